//! Vertices of the model that are to be seen instead of samples, and which of them are where the samples are
//! now.
//!
//! They come cell by cell. A cell is *fresh* while the samples that decide where its vertices go are where
//! they were when it was carried over; else it is *stale*, and its samples stand for it again. So what was
//! streamed stays of use when a change is taken back.

use crate::engine::SamplePose;
use crate::tint::Tint;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_core::detail::{DetailBatch, DetailRequest};
use simod_core::touching::Contacts;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What is to be seen in full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Previewed {
    /// What the camera sees now.
    Seen,
    /// The samples that are selected now.
    Selection,
    /// Nothing: samples everywhere.
    Nothing,
}

/// Vertices in pieces, as they came.
///
/// Memory: 32 bytes for each vertex, 56 for each splat. There are at most twice as many as were
/// [chosen](DetailRequest), as a piece is made anew when others have taken the place of more than half of it;
/// and for what was chosen before, until that is replaced.
pub struct Detail {
    of: Previewed,
    chosen: DetailRequest,
    tint: Tint,
    /// What is held of each of the model's cells.
    held: Vec<Option<HeldCell>>,
    pieces: BTreeMap<u64, DetailPiece>,
    made: u64,
    /// The samples as they are now.
    pose: SamplePose,
    covered: Arc<[bool]>,
    revision: u64,
}

/// A batch, as much of it as is shown.
pub struct DetailPiece {
    /// The vertices.
    pub batch: Arc<DetailBatch>,
    /// What they have values of.
    pub tint: Tint,
    /// Whether those of each of its cells are shown.
    pub shown: Vec<bool>,
    /// Counts up when what is shown changes.
    pub revision: u64,
    /// Vertices that others took the place of.
    dead: usize,
}

/// What is held of a cell.
struct HeldCell {
    piece: u64,
    /// The number of the cell among those of its piece.
    run: usize,
    stride: u64,
    tint: Tint,
    pose: SamplePose,
    fresh: bool,
}

/// How much is shown in full.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DetailCounts {
    /// Number of vertices that are shown ...
    pub vertices: u64,
    /// ... one of so many that are there ...
    pub stride: u64,
    /// ... and so many are wanted.
    pub wanted: u64,
    /// Vertices of stale cells that are not shown, as a share of those that are wanted.
    pub stale: f64,
}

impl Detail {
    /// A detail of which nothing is there yet.
    pub fn new(of: Previewed, chosen: DetailRequest, pose: SamplePose, tint: Tint) -> Self {
        let cells = pose.sampled.held_cells().map_or(0, |kept| kept.cells.len());
        let held = (0..cells).map(|_| None).collect();
        let covered = vec![false; pose.positions.len()].into();
        Self { of, chosen, tint, held, pieces: BTreeMap::new(), made: 0, pose, covered, revision: 0 }
    }

    /// The part of the model that it is of.
    pub fn previewed(&self) -> Previewed {
        self.of
    }

    /// What vertices are to be coloured by.
    pub fn tint(&self) -> Tint {
        self.tint
    }

    /// Vertices are to be coloured by something else. Whether others have to come for that: those that are
    /// there stay until then, and where samples have the colour, they are of use as they are.
    pub fn tint_by(&mut self, tint: Tint) -> bool {
        let before = std::mem::replace(&mut self.tint, tint);
        before != tint
    }

    /// The pieces, by numbers that are not given twice.
    pub fn pieces(&self) -> &BTreeMap<u64, DetailPiece> {
        &self.pieces
    }

    /// Whether vertices are shown in the place of each sample.
    pub fn covered(&self) -> &Arc<[bool]> {
        &self.covered
    }

    /// Counts up when anything changes.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Other cells are wanted, or others of their vertices. What is there and not wanted is let go; what is
    /// wanted in another number stays until that has come.
    pub fn choose(&mut self, of: Previewed, chosen: DetailRequest) {
        (self.of, self.chosen) = (of, chosen);
        for cell in 0..self.held.len() {
            if self.chosen.cells.binary_search(&(cell as u32)).is_err()
                && let Some(held) = self.held[cell].take()
            {
                self.bury(&held);
            }
        }
        self.tidy();
        self.update();
    }

