//! Whole stacks of real plugins, on samples of a cylinder far from the model's zero.
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

use crate::common;

use glam::{DVec3, Vec3};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{SampleSet, Sampling, sample};
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::progress::Silent;
use simod_model::{Error, ErrorKind, Progress, Scalar, write_points};
use simod_plugin_api::LogLevel;
use simod_session::edit::Refinements;
use simod_session::step::Step;
use simod_session::{DeformedSamples, PluginRegistry, SessionFile, Stack, deform};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

const ORIGIN: DVec3 = DVec3::new(1e6, -2e6, 500.0);
const FRAME: Frame = Frame { origin: ORIGIN, scale: 0.5 };

/// Radius 1, from 0 to 8 along y, about the origin; in local coordinates, whose unit is half the model's.
fn cylinder(n: usize) -> Vec<Vec3> {
    let angle = |i: usize| (2.399963 * i as f64) % std::f64::consts::TAU;
    (0..n)
        .map(|i| DVec3::new(angle(i).cos(), 8.0 * (i as f64 + 0.5) / n as f64, angle(i).sin()))
        .map(|p| FRAME.to_local(p + ORIGIN))
        .collect()
}

/// A local position in the model's unit.
fn about_origin(p: Vec3) -> Vec3 {
    (FRAME.to_model(p) - ORIGIN).as_vec3()
}

/// A model with these samples, and no others.
fn sampled(positions: &[Vec3]) -> SampledModel {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let vertices = positions.iter().map(|p| FRAME.to_model(*p));
    write_points(&path, vertices, &[], &[], Scalar::F64, &[]).unwrap();
    let model = simod_model::open(&path).unwrap();
    let mut sampled = sample(&*model, &Sampling::default(), folder.path(), &Silent).unwrap();
    sampled.samples = SampleSet::new(positions.to_vec(), Vec::new()).unwrap();
    sampled.frame = FRAME;
    let corner = |p| p + ORIGIN;
    sampled.bounds =
        Bounds { min: corner(DVec3::new(-1.0, 0.0, -1.0)), max: corner(DVec3::new(1.0, 8.0, 1.0)) };
    sampled
}

fn steps(session: &str) -> Result<Vec<Step>, Error> {
    Ok(SessionFile::parse(session, Path::new("s.toml"))?.steps)
}

fn apply(session: &str, positions: &[Vec3]) -> Result<DeformedSamples, Error> {
    apply_by(common::registry(), session, positions, &Silent)
}

fn apply_by(
    registry: &PluginRegistry,
    session: &str,
    positions: &[Vec3],
    progress: &dyn Progress,
) -> Result<DeformedSamples, Error> {
    deform(sampled(positions), &steps(session)?, registry, Refinements::default(), progress)
}

/// The exact map and the samples agree to single precision.
fn assert_evaluates(deformed: &DeformedSamples, positions: &[Vec3], tolerance: f64) {
    assert!(deformed.stack.can_evaluate());
    let mut points: Vec<DVec3> = positions.iter().map(|p| FRAME.to_model(*p)).collect();
    deformed.stack.evaluate(&mut points).unwrap();
    for (a, b) in points.iter().zip(&deformed.positions.local) {
        let error = FRAME.to_local_exact(*a).distance(b.as_dvec3());
        assert!(error < tolerance, "{error}");
    }
}

