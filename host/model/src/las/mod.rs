//! LAS 1.0 to 1.4, and LAZ, which is LAS with compressed points, COPC among it: all point formats, with any
//! extra bytes.
//!
//! The vertices are the points. Their positions are integers, which are patched in the records; everything
//! else is copied byte by byte, but for places of other content and limits of the points, which are corrected
//! where they change. A block of compressed points in which nothing moves is copied as it is.
//!
//! | module | |
//! |---|---|
//! | `file` | what is known of a file once it is open |
//! | `header` | the header; `vlrs` the records around the points, of which few matter |
//! | `points` | positions in and out of records; `attributes` the other numbers, `remarks` what is said of them |
//! | `laszip` | a block of compressed points, in and out; `blocks` where they are; `kept` what was found in them |
//! | `reader` | chunks of vertices from anywhere in the file |
//! | `rewrite` | the whole file anew, `turning` what of its extra bytes turns; `form` one made of another format, and
//! | | `same_records` the same points compressed, or not |

mod attributes;
mod blocks;
mod file;
pub(crate) mod form;
mod header;
mod kept;
mod laszip;
mod points;
mod reader;
pub(crate) mod remarks;
mod rewrite;
pub(crate) mod same_records;
mod turning;
mod vlrs;

use std::any::Any;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, PoisonError};

pub(super) use file::LasModel;
use glam::DVec3;
use kept::KeptFields;
use reader::LasReader;
use remarks::ExtraBytesRemark;
use vlrs::VlrKind;

use crate::bounds::Bounds;
use crate::follow::{Follow, Following};
use crate::form::counted;
use crate::pipeline::Rewritable;
use crate::{
    Division, Edit, Error, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting, ScaledIntegers,
    VertexChunk, VertexReader, pipeline,
};

