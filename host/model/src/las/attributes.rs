//! Numbers of a point's record beside its position.

use std::ops::Range;

use super::header::{LasHeader, RECORD_BYTES, bytes_at};
use super::remarks::{
    DESCRIPTION, ExtraBytesRemark, HAS_LEAST, HAS_MOST, HAS_OFFSET, HAS_SCALE, LEAST, MOST, OFFSET, SCALE,
};
use crate::{Attribute, Type};

/// Place and type of a number in a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NumberField {
    at: usize,
    how: How,
    limits: Option<LimitFields>,
}

/// Fields of extra bytes' descriptions for the least and the largest stored number, if they have these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LimitFields {
    pub least: Option<usize>,
    pub most: Option<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum How {
    /// Some bits of a byte.
    Bits {
        shift: u8,
        mask: u8,
    },
    Number(Type),
    U64,
    I64,
    /// A number of extra bytes that is to be scaled.
    Scaled {
        number: ExtraBytesType,
        scale: f64,
        offset: f64,
    },
}

impl How {
    fn size(self) -> usize {
        match self {
            Self::Bits { .. } => 1,
            Self::Number(kind) => kind.size(),
            Self::U64 | Self::I64 => 8,
            Self::Scaled { number, .. } => number.size(),
        }
    }
}

/// A type of extra bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum ExtraBytesType {
    Of(Type),
    U64,
    I64,
}

impl ExtraBytesType {
    fn size(self) -> usize {
        match self {
            Self::Of(kind) => kind.size(),
            Self::U64 | Self::I64 => 8,
        }
    }

    /// Bytes of a number, which is rounded to a whole one where the type has no others, and their count; none
    /// where the number does not fit.
    fn bytes(self, value: f64) -> Option<([u8; 8], usize)> {
        let mut bytes = [0; 8];
        macro_rules! put {
            ($number:expr) => {{
                let number = $number.to_le_bytes();
                bytes[..number.len()].copy_from_slice(&number);
                Some((bytes, number.len()))
            }};
        }
        // Whole numbers up to 2⁶⁴ fit 128 bits, and conversion cuts off at the ends.
        let rounded = value.round_ties_even() as i128;
        if !value.is_finite() {
            return None;
        }
        match self {
            Self::Of(Type::I8) => put!(i8::try_from(rounded).ok()?),
            Self::Of(Type::U8) => put!(u8::try_from(rounded).ok()?),
            Self::Of(Type::I16) => put!(i16::try_from(rounded).ok()?),
            Self::Of(Type::U16) => put!(u16::try_from(rounded).ok()?),
            Self::Of(Type::I32) => put!(i32::try_from(rounded).ok()?),
            Self::Of(Type::U32) => put!(u32::try_from(rounded).ok()?),
            Self::U64 => put!(u64::try_from(rounded).ok()?),
            Self::I64 => put!(i64::try_from(rounded).ok()?),
            Self::Of(Type::F32) => put!(Some(value as f32).filter(|value| value.is_finite())?),
            Self::Of(Type::F64) => put!(value),
        }
    }

    /// The type that has this code in a file, from 1 on.
    fn of_code(code: u8) -> Option<Self> {
        use Type::{F32, F64, I8, I16, I32, U8, U16, U32};
        let kinds = [
            Self::Of(U8),
            Self::Of(I8),
            Self::Of(U16),
            Self::Of(I16),
            Self::Of(U32),
            Self::Of(I32),
            Self::U64,
            Self::I64,
            Self::Of(F32),
            Self::Of(F64),
        ];
        kinds.get(usize::from(code).checked_sub(1)?).copied()
    }
}

/// Attributes of a file, and their places in a record.
#[derive(Debug, Clone, Default)]
pub(super) struct AttributeFields {
    pub attributes: Vec<Attribute>,
    places: Vec<NumberField>,
    /// Number of extra bytes among the attributes.
    extra_bytes: usize,
    /// Bytes of a record before extra ones.
    pub standard_bytes: usize,
    /// Remarks of the extra bytes' descriptions beside names and types.
    pub remarks: Vec<ExtraBytesRemark>,
}

