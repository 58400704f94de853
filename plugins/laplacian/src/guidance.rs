//! From the handles' motions to a pose: coarse to fine.

use crate::arap::{Level, Pose, Turning};
use crate::cells::Cells;
use crate::coarse::{Prolongation, coarsen};
use crate::constraints::{Motion, Target};
use crate::problem::Problem;
use glam::{DMat3, DQuat, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Steps on the coarse likeness, at most.
const COARSE_STEPS: usize = 24;
/// And for a draft, which is to be seen soon.
const DRAFT_STEPS: usize = 12;
/// How much coarser the tolerance of these is: what is left is for the others to find.
const COARSE_TOLERANCE: f64 = 10.0;

/// The surface, and a coarse likeness of it if it is large.
#[derive(Debug)]
pub struct Hierarchy {
    fine: Level,
    coarse: Option<(Level, Prolongation)>,
    /// The surroundings of the coarsest level's nodes.
    cells: Cells,
    /// Whether they are what turns on the fine level too, as they are wider than its own.
    is_wide: bool,
    /// How much each handle has to say at each free node of the coarsest level, node by node.
    influence: Vec<f64>,
    handles: usize,
}

impl Hierarchy {
    /// Factorises all that there is to factorise. `stiffness` is that of a draw, per area; `width` that of the
    /// surroundings, or 0.
    pub fn new(
        problem: Problem,
        stiffness: f64,
        width: f64,
        handles: usize,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let coarse = match coarsen(&problem, host)? {
            Some((coarse, prolongation)) => {
                Some((Level::new(coarse, stiffness, 0.3..0.4, host)?, prolongation))
            }
            None => None,
        };
        let fine = Level::new(problem, stiffness, 0.4..1.0, host)?;
        let coarsest = coarse.as_ref().map_or(&fine, |(level, _)| level);
        let cells = Cells::new(&coarsest.problem, width, host)?;
        let influence = influence(coarsest, handles, host)?;
        Ok(Self { cells, is_wide: width > 0.0, influence, handles, fine, coarse })
    }

    /// The pose, in at most so many `steps` on all nodes, or until none moves farther than `tolerance`. A draft has no
    /// number of steps: its turns are those of the coarse likeness.
    pub fn deform(
        &self,
        motion: &Motion,
        (steps, tolerance): (Option<usize>, f64),
        host: &Host<'_>,
    ) -> PluginResult<Pose> {
        let (fine, cells) = (&self.fine, &self.cells);
        let Some((coarse, prolongation)) = &self.coarse else {
            let turning = Turning { cells, problem: &fine.problem, groups: None };
            let mut pose = fine.pose(self.guess(fine, motion), turning, motion, host)?;
            // These are as cheap as coarse ones, and all that there are.
            fine.relax(&mut pose, turning, motion, (steps.unwrap_or(0) + COARSE_STEPS, tolerance), host)?;
            return Ok(pose);
        };
        let turning = Turning { cells, problem: &coarse.problem, groups: None };
        let mut pose = coarse.pose(self.guess(coarse, motion), turning, motion, host)?;
        let coarse_steps = if steps.is_some() { COARSE_STEPS } else { DRAFT_STEPS };
        coarse.relax(&mut pose, turning, motion, (coarse_steps, COARSE_TOLERANCE * tolerance), host)?;
        let own = Cells::narrow();
        let (turning, turns) = if self.is_wide {
            (Turning { groups: Some(prolongation), ..turning }, pose.turns)
        } else {
            let turns = prolongation.turns(&pose.turns, host)?;
            (Turning { cells: &own, problem: &fine.problem, groups: None }, turns)
        };
        let mut pose = fine.pose(turns, turning, motion, host)?;
        if let Some(steps) = steps {
            fine.relax(&mut pose, turning, motion, (steps, tolerance), host)?;
        }
        Ok(pose)
    }

    /// Rotations between those of the handles.
    fn guess(&self, level: &Level, motion: &Motion) -> Vec<DMat3> {
        let problem = &level.problem;
        let axes: Vec<DVec3> = (0..self.handles)
            .map(|h| DQuat::from_mat3(&motion.turn(Target::Handle(h as u32))).to_scaled_axis())
            .collect();
        let between = self.influence.chunks_exact(self.handles.max(1)).map(|influence| {
            let axis: DVec3 = influence.iter().zip(&axes).map(|(w, a)| *w * *a).sum();
            DMat3::from_quat(DQuat::from_scaled_axis(axis))
        });
        let held = problem.held.iter().map(|target| motion.turn(*target));
        between.chain(held).take(problem.rows).collect()
    }
}

/// Harmonic functions of the free nodes, one for each handle: 1 on it, and 0 on other regions.
fn influence(level: &Level, handles: usize, host: &Host<'_>) -> PluginResult<Vec<f64>> {
    let problem = &level.problem;
    let mut influence = vec![0.0; problem.free * handles];
    for first in (0..handles).step_by(3) {
        host.progress(0.0)?;
        // Three at once.
        let share = |target: Target| match target {
            Target::Handle(h) if (first..first + 3).contains(&(h as usize)) => {
                DVec3::AXES[h as usize - first]
            }
            Target::Handle(_) | Target::Fixed => DVec3::ZERO,
        };
        let side = |i: usize| -> DVec3 {
            let row = problem.operators.laplacian(i);
            row.filter_map(|(j, l)| problem.target(j).map(|target| -l * share(target))).sum()
        };
        let mut sides: Vec<DVec3> = (0..problem.free).map(side).collect();
        for spring in &level.springs {
            sides[spring.node as usize] += spring.strength * share(spring.target);
        }
        level.factor.solve(&mut sides, host)?;
        for (row, values) in influence.chunks_exact_mut(handles).zip(sides) {
            row[first..].iter_mut().zip(values.to_array()).for_each(|(slot, v)| *slot = v);
        }
    }
    Ok(influence)
}
