//! simod-cholesky: sparse Cholesky factorisation of symmetric positive definite matrices whose unknowns have places.
//!
//! ```text
//! Symmetric ──dissection──▶ order, tree of parts ──structure──▶ rows of each part ──fronts──▶ Factor ──▶ solutions
//! ```
//!
//! Why not faer's own, on which each dense front stands here: a factorisation of a plugin has to stop when the user asks
//! it to, within a frame, and to tell its progress; to give the same bits whatever the number of threads; and to solve for
//! the three coordinates at once in one pass over the factor, which is what a drag waits for. What it costs and gains
//! beside faer's is measured by `benches/cholesky`.

mod dissection;
mod factor;
mod front;
mod kernels;
mod refusal;
mod solve;
mod structure;

pub use factor::{Factor, Symmetric};
pub use kernels::Stored;
pub use refusal::Refusal;
