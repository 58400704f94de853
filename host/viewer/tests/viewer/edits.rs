//! A whole edit by commands, as a window would do it.

use super::{done, model, open, pixel, plugins, state};
use glam::{DVec3, Vec3};
use simod_core::reconstruction::Reconstruction;
use simod_core::refinement::Finer;
use simod_generate::Shape;
use simod_model::progress::Silent;
use simod_plugin_api::Effort;
use simod_session::edit::{self, Change};
use simod_session::step::Role;
use simod_session::{Motion, Run, SessionFile};
use simod_viewer::camera::Standard;
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::record::{Recorder, parse};
use simod_viewer::selection::Combine;
use simod_viewer::{Command, State, replay};
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Recording, to be looked at later.
#[derive(Clone, Default)]
pub(super) struct Tape(pub Arc<Mutex<Vec<u8>>>);

impl Write for Tape {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn select(area: Area) -> Command {
    Command::Select { area, combine: Combine::Replace, visible: false, goes_on: false }
}

fn moved(y: f64) -> edit::EditCommand {
    let motion = Motion { translate: DVec3::new(0.1, y, 0.0), degrees: 20.0 * y, ..Motion::default() };
    edit::EditCommand::Change { at: 0, change: Change::MoveRegion { region: 1, motion } }
}

/// The commands of an edit; `after` is called after each of them.
fn edit_amphora(state: &mut State, folder: &Path, mut after: impl FnMut(&mut State)) {
    let mut apply = |state: &mut State, command: Command| {
        state.apply(command.clone()).unwrap_or_else(|e| panic!("{command:?}: {e}"));
        after(state);
    };
    apply(state, Command::Camera(CameraMove::Look(Standard::Front)));
    // Looking closer changes nothing.
    apply(state, Command::Preview { what: simod_viewer::Previewed::Seen });
    apply(state, Command::AddStep { plugin: "rbf".into(), at: None });
    // All below, by a box; all above, by a lasso.
    let [left, low] = pixel(state, DVec3::new(-1.5, 0.5, 0.0));
    let [right, high] = pixel(state, DVec3::new(1.5, 1.6, 0.0));
    apply(state, select(Area::Box { from: [left, low], to: [right, 800.0] }));
    let fixed = Command::MakeRegion { step: 0, role: Role::Fixed, falloff: 0.0, replaces: None };
    apply(state, fixed);
    let path = vec![[left, high], [right, high], [right, 0.0], [left, 0.0]];
    apply(state, select(Area::Lasso { path }));
    apply(state, Command::MakeRegion { step: 0, role: Role::Handle, falloff: 0.1, replaces: None });
    for y in [0.1, 0.2, 0.3] {
        apply(state, Command::Drag(moved(y)));
    }
    apply(state, Command::Rest);
    apply(state, Command::RefineSelection { finer: Finer::Factor(3.0) });
    apply(state, Command::AddStep { plugin: "displacement-paint".into(), at: None });
    let begin = Command::BeginStroke { step: 2, radius: 0.3, strength: 1.0, params: toml::Table::new() };
    apply(state, begin);
    for x in [-0.2, 0.0, 0.2] {
        apply(state, Command::StrokePoint { at: DVec3::new(x, 1.0, 0.5), pressure: Some(0.5) });
    }
    apply(state, Command::EndStroke);
    apply(state, Command::Undo);
    apply(state, Command::Undo);
    apply(state, Command::Redo);
    apply(state, Command::Redo);
    apply(state, Command::Save { path: Some(folder.join("edit.toml")) });
    apply(state, Command::Write { output: folder.join("edited.ply") });
}

#[test]
fn an_edit_is_what_a_run_of_its_session_is_and_what_its_recording_is() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path(), Shape::Amphora, 20_000);
    // Once waiting each time, and once as quickly as commands come.
    for waits in [true, false] {
        let tape = Tape::default();
        let mut state = state(plugins());
        state.record(Some(Recorder::new(tape.clone())));
        done(&mut state, open(&model, 1500));
        edit_amphora(&mut state, folder.path(), |state| {
            if waits {
                state.settle(super::LONG).unwrap();
            }
        });
        state.settle(super::LONG).unwrap();
        let told = state.take_notices();
        let failed = |n: &simod_viewer::state::Notice| matches!(n, simod_viewer::state::Notice::Failed(..));
        assert!(!told.iter().any(failed), "{told:?}");
        assert!(state.is_settled() && state.editor().unwrap().is_saved());
        let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
        let (session, edited) = (read("edit.toml"), read("edited.ply"));
        assert!(edited != read("model.ply"), "nothing was edited");

        let saved = SessionFile::load(&folder.path().join("edit.toml")).unwrap();
        assert_eq!(saved.steps.len(), 3);
        let run = folder.path().join("run.ply");
        Run::execute(&saved, &plugins(), &Reconstruction::default(), false, &run, &Silent).unwrap();
        assert!(edited == read("run.ply"), "a run writes other bytes");

        let commands = parse(std::str::from_utf8(&tape.0.lock().unwrap()).unwrap()).unwrap();
        assert!(commands.len() > 20);
        let replayed = replay(&commands, &plugins()).unwrap();
        assert_eq!(replayed.selection().count(), state.selection().count());
        assert!(session == read("edit.toml") && edited == read("edited.ply"), "a replay writes other bytes");
    }
}

