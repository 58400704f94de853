//! Sampling whole models: any order, any memory limit, any place and size, and all parts of a sampled model.
#![allow(clippy::unwrap_used, reason = "a failing helper fails the test")]

mod attributes;
mod body;
mod cells;
mod density;
mod divided;
mod emerging;
mod groups;
mod layers;
mod parts;
mod placement;
mod promises;
mod touching;
mod triangles;

use std::sync::atomic::{AtomicU32, Ordering};

use glam::DVec3;
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::Shape;
use simod_model::Progress;

use body::{Body, worst_distance};

#[test]
fn a_memory_limit_changes_nothing_and_order_little() {
    let body = Body::generated(Shape::Amphora, 500_000).without_faces();
    let free = Sampling { target: Target::Samples(5000), ..Sampling::default() };
    // Least memory: 4 MiB of the 14 MB of samples, so that most wait in the file.
    let tight = Sampling { memory_limit: Some(33 << 20), ..free };
    let coherent = body.sampled(free);

    let body = body.shuffled();
    let (in_memory, spilled) = (body.sampled(free), body.sampled(tight));
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
    let body = Body::generated(Shape::Amphora, 60_000).without_faces();
    for (scale, offset) in
        [(1.0, 0.0), (1e-30, 0.0), (1e30, -3e30), (1e-300, 0.0), (1e300, 0.0), (100.0, 4_649_776.0)]
    {
        let mut placed = body.clone();
        placed.positions.iter_mut().for_each(|p| *p = *p * scale + DVec3::splat(offset));
        for placed in [placed.clone(), placed.without_normals()] {
            let sampled = placed.sampled(Sampling { target: Target::Samples(3000), ..Sampling::default() });
            let n = sampled.samples.len();
            assert!((2940..=3000).contains(&n), "{n} samples at {scale:e}");
            // The amphora has an area of about 8.5 square heights: 3000 samples are some 0.03 diagonals
            // apart.
            let worst = worst_distance(&sampled, &placed.positions);
            assert!(worst < 0.1, "a vertex is {worst} from its nearest sample at {scale:e}");
        }
    }
}

/// Progress that counts the beginnings of the second pass.
#[derive(Default)]
struct Passes(AtomicU32);

impl Progress for Passes {
    fn begin(&self, stage: &'static str, _total_bytes: u64) {
        self.0.fetch_add(u32::from(stage == "clustering"), Ordering::Relaxed);
    }
    fn advance(&self, _bytes: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}

#[test]
fn a_plain_rest_after_a_rough_beginning_gets_its_samples() {
    const SIDE: u32 = 250;
    let place = |i: u32| f64::from(i) / f64::from(SIDE);
    let mut body = Body::default();
    for i in 0..SIDE * SIDE {
        let (x, z) = (place(i / SIDE), place(i % SIDE));
        let angle = if x < 0.2 { 999.0 * x + 777.0 * z } else { 0.0 };
        body.positions.push(DVec3::new(x, 0.02 * angle.sin(), z));
        let slope = if x < 0.2 { 20.0 * angle.cos() } else { 0.0 };
        body.normals.push(DVec3::new(-slope, 1.0, 0.0).normalize_or(DVec3::Y).as_vec3());
    }
    for i in (0..SIDE * (SIDE - 1)).filter(|i| i % SIDE + 1 < SIDE) {
        body.faces.extend([[i, i + 1, i + SIDE], [i + 1, i + SIDE + 1, i + SIDE]]);
    }
    // The other way round, the beginning says enough of the rest.
    let mut reversed = body.clone();
    reversed.positions.reverse();
    reversed.normals.reverse();
    reversed.faces.iter_mut().flatten().for_each(|i| *i = SIDE * SIDE - 1 - *i);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let counts = [(body, 2), (reversed, 1)].map(|(body, expected)| {
        body.write(&path);
        let passes = Passes::default();
        let sampling = Sampling { target: Target::Samples(10_000), ..Sampling::default() };
        let sampled = sample(&*simod_model::open(&path).unwrap(), &sampling, folder.path(), &passes).unwrap();
        assert_eq!(passes.0.into_inner(), expected);
        assert!(sampled.triangles.len() > sampled.samples.len());
        sampled.samples.len()
    });
    assert!(counts.iter().all(|n| (9900..=10_000).contains(n)), "{counts:?}");
}