    /// The cells that are wanted and not there as they should be.
    pub fn missing(&self) -> DetailRequest {
        let stride = self.chosen.stride;
        let is_tinted = |held: &HeldCell| self.tint == Tint::Samples || held.tint == self.tint;
        let there = |held: &HeldCell| held.fresh && held.stride == stride && is_tinted(held);
        let missing =
            |cell: &&u32| !self.held.get(**cell as usize).is_some_and(|h| h.as_ref().is_some_and(there));
        let cells = self.chosen.cells.iter().filter(missing).copied().collect();
        DetailRequest { cells, ..self.chosen }
    }

    /// Takes vertices that were carried by a pose.
    pub fn take(&mut self, batch: DetailBatch, stride: u64, tint: Tint, pose: &SamplePose) {
        let piece = self.made;
        self.made += 1;
        let fresh = pose.is(&self.pose);
        for (run, (cell, _)) in batch.cells.iter().enumerate() {
            let new = HeldCell { piece, run, stride, tint, pose: pose.clone(), fresh };
            if let Some(held) = self.held.get_mut(*cell as usize)
                && let Some(former) = held.replace(new)
            {
                self.bury(&former);
            }
        }
        let shown = vec![fresh; batch.cells.len()];
        self.pieces.insert(piece, DetailPiece { batch: Arc::new(batch), tint, shown, revision: 0, dead: 0 });
        self.tidy();
        if !fresh {
            self.compare();
        }
        self.update();
    }

    /// The samples are somewhere else, or there are others.
    pub fn follow(&mut self, pose: SamplePose) {
        if !pose.is(&self.pose) {
            self.pose = pose;
            self.compare();
            self.update();
        }
    }

    /// The numbers of vertices and bytes.
    pub fn figures(&self) -> DetailCounts {
        let [_, wanted] = self.chosen.vertices(&self.pose.sampled);
        let count = |fresh: bool| -> u64 {
            let held = self.held.iter().flatten().filter(|held| held.fresh == fresh);
            held.map(|held| self.pieces[&held.piece].batch.cells[held.run].1.len() as u64).sum()
        };
        let stale = count(false) as f64 / wanted.max(1) as f64;
        DetailCounts { vertices: count(true), stride: self.chosen.stride, wanted, stale: stale.min(1.0) }
    }

    /// The vertices of a cell are not shown any more.
    fn bury(&mut self, held: &HeldCell) {
        if let Some(piece) = self.pieces.get_mut(&held.piece) {
            piece.dead += piece.batch.cells[held.run].1.len();
            piece.shown[held.run] = false;
            piece.revision += 1;
        }
    }

    /// Lets go of pieces that are dead, and of the dead part of those that are for the most part.
    fn tidy(&mut self) {
        let all = |piece: &DetailPiece| piece.batch.positions.len();
        let old: Vec<u64> =
            self.pieces.iter().filter(|(_, p)| 2 * p.dead > all(p)).map(|(number, _)| *number).collect();
        for number in old {
            let Some(former) = self.pieces.remove(&number) else { continue };
            let is_alive = |cell: u32, run: usize| {
                self.held[cell as usize].as_ref().is_some_and(|h| h.piece == number && h.run == run)
            };
            let kept: Vec<usize> = (0..former.batch.cells.len())
                .filter(|run| is_alive(former.batch.cells[*run].0, *run))
                .collect();
            if kept.is_empty() {
                continue;
            }
            let piece = self.made;
            self.made += 1;
            for (run, was) in kept.iter().enumerate() {
                if let Some(held) = &mut self.held[former.batch.cells[*was].0 as usize] {
                    (held.piece, held.run) = (piece, run);
                }
            }
            let shown = kept.iter().map(|run| former.shown[*run]).collect();
            let batch = Arc::new(part(&former.batch, &kept));
            self.pieces.insert(piece, DetailPiece { batch, tint: former.tint, shown, revision: 0, dead: 0 });
        }
    }

