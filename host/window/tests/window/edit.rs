//! A whole edit by names, and its outcome without the window.

use super::compare::click_at;
use super::*;

use egui_kittest::kittest::Queryable;
use glam::DVec3;
use simod_session::Motion;
use simod_session::edit::{self, Change};
use simod_session::step::{Region, Role};
use simod_viewer::command::Area;
use simod_window::Tool;

fn select(harness: &mut Harness<'_, App>, is_in: impl Fn(DVec3) -> bool) {
    let scene = harness.state().window().state().scene().unwrap().clone();
    let marks: Vec<bool> = scene.positions.iter().map(|p| is_in(scene.frame().to_model(*p))).collect();
    let runs = simod_viewer::Selection::from_marks(marks).runs();
    done(
        harness,
        Command::Select {
            area: Area::Runs(runs),
            combine: Default::default(),
            visible: false,
            goes_on: false,
        },
    );
}

fn click(harness: &mut Harness<'_, App>, label: &str) {
    harness.get_by_label(label).click();
    settle(harness);
}

fn steps(harness: &Harness<'_, App>) -> usize {
    harness.state().window().steps().len()
}

#[test]
fn an_edit_by_names_gives_the_bytes_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));

    click(&mut harness, "+ Add Step");
    let rbf = plugins().get("rbf").unwrap().name().to_owned();
    harness.get_by_label_contains(&rbf).click();
    settle(&mut harness);
    assert_eq!(steps(&harness), 1);

    select(&mut harness, |p| p.y < 0.3);
    click(&mut harness, "Make Fixed");
    select(&mut harness, |p| p.y > 1.7);
    click(&mut harness, "Make Handle");
    assert_eq!(harness.state().window().tools.tool, Tool::Move);
    let chosen = harness.state().window().chosen().unwrap();
    assert_eq!(chosen.2.regions.len(), 2);

    // Dragged, as by the gizmo: all of it is one change.
    let pivot = chosen.2.regions[1].motion.pivot;
    for i in 1..=5 {
        let translate = DVec3::new(0.1 * f64::from(i), 0.0, 0.0);
        let motion = Motion { translate, pivot, ..Motion::default() };
        let change = Change::MoveRegion { region: 1, motion };
        // A draft is shown of it, until it rests.
        let change = edit::EditCommand::Change { at: 0, change };
        assert!(harness.state_mut().window_mut().apply(Command::Drag(change)));
        harness.run_steps(2);
    }
    done(&mut harness, Command::Rest);
    let moved = |harness: &Harness<'_, App>| {
        let scene = harness.state().window().state().scene().unwrap().clone();
        scene.positions.iter().zip(&scene.sampled.samples.positions).any(|(p, q)| p.distance(*q) > 0.05)
    };
    assert!(moved(&harness));

    // Undone and done again by keys.
    harness.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Z);
    settle(&mut harness);
    assert!(!moved(&harness));
    harness.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Y);
    settle(&mut harness);
    assert!(moved(&harness));

    // Finer around the bend.
    let before = harness.state().window().state().scene().unwrap().len();
    select(&mut harness, |p| (0.8..1.2).contains(&p.y));
    click(&mut harness, "Refine");
    assert_eq!(steps(&harness), 2);
    assert!(harness.state().window().state().scene().unwrap().len() > before);

    let (session, here, there) =
        (folder.path().join("session.toml"), folder.path().join("here.ply"), folder.path().join("there.ply"));
    done(&mut harness, Command::Save { path: Some(session.clone()) });
    done(&mut harness, Command::Write { output: here.clone() });
    harness.run_steps(3);
    assert!(harness.query_by_label("The deformed model is written").is_some());
    click(&mut harness, "Close");

    // Opened again, it is the same.
    let positions = harness.state().window().state().scene().unwrap().positions.clone();
    done(&mut harness, Command::Open { path: session.clone(), sampling: Default::default(), recover: false });
    assert_eq!(steps(&harness), 2);
    assert_eq!(*harness.state().window().state().scene().unwrap().positions, *positions);

    // Beside the plugins that were built.
    let mut run = std::process::Command::new(simod_tests::program());
    run.arg("run").arg(&session).arg("--output").arg(&there).env_remove("SIMOD_PLUGIN_PATH");
    let output = run.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(std::fs::read(here).unwrap() == std::fs::read(there).unwrap(), "other bytes than `simod run`");
}

