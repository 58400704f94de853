//! E57 (ASTM E2807): scans with poses, in compressed vectors of points with any fields.
//!
//! The vertices are the points of all scans, in the order of the file and in the frame that they share. The
//! bits of positions (and normals) are patched in the packets that hold them, page by page, with new
//! checksums; everything else is copied byte by byte, but for what the XML says of how far points reach,
//! which is corrected where it changes.
//!
//! | module | |
//! |---|---|
//! | `file` | what is known of a file once it is open |
//! | `pages` | pages with checksums, and the logical bytes that they hold |
//! | `header` | the header; `description` the XML: scans, fields, poses, bounds |
//! | `fields` | numbers in and out of bits; `pose` the frames of scans, and spherical coordinates |
//! | `packets` | where the streams of a scan's fields are; `streams` what some points have of them |
//! | `scan` | positions and normals in and out of a point's fields |
//! | `reader` | chunks of vertices from anywhere in the file |
//! | `rewrite` | the whole file anew; `pieces` cuts it into pieces, `ending` is what is known last |

mod description;
mod ending;
mod fields;
mod file;
mod header;
mod packets;
mod pages;
mod pieces;
mod pose;
mod reader;
mod rewrite;
mod scan;
mod streams;

use std::ops::Range;
use std::path::Path;

use file::E57Model;
use glam::DVec3;
use reader::E57Reader;

use crate::follow::{Follow, Following};
use crate::source::SourceFile;
use crate::{
    Edit, Model, ModelInfo, Output, Progress, Result, Rewriting, VertexChunk, VertexReader, pipeline, wkt,
};

/// Whether a file with these first bytes is E57.
pub(super) fn is_e57(start: &[u8]) -> bool {
    start.starts_with(header::MAGIC)
}

/// # Errors
/// The file cannot be read, or is not what E57 files are.
pub(super) fn open(source: SourceFile) -> Result<Box<dyn Model>> {
    Ok(Box::new(E57Model::new(source)?))
}

impl Model for E57Model {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["e57"]
    }

    fn details(&self) -> Vec<String> {
        let mut details = self.describe_scans();
        details.extend(self.wkt.as_deref().and_then(wkt::line_of_units));
        details
    }

    fn wkt(&self) -> Option<String> {
        self.wkt.clone()
    }

    fn intensity_limits(&self) -> Option<[f64; 2]> {
        self.intensities()
    }

    fn besides(&self) -> Result<Vec<String>> {
        Ok(self.describe_besides())
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(E57Reader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        self.attributes_of(chunk, to);
        Ok(())
    }

    fn has_room_for(&self, p: DVec3) -> bool {
        self.scans.iter().any(|scan| scan.has_room_for(p))
    }

    fn make_room(&mut self, moves: &[[DVec3; 2]], margin: f64) -> Result<Option<String>> {
        self.choose_ranges(moves, margin)
    }

    fn following(&self) -> Option<&Following> {
        (!self.following.is_empty()).then_some(&self.following)
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.following = Following::declared(follow, &self.info.attributes, self.source.path())?;
        self.note_what_follows();
        Ok(())
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.following.check(self.source.path())?;
        self.tell_of_groups(progress);
        pipeline::rewrite(self, outputs, how, edit, progress)?;
        self.following.tell(self.source.path(), progress);
        Ok(())
    }
}
