//! The middle of a body: the largest of the balls that touch its surface from inside, beside each other.
//!
//! J. Ma, S. W. Bae, S. Choi, *3D medial axis point approximation using nearest neighbors and the normal
//! field*, The Visual Computer 28, 2012: a ball that touches at a sample, large at first, shrinks until it
//! holds no other sample.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::SampleSet;
use std::sync::{Arc, OnceLock};

/// Samples at which balls touch: many more than a body has parts.
const CANDIDATES: usize = 1024;

/// Greatest radius of a ball, as a part of the size of all samples; larger balls lie in no body, as the
/// surface is open there.
const LARGEST: f32 = 0.45;

/// Greatest number of shrinkings of a ball, and the least part by which each one makes it smaller.
const TIMES: usize = 40;
const LEAST: f32 = 1e-3;

/// Least radius of a ball in the body, as a part of the largest ball's; smaller balls lie in limbs.
const SMALLEST: f32 = 0.75;

/// Greatest number of balls.
const MOST: usize = 8;

/// Part of a ball's radius within which bones are in the body.
const WITHIN: f64 = 0.8;

/// A ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// The middle of the ball, local coordinates.
    pub center: DVec3,
    /// The radius of the ball.
    pub radius: f64,
}

impl Ball {
    /// Whether a segment comes nearer to the ball's middle than `WITHIN` of its radius.
    pub fn holds_some_of(&self, [a, b]: [DVec3; 2]) -> bool {
        let (along, to) = (b - a, self.center - a);
        let square = along.length_squared();
        let part = if square > 0.0 { (to.dot(along) / square).clamp(0.0, 1.0) } else { 0.0 };
        to.distance(along * part) < WITHIN * self.radius
    }
}

/// The largest balls inside of the samples of a model, found on a thread of their own: a hand that places a
/// joint does not wait for them.
pub struct InscribedBalls {
    of: Arc<SampledModel>,
    balls: Arc<OnceLock<Vec<Ball>>>,
}

impl InscribedBalls {
    /// Begins to find the balls.
    pub fn find(of: &Arc<SampledModel>) -> Self {
        let this = Self { of: of.clone(), balls: Arc::default() };
        let (of, balls) = (this.of.clone(), this.balls.clone());
        let find = move || {
            balls.get_or_init(|| largest_balls(&of.samples));
        };
        // Without a thread the balls are found where somebody asks for them.
        let _ = std::thread::Builder::new().name("body".into()).spawn(find);
        this
    }

    /// Whether the balls are those of this model.
    pub fn is_of(&self, model: &Arc<SampledModel>) -> bool {
        Arc::ptr_eq(&self.of, model)
    }

    /// All balls, in local coordinates; waits until they are found.
    pub fn balls(&self) -> &[Ball] {
        self.balls.get_or_init(|| largest_balls(&self.of.samples))
    }
}

/// Largest balls inside of a surface, none of which has its middle in another one, in local coordinates.
/// Empty where the surface encloses nothing.
pub fn largest_balls(samples: &SampleSet) -> Vec<Ball> {
    let bound =
        |start: Vec3, extreme: fn(Vec3, Vec3) -> Vec3| samples.positions.iter().copied().fold(start, extreme);
    let size = bound(Vec3::NEG_INFINITY, Vec3::max).distance(bound(Vec3::INFINITY, Vec3::min));
    samples.normals();
    let step = samples.len().div_ceil(CANDIDATES);
    let candidates = (0..samples.len()).into_par_iter().step_by(step);
    let mut balls: Vec<(Vec3, f32)> =
        candidates.filter_map(|i| ball_at(samples, i, LARGEST * size)).collect();
    balls.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut taken: Vec<(Vec3, f32)> = Vec::new();
    for (center, radius) in balls {
        let is_large = taken.first().is_none_or(|(_, largest)| radius >= SMALLEST * largest);
        let is_apart = taken.iter().all(|(other, radius)| center.distance(*other) > *radius);
        if is_large && is_apart && taken.len() < MOST {
            taken.push((center, radius));
        }
    }
    let ball = |(center, radius): (Vec3, f32)| Ball { center: center.as_dvec3(), radius: radius.into() };
    taken.into_iter().map(ball).collect()
}

