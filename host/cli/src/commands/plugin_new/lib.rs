//! Swells a model about a point, or pinches it: a deformation for SIMOD, to be changed into your own.
//!
//! SIMOD takes some thousands of samples of a model of any size, asks this library where they go, and carries
//! the whole model along. All coordinates here are local ones: the model's, shifted and scaled to a diagonal
//! of 1 to 2.

#[cfg(test)]
mod tests;

use simod_plugin_api::*;

/// Parameters: users see their names and hints. SIMOD checks the values, and completes them by the defaults.
/// A point's default is in fractions of the model's box.
#[derive(ParamSet)]
struct __TYPE__ {
    /// Centre of the swelling, until its handle is moved
    #[param(point, name = "Centre", default = [0.5; 3])]
    center: [f64; 3],
    /// Distance from the centre up to which points move
    ///
    /// It is a fraction of the model's diagonal, so that the default suits a model of any size.
    #[param(default = 0.3, unit = "diagonal", hard = 1e-6..=10.0)]
    radius: f64,
    /// Strength of the swelling; values below 0 pinch
    #[param(default = 0.5, hard = -1.0..=10.0)]
    strength: f64,
}

/// Push from the centre (left) to the rim (right): a curve that the user draws.
const PROFILE: [[f64; 2]; 5] = [[0.0, 1.0], [0.25, 0.88], [0.5, 0.56], [0.75, 0.19], [1.0, 0.0]];

/// The deformation, as parameters and the handle have it.
struct Bulge<'a> {
    center: [f64; 3],
    reach: f64,
    strength: f64,
    profile: Curve<'a>,
}

impl<'a> Bulge<'a> {
    fn read(input: &DeformInput<'a>) -> PluginResult<Self> {
        let __TYPE__ { center, radius, strength } = input.params().read()?;
        // The handle's motion moves the centre along.
        let center = input.handle_motions().first().map_or(center, |motion| motion.apply(center));
        let (reach, profile) = (radius * input.bounds.diagonal(), input.params().curve("profile")?);
        Ok(Self { center, reach, strength, profile })
    }

    /// The map: a point at distance `r < reach` from the centre goes to `1 + strength · profile(r / reach)`
    /// times that distance; all others stay exactly where they are.
    fn image(&self, p: [f64; 3]) -> [f64; 3] {
        let d = [0, 1, 2].map(|i| p[i] - self.center[i]);
        let t = d.iter().map(|x| x * x).sum::<f64>().sqrt() / self.reach;
        let push = if t < 1.0 { self.strength * self.profile.at(t) } else { 0.0 };
        [0, 1, 2].map(|i| p[i] + push * d[i])
    }
}

impl Deformer for __TYPE__ {
    type State = (); // Result of `prepare` for all calls of `deform`: here nothing,
    type Scratch = (); // and no memory to keep between them.

    fn descriptor() -> Descriptor {
        Descriptor::new("__NAME__", "__TITLE__", env!("CARGO_PKG_VERSION"))
            .summary("Swells the model about a point, or pinches it")
            .param_set::<Self>()
            .param(ParamDesc::curve("profile", "Profile", &PROFILE).hint("Push from the centre to the rim"))
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
        let bulge = Bulge::read(input)?;
        for (out, p) in out.iter_mut().zip(input.samples.positions()) {
            *out = bulge.image(p.map(f64::from)).map(|x| x as f32);
        }
        Ok(())
    }
}

/// The same map at any point, by which SIMOD measures its results. It can be left out, with `evaluate` below.
impl Evaluate for __TYPE__ {
    fn evaluate(_: &(), input: &DeformInput<'_>, points: &mut [[f64; 3]], _: &Host<'_>) -> PluginResult<()> {
        let bulge = Bulge::read(input)?;
        points.iter_mut().for_each(|p| *p = bulge.image(*p));
        Ok(())
    }
}

/// Handles that a user can grab: here the centre.
impl Handles for __TYPE__ {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        let this: Self = input.params().read()?;
        Ok(vec![HandleDesc::new("center", this.center).name("Centre").gizmo(Gizmo::TRANSLATE)])
    }
}

/// Whether there is nothing to do: samples move though no handle does, unless there is no strength.
impl IsIdentity for __TYPE__ {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(Bulge::read(input)?.strength == 0.0)
    }
}

simod_plugin_api::export_plugin!(__TYPE__, evaluate, handles, is_identity);
