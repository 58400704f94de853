//! The stack of deformations: each layer's output is the next one's rest shape.
//!
//! Regions are evaluated on the layer's own rest shape. A mask and the step's amount act on the host's side,
//! for every plugin: `p* = p + a m(p) (D(p) - p)`.

mod layer;
mod rest;

use crate::deformer::{Plugin, PluginWatch};
use crate::params::Params;
use crate::plugins::PluginRegistry;
use crate::step::{Deformation, Step};
use glam::DVec3;
pub(crate) use layer::{Layer, LayerCache, LayerResult};
use rayon::prelude::*;
pub(crate) use rest::{LayerRest, Moment, RestShape, located};
pub use rest::{neighbour_lists, rows};
use simod_model::frame::Frame;
use simod_model::progress::Silent;
use simod_model::{Progress, Result};
use std::sync::Arc;

/// Points evaluated at once on one thread.
const BLOCK: usize = 4096;

/// A checked list of deformations, not tied to any samples.
#[derive(Debug)]
pub struct Stack {
    layers: Vec<Layer>,
}

/// A stack prepared on samples: the map of space itself, where the plugins know it.
#[derive(Debug)]
pub struct PreparedStack {
    pub(crate) layers: Vec<Arc<LayerResult>>,
    pub(crate) frame: Frame,
}

impl Stack {
    /// Finds the plugins of the deformations that are enabled, and checks parameters and regions against the
    /// plugins' descriptions. Refinements are passed over: they need a model, and not samples alone.
    ///
    /// # Errors
    /// A plugin is not there, or a step does not fit it.
    pub fn build(steps: &[Step], registry: &PluginRegistry) -> Result<Self> {
        let enabled = steps.iter().filter(|step| step.enabled);
        let deformations = enabled.filter_map(|step| Some((step.deformation()?, &step.place)));
        let layer = |(deformation, place): (&Deformation, &String)| {
            Layer::build(deformation, place, registry, None)
                .map_err(|e| located(deformation.param_places.place_of(place, &e), e))
        };
        Ok(Self { layers: deformations.map(layer).collect::<Result<_>>()? })
    }

    /// Number of layers.
    pub fn len(&self) -> usize {
        self.layers.len()
    }

    /// Whether no layer deforms the samples.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// The plugins, first layer first.
    pub fn plugins(&self) -> impl Iterator<Item = &Plugin> {
        self.layers.iter().map(|l| &*l.plugin)
    }

    /// # Errors
    /// A step deforms samples alone, so that the map of space is not known; the error names the first such
    /// step.
    pub fn check_evaluable(&self) -> Result<()> {
        match self.layers.iter().find(|layer| !layer.plugin.capabilities().evaluate) {
            None => Ok(()),
            Some(layer) => Err(located(&layer.place, layer.plugin.samples_only())),
        }
    }

    /// Plugin of each layer with all parameters in effect.
    pub fn in_effect(&self) -> impl Iterator<Item = (&Plugin, &Params)> {
        self.layers.iter().map(|l| (&*l.plugin, l.params()))
    }
}

impl PreparedStack {
    /// Whether all layers know their map at any point of space.
    pub fn can_evaluate(&self) -> bool {
        self.layers.iter().all(|layer| layer.can_evaluate())
    }