/// Ball that touches a sample from inside: its middle and radius; nothing where it does not become smaller
/// than the `largest`.
fn ball_at(samples: &SampleSet, sample: usize, largest: f32) -> Option<(Vec3, f32)> {
    let (p, inward) = (samples.positions[sample], -samples.normals()[sample]);
    let mut radius = largest;
    for _ in 0..TIMES {
        let center = p + inward * radius;
        let other = samples.positions[samples.nearest(center) as usize];
        if other.distance(center) >= radius * (1.0 - LEAST) {
            break;
        }
        // Radius of the ball through both samples that touches the first one.
        let way = other - p;
        radius = way.length_squared() / (2.0 * inward.dot(way)).max(f32::MIN_POSITIVE);
    }
    (radius > 0.0 && radius < largest * (1.0 - LEAST)).then_some((p + inward * radius, radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples of a sphere.
    fn sphere(center: Vec3, radius: f32, count: usize) -> Vec<(Vec3, Vec3)> {
        let golden = std::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
        let point = |i: usize| {
            let z = 1.0 - (2 * i + 1) as f32 / count as f32;
            let (sin, cos) = (golden * i as f32).sin_cos();
            let n = Vec3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z);
            (center + radius * n, n)
        };
        (0..count).map(point).collect()
    }

    fn set(points: Vec<(Vec3, Vec3)>) -> SampleSet {
        let (positions, normals) = points.into_iter().unzip();
        SampleSet::new(positions, normals).unwrap()
    }

    #[test]
    fn it_is_in_the_largest_part() {
        let (body, hand) = (Vec3::new(0.2, 0.0, 0.1), Vec3::new(0.9, 0.1, 0.0));
        let samples = set([sphere(body, 0.4, 3000), sphere(hand, 0.1, 900)].concat());
        let balls = largest_balls(&samples);
        assert_eq!(balls.len(), 1, "{balls:?}");
        let ball = balls[0];
        assert!(ball.center.distance(body.as_dvec3()) < 0.02, "{ball:?}");
        assert!((ball.radius - 0.4).abs() < 0.02, "{ball:?}");
        let far = DVec3::splat(5.0);
        assert!(ball.holds_some_of([body.as_dvec3(), far]) && !ball.holds_some_of([far, 2.0 * far]));
        assert!(ball.holds_some_of([DVec3::new(-9.0, 0.1, 0.1), DVec3::new(9.0, 0.1, 0.1)]));
    }

    #[test]
    fn a_long_body_has_several() {
        // A rod with round sides: rings of samples, and ends that are closed.
        let ring = |k: usize| {
            let (sin, cos) = (k as f32 * std::f32::consts::TAU / 40.0).sin_cos();
            Vec3::new(0.1 * cos, 0.1 * sin, 0.0)
        };
        let side =
            (0..4000).map(|i| (ring(i % 40) + Vec3::Z * ((i / 40) as f32 * 0.01), ring(i % 40) * 10.0));
        let ends = (0..200).flat_map(|i| {
            let p = ring(i % 40) * (i / 40) as f32 / 5.0;
            [(p, -Vec3::Z), (p + Vec3::Z * 0.99, Vec3::Z)]
        });
        let balls = largest_balls(&set(side.chain(ends).collect()));
        assert!(balls.len() >= 4 && balls.len() <= MOST, "{balls:?}");
        assert!(balls.iter().all(|ball| ball.center.truncate().length() < 0.02), "{balls:?}");
        let apart = |a: &Ball, b: &Ball| a == b || a.center.distance(b.center) > 0.07;
        assert!(balls.iter().all(|a| balls.iter().all(|b| apart(a, b))), "{balls:?}");
    }

    #[test]
    fn what_encloses_nothing_has_none() {
        let plate = (0..2500).map(|i| (Vec3::new((i % 50) as f32, (i / 50) as f32, 0.0) * 0.02, Vec3::Z));
        assert!(largest_balls(&set(plate.collect())).is_empty());
        assert!(largest_balls(&set(vec![(Vec3::ZERO, Vec3::Z)])).is_empty());
    }
}