const BEND: &str = "
[[step]]
deform = \"warp\"
params = { operation = \"bend\", angle = 60 }
";

const RBF: &str = "
[[step]]
deform = \"rbf\"
[[step.region]]
role = \"fixed\"
shapes = [{ half-space = { point = [1e6, -1999999, 500], normal = [0, -1, 0] } }]
[[step.region]]
role = \"handle\"
shapes = [{ half-space = { point = [1e6, -1999993, 500], normal = [0, 1, 0] } }]
move = { translate = [1, 0, 0], axis = [0, 1, 0], degrees = 45, pivot = [1e6, 0, 500] }
";

const MASK: &str = "
[[step.region]]
role = \"mask\"
falloff = 2
shapes = [{ half-space = { point = [1e6, -1999995, 500], normal = [0, 1, 0] } }]
";

#[test]
fn an_empty_stack_changes_nothing() {
    let positions = cylinder(100);
    let deformed = apply("", &positions).unwrap();
    assert_eq!(deformed.positions, positions.clone().into());
    assert_evaluates(&deformed, &positions, 1e-6);
}

#[test]
fn two_plugins_in_one_stack() {
    let positions = cylinder(4000);
    let deformed = apply(&format!("{RBF}{BEND}"), &positions).unwrap();
    assert_evaluates(&deformed, &positions, 1e-5);
    // The other way round is something else: each layer works on what the one before made.
    let other = apply(&format!("{BEND}{RBF}"), &positions).unwrap();
    assert_evaluates(&other, &positions, 1e-5);
    let apart = other.positions.local.iter().zip(&deformed.positions.local).map(|(a, b)| a.distance(*b));
    assert!(apart.fold(0.0, f32::max) > 0.5);

    let turned = apply(RBF, &positions).unwrap();
    for (p, q) in positions.iter().zip(&turned.positions.local) {
        let (p, q) = (about_origin(*p), about_origin(*q));
        if p.y < 1.0 {
            assert!(p.distance(q) < 1e-2);
        } else if p.y > 7.0 {
            let expected = glam::Quat::from_rotation_y(45_f32.to_radians()) * p + Vec3::X;
            assert!(expected.distance(q) < 1e-2);
        }
    }
}

#[test]
fn masks_hold_any_layer_back() {
    let positions = cylinder(2000);
    let whole = apply(BEND, &positions).unwrap();
    let masked = apply(&format!("{BEND}{MASK}"), &positions).unwrap();
    assert_evaluates(&masked, &positions, 1e-5);
    for (p, (w, m)) in positions.iter().zip(whole.positions.local.iter().zip(&masked.positions.local)) {
        let y = about_origin(*p).y;
        if y >= 5.0 {
            assert_eq!(w, m);
        } else if y <= 3.0 {
            assert_eq!(p, m);
        } else if (y - 4.0).abs() < 1e-3 {
            assert!(p.midpoint(*w).distance(*m) < 1e-2 * p.distance(*w));
        }
    }
}

#[test]
fn an_amount_blends_any_layer_with_its_rest_shape() {
    let positions = cylinder(2000);
    for step in [BEND.to_owned(), RBF.to_owned(), format!("{BEND}{MASK}")] {
        let with = |amount: f64| {
            let deform = step.find("deform").unwrap();
            let text = format!("{}amount = {amount:?}\n{}", &step[..deform], &step[deform..]);
            apply(&text, &positions).unwrap()
        };
        let whole = apply(&step, &positions).unwrap();
        assert_eq!(with(1.0).positions, whole.positions);
        assert_eq!(with(0.0).positions, positions.clone().into());
        assert!(with(0.0).stack.can_evaluate());
        let part = with(0.3);
        assert_evaluates(&part, &positions, 1e-5);
        for (p, (w, q)) in positions.iter().zip(whole.positions.local.iter().zip(&part.positions.local)) {
            assert!(p.lerp(*w, 0.3).distance(*q) < 1e-5, "{p} went to {q}, not a part of the way to {w}");
        }
        // The next layer's rest shape is what is left of this one.
        let text =
            format!("[[step]]\namount = 0\n{}{RBF}", step.trim_start().trim_start_matches("[[step]]\n"));
        assert_eq!(apply(&text, &positions).unwrap().positions, apply(RBF, &positions).unwrap().positions);
    }
}

#[test]
fn points_that_are_no_numbers_stay() {
    let positions = cylinder(100);
    let deformed = apply(BEND, &positions).unwrap();
    let mut points = [DVec3::new(f64::NAN, 1.0, f64::INFINITY), ORIGIN + DVec3::Y];
    deformed.stack.evaluate(&mut points).unwrap();
    assert!(points[0].x.is_nan() && points[0].y == 1.0 && points[0].z == f64::INFINITY);
    assert!(points[1].is_finite() && points[1] != ORIGIN + DVec3::Y);
}

#[test]
fn what_is_wrong_in_a_step_names_the_step() {
    let told = |session: &str, what: &str, hint: &str| {
        let error = Stack::build(&steps(session).unwrap(), common::registry()).unwrap_err();
        let line = if what.contains("parameter") { 4 } else { 2 };
        assert!(error.to_string().starts_with(&format!("s.toml, line {line}: ")), "{error}");
        assert!(error.to_string().contains(what), "{error}");
        assert!(error.hint().contains(hint), "{}", error.hint());
    };
    told("\n[[step]]\ndeform = \"wrap\"", "no plugin `wrap`", "`warp`");
    told("\n[[step]]\ndeform = \"warp\"\nparams = { angel = 1 }", "no parameter `angel`", "`angle`");
    told("\n[[step]]\ndeform = \"rbf\"", "needs 1 handle region", "role = \"handle\"");
    let region =
        "[[step.region]]\nrole = \"fixed\"\nshapes = [{ sphere = { center = [0,0,0], radius = 1 } }]";
    told(&format!("\n[[step]]\ndeform = \"warp\"\n{region}"), "uses no fixed regions", "mask");
}

#[test]
fn plugin_errors_come_out_with_their_hints() {
    let told = |session: &str, what: &str| {
        let error = apply(session, &cylinder(500)).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Plugin);
        assert!(error.to_string().contains(what), "{error}");
        assert!(!error.hint().is_empty());
    };
    told("[[step]]\ndeform = \"warp\"\nparams = { axis = [0,0,0] }", "plugin warp: parameter `axis` is zero");
    told("[[step]]\ndeform = \"warp\"\nparams = { from = 1, to = 0 }", "parameter `from`");
    let far = "[[step]]\ndeform = \"rbf\"\n[[step.region]]\nrole = \"handle\"\nshapes = [{ sphere = { center = [0,0,0], radius = 1 } }]";
    told(far, "holds no sample");
}

