//! Triangles of samples with the numbers that finite elements need: cotangents and Voronoi areas, from edge
//! lengths alone.
//!
//! U. Pinkall, K. Polthier, *Computing Discrete Minimal Surfaces and Their Conjugates*, Experimental
//! Mathematics 1993; M. Meyer et al., *Discrete Differential-Geometry Operators for Triangulated
//! 2-Manifolds*, VisMath 2002.

use glam::DVec3;

/// A triangle of samples. Triangle, weights and areas may be of an intrinsic triangulation, whose edges are
/// no straight lines in space; corners may then be the same sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceTriangle {
    /// Samples.
    pub corners: [u32; 3],
    /// Half the cotangent of the angle at each corner: the weight of the edge opposite to it.
    pub weights: [f64; 3],
    /// The part of the area that belongs to each corner.
    pub areas: [f64; 3],
}

impl SurfaceTriangle {
    /// The triangle of the lengths of the edges opposite to the corners.
    pub fn new(corners: [u32; 3], lengths: [f64; 3]) -> Self {
        Self { corners, weights: half_cotangents(lengths), areas: voronoi_areas(lengths) }
    }

    /// Two samples that hold each other, as the edges of triangles do.
    pub fn link(a: u32, b: u32, weight: f64) -> [Self; 2] {
        // A triangle of which two corners coincide is added for both, so that neither sample counts for more.
        let half = |corners| Self { corners, weights: [0.0, weight / 4.0, weight / 4.0], areas: [0.0; 3] };
        [half([a, b, b]), half([b, a, a])]
    }

    /// Copy with all weights and areas times `factor`.
    pub fn scaled(self, factor: f64) -> Self {
        let Self { corners, weights, areas } = self;
        Self { corners, weights: weights.map(|w| factor * w), areas: areas.map(|a| factor * a) }
    }

    /// Sum of the weights times the edge vectors from a corner: this triangle's part in the corner's row of
    /// the Laplacian.
    pub fn laplacian(&self, corner: usize, at: impl Fn(u32) -> DVec3) -> DVec3 {
        let (b, c) = ((corner + 1) % 3, (corner + 2) % 3);
        let p = at(self.corners[corner]);
        self.weights[c] * (p - at(self.corners[b])) + self.weights[b] * (p - at(self.corners[c]))
    }
}

/// Four times the area, after W. Kahan's *Miscalculating Area and Angles of a Needle-like Triangle*.
fn four_areas(lengths: [f64; 3]) -> f64 {
    let mut l = lengths;
    l.sort_by(|a, b| b.total_cmp(a));
    let [a, b, c] = l;
    ((a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))).max(0.0).sqrt()
}

/// Half the cotangents of the angles opposite to the edges.
pub fn half_cotangents(lengths: [f64; 3]) -> [f64; 3] {
    let area = 2.0 * four_areas(lengths);
    opposite(lengths, |a, b, c| (b * b + c * c - a * a) / area)
}

/// The part of the area nearest to each corner; of obtuse triangles, half for the blunt corner and a quarter
/// for each of the others.
fn voronoi_areas(lengths: [f64; 3]) -> [f64; 3] {
    let area = four_areas(lengths) / 4.0;
    let cosines = opposite(lengths, |a, b, c| (b * b + c * c - a * a) / (2.0 * b * c));
    if let Some(blunt) = cosines.iter().position(|c| *c < 0.0) {
        return std::array::from_fn(|k| if k == blunt { area / 2.0 } else { area / 4.0 });
    }
    // The circumcentre's barycentric coordinates are the areas of the triangles that it makes with the edges.
    let parts: [f64; 3] = std::array::from_fn(|k| cosines[k] * lengths[k]);
    let sum: f64 = parts.iter().sum();
    opposite(parts, |_, b, c| area * (b + c) / (2.0 * sum))
}

/// A function of each edge's number and those of the two others.
fn opposite(of: [f64; 3], f: impl Fn(f64, f64, f64) -> f64) -> [f64; 3] {
    [f(of[0], of[1], of[2]), f(of[1], of[2], of[0]), f(of[2], of[0], of[1])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_right_triangle() {
        let e = SurfaceTriangle::new([0, 1, 2], [2.0_f64.sqrt(), 1.0, 1.0]);
        for (found, expected) in e.weights.into_iter().chain(e.areas).zip([0.0, 0.5, 0.5, 0.25, 0.125, 0.125])
        {
            assert!((found - expected).abs() < 1e-12, "{e:?}");
        }
        let e = SurfaceTriangle::new([0, 1, 2], [3.0; 3]);
        assert!(e.weights.iter().all(|w| (w - 0.5 / 3.0_f64.sqrt()).abs() < 1e-12), "{e:?}");
    }

    #[test]
    fn areas_add_up() {
        for lengths in [[3.0, 4.0, 5.0], [2.0, 3.0, 4.9], [1.0, 1.0, 1.9], [1.0, 1.1, 1e-3 + 0.1]] {
            let sum: f64 = voronoi_areas(lengths).iter().sum();
            assert!((sum - four_areas(lengths) / 4.0).abs() < 1e-12, "{lengths:?}");
        }
    }
}
