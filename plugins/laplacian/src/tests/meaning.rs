//! Tests of a deformation's meaning: exactness, lengths, symmetry, limits.

use super::scene::{Scene, bar, held_at_ends, tube, turn};
use glam::DVec3;
use simod_plugin_api::{Affine, ErrorCode, HostCalls, LogLevel, Role};
use std::sync::atomic::{AtomicUsize, Ordering};

const MODES: [&str; 4] = ["arap", "smooth-arap", "laplacian", "bi-laplacian"];

fn of_mode(scene: &Scene, mode: &'static str) -> Scene {
    Scene { mode, ..scene.clone() }
}

fn v(p: &[f32; 3]) -> DVec3 {
    DVec3::from(p.map(f64::from))
}

fn apply(map: &Affine, p: &[f32; 3]) -> DVec3 {
    DVec3::from(map.apply(p.map(f64::from)))
}

/// Root mean square of the edges' changes of length, relative to the length.
fn stretch(scene: &Scene, deformed: &[[f32; 3]]) -> f64 {
    let mut sum = 0.0;
    for t in &scene.triangles {
        for k in 0..3 {
            let (a, b) = (t[k] as usize, t[(k + 1) % 3] as usize);
            let before = v(&scene.points[a]).distance(v(&scene.points[b]));
            let after = v(&deformed[a]).distance(v(&deformed[b]));
            sum += (after / before - 1.0).powi(2);
        }
    }
    (sum / (3 * scene.triangles.len()) as f64).sqrt()
}

#[test]
fn regions_do_exactly_as_told() {
    let scene = held_at_ends(bar(6, 30, 0.1), 0.2);
    let motion = turn(DVec3::new(1.0, 1.0, 0.0), 40.0, DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.1, 0.2, -0.1));
    for mode in MODES {
        let scene = of_mode(&scene, mode);
        let state = scene.prepare().unwrap();
        assert_eq!(scene.deform(&state, &[Affine::IDENTITY]), scene.points, "{mode}");
        for (p, q) in scene.points.iter().zip(scene.deform(&state, &[motion])) {
            if p[2] < 0.2 {
                assert_eq!(*p, q, "{mode}");
            } else if p[2] > 0.8 {
                assert_eq!(apply(&motion, p).as_vec3().to_array(), q, "{mode}");
            }
        }
    }
}

#[test]
fn one_motion_of_all_handles_moves_everything_along() {
    let motion = turn(DVec3::new(1.0, 2.0, 3.0), 130.0, DVec3::ONE, DVec3::new(-0.3, 0.2, 2.0));
    let mut scene = bar(6, 30, 0.1);
    // Something loose beside it.
    let first = scene.points.len() as u32;
    scene.points.extend([[0.5, 0.0, 0.0], [0.6, 0.0, 0.0], [0.5, 0.1, 0.3], [9.0, 0.0, 0.0]]);
    scene.triangles.push([first, first + 1, first + 2]);
    let scene = scene.region(Role::HANDLE, |p| p[2] < 0.1).region(Role::HANDLE, |p| p[2] > 0.9);
    for mode in MODES {
        for (p, q) in scene.points.iter().zip(of_mode(&scene, mode).run(&[motion; 2])) {
            assert!(apply(&motion, p).distance(v(&q)) < 1e-6, "{mode}: {p:?} {q:?}");
        }
    }
}

/// A surface whose handles all move by a rigid motion more is bent as before, and moved: only differences of
/// the handles' motions matter.
#[test]
fn a_common_part_of_motions_makes_no_difference() {
    let scene = bar(5, 24, 0.1).region(Role::HANDLE, |p| p[2] < 0.2).region(Role::HANDLE, |p| p[2] > 0.8);
    let bend = turn(DVec3::X, 50.0, DVec3::new(0.0, 0.0, 0.7), DVec3::new(0.0, -0.2, 0.0));
    let common = turn(DVec3::new(1.0, -1.0, 0.5), 100.0, DVec3::Y, DVec3::new(0.3, 0.0, 0.0));
    let both = compose(&common, &bend);
    for mode in ["smooth-arap", "laplacian"] {
        let scene = of_mode(&scene, mode);
        let state = scene.prepare().unwrap();
        let here = scene.deform(&state, &[Affine::IDENTITY, bend]);
        let there = scene.deform(&state, &[common, both]);
        for (p, q) in here.iter().zip(there) {
            assert!(apply(&common, p).distance(v(&q)) < 1e-5, "{mode}");
        }
    }
}

fn compose(a: &Affine, b: &Affine) -> Affine {
    let product = simod_geometry::affine_map(&a.rows) * simod_geometry::affine_map(&b.rows);
    let (m, t) = (product.matrix3, product.translation);
    Affine { rows: std::array::from_fn(|r| [m.x_axis[r], m.y_axis[r], m.z_axis[r], t[r]]) }
}

