//! Plugins in processes of their own, which keep the program from harm that plugins do to themselves.
//!
//! The program starts itself once more for each such plugin that is called ([`serve`] is what it then does).
//! Requests go over a socket, arrays through shared memory: those of the samples are copied once for each
//! preparation, and a deformation copies its result. A plugin that crashes, that takes more memory than it
//! may have, or that gives no sign of life ends that process alone; the next call starts another one.

mod arena;
mod protocol;
mod serve;

use crate::child::{Ended, Tail, describe, ran_out_of_memory};
use crate::deformer::{About, Capabilities, Code, Migration, OwnHandles};
use arena::{Arena, ArenaRange, ControlMap};
use protocol::{InputRecord, LibraryRefusal, MotionRecord, Reply, Request, SettingRecord, Slice};
use simod_model::{Error, Progress, Result};
use simod_plugin_api::{
    DeformInput, Descriptor, ErrorCode, HostCalls, LogLevel, PluginError, PluginResult, PrepareInput,
    Scratch, Setting, State,
};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use serve::serve;

/// Time between two looks at the user's wish to stop.
const INTERVAL: Duration = Duration::from_millis(5);

/// Longest time that a plugin may go on when it was asked to stop.
const GRACE: Duration = Duration::from_secs(2);

/// Options of running plugins' processes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorkerOptions {
    /// Program and arguments of the worker's process; the arguments make it call [`serve`] with the three
    /// that follow them.
    pub command: Vec<PathBuf>,
    /// Longest time that a call may go on without any sign of life, as progress is one.
    pub silence: Duration,
    /// Most memory that a plugin may take, in bytes (on Linux).
    pub memory: u64,
}

/// Longest time that a plugin in a process of its own may give no sign of life, unless another is given.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Most memory that a plugin in a process of its own may take, in bytes, unless another limit is given.
pub const MEMORY: u64 = 4 << 30;

impl WorkerOptions {
    /// Options for workers that are `simod` itself, with the usual limits.
    pub fn for_program(program: &Path) -> Self {
        let command = vec![program.to_owned(), "plugin".into(), "serve".into()];
        Self { command, silence: PATIENCE, memory: MEMORY }
    }
}

/// A plugin's code in another process, which is started when it is first called.
pub(crate) struct WorkerCode {
    library: PathBuf,
    options: Arc<WorkerOptions>,
    about: About,
    worker: Mutex<Option<Arc<Worker>>>,
}

/// A plugin's process.
struct Worker {
    link: Mutex<ProcessLink>,
    control: ControlMap,
    child: Mutex<Ended>,
    errors: Tail,
    /// Requests to drop things in the process, which are sent before the next call, with the memory that each
    /// leaves.
    drops: Mutex<Vec<(Request, Option<ArenaRange>)>>,
}

/// Connection to a process; the thread that holds it talks to the process alone.
struct ProcessLink {
    socket: UnixStream,
    replies: Receiver<Reply>,
    arena: Arena,
    is_dead: bool,
}

/// A state in another process.
struct WorkerState {
    worker: Arc<Worker>,
    id: u64,
    input: ArenaRange,
}

/// A scratch in another process.
struct WorkerScratch {
    worker: Arc<Worker>,
    id: u64,
}

impl Drop for WorkerState {
    fn drop(&mut self) {
        self.worker.drop_later(Request::DropState(self.id), Some(self.input));
    }
}

impl Drop for WorkerScratch {
    fn drop(&mut self) {
        self.worker.drop_later(Request::DropScratch(self.id), None);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Starts a process for a library, asks for the library's description, and ends the process again.
pub(crate) fn ask(library: &Path, options: &Arc<WorkerOptions>, progress: &dyn Progress) -> Result<About> {
    Worker::start(library, options, &StopRequest(progress)).map(|(_, about)| about)
}

/// The wish of the user to stop, and nothing else.
struct StopRequest<'a>(&'a dyn Progress);

impl HostCalls for StopRequest<'_> {
    fn progress(&self, _: f64) -> bool {
        !self.0.is_cancelled()
    }

