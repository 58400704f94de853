//! The stack of deformations: each layer's output is the next one's rest shape.
//!
//! Regions are evaluated on the layer's own rest shape. A mask acts on the host's side, whatever the plugin:
//! `p* = p + m(p) (D(p) - p)`.

use crate::deformer::{Message, Plugin, Watch};
use crate::motion::to_local;
use crate::params::{LocalParams, Params};
use crate::plugins::PluginRegistry;
use crate::session_file::{Role, Step};
use crate::shapes::Shapes;
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use simod_core::frame::Frame;
use simod_core::geometry::Bounds;
use simod_core::progress::Silent;
use simod_core::sampling::NeighbourGraph;
use simod_core::{Error, ErrorKind, Progress, Result};
use simod_plugin_api as api;
use std::sync::Arc;

/// Points evaluated at once on one thread.
const BLOCK: usize = 4096;

/// Derives unit normals, one per sample, from changed positions (local coordinates).
pub type Renormal<'a> = dyn Fn(&[Vec3]) -> Vec<Vec3> + Sync + 'a;

/// The samples as they were taken, and where.
#[derive(Clone, Copy)]
pub struct RestShape<'a> {
    /// Local positions; all finite.
    pub positions: &'a [Vec3],
    /// Unit normals, one per sample, or none at all.
    pub normals: &'a [Vec3],
    /// Distance to the nearest other samples, one per sample, or none at all.
    pub spacing: &'a [f32],
    /// Triangles between the samples, or none.
    pub triangles: &'a [[u32; 3]],
    /// The samples' nearest neighbours.
    pub neighbours: Option<&'a NeighbourGraph>,
    /// The map between model and local coordinates.
    pub frame: Frame,
    /// The model's box, model coordinates.
    pub bounds: Bounds,
    /// Normals for changed positions, for layers that need them after others. Without it they get the old ones.
    pub renormal: Option<&'a Renormal<'a>>,
}

/// A checked list of deformations, not tied to any samples.
#[derive(Debug)]
pub struct Stack {
    layers: Vec<Layer>,
}

#[derive(Debug)]
struct Layer {
    /// Where in the session it stands; for errors.
    place: String,
    plugin: Arc<Plugin>,
    params: Params,
    /// Fixed and handle regions.
    regions: Vec<(api::Role, Shapes)>,
    /// The handle regions' motions, model coordinates.
    transforms: Vec<DAffine3>,
    /// Where the layer acts; everywhere if there is none.
    masks: Vec<Shapes>,
}

/// What a stack made of samples.
#[derive(Debug)]
pub struct Deformed {
    /// Deformed positions, in the same local coordinates, one per sample.
    pub positions: Vec<Vec3>,
    /// The prepared layers, to be asked for other points.
    pub stack: PreparedStack,
    /// What the plugins had to say.
    pub messages: Vec<Message>,
}

/// A stack prepared on samples: the map of space itself, where the plugins know it.
#[derive(Debug)]
pub struct PreparedStack {
    layers: Vec<PreparedLayer>,
    frame: Frame,
}

/// One layer, prepared on its rest shape.
#[derive(Debug)]
struct PreparedLayer {
    plugin: Arc<Plugin>,
    state: api::State,
    rest: Rest,
    params: LocalParams,
    transforms: Vec<api::Affine>,
    masks: Vec<Shapes>,
}

/// A layer's rest shape, local coordinates.
#[derive(Debug)]
struct Rest {
    positions: Vec<Vec3>,
    normals: Arc<[Vec3]>,
    spacing: Arc<[f32]>,
    bounds: api::Bounds,
}

impl Rest {
    fn samples(&self) -> api::Samples<'_> {
        api::Samples::new(
            bytemuck::cast_slice(&self.positions),
            bytemuck::cast_slice(&self.normals),
            &self.spacing,
        )
    }
}

impl Stack {
    /// Finds the steps' plugins, and checks parameters and regions against what they ask for.
    pub fn build(steps: &[Step], registry: &PluginRegistry) -> Result<Self> {
        let layer = |step: &Step| Layer::build(step, registry).map_err(|e| at(&step.place, e));
        Ok(Self { layers: steps.iter().map(layer).collect::<Result<_>>()? })
    }

    /// How many layers there are.
    pub fn len(&self) -> usize {
        self.layers.len()
    }

    /// Whether nothing is deformed at all.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// The plugins, first layer first.
    pub fn plugins(&self) -> impl Iterator<Item = &Plugin> {
        self.layers.iter().map(|l| &*l.plugin)
    }