#[test]
fn a_step_is_dragged_to_another_place() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    let names = ["warp", "rbf", "lattice"];
    for plugin in names {
        done(&mut harness, Command::AddStep { plugin: plugin.to_owned(), at: None });
    }
    let order = |harness: &Harness<'_, App>| -> Vec<String> {
        let steps = harness.state().window().steps();
        steps.iter().map(|entry| entry.step.name().to_owned()).collect()
    };
    let place = |harness: &Harness<'_, App>, id: &str| {
        let name = plugins().get(id).unwrap().name().to_owned();
        harness.get_by_label(&format!("Enable {name}")).rect().center() + egui::vec2(60.0, 0.0)
    };
    let above = egui::vec2(0.0, -6.0);
    let (from, to) = (place(&harness, "lattice"), place(&harness, "warp") + above);
    super::compare::drag(&mut harness, from, to);
    assert_eq!(order(&harness), ["lattice", "warp", "rbf"]);
    // The lattice's row has a message, so that it is higher.
    let (from, to) = (place(&harness, "lattice"), place(&harness, "rbf") - 4.0 * above);
    super::compare::drag(&mut harness, from, to);
    assert_eq!(order(&harness), names);
    // Beside itself, it stays.
    let (from, to) = (place(&harness, "rbf"), place(&harness, "warp") - above);
    super::compare::drag(&mut harness, from, to);
    assert_eq!(order(&harness), names);
    done(&mut harness, Command::Undo);
    assert_eq!(order(&harness), ["lattice", "warp", "rbf"], "a drag is one change");
}

#[test]
fn an_error_is_told_with_its_hint_and_changes_nothing() {
    let mut harness = window();
    let window = harness.state_mut().window_mut();
    assert!(!window.apply(Command::Undo));
    harness.run_steps(2);
    assert!(harness.query_by_label("no model is open").is_some());
    assert!(harness.query_by_label("open one").is_some());
}

#[test]
fn the_palette_finds_and_does() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    harness.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::P);
    harness.run_steps(2);
    harness.event(egui::Event::Text("select all".to_owned()));
    harness.run_steps(2);
    harness.key_press(egui::Key::Enter);
    settle(&mut harness);
    let state = harness.state().window().state();
    assert_eq!(state.selection().count(), state.scene().unwrap().len());
    assert!(harness.state().window().palette.is_none());
}

#[test]
fn what_is_not_saved_is_not_lost_without_a_question() {
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path());
    let mut harness = window();
    open(&mut harness, &path);
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.state_mut().window_mut().ask_to_open(path);
    harness.run_steps(3);
    assert!(harness.query_by_label("Save the edit?").is_some());
    assert_eq!(steps(&harness), 1);
    click(&mut harness, "Cancel");
    assert_eq!(steps(&harness), 1);
}

#[test]
fn a_plugin_that_is_not_there_is_named_at_its_step() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path());
    let session = folder.path().join("session.toml");
    let text =
        "[model]\npath = \"model.ply\"\n[sampling]\nsamples = 1500\n[[step]]\ndeform = \"nobody-has-it\"\n";
    std::fs::write(&session, text).unwrap();
    let mut harness = window();
    open(&mut harness, &session);
    done(&mut harness, Command::Choose { step: Some(0) });
    assert!(harness.query_by_label_contains("there is no plugin `nobody-has-it`").is_some());
}

#[test]
fn a_click_that_is_quicker_than_a_picture_selects() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    harness.state_mut().window_mut().tools.take(Tool::Connected);
    let at = harness.get_by_label("Model").rect().center();
    let button = |pressed| egui::Event::PointerButton {
        pos: at,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    };
    harness.event(egui::Event::PointerMoved(at));
    harness.run_steps(2);
    harness.input_mut().events.extend([button(true), button(false)]);
    settle(&mut harness);
    let state = harness.state().window().state();
    assert_eq!(state.selection().count(), state.scene().unwrap().len());
}

