//! LAS 1.0 to 1.4, and LAZ, which is LAS with compressed points, COPC among it: all point formats, with any
//! extra bytes.
//!
//! The vertices are the points. Their positions are integers, which are patched in the records; everything else
//! is copied byte by byte, but for what says where other things are or how far the points reach, which is
//! corrected where it changes. A block of compressed points in which nothing moves is copied as it is.
//!
//! | module | |
//! |---|---|
//! | `file` | what is known of a file once it is open |
//! | `header` | the header; `vlrs` the records around the points, of which few matter |
//! | `points` | positions in and out of records; `attributes` the other numbers |
//! | `laszip` | a block of compressed points, in and out; `blocks` where they are |
//! | `reader` | chunks of vertices from anywhere in the file |
//! | `rewrite` | the whole file anew |

mod attributes;
mod blocks;
mod file;
mod header;
mod laszip;
mod points;
mod reader;
mod rewrite;
mod vlrs;

use std::ops::Range;
use std::path::Path;

pub(super) use file::LasModel;
use glam::DVec3;
use reader::Reader;

use crate::model::NoFaces;
use crate::{
    Edit, FaceReader, Model, ModelInfo, Output, Progress, Result, Rewriting, ScaledIntegers, VertexChunk,
    VertexReader, pipeline,
};

/// Whether a file that begins so is LAS.
pub(super) fn is_las(start: &[u8]) -> bool {
    start.starts_with(header::MAGIC)
}

impl Model for LasModel {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        if self.compressed.is_some() { &["laz"] } else { &["las"] }
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(Reader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        self.places.decode(self.records_of(chunk), self.header.record, to);
        Ok(())
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(NoFaces))
    }

    fn faces_at(&self, _ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(NoFaces))
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn move_offset(&mut self, steps: [i64; 3]) -> Result<()> {
        let ScaledIntegers { scale, offset } = self.header.integers;
        let moved = DVec3::from(steps.map(|n| n as f64)) * scale + offset;
        self.info.written = Some(ScaledIntegers { scale, offset: moved });
        self.shift = steps;
        Ok(())
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        if self.records.of_copc().next().is_some() {
            let path = self.path().display();
            progress.note(&format!(
                "{path}: the octree of COPC is left out, as it does not fit what is deformed; the output is LAZ, \
                 of which `pdal translate OUT.laz OUT.copc.laz` makes COPC again"
            ));
        }
        pipeline::rewrite(self, outputs, how, edit, progress)
    }
}
