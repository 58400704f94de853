//! Poses of the surface from the handles' motions: coarse to fine.

use crate::arap::{DescentEnd, SurfaceLevel, TurningNodes};
use crate::cells::NodeNeighbourhoods;
use crate::coarse::{Prolongation, coarsen};
use crate::constraints::OwnMotions;
use crate::draft::Draft;
use crate::harmonic::Influence;
use crate::levers::GroupLevers;
use crate::problem::Problem;
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};
use std::sync::OnceLock;

/// Steps on the coarse likeness, at most.
const COARSE_STEPS: usize = 24;
/// Steps for a draft, at most, as it is to be seen soon.
const DRAFT_STEPS: usize = 12;
/// Ratio of the tolerance of these steps to that of the fine ones, which find the rest.
const COARSE_TOLERANCE: f64 = 10.0;

/// Surface, and a coarse likeness of it if it is large.
#[derive(Debug)]
pub struct Hierarchy {
    fine: SurfaceLevel,
    coarse: Option<(SurfaceLevel, Prolongation, OnceLock<GroupLevers>, OnceLock<Draft>)>,
    /// The surroundings of the coarsest level's nodes.
    cells: NodeNeighbourhoods,
    /// Whether these surroundings are what turns on the fine level too, as they are wider than its own.
    is_wide: bool,
    /// The influence of the handles on the coarsest level.
    influence: Influence,
}

impl Hierarchy {
    /// Factorises both levels. `stiffness` is that of a draw, per area; `width` that of the surroundings, or
    /// 0.
    pub fn new(
        problem: Problem,
        stiffness: f64,
        width: f64,
        handles: usize,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let coarse = match coarsen(&problem, host)? {
            Some((coarse, prolongation)) => {
                let coarse = SurfaceLevel::new(coarse, stiffness, 0.3..0.4, host)?;
                Some((coarse, prolongation, OnceLock::new(), OnceLock::new()))
            }
            None => None,
        };
        let fine = SurfaceLevel::new(problem, stiffness, 0.4..1.0, host)?;
        let coarsest = coarse.as_ref().map_or(&fine, |(level, ..)| level);
        let cells = NodeNeighbourhoods::new(&coarsest.problem, width, host)?;
        let influence = Influence::new(coarsest, handles, host)?;
        Ok(Self { cells, is_wide: width > 0.0, influence, fine, coarse })
    }

    /// The displacements of all nodes. A draft's are the coarse likeness', carried over.
    pub fn deform(
        &self,
        motion: &OwnMotions,
        until: DescentEnd,
        is_draft: bool,
        host: &Host<'_>,
    ) -> PluginResult<Vec<DVec3>> {
        let (fine, cells) = (&self.fine, &self.cells);
        let Some((coarse, prolongation, levers, draft)) = &self.coarse else {
            let turning = TurningNodes { cells, problem: &fine.problem, groups: None };
            let mut pose = fine.pose(self.influence.turns(&fine.problem, motion), turning, motion, host)?;
            // Steps here are as cheap as coarse ones, and all that there are.
            let steps = COARSE_STEPS + if is_draft { 0 } else { until.steps };
            fine.relax(&mut pose, turning, motion, DescentEnd { steps, ..until }, host)?;
            return Ok(pose.displacements);
        };
        let turning = TurningNodes { cells, problem: &coarse.problem, groups: None };
        let mut pose = coarse.pose(self.influence.turns(&coarse.problem, motion), turning, motion, host)?;
        let steps = if is_draft { DRAFT_STEPS } else { COARSE_STEPS };
        let coarsely = DescentEnd { steps, tolerance: COARSE_TOLERANCE * until.tolerance, decrease: 0.0 };
        coarse.relax(&mut pose, turning, motion, coarsely, host)?;
        let levers = || GroupLevers::once(levers, &fine.problem, coarse.problem.rows, prolongation, host);
        if is_draft {
            let carried = (pose.displacements.as_slice(), pose.blends.as_slice());
            let draft = Draft::once(draft, &fine.problem, host)?;
            return draft.carry((&fine.problem, levers()?), &coarse.problem, carried, motion, host);
        }
        let own = NodeNeighbourhoods::narrow();
        let (turning, turns) = if self.is_wide {
            (TurningNodes { groups: Some(levers()?), ..turning }, pose.turns)
        } else {
            let turns = prolongation.turns(&pose.turns, host)?;
            (TurningNodes { cells: &own, problem: &fine.problem, groups: None }, turns)
        };
        let mut pose = fine.pose(turns, turning, motion, host)?;
        fine.relax(&mut pose, turning, motion, until, host)?;
        Ok(pose.displacements)
    }
}
