//! A folder of its own for each test, and the program run in it.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::SystemTime;

use glam::DVec3;
use serde_json::Value;
use tempfile::TempDir;

use crate::{Ply, built};

/// A temporary folder in which the program runs, so that files are called by their names alone.
pub struct Workplace {
    root: TempDir,
    plugin_path: Option<PathBuf>,
}

/// Outcome of a run of the program.
pub struct Outcome {
    /// The exit code; none where a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// Each file and folder, with size and time of the last change.
type Snapshot = BTreeMap<PathBuf, (u64, SystemTime)>;

impl Default for Workplace {
    fn default() -> Self {
        Self::new()
    }
}

impl Workplace {
    /// An empty one.
    pub fn new() -> Self {
        let root = tempfile::Builder::new().prefix("simod-test-").tempdir_in(built::scratch_folder());
        let root = root.expect("a temporary folder");
        for folder in ["work", "home", "cache"] {
            std::fs::create_dir(root.path().join(folder)).expect("a folder");
        }
        Self { root, plugin_path: None }
    }

    /// With `folder` in `SIMOD_PLUGIN_PATH` from now on.
    pub fn with_plugins(mut self, folder: &str) -> Self {
        self.plugin_path = Some(self.path(folder));
        self
    }

    /// The path of a file here.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.path().join("work").join(name)
    }

    /// Writes a file, and the folders that it needs.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::File::create(path).and_then(|mut f| f.write_all(bytes.as_ref())).expect("a written file");
    }

    /// Writes `edit.toml`: a session on `model` with so many samples and these steps, which writes
    /// `edited.ply`.
    pub fn write_session(&self, model: &str, samples: u64, steps: &str) {
        let model = format!("[model]\npath = \"{model}\"\n[sampling]\nsamples = {samples}\n");
        self.write("edit.toml", format!("{model}{steps}\n[output]\npath = \"edited.ply\"\n"));
    }

    /// Deforms the samples in the folder `sampled` without any plugin, as any program may: `deformed.ply`.
    pub fn move_samples(&self, sampled: &str, to: impl FnMut(DVec3) -> DVec3) {
        let mut samples = self.ply(&format!("{sampled}/samples.ply"));
        samples.move_vertices(to);
        self.write("deformed.ply", &samples.bytes);
    }

    /// Reads a PLY file.
    pub fn ply(&self, name: &str) -> Ply {
        Ply::parse(self.read(name))
    }

    /// Reads a file.
    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// The names in this folder, in order.
    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.path("")).expect("a folder");
        let mut names: Vec<String> = entries
            .map(|e| e.expect("an entry").file_name().into_string().expect("a name in UTF-8"))
            .collect();
        names.sort();
        names
    }

    /// The program in this folder, with no environment but a home and a cache of its own; `line` is split at
    /// blanks.
    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(built::program());
        command.args(line.split_whitespace());
        self.prepare(&mut command);
        command
    }

    /// Another program that runs as this one does.
    pub fn prepared(&self, mut command: Command) -> Command {
        self.prepare(&mut command);
        command
    }

    /// Lets a command run as the program does.
    fn prepare(&self, command: &mut Command) {
        command.env_clear().env("HOME", self.root.path().join("home"));
        command.env("XDG_CACHE_HOME", self.root.path().join("cache"));
        if let Some(folder) = &self.plugin_path {
            command.env("SIMOD_PLUGIN_PATH", folder);
        }
        command.current_dir(self.path("")).stdin(Stdio::null());
    }

    /// Runs the program, which may fail.
    pub fn run(&self, line: &str) -> Outcome {
        self.command(line).output().expect("the program starts").into()
    }

    /// Runs the program, which has to succeed.
    ///
    /// # Panics
    /// It fails.
    pub fn simod(&self, line: &str) -> Outcome {
        let outcome = self.run(line);
        assert_eq!(outcome.code, Some(0), "simod {line}: {}", outcome.stderr);
        outcome
    }

    /// Runs the program, which has to succeed, for its report.
    ///
    /// # Panics
    /// It fails, or its report is not one JSON object.
    pub fn report(&self, line: &str) -> Value {
        self.simod(&format!("{line} --json")).json()
    }

    /// Runs the program, which has to refuse as it should (see [`Outcome::refused`]) and leave all files as
    /// they are.
    ///
    /// # Panics
    /// It does not.
    pub fn refuses(&self, line: &str, named: &[&str]) -> Outcome {
        self.refused(line, self.command(line), named)
    }

    /// As [`refuses`](Self::refuses), where no file may grow beyond `bytes`: how a full disk feels.
    #[cfg(unix)]
    pub fn refuses_beyond(&self, bytes: u64, line: &str, named: &[&str]) -> Outcome {
        self.refused(line, self.limited(bytes, line), named)
    }

    /// As [`run`](Self::run), where no file may grow beyond `bytes`.
    #[cfg(unix)]
    pub fn run_beyond(&self, bytes: u64, line: &str) -> Outcome {
        self.limited(bytes, line).output().expect("the program starts").into()
    }

    #[cfg(unix)]
    fn limited(&self, bytes: u64, line: &str) -> Command {
        // Without the signal, a write beyond the limit returns an error.
        let script = format!("trap '' XFSZ; ulimit -f {}; exec \"$@\"", bytes / 512);
        let mut shell = Command::new("/bin/sh");
        shell.args(["-c", &script, "sh"]).arg(built::program()).args(line.split_whitespace());
        self.prepare(&mut shell);
        shell
    }

    fn refused(&self, line: &str, mut command: Command, named: &[&str]) -> Outcome {
        let before = self.snapshot();
        let outcome = Outcome::from(command.output().expect("the program starts"));
        outcome.refused(line, named);
        assert_eq!(self.snapshot(), before, "simod {line} left something behind, or took it away");
        outcome
    }

    /// The file in which the program remembers plugins.
    pub fn plugin_cache(&self) -> PathBuf {
        self.root.path().join("cache/simod/plugins.json")
    }

    /// All that there is, home included, but what the program remembers to be faster.
    pub fn snapshot(&self) -> Snapshot {
        let folders = ["work", "home"].map(|folder| self.root.path().join(folder));
        let (mut found, mut folders) = (Snapshot::new(), folders.to_vec());
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).expect("a folder") {
                let entry = entry.expect("an entry");
                let meta = entry.metadata().expect("what an entry is");
                // A folder's time changes when a temporary file comes and goes, which is no trace of it.
                let trace = if meta.is_dir() {
                    folders.push(entry.path());
                    (0, SystemTime::UNIX_EPOCH)
                } else {
                    (meta.len(), meta.modified().expect("a time"))
                };
                found.insert(entry.path(), trace);
            }
        }
        found
    }
}

