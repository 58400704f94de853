//! Global warps of space: twist, bend, taper, stretch and shear along an axis, between two planes across it.
//!
//! A. H. Barr, *Global and local deformations of solid primitives*, SIGGRAPH 1984.
//!
//! Closed forms, so nothing is prepared: the same map serves the samples and any other point.

mod draft;
mod map;

use draft::Draft;
use map::{Warp, WarpKind};
use simod_plugin_api::{
    Bounds, Choice, Consumes, DeformInput, Deformer, Descriptor, Effort, Evaluate, Host, ParamSet, Params,
    PluginError, PluginResult, PrepareInput,
};

/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 4096;

/// The plugin.
struct WarpPlugin;

/// Parameters: the kind of warp, and its place.
#[derive(ParamSet)]
struct WarpSettings {
    /// Kind of deformation along the axis
    #[param(default = Operation::Twist)]
    operation: Operation,
    /// Point on the axis; a bend, stretch or shear leaves it where it is
    #[param(point, name = "Centre", default = [0.5; 3], unit = "model-length")]
    center: [f64; 3],
    /// Direction along which the warp runs
    #[param(direction, default = [0.0, 1.0, 0.0])]
    axis: [f64; 3],
    /// Direction to which a bend or shear leans the axis; its part along the axis does not count
    #[param(direction, default = [1.0, 0.0, 0.0])]
    direction: [f64; 3],
    /// Angle of a twist or bend over the whole range
    #[param(default = 90.0, unit = "degrees", soft = -360.0..=360.0)]
    angle: f64,
    /// Ratio of a taper's size at the end to that at the start, or of a stretch's length to that before
    #[param(default = 0.5, unit = "ratio", hard = f64::MIN_POSITIVE.., soft = 0.1..=4.0)]
    factor: f64,
    /// Makes what is stretched thinner as the range gets longer, so that the range keeps its volume
    #[param(default = false)]
    keep_volume: bool,
    /// Displacement of a shear across the axis, per length along it
    #[param(default = 0.5, soft = -2.0..=2.0)]
    slope: f64,
    /// Start of the range along the axis, as a signed distance from the centre
    #[param(default = -0.5, unit = "diagonal", soft = -1.0..=1.0)]
    from: f64,
    /// End of the range along the axis, as a signed distance from the centre
    #[param(default = 0.5, unit = "diagonal", soft = -1.0..=1.0)]
    to: f64,
}

#[derive(Choice, Clone, Copy)]
enum Operation {
    Twist,
    Bend,
    Taper,
    Stretch,
    Shear,
}

impl Deformer for WarpPlugin {
    type State = ();
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("warp", "Warp", env!("CARGO_PKG_VERSION"))
            .summary("Twists, bends, tapers, stretches or shears the whole model along an axis")
            .citation("A. H. Barr, Global and local deformations of solid primitives, SIGGRAPH 1984")
            .param_set::<WarpSettings>()
            .consumes(Consumes { effort: true, ..Consumes::default() })
    }

    fn prepare(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
        // There is nothing to prepare, but senseless parameters are better told early.
        warp(input.params(), &input.bounds).map(drop)
    }

    fn deform(
        _: &(),
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let warp = warp(input.params(), &input.bounds)?;
        let rest = input.samples.positions();
        let draft = (input.effort() == Effort::DRAFT).then(|| Draft::new(&warp)).flatten();
        if let Some(draft) = draft {
            return host.parallel_blocks(out, BLOCK, |first, out| draft.apply(&rest[first..], out));
        }
        host.parallel_blocks(out, BLOCK, |first, out| {
            for (o, p) in out.iter_mut().zip(&rest[first..]) {
                *o = warp.apply(p.map(f64::from)).map(|x| x as f32);
            }
        })
    }
}

impl Evaluate for WarpPlugin {
    fn evaluate(
        _: &(),
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let warp = warp(input.params(), &input.bounds)?;
        for block in points.chunks_mut(BLOCK) {
            block.iter_mut().for_each(|p| *p = warp.apply(*p));
            host.progress(0.0)?;
        }
        Ok(())
    }
}

