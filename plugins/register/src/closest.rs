//! As-rigid-as-possible closest points: a graph is drawn to the closest points of the target, stiff first and
//! softer step by step (B. Amberg, S. Romdhani, T. Vetter, *Optimal step nonrigid ICP algorithms for surface
//! registration*, CVPR 2007).
//!
//! A pair counts if its normals agree, if it is not much longer than the others, and if it does not slant:
//! from beyond a border, or over a gap, the closest point lies aside. So parts without a counterpart follow
//! those that have one.

use crate::graph::{Carried, Graph, Term};
use crate::points::{Pair, some};
use crate::tree::Tree;
use glam::{DMat3, DVec3};
use simod_plugin_api::{Host, PluginResult};

/// Number of degrees of stiffness for each power of ten, and of steps at each.
const DEGREES: f64 = 3.0;
const STEPS: usize = 6;
/// Least cosine between normals of a pair.
const AGREE: f64 = 0.5;
/// Part of the nearest points that have to face the same way, for the sides of normals to be known.
const SIDES: f64 = 0.9;
/// Weight of the distance beside the distance along the normal.
const ALONG: f64 = 0.1;
/// Multiple of the median length from which on pairs do not count.
const LONGER: f64 = 4.0;
/// Distance aside of its normal that a pair may have, in distances between the target's points.
const ASIDE: f64 = 1.5;
/// Weight of all landmarks together, beside all pairs.
const LANDMARKS: f64 = 10.0;
/// Motion of nodes in a step, as a part of the model's spread, below which a degree ends.
const STILL: f64 = 2e-4;
const BLOCK: usize = 64;

/// Points with normals.
#[derive(Clone, Copy)]
pub struct Surface<'a> {
    pub points: &'a [DVec3],
    pub normals: &'a [DVec3],
}

/// Source and target of a fit. Lengths are those of a model about 0 and of unit spread.
pub struct Closest<'a> {
    source: Surface<'a>,
    target: Surface<'a>,
    landmarks: &'a [Pair],
    tree: Tree,
    /// Distance between neighbours of the target's points.
    spacing: f64,
    /// Nodes that carry each of the source's points.
    carried: Vec<Carried>,
}

/// A pair of the model's and the target's points, and their distance.
#[derive(Clone, Copy)]
struct Match {
    source: usize,
    target: usize,
    distance: f64,
}

/// Source as a graph carries it, with the tree of its points.
struct Moved {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    tree: Tree,
    spacing: f64,
    knows_sides: bool,
}

/// Quality of a graph's fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Root of the mean square of the distances of matching points, the model's and the target's.
    pub rms: f64,
    /// The parts of the model's points and of the target's that match.
    pub matched: [f64; 2],
    /// See [`Graph::strain`].
    pub strain: f64,
    /// Distance of landmarks from their targets: the root of the mean square; nothing where there are no
    /// landmarks.
    pub landmarks: Option<f64>,
}

impl Fit {
    /// Cost of a fit, by which the best of several ways is chosen. Strain tells ways that stretch a part
    /// over the whole, or bend a part that should only be turned. A part may be missing on one side, but
    /// hardly on both: the side that is matched better counts most. Distances count little, in distances
    /// between the target's points, as far as there is a match.
    pub fn cost(&self, spacing: f64) -> f64 {
        let [less, more] = {
            let [a, b] = self.matched;
            [a.min(b), a.max(b)]
        };
        (1.0 - more)
            + 0.3 * (1.0 - less)
            + 0.1 * self.rms / spacing
            + self.strain
            + self.landmarks.unwrap_or(0.0)
    }
}

impl<'a> Closest<'a> {
    pub fn new(source: Surface<'a>, target: Surface<'a>, landmarks: &'a [Pair], graph: &Graph) -> Self {
        let tree = Tree::new(target.points);
        let spacing = spacing(&tree, target.points);
        let carried = source.points.iter().map(|p| graph.carried(*p)).collect();
        Self { source, target, landmarks, tree, spacing, carried }
    }

