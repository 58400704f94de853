//! Coefficients by which rotations of a coarse likeness' groups act on the nodes of the fine problem.
//!
//! Where nodes turn by weighted means of their groups' rotations, both steps of *as rigid as possible* are
//! sums over pairs of a node and a group, each with one coefficient, its *lever*. In the global step, a
//! group's change times the lever is part of the node's side of the equations; in the local step, the product
//! of the node's displacement and the lever is part of the group's covariance. So no matrix of a node's own
//! is made, as most of the time goes to memory.

use crate::cells::covariances;
use crate::coarse::{Lists, Prolongation};
use crate::problem::Problem;
use glam::{DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};
use std::sync::OnceLock;

/// Nodes at once on one thread, while levers are found.
const TOGETHER: usize = 4096;
/// Nodes at once that one thread adds to covariances: many, as each such part has a sum for each group …
const LEAST_SUMMED: usize = 1 << 14;
/// … and most parts, whatever the number of threads, as sums are taken in one order.
const MOST_PARTS: usize = 16;
/// Least number of nodes of a part for each group: where groups are many, as of loose pieces, the sums of all
/// parts would take more memory than the nodes.
const LEAST_OF_A_GROUP: usize = 4;

/// Shares that the nodes of a problem have in the groups of its coarse likeness.
///
/// Memory: 20 bytes for each group around a node or those next to it, of which there are some ten; about
/// twice as much while they are found. While covariances are summed up, 72 bytes for each group and part, of
/// which there are at most 16.
#[derive(Debug)]
pub struct GroupLevers {
    /// Shares of all nodes, the held ones included.
    shares: Lists<GroupShare>,
    /// Covariances at rest of the groups whose surroundings are whole.
    at_rest: Vec<DMat3>,
}

/// Share that a node has in a group's map.
#[derive(Debug, Clone, Copy)]
pub struct GroupShare {
    /// Number of the group.
    pub group: u32,
    /// Weight of the group in the node's displacement.
    pub weight: f32,
    /// Factor of the change of the group's rotation in the node's equation.
    pub lever: [f32; 3],
}

impl GroupLevers {
    /// Levers of a problem whose likeness has `groups` that turn.
    fn new(
        fine: &Problem,
        groups: usize,
        prolongation: &Prolongation,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let still = vec![DVec3::ZERO; fine.len()];
        let at_rest = prolongation.sums(&covariances(fine, &still, host)?, groups, host)?;
        let shares = Lists::made(fine.len(), TOGETHER, host, |node, list| {
            group_shares(fine, prolongation, node, list)
        })?;
        Ok(Self { shares, at_rest })
    }

    /// Levers, found when they are asked for first.
    pub fn once<'a>(
        kept: &'a OnceLock<Self>,
        fine: &Problem,
        groups: usize,
        prolongation: &Prolongation,
        host: &Host<'_>,
    ) -> PluginResult<&'a Self> {
        match kept.get() {
            Some(levers) => Ok(levers),
            None => {
                let made = Self::new(fine, groups, prolongation, host)?;
                Ok(kept.get_or_init(|| made))
            }
        }
    }

    /// Shares that a node has in the groups around it.
    pub fn row(&self, node: usize) -> &[GroupShare] {
        self.shares.row(node)
    }

    /// Part of a node's equation that the groups' matrices make: zero where they are the identity.
    pub fn asked(&self, node: usize, matrices: &[DMat3]) -> DVec3 {
        self.row(node).iter().fold(DVec3::ZERO, |sum, GroupShare { group, lever, .. }| {
            let lever = DVec3::from(lever.map(f64::from));
            sum + (matrices[*group as usize] * lever - lever)
        })
    }

    /// Covariances of the groups, given the displacements of all nodes.
    pub fn covariances(&self, displacements: &[DVec3], host: &Host<'_>) -> PluginResult<Vec<DMat3>> {
        let length = displacements
            .len()
            .div_ceil(MOST_PARTS)
            .max(LEAST_SUMMED)
            .max(LEAST_OF_A_GROUP * self.at_rest.len());
        let mut parts = vec![Vec::new(); displacements.len().div_ceil(length)];
        host.parallel_blocks(&mut parts, 1, |first, parts| {
            for (k, sums) in (first..).zip(parts) {
                *sums = vec![DMat3::ZERO; self.at_rest.len()];
                let nodes = (k * length..).zip(displacements[k * length..].iter().take(length));
                nodes.for_each(|(node, d)| self.add(node, *d, sums));
            }
        })?;
        let mut covariances = self.at_rest.clone();
        for part in &parts {
            covariances.iter_mut().zip(part).for_each(|(sum, part)| *sum += *part);
        }
        Ok(covariances)
    }

    /// Adds a node's part of the covariances.
    fn add(&self, node: usize, displacement: DVec3, sums: &mut [DMat3]) {
        for GroupShare { group, lever: [x, y, z], .. } in self.row(node) {
            let sum = &mut sums[*group as usize];
            sum.x_axis += displacement * f64::from(*x);
            sum.y_axis += displacement * f64::from(*y);
            sum.z_axis += displacement * f64::from(*z);
        }
    }
}

