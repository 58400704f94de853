//! Reads consecutive vertices, a chunk at a time, from any vertex on; no chunk has vertices of two scans.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::file::E57Model;
use super::pages::PageWindow;
use super::scan::{NUMBER, Scan};
use super::streams::Streams;
use crate::{CHUNK_VERTICES, Result, VertexChunk, VertexReader};

/// Pages that are read at a time.
const AHEAD: u64 = 256;

/// A chunk ends with the vertex that reaches this many bytes, however few vertices that are.
const CHUNK_BYTES: usize = 4 << 20;

/// Reads the vertices of a range.
pub(super) struct E57Reader<'a> {
    model: &'a E57Model,
    /// The vertices that are still to be read.
    range: Range<u64>,
    /// Most vertices of a chunk.
    chunk: usize,
    skips_attributes: bool,
    window: PageWindow<'a>,
    rows: Vec<u64>,
}

impl<'a> E57Reader<'a> {
    pub fn new(model: &'a E57Model, range: Range<u64>) -> Self {
        let end = range.end.min(model.info.vertices);
        Self {
            model,
            range: range.start.min(end)..end,
            chunk: CHUNK_VERTICES,
            skips_attributes: false,
            window: PageWindow::new(&model.source, AHEAD),
            rows: Vec::new(),
        }
    }
}

impl VertexReader for E57Reader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES);
    }

    fn skip_attributes(&mut self) {
        self.skips_attributes = true;
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let model = self.model;
        chunk.first = self.range.start;
        chunk.positions.clear();
        chunk.normals.clear();
        chunk.raw.clear();
        chunk.pages.clear();
        let Some(scan) = model.scans.get(model.scan_of(self.range.start)).filter(|_| !self.range.is_empty())
        else {
            chunk.of_format.clear();
            return Ok(false);
        };
        let fields: Vec<usize> = if self.skips_attributes {
            scan.row.clone()
        } else {
            let all = 0..scan.described.fields.len();
            all.filter(|field| scan.described.fields[*field].is_number()).collect()
        };
        let bits: usize = fields.iter().map(|field| scan.described.fields[*field].bits() as usize).sum();
        let most = (8 * CHUNK_BYTES / bits.max(1)).clamp(1, self.chunk) as u64;
        let end = self.range.end.min(scan.vertices().end).min(self.range.start + most);
        let points = self.range.start - scan.first..end - scan.first;
        let mut streams = chunk.take_of_format::<Streams>();
        streams.read(model.walk(scan, &mut self.window), scan, points.clone(), &fields)?;
        self.rows.clear();
        streams.rows(&scan.row, points, &mut self.rows);
        chunk.of_format.push(streams);
        chunk.raw.extend(self.rows.iter().flat_map(|number| number.to_le_bytes()));
        decode(scan, &self.rows, model.info.has_normals, chunk);
        self.range.start = end;
        Ok(true)
    }
}

/// Appends the positions and normals of rows.
pub(super) fn decode(scan: &Scan, rows: &[u64], normals: bool, chunk: &mut VertexChunk) {
    let (positions, of_normals) = decoded(scan, rows, normals);
    chunk.positions.extend(positions);
    chunk.normals.extend(of_normals);
}

/// The positions and normals of rows.
pub(super) fn decoded<'a>(
    scan: &'a Scan,
    rows: &'a [u64],
    normals: bool,
) -> (impl Iterator<Item = DVec3> + 'a, impl Iterator<Item = Vec3> + 'a) {
    let rows = rows.chunks_exact(scan.row.len().max(1));
    let of_normals = if normals { Some(rows.clone().map(|row| scan.normal(row))) } else { None };
    (rows.map(|row| scan.position(row)), of_normals.into_iter().flatten())
}

/// The numbers of rows that are kept as bytes.
pub(super) fn numbers(bytes: &[u8]) -> impl Iterator<Item = u64> + '_ {
    bytes.chunks_exact(NUMBER).map(|eight| u64::from_le_bytes(super::header::bytes_at(eight, 0)))
}

impl E57Model {
    /// The numbers of the first attributes of a chunk that was read, or of several that were joined.
    pub(super) fn attributes_of(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) {
        to.iter_mut().for_each(Vec::clear);
        let mut vertex = chunk.first_of_file();
        for streams in chunk.of_format.iter().filter_map(|of| of.downcast_ref::<Streams>()) {
            let number = self.scan_of(vertex);
            let (Some(scan), Some(places)) = (self.scans.get(number), self.attributes.get(number)) else {
                return;
            };
            let count = (streams.points.end - streams.points.start) as usize;
            vertex += count as u64;
            for (number, values) in to.iter_mut().enumerate() {
                match places.binary_search_by_key(&number, |(attribute, _)| *attribute) {
                    Ok(place) => {
                        let place = places[place].1;
                        let field = &scan.described.fields[place];
                        values.extend((0..count).map(|index| field.value(streams.get(place, index))));
                    }
                    // The scan does not have it.
                    Err(_) => values.extend(std::iter::repeat_n(f64::NAN, count)),
                }
            }
        }
    }
}
