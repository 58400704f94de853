//! The real programs as child processes: what they report, and what the system says of them; and a plain copy
//! of a file, to compare with.

use std::error::Error;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Result of a measurement, whose error is only ever shown to a person.
pub type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Ends a benchmark program: prints its error, if there is one.
#[expect(clippy::print_stderr, reason = "the error of a program is told there")]
pub fn exit(done: Result<()>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The anonymous memory of a process at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MemoryPoint {
    /// Seconds since the process began.
    pub seconds: f64,
    /// Anonymous resident memory in bytes.
    pub bytes: f64,
}

/// A process that has ended well.
#[derive(Debug)]
pub struct Ran {
    /// Standard output.
    pub stdout: Vec<u8>,
    /// Seconds of the whole process, its start and end included.
    pub wall: f64,
    /// Processor time of all its threads, in user mode and in the system; NaN where the system does not tell.
    pub cpu: f64,
    /// Its memory over time; empty where nobody looked, or the system does not tell.
    pub memory: Vec<MemoryPoint>,
}

impl Ran {
    /// The most memory that was seen, in bytes; NaN where none was.
    pub fn peak(&self) -> f64 {
        self.memory.iter().map(|m| m.bytes).fold(f64::NAN, f64::max)
    }

    /// Standard output as JSON.
    ///
    /// # Errors
    /// The output is no JSON.
    pub fn json(&self) -> Result<Value> {
        Ok(serde_json::from_slice(&self.stdout)?)
    }
}

/// The `simod` to measure: `path`, or the one beside this program.
///
/// # Errors
/// There is none.
pub fn simod(path: Option<&Path>) -> Result<PathBuf> {
    let simod = match path {
        Some(path) => path.to_owned(),
        None => std::env::current_exe()?.with_file_name(format!("simod{}", std::env::consts::EXE_SUFFIX)),
    };
    if !simod.is_file() {
        return Err(
            format!("{} is missing: build it first, with `cargo build --release`", simod.display()).into()
        );
    }
    Ok(simod)
}

/// Runs a process to its end. With `poll`, its memory is looked at so often (on Linux).
///
/// Processor time is that of all children of this process meanwhile: run one at a time.
///
/// # Errors
/// The process cannot be started, or fails.
pub fn run(command: &mut Command, poll: Option<Duration>) -> Result<Ran> {
    let (start, cpu) = (Instant::now(), children_cpu());
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let memory = match poll {
        // The child prints a few lines, which fit into a pipe while nobody reads them.
        Some(interval) => watch(&mut child, start, interval)?,
        None => Vec::new(),
    };
    let output = child.wait_with_output()?;
    let (wall, cpu) = (start.elapsed().as_secs_f64(), children_cpu() - cpu);
    Ok(Ran { stdout: succeeded(command, output)?.stdout, wall, cpu, memory })
}

/// Runs a command of `simod`, and returns what it reports of itself.
///
/// # Errors
/// The command fails, or reports nothing.
pub fn report(command: &mut Command) -> Result<Value> {
    run(command.arg("--json"), None)?.json()
}

/// A figure of a report.
///
/// # Errors
/// The report has none of that name.
pub fn number(report: &Value, name: &str) -> Result<f64> {
    report[name].as_f64().ok_or_else(|| format!("simod reports no `{name}`").into())
}

/// The seconds of a phase of a report.
///
/// # Errors
/// The report has no phase of that name.
pub fn phase(report: &Value, name: &str) -> Result<f64> {
    let phases = report["phases"].as_array().into_iter().flatten();
    let phase = phases.filter(|phase| phase["name"] == name).find_map(|phase| phase["seconds"].as_f64());
    phase.ok_or_else(|| format!("simod reports no phase `{name}`").into())
}

/// Copies a file to the disk, as `cp` and `sync` do, and returns the seconds: the least that any program
/// takes which writes the file anew. Not `std::fs::copy`, which on some file systems shares the blocks and
/// writes nothing.
///
/// # Errors
/// A file cannot be read or written.
pub fn copy(from: &Path, to: &Path) -> Result<f64> {
    let start = Instant::now();
    let (mut from, mut to) = (File::open(from)?, File::create(to)?);
    let mut block = vec![0; 1 << 20];
    loop {
        match from.read(&mut block)? {
            0 => break,
            n => to.write_all(&block[..n])?,
        }
    }
    to.sync_all()?;
    Ok(start.elapsed().as_secs_f64())
}

fn succeeded(command: &Command, output: Output) -> Result<Output> {
    if output.status.success() {
        return Ok(output);
    }
    Err(format!("{command:?} failed: {}", String::from_utf8_lossy(&output.stderr).trim()).into())
}

/// Looks at the memory of a process until it ends.
fn watch(child: &mut Child, start: Instant, interval: Duration) -> Result<Vec<MemoryPoint>> {
    let mut memory = Vec::new();
    while child.try_wait()?.is_none() {
        let seconds = start.elapsed().as_secs_f64();
        let bytes = simod_model::memory::anonymous_of(child.id());
        memory.extend(bytes.map(|bytes| MemoryPoint { seconds, bytes: bytes as f64 }));
        std::thread::sleep(interval);
    }
    Ok(memory)
}

/// Processor seconds of this process so far, of all its threads, in user mode and in the system; NaN where
/// the system does not tell.
pub fn own_cpu() -> f64 {
    cpu(Whose::Own)
}

/// Processor seconds of all children that have ended.
fn children_cpu() -> f64 {
    cpu(Whose::Children)
}

enum Whose {
    Own,
    Children,
}

#[cfg(unix)]
fn cpu(whose: Whose) -> f64 {
    use nix::sys::resource::{UsageWho, getrusage};
    use nix::sys::time::TimeValLike;

    let who = match whose {
        Whose::Own => UsageWho::RUSAGE_SELF,
        Whose::Children => UsageWho::RUSAGE_CHILDREN,
    };
    getrusage(who).map_or(f64::NAN, |usage| {
        (usage.user_time().num_microseconds() + usage.system_time().num_microseconds()) as f64 * 1e-6
    })
}

/// Not known on this system.
#[cfg(not(unix))]
fn cpu(_: Whose) -> f64 {
    f64::NAN
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_watched_to_its_end() {
        let mut command = Command::new("sh");
        let ran =
            run(command.args(["-c", "sleep 0.2; echo '{\"samples\": 3}'"]), Some(Duration::from_millis(5)));
        let ran = ran.expect("a shell");
        assert_eq!(number(&ran.json().expect("JSON"), "samples").expect("a number"), 3.0);
        assert!(ran.wall >= 0.2 && ran.cpu >= 0.0);
        if cfg!(target_os = "linux") {
            assert!(ran.peak() > 0.0, "{:?}", ran.memory);
        }
    }

    #[test]
    fn a_failure_is_an_error_that_says_what_was_said() {
        let error = run(Command::new("sh").args(["-c", "echo no such thing >&2; false"]), None);
        assert!(error.expect_err("false fails").to_string().ends_with("no such thing"));
    }
}
