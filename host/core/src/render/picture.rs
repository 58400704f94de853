//! Pictures of models and samples: shaded splats, drawn on the processor.

use glam::{DVec3, Vec3, swizzles::Vec3Swizzles};
use serde::Deserialize;

use super::{Camera, Image, Renderer, Spacing, Style, SurfacePoint};
use crate::geometry::Bounds;
use crate::model::{Model, VertexChunk, Vertices, in_step};
use crate::sampled_model::SampledModel;
use crate::{Progress, Result};

/// Of points that need none.
const NO_COLOR: [u8; 3] = [0; 3];

/// The colour of a vertex: of its number in these parts of models that are read in step.
pub type Paint<'a> = dyn Fn(&[Vertices<'_>], usize) -> [u8; 3] + 'a;

/// Radius of a sample's disc over its spacing: wide enough to leave no holes where the density changes.
const SAMPLE_RADIUS: f64 = 1.35;

/// From where, and how large.
#[derive(Debug, Clone, Copy)]
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
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Up {
    /// The first.
    X,
    /// The second.
    #[default]
    Y,
    /// The third.
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
    fn renderer(&self, own_colors: bool) -> Renderer {
        let [w, h] = self.size;
        let bounds = [self.up.turned(self.bounds.min), self.up.turned(self.bounds.max)];
        let aspect = f64::from(w) / f64::from(h.max(1));
        let camera = Camera::frame(bounds, self.yaw.to_radians(), self.pitch.to_radians(), aspect);
        Renderer::new(w, h, camera, Style { own_colors, ground: Some(bounds[0].y) })
    }
}

/// Bounding box of a model's finite positions.
///
/// # Errors
/// The model cannot be read; the user cancelled.
pub fn bounds(model: &dyn Model, progress: &dyn Progress) -> Result<Bounds> {
    let mut bounds = Bounds::default();
    stream(model, "measuring", progress, |chunk| {
        chunk.positions.iter().filter(|p| p.is_finite()).for_each(|p| bounds.include(*p));
    })?;
    Ok(bounds)
}

/// Draws a model in three streams: the spacing of its vertices, the visible surface, its shading.
///
/// # Errors
/// The model cannot be read; the user cancelled.
pub fn of_model(model: &dyn Model, bounds: &Bounds, view: &View, progress: &dyn Progress) -> Result<Image> {
    draw(&[model], bounds, view, None, progress)
}

/// As [`of_model`], for the first of several models that are read [in step](in_step): `paint` gives its vertices' colours.
///
/// # Errors
/// A model cannot be read, or they differ in their number of vertices; the user cancelled.
pub fn of_painted(
    models: &[&dyn Model],
    bounds: &Bounds,
    view: &View,
    paint: &Paint<'_>,
    progress: &dyn Progress,
) -> Result<Image> {
    draw(models, bounds, view, Some(paint), progress)
}

fn draw(
    models: &[&dyn Model],
    bounds: &Bounds,
    view: &View,
    paint: Option<&Paint<'_>>,
    progress: &dyn Progress,
) -> Result<Image> {
    let mut spacing = Spacing::new([bounds.min, bounds.max]);
    stream(models[0], "drawing", progress, |chunk| spacing.add(chunk.positions.iter().copied()))?;
    let points_of = |parts: &[Vertices<'_>]| -> Vec<SurfacePoint> {
        let Vertices { positions, normals } = parts[0];
        let point = |(i, p): (usize, &DVec3)| SurfacePoint {
            position: view.up.turned(*p),
            normal: view.up.turned(normals.get(i).map_or(DVec3::ZERO, |n| n.as_dvec3())).as_vec3(),
            color: paint.map_or(NO_COLOR, |paint| paint(parts, i)),
            radius: spacing.radius_at(*p),
        };
        positions.iter().enumerate().map(point).collect()
    };
    let mut renderer = view.renderer(paint.is_some());
    let pass = |draw: &mut dyn FnMut(&[SurfacePoint])| {
        progress.begin("drawing", models[0].info().vertex_bytes);
        in_step(models, progress, |parts| {
            draw(&points_of(parts));
            Ok(())
        })
    };
    pass(&mut |points| renderer.depth(points))?;
    pass(&mut |points| renderer.blend(points))?;
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
            color: NO_COLOR,
            radius: (SAMPLE_RADIUS * f64::from(*spacing) * sampled.frame.scale) as f32,
        })
        .collect();
    let mut renderer = view.renderer(false);
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
