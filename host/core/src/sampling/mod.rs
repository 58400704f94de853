//! Sampling: P_L is streamed twice and leaves the small point set P_S (paper §4).
//!
//! Pass 1 ([`grid`]) counts vertices per cell of a coarse grid. Pass 2 (`finalization`) puts each vertex in
//! its cell and clusters a cell ([`vs_tree`], [`cluster`]) once it is complete. A cut through all trees
//! (`cut`) gives the samples, which [`SampleSet`] completes with neighbours, spacing and normals.

pub mod cluster;
mod clustered_file;
mod counted;
pub(crate) mod cut;
mod deconvolution;
pub(crate) mod density;
pub mod divided;
pub mod divided_faces;
mod face_ranges;
pub mod face_runs;
pub(crate) mod finalization;
mod fit;
pub(crate) mod gather;
mod glimpse;
pub mod grid;
mod heights;
pub(crate) mod kd_tree;
pub mod kept_cells;
mod layers;
mod membership;
mod nearest_of_all;
mod neighbour_graph;
pub(crate) mod normals;
mod numbers_file;
mod opaque;
mod open_cells;
mod options;
pub(crate) mod placement;
pub(crate) mod random;
pub(crate) mod ranges;
mod sample_set;
mod shared_vertices;
pub(crate) mod shares;
mod splitting;
mod stream;
mod target;
mod tasks;
pub(crate) mod triangles;
pub mod vs_tree;
mod ways;

use std::ops::{Range, RangeInclusive};
use std::path::Path;

use glam::Vec3;
use rayon::prelude::*;
use simod_model::frame::Frame;
use simod_model::mapped::looked_at;
use simod_model::size::human_size;
use simod_model::{
    Error, ErrorKind, FaceChunk, Model, ModelInfo, Progress, Result, for_faces, for_faces_at, memory,
};

pub use density::By;
pub use gather::Grouping;
pub use kd_tree::KdTree;
pub use neighbour_graph::NeighbourGraph;
pub use opaque::LEAST_OPACITY;
pub(crate) use opaque::Opaque;
pub use opaque::UsualSplat;
pub use options::{Sampling, Skip};
pub use placement::Placement;
pub use sample_set::{NEIGHBOURS, SampleSet};
pub use splitting::Splitting;

use crate::colors::{Picked, Picking};
use crate::sampled_model::{SampledModel, SourceRecord, SourceTile};
use crate::sampling::ranges::joined;
use crate::touching::{self, ClusterParts, Contacts, FoundTwins, Islands, Parted, Parting};
use counted::{CountKey, NonFinite, count_range};
use deconvolution::Deconvolved;
use density::SplitRule;
use face_ranges::FaceRanges;
use finalization::{Clustered, ClusteringPass, HashedStream, StreamJob};
use fit::VertexMembers;
use gather::{GroupGather, VertexGather, find_room};
use grid::{CellKey, CellRecord, Grid, GridCounter};
use kept_cells::{KeptCell, KeptCells};
use membership::{Membership, Noted, SampleOf};
use placement::{Placed, Planes};
pub use target::Target;
use triangles::{Triangles, Wanted};

/// Most searches for a coarser cut that puts no sheets together.
const COARSER_ROUNDS: usize = 4;

/// Least memory limit, for a few samples: chunks of the model, the queue of cells, the program itself. Each
/// [`Target::Samples`] takes some more.
pub const LEAST_MEMORY: u64 = 32 << 20;

/// Largest memory for groups where there is no limit: without one, the result does not depend on the machine.
const GROUPS_AT_EASE: u64 = 256 << 20;

/// Least memory for samples of open cells.
const LEAST_FOR_CELLS: u64 = 4 << 20;

/// Largest memory for open cells where there is no limit, for few cells and for many, and for each cell. More
/// saves no time: spilled items go to the page cache first, and others are seldom in the processor's caches.
const CELLS_AT_EASE: RangeInclusive<u64> = 24 << 20..=64 << 20;
const CELL_AT_EASE: u64 = 4 << 10;

impl Sampling {
    fn limit(&self) -> u64 {
        self.memory_limit.unwrap_or_else(|| (memory::of_machine() / 4).min(2 << 30))
    }

    /// Part of the memory limit that is for the clusters: those of a target, or half of the limit.
    fn memory_for_clusters(&self) -> u64 {
        match self.target {
            Target::Samples(n) => n.saturating_mul(cut::BYTES_PER_SAMPLE),
            Target::Error(_) => self.limit() / 2,
        }
    }

    /// Part of the memory limit that is left for the items of open cells, after all else.
    fn memory_for_cells(&self, grid: &Grid) -> u64 {
        let largest = grid.records.iter().map(|r| r.count).max().unwrap_or(0);
        let largest = largest.saturating_mul(size_of::<cluster::Vertex>() as u64);
        let taken = (LEAST_MEMORY - LEAST_FOR_CELLS)
            .saturating_add(self.memory_for_clusters())
            .saturating_add(512 * grid.keys.len() as u64)
            .saturating_add(finalization::work_memory(largest));
        let left = self.limit().saturating_sub(taken);
        // A complete cell is copied out of the open ones.
        let left = left - largest.min(left / 2);
        let at_ease = CELL_AT_EASE.saturating_mul(grid.keys.len() as u64);
        let at_ease = at_ease.clamp(*CELLS_AT_EASE.start(), *CELLS_AT_EASE.end());
        let most = self.memory_limit.map_or(at_ease, |_| u64::MAX);
        left.min(most).max(LEAST_FOR_CELLS)
    }
}