impl AttributeFields {
    /// The places of the attributes of a point format, and the extra bytes that a record of the file
    /// describes.
    pub fn new(header: &LasHeader, extra: &[u8]) -> Self {
        use Type::{F64, I8, I16, U8, U16};
        let mut this = Self::default();
        let mut number = |name: &str, kind: Type, at: usize| this.add(name, kind, at, How::Number(kind));
        number("intensity", U16, 12);
        let format = header.format;
        let bits = |shift, mask| How::Bits { shift, mask };
        if format < 6 {
            this.add("return_number", U8, 14, bits(0, 7));
            this.add("number_of_returns", U8, 14, bits(3, 7));
            this.add("classification", U8, 15, bits(0, 31));
            this.add("scan_angle", I8, 16, How::Number(I8));
            this.add("user_data", U8, 17, How::Number(U8));
            this.add("point_source_id", U16, 18, How::Number(U16));
        } else {
            this.add("return_number", U8, 14, bits(0, 15));
            this.add("number_of_returns", U8, 14, bits(4, 15));
            this.add("classification", U8, 16, How::Number(U8));
            this.add("scan_angle", I16, 18, How::Number(I16));
            this.add("user_data", U8, 17, How::Number(U8));
            this.add("point_source_id", U16, 20, How::Number(U16));
        }
        let time = match format {
            1 | 3 | 4 | 5 => Some(20),
            6.. => Some(22),
            _ => None,
        };
        if let Some(at) = time {
            this.add("gps_time", F64, at, How::Number(F64));
        }
        let colour = match format {
            2 => Some(20),
            3 | 5 => Some(28),
            7 | 8 | 10 => Some(30),
            _ => None,
        };
        if let Some(at) = colour {
            for (i, name) in ["red", "green", "blue"].into_iter().enumerate() {
                this.add(name, U16, at + 2 * i, How::Number(U16));
            }
        }
        if matches!(format, 8 | 10) {
            this.add("nir", U16, 36, How::Number(U16));
        }
        this.add_flags(format);
        this.add_extra(header, extra);
        this
    }

    /// Flags, each a bit or two.
    fn add_flags(&mut self, format: u8) {
        let mut flag = |name, at, shift, mask| self.add(name, Type::U8, at, How::Bits { shift, mask });
        if format < 6 {
            flag("synthetic", 15, 5, 1);
            flag("key_point", 15, 6, 1);
            flag("withheld", 15, 7, 1);
            flag("scan_direction_flag", 14, 6, 1);
            flag("edge_of_flight_line", 14, 7, 1);
        } else {
            flag("synthetic", 15, 0, 1);
            flag("key_point", 15, 1, 1);
            flag("withheld", 15, 2, 1);
            flag("overlap", 15, 3, 1);
            flag("scanner_channel", 15, 4, 3);
            flag("scan_direction_flag", 15, 6, 1);
            flag("edge_of_flight_line", 15, 7, 1);
        }
    }

    fn add(&mut self, name: &str, kind: Type, at: usize, how: How) {
        if Attribute::is_name(name) && !self.attributes.iter().any(|known| known.name == name) {
            self.attributes.push(Attribute { name: name.to_owned(), kind });
            self.places.push(NumberField { at, how, limits: None });
        }
    }

    /// The extra bytes that are described, as far as the records have them.
    fn add_extra(&mut self, header: &LasHeader, descriptions: &[u8]) {
        let mut at = RECORD_BYTES[usize::from(header.format)];
        self.standard_bytes = at;
        for (number, one) in descriptions.chunks_exact(DESCRIPTION).enumerate() {
            let (code, options) = (one[2], one[3]);
            let bytes = match code {
                // Bytes without a meaning, as many as the options say.
                0 => usize::from(options),
                // Old ones: two or three of a type.
                11..=30 => {
                    let several = usize::from((code - 1) / 10) + 1;
                    several * ExtraBytesType::of_code((code - 1) % 10 + 1).map_or(0, ExtraBytesType::size)
                }
                code => ExtraBytesType::of_code(code).map_or(usize::MAX, ExtraBytesType::size),
            };
            let Some(behind) = at.checked_add(bytes).filter(|behind| *behind <= header.record) else {
                return;
            };
            if let Some(whole) = ExtraBytesType::of_code(code) {
                let name = one[4..36].split(|byte| *byte == 0).next().unwrap_or_default();
                let name = String::from_utf8_lossy(name);
                let [scale, offset] = [SCALE, OFFSET].map(|at| f64::from_le_bytes(bytes_at(one, at)));
                let scale = if options & HAS_SCALE != 0 { scale } else { 1.0 };
                let offset = if options & HAS_OFFSET != 0 { offset } else { 0.0 };
                let (kind, how) = match whole {
                    number if (scale, offset) != (1.0, 0.0) => {
                        (Type::F64, How::Scaled { number, scale, offset })
                    }
                    ExtraBytesType::Of(kind) => (kind, How::Number(kind)),
                    ExtraBytesType::U64 => (Type::F64, How::U64),
                    ExtraBytesType::I64 => (Type::F64, How::I64),
                };
                let known = self.attributes.len();
                self.add(name.trim(), kind, at, how);
                if self.attributes.len() > known {
                    self.extra_bytes += bytes;
                    let told = |bit: u8, at| (options & bit != 0).then_some(number * DESCRIPTION + at);
                    self.places[known].limits =
                        Some(LimitFields { least: told(HAS_LEAST, LEAST), most: told(HAS_MOST, MOST) });
                    self.remarks.extend(remark(name.trim(), one, how));
                }
            }
            at = behind;
        }
    }

