//! The code of a plugin in C, in this process: what `simod_plugin.h` says, from the host's side.
//!
//! Nothing that a plugin gives is trusted as far as it can be looked at: pointers may be NULL or misaligned,
//! counts absurd, text without an end or not UTF-8. Whether a function pointer is one, and whether the
//! function keeps to the memory that it may touch, cannot be checked; a user who does not trust a plugin has
//! it run in a process of its own.

mod describe;
mod give;
mod listen;
mod read;

use super::{Capabilities, Code, Migration, OwnHandles, cannot_load, limits, line};
use give::{with_deform_input, with_prepare_input, with_settings};
use libloading::Library;
use simod_model::{Error, Result};
use simod_plugin_api::c::{
    SIMOD_INTERFACE_MAJOR, SIMOD_INTERFACE_MINOR, SIMOD_OK, SimodDeformInput, SimodEvaluate, SimodFaceList,
    SimodHandleDesc, SimodHandleFaces, SimodHandleList, SimodHandles, SimodHost, SimodIsIdentity,
    SimodMigration, SimodParam, SimodPlugin, SimodPrepareInput, SimodSettingList,
};
use simod_plugin_api::{
    DeformInput, Descriptor, HandleDesc, HostCalls, PluginError, PluginResult, PrepareInput, Scratch,
    Setting, State,
};
use std::error::Error as _;
use std::ffi::{CStr, c_void};
use std::mem::offset_of;
use std::path::Path;

/// The name of the exported table.
const ENTRY: &CStr = c"simod_plugin_entry";

type EvaluateFunction = unsafe extern "C" fn(
    *const c_void,
    *const SimodDeformInput,
    *mut [f64; 3],
    usize,
    *const SimodHost,
) -> u32;
type HandlesFunction =
    unsafe extern "C" fn(*const SimodPrepareInput, *mut SimodHandleList, *const SimodHost) -> u32;
type HandleFacesFunction =
    unsafe extern "C" fn(*const SimodPrepareInput, *mut SimodFaceList, *const SimodHost) -> u32;
type MigrateFunction =
    unsafe extern "C" fn(u32, *const SimodParam, usize, *mut SimodSettingList, *const SimodHost) -> u32;
type IsIdentityFunction = unsafe extern "C" fn(*const SimodDeformInput) -> u8;

/// Functions of a plugin in C. A call costs the time to put the input into other words: parameters, regions
/// and strokes; no samples are copied.
pub(crate) struct CCode {
    describe: unsafe extern "C" fn() -> *const simod_plugin_api::c::SimodDescriptor,
    deform: unsafe extern "C" fn(
        *const c_void,
        *const SimodDeformInput,
        *mut c_void,
        *mut [f32; 3],
        *const SimodHost,
    ) -> u32,
    evaluate: Option<EvaluateFunction>,
    handles: Option<HandlesFunction>,
    handle_faces: Option<HandleFacesFunction>,
    is_identity: Option<IsIdentityFunction>,
    migration: Option<(Migration, Option<MigrateFunction>)>,
    /// The table of all functions, some of which may be missing.
    plugin: SimodPlugin,
}

/// A plugin's state; freed by the plugin.
struct CState {
    data: *mut c_void,
    free: Option<unsafe extern "C" fn(*mut c_void)>,
}

// SAFETY: the header says that several threads use a state at once, and that any of them may free it.
unsafe impl Send for CState {}
// SAFETY: as above.
unsafe impl Sync for CState {}

/// A plugin's working memory; freed by the plugin.
struct CScratch(CState);

impl Drop for CState {
    fn drop(&mut self) {
        if let Some(free) = self.free.filter(|_| !self.data.is_null()) {
            // SAFETY: the plugin gave the pointer along with this function, and nothing uses it any more.
            unsafe { free(self.data) };
        }
    }
}

/// Loads a library, for good, with all functions that it needs of others: a missing one is an error here, and
/// not the end of the process when it is first called. `file` is that at `path`, or a copy of it.
pub(crate) fn load_whole(file: &Path, path: &Path) -> Result<Library> {
    // SAFETY: initialisers of the library run, and may do anything. Whoever puts a library into a plugin
    // folder wants its code to run.
    #[cfg(unix)]
    let library = unsafe {
        use libloading::os::unix;
        unix::Library::open(Some(file), unix::RTLD_NOW | unix::RTLD_LOCAL).map(Library::from)
    };
    // SAFETY: as above; this system looks for all functions anyway.
    #[cfg(not(unix))]
    let library = unsafe { Library::new(file) };
    library.map_err(|e| {
        let reason = e.source().map_or_else(|| e.to_string(), ToString::to_string);
        let reason = reason.replace(&*file.display().to_string(), &path.display().to_string());
        cannot_load(path, &reason)
    })
}

