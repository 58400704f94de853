//! Hands that are quicker than pictures; and the look of moving surfaces.

use super::picture::{can_draw, drawn_window};
use super::*;
use egui_kittest::kittest::Queryable;
use simod_picture::Image;
use simod_scene::SurfaceMode;
use simod_session::edit::Change;
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::{Overlay, Previewed};
use simod_window::Tool;

/// All of this happens during one picture.
fn at_once(harness: &mut Harness<'_, App>, events: impl IntoIterator<Item = egui::Event>) {
    harness.input_mut().events.extend(events);
    settle(harness);
    harness.run_steps(12);
    settle(harness);
}

fn button(pos: egui::Pos2, pressed: bool) -> egui::Event {
    egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    }
}

fn key(key: egui::Key, modifiers: egui::Modifiers) -> egui::Event {
    egui::Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers }
}

fn drag(from: egui::Pos2, to: egui::Pos2) -> Vec<egui::Event> {
    let moves = (0..=10).map(|k| egui::Event::PointerMoved(from.lerp(to, k as f32 / 10.0)));
    let mut events = vec![egui::Event::PointerMoved(from), button(from, true)];
    events.extend(moves);
    events.push(button(to, false));
    events
}

#[test]
fn keys_and_drags_of_one_slow_picture_are_all_done() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    let model = harness.get_by_label("Model").rect();
    let (left, right) = (model.lerp_inside(egui::vec2(0.3, 0.5)), model.lerp_inside(egui::vec2(0.7, 0.5)));
    let none = egui::Modifiers::NONE;
    harness.event(egui::Event::PointerMoved(left));
    harness.run_steps(2);

    // The tool is taken, a box drawn, a mask made of it, and the selection grown twice; all before the next
    // picture.
    let mut events = vec![key(egui::Key::B, none), egui::Event::Text("b".to_owned())];
    let (top, bottom) = (model.left_top() + egui::vec2(20.0, 90.0), model.center() + egui::vec2(300.0, 0.0));
    events.extend(drag(top, bottom));
    events.push(key(egui::Key::M, egui::Modifiers::SHIFT));
    at_once(&mut harness, events);
    let window = harness.state().window();
    assert_eq!(window.tools.tool, Tool::Box);
    assert_eq!(window.chosen().unwrap().2.regions.len(), 1, "a mask of what was drawn");

    // A box again, and a key three times.
    at_once(&mut harness, drag(top, bottom));
    let selected = |harness: &Harness<'_, App>| harness.state().window().state().selection().count();
    let boxed = selected(&harness);
    assert!(boxed > 0);
    let mut grown = Vec::new();
    for _ in 0..2 {
        harness.key_press(egui::Key::Plus);
        settle(&mut harness);
        grown.push(selected(&harness));
    }
    let undo = key(egui::Key::Z, egui::Modifiers::COMMAND);
    at_once(&mut harness, [undo.clone(), undo]);
    assert_eq!(selected(&harness), boxed);
    let plus = key(egui::Key::Plus, none);
    at_once(&mut harness, [plus.clone(), plus]);
    assert_eq!(selected(&harness), grown[1]);
    assert!(boxed < grown[0] && grown[0] < grown[1]);

    // Two drags of the camera, with a click on nothing in between.
    harness.state_mut().window_mut().tools.take(Tool::Orbit);
    harness.run_steps(2);
    let yaw = |harness: &Harness<'_, App>| harness.state().window().state().camera().yaw;
    let before = yaw(&harness);
    at_once(&mut harness, drag(left, left + egui::vec2(40.0, 0.0)));
    let one = yaw(&harness) - before;
    assert!(one.abs() > 0.1, "{one}");
    let before = yaw(&harness);
    let twice = drag(left, left + egui::vec2(40.0, 0.0))
        .into_iter()
        .chain(drag(right, right + egui::vec2(40.0, 0.0)));
    at_once(&mut harness, twice);
    let two = yaw(&harness) - before;
    assert!((two - 2.0 * one).abs() < 0.3 * one.abs(), "{two} is not twice {one}");
}

