//! Clouds whose sheets lie one above the other and face the same way: samples are of one sheet or the other.

use glam::{DVec3, Vec3};
use simod_core::sampling::{Sampling, Splitting, Target};

use crate::body::Body;
use crate::touching::pulled;

/// Two vertices of a sheet are 1 / SIDE from each other, and the sheets some two of these.
const SIDE: u32 = 200;
const GAP: f64 = 0.01;

fn height(p: DVec3) -> f64 {
    0.05 * (6.0 * p.x).sin() * (5.0 * p.y).cos()
}

/// Depth of a place below the upper sheet: 0 there, and 1 on the lower one.
fn depth(p: DVec3) -> f64 {
    let slope = DVec3::new(
        -0.3 * (6.0 * p.x).cos() * (5.0 * p.y).cos(),
        0.25 * (6.0 * p.x).sin() * (5.0 * p.y).sin(),
        1.0,
    );
    (height(p) - p.z) / slope.length() / GAP
}

/// A sheet over a square and another one below it, facing the same way or without normals; and which vertices
/// are of the lower.
fn sheets(with_normals: bool) -> (Body, Vec<f64>) {
    let (mut body, mut part) = (Body::default(), Vec::new());
    for (below, i) in (0..2u32).flat_map(|below| (0..SIDE * SIDE).map(move |i| (below, i))) {
        let p = DVec3::new(f64::from(i / SIDE), f64::from(i % SIDE), 0.0) / f64::from(SIDE);
        let n = DVec3::new(
            -0.3 * (6.0 * p.x).cos() * (5.0 * p.y).cos(),
            0.25 * (6.0 * p.x).sin() * (5.0 * p.y).sin(),
            1.0,
        );
        let n = n / n.length();
        body.positions.push(p.with_z(height(p)) - n * GAP * f64::from(below));
        if with_normals {
            body.normals.push(n.as_vec3());
        }
        part.push(f64::from(below));
    }
    (body, part)
}

#[test]
fn samples_are_of_one_sheet_or_the_other() {
    for with_normals in [true, false] {
        let (body, part) = sheets(with_normals);
        let of = |p: DVec3| f64::from(u32::from(depth(p) > 0.5));
        let [layered, not] = [Splitting::Layered, Splitting::VolumeSurface].map(|splitting| {
            let sampled =
                body.sampled(Sampling { target: Target::Samples(2000), splitting, ..Sampling::default() });
            assert!((1960..=2000).contains(&sampled.samples.len()));
            let depth = |p: &Vec3| depth(sampled.frame.to_model(*p));
            let between = sampled.samples.positions.iter().filter(|p| (0.1..0.9).contains(&depth(p)));
            let off = pulled(&sampled, &body, &part, &of);
            let astray = off.iter().filter(|off| **off > 0.1).count() as f64 / off.len() as f64;
            (between.count() as f64 / sampled.samples.len() as f64, astray)
        });
        println!("normals: {with_normals}; layered {layered:?}, not {not:?}");
        assert!(layered.0 < 0.1 && not.0 > 0.5, "{layered:?} {not:?}");
        assert!(layered.1 < 0.12 && not.1 > 5.0 * layered.1, "{layered:?} {not:?}");
    }
}

/// Layers stay apart in a refinement, and its trees are those that were kept.
#[test]
fn a_folder_tells_how_its_clusters_were_split() {
    let (body, _) = sheets(true);
    let sampling = Sampling { target: Target::Samples(1000), ..Sampling::default() };
    let saved = crate::cells::Saved::new(&body, sampling);
    assert_eq!(saved.load().sampling.splitting, Splitting::Layered);
    let path = saved.folder().join("simod.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    // As folders were written before there were layers.
    simod_model::output::write_file(&path, text.replace("splitting = \"layered\"\n", "").as_bytes()).unwrap();
    assert_eq!(saved.load().sampling.splitting, Splitting::VolumeSurface);
}
