//! The fields of a point: how each is stored, as bits, and what number it is.

use crate::Type;

/// Type of a field's numbers in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NumberEncoding {
    /// 32 bits.
    Single,
    /// 64 bits.
    Double,
    /// Integers, in as many bits as the largest less the least one needs: a number is integer · scale +
    /// offset.
    Integer { min: i64, max: i64, scale: f64, offset: f64 },
    /// A field that holds no numbers, and is kept as it is.
    Other,
}

impl NumberEncoding {
    /// The number that bits stand for.
    #[inline]
    pub fn value(&self, bits: u64) -> f64 {
        match *self {
            Self::Single => f64::from(f32::from_bits(bits as u32)),
            Self::Double => f64::from_bits(bits),
            Self::Integer { min, scale, offset, .. } => {
                let number = min.wrapping_add(bits.cast_signed());
                number as f64 * scale + offset
            }
            Self::Other => f64::NAN,
        }
    }

    /// The bits of the nearest number; none if there is none so far out.
    #[inline]
    pub fn nearest(&self, value: f64) -> Option<u64> {
        match *self {
            NumberEncoding::Single => {
                Some(value as f32).filter(|v| v.is_finite()).map(|v| v.to_bits().into())
            }
            NumberEncoding::Double => Some(value).filter(|v| v.is_finite()).map(f64::to_bits),
            NumberEncoding::Integer { min, max, scale, offset } => {
                let number = ((value - offset) / scale).round();
                // Both ends as doubles are exact, or beyond every number that rounding gives.
                if !(number >= min as f64 && number <= max as f64) {
                    return None;
                }
                let number = (number as i64).clamp(min, max);
                Some(number.wrapping_sub(min).cast_unsigned())
            }
            NumberEncoding::Other => None,
        }
    }

    /// The least and the largest number that can be stored.
    pub fn range(&self) -> (f64, f64) {
        match *self {
            NumberEncoding::Single => (f32::MIN.into(), f32::MAX.into()),
            NumberEncoding::Integer { min, max, scale, offset } => {
                let ends = [min, max].map(|n| n as f64 * scale + offset);
                (ends[0].min(ends[1]), ends[0].max(ends[1]))
            }
            NumberEncoding::Double | NumberEncoding::Other => (f64::MIN, f64::MAX),
        }
    }
}

/// A field of the points of a scan, which has a stream of bits of its own.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct E57Field {
    /// Name of the field's element, with a prefix if it is an extension's: `cartesianX`, `nor:normalX`.
    pub name: String,
    pub kind: NumberEncoding,
}

impl E57Field {
    /// Bits of a number.
    pub fn bits(&self) -> u32 {
        match self.kind {
            NumberEncoding::Single => 32,
            NumberEncoding::Double => 64,
            NumberEncoding::Integer { min, max, .. } => {
                u64::BITS - max.wrapping_sub(min).cast_unsigned().leading_zeros()
            }
            NumberEncoding::Other => 0,
        }
    }

    pub fn is_number(&self) -> bool {
        self.kind != NumberEncoding::Other
    }

    /// The number that bits stand for.
    #[inline]
    pub fn value(&self, bits: u64) -> f64 {
        self.kind.value(bits)
    }

    /// The least and the largest number that can be stored.
    pub fn range(&self) -> (f64, f64) {
        self.kind.range()
    }

    /// Step from one number of the field to the next; zero of floats.
    pub fn step(&self) -> f64 {
        match self.kind {
            NumberEncoding::Integer { min, max, scale, .. } if max > min => scale.abs(),
            _ => 0.0,
        }
    }

    /// Whether some of the field's numbers are integers that double precision does not tell apart.
    pub fn is_beyond_doubles(&self) -> bool {
        const MOST: i64 = 1 << 53;
        matches!(self.kind, NumberEncoding::Integer { min, max, .. } if max > min && (min < -MOST || max > MOST))
    }

