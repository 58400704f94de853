//! Point-based free-form deformation with smooth handles: no mesh, and no system to solve.
//!
//! M. Pauly, R. Keiser, L. Kobbelt, M. Gross, *Shape modeling with point-sampled geometry*, SIGGRAPH 2003,
//! §5: the fixed region is the zero-region, a handle the one-region. Each sample makes a part of the
//! handle's motion, which a scale function gives from its distances to the two; parts of motions are those
//! of a screw. The tool of most of the SIMOD paper's figures.

mod distance;
mod draft;
mod influence;
mod motion;
mod regions;

use draft::{Amounts, PartsTable};
use glam::{DVec3, Vec3};
use influence::{HandleShares, Profile, ShareRule};
use motion::HandleMotion;
use regions::MergedRegions;
use simod_plugin_api::{
    Affine, Choice, Consumes, DeformInput, Deformer, Descriptor, Effort, Host, IsIdentity, ParamSet,
    PluginError, PluginResult, PrepareInput,
};
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 4096;

/// The plugin.
struct SmoothHandle;

#[derive(ParamSet)]
struct SmoothHandleSettings {
    /// Distance of samples from regions; along the surface, fingers that nearly touch are far apart
    #[param(default = Distance::Euclidean, invalidates_preparation)]
    distance: Distance,
    /// Distance up to which handles reach, if nothing is fixed
    #[param(default = 0.25, unit = "diagonal", hard = 0.0.., soft = 0.0..=1.0, invalidates_preparation)]
    reach: f64,
    /// Length over which ridges of the distances are smoothed; larger ones are rounder
    #[param(default = 0.02, unit = "diagonal", hard = 0.0..=1.0, soft = 0.0..=0.1, invalidates_preparation)]
    smoothing: f64,
}

#[derive(Choice, Clone, Copy, PartialEq)]
enum Distance {
    #[choice(label = "Through space")]
    Euclidean,
    #[choice(label = "Along the surface")]
    Surface,
}

/// The share of each handle in each sample's motion.
struct PreparedShares {
    /// Number of the preparation, which tells it from others.
    number: u64,
    shares: HandleShares,
    /// Middles of the handles, about which they stretch.
    centers: Vec<DVec3>,
}

impl Deformer for SmoothHandle {
    type State = PreparedShares;
    type Scratch = Amounts;

    fn descriptor() -> Descriptor {
        let [profile, curve] = Profile::params();
        Descriptor::new("smooth-handle", "Smooth handles", env!("CARGO_PKG_VERSION"))
            .summary("Moves handles, and what lies between them and fixed regions by parts of their motions")
            .citation(
                "M. Pauly, R. Keiser, L. Kobbelt, M. Gross, Shape modeling with point-sampled geometry, SIGGRAPH 2003",
            )
            .param(profile)
            .param(curve)
            .param_set::<SmoothHandleSettings>()
            .consumes(Consumes {
                fixed_regions: true,
                handle_regions: true,
                min_handles: 1,
                normals: true,
                graph: true,
                effort: true,
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedShares> {
        static PREPARED: AtomicU64 = AtomicU64::new(0);
        let positions: &[Vec3] = bytemuck::cast_slice(input.samples.positions());
        if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
            return Err(PluginError::input(format!("sample {i} is at no finite place")));
        }
        let normals: &[Vec3] = bytemuck::cast_slice(input.samples.normals());
        let graph = input.graph().filter(|g| g.len() == positions.len() && normals.len() == positions.len());
        let graph = graph
            .ok_or_else(|| PluginError::internal("the host gave no neighbours or normals of the samples"))?;
        let SmoothHandleSettings { distance, reach, smoothing } = input.params().read()?;
        let diagonal = input.bounds.diagonal();
        let measure = ShareRule {
            on_surface: distance == Distance::Surface,
            reach: reach * diagonal,
            smoothing: smoothing * diagonal,
        };
        let regions = MergedRegions::gather(input)?;
        let handles = regions.parts.iter().skip(usize::from(regions.has_fixed));
        let center = |core: &[u32]| {
            core.iter().map(|&i| positions[i as usize].as_dvec3()).sum::<DVec3>() / core.len() as f64
        };
        let centers = handles.map(|part| center(&part.core)).collect();
        let samples = influence::SurfaceAtRest { positions, normals, graph };
        let shares = HandleShares::new(&regions, &samples, &measure, host)?;
        Ok(PreparedShares { number: PREPARED.fetch_add(1, Ordering::Relaxed), shares, centers })
    }

    fn deform(
        state: &PreparedShares,
        input: &DeformInput<'_>,
        kept: &mut Amounts,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let (rest, transforms) = (input.samples.positions(), input.transforms());
        if transforms.len() != state.shares.handles() {
            let message = format!("{} transforms for {} handles", transforms.len(), state.shares.handles());
            return Err(PluginError::internal(message));
        }
        if [rest.len(), out.len()] != [state.shares.samples(); 2] {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let profile = Profile::from_params(input.params())?;
        let motions: Vec<HandleMotion> =
            transforms.iter().zip(&state.centers).map(|(t, &center)| HandleMotion::new(t, center)).collect();
        let mut moving = motions.iter().enumerate().filter(|(_, motion)| !motion.is_none());
        let is_draft = input.effort() == Effort::DRAFT;
        if let (true, Some((handle, motion)), None) = (is_draft, moving.next(), moving.next()) {
            let amounts = kept.of_handle((&state.shares, state.number), handle, &profile, host)?;
            let table = PartsTable::new(motion);
            return host.parallel_blocks(out, BLOCK, |first, out| {
                table.apply(&amounts[first..], &rest[first..], out);
            });
        }
        host.parallel_blocks(out, BLOCK, |first, block| {
            let mut amounts = vec![0.0; motions.len()];
            for ((i, out), p) in (first..).zip(block).zip(&rest[first..]) {
                profile.amounts(state.shares.row(i), &mut amounts);
                let moves = |(motion, t): &(&HandleMotion, f64)| *t != 0.0 && !motion.is_none();
                let mut parts = motions.iter().zip(amounts.iter().copied()).filter(moves);
                let p64 = Vec3::from(*p).as_dvec3();
                // A sample stays exactly in its place, or goes exactly where its handle takes it, if it
                // makes none or all of one motion.
                *out = match parts.next() {
                    None => *p,
                    Some((motion, 1.0)) if amounts.iter().sum::<f64>() == 1.0 => {
                        motion.all(p64).as_vec3().to_array()
                    }
                    Some(part) => motion::blend(p64, std::iter::once(part).chain(parts)).as_vec3().to_array(),
                };
            }
        })
    }
}

impl IsIdentity for SmoothHandle {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(input.transforms().iter().all(|t| *t == Affine::IDENTITY))
    }
}

simod_plugin_api::export_plugin!(SmoothHandle, is_identity);

#[cfg(test)]
mod tests;
