//! The whole plugin, on a bar along y that is held at one end and moved at the other.

use super::*;
use simod_plugin_api::{Bounds, ErrorCode, HostCalls, LogLevel, Param, ParamKind, Region, Role, Samples};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

mod reference;

const BOUNDS: Bounds = Bounds { min: [-1.0, 0.0, -1.0], max: [1.0, 8.0, 1.0] };

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
    bounds: Bounds,
    regions: Vec<(Role, Vec<f32>)>,
    kernel: &'static str,
    support: f64,
    tolerance: f64,
    max_centers: f64,
}

impl Setup {
    fn new(points: Vec<[f32; 3]>, regions: Vec<(Role, Vec<f32>)>) -> Self {
        Self {
            points,
            bounds: BOUNDS,
            regions,
            kernel: "triharmonic",
            support: 0.25,
            tolerance: 1e-3,
            max_centers: 1000.0,
        }
    }

    /// Bar that is held below y = 1, with a handle above y = 7.
    fn bar(n: usize) -> Self {
        let points = bar(n);
        let fixed = weights(&points, |p| p[1] < 1.0);
        let handle = weights(&points, |p| p[1] > 7.0);
        Self::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)])
    }

    fn prepare(&self, host: &impl HostCalls) -> PluginResult<PreparedFits> {
        let regions: Vec<Region<'_>> = self.regions.iter().map(|(role, w)| Region::new(*role, w)).collect();
        let (support, tolerance, max_centers) = ([self.support], [self.tolerance], [self.max_centers]);
        let params = [
            Param::numbers("support", ParamKind::FLOAT, &support),
            Param::text("kernel", ParamKind::CHOICE, self.kernel),
            Param::numbers("tolerance", ParamKind::FLOAT, &tolerance),
            Param::numbers("max-centers", ParamKind::INT, &max_centers),
        ];
        let samples = Samples::new(&self.points, &[], &[]);
        Rbf::prepare(&PrepareInput::new(samples, self.bounds, &regions, &params), &Host::new(host))
    }

    fn deform(&self, state: &PreparedFits, transforms: &[Affine]) -> Vec<[f32; 3]> {
        let input = DeformInput::new(Samples::new(&self.points, &[], &[]), self.bounds, transforms, &[]);
        let mut out = vec![[f32::NAN; 3]; self.points.len()];
        Rbf::deform(state, &input, &mut (), &mut out, &Host::new(&())).unwrap();
        out
    }

    fn evaluate(&self, state: &PreparedFits, transforms: &[Affine], points: &mut [Point]) {
        let input = DeformInput::new(Samples::new(&self.points, &[], &[]), self.bounds, transforms, &[]);
        Rbf::evaluate(state, &input, points, &Host::new(&())).unwrap();
    }
}

/// A host that keeps warnings.
#[derive(Default)]
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
        for (p, q) in setup.points.iter().zip(&out) {
            let (p, q) = (p.map(f64::from), q.map(f64::from));
            if p[1] < 1.0 {
                assert_eq!(p, q, "{kernel}: fixed moved");
            } else if p[1] > 7.0 {
                assert!(distance(quarter.apply(p), q) < 2e-6, "{kernel}: handle strays");
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
    // Every second sample is fixed, its twin is a handle.
    let points: Vec<[f32; 3]> = bar(1000).into_iter().flat_map(|p| [p, p]).collect();
    let fixed = (0..2000).map(|i| (i % 2) as f32).collect();
    let handle = (0..2000).map(|i| ((i + 1) % 2) as f32).collect();
    let setup = Setup {
        max_centers: 200.0,
        ..Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)])
    };
    let log = Log::default();
    let state = setup.prepare(&log).unwrap();
    assert!(state.fit.residual > 0.4);
    let told = log.0.lock().unwrap().clone();
    let [text] = &told[..] else { panic!("{told:?}") };
    let percent: f64 = text.split_once("met to ").unwrap().1.split_once(" %").unwrap().0.parse().unwrap();
    assert!((percent - 100.0 * (1.0 - state.fit.residual).max(0.0)).abs() <= 0.5, "{text}");
    assert!(text.contains("raise `max-centers` to 800, or leave room between regions"), "{text}");
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

