//! From the samples and the target to a map of space: alignment, several ways of bending from there, the
//! choice of the best, and the report on it.
//!
//! Bending happens at the model's place, shifted to 0 and scaled to unit spread: the target is brought
//! there, and the result goes to the target.

use crate::align::{Alignment, aligned};
use crate::closest::{Closest, Fit, Surface};
use crate::drift::{Drift, Start};
use crate::gaussian::Field;
use crate::graph::Graph;
use crate::landmarks;
use crate::points::{Extent, Pair, farthest, some};
use crate::{Method, Place, Settings};
use glam::{DAffine3, DVec3};
use simod_plugin_api::{Host, LogLevel, OtherModel, PluginError, PluginResult, PrepareInput};
use std::fmt;

/// Greatest number of the samples that are looked at, and that closest points take.
const MODEL: usize = 20_000;
const CLOSEST: usize = 4000;
/// Greatest number of centres of a drift's displacement.
const CENTERS: usize = 400;
/// Ways of bending that are tried, of which the best is taken: closest points alone; from a drift, stiff
/// enough to undo its errors; and from a drift as it is, also from afar.
const WAYS: [Way; 4] = [
    Way { drift: None, closest: Some(1e3) },
    Way { drift: Some(Start::Near), closest: Some(100.0) },
    Way { drift: Some(Start::Near), closest: Some(3.0) },
    Way { drift: Some(Start::Wide), closest: Some(3.0) },
];
/// The ways where drift alone is asked for.
const DRIFTS: [Way; 2] =
    [Way { drift: Some(Start::Near), closest: None }, Way { drift: Some(Start::Wide), closest: None }];
/// Distance to the target, in distances between its points, within which samples match.
const MATCHED: f64 = 2.0;
/// Part of the samples that match below which the user is told.
const FEW: f64 = 0.3;

/// Map of space: to coordinates about 0 and of unit spread, the bending there, and to the result.
#[derive(Debug)]
pub struct Map {
    to: DAffine3,
    bent: Bent,
    from: DAffine3,
}

#[derive(Debug)]
enum Bent {
    Not,
    Drift(Field),
    Graph(Graph),
}

impl Bent {
    fn apply(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Not => p,
            Self::Drift(field) => field.apply(p),
            Self::Graph(graph) => graph.apply(p),
        }
    }
}

impl Map {
    /// Image of a place, both in local coordinates.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.from.transform_point3(self.bent.apply(self.to.transform_point3(p)))
    }
}

/// Points with normals, some of those that there are.
pub struct Points {
    pub points: Vec<DVec3>,
    normals: Vec<DVec3>,
}

impl Points {
    /// At most `most` of `count` points.
    fn gather(points: impl Fn(usize) -> [f64; 3], normals: &[[f32; 3]], count: usize, most: usize) -> Self {
        let taken: Vec<usize> = some(count, most).collect();
        let normal = |i: &usize| normals.get(*i).map_or(DVec3::ZERO, |n| DVec3::from(n.map(f64::from)));
        Self {
            points: taken.iter().map(|i| DVec3::from(points(*i))).collect(),
            normals: taken.iter().map(|i| normal(i).normalize_or_zero()).collect(),
        }
    }

    /// At most `most` of the points, as far from each other as can be.
    fn farthest(&self, most: usize) -> Self {
        let taken = farthest(&self.points, most);
        Self {
            points: taken.iter().map(|i| self.points[*i]).collect(),
            normals: taken.iter().map(|i| self.normals[*i]).collect(),
        }
    }

    /// The points moved by a map; normals turn along.
    fn mapped(mut self, map: &DAffine3) -> Self {
        self.points.iter_mut().for_each(|p| *p = map.transform_point3(*p));
        self.normals.iter_mut().for_each(|n| *n = map.transform_vector3(*n).normalize_or_zero());
        self
    }

    fn surface(&self) -> Surface<'_> {
        Surface { points: &self.points, normals: &self.normals }
    }
}

/// Refuses a model or a target that is a point, or of less than four.
fn check_bodies(both: [(&Extent, usize); 2]) -> PluginResult<()> {
    let is_body = |(extent, count): (&Extent, usize)| extent.radius > 0.0 && count >= 4;
    if both.into_iter().all(is_body) && both[1].0.radius.is_finite() {
        return Ok(());
    }
    Err(PluginError::input("the model or the target is a point, or less than four")
        .hint("give a target of more points, and sample the model more finely"))
}