/// A button that is pressed and let go without a move is a click, however long a picture takes.
#[test]
fn clicks_between_slow_pictures_are_clicks() {
    let builder = Harness::builder().with_size([1440.0, 900.0]).with_step_dt(3.0);
    let plugins = plugins();
    let mut harness = builder
        .build_eframe(|cc| App::new(cc, Window::new(&cc.egui_ctx, plugins, WindowSettings::default())));
    let folder = tempfile::tempdir().unwrap();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    done(&mut harness, Command::Choose { step: None });
    let at = harness.get_by_label("Warp").rect().center();
    at_once(&mut harness, [egui::Event::PointerMoved(at), button(at, true), button(at, false)]);
    assert_eq!(harness.state().window().state().chosen(), Some(0), "its row was clicked");
}

/// A stroke that begins beside the model begins where the hand gets to it.
#[test]
fn a_stroke_that_begins_beside_the_model_is_not_lost() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "displacement-paint".to_owned(), at: None });
    harness.state_mut().window_mut().tools.take(Tool::Stroke);
    harness.run_steps(2);
    let model = harness.get_by_label("Model").rect();
    let (beside, on_it) = (model.left_center() + egui::vec2(30.0, 0.0), model.center());
    at_once(&mut harness, drag(beside, on_it));
    let strokes = harness.state().window().chosen().unwrap().2.strokes;
    assert_eq!(strokes.len(), 1);
    assert!(strokes[0].points.len() > 1, "{} points", strokes[0].points.len());
}

#[test]
fn what_is_chosen_stays_sensible() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    let chosen = |harness: &Harness<'_, App>| harness.state().window().state().chosen();
    for plugin in ["warp", "rbf", "lattice"] {
        done(&mut harness, Command::AddStep { plugin: plugin.to_owned(), at: None });
    }
    assert_eq!(chosen(&harness), Some(2));
    done(&mut harness, Command::Undo);
    assert_eq!(chosen(&harness), Some(1), "the one before what is gone");
    done(&mut harness, Command::Redo);
    assert_eq!(chosen(&harness), Some(2), "what came back");
    done(&mut harness, Command::Choose { step: Some(0) });
    done(&mut harness, Command::Edit(simod_session::edit::EditCommand::Remove { at: 0 }));
    assert_eq!(chosen(&harness), Some(0), "the one behind, where there is none before");
}

#[test]
fn the_sheet_of_keys_is_grouped_and_closed_by_keys() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    for closes in [egui::Key::Escape, egui::Key::F1] {
        harness.key_press(egui::Key::F1);
        harness.run_steps(3);
        for label in ["Keys and Mouse", "Mouse and trackpad", "Tools", "Compare", "Grow Selection"] {
            assert!(harness.query_all_by_label(label).count() > 0, "{label}");
        }
        // Below, nothing is done meanwhile.
        harness.key_press(egui::Key::B);
        harness.run_steps(2);
        assert_eq!(harness.state().window().tools.tool, Tool::Orbit);
        harness.key_press(closes);
        harness.run_steps(3);
        assert!(harness.query_by_label("Mouse and trackpad").is_none(), "{closes:?}");
    }
}

/// Picture of the window, which is also saved where somebody wants to see it.
fn picture(harness: &mut Harness<'_, App>, name: &str) -> Image {
    harness.run_steps(8);
    let shown = harness.render().unwrap();
    let pixels = shown.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect();
    let image = Image::from_pixels(shown.width(), shown.height(), pixels).unwrap();
    if let Some(folder) = std::env::var_os("SIMOD_PICTURES") {
        std::fs::write(Path::new(&folder).join(name), image.to_png().unwrap()).unwrap();
    }
    image
}

fn set(harness: &mut Harness<'_, App>, id: &str, value: impl Into<toml::Value>) {
    let change = Change::SetParam { id: id.to_owned(), value: Some(value.into()) };
    assert!(harness.state_mut().window_mut().change(0, change, false));
    settle(harness);
}

/// Places in the middle of the picture that are much darker than the places around them: the background,
/// seen through the surface.
fn holes(image: &Image, [x, y]: [std::ops::Range<u32>; 2]) -> usize {
    let light = |x, y| image.pixel(x, y).unwrap().iter().map(|c| u32::from(*c)).sum::<u32>();
    let places = x.flat_map(|x| y.clone().map(move |y| (x, y)));
    places
        .filter(|(x, y)| {
            let around = [light(x - 6, *y), light(x + 6, *y), light(*x, y - 6), light(*x, y + 6)];
            light(*x, *y) + 150 < around.into_iter().min().unwrap()
        })
        .count()
}

