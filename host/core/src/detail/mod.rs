//! Vertices of the model itself where somebody looks: those of some cells are read again and carried over by
//! the deformation, as many as a picture needs, without writing a file (paper §5 and §6).
//!
//! Only the ranges of these cells are read, once. Each cell is handed on when its last vertex came, in
//! batches that are carried as [`reconstruct`](crate::reconstruction::reconstruct) carries blocks. Where
//! there are more vertices than are wanted, one of each few that follow each other in a cell is taken
//! (`thinning`).

#[cfg(test)]
mod tests;
mod thinning;

use std::ops::Range;

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use simod_model::{ColorScale, Colors, Error, Model, Progress, Result};

use crate::ellipses::{self, Ellipses};
use crate::reconstruction::{DeformationField, Moved, VertexDiagnostics, carry, homes};
use crate::refinement::gathering::{Gathering, Visited};
use crate::sampled_model::SampledModel;
use crate::sampling::kd_tree::KdTree;
use crate::sampling::kept_cells::KeptCells;
use crate::sampling::normals;
use thinning::Thinning;

/// Number of vertices that is enough for most screens: there are hardly more pixels.
pub const ENOUGH: usize = 3_000_000;

/// Vertices of a batch, to which the last of its cells adds its own.
pub const BATCH: usize = 1 << 17;

/// Neighbours over which the spacing of vertices is measured, as that of samples.
const SPACING_NEIGHBOURS: usize = 6;

/// Nowhere, the surface is taken for stretched more than this when discs are to cover it.
const MOST_STRETCH: f32 = 8.0;

/// Request for vertices of some cells: the cells, the fineness, and the attributes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DetailRequest {
    /// The cells' places among the kept ones; ascending.
    pub cells: Vec<u32>,
    /// Length of the runs of vertices of which one is taken: 1 for all vertices.
    pub stride: u64,
    /// The attributes that come with them.
    pub shown: DetailAttributes,
}

/// The attributes of vertices that come with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DetailAttributes {
    /// No attributes.
    #[default]
    Nothing,
    /// The vertices' own colours.
    Colors(Colors, ColorScale),
    /// The attribute at this place in the model's list.
    Attribute(usize),
}

impl DetailAttributes {
    /// Number of attributes, from the first on, that have to be read.
    fn count(&self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Colors(colors, _) => colors.count(),
            Self::Attribute(place) => place + 1,
        }
    }

    fn none(&self) -> Values {
        match self {
            Self::Nothing => Values::Nothing,
            Self::Colors(..) => Values::Colors(Vec::new()),
            Self::Attribute(_) => Values::Numbers(Vec::new()),
        }
    }
}

/// Values that were [asked for](DetailAttributes), one for each vertex.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Values {
    /// No values.
    #[default]
    Nothing,
    /// The vertex's colour, 8-bit sRGB.
    Colors(Vec<[u8; 3]>),
    /// A number; it may not be finite.
    Numbers(Vec<f32>),
}

impl Values {
    fn push(&mut self, shown: &DetailAttributes, vertex: &Visited<'_>) {
        match (self, shown) {
            (Self::Colors(all), DetailAttributes::Colors(colors, scale)) => {
                all.push(colors.places.map(|place| scale.byte(vertex.attribute(place))));
            }
            (Self::Numbers(all), DetailAttributes::Attribute(place)) => {
                all.push(vertex.attribute(*place) as f32)
            }
            _ => {}
        }
    }

    /// Appends a range of another list's values; an empty list becomes one of the same sort.
    pub fn extend(&mut self, other: &Self, range: Range<usize>) {
        match (&mut *self, other) {
            (_, Self::Nothing) => {}
            (Self::Colors(all), Self::Colors(more)) => all.extend_from_slice(&more[range]),
            (Self::Numbers(all), Self::Numbers(more)) => all.extend_from_slice(&more[range]),
            (Self::Nothing, Self::Colors(more)) => *self = Self::Colors(more[range].to_vec()),
            (Self::Nothing, Self::Numbers(more)) => *self = Self::Numbers(more[range].to_vec()),
            // Vertices are streamed for one sort at a time.
            (Self::Colors(_), Self::Numbers(_)) | (Self::Numbers(_), Self::Colors(_)) => {}
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Colors(all) => all.len(),
            Self::Numbers(all) => all.len(),
        }
    }
}

