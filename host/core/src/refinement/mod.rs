//! Local refinement (paper §6): more samples where the user asks, appended to P_S.
//!
//! The cells that the selection meets are known from the cells that sampling kept. Only their ranges of the
//! model are read (`gathering`), their trees go on from where they stopped (`regrowing`) down to a smaller
//! error inside the selection and a rising one around it (`selection`), and the clusters below the former
//! samples become new ones (`appending`), with triangles from the model's faces (`faces`). Refinement works
//! again and again, down to the vertices themselves.

mod appending;
mod faces;
pub(crate) mod gathering;
mod needs;
mod record;
mod regrowing;
mod selection;
mod sizing;
#[cfg(test)]
pub(crate) mod tests;

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::OnceLock;

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_model::size::human_size;
use simod_model::{Error, ErrorKind, Model, Progress, Result, memory};

pub use record::Refinement;
pub use selection::SpaceSelection;

use crate::colors;
use crate::reconstruction::{DeformationField, carry_positions};
use crate::sampled_model::SampledModel;
use crate::sampling::cut::{self, threshold_for};
use crate::sampling::grid::CellMap;
use crate::sampling::kept_cells::{KeptCell, KeptCells};
use crate::sampling::ranges::joined;
use crate::sampling::{LEAST_MEMORY, Placement};
use crate::touching::{ContactVertices, Contacts, Guides, InheritedSheets};
use appending::{Appended, append};
use faces::ReadMembers;
use gathering::{GatheredCell, Gathering};
use needs::Needs;
use regrowing::{ChangedModel, Regrowing, Regrown};
use selection::{LeafEstimate, Selected};
use sizing::Sizing;

/// Fineness of P_S where it is selected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Finer {
    /// Largest error of a cluster there, as a fraction of the diagonal; 0 gives every vertex a sample of its
    /// own.
    Error(f64),
    /// Factor by which the number of samples there grows, about.
    Factor(f64),
    /// Number of new samples, about.
    Samples(u64),
    /// Fineness that the deformation so far needs: more samples around those where the reconstruction is
    /// expected ([`DeformationField::expected_error`]) to be off by more than this.
    Auto {
        /// Transfer error that is allowed, as a fraction of the diagonal; [`Finer::ALLOWED`], if no other is
        /// given.
        error: f64,
        /// Largest number of new samples, for the worst places; a quarter of those that there are, where not
        /// given.
        samples: Option<u64>,
    },
}

impl Finer {
    /// A transfer error that hardly anybody sees, as a fraction of the diagonal.
    pub const ALLOWED: f64 = 1e-5;

    /// Number of new samples that are allowed for each sample that there is, unless another number is given.
    const SHARE: f64 = 0.25;

    /// Numbers of samples that may be asked for.
    const COUNTS: RangeInclusive<u64> = 1..=u32::MAX as u64;

    /// Whether the numbers are in their range: an error that is finite and not negative (positive for
    /// `Auto`), a finite factor above 1, a count from 1 to 2³² − 1.
    pub fn makes_sense(&self) -> bool {
        let is_count = |n: u64| Self::COUNTS.contains(&n);
        match *self {
            Self::Error(e) => e.is_finite() && e >= 0.0,
            Self::Factor(f) => f.is_finite() && f > 1.0,
            Self::Samples(n) => is_count(n),
            Self::Auto { error, samples } => error.is_finite() && error > 0.0 && samples.is_none_or(is_count),
        }
    }
}

/// Request of a refinement.
#[derive(Debug, Clone)]
pub struct Refining {
    /// The fineness that is wanted.
    pub finer: Finer,
    /// Bytes of memory to stay below; as for sampling where not given.
    pub memory_limit: Option<u64>,
    /// The selected shapes, as the sampled model's record of its refinements gets them.
    pub shapes: Vec<toml::Table>,
}

