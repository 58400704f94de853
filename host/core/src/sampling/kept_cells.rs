//! Cells that are kept beside P_S, so that a refinement reads no more of the model than it has to and goes on
//! where the trees stopped (paper §6): the ranges of each cell in the stream, and its VS-Tree down to the
//! samples.
//!
//! The file begins with eight letters and a version, and ends with a checksum of all before it.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use simod_model::{Error, Result};

use super::grid::CellKey;
use crate::sealed::{UNKNOWN_VERSION, seal, unseal};

const MAGIC: &[u8; 8] = b"SIMODCEL";
/// Former files, which know nothing of the faces, are of the version before.
const VERSION: u32 = 3;
const WITHOUT_FACES: u32 = 2;

/// All occupied cells of a sampled model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptCells {
    /// log₂ of the cells' edge length, in the model's unit.
    pub level: i32,
    /// Whether the ranges of the cells' faces are known.
    pub knows_faces: bool,
    /// The cells in the order in which the stream meets them.
    pub cells: Vec<KeptCell>,
}

/// A cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptCell {
    /// ⌊p / edge length⌋ of its points.
    pub key: CellKey,
    /// Number of vertices.
    pub vertices: u64,
    /// Ranges of indices in the model among which all of the cell's vertices are; ascending.
    pub ranges: Vec<Range<u64>>,
    /// Bytes of the file among which all faces with one of its vertices are; ascending, and from one mark of
    /// their reader ([`FaceMark`](simod_model::FaceMark)) to another.
    pub faces: Vec<Range<u64>>,
    /// The cell's VS-Tree.
    pub tree: CutTree,
}

/// A cell's tree down to the samples, in preorder.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CutTree {
    /// Number of children of each node; none for a sample.
    pub children: Vec<u8>,
    /// Error of each node, or of one above if that is less; a length in local units.
    pub errors: Vec<f32>,
    /// The sample of each leaf, in their order. A tree of one node may share it with other cells.
    pub samples: Vec<u32>,
    /// Nodes that were samples until a refinement went on below them, with a VS-Tree over their vertices;
    /// ascending, and none below another.
    pub grown: Vec<u32>,
}

impl CutTree {
    /// The sample of each leaf, with the error of its cluster.
    pub fn errors_of_samples(&self) -> impl Iterator<Item = (u32, f32)> {
        let leaves = self.children.iter().zip(&self.errors).filter(|(children, _)| **children == 0);
        self.samples.iter().zip(leaves).map(|(sample, (_, error))| (*sample, *error))
    }

    /// The index behind the subtree of each node.
    pub fn ends(&self) -> Vec<usize> {
        let mut ends = vec![0; self.children.len()];
        for i in (0..ends.len()).rev() {
            ends[i] = (0..self.children[i]).fold(i + 1, |at, _| ends.get(at).copied().unwrap_or(at));
        }
        ends
    }

    /// Whether a refinement made each node, or split it.
    pub fn is_grown(&self) -> Vec<bool> {
        let (ends, mut is_grown) = (self.ends(), vec![false; self.children.len()]);
        self.grown.iter().for_each(|at| is_grown[*at as usize..ends[*at as usize]].fill(true));
        is_grown
    }

    /// Defect of a tree that was read, of a model of so many samples; `None`, mostly.
    pub(super) fn defect(&self, samples: usize) -> Option<&'static str> {
        let mut missing = 1usize;
        for children in &self.children {
            if missing == 0 || *children == 1 || *children > 8 {
                return Some("a tree is malformed");
            }
            missing = missing - 1 + *children as usize;
        }
        if missing != 0 || self.errors.len() != self.children.len() {
            return Some("a tree is cut off");
        }
        if !self.errors.iter().all(|e| e.is_finite() && *e >= 0.0) {
            return Some("an error is no number");
        }
        let leaves = self.children.iter().filter(|n| **n == 0).count();
        if self.samples.len() != leaves || self.samples.iter().any(|s| *s as usize >= samples) {
            return Some("it speaks of samples that there are not");
        }
        let ends = self.ends();
        let is_inner = |at: &u32| self.children.get(*at as usize).is_some_and(|n| *n > 0);
        let apart =
            self.grown.windows(2).all(|w| ends.get(w[0] as usize).is_some_and(|end| *end <= w[1] as usize));
        (!self.grown.iter().all(is_inner) || !apart).then_some("a tree has grown where it has not")
    }
}

