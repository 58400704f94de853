//! End of an E57 file, which is known when all points are: its XML, with the new limits of the coordinates,
//! and the place of the XML.
//!
//! XML that is the last thing in the file, as it usually is, is replaced where it was; other XML that changes
//! is put behind all. The page on which the XML begins may have points as well, and that of the header too:
//! both are patched, and their checksums follow.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::ops::Range;

use super::description::LimitSlot;
use super::fields::NumberEncoding;
use super::file::E57Model;
use super::header::at;
use super::pages::{PAGE, PAYLOAD, append_pages, checksum_after, pages_of, physical};
use super::scan::{Scan, ScanReach, corner_of};
use crate::{Result, Summary};

/// Bytes that replace others of a page: where, the old and the new ones.
type Replaced = Vec<(usize, Vec<u8>, Vec<u8>)>;

impl E57Model {
    /// Whether nothing follows the XML in the file.
    fn xml_is_last(&self) -> bool {
        let end = self.source.len() / PAGE;
        pages_of(&self.header.xml).end == end
            && self.scans.iter().all(|s| s.packets.section.start < self.header.xml.start)
    }

    /// The bytes of the file in whose place others are made: the pages of the XML, but the first one; or else
    /// none, behind all.
    pub(super) fn ending(&self) -> Range<u64> {
        let len = self.source.len();
        let start = if self.xml_is_last() { (self.header.xml.start / PAYLOAD + 1) * PAGE } else { len };
        start.min(len)..len
    }

    /// The bytes in the place of the ending.
    pub(super) fn make_ending(&self, all: &Summary) -> Result<Vec<u8>> {
        let ending = self.ending();
        let Some(xml) = self.new_xml(all) else {
            let mut same = Vec::new();
            self.source.append_at(&mut same, ending.start, (ending.end - ending.start) as usize)?;
            return Ok(same);
        };
        // XML of another length is filled up to the end of its page; XML of the same length keeps the bytes
        // behind it.
        let mut payload = xml.into_bytes();
        if self.xml_is_last() {
            let on_first_page = (PAYLOAD - self.header.xml.start % PAYLOAD) as usize;
            if payload.len() as u64 == self.header.xml.end - self.header.xml.start {
                let (end, mut rest) = (self.header.xml.end, Vec::new());
                let of_page = end.next_multiple_of(PAYLOAD) - end;
                self.source.append_at(&mut rest, physical(end), of_page as usize)?;
                payload.extend_from_slice(&rest);
            }
            payload.drain(..on_first_page.min(payload.len()));
        }
        payload.resize(payload.len().next_multiple_of(PAYLOAD as usize), 0);
        let mut bytes = Vec::new();
        append_pages(&payload, &mut bytes, |_, _| {});
        Ok(bytes)
    }

    /// Replacements in the header, and in the page on which the XML begins.
    pub(super) fn patches_in_the_end(&self, all: &Summary) -> Result<Vec<(u64, Vec<u8>)>> {
        let Some(xml) = self.new_xml(all) else { return Ok(Vec::new()) };
        let old = self.header.xml.clone();
        let ending = self.ending();
        let mut pages: BTreeMap<u64, Replaced> = BTreeMap::new();
        let mut header = |at: u64, old: u64, new: u64| {
            if old != new {
                let both = (at as usize, old.to_le_bytes().to_vec(), new.to_le_bytes().to_vec());
                pages.entry(0).or_default().push(both);
            }
        };
        header(at::XML_LENGTH, old.end - old.start, xml.len() as u64);
        let mut on_new_pages = xml.len() as u64;
        if !self.xml_is_last() {
            header(at::XML_PLACE, physical(old.start), ending.start);
        } else {
            on_new_pages = on_new_pages.saturating_sub(PAYLOAD - old.start % PAYLOAD);
        }
        let len = ending.start + on_new_pages.div_ceil(PAYLOAD) * PAGE;
        header(at::FILE_LENGTH, self.source.len(), len);
        if self.xml_is_last() {
            let within = (old.start % PAYLOAD) as usize;
            let room = PAYLOAD as usize - within;
            let mut there = Vec::new();
            self.source.append_at(&mut there, physical(old.start), room)?;
            let mut new = there.clone();
            new.iter_mut().zip(xml.bytes()).for_each(|(byte, new)| *byte = new);
            pages.entry(old.start / PAYLOAD).or_default().push((within, there, new));
        }
        let mut patches = Vec::new();
        for (page, replaced) in pages {
            let start = page * PAGE;
            let written = match all.checksums.get(&page) {
                Some(checksum) => *checksum,
                None => {
                    let mut copied = [0; 4];
                    self.source.read_at(&mut copied, start + PAYLOAD)?;
                    u32::from_be_bytes(copied)
                }
            };
            let differences = replaced.iter().map(|(at, old, new)| (*at, &old[..], &new[..]));
            let checksum = checksum_after(written, differences);
            patches.extend(replaced.into_iter().map(|(at, _, new)| (start + at as u64, new)));
            patches.push((start + PAYLOAD, checksum.to_be_bytes().to_vec()));
        }
        Ok(patches)
    }

