//! Soft body: the inside of the surface is a material that holds its volume, is held and moved by regions,
//! sags under its weight, and touches itself.
//!
//! | what | by |
//! |---|---|
//! | `occupancy` | what of space the body takes up |
//! | `lattice` | cells about that, whose corners move; samples go along with their cells |
//! | `material` | stable neo-Hookean energy: Smith, de Goes and Kim 2018; Macklin and Müller 2021 |
//! | `cell` | how a cell is deformed, and the forces at its corners |
//! | `body` | the energy of all cells, and its derivatives |
//! | `held`, `path` | regions as springs, and the ways of handles |
//! | `contact` | what comes near to other parts of the surface |
//! | `multilevel`, `solve` | where the energy is least, by Newton's method |
//!
//! Nothing depends on time, so the body is not let swing until it comes to rest: handles go their way in
//! small steps on a coarse lattice, and each time the energy is minimised; then finer lattices go on from
//! there.

mod body;
mod cell;
mod contact;
mod held;
mod lattice;
mod material;
mod multilevel;
mod occupancy;
mod path;
mod solve;

use body::Body;
use contact::ContactSurface;
use glam::{DAffine3, DMat3, DVec3};
use held::{Goals, SampleGoals};
use lattice::{CellPoint, HexMesh};
use occupancy::{Enclosure, Occupancy, PARTS};
use path::Path;
use simod_geometry::affine_map;
use simod_plugin_api::{
    Affine, Consumes, DeformInput, Deformer, Descriptor, Effort, Host, ParamSet, PluginError, PluginResult,
    PrepareInput,
};
use solve::{LoadCase, RestCriteria};

/// Samples that are written at once on one thread.
const BLOCK: usize = 4096;
/// Largest number of cells of a lattice: about a kilobyte each.
const MOST_CELLS: usize = 50_000;
/// Number of cells below which a lattice is not made coarser: it is the one on which handles go their ways.
const COARSE: usize = 600;
/// Number of fine cells along an edge of a cell from which on lattices are not made coarser: 64 times as many
/// as on the finest lattice.
const COARSEST: usize = 64 * PARTS;
/// Number of loose parts that are led, each by the nearest sample; more are led as one.
const MOST_LOOSE: usize = 1000;
/// Number of handles whose ways are foreseen; others have the solver alone.
const FORESEEN: u32 = 60;
/// Turn of a handle in one step of its way, and the length of a step, as a part of the longest side.
const TURN: f64 = 0.26;
const WAY: f64 = 0.15;
/// Largest number of steps, in full and in a draft.
const MOST_STEPS: f64 = 96.0;
const DRAFT_STEPS: f64 = 6.0;
/// Ratio of the products that handles' ways may take to those for a rest on the same lattice.
const WAY_WORTH: usize = 2;
/// Steps in which the weight sets in, at least.
const SAGGING: f64 = 4.0;

/// The plugin.
struct Elastic;

#[derive(ParamSet)]
struct ElasticSettings {
    /// Poisson's ratio; larger ones keep the volume better: 0 cork, 0.3 wood, 0.45 flesh, 0.49 rubber
    #[param(default = 0.45, hard = 0.0..=0.495, soft = 0.0..=0.49, invalidates_preparation)]
    poisson: f64,
    /// Weight beside the stiffness: a bar as long as the diagonal gets longer by half of this as it hangs
    #[param(default = 0.0, hard = 0.0..=10.0, soft = 0.0..=0.1)]
    weight: f64,
    /// Direction in which the weight draws
    #[param(direction, default = [0.0, 0.0, -1.0])]
    down: [f64; 3],
    /// Keeps parts that come near to each other from passing through
    #[param(default = true)]
    contact: bool,
    /// Number of cells of the lattice along the longest side of the model; more are nearer to the truth, and
    /// slower
    #[param(default = 32, hard = 4..=64, soft = 8..=48, group = "Accuracy", invalidates_preparation)]
    resolution: i64,
    /// Largest motion of a corner of the lattice that counts as rest
    #[param(default = 1e-4, unit = "diagonal", hard = 1e-9..=1.0, soft = 1e-6..=1e-2, group = "Accuracy")]
    tolerance: f64,
}

/// Map to coordinates in which the longest side of the samples' box is 1.
#[derive(Debug, Clone, Copy)]
struct UnitBox {
    origin: DVec3,
    scale: f64,
}

impl UnitBox {
    fn new(positions: &[[f32; 3]]) -> Self {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let all = positions.iter().map(|p| DVec3::from(p.map(f64::from)));
        let (low, high) = all.fold(start, |(low, high), p| (low.min(p), high.max(p)));
        let scale = (high - low).max_element();
        Self { origin: low, scale: if scale > 0.0 { scale } else { 1.0 } }
    }

