//! The tasks of pass 2, and the order in which threads do them.
//!
//! Pieces of the stream are gathered by any thread, several at a time; each shard merges them in the order of
//! the stream; and a piece that all shards have merged is finished, in that order as well. Merging makes
//! cells complete, which are clustered. Finishing comes first, then merging, then clustering, so that few
//! pieces are held.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use simod_model::Error;

/// Task for a thread, which tells [`Tasks`] when it is done. `P` is a piece, and `C` a cell.
pub enum Task<P, C> {
    /// Read the next piece and gather it, into this one if there is any.
    Gather(Option<P>),
    /// Merge a piece by a shard.
    Merge(usize, Arc<P>),
    /// Finish a piece that all shards have merged.
    Finish(Arc<P>),
    /// Cluster a complete cell.
    Cluster(C),
}

/// Reason why there is nothing left to do before the end.
pub enum Stopped {
    /// Something found no room.
    NoRoom,
    /// Something went wrong.
    Failed(Error),
}

/// Tasks that are still to be done.
pub struct Tasks<P, C> {
    /// Number of all pieces.
    pieces: u64,
    /// Largest number of pieces that are taken and not finished.
    most: u64,
    taken: u64,
    finished: u64,
    is_finishing: bool,
    /// Piece that each shard merges next, and whether a thread is at it.
    shards: Vec<(u64, bool)>,
    /// Pieces that are gathered and not finished, by their numbers.
    gathered: BTreeMap<u64, Arc<P>>,
    /// Cells that wait to be clustered.
    complete: VecDeque<C>,
    /// Bytes of these and of those that are clustered, beyond which nothing is merged.
    queued: usize,
    most_queued: usize,
    /// Pieces that are finished, to be filled again.
    spare: Vec<P>,
    stopped: Option<Stopped>,
    /// Threads that wait for something to do.
    waiting: usize,
}

impl<P, C> Tasks<P, C> {
    /// Tasks of `pieces` pieces, of which at most `most` are taken and not finished, and of `shards` shards,
    /// which merge until cells of `most_queued` bytes are complete and not clustered.
    pub fn new(pieces: u64, most: u64, shards: usize, most_queued: usize) -> Self {
        Self {
            pieces,
            most,
            taken: 0,
            finished: 0,
            is_finishing: false,
            shards: vec![(0, false); shards],
            gathered: BTreeMap::new(),
            complete: VecDeque::new(),
            queued: 0,
            most_queued,
            spare: Vec::new(),
            stopped: None,
            waiting: 0,
        }
    }

    fn next(&mut self) -> Option<Task<P, C>> {
        if self.can_finish() {
            self.is_finishing = true;
            return self.gathered.remove(&self.finished).map(Task::Finish);
        }
        if let Some(shard) = self.idle_shard() {
            let (next, is_busy) = &mut self.shards[shard];
            *is_busy = true;
            return self.gathered.get(next).map(|piece| Task::Merge(shard, piece.clone()));
        }
        if let Some(cell) = self.complete.pop_front() {
            return Some(Task::Cluster(cell));
        }
        self.can_gather().then(|| {
            self.taken += 1;
            Task::Gather(self.spare.pop())
        })
    }

    fn has_next(&self) -> bool {
        self.can_finish() || self.idle_shard().is_some() || !self.complete.is_empty() || self.can_gather()
    }

    /// Whether the next piece can be finished: all shards have merged it.
    fn can_finish(&self) -> bool {
        !self.is_finishing
            && self.gathered.contains_key(&self.finished)
            && self.shards.iter().all(|(next, _)| *next > self.finished)
    }

    /// The shard that is furthest behind of those that can merge their next piece.
    fn idle_shard(&self) -> Option<usize> {
        if self.queued > self.most_queued {
            return None;
        }
        let can_merge =
            |(_, (next, is_busy)): &(usize, &(u64, bool))| !is_busy && self.gathered.contains_key(next);
        let shards = self.shards.iter().enumerate().filter(can_merge);
        shards.min_by_key(|(_, (next, _))| *next).map(|(shard, _)| shard)
    }

