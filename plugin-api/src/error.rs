//! Failures as values that cross the boundary.

use abi_stable::{StableAbi, std_types::RString};

/// Result of every fallible call of a plugin.
pub type PluginResult<T> = Result<T, PluginError>;

/// Sort of a failure.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorCode(pub u32);

impl ErrorCode {
    /// A parameter's value makes no sense, alone or together with others.
    pub const INVALID_PARAMETER: Self = Self(1);
    /// The samples, the regions or their transforms cannot be worked on.
    pub const INVALID_INPUT: Self = Self(2);
    /// A solver did not get to an answer.
    pub const NOT_CONVERGED: Self = Self(3);
    /// The host asked to stop, and the plugin did.
    pub const CANCELLED: Self = Self(4);
    /// The plugin panicked; set by the exported shims alone.
    pub const PANICKED: Self = Self(5);
    /// A bug: of the plugin, or of the host in calling it.
    pub const INTERNAL: Self = Self(6);
    /// Something that the plugin needs is missing: the host is older, or the samples have no triangles.
    pub const UNSUPPORTED: Self = Self(7);
}

/// A failure: its sort, one line that says what is wrong, one that says what to do (may be empty).
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq, Eq)]
pub struct PluginError {
    /// Sort of the failure.
    pub code: ErrorCode,
    /// Message that says what is wrong: one line, lower case, no full stop.
    pub message: RString,
    /// Advice on what to do about the failure, in the same form; may be empty.
    pub hint: RString,
}

impl PluginError {
    /// A failure of the given sort, without a hint.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self { code, message: RString::from(message.into()), hint: RString::new() }
    }

    /// The parameter `id` has a value that makes no sense; `what` completes "parameter `id` …".
    pub fn parameter(id: &str, what: &str) -> Self {
        Self::new(ErrorCode::INVALID_PARAMETER, format!("parameter `{id}` {what}"))
    }

    /// The samples or regions cannot be worked on.
    pub fn input(message: impl Into<String>) -> Self {
        Self::new(ErrorCode::INVALID_INPUT, message)
    }

    /// The host asked to stop.
    pub fn cancelled() -> Self {
        Self::new(ErrorCode::CANCELLED, "cancelled")
    }

    /// A bug.
    pub fn internal(message: impl Into<String>) -> Self {
        Self::new(ErrorCode::INTERNAL, message)
    }

    /// Sets the line that says what to do.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = RString::from(hint.into());
        self
    }
}

impl std::fmt::Display for PluginError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for PluginError {}
