//! Registration against the map that made the target, on bodies of formulas.

use super::*;
use crate::drift::{Drift, Start};
use crate::gaussian::Kernel;
use crate::graph::Graph;
use crate::points::{Pair, farthest, similarity};
use crate::tree::Tree;
use faer::Mat;
use glam::{DAffine3, DMat3, DQuat};
use proptest::prelude::*;
use simod_plugin_api::{
    Bounds, ErrorCode, HostCalls, LogLevel, ModelFrame, OtherModel, OtherModels, Param, ParamKind, Part,
    PointsKind, Samples,
};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Host that keeps the messages, and asks to stop after so many signs of life.
struct Log {
    told: Mutex<String>,
    left: AtomicUsize,
}

impl Default for Log {
    fn default() -> Self {
        Self { told: Mutex::default(), left: AtomicUsize::new(usize::MAX) }
    }
}

impl HostCalls for Log {
    fn progress(&self, _: f64) -> bool {
        self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_ok()
    }
    fn log(&self, _: LogLevel, message: &str) {
        self.told.lock().unwrap().push_str(&format!("{message}\n"));
    }
}

/// Body without symmetries, with knobs and dents: the point in a direction.
fn body(d: DVec3) -> DVec3 {
    const KNOBS: [([f64; 3], f64); 7] = [
        ([1.0, 0.3, 0.2], 0.25),
        ([-0.8, 0.5, 0.4], 0.2),
        ([0.1, -1.0, 0.3], 0.3),
        ([0.2, 0.4, 1.0], 0.2),
        ([-0.5, -0.6, -0.7], 0.25),
        ([0.6, 0.7, -0.6], -0.12),
        ([-0.9, -0.2, 0.1], -0.1),
    ];
    let knob = |(at, height): ([f64; 3], f64)| {
        height * (-d.distance_squared(DVec3::from(at).normalize_or_zero()) / 0.06).exp()
    };
    (0.4 + KNOBS.map(knob).iter().sum::<f64>()) * d * DVec3::new(1.0, 0.8, 0.6)
}

/// Random directions, different ones for another count.
fn directions(count: usize) -> impl Iterator<Item = DVec3> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64 ^ count as u64;
    let mut next = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..count).map(move |_| {
        let z = 1.0 - 2.0 * next();
        let (sin, cos) = (std::f64::consts::TAU * next()).sin_cos();
        DVec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
    })
}

/// Points of the body after a map, and normals there.
fn surface(count: usize, map: &dyn Fn(DVec3) -> DVec3) -> (Vec<[f64; 3]>, Vec<[f32; 3]>) {
    let point = |d: DVec3| {
        let (a, b) = d.any_orthonormal_pair();
        let at = |d: DVec3| map(body(d.normalize_or_zero()));
        let normal = (at(d + 1e-5 * a) - at(d - 1e-5 * a)).cross(at(d + 1e-5 * b) - at(d - 1e-5 * b));
        let outward = normal * normal.dot(at(d) - map(DVec3::ZERO)).signum();
        (at(d).to_array(), outward.normalize_or_zero().as_vec3().to_array())
    };
    directions(count).map(point).unzip()
}

/// A smooth deformation of some hundredths to a tenth of the body's size.
fn bend(p: DVec3) -> DVec3 {
    p + 0.08 * DVec3::new((3.0 * p.y).sin(), 1.5 * p.x * p.x, (2.5 * p.x).sin())
}

struct Case {
    target: (Vec<[f64; 3]>, Vec<[f32; 3]>),
    method: &'static str,
    align: &'static str,
    any_turn: bool,
    place: &'static str,
    landmarks: String,
    log: Log,
}

const SAMPLES: usize = 1200;
const DIAGONAL: f64 = 1.5;
/// Distance between the target's points, as a part of the diagonal: the target is met within it.
const MET: f64 = 0.026;

