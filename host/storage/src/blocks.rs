//! Blocks of objects, as they came from stores: one cache for all objects of the process. Where an object is
//! read in order, the next blocks are on their way before they are asked for.
//!
//! Memory: at most [`AHEAD`] + 1 blocks of 4 MiB for each thread, and 8 more: 64 MiB with two threads, 288
//! MiB with 16.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::available_parallelism;

use bytes::Bytes;
use simod_model::Result;

use crate::failure::RequestFailure;
use crate::runtime::runtime;
use crate::version::ObjectVersion;

/// Number of blocks that are fetched ahead behind one that is read in order.
const AHEAD: u64 = 3;

/// The blocks, and who waits for one.
pub(crate) struct BlockCache {
    held: Mutex<HeldBlocks>,
    arrived: Condvar,
}

/// Blocks that are there or on their way, the last one that was used first.
struct HeldBlocks {
    blocks: VecDeque<CachedBlock>,
    most: usize,
}

struct CachedBlock {
    of: Arc<ObjectVersion>,
    number: u64,
    state: BlockState,
}

enum BlockState {
    Coming,
    There { bytes: Bytes, was_read: bool },
    Failed(RequestFailure),
}

impl BlockCache {
    /// The one cache. Each thread reads at one place at most.
    pub fn of_process() -> &'static Self {
        static BLOCKS: OnceLock<BlockCache> = OnceLock::new();
        BLOCKS.get_or_init(|| {
            let threads = available_parallelism().map_or(1, usize::from);
            Self::with_room_for(threads * (AHEAD as usize + 1) + 8)
        })
    }

    fn with_room_for(most: usize) -> Self {
        Self { held: Mutex::new(HeldBlocks { blocks: VecDeque::new(), most }), arrived: Condvar::new() }
    }

    fn locked(&self) -> MutexGuard<'_, HeldBlocks> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a block that came by itself.
    pub fn put(&self, of: &Arc<ObjectVersion>, number: u64, bytes: Bytes) {
        self.locked().insert(of, number, BlockState::There { bytes, was_read: false });
    }

    /// Returns a block, once it is there.
    ///
    /// # Errors
    /// The block cannot be brought, or the object has another version by now.
    pub fn get(&'static self, of: &Arc<ObjectVersion>, number: u64) -> Result<Bytes> {
        let mut held = self.locked();
        if held.is_new(of, number) {
            let is_in_order = number.checked_sub(1).is_some_and(|before| held.find(of, before).is_some());
            let last = if is_in_order { (number + AHEAD).min(of.blocks() - 1) } else { number };
            for coming in number..=last {
                self.begin(&mut held, of, coming)?;
            }
        }
        loop {
            match held.find(of, number) {
                Some(at) => match &mut held.blocks[at].state {
                    BlockState::Coming => {
                        held = self.arrived.wait(held).unwrap_or_else(PoisonError::into_inner);
                    }
                    BlockState::There { bytes, was_read } => {
                        *was_read = true;
                        let bytes = bytes.clone();
                        held.use_now(at);
                        return Ok(bytes);
                    }
                    BlockState::Failed(failure) => {
                        let failure = failure.clone();
                        held.blocks.remove(at);
                        return Err(failure.into());
                    }
                },
                // Gone since, as others needed the room.
                None => self.begin(&mut held, of, number)?,
            }
        }
    }

    /// Begins to fetch a block that is not there.
    fn begin(&'static self, held: &mut HeldBlocks, of: &Arc<ObjectVersion>, number: u64) -> Result<()> {
        if held.find(of, number).is_some() {
            return Ok(());
        }
        held.insert(of, number, BlockState::Coming);
        let of = of.clone();
        runtime()?.spawn(async move {
            let state = match of.fetch(number).await {
                Ok(bytes) => BlockState::There { bytes, was_read: false },
                Err(failure) => BlockState::Failed(failure),
            };
            let mut held = self.locked();
            if let Some(at) = held.find(&of, number) {
                held.blocks[at].state = state;
            }
            drop(held);
            self.arrived.notify_all();
        });
        Ok(())
    }
}

impl HeldBlocks {
    fn find(&self, of: &ObjectVersion, number: u64) -> Option<usize> {
        let is_it = |block: &CachedBlock| {
            block.number == number && block.of.name() == of.name() && block.of.tag() == of.tag()
        };
        self.blocks.iter().position(is_it)
    }

