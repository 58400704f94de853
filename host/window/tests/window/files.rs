//! Files: dialogs that are not there, edits that are recovered or not, models that were moved.

use super::*;
use egui_kittest::kittest::Queryable;
use simod_session::edit::{self, Change};
use simod_viewer::state::kept_at;
use simod_window::dialogs::{DialogAnswer, DialogTurn, Purpose};

/// Goes on until something is so.
fn wait(harness: &mut Harness<'_, App>, what: &str, is_so: impl Fn(&Window) -> bool) {
    let end = Instant::now() + LONG;
    while !is_so(harness.state().window()) {
        assert!(Instant::now() < end, "it takes too long: {what}");
        harness.run_steps(1);
        std::thread::sleep(Duration::from_millis(10));
    }
    harness.run_steps(3);
}

fn click(harness: &mut Harness<'_, App>, label: &str) {
    harness.get_by_label(label).click();
    settle(harness);
}

fn chooser(
    harness: &mut Harness<'_, App>,
    answer: impl Fn(&Purpose, &DialogTurn) -> DialogAnswer + Send + Sync + 'static,
) {
    harness.state_mut().window_mut().chooser = Arc::new(move |purpose, _, turn| answer(purpose, turn));
}

/// A path is typed, however long it takes to find out that the system has no dialogs, and if the system
/// never says so.
#[test]
fn a_path_is_typed_where_the_system_has_no_dialogs() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    let slow = |_: &Purpose, _: &DialogTurn| {
        std::thread::sleep(Duration::from_millis(700));
        DialogAnswer::Absent("nobody is at the door".to_owned())
    };
    let never = |_: &Purpose, _: &DialogTurn| {
        std::thread::sleep(LONG);
        DialogAnswer::Closed
    };
    chooser(&mut harness, slow);
    harness.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::S);
    wait(&mut harness, "the prompt", |window| window.prompt.is_some());
    assert!(harness.query_by_label_contains("nobody is at the door").is_some());
    assert!(harness.query_by_label("Path of the file").is_some());
    // The path beside the model is there, and selected: what is typed takes its place.
    let typed = |harness: &Harness<'_, App>| harness.state().window().prompt.as_ref().map(|p| p.text.clone());
    assert!(typed(&harness).unwrap().ends_with("model-session.toml"));
    let nowhere = folder.path().join("nowhere").join("edit.toml");
    harness.event(egui::Event::Text(nowhere.display().to_string()));
    harness.run_steps(2);
    assert_eq!(typed(&harness).unwrap(), nowhere.display().to_string());
    harness.key_press(egui::Key::Enter);
    harness.run_steps(3);
    assert!(harness.query_by_label_contains("There is no folder").is_some());
    assert!(harness.state().window().prompt.is_some());
    let saved = folder.path().join("edit.toml");
    harness.state_mut().window_mut().prompt.as_mut().unwrap().text = saved.display().to_string();
    harness.run_steps(2);
    click(&mut harness, "OK");
    assert!(saved.exists() && harness.state().window().state().editor().unwrap().is_saved());

    chooser(&mut harness, never);
    harness.state_mut().window_mut().ask(Purpose::Open);
    wait(&mut harness, "the prompt", |window| window.prompt.is_some());
    // Tab goes on with what is there.
    harness.state_mut().window_mut().prompt.as_mut().unwrap().text =
        folder.path().join("mod").display().to_string();
    harness.run_steps(2);
    harness.key_press(egui::Key::Tab);
    harness.run_steps(3);
    assert!(typed(&harness).unwrap().ends_with("model.ply"), "{:?}", typed(&harness));
    // Tab completes a text that was typed right before it, in the time of one picture.
    harness.get_by_label("Path of the file").focus();
    harness.run_steps(2);
    harness.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::A);
    harness.event(egui::Event::Text(folder.path().join("edi").display().to_string()));
    harness.key_press(egui::Key::Tab);
    harness.run_steps(1);
    harness.run_steps(6);
    assert!(typed(&harness).unwrap().ends_with("edit.toml"), "{:?}", typed(&harness));
    click(&mut harness, "Cancel");
    assert!(harness.state().window().prompt.is_none());
}

/// A dialog that the user closed stays closed, however quickly.
#[test]
fn a_dialog_that_is_closed_asks_nothing_more() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    chooser(&mut harness, |_, turn| {
        assert!(turn.take());
        DialogAnswer::Closed
    });
    harness.state_mut().window_mut().ask(Purpose::Open);
    std::thread::sleep(Duration::from_millis(100));
    harness.run_steps(10);
    assert!(harness.state().window().prompt.is_none());
}

