//! Handle-based deformation of space by radial basis functions.
//!
//! M. Botsch, L. Kobbelt, *Real-Time Shape Editing using Radial Basis Functions*, Eurographics 2005: the
//! displacement `d(x) = Σ w_j |x - c_j|³ + affine(x)` that meets the fixed and the handle regions' samples is as
//! smooth as can be in between. Handles move affinely, so the solutions for all their motions are spanned by four
//! per handle: these are found once, in `prepare`, with their values at all samples; a motion then costs one
//! small product per sample.

mod constraints;
mod fit;
mod kernel;

use constraints::{Constraints, HandleFrame, PER_HANDLE};
use faer::Mat;
use fit::{Fit, Goal};
use kernel::{BLOCK, Block, Frame, Point};
use simod_plugin_api::{
    Affine, Consumes, DeformInput, Deformer, Descriptor, Evaluate, Host, PluginError, PluginResult,
    PrepareInput,
};

/// Constraints that may take part in the least squares; all others are checked only.
const MOST_ROWS: usize = 20_000;
/// Share of the preparation's progress that the fit has; the samples' table has the rest.
const FIT_SHARE: f64 = 0.7;
/// Samples that are deformed at once on one thread.
const DEFORM_BLOCK: usize = 8192;
/// Blocks of points on one thread, which share their working memory.
const TOGETHER: usize = 64;

/// The plugin.
struct Rbf;

/// The solutions for all handle motions.
struct Prepared {
    fit: Fit,
    frame: Frame,
    handles: Vec<HandleFrame>,
    has_fixed: bool,
    /// Each sample's values of all right-hand sides' solutions, sample by sample.
    table: Vec<f32>,
}

