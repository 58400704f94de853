//! A picture of the model without a window.

use crate::viewport::detail::{Pieces, sample_colors, sample_radii};
use glam::DVec3;
use simod_core::{Error, ErrorKind, Result};
use simod_scene::{Background, Gpu, NoGpu, Scale, Scene, Style, Surface, View};
use simod_viewer::State;
use simod_viewer::camera::Camera;
use std::path::Path;

/// Width and height, in pixels.
const SIZE: [u32; 2] = [1600, 1000];
/// Radius of a disc over the spacing of samples, in the window, too: enough that no gap is left.
pub const RADIUS: f32 = 1.35;

/// Draws what the state shows, as its camera sees it.
///
/// # Errors
/// Nothing is open, there is nothing to draw with, or the file cannot be written.
pub fn write(state: &mut State, file: &Path) -> Result<()> {
    let none = || Error::new(ErrorKind::Argument, "there is no model to be drawn", "name one");
    let shown = state.scene().cloned().ok_or_else(none)?;
    let lost = || Error::new(ErrorKind::Io, "the picture cannot be drawn", NoGpu::HINT);
    let gpu = Gpu::headless().map_err(|e| {
        Error::new(ErrorKind::Io, e.to_string().lines().next().unwrap_or_default().to_owned(), NoGpu::HINT)
    })?;
    let colors: Option<Vec<[u8; 3]>> =
        state.field().map(|field| (0..shown.len()).map(|i| field.color(i)).collect());
    let detail = state.detail();
    let radii = sample_radii(shown.sampled.samples.spacing(), detail);
    let of_samples = match detail {
        Some(_) => Some(sample_colors(shown.len(), colors.as_deref())),
        None => colors.clone(),
    };
    let mut scene = Scene::new(&gpu);
    let surface = Surface {
        positions: &shown.positions,
        normals: &shown.normals,
        radii: &radii,
        colors: of_samples.as_deref(),
        triangles: &shown.sampled.triangles,
    };
    let bad = |e: simod_scene::BadSurface| Error::new(ErrorKind::Io, e.to_string(), "report this");
    scene.set_surface(&surface).map_err(bad)?;
    Pieces::default().update(&mut scene, detail, colors.as_deref(), false).map_err(bad)?;
    let own_colors = of_samples.is_some();
    let style = Style { own_colors, background: Background::Dark, scale: Scale::Double, ..Style::default() };
    let bounds = shown.bounds().map(|corner| corner.as_dvec3());
    scene.render(&view(state.camera(), bounds), &style, None);
    let picture = scene.read().ok_or_else(lost)?;
    simod_core::output::write_file(file, &picture.to_png()?)
}

fn view(camera: &Camera, bounds: [DVec3; 2]) -> View {
    let size = SIZE.map(f64::from);
    View {
        view: camera.view().as_mat4(),
        projection: camera.projection(size, camera.near_far(bounds)).as_mat4(),
        size: SIZE,
    }
}
