//! The plugins and the command line, built for the tests.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The project's plugins.
pub const PLUGINS: [&str; 8] =
    ["cage", "displacement-paint", "laplacian", "lattice", "rbf", "skinning", "smooth-handle", "warp"];

/// The folder with what is built: that of the profile that the tests run in.
fn built() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| {
        // target/<profile>/deps/<test>
        let test = std::env::current_exe().unwrap();
        let profile = test.parent().and_then(Path::parent).unwrap();
        let name = profile.file_name().and_then(|n| n.to_str()).unwrap();
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.arg("build").arg("--target-dir").arg(profile.parent().unwrap());
        cargo.arg("--profile").arg(if name == "debug" { "dev" } else { name });
        // The default members, as a plain build has them: a choice of packages would be built with other features of what
        // they depend on, once more.
        let output = cargo.current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        profile.to_owned()
    })
}

/// A plugin's library.
pub fn library(plugin: &str) -> PathBuf {
    built().join(format!("{DLL_PREFIX}simod_{}{DLL_SUFFIX}", plugin.replace('-', "_")))
}

/// The command line.
pub fn simod() -> PathBuf {
    built().join(format!("simod{EXE_SUFFIX}"))
}
