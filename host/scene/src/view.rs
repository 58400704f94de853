//! View and style in which a scene is shown.

use glam::{Mat4, Vec4};

/// View of a scene: camera and size of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneView {
    /// Map from local coordinates to the eye's: right, up, backward. A rigid motion, without scaling.
    pub view: Mat4,
    /// Map from the eye's coordinates to clip coordinates: depth from 0 (near) to 1; perspective or
    /// parallel, for instance `perspective` or `orthographic` of [`glam::camera::rh::proj::directx`].
    pub projection: Mat4,
    /// Width and height of the picture in pixels; 0 is taken as 1.
    pub size: [u32; 2],
}

/// The style of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneStyle {
    /// Kind of drawing of the surface.
    pub mode: SurfaceMode,
    /// Whether samples show their own colours, or all the same clay.
    pub own_colors: bool,
    /// Background behind the surface.
    pub background: Background,
    /// The light.
    pub light: Light,
    /// Whether crevices are darker.
    pub occlusion: bool,
    /// Whether the surface is drawn from its back, too: for surfaces that are not closed.
    pub two_sided: bool,
    /// Plane (n, d) in local coordinates beyond which the surface is cut away: where `n · p > d`. The
    /// visible inside is reddish then.
    pub clip: Option<Vec4>,
    /// Opacity of the ghost, from 0 to 1.
    pub ghost_opacity: f32,
    /// Scale of the drawn pixels.
    pub scale: PixelScale,
}

impl Default for SceneStyle {
    fn default() -> Self {
        Self {
            mode: SurfaceMode::Splats,
            own_colors: false,
            background: Background::Light,
            light: Light::Key,
            occlusion: true,
            two_sided: true,
            clip: None,
            ghost_opacity: 0.5,
            scale: PixelScale::Full,
        }
    }
}

/// Kind of drawing of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SurfaceMode {
    /// A disc for each sample.
    Splats,
    /// Triangles, where the surface has any; else discs.
    Triangles,
}

/// Background behind the surface, a gradient from above to below or one colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Background {
    /// Paper.
    Light,
    /// Slate.
    Dark,
    /// Black everywhere, for pictures that are [cut out](simod_picture::CutOut) of two.
    Black,
    /// White everywhere, likewise.
    White,
}

/// The direction of the light, as the eye sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Light {
    /// A key light from the upper left, a weaker one from the right.
    Key,
    /// Light from the eye.
    Head,
    /// Light from all around, as it would lie on a ball before the eye (P.-P. Sloan, W. Martin, A. Gooch,
    /// B. Gooch, *The Lit Sphere*, Graphics Interface 2001), by a formula instead of a picture of the ball.
    Matcap(Matcap),
}

/// Look of the ball by which the surface is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Matcap {
    /// Glossy, below a wide lamp: forms are read easily.
    Ceramic,
    /// Polished, with a horizon mirrored in the ball.
    Metal,
    /// Soft and warm: dark where it turns away.
    Wax,
    /// Stripes that are mirrored: they have kinks where the surface is not smooth.
    Stripes,
}

/// Number of pixels that are drawn for a pixel of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PixelScale {
    /// One drawn pixel for four of the picture: coarse, for software that draws while something moves.
    Half,
    /// One drawn pixel for each, with edges smoothed afterwards.
    Full,
    /// Four drawn pixels for one: the smoothest, for fast cards and pictures.
    Double,
}

impl PixelScale {
    /// Width or height in drawn pixels.
    pub(crate) fn drawn(self, pixels: u32) -> u32 {
        match self {
            Self::Half => pixels.div_ceil(2),
            Self::Full => pixels,
            Self::Double => 2 * pixels,
        }
    }
}
