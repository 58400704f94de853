//! Skinning: a skeleton in the model, whose joints are handles.
//!
//! | what | by |
//! |---|---|
//! | `skeleton` | joints of the session, or of a file |
//! | `grid`, `voxels`, `field`, `influences` | numbers of joints at the voxels of the model, and so everywhere |
//! | `levels`, `bounded`, `biharmonic` | bounded biharmonic weights: Jacobson, Baran, Popović and Sorkine 2011 |
//! | `distance`, `geodesic` | weights by the distance inside of the model: Dionne and de Lasa 2013 |
//! | `table`, `dmat` | weights of a file |
//! | `frames` | motions of a file |
//! | `pose`, `reach` | motions of handles, and ends that reach for a place: Aristidou and Lasenby 2011 |
//! | `blend` | linear, or by dual quaternions: Kavan, Collins, Žára and O'Sullivan 2008 |
//!
//! Weights are a map of space, and with them the whole deformation.

mod biharmonic;
mod blend;
mod bounded;
mod distance;
mod dmat;
mod field;
mod frames;
mod geodesic;
mod grid;
mod influences;
mod levels;
mod pose;
mod reach;
mod skeleton;
mod table;
mod voxels;

use biharmonic::Biharmonic;
use blend::Blend;
use frames::Frames;
use geodesic::{Geodesic, Rule};
use glam::{DAffine3, DVec3};
use influences::{InfluenceTable, Influences, limited};
use pose::Reaching;
use simod_plugin_api::{
    Affine, Choice, DeformInput, Deformer, Descriptor, Evaluate, HandleDesc, Handles, Host, IsIdentity,
    Migrate, MigrationDesc, ModelFrame, ParamDesc, ParamSet, PluginError, PluginResult, PrepareInput,
    Settings,
};
use skeleton::Skeleton;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use table::WeightTable;
use voxels::Voxels;

/// Samples or points at once on one thread.
const TOGETHER: usize = 1024;
/// Joints that a place follows where weights are found and nothing is said.
const FOUND: usize = 4;
/// Part of a sample's weights that may be left out without a warning.
const LOST: f64 = 0.01;
/// A file's rows should be so near to the samples, as a part of the diagonal.
const NEAR: f64 = 0.05;

/// The plugin.
struct Skinning;

/// Settings of the blend of joints, and of the ends that reach.
#[derive(ParamSet)]
struct Pose {
    /// Blend of the motions of several joints; dual quaternions keep the volume in twists, linear loses some
    ///
    /// Dual quaternions bulge a little where joints bend.
    #[param(default = Method::DualQuaternion)]
    method: Method,
    /// Joints with a handle `ID/reach`, to which the joint comes as the chain of bones above it bends
    #[param(default = Reach::Ends, group = "Reaching", invalidates_preparation)]
    reach: Reach,
    /// Number of bones of a chain that reaches, at most: 2 for an arm or a leg; 0 for all up to a branch or
    /// the root
    ///
    /// With two, a hand does not turn the body.
    #[param(default = 2, hard = 0..=1000, soft = 0..=8, group = "Reaching")]
    reach_length: i64,
}

#[derive(Choice, Clone, Copy)]
enum Method {
    #[choice(label = "Dual quaternions")]
    DualQuaternion,
    #[choice(label = "Linear")]
    Linear,
}

#[derive(Choice, Clone, Copy)]
enum Reach {
    #[choice(label = "The ends of limbs")]
    Ends,
    #[choice(label = "All that hang on another")]
    All,
    #[choice(label = "None")]
    None,
}

/// Settings of the weights.
#[derive(ParamSet)]
struct Weights {
    /// Weights where no file has them: the smoothest from bone to bone, or by distances through the inside
    ///
    /// Those by distances have `falloff` and `smoothing`.
    #[param(default = Binding::Biharmonic, group = "Weights", invalidates_preparation)]
    binding: Binding,
    /// Number of joints that a place follows, at most; 0 for four, or for all that a file has
    #[param(default = 0, hard = 0..=64, soft = 0..=8, group = "Weights", invalidates_preparation)]
    influences: i64,
    /// Power of the distance by which a bone's influence falls, for geodesic: 2 for soft limbs, 8 for tight
    /// joints
    ///
    /// Joints are tight that bend within little more than their width.
    #[param(default = 4.0, hard = 2.0..=32.0, soft = 2.0..=10.0, group = "Weights", invalidates_preparation)]
    falloff: f64,
    /// Length over which creases in the distances from bones are rounded off, for geodesic binding
    #[param(default = 0.005, unit = "diagonal", hard = 0.0..=0.02, soft = 0.0..=0.01, group = "Weights")]
    #[param(invalidates_preparation)]
    smoothing: f64,
    /// Number of voxels along the longest side of the model; limbs less than two of them apart count as one
    ///
    /// Weights are found in the voxels.
    #[param(default = 128, hard = 16..=256, soft = 64..=256, group = "Weights", invalidates_preparation)]
    resolution: i64,
}