    /// Type that holds all numbers of the field: for unscaled integers the narrowest one.
    pub fn number_type(&self) -> Type {
        match self.kind {
            NumberEncoding::Single => Type::F32,
            NumberEncoding::Integer { min, max, scale: 1.0, offset: 0.0 } => {
                let fits = |least: i64, most: i64| min >= least && max <= most;
                let types = [
                    (Type::U8, 0, i64::from(u8::MAX)),
                    (Type::I8, i64::from(i8::MIN), i64::from(i8::MAX)),
                    (Type::U16, 0, i64::from(u16::MAX)),
                    (Type::I16, i64::from(i16::MIN), i64::from(i16::MAX)),
                    (Type::U32, 0, i64::from(u32::MAX)),
                    (Type::I32, i64::from(i32::MIN), i64::from(i32::MAX)),
                ];
                let found = types.iter().find(|(_, least, most)| fits(*least, *most));
                found.map_or(Type::F64, |(kind, ..)| *kind)
            }
            _ => Type::F64,
        }
    }
}

/// Numbers of one field, packed: each has as many bits as the field, the lowest ones first.
#[derive(Debug, Clone, Default)]
pub(super) struct PackedNumbers {
    /// Bytes of the field's stream, and some more at the end, so that reading needs no care.
    bytes: Vec<u8>,
    /// First byte of the stream that is held.
    pub first: u64,
    /// Bit of the first byte at which the first number begins.
    shift: u32,
    width: u32,
}

/// Bytes behind the last of a stream.
const SPARE: usize = 16;

impl PackedNumbers {
    /// Begins numbers from `first` on of a field of so many bits, whose bytes will be [put](Self::bytes_mut)
    /// there.
    pub fn begin(&mut self, width: u32, first: u64, count: u64) {
        let range = Self::range(width, first, count);
        self.first = range.start;
        self.shift = ((u128::from(first) * u128::from(width)) % 8) as u32;
        self.width = width;
        self.bytes.clear();
        self.bytes.resize((range.end - range.start) as usize + SPARE, 0);
    }

    /// Range of the bytes of a stream in which some of its numbers lie.
    pub fn range(width: u32, first: u64, count: u64) -> std::ops::Range<u64> {
        let bit = |number: u64| u128::from(number) * u128::from(width);
        let (start, end) = (bit(first) / 8, bit(first.saturating_add(count)).div_ceil(8));
        let byte = |byte: u128| u64::try_from(byte).unwrap_or(u64::MAX);
        if count == 0 || width == 0 { byte(start)..byte(start) } else { byte(start)..byte(end) }
    }

    /// The bytes of the stream.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.bytes.len().saturating_sub(SPARE)]
    }

    pub fn bytes_mut(&mut self) -> &mut [u8] {
        let end = self.bytes.len().saturating_sub(SPARE);
        &mut self.bytes[..end]
    }

    /// The bits of a number, counted from the first one.
    #[inline]
    pub fn get(&self, index: usize) -> u64 {
        if self.width == 0 {
            return 0;
        }
        let bit = self.shift as usize + index * self.width as usize;
        let mut sixteen = [0; 16];
        sixteen.copy_from_slice(&self.bytes[bit / 8..bit / 8 + 16]);
        let word = (u128::from_le_bytes(sixteen) >> (bit % 8)) as u64;
        if self.width == 64 { word } else { word & ((1 << self.width) - 1) }
    }

    /// Replaces the bits of a number.
    #[inline]
    pub fn put(&mut self, index: usize, bits: u64) {
        if self.width == 0 {
            return;
        }
        let bit = self.shift as usize + index * self.width as usize;
        let there = &mut self.bytes[bit / 8..bit / 8 + 16];
        let mut sixteen = [0; 16];
        sixteen.copy_from_slice(there);
        let mask = if self.width == 64 { u128::from(u64::MAX) } else { (1 << self.width) - 1 };
        let rest = u128::from_le_bytes(sixteen) & !(mask << (bit % 8));
        let all = rest | (u128::from(bits) & mask) << (bit % 8);
        there.copy_from_slice(&all.to_le_bytes());
    }
}