impl Outcome {
    /// The report, on standard output.
    ///
    /// # Panics
    /// It is not one JSON object.
    pub fn json(&self) -> Value {
        let value: Value = serde_json::from_str(&self.stdout)
            .unwrap_or_else(|e| panic!("{e}: {}\n{}", self.stdout, self.stderr));
        assert!(value.is_object(), "{value}");
        value
    }

    /// The lines of standard error that begin so, without that.
    pub fn lines(&self, prefix: &str) -> Vec<&str> {
        self.stderr.lines().filter_map(|l| l.strip_prefix(prefix)).collect()
    }

    /// The one hint.
    pub fn hint(&self) -> &str {
        self.lines("hint: ")[0]
    }

    /// Checks that the program failed as it should: with exit code 1, one line that says what is wrong and
    /// names all of `named`, one that says what to do, nothing on standard output, and no panic.
    ///
    /// # Panics
    /// It did not.
    pub fn refused(&self, line: &str, named: &[&str]) {
        let Self { code, stdout, stderr } = self;
        let context = format!("simod {line}: exit {code:?}\n{stdout}{stderr}");
        assert_eq!(*code, Some(1), "{context}");
        assert_eq!(stdout, "", "{context}");
        assert!(!stderr.contains("panicked at"), "{context}");
        let (errors, hints) = (self.lines("error: "), self.lines("hint: "));
        assert_eq!((errors.len(), hints.len()), (1, 1), "{context}");
        let said = self.lines("warning: ").len() + self.lines("note: ").len();
        assert_eq!(stderr.lines().count() - said, 2, "{context}");
        assert!(!hints[0].trim().is_empty(), "{context}");
        for name in named {
            assert!(errors[0].contains(name), "the error does not name {name:?}: {context}");
        }
    }
}

impl From<Output> for Outcome {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
        Self { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

/// A real model, where the machine has it: in the folder that `SIMOD_TEST_DATA` names, or `shared/data`
/// beside the workspace. Says so on standard output where it has not.
pub fn real_model(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SIMOD_TEST_DATA")
        .map_or_else(|| built::workspace().join("../shared/data"), PathBuf::from);
    let path = folder.join(name);
    if !path.is_file() {
        skip(&format!("there is no {}", path.display()));
        return None;
    }
    Some(path)
}

/// Says that something is not tested here; also where the test harness keeps what tests print to itself.
pub fn skip(why: &str) {
    // On a line of its own, wherever the harness is.
    writeln!(std::io::stdout(), "\nskipped: {why}").expect("standard output");
}
