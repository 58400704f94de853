//! Weights from a file: a table of places with the joints that each of them follows.

use crate::dmat::{Matrix, Wrong};
use crate::influences::{Influences, limited};
use crate::skeleton::{Joint, Skeleton};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use simod_plugin_api::{PluginError, PluginResult};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::num::NonZero;
use std::path::Path;

/// The number of rows, at most.
const MOST_ROWS: usize = 1 << 22;
/// Rows that a place between them is blended of.
const BLENDED: usize = 4;
/// Rows that are so near, as a part of the table's size, are at the place itself.
const SAME: f64 = 1e-7;

/// The number of weights above 0, at most.
const MOST_WEIGHTS: usize = 1 << 26;
/// Negative weights up to this part of the largest are of rounding, or of solvers that keep to bounds nearly.
const ROUND_OFF: f64 = 0.01;
/// Largest difference of the sum of a row's weights from 1 without a warning.
const OFF: f64 = 0.01;
/// Number of joints that a warning names.
const IDS: usize = 5;

/// Table of places and the joints that they follow.
pub struct WeightTable {
    rows: Rows,
    tree: ImmutableKdTree<f64, 3>,
    /// Largest distance from a row's place at which a place counts as the row's.
    same: f64,
}

/// Rows of the table: each place with the joints that it follows, one after the other, as parts of 1.
#[derive(Default)]
struct Rows {
    places: Vec<DVec3>,
    ends: Vec<usize>,
    weights: Vec<(f64, u16)>,
    /// Number of rows that do not sum to 1.
    off: usize,
    /// Row among these whose sum is farthest from 1: its number from 0 on, its line if that is known, and the
    /// sum.
    farthest: Option<(usize, Option<usize>, f64)>,
    /// Ids of joints with bones, of which there is no column.
    without: Vec<String>,
}

impl WeightTable {
    /// The table in a file: a line `x y z` and the ids of joints, and then, line by line, a place and a
    /// weight for each of the joints. Numbers are separated by white space or commas; empty lines and those
    /// that begin with `#` are passed over. Weights are taken as parts of their sum, which is told where it
    /// is not 1.
    ///
    /// Or a DMAT with a column for each bone, in the skeleton's order, and a row for each of the places in a
    /// second file: an OBJ's vertices, or a DMAT with three columns.
    ///
    /// # Errors
    /// Errors name the line, and the column.
    pub fn read(
        path: &Path,
        places: Option<&Path>,
        skeleton: &Skeleton,
        to_local: impl Fn(DVec3) -> DVec3,
    ) -> PluginResult<Self> {
        let rows = match (is_dmat(path), places) {
            (true, Some(places)) => {
                let places = read_places(places).map_err(|(line, what)| {
                    told("places", places, line, &what).hint("give an OBJ, or a DMAT with three columns")
                })?;
                Matrix::read(path).and_then(|m| of_matrix((&m, path), places, skeleton))
            }
            (true, None) => {
                return Err(told("weights", path, None, "is a DMAT, which does not say where its rows are")
                    .hint(
                        "give the mesh that they are of as `places`: an OBJ, or a DMAT with three columns",
                    ));
            }
            (false, _) => {
                let file = File::open(path).map_err(|e| (None, format!("cannot be read: {e}")));
                file.and_then(|file| parse(BufReader::new(file), skeleton))
            }
        };
        let table = rows.and_then(|rows| Self::new(rows, to_local));
        let mut table = table.map_err(|(line, what)| {
            told("weights", path, line, &what).hint(
                "give a line `x y z` with the ids of joints, and then three coordinates and the weights in each; or a \
                 DMAT with a column for each bone",
            )
        })?;
        // Only of that one row, as the file is read again for it.
        if let Some((row, line @ None, _)) = &mut table.rows.farthest
            && is_dmat(path)
        {
            *line = Matrix::read(path).ok().and_then(|matrix| matrix.line(path, *row, 0));
        }
        Ok(table)
    }

