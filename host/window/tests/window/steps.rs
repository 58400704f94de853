//! Steps: named, blended, alone, copied; refinements told otherwise; strokes as a list.

use super::*;

use egui_kittest::kittest::Queryable;
use glam::DVec3;
use simod_core::refinement::Finer;
use simod_session::edit::{self, Change};
use simod_session::step::{Action, Deformation, Refine, Step, Stroke};
use simod_session::{RegionShape, Shapes};
use simod_viewer::State;

fn state<'a>(harness: &'a Harness<'_, App>) -> &'a State {
    harness.state().window().state()
}

fn add(harness: &mut Harness<'_, App>, plugin: &str) {
    done(harness, Command::AddStep { plugin: plugin.to_owned(), at: None });
}

fn change(harness: &mut Harness<'_, App>, at: usize, change: Change) {
    done(harness, Command::Edit(edit::EditCommand::Change { at, change }));
}

fn step(harness: &Harness<'_, App>, at: usize) -> Step {
    (*harness.state().window().steps()[at].step).clone()
}

fn press(harness: &mut Harness<'_, App>, modifiers: egui::Modifiers, key: egui::Key) {
    harness.key_press_modifiers(modifiers, key);
    settle(harness);
}

#[test]
fn a_step_is_named_blended_looked_at_alone_and_copied() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    add(&mut harness, "warp");
    change(
        &mut harness,
        0,
        Change::SetParam { id: "angle".to_owned(), value: Some(toml::Value::Float(60.0)) },
    );
    add(&mut harness, "warp");

    // A name of its own, typed.
    press(&mut harness, egui::Modifiers::NONE, egui::Key::F2);
    harness.get_by_label("Name of step 2");
    harness.event(egui::Event::Text("Lean back".to_owned()));
    harness.run_steps(2);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Enter);
    assert_eq!(step(&harness, 1).title.as_deref(), Some("Lean back"));
    assert!(harness.query_by_label("Enable Lean back").is_some());
    // Escape leaves it as it was.
    press(&mut harness, egui::Modifiers::NONE, egui::Key::F2);
    harness.event(egui::Event::Text("nonsense".to_owned()));
    harness.run_steps(2);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Escape);
    assert_eq!(step(&harness, 1).title.as_deref(), Some("Lean back"));

    // Less of the first one, by keys; the slider shows it, and its button takes it back.
    done(&mut harness, Command::Choose { step: Some(0) });
    press(&mut harness, egui::Modifiers::SHIFT, egui::Key::S);
    let whole = state(&harness).scene().unwrap().positions.clone();
    for _ in 0..5 {
        press(&mut harness, egui::Modifiers::SHIFT, egui::Key::ArrowDown);
    }
    assert_eq!(step(&harness, 0).deformation().unwrap().amount, 0.5);
    let scene = state(&harness).scene().unwrap().clone();
    let rest = &scene.sampled.samples.positions;
    for (p, (w, q)) in rest.iter().zip(whole.iter().zip(scene.positions.iter())) {
        assert!(p.midpoint(*w).distance(*q) < 1e-5, "{p} went to {q}, not halfway to {w}");
    }
    press(&mut harness, egui::Modifiers::SHIFT, egui::Key::S);
    harness.get_by_label("Reset Amount").click();
    settle(&mut harness);
    assert_eq!(step(&harness, 0).deformation().unwrap().amount, 1.0);

    // Alone, and with the other one again.
    let on = |harness: &Harness<'_, App>| [0, 1].map(|at| step(harness, at).enabled);
    press(&mut harness, egui::Modifiers::SHIFT, egui::Key::S);
    assert_eq!(on(&harness), [true, false]);
    harness.get_by_label("More on step 1").click();
    harness.run_steps(2);
    harness.get_by_label("With the Others Again").click();
    settle(&mut harness);
    assert_eq!(on(&harness), [true, true]);

    // By the clipboard into another edit.
    done(&mut harness, Command::Choose { step: Some(1) });
    change(&mut harness, 1, Change::SetAmount(0.25));
    harness.event(egui::Event::Copy);
    harness.step();
    let commands = harness.output().platform_output.commands.clone();
    let text = commands.into_iter().find_map(|command| match command {
        egui::OutputCommand::CopyText(text) => Some(text),
        _ => None,
    });
    let text = text.expect("a text was copied");
    let mut other = window();
    open(&mut other, &model(folder.path()));
    other.event(egui::Event::Paste(text));
    settle(&mut other);
    let pasted = step(&other, 0);
    assert_eq!((pasted.title.as_deref(), pasted.deformation().unwrap().amount), (Some("Lean back"), 0.25));
    assert_eq!(state(&other).chosen(), Some(0));
    // A text that is no step is told of, and nothing changes.
    other.event(egui::Event::Paste("Dear all".to_owned()));
    settle(&mut other);
    assert_eq!(other.state().window().steps().len(), 1);
    assert!(other.query_by_label_contains("the clipboard, line 1").is_some());
}

