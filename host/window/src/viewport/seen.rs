//! Input of the renderer, in the window and for pictures that are saved: the view, the discs' radii, the
//! plane that cuts.

use glam::{DVec3, Vec4};
use simod_scene::{SceneView, SurfaceMode};
use simod_viewer::State;
use simod_viewer::camera::Camera;

/// Radius of a disc over the spacing of samples: enough that no gap is left.
const RADIUS: f32 = 1.35;

/// View of a box, between two corners, by a camera in a picture of so many pixels.
pub fn view(camera: &Camera, size: [f64; 2], bounds: [DVec3; 2]) -> SceneView {
    SceneView {
        view: camera.view().as_mat4(),
        projection: camera.projection(size, camera.near_far(bounds)).as_mat4(),
        size: size.map(|s| s as u32),
    }
}

/// Radii of discs for samples with these spacings.
pub fn disc_radii(spacing: &[f32]) -> Vec<f32> {
    spacing.iter().map(|s| RADIUS * s).collect()
}

/// Surface's mode unless the user says otherwise: triangles where the samples have any, as these keep
/// together however they are stretched.
pub fn mode_of(shown: &simod_viewer::ViewerScene) -> SurfaceMode {
    if shown.sampled.triangles.is_empty() { SurfaceMode::Splats } else { SurfaceMode::Triangles }
}

/// The plane that cuts the model open, as the renderer takes it.
pub fn seen_clip(state: &State) -> Option<Vec4> {
    state.local_clip().map(|(normal, distance)| normal.extend(distance).as_vec4())
}