impl CCode {
    /// Loads a library that is known to have the table, for good: from `file`, which is that at `path`, or a
    /// copy of it.
    pub fn load(file: &Path, path: &Path) -> Result<Self> {
        let library = load_whole(file, path)?;
        // Never unloaded: states and descriptions point into it.
        let library = Box::leak(Box::new(library));
        // SAFETY: the symbol's address is taken, whatever is there.
        let table = unsafe { library.get::<*const SimodPlugin>(ENTRY) };
        let table = table.map_err(|e| cannot_load(path, &e.to_string()))?;
        // SAFETY: the header says that this is what has the name, and the library stays loaded.
        unsafe { Self::new(*table, path) }
    }

    /// The functions of a table.
    ///
    /// # Safety
    /// What the pointer points to, if it is good, begins like a `SimodPlugin` as far as its version says so,
    /// and stays.
    unsafe fn new(table: *const SimodPlugin, path: &Path) -> Result<Self> {
        let bug = crate::deformer::TELL_AUTHOR;
        // SAFETY: by the contract.
        let plugin = unsafe { read_table(table) }
            .map_err(|(what, hint)| Error::plugin(format!("{}: {what}", path.display()), hint))?;
        let (Some(describe), Some(deform)) = (plugin.describe, plugin.deform) else {
            let what = format!("{}: its table lacks `describe` or `deform`", path.display());
            return Err(Error::plugin(what, bug));
        };
        let missing = |id: &CStr| {
            let what = format!("it offers {} without the function", id.to_string_lossy());
            Error::plugin(format!("{}: {what}", path.display()), bug)
        };
        // SAFETY: the header says which struct has which id.
        let (evaluate, handles, handle_faces, is_identity, migration) = unsafe {
            (
                extension::<SimodEvaluate>(&plugin, c"simod.evaluate/1"),
                extension::<SimodHandles>(&plugin, c"simod.handles/1"),
                extension::<SimodHandleFaces>(&plugin, c"simod.handle-faces/1"),
                extension::<SimodIsIdentity>(&plugin, c"simod.is-identity/1"),
                extension::<SimodMigration>(&plugin, c"simod.migration/1")
                    .map(|m| Ok((describe::migration(&m)?, m.migrate))),
            )
        };
        Ok(Self {
            evaluate: evaluate.map(|e| e.evaluate.ok_or_else(|| missing(c"simod.evaluate/1"))).transpose()?,
            handles: handles.map(|e| e.handles.ok_or_else(|| missing(c"simod.handles/1"))).transpose()?,
            handle_faces: handle_faces
                .map(|e| e.handle_faces.ok_or_else(|| missing(c"simod.handle-faces/1")))
                .transpose()?,
            is_identity: is_identity
                .map(|e| e.is_identity.ok_or_else(|| missing(c"simod.is-identity/1")))
                .transpose()?,
            migration: migration.transpose().map_err(|e: PluginError| {
                Error::plugin(format!("{}: {}", path.display(), line(&e.message)), bug)
            })?,
            describe,
            deform,
            plugin,
        })
    }
}

/// Reads a table of this version; an error has the fault and the advice.
///
/// # Safety
/// What the pointer points to, if it is good, begins like a `SimodPlugin` as far as its version says so.
unsafe fn read_table(table: *const SimodPlugin) -> std::result::Result<SimodPlugin, (String, &'static str)> {
    if table.is_null() || !table.is_aligned() {
        return Err(("simod_plugin_entry is no table".to_owned(), crate::deformer::TELL_AUTHOR));
    }
    // SAFETY: by the contract; all versions of the table begin with two numbers and a size.
    let (major, minor, size) = unsafe { ((*table).interface_major, (*table).interface_minor, (*table).size) };
    if major != SIMOD_INTERFACE_MAJOR {
        let what = format!(
            "it was built for plugin interface {major}.{minor}, this program has \
             {SIMOD_INTERFACE_MAJOR}.{SIMOD_INTERFACE_MINOR}"
        );
        return Err((what, "rebuild it with this program's simod_plugin.h, as `simod plugin new` writes it"));
    }
    if size < size_of::<SimodPlugin>() {
        let what = format!("its table has {size} bytes instead of {}", size_of::<SimodPlugin>());
        return Err((what, "set `size` to sizeof(SimodPlugin), as the header says"));
    }
    // SAFETY: by the contract the table is one of this version, and as large as it says.
    Ok(unsafe { table.read() })
}

