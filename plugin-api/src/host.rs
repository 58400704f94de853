//! The calls from a plugin to its host: progress, messages, threads, look-ups.

use crate::services::{Lookups, Nearest, NearestService, Pose, Surface, SurfaceService};
use crate::{ErrorCode, Extension, ExtensionInterface, Host, PluginError, PluginResult};

/// Level of a message: how much it matters, and to whom.
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

/// The calls that a host implements; [`Host::new`] makes them callable across the boundary.
pub trait HostCalls: Sync {
    /// Takes the part of the call that is done, 0 to 1, and returns whether to go on: `false` asks the plugin
    /// to stop.
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

    /// The look-ups that plugins may do in the samples of this call.
    fn lookups(&self) -> Option<&dyn Lookups> {
        None
    }

    /// A capability of the host, by id, beside those of [`lookups`](Self::lookups).
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
    fn lookups(&self) -> Option<&dyn Lookups> {
        (**self).lookups()
    }
    fn extension(&self, id: &str) -> Option<Extension> {
        (**self).extension(id)
    }
}

impl Host<'_> {
    /// The nearest of the samples of this call, wherever the plugin is asked for something with samples.
    ///
    /// # Errors
    /// The host is older than this, or has no samples in this pose.
    pub fn nearest(&self, pose: Pose) -> PluginResult<Nearest<'_>> {
        let table = self.extension(NearestService::ID).and_then(|e| e.get::<NearestService>());
        let table = table.filter(|table| (table.has)(self, pose));
        table.map(|table| Nearest { host: self, table, pose }).ok_or_else(|| {
            PluginError::new(ErrorCode::UNSUPPORTED, "there are no samples to look up").hint(
                "take a later version of SIMOD; samples at rest are there for plugins that ask for them",
            )
        })
    }

    /// The triangles between the samples, for plugins that [ask for them](crate::Consumes::triangles).
    ///
    /// # Errors
    /// The host is older than this, or there are no triangles.
    pub fn surface(&self, pose: Pose) -> PluginResult<Surface<'_>> {
        let table = self.extension(SurfaceService::ID).and_then(|e| e.get::<SurfaceService>());
        let table = table.filter(|table| (table.has)(self, pose));
        table.map(|table| Surface { host: self, table, pose }).ok_or_else(|| {
            PluginError::new(ErrorCode::UNSUPPORTED, "there are no triangles between the samples")
                .hint("sample a model with faces, and without `--skip triangles`")
        })
    }

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