#[test]
fn a_drag_is_shown_as_drafts_and_undone_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), Shape::Cylinder, 5000), 500));
    done(&mut state, Command::AddStep { plugin: "rbf".into(), at: None });
    let half = |sign: f64| {
        let shape = simod_session::RegionShape::HalfSpace {
            point: DVec3::Y * (1.0 + 0.5 * sign),
            normal: DVec3::Y * sign,
        };
        simod_session::Shapes { shapes: vec![shape], falloff: 0.0 }
    };
    let region =
        |role, sign| simod_session::step::Region { role, shapes: half(sign), motion: Motion::default() };
    let regions = vec![region(Role::Fixed, -1.0), region(Role::Handle, 1.0)];
    let set = edit::EditCommand::Change { at: 0, change: Change::SetRegions(regions) };
    done(&mut state, Command::Edit(set));
    assert!(state.handle_pivot(0, 1).unwrap().y > 1.5);
    let highest = |state: &State| state.scene().unwrap().bounds()[1].y;
    let rest = highest(&state);
    let mut last = rest;
    for y in [0.1, 0.2, 0.3, 0.4] {
        done(&mut state, Command::Drag(moved(y)));
        assert!(!state.is_settled() && state.scene().unwrap().effort == Effort::DRAFT);
        assert!(highest(&state) > last);
        last = highest(&state);
    }
    done(&mut state, Command::Rest);
    assert!(state.is_settled());
    assert_eq!(state.document().unwrap().can_undo(), Some("move a handle of rbf"));
    done(&mut state, Command::Undo);
    assert_eq!(highest(&state), rest);
    done(&mut state, Command::Redo);
    assert!(highest(&state) > rest);
}

#[test]
fn handles_of_a_lattice_are_where_it_is_dragged_to() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), Shape::Bar, 5000), 500));
    done(&mut state, Command::AddStep { plugin: "lattice".into(), at: None });
    let handles = state.handles(0);
    assert!(handles.len() >= 8);
    let (desc, placed) = handles.last().unwrap();
    let to = glam::DAffine3 { translation: placed.position() + DVec3::X, ..placed.matrix() };
    let change = Change::MoveHandle { id: desc.id.to_string(), motion: placed.motion_to(to).unwrap() };
    done(&mut state, Command::Drag(edit::EditCommand::Change { at: 0, change }));
    done(&mut state, Command::Rest);
    let moved = state.handles(0).pop().unwrap().1;
    assert!(moved.position().abs_diff_eq(placed.position() + DVec3::X, 1e-9));
    let scene = state.scene().unwrap();
    assert!(*scene.positions != *scene.sampled.samples.positions);
}

