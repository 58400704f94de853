//! Pose of a moved cage: the motion of the whole, and the map of each of its faces.

use crate::mesh::Cage;
use crate::panels::Panel;
use glam::{DMat3, DVec3};
use simod_geometry::outer;

/// Part of the volume of a map's lengths below which the map is flat.
const FLAT: f64 = 1e-9;
/// Least volume of a face's map: smaller ones are taken to have this.
const LEAST: f64 = 1e-9;
/// Greatest number of steps of Newton's method for a rotation; five to eight are usual.
const STEPS: usize = 40;
/// Size of a step of that method below which it is the last one.
const SETTLED: f64 = 1e-7;

/// The vertices of a moved cage, with maps of its faces.
#[derive(Debug)]
pub struct MovedCage {
    /// Vertices, relative to their mean.
    pub vertices: Vec<DVec3>,
    pub mean: DVec3,
    /// Stretch that all of the cage has in common, of volume 1 or -1.
    pub common: DMat3,
    /// Map of each vertex that follows the common stretch: the mean of the maps of its faces.
    pub maps: Vec<DMat3>,
    /// Mean of the logarithms of the scales of these faces, for each vertex.
    pub scales: Vec<f64>,
    /// Similarity of the whole cage that follows the common stretch.
    whole: DMat3,
}

impl MovedCage {
    /// The pose of a cage whose vertices were moved by these displacements.
    pub fn new(cage: &Cage, panels: &[Panel], displacements: &[DVec3]) -> Self {
        let moved: Vec<DVec3> = cage.vertices.iter().zip(displacements).map(|(p, d)| *p + *d).collect();
        let mean = moved.iter().sum::<DVec3>() / moved.len() as f64;
        let vertices: Vec<DVec3> = moved.iter().map(|p| *p - mean).collect();
        let (common, whole) = common_stretch(cage, &vertices);
        let mut sums = vec![(DMat3::ZERO, 0.0, 0.0); vertices.len()];
        for panel in panels {
            let map = face(panel, &vertices, &common);
            let scale = map.determinant().max(LEAST).ln() / 3.0;
            for (v, angle) in panel.corners.into_iter().zip(panel.corner_angles) {
                let (maps, scales, angles) = sums[v];
                sums[v] = (maps + map * angle, scales + scale * angle, angles + angle);
            }
        }
        // Vertices whose faces all have no area have no share either.
        let mean_of = |sum: f64| if sum > 0.0 { sum.recip() } else { 0.0 };
        let maps = sums.iter().map(|(maps, _, angles)| *maps * mean_of(*angles)).collect();
        let scales = sums.iter().map(|(_, scales, angles)| scales * mean_of(*angles)).collect();
        Self { vertices, mean, common, maps, scales, whole }
    }

    /// Map nearest to a sum of the vertices' maps, among those that are a similarity after the common
    /// stretch; the similarity of the whole cage where the sum is flat or turned inside out.
    pub fn frame(&self, sum: DMat3, scale: f64) -> DMat3 {
        let volume = sum.determinant();
        let is_flat = volume <= FLAT * size(&sum).powi(3);
        // A mean of maps that are turned against each other is smaller than each of them. As an elastic
        // body in a bend or a twist gives way a little, too, the truth lies between.
        let similarity =
            if is_flat { self.whole } else { rotation(sum) * (scale.exp() * volume.cbrt()).sqrt() };
        similarity * self.common
    }
}

/// Root of the mean square of the stretches.
fn size(m: &DMat3) -> f64 {
    ([m.x_axis, m.y_axis, m.z_axis].iter().map(|a| a.length_squared()).sum::<f64>() / 3.0).sqrt()
}

/// The rotation nearest to a matrix with a volume, by Newton's method for the polar decomposition (N. J.
/// Higham, *Computing the polar decomposition, with applications*, SIAM J. Sci. Stat. Comput. 7, 1986).
fn rotation(m: DMat3) -> DMat3 {
    let mut x = m * m.determinant().cbrt().recip();
    for _ in 0..STEPS {
        // The inverse of the transpose has the cofactors divided by the volume.
        let [a, b, c] = [x.x_axis, x.y_axis, x.z_axis];
        let volume = a.dot(b.cross(c));
        let next = 0.5 * (x + DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b)) * volume.recip());
        let step = size(&(next - x));
        x = next;
        // The error left is the square of the step.
        if step < SETTLED {
            break;
        }
    }
    x
}

