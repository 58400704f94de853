//! The program and the plugins' libraries, built once per test process.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The workspace's root.
pub fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a workspace around the tests")
}

/// A command of cargo's that builds with the profile of the running test.
pub fn cargo_build(folder: &Path, target: &Path) -> Command {
    let profile = profile_folder();
    let name = profile.file_name().and_then(|n| n.to_str()).expect("a profile's folder");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(folder).arg("build").arg("--target-dir").arg(target);
    cargo.args(["--profile", if name == "debug" { "dev" } else { name }]);
    cargo
}

/// Runs a build.
///
/// # Panics
/// It fails.
pub fn run_build(mut cargo: Command) {
    let output = cargo.output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The built `simod`.
pub fn program() -> PathBuf {
    built().join(format!("simod{EXE_SUFFIX}"))
}

/// The built library of a crate, as `simod_warp`.
pub fn library(name: &str) -> PathBuf {
    built().join(format!("{DLL_PREFIX}{name}{DLL_SUFFIX}"))
}

/// Folder in which large files may lie for a while: on a disk, on which the system's folder for temporary
/// files need not be.
pub(crate) fn scratch_folder() -> PathBuf {
    let folder = target_folder().join("tmp");
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    folder
}

/// The folder with what is built: the default members of the workspace, and the plugins that tests alone
/// load. Together, as a choice of packages would be built with other features of what they depend on, once
/// more.
pub fn built() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| {
        let mut cargo = cargo_build(workspace(), &target_folder());
        cargo.args(["-p", "simod-cli", "-p", "simod-plugin-*", "-p", "surveyor"]);
        run_build(cargo);
        profile_folder()
    })
}

fn profile_folder() -> PathBuf {
    // target/<profile>/deps/<test>
    let test = std::env::current_exe().expect("the test's own path");
    test.ancestors().nth(2).expect("a test in a target folder").to_owned()
}

/// A target folder for what is built outside of the workspace, as plugins of other authors are. It is shared
/// and kept from one run to the next, so that what they depend on is built once.
pub fn outside_target() -> PathBuf {
    target_folder().join("outside")
}

/// The target folder.
pub fn target_folder() -> PathBuf {
    profile_folder().parent().expect("a profile in a target folder").to_owned()
}