/// A bar that is stretched fourfold holds together: as triangles, which are shown where there are any, and as
/// ellipses.
#[test]
fn what_is_stretched_does_not_fall_apart() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = drawn_window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    set(&mut harness, "operation", "stretch");
    set(&mut harness, "factor", 4.0);
    done(&mut harness, Command::Camera(CameraMove::Look(simod_viewer::camera::Standard::Front)));
    done(&mut harness, Command::Camera(CameraMove::FrameAll));
    harness.state_mut().window_mut().looks.handles = false;
    for _ in 0..3 {
        let at = harness.state().window().state().size().map(|s| 0.5 * s);
        done(&mut harness, Command::Camera(CameraMove::Zoom { factor: 1.6, at }));
    }
    assert_eq!(harness.state().window().mode(), SurfaceMode::Triangles, "as the model has triangles");
    let triangles = picture(&mut harness, "stretched-triangles.png");
    harness.key_press(egui::Key::T);
    settle(&mut harness);
    assert_eq!(harness.state().window().mode(), SurfaceMode::Splats);
    let discs = picture(&mut harness, "stretched-discs.png");
    let middle = [470..500, 300..520];
    for (image, name) in [(&triangles, "triangles"), (&discs, "discs")] {
        assert_eq!(holes(image, middle.clone()), 0, "{name}");
    }
    let axes = harness.state().window().state().scene().unwrap().axes().clone();
    let mut ratios: Vec<f32> = axes.iter().map(|[long, short]| long.length() / short.length()).collect();
    ratios.sort_by(f32::total_cmp);
    assert!((3.0..5.5).contains(&ratios[ratios.len() / 2]), "{}", ratios[ratios.len() / 2]);
}

#[test]
fn an_axis_has_planes_that_can_be_dragged() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    done(&mut harness, Command::Camera(CameraMove::Look(simod_viewer::camera::Standard::Front)));
    harness.run_steps(2);
    // Knob of the upper plane: half of the diagonal above the middle.
    let window = harness.state().window();
    let (state, scene) = (window.state(), window.state().scene().unwrap().clone());
    let bounds = scene.sampled.bounds;
    let (middle, diagonal) = (0.5 * (bounds.min + bounds.max), (bounds.max - bounds.min).length());
    let knob = |place: f64| {
        let p = scene.frame().to_local_exact(middle + glam::DVec3::Y * place * diagonal);
        let pixel = state.camera().project(p, state.size()).unwrap().0;
        harness.get_by_label("Model").rect().min + egui::vec2(pixel.x as f32, pixel.y as f32)
    };
    let (from, to) = (knob(0.5), knob(0.2));
    let steps = window.steps().len();
    at_once(&mut harness, drag(from, to));
    let place = harness.state().window().chosen().unwrap().2.params["to"].as_float().unwrap();
    assert!((place - 0.2).abs() < 0.02, "{place}");
    done(&mut harness, Command::Undo);
    assert!(!harness.state().window().chosen().unwrap().2.params.contains_key("to"), "one change");
    assert_eq!(harness.state().window().steps().len(), steps);
}

/// The result of a drag is whole in its first picture, also where only a part of the surface is drawn while
/// it is dragged: fewer samples in between would flicker.
#[test]
fn a_result_takes_the_place_of_its_draft_at_once() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let options = ModelOptions { shape: Shape::Bar, vertices: 200_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    let mut harness = drawn_window();
    let sampling = SamplingTable { samples: Some(150_000), ..SamplingTable::default() };
    done(&mut harness, Command::Open { path, sampling, recover: false });
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.key_press(egui::Key::T);
    settle(&mut harness);
    assert_eq!(harness.state().window().mode(), SurfaceMode::Splats);
    let drag = |angle: f64| {
        let change = Change::SetParam { id: "angle".to_owned(), value: Some(angle.into()) };
        Command::Drag(simod_session::edit::EditCommand::Change { at: 0, change })
    };
    for angle in [20.0, 40.0] {
        done(&mut harness, drag(angle));
        let window = harness.state().window();
        assert!(window.state().scene().unwrap().is_draft() && window.drawn.drawn > 0);
    }
    assert!(harness.state_mut().window_mut().apply(Command::Rest));
    let end = Instant::now() + LONG;
    while harness.state().window().state().scene().unwrap().is_draft() {
        assert!(Instant::now() < end, "no result comes");
        harness.run_steps(1);
    }
    // The picture above is the one in which the result came.
    let drawn = harness.state().window().drawn;
    assert!(drawn.complete && drawn.drawn == drawn.of, "{drawn:?}");
}

