//! What is expected of vertices: around a sample, by rounding, and of many summed up.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::frame::Frame;
use simod_model::histogram::Histogram;
use simod_model::{ModelInfo, Scalar};

/// The root of the mean square of what rounding to single precision makes, as a part of the number that is
/// rounded.
const SINGLE: f32 = 2.5e-8;

/// What is expected around a sample, in local units.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Expectation {
    /// The root of the mean square of how far it and its neighbours disagree halfway.
    pub disagreement: f32,
    /// The furthest of that, and of those which have it among their neighbours.
    pub largest: f32,
    /// The root of the mean square, of it and its neighbours, of how far it is from where the others would
    /// have it.
    pub left_out: f32,
}

/// What the file that is written rounds.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounding {
    /// Where the model's origin is, from the local one of what was shifted, in local units; `None` where
    /// positions are not of single precision.
    pub from: Option<Vec3>,
    /// What comes to all displacements, in local units, where positions are of single precision.
    pub shift: Vec3,
    /// What is rounded to an integer is off by so much, local units: the root of the mean square.
    pub step: f32,
}

impl Rounding {
    /// The rounding of a model with such positions, all of which are shifted (the model's unit).
    pub fn for_model(frame: &Frame, shift: DVec3, info: &ModelInfo) -> Self {
        let is_single = info.position_type == Scalar::F32;
        let shift = if is_single { shift } else { DVec3::ZERO };
        Self {
            from: is_single.then(|| ((frame.origin + shift) / frame.scale).as_vec3()),
            shift: (shift / frame.scale).as_vec3(),
            step: (info.rounding() / frame.scale) as f32,
        }
    }

    /// What writing it makes of a vertex that goes from `p` by `u`, local units; one that does not move is
    /// not rounded again.
    pub fn written(self, p: Vec3, u: Vec3) -> f32 {
        if u == Vec3::ZERO && self.shift == Vec3::ZERO {
            return 0.0;
        }
        self.from.map_or(self.step, |origin| SINGLE * (p + u + origin).length())
    }

    /// What rounding makes at a vertex or a sample that goes from `p` by `u`, local units.
    pub fn estimate(self, p: Vec3, u: Vec3) -> f32 {
        if u == Vec3::ZERO && self.shift == Vec3::ZERO {
            return 0.0;
        }
        // Samples are rounded each for itself, as in their file, and the blend is a mean of some; the
        // displacement comes of several sums.
        let (sample, displacement) = (0.7 * (p + u + self.shift).length(), 1.2 * u.length());
        hypot([self.written(p, u), SINGLE * sample, SINGLE * displacement])
    }
}

/// How far vertices are expected to be off. Lengths are fractions of the model's diagonal at rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExpectedError {
    /// Root of the mean square.
    pub rms: f64,
    /// 99.9 % of the vertices are expected to be off by less (to 2 %).
    pub p999: f64,
    /// The worst.
    pub worst: f64,
    /// Whether it was estimated at each vertex, for diagnostics. Otherwise it is that of the samples, each
    /// for as many vertices as it was the home of.
    pub of_vertices: bool,
    /// Where samples alone tell that it is more than will be [accepted](Self::ACCEPTED).
    #[serde(skip)]
    pub beyond: Option<ErrorExcess>,
}

/// Where more is expected than is accepted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorExcess {
    /// The largest error that is expected around a sample, as a fraction of the diagonal.
    pub worst: f64,
    /// What rounding alone makes there, as a fraction of the diagonal.
    pub rounding: f64,
    /// The position of that sample at rest, in the model's coordinates.
    pub place: DVec3,
    /// Number of samples around which it is more than is accepted.
    pub samples: u64,
    /// About how many samples more it takes until it is less, where the deformation is smooth.
    pub needed: u64,
}

impl ExpectedError {
    /// What a user will accept, as a fraction of the diagonal. In a picture in which the model is four
    /// thousand pixels long it is less than half of one, at the worst vertex; more may show, as a dent or an
    /// edge that is not straight.
    pub const ACCEPTED: f64 = 1e-4;

    /// The power of the size of clusters that the error falls with; four times as many samples halve the
    /// size.
    pub(super) const ORDER: f64 = 3.0;
}

/// Estimates of many vertices, summed up. Fractions of the diagonal.
#[derive(Default)]
pub(super) struct ErrorSums {
    histogram: Histogram,
    count: u64,
    squares: f64,
    /// The largest of them.
    pub worst: f64,
}

impl ErrorSums {
    /// Adds `vertices` for which so much is expected.
    pub fn add(&mut self, expected: f64, vertices: u64) {
        if vertices > 0 && expected.is_finite() {
            self.histogram.add_many(expected, vertices);
            self.count += vertices;
            self.squares += expected * expected * vertices as f64;
            self.worst = self.worst.max(expected);
        }
    }

    /// The error that the estimates come to; fractions of the diagonal.
    pub fn sum(&self, of_vertices: bool) -> ExpectedError {
        ExpectedError {
            rms: (self.squares / self.count.max(1) as f64).sqrt(),
            p999: self.histogram.quantile(0.999),
            worst: self.worst,
            of_vertices,
            beyond: None,
        }
    }
}

/// The root of the sum of squares.
pub(super) fn hypot<const N: usize>(parts: [f32; N]) -> f32 {
    parts.iter().map(|x| x * x).sum::<f32>().sqrt()
}
