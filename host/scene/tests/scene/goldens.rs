//! Pictures as they were: `../goldens/`. `SIMOD_WRITE_GOLDENS=1 cargo test -p simod-scene --test scene
//! goldens` makes them anew, by software Vulkan; look at the new pictures before they are committed.
#![allow(clippy::unwrap_used, reason = "a test")]

use crate::common;
use std::path::Path;

use common::{difference, gpu, sphere, view};
use glam::{Mat4, Vec3};
use simod_picture::Image;
use simod_scene::{Background, Dot, Line, PixelScale, Scene, SceneStyle, SceneView, SurfaceMode};

/// Cards round differently: so much a channel, but for a share of the pixels, at edges.
const TOLERANCE: i32 = 6;
const EDGES: f32 = 0.01;

fn check(name: &str, image: &Image) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/goldens").join(format!("{name}.png"));
    if std::env::var_os("SIMOD_WRITE_GOLDENS").is_some() {
        return simod_model::output::write_file(&path, &image.to_png().unwrap()).unwrap();
    }
    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let pixels = bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    let golden = Image::from_pixels(info.width, info.height, pixels).unwrap();
    let (worst, beyond) = difference(image, &golden, TOLERANCE);
    assert!(beyond <= EDGES, "{name}: {beyond} of the pixels differ, by up to {worst}");
}

#[test]
fn goldens() {
    let Some(gpu) = gpu() else { return };
    // Two bumpy lumps that meet.
    let mut model = sphere(Vec3::ZERO, 0.8, 120).and(&sphere(Vec3::new(0.7, 0.35, 0.3), 0.4, 70));
    for (p, n) in model.positions.iter_mut().zip(&model.normals) {
        *p += *n * 0.03 * (*p * 14.0).map(f32::sin).element_product();
    }
    model.normals.fill(Vec3::ZERO);
    for corners in &model.triangles {
        let [a, b, c] = corners.map(|i| model.positions[i as usize]);
        corners.iter().for_each(|i| model.normals[*i as usize] += (b - a).cross(c - a));
    }
    model.colors = Some(
        model.positions.iter().map(|p| ((*p * 0.4 + 0.5) * 255.0).to_array().map(|c| c as u8)).collect(),
    );

    let mut scene = Scene::new(gpu);
    scene.set_surface(&model.surface()).unwrap();
    let turned = Mat4::from_rotation_x(0.3) * Mat4::from_rotation_y(-0.5);
    let view = SceneView { view: view().view * turned, size: [160, 160], ..view() };
    let shot = |scene: &mut Scene, name, style: &SceneStyle| {
        scene.render(&view, style, None);
        check(name, &scene.read().unwrap());
    };
    shot(&mut scene, "clay", &SceneStyle { scale: PixelScale::Double, ..SceneStyle::default() });
    shot(
        &mut scene,
        "triangles",
        &SceneStyle { mode: SurfaceMode::Triangles, own_colors: true, ..SceneStyle::default() },
    );

    let ghost = sphere(Vec3::new(-0.25, 0.0, 0.2), 0.8, 120);
    scene.set_ghost(Some(&ghost.surface())).unwrap();
    let corner = |i: usize| Vec3::new((i % 2) as f32, (i / 2 % 2) as f32, (i / 4) as f32) * 1.7 - 0.85;
    let edges = (0..8).flat_map(|i| [1, 2, 4].map(|step| (i, i | step))).filter(|(i, j)| i != j);
    let line = |(i, j)| Line {
        a: corner(i),
        b: corner(j),
        color: [90, 170, 255, 255],
        width_px: 1.5,
        on_top: false,
    };
    let dot = |i| Dot { position: corner(i), color: [255, 160, 40, 255], size_px: 7.0, on_top: i < 4 };
    scene.set_lines(&edges.map(line).collect::<Vec<_>>());
    scene.set_dots(&(0..8).map(dot).collect::<Vec<_>>());
    shot(
        &mut scene,
        "ghost-and-marks",
        &SceneStyle { background: Background::Dark, ..SceneStyle::default() },
    );
}
