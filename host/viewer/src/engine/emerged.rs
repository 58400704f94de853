//! The samples of a model that is being opened, as they come: for the eye alone.

use glam::{DMat3, DVec3, Vec3};
use simod_core::geometry::symmetric_eigen;
use simod_model::progress::Emerging;

/// Most samples that are kept, of 28 bytes each; of more, each second one is.
const MOST: usize = 1 << 20;

/// Samples of the cells that are complete. All lists have one entry for each; all coordinates are local.
#[derive(Debug, Default)]
pub struct Emerged {
    /// Smallest and largest coordinates of the whole model.
    pub bounds: [DVec3; 2],
    /// Where they are.
    pub positions: Vec<Vec3>,
    /// Unit normals; zero where unknown.
    pub normals: Vec<Vec3>,
    /// About how far each is from those next to it.
    pub spacing: Vec<f32>,
    /// One of so many is kept.
    every: usize,
}

impl Emerged {
    /// Takes in the samples of a cell.
    pub(super) fn add(&mut self, cell: &Emerging<'_>) {
        if cell.first {
            let Emerging { bounds, frame, .. } = cell;
            let bounds = [bounds.min, bounds.max].map(|corner| frame.to_local_exact(corner));
            *self = Self { bounds, every: 1, ..Self::default() };
        }
        let (first, mut all) = (self.positions.len(), 0);
        cell.for_each(|position, normal| {
            if all % self.every == 0 {
                self.positions.push(position);
                self.normals.push(normal);
            }
            all += 1;
        });
        let Some(plane) = Plane::of(&self.positions[first..]) else { return };
        self.spacing.resize(self.positions.len(), plane.spacing);
        let outward = plane.normal * plane.normal.dot(plane.middle).signum();
        self.normals[first..].iter_mut().filter(|n| **n == Vec3::ZERO).for_each(|n| *n = outward);
        if self.positions.len() > MOST {
            self.every *= 2;
            halve(&mut self.positions);
            halve(&mut self.normals);
            halve(&mut self.spacing);
            self.spacing.iter_mut().for_each(|s| *s *= std::f32::consts::SQRT_2);
        }
    }
}

/// How some points lie.
struct Plane {
    middle: Vec3,
    normal: Vec3,
    /// How far they are apart, if they are spread evenly over the plane.
    spacing: f32,
}

impl Plane {
    /// By their principal components; nothing where there is no point.
    fn of(points: &[Vec3]) -> Option<Self> {
        let n = points.len() as f64;
        let middle = points.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n;
        let mut covariance = DMat3::ZERO;
        for d in points.iter().map(|p| p.as_dvec3() - middle) {
            covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (1.0 / n);
        }
        let (variances, axes) = symmetric_eigen(covariance);
        // Of a rectangle that is evenly covered, the variance is a twelfth of the square of its side.
        let area = 12.0 * (variances.y.max(0.0) * variances.z.max(0.0)).sqrt();
        let spacing = (area / n).sqrt() as f32;
        (!points.is_empty()).then(|| Self {
            middle: middle.as_vec3(),
            normal: axes.x_axis.as_vec3(),
            spacing,
        })
    }
}

/// Keeps each second one.
fn halve<T>(list: &mut Vec<T>) {
    let mut i = 0;
    list.retain(|_| {
        i += 1;
        i % 2 == 1
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_rectangle_tell_its_plane_and_their_spacing() {
        let spacing = 0.01;
        let tilt = glam::Quat::from_rotation_x(0.7);
        let point = |i: u32| tilt * Vec3::new(spacing * (i % 40) as f32, spacing * (i / 40) as f32, 0.5);
        let points: Vec<Vec3> = (0..1600).map(point).collect();
        let plane = Plane::of(&points).unwrap();
        assert!(plane.normal.dot(tilt * Vec3::Z).abs() > 0.9999);
        assert!((plane.spacing / spacing - 1.0).abs() < 0.01, "{}", plane.spacing);
        let alone = Plane::of(&points[..1]).unwrap();
        assert!(alone.spacing == 0.0 && alone.middle == points[0]);
        assert!(Plane::of(&[]).is_none());
    }

    #[test]
    fn of_too_many_each_second_one_is_left() {
        let mut list: Vec<u32> = (0..7).collect();
        halve(&mut list);
        assert_eq!(list, [0, 2, 4, 6]);
    }
}