#[derive(Choice, Clone, Copy)]
enum Binding {
    #[choice(label = "Bounded biharmonic")]
    Biharmonic,
    #[choice(label = "Geodesic voxel")]
    Geodesic,
}

/// A bound model.
struct Prepared {
    skeleton: Skeleton,
    moved: Moved,
    weights: Source,
    table: InfluenceTable,
}

/// The source of the joints' motions.
enum Moved {
    /// The user.
    Handles(pose::Handles),
    /// A file, which moves each bone by itself.
    Frames(Frames),
}

/// The source of the weights.
enum Source {
    Biharmonic(Box<Biharmonic>),
    Geodesic(Box<Geodesic>),
    File(Box<WeightTable>, usize),
}

/// The fit of a file's weights to a place.
struct Told {
    /// Distance to the nearest place that a file has.
    far: f64,
    /// Part of its weights that is left out.
    lost: f64,
}

impl Source {
    /// Weights that are found in the voxels of a body.
    fn of_voxels(
        binding: Binding,
        voxels: Voxels,
        skeleton: &Skeleton,
        rule: Rule,
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        Ok(match binding {
            Binding::Biharmonic => {
                Self::Biharmonic(Box::new(Biharmonic::new(voxels, skeleton, rule.limit, host)?))
            }
            Binding::Geodesic => Self::Geodesic(Box::new(Geodesic::new(voxels, skeleton, rule, host)?)),
        })
    }

    fn influences_at(&self, p: DVec3, influences: &mut Influences) -> Told {
        match self {
            Self::Biharmonic(binding) => binding.influences_at(p, influences),
            Self::Geodesic(binding) => binding.influences_at(p, influences),
            Self::File(rows, limit) => {
                let far = rows.influences_at(p, influences);
                return Told { far, lost: limited(influences, *limit) };
            }
        }
        Told { far: 0.0, lost: 0.0 }
    }
}

/// The joints of the session; without any, those of the file.
fn skeleton(input: &PrepareInput<'_>) -> PluginResult<Skeleton> {
    match input.params().file("skeleton")? {
        Some(path) if input.joints().is_empty() => Skeleton::read(path, to_local(input, "skeleton")?),
        _ => Skeleton::new(input.joints()),
    }
}

/// Map from the coordinates of a file to local ones.
fn to_local(input: &PrepareInput<'_>, param: &str) -> PluginResult<impl Fn(DVec3) -> DVec3> {
    let frame = frame(input, param)?;
    Ok(move |p: DVec3| frame.to_local(p.to_array()).into())
}

fn frame(input: &PrepareInput<'_>, param: &str) -> PluginResult<ModelFrame> {
    input.frame().copied().ok_or_else(|| {
        PluginError::parameter(param, "is of no use: this program does not tell where the model lies")
            .hint("take a newer one")
    })
}

fn handles(input: &PrepareInput<'_>, skeleton: &Skeleton) -> PluginResult<pose::Handles> {
    let which = match input.params().read::<Pose>()?.reach {
        Reach::Ends => Reaching::Ends,
        Reach::All => Reaching::All,
        Reach::None => Reaching::None,
    };
    Ok(pose::Handles::new(skeleton, which))
}

/// Warns of samples that lose weights, as they follow a limited number of joints, and of samples that are far
/// from all places of a table.
///
/// # Errors
/// All samples are far.
fn tell(
    input: &PrepareInput<'_>,
    [lossy, far]: [usize; 2],
    limit: usize,
    host: &Host<'_>,
) -> PluginResult<()> {
    let all = input.samples.positions().len();
    if lossy > 0 {
        host.warn(&format!(
            "{lossy} of {all} samples lose more than 1 % of their weights, as they follow {limit} joints at most; raise \
             `influences`"
        ));
    }
    if far == 0 {
        return Ok(());
    }
    if far == all {
        return Err(no_place_near(input)?);
    }
    host.warn(&format!("{far} of {all} samples are far from all places of the table of weights"));
    Ok(())
}

