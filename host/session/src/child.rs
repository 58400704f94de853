//! Other processes of this program, which may end in any way.

mod ended;

pub use ended::Ended;
use ended::{INTERVAL, LAST_WORDS};

use std::io::Read;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use simod_model::{Error, Progress, Result};

/// Number of bytes that are kept of the text that a process prints: the last ones.
const KEPT: usize = 64 << 10;

/// The end of a process.
pub enum End {
    /// The process ended by itself, with exit code 0.
    Well,
    /// The process went on for too long, and was ended.
    TooLong,
    /// The process asked for more memory than it may have.
    OutOfMemory,
    /// The process ended badly otherwise: by a signal, or with an exit code.
    Badly(String),
}

/// The output of a process and its end.
pub struct Outcome {
    /// The process's end.
    pub end: End,
    /// The end of what the process printed on standard output.
    pub output: String,
    /// The last line that the process printed on standard error; may be empty.
    pub last_error: String,
}

/// Runs this program with the given arguments for at most `time`. Where the user asks to stop, it is ended,
/// and the error says so. Nothing that it started is left behind.
pub fn run(mut command: Command, time: Duration, progress: &dyn Progress) -> Result<Outcome> {
    let refused = |e: std::io::Error| {
        let what = format!("cannot run this program once more: {e}");
        Error::system(what, "check the permissions of the program, and the limits on processes")
    };
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = Ended::start(command).map_err(refused)?;
    let output = Tail::read(child.stdout());
    let errors = Tail::read(child.stderr());
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(refused)? {
            break Some(status);
        }
        progress.check()?;
        if started.elapsed() >= time {
            break None;
        }
        std::thread::sleep(INTERVAL);
    };
    drop(child);
    let (output, errors) = (output.text(), errors.text());
    let end = match status {
        None => End::TooLong,
        Some(status) if status.success() => End::Well,
        Some(_) if ran_out_of_memory(&errors) => End::OutOfMemory,
        Some(status) => End::Badly(describe(status)),
    };
    let last_error = errors.lines().rfind(|l| !l.trim().is_empty()).unwrap_or_default().trim().to_owned();
    Ok(Outcome { end, output, last_error })
}

/// Whether a process that printed this ran out of memory: Rust, C++ and Python print one of these texts
/// before they give up.
pub(crate) fn ran_out_of_memory(errors: &str) -> bool {
    ["memory allocation of", "bad_alloc", "MemoryError"].iter().any(|text| errors.contains(text))
}

/// End of the text that a process prints, read by a thread, so that the process never waits for a reader.
pub struct Tail {
    bytes: Arc<Mutex<Vec<u8>>>,
    reader: Option<std::thread::JoinHandle<()>>,
}

impl Tail {
    /// Reads all that comes.
    pub fn read(source: Option<impl Read + Send + 'static>) -> Self {
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let kept = bytes.clone();
        let read = move |mut source: Box<dyn Read + Send>| {
            let mut block = [0; 4096];
            while let Ok(count @ 1..) = source.read(&mut block) {
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                kept.extend_from_slice(&block[..count]);
                if kept.len() > 2 * KEPT {
                    let old = kept.len() - KEPT;
                    kept.drain(..old);
                }
            }
        };
        let reader = source.and_then(|source| {
            let source: Box<dyn Read + Send> = Box::new(source);
            std::thread::Builder::new().name("child".into()).spawn(move || read(source)).ok()
        });
        Self { bytes, reader }
    }

    /// The end of what came, as text.
    pub fn text(&self) -> String {
        let since = Instant::now();
        while self.reader.as_ref().is_some_and(|r| !r.is_finished()) && since.elapsed() < LAST_WORDS {
            std::thread::sleep(INTERVAL);
        }
        String::from_utf8_lossy(&self.bytes.lock().unwrap_or_else(PoisonError::into_inner)).into_owned()
    }
}