/// A range of integers, as wide as so many bits allow, that reaches over all of `from` to `to`; the range
/// before stays as much as it can. None if there is none.
pub(super) fn range_over(range: [i64; 2], bits: u32, from: f64, to: f64) -> Option<[i64; 2]> {
    let [min, max] = range.map(i128::from);
    // Casts of floats end at the ends.
    let (least, most) = (from.floor() as i128, to.ceil() as i128);
    let span = (1i128 << bits) - 1;
    if most - least > span {
        return None;
    }
    let start = if least >= min && most <= min + span {
        min
    } else if most <= max && least >= max - span {
        max - span
    } else {
        least - (span - (most - least)) / 2
    };
    let start = start.clamp(i64::MIN.into(), i128::from(i64::MAX) - span);
    (start <= least && most <= start + span).then_some([start as i64, (start + span) as i64])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn integer(min: i64, max: i64, scale: f64, offset: f64) -> E57Field {
        E57Field { name: "x".into(), kind: NumberEncoding::Integer { min, max, scale, offset } }
    }

    #[test]
    fn integers_take_the_bits_that_they_need() {
        for (min, max, bits) in [
            (0, 0, 0),
            (5, 5, 0),
            (0, 1, 1),
            (0, 255, 8),
            (0, 256, 9),
            (-128, 127, 8),
            (i64::MIN, i64::MAX, 64),
        ] {
            assert_eq!(integer(min, max, 1.0, 0.0).bits(), bits);
        }
    }

    #[test]
    fn numbers_beyond_the_range_have_no_bits() {
        let field = integer(-10, 20, 0.5, 100.0);
        assert_eq!(field.range(), (95.0, 110.0));
        assert_eq!(field.kind.nearest(95.0), Some(0));
        assert_eq!(field.kind.nearest(110.2), Some(30));
        assert_eq!(field.kind.nearest(110.3), None);
        assert_eq!(field.kind.nearest(94.7), None);
        assert_eq!(field.kind.nearest(f64::NAN), None);
        let negative = integer(-10, 20, -0.5, 0.0);
        assert_eq!(negative.range(), (-10.0, 5.0));
        assert_eq!(negative.kind.nearest(5.0).map(|bits| negative.value(bits)), Some(5.0));
        let single = E57Field { name: "x".into(), kind: NumberEncoding::Single };
        assert_eq!(single.kind.nearest(1e39), None);
    }

    #[test]
    fn ranges_move_no_further_than_they_have_to() {
        assert_eq!(range_over([0, 200], 8, 10.0, 250.5), Some([0, 255]));
        assert_eq!(range_over([0, 200], 8, -30.0, 150.0), Some([-55, 200]));
        assert_eq!(range_over([0, 200], 8, 1000.0, 1100.0), Some([923, 1178]));
        assert_eq!(range_over([0, 200], 8, 0.0, 255.5), None);
        assert_eq!(range_over([5, 5], 0, 5.0, 5.0), Some([5, 5]));
        assert_eq!(range_over([0, 3], 2, 1e300, 1e300), None);
        assert_eq!(range_over([i64::MIN, i64::MAX], 64, -1e9, 1e9), Some([i64::MIN, i64::MAX]));
    }

    proptest! {
        #[test]
        fn packed_numbers_come_back(
            width in 0..=64u32,
            first in 0..1u64 << 40,
            numbers in prop::collection::vec(any::<u64>(), 1..50),
        ) {
            let mut packed = PackedNumbers::default();
            packed.begin(width, first, numbers.len() as u64);
            packed.bytes_mut().fill(0xa5);
            let before = packed.clone();
            let mask = if width == 64 { u64::MAX } else { (1 << width) - 1 };
            // In any order, without touching each other.
            for i in (0..numbers.len()).rev() {
                packed.put(i, numbers[i]);
            }
            for (i, number) in numbers.iter().enumerate() {
                prop_assert_eq!(packed.get(i), number & mask);
            }
            for i in 0..numbers.len() {
                packed.put(i, before.get(i));
            }
            prop_assert_eq!(packed.bytes(), before.bytes());
        }

        #[test]
        fn integers_come_back(a in any::<i64>(), b in any::<i64>(), bits in any::<u64>()) {
            let (min, max) = (a.min(b) >> 12, a.max(b) >> 12);
            let field = integer(min, max, 1.0, 0.0);
            let span = (max - min).cast_unsigned();
            let bits = if span == u64::MAX { bits } else { bits % (span + 1) };
            prop_assert_eq!(field.kind.nearest(field.value(bits)), Some(bits));
        }
    }
}