    /// Deforms samples. On an error nothing has changed anywhere.
    pub fn apply(&self, shape: &RestShape<'_>, progress: &dyn Progress) -> Result<Deformed> {
        shape.check()?;
        let mut positions = shape.positions.to_vec();
        let mut normals: Arc<[Vec3]> = shape.normals.into();
        let spacing: Arc<[f32]> = shape.spacing.into();
        let corner = |p| shape.frame.to_local_exact(p).to_array();
        let bounds = api::Bounds { min: corner(shape.bounds.min), max: corner(shape.bounds.max) };
        let mut messages = Vec::new();
        let mut layers = Vec::with_capacity(self.layers.len());
        for (i, layer) in self.layers.iter().enumerate() {
            if i > 0
                && layer.plugin.consumes().normals
                && let Some(renormal) = shape.renormal
            {
                normals = renormal(&positions).into();
                if normals.len() != positions.len() {
                    return Err(not_one_per_sample("normal"));
                }
            }
            let rest = Rest { positions, normals: normals.clone(), spacing: spacing.clone(), bounds };
            let watch = Watch::new(progress, layer.plugin.id(), size_of_val(shape.positions) as u64);
            let (prepared, deformed) = layer.apply(rest, shape, &watch).map_err(|e| at(&layer.place, e))?;
            messages.extend(watch.into_messages());
            layers.push(prepared);
            positions = deformed;
        }
        Ok(Deformed { positions, stack: PreparedStack { layers, frame: shape.frame }, messages })
    }
}

fn not_one_per_sample(what: &str) -> Error {
    let what = format!("there is not one {what} per sample");
    Error::new(ErrorKind::Mismatch, what, "sample the model again")
}

impl RestShape<'_> {
    fn check(&self) -> Result<()> {
        let count = self.positions.len();
        if count == 0 {
            let hint = "sample the model more finely";
            return Err(Error::new(ErrorKind::Degenerate, "there are no samples to deform", hint));
        }
        if ![0, count].contains(&self.normals.len()) {
            return Err(not_one_per_sample("normal"));
        }
        if ![0, count].contains(&self.spacing.len()) {
            return Err(not_one_per_sample("spacing distance"));
        }
        let finite = self.positions.par_iter().all(|p| p.is_finite());
        if !(finite && self.frame.is_valid() && self.bounds.min.is_finite() && self.bounds.max.is_finite()) {
            let what = "a sample, the frame or the bounding box is not finite";
            return Err(Error::new(ErrorKind::Degenerate, what, "sample the model again"));
        }
        Ok(())
    }
}

impl Layer {
    fn build(step: &Step, registry: &PluginRegistry) -> Result<Self> {
        let plugin = registry.get(&step.deform)?.clone();
        let params = Params::check(plugin.id(), plugin.params(), &step.params)?;
        let mut layer = Self {
            place: step.place.clone(),
            plugin,
            params,
            regions: Vec::new(),
            transforms: Vec::new(),
            masks: Vec::new(),
        };
        for region in &step.regions {
            match region.role {
                Role::Mask => layer.masks.push(region.shapes.clone()),
                Role::Fixed => layer.regions.push((api::Role::FIXED, region.shapes.clone())),
                Role::Handle => {
                    layer.regions.push((api::Role::HANDLE, region.shapes.clone()));
                    layer.transforms.push(region.motion.to_affine());
                }
            }
        }
        layer.check_regions()?;
        Ok(layer)
    }

    fn check_regions(&self) -> Result<()> {
        let (id, consumes) = (self.plugin.id(), self.plugin.consumes());
        let roles = [
            (api::Role::FIXED, "fixed", consumes.fixed_regions, consumes.min_fixed),
            (api::Role::HANDLE, "handle", consumes.handle_regions, consumes.min_handles),
        ];
        for (role, name, used, least) in roles {
            let count = self.regions.iter().filter(|r| r.0 == role).count();
            if count > 0 && !used {
                let hint = "remove the region; to limit where the step acts, use role = \"mask\"";
                let what = format!("plugin {id} uses no {name} regions");
                return Err(Error::new(ErrorKind::Argument, what, hint));
            }
            if count < least as usize {
                let what = format!("plugin {id} needs {least} {name} region(s), not {count}");
                let hint = format!("add a [[step.region]] with role = \"{name}\"");
                return Err(Error::new(ErrorKind::Argument, what, hint));
            }
        }
        Ok(())
    }

