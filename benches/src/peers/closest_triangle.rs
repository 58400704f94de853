//! The closest point of the triangles between the samples, found by parry's tree of boxes.

use glam::{DMat3, DVec3, Vec3};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::TriMesh;

use super::Field;
use crate::distance::{triangle_mesh, vector};

/// Treatment of the vector from the closest point to the vertex.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Offset {
    /// The vector stays as it is.
    Kept,
    /// The vector goes with the triangle: two edges, and the normal as long as the root of the area.
    Carried,
}

pub struct ClosestTriangle {
    mesh: TriMesh,
    rest: Vec<DVec3>,
    deformed: Vec<DVec3>,
    offset: Offset,
}

impl ClosestTriangle {
    pub fn new(rest: &[Vec3], deformed: &[Vec3], triangles: &[[u32; 3]], offset: Offset) -> Self {
        let double = |points: &[Vec3]| points.iter().map(|p| p.as_dvec3()).collect::<Vec<_>>();
        let (rest, deformed) = (double(rest), double(deformed));
        let mesh = triangle_mesh(&rest, triangles).expect("triangles between the samples");
        Self { mesh, rest, deformed, offset }
    }
}

impl Field for ClosestTriangle {
    fn displacement(&self, p: DVec3) -> DVec3 {
        let (_, (triangle, location)) = self.mesh.project_local_point_and_get_location(vector(p), false);
        let corners = self.mesh.indices()[triangle as usize].map(|i| i as usize);
        let before = corners.map(|i| self.rest[i]);
        let after = corners.map(|i| self.deformed[i]);
        let weights = location.barycentric_coordinates().unwrap_or([1.0, 0.0, 0.0]);
        let at = |corners: [DVec3; 3]| corners.iter().zip(weights).map(|(p, w)| *p * w).sum::<DVec3>();
        let (from, to) = (at(before), at(after));
        match self.offset {
            Offset::Kept => to - from,
            Offset::Carried => {
                let change = frame(after) - frame(before);
                to - from + change * (frame(before).inverse() * (p - from))
            }
        }
    }
}

/// Two edges of a triangle, and its normal as long as the root of its area (twice).
fn frame([a, b, c]: [DVec3; 3]) -> DMat3 {
    let normal = (b - a).cross(c - a);
    let length = normal.length().sqrt();
    DMat3::from_cols(b - a, c - a, if length > 0.0 { normal / length } else { DVec3::ZERO })
}
