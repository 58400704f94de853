//! Failures that leave the edit as it was.

use super::helpers::common::{copy, load, load_isolated};
use super::{LONG, done, model, open, plugins, state};
use simod_core::refinement::Finer;
use simod_generate::Shape;
use simod_model::ErrorKind;
use simod_session::edit::{self, Change, Status};
use simod_viewer::engine::Job;
use simod_viewer::state::{Notice, recoverable};
use simod_viewer::{Command, State};
use std::sync::Arc;
use std::time::{Duration, Instant};

fn failure(state: &mut State) -> (Job, simod_model::Error) {
    let failed = state.take_notices().into_iter().find_map(|notice| match notice {
        Notice::Failed(job, error) => Some((job, error)),
        _ => None,
    });
    failed.expect("a failure")
}

fn opened(folder: &std::path::Path) -> State {
    let mut state = state(plugins());
    done(&mut state, open(&model(folder, Shape::Amphora, 5000), 500));
    state
}

#[test]
fn what_cannot_be_opened_leaves_what_is_open() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = opened(folder.path());
    let scene = state.scene().unwrap().clone();
    let bad = folder.path().join("bad.ply");
    std::fs::write(&bad, b"ply, or so").unwrap();
    for path in
        [bad, folder.path().join("nowhere.ply"), folder.path().join("nowhere.toml"), folder.path().into()]
    {
        done(&mut state, open(&path, 100));
        let (job, error) = failure(&mut state);
        assert!(job == Job::Open && !error.hint().is_empty(), "{error}");
        assert!(Arc::ptr_eq(state.scene().unwrap(), &scene));
    }
    assert!(state.apply(Command::AddStep { plugin: "rfb".into(), at: None }).is_err());
    assert!(state.apply(Command::Save { path: None }).unwrap_err().to_string().contains("no file yet"));
}

/// An opening that failed counts as going on until its failure was taken.
#[test]
fn a_failure_that_was_not_taken_yet_is_no_model() {
    let (tell, told) = std::sync::mpsc::channel();
    let tell = std::sync::Mutex::new(tell);
    // Nobody receives the events any more in the end.
    let mut state = State::new(plugins(), Arc::new(move || _ = tell.lock().unwrap().send(())));
    let folder = tempfile::tempdir().unwrap();
    state.apply(open(&folder.path().join("nowhere.ply"), 100)).unwrap();
    told.recv_timeout(LONG).unwrap();
    assert!(!state.is_settled(), "it failed, and nobody was told");
    state.settle(LONG).unwrap();
    assert!(state.is_settled());
    assert_eq!(failure(&mut state).0, Job::Open);
}

#[test]
fn steps_of_plugins_that_are_missing_stay() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path(), Shape::Amphora, 5000);
    let session = folder.path().join("edit.toml");
    let text = "[model]\npath = \"model.ply\"\n[sampling]\nsamples = 500\n[[step]]\ndeform = \"warp\"\n\
        params = { operation = \"twist\", angle = 90 }\n[[step]]\ndeform = \"from-elsewhere\"\n[[step]]\ndeform = \"warp\"\n";
    std::fs::write(&session, text).unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&session, 1));
    let scene = state.scene().unwrap().clone();
    assert!(*scene.positions != *scene.sampled.samples.positions, "the first step is done");
    let [first, second, third] = &scene.statuses[..] else { panic!("three steps") };
    assert!(matches!(first.1, Status::Done(_)) && matches!(third.1, Status::Waiting));
    let Status::Failed(error) = &second.1 else { panic!("it is missing") };
    assert!(error.to_string().contains("there is no plugin `from-elsewhere`"), "{error}");
    assert_eq!(scene.before.len(), 2);
    // The edit cannot be written as a model, but can be saved.
    let output = folder.path().join("edited.ply");
    done(&mut state, Command::Write { output: output.clone() });
    assert!(failure(&mut state).0 == Job::Write && !output.exists());
    done(&mut state, Command::Save { path: None });
    assert!(std::fs::read_to_string(&session).unwrap().contains("from-elsewhere"));
    // Switched off, it is out of the way.
    done(&mut state, Command::Edit(edit::EditCommand::Change { at: 1, change: Change::Enable(false) }));
    done(&mut state, Command::Write { output: output.clone() });
    assert!(output.exists());
}

#[test]
fn a_file_that_cannot_be_written_leaves_the_edit() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = opened(folder.path());
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    let steps = state.document().unwrap().steps().clone();
    // A folder that is not there, and the model itself.
    let bad = [folder.path().join("nowhere/edited.ply"), folder.path().join("model.ply")];
    for output in bad {
        done(&mut state, Command::Write { output });
        let (job, error) = failure(&mut state);
        assert!(job == Job::Write && !error.hint().is_empty(), "{error}");
        assert!(Arc::ptr_eq(state.document().unwrap().steps(), &steps));
    }
    let nowhere = folder.path().join("nowhere/edit.toml");
    assert!(state.apply(Command::Save { path: Some(nowhere) }).is_err());
    assert!(!state.editor().unwrap().is_saved() && Arc::ptr_eq(state.document().unwrap().steps(), &steps));
}

