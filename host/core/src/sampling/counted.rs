//! Pass 1 in parts: ranges of the vertices are counted by themselves, on any machine, each to a file; the
//! files add up, in any order, to the counts of one reading.

use std::ops::Range;
use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_model::{Error, Model, Progress, Result, SMALL_CHUNK, VertexChunk, input, output};

use super::grid::{CellKey, CellRecord, Grid, GridCounter};
use super::opaque::Opaque;
use crate::sealed::{seal, unsealed};

/// First letters of a file of counts.
const LETTERS: &[u8; 8] = b"simodcnt";

const VERSION: u32 = 1;

/// Most bytes of a file of counts: that of 10⁸ cells.
const LONGEST: u64 = 8 << 30;

/// The content of a file.
#[derive(Serialize, Deserialize)]
struct CountFile {
    /// The model's bytes and vertices.
    model: [u64; 2],
    resolution: u32,
    min_opacity: Option<f64>,
    vertices: Range<u64>,
    /// The number of vertices without a finite position, the first of them, and the number of those left out.
    non_finite: (u64, Option<u64>, u64),
    level: i32,
    bounds: [DVec3; 2],
    /// The cells in ascending order of their keys: count, first and last vertex.
    cells: Vec<(CellKey, [u64; 3])>,
}

/// Counts the vertices of a range to a file, unless it is there already.
pub(super) fn count(
    model: &dyn Model,
    of: &CountKey,
    (vertices, path): (Range<u64>, &Path),
    progress: &dyn Progress,
) -> Result<bool> {
    if read(path).is_ok_and(|there| of.fits(&there) && there.vertices == vertices) {
        return Ok(false);
    }
    let info = model.info();
    let share = (vertices.end - vertices.start) as f64 / info.vertices.max(1) as f64;
    progress.begin("counting", (info.vertex_bytes as f64 * share) as u64);
    let opaque = Opaque::find(model, of.min_opacity)?;
    let (counter, non_finite) = count_range(model, opaque, vertices.clone(), of.resolution, progress)?;
    write(of, vertices, counter, &non_finite, path)?;
    Ok(true)
}

/// Adds up the counts of some files, which are of all vertices, to one file as if they had been counted at
/// once, unless it is there already.
pub(super) fn merge(
    model: &dyn Model,
    of: &CountKey,
    files: &[impl AsRef<Path>],
    path: &Path,
) -> Result<bool> {
    let vertices = 0..model.info().vertices;
    if read(path).is_ok_and(|there| of.fits(&there) && there.vertices == vertices) {
        return Ok(false);
    }
    let (counter, non_finite) = added_up(model, of, files)?;
    write(of, vertices, counter, &non_finite, path)?;
    Ok(true)
}

/// Writes the counts of a range.
fn write(
    of: &CountKey,
    vertices: Range<u64>,
    counter: GridCounter,
    non_finite: &NonFinite,
    path: &Path,
) -> Result<()> {
    let (level, bounds, cells) = counter.into_cells();
    let counted = CountFile {
        model: of.model,
        resolution: of.resolution,
        min_opacity: of.min_opacity,
        vertices,
        non_finite: (non_finite.count, non_finite.first, non_finite.transparent),
        level,
        bounds: [bounds.min, bounds.max],
        cells: cells.into_iter().map(|(key, r)| (key, [r.count, r.first, r.last])).collect(),
    };
    let bytes = seal(LETTERS, VERSION, &counted).map_err(|e| Error::unwritable(path.display(), e))?;
    output::write_file(path, &bytes)
}

/// The key of counts: the model and the options that they belong to.
pub(super) struct CountKey {
    /// The model's bytes and vertices.
    pub(super) model: [u64; 2],
    pub(super) resolution: u32,
    pub(super) min_opacity: Option<f64>,
}

impl CountKey {
    fn fits(&self, counted: &CountFile) -> bool {
        let bits = |opacity: Option<f64>| opacity.map(f64::to_bits);
        (self.model, self.resolution) == (counted.model, counted.resolution)
            && bits(self.min_opacity) == bits(counted.min_opacity)
    }
}

