//! Files that are held whole: eight letters, a version, the content in `postcard`'s words, and a checksum of
//! all before it.

use serde::Serialize;
use xxhash_rust::xxh3::xxh3_128;

/// The bytes of a file.
///
/// # Errors
/// The content cannot be held in a file.
pub fn seal(letters: &[u8; 8], version: u32, content: &impl Serialize) -> postcard::Result<Vec<u8>> {
    let bytes = [&letters[..], &version.to_le_bytes()].concat();
    let mut bytes = postcard::to_extend(content, bytes)?;
    let checksum = xxh3_128(&bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// The version of a file that begins with these letters, and its content; or what is wrong with it.
pub fn unseal<'a>(bytes: &'a [u8], letters: &[u8; 8]) -> Result<(u32, &'a [u8]), &'static str> {
    let (sealed, checksum) = bytes.split_last_chunk().ok_or("it is cut off")?;
    let content = sealed.strip_prefix(letters).ok_or("it does not begin as such a file does")?;
    if xxh3_128(sealed) != u128::from_le_bytes(*checksum) {
        return Err("its checksum is wrong");
    }
    let (version, content) = content.split_first_chunk().ok_or(UNKNOWN_VERSION)?;
    Ok((u32::from_le_bytes(*version), content))
}

/// What is wrong with a file of another version.
pub const UNKNOWN_VERSION: &str = "it is of a version that is not known";
