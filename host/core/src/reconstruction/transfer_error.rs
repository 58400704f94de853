//! Transfer error: the distance of a reconstruction from the exact deformation, over all vertices.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::histogram::Histogram;
use simod_model::{Error, Model, Progress, Result, for_positions, in_step, range_in_step};
use xxhash_rust::xxh3::xxh3_64;

use super::expectation::ErrorSums;
use super::{DeformationField, ExpectedError, Moved, carry};
use crate::sampled_model::SampledModel;

/// The deviation of a deformed model from the exact one. Lengths are fractions of the model's diagonal at
/// rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TransferError {
    /// Vertices compared: those with a finite position.
    pub vertices: u64,
    /// Root of the mean square.
    pub rms: f64,
    /// 99.9 % of the vertices deviate less (to 2 %).
    pub p999: f64,
    /// The worst vertex.
    pub max: f64,
    /// 99.9th percentile over pairs of vertices that follow each other in the file of the difference of their
    /// errors over their distance: it sees lumps that a small error can still make.
    pub jump: f64,
}

/// Vertices that follow each other in the file, of which all are compared or none.
const BLOCK: u64 = 1 << 10;

/// Compares the deformed model with the exact image of the model at rest: all vertices, or about `most` of
/// them where there are four times as many, in blocks that are chosen at random, the same ones each time.
/// `exact` maps points in the model's coordinates in place; `diagonal` is that of the model at rest.
///
/// Memory: a chunk of each model.
///
/// # Errors
/// A model cannot be read, they differ in their number of vertices, `exact` fails, or the user cancelled.
pub fn measure(
    model: &dyn Model,
    deformed: &dyn Model,
    (diagonal, most): (f64, Option<u64>),
    exact: &dyn Fn(&mut [DVec3]) -> Result<()>,
    progress: &dyn Progress,
) -> Result<TransferError> {
    let info = model.info();
    let share = most.filter(|most| info.vertices / 4 > *most).map(|most| most as f64 / info.vertices as f64);
    let is_chosen = |block: u64| {
        share.is_none_or(|share| xxh3_64(&block.to_le_bytes()) as f64 / (u64::MAX as f64) < share)
    };
    let mut compared = Compared::new(diagonal);
    if share.is_none() || !info.reads_exactly() || !deformed.info().reads_exactly() {
        let is_chosen = share.is_some().then_some(&is_chosen as _);
        compare_all([model, deformed], is_chosen, &mut compared, exact, progress)?;
    } else {
        same_count(model, deformed)?;
        let chosen: Vec<u64> = (0..info.vertices.div_ceil(BLOCK)).filter(|block| is_chosen(*block)).collect();
        compare_some([model, deformed], &chosen, &mut compared, exact, progress)?;
    }
    Ok(compared.finish())
}

/// Maps points in place.
type PointMap<'a> = &'a dyn Fn(&mut [DVec3]) -> Result<()>;

/// Reads all of both models, and compares them, or only the blocks that are chosen.
fn compare_all(
    models: [&dyn Model; 2],
    is_chosen: Option<&dyn Fn(u64) -> bool>,
    compared: &mut Compared,
    exact: PointMap<'_>,
    progress: &dyn Progress,
) -> Result<()> {
    progress.begin("measuring", models[0].info().vertex_bytes);
    let mut at = 0;
    in_step(&models, 0, progress, |versions| {
        let (rest, found) = (versions[0].positions, versions[1].positions);
        // Parts of one block, or of the next.
        let mut from = 0;
        while from < rest.len() {
            let block = (at + from as u64) / BLOCK;
            let to = if is_chosen.is_none() { rest.len() } else { ((block + 1) * BLOCK - at) as usize };
            let to = to.min(rest.len());
            if is_chosen.is_none_or(|is_chosen| is_chosen(block)) {
                compared.add(&rest[from..to], &found[from..to], usize::MAX, exact)?;
            } else {
                compared.last = None;
            }
            from = to;
        }
        at += rest.len() as u64;
        Ok(())
    })
}

/// Reads some blocks of both models, and compares these.
fn compare_some(
    models: [&dyn Model; 2],
    chosen: &[u64],
    compared: &mut Compared,
    exact: PointMap<'_>,
    progress: &dyn Progress,
) -> Result<()> {
    let info = models[0].info();
    let bytes = info.vertex_bytes / info.vertices.max(1) * BLOCK * chosen.len() as u64;
    progress.begin("measuring some vertices", bytes);
    // Blocks are mapped together in numbers that give all threads work.
    for some in chosen.chunks(1 << 6) {
        let (mut rest, mut found) = (Vec::new(), Vec::new());
        for block in some {
            let range = block * BLOCK..info.vertices.min((block + 1) * BLOCK);
            range_in_step(&models, range, 0, progress, |_, versions| {
                rest.extend_from_slice(versions[0].positions);
                found.extend_from_slice(versions[1].positions);
                Ok(())
            })?;
        }
        compared.last = None;
        compared.add(&rest, &found, BLOCK as usize, exact)?;
    }
    Ok(())
}

