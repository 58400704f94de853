//! Times of frames: `frame-times [--picture FOLDER] [THOUSANDS OF SPLATS ...]` (200, 1000 and 5000 by
//! default).
//!
//! Medians over frames of a turning model, each waited for. With `--picture`, writes the pictures, too.
#![allow(clippy::print_stdout, reason = "a program that tells what it measured")]

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::Vec3;
use glam::camera::rh::proj::directx::perspective;
use glam::camera::rh::view::look_at_mat4;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::{ModelOptions, Shape};
use simod_model::progress::Silent;
use simod_scene::{
    Background, Budget, Dot, Gpu, Light, Line, PixelScale, Scene, SceneStyle, SceneSurface, SceneView,
    SurfaceMode,
};

const SIZE: [u32; 2] = [1600, 1000];
/// Radius of a disc over the spacing of samples.
const RADIUS: f32 = 1.35;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).peekable();
    let folder = arguments.next_if(|a| a == "--picture").and_then(|_| arguments.next()).map(PathBuf::from);
    let thousands: Vec<usize> = arguments.map(|a| a.parse()).collect::<Result<_, _>>()?;
    let thousands = if thousands.is_empty() { vec![200, 1000, 5000] } else { thousands };

    let gpu = Gpu::headless()?;
    println!(
        "{}{}, {} x {}",
        gpu.name(),
        if gpu.is_software() { ", software" } else { "" },
        SIZE[0],
        SIZE[1]
    );
    println!("{:>10}  {:<34} {:>10}  {:>10}", "samples", "frame", "ms", "drawn");
    for thousands in thousands {
        let sampled = sampled(Shape::Amphora, 1000 * thousands)?;
        measure(&gpu, &sampled)?;
        if let Some(folder) = &folder {
            pictures(&gpu, &sampled, &folder.join(format!("{thousands}k")))?;
        }
    }
    Ok(())
}

/// Samples of a generated model of eight times as many vertices.
fn sampled(shape: Shape, samples: usize) -> Result<SampledModel, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("model.ply");
    let options = ModelOptions { shape, vertices: 8 * samples as u64, ..ModelOptions::default() };
    simod_generate::write_file(&options, &path, &Silent)?;
    let model = simod_model::open(&path)?;
    let sampling = Sampling { target: Target::Samples(samples as u64), ..Sampling::default() };
    Ok(sample(model.as_ref(), &sampling, folder.path(), &Silent)?)
}

fn measure(gpu: &Gpu, sampled: &SampledModel) -> Result<(), Box<dyn Error>> {
    let set = &sampled.samples;
    let radii: Vec<f32> = set.spacing().iter().map(|s| RADIUS * s).collect();
    let mut scene = Scene::new(gpu);
    let surface = SceneSurface {
        positions: &set.positions,
        normals: set.normals(),
        radii: &radii,
        triangles: &sampled.triangles,
        ..SceneSurface::default()
    };
    timed(set.len(), "upload of the surface", || {
        scene.set_surface(&surface).map(|()| gpu.wait()).map(|()| set.len())
    })?;
    timed(set.len(), "upload of positions and normals", || {
        scene.set_positions(&set.positions, set.normals()).map(|()| gpu.wait()).map(|()| set.len())
    })?;

    let style = SceneStyle::default();
    let plain = SceneStyle { occlusion: false, ..style };
    let mut budget = Budget::new(Duration::from_millis(40));
    let mut turn = 0.0;
    let mut frame = |style: &SceneStyle, budget: Option<&mut Budget>| {
        turn += 0.05;
        scene.render(&around(&set.positions, turn), style, budget);
        gpu.wait();
        Ok(scene.drawn().drawn)
    };
    timed(set.len(), "splats", || frame(&style, None))?;
    timed(set.len(), "splats, no occlusion", || frame(&plain, None))?;
    timed(set.len(), "splats, four pixels for one", || {
        frame(&SceneStyle { scale: PixelScale::Double, ..style }, None)
    })?;
    for _ in 0..12 {
        frame(&style, Some(&mut budget))?;
    }
    timed(set.len(), "splats, budget of 40 ms", || frame(&style, Some(&mut budget)))?;
    timed(set.len(), "triangles", || frame(&SceneStyle { mode: SurfaceMode::Triangles, ..style }, None))
}