    /// Warnings about the table in this file.
    pub fn doubts(&self, path: &Path) -> Vec<String> {
        let Rows { places, off, farthest, without, .. } = &self.rows;
        let mut doubts = Vec::new();
        if let Some((row, line, sum)) = farthest {
            let line = line.map_or(String::new(), |line| format!(", line {line}"));
            let sum = if *sum < 1e6 { format!("{sum:.4}") } else { format!("{sum:.1e}") };
            doubts.push(format!(
                "the weights of {off} of {} rows do not sum to 1, and count as parts of their sums; farthest off is row \
                 {}{line}, with {sum}: {}",
                places.len(),
                row + 1,
                path.display()
            ));
        }
        if !without.is_empty() {
            let ids: Vec<String> = without.iter().take(IDS).map(|id| format!("`{id}`")).collect();
            let more = without.len().checked_sub(IDS).filter(|more| *more > 0);
            let more = more.map_or(String::new(), |more| format!(" and {more} more"));
            doubts.push(format!(
                "there is no column of weights for {}{more}, so that nothing follows these joints: {}",
                ids.join(", "),
                path.display()
            ));
        }
        doubts
    }

    fn new(rows: Rows, to_local: impl Fn(DVec3) -> DVec3) -> Result<Self, Wrong> {
        let at: Vec<[f64; 3]> = rows.places.iter().map(|p| to_local(*p).to_array()).collect();
        let points = || at.iter().map(|p| DVec3::from(*p));
        let size =
            points().fold(DVec3::NEG_INFINITY, DVec3::max) - points().fold(DVec3::INFINITY, DVec3::min);
        if !size.length().is_finite() {
            return Err((None, "has places too far from each other".to_owned()));
        }
        let tree = ImmutableKdTree::new_from_slice(&at);
        let tree = tree.map_err(|_| (None, "has places that cannot be searched".to_owned()))?;
        Ok(Self { rows, tree, same: SAME * size.length() })
    }

