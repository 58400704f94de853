//! A third party's plugin that looks up whatever the host has for it, takes the time, and has older sessions.
//! `tests/c/surveyor.c` does the same in C, to the last bit.

use simod_plugin_api::{
    Choice, Consumes, DeformInput, Deformer, Descriptor, Host, LogLevel, Migrate, MigrationDesc, ParamDesc,
    ParamSet, PluginError, PluginResult, PointsKind, Pose, PrepareInput, Settings,
};

/// Once it had `method` for what is `mode` now, and `distance` in percent for what is `reach` now, as a part
/// of the diagonal.
#[derive(ParamSet)]
struct Surveyor {
    /// What is looked up
    #[param(default = Mode::Nearest)]
    mode: Mode,
    /// How far it looks, as a part of the diagonal
    #[param(default = 0.1, hard = 0.0..=1.0)]
    reach: f64,
}

#[derive(Choice, Clone, Copy)]
enum Mode {
    Nearest,
    Within,
    Rest,
    Closest,
    Ray,
    Time,
    /// Along x by red, along y by quality, and along z by how many attributes there are.
    Paint,
    /// To the point of the other model that has the sample's id, or else the nearest one; and along its
    /// normal.
    Other,
}

/// Points of the other model, with their normals, and which sample each is, if it is one.
type Other = Vec<([f64; 3], [f32; 3], Option<u64>)>;

/// Most points that are taken of the other model.
const POINTS: u32 = 300;