/// Samples a model. Temporary files without a name are made in `folder`: of at most 40 bytes per vertex if
/// the memory limit is reached, and of 8 bytes per vertex for the triangles, of 20 where faces place the
/// samples; of 20 more where faces share no vertices.
///
/// # Errors
/// The model cannot be read, changes meanwhile, or has no vertex with a finite position; the target is zero
/// or not finite, or takes more than the memory limit; a temporary file cannot be written; the user
/// cancelled.
pub fn sample(
    model: &dyn Model,
    sampling: &Sampling,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    sample_counted(model, sampling, None::<&[&Path]>, folder, progress)
}

/// Samples a model whose vertices were [counted](count) before, in ranges, each to one of some files.
///
/// # Errors
/// As of [`sample`]; a file is missing, damaged, or of another model or other options; they are not of all
/// vertices.
pub fn sample_counted(
    model: &dyn Model,
    sampling: &Sampling,
    counted: Option<&[impl AsRef<Path>]>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    check(sampling)?;
    let counted = counted.map(|files| files.iter().map(AsRef::as_ref).collect::<Vec<_>>());
    model.keep_positions(Some(folder));
    let sampled = sample_kept(model, sampling, counted.as_deref(), folder, progress);
    model.keep_positions(None);
    let mut sampled = sampled?;
    sampled.samples.store_lists(sampled.samples.usual_storage(folder));
    Ok(sampled)
}

/// Samples a model that may keep its positions for the second reading.
fn sample_kept(
    model: &dyn Model,
    sampling: &Sampling,
    counted: Option<&[&Path]>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<SampledModel> {
    glimpse::offer(model, progress);
    model.check_complete(progress)?;
    let prepared = SamplingPass::new(model, sampling, counted, folder, progress)?;
    let found = prepared.clustered()?;
    prepared.complete(found)
}

/// Inputs of pass 2 and of all that follows it.
pub(crate) struct SamplingPass<'a> {
    model: &'a dyn Model,
    /// Options, resolved for the model.
    sampling: Sampling,
    grid: Grid,
    non_finite: NonFinite,
    frame: Frame,
    rule: SplitRule,
    target: Option<usize>,
    bound: f32,
    /// Memory for the vertices of open cells, and for groups of them.
    memory: u64,
    for_groups: u64,
    /// Whether the model has faces that can tell of its samples.
    reads_faces: bool,
    picking: Option<Picking>,
    opaque: Option<Opaque>,
    folder: &'a Path,
    progress: &'a dyn Progress,
}

/// Findings of pass 2.
pub(crate) struct ClusteredStream {
    cut: cut::Cut,
    fingerprint: String,
    jumps: u64,
    /// Ranges of the stream with each cell's vertices.
    ranges: Vec<Vec<Range<u64>>>,
    membership: Option<Membership>,
    picked: Option<Picked>,
    grouping: Grouping,
}

/// # Errors
/// The model has no vertices.
fn check_not_empty(model: &dyn Model) -> Result<()> {
    if model.info().vertices > 0 {
        return Ok(());
    }
    Err(Error::degenerate(
        format!("{} has no vertices", model.path().display()),
        "a model needs at least one vertex to be sampled",
    ))
}

/// Pass 1: the vertices of each cell, counted here or merged from files.
///
/// # Errors
/// The model or a file cannot be read; no vertex is finite; the extent is no finite number; the user
/// cancelled.
fn counted_cells(
    model: &dyn Model,
    sampling: &Sampling,
    counted: Option<&[&Path]>,
    opaque: Option<Opaque>,
    progress: &dyn Progress,
) -> Result<(Grid, NonFinite)> {
    let info = model.info();
    let (grid, non_finite) = match counted {
        Some(files) => counted::merged(model, &counting(model, sampling)?, files)?,
        None => {
            progress.begin("counting", info.vertex_bytes);
            let resolution = sampling.grid.unwrap_or_else(|| default_grid(info.vertices, sampling.target));
            count_cells(model, opaque, resolution, progress)?
        }
    };
    check_counted(model, &non_finite)?;
    check_extent(model, &grid)?;
    Ok((grid, non_finite))
}

/// # Errors
/// The extent of the model is no finite number.
fn check_extent(model: &dyn Model, grid: &Grid) -> Result<()> {
    if grid.bounds.diagonal().is_finite() {
        return Ok(());
    }
    Err(Error::degenerate(
        format!("{} is too large for its own numbers", model.path().display()),
        "scale it down: its extent has to be below 1e308",
    ))
}

