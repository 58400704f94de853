//! Swells a model about a point, or pinches it: a deformation for SIMOD, to be changed into your own.
//!
//! SIMOD takes some thousands of samples of a model of any size, asks this library where they go, and carries the
//! whole model along. All coordinates here are local ones: the model's, shifted and scaled to a diagonal of 1 to 2.

#[cfg(test)]
mod tests;

use simod_plugin_api::*;

struct __TYPE__;

/// The map: a point at distance `r < radius` from the centre goes to `1 + strength · (1 - (r / radius)²)^falloff` times
/// that distance; all others stay exactly where they are.
fn bulge(params: Params<'_>, bounds: &Bounds) -> PluginResult<impl Fn([f64; 3]) -> [f64; 3]> {
    // The values are all there, and in their ranges: SIMOD has checked them against the descriptor.
    let (center, strength) = (params.vec3("center")?, params.float("strength")?);
    let falloff = params.float("falloff")?;
    // A fraction of the model's diagonal, so that the default suits a model of any size.
    let radius = params.float("radius")? * bounds.diagonal();
    Ok(move |p: [f64; 3]| {
        let d = [0, 1, 2].map(|i| p[i] - center[i]);
        let t = d.iter().map(|x| x * x).sum::<f64>() / radius.powi(2);
        let push = if t < 1.0 { strength * (1.0 - t).powf(falloff) } else { 0.0 };
        [0, 1, 2].map(|i| p[i] + push * d[i])
    })
}

impl Deformer for __TYPE__ {
    type State = (); // What `prepare` finds out for all calls of `deform`: here nothing,
    type Scratch = (); // and no memory to keep between them.

    /// What a user sees, and can choose.
    fn descriptor() -> Descriptor {
        let number = ParamDesc::float;
        Descriptor::new("__NAME__", "__TITLE__", env!("CARGO_PKG_VERSION"))
            .summary("Swells the model about a point, or pinches it")
            .param(ParamDesc::point("center", "Centre", [0.5; 3]).hint("What swells"))
            .param(number("radius", "Radius", 0.3).unit(Unit::DIAGONAL).hard(1e-6, 10.0).hint("Its reach"))
            .param(number("strength", "Strength", 0.5).hard(-1.0, 10.0).hint("Below 0 pinches"))
            .param(number("falloff", "Falloff", 2.0).hard(1.0, 8.0).hint("From 1 for wide to 8 for narrow"))
    }

    fn prepare(_: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
        Ok(())
    }

    /// Moves sample `i` to `out[i]`.
    fn deform(
        _: &(),
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        _: &Host<'_>,
    ) -> PluginResult<()> {
        let map = bulge(input.params(), &input.bounds)?;
        let images = input.samples.positions().iter().map(|p| map(p.map(f64::from)));
        out.iter_mut().zip(images).for_each(|(out, p)| *out = p.map(|x| x as f32));
        Ok(())
    }
}

/// The same map at any point, by which SIMOD measures its results. Not all deformations know it: this can be left out,
/// and `evaluate` below with it.
impl Evaluate for __TYPE__ {
    fn evaluate(_: &(), input: &DeformInput<'_>, points: &mut [[f64; 3]], _: &Host<'_>) -> PluginResult<()> {
        let map = bulge(input.params(), &input.bounds)?;
        points.iter_mut().for_each(|p| *p = map(*p));
        Ok(())
    }
}

simod_plugin_api::export_plugin!(__TYPE__, evaluate);
