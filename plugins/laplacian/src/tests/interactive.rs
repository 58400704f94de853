//! Tests of dragging a handle: drafts, results that do not depend on threads, and an end when the user asks
//! for it.

use super::scene::{Scene, Threads, held_at_ends, tube, turn};
use glam::DVec3;
use simod_plugin_api::{Affine, Effort, ErrorCode, HostCalls, LogLevel};
use std::sync::atomic::{AtomicUsize, Ordering};

const MODES: [&str; 4] = ["arap", "smooth-arap", "laplacian", "bi-laplacian"];

/// Motion that bends the surface between the held ends to an arc of the same length.
fn bend(degrees: f64) -> Affine {
    let (angle, end) = (degrees.to_radians(), DVec3::new(0.0, 0.0, 0.85));
    let radius = 0.7 / angle;
    let by = DVec3::new(0.0, -radius * (1.0 - angle.cos()), radius * angle.sin() - 0.7);
    turn(DVec3::X, degrees, end, by)
}

/// Large enough for a coarse likeness, and for several subtrees.
fn scene() -> Scene {
    let scene = held_at_ends(tube(90, 150, 0.1), 0.15);
    Scene { iterations: 2.0, tolerance: 1e-4, ..scene }
}

#[test]
fn a_draft_is_near_the_full_result() {
    // Deformations that may crease take more steps to find out where.
    let cases: [(_, _, &[f64]); 3] = [
        ("smooth-arap", 0.03, &[5.0, 30.0, 60.0]),
        ("arap", 0.0, &[5.0]),
        ("laplacian", 0.0, &[5.0, 30.0, 60.0]),
    ];
    for (mode, bending, turns) in cases {
        let full = Scene { mode, bending, ..scene() };
        let draft = Scene { effort: Effort::DRAFT, ..full.clone() };
        let state = full.prepare().unwrap();
        assert_eq!(draft.deform(&state, &[Affine::IDENTITY]), full.points);
        for &degrees in turns {
            let (a, b) = (full.deform(&state, &[bend(degrees)]), draft.deform(&state, &[bend(degrees)]));
            let v = |p: &[f32; 3]| DVec3::from(p.map(f64::from));
            let distances: Vec<f64> = a.iter().zip(&b).map(|(a, b)| v(a).distance(v(b))).collect();
            let rms = (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt();
            let worst = distances.iter().copied().fold(0.0, f64::max);
            println!("{mode}, bending {bending}, {degrees} degrees: rms {rms:.1e}, worst {worst:.1e}");
            // The diagonal is 1.04.
            assert!(
                rms < 3e-3 && worst < 1e-2,
                "{mode}, bending {bending}, {degrees} degrees: {rms:.1e}, {worst:.1e}"
            );
            for (p, (a, b)) in full.points.iter().zip(a.iter().zip(&b)) {
                assert!((0.15..=0.85).contains(&p[2]) || a == b, "{p:?}");
            }
            assert_eq!(b, draft.deform(&state, &[bend(degrees)]));
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for mode in MODES {
        for effort in [Effort::FULL, Effort::DRAFT] {
            let scene = Scene { mode, effort, ..scene() };
            let run = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| scene.run(&[bend(50.0)]))
            };
            let one = run(1);
            assert!(one == run(2) && one == run(4), "{mode}");
        }
    }
}

/// Says no from a certain call on.
struct StopsAt(usize, AtomicUsize);

impl HostCalls for StopsAt {
    fn progress(&self, _: f64) -> bool {
        self.1.fetch_add(1, Ordering::Relaxed) < self.0
    }
    fn log(&self, _: LogLevel, _: &str) {}
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        Threads.parallel_for(count, body)
    }
}

#[test]
fn a_factorisation_can_be_stopped_anywhere() {
    for mode in MODES {
        let scene = Scene { mode, ..scene() };
        let counting = StopsAt(usize::MAX, AtomicUsize::new(0));
        scene.prepare_with(&counting).unwrap();
        let all = counting.1.into_inner();
        // Each front asks: far more often than there are stages.
        assert!(all > 300, "{mode}: {all}");
        for at in [0, 1, all / 4, all / 2, 3 * all / 4, all - 1] {
            let host = StopsAt(at, AtomicUsize::new(0));
            let error = scene.prepare_with(&host).err().unwrap();
            assert_eq!(error.code, ErrorCode::CANCELLED, "{mode}, {at} of {all}");
            // Other threads may have been about to ask, but no more.
            assert!(host.1.into_inner() <= at + 64, "{mode}, {at} of {all}");
        }
    }
}
