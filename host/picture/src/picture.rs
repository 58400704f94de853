//! Pictures of models and samples: shaded splats, drawn on the processor.

use glam::{DVec3, Vec3, swizzles::Vec3Swizzles};
use serde::Deserialize;
use simod_core::ellipses::Ellipses;
use simod_core::sampled_model::SampledModel;
use simod_model::bounds::Bounds;
use simod_model::{Model, Progress, Result, VertexChunk, Vertices, in_step};

use super::{Camera, Image, Paint, Renderer, Spacing, Style, SurfacePoint};

/// The colour of a vertex: of its number in these parts of models that are read in step.
pub type PaintBy<'a> = dyn Fn(&[Vertices<'_>], usize) -> [u8; 3] + 'a;

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
    /// What of it is shown.
    pub crop: Crop,
}

/// A part of a picture, from the same place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crop {
    /// The model's point in the middle; that of the bounds where it is not given.
    pub around: Option<DVec3>,
    /// Its width over that of the whole: above 0.
    pub part: f64,
}

impl Default for Crop {
    /// The whole.
    fn default() -> Self {
        Self { around: None, part: 1.0 }
    }
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
    fn camera(&self) -> Camera {
        self.cropped(self.whole())
    }

    fn cropped(&self, camera: Camera) -> Camera {
        camera.crop(self.crop.around.map(|p| self.up.turned(p)), self.crop.part)
    }

    /// The camera that shows everything.
    fn whole(&self) -> Camera {
        let [w, h] = self.size;
        let bounds = [self.up.turned(self.bounds.min), self.up.turned(self.bounds.max)];
        let aspect = f64::from(w) / f64::from(h.max(1));
        Camera::frame(bounds, self.yaw.to_radians(), self.pitch.to_radians(), aspect)
    }

    /// The cameras of a full turn, evenly spaced. All are as far away as the farthest of those that just show
    /// everything: nothing is cut, and the model does not seem to grow and shrink.
    fn turn(&self, frames: u32) -> Vec<Camera> {
        let yaw = |k| self.yaw + 360.0 * f64::from(k) / f64::from(frames);
        let cameras: Vec<Camera> = (0..frames).map(|k| Self { yaw: yaw(k), ..*self }.whole()).collect();
        let farthest = cameras.iter().map(Camera::distance).fold(0.0, f64::max);
        cameras.into_iter().map(|camera| self.cropped(camera.at_least(farthest))).collect()
    }

    fn renderer(&self, camera: Camera, own_colors: bool) -> Renderer {
        let [w, h] = self.size;
        let ground = Some(self.up.turned(self.bounds.min).y);
        Renderer::new(w, h, camera, Style { own_colors, ground })
    }
}

/// Takes the pictures of a turn, one after the other.
pub type Frames<'a> = dyn FnMut(&Image) -> Result<()> + 'a;

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
pub fn of_model(
    model: &dyn Model,
    bounds: &Bounds,
    view: &View,
    paint: &Paint,
    progress: &dyn Progress,
) -> Result<Image> {
    let spacing = spacing(model, bounds, progress)?;
    draw_painted(model, &spacing, view, view.camera(), paint, progress)
}

/// As [`of_model`], so many times while the camera goes once round the vertical axis, in one stream more than
/// two for each picture. It stands as far back for all as some of them need; the first is that of
/// [`of_model`] if it is one of these.
///
/// # Errors
/// The model cannot be read; `frame` refuses a picture; the user cancelled.
pub fn turn_of_model(
    model: &dyn Model,
    bounds: &Bounds,
    view: &View,
    paint: &Paint,
    frames: u32,
    frame: &mut Frames<'_>,
    progress: &dyn Progress,
) -> Result<()> {
    let spacing = spacing(model, bounds, progress)?;
    let draw = |camera| draw_painted(model, &spacing, view, camera, paint, progress);
    view.turn(frames).into_iter().try_for_each(|camera| frame(&draw(camera)?))
}

