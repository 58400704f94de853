//! The options of sampling.

use serde::Serialize;

use super::density::By;
use super::gather::Grouping;
use super::placement::Placement;
use super::splitting::Splitting;
use super::target::Target;

/// Options of sampling.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Sampling {
    /// Fineness of P_S.
    pub target: Target,
    /// Largest number of cells of the coarse grid along an axis; by the model's size where not given.
    pub grid: Option<u32>,
    /// Bytes of memory to stay below, for any order of the vertices; a quarter of the machine's, and at most
    /// 2 GiB, where not given, of which open cells take 64 MiB at most.
    pub memory_limit: Option<u64>,
    /// The way in which clusters are split.
    pub splitting: Splitting,
    /// Measure by which samples are spread.
    pub by: By,
    /// Form in which open cells hold their vertices: single ones, or groups of them.
    pub grouping: Grouping,
    /// The way in which samples are placed.
    pub placement: Placement,
    /// Gaussian splats of less opacity are left out, as floaters are; [`LEAST_OPACITY`](super::LEAST_OPACITY)
    /// where not given. Once sampled, nothing where none are left out.
    pub min_opacity: Option<f64>,
    /// The parts that are left out.
    pub skip: Skip,
}

/// Parts of a sampled model that can be left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Skip {
    /// The triangles of P_S, which take a pass over the faces, and temporary files of at most 8 bytes per
    /// vertex.
    pub triangles: bool,
    /// The cells, which a refinement needs.
    pub cells: bool,
    /// Estimating normals where the model has none: whoever needs them estimates them again.
    pub normals: bool,
    /// Telling sheets apart that touch, by the faces: it takes a pass over them, the same as for the
    /// triangles, and temporary files of at most 12 bytes per vertex.
    pub sheets: bool,
    /// The samples' colours, where the model has some.
    pub colors: bool,
}
