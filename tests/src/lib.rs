//! Helpers of the end-to-end tests: the real program in a folder of its own, and models as bytes.
//!
//! Nothing here knows the program's crates: what the tests hold is what a user sees.

mod built;
mod compiler;
pub mod damage;
mod motion;
mod ply;
mod workplace;

pub use built::{built, cargo_build, library, outside_target, program, run_build, target_folder, workspace};
pub use compiler::has_compiler;
pub use motion::Motion;
pub use ply::Ply;
pub use workplace::{Outcome, Workplace, real_model, skip};

/// Whether the program is built for speed, so that large models take seconds.
pub const OPTIMISED: bool = !cfg!(debug_assertions);

/// Vertices of the model that figures are asked of: two million, and fewer where that would take minutes.
pub const MANY: u64 = if OPTIMISED { 2_000_000 } else { 120_000 };