/// An error where two models differ in their number of vertices.
fn same_count(model: &dyn Model, deformed: &dyn Model) -> Result<()> {
    let [a, b] = [model, deformed].map(|model| model.info().vertices);
    if a == b {
        return Ok(());
    }
    let what =
        format!("{} has {b} vertices, but {} has {a}", deformed.path().display(), model.path().display());
    Err(Error::mismatch(what, "compare versions of the same model"))
}

/// Sums of the deviation over the vertices so far.
struct Compared {
    errors: Histogram,
    jumps: Histogram,
    count: u64,
    sum: f64,
    max: f64,
    scale: f64,
    /// The vertex before, and its error.
    last: Option<(DVec3, DVec3)>,
}

impl Compared {
    fn new(diagonal: f64) -> Self {
        let scale = 1.0 / diagonal.max(f64::MIN_POSITIVE);
        let (errors, jumps) = (Histogram::default(), Histogram::default());
        Self { errors, jumps, count: 0, sum: 0.0, max: 0.0, scale, last: None }
    }

    /// Adds vertices in the file's order, of which `row` at a time follow each other there.
    fn add(
        &mut self,
        rest: &[DVec3],
        found: &[DVec3],
        row: usize,
        exact: &dyn Fn(&mut [DVec3]) -> Result<()>,
    ) -> Result<()> {
        let finite: Vec<usize> = (0..rest.len()).filter(|i| rest[*i].is_finite()).collect();
        let mut truth: Vec<DVec3> = finite.iter().map(|i| rest[*i]).collect();
        exact(&mut truth)?;
        for (i, truth) in finite.into_iter().zip(truth) {
            let error = (found[i] - truth) * self.scale;
            let length = error.length();
            self.count += 1;
            self.sum += length * length;
            self.max = self.max.max(length);
            self.errors.add(length);
            if i % row == 0 && i > 0 {
                self.last = None;
            }
            if let Some((p, e)) = self.last {
                let distance = (rest[i] - p).length() * self.scale;
                if distance > 0.0 {
                    self.jumps.add((error - e).length() / distance);
                }
            }
            self.last = Some((rest[i], error));
        }
        Ok(())
    }

    fn finish(self) -> TransferError {
        TransferError {
            vertices: self.count,
            rms: (self.sum / self.count.max(1) as f64).sqrt(),
            p999: self.errors.quantile(0.999),
            max: self.max,
            jump: self.jumps.quantile(0.999),
        }
    }
}

/// Vertices whose error is more than is allowed: their places (local coordinates) and errors (local units).
pub type Excesses = Vec<(Vec3, f32)>;

/// Largest number of vertices that [`measure_some`] returns.
pub const MOST_TOLD: usize = 1 << 16;

/// Compares the deformed positions of some vertices by `field`, no more than `most` and chosen at random,
/// with their exact images; nothing is written, but the positions are rounded as the file does it. The same
/// vertices each time; [`jump`](TransferError::jump) is 0.
///
/// Vertices that are off by more than `beyond`, a fraction of the diagonal, are told, up to [`MOST_TOLD`].
///
/// Memory: a chunk of the model, 72 bytes for each of its vertices, and 16 for each that is told.
///
/// # Errors
/// As of [`measure`].
pub fn measure_some(
    model: &dyn Model,
    field: &DeformationField<'_>,
    of: &SampledModel,
    (most, beyond): (u64, f64),
    exact: &dyn Fn(&mut [DVec3]) -> Result<()>,
    progress: &dyn Progress,
) -> Result<(TransferError, Excesses)> {
    let info = model.info();
    let mut told = Vec::new();
    progress.begin("measuring some vertices", info.vertex_bytes);
    let share = most as f64 / info.vertices.max(1) as f64;
    let is_chosen = |i: u64| share >= 1.0 || xxh3_64(&i.to_le_bytes()) as f64 / (u64::MAX as f64) < share;
    let scale = 1.0 / of.bounds.diagonal().max(f64::MIN_POSITIVE);
    let mut errors = ErrorSums::default();
    let mut count = 0;
    for_positions(model, |chunk| {
        progress.check()?;
        let chosen: Vec<usize> = (0..chunk.len())
            .filter(|i| is_chosen(chunk.first + *i as u64) && chunk.positions[*i].is_finite())
            .collect();
        let rest: Vec<DVec3> = chosen.iter().map(|i| chunk.positions[*i]).collect();
        let (mut found, mut truth) = (rest.clone(), rest.clone());
        let moved = Moved { positions: &mut found, normals: &mut [], gradients: &mut [], figures: &mut [] };
        carry(std::slice::from_ref(field), &of.frame, &rest, None, &mut [moved]);
        exact(&mut truth)?;
        for ((rest, found), truth) in rest.iter().zip(&found).zip(&truth) {
            // A vertex that does not move is not rounded again.
            let written = if found == rest { *found } else { info.rounded(*found) };
            let off = written.distance(*truth);
            errors.add(off * scale, 1);
            count += 1;
            if off * scale > beyond && told.len() < MOST_TOLD {
                told.push((of.frame.to_local(*rest), (off / of.frame.scale) as f32));
            }
        }
        progress.advance(chunk.raw().len() as u64);
        Ok(())
    })?;
    let ExpectedError { rms, p999, worst: max, .. } = errors.sum(true);
    Ok((TransferError { vertices: count, rms, p999, max, jump: 0.0 }, told))
}