/// The error that no sample is near any place that the weights are of.
fn no_place_near(input: &PrepareInput<'_>) -> PluginResult<PluginError> {
    let [weights, places] = [input.params().file("weights")?, input.params().file("places")?];
    let (param, path) = match (weights, places) {
        (Some(weights), Some(places)) if table::is_dmat(weights) => ("places", places),
        (weights, _) => ("weights", weights.unwrap_or(Path::new(""))),
    };
    let message = format!("has no place near the model: {}", path.display());
    Ok(PluginError::parameter(param, &message).hint("give places in the model's coordinates"))
}

/// The blend of the joints' motions.
fn blend(state: &Prepared, input: &DeformInput<'_>) -> PluginResult<Blend> {
    let Pose { method, reach_length, .. } = input.params().read()?;
    let motions = match &state.moved {
        Moved::Handles(handles) => {
            let length = usize::try_from(reach_length).ok().filter(|most| *most > 0);
            handles.pose(&state.skeleton, input.handle_motions(), length)?
        }
        Moved::Frames(frames) => {
            let mut motions = vec![DAffine3::IDENTITY; state.skeleton.joints.len()];
            let frame = input.time().frame;
            for (bone, motion) in frames.of_frame(frame)?.iter().enumerate() {
                if matches!(method, Method::DualQuaternion) && blend::mirrors(motion) {
                    return Err(frames.mirrors(frame, bone));
                }
                motions[state.skeleton.mover(bone)] = *motion;
            }
            motions
        }
    };
    match method {
        Method::DualQuaternion => Blend::dual_quaternion(&motions, &state.skeleton),
        Method::Linear => Ok(Blend::linear(motions)),
    }
}

