//! The exported tables: the root module, which every plugin has, and the extensions.

use crate::{
    DeformInput, Descriptor, Extension, HandleDesc, Host, MigrationDesc, PluginError, PrepareInput, Scratch,
    Setting, State,
};
use abi_stable::{
    StableAbi,
    library::RootModule,
    package_version_strings,
    sabi_types::VersionStrings,
    std_types::{ROption, RResult, RSliceMut, RStr, RVec},
};

/// The functions that every plugin exports, frozen: a plugin's `export_plugin!` fills it in.
#[repr(C)]
#[derive(StableAbi)]
#[sabi(kind(Prefix(prefix_ref = PluginModRef, prefix_fields = PluginModPrefix)))]
#[sabi(missing_field(panic))]
pub struct PluginMod {
    /// [`Deformer::descriptor`](crate::Deformer::descriptor).
    pub descriptor: extern "C" fn() -> RResult<Descriptor, PluginError>,
    /// [`Deformer::prepare`](crate::Deformer::prepare).
    pub prepare: extern "C" fn(&PrepareInput<'_>, &Host<'_>) -> RResult<State, PluginError>,
    /// Working memory for a sequence of `deform` calls on states of this plugin.
    pub new_scratch: extern "C" fn() -> RResult<Scratch, PluginError>,
    /// [`Deformer::deform`](crate::Deformer::deform).
    pub deform: extern "C" fn(
        &State,
        &DeformInput<'_>,
        &mut Scratch,
        RSliceMut<'_, [f32; 3]>,
        &Host<'_>,
    ) -> RResult<(), PluginError>,
    /// A capability by id, or nothing where the plugin does not have it.
    #[sabi(last_prefix_field)]
    pub extension: extern "C" fn(RStr<'_>) -> ROption<Extension>,
}

impl RootModule for PluginModRef {
    abi_stable::declare_root_module_statics! {PluginModRef}
    const BASE_NAME: &'static str = "simod_plugin";
    const NAME: &'static str = "SIMOD plugin";
    const VERSION_STRINGS: VersionStrings = package_version_strings!();
}

/// The extension `simod.evaluate/1`: the deformation as a map of space.
#[repr(C)]
#[derive(StableAbi)]
pub struct EvaluateExtension {
    /// [`Evaluate::evaluate`](crate::Evaluate::evaluate).
    pub evaluate: extern "C" fn(
        &State,
        &DeformInput<'_>,
        RSliceMut<'_, [f64; 3]>,
        &Host<'_>,
    ) -> RResult<(), PluginError>,
}

/// The extension `simod.handles/1`: handles that the plugin itself places.
#[repr(C)]
#[derive(StableAbi)]
pub struct HandlesExtension {
    /// [`Handles::handles`](crate::Handles::handles).
    pub handles: extern "C" fn(&PrepareInput<'_>, &Host<'_>) -> RResult<RVec<HandleDesc>, PluginError>,
}

/// The extension `simod.handle-faces/1`: faces between the handles that the plugin places.
#[repr(C)]
#[derive(StableAbi)]
pub struct HandleFacesExtension {
    /// [`HandleFaces::handle_faces`](crate::HandleFaces::handle_faces).
    pub handle_faces: extern "C" fn(&PrepareInput<'_>, &Host<'_>) -> RResult<RVec<RVec<u32>>, PluginError>,
}

/// The extension `simod.is-identity/1`: whether there is anything to do at all.
#[repr(C)]
#[derive(StableAbi)]
pub struct IsIdentityExtension {
    /// [`IsIdentity::is_identity`](crate::IsIdentity::is_identity).
    pub is_identity: extern "C" fn(&DeformInput<'_>) -> RResult<bool, PluginError>,
}

/// The extension `simod.migration/1`: sessions that are older than the plugin.
#[repr(C)]
#[derive(StableAbi)]
pub struct MigrationExtension {
    /// [`Migrate::migration`](crate::Migrate::migration).
    pub migration: extern "C" fn() -> RResult<MigrationDesc, PluginError>,
    /// [`Migrate::migrate`](crate::Migrate::migrate): what a session of an older version gives, and what
    /// becomes of it.
    pub migrate: extern "C" fn(u32, RVec<Setting>) -> RResult<RVec<Setting>, PluginError>,
}