/// The figures of a refinement that was done.
pub struct Refined {
    /// The sampled model with the new samples; `None` if there was nothing to refine.
    pub sampled: Option<SampledModel>,
    /// Number of new samples.
    pub added: u64,
    /// The error bound inside the selection, as a fraction of the diagonal.
    pub error: f64,
    /// Number of samples that the deformation needs, if that was asked for.
    pub need: Option<SamplesNeed>,
    /// Number of cells that were read.
    pub cells: u64,
    /// Bytes of the model's vertices that were read.
    pub vertex_bytes: u64,
    /// Bytes of the model's faces that were read.
    pub face_bytes: u64,
}

/// The samples that a deformation needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamplesNeed {
    /// The largest transfer error that is expected around a selected sample, before; a fraction of the
    /// diagonal.
    pub expected: f64,
    /// Error that the new samples allow: the one asked for, or more, if there may not be enough of them; a
    /// fraction of the diagonal.
    pub allowed: f64,
    /// Number of samples around which more than that was expected, and others would help.
    pub samples: u64,
    /// Whether the expected error was nowhere more than the one that was asked for.
    pub is_met: bool,
}

impl SamplesNeed {
    /// Reason why no samples are added though more is expected than was asked for.
    pub const NONE_LEFT: &str = "there are no vertices left there that could be samples";
}

/// Largest number of bytes of vertices, and of what they take, that are in work at a time: cells come in
/// batches of this size, unless one is larger.
const BATCH: u64 = 96 << 20;

/// Bytes that a new sample takes until P_S is complete: 1.4 nodes, before and after the cut, and the tree's
/// and its own.
const BYTES_PER_SAMPLE: u64 = 200;

/// Ratio of leaves to the target number above which trees are cut back ...
const KEEP_AT_MOST: f64 = 1.6;
/// ... and the ratio to which they are.
const PRUNE_TO: f64 = 1.2;

/// Number of samples of which one may be missing of the target, where sheets share clusters: their samples
/// come with those of the trees.
const NEAR_TARGET: usize = 64;

/// Factor by which a bound has to be less than the one that the number of samples foretells, to be low
/// enough, mostly.
const FORESIGHT: f64 = 3.0;

/// Refines a sampled model, whose cells are held, where it is selected. Temporary files without a name are
/// made in `folder`, of 4 bytes per vertex that is read, if there are triangles, 12 more where faces place
/// the samples, and 16 near places where sheets meet.
///
/// Memory: below the limit, for any selection. Cells come in batches of at most 96 MiB, or one at a time; 240
/// bytes for each of their vertices. The new samples take 200 bytes each, at most half of the limit. P_S
/// itself comes on top.
///
/// # Errors
/// The selection does not meet the model; the model cannot be read, or is not what was sampled; a target that
/// is out of range, or more than memory holds; the user cancelled.
pub fn refine(
    sampled: &SampledModel,
    model: &dyn Model,
    selection: SpaceSelection<'_>,
    how: &Refining,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Refined> {
    check(how)?;
    let kept = sampled.checked_cells()?;
    progress.begin("selecting", 0);
    let (sizing, need) = sized(sampled, selection, how.finer)?;
    let Some(sizing) = sizing else { return Ok(Refined { need, ..Refined::nothing() }) };
    let leaves = sizing.leaves(sampled, kept);
    if !leaves.iter().flatten().any(|leaf| leaf.inside) {
        return Err(meets_nothing());
    }
    let contacts = sampled.samples.contacts();
    let near = OnceLock::new();
    let guides = contacts.map(|contacts| Guides::new(&sampled.samples, contacts, &near));
    let guides = guides.as_ref();
    let call = RefinementCall { sampled, kept, model, sizing, leaves, guides, how, folder, progress };
    let GrownTrees { bound, cells, members, noted, figures } = call.regrow_all()?;
    progress.begin("completing the samples", 0);
    let mut appended = append(kept, &sampled.samples.positions, &cells, bound, guides);
    drop(cells);
    let added = appended.positions.len() as u64;
    let error = f64::from(bound) / sampled.local_diagonal().max(f64::MIN_POSITIVE);
    let mut refined = Refined { added, error, need, ..figures };
    if added == 0 {
        return Ok(refined);
    }
    let mut triangles = Vec::new();
    if let Some(members) = members {
        (triangles, refined.face_bytes) = call.reindex(members, &mut appended, bound)?;
    }
    progress.check()?;
    let transfer_error = need.map(|need| need.allowed);
    let record = Refinement { shapes: how.shapes.clone(), error, added, transfer_error };
    let mut with_new = call.complete(appended, triangles, record, noted)?;
    if sampled.colors.len() == sampled.samples.len() {
        with_new.colors = [&sampled.colors[..], &call.new_colors(&with_new)?].concat();
    }
    refined.sampled = Some(with_new);
    Ok(refined)
}

/// Sizes of clusters for a fineness where a selection is, and the samples that the deformation needs, for
/// [`Finer::Auto`] alone; no sizes, if the deformation needs no samples.
fn sized<'a>(
    sampled: &'a SampledModel,
    selection: SpaceSelection<'a>,
    finer: Finer,
) -> Result<(Option<Sizing<'a>>, Option<SamplesNeed>)> {
    match finer {
        Finer::Auto { error, samples } => {
            let (need, needs) = needs(sampled, selection, error, samples)?;
            Ok((needs.map(Sizing::Needed), Some(need)))
        }
        _ => Ok((Some(Sizing::Selected(Selected::new(selection, sampled.frame))), None)),
    }
}

