//! Smoothing at the scale of the samples: bumps up to some size go, larger ones stay, and details finer
//! than the samples are carried along as they are.
//!
//! Two methods: a low-pass filter (G. Taubin, *A signal processing approach to fair surface design*,
//! SIGGRAPH 1995, by the polynomials of Taubin, Zhang and Golub 1996), which keeps the size of the waves
//! that stay; and mean curvature flow (M. Desbrun, M. Meyer, P. Schröder, A. Barr, *Implicit fairing of
//! irregular meshes using diffusion and curvature flow*, SIGGRAPH 1999), by which all shrinks the faster
//! the more it is curved.

mod filter;
mod laplacian;
mod volume;

use filter::Filter;
use glam::DVec3;
use laplacian::MeshLaplacian;
use simod_plugin_api::{
    Choice, Consumes, DeformInput, Deformer, Descriptor, Host, IsIdentity, ParamSet, PluginError,
    PluginResult, PrepareInput, Role,
};
use std::f64::consts::TAU;

/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 4096;
/// Length of waves, in distances between the samples, below which the samples tell next to nothing of them.
const SHORTEST: f64 = 3.0;

/// The plugin.
struct Smooth;

/// Parameters of the smoothing.
#[derive(ParamSet)]
struct SmoothSettings {
    /// Method; a filter keeps the size of what stays, the flow shrinks all, what is most curved first
    #[param(default = SmoothingMethod::Filter, invalidates_preparation)]
    method: SmoothingMethod,
    /// Length from crest to crest below which bumps go; of those as long, half is left (by the flow, a third)
    #[param(default = 0.05, unit = "diagonal", hard = f64::MIN_POSITIVE..=10.0, soft = 0.005..=0.5, invalidates_preparation)]
    size: f64,
    /// Amount of smoothing: 1 is all, 0 none, values below 0 make bumps stand out
    #[param(default = 1.0, hard = -10.0..=10.0, soft = -1.0..=1.0)]
    amount: f64,
    /// Number of steps of the flow, each by the curvature that the one before has left
    #[param(default = 4, hard = 1..=1000, soft = 1..=20, invalidates_preparation)]
    steps: i64,
    /// Gives a closed surface back what it has lost of its volume
    #[param(default = true, invalidates_preparation)]
    keep_volume: bool,
}

#[derive(Choice, Debug, Clone, Copy, PartialEq)]
enum SmoothingMethod {
    #[choice(id = "taubin", label = "Filter (Taubin)")]
    Filter,
    #[choice(id = "mean-curvature", label = "Mean curvature flow")]
    Flow,
}

/// Position of each sample at an amount of 1.
struct SmoothedSamples(Vec<DVec3>);

/// Freedom of each sample to move, 1 in general, and less by the weights of fixed regions, down to 0.
fn freedom(input: &PrepareInput<'_>) -> Vec<f64> {
    let mut freedom = vec![1.0; input.samples.positions().len()];
    for region in input.regions().iter().filter(|region| region.role == Role::FIXED) {
        freedom.iter_mut().zip(region.weights()).for_each(|(f, w)| *f *= 1.0 - f64::from(*w).clamp(0.0, 1.0));
    }
    freedom
}

/// Triangles between the samples whose corners exist and differ.
fn triangles(input: &PrepareInput<'_>) -> Vec<[u32; 3]> {
    let count = input.samples.positions().len() as u32;
    let is_right =
        |t: &&[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0] && t.iter().all(|c| *c < count);
    input.triangles().map_or(Vec::new(), |t| t.indices().iter().filter(is_right).copied().collect())
}

/// Square of a wave's number: an eigenvalue of the Laplacian. `size` is the length of the wave, as a part
/// of the diagonal.
fn wave(size: f64, diagonal: f64) -> f64 {
    (TAU / (size * diagonal)).powi(2)
}

/// Positions without waves that are shorter than `size`, by one filter of sharp edge.
fn filtered(
    positions: &[DVec3],
    laplacian: impl Fn(&[DVec3]) -> MeshLaplacian,
    size: f64,
    diagonal: f64,
    host: &Host<'_>,
) -> PluginResult<Vec<DVec3>> {
    let laplacian = laplacian(positions);
    let shortest = SHORTEST * 2.0 * laplacian.scale.sqrt() / diagonal;
    if size < shortest {
        host.warn(&format!(
            "the samples lie too far apart to tell bumps of {size} of the diagonal: from {shortest:.1e} on \
             they do; take more of them for finer ones"
        ));
    }
    let filter = Filter::low_pass((wave(size, diagonal) * laplacian.scale).min(1.0));
    if filter.degree() == filter::MOST {
        host.warn("bumps of that size are too large beside the finest triangles to be told apart sharply");
    }
    filter.apply(&laplacian, positions, host, |part| host.progress(part))
}

