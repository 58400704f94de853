//! The whole file anew: positions, normals and tangents are patched in their rows, and `min` and `max` of
//! positions in the JSON.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, Vec3, Vec4};

use super::container::HEADER;
use super::file::GltfModel;
use super::layout::{VectorRole, VertexRows, VertexSet};
use super::nodes::MeshPose;
use super::reader::{CHUNK_BYTES, floats, rows};
use crate::pipeline::{Piece, PieceVersion, Pieces, Rewritable};
use crate::shared_normal::mean;
use crate::source::SourceFile;
use crate::summary::{PartBox, Summary};
use crate::unfit::Unfit;
use crate::{CHUNK_VERTICES, Edited, Error, Normals, Progress, Result, SMALL_CHUNK, VertexChunk};

/// A model that is rewritten.
pub(super) struct GltfRewriting<'a> {
    pub(super) model: &'a GltfModel,
    /// Number of normals and tangents, in all versions, that keep their bytes since they are shared by meshes
    /// that turn differently.
    kept: AtomicU64,
}

impl<'a> GltfRewriting<'a> {
    pub(super) fn new(model: &'a GltfModel) -> Self {
        Self { model, kept: AtomicU64::new(0) }
    }

    /// Tells the user of content of the file that does not follow the surface, or is written elsewhere.
    pub(super) fn announce(&self, progress: &dyn Progress) {
        let GltfModel { container, layout, is_gathered, had_sparse, .. } = self.model;
        let path = container.source.path().display();
        if *had_sparse {
            progress.note(&format!(
                "{path}: its sparse positions, normals, tangents or indices become plain ones"
            ));
        }
        if *is_gathered {
            progress.note(&format!(
                "{path}: it becomes one GLB file with its buffers; images beside it are not copied, and are looked for beside the GLB"
            ));
        }
        if layout.has_targets {
            progress
                .note(&format!("{path}: its morph targets are displacements, which are kept as they are"));
        }
    }

    /// Notes the number of vectors that were kept.
    pub(super) fn tell(&self, progress: &dyn Progress) {
        let kept = self.kept.load(Ordering::Relaxed);
        if kept > 0 {
            progress.note(&format!(
                "{}: {kept} normals or tangents are kept as they are: meshes share them that turn apart by more than 5\u{b0}",
                self.model.container.source.path().display()
            ));
        }
    }

    /// The region and the first row of a chunk.
    fn place(&self, chunk: &VertexChunk) -> (&'a VertexRows, u64) {
        let [region, row] = chunk.spans.first().copied().unwrap_or_default();
        (&self.model.layout.regions[region as usize], u64::from(row))
    }

    fn owners<'r>(&self, region: &'r VertexRows) -> impl Iterator<Item = &'r VertexSet>
    where
        'a: 'r,
    {
        let sets = &self.model.layout.sets;
        region.owners.iter().map(|owner| &sets[*owner])
    }
}