    /// Fills each list with the numbers of one attribute, in the order of the first attributes.
    pub fn decode(&self, records: &[u8], record: usize, to: &mut [Vec<f64>]) {
        for (values, place) in to.iter_mut().zip(&self.places) {
            values.clear();
            values.extend(records.chunks_exact(record).map(|bytes| place.number(bytes)));
        }
        to.iter_mut().skip(self.places.len()).for_each(Vec::clear);
    }

    /// The bytes of a record that an attribute is in.
    pub fn bytes_of(&self, attribute: usize) -> Range<usize> {
        self.places.get(attribute).map_or(0..0, |place| place.at..place.at + place.how.size())
    }

    /// Whether an attribute's numbers can be written: a float, a double, or a number of extra bytes that is
    /// scaled.
    pub fn is_writable(&self, attribute: usize) -> bool {
        self.places
            .get(attribute)
            .is_some_and(|place| matches!(place.how, How::Number(Type::F32 | Type::F64) | How::Scaled { .. }))
    }

    /// An attribute of a record.
    pub fn number(&self, attribute: usize, record: &[u8]) -> f64 {
        self.places[attribute].number(record)
    }

    /// An attribute of a record as it is stored, without scale and offset.
    pub fn stored(&self, attribute: usize, record: &[u8]) -> f64 {
        let NumberField { at, how, .. } = self.places[attribute];
        match how {
            How::Scaled { number, .. } => whole(number, &record[at..]),
            _ => self.places[attribute].number(record),
        }
    }

    /// Puts a number into a record, unless it does not fit its type; returns whether the record has changed.
    pub fn put(&self, attribute: usize, record: &mut [u8], value: f64) -> bool {
        let NumberField { at, how, .. } = self.places[attribute];
        let (kind, value) = match how {
            How::Number(kind) => (ExtraBytesType::Of(kind), value),
            How::Scaled { number, scale, offset } => (number, (value - offset) / scale),
            _ => return false,
        };
        let Some((bytes, length)) = kind.bytes(value) else { return false };
        let place = &mut record[at..at + length];
        let changed = *place != bytes[..length];
        place.copy_from_slice(&bytes[..length]);
        changed
    }

    /// Places, among the descriptions of extra bytes, of the least and the largest stored number of an
    /// attribute, if there is either.
    pub fn limits(&self, attribute: usize) -> Option<LimitFields> {
        let limits = self.places.get(attribute)?.limits?;
        (limits.least.is_some() || limits.most.is_some()).then_some(limits)
    }

    /// The bytes by which such a place says how far an attribute reaches: of a double, or of a whole number
    /// with 64 bits.
    pub fn limit(&self, attribute: usize, stored: f64) -> Vec<u8> {
        let wide = match self.places[attribute].how {
            How::Scaled { number: ExtraBytesType::Of(kind), .. } | How::Number(kind) => match kind {
                Type::F32 | Type::F64 => ExtraBytesType::Of(Type::F64),
                Type::U8 | Type::U16 | Type::U32 => ExtraBytesType::U64,
                Type::I8 | Type::I16 | Type::I32 => ExtraBytesType::I64,
            },
            How::Scaled { number, .. } => number,
            How::Bits { .. } | How::U64 => ExtraBytesType::U64,
            How::I64 => ExtraBytesType::I64,
        };
        wide.bytes(stored).map_or(Vec::new(), |(bytes, _)| bytes.to_vec())
    }

