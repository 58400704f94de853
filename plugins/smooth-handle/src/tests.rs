//! The whole plugin, on a bar along y that is held at one end and moved at the other.

use super::*;
use glam::{DMat3, DQuat};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use proptest::prelude::*;
use simod_plugin_api::{
    Bounds, ErrorCode, Graph, HostCalls, LogLevel, Param, ParamKind, Part, Region, Role, Samples,
};

const NEIGHBOURS: usize = 32;

struct Setup {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    regions: Vec<(Role, Vec<f32>)>,
    profile: &'static str,
    distance: &'static str,
    reach: [f64; 1],
    smoothing: [f64; 1],
}

impl Setup {
    fn new(samples: impl Iterator<Item = (DVec3, DVec3)>) -> Self {
        let (positions, normals): (Vec<[f32; 3]>, Vec<[f32; 3]>) =
            samples.map(|(p, n)| (p.as_vec3().to_array(), n.as_vec3().to_array())).unzip();
        let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&positions).unwrap();
        let k = NEIGHBOURS.min(positions.len() - 1);
        let mut neighbours = Vec::new();
        for (i, p) in positions.iter().enumerate() {
            let count = std::num::NonZero::new(k + 1).unwrap();
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            neighbours.extend(near.into_iter().map(|n| n.item).filter(|&j| j != i as u32).take(k));
        }
        let starts = (0..=positions.len()).map(|i| (i * k) as u32).collect();
        Self {
            positions,
            normals,
            starts,
            neighbours,
            regions: Vec::new(),
            profile: "smoother",
            distance: "euclidean",
            reach: [0.25],
            smoothing: [0.02],
        }
    }

    /// Cylinder of radius 0.1 and height 1, held below y = 0.2, with a handle above y = 0.8.
    fn bar(count: usize) -> Self {
        let mut setup = Self::new(cylinder(count, DVec3::ZERO));
        setup.region(Role::FIXED, |p| p.y < 0.2);
        setup.region(Role::HANDLE, |p| p.y > 0.8);
        setup
    }

    fn region(&mut self, role: Role, inside: impl Fn(Vec3) -> bool) {
        let weights = self.positions.iter().map(|p| f32::from(u8::from(inside(Vec3::from(*p))))).collect();
        self.regions.push((role, weights));
    }

    fn bounds(&self) -> Bounds {
        Bounds { min: [-0.1, 0.0, -0.1], max: [0.1, 1.0, 0.1] }
    }

    fn with<T>(&self, call: impl FnOnce(&[Param<'_>]) -> T) -> T {
        call(&[
            Param::text("profile", ParamKind::CHOICE, self.profile),
            Param::numbers("curve", ParamKind::CURVE, &[0.0, 0.0, 1.0, 1.0]),
            Param::text("distance", ParamKind::CHOICE, self.distance),
            Param::numbers("reach", ParamKind::FLOAT, &self.reach),
            Param::numbers("smoothing", ParamKind::FLOAT, &self.smoothing),
        ])
    }

    fn prepare(&self, host: &impl HostCalls) -> PluginResult<PreparedShares> {
        let regions: Vec<Region<'_>> = self.regions.iter().map(|(role, w)| Region::new(*role, w)).collect();
        let graph = Graph::new(&self.starts, &self.neighbours);
        let parts = [Part::new(&graph)];
        let samples = Samples::new(&self.positions, &self.normals, &[]);
        self.with(|params| {
            let input = PrepareInput::new(samples, self.bounds(), &regions, params).with_parts(&parts);
            SmoothHandle::prepare(&input, &Host::new(host))
        })
    }

    fn deform(&self, transforms: &[Affine]) -> Vec<[f32; 3]> {
        self.deform_by(&self.prepare(&()).unwrap(), transforms, Effort::FULL, &mut Amounts::default())
    }

    fn deform_by(
        &self,
        state: &PreparedShares,
        transforms: &[Affine],
        effort: Effort,
        kept: &mut Amounts,
    ) -> Vec<[f32; 3]> {
        let samples = Samples::new(&self.positions, &self.normals, &[]);
        let mut out = vec![[f32::NAN; 3]; self.positions.len()];
        let parts = [Part::new(&effort)];
        self.with(|params| {
            let input = DeformInput::new(samples, self.bounds(), transforms, params).with_parts(&parts);
            SmoothHandle::deform(state, &input, kept, &mut out, &Host::new(&())).unwrap();
        });
        out
    }

    /// Rest and deformed positions.
    fn pairs<'a>(&'a self, out: &'a [[f32; 3]]) -> impl Iterator<Item = (DVec3, DVec3)> + 'a {
        let point = |p: &[f32; 3]| Vec3::from(*p).as_dvec3();
        self.positions.iter().zip(out).map(move |(p, q)| (point(p), point(q)))
    }
}

fn cylinder(count: usize, at: DVec3) -> impl Iterator<Item = (DVec3, DVec3)> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count).map(move |i| {
        let angle = golden * i as f64;
        let n = DVec3::new(angle.cos(), 0.0, angle.sin());
        (0.1 * n + at + DVec3::Y * ((i as f64 + 0.5) / count as f64), n)
    })
}

