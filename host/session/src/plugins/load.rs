//! Loading one library.

use super::library_file::{self, EntryPoint};
use crate::deformer::{
    About, CCode, Capabilities, Care, CarefulCode, Code, LookingCode, Migration, OwnHandles, Plugin,
    RustCode, cannot_load, load_whole,
};
use abi_stable::library::{LibraryError, RootModule, lib_header_from_path};
use simod_model::{Error, Result};
use simod_plugin_api::{
    DeformInput, Descriptor, HostCalls, PluginError, PluginModRef, PluginResult, PrepareInput, Scratch,
    Setting, State,
};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};

/// The version of the plugin interface that this program has.
pub(super) fn interface() -> &'static str {
    PluginModRef::VERSION_STRINGS.version.as_str()
}

/// Loads a plugin's code for good: libraries are never unloaded. One that is no plugin is never loaded. What
/// one that did not come with the program does to this process is undone after each call, as far as that can
/// be done.
pub(crate) fn load_code(path: &Path, shipped: bool) -> Result<Box<dyn Code>> {
    let kind = library_file::kind(path)?;
    let care = if shipped { Care::Registers } else { Care::Process };
    let _kept = care.enter();
    let copy = fresh_copy(path)?;
    // The name of the copy does not matter once it is loaded; on systems where it does, the file goes when
    // the system cleans up.
    let file = copy.as_ref().map_or(path, |copy| copy.path());
    Ok(match kind {
        EntryPoint::Rust => {
            // The loader that comes next would accept a library of which some imported functions are missing;
            // here that is an error. The library stays loaded.
            std::mem::forget(load_whole(file, path)?);
            let module = root_module(file).map_err(|e| explain(path, &e.0, e.1.as_deref()))?;
            Box::new(CarefulCode::new(LookingCode(RustCode::new(module)), care))
        }
        EntryPoint::C => Box::new(CarefulCode::new(LookingCode(CCode::load(file, path)?), care)),
    })
}

/// A copy of a library, if one was loaded from that path before: the system would take it for the same.
fn fresh_copy(path: &Path) -> Result<Option<tempfile::NamedTempFile>> {
    static LOADED: LazyLock<Mutex<HashSet<PathBuf>>> = LazyLock::new(Mutex::default);
    let io = |e: std::io::Error| Error::io("copy the plugin", path, &e);
    let path = path.canonicalize().map_err(io)?;
    if LOADED.lock().unwrap_or_else(PoisonError::into_inner).insert(path.clone()) {
        return Ok(None);
    }
    let suffix = path.extension().map_or(String::new(), |e| format!(".{}", e.display()));
    let copy = tempfile::Builder::new().prefix("simod-plugin-").suffix(&suffix).tempfile().map_err(io)?;
    std::fs::copy(&path, copy.path()).map_err(io)?;
    Ok(Some(copy))
}

/// Functions that a library exports; or an error, and the interface's version that the library was built
/// with, where known.
///
/// Not by `RootModule::load_from_file`, which keeps the first library per type and returns it for all others.
fn root_module(path: &Path) -> std::result::Result<PluginModRef, (LibraryError, Option<String>)> {
    let header = lib_header_from_path(path).map_err(|e| (e, None))?;
    let version = header.version_strings().version.as_str();
    header.init_root_module::<PluginModRef>().map_err(|e| (e, Some(version.to_owned())))
}

/// Code of a library whose description is known: the library is loaded when it is first called.
pub(super) struct LazyCode {
    path: PathBuf,
    about: About,
    shipped: bool,
    code: OnceLock<std::result::Result<Box<dyn Code>, PluginError>>,
}

impl LazyCode {
    /// The code of a library that says this about itself. Loads nothing.
    pub fn new(path: &Path, about: About, shipped: bool) -> Self {
        Self { path: path.to_owned(), about, shipped, code: OnceLock::new() }
    }

    fn code(&self) -> PluginResult<&dyn Code> {
        let load = || {
            let failed = |e: Error| PluginError::internal(e.to_string()).hint(e.hint());
            let code = load_code(&self.path, self.shipped).map_err(failed)?;
            if Plugin::ask(code.as_ref(), &self.path).map_err(failed)? != self.about {
                let what = "the library is not what it was when it was looked at";
                return Err(PluginError::internal(what).hint("run the command again"));
            }
            Ok(code)
        };
        self.code.get_or_init(load).as_deref().map_err(Clone::clone)
    }
}

impl Code for LazyCode {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        Ok(self.about.descriptor.clone())
    }

    fn capabilities(&self) -> Capabilities {
        self.about.capabilities
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        Ok(self.about.migration.clone())
    }

    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State> {
        self.code()?.prepare(input, calls)
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        self.code()?.new_scratch()
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        self.code()?.deform(state, input, scratch, out, calls)
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        self.code()?.evaluate(state, input, points, calls)
    }

    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        self.code()?.handles(input, calls)
    }

    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool> {
        self.code()?.is_identity(input)
    }

    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        self.code()?.migrate(from, settings)
    }
}

/// Error of a library in one line, instead of the hundreds that abi_stable has. `theirs` is the interface's
/// version that the plugin was built with, where known.
fn explain(path: &Path, error: &LibraryError, theirs: Option<&str>) -> Error {
    let ours = interface();
    let file = path.display();
    let (what, hint) = match error {
        LibraryError::OpenError { err, .. } => return cannot_load(path, &err.to_string()),
        LibraryError::GetSymbolError { .. } => {
            (format!("{file} is no SIMOD plugin"), "remove it from the plugin folder".to_owned())
        }
        LibraryError::IncompatibleVersionNumber { .. }
        | LibraryError::AbiInstability(_)
        | LibraryError::ParseVersionError(_) => {
            let theirs = theirs.unwrap_or("another version");
            let what = if theirs == ours {
                format!("{file} was built for a changed plugin interface {theirs}, not that of this program")
            } else {
                format!("{file} was built for plugin interface {theirs}, this program has {ours}")
            };
            (what, format!("rebuild the plugin with simod-plugin-api {ours}"))
        }
        LibraryError::InvalidAbiHeader(_) | LibraryError::InvalidCAbi { .. } => (
            format!("{file} was built with another version of abi_stable or for another system"),
            format!("rebuild the plugin with simod-plugin-api {ours}"),
        ),
        LibraryError::RootModule { .. } | LibraryError::Many(_) => {
            (format!("{file} failed to start"), crate::deformer::TELL_AUTHOR.to_owned())
        }
    };
    Error::plugin(what, hint)
}