/// Positions after the flow by curvature, in steps that each have the Laplacian of the present positions.
/// Of a wave whose number has the square `wave`, a third is left in the end.
fn flowed(
    positions: &[DVec3],
    laplacian: impl Fn(&[DVec3]) -> MeshLaplacian,
    wave: f64,
    steps: i64,
    host: &Host<'_>,
) -> PluginResult<Vec<DVec3>> {
    let mut smoothed = positions.to_vec();
    for step in 0..steps {
        let laplacian = laplacian(&smoothed);
        let time = if laplacian.scale > 0.0 { 1.0 / (wave * laplacian.scale * steps as f64) } else { 0.0 };
        let progress = |part: f64| host.progress((step as f64 + part) / steps as f64);
        smoothed = Filter::flow(time).apply(&laplacian, &smoothed, host, progress)?;
    }
    Ok(smoothed)
}

/// Moves samples along their normals alone. Nothing tells where a surface of points alone ends: samples do
/// not go towards its middle.
fn keep_to_normals(smoothed: &mut [DVec3], positions: &[DVec3], normals: &[[f32; 3]]) {
    for ((new, p), n) in smoothed.iter_mut().zip(positions).zip(normals) {
        let n = DVec3::from(n.map(f64::from)).normalize_or_zero();
        if n != DVec3::ZERO {
            *new = *p + (*new - *p).dot(n) * n;
        }
    }
}

impl Deformer for Smooth {
    type State = SmoothedSamples;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("smooth", "Smooth", env!("CARGO_PKG_VERSION"))
            .summary("Takes away bumps up to some size, or makes them stand out")
            .citation(
                "G. Taubin, A Signal Processing Approach to Fair Surface Design, SIGGRAPH 1995; M. Desbrun, M. Meyer, \
                 P. Schröder, A. Barr, Implicit Fairing of Irregular Meshes Using Diffusion and Curvature Flow, \
                 SIGGRAPH 1999",
            )
            .param_set::<SmoothSettings>()
            .consumes(Consumes {
                fixed_regions: true,
                normals: true,
                graph: true,
                triangles: true,
                ..Consumes::default()
            })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<SmoothedSamples> {
        let places = input.samples.positions();
        if let Some(i) = places.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(PluginError::input(format!("sample {i} is at no finite place")));
        }
        let positions: Vec<DVec3> = places.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let graph = input.graph().filter(|graph| graph.len() == positions.len());
        let graph =
            graph.ok_or_else(|| PluginError::internal("the host gave no neighbours of the samples"))?;
        let triangles = triangles(input);
        let freedom = freedom(input);
        let SmoothSettings { method, size, steps, keep_volume, .. } = input.params().read()?;
        let diagonal = input.bounds.diagonal();
        let laplacian = |positions: &[DVec3]| MeshLaplacian::new(positions, &triangles, graph, &freedom);
        let mut smoothed = match method {
            SmoothingMethod::Filter => filtered(&positions, laplacian, size, diagonal, host)?,
            SmoothingMethod::Flow => flowed(&positions, laplacian, wave(size, diagonal), steps.max(1), host)?,
        };
        if triangles.is_empty() {
            keep_to_normals(&mut smoothed, &positions, input.samples.normals());
        }
        if keep_volume && volume::is_closed(&triangles) {
            volume::bring_back(&mut smoothed, &triangles, &freedom, volume::volume(&positions, &triangles));
        }
        Ok(SmoothedSamples(smoothed))
    }

    fn deform(
        SmoothedSamples(smoothed): &SmoothedSamples,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = input.samples.positions();
        if [rest.len(), out.len()] != [smoothed.len(); 2] {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let SmoothSettings { amount, .. } = input.params().read()?;
        host.parallel_blocks(out, BLOCK, |first, out| {
            for ((o, p), to) in out.iter_mut().zip(&rest[first..]).zip(&smoothed[first..]) {
                let from = DVec3::from(p.map(f64::from));
                *o = if *to == from { *p } else { (from + amount * (*to - from)).as_vec3().into() };
            }
        })
    }
}

impl IsIdentity for Smooth {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        let SmoothSettings { amount, .. } = input.params().read()?;
        Ok(amount == 0.0)
    }
}

simod_plugin_api::export_plugin!(Smooth, is_identity);

#[cfg(test)]
mod tests;