    fn to(&self, p: &[f32; 3]) -> DVec3 {
        (DVec3::from(p.map(f64::from)) - self.origin) / self.scale
    }

    fn map(&self, map: &Affine) -> DAffine3 {
        let matrix3 = affine_map(&map.rows).matrix3;
        let translation = (DVec3::from(map.apply(self.origin.into())) - self.origin) / self.scale;
        DAffine3 { matrix3, translation }
    }
}

/// Lattice that is held, and the places of the samples in it.
struct HeldLevel {
    body: Body,
    places: Vec<Option<CellPoint>>,
    /// Places of this lattice's corners in the next coarser one.
    corners: Vec<CellPoint>,
}

/// Loose parts, which hang on nothing that is held: the part of each sample, and the sample that leads each
/// part.
struct Loose {
    parts: Vec<Option<u32>>,
    leaders: Vec<u32>,
}

/// State of a step that does not depend on where handles are.
struct PreparedBody {
    unit: UnitBox,
    held: SampleGoals,
    /// Levels from fine to coarse; none where nothing is held.
    levels: Vec<HeldLevel>,
    surface: Option<ContactSurface>,
    /// Part by which each corner of the coarsest lattice goes along with each handle.
    shares: Vec<Vec<f64>>,
    loose: Loose,
}

impl Deformer for Elastic {
    type State = PreparedBody;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("elastic", "Elastic body", env!("CARGO_PKG_VERSION"))
            .summary("Bends a soft body that keeps its volume, sags under its weight, and does not pass through itself")
            .citation(
                "M. Macklin, M. Müller, A Constraint-Based Formulation of Stable Neo-Hookean Materials, MIG 2021; B. Smith, \
                 F. de Goes, T. Kim, Stable Neo-Hookean Flesh Simulation, ACM TOG 37, 2018",
            )
            .param_set::<ElasticSettings>()
            .consumes(Consumes {
                fixed_regions: true,
                handle_regions: true,
                normals: true,
                triangles: true,
                graph: true,
                effort: true,
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedBody> {
        let positions = input.samples.positions();
        if let Some(i) = positions.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(PluginError::input(format!("sample {i} is at no finite place")));
        }
        let ElasticSettings { poisson, resolution, .. } = input.params().read()?;
        let resolution = usize::try_from(resolution)
            .ok()
            .filter(|n| (1..=64).contains(n))
            .ok_or_else(|| PluginError::parameter("resolution", "is out of range"))?;
        let unit = UnitBox::new(positions);
        let points: Vec<DVec3> = positions.iter().map(|p| unit.to(p)).collect();
        let held = SampleGoals::gather(input, &points)?;
        if held.drawn().next().is_none() {
            let loose = Loose { parts: vec![None; points.len()], leaders: Vec::new() };
            return Ok(PreparedBody {
                unit,
                held,
                levels: Vec::new(),
                surface: None,
                shares: Vec::new(),
                loose,
            });
        }
        let mut space = Occupancy::new(&points, input, resolution, host)?;
        host.progress(0.4)?;
        tell(space.kind, host);
        let loose = loose(&mut space, &points, &held, host)?;
        let surface = (space.kind != Enclosure::Skin).then(|| {
            let of = |i: u32| {
                let normal = input.samples.normals().get(i as usize).copied().unwrap_or_default();
                (i, points[i as usize], DVec3::from(normal.map(f64::from)))
            };
            let tied = (0..points.len() as u32).filter(|i| loose.parts[*i as usize].is_none());
            let size = (space.step * PARTS as f64).element_product().cbrt();
            ContactSurface::new(&space, tied.map(of), size)
        });
        let levels = levels(&space, &points, &loose, &held, poisson, host)?;
        host.progress(0.8)?;
        let foreseen: Vec<u32> = (1..=held.handles as u32).take(FORESEEN as usize).collect();
        let shares = match levels.last() {
            Some(coarsest) => solve::shares(&coarsest.body, &foreseen, host)?,
            None => Vec::new(),
        };
        Ok(PreparedBody { unit, held, levels, surface, shares, loose })
    }

    fn deform(
        state: &PreparedBody,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = input.samples.positions();
        let transforms = input.transforms();
        if [rest.len(), out.len()] != [state.held.hard.len(); 2] || transforms.len() != state.held.handles {
            return Err(PluginError::internal("the samples or handles are not those of the preparation"));
        }
        let settings: ElasticSettings = input.params().read()?;
        let weight = settings.weight;
        let is_still = transforms.iter().all(|t| *t == Affine::IDENTITY) && weight == 0.0;
        if state.levels.is_empty() && weight != 0.0 {
            return Err(PluginError::input("nothing holds the body, which falls under its weight")
                .hint("add a fixed region, or a handle"));
        }
        let Some(finest) = state.levels.first().filter(|_| !is_still) else {
            out.copy_from_slice(rest);
            return Ok(());
        };
        let motion = asked_motion(state, input, &settings, &finest.body)?;
        let (level, x) = motion.solve(state, input.effort(), host)?;
        let maps = level.body.corner_maps(&x, host)?;
        let leads = leads(state, level, &x);
        let handles: Vec<DAffine3> = transforms.iter().map(|map| affine_map(&map.rows)).collect();
        host.parallel_blocks(out, BLOCK, |first, out| {
            for (i, o) in (first..).zip(out) {
                let p = DVec3::from(rest[i].map(f64::from));
                let q = match (state.held.hard[i], state.loose.parts[i], level.places[i]) {
                    (Some(0), ..) => p,
                    (Some(handle), ..) => handles[handle as usize - 1].transform_point3(p),
                    (_, Some(part), _) => {
                        let to = leads[part as usize].transform_point3(state.unit.to(&rest[i]));
                        state.unit.origin + state.unit.scale * to
                    }
                    (.., Some(place)) => {
                        let lattice = &level.body.lattice;
                        p + state.unit.scale * lattice.shift(place, state.unit.to(&rest[i]), &maps)
                    }
                    _ => p,
                };
                *o = q.as_vec3().into();
            }
        })
    }
}

/// Motion that is asked for: the handles' paths, weight, and contact.
struct AskedMotion {
    paths: Vec<Path>,
    weight: DVec3,
    contact: bool,
    still: f64,
}

impl AskedMotion {
    fn goals(&self, part: f64) -> Goals {
        Goals(std::iter::once(DAffine3::IDENTITY).chain(self.paths.iter().map(|p| p.pose(part))).collect())
    }

