//! Every button once, in whatever order they stand: whatever a click does, it is no mistake of the program.

use super::*;
use egui_kittest::Node;
use egui_kittest::kittest::{NodeT, Queryable};
use simod_session::step::Role;
use simod_viewer::command::Area;
use simod_window::dialogs::DialogAnswer;
use std::collections::BTreeSet;

/// Buttons that take the edit away, or all the time that there is; these have tests of their own.
const LEFT_OUT: [&str; 4] = ["Quit", "Render", "Save", "Open the Example"];

fn label(node: &Node<'_>) -> Option<String> {
    let node = node.accesskit_node();
    node.label().filter(|label| !label.is_empty() && !node.is_disabled())
}

fn labels(harness: &Harness<'_, App>) -> BTreeSet<String> {
    let labels = harness.query_all_by_role(egui::accesskit::Role::Button).filter_map(|node| label(&node));
    labels.filter(|label| !LEFT_OUT.iter().any(|left| label.starts_with(left))).collect()
}

/// Clicks a button, if it is there.
fn click(harness: &mut Harness<'_, App>, name: &str) {
    let all = harness.query_all_by_role(egui::accesskit::Role::Button);
    if let Some(node) = all.into_iter().find(|node| label(node).as_deref() == Some(name)) {
        node.click();
    }
    settle(harness);
    let told: Vec<String> = harness.state().window().toasts.texts().map(str::to_owned).collect();
    assert!(!told.iter().any(|text| text.contains("mistake in the program")), "{name}: {told:?}");
}

/// Closes what a click has opened, and what came of that; and chooses the step again.
fn close(harness: &mut Harness<'_, App>, chosen: usize) {
    for _ in 0..2 {
        harness.key_press(egui::Key::Escape);
        settle(harness);
    }
    if harness.state().window().state().chosen() != Some(chosen) {
        harness.state_mut().window_mut().apply(Command::Choose { step: Some(chosen) });
        settle(harness);
    }
}

fn edit(harness: &mut Harness<'_, App>, path: &Path) {
    open(harness, path);
    for plugin in ["warp", "lattice", "skinning", "displacement-paint"] {
        done(harness, Command::AddStep { plugin: plugin.to_owned(), at: None });
    }
    let all =
        Command::Select { area: Area::All, combine: Default::default(), visible: false, goes_on: false };
    done(harness, all);
    done(harness, Command::AddStep { plugin: "rbf".to_owned(), at: None });
    done(harness, Command::MakeRegion { step: 4, role: Role::Handle, falloff: 0.0, replaces: None });
}

#[test]
fn every_button_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path());
    let mut clicked = BTreeSet::new();
    for chosen in 0..5 {
        let mut harness = window();
        harness.set_size(egui::vec2(1440.0, 1700.0));
        // The system has no dialogs, so that paths are asked for in the window, and nobody answers.
        harness.state_mut().window_mut().chooser =
            Arc::new(|_, _, _| DialogAnswer::Absent("there are none".to_owned()));
        edit(&mut harness, &path);
        done(&mut harness, Command::Choose { step: Some(chosen) });
        while let Some(name) = labels(&harness).into_iter().find(|name| !clicked.contains(name)) {
            let before = labels(&harness);
            click(&mut harness, &name);
            clicked.insert(name.clone());
            assert!(clicked.len() < 600, "buttons have other names each time: {clicked:?}");
            // Entries of the menu that the click has opened.
            let entries: Vec<String> = labels(&harness).difference(&before).cloned().collect();
            for entry in entries {
                if clicked.insert(entry.clone()) {
                    click(&mut harness, &entry);
                    close(&mut harness, chosen);
                    click(&mut harness, &name);
                }
            }
            close(&mut harness, chosen);
        }
    }
    for expected in ["+ Add Step", "Make Fixed", "Frame All Home"] {
        assert!(clicked.contains(expected), "{expected}: {clicked:?}");
    }
    assert!(clicked.len() > 120, "{clicked:?}");
    if std::env::var_os("SIMOD_PICTURES").is_some() {
        use std::io::Write;
        let _ = writeln!(std::io::stderr(), "{} buttons: {clicked:?}", clicked.len());
    }
}
