//! LAS and LAZ written anew, from models of other formats: point formats 6 to 8 of LAS 1.4, and 0 to 3 of LAS
//! 1.2 where scan angles are the bytes that they are there.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, IVec3};
use laz::laszip::ChunkTableEntry;

use super::blocks::table_of;
use super::header::{ADJUSTED_TIME, RECORD_BYTES, at};
use super::laszip::Laszip;
use super::remarks::{self, DESCRIPTION, ExtraBytesRemark};
use crate::bounds::Bounds;
use crate::follow::Following;
use crate::form::{ConversionInput, Form, Rounding, WrittenRows, attribute_loss, counted, put_numbers};
use crate::{
    Attribute, ColorScale, Colors, Error, Model, Result, ScaledIntegers, Summary, Type, VertexChunk,
    for_positions,
};

/// Points of a compressed block: as LASzip has it.
pub(super) const BLOCK: u32 = 50_000;

/// Numbers of a summary for each piece: points, bytes, and points by their return, up to the fifteenth.
pub(super) const TALLIES: usize = 17;

/// Full light, of colours and intensities.
const MOST_LIGHT: f64 = 65535.0;

/// Most bytes of a VLR's content.
const LONGEST: usize = u16::MAX as usize;

/// User and number of the VLR that describes the compression of the points.
pub(super) const LASZIP: (&[u8], u16) = (b"laszip encoded", 22204);

/// The place that a number goes to.
#[derive(Debug, Clone, Copy, PartialEq)]
enum FieldTarget {
    /// A number with bytes of its own.
    Number(Type),
    /// Some bits of a byte, from the bit `shift` on.
    Bits { shift: u8, bits: u8 },
    /// A number of extra bytes that is stored in this type: less the second number, divided by the first.
    Scaled { kind: Type, scale: f64, offset: f64 },
    /// A number of 16 bits of light: how much more than the first number, times the second.
    Light(f64, f64),
}

/// An attribute that is written.
#[derive(Debug, Clone, PartialEq)]
struct WrittenAttribute {
    name: String,
    /// Place of the attribute among those of the model.
    from: usize,
    at: usize,
    place: FieldTarget,
    /// Whether numbers are rounded, and clamped to the range of their type.
    rounds: bool,
}

/// A file of points.
pub(crate) struct LasForm {
    is_compressed: bool,
    format: u8,
    vertices: u64,
    record: usize,
    fields: Vec<WrittenAttribute>,
    /// Place of the return number among the fields.
    returns: Option<usize>,
    integers: ScaledIntegers,
    /// Descriptions of extra bytes.
    extra: Vec<u8>,
    /// The coordinate reference system as text, if it has one.
    wkt: Vec<u8>,
    /// Whether GPS times are adjusted standard ones.
    has_adjusted_time: bool,
    /// Compression of the points, and the VLR that describes it.
    laszip: Option<(Laszip, Vec<u8>)>,
    /// Whether vertices without a position are left out, and the number of those that were.
    leaves_out: bool,
    left_out: AtomicU64,
}

/// Byte and type of a standard attribute in a record, in point formats below 6 and from there on.
fn standard(name: &str, format: u8) -> Option<(usize, FieldTarget)> {
    let (bits, number) = (|shift, bits| FieldTarget::Bits { shift, bits }, FieldTarget::Number);
    let is_old = format < 6;
    Some(match (name, is_old) {
        ("intensity", _) => (12, number(Type::U16)),
        ("return_number", true) => (14, bits(0, 3)),
        ("number_of_returns", true) => (14, bits(3, 3)),
        ("return_number", false) => (14, bits(0, 4)),
        ("number_of_returns", false) => (14, bits(4, 4)),
        ("scan_direction_flag", true) => (14, bits(6, 1)),
        ("edge_of_flight_line", true) => (14, bits(7, 1)),
        ("classification", true) => (15, bits(0, 5)),
        ("synthetic", true) => (15, bits(5, 1)),
        ("key_point", true) => (15, bits(6, 1)),
        ("withheld", true) => (15, bits(7, 1)),
        ("synthetic", false) => (15, bits(0, 1)),
        ("key_point", false) => (15, bits(1, 1)),
        ("withheld", false) => (15, bits(2, 1)),
        ("overlap", false) => (15, bits(3, 1)),
        ("scanner_channel", false) => (15, bits(4, 2)),
        ("scan_direction_flag", false) => (15, bits(6, 1)),
        ("edge_of_flight_line", false) => (15, bits(7, 1)),
        ("classification", false) => (16, number(Type::U8)),
        ("scan_angle", true) => (16, number(Type::I8)),
        ("scan_angle", false) => (18, number(Type::I16)),
        ("user_data", _) => (17, number(Type::U8)),
        ("point_source_id", true) => (18, number(Type::U16)),
        ("point_source_id", false) => (20, number(Type::U16)),
        ("gps_time", true) => (20, number(Type::F64)),
        ("gps_time", false) => (22, number(Type::F64)),
        ("nir", false) => (36, number(Type::U16)),
        _ => return None,
    })
}

