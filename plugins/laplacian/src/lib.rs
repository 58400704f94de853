//! Surface editing with the Laplacian: regions are held or moved, and the surface between follows.
//!
//! Four methods on one discretisation (cotangents, made robust: see `intrinsic`, `stars`):
//!
//! - `smooth-arap`, the default: as rigid as possible, with surroundings of a width of their own (`cells`),
//!   so that the surface resists bending. Rotations are found on a coarse likeness of the surface first
//!   (`coarse`), from the handles' own by harmonic interpolation (R. Zayer et al., *Harmonic Guidance for
//!   Surface Deformation*, Eurographics 2005), then on the surface itself. Details turn, and limbs keep their
//!   length and girth.
//! - `arap`: as rigid as possible as it is published (Sorkine and Alexa 2007; `arap`), with spokes and rims
//!   (Chao et al. 2010) or spokes alone, until the energy has settled.
//! - `bi-laplacian`: the smoothest displacement (Botsch and Kobbelt 2004; `linear`). Linear, and the fastest;
//!   details do not turn, and large turns make things shrink.
//! - `laplacian`: two such steps, in which details turn with the surface, and this with the handles (Lipman
//!   et al. 2004, Zayer et al. 2005; `rotated`).
//!
//! Regions' weights: 1 holds exactly, less draws as springs do, by `w / (1 - w)`, so that 0 is nothing and 1
//! the limit. Parts of the surface that nothing holds follow the samples next to them (`followers`).

mod arap;
mod cells;
mod coarse;
mod constraints;
mod descent;
mod draft;
mod elements;
mod followers;
mod guidance;
mod harmonic;
mod intrinsic;
mod levers;
mod linear;
mod operators;
mod problem;
mod rotated;
mod rotation;
mod stars;
mod surface;

use arap::DescentEnd;
use constraints::{OwnMotions, SampleConstraints, SampleTarget};
use followers::Followers;
use glam::{DAffine3, DMat3, DVec3};
use guidance::Hierarchy;
use linear::{BiLaplacian, Smoothest};
use problem::{Constraint, Problem};
use rotated::{Rotated, Stiffness};
use simod_geometry::affine_map;
use simod_plugin_api::{
    Choice, Consumes, DeformInput, Deformer, Descriptor, Effort, Host, Migrate, MigrationDesc, ParamSet,
    PluginError, PluginResult, PrepareInput, Settings,
};
use std::collections::BTreeMap;
use surface::TriangleWeights;

/// Length over which a draw of weight 1/2 lets the surface bend before the draw gives in, in units of the
/// diagonal.
const SOFT_LENGTH: f64 = 0.3;
/// Steps until the energy settles, at most.
const MOST_STEPS: usize = 2000;
/// Largest move of a sample at which descents end, too, in units of the diagonal: the rest is rounding.
const AT_REST: f64 = 1e-8;
/// Samples that are written at once on one thread.
const DEFORM_BLOCK: usize = 8192;

/// The plugin.
struct Laplacian;

#[derive(ParamSet)]
struct LaplacianSettings {
    /// Method; rigid ones keep shapes and turn details, the smoothest is linear and does neither
    #[param(default = Mode::SmoothArap, invalidates_preparation)]
    mode: Mode,
    /// Length over which the surface bends, for smooth rigid; 0 lets it crease
    #[param(default = 0.03, unit = "diagonal", hard = 0.0..=1.0, soft = 0.0..=0.2, invalidates_preparation)]
    bending: f64,
    /// Parts that turn with a sample, for published rigid: its triangles, or its edges alone
    ///
    /// Triangles: Chao and others 2010; edges: Sorkine and Alexa 2007.
    #[param(default = Surroundings::SpokesAndRims, group = "Accuracy", invalidates_preparation)]
    surroundings: Surroundings,
    /// Decrease of the energy by the last three steps, as a part of that by all, for published rigid
    #[param(default = 1e-3, hard = 0.0..=1.0, soft = 1e-6..=1e-1, group = "Accuracy")]
    decrease: f64,
    /// Number of steps on all samples at most, after those on a coarse likeness, for smooth rigid
    #[param(default = 2, hard = 0..=10_000, soft = 0..=20, group = "Accuracy")]
    iterations: i64,
    /// Largest motion of a sample in a step at which the steps end, for smooth rigid
    #[param(default = 1e-4, unit = "diagonal", hard = 0.0..=1.0, soft = 1e-6..=1e-2, group = "Accuracy")]
    tolerance: f64,
    /// Weights of the triangles; robust ones take any, cotangents as they are compare with other programs
    #[param(default = TriangleWeights::Robust, group = "Accuracy", invalidates_preparation)]
    weights: TriangleWeights,
}

