//! Tools for looking besides the camera: light, the model cut open, lengths and angles; and pictures that
//! are saved.

use super::picture::{can_draw, drawn, drawn_window};
use super::*;
use egui_kittest::kittest::Queryable;
use simod_picture::Image;
use simod_viewer::camera::Standard;
use simod_viewer::command::CameraMove;
use simod_window::Tool;

/// A bar, seen from its front, with something to draw with.
fn bar(folder: &Path) -> Harness<'static, App> {
    let mut harness = drawn_window();
    open(&mut harness, &model(folder));
    for step in [CameraMove::Look(Standard::Front), CameraMove::FrameAll] {
        done(&mut harness, Command::Camera(step));
    }
    harness.run_steps(4);
    harness
}

/// Chooses an entry of a menu within a menu.
fn choose(harness: &mut Harness<'_, App>, path: &[&str]) {
    for name in path {
        // Behind the name of an entry are its keys, or that it opens a menu.
        harness.get_by(|node| node.label().is_some_and(|label| is_entry(&label, name))).click();
        harness.run_steps(3);
    }
    settle(harness);
    harness.run_steps(3);
}

/// Whether a label is an entry of this name.
fn is_entry(label: &str, name: &str) -> bool {
    let rest = label.strip_prefix(name).map(str::trim);
    rest.is_some_and(|rest| rest.is_empty() || rest == "\u{23f5}" || rest.ends_with(['B', '2']))
}

fn middle(harness: &Harness<'_, App>) -> egui::Pos2 {
    harness.get_by_label("Model").rect().center()
}

fn click(harness: &mut Harness<'_, App>, at: egui::Pos2) {
    harness.event(egui::Event::PointerMoved(at));
    harness.run_steps(1);
    for pressed in [true, false] {
        let modifiers = egui::Modifiers::NONE;
        harness.event(egui::Event::PointerButton {
            pos: at,
            button: egui::PointerButton::Primary,
            pressed,
            modifiers,
        });
        harness.run_steps(1);
    }
    settle(harness);
}

#[test]
fn the_surface_is_lit_as_the_menu_says() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = bar(folder.path());
    let mut seen = vec![drawn(&mut harness, "light-lamps")];
    for (name, file) in [
        ("Lit from the Camera", "light-camera"),
        ("Ceramic", "light-ceramic"),
        ("Polished Metal", "light-metal"),
        ("Warm Wax", "light-wax"),
        ("Mirrored Stripes", "light-stripes"),
    ] {
        choose(&mut harness, &["View", "Light", name]);
        let picture = drawn(&mut harness, file);
        assert!(seen.iter().all(|other| *other != picture), "{name}");
        seen.push(picture);
    }
    choose(&mut harness, &["View", "Light", "Lit by Lamps"]);
    let again = drawn(&mut harness, "light-lamps");
    let changed = again.pixels().iter().zip(seen[0].pixels()).filter(|(a, b)| a != b).count();
    assert!(changed < 2000, "but for the pointer: {changed}");
}

#[test]
fn the_model_is_cut_open_and_closed() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = bar(folder.path());
    let whole = drawn(&mut harness, "whole");
    choose(&mut harness, &["View", "Cut Open"]);
    let open = drawn(&mut harness, "cut-open");
    let red = |picture: &Image| {
        picture.pixels().iter().filter(|p| 10 * u32::from(p[0]) > 17 * u32::from(p[2])).count()
    };
    assert!(red(&open) > red(&whole) + 2000, "the inside is seen: {} {}", red(&open), red(&whole));
    let clip = |harness: &Harness<'_, App>| harness.state().window().state().clipped();
    let first = clip(&harness).unwrap();
    assert!(first.normal.dot(glam::DVec3::Z) > 0.999, "towards the eye: {first:?}");
    // By its axis, side and place, and closed again.
    harness.get_by_label("Cut across Y").click();
    harness.run_steps(3);
    let across = clip(&harness).unwrap();
    assert_eq!(across.normal, glam::DVec3::Y);
    harness.get_by_label("Place of the cut").focus();
    harness.run_steps(2);
    harness.key_press(egui::Key::ArrowRight);
    harness.run_steps(3);
    assert!(clip(&harness).unwrap().through.y > across.through.y);
    harness.get_by_label("Flip").click();
    harness.run_steps(3);
    assert_eq!(clip(&harness).unwrap().normal, glam::DVec3::NEG_Y);
    harness.get_by_label("Close the cut").click();
    harness.run_steps(4);
    assert_eq!(clip(&harness), None);
    assert!(harness.query_by_label("Close the cut").is_none());
    harness.key_press_modifiers(egui::Modifiers::ALT, egui::Key::B);
    harness.run_steps(3);
    assert!(clip(&harness).is_some());
}

