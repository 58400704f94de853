//! Generated models: counts, topology, normals, bytes.
#![allow(clippy::unwrap_used, reason = "a failing helper fails the test")]

use std::collections::HashMap;
use std::f64::consts::PI;
use std::io::{Seek, Write};

use glam::DVec3;
use simod_generate::{ModelOptions, PlyEncoding, Shape, Surface, expected_bytes, write_ply};
use simod_model::progress::Silent;
use simod_model::{ErrorKind, Model, Progress, Scalar, for_faces};

const SHAPES: [Shape; 7] = [
    Shape::Amphora,
    Shape::BumpySphere,
    Shape::Plane,
    Shape::BumpyPlane,
    Shape::Cylinder,
    Shape::Bar,
    Shape::Cactus,
];

fn is_open(shape: Shape) -> bool {
    matches!(shape, Shape::Plane | Shape::BumpyPlane)
}

fn bytes(options: &ModelOptions) -> Vec<u8> {
    let mut bytes = Vec::new();
    let info = write_ply(options, &mut bytes, &Silent).unwrap();
    assert_eq!(info.bytes, bytes.len() as u64);
    bytes
}

#[test]
fn there_are_exactly_as_many_vertices_as_asked_for() {
    for shape in SHAPES {
        for asked in [1000, 1001, 1777, 5000, 123_456] {
            let surface = Surface::new(shape, asked).unwrap();
            let (vertices, triangles) = surface.mesh().unwrap();
            let close = asked.abs_diff(surface.vertices()) * 50 <= asked;
            assert!(close, "{shape:?}: {} of {asked}", surface.vertices());
            assert_eq!(surface.vertices(), vertices.len() as u64);
            assert_eq!(surface.faces(), triangles.len() as u64);
            if !is_open(shape) {
                let bodies = surface.bodies() as u64;
                assert_eq!(surface.faces(), 2 * surface.vertices() - 4 * bodies, "Euler's formula");
                // The cactus is made of grids.
                assert!(shape == Shape::Cactus || surface.vertices() == asked);
            }
        }
    }
    // Laid out at once, whatever their size.
    assert_eq!(Surface::new(Shape::Amphora, 1_000_000_000).unwrap().vertices(), 1_000_000_000);
}

#[test]
fn out_of_range_is_an_error() {
    for vertices in [0, 999, u64::MAX] {
        let error = Surface::new(Shape::Amphora, vertices).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Argument);
    }
    let huge = ModelOptions { vertices: 5_000_000_000, ..ModelOptions::default() };
    assert_eq!(expected_bytes(&huge).unwrap_err().kind(), ErrorKind::Argument);
    assert!(expected_bytes(&ModelOptions { faces: false, ..huge }).unwrap().is_some());
}

#[test]
fn meshes_are_oriented_manifolds_closed_where_meant() {
    for shape in SHAPES {
        for asked in [1000, 20_011] {
            let (vertices, triangles) = Surface::new(shape, asked).unwrap().mesh().unwrap();
            let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
            let mut used = vec![false; vertices.len()];
            for [a, b, c] in triangles {
                assert!(a != b && b != c && c != a);
                for edge in [[a, b], [b, c], [c, a]] {
                    *edges.entry(edge).or_default() += 1;
                    used[edge[0] as usize] = true;
                }
            }
            assert!(used.iter().all(|&u| u), "{shape:?}: unused vertices");
            assert!(edges.values().all(|&n| n == 1), "{shape:?}: an edge used twice in one direction");
            let open: Vec<_> = edges.keys().filter(|[a, b]| !edges.contains_key(&[*b, *a])).collect();
            if is_open(shape) {
                assert!(!open.is_empty());
                for index in open.into_iter().flatten() {
                    let p = vertices[*index as usize].position;
                    assert!((p.x.abs().max(p.z.abs()) - 1.0).abs() < 1e-9, "a hole at {p}");
                }
            } else {
                assert!(open.is_empty(), "{shape:?}: {} open edges", open.len());
            }
        }
    }
}

