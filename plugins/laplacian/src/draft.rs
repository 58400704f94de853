//! A quick picture: a coarse likeness' pose, carried over to the surface.
//!
//! Groups move rigidly, and nodes by the weighted means of what the groups around them do. What is rough
//! about that is smoothed by a few steps of Jacobi's method on the global step's equations (Sorkine and Alexa
//! 2007). All is in single precision, as what is shown is, since the time goes to memory.

use crate::coarse::Prolongation;
use crate::constraints::OwnMotions;
use crate::problem::Problem;
use glam::{Affine3A, DMat3, DVec3, Mat3A, Vec3A};
use simod_plugin_api::{Host, PluginResult};

/// Nodes at once on one thread.
const TOGETHER: usize = 4096;
/// How much of each of Jacobi's steps is made: the most that takes down all that is rough, whatever the
/// triangles.
const PART: f32 = 0.6;

/// Displacements of the fine problem's nodes, given those of the coarse one's and their rotations.
pub fn carry(
    fine: &Problem,
    coarse: &Problem,
    prolongation: &Prolongation,
    (displacements, turns): (&[DVec3], &[DMat3]),
    motion: &OwnMotions,
    host: &Host<'_>,
) -> PluginResult<Vec<DVec3>> {
    // From places to displacements.
    let maps: Vec<Affine3A> = turns
        .iter()
        .zip(displacements.iter().zip(&coarse.rest))
        .map(|(turn, (d, at))| {
            let change = *turn - DMat3::IDENTITY;
            let translation = (*d - change * *at).as_vec3a();
            Affine3A { matrix3: Mat3A::from(change.as_mat3()), translation }
        })
        .collect();
    let maps = prolongation.maps(&maps, host)?;
    let mut placed = fine.held_displacements(|target, at| motion.displacement(target, at));
    let mut carried: Vec<Vec3A> = placed.iter().map(|d| d.as_vec3a()).collect();
    host.parallel_blocks(&mut carried[..fine.free], TOGETHER, |first, carried| {
        for (i, d) in (first..).zip(carried) {
            *d = maps[i].transform_point3a(fine.rest[i].as_vec3a());
        }
    })?;
    // What the rotations ask for is the same in each step.
    let mut steps: Vec<JacobiStep> = vec![JacobiStep::default(); fine.free];
    host.parallel_blocks(&mut steps, TOGETHER, |first, steps| {
        for (i, step) in (first..).zip(steps) {
            for e in fine.operators.row(i) {
                step.asked += maps[e.column].matrix3 * e.out.as_vec3a();
            }
            step.placed = smoothed(fine, i, step.asked, &carried);
        }
    })?;
    carried[..fine.free].iter_mut().zip(&steps).for_each(|(d, step)| *d = step.placed);
    host.parallel_blocks(&mut placed[..fine.free], TOGETHER, |first, placed| {
        for (i, d) in (first..).zip(placed) {
            *d = smoothed(fine, i, steps[i].asked, &carried).as_dvec3();
        }
    })?;
    Ok(placed)
}

/// A node in the first of Jacobi's steps.
#[derive(Debug, Clone, Copy, Default)]
struct JacobiStep {
    /// What the rotations around it ask for.
    asked: Vec3A,
    /// The sample's displacement after the step.
    placed: Vec3A,
}

/// The displacement of a node after a step of Jacobi's method from those that are `given`.
fn smoothed(fine: &Problem, node: usize, asked: Vec3A, given: &[Vec3A]) -> Vec3A {
    let (mut lacking, mut diagonal) = (asked, 0.0);
    for (column, stiffness) in fine.operators.laplacian(node) {
        let stiffness = stiffness as f32;
        lacking -= stiffness * given[column];
        diagonal = if column == node { stiffness } else { diagonal };
    }
    let step = if diagonal > 0.0 { lacking * (PART / diagonal) } else { Vec3A::ZERO };
    given[node] + step
}
