//! As rigid as possible: the surroundings of each sample turn as a whole, as well as those of its neighbours let them.
//!
//! O. Sorkine, M. Alexa, *As-Rigid-As-Possible Surface Modeling*, SGP 2007. In turns, each sample's rotation is fitted
//! to where the samples are (the local step), and the samples are placed by the rotations, by one system of equations that
//! never changes (the global step). Neither can raise the energy. All is reckoned in displacements.
//!
//! That energy alone resists bending by the size of the samples' surroundings, and so the less the finer the
//! sampling: a dense surface crumples. A second term, the Dirichlet energy of the rotations times the square of a
//! length, makes the result one of the surface and not of its sampling (Z. Levi, C. Gotsman, *Smooth Rotation Enhanced
//! As-Rigid-As-Possible Mesh Animation*, TVCG 2015). Held nodes then turn as their regions do.

use crate::constraints::{Motion, Soft};
use crate::factor::Factor;
use crate::problem::Problem;
use crate::rotation;
use glam::{DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};
use std::collections::VecDeque;

/// Nodes at once on one thread.
const TOGETHER: usize = 1024;
/// Rounds in which rotations spread, each local step.
const SWEEPS: usize = 3;
/// Steps that are remembered.
const REMEMBERED: usize = 6;
/// The part of what the slope promises by which the energy has to go down.
const SUFFICIENT: f64 = 1e-4;
/// Steps are not made shorter than this part.
const LEAST_PART: f64 = 0.05;

/// The surface, or a coarse likeness of it, with its factorised Laplacian.
#[derive(Debug)]
pub struct Level {
    /// Its nodes.
    pub problem: Problem,
    springs: Vec<Soft>,
    factor: Factor,
}

/// What is asked of a pose.
#[derive(Debug, Clone, Copy)]
pub struct Goal<'a> {
    /// What the handles do.
    pub motion: &'a Motion,
    /// The square of the length over which rotations spread; 0 for the method of 2007.
    pub bending: f64,
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

    /// Solves for three values at the free nodes, given what the operators' rows give.
    pub fn solve(&self, sides: &mut [DVec3]) -> PluginResult<()> {
        self.factor.solve(sides)
    }

    /// The springs at free nodes.
    pub fn springs(&self) -> &[Soft] {
        &self.springs
    }

    /// The pose of given rotations.
    pub fn pose(&self, mut turns: Vec<DMat3>, goal: Goal<'_>, host: &Host<'_>) -> PluginResult<Pose> {
        let problem = &self.problem;
        if goal.bending > 0.0 {
            let held = turns[problem.free..].iter_mut().zip(&problem.held);
            held.for_each(|(turn, target)| *turn = goal.motion.turn(*target));
        }
        let displacements = problem.held_displacements(|target, at| goal.motion.displacement(target, at));
        let mut pose = Pose { displacements, turns };
        self.place(&mut pose, goal, host)?;
        Ok(pose)
    }

    /// The global step: places the free nodes by the rotations.
    pub fn place(&self, pose: &mut Pose, goal: Goal<'_>, host: &Host<'_>) -> PluginResult<()> {
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
            sums[node] += spring.strength * goal.motion.displacement(spring.target, problem.rest[node]);
        }
        self.factor.solve(&mut sums)?;
        pose.displacements[..problem.free].copy_from_slice(&sums);
        Ok(())
    }

    /// The local step: fits the rotations to where the nodes are.
    pub fn turn(&self, pose: &mut Pose, goal: Goal<'_>, host: &Host<'_>) -> PluginResult<()> {
        let Pose { displacements, turns } = pose;
        if goal.bending > 0.0 {
            for _ in 0..SWEEPS {
                let before = turns.clone();
                let free = &mut turns[..self.problem.free];
                fit_turns(
                    &self.problem,
                    displacements,
                    free,
                    |i| self.spread(&before, i, goal.bending),
                    host,
                )?;
            }
            return Ok(());
        }
        fit_turns(&self.problem, displacements, turns, |_| DMat3::ZERO, host)
    }

    /// What the rotations around a node ask of its own.
    ///
    /// All nodes are turned at once, so that each edge's `|R_i - R_j|²` is replaced by a bound that touches it,
    /// `2 |R_i - M|² + 2 |R_j - M|²` for the mean `M` of what both were: this does not raise the energy either.
    fn spread(&self, turns: &[DMat3], i: usize, bending: f64) -> DMat3 {
        let mut sum = DMat3::ZERO;
        for (j, l) in
            self.problem.operators.laplacian(i).filter(|(j, l)| *j < turns.len() && *j != i && *l < 0.0)
        {
            sum += (turns[i] + turns[j]) * (bending * -l);
        }
        sum
    }

    /// The energy, but for a constant, and its derivative by the free nodes' displacements; rotations are those
    /// that fit best, or are taken for constant.
    pub fn assess(&self, pose: &Pose, goal: Goal<'_>, host: &Host<'_>) -> PluginResult<(f64, Vec<DVec3>)> {
        let problem = &self.problem;
        let Pose { displacements, turns } = pose;
        let at = |i: usize| problem.rest[i] + displacements[i];
        let mut parts = vec![(0.0, DVec3::ZERO); problem.rows];
        host.parallel_blocks(&mut parts, TOGETHER, |first, parts| {
            for (i, (energy, gradient)) in (first..).zip(parts) {
                let (mut free, mut held, mut turned) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
                for e in problem.operators.row(i) {
                    if e.column != i {
                        let edge = at(e.column) - at(i);
                        *energy -= edge.dot(turns[i] * e.into - e.into);
                        if goal.bending > 0.0 && e.column < problem.rows && e.stiffness < 0.0 {
                            // Each edge is met from both ends.
                            *energy -=
                                0.5 * goal.bending * e.stiffness * (3.0 - overlap(turns[i], turns[e.column]));
                        }
                    }
                    if i < problem.free {
                        let laplacian = e.stiffness * displacements[e.column];
                        *(if e.column < problem.free { &mut free } else { &mut held }) += laplacian;
                        turned += turns[e.column] * e.out - e.out;
                    }
                }
                if i < problem.free {
                    *energy += displacements[i].dot(0.5 * free + held);
                    *gradient = free + held - turned;
                }
            }
        })?;
        let mut energy: f64 = parts.iter().map(|p| p.0).sum();
        let mut gradient: Vec<DVec3> = parts[..problem.free].iter().map(|p| p.1).collect();
        for spring in &self.springs {
            let node = spring.node as usize;
            let off = displacements[node] - goal.motion.displacement(spring.target, problem.rest[node]);
            energy += 0.5 * spring.strength * off.length_squared();
            gradient[node] += spring.strength * off;
        }
        Ok((energy, gradient))
    }

    /// Takes the energy down until no node moves farther than `tolerance`, for at most so many `steps`.
    ///
    /// A local and a global step are one of Newton's method with the Laplacian for the second derivative. What the
    /// steps before tell of the derivative makes it better, and saves most of the steps (limited-memory BFGS, as in
    /// T. Liu, S. Bouaziz, L. Kavan, *Quasi-Newton Methods for Real-Time Simulation of Hyperelastic Materials*, TOG 2017).
    pub fn relax(
        &self,
        pose: &mut Pose,
        goal: Goal<'_>,
        steps: usize,
        tolerance: f64,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        if steps == 0 || self.problem.free == 0 {
            return Ok(());
        }
        self.turn(pose, goal, host)?;
        let (mut energy, mut gradient) = self.assess(pose, goal, host)?;
        let mut past = Past::default();
        for _ in 0..steps {
            host.progress(0.0)?;
            let step = past.step(&gradient, &self.factor)?;
            let slope = dot(&step, &gradient);
            let before = pose.clone();
            let mut part = 1.0;
            let taken = loop {
                for ((d, b), s) in pose.displacements.iter_mut().zip(&before.displacements).zip(&step) {
                    *d = *b + part * *s;
                }
                self.turn(pose, goal, host)?;
                let (lower, next) = self.assess(pose, goal, host)?;
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
            #[cfg(test)]
            if std::env::var_os("LAP_TRACE").is_some() {
                std::eprintln!(
                    "{} {lower:.9e} part {part} moved {:.2e}",
                    self.problem.free,
                    step.iter().map(|s| s.length()).fold(0.0, f64::max)
                );
            }
            let moved = part * step.iter().map(|s| s.length()).fold(0.0, f64::max);
            if moved <= tolerance {
                break;
            }
            past.push(&step, part, &gradient, &next);
            (energy, gradient) = (lower, next);
        }
        Ok(())
    }
}

