//! Pictures of models and samples: shaded splats, drawn on the processor.

use simod_core::geometry::Bounds;
use simod_core::model::{Model, VertexChunk};
use simod_core::render::{Camera, Image, Renderer, Spacing, Style, SurfacePoint};
use simod_core::sampled_model::SampledModel;
use simod_core::{Progress, Result};

use glam::Vec3;

/// Colour of the clay where a point has none of its own.
const CLAY: [u8; 3] = [200, 190, 180];

/// From where, and how large.
#[derive(Clone, Copy)]
pub struct View {
    /// What fills the picture.
    pub bounds: Bounds,
    /// Turned to the right about +y from +z, in degrees.
    pub yaw: f64,
    /// Looking down, in degrees.
    pub pitch: f64,
    /// Picture size in pixels.
    pub size: [u32; 2],
}

impl View {
    fn renderer(&self) -> Renderer {
        let [w, h] = self.size;
        let bounds = [self.bounds.min, self.bounds.max];
        let aspect = f64::from(w) / f64::from(h.max(1));
        let camera = Camera::frame(bounds, self.yaw.to_radians(), self.pitch.to_radians(), aspect);
        Renderer::new(w, h, camera, Style { own_colors: false, ground: Some(self.bounds.min.y) })
    }
}

/// Bounding box of a model's finite positions.
pub fn bounds(model: &dyn Model, progress: &dyn Progress) -> Result<Bounds> {
    let mut bounds = Bounds::default();
    stream(model, "measuring", progress, |chunk| {
        chunk.positions.iter().filter(|p| p.is_finite()).for_each(|p| bounds.include(*p));
    })?;
    Ok(bounds)
}

/// Draws a model in three streams: the spacing of its vertices, the visible surface, its shading.
pub fn of_model(model: &dyn Model, bounds: &Bounds, view: &View, progress: &dyn Progress) -> Result<Image> {
    let mut spacing = Spacing::new([bounds.min, bounds.max]);
    stream(model, "drawing", progress, |chunk| spacing.add(chunk.positions.iter().copied()))?;
    let mut points = Vec::new();
    let mut points_of = |chunk: &VertexChunk| {
        points.clear();
        points.extend(chunk.positions.iter().enumerate().map(|(i, p)| SurfacePoint {
            position: *p,
            normal: chunk.normals.get(i).copied().unwrap_or(Vec3::ZERO),
            color: CLAY,
            radius: spacing.radius_at(*p),
        }));
        std::mem::take(&mut points)
    };
    let mut renderer = view.renderer();
    stream(model, "drawing", progress, |chunk| renderer.depth(&points_of(chunk)))?;
    stream(model, "drawing", progress, |chunk| renderer.blend(&points_of(chunk)))?;
    Ok(renderer.finish())
}

/// Draws samples at local `positions`, each as a disc that its neighbours overlap a little.
pub fn of_samples(sampled: &SampledModel, positions: &[Vec3], normals: &[Vec3], view: &View) -> Image {
    let points: Vec<SurfacePoint> = positions
        .iter()
        .zip(normals)
        .zip(&sampled.samples.spacing)
        .map(|((p, n), spacing)| SurfacePoint {
            position: sampled.frame.to_model(*p),
            normal: *n,
            color: CLAY,
            radius: (f64::from(*spacing) * sampled.frame.scale) as f32,
        })
        .collect();
    let mut renderer = view.renderer();
    renderer.depth(&points);
    renderer.blend(&points);
    renderer.finish()
}

fn stream(
    model: &dyn Model,
    stage: &'static str,
    progress: &dyn Progress,
    mut visit: impl FnMut(&VertexChunk),
) -> Result<()> {
    progress.begin(stage, model.info().vertex_bytes);
    let mut reader = model.vertices(0..model.info().vertices)?;
    let mut chunk = VertexChunk::default();
    while reader.read(&mut chunk)? {
        progress.check()?;
        visit(&chunk);
        progress.advance(chunk.raw().len() as u64);
    }
    Ok(())
}
