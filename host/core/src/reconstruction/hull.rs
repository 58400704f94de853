//! The point of a convex hull that is nearest to the origin (P. Wolfe, *Finding the Nearest Point in a
//! Polytope*, 1976).

use glam::{DMat3, DVec3, Vec3};

/// Rounds at most; a few are enough, as each ends at the nearest point of another simplex.
const ROUNDS: usize = 32;

/// Part of a square that is nothing in double precision.
const NOTHING: f64 = 1e-12;

/// The way from the hull of `corners` (one at least, finite) to the origin, never too long but for rounding;
/// nothing within the hull.
pub fn way_from_hull(corners: &[Vec3]) -> Vec3 {
    let mut simplex = Simplex::corner(corners[0].as_dvec3());
    let (mut least, mut way) = (0.0, DVec3::ZERO);
    for _ in 0..ROUNDS {
        let x = simplex.nearest();
        let length = x.length();
        if length * length <= NOTHING * simplex.extent_squared() {
            return Vec3::ZERO;
        }
        let towards = |a: &DVec3| a.dot(x);
        let all = corners.iter().map(|a| a.as_dvec3());
        let corner = all.min_by(|a, b| towards(a).total_cmp(&towards(b))).unwrap_or(x);
        // All corners lie beyond this plane.
        let beyond = corner.dot(x) / length;
        if beyond > least {
            (least, way) = (beyond, -x * (beyond / length));
        }
        if length - beyond <= NOTHING * length || !simplex.include(corner) {
            break;
        }
    }
    way.as_vec3()
}

/// Corners, at most four, whose hull holds the point that is nearest so far, with the weights that give it.
struct Simplex {
    count: usize,
    corners: [DVec3; 4],
    weights: [f64; 4],
}

impl Simplex {
    fn corner(corner: DVec3) -> Self {
        Self { count: 1, corners: [corner; 4], weights: [1.0, 0.0, 0.0, 0.0] }
    }

    fn nearest(&self) -> DVec3 {
        (0..self.count).map(|i| self.corners[i] * self.weights[i]).sum()
    }

    fn extent_squared(&self) -> f64 {
        (0..self.count).map(|i| self.corners[i].length_squared()).fold(0.0, f64::max)
    }

    /// Goes to the nearest point of the hull with one more corner, and leaves those out that it does not
    /// need. Whether it came nearer.
    fn include(&mut self, corner: DVec3) -> bool {
        let before = self.nearest().length_squared();
        if self.count == 4 {
            return false;
        }
        (self.corners[self.count], self.weights[self.count]) = (corner, 0.0);
        self.count += 1;
        while let Some(weights) = self.affine_weights() {
            // As far as the hull goes towards the nearest point of the plane, line or space of the corners.
            let leaving = |i: &usize| weights[*i] < NOTHING;
            let part = |i: usize| self.weights[i] / (self.weights[i] - weights[i]);
            let first = (0..self.count).filter(leaving).min_by(|a, b| part(*a).total_cmp(&part(*b)));
            let Some(first) = first else {
                self.weights = weights;
                return self.nearest().length_squared() < before;
            };
            let t = part(first).clamp(0.0, 1.0);
            self.weights = std::array::from_fn(|i| self.weights[i] + t * (weights[i] - self.weights[i]));
            self.count -= 1;
            self.corners.swap(first, self.count);
            self.weights.swap(first, self.count);
        }
        false
    }

    /// The weights of the point nearest to the origin among all that are sums of the corners with weights of
    /// sum one; `None` where the corners do not span it.
    fn affine_weights(&self) -> Option<[f64; 4]> {
        let edge =
            |i: usize| if i + 1 < self.count { self.corners[i + 1] - self.corners[0] } else { DVec3::ZERO };
        let edges = DMat3::from_cols(edge(0), edge(1), edge(2));
        let mut squares = edges.transpose() * edges;
        let scale = edges.to_cols_array().iter().map(|x| x * x).sum::<f64>();
        let scale = if scale > 0.0 { scale } else { 1.0 };
        (self.count - 1..3).for_each(|i| squares.col_mut(i)[i] = scale);
        let weights = squares.inverse() * (edges.transpose() * -self.corners[0]);
        let all = [1.0 - weights.element_sum(), weights.x, weights.y, weights.z];
        all.iter().all(|w| w.is_finite()).then_some(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;
    use proptest::prelude::*;

    /// The least distance of the origin, which is outside, from corners, sides and triangles of any three
    /// corners.
    fn by_triangles(corners: &[Vec3]) -> f64 {
        let mut least = f64::INFINITY;
        for (i, a) in corners.iter().map(|a| a.as_dvec3()).enumerate() {
            for (j, b) in corners[..=i].iter().map(|b| b.as_dvec3()).enumerate() {
                let side = b - a;
                let t = (-a.dot(side) / side.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                least = least.min((a + side * t).length());
                for c in corners[..=j].iter().map(|c| c.as_dvec3()) {
                    let normal = side.cross(c - a);
                    let is_inside = |from: DVec3, to: DVec3| (to - from).cross(-from).dot(normal) > 0.0;
                    if is_inside(a, b) && is_inside(b, c) && is_inside(c, a) {
                        least = least.min(a.dot(normal).abs() / normal.length());
                    }
                }
            }
        }
        least
    }

    proptest! {
        #[test]
        fn the_nearest_of_all_triangles_is_found(
            places in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 1..12),
            thin in 0..6i32,
            away in 0.0..0.5f32,
            turn in prop::array::uniform3(-3.0..3.0f32),
        ) {
            let turn = Quat::from_scaled_axis(Vec3::from_array(turn));
            // A thin hull, all of it above a plane through the origin.
            let flat = |p: [f32; 3]| Vec3::new(p[0], p[1], (p[2] + 1.0) * 0.1f32.powi(thin) + away + 1e-3);
            let corners: Vec<Vec3> = places.into_iter().map(|p| turn * flat(p)).collect();
            let way = way_from_hull(&corners);
            let expected = by_triangles(&corners);
            prop_assert!((f64::from(way.length()) - expected).abs() < 1e-6, "{way} is not {expected} long");
            for c in &corners {
                prop_assert!((*c + way).dot(way) < 1e-6);
            }
        }

        #[test]
        fn within_it_there_is_no_way(places in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 0..20)) {
            let around = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_ONE];
            let corners: Vec<Vec3> = around.into_iter().chain(places.into_iter().map(Vec3::from_array)).collect();
            prop_assert!(way_from_hull(&corners).length() < 1e-6);
        }
    }

    #[test]
    fn corners_in_one_place_or_on_a_line_have_a_nearest_point() {
        let line = |at: fn(f32) -> Vec3| (-5i8..9).map(|i| at(f32::from(i))).collect::<Vec<_>>();
        for (corners, way) in [
            (vec![Vec3::X; 9], Vec3::NEG_X),
            (vec![Vec3::ZERO; 9], Vec3::ZERO),
            (line(|t| Vec3::new(1.0, t, t)), Vec3::NEG_X),
            (line(|t| Vec3::Y * (t + 8.0)), Vec3::NEG_Y * 3.0),
        ] {
            assert!(way_from_hull(&corners).abs_diff_eq(way, 1e-6), "{corners:?}");
        }
    }
}
