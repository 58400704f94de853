//! `simod sample`: a model to a sampled model.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use simod_core::guard::Guard;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{By, Placement, Sampling, Skip, Splitting, Target, sample};
use simod_model::target::folder_of;
use simod_model::{ModelName, Result};
use simod_session::session_file::SamplingTable;

use super::{tell_cache, tell_transparent, warn_non_finite};
use crate::report::{Report, count, rate};

/// Stream a model to samples of it, a small point set that any tool can deform
#[derive(Args)]
pub struct Sample {
    /// Model to sample: a file, several files, or a pattern such as 'tiles/*.laz'
    ///
    /// Formats: PLY, OBJ, STL, GLB, OFF, PCD, LAS, LAZ, E57, .splat, SPZ, and text in columns. Several files,
    /// or all that match the pattern, are the tiles of one model.
    #[arg(required = true)]
    model: Vec<PathBuf>,
    /// Columns of a text file, as x,y,z,_,nx,ny,nz [default: names in its first line, or x,y,z]
    ///
    /// `_` stands for a column that is neither a position nor a normal.
    #[arg(long, value_name = "NAMES")]
    columns: Option<String>,
    /// Folder to write the sampled model to
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    sampling: SamplingArguments,
}

/// Options on the number of the samples, their places and their parts.
#[derive(Args)]
pub struct SamplingArguments {
    /// Number of samples [default: 100000]
    #[arg(long, value_name = "N", conflicts_with = "error")]
    samples: Option<u64>,
    /// Error bound of each sample's cluster, as a fraction of the bounding box's diagonal
    ///
    /// There are as many samples as it needs, instead of --samples: a smaller bound gives more.
    #[arg(long, value_name = "E")]
    error: Option<f64>,
    /// Largest number of the coarse grid's cells along an axis [default: 16 to 512]
    ///
    /// The default follows from the number of vertices, and from that of the samples.
    #[arg(long, value_name = "R")]
    grid: Option<u32>,
    /// Memory to stay below, as 500M or 2G [default: a quarter of the machine's, at most 2G]
    ///
    /// Vertices that find no room in it wait in a temporary file beside the output. By default, waiting
    /// vertices take at most 64M of it.
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    memory_limit: Option<u64>,
    /// Tree by which clusters are split
    #[arg(long, value_enum, default_value_t, value_name = "TREE")]
    tree: TreeKind,
    /// Measure by which samples are spread
    #[arg(long, value_enum, default_value_t, value_name = "WHAT")]
    by: SpreadBy,
    /// Rule by which a sample is placed in its cluster
    #[arg(long, value_enum, default_value_t, value_name = "BY")]
    place: PlacementRule,
    /// Least opacity of the Gaussian splats that are sampled [default: 0.1; 0 takes all]
    ///
    /// Fainter splats, as floaters, and large and far ones of an opacity up to 0.5 get no samples. They are
    /// deformed all the same.
    #[arg(long, value_name = "A")]
    min_opacity: Option<f64>,
    /// Parts of the sampled model to leave out, with commas between them
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WHAT,...")]
    skip: Vec<SkippedPart>,
    /// Former option, which is the default now
    #[arg(long = "sheets", hide = true)]
    _sheets: bool,
}

/// Kind of tree by which clusters are split.
#[derive(Clone, Copy, Default, ValueEnum)]
enum TreeKind {
    /// Octree, then quadtrees in the planes of the surface (VS-Tree)
    #[default]
    Vs,
    /// Octree, which splits in space alone
    Octree,
}

/// Measure by which samples are spread.
#[derive(Clone, Copy, Default, ValueEnum)]
enum SpreadBy {
    /// Error of the clusters, so that more samples are where the surface bends
    #[default]
    Error,
    /// Size of the clusters, so that samples are as far apart everywhere
    Area,
    /// Error of the clusters beside the distance between vertices, so that finer parts get finer samples
    Vertices,
}

/// Rule by which samples are placed.
#[derive(Clone, Copy, Default, ValueEnum)]
enum PlacementRule {
    /// Faces, if the vertices have no normals or not those of the surface, otherwise vertices
    #[default]
    Automatic,
    /// Planes of the model's faces: samples are nearer to the surface, and less even
    Faces,
    /// Vertices of the cluster, with their normals
    Vertices,
}

/// Parts of a sampled model.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum SkippedPart {
    /// Triangles of the samples
    Triangles,
    /// Cells with their trees, by which `simod refine` need not sample the model anew
    Cells,
    /// Normals of the samples, where they would be estimated
    Normals,
    /// Sheets, by which the model's faces tell apart parts that touch
    Sheets,
    /// Colours of the samples
    Colors,
}

