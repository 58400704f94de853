//! Rings about an axis, as on a pond that a drop fell into.

use simod_plugin_api::*;

/// Moves a point at distance `r` from the axis by `amplitude · cos(2π r / wavelength)` along it. Lengths are
/// fractions of the model's diagonal, so that the defaults suit a model of any size.
#[derive(ParamSet)]
struct Ripple {
    /// Height of the rings
    #[param(default = 0.02, unit = "diagonal")]
    amplitude: f64,
    /// Distance from ring to ring
    #[param(default = 0.1, unit = "diagonal", hard = 1e-6..=1e6)]
    wavelength: f64,
    /// Place where the drop fell
    #[param(point, name = "Centre", default = [0.5; 3])]
    center: [f64; 3],
    /// Direction that is up
    #[param(direction, default = [0.0, 1.0, 0.0])]
    axis: [f64; 3],
}

impl Ripple {
    /// As the user wants it, with an axis of unit length, and lengths in local coordinates.
    fn new(params: Params<'_>, bounds: &Bounds) -> PluginResult<Self> {
        let mut this: Self = params.read()?;
        let length = this.axis.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length == 0.0 {
            return Err(PluginError::parameter("axis", "is zero").hint("give a direction, such as [0, 1, 0]"));
        }
        this.axis = this.axis.map(|x| x / length);
        this.amplitude *= bounds.diagonal();
        this.wavelength *= bounds.diagonal();
        Ok(this)
    }

    fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let d = [0, 1, 2].map(|i| p[i] - self.center[i]);
        let r = (dot(d, d) - dot(d, self.axis).powi(2)).max(0.0).sqrt();
        let up = self.amplitude * (std::f64::consts::TAU * r / self.wavelength).cos();
        [0, 1, 2].map(|i| p[i] + up * self.axis[i])
    }
}

impl Deformer for Ripple {
    type State = (); // Nothing is worth preparing,
    type Scratch = (); // nor keeping.

    fn descriptor() -> Descriptor {
        Descriptor::new("ripple", "Ripple", env!("CARGO_PKG_VERSION"))
            .summary("Rings about an axis, as on a pond")
            .param_set::<Self>()
    }

    fn prepare(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
        Self::new(input.params(), &input.bounds).map(drop)
    }

    fn deform(
        _: &(),
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        _: &Host<'_>,
    ) -> PluginResult<()> {
        let ripple = Self::new(input.params(), &input.bounds)?;
        let images = input.samples.positions().iter().map(|p| ripple.apply(p.map(f64::from)));
        out.iter_mut().zip(images).for_each(|(out, p)| *out = p.map(|x| x as f32));
        Ok(())
    }
}

/// The same map at any point of space: what the host measures results against.
impl Evaluate for Ripple {
    fn evaluate(_: &(), input: &DeformInput<'_>, points: &mut [[f64; 3]], _: &Host<'_>) -> PluginResult<()> {
        let ripple = Self::new(input.params(), &input.bounds)?;
        points.iter_mut().for_each(|p| *p = ripple.apply(*p));
        Ok(())
    }
}

simod_plugin_api::export_plugin!(Ripple, evaluate);
