//! Triangles of P_S.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Write;

use glam::{DVec3, Vec3};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Grouping, Sampling, Skip, Splitting, Target};
use simod_generate::Shape;

use crate::body::{Body, sample_file, triangle_set};

fn samples(n: u64) -> Sampling {
    Sampling { target: Target::Samples(n), ..Sampling::default() }
}

/// Checks rules that no triangles break, however they came about.
fn check_each(sampled: &SampledModel) {
    let count = sampled.samples.len() as u32;
    for corners in &sampled.triangles {
        assert!(corners.iter().all(|i| *i < count), "{corners:?} of {count} samples");
        let [a, b, c] = corners;
        assert!(a != b && b != c && c != a, "{corners:?} is no triangle");
    }
    assert_eq!(
        triangle_set(sampled.triangles.iter().copied()).len(),
        sampled.triangles.len(),
        "one is there twice"
    );
}

/// Measures of how nearly triangles are a closed surface.
#[derive(Debug)]
struct Quality {
    edges: usize,
    /// Part of the edges that have two triangles, on their two sides.
    closed: f64,
    /// Part of the triangles that face to where the normals of their corners point.
    outside: f64,
    /// Vertices less edges plus faces: 2 for each closed body without holes.
    characteristic: i64,
}

impl Quality {
    fn measure(sampled: &SampledModel) -> Self {
        // Once in each direction.
        let mut edges: BTreeMap<[u32; 2], [u32; 2]> = BTreeMap::new();
        let mut used = BTreeSet::new();
        for [a, b, c] in &sampled.triangles {
            for (from, to) in [(*a, *b), (*b, *c), (*c, *a)] {
                edges.entry([from.min(to), from.max(to)]).or_default()[usize::from(from > to)] += 1;
                used.insert(from);
            }
        }
        let (positions, normals) = (&sampled.samples.positions, sampled.samples.normals());
        let faces_outside = |corners: &&[u32; 3]| {
            let [a, b, c] = corners.map(|i| positions[i as usize]);
            let normal: Vec3 = corners.iter().map(|i| normals[*i as usize]).sum();
            (b - a).cross(c - a).dot(normal) > 0.0
        };
        let triangles = &sampled.triangles;
        Self {
            edges: edges.len(),
            closed: edges.values().filter(|n| **n == [1, 1]).count() as f64 / edges.len() as f64,
            outside: triangles.iter().filter(faces_outside).count() as f64 / triangles.len() as f64,
            characteristic: used.len() as i64 - edges.len() as i64 + triangles.len() as i64,
        }
    }
}

/// Clusters of the vertices of a surface are patches, and so neighbours meet along an edge, three of them at
/// a corner: but for where a patch is in two parts, or ends in a point.
#[test]
fn a_closed_surface_stays_nearly_closed() {
    // The amphora has handles that run through its wall, and engravings about as deep as the samples are
    // apart.
    for (shape, bodies, closed) in [(Shape::BumpySphere, 1, 0.985), (Shape::Amphora, 3, 0.92)] {
        let body = Body::generated(shape, 100_000);
        for splitting in [Splitting::VolumeSurface, Splitting::Octree] {
            let sampled = body.sampled(Sampling { splitting, ..samples(5000) });
            check_each(&sampled);
            let quality = Quality::measure(&sampled);
            assert!(quality.closed > closed, "{shape:?}, {splitting:?}: {quality:?}");
            assert!(quality.outside > closed, "{shape:?}, {splitting:?}: {quality:?}");
            let surplus = quality.characteristic.abs_diff(2 * bodies) as f64;
            assert!(surplus < (1.0 - closed) * quality.edges as f64, "{shape:?}, {splitting:?}: {quality:?}");
            // A closed surface has two triangles for each vertex.
            let per_sample = sampled.triangles.len() as f64 / sampled.samples.len() as f64;
            assert!(
                (1.9..2.3).contains(&per_sample),
                "{shape:?}, {splitting:?}: {per_sample} for each sample"
            );
        }
    }
}

#[test]
fn groups_leave_the_surface_nearly_closed_too() {
    for (shape, closed) in [(Shape::BumpySphere, 0.97), (Shape::Amphora, 0.88)] {
        let body = Body::generated(shape, 100_000);
        let sampled = body.sampled(Sampling { grouping: Grouping::Level(3), ..samples(5000) });
        check_each(&sampled);
        let quality = Quality::measure(&sampled);
        assert!(quality.closed > closed && quality.outside > closed, "{shape:?}: {quality:?}");
    }
}

