//! Which sample of P_S stands for each vertex of P_L: what it takes to give P_S the faces of P_L.
//!
//! As this is as large as P_L, it is in temporary files of 4 bytes per vertex: while the model streams, each vertex'
//! item (all cells' items are counted in one row, in which a cell has as many places as vertices); once a cell is
//! clustered, each item's leaf; and in the end each vertex' sample.

use std::path::Path;
use std::sync::Arc;

use bytemuck::cast_slice;
use memmap2::Mmap;
use rayon::prelude::*;

use super::lattice::Grid;
use crate::output::check_space;
use crate::scratch::Scratch;
use crate::{Error, Progress, Result};

/// Numbers written at a time, by the stream and by each thread.
const BUFFER: usize = 1 << 16;

/// Files of so many numbers: items, leaves and samples.
const FILES: u64 = 3;

const BYTES: u64 = size_of::<u32>() as u64;

/// No sample.
const NONE: u32 = u32::MAX;

const ADVICE: &str = "leave the triangles out with --skip triangles";

/// While the model streams.
///
/// Memory: 4 bytes per cell, and a buffer.
pub struct Membership {
    leaves: Arc<Leaves>,
    items: Scratch,
    buffer: Vec<u32>,
    written: u64,
}

/// The leaf of each item.
pub struct Leaves {
    file: Scratch,
    /// Where each cell's items and leaves begin.
    starts: Vec<u32>,
}

impl Membership {
    /// Most vertices: beyond it, nothing can refer to them.
    pub const MAX_VERTICES: u64 = NONE as u64;

    /// Of no vertex yet. The files go to `folder`.
    ///
    /// # Errors
    /// They cannot be made, or the disk has no room for them.
    pub fn new(grid: &Grid, vertices: u64, folder: &Path) -> Result<Self> {
        // Better known before a large model is clustered.
        check_space(folder, folder, FILES * BYTES * vertices)
            .map_err(|e| Error::new(e.kind(), e.to_string(), format!("{}; or {ADVICE}", e.hint())))?;
        let mut next = 0u32;
        let starts = grid.records.iter().map(|r| {
            let start = next;
            next = next.wrapping_add(r.count as u32);
            start
        });
        let leaves = Leaves { file: Scratch::new(folder, ADVICE)?, starts: starts.collect() };
        // Sparse: only so much is written as there are items.
        leaves.file.set_len(vertices * BYTES)?;
        Ok(Self {
            leaves: Arc::new(leaves),
            items: Scratch::new(folder, ADVICE)?,
            buffer: Vec::with_capacity(BUFFER),
            written: 0,
        })
    }

    /// For the threads that cluster.
    pub fn leaves(&self) -> Arc<Leaves> {
        self.leaves.clone()
    }

    /// The next vertex is part of an item of a cell, or of none.
    ///
    /// # Errors
    /// The file cannot be written.
    #[inline]
    pub fn push(&mut self, item: Option<(u32, u32)>) -> Result<()> {
        self.buffer.push(item.map_or(NONE, |(cell, index)| self.leaves.starts[cell as usize] + index));
        if self.buffer.len() == BUFFER { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        self.items.write_at(cast_slice(&self.buffer), self.written * BYTES)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Once all cells are clustered and their threads have dropped the [`Leaves`]. `starts` says from which leaf on
    /// leaves belong to which sample, ascending.
    ///
    /// # Errors
    /// A file cannot be written; the user cancelled.
    pub fn finish(
        mut self,
        starts: &[(u32, u32)],
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<SampleOf> {
        self.flush()?;
        let samples = Scratch::new(folder, ADVICE)?;
        let items = self.items.map()?;
        let items: &[u32] = cast_slice(&items);
        {
            let leaves = Arc::into_inner(self.leaves).expect("all threads are done").file.map()?;
            let leaves: &[u32] = cast_slice(&leaves);
            items.par_chunks(BUFFER).enumerate().try_for_each(|(chunk, items)| {
                progress.check()?;
                let mut found = Vec::with_capacity(items.len());
                // The leaves from the first to before the second are of the third.
                let (mut from, mut to, mut sample) = (0, 0, NONE);
                for item in items {
                    let Some(leaf) = leaves.get(*item as usize).copied() else {
                        found.push(NONE);
                        continue;
                    };
                    if leaf < from || leaf >= to {
                        let next = starts.partition_point(|(start, _)| *start <= leaf);
                        (from, sample) = next.checked_sub(1).map_or((0, NONE), |at| starts[at]);
                        to = starts.get(next).map_or(NONE, |(start, _)| *start);
                    }
                    found.push(sample);
                }
                progress.advance(found.len() as u64);
                samples.write_at(cast_slice(&found), (chunk * BUFFER) as u64 * BYTES)
            })?;
        }
        Ok(SampleOf(samples.map()?))
    }
}

impl Leaves {
    /// Notes the leaf, counted within the cell, of consecutive items of a cell.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn record(&self, cell: u32, first_item: u32, leaves: &mut [u32]) -> Result<()> {
        let start = self.starts[cell as usize];
        leaves.iter_mut().for_each(|leaf| *leaf += start);
        self.file.write_at(cast_slice(leaves), u64::from(start + first_item) * BYTES)
    }
}

/// The sample of each vertex.
pub struct SampleOf(Mmap);

impl SampleOf {
    /// The samples of all vertices; `u32::MAX` for those that have none, as their position is not finite.
    pub fn all(&self) -> &[u32] {
        cast_slice(&self.0)
    }
}
