//! From where and how a scene is shown.

use glam::{Mat4, Vec4};

/// The view of a scene: from where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneView {
    /// From local coordinates to the eye's: right, up, backward. A motion, without scaling.
    pub view: Mat4,
    /// From there to clip coordinates: depth from 0 (near) to 1; perspective or parallel, for instance
    /// `perspective` or `orthographic` of [`glam::camera::rh::proj::directx`].
    pub projection: Mat4,
    /// Width and height of the picture in pixels; 0 is taken as 1.
    pub size: [u32; 2],
}

/// The style of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneStyle {
    /// What stands for the surface.
    pub mode: SurfaceMode,
    /// Whether samples show their own colours, or all the same clay.
    pub own_colors: bool,
    /// What is behind the surface.
    pub background: Background,
    /// The light.
    pub light: Light,
    /// Whether crevices are darker.
    pub occlusion: bool,
    /// Whether the surface is seen from its back, too: for what is not closed.
    pub two_sided: bool,
    /// What lies beyond a plane is cut away: where `n · p > d`, for the plane (n, d) in local coordinates.
    /// What is seen of the inside is reddish then.
    pub clip: Option<Vec4>,
    /// How much the ghost hides, from 0 to 1.
    pub ghost_opacity: f32,
    /// How finely it is drawn.
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

/// What stands for the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SurfaceMode {
    /// A disc for each sample.
    Splats,
    /// Triangles, where the surface has any; else discs.
    Triangles,
}

/// What is behind the surface: both are gradients from above to below.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Background {
    /// Paper.
    Light,
    /// Slate.
    Dark,
    /// One colour, for pictures that are [cut out](simod_picture::CutOut) of two.
    Black,
    /// Another one.
    White,
}

/// The direction of the light, as the eye sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Light {
    /// A key light from the upper left, a weaker one from the right.
    Key,
    /// From the eye.
    Head,
    /// From all around, as it would lie on a ball before the eye (P.-P. Sloan, W. Martin, A. Gooch, B. Gooch,
    /// *The Lit Sphere*, Graphics Interface 2001), by a formula instead of a picture of the ball.
    Matcap(Matcap),
}

/// What the ball looks like by which the surface is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Matcap {
    /// Glossy, below a wide lamp: forms are read easily.
    Ceramic,
    /// A polished one, in which a horizon is mirrored.
    Metal,
    /// Soft and warm: dark where it turns away.
    Wax,
    /// Stripes that are mirrored: they have kinks where the surface is not smooth.
    Stripes,
}

/// How many pixels are drawn for a pixel of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PixelScale {
    /// One for four: coarse, for software that draws while something moves.
    Half,
    /// One each, with edges smoothed afterwards.
    Full,
    /// Four for one: the smoothest, for fast cards and pictures.
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