impl Case {
    fn new(method: &'static str, map: &dyn Fn(DVec3) -> DVec3) -> Self {
        Self {
            target: surface(1000, map),
            method,
            align: "rigid",
            any_turn: false,
            place: "target",
            landmarks: String::new(),
            log: Log::default(),
        }
    }

    /// The case without some of the target's points.
    fn without(mut self, missing: impl Fn(DVec3) -> bool) -> Self {
        let (points, normals) = std::mem::take(&mut self.target);
        let kept = points.into_iter().zip(normals).filter(|(p, _)| !missing(DVec3::from(*p)));
        self.target = kept.unzip();
        self
    }

    fn prepare(&self, rest: &[[f32; 3]], normals: &[[f32; 3]]) -> PluginResult<State> {
        let number = |id, kind, numbers| Param::numbers(id, kind, numbers);
        let any_turn = [f64::from(u8::from(self.any_turn))];
        let params = [
            Param::text("target", ParamKind::MODEL, "target.ply"),
            Param::text("landmarks", ParamKind::FILE, &self.landmarks),
            Param::text("method", ParamKind::CHOICE, self.method),
            Param::text("align", ParamKind::CHOICE, self.align),
            number("any-turn", ParamKind::BOOL, &any_turn),
            Param::text("place", ParamKind::CHOICE, self.place),
            number("outliers", ParamKind::FLOAT, &[0.1]),
            number("width", ParamKind::FLOAT, &[0.5]),
            number("smoothness", ParamKind::FLOAT, &[3.0]),
            number("points", ParamKind::INT, &[400.0]),
            number("iterations", ParamKind::INT, &[100.0]),
            number("stiffness", ParamKind::FLOAT, &[0.01]),
            number("nodes", ParamKind::INT, &[120.0]),
        ];
        let (points, target_normals) = &self.target;
        let of = ("target", PointsKind::SAMPLED, points.len() as u64);
        let models = [OtherModel::new(of, points, target_normals, &[], &[])];
        let models = OtherModels::new(&models);
        let frame = ModelFrame { origin: [5e5, 4e6, 100.0], scale: 10.0 };
        let parts = [Part::new(&models), Part::new(&frame)];
        let bounds = Bounds { min: [-0.7, -0.5, -0.4], max: [0.7, 0.5, 0.4] };
        let input = PrepareInput::new(Samples::new(rest, normals, &[]), bounds, &[], &params);
        Register::prepare(&input.with_parts(&parts), &Host::new(&self.log))
    }

    /// Images of the samples that `has` picks, beside their rest positions.
    fn moved(&self, has: &dyn Fn(DVec3) -> bool) -> PluginResult<Vec<[DVec3; 2]>> {
        let (points, normals) = surface(SAMPLES, &|p| p);
        let all = points.into_iter().zip(normals).filter(|(p, _)| has(DVec3::from(*p)));
        let (rest, normals): (Vec<[f32; 3]>, Vec<[f32; 3]>) =
            all.map(|(p, n)| (p.map(|x| x as f32), n)).unzip();
        let state = self.prepare(&rest, &normals)?;
        let dense = |p: &[f32; 3]| DVec3::from(p.map(f64::from));
        Ok(rest.iter().zip(&state.samples).map(|(p, q)| [dense(p), dense(q)]).collect())
    }

    /// Distance of some samples from their true images: the root of the mean square, as a part of the
    /// diagonal.
    fn error(&self, truth: &dyn Fn(DVec3) -> DVec3, looks_at: &dyn Fn(DVec3) -> bool) -> f64 {
        rms(&self.moved(EVERYWHERE).expect("a map"), truth, looks_at)
    }

    fn told(&self) -> String {
        self.log.told.lock().unwrap().clone()
    }
}

fn rms(moved: &[[DVec3; 2]], truth: &dyn Fn(DVec3) -> DVec3, looks_at: &dyn Fn(DVec3) -> bool) -> f64 {
    let off: Vec<f64> =
        moved.iter().filter(|[p, _]| looks_at(*p)).map(|[p, q]| q.distance_squared(truth(*p))).collect();
    (off.iter().sum::<f64>() / off.len() as f64).sqrt() / DIAGONAL
}