#[test]
fn normals_are_unit_and_agree_with_the_faces() {
    for shape in SHAPES {
        let (vertices, triangles) = Surface::new(shape, 400_000).unwrap().mesh().unwrap();
        for vertex in &vertices {
            assert!(vertex.position.is_finite() && vertex.normal.is_finite());
            assert!((vertex.normal.length() - 1.0).abs() < 1e-5);
        }
        // Face normals averaged at each vertex, against the analytic ones.
        let mut sums = vec![DVec3::ZERO; vertices.len()];
        for t in &triangles {
            let [a, b, c] = t.map(|i| vertices[i as usize].position);
            for &i in t {
                sums[i as usize] += (b - a).cross(c - a);
            }
        }
        let mut cosines: Vec<f64> = sums
            .iter()
            .zip(&vertices)
            .map(|(sum, vertex)| sum.normalize_or_zero().dot(vertex.normal.as_dvec3()))
            .collect();
        cosines.sort_by(f64::total_cmp);
        let at = |share: f64| cosines[(share * cosines.len() as f64) as usize];
        assert!(at(0.001) > 0.0, "{shape:?}: the worst thousandth at {}", at(0.001));
        // Grain and fibres of the amphora are finer than triangles of this size.
        assert!(at(0.05) > 0.75, "{shape:?}: the worst twentieth at {}", at(0.05));
        assert!(at(0.5) > 0.98, "{shape:?}: the median at {}", at(0.5));
    }
}

#[test]
fn volumes_are_those_of_the_shapes() {
    let volume = |shape| {
        let (vertices, triangles) = Surface::new(shape, 50_000).unwrap().mesh().unwrap();
        let signed = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| vertices[i as usize].position);
            a.cross(b).dot(c) / 6.0
        };
        triangles.iter().map(signed).sum::<f64>()
    };
    let round = PI * 0.15 * 0.15 * 2.0;
    assert!((volume(Shape::Cylinder) / round - 1.0).abs() < 2e-3, "{}", volume(Shape::Cylinder));
    assert!((volume(Shape::Bar) / 0.18 - 1.0).abs() < 1e-4, "{}", volume(Shape::Bar));
    // Volume under the bumps: prisms below the triangles, as high as the mean of the corners' heights.
    let (vertices, triangles) = Surface::new(Shape::BumpyPlane, 50_000).unwrap().mesh().unwrap();
    let under = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| vertices[i as usize].position);
        (b - a).cross(c - a).y / 2.0 * (a.y + b.y + c.y) / 3.0
    };
    let under: f64 = triangles.iter().map(under).sum();
    assert!((under / 0.06 - 1.0).abs() < 1e-3, "{under}");
}

#[test]
fn edges_of_bars_are_sharp() {
    for (shape, corners) in [(Shape::Cylinder, 0), (Shape::Bar, 8)] {
        let (vertices, _) = Surface::new(shape, 3000).unwrap().mesh().unwrap();
        let is_on_rim = |p: DVec3| (p.y == 0.0 || p.y == 2.0) && p.with_y(0.0).length() > 0.1499;
        let is_corner = |p: DVec3| is_on_rim(p) && (p.x.abs() - p.z.abs()).abs() < 1e-9;
        assert!(vertices.iter().filter(|v| is_on_rim(v.position)).count() >= 20, "{shape:?}");
        assert!(vertices.iter().filter(|v| is_corner(v.position)).count() >= corners, "{shape:?}");
    }
}

#[test]
fn samples_are_spread_evenly() {
    for shape in SHAPES {
        let (vertices, triangles) = Surface::new(shape, 100_000).unwrap().mesh().unwrap();
        let mut areas: Vec<f64> = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| vertices[i as usize].position);
                (b - a).cross(c - a).length()
            })
            .collect();
        areas.sort_by(f64::total_cmp);
        let at = |share: f64| areas[(share * areas.len() as f64) as usize];
        assert!(at(0.99) < 2.5 * at(0.5), "{shape:?}: {} {}", at(0.99), at(0.5));
        assert!(at(0.01) > 0.4 * at(0.5), "{shape:?}: {} {}", at(0.01), at(0.5));
    }
}

#[test]
fn bytes_do_not_depend_on_the_threads() {
    for encoding in [PlyEncoding::Ascii, PlyEncoding::BinaryLittleEndian, PlyEncoding::BinaryBigEndian] {
        let options = ModelOptions { vertices: 70_000, encoding, ..ModelOptions::default() };
        let one_after_another = |threads| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| bytes(&options))
        };
        let one = one_after_another(1);
        assert!(one == one_after_another(2), "{encoding:?}");
        assert!(one == bytes(&options), "{encoding:?}");
        if let Some(expected) = expected_bytes(&options).unwrap() {
            assert_eq!(expected, one.len() as u64);
        }
    }
}

