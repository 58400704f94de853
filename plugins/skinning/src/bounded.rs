//! Bounded biharmonic weights: A. Jacobson, I. Baran, J. Popović, O. Sorkine, *Bounded biharmonic weights for
//! real-time deformation*, SIGGRAPH 2011.
//!
//! Each joint's weights are the smoothest ones that are 1 on its bones, 0 on those of others, and between 0
//! and 1: the least `½ wᵀ L M⁻¹ L w`. As there, joints are done by themselves, and in the end their weights
//! are divided by their sum.
//!
//! The least is found by projected gradients with momentum (A. Beck, M. Teboulle, *A fast iterative
//! shrinkage-thresholding algorithm*, SIAM J. Imaging Sci. 2, 2009; restarted as by B. O'Donoghue, E. Candès,
//! *Adaptive restart for accelerated gradient schemes*, Found. Comput. Math. 15, 2015), first on the coarsest
//! level, and on each finer one from there on: the changes that are left to be found are a few cells wide.

use crate::levels::{Held, Level};

/// Joints that are done at once.
pub const LANES: usize = 4;
/// The weights of as many joints at a node.
pub type Lanes = [f64; LANES];

/// Largest number of steps on a level, the finest first; those further up, and the coarsest, have as many as
/// the last one.
const STEPS: [usize; 3] = [120, 500, 2000];
/// Largest change of a weight in a step at which steps end.
const SETTLED: f64 = 3e-7;
/// Distance from 0 or 1 within which weights on a coarser level are so on finer ones.
const NEARLY: f64 = 1e-3;
/// Steps between two looks at whether they have settled.
const PATIENCE: usize = 10;

/// The weights of some joints at all nodes of the finest level. Stopped half-way if `is_wanted` says so.
pub fn solve(levels: &[Level], held: &[Held], joints: &[u16], is_wanted: impl Fn() -> bool) -> Vec<Lanes> {
    let mut coarser: Vec<Lanes> = Vec::new();
    for (depth, (level, held)) in levels.iter().zip(held).enumerate().rev() {
        let from = |node: u32| coarser[level.parents[node as usize] as usize];
        let mut weights: Vec<Lanes> = match coarser.len() {
            0 => vec![[0.0; LANES]; level.len()],
            _ => (0..level.len() as u32).map(from).collect(),
        };
        // Nodes whose weights are 0 or 1 all around stay as they are.
        let is_coarsest = coarser.is_empty();
        let is_open =
            |node: u32| is_coarsest || is_between(&levels[depth + 1], &coarser, level.parents[node as usize]);
        let mut is_free: Vec<bool> = (0..level.len() as u32).map(is_open).collect();
        for (node, shares) in held {
            is_free[*node as usize] = false;
            let share = |joint: &u16| shares.iter().find(|s| s.0 == *joint).map_or(0.0, |s| s.1);
            let own = &mut weights[*node as usize];
            *own = [0.0; LANES];
            own.iter_mut().zip(joints).for_each(|(w, joint)| *w = share(joint));
        }
        let steps = if is_coarsest { STEPS[STEPS.len() - 1] } else { STEPS[depth.min(STEPS.len() - 1)] };
        Part::new(level, &is_free).descend(&mut weights, steps, &is_wanted);
        coarser = weights;
    }
    coarser
}

/// Whether the weights at a node and beside it are not all nearly 0 or 1, and the same.
fn is_between(level: &Level, weights: &[Lanes], node: u32) -> bool {
    let own = &weights[node as usize];
    let differs = |other: &Lanes| own.iter().zip(other).any(|(a, b)| (a - b).abs() > NEARLY);
    own.iter().any(|w| *w > NEARLY && *w < 1.0 - NEARLY)
        || level.links(node).iter().any(|(other, _)| differs(&weights[*other as usize]))
}

/// Free nodes of a level, then the nodes that these are linked to, then the nodes that those are linked to,
/// numbered anew.
struct Part {
    nodes: Vec<u32>,
    free: usize,
    /// Nodes whose Laplacian counts.
    rows: usize,
    starts: Vec<u32>,
    links: Vec<(u32, f32)>,
    masses: Vec<f64>,
    /// Sum of the sizes of each row of the energy's second derivatives: steps that are shorter by this factor
    /// go down.
    bounds: Vec<f64>,
}

