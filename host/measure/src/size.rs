//! Volumes, lengths and areas.

use glam::DVec3;

use super::spread::Spread;
use super::triangle::{Edges, corners, cross, either_way, pair, sides, sorted};

/// The volume that a closed mesh holds, by signed tetrahedra: negative for one that is inside out.
pub fn volume(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    // About a corner: far from zero, large tetrahedra would cancel out.
    let Some(origin) = triangles.iter().find_map(|t| corners(positions, *t)).map(|[a, ..]| a) else {
        return 0.0;
    };
    let all = triangles.iter().filter_map(|t| corners(positions, *t));
    all.map(|c| c.map(|p| p - origin)).map(|[a, b, c]| a.cross(b).dot(c)).sum::<f64>() / 6.0
}

/// Whether a mesh holds a volume: all sides of triangles, but for one in a hundred, are also sides of another
/// triangle, the other way round. A mesh may lack that many where it was made of a closed one by joining
/// vertices.
pub fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let going = |up: bool| {
        let sides = sides(triangles.iter().copied()).filter(|[a, b]| (a < b) == up);
        sorted(sides.map(either_way))
    };
    // Sides that go one way and the other; each two that are the same are taken off together.
    let (up, down) = (going(true), going(false));
    let (mut i, mut k, mut closed) = (0, 0, 0);
    while i < up.len() && k < down.len() {
        let (a, b) = (up[i], down[k]);
        (i, k, closed) = (i + usize::from(a <= b), k + usize::from(b <= a), closed + 2 * usize::from(a == b));
    }
    let all = up.len() + down.len();
    all > 0 && (all - closed) * 100 <= all
}

/// Open mesh, which encloses a volume with the plane of its border: between each triangle and that plane,
/// more where the triangle is above, less where it is below.
pub struct OpenMesh {
    origin: DVec3,
    normal: DVec3,
}

impl OpenMesh {
    /// Plane in the middle of the border at rest, at right angles to the sum of the triangles' normals; none
    /// where there is no border, or the sum is zero.
    pub fn from_triangles(rest: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let valid = triangles.iter().filter(|t| corners(rest, **t).is_some());
        let sides = sorted(sides(valid.copied()).map(either_way));
        let border = sides.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| pair(same[0]));
        let (mut sum, mut length) = (DVec3::ZERO, 0.0);
        for [a, b] in border.map(|side| side.map(|i| rest[i as usize])) {
            sum += a.distance(b) * 0.5 * (a + b);
            length += a.distance(b);
        }
        let normal = triangles.iter().filter_map(|t| corners(rest, *t)).map(cross).sum::<DVec3>();
        (length > 0.0).then_some(Self { origin: sum / length, normal: normal.try_normalize()? })
    }

    /// Volume between the mesh and the plane, which stays where it is at rest.
    pub fn volume(&self, positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
        let all = triangles.iter().filter_map(|t| corners(positions, *t));
        // A prism: the triangle as seen along the normal, by its mean height.
        let prism = |c: [DVec3; 3]| {
            let height: f64 = c.iter().map(|p| (*p - self.origin).dot(self.normal)).sum();
            0.5 * cross(c).dot(self.normal) * height / 3.0
        };
        all.map(prism).sum()
    }
}

/// The area of a mesh.
pub fn area(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    0.5 * triangles.iter().filter_map(|t| corners(positions, *t)).map(|c| cross(c).length()).sum::<f64>()
}

/// The change |l′ / l − 1| of all edges, of length l at rest and l′ deformed. Edges without a length at rest
/// do not count.
pub fn edge_distortion(rest: &[DVec3], deformed: &[DVec3], edges: &Edges) -> Spread {
    Spread::from_amounts(changes(edges.lengths(rest, deformed)))
}

/// The change |A′ / A − 1| of all triangles, of area A at rest and A′ deformed. Those without an area at rest
/// do not count.
pub fn area_distortion(rest: &[DVec3], deformed: &[DVec3], triangles: &[[u32; 3]]) -> Spread {
    let areas = triangles
        .iter()
        .filter_map(|t| Some([cross(corners(rest, *t)?).length(), cross(corners(deformed, *t)?).length()]));
    Spread::from_amounts(changes(areas))
}