/// A size in bytes, with K, M, G or T for powers of 1024.
pub(super) fn parse_bytes(text: &str) -> std::result::Result<u64, String> {
    let upper = text.to_ascii_uppercase();
    let upper = upper.strip_suffix("IB").or(upper.strip_suffix('B')).unwrap_or(&upper);
    let (number, shift) = match upper.char_indices().last() {
        Some((at, unit @ ('K' | 'M' | 'G' | 'T'))) => {
            (&upper[..at], 10 * (1 + "KMGT".find(unit).unwrap_or(0)))
        }
        _ => (upper, 0),
    };
    let bytes = number.trim().parse::<f64>().ok().filter(|n| n.is_finite() && *n > 0.0);
    bytes
        .map(|n| (n * 2f64.powi(shift as i32)) as u64)
        .ok_or_else(|| "a size is like 500M or 1.5G".to_owned())
}

impl SamplingArguments {
    pub fn sampling(&self) -> Sampling {
        let skips = |part| self.skip.contains(&part);
        Sampling {
            memory_limit: self.memory_limit,
            splitting: match self.tree {
                TreeKind::Vs => Splitting::Layered,
                TreeKind::Octree => Splitting::Octree,
            },
            skip: Skip {
                triangles: skips(SkippedPart::Triangles),
                cells: skips(SkippedPart::Cells),
                normals: skips(SkippedPart::Normals),
                sheets: skips(SkippedPart::Sheets),
                colors: skips(SkippedPart::Colors),
            },
            ..Sampling::from(self.table())
        }
    }

    /// Table of the sampling as a session would have it.
    fn table(&self) -> SamplingTable {
        SamplingTable {
            samples: self.samples,
            error: self.error,
            grid: self.grid,
            by: Some(match self.by {
                SpreadBy::Error => By::Error,
                SpreadBy::Area => By::Area,
                SpreadBy::Vertices => By::Vertices,
            }),
            place: Some(match self.place {
                PlacementRule::Automatic => Placement::Automatic,
                PlacementRule::Faces => Placement::Faces,
                PlacementRule::Vertices => Placement::Vertices,
            }),
            sheets: None,
            min_opacity: self.min_opacity,
        }
    }
}

impl Sample {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let mut guard = Guard::default();
        let named = ModelName::of_all(&self.model)?;
        guard.reads_all(named.files());
        guard.replaces_folder(&self.output)?;
        let begun = SampledModel::begin(&self.output)?;
        let cache = SampledModel::cache_in(&begun);
        let opened = named.open(self.columns.as_deref(), &cache, report.progress());
        let model = opened.map_err(|e| begun.named(e))?;
        let folder = folder_of(&self.output);
        let sampled = sample(model.as_ref(), &self.sampling.sampling(), folder, report.progress())?;
        sampled.save_in(begun)?;
        let vertices = model.info().vertices;
        warn_non_finite(&sampled, report);
        tell_transparent(&sampled, report);
        warn_faces(&sampled, report);
        if let Some(cost) = sampled.source.cost_of_order() {
            report.warn(cost);
        }
        report.figure("vertices", vertices);
        report.figure("samples", sampled.samples.len());
        report.figure("cells", sampled.cells);
        report.figure("triangles", sampled.triangles.len());
        tell_cache(&cache, report);
        report.line(format!(
            "{} vertices to {} samples in {}, {}",
            count(vertices),
            count(sampled.samples.len() as u64),
            self.output.display(),
            rate(vertices, report.seconds()),
        ));
        if let Some(error) = asked_error(&sampled, report) {
            report.line(format!("asked for {error}"));
        }
        Ok(())
    }
}

/// Error that was asked for, in words, if one was; the figures go into the report.
pub(super) fn asked_error(sampled: &SampledModel, report: &mut Report) -> Option<String> {
    let Target::Error(error) = sampled.sampling.target else { return None };
    let diagonal = sampled.bounds.diagonal();
    report.figure("error", error);
    report.figure("error_length", error * diagonal);
    Some(format!("an error of {error} of the diagonal ({:.1e} in the model's unit)", error * diagonal))
}

/// Reports the model's faces that gave no triangles of the samples.
fn warn_faces(sampled: &SampledModel, report: &mut Report) {
    if sampled.faces_without_vertex > 0 {
        report.warn(format!(
            "{} of the model's triangles refer to vertices that it does not have; they are left as they are",
            count(sampled.faces_without_vertex)
        ));
    }
    if sampled.tangled_faces {
        report.warn(
            "the model's faces connect vertices far from each other: no triangles were made of them"
                .to_owned(),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::parse_bytes;

    #[test]
    fn sizes_have_units() {
        for (text, bytes) in
            [("1", 1), ("64k", 65_536), ("1.5M", 3 << 19), ("2GiB", 2 << 30), ("100 MB", 100 << 20)]
        {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "M", "-1", "0", "1X", "nan", "1e999"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }
}