impl Rewritable for GltfRewriting<'_> {
    fn pieces(&self, normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        let with_normals = normals == Normals::Transform;
        Ok(Box::new(GltfPieces { model: self.model, with_normals, at: 0, region: 0, row: 0 }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        let (region, row) = self.place(chunk);
        let VertexChunk { positions, normals, tangents, raw, .. } = chunk;
        positions.clear();
        normals.clear();
        tangents.clear();
        let count = raw.len().div_ceil(region.stride as usize) as u64;
        let mut apart = Vec::new();
        for set in self.owners(region) {
            if region.has_positions() {
                self.model.add_positions(set, raw, positions);
            } else {
                let of_positions = &self.model.layout.regions[set.region];
                self.model.container.read(&mut apart, of_positions.window(row..row + count))?;
                self.model.add_positions(set, &apart, positions);
            }
            if let Some(offset) = region.offset(VectorRole::Normal) {
                self.model.add_normals(set, raw, (region.stride, offset), normals);
            }
            if let Some(offset) = region.offset(VectorRole::Tangent) {
                self.model.add_tangents(set, raw, (region.stride, offset), tangents);
            }
        }
        Ok(())
    }

    fn encode(&self, chunk: &mut VertexChunk, mut version: PieceVersion<'_>) -> Result<()> {
        let (region, _) = self.place(chunk);
        version.begin_with(&mut chunk.raw);
        let mut patch = ChunkPatch { region, bytes: version.bytes, chunk, edited: version.edited };
        let placements: Vec<Option<MeshPose>> = self.owners(region).map(|set| set.placement).collect();
        let index = chunk.spans.first().map_or(0, |[region, _]| *region as usize);
        for (element, (kind, offset)) in region.elements.iter().enumerate() {
            let is_turned = version.normals == Normals::Transform;
            let has_moved = match kind {
                VectorRole::Position => patch
                    .positions(*offset, placements.first().and_then(Option::as_ref))
                    .map_err(|unfit| unfit.in_floats(&self.model.container.source, chunk.first))?,
                _ if !is_turned => continue,
                kind => {
                    let turned = match kind {
                        VectorRole::Normal => patch.normals(*offset, &placements),
                        _ => patch.tangents(*offset, &placements),
                    };
                    self.kept.fetch_add(turned.kept, Ordering::Relaxed);
                    turned.has_moved
                }
            };
            let part = VertexRows::part(index, element);
            if self.model.limits.has(part) {
                version.summary.parts.push(PartBox { has_moved, ..patch.reach(part, *kind, *offset) });
            }
        }
        Ok(())
    }

    fn make(&self, _before: &Summary, is_still: bool) -> Result<Vec<u8>> {
        let GltfModel { container, limits, .. } = self.model;
        let mut head = Vec::new();
        container.read(&mut head, 0..self.model.head())?;
        let room = if is_still { 0 } else { limits.room() };
        if room == 0 {
            return Ok(head);
        }
        let json_end = container.json.end as usize;
        head.splice(json_end..json_end, std::iter::repeat_n(b' ', room));
        for at in [HEADER as usize - 4, HEADER as usize] {
            let mut four = [0; 4];
            four.copy_from_slice(&head[at..at + 4]);
            let Some(longer) = u32::from_le_bytes(four).checked_add(room as u32) else {
                return Err(Error::degenerate(
                    format!(
                        "{}: {room} bytes more are too many for GLB, which has 4 GiB at most",
                        container.source.path().display()
                    ),
                    "divide the model",
                ));
            };
            head[at..at + 4].copy_from_slice(&longer.to_le_bytes());
        }
        Ok(head)
    }

    fn patches(&self, all: &Summary, is_still: bool) -> Result<Vec<(u64, Vec<u8>)>> {
        let GltfModel { container, limits, .. } = self.model;
        if is_still {
            return Ok(Vec::new());
        }
        let mut json = Vec::new();
        container.read(&mut json, container.json.clone())?;
        let Some((first, mut text)) = limits.corrected(&json, all) else { return Ok(Vec::new()) };
        text.resize(json.len() + limits.room(), b' ');
        Ok(vec![(container.json.start + first as u64, text.split_off(first))])
    }

    fn source(&self) -> &SourceFile {
        &self.model.container.source
    }
}

/// The bytes of a chunk's new version, as they are made.
struct ChunkPatch<'a> {
    region: &'a VertexRows,
    bytes: &'a mut [u8],
    chunk: &'a VertexChunk,
    edited: &'a Edited,
}

/// Result of turning normals or tangents.
#[derive(Default)]
struct TurnedVectors {
    has_moved: bool,
    /// Number of vectors that are kept, as the placements that share them disagree.
    kept: u64,
}

impl ChunkPatch<'_> {
    fn rows(&self, offset: usize, size: usize) -> impl Iterator<Item = usize> + use<> {
        rows(self.region.stride as usize, self.bytes.len(), offset, size)
    }

    /// Moves the positions of a set; whether any of them is elsewhere, or the first one that does not fit.
    fn positions(&mut self, offset: usize, placement: Option<&MeshPose>) -> Result<bool, Unfit> {
        let mut has_moved = false;
        let bits = |p: DVec3| p.to_array().map(f64::to_bits);
        let moved = self.chunk.positions.iter().zip(&self.edited.positions);
        for (vertex, ((old, new), at)) in moved.zip(self.rows(offset, 12)).enumerate() {
            if !old.is_finite() || bits(*old) == bits(*new) {
                continue;
            }
            let mut local = Vec3::from_array(floats(self.bytes, at));
            let there = placement.map_or(*new, |placement| placement.moved(local, *new - *old));
            let rounded = there.as_vec3();
            if let Some(axis) = (0..3).find(|axis| !rounded[*axis].is_finite()) {
                return Err(Unfit { vertex, axis, value: there[axis] });
            }
            has_moved |= rounded != local;
            // A component that stays where it is keeps its bytes, those of -0 among them.
            for axis in 0..3 {
                let is_still = match placement {
                    Some(_) => rounded[axis] == local[axis],
                    None => old[axis].to_bits() == new[axis].to_bits(),
                };
                if !is_still {
                    local[axis] = rounded[axis];
                }
            }
            put(self.bytes, at, &local.to_array());
        }
        Ok(has_moved)
    }

    /// Box of a part's numbers that are in this chunk, as they are now.
    fn reach(&self, part: u32, kind: VectorRole, offset: usize) -> PartBox {
        let mut found = PartBox::empty(part);
        let mut include = |element: Vec4| {
            if element.is_finite() {
                found.min = found.min.min(element);
                found.max = found.max.max(element);
            }
        };
        match kind {
            VectorRole::Tangent => {
                self.rows(offset, 16).for_each(|at| include(Vec4::from_array(floats(self.bytes, at))));
            }
            _ => self
                .rows(offset, 12)
                .for_each(|at| include(Vec3::from_array(floats(self.bytes, at)).extend(0.0))),
        }
        found
    }

    /// Turns normals, at all places that share them.
    fn normals(&mut self, offset: usize, placements: &[Option<MeshPose>]) -> TurnedVectors {
        let (old, new) = (&self.chunk.normals, &self.edited.normals);
        let (mut found, mut turned) = (TurnedVectors::default(), Vec::new());
        let count = self.rows(offset, 12).count();
        for (row, at) in self.rows(offset, 12).enumerate() {
            let local = Vec3::from_array(floats(self.bytes, at));
            turned.clear();
            turned.extend((row..).step_by(count).zip(placements).map(|(i, placement)| match placement {
                _ if same(&old[i].to_array(), &new[i].to_array()) || !self.chunk.positions[i].is_finite() => {
                    local
                }
                None => new[i],
                Some(placement) => placement.normal_back(new[i], local),
            }));
            match mean(local, &turned) {
                Some(new) => {
                    found.has_moved |= new != local;
                    put(self.bytes, at, &new.to_array());
                }
                None => found.kept += 1,
            }
        }
        found
    }

    /// Turns tangents, likewise.
    fn tangents(&mut self, offset: usize, placements: &[Option<MeshPose>]) -> TurnedVectors {
        let (old, new) = (&self.chunk.tangents, self.edited.tangents(self.chunk));
        let (mut found, mut turned) = (TurnedVectors::default(), Vec::new());
        let count = self.rows(offset, 16).count();
        for (row, at) in self.rows(offset, 16).enumerate() {
            let local = Vec4::from_array(floats(self.bytes, at));
            let mut sides = [false; 2];
            turned.clear();
            turned.extend((row..).step_by(count).zip(placements).map(|(i, placement)| {
                if same(&old[i].to_array(), &new[i].to_array()) || !self.chunk.positions[i].is_finite() {
                    sides[0] = true;
                    return local.truncate();
                }
                sides[usize::from(old[i].w != new[i].w)] = true;
                let direction = new[i].truncate();
                placement.as_ref().map_or(direction, |p| p.tangent_back(direction, local.truncate()))
            }));
            match mean(local.truncate(), &turned).filter(|_| sides != [true; 2]) {
                Some(new) => {
                    let side = if sides[1] { -local.w } else { local.w };
                    let new = new.extend(side);
                    found.has_moved |= new != local;
                    put(self.bytes, at, &new.to_array());
                }
                None => found.kept += 1,
            }
        }
        found
    }
}