/// Prints the median of some frames' times, after one to warm up.
fn timed<E>(samples: usize, what: &str, mut frame: impl FnMut() -> Result<usize, E>) -> Result<(), E> {
    let mut drawn = frame()?;
    let mut times = Vec::new();
    for _ in 0..7 {
        let started = Instant::now();
        drawn = frame()?;
        times.push(1e3 * started.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    println!("{samples:>10}  {what:<34} {:>10.1}  {drawn:>10}", times[times.len() / 2]);
    Ok(())
}

/// A view of all positions, from a little above, turned about the vertical axis.
fn around(positions: &[Vec3], turn: f32) -> SceneView {
    let (low, high) =
        positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let (middle, radius) = (0.5 * (low + high), 0.5 * (high - low).length());
    let distance = 3.6 * radius;
    let way = Vec3::new(turn.sin(), 0.35, turn.cos()).normalize_or_zero();
    SceneView {
        view: look_at_mat4(middle + distance * way, middle, Vec3::Y),
        projection: perspective(0.52, SIZE[0] as f32 / SIZE[1] as f32, 0.1 * distance, 2.0 * distance),
        size: SIZE,
    }
}

/// A lattice around the model, under a map.
fn lattice(map: impl Fn(Vec3) -> Vec3) -> (Vec<Line>, Vec<Dot>) {
    let corners =
        |i: usize| Vec3::new((i % 3) as f32 - 1.0, (i / 3 % 4) as f32 / 1.5 - 1.0, (i / 12) as f32 - 1.0);
    let corner = |i: usize| map(corners(i) * Vec3::new(0.32, 0.52, 0.32));
    let mut lines = Vec::new();
    for i in 0..36 {
        for (step, within) in [(1, i % 3 < 2), (3, i / 3 % 4 < 3), (12, i / 12 < 2)] {
            if within {
                let (a, b) = (corner(i), corner(i + step));
                lines.push(Line { a, b, color: [40, 90, 160, 255], width_px: 1.5, on_top: false });
            }
        }
    }
    let dot = |i| Dot { position: corner(i), color: [235, 130, 20, 255], size_px: 9.0, on_top: i % 3 == 2 };
    (lines, (0..36).map(dot).collect())
}

fn pictures(gpu: &Gpu, sampled: &SampledModel, folder: &Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let set = &sampled.samples;
    let radii: Vec<f32> = set.spacing().iter().map(|s| RADIUS * s).collect();
    let rest = SceneSurface {
        positions: &set.positions,
        normals: set.normals(),
        radii: &radii,
        triangles: &sampled.triangles,
        ..SceneSurface::default()
    };
    let mut scene = Scene::new(gpu);
    scene.set_surface(&rest)?;
    let shot =
        |scene: &mut Scene, name: &str, style: &SceneStyle, budget: Option<&mut Budget>, view: &SceneView| {
            let started = Instant::now();
            scene.render(view, style, budget);
            gpu.wait();
            println!("{:>10}  {name}: {:.0} ms", set.len(), 1e3 * started.elapsed().as_secs_f64());
            let picture = scene.read().ok_or("the device is lost")?;
            let file = folder.join(format!("{name}.png"));
            simod_model::output::write_file(&file, &picture.to_png()?)?;
            Ok::<(), Box<dyn Error>>(())
        };
    let view = around(&set.positions, 0.6);
    let near = SceneView { view: view.view, projection: perspective(0.12, 1.6, 0.5, 10.0), size: SIZE };
    let style = SceneStyle::default();
    shot(&mut scene, "splats", &style, None, &view)?;
    shot(&mut scene, "one-sided", &SceneStyle { two_sided: false, ..style }, None, &view)?;
    shot(&mut scene, "near", &style, None, &near)?;
    shot(&mut scene, "double", &SceneStyle { scale: PixelScale::Double, ..style }, None, &view)?;
    shot(&mut scene, "coarse", &SceneStyle { scale: PixelScale::Half, ..style }, None, &view)?;
    shot(&mut scene, "triangles", &SceneStyle { mode: SurfaceMode::Triangles, ..style }, None, &view)?;
    let dark = SceneStyle { background: Background::Dark, light: Light::Head, ..style };
    shot(&mut scene, "dark", &dark, None, &view)?;
    shot(&mut scene, "budget", &style, Some(&mut Budget::new(Duration::from_millis(40))), &view)?;

    // The model is bent to the side, beside the ghost of its rest shape, with a lattice.
    let bent = |p: Vec3| Vec3::new(p.x + 0.35 * (p.y + 0.5) * (p.y + 0.5), p.y, p.z);
    let positions: Vec<Vec3> = set.positions.iter().map(|p| bent(*p)).collect();
    scene.set_positions(&positions, set.normals())?;
    scene.set_ghost(Some(&rest))?;
    let (lines, dots) = lattice(bent);
    scene.set_lines(&lines);
    scene.set_dots(&dots);
    shot(&mut scene, "bent", &style, None, &view)?;
    shot(&mut scene, "bent-dark", &dark, None, &view)
}
