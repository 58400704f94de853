//! Rotations between those of the handles, by harmonic functions.
//!
//! R. Zayer, C. Rössl, Z. Karni, H.-P. Seidel, *Harmonic Guidance for Surface Deformation*, Eurographics
//! 2005: the weight of each handle at a node is a harmonic function, 1 on the handle and 0 on other regions.
//! The rotations are blended by their axes times angles.

use crate::arap::SurfaceLevel;
use crate::constraints::{OwnMotions, SampleTarget};
use crate::problem::Problem;
use glam::{DMat3, DQuat, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Weight of each handle at the free nodes.
#[derive(Debug)]
pub struct Influence {
    /// Weights at each free node, handle by handle.
    values: Vec<f64>,
    handles: usize,
}

impl Influence {
    /// Influence of the handles at the free nodes of a level.
    pub fn new(level: &SurfaceLevel, handles: usize, host: &Host<'_>) -> PluginResult<Self> {
        let problem = &level.problem;
        let mut values = vec![0.0; problem.free * handles];
        for first in (0..handles).step_by(3) {
            host.progress(0.0)?;
            // Three at once.
            let share = |target: SampleTarget| match target {
                SampleTarget::Handle(h) if (first..first + 3).contains(&(h as usize)) => {
                    DVec3::AXES[h as usize - first]
                }
                SampleTarget::Handle(_) | SampleTarget::Fixed => DVec3::ZERO,
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
            for (row, side) in values.chunks_exact_mut(handles).zip(sides) {
                row[first..].iter_mut().zip(side.to_array()).for_each(|(slot, v)| *slot = v);
            }
        }
        Ok(Self { values, handles })
    }

    /// Rotations of the problem's nodes whose surroundings are whole: of held ones by their regions, of free
    /// ones in between.
    pub fn turns(&self, problem: &Problem, motion: &OwnMotions) -> Vec<DMat3> {
        let axes: Vec<DVec3> =
            (0..self.handles).map(|h| scaled_axis(motion.turn(SampleTarget::Handle(h as u32)))).collect();
        let between = self.values.chunks_exact(self.handles.max(1)).map(|influence| {
            let axis: DVec3 = influence.iter().zip(&axes).map(|(w, a)| *w * *a).sum();
            DMat3::from_quat(DQuat::from_scaled_axis(axis))
        });
        let held = problem.held.iter().map(|target| motion.turn(*target));
        between.chain(held).take(problem.rows).collect()
    }
}

/// The axis times the angle, of at most half a turn.
fn scaled_axis(turn: DMat3) -> DVec3 {
    // A quaternion's negative is the same turn, whose angle is that of the long way round.
    let turn = DQuat::from_mat3(&turn);
    (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_go_the_short_way_round() {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(0.0, -0.6, 0.8)] {
            for degrees in [-179.0_f64, -120.0, -30.0, 0.0, 60.0, 130.0, 179.0] {
                let expected = axis * degrees.to_radians();
                let found = scaled_axis(DMat3::from_axis_angle(axis, degrees.to_radians()));
                assert!(found.distance(expected) < 1e-9, "{expected} {found}");
            }
        }
    }
}
