//! The variable length records of a LAS file, before the points (VLRs) and after them (EVLRs): found, and
//! those that matter here looked at.

use std::ops::Range;

use super::header::{CUT_OFF, DAMAGED, LasHeader, bytes_at};
use crate::source::SourceFile;
use crate::{Result, wkt};

/// Most bytes that are read of a record that names a coordinate reference system.
const MOST_OF_CRS: u64 = 1 << 20;

/// The record of numbers that GeoKeys name.
const GEO_NUMBERS: u16 = 34736;

/// Value of a GeoKey for a system or unit that has no code.
const OWN: u16 = 32767;

/// Kinds of systems in GeoKeys.
const GEOGRAPHIC: u16 = 2;
const GEOCENTRIC: u16 = 3;

/// Purpose of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum VlrKind {
    /// The compression of the points.
    Laszip,
    /// The octree of COPC, and COPC's info on it.
    Copc,
    /// The description of extra bytes.
    ExtraBytes,
    /// The coordinate reference system as text.
    Wkt,
    /// The coordinate reference system as numbers, and (the next two) the numbers and texts that these refer
    /// to.
    GeoKeys,
    GeoNumbers,
    GeoTexts,
}

/// A record that matters here.
#[derive(Debug, Clone)]
pub(super) struct KeptVlr {
    pub kind: VlrKind,
    /// Bytes of the record in the file, with its header.
    pub all: Range<u64>,
    /// Bytes of the record's content in the file.
    pub content: Range<u64>,
    /// Whether the record is an EVLR.
    pub is_extended: bool,
}

/// Records of a file that are used, in the order of the file.
#[derive(Debug, Clone, Default)]
pub(super) struct KeptVlrs {
    records: Vec<KeptVlr>,
}

impl KeptVlrs {
    pub fn read(source: &SourceFile, header: &LasHeader) -> Result<Self> {
        let mut this = Self::default();
        let mut at = header.len;
        for number in 0..header.vlrs {
            at = this.read_one(source, at, header.points, false)?.ok_or_else(|| {
                let what = format!(
                    "VLR {number} of {} at byte {at} goes on where the points begin, at byte {}",
                    header.vlrs, header.points
                );
                source.malformed(what, DAMAGED)
            })?;
        }
        if let Some((start, count)) = header.evlrs {
            at = start;
            for number in 0..count {
                at = this.read_one(source, at, source.len(), true)?.ok_or_else(|| {
                    let what = format!(
                        "EVLR {number} of {count} at byte {at} goes on beyond the {} bytes of the file",
                        source.len()
                    );
                    source.malformed(what, CUT_OFF)
                })?;
            }
        }
        Ok(this)
    }

    /// Reads the header of the record at a byte; returns the byte at which the record ends, if that is not
    /// beyond `end`.
    fn read_one(&mut self, source: &SourceFile, at: u64, end: u64, is_extended: bool) -> Result<Option<u64>> {
        let mut bytes = [0; 60];
        let bytes = &mut bytes[..if is_extended { 60 } else { 54 }];
        if at.checked_add(bytes.len() as u64).is_none_or(|behind| behind > end) {
            return Ok(None);
        }
        source.read_at(bytes, at)?;
        let length = if is_extended {
            u64::from_le_bytes(bytes_at(bytes, 20))
        } else {
            u64::from(u16::from_le_bytes(bytes_at(bytes, 20)))
        };
        let content = at + bytes.len() as u64;
        let Some(behind) = content.checked_add(length).filter(|behind| *behind <= end) else {
            return Ok(None);
        };
        let user = bytes[2..18].split(|byte| *byte == 0).next().unwrap_or_default();
        let kind = match (user, u16::from_le_bytes(bytes_at(bytes, 18))) {
            (b"laszip encoded", 22204) => VlrKind::Laszip,
            (b"copc", _) => VlrKind::Copc,
            (b"LASF_Spec", 4) => VlrKind::ExtraBytes,
            (b"LASF_Projection", 2112) => VlrKind::Wkt,
            (b"LASF_Projection", 34735) => VlrKind::GeoKeys,
            (b"LASF_Projection", GEO_NUMBERS) => VlrKind::GeoNumbers,
            (b"LASF_Projection", 34737) => VlrKind::GeoTexts,
            _ => return Ok(Some(behind)),
        };
        // One of each, and those of COPC, all of which go: a file of many such records is no reason to hold
        // them.
        if kind == VlrKind::Copc || self.find(kind).is_none() {
            self.records.push(KeptVlr { kind, all: at..behind, content: content..behind, is_extended });
        }
        Ok(Some(behind))
    }

    pub fn find(&self, kind: VlrKind) -> Option<&KeptVlr> {
        self.records.iter().find(|record| record.kind == kind)
    }

    /// Records that belong to the octree of COPC.
    pub fn of_copc(&self) -> impl Iterator<Item = &KeptVlr> {
        self.records.iter().filter(|record| record.kind == VlrKind::Copc)
    }

    /// The content of a record, but no more than so many bytes.
    pub fn content(&self, source: &SourceFile, kind: VlrKind, most: u64) -> Result<Option<Vec<u8>>> {
        let Some(KeptVlr { content, .. }) = self.find(kind) else { return Ok(None) };
        let mut bytes = Vec::new();
        source.append_at(&mut bytes, content.start, (content.end - content.start).min(most) as usize)?;
        Ok(Some(bytes))
    }