    /// The XML with other numbers, if any are others; never shorter.
    fn new_xml(&self, all: &Summary) -> Option<String> {
        let mut replaced = Vec::new();
        for (number, scan) in (0..).zip(&self.scans) {
            let boxes = |kind: u32| all.boxes.get(&(2 * number + kind)).copied().unwrap_or_default();
            let both = [boxes(0), boxes(1)];
            let (before, after): (ScanReach, ScanReach) = (both.map(|b| b[0]), both.map(|b| b[1]));
            for slot in &scan.described.slots {
                let around = |new: String| format!("{}{new}{}", slot.around.0, slot.around.1);
                let new = new_number(scan, slot, &before, &after).map(around);
                replaced.extend(new.map(|new| (slot.text.clone(), new)));
            }
            for (field, range) in scan.other_ranges() {
                let limits = scan.described.limits[field].iter().zip(range);
                replaced.extend(limits.filter_map(|(text, new)| Some((text.clone()?, new.to_string()))));
            }
        }
        if replaced.is_empty() {
            return None;
        }
        replaced.sort_by_key(|(text, _)| text.start);
        let (mut xml, mut at) = (String::new(), 0);
        for (text, new) in replaced {
            xml += self.xml.get(at..text.start).unwrap_or_default();
            xml += &new;
            at = text.end;
        }
        xml += self.xml.get(at..).unwrap_or_default();
        xml.extend(std::iter::repeat_n('\n', self.xml.len().saturating_sub(xml.len())));
        Some(xml)
    }
}

/// New text of a number that the XML has, if the points that the number is a limit of reach elsewhere now.
fn new_number(scan: &Scan, slot: &LimitSlot, before: &ScanReach, after: &ScanReach) -> Option<String> {
    let corner = slot.corner;
    let (was, is) = (corner_of(before, corner), corner_of(after, corner));
    let grows = if corner.is_max { is > was } else { is < was };
    let exceeds = if corner.is_max { is > slot.value } else { is < slot.value };
    if !is.is_finite() || was == is || (slot.is_limit && !(grows && exceeds)) {
        return None;
    }
    // From one azimuth up to a smaller one, by way of a half turn: all around is right in any case.
    let other = |other: &&LimitSlot| {
        !other.is_limit && other.corner == super::description::Corner { is_max: !corner.is_max, ..corner }
    };
    let wraps =
        |other: &LimitSlot| if corner.is_max { slot.value < other.value } else { slot.value > other.value };
    let is_around = corner.is_spherical
        && corner.axis == 1
        && !slot.is_limit
        && scan.described.slots.iter().find(other).is_some_and(wraps);
    let new = match (is_around, corner.is_max) {
        (false, _) => is,
        (true, false) => -PI,
        (true, true) => PI,
    };
    Some(padded(written(slot.kind, new, corner.is_max), slot.text.len()))
}

/// A number as text: where the type cannot have it, the next one further out.
fn written(kind: NumberEncoding, number: f64, is_max: bool) -> String {
    match kind {
        NumberEncoding::Integer { scale, offset, .. } => {
            let steps = (number - offset) / scale;
            let up = is_max == (scale > 0.0);
            format!("{}", (if up { steps.ceil() } else { steps.floor() }) as i64)
        }
        NumberEncoding::Single => {
            let single = number as f32;
            let is_inside = if is_max { f64::from(single) < number } else { f64::from(single) > number };
            let outer = if is_max { single.next_up() } else { single.next_down() };
            format!("{:?}", if is_inside { outer } else { single })
        }
        NumberEncoding::Double | NumberEncoding::Other => format!("{number:?}"),
    }
}

/// Number in so many characters, if it has fewer: with zeros behind its decimals.
fn padded(number: String, length: usize) -> String {
    let missing = length.saturating_sub(number.len());
    let Some(point) = number.find('.') else { return number };
    let end = number[point..].find('e').map_or(number.len(), |e| point + e);
    format!("{}{}{}", &number[..end], "0".repeat(missing), &number[end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_value_and_get_their_length() {
        for (number, length, text) in [
            (1.5, 8, "1.500000"),
            (-0.25, 3, "-0.25"),
            (1e-7, 6, "1e-7"),
            (1.25e-7, 10, "1.250000e-7"),
            (7.0, 1, "7.0"),
        ] {
            let new = padded(written(NumberEncoding::Double, number, true), length);
            assert_eq!(new.parse::<f64>(), Ok(number));
            assert!(new.len() >= length.min(text.len()) && (new == text || text.contains('e')), "{new}");
        }
        let single = written(NumberEncoding::Single, 0.1, true).parse::<f32>().unwrap();
        assert!(f64::from(single) >= 0.1);
        let single = written(NumberEncoding::Single, 0.3, false).parse::<f32>().unwrap();
        assert!(f64::from(single) <= 0.3);
        let kind = NumberEncoding::Integer { min: 0, max: 9, scale: 0.5, offset: 1.0 };
        assert_eq!([true, false].map(|is_max| written(kind, 2.7, is_max)), ["4", "3"]);
    }
}
