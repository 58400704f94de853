//! Motion or similarity that lays the model on the target before anything bends: by landmarks, or by the
//! closest points of the best fitting parts (D. Chetverikov and others, *The trimmed iterative closest
//! point algorithm*, ICPR 2002), from the model's place or from many turns, those of the axes and of the
//! principal ones.

use crate::points::{Extent, Pair, similarity, some};
use crate::tree::Tree;
use crate::{Align, Method, Place, Settings};
use glam::{DAffine3, DMat3, DVec3};
use simod_geometry::symmetric_eigen;
use simod_plugin_api::{Host, LogLevel, PluginError, PluginResult};

/// Number of points of the model, and of the target, that are looked at: in the search, and in the end.
const SEARCHED: [usize; 2] = [300, 2000];
const REFINED: [usize; 2] = [1500, 20_000];
/// Greatest number of steps from each first turn, and in the end.
const STEPS: [usize; 2] = [20, 100];
/// Motion of a step, as a part of the target's size, below which the step is the last one.
const STILL: f64 = 1e-5;
/// Part of the pairs that count: the others may have no counterpart.
const FITTING: f64 = 0.7;
/// Parts of the pairs that are tried from the model's own place: with all of them the model comes from
/// farther away.
const PARTS: [f64; 2] = [FITTING, 1.0];
/// Factor by which the score of another turn has to be smaller than that of none.
const BETTER: f64 = 0.8;
/// Number of the search's best turns that are compared by more points, where they are only told and where
/// they are taken.
const FINALISTS: [usize; 2] = [1, 5];
/// Factor by which the score of another turn has to be smaller for the user to be told.
const TURNED: f64 = 0.4;
/// Factor between the sizes from which on different units are assumed, and from which on the user is told.
const UNITS: [f64; 2] = [5.0, 2.0];
/// Distance of the boxes, in diagonals of the model, from which on they do not overlap.
const APART: f64 = 0.1;
/// Distance in diagonals from which on single precision would lose the model's details.
const FAR: f64 = 1e3;

