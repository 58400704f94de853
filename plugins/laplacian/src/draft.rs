//! A quick picture: a coarse likeness' pose, carried over to the surface.
//!
//! Groups move rigidly, and nodes by the weighted means of what the groups around them do. What is rough
//! about that is smoothed by a few steps of Jacobi's method on the global step's equations (Sorkine and Alexa
//! 2007).

use crate::coarse::Prolongation;
use crate::constraints::OwnMotions;
use crate::problem::Problem;
use glam::{DAffine3, DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Nodes at once on one thread.
const TOGETHER: usize = 1024;
/// Jacobi's steps.
const STEPS: usize = 2;
/// How much of each is made: the most that takes down all that is rough, whatever the triangles.
const PART: f64 = 0.6;

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
    let maps: Vec<DAffine3> = turns
        .iter()
        .zip(displacements.iter().zip(&coarse.rest))
        .map(|(turn, (d, at))| {
            let matrix3 = *turn - DMat3::IDENTITY;
            DAffine3 { matrix3, translation: *d - matrix3 * *at }
        })
        .collect();
    let maps = prolongation.maps(&maps, host)?;
    let mut placed = fine.held_displacements(|target, at| motion.displacement(target, at));
    host.parallel_blocks(&mut placed[..fine.free], TOGETHER, |first, placed| {
        for (i, d) in (first..).zip(placed) {
            *d = maps[i].transform_point3(fine.rest[i]);
        }
    })?;
    let mut next = placed.clone();
    for _ in 0..STEPS {
        host.parallel_blocks(&mut next[..fine.free], TOGETHER, |first, next| {
            for (i, d) in (first..).zip(next) {
                let (mut lacking, mut diagonal) = (DVec3::ZERO, 0.0);
                for e in fine.operators.row(i) {
                    lacking += maps[e.column].matrix3 * e.out - e.stiffness * placed[e.column];
                    diagonal = if e.column == i { e.stiffness } else { diagonal };
                }
                *d = placed[i];
                if diagonal > 0.0 {
                    *d += lacking * (PART / diagonal);
                }
            }
        })?;
        std::mem::swap(&mut next, &mut placed);
    }
    Ok(placed)
}
