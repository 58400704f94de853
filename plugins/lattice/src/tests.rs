//! The whole plugin, as the host calls it.

use super::*;
use proptest::prelude::*;
use simod_plugin_api::{Bounds, HandleMotions, Param, ParamKind, Part, Samples};

const BOUNDS: Bounds = Bounds { min: [-0.5, -0.7, -0.3], max: [0.5, 0.8, 0.4] };

/// A lattice on samples in and around the box.
#[derive(Debug, Clone)]
struct Setup {
    samples: Vec<[f32; 3]>,
    resolution: [f64; 3],
    basis: &'static str,
    outside: &'static str,
    sizes: [f64; 3],
    axis: [f64; 3],
    angle: f64,
}

impl Setup {
    fn new(basis: &'static str, outside: &'static str) -> Self {
        let at = |i: i32, range: f64| (f64::from(i) * 0.618_034).fract() * range;
        let sample = |i: i32| {
            let size: [f64; 3] = std::array::from_fn(|a| BOUNDS.max[a] - BOUNDS.min[a]);
            let u = [at(i, 1.0), at(7 * i, 1.0), at(31 * i, 1.0)];
            std::array::from_fn(|a| (BOUNDS.min[a] + u[a] * size[a]) as f32)
        };
        let (samples, resolution) = ((0..5001).map(sample).collect(), [4.0, 5.0, 3.0]);
        Self { samples, resolution, basis, outside, sizes: [0.0; 3], axis: [0.0, 1.0, 0.0], angle: 0.0 }
    }

    /// A box that covers a part of the samples, turned.
    fn small(self) -> Self {
        Self { sizes: [0.3, 0.4, 0.25], axis: [1.0, 2.0, -0.5], angle: 35.0, ..self }
    }

