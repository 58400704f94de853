//! The sample of P_S that stands for each vertex of P_L, and the vertex' place: by these the faces of P_L
//! become triangles of P_S. Besides, the vertices at one place, as far as they are found in passing.
//!
//! As this is as large as P_L, it is in temporary files of 4 bytes per vertex: while the model streams, each
//! vertex' item (all cells' items are counted in one row, in which a cell has as many places as vertices),
//! and in the end its sample in the same place; and once a cell is clustered, each item's leaf. Where faces
//! place the samples, positions take 12 bytes more, and 4 where these tell sheets apart.

use std::path::Path;
use std::sync::Arc;

use bytemuck::{cast_slice, cast_slice_mut};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_model::mapped::{Map, MapMut, looked_at};
use simod_model::scratch::Scratch;
use simod_model::{ModelInfo, Progress, Result};

use super::grid::{CellRecord, Grid};
use crate::touching::{FoundTwins, Twins};

/// Numbers written at a time, by the stream and by each thread.
const BUFFER: usize = 1 << 16;

/// Positions written at a time.
const POSITIONS: usize = 1 << 14;

/// Number of files with a number for each vertex: of items and later samples, and of leaves.
const FILES: u64 = 2;

/// Samples before and behind the last one, among which the next is looked for first: a few cells have as
/// many.
const AROUND: usize = 256;

const BYTES: u64 = size_of::<u32>() as u64;

/// No sample.
const NONE: u32 = u32::MAX;

const ADVICE: &str = "do without the faces, by --skip triangles,sheets and --place vertices";

/// While the model streams.
///
/// Memory: 4 bytes per cell, 16 for each list of vertices, and two buffers.
pub struct Membership {
    leaves: Arc<Leaves>,
    items: Scratch,
    buffer: Vec<u32>,
    written: u64,
    /// Number of each list of vertices, and the number of vertices before the list.
    lists: Vec<(u32, u64)>,
    positions: Option<Positions>,
    twins: Option<Twins>,
}

/// Choice of what is recorded of the vertices, beside their samples.
#[derive(Clone, Copy)]
pub struct Noted {
    /// Whether the positions of the vertices are recorded.
    pub positions: bool,
    /// Whether vertices at the same position are, as far as [`Twins`] finds them.
    pub twins: bool,
}

/// File of each vertex's position, local coordinates.
struct Positions {
    file: Scratch,
    buffer: Vec<Vec3>,
    written: u64,
}

/// The leaf of each item.
pub struct Leaves {
    file: Scratch,
    /// First number of each cell's items, and of its leaves.
    starts: Vec<u32>,
}

impl Membership {
    /// Largest number of vertices: faces cannot refer to more.
    pub const MAX_VERTICES: u64 = NONE as u64;

    /// Table without members yet, of a model of which `coming` vertices come. The files go to `folder`.
    ///
    /// # Errors
    /// The files cannot be made, or the disk has no room for them.
    pub fn new(grid: &Grid, info: &ModelInfo, coming: u64, noted: Noted, folder: &Path) -> Result<Self> {
        let vertices = info.vertices;
        // Better known before a large model is clustered.
        let bytes = FILES * BYTES
            + if noted.positions { size_of::<Vec3>() as u64 } else { 0 }
            + if noted.twins { BYTES } else { 0 };
        Scratch::check_space(folder, bytes.saturating_mul(coming), ADVICE)?;
        let leaves = Leaves { file: Scratch::new(folder, ADVICE)?, starts: starts(grid) };
        // Sparse: only so much is written as there are items.
        leaves.file.set_len(vertices * BYTES)?;
        Ok(Self {
            leaves: Arc::new(leaves),
            items: Scratch::new(folder, ADVICE)?,
            buffer: Vec::with_capacity(BUFFER),
            written: 0,
            lists: Vec::new(),
            positions: noted.positions.then(|| Positions::new(folder)).transpose()?,
            twins: noted.twins.then(|| Twins::new(vertices, info.faces, folder)).transpose()?,
        })
    }

    /// Leaves of the items, for the threads that cluster.
    pub fn leaves(&self) -> Arc<Leaves> {
        self.leaves.clone()
    }