/// The map that takes the samples to the target.
///
/// # Errors
/// The model or the target is no body; their sizes or places speak against each other; the user cancelled.
pub fn register(
    input: &PrepareInput<'_>,
    target: &OtherModel<'_>,
    settings: &Settings,
    host: &Host<'_>,
) -> PluginResult<Map> {
    let (rest, count) = (input.samples.positions(), input.samples.positions().len());
    let model = Points::gather(|i| rest[i].map(f64::from), input.samples.normals(), count, MODEL);
    let there = target.positions();
    let target = Points::gather(|i| there[i], target.normals(), there.len(), there.len());
    let (own, other) = (Extent::measure(&model.points), Extent::measure(&target.points));
    check_bodies([(&own, count), (&other, there.len())])?;
    let pairs = landmark_pairs(input)?;
    let align = aligned(
        &Alignment { settings, model: (&model.points, own), target: (&target.points, other), pairs: &pairs },
        host,
        &|done| host.progress(0.15 * done),
    )?;
    // The map `to` leads from the model's place to coordinates about 0 and of unit spread.
    let to = DAffine3::from_scale(DVec3::splat(1.0 / own.radius)) * DAffine3::from_translation(-own.middle);
    let bring = to * align.inverse();
    if !(bring.is_finite() && to.is_finite()) {
        return Err(
            PluginError::input("the target's size is beyond what can be worked with").hint("check its unit")
        );
    }
    let from = if settings.place == Place::Model { to.inverse() } else { align * to.inverse() };
    let mapped = |p: Pair| Pair {
        source: to.transform_point3(p.source),
        target: bring.transform_point3(p.target),
        ..p
    };
    let pairs: Vec<Pair> = pairs.into_iter().map(mapped).collect();
    let (model, target) = (model.mapped(&to), target.mapped(&bring));
    let source = model.farthest(CLOSEST);
    let graph = Graph::new(&source.points, settings.nodes as usize);
    let task = Task {
        settings,
        model: &model,
        target: &target,
        pairs: &pairs,
        width: settings.width * own.diagonal() / own.radius,
        closest: Closest::new(source.surface(), target.surface(), &pairs, &graph),
        graph,
        host,
    };
    let (bent, fit) = task.best()?;
    tell(&fit, task.closest.spacing(), own.radius * input.frame().map_or(1.0, |frame| frame.scale), host);
    Ok(Map { to, bent, from })
}

/// A way to bend.
struct Way {
    /// Drift with which the way begins, from this variance.
    drift: Option<Start>,
    /// Factor by which closest points, with which the way goes on, begin stiffer than they end.
    closest: Option<f64>,
}

impl fmt::Display for Way {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let drift = match self.drift {
            Some(Start::Near) => "drift from the nearest points",
            Some(Start::Wide) => "drift from afar",
            None => "no drift",
        };
        match self.closest {
            Some(stiffer) => write!(f, "{drift}, then closest points from {stiffer} times as stiff,"),
            None => write!(f, "{drift}"),
        }
    }
}

/// Model and target that are bent to each other, about 0 and of unit spread.
struct Task<'a> {
    settings: &'a Settings,
    model: &'a Points,
    target: &'a Points,
    pairs: &'a [Pair],
    /// The width of the drift's Gaussians.
    width: f64,
    closest: Closest<'a>,
    /// The graph at rest.
    graph: Graph,
    host: &'a Host<'a>,
}