#[test]
fn lengths_and_angles_are_clicked_and_go_along() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = if can_draw() { drawn_window() } else { window() };
    open(&mut harness, &model(folder.path()));
    for step in [CameraMove::Look(Standard::Front), CameraMove::FrameAll] {
        done(&mut harness, Command::Camera(step));
    }
    harness.key_press(egui::Key::M);
    harness.run_steps(3);
    assert_eq!(harness.state().window().tools.tool, Tool::Measure);
    assert!(harness.query_by_label("Click points on the surface.").is_some());
    let middle = middle(&harness);
    let [below, above] = [150.0, -150.0].map(|y| middle + egui::vec2(0.0, y));
    click(&mut harness, below);
    click(&mut harness, above);
    let measured = |harness: &Harness<'_, App>| harness.state().window().state().measured();
    let points = measured(&harness);
    assert_eq!(points.len(), 2);
    let length = points[0].now.distance(points[1].now);
    let text = |harness: &Harness<'_, App>| simod_window::measure_summary(harness.state().window()).unwrap();
    assert!(text(&harness).starts_with("Distance ") && !text(&harness).contains("at rest"));
    assert!(harness.query_by_label(&text(&harness)).is_some());
    assert!((points[0].now.y - points[1].now.y).abs() > 0.9 * length, "one is above the other");

    // A third click begins anew, but for angles.
    harness.get_by_label("Measure Angle").click();
    harness.run_steps(2);
    click(&mut harness, middle + egui::vec2(25.0, -150.0));
    assert_eq!(measured(&harness).len(), 3);
    assert!(
        text(&harness).starts_with("Angle 90") || text(&harness).starts_with("Angle 89"),
        "{}",
        text(&harness)
    );

    // A deformation of the model changes the measure, which tells its former value.
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.state_mut().window_mut().tools.take(Tool::Measure);
    harness.run_steps(3);
    assert!(text(&harness).contains("at rest"), "{}", text(&harness));
    if can_draw() {
        drawn(&mut harness, "measure");
    }
    assert!(harness.query_by_label(&text(&harness)).is_some());

    harness.get_by_label("Remove Last").click();
    harness.run_steps(2);
    assert_eq!(measured(&harness).len(), 2);
    harness.key_press(egui::Key::Escape);
    harness.run_steps(2);
    assert!(measured(&harness).is_empty());
}

/// Width, height and opacities of a PNG file.
fn read(file: &Path) -> ([u32; 2], Option<Vec<u8>>) {
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(file).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let opacities = || bytes.chunks_exact(4).map(|pixel| pixel[3]).collect();
    ([info.width, info.height], (info.color_type == png::ColorType::Rgba).then(opacities))
}

#[test]
fn pictures_are_saved_in_any_size_and_cut_out() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = drawn_window();
    open(&mut harness, &model(folder.path()));
    let file = folder.path().join("shot.png");
    for transparent in [false, true] {
        harness.key_press(egui::Key::F12);
        harness.run_steps(3);
        let asked = harness.state_mut().window_mut().picture.as_mut().unwrap();
        assert!(asked.file.ends_with("model.png"));
        asked.file = file.with_extension("").display().to_string();
        asked.format.size = [300, 200];
        harness.run_steps(2);
        if transparent {
            harness.get_by_label("Transparent background").click();
            harness.run_steps(2);
        }
        drawn(&mut harness, "save-picture");
        harness.get_by_label("Save").click();
        harness.run_steps(2);
        until_drawn(&mut harness);
        let (size, opacity) = read(&file);
        assert_eq!(size, [300, 200]);
        assert_eq!(opacity.is_some(), transparent);
        if let Some(opacity) = opacity {
            let share = |of: u8| opacity.iter().filter(|a| **a == of).count() as f64 / opacity.len() as f64;
            assert!(share(0) > 0.3 && share(255) > 0.05, "{} {}", share(0), share(255));
        }
    }
}

/// Goes on until a picture or a turntable is there.
fn until_drawn(harness: &mut Harness<'_, App>) {
    let end = Instant::now() + LONG;
    while harness.state().window().turning.is_some() {
        assert!(Instant::now() < end, "it takes too long");
        harness.run_steps(1);
        std::thread::sleep(Duration::from_millis(20));
    }
    harness.run_steps(3);
}

#[test]
fn a_turntable_tells_how_it_becomes_a_film() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = drawn_window();
    open(&mut harness, &model(folder.path()));
    choose(&mut harness, &["File", "Render Turntable\u{2026}"]);
    let turn = folder.path().join("turn");
    let asked = harness.state_mut().window_mut().turntable.as_mut().unwrap();
    (asked.frames, asked.folder, asked.format.size) = (2, turn.display().to_string(), [101, 64]);
    harness.run_steps(2);
    harness.get_by_label("Render").click();
    harness.run_steps(2);
    until_drawn(&mut harness);
    assert_eq!(read(&turn.join("frame-0002.png")).0, [102, 64], "films take even sizes alone");
    assert!(harness.query_by_label("Command line for a film").is_some());
    drawn(&mut harness, "film");
    let film = harness.state().window().film.clone().unwrap();
    assert_eq!((film.frames, film.rate, film.folder), (2, 30, turn));
    harness.get_by_label("Copy the Command Line").click();
    harness.run_steps(2);
    harness.get_by_label("Close").click();
    harness.run_steps(3);
    assert!(harness.state().window().film.is_none());
}