    /// Looks for twins of the next vertices, at these positions in the model's coordinates: before they are
    /// [pushed](Self::push).
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn look_for_twins(&mut self, positions: &[DVec3]) -> Result<()> {
        self.twins.as_mut().map_or(Ok(()), |twins| twins.take(positions))
    }

    /// The next vertex is part of an item of a cell, or of none, and at this place, in local coordinates.
    ///
    /// # Errors
    /// The file cannot be written.
    #[inline]
    pub fn push(&mut self, item: Option<(u32, u32)>, position: Vec3) -> Result<()> {
        if let Some(positions) = &mut self.positions {
            positions.push(position)?;
        }
        self.buffer.push(item.map_or(NONE, |(cell, index)| self.leaves.starts[cell as usize] + index));
        if self.buffer.len() == BUFFER { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        self.items.write_at(cast_slice(&self.buffer), self.written * BYTES)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// The vertices that come next are of the list of a number.
    pub fn begin_list(&mut self, list: u32) {
        if self.lists.last().is_none_or(|(last, _)| *last != list) {
            self.lists.push((list, self.written + self.buffer.len() as u64));
        }
    }

    /// Visits the leaf of each vertex, once all cells are clustered and their threads have dropped the
    /// [`Leaves`]: some vertices at a time, all of one list, whose number comes with them; 0 where none was
    /// begun. Leaves are counted as in [`finish`](Self::finish), and that of no vertex is `u32::MAX`.
    ///
    /// # Errors
    /// A file cannot be written; `visit` failed.
    pub fn each_leaf(mut self, mut visit: impl FnMut(u32, &[u32]) -> Result<()>) -> Result<()> {
        self.flush()?;
        let leaves = Arc::into_inner(self.leaves).expect("all threads are done").file.map()?;
        let leaves: &[u32] = cast_slice(&leaves);
        let begins = std::iter::once((0, 0)).chain(self.lists.iter().copied());
        let ends = self.lists.iter().map(|(_, start)| *start).chain([self.written]);
        let mut some = Vec::new();
        for ((list, start), end) in begins.zip(ends) {
            let mut at = start;
            while at < end {
                some.resize(BUFFER.min((end - at) as usize), 0);
                self.items.read_at(cast_slice_mut(&mut some), at * BYTES)?;
                some.iter_mut().for_each(|item| *item = leaves.get(*item as usize).copied().unwrap_or(NONE));
                looked_at(size_of_val(&some[..]));
                visit(list, &some)?;
                at += some.len() as u64;
            }
        }
        Ok(())
    }

    /// Once all cells are clustered and their threads have dropped the [`Leaves`]. `starts` says from which
    /// leaf on leaves belong to which sample, ascending.
    ///
    /// # Errors
    /// A file cannot be written; the user cancelled.
    pub fn finish(mut self, starts: &[(u32, u32)], progress: &dyn Progress) -> Result<SampleOf> {
        self.flush()?;
        let leaves = Arc::into_inner(self.leaves).expect("all threads are done").file.map()?;
        let leaves: &[u32] = cast_slice(&leaves);
        let chunks = 0..self.written.div_ceil(BUFFER as u64);
        chunks.into_par_iter().try_for_each(|chunk| {
            progress.check()?;
            let first = chunk * BUFFER as u64;
            let mut chunk = vec![0; BUFFER.min((self.written - first) as usize)];
            self.items.read_at(cast_slice_mut(&mut chunk), first * BYTES)?;
            let mut samples = LeafSamples::new(starts);
            for item in &mut chunk {
                *item = leaves.get(*item as usize).map_or(NONE, |leaf| samples.sample_of(*leaf));
            }
            looked_at(size_of_val(&chunk[..]));
            progress.advance(chunk.len() as u64);
            self.items.write_at(cast_slice(&chunk), first * BYTES)
        })?;
        let positions = self.positions.map(Positions::finish).transpose()?;
        let twins = self.twins.map(Twins::finish).transpose()?;
        Ok(SampleOf { samples: self.items.map_mut()?, positions, twins })
    }
}

/// First number of each cell's items, and of its leaves.
pub fn starts(grid: &Grid) -> Vec<u32> {
    let mut next = 0u32;
    let start = |record: &CellRecord| {
        let start = next;
        next = next.wrapping_add(record.count as u32);
        start
    };
    grid.records.iter().map(start).collect()
}

/// Finds samples by leaves.
pub struct LeafSamples<'a> {
    /// First leaf of each sample's leaves, and the sample, ascending.
    starts: &'a [(u32, u32)],
    /// The leaves from the first to before the second are of the third.
    from: u32,
    to: u32,
    sample: u32,
    last: usize,
}

impl<'a> LeafSamples<'a> {
    /// Table of these starts.
    pub fn new(starts: &'a [(u32, u32)]) -> Self {
        Self { starts, from: 0, to: 0, sample: NONE, last: 0 }
    }