#[test]
fn files_hold_what_the_surface_gives() {
    let offset = DVec3::new(512_345.0, -4_200_000.0, 77.5);
    let surface = Surface::new(Shape::BumpySphere, 1000).unwrap();
    let (vertices, triangles) = surface.mesh().unwrap();
    let options = ModelOptions {
        shape: Shape::BumpySphere,
        vertices: 1000,
        encoding: PlyEncoding::Ascii,
        scalar: Scalar::F64,
        offset,
        ..ModelOptions::default()
    };
    let text = String::from_utf8(bytes(&options)).unwrap();
    let (header, body) = text.split_once("end_header\n").unwrap();
    assert!(header.starts_with("ply\nformat ascii 1.0\nelement vertex 1000\nproperty double x\n"));
    let mut lines = body.lines();
    for vertex in &vertices {
        let numbers: Vec<f64> =
            lines.next().unwrap().split(' ').map(|number| number.parse().unwrap()).collect();
        assert_eq!(DVec3::from_slice(&numbers), vertex.position + offset);
        assert_eq!(DVec3::from_slice(&numbers[3..]).as_vec3(), vertex.normal);
        assert_eq!([6, 7, 8].map(|i| numbers[i] as u8), vertex.color);
    }
    for [a, b, c] in &triangles {
        assert_eq!(lines.next().unwrap(), format!("3 {a} {b} {c}"));
    }
    assert!(lines.next().is_none());

    // Both byte orders hold the same numbers.
    let bare = ModelOptions { normals: false, colors: false, faces: false, ..options };
    let body = |encoding, vertices: usize| {
        let bytes = bytes(&ModelOptions { encoding, ..bare.clone() });
        bytes[bytes.len() - vertices * 24..].to_vec()
    };
    let little = body(PlyEncoding::BinaryLittleEndian, 1000);
    let big = body(PlyEncoding::BinaryBigEndian, 1000);
    for ((little, big), vertex) in little
        .chunks_exact(8)
        .zip(big.chunks_exact(8))
        .zip(vertices.iter().flat_map(|vertex| (vertex.position + offset).to_array()))
    {
        assert_eq!(f64::from_le_bytes(little.try_into().unwrap()), vertex);
        assert_eq!(f64::from_be_bytes(big.try_into().unwrap()), vertex);
    }
}

/// All triangles of a model, as a reader gives them.
fn read_faces(model: &dyn Model) -> Vec<[u32; 3]> {
    let mut all = Vec::new();
    for_faces(model, |chunk| {
        all.extend_from_slice(&chunk.triangles);
        Ok(())
    })
    .unwrap();
    all
}

#[test]
fn faces_are_read_as_they_are_generated_in_every_encoding() {
    let (_, expected) = Surface::new(Shape::Amphora, 50_000).unwrap().mesh().unwrap();
    let mut file = tempfile::NamedTempFile::new().unwrap();
    for encoding in [PlyEncoding::Ascii, PlyEncoding::BinaryBigEndian, PlyEncoding::BinaryLittleEndian] {
        let options = ModelOptions { vertices: 50_000, encoding, ..ModelOptions::default() };
        file.as_file().set_len(0).unwrap();
        file.rewind().unwrap();
        file.write_all(&bytes(&options)).unwrap();
        let model = simod_model::open(file.path()).unwrap();
        assert_eq!(read_faces(&*model), expected);
        // In text, the end of the vertices is known by now.
        assert_eq!(read_faces(&*model), expected);
        let estimate = model.info().face_bytes as f64 / (13 * expected.len()) as f64;
        let is_text = encoding == PlyEncoding::Ascii;
        assert!(estimate == 1.0 || is_text && (1.0..2.0).contains(&estimate), "{estimate}");
    }
}

#[test]
fn cancelling_stops() {
    struct Cancelled;
    impl Progress for Cancelled {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let error = write_ply(&ModelOptions::default(), &mut std::io::sink(), &Cancelled).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled);
}
