//! The whole plugin, on a bar along y that is held at one end and moved at the other.

use super::*;
use simod_plugin_api::{ErrorCode, HostCalls, LogLevel, Param, ParamKind, Region, Role, Samples};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

const BOUNDS: simod_plugin_api::Bounds =
    simod_plugin_api::Bounds { min: [-1.0, 0.0, -1.0], max: [1.0, 8.0, 1.0] };

/// About `n` samples on the surface of a cylinder of radius 1, height 8.
fn bar(n: usize) -> Vec<[f32; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..n)
        .map(|i| {
            let angle = golden * i as f64;
            [angle.cos() as f32, (8.0 * (i as f64 + 0.5) / n as f64) as f32, angle.sin() as f32]
        })
        .collect()
}

fn weights(points: &[[f32; 3]], inside: impl Fn(&[f32; 3]) -> bool) -> Vec<f32> {
    points.iter().map(|p| f32::from(u8::from(inside(p)))).collect()
}

struct Setup {
    points: Vec<[f32; 3]>,
    regions: Vec<(Role, Vec<f32>)>,
    kernel: &'static str,
    tolerance: f64,
    max_centers: f64,
}

impl Setup {
    fn new(points: Vec<[f32; 3]>, regions: Vec<(Role, Vec<f32>)>) -> Self {
        Self { points, regions, kernel: "triharmonic", tolerance: 1e-3, max_centers: 1000.0 }
    }

    /// Held below y = 1, a handle above y = 7.
    fn bar(n: usize) -> Self {
        let points = bar(n);
        let fixed = weights(&points, |p| p[1] < 1.0);
        let handle = weights(&points, |p| p[1] > 7.0);
        Self::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)])
    }

    fn prepare(&self, host: &impl HostCalls) -> PluginResult<Prepared> {
        let regions: Vec<Region<'_>> = self.regions.iter().map(|(role, w)| Region::new(*role, w)).collect();
        let (tolerance, max_centers) = ([self.tolerance], [self.max_centers]);
        let params = [
            Param::text("kernel", ParamKind::CHOICE, self.kernel),
            Param::numbers("tolerance", ParamKind::FLOAT, &tolerance),
            Param::numbers("max-centers", ParamKind::INT, &max_centers),
        ];
        let samples = Samples::new(&self.points, &[], &[]);
        Rbf::prepare(&PrepareInput::new(samples, BOUNDS, &regions, &params), &Host::new(host))
    }

    fn deform(&self, state: &Prepared, transforms: &[Affine]) -> Vec<[f32; 3]> {
        let input = DeformInput::new(Samples::new(&self.points, &[], &[]), BOUNDS, transforms, &[]);
        let mut out = vec![[f32::NAN; 3]; self.points.len()];
        Rbf::deform(state, &input, &mut (), &mut out, &Host::new(&())).unwrap();
        out
    }

    fn evaluate(&self, state: &Prepared, transforms: &[Affine], points: &mut [Point]) {
        let input = DeformInput::new(Samples::new(&self.points, &[], &[]), BOUNDS, transforms, &[]);
        Rbf::evaluate(state, &input, points, &Host::new(&())).unwrap();
    }
}

/// Turns about the line through `pivot` along z, and moves.
fn turn(degrees: f64, pivot: Point, by: Point) -> Affine {
    let (s, c) = degrees.to_radians().sin_cos();
    let t = [pivot[0] - c * pivot[0] + s * pivot[1], pivot[1] - s * pivot[0] - c * pivot[1], 0.0];
    Affine { rows: [[c, -s, 0.0, t[0] + by[0]], [s, c, 0.0, t[1] + by[1]], [0.0, 0.0, 1.0, t[2] + by[2]]] }
}

fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn regions_do_as_told_and_space_follows_smoothly() {
    for (kernel, sharpest) in [("triharmonic", 1e-3), ("biharmonic", 1e-2)] {
        let setup = Setup { kernel, tolerance: 2e-3, ..Setup::bar(6000) };
        let state = setup.prepare(&()).unwrap();
        assert!(state.fit.residual <= 2e-3, "{kernel}: {}", state.fit.residual);
        let quarter = turn(90.0, [0.0, 7.0, 0.0], [2.0, -1.0, 0.5]);
        let out = setup.deform(&state, &[quarter]);
        let motion = 6.0;
        for (p, q) in setup.points.iter().zip(&out) {
            let (p, q) = (p.map(f64::from), q.map(f64::from));
            if p[1] < 1.0 {
                assert!(distance(p, q) < 4.0 * 2e-3 * motion, "{kernel}: fixed moved {}", distance(p, q));
            } else if p[1] > 7.0 {
                assert!(distance(quarter.apply(p), q) < 4.0 * 2e-3 * motion, "{kernel}: handle strays");
            }
        }
        // Along a line on the bar, second differences stay small: no steps and no kinks.
        let mut line: Vec<Point> = (0..=800).map(|i| [1.0, f64::from(i) / 100.0, 0.0]).collect();
        setup.evaluate(&state, &[quarter], &mut line);
        let kink = line.windows(3).map(|w| {
            let mid = std::array::from_fn(|i| 0.5 * (w[0][i] + w[2][i]));
            distance(w[1], mid)
        });
        let kink = kink.fold(0.0, f64::max);
        assert!(kink < sharpest, "{kernel}: {kink}");
    }
}

#[test]
fn samples_move_as_space_does() {
    let setup = Setup::bar(3000);
    let state = setup.prepare(&()).unwrap();
    let transform = [turn(30.0, [0.0; 3], [1.0, 0.0, 0.0])];
    let out = setup.deform(&state, &transform);
    let mut exact: Vec<Point> = setup.points.iter().map(|p| p.map(f64::from)).collect();
    setup.evaluate(&state, &transform, &mut exact);
    let worst = out.iter().zip(&exact).map(|(a, &b)| distance(a.map(f64::from), b)).fold(0.0, f64::max);
    assert!(worst < 8.0 * 2e-6, "{worst}");
}

#[test]
fn handles_that_do_not_move_move_nothing() {
    let setup = Setup::bar(2000);
    let state = setup.prepare(&()).unwrap();
    assert_eq!(setup.deform(&state, &[Affine::IDENTITY]), setup.points);
    let mut points = vec![[0.3, 4.0, 0.1], [100.0, -50.0, 3.0]];
    setup.evaluate(&state, &[Affine::IDENTITY], &mut points);
    assert_eq!(points, [[0.3, 4.0, 0.1], [100.0, -50.0, 3.0]]);
}

#[test]
fn a_common_motion_without_fixed_samples_moves_everything_along() {
    let points = bar(3000);
    // Two handles, one of them a single point: affine maps come back even so.
    let low = weights(&points, |p| p[1] < 1.0);
    let mut single = vec![0.0; points.len()];
    single[2900] = 1.0;
    let setup = Setup::new(points, vec![(Role::HANDLE, low), (Role::HANDLE, single)]);
    let state = setup.prepare(&()).unwrap();
    let mut affine = turn(50.0, [0.0, 2.0, 0.0], [3.0, 0.0, -1.0]);
    affine.rows[2][1] = 0.7;
    let mut space = vec![[5.0, -3.0, 2.0], [0.0, 4.0, 0.0]];
    let expected: Vec<Point> = space.iter().map(|&p| affine.apply(p)).collect();
    setup.evaluate(&state, &[affine; 2], &mut space);
    for (a, b) in space.iter().zip(expected) {
        assert!(distance(*a, b) < 1e-6);
    }
    for (p, q) in setup.points.iter().zip(setup.deform(&state, &[affine; 2])) {
        assert!(distance(affine.apply(p.map(f64::from)), q.map(f64::from)) < 2e-6);
    }
}