/// Deformed positions (in the model's coordinates) of the samples that a refinement has appended, from
/// `first` on, by a deformation of the samples before, or of those among them that are around.
pub fn appended_deformed(refined: &SampledModel, first: usize, field: &DeformationField<'_>) -> Vec<DVec3> {
    let rest = refined.samples.positions.get(first..).unwrap_or_default();
    let rest: Vec<DVec3> = rest.iter().map(|p| refined.frame.to_model(*p)).collect();
    carry_positions(field, &refined.frame, &rest)
}

impl Refined {
    /// Figures of a refinement that has read and added nothing.
    fn nothing() -> Self {
        Self { sampled: None, added: 0, error: 0.0, need: None, cells: 0, vertex_bytes: 0, face_bytes: 0 }
    }
}

fn meets_nothing() -> Error {
    Error::argument(
        "the selection does not meet the model: nothing is refined",
        "give shapes in the model's coordinates; `simod info` tells its bounding box",
    )
}

/// Samples that the deformation so far needs inside a selection, for a transfer error (a fraction of the
/// diagonal) and a number of samples at most; no sizes, if it needs none.
fn needs<'a>(
    sampled: &'a SampledModel,
    selection: SpaceSelection<'_>,
    error: f64,
    samples: Option<u64>,
) -> Result<(SamplesNeed, Option<Needs<'a>>)> {
    let selected = selection.samples(sampled);
    if !selected.contains(&true) {
        return Err(meets_nothing());
    }
    let mut expected = selection.so_far.map_or(vec![0.0; selected.len()], DeformationField::expected_error);
    if let Some(i) = expected.iter().position(|e| !e.is_finite()) {
        return Err(Error::argument(
            format!("the deformation around sample {i} is no finite number"),
            "correct the deformed samples",
        ));
    }
    expected.iter_mut().zip(&selected).filter(|(_, selected)| !**selected).for_each(|(e, _)| *e = 0.0);
    let diagonal = sampled.local_diagonal().max(f64::MIN_POSITIVE);
    let budget = samples.unwrap_or((Finer::SHARE * selected.len() as f64).ceil() as u64);
    let budget = usize::try_from(budget).unwrap_or(usize::MAX);
    let (allowed, most) = ((error * diagonal) as f32, expected.iter().copied().fold(0.0, f32::max));
    let needs = Needs::new(sampled, &sampled.cluster_errors()?, &expected, allowed, budget);
    let need = SamplesNeed {
        expected: f64::from(most) / diagonal,
        allowed: needs.as_ref().map_or(error, |needs| f64::from(needs.allowed) / diagonal),
        samples: needs.as_ref().map_or(0, |needs| needs.needy as u64),
        is_met: most <= allowed,
    };
    Ok((need, needs))
}

