//! The whole plugin, as the host calls it.

use super::*;
use proptest::prelude::*;
use simod_plugin_api::{
    Bounds, ErrorCode, HandleMotions, HostCalls, LogLevel, ModelFrame, Param, ParamKind, Part, Samples,
};
use std::sync::Mutex;

const BOUNDS: Bounds = Bounds { min: [-0.5, -0.7, -0.3], max: [0.5, 0.8, 0.4] };

fn samples(count: usize) -> Vec<[f32; 3]> {
    let at = |i: usize, axis: usize| (i as f64 * [0.618_034, 0.754_878, 0.569_840][axis]).fract();
    let sample =
        |i| std::array::from_fn(|a| (BOUNDS.min[a] + at(i, a) * (BOUNDS.max[a] - BOUNDS.min[a])) as f32);
    (0..count).map(sample).collect()
}

#[derive(Clone)]
struct Setup {
    samples: Vec<[f32; 3]>,
    cage: &'static str,
    detail: f64,
    file: String,
    origin: [f64; 3],
    coordinates: &'static str,
    poisson: f64,
}

impl Setup {
    fn new(cage: &'static str) -> Self {
        let (file, origin) = (String::new(), [0.0; 3]);
        Self {
            samples: samples(3000),
            cage,
            detail: 40.0,
            file,
            origin,
            coordinates: "mean-value",
            poisson: 0.0,
        }
    }

    fn somigliana(self, poisson: f64) -> Self {
        Self { coordinates: "somigliana", poisson, ..self }
    }

    fn of_file(name: &str, origin: [f64; 3]) -> Self {
        let file = format!("{}/../../tests/reference/{name}", env!("CARGO_MANIFEST_DIR"));
        Self { file, origin, ..Self::new("hull") }
    }

