//! Models of any size, made from formulas: for tests, measurements and the demonstration.
//!
//! A [`Surface`] is a list of patches with rows of vertices, evaluated in double precision as they are asked
//! for. What it keeps grows with the number of rows (the square root of the number of vertices); vertices and
//! triangles come in blocks of bounded size, computed on all cores, in the same order and with the same bits
//! for any number of threads.

mod amphora;
mod curve;
mod layout;
mod noise;
mod ornament;
mod ply;
mod shapes;
mod sweep;
mod tile;

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::{Error, ErrorKind, Result};
use layout::{Layout, Patch};

pub use ply::{Encoding, GeneratedInfo, ModelOptions, expected_bytes, write_file, write_ply};

/// Fewest vertices of a generated model; with fewer, the shapes fall apart.
pub const MIN_VERTICES: u64 = 1000;
/// Most vertices of a generated model: a sanity limit, a thousand times the largest scans.
pub const MAX_VERTICES: u64 = 1 << 42;

/// Vertices in a piece of work for one thread (rows are not cut, so longer rows make longer pieces).
const PIECE_VERTICES: u64 = 1 << 14;
/// Pieces computed at a time: with [`PIECE_VERTICES`], the bound of all buffers here.
const PIECES: usize = 16;

/// What to generate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Shape {
    /// An amphora, two units high along +y: a closed body with a hollow neck, and two closed handles whose ends
    /// lie within the body's wall. Full of fine detail: engraved letters, Greek keys, scales, rope, grain.
    Amphora,
    /// A sphere of radius 1 about the origin with waves on it; closed.
    BumpySphere,
    /// A square of side 2 about the origin, facing +y, with waves on it; its border is open.
    Plane,
}

/// A vertex of a generated surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceVertex {
    /// Position.
    pub position: DVec3,
    /// Unit normal, to the outside.
    pub normal: Vec3,
    /// Red, green and blue.
    pub color: [u8; 3],
}

/// A generated model: vertices by formula, and triangles.
///
/// ```
/// use simod_core::generate::{Shape, Surface};
/// # fn main() -> simod_core::Result<()> {
/// let surface = Surface::new(Shape::BumpySphere, 5_000)?;
/// let mut highest = f64::MIN;
/// surface.visit_vertices(|block| {
///     highest = block.iter().fold(highest, |y, vertex| y.max(vertex.position.y));
///     Ok(())
/// })?;
/// assert!(highest > 0.9);
/// # Ok(())
/// # }
/// ```
pub struct Surface {
    patches: Vec<Box<dyn Patch>>,
    layouts: Vec<Layout>,
    vertices: u64,
}

impl Surface {
    /// Lays out a model of exactly so many vertices, spread evenly over the smooth surface.
    ///
    /// # Errors
    /// The number is not between [`MIN_VERTICES`] and [`MAX_VERTICES`].
    pub fn new(shape: Shape, vertices: u64) -> Result<Self> {
        if !(MIN_VERTICES..=MAX_VERTICES).contains(&vertices) {
            return Err(Error::new(
                ErrorKind::Argument,
                format!("cannot generate a model of {vertices} vertices"),
                format!("ask for {MIN_VERTICES} to {MAX_VERTICES}"),
            ));
        }
        let patches = match shape {
            Shape::Amphora => amphora::amphora(),
            Shape::BumpySphere => shapes::bumpy_sphere(),
            Shape::Plane => vec![Box::new(shapes::BumpyPlane) as Box<dyn Patch>],
        };
        let layouts = layout::lay_out(&patches, vertices);
        let vertices = layouts.iter().flat_map(|l| (0..l.rows()).map(|r| u64::from(l.columns(r)))).sum();
        Ok(Self { patches, layouts, vertices })
    }

    /// Number of vertices.
    pub fn vertices(&self) -> u64 {
        self.vertices
    }

    /// Number of triangles.
    pub fn faces(&self) -> u64 {
        self.layouts.iter().flat_map(|l| (0..l.rows() - 1).map(|row| l.strip_len(row))).sum()
    }

    /// Number of separate bodies, whose vertices follow one another.
    pub fn bodies(&self) -> usize {
        self.patches.len()
    }

    /// Calls `visit` with all vertices, in order, block by block.
    ///
    /// # Errors
    /// What `visit` returns.
    pub fn visit_vertices(&self, mut visit: impl FnMut(&[SurfaceVertex]) -> Result<()>) -> Result<()> {
        self.in_pieces(|piece| self.vertices_of(piece), |vertices| visit(&vertices))
    }

    /// Calls `visit` with all triangles, block by block: indices of vertices, counter-clockwise seen from
    /// outside.
    ///
    /// # Errors
    /// What `visit` returns.
    pub fn visit_triangles(&self, mut visit: impl FnMut(&[[u64; 3]]) -> Result<()>) -> Result<()> {
        self.in_pieces(|piece| self.triangles_of(piece), |triangles| visit(&triangles))
    }

    fn vertices_of(&self, piece: &Piece) -> Vec<SurfaceVertex> {
        let (patch, layout) = (&self.patches[piece.patch], &self.layouts[piece.patch]);
        let length = patch.length();
        let mut vertices = Vec::new();
        for row in piece.rows.clone() {
            patch.row(layout.distance(row, length), layout.columns(row), &mut vertices);
        }
        vertices
    }

    fn triangles_of(&self, piece: &Piece) -> Vec<[u64; 3]> {
        let layout = &self.layouts[piece.patch];
        let mut triangles = Vec::new();
        for row in piece.rows.start..piece.rows.end.min(layout.rows() - 1) {
            layout.strip(row, &mut triangles);
        }
        triangles
    }

    /// Computes pieces on all cores, a bounded number at a time, and consumes the results in order.
    fn in_pieces<T: Send>(
        &self,
        compute: impl Fn(&Piece) -> T + Sync,
        mut consume: impl FnMut(T) -> Result<()>,
    ) -> Result<()> {
        let mut pieces = self.pieces();
        loop {
            let batch: Vec<Piece> = pieces.by_ref().take(PIECES).collect();
            if batch.is_empty() {
                return Ok(());
            }
            let results: Vec<T> = batch.par_iter().map(&compute).collect();
            results.into_iter().try_for_each(&mut consume)?;
        }
    }

    /// Cuts the surface between rows, in order.
    fn pieces(&self) -> impl Iterator<Item = Piece> {
        self.layouts.iter().enumerate().flat_map(|(patch, layout)| {
            let mut next = 0;
            std::iter::from_fn(move || {
                let start = next;
                let mut vertices = 0;
                while next < layout.rows() && vertices < PIECE_VERTICES {
                    vertices += u64::from(layout.columns(next));
                    next += 1;
                }
                (start < next).then_some(Piece { patch, rows: start..next })
            })
        })
    }
}

/// Some consecutive rows of a patch.
struct Piece {
    patch: usize,
    rows: Range<usize>,
}