    fn apply(
        &self,
        rest: Rest,
        shape: &RestShape<'_>,
        watch: &Watch<'_>,
    ) -> Result<(PreparedLayer, Vec<Vec3>)> {
        if self.plugin.consumes().normals && rest.normals.is_empty() {
            let what = format!("plugin {} needs normals, and the samples have none", self.plugin.id());
            return Err(Error::new(ErrorKind::Mismatch, what, "sample the model with normals"));
        }
        let frame = shape.frame;
        let weigh = |shapes: &Shapes| -> Vec<f32> {
            rest.positions.par_iter().map(|p| shapes.weight(frame.to_model(*p)) as f32).collect()
        };
        let weights: Vec<Vec<f32>> = self.regions.iter().map(|(_, shapes)| weigh(shapes)).collect();
        let regions: Vec<api::Region<'_>> =
            self.regions.iter().zip(&weights).map(|((role, _), w)| api::Region::new(*role, w)).collect();

        let params = self.params.to_local(&frame, &shape.bounds);
        let values = params.views();
        let triangles = api::Triangles::new(shape.triangles);
        let lists = shape
            .neighbours
            .filter(|_| self.plugin.consumes().graph)
            .map(|n| neighbour_lists(n, rest.positions.len()));
        let graph = lists.as_ref().map(|(starts, neighbours)| api::Graph::new(starts, neighbours));
        let mut parts: Vec<api::Part<'_>> = graph.iter().map(api::Part::new).collect();
        if self.plugin.consumes().triangles && !shape.triangles.is_empty() {
            parts.push(api::Part::new(&triangles));
        }
        let input = api::PrepareInput::new(rest.samples(), rest.bounds, &regions, &values).with_parts(&parts);
        let state = self.plugin.prepare(&input, watch)?;
        drop(values);
        let transforms = self.transforms.iter().map(|&t| rows(to_local(t, &frame))).collect();
        let (plugin, masks) = (self.plugin.clone(), self.masks.clone());
        let prepared = PreparedLayer { plugin, state, rest, params, transforms, masks };
        let deformed = prepared.deform(&frame, watch)?;
        Ok((prepared, deformed))
    }
}

/// Where the neighbours of each sample begin, and all of them.
pub(crate) fn neighbour_lists(graph: &NeighbourGraph, samples: usize) -> (Vec<u32>, &[u32]) {
    ((0..=samples).map(|i| (i * graph.k()) as u32).collect(), graph.all())
}

/// An error of a layer, with its place; a cancel has none.
fn at(place: &str, e: Error) -> Error {
    if e.kind() == ErrorKind::Cancelled { e } else { Error::new(e.kind(), format!("{place}: {e}"), e.hint()) }
}

/// As plugins take it.
pub(crate) fn rows(map: DAffine3) -> api::Affine {
    let (m, t) = (map.matrix3, map.translation);
    let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
    api::Affine { rows: [row(0), row(1), row(2)] }
}

impl PreparedLayer {
    fn deform(&self, frame: &Frame, watch: &Watch<'_>) -> Result<Vec<Vec3>> {
        let rest = &self.rest.positions;
        let mut out = vec![Vec3::NAN; rest.len()];
        let values = self.params.views();
        let input = api::DeformInput::new(self.rest.samples(), self.rest.bounds, &self.transforms, &values);
        let mut scratch = self.plugin.new_scratch()?;
        let buffer = bytemuck::cast_slice_mut(&mut out);
        self.plugin.deform(&self.state, &input, &mut scratch, buffer, watch)?;
        if !self.masks.is_empty() {
            out.par_iter_mut().zip(rest).for_each(|(q, p)| {
                let p = p.as_dvec3();
                *q = self.masked(frame.to_model_exact(p), p, q.as_dvec3()).as_vec3();
            });
        }
        Ok(out)
    }

    /// Replaces local points by their images.
    fn evaluate(&self, frame: &Frame, points: &mut [DVec3], watch: &Watch<'_>) -> Result<()> {
        let rest: Vec<DVec3> = if self.masks.is_empty() { Vec::new() } else { points.to_vec() };
        let values = self.params.views();
        let input = api::DeformInput::new(self.rest.samples(), self.rest.bounds, &self.transforms, &values);
        self.plugin.evaluate(&self.state, &input, bytemuck::cast_slice_mut(points), watch)?;
        for (q, p) in points.iter_mut().zip(rest) {
            *q = self.masked(frame.to_model_exact(p), p, *q);
        }
        Ok(())
    }

    /// The image `q` of `p` as far as the masks let it; `at` is `p` in model coordinates.
    fn masked(&self, at: DVec3, p: DVec3, q: DVec3) -> DVec3 {
        let weight = self.masks.iter().map(|m| m.weight(at)).fold(0.0, f64::max);
        // Exactly one of both where there is nothing to blend.
        if weight >= 1.0 { q } else { p + weight * (q - p) }
    }
}

impl PreparedStack {
    /// Whether all layers know their map at any point of space.
    pub fn can_evaluate(&self) -> bool {
        self.layers.iter().all(|l| l.plugin.can_evaluate())
    }

    /// Replaces points (model coordinates) by their exact images, on all cores. Points that are not finite stay
    /// as they are. On an error the points' content is meaningless.
    pub fn evaluate(&self, points: &mut [DVec3]) -> Result<()> {
        self.evaluate_with(points, &Silent)
    }