const EVERYWHERE: &dyn Fn(DVec3) -> bool = &|_| true;

#[test]
fn a_model_that_is_the_target_stays() {
    for method in ["cpd", "cpd-icp", "icp", "align"] {
        let error = Case::new(method, &|p| p).error(&|p| p, EVERYWHERE);
        assert!(error < MET, "{method}: {error}");
    }
}

#[test]
fn rigid_motions_are_found() {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.2, -0.3, 0.3)));
    let truth = |p| turn * p + DVec3::new(0.1, -0.06, 0.04);
    for method in ["cpd", "cpd-icp", "icp", "align"] {
        let error = Case::new(method, &truth).error(&truth, EVERYWHERE);
        assert!(error < MET, "{method}: {error}");
    }
}

#[test]
fn smooth_deformations_are_found() {
    let before = Case::new("align", &bend).error(&bend, EVERYWHERE);
    for method in ["cpd", "icp", "cpd-icp"] {
        let case = Case::new(method, &bend);
        let error = case.error(&bend, EVERYWHERE);
        assert!(error < 0.4 * before && error < MET, "{method}: {error}, before it {before}");
    }
}

#[test]
fn a_third_may_be_missing_on_either_side() {
    let missing = |p: DVec3| p.x > 0.12;
    for method in ["icp", "cpd-icp"] {
        let case = Case::new(method, &bend).without(|p| missing(p - 0.08 * DVec3::X * (3.0 * p.y).sin()));
        let moved = case.moved(EVERYWHERE).expect("a map");
        let [there, gone] = [false, true].map(|gone| rms(&moved, &bend, &|p| missing(p) == gone));
        assert!(there < MET && gone < 0.05, "{method}: {there}, and where the target is missing {gone}");
        let moved = Case::new(method, &bend).moved(&|p| !missing(p)).expect("a map");
        let error = rms(&moved, &bend, EVERYWHERE);
        assert!(error < MET, "{method}: {error}, where the model is missing");
    }
}

#[test]
fn other_units_places_and_turns_are_told_and_found() {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(1.5, 0.4, -0.7)));
    let far = |p: DVec3| 1000.0 * (turn * bend(p)) + DVec3::new(3e4, -1e5, 5e3);
    let mut case = Case::new("cpd-icp", &far);
    for align in ["rigid", "none"] {
        case.align = align;
        let refused = case.moved(EVERYWHERE).expect_err("other units");
        assert!(
            refused.message.contains("units may differ") && refused.hint.contains("similarity"),
            "{refused}"
        );
    }
    (case.align, case.any_turn) = ("similarity", true);
    let refused = case.moved(EVERYWHERE).expect_err("too far away");
    assert!(refused.message.contains("would be lost") && refused.hint.contains("place"), "{refused}");
    // The result is at the model's place, but for a similarity that is not determined, as the target is
    // bent.
    case.place = "model";
    let moved = case.moved(EVERYWHERE).expect("a map");
    let pair = |[p, q]: &[DVec3; 2]| Pair { source: *q, target: bend(*p), weight: 1.0 };
    let found = similarity(&moved.iter().map(pair).collect::<Vec<_>>(), true).expect("a map");
    let scale = found.matrix3.determinant().cbrt();
    let error = rms(
        &moved.iter().map(|[p, q]| [*p, found.transform_point3(*q)]).collect::<Vec<_>>(),
        &bend,
        EVERYWHERE,
    );
    assert!(error < 0.02 && (0.8..1.25).contains(&scale), "{error}, {scale}, {}", case.told());

    let beside = |p: DVec3| turn * p + DVec3::new(4.0, 0.0, 0.0);
    let mut case = Case::new("align", &beside);
    case.align = "none";
    let refused = case.moved(EVERYWHERE).expect_err("it lies beside");
    assert!(refused.message.contains("do not overlap") && refused.hint.contains("rigid"), "{refused}");
    (case.align, case.any_turn) = ("rigid", true);
    let error = case.error(&beside, EVERYWHERE);
    assert!(error < 0.01, "{error}");
    // A target that is turned in its place is found, or told of; beside the model, it is told of.
    for (at, is_found) in [(DVec3::ZERO, true), (4.0 * DVec3::X, false)] {
        let turned = |p| DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2) * p + at;
        let case = Case::new("align", &turned);
        let error = case.error(&turned, EVERYWHERE);
        assert!(case.told().contains("`any-turn") || (is_found && error < MET), "{error}, {}", case.told());
    }
    // The target is two and a half times as large.
    let case = Case::new("align", &|p| 2.5 * p);
    case.moved(EVERYWHERE).expect("a map");
    assert!(case.told().contains("larger than the model"), "{}", case.told());
}

