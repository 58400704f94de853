//! Plugins in C and C++, built as their authors would.

use std::env::consts::DLL_SUFFIX;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::{Workplace, workspace};

/// Whether there is a compiler of this name.
pub fn has_compiler(name: &str) -> bool {
    Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success())
}

impl Workplace {
    /// Builds a library from a source of the workspace, without a warning: `plugins/NAME.so`, or as the
    /// system has it. C++ if the source says so.
    ///
    /// # Panics
    /// It does not compile.
    pub fn build_c(&self, source: &str, name: &str, options: &[&str]) -> PathBuf {
        let source = workspace().join(source);
        let library = self.path("plugins").join(format!("{name}{DLL_SUFFIX}"));
        std::fs::create_dir_all(self.path("plugins")).expect("a folder");
        let is_c = source.extension().is_some_and(|e| e == "c");
        let mut command = Command::new(if is_c { "cc" } else { "c++" });
        command.arg(if is_c { "-std=c99" } else { "-std=c++11" });
        command.args(["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-shared", "-fPIC"]).args(options);
        command.arg("-I").arg(include()).arg("-o").arg(&library).arg(&source).arg("-lm");
        let output = command.output().expect("a compiler");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        library
    }
}

/// Folder of the header.
fn include() -> PathBuf {
    Path::new(workspace()).join("plugin-api/include")
}