impl Part {
    fn new(level: &Level, is_free: &[bool]) -> Self {
        let mut places = vec![u32::MAX; level.len()];
        let mut nodes: Vec<u32> = (0..level.len() as u32).filter(|n| is_free[*n as usize]).collect();
        nodes.iter().zip(0..).for_each(|(n, place)| places[*n as usize] = place);
        let free = nodes.len();
        let mut ends = [free; 2];
        let mut first = 0;
        for end in &mut ends {
            let last = nodes.len();
            for place in first..last {
                for (other, _) in level.links(nodes[place]) {
                    if places[*other as usize] == u32::MAX {
                        places[*other as usize] = nodes.len() as u32;
                        nodes.push(*other);
                    }
                }
            }
            (first, *end) = (last, nodes.len());
        }
        let rows = ends[0];
        let mut starts = vec![0_u32];
        let mut links = Vec::new();
        for node in &nodes[..rows] {
            links.extend(level.links(*node).iter().map(|(other, by)| (places[*other as usize], *by)));
            starts.push(links.len() as u32);
        }
        let masses = nodes.iter().map(|n| level.masses[*n as usize]).collect();
        let mut this = Self { nodes, free, rows, starts, links, masses, bounds: Vec::new() };
        let size = |row: usize| 2.0 * this.degree(row) / this.masses[row];
        let bound = |row: usize| {
            let others = this.links(row).iter().map(|(other, by)| f64::from(*by) * size(*other as usize));
            this.degree(row) * size(row) + others.sum::<f64>()
        };
        // A node that is linked to none would have the bound 0.
        this.bounds = (0..free).map(|row| bound(row).max(f64::MIN_POSITIVE)).collect();
        this
    }

    fn links(&self, row: usize) -> &[(u32, f32)] {
        &self.links[self.starts[row] as usize..self.starts[row + 1] as usize]
    }

    fn degree(&self, row: usize) -> f64 {
        self.links(row).iter().map(|l| f64::from(l.1)).sum()
    }

    /// Sum of a row's differences to the nodes that it is linked to.
    fn laplacian(&self, row: usize, of: &[Lanes]) -> Lanes {
        let mut sum = [0.0; LANES];
        let own = of[row];
        for (other, by) in self.links(row) {
            let (other, by) = (&of[*other as usize], f64::from(*by));
            (0..LANES).for_each(|k| sum[k] += by * (other[k] - own[k]));
        }
        sum
    }