#[test]
#[expect(clippy::disallowed_methods, reason = "the file is the test's own")]
fn landmarks_are_met() {
    // The target is shifted along the body, which its points hardly determine.
    let slide = |p: DVec3| bend(p) + DVec3::new(0.0, 0.0, 0.1 * p.x);
    let file = std::env::temp_dir().join(format!("simod-register-{}.csv", std::process::id()));
    let model = |p: DVec3| DVec3::new(5e5, 4e6, 100.0) + 10.0 * p;
    let lines = directions(12).enumerate().map(|(i, d)| {
        let [s, t] = [body(d), slide(body(d))].map(model);
        format!("p{i},{},{},{},{},{},{}\n", s.x, s.y, s.z, t.x, t.y, t.z)
    });
    std::fs::write(&file, lines.collect::<String>()).expect("a file");
    for method in ["cpd", "icp", "cpd-icp"] {
        let mut case = Case::new(method, &slide);
        case.landmarks = file.to_str().expect("a path").to_owned();
        let (rest, normals) = surface(SAMPLES, &|p| p);
        let rest: Vec<[f32; 3]> = rest.into_iter().map(|p| p.map(|x| x as f32)).collect();
        let map = case.prepare(&rest, &normals).expect("a map").map.expect("a map");
        let off = directions(12).map(|d| map.apply(body(d)).distance(slide(body(d))));
        let worst = off.fold(0.0, f64::max);
        assert!(worst < 0.02 && case.told().contains("landmarks are"), "{method}: {worst}");
    }
    for (text, what) in [("a,1,2,3\n", "line 1"), ("a,1,2,3,4,5,6\n", "far from the model")] {
        std::fs::write(&file, text).expect("a file");
        let mut case = Case::new("cpd", &slide);
        case.landmarks = file.to_str().expect("a path").to_owned();
        assert!(case.moved(EVERYWHERE).expect_err("no landmarks").message.contains(what));
    }
    std::fs::remove_file(&file).expect("a file");
}

/// Points in one place are refused by a method; points in a line, or a plane, get a map, or a message.
fn refuses_what_cannot_be_registered(method: &'static str) {
    let case = Case::new(method, &|p| p);
    for count in [1, 3, 50] {
        let refused = case.prepare(&vec![[0.1, 0.2, 0.3]; count], &vec![[0.0, 0.0, 1.0]; count]);
        assert_eq!(refused.expect_err("a point").code, ErrorCode::INVALID_INPUT, "{method}, {count}");
    }
    for flat in [DVec3::X, DVec3::new(1.0, 1.0, 0.0)] {
        // Few points will do, as nothing has to be met.
        let target = surface(300, &|p| p * flat + 1e-9 * p);
        if let Ok(moved) = (Case { target, ..Case::new(method, &|p| p) }).moved(EVERYWHERE) {
            assert!(moved.iter().all(|[_, q]| q.is_finite()));
        }
    }
}

