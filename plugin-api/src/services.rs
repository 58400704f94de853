//! Look-ups in the samples that a plugin was given, of which the host keeps trees: the nearest samples,
//! `simod.nearest/1`, and the surface of the triangles between them, `simod.surface/1`.
//!
//! Both are extensions of the host ([`Host::extension`](crate::Host::extension)), asked for by
//! [`Host::nearest`](crate::Host::nearest) and [`Host::surface`](crate::Host::surface). Trees are built when
//! they are first asked, and kept with the state. Coordinates are local ones.

use crate::opaque::Host;
use abi_stable::{StableAbi, std_types::RSliceMut};

/// Pose of the samples in which something is looked up.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pose(pub u32);

impl Pose {
    /// Positions that the step is given ([`Samples::positions`](crate::Samples::positions)), as the steps
    /// before it left them.
    pub const CURRENT: Self = Self(1);
    /// Positions of the samples before all steps: for plugins that ask for
    /// [`rest_positions`](crate::Consumes::rest_positions).
    pub const REST: Self = Self(2);
}

/// A point of the triangles between the samples.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Default)]
pub struct SurfacePoint {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of its corners, at least 0, which add up to 1.
    pub weights: [f64; 3],
    /// Position of the point.
    pub position: [f64; 3],
    /// Distance from the point that was asked for, or along the ray, as a length.
    pub distance: f64,
}

/// The table of `simod.nearest/1`.
#[repr(C)]
#[derive(StableAbi, Debug)]
pub struct NearestService {
    pub(crate) has: extern "C" fn(&Host<'_>, Pose) -> bool,
    pub(crate) find: extern "C" fn(&Host<'_>, Pose, &[f64; 3], f64, RSliceMut<'_, u32>) -> usize,
}

/// The table of `simod.surface/1`.
#[repr(C)]
#[derive(StableAbi, Debug)]
pub struct SurfaceService {
    pub(crate) has: extern "C" fn(&Host<'_>, Pose) -> bool,
    pub(crate) closest: extern "C" fn(&Host<'_>, Pose, &[f64; 3], f64, &mut SurfacePoint) -> bool,
    pub(crate) ray: extern "C" fn(&Host<'_>, Pose, &[f64; 3], &[f64; 3], f64, &mut SurfacePoint) -> bool,
}

/// Look-ups that a host implements to offer these services, in the samples of the call that the plugin is
/// in.
pub trait Lookups: Sync {
    /// Whether there are samples to look up in this pose.
    fn has_samples(&self, pose: Pose) -> bool;

    /// Whether there are triangles between the samples in this pose, and the plugin asked for them.
    fn has_triangles(&self, pose: Pose) -> bool;

    /// See [`Nearest::find`].
    fn nearest(&self, pose: Pose, point: [f64; 3], radius: f64, found: &mut [u32]) -> usize;

    /// See [`Surface::closest_within`].
    fn closest(&self, pose: Pose, point: [f64; 3], radius: f64) -> Option<SurfacePoint>;

    /// See [`Surface::ray`].
    fn ray(&self, pose: Pose, origin: [f64; 3], direction: [f64; 3], reach: f64) -> Option<SurfacePoint>;
}

/// The samples nearest to points. Cheap to ask from any thread; the first time it builds a tree.
#[derive(Debug, Clone, Copy)]
pub struct Nearest<'a> {
    pub(crate) host: &'a Host<'a>,
    pub(crate) table: &'static NearestService,
    pub(crate) pose: Pose,
}

impl Nearest<'_> {
    /// Number of samples within `radius` (which may be infinite); the nearest of them are written to
    /// `found`, nearest first, as many as it holds. Those at the same distance are in the order of their
    /// indices.
    pub fn find(&self, point: [f64; 3], radius: f64, found: &mut [u32]) -> usize {
        (self.table.find)(self.host, self.pose, &point, radius, found.into())
    }

    /// The `count` nearest samples, nearest first; fewer where there are fewer.
    pub fn ones(&self, point: [f64; 3], count: usize) -> Vec<u32> {
        let mut found = vec![0; count];
        let there = self.find(point, f64::INFINITY, &mut found);
        found.truncate(there);
        found
    }

    /// All samples within `radius`, nearest first.
    pub fn within(&self, point: [f64; 3], radius: f64) -> Vec<u32> {
        let mut found = vec![0; 64];
        let there = self.find(point, radius, &mut found);
        if there > found.len() {
            found.resize(there, 0);
            self.find(point, radius, &mut found);
        }
        found.truncate(there);
        found
    }
}

/// The triangles between the samples. Cheap to ask from any thread; the first time it builds a tree.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    pub(crate) host: &'a Host<'a>,
    pub(crate) table: &'static SurfaceService,
    pub(crate) pose: Pose,
}

impl Surface<'_> {
    /// The point of the surface that is nearest to a point; nothing where no triangle has an area, or the
    /// point is not finite.
    pub fn closest(&self, point: [f64; 3]) -> Option<SurfacePoint> {
        self.closest_within(point, f64::INFINITY)
    }

    /// The point of the surface that is nearest to a point, if it is not farther away than `radius`.
    pub fn closest_within(&self, point: [f64; 3], radius: f64) -> Option<SurfacePoint> {
        let mut found = SurfacePoint::default();
        (self.table.closest)(self.host, self.pose, &point, radius, &mut found).then_some(found)
    }

    /// The point in which a ray first meets the surface, not farther away than `reach`: from either side, and
    /// from the origin on. The direction may be of any length but zero.
    pub fn ray(&self, origin: [f64; 3], direction: [f64; 3], reach: f64) -> Option<SurfacePoint> {
        let mut found = SurfacePoint::default();
        (self.table.ray)(self.host, self.pose, &origin, &direction, reach, &mut found).then_some(found)
    }
}
