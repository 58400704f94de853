//! A limit to what the blend of expansions may do where the deformation is not smooth.
//!
//! A polynomial that is fitted across a step overshoots on both sides. Where a vertex is blended from samples that
//! their neighbours leave in doubt, it is held within where the samples around it would take it, each by its own
//! displacement and the gradient that prevails there: in the direction in which the blend departs from their mean, no
//! further than the furthest of them, and a little. This is the limiter of finite volumes (T. Barth, D. Jespersen, *The
//! Design and Application of Upwind Schemes on Unstructured Meshes*, 1989), for vectors: it turns with the model.

use glam::{Mat3, Vec3};

use super::blend::Supports;
use super::blended_jets::Doubt;
use super::expansion::Expansion;

/// How far the blend may leave the samples' range, as a part of it.
const OVERSHOOT: f32 = 0.02;

/// The homes that samples in doubt reach, and what prevails around them.
///
/// Memory: eight bytes per sample, and 40 for each home that is concerned, unless no sample is in doubt.
#[derive(Debug, Default)]
pub struct Limiter {
    /// For each home its place in `prevailing`, or [`NONE`]; empty if no sample is in doubt.
    concerned: Vec<u32>,
    /// The mean gradient of the displacement around a home, and the most that it may make of a way: the largest
    /// difference of their displacements from the home's.
    prevailing: Vec<(Mat3, f32)>,
    /// How little the expansion of each sample is to be believed, from 0 to 1; empty if no sample is in doubt.
    doubt: Vec<f32>,
}

const NONE: u32 = u32::MAX;

impl Limiter {
    /// Of the expansions, and those of them that are in doubt.
    pub fn new(supports: &Supports, expansions: &[Expansion], doubtful: &[(u32, Doubt)]) -> Self {
        if doubtful.is_empty() {
            return Self::default();
        }
        let n = expansions.len();
        let mut doubt = vec![0.0; n];
        let mut slopes: Vec<Mat3> = expansions.iter().map(Expansion::slope).collect();
        for (i, d) in doubtful {
            doubt[*i as usize] = d.amount;
            slopes[*i as usize] = d.prevailing;
        }
        let (mut concerned, mut prevailing) = (vec![NONE; n], Vec::new());
        for (home, place) in concerned.iter_mut().enumerate() {
            let around = || supports.of_home(home).iter().map(|r| r.sample as usize);
            if around().any(|i| doubt[i] > 0.0) {
                *place = prevailing.len() as u32;
                let sum = around().fold(Mat3::ZERO, |sum, i| sum + slopes[i]);
                let from_home = |i: usize| expansions[i].displacement() - expansions[home].displacement();
                let spread = around().map(|i| from_home(i).length()).fold(0.0, f32::max);
                prevailing.push((sum * (1.0 / around().count() as f32), spread));
            }
        }
        Self { concerned, prevailing, doubt }
    }

    /// Whether the vertices of this home have to be limited.
    #[inline]
    pub fn concerns(&self, home: usize) -> bool {
        self.concerned.get(home).is_some_and(|place| *place != NONE)
    }

    /// The displacement of a point at `d` from a sample, beyond its support, and the gradient there.
    pub fn beyond(&self, expansions: &[Expansion], sample: usize, d: Vec3) -> (Vec3, Mat3) {
        let e = &expansions[sample];
        let (u, slope) = e.beyond(d);
        if !self.concerns(sample) {
            return (u, slope);
        }
        let (prevailing, most) = self.prevailing[self.concerned[sample] as usize];
        let doubt = self.doubt[sample];
        let held = e.displacement() + (prevailing * d).clamp_length_max(most);
        (u.lerp(held, doubt), slope * (1.0 - doubt) + prevailing * doubt)
    }

    /// The displacement of a vertex at `p`, for which the expansions around its home, which is concerned, give
    /// `blended`.
    pub fn limited(
        &self,
        supports: &Supports,
        expansions: &[Expansion],
        home: usize,
        p: Vec3,
        blended: Vec3,
    ) -> Vec3 {
        let (prevailing, most) = self.prevailing[self.concerned[home] as usize];
        let said = || {
            supports.of_home(home).iter().filter_map(|r| {
                let e = &expansions[r.sample as usize];
                let d = p - Vec3::from_array(e.center);
                let s = (1.0 - d.length_squared() * e.inverse_square).max(0.0);
                let w = s * s * s;
                (w > 0.0).then(|| {
                    (
                        w,
                        self.doubt[r.sample as usize],
                        e.displacement() + (prevailing * d).clamp_length_max(most),
                    )
                })
            })
        };
        let (mut mean, mut doubt, mut sum) = (Vec3::ZERO, 0.0, 0.0);
        for (w, amount, u) in said() {
            mean += w * u;
            doubt += w * amount;
            sum += w;
        }
        (mean, doubt) = (mean / sum, doubt / sum);
        let departure = blended - mean;
        let length = departure.length();
        // Written so that NaN, from a vertex without a support, is left alone.
        if !(length > 0.0 && doubt > 0.0) {
            return blended;
        }
        let direction = departure / length;
        let along = said().map(|(_, _, u)| (u - mean).dot(direction));
        let (low, high) = along.fold((0.0f32, 0.0f32), |(low, high), x| (low.min(x), high.max(x)));
        let limited = mean + direction * length.min(high + OVERSHOOT * (high - low));
        blended.lerp(limited, doubt.min(1.0))
    }
}
