//! Poses of bones from a file: a transform of each bone for each frame.

use crate::blend::CANNOT;
use crate::dmat::{Matrix, Wrong};
use glam::{DAffine3, DMat3, DVec3};
use simod_plugin_api::{ModelFrame, PluginError, PluginResult};
use std::path::{Path, PathBuf};

/// Largest number of bytes of a file.
const MOST_BYTES: u64 = 1 << 30;
/// Numbers of a transform: the rows of a 3 × 4 matrix.
const NUMBERS: usize = 12;

/// Numbers beyond it, in local coordinates, are no motion of a model.
const MOST: f64 = 1e15;

/// Motion of each bone in each frame, in local coordinates.
pub struct Frames {
    path: PathBuf,
    bones: usize,
    /// Motions of all bones, frame after frame.
    motions: Vec<DAffine3>,
    /// Line of each motion in the file; empty of a DMAT.
    lines: Vec<u32>,
}

/// Transforms, and the line of each, if it has one.
type TransformRows = (Vec<[f64; NUMBERS]>, Vec<u32>);

impl Frames {
    /// The poses in a file. Text has a line of 12 numbers for each bone of the first frame, then of the
    /// second, and so on; empty lines, and those that begin with `#`, are passed over. A DMAT has 12 columns
    /// with the same, or 3 with four rows for each bone, as libigl's `lbs_matrix` takes them. All are in the
    /// model's coordinates.
    ///
    /// # Errors
    /// Errors name the line.
    pub fn read(path: &Path, bones: usize, frame: ModelFrame) -> PluginResult<Self> {
        let is_matrix = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("dmat"));
        let rows = if is_matrix { Matrix::read(path).and_then(|m| of_matrix(&m)) } else { of_text(path) };
        let rows = rows.and_then(|rows| match (rows.0.len(), bones) {
            (0, _) => Err((None, "has no transforms".to_owned())),
            (n, bones) if !n.is_multiple_of(bones) => {
                let what = format!(
                    "has {n} transforms, and the skeleton has {bones} bones, of which each frame needs one"
                );
                Err((None, what))
            }
            _ => Ok(rows),
        });
        let (rows, lines) = rows.map_err(|(line, what)| {
            let line = line.map_or(String::new(), |line| format!(", line {line}"));
            PluginError::parameter("pose", &format!("{what}: {}{line}", path.display()))
                .hint("give a line of 12 numbers for each bone and frame, the rows of a 3 × 4 matrix")
        })?;
        let motions = rows.iter().map(|row| local(row, &frame)).collect();
        let frames = Self { path: path.to_owned(), bones, motions, lines };
        // Numbers that are not finite are refused as well.
        let is_small = |m: &DAffine3| m.to_cols_array().iter().all(|x| x.abs() <= MOST);
        match frames.motions.iter().position(|m| !is_small(m)) {
            None => Ok(frames),
            Some(i) => Err(frames
                .wrong(i, "has numbers that are too large")
                .hint("give transforms in the model's coordinates")),
        }
    }

    /// An error about a transform.
    fn wrong(&self, transform: usize, what: &str) -> PluginError {
        let place = match self.lines.get(transform) {
            Some(line) => format!("line {line}"),
            None => format!("transform {}", transform + 1),
        };
        PluginError::parameter("pose", &format!("{what}: {}, {place}", self.path.display()))
    }

    /// The error that a bone's motion in a frame mirrors or flattens.
    pub fn mirrors(&self, frame: i64, bone: usize) -> PluginError {
        let before = usize::try_from(frame).unwrap_or(0) * self.bones;
        self.wrong(before + bone, "mirrors or flattens").hint(CANNOT)
    }

    /// The motions of a frame.
    ///
    /// # Errors
    /// There is no such frame.
    pub fn of_frame(&self, frame: i64) -> PluginResult<&[DAffine3]> {
        let count = self.motions.len() / self.bones;
        let frame = usize::try_from(frame).ok().filter(|f| *f < count).ok_or_else(|| {
            PluginError::parameter("pose", &format!("has {count} frames, and none of number {frame}"))
                .hint(format!("take a frame from 0 to {}", count - 1))
        })?;
        Ok(&self.motions[frame * self.bones..(frame + 1) * self.bones])
    }
}

/// Transform in local coordinates, from one in the model's.
fn local(row: &[f64; NUMBERS], frame: &ModelFrame) -> DAffine3 {
    let matrix3 =
        DMat3::from_cols_array(&[row[0], row[4], row[8], row[1], row[5], row[9], row[2], row[6], row[10]]);
    let origin = DVec3::from(frame.origin);
    let shift = DVec3::new(row[3], row[7], row[11]);
    // Differences from the identity, so that what does not move stays.
    let moved = (matrix3 - DMat3::IDENTITY) * origin + shift;
    DAffine3 { matrix3, translation: moved / frame.scale }
}

fn of_text(path: &Path) -> Result<TransformRows, Wrong> {
    let unreadable = |e: std::io::Error| (None, format!("cannot be read: {e}"));
    if std::fs::metadata(path).map_err(unreadable)?.len() > MOST_BYTES {
        return Err((None, "is too large".to_owned()));
    }
    parse(&std::fs::read_to_string(path).map_err(unreadable)?)
}

