//! A model with its samples, and the transfer of a deformation from these to all vertices, by any method.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use glam::{DVec3, Vec3};
use simod_benches::Map;
use simod_benches::peers::{self, Peer};
use simod_benches::process::{Result, own_cpu};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::{self, Reconstruction, Version, reconstruct};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::{ModelOptions, Shape, write_file};
use simod_model::output::OutputFile;
use simod_model::progress::Silent;
use simod_model::{Edited, Model, Progress, Rewriting, VertexChunk};
use tempfile::TempDir;

use crate::method::Method;

/// Processor seconds of a transfer.
pub struct Cost {
    /// Seconds of the work that is done once, before the first vertex.
    pub preparation: f64,
    /// Seconds for all vertices.
    pub transfer: f64,
}

pub struct Scene {
    pub name: String,
    pub model: Box<dyn Model>,
    pub sampled: SampledModel,
    /// All vertices.
    pub positions: Vec<DVec3>,
    /// Processor seconds for the neighbours of the samples, which SIMOD keeps from one deformation to the
    /// next.
    neighbours: f64,
    folder: TempDir,
}

impl Scene {
    /// Samples a generated model.
    pub fn generated(shape: Shape, vertices: u64, samples: u64, folder: &Path) -> Result<Self> {
        let folder = tempfile::tempdir_in(folder)?;
        let path = folder.path().join("model.ply");
        write_file(&ModelOptions { shape, vertices, ..ModelOptions::default() }, &path, &Silent)?;
        let name = match shape {
            Shape::Amphora => "amphora",
            Shape::BumpySphere => "bumpy sphere",
            _ => "generated",
        };
        Self::sampled(name.to_owned(), &path, samples, folder)
    }

    /// Samples a model of the user's.
    pub fn of_file(path: &Path, samples: u64, folder: &Path) -> Result<Self> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self::sampled(name, path, samples, tempfile::tempdir_in(folder)?)
    }

    /// The user's model, or else a generated amphora.
    pub fn of_file_or_amphora(
        path: Option<&Path>,
        vertices: u64,
        samples: u64,
        folder: &Path,
    ) -> Result<Self> {
        match path {
            Some(path) => Self::of_file(path, samples, folder),
            None => Self::generated(Shape::Amphora, vertices, samples, folder),
        }
    }

    fn sampled(name: String, path: &Path, samples: u64, folder: TempDir) -> Result<Self> {
        let model = simod_model::open(path)?;
        let sampling = Sampling { target: Target::Samples(samples), ..Sampling::default() };
        let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent)?;
        let start = own_cpu();
        sampled.samples.prepare();
        let neighbours = own_cpu() - start;
        let positions = positions_of(model.as_ref())?;
        Ok(Self { name, model, sampled, positions, neighbours, folder })
    }

    /// A line about the model, before a table.
    pub fn title(&self) -> String {
        format!("{}: {} vertices, {} samples", self.name, self.positions.len(), self.sampled.samples.len())
    }

    /// The methods that are possible: some need triangles.
    pub fn methods(&self) -> impl Iterator<Item = Method> {
        Method::all().filter(|method| !method.needs_triangles() || !self.sampled.triangles.is_empty())
    }

    /// The sample that is nearest to the front of the box (+z).
    pub fn front(&self) -> DVec3 {
        let bounds = &self.sampled.bounds;
        let front = bounds.center().with_z(bounds.max.z);
        let nearest = self.sampled.samples.nearest(self.sampled.frame.to_local(front));
        self.sampled.frame.to_model(self.sampled.samples.positions[nearest as usize])
    }

    /// Mean distance of neighbouring samples, in the model's unit.
    pub fn spacing(&self) -> f64 {
        let spacing = self.sampled.samples.spacing();
        let sum: f64 = spacing.iter().map(|x| f64::from(*x)).sum();
        sum / spacing.len() as f64 * self.sampled.frame.scale
    }

    /// P_S* after any map of space, as exact as a file of them holds.
    pub fn deform(&self, map: impl Fn(DVec3) -> DVec3) -> DeformedPositions {
        let frame = self.sampled.frame;
        let image = |p: &Vec3| frame.to_local(map(frame.to_model(*p)));
        self.sampled.rounded(&self.sampled.samples.positions.iter().map(image).collect::<Vec<_>>())
    }

    /// Carries the deformation of the samples over to the file [`result`](Self::result).
    pub fn transfer(&self, method: Method, deformed: &DeformedPositions) -> Result<Cost> {
        match method {
            Method::Simod(method) => self.reconstruct(method, deformed),
            Method::Peer(peer) => self.apply(peer, deformed),
        }
    }

    /// The same for a map, and returns all vertices as they are in the file.
    pub fn transferred(&self, method: Method, map: Map) -> Result<Vec<DVec3>> {
        self.transfer(method, &map.deform(&self.sampled))?;
        positions_of(self.result()?.as_ref())
    }

    /// The model that was written last.
    pub fn result(&self) -> Result<Box<dyn Model>> {
        Ok(simod_model::open(&self.output())?)
    }

    fn output(&self) -> PathBuf {
        self.folder.path().join("deformed.ply")
    }

    /// SIMOD, file in and file out.
    fn reconstruct(&self, method: reconstruction::Method, deformed: &DeformedPositions) -> Result<Cost> {
        let clock = StageClock::default();
        let start = own_cpu();
        let version = Version { deformed, output: &self.output(), diagnostics: None };
        let how = Reconstruction { method, ..Reconstruction::default() };
        reconstruct(&self.sampled, self.model.as_ref(), &[version], &how, &clock)?;
        let (end, began) = (own_cpu(), clock.began("reconstructing").unwrap_or(start));
        Ok(Cost { preparation: self.neighbours + began - start, transfer: end - began })
    }

    /// Another method, in memory. What it takes to write its result is not counted.
    fn apply(&self, peer: Peer, deformed: &DeformedPositions) -> Result<Cost> {
        let start = own_cpu();
        let field = peer.prepare(&self.sampled, &deformed.local);
        let began = own_cpu();
        let moved = peers::carry(field.as_ref(), &self.sampled.frame, &self.positions);
        let cost = Cost { preparation: began - start, transfer: own_cpu() - began };

        let replace = |chunk: &VertexChunk, versions: &mut [Edited]| {
            let positions = &moved[chunk.first as usize..][..chunk.len()];
            versions.iter_mut().for_each(|edited| edited.positions.copy_from_slice(positions));
            Ok(())
        };
        let mut file = OutputFile::create(&self.output(), self.model.info().bytes)?;
        self.model.rewrite(&mut [&mut file], Rewriting::default(), &replace, &Silent)?;
        file.commit()?;
        Ok(cost)
    }
}

/// All vertices of a model.
pub fn positions_of(model: &dyn Model) -> Result<Vec<DVec3>> {
    let mut positions = Vec::with_capacity(model.info().vertices as usize);
    simod_model::for_vertices(model, |chunk| {
        positions.extend_from_slice(&chunk.positions);
        Ok(())
    })?;
    Ok(positions)
}

/// Notes the processor time at which each stage begins.
#[derive(Default)]
struct StageClock(Mutex<Vec<(&'static str, f64)>>);

impl StageClock {
    fn began(&self, stage: &str) -> Option<f64> {
        let stages = self.0.lock().ok()?;
        stages.iter().find(|(name, _)| *name == stage).map(|(_, time)| *time)
    }
}

impl Progress for StageClock {
    fn begin(&self, stage: &'static str, _: u64) {
        if let Ok(mut stages) = self.0.lock() {
            stages.push((stage, own_cpu()));
        }
    }
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}
