//! Things that are shown besides the surface, as the user chose them.

/// Choice of the things that are shown besides the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Looks {
    /// Triangles or discs, where the user said which; see [`Window::mode`](super::Window::mode).
    pub triangles: Option<bool>,
    /// The shape at rest.
    pub ghost: bool,
    /// Dots for samples in whose place vertices are shown.
    pub samples: bool,
    /// The regions of the chosen step, in colours.
    pub regions: bool,
    /// The handles that the chosen step's plugin placed.
    pub handles: bool,
    /// The pinned version beside the one that is worked on.
    pub side_by_side: bool,
    /// The pinned version in the place of the one that is worked on.
    pub pinned_in_place: bool,
}

impl Default for Looks {
    fn default() -> Self {
        Self {
            triangles: None,
            ghost: false,
            samples: false,
            regions: true,
            handles: true,
            side_by_side: false,
            pinned_in_place: false,
        }
    }
}
