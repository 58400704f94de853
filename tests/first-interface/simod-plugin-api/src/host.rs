//! The other direction: what a plugin may ask of the host.

use crate::{Extension, Host, PluginError, PluginResult};

/// How much a message matters.
#[repr(transparent)]
#[derive(abi_stable::StableAbi, Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct LogLevel(pub u32);

impl LogLevel {
    /// For the plugin's author.
    pub const DEBUG: Self = Self(1);
    /// For a curious user.
    pub const INFO: Self = Self(2);
    /// The result may not be what the user wants.
    pub const WARNING: Self = Self(3);
}

/// What a host implements; [`Host::new`] makes it callable across the boundary.
pub trait HostCalls: Sync {
    /// So much of the call is done, 0 to 1. Whether to go on: `false` asks the plugin to stop.
    fn progress(&self, fraction: f64) -> bool;

    /// A line for the user.
    fn log(&self, level: LogLevel, message: &str);

    /// Calls `body` once for each number below `count`, on several threads where there are any. `false` if it
    /// was stopped before all were called.
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        (0..count).all(|i| {
            let goes_on = self.progress(0.0);
            if goes_on {
                body(i);
            }
            goes_on
        })
    }

    /// A capability of the host, by id.
    fn extension(&self, id: &str) -> Option<Extension> {
        let _ = id;
        None
    }
}

/// A host that never stops anything and hears nothing, for tests.
impl HostCalls for () {
    fn progress(&self, _fraction: f64) -> bool {
        true
    }
    fn log(&self, _level: LogLevel, _message: &str) {}
}

impl<T: HostCalls + ?Sized> HostCalls for &T {
    fn progress(&self, fraction: f64) -> bool {
        (**self).progress(fraction)
    }
    fn log(&self, level: LogLevel, message: &str) {
        (**self).log(level, message);
    }
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        (**self).parallel_for(count, body)
    }
    fn extension(&self, id: &str) -> Option<Extension> {
        (**self).extension(id)
    }
}

impl Host<'_> {
    /// Tells that so much of the call is done (0 to 1), and learns whether to go on: an error of code
    /// [`CANCELLED`](crate::ErrorCode::CANCELLED), to be returned as it is, where the user asked to stop.
    ///
    /// From any thread; costs some nanoseconds. Call it at least every 100 ms.
    pub fn progress(&self, fraction: f64) -> PluginResult<()> {
        if self.call_progress(fraction) { Ok(()) } else { Err(PluginError::cancelled()) }
    }

    /// A warning for the user: the result may not be what they want.
    pub fn warn(&self, message: &str) {
        self.log(LogLevel::WARNING, message);
    }
}