#[test]
fn a_bar_that_is_bent_or_twisted_keeps_its_length_and_girth() {
    let scene = held_at_ends(bar(8, 60, 0.06), 0.15);
    let end = DVec3::new(0.0, 0.0, 0.85);
    // A quarter of a circle between the held ends, as long as the bar was there.
    let radius = 0.7 / std::f64::consts::FRAC_PI_2;
    let bend = turn(DVec3::X, 90.0, end, DVec3::new(0.0, -radius, radius - 0.7));
    let twist = turn(DVec3::Z, 120.0, end, DVec3::ZERO);
    for (name, motion, least_gain) in [("bend", bend, 2.0), ("twist", twist, 2.0)] {
        let [_, arap, rotated, linear] =
            MODES.map(|mode| stretch(&scene, &of_mode(&scene, mode).run(&[motion])));
        println!("{name}: edges change by {arap:.3}, {rotated:.3}, {linear:.3}");
        // Inside and outside of the bend cannot but change: by 7 %, or 4 % over all edges.
        assert!(arap < 0.065, "{name}: {arap}");
        // Turns come from the handles', so that one linear solution does as well.
        assert!(rotated < 0.065, "{name}: {rotated}");
        assert!(linear > least_gain * arap, "{name}: {arap} {linear}");
    }
    // The middle of each cross section.
    let bent = scene.run(&[bend]);
    let middles: Vec<DVec3> = (0..=60)
        .map(|k| {
            let section = scene.points.iter().zip(&bent).filter(|(p, _)| (p[2] * 60.0).round() as i32 == k);
            let all: Vec<DVec3> = section.map(|(_, q)| v(q)).collect();
            all.iter().sum::<DVec3>() / all.len() as f64
        })
        .collect();
    let length: f64 = middles.windows(2).map(|w| w[0].distance(w[1])).sum();
    assert!((length - 1.0).abs() < 0.02, "a length of {length}");
}

#[test]
fn what_is_symmetric_stays_symmetric() {
    let scene = held_at_ends(bar(6, 24, 0.1), 0.2);
    let pull = turn(DVec3::Z, 0.0, DVec3::ZERO, DVec3::new(0.0, 0.0, 0.3));
    for (mode, tolerance) in [("smooth-arap", 2e-3), ("laplacian", 2e-3), ("bi-laplacian", 1e-5)] {
        let deformed = of_mode(&scene, mode).run(&[pull]);
        for (p, q) in scene.points.iter().zip(&deformed) {
            let mirrored = scene.points.iter().position(|m| (v(m) - v(&[-p[0], p[1], p[2]])).length() < 1e-6);
            let m = v(&deformed[mirrored.unwrap()]);
            assert!(m.distance(v(&[-q[0], q[1], q[2]])) < tolerance, "{mode}: {q:?} {m}");
        }
    }
}

/// On a tube that is moved as a whole, the bi-Laplacian is the fourth derivative along it, and the
/// displacement a cubic.
#[test]
fn the_smoothest_displacement_of_a_tube_is_a_cubic() {
    let error = |n: usize, m: usize| {
        let scene = held_at_ends(tube(n, m, 0.2), 0.2);
        let by = DVec3::new(0.3, 0.1, 0.2);
        let scene = Scene { mode: "bi-laplacian", ..scene };
        let deformed = scene.run(&[turn(DVec3::X, 0.0, DVec3::ZERO, by)]);
        // The last rings that are held.
        let held = |inside: fn(f32) -> bool| scene.points.iter().map(|p| p[2]).filter(move |z| inside(*z));
        let below = f64::from(held(|z| z < 0.2).fold(0.0, f32::max));
        let above = f64::from(held(|z| z > 0.8).fold(1.0, f32::min));
        let worst = scene.points.iter().zip(&deformed).map(|(p, q)| {
            let t = ((f64::from(p[2]) - below) / (above - below)).clamp(0.0, 1.0);
            (v(q) - v(p)).distance(by * (3.0 * t * t - 2.0 * t * t * t)) / by.length()
        });
        worst.fold(0.0, f64::max)
    };
    let errors = [error(24, 20), error(48, 40), error(96, 80)];
    println!("off by {errors:.4?}");
    assert!(errors[2] < 0.02, "{errors:?}");
    assert!(errors[1] < 0.7 * errors[0] && errors[2] < 0.7 * errors[1], "{errors:?}");
}

/// Finer samplings of one surface come to one result, also where results are found by way of a coarse
/// likeness.
#[test]
fn results_converge_under_refinement() {
    let motion = turn(DVec3::X, 70.0, DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, -0.3, -0.15));
    let run = |k: usize| {
        let scene = held_at_ends(tube(16 * k, 20 * k, 0.1), 0.199);
        let deformed = Scene { iterations: 100.0, tolerance: 1e-5, ..scene }.run(&[motion]);
        // Samples of the coarsest tube.
        let at = move |i: usize, j: usize| j * k * 16 * k + i * k;
        let kept = (0..=20).flat_map(move |j| (0..16).map(move |i| at(i, j)));
        kept.map(|i| v(&deformed[i])).collect::<Vec<_>>()
    };
    let runs = [1, 2, 4, 8].map(run);
    let differences: Vec<f64> = runs
        .windows(2)
        .map(|w| w[0].iter().zip(&w[1]).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max))
        .collect();
    println!("from one to the next: {differences:.4?}");
    assert!(differences[1] < 0.7 * differences[0] && differences[2] < 0.02, "{differences:?}");
}

