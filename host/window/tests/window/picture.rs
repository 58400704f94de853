//! The whole window as it looks, drawn by whatever graphics card there is, or by software.

use super::*;
use simod_core::render::Image;
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

#[test]
fn the_window_shows_the_model() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let plugins = plugins();
    let builder = Harness::builder().with_size([1280.0, 800.0]).wgpu();
    let mut harness =
        builder.build_eframe(|cc| App::new(cc, Window::new(&cc.egui_ctx, plugins, Settings::default())));
    let empty = harness.render().unwrap();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    harness.run_steps(8);
    let shown = harness.render().unwrap();
    if let Some(folder) = std::env::var_os("SIMOD_PICTURES") {
        let pixels = shown.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect();
        let image = Image::from_pixels(shown.width(), shown.height(), pixels).unwrap();
        std::fs::write(Path::new(&folder).join("window.png"), image.to_png().unwrap()).unwrap();
    }
    assert_eq!((shown.width(), shown.height()), (1280, 800));
    assert_ne!(empty.as_raw(), shown.as_raw());
    // The bar stands in the middle of the picture, lighter than the dark background around it.
    let light = |x: u32, y: u32| shown.get_pixel(x, y).0[..3].iter().map(|c| u32::from(*c)).sum::<u32>();
    let middle = (48 + (1280 - 324)) / 2;
    assert!(light(middle, 400) > light(80, 400) + 60, "{} and {}", light(middle, 400), light(80, 400));
}
