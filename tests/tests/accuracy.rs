//! How near the deformed model is to the exact deformation of each of its vertices.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec3};
use serde_json::Value;
use simod_tests::{MANY, OPTIMISED, Workplace};

/// Samples for the model of [`MANY`] vertices.
const SAMPLES: u64 = MANY / 20;

/// Largest error allowed, root of the mean square and worst vertex, as fractions of the diagonal: for 100 000
/// samples, and for the 6000 of a slow build, whose spacing is 4 times as wide.
const RMS: f64 = if OPTIMISED { 2e-4 } else { 8e-4 };
const WORST: f64 = if OPTIMISED { 5e-3 } else { 2e-2 };

/// Half of the normals deviate less, after a half-turn twist.
const MEDIAN_DEGREES: f64 = if OPTIMISED { 1.5 } else { 6.0 };

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

/// The error as the test itself finds it: where `exact` sends the vertices, and where they came out.
///
/// The program has to report the same, and not what it would like.
fn check_figures(work: &Workplace, error: &Value, exact: impl Fn(DVec3) -> DVec3) {
    check(error);
    let before = work.ply("amphora.ply");
    let (rest, after, diagonal) = (before.positions(), work.ply("edited.ply").positions(), before.diagonal());
    let deviations: Vec<f64> =
        rest.iter().zip(&after).map(|(p, q)| exact(*p).distance(*q) / diagonal).collect();
    let rms = (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt();
    let worst = deviations.iter().copied().max_by(f64::total_cmp).expect("vertices");
    for (name, here) in [("rms", rms), ("max", worst)] {
        let there = figure(error, name);
        assert!((here / there - 1.0).abs() < 0.01, "{name} is {here:.3e}, but reported as {there:.3e}");
    }
}

#[test]
fn half_turn_twist() {
    let (work, error) = warped("twist", 180.0);
    check_figures(&work, &error, twist);
}

#[test]
fn quarter_turn_bend() {
    let (work, error) = warped("bend", 90.0);
    check_figures(&work, &error, bend);
}

/// Normals go with the inverse transpose of the map's gradient, and keep their length.
#[test]
fn normals_of_a_twist() {
    let (work, _) = warped("twist", 180.0);
    let (before, after) = (work.ply("amphora.ply"), work.ply("edited.ply"));
    let pairs = before.normals().into_iter().zip(after.normals());
    let mut degrees = Vec::new();
    for (p, (n, m)) in before.positions().into_iter().zip(pairs) {
        assert!((m.length() - n.length()).abs() < 1e-5, "a normal of length {}", m.length());
        let exact = gradient(twist, p).inverse().transpose() * n;
        degrees.push(exact.angle_between(m).to_degrees());
    }
    degrees.sort_by(f64::total_cmp);
    let quantile = |q: f64| degrees[(q * degrees.len() as f64) as usize];
    // As far as triangles of samples tell how the surface shears between them.
    let (half, most) = (quantile(0.5), quantile(0.99));
    assert!(
        half < MEDIAN_DEGREES && most < 10.0 * MEDIAN_DEGREES,
        "half are within {half}°, 99 % within {most}°"
    );
}

/// A half turn over the height about the axis, none at the foot.
fn twist(p: DVec3) -> DVec3 {
    let part = ((p.y - CENTER.y) / HALF_HEIGHT).clamp(-1.0, 1.0) / 2.0 + 0.5;
    DMat3::from_rotation_y(part * PI) * p
}

/// The axis on a quarter of a circle towards +x, upright at the centre; straight beyond the height.
fn bend(p: DVec3) -> DVec3 {
    let radius = 2.0 * HALF_HEIGHT / FRAC_PI_2;
    let along = p.y - CENTER.y;
    let on_arc = along.clamp(-HALF_HEIGHT, HALF_HEIGHT);
    let (sin, cos) = (on_arc / radius).sin_cos();
    let beyond = along - on_arc;
    let across = radius - (radius - p.x) * cos + beyond * sin;
    DVec3::new(across, CENTER.y + (radius - p.x) * sin + beyond * cos, p.z)
}

/// Central differences.
fn gradient(map: fn(DVec3) -> DVec3, p: DVec3) -> DMat3 {
    let step = 1e-6;
    let column = |axis: DVec3| (map(p + axis * step) - map(p - axis * step)) / (2.0 * step);
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}
