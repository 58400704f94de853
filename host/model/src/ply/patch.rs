//! What text and binary share where numbers of a chunk are replaced.

use glam::{DVec3, Vec3};

/// A chunk of a binary file but for its bytes, as they were read.
#[derive(Clone, Copy)]
pub(super) struct Rest<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) normals: &'a [Vec3],
    pub(super) spans: &'a [[u32; 2]],
}

/// Whether a coordinate of a normal was left as it was. Any NaN is as good as another: keep the file's.
#[inline(always)]
pub(super) fn same_normal(old: f32, new: f32) -> bool {
    old.to_bits() == new.to_bits() || (old.is_nan() && new.is_nan())
}