/// Grouping that is done, never [`Grouping::Automatic`], and the bytes that groups may take, where cells have
/// so much `memory`.
fn resolve_grouping(sampling: &Sampling, grid: &Grid, frame: &Frame, memory: u64) -> (Grouping, u64) {
    // Groups are as large everywhere: finer vertices would be lost in them.
    let grouping = match (sampling.grouping, sampling.by) {
        (Grouping::Automatic, By::Vertices) => Grouping::Never,
        (grouping, _) => grouping,
    };
    let for_groups = match (sampling.memory_limit, sampling.grouping) {
        (Some(_), _) => memory,
        // The machine's memory does not count, so that the samples do not depend on it …
        (None, Grouping::Automatic) => GROUPS_AT_EASE,
        // … and none other than asked for.
        (None, _) => u64::MAX,
    };
    (grouping.resolve(grid, frame, sampling.target, for_groups), for_groups)
}

impl<'a> SamplingPass<'a> {
    fn new(
        model: &'a dyn Model,
        sampling: &Sampling,
        counted: Option<&[&Path]>,
        folder: &'a Path,
        progress: &'a dyn Progress,
    ) -> Result<Self> {
        let info = model.info();
        check_not_empty(model)?;
        let min_opacity = opaque::resolve(model, sampling.min_opacity)?;
        let opaque = Opaque::find(model, min_opacity)?;
        let (grid, non_finite) = counted_cells(model, sampling, counted, opaque, progress)?;
        let frame = Frame::from_bounds(&grid.bounds);

        let (target, bound) = match sampling.target {
            Target::Samples(n) => (Some(usize::try_from(n).unwrap_or(usize::MAX / 8)), 0.0),
            Target::Error(e) => (None, (e * grid.bounds.diagonal() / frame.scale) as f32),
        };
        let memory = sampling.memory_for_cells(&grid);
        let finite = info.vertices - non_finite.count - non_finite.transparent;
        let edge = grid.cell_size() / frame.scale;
        let splitting = sampling.splitting.resolve(info);
        let rule = SplitRule::new(splitting, sampling.by, finite, grid.keys.len() as u64, edge);
        let (grouping, for_groups) = resolve_grouping(sampling, &grid, &frame, memory);
        let reads_faces = can_tell(info);
        let placement = if reads_faces { sampling.placement.resolve(model)? } else { Placement::Vertices };
        let known = if let Target::Samples(n) = sampling.target { Some(n) } else { None };
        let picking = if sampling.skip.colors { None } else { Picking::for_model(model, known)? };
        let sampling = Sampling { placement, splitting, min_opacity, grouping, ..*sampling };
        Ok(Self {
            model,
            sampling,
            grid,
            non_finite,
            frame,
            rule,
            target,
            bound,
            memory,
            for_groups,
            reads_faces,
            picking,
            opaque,
            folder,
            progress,
        })
    }

    /// Whether the cluster of each vertex is recorded.
    fn with_members(&self) -> bool {
        let Sampling { placement, skip, .. } = &self.sampling;
        self.reads_faces && are_told(*placement, skip)
    }

    /// Largest number of clusters that may be kept if there is no target.
    fn most(&self) -> usize {
        let most = self.sampling.memory_for_clusters() / cut::BYTES_PER_SAMPLE;
        usize::try_from(most).unwrap_or(usize::MAX)
    }

    /// Streams the vertices and clusters the cells of a job, in groups where there are to be some; `None` if
    /// these find no room.
    fn stream(
        &self,
        job: StreamJob<'_>,
        foresight: Option<f64>,
        grouping: Grouping,
    ) -> Result<Option<Clustered>> {
        let Self { model, grid, frame, rule, target, bound, opaque, folder, progress, .. } = self;
        // Units that read faces find these by themselves.
        let is_whole = matches!(job, StreamJob::Whole);
        let pass = ClusteringPass {
            model: *model,
            grid,
            frame,
            rule: *rule,
            target: *target,
            bound: *bound,
            most: self.most(),
            foresight,
            job,
            with_members: self.with_members(),
            noted: Noted {
                positions: is_whole && self.sampling.placement == Placement::Faces,
                twins: is_whole && !self.sampling.skip.sheets,
            },
            picking: self.picking.as_ref(),
            opaque: *opaque,
            folder,
            progress: *progress,
        };
        let cells = grid.keys.len();
        let Some(edge) = grouping.edge(grid.cell_size(), frame) else {
            let part =
                |parts: usize| VertexGather::new(cells.div_ceil(parts), self.memory / parts as u64, folder);
            return stream::cluster(&pass, part);
        };
        let part =
            |parts: usize| GroupGather::new(cells.div_ceil(parts), edge, self.for_groups / parts as u64);
        let clustered = stream::cluster(&pass, part)?;
        let has_room =
            |found: &Clustered| !is_whole || find_room(&grid.records, &found.items, self.for_groups);
        Ok(clustered.filter(has_room))
    }

    /// Pass 2 of the whole model.
    fn clustered(&self) -> Result<ClusteredStream> {
        self.clustered_with(self.sampling.grouping)
    }