    fn log(&self, _: LogLevel, _: &str) {}
}

impl WorkerCode {
    /// The code of a library that says this about itself. Starts nothing.
    pub fn new(library: &Path, about: About, options: Arc<WorkerOptions>) -> Self {
        Self { library: library.to_owned(), options, about, worker: Mutex::new(None) }
    }

    /// The process, started if there is none.
    fn worker(&self, calls: &dyn HostCalls) -> PluginResult<Arc<Worker>> {
        let mut worker = lock(&self.worker);
        if let Some(worker) = worker.as_ref()
            && !lock(&worker.link).is_dead
        {
            return Ok(worker.clone());
        }
        let (started, about) = Worker::start(&self.library, &self.options, calls)
            .map_err(|e| PluginError::internal(e.to_string()).hint(e.hint()))?;
        if about != self.about {
            let hint = "run the command again";
            return Err(PluginError::internal("the library was replaced meanwhile").hint(hint));
        }
        Ok(worker.insert(Arc::new(started)).clone())
    }

    /// Sends a request to the plugin's process, and returns the answer. `call` names it in errors.
    fn call(
        &self,
        worker: &Worker,
        link: &mut ProcessLink,
        call: &str,
        request: &Request,
        calls: &dyn HostCalls,
    ) -> PluginResult<Reply> {
        worker.call(link, request, calls, self.options.silence).map_err(|end| {
            link.is_dead = true;
            end.explain(call, self.options.memory)
        })
    }

    /// Sends an input to the process, and a request on it; returns the answer.
    fn call_with_input(
        &self,
        call: &str,
        input: &PrepareInput<'_>,
        calls: &dyn HostCalls,
        request: impl FnOnce(InputRecord) -> Request,
    ) -> PluginResult<(Arc<Worker>, ArenaRange, Reply)> {
        let worker = self.worker(calls)?;
        let mut link = lock(&worker.link);
        let (mut record, arrays) = InputRecord::new(input);
        record.range = link.put(&arrays)?;
        let range = record.range;
        let reply = self.call(&worker, &mut link, call, &request(record), calls)?;
        drop(link);
        Ok((worker, range, reply))
    }

    /// State, if it belongs to the process that is there now.
    fn own<'a, T>(&self, worker: &Arc<Worker>, of: &Arc<Worker>, content: &'a T) -> PluginResult<&'a T> {
        if Arc::ptr_eq(worker, of) {
            return Ok(content);
        }
        let hint = "the next edit prepares it again";
        Err(PluginError::internal("the plugin's process ended after it had prepared this").hint(hint))
    }
}

fn foreign() -> PluginError {
    PluginError::internal("the state or scratch is another plugin's")
}

/// Error of an answer to another request: the process is out of order.
fn confused() -> PluginError {
    PluginError::internal("the plugin's process answered another question")
}

impl Code for WorkerCode {
    fn descriptor(&self) -> PluginResult<Descriptor> {
        Ok(self.about.descriptor.clone())
    }

    fn capabilities(&self) -> Capabilities {
        self.about.capabilities
    }

    fn migration(&self) -> PluginResult<Option<Migration>> {
        Ok(self.about.migration.clone())
    }

    fn is_isolated(&self) -> bool {
        true
    }

    fn get_ready(&self, calls: &dyn HostCalls) -> PluginResult<()> {
        self.worker(calls).map(drop)
    }