    /// Goes down from given weights.
    fn descend(&self, all: &mut [Lanes], most: usize, is_wanted: impl Fn() -> bool) {
        let mut weights: Vec<Lanes> = self.nodes.iter().map(|n| all[*n as usize]).collect();
        let mut ahead = weights.clone();
        let mut bends = vec![[0.0; LANES]; self.rows];
        let mut momentum = [1.0_f64; LANES];
        for step in 1..=most {
            for (row, bend) in bends.iter_mut().enumerate() {
                let sum = self.laplacian(row, &ahead);
                *bend = sum.map(|x| x / self.masses[row]);
            }
            let (mut uphill, mut most_moved) = ([0.0; LANES], 0.0_f64);
            // The former weights are kept in place of the latter until these are known.
            for row in 0..self.free {
                let slope = self.laplacian(row, &bends);
                let (from, former) = (ahead[row], weights[row]);
                let bound = self.bounds[row];
                for k in 0..LANES {
                    let to = (from[k] - slope[k] / bound).clamp(0.0, 1.0);
                    uphill[k] += bound * (from[k] - to) * (to - former[k]);
                    most_moved = most_moved.max((to - former[k]).abs());
                    weights[row][k] = to;
                    ahead[row][k] = former[k];
                }
            }
            let mut onwards = [0.0; LANES];
            for k in 0..LANES {
                if uphill[k] > 0.0 {
                    momentum[k] = 1.0;
                }
                let next = 0.5 * (1.0 + (1.0 + 4.0 * momentum[k] * momentum[k]).sqrt());
                onwards[k] = (momentum[k] - 1.0) / next;
                momentum[k] = next;
            }
            for (ahead, weights) in ahead[..self.free].iter_mut().zip(&weights) {
                (0..LANES).for_each(|k| ahead[k] = weights[k] + onwards[k] * (weights[k] - ahead[k]));
            }
            if step.is_multiple_of(PATIENCE) && (most_moved < SETTLED || !is_wanted()) {
                break;
            }
        }
        self.nodes[..self.free].iter().zip(&weights).for_each(|(n, w)| all[*n as usize] = *w);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::{coarsened, coarser_held};
    use glam::IVec3;
    use proptest::prelude::*;

    fn solved(links: &[(u32, u32)], cells: Vec<IVec3>, held: Held, joints: &[u16]) -> Vec<Lanes> {
        let both = links.iter().flat_map(|(a, b)| [(*a, *b, 1.0), (*b, *a, 1.0)]).collect();
        let levels = coarsened(Level::new(both, vec![1.0; cells.len()], cells));
        let mut all = vec![held];
        for (level, depth) in levels[..levels.len() - 1].iter().zip(0..) {
            let next = coarser_held(&all[depth], level);
            all.push(next);
        }
        solve(&levels, &all, joints, || true)
    }

    fn chain(nodes: u32, held: Held) -> Vec<Lanes> {
        let links: Vec<(u32, u32)> = (1..nodes).map(|i| (i - 1, i)).collect();
        solved(&links, (0..nodes).map(|i| IVec3::X * i as i32).collect(), held, &[3, 5])
    }

    /// Between two bones in a line, fourth differences are 0: a cubic polynomial.
    #[test]
    fn between_two_bones_weights_are_cubic() {
        for (gap, far) in [(10_u32, 1e-4), (24, 2e-3)] {
            let first = (0..5).map(|i| (i, vec![(3, 1.0)]));
            let second = (4 + gap..9 + gap).map(|i| (i, vec![(5, 1.0)]));
            let weights = chain(9 + gap, first.chain(second).collect());
            // Through 1 at -1 and 0, and 0 at n and n + 1.
            let n = f64::from(gap);
            let exact = |x: f64| {
                let t = (x + 0.5) / (n + 1.0) - 0.5;
                let h = 0.5 / (n + 1.0);
                // Odd about the middle: a t + b t³ is 1/2 at t = 1/2 - h and 1/2 + h.
                let (p, q) = (0.5 - h, 0.5 + h);
                let b = 0.5 * (1.0 / q - 1.0 / p) / (q * q - p * p);
                let a = 0.5 / p - b * p * p;
                0.5 - (a * t + b * t * t * t)
            };
            for i in 0..=gap {
                let [a, b, ..] = weights[4 + i as usize];
                let wanted = exact(f64::from(i));
                assert!(
                    (a - wanted).abs() < far && (a + b - 1.0).abs() < far,
                    "{i} of {gap}: {a} {b}, {wanted}"
                );
            }
        }
    }

    /// The smoothest weights would be negative beyond the other bone, a point.
    #[test]
    fn bounds_hold() {
        let weights = chain(30, vec![(0, vec![(3, 1.0)]), (1, vec![(3, 1.0)]), (12, vec![(5, 1.0)])]);
        assert!(weights[12..].iter().all(|w| w[0] == 0.0 || w[0] < 1e-5), "{weights:?}");
        assert!(weights[1..12].windows(2).all(|w| w[0][0] > w[1][0]));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// No weights within the bounds are smoother: the slope is 0, or leads out of the bounds.
        #[test]
        fn weights_are_the_least(
            more in prop::collection::vec((0..24_u32, 0..24_u32), 0..40),
            a in 0..12_u32, b in 12..24_u32,
        ) {
            let mut links: Vec<(u32, u32)> = (1..24).map(|i| (i - 1, i)).collect();
            links.extend(more.into_iter().filter(|(a, b)| a != b));
            let cells = (0..24).map(|i| IVec3::X * i).collect();
            let found = solved(&links, cells, vec![(a, vec![(3, 1.0)]), (b, vec![(5, 1.0)])], &[3, 5]);
            let laplacian = |of: &[f64]| {
                let mut sums = vec![0.0; 24];
                for (a, b) in links.iter().map(|(a, b)| (*a as usize, *b as usize)) {
                    sums[a] += of[b] - of[a];
                    sums[b] += of[a] - of[b];
                }
                sums
            };
            for lane in 0..2 {
                let weights: Vec<f64> = found.iter().map(|w| w[lane]).collect();
                let slope = laplacian(&laplacian(&weights));
                for i in (0..24).filter(|i| *i != a as usize && *i != b as usize) {
                    let inwards = match weights[i] {
                        w if w < 1e-4 => -slope[i],
                        w if w > 1.0 - 1e-4 => slope[i],
                        _ => slope[i].abs(),
                    };
                    prop_assert!(inwards < 2e-3, "{} at {}: {}", inwards, i, weights[i]);
                }
            }
        }
    }
}
