//! Memory that two processes share: one nameless file, grown as needed, of which each maps the ranges in use.
//!
//! The file has no name anywhere, so nothing is left of it however the processes end. Its blocks are reserved
//! before they are mapped: a full disk is an error, and not a signal.
#![allow(unsafe_code, reason = "memory maps; each block has its argument")]

use memmap2::{Mmap, MmapMut, MmapOptions};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Result;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Ranges begin at multiples of this: a page, or several.
const ALIGNMENT: u64 = 1 << 16;

/// A range of the shared file, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ArenaRange {
    pub offset: u64,
    pub len: u64,
}

/// File of the shared memory, as both processes have it.
pub(super) struct SharedArena(File);

impl SharedArena {
    /// A new one, empty, in memory where the system has such files, else in the folder for temporary ones.
    pub fn create() -> Result<Self> {
        #[cfg(target_os = "linux")]
        if let Ok(fd) = rustix::fs::memfd_create("simod-plugin", rustix::fs::MemfdFlags::CLOEXEC) {
            return Ok(Self(fd.into()));
        }
        tempfile::tempfile().map(Self)
    }

    /// Arena that another process made.
    pub fn from_file(file: File) -> Self {
        Self(file)
    }

    /// The file, for another process.
    pub fn file(&self) -> Result<File> {
        self.0.try_clone()
    }

    /// Maps a range to read.
    pub fn map(&self, range: ArenaRange) -> Result<Mmap> {
        self.check(range)?;
        // SAFETY: the range is within the file, which is never truncated. The other process may write to it
        // at any time, as foreign code runs there: all that is read is plain numbers, of which any bits are
        // valid, and nothing relies on reading the same twice.
        unsafe { options(range).map(&self.0) }
    }

    /// Maps a range to write.
    pub fn map_mut(&self, range: ArenaRange) -> Result<MmapMut> {
        self.check(range)?;
        // SAFETY: as above; of this process, one thread at a time maps a range to write: the one whose call
        // it belongs to.
        unsafe { options(range).map_mut(&self.0) }
    }

    /// A range beyond the end of the file cannot be touched.
    fn check(&self, range: ArenaRange) -> Result<()> {
        let end = range.offset.checked_add(range.len);
        if end.is_some_and(|end| end <= self.0.metadata().map_or(0, |m| m.len())) {
            return Ok(());
        }
        Err(std::io::Error::other("a range is beyond the end of the shared memory"))
    }
}

/// Options of a map that has all its pages at once: a fault for each would take longer than all the rest.
fn options(range: ArenaRange) -> MmapOptions {
    let mut options = MmapOptions::new();
    options.offset(range.offset).len(range.len as usize).populate();
    options
}

/// Arena that hands out ranges of a shared file. Bounded by the memory that is in use at a time: the arrays
/// of the states that are alive.
pub(super) struct Arena {
    shared: SharedArena,
    end: u64,
    free: Vec<ArenaRange>,
}

impl Arena {
    /// An arena with the control block at its beginning.
    pub fn create() -> Result<Self> {
        let mut arena = Self { shared: SharedArena::create()?, end: 0, free: Vec::new() };
        let control = arena.allocate(size_of::<Control>())?;
        debug_assert_eq!(control, CONTROL);
        Ok(arena)
    }

    pub fn shared(&self) -> &SharedArena {
        &self.shared
    }

    /// A range for so many bytes, at least one.
    pub fn allocate(&mut self, bytes: usize) -> Result<ArenaRange> {
        let len = (bytes.max(1) as u64).next_multiple_of(ALIGNMENT);
        let fits = self.free.iter().enumerate().filter(|(_, r)| r.len >= len);
        if let Some((i, _)) = fits.min_by_key(|(_, r)| r.len) {
            let range = self.free[i];
            self.free[i] = ArenaRange { offset: range.offset + len, len: range.len - len };
            if self.free[i].len == 0 {
                self.free.swap_remove(i);
            }
            return Ok(ArenaRange { len, ..range });
        }
        fs4::FileExt::allocate(&self.shared.0, self.end + len)?;
        let range = ArenaRange { offset: self.end, len };
        self.end += len;
        Ok(range)
    }