/// What the last steps told of the energy's second derivative.
#[derive(Default)]
struct Past {
    /// Steps, changes of the gradient, and one over their products.
    pairs: VecDeque<(Vec<DVec3>, Vec<DVec3>, f64)>,
}

impl Past {
    fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// The step that would lead to the least energy, as far as is known (J. Nocedal, S. Wright, *Numerical
    /// Optimization*, algorithm 7.4).
    fn step(&self, gradient: &[DVec3], factor: &Factor) -> PluginResult<Vec<DVec3>> {
        let mut q: Vec<DVec3> = gradient.iter().map(|g| -*g).collect();
        let mut shares = Vec::with_capacity(self.pairs.len());
        for (s, y, inverse) in self.pairs.iter().rev() {
            let share = inverse * dot(s, &q);
            q.iter_mut().zip(y).for_each(|(q, y)| *q -= share * *y);
            shares.push(share);
        }
        factor.solve(&mut q)?;
        for ((s, y, inverse), share) in self.pairs.iter().zip(shares.into_iter().rev()) {
            let other = inverse * dot(y, &q);
            q.iter_mut().zip(s).for_each(|(q, s)| *q += (share - other) * *s);
        }
        Ok(q)
    }

    fn push(&mut self, step: &[DVec3], part: f64, before: &[DVec3], after: &[DVec3]) {
        let s: Vec<DVec3> = step.iter().map(|s| part * *s).collect();
        let y: Vec<DVec3> = after.iter().zip(before).map(|(a, b)| *a - *b).collect();
        let product = dot(&s, &y);
        // The second derivative is not always positive, and what is to be used has to be.
        if product <= 1e-12 * (dot(&s, &s) * dot(&y, &y)).sqrt() {
            return;
        }
        if self.pairs.len() == REMEMBERED {
            self.pairs.pop_front();
        }
        self.pairs.push_back((s, y, 1.0 / product));
    }
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

/// The sum of the products of two rotations' entries: 3 where they are the same.
fn overlap(a: DMat3, b: DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

/// Fits the rotations of nodes to displacements, from those that they had, and to what else asks of them.
pub fn fit_turns(
    problem: &Problem,
    displacements: &[DVec3],
    turns: &mut [DMat3],
    also: impl Fn(usize) -> DMat3 + Sync,
    host: &Host<'_>,
) -> PluginResult<()> {
    let at = |i: usize| problem.rest[i] + displacements[i];
    host.parallel_blocks(turns, TOGETHER, |first, turns| {
        for (i, turn) in (first..).zip(turns) {
            let mut covariance = also(i);
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
