//! The pictures of a comparison, all from one place: the model at rest, each method's result, and its
//! distances from the first method's.

use crate::chosen::ChosenVertices;
use crate::file::{CompareFile, CropPlace};
use crate::folder::{REST, difference};
use crate::html::round_percent;
use crate::record::Comparison;
use glam::DVec3;
use rayon::prelude::*;
use simod_model::bounds::Bounds;
use simod_model::{Model, Progress, Result, Vertices};
use simod_picture::picture::{ColorOf, Crop, Drawn, PaintBy, PictureView, of_painted, of_some};
use simod_picture::{Coloring, Image, Paint, scale_color as color};
use simod_session::step::{Region, Role};
use std::path::Path;

const CLAY: [u8; 3] = [205, 198, 190];
const FIXED: [u8; 3] = [120, 140, 175];
const HANDLE: [u8; 3] = [230, 175, 60];

/// Source and colours of the pictures.
pub(crate) struct Easel<'a> {
    file: &'a CompareFile,
    paint: Paint,
    /// Folder for temporary files.
    folder: &'a Path,
}

impl<'a> Easel<'a> {
    /// Easel for pictures of a model at rest, whose vertices may have colours.
    pub fn new(
        file: &'a CompareFile,
        rest: &dyn Model,
        folder: &'a Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let coloring = Coloring::choose(None, &rest.info().attributes)?;
        Ok(Self { file, paint: Paint::of_model(rest, coloring, progress)?, folder })
    }

    /// Number of a model's vertices that are chosen to be drawn, if any are: three for each pixel, which is
    /// about one for each sample of the picture that shows the model. A model with no more than one vertex
    /// for each pixel is drawn itself, with its faces: the faces of larger models would be smaller than the
    /// picture's samples.
    pub fn chosen(&self, vertices: u64) -> Option<u64> {
        let [w, h] = self.file.camera.size;
        let pixels = u64::from(w) * u64::from(h);
        (vertices > pixels).then_some(3 * pixels)
    }

    /// Number of models that are drawn at a time: two, so that the work of one thread on one model is
    /// beside that on the other, where pictures are small enough to be held twice.
    fn at_a_time(&self) -> usize {
        const SMALL: u64 = 1 << 20;
        let [w, h] = self.file.camera.size;
        if u64::from(w) * u64::from(h) <= SMALL { 2 } else { 1 }
    }

    /// Number of the vertices' first attributes of which their colours are made.
    pub fn attributes(&self) -> usize {
        self.paint.count()
    }

    /// Colour of a vertex by the regions, or its own; `rest` is the index of the part at rest.
    pub fn color(&self, parts: &[Vertices<'_>], rest: usize, i: usize) -> [u8; 3] {
        region_color(&self.file.regions, parts[rest].positions[i]).unwrap_or_else(|| {
            if self.paint.is_colored() {
                self.paint.color(|place| parts[0].attribute(place, i))
            } else {
                CLAY
            }
        })
    }

    fn view(&self, bounds: &[Bounds], crop: Crop) -> PictureView {
        let mut all = Bounds::default();
        for bounds in bounds.iter().filter(|bounds| !bounds.is_empty()) {
            all.include(bounds.min);
            all.include(bounds.max);
        }
        let camera = self.file.camera;
        PictureView {
            bounds: all,
            yaw: camera.yaw,
            pitch: camera.pitch,
            size: camera.size,
            up: camera.up,
            crop,
        }
    }

    /// Draws `models`, of which the first is at rest. `files` has, for each of the others, its method's
    /// number and the beginning of its files' names. Where vertices were chosen, these stand for the whole
    /// models, but not for parts of them. Returns the pictures' names and contents, and writes the names
    /// into the record.
    pub fn draw(
        &self,
        (models, chosen): (&[&dyn Model], Option<&ChosenVertices>),
        bounds: &[Bounds],
        files: &[(usize, String)],
        comparison: &mut Comparison,
        progress: &dyn Progress,
    ) -> Result<Vec<(String, Vec<u8>)>> {
        let end = comparison.color_scale;
        let labels = ["0", &format!("{} OF THE DIAGONAL", round_percent(end))];
        let crops = self.file.crops.iter().map(|crop| (format!("_{}", crop.file), crop_of(crop)));
        let (ends, crops): (Vec<String>, Vec<Crop>) =
            [(String::new(), Crop::default())].into_iter().chain(crops).unzip();
        let views: Vec<PictureView> = crops.into_iter().map(|crop| self.view(bounds, crop)).collect();
        let scale = end * comparison.model.diagonal;
        let brush = PictureBrush { easel: self, models, chosen, bounds, views: &views, scale, progress };
        let names = std::iter::once(REST).chain(files.iter().map(|(_, file)| file.as_str()));
        let names: Vec<(usize, &str)> = names.enumerate().collect();
        let of_version = |(version, file): &(usize, &str)| -> Result<Vec<(String, Vec<u8>)>> {
            let Drawings { by_region, by_distance } = brush.draw(*version)?;
            let plain =
                ends.iter().zip(by_region).map(|(end, image)| (format!("{file}{end}.png"), image, false));
            let with_scale = ends.iter().zip(by_distance);
            let with_scale =
                with_scale.map(|(end, image)| (format!("{}{end}.png", difference(file)), image, true));
            let drawn: Vec<(String, Image, bool)> = plain.chain(with_scale).collect();
            let encoded = drawn.into_par_iter().map(|(name, image, has_scale)| {
                let image = if has_scale { image.with_scale(color, labels) } else { image };
                Ok((name, image.to_png()?))
            });
            encoded.collect()
        };
        let mut pictures = Vec::new();
        for some in names.chunks(self.at_a_time()) {
            let drawn: Vec<_> = some.par_iter().map(of_version).collect::<Result<_>>()?;
            pictures.extend(drawn.into_iter().flatten());
        }
        comparison.files.extend(pictures.iter().map(|(name, _)| name.clone()));
        Ok(pictures)
    }
}

fn crop_of(place: &CropPlace) -> Crop {
    Crop { around: Some(place.target), part: place.part }
}

/// Draws one model after the other, from some places.
struct PictureBrush<'a> {
    easel: &'a Easel<'a>,
    models: &'a [&'a dyn Model],
    chosen: Option<&'a ChosenVertices>,
    bounds: &'a [Bounds],
    /// Views of the pictures; the first shows all of the model.
    views: &'a [PictureView],
    /// The distance at which the scale ends.
    scale: f64,
    progress: &'a dyn Progress,
}

