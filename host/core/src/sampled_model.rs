//! A sampled model: P_S and where it came from, in memory or as a folder of plain files (design: `simod.toml`
//! and `samples.ply`, which any tool opens and any program may deform).

use std::fmt::Display;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use simod_model::bounds::Bounds;
use simod_model::claim::Claim;
use simod_model::frame::Frame;
use simod_model::input;
use simod_model::long_list::LongList;
use simod_model::object::{self, is_object};
use simod_model::output::{self, OutputFile};
use simod_model::output_folder::OutputFolder;
use simod_model::target::folder_of;
use simod_model::{
    Attribute, Besides, Cache, Error, ErrorMark, FaceChunk, Model, ModelName, Progress, Result, Scalar, Tile,
    VertexChunk, pattern_of,
};
use xxhash_rust::xxh3::Xxh3Default;

use crate::attributes::SampleAttributes;
use crate::colors;
use crate::deformed_file::{self, DeformedFile};
use crate::deformed_positions::DeformedPositions;
use crate::fingerprint::fingerprint;
use crate::refinement::Refinement;
use crate::sampling::cut;
use crate::sampling::density::SplitRule;
use crate::sampling::gather::Cubes;
use crate::sampling::grid::Grid;
use crate::sampling::kept_cells::KeptCells;
use crate::sampling::shares::PIECE;
use crate::sampling::triangles::Triangles;
use crate::sampling::{
    By, Grouping, Opaque, Placement, SampleSet, Sampling, Skip, Splitting, Target, UsualSplat,
};
use crate::stored_precision::StoredPrecision;
use crate::tables;
use crate::touching::Contacts;

/// Value of `format` in `simod.toml`: the kind of folder and the version.
const FORMAT: &str = "simod-sampled-model/1";

/// The file of a folder that [`bind`](crate::reconstruction::bind) adds.
pub const BINDING: &str = "binding.bin";

/// The file with the cells: see [`KeptCells`].
pub(crate) const CELLS: &str = "cells.bin";

/// File of what is made of a model that cannot be read from anywhere as it is: see [`Cache`].
const CACHE: &str = "cache.bin";

/// File of the geometry of the samples at rest: see
/// [`RestGeometry::kept`](crate::reconstruction::RestGeometry::kept).
pub(crate) const REST: &str = "rest.bin";

/// The file that describes the folder.
const DESCRIPTION: &str = "simod.toml";

/// P_S as a file.
pub(crate) const SAMPLES: &str = "samples.ply";

/// All files of a folder.
pub(crate) const OWN_FILES: [&str; 8] =
    [DESCRIPTION, SAMPLES, CELLS, SHEETS, ATTRIBUTES, BINDING, CACHE, REST];

/// Longest description: each refinement adds a few hundred bytes.
const LONGEST_DESCRIPTION: u64 = 64 << 20;

/// Longest file of cells.
const LONGEST_CELLS: u64 = 16 << 30;

/// Longest file of attributes.
pub(crate) const LONGEST_ATTRIBUTES: u64 = 16 << 30;

/// Distance from one coordinate of deformed samples to the next above which the user is warned, as a part of
/// the model's diagonal.
const COARSE: f64 = 1e-6;

/// Largest distance of a deformed sample from the model's middle, in local units: about 1e12 times the
/// model's size.
const FARTHEST: f32 = 1e12;

/// File of the sheets of samples where parts touch: see [`Contacts`].
const SHEETS: &str = "sheets.bin";

/// The file of the samples' attributes, once they were asked for: see [`SampleAttributes`].
pub(crate) const ATTRIBUTES: &str = "attributes.bin";

/// The model that was sampled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct SourceRecord {
    /// The file; in `simod.toml` relative to the folder.
    #[serde(with = "any_path")]
    pub path: PathBuf,
    /// Files that the model is made of, where these are several; `path` is a pattern that they have in common
    /// then.
    #[serde(default, skip_serializing_if = "Vec::is_empty", rename = "tile")]
    pub tiles: Vec<SourceTile>,
    /// Names of the columns as the user gave them, for a model that is a text in columns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub columns: Option<String>,
    /// The model's size in bytes.
    pub bytes: u64,
    /// The model's number of vertices.
    pub vertices: u64,
    /// Numbers that each vertex has besides position and normal; empty in folders that former versions wrote.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub attributes: Vec<Attribute>,
    /// Number of vertices without a finite position.
    pub non_finite: u64,
    /// The first vertex without a finite position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_non_finite: Option<u64>,
    /// Number of splats that were too transparent to be sampled.
    #[serde(default, skip_serializing_if = "is_none")]
    pub transparent: u64,
    /// Size and place that splats were compared with; `None` where no splats were left out for these.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usual_splat: Option<UsualSplat>,
    /// Number of vertices that are in another cell of the coarse grid than the vertex before; `None` for
    /// folders that former versions wrote.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jumps: Option<u64>,
    /// Hash of the bytes of all vertices.
    pub fingerprint: String,
}

/// One of the files that a sampled model is made of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct SourceTile {
    /// The file; in `simod.toml` relative to the folder.
    #[serde(with = "any_path")]
    pub path: PathBuf,
    /// The file's size in bytes.
    pub bytes: u64,
    /// The file's number of vertices.
    pub vertices: u64,
}

impl SourceTile {
    /// The tiles of a model; none, if it is one file.
    pub(crate) fn all(model: &dyn Model) -> Vec<Self> {
        let tile = |tile: &Tile| Self { path: tile.path.clone(), bytes: tile.bytes, vertices: tile.vertices };
        model.tiles().iter().map(tile).collect()
    }
}

fn is_none(count: &u64) -> bool {
    *count == 0
}

/// Number of vertices below which a model is carried over in a second or two in any order.
const MANY: u64 = 500_000;

