//! Opaque handles: the only unsafe code of the crate, besides the exported symbol.
//!
//! A handle is a pointer with the functions that know what it points to. Both sides are compiled from this
//! module, at versions whose layouts the loader compared; that the functions of a handle fit its pointer is
//! by construction, since the fields are private. What a handle's content is read back as is checked at run
//! time.
#![allow(unsafe_code, reason = "type-erased pointers cross the boundary; each block has its argument")]

use crate::{
    Attributes, Effort, EvaluateExtension, Graph, HandleFacesExtension, HandleMotions, HandlesExtension,
    HostCalls, IsIdentityExtension, Joints, LogLevel, Lookups, MigrationExtension, ModelFrame,
    NearestService, OtherModels, PluginError, PluginResult, Pose, RestPositions, Strokes, SurfacePoint,
    SurfaceService, Time, Triangles,
};
use abi_stable::{
    StableAbi,
    std_types::{ROption, RSliceMut, RStr},
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

/// State that a plugin prepared: immutable, shared by threads, freed by the code that made it.
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

/// Body that a plugin has called in parallel, and its first panic.
struct Work<'b> {
    body: &'b (dyn Fn(usize) + Sync),
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

/// The parallel work as it goes across the boundary.
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
    guarded(context, None, |calls: &T| match id.as_str() {
        NearestService::ID if calls.lookups().is_some() => {
            Some(const { Extension::new(&NearestService { has: has_samples::<T>, find: call_nearest::<T> }) })
        }
        SurfaceService::ID if calls.lookups().is_some() => Some(
            const {
                Extension::new(&SurfaceService {
                    has: has_triangles::<T>,
                    closest: call_closest::<T>,
                    ray: call_ray::<T>,
                })
            },
        ),
        id => calls.extension(id),
    })
    .into()
}

/// A look-up for a plugin. The tables' functions are called by [`Nearest`](crate::Nearest) and
/// [`Surface`](crate::Surface) alone, with the host that gave the table: of the same `T`.
fn look_up<T: HostCalls, R>(host: &Host<'_>, or: R, call: impl FnOnce(&dyn Lookups) -> R) -> R {
    guarded(host.context, None, |calls: &T| calls.lookups().map(call)).unwrap_or(or)
}

extern "C" fn has_samples<T: HostCalls>(host: &Host<'_>, pose: Pose) -> bool {
    look_up::<T, _>(host, false, |lookups| lookups.has_samples(pose))
}

extern "C" fn has_triangles<T: HostCalls>(host: &Host<'_>, pose: Pose) -> bool {
    look_up::<T, _>(host, false, |lookups| lookups.has_triangles(pose))
}

extern "C" fn call_nearest<T: HostCalls>(
    host: &Host<'_>,
    pose: Pose,
    point: &[f64; 3],
    radius: f64,
    mut found: RSliceMut<'_, u32>,
) -> usize {
    look_up::<T, _>(host, 0, |lookups| lookups.nearest(pose, *point, radius, found.as_mut_slice()))
}

/// Writes down the point that was found, if any, and returns whether there was one.
fn give(found: Option<SurfacePoint>, to: &mut SurfacePoint) -> bool {
    found.map(|found| *to = found).is_some()
}

extern "C" fn call_closest<T: HostCalls>(
    host: &Host<'_>,
    pose: Pose,
    point: &[f64; 3],
    radius: f64,
    to: &mut SurfacePoint,
) -> bool {
    give(look_up::<T, _>(host, None, |lookups| lookups.closest(pose, *point, radius)), to)
}

extern "C" fn call_ray<T: HostCalls>(
    host: &Host<'_>,
    pose: Pose,
    origin: &[f64; 3],
    direction: &[f64; 3],
    reach: f64,
    to: &mut SurfacePoint,
) -> bool {
    give(look_up::<T, _>(host, None, |lookups| lookups.ray(pose, *origin, *direction, reach)), to)
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
unsafe impl ExtensionInterface for HandleFacesExtension {
    const ID: &'static str = "simod.handle-faces/1";
}

// SAFETY: as above.
unsafe impl ExtensionInterface for IsIdentityExtension {
    const ID: &'static str = "simod.is-identity/1";
}

// SAFETY: as above.
unsafe impl ExtensionInterface for MigrationExtension {
    const ID: &'static str = "simod.migration/1";
}

// SAFETY: as above.
unsafe impl ExtensionInterface for NearestService {
    const ID: &'static str = "simod.nearest/1";
}

// SAFETY: as above.
unsafe impl ExtensionInterface for SurfaceService {
    const ID: &'static str = "simod.surface/1";
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

// SAFETY: as above.
unsafe impl InputPart<'_> for ModelFrame {
    const ID: &'static str = "simod.model-frame/1";
}

// SAFETY: as above.
unsafe impl InputPart<'_> for Effort {
    const ID: &'static str = "simod.effort/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for RestPositions<'a> {
    const ID: &'static str = "simod.rest-positions/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for Attributes<'a> {
    const ID: &'static str = "simod.attributes/1";
}

// SAFETY: as above.
unsafe impl<'a> InputPart<'a> for OtherModels<'a> {
    const ID: &'static str = "simod.other-models/1";
}

// SAFETY: as above.
unsafe impl InputPart<'_> for Time {
    const ID: &'static str = "simod.time/1";
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    struct CountsDrops(Arc<AtomicUsize>);
    impl Drop for CountsDrops {
        fn drop(&mut self) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn handles_give_their_content_and_free_it_once() {
        let drops = Arc::new(AtomicUsize::new(0));
        let state = State::new(CountsDrops(drops.clone()));
        assert!(state.get::<CountsDrops>().is_some());
        assert!(state.get::<u32>().is_none());
        drop(state);
        let mut scratch = Scratch::new((CountsDrops(drops.clone()), 7));
        scratch.get_mut::<(CountsDrops, i32)>().unwrap().1 += 1;
        assert_eq!(scratch.get_mut::<(CountsDrops, i32)>().unwrap().1, 8);
        assert!(scratch.get_mut::<i32>().is_none());
        drop(scratch);
        assert_eq!(drops.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn a_panicking_host_stops_the_plugin() {
        struct Bad;
        impl HostCalls for Bad {
            fn progress(&self, _: f64) -> bool {
                panic!("host")
            }
            fn log(&self, _: LogLevel, _: &str) {}
        }
        assert!(Host::new(&Bad).progress(0.5).is_err());
        assert!(Host::new(&()).progress(0.5).is_ok());
        assert!(Host::new(&()).extension("simod.graph/1").is_none());
    }

    #[test]
    fn work_is_handed_out_whole_and_panics_come_back() {
        let host = Host::new(&());
        let mut numbers = vec![0; 1001];
        host.parallel_blocks(&mut numbers, 10, |first, block| {
            block.iter_mut().enumerate().for_each(|(i, n)| *n += first + i);
        })
        .unwrap();
        assert!(numbers.iter().enumerate().all(|(i, n)| i == *n));
        let done = AtomicUsize::new(0);
        let panic = catch_unwind(AssertUnwindSafe(|| {
            host.parallel_for(9, |i| {
                assert!(i % 4 != 3, "at {i}");
                done.fetch_add(1, Ordering::Relaxed);
            })
        }));
        assert_eq!(panic.unwrap_err().downcast_ref::<String>().map(String::as_str), Some("at 3"));
        assert_eq!(done.load(Ordering::Relaxed), 7);
    }
}
