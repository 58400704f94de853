//! The part of each handle's motion that each sample makes.
//!
//! Between the fixed region, at distance d₀, and one handle, at d₁, the paper's parameter is t = d₀ / (d₀ +
//! d₁): the share of 1/d₁ in 1/d₀ + 1/d₁. In this form it holds for any number of handles: the share of
//! each in the sum of the reciprocals. A scale function makes the part of the motion of it, and is flat at
//! both ends, so that no border shows.

use crate::distance;
use crate::regions::MergedRegions;
use glam::{DMat2, DVec2, Vec3};
use simod_geometry::smoothstep;
use simod_plugin_api::{Curve, Graph, Host, ParamDesc, Params, PluginError, PluginResult};

/// Number of samples that are looked after at once on one thread.
const BLOCK: usize = 4096;
/// Number of neighbours over which shares are smoothed.
const RING: usize = 12;
/// Greatest number of passes of smoothing.
const MOST_PASSES: f64 = 300.0;
/// Part of the neighbours' mean that is taken in a pass.
const PART: f64 = 0.5;
/// Part of the preparation's progress that the distances have.
const DISTANCES: f64 = 0.5;

/// Shares of the fixed regions and of all handles, sample by sample: they sum up to 1.
pub struct HandleShares {
    /// Share of the fixed regions first, and then those of the handles, sample by sample.
    values: Vec<f32>,
    /// Number of columns: one for the fixed regions, and one for each handle.
    columns: usize,
}

/// Samples at rest with their normals and neighbours.
pub struct SurfaceAtRest<'a> {
    /// Positions in local coordinates.
    pub positions: &'a [Vec3],
    /// Unit normals.
    pub normals: &'a [Vec3],
    /// The samples' neighbours.
    pub graph: &'a Graph<'a>,
}

/// Rule by which shares are computed.
pub struct ShareRule {
    /// Whether distances are along the surface, not through space.
    pub on_surface: bool,
    /// Reach of handles where nothing is fixed, in local coordinates.
    pub reach: f64,
    /// Length over which shares are smoothed, in local coordinates.
    pub smoothing: f64,
}

impl HandleShares {
    /// The shares of all samples.
    pub fn new(
        regions: &MergedRegions,
        samples: &SurfaceAtRest<'_>,
        measure: &ShareRule,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        let SurfaceAtRest { positions, normals, graph } = samples;
        let mut distances = Vec::with_capacity(regions.parts.len());
        for part in &regions.parts {
            host.progress(DISTANCES * distances.len() as f64 / regions.parts.len() as f64)?;
            distances.push(if measure.on_surface {
                distance::on_surface(positions, normals, graph, &part.core, host)?
            } else {
                distance::in_space(positions, &part.core, host)?
            });
        }
        if !regions.has_fixed {
            let reach = measure.reach as f32;
            let nearest = |i: usize| distances.iter().map(|d| d[i]).fold(f32::INFINITY, f32::min);
            let left: Vec<f32> = (0..positions.len()).map(|i| (reach - nearest(i)).max(0.0)).collect();
            distances.insert(0, left);
        }
        let columns = distances.len();
        let mut values = vec![0.0; positions.len() * columns];
        host.parallel_blocks(&mut values, BLOCK * columns, |first, block| {
            for (i, shares) in (first / columns..).zip(block.chunks_exact_mut(columns)) {
                reciprocals(|r| distances[r][i], shares);
            }
        })?;
        let mut shares = Self { values, columns };
        // Samples of regions keep their shares, and so do those that no handle reaches.
        let mut held: Vec<bool> = (0..positions.len()).map(|i| shares.row(i)[0] == 1.0).collect();
        regions.parts.iter().flat_map(|p| &p.core).for_each(|&i| held[i as usize] = true);
        shares.smooth(&held, samples, measure.smoothing, host)?;
        let first = columns - regions.parts.len();
        host.parallel_blocks(&mut shares.values, BLOCK * columns, |start, block| {
            for (i, shares) in (start / columns..).zip(block.chunks_exact_mut(columns)) {
                soften(|r| regions.parts[r].weights[i], first, shares);
            }
        })?;
        for (r, part) in regions.parts.iter().enumerate() {
            for &i in &part.core {
                let shares = &mut shares.values[i as usize * columns..][..columns];
                shares.fill(0.0);
                shares[first + r] = 1.0;
            }
        }
        Ok(shares)
    }