    /// [`evaluate`](Self::evaluate), stopping where `progress` says so.
    pub fn evaluate_with(&self, points: &mut [DVec3], progress: &dyn Progress) -> Result<()> {
        points.par_chunks_mut(BLOCK).try_for_each_init(Vec::new, |local, points| {
            local.clear();
            // Plugins are promised finite points.
            local.extend(
                points
                    .iter()
                    .map(|p| if p.is_finite() { self.frame.to_local_exact(*p) } else { DVec3::ZERO }),
            );
            for layer in &self.layers {
                progress.check()?;
                // Blocks are too small for progress of their own: size 0 tells nothing.
                let watch = Watch::new(progress, layer.plugin.id(), 0);
                layer.evaluate(&self.frame, local, &watch)?;
            }
            for (point, image) in points.iter_mut().zip(local.iter()) {
                if point.is_finite() {
                    *point = self.frame.to_model_exact(*image);
                }
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_core::sampling::SampleSet;
    use simod_plugin_api::__private::{no_extension, root_module};
    use std::path::Path;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Moves each sample to the mean of its neighbours and of the corners of its triangles.
    struct Smooth;

    impl api::Deformer for Smooth {
        type State = Vec<[f32; 3]>;
        type Scratch = ();

        fn descriptor() -> api::Descriptor {
            let consumes = api::Consumes { triangles: true, graph: true, ..api::Consumes::default() };
            api::Descriptor::new("smooth", "Smooth", "1.0.0").consumes(consumes)
        }

        fn prepare(input: &api::PrepareInput<'_>, host: &api::Host<'_>) -> api::PluginResult<Vec<[f32; 3]>> {
            let missing = || api::PluginError::input("it is not there");
            let (graph, triangles) =
                (input.graph().ok_or_else(missing)?, input.triangles().ok_or_else(missing)?);
            let positions = input.samples.positions();
            let mut means = vec![[0.0; 3]; positions.len()];
            let seen = AtomicUsize::new(0);
            host.parallel_blocks(&mut means, 7, |first, means| {
                for (i, mean) in (first..).zip(means) {
                    let corners = triangles.indices().iter().filter(|t| t.contains(&(i as u32))).flatten();
                    let near: Vec<usize> = graph.of(i).iter().chain(corners).map(|j| *j as usize).collect();
                    let sum = near.iter().map(|j| Vec3::from_array(positions[*j])).sum::<Vec3>();
                    *mean = (sum / near.len() as f32).to_array();
                    seen.fetch_add(1, Ordering::Relaxed);
                }
            })?;
            assert_eq!(seen.into_inner(), positions.len());
            Ok(means)
        }

        fn deform(
            state: &Vec<[f32; 3]>,
            _: &api::DeformInput<'_>,
            _: &mut (),
            out: &mut [[f32; 3]],
            _: &api::Host<'_>,
        ) -> api::PluginResult<()> {
            out.copy_from_slice(state);
            Ok(())
        }
    }

    #[test]
    fn triangles_and_neighbours_reach_a_plugin_that_asks_for_them() {
        let positions = (0..50).map(|i| Vec3::new(i as f32, (i * i) as f32 / 9.0, 0.0)).collect();
        let set = SampleSet::new(positions, Vec::new()).unwrap();
        let triangles: Vec<[u32; 3]> = (0..48).map(|i| [i, i + 1, i + 2]).collect();
        let plugin = Plugin::new(root_module::<Smooth>(no_extension), Path::new("smooth")).unwrap();
        let layer = Layer {
            place: "step 1".to_owned(),
            params: Params::check(plugin.id(), plugin.params(), &toml::Table::new()).unwrap(),
            plugin: Arc::new(plugin),
            regions: Vec::new(),
            transforms: Vec::new(),
            masks: Vec::new(),
        };
        let shape = RestShape {
            positions: &set.positions,
            normals: &[],
            spacing: &[],
            triangles: &triangles,
            neighbours: Some(set.neighbours()),
            frame: Frame { origin: DVec3::ZERO, scale: 1.0 },
            bounds: Bounds { min: DVec3::ZERO, max: DVec3::ONE },
            renormal: None,
        };
        let stack = Stack { layers: vec![layer] };
        let deformed = stack.apply(&shape, &Silent).unwrap().positions;
        let near = |i: usize| {
            let corners = triangles.iter().filter(move |t| t.contains(&(i as u32))).flatten();
            set.neighbours().of(i).iter().chain(corners).map(|j| set.positions[*j as usize])
        };
        for (i, p) in deformed.iter().enumerate() {
            let mean = near(i).sum::<Vec3>() / near(i).count() as f32;
            assert!(p.abs_diff_eq(mean, 1e-4), "{i}: {p} is not {mean}");
        }
        let without = stack.apply(&RestShape { triangles: &[], ..shape }, &Silent).unwrap_err();
        assert!(without.to_string().contains("it is not there"), "{without}");
    }
}