    fn with<T>(&self, call: impl FnOnce(&PrepareInput<'_>) -> T) -> T {
        let (detail, margin, poisson) = ([self.detail], [0.03], [self.poisson]);
        let params = [
            Param::text("cage", ParamKind::CHOICE, self.cage),
            Param::numbers("detail", ParamKind::INT, &detail),
            Param::numbers("margin", ParamKind::FLOAT, &margin),
            Param::text("file", ParamKind::FILE, &self.file),
            Param::text("coordinates", ParamKind::CHOICE, self.coordinates),
            Param::numbers("poisson", ParamKind::FLOAT, &poisson),
        ];
        // The frame puts the file's origin where the test wants it.
        let frame = ModelFrame { origin: self.origin.map(|x| -x), scale: 1.0 };
        let samples = Samples::new(&self.samples, &[], &[]);
        call(&PrepareInput::new(samples, BOUNDS, &[], &params).with_parts(&[Part::new(&frame)]))
    }

    fn prepare(&self) -> PreparedCage {
        self.with(|input| CagePlugin::prepare(input, &Host::new(&()))).unwrap()
    }

    fn motions(&self, motion: impl Fn(&HandleDesc) -> Affine) -> Vec<Affine> {
        self.with(|input| CagePlugin::handles(input, &Host::new(&()))).unwrap().iter().map(motion).collect()
    }

    fn deform(&self, state: &PreparedCage, motions: &[Affine]) -> Vec<[f32; 3]> {
        let motions = HandleMotions::new(motions);
        let parts = [Part::new(&motions)];
        let input =
            DeformInput::new(Samples::new(&self.samples, &[], &[]), BOUNDS, &[], &[]).with_parts(&parts);
        let mut out = vec![[f32::NAN; 3]; self.samples.len()];
        CagePlugin::deform(state, &input, &mut CageSums::default(), &mut out, &Host::new(&())).unwrap();
        out
    }

    fn evaluate(&self, state: &PreparedCage, motions: &[Affine]) -> Vec<[f64; 3]> {
        let motions = HandleMotions::new(motions);
        let parts = [Part::new(&motions)];
        let input = DeformInput::new(Samples::new(&[], &[], &[]), BOUNDS, &[], &[]).with_parts(&parts);
        let mut out: Vec<[f64; 3]> = self.samples.iter().map(|p| p.map(f64::from)).collect();
        CagePlugin::evaluate(state, &input, &mut out, &Host::new(&())).unwrap();
        out
    }
}

fn cages() -> [Setup; 3] {
    [Setup::new("hull"), Setup::new("box"), Setup::of_file("cage.obj", [0.1, 0.0, -0.1])]
}

/// Set-ups with all kinds of coordinates.
fn all() -> Vec<Setup> {
    let elastic =
        cages().into_iter().zip([0.0, 0.45, -0.5]).map(|(setup, poisson)| setup.somigliana(poisson));
    cages().into_iter().chain(elastic).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    DVec3::from(a).distance(b.into())
}

/// A motion of each vertex to somewhere else.
fn wild(handle: &HandleDesc) -> Affine {
    let [x, y, z] = handle.position;
    let by = [0.2 * (9.0 * y).sin(), 0.15 * (7.0 * z + x).cos(), 0.1 * (5.0 * x - y).sin()];
    let mut shift = Affine::IDENTITY;
    (0..3).for_each(|axis| shift.rows[axis][3] = by[axis]);
    shift
}

#[test]
fn what_does_not_move_stays_to_the_last_bit() {
    for setup in all() {
        let (state, still) = (setup.prepare(), setup.motions(|_| Affine::IDENTITY));
        assert_eq!(setup.deform(&state, &still), setup.samples);
        assert!(
            setup.evaluate(&state, &still).iter().zip(&setup.samples).all(|(q, p)| *q == p.map(f64::from))
        );
    }
}

#[test]
fn samples_move_as_space_does() {
    for setup in all() {
        let (state, motions) = (setup.prepare(), setup.motions(wild));
        let pairs = setup.deform(&state, &motions).into_iter().zip(setup.evaluate(&state, &motions));
        let worst = pairs.map(|(q, e)| distance(q.map(f64::from), e)).fold(0.0, f64::max);
        // Matrices have larger entries than weights.
        let rounding = if setup.coordinates == "mean-value" { 2e-7 } else { 1e-6 };
        assert!(worst < rounding, "{}: {worst}", setup.coordinates);
    }
}

#[test]
fn handles_are_the_vertices_in_their_order() {
    let setup = Setup::of_file("cage.obj", [0.1, 0.0, -0.1]);
    let handles = setup.with(|input| CagePlugin::handles(input, &Host::new(&()))).unwrap();
    let text = std::fs::read_to_string(&setup.file).unwrap();
    let vertices: Vec<&str> = text.lines().filter(|l| l.starts_with("v ")).collect();
    assert_eq!(handles.len(), vertices.len());
    for (i, (handle, line)) in handles.iter().zip(vertices).enumerate() {
        let p: Vec<f64> = line[2..].split(' ').map(|x| x.parse().unwrap()).collect();
        assert!(
            handle.id == i.to_string() && distance(handle.position, [p[0] + 0.1, p[1], p[2] - 0.1]) < 1e-15
        );
    }
    // A vertex takes near samples along more than far ones.
    let setup = Setup::new("hull");
    let state = setup.prepare();
    let handles = setup.with(|input| CagePlugin::handles(input, &Host::new(&()))).unwrap();
    let motions = setup.motions(|h| if h.id == "7" { wild(h) } else { Affine::IDENTITY });
    let moved = |(p, q): (&[f32; 3], [f32; 3])| {
        (distance(p.map(f64::from), handles[7].position), distance(p.map(f64::from), q.map(f64::from)))
    };
    let mut moved: Vec<(f64, f64)> =
        setup.samples.iter().zip(setup.deform(&state, &motions)).map(moved).collect();
    moved.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mean = |part: &[(f64, f64)]| part.iter().map(|m| m.1).sum::<f64>() / part.len() as f64;
    assert!(
        mean(&moved[..300]) > 10.0 * mean(&moved[2700..]),
        "{} {}",
        mean(&moved[..300]),
        mean(&moved[2700..])
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn affine_maps_are_reproduced(rows in prop::array::uniform3(prop::array::uniform4(-1.0..1.0_f64))) {
        let affine = Affine { rows };
        for setup in all() {
            let (state, motions) = (setup.prepare(), setup.motions(|_| affine));
            for (p, q) in setup.samples.iter().zip(setup.evaluate(&state, &motions)) {
                let miss = distance(q, affine.apply(p.map(f64::from)));
                prop_assert!(miss < 1e-10, "{} {} {}: {:?} {miss}", setup.coordinates, setup.cage, setup.file, p);
            }
            for (p, q) in setup.samples.iter().zip(setup.deform(&state, &motions)) {
                prop_assert!(distance(q.map(f64::from), affine.apply(p.map(f64::from))) < 1e-6);
            }
        }
    }
}

/// Host that keeps the lines that it hears, and stops the plugin if asked to.
#[derive(Default)]
struct Listener {
    lines: Mutex<Vec<String>>,
    stop: bool,
}

impl HostCalls for Listener {
    fn progress(&self, _: f64) -> bool {
        !self.stop
    }
    fn log(&self, level: LogLevel, message: &str) {
        assert_eq!(level, LogLevel::WARNING);
        self.lines.lock().unwrap().push(message.to_owned());
    }
}

#[test]
fn samples_outside_are_told() {
    let told = |setup: &Setup| {
        let host = Listener::default();
        setup.with(|input| CagePlugin::prepare(input, &Host::new(&host))).map(drop).unwrap();
        host.lines.into_inner().unwrap().concat()
    };
    assert_eq!(told(&Setup::new("hull")) + &told(&Setup::new("box")), "");
    assert_eq!(told(&Setup::new("hull").somigliana(0.0)), "");
    for setup in [Setup::of_file("cage.obj", [0.0; 3]), Setup::of_file("cage.obj", [0.0; 3]).somigliana(0.3)]
    {
        assert!(told(&setup).contains("samples lie outside"));
    }
    assert!(told(&Setup::of_file("cage.obj", [9.0; 3])).contains("the model's own coordinates"));
}

#[test]
fn what_cannot_be_is_refused() {
    let prepare = |setup: &Setup, host: &Listener| {
        setup.with(|input| CagePlugin::prepare(input, &Host::new(host)).map(drop)).unwrap_err()
    };
    let setup = Setup { samples: vec![[0.1; 3]; 3_000_000], detail: 400.0, ..Setup::new("hull") };
    let error = prepare(&setup, &Listener::default());
    assert!(error.message.contains("too many") && error.hint.contains("less than"), "{error}");
    let error = prepare(&setup.clone().somigliana(0.0), &Listener::default());
    assert!(error.message.contains("too many") && error.hint.contains("less than"), "{error}");
    let error = prepare(&Setup::of_file("cage.csv", [0.0; 3]), &Listener::default());
    assert!(error.message.contains("without a volume"), "{error}");
    for setup in [Setup::new("hull"), Setup::new("hull").somigliana(0.0)] {
        let error = prepare(&setup, &Listener { stop: true, ..Listener::default() });
        assert_eq!(error.code, ErrorCode::CANCELLED);
    }
}