/// Least and largest number that a place holds.
fn range(place: FieldTarget) -> (f64, f64) {
    match place {
        FieldTarget::Bits { bits, .. } => (0.0, f64::from((1u32 << bits) - 1)),
        FieldTarget::Light(..) => (0.0, MOST_LIGHT),
        FieldTarget::Number(kind) | FieldTarget::Scaled { kind, .. } => match kind {
            Type::U8 => (0.0, 255.0),
            Type::I8 => (-128.0, 127.0),
            Type::U16 => (0.0, 65535.0),
            Type::I16 => (-32768.0, 32767.0),
            Type::U32 => (0.0, f64::from(u32::MAX)),
            Type::I32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
            Type::F32 | Type::F64 => (f64::NEG_INFINITY, f64::INFINITY),
        },
    }
}

/// Whether a place keeps all numbers of a type apart. Flags and the like that are wider in the model than in
/// the record are checked when they are written.
fn fits(kind: Type, place: FieldTarget) -> bool {
    match place {
        FieldTarget::Number(Type::F64) => true,
        FieldTarget::Bits { .. } => kind == Type::U8,
        FieldTarget::Number(to) if kind.is_float() => to == kind,
        FieldTarget::Number(to) => {
            let ((least, most), (from, end)) = (range(place), range(FieldTarget::Number(kind)));
            !to.is_float() && from >= least && end <= most
        }
        FieldTarget::Light(..) => matches!(kind, Type::U8 | Type::U16),
        FieldTarget::Scaled { .. } => false,
    }
}

/// Properties of the numbers of an attribute, all over the model.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FoundNumbers {
    least: f64,
    most: f64,
    are_whole: bool,
    /// Whether all numbers come back exactly from the type in which they are [said](ExtraBytesRemark::stored)
    /// to be stored.
    are_stored: bool,
}

impl FoundNumbers {
    /// Properties before any numbers were found.
    const NONE: Self =
        Self { least: f64::INFINITY, most: f64::NEG_INFINITY, are_whole: true, are_stored: true };

    /// Includes numbers, on which there may be a remark; NaN and infinite numbers are not whole.
    fn take(&mut self, numbers: &[f64], remark: Option<&ExtraBytesRemark>) {
        if let Some((remark, kind)) = remark.and_then(|remark| Some((remark, remark.stored?))) {
            let (least, most) = range(FieldTarget::Number(kind));
            self.are_stored = self.are_stored
                && numbers.iter().all(|number| {
                    let stored = remark.to_stored(*number);
                    (least..=most).contains(&stored) && remark.of_stored(stored) == *number
                });
        }
        for number in numbers {
            (self.least, self.most) = (self.least.min(*number), self.most.max(*number));
            self.are_whole &= number.fract() == 0.0;
        }
    }

    /// Whether a place holds all the numbers as they are.
    fn fit(&self, place: FieldTarget) -> bool {
        let (least, most) = range(place);
        let is_light = matches!(place, FieldTarget::Light(..));
        self.are_whole && !is_light && self.least >= least && self.most <= most
    }
}

/// Properties of the numbers of those attributes whose type does not guarantee that their places hold them,
/// or that are said to be stored in another type. Reads the model, if there are such attributes.
fn found_numbers(
    model: &dyn Model,
    places: &[Option<(usize, FieldTarget)>],
    remarks: &[Option<ExtraBytesRemark>],
) -> Result<Vec<FoundNumbers>> {
    let mut found = vec![FoundNumbers::NONE; places.len()];
    let attributes = &model.info().attributes;
    let is_open = |from: &usize| match places[*from] {
        Some((_, FieldTarget::Light(..))) => false,
        Some((_, place)) => !fits(attributes[*from].kind, place),
        None => remarks[*from].as_ref().is_some_and(|remark| remark.stored.is_some()),
    };
    let open: Vec<usize> = (0..places.len()).filter(is_open).collect();
    if open.is_empty() {
        return Ok(found);
    }
    let mut reader = model.vertices(0..model.info().vertices)?;
    let (mut chunk, mut lists) = (VertexChunk::default(), vec![Vec::new(); open.len()]);
    while reader.read(&mut chunk)? {
        model.some_attributes(&chunk, &open, &mut lists)?;
        for (place, numbers) in open.iter().zip(&lists) {
            found[*place].take(numbers, remarks[*place].as_ref());
        }
    }
    Ok(found)
}

