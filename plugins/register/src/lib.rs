//! Non-rigid registration: the samples are deformed to another model, a mesh or a cloud, as far as both have
//! something in common.
//!
//! A rigid motion or a similarity lays the model on the target (`align`); coherent point drift (`drift`,
//! with the field of `gaussian`) finds corresponding points from afar; closest points draw a graph that is
//! as rigid as possible (`closest`, `graph`) from there to the target. All are fitted to some of the
//! points, and are maps of space, which apply to any sample (`registration`).

mod align;
mod closest;
mod drift;
mod gaussian;
mod graph;
#[path = "../../control-points/src/landmarks.rs"]
mod landmarks;
mod points;
mod registration;
mod tree;

use glam::DVec3;
use registration::{Map, register};
use simod_plugin_api::{
    Choice, Consumes, DeformInput, Deformer, Descriptor, Evaluate, Host, IsIdentity, ParamDesc, ParamSet,
    PluginError, PluginResult, PrepareInput,
};

/// Greatest number of the target's points that are taken.
const TARGET: u32 = 20_000;
/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 256;

/// The plugin.
struct Register;

#[derive(ParamSet)]
struct Settings {
    /// Method; drift finds what lies far apart, closest points meet the surface where it has a counterpart
    #[param(default = Method::CpdIcp, invalidates_preparation)]
    method: Method,
    /// Alignment at first: a rigid motion, or a similarity, which finds another size, as where units differ
    #[param(default = Align::Rigid, invalidates_preparation)]
    align: Align,
    /// Tries many turns of the model first, where it is not known how it is turned to the target
    #[param(default = false, invalidates_preparation)]
    any_turn: bool,
    /// Place of the result: at the target, or where the model was, as large as it was
    #[param(default = Place::Target, invalidates_preparation)]
    place: Place,
    /// Part of the target's points that are noise, or have no counterpart (w)
    #[param(default = 0.1, hard = 0.0..=0.95, group = "Drift", invalidates_preparation)]
    outliers: f64,
    /// Distance up to which a displacement carries along what is around (β)
    #[param(default = 0.5, unit = "diagonal", hard = 0.02..=10.0, soft = 0.1..=1.0, group = "Drift", invalidates_preparation)]
    width: f64,
    /// Weight of the displacements' smoothness (λ): larger ones are smoother, and fit less
    #[param(default = 3.0, hard = 1e-6..=1e6, soft = 0.1..=10.0, group = "Drift", invalidates_preparation)]
    smoothness: f64,
    /// Number of points of the model, and of the target, that take part
    #[param(default = 1500, hard = 10..=4000, soft = 200..=3000, group = "Drift", invalidates_preparation)]
    points: i64,
    /// Number of iterations at most
    #[param(default = 150, hard = 1..=1000, soft = 20..=300, group = "Drift", invalidates_preparation)]
    iterations: i64,
    /// Resistance of the model to bending in the end; larger ones bend less, and fit less
    #[param(default = 0.01, hard = 1e-6..=1e3, soft = 0.001..=1.0, group = "Closest points", invalidates_preparation)]
    stiffness: f64,
    /// Number of nodes of the graph that bends; more follow finer differences
    #[param(default = 250, hard = 4..=500, soft = 50..=400, group = "Closest points", invalidates_preparation)]
    nodes: i64,
}

#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    #[choice(label = "Drift, then closest points")]
    CpdIcp,
    #[choice(label = "Coherent point drift")]
    Cpd,
    #[choice(label = "Closest points, as rigid as possible")]
    Icp,
    #[choice(label = "Alignment alone")]
    Align,
}

#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
enum Align {
    None,
    Rigid,
    #[choice(label = "Similarity (with scale)")]
    Similarity,
}

#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Target,
    Model,
}

/// Map of space, and the images of all samples, found once and for all: 12 bytes for each.
#[derive(Debug, Default)]
struct State {
    map: Option<Map>,
    samples: Vec<[f32; 3]>,
}

impl Deformer for Register {
    type State = State;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("register", "Register", env!("CARGO_PKG_VERSION"))
            .summary("Deforms the model to another one, a mesh or a cloud, also where parts of either are missing")
            .citation(
                "A. Myronenko, X. Song, Point Set Registration: Coherent Point Drift, PAMI 2010; R. W. Sumner, J. Schmid, \
                 M. Pauly, Embedded Deformation for Shape Manipulation, SIGGRAPH 2007; B. Amberg, S. Romdhani, T. Vetter, \
                 Optimal Step Nonrigid ICP Algorithms for Surface Registration, CVPR 2007",
            )
            .param(
                ParamDesc::model("target", "Target", TARGET)
                    .hint("Model or cloud that the samples are deformed to"),
            )
            .param(
                ParamDesc::file("landmarks", "Landmarks", &["csv", "txt"])
                    .hint("Lines of a name, x, y, z, the place on the target as x, y, z, and maybe a weight"),
            )
            .param_set::<Settings>()
            .consumes(Consumes { frame: true, normals: true, ..Consumes::default() })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<State> {
        let Some(target) = input.other_model("target") else {
            host.warn("there is no target: nothing moves");
            return Ok(State::default());
        };
        let map = register(input, target, &input.params().read()?, host)?;
        let rest = input.samples.positions();
        let mut samples = vec![[0.0; 3]; rest.len()];
        host.parallel_blocks(&mut samples, BLOCK, |first, samples| {
            for (q, p) in samples.iter_mut().zip(&rest[first..]) {
                *q = map.apply(DVec3::from(p.map(f64::from))).as_vec3().into();
            }
        })?;
        if samples.iter().flatten().any(|x| !x.is_finite()) {
            return Err(PluginError::input("the result is not finite")
                .hint("check units, or give `align = \"similarity\"`"));
        }
        Ok(State { map: Some(map), samples })
    }

    fn deform(
        state: &State,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        _: &Host<'_>,
    ) -> PluginResult<()> {
        let from = if state.map.is_some() { &state.samples[..] } else { input.samples.positions() };
        if from.len() != out.len() {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        out.copy_from_slice(from);
        Ok(())
    }
}

impl Evaluate for Register {
    fn evaluate(
        state: &State,
        _: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let Some(map) = &state.map else { return Ok(()) };
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            points.iter_mut().for_each(|p| *p = map.apply(DVec3::from(*p)).into());
        }
        Ok(())
    }
}

impl IsIdentity for Register {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(input.params().model("target")?.is_none())
    }
}

simod_plugin_api::export_plugin!(Register, evaluate, is_identity);

#[cfg(test)]
mod tests;
