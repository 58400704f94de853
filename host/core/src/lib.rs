//! simod-core: freeform deformation that does not care about size.
//!
//! A huge model `P_L` is streamed to a small point set `P_S` ([`sampling`]); anything may deform `P_S` to
//! `P_S*`; the deformation is streamed back onto `P_L` ([`reconstruction`]). `P_S` gets more samples where it
//! needs them ([`refinement`]). Follows T. Boubekeur, O. Sorkine, C. Schlick, *SIMOD: Making Freeform
//! Deformation Size-Insensitive*, Eurographics Symposium on Point-Based Graphics 2007.
//!
//! Nothing here holds memory proportional to `P_L` (but [`measure`], which is for meshes in memory), prints,
//! opens a window, or knows of plugins.

pub mod attributes;
pub mod claim;
pub mod detail;
pub mod error;
pub mod frame;
pub mod generate;
pub mod geometry;
pub mod guard;
pub mod input;
pub mod measure;
pub mod memory;
pub mod model;
pub mod output;
pub mod output_folder;
mod positioned;
pub mod progress;
pub mod reconstruction;
pub mod refinement;
pub mod render;
mod resumable;
pub mod sampled_model;
pub mod sampling;
mod scratch;
mod sealed;
pub mod touching;
mod uncached;
mod varint;

pub use error::{Error, ErrorKind, Result};
pub use progress::Progress;
