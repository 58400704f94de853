//! The whole window as it looks, drawn by whatever graphics card there is, or by software.

use super::*;
use egui_kittest::kittest::Queryable;
use simod_picture::Image;
use simod_scene::Gpu;

/// Whether to go on: there is something to draw with, or there has to be.
pub fn can_draw() -> bool {
    match Gpu::headless() {
        Ok(_) => true,
        Err(error) if std::env::var_os("CI").is_some() => panic!("{error}"),
        Err(error) => {
            use std::io::Write;
            let _ = writeln!(std::io::stderr(), "skipped: {error}");
            false
        }
    }
}

/// Picture of the window, which is also saved where `SIMOD_PICTURES` names a folder for it.
pub fn drawn(harness: &mut Harness<'_, App>, name: &str) -> Image {
    let shown = harness.render().unwrap();
    let pixels = shown.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect();
    let image = Image::from_pixels(shown.width(), shown.height(), pixels).unwrap();
    if let Some(folder) = std::env::var_os("SIMOD_PICTURES") {
        let file = Path::new(&folder).join(format!("{name}.png"));
        std::fs::write(file, image.to_png().unwrap()).unwrap();
    }
    image
}

/// A window with nothing open, and something to draw with.
pub fn drawn_window() -> Harness<'static, App> {
    drawn_window_of([1280.0, 800.0])
}

/// Window of a size with nothing open, and something to draw with.
pub fn drawn_window_of(size: [f32; 2]) -> Harness<'static, App> {
    let plugins = plugins();
    let builder = Harness::builder().with_size(size).wgpu();
    builder.build_eframe(|cc| App::new(cc, Window::new(&cc.egui_ctx, plugins, WindowSettings::default())))
}

#[test]
fn the_window_shows_the_model() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut harness = drawn_window();
    let empty = drawn(&mut harness, "empty");
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.run_steps(8);
    let shown = drawn(&mut harness, "window");
    assert_eq!((shown.width(), shown.height()), (1280, 800));
    assert!(empty != shown);
    // The bar stands in the middle of the picture, lighter than the dark background around it.
    let light = |x: u32, y: u32| shown.pixel(x, y).unwrap().iter().map(|c| u32::from(*c)).sum::<u32>();
    let middle = (48 + (1280 - 324)) / 2;
    assert!(light(middle, 400) > light(80, 400) + 60, "{} and {}", light(middle, 400), light(80, 400));
}

#[test]
fn a_card_that_goes_away_takes_nothing_of_the_edit_along() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path());
    let plugins = plugins();
    let device = std::cell::OnceCell::new();
    let builder = Harness::builder().with_size([1280.0, 800.0]).wgpu();
    let mut harness = builder.build_eframe(|cc| {
        device.get_or_init(|| cc.wgpu_render_state.as_ref().unwrap().device.clone());
        App::new(cc, Window::new(&cc.egui_ctx, plugins, WindowSettings::default()))
    });
    open(&mut harness, &path);
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    assert!(simod_viewer::state::recoverable(&path).unwrap().is_none());
    let device = device.get().unwrap();
    device.destroy();
    // The next drawing notices the loss.
    let orbit = simod_viewer::command::CameraMove::Orbit { yaw: 0.3, pitch: 0.0 };
    assert!(harness.state_mut().window_mut().apply(Command::Camera(orbit)));
    harness.run_steps(4);
    assert!(harness.query_by_label("the graphics card went away").is_some());
    // The edit goes on without its picture, and is kept already.
    let kept = simod_viewer::state::recoverable(&path).unwrap().unwrap();
    assert_eq!(kept.steps.len(), 1);
    done(&mut harness, Command::Undo);
    assert!(harness.state().window().steps().is_empty());
}