/// A handle with its surroundings fixed is made at once, and undone at once; a band that is too wide is
/// told of.
#[test]
fn a_handle_is_made_with_what_is_around_it_fixed() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "laplacian".to_owned(), at: None });
    let scene = harness.state().window().state().scene().unwrap().clone();
    let [min, max] = scene.bounds();
    let top = |p: &glam::Vec3| p.y > max.y - 0.2 * (max.y - min.y);
    let marks: Vec<bool> = scene.positions.iter().map(top).collect();
    let area = Area::Runs(simod_viewer::Selection::from_marks(marks.clone()).runs());
    let select = Command::Select { area, combine: Default::default(), visible: false, goes_on: false };
    done(&mut harness, select.clone());
    harness.run_steps(3);
    assert!(harness.query_by_label("Band that bends").is_some());
    harness.get_by_label("Make Handle, Fix Around").click();
    settle(&mut harness);
    let regions = || harness.state().window().chosen().unwrap().2.regions;
    let made = regions();
    let roles: Vec<Role> = made.iter().map(|region| region.role).collect();
    assert_eq!(roles, [Role::Handle, Role::Fixed]);
    // Fixed samples are those beyond the band, along the surface, and all of those.
    let diagonal = (scene.sampled.bounds.max - scene.sampled.bounds.min).length();
    let height = |p: &glam::Vec3| scene.frame().to_model(*p).y;
    let lowest = scene.positions.iter().filter(|p| top(p)).map(height).fold(f64::INFINITY, f64::min);
    for p in scene.positions.iter().filter(|p| !top(p)) {
        let below = lowest - height(p);
        let fixed = made[1].shapes.weight(scene.frame().to_model(*p)) > 0.5;
        // Samples are this far apart, and ways along them are not straight.
        assert!(!fixed || below > 0.1 * diagonal * 0.7, "{below} of {diagonal}");
        assert!(fixed || below < 0.1 * diagonal * 1.3, "{below} of {diagonal}");
    }
    assert!(harness.state().window().state().selection().is_empty());
    done(&mut harness, Command::Undo);
    assert!(harness.state().window().chosen().unwrap().2.regions.is_empty());
    // Nothing is beyond so wide a band.
    done(&mut harness, select);
    assert!(!harness.state_mut().window_mut().apply(Command::MakeHandle { step: 0, band: 100.0 }));
    let texts: Vec<String> = harness.state().window().toasts.texts().map(str::to_owned).collect();
    assert!(texts.iter().any(|text| text.contains("nothing is left to be fixed")), "{texts:?}");
}

/// The advice of a plugin about its parameters is a button.
#[test]
fn what_a_plugin_says_to_do_is_a_button() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "rbf".to_owned(), at: None });
    // A handle that turns beside what stays, by far too few centres.
    let sphere =
        |y: f64, radius: f64| simod_session::RegionShape::Sphere { center: glam::DVec3::Y * y, radius };
    let region = |role, shape, motion| Region {
        role,
        shapes: simod_session::Shapes { shapes: vec![shape], falloff: 0.0 },
        motion,
    };
    let turn = simod_session::Motion {
        axis: glam::DVec3::Y,
        degrees: 170.0,
        pivot: Some(glam::DVec3::Y),
        ..Default::default()
    };
    let regions = vec![
        region(Role::Handle, sphere(1.6, 0.5), turn),
        region(Role::Fixed, sphere(0.5, 0.5), Default::default()),
    ];
    for change in [
        Change::SetRegions(regions),
        Change::SetParam { id: "max-centers".into(), value: Some(8.into()) },
        Change::SetParam { id: "tolerance".into(), value: Some(1e-6.into()) },
    ] {
        done(&mut harness, Command::Edit(simod_session::edit::EditCommand::Change { at: 0, change }));
    }
    harness.run_steps(3);
    let told = harness.query_by_label_contains("motion is met to").is_some();
    assert!(told, "{:?}", harness.state().window().state().scene().unwrap().statuses);
    harness.get_by_label("Raise Most centres to 32").click();
    settle(&mut harness);
    let params = harness.state().window().chosen().unwrap().2.params;
    assert_eq!(params.get("max-centers"), Some(&32.into()));
}

/// Looks at the model from the front, with a skeleton's step and the tool that places its joints.
fn take_joints(harness: &mut Harness<'_, App>) {
    for step in [
        simod_viewer::command::CameraMove::Look(simod_viewer::camera::Standard::Front),
        simod_viewer::command::CameraMove::FrameAll,
    ] {
        done(harness, Command::Camera(step));
    }
    done(harness, Command::AddStep { plugin: "skinning".to_owned(), at: None });
    harness.state_mut().window_mut().tools.take(Tool::Joint);
    harness.run_steps(3);
}

