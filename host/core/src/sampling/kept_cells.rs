//! What is kept of the cells beside P_S, so that a refinement reads no more of the model than it has to and goes on
//! where the trees stopped (paper §6): where in the stream each cell is, and its VS-Tree down to the samples.
//!
//! The file begins with eight letters and a version, and ends with a checksum of all before it.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_128;

use super::cut::CutTree;
use super::lattice::CellKey;
use crate::{Error, ErrorKind, Result};

const MAGIC: &[u8; 8] = b"SIMODCEL";
const VERSION: u32 = 1;
const HEAD: usize = MAGIC.len() + size_of::<u32>();
const CHECKSUM: usize = size_of::<u128>();

/// All occupied cells of a sampled model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptCells {
    /// log₂ of the cells' edge length, in the model's unit.
    pub level: i32,
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
    /// Indices of the vertices among which all of them are; ascending.
    pub ranges: Vec<Range<u64>>,
    /// Its VS-Tree.
    pub tree: CutTree,
}

impl KeptCells {
    /// The content of a file, for the `samples.ply` with this hash.
    ///
    /// # Errors
    /// Never, for what sampling makes: only what cannot be held in a file would be refused.
    pub fn encode(&self, samples_fingerprint: &str) -> Result<Vec<u8>> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        let mut bytes =
            postcard::to_extend(&(samples_fingerprint, self), bytes).map_err(|e| damaged(&e.to_string()))?;
        let checksum = xxh3_128(&bytes);
        bytes.extend(checksum.to_le_bytes());
        Ok(bytes)
    }

    /// Reads the content of a file: the hash of the `samples.ply` that it belongs to, and the cells.
    ///
    /// # Errors
    /// It is damaged, or of a version that is not known.
    pub fn decode(bytes: &[u8]) -> Result<(String, Self)> {
        let Some((content, checksum)) = bytes.split_last_chunk::<CHECKSUM>() else {
            return Err(damaged("it is cut off"));
        };
        if content.get(..MAGIC.len()) != Some(MAGIC) {
            return Err(damaged("it does not begin as such a file does"));
        }
        if xxh3_128(content) != u128::from_le_bytes(*checksum) {
            return Err(damaged("its checksum is wrong"));
        }
        match content[MAGIC.len()..].first_chunk() {
            Some(version) if u32::from_le_bytes(*version) == VERSION => {}
            _ => return Err(damaged("it is of a version that is not known")),
        }
        postcard::from_bytes(&content[HEAD..]).map_err(|e| damaged(&e.to_string()))
    }
}

fn damaged(what: &str) -> Error {
    Error::new(ErrorKind::Format, format!("the cells' file is of no use: {what}"), "sample the model again")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells() -> KeptCells {
        let cell = |i: i64| KeptCell {
            key: [i, -i, i64::MIN],
            vertices: 1 << 40,
            ranges: vec![0..5, 7..u64::MAX],
            tree: CutTree { first_sample: 7, children: vec![2, 0, 0], errors: vec![1.0, 0.5, 0.25] },
        };
        let cells = (0..3).map(cell).collect();
        KeptCells { level: -4, cells }
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
    fn other_versions_are_refused() {
        let mut bytes = cells().encode("hash").expect("cells");
        bytes.truncate(bytes.len() - CHECKSUM);
        bytes[MAGIC.len()] += 1;
        let checksum = xxh3_128(&bytes);
        bytes.extend(checksum.to_le_bytes());
        let error = KeptCells::decode(&bytes).expect_err("another version");
        assert!(error.to_string().contains("version"), "{error}");
    }
}
