//! Temporary files as memory, of which little stays resident: mapped pages count as the process' own wherever
//! its memory is measured, though the system may take them back at any time.

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use memmap2::{Mmap, MmapMut};

/// Bytes that are read or written until all pages are given back, which bounds the resident part of a pass
/// that goes through its files in about their order. Pages in the system's cache come back at once; a pass in
/// no order gets all files back each time.
const RESIDENT: u64 = 64 << 20;

/// Address and length of each map of this process.
static MAPS: Mutex<Vec<(usize, usize)>> = Mutex::new(Vec::new());

/// Bytes that were looked at so far.
static LOOKED_AT: AtomicU64 = AtomicU64::new(0);

/// A temporary file as memory to be read.
pub type Map = Mapped<Mmap>;

/// A temporary file as memory to be read and written.
pub type MapMut = Mapped<MmapMut>;

/// A file as memory.
#[derive(Debug)]
pub struct Mapped<M: Deref<Target = [u8]>>(M);

impl<M: Deref<Target = [u8]>> Mapped<M> {
    /// Map of a whole file, with which it is shared: bytes that are written to the map are in the file.
    pub(crate) fn new(map: M) -> Self {
        let place = (map.as_ptr() as usize, map.len());
        MAPS.lock().unwrap_or_else(PoisonError::into_inner).push(place);
        Self(map)
    }
}

impl<M: Deref<Target = [u8]>> Drop for Mapped<M> {
    fn drop(&mut self) {
        let place = (self.0.as_ptr() as usize, self.0.len());
        let mut maps = MAPS.lock().unwrap_or_else(PoisonError::into_inner);
        maps.retain(|other| *other != place);
    }
}

impl<M: Deref<Target = [u8]>> Deref for Mapped<M> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

impl<M: DerefMut<Target = [u8]>> DerefMut for Mapped<M> {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.0
    }
}

/// Tells that about so many bytes of mapped files were used, which are not used again soon: from time to time
/// all pages go back to the system, which keeps their content.
pub fn looked_at(bytes: usize) {
    if is_due(&LOOKED_AT, bytes) {
        MAPS.lock().unwrap_or_else(PoisonError::into_inner).iter().for_each(|place| release(*place));
    }
}

/// Whether another [`RESIDENT`] bytes are full with these, which the one thread is told that fills them.
fn is_due(looked_at: &AtomicU64, bytes: usize) -> bool {
    let before = looked_at.fetch_add(bytes as u64, Ordering::Relaxed);
    before.wrapping_add(bytes as u64) / RESIDENT != before / RESIDENT
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn release((address, length): (usize, usize)) {
    #[expect(unsafe_code, reason = "advice about memory")]
    // SAFETY: it is the whole of a map that is there, as one that ends waits for the lock first. It is shared
    // with its file, so that its pages keep what is in them and come back, whoever uses them meanwhile.
    let _ = unsafe { libc::madvise(address as *mut libc::c_void, length, libc::MADV_DONTNEED) };
}

/// Does nothing: these systems are not told.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn release(_place: (usize, usize)) {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scratch::Scratch;

    /// Bytes of a map that are resident in this process.
    #[cfg(target_os = "linux")]
    fn resident(map: &[u8]) -> u64 {
        let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
        let begin = format!("{:x}-", map.as_ptr() as usize);
        let own = maps.lines().skip_while(|line| !line.starts_with(&begin));
        let line = own.into_iter().find_map(|line| line.strip_prefix("Rss:")).unwrap();
        line.trim().strip_suffix("kB").unwrap().trim().parse::<u64>().unwrap() << 10
    }

    #[test]
    fn one_thread_of_several_is_told_to_give_pages_back() {
        let (looked_at, told) = (AtomicU64::new(0), AtomicU64::new(0));
        let bytes = RESIDENT / 1000;
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..100_000 {
                        told.fetch_add(u64::from(is_due(&looked_at, bytes as usize)), Ordering::Relaxed);
                    }
                });
            }
        });
        assert_eq!(told.into_inner(), 400_000 * bytes / RESIDENT);
    }

    #[test]
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    fn pages_are_given_back_and_keep_what_is_in_them() {
        let file = Scratch::new(&std::env::temp_dir(), "").unwrap();
        let bytes: Vec<u8> = (0..4 << 20).map(|i: u32| (i % 251) as u8).collect();
        file.write_at(&bytes, 0).unwrap();
        let mut map = file.map_mut().unwrap();
        map.iter_mut().for_each(|byte| *byte ^= 1);
        assert!(resident(&map) > 0);
        looked_at(RESIDENT as usize);
        assert!(resident(&map) < bytes.len() as u64 / 4);
        assert!(map.iter().zip(&bytes).all(|(a, b)| *a == b ^ 1));
    }
}
