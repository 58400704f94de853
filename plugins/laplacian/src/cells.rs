//! Surroundings of nodes, which turn as a whole, and their width.
//!
//! The surroundings of Sorkine and Alexa are the triangles around a sample. Their resistance to bending is as
//! wide as these, and so the less the finer the sampling: converged, a densely sampled surface crumples like
//! foil. Here surroundings have a width of their own: node `j` belongs to those of node `c` by the weight `W
//! = (M + l² L)⁻¹ M`, a smooth bump of the length `l` whose weights at each node add up to 1. The energy is
//! still a sum over surroundings of how far each is from being turned as a whole, and both steps stay what
//! they were: covariances are spread by `Wᵀ`, rotations by `W`. Held nodes then turn as their regions do, so
//! that the surface leaves these smoothly. The aim is that of Z. Levi, C. Gotsman, *Smooth Rotation Enhanced
//! As-Rigid-As-Possible Mesh Animation*, TVCG 2015, who add a term for it.

use crate::problem::Problem;
use crate::rotation;
use glam::{DMat3, DVec3};
use simod_cholesky::Factor;
use simod_plugin_api::{Host, PluginResult};

/// Nodes at once on one thread.
const TOGETHER: usize = 1024;

/// The surroundings of a problem's nodes.
#[derive(Debug)]
pub struct NodeNeighbourhoods {
    wide: Option<Wide>,
}

#[derive(Debug)]
struct Wide {
    /// The factorised `M + l² L` among the free nodes.
    factor: Factor<f64>,
    /// `l²`
    spread: f64,
}

impl NodeNeighbourhoods {
    /// The neighbourhoods of each node's elements alone.
    pub fn narrow() -> Self {
        Self { wide: None }
    }

    /// Surroundings of the given width; of a node's elements alone where it is 0.
    pub fn new(problem: &Problem, width: f64, host: &Host<'_>) -> PluginResult<Self> {
        if width <= 0.0 {
            return Ok(Self::narrow());
        }
        let spread = width * width;
        let row = |i: usize| {
            let mut row = problem.laplacian()(i);
            row.iter_mut().for_each(|e| e.1 *= spread);
            if let Some(diagonal) = row.last_mut() {
                diagonal.1 += problem.operators.areas[i];
            }
            row
        };
        Ok(Self { wide: Some(Wide { factor: problem.factor(row, &[], 0.0..0.0, host)?, spread }) })
    }

    /// Fits rotations to covariances, starting from their former values.
    pub fn fit(
        &self,
        problem: &Problem,
        covariances: &[DMat3],
        turns: &mut [DMat3],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let Some(wide) = &self.wide else { return fit(covariances, turns, host) };
        let mut spread = covariances[..problem.free].to_vec();
        wide.solve(&mut spread, host)?;
        spread.iter_mut().zip(&problem.operators.areas).for_each(|(s, area)| *s *= *area);
        fit(&spread, &mut turns[..problem.free], host)
    }

    /// The mean of the rotations that each node takes part in.
    pub fn blend(&self, problem: &Problem, turns: &[DMat3], host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        let mut blends = turns.to_vec();
        let Some(wide) = &self.wide else { return Ok(blends) };
        // Reckoned as changes, so that what does not turn stays exactly.
        let change = |i: usize| turns[i] - DMat3::IDENTITY;
        let mut sides: Vec<DMat3> = (0..problem.free)
            .map(|i| {
                let held = problem.operators.laplacian(i).filter(|(j, _)| *j >= problem.free);
                let held = held.fold(DMat3::ZERO, |sum, (j, l)| sum + change(j) * (wide.spread * l));
                change(i) * problem.operators.areas[i] - held
            })
            .collect();
        wide.solve(&mut sides, host)?;
        blends.iter_mut().zip(sides).for_each(|(blend, side)| *blend = side + DMat3::IDENTITY);
        Ok(blends)
    }
}

impl Wide {
    /// Replaces matrices by solutions, the columns side by side.
    fn solve(&self, sides: &mut [DMat3], host: &Host<'_>) -> PluginResult<()> {
        let mut columns: [Vec<DVec3>; 3] = std::array::from_fn(|c| sides.iter().map(|m| m.col(c)).collect());
        for column in &mut columns {
            self.factor.solve(column, host)?;
        }
        for (i, side) in sides.iter_mut().enumerate() {
            *side = DMat3::from_cols(columns[0][i], columns[1][i], columns[2][i]);
        }
        Ok(())
    }
}

/// Fits each rotation to its covariance, from its former value.
fn fit(covariances: &[DMat3], turns: &mut [DMat3], host: &Host<'_>) -> PluginResult<()> {
    host.parallel_blocks(turns, TOGETHER, |first, turns| {
        for (turn, covariance) in turns.iter_mut().zip(&covariances[first..]) {
            *turn = rotation::nearest(*covariance, *turn);
        }
    })
}

/// Covariances of the edges, before and after, at each node whose surroundings are whole.
pub fn covariances(problem: &Problem, displacements: &[DVec3], host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
    let at = |i: usize| problem.rest[i] + displacements[i];
    let mut covariances = vec![DMat3::ZERO; problem.rows];
    host.parallel_blocks(&mut covariances, TOGETHER, |first, covariances| {
        for (i, covariance) in (first..).zip(covariances) {
            for e in problem.operators.row(i) {
                let edge = at(e.column) - at(i);
                covariance.x_axis += edge * e.into.x;
                covariance.y_axis += edge * e.into.y;
                covariance.z_axis += edge * e.into.z;
            }
        }
    })?;
    Ok(covariances)
}