/// The figures of a stream.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Streamed {
    /// Number of vertices that were handed on ...
    pub vertices: u64,
    /// ... and the number of those with a finite position in the cells.
    pub of: u64,
    /// Bytes of the model that were read.
    pub bytes: u64,
}

/// Vertices of some cells, carried over. All lists but the last one have an entry for each vertex;
/// coordinates are local (see [`Frame`](simod_model::frame::Frame)).
///
/// Memory: 32 bytes per vertex, 3 or 4 more for the attribute that is shown, 24 more for splats, 12 per cell.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DetailBatch {
    /// Deformed positions.
    pub positions: Vec<Vec3>,
    /// Unit normals: the model's own, or else estimated at rest, turned by the deformation.
    pub normals: Vec<Vec3>,
    /// Mean distance to the nearest vertices that were taken, at rest, times the largest stretch.
    pub spacing: Vec<f32>,
    /// A sample near each at rest, on its sheet of the surface.
    pub homes: Vec<u32>,
    /// Half axes of splats, as they are drawn: the longer one first, at right angles to each other and to the
    /// normal; zero where nothing is to be seen. Empty where vertices are no splats.
    pub axes: Vec<[Vec3; 2]>,
    /// Values of the attributes that were asked for.
    pub values: Values,
    /// The cells, as in [`DetailRequest::cells`], and which vertices are theirs, in the order of the model.
    pub cells: Vec<(u32, Range<u32>)>,
}

impl DetailRequest {
    /// The cells with a marked sample, so finely that they give at most `most` vertices; or one of each cell,
    /// where that is more.
    ///
    /// # Errors
    /// The cells are not held; there are not as many marks as samples; no sample is marked.
    pub fn select(sampled: &SampledModel, marks: &[bool], most: usize) -> Result<Self> {
        let kept = sampled.checked_cells()?;
        if marks.len() != sampled.samples.len() {
            let what = format!("{} marks for {} samples", marks.len(), sampled.samples.len());
            return Err(Error::argument(what, "give one for each sample"));
        }
        let is_marked =
            |cell: &u32| kept.cells[*cell as usize].tree.samples.iter().any(|s| marks[*s as usize]);
        let cells: Vec<u32> = (0..kept.cells.len() as u32).filter(is_marked).collect();
        if cells.is_empty() {
            let hint = "select a part of the model, or look at it";
            return Err(Error::argument("nothing of the model was chosen", hint));
        }
        let vertices: Vec<u64> = cells.iter().map(|cell| kept.cells[*cell as usize].vertices).collect();
        Ok(Self { cells, stride: thinning::stride(&vertices, most as u64), shown: DetailAttributes::Nothing })
    }

    /// Copy of this request that asks for attributes of the vertices as well.
    pub fn showing(self, shown: DetailAttributes) -> Self {
        Self { shown, ..self }
    }

    /// Number of vertices that these cells have, and of those of them that are taken.
    pub fn vertices(&self, sampled: &SampledModel) -> [u64; 2] {
        let Some(kept) = sampled.held_cells() else { return [0; 2] };
        let of = |cell: &u32| kept.cells.get(*cell as usize).map_or(0, |cell| cell.vertices);
        let sums = self.cells.iter().map(of).map(|n| [n, n.div_ceil(self.stride)]);
        sums.fold([0; 2], |[all, taken], [n, k]| [all + n, taken + k])
    }
}

