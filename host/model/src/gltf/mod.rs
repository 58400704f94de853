//! glTF 2.0: GLB, and `.gltf` with its buffers, which is written as GLB.
//!
//! The vertices are the positions of all meshes that nodes show, in the world's coordinates: a node's matrix
//! is done before, and undone after. They are patched in their bytes with their normals and tangents,
//! wherever accessors say that these are, and so are `min` and `max` of positions, in the JSON. Everything
//! else is copied byte by byte.
//!
//! | module | |
//! |---|---|
//! | `container` | the bytes of GLB, or of a `.gltf` as if it were one |
//! | `json` | what of the JSON is read; `sparse` accessors made plain |
//! | `places` | where accessors are; `nodes` where nodes are in the world |
//! | `layout` | which bytes are of vertices; `limits` which text is of `min` and `max` |
//! | `file` | what is known of a file once it is open |
//! | `reader` | chunks of vertices from anywhere in the file; `faces` triangles |
//! | `rewrite` | the whole file anew |

mod container;
mod faces;
mod file;
mod json;
mod layout;
mod limits;
mod nodes;
mod places;
mod reader;
mod rewrite;
mod sparse;

use std::ops::Range;
use std::path::Path;

use faces::GltfFaces;
use file::GltfModel;
use reader::GltfReader;

use crate::cache::Making;
use crate::source::SourceFile;
use crate::{
    Edit, FaceReader, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting, VertexChunk,
    VertexReader, pipeline,
};

/// Whether a file with these first bytes is GLB.
pub(super) fn is_glb(start: &[u8]) -> bool {
    start.starts_with(container::MAGIC)
}

/// Whether a file is a `.gltf`, as far as its beginning tells: JSON that speaks of the asset.
pub(super) fn is_gltf(source: &SourceFile) -> Result<bool> {
    const START: usize = 4096;
    let mut start = Vec::new();
    source.append_at(&mut start, 0, START)?;
    let is_object = start.trim_ascii_start().starts_with(b"{");
    Ok(is_object && memchr::memmem::find(&start, b"\"asset\"").is_some())
}

/// Opens a file.
pub(super) fn open(source: SourceFile, making: &Making<'_>) -> Result<Box<dyn Model>> {
    Ok(Box::new(GltfModel::new(source, making)?))
}

impl Model for GltfModel {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.container.source.path()
    }

    fn other_files(&self) -> Vec<&Path> {
        self.container.others().collect()
    }

    fn besides(&self) -> Result<Vec<String>> {
        self.not_read()
    }

    fn extensions(&self) -> &'static [&'static str] {
        // Files that are written are GLB, whatever the extension of the source.
        &["glb"]
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(GltfReader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        let first = chunk.first_of_file();
        self.read_colours(first..first + chunk.len() as u64, to)
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(GltfFaces::new(self)))
    }

    fn faces_at(&self, ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(GltfFaces::between(self, ranges)))
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.container.check_unchanged()
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        if how.normals == Normals::Drop && self.info.has_normals {
            return Err(self.container.source.keeps_normals("keep or transform them: --normals keep"));
        }
        let rewriting = rewrite::GltfRewriting::new(self);
        rewriting.announce(progress);
        pipeline::rewrite(&rewriting, outputs, how, edit, progress)?;
        rewriting.tell(progress);
        Ok(())
    }
}
