//! Offsets of some of the vertices where their records differ in length: learnt by reading them.

use std::sync::{Mutex, PoisonError};

use crate::CHUNK_VERTICES;

/// Vertices of a file, and the bytes at which they begin, as far as known.
#[derive(Debug)]
pub(super) struct Offsets(Mutex<KnownOffsets>);

#[derive(Debug)]
struct KnownOffsets {
    /// Vertex and offset, ascending in both.
    entries: Vec<(u64, u64)>,
    /// Fewest vertices from one entry to the next.
    spacing: u64,
}

impl Offsets {
    /// Most entries: with twice as many vertices, entries become half as dense.
    const MAX: usize = 1 << 14;

    pub(super) fn new() -> Self {
        Self(Mutex::new(KnownOffsets { entries: Vec::new(), spacing: CHUNK_VERTICES as u64 }))
    }

    /// The last known vertex that is not after this one.
    pub(super) fn before(&self, vertex: u64) -> Option<(u64, u64)> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let after = known.entries.partition_point(|e| e.0 <= vertex);
        known.entries[..after].last().copied()
    }

    /// Remembers where a vertex begins, if it is far enough from all that are known.
    pub(super) fn note(&self, vertex: u64, offset: u64) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let last = known.entries.last().map_or(0, |e| e.0);
        if vertex < last.saturating_add(known.spacing) {
            return;
        }
        known.entries.push((vertex, offset));
        if known.entries.len() > Self::MAX {
            let mut nth = 0;
            known.entries.retain(|_| {
                nth += 1;
                nth % 2 == 0
            });
            known.spacing *= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_offsets_stay_few_and_right() {
        let offsets = Offsets::new();
        assert_eq!(offsets.before(7), None);
        let step = CHUNK_VERTICES as u64;
        for i in 1..5 * Offsets::MAX as u64 {
            offsets.note(i * step, 10 * i * step);
            offsets.note(i * step + 1, 0); // too near
        }
        assert!(offsets.0.lock().unwrap().entries.len() <= Offsets::MAX);
        for vertex in [8 * step, 9 * step + 1, 40_001 * step, u64::MAX] {
            let (known, offset) = offsets.before(vertex).unwrap();
            assert!(known <= vertex && offset == 10 * known);
            assert!(vertex == u64::MAX || vertex - known <= 9 * step);
        }
    }
}
