//! Groups of samples in open cells.

use glam::{DVec3, Vec3};
use simod_core::sampling::{Grouping, Sampling, Target};
use simod_generate::Shape;

use crate::body::{Body, rms_distance};

fn samples(n: u64, grouping: Grouping) -> Sampling {
    Sampling { target: Target::Samples(n), grouping, ..Sampling::default() }
}

#[test]
fn groups_sample_about_as_well() {
    let body = Body::generated(Shape::Amphora, 300_000).without_faces();
    let single = body.sampled(samples(3000, Grouping::Never));
    let best = rms_distance(&single, &body.positions);
    // From about five groups for each sample to about as many as vertices.
    for level in [2, 3, 4, 5] {
        let grouped = body.sampled(samples(3000, Grouping::Level(level)));
        assert_eq!(grouped.sampling.grouping, Grouping::Level(level));
        let n = grouped.samples.len();
        assert!((2940..=3000).contains(&n), "{n} samples at level {level}");
        let rms = rms_distance(&grouped, &body.positions);
        assert!((0.9..1.1).contains(&(rms / best)), "{rms} instead of {best} at level {level}");
    }
}

/// There can be no more samples than groups; each vertex is in one of them, and not far from it.
#[test]
fn coarse_groups_give_fewer_samples_that_still_cover_the_model() {
    let body = Body::generated(Shape::Amphora, 300_000).without_faces();
    let grouped = body.sampled(samples(3000, Grouping::Level(1)));
    let n = grouped.samples.len();
    assert!((500..2000).contains(&n), "{n} samples");
    let worst = crate::body::worst_distance(&grouped, &body.positions);
    // Within the diagonal of a cube.
    let diagonal = 3f64.sqrt() * grouped.cell_size / grouped.frame.scale / 2.0;
    assert!(f64::from(worst) <= diagonal, "{worst} beyond {diagonal}");
}

/// A wall without a thickness to speak of: `n`² vertices on either side.
fn wall(n: usize, thickness: f64) -> Body {
    let mut body = Body::default();
    for i in 0..n * n {
        // A little off the raster, so that no line of them is where cubes end.
        let turn = i as f64;
        let x = ((i % n) as f64 + 0.3 * turn.sin()) / n as f64;
        let z = ((i / n) as f64 + 0.3 * turn.cos()) / n as f64;
        for (y, normal) in [(0.0, -Vec3::Y), (thickness, Vec3::Y)] {
            body.positions.push(DVec3::new(x, y, z));
            body.normals.push(normal);
        }
    }
    // Moves the middle of the model, where cubes end, away from between the sides.
    body.positions.push(DVec3::new(0.5, LIFTED, 0.5));
    body.normals.push(Vec3::Y);
    body
}

/// Height of a single vertex above the wall.
const LIFTED: f64 = 0.137;

#[test]
fn the_two_sides_of_a_thin_wall_are_never_mixed() {
    let thickness = 1e-3;
    let body = wall(150, thickness);
    for body in [body.clone(), body.shuffled()] {
        for level in [None, Some(0), Some(1), Some(2), Some(3)] {
            let grouping = level.map_or(Grouping::Never, Grouping::Level);
            let sampled = body.sampled(samples(3000, grouping));
            let edge = sampled.cell_size / f64::from(1 << level.unwrap_or(0));
            let cube = |y: f64| ((y - 0.5 * LIFTED) / edge).floor();
            assert_eq!(cube(0.0), cube(thickness), "the sides are in different cubes anyway");
            let mut sides = [0usize; 2];
            for (p, n) in sampled.samples.positions.iter().zip(sampled.samples.normals()) {
                let p = sampled.frame.to_model(*p);
                if p.y > 0.5 * LIFTED {
                    continue;
                }
                let upper = p.y > 0.5 * thickness;
                let (height, normal) = if upper { (thickness, Vec3::Y) } else { (0.0, -Vec3::Y) };
                assert!((p.y - height).abs() < 0.02 * thickness, "{grouping:?}: {p} is between the sides");
                assert!(n.dot(normal) > 0.999, "{grouping:?}: {n} at {p}");
                sides[usize::from(upper)] += 1;
            }
            // As many on either side.
            assert!(sides[0].abs_diff(sides[1]) * 20 < sides[0], "{grouping:?}: {sides:?}");
        }
    }
}

