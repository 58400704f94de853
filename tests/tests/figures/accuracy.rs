//! Distance of the deformed model from the exact deformation of each of its vertices.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec3};
use serde_json::Value;
use simod_tests::{MANY, OPTIMISED, Ply, Workplace};

/// Samples for the model of [`MANY`] vertices.
const SAMPLES: u64 = MANY / 20;

/// A method of the reconstruction, and the largest errors allowed: root of the mean square and worst vertex,
/// as fractions of the diagonal, and the deviation of normals in degrees, in the median. For 100 000 samples,
/// and for the 6000 of a slow build, whose spacing is 4 times as wide.
struct Method {
    name: &'static str,
    rms: f64,
    worst: f64,
    /// The 99.9th percentile of the error's slope along the file.
    jump: f64,
    normals: f64,
}

const METHODS: [Method; 2] = [
    Method {
        name: "projected-barycentric",
        rms: if OPTIMISED { 1.5e-4 } else { 8e-4 },
        worst: if OPTIMISED { 4e-3 } else { 2e-2 },
        jump: if OPTIMISED { 1.0 } else { 4.0 },
        normals: if OPTIMISED { 1.5 } else { 6.0 },
    },
    Method {
        name: "blended-jets",
        rms: if OPTIMISED { 6e-6 } else { 3e-4 },
        worst: if OPTIMISED { 1e-3 } else { 1e-2 },
        jump: if OPTIMISED { 0.02 } else { 0.5 },
        normals: if OPTIMISED { 0.05 } else { 2.0 },
    },
];

/// The range of a warp from the foot of the amphora to its mouth: its centre, and half the height.
const CENTER: DVec3 = DVec3::new(0.0, 1.0, 0.0);
const HALF_HEIGHT: f64 = 1.0;

/// The amphora after a warp over its whole height, and what `run --measure` says of it.
fn warped(operation: &str, degrees: f64, method: &Method) -> (Workplace, Value) {
    let work = Workplace::new();
    work.simod(&format!("generate -o amphora.ply --vertices {MANY}"));
    let range = HALF_HEIGHT / work.ply("amphora.ply").diagonal();
    let [x, y, z] = CENTER.to_array();
    let place = format!("center = [{x}, {y}, {z}], from = {}, to = {range}", -range);
    let params = format!("{{ operation = \"{operation}\", angle = {degrees}, {place} }}");
    work.write_session("amphora.ply", SAMPLES, &format!("[[step]]\ndeform = \"warp\"\nparams = {params}\n"));
    let report = work.report(&format!("run edit.toml --measure --method {}", method.name));
    (work, report["transfer_error"].clone())
}

fn figure(error: &Value, name: &str) -> f64 {
    error[name].as_f64().unwrap_or_else(|| panic!("no {name} in {error}"))
}

fn check(error: &Value, method: &Method) {
    assert_eq!(error["vertices"], MANY);
    assert!(figure(error, "rms") < method.rms, "{}: {error}", method.name);
    assert!(figure(error, "jump") < method.jump, "{}: {error}", method.name);
    assert!(figure(error, "max") < method.worst, "{}: {error}", method.name);
}

/// The error as the test itself finds it: where `exact` sends the vertices, and where they came out.
///
/// The program has to report the same, and not what it would like. Returns the model before and after.
fn check_figures(operation: &str, degrees: f64, method: &Method, exact: fn(DVec3) -> DVec3) -> [Ply; 2] {
    let (work, error) = warped(operation, degrees, method);
    check(&error, method);
    let (before, edited) = (work.ply("amphora.ply"), work.ply("edited.ply"));
    let (rest, after, diagonal) = (before.positions(), edited.positions(), before.diagonal());
    let deviations: Vec<f64> =
        rest.iter().zip(&after).map(|(p, q)| exact(*p).distance(*q) / diagonal).collect();
    let rms = (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt();
    let worst = deviations.iter().copied().max_by(f64::total_cmp).expect("vertices");
    for (name, here) in [("rms", rms), ("max", worst)] {
        let there = figure(&error, name);
        assert!((here / there - 1.0).abs() < 0.01, "{name} is {here:.3e}, but reported as {there:.3e}");
    }
    [before, edited]
}

#[test]
fn half_turn_twist_and_its_normals() {
    for method in &METHODS {
        let models = check_figures("twist", 180.0, method, twist);
        check_normals_after_twist(&models, method);
    }
}

#[test]
fn quarter_turn_bend() {
    for method in &METHODS {
        check_figures("bend", 90.0, method, bend);
    }
}

/// Normals go with the inverse transpose of the map's gradient, and keep their length.
fn check_normals_after_twist([before, after]: &[Ply; 2], method: &Method) {
    let pairs = before.normals().into_iter().zip(after.normals());
    let mut degrees = Vec::new();
    for (p, (n, m)) in before.positions().into_iter().zip(pairs) {
        assert!((m.length() - n.length()).abs() < 1e-5, "a normal of length {}", m.length());
        let exact = gradient(twist, p).inverse().transpose() * n;
        degrees.push(exact.angle_between(m).to_degrees());
    }
    degrees.sort_by(f64::total_cmp);
    let quantile = |q: f64| degrees[(q * degrees.len() as f64) as usize];
    let (half, most) = (quantile(0.5), quantile(0.99));
    assert!(
        half < method.normals && most < 10.0 * method.normals,
        "{}: half are within {half}°, 99 % within {most}°",
        method.name
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