/// The place of an attribute, which for intensities that are no whole numbers of LAS's is one of light: from
/// the least to the largest that the model says there may be, or else of fractions.
fn for_intensity(
    attribute: &Attribute,
    place: FieldTarget,
    found: &FoundNumbers,
    limits: Option<[f64; 2]>,
) -> FieldTarget {
    let holds_all = fits(attribute.kind, place) || found.fit(place);
    if attribute.name != "intensity" || holds_all {
        return place;
    }
    let are_fractions = found.least >= 0.0 && found.most <= 1.0;
    let limits = limits.filter(|[least, most]| *least <= found.least && found.most <= *most);
    match limits.or(are_fractions.then_some([0.0, 1.0])) {
        // Numbers such as LAS has them, but for their digits.
        Some([least, most]) if least >= 0.0 && most > 1.0 && most <= MOST_LIGHT => place,
        Some([least, most]) => FieldTarget::Light(least, MOST_LIGHT / (most - least)),
        None => place,
    }
}

/// Text of the coordinate reference system, as a record has it, where the file has room for it: in LAS 1.4,
/// whose points are of the new formats.
fn wkt(content: &ConversionInput<'_>, format: u8, losses: &mut Vec<String>) -> Vec<u8> {
    let text = content.model.wkt().filter(|text| format >= 6 && text.len() < LONGEST);
    match (text, &content.info().crs) {
        (Some(text), _) => [text.as_bytes(), &[0]].concat(),
        (None, Some(crs)) => {
            losses.push(format!("the coordinate reference system {crs}"));
            Vec::new()
        }
        (None, None) => Vec::new(),
    }
}

/// Adds the losses of a model's content that points have no place for.
fn lose_what_has_no_place(content: &ConversionInput<'_>, losses: &mut Vec<String>) {
    if content.faces.triangles > 0 {
        losses.push(counted(content.faces.polygons, "face"));
    }
    if content.has_normals {
        losses.push("the normals".to_owned());
    }
}

/// Remark on each attribute's extra bytes; other remarks are losses.
fn remarks(content: &ConversionInput<'_>, losses: &mut Vec<String>) -> Vec<Option<ExtraBytesRemark>> {
    let attributes = &content.info().attributes;
    let has_time = has_time(attributes);
    let (mut found, mut lost) = (vec![None; attributes.len()], Vec::new());
    for line in content.model.remarks() {
        let remark = ExtraBytesRemark::parse(&line);
        let is_extra = |a: &Attribute| standard(&a.name, 0).or(standard(&a.name, 8)).is_none();
        let is_its = |a: &Attribute| {
            is_extra(a) && remark.as_ref().is_some_and(|remark| remark.name == remarks::name_of(&a.name))
        };
        // Names that differ in their blanks alone have their remarks one after the other.
        let place =
            (0..attributes.len()).find(|place| found[*place].is_none() && is_its(&attributes[*place]));
        match place {
            Some(place) => found[place] = remark,
            None if line == remarks::GPS_TIME && has_time => {}
            None => lost.push(line),
        }
    }
    losses.extend(remarks::losses(&lost));
    // Attributes that turn with the surface keep neither their range nor the step of their numbers.
    for place in content.model.following().map_or(&[][..], Following::places) {
        if let Some(slot) = found.get_mut(*place)
            && let Some(remark) = slot.take()
        {
            *slot = Some(ExtraBytesRemark { least: None, most: None, ..remark.unscaled() });
        }
    }
    found
}

/// Whether points have GPS times.
fn has_time(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| attribute.name == "gps_time")
}

/// The point format that has places for most attributes: one below 6 for angles in whole degrees.
fn point_format(attributes: &[Attribute], has_colors: bool) -> u8 {
    let has = |name: &str| attributes.iter().any(|a| a.name == name);
    let is_old = attributes.iter().any(|a| a.name == "scan_angle" && a.kind == Type::I8);
    match (is_old, has_colors) {
        (true, colors) => u8::from(has("gps_time")) + if colors { 2 } else { 0 },
        (false, _) if has("nir") => 8,
        (false, true) => 7,
        (false, false) => 6,
    }
}

