//! Folders of the user's, by the rules of each system.

use std::path::PathBuf;

/// A folder of the user's: a variable's on Windows, one in the home on macOS, and elsewhere a variable's or
/// one in the home.
pub(super) fn users_folder(windows: &str, macos: &str, variable: &str, home: &str) -> Option<PathBuf> {
    let path_of = |name| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    let in_home = |folder| path_of("HOME").map(|home| home.join(folder));
    if cfg!(windows) {
        path_of(windows)
    } else if cfg!(target_os = "macos") {
        in_home(macos)
    } else {
        path_of(variable).or_else(|| in_home(home))
    }
}
