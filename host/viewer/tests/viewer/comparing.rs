//! Two versions of an edit beside each other.

use super::edits::Tape;
use super::{LONG, done, model, open, plugins, state};
use simod_core::refinement::Finer;
use simod_generate::Shape;
use simod_session::edit::{self, Change};
use simod_session::step::{Action, Refine};
use simod_session::{Shapes, step::Step};
use simod_viewer::command::Area;
use simod_viewer::engine::Job;
use simod_viewer::record::{Recorder, parse};
use simod_viewer::state::Notice;
use simod_viewer::{Command, ComparedVersion, Overlay, State, replay};
use std::path::Path;
use std::sync::Arc;

fn set(at: usize, id: &str, value: impl Into<toml::Value>) -> Command {
    let change = Change::SetParam { id: id.into(), value: Some(value.into()) };
    Command::Edit(edit::EditCommand::Change { at, change })
}

/// A cylinder, sheared by 0.2.
fn sheared(folder: &Path) -> State {
    let mut state = state(plugins());
    done(&mut state, open(&model(folder, Shape::Cylinder, 20_000), 1500));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    done(&mut state, set(0, "operation", "shear"));
    done(&mut state, set(0, "slope", 0.2));
    state
}

fn refined(factor: f64) -> Command {
    let everywhere = simod_session::RegionShape::Sphere { center: glam::DVec3::ZERO, radius: 1e6 };
    let shapes = Shapes { shapes: vec![everywhere], falloff: 0.0 };
    let action = Action::Refine(Refine { shapes, finer: Finer::Factor(factor) });
    let step = Box::new(Step::new(action));
    Command::Edit(edit::EditCommand::Add { at: 0, step })
}

/// The largest part by which a difference of shears is not what it has to be.
fn off(state: &mut State, version: ComparedVersion, slope: f64) -> f64 {
    let scene = state.scene_of(version).unwrap().clone();
    let middle = 0.5 * (scene.sampled.bounds.min.y + scene.sampled.bounds.max.y);
    let height = |i: usize| scene.frame().to_model(scene.sampled.samples.positions[i]).y - middle;
    let values = state.field_of(version).unwrap().values.clone();
    assert_eq!(values.len(), scene.len());
    let off = |(i, x): (usize, &f32)| (f64::from(*x) - slope * height(i).abs()).abs();
    values.iter().enumerate().map(off).fold(0.0, f64::max)
}

fn failure(state: &mut State) -> Option<(Job, String, String)> {
    state.take_notices().into_iter().find_map(|notice| match notice {
        Notice::Failed(job, error) => Some((job, error.to_string(), error.hint().to_owned())),
        _ => None,
    })
}

#[test]
fn the_difference_of_two_shears_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = sheared(folder.path());
    done(&mut state, Command::Pin);
    assert_eq!(state.pinned(), Some("after \u{201c}change slope of warp\u{201d}"));
    let pinned = state.scene_of(ComparedVersion::Pinned).unwrap().clone();
    assert!(Arc::ptr_eq(&pinned, state.scene().unwrap()), "nothing is copied");
    done(&mut state, Command::Show(Overlay::Difference));
    assert!(state.field().unwrap().values.iter().all(|x| *x == 0.0));

    done(&mut state, set(0, "slope", 0.5));
    assert!(Arc::ptr_eq(&pinned, state.scene_of(ComparedVersion::Pinned).unwrap()));
    for version in [ComparedVersion::Now, ComparedVersion::Pinned] {
        assert!(off(&mut state, version, 0.3) < 1e-5, "{version:?}");
    }
    let range = state.field().unwrap().range;
    assert!(range[0] == 0.0 && (0.25..=0.3001).contains(&range[1]), "{range:?}");

    // Both versions have one scale.
    done(&mut state, Command::Show(Overlay::Displacement));
    let of = |state: &mut State, version| state.field_of(version).unwrap().clone();
    let [now, then] = [ComparedVersion::Now, ComparedVersion::Pinned].map(|version| of(&mut state, version));
    assert_eq!(now.range, then.range);
    let most = |values: &[f32]| values.iter().copied().fold(0.0, f32::max);
    assert!((most(&now.values) / most(&then.values) - 2.5).abs() < 1e-3);
    done(&mut state, set(0, "slope", 0.1));
    let range = of(&mut state, ComparedVersion::Now).range;
    assert!((range[1] - 0.2).abs() < 1e-3, "{range:?}: the pinned one moves farther");

    done(&mut state, Command::Show(Overlay::Difference));
    done(&mut state, Command::Unpin);
    assert!(state.pinned().is_none() && state.field().is_none() && state.overlay() == Overlay::None);
}