impl Task<'_> {
    /// Best of the results from several starts.
    fn best(&self) -> PluginResult<(Bent, Fit)> {
        let ways: &[Way] = match self.settings.method {
            Method::Align => &[],
            Method::Cpd => &DRIFTS,
            Method::Icp => &WAYS[..1],
            Method::CpdIcp => &WAYS,
        };
        let starts =
            [Start::Near, Start::Wide].into_iter().filter(|s| ways.iter().any(|way| way.drift == Some(*s)));
        let starts: Vec<Start> = starts.collect();
        let (parts, mut fields) = (starts.len() + ways.len(), Vec::new());
        let progress =
            |number: usize, done: f64| self.host.progress(0.15 + 0.8 * (number as f64 + done) / parts as f64);
        for (number, start) in starts.iter().enumerate() {
            fields.push((*start, self.drift(*start, &|done| progress(number, done))?));
        }
        let mut best: Option<(f64, Bent, Fit)> = None;
        for (number, way) in ways.iter().enumerate() {
            let field = fields.iter().find(|(start, _)| way.drift == Some(*start)).map(|(_, field)| field);
            let (bent, graph) =
                self.bend(field, way.closest, &|done| progress(starts.len() + number, done))?;
            let fit = self.closest.fit(&graph, MATCHED, self.host)?;
            let cost = fit.cost(self.closest.spacing());
            self.host
                .log(LogLevel::INFO, &format!("{way} costs {cost:.3}: {:.3} of it is strain", fit.strain));
            if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
                best = Some((cost, bent, fit));
            }
        }
        match best {
            Some((_, bent, fit)) => Ok((bent, fit)),
            None => Ok((Bent::Not, self.closest.fit(&self.graph, MATCHED, self.host)?)),
        }
    }

    fn drift(&self, start: Start, progress: &dyn Fn(f64) -> PluginResult<()>) -> PluginResult<Field> {
        let settings = self.settings;
        let drift = Drift {
            width: self.width,
            stiffness: settings.smoothness,
            centers: CENTERS,
            outliers: settings.outliers,
            most_iterations: settings.iterations as usize,
        };
        let [source, goal] = [self.model, self.target].map(|p| p.farthest(settings.points as usize).points);
        Ok(drift.run((&source, &goal), self.pairs, start, self.host, progress)?.0)
    }

    /// Bends by a drift, by closest points, or by both; returns also the graph moved by that.
    fn bend(
        &self,
        drift: Option<&Field>,
        stiffer: Option<f64>,
        progress: &dyn Fn(f64) -> PluginResult<()>,
    ) -> PluginResult<(Bent, Graph)> {
        let (mut graph, mut bent) = (self.graph.clone(), Bent::Not);
        if let Some(field) = drift {
            graph = graph.moved(|p| field.apply(p));
            bent = Bent::Drift(field.clone());
        }
        if let Some(stiffer) = stiffer {
            self.closest.draw(&mut graph, self.settings.stiffness, stiffer, self.host, progress)?;
            bent = Bent::Graph(graph.clone());
        }
        Ok((bent, graph))
    }
}

/// Landmarks in local coordinates.
fn landmark_pairs(input: &PrepareInput<'_>) -> PluginResult<Vec<Pair>> {
    let Some(path) = input.params().file("landmarks")? else { return Ok(Vec::new()) };
    let frame = input.frame().ok_or_else(|| {
        PluginError::input("this version of SIMOD does not tell where the file's coordinates are")
            .hint("use a newer one")
    })?;
    let found = landmarks::read(path).map_err(|(line, what)| {
        let place = line.map_or(String::new(), |line| format!(", line {line}"));
        PluginError::input(format!("{}{place} {what}", path.display()))
            .hint("a line for each landmark: a name, x, y, z, where these belong, and maybe a weight")
    })?;
    let local = |p: DVec3| DVec3::from(frame.to_local(p.into()));
    let reach = 2.0 * input.bounds.diagonal();
    let [low, high] = [input.bounds.min, input.bounds.max].map(DVec3::from);
    let mut pairs = Vec::new();
    for l in found.iter().filter(|l| l.weight > 0.0) {
        let source = local(l.source);
        if !source.is_finite() || source.distance(source.clamp(low, high)) > reach {
            return Err(PluginError::input(format!(
                "{}, line {}: the landmark `{}` is far from the model",
                path.display(),
                l.line,
                l.name
            ))
            .hint("its first three numbers have to be in the model's coordinates"));
        }
        pairs.push(Pair { source, target: local(l.target), weight: l.weight });
    }
    Ok(pairs)
}

/// Reports the errors at the target, in the model's unit.
fn tell(fit: &Fit, spacing: f64, unit: f64, host: &Host<'_>) {
    let [own, other] = fit.matched.map(|part| 100.0 * part);
    host.log(
        LogLevel::INFO,
        &format!(
            "{own:.1} % of the model and {other:.1} % of the target match, with {:.4} between them (rms); the target's \
             points are {:.4} from each other",
            fit.rms * unit,
            spacing * unit
        ),
    );
    if let Some(off) = fit.landmarks {
        host.log(LogLevel::INFO, &format!("landmarks are {:.4} from where they belong (rms)", off * unit));
    }
    if fit.matched[0] < FEW {
        host.warn(
            "few of the samples match: the target may be turned (`any-turn = true`), in another unit (`align = \"similarity\"`), or \
             elsewhere, or the model too stiff for it",
        );
    }
}
