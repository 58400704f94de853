//! A file that several processes write at the same time, each a range of its own, and that becomes an output
//! once all of it is there.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::claim::Claim;
use crate::output::sync_folder;
use crate::target::folder_of;
use crate::uncached::{BLOCK, UncachedFile};
use crate::{Error, Output, Result, Summary};

/// A range of the file in the making, from where its pieces [begin](Output::begin_at).
///
/// Memory: 4 MiB.
pub struct SharedFile {
    path: PathBuf,
    file: UncachedFile,
    /// Byte of the file at which the next written byte goes.
    at: u64,
}

impl SharedFile {
    /// Opens the file, which need not be there, from its beginning on. Nothing of it is lost.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn open(path: &Path) -> Result<Self> {
        let failed = |e: io::Error| Error::io("write", path, &e);
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
        Ok(Self { path: path.to_owned(), file: UncachedFile::new(file.map_err(failed)?), at: 0 })
    }

    /// Byte of the file at which the next written byte goes.
    pub fn position(&self) -> u64 {
        self.at
    }

    /// Brings the written bytes to the disk; with `is_end`, the file is cut off behind them.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub fn sync(&mut self, is_end: bool) -> Result<()> {
        let mut sync = || {
            self.file.flush()?;
            if is_end {
                self.file.file().set_len(self.at)?;
            }
            self.file.file().sync_all()
        };
        sync().map_err(|e: io::Error| Error::io("write", &self.path, &e))
    }

    /// Puts the file, which nobody writes any more, in the place of an output, with the permissions and the
    /// owner of the file that it replaces.
    ///
    /// # Errors
    /// Another process writes the output, or the operating system refuses; it is then what it was.
    pub fn become_output(self, output: &Path) -> Result<()> {
        let mut claim = Claim::file(output, false)?;
        let put = claim.put_other_in_place(self.file.file(), &self.path);
        put.and_then(|()| sync_folder(folder_of(&claim.places().target))).map_err(|e| claim.failed(&e))
    }

    fn named(&self, e: &io::Error) -> io::Error {
        io::Error::new(e.kind(), Error::io("write", &self.path, e))
    }
}

impl Output for SharedFile {
    fn begin_at(&mut self, at: u64) -> io::Result<()> {
        let begun = self.file.flush().and_then(|()| self.file.begin_at(at.next_multiple_of(BLOCK as u64)));
        begun.map_err(|e| self.named(&e))?;
        self.at = at;
        Ok(())
    }

    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        let room = (self.at.next_multiple_of(BLOCK as u64) - self.at) as usize;
        // Bytes of a block that began in another range, where nothing has been written behind them yet.
        let (first, rest) =
            if self.file.is_at_begin() { bytes.split_at(room.min(bytes.len())) } else { (&[][..], bytes) };
        let mut write = || {
            if !first.is_empty() {
                put(self.file.file(), self.at, first)?;
            }
            self.file.write(rest)
        };
        write().map_err(|e| self.named(&e))?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let mut patch = || {
            self.file.flush()?;
            put(self.file.file(), at, bytes)
        };
        patch().map_err(|e| self.named(&e))
    }

    fn finish(&mut self) -> io::Result<()> {
        self.file.flush().map_err(|e| self.named(&e))
    }
}

/// Writes bytes to a place, and to no others.
fn put(mut file: &File, at: u64, bytes: &[u8]) -> io::Result<()> {
    file.seek(SeekFrom::Start(at))?;
    file.write_all(bytes)
}

/// Whether a file is there and has so many bytes.
pub fn reaches(path: &Path, end: u64) -> bool {
    fs::metadata(path).is_ok_and(|meta| meta.is_file() && meta.len() >= end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::tests::names;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: if std::env::var_os("PROPTEST_CASES").is_some() { ProptestConfig::default().cases } else { 24 }, ..ProptestConfig::default() })]

        /// Ranges in any order, twice, in pieces of any length, beside each other in one block or far from
        /// that.
        #[test]
        fn ranges_are_written_beside_each_other(
            length in prop_oneof![0..20_000usize, 4_000_000..4_300_000usize],
            cuts in proptest::collection::vec((0.0..1.0f64, any::<bool>()), 0..5),
            piece in prop_oneof![1..9000usize, Just(4096usize), 1_000_000..3_000_000usize],
            order in any::<u64>(),
        ) {
            let piece = piece.max(length / 300);
            let bytes: Vec<u8> = (0..length as u64).map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as u8).collect();
            let mut ends: Vec<usize> = cuts
                .iter()
                .map(|(cut, block)| (cut * length as f64) as usize / if *block { BLOCK } else { 1 } * if *block { BLOCK } else { 1 })
                .chain([0, length])
                .collect();
            ends.sort_unstable();
            let folder = tempfile::tempdir().unwrap();
            let [path, output] = ["shared", "output"].map(|name| folder.path().join(name));
            let ranges = ends.len() - 1;
            for turn in 0..2 * ranges {
                let range = (turn + order as usize % ranges) * 3 % ranges;
                for range in if turn < ranges { range..range + 1 } else { turn - ranges..turn - ranges + 1 } {
                    let mut file = SharedFile::open(&path).unwrap();
                    if ends[range] > 0 {
                        file.begin_at(ends[range] as u64).unwrap();
                    }
                    for piece in bytes[ends[range]..ends[range + 1]].chunks(piece) {
                        file.write_piece(piece, 0, &Summary::default()).unwrap();
                    }
                    prop_assert_eq!(file.position(), ends[range + 1] as u64);
                    file.sync(false).unwrap();
                }
            }
            let mut file = SharedFile::open(&path).unwrap();
            file.begin_at(length as u64).unwrap();
            file.sync(true).unwrap();
            prop_assert!(reaches(&path, length as u64) && !reaches(&path, length as u64 + 1));
            file.become_output(&output).unwrap();
            prop_assert!(fs::read(&output).unwrap() == bytes);
            prop_assert_eq!(names(folder.path()), ["output"]);
        }
    }
}