impl SourceRecord {
    /// The files that were sampled.
    pub fn files(&self) -> Vec<PathBuf> {
        if self.tiles.is_empty() {
            return vec![self.path.clone()];
        }
        self.tiles.iter().map(|tile| tile.path.clone()).collect()
    }

    /// Name of the model where its files are now: its file or its tiles, or `elsewhere`, where tiles that
    /// were moved to another folder have the names that they had.
    ///
    /// # Errors
    /// A pattern matches no file.
    pub fn named(&self, elsewhere: Option<&Path>) -> Result<ModelName> {
        match elsewhere {
            None if self.tiles.is_empty() => Ok(ModelName::File(self.path.clone())),
            None => Ok(ModelName::Tiles(self.files())),
            Some(folder) if !self.tiles.is_empty() && folder.is_dir() => {
                let names = ModelName::Tiles(self.files()).tiles();
                Ok(ModelName::Tiles(names.iter().map(|name| folder.join(name)).collect()))
            }
            Some(path) => ModelName::from_path(path),
        }
    }

    /// The source with paths as seen from a folder.
    fn relative_to(&self, folder: &Path) -> Self {
        let tiles = self.tiles.iter().map(|tile| {
            // A link has a name of its own.
            let path =
                relative(folder_of(&tile.path), folder).join(tile.path.file_name().unwrap_or_default());
            SourceTile { path, ..tile.clone() }
        });
        Self { path: relative(&self.path, folder), tiles: tiles.collect(), ..self.clone() }
    }

    /// The source with paths that were relative to a folder, as this process sees them.
    fn seen_from(mut self, folder: &Path) -> Self {
        // Without the detours that a relative path makes, where it still exists.
        let seen = |path: &Path| {
            let path = input::seen_from(folder, path);
            path.canonicalize().unwrap_or(path)
        };
        for tile in &mut self.tiles {
            let path = input::seen_from(folder, &tile.path);
            // A link has a name of its own.
            let known = folder_of(&path).canonicalize().ok().zip(path.file_name());
            tile.path = known.map_or_else(|| path.clone(), |(folder, name)| folder.join(name));
        }
        self.path = if self.tiles.is_empty() { seen(&self.path) } else { pattern_of(&self.files()) };
        self
    }

    /// Whether the vertices come in no order in space: more than a fifth of them are in another cell of the
    /// coarse grid than the vertex before, as where all vertices, or runs of few, are in random order. Rows
    /// of a surface leave a cell at one of thirty vertices. `false` where the number of such vertices is not
    /// known.
    pub fn comes_in_no_order(&self) -> bool {
        self.jumps.is_some_and(|jumps| jumps > self.vertices / 5)
    }

    /// Message on the time that a reconstruction takes because its vertices [come in no order in
    /// space](Self::comes_in_no_order); `None` if they come in order, or are few.
    pub fn cost_of_order(&self) -> Option<String> {
        let jumps = self.jumps.filter(|_| self.vertices >= MANY && self.comes_in_no_order())?;
        Some(format!(
            "the vertices come in no order in space ({:.0} % of them are in another cell than the one before): to \
             reconstruct them takes {TIMES} times as long per vertex as in an order that follows the surface",
            100.0 * jumps as f64 / self.vertices as f64
        ))
    }
}

/// Ratio of the processor time per vertex in random order, or in that of runs of 2 to 4 vertices, to that in
/// a coherent one: 0.6 and 2 million vertices with normals, 2000 and 100 000 samples, vectors of 8 to 16.
const TIMES: &str = "2 to 5";

/// Paths in files: text where they are, and bytes where not, as systems allow.
mod any_path {
    use std::path::{Path, PathBuf};

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    enum Written {
        Text(PathBuf),
        Bytes(Vec<u8>),
    }

    pub fn serialize<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
        #[cfg(unix)]
        if path.to_str().is_none() {
            use std::os::unix::ffi::OsStrExt;
            return Written::Bytes(path.as_os_str().as_bytes().to_vec()).serialize(to);
        }
        path.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
        Ok(match Written::deserialize(from)? {
            Written::Text(path) => path,
            #[cfg(unix)]
            Written::Bytes(bytes) => {
                use std::os::unix::ffi::OsStringExt;
                std::ffi::OsString::from_vec(bytes).into()
            }
            #[cfg(not(unix))]
            Written::Bytes(_) => {
                return Err(serde::de::Error::custom("the model's name is no path on this system"));
            }
        })
    }
}

/// P_S with its source.
pub struct SampledModel {
    /// The model that was sampled.
    pub source: SourceRecord,
    /// The options that the model was sampled with.
    pub sampling: Sampling,
    /// Number of occupied cells of the coarse grid.
    pub cells: u64,
    /// Edge length of a cell, in the model's unit.
    pub cell_size: f64,
    /// Bounding box of the model's finite positions.
    pub bounds: Bounds,
    /// The map to local coordinates.
    pub frame: Frame,
    /// Number type of the positions in `samples.ply`.
    pub position_type: Scalar,
    /// The samples.
    pub samples: SampleSet,
    /// Red, green and blue of each sample: the model's own, averaged over its vertices. None where the model
    /// has none, or they were not wanted.
    pub colors: Vec<[u8; 3]>,
    /// Refinements since the model was sampled, first to last.
    pub refinements: Vec<Refinement>,
    /// Triangles between samples, from the model's faces; empty where the model has no faces, or triangles
    /// were not wanted.
    pub triangles: Vec<[u32; 3]>,
    /// Number of triangles of the model that refer to a vertex that there is not. Not kept in the folder.
    pub faces_without_vertex: u64,
    /// Whether the model's faces are such a tangle that no triangles were made of them. Not kept in the
    /// folder.
    pub tangled_faces: bool,
    /// Number of vertices that were gathered in groups at a time, if they were.
    group_piece: u64,
    /// The cells, after sampling; see [`cells_or_resample`](Self::cells_or_resample).
    kept: Option<KeptCells>,
    /// Folder that the model was read from, and the hash of the `samples.ply` there.
    pub(crate) folder: Option<(PathBuf, String)>,
    /// Once they were asked for.
    pub(crate) attributes: OnceLock<Arc<SampleAttributes>>,
    /// Cache of what is made of a model that cannot be read from anywhere as it is.
    cache: Arc<Cache>,
}

