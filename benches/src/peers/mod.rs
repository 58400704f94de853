//! Other ways to carry a deformation from points to a surface, as they are usually written: for every vertex
//! a query of a tree, no memory of the vertex before, all cores, models in memory.

mod affine_least_squares;
mod closest_triangle;
mod inverse_distance;
mod thin_plate;

use std::num::NonZeroUsize;

use glam::{DVec3, Vec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use simod_core::sampled_model::SampledModel;
use simod_model::frame::Frame;

use affine_least_squares::AffineLeastSquares;
use closest_triangle::{ClosestTriangle, Offset};
use inverse_distance::InverseDistance;
use thin_plate::ThinPlate;

/// Vertices that a thread takes at a time.
const BLOCK: usize = 1024;

/// A way to carry a deformation over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Peer {
    /// Inverse distance weighting over 8 samples, with weights 1/d² (D. Shepard 1968).
    InverseDistance,
    /// Moving least squares over 16 samples, with affine maps.
    AffineLeastSquares,
    /// Thin-plate splines with affine terms through 16 samples, as SciPy's `RBFInterpolator` with
    /// `neighbors=16`.
    ThinPlate,
    /// The displacement of the closest point of P_S's triangles.
    ClosestPoint,
    /// The same, and the offset from there carried with the frame of the triangle, as surface-deform
    /// modifiers do.
    ClosestFrame,
}

impl Peer {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::InverseDistance,
        Self::AffineLeastSquares,
        Self::ThinPlate,
        Self::ClosestPoint,
        Self::ClosestFrame,
    ];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::InverseDistance => "inverse distances, 8",
            Self::AffineLeastSquares => "affine least squares, 16",
            Self::ThinPlate => "thin plates, 16",
            Self::ClosestPoint => "closest triangle",
            Self::ClosestFrame => "closest triangle's frame",
        }
    }

    /// Whether the peer needs triangles between the samples.
    pub fn needs_triangles(self) -> bool {
        matches!(self, Self::ClosestPoint | Self::ClosestFrame)
    }

    /// Prepares it for samples and their local positions after the deformation.
    ///
    /// # Panics
    /// It needs triangles, and there are none.
    pub fn prepare(self, sampled: &SampledModel, deformed: &[Vec3]) -> Box<dyn Field> {
        let rest = &sampled.samples.positions;
        let triangles = |offset| ClosestTriangle::new(rest, deformed, &sampled.triangles, offset);
        match self {
            Self::InverseDistance => Box::new(InverseDistance(Cloud::new(rest, deformed))),
            Self::AffineLeastSquares => Box::new(AffineLeastSquares(Cloud::new(rest, deformed))),
            Self::ThinPlate => Box::new(ThinPlate(Cloud::new(rest, deformed))),
            Self::ClosestPoint => Box::new(triangles(Offset::Kept)),
            Self::ClosestFrame => Box::new(triangles(Offset::Carried)),
        }
    }
}

/// A deformation that can be asked for anywhere near the samples.
pub trait Field: Send + Sync {
    /// The displacement of a point, both in local coordinates.
    fn displacement(&self, p: DVec3) -> DVec3;
}

/// The positions of vertices after the deformation, on all cores. Those that are not finite stay.
pub fn carry(field: &dyn Field, frame: &Frame, positions: &[DVec3]) -> Vec<DVec3> {
    let moved = |p: &DVec3| *p + field.displacement(frame.to_local_exact(*p)) * frame.scale;
    let carried = |p: &DVec3| if p.is_finite() { moved(p) } else { *p };
    positions.par_iter().with_min_len(BLOCK).map(carried).collect()
}

/// Samples with their displacements, to be found by a k-d tree.
struct Cloud {
    tree: ImmutableKdTree<f32, 3>,
    samples: Vec<Sample>,
}

/// A sample as a vertex sees it.
#[derive(Clone, Copy)]
struct Sample {
    position: DVec3,
    displacement: DVec3,
}

impl Cloud {
    fn new(rest: &[Vec3], deformed: &[Vec3]) -> Self {
        let tree = ImmutableKdTree::new_from_slice(bytemuck::cast_slice(rest));
        let sample = |(p, q): (&Vec3, &Vec3)| Sample {
            position: p.as_dvec3(),
            displacement: q.as_dvec3() - p.as_dvec3(),
        };
        Self {
            tree: tree.expect("finite samples, fewer than 2^32"),
            samples: rest.iter().zip(deformed).map(sample).collect(),
        }
    }

