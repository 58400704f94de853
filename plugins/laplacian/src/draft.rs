//! A quick picture: a coarse likeness' pose, carried over to the surface.
//!
//! Groups move rigidly, and nodes by the weighted means of the maps of the groups around them. The roughness
//! of that is smoothed by a few steps of Jacobi's method on the global step's equations (Sorkine and Alexa
//! 2007). All is in single precision, as what is shown is, since the time goes to memory. Each node's shares
//! of the groups are known beforehand (`levers`), so that no map of a node's own is made.

use crate::coarse::Lists;
use crate::constraints::OwnMotions;
use crate::levers::{GroupLevers, GroupShare};
use crate::problem::Problem;
use glam::{Affine3A, DMat3, DVec3, Mat3A, Vec3A};
use simod_plugin_api::{Host, PluginResult};
use std::sync::OnceLock;

/// Nodes at once on one thread.
const TOGETHER: usize = 4096;
/// Part of each of Jacobi's steps that is made: the most that takes down all roughness, whatever the
/// triangles.
const PART: f64 = 0.6;

/// Coefficients of the steps that smooth the displacements of free nodes.
///
/// Memory: 8 bytes for each node next to a node, and 4 for each node; about twice as much while that is made.
#[derive(Debug)]
pub struct Draft {
    /// Factor of the residual of each node's equation in a step: `PART` over the equation's diagonal.
    parts: Vec<f32>,
    /// Numbers and coefficients of the nodes whose displacements a step takes off at each node, its own
    /// included.
    steps: Lists<(u32, f32)>,
}

impl Draft {
    /// Coefficients of the nodes of a problem.
    fn new(fine: &Problem, host: &Host<'_>) -> PluginResult<Self> {
        let part = |i: usize| {
            let own = fine.operators.laplacian(i).find(|(column, _)| *column == i);
            own.filter(|(_, diagonal)| *diagonal > 0.0).map_or(0.0, |(_, diagonal)| PART / diagonal)
        };
        let steps = Lists::made(fine.free, TOGETHER, host, |i, list| {
            let part = part(i);
            list.extend(fine.operators.laplacian(i).map(|(j, l)| (j as u32, (part * l) as f32)));
        })?;
        Ok(Self { parts: (0..fine.free).map(|i| part(i) as f32).collect(), steps })
    }

    /// Coefficients of the nodes, found when the first draft asks for them: a full deformation needs none.
    pub fn once<'a>(kept: &'a OnceLock<Self>, fine: &Problem, host: &Host<'_>) -> PluginResult<&'a Self> {
        match kept.get() {
            Some(draft) => Ok(draft),
            None => {
                let made = Self::new(fine, host)?;
                Ok(kept.get_or_init(|| made))
            }
        }
    }

    /// Displacements of the fine problem's nodes, given those of the coarse one's and their rotations.
    pub fn carry(
        &self,
        (fine, levers): (&Problem, &GroupLevers),
        coarse: &Problem,
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
        let mut placed = fine.held_displacements(|target, at| motion.displacement(target, at));
        let held = |d: &DVec3| CarriedNode { placed: d.as_vec3a(), asked: Vec3A::ZERO };
        let mut carried: Vec<CarriedNode> = placed.iter().map(held).collect();
        host.parallel_blocks(&mut carried[..fine.free], TOGETHER, |first, carried| {
            for (i, node) in (first..).zip(carried) {
                *node = carried_node(levers.row(i), fine.rest[i], self.parts[i], &maps);
            }
        })?;
        // Part of each step that the rotations ask for is the same in both steps.
        let mut smoothed: Vec<Vec3A> = carried.iter().map(|node| node.placed).collect();
        host.parallel_blocks(&mut smoothed[..fine.free], TOGETHER, |first, smoothed| {
            for (i, d) in (first..).zip(smoothed) {
                *d += self.step(i, carried[i].asked, |j| carried[j].placed);
            }
        })?;
        host.parallel_blocks(&mut placed[..fine.free], TOGETHER, |first, placed| {
            for (i, d) in (first..).zip(placed) {
                *d = (smoothed[i] + self.step(i, carried[i].asked, |j| smoothed[j])).as_dvec3();
            }
        })?;
        Ok(placed)
    }

    /// Displacement of a node by a step of Jacobi's method.
    fn step(&self, node: usize, asked: Vec3A, given: impl Fn(usize) -> Vec3A) -> Vec3A {
        self.steps.row(node).iter().fold(asked, |step, (j, part)| step - given(*j as usize) * *part)
    }
}

/// Node on the way through a draft.
#[derive(Debug, Clone, Copy)]
struct CarriedNode {
    /// Displacement of the node.
    placed: Vec3A,
    /// Part of each step that the rotations around the node ask for.
    asked: Vec3A,
}

/// A node as the maps of the groups around it carry it; `part` is the factor of its residual in a step.
fn carried_node(shares: &[GroupShare], at: DVec3, part: f32, maps: &[Affine3A]) -> CarriedNode {
    let at = at.as_vec3a();
    let mut carried = CarriedNode { placed: Vec3A::ZERO, asked: Vec3A::ZERO };
    for GroupShare { group, weight, lever: [x, y, z] } in shares {
        let Affine3A { matrix3: m, translation } = &maps[*group as usize];
        carried.placed += (*m * at + *translation) * *weight;
        carried.asked += m.x_axis * *x + m.y_axis * *y + m.z_axis * *z;
    }
    carried.asked *= part;
    carried
}