fn misbehave(how: &str) -> Result<DeformedSamples, Error> {
    // A good layer first: its work is lost as well, since the stack is one.
    apply(
        &format!("{BEND}[[step]]\ndeform = \"misbehaving\"\nparams = {{ how = \"{how}\" }}"),
        &cylinder(300),
    )
}

#[test]
fn misbehaviour_is_an_error_and_not_a_crash() {
    for (how, what) in [
        ("panic-in-prepare", "panicked: no state for 300 samples"),
        ("panic-in-deform", "panicked: half-way"),
        ("panic-payload", "panicked: without a message"),
        ("error-in-prepare", "plugin misbehaving: this does not please me"),
        ("error-in-deform", "plugin misbehaving: not today"),
        ("cancel-unasked", "stopped unasked"),
        ("nan", "1 of 300 positions are unwritten or not finite, the first at index 100"),
        ("unwritten", "1 of 300 positions are unwritten or not finite, the first at index 299"),
    ] {
        let error = misbehave(how).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Plugin, "{how}");
        assert!(error.to_string().contains(what), "{how}: {error}");
        assert!(!error.to_string().contains('\n') && !error.hint().contains('\n'));
        assert!(!error.hint().is_empty(), "{how}");
    }
    // The same plugin works on, right after.
    let deformed = misbehave("well").unwrap();
    let [message] = deformed.messages.as_slice() else { panic!("{:?}", deformed.messages) };
    assert_eq!((message.text.as_str(), message.level), ("all is well", LogLevel::INFO));
    drop(misbehave("panic-in-drop").unwrap());
    let deformed = misbehave("panic-in-evaluate").unwrap();
    let error = deformed.stack.evaluate(&mut [ORIGIN]).unwrap_err();
    assert!(error.to_string().contains("panicked: nowhere"), "{error}");
}

/// Cancelled from the first look on.
struct Stopped(AtomicBool);

impl Progress for Stopped {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

#[test]
fn cancelled_is_cancelled_whether_the_plugin_obeys_or_not() {
    let positions = cylinder(500);
    for session in [RBF, BEND, "[[step]]\ndeform = \"misbehaving\"\nparams = { how = \"ignore-cancel\" }"] {
        let stopped = Stopped(AtomicBool::new(true));
        let error = apply_by(common::registry(), session, &positions, &stopped).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Cancelled);
    }
}

/// A plugin's process that came to its end takes what it prepared with it, and nothing else.
#[test]
#[cfg(unix)]
fn the_next_call_starts_another_process() {
    let folder = tempfile::tempdir().unwrap();
    common::copy("misbehaving", folder.path(), "misbehaving");
    let registry = common::load_isolated(folder.path());
    assert!(registry.rejected().is_empty(), "{:?}", registry.rejected());
    let positions = cylinder(500);
    let apply = |how: &str| {
        let text = format!("[[step]]\ndeform = \"misbehaving\"\nparams = {{ how = \"{how}\" }}\n");
        apply_by(&registry, &text, &positions, &Silent)
    };
    let first = apply("well").unwrap();
    assert_evaluates(&first, &positions, 1e-6);
    // Two stacks share the process.
    let second = apply("well").unwrap();
    assert_eq!(first.positions, second.positions);
    drop(second);
    for _ in 0..2 {
        let error = apply("segfault").err().unwrap();
        assert!(error.to_string().contains("invalid memory access"), "{error}");
        let gone = first.stack.evaluate(&mut [DVec3::ZERO]).unwrap_err();
        assert!(gone.to_string().contains("process ended"), "{gone}");
    }
    assert_eq!(apply("well").unwrap().positions, first.positions);
}
