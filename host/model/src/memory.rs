//! Memory of this process: the peak of its own memory, without the pages of files in the cache; blocks that
//! go back to the system; large pages; and lists whose numbers several threads change.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use bytemuck::Zeroable;

/// Time between two looks. Large buffers live longer than this.
const INTERVAL: Duration = Duration::from_millis(5);

/// Size in bytes from which on a block of memory goes back to the system once it is free.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const LARGE: i32 = 256 << 10;

/// The size of such a block while [blocks are used again](Reusing): the most that glibc allows.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const LARGEST: i32 = 32 << 20;

/// Free memory at the end of each of the allocator's parts, of which each thread has one, from which on some
/// goes back; and the same meanwhile. With the usual 128 KiB, the lists of each cell come from new pages.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const LITTLE_FREE: i32 = 4 << 20;
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MUCH_FREE: i32 = 64 << 20;

/// Whether large blocks go back to the system, and (`REUSING`) the number of those at work that use them
/// again.
static RETURNING: AtomicBool = AtomicBool::new(false);
static REUSING: AtomicU32 = AtomicU32::new(0);

/// Lets large blocks of memory go back to the system as soon as they are free, in this process from now on,
/// where its allocator can be told: that of glibc keeps more and more of them otherwise, and larger ones, as
/// the work goes on.
pub fn return_large_blocks() {
    RETURNING.store(true, Ordering::Relaxed);
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    set_allocator(LARGE, LITTLE_FREE);
}

/// As long as a value of this type exists, large blocks are used again where they would [go
/// back](return_large_blocks) to the system: for work that takes and frees many of them, as new pages from
/// the system cost more than the work in them. Blocks that are free in the end go back to the system.
///
/// Memory: blocks that are free meanwhile stay with the thread that took them, 64 MiB of each at most.
pub struct Reusing(());

impl Reusing {
    /// Uses large blocks again from now on.
    pub fn begin() -> Self {
        REUSING.fetch_add(1, Ordering::Relaxed);
        #[cfg(all(target_os = "linux", target_env = "gnu"))]
        if RETURNING.load(Ordering::Relaxed) {
            set_allocator(LARGEST, MUCH_FREE);
        }
        Self(())
    }
}

impl Drop for Reusing {
    fn drop(&mut self) {
        let is_last = REUSING.fetch_sub(1, Ordering::Relaxed) == 1;
        #[cfg(all(target_os = "linux", target_env = "gnu"))]
        if is_last && RETURNING.load(Ordering::Relaxed) {
            give_back();
        }
        #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
        let _ = is_last;
    }
}

/// Returns all free memory to the system now, and large blocks from now on.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn give_back() {
    set_allocator(LARGE, LITTLE_FREE);
    #[expect(unsafe_code, reason = "a call of the allocator")]
    // SAFETY: it gives back pages in which nothing is, and locks what it changes.
    let _ = unsafe { libc::malloc_trim(0) };
}

/// Sets the bytes from which on blocks go back to the system, and those free at the end of the allocator's
/// memory.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn set_allocator(block: i32, free: i32) {
    for (what, bytes) in [(libc::M_MMAP_THRESHOLD, block), (libc::M_TRIM_THRESHOLD, free)] {
        #[expect(unsafe_code, reason = "a setting of the allocator")]
        // SAFETY: it takes two numbers and keeps them for later calls of the allocator. Other threads may be
        // in one: the numbers are words, and whoever reads a former one goes by that, as where glibc itself
        // changes them, which it does until somebody sets them.
        let _ = unsafe { libc::mallopt(what, bytes) };
    }
}

/// Bytes of a large page.
pub(crate) const LARGE_PAGE: usize = 2 << 20;

/// List of so many zeros, in fresh pages of the system, which a thread gets when it first writes there: for
/// long lists that are held for long. The system is asked for large pages, which are allocated and looked up
/// in fewer steps; where it gives none, nothing else changes.
pub fn zeros<T: Zeroable>(count: usize) -> Vec<T> {
    let list: Vec<T> = bytemuck::zeroed_vec(count);
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        let bytes = list.as_ptr_range();
        let first = (bytes.start as usize).next_multiple_of(LARGE_PAGE);
        let length = (bytes.end as usize).saturating_sub(first) / LARGE_PAGE * LARGE_PAGE;
        if length > 0 {
            let start = bytes.start.wrapping_byte_add(first - bytes.start as usize);
            #[expect(unsafe_code, reason = "advice about memory")]
            // SAFETY: the range lies within the list, begins where a page does, and what is in it stays as it
            // is.
            let _ = unsafe { libc::madvise(start.cast_mut().cast(), length, libc::MADV_HUGEPAGE) };
        }
    }
    list
}

/// The numbers of a list, for several threads to change as long as the list is borrowed: those of a mapped
/// file, say.
pub fn atomics(list: &mut [u32]) -> &[AtomicU32] {
    #[expect(unsafe_code, reason = "the standard library has no stable way from a slice to atomics")]
    // SAFETY: both types have the same size, alignment and values. The list is borrowed as the only one who
    // may read or write it, for as long as the atomics are.
    unsafe {
        std::slice::from_raw_parts(list.as_mut_ptr().cast(), list.len())
    }
}

