//! Pictures of models and samples: shaded triangles and splats, drawn on the processor.

use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_core::ellipses::Ellipses;
use simod_core::sampled_model::SampledModel;
use simod_model::bounds::Bounds;
use simod_model::{CHUNK_TRIANGLES, CHUNK_VERTICES, Model, Progress, Result, VertexChunk, Vertices, in_step};

pub use super::paint::PaintBy;
use super::paint::Painted;
pub use super::view::{Crop, PictureView, UpAxis};

use super::mesh::{DrawnMesh, are_many};
use super::{Image, Paint, PictureCamera, Spacing, SurfaceDisc};

/// Radius of a sample's disc over its spacing: wide enough to leave no holes where the density changes.
const SAMPLE_RADIUS: f64 = 1.35;

/// Factor by which discs of points that were chosen by chance are wider: there is more room between some of
/// them.
const UNEVEN: f32 = 1.5;

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

/// Part of a model that is drawn: its vertices, or its faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn<'a> {
    /// Vertices alone, as discs.
    Points,
    /// Triangles where the model has faces, and discs for vertices that no triangle has, where these are a
    /// tenth of all. Of a model with faces that is large, a temporary file without a name is made in this
    /// folder: 28 bytes for each vertex.
    Faces(&'a Path),
}

/// Draws a model. Of vertices alone in three streams: their spacing, the visible surface, its shading; of
/// faces in one stream of the vertices, and three of the faces: which vertices are theirs, the visible
/// surface, its shading.
///
/// # Errors
/// The model cannot be read; a temporary file cannot be written; the user cancelled.
pub fn of_model(
    model: &dyn Model,
    bounds: &Bounds,
    view: &PictureView,
    (paint, drawn): (&Paint, Drawn<'_>),
    progress: &dyn Progress,
) -> Result<Image> {
    with_paint(paint, |by| {
        ShownModel::new(&[model], bounds, by, drawn, progress)?.draw(view, view.camera(), progress)
    })
}

/// Draws a model as [`of_model`] does, so many times while the camera goes once round the vertical axis, in
/// one or two streams more than two for each picture. The camera stands as far back for all pictures as some
/// of them need; the first picture is that of [`of_model`] if it is one of these.
///
/// # Errors
/// As of [`of_model`]; `frame` refuses a picture.
pub fn turn_of_model(
    model: &dyn Model,
    bounds: &Bounds,
    view: &PictureView,
    (paint, drawn): (&Paint, Drawn<'_>),
    frames: (u32, &mut Frames<'_>),
    progress: &dyn Progress,
) -> Result<()> {
    with_paint(paint, |by| {
        let models = [model];
        let shown = ShownModel::new(&models, bounds, by, drawn, progress)?;
        let draw = |camera| shown.draw(view, camera, progress);
        view.turn(frames.0).into_iter().try_for_each(|camera| (frames.1)(&draw(camera)?))
    })
}

/// Draws as [`of_model`] does the first of several models that are read [in step](in_step), one picture for
/// each view: `paint` gives its vertices' colours, and may ask for so many of its first attributes.
///
/// # Errors
/// As of [`of_model`]; models differ in their number of vertices.
pub fn of_painted(
    models: &[&dyn Model],
    bounds: &Bounds,
    views: &[PictureView],
    (attributes, paint, drawn): (usize, &PaintBy<'_>, Drawn<'_>),
    progress: &dyn Progress,
) -> Result<Vec<Image>> {
    if views.is_empty() {
        return Ok(Vec::new());
    }
    let shown = ShownModel::new(models, bounds, Some((attributes, paint)), drawn, progress)?;
    views.iter().map(|view| shown.draw(view, view.camera(), progress)).collect()
}

fn with_paint<T>(paint: &Paint, draw: impl FnOnce(Painted<'_>) -> Result<T>) -> Result<T> {
    let by_attributes = |parts: &[Vertices<'_>], i: usize| paint.color(|place| parts[0].attribute(place, i));
    draw(paint.is_colored().then_some((paint.count(), &by_attributes)))
}

/// Model that is drawn, from any place.
enum ShownModel<'a> {
    Mesh(Box<DrawnMesh<'a>>, bool),
    Points(&'a [&'a dyn Model], Spacing, Painted<'a>),
}

impl<'a> ShownModel<'a> {
    fn new(
        models: &'a [&'a dyn Model],
        bounds: &Bounds,
        paint: Painted<'a>,
        drawn: Drawn<'_>,
        progress: &dyn Progress,
    ) -> Result<Self> {
        match drawn {
            Drawn::Faces(folder) if models[0].info().faces > 0 => {
                let mesh = DrawnMesh::new(models, bounds, paint, folder, progress)?;
                Ok(Self::Mesh(Box::new(mesh), paint.is_some()))
            }
            _ => Ok(Self::Points(models, spacing(models[0], bounds, progress)?, paint)),
        }
    }

    fn draw(&self, view: &PictureView, camera: PictureCamera, progress: &dyn Progress) -> Result<Image> {
        match self {
            Self::Mesh(mesh, own_colors) => {
                let mut renderer = view.renderer(camera, *own_colors);
                mesh.draw(&mut renderer, view.up, progress)?;
                Ok(renderer.finish())
            }
            Self::Points(models, spacing, paint) => draw(models, spacing, view, camera, *paint, progress),
        }
    }
}

fn spacing(model: &dyn Model, bounds: &Bounds, progress: &dyn Progress) -> Result<Spacing> {
    let mut spacing = Spacing::new([bounds.min, bounds.max]);
    stream(model, "drawing", progress, |chunk| spacing.add(chunk.positions.iter().copied()))?;
    Ok(spacing)
}

/// Function that draws points, and the half axes of those that are ellipses.
type PointDrawing<'a> = dyn FnMut(&[SurfaceDisc], &[[Vec3; 2]]) + 'a;

fn draw(
    models: &[&dyn Model],
    spacing: &Spacing,
    view: &PictureView,
    camera: PictureCamera,
    paint: Painted<'_>,
    progress: &dyn Progress,
) -> Result<Image> {
    let ellipses = Ellipses::from_attributes(&models[0].info().attributes);
    let points_of = |parts: &[Vertices<'_>]| -> (Vec<SurfaceDisc>, Vec<[Vec3; 2]>) {
        let Vertices { positions, normals, .. } = parts[0];
        let (mut points, mut axes) = (Vec::with_capacity(positions.len()), Vec::new());
        for (i, p) in positions.iter().enumerate() {
            let mut point = SurfaceDisc {
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
    let pass = |draw: &mut PointDrawing<'_>| {
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

/// Function that gives the colour of a point by its number.
pub type ColorOf<'a> = dyn Fn(usize) -> [u8; 3] + Sync + 'a;

/// Draws points of a model that are not all of its vertices, as discs: so many, which `point` gives by their
/// numbers, in the model's axes; in one colouring, and if it is wanted in another one, which takes little
/// more. The radii and colours that `point` gives do not count: discs cover the surface by their number.
///
/// Memory: besides the picture's, 4 bytes for each point.
///
/// # Errors
/// The user cancelled.
pub fn of_some(
    (count, point): (usize, &(dyn Fn(usize) -> SurfaceDisc + Sync)),
    (color, other): (&ColorOf<'_>, Option<&ColorOf<'_>>),
    bounds: &Bounds,
    view: &PictureView,
    progress: &dyn Progress,
) -> Result<(Image, Option<Image>)> {
    progress.begin("drawing", 0);
    let mut spacing = Spacing::new([bounds.min, bounds.max]);
    spacing.add((0..count).map(|i| point(i).position));
    let radius = |i: usize| UNEVEN * spacing.radius_at(point(i).position);
    let radii: Vec<f32> = (0..count).into_par_iter().map(radius).collect();
    let mut renderer = view.renderer(view.camera(), true);
    let chunks = || (0..count).step_by(CHUNK_VERTICES).map(|i| i..count.min(i + CHUNK_VERTICES));
    let drawn = |i: usize, color: [u8; 3]| {
        let point = point(i);
        SurfaceDisc {
            position: view.up.turned(point.position),
            normal: view.up.turned(point.normal.as_dvec3()).as_vec3(),
            radius: radii[i],
            color,
        }
    };
    // In the same memory each time: to get it anew takes the system longer than to fill it.
    let (mut points, mut others) = (Vec::new(), Vec::new());
    for chunk in chunks() {
        progress.check()?;
        chunk.into_par_iter().map(|i| drawn(i, [0; 3])).collect_into_vec(&mut points);
        renderer.depth(&points);
    }
    for chunk in chunks() {
        progress.check()?;
        chunk.clone().into_par_iter().map(|i| drawn(i, color(i))).collect_into_vec(&mut points);
        match other {
            Some(other) => {
                chunk.into_par_iter().map(other).collect_into_vec(&mut others);
                renderer.blend_both(&points, &others);
            }
            None => renderer.blend(&points),
        }
    }
    if other.is_none() {
        return Ok((renderer.finish(), None));
    }
    let [image, other] = renderer.finish_both();
    Ok((image, Some(other)))
}

/// Draws samples at local `positions`, in colours of which there is one for each, if there are any: the
/// triangles between them; and those that no triangle has, where these are a tenth of all, as discs that
/// overlap a little.
pub fn of_samples(
    sampled: &SampledModel,
    positions: &[Vec3],
    normals: &[Vec3],
    view: &PictureView,
    colors: Option<&[[u8; 3]]>,
) -> Image {
    DrawnSamples::new(sampled, (positions, normals), view, colors, true).draw(view, view.camera())
}

/// Draws samples at rest as [`of_samples`] does, each as a disc, whether there are triangles or not.
pub fn of_discs(sampled: &SampledModel, view: &PictureView, colors: Option<&[[u8; 3]]>) -> Image {
    let samples = &sampled.samples;
    let shape = (&samples.positions[..], samples.normals());
    DrawnSamples::new(sampled, shape, view, colors, false).draw(view, view.camera())
}

/// Draws samples at rest as [`of_samples`] does, or as [`of_discs`] does where no triangles are wanted, so
/// many times while the camera goes once round the vertical axis; see [`turn_of_model`].
///
/// # Errors
/// `frame` refuses a picture; the user cancelled.
pub fn turn_of_samples(
    sampled: &SampledModel,
    view: &PictureView,
    (colors, triangles): (Option<&[[u8; 3]]>, bool),
    (frames, frame): (u32, &mut Frames<'_>),
    progress: &dyn Progress,
) -> Result<()> {
    let samples = &sampled.samples;
    let shape = (&samples.positions[..], samples.normals());
    let drawn = DrawnSamples::new(sampled, shape, view, colors, triangles);
    view.turn(frames).into_iter().try_for_each(|camera| {
        progress.check()?;
        frame(&drawn.draw(view, camera))
    })
}

/// Samples as they are drawn.
struct DrawnSamples<'a> {
    points: Vec<SurfaceDisc>,
    triangles: &'a [[u32; 3]],
    /// Samples that no triangle has.
    alone: Vec<SurfaceDisc>,
    own_colors: bool,
}

impl<'a> DrawnSamples<'a> {
    fn new(
        sampled: &'a SampledModel,
        (positions, normals): (&[Vec3], &[Vec3]),
        view: &PictureView,
        colors: Option<&[[u8; 3]]>,
        triangles: bool,
    ) -> Self {
        let disc = |(i, ((p, n), spacing)): (usize, ((&Vec3, &Vec3), &f32))| SurfaceDisc {
            position: view.up.turned(sampled.frame.to_model(*p)),
            normal: view.up.turned(n.as_dvec3()).as_vec3(),
            color: colors.map_or([0; 3], |colors| colors[i]),
            radius: (SAMPLE_RADIUS * f64::from(*spacing) * sampled.frame.scale) as f32,
        };
        let extents = sampled.samples.extents();
        let points: Vec<SurfaceDisc> =
            positions.iter().zip(normals).zip(&extents).enumerate().map(disc).collect();
        let triangles = if triangles { &sampled.triangles[..] } else { &[] };
        let mut used = vec![false; points.len()];
        for i in triangles.iter().flatten() {
            if let Some(used) = used.get_mut(*i as usize) {
                *used = true;
            }
        }
        let alone = points.iter().zip(&used).filter(|(_, used)| !**used).map(|(point, _)| *point);
        let mut alone: Vec<SurfaceDisc> = alone.collect();
        if !are_many(alone.len(), points.len()) {
            alone.clear();
        }
        Self { points, triangles, alone, own_colors: colors.is_some() }
    }

    fn draw(&self, view: &PictureView, camera: PictureCamera) -> Image {
        let mut renderer = view.renderer(camera, self.own_colors);
        let corners = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|i| self.points.get(i as usize).copied());
            Some([a?, b?, c?])
        };
        let chunks = || self.triangles.chunks(CHUNK_TRIANGLES);
        let some = |chunk: &[[u32; 3]]| chunk.iter().filter_map(corners).collect::<Vec<_>>();
        chunks().for_each(|chunk| renderer.depth_of_triangles(&some(chunk)));
        renderer.depth(&self.alone);
        chunks().for_each(|chunk| renderer.blend_triangles(&some(chunk)));
        renderer.blend(&self.alone);
        renderer.finish()
    }
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
