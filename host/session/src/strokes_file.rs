//! Brush strokes beside a session: what is too much for a readable file.
//!
//! `simod-strokes/1`, a line feed, and the strokes in postcard's encoding. The session names the file with its hash; the
//! name has a part of the hash, so that a session that is saved anew never spoils what the former one refers to.

use crate::session_file::Stroke;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_core::{Error, ErrorKind, Result, output};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_128;

/// What a file begins with.
const MAGIC: &[u8] = b"simod-strokes/1\n";

/// Points of a step's strokes beyond which they go to a file of their own.
const MOST_IN_SESSION: usize = 1000;

/// Digits of the hash in a file's name.
const HASH: usize = 12;

/// What a session says of the file.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Reference {
    /// Relative to the session.
    pub file: PathBuf,
    /// Hash of its bytes.
    pub fingerprint: String,
}

#[derive(Serialize, Deserialize)]
struct Record {
    radius: f64,
    strength: f64,
    points: Vec<[f64; 3]>,
    pressures: Vec<f32>,
    /// As TOML, since values are of any kind.
    params: String,
}

/// Whether strokes are too long for the session itself.
pub fn is_needed(strokes: &[Arc<Stroke>]) -> bool {
    strokes.iter().map(|s| s.points.len()).sum::<usize>() > MOST_IN_SESSION
}

/// Writes strokes beside the session, whole or not at all; a file that is there already with the same content stays.
///
/// # Errors
/// The file cannot be written.
pub fn write(session: &Path, strokes: &[Arc<Stroke>]) -> Result<Reference> {
    let record = |s: &Arc<Stroke>| Record {
        radius: s.radius,
        strength: s.strength,
        points: s.points.iter().map(DVec3::to_array).collect(),
        pressures: s.pressures.clone(),
        params: s.params.to_string(),
    };
    let records: Vec<Record> = strokes.iter().map(record).collect();
    let bytes = postcard::to_extend(&records, MAGIC.to_vec())
        .map_err(|e| Error::new(ErrorKind::Io, format!("cannot write strokes: {e}"), "report this"))?;
    let fingerprint = fingerprint(&bytes);
    let stem = session.file_stem().unwrap_or_default().to_string_lossy();
    let short = fingerprint.rsplit(':').next().and_then(|hex| hex.get(..HASH)).unwrap_or_default();
    let file = PathBuf::from(format!("{stem}-{short}.strokes"));
    let path = output::folder_of(session).join(&file);
    if std::fs::read(&path).ok().as_deref() != Some(&bytes) {
        output::write_file(&path, &bytes)?;
    }
    Ok(Reference { file, fingerprint })
}

/// The files of strokes that sessions at this path have written, used or not.
///
/// # Errors
/// The folder cannot be read.
pub fn beside(session: &Path) -> Result<Vec<PathBuf>> {
    let folder = output::folder_of(session);
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("read", folder, &e))?;
    let stem = session.file_stem().unwrap_or_default().to_string_lossy();
    let is_ours = |path: &Path| {
        let name = path.file_name().and_then(|name| name.to_str());
        let rest = name.and_then(|n| n.strip_prefix(&*stem)?.strip_prefix('-')?.strip_suffix(".strokes"));
        rest.is_some_and(|hex| hex.len() == HASH && hex.bytes().all(|b| b.is_ascii_hexdigit()))
    };
    Ok(entries.flatten().map(|entry| entry.path()).filter(|path| is_ours(path)).collect())
}

impl Reference {
    /// Reads the strokes; `folder` is the session's.
    ///
    /// # Errors
    /// The file cannot be read, is not the one that the session was saved with, or holds what is no stroke.
    pub fn read(&self, folder: &Path) -> Result<Vec<Arc<Stroke>>> {
        let path = folder.join(&self.file);
        let bytes = std::fs::read(&path).map_err(|e| Error::io("read the strokes", &path, &e))?;
        let refused = |what: &str| {
            let what = format!("{} {what}", path.display());
            Error::new(ErrorKind::Mismatch, what, "put the file that was saved with the session beside it")
        };
        if fingerprint(&bytes) != self.fingerprint {
            return Err(refused("is not what the session was saved with"));
        }
        let damaged = || refused("is no file of strokes");
        let records: Vec<Record> =
            postcard::from_bytes(bytes.strip_prefix(MAGIC).ok_or_else(damaged)?).map_err(|_| damaged())?;
        let stroke = |r: Record| {
            let stroke = Stroke {
                radius: r.radius,
                strength: r.strength,
                points: r.points.into_iter().map(DVec3::from_array).collect(),
                pressures: r.pressures,
                params: r.params.parse().map_err(|_| damaged())?,
            };
            match stroke.defect() {
                Some((what, _)) => Err(refused(&format!("holds a wrong stroke: {what}"))),
                None => Ok(Arc::new(stroke)),
            }
        };
        records.into_iter().map(stroke).collect()
    }
}

fn fingerprint(bytes: &[u8]) -> String {
    format!("xxh3-128:{:032x}", xxh3_128(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strokes() -> Vec<Arc<Stroke>> {
        let points: Vec<DVec3> = (0..2000).map(|i| DVec3::new(f64::from(i) * 0.1, 1e7, -1e-9)).collect();
        let params: toml::Table = "brush = \"smooth\"\nfalloff = [[0.0, 1.0], [1.0, 0.0]]".parse().unwrap();
        let pressures = vec![0.25; points.len()];
        let long = Stroke { radius: 2.0, strength: -0.5, points, pressures, params };
        let short = Stroke { points: vec![DVec3::ONE], pressures: Vec::new(), ..long.clone() };
        vec![Arc::new(long), Arc::new(short)]
    }

    #[test]
    fn strokes_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("edit.toml");
        let strokes = strokes();
        assert!(is_needed(&strokes) && !is_needed(&strokes[1..]));
        let reference = write(&session, &strokes).unwrap();
        assert_eq!(reference.read(folder.path()).unwrap(), strokes);
        assert_eq!(write(&session, &strokes).unwrap(), reference, "the same again");
        let other = write(&session, &strokes[1..]).unwrap();
        assert_ne!(other.file, reference.file, "the former session keeps its own");
        assert_eq!(reference.read(folder.path()).unwrap(), strokes);
    }

    #[test]
    fn other_bytes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let reference = write(&folder.path().join("edit.toml"), &strokes()).unwrap();
        let path = folder.path().join(&reference.file);
        let good = std::fs::read(&path).unwrap();
        let spoil = |bytes: &[u8], fingerprint: &str| {
            output::write_file(&path, bytes).unwrap();
            let reference = Reference { fingerprint: fingerprint.to_owned(), ..reference.clone() };
            reference.read(folder.path()).unwrap_err().to_string()
        };
        assert!(spoil(&good[..good.len() / 2], &reference.fingerprint).contains("not what the session"));
        // A hash that fits, of bytes that are no strokes.
        for bytes in [&b"solid"[..], &good[..good.len() / 2], MAGIC] {
            assert!(spoil(bytes, &fingerprint(bytes)).contains("no file of strokes"));
        }
        std::fs::remove_file(&path).unwrap();
        assert!(reference.read(folder.path()).unwrap_err().to_string().contains("cannot read the strokes"));
    }
}