/// Resizes a buffer to so many bytes, whatever these are: the caller overwrites them.
pub(crate) fn resize(buffer: &mut Vec<u8>, bytes: usize) {
    if buffer.capacity() < bytes {
        *buffer = zeros(bytes);
    } else {
        // Not cleared first: filling a buffer with zeros, only to overwrite it, takes time.
        buffer.resize(bytes, 0);
    }
}

/// Watches the process' memory from a thread of its own.
pub struct MemoryWatch {
    peak: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl MemoryWatch {
    /// Begins to watch.
    pub fn start() -> Self {
        let (peak, stop) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let (p, s) = (peak.clone(), stop.clone());
        let thread = std::thread::Builder::new()
            .name("memory".into())
            .spawn(move || {
                while !s.load(Ordering::Relaxed) {
                    let Some(bytes) = anonymous() else { break };
                    p.fetch_max(bytes, Ordering::Relaxed);
                    std::thread::sleep(INTERVAL);
                }
            })
            .ok();
        Self { peak, stop, thread }
    }

    /// The peak so far, in bytes; `None` where the system does not tell.
    pub fn peak(&self) -> Option<u64> {
        let now = anonymous()?;
        Some(self.peak.fetch_max(now, Ordering::Relaxed).max(now))
    }
}

impl Drop for MemoryWatch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Anonymous memory in bytes of another process and of those that it started, now.
#[cfg(target_os = "linux")]
pub fn anonymous_of(process: u32) -> Option<u64> {
    let own = anonymous_by(&format!("/proc/{process}/statm"))?;
    let children = std::fs::read_to_string(format!("/proc/{process}/task/{process}/children"));
    let children = children.unwrap_or_default();
    let ids = children.split_whitespace().filter_map(|id| id.parse().ok());
    Some(own + ids.filter_map(anonymous_of).sum::<u64>())
}

/// Returns `None`: these systems are not asked.
#[cfg(not(target_os = "linux"))]
pub fn anonymous_of(_process: u32) -> Option<u64> {
    None
}

/// Anonymous resident memory in bytes, now; `None` where the system does not tell.
///
/// Read here, as `sysinfo` and `memory-stats` know resident memory alone, of which the pages of the model's
/// files are the most.
#[cfg(target_os = "linux")]
pub fn anonymous() -> Option<u64> {
    anonymous_by("/proc/self/statm")
}

/// Anonymous memory: the resident pages less those of files or shared ones. `status`, which has this number,
/// takes the system ten times as long. `None` for a process that has ended, of which all numbers are 0.
#[cfg(target_os = "linux")]
fn anonymous_by(file: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let mut pages = text.split_ascii_whitespace().skip(1).map(str::parse::<u64>);
    let (resident, shared) = (pages.next()?.ok()?, pages.next()?.ok()?);
    (resident > 0).then(|| resident.saturating_sub(shared) * rustix::param::page_size() as u64)
}

/// Bytes that a file of the system tells in a line of this name.
#[cfg(target_os = "linux")]
fn told_by(file: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(name))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Memory of the machine in bytes; 4 GiB where the machine does not tell.
pub fn of_machine() -> u64 {
    #[cfg(target_os = "linux")]
    let total = told_by("/proc/meminfo", "MemTotal:");
    #[cfg(not(target_os = "linux"))]
    let total = {
        let mut system = sysinfo::System::new();
        system.refresh_memory();
        Some(system.total_memory()).filter(|bytes| *bytes > 0)
    };
    total.unwrap_or(4 << 30)
}

/// Resident memory in bytes, now, from which these systems do not separate that of files; `None` where a
/// system does not tell.
#[cfg(not(target_os = "linux"))]
pub fn anonymous() -> Option<u64> {
    use sysinfo::{ProcessRefreshKind, ProcessesToUpdate, System, get_current_pid};

    let this = get_current_pid().ok()?;
    let mut system = System::new();
    let memory = ProcessRefreshKind::nothing().with_memory();
    system.refresh_processes_specifics(ProcessesToUpdate::Some(&[this]), false, memory);
    system.process(this).map(sysinfo::Process::memory)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn anonymous_memory_is_as_the_system_tells_in_words() {
        // The list must not be optimised away, though no code reads it.
        let list = std::hint::black_box(vec![1u8; 64 << 20]);
        // Other tests take and free memory between the two looks, but not each time.
        let looks: Vec<[u64; 2]> = (0..10)
            .map(|_| [anonymous(), told_by("/proc/self/status", "RssAnon:")].map(|n| n.expect("told")))
            .collect();
        let are_alike = |[now, told]: &[u64; 2]| now.abs_diff(*told) < 16 << 20;
        assert!(looks.iter().all(|[now, _]| *now > list.len() as u64), "{looks:?}");
        assert!(looks.iter().any(are_alike), "{looks:?}");
    }

    #[test]
    fn zeros_are_zero_and_can_be_written() {
        for count in [0, 1, 1000, 1 << 20, 3 << 20] {
            let mut list: Vec<u64> = zeros(count);
            assert_eq!(list.len(), count);
            assert!(list.iter().all(|x| *x == 0));
            list.iter_mut().zip(1..).for_each(|(x, i)| *x = i);
            assert_eq!(list.last().copied().unwrap_or(0), count as u64);
        }
    }
}