impl KeptCells {
    /// The content of a file, for the `samples.ply` with this hash.
    ///
    /// # Errors
    /// Never, for what sampling makes: only what cannot be held in a file would be refused.
    pub fn encode(&self, samples_fingerprint: &str) -> Result<Vec<u8>> {
        seal(MAGIC, VERSION, &(samples_fingerprint, self))
            .map_err(|e| Error::internal("the cells cannot be held in a file").because(e))
    }

    /// Reads the content of a file: the hash of the `samples.ply` that it belongs to, and the cells.
    ///
    /// # Errors
    /// The content is damaged, or of a version that is not known.
    pub fn decode(bytes: &[u8]) -> Result<(String, Self)> {
        let (version, content) = unseal(bytes, MAGIC).map_err(damaged)?;
        let failed = |e: postcard::Error| damaged(&e.to_string());
        match version {
            VERSION => postcard::from_bytes(content).map_err(failed),
            WITHOUT_FACES => {
                let (of, former): (_, FormerCells) = postcard::from_bytes(content).map_err(failed)?;
                Ok((of, former.into()))
            }
            _ => Err(damaged(UNKNOWN_VERSION)),
        }
    }

    /// Checks that the cells are those of a model of so many vertices with a finite position, of `all`, in a
    /// file of so many bytes, and of so many samples, of which no cell has those that are parted: cells of a
    /// file that is whole may still be of another model.
    ///
    /// # Errors
    /// The cells are those of another model.
    pub fn check(
        &self,
        finite: u64,
        all: u64,
        bytes: u64,
        samples: usize,
        parted: impl Iterator<Item = u32>,
    ) -> Result<()> {
        let mut keys: Vec<_> = self.cells.iter().map(|cell| cell.key).collect();
        keys.sort_unstable();
        if !(-1100..=1100).contains(&self.level) || keys.windows(2).any(|w| w[0] == w[1]) {
            return Err(damaged("its cells are none"));
        }
        let (mut vertices, mut known) = (0u64, vec![false; samples]);
        parted.for_each(|sample| known[sample as usize] = true);
        for cell in &self.cells {
            let held = cell.ranges.iter().map(|r| r.end.saturating_sub(r.start)).fold(0, u64::saturating_add);
            if !are_ranges(&cell.ranges, all) || cell.vertices == 0 || cell.vertices > held {
                return Err(damaged("a cell's vertices are not where it says"));
            }
            if !are_ranges(&cell.faces, if self.knows_faces { bytes } else { 0 }) {
                return Err(damaged("a cell's faces are not where it says"));
            }
            if let Some(what) = cell.tree.defect(samples) {
                return Err(damaged(what));
            }
            vertices = vertices.saturating_add(cell.vertices);
            cell.tree.samples.iter().for_each(|s| known[*s as usize] = true);
        }
        if vertices != finite || known.contains(&false) {
            return Err(damaged("it is of another model"));
        }
        Ok(())
    }
}

/// Whether ranges ascend, and end before `end`.
fn are_ranges(ranges: &[Range<u64>], end: u64) -> bool {
    ranges.iter().all(|r| r.start < r.end && r.end <= end)
        && ranges.windows(2).all(|w| w[0].end <= w[1].start)
}

/// The content of files that former versions wrote.
#[derive(Deserialize)]
struct FormerCells {
    level: i32,
    cells: Vec<FormerCell>,
}

#[derive(Deserialize)]
struct FormerCell {
    key: CellKey,
    vertices: u64,
    ranges: Vec<Range<u64>>,
    tree: CutTree,
}

impl From<FormerCells> for KeptCells {
    fn from(FormerCells { level, cells }: FormerCells) -> Self {
        let cell = |FormerCell { key, vertices, ranges, tree }: FormerCell| KeptCell {
            key,
            vertices,
            ranges,
            faces: Vec::new(),
            tree,
        };
        Self { level, knows_faces: false, cells: cells.into_iter().map(cell).collect() }
    }
}

fn damaged(what: &str) -> Error {
    Error::format(format!("the cells' file is of no use: {what}"), "sample the model again")
}

#[cfg(test)]
mod tests {
    use super::*;
    use xxhash_rust::xxh3::xxh3_128;

    fn cells() -> KeptCells {
        let cell = |i: i64| KeptCell {
            key: [i, -i, i64::MIN],
            vertices: 1 << 40,
            ranges: vec![0..5, 7..u64::MAX],
            faces: vec![3..9, 10..11],
            tree: CutTree {
                children: vec![2, 0, 0],
                errors: vec![1.0, 0.5, 0.25],
                samples: vec![7, 9],
                grown: Vec::new(),
            },
        };
        let cells = (0..3).map(cell).collect();
        KeptCells { level: -4, knows_faces: true, cells }
    }