    fn prepare(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<State> {
        let (worker, input, reply) = self.call_with_input("prepare", input, calls, Request::Prepare)?;
        match reply {
            Reply::Made(Ok(id)) => Ok(State::new(WorkerState { worker, id, input })),
            Reply::Made(Err(failure)) => {
                lock(&worker.link).arena.release(input);
                Err(failure.into())
            }
            _ => Err(confused()),
        }
    }

    fn new_scratch(&self) -> PluginResult<Scratch> {
        let worker = self.worker(&())?;
        let mut link = lock(&worker.link);
        let reply = self.call(&worker, &mut link, "new_scratch", &Request::NewScratch, &())?;
        drop(link);
        match reply {
            Reply::Made(Ok(id)) => Ok(Scratch::new(WorkerScratch { worker, id })),
            Reply::Made(Err(failure)) => Err(failure.into()),
            _ => Err(confused()),
        }
    }

    fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let worker = self.worker(calls)?;
        let state = state.get::<WorkerState>().ok_or_else(foreign)?;
        let state = self.own(&worker, &state.worker, state)?.id;
        let scratch = scratch.get_mut::<WorkerScratch>().ok_or_else(foreign)?;
        let scratch = self.own(&worker, &scratch.worker, scratch)?.id;
        let motion = MotionRecord::new(input);
        let mut link = lock(&worker.link);
        let range = link.arena.allocate(size_of_val(out)).map_err(no_memory)?;
        // Positions that the plugin does not write show by the value with which the caller has filled all of
        // them.
        let fill = out.first().copied().unwrap_or_default();
        let array = bytemuck::cast_slice_mut(out);
        let slice = Slice { range, len: array.len() as u64 };
        let request = Request::Deform { state, scratch, motion, out: slice, fill };
        self.take_back(&worker, &mut link, "deform", &request, range, array, calls)
    }

    fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        let worker = self.worker(calls)?;
        let state = state.get::<WorkerState>().ok_or_else(foreign)?;
        let state = self.own(&worker, &state.worker, state)?.id;
        let motion = MotionRecord::new(input);
        let mut link = lock(&worker.link);
        let array = bytemuck::cast_slice_mut(points);
        let range = link.put(&[array])?;
        let slice = Slice { range, len: array.len() as u64 };
        let request = Request::Evaluate { state, motion, points: slice };
        self.take_back(&worker, &mut link, "evaluate", &request, range, array, calls)
    }

    fn handles(&self, input: &PrepareInput<'_>, calls: &dyn HostCalls) -> PluginResult<OwnHandles> {
        let (worker, range, reply) = self.call_with_input("handles", input, calls, Request::Handles)?;
        lock(&worker.link).arena.release(range);
        match reply {
            Reply::Handles(Ok(handles)) => Ok(handles.into()),
            Reply::Handles(Err(failure)) => Err(failure.into()),
            _ => Err(confused()),
        }
    }

    fn is_identity(&self, input: &DeformInput<'_>) -> PluginResult<bool> {
        let worker = self.worker(&())?;
        let bounds = [input.bounds.min, input.bounds.max];
        let request = Request::IsIdentity { bounds, motion: MotionRecord::new(input) };
        let mut link = lock(&worker.link);
        match self.call(&worker, &mut link, "is_identity", &request, &())? {
            Reply::Identity(answer) => answer.map_err(PluginError::from),
            _ => Err(confused()),
        }
    }

    fn migrate(&self, from: u32, settings: Vec<Setting>) -> PluginResult<Vec<Setting>> {
        let worker = self.worker(&())?;
        let request = Request::Migrate(from, settings.into_iter().map(SettingRecord::from).collect());
        let mut link = lock(&worker.link);
        match self.call(&worker, &mut link, "migrate", &request, &())? {
            Reply::Settings(Ok(settings)) => Ok(settings.into_iter().map(Setting::from).collect()),
            Reply::Settings(Err(failure)) => Err(failure.into()),
            _ => Err(confused()),
        }
    }
}

impl WorkerCode {
    /// Sends a request that writes an array to a range of the shared memory, and takes the array from there.
    #[expect(clippy::too_many_arguments, reason = "the call's own, and the two places")]
    fn take_back(
        &self,
        worker: &Worker,
        link: &mut ProcessLink,
        call: &str,
        request: &Request,
        range: ArenaRange,
        array: &mut [u8],
        calls: &dyn HostCalls,
    ) -> PluginResult<()> {
        match self.call(worker, link, call, request, calls)? {
            Reply::Done(done) => {
                let map = link.arena.shared().map(range).map_err(no_memory)?;
                array.copy_from_slice(&map[..array.len()]);
                link.arena.release(range);
                done.map_err(PluginError::from)
            }
            _ => Err(confused()),
        }
    }
}