/// Shares that a node has in all groups around it and around the nodes next to it.
fn group_shares(fine: &Problem, prolongation: &Prolongation, node: usize, shares: &mut Vec<GroupShare>) {
    // Held nodes farther from free ones do not turn.
    if node < fine.rows {
        let own = prolongation.groups_of(node);
        shares.extend(own.iter().map(|(group, weight)| GroupShare {
            group: *group,
            weight: *weight,
            lever: [0.0; 3],
        }));
    }
    for e in fine.operators.row(node).filter(|e| e.column < fine.rows) {
        let asked = e.out.as_vec3();
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coarse::coarsen;
    use crate::constraints::SampleTarget;
    use crate::intrinsic;
    use crate::problem::Constraint;
    use crate::tests::scene::tube;

    /// A tube that is held at one end, and is large enough for a likeness.
    fn problem(host: &Host<'_>) -> Problem {
        let scene = tube(60, 120, 0.15);
        let rest: Vec<DVec3> = scene.points.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let kind =
            |p: &DVec3| if p.z < 0.2 { Constraint::Held(SampleTarget::Fixed) } else { Constraint::Free };
        let kinds: Vec<Constraint> = rest.iter().map(kind).collect();
        Problem::new(&rest, &intrinsic::plain(&rest, &scene.triangles), &kinds, &[], host).unwrap()
    }

    #[test]
    fn levers_are_what_means_of_rotations_come_to() {
        let host = Host::new(&());
        let fine = problem(&host);
        let (coarse, prolongation) = coarsen(&fine, &host).unwrap().unwrap();
        let levers = GroupLevers::new(&fine, coarse.rows, &prolongation, &host).unwrap();
        let turn = |at: &DVec3| DMat3::from_rotation_y(2.0 * at.z) * DMat3::from_rotation_z(at.x);
        let turns: Vec<DMat3> = coarse.rest[..coarse.rows].iter().map(turn).collect();
        let blends = prolongation.means(&turns, &host).unwrap();
        let expected = |node: usize| -> DVec3 {
            fine.operators.row(node).map(|e| blends[e.column] * e.out - e.out).sum()
        };
        let size = (0..fine.free).map(|i| expected(i).length()).fold(0.0, f64::max);
        for node in 0..fine.free {
            let (asked, expected) = (levers.asked(node, &turns), expected(node));
            assert!(asked.distance(expected) < 1e-6 * size, "{node}: {asked} instead of {expected}");
        }
        let displacements: Vec<DVec3> = fine.rest.iter().map(|p| turn(p) * *p - *p).collect();
        let of_nodes = covariances(&fine, &displacements, &host).unwrap();
        let expected = prolongation.sums(&of_nodes, coarse.rows, &host).unwrap();
        let found = levers.covariances(&displacements, &host).unwrap();
        let numbers = |m: &DMat3| m.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
        let size = expected.iter().map(numbers).fold(0.0, f64::max);
        assert_eq!(found.len(), expected.len());
        for (group, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!(numbers(&(*found - *expected)) < 1e-6 * size, "{group}: {found} instead of {expected}");
        }
        // Groups that do not turn add nothing at all.
        assert_eq!(levers.asked(17, &vec![DMat3::IDENTITY; coarse.rows]), DVec3::ZERO);
    }
}