    /// Clusters the stream, where it is known whether groups find room.
    fn clustered_with(&self, mut grouping: Grouping) -> Result<ClusteredStream> {
        for foresight in [Some(1.0), None] {
            let clustered = match self.stream(StreamJob::Whole, foresight, grouping)? {
                Some(clustered) => clustered,
                // Groups find no room in memory; single vertices find some in a file.
                None => {
                    grouping = Grouping::Never;
                    let vertices = self.stream(StreamJob::Whole, foresight, grouping)?;
                    vertices.ok_or_else(|| Error::internal("vertices find no room"))?
                }
            };
            self.progress.begin("completing the samples", 0);
            let Clustered { forest, hash, ranges, jumps, membership, picked, .. } = clustered;
            let HashedStream::All(hash) = hash else {
                return Err(Error::internal("a part of the vertices was hashed"));
            };
            if let Some(cut) = forest.cut(&self.grid) {
                return Ok(ClusteredStream {
                    cut,
                    fingerprint: hash.fingerprint(),
                    jumps: jumps.count,
                    ranges: ranges.into_par_iter().map(|cell| cell.all()).collect(),
                    membership,
                    picked,
                    grouping,
                });
            }
        }
        // Without foresight, all is kept that the cut may need.
        Err(Error::internal("the samples are fewer than was foreseen"))
    }

    /// Inputs by which sheets are parted, for cells whose vertices are in these ranges.
    fn parting<'b>(&'b self, ranges: &'b [Vec<Range<u64>>]) -> Parting<'b> {
        let Self { model, frame, folder, progress, .. } = *self;
        Parting { model, ranges, frame, folder, progress }
    }

    /// Sampled model of the findings of pass 2.
    fn complete(self, mut found: ClusteredStream) -> Result<SampledModel> {
        let mut reindexed = FaceResult::new(std::mem::take(&mut found.cut));
        let sample_of = match found.membership.take() {
            None => None,
            Some(members) => {
                self.progress.begin_parts("looking up each vertex' sample", self.model.info().vertices);
                let mut sample_of = members.finish(&reindexed.cut.starts, self.progress)?;
                let parting = self.parting(&found.ranges);
                let read = Read { sampling: &self.sampling, bound: self.bound, parting: &parting };
                reindexed.run(&read, &mut sample_of)?;
                Some(sample_of)
            }
        };
        self.assemble(found, reindexed, sample_of)
    }

    /// The samples of a cloud, on the surface: none is farther from where its cluster has it than the error
    /// of that, and the promise of an error bound is kept.
    fn deconvolved(&self, cut: &cut::Cut) -> Option<Deconvolved> {
        if self.model.info().faces > 0 {
            return None;
        }
        let errors = cut::errors(cut.trees.iter(), cut.samples());
        let slack = self.target.is_none().then(|| cut::slack(cut.trees.iter(), 0..cut.samples(), self.bound));
        let most = |i: usize| slack.as_ref().map_or(errors[i], |slack| slack[i].min(errors[i]));
        deconvolution::deconvolved(&cut.positions, &cut.variances, most)
    }

    fn source_record(&self, jumps: u64, fingerprint: String) -> SourceRecord {
        let Self { model, non_finite, opaque, .. } = self;
        let info = model.info();
        SourceRecord {
            path: model.path().to_owned(),
            tiles: SourceTile::all(*model),
            columns: model.columns().map(str::to_owned),
            bytes: info.bytes,
            vertices: info.vertices,
            attributes: info.attributes.clone(),
            non_finite: non_finite.count,
            first_non_finite: non_finite.first,
            transparent: non_finite.transparent,
            usual_splat: opaque.and_then(|opaque| opaque.usual()),
            jumps: Some(jumps),
            fingerprint,
        }
    }

    /// Puts P_S together, once its parts are known.
    fn assemble(
        self,
        found: ClusteredStream,
        reindexed: FaceResult,
        sample_of: Option<SampleOf>,
    ) -> Result<SampledModel> {
        let ClusteredStream { fingerprint, jumps, ranges, picked, grouping, .. } = found;
        let parting = self.parting(&ranges);
        let source = self.source_record(jumps, fingerprint);
        let Self { model, sampling, grid, picking, progress, .. } = &self;
        let (model, progress) = (*model, *progress);
        let FaceResult { mut cut, triangles, faces, parted, placed } = reindexed;
        let mut around = None;
        if let Some(placed) = placed {
            cut.positions = placed.into_iter().map(|placed| placed.at).collect();
        } else if let Some(Deconvolved { positions, graph, across }) = self.deconvolved(&cut) {
            (cut.positions, around) = (positions, Some((graph, across)));
        }
        progress.check()?;
        let trees = cut.trees;
        let mut sampled = SampledModel::new(
            source,
            Sampling { grouping, ..*sampling },
            grid,
            model.info().position_type,
            (cut.positions, cut.normals),
            triangles,
        )?;
        if let (Some(picking), Some(picked)) = (picking, picked) {
            let sample_of = sample_of.as_ref().map(SampleOf::all);
            sampled.colors = picked.colors(picking, &sampled.samples.positions, sample_of, progress)?;
        }
        if let (Some(parted), Some(sample_of)) = (parted, sample_of) {
            progress.begin("telling the sheets apart", 0);
            Contacts::find(&mut sampled, &parted, sample_of.all(), &trees, &parting)?;
        }
        if !sampling.skip.cells {
            sampled.hold_cells(keep(grid, ranges, faces, trees));
        }
        if !sampling.skip.normals && !sampled.samples.knows_normals() {
            progress.begin("estimating normals", 0);
            if let Some((graph, across)) = around {
                sampled.samples.estimate_normals(&graph, &across);
            }
            sampled.samples.normals();
        }
        progress.check()?;
        Ok(sampled)
    }
}