#[test]
fn only_what_is_neither_saved_nor_discarded_is_offered_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path());
    let hidden = || {
        let names = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name());
        names.filter(|name| name.to_string_lossy().starts_with('.')).count()
    };
    let commands = |harness: &mut Harness<'_, App>| {
        harness.state_mut().window_mut().ask_to_open(path.clone());
        settle(harness);
        harness.query_by_label("Recover the edit?").is_some()
    };
    let mut harness = window();
    assert!(!commands(&mut harness));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.state_mut().window_mut().keep();
    assert_eq!(hidden(), 1);

    // The program ends here. The next one offers it, with when it was made.
    let mut harness = window();
    assert!(commands(&mut harness));
    assert!(harness.query_by_label("Kept just now: 1 step").is_some());
    click(&mut harness, "Recover");
    assert_eq!(harness.state().window().steps().len(), 1);
    assert!(!harness.state().window().state().editor().unwrap().is_saved());

    // The first save takes it along: nothing is offered any more.
    let saved = folder.path().join("edit.toml");
    harness.state_mut().window_mut().answered(Purpose::Save, saved.clone());
    assert_eq!(hidden(), 0);
    let mut harness = window();
    assert!(!commands(&mut harness));

    // Discarded, it is gone for good; it is not kept once more by what comes.
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.state_mut().window_mut().keep();
    assert!(kept_at(&path).is_some());
    harness.state_mut().window_mut().ask_to_open(saved.clone());
    harness.run_steps(3);
    click(&mut harness, "Discard");
    assert_eq!(harness.state().window().steps().len(), 1);
    harness.state_mut().window_mut().keep();
    assert_eq!(hidden(), 0);
    // As it was saved, there is nothing to keep, though something was done and undone.
    let change = Change::SetParam { id: "angle".to_owned(), value: Some(10.0.into()) };
    done(&mut harness, Command::Edit(edit::EditCommand::Change { at: 0, change }));
    harness.state_mut().window_mut().keep();
    assert_eq!(hidden(), 1);
    done(&mut harness, Command::Undo);
    harness.state_mut().window_mut().keep();
    assert_eq!(hidden(), 0);

    // Discarded at the question, too.
    let mut harness = window();
    assert!(!commands(&mut harness));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.state_mut().window_mut().keep();
    let mut harness = window();
    assert!(commands(&mut harness));
    click(&mut harness, "Discard It");
    assert!(harness.state().window().steps().is_empty());
    assert_eq!(hidden(), 0);
}

#[test]
fn a_model_that_was_moved_is_located() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path());
    let session = folder.path().join("edit.toml");
    let mut harness = window();
    open(&mut harness, &path);
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    done(&mut harness, Command::Save { path: Some(session.clone()) });

    let moved = folder.path().join("elsewhere.ply");
    std::fs::rename(&path, &moved).unwrap();
    let mut harness = window();
    harness.state_mut().window_mut().ask_to_open(session.clone());
    settle(&mut harness);
    assert!(harness.query_by_label("Where is the model?").is_some());
    assert!(harness.state().window().settings.recent.is_empty(), "what failed is not offered again");
    let there = moved.clone();
    chooser(&mut harness, move |purpose, _| {
        assert!(matches!(purpose, Purpose::Locate { .. }));
        DialogAnswer::Chosen(there.clone())
    });
    harness.get_by_label("Locate\u{2026}").click();
    wait(&mut harness, "the model", |window| window.state().scene().is_some());
    settle(&mut harness);
    let state = harness.state().window().state();
    assert_eq!(state.document().unwrap().steps().len(), 1);
    let editor = state.editor().unwrap();
    assert_eq!(editor.model().unwrap(), moved);
    assert!(!editor.is_saved(), "its file has the former place");
    assert_eq!(harness.state().window().settings.recent.len(), 1);

    // A file that is no model is told of, and not remembered.
    let bad = folder.path().join("bad.ply");
    std::fs::write(&bad, "no model").unwrap();
    let mut harness = window();
    harness.state_mut().window_mut().ask_to_open(bad);
    settle(&mut harness);
    assert!(harness.state().window().settings.recent.is_empty());
    assert_eq!(harness.state().window().toasts.texts().count(), 1);
    // The message leaves with its cause.
    harness.state_mut().window_mut().ask_to_open(moved);
    settle(&mut harness);
    assert_eq!(harness.state().window().toasts.texts().count(), 0);
}
