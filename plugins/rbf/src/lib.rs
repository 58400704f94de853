//! Handle-based deformation of space by radial basis functions.
//!
//! M. Botsch, L. Kobbelt, *Real-Time Shape Editing using Radial Basis Functions*, Eurographics 2005: the
//! displacement `d(x) = Σ w_j |x - c_j|³ + affine(x)` that meets the fixed and the handle regions' samples
//! is as smooth as can be in between. Handles move affinely, so the solutions for all their motions are
//! spanned by four solutions per handle: these are found once, in `prepare`, with their values at all
//! samples; a motion then costs one small product per sample.
//!
//! With compact kernels there is no affine part: places farther than the support from all regions do not
//! move at all, and a motion of all handles together is none of the whole. Either way samples in a region
//! have exactly the region's motion (`held`).

mod constraints;
mod domains;
mod fit;
mod held;
mod interpolation;
mod kernel;
mod least_squares;
mod side;
mod sums;
mod table;

use constraints::{HandleFrame, PER_HANDLE, RegionSamples};
use fit::{Goal, MOST_CENTERS, SplineFit};
use held::RegionResiduals;
use kernel::{BLOCK, Point, UnitBoxMap};
use simod_plugin_api::{
    Affine, Consumes, DeformInput, Deformer, Descriptor, Evaluate, Host, PluginError, PluginResult,
    PrepareInput,
};
use table::SolutionTable;

/// Distance from the regions within which residuals are felt, in units of the diagonal.
const HELD_REACH: f64 = 0.05;
/// Share of the preparation's progress that the fit has; the samples' table has the rest.
const FIT_SHARE: f64 = 0.7;
/// Number of blocks of points on one thread, which share their working memory.
const TOGETHER: usize = 64;

/// The plugin.
struct Rbf;

/// The solutions for all handle motions.
struct PreparedFits {
    fit: SplineFit,
    frame: UnitBoxMap,
    handles: Vec<HandleFrame>,
    has_fixed: bool,
    held: RegionResiduals,
    table: SolutionTable,
}

impl Deformer for Rbf {
    type State = PreparedFits;
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

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedFits> {
        let goal: Goal = input.params().read()?;
        let constraints = RegionSamples::gather(input, &goal, host)?;
        let length = |part: f64| constraints.frame.to_unit_length(part * input.bounds.diagonal());
        let support = length(goal.support);
        let fit = fit::fit(&constraints, &goal, support, host, FIT_SHARE)?;
        warn(&constraints, &fit, &goal, host);
        let reach = if goal.kernel.is_compact() { HELD_REACH.min(goal.support) } else { HELD_REACH };
        let held = RegionResiduals::new(&constraints, &fit, length(reach), host)?;
        let table =
            SolutionTable::new(&fit, &held, &constraints, input.samples.positions(), host, FIT_SHARE)?;
        let RegionSamples { frame, handles, has_fixed, .. } = constraints;
        Ok(PreparedFits { fit, frame, handles, has_fixed, held, table })
    }

    fn deform(
        state: &PreparedFits,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let motion = state.motion(input.transforms())?;
        let rest = input.samples.positions();
        if !state.table.is_of(motion.coefficients.len(), out.len()) || rest.len() != out.len() {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        state.table.deform(&motion, rest, out, host)
    }
}

impl Evaluate for Rbf {
    fn evaluate(
        state: &PreparedFits,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let motion = state.motion(input.transforms())?;
        let (mut unit, mut values) = ([[0.0; 3]; BLOCK], vec![0.0; motion.coefficients.len()]);
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            let unit = &mut unit[..points.len()];
            unit.iter_mut().zip(points.iter()).for_each(|(u, &p)| *u = state.frame.to_unit(p));
            let sums = state.fit.functions.sums(unit, state.fit.weights.as_ref());
            for (i, p) in points.iter_mut().enumerate() {
                values.iter_mut().enumerate().for_each(|(f, value)| *value = sums[f][i]);
                state.held.add(&unit[i], &mut values);
                let common = motion.common.apply(*p);
                *p = std::array::from_fn(|j| {
                    common[j] + values.iter().zip(&motion.coefficients).map(|(v, k)| v * k[j]).sum::<f64>()
                });
            }
        }
        Ok(())
    }
}

