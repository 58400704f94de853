//! As rigid as possible: surroundings turn as a whole, as well as those next to them let them.
//!
//! O. Sorkine, M. Alexa, *As-Rigid-As-Possible Surface Modeling*, SGP 2007. In turns, rotations are fitted to
//! where the samples are (the local step), and the samples are placed by the rotations, by one system of
//! equations that never changes (the global step). Neither can raise the energy. All is reckoned in
//! displacements.

use crate::cells::{NodeNeighbourhoods, covariances};
use crate::constraints::{OwnMotions, Soft};
use crate::descent::{Past, dot};
use crate::levers::GroupLevers;
use crate::problem::Problem;
use glam::{DMat3, DVec3};
use simod_cholesky::Factor;
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;

/// Nodes at once on one thread.
const TOGETHER: usize = 1024;
/// Part of the decrease that the slope promises by which the energy has to go down.
const SUFFICIENT: f64 = 1e-4;
/// Steps whose decrease of the energy is looked at together: a single one may be short.
const LOOKED_AT: usize = 3;
/// Least length of a step, as a part of the full one.
const LEAST_PART: f64 = 0.05;

/// Criteria by which a descent ends: the first one that is met.
#[derive(Debug, Clone, Copy)]
pub struct DescentEnd {
    /// Number of steps.
    pub steps: usize,
    /// Largest move of a node in the last step, local coordinates.
    pub tolerance: f64,
    /// Decrease of the energy by the last steps together, as a part of that by all.
    pub decrease: f64,
}

/// Surface, or a coarse likeness of it, with its factorised Laplacian.
#[derive(Debug)]
pub struct SurfaceLevel {
    /// The nodes of the level.
    pub problem: Problem,
    /// The draws at free nodes.
    pub springs: Vec<Soft>,
    /// Factorised Laplacian with the springs. Steps by it need not be exact, but their goal is.
    pub factor: Factor<f32>,
}

/// Nodes whose surroundings turn.
#[derive(Debug, Clone, Copy)]
pub struct TurningNodes<'a> {
    /// Neighbourhoods of these nodes.
    pub cells: &'a NodeNeighbourhoods,
    /// Problem that has these nodes.
    pub problem: &'a Problem,
    /// Levers by which the nodes' rotations act on a finer problem whose groups they are; `None` if the nodes
    /// are that problem's own.
    pub groups: Option<&'a GroupLevers>,
}

/// Displacements of a level's nodes, and their rotations.
#[derive(Debug, Clone)]
pub struct LevelPose {
    /// Displacements from rest, before the motion that all handles share.
    pub displacements: Vec<DVec3>,
    /// Rotations of the turning nodes.
    pub turns: Vec<DMat3>,
    /// Means of these rotations at each of the turning nodes.
    pub blends: Vec<DMat3>,
    /// Covariances of the edges around these nodes when the rotations were fitted last; none before.
    covariances: Vec<DMat3>,
}

impl SurfaceLevel {
    /// Factorises the Laplacian. `stiffness` is that of a draw, per area.
    pub fn new(problem: Problem, stiffness: f64, told: Range<f64>, host: &Host<'_>) -> PluginResult<Self> {
        let springs = problem.springs(stiffness);
        let factor = problem.factor(problem.laplacian(), &springs, told, host)?;
        Ok(Self { problem, springs, factor })
    }

    /// The pose of given rotations.
    pub fn pose(
        &self,
        turns: Vec<DMat3>,
        turning: TurningNodes<'_>,
        motion: &OwnMotions,
        host: &Host<'_>,
    ) -> PluginResult<LevelPose> {
        let displacements = self.problem.held_displacements(|target, at| motion.displacement(target, at));
        let blends = turning.blend(&turns, host)?;
        let mut pose = LevelPose { displacements, turns, blends, covariances: Vec::new() };
        self.place(&mut pose, turning, motion, host)?;
        Ok(pose)
    }

