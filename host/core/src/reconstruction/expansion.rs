//! A second-order Taylor expansion of the deformation about a sample: what is blended.

use glam::{Mat3, Vec3};

/// The displacement about a sample, u(q + d) = u₀ + S·d + Q(d, d), and how far the sample's word counts.
///
/// One row per coordinate of the displacement holds u₀, the three slopes, and the six second-order terms xx,
/// xy, xz, yy, yz, zz, in the order in which Horner's rule takes them. Displacements rather than places, as
/// those of samples that do not move are exactly nothing.
///
/// Memory: 136 bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expansion {
    /// q, in local coordinates.
    pub center: [f32; 3],
    /// One over the square of the support's radius, at most [`NO_SUPPORT`](Self::NO_SUPPORT).
    pub inverse_square: f32,
    /// For each coordinate of the displacement.
    pub rows: [[f32; 10]; 3],
}

impl Expansion {
    /// So small a support holds the sample alone.
    pub const NO_SUPPORT: f32 = 1e30;

    /// Of a displacement, its gradient S, and the second-order terms.
    pub fn new(center: Vec3, displacement: Vec3, slope: Mat3, second: [Vec3; 6]) -> Self {
        let row = |o: usize| {
            let s = slope.row(o);
            let [xx, xy, xz, yy, yz, zz] = second.map(|q| q[o]);
            [displacement[o], s.x, s.y, s.z, xx, xy, xz, yy, yz, zz]
        };
        Self { center: center.to_array(), inverse_square: Self::NO_SUPPORT, rows: [row(0), row(1), row(2)] }
    }

    /// How far within its support a place is: from 1 at the sample down to 0, and below.
    #[inline]
    pub fn within(&self, p: Vec3) -> f32 {
        1.0 - p.distance_squared(Vec3::from_array(self.center)) * self.inverse_square
    }

    /// The displacement of the sample itself.
    pub fn displacement(&self) -> Vec3 {
        Vec3::from_array(self.rows.map(|row| row[0]))
    }

    /// The gradient of the displacement at the sample.
    pub fn slope(&self) -> Mat3 {
        let rows = self.rows.map(|[_, x, y, z, ..]| Vec3::new(x, y, z));
        Mat3::from_cols(rows[0], rows[1], rows[2]).transpose()
    }

    /// The same with another gradient of the displacement.
    pub fn with_slope(mut self, slope: Mat3) -> Self {
        for (axis, row) in self.rows.iter_mut().enumerate() {
            row[1..4].copy_from_slice(&slope.row(axis).to_array());
        }
        self
    }

    /// The same with other second-order terms: xx, xy, xz, yy, yz, zz.
    pub fn with_second(mut self, second: [Vec3; 6]) -> Self {
        for (axis, row) in self.rows.iter_mut().enumerate() {
            row[4..].copy_from_slice(&second.map(|term| term[axis]));
        }
        self
    }

    /// The second-order terms xx, xy, xz, yy, yz, zz.
    pub fn second(&self) -> [Vec3; 6] {
        std::array::from_fn(|term| Vec3::from_array(self.rows.map(|row| row[4 + term])))
    }

    /// Whether it moves nothing anywhere.
    pub fn is_still(&self) -> bool {
        self.rows.as_flattened().iter().all(|x| *x == 0.0)
    }

    /// The displacement at `d` from the sample, and its gradient.
    pub fn at(&self, d: Vec3) -> (Vec3, Mat3) {
        let parts = self.rows.map(|[u, sx, sy, sz, xx, xy, xz, yy, yz, zz]| {
            let a = sx + xx * d.x + xy * d.y + xz * d.z;
            let b = sy + yy * d.y + yz * d.z;
            let c = sz + zz * d.z;
            let slope = Vec3::new(a + xx * d.x, b + xy * d.x + yy * d.y, c + xz * d.x + yz * d.y + zz * d.z);
            (u + a * d.x + b * d.y + c * d.z, slope)
        });
        let slopes = parts.map(|(_, slope)| slope);
        let gradient = Mat3::from_cols(slopes[0], slopes[1], slopes[2]).transpose();
        (Vec3::from_array(parts.map(|(u, _)| u)), gradient)
    }

    /// The displacement of a point at `d`, beyond the support, and its gradient: the second order stays what
    /// it is at the margin, as no neighbour told what it is there.
    pub fn beyond(&self, d: Vec3) -> (Vec3, Mat3) {
        let margin = (1.0 / (d.length_squared() * self.inverse_square)).min(1.0);
        let mut inner = *self;
        inner.rows.iter_mut().flat_map(|row| &mut row[4..]).for_each(|x| *x *= margin);
        inner.at(d)
    }
}