    /// Shares of a sample: of the fixed regions first, and then of the handles.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.columns..][..self.columns]
    }

    /// The number of handles.
    pub fn handles(&self) -> usize {
        self.columns - 1
    }

    /// The number of samples.
    pub fn samples(&self) -> usize {
        self.values.len() / self.columns
    }

    /// Smooths shares along the surface: distances have ridges, and distances to samples have dents.
    fn smooth(
        &mut self,
        held: &[bool],
        samples: &SurfaceAtRest<'_>,
        length: f64,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        if length <= 0.0 {
            return Ok(());
        }
        let mut rings = vec![Ring::default(); held.len()];
        host.parallel_blocks(&mut rings, BLOCK, |first, block| {
            block.iter_mut().zip(first..).for_each(|(ring, i)| *ring = Ring::around(samples, i));
        })?;
        let mean = rings.iter().map(|r| f64::from(r.square)).sum::<f64>() / rings.len() as f64;
        if mean <= 0.0 {
            return Ok(());
        }
        // A pass is a step of diffusion that spreads by so much of the squared distance.
        let passes = (length * length / (PART * mean)).ceil().min(MOST_PASSES) as usize;
        let mut next = self.values.clone();
        let columns = self.columns;
        for pass in 0..passes {
            host.progress(DISTANCES + (1.0 - DISTANCES) * pass as f64 / passes as f64)?;
            let now = &self.values;
            host.parallel_blocks(&mut next, BLOCK * columns, |first, block| {
                for (i, shares) in (first / columns..).zip(block.chunks_exact_mut(columns)) {
                    if held[i] {
                        continue;
                    }
                    let ring = &rings[i];
                    for (c, share) in shares.iter_mut().enumerate() {
                        let mean = |(j, w): (&u32, &f32)| w * now[*j as usize * columns + c];
                        let near: f32 = ring.samples.iter().zip(&ring.weights).map(mean).sum();
                        let own = now[i * columns + c];
                        *share = own + PART as f32 * (near - own);
                    }
                }
            })?;
            std::mem::swap(&mut self.values, &mut next);
        }
        Ok(())
    }
}

/// The nearest neighbours of a sample on its side of the surface, with weights that sum up to 1.
#[derive(Debug, Clone, Default)]
struct Ring {
    samples: [u32; RING],
    weights: [f32; RING],
    /// Mean of the neighbours' squared distances.
    square: f32,
}

impl Ring {
    /// Ring of a sample, whose weighted mean is the sample itself, as far as positive weights can do that:
    /// a value that grows evenly is left as it is, though samples lie unevenly. Of all such weights these
    /// are the most alike.
    ///
    /// M. Arroyo, M. Ortiz, Local maximum-entropy approximation schemes, Int. J. Numer. Meth. Engng. 65
    /// (2006).
    fn around(of: &SurfaceAtRest<'_>, i: usize) -> Self {
        const NEWTON: usize = 8;
        /// Greatest steepness: weights differ by no more than the exponential of twice this.
        const STEEPEST: f64 = 4.0;
        let p = of.positions[i];
        let same_side = |j: &&u32| of.normals[i].dot(of.normals[**j as usize]) > -0.5;
        let mut ring = Self { samples: [i as u32; RING], ..Self::default() };
        let near = of.graph.of(i).iter().filter(same_side);
        ring.samples.iter_mut().zip(near).for_each(|(place, j)| *place = *j);
        let to = ring.samples.map(|j| (of.positions[j as usize] - p).as_dvec3());
        let radius = to.iter().map(|d| d.length()).fold(0.0, f64::max);
        ring.weights = [1.0 / RING as f32; RING];
        let Some(normal) = of.normals[i].as_dvec3().try_normalize().filter(|_| radius > 0.0) else {
            return ring;
        };
        let (s, t) = normal.any_orthonormal_pair();
        let at = to.map(|d| DVec2::new(d.dot(s), d.dot(t)) / radius);
        let mut slope = DVec2::ZERO;
        let mut weights = [1.0 / RING as f64; RING];
        for _ in 0..NEWTON {
            let mean: DVec2 = at.iter().zip(&weights).map(|(u, w)| *w * *u).sum();
            let spread = at.iter().zip(&weights).map(|(u, w)| {
                let d = *u - mean;
                *w * DMat2::from_cols(d * d.x, d * d.y)
            });
            let spread = spread.fold(DMat2::from_diagonal(DVec2::splat(1e-9)), |sum, m| sum + m);
            slope = (slope + spread.inverse() * mean).clamp_length_max(STEEPEST);
            weights = at.map(|u| (-slope.dot(u)).exp());
            let sum: f64 = weights.iter().sum();
            weights.iter_mut().for_each(|w| *w /= sum);
        }
        ring.weights = weights.map(|w| w as f32);
        ring.square = to.iter().zip(weights).map(|(d, w)| w * d.length_squared()).sum::<f64>() as f32;
        ring
    }
}