fn no_memory(e: std::io::Error) -> PluginError {
    PluginError::internal(format!("there is no memory to share with the plugin's process: {e}"))
        .hint("free some memory, or run it in this process with `--isolate never`")
}

impl ProcessLink {
    /// Copies arrays to a new range of the shared memory, one after the other.
    fn put(&mut self, arrays: &[&[u8]]) -> PluginResult<ArenaRange> {
        let bytes = arrays.iter().map(|a| a.len()).sum();
        let range = self.arena.allocate(bytes).map_err(no_memory)?;
        let mut map = self.arena.shared().map_mut(range).map_err(no_memory)?;
        let mut rest = &mut map[..bytes];
        for array in arrays {
            let (to, after) = rest.split_at_mut(array.len());
            to.copy_from_slice(array);
            rest = after;
        }
        Ok(range)
    }
}

/// The end of a process during a call.
enum CallEnd {
    /// The process ended by itself; how, and the last line that it printed.
    Died { how: String, last_words: String, is_memory: bool },
    /// The process gave no sign of life, and was ended.
    Silent(Duration),
    /// The process did not stop when it was asked to, and was ended.
    Deaf,
}

impl CallEnd {
    fn explain(self, call: &str, memory: u64) -> PluginError {
        let check = "leave the step out, or choose other parameters; `simod plugin check` tells the plugin's author more";
        let error = |what: String| PluginError::new(ErrorCode::INTERNAL, what).hint(check);
        match self {
            Self::Died { is_memory: true, .. } => {
                error(format!("ran out of the {} MB that it may have, in {call}", memory >> 20))
            }
            Self::Died { how, last_words, .. } if last_words.is_empty() => {
                error(format!("its process {how} in {call}"))
            }
            Self::Died { how, last_words, .. } => error(format!("its process {how} in {call}: {last_words}")),
            Self::Silent(time) => error(format!(
                "{call} gave no sign of life for {} s and was ended",
                time.as_secs_f64().round()
            )),
            Self::Deaf => PluginError::cancelled(),
        }
    }
}

impl Worker {
    /// Starts a process for a library, and receives the library's description.
    fn start(library: &Path, options: &Arc<WorkerOptions>, calls: &dyn HostCalls) -> Result<(Self, About)> {
        let refused = |e: std::io::Error| {
            let what = format!("cannot start a process for the plugin {}: {e}", library.display());
            Error::system(what, "check the limits on processes and memory, or use `--isolate never`")
        };
        let (mut socket, theirs) = UnixStream::pair().map_err(refused)?;
        let arena = Arena::create().map_err(refused)?;
        let control = ControlMap::new(arena.shared()).map_err(refused)?;
        let mut child = serving(library, options, theirs, &arena).and_then(Ended::start).map_err(refused)?;
        let errors = Tail::read(child.stderr());
        let replies = replies(&socket).map_err(refused)?;
        // A process that has ended already is reported below.
        let _ = protocol::send(&mut socket, &Request::Load);
        let this = Self {
            link: Mutex::new(ProcessLink { socket, replies, arena, is_dead: false }),
            control,
            child: Mutex::new(child),
            errors,
            drops: Mutex::new(Vec::new()),
        };
        // A worker whose loading is not wanted any more is not waited for.
        let loaded = this.wait(&lock(&this.link), calls, options.silence, Duration::ZERO);
        match loaded {
            Ok(Reply::Loaded(Ok(about))) => Ok((this, *about)),
            Ok(Reply::Loaded(Err(LibraryRefusal { what, hint }))) => Err(Error::plugin(what, hint)),
            Ok(_) => Err(refused(std::io::Error::other("it says what it was not asked"))),
            Err(CallEnd::Deaf) => Err(Error::cancelled()),
            Err(end) => {
                let error = end.explain("loading", options.memory);
                let what = format!("{}: {}", library.display(), error.message);
                Err(Error::plugin(what, error.hint.as_str()))
            }
        }
    }

