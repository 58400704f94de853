//! Loose parts, which nothing holds: each follows, as a whole, the samples nearest to it.
//!
//! So eyes go with their head, and buttons with their coat. The motion is the rigid one nearest to the
//! motions of the samples around (K. Arun et al., *Least-Squares Fitting of Two 3-D Point Sets*, PAMI 1987).

use crate::rotation;
use glam::{DAffine3, DMat3, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use simod_plugin_api::{Graph, Host, PluginError, PluginResult};
use std::collections::BTreeMap;

/// Samples of a part that look for others to follow.
const SEEKERS: usize = 32;
/// Neighbours of those leaders that are followed too: one sample alone does not tell how it turns.
const COMPANIONS: usize = 8;

/// Samples that the loose parts follow.
#[derive(Debug, Default)]
pub struct Followers {
    /// Samples that each part follows.
    leaders: Vec<Vec<u32>>,
}

impl Followers {
    /// Finds the samples that each part, given by its own samples, follows: others that are not loose, of
    /// which there are some.
    pub fn new(
        positions: &[[f32; 3]],
        parts: &BTreeMap<u32, Vec<u32>>,
        is_loose: impl Fn(u32) -> bool + Sync,
        graph: Option<&Graph<'_>>,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        if parts.is_empty() {
            return Ok(Self::default());
        }
        let held: Vec<u32> = (0..positions.len() as u32).filter(|i| !is_loose(*i)).collect();
        let at: Vec<[f32; 3]> = held.iter().map(|i| positions[*i as usize]).collect();
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&at)
            .map_err(|_| PluginError::internal("the samples cannot be searched"))?;
        let parts: Vec<&Vec<u32>> = parts.values().collect();
        let mut leaders = vec![Vec::new(); parts.len()];
        host.parallel_blocks(&mut leaders, 64, |first, leaders| {
            for (leaders, part) in leaders.iter_mut().zip(&parts[first..]) {
                let seekers = part.iter().step_by(part.len().div_ceil(SEEKERS));
                for &i in seekers {
                    let nearest =
                        tree.query(&positions[i as usize]).nearest_one::<SquaredEuclidean<f32>>().execute();
                    let leader = held[nearest.item as usize];
                    leaders.push(leader);
                    if let Some(graph) = graph.filter(|g| g.len() == positions.len()) {
                        let near = graph.of(leader as usize).iter().copied();
                        leaders.extend(near.filter(|j| !is_loose(*j)).take(COMPANIONS));
                    }
                }
                leaders.sort_unstable();
                leaders.dedup();
            }
        })?;
        Ok(Self { leaders })
    }

    /// Motions of the parts, given the images of samples that are not loose.
    pub fn motions(
        &self,
        positions: &[[f32; 3]],
        image: impl Fn(u32) -> DVec3 + Sync,
        host: &Host<'_>,
    ) -> PluginResult<Vec<DAffine3>> {
        let mut motions = vec![DAffine3::IDENTITY; self.leaders.len()];
        host.parallel_blocks(&mut motions, 64, |first, motions| {
            for (motion, leaders) in motions.iter_mut().zip(&self.leaders[first..]) {
                let pairs =
                    leaders.iter().map(|&i| (DVec3::from(positions[i as usize].map(f64::from)), image(i)));
                *motion = rigid(&pairs.collect::<Vec<_>>());
            }
        })?;
        Ok(motions)
    }
}

/// The rigid motion nearest to pairs of points and their images.
fn rigid(pairs: &[(DVec3, DVec3)]) -> DAffine3 {
    let share = 1.0 / pairs.len().max(1) as f64;
    let (from, to) =
        pairs.iter().fold((DVec3::ZERO, DVec3::ZERO), |(a, b), (p, q)| (a + *p * share, b + *q * share));
    let mut covariance = DMat3::ZERO;
    for (p, q) in pairs {
        let (p, q) = (*p - from, *q - to);
        covariance += DMat3::from_cols(q * p.x, q * p.y, q * p.z);
    }
    let turn = rotation::nearest(covariance, DMat3::IDENTITY);
    DAffine3 { matrix3: turn, translation: to - turn * from }
}