    /// Draws the graph from its present place to the target, at stiffnesses down to `stiffness`, from one
    /// that is so much stiffer.
    ///
    /// # Errors
    /// The user cancelled; the equations have no solution.
    pub fn draw(
        &self,
        graph: &mut Graph,
        stiffness: f64,
        stiffer: f64,
        host: &Host<'_>,
        progress: &dyn Fn(f64) -> PluginResult<()>,
    ) -> PluginResult<()> {
        let degrees = 1 + (DEGREES * stiffer.log10()).ceil() as usize;
        // The room is taken once, as the system hands out memory of that size page by page.
        let mut room = graph.room();
        for degree in 0..degrees {
            let stiffness = stiffness * stiffer.powf(1.0 - degree as f64 / (degrees - 1).max(1) as f64);
            for step in 0..STEPS {
                progress((degree * STEPS + step) as f64 / (degrees * STEPS) as f64)?;
                let terms = self.terms(graph, host)?;
                let before = graph.clone();
                graph.settle(&terms, stiffness, 2, &mut room)?;
                if graph.apart(&before) < STILL {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Quality of the graph's present fit: points match that are nearer than `within` distances between
    /// points.
    ///
    /// # Errors
    /// The user cancelled.
    pub fn fit(&self, graph: &Graph, within: f64, host: &Host<'_>) -> PluginResult<Fit> {
        let moved = self.moved(graph, host)?;
        let limit = within * self.spacing.max(moved.spacing);
        let [there, back] = self.matches(&moved, host)?;
        let near = |matches: &[Option<Match>]| -> Vec<f64> {
            matches.iter().flatten().map(|m| m.distance).filter(|d| *d < limit).collect()
        };
        let near = [near(&there), near(&back)];
        let matched = [(&near[0], there.len()), (&near[1], back.len())];
        let squares: f64 = near.iter().flatten().map(|d| d * d).sum();
        let count = near[0].len() + near[1].len();
        Ok(Fit {
            rms: (squares / count.max(1) as f64).sqrt(),
            matched: matched.map(|(near, all)| near.len() as f64 / all.max(1) as f64),
            strain: graph.strain(),
            landmarks: self.missed_by(graph),
        })
    }

    fn missed_by(&self, graph: &Graph) -> Option<f64> {
        let whole: f64 = self.landmarks.iter().map(|l| l.weight).sum();
        let squares: f64 =
            self.landmarks.iter().map(|l| l.weight * graph.apply(l.source).distance_squared(l.target)).sum();
        (whole > 0.0).then(|| (squares / whole).sqrt())
    }

    /// The distance between neighbours of the target's points.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    fn moved(&self, graph: &Graph, host: &Host<'_>) -> PluginResult<Moved> {
        let (source, target) = (self.source, self.target);
        let mut now = vec![[DVec3::ZERO; 2]; source.points.len()];
        host.parallel_blocks(&mut now, BLOCK, |first, now| {
            for (i, now) in (first..).zip(now) {
                let carried = &self.carried[i];
                *now = [
                    graph.image(source.points[i], carried),
                    graph.direction(source.normals[i], carried).normalize_or_zero(),
                ];
            }
        })?;
        let (points, normals): (Vec<DVec3>, Vec<DVec3>) = now.into_iter().map(|[p, n]| (p, n)).unzip();
        let tree = Tree::new(&points);
        let spacing = spacing(&tree, &points);
        let facing = some(points.len(), 1000).filter(|i| {
            let near = self.tree.nearest(points[*i], &|_| true);
            near.is_none_or(|(j, _)| normals[*i].dot(target.normals[j as usize]) > 0.0)
        });
        let knows_sides = facing.count() as f64 >= SIDES * points.len().min(1000) as f64;
        Ok(Moved { points, normals, tree, spacing, knows_sides })
    }

    /// Pairs of the source's points, and those of some of the target's: the nearest point whose normal
    /// agrees, if it does not lie aside.
    fn matches(&self, moved: &Moved, host: &Host<'_>) -> PluginResult<[Vec<Option<Match>>; 2]> {
        let target = self.target;
        let agrees = |n: DVec3, other: DVec3| {
            let cosine = n.dot(other);
            // A point without a normal agrees with all.
            let is_known = n != DVec3::ZERO && other != DVec3::ZERO;
            !is_known || if moved.knows_sides { cosine > AGREE } else { cosine.abs() > AGREE }
        };
        let mut there: Vec<Option<Match>> = vec![None; moved.points.len()];
        host.parallel_blocks(&mut there, BLOCK, |first, there| {
            for (i, found) in (first..).zip(there) {
                let (p, n) = (moved.points[i], moved.normals[i]);
                let near = self.tree.nearest(p, &|j| agrees(n, target.normals[j as usize]));
                let near = near.map(|(j, d)| Match { source: i, target: j as usize, distance: d.sqrt() });
                *found = near.filter(|m| {
                    aside(p - target.points[m.target], target.normals[m.target]) < ASIDE * self.spacing
                });
            }
        })?;
        let some: Vec<usize> = some(target.points.len(), moved.points.len()).collect();
        let mut back: Vec<Option<Match>> = vec![None; some.len()];
        host.parallel_blocks(&mut back, BLOCK, |first, back| {
            for (j, found) in some[first..].iter().zip(back) {
                let x = target.points[*j];
                let near = moved.tree.nearest(x, &|i| agrees(moved.normals[i as usize], target.normals[*j]));
                let near = near.map(|(i, d)| Match { source: i as usize, target: *j, distance: d.sqrt() });
                *found = near.filter(|m| {
                    aside(x - moved.points[m.source], moved.normals[m.source]) < ASIDE * moved.spacing
                });
            }
        })?;
        Ok([there, back])
    }

    /// Terms of the present pairs, both ways, and of landmarks.
    fn terms(&self, graph: &Graph, host: &Host<'_>) -> PluginResult<Vec<Term>> {
        let moved = self.moved(graph, host)?;
        let mut found: Vec<Match> = self.matches(&moved, host)?.into_iter().flatten().flatten().collect();
        let mut lengths: Vec<f64> = found.iter().map(|m| m.distance).collect();
        lengths.sort_by(f64::total_cmp);
        let longest = LONGER * lengths.get(lengths.len() / 2).copied().unwrap_or(0.0) + 0.5 * self.spacing;
        found.retain(|m| m.distance < longest);
        let share = 1.0 / found.len().max(1) as f64;
        let pairs = found.iter().map(|m| {
            let n = self.target.normals[m.target];
            let weight = share * (1.0 - (m.distance / longest).powi(2)).powi(2);
            Term {
                source: self.source.points[m.source],
                carried: self.carried[m.source],
                target: self.target.points[m.target],
                metric: weight * (DMat3::from_cols(n * n.x, n * n.y, n * n.z) + ALONG * DMat3::IDENTITY),
            }
        });
        let whole: f64 = self.landmarks.iter().map(|l| l.weight).sum();
        let landmarks = self.landmarks.iter().map(|l| Term {
            source: l.source,
            carried: graph.carried(l.source),
            target: l.target,
            metric: LANDMARKS * l.weight / whole * DMat3::IDENTITY,
        });
        Ok(pairs.chain(landmarks).collect())
    }
}

/// Length of the part of a shift that is at right angles to a normal.
fn aside(shift: DVec3, normal: DVec3) -> f64 {
    (shift - shift.dot(normal) * normal).length()
}

/// The distance between neighbouring points: the root of the mean square over some of them.
fn spacing(tree: &Tree, points: &[DVec3]) -> f64 {
    let of = |i: usize| tree.nearest(points[i], &|j| j as usize != i).map_or(0.0, |(_, squared)| squared);
    let all: Vec<f64> = some(points.len(), 1000).map(of).collect();
    (all.iter().sum::<f64>() / all.len().max(1) as f64).sqrt()
}