fn check(how: &Refining) -> Result<()> {
    if how.finer.makes_sense() {
        return Ok(());
    }
    let bad = match how.finer {
        Finer::Error(e) => format!("the error bound {e}"),
        Finer::Factor(f) => format!("the factor {f}"),
        Finer::Samples(n) => format!("the number of {n} samples"),
        Finer::Auto { samples: Some(n), .. } if !Finer::COUNTS.contains(&n) => {
            format!("the number of {n} samples")
        }
        Finer::Auto { error, .. } => format!("the transfer error {error}"),
    };
    let most = Finer::COUNTS.end();
    Err(Error::argument(
        format!("{bad} is out of range"),
        format!(
            "give an error of 0 or more (a fraction of the diagonal), a factor above 1, or from 1 to {most} samples"
        ),
    ))
}

/// A refinement at work.
struct RefinementCall<'a, 'g> {
    sampled: &'a SampledModel,
    kept: &'a KeptCells,
    model: &'a dyn Model,
    sizing: Sizing<'a>,
    /// Estimates of each leaf of each cell, before the model is read.
    leaves: Vec<Vec<LeafEstimate>>,
    /// Contacts where the model touches itself, with the sheet of each vertex there.
    guides: Option<&'a Guides<'g>>,
    how: &'a Refining,
    folder: &'a Path,
    progress: &'a dyn Progress,
}

/// Trees as they grow, batch by batch.
struct GrowingTrees {
    /// Bound on the error of clusters, local units; a cluster with more is split. The bound rises where there
    /// would be more samples than were asked for.
    bound: f32,
    regrown: Vec<Regrown>,
    /// Nodes that were built so far.
    built: u32,
    members: Option<ReadMembers>,
    noted: Option<ContactVertices>,
}

impl GrowingTrees {
    /// Adds one more cell, whose leaves are counted on from those before.
    fn push(&mut self, mut cell: Regrown, leaves_from: u32) -> Result<()> {
        cell.count_from(self.built, leaves_from);
        self.built = self.built.wrapping_add(cell.built);
        if let Some(members) = &self.members {
            members.note(&mut cell)?;
        }
        self.regrown.push(cell);
        Ok(())
    }
}

/// The goal of a refinement.
#[derive(Clone, Copy)]
struct RefinementGoal {
    /// Least bound that is tried, local units.
    least: f32,
    /// Number of new samples; `None` if the bound alone decides.
    samples: Option<usize>,
    /// Whether fewer samples than that will do.
    at_most: bool,
}

/// A cell that is read, and which of its leaves may be split.
type Met = (u32, Vec<bool>);

/// Trees that have grown.
struct GrownTrees {
    /// Nodes of a larger error than this are split; local units.
    bound: f32,
    cells: Vec<Regrown>,
    /// The vertices of the cells, where faces are looked at.
    members: Option<ReadMembers>,
    /// The vertices near contacts, where there are such.
    noted: Option<ContactVertices>,
    /// Figures of the vertices and faces that were read.
    figures: Refined,
}

impl RefinementCall<'_, '_> {
    fn limit(&self) -> u64 {
        self.how.memory_limit.unwrap_or_else(|| (memory::of_machine() / 4).min(2 << 30)).max(LEAST_MEMORY)
    }

    fn goal(&self) -> RefinementGoal {
        let mut inside: Vec<f32> =
            self.leaves.iter().flatten().filter(|leaf| leaf.inside).map(|leaf| leaf.error).collect();
        let there = inside.len().max(1) as f64;
        let more = match self.how.finer {
            Finer::Error(e) => {
                let least = (e * self.sampled.local_diagonal()) as f32;
                return RefinementGoal { least, samples: None, at_most: false };
            }
            Finer::Factor(f) => (f - 1.0) * there,
            Finer::Samples(n) => n as f64,
            Finer::Auto { samples, .. } => {
                let least = if let Sizing::Needed(needs) = &self.sizing { needs.least } else { 0.0 };
                let most =
                    samples.unwrap_or((Finer::SHARE * self.sampled.samples.len() as f64).ceil() as u64);
                let most = most.min(self.most_samples());
                return RefinementGoal { least, samples: usize::try_from(most).ok(), at_most: true };
            }
        };
        // Halving the size of clusters makes four of one, and their errors half as large or less.
        let middle = inside.len() / 2;
        let typical = *inside.select_nth_unstable_by(middle, f32::total_cmp).1;
        let least = f64::from(typical) / (FORESIGHT * (1.0 + more / there));
        RefinementGoal { least: least as f32, samples: Some(more.round().min(1e12) as usize), at_most: false }
    }