/// Input of an alignment: the model and the target.
pub struct Alignment<'a> {
    pub settings: &'a Settings,
    pub model: (&'a [DVec3], Extent),
    pub target: (&'a [DVec3], Extent),
    pub pairs: &'a [Pair],
}

/// Map with its score: the mean of the squares of the best fitting distances both ways.
#[derive(Debug, Clone, Copy)]
struct ScoredMap {
    map: DAffine3,
    score: f64,
}

/// Motion or similarity from the model to the target, as far as the settings ask for one.
///
/// # Errors
/// The target is of another size, or elsewhere, and is not to be aligned so far; the user cancelled.
pub fn aligned(
    task: &Alignment<'_>,
    host: &Host<'_>,
    progress: &dyn Fn(f64) -> PluginResult<()>,
) -> PluginResult<DAffine3> {
    let (settings, (_, own), (_, other)) = (task.settings, task.model, task.target);
    sizes_agree(settings.align, other.radius / own.radius, host)?;
    let gap = own.gap(&other) / own.diagonal();
    let is_beside = gap > APART;
    if settings.align == Align::None {
        if settings.method == Method::Align {
            host.warn("the model is aligned alone, and that by nothing: nothing moves");
        }
        return if is_beside { Err(do_not_overlap(gap)) } else { Ok(DAffine3::IDENTITY) };
    }
    let with_scale = settings.align == Align::Similarity;
    let by_landmarks = if task.pairs.len() >= 3 { similarity(task.pairs, with_scale) } else { None };
    let map = match by_landmarks {
        Some(map) => map,
        None => {
            if is_beside && !settings.any_turn {
                host.warn(&format!(
                    "the target lies {gap:.1} diagonals of the model beside it, and is brought to it as it is turned; \
                     `any-turn = true` looks for the best turn"
                ));
            }
            task.by_closest_points(with_scale, is_beside, host, progress)?
        }
    };
    let away = map.transform_point3(own.middle).distance(own.middle) / own.diagonal();
    if settings.place == Place::Target && away > FAR {
        return Err(PluginError::input(format!(
            "the target lies {away:.0} diagonals of the model away: there the model's details would be lost"
        ))
        .hint(
            "give `place = \"model\"`, which leaves the model where it is, or a target in its coordinates",
        ));
    }
    tell(&map, away, host);
    Ok(map)
}

/// The error for a target that lies so many of the model's diagonals beside it, and is not to be aligned.
fn do_not_overlap(gap: f64) -> PluginError {
    PluginError::input(format!(
        "the target lies {gap:.1} diagonals of the model beside it: they do not overlap"
    ))
    .hint("give `align = \"rigid\"`, which lays one on the other")
}

/// Tells the user of an alignment, which moves the model by `away` of its diagonals.
fn tell(map: &DAffine3, away: f64, host: &Host<'_>) {
    let scale = map.matrix3.determinant().cbrt();
    let (_, turn, _) = map.to_scale_rotation_translation();
    host.log(
        LogLevel::INFO,
        &format!(
            "the model was laid on the target: turned by {:.1} degrees, moved by {away:.3} diagonals, {scale:.4} times as \
             large",
            2.0 * turn.w.abs().min(1.0).acos().to_degrees(),
        ),
    );
}

/// Checks that the target is about as large as the model, or that its size does not matter.
fn sizes_agree(align: Align, ratio: f64, host: &Host<'_>) -> PluginResult<()> {
    let factor = ratio.max(1.0 / ratio);
    if align == Align::Similarity || factor <= UNITS[1] {
        return Ok(());
    }
    let than = if ratio > 1.0 { "larger" } else { "smaller" };
    let told = format!("the target is {factor:.3} times {than} than the model");
    if factor > UNITS[0] {
        return Err(PluginError::input(format!("{told}: their units may differ"))
            .hint("give `align = \"similarity\"`, which finds the scale, or a target in the model's unit"));
    }
    host.warn(&format!("{told}; `align = \"similarity\"` would find the scale"));
    Ok(())
}

impl Alignment<'_> {
    fn by_closest_points(
        &self,
        with_scale: bool,
        is_beside: bool,
        host: &Host<'_>,
        progress: &dyn Fn(f64) -> PluginResult<()>,
    ) -> PluginResult<DAffine3> {
        let search = Search::new(self.model.0, self.target.0, SEARCHED, with_scale);
        let [from, to] = [self.model.1, self.target.1];
        let scale = if with_scale { to.radius / from.radius } else { 1.0 };
        let at_middles = |turn: DMat3| {
            DAffine3::from_mat3_translation(scale * turn, to.middle - scale * turn * from.middle)
        };
        let differs = !(1.0 / UNITS[1]..=UNITS[1]).contains(&scale);
        let start = || progress(0.0);
        let mut firsts = vec![at_middles(DMat3::IDENTITY)];
        if !is_beside && !differs {
            firsts.insert(0, DAffine3::IDENTITY);
        }
        let best = search.improved_best(&firsts, &start)?;
        let turns = search.turns(from.middle, to.middle);
        let improved = |(i, turn): (usize, &DMat3)| {
            let told = || progress(i as f64 / turns.len() as f64);
            search.improved(at_middles(*turn), FITTING, STEPS[0], &told)
        };
        let mut turned = turns.iter().enumerate().map(improved).collect::<PluginResult<Vec<ScoredMap>>>()?;
        turned.sort_by(|a, b| a.score.total_cmp(&b.score));
        let search = Search::new(self.model.0, self.target.0, REFINED, with_scale);
        let refined = |fit: &ScoredMap| search.improved(fit.map, FITTING, STEPS[1], &|| progress(1.0));
        let best = refined(&best)?;
        let finalists = FINALISTS[usize::from(self.settings.any_turn)];
        let finalists = turned.iter().take(finalists).map(refined).collect::<PluginResult<Vec<_>>>()?;
        let Some(turned) = finalists.into_iter().min_by(|a, b| a.score.total_cmp(&b.score)) else {
            return Ok(best.map);
        };
        if self.settings.any_turn && turned.score < BETTER * best.score {
            return Ok(turned.map);
        }
        if turned.score < TURNED * best.score && best.score > (0.05 * to.radius).powi(2) {
            host.warn("the model fits better when it is turned: `any-turn = true` does so");
        }
        Ok(best.map)
    }
}

/// Data of the search for turns.
struct Search {
    source: Vec<DVec3>,
    target: Vec<DVec3>,
    tree: Tree,
    with_scale: bool,
    /// The target's size.
    size: f64,
}

impl Search {
    fn new(source: &[DVec3], target: &[DVec3], most: [usize; 2], with_scale: bool) -> Self {
        let [source, target] = [(source, most[0]), (target, most[1])]
            .map(|(points, most)| some(points.len(), most).map(|i| points[i]).collect::<Vec<_>>());
        Self { tree: Tree::new(&target), size: Extent::measure(&target).radius, source, target, with_scale }
    }

    /// Turns to begin with: those of the axes, and of the principal ones.
    fn turns(&self, from: DVec3, to: DVec3) -> Vec<DMat3> {
        let mut turns: Vec<DMat3> = axis_turns().skip(1).collect();
        if let (Some(a), Some(b)) = (axes(&self.source, from), axes(&self.target, to)) {
            turns.extend(axis_turns().map(|turn| b * turn * a.transpose()));
        }
        turns
    }