/// Motions of the handles, in terms of the right-hand sides.
struct HandleCombination {
    /// Affine map that is applied everywhere: the handles' common part, or the identity where there are fixed
    /// samples or the kernel is compact.
    common: Affine,
    /// Coefficient of each solution that is added to the common part, in local coordinates.
    coefficients: Vec<Point>,
}

impl PreparedFits {
    fn motion(&self, transforms: &[Affine]) -> PluginResult<HandleCombination> {
        if transforms.len() != self.handles.len() {
            let message = format!("{} transforms for {} handles", transforms.len(), self.handles.len());
            return Err(PluginError::internal(message));
        }
        // Solutions reproduce affine maps anyway; taking the common part out makes that exact, and
        // determines the motion that coplanar handles leave open. Compact kernels shall leave the rest of
        // the model alone.
        let is_local = self.has_fixed || self.fit.functions.kernel.is_compact();
        let common = if is_local { Affine::IDENTITY } else { mean(transforms) };
        let mut coefficients = Vec::with_capacity(PER_HANDLE * transforms.len());
        for (handle, transform) in self.handles.iter().zip(transforms) {
            let [at, of] = [transform, &common].map(|a| a.apply(handle.centroid));
            coefficients.push(std::array::from_fn(|i| at[i] - of[i]));
            for axis in 0..3 {
                let column = |i: usize| handle.radius * (transform.rows[i][axis] - common.rows[i][axis]);
                coefficients.push(std::array::from_fn(column));
            }
        }
        Ok(HandleCombination { common, coefficients })
    }
}

/// Mean of affine maps; exactly the map where all are the same.
fn mean(transforms: &[Affine]) -> Affine {
    let first = transforms.first().copied().unwrap_or(Affine::IDENTITY);
    let rest = |i: usize, j: usize| {
        transforms.iter().map(|t| t.rows[i][j] - first.rows[i][j]).sum::<f64>()
            / transforms.len().max(1) as f64
    };
    Affine { rows: std::array::from_fn(|i| std::array::from_fn(|j| first.rows[i][j] + rest(i, j))) }
}

/// Residual of a motion from which on regions that move apart may touch each other, so that no centres
/// help.
const CONTRADICTION: f64 = 0.4;

/// Part of a motion that is met, in percent, for this residual, with as many digits as tell it from all of
/// the motion.
fn met(left: f64) -> String {
    let decimals = (-left.max(1e-12).log10() - 2.0).ceil().clamp(0.0, 8.0) as usize;
    format!("{:.decimals$} %", 100.0 * (1.0 - left.min(1.0)))
}

/// Next tolerance of one digit above a residual.
fn tolerance_above(left: f64) -> f64 {
    let digit = 10f64.powf(left.max(1e-9).log10().floor());
    let above = (left / digit + 0.01).ceil();
    // The number is read back from one digit: 0.3, not 0.30000000000000004.
    format!("{:.0e}", (above * digit).min(1.0)).parse().unwrap_or(1.0)
}

/// Warns the user of a fit that misses the tolerance, and of other doubtful results.
fn warn(constraints: &RegionSamples, fit: &SplineFit, goal: &Goal, host: &Host<'_>) {
    let centers = fit.functions.centers.len();
    if fit.residual > goal.tolerance {
        let more = goal.max_centers.saturating_mul(4).min(MOST_CENTERS);
        let raise = if more > goal.max_centers {
            format!("raise `max-centers` to {more}, or ")
        } else {
            String::new()
        };
        let advice = if fit.residual > CONTRADICTION {
            format!("{raise}leave room between regions that move apart")
        } else {
            format!("{raise}raise `tolerance` to {}", tolerance_above(fit.residual))
        };
        host.warn(&format!(
            "the handles' motion is met to {} by {centers} centres, where {} was asked for: {advice}. Samples of \
             regions are held all the same, which may show at the rims",
            met(fit.residual),
            met(goal.tolerance),
        ));
    }
    if goal.kernel.is_compact() && constraints.is_sparse(0.5 * fit.functions.support) {
        host.warn("the samples of a handle hardly reach each other, and move as bumps of their own: raise `support`");
    }
}

simod_plugin_api::export_plugin!(Rbf, evaluate);

#[cfg(test)]
mod tests;
