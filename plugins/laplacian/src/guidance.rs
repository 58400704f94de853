//! From the handles' motions to a pose: coarse to fine.

use crate::arap::{Level, Pose};
use crate::coarse::{Prolongation, coarsen};
use crate::constraints::{Motion, Target};
use crate::problem::Problem;
use glam::{DMat3, DQuat, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Steps on the coarse likeness, at most.
const COARSE_STEPS: usize = 40;
/// How much finer the coarse steps' tolerance is than that of the others.
const COARSE_TOLERANCE: f64 = 0.3;

/// The surface, and a coarse likeness of it if it is large.
#[derive(Debug)]
pub struct Hierarchy {
    fine: Level,
    coarse: Option<(Level, Prolongation)>,
    /// How much each handle has to say at each free node of the coarsest level, node by node.
    influence: Vec<f64>,
    handles: usize,
}

impl Hierarchy {
    /// Factorises all that there is to factorise. `stiffness` is that of a draw, per area.
    pub fn new(problem: Problem, stiffness: f64, handles: usize, host: &Host<'_>) -> PluginResult<Self> {
        let coarse = match coarsen(&problem, host)? {
            Some((coarse, prolongation)) => Some((Level::new(coarse, stiffness, host)?, prolongation)),
            None => None,
        };
        host.progress(0.4)?;
        let fine = Level::new(problem, stiffness, host)?;
        let coarsest = coarse.as_ref().map_or(&fine, |(level, _)| level);
        let influence = influence(coarsest, handles, host)?;
        Ok(Self { fine, coarse, influence, handles })
    }

    /// The pose: at most so many `steps` on all nodes, or until none moves farther than `tolerance`.
    pub fn deform(
        &self,
        motion: &Motion,
        steps: usize,
        tolerance: f64,
        host: &Host<'_>,
    ) -> PluginResult<Pose> {
        let Some((coarse, prolongation)) = &self.coarse else {
            let turns = self.guess(&self.fine, motion);
            let mut pose = self.fine.pose(turns, motion, host)?;
            self.fine.relax(&mut pose, motion, steps, tolerance, host)?;
            return Ok(pose);
        };
        let mut pose = coarse.pose(self.guess(coarse, motion), motion, host)?;
        coarse.relax(&mut pose, motion, COARSE_STEPS, COARSE_TOLERANCE * tolerance, host)?;
        let mut pose = self.fine.pose(prolongation.turns(&pose.turns, host)?, motion, host)?;
        self.fine.relax(&mut pose, motion, steps, tolerance, host)?;
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
    for h in 0..handles {
        host.progress(0.0)?;
        let own = Some(Target::Handle(h as u32));
        let mut column = vec![0.0; problem.free];
        for (i, sum) in column.iter_mut().enumerate() {
            let held = problem.operators.laplacian(i).filter(|(j, _)| problem.target(*j) == own);
            *sum = -held.map(|(_, l)| l).sum::<f64>();
        }
        for spring in level.springs().iter().filter(|s| Some(s.target) == own) {
            column[spring.node as usize] += spring.strength;
        }
        level.solve(&mut column, host)?;
        for (i, value) in column.into_iter().enumerate() {
            influence[i * handles + h] = value;
        }
    }
    Ok(influence)
}
