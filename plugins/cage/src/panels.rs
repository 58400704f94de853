//! Contributions of a cage's flat triangle to a point by the fundamental solution of linear elasticity, in
//! closed form.
//!
//! The integrals over a triangle of the tractions of Kelvin's solution, with the corners' hat functions, as
//! in Somigliana's identity (C. A. Brebbia, J. C. F. Telles, L. C. Wrobel, *Boundary element techniques*,
//! 1984, chapter 5). With `r` from the point to the triangle, `d` its part along the normal and `ρ` the rest,
//! all of them are moments of `ρ` over powers of `|r|`; as `∇ |r|⁻ᵏ = -k ρ |r|⁻ᵏ⁻²` in the plane, these are
//! integrals along the edges, and the angle at which the triangle is seen. In double precision.

use crate::mesh::Cage;
use glam::{DMat2, DMat3, DVec2, DVec3};
use std::f64::consts::PI;

/// Distance to the line of an edge, in radii of the cage, that nearer points are taken to have: the
/// integrals are finite.
const ON_LINE: f64 = 1e-12;

/// Triangle of a cage, with all that does not depend on the point.
#[derive(Debug, Clone)]
pub struct Panel {
    pub corners: [usize; 3],
    /// Outward unit normal.
    pub normal: DVec3,
    /// Gradients of the corners' hat functions, in inverse lengths.
    pub gradients: [DVec3; 3],
    /// Angles between the edges, in radians.
    pub corner_angles: [f64; 3],
    edges: [usize; 3],
    /// Two axes in the plane, and the normal.
    axes: DMat3,
    /// The direction out of each edge, in the plane.
    across: [DVec2; 3],
    along: [DVec2; 3],
    /// Inverse of the height of each corner over its edge.
    over_heights: [f64; 3],
}

/// Integrals along an edge of powers of the distance to a point, and of the place `s` along it.
#[derive(Debug, Clone, Copy, Default)]
struct EdgeIntegrals {
    /// `∫ 1/r`
    log: f64,
    /// `∫ s/r`
    first: f64,
    /// `∫ 1/r³`
    cubed: f64,
    /// `∫ s/r³`
    first_cubed: f64,
    /// `∫ s²/r³`
    second_cubed: f64,
}

impl EdgeIntegrals {
    /// Integrals between two ends as seen from the point; `least` is the least square of a distance.
    fn new([a, b]: [DVec3; 2], [ra, rb]: [f64; 2], least: f64) -> Self {
        let length = a.distance(b);
        let direction = (b - a) / length;
        let (sa, sb) = (a.dot(direction), b.dot(direction));
        let square = a.cross(direction).length_squared().max(least);
        // With both ends on one side, nothing cancels.
        let one_side = (sb * sb - sa * sa) / (ra * rb * (sb * ra + sa * rb));
        let (log, cubed) = if sa >= 0.0 {
            (((sb + rb) / (sa + ra)).ln(), one_side)
        } else if sb <= 0.0 {
            (((ra - sa) / (rb - sb)).ln(), one_side)
        } else {
            (((sb + rb) * (ra - sa) / square).ln(), (sb / rb - sa / ra) / square)
        };
        Self {
            log,
            first: rb - ra,
            cubed,
            first_cubed: ra.recip() - rb.recip(),
            second_cubed: log - square * cubed,
        }
    }
}

/// Vertices and edges as seen from a point; memory to keep from point to point.
#[derive(Debug, Default)]
pub struct Sight {
    vectors: Vec<DVec3>,
    distances: Vec<f64>,
    edges: Vec<EdgeIntegrals>,
}

impl Sight {
    /// Computes the vectors, distances and integrals as seen from a point.
    pub fn look(&mut self, x: DVec3, cage: &Cage) {
        let nearest = ON_LINE * cage.radius;
        self.vectors.clear();
        self.vectors.extend(cage.vertices.iter().map(|p| *p - x));
        self.distances.clear();
        self.distances.extend(self.vectors.iter().map(|r| r.length().max(nearest)));
        self.edges.clear();
        let along = |[a, b]: &[usize; 2]| {
            EdgeIntegrals::new(
                [self.vectors[*a], self.vectors[*b]],
                [self.distances[*a], self.distances[*b]],
                nearest * nearest,
            )
        };
        self.edges.extend(cage.edges.iter().map(along));
    }
}

/// Symmetric product of two vectors in the plane.
fn symmetric(a: DVec2, b: DVec2) -> DMat2 {
    outer(a, b) + outer(b, a)
}

fn outer(a: DVec2, b: DVec2) -> DMat2 {
    DMat2::from_cols(a * b.x, a * b.y)
}