/// Stretch that the cage has in common, and the similarity that follows.
///
/// The affine map nearest to a pose stretches by `P`. Where the pose is that map, `P` is the wanted
/// stretch; where the pose is a bend, `P` has nothing to do with it. So only a part of `P` is taken: the
/// affine map's share in explaining the part of the pose that no similarity explains. That is all of `P`
/// for an affine map, and next to nothing for bends, twists and single vertices.
fn common_stretch(cage: &Cage, moved: &[DVec3]) -> (DMat3, DMat3) {
    let rest = |v: usize| cage.vertices[v] - cage.mean;
    let spread = (0..moved.len()).fold(DMat3::ZERO, |sum, v| sum + outer(moved[v], rest(v)));
    let affine = spread * cage.scatter_inverse;
    let volume = affine.determinant();
    if volume.abs() <= FLAT * size(&affine).powi(3) {
        let scale = size(&affine);
        return (DMat3::IDENTITY, DMat3::IDENTITY * if scale > FLAT { scale } else { 1.0 });
    }
    let turn = rotation(affine * volume.signum());
    let scale = volume.abs().cbrt();
    let missed = |map: DMat3| (0..moved.len()).map(|v| moved[v].distance_squared(map * rest(v))).sum::<f64>();
    // The scale is the best one for the rotation.
    let along: f64 = (0..moved.len()).map(|v| moved[v].dot(turn * rest(v))).sum();
    let over: f64 = (0..moved.len()).map(|v| rest(v).length_squared()).sum();
    let (by_affine, by_similarity) = (missed(affine), missed(turn * (along / over)));
    let explained =
        if by_similarity > 0.0 { (1.0 - by_affine / by_similarity).max(0.0).powi(2) } else { 0.0 };
    let stretch = turn.transpose() * affine * scale.recip();
    let common = if volume > 0.0 {
        DMat3::IDENTITY + (stretch - DMat3::IDENTITY) * explained
    } else if explained > 0.5 {
        // A mirrored stretch is taken whole, if at all: between it and the identity lie flat maps.
        stretch
    } else {
        DMat3::IDENTITY
    };
    (common * common.determinant().abs().cbrt().recip(), turn * scale)
}

/// Map from a face that was stretched by `common` to its present place: exact along the face, and across
/// the face as if the map were a similarity.
fn face(panel: &Panel, moved: &[DVec3], common: &DMat3) -> DMat3 {
    let map = (0..3).fold(DMat3::ZERO, |sum, k| sum + outer(moved[panel.corners[k]], panel.gradients[k]));
    let [x, y] = panel.in_plane();
    let (from, to) = ([*common * x, *common * y], [map * x, map * y]);
    let (across_from, across_to) = (from[0].cross(from[1]), to[0].cross(to[1]));
    // The height is scaled by the root of the ratio of the areas.
    let height = (across_to.length() / across_from.length()).sqrt() * across_to.normalize_or_zero();
    DMat3::from_cols(to[0], to[1], height)
        * DMat3::from_cols(from[0], from[1], across_from.normalize_or_zero()).inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rotations_are_the_nearest(m in prop::array::uniform9(-1.0..1.0_f64)) {
            let m = DMat3::from_cols_array(&m);
            let m = m * m.determinant().signum();
            prop_assume!(m.determinant() > 1e-3);
            let r = rotation(m);
            prop_assert!((r * r.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-12));
            // The stretch that is left is symmetric.
            let stretch = r.transpose() * m;
            prop_assert!((stretch - stretch.transpose()).abs_diff_eq(DMat3::ZERO, 1e-9));
            prop_assert!(stretch.x_axis.x + stretch.y_axis.y + stretch.z_axis.z > 0.0);
        }
    }
}