#[test]
fn samples_emerge_while_a_model_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path(), Shape::Amphora, 200_000);
    // Each news of progress takes a while, so that none is missed here.
    let mut state =
        State::new(plugins(), Arc::new(|| std::thread::sleep(std::time::Duration::from_millis(5))));
    state.apply(open(&path, 5000)).unwrap();
    let (mut counts, mut inside) = (Vec::new(), true);
    while state.is_opening() {
        state.emerged(|emerged| {
            let [low, high] = emerged.bounds.map(|corner| corner.as_vec3());
            let seen = emerged.samples();
            inside &= seen.positions.iter().all(|p| p.cmpge(low - 1e-3).all() && p.cmple(high + 1e-3).all());
            assert_eq!([seen.normals.len(), seen.spacing.len()], [seen.positions.len(); 2]);
            counts.push(seen.positions.len());
        });
        state.poll();
    }
    assert!(inside && counts.is_sorted() && counts.iter().any(|n| *n >= 5000), "{counts:?}");
    assert!(state.scene().is_some() && state.emerged(|_| ()).is_none());
}

#[test]
fn a_drag_below_a_refinement_rests_where_a_run_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path(), Shape::Amphora, 20_000);
    let angle = |degrees: f64| {
        let change = Change::SetParam { id: "angle".into(), value: Some(degrees.into()) };
        edit::EditCommand::Change { at: 0, change }
    };
    let mut state = state(plugins());
    done(&mut state, open(&path, 1000));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    done(&mut state, Command::Edit(angle(30.0)));
    let at = pixel(&state, DVec3::new(0.0, 1.0, 0.0));
    done(&mut state, select(Area::Brush { path: vec![at], radius: 60.0 }));
    done(&mut state, Command::RefineSelection { finer: Finer::Factor(4.0) });
    let refined = state.scene().unwrap().len();
    done(&mut state, Command::Drag(angle(90.0)));
    assert_eq!((state.scene().unwrap().len(), state.scene().unwrap().effort), (refined, Effort::DRAFT));
    done(&mut state, Command::Rest);
    assert_eq!(state.scene().unwrap().effort, Effort::FULL);

    let mut again = self::state(plugins());
    done(&mut again, open(&path, 1000));
    for (at, entry) in state.document().unwrap().steps().iter().enumerate() {
        done(&mut again, Command::Edit(edit::EditCommand::Add { at, step: Box::new((*entry.step).clone()) }));
    }
    assert_eq!(state.scene().unwrap().positions, again.scene().unwrap().positions);
}

#[test]
fn normals_turn_as_the_surface_does() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), Shape::Bar, 40_000), 4000));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    let change = Change::SetParam { id: "angle".into(), value: Some(120.0.into()) };
    done(&mut state, Command::Edit(edit::EditCommand::Change { at: 0, change }));
    let scene = state.scene().unwrap();
    // Normals are as those that are fitted with care, but for some at the bar's edges.
    let fitted = simod_core::reconstruction::deformed_normals(&scene.sampled.samples, &scene.positions);
    let median = |normals: &[Vec3]| {
        let mut cosines: Vec<f32> = normals.iter().zip(&fitted).map(|(a, b)| a.dot(*b)).collect();
        cosines.sort_unstable_by(f32::total_cmp);
        [cosines[cosines.len() / 10], cosines[cosines.len() / 2]]
    };
    let ([low, turned], [_, unmoved]) = (median(scene.normals()), median(scene.sampled.samples.normals()));
    assert!(low > 0.9 && turned > 0.995 && unmoved < 0.95, "{low}, {turned}, {unmoved}");
}

