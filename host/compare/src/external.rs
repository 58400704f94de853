//! Programs of the user's own that are methods, run on the samples or on the model.

use crate::file::{ProgramFile, ProgramMethod};
use glam::DVec3;
use simod_core::sampled_model::SampledModel;
use simod_model::memory::anonymous_of;
use simod_model::output::write_file;
use simod_model::{Error, Progress, Result};
use simod_session::child::{Ended, Tail};
use simod_session::step::{Region, Role};
use std::fmt::Write as _;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Time between two looks at the process.
const INTERVAL: Duration = Duration::from_millis(10);

/// Number of lines of a program's output that are told if the program fails.
const TOLD: usize = 3;

/// The cost of a program that was run.
pub(crate) struct Ran {
    pub seconds: f64,
    /// Largest anonymous memory of the program and those that it started, at the times when it was looked
    /// at.
    pub peak_memory_bytes: Option<u64>,
}

/// Files for the words in braces of a program's command.
pub(crate) struct Files<'a> {
    /// `{samples}`
    pub samples: &'a Path,
    /// `{constraints}`
    pub constraints: &'a Path,
    /// `{model}`
    pub model: &'a Path,
    /// `{output}`
    pub output: &'a Path,
}

impl Files<'_> {
    /// Word of a command, with the whole paths of the files that it names.
    fn filled_in(&self, word: &str) -> String {
        let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let mut word = word.to_owned();
        for (name, path) in [
            ("{samples}", self.samples),
            ("{constraints}", self.constraints),
            ("{model}", self.model),
            ("{output}", self.output),
        ] {
            word = word.replace(name, &whole(path).to_string_lossy());
        }
        word
    }
}

/// Runs a program in the folder of the file that names it, to its end.
pub(crate) fn run(command: &ProgramMethod, files: &Files<'_>, progress: &dyn Progress) -> Result<Ran> {
    progress.begin("running a program", 0);
    let words: Vec<String> = command.words.iter().map(|word| files.filled_in(word)).collect();
    let Some((program, arguments)) = words.split_first() else {
        return Err(Error::internal("a command has no words"));
    };
    let refused = |e: std::io::Error| {
        let what = format!("cannot run {program}: {e}");
        let hint = "correct the command; its first word is a program that the system finds, or its path";
        Error::system(what, hint)
    };
    let mut process = std::process::Command::new(program);
    let folder = if command.folder.as_os_str().is_empty() { Path::new(".") } else { &command.folder };
    process.args(arguments).current_dir(folder);
    process.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let started = Instant::now();
    let mut child = Ended::start(process).map_err(refused)?;
    let (output, errors) = (Tail::read(child.stdout()), Tail::read(child.stderr()));
    let mut peak_memory_bytes = None;
    let status = loop {
        peak_memory_bytes = peak_memory_bytes.max(anonymous_of(child.id()));
        if let Some(status) = child.try_wait().map_err(refused)? {
            break status;
        }
        progress.check()?;
        std::thread::sleep(INTERVAL);
    };
    let seconds = started.elapsed().as_secs_f64();
    drop(child);
    if !status.success() {
        let what = format!("{program} ended with {status}: {}", last_said(&output.text(), &errors.text()));
        return Err(Error::argument(what, "run it by hand with `simod sample`'s samples.ply"));
    }
    if !files.output.is_file() {
        let what = format!("{program} ended well, and wrote no {{output}}");
        return Err(Error::argument(what, "have it write to the path in place of {output}"));
    }
    Ok(Ran { seconds, peak_memory_bytes })
}

/// Last lines of a program's output, which tell most.
fn last_said(output: &str, errors: &str) -> String {
    let said = if errors.trim().is_empty() { output } else { errors };
    let lines: Vec<&str> = said.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let last = lines[lines.len().saturating_sub(TOLD)..].join("; ");
    if last.is_empty() { "and said nothing".to_owned() } else { last }
}

/// Writes the files that a program is given, as far as its command asks for them.
pub(crate) fn write_given(
    command: &ProgramMethod,
    files: &Files<'_>,
    sampled: &SampledModel,
    regions: &[Region],
) -> Result<()> {
    if command.given.contains(&ProgramFile::Samples) {
        sampled.write_rest(files.samples)?;
    }
    if command.given.contains(&ProgramFile::Constraints) {
        write_file(files.constraints, constraints(sampled, regions).as_bytes())?;
    }
    Ok(())
}

/// Targets of samples in regions: a line for each sample that a region holds by more than a half, with its
/// number and three coordinates; samples in fixed regions have their own place.
fn constraints(sampled: &SampledModel, regions: &[Region]) -> String {
    let place = |p: DVec3| {
        let holding = |region: &&Region| region.role != Role::Mask && region.shapes.weight(p) > 0.5;
        let region = regions.iter().find(holding)?;
        Some(match region.role {
            Role::Handle => region.motion.to_affine(DVec3::ZERO).transform_point3(p),
            _ => p,
        })
    };
    let mut text = String::new();
    for (i, position) in sampled.samples.positions.iter().enumerate() {
        if let Some(DVec3 { x, y, z }) = place(sampled.frame.to_model(*position)) {
            // Writing to a text does not fail.
            let _ = writeln!(text, "{i} {x} {y} {z}");
        }
    }
    text
}