impl Panel {
    /// Triangles of a cage; those without an area, which contribute nothing, are left out.
    pub fn all(cage: &Cage) -> Vec<Self> {
        cage.triangles
            .iter()
            .filter_map(|triangle| {
                let p = triangle.corners.map(|v| cage.vertices[v]);
                let area = (p[1] - p[0]).cross(p[2] - p[0]);
                let longest = (0..3).map(|i| p[i].distance(p[(i + 1) % 3])).fold(0.0, f64::max);
                if area.length() <= 1e-9 * longest * longest {
                    return None;
                }
                let normal = area.normalize_or_zero();
                let x = (p[1] - p[0]).normalize_or_zero();
                let axes = DMat3::from_cols(x, normal.cross(x), normal);
                let flat = |v: DVec3| DVec2::new(axes.x_axis.dot(v), axes.y_axis.dot(v));
                let along3: [DVec3; 3] = std::array::from_fn(|i| {
                    let (e, _) = triangle.edges[i];
                    let [a, b] = cage.edges[e].map(|v| cage.vertices[v]);
                    (b - a).normalize_or_zero()
                });
                let across3: [DVec3; 3] =
                    std::array::from_fn(|i| triangle.edges[i].1 * along3[i].cross(normal));
                let over_heights = std::array::from_fn(|i| across3[i].dot(p[(i + 1) % 3] - p[i]).recip());
                Some(Self {
                    corners: triangle.corners,
                    normal,
                    gradients: std::array::from_fn(|i| -over_heights[i] * across3[i]),
                    corner_angles: std::array::from_fn(|i| {
                        (p[(i + 1) % 3] - p[i]).angle_between(p[(i + 2) % 3] - p[i])
                    }),
                    edges: triangle.edges.map(|(e, _)| e),
                    axes,
                    across: across3.map(flat),
                    along: along3.map(flat),
                    over_heights,
                })
            })
            .collect()
    }

    /// Two axes in the plane.
    pub fn in_plane(&self) -> [DVec3; 2] {
        [self.axes.x_axis, self.axes.y_axis]
    }

    /// Angle at which the triangle is seen, as a part of the whole sphere: positive from within (A. van
    /// Oosterom, J. Strackee, *The solid angle of a plane triangle*, IEEE Trans. Biomed. Eng. 30, 1983).
    pub fn angle(&self, sight: &Sight) -> f64 {
        let [a, b, c] = self.corners.map(|v| sight.vectors[v]);
        let [la, lb, lc] = self.corners.map(|v| sight.distances[v]);
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.cross(b).dot(c).atan2(below) / (4.0 * PI)
    }

    /// Distance of the triangle's plane from the point of view; positive from within.
    pub fn distance(&self, sight: &Sight) -> f64 {
        sight.vectors[self.corners[0]].dot(self.normal)
    }

    /// Displacement of the point of view for a displacement of each corner, as a matrix, at a Poisson's
    /// ratio; and the corner's share of `angle`, at which the triangle is seen.
    pub fn weights(&self, sight: &Sight, angle: f64, poisson: f64) -> [(DMat3, f64); 3] {
        let (d, omega) = (self.distance(sight), 4.0 * PI * angle);
        let heights = self.heights(sight);
        let edges = self.edges.map(|e| sight.edges[e]);
        // Sums along the edges: of `∫ ρ/r³`, `∫ 1/r`, `∫ ρρᵀ/r³`, and of those over `r⁵`.
        let (mut a, mut m, mut single, mut c) = (DVec2::ZERO, DVec2::ZERO, -d * omega, 0.0);
        let (mut s, mut b) = (DMat2::ZERO, DMat2::ZERO);
        let mut squares = [DMat2::ZERO; 3];
        for i in 0..3 {
            let (across, along, h, of) = (self.across[i], self.along[i], heights[i], edges[i]);
            a += of.log * across;
            m += of.cubed * across;
            single += h * of.log;
            c += h * of.cubed;
            s += outer(across, h * of.log * across + of.first * along);
            b += outer(across, h * of.cubed * across + of.first_cubed * along);
            squares[i] = h * h * of.cubed * outer(across, across)
                + h * of.first_cubed * symmetric(across, along)
                + of.second_cubed * outer(along, along);
        }
        // `∫ ρρᵀ/r³` and `3d ∫ ρρᵀ/r⁵`; both are symmetric but for rounding.
        let third = DMat2::from_diagonal(DVec2::splat(single)) - 0.5 * (s + s.transpose());
        let fifth = DMat2::from_diagonal(DVec2::splat(omega)) - 0.5 * d * (b + b.transpose());
        let (free, scale) = (1.0 - 2.0 * poisson, 1.0 / (8.0 * PI * (1.0 - poisson)));
        std::array::from_fn(|k| {
            // The hat function is `alpha + g ρ`.
            let (alpha, g) = (self.over_heights[k] * heights[k], -self.over_heights[k] * self.across[k]);
            // The integrals with the hat function: `∫ r/r³`, of which the part along the normal is by `d`
            // an angle.
            let (u, up) = (third * g - alpha * a, alpha * omega - d * g.dot(a));
            // The same of `3d ∫ rrᵀ/r⁵`.
            let cubes = (0..3).fold(symmetric(g, a), |sum, i| sum + g.dot(self.across[i]) * squares[i]);
            let block = alpha * fifth - d * cubes;
            let side = d * (fifth * g - alpha * d * m);
            let top = alpha * (omega + d * c) - d * d * d * g.dot(m);
            let local = DMat3::from_cols(
                (block.x_axis + DVec2::X * (free * up)).extend(side.x + free * u.x),
                (block.y_axis + DVec2::Y * (free * up)).extend(side.y + free * u.y),
                (side - free * u).extend(top + free * up),
            );
            (self.axes * (scale * local) * self.axes.transpose(), up / (4.0 * PI))
        })
    }