/// The warp that the parameters describe.
fn warp(params: Params<'_>, bounds: &Bounds) -> PluginResult<Warp> {
    let WarpSettings { operation, center, axis, direction, angle, factor, keep_volume, slope, from, to } =
        params.read()?;
    if from >= to {
        let error = PluginError::parameter("from", &format!("is {from}, not less than `to`, {to}"));
        return Err(error.hint("give a range along the axis, such as from = -0.5, to = 0.5"));
    }
    let angle = angle.to_radians();
    let deformation = match operation {
        Operation::Twist => WarpKind::Twist { angle },
        Operation::Bend => WarpKind::Bend { angle, direction },
        Operation::Taper => WarpKind::Taper { factor },
        Operation::Stretch => WarpKind::Stretch { factor, keep_volume },
        Operation::Shear => WarpKind::Shear { slope, direction },
    };
    let diagonal = bounds.diagonal();
    Warp::new(deformation, center, axis, [from * diagonal, to * diagonal])
}

simod_plugin_api::export_plugin!(WarpPlugin, evaluate);

#[cfg(test)]
mod tests {
    use super::*;
    use simod_plugin_api::{Param, ParamKind, Samples};

    const BOUNDS: Bounds = Bounds { min: [-1.0, -2.0, -1.0], max: [1.0, 2.0, 1.0] };

    /// Difference between the images of samples and of space, and whether all stays in its place; `amount`
    /// 0 should do that.
    fn run(operation: &str, amount: f64, range: [f64; 2]) -> PluginResult<(f64, bool)> {
        let (centre, axis, direction) = ([0.1, 0.2, 0.0], [0.0, 3.0, 0.0], [1.0, 1.0, 0.0]);
        let (angle, factor, slope) = ([75.0 * amount], [1.0 - 0.7 * amount], [amount]);
        let (from, to) = ([range[0]], [range[1]]);
        let params = [
            Param::text("operation", ParamKind::CHOICE, operation),
            Param::numbers("center", ParamKind::POINT, &centre),
            Param::numbers("axis", ParamKind::DIRECTION, &axis),
            Param::numbers("direction", ParamKind::DIRECTION, &direction),
            Param::numbers("angle", ParamKind::FLOAT, &angle),
            Param::numbers("factor", ParamKind::FLOAT, &factor),
            Param::numbers("keep-volume", ParamKind::BOOL, &[1.0]),
            Param::numbers("slope", ParamKind::FLOAT, &slope),
            Param::numbers("from", ParamKind::FLOAT, &from),
            Param::numbers("to", ParamKind::FLOAT, &to),
        ];
        let rest: Vec<[f32; 3]> = (0..1000)
            .map(|i| {
                let t = i as f32 / 999.0;
                [(7.0 * t).sin(), 4.0 * t - 2.0, (11.0 * t).cos()]
            })
            .collect();
        let samples = Samples::new(&rest, &[], &[]);
        let host = Host::new(&());
        WarpPlugin::prepare(&PrepareInput::new(samples, BOUNDS, &[], &params), &host)?;
        let input = DeformInput::new(samples, BOUNDS, &[], &params);
        let mut out = vec![[f32::NAN; 3]; rest.len()];
        WarpPlugin::deform(&(), &input, &mut (), &mut out, &host)?;
        let mut exact: Vec<[f64; 3]> = rest.iter().map(|p| p.map(f64::from)).collect();
        WarpPlugin::evaluate(&(), &input, &mut exact, &host)?;
        let worst = out.iter().zip(&exact).flat_map(|(a, b)| (0..3).map(|i| (f64::from(a[i]) - b[i]).abs()));
        Ok((worst.fold(0.0, f64::max), out == rest))
    }

    #[test]
    fn samples_move_as_space_does() {
        for operation in Operation::ALL.iter().map(Choice::id) {
            let (worst, same) = run(operation, 1.0, [-0.4, 0.3]).unwrap();
            assert!(worst < 1e-6, "{operation}: {worst}");
            assert!(!same);
            let (_, same) = run(operation, 0.0, [-0.4, 0.3]).unwrap();
            assert!(same, "{operation} of nothing moves something");
        }
    }

    #[test]
    fn an_empty_range_is_refused() {
        let error = run("twist", 1.0, [0.5, 0.5]).unwrap_err();
        assert!(error.message.contains("`from`"), "{error}");
    }
}
