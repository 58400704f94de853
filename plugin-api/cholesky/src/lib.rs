//! simod-cholesky: sparse Cholesky factorisation of symmetric positive definite matrices whose unknowns have
//! places.
//!
//! ```text
//! Symmetric ──dissection──▶ order, tree of parts ──structure──▶ rows of each part ──fronts──▶ Factor ──▶ solutions
//! ```
//!
//! Each dense front stands on faer. Its own sparse factorisation is not used: a factorisation of a plugin has
//! to stop when the user asks it to, within a frame, and to tell its progress; to give the same bits whatever
//! the number of threads; and to solve for the three coordinates at once in one pass over the factor, which
//! is what a drag waits for. Beside faer 0.24, seconds on two cores with AVX-512, the squared Laplacian of a
//! torus, by `benches/cholesky`:
//!
//! | unknowns, threads | factor | faer's | three solutions | faer's |
//! |---|---:|---:|---:|---:|
//! | 20 000, two | 0.088 | 0.092 | 0.013 | 0.032 |
//! | 100 000, two | 0.90 | 0.92 | 0.071 | 0.175 |
//! | 100 000, one | 0.99 | 1.07 | 0.106 | 0.074 |
//! | 200 000, two | 2.43 | 2.97 | 0.190 | 0.370 |

mod dissection;
mod factor;
mod front;
mod kernels;
mod refusal;
mod separator;
mod solve;
mod structure;

pub use factor::{Factor, Symmetric};
pub use kernels::Stored;
pub use refusal::Refusal;
