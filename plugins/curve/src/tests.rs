//! The whole plugin, as the host calls it.

use super::*;
use glam::DQuat;
use proptest::prelude::*;
use simod_plugin_api::{Bounds, HandleMotions, ModelFrame, Param, ParamKind, Part, Samples};
use std::f64::consts::{FRAC_PI_2, PI};

const BOUNDS: Bounds = Bounds { min: [-0.2, -1.0, -0.2], max: [0.2, 1.0, 0.2] };
const FRAME: ModelFrame = ModelFrame { origin: [10.0, 20.0, 30.0], scale: 2.0 };

/// A bar along y, and a wire in it.
#[derive(Clone)]
struct Setup {
    samples: Vec<[f32; 3]>,
    points: f64,
    ends: &'static str,
    reach: f64,
    whole: f64,
    twist: f64,
    keep_volume: bool,
    wire: String,
    moved: String,
}

/// Numbers between 0 and 1 that are spread evenly.
fn spread(i: usize) -> DVec3 {
    DVec3::new(0.819_173, 0.671_044, 0.549_7).map(|step| (i as f64 * step).fract())
}

impl Setup {
    fn new(points: usize) -> Self {
        let [low, high] = [BOUNDS.min, BOUNDS.max].map(DVec3::from);
        let samples = (0..3000).map(|i| (low + spread(i) * (high - low)).as_vec3().into()).collect();
        let none = String::new;
        Self {
            samples,
            points: points as f64,
            ends: "follow",
            reach: 1.0,
            whole: 0.5,
            twist: 0.0,
            keep_volume: false,
            wire: none(),
            moved: none(),
        }
    }

    fn with<T>(&self, call: impl FnOnce(&PrepareInput<'_>, &[Param<'_>]) -> T) -> T {
        let (points, reach, whole) = ([self.points], [self.reach], [self.whole]);
        let (twist, keep) = ([self.twist], [f64::from(u8::from(self.keep_volume))]);
        let params = [
            Param::text("wire", ParamKind::FILE, &self.wire),
            Param::text("moved", ParamKind::FILE, &self.moved),
            Param::numbers("points", ParamKind::INT, &points),
            Param::text("ends", ParamKind::CHOICE, self.ends),
            Param::numbers("reach", ParamKind::FLOAT, &reach),
            Param::numbers("whole", ParamKind::FLOAT, &whole),
            Param::numbers("twist", ParamKind::FLOAT, &twist),
            Param::numbers("keep-volume", ParamKind::BOOL, &keep),
        ];
        let samples = Samples::new(&self.samples, &[], &[]);
        let parts = [Part::new(&FRAME)];
        call(&PrepareInput::new(samples, BOUNDS, &[], &params).with_parts(&parts), &params)
    }

    fn prepare(&self) -> PluginResult<PreparedWire> {
        self.with(|input, _| CurvePlugin::prepare(input, &Host::new(&())))
    }

    fn handles(&self) -> Vec<DVec3> {
        let handles = self.with(|input, _| CurvePlugin::handles(input, &Host::new(&()))).unwrap();
        handles.iter().map(|handle| handle.position.into()).collect()
    }

    /// Samples deformed with the wire's points moved: by `deform` and by `evaluate`.
    fn deformed(&self, to: impl Fn(usize, DVec3) -> DVec3) -> [Vec<DVec3>; 2] {
        self.with_moved(to, |state, input| {
            let mut out = vec![[f32::NAN; 3]; self.samples.len()];
            CurvePlugin::deform(state, input, &mut (), &mut out, &Host::new(&())).unwrap();
            [out.iter().map(|p| DVec3::from(p.map(f64::from))).collect(), self.images(state, input)]
        })
    }

    /// Places of the samples with the wire's points moved, by `evaluate` alone.
    fn evaluated(&self, to: impl Fn(usize, DVec3) -> DVec3) -> Vec<DVec3> {
        self.with_moved(to, |state, input| self.images(state, input))
    }

    fn with_moved<T>(
        &self,
        to: impl Fn(usize, DVec3) -> DVec3,
        call: impl FnOnce(&PreparedWire, &DeformInput<'_>) -> T,
    ) -> T {
        let motions: Vec<Affine> =
            self.handles().iter().enumerate().map(|(i, p)| shift(to(i, *p) - *p)).collect();
        let motions = HandleMotions::new(&motions);
        let parts = [Part::new(&motions)];
        let state = self.prepare().unwrap();
        self.with(|_, params| {
            let samples = Samples::new(&self.samples, &[], &[]);
            call(&state, &DeformInput::new(samples, BOUNDS, &[], params).with_parts(&parts))
        })
    }

    fn images(&self, state: &PreparedWire, input: &DeformInput<'_>) -> Vec<DVec3> {
        let mut points: Vec<[f64; 3]> = self.places().into_iter().map(Into::into).collect();
        CurvePlugin::evaluate(state, input, &mut points, &Host::new(&())).unwrap();
        points.into_iter().map(DVec3::from).collect()
    }

    fn places(&self) -> Vec<DVec3> {
        self.samples.iter().map(|p| DVec3::from(p.map(f64::from))).collect()
    }
}