    /// Weights of the joints that a place follows, all of them: a row's where the place is the row's, and
    /// otherwise those of the four nearest rows, the nearer ones more. Returns the distance to the nearest
    /// row's place.
    ///
    /// By R. Franke, G. Nielson, *Smooth interpolation of large sets of scattered data*, 1980: a row's part
    /// falls to nothing at the distance of the fifth, so that none jumps where another takes its place.
    pub fn influences_at(&self, p: DVec3, room: &mut Influences) -> f64 {
        let count = NonZero::new(BLENDED + 1).unwrap_or(NonZero::<usize>::MIN);
        let near = self.tree.query(&p.to_array()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let mut near: Vec<(f64, usize)> =
            near.into_iter().map(|n| (n.distance.sqrt(), n.item as usize)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let nearest = near[0].0;
        room.clear();
        let mut add = |row: usize, part: f64| {
            for (weight, joint) in self.rows.row(row) {
                match room.iter_mut().find(|(_, j)| j == joint) {
                    Some((sum, _)) => *sum += part * weight,
                    None => room.push((part * weight, *joint)),
                }
            }
        };
        if nearest <= self.same {
            near.iter().filter(|(d, _)| *d <= self.same).for_each(|(_, row)| add(*row, 1.0));
        } else {
            // A bit further, as all may be as far.
            let far = near.get(BLENDED).map_or(f64::INFINITY, |n| n.0 * (1.0 + 1e-6));
            for (d, row) in &near[..near.len().min(BLENDED)] {
                add(*row, (nearest / d * (1.0 - d / far)).powi(2));
            }
        }
        limited(room, usize::MAX);
        nearest
    }
}

impl Rows {
    fn row(&self, row: usize) -> &[(f64, u16)] {
        let start = if row == 0 { 0 } else { self.ends[row - 1] };
        &self.weights[start..self.ends[row]]
    }

    /// Adds a row, which sums to that in the file. Weights that are a little below 0 are 0.
    fn push(
        &mut self,
        place: DVec3,
        mut weights: Influences,
        (sum, line): (f64, Option<usize>),
    ) -> Result<(), String> {
        let largest = weights.iter().map(|w| w.0).fold(0.0, f64::max);
        if largest == 0.0 {
            return Err("has no weight above 0".to_owned());
        }
        weights.retain(|w| w.0 > 0.0);
        weights.iter_mut().for_each(|w| w.0 /= largest);
        limited(&mut weights, usize::MAX);
        if self.weights.len() + weights.len() > MOST_WEIGHTS {
            return Err(format!("has more than {MOST_WEIGHTS} weights"));
        }
        let is_off = |sum: f64| (sum - 1.0).abs();
        if is_off(sum) > OFF {
            self.off += 1;
            if self.farthest.is_none_or(|(_, _, other)| is_off(sum) > is_off(other)) {
                self.farthest = Some((self.places.len(), line, sum));
            }
        }
        self.weights.extend(weights);
        self.places.push(place);
        self.ends.push(self.weights.len());
        Ok(())
    }
}

/// Whether a weight is so far below 0 that it is no rounding.
fn is_negative(weight: f64, largest: f64) -> bool {
    weight < -ROUND_OFF * largest
}

/// Whether a file is a matrix, whose rows' places are in a second file.
pub fn is_dmat(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("dmat"))
}

fn told(param: &str, path: &Path, line: Option<usize>, what: &str) -> PluginError {
    let place = line.map_or(String::new(), |n| format!(", line {n}"));
    PluginError::parameter(param, &format!("{what}: {}{place}", path.display()))
}

/// The rows of a matrix, which is in a file.
fn of_matrix(
    (matrix, path): (&Matrix, &Path),
    places: Vec<DVec3>,
    skeleton: &Skeleton,
) -> Result<Rows, Wrong> {
    if matrix.columns != skeleton.bone_count() {
        let (columns, bones) = (matrix.columns, skeleton.bone_count());
        return Err((Some(1), format!("has {columns} columns, and the skeleton {bones} bones")));
    }
    if matrix.rows != places.len() {
        let what = format!("has {} rows, and there are {} places", matrix.rows, places.len());
        return Err((Some(1), what));
    }
    if matrix.rows == 0 || matrix.rows > MOST_ROWS {
        return Err((Some(1), format!("has {} rows, and 1 to {MOST_ROWS} can be", matrix.rows)));
    }
    let mut rows = Rows::default();
    for (row, place) in places.into_iter().enumerate() {
        let wrong =
            |what: &str, bone: usize| (matrix.line(path, row, bone), format!("{what} in row {}", row + 1));
        let all = || (0..matrix.columns).map(|bone| matrix.number(row, bone));
        let (largest, sum) = (all().fold(0.0, f64::max), all().sum());
        let mut weights: Influences = Vec::new();
        for bone in 0..matrix.columns {
            let (weight, joint) = (matrix.number(row, bone), skeleton.mover(bone) as u16);
            if is_negative(weight, largest) {
                return Err(wrong("has a negative weight", bone));
            }
            match weights.iter_mut().find(|(_, j)| *j == joint) {
                Some((sum, _)) => *sum += weight.max(0.0),
                None => weights.push((weight.max(0.0), joint)),
            }
        }
        rows.push(place, weights, (sum, None)).map_err(|what| wrong(&what, 0))?;
    }
    Ok(rows)
}

/// The vertices of an OBJ, or the rows of a DMAT.
fn read_places(path: &Path) -> Result<Vec<DVec3>, Wrong> {
    if is_dmat(path) {
        let matrix = Matrix::read(path)?;
        if matrix.columns != 3 {
            return Err((None, format!("has {} columns instead of three", matrix.columns)));
        }
        return Ok((0..matrix.rows).map(|row| [0, 1, 2].map(|k| matrix.number(row, k)).into()).collect());
    }
    let file = File::open(path).map_err(|e| (None, format!("cannot be read: {e}")))?;
    let mut places = Vec::new();
    for (number, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|e| (Some(number + 1), format!("cannot be read: {e}")))?;
        let mut words = line.split_whitespace();
        if words.next() != Some("v") {
            continue;
        }
        if places.len() == MOST_ROWS {
            return Err((Some(number + 1), format!("has more than {MOST_ROWS} vertices")));
        }
        let mut next = || words.next().and_then(|w| w.parse::<f64>().ok()).filter(|x| x.is_finite());
        match [next(), next(), next()] {
            [Some(x), Some(y), Some(z)] => places.push(DVec3::new(x, y, z)),
            _ => return Err((Some(number + 1), "has a vertex without three finite coordinates".to_owned())),
        }
    }
    Ok(places)
}