/// The content of `simod.toml`.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct ModelDescription {
    format: String,
    samples: u64,
    /// Hash of `samples.ply`, which deformers must not write to.
    samples_fingerprint: String,
    position_type: String,
    model: SourceRecord,
    sampling: SamplingRecord,
    frame: FrameRecord,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    refinement: Vec<Refinement>,
}

/// Splitting of clusters in folders that former versions wrote without naming it.
fn without_layers() -> Splitting {
    Splitting::VolumeSurface
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct SamplingRecord {
    target: Target,
    #[serde(skip_serializing_if = "Option::is_none")]
    grid: Option<u32>,
    cells: u64,
    cell_size: f64,
    #[serde(default = "without_layers")]
    splitting: Splitting,
    /// Measure by which samples are spread.
    #[serde(default, skip_serializing_if = "By::is_error")]
    by: By,
    /// Level of the groups that open cells held, if they held groups.
    #[serde(skip_serializing_if = "Option::is_none")]
    group_level: Option<u32>,
    /// Number of vertices that were gathered in groups at a time; all vertices where not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    group_piece: Option<u64>,
    /// Placement of the samples, if other than by their vertices alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    placement: Option<Placement>,
    /// The least opacity of splats that were sampled, if any were left out for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    min_opacity: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct FrameRecord {
    origin: DVec3,
    scale: f64,
    min: DVec3,
    max: DVec3,
}

impl ModelDescription {
    /// The file of a folder.
    ///
    /// # Errors
    /// There is none, it is damaged, or of a version that is not known.
    fn read(folder: &Path) -> Result<Self> {
        let file = folder.join(DESCRIPTION);
        if !file.exists() {
            return Err(Error::argument(
                format!("{} is no sampled model: it has no {DESCRIPTION}", folder.display()),
                "give the folder that `simod sample` wrote",
            ));
        }
        let text = input::read_text(&file, LONGEST_DESCRIPTION)?;
        let description: Self =
            tables::read(&text).map_err(|e| damaged(folder, &e.message().replace('\n', " ")))?;
        if description.format != FORMAT {
            let what = format!("format is {:?}, not {FORMAT:?}", description.format);
            return Err(damaged(folder, &what));
        }
        let FrameRecord { origin, scale, min, max } = description.frame;
        if !(min.is_finite() && max.is_finite() && Frame { origin, scale }.is_valid()) {
            return Err(damaged(folder, "the frame is not finite"));
        }
        Ok(description)
    }

    fn position_type(&self, folder: &Path) -> Result<Scalar> {
        match self.position_type.as_str() {
            "float" => Ok(Scalar::F32),
            "double" => Ok(Scalar::F64),
            other => {
                Err(damaged(folder, &format!("position-type is {other:?}, not \"float\" or \"double\"")))
            }
        }
    }

    /// The samples that are described, from their file.
    ///
    /// # Errors
    /// The file cannot be read, or holds others.
    fn samples(&self, path: &Path) -> Result<SamplesFile> {
        if file_fingerprint(path)? != self.samples_fingerprint {
            return Err(Error::mismatch(
                format!("{} is not what was sampled any more", path.display()),
                "deformed samples go to another file: sample the model again",
            ));
        }
        let samples = SamplesFile::read(path)?;
        let count = samples.positions.len();
        if count as u64 != self.samples {
            return Err(Error::mismatch(
                format!(
                    "{} has {count} vertices, but {DESCRIPTION} says {} samples",
                    path.display(),
                    self.samples
                ),
                "the samples were replaced: sample the model again, and write deformed samples to another file",
            ));
        }
        Ok(samples)
    }
}

fn damaged(folder: &Path, what: &str) -> Error {
    Error::format(
        format!("{}: {what}", folder.join(DESCRIPTION).display()),
        "it is damaged, or of another version of SIMOD: sample the model again",
    )
}

impl SamplingRecord {
    /// Options as they were asked for, with those parts to skip that are not there.
    fn options(&self, skip: Skip) -> Sampling {
        Sampling {
            target: self.target,
            grid: self.grid,
            memory_limit: None,
            splitting: self.splitting,
            by: self.by,
            grouping: self.group_level.map_or(Grouping::Never, Grouping::Level),
            placement: self.placement.unwrap_or(Placement::Vertices),
            min_opacity: self.min_opacity,
            skip,
        }
    }
}

impl SampledModel {
    /// Completes the samples, whose positions are rounded as `samples.ply` stores them, so that working in
    /// memory and through the folder give the same bytes.
    pub(crate) fn new(
        source: SourceRecord,
        sampling: Sampling,
        grid: &Grid,
        position_type: Scalar,
        (mut positions, normals): (Vec<Vec3>, Vec<Vec3>),
        triangles: Triangles,
    ) -> Result<Self> {
        let (bounds, frame) = (grid.bounds, Frame::from_bounds(&grid.bounds));
        // Far from zero, or at sizes beyond its exponent, single precision would spoil the samples.
        let diagonal = bounds.diagonal();
        let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
        let single = position_type == Scalar::F32 && largest <= 2.0 * diagonal && diagonal > 1e-30;
        let position_type = if single { Scalar::F32 } else { Scalar::F64 };
        // A cluster of groups knows its box but roughly.
        let (min, max) = (frame.to_local(bounds.min), frame.to_local(bounds.max));
        for p in &mut positions {
            *p = frame.to_local(rounded(frame.to_model(p.clamp(min, max)), position_type));
        }
        Ok(Self {
            source,
            sampling,
            cells: grid.keys.len() as u64,
            cell_size: grid.cell_size(),
            bounds,
            frame,
            position_type,
            samples: SampleSet::new(positions, normals)?,
            colors: Vec::new(),
            refinements: Vec::new(),
            triangles: triangles.triangles,
            faces_without_vertex: triangles.without_vertex,
            tangled_faces: triangles.tangled,
            group_piece: PIECE,
            kept: None,
            folder: None,
            attributes: OnceLock::new(),
            cache: Arc::default(),
        })
    }

    /// Copy of this model with new samples behind its own, given by local positions and normals (zero where
    /// unknown), and with other triangles and cells.
    pub(crate) fn refined(
        &self,
        (positions, normals): (Vec<Vec3>, Vec<Vec3>),
        triangles: Vec<[u32; 3]>,
        kept: KeptCells,
        refinement: Refinement,
    ) -> Result<Self> {
        let (min, max) = (self.frame.to_local(self.bounds.min), self.frame.to_local(self.bounds.max));
        let inside: Vec<Vec3> = positions.iter().map(|p| p.clamp(min, max)).collect();
        let positions = [&self.samples.positions[..], &self.rounded_at_rest(&inside)].concat();
        // Normals that were estimated stay as well, and orient those of the new samples.
        let known = if self.sampling.skip.normals && self.samples.known_normals().is_empty() {
            Vec::new()
        } else {
            [self.samples.normals(), &normals].concat()
        };
        Ok(Self {
            source: self.source.clone(),
            samples: self.samples.stored_alike(SampleSet::new(positions, known)?),
            colors: Vec::new(),
            refinements: self.refinements.iter().cloned().chain([refinement]).collect(),
            triangles,
            kept: Some(kept),
            folder: None,
            attributes: OnceLock::new(),
            cache: self.cache.clone(),
            ..*self
        })
    }

    /// Rule by which clusters were split while sampling, and are split by refinements.
    pub(crate) fn rule(&self) -> SplitRule {
        let SourceRecord { vertices, non_finite, transparent, .. } = self.source;
        let (finite, edge) = (
            vertices.saturating_sub(non_finite).saturating_sub(transparent),
            self.cell_size / self.frame.scale,
        );
        SplitRule::new(self.sampling.splitting, self.sampling.by, finite, self.cells, edge)
    }

    /// The splats of the model that are left out whenever it is read for samples.
    pub(crate) fn opaque(&self, model: &dyn Model) -> Option<Opaque> {
        Opaque::new(model, self.sampling.min_opacity, self.source.usual_splat)
    }

    /// Cubes in which vertices were gathered in groups; `None` if they were not.
    pub(crate) fn cubes(&self) -> Option<Cubes> {
        let edge = self.sampling.grouping.edge(self.cell_size, &self.frame)?;
        Some(Cubes { edge, piece: self.group_piece })
    }

    /// The model's diagonal, in local units.
    pub fn local_diagonal(&self) -> f64 {
        self.bounds.diagonal() / self.frame.scale
    }

    /// Writes the folder, whole or not at all. A former sampled model at the place is replaced; any other
    /// folder or file there is an error.
    ///
    /// # Errors
    /// The folder cannot be written, or something else is there.
    pub fn save(&self, folder: &Path) -> Result<()> {
        self.save_in(Self::begin(folder)?)
    }

    /// Begins the folder that a sampled model will be [saved in](Self::save_in), so that nobody else writes
    /// it meanwhile.
    ///
    /// # Errors
    /// As of [`save`](Self::save), or another process writes it.
    pub fn begin(folder: &Path) -> Result<OutputFolder> {
        Self::check_target(folder)?;
        OutputFolder::create(folder)
    }

    /// The cache of the model that will be sampled, in the folder that it will be [saved in](Self::save_in).
    pub fn cache_in(begun: &OutputFolder) -> Arc<Cache> {
        Arc::new(Cache::in_new_folder(begun, CACHE))
    }

    /// Cache of what is made of a model that cannot be read from anywhere as it is.
    pub fn cache(&self) -> &Arc<Cache> {
        &self.cache
    }

    /// Sets the cache to that which was made of the model when it was sampled.
    pub fn set_cache(&mut self, cache: Arc<Cache>) {
        self.cache = cache;
    }

    /// Saves as [`save`](Self::save) does, to a folder that was begun before.
    ///
    /// # Errors
    /// As of [`save`](Self::save).
    pub fn save_in(&self, new: OutputFolder) -> Result<()> {
        let folder = new.target();
        let named = |e: Error| new.named(e);
        let points = new.path().join(SAMPLES);
        let normals =
            if self.sampling.skip.normals { self.samples.known_normals() } else { self.samples.normals() };
        self.write_points(&points, &self.samples.positions, normals).map_err(named)?;
        let description = self.description(folder, file_fingerprint(&points).map_err(named)?);
        let text = toml::to_string(&description).map_err(|e| Error::unwritable(DESCRIPTION, e))?;
        output::write_file(&new.path().join(DESCRIPTION), text.as_bytes()).map_err(named)?;
        if let Some(kept) = &self.kept {
            let bytes = kept.encode(&description.samples_fingerprint)?;
            output::write_file(&new.path().join(CELLS), &bytes).map_err(named)?;
        }
        if let Some(contacts) = self.samples.contacts() {
            contacts.save(&new.path().join(SHEETS), &description.samples_fingerprint).map_err(named)?;
        }
        if let Some(attributes) = self.attributes.get() {
            let of = [&*description.samples_fingerprint, &*self.source.fingerprint];
            output::write_file(&new.path().join(ATTRIBUTES), &attributes.encode(of)?).map_err(named)?;
        }
        self.cache.link_to(&new.path().join(CACHE));
        // A file of another kind that came into the folder meanwhile is not lost.
        Self::check_target(folder)?;
        new.commit()
    }

    /// Content of `simod.toml` in a folder with these samples.
    fn description(&self, folder: &Path, samples_fingerprint: String) -> ModelDescription {
        ModelDescription {
            format: FORMAT.to_owned(),
            samples: self.samples.len() as u64,
            samples_fingerprint,
            position_type: match self.position_type {
                Scalar::F32 => "float".to_owned(),
                Scalar::F64 => "double".to_owned(),
            },
            model: self.source.relative_to(folder),
            sampling: SamplingRecord {
                target: self.sampling.target,
                grid: self.sampling.grid,
                cells: self.cells,
                cell_size: self.cell_size,
                splitting: self.sampling.splitting,
                by: self.sampling.by,
                group_level: match self.sampling.grouping {
                    Grouping::Level(level) => Some(level),
                    _ => None,
                },
                group_piece: Some(self.group_piece)
                    .filter(|piece| self.sampling.grouping.is_level() && *piece != u64::MAX),
                placement: Some(self.sampling.placement)
                    .filter(|placement| *placement != Placement::Vertices),
                min_opacity: self.sampling.min_opacity,
            },
            frame: FrameRecord {
                origin: self.frame.origin,
                scale: self.frame.scale,
                min: self.bounds.min,
                max: self.bounds.max,
            },
            refinement: self.refinements.clone(),
        }
    }

    /// Refuses a folder that [`save`](Self::save) may not write to: better known before a large model is
    /// sampled.
    ///
    /// # Errors
    /// Something is there that is no sampled model, or holds other files as well.
    pub fn check_target(folder: &Path) -> Result<()> {
        object::check_file("write", folder)?;
        let refused = |what: String| {
            let hint = "give the name of a new folder, or of a sampled model to replace";
            Err(Error::argument(format!("{} {what}", folder.display()), hint))
        };
        if folder.symlink_metadata().is_err() {
            let failed = |e: std::io::Error| Error::io("write", folder, &e);
            let parent = std::fs::metadata(folder_of(folder)).map_err(failed)?;
            return if parent.is_dir() {
                Ok(())
            } else {
                Err(failed(std::io::ErrorKind::NotADirectory.into()))
            };
        }
        if !Self::is_at(folder) {
            return refused("exists and is no sampled model".to_owned());
        }
        // Replacing removes the folder's files, so there may be none of the user's own.
        let entries = std::fs::read_dir(folder).map_err(|e| Error::io("read", folder, &e))?;
        let foreign = |name: &std::ffi::OsStr| {
            let left = name.to_str().is_some_and(|n| n.starts_with(".simod-") && n.ends_with(".part"));
            !OWN_FILES.iter().any(|own| name == *own) && !left
        };
        match entries.flatten().map(|e| e.file_name()).find(|name| foreign(name)) {
            Some(name) => refused(format!("holds {} beside the samples", name.display())),
            None => Ok(()),
        }
    }

    /// Whether the folder is one of a sampled model, as far as the names of its files tell.
    pub(crate) fn is_at(folder: &Path) -> bool {
        folder.join(DESCRIPTION).is_file()
    }

    /// Reads a folder.
    ///
    /// # Errors
    /// The folder is no sampled model, is of a version that is not known, or its files do not fit each other.
    pub fn load(folder: &Path) -> Result<Self> {
        let description = ModelDescription::read(folder)?;
        let FrameRecord { origin, scale, min, max } = description.frame;
        let (bounds, frame) = (Bounds { min, max }, Frame { origin, scale });
        let position_type = description.position_type(folder)?;
        let path = folder.join(SAMPLES);
        let SamplesFile { positions, normals, colors, triangles } = description.samples(&path)?;
        let local = positions.iter().map(|p| frame.to_local(*p)).collect();
        let mut samples = SampleSet::new(local, normals).map_err(|e| {
            let what = format!("{}: {e}", path.display());
            e.saying(what)
        })?;
        // Beside the folder, not in it: where open files keep a name (network file systems, Windows), the
        // folder could not be replaced as long as there are lists.
        samples.store_lists(samples.usual_storage(folder_of(folder)));
        let fingerprint = description.samples_fingerprint;
        samples.set_contacts(Contacts::load(&folder.join(SHEETS), &fingerprint, samples.len())?);
        let skip = Skip {
            normals: samples.known_normals().is_empty(),
            sheets: samples.contacts().is_none(),
            colors: colors.is_empty(),
            ..Skip::default()
        };
        Ok(Self {
            source: description.model.seen_from(folder),
            cells: description.sampling.cells,
            cell_size: description.sampling.cell_size,
            group_piece: description.sampling.group_piece.unwrap_or(u64::MAX),
            sampling: description.sampling.options(skip),
            bounds,
            frame,
            position_type,
            samples,
            colors,
            refinements: description.refinement,
            triangles,
            faces_without_vertex: 0,
            tangled_faces: false,
            kept: None,
            folder: Some((folder.to_owned(), fingerprint)),
            attributes: OnceLock::new(),
            cache: Arc::new(Cache::in_folder(&folder.join(CACHE))),
        })
    }

    /// Sampled model, as [`load`](Self::load) reads it, with the deformed samples that
    /// [`read_deformed`](Self::read_deformed) reads of several files. The first of them is read beside the
    /// samples.
    ///
    /// # Errors
    /// As of [`load`](Self::load) and [`read_deformed`](Self::read_deformed).
    pub fn load_with_deformed(
        folder: &Path,
        paths: &[&Path],
        progress: &dyn Progress,
    ) -> Result<(Self, Vec<DeformedPositions>)> {
        let first = || paths.first().map(|path| DeformedFile::read(path));
        let (sampled, first) = rayon::join(|| Self::load(folder), first);
        let (sampled, first) = (sampled?, first.transpose()?);
        let first = first.into_iter().map(|file| sampled.localized(file, progress));
        let others = paths.iter().skip(1).map(|path| sampled.read_deformed(path, progress));
        let deformed = first.chain(others).collect::<Result<_>>()?;
        Ok((sampled, deformed))
    }

    /// Content of a file in the folder that the model was read from, of at most `most` bytes; `None` where
    /// there is no such file, or it cannot be read.
    pub(crate) fn read_beside(&self, name: &str, most: u64) -> Option<LongList<u8>> {
        let (folder, _) = self.folder.as_ref()?;
        LongList::read(&folder.join(name), most, self.samples.storage()).ok()
    }

    /// Puts a file into the folder that the model was read from, if there is one, unless another process is
    /// writing the folder, or it has other samples by now: `write` makes the content, of about
    /// `expected_bytes` bytes. Files that can be made again from the rest go by here: a link is not followed,
    /// and nobody waits for the disk.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn keep_beside(
        &self,
        name: &str,
        expected_bytes: u64,
        write: impl FnOnce(&mut OutputFile) -> io::Result<()>,
    ) -> Result<()> {
        let Some((folder, samples)) = &self.folder else { return Ok(()) };
        let Ok(_claim) = Claim::folder(folder) else { return Ok(()) };
        let path = folder.join(name);
        if path.is_symlink() || file_fingerprint(&folder.join(SAMPLES))? != *samples {
            return Ok(());
        }
        let mut file = OutputFile::create(&path, expected_bytes)?;
        let failed = |e: io::Error| Error::written(&path, e);
        write(&mut file).map_err(failed)?;
        file.commit_unsynced()
    }

    /// The cells, if they are in memory: after sampling, unless they were not wanted, and after a refinement.
    pub fn held_cells(&self) -> Option<&KeptCells> {
        self.kept.as_ref()
    }

    /// The kept cells, and nothing else of the sampled model.
    pub(crate) fn into_cells(self) -> Option<KeptCells> {
        self.kept
    }

    /// Cells that are in memory, checked against the model: cells that were read from a file may be of
    /// another one.
    ///
    /// # Errors
    /// The cells are not in memory, or of another model.
    pub(crate) fn checked_cells(&self) -> Result<&KeptCells> {
        let Some(kept) = self.held_cells() else {
            return Err(Error::argument(
                "the sampled model's cells are not there, without which no part of the model can be read again",
                "sample the model again, without --skip cells",
            ));
        };
        self.check_cells(kept)?;
        Ok(kept)
    }

    /// Largest error of each sample's clusters; local units. It is 0 where the clusters are a single place.
    ///
    /// # Errors
    /// The cells are not in memory, or of another model.
    pub fn cluster_errors(&self) -> Result<Vec<f32>> {
        let trees = self.checked_cells()?.cells.iter().map(|cell| &cell.tree);
        let mut errors = cut::errors(trees, self.samples.len());
        // Samples that share a cluster with one that a tree has.
        for [sample, of] in self.samples.contacts().map_or(&[][..], Contacts::parted) {
            errors[*sample as usize] = errors[*of as usize];
        }
        Ok(errors)
    }

    /// An error if these are not the cells of this model.
    pub(crate) fn check_cells(&self, kept: &KeptCells) -> Result<()> {
        let SourceRecord { vertices, non_finite, transparent, bytes, .. } = self.source;
        let left_out = non_finite.saturating_add(transparent);
        let parted = self.samples.contacts().map_or(&[][..], Contacts::parted);
        let parted = parted.iter().map(|[sample, _]| *sample);
        kept.check(vertices - left_out.min(vertices), vertices, bytes, self.samples.len(), parted)
    }

    /// Holds cells in memory, as [`cells_or_resample`](Self::cells_or_resample) has read them: to be refined,
    /// or saved with the samples.
    pub fn hold_cells(&mut self, cells: KeptCells) {
        self.kept = Some(cells);
    }

    /// The cells in a folder, if their file is there, whole, and of the samples there.
    pub fn kept_cells(folder: &Path) -> Option<KeptCells> {
        let (of, kept) = KeptCells::decode(&input::read(&folder.join(CELLS), LONGEST_CELLS).ok()?).ok()?;
        (of == file_fingerprint(&folder.join(SAMPLES)).ok()?).then_some(kept)
    }

    /// The attributes, if they were [asked for](Self::attributes) since this was sampled or loaded.
    pub fn held_attributes(&self) -> Option<&Arc<SampleAttributes>> {
        self.attributes.get()
    }

    /// Opens the model that was sampled, or `elsewhere` if it was moved.
    ///
    /// # Errors
    /// The model cannot be opened, or is not the one that was sampled, as far as its size tells; the
    /// reconstruction compares its bytes too; what has to be made of it has no room.
    pub fn open_source(&self, elsewhere: Option<&Path>, progress: &dyn Progress) -> Result<Box<dyn Model>> {
        let path = elsewhere.unwrap_or(&self.source.path);
        let named = self.source.named(elsewhere)?;
        if let Some(gone) =
            named.files().iter().find(|file| elsewhere.is_none() && !input::may_be_there(file))
        {
            let what = format!("the sampled model's source {} is gone", gone.display());
            let hint = "put it back, or say where it is with --model";
            return Err(Error::system(what, hint).marked(ErrorMark::OtherSource));
        }
        let model = named.open(self.source.columns.as_deref(), &self.cache, progress)?;
        let info = model.info();
        let tiles = SourceTile::all(&*model);
        let is_same = |(now, then): &(&SourceTile, &SourceTile)| {
            (now.bytes, now.vertices) == (then.bytes, then.vertices)
        };
        if let Some((changed, _)) = tiles.iter().zip(&self.source.tiles).find(|both| !is_same(both)) {
            return Err(self.source_changed(&changed.path));
        }
        if tiles.len() != self.source.tiles.len() {
            let (now, then) = (tiles.len(), self.source.tiles.len());
            let what = format!("{} is {}, but {} were sampled", path.display(), files(now), files(then));
            let hint =
                "give the tiles that were sampled, or the folder that they were moved to, with --model";
            return Err(Error::mismatch(what, hint).marked(ErrorMark::OtherSource));
        }
        if (info.bytes, info.vertices) != (self.source.bytes, self.source.vertices) {
            return Err(self.source_changed(path));
        }
        Ok(model)
    }

    /// Error of a source that is not the model that was sampled.
    pub(crate) fn source_changed(&self, path: &Path) -> Error {
        let newer = self.newer_tiles();
        let which = match &newer[..] {
            _ if self.source.tiles.is_empty() || path != self.source.path => String::new(),
            [] => String::new(),
            [one] => format!(", probably {}", one.display()),
            [one, others @ ..] => {
                format!(", probably {} and {} more of its tiles", one.display(), others.len())
            }
        };
        Error::mismatch(
            format!("{} changed since it was sampled{which}", path.display()),
            "sample it again, or give the file that was sampled with --model",
        )
        .marked(ErrorMark::OtherSource)
    }

    /// The tiles that were written after the samples were.
    fn newer_tiles(&self) -> Vec<&Path> {
        let written = |path: &Path| std::fs::metadata(path).and_then(|is| is.modified()).ok();
        let Some(sampled) = self.folder.as_ref().and_then(|(folder, _)| written(&folder.join(SAMPLES)))
        else {
            return Vec::new();
        };
        let tiles = self.source.tiles.iter().map(|tile| tile.path.as_path());
        tiles.filter(|path| written(path).is_some_and(|tile| tile > sampled)).collect()
    }

    /// Writes deformed samples, in the model's coordinates, as `samples.ply` is.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_deformed(&self, path: &Path, deformed: &DeformedPositions, normals: &[Vec3]) -> Result<()> {
        self.write_as(path, deformed.places(&self.frame), normals, self.position_type)
    }

    /// Writes the samples at rest, as `samples.ply` is.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_rest(&self, path: &Path) -> Result<()> {
        self.write_points(path, &self.samples.positions, self.samples.normals())
    }

    fn write_points(&self, path: &Path, positions: &[Vec3], normals: &[Vec3]) -> Result<()> {
        let positions = positions.iter().map(|p| self.frame.to_model(*p));
        self.write_as(path, positions, normals, self.position_type)
    }

    /// Writes positions of all samples (the model's coordinates), with the properties that other programs
    /// show and keep.
    fn write_as(
        &self,
        path: &Path,
        positions: impl ExactSizeIterator<Item = DVec3>,
        normals: &[Vec3],
        scalar: Scalar,
    ) -> Result<()> {
        let besides = Besides { normals, colors: &self.colors, ids: true, triangles: &self.triangles };
        simod_model::write_vertices(path, positions, besides, scalar, &["SIMOD samples".to_owned()])
    }

    /// Local deformed positions, rounded as by writing and reading them.
    pub fn rounded(&self, deformed: &[Vec3]) -> DeformedPositions {
        self.rounded_places(deformed.iter().map(|p| self.frame.to_model(*p)))
    }

    /// Deformed positions in the model's coordinates, rounded as the file of the samples stores them.
    ///
    /// Memory: 24 bytes per sample while it runs.
    pub fn rounded_places(&self, places: impl IntoIterator<Item = DVec3>) -> DeformedPositions {
        let places: Vec<DVec3> = places.into_iter().map(|p| rounded(p, self.position_type)).collect();
        DeformedPositions::new(&self.frame, &self.samples.positions, &places)
    }

    /// Positions of samples at rest, rounded likewise.
    fn rounded_at_rest(&self, positions: &[Vec3]) -> Vec<Vec3> {
        let round = |p: &Vec3| self.frame.to_local(rounded(self.frame.to_model(*p), self.position_type));
        positions.iter().map(round).collect()
    }

    /// Writes deformed samples of a refined model: those of `before`, a file of deformed samples of the model
    /// that was refined, bit for bit as they are there, and the new ones (model coordinates), in the type of
    /// that file's positions.
    ///
    /// # Errors
    /// A file cannot be read or written.
    pub fn write_more_deformed(
        &self,
        path: &Path,
        before: &Path,
        more: &[DVec3],
        normals: &[Vec3],
    ) -> Result<()> {
        let there = self.samples.len().saturating_sub(more.len());
        let before = DeformedFile::read(before)?;
        let scalar = before.scalar;
        let mut positions = before.into_ordered(there)?;
        positions.extend_from_slice(more);
        self.write_as(path, positions.into_iter(), normals, scalar)
    }

    /// Reads deformed samples, in the order of the samples. Where the file's vertices have ids, these tell
    /// which is which; otherwise their order does. Normals in the file are not looked at, as a tool may leave
    /// stale ones. A coordinate that is the sample's own, rounded to the file's precision, did not move, and
    /// it is noted where that precision is too coarse for the model.
    ///
    /// # Errors
    /// The file cannot be read, has other vertices than P_S, or positions that are not finite.
    pub fn read_deformed(&self, path: &Path, progress: &dyn Progress) -> Result<DeformedPositions> {
        self.localized(DeformedFile::read(path)?, progress)
    }

    /// Deformed samples that were read from a file.
    fn localized(&self, deformed: DeformedFile<'_>, progress: &dyn Progress) -> Result<DeformedPositions> {
        let path = deformed.path;
        let mut places = deformed.into_ordered(self.samples.len())?;
        let precision = StoredPrecision::measure(&places);
        if let Some(note) = self.coarseness(&precision) {
            progress.note(&format!("{}: {note}", path.display()));
        }
        self.check_places(&places, &path.display())?;
        let rest = &self.samples.positions;
        for (place, own) in places.iter_mut().zip(rest) {
            let own = self.frame.to_model(*own);
            let known = |axis| if precision.is_rounded(axis, place[axis], own[axis]) { own } else { *place };
            *place = DVec3::new(known(0).x, known(1).y, known(2).z);
        }
        Ok(DeformedPositions::new(&self.frame, rest, &places))
    }

    /// Warning about deformed samples whose numbers are further apart than a millionth part of the model's
    /// diagonal, and than those of the samples at rest.
    fn coarseness(&self, precision: &StoredPrecision) -> Option<String> {
        let (step, diagonal) = (precision.coarsest(), self.bounds.diagonal());
        let own = || {
            let rest: Vec<DVec3> = self.samples.positions.iter().map(|p| self.frame.to_model(*p)).collect();
            StoredPrecision::measure(&rest).coarsest()
        };
        (step > COARSE * diagonal && step > own()).then(|| {
            format!(
                "its coordinates are {step:.1e} apart (in the model's unit; {:.1e} of the diagonal), which is coarser than the \
                 samples: what moved is rounded to that, and more samples do not help; have the program export double \
                 precision, or more digits, or shift the samples near the origin there, and back",
                step / diagonal
            )
        })
    }

    /// Local positions of deformed samples, which are in the model's coordinates; `whose` names their source,
    /// for errors.
    ///
    /// # Errors
    /// One is not finite, or too far away.
    pub fn to_local(&self, positions: &[DVec3], whose: &dyn Display) -> Result<Vec<Vec3>> {
        self.check_places(positions, whose)?;
        Ok(positions.iter().map(|p| self.frame.to_local(*p)).collect())
    }

    /// The errors of [`to_local`](Self::to_local).
    fn check_places(&self, positions: &[DVec3], whose: &dyn Display) -> Result<()> {
        let local = || positions.iter().map(|p| self.frame.to_local(*p));
        let mut bad = local().enumerate().filter(|(_, p)| !p.is_finite()).map(|(i, _)| i);
        if let Some(first) = bad.next() {
            return Err(Error::degenerate(
                format!(
                    "{} of the vertices of {whose} are not finite, the first is vertex {first}",
                    bad.count() + 1
                ),
                "mend the deformation: every sample needs a finite position",
            ));
        }
        // Squares of lengths have to be numbers, too.
        if let Some(i) = local().position(|p| p.abs().max_element() > FARTHEST) {
            return Err(Error::degenerate(
                format!("{whose}: sample {i} is at {}, too far from the model to go on", positions[i]),
                "mend the deformation: no sample can be a trillion times the model's size away",
            ));
        }
        Ok(())
    }
}

