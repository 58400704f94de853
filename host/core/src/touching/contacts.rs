//! Places where sheets meet, as the model's faces tell them, and the sheets of the samples there: kept in the
//! folder.
//!
//! The file begins with eight letters and a version. The lists of the samples follow, then the places, and a
//! checksum of all before it.

use std::collections::BTreeMap;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};
use simod_model::output::OutputFile;
use simod_model::{Error, Result, input};

use crate::hashed::Hashed;

use super::places::PlaceSamples;

const MAGIC: &[u8; 8] = b"SIMODSHT";
const VERSION: u32 = 1;

/// Neighbours in a list, at most.
pub(super) const MOST: usize = 32;

/// The samples on the same sheet as each, near places where sheets meet.
///
/// Memory: at most 140 bytes for each sample near which sheets meet, and those of the places.
#[derive(Debug, Default)]
pub struct Contacts {
    pub(super) lists: ContactLists,
    pub(super) places: Arc<PlaceSamples>,
}

/// The neighbours of samples near which sheets meet, one list after the other.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct ContactLists {
    /// Samples near which sheets meet, ascending.
    pub samples: Vec<u32>,
    starts: Vec<u32>,
    /// The neighbours of each on its sheet, the nearest first.
    same: Vec<u32>,
    /// Samples that were parted from the sample of a cluster, each with that one: they are in no cell's tree.
    pub parted: Vec<[u32; 2]>,
}

impl Contacts {
    /// The neighbours of a sample on its sheet, nearest first; `None` where no sheets meet.
    pub fn same_sheet(&self, sample: usize) -> Option<&[u32]> {
        self.lists.get(sample)
    }

    /// Sample on whose sheet a local position is, where the position itself does not tell.
    #[inline]
    pub fn sample_at(&self, p: Vec3) -> Option<u32> {
        self.places.sample_at(p)
    }

    /// Samples that no cell's tree has, and the one of its cluster that each was parted from.
    pub fn parted(&self) -> &[[u32; 2]] {
        &self.lists.parted
    }

    /// Samples whose [sheet](Self::same_sheet) is known, ascending.
    pub fn told(&self) -> &[u32] {
        &self.lists.samples
    }

    /// Number of samples near which sheets meet.
    pub fn samples(&self) -> usize {
        self.lists.samples.len()
    }

    /// Number of places that are kept.
    pub fn places(&self) -> usize {
        self.places.all().len()
    }

    /// A hash of all that is known of contacts.
    pub fn digest(&self) -> u128 {
        let mut hash = Hashed::new(io::sink());
        // A sink takes all bytes, so that writing cannot fail.
        let _ = self.write_content("", &mut hash);
        hash.hash.digest128()
    }

    fn write_content(&self, samples_fingerprint: &str, mut to: impl Write) -> io::Result<()> {
        let head = (samples_fingerprint, &self.lists, self.places.all().len() as u64);
        let head = postcard::to_allocvec(&head).map_err(io::Error::other)?;
        to.write_all(MAGIC)?;
        to.write_all(&VERSION.to_le_bytes())?;
        to.write_all(&(head.len() as u64).to_le_bytes())?;
        to.write_all(&head)?;
        self.places.write(to)
    }

    /// Writes a file, for the `samples.ply` with this hash.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path, samples_fingerprint: &str) -> Result<()> {
        let failed = |e: io::Error| Error::written(path, e);
        let mut file = OutputFile::create(path, 12 * self.places.all().len() as u64)?;
        let mut hashed = Hashed::new(&mut file);
        self.write_content(samples_fingerprint, &mut hashed).map_err(failed)?;
        let checksum = hashed.hash.digest128();
        file.write_all(&checksum.to_le_bytes()).map_err(failed)?;
        file.commit()
    }

    /// Reads a file, if it is there: of `samples` samples, and of the `samples.ply` with this hash.
    ///
    /// # Errors
    /// The file cannot be read; it is damaged, or of other samples.
    pub fn load(path: &Path, samples_fingerprint: &str, samples: usize) -> Result<Option<Self>> {
        if path.symlink_metadata().is_err() {
            return Ok(None);
        }
        let file = input::open(path)?;
        let refused = |what: &str| {
            Error::format(format!("{} is of no use: {what}", path.display()), "sample the model again")
        };
        let cut_off = |_| refused("it is cut off");
        let length = file.metadata().map_err(|e| Error::io("read", path, &e))?.len();
        let mut reader = Hashed::new(BufReader::new(file));
        let mut start = [0; 20];
        reader.read_exact(&mut start).map_err(cut_off)?;
        let bytes = u64::from_le_bytes(start[12..].try_into().unwrap_or_default());
        if &start[..8] != MAGIC {
            return Err(refused("it does not begin as such a file does"));
        }
        if start[8..12] != VERSION.to_le_bytes() {
            return Err(refused("it is of a version that is not known"));
        }
        if bytes > length {
            return Err(refused("it is cut off"));
        }
        let mut head = vec![0; bytes as usize];
        reader.read_exact(&mut head).map_err(cut_off)?;
        let (of, lists, count): (String, ContactLists, u64) =
            postcard::from_bytes(&head).map_err(|e| refused(&e.to_string()))?;
        // The length is checked before anything is held by what the file says.
        if length - bytes.min(length) != 20 + count.saturating_mul(12).saturating_add(16) {
            return Err(refused("it is cut off"));
        }
        let places =
            PlaceSamples::read(&mut reader, count, samples, &std::env::temp_dir()).map_err(cut_off)??;
        let expected = reader.hash.digest128();
        let mut checksum = [0; 16];
        reader.read_exact(&mut checksum).map_err(cut_off)?;
        if u128::from_le_bytes(checksum) != expected {
            return Err(refused("its checksum is wrong"));
        }
        if of != samples_fingerprint {
            return Err(refused("it belongs to other samples"));
        }
        match places {
            Some(places) if lists.is_valid(samples) => Ok(Some(Self { lists, places: Arc::new(places) })),
            _ => Err(refused("its numbers make no sense")),
        }
    }
}

impl ContactLists {
    pub fn new(lists: BTreeMap<u32, Vec<u32>>, parted: Vec<[u32; 2]>) -> Self {
        let mut all = Self { starts: vec![0], parted, ..Self::default() };
        for (sample, same) in lists {
            all.samples.push(sample);
            all.same.extend(same);
            all.starts.push(all.same.len() as u32);
        }
        all
    }

    fn place(&self, sample: usize) -> Option<usize> {
        self.samples.binary_search(&(sample as u32)).ok()
    }

    pub fn get(&self, sample: usize) -> Option<&[u32]> {
        let at = self.place(sample)?;
        Some(&self.same[self.starts[at] as usize..self.starts[at + 1] as usize])
    }

    fn is_valid(&self, samples: usize) -> bool {
        let exist = |s: &u32| (*s as usize) < samples;
        self.samples.windows(2).all(|w| w[0] < w[1])
            && self.samples.iter().chain(&self.same).chain(self.parted.iter().flatten()).all(exist)
            && self.starts.len() == self.samples.len() + 1
            && self.starts.first() == Some(&0)
            && self.starts.is_sorted_by(|a, b| a <= b && b - a <= MOST as u32)
            && self.starts.last().is_some_and(|end| *end as usize == self.same.len())
            && (0..self.samples.len()).all(|at| {
                let list = &self.same[self.starts[at] as usize..self.starts[at + 1] as usize];
                !list.contains(&self.samples[at])
            })
    }
}
