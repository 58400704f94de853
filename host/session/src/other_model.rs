//! Other models than the one that is deformed, as plugins take them: points, in the local coordinates of the
//! deformed model.
//!
//! A model is sampled, to as many points as the plugin takes. Samples that the user has are taken as they
//! are, so that each can be told by its id: the folder of a sampled model, and files of samples that anything
//! has moved.

use glam::{DVec3, Vec3};
use simod_core::deformed_file::place_of_ids;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{SampleSet, Sampling, Skip, Target, sample};
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::{Cache, Error, Model, Progress, Result, VertexChunk, for_faces};
use simod_plugin_api as api;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// Most samples that are taken as they are.
const MOST_SAMPLES: u64 = 1 << 22;

/// File that describes a sampled model, and the file of its samples.
const OF_SAMPLED: [&str; 2] = ["simod.toml", "samples.ply"];

/// Points of another model.
///
/// Memory: 44 bytes a point and 12 a triangle, of at most 4 194 304 points.
#[derive(Debug)]
pub(crate) struct OtherModel {
    kind: api::PointsKind,
    vertices: u64,
    /// Local coordinates of the model that is deformed.
    positions: Vec<[f64; 3]>,
    normals: Vec<[f32; 3]>,
    ids: Vec<u64>,
    triangles: Vec<[u32; 3]>,
}

impl OtherModel {
    /// Reads a model, of which `points` are taken at most, for one with local coordinates of `frame`.
    /// Temporary files without a name are made in `folder`.
    ///
    /// # Errors
    /// The model cannot be read or sampled, has a point that is not finite in the other's coordinates, or
    /// more samples than are taken as they are; the user cancelled.
    pub fn read(
        path: &Path,
        points: u64,
        frame: &Frame,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        if let Some(folder) = sampled_folder(path) {
            let sampled = SampledModel::load(&folder)?;
            let count = sampled.samples.len() as u64;
            if count > MOST_SAMPLES {
                return Err(too_many(count));
            }
            let kind = (api::PointsKind::SAMPLES, count);
            return Self::from_samples(
                kind,
                sampled.samples,
                &sampled.frame,
                (0..count).collect(),
                sampled.triangles,
                frame,
            );
        }
        let elsewhere = std::env::temp_dir();
        let folder = if folder.as_os_str().is_empty() { &elsewhere } else { folder };
        let model = simod_model::open_with(path, None, &Arc::new(Cache::nameless(folder)), progress)?;
        if let Some((positions, ids)) = samples_with_ids(&*model, progress)? {
            return Self::of_samples(&*model, &positions, ids, frame);
        }
        let skip = Skip { cells: true, normals: true, sheets: true, colors: true, triangles: false };
        let sampling = Sampling { target: Target::Samples(points), skip, ..Sampling::default() };
        let sampled = sample(&*model, &sampling, folder, progress)?;
        let kind = (api::PointsKind::SAMPLED, model.info().vertices);
        Self::from_samples(kind, sampled.samples, &sampled.frame, Vec::new(), sampled.triangles, frame)
    }

    /// The model of the samples in a file. Their normals there may be those of before something moved them.
    fn of_samples(model: &dyn Model, positions: &[DVec3], ids: Vec<u64>, frame: &Frame) -> Result<Self> {
        let theirs = Frame::from_bounds(&Bounds::from_points(positions.iter().copied()));
        let local = positions.iter().map(|p| theirs.to_local(*p)).collect();
        let mut triangles = Vec::new();
        let most = 4 * MOST_SAMPLES as usize;
        for_faces(model, |chunk| {
            triangles.extend_from_slice(&chunk.triangles);
            if triangles.len() > most {
                return Err(Error::format(
                    format!("there are more than {most} triangles between samples"),
                    "give the model without its property id, so that it is sampled",
                ));
            }
            Ok(())
        })?;
        triangles.retain(|corners| corners.iter().all(|corner| (*corner as usize) < positions.len()));
        let kind = (api::PointsKind::SAMPLES, positions.len() as u64);
        Self::from_samples(kind, SampleSet::new(local, Vec::new())?, &theirs, ids, triangles, frame)
    }