/// Tests for each method on its own, as some take long and can be run at the same time.
mod what_cannot_be_registered_is_refused {
    use super::refuses_what_cannot_be_registered;

    #[test]
    fn by_drift() {
        refuses_what_cannot_be_registered("cpd");
    }

    #[test]
    fn by_drift_and_closest_points() {
        refuses_what_cannot_be_registered("cpd-icp");
    }

    #[test]
    fn by_closest_points() {
        refuses_what_cannot_be_registered("icp");
    }

    #[test]
    fn by_alignment() {
        refuses_what_cannot_be_registered("align");
    }
}

#[test]
fn a_stop_is_obeyed_anywhere() {
    let case = Case::new("cpd-icp", &bend);
    case.log.left.store(usize::MAX / 2, Ordering::Relaxed);
    case.moved(EVERYWHERE).expect("a map");
    let calls = usize::MAX / 2 - case.log.left.load(Ordering::Relaxed);
    for part in 0..5 {
        case.log.left.store(calls * part / 5, Ordering::Relaxed);
        assert_eq!(case.moved(EVERYWHERE).expect_err("a stop").code, ErrorCode::CANCELLED, "after {part}/5");
    }
}

/// One iteration is as the paper has it, with the whole kernel and matrices (equations 6, 22 and 23).
#[test]
fn an_iteration_is_the_paper_s() {
    let source: Vec<DVec3> = directions(90).map(|d| 2.0 * body(d)).collect();
    let target: Vec<DVec3> = directions(70).map(|d| 2.0 * bend(body(d))).collect();
    let (m, n, width, stiffness, outliers) = (90, 70, 1.2, 3.0, 0.1);
    let mut variance = 0.0;
    for y in &source {
        variance += target.iter().map(|x| x.distance_squared(*y)).sum::<f64>() / (3 * m * n) as f64;
    }
    let uniform =
        (std::f64::consts::TAU * variance).powf(1.5) * outliers / (1.0 - outliers) * m as f64 / n as f64;
    let gaussian = |a: DVec3, b: DVec3, variance: f64| (-a.distance_squared(b) / (2.0 * variance)).exp();
    let mut p = Mat::from_fn(m, n, |i, j| gaussian(source[i], target[j], variance));
    for j in 0..n {
        let whole = (0..m).map(|i| p[(i, j)]).sum::<f64>() + uniform;
        (0..m).for_each(|i| p[(i, j)] /= whole);
    }
    let kernel = Mat::from_fn(m, m, |i, k| gaussian(source[i], source[k], width * width));
    let own: Vec<f64> = (0..m).map(|i| (0..n).map(|j| p[(i, j)]).sum()).collect();
    let left =
        Mat::from_fn(m, m, |i, k| own[i] * kernel[(i, k)] + if i == k { stiffness * variance } else { 0.0 });
    let sums: Vec<DVec3> = (0..m).map(|i| (0..n).map(|j| p[(i, j)] * target[j]).sum()).collect();
    let right = Mat::from_fn(m, 3, |i, k| (sums[i] - own[i] * source[i])[k]);
    let moves = &kernel * faer::linalg::solvers::Solve::solve(&left.partial_piv_lu(), &right);

    let drift = Drift { width, stiffness, centers: m, outliers, most_iterations: 1 };
    let log = Log::default();
    let found = drift.run((&source, &target), &[], Start::Wide, &Host::new(&log), &|_| Ok(()));
    let (field, iterations) = found.expect("a field");
    assert_eq!(iterations, 1);
    for (i, y) in source.iter().enumerate() {
        let off = field.apply(*y).distance(*y + DVec3::new(moves[(i, 0)], moves[(i, 1)], moves[(i, 2)]));
        assert!(off < 1e-5, "{i}: {off:e}");
    }
}

