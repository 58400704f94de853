//! Distances among the figures of a comparison: as fractions of the diagonal of the model's bounding box, and
//! the same in the model's unit.

use serde::{Deserialize, Serialize};
use simod_core::reconstruction::ExpectedError;
use simod_core::reconstruction::transfer_error::TransferError;
use simod_measure::{Difference, Distances};
use std::ops::Deref;

/// Figures that are fractions of the diagonal, and those of them that are distances in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WithLengths<T> {
    /// Figures as fractions of the diagonal.
    #[serde(flatten)]
    pub fractions: T,
    /// Distances in the model's unit.
    #[serde(default)]
    pub lengths: Lengths,
}

/// Distances in the model's unit, as far as the figures have them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Lengths {
    /// Root of the mean square.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms: Option<f64>,
    /// Number below which 99 of 100 are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p99: Option<f64>,
    /// Number below which 999 of 1000 are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p999: Option<f64>,
    /// Greatest distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// Greatest expected distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub worst: Option<f64>,
    /// The end of the colour scale.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color_scale: Option<f64>,
}

/// Figures among which are distances.
pub trait Fractions {
    /// The distances, as fractions of the diagonal.
    fn distances(&self) -> Lengths;
}

impl<T: Fractions> WithLengths<T> {
    /// Figures of a model whose bounding box has the `diagonal`, in the model's unit.
    pub(crate) fn new(fractions: T, diagonal: f64) -> Self {
        Self { lengths: fractions.distances().scaled(diagonal), fractions }
    }
}

impl<T> Deref for WithLengths<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.fractions
    }
}

impl Lengths {
    /// All distances times a factor.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        let scale = |x: Option<f64>| x.map(|x| x * factor);
        Self {
            rms: scale(self.rms),
            p99: scale(self.p99),
            p999: scale(self.p999),
            max: scale(self.max),
            worst: scale(self.worst),
            color_scale: scale(self.color_scale),
        }
    }
}

impl Fractions for TransferError {
    fn distances(&self) -> Lengths {
        Lengths { rms: Some(self.rms), p999: Some(self.p999), max: Some(self.max), ..Lengths::default() }
    }
}

impl Fractions for ExpectedError {
    fn distances(&self) -> Lengths {
        Lengths { rms: Some(self.rms), p999: Some(self.p999), worst: Some(self.worst), ..Lengths::default() }
    }
}

impl Fractions for Difference {
    fn distances(&self) -> Lengths {
        Lengths { rms: Some(self.rms), p99: Some(self.p99), max: Some(self.max), ..Lengths::default() }
    }
}

impl Fractions for Distances {
    fn distances(&self) -> Lengths {
        Lengths { rms: Some(self.rms), max: Some(self.max), ..Lengths::default() }
    }
}
