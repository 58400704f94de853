//! Opaque handles: the only unsafe code of the crate, besides the exported symbol.
//!
//! A handle is a pointer with the functions that know what it points to. Both sides are compiled from this
//! module, at versions whose layouts the loader compared; that the functions of a handle fit its pointer is
//! by construction, since the fields are private. What a handle's content is read back as is checked at run
//! time.
#![allow(unsafe_code, reason = "type-erased pointers cross the boundary; each block has its argument")]

use crate::{
    EvaluateExtension, Graph, HandleMotions, HandlesExtension, HostCalls, IsIdentityExtension, Joints,
    LogLevel, PluginError, PluginResult, Strokes, Triangles,
};
use abi_stable::{
    StableAbi,
    std_types::{ROption, RStr},
};
use std::any::{Any, TypeId};
use std::ffi::c_void;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Mutex, PoisonError};

/// Tells types of one library apart, and nearly surely those of different ones.
fn type_tag<T: 'static>() -> u64 {
    let mut hasher = DefaultHasher::new();
    TypeId::of::<T>().hash(&mut hasher);
    hasher.finish()
}

/// Frees a `Box<T>`; a panic in `T`'s destructor is swallowed, as nothing may unwind across the boundary.
extern "C" fn drop_box<T>(data: *mut c_void) {
    // SAFETY: called once, by the owning handle's `Drop`, with the pointer that `Box::into_raw` gave for a
    // `Box<T>` of the same `T` (see `new` of the handles).
    let content = unsafe { Box::from_raw(data.cast::<T>()) };
    if let Err(payload) = catch_unwind(AssertUnwindSafe(|| drop(content))) {
        // A payload's own destructor may panic too.
        std::mem::forget(payload);
    }
}

/// What a plugin prepared: immutable, shared by threads, freed by the code that made it.
#[repr(C)]
#[derive(StableAbi, Debug)]
pub struct State {
    data: *mut c_void,
    tag: u64,
    free: extern "C" fn(*mut c_void),
}

// SAFETY: `new` takes `Send + Sync` content only, and the fields are private.
unsafe impl Send for State {}
// SAFETY: as above; only shared references to the content are handed out.
unsafe impl Sync for State {}

impl State {
    /// Takes over the content.
    pub fn new<T: Send + Sync + 'static>(content: T) -> Self {
        Self { data: Box::into_raw(Box::new(content)).cast(), tag: type_tag::<T>(), free: drop_box::<T> }
    }

    /// The content, where it is a `T`: nothing for another plugin's state.
    pub fn get<T: 'static>(&self) -> Option<&T> {
        // SAFETY: `data` came from a `Box<T>` with this `T`, as the tag tells, lives as long as `self`, and
        // is never handed out mutably.
        (self.tag == type_tag::<T>()).then(|| unsafe { &*self.data.cast::<T>() })
    }
}

impl Drop for State {
    fn drop(&mut self) {
        (self.free)(self.data);
    }
}

/// A plugin's working memory for one sequence of `deform` calls, kept by the host between them.
#[repr(C)]
#[derive(StableAbi, Debug)]
pub struct Scratch {
    data: *mut c_void,
    tag: u64,
    free: extern "C" fn(*mut c_void),
}

// SAFETY: `new` takes `Send` content only, and the fields are private.
unsafe impl Send for Scratch {}

impl Scratch {
    /// Takes over the content.
    pub fn new<T: Send + 'static>(content: T) -> Self {
        Self { data: Box::into_raw(Box::new(content)).cast(), tag: type_tag::<T>(), free: drop_box::<T> }
    }

    /// The content, where it is a `T`: nothing for another plugin's scratch.
    pub fn get_mut<T: 'static>(&mut self) -> Option<&mut T> {
        // SAFETY: `data` came from a `Box<T>` with this `T`, as the tag tells, lives as long as `self`, and
        // is borrowed as mutably as `self` is.
        (self.tag == type_tag::<T>()).then(|| unsafe { &mut *self.data.cast::<T>() })
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        (self.free)(self.data);
    }
}

