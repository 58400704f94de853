//! Deformation by a wire: a curve through the model, whose points are handles; the model around the curve
//! goes along.
//!
//! K. Singh, E. Fiume, *Wires: a geometric deformation technique*, SIGGRAPH 1998. A map of space: for each
//! sample the nearest place of the curve is found once, in `prepare`.

mod motion;
mod nearest;
mod points;
mod spline;

use glam::DVec3;
use motion::{WireEffects, WireMotion};
use nearest::{Foot, NearestOnCurve};
use simod_plugin_api::{
    Affine, Choice, Consumes, DeformInput, Deformer, Descriptor, Evaluate, HandleDesc, Handles, Host,
    IsIdentity, ParamDesc, ParamSet, Params, PluginError, PluginResult, PrepareInput,
};
use spline::Spline;

/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 1024;
/// Number of a wire's nodes that are compared with each other.
const MOST_COMPARED: usize = 1000;

/// Distance of two parts of a wire, in units of the diagonal, below which the user is warned.
const NEAR: f64 = 0.05;

/// The plugin.
struct CurvePlugin;

/// Parameters: the wire's place, and its effects.
#[derive(ParamSet)]
struct CurveSettings {
    /// Number of points of a wire that is made: through the model's middle, along its longest side
    #[param(default = 5, hard = 2..=100, soft = 3..=15, invalidates_preparation)]
    points: i64,
    /// Motion of what is beyond the wire's ends
    #[param(default = Ends::Follow, invalidates_preparation)]
    ends: Ends,
    /// Distance from the wire from which on nothing moves
    #[param(default = 1.0, unit = "diagonal", hard = f64::MIN_POSITIVE..=1e3, soft = 0.01..=1.0)]
    reach: f64,
    /// Part of the reach within which all goes along as a whole
    #[param(default = 0.5, hard = 0.0..=1.0, soft = 0.0..=1.0)]
    whole: f64,
    /// Turn about the wire from its beginning to its end
    #[param(default = 0.0, unit = "degrees", soft = -360.0..=360.0)]
    twist: f64,
    /// Makes thinner what is stretched along the wire, so that it keeps its volume
    #[param(default = false)]
    keep_volume: bool,
}

#[derive(Choice, Debug, Clone, Copy, PartialEq)]
enum Ends {
    #[choice(label = "Goes along with them")]
    Follow,
    #[choice(label = "Fades with the distance")]
    Fade,
}

/// The wire, and the samples' nearest places on it.
struct PreparedWire {
    rest: NearestOnCurve,
    /// Points before handles are moved: other places than at rest where a file gives some.
    placed: Vec<DVec3>,
    knots: Vec<f64>,
    feet: Vec<Foot>,
}

/// The points of the wire at rest, and before handles are moved.
fn wire(input: &PrepareInput<'_>) -> PluginResult<[Vec<DVec3>; 2]> {
    let params = input.params();
    let read = |id: &str| -> PluginResult<Option<Vec<DVec3>>> {
        let Some(path) = params.file(id)? else { return Ok(None) };
        let frame = input.frame().ok_or_else(|| {
            PluginError::input("this version of SIMOD does not tell where the file's coordinates are")
                .hint("use a newer one, or a wire that is made")
        })?;
        let points = points::read(path)?;
        Ok(Some(points.into_iter().map(|p| frame.to_local(p.into()).into()).collect()))
    };
    let rest = match read("wire")? {
        Some(points) => points,
        None => {
            let CurveSettings { points, .. } = params.read()?;
            let points =
                usize::try_from(points).map_err(|_| PluginError::parameter("points", "is negative"))?;
            points::along_the_middle(&input.bounds, input.samples.positions(), points)
        }
    };
    if let Some(i) =
        rest.windows(2).position(|pair| pair[0].distance(pair[1]) <= 1e-9 * input.bounds.diagonal())
    {
        return Err(PluginError::input(format!("points {i} and {} of the wire coincide", i + 1))
            .hint("a wire has each place once in succession: leave one of the two out"));
    }
    let placed = read("moved")?.unwrap_or_else(|| rest.clone());
    if placed.len() != rest.len() {
        let message = format!("the moved wire has {} points, the wire {}", placed.len(), rest.len());
        return Err(
            PluginError::input(message).hint("each point of the wire has its new place, in the same order")
        );
    }
    Ok([rest, placed])
}

/// The motion that parameters and handles make of the wire.
fn motion<'a>(state: &'a PreparedWire, input: &DeformInput<'_>) -> PluginResult<WireMotion<'a>> {
    let motions = input.handle_motions();
    if !motions.is_empty() && motions.len() != state.placed.len() {
        let message = format!("{} motions of {} points", motions.len(), state.placed.len());
        return Err(PluginError::internal(message));
    }
    let mut points = state.placed.clone();
    // A point that does not move shall not move by rounding either.
    let moved = points.iter_mut().zip(motions).filter(|(_, motion)| **motion != Affine::IDENTITY);
    moved.for_each(|(p, motion)| *p = motion.apply((*p).into()).into());
    let looks = looks(input.params(), input.bounds.diagonal())?;
    Ok(WireMotion::new(&state.rest, Spline::new(state.knots.clone(), points), looks))
}

