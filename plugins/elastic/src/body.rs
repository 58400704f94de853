//! Body: its energy as a function of the positions of its lattice's corners, and the derivatives.
//!
//! Cells are hexahedra with linear edges. Changes of volume are resisted in the middle of each alone, so that
//! thin parts of nearly constant volume bend; changes of shape at eight points, which lie a little nearer to
//! the middle than Gauss's, so that a single layer of cubes bends as stiffly as it should (T. Belytschko, L.
//! Bindeman, *Assumed strain stabilization of the eight node hexahedral element*, CMAME 105, 1993, choose
//! this by the same bend).

use crate::cell::{CellGradients, Eight, Forces, Matrices, Slopes};
use crate::contact::Touch;
use crate::held::{Goals, Spring};
use crate::lattice::{CORNERS, CellPoint, HexMesh, slopes};
use crate::material;
use crate::multilevel::{Inverse, Multilevel};
use glam::{DAffine3, DMat3, DVec3};
use pulp::{Arch, Simd, WithSimd};
use simod_plugin_api::{Host, PluginResult};

/// Cells at once on one thread.
const CELLS: usize = 128;
/// The least part of a cell that counts as filled, and of that the least for a point.
const LEAST: f64 = 0.02;
/// Corners at once on one thread.
const TOGETHER: usize = 1024;

/// A body that is held.
#[derive(Debug)]
pub struct Body {
    /// The cells of the body.
    pub lattice: HexMesh,
    springs: Vec<Spring>,
    /// Sum of the springs' weights at each corner.
    ties: Vec<f64>,
    /// Volume of the body about each corner.
    masses: Vec<f64>,
    /// Resistance to changes of volume, beside a shear modulus of 1 (Lamé's first parameter).
    modulus: f64,
    slopes: Slopes,
    /// Volume that each of a cell's points stands for.
    amounts: Vec<[f64; 8]>,
    multilevel: Multilevel,
}

/// Gradients of the deformation in all cells.
pub type BodyGradients = Vec<CellGradients>;

/// Loads on the body.
#[derive(Debug)]
pub struct Load<'a> {
    /// The places of the regions.
    pub goals: &'a Goals,
    /// The force on a unit of the body.
    pub weight: DVec3,
    /// The places where the body touches itself.
    pub touches: &'a [Touch],
}

impl Body {
    /// Body of a lattice with the springs that hold it, of a material of this Poisson's ratio.
    pub fn new(lattice: HexMesh, springs: Vec<Spring>, poisson: f64) -> Self {
        // Factor by which the points lie nearer to the middle: see the head of this file.
        let near = ((1.0 + poisson) / (1.5 * (1.0 + poisson * poisson))).sqrt();
        let off = |n: usize| 0.5 + (n as f64 - 0.5) * near / 3.0_f64.sqrt();
        let of = |at: DVec3| slopes(at).map(|slope| slope / lattice.size);
        let points = CORNERS.map(|c| of(DVec3::from(c.map(off))));
        let slopes = Slopes::new(&points, &of(DVec3::splat(0.5)));
        let mut masses = vec![0.0; lattice.rest.len()];
        let whole = lattice.size.element_product();
        for (corners, moments) in lattice.cells.iter().zip(&lattice.moments) {
            corners.iter().zip(moments).for_each(|(c, m)| masses[*c as usize] += whole * m.max(LEAST / 8.0));
        }
        let amounts = lattice.moments.iter().map(|m| amounts(*m, off(0)).map(|a| a * whole)).collect();
        let mut ties = vec![0.0; lattice.rest.len()];
        for spring in &springs {
            for (row, c) in spring.form.iter().zip(lattice.cells[spring.cell as usize]) {
                ties[c as usize] += row.iter().sum::<f64>();
            }
        }
        let modulus = 2.0 * poisson / (1.0 - 2.0 * poisson);
        let multilevel = Multilevel::new(&lattice, &masses, 4.0 / 3.0 + modulus / 3.0);
        Self { lattice, springs, ties, masses, modulus, slopes, amounts, multilevel }
    }