/// 14 MB of samples are open at a time in this order, and next to none in that of the generator.
fn shuffled() -> Body {
    let coherent = Body::generated(Shape::Amphora, 500_000).without_faces();
    assert_eq!(coherent.sampled(samples(1000, Grouping::Automatic)).sampling.grouping, Grouping::Never);
    coherent.shuffled()
}

#[test]
fn whether_there_are_groups_depends_on_the_memory_only_if_it_cannot_hold_them() {
    let body = shuffled();
    let limited = |limit| {
        let sampling = Sampling { memory_limit: limit, ..samples(1000, Grouping::Automatic) };
        body.sampled(sampling)
    };
    let (free, enough, tight) = (limited(None), limited(Some(60 << 20)), limited(Some(33 << 20)));
    assert!(matches!(free.sampling.grouping, Grouping::Level(_)), "{:?}", free.sampling.grouping);
    assert_eq!(free.sampling.grouping, enough.sampling.grouping);
    assert_eq!(free.samples.positions, enough.samples.positions);
    assert_eq!(free.samples.normals(), enough.samples.normals());
    // A thousand samples take few groups: they find room even so.
    assert_eq!(free.samples.positions, tight.samples.positions);
}

#[test]
fn groups_that_find_no_room_give_way_to_samples_in_a_file() {
    let body = Body::generated(Shape::Amphora, 500_000).without_faces().shuffled();
    let tight = Sampling { memory_limit: Some(33 << 20), ..samples(3000, Grouping::Level(6)) };
    let (tight, never) = (body.sampled(tight), body.sampled(samples(3000, Grouping::Never)));
    assert_eq!(tight.sampling.grouping, Grouping::Never);
    assert_eq!(tight.samples.positions, never.samples.positions);
}

#[test]
fn one_place_is_one_sample() {
    for place in [DVec3::ZERO, DVec3::splat(1e-30), DVec3::ONE, DVec3::splat(1e300)] {
        let body = Body { positions: vec![place; 600_000], ..Body::default() };
        assert_eq!(body.sampled(samples(100, Grouping::Automatic)).samples.len(), 1, "{place}");
    }
}

/// Pieces of the stream are gathered on any thread, and so are cells clustered, whatever waits in a file.
#[test]
fn samples_do_not_depend_on_threads() {
    let body = Body::generated(Shape::Amphora, 200_000);
    let tight = Sampling { memory_limit: Some(33 << 20), ..samples(3000, Grouping::Never) };
    for (body, sampling) in [
        (&body, samples(3000, Grouping::Level(3))),
        (&body, samples(3000, Grouping::Never)),
        (&body.shuffled(), samples(3000, Grouping::Level(3))),
        (&body.shuffled(), tight),
    ] {
        let with_threads = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
            let sampled = pool.install(|| body.sampled(sampling));
            // Ranges of the stream with each cell's vertices, which the cell's shard notes, are compared as
            // well.
            let stream = (sampled.cells, sampled.source.jumps, sampled.held_cells().cloned());
            let samples = &sampled.samples;
            (samples.positions.clone(), samples.normals().to_vec(), sampled.triangles.clone(), stream)
        };
        let one = with_threads(1);
        for threads in [2, 7, 16] {
            assert!(with_threads(threads) == one, "{sampling:?}: {threads} threads");
        }
    }
}

/// Many threads deal the cells, and the memory for their groups, out among shards. A cell has more groups
/// here than there is room for in a shard (8192), and fewer than in all of the memory (32 768).
#[test]
fn a_cell_that_is_too_large_for_its_shard_finds_room_in_all_of_the_memory() {
    let mut body = Body::default();
    // Irrational steps along each axis fill the cube evenly.
    let place = |i: u32| (DVec3::new(0.754_877_67, 0.569_840_29, 0.819_172_51) * f64::from(i)).fract();
    body.positions.extend((0..20_000).map(|i| place(i) * 0.2));
    body.positions.push(DVec3::ONE);
    let sampling =
        Sampling { memory_limit: Some(33 << 20), grid: Some(4), ..samples(500, Grouping::Level(6)) };
    let with_threads = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
        let sampled = pool.install(|| body.sampled(sampling));
        (sampled.samples.positions.clone(), sampled.sampling.grouping)
    };
    let one = with_threads(1);
    assert_eq!(one.1, Grouping::Level(6));
    assert!(with_threads(16) == one);
}