    /// Finds out which cells are fresh. These were carried by the pose as it is, too.
    fn compare(&mut self) {
        let mut known: Vec<(SamplePose, Option<Vec<bool>>)> = Vec::new();
        let Some(kept) = self.pose.sampled.held_cells() else { return };
        for (held, cell) in self.held.iter_mut().zip(&kept.cells) {
            let Some(held) = held else { continue };
            let at = known.iter().position(|(pose, _)| pose.is(&held.pose)).unwrap_or_else(|| {
                known.push((held.pose.clone(), elsewhere(&held.pose, &self.pose)));
                known.len() - 1
            });
            let moved = &known[at].1;
            held.fresh =
                moved.as_ref().is_some_and(|moved| !cell.tree.samples.iter().any(|s| moved[*s as usize]));
            if held.fresh {
                held.pose = self.pose.clone();
            }
        }
    }

    /// Brings what is shown up to what is fresh.
    fn update(&mut self) {
        self.revision += 1;
        for held in self.held.iter().flatten() {
            if let Some(piece) = self.pieces.get_mut(&held.piece)
                && piece.shown[held.run] != held.fresh
            {
                piece.shown[held.run] = held.fresh;
                piece.revision += 1;
            }
        }
        // A sample may stand for several cells.
        let mut covered = vec![false; self.pose.positions.len()];
        let Some(kept) = self.pose.sampled.held_cells() else { return };
        for fresh in [true, false] {
            let is_so = |held: &Option<HeldCell>| held.as_ref().is_some_and(|held| held.fresh) == fresh;
            let cells = kept.cells.iter().zip(&self.held).filter(|(_, held)| is_so(held));
            cells.flat_map(|(cell, _)| &cell.tree.samples).for_each(|s| covered[*s as usize] = fresh);
        }
        // The samples of several sheets stand for one cluster.
        for [sample, of] in self.pose.sampled.samples.contacts().map_or(&[][..], Contacts::parted) {
            covered[*sample as usize] = covered[*of as usize];
        }
        self.covered = covered.into();
    }
}

/// Whether vertices around each sample go elsewhere by one pose than by another; nothing where all do.
///
/// Where a vertex goes is told by expansions around it, and these by the samples around theirs: two rings of
/// neighbours.
fn elsewhere(a: &SamplePose, b: &SamplePose) -> Option<Vec<bool>> {
    if !Arc::ptr_eq(&a.sampled, &b.sampled) {
        return None;
    }
    if Arc::ptr_eq(&a.positions, &b.positions) {
        return Some(vec![false; a.positions.len()]);
    }
    let moved: Vec<bool> = a.positions.par_iter().zip(&*b.positions).map(|(p, q)| p != q).collect();
    if !moved.contains(&true) {
        return Some(moved);
    }
    let neighbours = a.sampled.samples.neighbours();
    let grown = |marks: Vec<bool>| -> Vec<bool> {
        let near = |i: usize| marks[i] || neighbours.nearest_to(i).iter().any(|j| marks[*j as usize]);
        (0..marks.len()).into_par_iter().map(near).collect()
    };
    Some(grown(grown(moved)))
}

/// Some cells of a batch.
fn part(batch: &DetailBatch, runs: &[usize]) -> DetailBatch {
    let mut part = DetailBatch::default();
    for run in runs {
        let (cell, range) = &batch.cells[*run];
        let (first, range) = (part.positions.len() as u32, range.start as usize..range.end as usize);
        part.positions.extend_from_slice(&batch.positions[range.clone()]);
        part.normals.extend_from_slice(&batch.normals[range.clone()]);
        part.spacing.extend_from_slice(&batch.spacing[range.clone()]);
        part.homes.extend_from_slice(&batch.homes[range.clone()]);
        part.axes.extend_from_slice(batch.axes.get(range.clone()).unwrap_or_default());
        part.values.extend(&batch.values, range);
        part.cells.push((*cell, first..part.positions.len() as u32));
    }
    part
}