/// The table of a capability; nothing where the plugin does not have it.
///
/// # Safety
/// The plugin's table of this id is a `T`.
unsafe fn extension<T: Copy>(plugin: &SimodPlugin, id: &CStr) -> Option<T> {
    // SAFETY: the header says that this may be called once the library is loaded, with any id.
    let table = unsafe { plugin.extension?(id.as_ptr()) }.cast::<T>();
    // SAFETY: by the contract.
    (!table.is_null() && table.is_aligned()).then(|| unsafe { table.read() })
}

/// Reason for which a call expects the plugin to have it: calls that are not offered are not made.
const OFFERED: &str = "the plugin offers it";

/// Calls the plugin with a host that hears its messages, and makes an error of any status but success.
fn call(calls: &dyn HostCalls, call: impl FnOnce(*const SimodHost) -> u32) -> PluginResult<()> {
    let ear = listen::Ear::new(calls);
    match call(&ear.host()) {
        SIMOD_OK => Ok(()),
        status => Err(ear.into_error(status)),
    }
}

fn content(state: &State) -> PluginResult<*const c_void> {
    let state = state.get::<CState>();
    state
        .map(|s| s.data.cast_const())
        .ok_or_else(|| PluginError::internal("the host passed the state of another plugin"))
}

impl Code for CCode {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        // SAFETY: the header says that this may be called at any time, and what it gives stays.
        unsafe { describe::descriptor((self.describe)()) }
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities {
            evaluate: self.evaluate.is_some(),
            handles: self.handles.is_some(),
            is_identity: self.is_identity.is_some(),
        }
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        Ok(self.migration.as_ref().map(|(migration, _)| migration.clone()))
    }

    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State> {
        let mut data = std::ptr::null_mut();
        if let Some(prepare) = self.plugin.prepare {
            with_prepare_input(input, |input| {
                // SAFETY: all pointers are good for the length of the call, as the header asks of the host.
                call(calls, |host| unsafe { prepare(input, host, &raw mut data) })
            })??;
        }
        // After an error there is no state, whatever the plugin wrote.
        Ok(State::new(CState { data, free: self.plugin.drop_state }))
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        let mut data = std::ptr::null_mut();
        if let Some(new_scratch) = self.plugin.new_scratch {
            // SAFETY: the header says that this may be called at any time.
            data = unsafe { new_scratch() };
            if data.is_null() {
                return Err(PluginError::internal("there is no memory to work in")
                    .hint("close other programs, or take fewer samples"));
            }
        }
        Ok(Scratch::new(CScratch(CState { data, free: self.plugin.drop_scratch })))
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let state = content(state)?;
        let scratch = scratch.get_mut::<CScratch>();
        let scratch = scratch
            .ok_or_else(|| PluginError::internal("the host passed the scratch of another plugin"))?
            .0
            .data;
        if out.len() != input.samples.positions().len() {
            return Err(PluginError::internal("the host passed a buffer of another length than the samples"));
        }
        with_deform_input(input, |input| {
            // SAFETY: all pointers are good for the length of the call, `out` has room for all samples, and
            // the scratch is borrowed by this call alone.
            call(calls, |host| unsafe { (self.deform)(state, input, scratch, out.as_mut_ptr(), host) })
        })?
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let (evaluate, state) = (self.evaluate.expect(OFFERED), content(state)?);
        with_deform_input(input, |input| {
            let (first, count) = (points.as_mut_ptr(), points.len());
            // SAFETY: all pointers are good for the length of the call, and there are so many points.
            call(calls, |host| unsafe { evaluate(state, input, first, count, host) })
        })?
    }

    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        let descs = self.handle_descs(input, calls)?;
        let faces = self.handle_faces.map(|function| handle_faces(function, input, calls)).transpose()?;
        Ok(OwnHandles { descs, faces: faces.unwrap_or_default() })
    }

    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool> {
        let is_identity = self.is_identity.expect(OFFERED);
        // SAFETY: the pointer is good for the length of the call.
        with_deform_input(input, |input| unsafe { is_identity(input) } != 0)
    }

    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        // Without the function, all stays as it is.
        let Some(migrate) = self.migration.as_ref().expect(OFFERED).1 else { return Ok(settings) };
        let mut found: PluginResult<Vec<Setting>> = Ok(Vec::new());
        let mut list = SimodSettingList { context: (&raw mut found).cast(), set: set_setting };
        with_settings(&settings, |settings, count| {
            // SAFETY: all pointers are good for the length of the call.
            call(&(), |host| unsafe { migrate(from, settings, count, &raw mut list, host) })
        })??;
        found.map_err(|e| e.hint(crate::deformer::TELL_AUTHOR))
    }
}