/// One vertex is far away, as scans have them, and all others are in one cell: more than are clustered at
/// once.
#[test]
fn a_cell_of_several_parts_has_one_surface() {
    let mut body = Body::generated(Shape::BumpySphere, 600_000);
    body.positions.iter_mut().for_each(|p| *p += 5.0);
    body.positions[0] = DVec3::splat(500.0);
    let sampled = body.sampled(samples(5000));
    assert_eq!(sampled.cells, 2);
    check_each(&sampled);
    let quality = Quality::measure(&sampled);
    assert!(quality.closed > 0.99 && quality.outside > 0.99, "{quality:?}");
}

#[test]
fn an_open_surface_keeps_its_border() {
    let sampled = Body::generated(Shape::Plane, 40_000).sampled(samples(1000));
    check_each(&sampled);
    let quality = Quality::measure(&sampled);
    // Some 4√1000 edges of 3000 lie along the border.
    assert!((0.93..0.97).contains(&quality.closed), "{quality:?}");
    assert!(quality.outside > 0.985, "{quality:?}");
}

/// Vertex of each sample, where each vertex is a sample.
fn vertex_of(sampled: &SampledModel, body: &Body) -> Vec<u32> {
    let bits = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let vertices: BTreeMap<_, u32> =
        body.positions.iter().map(|p| bits(sampled.frame.to_local(*p))).zip(0..).collect();
    sampled.samples.positions.iter().map(|p| vertices[&bits(*p)]).collect()
}

#[test]
fn where_each_vertex_is_a_sample_the_triangles_are_the_faces() {
    for shape in [Shape::BumpySphere, Shape::Plane, Shape::Amphora] {
        let body = Body::generated(shape, 5000);
        let n = body.positions.len();
        for target in [n, n + 1, 10 * n] {
            for body in [body.clone(), body.shuffled()] {
                let sampled = body.sampled(samples(target as u64));
                assert_eq!(sampled.samples.len(), n);
                let vertex_of = vertex_of(&sampled, &body);
                let found = sampled.triangles.iter().map(|t| t.map(|i| vertex_of[i as usize]));
                assert_eq!(found.len(), body.faces.len());
                assert!(triangle_set(found) == triangle_set(body.faces.iter().copied()), "{shape:?}");
            }
        }
    }
}

/// Coordinates of few digits, of which all sums of products within a cell are exact: then the order of the
/// vertices rounds nothing.
fn exact(shape: Shape, vertices: u64) -> Body {
    let mut body = Body::generated(shape, vertices).without_normals();
    body.positions.iter_mut().for_each(|p| *p = (*p * 512.0).round() / 512.0);
    body
}

#[test]
fn the_order_of_the_vertices_changes_nothing_but_numbers() {
    for shape in [Shape::BumpySphere, Shape::Amphora] {
        let body = exact(shape, 50_000);
        // The handles of the amphora touch its body.
        let ways =
            [(Splitting::VolumeSurface, true), (Splitting::Octree, true), (Splitting::VolumeSurface, false)];
        for (splitting, sheets) in ways {
            let skip = Skip { sheets, ..Skip::default() };
            // Corner positions of each triangle, whatever its corners are numbered.
            let places = |body: &Body| {
                let sampled = body.sampled(Sampling { splitting, skip, ..samples(3000) });
                check_each(&sampled);
                let bits = |i: u32| sampled.samples.positions[i as usize].to_array().map(f32::to_bits);
                let rotated = |[a, b, c]: [u32; 3]| {
                    let [a, b, c] = [a, b, c].map(bits);
                    [[a, b, c], [b, c, a], [c, a, b]].into_iter().min()
                };
                let mut places: Vec<_> = sampled.triangles.iter().map(|t| rotated(*t)).collect();
                places.sort_unstable();
                places
            };
            let (coherent, shuffled) = (places(&body), places(&body.shuffled()));
            assert!(coherent.len() > 5000);
            assert!(coherent == shuffled, "{shape:?}, {splitting:?}");
        }
    }
}

#[test]
fn waiting_in_a_file_changes_no_triangle() {
    let body = Body::generated(Shape::Amphora, 500_000).shuffled();
    let free = Sampling { grouping: Grouping::Never, ..samples(5000) };
    let tight = Sampling { memory_limit: Some(33 << 20), ..free };
    let (free, tight) = (body.sampled(free), body.sampled(tight));
    assert!(free.triangles.len() > 9000);
    assert_eq!(free.samples.positions, tight.samples.positions);
    assert!(free.triangles == tight.triangles);
}