#[test]
fn samples_that_one_version_has_are_compared_with_its_reconstruction() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = sheared(folder.path());
    done(&mut state, Command::Pin);
    done(&mut state, Command::Show(Overlay::Difference));
    done(&mut state, set(0, "slope", 0.5));
    done(&mut state, refined(3.0));
    let [now, pinned] =
        [ComparedVersion::Now, ComparedVersion::Pinned].map(|v| state.scene_of(v).unwrap().len());
    assert!(now > pinned + 500);
    assert!(off(&mut state, ComparedVersion::Now, 0.3) < 1e-4, "a shear is carried over exactly");
    assert!(off(&mut state, ComparedVersion::Pinned, 0.3) < 1e-5);

    // With versions swapped, samples that only the pinned one has are shown as their neighbours are.
    done(&mut state, Command::SwapPinned);
    assert_eq!(
        [now, pinned],
        [ComparedVersion::Pinned, ComparedVersion::Now].map(|v| state.scene_of(v).unwrap().len())
    );
    assert!(off(&mut state, ComparedVersion::Now, 0.3) < 1e-5);
    assert!(off(&mut state, ComparedVersion::Pinned, 0.3) < 0.05);

    // Both are refined, each in its own way.
    done(&mut state, refined(1.5));
    assert!(off(&mut state, ComparedVersion::Now, 0.3) < 1e-4);
}

#[test]
fn a_refinement_alone_makes_no_difference() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = sheared(folder.path());
    done(&mut state, set(0, "operation", "twist"));
    done(&mut state, Command::Pin);
    done(&mut state, Command::Show(Overlay::Difference));
    done(
        &mut state,
        Command::Select { area: Area::All, combine: Default::default(), visible: false, goes_on: false },
    );
    done(&mut state, Command::RefineSelection { finer: Finer::Factor(2.0) });
    assert!(state.scene().unwrap().len() > state.scene_of(ComparedVersion::Pinned).unwrap().len());
    let most = state.field().unwrap().values.iter().copied().fold(0.0, f32::max);
    assert!(most < 1e-6, "{most}");
}

#[test]
fn versions_are_swapped_and_swapped_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = sheared(folder.path());
    assert!(state.apply(Command::SwapPinned).unwrap_err().to_string().contains("nothing is pinned"));
    done(&mut state, Command::Pin);
    done(&mut state, set(0, "slope", 0.5));
    let positions = |state: &State, version| state.scene_of(version).unwrap().positions.clone();
    let [now, pinned] =
        [ComparedVersion::Now, ComparedVersion::Pinned].map(|version| positions(&state, version));
    assert!(now != pinned);
    let check = |state: &State, swapped: bool| {
        let expected = if swapped { [&pinned, &now] } else { [&now, &pinned] };
        let found = [ComparedVersion::Now, ComparedVersion::Pinned].map(|version| positions(state, version));
        assert!(found.each_ref() == expected && state.is_settled());
        let slope = state.document().unwrap().steps()[0].step.deformation().unwrap().params["slope"].clone();
        assert_eq!(slope, toml::Value::Float(if swapped { 0.2 } else { 0.5 }));
    };
    done(&mut state, Command::SwapPinned);
    check(&state, true);
    assert_eq!(state.document().unwrap().can_undo(), Some("go on with the pinned version"));
    // Neither version is lost.
    done(&mut state, Command::Undo);
    check(&state, false);
    done(&mut state, Command::Redo);
    check(&state, true);
    done(&mut state, Command::SwapPinned);
    check(&state, false);
    assert_eq!(state.pinned(), Some("after \u{201c}change slope of warp\u{201d}"));
    // Undo of something else leaves what is pinned.
    done(&mut state, Command::Undo);
    check(&state, true);
    done(&mut state, Command::Undo);
    done(&mut state, Command::Undo);
    assert!(
        positions(&state, ComparedVersion::Pinned) == now
            || positions(&state, ComparedVersion::Pinned) == pinned
    );
}