    fn drop_later(&self, request: Request, range: Option<ArenaRange>) {
        lock(&self.drops).push((request, range));
    }

    /// Sends a request, and waits for its answer.
    fn call(
        &self,
        link: &mut ProcessLink,
        request: &Request,
        calls: &dyn HostCalls,
        silence: Duration,
    ) -> std::result::Result<Reply, CallEnd> {
        for (request, range) in std::mem::take(&mut *lock(&self.drops)) {
            protocol::send(&mut link.socket, &request).map_err(|_| self.death())?;
            range.into_iter().for_each(|range| link.arena.release(range));
        }
        self.control.reset();
        protocol::send(&mut link.socket, request).map_err(|_| self.death())?;
        self.wait(link, calls, silence, GRACE)
    }

    /// Waits for an answer, and passes on the messages before it. Where the user asks to stop, the plugin has
    /// the time `grace` to do so.
    fn wait(
        &self,
        link: &ProcessLink,
        calls: &dyn HostCalls,
        silence: Duration,
        grace: Duration,
    ) -> std::result::Result<Reply, CallEnd> {
        let (mut beats, _) = self.control.read();
        let mut heard = Instant::now();
        let mut asked_to_stop: Option<Instant> = None;
        loop {
            match link.replies.recv_timeout(INTERVAL) {
                Ok(Reply::Log { level, text }) => calls.log(LogLevel(level), &text),
                Ok(reply) => return Ok(reply),
                Err(RecvTimeoutError::Disconnected) => return Err(self.death()),
                Err(RecvTimeoutError::Timeout) => {}
            }
            let (beats_now, fraction) = self.control.read();
            if beats_now != beats {
                (beats, heard) = (beats_now, Instant::now());
            }
            if !calls.progress(fraction) {
                self.control.cancel.store(1, std::sync::atomic::Ordering::Relaxed);
                if asked_to_stop.get_or_insert_with(Instant::now).elapsed() >= grace {
                    lock(&self.child).kill();
                    return Err(CallEnd::Deaf);
                }
            } else if heard.elapsed() > silence {
                lock(&self.child).kill();
                return Err(CallEnd::Silent(silence));
            }
        }
    }

    /// End of a process that does not answer any more.
    fn death(&self) -> CallEnd {
        let status = lock(&self.child).end();
        let errors = self.errors.text();
        let last_words = errors.lines().rfind(|l| !l.trim().is_empty()).unwrap_or_default().trim();
        CallEnd::Died {
            how: status.map_or_else(|| "ended for no known reason".to_owned(), describe),
            is_memory: ran_out_of_memory(&errors),
            last_words: crate::deformer::line(last_words),
        }
    }
}

/// The command that serves a library over one end of a socket, with an arena.
fn serving(
    library: &Path,
    options: &WorkerOptions,
    theirs: UnixStream,
    arena: &Arena,
) -> std::io::Result<Command> {
    let [program, arguments @ ..] = options.command.as_slice() else {
        return Err(std::io::Error::other("no program is named"));
    };
    let mut command = Command::new(program);
    command.args(arguments).arg(library);
    command.args([options.memory.to_string(), std::process::id().to_string()]);
    command.env("RAYON_NUM_THREADS", rayon::current_num_threads().to_string());
    // Both ends of the connection are handed over as standard streams, which needs nothing unsafe. The
    // process moves them.
    command.stdin(Stdio::from(OwnedFd::from(theirs)));
    command.stdout(Stdio::from(arena.shared().file()?));
    command.stderr(Stdio::piped());
    Ok(command)
}

/// Replies of a process, read by a thread of their own until the process ends.
fn replies(socket: &UnixStream) -> std::io::Result<Receiver<Reply>> {
    let (sender, replies) = sync_channel(64);
    let mut reader = socket.try_clone()?;
    let read = move || {
        while let Ok(Some(reply)) = protocol::receive(&mut reader) {
            if sender.send(reply).is_err() {
                break;
            }
        }
    };
    std::thread::Builder::new().name("plugin".into()).spawn(read)?;
    Ok(replies)
}
