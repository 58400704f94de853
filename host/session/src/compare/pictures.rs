//! The pictures of a comparison, all from one place: the model at rest, what each method makes of it, and how
//! far that is from the first one.

use super::chosen::Chosen;
use super::file::CompareFile;
use super::folder::{REST, difference};
use super::html::round_percent;
use super::record::Comparison;
use crate::session_file::{Region, Role};
use glam::DVec3;
use simod_model::bounds::Bounds;
use simod_model::{Model, Progress, Result, Vertices};
use simod_picture::picture::{Crop, Drawn, PaintBy, View, of_painted, of_some};
use simod_picture::{Coloring, Image, Paint, SurfacePoint, scale_color as color};
use std::path::Path;

const CLAY: [u8; 3] = [205, 198, 190];
const FIXED: [u8; 3] = [120, 140, 175];
const HANDLE: [u8; 3] = [230, 175, 60];

/// What pictures are made of, and how.
pub(super) struct Easel<'a> {
    file: &'a CompareFile,
    paint: Paint,
    /// Where a temporary file may be made.
    folder: &'a Path,
}

impl<'a> Easel<'a> {
    /// For pictures of a model at rest, whose vertices may have colours.
    pub fn new(
        file: &'a CompareFile,
        rest: &dyn Model,
        folder: &'a Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let coloring = Coloring::choose(None, &rest.info().attributes)?;
        Ok(Self { file, paint: Paint::of_model(rest, coloring, progress)?, folder })
    }

    /// How many vertices of a model are chosen to be drawn, if they are: three for each pixel, which is about one for each
    /// sample of the picture that shows the model. Where there is no more than one for each pixel, the model itself is
    /// drawn, with its faces: those of others would be smaller than samples.
    pub fn chosen(&self, vertices: u64) -> Option<u64> {
        let [w, h] = self.file.camera.size;
        let pixels = u64::from(w) * u64::from(h);
        (vertices > pixels).then_some(3 * pixels)
    }

    /// How many of the vertices' first attributes their colours are made of.
    pub fn attributes(&self) -> usize {
        self.paint.count()
    }

    /// The colour of a vertex by the regions, or its own; `rest` says which of the parts is at rest.
    pub fn color(&self, parts: &[Vertices<'_>], rest: usize, i: usize) -> [u8; 3] {
        region_color(&self.file.regions, parts[rest].positions[i]).unwrap_or_else(|| {
            if self.paint.is_colored() {
                self.paint.color(|place| parts[0].attribute(place, i))
            } else {
                CLAY
            }
        })
    }

    fn view(&self, bounds: &[Bounds], crop: Crop) -> View {
        let mut all = Bounds::default();
        for bounds in bounds.iter().filter(|bounds| !bounds.is_empty()) {
            all.include(bounds.min);
            all.include(bounds.max);
        }
        let camera = self.file.camera;
        View { bounds: all, yaw: camera.yaw, pitch: camera.pitch, size: camera.size, up: camera.up, crop }
    }

    /// Draws `models`, of which the first is at rest; `files` has what the others' files begin with, and whose
    /// they are; where vertices were chosen, these stand for the whole models, but not for parts of them. Gives the
    /// pictures' names and contents, and writes them into the record.
    pub fn draw(
        &self,
        (models, chosen): (&[&dyn Model], Option<&Chosen>),
        bounds: &[Bounds],
        files: &[(usize, String)],
        comparison: &mut Comparison,
        progress: &dyn Progress,
    ) -> Result<Vec<(String, Vec<u8>)>> {
        let mut pictures = Vec::new();
        let whole = [(String::new(), Crop::default())];
        let parts = self
            .file
            .crops
            .iter()
            .map(|crop| (format!("_{}", crop.file), Crop { around: Some(crop.target), part: crop.part }));
        let end = comparison.color_scale;
        let labels = ["0", &format!("{} OF THE DIAGONAL", round_percent(end))];
        for (name, crop) in whole.into_iter().chain(parts) {
            let view = self.view(bounds, crop);
            let chosen = chosen.filter(|_| name.is_empty());
            let brush = Brush { easel: self, models, chosen, bounds, view, progress };
            pictures.push((format!("{REST}{name}.png"), brush.by_region(0)?.to_png()?));
            for (k, (_, file)) in files.iter().enumerate() {
                pictures.push((format!("{file}{name}.png"), brush.by_region(k + 1)?.to_png()?));
                if k > 0 {
                    let image = brush.by_distance(k + 1, end * comparison.model.diagonal)?;
                    let file = format!("{}{name}.png", difference(file));
                    pictures.push((file, image.with_scale(color, labels).to_png()?));
                }
            }
        }
        comparison.files.extend(pictures.iter().map(|(name, _)| name.clone()));
        Ok(pictures)
    }
}

/// Draws one model after the other from one place.
struct Brush<'a> {
    easel: &'a Easel<'a>,
    models: &'a [&'a dyn Model],
    chosen: Option<&'a Chosen>,
    bounds: &'a [Bounds],
    view: View,
    progress: &'a dyn Progress,
}

impl Brush<'_> {
    fn by_region(&self, version: usize) -> Result<Image> {
        if let Some(chosen) = self.chosen {
            return self.of_chosen(chosen, version, &|i| chosen.point(i, version));
        }
        let by = |parts: &[Vertices<'_>], i: usize| self.easel.color(parts, 1, i);
        self.of_all([version, 0], (self.easel.attributes(), &by))
    }

    /// Each vertex by its distance to the same one of the first method; `end` is where the scale ends.
    fn by_distance(&self, version: usize, end: f64) -> Result<Image> {
        // Where nothing differs the scale has no length.
        let by = |distance: f64| color(if end > 0.0 { (distance / end) as f32 } else { 0.0 });
        if let Some(chosen) = self.chosen {
            return self.of_chosen(chosen, version, &|i| {
                let (point, first) = (chosen.point(i, version), chosen.point(i, 1));
                SurfacePoint { color: by(point.position.distance(first.position)), ..point }
            });
        }
        let by = |parts: &[Vertices<'_>], i: usize| by(parts[0].positions[i].distance(parts[1].positions[i]));
        self.of_all([version, 1], (0, &by))
    }

    /// The first of two versions, painted by both.
    fn of_all(&self, versions: [usize; 2], (attributes, by): (usize, &PaintBy<'_>)) -> Result<Image> {
        let (models, drawn) = (versions.map(|i| self.models[i]), Drawn::Faces(self.easel.folder));
        of_painted(&models, &self.bounds[versions[0]], &self.view, (attributes, by, drawn), self.progress)
    }

    fn of_chosen(
        &self,
        chosen: &Chosen,
        version: usize,
        point: &(dyn Fn(usize) -> SurfacePoint + Sync),
    ) -> Result<Image> {
        of_some((chosen.len(), point), &self.bounds[version], &self.view, self.progress)
    }
}

/// The colour of a vertex by where it is at rest.
fn region_color(regions: &[Region], p: DVec3) -> Option<[u8; 3]> {
    let mut holding = regions.iter().filter(|r| r.role != Role::Mask && r.shapes.weight(p) > 0.5);
    holding.next().map(|region| if region.role == Role::Handle { HANDLE } else { FIXED })
}
