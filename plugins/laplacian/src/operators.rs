//! Sums of the elements, row by row: the Laplacian, areas, and the action of rotations of the samples'
//! surroundings.
//!
//! O. Sorkine, M. Alexa, *As-Rigid-As-Possible Surface Modeling*, SGP 2007, with the triangles around a
//! sample as its surroundings (*spokes and rims*; I. Chao et al., *A Simple Geometric Model for Elastic
//! Deformations*, SIGGRAPH 2010): the sum over elements of their energies under the rotation of each corner,
//! a third each, is never negative, whatever the signs of the cotangents.

use crate::elements::SurfaceTriangle;
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};

/// Rows at once on one thread.
const TOGETHER: usize = 2048;
/// Areas are at least this part of the mean.
const LEAST_AREA: f64 = 1e-6;

/// Sparse rows; all matrices have the same pattern, which is symmetric.
#[derive(Debug, Default)]
pub struct Operators {
    starts: Vec<usize>,
    columns: Vec<u32>,
    /// The Laplacian, positive semi-definite: half the sum of cotangents, negative, off the diagonal.
    stiffness: Vec<f64>,
    /// Factors of `R_j` in the sum over `j` of `R_j k_ij`: the rotated Laplacian of the positions at `i`.
    out: Vec<[f32; 3]>,
    /// Factors in that sum with `i` and `j` exchanged.
    into: Vec<[f32; 3]>,
    /// Voronoi areas.
    pub areas: Vec<f64>,
}

/// Entries of the matrices for two samples, or for one and itself.
#[derive(Debug, Clone, Copy)]
pub struct MatrixEntry {
    /// The other sample.
    pub column: usize,
    /// The entry of the Laplacian.
    pub stiffness: f64,
    /// The entry of the rotated Laplacian.
    pub out: DVec3,
    /// The entry of its transpose.
    pub into: DVec3,
}

impl Operators {
    /// Sums up elements whose corners are below the number of positions.
    pub fn new(rest: &[DVec3], elements: &[SurfaceTriangle], host: &Host<'_>) -> PluginResult<Self> {
        let at = |i: u32| rest[i as usize];
        let corners = SampleElements::new(rest.len(), elements);
        let mut rows: Vec<Vec<MatrixEntry>> = vec![Vec::new(); rest.len()];
        host.parallel_blocks(&mut rows, TOGETHER, |first, rows| {
            let mut laplacians = Vec::new();
            for (i, row) in (first..).zip(rows) {
                // Also where there is no element.
                entry(row, i);
                for (element, corner) in corners.around(i) {
                    let e = &elements[element];
                    laplacians.clear();
                    laplacians.extend((0..3).map(|k| e.laplacian(k, at) / 3.0));
                    for k in 0..3 {
                        let entry = entry(row, e.corners[k] as usize);
                        entry.out += laplacians[corner];
                        entry.into += laplacians[k];
                        if k != corner {
                            let weight = e.weights[3 - k - corner];
                            entry.stiffness -= weight;
                            self::entry(row, i).stiffness += weight;
                        }
                    }
                }
                row.sort_unstable_by_key(|e| e.column);
            }
        })?;
        let mut this = Self { areas: areas(rest.len(), elements), starts: vec![0], ..Self::default() };
        let all: usize = rows.iter().map(Vec::len).sum();
        this.columns.reserve_exact(all);
        this.stiffness.reserve_exact(all);
        this.out.reserve_exact(all);
        this.into.reserve_exact(all);
        for row in rows {
            for e in row {
                this.columns.push(e.column as u32);
                this.stiffness.push(e.stiffness);
                this.out.push(e.out.as_vec3().to_array());
                this.into.push(e.into.as_vec3().to_array());
            }
            this.starts.push(this.columns.len());
        }
        Ok(this)
    }

    /// The operators with the edges from a sample alone as its surroundings (*spokes*), as Sorkine and Alexa
    /// have them: each edge turns with both of its ends, by halves.
    #[must_use]
    pub fn of_spokes(mut self, rest: &[DVec3]) -> Self {
        for i in 0..rest.len() {
            let mut sum = DVec3::ZERO;
            let mut own = None;
            for k in self.starts[i]..self.starts[i + 1] {
                let j = self.columns[k] as usize;
                if j == i {
                    own = Some(k);
                    continue;
                }
                let half = 0.5 * self.stiffness[k] * (rest[j] - rest[i]);
                sum += half;
                self.out[k] = half.as_vec3().to_array();
                self.into[k] = (-half).as_vec3().to_array();
            }
            if let Some(k) = own {
                self.out[k] = sum.as_vec3().to_array();
                self.into[k] = [0.0; 3];
            }
        }
        self
    }

    /// The entries of a row, by column.
    pub fn row(&self, i: usize) -> impl Iterator<Item = MatrixEntry> {
        let vector = |v: &[f32; 3]| DVec3::from(v.map(f64::from));
        (self.starts[i]..self.starts[i + 1]).map(move |k| MatrixEntry {
            column: self.columns[k] as usize,
            stiffness: self.stiffness[k],
            out: vector(&self.out[k]),
            into: vector(&self.into[k]),
        })
    }

    /// Number of entries of a row.
    pub fn entries(&self, i: usize) -> usize {
        self.starts[i + 1] - self.starts[i]
    }

    /// Columns and entries of the Laplacian's row.
    pub fn laplacian(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        (self.starts[i]..self.starts[i + 1]).map(|k| (self.columns[k] as usize, self.stiffness[k]))
    }
}

fn entry(row: &mut Vec<MatrixEntry>, column: usize) -> &mut MatrixEntry {
    let k = row.iter().position(|e| e.column == column).unwrap_or_else(|| {
        row.push(MatrixEntry { column, stiffness: 0.0, out: DVec3::ZERO, into: DVec3::ZERO });
        row.len() - 1
    });
    &mut row[k]
}

fn areas(samples: usize, elements: &[SurfaceTriangle]) -> Vec<f64> {
    let mut areas = vec![0.0; samples];
    for e in elements {
        for (corner, area) in e.corners.iter().zip(e.areas) {
            areas[*corner as usize] += area;
        }
    }
    let mean = areas.iter().sum::<f64>() / samples.max(1) as f64;
    let least = if mean > 0.0 { LEAST_AREA * mean } else { 1.0 };
    areas.iter_mut().for_each(|a| *a = a.max(least));
    areas
}

/// The elements around each sample.
struct SampleElements {
    starts: Vec<usize>,
    /// Three times the element, plus the corner.
    all: Vec<u32>,
}

impl SampleElements {
    fn new(samples: usize, elements: &[SurfaceTriangle]) -> Self {
        let corners = || elements.iter().flat_map(|e| e.corners).map(|c| c as usize);
        let mut starts = vec![0; samples + 1];
        corners().for_each(|c| starts[c + 1] += 1);
        (0..samples).for_each(|i| starts[i + 1] += starts[i]);
        let mut next = starts.clone();
        let mut all = vec![0; 3 * elements.len()];
        for (k, c) in corners().enumerate() {
            all[next[c]] = k as u32;
            next[c] += 1;
        }
        Self { starts, all }
    }

    fn around(&self, i: usize) -> impl Iterator<Item = (usize, usize)> {
        self.all[self.starts[i]..self.starts[i + 1]].iter().map(|k| (*k as usize / 3, *k as usize % 3))
    }
}
