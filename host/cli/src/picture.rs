//! Pictures of models and samples: shaded splats, drawn on the processor.

use simod_core::geometry::Bounds;
use simod_core::model::{Model, VertexChunk};
use simod_core::render::{Camera, Image, Renderer, Spacing, Style, SurfacePoint};
use simod_core::sampled_model::SampledModel;
use simod_core::{Progress, Result};

use glam::{DVec3, Vec3, swizzles::Vec3Swizzles};

/// Colour of the clay where a point has none of its own.
const CLAY: [u8; 3] = [200, 190, 180];

/// Radius of a sample's disc over its spacing: wide enough to leave no holes where the density changes.
const SAMPLE_RADIUS: f64 = 1.35;

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
    /// Which of the model's axes points up.
    pub up: Up,
}

/// The model's axis that points up in the picture.
#[derive(Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Up {
    X,
    #[default]
    Y,
    Z,
}

impl Up {
    /// Turns the model's axes, in their order, so that the one that is up becomes y.
    fn turned(self, p: DVec3) -> DVec3 {
        match self {
            Self::X => p.zxy(),
            Self::Y => p,
            Self::Z => p.yzx(),
        }
    }
}

impl View {
    fn renderer(&self) -> Renderer {
        let [w, h] = self.size;
        let bounds = [self.up.turned(self.bounds.min), self.up.turned(self.bounds.max)];
        let aspect = f64::from(w) / f64::from(h.max(1));
        let camera = Camera::frame(bounds, self.yaw.to_radians(), self.pitch.to_radians(), aspect);
        Renderer::new(w, h, camera, Style { own_colors: false, ground: Some(bounds[0].y) })
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
    let points_of = |chunk: &VertexChunk| -> Vec<SurfacePoint> {
        let point = |(i, p): (usize, &DVec3)| SurfacePoint {
            position: view.up.turned(*p),
            normal: view.up.turned(chunk.normals.get(i).map_or(DVec3::ZERO, |n| n.as_dvec3())).as_vec3(),
            color: CLAY,
            radius: spacing.radius_at(*p),
        };
        chunk.positions.iter().enumerate().map(point).collect()
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
        .zip(sampled.samples.spacing())
        .map(|((p, n), spacing)| SurfacePoint {
            position: view.up.turned(sampled.frame.to_model(*p)),
            normal: view.up.turned(n.as_dvec3()).as_vec3(),
            color: CLAY,
            radius: (SAMPLE_RADIUS * f64::from(*spacing) * sampled.frame.scale) as f32,
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
