//! Placement of samples in their clusters.

use glam::{DVec3, Vec3};
use simod_core::refinement::{Finer, Refining, SpaceSelection, refine};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Grouping, Placement, Sampling, Skip, Target};
use simod_generate::Shape;
use simod_model::progress::Silent;

use crate::body::{Body, sample_file, worst_distance};
use crate::cells::Saved;

const SIDE: u32 = 220;

/// Waves, of which the finer ones are six samples long.
fn height(x: f64, z: f64) -> f64 {
    0.02 * (13.0 * x).sin() * (11.0 * z).cos() + 0.004 * (37.0 * x + 1.0).sin() * (31.0 * z).sin()
}

/// A relief over a square of side 2, whose normals are those of the square.
fn relief() -> Body {
    let at = |i: u32| 2.0 * f64::from(i) / f64::from(SIDE - 1) - 1.0;
    let vertex = |i: u32| {
        let (x, z) = (at(i % SIDE), at(i / SIDE));
        DVec3::new(x, height(x, z), z)
    };
    let square = |i: u32| {
        let a = i / (SIDE - 1) * SIDE + i % (SIDE - 1);
        [[a, a + SIDE, a + 1], [a + 1, a + SIDE, a + SIDE + 1]]
    };
    Body {
        positions: (0..SIDE * SIDE).map(vertex).collect(),
        normals: vec![Vec3::Y; (SIDE * SIDE) as usize],
        faces: (0..(SIDE - 1) * (SIDE - 1)).flat_map(square).collect(),
    }
}

fn by(placement: Placement, target: Target) -> Sampling {
    Sampling { target, placement, ..Sampling::default() }
}

fn samples(n: u64) -> Sampling {
    by(Placement::default(), Target::Samples(n))
}

/// Distance of the triangles from the relief, rms.
fn off(sampled: &SampledModel) -> f64 {
    let mut squares = Vec::new();
    for corners in &sampled.triangles {
        let [a, b, c] = corners.map(|i| sampled.frame.to_model(sampled.samples.positions[i as usize]));
        for weights in [[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]] {
            let [u, v, w] = weights;
            let p = (a * u + b * v + c * w) / (u + v + w);
            squares.push((p.y - height(p.x, p.z)).powi(2));
        }
    }
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn faces_tell_where_the_surface_is_whatever_the_normals() {
    let body = relief();
    for body in [body.clone(), body.without_normals()] {
        let [faces, vertices] = [Placement::Faces, Placement::Vertices]
            .map(|placement| body.sampled(by(placement, Target::Samples(4000))));
        assert_eq!(faces.samples.len(), vertices.samples.len());
        assert!(faces.triangles == vertices.triangles, "the clusters are others");
        let (faces, vertices) = (off(&faces), off(&vertices));
        assert!(faces < 0.32 * vertices, "{faces} and {vertices}");
    }
}

#[test]
fn samples_are_where_they_are_whatever_the_number_of_threads() {
    // Of few samples, every so many-th vertex is looked at.
    for n in [200, 4000] {
        let sampled = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| relief().without_normals().sampled(samples(n)))
        };
        let (one, three) = (sampled(1), sampled(3));
        assert_eq!(one.samples.positions, three.samples.positions);
        assert_eq!(one.triangles, three.triangles);
    }
}

#[test]
fn without_faces_there_is_nothing_to_choose() {
    let body = relief().without_faces();
    let [a, b] = [Placement::Faces, Placement::Vertices]
        .map(|placement| body.sampled(by(placement, Target::Samples(1000))));
    assert_eq!(a.samples.positions, b.samples.positions);
    assert_eq!(a.sampling.placement, Placement::Vertices);
}

#[test]
fn every_vertex_has_a_sample_within_what_an_error_promises() {
    for body in [relief(), relief().without_normals(), Body::generated(Shape::Amphora, 40_000)] {
        for error in [3e-3, 1e-3] {
            let sampled = body.sampled(by(Placement::Faces, Target::Error(error)));
            let most = 12.5 * error * sampled.local_diagonal();
            let worst = f64::from(worst_distance(&sampled, &body.positions));
            assert!(worst <= most * 1.0001, "{worst} beyond {most}");
        }
    }
}

#[test]
fn samples_stay_inside_their_clusters() {
    // Each vertex its own cluster, and faces of which none tells more than the vertices.
    let body = Body::generated(Shape::BumpySphere, 3000);
    let sampled = body.sampled(by(Placement::Faces, Target::Samples(100_000)));
    assert_eq!(worst_distance(&sampled, &body.positions), 0.0);

    // Faces that are no surface: across the whole model, without area, of vertices that are not there or not
    // finite.
    let mut body = relief();
    let count = body.positions.len() as u32;
    body.positions[7].y = f64::NAN;
    body.faces = (0..count).map(|i| [i, i * 7 % count, i * 31 % count]).collect();
    body.faces.extend([[1, 1, 2], [3, 3, 3], [0, 1, count], [u32::MAX - 1, 4, 5]]);
    let sampled = body.sampled(by(Placement::Faces, Target::Samples(2000)));
    let plain = body.sampled(by(Placement::Vertices, Target::Samples(2000)));
    let farthest = worst_distance(&plain, &body.positions);
    for (p, q) in sampled.samples.positions.iter().zip(&plain.samples.positions) {
        assert!(p.is_finite() && p.distance(*q) <= 2.0 * farthest, "{p} of {q}");
    }
}

