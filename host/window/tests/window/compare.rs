//! Two versions side by side, by names; and turntables.

use super::picture::{can_draw, drawn_window};
use super::*;
use egui_kittest::kittest::Queryable;
use simod_model::Error;
use simod_model::progress::Progress;
use simod_session::edit::Change;
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::{ComparedVersion, Overlay};
use simod_window::Tool;
use simod_window::screenshot::Shot;
use simod_window::turntable;

fn bent(harness: &mut Harness<'_, App>, angle: f64) {
    let change = Change::SetParam { id: "angle".to_owned(), value: Some(angle.into()) };
    assert!(harness.state_mut().window_mut().change(0, change, false));
    settle(harness);
}

fn pressed(harness: &mut Harness<'_, App>, key: egui::Key, modifiers: egui::Modifiers) {
    harness.key_press_modifiers(modifiers, key);
    settle(harness);
}

/// Drags with the left button.
pub fn drag(harness: &mut Harness<'_, App>, from: egui::Pos2, to: egui::Pos2) {
    let button = |pos, pressed| egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    };
    for event in [egui::Event::PointerMoved(from), button(from, true)] {
        harness.event(event);
        harness.run_steps(2);
    }
    for k in 1..=4 {
        harness.event(egui::Event::PointerMoved(from.lerp(to, k as f32 / 4.0)));
        harness.run_steps(2);
    }
    harness.event(button(to, false));
    settle(harness);
}

/// Clicks with the left button.
pub fn click_at(harness: &mut Harness<'_, App>, at: egui::Pos2) {
    harness.event(egui::Event::PointerMoved(at));
    harness.run_steps(2);
    for pressed in [true, false] {
        harness.event(egui::Event::PointerButton {
            pos: at,
            button: egui::PointerButton::Primary,
            pressed,
            modifiers: egui::Modifiers::NONE,
        });
    }
    settle(harness);
}

#[test]
fn versions_are_pinned_seen_swapped_and_let_go() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    bent(&mut harness, 30.0);
    pressed(&mut harness, egui::Key::P, egui::Modifiers::NONE);
    assert!(harness.query_by_label_contains("Pinned: after").is_some());
    bent(&mut harness, 60.0);
    done(&mut harness, Command::Show(Overlay::Difference));

    let width = |harness: &Harness<'_, App>| harness.state().window().state().size()[0];
    let whole = width(&harness);
    harness.get_by_label("Side by Side").click();
    settle(&mut harness);
    assert!((width(&harness) - 0.5 * whole).abs() <= 2.0, "{} of {whole}", width(&harness));

    // On the pinned version nothing is selected: the camera moves. On the other one the brush works.
    harness.state_mut().window_mut().tools.take(Tool::Brush);
    harness.run_steps(2);
    let model = harness.get_by_label("Model").rect();
    let [left, right] = [0.25, 0.75].map(|x| model.lerp_inside(egui::vec2(x, 0.5)));
    let camera = |harness: &Harness<'_, App>| *harness.state().window().state().camera();
    let selected = |harness: &Harness<'_, App>| harness.state().window().state().selection().count();
    let before = camera(&harness);
    drag(&mut harness, left, left + egui::vec2(40.0, 0.0));
    assert!(camera(&harness) != before && selected(&harness) == 0);
    let before = camera(&harness);
    drag(&mut harness, right, right + egui::vec2(10.0, 0.0));
    assert!(camera(&harness) == before && selected(&harness) > 0);

    // In place while the key is held.
    harness.key_down(egui::Key::X);
    harness.run_steps(3);
    assert_eq!(width(&harness), whole);
    harness.key_up(egui::Key::X);
    harness.run_steps(3);
    assert!(width(&harness) < whole);

    let angle = |harness: &Harness<'_, App>| {
        harness.state().window().chosen().unwrap().2.params["angle"].as_float().unwrap()
    };
    harness.get_by_label("Swap").click();
    settle(&mut harness);
    assert_eq!(angle(&harness), 30.0);
    pressed(&mut harness, egui::Key::Z, egui::Modifiers::COMMAND);
    assert_eq!(angle(&harness), 60.0);
    harness.get_by_label("Unpin").click();
    settle(&mut harness);
    assert!(harness.query_by_label_contains("Pinned:").is_none());
    assert_eq!(width(&harness), whole);
}

#[test]
fn both_versions_are_drawn_beside_each_other() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = drawn_window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::Pin);
    harness.state_mut().window_mut().looks.side_by_side = true;
    harness.run_steps(8);
    done(&mut harness, Command::Camera(CameraMove::FrameAll));
    harness.run_steps(8);
    let shown = harness.render().unwrap();
    // Nothing differs: the halves are the same but for what lies over them.
    let model = harness.get_by_label("Model").rect();
    let (y, quarter) = (model.center().y as u32, 0.5 * model.width() as f64);
    let row = |from: f64| -> Vec<[u8; 4]> {
        let from = (f64::from(model.left()) + from).ceil() as u32;
        (40..400).map(|x| shown.get_pixel(from + x, y).0).collect()
    };
    let (left, right) = (row(0.0), row(quarter + 1.0));
    assert!(left.iter().any(|p| p[0] > 120) && left.iter().any(|p| p[0] < 60), "the bar and its background");
    let off = |(a, b): (&[u8; 4], &[u8; 4])| a[0].abs_diff(b[0]) > 24;
    let differ = left.iter().zip(&right).filter(|pair| off(*pair)).count();
    assert!(differ <= 8, "{differ} pixels differ");
}

