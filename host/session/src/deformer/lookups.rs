//! Look-ups in a plugin's samples, as the interface's `services` have them: trees that are built when they
//! are first asked, in whichever process the plugin runs, and kept with its state.
//!
//! Memory, for each state: 12 bytes a triangle where the plugin asks for triangles and 12 a sample where it
//! asks for positions at rest; 20 a sample once samples were looked up, and 150 a triangle once the surface
//! was, for each pose.

use super::{Capabilities, Code, Migration, OwnHandles};
use glam::{DVec3, Vec3};
use simod_core::sampling::KdTree;
use simod_measure::{DistanceSurface, OnSurface};
use simod_plugin_api::{
    DeformInput, Descriptor, Extension, HostCalls, LogLevel, Lookups, PluginError, PluginResult, Pose,
    PrepareInput, Scratch, Setting, State, SurfacePoint, Triangles,
};
use std::sync::OnceLock;

/// Samples of a preparation, and the trees that were built of them.
#[derive(Default)]
struct Trees {
    triangles: Vec<[u32; 3]>,
    /// Positions at rest, where the plugin asked for them.
    rest: Option<Vec<[f32; 3]>>,
    /// A tree of the samples for each pose.
    samples: [OnceLock<Option<KdTree>>; 2],
    surfaces: [OnceLock<Option<DistanceSurface>>; 2],
}

/// The host for one call, with these samples.
struct Looking<'a> {
    calls: &'a dyn HostCalls,
    positions: &'a [[f32; 3]],
    trees: &'a Trees,
}

/// A plugin's state, with the trees of its samples.
struct WithTrees {
    state: State,
    trees: Trees,
}

/// A plugin's code in this process, whose calls can look things up.
pub(crate) struct LookingCode<C>(pub C);

impl Trees {
    fn build(input: &PrepareInput<'_>) -> Self {
        Self {
            triangles: input.triangles().map(Triangles::indices).unwrap_or_default().to_vec(),
            rest: input.rest_positions().map(<[_]>::to_vec),
            ..Self::default()
        }
    }
}

impl Looking<'_> {
    /// Index and positions of a pose.
    fn pose(&self, pose: Pose) -> Option<(usize, &[[f32; 3]])> {
        match pose {
            Pose::CURRENT => Some((0, self.positions)),
            Pose::REST => Some((1, self.trees.rest.as_deref()?)),
            _ => None,
        }
    }

    /// The tree of the samples; nothing where there are none, or one is nowhere. By the calling thread alone,
    /// as several may wait for it that do jobs of a thread pool.
    fn samples(&self, pose: Pose) -> Option<&KdTree> {
        let (which, positions) = self.pose(pose)?;
        let tree = || {
            let usable = !positions.is_empty() && positions.iter().flatten().all(|x| x.is_finite());
            usable.then(|| KdTree::in_one_job(bytemuck::cast_slice::<_, Vec3>(positions)))
        };
        self.trees.samples[which].get_or_init(tree).as_ref()
    }

    fn surface(&self, pose: Pose) -> Option<&DistanceSurface> {
        let (which, positions) = self.pose(pose)?;
        let surface = || {
            let positions: Vec<DVec3> = positions.iter().map(|p| Vec3::from_array(*p).as_dvec3()).collect();
            DistanceSurface::new(&positions, &self.trees.triangles)
        };
        self.trees.surfaces[which].get_or_init(surface).as_ref()
    }
}

impl Lookups for Looking<'_> {
    fn has_samples(&self, pose: Pose) -> bool {
        self.pose(pose).is_some_and(|(_, positions)| !positions.is_empty())
    }

    fn has_triangles(&self, pose: Pose) -> bool {
        self.has_samples(pose) && !self.trees.triangles.is_empty()
    }

    fn nearest(&self, pose: Pose, point: [f64; 3], radius: f64, found: &mut [u32]) -> usize {
        /// Most samples that are found one by one; more of them are sorted.
        const FEW: usize = 256;
        let (Some((_, positions)), point) = (self.pose(pose), Vec3::from_array(point.map(|x| x as f32)))
        else {
            return 0;
        };
        // Written so that NaN is no radius.
        if !(point.is_finite() && radius >= 0.0) {
            return 0;
        }
        let Some(tree) = self.samples(pose) else { return 0 };
        if radius == f64::INFINITY && found.len() <= FEW {
            let mut nearest = vec![0; found.len().min(positions.len())];
            tree.nearest_ones(point, &mut nearest);
            found.iter_mut().zip(nearest).for_each(|(to, from)| *to = from as u32);
            return positions.len();
        }
        let within = tree.within(point, radius as f32);
        found.iter_mut().zip(&within).for_each(|(to, from)| *to = *from as u32);
        within.len()
    }

    fn closest(&self, pose: Pose, point: [f64; 3], radius: f64) -> Option<SurfacePoint> {
        let point = DVec3::from_array(point);
        let found = self.surface(pose).filter(|_| point.is_finite())?.closest(point)?;
        given(found, found.position.distance(point), radius)
    }

    fn ray(&self, pose: Pose, origin: [f64; 3], direction: [f64; 3], reach: f64) -> Option<SurfacePoint> {
        let (origin, direction) = (DVec3::from_array(origin), DVec3::from_array(direction).try_normalize()?);
        let found = self.surface(pose).filter(|_| origin.is_finite())?.first_on_ray(origin, direction)?;
        given(found, found.position.distance(origin), reach)
    }
}

/// A point that is not farther away than `most`.
fn given(found: OnSurface, distance: f64, most: f64) -> Option<SurfacePoint> {
    let OnSurface { triangle, weights, position } = found;
    (distance <= most).then(|| SurfacePoint {
        triangle,
        weights: weights.to_array(),
        position: position.to_array(),
        distance,
    })
}

impl HostCalls for Looking<'_> {
    fn progress(&self, fraction: f64) -> bool {
        self.calls.progress(fraction)
    }

    fn log(&self, level: LogLevel, message: &str) {
        self.calls.log(level, message);
    }

    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        self.calls.parallel_for(count, body)
    }

    fn lookups(&self) -> Option<&dyn Lookups> {
        Some(self)
    }

    fn extension(&self, id: &str) -> Option<Extension> {
        self.calls.extension(id)
    }
}

fn content(state: &State) -> PluginResult<&WithTrees> {
    state.get().ok_or_else(|| PluginError::internal("the host passed the state of another plugin"))
}

impl<C: Code> Code for LookingCode<C> {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        self.0.descriptor()
    }

    fn capabilities(&self) -> Capabilities {
        self.0.capabilities()
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        self.0.migration()
    }

    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State> {
        let trees = Trees::build(input);
        let looking = Looking { calls, positions: input.samples.positions(), trees: &trees };
        let state = self.0.prepare(input, &looking)?;
        Ok(State::new(WithTrees { state, trees }))
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        self.0.new_scratch()
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let WithTrees { state, trees } = content(state)?;
        let looking = Looking { calls, positions: input.samples.positions(), trees };
        self.0.deform(state, input, scratch, out, &looking)
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let WithTrees { state, trees } = content(state)?;
        let looking = Looking { calls, positions: input.samples.positions(), trees };
        self.0.evaluate(state, input, points, &looking)
    }

    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        let trees = Trees::build(input);
        let looking = Looking { calls, positions: input.samples.positions(), trees: &trees };
        self.0.handles(input, &looking)
    }

    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool> {
        self.0.is_identity(input)
    }

    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        self.0.migrate(from, settings)
    }
}