    /// Model from its samples, in local coordinates of their own.
    fn from_samples(
        (kind, vertices): (api::PointsKind, u64),
        samples: SampleSet,
        theirs: &Frame,
        ids: Vec<u64>,
        triangles: Vec<[u32; 3]>,
        frame: &Frame,
    ) -> Result<Self> {
        let local = |p: &Vec3| frame.to_local_exact(theirs.to_model(*p)).to_array();
        let positions: Vec<[f64; 3]> = samples.positions.iter().map(local).collect();
        if positions.iter().flatten().any(|x| !x.is_finite()) {
            let what = "its coordinates are too far from those of the model that is deformed";
            return Err(Error::degenerate(what, "give both in the same unit"));
        }
        let samples = if samples.knows_normals() || triangles.is_empty() {
            samples
        } else {
            let normals = normals_of(&samples.positions, &triangles);
            SampleSet::new(samples.positions, normals)?
        };
        let normals = bytemuck::cast_slice(samples.normals()).to_vec();
        Ok(Self { kind, vertices, positions, normals, ids, triangles })
    }

    /// View of the model as plugins have it, for the parameter of an id.
    pub fn view<'a>(&'a self, param: &'a str) -> api::OtherModel<'a> {
        let Self { kind, vertices, positions, normals, ids, triangles } = self;
        api::OtherModel::new((param, *kind, *vertices), positions, normals, ids, triangles)
    }
}

/// Stamps by which a change of a file is noticed: for a sampled model, those of its own files.
pub(crate) fn stamps(path: &Path) -> Vec<(u64, Option<SystemTime>)> {
    let files = match sampled_folder(path) {
        Some(folder) => OF_SAMPLED.iter().map(|name| folder.join(name)).collect(),
        None => vec![path.to_owned()],
    };
    files.iter().filter_map(|file| file.metadata().ok()).map(|m| (m.len(), m.modified().ok())).collect()
}

/// The folder of a sampled model, if the path is one, or the file that describes it.
fn sampled_folder(path: &Path) -> Option<PathBuf> {
    if path.is_dir() {
        return Some(path.to_owned());
    }
    let folder = path.parent().filter(|_| path.file_name().is_some_and(|name| name == OF_SAMPLED[0]))?;
    Some(folder.to_owned())
}

fn too_many(count: u64) -> Error {
    let what = format!("there are {count} samples, more than {MOST_SAMPLES}");
    Error::argument(what, "give the model, which is sampled, or fewer samples")
}

/// Positions and ids of a file of samples; none where the file is no such: it has no ids, or not one for
/// each.
///
/// # Errors
/// The file cannot be read, or a sample has no finite position; the user cancelled.
fn samples_with_ids(model: &dyn Model, progress: &dyn Progress) -> Result<Option<(Vec<DVec3>, Vec<u64>)>> {
    let info = model.info();
    let Some(place) = place_of_ids(&info.attributes).filter(|_| info.vertices <= MOST_SAMPLES) else {
        return Ok(None);
    };
    let (mut positions, mut ids) = (Vec::new(), Vec::new());
    let mut lists = vec![Vec::new(); place + 1];
    let mut reader = model.vertices(0..info.vertices)?;
    let mut chunk = VertexChunk::default();
    while reader.read(&mut chunk)? {
        progress.check()?;
        positions.extend_from_slice(&chunk.positions);
        model.attributes(&chunk, &mut lists)?;
        ids.extend_from_slice(&lists[place]);
    }
    let whole: Vec<u64> = ids.iter().map(|id| *id as u64).collect();
    let is_whole = ids.iter().zip(&whole).all(|(id, whole)| *id == *whole as f64);
    if !is_whole || whole.iter().collect::<HashSet<_>>().len() != whole.len() {
        return Ok(None);
    }
    match positions.iter().position(|p| !p.is_finite()) {
        None if positions.is_empty() => Ok(None),
        None => Ok(Some((positions, whole))),
        Some(i) => {
            let what = format!("sample {} of {} has no finite position", whole[i], model.path().display());
            Err(Error::degenerate(what, "mend what moved the samples"))
        }
    }
}

/// Unit normals of the corners of triangles, each weighted by its area; zero where there is none.
fn normals_of(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for corners in triangles {
        let [a, b, c] = corners.map(|i| positions[i as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        corners.iter().for_each(|i| sums[*i as usize] += normal);
    }
    sums.into_iter().map(|n| n.normalize_or_zero().as_vec3()).collect()
}