    fn with<T>(&self, call: impl FnOnce(&PrepareInput<'_>) -> T) -> T {
        let [x, y, z] = self.resolution.map(|n| [n]);
        let [sx, sy, sz] = self.sizes.map(|s| [s]);
        let (angle, reach, centre) = ([self.angle], [0.25], [0.0, 0.05, 0.05]);
        let params = [
            Param::numbers("resolution-x", ParamKind::INT, &x),
            Param::numbers("resolution-y", ParamKind::INT, &y),
            Param::numbers("resolution-z", ParamKind::INT, &z),
            Param::text("basis", ParamKind::CHOICE, self.basis),
            Param::numbers("center", ParamKind::POINT, &centre),
            Param::numbers("size-x", ParamKind::FLOAT, &sx),
            Param::numbers("size-y", ParamKind::FLOAT, &sy),
            Param::numbers("size-z", ParamKind::FLOAT, &sz),
            Param::numbers("axis", ParamKind::DIRECTION, &self.axis),
            Param::numbers("angle", ParamKind::FLOAT, &angle),
            Param::text("outside", ParamKind::CHOICE, self.outside),
            Param::numbers("reach", ParamKind::FLOAT, &reach),
        ];
        call(&PrepareInput::new(Samples::new(&self.samples, &[], &[]), BOUNDS, &[], &params))
    }

    fn lattice(&self) -> ControlLattice {
        self.with(|input| LatticePlugin::prepare(input, &Host::new(&()))).unwrap()
    }

    fn handles(&self) -> Vec<HandleDesc> {
        self.with(|input| LatticePlugin::handles(input, &Host::new(&()))).unwrap()
    }

    /// Motions of the handles, by their places at rest.
    fn motions(&self, motion: impl Fn(&HandleDesc) -> Affine) -> Vec<Affine> {
        self.handles().iter().map(motion).collect()
    }

    fn deform(&self, motions: &[Affine]) -> Vec<[f32; 3]> {
        let motions = HandleMotions::new(motions);
        let parts = [Part::new(&motions)];
        let input =
            DeformInput::new(Samples::new(&self.samples, &[], &[]), BOUNDS, &[], &[]).with_parts(&parts);
        let mut out = vec![[f32::NAN; 3]; self.samples.len()];
        LatticePlugin::deform(&self.lattice(), &input, &mut (), &mut out, &Host::new(&())).unwrap();
        out
    }

    fn evaluate(&self, motions: &[Affine], points: &[DVec3]) -> Vec<DVec3> {
        let motions = HandleMotions::new(motions);
        let parts = [Part::new(&motions)];
        let input = DeformInput::new(Samples::new(&[], &[], &[]), BOUNDS, &[], &[]).with_parts(&parts);
        let mut out: Vec<[f64; 3]> = points.iter().map(|p| (*p).into()).collect();
        LatticePlugin::evaluate(&self.lattice(), &input, &mut out, &Host::new(&())).unwrap();
        out.into_iter().map(DVec3::from).collect()
    }

    fn points(&self) -> Vec<DVec3> {
        self.samples.iter().map(|p| DVec3::from(p.map(f64::from))).collect()
    }
}

fn all() -> impl Iterator<Item = Setup> {
    let pairs = ["b-spline", "bernstein"].into_iter().flat_map(|b| ["smooth", "clamped"].map(|o| (b, o)));
    pairs.map(|(basis, outside)| Setup::new(basis, outside))
}

fn shift(by: [f64; 3]) -> Affine {
    Affine {
        rows: std::array::from_fn(|i| {
            [0, 1, 2, 3].map(|j| if j == 3 { by[i] } else { f64::from(u8::from(i == j)) })
        }),
    }
}

/// A motion of each control point to somewhere else.
fn wild(handle: &HandleDesc) -> Affine {
    let [x, y, z] = handle.position;
    shift([0.2 * (9.0 * y).sin(), 0.15 * (7.0 * z + x).cos(), 0.1 * (5.0 * x - y).sin()])
}

#[test]
fn the_box_holds_the_model_and_its_corners_are_handles() {
    for setup in all() {
        let handles = setup.handles();
        assert_eq!(handles.len(), 4 * 5 * 3);
        assert_eq!((handles[0].id.as_str(), handles[59].id.as_str()), ("0,0,0", "3,4,2"));
        for axis in 0..3 {
            let (size, margin) = (BOUNDS.max[axis] - BOUNDS.min[axis], 0.011);
            assert!((handles[0].position[axis] - (BOUNDS.min[axis] - 0.01 * size)).abs() < margin * size);
            assert!(
                handles[0].position[axis] < BOUNDS.min[axis] && handles[59].position[axis] > BOUNDS.max[axis]
            );
        }
        // Corners are met: the corner of space goes where its control point goes.
        let corner = DVec3::from(handles[59].position);
        let motions =
            setup.motions(|h| if h.id == "3,4,2" { shift([0.1, 0.2, 0.3]) } else { Affine::IDENTITY });
        assert!(setup.evaluate(&motions, &[corner])[0].distance(corner + DVec3::new(0.1, 0.2, 0.3)) < 1e-14);
    }
}

#[test]
fn what_does_not_move_stays_to_the_last_bit() {
    for setup in all().chain(all().map(Setup::small)) {
        let still = setup.motions(|_| Affine::IDENTITY);
        assert_eq!(setup.deform(&still), setup.samples);
        assert!(setup.evaluate(&still, &setup.points()) == setup.points());
    }
    // Beyond a spline's reach.
    let setup = Setup { resolution: [10.0; 3], ..Setup::new("b-spline", "smooth") };
    let motions = setup.motions(|h| if h.id == "1,1,1" { shift([0.1; 3]) } else { Affine::IDENTITY });
    let out = setup.deform(&motions);
    let frame = setup.lattice().frame;
    let mut moved = 0;
    for (p, q) in setup.samples.iter().zip(&out) {
        let u = frame.coordinates(DVec3::from(p.map(f64::from)));
        // Control point 1 reaches over the first two of seven spans.
        assert!(p == q || u.iter().all(|u| *u < 2.0 / 7.0), "{u:?}");
        moved += usize::from(p != q);
    }
    assert!(moved > 50);
}

#[test]
fn beyond_the_reach_nothing_moves() {
    for setup in all().filter(|s| s.outside == "smooth").map(Setup::small) {
        let frame = setup.lattice().frame;
        let motions = setup.motions(wild);
        let (mut still, mut moved) = (0, 0);
        for (p, q) in setup.samples.iter().zip(setup.deform(&motions)) {
            let u = frame.coordinates(DVec3::from(p.map(f64::from)));
            let far = u.iter().any(|u| *u <= -0.25 || *u >= 1.25);
            assert!(!far || *p == q);
            still += usize::from(far);
            moved += usize::from(*p != q);
        }
        assert!(still > 500 && moved > 500, "{still} {moved}");
    }
}

#[test]
fn clamped_space_follows_the_nearest_point_of_the_box() {
    for setup in all().filter(|s| s.outside == "clamped").map(Setup::small) {
        let frame = setup.lattice().frame;
        let motions = setup.motions(wild);
        let points = setup.points();
        let nearest: Vec<DVec3> =
            points.iter().map(|p| frame.point(frame.coordinates(*p).map(|u| u.clamp(0.0, 1.0)))).collect();
        let (images, of_nearest) = (setup.evaluate(&motions, &points), setup.evaluate(&motions, &nearest));
        for i in 0..points.len() {
            assert!((images[i] - points[i]).distance(of_nearest[i] - nearest[i]) < 1e-13);
        }
    }
}

/// Lines through the box and out of it have no step, and for `smooth` no kink.
#[test]
fn space_is_continuous_at_the_faces() {
    const STEPS: i32 = 40_000;
    for setup in all().map(Setup::small) {
        let motions = setup.motions(wild);
        for direction in
            [DVec3::X, DVec3::new(0.3, 1.0, 0.2), DVec3::new(-0.7, 0.4, 1.0), DVec3::new(1.0, 0.0, 0.9)]
        {
            let at = |i: i32| {
                DVec3::new(0.0, 0.05, 0.05) + direction * (f64::from(i) / f64::from(STEPS) * 2.0 - 1.0)
            };
            let line: Vec<DVec3> = (0..=STEPS).map(at).collect();
            let moved: Vec<DVec3> =
                setup.evaluate(&motions, &line).iter().zip(&line).map(|(q, p)| *q - *p).collect();
            let h = 2.0 * direction.length() / f64::from(STEPS);
            let slope = moved.windows(2).map(|w| w[0].distance(w[1]) / h).fold(0.0, f64::max);
            assert!(slope < 30.0, "{setup:?} {slope}");
            // Twice the curvature would be of the order of `h`, a kink of that of the slope.
            let bend = moved.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).length() / h).fold(0.0, f64::max);
            assert_eq!(bend < 2000.0 * h, setup.outside == "smooth", "{setup:?} {bend} {slope}");
        }
    }
}

