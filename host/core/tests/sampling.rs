//! Sampling whole models: any order, any memory limit, any place and size.
#![allow(clippy::unwrap_used, reason = "a failing helper fails the test")]

use std::path::Path;

use glam::{DVec3, Vec3};
use simod_core::generate::{Shape, Surface};
use simod_core::model::ply::write_points;
use simod_core::model::{self, Scalar};
use simod_core::progress::Silent;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};

/// Positions and normals of a generated amphora.
fn amphora(vertices: u64) -> (Vec<DVec3>, Vec<Vec3>) {
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    Surface::new(Shape::Amphora, vertices)
        .unwrap()
        .visit_vertices(|block| {
            positions.extend(block.iter().map(|v| v.position));
            normals.extend(block.iter().map(|v| v.normal));
            Ok(())
        })
        .unwrap();
    (positions, normals)
}

/// The same vertices in an order without any coherence.
fn shuffled<T: Copy>(all: &[T]) -> Vec<T> {
    // A step that shares no factor with the count visits each index once.
    let gcd = |mut a: usize, mut b: usize| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let step = (all.len() * 5 / 13..).find(|s| gcd(*s, all.len()) == 1).unwrap();
    (0..all.len()).map(|i| all[i * step % all.len()]).collect()
}

fn sampled(folder: &Path, positions: &[DVec3], normals: &[Vec3], sampling: Sampling) -> SampledModel {
    let path = folder.join("model.ply");
    write_points(&path, positions.iter().copied(), normals, &[], Scalar::F64, &[]).unwrap();
    let model = model::open(&path).unwrap();
    let sampled = sample(model.as_ref(), &sampling, folder, &Silent).unwrap();
    std::fs::remove_file(path).unwrap();
    // Nothing else is left: the temporary file has no name.
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 0);
    sampled
}

#[test]
fn a_memory_limit_changes_nothing_and_order_little() {
    let folder = tempfile::tempdir().unwrap();
    let (positions, normals) = amphora(500_000);
    let free = Sampling { target: Target::Samples(5000), ..Sampling::default() };
    // Least memory: 4 MiB of the 12 MB of samples, so that most wait in the file.
    let tight = Sampling { memory_limit: Some(1), ..free };
    let coherent = sampled(folder.path(), &positions, &normals, free);

    let (positions, normals) = (shuffled(&positions), shuffled(&normals));
    let in_memory = sampled(folder.path(), &positions, &normals, free);
    let spilled = sampled(folder.path(), &positions, &normals, tight);
    assert_eq!(in_memory.samples.positions, spilled.samples.positions);
    assert_eq!(in_memory.samples.normals(), spilled.samples.normals());

    // Another order rounds sums in another way, which may tip a split over; the cells are the same.
    assert_eq!(in_memory.cells, coherent.cells);
    assert_eq!(in_memory.samples.len().abs_diff(coherent.samples.len()), 0);
    let spacing = coherent.samples.spacing();
    let moved = in_memory.samples.positions.iter().filter(|p| {
        let nearest = coherent.samples.nearest(**p) as usize;
        coherent.samples.positions[nearest].distance(**p) > 1e-3 * spacing[nearest]
    });
    assert!(moved.count() * 50 < in_memory.samples.len());
}

#[test]
fn every_vertex_has_a_sample_near_it_at_any_place_and_size() {
    let folder = tempfile::tempdir().unwrap();
    let (positions, normals) = amphora(60_000);
    for (scale, offset) in
        [(1.0, 0.0), (1e-30, 0.0), (1e30, -3e30), (1e-300, 0.0), (1e300, 0.0), (100.0, 4_649_776.0)]
    {
        let placed: Vec<DVec3> = positions.iter().map(|p| *p * scale + DVec3::splat(offset)).collect();
        for normals in [&normals[..], &[]] {
            let sampling = Sampling { target: Target::Samples(3000), ..Sampling::default() };
            let sampled = sampled(folder.path(), &placed, normals, sampling);
            let (n, samples) = (sampled.samples.len(), &sampled.samples);
            assert!((2940..=3000).contains(&n), "{n} samples at {scale:e}");
            // The amphora has an area of about 8.5 square heights: 3000 samples are some 0.03 diagonals apart.
            let worst = placed
                .iter()
                .map(|p| {
                    let p = sampled.frame.to_local(*p);
                    samples.positions[samples.nearest(p) as usize].distance(p)
                })
                .fold(0.0, f32::max);
            assert!(worst < 0.1, "a vertex is {worst} from its nearest sample at {scale:e}");
        }
    }
}
