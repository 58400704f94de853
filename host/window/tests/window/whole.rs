//! A whole edit by mouse and keys alone, from the model to the saved session, with pictures as they were:
//! `goldens/`. `SIMOD_WRITE_GOLDENS=1 cargo test -p simod-window whole::` makes them anew, by software
//! Vulkan; look at them before they are committed.

use super::compare::{click_at, drag};
use super::picture::{can_draw, drawn, drawn_window_of};
use super::*;
use egui_kittest::kittest::Queryable;
use simod_picture::Image;
use simod_session::SessionFile;
use simod_session::step::Role;
use simod_window::dialogs::DialogAnswer;

/// Cards round differently: so much a channel, but for a share of the pixels, at edges.
const TOLERANCE: u8 = 8;
const EDGES: f64 = 0.015;

fn press(harness: &mut Harness<'_, App>, modifiers: egui::Modifiers, key: egui::Key) {
    harness.key_press_modifiers(modifiers, key);
    settle(harness);
}

fn click(harness: &mut Harness<'_, App>, label: &str) {
    harness.get_by_label(label).click();
    settle(harness);
}

/// Clicks the control whose label contains this text: an entry of a menu, whose label has its id, too.
fn click_on(harness: &mut Harness<'_, App>, label: &str) {
    harness.get_by_label_contains(label).click();
    settle(harness);
}

fn typed(harness: &mut Harness<'_, App>, text: &str) {
    for character in text.chars() {
        harness.event(egui::Event::Text(character.to_string()));
        harness.run_steps(2);
    }
}

/// Types a path once it is asked for.
fn path_is_typed(harness: &mut Harness<'_, App>, path: &Path) {
    let end = Instant::now() + LONG;
    while harness.state().window().prompt.is_none() {
        assert!(Instant::now() < end, "no path is asked for");
        std::thread::sleep(Duration::from_millis(10));
        harness.run_steps(1);
    }
    harness.run_steps(2);
    harness.event(egui::Event::Text(path.display().to_string()));
    harness.run_steps(2);
    press(harness, egui::Modifiers::NONE, egui::Key::Enter);
    assert!(harness.state().window().prompt.is_none(), "{}", path.display());
}

/// A point of the model's picture, by parts of its width and height.
fn place(harness: &Harness<'_, App>, x: f32, y: f32) -> egui::Pos2 {
    harness.get_by_label("Model").rect().lerp_inside(egui::vec2(x, y))
}

/// The picture of the model, beside the one that was kept.
fn looks(harness: &mut Harness<'_, App>, name: &str) {
    // The pointer lights up what it is over.
    let corner = place(harness, 0.99, 0.99);
    harness.event(egui::Event::PointerMoved(corner));
    settle(harness);
    harness.run_steps(12);
    let rect = harness.get_by_label("Model").rect();
    let whole = drawn(harness, name);
    let [left, top, right, bottom] =
        [rect.left(), rect.top(), rect.right(), rect.bottom()].map(|x| x.round() as u32);
    let all = (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y)));
    let pixels: Vec<[u8; 3]> = all.map(|(x, y)| whole.pixel(x, y).unwrap()).collect();
    let image = Image::from_pixels(right - left, bottom - top, pixels).unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/goldens").join(format!("{name}.png"));
    if std::env::var_os("SIMOD_WRITE_GOLDENS").is_some() {
        return simod_model::output::write_file(&path, &image.to_png().unwrap()).unwrap();
    }
    let golden = golden(&path);
    assert_eq!((image.width(), image.height()), (golden.width(), golden.height()), "{name}");
    let differs = |(a, b): (&[u8; 3], &[u8; 3])| (0..3).any(|c| a[c].abs_diff(b[c]) > TOLERANCE);
    let beyond = image.pixels().iter().zip(golden.pixels()).filter(|pair| differs(*pair)).count();
    let share = beyond as f64 / image.pixels().len() as f64;
    assert!(share <= EDGES, "{name}: {share} of the pixels differ");
}

fn golden(path: &Path) -> Image {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let pixels = bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    Image::from_pixels(info.width, info.height, pixels).unwrap()
}