    /// Young's modulus, where the shear modulus is 1.
    pub fn young(&self) -> f64 {
        let modulus = self.modulus;
        (3.0 * modulus + 2.0) / (modulus + 1.0)
    }

    /// Gradient of the deformation at a place, in the place's cell.
    pub fn gradient(&self, place: CellPoint, x: &[DVec3]) -> DMat3 {
        let slopes = slopes(place.at).map(|slope| slope / self.lattice.size);
        deformation(&self.lattice.cells[place.cell as usize].map(|c| x[c as usize]), &slopes)
    }

    /// The gradients of the deformation in all cells.
    pub fn gradients(&self, x: &[DVec3], host: &Host<'_>) -> PluginResult<BodyGradients> {
        let mut all = vec![CellGradients::NONE; self.lattice.cells.len()];
        host.parallel_blocks(&mut all, CELLS, |first, all| {
            Arch::new().dispatch(Deforms {
                slopes: &self.slopes,
                cells: &self.lattice.cells[first..],
                x,
                out: all,
            });
        })?;
        Ok(all)
    }

    /// Map of the body about each corner, to shifts: the mean of the maps of the cells around.
    pub fn corner_maps(&self, x: &[DVec3], host: &Host<'_>) -> PluginResult<Vec<DAffine3>> {
        let gradients = self.gradients(x, host)?;
        let mut maps = vec![DAffine3::IDENTITY; x.len()];
        host.parallel_blocks(&mut maps, TOGETHER, |first, maps| {
            for (i, map) in (first..).zip(maps) {
                let (mut sum, mut whole) = (DMat3::ZERO, 0.0);
                for [cell, _] in self.lattice.uses(i) {
                    let amount: f64 = self.amounts[*cell as usize].iter().sum();
                    sum += (gradients[*cell as usize].middle - DMat3::IDENTITY) * amount;
                    whole += amount;
                }
                // Slopes count by half: so the blend of two corners has quadratic functions between them
                // exactly.
                let (matrix3, rest) = (sum * (0.5 / whole), self.lattice.rest[i]);
                *map = DAffine3 { matrix3, translation: x[i] - rest - matrix3 * rest };
            }
        })?;
        Ok(maps)
    }

    /// The energy, and the forces that would undo it, negative.
    pub fn energy(
        &self,
        x: &[DVec3],
        gradients: &BodyGradients,
        load: &Load<'_>,
        host: &Host<'_>,
    ) -> PluginResult<(f64, Vec<DVec3>)> {
        let mut cells = vec![([Eight::ZERO; 3], 0.0); gradients.len()];
        host.parallel_blocks(&mut cells, CELLS, |first, cells| {
            Arch::new().dispatch(CellForces { body: self, gradients, first, out: cells });
        })?;
        let mut forces = vec![DVec3::ZERO; x.len()];
        self.gather(&mut forces, |cell| &cells[cell].0, host)?;
        let mut energy: f64 = cells.iter().map(|(_, e)| e).sum();
        for ((f, x), (rest, mass)) in forces.iter_mut().zip(x).zip(self.lattice.rest.iter().zip(&self.masses))
        {
            energy -= *mass * load.weight.dot(*x - *rest);
            *f -= *mass * load.weight;
        }
        for spring in &self.springs {
            let corners = self.lattice.cells[spring.cell as usize];
            let off = corners
                .map(|c| x[c as usize] - load.goals.image(spring.target, self.lattice.rest[c as usize]));
            for (row, (c, own)) in spring.form.iter().zip(corners.iter().zip(&off)) {
                let force: DVec3 = row.iter().zip(&off).map(|(w, o)| *w * *o).sum();
                energy += 0.5 * force.dot(*own);
                forces[*c as usize] += force;
            }
        }
        for touch in load.touches {
            let depth = touch.depth(&self.lattice, x);
            if depth > 0.0 {
                energy += 0.5 * touch.stiffness * depth * depth;
                touch.spread(&self.lattice, -touch.stiffness * depth, &mut forces);
            }
        }
        Ok((energy, forces))
    }