/// Streams the chosen cells of the model through `each`, batch by batch, deformed by a field of its samples,
/// or at rest. Vertices without a finite position are left out.
///
/// The batches do not depend on the number of threads. Positions do not depend on what else was chosen: they
/// are those that a reconstruction writes, in single precision. Spacings and estimated normals do, at the rim
/// of a batch.
///
/// Memory: about 250 bytes for each vertex of a batch, and 36 for each that was taken and whose cell is not
/// complete; in a model in no order, that may be all.
///
/// # Errors
/// The cells are not held, or not those of the model; the model cannot be read, or is not what was sampled;
/// `each` failed; the user cancelled.
pub fn stream(
    sampled: &SampledModel,
    model: &dyn Model,
    chosen: &DetailRequest,
    field: Option<&DeformationField<'_>>,
    progress: &dyn Progress,
    mut each: impl FnMut(DetailBatch) -> Result<()>,
) -> Result<Streamed> {
    let kept = sampled.checked_cells()?;
    if let Some(cell) = chosen.cells.iter().find(|cell| **cell as usize >= kept.cells.len()) {
        let what = format!("there is no cell {cell} among {}", kept.cells.len());
        return Err(Error::argument(what, "choose cells of this model"));
    }
    let changed = || sampled.source_changed(model.path());
    let (frame, shown) = (sampled.frame, chosen.shown);
    let splats = Ellipses::from_attributes(&model.info().attributes);
    let gathering = Gathering {
        model,
        kept,
        frame,
        cubes: None,
        with_ids: false,
        attributes: shown.count().max(splats.as_ref().map_or(0, Ellipses::count)),
        opaque: sampled.opaque(model),
    };
    let extents = sampled.samples.extents();
    let carrying = Carrying { sampled, extents: &extents, field, stride: chosen.stride, progress };
    let mut cells = OpenCells::new(chosen, kept, splats, frame.scale);
    let mut hand_on = |parts: &mut Vec<CellVertices>| -> Result<()> {
        let batch = carrying.batch(parts)?;
        parts.clear();
        if batch.positions.is_empty() { Ok(()) } else { each(batch) }
    };
    progress.begin("streaming vertices", gathering.bytes_of(&chosen.cells));
    let bytes = gathering.visit(&chosen.cells, progress, |visited| {
        let Some(vertex) = visited else { return Ok(true) };
        let is_of_cell = cells.take(&vertex);
        if cells.held >= BATCH {
            hand_on(&mut cells.complete)?;
            cells.held = 0;
        }
        Ok(is_of_cell)
    })?;
    let bytes = bytes.ok_or_else(changed)?;
    if !cells.are_complete() {
        return Err(changed());
    }
    hand_on(&mut cells.complete)?;
    Ok(Streamed { bytes, ..cells.streamed })
}

/// The chosen cells, while their vertices come.
struct OpenCells<'a> {
    shown: DetailAttributes,
    kept: &'a KeptCells,
    thinning: Thinning,
    splats: Option<Ellipses>,
    /// Model units of a local one.
    scale: f64,
    /// Vertices that came of each cell, in the order in which the cells were chosen.
    open: Vec<CellVertices>,
    /// Cells of which all vertices have come, until they are handed on, and the number of their vertices.
    complete: Vec<CellVertices>,
    held: usize,
    streamed: Streamed,
}

impl<'a> OpenCells<'a> {
    fn new(chosen: &DetailRequest, kept: &'a KeptCells, splats: Option<Ellipses>, scale: f64) -> Self {
        let shown = chosen.shown;
        let open = chosen.cells.iter().map(|cell| CellVertices::new(*cell, &shown)).collect();
        let (thinning, streamed) = (Thinning::new(chosen.stride), Streamed::default());
        Self { shown, kept, thinning, splats, scale, open, complete: Vec::new(), held: 0, streamed }
    }