#[test]
fn without_faces_there_are_none() {
    let body = Body::generated(Shape::BumpySphere, 5000);
    assert!(!body.sampled(samples(500)).triangles.is_empty());
    let sampled = body.without_faces().sampled(samples(500));
    assert!(sampled.triangles.is_empty() && sampled.faces_without_vertex == 0);
}

#[test]
fn a_vertex_without_a_position_takes_its_faces_along() {
    let mut body = Body::generated(Shape::BumpySphere, 5000);
    let lost = [17, 2500, 4999];
    for (vertex, x) in lost.into_iter().zip([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]) {
        body.positions[vertex].y = x;
    }
    let n = body.positions.len();
    let sampled = body.sampled(samples(n as u64));
    assert_eq!((sampled.samples.len(), sampled.source.non_finite), (n - lost.len(), lost.len() as u64));
    assert_eq!(sampled.source.first_non_finite, Some(17));
    assert_eq!(sampled.faces_without_vertex, 0, "the vertices are there, though nowhere");
    let vertex_of = vertex_of(&sampled, &body);
    let found = triangle_set(sampled.triangles.iter().map(|t| t.map(|i| vertex_of[i as usize])));
    let whole = |t: &&[u32; 3]| t.iter().all(|i| !lost.contains(&(*i as usize)));
    let kept: Vec<_> = body.faces.iter().filter(whole).copied().collect();
    assert!(kept.len() < body.faces.len() - 10);
    assert!(found == triangle_set(kept));
}

/// A PLY file in text: the corners of a cube, with these faces.
fn cube(faces: &[&str]) -> SampledModel {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let mut file = File::create(&path).unwrap();
    let properties = "property float x\nproperty float y\nproperty float z";
    writeln!(file, "ply\nformat ascii 1.0\nelement vertex 8\n{properties}").unwrap();
    writeln!(file, "element face {}\nproperty list uchar int vertex_indices\nend_header", faces.len())
        .unwrap();
    for corner in 0..8 {
        writeln!(file, "{} {} {}", corner & 1, corner >> 1 & 1, corner >> 2).unwrap();
    }
    faces.iter().for_each(|face| writeln!(file, "{face}").unwrap());
    drop(file);
    sample_file(&path, samples(8))
}

/// The triangles of a [`cube`] in the numbers of its corners.
fn of_corners(sampled: &SampledModel) -> BTreeSet<[u32; 3]> {
    assert_eq!(sampled.samples.len(), 8);
    let corner = |i: u32| {
        let p = sampled.frame.to_model(sampled.samples.positions[i as usize]).round();
        (p.dot(DVec3::new(1.0, 2.0, 4.0))) as u32
    };
    triangle_set(sampled.triangles.iter().map(|t| t.map(corner)))
}

#[test]
fn polygons_are_fans_and_what_is_no_face_gives_none() {
    let sampled = cube(&["4 0 2 3 1", "5 4 5 7 6 2", "2 0 1", "1 3", "0", "3 5 5 6", "3 0 2 3"]);
    check_each(&sampled);
    let expected = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [4, 6, 2]];
    assert_eq!(of_corners(&sampled), triangle_set(expected));
    assert_eq!(sampled.faces_without_vertex, 0);
}

/// The same three samples the other way round are another triangle: a thin sheet has both.
#[test]
fn a_sheet_of_two_sides_keeps_both() {
    let sampled = cube(&["3 0 1 2", "3 0 2 1", "3 2 0 1"]);
    assert_eq!(of_corners(&sampled), triangle_set([[0, 1, 2], [0, 2, 1]]));
}

#[test]
fn faces_of_vertices_that_there_are_not_are_dropped_and_counted() {
    // Of the quadrilateral one triangle is left.
    let sampled = cube(&["3 0 1 8", "3 0 1 2", "4 0 1 2 8", "3 -1 0 1", "3 2147483647 1 0", "4 -5 1 2 3"]);
    check_each(&sampled);
    assert_eq!(of_corners(&sampled), triangle_set([[0, 1, 2]]));
    assert_eq!(sampled.faces_without_vertex, 6);
}

#[test]
fn faces_at_random_are_a_tangle_and_dropped() {
    let mut body = Body::generated(Shape::BumpySphere, 50_000);
    let n = body.positions.len() as u64;
    // Far more triangles than samples could have between neighbours.
    body.faces =
        (0..100_000u64).map(|i| [i * 7919 % n, i * i % n, (i * 104_729 + 5) % n].map(|v| v as u32)).collect();
    let sampled = body.sampled(samples(1000));
    assert!(sampled.tangled_faces && sampled.triangles.is_empty());
    assert!(!Body::generated(Shape::BumpySphere, 50_000).sampled(samples(1000)).tangled_faces);
}