/// End of a process in words, to complete a sentence.
#[cfg(unix)]
pub(crate) fn describe(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    let Some(signal) = status.signal() else { return describe_code(status) };
    let name = match signal {
        4 => " (illegal instruction)",
        6 => " (abort)",
        8 => " (arithmetic error)",
        9 => " (killed; perhaps for its memory)",
        7 | 10 | 11 => " (invalid memory access)",
        _ => "",
    };
    format!("ended by signal {signal}{name}")
}

/// See the version for Unix.
#[cfg(not(unix))]
pub(crate) fn describe(status: ExitStatus) -> String {
    describe_code(status)
}

fn describe_code(status: ExitStatus) -> String {
    status
        .code()
        .map_or_else(|| "ended for no known reason".to_owned(), |c| format!("ended with exit code {c}"))
}

/// Whether [`limit_memory`] has an effect on this system.
pub const LIMITS_MEMORY: bool = cfg!(target_os = "linux");

/// Ends this process together with the process of this number that started it; at once, if that one has ended
/// already. On Linux by a signal of the system's; elsewhere a process that does not listen goes on for a
/// moment when the other one is killed.
pub fn end_with(parent: u32) {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Signal, set_parent_process_death_signal};
        // A system on which this does not work is no reason to stop.
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
    }
    // The parent may have ended before the signal was asked for: the parent is another process then.
    #[cfg(unix)]
    if std::os::unix::process::parent_id() != parent {
        std::process::exit(1);
    }
    #[cfg(not(unix))]
    let _ = parent;
}

/// Limits the memory of this process to so many bytes from now on, and keeps it from leaving an image of its
/// memory on the disk when it crashes. On Linux; other systems have no such limits.
///
/// Memory that threads reserve comes on top: their stacks, and for all addresses, which also count where they
/// are not used, the arenas of the C library.
#[cfg(target_os = "linux")]
pub fn limit_memory(bytes: u64) -> Result<()> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    const STACK: u64 = 8 << 20;
    const ARENA: u64 = 128 << 20;
    // The program's and the plugin's.
    let threads = 2 * std::thread::available_parallelism().map_or(1, usize::from) as u64;
    let data = bytes.saturating_add(threads * STACK);
    let addresses = data.saturating_add(threads * ARENA);
    for (resource, most) in [(Resource::Data, data), (Resource::As, addresses), (Resource::Core, 0)] {
        let before = getrlimit(resource).maximum;
        let most = Some(before.map_or(most, |before| before.min(most)));
        setrlimit(resource, Rlimit { current: most, maximum: most }).map_err(|e| {
            let what = format!("cannot limit the memory to {bytes} bytes: {e}");
            Error::system(what, "check the limits that the shell sets, with `ulimit -a`")
        })?;
    }
    Ok(())
}

/// See the version for Linux.
#[cfg(not(target_os = "linux"))]
pub fn limit_memory(_bytes: u64) -> Result<()> {
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use simod_model::progress::Silent;

    fn shell(script: &str) -> Outcome {
        shell_for(Duration::from_secs(60), script)
    }

    fn shell_for(time: Duration, script: &str) -> Outcome {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        run(command, time, &Silent).expect("a shell")
    }

    #[test]
    fn every_end_is_told() {
        let well = shell("echo fine; echo oops >&2");
        assert!(matches!(well.end, End::Well));
        assert_eq!((well.output.as_str(), well.last_error.as_str()), ("fine\n", "oops"));
        assert!(matches!(shell_for(Duration::from_millis(300), "exec sleep 100").end, End::TooLong));
        assert!(matches!(shell("exit 3").end, End::Badly(how) if how == "ended with exit code 3"));
        assert!(matches!(shell("kill -11 $$").end, End::Badly(how) if how.starts_with("ended by signal 11")));
        let dry = "echo 'memory allocation of 8 bytes failed' >&2; exit 1";
        assert!(matches!(shell(dry).end, End::OutOfMemory));
        // Output that is too much to keep does not stop the process.
        assert!(shell("yes | head -c 1000000").output.len() <= 2 * KEPT);
    }
}
