//! Code of a plugin, in this process or another, as the plugin answers: nothing is checked yet.

use super::about::{Capabilities, Migration};
use simod_plugin_api::{
    DeformInput, Descriptor, EvaluateExtension, ExtensionInterface, HandleDesc, HandleFacesExtension,
    HandlesExtension, Host, HostCalls, IsIdentityExtension, MigrationExtension, PluginModRef, PluginResult,
    PrepareInput, Scratch, Setting, State,
};

/// The handles that a plugin places.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OwnHandles {
    /// Descriptions of the handles: their places at rest, local coordinates, and the ways in which they may
    /// be moved.
    pub descs: Vec<HandleDesc>,
    /// Faces between the handles, each with its corners as indices of handles; none where the plugin knows of
    /// no surface.
    pub faces: Vec<Vec<u32>>,
}

/// Calls of the plugin interface. Calls that a plugin does not support, as
/// [`capabilities`](Self::capabilities) tell, are not made.
pub trait Code: Send + Sync {
    /// Returns the plugin's description of itself.
    fn descriptor(&self) -> PluginResult<Descriptor>;

    /// The code's capabilities.
    fn capabilities(&self) -> Capabilities;

    /// Returns the plugin's description of its older sessions, if it has one.
    fn migration(&self) -> PluginResult<Option<Migration>>;

    /// Whether the plugin runs in another process.
    fn is_isolated(&self) -> bool {
        false
    }

    /// Loads the library where that is done late, so that the calls which nobody can stop need not wait for
    /// it.
    fn get_ready(&self, calls: &dyn HostCalls) -> PluginResult<()> {
        let _ = calls;
        Ok(())
    }

    /// See [`Deformer::prepare`](simod_plugin_api::Deformer::prepare).
    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State>;

    /// Working memory for a sequence of deformations.
    fn new_scratch(&self) -> PluginResult<Scratch>;

    /// See [`Deformer::deform`](simod_plugin_api::Deformer::deform).
    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()>;

    /// See [`Evaluate::evaluate`](simod_plugin_api::Evaluate::evaluate).
    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()>;

    /// See [`Handles::handles`](simod_plugin_api::Handles::handles), and
    /// [`HandleFaces::handle_faces`](simod_plugin_api::HandleFaces::handle_faces), which not all have.
    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles>;

    /// See [`IsIdentity::is_identity`](simod_plugin_api::IsIdentity::is_identity).
    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool>;

    /// See [`Migrate::migrate`](simod_plugin_api::Migrate::migrate).
    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>>;
}

/// The code of a plugin that was built with the interface's crate, in this process. A call costs some
/// nanoseconds.
pub(crate) struct RustCode {
    module: PluginModRef,
    evaluate: Option<&'static EvaluateExtension>,
    handles: Option<&'static HandlesExtension>,
    handle_faces: Option<&'static HandleFacesExtension>,
    is_identity: Option<&'static IsIdentityExtension>,
    migration: Option<&'static MigrationExtension>,
}

impl RustCode {
    /// Functions of a library's root module, and of its extensions.
    pub fn new(module: PluginModRef) -> Self {
        fn extension<T: ExtensionInterface>(module: PluginModRef) -> Option<&'static T> {
            module.extension()(T::ID.into()).into_option().and_then(|e| e.get())
        }
        Self {
            module,
            evaluate: extension(module),
            handles: extension(module),
            handle_faces: extension(module),
            is_identity: extension(module),
            migration: extension(module),
        }
    }
}

/// Reason for which a call expects the plugin to have it: calls that are not offered are not made.
const OFFERED: &str = "the plugin offers it";

impl Code for RustCode {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        self.module.descriptor()().into_result()
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities {
            evaluate: self.evaluate.is_some(),
            handles: self.handles.is_some(),
            is_identity: self.is_identity.is_some(),
        }
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        self.migration.map(|m| (m.migration)().into_result().map(Migration::from)).transpose()
    }

    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State> {
        self.module.prepare()(input, &Host::new(&calls)).into_result()
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        self.module.new_scratch()().into_result()
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        self.module.deform()(state, input, scratch, out.into(), &Host::new(&calls)).into_result()
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let evaluate = self.evaluate.expect(OFFERED).evaluate;
        evaluate(state, input, points.into(), &Host::new(&calls)).into_result()
    }

    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        let host = Host::new(&calls);
        let descs = (self.handles.expect(OFFERED).handles)(input, &host).into_result()?;
        let faces = self.handle_faces.map(|e| (e.handle_faces)(input, &host).into_result()).transpose()?;
        let faces = faces.unwrap_or_default().into_iter().map(Into::into).collect();
        Ok(OwnHandles { descs: descs.into(), faces })
    }

    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool> {
        (self.is_identity.expect(OFFERED).is_identity)(input).into_result()
    }

    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        let migrate = self.migration.expect(OFFERED).migrate;
        migrate(from, settings.into()).into_result().map(Into::into)
    }
}