/// Stops after so many frames.
struct Until(std::sync::atomic::AtomicU32);

impl Progress for Until {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {
        self.0.fetch_sub(1, std::sync::atomic::Ordering::Relaxed);
    }
    fn is_cancelled(&self) -> bool {
        self.0.load(std::sync::atomic::Ordering::Relaxed) == 0
    }
}

fn names(folder: &Path) -> Vec<String> {
    let name = |e: std::io::Result<std::fs::DirEntry>| e.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = std::fs::read_dir(folder).unwrap().map(name).collect();
    names.sort();
    names
}

#[test]
fn a_turntable_is_whole_or_not_there() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let options = ModelOptions { shape: Shape::Cylinder, vertices: 20_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    let sampling = SamplingTable { samples: Some(4000), ..SamplingTable::default() };
    let commands = [Command::Open { path, sampling, recover: false }];
    let mut state = simod_viewer::replay(&commands, &plugins()).unwrap();
    let (plain, turn) = (folder.path().join("plain.png"), folder.path().join("turn"));
    let shot = Shot::take(&state).unwrap();

    let stopped = turntable::write(&shot, &turn, 5, &Until(2.into()));
    assert_eq!(stopped.unwrap_err().kind(), Error::cancelled().kind());
    assert_eq!(names(folder.path()), ["model.ply"], "nothing is left");

    turntable::write(&shot, &turn, 3, &Silent).unwrap();
    let frames = ["frame-0001.png", "frame-0002.png", "frame-0003.png"];
    assert_eq!(names(&turn), frames);
    simod_window::screenshot::write(&mut state, &plain, Default::default()).unwrap();
    let read = |name: &str| std::fs::read(turn.join(name)).unwrap();
    assert!(std::fs::read(&plain).unwrap() == read(frames[0]), "the first frame is the picture");
    let again = folder.path().join("again");
    turntable::write(&shot, &again, 3, &Silent).unwrap();
    assert!(frames.iter().all(|name| std::fs::read(again.join(name)).unwrap() == read(name)));

    // A cylinder looks the same from all sides, but for its samples.
    let mut studio = shot.studio().unwrap();
    let [front, side] = [0.0, 2.0].map(|angle| studio.picture(angle).unwrap());
    let pairs = front.pixels().iter().zip(side.pixels());
    let sum: u64 = pairs.map(|(a, b)| (0..3).map(|c| u64::from(a[c].abs_diff(b[c]))).sum::<u64>()).sum();
    let mean = sum as f64 / (3 * front.pixels().len()) as f64;
    assert!(mean < 1.0, "{mean} of 255");

    // A file that is no frame stays in the folder.
    std::fs::write(turn.join("notes.txt"), "").unwrap();
    let error = turntable::write(&shot, &turn, 2, &Silent).unwrap_err();
    assert!(error.to_string().contains("notes.txt") && names(&turn).len() == 4, "{error}");
}

#[test]
fn a_turntable_is_rendered_from_the_menu_and_stopped() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(
        &mut harness,
        Command::Select { area: Area::All, combine: Default::default(), visible: false, goes_on: false },
    );
    harness.set_size(egui::vec2(800.0, 520.0));
    let turn = folder.path().join("turn");
    for (frames, stops) in [(2, false), (500, true)] {
        harness.get_by_label("File").click();
        harness.run_steps(3);
        harness.get_by_label_contains("Render Turntable").click();
        harness.run_steps(3);
        let asked = harness.state_mut().window_mut().turntable.as_mut().unwrap();
        assert!(asked.folder.ends_with("model-turntable"));
        (asked.frames, asked.folder) = (frames, turn.display().to_string());
        harness.run_steps(2);
        harness.get_by_label("Render").click();
        harness.run_steps(3);
        if stops {
            assert!(harness.query_by_label_contains(&format!("of {frames}")).is_some(), "how far it is");
            harness.get_by_label("Cancel").click();
            harness.run_steps(2);
            // At once, whatever the frame takes that is being drawn.
            assert!(harness.state().window().turning.is_none());
            assert!(harness.query_by_label("Cancel").is_none());
        }
        let end = Instant::now() + LONG;
        let goes_on = |window: &Window| window.turning.is_some() || window.stopping.is_some();
        while goes_on(harness.state().window()) {
            assert!(Instant::now() < end, "it takes too long");
            harness.run_steps(1);
            std::thread::sleep(Duration::from_millis(20));
        }
        if !stops {
            harness.run_steps(2);
            harness.get_by_label("Close").click();
            harness.run_steps(2);
        }
        // The first one stays where the second one was stopped.
        assert_eq!(names(&turn).len(), 2);
        assert_eq!(names(folder.path()), ["model.ply", "turn"]);
    }
    assert!(harness.state().window().state().scene_of(ComparedVersion::Pinned).is_none());
}
