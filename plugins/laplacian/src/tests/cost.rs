//! What it costs: `cargo test --release -p simod-plugin-laplacian -- --ignored --nocapture cost`.

use super::scene::{held_at_ends, tube, turn};
use glam::DVec3;
use simod_plugin_api::Affine;
use std::time::Instant;

#[test]
#[ignore = "prints times, and asserts nothing"]
fn cost() {
    for mode in ["arap", "bi-laplacian", "laplacian"] {
        for samples in [20_000, 100_000, 350_000] {
            let around = (f64::from(samples) * 0.6).sqrt() as usize;
            let mut scene = held_at_ends(tube(around, samples as usize / around, 0.1), 0.15);
            scene.mode = mode;
            (scene.iterations, scene.tolerance) = (4.0, 1e-4);
            let start = Instant::now();
            let state = scene.prepare().unwrap();
            let prepare = start.elapsed().as_secs_f64();
            let at = |k: usize| -> Affine {
                turn(DVec3::X, 60.0 + k as f64, DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, -0.2, -0.2))
            };
            let mut times: Vec<f64> = (0..5)
                .map(|k| {
                    let start = Instant::now();
                    scene.deform(&state, &[at(k)]);
                    start.elapsed().as_secs_f64()
                })
                .collect();
            times.sort_by(f64::total_cmp);
            println!("{mode} {samples}: prepare {prepare:.2} s, deform {:.0} ms", times[2] * 1e3);
        }
    }
}
