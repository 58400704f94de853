//! The one crate that a SIMOD deformation plugin needs.
//!
//! A plugin is a dynamic library (`crate-type = ["cdylib"]`) that implements [`Deformer`] and exports it with
//! [`export_plugin!`]. The host hands it a few hundred thousand samples of a model, and it writes their
//! deformed positions into the host's buffer: as many as it got, in the same order. How the deformation
//! reaches the model's billions of vertices is none of its concern.
//!
//! A whole plugin:
//!
//! ```
//! use simod_plugin_api::*;
//!
//! /// Moves everything along a direction.
//! #[derive(ParamSet)]
//! struct Shift {
//!     /// How far it moves, and where to
//!     #[param(direction, default = [0.1, 0.0, 0.0])]
//!     direction: [f64; 3],
//!     /// So many times as far
//!     #[param(default = 1.0, soft = 0.0..=10.0)]
//!     times: f64,
//! }
//!
//! impl Shift {
//!     fn image(&self, p: [f64; 3]) -> [f64; 3] {
//!         [0, 1, 2].map(|i| p[i] + self.times * self.direction[i])
//!     }
//! }
//!
//! impl Deformer for Shift {
//!     type State = ();
//!     type Scratch = ();
//!
//!     fn descriptor() -> Descriptor {
//!         Descriptor::new("shift", "Shift", env!("CARGO_PKG_VERSION"))
//!             .summary("Moves everything along a direction")
//!             .param_set::<Self>()
//!     }
//!
//!     fn prepare(_: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
//!         Ok(())
//!     }
//!
//!     fn deform(
//!         _: &(), input: &DeformInput<'_>, _: &mut (), out: &mut [[f32; 3]], _: &Host<'_>,
//!     ) -> PluginResult<()> {
//!         let shift: Self = input.params().read()?;
//!         for (o, p) in out.iter_mut().zip(input.samples.positions()) {
//!             *o = shift.image(p.map(f64::from)).map(|x| x as f32);
//!         }
//!         Ok(())
//!     }
//! }
//!
//! impl Evaluate for Shift {
//!     fn evaluate(
//!         _: &(), input: &DeformInput<'_>, points: &mut [[f64; 3]], _: &Host<'_>,
//!     ) -> PluginResult<()> {
//!         let shift: Self = input.params().read()?;
//!         points.iter_mut().for_each(|p| *p = shift.image(*p));
//!         Ok(())
//!     }
//! }
//!
//! simod_plugin_api::export_plugin!(Shift, evaluate);
//! # fn main() {}
//! ```
//!
//! # Coordinates and units
//!
//! Everything a plugin sees is in *local* coordinates: the model's own, minus an origin and divided by a
//! scale that the host chose so that `f32` positions keep their digits and the model's diagonal lies between
//! 1 and 2. Axes are the model's, untouched. Points and lengths given as parameters ([`Unit::MODEL_LENGTH`])
//! and the handles' transforms are local as well. Indices are sample indices.
//!
//! # Threads, ownership, errors
//!
//! | call | thread | cost |
//! |---|---|---|
//! | [`Deformer::descriptor`] | any, at load | microseconds |
//! | [`Deformer::prepare`] | a worker; several instances at once | may take seconds; reports progress, obeys cancel |
//! | [`Deformer::deform`] | one at a time per scratch; several scratches of a state at once | interactive |
//! | [`Evaluate::evaluate`] | several threads at once on one state | nanoseconds to microseconds per point |
//! | [`Handles::handles`], [`HandleFaces::handle_faces`] | any | milliseconds |
//! | [`IsIdentity::is_identity`] | any | microseconds |
//! | [`Migrate::migrate`] | any | microseconds |
//!
//! All inputs are borrowed for the length of the call. A state is immutable and owned by the host until it is
//! dropped, as is a scratch. Failures are [`PluginError`]s; a panic is caught inside the plugin and becomes
//! one.
//!
//! # Evolution
//!
//! The root module and all types that cross the boundary are frozen with the first release: the loader
//! compares their layouts. What comes later is an extension, a frozen struct of its own, queried by a string
//! id: the plugin's by the host (`simod.evaluate/1`), the host's by the plugin ([`Host::extension`]), and
//! inputs beside positions, regions and parameters ([`Part`]), which a description names by their ids
//! ([`InputDesc`]). Ids are never used for anything else again. Those of third parties begin with a domain of
//! theirs (`org.vendor.thing/1`), those that may still change with `draft.` (`draft.simod.thing/1`): hosts
//! and plugins of different versions do not share these. Codes ([`ErrorCode`], [`ParamKind`], [`Unit`],
//! [`Role`], [`LogLevel`]) are numbers, not enums, since an enum with a value that one side does not know is
//! undefined behaviour; an unknown code is refused, politely.

pub mod c;
mod curve;
mod deformer;
mod descriptor;
mod error;
mod handles;
mod host;
mod input;
mod migration;
mod opaque;
mod param_set;
mod params;
mod parts;
mod root;
mod services;

pub use curve::Curve;
pub use deformer::{Deformer, Evaluate, HandleFaces, Handles, IsIdentity};
pub use descriptor::{Consumes, Descriptor, InputDesc};
pub use error::{ErrorCode, PluginError, PluginResult};
pub use handles::{Gizmo, HandleDesc};
pub use host::{HostCalls, LogLevel};
pub use input::{Affine, Bounds, DeformInput, PrepareInput, Region, Role, Samples};
pub use migration::{AliasDesc, Migrate, MigrationDesc, Setting, Settings};
pub use opaque::{Extension, ExtensionInterface, Host, Scratch, State};
pub use param_set::{Choice, ParamSet, ParamType, Ranged};
pub use params::{ChoiceDesc, Param, ParamDesc, ParamKind, Params, Unit};
pub use parts::{
    Attribute, AttributeKind, Attributes, Effort, Graph, HandleMotions, InputPart, Joint, Joints, ModelFrame,
    OtherModel, OtherModels, Part, PointsKind, RestPositions, Stroke, Strokes, Time, Triangles,
};
pub use plugin_api_derive::{Choice, ParamSet};
pub use root::{
    EvaluateExtension, HandleFacesExtension, HandlesExtension, IsIdentityExtension, MigrationExtension,
    PluginMod, PluginModRef,
};
pub use services::{Lookups, Nearest, NearestService, Pose, Surface, SurfacePoint, SurfaceService};

/// Items that the macros and the host need of the modules above and of `abi_stable`; not for plugins.
#[doc(hidden)]
pub mod __private {
    pub use crate::deformer::{capability, find_extension, no_extension, quiet_panics, root_module};
    pub use abi_stable;
}
