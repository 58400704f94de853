//! Colours and other numbers of the model's vertices, as values of the samples: for plugins that ask for
//! them.
//!
//! A sample stands for the vertices that are nearest to it, among the samples of the sheet of the surface
//! that they lie on: of a thin wall that is painted on both sides, no sample gets the other side's colour.
//! Its value is the mean of theirs, in the attribute's own unit; of classes, that of the vertex nearest to
//! it. They are found by one more stream of the model, and kept in the folder of the samples.
//!
//! The file begins with eight letters and a version; the hash of the `samples.ply` and of the model that it
//! belongs to follow, the attributes, and a checksum.

use serde::{Deserialize, Serialize};
use simod_model::{Attribute, Error, Result};

use crate::sealed::{seal, unsealed};

/// Largest number of attributes of the samples: the first ones of the file.
pub const MOST: usize = 32;

const MAGIC: &[u8; 8] = b"SIMODATR";
const VERSION: u32 = 2;

/// An attribute of the samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OfSamples {
    /// The attribute's name and type in the model's file.
    pub attribute: Attribute,
    /// Value of each sample, all finite.
    pub values: Vec<f32>,
}

/// The attributes of all samples, in the order of the model's file.
///
/// Memory: 4 bytes per sample and attribute.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SampleAttributes(Vec<OfSamples>);

impl SampleAttributes {
    /// The attributes of all samples.
    pub(crate) fn new(all: Vec<OfSamples>) -> Self {
        Self(all)
    }

    /// All attributes, in the order of the model's file.
    pub fn all(&self) -> &[OfSamples] {
        &self.0
    }

    /// The values of the attribute that the file calls so, one for each sample.
    pub fn get(&self, name: &str) -> Option<&[f32]> {
        self.0.iter().find(|of| of.attribute.name == name).map(|of| &*of.values)
    }

    /// The content of a file, for the `samples.ply` and the model of these hashes.
    pub(crate) fn encode(&self, of: [&str; 2]) -> Result<Vec<u8>> {
        seal(MAGIC, VERSION, &(of, self)).map_err(|e| Error::unwritable("the attributes", e))
    }

    /// Reads the content of a file, of so many samples.
    ///
    /// # Errors
    /// The file is damaged, of a version that is not known, or of other samples.
    pub(crate) fn decode(bytes: &[u8], of: [&str; 2], samples: usize) -> Result<Self> {
        let (known, all): ([String; 2], Self) = unsealed(bytes, (MAGIC, VERSION), damaged)?;
        if known != of {
            return Err(damaged("it belongs to other samples"));
        }
        if all.is_valid(samples) { Ok(all) } else { Err(damaged("its numbers make no sense")) }
    }

    fn is_valid(&self, samples: usize) -> bool {
        let is_good = |(i, of): (usize, &OfSamples)| {
            Attribute::is_name(&of.attribute.name)
                && self.0[..i].iter().all(|before| before.attribute.name != of.attribute.name)
                && of.values.len() == samples
                && of.values.iter().all(|value| value.is_finite())
        };
        self.0.len() <= MOST && self.0.iter().enumerate().all(is_good)
    }
}

fn damaged(what: &str) -> Error {
    let what = format!("the file of attributes is of no use: {what}");
    Error::format(what, "remove it, and it is made anew")
}
