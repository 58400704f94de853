//! The finding of a rule on a plugin.

use serde::{Deserialize, Serialize};

/// Verdict of a rule on a plugin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The rule is kept.
    Pass,
    /// The rule is broken.
    Fail,
    /// The plugin is not wrong, and not as good as it could be.
    Warn,
    /// The rule does not apply, or something else is in the way.
    Skip,
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::Warn => "warn",
            Self::Skip => "skip",
        })
    }
}

/// The finding of a rule.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// The verdict on the plugin.
    pub verdict: Verdict,
    /// Result of the check, in one line.
    pub found: String,
    /// Advice, in one line; may be empty.
    pub hint: String,
}

impl Finding {
    /// Finding that the rule is broken.
    pub fn fail(found: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { verdict: Verdict::Fail, found: found.into(), hint: hint.into() }
    }

    /// Finding that the rule is kept.
    pub fn pass(found: impl Into<String>) -> Self {
        Self { verdict: Verdict::Pass, found: found.into(), hint: String::new() }
    }

    /// Finding that the plugin is not wrong, and not as good as it could be.
    pub fn warn(found: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { verdict: Verdict::Warn, found: found.into(), hint: hint.into() }
    }

    /// Finding that the rule does not apply.
    pub fn skip(found: impl Into<String>) -> Self {
        Self { verdict: Verdict::Skip, found: found.into(), hint: String::new() }
    }
}

/// A rule's result so far, or the finding that ends it early.
pub(crate) type Checked<T> = std::result::Result<T, Finding>;
