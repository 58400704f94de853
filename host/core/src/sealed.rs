//! Files that are held whole: eight letters, a version, the content in `postcard`'s words, and a checksum of
//! all before it.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use simod_model::mapped::looked_at;
use simod_model::{Error, Result as ModelResult, input};
use xxhash_rust::xxh3::Xxh3Default;

use crate::hashed::Hashed;

/// The bytes of such a file.
///
/// # Errors
/// The content cannot be held in a file.
pub fn seal(letters: &[u8; 8], version: u32, content: &impl Serialize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write_sealed(letters, version, content, &mut bytes)?;
    Ok(bytes)
}

/// Writes such a file, without holding its bytes.
///
/// # Errors
/// The file cannot be written.
pub fn write_sealed(
    letters: &[u8; 8],
    version: u32,
    content: &impl Serialize,
    mut to: impl Write,
) -> io::Result<()> {
    let mut hashed = Hashed::new(&mut to);
    hashed.write_all(letters)?;
    hashed.write_all(&version.to_le_bytes())?;
    let hashed = postcard::to_io(content, hashed).map_err(io::Error::other)?;
    let checksum = hashed.hash.digest128();
    to.write_all(&checksum.to_le_bytes())
}

/// Bytes that are hashed at once.
const PART: usize = 1 << 20;

/// Version of a file that begins with these letters, and its content; or an error text that says what is
/// wrong with the file.
pub fn unseal<'a>(bytes: &'a [u8], letters: &[u8; 8]) -> Result<(u32, &'a [u8]), &'static str> {
    let (sealed, checksum) = bytes.split_last_chunk().ok_or("it is cut off")?;
    let content = sealed.strip_prefix(letters).ok_or("it does not begin as such a file does")?;
    let mut hash = Xxh3Default::new();
    for part in sealed.chunks(PART) {
        hash.update(part);
        // The bytes may be those of a mapped file.
        looked_at(part.len());
    }
    if hash.digest128() != u128::from_le_bytes(*checksum) {
        return Err("its checksum is wrong");
    }
    let (version, content) = content.split_first_chunk().ok_or(UNKNOWN_VERSION)?;
    Ok((u32::from_le_bytes(*version), content))
}

/// Content of a file that begins with these letters and is of this version. `damaged` makes the error from a
/// description of the damage.
///
/// # Errors
/// The file is damaged, or of another version.
pub fn unsealed<T: DeserializeOwned>(
    bytes: &[u8],
    (letters, version): (&[u8; 8], u32),
    damaged: impl Fn(&str) -> Error,
) -> ModelResult<T> {
    let (known, content) = unseal(bytes, letters).map_err(&damaged)?;
    if known != version {
        return Err(damaged(UNKNOWN_VERSION));
    }
    postcard::from_bytes(content).map_err(|e| damaged("its content makes no sense").because(e))
}

/// Message on a file of another version.
pub const UNKNOWN_VERSION: &str = "it is of a version that is not known";

/// Reads sealed content of at most `longest` bytes from a file's end, where its length stands in the last
/// eight bytes. Gives the file, the content, and the offset at which the content begins. `damaged` makes the
/// error from a description of the damage.
///
/// # Errors
/// The file cannot be read, or is damaged.
pub fn read_end<T: DeserializeOwned>(
    path: &Path,
    (letters, version): (&[u8; 8], u32),
    longest: u64,
    damaged: impl Fn(&str) -> Error,
) -> ModelResult<(File, T, u64)> {
    let failed = |e| Error::io("read", path, &e);
    let mut file = input::open(path)?;
    let length = file.metadata().map_err(failed)?.len();
    let mut word = [0; 8];
    if length < 8 {
        return Err(damaged("it is cut off"));
    }
    file.seek(SeekFrom::End(-8)).map_err(failed)?;
    file.read_exact(&mut word).map_err(failed)?;
    let bytes = u64::from_le_bytes(word);
    if bytes > (length - 8).min(longest) {
        return Err(damaged("it is cut off"));
    }
    let begins = length - 8 - bytes;
    let mut table = vec![0; bytes as usize];
    file.seek(SeekFrom::Start(begins)).map_err(failed)?;
    file.read_exact(&mut table).map_err(failed)?;
    Ok((file, unsealed(&table, (letters, version), damaged)?, begins))
}