/// The grid of all vertices, whose ranges were counted to these files.
///
/// Memory: 48 bytes per occupied cell and the map's slack, and a file.
pub(super) fn merged(
    model: &dyn Model,
    of: &CountKey,
    files: &[impl AsRef<Path>],
) -> Result<(Grid, NonFinite)> {
    let (counter, non_finite) = added_up(model, of, files)?;
    Ok((counter.finish(), non_finite))
}

fn added_up(
    model: &dyn Model,
    of: &CountKey,
    files: &[impl AsRef<Path>],
) -> Result<(GridCounter, NonFinite)> {
    let (mut counter, mut all, mut ranges) =
        (GridCounter::new(of.resolution), NonFinite::default(), Vec::new());
    for path in files.iter().map(AsRef::as_ref) {
        let counted = read(path)?;
        if !of.fits(&counted) {
            return Err(refused(path, "has counts of another model, or for other samples"));
        }
        let (count, first, transparent) = counted.non_finite;
        all.absorb(NonFinite { count, first, transparent });
        ranges.push(counted.vertices.clone());
        let cells = counted.cells.into_iter();
        let cells = cells.map(|(key, [count, first, last])| (key, CellRecord { count, first, last }));
        let [min, max] = counted.bounds;
        let counted = GridCounter::of_cells(of.resolution, counted.level, [min, max], cells);
        counter.absorb(counted.ok_or_else(|| refused(path, "has cells that make no sense"))?);
    }
    ranges.sort_by_key(|range| (range.start, range.end));
    let mut next = 0;
    let is_next = |range: &Range<u64>| std::mem::replace(&mut next, range.end) == range.start;
    if !ranges.iter().all(is_next) || next != model.info().vertices {
        return Err(Error::argument(
            format!("the counts of {} are not of each vertex once", model.path().display()),
            "count all ranges first",
        ));
    }
    Ok((counter, all))
}

fn refused(path: &Path, what: &str) -> Error {
    Error::mismatch(format!("{} {what}", path.display()), "remove it, and count that range again")
}

fn read(path: &Path) -> Result<CountFile> {
    let bytes = input::read(path, LONGEST)?;
    let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
    unsealed(&bytes, (LETTERS, VERSION), damaged)
}

/// Vertices whose position is not finite: they are left out of P_S, and keep their bytes.
#[derive(Default)]
pub(super) struct NonFinite {
    pub(super) count: u64,
    pub(super) first: Option<u64>,
    /// Number of splats that are left out as well, and are not among those.
    pub(super) transparent: u64,
}

impl NonFinite {
    pub(super) fn absorb(&mut self, other: Self) {
        self.count += other.count;
        self.transparent += other.transparent;
        self.first = self.first.into_iter().chain(other.first).min();
    }
}

/// Counts the vertices of a range.
pub(super) fn count_range(
    model: &dyn Model,
    opaque: Option<Opaque>,
    range: Range<u64>,
    resolution: u32,
    progress: &dyn Progress,
) -> Result<(GridCounter, NonFinite)> {
    let mut counter = GridCounter::new(resolution);
    let mut non_finite = NonFinite::default();
    let mut reader = model.vertices(range)?;
    reader.set_chunk(SMALL_CHUNK);
    if opaque.is_none() {
        reader.skip_attributes();
    }
    let mut chunk = VertexChunk::default();
    while reader.read(&mut chunk)? {
        progress.check()?;
        for (index, p) in (chunk.first..).zip(&chunk.positions) {
            if !p.is_finite() {
                non_finite.count += 1;
                non_finite.first.get_or_insert(index);
            }
        }
        if let Some(opaque) = opaque {
            non_finite.transparent += opaque.leave_out(model, &mut chunk)?;
        }
        for (index, p) in (chunk.first..).zip(&chunk.positions).filter(|(_, p)| p.is_finite()) {
            counter.add(*p, index);
        }
        progress.advance(chunk.raw().len() as u64);
    }
    Ok((counter, non_finite))
}