    /// The sample of a leaf.
    #[inline]
    pub fn sample_of(&mut self, leaf: u32) -> u32 {
        if leaf < self.from || leaf >= self.to {
            let next = next_start(self.starts, leaf, self.last);
            self.last = next;
            (self.from, self.sample) = next.checked_sub(1).map_or((0, NONE), |at| self.starts[at]);
            self.to = self.starts.get(next).map_or(NONE, |(start, _)| *start);
        }
        self.sample
    }
}

/// The first of the ascending starts that is behind a leaf. It is probably `near` one, as the vertices of a
/// cell follow each other: those around it are still in the processor's cache.
fn next_start(starts: &[(u32, u32)], leaf: u32, near: usize) -> usize {
    let is_before = |(start, _): &(u32, u32)| *start <= leaf;
    let (low, high) = (near.saturating_sub(AROUND), (near + AROUND).min(starts.len()));
    let inside = starts[low..high].partition_point(is_before);
    let is_whole = (low == 0 || inside > 0) && (high == starts.len() || low + inside < high);
    if is_whole { low + inside } else { starts.partition_point(is_before) }
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

impl Positions {
    fn new(folder: &Path) -> Result<Self> {
        Ok(Self { file: Scratch::new(folder, ADVICE)?, buffer: Vec::with_capacity(POSITIONS), written: 0 })
    }

    #[inline]
    fn push(&mut self, position: Vec3) -> Result<()> {
        self.buffer.push(position);
        if self.buffer.len() == POSITIONS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        self.file.write_at(cast_slice(&self.buffer), self.written)?;
        self.written += size_of_val(&self.buffer[..]) as u64;
        self.buffer.clear();
        Ok(())
    }

    fn finish(mut self) -> Result<Map> {
        self.flush()?;
        self.file.map()
    }
}

/// The sample of each vertex.
pub struct SampleOf {
    samples: MapMut,
    positions: Option<Map>,
    twins: Option<FoundTwins>,
}

impl SampleOf {
    /// Samples of all vertices, from a file of them.
    pub fn of_all(samples: MapMut) -> Self {
        Self { samples, positions: None, twins: None }
    }

    /// The samples of all vertices; `u32::MAX` for those that have none, as their position is not finite.
    pub fn all(&self) -> &[u32] {
        cast_slice(&self.samples)
    }

    /// The vertices at the same position, if they were wanted.
    pub fn take_twins(&mut self) -> Option<FoundTwins> {
        self.twins.take()
    }

    /// The sample of each vertex, to be changed, and where the vertices are (local coordinates), if that was
    /// wanted.
    pub fn all_mut(&mut self) -> (&mut [u32], Option<&[Vec3]>) {
        (cast_slice_mut(&mut self.samples), self.positions.as_ref().map(|map| cast_slice(map)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_next_start_is_found_wherever_it_is_looked_for(
            gaps in proptest::collection::vec(1..9u32, 0..2000), leaf in 0..12_000u32, near in 0..2000usize,
        ) {
            let starts: Vec<_> = gaps.iter().scan(0, |sum, gap| { *sum += gap; Some((*sum, 0)) }).collect();
            let expected = starts.iter().filter(|(start, _)| *start <= leaf).count();
            prop_assert_eq!(next_start(&starts, leaf, near.min(starts.len())), expected);
        }
    }
}