/// The host as a plugin sees it, for the length of one call. Its calls are cheap, from any thread.
#[repr(C)]
#[derive(StableAbi, Debug)]
pub struct Host<'a> {
    context: *const c_void,
    progress: extern "C" fn(*const c_void, f64) -> bool,
    log: extern "C" fn(*const c_void, LogLevel, RStr<'_>),
    extension: extern "C" fn(*const c_void, RStr<'_>) -> ROption<Extension>,
    parallel: extern "C" fn(*const c_void, usize, &Job) -> bool,
    lifetime: PhantomData<&'a c_void>,
}

// SAFETY: `new` takes `HostCalls` only, which are `Sync`; all access is through shared references.
unsafe impl Send for Host<'_> {}
// SAFETY: as above.
unsafe impl Sync for Host<'_> {}

impl<'a> Host<'a> {
    /// Makes the host callable across the boundary.
    pub fn new<T: HostCalls>(calls: &'a T) -> Self {
        Self {
            context: std::ptr::from_ref(calls).cast(),
            progress: call_progress::<T>,
            log: call_log::<T>,
            extension: call_extension::<T>,
            parallel: call_parallel::<T>,
            lifetime: PhantomData,
        }
    }

    pub(crate) fn call_progress(&self, fraction: f64) -> bool {
        (self.progress)(self.context, fraction)
    }

    /// A line for the user.
    pub fn log(&self, level: LogLevel, message: &str) {
        (self.log)(self.context, level, message.into());
    }

    /// Calls `body` once for each number below `count`, in any order, several at once on the host's threads:
    /// a plugin with threads of its own would crowd the cores. Returns when all is done; may be called from
    /// within itself.
    ///
    /// A call costs about a microsecond, and so should `body`, or more: give it a block of samples, not a
    /// single one.
    ///
    /// # Errors
    /// The user asked to stop: some were not called. To be returned as it is.
    ///
    /// # Panics
    /// If `body` does, once the others are done.
    pub fn parallel_for(&self, count: usize, body: impl Fn(usize) + Sync) -> PluginResult<()> {
        let work = Work { body: &body, panic: Mutex::new(None) };
        let job = Job { work: std::ptr::from_ref(&work).cast(), run };
        let done = (self.parallel)(self.context, count, &job);
        if let Some(payload) = work.panic.into_inner().unwrap_or_else(PoisonError::into_inner) {
            resume_unwind(payload);
        }
        if done { Ok(()) } else { Err(PluginError::cancelled()) }
    }

    /// Calls `body` for blocks of `size` entries (the last one may have less), with the place of the first:
    /// as [`parallel_for`](Self::parallel_for).
    ///
    /// # Errors
    /// The user asked to stop.
    ///
    /// # Panics
    /// If `body` does, or `size` is 0.
    pub fn parallel_blocks<T: Send>(
        &self,
        entries: &mut [T],
        size: usize,
        body: impl Fn(usize, &mut [T]) + Sync,
    ) -> PluginResult<()> {
        let blocks: Vec<Mutex<&mut [T]>> = entries.chunks_mut(size).map(Mutex::new).collect();
        self.parallel_for(blocks.len(), |i| {
            // Each is locked once.
            body(i * size, &mut blocks[i].lock().unwrap_or_else(PoisonError::into_inner));
        })
    }

    /// A capability of the host, by id, such as later versions may add.
    pub fn extension(&self, id: &str) -> Option<Extension> {
        (self.extension)(self.context, id.into()).into_option()
    }
}

/// The host's side of a call from a plugin; a panic of the host's gives `or`.
fn guarded<T: HostCalls, R>(context: *const c_void, or: R, call: impl FnOnce(&T) -> R) -> R {
    // SAFETY: `context` came from the `&'a T` that `Host::new` was given together with the functions below
    // for the same `T`; a `Host<'a>` cannot outlive it.
    let calls = unsafe { &*context.cast::<T>() };
    catch_unwind(AssertUnwindSafe(|| call(calls))).unwrap_or_else(|payload| {
        std::mem::forget(payload);
        or
    })
}

extern "C" fn call_progress<T: HostCalls>(context: *const c_void, fraction: f64) -> bool {
    guarded(context, false, |calls: &T| calls.progress(fraction))
}

extern "C" fn call_log<T: HostCalls>(context: *const c_void, level: LogLevel, message: RStr<'_>) {
    guarded(context, (), |calls: &T| calls.log(level, message.as_str()));
}

/// What a plugin has done in parallel, and the first panic of it.
struct Work<'b> {
    body: &'b (dyn Fn(usize) + Sync),
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

/// The same across the boundary.
#[repr(C)]
#[derive(StableAbi)]
struct Job {
    work: *const c_void,
    run: extern "C" fn(&Job, usize),
}

// SAFETY: `work` points to a `Work`, which is `Sync`.
unsafe impl Sync for Job {}

extern "C" fn run(job: &Job, i: usize) {
    // SAFETY: a `Job` is made in `parallel_for` alone, of the `Work` there, which outlives the host's call;
    // only shared references to it are made.
    let work = unsafe { &*job.work.cast::<Work<'_>>() };
    if let Err(payload) = catch_unwind(AssertUnwindSafe(|| (work.body)(i))) {
        let mut first = work.panic.lock().unwrap_or_else(PoisonError::into_inner);
        // A payload's destructor may panic again.
        std::mem::forget(if first.is_none() { first.replace(payload) } else { Some(payload) });
    }
}

extern "C" fn call_parallel<T: HostCalls>(context: *const c_void, count: usize, job: &Job) -> bool {
    guarded(context, false, |calls: &T| calls.parallel_for(count, &|i| (job.run)(job, i)))
}

extern "C" fn call_extension<T: HostCalls>(context: *const c_void, id: RStr<'_>) -> ROption<Extension> {
    guarded(context, None, |calls: &T| calls.extension(id.as_str())).into()
}

/// A table of functions that is known by an id.
///
/// # Safety
///
/// The type is `repr(C)`, of an ABI-stable layout that never changes under this id: a change needs another
/// id.
pub unsafe trait ExtensionInterface: Sync + 'static {
    /// The id, such as `simod.evaluate/1`; one per type and layout.
    const ID: &'static str;
}

// SAFETY: `repr(C)`, of ABI-stable fields; frozen.
unsafe impl ExtensionInterface for EvaluateExtension {
    const ID: &'static str = "simod.evaluate/1";
}

// SAFETY: as above.
unsafe impl ExtensionInterface for HandlesExtension {
    const ID: &'static str = "simod.handles/1";
}

// SAFETY: as above.
unsafe impl ExtensionInterface for IsIdentityExtension {
    const ID: &'static str = "simod.is-identity/1";
}

/// A capability beyond the root module: an untyped pointer to a table, with its id.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Extension {
    id: RStr<'static>,
    size: usize,
    table: *const c_void,
}