fn shift(by: DVec3) -> Affine {
    let mut affine = Affine::IDENTITY;
    (0..3).for_each(|i| affine.rows[i][3] = by[i]);
    affine
}

fn worst(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

#[test]
fn a_wire_that_is_where_it_was_moves_nothing() {
    for ends in ["follow", "fade"] {
        let setup = Setup { ends, whole: 0.02, reach: 0.1, keep_volume: true, ..Setup::new(5) };
        let [samples, points] = setup.deformed(|_, p| p);
        assert!(samples == setup.places() && points == samples);
    }
}

#[test]
fn rigid_motions_are_those_of_all_that_goes_along_as_a_whole() {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize_or_zero(), 2.0);
    let moved = |p: DVec3| turn * p + DVec3::new(0.3, -0.2, 0.9);
    let setup = Setup::new(6);
    // The least turn of the tangent differs from this turn by one about the wire.
    let axis = turn * DVec3::Y;
    let [samples, points] = setup.deformed(|_, p| moved(p));
    let least = DQuat::from_rotation_arc(DVec3::Y, axis);
    let about = least * turn.conjugate();
    let start = setup.handles()[0];
    let expected: Vec<DVec3> =
        setup.places().iter().map(|p| moved(start) + about * (turn * (*p - start))).collect();
    // The wire through the middle of samples is nearly straight, not wholly.
    let [samples, points] = [samples, points].map(|found| worst(&found, &expected));
    assert!(samples < 0.05 && points < 0.05, "{samples} {points}");
    let translated = setup.deformed(|_, p| p + DVec3::X);
    let expected: Vec<DVec3> = setup.places().iter().map(|p| *p + DVec3::X).collect();
    assert!(worst(&translated[1], &expected) < 1e-14);
}

/// A straight wire along the bar, in a file.
fn straight(folder: &tempfile::TempDir, points: usize) -> String {
    let line = |i: usize| {
        let p = FRAME.to_model([0.0, 2.0 * i as f64 / (points - 1) as f64 - 1.0, 0.0]);
        format!("{},{},{}\n", p[0], p[1], p[2])
    };
    let path = folder.path().join("wire.csv");
    let text = "x,y,z\n".to_owned() + &(0..points).map(line).collect::<String>();
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Barr's bend of the bar by an angle, lengths along its middle kept.
fn bent(p: DVec3, angle: f64) -> DVec3 {
    let (radius, at) = (2.0 / angle, angle * (p.y + 1.0) / 2.0);
    let (sin, cos) = at.sin_cos();
    DVec3::new(radius - (radius - p.x) * cos, (radius - p.x) * sin - 1.0, p.z)
}

#[test]
fn a_wire_bent_to_an_arc_bends_as_barr_does() {
    let folder = tempfile::tempdir().unwrap();
    for angle in [0.5 * PI, 0.99 * PI, PI, 1.01 * PI, 1.9 * PI] {
        let setup = Setup { wire: straight(&folder, 41), ..Setup::new(5) };
        let [samples, points] = setup.deformed(|_, p| bent(p, angle));
        let expected: Vec<DVec3> = setup.places().iter().map(|p| bent(*p, angle)).collect();
        // The curve's ends are straight for a bit.
        let inner = |found: &[DVec3]| {
            let all = found.iter().zip(&expected).zip(setup.places()).filter(|(_, p)| p.y.abs() < 0.9);
            all.map(|((a, b), _)| a.distance(*b)).fold(0.0, f64::max)
        };
        assert!(inner(&points) < 2e-3 * angle, "{angle}: {}", inner(&points));
        assert!(worst(&samples, &points) < 1e-6);
    }
}

#[test]
fn what_is_far_along_the_wire_from_where_it_moves_stays_in_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let setup = Setup { wire: straight(&folder, 13), ..Setup::new(5) };
    // The wire leaves any plane, so that frames that are carried along turn about it.
    let moves = [DVec3::new(0.3, 0.1, 0.0), DVec3::new(0.1, 0.0, 0.4), DVec3::new(-0.2, 0.1, 0.2)];
    let [samples, points] = setup.deformed(|i, p| if (5..8).contains(&i) { p + moves[i - 5] } else { p });
    let (mut still, mut others) = (0, 0);
    for ((before, after), exact) in setup.places().iter().zip(samples).zip(points) {
        // Tangents change at the neighbours of points that move, and the spans beside them.
        if before.y.abs() > 2.0 / 3.0 - 1e-6 {
            assert!(*before == after && *before == exact, "{before} {after} {exact}");
            still += 1;
        } else if before.y.abs() < 0.3 {
            others += usize::from(before.distance(after) > 0.01);
        }
    }
    assert!(still > 900 && others > 700, "{still} {others}");
}