#[test]
fn groups_parts_and_refinements_place_alike() {
    let body = relief();
    let target = Target::Samples(2000);
    let grouped = |placement| Sampling { grouping: Grouping::Level(3), ..by(placement, target) };
    let [faces, vertices] =
        [Placement::Faces, Placement::Vertices].map(|placement| off(&body.sampled(grouped(placement))));
    assert!(faces < 0.7 * vertices, "{faces} and {vertices}");

    // As `run` does that needs no triangles.
    let skip = Skip { triangles: true, cells: true, ..Skip::default() };
    let whole = body.sampled(by(Placement::Faces, target));
    let part = body.sampled(Sampling { skip, ..by(Placement::Faces, target) });
    assert_eq!(whole.samples.positions, part.samples.positions);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    body.write(&path);
    let refined = |placement, finer| {
        let sampled = sample_file(&path, by(placement, target));
        let model = simod_model::open(&path).unwrap();
        let how = Refining { finer, memory_limit: None, shapes: Vec::new() };
        let everywhere = |_: DVec3| -1.0;
        let selection = SpaceSelection { distance: &everywhere, so_far: None, at_rest: true };
        let refined = refine(&sampled, model.as_ref(), selection, &how, folder.path(), &Silent).unwrap();
        let refined = refined.sampled.unwrap();
        // Samples from before the refinement stay.
        assert_eq!(refined.samples.positions[..sampled.samples.len()], sampled.samples.positions);
        refined
    };
    let [faces, vertices] =
        [Placement::Faces, Placement::Vertices].map(|placement| off(&refined(placement, Finer::Factor(3.0))));
    assert!(faces < 0.55 * vertices, "{faces} and {vertices}");
    // Samples that were there may stand at the rim of their new clusters.
    let error = 1e-3;
    let refined = refined(Placement::Faces, Finer::Error(error));
    let worst = f64::from(worst_distance(&refined, &body.positions));
    assert!(worst <= 2.0 * 12.5 * error * refined.local_diagonal(), "{worst}");
}

/// Folders that were written before faces placed samples do not say what did.
#[test]
fn cells_of_former_folders_are_made_again() {
    let body = relief();
    for placement in [Placement::Faces, Placement::Vertices] {
        let saved = Saved::new(&body, by(placement, Target::Samples(2000)));
        let text = std::fs::read_to_string(saved.folder().join("simod.toml")).unwrap();
        assert_eq!(text.contains("placement = \"faces\""), placement == Placement::Faces, "{text}");
        assert_eq!(text.contains("placement"), placement == Placement::Faces, "{text}");
        let bytes = saved.bytes();
        std::fs::remove_file(saved.folder().join("cells.bin")).unwrap();
        saved.cells();
        assert!(saved.bytes() == bytes, "{placement:?}");
    }
}

/// Faces place the samples where normals are missing or those of a smoother surface, and vertices do where
/// the normals are the surface's own.
#[test]
fn normals_are_trusted_unless_faces_tell_otherwise() {
    let placed = |body: &Body| body.sampled(samples(1000)).sampling.placement;
    let body = relief();
    assert_eq!(placed(&body), Placement::Faces);
    assert_eq!(placed(&body.clone().without_normals()), Placement::Faces);
    assert_eq!(placed(&body.shuffled()), Placement::Faces);
    let zero = Body { normals: vec![Vec3::ZERO; body.positions.len()], ..body.clone() };
    assert_eq!(placed(&zero), Placement::Faces);
    assert_eq!(placed(&body.clone().without_faces()), Placement::Vertices);
    assert_eq!(placed(&body.clone().without_faces().without_normals()), Placement::Vertices);

    // On whichever side, and with a little noise.
    let slope = |p: &DVec3, axis: DVec3| {
        let (a, b) = (*p - axis * 1e-5, *p + axis * 1e-5);
        (height(b.x, b.z) - height(a.x, a.z)) / 2e-5
    };
    let own = |(i, p): (usize, &DVec3)| {
        let normal = DVec3::new(-slope(p, DVec3::X), 1.0, -slope(p, DVec3::Z)).normalize_or(DVec3::Y);
        let noise = DVec3::new((i * 7 % 11) as f64, (i * 5 % 13) as f64, (i * 3 % 17) as f64) * 1e-3;
        ((normal + noise).normalize_or(DVec3::Y) * if i / 1000 % 2 == 0 { 1.0 } else { -1.0 }).as_vec3()
    };
    let body = Body { normals: body.positions.iter().enumerate().map(own).collect(), ..body };
    assert_eq!(placed(&body), Placement::Vertices);
    assert_eq!(placed(&body.shuffled()), Placement::Vertices);
    let sharp = [Shape::Bar, Shape::Cylinder];
    let round = [Shape::Amphora, Shape::BumpySphere, Shape::BumpyPlane, Shape::Cactus];
    for shape in round.into_iter().chain(sharp) {
        let body = Body::generated(shape, 40_000);
        assert_eq!(placed(&body), Placement::Vertices, "{shape:?}");
        assert_eq!(placed(&body.without_normals()), Placement::Faces, "{shape:?}");
    }
    // Faces that are no surface tell nothing; nor do flat ones.
    let count = body.positions.len() as u32;
    let faces = vec![[0, 0, 0], [u32::MAX - 1, count, count + 1], [1, 1, 2]];
    assert_eq!(placed(&Body { faces, ..body.clone() }), Placement::Vertices);
    let flat = body.positions.iter().map(|p| DVec3::new(p.x, 0.0, p.z)).collect();
    let normals = vec![Vec3::new(0.001, 1.0, 0.002); count as usize];
    assert_eq!(placed(&Body { positions: flat, normals, ..body }), Placement::Vertices);
}