/// Byte and type in a record of each attribute that has a place there: colours by their scale, and all others
/// by their names.
fn places(
    attributes: &[Attribute],
    format: u8,
    colors: Option<(Colors, f64)>,
) -> Vec<Option<(usize, FieldTarget)>> {
    let place = |(from, attribute): (usize, &Attribute)| {
        let of_color = colors.and_then(|(colors, scale)| {
            let which = colors.places.iter().position(|place| *place == from)?;
            Some((colors_at(format) + 2 * which, FieldTarget::Light(0.0, scale)))
        });
        of_color.or_else(|| standard(&attribute.name, format))
    };
    attributes.iter().enumerate().map(place).collect()
}

/// Byte of a record at which red begins.
fn colors_at(format: u8) -> usize {
    match format {
        2 => 20,
        3 => 28,
        _ => 30,
    }
}

impl LasForm {
    pub(crate) fn new(
        is_compressed: bool,
        content: &ConversionInput<'_>,
        losses: &mut Vec<String>,
    ) -> Result<Self> {
        let info = content.info();
        lose_what_has_no_place(content, losses);
        let colors = Colors::from_info(info).filter(|colors| {
            let names = colors.places.map(|place| info.attributes[place].name.as_str());
            names == ["red", "green", "blue"]
        });
        let format = point_format(&info.attributes, colors.is_some());
        if format < 6 {
            content.too_many("points of LAS 1.2", info.vertices, u64::from(u32::MAX))?;
        }
        let integers = integers(content)?;
        let mut this = Self {
            is_compressed,
            format,
            vertices: info.vertices,
            record: RECORD_BYTES[usize::from(format)],
            fields: Vec::new(),
            returns: None,
            integers,
            extra: Vec::new(),
            wkt: wkt(content, format, losses),
            has_adjusted_time: has_time(&info.attributes)
                && content.model.remarks().iter().any(|line| line == remarks::GPS_TIME),
            laszip: None,
            leaves_out: content.how.lossy,
            left_out: AtomicU64::new(0),
        };
        this.add_attributes(content, colors, losses)?;
        if is_compressed {
            let extra = this.record - RECORD_BYTES[usize::from(format)];
            let laszip = Laszip::anew(format, extra as u16, BLOCK);
            this.laszip = Some(laszip.map_err(|e| Error::unwritable("compressed points", e))?);
        }
        Ok(this)
    }

    /// Has all attributes written: those that have a place in a record there, and the others as extra bytes.
    fn add_attributes(
        &mut self,
        content: &ConversionInput<'_>,
        colors: Option<Colors>,
        losses: &mut Vec<String>,
    ) -> Result<()> {
        let info = content.info();
        let scale = colors.map(|colors| full_light(content, &colors)).transpose()?;
        let places = places(&info.attributes, self.format, colors.zip(scale));
        let remarks = remarks(content, losses);
        let found = found_numbers(content.model, &places, &remarks)?;
        for (from, (attribute, place)) in info.attributes.iter().zip(places).enumerate() {
            let intensities = content.model.intensity_limits();
            let place =
                place.map(|(at, place)| (at, for_intensity(attribute, place, &found[from], intensities)));
            match place {
                Some(place) => self.add_attribute(from, attribute, place, &found[from], losses),
                None => {
                    let remark = remarks[from].clone().unwrap_or_default();
                    self.add_extra(from, attribute, (remark, &found[from]), losses);
                }
            }
        }
        Ok(())
    }

    /// Adds a field for an attribute that has a place in a record.
    fn add_attribute(
        &mut self,
        from: usize,
        attribute: &Attribute,
        (at, place): (usize, FieldTarget),
        found: &FoundNumbers,
        losses: &mut Vec<String>,
    ) {
        let (name, kind) = (attribute.name.clone(), attribute.kind);
        let rounds = !fits(kind, place);
        if rounds && !found.fit(place) {
            let (least, most) = range(place);
            let of = match place {
                FieldTarget::Light(from, scale) => {
                    format!("of which {from} to {} become", from + MOST_LIGHT / scale)
                }
                _ => "which become".to_owned(),
            };
            let of_all = attribute_loss(&name, kind);
            losses.push(format!("digits of {of_all}, {of} whole numbers from {least} to {most}"));
        }
        if name == "return_number" {
            self.returns = Some(self.fields.len());
        }
        self.fields.push(WrittenAttribute { name, from, at, place, rounds });
    }

