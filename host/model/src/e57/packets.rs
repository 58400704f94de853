//! Packets of a scan: a section of the file in which each packet has the next bytes of every field's stream.

use std::ops::Range;

use super::fields::{E57Field, PackedNumbers};
use super::header::bytes_at;
use super::pages::{DAMAGED, PageWindow, logical};
use crate::Result;
use crate::source::SourceFile;

/// Bytes of the head of a section.
const HEAD: u64 = 32;

/// Most numbers by which one stream of a scan may be ahead of another where a packet ends: a bound of what
/// has to be read to have all numbers of some points.
const MOST_APART: u64 = 1 << 18;

/// Numbers in the tables of all scans, so 8 MiB; but a scan has a few rows at least.
const ROOM: usize = 1 << 20;
const LEAST_ROWS: usize = 4;

/// Start of a packet, and the number of bytes of each stream before it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PacketStart {
    /// The logical byte at which the packet begins.
    pub at: u64,
    /// Bytes of each stream.
    pub before: Vec<u64>,
}

/// The packets of a scan.
///
/// Memory: of the places of packets, all as long as there is room, and then every second, fourth and so on.
#[derive(Debug)]
pub(super) struct Packets {
    /// The logical bytes of the section.
    pub section: Range<u64>,
    /// Logical byte of the file at which all streams are complete, and the walk is over.
    pub end: u64,
    streams: usize,
    /// Starts of the packets that are kept: the byte of each, and the numbers of bytes of each stream before
    /// it, side by side.
    table: Vec<u64>,
    /// Number of packets from one start that is kept to the next.
    stride: usize,
}

/// A packet's part of a stream.
pub(super) struct PacketStream {
    pub stream: usize,
    /// The bytes of the stream.
    pub of_stream: Range<u64>,
    /// Logical byte of the file at which the bytes of the stream begin.
    pub at: u64,
}

/// File, window and scan of a walk through packets.
pub(super) struct PacketWalk<'a, 'w> {
    pub source: &'a SourceFile,
    pub window: &'a mut PageWindow<'w>,
    /// The scan's name.
    pub name: &'a str,
}

impl Packets {
    /// The packets of no points.
    pub fn none() -> Self {
        Self { section: 0..0, end: 0, streams: 0, table: Vec::new(), stride: 1 }
    }

    /// Goes over the packets' heads once; `scans` share the room for tables.
    pub fn find(
        mut walk: PacketWalk<'_, '_>,
        (place, count): (u64, u64),
        fields: &[E57Field],
        scans: usize,
    ) -> Result<Self> {
        let (section, first) = walk.section(place)?;
        let row = fields.len() + 1;
        let most_rows = (ROOM / scans.max(1) / row).max(LEAST_ROWS);
        let mut this = Self { section, end: 0, streams: fields.len(), table: Vec::new(), stride: 1 };
        let needed: Vec<u64> = fields.iter().map(|f| PackedNumbers::range(f.bits(), 0, count).end).collect();
        let mut now = PacketStart { at: first, before: vec![0; fields.len()] };
        let mut packet = 0;
        while now.before.iter().zip(&needed).any(|(there, needed)| there < needed) {
            if packet % this.stride == 0 {
                if this.table.len() == most_rows * row {
                    this.thin_out();
                }
                if packet % this.stride == 0 {
                    this.table.push(now.at);
                    this.table.extend_from_slice(&now.before);
                }
            }
            packet += 1;
            if !walk.next(&mut now, this.section.end, |_| {})? {
                let missing = now.before.iter().zip(&needed).position(|(there, needed)| there < needed);
                let (field, there) = (missing.unwrap_or(0), now.before[missing.unwrap_or(0)]);
                let has = there * 8 / u64::from(fields[field].bits().max(1));
                let what = format!(
                    "{} is said to have {count} points, but of {} there are {has}",
                    walk.name, fields[field].name
                );
                return Err(walk.source.malformed(what, DAMAGED));
            }
            check_apart(&walk, fields, &now, count)?;
        }
        this.end = now.at;
        Ok(this)
    }

    /// Keeps every second place.
    fn thin_out(&mut self) {
        let row = self.streams + 1;
        let mut rows = 0;
        for old in (0..self.table.len()).step_by(2 * row) {
            self.table.copy_within(old..old + row, rows * row);
            rows += 1;
        }
        self.table.truncate(rows * row);
        self.stride *= 2;
    }

    /// Last start that is kept for which `is_before` holds, as it does for all starts before; or else the
    /// first one.
    pub fn last_place(&self, is_before: impl Fn(u64, &[u64]) -> bool) -> Option<PacketStart> {
        let row = self.streams + 1;
        let place = |number: usize| {
            let (at, before) = self.table.get(number * row..(number + 1) * row)?.split_first()?;
            Some((*at, before))
        };
        let (mut low, mut high) = (0, self.table.len() / row);
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            let is_before = place(middle).is_some_and(|(at, before)| is_before(at, before));
            (low, high) = if is_before { (middle, high) } else { (low, middle) };
        }
        place(low).map(|(at, before)| PacketStart { at, before: before.to_vec() })
    }
}

