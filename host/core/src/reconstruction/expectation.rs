//! Expected errors: around a sample, of rounding, and summed up over many vertices.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::frame::Frame;
use simod_model::histogram::Histogram;
use simod_model::{ModelInfo, Scalar};

/// Root of the mean square error by rounding to single precision, as a part of the number that is rounded.
const SINGLE: f32 = 2.5e-8;

/// Expected error around a sample, in local units.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Expectation {
    /// Root of the mean square by which the sample and its neighbours disagree halfway.
    pub disagreement: f32,
    /// Largest of these disagreements, and of those with samples that have this one among their neighbours.
    pub largest: f32,
    /// Root of the mean square, over the sample and its neighbours, of each one's distance from where the
    /// others' expansions take it.
    pub left_out: f32,
}

/// Rounding of positions in the file that is written.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounding {
    /// Local origin, shifted, as a point of the model's coordinates in local units: local positions plus this
    /// are the file's numbers in these units. `None` where positions are not of single precision.
    pub from: Option<Vec3>,
    /// Shift that is added to all displacements, in local units; zero where positions are not of single
    /// precision.
    pub shift: Vec3,
    /// Root of the mean square error of positions that are rounded to integers, local units.
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

    /// Rounding error of the written position of a vertex that goes from `p` by `u`, local units; a vertex
    /// that does not move is not rounded again.
    pub fn written(self, p: Vec3, u: Vec3) -> f32 {
        if u == Vec3::ZERO && self.shift == Vec3::ZERO {
            return 0.0;
        }
        self.from.map_or(self.step, |origin| SINGLE * (p + u + origin).length())
    }

    /// Rounding error of the whole reconstruction at a vertex or a sample that goes from `p` by `u`, local
    /// units.
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

/// Expected error of a model's vertices. Lengths are fractions of the model's diagonal at rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExpectedError {
    /// Root of the mean square.
    pub rms: f64,
    /// Bound of the expected error of 99.9 % of the vertices (to 2 %).
    pub p999: f64,
    /// Largest expected error.
    pub worst: f64,
    /// Whether the error was estimated at each vertex, for diagnostics. Otherwise it is that of the samples,
    /// each counted for as many vertices as it was the home of.
    pub of_vertices: bool,
    /// Samples around which more error is expected than will be [accepted](Self::ACCEPTED), if there are any.
    #[serde(skip)]
    pub beyond: Option<ErrorExcess>,
}

/// Samples around which more error is expected than is accepted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorExcess {
    /// The largest error that is expected around a sample, as a fraction of the diagonal.
    pub worst: f64,
    /// Error due to rounding alone around that sample, as a fraction of the diagonal.
    pub rounding: f64,
    /// The position of that sample at rest, in the model's coordinates.
    pub place: DVec3,
    /// Number of samples around which more is expected than is accepted.
    pub samples: u64,
    /// About the number of additional samples with which the error becomes acceptable, where the deformation
    /// is smooth.
    pub needed: u64,
}

impl ExpectedError {
    /// Largest error that a user will accept, as a fraction of the diagonal. In a picture in which the model
    /// is four thousand pixels long it is less than half of one, at the worst vertex; more may show, as a
    /// dent or an edge that is not straight.
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
    /// Largest of the errors.
    pub worst: f64,
}

impl ErrorSums {
    /// Adds `vertices` with this expected error.
    pub fn add(&mut self, expected: f64, vertices: u64) {
        if vertices > 0 && expected.is_finite() {
            self.histogram.add_many(expected, vertices);
            self.count += vertices;
            self.squares += expected * expected * vertices as f64;
            self.worst = self.worst.max(expected);
        }
    }

    /// Expected error summed up from all estimates; fractions of the diagonal.
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

/// Error as it is compared with others: infinite where numbers overflow, so that nothing tells it.
#[inline]
pub(super) fn infinite_if_untold(error: f32) -> f32 {
    if error.is_nan() { f32::INFINITY } else { error }
}
