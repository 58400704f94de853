//! The variable length records of a LAS file, before the points (VLRs) and after them (EVLRs): found, and
//! those that matter here looked at.

use std::ops::Range;

use super::header::{CUT_OFF, DAMAGED, LasHeader, bytes_at};
use crate::Result;
use crate::source::SourceFile;

/// Most bytes that are looked at of a record that names a coordinate reference system.
const MOST_OF_CRS: u64 = 1 << 20;

/// What a record belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum VlrKind {
    /// How the points are compressed.
    Laszip,
    /// The octree of COPC, and what COPC says of it.
    Copc,
    /// What extra bytes are.
    ExtraBytes,
    /// The coordinate reference system as text.
    Wkt,
    /// The coordinate reference system as numbers, and the texts that these name.
    GeoKeys,
    GeoTexts,
}

/// A record that matters here.
#[derive(Debug, Clone)]
pub(super) struct KeptVlr {
    pub kind: VlrKind,
    /// All of its bytes in the file, with its own header.
    pub all: Range<u64>,
    /// The bytes of its content.
    pub content: Range<u64>,
    /// Whether it is an EVLR.
    pub is_extended: bool,
}

/// The records of a file that matter here, in its order.
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

    /// Reads the header of the record at a place; where it ends, if that is not beyond `end`.
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

    /// What belongs to the octree of COPC.
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

    /// The unit of lengths of the coordinate reference system, as far as the file says one: of the plane and
    /// of heights, if these differ.
    pub fn unit(&self, source: &SourceFile) -> Result<Option<String>> {
        if let Some(wkt) = self.content(source, VlrKind::Wkt, MOST_OF_CRS)? {
            let units = units_of_wkt(&String::from_utf8_lossy(&wkt));
            return Ok((!units.is_empty()).then(|| units.join(", ")));
        }
        let keys = self.content(source, VlrKind::GeoKeys, MOST_OF_CRS)?.unwrap_or_default();
        let keys =
            keys.chunks_exact(8).skip(1).map(|key| [0, 2, 6].map(|at| u16::from_le_bytes(bytes_at(key, at))));
        let mut units: Vec<String> = Vec::new();
        for [key, place, code] in keys {
            let unit = match code {
                9001 => "metre".to_owned(),
                9002 => "foot".to_owned(),
                9003 => "US survey foot".to_owned(),
                _ => format!("EPSG:{code}"),
            };
            let is_told = matches!(key, 3076 | 4099) && place == 0 && !matches!(code, 0 | 32767);
            if is_told && units.len() < MOST_UNITS && !units.contains(&unit) {
                units.push(unit);
            }
        }
        Ok((!units.is_empty()).then(|| units.join(", ")))
    }

    /// The name of the coordinate reference system, as far as the file has one.
    pub fn crs(&self, source: &SourceFile) -> Result<Option<String>> {
        if let Some(wkt) = self.content(source, VlrKind::Wkt, MOST_OF_CRS)? {
            let wkt = String::from_utf8_lossy(&wkt);
            let name = wkt.split('"').nth(1).map(str::trim);
            if let Some(name) = name.filter(|name| !name.is_empty()) {
                return Ok(Some(name.chars().filter(|c| !c.is_control()).take(200).collect()));
            }
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
        if let Some(code) = found.filter(|code| *code != 0 && *code != 32767) {
            return Ok(Some(format!("EPSG:{code}")));
        }
        // Then it may have a name: the projected system, all of it, or the geographic one.
        let texts = self.content(source, VlrKind::GeoTexts, MOST_OF_CRS)?.unwrap_or_default();
        let named = |[.., count, at]: &[u16; 4]| {
            let text = texts.get(usize::from(*at)..)?;
            let text = String::from_utf8_lossy(&text[..text.len().min(usize::from(*count))]).into_owned();
            let text = text.split(['|', '\0']).next().unwrap_or_default().trim();
            let text: String = text.chars().filter(|c| !c.is_control()).take(200).collect();
            (!text.is_empty()).then_some(text)
        };
        Ok([3073, 1026, 2049].into_iter().find_map(|key| value(key, 34737).and_then(named)))
    }
}

/// Units that are told: there is one of the plane, and one of heights.
const MOST_UNITS: usize = 4;

/// Names of the units of lengths in a system in WKT, none twice.
fn units_of_wkt(wkt: &str) -> Vec<String> {
    // In WKT 2, ellipsoids and parameters have units of their own, before those of the axes.
    let (wkt, keyword) = match wkt.find("CS[Cartesian") {
        Some(at) => (&wkt[at..], "LENGTHUNIT[\""),
        None => (wkt, "UNIT[\""),
    };
    let is_angle = |name: &str| ["deg", "grad", "gon", "rad"].iter().any(|angle| name.contains(angle));
    let mut units: Vec<String> = Vec::new();
    for (at, _) in wkt.match_indices(keyword) {
        if units.len() == MOST_UNITS {
            break;
        }
        let name = wkt[at + keyword.len()..].split('"').next().unwrap_or_default().trim();
        let name: String = name.chars().filter(|c| !c.is_control()).take(100).collect();
        let is_other = wkt[..at].ends_with(|before: char| before.is_alphabetic());
        if !is_other && !name.is_empty() && !is_angle(&name.to_lowercase()) && !units.contains(&name) {
            units.push(name);
        }
    }
    units
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_those_of_lengths() {
        let plane = r#"PROJCS["A",GEOGCS["B",UNIT["degree",0.017]],UNIT["US survey foot",0.3048]]"#;
        assert_eq!(units_of_wkt(plane), ["US survey foot"]);
        let both = format!(r#"COMPD_CS["C",{plane},VERT_CS["D",UNIT["metre",1]]]"#);
        assert_eq!(units_of_wkt(&both), ["US survey foot", "metre"]);
        let second =
            r#"PROJCRS["E",ELLIPSOID["F",1,2,LENGTHUNIT["metre",1]],CS[Cartesian,2],LENGTHUNIT["foot",0.3]]"#;
        assert_eq!(units_of_wkt(second), ["foot"]);
        assert!(
            units_of_wkt("GEOGCS[\"B\",UNIT[\"Degree\",0.017]").is_empty() && units_of_wkt("").is_empty()
        );
    }
}
