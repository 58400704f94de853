//! As rigid as possible: the surroundings of each sample turn as a whole, as well as those of its neighbours let them.
//!
//! O. Sorkine, M. Alexa, *As-Rigid-As-Possible Surface Modeling*, SGP 2007. In turns, each sample's rotation is fitted
//! to where the samples are (the local step), and the samples are placed by the rotations, by one system of equations that
//! never changes (the global step). Neither can raise the energy. All is reckoned in displacements.

use crate::constraints::{Motion, Soft};
use crate::factor::Factor;
use crate::problem::Problem;
use crate::rotation;
use glam::{DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Nodes at once on one thread.
const TOGETHER: usize = 1024;

/// The surface, or a coarse likeness of it, with its factorised Laplacian.
#[derive(Debug)]
pub struct Level {
    /// Its nodes.
    pub problem: Problem,
    springs: Vec<Soft>,
    factor: Factor,
}

/// Where a level's nodes are, and how they are turned.
#[derive(Debug, Clone)]
pub struct Pose {
    /// From rest, before the motion that all share.
    pub displacements: Vec<DVec3>,
    /// Rotations of the nodes whose surroundings are whole.
    pub turns: Vec<DMat3>,
}

impl Level {
    /// Factorises. `stiffness` is that of a draw, per area.
    pub fn new(problem: Problem, stiffness: f64, host: &Host<'_>) -> PluginResult<Self> {
        let springs = problem.springs(stiffness);
        let factor = problem.factor(problem.laplacian(), &springs, host)?;
        Ok(Self { problem, springs, factor })
    }

    /// Solves for columns of values at the free nodes, given what the operators' rows give, on as many threads.
    pub fn solve(&self, columns: &mut [f64], host: &Host<'_>) -> PluginResult<()> {
        solve(&self.factor, columns, host)
    }

    /// The springs at free nodes.
    pub fn springs(&self) -> &[Soft] {
        &self.springs
    }

    /// The pose of given rotations.
    pub fn pose(&self, turns: Vec<DMat3>, motion: &Motion, host: &Host<'_>) -> PluginResult<Pose> {
        let displacements = self.problem.held_displacements(|target, at| motion.displacement(target, at));
        let mut pose = Pose { displacements, turns };
        self.place(&mut pose, motion, host)?;
        Ok(pose)
    }

    /// The global step: places the free nodes by the rotations.
    pub fn place(&self, pose: &mut Pose, motion: &Motion, host: &Host<'_>) -> PluginResult<()> {
        let problem = &self.problem;
        let mut sums = vec![DVec3::ZERO; problem.free];
        host.parallel_blocks(&mut sums, TOGETHER, |first, sums| {
            for (i, sum) in (first..).zip(sums) {
                for e in problem.operators.row(i) {
                    *sum += pose.turns[e.column] * e.out - e.out;
                    if e.column >= problem.free {
                        *sum -= e.stiffness * pose.displacements[e.column];
                    }
                }
            }
        })?;
        for spring in &self.springs {
            let node = spring.node as usize;
            sums[node] += spring.strength * motion.displacement(spring.target, problem.rest[node]);
        }
        let mut columns: Vec<f64> = (0..3).flat_map(|k| sums.iter().map(move |s| s[k])).collect();
        solve(&self.factor, &mut columns, host)?;
        let (xs, rest) = columns.split_at(problem.free);
        let (ys, zs) = rest.split_at(problem.free);
        for (d, ((x, y), z)) in pose.displacements.iter_mut().zip(xs.iter().zip(ys).zip(zs)) {
            *d = DVec3::new(*x, *y, *z);
        }
        Ok(())
    }

    /// The local step: fits the rotations to where the nodes are.
    pub fn turn(&self, pose: &mut Pose, host: &Host<'_>) -> PluginResult<()> {
        let Pose { displacements, turns } = pose;
        fit_turns(&self.problem, displacements, turns, host)
    }

    /// Local and global steps until no node moves farther than `tolerance`, or for so many `steps`.
    pub fn relax(
        &self,
        pose: &mut Pose,
        motion: &Motion,
        steps: usize,
        tolerance: f64,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        for _ in 0..steps {
            host.progress(0.0)?;
            let before = pose.displacements[..self.problem.free].to_vec();
            self.turn(pose, host)?;
            self.place(pose, motion, host)?;
            let moved =
                before.iter().zip(&pose.displacements).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            if moved <= tolerance {
                break;
            }
        }
        Ok(())
    }
}

/// Fits the rotations of nodes to displacements, from those that they had.
pub fn fit_turns(
    problem: &Problem,
    displacements: &[DVec3],
    turns: &mut [DMat3],
    host: &Host<'_>,
) -> PluginResult<()> {
    let at = |i: usize| problem.rest[i] + displacements[i];
    host.parallel_blocks(turns, TOGETHER, |first, turns| {
        for (i, turn) in (first..).zip(turns) {
            let mut covariance = DMat3::ZERO;
            for e in problem.operators.row(i).filter(|e| e.column != i) {
                let edge = at(e.column) - at(i);
                covariance.x_axis += edge * e.into.x;
                covariance.y_axis += edge * e.into.y;
                covariance.z_axis += edge * e.into.z;
            }
            *turn = rotation::nearest(covariance, *turn);
        }
    })
}

/// Solves for columns, each by itself, on as many threads.
pub fn solve(factor: &Factor, columns: &mut [f64], host: &Host<'_>) -> PluginResult<()> {
    if columns.is_empty() {
        return Ok(());
    }
    let failed = std::sync::Mutex::new(None);
    host.parallel_blocks(columns, factor.len(), |_, column| {
        if let Err(e) = factor.solve(column) {
            failed.lock().unwrap_or_else(std::sync::PoisonError::into_inner).get_or_insert(e);
        }
    })?;
    failed.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).map_or(Ok(()), Err)
}