    /// Adds extra bytes for an attribute, if the record has room for them, with the remark on them.
    fn add_extra(
        &mut self,
        from: usize,
        attribute: &Attribute,
        (remark, found): (ExtraBytesRemark, &FoundNumbers),
        losses: &mut Vec<String>,
    ) {
        let Attribute { name, kind } = attribute;
        let name = remark.spaced.clone().unwrap_or_else(|| name.clone());
        let (place, remark) = match remark.stored {
            Some(kind) if found.are_stored => {
                let (scale, offset) = (remark.scale.unwrap_or(1.0), remark.offset.unwrap_or(0.0));
                (FieldTarget::Scaled { kind, scale, offset }, remark)
            }
            Some(kind) => {
                let kind = kind.name();
                losses
                    .push(format!("that {name} was a {kind} with a scale, which does not give its numbers"));
                (FieldTarget::Number(attribute.kind), remark.unscaled())
            }
            None => (FieldTarget::Number(*kind), remark),
        };
        let (FieldTarget::Scaled { kind: stored, .. } | FieldTarget::Number(stored)) = place else { return };
        let fits_in = name.len() <= 32 && self.extra.len() + DESCRIPTION <= LONGEST;
        if !fits_in || self.record + stored.size() > LONGEST {
            losses.push(attribute_loss(&name, *kind));
            return;
        }
        let start = self.extra.len();
        self.extra.resize(start + DESCRIPTION, 0);
        let description = &mut self.extra[start..];
        description[2] = match stored {
            Type::U8 => 1,
            Type::I8 => 2,
            Type::U16 => 3,
            Type::I16 => 4,
            Type::U32 => 5,
            Type::I32 => 6,
            Type::F32 => 9,
            Type::F64 => 10,
        };
        description[4..4 + name.len()].copy_from_slice(name.as_bytes());
        remark.put(stored, description);
        let at = self.record;
        self.record += stored.size();
        self.fields.push(WrittenAttribute { name, from, at, place, rounds: false });
    }

    /// Place of the number of points in the header, and its bytes for so many points.
    fn count(&self, points: u64) -> (u64, Vec<u8>) {
        if self.format < 6 {
            (107, (points as u32).to_le_bytes().to_vec())
        } else {
            (247, points.to_le_bytes().to_vec())
        }
    }

    fn header_len(&self) -> usize {
        if self.format < 6 { 227 } else { 375 }
    }

    fn vlrs(&self) -> Vec<u8> {
        // First, so that it is known where.
        let mut all =
            self.laszip.as_ref().map_or(Vec::new(), |(_, content)| vlr(LASZIP.0, LASZIP.1, content));
        if !self.extra.is_empty() {
            all.extend(vlr(b"LASF_Spec", 4, &self.extra));
        }
        if !self.wkt.is_empty() {
            all.extend(vlr(b"LASF_Projection", 2112, &self.wkt));
        }
        all
    }

    /// Byte of the file at which the points begin.
    fn start(&self) -> u64 {
        (self.header_len() + self.vlrs().len()) as u64
    }

    /// Fills the records of vertices.
    fn records(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, summary: &mut Summary) -> Result<()> {
        to.clear();
        to.resize(rows.positions.len() * self.record, 0);
        let (mut least, mut most) = (IVec3::MAX, IVec3::MIN);
        for (i, (record, p)) in to.chunks_exact_mut(self.record).zip(rows.positions).enumerate() {
            if self.leaves_out && !p.is_finite() {
                continue;
            }
            let numbers = self.integers.nearest(*p).ok_or_else(|| self.unfit(rows, i))?;
            record[..12].copy_from_slice(numbers.to_array().map(i32::to_le_bytes).as_flattened());
            (least, most) = (least.min(numbers), most.max(numbers));
        }
        if least.x <= most.x {
            summary.before = Bounds { min: least.as_dvec3(), max: most.as_dvec3() };
            summary.after = summary.before;
        }
        let mut numbers = Vec::new();
        for field in &self.fields {
            self.numbers(field, rows, &mut numbers)?;
            match field.place {
                FieldTarget::Bits { shift, .. } => {
                    for (record, number) in to.chunks_exact_mut(self.record).zip(&numbers) {
                        record[field.at] |= (*number as u8) << shift;
                    }
                }
                FieldTarget::Number(kind) | FieldTarget::Scaled { kind, .. } => {
                    put_numbers(kind, &numbers, to, field.at, self.record);
                }
                FieldTarget::Light(..) => put_numbers(Type::U16, &numbers, to, field.at, self.record),
            }
        }
        Ok(())
    }