impl Deformer for Rbf {
    type State = Prepared;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("rbf", "Radial basis functions", env!("CARGO_PKG_VERSION"))
            .summary("Moves handle regions, holds fixed ones, and bends space smoothly in between")
            .citation(
                "M. Botsch, L. Kobbelt, Real-Time Shape Editing using Radial Basis Functions, Eurographics 2005",
            )
            .param_set::<Goal>()
            .consumes(Consumes {
                fixed_regions: true,
                handle_regions: true,
                min_handles: 1,
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Prepared> {
        let goal: Goal = input.params().read()?;
        let constraints = Constraints::gather(input, MOST_ROWS)?;
        let fit = fit::fit(&constraints, goal, host, FIT_SHARE)?;
        if fit.residual > goal.tolerance {
            host.warn(&format!(
                "the regions are met to {:.1e} of the handles' motion, not {:.1e}, with {} centres",
                fit.residual,
                goal.tolerance,
                fit.functions.centers.len()
            ));
        }
        let table = table(&fit, constraints.frame, input.samples.positions(), host)?;
        let Constraints { frame, handles, has_fixed, .. } = constraints;
        Ok(Prepared { fit, frame, handles, has_fixed, table })
    }

    fn deform(
        state: &Prepared,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let motion = state.motion(input.transforms())?;
        let functions = motion.coefficients.len();
        if out.len() * functions != state.table.len() || input.samples.positions().len() != out.len() {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let rest = input.samples.positions();
        host.parallel_blocks(out, DEFORM_BLOCK, |first, out| {
            let table = state.table[first * functions..].chunks_exact(functions);
            for ((o, p), values) in out.iter_mut().zip(&rest[first..]).zip(table) {
                let mut q = motion.common.apply(p.map(f64::from));
                for (&value, k) in values.iter().zip(&motion.coefficients) {
                    (0..3).for_each(|i| q[i] += f64::from(value) * k[i]);
                }
                *o = q.map(|x| x as f32);
            }
        })
    }
}

impl Evaluate for Rbf {
    fn evaluate(
        state: &Prepared,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let motion = state.motion(input.transforms())?;
        let k = Mat::from_fn(motion.coefficients.len(), 3, |i, j| motion.coefficients[i][j]);
        let weights = &state.fit.weights * &k;
        let mut scratch = Block::default();
        let mut unit = [[0.0; 3]; BLOCK];
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            let unit = &mut unit[..points.len()];
            unit.iter_mut().zip(points.iter()).for_each(|(u, &p)| *u = state.frame.to_unit(p));
            let sums = state.fit.functions.sums(unit, weights.as_ref(), &mut scratch);
            for (i, p) in points.iter_mut().enumerate() {
                let common = motion.common.apply(*p);
                *p = std::array::from_fn(|j| common[j] + sums[(i, j)]);
            }
        }
        Ok(())
    }
}

/// What the handles do, in terms of the right-hand sides.
struct Motion {
    /// Applied everywhere: what the handles have in common, or nothing where there are fixed samples.
    common: Affine,
    /// How much of each solution comes on top, local coordinates.
    coefficients: Vec<Point>,
}

impl Prepared {
    fn motion(&self, transforms: &[Affine]) -> PluginResult<Motion> {
        if transforms.len() != self.handles.len() {
            let message = format!("{} transforms for {} handles", transforms.len(), self.handles.len());
            return Err(PluginError::internal(message));
        }
        // Solutions reproduce affine maps anyway; taking the common part out makes that exact, and settles what
        // coplanar handles leave open.
        let common = if self.has_fixed { Affine::IDENTITY } else { mean(transforms) };
        let mut coefficients = Vec::with_capacity(PER_HANDLE * transforms.len());
        for (handle, transform) in self.handles.iter().zip(transforms) {
            let [at, of] = [transform, &common].map(|a| a.apply(handle.centroid));
            coefficients.push(std::array::from_fn(|i| at[i] - of[i]));
            for axis in 0..3 {
                let column = |i: usize| handle.radius * (transform.rows[i][axis] - common.rows[i][axis]);
                coefficients.push(std::array::from_fn(column));
            }
        }
        Ok(Motion { common, coefficients })
    }
}

/// The mean of affine maps; exactly the map where all are the same.
fn mean(transforms: &[Affine]) -> Affine {
    let first = transforms.first().copied().unwrap_or(Affine::IDENTITY);
    let rest = |i: usize, j: usize| {
        transforms.iter().map(|t| t.rows[i][j] - first.rows[i][j]).sum::<f64>()
            / transforms.len().max(1) as f64
    };
    Affine { rows: std::array::from_fn(|i| std::array::from_fn(|j| first.rows[i][j] + rest(i, j))) }
}

/// The solutions' values at all samples.
fn table(fit: &Fit, frame: Frame, positions: &[[f32; 3]], host: &Host<'_>) -> PluginResult<Vec<f32>> {
    let functions = fit.weights.ncols();
    let mut table = vec![0.0; positions.len() * functions];
    let total = positions.len().max(1) as f64;
    let entries = BLOCK * functions;
    host.parallel_blocks(&mut table, TOGETHER * entries, |first, table| {
        let first = first / functions;
        // Whether to go on is looked after by whoever hands out the blocks.
        let _ = host.progress(FIT_SHARE + (1.0 - FIT_SHARE) * first as f64 / total);
        let mut scratch = Block::default();
        for (table, positions) in table.chunks_mut(entries).zip(positions[first..].chunks(BLOCK)) {
            let points: Vec<Point> = positions.iter().map(|p| frame.to_unit(p.map(f64::from))).collect();
            let sums = fit.functions.sums(&points, fit.weights.as_ref(), &mut scratch);
            for (i, values) in table.chunks_exact_mut(functions).enumerate() {
                values.iter_mut().enumerate().for_each(|(f, value)| *value = sums[(i, f)] as f32);
            }
        }
    })?;
    Ok(table)
}

simod_plugin_api::export_plugin!(Rbf, evaluate);

#[cfg(test)]
mod tests;