    /// The nearest samples, nearest first.
    fn nearest(&self, p: DVec3, count: NonZeroUsize) -> impl ExactSizeIterator<Item = Sample> {
        let query = p.as_vec3().to_array();
        let found = self.tree.query(&query).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        found.into_iter().map(|found| self.samples[found.item as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples of a bumpy sheet, and an affine map of them.
    pub fn sheet() -> Vec<Vec3> {
        let at = |i: u16, j: u16| (0.1 * f32::from(i), 0.1 * f32::from(j));
        let height = |x: f32, y: f32| 0.2 * (3.0 * x).sin() * (2.0 * y).cos();
        let points = (0..20u16).flat_map(|i| (0..20u16).map(move |j| at(i, j)));
        points.map(|(x, y)| Vec3::new(x, y, height(x, y))).collect()
    }

    fn affine(p: DVec3) -> DVec3 {
        DVec3::new(1.2 * p.x - 0.3 * p.y + 0.5, 0.9 * p.y + 0.2 * p.z, 0.4 * p.x + 0.8 * p.z - 1.0)
    }

    fn clouds(map: impl Fn(DVec3) -> DVec3) -> (Vec<Vec3>, Cloud) {
        let rest = sheet();
        let deformed: Vec<Vec3> = rest.iter().map(|p| map(p.as_dvec3()).as_vec3()).collect();
        let cloud = Cloud::new(&rest, &deformed);
        (rest, cloud)
    }

    /// Points near the sheet, not on it.
    fn queries() -> impl Iterator<Item = DVec3> {
        sheet().into_iter().map(|p| p.as_dvec3() + DVec3::new(0.031, -0.022, 0.004))
    }

    /// Largest distance of a field's images from those of a map.
    fn worst(field: &dyn Field, map: impl Fn(DVec3) -> DVec3, points: impl Iterator<Item = DVec3>) -> f64 {
        points.map(|p| (p + field.displacement(p)).distance(map(p))).fold(0.0, f64::max)
    }

    #[test]
    fn inverse_distances_reproduce_translations_and_samples() {
        let moved = |p: DVec3| p + DVec3::new(1.0, -2.0, 0.5);
        assert!(worst(&InverseDistance(clouds(moved).1), moved, queries()) < 1e-6);
        let (rest, cloud) = clouds(affine);
        assert!(worst(&InverseDistance(cloud), affine, rest.iter().map(|p| p.as_dvec3())) < 1e-6);
    }

    #[test]
    fn least_squares_reproduce_affine_maps() {
        // But for the regularisation, which counts where samples lie nearly in a plane: not in a solid.
        let layers =
            (0..5u8).flat_map(|i| sheet().into_iter().map(move |p| p + 0.1 * f32::from(i) * Vec3::Z));
        let rest: Vec<Vec3> = layers.collect();
        let deformed: Vec<Vec3> = rest.iter().map(|p| affine(p.as_dvec3()).as_vec3()).collect();
        let field = AffineLeastSquares(Cloud::new(&rest, &deformed));
        assert!(worst(&field, affine, queries().map(|p| p + 0.2 * DVec3::Z)) < 1e-5);
        let (_, cloud) = clouds(affine);
        assert!(worst(&AffineLeastSquares(cloud), affine, queries()) < 1e-2);
    }

    #[test]
    fn thin_plates_reproduce_affine_maps_and_samples() {
        assert!(worst(&ThinPlate(clouds(affine).1), affine, queries()) < 1e-5);
        let wave = |p: DVec3| p + 0.3 * (p * 4.0).map(f64::sin);
        let (rest, cloud) = clouds(wave);
        assert!(worst(&ThinPlate(cloud), wave, rest.iter().map(|p| p.as_dvec3())) < 1e-5);
    }

    #[test]
    fn thin_plates_are_those_of_scipy() {
        let (_, cloud) = clouds(|p| p + 0.3 * (p * 4.0).map(f64::sin));
        let p = DVec3::new(0.73, 1.08, 0.1);
        // SciPy 1.17: RBFInterpolator(samples, displacements, neighbors=16, kernel="thin_plate_spline").
        let expected = DVec3::new(0.798_049_5, 0.848_662_2, 0.210_107_7);
        let found = p + ThinPlate(cloud).displacement(p);
        assert!(found.distance(expected) < 1e-5, "{found}");
    }

    #[test]
    fn thin_plates_take_samples_of_a_plane() {
        let rest: Vec<Vec3> = sheet().into_iter().map(|p| Vec3::new(p.x, p.y, 0.0)).collect();
        let deformed: Vec<Vec3> = rest.iter().map(|p| affine(p.as_dvec3()).as_vec3()).collect();
        let field = ThinPlate(Cloud::new(&rest, &deformed));
        let on_plane = queries().map(|p| p.with_z(0.0));
        assert!(worst(&field, affine, on_plane) < 1e-5);
    }

    #[test]
    fn triangles_interpolate_and_carry_offsets() {
        let rest = [Vec3::ZERO, Vec3::X, Vec3::Y];
        // Twice as large, and turned: x to y, y to z, z to x.
        let turned = |p: DVec3| 2.0 * DVec3::new(p.z, p.x, p.y);
        let deformed = rest.map(|p| turned(p.as_dvec3()).as_vec3());
        let field = |offset| ClosestTriangle::new(&rest, &deformed, &[[0, 1, 2]], offset);
        let on = DVec3::new(0.3, 0.2, 0.0);
        let above = on.with_z(0.1);
        let image = |field: &ClosestTriangle, p: DVec3| p + field.displacement(p);
        assert!(image(&field(Offset::Kept), on).distance(turned(on)) < 1e-6);
        assert!(image(&field(Offset::Kept), above).distance(turned(on) + 0.1 * DVec3::Z) < 1e-6);
        assert!(image(&field(Offset::Carried), above).distance(turned(above)) < 1e-6);
    }
}
