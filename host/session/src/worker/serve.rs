//! A plugin's process: it answers the program's requests until there is nobody to answer.

use super::arena::{ControlMap, SharedArena};
use super::protocol::{
    self, HandlesRecord, InputRecord, LibraryRefusal, PluginFailure, Reply, Request, SettingRecord, Slice,
};
use crate::child::{end_with, limit_memory};
use crate::deformer::{Care, Code, Plugin};
use crate::plugins::load_code;
use memmap2::Mmap;
use rayon::prelude::*;
use simod_model::{Error, Result};
use simod_plugin_api::{
    HostCalls, LogLevel, PluginError, PluginResult, PrepareInput, Scratch, Setting, State,
};
use std::collections::HashMap;
use std::fs::File;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, PoisonError};

/// Lines of a call that are passed on; the program keeps fewer.
const LINES: usize = 1000;

/// Answers requests on a library, as this process's standard streams bring them, until the other side ends.
/// The plugin may take `memory` bytes. `parent` is the number of the program's process.
///
/// # Errors
/// The standard streams are not those that the program makes, or the memory cannot be limited.
pub fn serve(library: &Path, memory: u64, parent: u32) -> Result<()> {
    end_with(parent);
    let refused = |e: std::io::Error| {
        let what = format!("this command is for the program itself: {e}");
        Error::argument(what, "see `simod help` for the others")
    };
    let socket = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned().map_err(refused)?);
    let shared =
        SharedArena::from_file(File::from(std::io::stdout().as_fd().try_clone_to_owned().map_err(refused)?));
    let control = ControlMap::new(&shared).map_err(refused)?;
    // Standard output is the shared memory's file, and standard input the socket: a plugin must not print to
    // the one, or read from the other.
    rustix::stdio::dup2_stdout(std::io::stderr()).map_err(|e| refused(e.into()))?;
    let nothing = File::open("/dev/null").map_err(refused)?;
    rustix::stdio::dup2_stdin(nothing).map_err(|e| refused(e.into()))?;
    limit_memory(memory)?;

    let requests = requests(&socket).map_err(refused)?;

    // By now the thread above is at work: one that begins while a library loads may have to wait until that
    // is done.
    if !matches!(requests.recv(), Ok(Request::Load)) {
        end();
    }
    let calls = Calls { control, socket: Mutex::new(socket), lines: AtomicUsize::new(0) };
    let Some(code) = load(library, &calls) else { return Ok(()) };
    let mut workshop =
        Workshop { code, shared, calls, states: HashMap::new(), scratches: HashMap::new(), made: 0 };
    for request in requests {
        workshop.calls.lines.store(0, Ordering::Relaxed);
        if let Some(reply) = workshop.answer(request) {
            workshop.calls.send(&reply);
        }
    }
    Ok(())
}

/// Requests of the program, read by a thread of their own, which ends the process when nobody asks any more.
fn requests(socket: &UnixStream) -> std::io::Result<Receiver<Request>> {
    let mut reader = socket.try_clone()?;
    let (sender, requests) = channel();
    let read = move || {
        while let Ok(Some(request)) = protocol::receive::<Request>(&mut reader) {
            if sender.send(request).is_err() {
                break;
            }
        }
        end();
    };
    std::thread::Builder::new().name("requests".into()).spawn(read)?;
    Ok(requests)
}

/// Loads the library, and sends its description, or the reason for which it is refused.
fn load(library: &Path, calls: &Calls) -> Option<Box<dyn Code>> {
    let loaded = load_code(library, false).and_then(|code| {
        let about = Plugin::ask(code.as_ref(), library)?;
        Ok((code, about))
    });
    match loaded {
        Ok((code, about)) => {
            calls.send(&Reply::Loaded(Ok(Box::new(about))));
            Some(code)
        }
        Err(e) => {
            let refusal = LibraryRefusal { what: e.to_string(), hint: e.hint().to_owned() };
            calls.send(&Reply::Loaded(Err(refusal)));
            None
        }
    }
}

/// Ends this process at once, in whatever state the plugin's threads and destructors are.
fn end() -> ! {
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    std::process::abort()
}

/// The states and scratches that the plugin made, and the memory that it works on.
struct Workshop {
    code: Box<dyn Code>,
    shared: SharedArena,
    calls: Calls,
    states: HashMap<u64, (State, InputRecord, Mmap)>,
    scratches: HashMap<u64, Scratch>,
    /// Numbers given so far.
    made: u64,
}

fn broken(e: impl std::fmt::Display) -> PluginError {
    PluginError::internal(format!("the plugin's process cannot reach its input: {e}"))
}

fn wrap<T>(result: PluginResult<T>) -> std::result::Result<T, PluginFailure> {
    result.map_err(PluginFailure::from)
}