    /// Takes a vertex; `false` if its cell has all of its vertices already.
    fn take(&mut self, vertex: &Visited<'_>) -> bool {
        let part = &mut self.open[vertex.at as usize];
        let all = self.kept.cells[part.cell as usize].vertices;
        if part.seen == all {
            return false;
        }
        if self.thinning.takes(part.cell, part.seen, all) {
            let normal = match &self.splats {
                Some(splats) => part.push_ellipse(splats, vertex, self.scale),
                None => vertex.normal,
            };
            part.positions.push(vertex.position);
            part.normals.push(normal);
            part.values.push(&self.shown, vertex);
        }
        part.seen += 1;
        if part.seen == all {
            self.held += part.positions.len();
            self.streamed.vertices += part.positions.len() as u64;
            self.streamed.of += all;
            let whole = CellVertices { seen: all, ..CellVertices::new(part.cell, &self.shown) };
            self.complete.push(std::mem::replace(part, whole));
        }
        true
    }

    /// Whether all vertices of all chosen cells have come.
    fn are_complete(&self) -> bool {
        self.open.iter().all(|part| part.seen == self.kept.cells[part.cell as usize].vertices)
    }
}

/// Vertices of one cell that have come so far.
struct CellVertices {
    cell: u32,
    /// Number of its vertices that came.
    seen: u64,
    /// The vertices that were taken: model coordinates, and normals, zero where there are none.
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    /// The two axes of each splat, in local units; zero where nothing is to be seen.
    axes: Vec<[Vec3; 2]>,
    values: Values,
}

impl CellVertices {
    fn new(cell: u32, shown: &DetailAttributes) -> Self {
        let (positions, normals, axes) = Default::default();
        Self { cell, seen: 0, positions, normals, axes, values: shown.none() }
    }

    /// Takes the half axes of a splat; gives its normal, on any side.
    fn push_ellipse(&mut self, splats: &Ellipses, vertex: &Visited<'_>, unit: f64) -> Vec3 {
        let (axes, normal) =
            splats.ellipse(|place| vertex.attribute(place)).unwrap_or(([DVec3::ZERO; 2], DVec3::ZERO));
        self.axes.push(axes.map(|axis| (axis / unit).as_vec3()));
        normal.as_vec3()
    }
}

/// The vertices of several cells, one after the other; the lists are those of [`CellVertices`].
struct JoinedCells {
    rest: Vec<DVec3>,
    known: Vec<Vec3>,
    axes: Vec<[Vec3; 2]>,
    values: Values,
    /// The cells, and which vertices are theirs.
    cells: Vec<(u32, Range<u32>)>,
}

impl JoinedCells {
    fn new(parts: &[CellVertices]) -> Self {
        let (rest, known, axes) = Default::default();
        let mut all =
            Self { rest, known, axes, values: Values::Nothing, cells: Vec::with_capacity(parts.len()) };
        for part in parts {
            let first = all.rest.len() as u32;
            all.rest.extend_from_slice(&part.positions);
            all.known.extend_from_slice(&part.normals);
            all.axes.extend_from_slice(&part.axes);
            all.values.extend(&part.values, 0..part.values.len());
            all.cells.push((part.cell, first..all.rest.len() as u32));
        }
        all
    }
}

/// Inputs from which vertices of the model become a batch.
struct Carrying<'a> {
    sampled: &'a SampledModel,
    /// Radius of the surface that each sample stands for.
    extents: &'a [f32],
    field: Option<&'a DeformationField<'a>>,
    stride: u64,
    progress: &'a dyn Progress,
}