/// Shares of the reciprocals of distances in their sum.
fn reciprocals(distance: impl Fn(usize) -> f32, shares: &mut [f32]) {
    shares.fill(0.0);
    if let Some(there) = (0..shares.len()).find(|&r| distance(r) <= 0.0) {
        shares[there] = 1.0;
        return;
    }
    // Reciprocals are relative to the nearest distance, so that nothing overflows.
    let nearest = (0..shares.len()).map(&distance).fold(f32::INFINITY, f32::min);
    if nearest == f32::INFINITY {
        // No region can be reached from here.
        shares[0] = 1.0;
        return;
    }
    shares.iter_mut().enumerate().for_each(|(r, share)| *share = nearest / distance(r));
    let sum: f32 = shares.iter().sum();
    shares.iter_mut().for_each(|share| *share /= sum);
}

/// Gives regions, the first of which has share `first`, as much of a sample as their weights say.
fn soften(weight: impl Fn(usize) -> f32, first: usize, shares: &mut [f32]) {
    let sum: f32 = (first..shares.len()).map(|c| weight(c - first)).sum();
    if sum <= 0.0 {
        return;
    }
    let (free, scale) = ((1.0 - sum).max(0.0), sum.max(1.0).recip());
    for (c, share) in shares.iter_mut().enumerate() {
        let own = c.checked_sub(first).map_or(0.0, &weight);
        *share = free * *share + scale * own;
    }
}

/// Function by which shares become parts of motions.
pub enum Profile<'a> {
    /// The share itself.
    Linear,
    /// 3t² - 2t³: no border shows.
    Smooth,
    /// 6t⁵ - 15t⁴ + 10t³: not even in reflections.
    Smoother,
    /// A curve that the user draws.
    Curve(Curve<'a>),
}

impl<'a> Profile<'a> {
    /// Parameters of the profile.
    pub fn params() -> [ParamDesc; 2] {
        let profiles =
            [("smooth", "Smooth"), ("smoother", "Smoother"), ("linear", "Linear"), ("curve", "Drawn")];
        [
            ParamDesc::choice("profile", "Profile", "smoother", &profiles)
                .hint("Growth of the motion from what is fixed to a handle"),
            ParamDesc::curve("curve", "Curve", &[[0.0, 0.0], [1.0, 1.0]]).hint(
                "Part of the motion from what is fixed (left) to a handle (right), for the drawn profile",
            ),
        ]
    }

    /// Profile that the parameters choose.
    pub fn from_params(params: Params<'a>) -> PluginResult<Self> {
        match params.choice("profile")? {
            "smooth" => Ok(Self::Smooth),
            "smoother" => Ok(Self::Smoother),
            "linear" => Ok(Self::Linear),
            "curve" => Ok(Self::Curve(params.curve("curve")?)),
            other => Err(PluginError::parameter("profile", &format!("is unknown: {other}"))),
        }
    }

    /// Key of the profile: its number, and the points of a drawn one.
    pub fn key(&self) -> (u8, Vec<[f64; 2]>) {
        match self {
            Self::Linear => (0, Vec::new()),
            Self::Smooth => (1, Vec::new()),
            Self::Smoother => (2, Vec::new()),
            Self::Curve(curve) => (3, curve.points().to_vec()),
        }
    }

    fn evaluate(&self, t: f64) -> f64 {
        match self {
            Self::Linear => t,
            Self::Smooth => smoothstep(t),
            Self::Smoother => t * t * t * (t * (6.0 * t - 15.0) + 10.0),
            Self::Curve(curve) => curve.at(t),
        }
    }