    fn task<'a>(
        &self,
        goals: &'a Goals,
        part: f64,
        state: &'a PreparedBody,
        level: &'a HeldLevel,
    ) -> LoadCase<'a> {
        let contact = state.surface.as_ref().filter(|_| self.contact);
        LoadCase { goals, weight: self.weight * part, contact: contact.map(|s| (s, &level.places[..])) }
    }

    /// Places of a lattice's corners: for a draft those of the coarsest one on the handles' way, and else
    /// those of the finest one at rest.
    fn solve<'a>(
        &self,
        state: &'a PreparedBody,
        effort: Effort,
        host: &Host<'_>,
    ) -> PluginResult<(&'a HeldLevel, Vec<DVec3>)> {
        Ok(if effort == Effort::DRAFT {
            (&state.levels[state.levels.len() - 1], self.way(state, true, host)?)
        } else {
            (&state.levels[0], self.rest(state, host)?)
        })
    }

    /// Number of steps into which the handles' paths are parted.
    fn steps(&self, state: &PreparedBody, is_draft: bool) -> f64 {
        let contact = state.surface.as_ref().filter(|_| self.contact);
        let of = |(path, middle): (&Path, &Option<(DVec3, f64)>)| {
            let length = path.length(middle.map_or(0.0, |(_, reach)| reach));
            let seen = contact.map_or(0.0, |surface| length / surface.step());
            (path.angle() / TURN).max(length / WAY).max(seen)
        };
        let sagging = if self.weight == DVec3::ZERO { 1.0 } else { SAGGING };
        let steps = self.paths.iter().zip(&state.held.middles[1..]).map(of).fold(sagging, f64::max);
        steps.ceil().clamp(1.0, if is_draft { DRAFT_STEPS } else { MOST_STEPS })
    }

    /// Positions of the coarsest lattice's corners at the end of the handles' paths.
    fn way(&self, state: &PreparedBody, is_draft: bool, host: &Host<'_>) -> PluginResult<Vec<DVec3>> {
        let level = &state.levels[state.levels.len() - 1];
        let rest = &level.body.lattice.rest;
        let mut x = rest.clone();
        let steps = self.steps(state, is_draft);
        let mut before = self.goals(0.0);
        for step in 1..=steps as usize {
            host.progress(0.8 * step as f64 / steps)?;
            let part = step as f64 / steps;
            let goals = self.goals(part);
            for (handle, shares) in (1_u32..).zip(&state.shares) {
                for ((x, rest), share) in x.iter_mut().zip(rest).zip(shares) {
                    *x += *share * (goals.image(handle, *rest) - before.image(handle, *rest));
                }
            }
            let until = if is_draft {
                RestCriteria::quickly()
            } else {
                RestCriteria::roughly(
                    10.0 * self.still,
                    WAY_WORTH * solve::worth(&level.body) / steps as usize,
                )
            };
            solve::settle(&level.body, &mut x, &self.task(&goals, part, state, level), until, host)?;
            before = goals;
        }
        Ok(x)
    }

    /// Positions of the finest lattice's corners when the body is at rest.
    fn rest(&self, state: &PreparedBody, host: &Host<'_>) -> PluginResult<Vec<DVec3>> {
        let mut x = self.way(state, false, host)?;
        let goals = self.goals(1.0);
        let mut is_at_rest = true;
        for (n, level) in state.levels.iter().enumerate().rev() {
            host.progress(0.9)?;
            if let Some(coarser) = state.levels.get(n + 1) {
                let lattice = &coarser.body.lattice;
                let shift: Vec<DVec3> = x.iter().zip(&lattice.rest).map(|(x, r)| *x - *r).collect();
                let all = level.body.lattice.rest.iter().zip(&level.corners);
                x = all.map(|(rest, place)| *rest + lattice.interpolate(*place, &shift)).collect();
            }
            let until = RestCriteria::wholly(self.still, solve::worth(&level.body));
            is_at_rest =
                solve::settle(&level.body, &mut x, &self.task(&goals, 1.0, state, level), until, host)?;
        }
        if !is_at_rest {
            host.warn("the body is not quite at rest: move its handles less far, or raise `tolerance`");
        }
        Ok(x)
    }
}

