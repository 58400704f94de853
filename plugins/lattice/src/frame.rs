//! The lattice's box, and its place in space.

use crate::LatticeSettings;
use glam::{DQuat, DVec3};
use simod_plugin_api::{Bounds, PluginError, PluginResult};

/// Margin around the model in a box that is made for it, relative to its size.
const MARGIN: f64 = 0.02;
/// The least size of a box that is made for something flat, relative to the diagonal.
const THINNEST: f64 = 0.05;

/// An oriented box with a coordinate from 0 to 1 along each of its axes.
#[derive(Debug, Clone, Copy)]
pub struct LatticeFrame {
    centre: DVec3,
    /// The edges, at right angles.
    edges: [DVec3; 3],
    /// Unit vectors along the edges, over the edges' lengths.
    inverses: [DVec3; 3],
}

impl LatticeFrame {
    /// The box of these settings, for a model with this box (at rest) and these samples.
    pub fn new(settings: &LatticeSettings, bounds: &Bounds, samples: &[[f32; 3]]) -> PluginResult<Self> {
        let (axis, angle) = (DVec3::from(settings.axis), settings.angle.to_radians());
        // The axis is scaled first, so that neither tiny nor huge vectors are lost in their squares.
        let turn = match (axis / axis.abs().max_element()).try_normalize() {
            Some(axis) => DQuat::from_axis_angle(axis, angle),
            None if angle == 0.0 => DQuat::IDENTITY,
            None => {
                let error = PluginError::parameter("axis", "is zero");
                return Err(error.hint("give a direction about which the box is turned, such as [0, 1, 0]"));
            }
        };
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|a| turn * a);
        let centre = DVec3::from(settings.center);
        let corners = corners(bounds, samples);
        let mut sizes = [settings.size_x, settings.size_y, settings.size_z];
        for (i, size) in sizes.iter_mut().enumerate() {
            let given = *size * bounds.diagonal();
            let reach = corners.iter().map(|c| (*c - centre).dot(axes[i]).abs()).fold(0.0, f64::max);
            let thinnest = if bounds.diagonal() > 0.0 { THINNEST * bounds.diagonal() } else { 1.0 };
            *size = if given > 0.0 { given } else { (2.0 * reach * (1.0 + MARGIN)).max(thinnest) };
        }
        let edges = std::array::from_fn(|i| sizes[i] * axes[i]);
        Ok(Self { centre, edges, inverses: std::array::from_fn(|i| axes[i] / sizes[i]) })
    }

    /// The coordinates of a point: 0 to 1 inside.
    #[inline(always)]
    pub fn coordinates(&self, p: DVec3) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.coordinate(axis, p))
    }

    /// Coordinate of a point along one axis.
    #[inline(always)]
    pub fn coordinate(&self, axis: usize, p: DVec3) -> f64 {
        0.5 + (p - self.centre).dot(self.inverses[axis])
    }

    /// The point with these coordinates.
    pub fn point(&self, u: [f64; 3]) -> DVec3 {
        (0..3).fold(self.centre, |p, i| p + (u[i] - 0.5) * self.edges[i])
    }
}

/// The corners of the box around the model at rest, and around the samples where earlier steps have moved
/// them.
fn corners(bounds: &Bounds, samples: &[[f32; 3]]) -> [DVec3; 8] {
    let (mut min, mut max) = (DVec3::from(bounds.min), DVec3::from(bounds.max));
    for p in samples.iter().map(|p| DVec3::from(p.map(f64::from))) {
        (min, max) = (min.min(p), max.max(p));
    }
    std::array::from_fn(|i| {
        let at = |axis: usize| if i >> axis & 1 == 0 { min[axis] } else { max[axis] };
        DVec3::new(at(0), at(1), at(2))
    })
}
