//! A PLY file once it is open.

use super::header::PlyHeader;
use super::layout::PlyLayout;
use super::offsets::Offsets;
use crate::follow::Following;
use crate::source::SourceFile;
use crate::{ModelInfo, Result};

/// A PLY file.
#[derive(Debug)]
pub struct PlyModel {
    pub(super) source: SourceFile,
    pub(super) header: PlyHeader,
    /// Index of the element that holds the vertices.
    pub(super) vertex: usize,
    pub(super) layout: PlyLayout,
    /// Attributes of the layout that turn with the surface.
    pub(super) following: Following,
    /// Byte of the file at which the vertices begin.
    pub(super) vertices_start: u64,
    /// Bytes at which the elements of a binary file begin, and after them the end of the last one. Empty for
    /// a text file.
    pub(super) starts: Vec<u64>,
    pub(super) offsets: Offsets,
    /// Function that makes the header anew without the properties of the normals.
    pub(super) without_normals: fn(&[u8]) -> Vec<u8>,
    /// Note for the user on the file that is written.
    pub(crate) note: Option<&'static str>,
    /// Returns the content of the file that is not read, in a few words each.
    pub(crate) besides: fn(&PlyModel) -> Result<Vec<String>>,
    /// Extensions that names of such files have.
    pub(crate) extensions: &'static [&'static str],
    /// The coordinate reference system as text.
    pub(super) wkt: Option<String>,
    /// [Remarks](crate::Model::remarks), which are comments.
    pub(super) remarks: Vec<String>,
    pub(crate) info: ModelInfo,
}
