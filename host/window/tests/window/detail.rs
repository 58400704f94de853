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
        harness.state().window().state().detail().map(|detail| (detail.previewed(), detail.figures()))
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

/// Places in the middle of the picture, where the model is.
fn middle() -> impl Iterator<Item = [u32; 2]> {
    (300..700).flat_map(|x| (200..600).map(move |y| [x, y]))
}

fn at(image: &Image, [x, y]: [u32; 2]) -> [u8; 3] {
    image.pixel(x, y).unwrap()
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
    let mut harness = builder
        .build_eframe(|cc| App::new(cc, Window::new(&cc.egui_ctx, plugins, WindowSettings::default())));
    open(&mut harness, &path);
    let before = picture(&mut harness, "samples.png");
    press(&mut harness, egui::Modifiers::NONE);
    let detail = picture(&mut harness, "detail.png");
    let others = middle().filter(|place| at(&before, *place)[0].abs_diff(at(&detail, *place)[0]) > 6).count();
    assert!(others > 2000, "{others} pixels are others");
    press(&mut harness, egui::Modifiers::ALT);
    let after = picture(&mut harness, "after.png");
    let others = middle().filter(|place| at(&before, *place) != at(&after, *place)).count();
    assert_eq!(others, 0);
}

/// Splats on a wall: long ones that lie aslant, red below and blue above, a part of the wall's size each.
fn wall_of_splats(path: &Path) {
    const N: usize = 60;
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let names = names.into_iter().chain(["rot_0", "rot_1", "rot_2", "rot_3"]);
    let mut file = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", N * N);
    names.for_each(|name| file.push_str(&format!("property float {name}\n")));
    let mut file = (file + "end_header\n").into_bytes();
    for i in 0..N * N {
        let place = |i: usize| (i as f32 + 0.5) / N as f32 - 0.5;
        let (x, y) = (place(i % N), place(i / N));
        let (red, blue) = if y < 0.0 { (1.5, -1.5) } else { (-1.5, 1.5) };
        // An eighth of a turn about z: aslant as the picture shows it, too.
        let (sin, cos) = std::f32::consts::FRAC_PI_8.sin_cos();
        let position = [x, y, 0.02 * (9.0 * x).sin()];
        let look = [red, -1.5, blue, 4.0, 0.011f32.ln(), 0.0016f32.ln(), 0.0004f32.ln(), cos, 0.0, 0.0, sin];
        file.extend(position.into_iter().chain(look).flat_map(f32::to_le_bytes));
    }
    std::fs::write(path, file).unwrap();
}

#[test]
fn splats_are_ellipses_in_their_colours() {
    if !can_draw() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wall.ply");
    wall_of_splats(&path);
    let mut harness = super::picture::drawn_window();
    let sampling = SamplingTable { samples: Some(400), ..SamplingTable::default() };
    done(&mut harness, Command::Open { path, sampling, recover: false });
    // The samples have the splats' colours already.
    let samples = picture(&mut harness, "splats-samples.png");
    let red = |[r, _, b]: [u8; 3]| r > 60 && r > 2 * b.clamp(1, 127);
    let blue = |[r, _, b]: [u8; 3]| b > 60 && b > 2 * r.clamp(1, 127);
    let of = |picture: &Image, is: &dyn Fn([u8; 3]) -> bool| {
        middle().filter(|place| is(at(picture, *place))).count()
    };
    assert!(of(&samples, &red) > 5000 && of(&samples, &blue) > 5000);

    press(&mut harness, egui::Modifiers::NONE);
    let splats = picture(&mut harness, "splats.png");
    let [covered, left] = [&samples, &splats].map(|picture| of(picture, &red) + of(picture, &blue));
    // Gaps between narrow ellipses are seen through.
    assert!(left > 5000 && left < covered * 9 / 10, "{left} of {covered}");
    // Each splat has its own colour, where a sample's is mixed of both, too; a splat's edge is smoothed
    // against what is beneath.
    let mixed = |[r, _, b]: [u8; 3]| r > 70 && b > 70 && r.abs_diff(b) < 40;
    let [of_samples, of_splats] = [&samples, &splats].map(|picture| of(picture, &mixed));
    assert!(of_splats < of_samples / 10, "{of_splats} of {of_samples}");
    // Pixels that go on along the ellipses, and across them by about half of what lies between two.
    let is = |place| red(at(&splats, place)) || blue(at(&splats, place));
    let alike = |dx: u32, dy: i32| {
        let other = |[x, y]: [u32; 2]| [x + dx, y.wrapping_add_signed(dy)];
        middle().filter(|place| is(*place) && is(other(*place))).count()
    };
    let (along, across) = (alike(2, -2), alike(2, 2));
    assert!(along > 4 * across, "{along} along, {across} across");

    harness.state_mut().window_mut().looks.samples = true;
    let dots = picture(&mut harness, "splats-dots.png");
    let yellow = |[r, g, b]: [u8; 3]| r > 200 && g > 160 && b < 140;
    assert!(of(&splats, &yellow) == 0 && of(&dots, &yellow) > 300, "{}", of(&dots, &yellow));
}
