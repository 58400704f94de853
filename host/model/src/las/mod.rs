//! LAS 1.0 to 1.4, and LAZ, which is LAS with compressed points, COPC among it: all point formats, with any
//! extra bytes.
//!
//! The vertices are the points. Their positions are integers, which are patched in the records; everything else
//! is copied byte by byte, but for what says where other things are or how far the points reach, which is
//! corrected where it changes. A block of compressed points in which nothing moves is copied as it is.
//!
//! | module | |
//! |---|---|
//! | `header` | the header; `vlrs` the records around the points, of which few matter |
//! | `points` | positions in and out of records; `attributes` the other numbers |
//! | `laszip` | a block of compressed points, in and out; `blocks` where they are |
//! | `reader` | chunks of vertices from anywhere in the file |
//! | `rewrite` | the whole file anew |

mod attributes;
mod blocks;
mod header;
mod laszip;
mod points;
mod reader;
mod rewrite;
mod vlrs;

use std::ops::Range;
use std::path::Path;

use attributes::Places;
use blocks::Blocks;
use glam::DVec3;
use header::Header;
use laszip::Laszip;
use reader::Reader;
use vlrs::{Kind, Records};

use crate::source::Source;
use crate::{
    Edit, FaceChunk, FaceReader, Model, ModelInfo, Output, Progress, Result, Rewriting, Scalar,
    ScaledIntegers, VertexChunk, VertexReader, pipeline,
};

/// Hint for everything that no correct program writes.
const DAMAGED: &str = "the file is damaged: copy or export it again";

/// Hint where something is missing.
const CUT_OFF: &str = "the file is cut off, or its header lies: copy or export it again";

/// Most bytes of the record that describes extra bytes: as many as can be in a record of a point.
const MOST_DESCRIPTIONS: u64 = 192 << 16;

/// Whether a file that begins so is LAS.
pub(super) fn is_las(start: &[u8]) -> bool {
    start.starts_with(header::MAGIC)
}

/// A LAS or LAZ file.
#[derive(Debug)]
pub struct LasModel {
    source: Source,
    header: Header,
    records: Records,
    places: Places,
    /// Where the points are compressed.
    compressed: Option<(Laszip, Blocks)>,
    info: ModelInfo,
    /// By how many steps the offset of what is written is another one.
    shift: [i64; 3],
}

impl LasModel {
    /// What the file `source` is. One that is cut off is noticed here.
    ///
    /// # Errors
    /// The file cannot be read, is not LAS of a known version, is cut off, or has blocks of compressed points
    /// that are too large to be held.
    pub(super) fn new(source: Source) -> Result<Self> {
        let header = Header::read(&source)?;
        let records = Records::read(&source, &header)?;
        let extra = records.content(&source, Kind::ExtraBytes, MOST_DESCRIPTIONS)?.unwrap_or_default();
        let places = Places::new(&header, &extra);
        let compressed = compression(&source, &header, &records)?;
        let vertex_bytes = match &compressed {
            Some((_, blocks)) => blocks.bytes(),
            None => check_room(&source, &header)?,
        };
        let of_copc = if records.of_copc().next().is_some() { ", COPC" } else { "" };
        let how = if header.is_compressed { format!(", LAZ{of_copc}") } else { String::new() };
        let described = |a: &crate::Attribute| format!("{} {}", a.kind.name(), a.name);
        let info = ModelInfo {
            format: format!("LAS 1.{}, point format {}{how}", header.minor, header.format),
            vertices: header.count,
            faces: 0,
            has_normals: false,
            position_type: Scalar::F64,
            other_properties: places.attributes.iter().map(described).collect(),
            attributes: places.attributes.clone(),
            bytes: source.len(),
            random_access: true,
            vertex_bytes,
            face_bytes: 0,
            integers: Some(header.integers),
            written: Some(header.integers),
            crs: records.crs(&source)?,
        };
        Ok(Self { source, header, records, places, compressed, info, shift: [0; 3] })
    }

    /// How positions are stored in what is written.
    fn written(&self) -> &ScaledIntegers {
        self.info.written.as_ref().unwrap_or(&self.header.integers)
    }

    /// The records of a chunk's vertices.
    fn records_of<'a>(&self, chunk: &'a VertexChunk) -> &'a [u8] {
        if self.compressed.is_some() { &chunk.records } else { &chunk.raw }
    }
}

/// How the points are compressed, and where.
fn compression(source: &Source, header: &Header, records: &Records) -> Result<Option<(Laszip, Blocks)>> {
    if !header.is_compressed {
        return Ok(None);
    }
    let Some(vlr) = records.content(source, Kind::Laszip, u64::from(u16::MAX))? else {
        let what = "the points are compressed, but nothing says how (the VLR \"laszip encoded\" is missing)";
        return Err(source.malformed(what, DAMAGED));
    };
    let laszip = Laszip::new(&vlr, header).map_err(|what| {
        let hint = "write the model with another program first, as `pdal translate IN.laz OUT.las`";
        source.malformed(format!("the VLR \"laszip encoded\" cannot be used: {what}"), hint)
    })?;
    let blocks = Blocks::read(source, header, &laszip)?;
    Ok(Some((laszip, blocks)))
}

/// Bytes of points that are not compressed, all of which are there.
fn check_room(source: &Source, header: &Header) -> Result<u64> {
    let needed = header.count.checked_mul(header.record as u64);
    let left = source.len() - header.points;
    needed.filter(|needed| *needed <= left).ok_or_else(|| {
        let Header { count, record, .. } = header;
        let what =
            format!("says {count} points of {record} bytes each, but only {left} bytes are left for them");
        source.malformed(what, CUT_OFF)
    })
}

impl Model for LasModel {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
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

/// A cloud's.
struct NoFaces;

impl FaceReader for NoFaces {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        chunk.triangles.clear();
        chunk.marks.clear();
        chunk.bytes = 0;
        Ok(false)
    }
}