#[test]
fn steps_are_grouped_folded_switched_and_moved_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    for at in 0..3 {
        add(&mut harness, "warp");
        change(&mut harness, at, Change::SetTitle(Some(format!("Turn {at}"))));
    }
    let groups = |harness: &Harness<'_, App>| {
        let group = |at: usize| step(harness, at).group.unwrap_or_default();
        (0..harness.state().window().steps().len()).map(group).collect::<Vec<_>>()
    };
    let titles = |harness: &Harness<'_, App>| [0, 1, 2].map(|at| step(harness, at).title.unwrap());
    let click = |harness: &mut Harness<'_, App>, name: &str| {
        harness.get_by_label(name).click();
        settle(harness);
    };
    done(&mut harness, Command::Choose { step: Some(1) });
    press(&mut harness, egui::Modifiers::COMMAND, egui::Key::G);
    assert_eq!(groups(&harness), ["Group", "Group", ""]);

    // A name of its own; Escape leaves it.
    for (key, text, name) in [
        (egui::Key::Enter, "Arms", "Arms"),
        (egui::Key::Escape, "nonsense", "Arms"),
        (egui::Key::Enter, " ", "Arms"),
    ] {
        harness.get_by_label_contains("More on the group").click();
        harness.run_steps(2);
        harness.get_by_label("Rename\u{2026}").click();
        harness.run_steps(2);
        harness.get_by_label_contains("Name of the group");
        press(&mut harness, egui::Modifiers::COMMAND, egui::Key::A);
        harness.event(egui::Event::Text(text.to_owned()));
        harness.run_steps(2);
        press(&mut harness, egui::Modifiers::NONE, key);
        assert_eq!(groups(&harness), [name, name, ""], "{text:?}");
    }

    // Folded, its steps are not in the list; they are switched together.
    assert!(harness.query_by_label("Enable Turn 0").is_some());
    click(&mut harness, "Fold Arms");
    assert!(harness.query_by_label("Enable Turn 0").is_none());
    assert!(harness.query_by_label("Enable Turn 2").is_some());
    click(&mut harness, "Enable Arms");
    assert_eq!([0, 1, 2].map(|at| step(&harness, at).enabled), [false, false, true]);
    click(&mut harness, "Enable Arms");
    click(&mut harness, "More on the group Arms");
    click(&mut harness, "Move Down");
    assert_eq!(titles(&harness), ["Turn 2", "Turn 0", "Turn 1"]);
    click(&mut harness, "Unfold Arms");

    // By the clipboard behind itself, it is a group of its own.
    click(&mut harness, "More on the group Arms");
    harness.get_by_label("Copy").click();
    harness.step();
    let commands = harness.output().platform_output.commands.clone();
    let text = commands.into_iter().find_map(|command| match command {
        egui::OutputCommand::CopyText(text) => Some(text),
        _ => None,
    });
    done(&mut harness, Command::Choose { step: Some(2) });
    harness.event(egui::Event::Paste(text.expect("a text was copied")));
    settle(&mut harness);
    assert_eq!(groups(&harness), ["", "Arms", "Arms", "Arms 2", "Arms 2"]);

    click(&mut harness, "More on step 3");
    click(&mut harness, "Take Out of Its Group");
    assert_eq!(groups(&harness), ["", "Arms", "", "Arms 2", "Arms 2"]);
    click(&mut harness, "More on the group Arms 2");
    click(&mut harness, "Remove All");
    click(&mut harness, "More on the group Arms");
    click(&mut harness, "Ungroup");
    assert_eq!(groups(&harness), ["", "", ""]);
}

