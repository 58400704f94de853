//! Helpers of the end-to-end tests: the real program in a folder of its own, and models as bytes.
//!
//! Nothing here knows the program's crates: what the tests hold is what a user sees.

mod built;
mod ply;
mod workplace;

pub use built::{cargo_build, library, run_build, workspace};
pub use ply::Ply;
pub use workplace::{Outcome, Workplace, real_model, skip};

/// Whether the program is built for speed, so that large models take seconds.
pub const OPTIMISED: bool = !cfg!(debug_assertions);