    /// The numbers of a field as they are written.
    fn numbers(&self, field: &WrittenAttribute, rows: &WrittenRows<'_>, to: &mut Vec<f64>) -> Result<()> {
        let (least, most) = range(field.place);
        to.clear();
        for (i, number) in rows.attributes[field.from].iter().enumerate() {
            let scaled = match field.place {
                FieldTarget::Light(from, scale) => (number - from) * scale,
                FieldTarget::Scaled { kind, scale, offset } => {
                    let stored = (number - offset) / scale;
                    if kind.is_float() { stored } else { stored.round() }
                }
                FieldTarget::Number(_) | FieldTarget::Bits { .. } => *number,
            };
            let is_whole = least.is_finite();
            to.push(match field.rounds {
                // Numbers of points that are left out, and missing numbers where losses are allowed, as those
                // of a scan without an attribute that others have: they become 0, as in PLY.
                _ if is_whole && self.leaves_out && (scaled.is_nan() || !rows.positions[i].is_finite()) => 0.0,
                true => scaled.round().clamp(least, most),
                // NaN may be a number of the attribute: a place for floats holds it.
                false if (least..=most).contains(&scaled) || least == f64::NEG_INFINITY => scaled,
                false => {
                    return Err(Error::degenerate(format!(
                            "vertex {} has the {} {number}, which LAS counts from {least} to {most} in point format {}",
                            rows.first + i as u64,
                            field.name,
                            self.format
                        ), "write a format that holds it, as PLY"));
                }
            });
        }
        Ok(())
    }

    /// Removes the records of vertices that have no position; returns their number.
    fn leave_out(&self, rows: &WrittenRows<'_>, records: &mut Vec<u8>) -> usize {
        let mut kept = 0;
        for (i, _) in rows.positions.iter().enumerate().filter(|(_, p)| p.is_finite()) {
            records.copy_within(i * self.record..(i + 1) * self.record, kept * self.record);
            kept += 1;
        }
        records.truncate(kept * self.record);
        rows.positions.len() - kept
    }

    fn unfit(&self, rows: &WrittenRows<'_>, i: usize) -> Error {
        if !rows.positions[i].is_finite() {
            return rows.without_position(i, "which LAS has no integers for");
        }
        let range = self.integers.range();
        let why = format!(
            "but with the step {} LAS holds ({}, {}, {}) to ({}, {}, {}) alone",
            self.integers.scale.x,
            range.min.x,
            range.min.y,
            range.min.z,
            range.max.x,
            range.max.y,
            range.max.z
        );
        rows.unfit(i, &why).hinting("give a larger --step, or another --origin, or write PLY")
    }
}

/// Tallies of each piece: its points, its bytes, and its points by their return.
fn pieces(all: &Summary) -> impl Iterator<Item = &[u32; TALLIES]> {
    all.lengths.as_chunks().0.iter()
}

/// Bytes of all pieces.
pub(super) fn bytes_of(all: &Summary) -> u64 {
    pieces(all).map(|piece| u64::from(piece[1])).sum()
}

/// Whether all compressed blocks but the last have the usual number of points.
pub(super) fn is_fixed(all: &Summary) -> bool {
    let count = pieces(all).count();
    pieces(all).take(count.saturating_sub(1)).all(|piece| piece[0] == BLOCK)
}

/// The table of compressed blocks.
pub(super) fn table(all: &Summary) -> Result<Vec<u8>> {
    let entry = |piece: &[u32; TALLIES]| ChunkTableEntry {
        point_count: piece[0].into(),
        byte_count: piece[1].into(),
    };
    let entries: Vec<_> = pieces(all).map(entry).collect();
    table_of(&entries, !is_fixed(all)).map_err(|e| Error::unwritable("the table of blocks", e))
}

/// Compresses records in their place.
pub(super) fn compress(laszip: &Laszip, records: &mut Vec<u8>) -> Result<()> {
    let block = laszip.compress(records);
    *records = block.map_err(|e| Error::unwritable("compressed points", e))?;
    Ok(())
}

/// Replacements in the end of a file whose first VLR, at byte `vlr`, describes the compression of the points:
/// the place of the table, which goes to byte `start`, where the points begin; and a mark that blocks differ
/// in size, if they do.
pub(super) fn laszip_patches(vlr: u64, start: u64, all: &Summary) -> Vec<(u64, Vec<u8>)> {
    let mut patches = vec![(start, (start + 8 + bytes_of(all)).to_le_bytes().to_vec())];
    if !is_fixed(all) {
        // The number stands behind compressor, coder, version and options.
        patches.push((vlr + 54 + 12, u32::MAX.to_le_bytes().to_vec()));
    }
    patches
}