/// Turns about an axis through a pivot, scales, and moves.
fn motion(axis: DVec3, degrees: f64, pivot: DVec3, scale: f64, by: DVec3) -> Affine {
    let matrix = DMat3::from_quat(DQuat::from_axis_angle(axis, degrees.to_radians())) * scale;
    let offset = pivot - matrix * pivot + by;
    let rows = matrix.transpose();
    let row = |v: DVec3, t: f64| [v.x, v.y, v.z, t];
    Affine { rows: [row(rows.x_axis, offset.x), row(rows.y_axis, offset.y), row(rows.z_axis, offset.z)] }
}

fn shift(x: f64, y: f64, z: f64) -> Affine {
    motion(DVec3::Y, 0.0, DVec3::ZERO, 1.0, DVec3::new(x, y, z))
}

#[test]
fn regions_do_exactly_as_told() {
    let setup = Setup::bar(4000);
    let turn = motion(DVec3::X, 70.0, DVec3::new(0.0, 0.5, 0.0), 1.2, DVec3::new(0.1, 0.0, 0.2));
    let out = setup.deform(&[turn]);
    for (p, q) in setup.pairs(&out) {
        if p.y < 0.2 {
            assert_eq!(p, q);
        } else if p.y > 0.8 {
            assert_eq!(q, DVec3::from(turn.apply(p.into())).as_vec3().as_dvec3());
        }
    }
    assert_eq!(setup.deform(&[Affine::IDENTITY]), setup.positions);
}

/// Drafts do not depend on former drafts with the same working memory.
#[test]
fn drafts_are_like_results() {
    let mut kept = Amounts::default();
    let turn = motion(DVec3::X, 70.0, DVec3::new(0.0, 0.5, 0.0), 1.2, DVec3::new(0.1, 0.0, 0.2));
    for handles in [1, 2] {
        let mut setup = Setup::bar(4000);
        if handles == 2 {
            setup.region(Role::HANDLE, |p| p.y > 0.4 && p.y < 0.5);
        }
        let state = setup.prepare(&()).unwrap();
        for (profile, moved) in [("linear", 0), ("smoother", 0), ("curve", 0), ("curve", handles - 1)] {
            setup.profile = profile;
            let mut motions = vec![Affine::IDENTITY; handles];
            motions[moved] = turn;
            let exact = setup.deform_by(&state, &motions, Effort::FULL, &mut Amounts::default());
            let draft = setup.deform_by(&state, &motions, Effort::DRAFT, &mut kept);
            for ((p, q), r) in setup.positions.iter().zip(&exact).zip(&draft) {
                assert!(Vec3::from(*q).distance(Vec3::from(*r)) < 4e-6, "{profile}, {moved}: {q:?} {r:?}");
                // Samples that stay do so in both.
                assert_eq!(q == p, r == p, "{profile}, {moved}: {p:?} {q:?} {r:?}");
            }
        }
    }
}

#[test]
fn all_samples_in_handles_move_rigidly() {
    let mut setup = Setup::new(cylinder(2000, DVec3::ZERO));
    setup.region(Role::HANDLE, |p| p.y < 0.4);
    setup.region(Role::HANDLE, |p| p.y >= 0.4);
    let turn = motion(DVec3::Z, 130.0, DVec3::ONE, 1.0, DVec3::X);
    let out = setup.deform(&[turn; 2]);
    for (p, q) in setup.pairs(&out) {
        assert_eq!(q, DVec3::from(turn.apply(p.into())).as_vec3().as_dvec3());
    }
}

