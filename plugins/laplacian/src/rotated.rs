//! The surface's own Laplacians, turned, and met by least squares.
//!
//! Y. Lipman et al., *Differential Coordinates for Interactive Mesh Editing*, SMI 2004, who take the turns
//! from a first solution that knows none. That solution collapses where handles turn far, and the turns with
//! it. Here the handles' own turns, harmonically blended (`harmonic`), are in the first solution, from which
//! then come those of the final one. The turns vary slowly, and are found on a coarse likeness of the surface
//! (`coarse`).

use crate::arap::SurfaceLevel;
use crate::cells::covariances;
use crate::coarse::{Prolongation, coarsen};
use crate::constraints::OwnMotions;
use crate::draft::Draft;
use crate::harmonic::Influence;
use crate::levers::GroupLevers;
use crate::linear::BiLaplacian;
use crate::problem::Problem;
use crate::rotation;
use glam::{DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};
use std::sync::OnceLock;

/// Nodes at once on one thread.
const TOGETHER: usize = 1024;

/// Surface, and a coarse likeness of it if it is large.
#[derive(Debug)]
pub struct Rotated {
    fine: BiLaplacian,
    coarse: Option<(BiLaplacian, Prolongation, OnceLock<GroupLevers>, OnceLock<Draft>)>,
    /// Influence of the handles on the coarsest level.
    influence: Influence,
}

/// Stiffness of draws, per area.
#[derive(Debug, Clone, Copy)]
pub struct Stiffness {
    /// The stiffness of draws with the Laplacian.
    pub harmonic: f64,
    /// The stiffness of draws with the bi-Laplacian.
    pub biharmonic: f64,
}

impl Rotated {
    /// Factorises.
    pub fn new(
        problem: Problem,
        stiffness: Stiffness,
        handles: usize,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let guided = |problem, told, host: &Host<'_>| {
            let level = SurfaceLevel::new(problem, stiffness.harmonic, told, host)?;
            let influence = Influence::new(&level, handles, host)?;
            Ok((level.problem, influence))
        };
        let smooth =
            |problem, told, host: &Host<'_>| BiLaplacian::new(problem, stiffness.biharmonic, told, host);
        let Some((coarse, prolongation)) = coarsen(&problem, host)? else {
            let (problem, influence) = guided(problem, 0.3..0.5, host)?;
            return Ok(Self { fine: smooth(problem, 0.5..1.0, host)?, coarse: None, influence });
        };
        let (coarse, influence) = guided(coarse, 0.3..0.35, host)?;
        let coarse = smooth(coarse, 0.35..0.4, host)?;
        let fine = smooth(problem, 0.4..1.0, host)?;
        Ok(Self { fine, coarse: Some((coarse, prolongation, OnceLock::new(), OnceLock::new())), influence })
    }

    /// Displacements of all nodes. Those of a draft are the coarse likeness', carried over.
    pub fn displacements(
        &self,
        motion: &OwnMotions,
        is_draft: bool,
        host: &Host<'_>,
    ) -> PluginResult<Vec<DVec3>> {
        let coarsest = self.coarse.as_ref().map_or(&self.fine, |(coarse, ..)| coarse);
        let mut turns = self.influence.turns(&coarsest.problem, motion);
        let first = solve(coarsest, turns.clone(), motion, host)?;
        fit(&coarsest.problem, &first, &mut turns, host)?;
        let Some((coarse, prolongation, levers, draft)) = &self.coarse else {
            return solve(&self.fine, turns, motion, host);
        };
        if is_draft {
            let displacements = solve(coarse, turns.clone(), motion, host)?;
            let carried = (displacements.as_slice(), turns.as_slice());
            let fine = &self.fine.problem;
            let levers = GroupLevers::once(levers, fine, coarse.problem.rows, prolongation, host)?;
            let draft = Draft::once(draft, fine, host)?;
            return draft.carry((fine, levers), &coarse.problem, carried, motion, host);
        }
        solve(&self.fine, prolongation.turns(&turns, host)?, motion, host)
    }
}

/// The displacements with which the Laplacians are met that turn so.
fn solve(
    level: &BiLaplacian,
    mut turns: Vec<DMat3>,
    motion: &OwnMotions,
    host: &Host<'_>,
) -> PluginResult<Vec<DVec3>> {
    let Problem { rows, free, held, operators, .. } = &level.problem;
    // The turns of held nodes one farther from free ones.
    turns.extend(held[rows - free..].iter().map(|target| motion.turn(*target)));
    let mut laplacians = vec![DVec3::ZERO; *rows];
    host.parallel_blocks(&mut laplacians, TOGETHER, |first, out| {
        for (i, sum) in (first..).zip(out) {
            *sum = operators.row(i).map(|e| turns[e.column] * e.out - e.out).sum();
        }
    })?;
    level.respond(|i| laplacians[i], |target, at| motion.displacement(target, at), host)
}

/// Fits the free nodes' rotations to the displacements of their surroundings.
fn fit(problem: &Problem, displacements: &[DVec3], turns: &mut [DMat3], host: &Host<'_>) -> PluginResult<()> {
    let covariances = covariances(problem, displacements, host)?;
    host.parallel_blocks(&mut turns[..problem.free], TOGETHER, |first, turns| {
        for (turn, covariance) in turns.iter_mut().zip(&covariances[first..]) {
            *turn = rotation::nearest(*covariance, *turn);
        }
    })
}
