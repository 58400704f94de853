//! The attributes of the samples, found by one more stream of the model, and kept in the folder that the
//! samples are from.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;
use simod_model::{Attribute, Model, Progress, Result};

use crate::attributes::{MOST, OfSamples, SampleAttributes};
use crate::fingerprint::VertexHash;
use crate::reconstruction::{RestGeometry, homes};
use crate::sampled_model::{ATTRIBUTES, LONGEST_ATTRIBUTES, SampledModel};
use crate::sampling::kd_tree::completed;

impl SampledModel {
    /// Colours and other attributes of the samples: those that the folder of the samples keeps, or else means
    /// over the model, which is read once more for them and kept in that folder. `elsewhere` is the model's
    /// path if the model was moved.
    ///
    /// # Errors
    /// As of [`open_source`](Self::open_source); the model is not what was sampled, or cannot be read; the
    /// user cancelled.
    pub fn attributes(
        &self,
        elsewhere: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<&Arc<SampleAttributes>> {
        if let Some(known) = self.attributes.get() {
            return Ok(known);
        }
        let found = match self.kept_attributes() {
            Some(kept) => kept,
            None => {
                let found = self.stream_attributes(&*self.open_source(elsewhere, progress)?, progress)?;
                if let Err(e) = self.keep_attributes(&found) {
                    progress.note(&format!("the attributes are not kept, and found anew the next time: {e}"));
                }
                found
            }
        };
        Ok(self.attributes.get_or_init(|| Arc::new(found)))
    }

    /// The attributes in the folder, if their file is there, whole, and of these samples.
    fn kept_attributes(&self) -> Option<SampleAttributes> {
        let (_, samples) = self.folder.as_ref()?;
        let bytes = self.read_beside(ATTRIBUTES, LONGEST_ATTRIBUTES)?;
        SampleAttributes::decode(&bytes, [samples, &self.source.fingerprint], self.samples.len()).ok()
    }

    /// Puts the attributes into the folder, if there is one, unless another process is writing it, or has.
    fn keep_attributes(&self, attributes: &SampleAttributes) -> Result<()> {
        let Some((_, samples)) = &self.folder else { return Ok(()) };
        let of: [&str; 2] = [samples, &self.source.fingerprint];
        let values = attributes.all().iter().map(|of| of.values.len());
        let bytes = 4 * values.sum::<usize>() as u64;
        self.keep_beside(ATTRIBUTES, bytes, |file| {
            file.write_all(&attributes.encode(of).map_err(io::Error::other)?)
        })
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
    pub fn stream_attributes(&self, model: &dyn Model, progress: &dyn Progress) -> Result<SampleAttributes> {
        let info = model.info();
        let attributes = taken(model, progress);
        if attributes.is_empty() {
            return Ok(SampleAttributes::default());
        }
        let samples = &self.samples;
        progress.begin("reading the attributes", info.vertex_bytes);
        let around = RestGeometry::kept(self);
        let mut gathered: Vec<AttributeSource> =
            attributes.iter().map(|attribute| AttributeSource::new(attribute, samples.len())).collect();
        // Of a chunk.
        let mut values = vec![Vec::new(); attributes.len()];
        let (mut home_of, mut hash) = (Vec::new(), VertexHash::like(&self.source.fingerprint));
        simod_model::for_vertices(model, |chunk| {
            progress.check()?;
            hash.update(chunk.raw());
            model.attributes(chunk, &mut values)?;
            homes(&around, &self.frame, &chunk.positions, &mut home_of);
            let nearest = |(home, p): (&mut u32, &DVec3)| {
                *home = around.nearest_on_sheet(*home, self.frame.to_local(*p));
            };
            home_of.par_iter_mut().zip(&chunk.positions).with_min_len(1024).for_each(nearest);
            // In the file's order, so that sums are the same on any machine.
            for (gathered, values) in gathered.iter_mut().zip(&values) {
                let vertices = chunk.positions.iter().zip(&home_of).zip(values);
                for ((p, sample), value) in vertices.filter(|((p, _), _)| p.is_finite()) {
                    let sample = *sample as usize;
                    let distance = || self.frame.to_local(*p).distance(samples.positions[sample]);
                    gathered.add(sample, *value, distance);
                }
            }
            progress.advance(chunk.raw().len() as u64);
            Ok(())
        })?;
        if hash.fingerprint() != self.source.fingerprint {
            return Err(self.source_changed(model.path()));
        }
        let all = attributes.iter().zip(&gathered).filter_map(|(attribute, gathered)| {
            let values = completed(&gathered.values(), &samples.positions)?;
            Some(OfSamples { attribute: attribute.clone(), values })
        });
        Ok(SampleAttributes::new(all.collect()))
    }
}

/// Attributes of the model that the samples get: the first ones, if there are very many, in which case the
/// user is told.
fn taken<'a>(model: &'a dyn Model, progress: &dyn Progress) -> &'a [Attribute] {
    let all = &model.info().attributes;
    let attributes = &all[..all.len().min(MOST)];
    if let [_, .., last] = attributes
        && attributes.len() < all.len()
    {
        progress.note(&format!(
            "{} has {} attributes, of which the first {MOST} are taken, up to {}",
            model.path().display(),
            all.len(),
            last.name
        ));
    }
    attributes
}

/// The mean of numbers of any size.
///
/// Memory: 16 bytes per sample and attribute.
#[derive(Debug, Clone, Copy, Default)]
struct RunningMean {
    sum: f64,
    count: u64,
}

impl RunningMean {
    /// Adds one more value, if it is a number; the means are rounded to single precision in the end.
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

/// Source of the values that the samples get for one attribute of the model.
enum AttributeSource {
    Means(Vec<RunningMean>),
    /// Classes: the distance of the nearest vertex so far, local, and its class.
    ///
    /// Memory: 8 bytes per sample.
    Classes(Vec<(f32, f32)>),
}

impl AttributeSource {
    fn new(attribute: &Attribute, samples: usize) -> Self {
        if attribute.is_of_classes() {
            Self::Classes(vec![(f32::INFINITY, 0.0); samples])
        } else {
            Self::Means(vec![RunningMean::default(); samples])
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