#[derive(Choice, Clone, Copy)]
enum Mode {
    #[choice(label = "As rigid as possible, smooth")]
    SmoothArap,
    #[choice(label = "As rigid as possible, as published")]
    Arap,
    #[choice(label = "Rotated Laplacian coordinates")]
    Laplacian,
    #[choice(label = "Bi-Laplacian (smoothest)")]
    BiLaplacian,
}

#[derive(Choice, Clone, Copy, PartialEq, Eq)]
enum Surroundings {
    #[choice(label = "Spokes and rims")]
    SpokesAndRims,
    #[choice(label = "Spokes")]
    Spokes,
}

/// State of a step that does not depend on the handles' motions.
struct PreparedSurface {
    /// Source of each sample's image.
    places: Vec<ImageOf>,
    method: LaplacianMethod,
    has_fixed: bool,
    handles: usize,
    followers: Followers,
}

enum LaplacianMethod {
    Arap(Box<Hierarchy>),
    Bilaplacian(Box<Smoothest>),
    Rotated(Box<Rotated>),
}

/// Source of a sample's image.
#[derive(Debug, Clone, Copy)]
enum ImageOf {
    /// A free node.
    Node(u32),
    /// A region that holds the sample.
    Held(SampleTarget),
    /// A loose part to which the sample belongs.
    Part(u32),
}