#[test]
fn an_edit_by_mouse_and_keys() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cactus.ply");
    let options = ModelOptions { shape: Shape::Cactus, vertices: 20_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    let mut harness = drawn_window_of([1000.0, 700.0]);
    // The system has no dialogs, so that paths are typed.
    harness.state_mut().window_mut().chooser =
        Arc::new(|_, _, _| DialogAnswer::Absent("there are none".to_owned()));
    press(&mut harness, egui::Modifiers::COMMAND, egui::Key::O);
    path_is_typed(&mut harness, &path);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Num1);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Home);
    looks(&mut harness, "opened");

    // A step, a handle and what is fixed, by two boxes.
    click(&mut harness, "+ Add Step");
    click_on(&mut harness, "Radial basis functions");
    press(&mut harness, egui::Modifiers::NONE, egui::Key::B);
    click(&mut harness, "Through");
    let (from, to) = (place(&harness, 0.02, 0.12), place(&harness, 0.98, 0.32));
    drag(&mut harness, from, to);
    press(&mut harness, egui::Modifiers::SHIFT, egui::Key::H);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::B);
    let (from, to) = (place(&harness, 0.02, 0.75), place(&harness, 0.98, 0.98));
    drag(&mut harness, from, to);
    press(&mut harness, egui::Modifiers::SHIFT, egui::Key::F);
    looks(&mut harness, "regions");

    // The handle is taken, turned and moved by keys and numbers; a motion that is not wanted is taken back.
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Q);
    let (x, y) = (0.5, 0.2);
    let at = place(&harness, x, y);
    click_at(&mut harness, at);
    let middle = place(&harness, 0.5, 0.4);
    harness.event(egui::Event::PointerMoved(middle));
    harness.run_steps(2);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::R);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Z);
    typed(&mut harness, "30");
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Enter);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::G);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::X);
    typed(&mut harness, "0.4");
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Enter);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::S);
    typed(&mut harness, "3");
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Escape);
    looks(&mut harness, "bent");

    // A name, a second step, both in a group; how far all went, in colours.
    press(&mut harness, egui::Modifiers::NONE, egui::Key::F2);
    typed(&mut harness, "Lean");
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Enter);
    click(&mut harness, "+ Add Step");
    click_on(&mut harness, "Warp");
    press(&mut harness, egui::Modifiers::COMMAND, egui::Key::G);
    press(&mut harness, egui::Modifiers::COMMAND, egui::Key::P);
    typed(&mut harness, "displacement");
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Enter);
    press(&mut harness, egui::Modifiers::NONE, egui::Key::Q);
    looks(&mut harness, "displacement");

    // All back to the model as it was, and forward again.
    let positions =
        |harness: &Harness<'_, App>| harness.state().window().state().scene().unwrap().positions.clone();
    let edited = positions(&harness);
    while harness.state().window().state().can_undo().is_some() {
        press(&mut harness, egui::Modifiers::COMMAND, egui::Key::Z);
    }
    let scene = harness.state().window().state().scene().unwrap().clone();
    assert!(harness.state().window().steps().is_empty());
    assert_eq!(*scene.positions, *scene.sampled.samples.positions);
    while harness.state().window().state().can_redo().is_some() {
        press(&mut harness, egui::Modifiers::COMMAND | egui::Modifiers::SHIFT, egui::Key::Z);
    }
    assert_eq!(*positions(&harness), *edited);

    // Saved, it says what was done.
    press(&mut harness, egui::Modifiers::COMMAND, egui::Key::S);
    let session = folder.path().join("edit.toml");
    path_is_typed(&mut harness, &session);
    let saved = SessionFile::load(&session).unwrap();
    let [lean, warp] = &saved.steps[..] else { panic!("{:?}", saved.steps) };
    assert_eq!((lean.title.as_deref(), lean.group.as_deref()), (Some("Lean"), Some("Group")));
    assert_eq!((warp.name(), warp.group.as_deref()), ("warp", Some("Group")));
    let regions = &lean.deformation().unwrap().regions;
    assert_eq!(regions.iter().map(|region| region.role).collect::<Vec<_>>(), [Role::Handle, Role::Fixed]);
    let motion = regions[0].motion;
    assert!((motion.degrees - 30.0).abs() < 1e-9 && motion.axis.z.abs() > 0.999_999, "{motion:?}");
    assert!((motion.scale - 1.0).abs() < 1e-9, "{motion:?}");
    assert!(harness.state().window().state().editor().unwrap().is_saved());
}