/// The rows of a table.
fn parse(text: impl BufRead, skeleton: &Skeleton) -> Result<Rows, Wrong> {
    let mut columns: Option<Vec<(String, usize)>> = None;
    let mut rows = Rows::default();
    for (number, line) in text.lines().enumerate() {
        let number = number + 1;
        let line = line.map_err(|e| (Some(number), format!("cannot be read: {e}")))?;
        let words = || line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
        match (words().next(), &columns) {
            (None, _) => {}
            (Some(word), _) if word.starts_with('#') => {}
            (_, None) => columns = Some(header(words(), skeleton).map_err(|what| (Some(number), what))?),
            (_, Some(_)) if rows.places.len() == MOST_ROWS => {
                return Err((Some(number), format!("has more than {MOST_ROWS} rows")));
            }
            (_, Some(columns)) => {
                let row = row(words(), columns).and_then(|(place, weights)| {
                    let sum = weights.iter().map(|w| w.0).sum();
                    rows.push(place, weights, (sum, Some(number)))
                });
                row.map_err(|what| (Some(number), what))?;
            }
        }
    }
    match (columns, rows.places.is_empty()) {
        (None, _) => Err((None, "is empty".to_owned())),
        (_, true) => Err((None, "has no rows".to_owned())),
        (Some(columns), _) => {
            let joints = skeleton.joints.iter().enumerate();
            let lacks = |(i, joint): &(usize, &Joint)| {
                !joint.is_end() && columns.iter().all(|(_, column)| column != i)
            };
            rows.without = joints.filter(lacks).map(|(_, joint)| joint.id.clone()).collect();
            Ok(rows)
        }
    }
}

/// The joints of the columns after the first three.
fn header<'a>(
    mut words: impl Iterator<Item = &'a str>,
    skeleton: &Skeleton,
) -> Result<Vec<(String, usize)>, String> {
    for axis in ["x", "y", "z"] {
        if words.next() != Some(axis) {
            return Err("does not begin with the columns x, y and z".to_owned());
        }
    }
    let mut columns: Vec<(String, usize)> = Vec::new();
    for id in words {
        let joint =
            skeleton.find(id).ok_or_else(|| format!("has a column `{id}`, and there is no such joint"))?;
        if skeleton.joints[joint].is_end() {
            return Err(format!(
                "has a column `{id}`, and no joint hangs on that one, so that it has no bone"
            ));
        }
        if columns.iter().any(|(known, _)| known == id) {
            return Err(format!("has two columns `{id}`"));
        }
        columns.push((id.to_owned(), joint));
    }
    if columns.is_empty() { Err("has no columns of joints".to_owned()) } else { Ok(columns) }
}