/// Counts the vertices of a range per cell, for [`sample_counted`] of the same model and options, to a file
/// that appears whole or not at all. Nothing is done if it is there already; `false` then.
///
/// Memory: 48 bytes for each cell that the range meets, as much for the file, and a chunk.
///
/// # Errors
/// The options are out of range; the model cannot be read; the file cannot be written, or is being written by
/// another process; the user cancelled.
pub fn count(
    model: &dyn Model,
    sampling: &Sampling,
    target: (Range<u64>, &Path),
    progress: &dyn Progress,
) -> Result<bool> {
    check(sampling)?;
    counted::count(model, &counting(model, sampling)?, target, progress)
}

/// Key of the model and the options that counts belong to.
fn counting(model: &dyn Model, sampling: &Sampling) -> Result<CountKey> {
    let info = model.info();
    let resolution = sampling.grid.unwrap_or_else(|| default_grid(info.vertices, sampling.target));
    let min_opacity = opaque::resolve(model, sampling.min_opacity)?;
    Ok(CountKey { model: [info.bytes, info.vertices], resolution, min_opacity })
}

/// Inputs by which the faces are read.
struct Read<'a> {
    sampling: &'a Sampling,
    /// The error bound, local units, if that is the target.
    bound: f32,
    parting: &'a Parting<'a>,
}

/// P_S once the faces are known.
struct FaceResult {
    cut: cut::Cut,
    triangles: Triangles,
    /// Ranges of the file with the faces of each cell.
    faces: Option<Vec<Vec<Range<u64>>>>,
    /// Clusters as they were parted by sheets.
    parted: Option<Parted>,
    /// Positions in which the faces place the samples.
    placed: Option<Vec<Placed>>,
}

impl FaceResult {
    fn new(cut: cut::Cut) -> Self {
        Self { cut, triangles: Triangles::default(), faces: None, parted: None, placed: None }
    }

    /// Reads the faces. Where they tell that clusters hold several sheets, these are parted; where faces
    /// place the samples, those of the samples that this changes are read once more.
    fn run(&mut self, read: &Read<'_>, members: &mut SampleOf) -> Result<()> {
        let Read { parting, .. } = *read;
        let twins = members.take_twins();
        let (sample_of, vertices) = members.all_mut();
        let Some(twins) = twins else {
            self.read_faces(read, sample_of, vertices, None)?;
            return self.fit(read, sample_of, vertices);
        };
        let (mut islands, welded) = begin_islands(parting, twins, sample_of, self.cut.samples())?;
        self.read_faces(read, sample_of, vertices, Some(&mut islands))?;
        let changed = self.part_sheets(read, islands, sample_of, welded)?;
        if let (Some(changed), Some(vertices)) = (changed, vertices) {
            self.place_again(read, sample_of, vertices, &changed)?;
        }
        self.fit(read, sample_of, vertices)
    }

    /// Finds where sheets meet, and parts the clusters that hold several; these clusters are others than
    /// before then. `welded` says that vertices at one place are joined already.
    fn part_sheets(
        &mut self,
        read: &Read<'_>,
        mut islands: Islands,
        sample_of: &mut [u32],
        mut welded: bool,
    ) -> Result<Option<ClusterChanges>> {
        let mut parts = read.parting.find(&mut islands, sample_of, &self.cut.trees, &mut welded)?;
        let mut merged = None;
        if let Some(n) = samples_wanted(read.sampling)
            && let Some(fewer) = parts.fewer_clusters(self.cut.samples(), n)
        {
            merged = Some(self.merge_clusters(fewer, &mut islands, sample_of));
            parts = read.parting.find(&mut islands, sample_of, &self.cut.trees, &mut welded)?;
        }
        let (mut parted, changed) = if parts.is_empty() && merged.is_none() {
            drop(islands);
            self.triangles.put(sample_of);
            (parts.part(&self.cut.positions, None, 0), None)
        } else {
            let (parted, changed) = self.part_clusters(read, parts, merged, islands, sample_of)?;
            (parted, Some(changed))
        };
        if parted.joins_any() {
            parted.beside = touching::meeting(self.cut.positions.clone(), &parted)?;
        }
        self.parted = Some(parted).filter(|parted| changed.is_some() || !parted.beside.is_empty());
        Ok(changed)
    }

    /// Makes the clusters larger, about `fewer` of them; returns the new cluster of each.
    fn merge_clusters(&mut self, fewer: usize, islands: &mut Islands, sample_of: &mut [u32]) -> Vec<u32> {
        let (cut, becomes) = self.cut.coarser(fewer, |_| false);
        self.cut = cut;
        // There are vertices without a sample.
        sample_of.par_iter_mut().for_each(|of| *of = becomes.get(*of as usize).copied().unwrap_or(*of));
        looked_at(size_of_val(sample_of));
        islands.merge(sample_of, self.cut.samples());
        becomes
    }

