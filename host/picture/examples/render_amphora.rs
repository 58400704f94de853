//! Generates the amphora and draws it, streaming throughout:
//! `cargo run --release -p simod-picture --example render_amphora -- [FOLDER] [VERTICES]...`
#![allow(clippy::print_stdout, reason = "a program for people")]

use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use glam::DVec3;
use simod_generate::{Shape, Surface};
use simod_model::Result;
use simod_picture::{Image, PictureCamera, Renderer, Spacing, Style, SurfaceDisc};

fn main() -> std::result::Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().unwrap_or_else(|| ".".into());
    let mut counts = arguments.map(|count| count.parse()).collect::<std::result::Result<Vec<u64>, _>>()?;
    if counts.is_empty() {
        counts = vec![300_000, 2_000_000];
    }

    for vertices in counts {
        let surface = Surface::new(Shape::Amphora, vertices)?;
        let model = Model::measure(&surface)?;
        let start = Instant::now();
        let whole = model.picture(model.bounds, 0.35, 0.2, Style { own_colors: true, ground: Some(0.0) })?;
        println!("{vertices} vertices drawn in {:.2} s", start.elapsed().as_secs_f64());
        let clay = model.picture(model.bounds, 0.9, 0.3, Style { own_colors: false, ground: Some(0.0) })?;
        let belly = [DVec3::new(-0.3, 0.6, 0.3), DVec3::new(0.3, 1.25, 0.6)];
        let detail = model.picture(belly, 0.0, 0.1, Style { own_colors: false, ground: None })?;
        let caption = format!("{vertices} vertices");
        let path = |part: &str| Path::new(&folder).join(format!("amphora-{vertices}{part}.png"));
        save(&Image::side_by_side(&[(&whole, &caption), (&clay, "clay"), (&detail, "detail")]), &path(""))?;
        save(&whole, &path("-whole"))?;
        save(&clay, &path("-clay"))?;
        save(&detail, &path("-detail"))?;
    }
    Ok(())
}

/// Surface, and the results of a first pass over it.
struct Model<'a> {
    surface: &'a Surface,
    bounds: [DVec3; 2],
    spacing: Spacing,
}

impl<'a> Model<'a> {
    fn measure(surface: &'a Surface) -> Result<Self> {
        let start = Instant::now();
        let (mut low, mut high) = (DVec3::MAX, DVec3::MIN);
        surface.visit_vertices(|block| {
            for vertex in block {
                low = low.min(vertex.position);
                high = high.max(vertex.position);
            }
            Ok(())
        })?;
        let seconds = start.elapsed().as_secs_f64();
        println!("{:.1} M vertices/s generated", surface.vertices() as f64 * 1e-6 / seconds);
        let bounds = [low, high];
        let mut spacing = Spacing::new(bounds);
        surface.visit_vertices(|block| {
            spacing.add(block.iter().map(|vertex| vertex.position));
            Ok(())
        })?;
        Ok(Self { surface, bounds, spacing })
    }

    fn picture(&self, view: [DVec3; 2], yaw: f64, pitch: f64, style: Style) -> Result<Image> {
        const WIDTH: u32 = 900;
        const HEIGHT: u32 = 1100;
        let camera = PictureCamera::frame(view, yaw, pitch, f64::from(WIDTH) / f64::from(HEIGHT));
        let mut renderer = Renderer::new(WIDTH, HEIGHT, camera, style);
        self.visit(|points| renderer.depth(points))?;
        self.visit(|points| renderer.blend(points))?;
        Ok(renderer.finish())
    }

    fn visit(&self, mut draw: impl FnMut(&[SurfaceDisc])) -> Result<()> {
        let mut points = Vec::new();
        self.surface.visit_vertices(|block| {
            points.clear();
            points.extend(block.iter().map(|vertex| SurfaceDisc {
                position: vertex.position,
                normal: vertex.normal,
                color: vertex.color,
                radius: self.spacing.radius_at(vertex.position),
            }));
            draw(&points);
            Ok(())
        })
    }
}

fn save(image: &Image, path: &Path) -> std::result::Result<(), Box<dyn Error>> {
    File::create(path)?.write_all(&image.to_png()?)?;
    println!("wrote {}", path.display());
    Ok(())
}
