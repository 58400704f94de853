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

/// Stream a model to a small point set that any tool can deform
#[derive(Args)]
pub struct Sample {
    /// The model to sample: PLY, OBJ, STL, GLB, OFF, PCD, LAS, LAZ, E57, .splat, SPZ, or text in columns.
    /// Several files, or a pattern as 'tiles/*.laz', are one model of as many tiles
    #[arg(required = true)]
    model: Vec<PathBuf>,
    /// What the columns of a text are, as x,y,z,_,nx,ny,nz [default: by names in its first line, or x,y,z]
    #[arg(long, value_name = "NAMES")]
    columns: Option<String>,
    /// The folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    sampling: SamplingArguments,
}

/// How fine P_S shall be.
#[derive(Args)]
pub struct SamplingArguments {
    /// Number of samples [default: 100000]
    #[arg(long, value_name = "N", conflicts_with = "error")]
    samples: Option<u64>,
    /// Error bound of a sample's cluster, as a fraction of the bounding box diagonal
    #[arg(long, value_name = "E")]
    error: Option<f64>,
    /// Most cells of the coarse grid along an axis [default: 16 to 512, by the model's size]
    #[arg(long, value_name = "R")]
    grid: Option<u32>,
    /// Memory to stay below, as 500M or 2G; beyond it samples wait in a temporary file beside the output
    /// [default: a quarter of the machine's, at most 2G, of which vertices that wait take at most 64M]
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    memory_limit: Option<u64>,
    /// How clusters are split: in space and then in their plane, or in space alone
    #[arg(long, value_enum, default_value_t, value_name = "TREE")]
    tree: TreeKind,
    /// What samples are spread by: the `error` of their clusters, so that more are where the surface bends;
    /// `area`, as far apart everywhere; or `vertices`, the error beside the distance between vertices, so
    /// that finer parts get finer samples
    #[arg(long, value_enum, default_value_t, value_name = "WHAT")]
    by: SpreadBy,
    /// What places a sample in its cluster: its vertices alone, or the planes of the model's faces, which are
    /// nearer to the surface, and less even; unless given, faces where vertices have no normals, or not those
    /// of the surface
    #[arg(long, value_enum, default_value_t, value_name = "BY")]
    place: PlacementRule,
    /// Leave Gaussian splats of less opacity out of the samples, as floaters, and large and far ones of up to
    /// 0.5; they are deformed all the same [default: 0.1; 0 takes all]
    #[arg(long, value_name = "A")]
    min_opacity: Option<f64>,
    /// What to leave out: `triangles` of the samples, `cells` for refining, `normals` where they would be
    /// estimated, `sheets`, so that the model's faces do not tell parts apart that touch,
    /// `colors` of the samples
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WHAT,...")]
    skip: Vec<SkippedPart>,
    /// The default; once it had to be asked for
    #[arg(long = "sheets", hide = true)]
    _sheets: bool,
}

/// Kind of tree by which clusters are split.
#[derive(Clone, Copy, Default, ValueEnum)]
enum TreeKind {
    /// Octree, then quadtree (VS-Tree)
    #[default]
    Vs,
    /// Octree alone
    Octree,
}

/// Measure by which samples are spread.
#[derive(Clone, Copy, Default, ValueEnum)]
enum SpreadBy {
    /// Error of clusters
    #[default]
    Error,
    /// Reach of clusters
    Area,
    /// Error of clusters beside the distance between vertices
    Vertices,
}

/// Rule by which samples are placed.
#[derive(Clone, Copy, Default, ValueEnum)]
enum PlacementRule {
    /// Faces where normals do not tell where the surface is
    #[default]
    Automatic,
    /// Planes of faces
    Faces,
    /// Vertices, with their normals
    Vertices,
}

/// Parts of a sampled model.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum SkippedPart {
    Triangles,
    Cells,
    Normals,
    Sheets,
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