#[test]
fn soft_regions_are_between_none_and_hard() {
    let scene = bar(6, 30, 0.1).region(Role::FIXED, |p| p[2] < 0.1);
    let by = DVec3::new(0.2, 0.0, 0.0);
    let lift = turn(DVec3::X, 0.0, DVec3::ZERO, by);
    for mode in MODES {
        let reached = |weight: f32| {
            let mut scene = of_mode(&scene, mode).region(Role::HANDLE, |p| p[2] > 0.9);
            scene.regions[1].1.iter_mut().for_each(|w| *w *= weight);
            let deformed = scene.run(&[lift]);
            let tip: Vec<f64> = (scene.points.iter().zip(&deformed))
                .filter(|(p, _)| p[2] > 0.9)
                .map(|(p, q)| (v(q) - v(p)).dot(by) / by.length_squared())
                .collect();
            tip.iter().sum::<f64>() / tip.len() as f64
        };
        let parts = [2e-4, 0.01, 0.1, 0.5, 0.9, 0.99, 0.9999, 1.0].map(reached);
        println!("{mode}: {parts:.4?}");
        assert!(parts.is_sorted(), "{mode}: {parts:?}");
        assert!(
            parts[0] < 0.1
                && (1.0 - parts[6]) < 1e-3
                && (0.5..0.99).contains(&parts[3])
                && (parts[7] - 1.0).abs() < 1e-6,
            "{mode}: {parts:?}"
        );
    }
}

#[test]
fn threads_make_no_difference() {
    let scene = held_at_ends(tube(60, 100, 0.1), 0.15);
    let motion = turn(DVec3::X, 45.0, DVec3::Z, DVec3::new(0.0, -0.2, 0.0));
    for mode in MODES {
        let scene = Scene { iterations: 3.0, ..of_mode(&scene, mode) };
        let many = scene.deform(&scene.prepare().unwrap(), &[motion]);
        let one = scene.deform_with(&scene.prepare_with(&()).unwrap(), &[motion], &()).unwrap();
        assert!(many == one, "{mode}");
    }
}

#[test]
fn many_handles_are_solved_for_one_by_one() {
    // More than are tabulated; alternately up and down, and the same as one handle if all do the same.
    let mut scene = tube(20, 60, 0.1).region(Role::FIXED, |p| p[2] < 0.05);
    for k in 0..16 {
        let z = 0.2 + 0.05 * f64::from(k);
        scene = scene.region(Role::HANDLE, move |p| (p[2] - z).abs() < 0.01);
    }
    let motion = turn(DVec3::X, 10.0, DVec3::ZERO, DVec3::new(0.0, 0.1, 0.0));
    let mut one = Scene { mode: "bi-laplacian", ..scene.clone() };
    let all = one.run(&[motion; 16]);
    let merged: Vec<f32> =
        (0..one.points.len()).map(|i| one.regions[1..].iter().map(|r| r.1[i]).fold(0.0, f32::max)).collect();
    one.regions.truncate(1);
    one.regions.push((Role::HANDLE, merged));
    for (a, b) in all.iter().zip(one.run(&[motion])) {
        assert!(v(a).distance(v(&b)) < 1e-5);
    }
}

#[test]
fn what_cannot_be_worked_on_is_refused_with_a_hint() {
    let refused = |scene: Scene| {
        let error = scene.prepare().err().unwrap();
        assert_eq!(error.code, ErrorCode::INVALID_INPUT);
        assert!(!error.hint.is_empty());
        error.message.into_string()
    };
    let scene = tube(8, 8, 0.1);
    assert!(refused(scene.clone()).contains("no handle"));
    assert!(refused(scene.clone().region(Role::FIXED, |_| true)).contains("no handle"));
    let empty = refused(scene.region(Role::FIXED, |_| true).region(Role::HANDLE, |_| false));
    assert!(empty.contains("region 2 (handle) holds no sample"), "{empty}");
}

#[test]
fn stops_when_asked() {
    struct StopAfter(usize, AtomicUsize);
    impl HostCalls for StopAfter {
        fn progress(&self, _: f64) -> bool {
            self.1.fetch_add(1, Ordering::Relaxed) < self.0
        }
        fn log(&self, _: LogLevel, _: &str) {}
    }
    let scene = held_at_ends(tube(80, 100, 0.1), 0.15);
    let motion = turn(DVec3::X, 45.0, DVec3::Z, DVec3::ZERO);
    for mode in MODES {
        let scene = of_mode(&scene, mode);
        for calls in [0, 3, 5] {
            let error = scene.prepare_with(&StopAfter(calls, AtomicUsize::new(0))).err().unwrap();
            assert_eq!(error.code, ErrorCode::CANCELLED, "{mode}");
        }
        let state = scene.prepare().unwrap();
        let error = scene.deform_with(&state, &[motion], &StopAfter(2, AtomicUsize::new(0))).unwrap_err();
        assert_eq!(error.code, ErrorCode::CANCELLED, "{mode}");
    }
}