    /// Coarser cut, and the sample that has each cluster: those of several sheets stay, and so do those that
    /// would be of one sample though they are on several.
    fn coarser_by_sheets(&self, target: usize, parts: &ClusterParts) -> (cut::Cut, Vec<u32>) {
        let mut stay = vec![false; self.cut.samples()];
        let mut rounds = 0..COARSER_ROUNDS;
        loop {
            let (cut, becomes) =
                self.cut.coarser(target, |cluster| stay[cluster as usize] || parts.is_mixed(cluster));
            let joining = parts.joining_sheets(&becomes, cut.samples());
            if joining.is_empty() || rounds.next().is_none() {
                return (cut, becomes);
            }
            joining.into_iter().for_each(|cluster| stay[cluster as usize] = true);
        }
    }

    /// Parts clusters of several sheets, if need be after a coarser cut, so that there are no more samples
    /// than are wanted. `merged` says which one each cluster became before that.
    fn part_clusters(
        &mut self,
        read: &Read<'_>,
        parts: ClusterParts,
        merged: Option<Vec<u32>>,
        islands: Islands,
        sample_of: &mut [u32],
    ) -> Result<(Parted, ClusterChanges)> {
        let Read { sampling, parting, .. } = *read;
        let (mut most, mut becomes) = (usize::MAX, None);
        if let Some(n) = samples_wanted(sampling) {
            let needed = parts.needed(n);
            if self.cut.samples() + needed > n {
                let target = n.saturating_sub(needed).max(n.div_ceil(2));
                let (cut, coarser) = self.coarser_by_sheets(target, &parts);
                (self.cut, becomes) = (cut, Some(coarser));
            }
            most = n.saturating_sub(self.cut.samples());
        }
        let parted = parts.part(&self.cut.positions, becomes.as_deref(), most);
        parted.renumber(&islands, sample_of);
        drop(islands);

        for (sample, position, normal) in &parted.moved {
            self.cut.positions[*sample as usize] = *position;
            self.cut.normals[*sample as usize] = *normal;
        }
        for (_, position, normal) in &parted.added {
            self.cut.positions.push(*position);
            self.cut.normals.push(*normal);
        }
        if self.triangles.of_vertices || !finds_triangles(sampling) || self.triangles.tangled {
            self.triangles.put(sample_of);
        } else {
            // The triangles of vertices were too many, and those of samples were put for them.
            let wanted = Wanted { triangles: true, ..Wanted::default() };
            self.triangles =
                triangles::reindex(parting.model, sample_of, self.cut.samples(), wanted, parting.progress)?;
        }
        let becomes = match (merged, becomes) {
            (Some(merged), Some(becomes)) => Some(merged.iter().map(|of| becomes[*of as usize]).collect()),
            (merged, becomes) => merged.or(becomes),
        };
        let changed = ClusterChanges::new(&parted, becomes, self.cut.samples());
        Ok((parted, changed))
    }

    /// Finds the triangles; the ranges of each cell's faces, if they are wanted; islands; and the positions
    /// of samples by the faces, if the local positions of the vertices are given, as these place them.
    fn read_faces(
        &mut self,
        read: &Read<'_>,
        sample_of: &[u32],
        vertices: Option<&[Vec3]>,
        islands: Option<&mut Islands>,
    ) -> Result<()> {
        let Read { sampling, parting, .. } = *read;
        let triangles = finds_triangles(sampling);
        if !triangles && islands.is_none() {
            return Ok(());
        }
        parting.progress.begin("reindexing the faces", parting.model.info().face_bytes);
        let (trees, samples) = (&self.cut.trees, self.cut.samples());
        let mut ranges = keeps_faces(sampling).then(|| FaceRanges::new(trees, samples));
        let mut planes = vertices.map(|vertices| Planes::new(vertices, &self.cut.positions, 0));
        let wanted = Wanted { triangles, ranges: ranges.as_mut(), islands, planes: planes.as_mut() };
        let found = triangles::reindex(parting.model, sample_of, samples, wanted, parting.progress);
        self.triangles = found.map_err(|e| {
            let hint = format!(
                "{}; or do without the faces, by --skip triangles,sheets and --place vertices",
                e.hint()
            );
            if e.kind() == ErrorKind::Format { e.hinting(hint) } else { e }
        })?;
        self.placed = planes.map(|planes| self.place(read, planes));
        self.faces =
            ranges.filter(|_| !self.triangles.triangles.is_empty()).and_then(|r| r.into_cells(trees));
        Ok(())
    }

    /// Positions of the samples by the planes around them.
    fn place(&self, read: &Read<'_>, planes: Planes<'_>) -> Vec<Placed> {
        // The promise of an error bound is kept.
        let slack = matches!(read.sampling.target, Target::Error(_))
            .then(|| cut::slack(self.cut.trees.iter(), 0..self.cut.samples(), read.bound));
        planes.place(|sample| slack.as_ref().map_or(f32::INFINITY, |slack| slack[sample]))
    }

