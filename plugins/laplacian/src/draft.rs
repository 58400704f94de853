//! A quick picture: a coarse likeness' pose, carried over to the surface.
//!
//! Groups move rigidly, and nodes by the weighted means of the maps of the groups around them. The roughness
//! of that is smoothed by a few steps of Jacobi's method on the global step's equations (Sorkine and Alexa
//! 2007). All is in single precision, as what is shown is, since the time goes to memory. Each node's shares
//! of the groups are known beforehand, so that no map of a node's own is made.

use crate::coarse::{Lists, Prolongation};
use crate::constraints::OwnMotions;
use crate::problem::Problem;
use glam::{Affine3A, DMat3, DVec3, Mat3A, Vec3A};
use simod_plugin_api::{Host, PluginResult};
use std::sync::OnceLock;

/// Nodes at once on one thread.
const TOGETHER: usize = 4096;
/// Part of each of Jacobi's steps that is made: the most that takes down all roughness, whatever the
/// triangles.
const PART: f64 = 0.6;

/// Shares that free nodes have in the coarse likeness' groups, and in the nodes next to them.
///
/// Memory: 20 bytes for each group around a node or those next to it, of which there are some ten, and 8 for
/// each node next to it; about twice as much while that is made.
#[derive(Debug)]
pub struct Draft {
    shares: Lists<GroupShare>,
    /// Numbers and coefficients of the nodes whose displacements a step takes off at each node, its own
    /// included.
    steps: Lists<(u32, f32)>,
}

/// Share that a node has in a group's map.
#[derive(Debug, Clone, Copy)]
struct GroupShare {
    group: u32,
    /// Weight of the group in the node's displacement.
    weight: f32,
    /// Factor of the change of the group's rotation in a step.
    lever: [f32; 3],
}

impl Draft {
    /// Shares of the nodes of a problem.
    fn new(fine: &Problem, prolongation: &Prolongation, host: &Host<'_>) -> PluginResult<Self> {
        // Factor of the residual of a node's equation in a step: `PART` over the equation's diagonal.
        let part = |i: usize| {
            let own = fine.operators.laplacian(i).find(|(column, _)| *column == i);
            own.filter(|(_, diagonal)| *diagonal > 0.0).map_or(0.0, |(_, diagonal)| PART / diagonal)
        };
        let shares = lists(fine.free, host, |i| group_shares(fine, prolongation, i, part(i)))?;
        let steps = lists(fine.free, host, |i| {
            let part = part(i);
            fine.operators.laplacian(i).map(|(j, l)| (j as u32, (part * l) as f32)).collect()
        })?;
        Ok(Self { shares, steps })
    }

    /// Shares of the nodes, found when the first draft asks for them: a full deformation needs none.
    pub fn once<'a>(
        kept: &'a OnceLock<Self>,
        fine: &Problem,
        prolongation: &Prolongation,
        host: &Host<'_>,
    ) -> PluginResult<&'a Self> {
        match kept.get() {
            Some(draft) => Ok(draft),
            None => {
                let made = Self::new(fine, prolongation, host)?;
                Ok(kept.get_or_init(|| made))
            }
        }
    }

    /// Displacements of the fine problem's nodes, given those of the coarse one's and their rotations.
    pub fn carry(
        &self,
        fine: &Problem,
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
                *node = self.carried(i, fine.rest[i], &maps);
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

    /// A node as the groups' maps carry it.
    fn carried(&self, node: usize, at: DVec3, maps: &[Affine3A]) -> CarriedNode {
        let at = at.as_vec3a();
        let mut carried = CarriedNode { placed: Vec3A::ZERO, asked: Vec3A::ZERO };
        for GroupShare { group, weight, lever: [x, y, z] } in self.shares.row(node) {
            let Affine3A { matrix3: m, translation } = &maps[*group as usize];
            carried.placed += (*m * at + *translation) * *weight;
            carried.asked += m.x_axis * *x + m.y_axis * *y + m.z_axis * *z;
        }
        carried
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

/// Lists of `count` nodes, each as `list` makes it.
fn lists<T: Copy + Send>(
    count: usize,
    host: &Host<'_>,
    list: impl Fn(usize) -> Vec<T> + Sync,
) -> PluginResult<Lists<T>> {
    let mut all: Vec<Vec<T>> = vec![Vec::new(); count];
    host.parallel_blocks(&mut all, TOGETHER, |first, all| {
        (first..).zip(all).for_each(|(i, made)| *made = list(i));
    })?;
    Ok(Lists::new(&all))
}

/// Shares that a node has in all groups around it and around the nodes next to it, where a step makes the
/// given part of what is lacking.
fn group_shares(fine: &Problem, prolongation: &Prolongation, node: usize, part: f64) -> Vec<GroupShare> {
    let mut shares: Vec<GroupShare> = Vec::new();
    let own = prolongation.groups_of(node);
    shares.extend(own.iter().map(|(group, weight)| GroupShare {
        group: *group,
        weight: *weight,
        lever: [0.0; 3],
    }));
    for e in fine.operators.row(node) {
        let asked = (part * e.out).as_vec3();
        for (group, weight) in prolongation.groups_of(e.column) {
            let known = shares.iter().position(|share| share.group == *group);
            let at = known.unwrap_or_else(|| {
                shares.push(GroupShare { group: *group, weight: 0.0, lever: [0.0; 3] });
                shares.len() - 1
            });
            let lever = &mut shares[at].lever;
            (0..3).for_each(|axis| lever[axis] += asked[axis] * weight);
        }
    }
    shares
}
