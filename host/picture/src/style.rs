//! Style of pictures.

use glam::Vec3;

/// Direction to the key light in view coordinates (right, up, forward): from the upper left, before the
/// model.
pub(super) const KEY_LIGHT: Vec3 = Vec3::new(-0.50, 0.66, -0.56);

/// The style of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Style {
    /// Whether points show their own colours, or all the same clay.
    pub own_colors: bool,
    /// Height (y) of the ground that receives a soft shadow, where there is one.
    pub ground: Option<f64>,
}

impl Default for Style {
    /// Own colours, no ground.
    fn default() -> Self {
        Self { own_colors: true, ground: None }
    }
}
