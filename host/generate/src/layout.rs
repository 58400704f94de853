//! Rows of vertices on patches: their numbers and places, and the triangles between them.
//!
//! Every row has its own number of columns, so a vase is sampled evenly from its foot to its belly, and poles
//! are single vertices. Two neighbouring rows are sewn together like a zip.

use super::{BodyRows, SurfaceVertex};

/// Fewest columns of a closed row that is no pole.
const MIN_COLUMNS: u64 = 5;
/// Fewest rows of a patch.
const MIN_ROWS: u64 = 4;

/// A surface with parameters: rows follow its length, and each row goes along (or around) its width.
pub(super) trait SurfacePatch: Sync + Send {
    /// Length, across the rows.
    fn length(&self) -> f64;

    /// Width of the row at a `distance` from the patch's first row; 0 for a pole.
    fn width(&self, distance: f64) -> f64;

    /// Whether rows are closed.
    fn is_wrapped(&self) -> bool;

    /// Distances at which the surface has an edge, ascending: there are rows just there.
    fn creases(&self) -> &[f64] {
        &[]
    }

    /// Appends the `columns` vertices of a row.
    fn row(&self, distance: f64, columns: u32, vertices: &mut Vec<SurfaceVertex>);
}

/// A patch with its rows.
struct RowLayout {
    patch: Box<dyn SurfacePatch>,
    columns: Vec<u32>,
    /// Index in the model of each row's first vertex, and of the first one after the patch.
    first: Vec<u64>,
}

impl BodyRows for RowLayout {
    fn rows(&self) -> usize {
        self.columns.len()
    }

    fn row_len(&self, row: usize) -> u64 {
        u64::from(self.columns[row])
    }

    fn row(&self, row: usize, vertices: &mut Vec<SurfaceVertex>) {
        let distance = distance(self.patch.as_ref(), row as u64, self.rows() as u64);
        self.patch.row(distance, self.columns[row], vertices);
    }

    fn strip_len(&self, row: usize) -> u64 {
        let Some(next) = self.columns.get(row + 1) else { return 0 };
        let (a, b) = (u64::from(self.columns[row]), u64::from(*next));
        match (self.patch.is_wrapped(), a, b) {
            (true, 1, n) | (true, n, 1) => n,
            (true, ..) => a + b,
            (false, ..) => a + b - 2,
        }
    }

    fn strip(&self, row: usize, triangles: &mut Vec<[u64; 3]>) {
        let Some(next) = self.columns.get(row + 1) else { return };
        let (na, nb) = (u64::from(self.columns[row]), u64::from(*next));
        let (a, b) = (self.first[row], self.first[row + 1]);
        // Edges of each row, and their number per full width, to compare how far both sides have come.
        let edges = |n: u64| {
            if !self.patch.is_wrapped() {
                n - 1
            } else if n == 1 {
                0
            } else {
                n
            }
        };
        let (ea, eb) = (edges(na), edges(nb));
        let (mut i, mut j) = (0, 0);
        while i < ea || j < eb {
            // Compares the middles of the two candidate edges: the shorter diagonal wins.
            if j == eb || (i < ea && (2 * i + 1) * eb <= (2 * j + 1) * ea) {
                triangles.push([a + i % na, b + j % nb, a + (i + 1) % na]);
                i += 1;
            } else {
                triangles.push([a + i % na, b + j % nb, b + (j + 1) % nb]);
                j += 1;
            }
        }
    }
}

/// Lays exactly `vertices` vertices on the patches, evenly.
pub(super) fn lay_out(patches: Vec<Box<dyn SurfacePatch>>, vertices: u64) -> Vec<Box<dyn BodyRows>> {
    // The widest spacing is halved until it gives enough, then bisected. The count is not quite monotonic,
    // as it is rounded by rows; any spacing slightly too wide will do, since the rest is dealt out below.
    let count = |spacing: f64| -> u64 {
        patches.iter().map(|p| columns(p.as_ref(), spacing).map(u64::from).sum::<u64>()).sum()
    };
    let mut narrow = patches.iter().map(|p| p.length()).fold(0.0, f64::max);
    let mut wide = narrow;
    while count(narrow) <= vertices {
        wide = narrow;
        narrow *= 0.5;
    }
    for _ in 0..24 {
        let middle = (narrow * wide).sqrt();
        if count(middle) <= vertices {
            wide = middle;
        } else {
            narrow = middle;
        }
    }
    let mut rows: Vec<Vec<u32>> = patches.iter().map(|p| columns(p.as_ref(), wide).collect()).collect();

    // Deal out what the rounding left, in proportion to what the rows have; poles stay poles.
    let dealt: u64 = rows.iter().flatten().map(|&c| u64::from(c)).sum();
    let rest = u128::from(vertices.saturating_sub(dealt));
    let total: u128 = rows.iter().flatten().filter(|&&c| c > 1).map(|&c| u128::from(c)).sum();
    let mut seen = 0;
    for columns in rows.iter_mut().flatten().filter(|c| **c > 1) {
        let before = rest * seen / total;
        seen += u128::from(*columns);
        *columns += (rest * seen / total - before) as u32;
    }

    let mut next = 0;
    patches
        .into_iter()
        .zip(rows)
        .map(|(patch, columns)| -> Box<dyn BodyRows> {
            let mut first = Vec::with_capacity(columns.len() + 1);
            first.push(next);
            for &c in &columns {
                next += u64::from(c);
                first.push(next);
            }
            Box::new(RowLayout { patch, columns, first })
        })
        .collect()
}

/// Columns of each row of a patch at a given spacing.
fn columns(patch: &dyn SurfacePatch, spacing: f64) -> impl Iterator<Item = u32> {
    let length = patch.length();
    let rows = ((length / spacing).round() as u64 + 1).max(MIN_ROWS);
    (0..rows).map(move |row| {
        let width = patch.width(distance(patch, row, rows));
        let steps = (width / spacing).round() as u64;
        let columns = match (patch.is_wrapped(), width < 1e-9) {
            (true, true) => 1,
            (true, false) => steps.max(MIN_COLUMNS),
            (false, _) => steps + 1,
        };
        columns.clamp(1, u64::from(u32::MAX)) as u32
    })
}

/// Distance of a row of so many from the patch's first one. The rows between two creases are spread evenly.
fn distance(patch: &dyn SurfacePatch, row: u64, rows: u64) -> f64 {
    let (length, last) = (patch.length(), rows - 1);
    let (mut from, mut start) = (0, 0.0);
    for &crease in patch.creases() {
        let to = (crease / length * last as f64).round() as u64;
        if row < to {
            return start + (crease - start) * (row - from) as f64 / (to - from) as f64;
        }
        (from, start) = (to, crease);
    }
    start + (length - start) * (row - from) as f64 / (last - from).max(1) as f64
}
