//! Loading one library.

use super::elf;
use crate::deformer::{Plugin, RustCode};
use abi_stable::library::{LibraryError, RootModule, lib_header_from_path};
use simod_core::{Error, ErrorKind, Result};
use simod_plugin_api::PluginModRef;
use std::path::Path;

/// Loads a plugin for good: libraries are never unloaded.
pub(super) fn load(path: &Path) -> Result<Plugin> {
    Plugin::in_process(root_module(path)?, path)
}

/// As [`load`], whatever the plugin says about itself.
pub(super) fn load_unchecked(path: &Path) -> Result<Plugin> {
    Plugin::unchecked(Box::new(RustCode::new(root_module(path)?)), path)
}

/// The functions that a library exports.
///
/// Not by `RootModule::load_from_file`, which keeps the first library per type and returns it for all others.
fn root_module(path: &Path) -> Result<PluginModRef> {
    // The dynamic linker maps a file that was cut off without a complaint, and the process dies on touching it.
    elf::check_complete(path)?;
    let header = lib_header_from_path(path).map_err(|e| explain(path, &e, None))?;
    let version = header.version_strings().version.as_str();
    header.init_root_module::<PluginModRef>().map_err(|e| explain(path, &e, Some(version)))
}

/// One line instead of the hundreds that abi_stable has. `theirs` is the interface's version that the plugin
/// was built with, where known.
fn explain(path: &Path, error: &LibraryError, theirs: Option<&str>) -> Error {
    let ours = PluginModRef::VERSION_STRINGS.version.as_str();
    let file = path.display();
    let (what, hint) = match error {
        LibraryError::OpenError { err, .. } => {
            // "/path/lib.so: what is wrong": the path is ours to tell.
            let text = err.to_string();
            let reason = text.lines().next().unwrap_or_default();
            let reason = reason.strip_prefix(&format!("{file}: ")).unwrap_or(reason);
            (
                format!("cannot load {file}: {reason}"),
                "is it a library for this system, and complete?".to_owned(),
            )
        }
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
            (format!("{file} failed to start"), "this is a bug of the plugin; tell its author".to_owned())
        }
    };
    Error::new(ErrorKind::Plugin, what, hint)
}
