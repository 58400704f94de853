//! Parameters as a struct: described and read together, so that ids, kinds and defaults stand in one place.

use crate::{Descriptor, ParamDesc, Params, PluginError, PluginResult};

/// A plugin's parameters as the fields of a struct. Derived:
///
/// ```
/// use simod_plugin_api::{Choice, Descriptor, ParamSet};
///
/// #[derive(ParamSet)]
/// struct Swirl {
///     /// Turned at the end of the range
///     #[param(default = 90.0, unit = "degrees", soft = -360.0..=360.0)]
///     angle: f64,
///     /// A point on the axis
///     #[param(point, name = "Centre", default = [0.5; 3])]
///     center: [f64; 3],
///     /// How often it turns back
///     #[param(default = 3, hard = 1.., soft = 1..=20, group = "Details", invalidates_preparation)]
///     turns: i64,
///     /// How the angle grows along the axis
///     #[param(default = Growth::Linear)]
///     growth: Growth,
/// }
///
/// #[derive(Choice, Clone, Copy)]
/// enum Growth {
///     Linear,
///     #[choice(id = "smooth", label = "Smooth (no kink at the ends)")]
///     Smoothstep,
/// }
///
/// let descriptor = Descriptor::new("swirl", "Swirl", "1.0.0").param_set::<Swirl>();
/// assert_eq!(descriptor.params[0].hint, "Turned at the end of the range");
/// ```
///
/// and in the plugin's calls: `let Swirl { angle, .. } = input.params().read()?`.
///
/// The type tells the kind: `f64`, `i64`, `bool`, or an enum that is a [`Choice`]; for `[f64; 3]` it is one
/// of the words `point` and `direction`, and `[f64; 4]` is a `colour`. Curves and files are described by
/// hand, with [`Descriptor::param`]. The documentation's first paragraph is the hint. What else can stand in
/// `#[param(…)]`, of which only the default must:
///
/// | word | of [`ParamDesc`] |
/// |---|---|
/// | `default = 90.0` | of the field's type; for a point in fractions of the model's box |
/// | `point`, `direction`, `colour` | the kind of a `[f64; 3]`, or a `[f64; 4]` |
/// | `name = "…"` | what the user reads; or else the field's name in words |
/// | `unit = "degrees"` | a constant of [`Unit`](crate::Unit) in kebab-case |
/// | `hard = 0.0..=1.0` | values outside are refused; `0.0..` and `..=1.0` have one end |
/// | `soft = 0.0..=1.0` | what a slider shows |
/// | `group = "…"` | shown together with others of the group |
/// | `invalidates_preparation` | `prepare` depends on it |
/// | `hint = "…"` | or else the documentation's first paragraph |
/// | `id = "…"` | or else the field's name in kebab-case; stored in files, so that a renamed field has to keep it |
pub trait ParamSet: Sized {
    /// The parameters, in the order to show them.
    fn describe() -> Vec<ParamDesc>;

    /// The values of the parameters.
    ///
    /// # Errors
    /// Where the host gave others than were described: a bug of the host.
    fn read(params: &Params<'_>) -> PluginResult<Self>;
}

impl Descriptor {
    /// All parameters of a struct, after those so far.
    #[must_use]
    pub fn param_set<T: ParamSet>(mut self) -> Self {
        self.params.extend(T::describe());
        self
    }
}

impl Params<'_> {
    /// The values of a struct's parameters.
    pub fn read<T: ParamSet>(&self) -> PluginResult<T> {
        T::read(self)
    }
}

/// A type that tells a parameter's kind. Where it does not, a word has to:
///
/// ```compile_fail
/// # use simod_plugin_api::ParamSet;
/// #[derive(ParamSet)]
/// struct Place {
///     #[param(default = [0.5; 3])] // error: a parameter cannot be of type `[f64; 3]` … `#[param(point)]` …
///     center: [f64; 3],
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "a parameter cannot be of type `{Self}`",
    label = "of no parameter's kind",
    note = "a parameter is a `f64`, `i64`, `bool`, a `[f64; 3]` with `#[param(point)]` or `#[param(direction)]`, a `[f64; 4]` with \
            `#[param(colour)]`, or an enum with `#[derive(Choice, Clone, Copy)]`"
)]
pub trait ParamType: Sized {
    /// A parameter of this type, without a unit, a range and the rest.
    fn describe(id: &str, name: &str, default: Self) -> ParamDesc;

    /// The value of a parameter of this type.
    fn read(params: &Params<'_>, id: &str) -> PluginResult<Self>;
}

/// A type of numbers, which may have a range; others may not:
///
/// ```compile_fail
/// # use simod_plugin_api::ParamSet;
/// #[derive(ParamSet)]
/// struct Place {
///     #[param(point, default = [0.5; 3], hard = 0.0..=1.0)]
///     center: [f64; 3],
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "a parameter of type `{Self}` has no range",
    note = "parameters with `hard` or `soft` are of type `f64` or `i64`"
)]
pub trait Ranged: ParamType {
    /// An end of a range.
    fn bound(self) -> f64;
}

impl ParamType for f64 {
    fn describe(id: &str, name: &str, default: Self) -> ParamDesc {
        ParamDesc::float(id, name, default)
    }

    fn read(params: &Params<'_>, id: &str) -> PluginResult<Self> {
        params.float(id)
    }
}

impl Ranged for f64 {
    fn bound(self) -> f64 {
        self
    }
}

impl ParamType for i64 {
    fn describe(id: &str, name: &str, default: Self) -> ParamDesc {
        ParamDesc::int(id, name, default)
    }

    fn read(params: &Params<'_>, id: &str) -> PluginResult<Self> {
        params.int(id)
    }
}

impl Ranged for i64 {
    fn bound(self) -> f64 {
        self as f64
    }
}

impl ParamType for bool {
    fn describe(id: &str, name: &str, default: Self) -> ParamDesc {
        ParamDesc::bool(id, name, default)
    }

    fn read(params: &Params<'_>, id: &str) -> PluginResult<Self> {
        params.bool(id)
    }
}

impl<T: Choice> ParamType for T {
    fn describe(id: &str, name: &str, default: Self) -> ParamDesc {
        let choices: Vec<(&str, &str)> = T::ALL.iter().map(|c| (c.id(), c.label())).collect();
        ParamDesc::choice(id, name, default.id(), &choices)
    }

    fn read(params: &Params<'_>, id: &str) -> PluginResult<Self> {
        let chosen = params.choice(id)?;
        T::ALL.iter().copied().find(|c| c.id() == chosen).ok_or_else(|| {
            let ids: Vec<&str> = T::ALL.iter().map(Choice::id).collect();
            PluginError::parameter(id, &format!("is unknown: {chosen}"))
                .hint(format!("use one of {}", ids.join(", ")))
        })
    }
}

/// The alternatives of a parameter. Derived for an enum without fields: ids are the variants' names in
/// kebab-case, and labels the same in words, unless `#[choice(id = "…", label = "…")]` says otherwise.
pub trait Choice: Copy + 'static {
    /// All, in the order to show them.
    const ALL: &'static [Self];

    /// Stable id, kebab-case; stored in files.
    fn id(&self) -> &'static str;

    /// Label for the user.
    fn label(&self) -> &'static str;
}
