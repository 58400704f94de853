//! simod-core: freeform deformation that does not care about size.
//!
//! A huge model `P_L` is streamed to a small point set `P_S` ([`sampling`]); anything may deform `P_S` to
//! `P_S*`; the deformation is streamed back onto `P_L` ([`reconstruction`]). `P_S` gets more samples where it
//! needs them ([`refinement`]). Follows T. Boubekeur, O. Sorkine, C. Schlick, *SIMOD: Making Freeform
//! Deformation Size-Insensitive*, Eurographics Symposium on Point-Based Graphics 2007.
//!
//! Nothing here holds memory proportional to `P_L`, prints, opens a window, or knows of plugins or of the
//! formats of models.

mod attribute_stream;
pub mod attributes;
pub mod colors;
mod counting_sort;
pub mod deformed_file;
pub mod deformed_positions;
pub mod detail;
mod double_lanes;
mod eigen_lanes;
pub mod ellipses;
pub mod fingerprint;
mod found_cells;
pub mod guard;
mod hashed;
mod lists;
pub mod reconstruction;
pub mod refinement;
pub mod sampled_model;
pub mod sampling;
mod sealed;
mod stored_precision;
pub mod tables;
pub mod touching;
mod varint;

pub use simod_geometry as geometry;
