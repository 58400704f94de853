//! Preconditioner that makes conjugate gradients quick: residuals are divided by stiffness on lattices of
//! ever larger cells, too.
//!
//! J. Bramble, J. Pasciak, J. Xu, *Parallel multilevel preconditioners*, Mathematics of Computation 55, 1990.

use crate::lattice::HexMesh;
use glam::DVec3;
use std::collections::HashMap;

/// A lattice of so few corners is not made coarser.
const FEWEST: usize = 12;

/// Corners of a lattice of twice the size, and their weights at those of the one below.
#[derive(Debug)]
struct CoarserCorners {
    /// Corners above that each corner below lies between, with weights.
    above: Vec<(u32, f64)>,
    /// Start of each corner's entries in `above`.
    starts: Vec<u32>,
    /// Stiffness of the material about each corner.
    material: Vec<f64>,
}

/// Lattices of ever larger cells above one.
#[derive(Debug)]
pub struct Multilevel {
    finest: Vec<f64>,
    levels: Vec<CoarserCorners>,
}

/// The inverse stiffnesses of one state of the body.
#[derive(Debug)]
pub struct Inverse(Vec<Vec<f64>>);

impl Multilevel {
    /// Lattices above one. `masses` is the volume of the body about each corner; `modulus` the stiffness
    /// against waves of all kinds.
    pub fn new(lattice: &HexMesh, masses: &[f64], modulus: f64) -> Self {
        let scale = |size: DVec3| modulus * (8.0 / 9.0) * size.map(|h| h.powi(-2)).element_sum();
        let stiff = |masses: &[f64], size| masses.iter().map(|m| m * scale(size)).collect::<Vec<f64>>();
        let mut this = Self { finest: stiff(masses, lattice.size), levels: Vec::new() };
        let (mut places, mut masses, mut size) = (lattice.places.clone(), masses.to_vec(), lattice.size);
        while places.len() > FEWEST {
            size *= 2.0;
            let (mut ids, mut coarse) = (HashMap::new(), Vec::new());
            let (mut above, mut starts) = (Vec::new(), vec![0]);
            for place in &places {
                for corner in 0..8_u32 {
                    let by: [u32; 3] = std::array::from_fn(|axis| corner >> axis & 1);
                    // A corner of odd place lies between two; else over one.
                    if (0..3).any(|axis| by[axis] > place[axis] % 2) {
                        continue;
                    }
                    let over: [u32; 3] = std::array::from_fn(|axis| place[axis] / 2 + by[axis]);
                    let weight = 0.5_f64.powi(place.iter().filter(|n| **n % 2 == 1).count() as i32);
                    let id = *ids.entry(over).or_insert_with(|| {
                        coarse.push(over);
                        coarse.len() as u32 - 1
                    });
                    above.push((id, weight));
                }
                starts.push(above.len() as u32);
            }
            if coarse.len() * 10 > places.len() * 9 {
                break;
            }
            let mut level = CoarserCorners { above, starts, material: Vec::new() };
            masses = level.up(&masses, coarse.len());
            level.material = stiff(&masses, size);
            this.levels.push(level);
            places = coarse;
        }
        this
    }

    /// Inverse stiffnesses, with `ties` that bind each corner to places of space, and to others of the body,
    /// beside the material.
    pub fn inverse(&self, ties: &[f64]) -> Inverse {
        let inverse = |material: &[f64], ties: &[f64]| {
            material.iter().zip(ties).map(|(m, t)| (m + t).recip()).collect::<Vec<f64>>()
        };
        let mut all = vec![inverse(&self.finest, ties)];
        let mut ties = ties.to_vec();
        for level in &self.levels {
            ties = level.up(&ties, level.material.len());
            all.push(inverse(&level.material, &ties));
        }
        Inverse(all)
    }

    /// Approximates the displacements that would take a residual away.
    pub fn apply(&self, Inverse(inverse): &Inverse, residual: &[DVec3], out: &mut Vec<DVec3>) {
        let divided =
            |r: &[DVec3], level: usize| r.iter().zip(&inverse[level]).map(|(r, d)| *r * *d).collect();
        let mut all: Vec<Vec<DVec3>> = vec![divided(residual, 0)];
        let mut residual = residual.to_vec();
        for (n, level) in self.levels.iter().enumerate() {
            residual = level.up(&residual, level.material.len());
            all.push(divided(&residual, n + 1));
        }
        for (n, level) in self.levels.iter().enumerate().rev() {
            let (below, above) = all.split_at_mut(n + 1);
            for (i, b) in below[n].iter_mut().enumerate() {
                *b += level.weights(i).iter().map(|(id, w)| *w * above[0][*id as usize]).sum::<DVec3>();
            }
        }
        *out = all.swap_remove(0);
    }
}

impl CoarserCorners {
    fn weights(&self, corner: usize) -> &[(u32, f64)] {
        &self.above[self.starts[corner] as usize..self.starts[corner + 1] as usize]
    }

    /// Sums by the weights with which corners below lie between those above.
    fn up<T>(&self, values: &[T], count: usize) -> Vec<T>
    where
        T: Copy + Default + std::ops::AddAssign + std::ops::Mul<f64, Output = T>,
    {
        let mut sums = vec![T::default(); count];
        for (i, v) in values.iter().enumerate() {
            self.weights(i).iter().for_each(|(id, w)| sums[*id as usize] += *v * *w);
        }
        sums
    }
}