fn same(a: &[f32], b: &[f32]) -> bool {
    a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits()))
}

fn put(bytes: &mut [u8], at: usize, floats: &[f32]) {
    for (bytes, float) in bytes[at..].chunks_exact_mut(4).zip(floats) {
        bytes.copy_from_slice(&float.to_le_bytes());
    }
}

impl GltfModel {
    /// Byte at which the header and the JSON end, with the header of the binary data.
    fn head(&self) -> u64 {
        self.container.json.end.max(self.container.bin.start)
    }
}

/// The file in its order: header and JSON, regions, and what is between them.
struct GltfPieces<'a> {
    model: &'a GltfModel,
    /// Whether normals and tangents that stand apart from the positions are turned.
    with_normals: bool,
    at: u64,
    /// Region that comes next, and the row of it.
    region: usize,
    row: u64,
}

impl Pieces for GltfPieces<'_> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let GltfModel { container, layout, .. } = self.model;
        chunk.spans.clear();
        if self.at == 0 {
            self.at = self.model.head();
            container.read(&mut chunk.raw, 0..self.at)?;
            return Ok(Piece::Made);
        }
        let is_patched = |region: &VertexRows| self.with_normals || region.has_positions();
        while layout.regions.get(self.region).is_some_and(|region| !is_patched(region)) {
            self.region += 1;
        }
        let region = layout.regions.get(self.region);
        let next = region.map_or(container.len(), |region| region.bytes.start);
        if self.at < next {
            chunk.raw.clear();
            let wanted = (next - self.at).min(CHUNK_BYTES) as usize;
            self.at += container.append_at(&mut chunk.raw, self.at, wanted)? as u64;
            return Ok(Piece::Bytes);
        }
        let Some(region) = region else {
            container.check_unchanged()?;
            return Ok(Piece::End);
        };
        chunk.of_normals = !region.has_positions();
        let most = GltfModel::most_rows(region.stride);
        // A row of normals is of a vertex of each owner.
        let of_owners = |chunk: usize| (chunk / region.owners.len().max(1)).max(1) as u64;
        let most = most.min(of_owners(if chunk.of_normals { SMALL_CHUNK } else { CHUNK_VERTICES }));
        let rows = self.row..(self.row + most).min(region.rows);
        let window = region.window(rows.clone());
        self.at = window.end;
        chunk.spans.push([self.region as u32, rows.start as u32]);
        chunk.first = region.owners.first().map_or(0, |set| layout.sets[*set].first) + rows.start;
        container.read(&mut chunk.raw, window)?;
        let count = rows.end - rows.start;
        self.row = rows.end;
        if self.row == region.rows {
            (self.region, self.row) = (self.region + 1, 0);
        }
        Ok(if chunk.of_normals { Piece::Normals } else { Piece::Vertices(count as usize) })
    }
}