impl Carrying<'_> {
    fn batch(&self, parts: &[CellVertices]) -> Result<DetailBatch> {
        let JoinedCells { rest, mut known, mut axes, values, cells } = JoinedCells::new(parts);
        if rest.is_empty() {
            return Ok(DetailBatch { cells, ..DetailBatch::default() });
        }
        let frame = &self.sampled.frame;
        let local: Vec<Vec3> = rest.par_iter().map(|p| frame.to_local(*p)).collect();
        self.progress.check()?;
        let mut at = Vec::new();
        match self.field {
            Some(field) => homes(field.around(), frame, &rest, &mut at),
            None => local.par_iter().map(|p| self.sampled.samples.nearest(*p)).collect_into_vec(&mut at),
        }
        self.progress.check()?;
        // A splat does not tell which end of its shortest axis is outside; the samples' normals do.
        let at_samples = self.sampled.samples.normals();
        let outwards = |(n, home): (&mut Vec3, &u32)| *n *= n.dot(at_samples[*home as usize]).signum();
        known.iter_mut().zip(&at).take(axes.len()).for_each(outwards);
        let (normals, spacing) = self.surface(&local, &known, &at);
        // One of so many splats stands for all.
        let wider = (self.stride as f32).sqrt();
        axes.iter_mut().flatten().for_each(|axis: &mut Vec3| *axis *= wider);
        self.progress.check()?;
        let mut batch = DetailBatch { positions: local, normals, spacing, homes: at, axes, values, cells };
        if let Some(field) = self.field {
            self.deform(field, rest, &mut batch);
        }
        Ok(batch)
    }

    /// Carries a batch over; `moved` are the vertices' positions at rest in the model's coordinates.
    fn deform(&self, field: &DeformationField<'_>, mut moved: Vec<DVec3>, batch: &mut DetailBatch) {
        let frame = &self.sampled.frame;
        let DetailBatch { positions, normals, spacing, homes, axes, .. } = batch;
        let rest = moved.clone();
        let mut figures = vec![VertexDiagnostics::UNKNOWN; rest.len()];
        let mut gradients = vec![Mat3::IDENTITY; axes.len()];
        let to =
            Moved { normals, gradients: &mut gradients, figures: &mut figures, ..Moved::places(&mut moved) };
        carry(std::slice::from_ref(field), frame, &rest, Some(homes), &mut [to]);
        spacing.iter_mut().zip(&figures).for_each(|(spacing, figures)| {
            let stretch = figures.stretch[0];
            *spacing *= if stretch.is_finite() { stretch.min(MOST_STRETCH) } else { 1.0 };
        });
        axes.iter_mut().zip(&gradients).for_each(|(axes, g)| *axes = ellipses::image(*axes, g));
        *positions = moved.par_iter().map(|p| frame.to_local(*p)).collect();
    }

    /// Normals at rest of vertices of which some are known, and their spacing.
    fn surface(&self, positions: &[Vec3], known: &[Vec3], homes: &[u32]) -> (Vec<Vec3>, Vec<f32>) {
        let samples = &self.sampled.samples;
        let at_samples = samples.normals();
        // Vertices are hardly farther apart than samples.
        let most = (self.stride as f32).sqrt();
        let tree = KdTree::new(positions);
        let look = |(found, near): &mut (Vec<u64>, Vec<u32>), i: usize| {
            let (p, home) = (positions[i], homes[i] as usize);
            let is_known = known[i] != Vec3::ZERO;
            let wanted = if is_known { SPACING_NEIGHBOURS } else { normals::NEIGHBOURS };
            found.resize(wanted.min(positions.len() - 1), 0);
            tree.nearest_others(p, i as u32, found);
            near.clear();
            near.extend(found.iter().map(|found| *found as u32));
            let normal = if is_known {
                known[i]
            } else {
                let mut n = [Vec3::ZERO];
                normals::plane_normals(positions, i, |_| near, &mut n);
                let [n] = n;
                if n.dot(at_samples[home]) < 0.0 { -n } else { n }
            };
            // Vertices may be there twice, as at seams of textures.
            let (mut sum, mut count) = (0.0, 0);
            for j in near.iter().take(SPACING_NEIGHBOURS) {
                let d = positions[*j as usize].distance(p);
                (sum, count) = (sum + d, count + u8::from(d > 0.0));
            }
            let widest = most * self.extents[home];
            (normal, if count > 0 { (sum / f32::from(count)).min(widest) } else { widest })
        };
        (0..positions.len()).into_par_iter().map_init(Default::default, look).unzip()
    }
}