/// A VLR.
pub(super) fn vlr(user: &[u8], id: u16, content: &[u8]) -> Vec<u8> {
    let mut all = vec![0; 54];
    all[2..2 + user.len()].copy_from_slice(user);
    all[18..20].copy_from_slice(&id.to_le_bytes());
    all[20..22].copy_from_slice(&(content.len() as u16).to_le_bytes());
    all.extend_from_slice(content);
    all
}

impl Form for LasForm {
    fn attributes(&self) -> usize {
        self.fields.iter().map(|field| field.from + 1).max().unwrap_or(0)
    }

    fn head(&self) -> Result<Vec<u8>> {
        let vlrs = self.vlrs();
        let are_there = [self.laszip.is_some(), !self.extra.is_empty(), !self.wkt.is_empty()];
        let count = are_there.map(u8::from).iter().sum::<u8>();
        let mut head = vec![0; self.header_len()];
        let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        // Coordinate reference systems are WKT, if there are any.
        let of_crs = if self.format >= 6 { 16 } else { 0 };
        put(6, &[of_crs | if self.has_adjusted_time { ADJUSTED_TIME } else { 0 }]);
        put(24, &[1, if self.format < 6 { 2 } else { 4 }]);
        put(26, b"OTHER");
        put(58, b"SIMOD");
        put(94, &(self.header_len() as u16).to_le_bytes());
        put(at::POINTS as usize, &(self.start() as u32).to_le_bytes());
        put(at::VLRS as usize, &u32::from(count).to_le_bytes());
        put(104, &[self.format | if self.is_compressed { 0x80 } else { 0 }]);
        put(105, &(self.record as u16).to_le_bytes());
        let (at, count) = self.count(self.vertices);
        put(at as usize, &count);
        let vector = |v: DVec3| v.to_array().map(f64::to_le_bytes);
        put(131, vector(self.integers.scale).as_flattened());
        put(at::OFFSETS as usize, vector(self.integers.offset).as_flattened());
        head.extend_from_slice(&vlrs);
        if self.is_compressed {
            // Room for the place of the table, which is not known yet.
            head.extend_from_slice(&[0; 8]);
        }
        Ok(head)
    }

    fn vertices(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, summary: &mut Summary) -> Result<()> {
        self.records(rows, to, summary)?;
        let is_kept = |p: &DVec3| !self.leaves_out || p.is_finite();
        let mut tallies = [0; TALLIES];
        tallies[0] = rows.positions.iter().filter(|p| is_kept(p)).count() as u32;
        match self.returns.map(|field| &rows.attributes[self.fields[field].from]) {
            Some(returns) => {
                for (number, _) in returns.iter().zip(rows.positions).filter(|(_, p)| is_kept(p)) {
                    if let Some(tally) = tallies[2..].get_mut((*number as usize).wrapping_sub(1)) {
                        *tally += 1;
                    }
                }
            }
            None => {
                // Points without a number of their return count as first returns.
                tallies[2] = tallies[0];
                let first = if self.format < 6 { 1 | 1 << 3 } else { 1 | 1 << 4 };
                let has_count = self.fields.iter().any(|field| field.name == "number_of_returns");
                let bits = if has_count { 1 } else { first };
                to.chunks_exact_mut(self.record).for_each(|record| record[14] |= bits);
            }
        }
        if tallies[0] < rows.positions.len() as u32 {
            self.left_out.fetch_add(self.leave_out(rows, to) as u64, Ordering::Relaxed);
        }
        if to.is_empty() {
            return Ok(());
        }
        if let Some((laszip, _)) = &self.laszip {
            compress(laszip, to)?;
        }
        tallies[1] = to.len() as u32;
        summary.lengths.extend_from_slice(&tallies);
        Ok(())
    }

    fn tail(&self, all: &Summary) -> Result<Vec<u8>> {
        if self.is_compressed { table(all) } else { Ok(Vec::new()) }
    }