    /// The global step: places the free nodes by the rotations.
    fn place(
        &self,
        pose: &mut LevelPose,
        turning: TurningNodes<'_>,
        motion: &OwnMotions,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let problem = &self.problem;
        let mut sums = vec![DVec3::ZERO; problem.free];
        host.parallel_blocks(&mut sums, TOGETHER, |first, sums| {
            for (i, sum) in (first..).zip(sums) {
                *sum = turning.asked(problem, i, &pose.blends);
                for (column, stiffness) in problem.operators.laplacian(i).filter(|e| e.0 >= problem.free) {
                    *sum -= stiffness * pose.displacements[column];
                }
            }
        })?;
        for spring in &self.springs {
            let node = spring.node as usize;
            sums[node] += spring.strength * motion.displacement(spring.target, problem.rest[node]);
        }
        self.factor.solve(&mut sums, host)?;
        pose.displacements[..problem.free].copy_from_slice(&sums);
        Ok(())
    }

    /// The local step: fits the rotations to where the nodes are.
    fn turn(&self, pose: &mut LevelPose, turning: TurningNodes<'_>, host: &Host<'_>) -> PluginResult<()> {
        pose.covariances = turning.covariances(&self.problem, &pose.displacements, host)?;
        turning.fit(&pose.covariances, &mut pose.turns, host)?;
        pose.blends = turning.blend(&pose.turns, host)?;
        Ok(())
    }

    /// The energy, but for a constant, and its derivative by the free nodes' displacements, behind a local
    /// step. As the rotations are those that fit best, they count as constant.
    fn assess(
        &self,
        pose: &LevelPose,
        turning: TurningNodes<'_>,
        motion: &OwnMotions,
        host: &Host<'_>,
    ) -> PluginResult<(f64, Vec<DVec3>)> {
        let problem = &self.problem;
        let LevelPose { displacements, blends, covariances, .. } = pose;
        // Part of the energy that couples the edges' displacements with the rotations.
        let turned = |(blend, covariance): (&DMat3, &DMat3)| -> f64 {
            let change = *blend - DMat3::IDENTITY;
            (0..3).map(|axis| change.col(axis).dot(covariance.col(axis))).sum()
        };
        let mut energy = -blends.iter().zip(covariances).map(turned).sum::<f64>();
        let mut gradient = vec![DVec3::ZERO; problem.free];
        let mut parts: Vec<(f64, &mut [DVec3])> =
            gradient.chunks_mut(TOGETHER).map(|gradient| (0.0, gradient)).collect();
        host.parallel_blocks(&mut parts, 1, |first, parts| {
            for (k, (energy, gradient)) in (first..).zip(parts) {
                for (i, gradient) in (k * TOGETHER..).zip(&mut **gradient) {
                    let (mut free, mut held) = (DVec3::ZERO, DVec3::ZERO);
                    for (column, stiffness) in problem.operators.laplacian(i) {
                        let laplacian = stiffness * displacements[column];
                        *(if column < problem.free { &mut free } else { &mut held }) += laplacian;
                    }
                    *energy += displacements[i].dot(0.5 * free + held);
                    *gradient = free + held - turning.asked(problem, i, blends);
                }
            }
        })?;
        energy += parts.iter().map(|part| part.0).sum::<f64>();
        for spring in &self.springs {
            let node = spring.node as usize;
            let off = displacements[node] - motion.displacement(spring.target, problem.rest[node]);
            energy += 0.5 * spring.strength * off.length_squared();
            gradient[node] += spring.strength * off;
        }
        Ok((energy, gradient))
    }

    /// Displacements after a part of a step of the free nodes.
    fn stepped(&self, before: &[DVec3], part: f64, step: &[DVec3]) -> Vec<DVec3> {
        let (free, held) = before.split_at(self.problem.free);
        let free = free.iter().zip(step).map(|(d, s)| *d + part * *s);
        free.chain(held.iter().copied()).collect()
    }

