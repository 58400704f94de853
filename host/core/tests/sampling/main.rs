//! Sampling whole models: any order, any memory limit, any place and size, and all parts of a sampled model.
#![allow(clippy::unwrap_used, reason = "a failing helper fails the test")]

mod body;
mod cells;
mod groups;
mod parts;
mod promises;
mod triangles;

use glam::DVec3;
use simod_core::generate::Shape;
use simod_core::sampling::{Sampling, Target};

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
            // The amphora has an area of about 8.5 square heights: 3000 samples are some 0.03 diagonals apart.
            let worst = worst_distance(&sampled, &placed.positions);
            assert!(worst < 0.1, "a vertex is {worst} from its nearest sample at {scale:e}");
        }
    }
}
