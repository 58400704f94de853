//! The triangles of P_S after a refinement: those that were there, but for those of split clusters, whose
//! faces are reindexed anew.

use std::ops::Range;
use std::path::Path;

use bytemuck::cast_slice;
use glam::Vec3;
use simod_model::mapped::{Map, looked_at};
use simod_model::scratch::Scratch;
use simod_model::{FaceChunk, Model, Progress, Result, for_faces, for_faces_at};

use super::appending::Appended;
use super::gathering::GatheredCell;
use super::regrowing::Regrown;
use crate::sampling::kept_cells::{KeptCell, KeptCells};
use crate::sampling::placement::Planes;
use crate::sampling::ranges::joined;
use crate::sampling::triangles::{all_three, first_least, once_each};

const ADVICE: &str = "sample the model with --skip triangles, which need it";

/// Bytes between two ranges that cost less to read than to begin anew.
const NEAR: u64 = 4 << 10;

const BYTES: u64 = size_of::<u32>() as u64;
const POSITION_BYTES: u64 = size_of::<Vec3>() as u64;

/// Leaf of each vertex that was read, and the vertex's position if faces place the samples: in temporary
/// files of 4 and 12 bytes per vertex of the model, of which only as much is on the disk as is known.
pub(super) struct ReadMembers {
    file: Scratch,
    /// Local coordinates.
    positions: Option<Scratch>,
}

impl ReadMembers {
    /// Table without members yet, for a model of `vertices` vertices; `with_positions` says whether positions
    /// are wanted.
    pub fn new(vertices: u64, with_positions: bool, folder: &Path) -> Result<Self> {
        let file = |bytes| {
            let file = Scratch::new(folder, ADVICE)?;
            file.set_len(vertices * bytes)?;
            Ok(file)
        };
        Ok(Self { file: file(BYTES)?, positions: with_positions.then(|| file(POSITION_BYTES)).transpose()? })
    }

    /// Notes where a cell's vertices are, if that is wanted.
    pub fn note_positions(&self, cell: &GatheredCell) -> Result<()> {
        let Some(file) = &self.positions else { return Ok(()) };
        let mut run: Vec<Vec3> = Vec::new();
        for (i, (id, vertex)) in cell.ids.iter().zip(&cell.vertices).enumerate() {
            run.push(vertex.position);
            if cell.ids.get(i + 1).is_none_or(|next| *next != id + 1) {
                file.write_at(cast_slice(&run), (u64::from(*id) + 1 - run.len() as u64) * POSITION_BYTES)?;
                run.clear();
            }
        }
        Ok(())
    }

    /// Notes the leaves of a cell's vertices.
    pub fn note(&self, cell: &mut Regrown) -> Result<()> {
        let mut members = std::mem::take(&mut cell.members);
        members.sort_unstable();
        let mut run: Vec<u32> = Vec::new();
        for (i, (id, leaf)) in members.iter().enumerate() {
            // Zero is for those that are not known.
            run.push(leaf + 1);
            if members.get(i + 1).is_none_or(|(next, _)| *next != id + 1) {
                self.file.write_at(cast_slice(&run), (u64::from(*id) + 1 - run.len() as u64) * BYTES)?;
                run.clear();
            }
        }
        Ok(())
    }

    /// The samples of the vertices, once they are numbered.
    pub fn finish(self, samples: usize, appended: &Appended) -> Result<NewSampleOf<'_>> {
        let positions = self.positions.map(Scratch::map).transpose()?;
        Ok(NewSampleOf { map: self.file.map()?, positions, samples: samples as u32, appended })
    }
}

/// The new sample of each vertex that was read.
pub(super) struct NewSampleOf<'a> {
    map: Map,
    positions: Option<Map>,
    /// Number of samples that were there.
    samples: u32,
    appended: &'a Appended,
}

/// Triangles and positions that the model's faces give after a refinement.
pub(super) struct RefinedFaces {
    pub triangles: Vec<[u32; 3]>,
    /// Positions of the new samples, if faces place them.
    pub positions: Option<Vec<Vec3>>,
    /// Number of bytes of the model that were read.
    pub bytes: u64,
}