impl Workshop {
    fn answer(&mut self, request: Request) -> Option<Reply> {
        Some(match request {
            // The library was loaded before any other request is answered.
            Request::Load => return None,
            Request::Prepare(input) => Reply::Made(wrap(self.prepare(input))),
            Request::NewScratch => {
                let scratch = self.code.new_scratch().map(|scratch| {
                    self.made += 1;
                    self.scratches.insert(self.made, scratch);
                    self.made
                });
                Reply::Made(wrap(scratch))
            }
            Request::Deform { state, scratch, motion, out, fill } => {
                Reply::Done(wrap(self.deform(state, scratch, &motion, out, fill)))
            }
            Request::Evaluate { state, motion, points } => {
                Reply::Done(wrap(self.evaluate(state, &motion, points)))
            }
            Request::Handles(input) => {
                let handles = self.with_input(&input, |input| self.code.handles(input, &self.calls));
                Reply::Handles(wrap(handles.map(HandlesRecord::from)))
            }
            Request::Migrate(from, settings) => {
                let settings = settings.into_iter().map(Setting::from).collect();
                let migrated = self.code.migrate(from, settings);
                Reply::Settings(wrap(migrated.map(|all| all.into_iter().map(SettingRecord::from).collect())))
            }
            Request::IsIdentity { bounds: [min, max], motion } => {
                let samples = simod_plugin_api::Samples::new(&[], &[], &[]);
                let bounds = simod_plugin_api::Bounds { min, max };
                let answer = motion.with(samples, None, bounds, |input| self.code.is_identity(input));
                Reply::Identity(wrap(answer))
            }
            Request::DropState(id) => {
                self.states.remove(&id);
                return None;
            }
            Request::DropScratch(id) => {
                self.scratches.remove(&id);
                return None;
            }
        })
    }

    fn with_input<T>(
        &self,
        input: &InputRecord,
        call: impl FnOnce(&PrepareInput<'_>) -> PluginResult<T>,
    ) -> PluginResult<T> {
        let map = self.shared.map(input.range).map_err(broken)?;
        input.with(&map, call).unwrap_or_else(|| Err(broken("it is too short")))
    }

    fn prepare(&mut self, input: InputRecord) -> PluginResult<u64> {
        let state = self.with_input(&input, |input| self.code.prepare(input, &self.calls))?;
        let map = self.shared.map(input.range).map_err(broken)?;
        self.made += 1;
        self.states.insert(self.made, (state, input, map));
        Ok(self.made)
    }

    fn deform(
        &mut self,
        state: u64,
        scratch: u64,
        motion: &protocol::MotionRecord,
        out: Slice,
        fill: [f32; 3],
    ) -> PluginResult<()> {
        let (state, input, map) = self.states.get(&state).ok_or_else(|| broken("there is no such state"))?;
        let scratch = self.scratches.get_mut(&scratch).ok_or_else(|| broken("there is no such scratch"))?;
        let (samples, attributes) = input.samples(map).ok_or_else(|| broken("it is too short"))?;
        let mut buffer = self.shared.map_mut(out.range).map_err(broken)?;
        let out: &mut [[f32; 3]] = bytemuck::cast_slice_mut(&mut buffer[..out.len as usize]);
        out.fill(fill);
        motion.with(samples, attributes, input.bounds(), |input| {
            self.code.deform(state, input, scratch, out, &self.calls)
        })
    }

    fn evaluate(&self, state: u64, motion: &protocol::MotionRecord, points: Slice) -> PluginResult<()> {
        let (state, input, map) = self.states.get(&state).ok_or_else(|| broken("there is no such state"))?;
        let (samples, attributes) = input.samples(map).ok_or_else(|| broken("it is too short"))?;
        let mut buffer = self.shared.map_mut(points.range).map_err(broken)?;
        let points = bytemuck::cast_slice_mut(&mut buffer[..points.len as usize]);
        motion.with(samples, attributes, input.bounds(), |input| {
            self.code.evaluate(state, input, points, &self.calls)
        })
    }
}

/// The program as the plugin sees it from here.
struct Calls {
    control: ControlMap,
    socket: Mutex<UnixStream>,
    /// Lines passed on in this call.
    lines: AtomicUsize,
}

impl Calls {
    fn send(&self, reply: &Reply) {
        let mut socket = self.socket.lock().unwrap_or_else(PoisonError::into_inner);
        if protocol::send(&mut *socket, reply).is_err() {
            // The program has gone.
            end();
        }
    }

    fn goes_on(&self) -> bool {
        self.control.cancel.load(Ordering::Relaxed) == 0
    }
}

impl HostCalls for Calls {
    fn progress(&self, fraction: f64) -> bool {
        self.control.beat(fraction);
        self.goes_on()
    }

    fn log(&self, level: LogLevel, message: &str) {
        let (_, fraction) = self.control.read();
        self.control.beat(fraction);
        if self.lines.fetch_add(1, Ordering::Relaxed) < LINES {
            self.send(&Reply::Log { level: level.0, text: crate::deformer::line(message) });
        }
    }

    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        let part = |i| {
            if !self.goes_on() {
                return Err(());
            }
            let kept = Care::Registers.enter();
            body(i);
            drop(kept);
            let (_, fraction) = self.control.read();
            self.control.beat(fraction);
            Ok(())
        };
        // A single part takes less time here than another thread takes to wake up.
        let work = if count == 1 { part(0) } else { (0..count).into_par_iter().try_for_each(part) };
        work.is_ok()
    }
}
