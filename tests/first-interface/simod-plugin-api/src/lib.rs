//! The plugin interface as it was first released, frozen: what was built with it keeps loading.
//!
//! A copy of `plugin-api/src` at version 1.0.0 without tests and derives. Never change it.

mod curve;
mod deformer;
mod descriptor;
mod error;
mod handles;
mod host;
mod input;
mod opaque;
mod params;
mod parts;
mod root;

pub use curve::Curve;
pub use deformer::{Deformer, Evaluate, Handles, IsIdentity};
pub use descriptor::{Consumes, Descriptor, InputDesc};
pub use error::{ErrorCode, PluginError, PluginResult};
pub use handles::{Gizmo, HandleDesc};
pub use host::{HostCalls, LogLevel};
pub use input::{Affine, Bounds, DeformInput, PrepareInput, Region, Role, Samples};
pub use opaque::{Extension, ExtensionInterface, Host, Scratch, State};
pub use params::{ChoiceDesc, Param, ParamDesc, ParamKind, Params, Unit};
pub use parts::{Graph, HandleMotions, InputPart, Joint, Joints, Part, Stroke, Strokes, Triangles};
pub use root::{EvaluateExtension, HandlesExtension, IsIdentityExtension, PluginMod, PluginModRef};

/// What the macros and the host need of the crates below; not for plugins.
#[doc(hidden)]
pub mod __private {
    pub use crate::deformer::{capability, find_extension, no_extension, quiet_panics, root_module};
    pub use abi_stable;
}