/// A limb's joint does not turn the body: a pin in it holds it, until a bone is there; others are placed by
/// clicks.
#[test]
fn a_limb_turns_without_the_body() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cactus.ply");
    let options = ModelOptions { shape: Shape::Cactus, vertices: 30_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    let mut harness = window();
    open(&mut harness, &path);
    take_joints(&mut harness);
    let pixel = |harness: &Harness<'_, App>, p: glam::Vec3| {
        let state = harness.state().window().state();
        let at = state.camera().project(p.as_dvec3(), state.size()).unwrap().0;
        harness.get_by_label("Model").rect().min + egui::vec2(at.x as f32, at.y as f32)
    };
    let joints = |harness: &Harness<'_, App>| harness.state().window().chosen().unwrap().2.joints;
    let ids = |harness: &Harness<'_, App>| joints(harness).into_iter().map(|j| j.id).collect::<Vec<_>>();
    let positions = harness.state().window().state().scene().unwrap().positions.clone();
    let highest = |side: f32| {
        // The top of an arm: the highest of what is far to a side.
        let far = positions.iter().map(|p| side * p.x).fold(0.0, f32::max);
        let aside = positions.iter().filter(|p| side * p.x > 0.8 * far);
        *aside.max_by(|a, b| a.y.total_cmp(&b.y)).unwrap()
    };
    let hand = highest(1.0) - glam::Vec3::Y * 0.03;
    let at = pixel(&harness, hand);
    click_at(&mut harness, at);
    let held = ids(&harness);
    let is_of_body = |id: &String| id.starts_with("pin-body-");
    assert!(held[0] == "joint-1" && held.len() > 2 && held[1..].iter().all(is_of_body), "{held:?}");
    let stem = joints(&harness)[1].at;
    assert!(joints(&harness)[1..].iter().all(|pin| pin.at.x.abs() < 0.1), "all in the stem");

    // Turned, the hand goes, and the stem stays.
    let motion = simod_session::Motion { axis: glam::DVec3::Z, degrees: 90.0, ..Default::default() };
    let turn = Change::MoveHandle { id: "joint-1".to_owned(), motion };
    done(&mut harness, Command::Edit(edit::EditCommand::Change { at: 0, change: turn }));
    let scene = harness.state().window().state().scene().unwrap().clone();
    let moved = |p: &glam::Vec3, q: &glam::Vec3| p.distance(*q);
    let ways = || scene.sampled.samples.positions.iter().zip(scene.positions.iter());
    let near = |p: &glam::Vec3, far: f32| p.distance(hand) < far;
    let of_hand = ways().filter(|(p, _)| near(p, 0.1)).map(|(p, q)| moved(p, q)).fold(0.0, f32::max);
    let pin = scene.frame().to_local(stem);
    // The side of the stem on which the arm is not.
    let is_stem = |p: &glam::Vec3| p.distance(pin) < 0.3 && p.x < pin.x;
    let of_stem = ways().filter(|(p, _)| is_stem(p)).map(|(p, q)| moved(p, q)).fold(0.0, f32::max);
    assert!(of_hand > 10.0 * of_stem, "{of_hand} {of_stem}");
    done(&mut harness, Command::Undo);

    // A pin by hand, which is taken by no click and no box.
    harness.get_by_label("Place Pins").click();
    harness.run_steps(2);
    let at = pixel(&harness, highest(-1.0));
    click_at(&mut harness, at - egui::vec2(0.0, -8.0));
    assert_eq!(ids(&harness), [held, vec!["pin-1".to_owned()]].concat());
    harness.state_mut().window_mut().tools.take(Tool::Move);
    harness.state_mut().window_mut().tools.target = None;
    click_at(&mut harness, at - egui::vec2(0.0, -8.0));
    assert_eq!(harness.state().window().tools.target, None);
    // Chosen in the list, it can be seen and removed, but not moved.
    harness.set_size(egui::vec2(1440.0, 1700.0));
    harness.run_steps(3);
    harness.get_by_label("pin-1").click();
    harness.run_steps(3);
    assert!(harness.state().window().tools.target.is_some());
    assert!(harness.query_by_label("Handle pin-1").is_none());
    harness.key_press(egui::Key::G);
    harness.run_steps(3);
    assert!(harness.state().window().tools.gesture.transforming.is_none());
    harness.get_by_label("joint-1").click();
    harness.run_steps(3);
    assert!(harness.query_by_label("Handle joint-1").is_some());
    harness.state_mut().window_mut().tools.target = None;
    harness.set_size(egui::vec2(1440.0, 900.0));
    harness.run_steps(3);

    // A chain along the stem has the body turn: nothing holds it any more.
    harness.state_mut().window_mut().tools.take(Tool::Joint);
    harness.state_mut().window_mut().tools.places_pins = false;
    harness.run_steps(2);
    let ends = [0.1, 0.9].map(|part| {
        let [low, high] = scene.bounds();
        glam::Vec3::new(pin.x, low.y + part * (high.y - low.y), pin.z)
    });
    let [from, to] = ends.map(|p| pixel(&harness, p));
    drag(&mut harness, from, to);
    settle(&mut harness);
    let all = ids(&harness);
    assert!(!all.iter().any(is_of_body) && all.contains(&"pin-1".to_owned()), "{all:?}");
}