#[test]
fn a_refinement_is_told_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    let shapes = vec![RegionShape::Sphere { center: DVec3::Y, radius: 0.4 }];
    let refine = Refine { shapes: Shapes { shapes, falloff: 0.0 }, finer: Finer::Factor(1.5) };
    let step = Box::new(Step::new(Action::Refine(refine)));
    done(&mut harness, Command::Edit(edit::EditCommand::Add { at: 0, step }));
    done(&mut harness, Command::Choose { step: Some(0) });
    let samples = |harness: &Harness<'_, App>| state(harness).scene().unwrap().len();
    let finer = |harness: &Harness<'_, App>| match &harness.state().window().steps()[0].step.action {
        Action::Refine(refine) => refine.finer,
        Action::Deform(_) => panic!("a refinement"),
    };
    let before = samples(&harness);
    // The number is dragged; it counts once the hand rests.
    let from = harness.get_by_label("Factor of the refinement").rect().center();
    super::compare::drag(&mut harness, from, from + egui::vec2(40.0, 0.0));
    settle(&mut harness);
    let Finer::Factor(factor) = finer(&harness) else { panic!("{:?}", finer(&harness)) };
    assert!(factor > 2.0 && samples(&harness) > before, "{factor}");
    done(&mut harness, Command::Undo);
    assert_eq!((finer(&harness), samples(&harness)), (Finer::Factor(1.5), before), "a drag is one change");
    // Another way to tell it.
    harness.get_by_label("Measure of the refinement").click();
    harness.run_steps(2);
    harness.get_by_label("Number of samples more").click();
    settle(&mut harness);
    assert!(matches!(finer(&harness), Finer::Samples(_)), "{:?}", finer(&harness));
    harness.get_by_label("Samples of the refinement");
    harness.get_by_label("Measure of the refinement").click();
    harness.run_steps(2);
    harness.get_by_label("Down to an error").click();
    settle(&mut harness);
    // A fraction by the control, a length beside it.
    let Finer::Error(error) = finer(&harness) else { panic!("{:?}", finer(&harness)) };
    let length = error * state(&harness).scene().unwrap().sampled.bounds.diagonal();
    let told = format!("Here {length:.2e} in the model's unit.");
    harness.get_by_label_contains(&told);
}

#[test]
fn strokes_are_a_list() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    add(&mut harness, "displacement-paint");
    let top = state(&harness).scene().unwrap().sampled.bounds.max;
    for strength in [1.0, 0.5] {
        let points = vec![DVec3::new(0.0, 0.8 * top.y, top.z)];
        let stroke =
            Stroke { radius: 0.2, strength, points, pressures: Vec::new(), params: toml::Table::new() };
        change(&mut harness, 0, Change::AddStroke(Arc::new(stroke)));
    }
    harness.set_size(egui::vec2(1440.0, 2000.0));
    harness.run_steps(4);
    let strokes = |harness: &Harness<'_, App>| {
        let Action::Deform(Deformation { strokes, .. }) = step(harness, 0).action else {
            panic!("a deformation")
        };
        strokes
    };
    assert!(harness.query_by_label("2 Brush Strokes").is_some());
    // Wider, by the hand.
    let from = harness.get_by_label("Radius of stroke 2").rect().center();
    super::compare::drag(&mut harness, from, from + egui::vec2(30.0, 0.0));
    settle(&mut harness);
    let radii: Vec<f64> = strokes(&harness).iter().map(|stroke| stroke.radius).collect();
    assert!(radii[0] == 0.2 && radii[1] > 0.2, "{radii:?}");
    // By another brush than the other one.
    let brush = plugins()
        .get("displacement-paint")
        .unwrap()
        .params()
        .iter()
        .find(|d| d.kind == simod_plugin_api::ParamKind::CHOICE)
        .unwrap()
        .clone();
    harness.get_by_label(&format!("{} of stroke 2", brush.name)).click();
    harness.run_steps(2);
    let other = brush.choices.iter().find(|choice| choice.id != brush.default_text).unwrap();
    harness.get_all_by_label(&other.label).last().unwrap().click();
    settle(&mut harness);
    let own = |i: usize| strokes(&harness)[i].params.get(brush.id.as_str()).cloned();
    assert_eq!([own(0), own(1)], [None, Some(other.id.to_string().into())]);
    // The first one goes, and comes back.
    harness.get_by_label("Remove stroke 1").click();
    settle(&mut harness);
    assert_eq!(strokes(&harness).iter().map(|stroke| stroke.strength).collect::<Vec<_>>(), [0.5]);
    done(&mut harness, Command::Undo);
    assert_eq!(strokes(&harness).len(), 2);
}
