//! Vertices of the model that are to be seen instead of samples, and which of them agree with the samples'
//! present positions.
//!
//! The vertices come cell by cell. A cell is *fresh* while the samples that decide on the positions of its
//! vertices are where they were when the cell was carried over; else the cell is *stale*, and its samples
//! stand for it again. So vertices that were streamed stay of use when a change is taken back.

use crate::engine::SamplePose;
use crate::tint::Tint;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_core::detail::{DetailBatch, DetailRequest};
use simod_core::touching::Contacts;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Part of the model that is to be seen in full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Previewed {
    /// The part that the camera sees when asked.
    Seen,
    /// The samples that are selected when asked.
    Selection,
    /// No part: samples everywhere.
    Nothing,
}

/// Vertices in pieces, in which they came.
///
/// Memory: 32 bytes for each vertex, 56 for each splat. There are at most twice as many vertices as were
/// [chosen](DetailRequest), as a piece is made anew when others have taken the place of more than half of
/// it; and in addition those that were chosen before, until they are replaced.
pub struct Detail {
    of: Previewed,
    chosen: DetailRequest,
    tint: Tint,
    /// State of each cell of the model: its vertices, if there are any.
    held: Vec<Option<HeldCell>>,
    pieces: BTreeMap<u64, DetailPiece>,
    made: u64,
    /// The samples as they are now.
    pose: SamplePose,
    covered: Arc<[bool]>,
    revision: u64,
}

/// Batch of vertices, with the cells of it that are shown.
pub struct DetailPiece {
    /// The vertices.
    pub batch: Arc<DetailBatch>,
    /// Colour values that the vertices came with.
    pub tint: Tint,
    /// Whether the vertices of each cell of the batch are shown.
    pub shown: Vec<bool>,
    /// Revision of the shown cells, which counts up with each change.
    pub revision: u64,
    /// Number of vertices whose place others took.
    dead: usize,
}

/// Vertices of a cell that are held, with the pose by which they were carried.
struct HeldCell {
    piece: u64,
    /// The number of the cell among those of its piece.
    run: usize,
    stride: u64,
    tint: Tint,
    pose: SamplePose,
    fresh: bool,
}

/// Numbers of vertices in full, for the user.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DetailCounts {
    /// Number of vertices that are shown ...
    pub vertices: u64,
    /// ... one of so many vertices that there are ...
    pub stride: u64,
    /// ... and number of vertices that are wanted.
    pub wanted: u64,
    /// Vertices of stale cells that are not shown, as a share of those that are wanted.
    pub stale: f64,
}

impl Detail {
    /// Detail that has no vertices yet.
    pub fn new(of: Previewed, chosen: DetailRequest, pose: SamplePose, tint: Tint) -> Self {
        let cells = pose.sampled.held_cells().map_or(0, |kept| kept.cells.len());
        let held = (0..cells).map(|_| None).collect();
        let covered = vec![false; pose.positions.len()].into();
        Self { of, chosen, tint, held, pieces: BTreeMap::new(), made: 0, pose, covered, revision: 0 }
    }

    /// Part of the model that the detail is of.
    pub fn previewed(&self) -> Previewed {
        self.of
    }

    /// Colour values that are wanted of the vertices.
    pub fn tint(&self) -> Tint {
        self.tint
    }

    /// Changes the colour values that are wanted of the vertices. Returns whether other vertices have to
    /// come for that: those that are there stay until then, and where samples have the colour, they are of
    /// use as they are.
    pub fn tint_by(&mut self, tint: Tint) -> bool {
        let before = std::mem::replace(&mut self.tint, tint);
        before != tint
    }

    /// The pieces, by numbers that are not given twice.
    pub fn pieces(&self) -> &BTreeMap<u64, DetailPiece> {
        &self.pieces
    }

    /// Whether each sample's place is taken by vertices.
    pub fn covered(&self) -> &Arc<[bool]> {
        &self.covered
    }

    /// Revision, which counts up when anything changes.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Changes the cells that are wanted, or the share of their vertices. Cells that are not wanted are let
    /// go; cells that are wanted with another share stay until that has come.
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

    /// Cells that are wanted and not there, or not fresh, or with another share or colour.
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

    /// Takes another pose, or other samples.
    pub fn follow(&mut self, pose: SamplePose) {
        if !pose.is(&self.pose) {
            self.pose = pose;
            self.compare();
            self.update();
        }
    }

    /// Numbers of vertices that are shown and wanted.
    pub fn figures(&self) -> DetailCounts {
        let [_, wanted] = self.chosen.vertices(&self.pose.sampled);
        let count = |fresh: bool| -> u64 {
            let held = self.held.iter().flatten().filter(|held| held.fresh == fresh);
            held.map(|held| self.pieces[&held.piece].batch.cells[held.run].1.len() as u64).sum()
        };
        let stale = count(false) as f64 / wanted.max(1) as f64;
        DetailCounts { vertices: count(true), stride: self.chosen.stride, wanted, stale: stale.min(1.0) }
    }

    /// Hides the vertices of a cell for good.
    fn bury(&mut self, held: &HeldCell) {
        if let Some(piece) = self.pieces.get_mut(&held.piece) {
            piece.dead += piece.batch.cells[held.run].1.len();
            piece.shown[held.run] = false;
            piece.revision += 1;
        }
    }

    /// Lets go of pieces of which nothing is shown, and of the dead part of pieces that are dead for the
    /// most part.
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

    /// Marks the cells that are fresh. Fresh cells then count as carried by the present pose.
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

    /// Shows the cells that are fresh, and hides the others.
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

/// Whether vertices around each sample have other positions by one pose than by another; nothing where all
/// have.
///
/// The position of a vertex follows from expansions at the samples around it, and these from the samples
/// around theirs: two rings of neighbours.
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
