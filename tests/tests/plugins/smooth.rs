//! Smoothing at the scale of the samples, from a session to a model's vertices.

use glam::DVec3;
use simod_tests::Workplace;

/// Root mean square of the vertices' distances from a sphere about the origin, and the sphere's radius, their
/// mean distance from the origin.
fn off(places: &[DVec3]) -> [f64; 2] {
    let mean = places.iter().map(|p| p.length()).sum::<f64>() / places.len() as f64;
    let squares: f64 = places.iter().map(|p| (p.length() - mean).powi(2)).sum();
    [(squares / places.len() as f64).sqrt(), mean]
}

/// A sphere of many points with broad bumps and fine ones, without faces.
fn bumpy_sphere(broad: f64, fine: f64) -> String {
    let count = 60_000;
    let point = |i: usize| {
        // Spread evenly (Fibonacci).
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let angle = 2.399_963_229_728_653 * i as f64;
        let unit = DVec3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z);
        let wave = |n: f64| (n * unit.x).sin() * (n * unit.y).sin() * (n * unit.z).sin();
        let p = unit * (1.0 + broad * wave(12.0) + fine * wave(130.0));
        format!("{} {} {} {} {} {}\n", p.x, p.y, p.z, unit.x, unit.y, unit.z)
    };
    (0..count).map(point).collect()
}

#[test]
fn broad_bumps_go_and_details_stay() {
    let work = Workplace::new();
    let run = |model: &str, amount: f64| {
        let size = 0.4;
        let step =
            format!("[[step]]\ndeform = \"smooth\"\nparams = {{ size = {size}, amount = {amount} }}\n");
        work.write_session(model, 4000, &step);
        work.simod("run edit.toml -o out.ply --lossy");
        work.ply("out.ply").positions()
    };
    work.write("both.xyzn", bumpy_sphere(0.02, 0.002));
    work.write("fine.xyzn", bumpy_sphere(0.0, 0.002));
    let [fine, _] = off(&run("fine.xyzn", 0.0));
    let [both, _] = off(&run("both.xyzn", 0.0));
    let [smoothed, size] = off(&run("both.xyzn", 1.0));
    assert!(both > 3.0 * fine && smoothed < both / 2.0, "{both} {smoothed} {fine}");
    // Bumps finer than the samples are still there, and the whole is as large as it was.
    assert!(smoothed > 0.8 * fine && (size - 1.0).abs() < 0.01, "{smoothed} {fine} {size}");
    let [sharpened, _] = off(&run("both.xyzn", -1.0));
    assert!(sharpened > 1.5 * both, "{sharpened} {both}");
}