/// Bar that is held below y = 1, with a ring about the middle and the top as handles.
fn two_handles(n: usize) -> Setup {
    let points = bar(n);
    let fixed = weights(&points, |p| p[1] < 1.0);
    let ring = weights(&points, |p| (3.5..4.5).contains(&p[1]));
    let top = weights(&points, |p| p[1] > 7.0);
    Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, ring), (Role::HANDLE, top)])
}

/// Affine map that is also scaled by a factor about a pivot.
fn grown(mut affine: Affine, factor: f64, pivot: Point) -> Affine {
    let at = affine.apply(pivot);
    for (row, at) in affine.rows.iter_mut().zip(at) {
        row[..3].iter_mut().for_each(|x| *x *= factor);
        row[3] = at - (0..3).map(|k| row[k] * pivot[k]).sum::<f64>();
    }
    affine
}

#[test]
fn handles_turn_and_grow_at_once_and_what_is_fixed_stays_bit_for_bit() {
    for kernel in ["triharmonic", "biharmonic", "compact-c2", "compact-c4"] {
        // A coarse fit: its residuals are taken away.
        let setup = Setup { kernel, tolerance: 0.02, ..two_handles(4000) };
        let state = setup.prepare(&()).unwrap();
        assert!(state.fit.residual > 1e-4, "{kernel}: nothing is left over to take away");
        let ring = grown(turn(30.0, [0.0, 4.0, 0.0], [0.5, 0.0, 0.0]), 1.5, [0.0, 4.0, 0.0]);
        let top = grown(turn(-45.0, [0.0, 7.5, 0.0], [-1.0, 0.5, 1.0]), 0.6, [0.0, 7.5, 0.0]);
        let out = setup.deform(&state, &[ring, top]);
        for (p, q) in setup.points.iter().zip(&out) {
            let told = match p[1] {
                y if y < 1.0 => {
                    assert_eq!(p.map(f32::to_bits), q.map(f32::to_bits), "{kernel}");
                    continue;
                }
                y if (3.5..4.5).contains(&y) => ring,
                y if y > 7.0 => top,
                _ => continue,
            };
            assert!(distance(told.apply(p.map(f64::from)), q.map(f64::from)) < 4e-6, "{kernel}: {p:?}");
        }
        // The map of space says the same, and has no step where a region ends.
        let mut space: Vec<Point> = setup.points.iter().map(|p| p.map(f64::from)).collect();
        setup.evaluate(&state, &[ring, top], &mut space);
        for (a, b) in space.iter().zip(&out) {
            assert!(distance(*a, b.map(f64::from)) < 4e-6, "{kernel}");
        }
        let mut line: Vec<Point> = (0..=4000).map(|i| [1.0, f64::from(i) / 500.0, 0.0]).collect();
        setup.evaluate(&state, &[ring, top], &mut line);
        let step = line.windows(2).map(|w| distance(w[0], w[1])).fold(0.0, f64::max);
        assert!(step < 0.02, "{kernel}: {step}");
    }
}

#[test]
fn beyond_the_support_nothing_moves() {
    for kernel in ["compact-c2", "compact-c4"] {
        // A tenth of the diagonal is 0.85.
        let setup = Setup { kernel, support: 0.1, ..two_handles(6000) };
        let state = setup.prepare(&()).unwrap();
        let shift = turn(20.0, [0.0, 4.0, 0.0], [1.0, 0.0, 0.5]);
        let out = setup.deform(&state, &[shift, Affine::IDENTITY]);
        let mut moved = 0;
        for (p, q) in setup.points.iter().zip(&out) {
            if p[1] < 3.5 - 0.85 || p[1] > 4.5 + 0.85 {
                assert_eq!(p.map(f32::to_bits), q.map(f32::to_bits), "{kernel}");
            } else if p != q && !(3.5..4.5).contains(&p[1]) {
                moved += 1;
            }
        }
        assert!(moved > 100, "{kernel}: {moved}");
        let mut space = vec![[30.0, 4.0, 0.0], [0.0, -9.0, 0.0]];
        setup.evaluate(&state, &[shift; 2], &mut space);
        assert_eq!(space, [[30.0, 4.0, 0.0], [0.0, -9.0, 0.0]]);
    }
}