#[test]
fn flat_and_coincident_constraints_do_not_break_it() {
    // A plane, each sample three times.
    let points: Vec<[f32; 3]> = (0..3000)
        .map(|i| {
            let i = i / 3;
            [(i % 32) as f32 / 4.0, (i / 32) as f32 / 4.0, 0.0]
        })
        .collect();
    let fixed = weights(&points, |p| p[0] < 2.0);
    let handle = weights(&points, |p| p[0] > 6.0);
    let setup = Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)]);
    let state = setup.prepare(&()).unwrap();
    assert!(state.fit.residual <= 1e-3, "{}", state.fit.residual);
    let out = setup.deform(&state, &[turn(0.0, [0.0; 3], [0.0, 0.0, 2.0])]);
    assert!(out.iter().flatten().all(|x| x.is_finite() && x.abs() < 10.0));
}

#[test]
fn what_lies_beside_a_plane_turns_with_its_handle() {
    let points: Vec<[f32; 3]> =
        (0..4096).map(|i| [(i % 64) as f32 / 8.0, (i / 64) as f32 / 8.0, 0.0]).collect();
    let fixed = weights(&points, |p| p[0] < 2.0);
    let handle = weights(&points, |p| p[0] > 6.0);
    let setup = Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)]);
    let state = setup.prepare(&()).unwrap();
    // A quarter turn about y through x = 7: what was above now lies along x.
    let quarter = Affine { rows: [[0.0, 0.0, 1.0, 7.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 7.0]] };
    let mut space = vec![[7.0, 4.0, 0.1], [1.0, 4.0, 0.1]];
    setup.evaluate(&state, &[quarter], &mut space);
    assert!(distance(space[0], quarter.apply([7.0, 4.0, 0.1])) < 0.02, "{space:?}");
    assert!(distance(space[1], [1.0, 4.0, 0.1]) < 0.02, "{space:?}");
}

#[test]
fn contradictions_end_in_a_warning() {
    struct Log(Mutex<Vec<String>>);
    impl HostCalls for Log {
        fn progress(&self, _: f64) -> bool {
            true
        }
        fn log(&self, level: LogLevel, message: &str) {
            assert_eq!(level, LogLevel::WARNING);
            self.0.lock().unwrap().push(message.to_owned());
        }
    }
    // Every second sample is fixed, its twin is a handle.
    let points: Vec<[f32; 3]> = bar(1000).into_iter().flat_map(|p| [p, p]).collect();
    let fixed = (0..2000).map(|i| (i % 2) as f32).collect();
    let handle = (0..2000).map(|i| ((i + 1) % 2) as f32).collect();
    let setup = Setup {
        max_centers: 200.0,
        ..Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)])
    };
    let log = Log(Mutex::new(Vec::new()));
    let state = setup.prepare(&log).unwrap();
    assert!(state.fit.residual > 0.4);
    assert_eq!(log.0.lock().unwrap().len(), 1);
}

#[test]
fn what_cannot_be_worked_on_is_refused_with_a_hint() {
    let points = bar(100);
    let refused = |points: &[[f32; 3]], regions| {
        let error = Setup::new(points.to_vec(), regions).prepare(&()).err().unwrap();
        assert_eq!(error.code, ErrorCode::INVALID_INPUT);
        assert!(!error.hint.is_empty());
        error.message.into_string()
    };
    let all = vec![1.0; 100];
    let none = vec![0.0; 100];
    assert!(refused(&points, vec![]).contains("no handle"));
    assert!(refused(&points, vec![(Role::FIXED, all.clone())]).contains("no handle"));
    let empty = refused(&points, vec![(Role::FIXED, all.clone()), (Role::HANDLE, none)]);
    assert!(empty.contains("region 2 (handle) holds no sample"), "{empty}");
    assert!(refused(&[[1.0; 3]; 100], vec![(Role::HANDLE, all)]).contains("one point"));
}

#[test]
fn stops_when_asked() {
    struct StopAfter(AtomicUsize);
    impl HostCalls for StopAfter {
        fn progress(&self, _: f64) -> bool {
            self.0.fetch_add(1, Ordering::Relaxed) < 2
        }
        fn log(&self, _: LogLevel, _: &str) {}
    }
    let error = Setup::bar(2000).prepare(&StopAfter(AtomicUsize::new(0))).err().unwrap();
    assert_eq!(error.code, ErrorCode::CANCELLED);
}