#[test]
fn the_field_is_the_kernel_s() {
    let points: Vec<DVec3> = directions(300).map(body).collect();
    let kernel = Kernel::new(&points, 0.3, 60);
    let count = kernel.factor.ncols();
    assert!((20..=60).contains(&count), "{count}");
    let coefficients = Mat::from_fn(count, 3, |i, k| ((7 * i + 3 * k) as f64).sin());
    let field = kernel.field(&points, &coefficients);
    let expected = &kernel.factor * &coefficients;
    for (i, p) in points.iter().enumerate() {
        let by = field.apply(*p) - *p;
        let off = (0..3).map(|k| (by[k] - expected[(i, k)]).abs()).fold(0.0, f64::max);
        assert!(off < 1e-8, "{i}: {off:e}");
    }
}

proptest! {
    #[test]
    fn similarities_are_recovered(
        axis in proptest::array::uniform3(-2.0..2.0_f64), at in proptest::array::uniform3(-9.0..9.0_f64), scale in 0.01..100.0_f64,
    ) {
        let turn = DQuat::from_scaled_axis(DVec3::from(axis));
        for (scale, with_scale) in [(scale, true), (1.0, false)] {
            let map = DAffine3::from_scale_rotation_translation(DVec3::splat(scale), turn, DVec3::from(at));
            let pairs: Vec<Pair> = directions(20)
                .map(|d| Pair { source: body(d), target: map.transform_point3(body(d)), weight: 1.0 + d.x })
                .collect();
            let found = similarity(&pairs, with_scale).expect("a map");
            prop_assert!(found.matrix3.abs_diff_eq(map.matrix3, 1e-8 * scale));
            prop_assert!(found.translation.distance(map.translation) < 1e-8 * (scale + 10.0));
        }
    }

    /// A graph whose nodes a rigid motion moves is that motion everywhere, and without strain.
    #[test]
    fn a_graph_turns_with_its_nodes(
        axis in proptest::array::uniform3(-2.0..2.0_f64), at in proptest::array::uniform3(-9.0..9.0_f64), count in 8_usize..60,
    ) {
        let map = DAffine3::from_rotation_translation(DQuat::from_scaled_axis(DVec3::from(axis)), DVec3::from(at));
        let points: Vec<DVec3> = directions(200).map(body).collect();
        let graph = Graph::new(&points, count).moved(|p| map.transform_point3(p));
        prop_assert!(graph.strain() < 1e-7);
        for p in points {
            prop_assert!(graph.apply(p).distance(map.transform_point3(p)) < 1e-7);
        }
    }

    #[test]
    fn the_farthest_are_apart_and_near_to_all(count in 1_usize..50) {
        let points: Vec<DVec3> = directions(60).map(body).collect();
        let found = farthest(&points, count);
        prop_assert_eq!(found.len(), count);
        let to_found = |p: DVec3| found.iter().map(|i| p.distance(points[*i])).fold(f64::INFINITY, f64::min);
        let reach = points.iter().map(|p| to_found(*p)).fold(0.0, f64::max);
        for (k, a) in found.iter().enumerate() {
            prop_assert!(found[..k].iter().all(|b| points[*a].distance(points[*b]) >= reach));
        }
    }

    #[test]
    fn the_nearest_is_the_nearest(
        points in proptest::collection::vec(proptest::array::uniform3(-3_i8..4), 1..60), p in proptest::array::uniform3(-4_i8..5),
    ) {
        let dense = |p: [i8; 3]| DVec3::from_array(p.map(f64::from));
        let (points, p): (Vec<DVec3>, DVec3) = (points.into_iter().map(dense).collect(), dense(p));
        let tree = Tree::new(&points);
        for accepts in [&(|_| true) as &dyn Fn(u32) -> bool, &(|i| i % 3 == 0)] {
            let near = (0..points.len() as u32).filter(|i| accepts(*i));
            let best = near.min_by(|a, b| {
                let [a, b] = [*a, *b].map(|i| (p.distance_squared(points[i as usize]), i));
                a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
            });
            prop_assert_eq!(tree.nearest(p, accepts).map(|(i, _)| i), best);
        }
    }
}