#[test]
fn a_twist_turns_about_the_wire() {
    let folder = tempfile::tempdir().unwrap();
    let setup = Setup { wire: straight(&folder, 4), twist: 300.0, ..Setup::new(5) };
    let [_, points] = setup.deformed(|_, p| p);
    let twisted = |p: &DVec3| DQuat::from_rotation_y(300f64.to_radians() * (p.y + 1.0) / 2.0) * *p;
    let expected: Vec<DVec3> = setup.places().iter().map(twisted).collect();
    assert!(worst(&points, &expected) < 1e-6, "{}", worst(&points, &expected));
}

#[test]
fn what_is_stretched_keeps_its_volume_where_asked() {
    let folder = tempfile::tempdir().unwrap();
    for keep_volume in [false, true] {
        let setup = Setup { wire: straight(&folder, 3), keep_volume, ..Setup::new(5) };
        let [_, points] = setup.deformed(|_, p| DVec3::new(p.x, 4.0 * p.y, p.z));
        let wide = if keep_volume { 0.5 } else { 1.0 };
        let expected: Vec<DVec3> = setup.places().iter().map(|p| DVec3::new(wide, 4.0, wide) * *p).collect();
        assert!(worst(&points, &expected) < 1e-9);
    }
}

#[test]
fn nothing_moves_beyond_the_reach_and_ends_fade_where_asked() {
    let folder = tempfile::tempdir().unwrap();
    let diagonal = BOUNDS.diagonal();
    let setup = Setup { wire: straight(&folder, 5), reach: 0.1 / diagonal, whole: 0.0, ..Setup::new(5) };
    let [_, points] = setup.deformed(|_, p| p + DVec3::Z);
    for (before, after) in setup.places().into_iter().zip(points) {
        let u = before.x.hypot(before.z) / 0.1;
        let expected = if u < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 };
        assert!((after - before - expected * DVec3::Z).length() < 1e-9);
    }
    let path = folder.path().join("short.txt");
    std::fs::write(&path, "10 19 30 # at half of the bar\n\n10\t21 30\n").unwrap();
    for ends in ["follow", "fade"] {
        let setup =
            Setup { wire: path.to_str().unwrap().into(), ends, reach: 0.3 / diagonal, ..Setup::new(5) };
        let [_, points] = setup.deformed(|_, p| p + DVec3::Z);
        let all = setup.places().into_iter().zip(points);
        let moved = all.filter(|(before, after)| before.y > 0.81 && before != after).count();
        assert!((moved > 0) == (ends == "follow"), "{moved}");
    }
}

#[test]
fn a_moved_wire_in_a_file_is_where_its_handles_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("moved.obj");
    std::fs::write(&path, "v 13 18 30\nv 11 22 30\nv 11 18 30 1.0\nl -1 -2\n").unwrap();
    let moved = path.to_str().unwrap().to_owned();
    let setup = Setup { wire: straight(&folder, 2), moved, ..Setup::new(5) };
    assert_eq!(setup.handles(), [DVec3::new(0.5, -1.0, 0.0), DVec3::new(0.5, 1.0, 0.0)]);
    let [_, points] = setup.deformed(|_, p| p + DVec3::Z);
    let expected: Vec<DVec3> = setup.places().iter().map(|p| *p + DVec3::new(0.5, 0.0, 1.0)).collect();
    assert!(worst(&points, &expected) < 1e-14);
}

#[test]
fn what_is_no_wire_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let setup = Setup { wire: path.to_str().unwrap().into(), ..Setup::new(5) };
        setup.prepare().err().unwrap().to_string()
    };
    assert!(refused("a.csv", "0,0,0\n").contains("two at least"));
    assert!(refused("a.csv", "0,0,0\n1,1\n").contains("line 2 has 2 fields"));
    assert!(refused("a.csv", "0,0,0\n1,1,nan\n").contains("not finite"));
    assert!(refused("a.csv", "0,0,0\n1,1,one\n").contains("`one`"));
    assert!(refused("a.csv", "0,0,0\n0,0,0\n1,1,1\n").contains("points 0 and 1 of the wire coincide"));
    assert!(refused("a.obj", "v 0 0 0\nv 1 1 1\nl 1 3\n").contains("line 3 names `3`"));
    assert!(refused("a.obj", "l 9223372036854775807 -9223372036854775808\n").contains("no vertex"));
    assert!(refused("a.csv", &"1 1 1\n2 2 2\n".repeat(501)).contains("1002 points"));
    let other = folder.path().join("other.csv");
    std::fs::write(&other, "0,0,0\n1,1,1\n2,2,2\n").unwrap();
    let setup = Setup { wire: straight(&folder, 2), moved: other.to_str().unwrap().into(), ..Setup::new(5) };
    assert!(setup.prepare().err().unwrap().to_string().contains("the moved wire has 3 points, the wire 2"));
}

