//! A LAS file once it is open.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use super::attributes::AttributeFields;
use super::blocks::LasBlocks;
use super::header::{CUT_OFF, DAMAGED, LasHeader};
use super::kept::KeptFields;
use super::laszip::Laszip;
use super::points;
use super::vlrs::{KeptVlrs, VlrKind};
use crate::follow::Following;
use crate::source::SourceFile;
use crate::{Attribute, Colors, ModelInfo, Result, Scalar, ScaledIntegers, VertexChunk};

/// Most bytes of the record that describes extra bytes: as many as can be in a record of a point.
const MOST_DESCRIPTIONS: u64 = 192 << 16;

/// A LAS or LAZ file.
#[derive(Debug)]
pub struct LasModel {
    pub(super) source: SourceFile,
    pub(super) header: LasHeader,
    pub(super) records: KeptVlrs,
    pub(super) places: AttributeFields,
    /// Attributes that turn with the surface.
    pub(super) following: Following,
    /// Compression and blocks of the points, if they are compressed.
    pub(super) compressed: Option<(Laszip, LasBlocks)>,
    pub(super) info: ModelInfo,
    /// Number of steps by which the offset in the new file differs.
    pub(super) shift: [i64; 3],
    /// Positions and colours of compressed points that were read, as long as these points are [read
    /// again](crate::Model::keep_positions).
    pub(super) kept: Mutex<Option<Arc<KeptFields>>>,
}

impl LasModel {
    /// Opens the file `source`. A file that is cut off is noticed here.
    ///
    /// # Errors
    /// The file cannot be read, is not LAS of a known version, is cut off, or has blocks of compressed points
    /// that are too large to be held.
    pub(crate) fn new(source: SourceFile) -> Result<Self> {
        let header = LasHeader::read(&source)?;
        let records = KeptVlrs::read(&source, &header)?;
        let extra = records.content(&source, VlrKind::ExtraBytes, MOST_DESCRIPTIONS)?.unwrap_or_default();
        let places = AttributeFields::new(&header, &extra);
        let following = Following::recognised(&places.attributes);
        let compressed = compression(&source, &header, &records)?;
        let vertex_bytes = match &compressed {
            Some((_, blocks)) => blocks.bytes(),
            None => check_room(&source, &header)?,
        };
        let of_copc = if records.of_copc().next().is_some() { ", COPC" } else { "" };
        let how = if header.is_compressed { format!(", LAZ{of_copc}") } else { String::new() };
        let described = |a: &Attribute| format!("{} {}", a.kind.name(), a.name);
        let info = ModelInfo {
            format: format!("LAS 1.{}, point format {}{how}", header.minor, header.format),
            vertices: header.count,
            position_type: Scalar::F64,
            other_properties: places.attributes.iter().map(described).collect(),
            attributes: places.attributes.clone(),
            bytes: source.len(),
            block_vertices: compressed.as_ref().map_or(1, |(_, blocks)| blocks.most_vertices().max(2)),
            vertex_bytes,
            integers: Some(header.integers),
            written: Some(header.integers),
            step: header.integers.scale.abs(),
            crs: records.crs(&source)?,
            ..ModelInfo::default()
        };
        Ok(Self {
            source,
            header,
            records,
            places,
            following,
            compressed,
            info,
            shift: [0; 3],
            kept: Mutex::default(),
        })
    }

    /// Scale and offset of the positions in the file that is written.
    pub(super) fn written(&self) -> &ScaledIntegers {
        self.info.written.as_ref().unwrap_or(&self.header.integers)
    }

    /// The bytes of a record that positions and colours take.
    pub(super) fn parts(&self) -> Vec<Range<usize>> {
        let colors = Colors::from_info(&self.info).into_iter().flat_map(|colors| colors.places);
        let of_colors = colors.map(|place| self.places.bytes_of(place));
        std::iter::once(0..points::BYTES).chain(of_colors).collect()
    }

    pub(super) fn kept(&self) -> Option<Arc<KeptFields>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The records of a chunk's vertices.
    pub(super) fn records_of<'a>(&self, chunk: &'a VertexChunk) -> &'a [u8] {
        if self.compressed.is_some() { &chunk.records } else { &chunk.raw }
    }
}

/// Compression of the points, and their blocks; none if they are not compressed.
fn compression(
    source: &SourceFile,
    header: &LasHeader,
    records: &KeptVlrs,
) -> Result<Option<(Laszip, LasBlocks)>> {
    if !header.is_compressed {
        return Ok(None);
    }
    let Some(vlr) = records.content(source, VlrKind::Laszip, u64::from(u16::MAX))? else {
        let what = "the points are compressed, but nothing says how (the VLR \"laszip encoded\" is missing)";
        return Err(source.malformed(what, DAMAGED));
    };
    let laszip = Laszip::new(&vlr, header).map_err(|what| {
        let hint = "write the model with another program first, as `pdal translate IN.laz OUT.las`";
        source.malformed(format!("the VLR \"laszip encoded\" cannot be used: {what}"), hint)
    })?;
    let blocks = LasBlocks::read(source, header, &laszip)?;
    Ok(Some((laszip, blocks)))
}

/// Bytes of points that are not compressed, all of which are there.
fn check_room(source: &SourceFile, header: &LasHeader) -> Result<u64> {
    let needed = header.count.checked_mul(header.record as u64);
    let left = source.len() - header.points;
    needed.filter(|needed| *needed <= left).ok_or_else(|| {
        let LasHeader { count, record, .. } = header;
        let what =
            format!("says {count} points of {record} bytes each, but only {left} bytes are left for them");
        source.malformed(what, CUT_OFF)
    })
}
