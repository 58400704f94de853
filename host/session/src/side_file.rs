//! Files beside a session: content that is too long for a readable file, as long brush strokes and
//! selections.
//!
//! The file is a line with its kind, such as `simod-strokes/1`, and the content in postcard's encoding. The
//! session names the file with its hash; the name has a part of the hash, so that a session that is saved
//! anew never spoils the files that the former one refers to.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use simod_model::target::folder_of;
use simod_model::{Error, Result, input, output};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// Number of points beyond which strokes or a selection go to a file of their own.
pub const MOST_IN_SESSION: usize = 1000;

/// Longest file: 40 million points.
const LONGEST: u64 = 1 << 30;

/// Digits of the hash in a file's name.
const HASH: usize = 12;

/// Content of a side file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SideFileKind {
    /// The strokes of a step.
    Strokes,
    /// A region that was selected by hand.
    Selection,
}

impl SideFileKind {
    const ALL: [Self; 2] = [Self::Strokes, Self::Selection];

    /// First bytes of files of this kind, the end of their names, and the word for them in messages.
    fn names(self) -> (&'static [u8], &'static str, &'static str) {
        match self {
            Self::Strokes => (b"simod-strokes/1\n", "strokes", "strokes"),
            Self::Selection => (b"simod-selection/1\n", "selection", "selection"),
        }
    }
}

/// Reference of a session to a side file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Reference {
    /// Path of the file, relative to the session.
    pub file: PathBuf,
    /// Hash of the file's bytes.
    pub fingerprint: String,
}

/// Writes a file beside the session, whole or not at all; one that is there already with the same content
/// stays.
///
/// # Errors
/// The file cannot be written.
pub fn write(session: &Path, kind: SideFileKind, content: &impl Serialize) -> Result<Reference> {
    let (magic, extension, what) = kind.names();
    let bytes = postcard::to_extend(content, magic.to_vec())
        .map_err(|e| Error::unwritable(format_args!("a {what}"), e))?;
    let fingerprint = fingerprint(&bytes);
    let stem = stem(session);
    let short = fingerprint.rsplit(':').next().and_then(|hex| hex.get(..HASH)).unwrap_or_default();
    let file = PathBuf::from(format!("{stem}-{short}.{extension}"));
    let path = folder_of(session).join(&file);
    if input::read(&path, LONGEST).ok().as_deref() != Some(&bytes) {
        output::write_file(&path, &bytes)?;
    }
    Ok(Reference { file, fingerprint })
}

/// Beginning of the names of files beside a session: a text that differs from that of any other session.
fn stem(session: &Path) -> String {
    let stem = session.file_stem().unwrap_or_default();
    match stem.to_str() {
        Some(text) => text.to_owned(),
        None => format!("{}-{:016x}", stem.to_string_lossy(), xxh3_64(stem.as_encoded_bytes())),
    }
}

/// The files that sessions at this path have written beside them, used or not.
///
/// # Errors
/// The folder cannot be read.
pub fn beside(session: &Path) -> Result<Vec<PathBuf>> {
    let folder = folder_of(session);
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("read", folder, &e))?;
    let stem = stem(session);
    let is_ours = |path: &Path| {
        let name = path.file_name().and_then(|name| name.to_str());
        let rest = name.and_then(|n| n.strip_prefix(&*stem)?.strip_prefix('-')?.split_once('.'));
        rest.is_some_and(|(hex, extension)| {
            SideFileKind::ALL.iter().any(|kind| kind.names().1 == extension)
                && hex.len() == HASH
                && hex.bytes().all(|b| b.is_ascii_hexdigit())
        })
    };
    Ok(entries.flatten().map(|entry| entry.path()).filter(|path| is_ours(path)).collect())
}

impl Reference {
    /// Reads the file; `folder` is the session's. `make` makes the value of its content, or an error that
    /// tells the fault.
    ///
    /// # Errors
    /// The file cannot be read, is not the one that the session was saved with, or holds what makes no sense.
    pub fn read<C: DeserializeOwned, T>(
        &self,
        folder: &Path,
        kind: SideFileKind,
        make: impl FnOnce(C) -> Result<T, String>,
    ) -> Result<T> {
        let (magic, _, what) = kind.names();
        let path = folder.join(&self.file);
        let bytes = input::read(&path, LONGEST)?;
        let refused = |what: &str| {
            let what = format!("{} {what}", path.display());
            Error::mismatch(what, "put the file that was saved with the session beside it")
        };
        if fingerprint(&bytes) != self.fingerprint {
            return Err(refused("is not what the session was saved with"));
        }
        let damaged = || refused(&format!("is no file of a {what}"));
        let content = bytes.strip_prefix(magic).ok_or_else(damaged)?;
        let content = postcard::from_bytes(content).map_err(|e| damaged().because(e))?;
        make(content).map_err(|what| refused(&format!("is wrong: {what}")))
    }
}

fn fingerprint(bytes: &[u8]) -> String {
    format!("xxh3-128:{:032x}", xxh3_128(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_bytes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let content: Vec<f64> = (0..100).map(f64::from).collect();
        for kind in SideFileKind::ALL {
            let (magic, _, what) = kind.names();
            let reference = write(&folder.path().join("edit.toml"), kind, &content).unwrap();
            let path = folder.path().join(&reference.file);
            let read = |reference: &Reference| {
                reference.read(
                    folder.path(),
                    kind,
                    |c: Vec<f64>| if c.is_empty() { Err("none".into()) } else { Ok(c) },
                )
            };
            assert_eq!(read(&reference).unwrap(), content);
            let good = std::fs::read(&path).unwrap();
            let spoil = |bytes: &[u8], fingerprint: &str| {
                output::write_file(&path, bytes).unwrap();
                let reference = Reference { fingerprint: fingerprint.to_owned(), ..reference.clone() };
                read(&reference).unwrap_err().to_string()
            };
            assert!(spoil(&good[..good.len() / 2], &reference.fingerprint).contains("not what the session"));
            // A hash that fits, of bytes that are something else.
            for bytes in [&b"solid"[..], &good[..good.len() / 2], magic] {
                assert!(spoil(bytes, &fingerprint(bytes)).contains(&format!("no file of a {what}")));
            }
            let empty = [magic, &[0]].concat();
            assert!(spoil(&empty, &fingerprint(&empty)).contains("is wrong: none"));
            std::fs::remove_file(&path).unwrap();
            assert!(read(&reference).unwrap_err().to_string().contains(reference.file.to_str().unwrap()));
        }
    }
}
