//! Blend shapes: targets are deformed versions of the samples, and each is added by an amount.
//!
//! F. Parke, *Computer generated animation of faces*, ACM annual conference 1972; J. P. Lewis and others,
//! *Practice and theory of blendshape facial models*, Eurographics 2014 (delta blendshapes, section 2): a
//! sample goes to `p + Σ wᵢ (tᵢ - p₀)`, where `p₀` is its position before all steps. Targets are matched by
//! the samples' ids.

use glam::DVec3;
use simod_plugin_api::{
    Consumes, DeformInput, Deformer, Descriptor, Host, IsIdentity, OtherModel, ParamDesc, Params,
    PluginError, PluginResult, PointsKind, PrepareInput,
};

/// Number of targets of a step; a further step has as many again.
const TARGETS: usize = 8;
/// Number of samples at once on one thread.
const BLOCK: usize = 4096;
/// Distance below which a target does not move a sample, as a part of the diagonal: files have coordinates
/// in single precision.
const STILL: f64 = 1e-6;

/// Distance of a target from the samples beyond which it is a mistake, in local coordinates, whose unit is
/// about the model's size.
const FAR: f64 = 1e3;

/// The plugin.
struct Blendshapes;

/// Displacement of each sample by each target: 12 bytes for each sample and target.
struct TargetDisplacements {
    count: usize,
    targets: Vec<(usize, Vec<[f32; 3]>)>,
}

fn target(number: usize) -> String {
    format!("target-{number}")
}

fn amount(number: usize) -> String {
    format!("amount-{number}")
}

impl Deformer for Blendshapes {
    type State = TargetDisplacements;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        let mut descriptor = Descriptor::new("blendshapes", "Blend shapes", env!("CARGO_PKG_VERSION"))
            .summary("Adds up what other deformations of the samples do, each by an amount")
            .citation("J. P. Lewis, K. Anjyo, T. Rhee, M. Zhang, F. Pighin, Z. Deng, Practice and Theory of Blendshape Facial Models, Eurographics 2014");
        for number in 1..=TARGETS {
            let (id, name) = (target(number), format!("Target {number}"));
            descriptor = descriptor
                .param(
                    ParamDesc::model(&id, &name, 1)
                        .hint("Samples as something has deformed them: a file with their ids, as `simod deform` writes it"),
                )
                .param(
                    ParamDesc::float(&amount(number), &format!("Amount {number}"), 1.0)
                        .hard(-10.0, 10.0)
                        .soft(0.0, 1.0)
                        .hint("Amount of the target that is added: 1 is all, values below 0 take it away, those above 1 exaggerate"),
                );
        }
        descriptor.consumes(Consumes { rest_positions: true, ..Consumes::default() })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<TargetDisplacements> {
        let samples = input.samples.positions();
        let rest = input.rest_positions().filter(|rest| rest.len() == samples.len()).unwrap_or(samples);
        let mut targets = Vec::new();
        for number in 1..=TARGETS {
            host.progress((number - 1) as f64 / TARGETS as f64)?;
            let id = target(number);
            if let Some(model) = input.other_model(&id) {
                targets
                    .push((number, displacements(&id, model, rest, STILL * input.bounds.diagonal(), host)?));
            }
        }
        Ok(TargetDisplacements { count: samples.len(), targets })
    }

    fn deform(
        state: &TargetDisplacements,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let samples = input.samples.positions();
        if [samples.len(), out.len()] != [state.count; 2] {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let mut terms = Vec::new();
        for (number, by) in &state.targets {
            let amount = input.params().float(&amount(*number))?;
            if amount != 0.0 {
                terms.push((amount, by));
            }
        }
        host.parallel_blocks(out, BLOCK, |first, out| {
            for (i, o) in (first..).zip(out) {
                let by: DVec3 =
                    terms.iter().map(|(amount, by)| *amount * DVec3::from(by[i].map(f64::from))).sum();
                let from = samples[i];
                *o = if by == DVec3::ZERO {
                    from
                } else {
                    (DVec3::from(from.map(f64::from)) + by).as_vec3().into()
                };
            }
        })
    }
}

/// Displacement of each sample by a target; samples that the target does not have are not moved.
fn displacements(
    id: &str,
    model: &OtherModel<'_>,
    rest: &[[f32; 3]],
    still: f64,
    host: &Host<'_>,
) -> PluginResult<Vec<[f32; 3]>> {
    if model.kind != PointsKind::SAMPLES || model.ids().len() != model.positions().len() {
        return Err(PluginError::parameter(id, "is no deformed samples: its points have no ids to know them by")
            .hint("give a PLY file as `simod deform` writes it, or `samples.ply` as another program has deformed it, with its ids"));
    }
    let mut by = vec![[0.0; 3]; rest.len()];
    for (sample, to) in model.ids().iter().zip(model.positions()) {
        let index = usize::try_from(*sample).ok().filter(|i| *i < rest.len());
        let Some(index) = index else {
            let what =
                format!("is of another sampling: it has a sample {sample}, and the model {}", rest.len());
            return Err(PluginError::parameter(id, &what)
                .hint("deform the samples of this model and this number, and give what comes out"));
        };
        let moved = DVec3::from(*to) - DVec3::from(rest[index].map(f64::from));
        if moved.length().is_nan() || moved.length() > FAR {
            return Err(PluginError::parameter(id, &format!("lies far away, at sample {sample}"))
                .hint("give a target in the model's own unit and coordinates"));
        }
        if moved.length() > still {
            by[index] = moved.as_vec3().into();
        }
    }
    let missing = rest.len() - model.ids().len().min(rest.len());
    if missing > 0 {
        host.warn(&format!(
            "{missing} of {} samples are not in `{id}`, which does not move them",
            rest.len()
        ));
    }
    Ok(by)
}

/// Whether no given target has an amount other than 0.
fn is_still(params: Params<'_>) -> PluginResult<bool> {
    for number in 1..=TARGETS {
        if params.model(&target(number))?.is_some() && params.float(&amount(number))? != 0.0 {
            return Ok(false);
        }
    }
    Ok(true)
}

impl IsIdentity for Blendshapes {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        is_still(input.params())
    }
}

simod_plugin_api::export_plugin!(Blendshapes, is_identity);

#[cfg(test)]
mod tests;
