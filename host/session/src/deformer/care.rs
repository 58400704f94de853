//! Protection of this process from side effects of a plugin in it, which are undone after each call:
//! floating-point modes, the current folder, and standard output, which is the program's alone.
//!
//! The protection is a help against libraries that do not think of others. Nothing here keeps a plugin from
//! harm that it means: see `docs/plugins.md`.

use super::registers::{Modes, clear_upper_halves};
use super::{Capabilities, Code, Migration, OwnHandles};
use simod_plugin_api::{
    DeformInput, Descriptor, HostCalls, PluginError, PluginResult, PrepareInput, Scratch, Setting, State,
};

/// The care that is taken: how much is undone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Care {
    /// State of this thread's registers: some nanoseconds.
    Registers,
    /// State of the whole process, too: some microseconds.
    Process,
}

/// Guard that restores the state when it is dropped.
#[must_use]
pub(crate) struct RestoreOnDrop {
    modes: Modes,
    #[cfg(unix)]
    process: Option<&'static process::Process>,
}

impl Care {
    /// Remembers how things are.
    pub fn enter(self) -> RestoreOnDrop {
        RestoreOnDrop {
            modes: Modes::current(),
            #[cfg(unix)]
            process: (self == Self::Process).then(process::Process::enter).flatten(),
        }
    }
}

impl Drop for RestoreOnDrop {
    fn drop(&mut self) {
        clear_upper_halves();
        // To write them takes longer than to read them.
        if Modes::current() != self.modes {
            self.modes.set();
        }
        #[cfg(unix)]
        if let Some(process) = self.process {
            process.leave();
        }
    }
}

/// State of the whole process.
#[cfg(unix)]
mod process {
    use rustix::fd::OwnedFd;
    use std::sync::{Mutex, OnceLock, PoisonError};

    pub struct Process {
        folder: Option<OwnedFd>,
        output: Option<OwnedFd>,
        /// Calls that are going on, of all threads.
        inside: Mutex<usize>,
    }

    impl Process {
        /// Sends what is printed from now on to standard error, until the last one [leaves](Self::leave).
        pub fn enter() -> Option<&'static Self> {
            static PROCESS: OnceLock<Process> = OnceLock::new();
            let this = PROCESS.get_or_init(|| {
                use rustix::fs::{Mode, OFlags, open};
                let flags = OFlags::DIRECTORY | OFlags::CLOEXEC;
                Self {
                    folder: open(".", flags, Mode::empty()).ok(),
                    output: rustix::io::fcntl_dupfd_cloexec(std::io::stdout(), 3).ok(),
                    inside: Mutex::new(0),
                }
            });
            let mut inside = this.inside.lock().unwrap_or_else(PoisonError::into_inner);
            if *inside == 0 && this.output.is_some() {
                let _ = rustix::stdio::dup2_stdout(std::io::stderr());
            }
            *inside += 1;
            Some(this)
        }

        /// Restores the state of the process.
        pub fn leave(&self) {
            let mut inside = self.inside.lock().unwrap_or_else(PoisonError::into_inner);
            *inside -= 1;
            if let Some(output) = self.output.as_ref().filter(|_| *inside == 0) {
                flush();
                let _ = rustix::stdio::dup2_stdout(output);
            }
            if let Some(folder) = &self.folder {
                let _ = rustix::process::fchdir(folder);
            }
        }
    }

    /// Has the C library write the text that it was told to print, while standard output leads to where that
    /// text should go.
    #[allow(unsafe_code, reason = "a function of the C library; the block has its argument")]
    fn flush() {
        #[cfg(any(target_os = "linux", target_os = "macos"))]
        {
            use std::ffi::{c_int, c_void};
            unsafe extern "C" {
                #[cfg_attr(target_os = "macos", link_name = "__stdoutp")]
                static stdout: *mut c_void;
                fn fflush(stream: *mut c_void) -> c_int;
            }
            // SAFETY: the C library's own stream, which it locks.
            unsafe { fflush(stdout) };
        }
    }
}

/// A plugin's code in this process, each call with care.
pub(crate) struct CarefulCode<C> {
    code: C,
    care: Care,
}

/// A thing that a plugin made, which it frees with the same care.
struct Careful<T> {
    content: Option<T>,
    care: Care,
}

impl<T> Drop for Careful<T> {
    fn drop(&mut self) {
        let _kept = self.care.enter();
        self.content = None;
    }
}

fn foreign() -> PluginError {
    PluginError::internal("the host passed what another plugin made")
}

impl<C: Code> CarefulCode<C> {
    /// Code that is called with this care.
    pub fn new(code: C, care: Care) -> Self {
        Self { code, care }
    }

    fn careful<T>(&self, content: T) -> Careful<T> {
        Careful { content: Some(content), care: self.care }
    }
}

fn content(state: &State) -> PluginResult<&State> {
    state.get::<Careful<State>>().and_then(|s| s.content.as_ref()).ok_or_else(foreign)
}

impl<C: Code> Code for CarefulCode<C> {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        let _kept = self.care.enter();
        self.code.descriptor()
    }

    fn capabilities(&self) -> Capabilities {
        self.code.capabilities()
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        let _kept = self.care.enter();
        self.code.migration()
    }

    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State> {
        let _kept = self.care.enter();
        self.code.prepare(input, calls).map(|state| State::new(self.careful(state)))
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        let _kept = self.care.enter();
        self.code.new_scratch().map(|scratch| Scratch::new(self.careful(scratch)))
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let scratch = scratch.get_mut::<Careful<Scratch>>().and_then(|s| s.content.as_mut());
        let (state, scratch) = (content(state)?, scratch.ok_or_else(foreign)?);
        let _kept = self.care.enter();
        self.code.deform(state, input, scratch, out, calls)
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let state = content(state)?;
        let _kept = self.care.enter();
        self.code.evaluate(state, input, points, calls)
    }

    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        let _kept = self.care.enter();
        self.code.handles(input, calls)
    }

    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool> {
        let _kept = self.care.enter();
        self.code.is_identity(input)
    }

    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        let _kept = self.care.enter();
        self.code.migrate(from, settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A third of a small number, which is none where small numbers are taken for zero.
    #[cfg(target_arch = "x86_64")]
    #[test]
    #[allow(unsafe_code, deprecated, reason = "to change what is to be kept")]
    fn modes_are_as_before() {
        use std::arch::x86_64::{_mm_getcsr, _mm_setcsr};
        use std::hint::black_box;
        let third = || black_box(f32::MIN_POSITIVE) / black_box(3.0);
        let before = Modes::current();
        let kept = Care::Registers.enter();
        // SAFETY: bits that exist: flush to zero.
        unsafe { _mm_setcsr(_mm_getcsr() | 0x8000) };
        assert_eq!(third(), 0.0);
        assert_ne!(Modes::current(), before);
        drop(kept);
        assert!(third() > 0.0);
        assert_eq!(Modes::current(), before);
    }
}