    /// The leaves of each cell that may be split at a bound.
    fn wanted(&self, bound: f32) -> Vec<Met> {
        let may = |leaf: &LeafEstimate| leaf.error - leaf.slack > bound;
        let cells = self.leaves.iter().zip(0..).filter(|(leaves, _)| leaves.iter().any(may));
        cells.map(|(leaves, cell)| (cell, leaves.iter().map(may).collect())).collect()
    }

    /// Grows the trees of all cells that the selection meets.
    fn regrow_all(&self) -> Result<GrownTrees> {
        let goal = self.goal();
        if let Some(done) = self.regrow(goal)? {
            return Ok(done);
        }
        // The bound that was foretold from the samples was too coarse.
        match self.regrow(RefinementGoal { least: 0.0, ..goal })? {
            Some(done) => Ok(done),
            None => unreachable!("down to the vertices, no bound is too coarse"),
        }
    }

    /// Grows the trees of the cells that the selection meets down to the least bound; `None` if that is too
    /// coarse for the number of samples.
    fn regrow(&self, goal: RefinementGoal) -> Result<Option<GrownTrees>> {
        let mut cells = self.wanted(goal.least);
        let members = self.members_of(&mut cells)?;
        let gathering = self.gathering();
        self.tell_scattered(&gathering, &cells);
        let noted = self.guides.map(|_| ContactVertices::new(self.folder)).transpose()?;
        let mut growing = GrowingTrees { bound: goal.least, regrown: Vec::new(), built: 0, members, noted };
        let mut vertex_bytes = 0;
        for batch in self.batches(&cells)? {
            let (gathered, bytes) = self.read(&gathering, batch)?;
            vertex_bytes += bytes;
            self.grow(&mut growing, gathered, batch)?;
            self.keep_within_limit(&mut growing, goal)?;
        }
        let GrowingTrees { mut bound, regrown, members, noted, .. } = growing;
        if let Some(target) = goal.samples {
            let threshold = self.threshold(&regrown, bound, target)?;
            if !goal.at_most && threshold < bound && bound == goal.least && goal.least > 0.0 {
                return Ok(None);
            }
            bound = bound.max(threshold);
        }
        let figures = Refined { cells: cells.len() as u64, vertex_bytes, ..Refined::nothing() };
        Ok(Some(GrownTrees { bound, cells: regrown, members, noted, figures }))
    }

    /// File in which the leaves of the cells' vertices are noted, if there are triangles; `cells` then gets
    /// the cells around as well, which have vertices of the same faces.
    fn members_of(&self, cells: &mut Vec<Met>) -> Result<Option<ReadMembers>> {
        if self.sampled.triangles.is_empty() || cells.is_empty() {
            return Ok(None);
        }
        self.add_neighbours(cells);
        let by_faces = self.sampled.sampling.placement == Placement::Faces;
        ReadMembers::new(self.sampled.source.vertices, by_faces, self.folder).map(Some)
    }