impl CCode {
    fn handle_descs(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<Vec<HandleDesc>> {
        let handles = self.handles.expect(OFFERED);
        let mut found: PluginResult<Vec<HandleDesc>> = Ok(Vec::new());
        let mut list = SimodHandleList { context: (&raw mut found).cast(), add: add_handle };
        with_prepare_input(input, |input| {
            // SAFETY: all pointers are good for the length of the call.
            call(calls, |host| unsafe { handles(input, &raw mut list, host) })
        })??;
        found
    }
}

/// The faces that a plugin puts between its handles.
fn handle_faces(
    function: HandleFacesFunction,
    input: &PrepareInput<'_>,
    calls: &dyn HostCalls,
) -> PluginResult<Vec<Vec<u32>>> {
    let mut found: PluginResult<Vec<Vec<u32>>> = Ok(Vec::new());
    let mut list = SimodFaceList { context: (&raw mut found).cast(), add: add_face };
    with_prepare_input(input, |input| {
        // SAFETY: all pointers are good for the length of the call.
        call(calls, |host| unsafe { function(input, &raw mut list, host) })
    })??;
    found
}

/// Function behind `SimodFaceList::add`: the first face that cannot be read is reported.
unsafe extern "C" fn add_face(list: *mut SimodFaceList, corners: *const u32, count: usize) {
    if list.is_null() {
        return;
    }
    // SAFETY: the plugin passes the list that it was given, whose context is the one that `handle_faces`
    // made; it adds faces one by one.
    let found = unsafe { &mut *(*list).context.cast::<PluginResult<Vec<Vec<u32>>>>() };
    if let Ok(faces) = found {
        // SAFETY: the header asks for so many good numbers.
        match unsafe { read::list(corners, count, "the corners of a face") } {
            Ok(corners) => faces.push(corners.to_vec()),
            Err(error) => *found = Err(error),
        }
    }
}

/// Function behind `SimodSettingList::set`: the first setting that cannot be read, or that is one too many,
/// is reported.
unsafe extern "C" fn set_setting(list: *mut SimodSettingList, setting: *const SimodParam) {
    if list.is_null() {
        return;
    }
    // SAFETY: the plugin passes the list that it was given, whose context is the one that `CCode::migrate`
    // made; it gives settings one by one.
    let found = unsafe { &mut *(*list).context.cast::<PluginResult<Vec<Setting>>>() };
    if let Ok(settings) = found {
        if settings.len() >= limits::LONGEST_LIST {
            *found =
                Err(PluginError::internal(format!("it gives more than {} settings", limits::LONGEST_LIST)));
            return;
        }
        // SAFETY: the header asks for a good pointer.
        match unsafe { describe::setting(setting) } {
            Ok(setting) => settings.push(setting),
            Err(error) => *found = Err(error),
        }
    }
}

/// Function behind `SimodHandleList::add`: the first handle that cannot be read is reported.
unsafe extern "C" fn add_handle(list: *mut SimodHandleList, handle: *const SimodHandleDesc) {
    if list.is_null() {
        return;
    }
    // SAFETY: the plugin passes the list that it was given, whose context is the one that `CCode::handles`
    // made; it adds handles one by one.
    let found = unsafe { &mut *(*list).context.cast::<PluginResult<Vec<HandleDesc>>>() };
    if let Ok(handles) = found {
        // SAFETY: the header asks for a good pointer.
        match unsafe { describe::handle(handle) } {
            Ok(handle) => handles.push(handle),
            Err(error) => *found = Err(error),
        }
    }
}

// All versions of the table begin like this, whatever else they have.
const _: () = assert!(offset_of!(SimodPlugin, interface_major) == 0);
const _: () = assert!(offset_of!(SimodPlugin, interface_minor) == 4);
const _: () = assert!(offset_of!(SimodPlugin, size) == 8);