impl Deformer for Laplacian {
    type State = PreparedSurface;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("laplacian", "Laplacian surface editing", env!("CARGO_PKG_VERSION"))
            .summary("Moves handle regions, holds fixed ones, and bends the surface in between like a skin")
            .citation(
                "O. Sorkine, M. Alexa, As-Rigid-As-Possible Surface Modeling, SGP 2007; I. Chao, U. Pinkall, P. \
                 Sanan, P. Schröder, A Simple Geometric Model for Elastic Deformations, SIGGRAPH 2010",
            )
            .param_set::<LaplacianSettings>()
            .consumes(Consumes {
                fixed_regions: true,
                handle_regions: true,
                min_handles: 1,
                triangles: true,
                graph: true,
                effort: true,
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedSurface> {
        host.progress(0.0)?;
        let LaplacianSettings { mode, bending, surroundings, weights, .. } = input.params().read()?;
        let constraints = SampleConstraints::gather(input)?;
        let positions: Vec<DVec3> =
            input.samples.positions().iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let elements = surface::elements(input, &positions, weights, host)?;
        host.progress(0.15)?;

        let kinds = kinds(&constraints, &surface::components(positions.len(), &elements));
        let parts = parts(&kinds, &surface::components(positions.len(), &elements));
        let is_loose = |i: u32| kinds[i as usize] == Constraint::Loose;
        let followers = Followers::new(input.samples.positions(), &parts, is_loose, input.graph(), host)?;
        let mut problem = Problem::new(&positions, &elements, &kinds, &constraints.soft, host)?;
        drop(elements);
        host.progress(0.3)?;

        let places = places(&kinds, &parts, &problem);
        let diagonal = input.bounds.diagonal();
        let length = SOFT_LENGTH * if diagonal > 0.0 { diagonal } else { 1.0 };
        let (handles, stiffness) =
            (constraints.handles, Stiffness { harmonic: length.powi(-2), biharmonic: length.powi(-4) });
        let method = match mode {
            Mode::Arap | Mode::SmoothArap => {
                let is_smooth = matches!(mode, Mode::SmoothArap);
                if !is_smooth && surroundings == Surroundings::Spokes {
                    problem.operators = problem.operators.of_spokes(&problem.rest);
                }
                let width = if is_smooth { bending * diagonal } else { 0.0 };
                LaplacianMethod::Arap(Box::new(Hierarchy::new(
                    problem,
                    stiffness.harmonic,
                    width,
                    handles,
                    host,
                )?))
            }
            Mode::BiLaplacian => {
                let equations = BiLaplacian::new(problem, stiffness.biharmonic, 0.3..0.9, host)?;
                LaplacianMethod::Bilaplacian(Box::new(Smoothest::new(
                    equations,
                    frames(&constraints, &positions),
                    host,
                )?))
            }
            Mode::Laplacian => {
                LaplacianMethod::Rotated(Box::new(Rotated::new(problem, stiffness, handles, host)?))
            }
        };
        let has_fixed = constraints.has_fixed;
        Ok(PreparedSurface { places, method, has_fixed, handles, followers })
    }

    fn deform(
        state: &PreparedSurface,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = input.samples.positions();
        let transforms = input.transforms();
        if transforms.len() != state.handles || rest.len() != state.places.len() || out.len() != rest.len() {
            return Err(PluginError::internal("the samples or handles are not those of the preparation"));
        }
        let motion = match &state.method {
            LaplacianMethod::Bilaplacian(_) => OwnMotions::affine(transforms, state.has_fixed),
            LaplacianMethod::Arap(_) | LaplacianMethod::Rotated(_) => {
                OwnMotions::rigid(transforms, state.has_fixed)
            }
        };
        if motion.common == DAffine3::IDENTITY && motion.is_common() {
            out.copy_from_slice(rest);
            return Ok(());
        }
        let displacements =
            if motion.is_common() { Vec::new() } else { displacements(&state.method, &motion, input, host)? };
        let handles: Vec<DAffine3> = transforms.iter().map(|map| affine_map(&map.rows)).collect();
        // Displacements of linear methods are added after the common motion.
        let turn = if matches!(state.method, LaplacianMethod::Bilaplacian(_)) {
            DMat3::IDENTITY
        } else {
            motion.common.matrix3
        };
        let at = |i: usize| DVec3::from(rest[i].map(f64::from));
        let image = |i: usize| match state.places[i] {
            ImageOf::Node(node) => {
                let displacement = displacements.get(node as usize).copied().unwrap_or(DVec3::ZERO);
                motion.common.transform_point3(at(i)) + turn * displacement
            }
            ImageOf::Held(SampleTarget::Handle(h)) => handles[h as usize].transform_point3(at(i)),
            ImageOf::Held(SampleTarget::Fixed) | ImageOf::Part(_) => at(i),
        };
        let parts = if motion.is_common() {
            Vec::new()
        } else {
            state.followers.motions(rest, |i| image(i as usize), host)?
        };
        host.parallel_blocks(out, DEFORM_BLOCK, |first, out| {
            for (i, o) in (first..).zip(out) {
                let q = match state.places[i] {
                    ImageOf::Part(part) => {
                        parts.get(part as usize).unwrap_or(&motion.common).transform_point3(at(i))
                    }
                    _ => image(i),
                };
                *o = q.as_vec3().to_array();
            }
        })
    }
}

/// The displacements of the nodes, local units, besides the common motion.
fn displacements(
    method: &LaplacianMethod,
    motion: &OwnMotions,
    input: &DeformInput<'_>,
    host: &Host<'_>,
) -> PluginResult<Vec<DVec3>> {
    let is_draft = input.effort() == Effort::DRAFT;
    match method {
        LaplacianMethod::Arap(hierarchy) => hierarchy.deform(motion, until(input)?, is_draft, host),
        LaplacianMethod::Bilaplacian(smoothest) => smoothest.displacements(motion, host),
        LaplacianMethod::Rotated(rotated) => rotated.displacements(motion, is_draft, host),
    }
}

/// Criteria by which the iteration of as-rigid-as-possible deformations ends.
fn until(input: &DeformInput<'_>) -> PluginResult<DescentEnd> {
    let LaplacianSettings { mode, iterations, tolerance, decrease, .. } = input.params().read()?;
    let steps =
        usize::try_from(iterations).map_err(|_| PluginError::parameter("iterations", "is negative"))?;
    let diagonal = input.bounds.diagonal();
    Ok(match mode {
        Mode::Arap => DescentEnd { steps: MOST_STEPS, tolerance: AT_REST * diagonal, decrease },
        _ => DescentEnd { steps, tolerance: tolerance * diagonal, decrease: 0.0 },
    })
}

impl Migrate for Laplacian {
    /// Migration of settings: in the first version `arap` had a bending length, as `smooth-arap` has now.
    /// Steps that give one above 0 keep it; others are as rigid as possible, as they say.
    fn migration() -> MigrationDesc {
        MigrationDesc::new(2)
    }

    fn migrate(_: u32, settings: &mut Settings) -> PluginResult<()> {
        // A step that says what turns was written since.
        if settings.text("mode") != Some("arap") || settings.get("surroundings").is_some() {
            return Ok(());
        }
        if settings.number("bending").is_some_and(|length| length > 0.0) {
            settings.set_text("mode", "smooth-arap");
        } else {
            // Said, so that the user is told.
            settings.remove("bending");
            settings.set_text("surroundings", "spokes-and-rims");
        }
        Ok(())
    }
}

/// Constraint of each sample: held; free, if it is connected to a sample that is held or drawn; or loose.
fn kinds(constraints: &SampleConstraints, components: &[u32]) -> Vec<Constraint> {
    let mut is_tied = vec![false; components.len()];
    let held = constraints.hard.iter().enumerate().filter(|(_, t)| t.is_some()).map(|(i, _)| i);
    for i in held.chain(constraints.soft.iter().map(|s| s.node as usize)) {
        is_tied[components[i] as usize] = true;
    }
    let kind = |(target, component): (&Option<SampleTarget>, &u32)| match target {
        Some(target) => Constraint::Held(*target),
        None if is_tied[*component as usize] => Constraint::Free,
        None => Constraint::Loose,
    };
    constraints.hard.iter().zip(components).map(kind).collect()
}

/// The samples of each loose part, by its component.
fn parts(kinds: &[Constraint], components: &[u32]) -> BTreeMap<u32, Vec<u32>> {
    let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (i, (_, component)) in
        kinds.iter().zip(components).enumerate().filter(|(_, (k, _))| **k == Constraint::Loose)
    {
        parts.entry(*component).or_default().push(i as u32);
    }
    parts
}

fn places(kinds: &[Constraint], parts: &BTreeMap<u32, Vec<u32>>, problem: &Problem) -> Vec<ImageOf> {
    let mut places: Vec<ImageOf> = kinds
        .iter()
        .map(|kind| match kind {
            Constraint::Held(target) => ImageOf::Held(*target),
            Constraint::Free | Constraint::Loose => ImageOf::Held(SampleTarget::Fixed),
        })
        .collect();
    for (node, sample) in problem.samples[..problem.free].iter().enumerate() {
        places[*sample as usize] = ImageOf::Node(node as u32);
    }
    for (part, samples) in parts.values().enumerate() {
        samples.iter().for_each(|i| places[*i as usize] = ImageOf::Part(part as u32));
    }
    places
}

/// Middle and size of each handle.
fn frames(constraints: &SampleConstraints, positions: &[DVec3]) -> Vec<(DVec3, f64)> {
    let members = |handle: u32| {
        let own = SampleTarget::Handle(handle);
        let hard = constraints.hard.iter().enumerate().filter(move |(_, t)| **t == Some(own)).map(|(i, _)| i);
        let soft = constraints.soft.iter().filter(move |s| s.target == own).map(|s| s.node as usize);
        hard.chain(soft).map(|i| positions[i])
    };
    let frame = |handle: u32| {
        let count = members(handle).count().max(1) as f64;
        let middle = members(handle).sum::<DVec3>() / count;
        let size = members(handle).map(|p| p.distance(middle)).fold(0.0, f64::max);
        (middle, if size > 0.0 { size } else { 1.0 })
    };
    (0..constraints.handles as u32).map(frame).collect()
}

simod_plugin_api::export_plugin!(Laplacian, migrate);

#[cfg(test)]
mod tests;
