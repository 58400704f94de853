//! A limit to what the blend of expansions may do where the deformation is not smooth.
//!
//! A polynomial that is fitted across a step overshoots on both sides. Where a vertex is blended from
//! troubled samples, whose neighbours disagree with them, it is held within where the samples around it would
//! take it, each by its own displacement and the gradient that prevails there: in the direction in which the
//! blend departs from their mean, no further than those of them do that lie that way. This is the limiter of
//! finite volumes (T. Barth, D. Jespersen, *The Design and Application of Upwind Schemes on Unstructured
//! Meshes*, 1989), for vectors, so that it turns with the model, and with a mean of fourth powers in the
//! place of the furthest, so that it is as continuous as the weights are.

use glam::{Mat3, Vec3};
use rayon::prelude::*;
use simod_model::long_list::ListStorage;

use super::blend::Supports;
use super::blended_jets::TroubledSample;
use super::expansion::Expansion;
use super::transport::Transport;

/// First-order displacement around a sample, with the gradient that prevails there.
#[derive(Debug, Clone, Copy)]
struct PrevailingSlope {
    /// The gradient of the displacement that prevails around the sample.
    slope: Mat3,
    /// Largest displacement beyond the sample's own that the gradient may make: the largest difference of
    /// displacements around the sample from its own.
    most: f32,
    /// Distrust of the sample's expansion, from 0 to 1.
    trouble: f32,
}

impl PrevailingSlope {
    /// The displacement at `d` from the sample, beyond the sample's.
    #[inline(always)]
    fn evaluate(&self, d: Vec3) -> Vec3 {
        (self.slope * d).clamp_length_max(self.most)
    }

    /// The limited displacement at `d`, and its gradient.
    #[inline(always)]
    fn evaluate_with_gradient(&self, d: Vec3) -> (Vec3, Mat3) {
        let (u, held) = (self.slope * d, self.evaluate(d));
        (held, if held == u { self.slope } else { self.slope * (held.length() / u.length()) })
    }
}

/// Homes that the supports of troubled samples reach, and the prevailing slopes of all samples that reach
/// there.
///
/// Memory: five bytes per sample, four more while it is made, and 44 for each that reaches such a home,
/// unless no sample is troubled.
#[derive(Debug, Default)]
pub struct Limiter {
    /// Whether the support of a troubled sample reaches each home; empty if none is troubled.
    concerned: Vec<bool>,
    /// Place of each sample in `held`, or [`NONE`].
    place: Vec<u32>,
    held: Vec<PrevailingSlope>,
}

const NONE: u32 = u32::MAX;

impl Limiter {
    /// The limiter for these expansions, of which these samples are `troubled`.
    pub fn new(
        supports: &Supports,
        expansions: &[Expansion],
        troubled: &[(u32, TroubledSample)],
        storage: &ListStorage,
    ) -> Self {
        if troubled.is_empty() {
            return Self::default();
        }
        let n = expansions.len();
        let around = |i: usize| supports.of_home(i).iter().map(|r| r.sample as usize);
        let mut of_sample = vec![NONE; n];
        troubled.iter().zip(0..).for_each(|((i, _), at)| of_sample[*i as usize] = at);
        let concerned: Vec<bool> = storage
            .counted(n, supports.bytes_of(1))
            .map(|home| around(home).any(|i| of_sample[i] != NONE))
            .collect();
        let mut this = Self { concerned, place: vec![NONE; n], held: Vec::new() };
        for i in (0..n).filter(|home| this.concerned[*home]).flat_map(around) {
            if this.place[i] == NONE {
                this.place[i] = this.held.len() as u32;
                let (slope, trouble) = match troubled.get(of_sample[i] as usize) {
                    Some((_, trouble)) => (trouble.prevailing, trouble.amount),
                    None => (expansions[i].slope(), 0.0),
                };
                let differences =
                    around(i).map(|j| expansions[j].displacement().distance(expansions[i].displacement()));
                this.held.push(PrevailingSlope { slope, most: differences.fold(0.0, f32::max), trouble });
            }
        }
        this
    }

