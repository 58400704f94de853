//! Parts of the model in full, by keys and names, and as they look.

use super::picture::can_draw;
use super::*;
use egui_kittest::kittest::Queryable;
use simod_picture::Image;
use simod_viewer::Previewed;

fn press(harness: &mut Harness<'_, App>, modifiers: egui::Modifiers) {
    harness.key_press_modifiers(modifiers, egui::Key::I);
    settle(harness);
}

#[test]
fn what_is_seen_or_selected_is_shown_in_full_by_a_key() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    press(&mut harness, egui::Modifiers::NONE);
    open(&mut harness, &model(folder.path()));
    assert!(harness.query_by_label("Full detail").is_none());

    press(&mut harness, egui::Modifiers::NONE);
    let figures = |harness: &Harness<'_, App>| {
        harness.state().window().state().detail().map(|detail| (detail.of(), detail.figures()))
    };
    let (of, seen) = figures(&harness).unwrap();
    assert!(of == Previewed::Seen && seen.vertices > 1000 && seen.vertices == seen.wanted, "{seen:?}");
    assert!(harness.query_by_label("Full detail").is_some());
    assert!(harness.query_by_label_contains("vertices, all of what was seen").is_some());

    // Nothing is selected yet.
    press(&mut harness, egui::Modifiers::SHIFT);
    assert_eq!(figures(&harness).unwrap().0, Previewed::Seen);
    harness.key_press(egui::Key::A);
    settle(&mut harness);
    press(&mut harness, egui::Modifiers::SHIFT);
    let (of, all) = figures(&harness).unwrap();
    assert!(of == Previewed::Selection && all.vertices > seen.vertices, "{all:?}");
    assert!(harness.query_by_label_contains("vertices, all of the selection").is_some());

    harness.get_by_label("Update").click();
    settle(&mut harness);
    assert_eq!(figures(&harness).unwrap().1, all);
    harness.get_by_label("Off").click();
    settle(&mut harness);
    assert!(figures(&harness).is_none() && harness.query_by_label("Full detail").is_none());
    press(&mut harness, egui::Modifiers::NONE);
    press(&mut harness, egui::Modifiers::ALT);
    assert!(figures(&harness).is_none());
}

#[test]
fn it_is_seen_and_gone_again() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("amphora.ply");
    let options = ModelOptions { shape: Shape::Amphora, vertices: 200_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    let plugins = plugins();
    let builder = Harness::builder().with_size([1280.0, 800.0]).wgpu();
    let mut harness =
        builder.build_eframe(|cc| App::new(cc, Window::new(&cc.egui_ctx, plugins, Settings::default())));
    open(&mut harness, &path);
    let picture = |harness: &mut Harness<'_, App>, name: &str| {
        harness.run_steps(8);
        let shown = harness.render().unwrap();
        if let Some(folder) = std::env::var_os("SIMOD_PICTURES") {
            let pixels = shown.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect();
            let image = Image::from_pixels(shown.width(), shown.height(), pixels).unwrap();
            std::fs::write(Path::new(&folder).join(name), image.to_png().unwrap()).unwrap();
        }
        shown
    };
    let before = picture(&mut harness, "samples.png");
    press(&mut harness, egui::Modifiers::NONE);
    let detail = picture(&mut harness, "detail.png");
    // In the middle of the picture, where the amphora is.
    let middle = |x: &u32, y: &u32| (300..700).contains(x) && (200..600).contains(y);
    let others = before
        .enumerate_pixels()
        .filter(|(x, y, p)| middle(x, y) && p.0[0].abs_diff(detail.get_pixel(*x, *y).0[0]) > 6)
        .count();
    assert!(others > 2000, "{others} pixels are others");
    press(&mut harness, egui::Modifiers::ALT);
    let after = picture(&mut harness, "after.png");
    let others = before
        .enumerate_pixels()
        .filter(|(x, y, p)| middle(x, y) && p.0 != after.get_pixel(*x, *y).0)
        .count();
    assert_eq!(others, 0);
}
