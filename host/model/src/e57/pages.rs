//! The pages of an E57 file, each of which ends with a checksum (CRC-32C), and the bytes between the
//! checksums: everything else in this format counts *logical* bytes, as if there were no checksums.

use std::ops::Range;

use crate::Result;
use crate::source::SourceFile;

/// Bytes of a page.
pub(super) const PAGE: u64 = 1024;

/// Bytes of a page before its checksum.
pub(super) const PAYLOAD: u64 = PAGE - 4;

/// Hint for everything that no correct program writes.
pub(super) const DAMAGED: &str = "the file is damaged: copy or export it again";

/// Hint where something is missing.
pub(super) const CUT_OFF: &str = "the file is cut off, or its header lies: copy or export it again";

/// The logical byte at a place of the file; none within a checksum.
pub(super) fn logical(physical: u64) -> Option<u64> {
    let (page, within) = (physical / PAGE, physical % PAGE);
    (within < PAYLOAD).then_some(page * PAYLOAD + within)
}

/// The place in the file of a logical byte.
pub(super) fn physical(logical: u64) -> u64 {
    logical / PAYLOAD * PAGE + logical % PAYLOAD
}

/// The pages that hold some logical bytes.
pub(super) fn pages_of(bytes: &Range<u64>) -> Range<u64> {
    bytes.start / PAYLOAD..bytes.end.div_ceil(PAYLOAD).max(bytes.start / PAYLOAD)
}

/// Appends logical bytes of whole pages as they are in a file, with checksums; calls `each` with the checksum
/// of each page.
pub(super) fn append_pages(bytes: &[u8], to: &mut Vec<u8>, mut each: impl FnMut(usize, u32)) {
    to.reserve(bytes.len().div_ceil(PAYLOAD as usize) * PAGE as usize);
    for (page, payload) in bytes.chunks(PAYLOAD as usize).enumerate() {
        let checksum = crc32c::crc32c(payload);
        to.extend_from_slice(payload);
        to.extend_from_slice(&checksum.to_be_bytes());
        each(page, checksum);
    }
}

/// The checksum of a page whose checksum was another one before some bytes were replaced: places within the
/// page, and the old and the new bytes, which are as many.
pub(super) fn checksum_after<'a>(
    checksum: u32,
    replaced: impl IntoIterator<Item = (usize, &'a [u8], &'a [u8])>,
) -> u32 {
    // Checksums are linear, but for what they begin and end with.
    let mut difference = [0; PAYLOAD as usize];
    let nothing = crc32c::crc32c(&difference);
    for (at, old, new) in replaced {
        let there = difference.iter_mut().skip(at);
        there.zip(old.iter().zip(new)).for_each(|(byte, (old, new))| *byte ^= old ^ new);
    }
    checksum ^ crc32c::crc32c(&difference) ^ nothing
}

/// Some pages of a file, read and checked: reading on is cheap, and so is going back a little.
///
/// Memory: as many pages as it was made for, or as are asked for at once, twice.
pub(super) struct PageWindow<'a> {
    source: &'a SourceFile,
    /// Pages that are read at a time.
    ahead: u64,
    /// The first page that is there.
    first: u64,
    /// The logical bytes of all that are there.
    bytes: Vec<u8>,
    read: Vec<u8>,
}

impl<'a> PageWindow<'a> {
    pub fn new(source: &'a SourceFile, ahead: u64) -> Self {
        Self { source, ahead, first: 0, bytes: Vec::new(), read: Vec::new() }
    }

    /// Logical bytes; fewer only where the file ends.
    ///
    /// # Errors
    /// The file cannot be read, or the checksum of a page is wrong.
    pub fn get(&mut self, bytes: Range<u64>) -> Result<&[u8]> {
        let start = self.first * PAYLOAD;
        if bytes.start < start || bytes.end > start + self.bytes.len() as u64 {
            let pages = pages_of(&bytes);
            self.load(pages.start..pages.end.max(pages.start + self.ahead))?;
        }
        let start = self.first * PAYLOAD;
        let part = |at: u64| (at.saturating_sub(start) as usize).min(self.bytes.len());
        Ok(&self.bytes[part(bytes.start)..part(bytes.end)])
    }

    /// Reads these pages, as far as the file has them.
    pub fn load(&mut self, pages: Range<u64>) -> Result<()> {
        let end = (self.source.len() / PAGE).min(pages.end);
        let behind = self.first + self.bytes.len() as u64 / PAYLOAD;
        if (self.first..behind).contains(&pages.start) {
            // Bytes of these pages that the window has already are kept.
            self.bytes.drain(..((pages.start - self.first) * PAYLOAD) as usize);
        } else {
            self.bytes.clear();
        }
        self.first = pages.start;
        let kept = pages.start + self.bytes.len() as u64 / PAYLOAD;
        let count = end.saturating_sub(kept) as usize;
        self.read.resize(count * PAGE as usize, 0);
        self.source.read_at(&mut self.read, kept.min(end) * PAGE)?;
        for (number, page) in (kept..).zip(self.read.chunks_exact(PAGE as usize)) {
            let (payload, checksum) = page.split_at(PAYLOAD as usize);
            if crc32c::crc32c(payload).to_be_bytes() != checksum {
                self.bytes.clear();
                let what = format!("the checksum of page {number}, at byte {}, is wrong", number * PAGE);
                return Err(self.source.malformed(what, DAMAGED));
            }
            self.bytes.extend_from_slice(payload);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn places_are_the_same_both_ways() {
        for at in 0..5000 {
            assert_eq!(logical(physical(at)), Some(at));
        }
        assert_eq!(logical(1019), Some(1019));
        assert_eq!(logical(1020), None);
        assert_eq!(logical(1024), Some(1020));
        assert_eq!(pages_of(&(1019..1021)), 0..2);
        assert_eq!(pages_of(&(1020..1020)), 1..1);
    }

    proptest! {
        #[test]
        fn checksums_follow_what_is_replaced(
            page in prop::collection::vec(any::<u8>(), PAYLOAD as usize),
            at in 0..1000usize,
            new in prop::collection::vec(any::<u8>(), 0..20),
        ) {
            let mut replaced = page.clone();
            replaced[at..at + new.len()].copy_from_slice(&new);
            let old = &page[at..at + new.len()];
            let told = checksum_after(crc32c::crc32c(&page), [(at, old, &new[..])]);
            prop_assert_eq!(told, crc32c::crc32c(&replaced));
        }
    }
}
