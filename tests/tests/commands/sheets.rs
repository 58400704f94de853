//! Sheets of a surface that lie nearer to each other than samples do: what moves one leaves the other alone.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3};
use simod_tests::{Motion, Ply, Workplace};

/// Vertices along a plate's side, and samples of both plates.
const SIDE: usize = 300;
const SAMPLES: usize = 8000;

/// Largest deviation of any vertex of what moves, as a fraction of the diagonal.
const TOLERANCE: f64 = 1e-4;

/// Distance of samples on the plates.
fn spacing() -> f64 {
    (2.0 / SAMPLES as f64).sqrt()
}

/// Two bumpy plates of side 1, the second `gap` above the first, with their normals, which face away from
/// each other. Bumps are half as long as the spacing, and their height is a tenth of the gap.
fn plates(gap: f64) -> (Vec<DVec3>, Vec<DVec3>) {
    let (height, wave) = (0.1 * gap, TAU / (0.5 * spacing()));
    let plate = |level: f64, side: f64| {
        (0..SIDE * SIDE).map(move |i| {
            let [x, z] = [i % SIDE, i / SIDE].map(|i| i as f64 / (SIDE - 1) as f64);
            let [(sin_x, cos_x), (sin_z, cos_z)] = [x, z].map(|a| (wave * a).sin_cos());
            let slope = -height * wave * DVec3::new(cos_x * sin_z, 0.0, sin_x * cos_z);
            let p = DVec3::new(x, level + height * sin_x * sin_z, z);
            (p, side * (DVec3::Y + slope).normalize_or(DVec3::Y))
        })
    };
    plate(0.0, -1.0).chain(plate(gap, 1.0)).unzip()
}

/// Samples two plates `gap` apart, and says how many samples lie on none of them.
fn sampled(gap: f64, with_normals: bool) -> (Workplace, usize) {
    let work = Workplace::new();
    let (positions, normals) = plates(gap);
    let normals = if with_normals { &normals[..] } else { &[] };
    work.write("plates.ply", Ply::from_points(&positions, normals).bytes);
    work.simod(&format!("sample plates.ply -o plates.simod --samples {SAMPLES}"));
    let samples = work.ply("plates.simod/samples.ply").positions();
    let between = samples.iter().filter(|p| p.y.abs().min((p.y - gap).abs()) > 0.2 * gap).count();
    (work, between)
}

/// Moves the upper plate alone; the worst error on each plate.
fn errors(work: &Workplace, gap: f64, motion: &Motion, method: &str) -> [f64; 2] {
    let upper = |p: DVec3| p.y > 0.5 * gap;
    let moved = |p: DVec3| if upper(p) { motion.image_of(p) } else { p };
    work.move_samples("plates.simod", moved);
    work.simod(&format!("reconstruct plates.simod --deformed deformed.ply -o out.ply --method {method}"));
    let (before, after) = (work.ply("plates.ply"), work.ply("out.ply").positions());
    let diagonal = before.diagonal();
    let mut worst = [0.0f64; 2];
    for (p, q) in before.positions().into_iter().zip(after) {
        assert!(q.is_finite(), "{p} went to {q}");
        let worst = &mut worst[usize::from(upper(p))];
        *worst = worst.max(moved(p).distance(q) / diagonal);
    }
    worst
}

#[test]
fn plates_that_face_away_from_each_other_stay_apart() {
    let shift = DVec3::new(0.1, 0.5, 0.0);
    let shift = Motion { scale: 1.0, turn: DMat3::IDENTITY, pivot: DVec3::ZERO, shift };
    for spacings in [0.8, 0.5, 0.3] {
        let gap = spacings * spacing();
        let (work, between) = sampled(gap, true);
        assert_eq!(between, 0, "a gap of {spacings} spacings");
        for motion in [shift, Motion::rigid(DVec3::splat(0.5), 1.0)] {
            for method in ["blended-jets", "projected-barycentric"] {
                let [lower, upper] = errors(&work, gap, &motion, method);
                assert!(
                    lower == 0.0 && upper < TOLERANCE,
                    "{method}, {spacings} spacings: the lower plate is off by {lower:.1e}, the upper by {upper:.1e}"
                );
            }
        }
    }
}

/// Without normals, sampling joins plates that are nearer than about three spacings: samples between them
/// belong to both. Then nothing can be promised but that all is finite, and nothing flies off.
#[test]
fn plates_that_sampling_joins_make_no_spikes() {
    let shift = DVec3::new(0.1, 0.5, 0.0);
    let shift = Motion { scale: 1.0, turn: DMat3::IDENTITY, pivot: DVec3::ZERO, shift };
    for spacings in [0.8, 0.5] {
        let gap = spacings * spacing();
        let (work, between) = sampled(gap, false);
        assert!(between > 0, "sampling keeps them apart: promise more");
        // No vertex is further off than all of the shift, which is 0.36 of the diagonal.
        for worst in errors(&work, gap, &shift, "blended-jets") {
            assert!(worst < 0.5, "a gap of {spacings} spacings: off by {worst:.2}");
        }
    }
}