    /// Lowers the energy; returns the energies on the way, but for a constant.
    ///
    /// A local and a global step are one of Newton's method with the Laplacian for the second derivative.
    /// Earlier steps improve that derivative, and save most of the steps (limited-memory BFGS, as in T. Liu,
    /// S. Bouaziz, L. Kavan, *Quasi-Newton Methods for Real-Time Simulation of Hyperelastic Materials*, TOG
    /// 2017).
    pub fn relax(
        &self,
        pose: &mut LevelPose,
        turning: TurningNodes<'_>,
        motion: &OwnMotions,
        until: DescentEnd,
        host: &Host<'_>,
    ) -> PluginResult<Vec<f64>> {
        if until.steps == 0 || self.problem.free == 0 {
            return Ok(Vec::new());
        }
        self.turn(pose, turning, host)?;
        let (mut energy, mut gradient) = self.assess(pose, turning, motion, host)?;
        let mut energies = vec![energy];
        let mut past = Past::default();
        for count in 1..=until.steps {
            host.progress(0.0)?;
            let step = past.step(&gradient, &self.factor, host)?;
            let slope = dot(&step, &gradient, host)?;
            // The rest is found anew.
            let before = LevelPose {
                displacements: std::mem::take(&mut pose.displacements),
                turns: pose.turns.clone(),
                blends: std::mem::take(&mut pose.blends),
                covariances: Vec::new(),
            };
            let mut part = 1.0;
            let taken = loop {
                pose.displacements = self.stepped(&before.displacements, part, &step);
                self.turn(pose, turning, host)?;
                let (lower, next) = self.assess(pose, turning, motion, host)?;
                if lower <= energy + SUFFICIENT * part * slope {
                    break Some((lower, next));
                }
                part *= 0.5;
                if part < LEAST_PART {
                    break None;
                }
            };
            let Some((lower, next)) = taken else {
                *pose = before;
                // The plain step goes down, but for rounding.
                if past.is_empty() {
                    break;
                }
                past = Past::default();
                continue;
            };
            energies.push(lower);
            let moved = part * step.iter().map(|s| s.length()).fold(0.0, f64::max);
            if moved <= until.tolerance || is_settled(&energies, until.decrease) || count == until.steps {
                break;
            }
            past.push(&step, part, &gradient, &next, host)?;
            (energy, gradient) = (lower, next);
        }
        Ok(energies)
    }
}

/// Whether the last steps lowered the energy by less than a part of the decrease by all.
fn is_settled(energies: &[f64], part: f64) -> bool {
    let last = energies.len() - 1;
    last > LOOKED_AT && energies[last - LOOKED_AT] - energies[last] <= part * (energies[0] - energies[last])
}