/// While something is dragged, the shading is computed where it is drawn; and is the same there as if all
/// of it had been computed. At rest the surface is where the steps put it to the last digit.
#[test]
fn a_part_of_a_draft_lies_as_all_of_it_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path(), Shape::Amphora, 40_000);
    let angle = |degrees: f64| {
        let change = Change::SetParam { id: "angle".into(), value: Some(degrees.into()) };
        edit::EditCommand::Change { at: 0, change }
    };
    let mut state = state(plugins());
    done(&mut state, open(&path, 4000));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    let some: std::sync::Arc<[u32]> = (0..1300).map(|k| 3 * k).collect();
    let mut kept = None;
    let mut drafts = Vec::new();
    // Before anybody has asked for all of a draft, and after that, when they are found beforehand.
    for degrees in [40.0, 80.0, 120.0] {
        done(&mut state, Command::Drag(angle(degrees)));
        let scene = state.scene().unwrap().clone();
        assert!(scene.is_draft());
        let part = scene.shading_of(&some, &mut kept);
        for (k, i) in some.iter().map(|i| *i as usize).enumerate() {
            assert_eq!((part.normals[k], part.axes[k]), (scene.normals()[i], scene.axes()[i]), "{i}");
        }
        drafts.push(scene);
    }
    done(&mut state, Command::Rest);
    let rest = state.scene().unwrap().clone();
    assert!(!rest.is_draft());
    let ways = rest.positions.iter().zip(drafts[2].positions.iter()).map(|(p, q)| p.distance(*q));
    assert!(ways.fold(0.0, f32::max) < 3e-6);

    let mut again = self::state(plugins());
    done(&mut again, open(&path, 4000));
    done(&mut again, Command::AddStep { plugin: "warp".into(), at: None });
    done(&mut again, Command::Edit(angle(120.0)));
    let scene = again.scene().unwrap();
    assert!(scene.positions == rest.positions && scene.normals() == rest.normals());
}

#[test]
fn a_step_goes_by_a_text_to_another_edit() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path(), Shape::Bar, 3000);
    let mut first = state(plugins());
    done(&mut first, open(&path, 300));
    done(&mut first, Command::AddStep { plugin: "warp".into(), at: None });
    let edits = [
        Change::SetParam { id: "angle".into(), value: Some(80.0.into()) },
        Change::SetAmount(0.5),
        Change::SetTitle(Some("Halfway".to_owned())),
    ];
    for change in edits {
        done(&mut first, Command::Edit(edit::EditCommand::Change { at: 0, change }));
    }
    let text = first.copied(0).unwrap();
    assert!(first.copied(1).is_err());

    let mut other = state(plugins());
    done(&mut other, open(&path, 300));
    done(&mut other, Command::AddStep { plugin: "lattice".into(), at: None });
    done(&mut other, Command::AddStep { plugin: "lattice".into(), at: None });
    done(&mut other, Command::Choose { step: Some(0) });
    done(&mut other, Command::Paste { text: text.clone(), at: None });
    let names = |state: &State| -> Vec<String> {
        let steps = state.document().unwrap().steps().clone();
        steps.iter().map(|e| e.step.title.clone().unwrap_or_else(|| e.step.name().to_owned())).collect()
    };
    assert_eq!(names(&other), ["lattice", "Halfway", "lattice"], "behind the chosen one");
    assert_eq!(other.chosen(), Some(1));
    let positions = |state: &State| state.scene().unwrap().positions.to_vec();
    assert!(positions(&other) == positions(&first), "the others move nothing");
    // All of it is one change, that can be undone; and a text that makes no sense changes nothing.
    done(&mut other, Command::Undo);
    assert_eq!(names(&other), ["lattice", "lattice"]);
    for (text, at) in [(text.as_str(), Some(9)), ("nonsense", None), ("", None)] {
        assert!(other.apply(Command::Paste { text: text.to_owned(), at }).is_err());
    }
    assert_eq!(names(&other), ["lattice", "lattice"]);
}
