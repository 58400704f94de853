//! The cactus: three tubes that are smoothly joined, with ribs and bumps, as one closed surface.
//!
//! The shape is an implicit surface ([`form`]); the vertices and their connections are a grid of four sides
//! about each tube, an arm's around a hole in the stem's ([`grid`]), of which each vertex is moved onto the
//! surface.

mod counts;
mod form;
mod grid;
mod tube;

use super::BodyRows;

pub(super) fn cactus(vertices: u64) -> Box<dyn BodyRows> {
    Box::new(grid::Cactus::new(vertices))
}