/// Bones that an end bends are drawn where the body is, though their own handles have not moved.
#[test]
fn bones_that_an_end_bends_are_where_the_body_is() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    take_joints(&mut harness);
    harness.get_by_label("Hold the Body").click();
    harness.run_steps(2);
    let middle = harness.get_by_label("Model").rect().center();
    let [from, to] = [200.0, -200.0].map(|y| middle + egui::vec2(0.0, y));
    drag(&mut harness, from, to);
    settle(&mut harness);
    let posed =
        |harness: &Harness<'_, App>| harness.state().window().state().posed(0).map(<[glam::DVec3]>::to_vec);
    assert_eq!(posed(&harness), None, "nothing has moved");
    let joints = harness.state().window().chosen().unwrap().2.joints;
    let end = joints.last().unwrap().clone();
    let size = joints[0].at.distance(end.at);
    // The end's target is at the end, as long as nobody has moved it, however the bones turn.
    let turn = simod_session::Motion { axis: glam::DVec3::Z, degrees: 40.0, ..Default::default() };
    let turned = Change::MoveHandle { id: joints[1].id.clone(), motion: turn };
    done(&mut harness, Command::Edit(edit::EditCommand::Change { at: 0, change: turned }));
    let place = |harness: &Harness<'_, App>, id: &str| {
        let handles = harness.state().window().state().handles(0);
        handles.into_iter().find(|(desc, _)| desc.id == id).unwrap().1.position()
    };
    let reach = format!("{}/reach", end.id);
    assert!(place(&harness, &end.id).distance(end.at) > 0.2 * size);
    assert!(place(&harness, &reach).distance(place(&harness, &end.id)) < 1e-9 * size);
    let motion = simod_session::Motion { translate: glam::DVec3::X * (0.1 * size), ..Default::default() };
    let wanted = Change::MoveHandle { id: reach.clone(), motion };
    done(&mut harness, Command::Edit(edit::EditCommand::Change { at: 0, change: wanted }));
    assert!(place(&harness, &reach).distance(end.at + motion.translate) < 1e-9 * size);
    done(&mut harness, Command::Undo);
    done(&mut harness, Command::Undo);
    let motion =
        simod_session::Motion { translate: glam::DVec3::new(0.45, -0.2, 0.0) * size, ..Default::default() };
    let reach = Change::MoveHandle { id: end.id.clone(), motion };
    done(&mut harness, Command::Edit(edit::EditCommand::Change { at: 0, change: reach }));
    let frame = harness.state().window().state().scene().unwrap().frame();
    let posed = posed(&harness).expect("an end reaches");
    let rest: Vec<glam::DVec3> = joints.iter().map(|joint| frame.to_local_exact(joint.at)).collect();
    // The end is there, its elbow has gone aside, and bones have the lengths that they had.
    let target = frame.to_local_exact(end.at + motion.translate);
    let scale = size / frame.scale;
    assert!(posed[3].distance(target) < 0.05 * scale, "{posed:?} {target}");
    assert!(posed[2].distance(rest[2]) > 0.05 * scale && posed[0].distance(rest[0]) < 0.02 * scale);
    for i in 1..4 {
        let [was, is] = [&rest, &posed].map(|places| places[i].distance(places[i - 1]));
        assert!((was - is).abs() < 0.05 * was, "{i}: {was} {is}");
    }
    // A click takes the elbow where it is seen.
    harness.state_mut().window_mut().tools.take(Tool::Move);
    harness.state_mut().window_mut().tools.target = None;
    let state = harness.state().window().state();
    let at = state.camera().project(posed[2], state.size()).unwrap().0;
    let at = harness.get_by_label("Model").rect().min + egui::vec2(at.x as f32, at.y as f32);
    click_at(&mut harness, at);
    let taken = format!("{:?}", harness.state().window().tools.target);
    assert!(taken.contains(&joints[2].id), "{taken}");
}

