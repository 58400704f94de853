//! simod-generate: models of any size, made from formulas: for tests, measurements and the demonstration.
//!
//! A [`Surface`] is a list of patches with rows of vertices, evaluated in double precision as they are asked
//! for. Its memory grows with the number of rows (the square root of the number of vertices); vertices and
//! triangles come in blocks of bounded size, computed on all cores, in the same order and with the same bits
//! for any number of threads.

mod amphora;
mod cactus;
mod curve;
mod fade;
mod layout;
mod noise;
mod ornament;
mod ply;
mod prism;
mod rows;
mod shapes;
mod sweep;
mod tile;

use std::ops::Range;

use rayon::prelude::*;
use simod_model::{Error, Result};

use layout::{SurfacePatch, lay_out};
use rows::BodyRows;

pub use ply::{GeneratedInfo, ModelOptions, PlyEncoding, expected_bytes, write_file, write_ply};
pub use rows::SurfaceVertex;

/// Fewest vertices of a generated model; with fewer, the shapes fall apart.
pub const MIN_VERTICES: u64 = 1000;
/// Most vertices of a generated model: a sanity limit, a thousand times the largest scans.
pub const MAX_VERTICES: u64 = 1 << 42;

/// Vertices in a piece of work for one thread (rows are not cut, so longer rows make longer pieces).
const PIECE_VERTICES: u64 = 1 << 14;
/// Pieces computed at a time: with [`PIECE_VERTICES`], the bound of all buffers here.
const PIECES: usize = 16;

/// The model to generate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Shape {
    /// An amphora, two units high along +y: a closed body with a hollow neck, and two closed handles whose
    /// ends lie within the body's wall. Full of fine detail: engraved letters, Greek keys, scales, rope,
    /// grain.
    Amphora,
    /// A sphere of radius 1 about the origin with waves on it; closed.
    BumpySphere,
    /// A square of side 2 about the origin, facing +y, with waves on it; its border is open.
    Plane,
    /// A square as of `Plane`, with 10 by 10 bumps on it, 0.06 high.
    BumpyPlane,
    /// A round bar, two units high along +y from the origin, with flat ends: radius 0.15, closed.
    Cylinder,
    /// A square bar with sharp edges, two units high along +y from the origin: sides of 0.3, closed.
    Bar,
    /// A cactus, two units high along +y: a stem and two bent arms in the plane of x and y, with ribs and
    /// bumps, as one closed surface.
    Cactus,
}

/// A generated model: vertices by formula, and triangles.
///
/// ```
/// use simod_generate::{Shape, Surface};
/// # fn main() -> simod_model::Result<()> {
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
    bodies: Vec<Box<dyn BodyRows>>,
    vertices: u64,
}

impl Surface {
    /// Lays out a model of exactly so many vertices, spread evenly over the smooth surface.
    ///
    /// # Errors
    /// The number is not between [`MIN_VERTICES`] and [`MAX_VERTICES`].
    pub fn new(shape: Shape, vertices: u64) -> Result<Self> {
        if !(MIN_VERTICES..=MAX_VERTICES).contains(&vertices) {
            return Err(Error::argument(
                format!("cannot generate a model of {vertices} vertices"),
                format!("ask for {MIN_VERTICES} to {MAX_VERTICES}"),
            ));
        }
        let one = |patch: Box<dyn SurfacePatch>| lay_out(vec![patch], vertices);
        let bodies = match shape {
            Shape::Amphora => lay_out(amphora::amphora(), vertices),
            Shape::BumpySphere => one(shapes::bumpy_sphere()),
            Shape::Plane => one(shapes::wavy_plane()),
            Shape::BumpyPlane => one(shapes::bumpy_plane()),
            Shape::Cylinder => one(prism::cylinder()),
            Shape::Bar => one(prism::bar()),
            Shape::Cactus => vec![cactus::cactus(vertices)],
        };
        let vertices = bodies.iter().flat_map(|body| (0..body.rows()).map(|row| body.row_len(row))).sum();
        Ok(Self { bodies, vertices })
    }

    /// Number of vertices.
    pub fn vertices(&self) -> u64 {
        self.vertices
    }

    /// Number of triangles.
    pub fn faces(&self) -> u64 {
        self.bodies.iter().flat_map(|body| (0..body.rows()).map(|row| body.strip_len(row))).sum()
    }

    /// Number of separate bodies, whose vertices follow one another.
    pub fn bodies(&self) -> usize {
        self.bodies.len()
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

    /// Whole mesh at once, for surfaces that are small enough.
    ///
    /// # Errors
    /// The model has more vertices than 32 bits can count.
    pub fn mesh(&self) -> Result<(Vec<SurfaceVertex>, Vec<[u32; 3]>)> {
        if u32::try_from(self.vertices).is_err() {
            let what = format!("{} vertices are too many for a mesh in memory", self.vertices);
            return Err(Error::argument(what, "ask for fewer, or visit them block by block"));
        }
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        self.visit_vertices(|block| {
            vertices.extend_from_slice(block);
            Ok(())
        })?;
        self.visit_triangles(|block| {
            triangles.extend(block.iter().map(|corners| corners.map(|i| i as u32)));
            Ok(())
        })?;
        Ok((vertices, triangles))
    }

    fn vertices_of(&self, piece: &RowPiece) -> Vec<SurfaceVertex> {
        let mut vertices = Vec::new();
        piece.rows.clone().for_each(|row| self.bodies[piece.body].row(row, &mut vertices));
        vertices
    }

    fn triangles_of(&self, piece: &RowPiece) -> Vec<[u64; 3]> {
        let mut triangles = Vec::new();
        piece.rows.clone().for_each(|row| self.bodies[piece.body].strip(row, &mut triangles));
        triangles
    }

    /// Computes pieces on all cores, a bounded number at a time, and consumes the results in order.
    fn in_pieces<T: Send>(
        &self,
        compute: impl Fn(&RowPiece) -> T + Sync,
        mut consume: impl FnMut(T) -> Result<()>,
    ) -> Result<()> {
        let mut pieces = self.pieces();
        loop {
            let batch: Vec<RowPiece> = pieces.by_ref().take(PIECES).collect();
            if batch.is_empty() {
                return Ok(());
            }
            let results: Vec<T> = batch.par_iter().map(&compute).collect();
            results.into_iter().try_for_each(&mut consume)?;
        }
    }

    /// Cuts the surface between rows, in order.
    fn pieces(&self) -> impl Iterator<Item = RowPiece> {
        self.bodies.iter().enumerate().flat_map(|(index, body)| {
            let mut next = 0;
            std::iter::from_fn(move || {
                let start = next;
                let mut vertices = 0;
                while next < body.rows() && vertices < PIECE_VERTICES {
                    vertices += body.row_len(next);
                    next += 1;
                }
                (start < next).then_some(RowPiece { body: index, rows: start..next })
            })
        })
    }
}

/// Some consecutive rows of a body.
struct RowPiece {
    body: usize,
    rows: Range<usize>,
}
