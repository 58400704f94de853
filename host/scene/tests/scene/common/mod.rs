//! Models, views and devices that the tests draw with.
#![allow(dead_code, reason = "each test uses a part")]
#![allow(clippy::print_stdout, reason = "who is skipped says so")]

use std::sync::OnceLock;

use glam::camera::rh::{proj::directx::perspective, view::look_at_mat4};
use glam::{Vec3, Vec4};
use simod_picture::Image;
use simod_scene::{Gpu, Scene, SceneStyle, SceneSurface, SceneView};

/// The device, or none where there is no adapter; then the test says that it is skipped. Where `CI` is set,
/// it fails.
pub fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let gpu = GPU.get_or_init(|| match Gpu::headless() {
        Ok(gpu) => Some(gpu),
        Err(error) if std::env::var_os("CI").is_some() => panic!("{error}"),
        Err(_) => None,
    });
    if gpu.is_none() {
        println!("skipped: no GPU adapter");
    }
    gpu.as_ref()
}

/// A sampled surface that owns its lists.
#[derive(Clone, Default)]
pub struct Model {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub radii: Vec<f32>,
    pub axes: Vec<[Vec3; 2]>,
    pub colors: Option<Vec<[u8; 3]>>,
    pub triangles: Vec<[u32; 3]>,
}

impl Model {
    pub fn surface(&self) -> SceneSurface<'_> {
        SceneSurface {
            positions: &self.positions,
            normals: &self.normals,
            radii: &self.radii,
            axes: &self.axes,
            colors: self.colors.as_deref(),
            triangles: &self.triangles,
        }
    }

    pub fn and(mut self, other: &Self) -> Self {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.radii.extend(&other.radii);
        self.axes.extend(&other.axes);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
        if let (Some(colors), Some(others)) = (&mut self.colors, &other.colors) {
            colors.extend(others);
        }
        self
    }

    pub fn colored(self, color: [u8; 3]) -> Self {
        Self { colors: Some(vec![color; self.positions.len()]), ..self }
    }
}

/// A sphere of samples along circles of latitude, with triangles between them.
pub fn sphere(center: Vec3, radius: f32, rows: usize) -> Model {
    let columns = 2 * rows;
    let mut model = Model::default();
    for row in 0..=rows {
        let (sin, cos) = (std::f32::consts::PI * row as f32 / rows as f32).sin_cos();
        for column in 0..columns {
            let angle = std::f32::consts::TAU * (column as f32 + 0.5 * row as f32) / columns as f32;
            let normal = Vec3::new(sin * angle.sin(), cos, sin * angle.cos());
            model.positions.push(center + radius * normal);
            model.normals.push(normal);
        }
    }
    let index = |row: usize, column: usize| (row * columns + column % columns) as u32;
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [index(row, column), index(row, column + 1)];
            let [c, d] = [index(row + 1, column), index(row + 1, column + 1)];
            model.triangles.extend([[a, c, b], [b, c, d]]);
        }
    }
    let spacing = std::f32::consts::PI * radius / rows as f32;
    model.radii = vec![1.35 * spacing; model.positions.len()];
    model
}

/// View from a distance of 4 along +z, 240 pixels in square, just wide enough for 1.2 to all sides of the
/// origin.
pub fn view() -> SceneView {
    SceneView {
        view: look_at_mat4(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, Vec3::Y),
        projection: perspective(2.0 * (1.2f32 / 4.0).atan(), 1.0, 0.5, 8.0),
        size: [240, 240],
    }
}

/// Place of a point in a picture, in pixels.
pub fn project(view: &SceneView, point: Vec3) -> [f32; 2] {
    let clip: Vec4 = view.projection * (view.view * point.extend(1.0));
    let [w, h] = view.size.map(|s| s as f32);
    [(0.5 + 0.5 * clip.x / clip.w) * w, (0.5 - 0.5 * clip.y / clip.w) * h]
}

pub fn draw(gpu: &Gpu, model: &Model, style: &SceneStyle) -> Image {
    draw_from(gpu, model, style, &view())
}

pub fn draw_from(gpu: &Gpu, model: &Model, style: &SceneStyle, view: &SceneView) -> Image {
    let mut scene = Scene::new(gpu);
    scene.set_surface(&model.surface()).expect("a surface");
    scene.render(view, style, None);
    scene.read().expect("a picture")
}

/// Colour at a place of a picture.
pub fn at(image: &Image, [x, y]: [f32; 2]) -> [i32; 3] {
    image.pixel(x as u32, y as u32).expect("a pixel").map(i32::from)
}

/// The largest difference of two colours' channels.
pub fn apart(a: [i32; 3], b: [i32; 3]) -> i32 {
    (0..3).map(|i| (a[i] - b[i]).abs()).max().unwrap_or(0)
}

/// Largest difference of two pictures, and the share of pixels that differ by more than `tolerance`.
pub fn difference(a: &Image, b: &Image, tolerance: i32) -> (i32, f32) {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let all = a.pixels().iter().zip(b.pixels());
    let apart: Vec<i32> = all.map(|(a, b)| apart(a.map(i32::from), b.map(i32::from))).collect();
    let beyond = apart.iter().filter(|d| **d > tolerance).count();
    (apart.iter().copied().max().unwrap_or(0), beyond as f32 / apart.len() as f32)
}

/// Whether two pictures have the same bytes.
pub fn same(a: &Image, b: &Image) -> bool {
    difference(a, b, 0).0 == 0
}

/// Red, to tell surfaces from backgrounds, which are bluish.
pub const RED: [u8; 3] = [210, 50, 40];

/// Whether a pixel shows something red.
pub fn is_red(image: &Image, [x, y]: [f32; 2]) -> bool {
    let [r, _, b] = at(image, [x, y]);
    r > b + 12
}

/// Style of most tests: surfaces show their own colours, and nothing depends on the surroundings.
pub fn plain() -> SceneStyle {
    SceneStyle { own_colors: true, occlusion: false, ..SceneStyle::default() }
}

/// Lit colour that `shade.wgsl` makes of a colour (sRGB), by the formula of `simod_picture`: key light from
/// the upper left, fill light, sky, highlight and rim, without occlusion.
pub fn lit(color: [u8; 3], normal: Vec3, eye: Vec3) -> [i32; 3] {
    let key_way = Vec3::new(-0.50, 0.66, 0.56).normalize_or_zero();
    let key = normal.dot(key_way).max(0.0);
    let fill = normal.dot(Vec3::new(0.80, 0.10, 0.59).normalize_or_zero()).max(0.0);
    let sky = 0.5 + 0.5 * normal.y;
    let light = Vec3::new(0.20, 0.19, 0.18)
        + Vec3::new(0.17, 0.18, 0.20) * sky
        + Vec3::new(1.02, 0.98, 0.92) * key
        + Vec3::new(0.17, 0.19, 0.23) * fill;
    let highlight = normal.dot((key_way + eye).normalize_or_zero()).max(0.0).powi(40) * 0.10 * key;
    let rim = (1.0 - normal.dot(eye).clamp(0.0, 1.0)).powi(4) * 0.10 * sky;
    let linear = |c: u8| {
        let c = f32::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    };
    let shown = |x: f32| {
        let x = if x > 0.8 { 1.0 - 0.2 * (-(x - 0.8) / 0.2).exp() } else { x };
        let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded).round() as i32
    };
    let color = Vec3::from(color.map(linear));
    (color * light + Vec3::splat(highlight + rim)).to_array().map(shown)
}
