//! The host as a plugin in C sees it.

use super::read::{list, lossy};
use simod_plugin_api::c::{SIMOD_CANCELLED, SimodHost, SimodNearest, SimodSurface, SimodSurfacePoint};
use simod_plugin_api::{ErrorCode, HostCalls, LogLevel, PluginError, Pose, SurfacePoint};
use std::ffi::{c_char, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};

/// Listener to a plugin during one call.
pub(super) struct Ear<'a> {
    calls: &'a dyn HostCalls,
    /// The last error that the plugin told: the error in words, and advice.
    told: Mutex<Option<(String, String)>>,
}

impl<'a> Ear<'a> {
    /// Ear that passes on to the host what the plugin tells it.
    pub fn new(calls: &'a dyn HostCalls) -> Self {
        Self { calls, told: Mutex::new(None) }
    }

    /// Table of the host's functions that the plugin gets. It must not outlive `self`.
    pub fn host(&self) -> SimodHost {
        SimodHost { context: std::ptr::from_ref(self).cast(), progress, log, error, parallel_for, extension }
    }

    /// The error of a call that returned this, which is not success.
    pub fn into_error(self, status: u32) -> PluginError {
        let told = self.told.into_inner().unwrap_or_else(PoisonError::into_inner);
        match told.filter(|(message, _)| !message.trim().is_empty()) {
            Some((message, hint)) => PluginError::new(ErrorCode(status), message).hint(hint),
            None if status == SIMOD_CANCELLED => PluginError::cancelled(),
            None => PluginError::new(
                ErrorCode(status),
                format!("failed with code {status}, and does not say why"),
            )
            .hint(crate::deformer::TELL_AUTHOR),
        }
    }
}