    /// Places those samples anew whose clusters have changed, if the faces have placed the samples. Only
    /// faces of cells in which clusters have changed are read, if their ranges are known.
    fn place_again(
        &mut self,
        read: &Read<'_>,
        sample_of: &[u32],
        vertices: &[Vec3],
        changed: &ClusterChanges,
    ) -> Result<()> {
        let Read { parting, .. } = *read;
        let Some(placed) = self.placed.take() else { return Ok(()) };
        let mut planes = Planes::new(vertices, &self.cut.positions, 0);
        let take = |chunk: &FaceChunk| {
            parting.progress.check()?;
            planes.take(&chunk.triangles, |corners| {
                triangles::all_three(corners.map(|vertex| sample_of.get(vertex as usize).copied()))
            });
            looked_at(triangles::BYTES_OF_A_FACE * chunk.triangles.len());
            Ok(())
        };
        match &self.faces {
            Some(faces) => {
                let changes = |tree: &kept_cells::CutTree| tree.samples.iter().any(|s| changed.is(*s));
                let cells = self.cut.trees.iter().zip(faces).filter(|(tree, _)| changes(tree));
                let ranges = joined(cells.flat_map(|(_, ranges)| ranges.iter().cloned()), NEAR_FACES);
                for_faces_at(parting.model, ranges, take)?;
            }
            None => for_faces(parting.model, take)?,
        }
        let again = self.place(read, planes);
        let former = |sample: usize| changed.former[sample].map(|former| placed[former as usize]);
        let placed = again.into_iter().enumerate().map(|(i, again)| former(i).unwrap_or(again)).collect();
        self.placed = Some(placed);
        Ok(())
    }

    /// Fits the samples to the vertices, if faces place them; the triangles are dropped then if they were not
    /// wanted but for it.
    fn fit(&mut self, read: &Read<'_>, sample_of: &[u32], vertices: Option<&[Vec3]>) -> Result<()> {
        let triangles = &mut self.triangles.triangles;
        if let (Some(placed), Some(vertices), false) = (&mut self.placed, vertices, triangles.is_empty()) {
            // A closed surface has two faces for each place.
            let info = read.parting.model.info();
            let at_one_place = (2 * info.vertices / info.faces.max(1)).clamp(1, 6) as u32;
            let members = VertexMembers { vertices, sample_of, at_one_place };
            // Samples near which sheets meet are held: nearer to their own vertices they would get into the
            // other side.
            let held = match &self.parted {
                Some(parted) if !parted.seeds.is_empty() => {
                    touching::crowded(placed.iter().map(|placed| placed.at).collect(), parted)?
                }
                _ => Vec::new(),
            };
            fit::fit(placed, &self.cut.positions, triangles, members, &held, read.parting.progress)?;
        }
        if read.sampling.skip.triangles {
            *triangles = Vec::new();
            self.triangles.tangled = false;
        }
        Ok(())
    }
}

/// Number of samples that are wanted, if that is the target.
fn samples_wanted(sampling: &Sampling) -> Option<usize> {
    match sampling.target {
        Target::Samples(n) => Some(usize::try_from(n).unwrap_or(usize::MAX)),
        Target::Error(_) => None,
    }
}

/// Whether triangles of P_S are looked for: if they are wanted, or the samples are fitted by them.
fn finds_triangles(sampling: &Sampling) -> bool {
    !sampling.skip.triangles || sampling.placement == Placement::Faces
}

/// Whether the ranges of each cell's faces are kept.
fn keeps_faces(sampling: &Sampling) -> bool {
    !sampling.skip.triangles && !sampling.skip.cells
}

/// Whether the faces of a model can tell anything of its samples.
fn can_tell(info: &ModelInfo) -> bool {
    info.faces > 0 && info.vertices <= Membership::MAX_VERTICES
}

/// Whether anything is wanted that faces tell.
fn are_told(placement: Placement, skip: &Skip) -> bool {
    placement == Placement::Faces || !skip.sheets || !skip.triangles
}

/// Whether faces share hardly any vertices, `twins` of which are known to be at the same place as others:
/// islands are told by the positions of all vertices then.
fn are_apart(info: &ModelInfo, twins: u64) -> bool {
    (info.vertices - twins) / 2 > info.faces
}

/// Islands of so many clusters before the faces are read, and whether all vertices at one place are joined.
fn begin_islands(
    parting: &Parting<'_>,
    twins: FoundTwins,
    sample_of: &[u32],
    samples: usize,
) -> Result<(Islands, bool)> {
    let welded = are_apart(parting.model.info(), twins.count);
    let mut islands = Islands::new(twins, sample_of, samples, parting.folder);
    if welded {
        parting.weld_all(&mut islands, sample_of)?;
    }
    Ok((islands, welded))
}

/// Bytes between two ranges of faces that cost less to read than to begin anew.
const NEAR_FACES: u64 = 4 << 10;

/// The clusters that differ from those before some were parted.
struct ClusterChanges {
    /// Former number of each sample, if its cluster is the same.
    former: Vec<Option<u32>>,
}

