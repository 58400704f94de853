//! Handles that a plugin itself places: a lattice's points, a skeleton's joints, a cage's corners.

use abi_stable::{StableAbi, std_types::RString};

/// Set of the motions that a handle takes, for which a viewer offers something to grab.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gizmo(pub u32);

impl Gizmo {
    /// The handle can be shifted.
    pub const TRANSLATE: Self = Self(1);
    /// The handle can be turned about its position.
    pub const ROTATE: Self = Self(2);
    /// The handle can be scaled about its position.
    pub const SCALE: Self = Self(4);

    /// Whether all motions of `other` are among these.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl std::ops::BitOr for Gizmo {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// A handle that a plugin places.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq)]
pub struct HandleDesc {
    /// Stable id, unique among the plugin's handles; stored in files. Any text without white space, such as
    /// `3,3,3`.
    pub id: RString,
    /// Name for the user; the id where it is empty.
    pub name: RString,
    /// Position at rest, local coordinates.
    pub position: [f64; 3],
    /// Motions that the handle takes. Bits that the host does not know are passed over.
    pub gizmo: Gizmo,
    /// The index of the handle that it hangs on, less than its own, or [`HandleDesc::ROOT`]: a viewer draws a
    /// bone between the two, and the parent's motion moves it along.
    pub parent: u32,
}

impl HandleDesc {
    /// The parent of a handle that hangs on no other.
    pub const ROOT: u32 = u32::MAX;

    /// A handle at `position` that can be shifted, and hangs on no other.
    pub fn new(id: &str, position: [f64; 3]) -> Self {
        Self { id: id.into(), name: RString::new(), position, gizmo: Gizmo::TRANSLATE, parent: Self::ROOT }
    }

    /// Sets the name for the user.
    #[must_use]
    pub fn name(mut self, name: &str) -> Self {
        self.name = name.into();
        self
    }

    /// Sets the motions that the handle takes.
    #[must_use]
    pub fn gizmo(mut self, gizmo: Gizmo) -> Self {
        self.gizmo = gizmo;
        self
    }

    /// Sets the index of the handle that this one hangs on.
    #[must_use]
    pub fn parent(mut self, parent: u32) -> Self {
        self.parent = parent;
        self
    }
}