    fn can_gather(&self) -> bool {
        self.taken < self.pieces && self.taken - self.finished < self.most
    }

    /// The piece of a number is gathered.
    pub fn gathered(&mut self, number: u64, piece: P) {
        self.gathered.insert(number, Arc::new(piece));
    }

    /// Notes that a shard has merged the piece that it was given, or a part of it, and has let go of the
    /// piece.
    pub fn merged(&mut self, shard: usize, has_all: bool) {
        let (next, is_busy) = &mut self.shards[shard];
        (*next, *is_busy) = (*next + u64::from(has_all), false);
    }

    /// A piece is finished, and can be filled again.
    pub fn finished(&mut self, piece: Option<P>) {
        self.finished += 1;
        self.is_finishing = false;
        self.spare.extend(piece);
    }

    /// Reserves `bytes` bytes for a complete cell that is to be clustered; `false` where too many wait for it
    /// or are in it.
    pub fn reserve(&mut self, bytes: usize) -> bool {
        let has_room = self.queued <= self.most_queued;
        if has_room {
            self.queued += bytes;
        }
        has_room
    }

    /// Notes that a cell of `bytes` bytes is clustered.
    pub fn clustered(&mut self, bytes: usize) {
        self.queued -= bytes;
    }

    /// Stops all tasks. The first reason counts.
    pub fn stop(&mut self, why: Stopped) {
        self.stopped.get_or_insert(why);
    }
}

/// Tasks that are still to be done, for several threads.
pub struct Schedule<P, C> {
    tasks: Mutex<Tasks<P, C>>,
    /// Signal that there is a task for a thread that waits, or that there will be none.
    moved: Condvar,
}

impl<P, C> Schedule<P, C> {
    /// The schedule of these tasks.
    pub fn new(tasks: Tasks<P, C>) -> Self {
        Self { tasks: Mutex::new(tasks), moved: Condvar::new() }
    }

    /// Lock of the tasks, for a thread to note what it has done; it [takes](Self::take) another task
    /// thereupon.
    pub fn tasks(&self) -> MutexGuard<'_, Tasks<P, C>> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Next task, once there is one; `None` if nothing is left. Where there is yet another one, a thread that
    /// waits is woken for it: as each thread comes back for what it has made possible, nothing is left
    /// undone, and few are woken in vain.
    pub fn take(&self) -> Option<Task<P, C>> {
        let mut tasks = self.tasks();
        loop {
            let next = if tasks.stopped.is_some() { None } else { tasks.next() };
            if next.is_some() {
                if tasks.waiting > 0 && tasks.has_next() {
                    self.moved.notify_one();
                }
                return next;
            }
            if tasks.stopped.is_some() || tasks.finished == tasks.pieces {
                self.moved.notify_all();
                return None;
            }
            tasks.waiting += 1;
            tasks = self.moved.wait(tasks).unwrap_or_else(PoisonError::into_inner);
            tasks.waiting -= 1;
        }
    }

    /// Lets a complete cell be clustered, for which bytes are [reserved](Tasks::reserve), while its shard
    /// goes on.
    pub fn hand_over(&self, cell: C) {
        let mut tasks = self.tasks();
        tasks.complete.push_back(cell);
        if tasks.waiting > 0 {
            self.moved.notify_one();
        }
    }

