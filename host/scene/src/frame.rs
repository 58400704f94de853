//! The data of a frame for the shaders: `FrameData` in `common.wgsl`.

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3, Vec4};

use crate::view::{Background, Light, Matcap, SceneStyle, SceneView};

#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct FrameData {
    view: Mat4,
    projection: Mat4,
    key: Vec4,
    fill: Vec4,
    clay: Vec4,
    ghost_color: Vec4,
    background_top: Vec4,
    background_bottom: Vec4,
    clip: Vec4,
    size: [f32; 2],
    finished: [f32; 2],
    pub radius_scale: f32,
    ghost_opacity: f32,
    reach: f32,
    flags: u32,
}

/// Directions to the lights as the eye sees them, as in `simod_picture`.
const KEY_LIGHT: Vec3 = Vec3::new(-0.50, 0.66, 0.56);
const FILL_LIGHT: Vec3 = Vec3::new(0.80, 0.10, 0.59);
const HEAD_LIGHT: Vec3 = Vec3::new(0.0, 0.12, 1.0);
/// Linear colour of the surface where its own colours are not shown.
const CLAY: Vec3 = Vec3::new(0.56, 0.51, 0.46);
/// Linear colour of the ghost.
const GHOST: Vec3 = Vec3::new(0.22, 0.42, 0.72);
/// Backgrounds, above and below, in sRGB.
const PAPER: [Vec3; 2] = [Vec3::new(0.925, 0.930, 0.935), Vec3::new(0.845, 0.850, 0.860)];
const SLATE: [Vec3; 2] = [Vec3::new(0.260, 0.270, 0.290), Vec3::new(0.140, 0.145, 0.160)];
/// Place of the light among the bits of the flags.
const LIGHT: u32 = 8;
/// Reach of the occlusion, as a share of the surface's radius.
const REACH: f32 = 0.13;

impl FrameData {
    /// Data of a frame of so many pixels, of a surface with a radius, with a ghost or not.
    pub fn new(
        view: &SceneView,
        style: &SceneStyle,
        size: [u32; 2],
        finished: [u32; 2],
        radius: f32,
        ghost: bool,
    ) -> Self {
        let (key, strength) = match style.light {
            Light::Key => (KEY_LIGHT, 1.0),
            Light::Head => (HEAD_LIGHT, 0.7),
            Light::Matcap(_) => (KEY_LIGHT, 1.0),
        };
        let [top, bottom] = match style.background {
            Background::Light => PAPER,
            Background::Dark => SLATE,
            Background::Black => [Vec3::ZERO; 2],
            Background::White => [Vec3::ONE; 2],
        };
        let light = match style.light {
            Light::Key | Light::Head => 0,
            Light::Matcap(Matcap::Ceramic) => 1,
            Light::Matcap(Matcap::Metal) => 2,
            Light::Matcap(Matcap::Wax) => 3,
            Light::Matcap(Matcap::Stripes) => 4,
        };
        let flags = [style.own_colors, style.occlusion, !style.two_sided, ghost, style.clip.is_some()];
        let flags: u32 = flags.iter().zip(0..).map(|(flag, bit)| u32::from(*flag) << bit).sum();
        Self {
            view: view.view,
            projection: view.projection,
            key: key.normalize_or_zero().extend(strength),
            fill: FILL_LIGHT.normalize_or_zero().extend(0.0),
            clay: CLAY.extend(1.0),
            background_top: top.extend(1.0),
            background_bottom: bottom.extend(1.0),
            clip: style.clip.map_or(Vec4::ZERO, |plane| seen_plane(&view.view, plane)),
            ghost_color: GHOST.extend(1.0),
            size: size.map(|s| s as f32),
            finished: finished.map(|s| s as f32),
            radius_scale: 1.0,
            ghost_opacity: style.ghost_opacity.clamp(0.0, 1.0),
            reach: REACH * radius,
            flags: flags | light << LIGHT,
        }
    }
}

/// A plane (n, d) of local coordinates as the eye sees it.
fn seen_plane(view: &Mat4, plane: Vec4) -> Vec4 {
    let normal = view.transform_vector3(plane.truncate());
    normal.extend(plane.w + normal.dot(view.w_axis.truncate()))
}