/// The pictures of a model, one for each view.
struct Drawings {
    by_region: Vec<Image>,
    /// Pictures of each vertex by its distance to the same one of the first method; none of the model at
    /// rest and of that method.
    by_distance: Vec<Image>,
}

impl PictureBrush<'_> {
    fn draw(&self, version: usize) -> Result<Drawings> {
        let has_distance = version > 1;
        let (mut by_region, mut by_distance, mut views) = (Vec::new(), Vec::new(), self.views);
        if let (Some(chosen), Some((whole, crops))) = (self.chosen, self.views.split_first()) {
            let point = |i: usize| chosen.point(i, version);
            let region = |i: usize| point(i).color;
            let distance = |i: usize| self.color(point(i).position.distance(chosen.point(i, 1).position));
            let distance: Option<&ColorOf<'_>> = if has_distance { Some(&distance) } else { None };
            let bounds = &self.bounds[version];
            let drawn = of_some((chosen.len(), &point), (&region, distance), bounds, whole, self.progress)?;
            by_region.push(drawn.0);
            by_distance.extend(drawn.1);
            views = crops;
        }
        let region = |parts: &[Vertices<'_>], i: usize| self.easel.color(parts, 1, i);
        by_region.extend(self.of_all([version, 0], views, (self.easel.attributes(), &region))?);
        if has_distance {
            let distance = |parts: &[Vertices<'_>], i: usize| {
                self.color(parts[0].positions[i].distance(parts[1].positions[i]))
            };
            by_distance.extend(self.of_all([version, 1], views, (0, &distance))?);
        }
        Ok(Drawings { by_region, by_distance })
    }

    /// Picture of the first of two versions, painted by both.
    fn of_all(
        &self,
        versions: [usize; 2],
        views: &[PictureView],
        (attributes, by): (usize, &PaintBy<'_>),
    ) -> Result<Vec<Image>> {
        let (models, drawn) = (versions.map(|i| self.models[i]), Drawn::Faces(self.easel.folder));
        of_painted(&models, &self.bounds[versions[0]], views, (attributes, by, drawn), self.progress)
    }

    /// The colour of a distance.
    fn color(&self, distance: f64) -> [u8; 3] {
        // The scale has no length where nothing differs.
        color(if self.scale > 0.0 { (distance / self.scale) as f32 } else { 0.0 })
    }
}

/// Colour of a vertex by its region at rest.
fn region_color(regions: &[Region], p: DVec3) -> Option<[u8; 3]> {
    let mut holding = regions.iter().filter(|r| r.role != Role::Mask && r.shapes.weight(p) > 0.5);
    holding.next().map(|region| if region.role == Role::Handle { HANDLE } else { FIXED })
}