/// Points of the other model, checked to be as the interface promises.
fn other(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Other> {
    let Some(other) = input.other_model("other") else { return Ok(Vec::new()) };
    let (points, normals, ids) = (other.positions(), other.normals(), other.ids());
    let is_unit = |n: &[f32; 3]| (n.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-3;
    let is_known = (other.kind == PointsKind::SAMPLES) == (ids.len() == points.len());
    let fits = other.triangles().as_flattened().iter().all(|i| (*i as usize) < points.len());
    if points.is_empty()
        || normals.len() != points.len()
        || !normals.iter().all(is_unit)
        || !is_known
        || !fits
    {
        return Err(PluginError::internal("the other model is not as promised"));
    }
    let path = input.params().model("other")?.ok_or_else(|| PluginError::internal("it has no name"))?;
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    host.log(
        LogLevel::INFO,
        &format!(
            "{name}: {} points of {}, {}",
            points.len(),
            other.vertices,
            if other.triangles().is_empty() { "a cloud" } else { "a surface" }
        ),
    );
    Ok((0..points.len()).map(|i| (points[i], normals[i], ids.get(i).copied())).collect())
}

impl Deformer for Surveyor {
    type State = Other;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        let consumes = Consumes {
            triangles: true,
            rest_positions: true,
            time: true,
            attributes: true,
            ..Consumes::default()
        };
        Descriptor::new("surveyor", "Surveyor", env!("CARGO_PKG_VERSION"))
            .summary("Moves samples to where the host says that something is")
            .author("a third party")
            .param_set::<Self>()
            .param(
                ParamDesc::model("other", "Other", POINTS).hint("Where samples go that have another model"),
            )
            .consumes(consumes)
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Other> {
        // Here as well as while it deforms.
        let itself = host.nearest(Pose::CURRENT)?.ones(input.samples.positions()[0].map(f64::from), 1);
        let rest = input.rest_positions().ok_or_else(|| PluginError::input("there is nothing at rest"))?;
        if itself != [0] || rest.len() != input.samples.positions().len() {
            return Err(PluginError::internal(format!("the first sample is {itself:?}")));
        }
        let all = input.attributes();
        match all.iter().find(|a| a.values().len() != rest.len() || a.values().iter().any(|x| !x.is_finite()))
        {
            Some(bad) => {
                Err(PluginError::internal(format!("not one number for each sample: {}", bad.name())))
            }
            None => other(input, host),
        }
    }

    fn deform(
        other: &Other,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let this: Self = input.params().read()?;
        let reach = this.reach * input.bounds.diagonal();
        let samples = input.samples.positions();
        let mean = |found: &[u32]| {
            let sum = |k: usize| found.iter().map(|i| f64::from(samples[*i as usize][k])).sum::<f64>();
            [0, 1, 2].map(|k| sum(k) / found.len() as f64)
        };
        let nearest = host.nearest(Pose::CURRENT)?;
        match this.mode {
            Mode::Nearest => host.parallel_blocks(out, 100, |first, out| {
                for (i, out) in (first..).zip(out) {
                    *out = mean(&nearest.ones(samples[i].map(f64::from), 5)).map(|x| x as f32);
                }
            })?,
            Mode::Within => {
                for (p, out) in samples.iter().zip(out) {
                    *out = mean(&nearest.within(p.map(f64::from), reach)).map(|x| x as f32);
                }
            }
            Mode::Rest => {
                let at_rest = host.nearest(Pose::REST)?;
                for (p, out) in samples.iter().zip(out) {
                    *out = samples[at_rest.ones(p.map(f64::from), 1)[0] as usize];
                }
            }
            Mode::Closest => {
                let surface = host.surface(Pose::CURRENT)?;
                for ([x, y, z], out) in samples.iter().map(|p| p.map(f64::from)).zip(out) {
                    let found = surface.closest([x + reach, y, z]);
                    *out = found.map_or([0.0; 3], |found| found.position).map(|x| x as f32);
                }
            }
            Mode::Ray => {
                let surface = host.surface(Pose::CURRENT)?;
                for ([x, y, z], out) in samples.iter().map(|p| p.map(f64::from)).zip(out) {
                    let found = surface.ray([x, y, 10.0], [0.0, 0.0, -2.0], f64::INFINITY);
                    *out = found.map_or([x, y, z], |found| found.position).map(|x| x as f32);
                }
            }
            Mode::Paint => {
                let count = input.attributes().len();
                let (red, quality) = (input.attribute("red"), input.attribute("quality"));
                if red.is_none() {
                    host.warn("there is no red");
                }
                for (i, (p, out)) in samples.iter().zip(out).enumerate() {
                    let by = [red.map_or(0.0, |x| f64::from(x[i])), quality.map_or(0.0, |x| f64::from(x[i]))];
                    let [x, y, z] = p.map(f64::from);
                    *out = [x + by[0] / 255.0, y + by[1], z + count as f64].map(|x| x as f32);
                }
            }
            Mode::Other => {
                for (i, (p, out)) in samples.iter().zip(out).enumerate() {
                    let p = p.map(f64::from);
                    let squared = |q: &[f64; 3]| (0..3).map(|k| (p[k] - q[k]) * (p[k] - q[k])).sum::<f64>();
                    let own = other.iter().find(|(.., id)| *id == Some(i as u64));
                    let near = || other.iter().min_by(|a, b| squared(&a.0).total_cmp(&squared(&b.0)));
                    let to = own
                        .or_else(near)
                        .map_or(p, |(q, n, _)| std::array::from_fn(|k| q[k] + reach * f64::from(n[k])));
                    *out = to.map(|x| x as f32);
                }
            }
            Mode::Time => {
                let time = input.time();
                for (p, out) in samples.iter().zip(out) {
                    *out = [p[0] + time.seconds as f32, p[1] + time.frame as f32, p[2]];
                }
            }
        }
        Ok(())
    }
}

impl Migrate for Surveyor {
    fn migration() -> MigrationDesc {
        MigrationDesc::new(2).alias("method", "mode").alias("distance", "reach")
    }

    fn migrate(_: u32, settings: &mut Settings) -> PluginResult<()> {
        if let Some(percent) = settings.number("reach") {
            if percent < 0.0 {
                return Err(
                    PluginError::parameter("reach", "was never below 0").hint("give a part of the diagonal")
                );
            }
            settings.set_number("reach", percent / 100.0);
        }
        Ok(())
    }
}

simod_plugin_api::export_plugin!(Surveyor, migrate);