    /// Signed distances of the edges' lines from the point, in the plane.
    fn heights(&self, sight: &Sight) -> [f64; 3] {
        std::array::from_fn(|i| {
            let r = sight.vectors[self.corners[(i + 1) % 3]];
            self.across[i].dot(DVec2::new(self.axes.x_axis.dot(r), self.axes.y_axis.dot(r)))
        })
    }

    /// The point of the triangle that is nearest to another one.
    pub fn nearest(&self, x: DVec3, vertices: &[DVec3]) -> DVec3 {
        let p = self.corners.map(|v| vertices[v]);
        let onto = x - self.normal * (x - p[0]).dot(self.normal);
        let share: [f64; 3] = std::array::from_fn(|i| (onto - p[(i + 1) % 3]).dot(self.gradients[i]));
        if share.iter().all(|s| *s >= 0.0) {
            return onto;
        }
        let on_edge = |i: usize| {
            let (a, b) = (p[i], p[(i + 1) % 3]);
            a + ((x - a).dot(b - a) / a.distance_squared(b)).clamp(0.0, 1.0) * (b - a)
        };
        let edges = [0, 1, 2].map(on_edge);
        edges
            .into_iter()
            .min_by(|a, b| a.distance_squared(x).total_cmp(&b.distance_squared(x)))
            .unwrap_or(p[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed forms agree with sums over many small triangles, from points that are not near.
    #[test]
    fn weights_are_the_integrals() {
        let corners = [DVec3::new(0.1, -0.2, 0.3), DVec3::new(1.2, 0.1, -0.1), DVec3::new(0.4, 0.9, 0.5)];
        let vertices = [&corners[..], &[DVec3::new(0.3, 0.2, -2.0)]].concat();
        let cage = Cage::new(vertices, vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]).unwrap();
        let panel = &Panel::all(&cage)[0];
        let area = 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
        const PARTS: usize = 400;
        for x in [DVec3::new(0.5, 0.3, -0.8), DVec3::new(1.5, -0.9, 0.9), DVec3::new(0.2, 0.2, 1.0)] {
            for poisson in [-0.5, 0.0, 0.3, 0.49] {
                let mut sight = Sight::default();
                sight.look(x, &cage);
                let weights = panel.weights(&sight, panel.angle(&sight), poisson);
                let mut sums = [DMat3::ZERO; 3];
                for (i, j, half) in
                    (0..PARTS).flat_map(|i| (0..PARTS - i).flat_map(move |j| [(i, j, false), (i, j, true)]))
                {
                    if half && i + j + 1 == PARTS {
                        continue;
                    }
                    let off = if half { 2.0 } else { 1.0 } / 3.0;
                    let (b, c) = ((i as f64 + off) / PARTS as f64, (j as f64 + off) / PARTS as f64);
                    let hats = [1.0 - b - c, b, c];
                    let r = (0..3).fold(-x, |sum, k| sum + hats[k] * corners[k]);
                    let (length, n) = (r.length(), panel.normal);
                    let free = 1.0 - 2.0 * poisson;
                    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
                    let kernel = (DMat3::IDENTITY * (r.dot(n) * free)
                        + (outer(n, r) - outer(r, n)) * free
                        + outer(r, r) * (3.0 * r.dot(n) / r.length_squared()))
                        * (length.powi(-3) / (8.0 * PI * (1.0 - poisson)));
                    (0..3).for_each(|k| sums[k] += kernel * (hats[k] * area / (PARTS * PARTS) as f64));
                }
                for ((weights, _), sums) in weights.iter().zip(&sums) {
                    assert!(
                        (*weights - *sums).abs_diff_eq(DMat3::ZERO, 2e-6),
                        "{x} {poisson}: {weights} {sums}"
                    );
                }
                let shares: f64 = weights.iter().map(|w| w.1).sum();
                assert!((shares - panel.angle(&sight)).abs() < 1e-12);
            }
        }
    }
}