/// Whether a file with these first bytes is LAS.
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

    fn as_any(&self) -> Option<&dyn Any> {
        Some(self)
    }

    fn details(&self) -> Vec<String> {
        // A record that cannot be read tells no unit.
        let unit = self.records.unit(&self.source).ok().flatten();
        unit.into_iter().map(|unit| format!("unit: {unit}")).collect()
    }

    fn wkt(&self) -> Option<String> {
        self.records.wkt(&self.source).ok().flatten()
    }

    fn remarks(&self) -> Vec<String> {
        let has_time = self.places.attributes.iter().any(|attribute| attribute.name == "gps_time");
        let of_time = (has_time && self.header.has_adjusted_time).then(|| remarks::GPS_TIME.to_owned());
        of_time.into_iter().chain(self.places.remarks.iter().map(ExtraBytesRemark::line)).collect()
    }

    fn besides(&self) -> Result<Vec<String>> {
        let mut besides = Vec::new();
        let records = u64::from(self.header.vlrs) + self.header.evlrs.map_or(0, |(_, n)| u64::from(n));
        // A text without a name is lost without a note.
        let has_wkt = self.wkt().is_some_and(|text| crate::wkt::name(&text).is_some());
        let known = [VlrKind::Laszip, VlrKind::ExtraBytes, VlrKind::Wkt];
        let known = known.iter().filter(|kind| **kind != VlrKind::Wkt || has_wkt);
        let known = known.filter(|kind| self.records.find(**kind).is_some());
        let others = records - (known.count() + self.records.of_copc().count()) as u64;
        if others > 0 {
            let crs = self.info.crs.as_ref().filter(|_| !has_wkt);
            let crs = crs
                .map_or(String::new(), |crs| format!(", the coordinate reference system {crs} among them"));
            besides.push(counted(others, "variable length record") + &crs);
        }
        if matches!(self.header.format, 4 | 5 | 9 | 10) {
            besides.push("waveforms".to_owned());
        }
        match self.places.undescribed(self.header.record) {
            0 => {}
            n => besides.push(format!("{n} extra bytes of each point that are no single numbers")),
        }
        for name in self.places.of_64_bits() {
            besides.push(format!("digits of the attribute {name}, which has whole numbers of 64 bits"));
        }
        Ok(besides)
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(LasReader::new(self, range)))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        self.places.decode(self.records_of(chunk), self.header.record, to);
        Ok(())
    }

    fn some_attributes(&self, chunk: &VertexChunk, places: &[usize], to: &mut [Vec<f64>]) -> Result<()> {
        self.places.decode_some(self.records_of(chunk), self.header.record, places, to);
        Ok(())
    }

    fn bytes_before(&self, vertex: u64) -> [u64; 2] {
        let Some((_, blocks)) = &self.compressed else {
            return [vertex * self.header.record as u64; 2];
        };
        let [first, block] = [blocks.start(0).1, blocks.of_vertex(vertex) as u64];
        let at = |block: usize| blocks.start(block.min(blocks.len()));
        let (begin, own) = at(block as usize);
        let next = if begin >= vertex { own } else { at(block as usize + 1).1 };
        [own - first, next - first]
    }

    fn keep_positions(&self, folder: Option<&Path>) {
        // Layers that are not asked for are not decompressed.
        let blocks =
            self.compressed.as_ref().filter(|(laszip, _)| !laszip.is_layered).map(|(_, blocks)| blocks);
        let kept = folder
            .zip(blocks)
            .and_then(|(folder, blocks)| KeptFields::new(folder, blocks, self.parts(), self.header.record));
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = kept.map(Arc::new);
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        self.source.check_unchanged()
    }

    fn told_bounds(&self) -> Option<Bounds> {
        self.header.told
    }

    fn make_room(&mut self, moves: &[[DVec3; 2]], margin: f64) -> Result<Option<String>> {
        let integers = self.header.integers;
        let bounds = Bounds::from_points(moves.iter().map(|[_, to]| *to));
        let steps = integers.steps_to(&bounds, margin).map_err(|axis| {
            let what = format!(
                "the deformed samples span {} along {}, which has no room in integers of 32 bits at the scale {} of {}",
                (bounds.max - bounds.min)[axis],
                ["x", "y", "z"][axis],
                integers.scale[axis],
                self.path().display()
            );
            let hint = "write one version after the other, where there are several, or the model with a coarser scale first, \
                        as `pdal translate IN.las OUT.las --writers.las.scale_x=0.01` (and _y, _z) does";
            Error::degenerate(what, hint)
        })?;
        let Some(steps) = steps else { return Ok(None) };
        let ScaledIntegers { scale, offset } = integers;
        let offset = DVec3::from(steps.map(|n| n as f64)) * scale + offset;
        self.info.written = Some(ScaledIntegers { scale, offset });
        self.shift = steps;
        let DVec3 { x, y, z } = offset;
        Ok(Some(format!(
            "the offset of the positions becomes ({x}, {y}, {z}); all their integers are written anew"
        )))
    }

    fn following(&self) -> Option<&Following> {
        (!self.following.is_empty()).then_some(&self.following)
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        let following = Following::declared(follow, &self.places.attributes, self.source.path())?;
        if let Some(place) = following.places().iter().find(|place| !self.places.is_writable(**place)) {
            let name = &self.places.attributes[*place].name;
            let what = format!(
                "{}: {name} is a whole number of 64 bits, and vectors that turn have to be float, double or scaled",
                self.source.path().display()
            );
            return Err(Error::argument(what, "leave it out"));
        }
        self.following = following;
        Ok(())
    }

    fn division(&self, normals: Normals) -> Option<Division> {
        Rewritable::division(self, normals)
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.following.check(self.source.path())?;
        self.tell_of_octree(progress);
        self.tell_of_waveforms(progress);
        pipeline::rewrite(self, outputs, how, edit, progress)?;
        self.following.tell(self.source.path(), progress);
        Ok(())
    }
}

impl LasModel {
    /// Tells the user that waveforms are in a file of their own, if they are.
    pub(crate) fn tell_of_waveforms(&self, progress: &dyn Progress) {
        if self.header.has_waveforms_beside {
            progress.note(&format!(
                "{}: its waveforms are in {}, which is not copied: put a copy beside what is written, with the name of that and \
                 the extension wdp",
                self.source.path().display(),
                self.source.path().with_extension("wdp").display()
            ));
        }
    }

    /// Notes that the new file has no octree, if this one is COPC.
    pub(crate) fn tell_of_octree(&self, progress: &dyn Progress) {
        if self.records.of_copc().next().is_some() {
            progress.note(&format!(
                "{}: the octree of COPC is left out, as it does not fit what is written; of LAZ, \
                 `pdal translate OUT.laz OUT.copc.laz` makes COPC again",
                self.path().display()
            ));
        }
    }
}
