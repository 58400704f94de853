//! Samples that are shown while the model streams.

use super::*;
use glam::Vec3;
use simod_core::sampled_model::SampledModel;
use simod_model::progress::Emerging;
use std::sync::Mutex;

/// Progress that keeps the vertices which emerge.
#[derive(Default)]
struct Watch(Mutex<Vec<(Vec3, Vec3)>>);

impl Progress for Watch {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, _bytes: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
    fn emerge(&self, samples: &Emerging<'_>) {
        let mut kept = self.0.lock().unwrap();
        if samples.first {
            kept.clear();
        }
        samples.for_each(|position, normal| kept.push((position, normal)));
    }
}

fn watched(body: &Body, target: Target) -> (SampledModel, Vec<(Vec3, Vec3)>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    body.write(&path);
    let watch = Watch::default();
    let sampling = Sampling { target, grid: Some(16), ..Sampling::default() };
    let sampled = sample(&*simod_model::open(&path).unwrap(), &sampling, folder.path(), &watch).unwrap();
    (sampled, watch.0.into_inner().unwrap())
}

#[test]
fn with_a_bound_those_that_emerge_are_the_samples() {
    let body = Body::generated(Shape::Amphora, 60_000);
    let (sampled, emerged) = watched(&body, Target::Error(1e-4));
    let bits = |p: &Vec3| p.to_array().map(f32::to_bits);
    let mut emerged: Vec<_> = emerged.iter().map(|(p, n)| [bits(p), bits(n)]).collect();
    let samples = &sampled.samples;
    let mut found: Vec<_> =
        samples.positions.iter().zip(samples.normals()).map(|(p, n)| [bits(p), bits(n)]).collect();
    emerged.sort_unstable();
    found.sort_unstable();
    assert!(emerged == found, "{} emerged, {} found", emerged.len(), found.len());
}

#[test]
fn with_a_number_those_that_emerge_are_near_the_samples() {
    let body = Body::generated(Shape::Amphora, 60_000).without_faces();
    let mut reversed = body.clone();
    reversed.positions.reverse();
    reversed.normals.reverse();
    for body in [body, reversed] {
        let (sampled, emerged) = watched(&body, Target::Samples(3000));
        assert!((3000..12_000).contains(&emerged.len()), "{}", emerged.len());
        for p in &sampled.samples.positions {
            let nearest = emerged.iter().map(|(q, _)| p.distance(*q)).fold(f32::INFINITY, f32::min);
            assert!(nearest < 0.05, "{p} has none within {nearest}");
        }
    }
}