#[test]
fn samples_move_as_space_does() {
    for setup in all().chain(all().map(Setup::small)) {
        let motions = setup.motions(wild);
        let exact = setup.evaluate(&motions, &setup.points());
        let pairs = setup.deform(&motions).into_iter().zip(exact);
        let worst = pairs.map(|(q, e)| DVec3::from(q.map(f64::from)).distance(e)).fold(0.0, f64::max);
        assert!(worst < 3e-7, "{} {}: {worst}", setup.basis, setup.outside);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// All control points moved by one affine map give that map, whatever the lattice.
    #[test]
    fn affine_maps_are_reproduced(
        rows in prop::array::uniform3(prop::array::uniform4(-1.0..1.0_f64)),
        resolution in prop::array::uniform3(2..12_i32),
        turned in 0.0..360.0_f64,
    ) {
        let affine = Affine { rows };
        for setup in all() {
            let resolution = resolution.map(f64::from);
            let setup = Setup { resolution, angle: turned, axis: [1.0, 1.0, -0.3], ..setup };
            let motions = setup.motions(|_| affine);
            for (p, q) in setup.points().iter().zip(setup.evaluate(&motions, &setup.points())) {
                prop_assert!(q.distance(DVec3::from(affine.apply((*p).into()))) < 1e-13);
            }
            for (p, q) in setup.points().iter().zip(setup.deform(&motions)) {
                let q = DVec3::from(q.map(f64::from));
                prop_assert!(q.distance(DVec3::from(affine.apply((*p).into()))) < 2e-6);
            }
        }
    }

    /// Displacements stay within the hull of the control points' ones, within the box.
    #[test]
    fn displacements_are_means(x in prop::collection::vec(-1.0..1.0_f64, 60)) {
        for setup in all() {
            let motions: Vec<Affine> = x.iter().map(|x| shift([*x, 0.0, 0.0])).collect();
            let [min, max] = x.iter().fold([0.0_f64, 0.0], |[a, b], x| [a.min(*x), b.max(*x)]);
            for (p, q) in setup.points().iter().zip(setup.evaluate(&motions, &setup.points())) {
                prop_assert!((min - 1e-14..=max + 1e-14).contains(&(q.x - p.x)));
            }
        }
    }
}

#[test]
fn flat_models_get_a_box_with_a_volume() {
    let bounds = Bounds { min: [0.0; 3], max: [1.0, 0.0, 0.5] };
    let samples = [[0.5, 0.0, 0.2]];
    for bounds in [bounds, Bounds { min: [0.1; 3], max: [0.1; 3] }] {
        let setup = Setup { samples: samples.to_vec(), ..Setup::new("bernstein", "smooth") };
        let lattice = setup.with(|input| {
            let mut input = *input;
            input.bounds = bounds;
            ControlLattice::new(&input)
        });
        let lattice = lattice.unwrap();
        let [a, b] = [[0, 0, 0], [3, 4, 2]].map(|i| lattice.control_point(i));
        assert!((b - a).min_element() > 0.05, "{a} {b}");
    }
}

#[test]
fn senseless_parameters_are_refused() {
    let refused =
        |setup: Setup| setup.with(|input| ControlLattice::new(input).map(drop)).unwrap_err().message;
    let setup = Setup::new("bernstein", "smooth");
    assert!(refused(Setup { axis: [0.0; 3], angle: 1.0, ..setup.clone() }).contains("`axis`"));
    assert!(refused(Setup { resolution: [4.0, 33.0, 4.0], ..setup.clone() }).contains("`resolution-y`"));
    let accepted = |setup: Setup| setup.with(|input| ControlLattice::new(input).is_ok());
    assert!(accepted(Setup { axis: [0.0, 1e-300, 0.0], angle: 1.0, ..setup.clone() }));
    assert!(accepted(Setup { axis: [0.0; 3], ..setup }));
}