    fn patches(&self, all: &Summary) -> Result<Vec<(u64, Vec<u8>)>> {
        let mut patches = Vec::new();
        // Points may have been left out.
        let points: u64 = pieces(all).map(|piece| u64::from(piece[0])).sum();
        patches.push(self.count(points));
        let mut returns = [0u64; TALLIES - 2];
        for piece in pieces(all) {
            returns.iter_mut().zip(&piece[2..]).for_each(|(sum, n)| *sum += u64::from(*n));
        }
        if !all.after.is_empty() {
            let corners = [all.after.min, all.after.max];
            let Bounds { min, max } = Bounds::from_points(
                corners.map(|numbers| numbers * self.integers.scale + self.integers.offset),
            );
            let sides = (0..3).flat_map(|axis| [max[axis], min[axis]]).flat_map(f64::to_le_bytes);
            patches.push((at::BOUNDS, sides.collect()));
        }
        if self.format < 6 {
            let five = returns[..5].iter().flat_map(|n| (*n as u32).to_le_bytes());
            patches.push((111, five.collect()));
        } else {
            patches.push((255, returns.iter().flat_map(|n| n.to_le_bytes()).collect()));
        }
        if self.is_compressed {
            patches.extend(laszip_patches(self.header_len() as u64, self.start(), all));
        }
        Ok(patches)
    }

    fn left_out(&self) -> u64 {
        self.left_out.load(Ordering::Relaxed)
    }

    fn integers(&self) -> Option<ScaledIntegers> {
        Some(self.integers)
    }

    fn rounding(&self, content: &ConversionInput<'_>) -> Result<Option<Rounding>> {
        if content.info().integers == Some(self.integers) {
            return Ok(None);
        }
        let stays = |p| is_on_grid(p, &self.integers);
        let step = |_: &Bounds| self.integers.scale.abs().max_element();
        let rounding = Rounding::of_model(content.model, stays, step)?;
        Ok(rounding.map(|rounding| Rounding { is_asked: content.how.step.is_some(), ..rounding }))
    }

    fn bytes(&self) -> u64 {
        let all = self.start() + self.vertices * self.record as u64;
        if self.is_compressed { all / 3 } else { all }
    }
}

/// Whether a position is one that integers have, up to the rounding of double precision.
fn is_on_grid(p: DVec3, integers: &ScaledIntegers) -> bool {
    // A position without integers is another error, which is reported elsewhere.
    integers.nearest(p).is_none_or(|numbers| {
        let near = 4.0 * f64::EPSILON * p.abs().max(integers.offset.abs());
        (integers.position(numbers) - p).abs().cmple(near).all()
    })
}

/// The integers that positions become.
fn integers(content: &ConversionInput<'_>) -> Result<ScaledIntegers> {
    let how = &content.how;
    let info = content.info();
    if let Some(integers) = content.integers {
        return Ok(integers);
    }
    if let (Some(integers), None, None) = (info.integers, how.step, how.offset) {
        return Ok(integers);
    }
    let wrong = |what: &str, hint: &str| Err(Error::argument(what, hint));
    if how.step.is_some_and(|step| !(step.is_finite() && step > 0.0)) {
        return wrong("the step between positions is not above 0", "give a positive length");
    }
    if how.offset.is_some_and(|offset| !offset.is_finite()) {
        return wrong("the origin of positions is not finite", "give three numbers");
    }
    let mut bounds = Bounds::default();
    if how.step.is_none() || how.offset.is_none() {
        for_positions(content.model, |chunk: &VertexChunk| {
            for p in chunk.positions.iter().filter(|p| p.is_finite()) {
                (bounds.min, bounds.max) = (bounds.min.min(*p), bounds.max.max(*p));
            }
            Ok(())
        })?;
    }
    if bounds.is_empty() {
        bounds = Bounds { min: DVec3::ZERO, max: DVec3::ZERO };
    }
    let step = how.step.unwrap_or_else(|| {
        // The range has room for motions as far as the model is large.
        let extent = (bounds.max - bounds.min).max_element().max(f64::MIN_POSITIVE);
        let power = (4.0 * extent / f64::from(i32::MAX)).log10().ceil() as i32;
        10f64.powi(power)
    });
    let offset = how.offset.unwrap_or_else(|| {
        // The offset gets few digits.
        let unit = step * 1e6;
        (0.5 * (bounds.min + bounds.max) / unit).round() * unit
    });
    Ok(ScaledIntegers { scale: DVec3::splat(step), offset })
}

/// Factor by which the model's colours become colours of 16 bits.
fn full_light(content: &ConversionInput<'_>, colors: &Colors) -> Result<f64> {
    match colors.kind {
        Type::U8 => return Ok(257.0),
        Type::U16 => return Ok(1.0),
        _ => {}
    }
    Ok(MOST_LIGHT / ColorScale::of_model(content.model, colors)?.full())
}