    fn gathering(&self) -> Gathering<'_> {
        let Self { sampled, kept, model, .. } = *self;
        Gathering {
            model,
            kept,
            frame: sampled.frame,
            cubes: sampled.cubes(),
            with_ids: !sampled.triangles.is_empty(),
            attributes: 0,
            opaque: sampled.opaque(model),
        }
    }

    /// Vertices of a batch of cells, and the number of their bytes in the model.
    fn read(&self, gathering: &Gathering<'_>, batch: &[Met]) -> Result<(Vec<GatheredCell>, u64)> {
        let places: Vec<u32> = batch.iter().map(|(cell, _)| *cell).collect();
        self.progress.begin("reading the cells", gathering.bytes_of(&places));
        gathering.read(&places, self.progress)?.ok_or_else(|| self.changed())
    }

    /// Grows the trees of a batch of cells by their vertices.
    fn grow(&self, growing: &mut GrowingTrees, mut gathered: Vec<GatheredCell>, batch: &[Met]) -> Result<()> {
        let Self { sampled, kept, progress, .. } = self;
        if let Some(members) = &growing.members {
            gathered.iter().try_for_each(|cell| members.note_positions(cell))?;
        }
        progress.begin("refining", 0);
        if let Some(guides) = self.guides {
            gathered.iter_mut().try_for_each(|cell| self.guide(guides, cell, growing.noted.as_mut()))?;
        }
        let how = Regrowing {
            rule: sampled.rule(),
            sizing: &self.sizing,
            bound: growing.bound,
            leaves_from: sampled.samples.len() as u32,
            guides: self.guides,
        };
        let found: Result<Vec<Regrown>> = gathered
            .into_par_iter()
            .zip(batch)
            .map(|(gathered, (_, wanted)): (GatheredCell, _)| {
                progress.check()?;
                let cell = &kept.cells[gathered.cell as usize];
                how.regrow(gathered, cell, wanted).map_err(|ChangedModel| self.changed())
            })
            .collect();
        found?.into_iter().try_for_each(|cell| growing.push(cell, how.leaves_from))
    }

    /// Finds the side of each vertex of a cell near a contact, and notes it.
    fn guide(
        &self,
        guides: &Guides<'_>,
        cell: &mut GatheredCell,
        noted: Option<&mut ContactVertices>,
    ) -> Result<()> {
        if guides.concern(&self.kept.cells[cell.cell as usize].tree.samples) {
            let vertices = cell.vertices.iter().map(|v| v.position);
            cell.guides = guides.find(&self.sampled.frame, vertices);
        }
        let Some(noted) = noted else { return Ok(()) };
        let all = cell.vertices.iter().zip(&cell.guides).map(|(v, guide)| (v.position, *guide));
        noted.note(all.filter(|(_, guide)| guides.concern(&[*guide])))
    }

    /// Cuts the trees back where they have far more leaves than are asked for.
    ///
    /// # Errors
    /// By the bound alone, there are more samples than memory holds.
    fn keep_within_limit(&self, growing: &mut GrowingTrees, goal: RefinementGoal) -> Result<()> {
        let Self { sampled, kept, .. } = self;
        let more = splits(&growing.regrown, kept).map(|(_, added)| u64::from(added)).sum::<u64>();
        let most = self.most_samples();
        if let Some(target) = goal.samples
            && more as f64 > KEEP_AT_MOST * target.max(1024) as f64
        {
            let keep = (PRUNE_TO * target.max(1024) as f64) as usize;
            growing.bound = growing.bound.max(threshold_for(splits(&growing.regrown, kept), 0, keep));
            for cell in &mut growing.regrown {
                let tree = &kept.cells[cell.cell as usize].tree;
                cell.grown.iter_mut().for_each(|grown| grown.prune(growing.bound, tree));
            }
        } else if more > most || sampled.samples.len() as u64 + more > u64::from(u32::MAX) {
            return Err(too_many(most));
        }
        Ok(())
    }

    /// Bound that gives `target` new samples, those included that sheets which share clusters take beside
    /// those of the trees.
    fn threshold(&self, regrown: &[Regrown], bound: f32, target: usize) -> Result<f32> {
        let (kept, most) = (self.kept, self.most_samples());
        if target as u64 > most {
            return Err(too_many(most));
        }
        let of_trees = |samples: usize| threshold_for(splits(regrown, kept), 0, samples);
        let beside = |threshold: f32| -> usize {
            let cut = bound.max(threshold);
            regrown.iter().map(|cell| cell.beside(cut, kept)).sum()
        };
        let whole = of_trees(target);
        let sheets = beside(whole);
        if sheets == 0 {
            return Ok(whole);
        }
        // Fewer samples in the trees are fewer in all; where sheets have few, the rest that they leave is a
        // good guess.
        let (mut fits, mut more, mut threshold) = (0, target, of_trees(0));
        let mut tried = target.saturating_sub(sheets);
        loop {
            let of_tried = of_trees(tried);
            if tried + beside(of_tried) <= target {
                (fits, threshold) = (tried, of_tried);
            } else {
                more = tried;
            }
            // Below the bound, no other threshold makes a difference.
            if (fits == tried && of_tried <= bound) || more - fits <= 1 + fits / NEAR_TARGET {
                break;
            }
            tried = fits + (more - fits) / 2;
        }
        Ok(threshold)
    }

    /// Number of new samples that memory has room for.
    fn most_samples(&self) -> u64 {
        self.limit() / 2 / BYTES_PER_SAMPLE
    }

    /// Triangles of all samples by the model's faces, which place the new ones where they do so; and the
    /// number of bytes of faces that were read.
    fn reindex(
        &self,
        members: ReadMembers,
        appended: &mut Appended,
        bound: f32,
    ) -> Result<(Vec<[u32; 3]>, u64)> {
        let Self { sampled, kept, model, progress, .. } = *self;
        let sample_of = members.finish(sampled.samples.len(), appended)?;
        // A bound that was asked for is kept.
        let slack = matches!(self.how.finer, Finer::Error(_)).then(|| {
            let there = sampled.samples.len();
            let trees = appended.trees.iter().map(|(_, tree)| tree);
            cut::slack(trees, there..there + appended.positions.len(), bound)
        });
        let found = sample_of.reindex(model, &sampled.triangles, kept, slack.as_deref(), progress);
        let found = found.map_err(|e| match e.kind() {
            ErrorKind::Format if kept.knows_faces => sampled.source_changed(model.path()),
            _ => e,
        })?;
        if let Some(positions) = found.positions {
            appended.positions = positions;
        }
        Ok((found.triangles, found.bytes))
    }

    /// The sampled model with the new samples, and where it touches itself.
    fn complete(
        &self,
        appended: Appended,
        triangles: Vec<[u32; 3]>,
        record: Refinement,
        noted: Option<ContactVertices>,
    ) -> Result<SampledModel> {
        let mut kept = self.kept.clone();
        let Appended { positions, normals, origins, parted, trees, .. } = appended;
        trees.into_iter().for_each(|(cell, tree)| kept.cells[cell as usize].tree = tree);
        let mut with_new = self.sampled.refined((positions, normals), triangles, kept, record)?;
        if let Some(contacts) = self.sampled.samples.contacts() {
            with_new.samples.prepare();
            let before = self.sampled.samples.len();
            let inherited = InheritedSheets { contacts, before, origins: &origins };
            let mut contacts = Contacts::refined(&inherited, &with_new.samples, parted);
            if let Some(noted) = noted {
                contacts = contacts.with_places(&inherited, &with_new, noted, self.folder)?;
            }
            with_new.samples.set_contacts(Some(contacts));
        }
        Ok(with_new)
    }

    /// The colours of the new samples.
    fn new_colors(&self, with_new: &SampledModel) -> Result<Vec<[u8; 3]>> {
        let before = self.sampled.samples.len();
        let cells = with_new.held_cells().map_or(&[][..], |kept| &kept.cells);
        let is_new = |cell: &&KeptCell| cell.tree.samples.iter().any(|sample| *sample as usize >= before);
        let ranges = cells.iter().filter(is_new).flat_map(|cell| cell.ranges.iter().cloned());
        let ranges = joined(ranges, self.model.info().near());
        let new = (&with_new.samples.positions[..], before);
        colors::of_ranges(new, &with_new.frame, self.model, &ranges, self.progress)
    }

    /// Adds the cells of all samples that share a triangle with one that may be split: the samples of their
    /// vertices have to be known as well.
    fn add_neighbours(&self, cells: &mut Vec<Met>) {
        let mut split = vec![false; self.sampled.samples.len()];
        for (cell, wanted) in cells.iter() {
            let samples = &self.kept.cells[*cell as usize].tree.samples;
            samples
                .iter()
                .zip(wanted)
                .filter(|(_, wanted)| **wanted)
                .for_each(|(s, _)| split[*s as usize] = true);
        }
        let parted = self.guides.map_or(&[][..], |guides| guides.parted());
        parted.iter().for_each(|[sample, of]| split[*sample as usize] = split[*of as usize]);
        let mut needed = split.clone();
        for triangle in self.sampled.triangles.iter().filter(|t| t.iter().any(|s| split[*s as usize])) {
            triangle.iter().for_each(|s| needed[*s as usize] = true);
        }
        // No tree has these, but the sample that they are parted from.
        for [sample, of] in parted {
            needed[*of as usize] |= needed[*sample as usize];
        }
        // Samples of whole cells need not share a triangle with all that they are next to.
        let index: CellMap<usize> = self.kept.cells.iter().map(|cell| cell.key).zip(0..).collect();
        for cell in &self.kept.cells {
            if cell.tree.children.len() == 1 && split[cell.tree.samples[0] as usize] {
                let around = (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
                let keys = around.map(|d: [i64; 3]| [0, 1, 2].map(|a| cell.key[a].saturating_add(d[a])));
                for at in keys.filter_map(|key| index.get(&key)) {
                    self.kept.cells[*at].tree.samples.iter().for_each(|s| needed[*s as usize] = true);
                }
            }
        }
        let mut known = vec![false; self.kept.cells.len()];
        cells.iter().for_each(|(cell, _)| known[*cell as usize] = true);
        for (cell, kept) in self.kept.cells.iter().enumerate().filter(|(cell, _)| !known[*cell]) {
            if kept.tree.samples.iter().any(|s| needed[*s as usize]) {
                cells.push((cell as u32, vec![false; kept.tree.samples.len()]));
            }
        }
        cells.sort_unstable_by_key(|(cell, _)| *cell);
    }

    /// Cells that are read at a time.
    fn batches<'c>(&self, cells: &'c [Met]) -> Result<Vec<&'c [Met]>> {
        let bytes = |(cell, _): &Met| {
            self.kept.cells[*cell as usize].vertices.saturating_mul(Gathering::BYTES_PER_VERTEX)
        };
        let limit = self.limit() / 2;
        if let Some(largest) = cells.iter().map(bytes).max().filter(|bytes| *bytes > limit) {
            return Err(Error::argument(
                format!("a cell of the model's grid takes {} of memory to refine", human_size(largest)),
                format!(
                    "give --memory-limit {}M or more, or sample with a finer --grid",
                    largest.div_ceil(1 << 19)
                ),
            ));
        }
        let (mut batches, mut first, mut held) = (Vec::new(), 0, 0u64);
        for (i, cell) in cells.iter().enumerate() {
            if held + bytes(cell) > BATCH.min(limit) && i > first {
                batches.push(&cells[first..i]);
                (first, held) = (i, 0);
            }
            held += bytes(cell);
        }
        batches.push(&cells[first..]);
        Ok(batches)
    }

    /// Says so where much more is read than is needed.
    fn tell_scattered(&self, gathering: &Gathering<'_>, cells: &[Met]) {
        let places: Vec<u32> = cells.iter().map(|(cell, _)| *cell).collect();
        let needed: u64 = places.iter().map(|cell| self.kept.cells[*cell as usize].vertices).sum();
        let read: u64 = gathering.ranges(&places).iter().map(|r| r.end - r.start).sum();
        let all = self.sampled.source.vertices.max(1);
        if read > 4 * needed && read > all / 4 {
            let percent = 100 * read / all;
            self.progress.note(&format!(
                "neighbours on the surface are far apart in the model's file: {percent} % of its vertices are read for a \
                 selection with {:.1} % of them",
                100.0 * needed as f64 / all as f64
            ));
        }
    }

    fn changed(&self) -> Error {
        self.sampled.source_changed(self.model.path())
    }
}

/// All splits of some cells.
fn splits<'a>(cells: &'a [Regrown], kept: &'a KeptCells) -> impl Iterator<Item = (f32, u32)> + 'a {
    cells.iter().flat_map(|cell| {
        let tree = &kept.cells[cell.cell as usize].tree;
        cell.grown.iter().flat_map(move |grown| grown.splits(tree))
    })
}

fn too_many(most: u64) -> Error {
    Error::argument(
        format!("this takes more than {most} new samples, which memory does not hold"),
        "select less, give a larger --error, or more memory with --memory-limit",
    )
}