/// Number of files as text, for people.
fn files(count: usize) -> String {
    match count {
        0 => "one file that is a model by itself".to_owned(),
        1 => "1 tile".to_owned(),
        _ => format!("{count} tiles"),
    }
}

/// Hash of a whole file.
pub(crate) fn file_fingerprint(path: &Path) -> Result<String> {
    let failed = |e: std::io::Error| Error::io("read", path, &e);
    let mut file = input::open(path)?;
    let (mut hash, mut block) = (Xxh3Default::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut block).map_err(failed)? {
            0 => return Ok(fingerprint(hash.digest128())),
            n => hash.update(&block[..n]),
        }
    }
}

/// Content of a file of samples. It is held in memory, as P_S alone has to fit there.
struct SamplesFile {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    colors: Vec<[u8; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl SamplesFile {
    /// Reads P_S whole. Its ids are the order, and not looked at.
    fn read(path: &Path) -> Result<Self> {
        let model = deformed_file::open(path)?;
        let (mut positions, mut normals, mut colors) = (Vec::new(), Vec::new(), Vec::new());
        let of_colors = colors::ColorBytes::for_model(&*model)?;
        let mut reader = model.vertices(0..model.info().vertices)?;
        let (mut chunk, mut some) = (VertexChunk::default(), Vec::new());
        while reader.read(&mut chunk)? {
            positions.extend_from_slice(&chunk.positions);
            normals.extend(chunk.normals.iter().map(|n| if n.is_finite() { *n } else { Vec3::ZERO }));
            if let Some(of_colors) = &of_colors {
                of_colors.decode(&*model, &chunk, &mut some)?;
                colors.extend_from_slice(&some);
            }
        }
        let (mut faces, mut chunk, mut triangles) = (model.faces()?, FaceChunk::default(), Vec::new());
        while faces.read(&mut chunk)? {
            triangles.extend_from_slice(&chunk.triangles);
        }
        triangles.retain(|corners| corners.iter().all(|corner| (*corner as usize) < positions.len()));
        Ok(Self { positions, normals, colors, triangles })
    }
}

fn rounded(p: DVec3, to: Scalar) -> DVec3 {
    match to {
        Scalar::F32 => p.as_vec3().as_dvec3(),
        Scalar::F64 => p,
    }
}

/// The path of `file` as seen from `folder`, so that both can be moved together; absolute where it has to be.
/// An object's is the same from everywhere.
pub fn relative(file: &Path, folder: &Path) -> PathBuf {
    if is_object(file) {
        return file.to_owned();
    }
    let absolute = |p: &Path| std::path::absolute(p).unwrap_or_else(|_| p.to_owned());
    let (file, folder) = (file.canonicalize().unwrap_or_else(|_| absolute(file)), absolute(folder));
    let folder = match (folder.parent().and_then(|p| p.canonicalize().ok()), folder.file_name()) {
        (Some(parent), Some(name)) => parent.join(name),
        _ => folder,
    };
    pathdiff::diff_paths(&file, &folder).unwrap_or(file)
}