#[test]
fn a_twist_turns_by_parts_of_the_angle_and_keeps_the_radius() {
    for profile in ["linear", "smooth", "smoother", "curve"] {
        let setup = Setup { profile, ..Setup::bar(10_000) };
        let out = setup.deform(&[motion(DVec3::Y, 120.0, DVec3::ZERO, 1.0, DVec3::ZERO)]);
        for (p, q) in setup.pairs(&out) {
            assert!((q.x.hypot(q.z) - 0.1).abs() < 1e-6 && (q.y - p.y).abs() < 1e-6, "{profile}");
            let angle = DVec3::new(p.x, 0.0, p.z).angle_between(DVec3::new(q.x, 0.0, q.z)).to_degrees();
            let t = ((p.y - 0.2) / 0.6).clamp(0.0, 1.0);
            let expected = match profile {
                "linear" => t,
                "smoother" => t * t * t * (t * (6.0 * t - 15.0) + 10.0),
                _ => t * t * (3.0 - 2.0 * t),
            };
            // Half of the bar is half of the angle; ends differ a little, as the nearest sample is not
            // straight below.
            assert!((angle / 120.0 - expected).abs() < 0.03, "{profile} at {t}: {angle}");
        }
    }
}

#[test]
fn borders_and_ridges_do_not_show() {
    // Two handles and a fixed region on a plate: distances have ridges between them.
    let side = 120;
    let plate = (0..side * side).map(|i| {
        let at = |k: usize| k as f64 / f64::from(side as u32 - 1);
        (DVec3::new(at(i % side), at(i / side), 0.0), DVec3::Z)
    });
    let mut setup = Setup::new(plate);
    setup.region(Role::FIXED, |p| p.x < 0.2 || p.x > 0.8);
    setup.region(Role::HANDLE, |p| p.distance(Vec3::new(0.5, 0.3, 0.0)) < 0.1);
    setup.region(Role::HANDLE, |p| p.distance(Vec3::new(0.5, 0.7, 0.0)) < 0.1);
    let out = setup.deform(&[shift(0.0, 0.0, 0.2), shift(0.0, 0.0, -0.1)]);
    let height = |x: usize, y: usize| f64::from(out[y * side + x][2]);
    let mut sharpest: f64 = 0.0;
    let mut steepest: f64 = 0.0;
    for y in 1..side - 1 {
        for x in 1..side - 1 {
            for (before, after) in
                [(height(x - 1, y), height(x + 1, y)), (height(x, y - 1), height(x, y + 1))]
            {
                let kink = (before + after - 2.0 * height(x, y)).abs();
                sharpest = sharpest.max(kink);
                steepest = steepest.max((after - before).abs() / 2.0);
            }
        }
    }
    // A kink would bend by the whole slope from one sample to the next.
    assert!(sharpest < 0.25 * steepest, "{sharpest} {steepest}");
}

#[test]
fn without_fixed_regions_handles_reach_as_far_as_they_should() {
    for distance in ["euclidean", "surface"] {
        let mut setup = Setup::new(cylinder(6000, DVec3::ZERO));
        setup.region(Role::HANDLE, |p| p.y > 0.8);
        setup.reach = [0.3];
        setup.distance = distance;
        let reach = 0.3 * setup.bounds().diagonal();
        let out = setup.deform(&[shift(0.3, 0.0, 0.0)]);
        let mut on_the_way = 0;
        for (p, q) in setup.pairs(&out) {
            if p.y < 0.8 - reach - 0.01 {
                assert_eq!(p, q, "{distance}");
            }
            on_the_way += usize::from(q.x - p.x > 0.01 && q.x - p.x < 0.29);
        }
        assert!(on_the_way > 1000, "{distance}: {on_the_way}");
    }
}

#[test]
fn the_next_finger_stays_where_distances_are_along_the_surface() {
    // Two bars, of which one is nearer to the other than to its own fixed end.
    let bars = cylinder(4000, DVec3::ZERO).chain(cylinder(4000, DVec3::X * 0.25));
    let mut setup = Setup::new(bars);
    setup.region(Role::FIXED, |p| p.y < 0.2);
    setup.region(Role::HANDLE, |p| p.y > 0.8 && p.x < 0.125);
    let moved = |setup: &Setup| {
        let out = setup.deform(&[shift(0.0, 0.3, 0.0)]);
        setup.pairs(&out).skip(4000).map(|(p, q)| p.distance(q)).fold(0.0, f64::max)
    };
    assert!(moved(&setup) > 0.1);
    setup.distance = "surface";
    assert_eq!(moved(&setup), 0.0);
}

