//! Bindings: the home of every vertex, kept in a file. Homes do not depend on the deformation, and so a model
//! that is deformed again and again is bound to its samples once. What depends on the samples alone is
//! [kept](super::kept_geometry) beside them anyway.
//!
//! The file begins with eight letters, a version, and a hash of all that homes depend on. Then follow the
//! homes, a part with its own checksum for each chunk that the model is read in: runs of vertices with the
//! same home, as the difference to the last home and a length.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

use glam::Vec3;
use simod_model::output::OutputFile;
use simod_model::{Error, Model, Progress, Result, VertexChunk, input};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

use super::RestGeometry;
use super::block::homes;
use crate::fingerprint::VertexHash;
use crate::sampled_model::SampledModel;
use crate::touching::Contacts;
use crate::varint::{self, VarintNumbers};

/// First letters of a binding.
pub(crate) const MAGIC: &[u8; 8] = b"SIMODBND";

/// Version of the format, counted up whenever the format changes, or the key of the same samples, their
/// sheets, supports or homes.
const VERSION: u32 = 10;

/// Bytes before the homes: letters, version and hash.
const HEAD_BYTES: usize = MAGIC.len() + 4 + 16;

/// Largest number of bytes of a part: a chunk's vertices, each with another home.
const MOST_BYTES: usize = 10 * simod_model::CHUNK_VERTICES;

/// Binds a model to its samples: writes `path`, whole or not at all. Returns its size in bytes. The geometry
/// of the samples, which is found for it, is held with these, and may be [kept](super::keep_geometry).
///
/// Memory: the [`RestGeometry`], and a chunk of the model.
///
/// # Errors
/// The model cannot be read or is not what was sampled, the file cannot be written, or the user cancelled.
pub fn bind(sampled: &SampledModel, model: &dyn Model, path: &Path, progress: &dyn Progress) -> Result<u64> {
    let failed = |e: io::Error| Error::written(path, e);
    progress.begin("preparing", 0);
    let around = RestGeometry::kept(sampled);
    around.prepare();
    let head = [&MAGIC[..], &VERSION.to_le_bytes(), &key(sampled).to_le_bytes()].concat();
    let mut file = OutputFile::create(path, 0)?;
    let mut bytes = HEAD_BYTES as u64;
    file.write_all(&head).map_err(failed)?;

    progress.begin("binding", model.info().vertex_bytes);
    let mut reader = model.vertices(0..model.info().vertices)?;
    let (mut chunk, mut found, mut runs) = (VertexChunk::default(), Vec::new(), Vec::new());
    let mut hash = VertexHash::like(&sampled.source.fingerprint);
    while reader.read(&mut chunk)? {
        progress.check()?;
        hash.update(chunk.raw());
        homes(&around, &sampled.frame, &chunk.positions, &mut found);
        runs.clear();
        encode(&found, &mut runs);
        file.write_all(&(found.len() as u32).to_le_bytes()).map_err(failed)?;
        file.write_all(&(runs.len() as u32).to_le_bytes()).map_err(failed)?;
        file.write_all(&xxh3_64(&runs).to_le_bytes()).map_err(failed)?;
        file.write_all(&runs).map_err(failed)?;
        bytes += 16 + runs.len() as u64;
        progress.advance(chunk.raw().len() as u64);
    }
    if sampled.source.fingerprint != hash.fingerprint() {
        return Err(sampled.source_changed(model.path()));
    }
    file.commit()?;
    Ok(bytes)
}

/// Hash of all that homes depend on.
fn key(sampled: &SampledModel) -> u128 {
    let source = &sampled.source;
    let frame = [sampled.frame.origin.x, sampled.frame.origin.y, sampled.frame.origin.z, sampled.frame.scale];
    let texts = [env!("CARGO_PKG_VERSION"), &source.fingerprint].map(str::as_bytes);
    let (bytes, frame) = (source.bytes.to_le_bytes(), frame.map(f64::to_le_bytes));
    let numbers = [&bytes[..], frame.as_flattened()];
    let samples = &sampled.samples;
    let points = [&samples.positions, samples.known_normals()].map(bytemuck::cast_slice::<Vec3, u8>);
    let hashes = [texts, numbers, points].into_iter().flatten().map(xxh3_128);
    let hashes = hashes.chain(samples.contacts().map(Contacts::digest));
    xxh3_128(&hashes.flat_map(u128::to_le_bytes).collect::<Vec<_>>())
}