fn looks(params: Params<'_>, diagonal: f64) -> PluginResult<WireEffects> {
    let CurveSettings { reach, whole, twist, keep_volume, .. } = params.read()?;
    let reach = reach * diagonal;
    Ok(WireEffects { reach, whole: whole * reach, twist: twist.to_radians(), keeps_volume: keep_volume })
}

impl Deformer for CurvePlugin {
    type State = PreparedWire;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("curve", "Wire", env!("CARGO_PKG_VERSION"))
            .summary("Bends what is around a curve as the curve is bent")
            .citation("K. Singh, E. Fiume, Wires: A Geometric Deformation Technique, SIGGRAPH 1998")
            .param(
                ParamDesc::file("wire", "Wire", &["csv", "txt", "xyz", "obj"])
                    .hint("Points along the wire at rest in the model's coordinates, a line of x, y, z for each; without, one is made"),
            )
            .param(
                ParamDesc::file("moved", "Moved wire", &["csv", "txt", "xyz", "obj"])
                    .hint("New places of these points, as many in the same order; handles move them on from there"),
            )
            .param_set::<CurveSettings>()
            .consumes(Consumes { frame: true, ..Consumes::default() })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedWire> {
        let [rest, placed] = wire(input)?;
        let CurveSettings { ends, .. } = input.params().read()?;
        let knots = spline::knots(&rest);
        let rest = NearestOnCurve::new(Spline::new(knots.clone(), rest), ends == Ends::Follow);
        let diagonal = input.bounds.diagonal();
        if let Some(across) = comes_back(&rest, diagonal) {
            host.warn(&format!(
                "the wire comes back to within {across:.1} % of the model's diagonal of itself: what lies between its two parts \
                 may be torn if they go different ways; several wires, a step for each, do not have that"
            ));
        } else if let Some(across) =
            comes_back(&NearestOnCurve::new(Spline::new(knots.clone(), placed.clone()), false), diagonal)
        {
            host.warn(&format!(
                "the moved wire comes back to within {across:.1} % of the model's diagonal of itself: what goes along with \
                 its two parts may be in one place"
            ));
        }
        let samples = input.samples.positions();
        let mut feet = vec![Foot { piece: 0, t: 0.0, distance: 0.0 }; samples.len()];
        let total = samples.len().max(1) as f64;
        host.parallel_blocks(&mut feet, BLOCK, |first, feet| {
            // The wish to stop is looked after by the code that hands out the blocks.
            let _ = host.progress(first as f64 / total);
            for (foot, p) in feet.iter_mut().zip(&samples[first..]) {
                *foot = rest.find(DVec3::from(p.map(f64::from)));
            }
        })?;
        Ok(PreparedWire { rest, placed, knots, feet })
    }

    fn deform(
        state: &PreparedWire,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = input.samples.positions();
        if [rest.len(), out.len()] != [state.feet.len(); 2] {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let motion = motion(state, input)?;
        host.parallel_blocks(out, BLOCK, |first, out| {
            for ((o, p), foot) in out.iter_mut().zip(&rest[first..]).zip(&state.feet[first..]) {
                let p64 = DVec3::from(p.map(f64::from));
                *o = motion.apply(p64, foot).as_vec3().into();
            }
        })
    }
}

impl Evaluate for CurvePlugin {
    fn evaluate(
        state: &PreparedWire,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let motion = motion(state, input)?;
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            for p in points {
                let x = DVec3::from(*p);
                *p = motion.apply(x, &state.rest.find(x)).into();
            }
        }
        Ok(())
    }
}

impl Handles for CurvePlugin {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        let [_, placed] = wire(input)?;
        let handle = |(i, p): (usize, &DVec3)| {
            HandleDesc::new(&i.to_string(), (*p).into()).name(&format!("Point {}", i + 1))
        };
        Ok(placed.iter().enumerate().map(handle).collect())
    }
}

impl IsIdentity for CurvePlugin {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        let CurveSettings { twist, .. } = input.params().read()?;
        let is_still = input.handle_motions().iter().all(|motion| *motion == Affine::IDENTITY);
        Ok(is_still && twist == 0.0 && input.params().file("moved")?.is_none())
    }
}

/// Distance of a wire from itself, in percent of the diagonal, where two parts of it come near each other:
/// there space is torn if they go different ways, or folded into one place.
fn comes_back(rest: &NearestOnCurve, diagonal: f64) -> Option<f64> {
    let stride = rest.nodes().len().div_ceil(MOST_COMPARED);
    let nodes: Vec<DVec3> = rest.nodes().iter().copied().step_by(stride).collect();
    let mut lengths = vec![0.0];
    for pair in nodes.windows(2) {
        lengths.push(lengths[lengths.len() - 1] + pair[0].distance(pair[1]));
    }
    // The length along a half circle is 1.6 times that across.
    let is_back = |i: usize, j: usize| {
        let across = nodes[i].distance(nodes[j]);
        across < NEAR * diagonal && lengths[j] - lengths[i] > 3.0 * across.max(NEAR * diagonal / 50.0)
    };
    let [i, j] =
        (0..nodes.len()).find_map(|i| (i + 1..nodes.len()).find(|&j| is_back(i, j)).map(|j| [i, j]))?;
    Some(100.0 * nodes[i].distance(nodes[j]) / diagonal)
}

simod_plugin_api::export_plugin!(CurvePlugin, evaluate, handles, is_identity);

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "the tests' files are their own")]
mod tests;