#[test]
fn what_was_not_saved_is_kept_and_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = opened(folder.path());
    let path = state.editor().unwrap().model().unwrap().to_owned();
    assert!(recoverable(&path).unwrap().is_none());
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    state.autosave().unwrap();
    drop(state);
    assert_eq!(recoverable(&path).unwrap().unwrap().steps.len(), 1);
    let mut state = super::state(plugins());
    let Command::Open { path, sampling, .. } = open(&path, 500) else { panic!("it opens") };
    done(&mut state, Command::Open { path, sampling, recover: true });
    assert_eq!(state.document().unwrap().steps().len(), 1);
}

#[test]
fn what_runs_in_the_background_can_be_cancelled() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path(), Shape::Amphora, 300_000);
    let mut state = state(plugins());
    state.apply(open(&path, 2000)).unwrap();
    state.apply(Command::Cancel { job: Job::Open }).unwrap();
    state.settle(LONG).unwrap();
    assert!(state.scene().is_none());
    done(&mut state, open(&path, 2000));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    let angle = Change::SetParam { id: "angle".into(), value: Some(90.into()) };
    done(&mut state, Command::Edit(edit::EditCommand::Change { at: 0, change: angle }));
    let output = folder.path().join("edited.ply");
    state.apply(Command::Write { output: output.clone() }).unwrap();
    state.apply(Command::Cancel { job: Job::Write }).unwrap();
    state.settle(LONG).unwrap();
    assert!(!output.exists());
    done(&mut state, Command::Write { output: output.clone() });
    assert!(output.exists());
    assert!(state.take_notices().iter().any(|n| matches!(n, Notice::Written(..))));
}

/// A plugin that writes to its input is found before the damage comes into a result.
#[test]
fn a_plugin_that_writes_to_its_input_is_found_while_something_is_dragged() {
    let folder = tempfile::tempdir().unwrap();
    let libraries = folder.path().join("plugins");
    std::fs::create_dir(&libraries).unwrap();
    copy("misbehaving", &libraries, "misbehaving");
    let mut state = state(Arc::new(load(&libraries)));
    done(&mut state, open(&model(folder.path(), Shape::Amphora, 5000), 500));
    done(&mut state, Command::AddStep { plugin: "misbehaving".into(), at: None });
    let how = Change::SetParam { id: "how".into(), value: Some("writes-to-input".into()) };
    done(&mut state, Command::Drag(edit::EditCommand::Change { at: 0, change: how }));
    let scene = state.scene().unwrap();
    assert!(scene.is_draft());
    let [(_, Status::Failed(error))] = &scene.statuses[..] else { panic!("{:?}", scene.statuses) };
    assert!(error.to_string().contains("changed the samples"), "{error}");
}

#[test]
fn a_refinement_that_adds_nothing_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    // Each vertex is a sample.
    done(&mut state, open(&model(folder.path(), Shape::Amphora, 1000), 4000));
    let all = Command::Select {
        area: simod_viewer::command::Area::All,
        combine: Default::default(),
        visible: false,
        goes_on: false,
    };
    let told = |state: &mut State| {
        let notes = state.take_notices().into_iter().filter_map(|notice| match notice {
            Notice::Note(text) => Some(text),
            _ => None,
        });
        notes.filter(|text| text.starts_with("nothing is refined")).collect::<Vec<_>>()
    };
    done(&mut state, all);
    let before = state.scene().unwrap().len();
    done(&mut state, Command::RefineSelection { finer: Finer::Factor(4.0) });
    assert_eq!(state.scene().unwrap().len(), before);
    assert_eq!(told(&mut state), ["nothing is refined: all vertices there are samples already"]);
    done(&mut state, Command::Undo);
    done(&mut state, Command::RefineSelection { finer: Finer::Error(0.5) });
    assert_eq!(told(&mut state), ["nothing is refined: no cluster there has a larger error"]);
}

#[cfg(unix)]
#[test]
fn a_plugin_that_hangs_is_stopped_and_the_edit_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let libraries = folder.path().join("plugins");
    std::fs::create_dir(&libraries).unwrap();
    copy("misbehaving", &libraries, "misbehaving");
    copy("simod_warp", &libraries, "warp");
    let mut state = state(Arc::new(load_isolated(&libraries)));
    done(&mut state, open(&model(folder.path(), Shape::Amphora, 5000), 500));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    state.apply(Command::AddStep { plugin: "misbehaving".into(), at: None }).unwrap();
    state.settle(LONG).unwrap();
    let hang = Change::SetParam { id: "how".into(), value: Some("endless-loop".into()) };
    state.apply(Command::Edit(edit::EditCommand::Change { at: 1, change: hang })).unwrap();
    let start = Instant::now();
    let deforming = |state: &State| {
        state.activity(Job::Evaluate).is_some_and(|activity| activity.stage == "deforming")
            && state.busy_step() == Some(1)
    };
    while !deforming(&state) && start.elapsed() < LONG {
        std::thread::sleep(Duration::from_millis(5));
        state.poll();
    }
    assert!(deforming(&state));
    // The window is there all the time.
    state.apply(Command::Cancel { job: Job::Evaluate }).unwrap();
    state.settle(LONG).unwrap();
    let (job, error) = failure(&mut state);
    assert_eq!((job, error.kind()), (Job::Evaluate, ErrorKind::Cancelled));
    assert_eq!(state.document().unwrap().steps().len(), 2, "nothing is lost");
    done(&mut state, Command::Undo);
    let scene = state.scene().unwrap();
    assert!(
        scene.statuses.iter().all(|(_, status)| matches!(status, Status::Done(_))),
        "{:?}",
        scene.statuses
    );
}