#[test]
fn another_session_is_compared_with() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = sheared(folder.path());
    let session = folder.path().join("other.toml");
    done(&mut state, Command::Save { path: Some(session.clone()) });
    done(&mut state, set(0, "slope", 0.5));
    done(&mut state, Command::Show(Overlay::Difference));
    done(&mut state, Command::PinSession { path: session.clone() });
    assert_eq!(state.pinned(), Some("other.toml"));
    assert!(off(&mut state, ComparedVersion::Now, 0.3) < 1e-5);
    done(&mut state, Command::SwapPinned);
    assert!(state.chosen().is_some());
    done(&mut state, set(0, "slope", 0.6));
    assert!(off(&mut state, ComparedVersion::Now, 0.1) < 1e-5);

    // Other models, and steps that cannot be done.
    let pinned = state.scene_of(ComparedVersion::Pinned).unwrap().clone();
    let refuses = |state: &mut State, path: &Path, what: &str| {
        let error = state.apply(Command::PinSession { path: path.to_owned() }).unwrap_err();
        assert!(error.to_string().contains(what) && !error.hint().is_empty(), "{error}");
        assert!(Arc::ptr_eq(&pinned, state.scene_of(ComparedVersion::Pinned).unwrap()));
    };
    refuses(&mut state, &folder.path().join("nowhere.toml"), "nowhere.toml");
    let foreign = folder.path().join("foreign.toml");
    std::fs::write(&foreign, "[model]\npath = \"another.ply\"\n[[step]]\ndeform = \"warp\"\n").unwrap();
    refuses(&mut state, &foreign, "is an edit of another model");
    let missing = folder.path().join("missing.toml");
    std::fs::write(&missing, "[[step]]\ndeform = \"from-elsewhere\"\n").unwrap();
    done(&mut state, Command::PinSession { path: missing });
    let (job, what, hint) = failure(&mut state).unwrap();
    assert!(job == Job::Compare && what.contains("from-elsewhere") && !hint.is_empty(), "{what}");
    assert!(state.pinned().is_none() && state.field().is_none());
}

#[test]
fn the_pinned_version_gets_what_the_overlay_needs() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = sheared(folder.path());
    done(&mut state, set(0, "operation", "bend"));
    done(&mut state, Command::Pin);
    done(&mut state, set(0, "angle", 20.0));
    done(&mut state, Command::Show(Overlay::TransferError));
    let most = |state: &mut State, version| {
        state.field_of(version).unwrap().values.iter().copied().fold(0.0, f32::max)
    };
    let [now, then] =
        [ComparedVersion::Now, ComparedVersion::Pinned].map(|version| most(&mut state, version));
    assert!(then > 2.0 * now && now > 0.0, "{then} for 90 degrees, {now} for 20");
}

#[test]
fn a_recording_compares_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let mut other = sheared(folder.path());
    let session = folder.path().join("other.toml");
    done(&mut other, Command::Save { path: Some(session.clone()) });
    let commands = [
        Command::AddStep { plugin: "warp".into(), at: None },
        set(0, "operation", "bend"),
        // The pinned version is on its way.
        Command::Pin,
        Command::Show(Overlay::Difference),
        refined(2.0),
        set(1, "angle", 30.0),
    ];
    for ends in
        [vec![], vec![Command::SwapPinned, Command::Undo], vec![Command::PinSession { path: session }]]
    {
        let tape = Tape::default();
        let mut state = state(plugins());
        state.record(Some(Recorder::new(tape.clone())));
        done(&mut state, open(&folder.path().join("model.ply"), 1500));
        commands.iter().for_each(|command| state.apply(command.clone()).unwrap());
        state.settle(LONG).unwrap();
        ends.into_iter().for_each(|command| state.apply(command).unwrap());
        state.settle(LONG).unwrap();
        assert!(failure(&mut state).is_none());
        let commands = parse(std::str::from_utf8(&tape.0.lock().unwrap()).unwrap()).unwrap();
        let replayed = replay(&commands, &plugins()).unwrap();
        assert_eq!(replayed.pinned(), state.pinned());
        for version in [ComparedVersion::Now, ComparedVersion::Pinned] {
            let of = |state: &State| state.scene_of(version).unwrap().positions.clone();
            assert!(of(&replayed) == of(&state));
            assert_eq!(replayed.field_of(version).as_deref(), state.field_of(version).as_deref());
        }
        assert!(state.field().unwrap().values.iter().any(|x| *x > 0.0));
    }
}