    /// The coordinate reference system as text, in one line, if the file has it so.
    pub fn wkt(&self, source: &SourceFile) -> Result<Option<String>> {
        let text = self.content(source, VlrKind::Wkt, MOST_OF_CRS)?;
        Ok(text.and_then(|text| wkt::in_one_line(&String::from_utf8_lossy(&text))))
    }

    /// The unit of positions by the coordinate reference system, as far as the file says one: of the plane
    /// and of heights, if these differ.
    pub fn unit(&self, source: &SourceFile) -> Result<Option<String>> {
        let mut units = self.wkt(source)?.map_or(Vec::new(), |text| wkt::units(&text));
        if units.is_empty() {
            units = self.unit_of_keys(source)?;
        }
        Ok((!units.is_empty()).then(|| units.join(", ")))
    }

    /// The unit that GeoKeys tell: in the plane, or on the ellipsoid, and of heights.
    fn unit_of_keys(&self, source: &SourceFile) -> Result<Vec<String>> {
        let keys = self.content(source, VlrKind::GeoKeys, MOST_OF_CRS)?.unwrap_or_default();
        let keys: Vec<[u16; 4]> = keys
            .chunks_exact(8)
            .skip(1)
            .map(|key| [0, 2, 4, 6].map(|at| u16::from_le_bytes(bytes_at(key, at))))
            .collect();
        let found = |wanted: u16, at: u16| {
            let found = keys.iter().find(|[key, place, ..]| (*key, *place) == (wanted, at));
            found.map(|[.., value]| *value)
        };
        let value = |wanted: u16, at: u16| found(wanted, at).filter(|value| *value != 0);
        let numbers = self.content(source, VlrKind::GeoNumbers, MOST_OF_CRS)?.unwrap_or_default();
        // A unit that has no code has its size, in metres.
        let own = |size: u16| {
            let at = 8 * usize::from(found(size, GEO_NUMBERS)?);
            let metres = f64::from_le_bytes(numbers.get(at..at + 8)?.try_into().ok()?);
            metres.is_finite().then(|| format!("{metres} metres"))
        };
        let unit = |key: u16, size: u16| match value(key, 0)? {
            OWN => own(size),
            9001 => Some("metre".to_owned()),
            9002 => Some("foot".to_owned()),
            9003 => Some("US survey foot".to_owned()),
            9101 => Some("radian".to_owned()),
            9102 | 9122 => Some("degree".to_owned()),
            9105 | 9106 => Some("grad".to_owned()),
            code => Some(format!("EPSG:{code}")),
        };
        // Some systems are in one unit by their code: WGS 84, ETRS89, NAD83 and NAD27, and WGS 84 geocentric.
        let of_earth = || match value(2048, 0)? {
            4326 | 4258 | 4269 | 4267 => Some("degree".to_owned()),
            4978 => Some("metre".to_owned()),
            _ => None,
        };
        let plane = match value(1024, 0) {
            Some(GEOGRAPHIC) => unit(2054, 2055).or_else(of_earth),
            Some(GEOCENTRIC) => unit(2052, 2053).or_else(of_earth),
            _ if value(3072, 0).is_some() || value(3076, 0).is_some() => unit(3076, 3077),
            _ => unit(2054, 2055).or_else(of_earth),
        };
        let mut units: Vec<String> = plane.into_iter().chain(unit(4099, 0)).collect();
        units.dedup();
        Ok(units)
    }

    /// The name of the coordinate reference system, as far as the file has one.
    pub fn crs(&self, source: &SourceFile) -> Result<Option<String>> {
        if let Some(name) = self.wkt(source)?.and_then(|text| wkt::name(&text)) {
            return Ok(Some(name));
        }
        let keys = self.content(source, VlrKind::GeoKeys, MOST_OF_CRS)?.unwrap_or_default();
        // Four numbers first, then key, place, count and value for each key.
        let keys = keys.chunks_exact(8).skip(1);
        let keys: Vec<[u16; 4]> =
            keys.map(|key| [0, 2, 4, 6].map(|at| u16::from_le_bytes(bytes_at(key, at)))).collect();
        // The projected system, or else the geographic one; 32767 says that it has no code.
        let value =
            |wanted: u16, at: u16| keys.iter().find(|[key, place, ..]| (*key, *place) == (wanted, at));
        let found = value(3072, 0).or(value(2048, 0)).map(|[.., code]| *code);
        if let Some(code) = found.filter(|code| *code != 0 && *code != OWN) {
            return Ok(Some(format!("EPSG:{code}")));
        }
        // A system without a code may have a name: the projected system, all of it, or the geographic one.
        let texts = self.content(source, VlrKind::GeoTexts, MOST_OF_CRS)?.unwrap_or_default();
        let named = |[.., count, at]: &[u16; 4]| {
            let text = texts.get(usize::from(*at)..)?;
            let text = String::from_utf8_lossy(&text[..text.len().min(usize::from(*count))]).into_owned();
            let text = text.split(['|', '\0']).next().unwrap_or_default().trim();
            wkt::short(text)
        };
        Ok([3073, 1026, 2049].into_iter().find_map(|key| value(key, 34737).and_then(named)))
    }
}