/// As [`of_model`], for the first of several models that are read [in step](in_step): `paint` gives its
/// vertices' colours, and may ask for so many of its first attributes.
///
/// # Errors
/// A model cannot be read, or they differ in their number of vertices; the user cancelled.
pub fn of_painted(
    models: &[&dyn Model],
    bounds: &Bounds,
    view: &View,
    (attributes, paint): (usize, &PaintBy<'_>),
    progress: &dyn Progress,
) -> Result<Image> {
    let spacing = spacing(models[0], bounds, progress)?;
    draw(models, &spacing, view, view.camera(), Some((attributes, paint)), progress)
}

fn draw_painted(
    model: &dyn Model,
    spacing: &Spacing,
    view: &View,
    camera: Camera,
    paint: &Paint,
    progress: &dyn Progress,
) -> Result<Image> {
    let by_attributes = |parts: &[Vertices<'_>], i: usize| paint.color(|place| parts[0].attribute(place, i));
    let by = paint.is_colored().then_some((paint.count(), &by_attributes as &PaintBy<'_>));
    draw(&[model], spacing, view, camera, by, progress)
}

fn spacing(model: &dyn Model, bounds: &Bounds, progress: &dyn Progress) -> Result<Spacing> {
    let mut spacing = Spacing::new([bounds.min, bounds.max]);
    stream(model, "drawing", progress, |chunk| spacing.add(chunk.positions.iter().copied()))?;
    Ok(spacing)
}

/// Draws points, and the half axes of those that are ellipses.
type Drawing<'a> = dyn FnMut(&[SurfacePoint], &[[Vec3; 2]]) + 'a;

fn draw(
    models: &[&dyn Model],
    spacing: &Spacing,
    view: &View,
    camera: Camera,
    paint: Option<(usize, &PaintBy<'_>)>,
    progress: &dyn Progress,
) -> Result<Image> {
    let ellipses = Ellipses::of(&models[0].info().attributes);
    let points_of = |parts: &[Vertices<'_>]| -> (Vec<SurfacePoint>, Vec<[Vec3; 2]>) {
        let Vertices { positions, normals, .. } = parts[0];
        let (mut points, mut axes) = (Vec::with_capacity(positions.len()), Vec::new());
        for (i, p) in positions.iter().enumerate() {
            let mut point = SurfacePoint {
                position: view.up.turned(*p),
                normal: view.up.turned(normals.get(i).map_or(DVec3::ZERO, |n| n.as_dvec3())).as_vec3(),
                color: paint.map_or([0; 3], |(_, paint)| paint(parts, i)),
                radius: spacing.radius_at(*p),
            };
            if let Some(ellipses) = &ellipses {
                // One that is not seen has no size.
                let none = ([DVec3::NAN; 2], DVec3::NAN);
                let (half, normal) = ellipses.ellipse(|place| parts[0].attribute(place, i)).unwrap_or(none);
                point.normal = view.up.turned(normal).as_vec3();
                point.radius = half[0].length() as f32;
                axes.push(half.map(|axis| view.up.turned(axis).as_vec3()));
            }
            points.push(point);
        }
        (points, axes)
    };
    let wanted =
        paint.map_or(0, |(attributes, _)| attributes).max(ellipses.as_ref().map_or(0, Ellipses::count));
    let mut renderer = view.renderer(camera, paint.is_some());
    let pass = |draw: &mut Drawing<'_>| {
        progress.begin("drawing", models[0].info().vertex_bytes);
        in_step(models, wanted, progress, |parts| {
            let (points, axes) = points_of(parts);
            draw(&points, &axes);
            Ok(())
        })
    };
    pass(&mut |points, axes| renderer.depth_of(points, axes))?;
    pass(&mut |points, axes| renderer.blend_of(points, axes))?;
    Ok(renderer.finish())
}

/// Draws samples at local `positions`, each as a disc that its neighbours overlap a little, in colours of which there
/// is one for each, if there are any.
pub fn of_samples(
    sampled: &SampledModel,
    positions: &[Vec3],
    normals: &[Vec3],
    view: &View,
    colors: Option<&[[u8; 3]]>,
) -> Image {
    drawn(&discs(sampled, positions, normals, view, colors), view, view.camera(), colors.is_some())
}

/// As [`of_samples`], so many times while the camera goes once round the vertical axis; see
/// [`turn_of_model`].
///
/// # Errors
/// `frame` refuses a picture; the user cancelled.
pub fn turn_of_samples(
    sampled: &SampledModel,
    view: &View,
    colors: Option<&[[u8; 3]]>,
    frames: u32,
    frame: &mut Frames<'_>,
    progress: &dyn Progress,
) -> Result<()> {
    let samples = &sampled.samples;
    let points = discs(sampled, &samples.positions, samples.normals(), view, colors);
    view.turn(frames).into_iter().try_for_each(|camera| {
        progress.check()?;
        frame(&drawn(&points, view, camera, colors.is_some()))
    })
}

fn discs(
    sampled: &SampledModel,
    positions: &[Vec3],
    normals: &[Vec3],
    view: &View,
    colors: Option<&[[u8; 3]]>,
) -> Vec<SurfacePoint> {
    let disc = |(i, ((p, n), spacing)): (usize, ((&Vec3, &Vec3), &f32))| SurfacePoint {
        position: view.up.turned(sampled.frame.to_model(*p)),
        normal: view.up.turned(n.as_dvec3()).as_vec3(),
        color: colors.map_or([0; 3], |colors| colors[i]),
        radius: (SAMPLE_RADIUS * f64::from(*spacing) * sampled.frame.scale) as f32,
    };
    positions.iter().zip(normals).zip(&sampled.samples.extents()).enumerate().map(disc).collect()
}

fn drawn(points: &[SurfacePoint], view: &View, camera: Camera, own_colors: bool) -> Image {
    let mut renderer = view.renderer(camera, own_colors);
    renderer.depth(points);
    renderer.blend(points);
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
    reader.skip_attributes();
    let mut chunk = VertexChunk::default();
    while reader.read(&mut chunk)? {
        progress.check()?;
        visit(&chunk);
        progress.advance(chunk.raw().len() as u64);
    }
    Ok(())
}