    /// Part of each handle's motion that a sample with these shares makes: together the profile of the part
    /// that is not fixed, divided in proportion to the profile of each share.
    pub fn amounts(&self, shares: &[f32], amounts: &mut [f64]) {
        let handles = &shares[1..];
        if let Some(own) = shares.iter().position(|s| *s == 1.0) {
            amounts.fill(0.0);
            own.checked_sub(1).into_iter().for_each(|h| amounts[h] = 1.0);
            return;
        }
        amounts.iter_mut().zip(handles).for_each(|(amount, s)| *amount = self.evaluate(f64::from(*s)));
        let sum: f64 = amounts.iter().sum();
        let whole = self.evaluate(handles.iter().map(|s| f64::from(*s)).sum::<f64>().clamp(0.0, 1.0));
        let scale = if sum > 0.0 { whole / sum } else { 0.0 };
        amounts.iter_mut().for_each(|amount| *amount *= scale);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_grows_evenly_is_smooth_already() {
        // A plane, its samples scattered about those of a lattice.
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        let at = |k: i32, random: f32| (k as f32 + 0.8 * random) / 30.0;
        let positions: Vec<Vec3> =
            (0..900).map(|i| Vec3::new(at(i % 30, random()), at(i / 30, random()), 0.0)).collect();
        let normals = vec![Vec3::Z; positions.len()];
        let mut neighbours = Vec::new();
        for p in &positions {
            let mut near: Vec<u32> = (0..positions.len() as u32).collect();
            near.sort_by(|a, b| {
                positions[*a as usize].distance(*p).total_cmp(&positions[*b as usize].distance(*p))
            });
            neighbours.extend(&near[1..=16]);
        }
        let starts: Vec<u32> = (0..=positions.len() as u32).map(|i| 16 * i).collect();
        let graph = Graph::new(&starts, &neighbours);
        let samples = SurfaceAtRest { positions: &positions, normals: &normals, graph: &graph };
        let inner =
            (0..positions.len()).filter(|&i| (positions[i] - 0.5).truncate().abs().max_element() < 0.35);
        for i in inner {
            let ring = Ring::around(&samples, i);
            let mean: Vec3 =
                ring.samples.iter().zip(ring.weights).map(|(j, w)| w * positions[*j as usize]).sum();
            assert!(mean.distance(positions[i]) < 1e-3, "{i}: {mean} {}", positions[i]);
            assert!(ring.weights.iter().all(|w| *w > 0.0));
        }
    }

    #[test]
    fn shares_of_two_are_the_papers_parameter() {
        let distances = [3.0, 1.0];
        let mut shares = [0.0; 2];
        reciprocals(|r| distances[r], &mut shares);
        assert_eq!(shares, [0.25, 0.75]);
        let mut amounts = [0.0];
        Profile::Smooth.amounts(&shares, &mut amounts);
        assert!((amounts[0] - 0.75 * 0.75 * 1.5).abs() < 1e-7);
        reciprocals(|r| [f32::INFINITY, 1.0][r], &mut shares);
        assert_eq!(shares, [0.0, 1.0]);
        reciprocals(|_| f32::INFINITY, &mut shares);
        assert_eq!(shares, [1.0, 0.0]);
    }

    #[test]
    fn weights_pull_towards_their_regions() {
        let mut shares = [0.5, 0.5];
        soften(|_| 0.0, 0, &mut shares);
        assert_eq!(shares, [0.5, 0.5]);
        soften(|r| [0.0, 0.5][r], 0, &mut shares);
        assert_eq!(shares, [0.25, 0.75]);
        soften(|r| [1.0, 1.0][r], 0, &mut shares);
        assert_eq!(shares, [0.5, 0.5]);
        // Without a fixed region, the first share is nobody's.
        soften(|_| 1.0, 1, &mut shares);
        assert_eq!(shares, [0.0, 1.0]);
    }

    #[test]
    fn two_halves_of_a_handle_do_as_one() {
        let mut amounts = [0.0; 2];
        Profile::Smoother.amounts(&[0.4, 0.3, 0.3], &mut amounts);
        let whole = Profile::Smoother.evaluate(0.6);
        assert!((amounts[0] + amounts[1] - whole).abs() < 1e-7 && amounts[0] == amounts[1]);
    }
}