impl Deformer for Skinning {
    type State = Prepared;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("skinning", "Skinning", env!("CARGO_PKG_VERSION"))
            .summary("Bends the model by the joints of a skeleton in it")
            .citation(
                "L. Kavan, S. Collins, J. Žára, C. O'Sullivan, Geometric skinning with approximate dual quaternion \
                 blending, ACM TOG 27, 2008; A. Jacobson, I. Baran, J. Popović, O. Sorkine, Bounded biharmonic weights \
                 for real-time deformation, SIGGRAPH 2011; O. Dionne, M. de Lasa, Geodesic voxel binding for \
                 production character meshes, SCA 2013; A. Aristidou, J. Lasenby, FABRIK, Graphical Models 73, 2011",
            )
            .param_set::<Pose>()
            .param(
                ParamDesc::file("skeleton", "Skeleton", &["tgf"])
                    .hint("Joints and bones as a TGF file in the model's coordinates, where the session places no joints")
                    .group("Files"),
            )
            .param(
                ParamDesc::file("weights", "Weights", &["txt", "csv", "dat", "dmat"])
                    .hint("Table `x y z` and a column for each joint, in the model's coordinates, or a DMAT; without it they are found")
                    .group("Files"),
            )
            .param(
                ParamDesc::file("places", "Places of weights", &["obj", "dmat"])
                    .hint("Places of the rows of a DMAT with weights: an OBJ's vertices, or a DMAT with three columns")
                    .group("Files"),
            )
            .param(
                ParamDesc::file("pose", "Pose", &["txt", "csv", "dat", "dmat"])
                    .hint("Motions of the bones instead of handles, each by itself: 12 numbers for each bone and frame")
                    .group("Files"),
            )
            .param_set::<Weights>()
            .consumes(simod_plugin_api::Consumes {
                joints: true,
                triangles: true,
                graph: true,
                frame: true,
                time: true,
                ..Default::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<Prepared> {
        let whole_skeleton = skeleton(input)?;
        let (skeleton, moved) = match input.params().file("pose")? {
            Some(path) => {
                let frames = Frames::read(path, whole_skeleton.bone_count(), frame(input, "pose")?)?;
                (whole_skeleton.taken_apart(), Moved::Frames(frames))
            }
            None => {
                let handles = handles(input, &whole_skeleton)?;
                (whole_skeleton, Moved::Handles(handles))
            }
        };
        let Weights { binding, influences, falloff, smoothing, resolution } = input.params().read()?;
        let whole =
            |id: &str, x: i64| usize::try_from(x).map_err(|_| PluginError::parameter(id, "is negative"));
        let limit = Some(whole("influences", influences)?).filter(|most| *most > 0);
        let samples = input.samples.positions();
        let weights = match input.params().file("weights")? {
            Some(path) => {
                let places = input.params().file("places")?;
                let rows = WeightTable::read(path, places, &skeleton, to_local(input, "weights")?)?;
                rows.doubts(path).iter().for_each(|doubt| host.warn(doubt));
                Source::File(Box::new(rows), limit.unwrap_or(usize::MAX))
            }
            None => {
                let voxels =
                    Voxels::new(input, &skeleton.all_bones(), whole("resolution", resolution)?, host)?;
                let smoothing = smoothing * input.bounds.diagonal();
                let rule = Rule { power: falloff, smoothing, limit: limit.unwrap_or(FOUND) };
                Source::of_voxels(binding, voxels, &skeleton, rule, host)?
            }
        };
        let (far, lossy) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let near = NEAR * input.bounds.diagonal();
        let find = |p: DVec3, influences: &mut Influences| {
            let told = weights.influences_at(p, influences);
            far.fetch_add(usize::from(told.far > near), Ordering::Relaxed);
            lossy.fetch_add(usize::from(told.lost > LOST), Ordering::Relaxed);
        };
        let table = InfluenceTable::new(samples, find, host)?;
        tell(input, [lossy.into_inner(), far.into_inner()], limit.unwrap_or(FOUND), host)?;
        Ok(Prepared { skeleton, moved, weights, table })
    }

    fn deform(
        state: &Prepared,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = input.samples.positions();
        if rest.len() != out.len() || state.table.len() != out.len() {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let blend = blend(state, input)?;
        if blend.is_identity() {
            out.copy_from_slice(rest);
            return Ok(());
        }
        host.parallel_blocks(out, TOGETHER, |first, out| {
            for (i, o) in (first..).zip(out) {
                let p = DVec3::from(rest[i].map(f64::from));
                *o = blend.apply(p, state.table.of_sample(i)).as_vec3().into();
            }
        })
    }
}

impl Evaluate for Skinning {
    fn evaluate(
        state: &Prepared,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let blend = blend(state, input)?;
        let mut room = Vec::new();
        for points in points.chunks_mut(TOGETHER) {
            host.progress(0.0)?;
            for p in points {
                let x = DVec3::from(*p);
                state.weights.influences_at(x, &mut room);
                *p = blend.apply(x, room.iter().map(|(w, joint)| (usize::from(*joint), *w))).into();
            }
        }
        Ok(())
    }
}

impl Handles for Skinning {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        if input.params().file("pose")?.is_some() {
            return Ok(Vec::new());
        }
        let skeleton = skeleton(input)?;
        Ok(handles(input, &skeleton)?.describe(&skeleton))
    }
}

impl Migrate for Skinning {
    /// Migration of settings: in the first version weights were geodesic: sessions that say how stay with
    /// these. In the second, chains that reach went up to the root.
    fn migration() -> MigrationDesc {
        MigrationDesc::new(3)
    }

    fn migrate(from: u32, settings: &mut Settings) -> PluginResult<()> {
        let says_how = ["falloff", "smoothing"].iter().any(|id| settings.get(id).is_some());
        if from < 2 && says_how && settings.get("binding").is_none() {
            settings.set_text("binding", "geodesic");
        }
        if settings.get("reach-length").is_none() {
            settings.set_number("reach-length", 0.0);
        }
        Ok(())
    }
}

impl IsIdentity for Skinning {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        let has = |id: &str| Ok::<bool, PluginError>(input.params().file(id)?.is_some());
        // Weights are read even if nothing moves, so that the user is told of errors in them.
        let is_still = !has("pose")? && !has("weights")?;
        Ok(is_still && input.handle_motions().iter().all(|motion| *motion == Affine::IDENTITY))
    }
}

simod_plugin_api::export_plugin!(Skinning, evaluate, handles, is_identity, migrate);

#[cfg(test)]
mod tests;