    /// Change of the forces where corners are moved, if the material is taken for stiffer by a part of its
    /// shear modulus.
    pub fn change(
        &self,
        gradients: &BodyGradients,
        (touches, stiffer): (&[Touch], f64),
        by: &[DVec3],
        host: &Host<'_>,
    ) -> PluginResult<Vec<DVec3>> {
        let mut cells = vec![[Eight::ZERO; 3]; gradients.len()];
        host.parallel_blocks(&mut cells, CELLS, |first, cells| {
            Arch::new().dispatch(Changes {
                body: self,
                of: Some((gradients, stiffer)),
                by,
                first,
                out: cells,
            });
        })?;
        let mut forces = vec![DVec3::ZERO; by.len()];
        self.gather(&mut forces, |cell| &cells[cell], host)?;
        self.add_springs(by, &mut forces);
        for touch in touches {
            touch.spread(&self.lattice, touch.stiffness * touch.along(&self.lattice, by), &mut forces);
        }
        Ok(forces)
    }

    /// Change of the forces as [`change`](Self::change) gives it, for a field that is as even as it can be
    /// (the Laplacian instead of the material).
    pub fn even(&self, by: &[DVec3], host: &Host<'_>) -> PluginResult<Vec<DVec3>> {
        let mut cells = vec![[Eight::ZERO; 3]; self.lattice.cells.len()];
        host.parallel_blocks(&mut cells, CELLS, |first, cells| {
            Arch::new().dispatch(Changes { body: self, of: None, by, first, out: cells });
        })?;
        let mut forces = vec![DVec3::ZERO; by.len()];
        self.gather(&mut forces, |cell| &cells[cell], host)?;
        self.add_springs(by, &mut forces);
        Ok(forces)
    }

    /// Weight of a target at each corner, by its springs.
    pub fn draws(&self, target: u32) -> Vec<f64> {
        let mut draws = vec![0.0; self.lattice.rest.len()];
        for spring in self.springs.iter().filter(|s| s.target == target) {
            for (row, c) in spring.form.iter().zip(self.lattice.cells[spring.cell as usize]) {
                draws[c as usize] += row.iter().sum::<f64>();
            }
        }
        draws
    }

    fn add_springs(&self, by: &[DVec3], forces: &mut [DVec3]) {
        for spring in &self.springs {
            let corners = self.lattice.cells[spring.cell as usize];
            let by = corners.map(|c| by[c as usize]);
            for (row, c) in spring.form.iter().zip(corners) {
                forces[c as usize] += row.iter().zip(&by).map(|(w, b)| *w * *b).sum::<DVec3>();
            }
        }
    }

    /// Sums up the forces of cells at each corner, in the order of the cells.
    fn gather<'a>(
        &self,
        out: &mut [DVec3],
        of: impl Fn(usize) -> &'a Forces + Sync,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        host.parallel_blocks(out, TOGETHER, |first, out| {
            for (i, o) in (first..).zip(out) {
                let force = |[cell, corner]: &[u32; 2]| {
                    DVec3::from(of(*cell as usize).map(|forces| forces.0[*corner as usize]))
                };
                *o = self.lattice.uses(i).iter().map(force).sum();
            }
        })
    }

    /// Inverse stiffnesses for [`Multilevel::apply`], by [`precondition`](Self::precondition).
    pub fn inverse(&self, touches: &[Touch]) -> Inverse {
        let mut ties = self.ties.clone();
        touches.iter().for_each(|touch| touch.tie(&self.lattice, &mut ties));
        self.multilevel.inverse(&ties)
    }

    /// Approximates the displacements that take a residual away.
    pub fn precondition(&self, inverse: &Inverse, residual: &[DVec3], out: &mut Vec<DVec3>) {
        self.multilevel.apply(inverse, residual, out);
    }
}