fn paths(state: &PreparedBody, transforms: &[Affine]) -> Vec<Path> {
    let fixed = state.held.middles[0].map(|(middle, _)| middle);
    let middles = state.held.middles[1..].iter().map(|m| m.map_or(DVec3::ZERO, |(middle, _)| middle));
    transforms
        .iter()
        .zip(middles)
        .map(|(map, middle)| Path::new(state.unit.map(map), middle, fixed))
        .collect()
}

/// Warns of a surface that is not closed.
fn tell(kind: Enclosure, host: &Host<'_>) {
    match kind {
        Enclosure::Closed => {}
        Enclosure::Open => host.warn(
            "the surface has holes: what sees it in nearly all directions is taken for the inside of the body",
        ),
        Enclosure::Skin => host.warn(
            "the surface encloses nothing: the body is a skin, as thick as a cell of the lattice, and does not look after \
             contact with itself; raise `resolution` for a thinner one, or take `laplacian` for surfaces",
        ),
    }
}

/// All levels, the finest first: each of the next has cells of twice the size, until the cells are few.
fn levels(
    space: &Occupancy,
    points: &[DVec3],
    loose: &Loose,
    held: &SampleGoals,
    poisson: f64,
    host: &Host<'_>,
) -> PluginResult<Vec<HeldLevel>> {
    let mut levels: Vec<HeldLevel> = Vec::new();
    let mut parts = PARTS;
    loop {
        host.progress(0.5)?;
        let level = level(space, parts, points, loose, held, poisson)?;
        if let Some(finer) = levels.last_mut() {
            finer.corners = corners(&finer.body.lattice, &level.body.lattice, parts / 2);
        }
        let cells = level.body.lattice.cells.len();
        levels.push(level);
        if cells <= COARSE || parts >= COARSEST {
            return Ok(levels);
        }
        parts *= 2;
    }
}

fn level(
    space: &Occupancy,
    parts: usize,
    points: &[DVec3],
    loose: &Loose,
    held: &SampleGoals,
    poisson: f64,
) -> PluginResult<HeldLevel> {
    let lattice = HexMesh::new(space, parts);
    if lattice.cells.len() > MOST_CELLS {
        let what = format!("is too fine: {} cells of the lattice", lattice.cells.len());
        return Err(PluginError::parameter("resolution", &what)
            .hint(format!("lower it: {MOST_CELLS} cells are the most")));
    }
    let place = |(p, loose): (&DVec3, &Option<u32>)| {
        if loose.is_some() { None } else { lattice.place(space, *p) }
    };
    let places: Vec<Option<CellPoint>> = points.iter().zip(&loose.parts).map(place).collect();
    let springs = held.springs(&lattice, &places);
    Ok(HeldLevel { body: Body::new(lattice, springs, poisson), places, corners: Vec::new() })
}

