//! Cost of deformations: `cargo test --release -p simod-plugin-laplacian -- --ignored --nocapture cost`.

use super::scene::{held_at_ends, tube, turn};
use glam::DVec3;
use simod_plugin_api::Effort;
use std::time::Instant;

#[test]
#[ignore = "prints times, and asserts nothing"]
fn cost() {
    let [full, draft] = [Effort::FULL, Effort::DRAFT];
    let rotated = [("laplacian", full), ("laplacian", draft)];
    for (mode, effort) in
        [("smooth-arap", full), ("smooth-arap", draft), ("bi-laplacian", full)].into_iter().chain(rotated)
    {
        for samples in [20_000_u32, 100_000, 200_000, 350_000] {
            let around = (f64::from(samples) * 0.6).sqrt() as usize;
            let mut scene = held_at_ends(tube(around, samples as usize / around, 0.1), 0.15);
            (scene.mode, scene.effort) = (mode, effort);
            (scene.iterations, scene.tolerance) = (2.0, 1e-4);
            let mut prepared = Vec::new();
            let mut deformed = Vec::new();
            for _ in 0..3 {
                let start = Instant::now();
                let state = scene.prepare().unwrap();
                prepared.push(start.elapsed().as_secs_f64());
                for k in 0..5 {
                    let at = turn(
                        DVec3::X,
                        60.0 + f64::from(k),
                        DVec3::new(0.0, 0.0, 0.8),
                        DVec3::new(0.0, -0.2, -0.2),
                    );
                    let start = Instant::now();
                    scene.deform(&state, &[at]);
                    deformed.push(start.elapsed().as_secs_f64());
                }
            }
            let of = |mut times: Vec<f64>| {
                times.sort_by(f64::total_cmp);
                (times[times.len() / 2], times[0])
            };
            let ((p, p0), (d, d0)) = (of(prepared), of(deformed));
            println!(
                "{mode}{} {samples}: prepare {p:.2} s (least {p0:.2}), deform {:.0} ms (least {:.0})",
                if effort == draft { ", draft" } else { "" },
                d * 1e3,
                d0 * 1e3
            );
        }
    }
}

#[test]
#[ignore = "prints differences, and asserts nothing"]
fn steps() {
    let mut scene = held_at_ends(tube(110, 180, 0.1), 0.15);
    let at = turn(DVec3::X, 60.0, DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, -0.2, -0.2));
    let state = scene.prepare().unwrap();
    (scene.iterations, scene.tolerance) = (500.0, 1e-6);
    let best = scene.deform(&state, &[at]);
    for steps in [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0] {
        (scene.iterations, scene.tolerance) = (steps, 1e-4);
        let found = scene.deform(&state, &[at]);
        let d = |(a, b): (&[f32; 3], &[f32; 3])| {
            DVec3::from(a.map(f64::from)).distance(DVec3::from(b.map(f64::from)))
        };
        let worst = found.iter().zip(&best).map(d).fold(0.0, f64::max);
        println!("{steps} steps: worst {worst:.2e}");
    }
}