/// The deformation of cells.
struct Deforms<'a> {
    slopes: &'a Slopes,
    cells: &'a [[u32; 8]],
    x: &'a [DVec3],
    out: &'a mut [CellGradients],
}

impl WithSimd for Deforms<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (out, corners) in self.out.iter_mut().zip(self.cells) {
            *out = self.slopes.deform(&corners.map(|c| self.x[c as usize]));
        }
    }
}

/// The forces and energies of cells.
struct CellForces<'a> {
    body: &'a Body,
    gradients: &'a BodyGradients,
    first: usize,
    out: &'a mut [(Forces, f64)],
}

impl WithSimd for CellForces<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (i, (forces, sum)) in (self.first..).zip(self.out) {
            let (amounts, deformed) = (self.body.amounts[i], &self.gradients[i]);
            let whole = amounts.iter().sum::<f64>() * self.body.modulus;
            let (energies, points) = material::shape(&deformed.points);
            let (energy, middle) = material::volume(&deformed.middle);
            self.body.slopes.add(&weighted(points, amounts, middle * whole), forces);
            *sum = (energies * Eight(amounts)).0.iter().sum::<f64>() + energy * whole;
        }
    }
}

/// Computation of how forces of cells change: by the material, taken for stiffer by a part, or by the
/// Laplacian that evens out.
struct Changes<'a> {
    body: &'a Body,
    of: Option<(&'a BodyGradients, f64)>,
    by: &'a [DVec3],
    first: usize,
    out: &'a mut [Forces],
}

impl WithSimd for Changes<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let body = self.body;
        for (i, forces) in (self.first..).zip(self.out) {
            let amounts = body.amounts[i];
            let by = body.slopes.deform(&body.lattice.cells[i].map(|c| self.by[c as usize]));
            let stresses = if let Some((gradients, stiffer)) = self.of {
                let whole = amounts.iter().sum::<f64>() * body.modulus;
                let points = material::shape_change(&gradients[i].points, &by.points, stiffer);
                let middle = material::volume_change(&gradients[i].middle, &by.middle);
                weighted(points, amounts, middle * whole)
            } else {
                weighted(by.points, amounts, DMat3::ZERO)
            };
            body.slopes.add(&stresses, forces);
        }
    }
}

/// Stresses at the points, weighted by the points' volumes, and that of the middle.
#[inline(always)]
fn weighted(points: Matrices, amounts: [f64; 8], middle: DMat3) -> CellGradients {
    CellGradients { points: points.map(|column| column.map(|entry| entry * Eight(amounts))), middle }
}

/// Part of a cell that each of its points stands for, so that linear functions are summed up over the filled
/// part as it is (moment fitting), but none less than next to nothing. The points are `low` and `1 - low`
/// along each axis.
fn amounts(mut moments: [f64; 8], low: f64) -> [f64; 8] {
    // Corners are numbered by one bit for each axis.
    for bit in [1, 2, 4] {
        for first in (0..8).filter(|c| c & bit == 0) {
            let second = first + bit;
            let (a, b) = (moments[first], moments[second]);
            let over = (b - low * (a + b)) / (1.0 - 2.0 * low);
            (moments[first], moments[second]) = (a + b - over, over);
        }
    }
    let whole: f64 = moments.iter().sum();
    let raised = moments.map(|m| m.max(LEAST * whole.max(LEAST)));
    let sum: f64 = raised.iter().sum();
    raised.map(|m| m * whole.max(LEAST) / sum)
}

/// Gradient of a cell's deformation at a point where the corners' weights have these slopes.
fn deformation(corners: &[DVec3; 8], slopes: &[DVec3; 8]) -> DMat3 {
    let mut sum = DMat3::ZERO;
    for (x, s) in corners.iter().zip(slopes) {
        sum.x_axis += *x * s.x;
        sum.y_axis += *x * s.y;
        sum.z_axis += *x * s.z;
    }
    sum
}
