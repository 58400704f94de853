//! Swells a model about a point, or pinches it: a deformation for SIMOD, to be changed into your own.
//!
//! SIMOD takes some thousands of samples of a model of any size, asks this library where they go, and carries the
//! whole model along. All coordinates here are local ones: the model's, shifted and scaled to a diagonal of 1 to 2.

#[cfg(test)]
mod tests;

use simod_plugin_api::*;

/// The deformation with all that a user can choose: names and hints are what they see. SIMOD checks the values, and
/// completes them by the defaults. A point's default is in fractions of the model's box.
#[derive(ParamSet)]
struct __TYPE__ {
    /// What swells
    #[param(point, name = "Centre", default = [0.5; 3])]
    center: [f64; 3],
    /// Its reach: a fraction of the model's diagonal, so that the default suits a model of any size
    #[param(default = 0.3, unit = "diagonal", hard = 1e-6..=10.0)]
    radius: f64,
    /// Below 0 pinches
    #[param(default = 0.5, hard = -1.0..=10.0)]
    strength: f64,
    /// From 1 for wide to 8 for narrow
    #[param(default = 2.0, hard = 1.0..=8.0)]
    falloff: f64,
}

impl __TYPE__ {
    /// The map: a point at distance `r < radius` from the centre goes to `1 + strength · (1 - (r / radius)²)^falloff`
    /// times that distance; all others stay exactly where they are.
    fn image(&self, p: [f64; 3], bounds: &Bounds) -> [f64; 3] {
        let d = [0, 1, 2].map(|i| p[i] - self.center[i]);
        let t = d.iter().map(|x| x * x).sum::<f64>() / (self.radius * bounds.diagonal()).powi(2);
        let push = if t < 1.0 { self.strength * (1.0 - t).powf(self.falloff) } else { 0.0 };
        [0, 1, 2].map(|i| p[i] + push * d[i])
    }
}

impl Deformer for __TYPE__ {
    type State = (); // What `prepare` finds out for all calls of `deform`: here nothing,
    type Scratch = (); // and no memory to keep between them.

    fn descriptor() -> Descriptor {
        Descriptor::new("__NAME__", "__TITLE__", env!("CARGO_PKG_VERSION"))
            .summary("Swells the model about a point, or pinches it")
            .param_set::<Self>()
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
        let this: Self = input.params().read()?;
        for (out, p) in out.iter_mut().zip(input.samples.positions()) {
            *out = this.image(p.map(f64::from), &input.bounds).map(|x| x as f32);
        }
        Ok(())
    }
}

/// The same map at any point, by which SIMOD measures its results. It can be left out, with `evaluate` below.
impl Evaluate for __TYPE__ {
    fn evaluate(_: &(), input: &DeformInput<'_>, points: &mut [[f64; 3]], _: &Host<'_>) -> PluginResult<()> {
        let this: Self = input.params().read()?;
        points.iter_mut().for_each(|p| *p = this.image(*p, &input.bounds));
        Ok(())
    }
}

simod_plugin_api::export_plugin!(__TYPE__, evaluate);
