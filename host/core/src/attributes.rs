//! Colours and other numbers of the model's vertices, as values of the samples: for plugins that ask for
//! them.
//!
//! A sample stands for the vertices that are nearest to it, among the samples of the sheet of the surface
//! that they lie on: of a thin wall that is painted on both sides, no sample gets the other side's colour.
//! Its value is the mean of theirs, in the attribute's own unit; of classes, that of the vertex nearest to it. They are found by one more stream of the
//! model, and kept in the folder of the samples.
//!
//! The file begins with eight letters and a version; the hash of the `samples.ply` and of the model that it
//! belongs to follow, the attributes, and a checksum.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_model::{Attribute, Error, ErrorKind, Model, Progress, Result};

use crate::fingerprint::VertexHash;
use crate::reconstruction::{RestGeometry, homes};
use crate::sampled_model::SampledModel;
use crate::sampling::kd_tree::completed;
use crate::sealed::{UNKNOWN_VERSION, seal, unseal};

/// Most attributes that samples have: the first ones of the file.
pub const MOST: usize = 32;

const MAGIC: &[u8; 8] = b"SIMODATR";
const VERSION: u32 = 2;

/// An attribute of the samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OfSamples {
    /// Its name and type in the model's file.
    pub attribute: Attribute,
    /// One for each sample, all finite.
    pub values: Vec<f32>,
}

/// The attributes of all samples, in the order of the model's file.
///
/// Memory: 4 bytes per sample and attribute.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Attributes(Vec<OfSamples>);

/// The mean of numbers of any size.
///
/// Memory: 16 bytes per sample and attribute.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    /// Takes one more, if it is a number; in the end they are rounded to single precision.
    fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.sum += value.clamp(f64::from(f32::MIN), f64::from(f32::MAX));
            self.count += 1;
        }
    }

    fn value(self) -> Option<f32> {
        (self.count > 0).then(|| (self.sum / self.count as f64) as f32)
    }
}

/// What becomes an attribute of the samples.
enum Gathered {
    Means(Vec<Mean>),
    /// Classes: the distance of the nearest vertex so far, local, and its class.
    ///
    /// Memory: 8 bytes per sample.
    Classes(Vec<(f32, f32)>),
}

impl Gathered {
    fn new(attribute: &Attribute, samples: usize) -> Self {
        if attribute.is_of_classes() {
            Self::Classes(vec![(f32::INFINITY, 0.0); samples])
        } else {
            Self::Means(vec![Mean::default(); samples])
        }
    }

    /// Adds a vertex' number to a sample at some distance.
    fn add(&mut self, sample: usize, value: f64, distance: impl FnOnce() -> f32) {
        match self {
            Self::Means(means) => means[sample].add(value),
            Self::Classes(nearest) => {
                let distance = distance();
                if value.is_finite() && distance < nearest[sample].0 {
                    nearest[sample] = (distance, value as f32);
                }
            }
        }
    }

    /// The values of all samples that have one.
    fn values(&self) -> Vec<Option<f32>> {
        match self {
            Self::Means(means) => means.iter().map(|mean| mean.value()).collect(),
            Self::Classes(nearest) => {
                nearest.iter().map(|(distance, class)| distance.is_finite().then_some(*class)).collect()
            }
        }
    }
}

impl Attributes {
    /// All of them.
    pub fn all(&self) -> &[OfSamples] {
        &self.0
    }

    /// The values of the attribute that the file calls so, one for each sample.
    pub fn get(&self, name: &str) -> Option<&[f32]> {
        self.0.iter().find(|of| of.attribute.name == name).map(|of| &*of.values)
    }

    /// Reads the model that was sampled. Vertices without a finite position, and values that are no numbers,
    /// do not count. A sample that no vertex is nearest to takes the value of the nearest one that has one;
    /// an attribute without any number is left out.
    ///
    /// Memory: 16 bytes per sample and attribute, what is known of the samples' surroundings, and some
    /// chunks.
    ///
    /// # Errors
    /// The model cannot be read, or is not what was sampled; the user cancelled.
    pub fn stream(sampled: &SampledModel, model: &dyn Model, progress: &dyn Progress) -> Result<Self> {
        let info = model.info();
        let attributes = &info.attributes[..info.attributes.len().min(MOST)];
        if let [_, .., last] = attributes
            && attributes.len() < info.attributes.len()
        {
            progress.note(&format!(
                "{} has {} attributes, of which the first {MOST} are taken, up to {}",
                model.path().display(),
                info.attributes.len(),
                last.name
            ));
        }
        if attributes.is_empty() {
            return Ok(Self::default());
        }
        let samples = &sampled.samples;
        progress.begin("reading the attributes", info.vertex_bytes);
        let around = RestGeometry::new(samples);
        let mut gathered: Vec<Gathered> =
            attributes.iter().map(|attribute| Gathered::new(attribute, samples.len())).collect();
        // Of a chunk.
        let mut values = vec![Vec::new(); attributes.len()];
        let (mut home_of, mut hash) = (Vec::new(), VertexHash::like(&sampled.source.fingerprint));
        simod_model::for_vertices(model, |chunk| {
            progress.check()?;
            hash.update(chunk.raw());
            model.attributes(chunk, &mut values)?;
            homes(&around, &sampled.frame, &chunk.positions, &mut home_of);
            let nearest = |(home, p): (&mut u32, &DVec3)| {
                *home = around.nearest_on_sheet(*home, sampled.frame.to_local(*p));
            };
            home_of.par_iter_mut().zip(&chunk.positions).with_min_len(1024).for_each(nearest);
            // In the file's order, so that sums are the same on any machine.
            for (gathered, values) in gathered.iter_mut().zip(&values) {
                let vertices = chunk.positions.iter().zip(&home_of).zip(values);
                for ((p, sample), value) in vertices.filter(|((p, _), _)| p.is_finite()) {
                    let sample = *sample as usize;
                    let distance = || sampled.frame.to_local(*p).distance(samples.positions[sample]);
                    gathered.add(sample, *value, distance);
                }
            }
            progress.advance(chunk.raw().len() as u64);
            Ok(())
        })?;
        if hash.fingerprint() != sampled.source.fingerprint {
            return Err(sampled.source_changed(model.path()));
        }
        let all = attributes.iter().zip(&gathered).filter_map(|(attribute, gathered)| {
            let values = completed(&gathered.values(), &samples.positions)?;
            Some(OfSamples { attribute: attribute.clone(), values })
        });
        Ok(Self(all.collect()))
    }

    /// The content of a file, for the `samples.ply` and the model of these hashes.
    pub(crate) fn encode(&self, of: [&str; 2]) -> Result<Vec<u8>> {
        seal(MAGIC, VERSION, &(of, self)).map_err(|e| {
            Error::internal(format!("cannot write the attributes: {e}"), "report this").because(e)
        })
    }

    /// Reads the content of a file, of so many samples.
    ///
    /// # Errors
    /// It is damaged, of a version that is not known, or of other samples.
    pub(crate) fn decode(bytes: &[u8], of: [&str; 2], samples: usize) -> Result<Self> {
        let (version, content) = unseal(bytes, MAGIC).map_err(damaged)?;
        if version != VERSION {
            return Err(damaged(UNKNOWN_VERSION));
        }
        let (known, all): ([String; 2], Self) =
            postcard::from_bytes(content).map_err(|e| damaged(&e.to_string()))?;
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
    Error::new(ErrorKind::Format, what, "remove it, and it is made anew")
}