/// Place, and the weights of the joints that it follows.
fn row<'a>(
    words: impl Iterator<Item = &'a str>,
    columns: &[(String, usize)],
) -> Result<(DVec3, Influences), String> {
    let words: Vec<&str> = words.collect();
    if words.len() != 3 + columns.len() {
        return Err(format!("has {} numbers instead of {}", words.len(), 3 + columns.len()));
    }
    let number = |column: &str, word: &str| {
        let number = word.parse::<f64>().ok().filter(|x| x.is_finite());
        number.ok_or_else(|| format!("has `{word}` in column `{column}`, and that is no finite number"))
    };
    let at = DVec3::new(number("x", words[0])?, number("y", words[1])?, number("z", words[2])?);
    let mut weights = Vec::with_capacity(columns.len());
    for ((id, joint), word) in columns.iter().zip(&words[3..]) {
        weights.push((number(id, word)?, *joint as u16));
    }
    let largest = weights.iter().map(|w| w.0).fold(0.0, f64::max);
    match weights.iter().position(|w| is_negative(w.0, largest)) {
        Some(i) => Err(format!("has a negative weight in column `{}`", columns[i].0)),
        None => Ok((at, weights)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use simod_plugin_api::Joint as Given;
    use std::io::Write;

    fn skeleton() -> Skeleton {
        let joint = |id, x, parent| Given::new(id, [x, 0.0, 0.0], parent);
        Skeleton::new(&[joint("a", 0.0, Given::ROOT), joint("b", 1.0, 0), joint("tip", 2.0, 1)]).unwrap()
    }

    fn read(text: &str) -> PluginResult<WeightTable> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        WeightTable::read(file.path(), None, &skeleton(), |p| p)
    }

    fn at(table: &WeightTable, p: [f64; 3]) -> [f64; 2] {
        let mut weights = [0.0; 2];
        let mut room = Vec::new();
        table.influences_at(p.into(), &mut room);
        room.iter().for_each(|(w, j)| weights[usize::from(*j)] = *w);
        weights
    }

    #[test]
    fn rows_are_met_and_blended() {
        let table =
            read("# by hand\nx y z b a\n0 0 0 0 1\n1,0,0,3,1\n\n1 1 0 1 0\n 0\t1 0 0 7e300\n5 5 5 1 0\n")
                .unwrap();
        assert_eq!(at(&table, [0.0; 3]), [1.0, 0.0]);
        assert_eq!(at(&table, [1.0, 0.0, 0.0]), [0.25, 0.75]);
        let [a, b] = at(&table, [0.5, 0.5, 0.0]);
        assert!((a - 0.5625).abs() < 1e-12 && (a + b - 1.0).abs() < 1e-12, "{a} {b}");
        let [a, _] = at(&table, [0.1, 0.0, 0.0]);
        assert!(a > 0.97 && a < 1.0, "{a}");
        // Two rows in one place count as their mean.
        let table = read("x y z a b\n0 0 0 1 0\n0 0 0 0 1\n1 0 0 1 0\n").unwrap();
        assert_eq!(at(&table, [0.0; 3]), [0.5, 0.5]);
        assert_eq!(at(&read("x y z a\n3 0 0 2").unwrap(), [0.0; 3]), [1.0, 0.0]);
    }

    #[test]
    fn a_matrix_is_read_with_its_places() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &[u8]| {
            let path = folder.path().join(name);
            std::fs::File::create(&path).unwrap().write_all(text).unwrap();
            path
        };
        // Rounding below 0 is nothing.
        let weights = write("weights.dmat", b"2 3\n1 0.25 -1e-9\n-0.003 0.75 2\n");
        let obj =
            write("mesh.obj", b"# mesh\nv 0 0 0 1 1 1\nvn 0 0 1\nv 1 0 0\nv 2 0 0\nv\t9 9 9\nf 1 2 3\n");
        let read = |weights: &Path, places: &Path| {
            WeightTable::read(weights, Some(places), &skeleton(), |p| p).map_err(|e| e.message.to_string())
        };
        assert!(read(&weights, &obj).err().unwrap().contains("3 rows, and there are 4 places"));
        let places = write("places.dmat", b"3 3\n0 1 2 0 0 0 0 0 0\n");
        let table = read(&weights, &places).unwrap();
        assert_eq!(
            [0.0, 1.0, 2.0].map(|x| at(&table, [x, 0.0, 0.0])),
            [[1.0, 0.0], [0.25, 0.75], [0.0, 1.0]]
        );
        let error = WeightTable::read(&weights, None, &skeleton(), |p| p).err().unwrap();
        assert!(error.message.contains("where its rows are") && error.hint.contains("places"), "{error}");
        let negative = write("negative.dmat", b"2 3\n1 1 1\n-0.02 0 0\n");
        assert!(read(&negative, &places).err().unwrap().contains("negative weight in row 1"));
        let wide = write("wide.dmat", b"3 3\n1 1 1 1 1 1 1 1 1\n");
        assert!(read(&wide, &places).err().unwrap().contains("3 columns, and the skeleton 2 bones"));
        assert!(read(&weights, &weights).err().unwrap().contains("2 columns instead of three"));
        let damaged = write("damaged.obj", b"v 0 0 0\nv 1 0 nan\n");
        assert!(read(&weights, &damaged).err().unwrap().contains("line 2"));
    }

    #[test]
    fn sums_and_columns_that_are_doubtful_are_told() {
        let doubts = |text: &str| read(text).unwrap().doubts(Path::new("w.txt"));
        assert_eq!(doubts("x y z a b\n0 0 0 1 0\n1 0 0 0.333 0.666\n"), [""; 0]);
        let off = doubts("x y z b a\n0 0 0 0.3 0.5\n1 0 0 1 1.5\n2 0 0 0.6 0.4\n");
        let told = "the weights of 2 of 3 rows do not sum to 1, and count as parts of their sums; farthest off is row \
                    2, line 3, with 2.5000: w.txt";
        assert_eq!(off, [told]);
        let [huge] = &doubts("x y z b a\n0 0 0 0 7e300\n")[..] else { panic!("one") };
        assert!(huge.contains("with 7.0e300"), "{huge}");
        let [without] = &doubts("x y z b\n0 0 0 1\n")[..] else { panic!("one") };
        assert!(without.contains("no column of weights for `a`,") && without.contains("w.txt"), "{without}");
    }

    /// Damaged files are an error or a table, whose weights are parts of one, and nothing panics.
    #[test]
    fn damaged_files_do_no_harm() {
        let good = "# by hand\nx y z b a\n0 0 0 0 1\n1,0,0,3,1\n\n1 1 0 1 0\n0 1 0 0 7e300\n5 5 5 1 0\n";
        assert!(read(good).is_ok());
        simod_tests::damage::damaged_files(good, 500, |path| {
            if let Ok(table) = WeightTable::read(path, None, &skeleton(), |p| p) {
                let sum: f64 = at(&table, [0.3, 0.2, 0.0]).iter().sum();
                assert!((sum - 1.0).abs() < 1e-9, "{sum}");
            }
        });
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let told = |text: &str, parts: &[&str]| {
            let error = read(text).err().unwrap();
            for part in parts {
                assert!(error.message.contains(part), "{part}: {error}");
            }
            assert!(!error.hint.is_empty(), "{text}");
        };
        told("", &["is empty"]);
        told("x y z a b\n# nothing\n", &["no rows"]);
        told("x z y a\n0 0 0 1", &["x, y and z", "line 1"]);
        told("x y z\n0 0 0", &["no columns", "line 1"]);
        told("x y z a c\n", &["`c`", "no such joint", "line 1"]);
        told("x y z a tip\n", &["`tip`", "no bone", "line 1"]);
        told("x y z a a\n", &["two columns `a`", "line 1"]);
        told("x y z a b\n0 0 0 1\n", &["4 numbers instead of 5", "line 2"]);
        told("x y z a b\n0 0 0 1 0 1\n", &["6 numbers instead of 5", "line 2"]);
        told("x y z a b\n0 0 0 1 -1\n", &["negative", "`b`", "line 2"]);
        told("x y z a b\n0 0 0 1 NaN\n", &["`NaN`", "`b`", "line 2"]);
        told("x y z a b\n0 1e999 0 1 0\n", &["`1e999`", "`y`", "line 2"]);
        told("x y z a b\n0 0 0 0 0\n", &["no weight above 0", "line 2"]);
        told("x y z a b\n1e308 0 0 1 0\n-1e308 0 0 1 0\n", &["too far"]);
        let error = WeightTable::read(Path::new("/nowhere"), None, &skeleton(), |p| p).err().unwrap();
        assert!(error.message.contains("/nowhere"), "{error}");
    }

    proptest! {
        #[test]
        fn nothing_makes_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes[..], &skeleton());
        }

        #[test]
        fn nor_does_what_looks_right(lines in prop::collection::vec("[0-9ab.,e -]{0,14}", 0..8)) {
            let text = format!("x y z a b\n{}", lines.join("\n"));
            let _ = parse(text.as_bytes(), &skeleton()).and_then(|rows| WeightTable::new(rows, |p| p));
        }
    }
}