    /// Improves a first map by closest points, of which a part counts, in at most so many steps.
    ///
    /// # Errors
    /// The user cancelled.
    fn improved(
        &self,
        first: DAffine3,
        part: f64,
        steps: usize,
        goes_on: &dyn Fn() -> PluginResult<()>,
    ) -> PluginResult<ScoredMap> {
        let mut best = self.score(first);
        let mut map = first;
        for _ in 0..steps {
            goes_on()?;
            let Some(next) = self.step(map, part) else { break };
            let moves = |p: &DVec3| next.transform_point3(*p).distance(map.transform_point3(*p));
            let most = self.source.iter().map(moves).fold(0.0, f64::max);
            map = next;
            let fit = self.score(map);
            if fit.score < best.score {
                best = fit;
            }
            if most < STILL * self.size {
                break;
            }
        }
        Ok(best)
    }

    /// The map that fits the closest points of a former one.
    fn step(&self, map: DAffine3, part: f64) -> Option<DAffine3> {
        let mut pairs: Vec<(f64, Pair)> = self
            .source
            .iter()
            .filter_map(|p| {
                let (i, squared) = self.tree.nearest(map.transform_point3(*p), &|_| true)?;
                Some((squared, Pair { source: *p, target: self.target[i as usize], weight: 1.0 }))
            })
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        pairs.truncate(fitting(part, pairs.len()));
        let pairs: Vec<Pair> = pairs.into_iter().map(|(_, pair)| pair).collect();
        similarity(&pairs, self.with_scale)
    }

    /// Best map that some first ones are improved to, each by several parts of the points. A later map has
    /// to be [so much better](BETTER) than one before it.
    fn improved_best(
        &self,
        firsts: &[DAffine3],
        told: &dyn Fn() -> PluginResult<()>,
    ) -> PluginResult<ScoredMap> {
        let mut best: Option<ScoredMap> = None;
        for (first, part) in firsts.iter().flat_map(|first| PARTS.map(|part| (*first, part))) {
            let brought = self.improved(first, part, STEPS[0], told)?.map;
            let fit = self.improved(brought, FITTING, STEPS[0], told)?;
            if best.is_none_or(|best| fit.score < BETTER * best.score) {
                best = Some(fit);
            }
        }
        Ok(best.unwrap_or_else(|| self.score(firsts[0])))
    }

    fn score(&self, map: DAffine3) -> ScoredMap {
        let moved: Vec<DVec3> = self.source.iter().map(|p| map.transform_point3(*p)).collect();
        let back = Tree::new(&moved);
        let some: Vec<DVec3> = some(self.target.len(), self.source.len()).map(|i| self.target[i]).collect();
        ScoredMap { map, score: best_of(&self.tree, &moved) + best_of(&back, &some) }
    }
}
fn fitting(part: f64, count: usize) -> usize {
    ((count as f64 * part) as usize).max(3).min(count)
}

/// Mean of the squares of the best fitting distances.
fn best_of(tree: &Tree, points: &[DVec3]) -> f64 {
    let mut all: Vec<f64> =
        points.iter().filter_map(|p| tree.nearest(*p, &|_| true).map(|(_, squared)| squared)).collect();
    all.sort_by(f64::total_cmp);
    let best = &all[..fitting(FITTING, all.len())];
    best.iter().sum::<f64>() / best.len().max(1) as f64
}

/// The 24 turns that take axes to axes, the identity first.
fn axis_turns() -> impl Iterator<Item = DMat3> {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2], [0, 2, 1], [2, 1, 0]];
    let unit = [DVec3::X, DVec3::Y, DVec3::Z];
    ORDERS.into_iter().flat_map(move |order| {
        (0..8).filter_map(move |signs: u8| {
            let column = |k: usize| if signs >> k & 1 == 0 { unit[order[k]] } else { -unit[order[k]] };
            let turn = DMat3::from_cols(column(0), column(1), column(2));
            (turn.determinant() > 0.0).then_some(turn)
        })
    })
}

/// The principal axes, as a turn; nothing where points lie in one place.
fn axes(points: &[DVec3], middle: DVec3) -> Option<DMat3> {
    let covariance = points.iter().fold(DMat3::ZERO, |sum, p| {
        let p = *p - middle;
        sum + DMat3::from_cols(p * p.x, p * p.y, p * p.z)
    });
    let (_, axes) = symmetric_eigen(covariance);
    let turn = DMat3::from_cols(axes.x_axis, axes.y_axis, axes.x_axis.cross(axes.y_axis));
    turn.is_finite().then_some(turn)
}