    #[test]
    fn what_is_written_is_read_and_any_damage_is_noticed() {
        let cells = cells();
        let bytes = cells.encode("hash").expect("cells");
        assert_eq!(KeptCells::decode(&bytes).expect("cells"), ("hash".to_owned(), cells));
        for i in 0..bytes.len() {
            KeptCells::decode(&bytes[..i]).expect_err("cut off");
            let mut changed = bytes.clone();
            changed[i] ^= 4;
            KeptCells::decode(&changed).expect_err("changed");
        }
    }

    #[test]
    fn cells_that_lie_are_noticed() {
        let cell = |i: u64| KeptCell {
            key: [i as i64, 0, 0],
            vertices: 5,
            ranges: vec![5 * i..5 * i + 2, 5 * i + 2..5 * i + 5],
            faces: vec![90..95, 95..100],
            tree: CutTree {
                children: vec![2, 2, 0, 0, 0],
                errors: vec![1.0, 0.5, 0.25, 0.5, 0.0],
                samples: vec![3 * i as u32, 3 * i as u32 + 1, 3 * i as u32 + 2],
                grown: vec![1],
            },
        };
        let good = KeptCells { level: -4, knows_faces: true, cells: vec![cell(0), cell(1)] };
        good.check(10, 11, 100, 6, std::iter::empty()).expect("good cells");
        let lies: [&dyn Fn(&mut KeptCell); 21] = [
            &|c| c.key = [0; 3],
            &|c| c.vertices = 6,
            &|c| c.vertices = 0,
            &|c| c.ranges.clear(),
            &|c| c.ranges = vec![5..5, 5..10],
            &|c| c.ranges = vec![7..10, 5..7],
            &|c| c.ranges = vec![5..7, 7..12],
            &|c| c.ranges = std::iter::once(std::ops::Range { start: 9, end: 5 }).collect(),
            &|c| c.faces[1] = 95..95,
            &|c| c.faces[1].end = 101,
            &|c| c.faces[1].start = 94,
            &|c| c.tree.children[0] = 1,
            &|c| c.tree.children[0] = 3,
            &|c| c.tree.children[1] = 9,
            &|c| c.tree.children.clear(),
            &|c| c.tree.errors[2] = f32::NAN,
            &|c| c.tree.errors.truncate(4),
            &|c| c.tree.samples[1] = 6,
            &|c| c.tree.samples.truncate(2),
            &|c| c.tree.grown = vec![2],
            &|c| c.tree.grown = vec![0, 1],
        ];
        for (i, lie) in lies.iter().enumerate() {
            let mut cells = good.clone();
            lie(&mut cells.cells[1]);
            assert!(cells.check(10, 11, 100, 6, std::iter::empty()).is_err(), "lie {i}");
        }
        for (finite, bytes, samples) in [(11, 100, 6), (10, 99, 6), (10, 100, 7)] {
            assert!(good.check(finite, 11, bytes, samples, std::iter::empty()).is_err());
        }
        let unknown = KeptCells { knows_faces: false, ..good };
        assert!(unknown.check(10, 11, 100, 6, std::iter::empty()).is_err(), "faces that nobody knows");
    }

    #[test]
    fn files_without_faces_are_read() {
        let KeptCells { level, mut cells, .. } = cells();
        cells.iter_mut().for_each(|cell| cell.faces.clear());
        let former: Vec<_> = cells.iter().map(|c| (c.key, c.vertices, &c.ranges, &c.tree)).collect();
        let mut bytes = MAGIC.to_vec();
        bytes.extend(WITHOUT_FACES.to_le_bytes());
        let mut bytes = postcard::to_extend(&("hash", level, former), bytes).expect("a file");
        let checksum = xxh3_128(&bytes);
        bytes.extend(checksum.to_le_bytes());
        let expected = KeptCells { level, knows_faces: false, cells };
        assert_eq!(KeptCells::decode(&bytes).expect("cells"), ("hash".to_owned(), expected));
    }

    #[test]
    fn other_versions_are_refused() {
        let mut bytes = cells().encode("hash").expect("cells");
        bytes.truncate(bytes.len() - size_of::<u128>());
        bytes[MAGIC.len()] += 1;
        let checksum = xxh3_128(&bytes);
        bytes.extend(checksum.to_le_bytes());
        let error = KeptCells::decode(&bytes).expect_err("another version");
        assert!(error.to_string().contains("version"), "{error}");
    }
}