    /// Whether nobody has read a block, as far as is known.
    fn is_new(&self, of: &ObjectVersion, number: u64) -> bool {
        let found = self.find(of, number).map(|at| &self.blocks[at].state);
        !matches!(found, Some(BlockState::There { was_read: true, .. }))
    }

    fn use_now(&mut self, at: usize) {
        if let Some(block) = self.blocks.remove(at) {
            self.blocks.push_front(block);
        }
    }

    /// Adds a block, in the place of those that were not used for the longest time.
    fn insert(&mut self, of: &Arc<ObjectVersion>, number: u64, state: BlockState) {
        while self.blocks.len() >= self.most {
            // A block on its way is waited for, and stays.
            let idle = self.blocks.iter().rposition(|block| !matches!(block.state, BlockState::Coming));
            let Some(idle) = idle else { break };
            self.blocks.remove(idle);
        }
        self.blocks.push_front(CachedBlock { of: of.clone(), number, state });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::ObjectLocation;
    use crate::runtime::wait;
    use crate::version::BLOCK;
    use object_store::memory::InMemory;
    use object_store::{ObjectStore, ObjectStoreExt, PutPayload};

    /// An object of so many bytes, and the store that it is in.
    fn object(bytes: usize) -> (ObjectLocation, Vec<u8>) {
        let store: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
        let place = ObjectLocation { name: "s3://b/a".to_owned(), store, parts: None, path: "a".into() };
        let content: Vec<u8> =
            (0..bytes as u64).map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8).collect();
        put(&place, content.clone());
        (place, content)
    }

    fn put(place: &ObjectLocation, content: Vec<u8>) {
        wait(place.store.put(&place.path, PutPayload::from(content))).unwrap().unwrap();
    }

    fn version(place: &ObjectLocation) -> Arc<ObjectVersion> {
        let meta = wait(place.store.head(&place.path)).unwrap().unwrap();
        Arc::new(ObjectVersion::from_meta(place.clone(), &meta))
    }

    #[test]
    fn threads_read_anywhere_and_little_is_held() {
        let (place, content) = object(10 * BLOCK as usize + 7);
        let version = version(&place);
        assert_eq!(version.blocks(), 11);
        // Less than all, and more than two threads have on their way.
        let blocks: &'static BlockCache = Box::leak(Box::new(BlockCache::with_room_for(10)));
        std::thread::scope(|scope| {
            for thread in 0..2u64 {
                let (version, content) = (&version, &content);
                scope.spawn(move || {
                    for turn in 0..60 {
                        // In order, with jumps.
                        let number = (thread * 3 + turn + turn / 7 * 4) % 11;
                        let start = (number * BLOCK) as usize;
                        let block = blocks.get(version, number).unwrap();
                        assert!(block[..] == content[start..content.len().min(start + BLOCK as usize)]);
                        assert!(blocks.locked().blocks.len() <= 10);
                    }
                });
            }
        });
    }

    #[test]
    fn the_next_blocks_are_on_their_way_where_reading_is_in_order() {
        let (place, _) = object(9 * BLOCK as usize);
        let version = version(&place);
        let blocks: &'static BlockCache = Box::leak(Box::new(BlockCache::with_room_for(9)));
        let numbers = || {
            let mut numbers: Vec<u64> = blocks.locked().blocks.iter().map(|block| block.number).collect();
            numbers.sort_unstable();
            numbers
        };
        blocks.get(&version, 2).unwrap();
        assert_eq!(numbers(), [2]);
        blocks.get(&version, 3).unwrap();
        assert_eq!(numbers(), [2, 3, 4, 5, 6]);
        blocks.get(&version, 3).unwrap();
        assert_eq!(numbers(), [2, 3, 4, 5, 6]);
        blocks.get(&version, 4).unwrap();
        assert_eq!(numbers(), [2, 3, 4, 5, 6, 7]);
        blocks.get(&version, 0).unwrap();
        assert_eq!(numbers(), [0, 2, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn another_version_of_an_object_is_not_read() {
        let (place, mut content) = object(3 * BLOCK as usize);
        let version = version(&place);
        let blocks: &'static BlockCache = Box::leak(Box::new(BlockCache::with_room_for(4)));
        blocks.get(&version, 1).unwrap();
        content[0] ^= 1;
        put(&place, content);
        let error = blocks.get(&version, 0).unwrap_err().to_string();
        assert_eq!(error, "s3://b/a changed while it was read");
        // The block that was read before is of the version that was opened.
        blocks.get(&version, 1).unwrap();
    }
}
