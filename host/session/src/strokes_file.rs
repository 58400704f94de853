//! Brush strokes in a file [beside](crate::side_file) a session: `NAME-HASH.strokes`.

use crate::side_file::{MOST_IN_SESSION, Reference, SideFileKind, write as write_file};
use crate::stroke::Stroke;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_model::Result;
use std::path::Path;
use std::sync::Arc;

#[derive(Serialize, Deserialize)]
struct FileStroke {
    radius: f64,
    strength: f64,
    points: Vec<[f64; 3]>,
    pressures: Vec<f32>,
    /// Parameters as TOML, since values are of any kind.
    params: String,
}

/// Whether a step's strokes need a file, as they are too long for the session itself.
pub fn is_needed(strokes: &[Arc<Stroke>]) -> bool {
    strokes.iter().map(|s| s.points.len()).sum::<usize>() > MOST_IN_SESSION
}

/// Writes strokes beside the session.
///
/// # Errors
/// The file cannot be written.
pub fn write(session: &Path, strokes: &[Arc<Stroke>]) -> Result<Reference> {
    let record = |s: &Arc<Stroke>| FileStroke {
        radius: s.radius,
        strength: s.strength,
        points: s.points.iter().map(DVec3::to_array).collect(),
        pressures: s.pressures.clone(),
        params: s.params.to_string(),
    };
    write_file(session, SideFileKind::Strokes, &strokes.iter().map(record).collect::<Vec<_>>())
}

/// Reads the strokes of a file; `folder` is the session's.
///
/// # Errors
/// The file cannot be read, is not the one that the session was saved with, or holds what is no stroke.
pub fn read(reference: &Reference, folder: &Path) -> Result<Vec<Arc<Stroke>>> {
    let stroke = |r: FileStroke| {
        let stroke = Stroke {
            radius: r.radius,
            strength: r.strength,
            points: r.points.into_iter().map(DVec3::from_array).collect(),
            pressures: r.pressures,
            params: r.params.parse().map_err(|_| "the parameters of a stroke are no TOML".to_owned())?,
        };
        stroke.defect().map_or(Ok(()), |(what, _)| Err(what.to_owned()))?;
        Ok(Arc::new(stroke))
    };
    reference.read(folder, SideFileKind::Strokes, |records: Vec<FileStroke>| {
        records.into_iter().map(stroke).collect()
    })
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
        assert_eq!(read(&reference, folder.path()).unwrap(), strokes);
        assert_eq!(write(&session, &strokes).unwrap(), reference, "the same again");
        let other = write(&session, &strokes[1..]).unwrap();
        assert_ne!(other.file, reference.file, "the former session keeps its own");
        assert_eq!(read(&reference, folder.path()).unwrap(), strokes);
    }

    #[test]
    fn wrong_strokes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let nowhere =
            vec![Arc::new(Stroke { points: Vec::new(), pressures: Vec::new(), ..(*strokes()[0]).clone() })];
        let reference = write(&folder.path().join("edit.toml"), &nowhere).unwrap();
        assert!(read(&reference, folder.path()).unwrap_err().to_string().contains("no point"));
    }
}