#[test]
fn a_handle_of_far_samples_is_told_of() {
    let points = bar(2000);
    let mut some = vec![0.0; points.len()];
    (0..points.len()).step_by(200).for_each(|i| some[i] = 1.0);
    let setup = |support| Setup {
        kernel: "compact-c2",
        support,
        ..Setup::new(points.clone(), vec![(Role::HANDLE, some.clone())])
    };
    let warnings = |support| {
        let log = Log::default();
        setup(support).prepare(&log).unwrap();
        log.0.into_inner().unwrap().iter().filter(|w| w.contains("`support`")).count()
    };
    assert_eq!((warnings(0.02), warnings(1.0)), (1, 0));
    // One sample alone is a soft bump.
    let mut single = vec![0.0; points.len()];
    single[1000] = 1.0;
    let setup = Setup { kernel: "compact-c2", ..Setup::new(points.clone(), vec![(Role::HANDLE, single)]) };
    let state = setup.prepare(&()).unwrap();
    let up = turn(0.0, [0.0; 3], [0.0, 0.0, 1.0]);
    let out = setup.deform(&state, &[up]);
    assert!((out[1000][2] - points[1000][2] - 1.0).abs() < 1e-6);
    assert_eq!((out[0], out[1999]), (points[0], points[1999]));
}

#[test]
fn mirror_images_stay_mirror_images() {
    let half = bar(1500);
    let points: Vec<[f32; 3]> = half.iter().flat_map(|p| [*p, [-p[0], p[1], p[2]]]).collect();
    let fixed = weights(&points, |p| p[1] < 1.0);
    let top = weights(&points, |p| p[1] > 7.0);
    for kernel in ["triharmonic", "compact-c2"] {
        let regions = vec![(Role::FIXED, fixed.clone()), (Role::HANDLE, top.clone())];
        let setup = Setup { kernel, support: 1.0, ..Setup::new(points.clone(), regions) };
        let state = setup.prepare(&()).unwrap();
        let stretch = grown(turn(0.0, [0.0; 3], [0.0, 1.0, 0.5]), 1.4, [0.0, 7.5, 0.0]);
        let out = setup.deform(&state, &[stretch]);
        let off = out.chunks(2).map(|w| {
            let [a, b] = [w[0], w[1]].map(|p| p.map(f64::from));
            distance(a, [-b[0], b[1], b[2]])
        });
        let off = off.fold(0.0, f64::max);
        // The motion is of 1.5 units.
        assert!(off < 4.0 * 1e-3 * 1.5, "{kernel}: {off}");
    }
}

#[test]
fn all_constraints_on_a_line_do_not_break_it() {
    let points: Vec<[f32; 3]> = (0..500).map(|i| [i as f32 / 100.0, 0.5, -1.0]).collect();
    let fixed = weights(&points, |p| p[0] < 1.0);
    let handle = weights(&points, |p| p[0] > 4.0);
    for kernel in ["triharmonic", "biharmonic", "compact-c2"] {
        let regions = vec![(Role::FIXED, fixed.clone()), (Role::HANDLE, handle.clone())];
        let setup = Setup { kernel, support: 0.5, ..Setup::new(points.clone(), regions) };
        let state = setup.prepare(&()).unwrap();
        let lift = turn(30.0, [4.5, 0.5, -1.0], [0.0, 1.0, 1.0]);
        let out = setup.deform(&state, &[lift]);
        assert!(out.iter().flatten().all(|x| x.is_finite() && x.abs() < 10.0), "{kernel}");
        assert_eq!(out[0], points[0]);
    }
}

#[test]
fn what_is_not_connected_moves_with_space() {
    // A second bar beside the first, in no region.
    let first = bar(2000);
    let points: Vec<[f32; 3]> = first.iter().flat_map(|p| [*p, [p[0] + 3.0, p[1], p[2]]]).collect();
    let fixed = weights(&points, |p| p[1] < 1.0 && p[0] < 1.5);
    let top = weights(&points, |p| p[1] > 7.0 && p[0] < 1.5);
    let setup = Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, top)]);
    let state = setup.prepare(&()).unwrap();
    let out = setup.deform(&state, &[turn(0.0, [0.0; 3], [0.0, 0.0, 1.0])]);
    for (p, q) in setup.points.iter().zip(&out).filter(|(p, _)| p[0] > 1.5) {
        let up = q[2] - p[2];
        assert!(if p[1] > 7.5 { up > 0.7 } else { p[1] > 0.5 || up.abs() < 0.3 }, "{p:?} to {q:?}");
    }
}