// SAFETY: the table is immutable, `'static` and `Sync`, as `ExtensionInterface` asks.
unsafe impl Send for Extension {}
// SAFETY: as above.
unsafe impl Sync for Extension {}

impl Extension {
    /// Offers a table.
    pub const fn new<T: ExtensionInterface>(table: &'static T) -> Self {
        Self {
            id: RStr::from_str(T::ID),
            size: size_of::<T>(),
            table: std::ptr::from_ref(table).cast::<c_void>(),
        }
    }

    /// The id that it is known by.
    pub fn id(&self) -> &'static str {
        self.id.as_str()
    }

    /// The table, where it is a `T`.
    pub fn get<T: ExtensionInterface>(&self) -> Option<&'static T> {
        let fits = self.id.as_str() == T::ID && self.size == size_of::<T>() && !self.table.is_null();
        // SAFETY: the other side made it with `new` from a `&'static` table of this id, whose layout is
        // frozen by the contract of `ExtensionInterface`; the size is checked besides.
        fits.then(|| unsafe { &*self.table.cast::<T>() })
    }
}

/// An input that is known by an id.
///
/// # Safety
///
/// The type is `repr(C)`, of an ABI-stable layout that never changes under this id: a change needs another
/// id. It borrows for `'a` what it borrows.
pub unsafe trait InputPart<'a>: Sync + 'a {
    /// The id, such as `simod.triangles/1`; one per type and layout.
    const ID: &'static str;
}

// SAFETY: `repr(C)`, of ABI-stable fields; frozen.
unsafe impl<'a> InputPart<'a> for Triangles<'a> {
    const ID: &'static str = "simod.triangles/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for Graph<'a> {
    const ID: &'static str = "simod.graph/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for Joints<'a> {
    const ID: &'static str = "simod.joints/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for HandleMotions<'a> {
    const ID: &'static str = "simod.handle-motions/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for Strokes<'a> {
    const ID: &'static str = "simod.strokes/1";
}

/// An untyped pointer to an [`InputPart`], with its id.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Part<'a> {
    id: RStr<'static>,
    size: usize,
    data: *const c_void,
    lifetime: PhantomData<&'a c_void>,
}

// SAFETY: what it points to is borrowed for `'a`, and `Sync`, as `InputPart` asks.
unsafe impl Send for Part<'_> {}
// SAFETY: as above.
unsafe impl Sync for Part<'_> {}

impl<'a> Part<'a> {
    /// Offers an input.
    pub fn new<T: InputPart<'a>>(part: &'a T) -> Self {
        Self {
            id: RStr::from_str(T::ID),
            size: size_of::<T>(),
            data: std::ptr::from_ref(part).cast(),
            lifetime: PhantomData,
        }
    }

    /// The input, where it is a `T`.
    pub fn get<T: InputPart<'a>>(&self) -> Option<&'a T> {
        let fits = self.id.as_str() == T::ID && self.size == size_of::<T>();
        // SAFETY: the other side made it with `new` from a `&'a` of this id, whose layout is frozen by the
        // contract of `InputPart`; the size is checked besides. `T` borrows for `'a`, as what was offered
        // did.
        fits.then(|| unsafe { &*self.data.cast::<T>() })
    }
}
