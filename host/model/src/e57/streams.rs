//! Numbers of consecutive points of a scan, gathered from its packets.

use std::ops::Range;

use super::fields::{E57Field, PackedNumbers};
use super::packets::{PacketWalk, Packets};
use super::scan::Scan;
use crate::Result;

/// Numbers of some fields for some points.
///
/// Memory: as many bytes as they take in the file.
#[derive(Debug, Default)]
pub(super) struct Streams {
    /// The points.
    pub points: Range<u64>,
    /// Packed numbers of each field that was read; none for other fields.
    pub packed: Vec<Option<PackedNumbers>>,
}

impl Streams {
    /// Reads the numbers of some fields of the points.
    pub fn read(
        &mut self,
        mut walk: PacketWalk<'_, '_>,
        scan: &Scan,
        points: Range<u64>,
        fields: &[usize],
    ) -> Result<()> {
        let Scan { described, packets, .. } = scan;
        let of = &described.fields;
        let count = points.end - points.start;
        self.packed.resize_with(of.len(), Option::default);
        self.packed.truncate(of.len());
        let mut is_wanted = vec![false; of.len()];
        fields.iter().for_each(|field| is_wanted[*field] = true);
        for ((field, packed), is_wanted) in of.iter().zip(&mut self.packed).zip(is_wanted) {
            if is_wanted {
                packed.get_or_insert_default().begin(field.bits(), points.start, count);
            } else {
                *packed = None;
            }
        }
        self.points = points;
        let wanted: Vec<Range<u64>> = of.iter().map(|field| self.range(field)).collect();
        let is_before = |_, before: &[u64]| fields.iter().all(|field| before[*field] <= wanted[*field].start);
        let Some(mut place) = packets.last_place(is_before) else { return Ok(()) };
        let end = packets.section.end;
        let mut parts = Vec::new();
        while fields.iter().any(|field| place.before[*field] < wanted[*field].end) {
            parts.clear();
            if !walk.next(&mut place, end, |part| parts.push(part))? {
                break;
            }
            for part in &parts {
                let wanted = &wanted[part.stream];
                let (start, end) =
                    (part.of_stream.start.max(wanted.start), part.of_stream.end.min(wanted.end));
                let Some(Some(packed)) = self.packed.get_mut(part.stream) else { continue };
                if start < end {
                    let at = part.at + (start - part.of_stream.start);
                    let bytes = walk.window.get(at..at + (end - start))?;
                    let to = (start - wanted.start) as usize;
                    packed.bytes_mut()[to..to + bytes.len()].copy_from_slice(bytes);
                }
            }
        }
        Ok(())
    }

    fn range(&self, field: &E57Field) -> Range<u64> {
        PackedNumbers::range(field.bits(), self.points.start, self.points.end - self.points.start)
    }

    /// The bits of a field of a point, which counts from the first point here.
    #[inline]
    pub fn get(&self, field: usize, index: usize) -> u64 {
        self.packed.get(field).and_then(Option::as_ref).map_or(0, |packed| packed.get(index))
    }

    /// Appends the rows of some of the points, which are here.
    pub fn rows(&self, fields: &[usize], points: Range<u64>, to: &mut Vec<u64>) {
        let first = (points.start - self.points.start) as usize;
        let count = (points.end - points.start) as usize;
        let start = to.len();
        to.resize(start + count * fields.len(), 0);
        for (i, field) in fields.iter().enumerate() {
            let Some(Some(packed)) = self.packed.get(*field) else { continue };
            let numbers = to[start..].iter_mut().skip(i).step_by(fields.len());
            numbers.enumerate().for_each(|(index, number)| *number = packed.get(first + index));
        }
    }
}

impl Packets {
    /// Number of bytes of each stream before a logical byte of the file, by a walk from the last known place
    /// before it.
    pub fn before(&self, walk: &mut PacketWalk<'_, '_>, byte: u64) -> Result<Vec<u64>> {
        let Some(mut place) = self.last_place(|at, _| at <= byte) else { return Ok(Vec::new()) };
        let mut before = place.before.clone();
        while place.at < byte && place.at < self.end {
            walk.next(&mut place, self.section.end, |part| {
                let bytes = part.of_stream.end - part.of_stream.start;
                before[part.stream] += bytes.min(byte.saturating_sub(part.at));
            })?;
        }
        Ok(before)
    }
}