/// Bar that is held below the middle, with a handle above it, where both meet all around.
fn border(n: usize, gap: f32) -> Setup {
    let points = bar(n);
    let fixed = weights(&points, |p| p[1] < 4.0 - gap);
    let handle = weights(&points, |p| p[1] > 4.0 + gap);
    Setup {
        tolerance: 1e-6,
        max_centers: 50_000.0,
        ..Setup::new(points, vec![(Role::FIXED, fixed), (Role::HANDLE, handle)])
    }
}

#[test]
fn long_borders_are_met_by_more_centres_than_can_be_chosen() {
    for kernel in ["triharmonic", "biharmonic", "compact-c2", "compact-c4"] {
        for gap in [0.0, 0.2] {
            let setup = Setup { kernel, ..border(2500, gap) };
            let log = Log::default();
            let state = setup.prepare(&log).unwrap();
            assert!(state.fit.residual <= 1e-6, "{kernel}, {gap}: {}", state.fit.residual);
            assert!(log.0.lock().unwrap().is_empty());
        }
    }
    // Where nearly all constraints have to be centres, all become centres at once.
    let state = Setup { kernel: "biharmonic", ..border(2500, 0.0) }.prepare(&()).unwrap();
    assert_eq!(state.fit.functions.centers.len(), 2500);
    // The centres are as many as may be, and the residual is told.
    let setup = Setup { max_centers: 1500.0, ..border(2500, 0.0) };
    let log = Log::default();
    let state = setup.prepare(&log).unwrap();
    assert!(state.fit.functions.centers.len() <= 1500);
    let told = log.0.lock().unwrap().concat();
    assert!(told.contains("raise `max-centers` to 6000, or raise `tolerance` to "), "{told}");
    // With the tolerance that the message advises, there is nothing to be told any more.
    let tolerance =
        told.split_once("`tolerance` to ").unwrap().1.split_once(". ").unwrap().0.parse().unwrap();
    let log = Log::default();
    Setup { tolerance, ..setup }.prepare(&log).unwrap();
    assert!(log.0.lock().unwrap().is_empty(), "{tolerance}");
}

/// Times are printed by `cargo test --release -p simod-plugin-rbf cost -- --ignored --nocapture`.
#[test]
#[ignore = "prints times, and asserts nothing"]
fn cost() {
    for kernel in ["triharmonic", "biharmonic", "compact-c2", "compact-c4"] {
        for (n, gap, tolerance) in [
            (16_540, 0.0, 1e-7),
            (20_000, 0.0, 1e-6),
            // Rounding ends this fit, when all constraints are centres.
            (20_000, 0.0, 1e-9),
            (25_000, 0.8, 1e-6),
            (100_000, 3.2, 1e-6),
        ] {
            let setup = Setup { kernel, tolerance, ..border(n, gap) };
            let start = std::time::Instant::now();
            let state = setup.prepare(&Threads).unwrap();
            println!(
                "{kernel}, {n} samples, a gap of {gap}: {} centres to {:.1e} of {tolerance:.0e}, {:.1} s",
                state.fit.functions.centers.len(),
                state.fit.residual,
                start.elapsed().as_secs_f64()
            );
        }
    }
}

/// A host with two threads.
struct Threads;

impl HostCalls for Threads {
    fn progress(&self, _: f64) -> bool {
        true
    }
    fn log(&self, _: LogLevel, _: &str) {}
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        let next = AtomicUsize::new(0);
        let work = || {
            loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                if i >= count {
                    return;
                }
                body(i);
            }
        };
        std::thread::scope(|scope| {
            scope.spawn(work);
            work();
        });
        true
    }
}

#[test]
fn threads_make_no_difference() {
    let setup = Setup { tolerance: 1e-5, ..border(3000, 0.1) };
    let quarter = [turn(90.0, [0.0, 4.0, 0.0], [2.0, -1.0, 0.5])];
    let alone = setup.deform(&setup.prepare(&()).unwrap(), &quarter);
    assert_eq!(alone, setup.deform(&setup.prepare(&Threads).unwrap(), &quarter));
}