impl NewSampleOf<'_> {
    /// The sample of a vertex, and whether it belonged to a cluster that is split; `None` if it was not read.
    fn get(&self, vertex: u32) -> Option<(u32, bool)> {
        let leaves: &[u32] = cast_slice(&self.map);
        let leaf = leaves.get(vertex as usize)?.checked_sub(1)?;
        if leaf < self.samples {
            return Some((leaf, self.appended.split[leaf as usize]));
        }
        let starts = &self.appended.starts;
        let at = starts.partition_point(|(first, _)| *first <= leaf - self.samples).checked_sub(1)?;
        let sample = starts[at].1;
        Some((sample, self.appended.split.get(sample as usize).is_none_or(|split| *split)))
    }

    /// Ranges of the faces whose triangles may change: those with a vertex of a sample that is split.
    fn ranges(&self, kept: &KeptCells) -> Vec<Range<u64>> {
        let changes = |cell: &&KeptCell| cell.tree.samples.iter().any(|s| self.appended.split[*s as usize]);
        joined(kept.cells.iter().filter(changes).flat_map(|cell| cell.faces.iter().cloned()), NEAR)
    }

    /// Streams the faces of the cells whose samples are split, or all where it is not known which these are;
    /// returns the new triangles, the positions of the new samples where faces place them, no further than
    /// `slack` allows, and the number of bytes that were read.
    ///
    /// Memory: 12 bytes per triangle, twice while the list grows; that of [`Planes`]; the chunks of
    /// [`for_faces`].
    pub fn reindex(
        &self,
        model: &dyn Model,
        old: &[[u32; 3]],
        kept: &KeptCells,
        slack: Option<&[f32]>,
        progress: &dyn Progress,
    ) -> Result<RefinedFaces> {
        let stays = |t: &&[u32; 3]| !t.iter().any(|s| self.appended.split[*s as usize]);
        let mut found: Vec<[u32; 3]> = old.iter().filter(stays).copied().collect();
        let (mut bytes, mut limit) = (0, 2 * found.len().max(1 << 16));
        let ranges = kept.knows_faces.then(|| self.ranges(kept));
        let to_read =
            ranges.as_ref().map_or(model.info().face_bytes, |all| all.iter().map(|r| r.end - r.start).sum());
        progress.begin("reindexing the faces", to_read);
        let vertices = self.positions.as_ref().map(|map| cast_slice(map));
        let mut planes = vertices.map(|all| Planes::new(all, &self.appended.positions, self.samples));
        let visit = |chunk: &FaceChunk| {
            progress.check()?;
            for corners in &chunk.triangles {
                let [Some(a), Some(b), Some(c)] = corners.map(|vertex| self.get(vertex)) else { continue };
                if (a.1 || b.1 || c.1) && a.0 != b.0 && b.0 != c.0 && c.0 != a.0 {
                    found.push(first_least([a.0, b.0, c.0]));
                }
            }
            if let Some(planes) = &mut planes {
                planes.take(&chunk.triangles, |corners| {
                    all_three(corners.map(|vertex| self.get(vertex).map(|(sample, _)| sample)))
                });
            }
            if found.len() > limit {
                once_each(&mut found);
                limit = 2 * found.len().max(1 << 16);
            }
            bytes += chunk.bytes;
            looked_at(3 * (BYTES + POSITION_BYTES) as usize * chunk.triangles.len());
            progress.advance(chunk.bytes);
            Ok(())
        };
        match ranges {
            Some(ranges) => for_faces_at(model, ranges, visit)?,
            None => for_faces(model, visit)?,
        }
        once_each(&mut found);
        found.shrink_to_fit();
        let positions =
            planes.map(|planes| planes.place(|sample| slack.map_or(f32::INFINITY, |slack| slack[sample])));
        let positions = positions.map(|all| all.into_iter().map(|placed| placed.at).collect());
        Ok(RefinedFaces { triangles: found, positions, bytes })
    }
}
