//! The pictures of a comparison, all from one place: the model at rest, what each method makes of it, and how
//! far that is from the first one.

use super::file::CompareFile;
use super::folder::{REST, difference};
use super::html::round_percent;
use super::record::Comparison;
use crate::session_file::{Region, Role};
use glam::DVec3;
use simod_model::bounds::Bounds;
use simod_model::{Model, Progress, Result, Vertices};
use simod_picture::picture::{Crop, PaintBy, View, of_painted};
use simod_picture::{Coloring, Paint, scale_color as color};

const CLAY: [u8; 3] = [205, 198, 190];
const FIXED: [u8; 3] = [120, 140, 175];
const HANDLE: [u8; 3] = [230, 175, 60];

/// Draws `models`, of which the first is at rest; `files` has what the others' files begin with, and whose
/// they are. Gives the pictures' names and contents, and writes them into the record.
pub(super) fn draw(
    file: &CompareFile,
    models: &[&dyn Model],
    bounds: &[Bounds],
    files: &[(usize, String)],
    comparison: &mut Comparison,
    progress: &dyn Progress,
) -> Result<Vec<(String, Vec<u8>)>> {
    let mut all = Bounds::default();
    for bounds in bounds.iter().filter(|bounds| !bounds.is_empty()) {
        all.include(bounds.min);
        all.include(bounds.max);
    }
    let camera = file.camera;
    let view = View {
        bounds: all,
        yaw: camera.yaw,
        pitch: camera.pitch,
        size: camera.size,
        up: camera.up,
        crop: Crop::default(),
    };
    let info = models[0].info();
    let paint = Paint::of_model(models[0], Coloring::choose(None, &info.attributes)?, progress)?;
    let own = |parts: &[Vertices<'_>], i: usize| match paint.is_colored() {
        true => paint.color(|place| parts[0].attribute(place, i)),
        false => CLAY,
    };
    let by_region = |parts: &[Vertices<'_>], i: usize| {
        region_color(&file.regions, last(parts, i)).unwrap_or_else(|| own(parts, i))
    };
    let by_region = (paint.count(), &by_region as &PaintBy<'_>);
    let mut pictures = Vec::new();
    let rest = of_painted(&[models[0], models[0]], &bounds[0], &view, by_region, progress)?;
    pictures.push((REST.to_owned(), rest.to_png()?));
    let end = comparison.color_scale;
    let diagonal = comparison.model.diagonal;
    let by_distance = |parts: &[Vertices<'_>], i: usize| {
        let distance = parts[0].positions[i].distance(last(parts, i)) / diagonal;
        // Where nothing differs the scale has no length.
        color(if end > 0.0 { (distance / end) as f32 } else { 0.0 })
    };
    let labels = ["0", &format!("{} OF THE DIAGONAL", round_percent(end))];
    for (k, ((_, name), model)) in files.iter().zip(&models[1..]).enumerate() {
        let bounds = &bounds[k + 1];
        let image = of_painted(&[*model, models[0]], bounds, &view, by_region, progress)?;
        pictures.push((format!("{name}.png"), image.to_png()?));
        if k > 0 {
            let image = of_painted(&[*model, models[1]], bounds, &view, (0, &by_distance), progress)?;
            pictures.push((format!("{}.png", difference(name)), image.with_scale(color, labels).to_png()?));
        }
    }
    comparison.files.extend(pictures.iter().map(|(name, _)| name.clone()));
    Ok(pictures)
}

/// A vertex in the model that the first one is painted by.
fn last(parts: &[Vertices<'_>], i: usize) -> DVec3 {
    parts[parts.len() - 1].positions[i]
}

/// The colour of a vertex by where it is at rest.
fn region_color(regions: &[Region], p: DVec3) -> Option<[u8; 3]> {
    let mut holding = regions.iter().filter(|r| r.role != Role::Mask && r.shapes.weight(p) > 0.5);
    holding.next().map(|region| if region.role == Role::Handle { HANDLE } else { FIXED })
}
