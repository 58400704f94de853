//! How near the deformed model is to the exact deformation of each of its vertices.

use glam::{DMat3, DVec3};
use serde_json::Value;
use simod_tests::{MANY, Motion, OPTIMISED, Workplace};

/// Samples for the model of [`MANY`] vertices.
const SAMPLES: u64 = MANY / 20;

/// Largest error allowed, root of the mean square and worst vertex, as fractions of the diagonal: for 100 000
/// samples, and for the 6000 of a slow build, whose spacing is 4 times as wide.
const RMS: f64 = if OPTIMISED { 2e-4 } else { 8e-4 };
const WORST: f64 = if OPTIMISED { 5e-3 } else { 2e-2 };

/// The range of a warp from the foot of the amphora to its mouth: its centre, and half the height.
const CENTER: DVec3 = DVec3::new(0.0, 1.0, 0.0);
const HALF_HEIGHT: f64 = 1.0;

/// The amphora after a warp over its whole height, and what `run --measure` says of it.
fn warped(operation: &str, degrees: f64) -> (Workplace, Value) {
    let work = Workplace::new();
    work.simod(&format!("generate -o amphora.ply --vertices {MANY}"));
    let range = HALF_HEIGHT / work.ply("amphora.ply").diagonal();
    let [x, y, z] = CENTER.to_array();
    let place = format!("center = [{x}, {y}, {z}], from = {}, to = {range}", -range);
    let params = format!("{{ operation = \"{operation}\", angle = {degrees}, {place} }}");
    work.write_session("amphora.ply", SAMPLES, &format!("[[step]]\ndeform = \"warp\"\nparams = {params}\n"));
    let report = work.report("run edit.toml --measure");
    (work, report["transfer_error"].clone())
}

fn figure(error: &Value, name: &str) -> f64 {
    error[name].as_f64().unwrap_or_else(|| panic!("no {name} in {error}"))
}

fn check(error: &Value) {
    assert_eq!(error["vertices"], MANY);
    assert!(figure(error, "rms") < RMS, "{error}");
    assert!(figure(error, "max") < WORST, "{error}");
}

/// Measured by the program, and once more here by Barr's formula: the program's figures are true.
#[test]
fn half_turn_twist() {
    let (work, error) = warped("twist", 180.0);
    check(&error);

    let (before, after) = (work.ply("amphora.ply"), work.ply("edited.ply"));
    let (rest, diagonal) = (before.positions(), before.diagonal());
    let deviation = |(p, q): (&DVec3, &DVec3)| twist(*p).of(*p).distance(*q) / diagonal;
    let deviations: Vec<f64> = rest.iter().zip(&after.positions()).map(deviation).collect();
    let rms = (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt();
    let worst = deviations.iter().copied().max_by(f64::total_cmp).expect("vertices");
    for (name, here) in [("rms", rms), ("max", worst)] {
        let there = figure(&error, name);
        assert!((here / there - 1.0).abs() < 0.01, "{name} is {here:.3e}, but reported as {there:.3e}");
    }

    // Normals go with the inverse transpose of the map's gradient: a turn about the axis, sheared along it.
    let mut errors = Vec::new();
    for ((p, n), m) in rest.iter().zip(before.normals()).zip(after.normals()) {
        assert!((m.length() - 1.0).abs() < 1e-5, "a normal of length {}", m.length());
        let exact = (twist_gradient(*p).inverse().transpose() * n).normalize_or_zero();
        errors.push(exact.angle_between(m));
    }
    errors.sort_by(f64::total_cmp);
    let quantile = |q: f64| errors[(q * errors.len() as f64) as usize].to_degrees();
    assert!(quantile(0.5) < 1.0 && quantile(0.99) < 10.0, "{}° {}°", quantile(0.5), quantile(0.99));
}

#[test]
fn quarter_turn_bend() {
    let (work, error) = warped("bend", 90.0);
    check(&error);
    // The foot and the mouth, upright before, lie at a right angle to each other.
    let ends = |name: &str| {
        let (rest, now) = (work.ply("amphora.ply").positions(), work.ply(name).positions());
        let mean = |range: std::ops::Range<f64>| {
            let found: Vec<&DVec3> =
                rest.iter().zip(&now).filter(|(p, _)| range.contains(&p.y)).map(|(_, q)| q).collect();
            found.iter().copied().sum::<DVec3>() / found.len() as f64
        };
        [mean(0.1..0.2) - mean(0.0..0.1), mean(1.9..2.0) - mean(1.8..1.9)]
    };
    let [foot, mouth] = ends("amphora.ply");
    assert!(foot.angle_between(mouth).to_degrees() < 3.0);
    let [foot, mouth] = ends("edited.ply");
    let degrees = foot.angle_between(mouth).to_degrees();
    assert!((80.0..95.0).contains(&degrees), "bent by {degrees}°");
}

/// What a half-turn twist over the height does to a point: a turn about the axis, none at the foot.
fn twist(p: DVec3) -> Motion {
    let part = ((p.y - CENTER.y) / HALF_HEIGHT).clamp(-1.0, 1.0) / 2.0 + 0.5;
    let turn = DMat3::from_rotation_y(part * std::f64::consts::PI);
    Motion { turn, scale: 1.0, pivot: CENTER, shift: DVec3::ZERO }
}

fn twist_gradient(p: DVec3) -> DMat3 {
    let step = 1e-6;
    let image = |q: DVec3| twist(q).of(q);
    let column = |axis: DVec3| (image(p + axis * step) - image(p - axis * step)) / (2.0 * step);
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}
