//! A plugin that uses all that the interface had when it was first released. Never change it.
//!
//! Samples follow the plugin's handle `grip`, and are lifted along z by strokes: less the more samples are
//! fixed.

use simod_plugin_api::{
    Affine, Consumes, DeformInput, Deformer, Descriptor, Evaluate, Gizmo, HandleDesc, Handles, Host, IsIdentity,
    LogLevel, ParamDesc, PluginError, PluginResult, PrepareInput, Unit,
};

struct Veteran;

/// How far all samples are free to move, 0 to 1.
struct Prepared {
    free: f64,
}

impl Deformer for Veteran {
    type State = Prepared;
    type Scratch = Vec<u32>;

    fn descriptor() -> Descriptor {
        Descriptor::new("veteran", "Veteran", "1.0.0")
            .summary("Uses all that there is")
            .citation("Nobody, never")
            .author("SIMOD's tests")
            .url("none")
            .param(ParamDesc::float("height", "Height", 1.0).unit(Unit::RATIO).hard(-10.0, 10.0).hint("Of strokes"))
            .param(ParamDesc::int("times", "Times", 1).hard(1.0, 3.0).group("More"))
            .param(ParamDesc::bool("up", "Up", true))
            .param(ParamDesc::choice("along", "Along", "z", &[("y", "Y"), ("z", "Z")]))
            .param(ParamDesc::direction("axis", "Axis", [0.0, 1.0, 0.0]))
            .param(ParamDesc::point("center", "Centre", [0.5; 3]).unit(Unit::MODEL_LENGTH))
            .param(ParamDesc::colour("tint", "Tint", [0.0, 0.0, 0.0, 1.0]))
            .param(ParamDesc::curve("profile", "Profile", &[[0.0, 0.0], [1.0, 1.0]]).invalidates_preparation())
            .param(ParamDesc::file("notes", "Notes", &["txt"]))
            .consumes(Consumes {
                fixed_regions: true,
                triangles: true,
                graph: true,
                joints: true,
                strokes: true,
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Prepared> {
        let count = input.samples.positions().len();
        let lengths = [input.samples.normals().len(), input.samples.spacing().len()];
        let graph = input.graph().ok_or_else(|| PluginError::input("there are no neighbours").hint("make some"))?;
        let corners = input.triangles().map_or(&[][..], |t| t.indices()).as_flattened();
        let wrong = |i: &u32| *i as usize >= count;
        if lengths.iter().any(|l| ![0, count].contains(l)) || graph.len() != count || corners.iter().any(wrong) {
            return Err(PluginError::internal("the input does not fit together"));
        }
        if let Some(path) = input.params().file("notes")? {
            std::fs::read(path).map_err(|e| PluginError::parameter("notes", &format!("cannot be read: {e}")))?;
        }
        let mut held = vec![0.0; count];
        host.parallel_blocks(&mut held, 100, |first, block| {
            for (i, held) in (first..).zip(block) {
                *held = input.regions().iter().map(|r| f64::from(r.weights()[i])).fold(0.0, f64::max);
            }
        })?;
        let free = input.params().curve("profile")?.at(1.0 - held.iter().sum::<f64>() / count as f64);
        host.progress(1.0)?;
        host.log(LogLevel::INFO, "at your service");
        assert!(host.extension("org.nobody.nothing/1").is_none());
        Ok(Prepared { free })
    }

    fn deform(
        state: &Prepared,
        input: &DeformInput<'_>,
        scratch: &mut Vec<u32>,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        scratch.push(1);
        let (grip, lift) = (grip(input), lift(input)?);
        for (o, p) in out.iter_mut().zip(input.samples.positions()) {
            *o = image(p.map(f64::from), &grip, lift, state.free).map(|x| x as f32);
        }
        host.progress(1.0)
    }
}

impl Evaluate for Veteran {
    fn evaluate(
        state: &Prepared,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        _: &Host<'_>,
    ) -> PluginResult<()> {
        let (grip, lift) = (grip(input), lift(input)?);
        points.iter_mut().for_each(|p| *p = image(*p, &grip, lift, state.free));
        Ok(())
    }
}

impl Handles for Veteran {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        let center = input.params().vec3("center")?;
        let grip = HandleDesc::new("grip", center).name("Grip").gizmo(Gizmo::TRANSLATE | Gizmo::ROTATE);
        let joint = |j: &simod_plugin_api::Joint<'_>| HandleDesc::new(j.id(), j.position).parent(0);
        Ok([grip].into_iter().chain(input.joints().iter().map(joint)).collect())
    }
}

impl IsIdentity for Veteran {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(grip(input) == Affine::IDENTITY && input.strokes().is_empty())
    }
}

fn grip(input: &DeformInput<'_>) -> Affine {
    input.handle_motions().first().copied().unwrap_or(Affine::IDENTITY)
}

fn image(p: [f64; 3], grip: &Affine, lift: [f64; 3], free: f64) -> [f64; 3] {
    let q = grip.apply(p);
    std::array::from_fn(|k| p[k] + free * (q[k] + lift[k] - p[k]))
}

/// What all strokes add to every sample.
fn lift(input: &DeformInput<'_>) -> PluginResult<[f64; 3]> {
    let mut lift = [0.0; 3];
    for stroke in input.strokes() {
        let params = stroke.params();
        let sign = if params.bool("up")? { 1.0 } else { -1.0 };
        let along = if params.choice("along")? == "y" { 1 } else { 2 };
        let opacity = params.colour("tint")?[3];
        let times = params.int("times")? as f64;
        assert!(!stroke.points().is_empty() && params.vec3("axis")?.iter().all(|x| x.is_finite()));
        lift[along] += sign * opacity * times * stroke.radius * stroke.strength * params.float("height")?;
    }
    Ok(lift)
}

simod_plugin_api::export_plugin!(Veteran, evaluate, handles, is_identity);