impl TurningNodes<'_> {
    /// Fits rotations to covariances.
    fn fit(&self, covariances: &[DMat3], turns: &mut [DMat3], host: &Host<'_>) -> PluginResult<()> {
        self.cells.fit(self.problem, covariances, turns, host)
    }

    /// Means of the rotations at the turning nodes.
    fn blend(&self, turns: &[DMat3], host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        self.cells.blend(self.problem, turns, host)
    }

    /// Covariances of the turning nodes, given the displacements of a level's nodes.
    fn covariances(
        &self,
        level: &Problem,
        displacements: &[DVec3],
        host: &Host<'_>,
    ) -> PluginResult<Vec<DMat3>> {
        match self.groups {
            Some(levers) => levers.covariances(displacements, host),
            None => covariances(level, displacements, host),
        }
    }

    /// Part of the equation of a level's free node that the blended rotations make.
    #[inline]
    fn asked(&self, level: &Problem, node: usize, blends: &[DMat3]) -> DVec3 {
        match self.groups {
            Some(levers) => levers.asked(node, blends),
            None => level.operators.row(node).map(|e| blends[e.column] * e.out - e.out).sum(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constraints::SampleTarget;
    use crate::elements::SurfaceTriangle;
    use crate::intrinsic;
    use crate::problem::Constraint;
    use crate::tests::scene::{tube, turn};
    use simod_plugin_api::Affine;

    fn level(is_of_spokes: bool) -> SurfaceLevel {
        let scene = tube(14, 24, 0.15);
        let rest: Vec<DVec3> = scene.points.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let kind = |p: &DVec3| match p.z {
            z if z < 0.2 => Constraint::Held(SampleTarget::Fixed),
            z if z > 0.8 => Constraint::Held(SampleTarget::Handle(0)),
            _ => Constraint::Free,
        };
        let kinds: Vec<Constraint> = rest.iter().map(kind).collect();
        let elements: Vec<SurfaceTriangle> = intrinsic::plain(&rest, &scene.triangles);
        let node = kinds.iter().position(|k| *k == Constraint::Free).unwrap() as u32;
        let soft = [Soft { node, target: SampleTarget::Handle(0), strength: 0.1 }];
        let host = Host::new(&());
        let mut problem = Problem::new(&rest, &elements, &kinds, &soft, &host).unwrap();
        if is_of_spokes {
            problem.operators = problem.operators.of_spokes(&problem.rest);
        }
        SurfaceLevel::new(problem, 400.0, 0.0..1.0, &host).unwrap()
    }

    fn motion() -> OwnMotions {
        let bend: Affine = turn(DVec3::X, 100.0, DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.1, -0.3, 0.0));
        OwnMotions::rigid(&[bend], true)
    }

    /// Pose from which a descent starts: the free nodes' rotations are the identity.
    fn start(level: &SurfaceLevel, turning: TurningNodes<'_>, motion: &OwnMotions) -> LevelPose {
        let held = level.problem.held.iter().map(|t| motion.turn(*t));
        let turns = std::iter::repeat_n(DMat3::IDENTITY, level.problem.free).chain(held);
        level.pose(turns.take(level.problem.rows).collect(), turning, motion, &Host::new(&())).unwrap()
    }

    /// The energy of a pose, whichever step was the last.
    fn energy(
        level: &SurfaceLevel,
        pose: &mut LevelPose,
        turning: TurningNodes<'_>,
        motion: &OwnMotions,
    ) -> f64 {
        let host = Host::new(&());
        pose.covariances = turning.covariances(&level.problem, &pose.displacements, &host).unwrap();
        level.assess(pose, turning, motion, &host).unwrap().0
    }

    #[test]
    fn neither_step_raises_the_energy() {
        let (motion, host) = (motion(), Host::new(&()));
        for (width, is_of_spokes) in [(0.0, false), (0.1, false), (0.0, true)] {
            let level = level(is_of_spokes);
            let cells = NodeNeighbourhoods::new(&level.problem, width, &host).unwrap();
            let turning = TurningNodes { cells: &cells, problem: &level.problem, groups: None };
            let mut pose = start(&level, turning, &motion);
            let mut last = energy(&level, &mut pose, turning, &motion);
            for step in 0..60 {
                for local in [true, false] {
                    if local {
                        level.turn(&mut pose, turning, &host).unwrap();
                    } else {
                        level.place(&mut pose, turning, &motion, &host).unwrap();
                    }
                    let energy = energy(&level, &mut pose, turning, &motion);
                    // Coefficients are of single precision.
                    assert!(energy <= last + 1e-7, "width {width}, step {step}: {last} to {energy}");
                    last = energy;
                }
            }
            // The faster descent comes at least as far in half of the steps, and never up.
            let mut pose = start(&level, turning, &motion);
            let energies = level
                .relax(
                    &mut pose,
                    turning,
                    &motion,
                    DescentEnd { steps: 30, tolerance: 0.0, decrease: 0.0 },
                    &host,
                )
                .unwrap();
            assert!(energies.is_sorted_by(|a, b| a >= b), "{energies:?}");
            assert!(*energies.last().unwrap() <= last + 1e-6, "{energies:?}, {last}");
        }
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_energy() {
        let (motion, host) = (motion(), Host::new(&()));
        for (width, is_of_spokes) in [(0.0, false), (0.1, false), (0.0, true)] {
            let level = level(is_of_spokes);
            let cells = NodeNeighbourhoods::new(&level.problem, width, &host).unwrap();
            let turning = TurningNodes { cells: &cells, problem: &level.problem, groups: None };
            let mut pose = start(&level, turning, &motion);
            level.turn(&mut pose, turning, &host).unwrap();
            let (_, gradient) = level.assess(&pose, turning, &motion, &host).unwrap();
            let energy_at = |node: usize, by: DVec3| {
                let mut pose = pose.clone();
                pose.displacements[node] += by;
                level.turn(&mut pose, turning, &host).unwrap();
                level.assess(&pose, turning, &motion, &host).unwrap().0
            };
            let largest = gradient.iter().map(|g| g.length()).fold(0.0, f64::max);
            for node in (0..level.problem.free).step_by(17) {
                for axis in DVec3::AXES {
                    let h = 1e-5;
                    let slope = (energy_at(node, axis * h) - energy_at(node, axis * -h)) / (2.0 * h);
                    let found = gradient[node].dot(axis);
                    assert!((slope - found).abs() < 1e-3 * largest, "width {width}, {node}: {slope} {found}");
                }
            }
        }
    }
}