    /// Names of the attributes that have whole numbers of 64 bits, of which doubles do not hold all digits.
    pub fn of_64_bits(&self) -> impl Iterator<Item = &str> {
        let are_wide = self.places.iter().map(NumberField::is_wide);
        self.attributes.iter().zip(are_wide).filter(|(_, is_wide)| *is_wide).map(|(of, _)| of.name.as_str())
    }

    /// Extra bytes of a record that are not among the attributes.
    pub fn undescribed(&self, record: usize) -> usize {
        record - self.standard_bytes - self.extra_bytes
    }

    /// The numbers of the attributes at some places.
    pub fn decode_some(&self, records: &[u8], record: usize, places: &[usize], to: &mut [Vec<f64>]) {
        for (values, place) in to.iter_mut().zip(places) {
            values.clear();
            if let Some(place) = self.places.get(*place) {
                values.extend(records.chunks_exact(record).map(|bytes| place.number(bytes)));
            }
        }
    }
}

/// Remark that the description of extra bytes makes on them beside name and type.
fn remark(name: &str, one: &[u8], how: How) -> Option<ExtraBytesRemark> {
    let stored = |number: ExtraBytesType, bytes: &[u8]| match number {
        ExtraBytesType::Of(Type::F32 | Type::F64) => plain(Type::F64, bytes),
        ExtraBytesType::Of(Type::U8 | Type::U16 | Type::U32) => whole(ExtraBytesType::U64, bytes),
        ExtraBytesType::Of(_) => whole(ExtraBytesType::I64, bytes),
        wide => whole(wide, bytes),
    };
    let remark = match how {
        How::Scaled { number: ExtraBytesType::Of(kind), .. } => {
            ExtraBytesRemark::read(name, one, Some(kind), |bytes| stored(ExtraBytesType::Of(kind), bytes))
        }
        // Integers of 64 bits that are scaled become doubles.
        How::Scaled { number, scale, offset } => {
            ExtraBytesRemark::read(name, one, None, |bytes| stored(number, bytes) * scale + offset)
        }
        How::Number(kind) => {
            ExtraBytesRemark::read(name, one, None, |bytes| stored(ExtraBytesType::Of(kind), bytes))
        }
        How::I64 => ExtraBytesRemark::read(name, one, None, |bytes| whole(ExtraBytesType::I64, bytes)),
        How::U64 | How::Bits { .. } => {
            ExtraBytesRemark::read(name, one, None, |bytes| whole(ExtraBytesType::U64, bytes))
        }
    };
    (!remark.is_empty()).then_some(remark)
}

impl NumberField {
    /// Whether the number is a whole one of 64 bits, scaled or not.
    fn is_wide(&self) -> bool {
        matches!(
            self.how,
            How::U64 | How::I64 | How::Scaled { number: ExtraBytesType::U64 | ExtraBytesType::I64, .. }
        )
    }

    #[inline]
    fn number(self, record: &[u8]) -> f64 {
        let bytes = &record[self.at..];
        match self.how {
            How::Bits { shift, mask } => f64::from((bytes[0] >> shift) & mask),
            How::Number(kind) => plain(kind, bytes),
            How::U64 => whole(ExtraBytesType::U64, bytes),
            How::I64 => whole(ExtraBytesType::I64, bytes),
            How::Scaled { number, scale, offset } => whole(number, bytes) * scale + offset,
        }
    }
}

fn whole(number: ExtraBytesType, bytes: &[u8]) -> f64 {
    match number {
        ExtraBytesType::Of(kind) => plain(kind, bytes),
        ExtraBytesType::U64 => u64::from_le_bytes(bytes_at(bytes, 0)) as f64,
        ExtraBytesType::I64 => i64::from_le_bytes(bytes_at(bytes, 0)) as f64,
    }
}

#[inline]
fn plain(kind: Type, bytes: &[u8]) -> f64 {
    match kind {
        Type::I8 => f64::from(bytes[0] as i8),
        Type::U8 => f64::from(bytes[0]),
        Type::I16 => f64::from(i16::from_le_bytes(bytes_at(bytes, 0))),
        Type::U16 => f64::from(u16::from_le_bytes(bytes_at(bytes, 0))),
        Type::I32 => f64::from(i32::from_le_bytes(bytes_at(bytes, 0))),
        Type::U32 => f64::from(u32::from_le_bytes(bytes_at(bytes, 0))),
        Type::F32 => f64::from(f32::from_le_bytes(bytes_at(bytes, 0))),
        Type::F64 => f64::from_le_bytes(bytes_at(bytes, 0)),
    }
}