fn changes(sizes: impl Iterator<Item = [f64; 2]>) -> Vec<f64> {
    sizes.filter(|[rest, _]| *rest > 0.0).map(|[rest, deformed]| (deformed / rest - 1.0).abs()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Details;
    use glam::{DMat3, DQuat};

    /// A box with sides 1, 2 and 3.
    fn brick() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i & 2), 3.0 * f64::from(i >> 2));
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        ((0..8).map(corner).collect(), triangles)
    }

    #[test]
    fn a_brick_has_its_volume_and_area_wherever_it_is() {
        let (rest, triangles) = brick();
        for shift in [0.0, -1.0, 1e6] {
            let moved: Vec<_> = rest.iter().map(|p| *p + shift).collect();
            assert!((volume(&moved, &triangles) - 6.0).abs() < 1e-8);
            assert!((area(&moved, &triangles) - 22.0).abs() < 1e-8);
        }
        let mirrored: Vec<_> = rest.iter().map(|p| -*p).collect();
        assert!((volume(&mirrored, &triangles) + 6.0).abs() < 1e-12);
        // Without one triangle, or with one turned round, it holds nothing.
        assert!(is_closed(&triangles) && !is_closed(&triangles[1..]) && !is_closed(&[]));
        let turned = triangles
            .iter()
            .enumerate()
            .map(|(i, [a, b, c])| if i == 3 { [*a, *c, *b] } else { [*a, *b, *c] });
        assert!(!is_closed(&turned.collect::<Vec<_>>()));
    }

    #[test]
    fn an_open_box_holds_what_it_holds_with_its_lid() {
        let (rest, triangles) = brick();
        // Without the quad at the top, z = 3.
        let open: Vec<[u32; 3]> = [&triangles[..2], &triangles[4..]].concat();
        let plane = OpenMesh::from_triangles(&rest, &open).unwrap();
        assert!((plane.volume(&rest, &open).abs() - 6.0).abs() < 1e-12);
        let deeper: Vec<_> = rest.iter().map(|p| if p.z == 0.0 { p.with_z(-1.0) } else { *p }).collect();
        let ratio = plane.volume(&deeper, &open) / plane.volume(&rest, &open);
        assert!((ratio - 4.0 / 3.0).abs() < 1e-12, "{ratio}");
        assert!(
            OpenMesh::from_triangles(&rest, &triangles).is_none()
                && OpenMesh::from_triangles(&rest, &[]).is_none()
        );
    }

    #[test]
    fn a_rigid_motion_changes_nothing_and_a_scale_all_lengths_alike() {
        let (rest, triangles) = brick();
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.0);
        for scale in [1.0, 0.5, 3.0] {
            let moved: Vec<_> = rest.iter().map(|p| turn * *p * scale + DVec3::ONE).collect();
            let expect = |spread: Spread, change: f64| {
                for figure in [spread.rms, spread.p99, spread.max] {
                    assert!((figure - change.abs()).abs() < 1e-12, "{spread:?} instead of {change}");
                }
            };
            expect(edge_distortion(&rest, &moved, &Edges::from_triangles(&rest, &triangles)), scale - 1.0);
            expect(area_distortion(&rest, &moved, &triangles), scale * scale - 1.0);
            assert!((volume(&moved, &triangles) - 6.0 * scale.powi(3)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_stretch_changes_edges_along_it_alone() {
        // A square of two triangles, to twice its width: two edges are doubled, two kept, the diagonal is √5
        // / √2.
        let rest = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        let deformed = rest.map(|p| DMat3::from_diagonal(DVec3::new(2.0, 1.0, 1.0)) * p);
        let triangles = [[0, 1, 2], [0, 2, 3]];
        let diagonal = 2.5f64.sqrt() - 1.0;
        let expected = ((2.0 + diagonal * diagonal) / 5.0).sqrt();
        let edges = edge_distortion(&rest, &deformed, &Edges::from_triangles(&rest, &triangles));
        assert!((edges.rms - expected).abs() < 1e-12 && (edges.max - 1.0).abs() < 1e-12, "{edges:?}");
        assert!((area_distortion(&rest, &deformed, &triangles).rms - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_triangle_is_left_out() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::NAN];
        let triangles = [[0, 1, 2], [0, 1, 9], [1, 2, 3], [1, 1, 1]];
        assert_eq!(area(&positions, &triangles), 0.5);
        assert_eq!(
            edge_distortion(&positions, &positions, &Edges::from_triangles(&positions, &triangles)),
            Spread::default()
        );
        assert_eq!(area_distortion(&positions, &positions, &triangles), Spread::default());
        assert_eq!(volume(&[], &[]), 0.0);
        assert_eq!(Details::new(&positions, &triangles, 0.1).rotation(&positions).rms, 0.0);
    }
}
