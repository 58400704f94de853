//! Handles moved by keys, several at a time.

use super::*;

use egui_kittest::kittest::Queryable;
use glam::DVec3;
use simod_session::step::HandleMove;
use simod_viewer::command::CameraMove;
use simod_window::Tool;
use std::collections::BTreeSet;

/// A window with a lattice, whose tool moves; and the ids of its points.
fn lattice(folder: &Path) -> (Harness<'static, App>, Vec<String>) {
    let mut harness = window();
    open(&mut harness, &model(folder));
    done(&mut harness, Command::AddStep { plugin: "lattice".to_owned(), at: None });
    harness.state_mut().window_mut().tools.take(Tool::Move);
    let handles = harness.state().window().state().handles(0);
    (harness, handles.into_iter().map(|(desc, _)| desc.id.to_string()).collect())
}

fn take(harness: &mut Harness<'_, App>, ids: &[String]) {
    let window = harness.state_mut().window_mut();
    let (_, step, ..) = window.chosen().unwrap();
    window.tools.take_handles(step, ids.first().cloned(), ids.iter().cloned().collect());
    harness.run_steps(2);
}

fn in_hand(harness: &Harness<'_, App>) -> BTreeSet<String> {
    let window = harness.state().window();
    window.tools.handles(window.chosen().unwrap().1)
}

fn moved(harness: &Harness<'_, App>) -> Vec<HandleMove> {
    harness.state().window().chosen().unwrap().2.handles
}

fn point_at(harness: &mut Harness<'_, App>, at: egui::Pos2) {
    harness.event(egui::Event::PointerMoved(at));
    settle(harness);
}

fn press(harness: &mut Harness<'_, App>, key: egui::Key) {
    harness.key_press(key);
    settle(harness);
}

fn typed(harness: &mut Harness<'_, App>, text: &str) {
    for character in text.chars() {
        harness.event(egui::Event::Text(character.to_string()));
        settle(harness);
    }
}

#[test]
fn handles_are_moved_turned_and_scaled_by_keys_and_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (mut harness, ids) = lattice(folder.path());
    let middle = harness.get_by_label("Model").rect().center();
    point_at(&mut harness, middle);
    take(&mut harness, &[ids[0].clone(), ids[5].clone()]);
    assert_eq!(in_hand(&harness).len(), 2);

    // Along y, by a number.
    press(&mut harness, egui::Key::G);
    press(&mut harness, egui::Key::Y);
    typed(&mut harness, "0.30");
    press(&mut harness, egui::Key::Enter);
    let motions = moved(&harness);
    assert_eq!(motions.len(), 2);
    assert!(motions.iter().all(|m| m.motion.translate.abs_diff_eq(DVec3::Y * 0.3, 1e-9)), "{motions:?}");
    let before = harness.state().window().state().scene().unwrap().clone();
    assert!(before.positions.iter().zip(&before.sampled.samples.positions).any(|(p, q)| p != q));

    // Turned about z: they go round their middle, as points that do not turn themselves.
    let places = |harness: &Harness<'_, App>| -> Vec<DVec3> {
        let handles = harness.state().window().state().handles(0);
        let in_hand = in_hand(harness);
        handles.iter().filter(|(d, _)| in_hand.contains(d.id.as_str())).map(|(_, h)| h.position()).collect()
    };
    let from = places(&harness);
    press(&mut harness, egui::Key::R);
    press(&mut harness, egui::Key::Z);
    typed(&mut harness, "180");
    press(&mut harness, egui::Key::Enter);
    let (to, about) = (places(&harness), from[0].midpoint(from[1]));
    for (p, q) in from.iter().zip(&to) {
        let turned = about + (*p - about) * DVec3::new(-1.0, -1.0, 1.0);
        assert!(turned.distance(*q) < 1e-9, "{p} went to {q}");
    }
    assert!(moved(&harness).iter().all(|m| m.motion.degrees == 0.0));

    // Each is one change; what is taken back by Escape is none.
    let kept = moved(&harness);
    press(&mut harness, egui::Key::S);
    typed(&mut harness, "3");
    assert_ne!(moved(&harness), kept);
    press(&mut harness, egui::Key::Escape);
    assert_eq!(moved(&harness), kept);
    for _ in 0..2 {
        done(&mut harness, Command::Undo);
    }
    assert_eq!(moved(&harness), []);
}

#[test]
fn a_motion_follows_the_pointer_until_a_click() {
    let folder = tempfile::tempdir().unwrap();
    let (mut harness, ids) = lattice(folder.path());
    let middle = harness.get_by_label("Model").rect().center();
    point_at(&mut harness, middle);
    take(&mut harness, &ids[..1]);
    press(&mut harness, egui::Key::G);
    point_at(&mut harness, middle + egui::vec2(60.0, 0.0));
    let first = moved(&harness);
    point_at(&mut harness, middle + egui::vec2(120.0, 0.0));
    let second = moved(&harness);
    let [first, second] = [&first, &second].map(|moves| moves[0].motion.translate);
    assert!(
        (second - 2.0 * first).length() < 1e-6 * first.length() && first.length() > 0.0,
        "{first} {second}"
    );
    let camera = *harness.state().window().state().camera();
    for pressed in [true, false] {
        let button = egui::Event::PointerButton {
            pos: middle + egui::vec2(120.0, 0.0),
            button: egui::PointerButton::Primary,
            pressed,
            modifiers: egui::Modifiers::NONE,
        };
        harness.event(button);
        settle(&mut harness);
    }
    // The motion is over: the pointer goes on without it.
    point_at(&mut harness, middle);
    assert_eq!(moved(&harness)[0].motion.translate, second);
    assert_eq!(in_hand(&harness).len(), 1, "the click took nothing else");
    assert_eq!(*harness.state().window().state().camera(), camera);
}

#[test]
fn a_box_takes_handles_and_others_go_along() {
    let folder = tempfile::tempdir().unwrap();
    let (mut harness, ids) = lattice(folder.path());
    let model = harness.get_by_label("Model").rect();
    // All points of the lattice are seen, and no control lies over one of them.
    let at = harness.state().window().state().size().map(|s| 0.5 * s);
    let zoom = CameraMove::Zoom { factor: 0.5, at };
    done(&mut harness, Command::Camera(zoom));
    press(&mut harness, egui::Key::B);
    harness.get_by_label("Handles").click();
    settle(&mut harness);
    super::compare::drag(
        &mut harness,
        model.right_bottom() - egui::vec2(10.0, 10.0),
        model.left_top() + egui::vec2(10.0, 10.0),
    );
    assert_eq!(in_hand(&harness), ids.iter().cloned().collect());
    assert!(harness.state().window().state().selection().is_empty(), "no samples");

    // One of them, with those around it.
    take(&mut harness, &ids[..1]);
    harness.state_mut().window_mut().tools.reach = 0.4;
    point_at(&mut harness, model.center());
    press(&mut harness, egui::Key::G);
    press(&mut harness, egui::Key::X);
    typed(&mut harness, "-1");
    press(&mut harness, egui::Key::Enter);
    let all: Vec<f64> = moved(&harness).iter().map(|m| m.motion.translate.x).collect();
    assert!(all.len() > 1 && all.len() < ids.len(), "{all:?}");
    assert_eq!(all.iter().filter(|x| (**x + 1.0).abs() < 1e-9).count(), 1, "{all:?}");
    assert!(all.iter().all(|x| (-1.0 - 1e-9..0.0).contains(x)), "{all:?}");
}