impl ClusterChanges {
    /// `becomes` says which sample each one was merged into, if the cut has become coarser.
    fn new(parted: &Parted, becomes: Option<Vec<u32>>, samples: usize) -> Self {
        let first = samples - parted.added.len();
        let mut former: Vec<Option<u32>> = match &becomes {
            None => (0..first as u32).map(Some).collect(),
            Some(_) => vec![None; first],
        };
        let mut merged = vec![false; first];
        for (was, now) in becomes.iter().flatten().enumerate() {
            merged[*now as usize] |= former[*now as usize].replace(was as u32).is_some();
        }
        former.iter_mut().zip(merged).filter(|(_, merged)| *merged).for_each(|(former, _)| *former = None);
        former.resize(samples, None);
        parted.seeds.iter().for_each(|sample| former[*sample as usize] = None);
        Self { former }
    }

    fn is(&self, sample: u32) -> bool {
        self.former[sample as usize].is_none()
    }
}

/// Cells with their ranges and trees, to be kept.
fn keep(
    grid: &Grid,
    ranges: Vec<Vec<Range<u64>>>,
    faces: Option<Vec<Vec<Range<u64>>>>,
    trees: Vec<kept_cells::CutTree>,
) -> KeptCells {
    let knows_faces = faces.is_some();
    let faces = faces.unwrap_or_else(|| vec![Vec::new(); trees.len()]);
    let cells = grid.keys.iter().zip(&grid.records).zip(ranges).zip(faces).zip(trees);
    let cell = |((((key, record), ranges), faces), tree): ((((&CellKey, &CellRecord), _), _), _)| KeptCell {
        key: *key,
        vertices: record.count,
        ranges,
        faces,
        tree,
    };
    KeptCells { level: grid.level, knows_faces, cells: cells.map(cell).collect() }
}

/// Samples are indexed by 32 bits.
const MAX_SAMPLES: u64 = u32::MAX as u64;

fn check(sampling: &Sampling) -> Result<()> {
    let bad = match sampling.target {
        Target::Samples(n) if n == 0 || n > MAX_SAMPLES => format!("the target of {n} samples"),
        Target::Error(e) if !(e.is_finite() && e > 0.0) => format!("the error bound {e}"),
        _ => match sampling.grid {
            Some(r @ (0 | 1 | 4097..)) => format!("a grid of {r} cells along an axis"),
            _ => return check_memory(sampling),
        },
    };
    Err(Error::argument(
        format!("{bad} is out of range"),
        "give a number of samples from 1 to 2^32 - 1, an error above 0 (a fraction of the diagonal), a grid from 2 to 4096",
    ))
}

/// An error where the limit does not even leave room for the clusters.
fn check_memory(sampling: &Sampling) -> Result<()> {
    let clusters = match sampling.target {
        Target::Samples(n) => n.saturating_mul(cut::BYTES_PER_SAMPLE),
        Target::Error(_) => 0,
    };
    let least = LEAST_MEMORY.saturating_add(clusters);
    match sampling.memory_limit {
        Some(limit) if limit < least => Err(Error::argument(
            format!("a memory limit of {} is too small", human_size(limit)),
            format!("give --memory-limit {}M or more, or ask for fewer samples", least.div_ceil(1 << 20)),
        )),
        _ => Ok(()),
    }
}

/// About 2000 vertices per cell of a surface, which meets about 3R² cells: enough for a tree to be adaptive,
/// few enough that the open cells of a coherent stream stay small. No more cells than a small part of the
/// samples, so that they take less memory than these: groups keep the open cells small as well.
fn default_grid(vertices: u64, target: Target) -> u32 {
    let resolution = |cells: f64| (cells / 3.0).sqrt();
    let by_vertices = (resolution(vertices as f64 / 2000.0) as u32).next_power_of_two();
    let most = match target {
        Target::Samples(n) => 1 << resolution(n as f64 / 12.0).max(1.0).log2() as u32,
        Target::Error(_) => 128,
    };
    by_vertices.min(most).clamp(16, 512)
}

/// Pass 1, on all cores where the file can be read from anywhere.
fn count_cells(
    model: &dyn Model,
    opaque: Option<Opaque>,
    resolution: u32,
    progress: &dyn Progress,
) -> Result<(Grid, NonFinite)> {
    let info = model.info();
    let parts = if info.random_access { rayon::current_num_threads() as u64 } else { 1 };
    let part = info.vertices.div_ceil(parts);
    let counted: Result<Vec<_>> = (0..parts)
        .into_par_iter()
        .map(|i| count_range(model, opaque, i * part..(i + 1) * part, resolution, progress))
        .collect();
    let (mut counter, mut non_finite) = (GridCounter::new(resolution), NonFinite::default());
    for (cells, others) in counted? {
        counter.absorb(cells);
        non_finite.absorb(others);
    }
    Ok((counter.finish(), non_finite))
}

/// An error where no vertex is left.
fn check_counted(model: &dyn Model, non_finite: &NonFinite) -> Result<()> {
    let info = model.info();
    if non_finite.count == info.vertices {
        return Err(Error::degenerate(
            format!("none of the {} vertices of {} is finite", non_finite.count, model.path().display()),
            "check how the file was written: all of its positions hold NaN or infinity",
        ));
    }
    if non_finite.count + non_finite.transparent == info.vertices {
        return Err(Error::degenerate(
            format!("all splats of {} are too transparent to be sampled", model.path().display()),
            "give a smaller --min-opacity, or 0 for all splats",
        ));
    }
    Ok(())
}