fn encode(homes: &[u32], runs: &mut Vec<u8>) {
    let mut last = 0;
    for run in homes.chunk_by(|a, b| a == b) {
        let step = i64::from(run[0]) - last;
        varint::push(((step << 1) ^ (step >> 63)) as u64, runs);
        varint::push(run.len() as u64, runs);
        last = i64::from(run[0]);
    }
}

/// Homes of runs, each less than `samples`, `count` in all; `None` if `runs` are no such homes.
fn decode(runs: &[u8], count: usize, samples: usize, homes: &mut Vec<u32>) -> Option<()> {
    homes.clear();
    let mut numbers = VarintNumbers(runs);
    let mut home = 0i64;
    while homes.len() < count {
        let (step, length) = (numbers.next()?, numbers.next()?);
        home = home.checked_add((step >> 1) as i64 ^ -((step & 1) as i64))?;
        let length = usize::try_from(length).ok().filter(|n| (1..=count - homes.len()).contains(n))?;
        let valid = u32::try_from(home).ok().filter(|home| (*home as usize) < samples)?;
        homes.resize(homes.len() + length, valid);
    }
    numbers.0.is_empty().then_some(())
}

/// A binding that is read.
pub(super) struct Binding {
    file: BufReader<File>,
    samples: usize,
    bytes: Vec<u8>,
}

impl Binding {
    /// Opens the binding of a sampled model, if there is one; the error says why it is of no use.
    pub(super) fn open(path: &Path, sampled: &SampledModel) -> std::result::Result<Option<Self>, String> {
        if !path.exists() {
            return Ok(None);
        }
        let file = input::open(path).map_err(|e| e.to_string())?;
        let mut file = BufReader::with_capacity(1 << 18, file);
        let mut head = [0; HEAD_BYTES];
        file.read_exact(&mut head).map_err(|_| "it is cut off".to_owned())?;
        let (start, of) = head.split_at(MAGIC.len() + 4);
        if start != [&MAGIC[..], &VERSION.to_le_bytes()].concat() {
            return Err("it is of another version".to_owned());
        }
        if of != key(sampled).to_le_bytes() {
            return Err("it belongs to other samples".to_owned());
        }
        Ok(Some(Self { file, samples: sampled.samples.len(), bytes: Vec::new() }))
    }

    /// The homes of the next vertices, which are a chunk.
    pub(super) fn next(&mut self, vertices: usize) -> Result<Vec<u32>> {
        let io = |e| damaged("it is cut off").because(e);
        let mut start = [0; 16];
        self.file.read_exact(&mut start).map_err(io)?;
        let word = |at: usize| u32::from_le_bytes([start[at], start[at + 1], start[at + 2], start[at + 3]]);
        let (count, bytes) = (word(0) as usize, word(4) as usize);
        if count != vertices || bytes > MOST_BYTES {
            return Err(damaged("its parts are not those of the model"));
        }
        self.bytes.resize(bytes, 0);
        self.file.read_exact(&mut self.bytes).map_err(io)?;
        if xxh3_64(&self.bytes).to_le_bytes() != start[8..] {
            return Err(damaged("a checksum is wrong"));
        }
        let mut homes = Vec::with_capacity(count);
        decode(&self.bytes, count, self.samples, &mut homes)
            .ok_or_else(|| damaged("its numbers make no sense"))?;
        Ok(homes)
    }
}

fn damaged(what: &str) -> Error {
    Error::format(
        format!("the binding of the model to its samples is of no use: {what}"),
        "run simod bind again, or delete binding.bin",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_come_back(lengths in proptest::collection::vec((0u32..1000, 1usize..20), 0..50)) {
            let homes: Vec<u32> = lengths.iter().flat_map(|(home, n)| vec![*home; *n]).collect();
            let (mut runs, mut back) = (Vec::new(), Vec::new());
            encode(&homes, &mut runs);
            prop_assert!(decode(&runs, homes.len(), 1000, &mut back).is_some());
            prop_assert_eq!(&back, &homes);
            // Too few samples, too many or too few vertices.
            prop_assert!(homes.iter().all(|h| *h < 500) == decode(&runs, homes.len(), 500, &mut back).is_some());
            prop_assert!(decode(&runs, homes.len() + 1, 1000, &mut back).is_none());
            prop_assert!(homes.is_empty() || decode(&runs, homes.len() - 1, 1000, &mut back).is_none());
        }

        #[test]
        fn any_bytes_are_refused_or_fit(bytes in proptest::collection::vec(any::<u8>(), 0..100), count in 0usize..200) {
            let mut homes = Vec::new();
            if decode(&bytes, count, 50, &mut homes).is_some() {
                prop_assert!(homes.len() == count && homes.iter().all(|h| *h < 50));
            }
        }
    }
}