    /// Takes a range back.
    pub fn release(&mut self, range: ArenaRange) {
        let mut range = range;
        // Joined with its neighbours.
        self.free.retain(|other| {
            let touches =
                other.offset + other.len == range.offset || range.offset + range.len == other.offset;
            if touches {
                range = ArenaRange { offset: other.offset.min(range.offset), len: range.len + other.len };
            }
            !touches
        });
        self.free.push(range);
    }
}

/// Range of the control block.
pub(super) const CONTROL: ArenaRange = ArenaRange { offset: 0, len: ALIGNMENT };

/// State that both processes look at during a call.
#[repr(C)]
#[derive(Default)]
pub(super) struct Control {
    /// Whether the worker shall stop; not 0 if so.
    pub cancel: AtomicU32,
    /// Count of the signs of life.
    beats: AtomicU32,
    /// Fraction of the call that is done, as the bits of a double.
    progress: AtomicU64,
}

impl Control {
    /// The worker is alive, and so far.
    pub fn beat(&self, fraction: f64) {
        self.progress.store(fraction.to_bits(), Ordering::Relaxed);
        self.beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The signs of life so far, and how much is done.
    pub fn read(&self) -> (u32, f64) {
        (self.beats.load(Ordering::Relaxed), f64::from_bits(self.progress.load(Ordering::Relaxed)))
    }

    /// Clears the state before a call.
    pub fn reset(&self) {
        self.cancel.store(0, Ordering::Relaxed);
        self.progress.store(0, Ordering::Relaxed);
    }
}

/// The control block, mapped.
pub(super) struct ControlMap(MmapMut);

impl ControlMap {
    pub fn new(shared: &SharedArena) -> Result<Self> {
        shared.map_mut(CONTROL).map(Self)
    }
}

impl std::ops::Deref for ControlMap {
    type Target = Control;

    fn deref(&self) -> &Control {
        // SAFETY: the map is longer than a `Control`, aligned to a page, and lives as long as `self`; all
        // fields are atomic, so that any process may write to them.
        unsafe { &*self.0.as_ptr().cast::<Control>() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_given_and_taken_back() {
        let mut arena = Arena::create().unwrap();
        let a = arena.allocate(100_000).unwrap();
        let b = arena.allocate(1).unwrap();
        let c = arena.allocate(1).unwrap();
        assert_eq!((a.offset, a.len, b.offset), (CONTROL.len, 2 * ALIGNMENT, CONTROL.len + 2 * ALIGNMENT));
        arena.release(a);
        arena.release(c);
        arena.release(b);
        let all = arena.allocate(4 * ALIGNMENT as usize).unwrap();
        assert_eq!(all, ArenaRange { offset: a.offset, len: 4 * ALIGNMENT });
        assert_eq!(arena.end, CONTROL.len + 4 * ALIGNMENT);
        arena.release(all);
        assert_eq!(arena.allocate(1).unwrap(), ArenaRange { len: ALIGNMENT, ..all });
    }

    #[test]
    fn what_one_writes_the_other_reads() {
        let mut arena = Arena::create().unwrap();
        let range = arena.allocate(12).unwrap();
        let other = SharedArena::from_file(arena.shared().file().unwrap());
        arena.shared().map_mut(range).unwrap()[..4].copy_from_slice(b"here");
        assert_eq!(&other.map(range).unwrap()[..4], b"here");
        let (mine, theirs) = (ControlMap::new(arena.shared()).unwrap(), ControlMap::new(&other).unwrap());
        theirs.beat(0.25);
        assert_eq!(mine.read(), (1, 0.25));
        assert!(other.map(ArenaRange { offset: 1 << 40, len: 1 }).is_err());
    }
}