/// Places of the corners of a lattice in one of twice the size; `parts` is the finer one's.
fn corners(fine: &HexMesh, coarse: &HexMesh, parts: usize) -> Vec<CellPoint> {
    let of = |(i, rest): (usize, &DVec3)| {
        // Over any of the cells about it there is one.
        let [_, corner] = fine.uses(i)[0];
        let by = lattice::CORNERS[corner as usize];
        let cell: [usize; 3] = std::array::from_fn(|a| (fine.places[i][a] as usize - by[a]) * parts);
        coarse.place_in(cell, *rest).unwrap_or(CellPoint { cell: 0, at: DVec3::ZERO })
    };
    fine.rest.iter().enumerate().map(of).collect()
}

/// Finds the parts that hang on nothing that is held, takes them out of the body, and finds the samples that
/// lead them.
fn loose(
    space: &mut Occupancy,
    points: &[DVec3],
    held: &SampleGoals,
    host: &Host<'_>,
) -> PluginResult<Loose> {
    let lattice = HexMesh::new(space, PARTS);
    let (part_of, count) = lattice.parts();
    let of = |p: &DVec3| part_of[lattice.over(space.cell(*p)) as usize] as usize;
    let mut is_tied = vec![false; count];
    held.drawn().for_each(|i| is_tied[of(&points[i as usize])] = true);
    let mut number = vec![None; count];
    let mut numbers = (0..).map(|n: usize| n.min(MOST_LOOSE - 1) as u32);
    is_tied.iter().zip(&mut number).filter(|(tied, _)| !**tied).for_each(|(_, n)| *n = numbers.next());
    let parts: Vec<Option<u32>> = points.iter().map(|p| number[of(p)]).collect();
    let known = parts.iter().flatten().max().map_or(0, |n| *n as usize + 1);
    let mut middles = vec![(DVec3::ZERO, 0.0); known];
    for (p, part) in points.iter().zip(&parts).filter_map(|(p, part)| Some((p, (*part)?))) {
        middles[part as usize].0 += *p;
        middles[part as usize].1 += 1.0;
    }
    let mut leaders = vec![0; known];
    host.parallel_blocks(&mut leaders, 1, |first, leaders| {
        let (sum, count) = middles[first];
        let middle = sum / f64::max(count, 1.0);
        let tied = (0..).zip(points).zip(&parts).filter(|(_, part)| part.is_none()).map(|(p, _)| p);
        let nearest = tied.min_by(|a: &(u32, &DVec3), b| {
            a.1.distance_squared(middle).total_cmp(&b.1.distance_squared(middle))
        });
        leaders[0] = nearest.map_or(0, |(i, _)| i);
    })?;
    if known > 0 {
        let loose = count - is_tied.iter().filter(|t| **t).count();
        host.warn(&format!(
            "{loose} of {count} parts of the body hang on nothing that is held: they go along with what is nearest to them"
        ));
        let is_loose: Vec<bool> = part_of.iter().map(|part| !is_tied[*part as usize]).collect();
        space.clear(|fine| is_loose.get(lattice.over(fine) as usize).is_some_and(|l| *l));
    }
    Ok(Loose { parts, leaders })
}

/// The motion that the handles and the settings ask of a body, whose finest lattice this is.
fn asked_motion(
    state: &PreparedBody,
    input: &DeformInput<'_>,
    settings: &ElasticSettings,
    finest: &Body,
) -> PluginResult<AskedMotion> {
    let down = DVec3::from(settings.down).try_normalize();
    let down =
        down.ok_or_else(|| PluginError::parameter("down", "is no direction").hint("give another one"))?;
    let diagonal = input.bounds.diagonal() / state.unit.scale;
    let diagonal = if diagonal > 0.0 { diagonal } else { 1.0 };
    Ok(AskedMotion {
        paths: paths(state, input.transforms()),
        weight: down * (settings.weight * finest.young() / diagonal),
        contact: settings.contact && input.effort() != Effort::DRAFT,
        still: settings.tolerance * diagonal,
    })
}

/// Motions of the leaders of loose parts.
fn leads(state: &PreparedBody, level: &HeldLevel, x: &[DVec3]) -> Vec<DAffine3> {
    let lead = |leader: &u32| {
        let Some(place) = level.places[*leader as usize] else { return DAffine3::IDENTITY };
        let lattice = &level.body.lattice;
        let matrix3 = path::turn(level.body.gradient(place, x)).unwrap_or(DMat3::IDENTITY);
        let (from, to) = (lattice.interpolate(place, &lattice.rest), lattice.interpolate(place, x));
        DAffine3 { matrix3, translation: to - matrix3 * from }
    };
    state.loose.leaders.iter().map(lead).collect()
}

simod_plugin_api::export_plugin!(Elastic);

#[cfg(test)]
mod tests;