    /// Reason why there was nothing left to do before the end, if there is one.
    pub fn into_stopped(self) -> Option<Stopped> {
        self.tasks.into_inner().unwrap_or_else(PoisonError::into_inner).stopped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

    /// Piece that counts the shards that have merged it.
    struct Numbered {
        number: u64,
        merged: AtomicUsize,
    }

    /// Bytes of a cell.
    const CELL: usize = 5;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// Each shard merges all pieces in their order, whether at once or in parts; each is finished once
        /// all have, in order; all cells are clustered; and no more pieces are held than may be.
        #[test]
        fn all_is_done_in_order_by_any_number_of_threads(
            pieces in 0u64..60, shards in 1usize..5, threads in 1usize..6, more in 0u64..3,
            most_queued in 0usize..20, cells_at in proptest::collection::vec(0usize..4, 1..6),
        ) {
            let most = threads as u64 + more;
            let schedule = Schedule::new(Tasks::new(pieces, most, shards, most_queued));
            let next_of_shard: Vec<AtomicU64> = (0..shards).map(|_| AtomicU64::new(0)).collect();
            let (read, finished) = (AtomicU64::new(0), AtomicU64::new(0));
            let (made, clustered) = (AtomicUsize::new(0), AtomicUsize::new(0));
            // Cells of its next piece that a shard has made, and bytes of those that are not clustered.
            let made_of_shard: Vec<AtomicUsize> = (0..shards).map(|_| AtomicUsize::new(0)).collect();
            let queued = AtomicUsize::new(0);
            let work = || while let Some(task) = schedule.take() {
                match task {
                    Task::Gather(_) => {
                        let number = read.fetch_add(1, Ordering::SeqCst);
                        assert!(number < finished.load(Ordering::SeqCst) + most);
                        schedule.tasks().gathered(number, Numbered { number, merged: AtomicUsize::new(0) });
                    }
                    Task::Merge(shard, piece) => {
                        assert_eq!(next_of_shard[shard].load(Ordering::SeqCst), piece.number);
                        let cells = cells_at[(piece.number as usize + shard) % cells_at.len()];
                        let made_of_shard = &made_of_shard[shard];
                        while made_of_shard.load(Ordering::SeqCst) < cells && schedule.tasks().reserve(CELL) {
                            let before = queued.fetch_add(CELL, Ordering::SeqCst);
                            assert!(before <= most_queued, "{before} bytes are queued");
                            made_of_shard.fetch_add(1, Ordering::SeqCst);
                            made.fetch_add(1, Ordering::SeqCst);
                            schedule.hand_over(CELL);
                        }
                        // A shard that finds no room has the rest later.
                        let has_all = made_of_shard.load(Ordering::SeqCst) == cells;
                        if has_all {
                            made_of_shard.store(0, Ordering::SeqCst);
                            piece.merged.fetch_add(1, Ordering::SeqCst);
                            next_of_shard[shard].fetch_add(1, Ordering::SeqCst);
                        }
                        drop(piece);
                        schedule.tasks().merged(shard, has_all);
                    }
                    Task::Finish(piece) => {
                        assert_eq!(finished.fetch_add(1, Ordering::SeqCst), piece.number);
                        assert_eq!(piece.merged.load(Ordering::SeqCst), shards);
                        let piece = Arc::into_inner(piece);
                        assert!(piece.is_some(), "a shard still has it");
                        schedule.tasks().finished(piece);
                    }
                    Task::Cluster(bytes) => {
                        clustered.fetch_add(1, Ordering::SeqCst);
                        queued.fetch_sub(bytes, Ordering::SeqCst);
                        schedule.tasks().clustered(bytes);
                    }
                }
            };
            std::thread::scope(|scope| {
                (0..threads).for_each(|_| { scope.spawn(work); });
            });
            prop_assert!(schedule.into_stopped().is_none());
            prop_assert_eq!(finished.into_inner(), pieces);
            prop_assert_eq!(made.into_inner(), clustered.into_inner());
        }
    }

    #[test]
    fn what_stops_it_first_ends_all_threads() {
        let schedule = Schedule::<(), usize>::new(Tasks::new(10, 3, 2, 0));
        std::thread::scope(|scope| {
            (0..4).for_each(|_| {
                scope.spawn(|| {
                    while schedule.take().is_some() {
                        // One piece is never gathered, so that others wait for it.
                        schedule.tasks().stop(Stopped::NoRoom);
                    }
                });
            });
        });
        schedule.tasks().stop(Stopped::Failed(Error::internal("too late")));
        assert!(matches!(schedule.into_stopped(), Some(Stopped::NoRoom)));
    }
}