fn parse(text: &str) -> Result<TransformRows, Wrong> {
    let (mut rows, mut lines) = (Vec::new(), Vec::new());
    for (number, line) in (1..).zip(text.lines()) {
        let wrong = |what: String| (Some(number), what);
        let words = || line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
        if words().next().is_none_or(|word| word.starts_with('#')) {
            continue;
        }
        let count = words().count();
        if count != NUMBERS {
            return Err(wrong(format!("has {count} numbers instead of {NUMBERS}")));
        }
        let mut row = [0.0; NUMBERS];
        for (x, word) in row.iter_mut().zip(words()) {
            let number = word.parse().ok().filter(|x: &f64| x.is_finite());
            *x = number.ok_or_else(|| wrong(format!("has `{word}`, and that is no finite number")))?;
        }
        rows.push(row);
        lines.push(number as u32);
    }
    Ok((rows, lines))
}

fn of_matrix(matrix: &Matrix) -> Result<TransformRows, Wrong> {
    let whole = |row: usize| std::array::from_fn(|k| matrix.number(row, k));
    let stacked = |bone: usize| std::array::from_fn(|k| matrix.number(4 * bone + k % 4, k / 4));
    match (matrix.columns, matrix.rows) {
        (NUMBERS, rows) => Ok(((0..rows).map(whole).collect(), Vec::new())),
        (3, rows) if rows.is_multiple_of(4) => Ok(((0..rows / 4).map(stacked).collect(), Vec::new())),
        (columns, rows) => {
            Err((Some(1), format!("has {rows} rows of {columns}, instead of 12, or of 3 in fours")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;

    const FRAME: ModelFrame = ModelFrame { origin: [5.0, -2.0, 1.0], scale: 4.0 };

    fn read(text: &[u8], extension: &str, bones: usize) -> PluginResult<Frames> {
        let mut file = tempfile::Builder::new().suffix(extension).tempfile().unwrap();
        file.write_all(text).unwrap();
        Frames::read(file.path(), bones, FRAME)
    }

    #[test]
    fn transforms_are_of_the_model() {
        let frames =
            read(b"# two frames\n1 0 0 0 0 1 0 0 0 0 1 0\n\n0,-1,0,3, 1 0 0 4 0 0 1 5\n", ".txt", 1).unwrap();
        assert_eq!(frames.of_frame(0).unwrap(), [DAffine3::IDENTITY]);
        let p = DVec3::new(0.25, 0.5, -0.75);
        let q = frames.of_frame(1).unwrap()[0].transform_point3(p);
        let x = DVec3::from(FRAME.to_model(p.to_array()));
        let y = DVec3::new(-x.y + 3.0, x.x + 4.0, x.z + 5.0);
        assert!(q.distance(FRAME.to_local(y.to_array()).into()) < 1e-12, "{q}");
        assert!(frames.of_frame(2).unwrap_err().message.contains("2 frames") && frames.of_frame(-1).is_err());
        // The same as libigl has it: transposes on top of each other; or row by row.
        let stacked = b"3 8\n1 0 0 0 0 -1 0 3 0 1 0 0 1 0 0 4 0 0 1 0 0 0 1 5\n";
        let rows = b"12 2\n1 0 0 -1 0 0 0 3 0 1 1 0 0 0 0 4 0 0 0 0 1 1 0 5\n";
        for text in [&stacked[..], rows] {
            let same = read(text, ".dmat", 2).unwrap();
            assert_eq!(same.motions, frames.motions);
        }
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let told = |text: &[u8], extension: &str, bones: usize, what: &str| {
            let error = read(text, extension, bones).err().unwrap();
            assert!(error.message.contains(what) && !error.hint.is_empty(), "{error}");
        };
        told(b"", ".txt", 1, "no transforms");
        told(b"1 2 3\n", ".txt", 1, "3 numbers instead of 12");
        told(b"1 2 3\n", ".txt", 1, ".txt, line 1");
        told(b"#\n1 0 0 0 0 1 0 0 0 0 1 nan\n", ".txt", 1, "`nan`");
        told(b"#\n1 0 0 0 0 1 0 0 0 0 1 nan\n", ".txt", 1, ".txt, line 2");
        told(b"\n1e40 0 0 0 0 1 0 0 0 0 1 0\n", ".txt", 1, ".txt, line 2");
        told(b"12 1\n1e40 0 0 0 0 1 0 0 0 0 1 0\n", ".dmat", 1, ".dmat, transform 1");
        told(b"12 1\n1 0 0 0 0 1 0 0 0 0\n1\nx\n", ".dmat", 1, ".dmat, line 4");
        told(b"1 0 0 0 0 1 0 0 0 0 1 0\n", ".txt", 2, "1 transforms, and the skeleton has 2 bones");
        told(b"5 1\n1 2 3 4 5\n", ".dmat", 1, "1 rows of 5");
        told(b"1e308 0 0 0 0 1 0 0 0 0 1 0\n", ".txt", 1, "too large");
        assert!(Frames::read(Path::new("/nowhere"), 1, FRAME).err().unwrap().message.contains("/nowhere"));
    }

    proptest! {
        #[test]
        fn nothing_makes_it_panic(text in "[0-9a#, \n.e-]{0,200}") {
            let _ = parse(&text);
        }
    }
}