#[test]
fn soft_weights_pull_as_much_as_they_say() {
    let mut setup = Setup::bar(4000);
    // The handle fades from y = 0.9 to y = 0.6.
    setup.regions[1].1 = setup.positions.iter().map(|p| ((p[1] - 0.6) / 0.3).clamp(0.0, 1.0)).collect();
    setup.profile = "linear";
    let out = setup.deform(&[shift(0.0, 0.0, 1.0)]);
    for ((p, q), w) in setup.pairs(&out).zip(&setup.regions[1].1) {
        assert!(q.z - p.z >= f64::from(*w) - 1e-6 && q.z - p.z <= 1.0 + 1e-6, "{} {w}", q.z - p.z);
    }
    // A fixed region that covers the rest takes its part.
    setup.regions[0].1 = setup.regions[1].1.iter().map(|w| 1.0 - w).collect();
    let out = setup.deform(&[shift(0.0, 0.0, 1.0)]);
    for ((p, q), w) in setup.pairs(&out).zip(&setup.regions[1].1) {
        assert!((q.z - p.z - f64::from(*w)).abs() < 2e-3, "{} {w}", q.z - p.z);
    }
}

#[test]
fn a_handle_in_two_parts_does_as_one() {
    let mut whole = Setup::new(cylinder(4000, DVec3::ZERO));
    whole.region(Role::FIXED, |p| p.y < 0.2);
    let mut parts = Setup::new(cylinder(4000, DVec3::ZERO));
    parts.region(Role::FIXED, |p| p.y < 0.2);
    whole.region(Role::HANDLE, |p| p.y > 0.8);
    parts.region(Role::HANDLE, |p| p.y > 0.8 && p.x < 0.0);
    parts.region(Role::HANDLE, |p| p.y > 0.8 && p.x >= 0.0);
    let turn = motion(DVec3::X, 60.0, DVec3::ZERO, 1.0, DVec3::ZERO);
    let (a, b) = (whole.deform(&[turn]), parts.deform(&[turn; 2]));
    // Two handles pull harder than one against what is fixed, but along the same way.
    for ((p, q), (_, r)) in whole.pairs(&a).zip(parts.pairs(&b)) {
        let way = |v: DVec3| v.y.hypot(v.z);
        assert!((way(q) - way(p)).abs() < 1e-6 && (way(r) - way(p)).abs() < 1e-6);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn what_is_turned_as_a_whole_deforms_as_before(
        axis in prop::array::uniform3(-1.0..1.0_f64), degrees in 0.0..360.0_f64, tilt in -90.0..90.0_f64,
    ) {
        let world = DQuat::from_scaled_axis(DVec3::from(axis) * degrees.to_radians());
        let bar = Setup::bar(1500);
        let mut turned = Setup::new(cylinder(1500, DVec3::ZERO).map(|(p, n)| (world * p, world * n)));
        turned.regions = bar.regions.clone();
        let (pivot, by) = (DVec3::new(0.0, 0.4, 0.1), DVec3::new(0.0, 0.1, 0.2));
        let a = bar.deform(&[motion(DVec3::X, tilt, pivot, 1.3, by)]);
        let b = turned.deform(&[motion((world * DVec3::X).normalize_or(DVec3::X), tilt, world * pivot, 1.3, world * by)]);
        for ((_, q), (_, r)) in bar.pairs(&a).zip(turned.pairs(&b)) {
            prop_assert!((world * q).distance(r) < 1e-3, "{} {r}", world * q);
        }
    }
}

#[test]
fn what_cannot_be_worked_on_is_refused_with_a_hint() {
    let refused = |regions: Vec<(Role, Vec<f32>)>| {
        let error = Setup { regions, ..Setup::bar(100) }.prepare(&()).err().unwrap();
        assert_eq!(error.code, ErrorCode::INVALID_INPUT);
        assert!(!error.hint.is_empty());
        error.message.into_string()
    };
    let (all, none) = (vec![1.0; 100], vec![0.0; 100]);
    assert!(refused(vec![]).contains("no handle"));
    assert!(refused(vec![(Role::FIXED, all.clone()), (Role::HANDLE, all.clone())]).contains("handle 1"));
    assert!(refused(vec![(Role::FIXED, none), (Role::HANDLE, all)]).contains("fixed"));
}

#[test]
fn stops_when_asked() {
    struct Stop;
    impl HostCalls for Stop {
        fn progress(&self, _: f64) -> bool {
            false
        }
        fn log(&self, _: LogLevel, _: &str) {}
    }
    assert_eq!(Setup::bar(2000).prepare(&Stop).err().unwrap().code, ErrorCode::CANCELLED);
}