#[test]
fn a_wire_that_comes_back_to_itself_is_told() {
    let circle = |turns: f64| -> Vec<DVec3> {
        (0..33).map(|i| DQuat::from_rotation_z(turns * 2.0 * PI * f64::from(i) / 32.0) * DVec3::X).collect()
    };
    let told = |points: Vec<DVec3>| {
        comes_back(&NearestOnCurve::new(Spline::new(spline::knots(&points), points), true), 2.0).is_some()
    };
    assert!(!told(circle(0.9)) && told(circle(1.0)) && told(circle(1.5)));
}

/// Host that keeps the messages.
#[derive(Default)]
struct Listener(std::sync::Mutex<String>);

impl simod_plugin_api::HostCalls for Listener {
    fn progress(&self, _: f64) -> bool {
        true
    }
    fn log(&self, _: simod_plugin_api::LogLevel, message: &str) {
        *self.0.lock().unwrap() += message;
    }
}

#[test]
fn a_moved_wire_that_crosses_itself_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let [rest, moved] = ["rest.csv", "moved.csv"].map(|name| folder.path().join(name));
    std::fs::write(&rest, "10,18,30\n10,19,30\n10,20,30\n10,21,30\n").unwrap();
    let told = |to: &str| {
        std::fs::write(&moved, to).unwrap();
        let [wire, moved] = [&rest, &moved].map(|path| path.to_str().unwrap().to_owned());
        let host = Listener::default();
        let setup = Setup { wire, moved, ..Setup::new(4) };
        setup.with(|input, _| CurvePlugin::prepare(input, &Host::new(&host)).map(drop)).unwrap();
        host.0.into_inner().unwrap()
    };
    assert_eq!(told("10,18,30\n11,19,30\n11,20,30\n10,21,30\n"), "");
    assert!(told("10,18,30\n11,20,30\n9,20,30\n10,18,30.01\n").contains("moved wire comes back"));
}

proptest! {
    #[test]
    fn the_nearest_place_is_no_farther_than_any_other(
        points in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 2..12),
        p in prop::array::uniform3(-2.0..2.0f64),
    ) {
        let (points, p): (Vec<DVec3>, DVec3) = (points.into_iter().map(DVec3::from).collect(), p.into());
        prop_assume!(points.windows(2).all(|pair| pair[0].distance(pair[1]) > 0.05));
        let curve = Spline::new(spline::knots(&points), points);
        let nearest = NearestOnCurve::new(curve.clone(), false);
        let foot = nearest.find(p);
        prop_assert!((nearest.jet(&foot).position.distance(p) - foot.distance).abs() < 1e-12);
        let places = (0..curve.spans()).flat_map(|span| (0..=200).map(move |u| (span, f64::from(u) / 200.0)));
        let least = places.map(|(span, u)| curve.evaluate(span, curve.parameter(span, u)).position.distance(p));
        // Of two places that are nearly as near, the polyline may choose the other one.
        prop_assert!(foot.distance <= least.fold(f64::INFINITY, f64::min) + 5e-3);
    }

    #[test]
    fn wires_that_bend_less_than_they_are_thick_tear_nothing(
        bends in prop::collection::vec((-0.5..0.5f64, -0.5..0.5f64), 8),
        twist in -360.0..360.0f64,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let setup = Setup { wire: straight(&folder, 9), twist, ..Setup::new(5) };
        // A chain whose links turn by less than half of a right angle.
        let (mut at, mut turn) = (DVec3::new(0.0, -1.0, 0.0), DQuat::IDENTITY);
        let mut chain = vec![at];
        for (x, z) in bends {
            turn *= DQuat::from_rotation_x(x) * DQuat::from_rotation_z(z);
            at += turn * DVec3::new(0.0, 0.25, 0.0);
            chain.push(at);
        }
        let near = |by: DVec3| {
            let samples = setup.samples.iter().map(|p| (DVec3::from(p.map(f64::from)) + by).as_vec3().into());
            let moved = Setup { samples: samples.collect(), ..setup.clone() };
            moved.evaluated(|i, _| chain[i])
        };
        let here = near(DVec3::ZERO);
        for step in [DVec3::X, DVec3::Y, DVec3::Z] {
            let there = near(1e-3 * step);
            // Steps of float in the samples are 6e-8.
            let longest = worst(&here, &there) / 1e-3;
            prop_assert!(longest < 1.0 + 0.3 * (FRAC_PI_2 / 0.25 + twist.to_radians().abs() / 2.0 + 4.0), "{longest}");
        }
    }
}
