//! A third party's plugin that looks up whatever the host has for it, takes the time, and has older sessions.
//! `tests/c/surveyor.c` does the same in C, to the last bit.

use simod_plugin_api::{
    Choice, Consumes, DeformInput, Deformer, Descriptor, Host, Migrate, MigrationDesc, ParamSet, PluginError,
    PluginResult, Pose, PrepareInput, Settings,
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
}

impl Deformer for Surveyor {
    type State = ();
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
            .consumes(consumes)
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<()> {
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
            None => Ok(()),
        }
    }

    fn deform(
        _: &(),
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