    /// Replaces points (model coordinates) by their exact images, on all cores. Points that are not finite
    /// stay as they are. On an error the points' content is meaningless.
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
                let watch = PluginWatch::new(progress, layer.id(), 0);
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
    use crate::deform;
    use crate::edit::Refinements;
    use crate::session_file::SessionFile;
    use glam::Vec3;
    use simod_core::sampled_model::SampledModel;
    use simod_core::sampling::{SampleSet, Sampling, sample};
    use simod_model::bounds::Bounds;
    use simod_model::{Scalar, write_points};
    use simod_plugin_api as api;
    use simod_plugin_api::__private::{abi_stable, capability, find_extension, no_extension, root_module};
    use std::path::Path;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Model with these samples, and no others.
    fn sampled(
        positions: &[Vec3],
        triangles: &[[u32; 3]],
        (frame, bounds): (Frame, Bounds),
    ) -> Arc<SampledModel> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        let vertices = positions.iter().map(|p| frame.to_model(*p));
        write_points(&path, vertices, &[], triangles, Scalar::F64, &[]).unwrap();
        let model = simod_model::open(&path).unwrap();
        let mut sampled = sample(&*model, &Sampling::default(), folder.path(), &Silent).unwrap();
        sampled.samples = SampleSet::new(positions.to_vec(), Vec::new()).unwrap();
        sampled.triangles = triangles.to_vec();
        (sampled.frame, sampled.bounds) = (frame, bounds);
        Arc::new(sampled)
    }

    /// Positions to which a session's steps take its samples, local coordinates.
    fn deformed(session: &str, registry: &PluginRegistry, of: Arc<SampledModel>) -> Result<Vec<Vec3>> {
        let session = SessionFile::parse(session, Path::new("s.toml"))?;
        let frame = of.frame;
        let deformed = deform(of, &session.steps, registry, Refinements::default(), &Silent)?;
        Ok(deformed.positions.into_unshifted(&frame))
    }

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
        let plugin = Plugin::in_process(root_module::<Smooth>(no_extension), Path::new("smooth")).unwrap();
        let registry = PluginRegistry::from_plugins([plugin]);
        let placed = (
            Frame { origin: DVec3::ZERO, scale: 1.0 },
            Bounds { min: DVec3::ZERO, max: DVec3::splat(300.0) },
        );
        let smoothed = |triangles: &[[u32; 3]]| {
            let sampled = sampled(&set.positions, triangles, placed);
            deformed("[[step]]\ndeform = \"smooth\"", &registry, sampled)
        };
        let deformed = smoothed(&triangles).unwrap();
        let near = |i: usize| {
            let corners = triangles.iter().filter(move |t| t.contains(&(i as u32))).flatten();
            set.neighbours().nearest_to(i).iter().chain(corners).map(|j| set.positions[*j as usize])
        };
        for (i, p) in deformed.iter().enumerate() {
            let mean = near(i).sum::<Vec3>() / near(i).count() as f32;
            assert!(p.abs_diff_eq(mean, 1e-4), "{i}: {p} is not {mean}");
        }
        let without = smoothed(&[]).unwrap_err();
        assert!(without.to_string().contains("it is not there"), "{without}");
    }

    /// Joints as handles, with one more of its own; samples follow them in turn, and strokes lift all.
    struct Puppet;

    impl api::Deformer for Puppet {
        type State = usize;
        type Scratch = ();

        fn descriptor() -> api::Descriptor {
            let consumes = api::Consumes { joints: true, strokes: true, ..api::Consumes::default() };
            api::Descriptor::new("puppet", "Puppet", "1.0.0")
                .param(api::ParamDesc::float("lift", "Lift", 1.0).unit(api::Unit::MODEL_LENGTH))
                .consumes(consumes)
        }

        fn prepare(input: &api::PrepareInput<'_>, _: &api::Host<'_>) -> api::PluginResult<usize> {
            Ok(input.joints().len())
        }

        fn deform(
            joints: &usize,
            input: &api::DeformInput<'_>,
            _: &mut (),
            out: &mut [[f32; 3]],
            _: &api::Host<'_>,
        ) -> api::PluginResult<()> {
            let motions = input.handle_motions();
            assert_eq!(motions.len(), joints + 1);
            let mut lift = 0.0;
            for stroke in input.strokes() {
                assert!(stroke.pressures().is_empty() && stroke.points() == [[0.0; 3]]);
                lift += stroke.params().float("lift")? * stroke.strength * stroke.radius;
            }
            for (i, (o, p)) in out.iter_mut().zip(input.samples.positions()).enumerate() {
                *o = motions[i % motions.len()].apply(p.map(f64::from)).map(|x| x as f32);
                o[2] += lift as f32;
            }
            Ok(())
        }
    }

    impl api::Handles for Puppet {
        fn handles(
            input: &api::PrepareInput<'_>,
            _: &api::Host<'_>,
        ) -> api::PluginResult<Vec<api::HandleDesc>> {
            assert!(input.regions().is_empty());
            let of = |j: &api::Joint<'_>| api::HandleDesc::new(j.id(), j.position).parent(j.parent);
            let tip = api::HandleDesc::new("tip", [0.0; 3]);
            Ok(input.joints().iter().map(of).chain([tip]).collect())
        }
    }

    impl api::IsIdentity for Puppet {
        fn is_identity(input: &api::DeformInput<'_>) -> api::PluginResult<bool> {
            let still = input.handle_motions().iter().all(|m| *m == api::Affine::IDENTITY);
            Ok(still && input.strokes().is_empty())
        }
    }

    extern "C" fn puppet_extension(
        id: abi_stable::std_types::RStr<'_>,
    ) -> abi_stable::std_types::ROption<api::Extension> {
        let known = [capability::handles::<Puppet> as fn() -> _, capability::is_identity::<Puppet>];
        find_extension(id.as_str(), &known)
    }

    /// Deforms three samples on the x axis by a step of the puppet.
    fn puppet(step: &str) -> Result<Vec<Vec3>> {
        let module = root_module::<Puppet>(puppet_extension);
        let registry =
            PluginRegistry::from_plugins([Plugin::in_process(module, Path::new("puppet")).unwrap()]);
        let positions = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0];
        // Local coordinates are half of the model's, and begin at 10 along y.
        let frame = Frame { origin: DVec3::Y * 10.0, scale: 2.0 };
        let bounds = Bounds { min: DVec3::Y * 10.0, max: DVec3::new(4.0, 11.0, 1.0) };
        let sampled = sampled(&positions, &[], (frame, bounds));
        deformed(&format!("[[step]]\ndeform = \"puppet\"\n{step}"), &registry, sampled)
    }

    #[test]
    fn joints_handles_and_strokes_reach_a_plugin_that_has_them() {
        let joints = "[[step.joint]]\nid = \"hand\"\nat = [2, 10, 0]\nparent = \"arm\"\n\
            [[step.joint]]\nid = \"arm\"\nat = [0, 10, 0]\n";
        assert_eq!(puppet(joints).unwrap()[2], Vec3::X * 2.0, "nothing moves, and nothing is called");
        // The arm is raised by a quarter turn about itself, and the hand, which hangs on it, by another about
        // its place.
        let turn =
            |id| format!("[[step.handle]]\nid = \"{id}\"\nmove = {{ axis = [0, 0, 1], degrees = 90 }}\n");
        let moved = puppet(&format!("{joints}{}{}", turn("arm"), turn("hand"))).unwrap();
        let expected = [Vec3::ZERO, Vec3::Y, Vec3::X * 2.0];
        assert!(moved.iter().zip(expected).all(|(a, b)| a.abs_diff_eq(b, 1e-6)), "{moved:?}");
        let hand = puppet(&format!("{joints}{}", turn("hand"))).unwrap();
        assert!(hand[1].abs_diff_eq(Vec3::X, 1e-6), "{hand:?}");
        // Lengths of strokes and their parameters are local: (3 / 2) (4 / 2) - (1 / 2) (4 / 2).
        let strokes = "params = { lift = 1 }\n\
            [[step.stroke]]\nradius = 4\nparams = { lift = 3 }\npoints = [[0, 10, 0]]\n\
            [[step.stroke]]\nradius = 4\nstrength = -1\npoints = [[0, 10, 0]]\n";
        assert_eq!(puppet(strokes).unwrap()[1], Vec3::new(1.0, 0.0, 2.0));
        let unknown = puppet(&format!("{joints}{}", turn("hnad"))).unwrap_err();
        assert!(unknown.to_string().contains("no handle `hnad`"), "{unknown}");
        assert_eq!(unknown.hint(), "did you mean `hand`?");
    }
}