/// An error where streams of numbers are too far apart.
fn check_apart(walk: &PacketWalk<'_, '_>, fields: &[E57Field], now: &PacketStart, count: u64) -> Result<()> {
    let numbers = fields.iter().zip(&now.before).filter(|(field, _)| field.bits() > 0);
    let numbers = numbers.map(|(field, bytes)| (bytes * 8 / u64::from(field.bits())).min(count));
    let (least, most) = numbers.fold((u64::MAX, 0), |(least, most), n| (least.min(n), most.max(n)));
    if most.saturating_sub(least) > MOST_APART {
        let what = format!(
            "{}: at byte {} some fields of the points are {} points ahead of others",
            walk.name,
            super::pages::physical(now.at),
            most - least
        );
        let hint = "write the model with another program first, as CloudCompare, which keeps fields together";
        return Err(walk.source.malformed(what, hint));
    }
    Ok(())
}

impl<'a> PacketWalk<'a, '_> {
    /// Returns a function that makes the error of a malformed packet at a logical byte.
    fn wrong(&self) -> impl Fn(u64, std::fmt::Arguments<'_>) -> crate::Error + use<'a> {
        let (source, name) = (self.source, self.name);
        move |at, what| {
            let what = format!("{name}, at byte {}: {what}", super::pages::physical(at));
            source.malformed(what, DAMAGED)
        }
    }

    /// The section at a place of the file, and its first packet.
    fn section(&mut self, place: u64) -> Result<(Range<u64>, u64)> {
        let wrong = self.wrong();
        let start = logical(place).filter(|start| start % 4 == 0);
        let Some(start) = start else {
            let what = format!("{}: its points cannot be at byte {place}", self.name);
            return Err(self.source.malformed(what, DAMAGED));
        };
        let head = self.window.get(start..start.saturating_add(HEAD))?;
        if (head.len() as u64) < HEAD {
            let what = format!("{}: its points are at byte {place}, behind the end of the file", self.name);
            return Err(self.source.malformed(what, DAMAGED));
        }
        let number = |at| u64::from_le_bytes(bytes_at(head, at));
        let (id, length, first) = (head[0], number(8), number(16));
        if id != 1 {
            return Err(wrong(start, format_args!("the section is of type {id}, and not one of points")));
        }
        let end = start.checked_add(length).filter(|end| *end >= start + HEAD);
        let all = self.source.len() / super::pages::PAGE * super::pages::PAYLOAD;
        let Some(end) = end.filter(|end| *end <= all) else {
            let what = format_args!("the section of points has {length} bytes, which are not there");
            return Err(wrong(start, what));
        };
        match logical(first).filter(|first| *first >= start + HEAD && *first < end) {
            Some(packet) => Ok((start..end, packet)),
            None => {
                let what = format_args!("the first packet is said to be at byte {first}, beyond the section");
                Err(wrong(start, what))
            }
        }
    }

    /// Goes over the packet at a place, and on to the next one; `false` if there is none before `end`. Tells
    /// `each` what of streams it has.
    pub fn next(
        &mut self,
        place: &mut PacketStart,
        end: u64,
        mut each: impl FnMut(PacketStream),
    ) -> Result<bool> {
        let (at, wrong) = (place.at, self.wrong());
        if at.saturating_add(4) > end {
            return Ok(false);
        }
        let streams = place.before.len();
        let head = self.window.get(at..(at + 6 + 2 * streams as u64).min(end))?;
        let kind = head.first().copied().unwrap_or(u8::MAX);
        let length = u64::from(u16::from_le_bytes(bytes_at(head, 2))) + 1;
        if length % 4 != 0 || at + length > end {
            return Err(wrong(at, format_args!("a packet has {length} bytes, and goes beyond its section")));
        }
        match kind {
            1 => {
                let lengths = head.get(6..).unwrap_or_default();
                let (told, wanted) = (usize::from(u16::from_le_bytes(bytes_at(head, 4))), 2 * streams);
                if told != streams || lengths.len() < wanted {
                    let what =
                        format_args!("a packet with {told} streams, where points have {streams} fields");
                    return Err(wrong(at, what));
                }
                let mut begin = 6 + wanted as u64;
                for (stream, length) in lengths.chunks_exact(2).enumerate() {
                    let bytes = u64::from(u16::from_le_bytes([length[0], length[1]]));
                    let before = &mut place.before[stream];
                    each(PacketStream { stream, of_stream: *before..*before + bytes, at: at + begin });
                    *before += bytes;
                    begin += bytes;
                }
                if begin > length {
                    let what = format_args!("a packet of {length} bytes has streams of {begin} bytes");
                    return Err(wrong(at, what));
                }
            }
            0 | 2 => {}
            other => return Err(wrong(at, format_args!("a packet has the type {other}"))),
        }
        place.at += length;
        Ok(true)
    }
}