/// The knobs of a step that is added are seen where all of the model is; and wherever all of it is asked for.
#[test]
fn knobs_are_in_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    let front = Command::Camera(CameraMove::Look(simod_viewer::camera::Standard::Front));
    done(&mut harness, front.clone());
    done(&mut harness, Command::Camera(CameraMove::FrameAll));
    let camera = |harness: &Harness<'_, App>| *harness.state().window().state().camera();
    let whole = camera(&harness);
    let are_seen = |harness: &Harness<'_, App>| {
        let state = harness.state().window().state();
        let scene = state.scene().unwrap();
        let bounds = scene.sampled.bounds;
        let (middle, diagonal) = (0.5 * (bounds.min + bounds.max), (bounds.max - bounds.min).length());
        [-0.5, 0.5].iter().all(|place| {
            let p = scene.frame().to_local_exact(middle + glam::DVec3::Y * *place * diagonal);
            let pixel = state.camera().project(p, state.size()).unwrap().0;
            (20.0..=state.size()[1] - 20.0).contains(&pixel.y)
        })
    };
    let add = |harness: &mut Harness<'_, App>| {
        harness.get_by_label("+ Add Step").click();
        settle(harness);
        harness.get_by_label("Warp warp").click();
        settle(harness);
    };
    assert!(!are_seen(&harness), "the planes are a diagonal apart");
    add(&mut harness);
    assert_eq!(harness.state().window().steps().len(), 1);
    assert!(are_seen(&harness));
    assert_eq!((camera(&harness).yaw, camera(&harness).pitch), (whole.yaw, whole.pitch));
    // A camera that looks closely stays.
    let at = harness.state().window().state().size().map(|s| 0.5 * s);
    done(&mut harness, Command::Camera(CameraMove::Zoom { factor: 4.0, at }));
    let near = camera(&harness);
    add(&mut harness);
    assert_eq!(camera(&harness), near);
    harness.key_press(egui::Key::Home);
    settle(&mut harness);
    assert!(are_seen(&harness));
    let with_knobs = camera(&harness).distance;
    harness.state_mut().window_mut().looks.handles = false;
    harness.key_press(egui::Key::Home);
    settle(&mut harness);
    assert!(camera(&harness).distance < with_knobs, "the model alone");
}

/// Pictures for the eye: the panels around the model, and over it.
#[test]
fn nothing_lies_over_the_model_that_need_not() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = drawn_window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    picture(&mut harness, "axis.png");
    let before = harness.get_by_label("Model").rect();
    done(&mut harness, Command::Show(Overlay::Displacement));
    harness.run_steps(3);
    let after = harness.get_by_label("Model").rect();
    assert!(after.bottom() < before.bottom() - 20.0, "the scale has a place of its own");
    assert!(harness.get_by_label("Displacement").rect().top() >= after.bottom());
    done(&mut harness, Command::Preview { what: Previewed::Seen });
    let detail = harness.get_by_label("Full detail").rect();
    assert!(detail.top() >= harness.get_by_label("Model").rect().bottom());
    picture(&mut harness, "legend.png");
    done(&mut harness, Command::Preview { what: Previewed::Nothing });
    done(&mut harness, Command::Show(Overlay::None));
    let all =
        Command::Select { area: Area::All, combine: Default::default(), visible: false, goes_on: false };
    done(&mut harness, all);
    done(&mut harness, Command::AddStep { plugin: "lattice".to_owned(), at: None });
    picture(&mut harness, "lattice.png");
    done(&mut harness, Command::AddStep { plugin: "skinning".to_owned(), at: None });
    harness.run_steps(3);
    assert!(harness.query_by_label_contains("[[").is_none(), "words of files");
    picture(&mut harness, "skinning.png");
    harness.key_press(egui::Key::F1);
    picture(&mut harness, "keys.png");
}