/// The host's side of a call; a panic of the host's, which must not unwind into C, gives `or`.
fn guarded<R>(host: *const SimodHost, or: R, call: impl FnOnce(&Ear<'_>) -> R) -> R {
    if host.is_null() {
        return or;
    }
    // SAFETY: the header asks for the pointer that the plugin was given, during the call that it was given
    // to; that one's context is the `Ear` which made it, and outlives the call. It is `Sync`: any thread may
    // come.
    let ear = unsafe { &*(*host).context.cast::<Ear<'_>>() };
    catch_unwind(AssertUnwindSafe(|| call(ear))).unwrap_or_else(|payload| {
        // A payload's destructor may panic again.
        std::mem::forget(payload);
        or
    })
}

unsafe extern "C" fn progress(host: *const SimodHost, fraction: f64) -> bool {
    guarded(host, false, |ear| ear.calls.progress(fraction))
}

unsafe extern "C" fn log(host: *const SimodHost, level: u32, message: *const c_char) {
    // SAFETY: the header asks for a text.
    guarded(host, (), |ear| ear.calls.log(LogLevel(level), &unsafe { lossy(message) }));
}

unsafe extern "C" fn error(
    host: *const SimodHost,
    code: u32,
    message: *const c_char,
    hint: *const c_char,
) -> u32 {
    guarded(host, (), |ear| {
        // SAFETY: the header asks for texts, or NULL.
        let told = unsafe { (lossy(message), lossy(hint)) };
        *ear.told.lock().unwrap_or_else(PoisonError::into_inner) = Some(told);
    });
    code
}

/// Function of a plugin with the context that the plugin wants it to be called with.
struct PluginCall {
    call: unsafe extern "C" fn(*mut c_void, usize),
    context: *mut c_void,
}

// SAFETY: the header says that several threads call a body at once.
unsafe impl Sync for PluginCall {}

impl PluginCall {
    fn call(&self, i: usize) {
        // SAFETY: the plugin gave the function with this context, for the length of `parallel_for`.
        unsafe { (self.call)(self.context, i) }
    }
}

unsafe extern "C" fn parallel_for(
    host: *const SimodHost,
    count: usize,
    body: Option<unsafe extern "C" fn(*mut c_void, usize)>,
    context: *mut c_void,
) -> bool {
    let Some(call) = body else { return false };
    let body = PluginCall { call, context };
    guarded(host, false, |ear| ear.calls.parallel_for(count, &|i| body.call(i)))
}

/// The services that there are for the samples of the call.
unsafe extern "C" fn extension(host: *const SimodHost, id: *const c_char) -> *const c_void {
    static NEAREST: SimodNearest = SimodNearest { find };
    static SURFACE: SimodSurface = SimodSurface { has, closest, ray };
    // SAFETY: the header asks for a text.
    let id = unsafe { lossy(id) };
    guarded(host, std::ptr::null(), |ear| match id.as_str() {
        "simod.nearest/1" if ear.calls.lookups().is_some() => std::ptr::from_ref(&NEAREST).cast(),
        "simod.surface/1" if ear.calls.lookups().is_some() => std::ptr::from_ref(&SURFACE).cast(),
        _ => std::ptr::null(),
    })
}

/// Three numbers that a plugin points to.
///
/// # Safety
/// If it is not NULL and aligned, there are three.
unsafe fn three(numbers: *const f64) -> Option<[f64; 3]> {
    // SAFETY: by the contract.
    unsafe { list(numbers, 3, "numbers") }.ok()?.try_into().ok()
}

unsafe extern "C" fn find(
    host: *const SimodHost,
    pose: u32,
    point: *const f64,
    radius: f64,
    found: *mut u32,
    capacity: usize,
) -> usize {
    guarded(host, 0, |ear| {
        // SAFETY: the header asks for three numbers.
        let (Some(lookups), Some(point)) = (ear.calls.lookups(), unsafe { three(point) }) else { return 0 };
        let room: &mut [u32] = if capacity == 0 || found.is_null() || !found.is_aligned() {
            &mut []
        } else {
            // SAFETY: the header asks for room for so many, which is the plugin's own.
            unsafe { std::slice::from_raw_parts_mut(found, capacity) }
        };
        lookups.nearest(Pose(pose), point, radius, room)
    })
}

unsafe extern "C" fn has(host: *const SimodHost, pose: u32) -> bool {
    guarded(host, false, |ear| ear.calls.lookups().is_some_and(|lookups| lookups.has_triangles(Pose(pose))))
}

/// Writes a point that was found; returns whether there is one.
///
/// # Safety
/// If it is not NULL and aligned, there is room for a point.
unsafe fn put(found: Option<SurfacePoint>, to: *mut SimodSurfacePoint) -> bool {
    let Some(SurfacePoint { triangle, weights, position, distance }) = found else { return false };
    if to.is_null() || !to.is_aligned() {
        return false;
    }
    // SAFETY: by the contract.
    unsafe { to.write(SimodSurfacePoint { triangle, weights, position, distance }) };
    true
}

unsafe extern "C" fn closest(
    host: *const SimodHost,
    pose: u32,
    point: *const f64,
    radius: f64,
    found: *mut SimodSurfacePoint,
) -> bool {
    // SAFETY: the header asks for three numbers, and for room for a point.
    guarded(host, false, |ear| unsafe {
        let (Some(lookups), Some(point)) = (ear.calls.lookups(), three(point)) else { return false };
        put(lookups.closest(Pose(pose), point, radius), found)
    })
}

unsafe extern "C" fn ray(
    host: *const SimodHost,
    pose: u32,
    origin: *const f64,
    direction: *const f64,
    reach: f64,
    found: *mut SimodSurfacePoint,
) -> bool {
    // SAFETY: as above.
    guarded(host, false, |ear| unsafe {
        let (Some(lookups), Some(origin), Some(direction)) =
            (ear.calls.lookups(), three(origin), three(direction))
        else {
            return false;
        };
        put(lookups.ray(Pose(pose), origin, direction, reach), found)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    struct Full(AtomicUsize);
    impl HostCalls for Full {
        fn progress(&self, fraction: f64) -> bool {
            assert!(fraction < 1.0, "a host that panics");
            fraction < 0.5
        }
        fn log(&self, level: LogLevel, message: &str) {
            assert_eq!((level, message), (LogLevel::WARNING, "careful"));
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn the_host_hears_and_answers() {
        let calls = Full(AtomicUsize::new(0));
        let ear = Ear::new(&calls);
        let host = ear.host();
        unsafe extern "C" fn count(context: *mut c_void, i: usize) {
            // SAFETY: it is called with the number below.
            unsafe { &*context.cast::<AtomicUsize>() }.fetch_add(i, Ordering::Relaxed);
        }
        let sum = AtomicUsize::new(0);
        let context = std::ptr::from_ref(&sum).cast_mut().cast();
        // SAFETY: the host and all texts are there.
        unsafe {
            assert!((host.progress)(&host, 0.25) && !(host.progress)(&host, 0.75));
            assert!(!(host.progress)(&host, 2.0), "a panic stops the plugin");
            assert!(!(host.progress)(std::ptr::null(), 0.25));
            (host.log)(&host, 3, c"careful".as_ptr());
            assert!((host.parallel_for)(&host, 11, Some(count), context));
            assert!(!(host.parallel_for)(&host, 11, None, context));
            assert!((host.extension)(&host, c"simod.graph/1".as_ptr()).is_null());
            assert!(
                (host.extension)(&host, c"simod.nearest/1".as_ptr()).is_null(),
                "where there are no samples"
            );
            assert_eq!((host.error)(&host, 2, c"too few".as_ptr(), std::ptr::null()), 2);
        }
        assert_eq!((calls.0.load(Ordering::Relaxed), sum.into_inner()), (1, 55));
        let error = ear.into_error(2);
        assert_eq!((error.code, &*error.message, &*error.hint), (ErrorCode::INVALID_INPUT, "too few", ""));
    }

    #[test]
    fn an_error_without_words_gets_some() {
        assert_eq!(Ear::new(&()).into_error(SIMOD_CANCELLED), PluginError::cancelled());
        let error = Ear::new(&()).into_error(77);
        assert!(error.message.contains("code 77") && !error.hint.is_empty(), "{error}");
    }
}