    /// Whether any home is concerned.
    pub fn is_needed(&self) -> bool {
        !self.held.is_empty()
    }

    /// Whether the vertices of this home have to be limited.
    #[inline]
    pub fn concerns(&self, home: usize) -> bool {
        self.concerned.get(home).is_some_and(|concerned| *concerned)
    }

    /// The displacement of a point at `d` from a sample, beyond its support, and the gradient there.
    pub fn beyond(&self, expansions: &[Expansion], sample: usize, d: Vec3) -> (Vec3, Mat3) {
        let e = &expansions[sample];
        let (u, slope) = e.beyond(d);
        let Some(held) = self.place.get(sample).and_then(|place| self.held.get(*place as usize)) else {
            return (u, slope);
        };
        let (way, prevailing) = held.evaluate_with_gradient(d);
        let mixed = slope * (1.0 - held.trouble) + prevailing * held.trouble;
        (u.lerp(e.displacement() + way, held.trouble), mixed)
    }

    /// Limited transport of a vertex at `p`, for which the expansions around its home, which is concerned,
    /// give `blended`.
    pub fn limited(
        &self,
        supports: &Supports,
        expansions: &[Expansion],
        home: usize,
        p: Vec3,
        blended: Transport,
    ) -> Transport {
        // For each support that reaches the vertex: the way from its centre, the depth of the vertex in it,
        // and the prevailing slope of its sample.
        let reaching = || {
            supports.of_home(home).iter().filter_map(|r| {
                let (e, place) = (&expansions[r.sample as usize], self.place[r.sample as usize]);
                let d = p - Vec3::from_array(e.center);
                let s = (1.0 - d.length_squared() * e.inverse_square).max(0.0);
                (s > 0.0).then_some((e, d, s, &self.held[place as usize]))
            })
        };
        let (mut mean, mut trouble, mut sum) = (Vec3::ZERO, 0.0, 0.0);
        for (e, d, s, held) in reaching() {
            let w = s * s * s;
            mean += w * (e.displacement() + held.evaluate(d));
            trouble += w * held.trouble;
            sum += w;
        }
        (mean, trouble) = (mean / sum, trouble / sum);
        let departure = blended.displacement - mean;
        let length = departure.length();
        // Written so that NaN, from a vertex without a support, is left alone.
        if !(length > 0.0 && trouble > 0.0) {
            return blended;
        }
        let along = |u: Vec3| (u - mean).dot(departure / length).max(0.0);
        let fourths =
            reaching().map(|(e, d, s, held)| s * s * s * fourth(along(e.displacement() + held.evaluate(d))));
        // A mean that is nearly the furthest of them.
        let most = (fourths.sum::<f32>() / sum).sqrt().sqrt();
        let back = trouble * (1.0 - (most / length).min(1.0));
        if back == 0.0 {
            return blended;
        }
        let (mut slope, mut sum_slope) = (Mat3::ZERO, Vec3::ZERO);
        for (e, d, s, held) in reaching() {
            let (way, of_way) = held.evaluate_with_gradient(d);
            let of_weight = -6.0 * s * s * e.inverse_square * d;
            slope += of_way * (s * s * s) + outer(e.displacement() + way, of_weight);
            sum_slope += of_weight;
        }
        slope = (slope - outer(mean, sum_slope)) * (1.0 / sum);
        Transport {
            displacement: blended.displacement - departure * back,
            gradient: blended.gradient * (1.0 - back) + (Mat3::IDENTITY + slope) * back,
        }
    }
}

fn fourth(x: f32) -> f32 {
    x * x * x * x
}

/// a bᵀ
pub fn outer(a: Vec3, b: Vec3) -> Mat3 {
    Mat3::from_cols(a * b.x, a * b.y, a * b.z)
}
