//! A process that does not outlive this one, nor do those that it starts.
//!
//! The process leads a process group, which is ended with it. If this process is killed, and cannot end the
//! group itself, that is done on Linux by the signal that the system sends to it
//! ([`end_with`](super::end_with)), and on all Unix systems by a shell that reads a pipe from here until it
//! breaks, and then ends all groups that are left.

use std::io::Result;
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus};
use std::sync::OnceLock;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

/// Time between two looks whether the process is still there.
pub(super) const INTERVAL: Duration = Duration::from_millis(5);

/// Time for which the last words of a process that ended are waited for. Processes that it started itself may
/// hold its outputs open.
pub(super) const LAST_WORDS: Duration = Duration::from_secs(1);

/// A process that does not outlive this.
pub struct Ended {
    child: Child,
    /// Exit status, once the process was taken off the system's list: from then on its number may be another
    /// process'.
    status: Option<ExitStatus>,
}

impl Ended {
    /// Starts a process at the head of a group of its own. What the user types at the terminal to stop is
    /// this process's to handle.
    pub fn start(mut command: Command) -> Result<Self> {
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let this = Self { child: spawn(command)?, status: None };
        #[cfg(unix)]
        watcher::add(this.child.id());
        Ok(this)
    }

    /// The process's number, as long as it is there.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Pipe of the process's standard output, if that is asked for, and for the first time.
    pub fn stdout(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Pipe of the process's standard error, likewise.
    pub fn stderr(&mut self) -> Option<ChildStderr> {
        self.child.stderr.take()
    }

    /// Exit status, if the process has ended: then nothing of its group is left either.
    pub fn try_wait(&mut self) -> Result<Option<ExitStatus>> {
        if self.status.is_none() && self.has_ended()? {
            self.kill();
            self.take_off();
        }
        Ok(self.status)
    }

    /// Ends the process, if it does not end by itself at this moment; returns its exit status, where that is
    /// known.
    pub fn end(&mut self) -> Option<ExitStatus> {
        let since = Instant::now();
        while since.elapsed() < LAST_WORDS {
            match self.try_wait() {
                Ok(None) => std::thread::sleep(INTERVAL),
                ended => return ended.ok().flatten(),
            }
        }
        self.kill();
        self.take_off();
        self.status
    }

    /// Ends the process at once, with all of its group.
    pub fn kill(&mut self) {
        if self.status.is_some() {
            return;
        }
        // The signal fails where no process of the group is left.
        #[cfg(unix)]
        if let Some(group) = pid(&self.child) {
            let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _ = self.child.kill();
    }

    /// Whether the process has ended, without taking it off the system's list: as long as it is there, no
    /// other process has its number.
    #[cfg(unix)]
    fn has_ended(&self) -> Result<bool> {
        use rustix::process::{WaitId, WaitIdOptions, waitid};
        let Some(pid) = pid(&self.child) else { return Ok(true) };
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        Ok(waitid(WaitId::Pid(pid), options)?.is_some())
    }

    /// See the version for Unix.
    #[cfg(not(unix))]
    fn has_ended(&mut self) -> Result<bool> {
        Ok(self.child.try_wait()?.is_some())
    }

    /// Waits for a process that is ending, and forgets its number.
    fn take_off(&mut self) {
        #[cfg(unix)]
        watcher::remove(self.child.id());
        self.status = self.child.wait().ok();
    }
}

impl Drop for Ended {
    fn drop(&mut self) {
        if self.status.is_none() {
            self.kill();
            self.take_off();
        }
    }
}

#[cfg(unix)]
fn pid(child: &Child) -> Option<rustix::process::Pid> {
    rustix::process::Pid::from_raw(child.id() as i32)
}

/// Starts a process from a thread that lasts as long as this process: the signal that ends processes with
/// their parent comes when the *thread* ends that started them.
fn spawn(command: Command) -> Result<Child> {
    type Order = (Command, Sender<Result<Child>>);
    static STARTER: OnceLock<Option<Sender<Order>>> = OnceLock::new();
    let starter = STARTER.get_or_init(|| {
        let (sender, orders) = channel::<Order>();
        let start = move || {
            for (mut command, answer) in orders {
                let child = command.spawn();
                // The rest of the command may hold its ends of pipes and sockets open.
                drop(command);
                // The caller has gone, and no other code ends the process.
                if let Err(unheard) = answer.send(child)
                    && let Ok(mut child) = unheard.0
                {
                    let _ = child.kill();
                }
            }
        };
        std::thread::Builder::new().name("processes".into()).spawn(start).ok().map(|_| sender)
    });
    let gone = || std::io::Error::other("the thread that starts processes has ended");
    let (answer, child) = channel();
    let starter = starter.as_ref().ok_or_else(gone)?;
    starter.send((command, answer)).map_err(|_| gone())?;
    child.recv().map_err(|_| gone())?
}

/// Shell that ends the groups that are left.
#[cfg(unix)]
mod watcher {
    use crate::child::ended::spawn;
    use std::io::Write;
    use std::os::unix::process::CommandExt;
    use std::process::{Child, ChildStdin, Command, Stdio};
    use std::sync::{Mutex, OnceLock, PoisonError};

    /// Keeps a list of the groups that are there, and ends them when it can read no more.
    const SCRIPT: &str = r#"
        groups=' '
        while read -r change group; do
            case $change in
                +) groups="$groups-$group " ;;
                *) groups="${groups%%" -$group "*} ${groups#*" -$group "}" ;;
            esac
        done
        set -- $groups
        [ $# -eq 0 ] || kill -s KILL -- "$@"
    "#;

    /// A group is there that has to end with this process.
    pub fn add(group: u32) {
        tell('+', group);
    }

    /// The group has ended.
    pub fn remove(group: u32) {
        tell('-', group);
    }

    fn tell(change: char, group: u32) {
        static PIPE: OnceLock<Option<Mutex<(ChildStdin, Child)>>> = OnceLock::new();
        let pipe = PIPE.get_or_init(|| {
            let mut shell = Command::new("/bin/sh");
            shell.args(["-c", SCRIPT]).env_clear().current_dir("/").process_group(0);
            shell.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
            let mut shell = spawn(shell).ok()?;
            Some(Mutex::new((shell.stdin.take()?, shell)))
        });
        // On a system without a shell, the system's own signal has to do.
        if let Some(pipe) = pipe {
            let _ = writeln!(pipe.lock().unwrap_or_else(PoisonError::into_inner).0, "{change} {group}");
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::process::Stdio;
    use std::time::Duration;

    fn is_there(process: &str) -> bool {
        // One that has ended, and that nobody has asked about, is not there.
        let state = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        state.rsplit(')').next().is_some_and(|rest| !rest.trim().is_empty() && !rest.trim().starts_with('Z'))
    }

    /// A shell with a child that would go on, which prints the child's number and then does the rest of the
    /// script.
    fn parent(script: &str) -> (Ended, String) {
        let mut command = Command::new("sh");
        command.args(["-c", &format!("sleep 100 & echo $!; {script}")]).stdout(Stdio::piped());
        let mut parent = Ended::start(command).expect("a shell");
        let mut line = String::new();
        let mut out = std::io::BufReader::new(parent.stdout().expect("its output"));
        std::io::BufRead::read_line(&mut out, &mut line).expect("a number");
        (parent, line.trim().to_owned())
    }

    fn ends(process: &str) {
        let since = Instant::now();
        while is_there(process) {
            assert!(since.elapsed() < Duration::from_secs(10), "{process} goes on");
            std::thread::sleep(INTERVAL);
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_group_ends_with_its_first_process() {
        // The group ends when its first process ends by itself,
        let (mut parent, child) = parent("exit 3");
        assert_eq!(parent.end().and_then(|status| status.code()), Some(3));
        ends(&child);
        // or is ended.
        let (parent, child) = self::parent("wait");
        assert!(is_there(&child));
        drop(parent);
        ends(&child);
    }
}