/// A drag places a chain, whose joints are renamed, and mirrored to the other side.
#[test]
fn a_chain_of_joints_is_dragged_renamed_and_mirrored() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    // All of the panel is seen.
    harness.set_size(egui::vec2(1440.0, 1700.0));
    harness.run_steps(3);
    open(&mut harness, &model(folder.path()));
    take_joints(&mut harness);
    assert_eq!(harness.state().window().tools.chain, 4);
    harness.get_by_label("Hold the Body").click();
    harness.run_steps(2);
    assert!(harness.query_by_label("Joints of a chain").is_some());
    let middle = harness.get_by_label("Model").rect().center() + egui::vec2(30.0, 0.0);
    let [from, to] = [150.0, -150.0].map(|y| middle + egui::vec2(0.0, y));
    drag(&mut harness, from, to);
    let joints = |harness: &Harness<'_, App>| harness.state().window().chosen().unwrap().2.joints;
    let chain = joints(&harness);
    assert_eq!(chain.len(), 4);
    for (i, pair) in chain.windows(2).enumerate() {
        assert_eq!(pair[1].parent.as_ref(), Some(&pair[0].id), "{i}");
        assert!(pair[1].at.y > pair[0].at.y, "upwards");
    }
    assert_eq!(chain[0].parent, None);
    // In the middle of the bar as it is deep, beside it as it is wide.
    assert!(chain.iter().all(|joint| joint.at.z.abs() < 0.03 && joint.at.x > 0.02), "{chain:?}");

    harness.get_by_label("Rename joint-2").click();
    harness.run_steps(3);
    harness.get_by_label("Name of joint-2").focus();
    harness.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::A);
    harness.event(egui::Event::Text("left-arm".to_owned()));
    harness.run_steps(2);
    harness.key_press(egui::Key::Enter);
    settle(&mut harness);
    let renamed = joints(&harness);
    assert_eq!((&*renamed[1].id, renamed[2].parent.as_deref()), ("left-arm", Some("left-arm")));

    harness.get_by_label("Mirror").click();
    harness.run_steps(3);
    harness.get_by_label_contains("left and right").click();
    settle(&mut harness);
    let both = joints(&harness);
    assert_eq!(both.len(), 8);
    let right = both.iter().find(|joint| joint.id == "right-arm").unwrap();
    assert!((right.at.x + renamed[1].at.x).abs() < 0.02 && right.at.y == renamed[1].at.y, "{right:?}");
    // A chain that begins at a joint goes on from it: the first is not placed twice.
    harness.state_mut().window_mut().tools.take(Tool::Joint);
    harness.run_steps(2);
    drag(&mut harness, to, from + egui::vec2(-60.0, 0.0));
    let more = joints(&harness);
    assert_eq!(more.len(), 12);
    assert_eq!(more[8].parent.as_deref(), Some(&*chain[3].id));
}

fn drag(harness: &mut Harness<'_, App>, from: egui::Pos2, to: egui::Pos2) {
    let button = |pos, pressed| egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    };
    harness.event(egui::Event::PointerMoved(from));
    harness.run_steps(1);
    harness.event(button(from, true));
    harness.run_steps(1);
    for i in 1..=4 {
        harness.event(egui::Event::PointerMoved(from.lerp(to, i as f32 / 4.0)));
        harness.run_steps(1);
    }
    harness.event(button(to, false));
    harness.run_steps(2);
    settle(harness);
}
