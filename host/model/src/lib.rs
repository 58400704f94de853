//! simod-model: models of any size as streams, and files as reliable as they have to be.
//!
//! A [`Model`] is a mesh, a soup or a cloud in a file that may be larger than memory: vertices come in
//! chunks, and go out as patched chunks; faces come as triangles. A model is never held: readers keep one
//! chunk of at most [`CHUNK_VERTICES`] vertices or [`CHUNK_TRIANGLES`] triangles, and [`Model::rewrite`] one
//! for each thread, with up to [`MAX_VERSIONS`] new versions, and the bytes of a few more.
//!
//! Files that are written appear whole or not at all ([`output`], [`output_folder`]), and are resumed after
//! the program was killed ([`resumable`]). The vocabulary of all crates above is here as well: errors,
//! progress, [local coordinates](frame).
//!
//! Nothing here prints, opens a window, or knows of samples.

mod attribute;
pub mod bounds;
mod cache;
pub mod claim;
mod colors;
mod columns;
mod convert;
mod e57;
mod error;
mod fan;
pub mod follow;
mod form;
mod formats;
pub mod frame;
mod gltf;
pub mod histogram;
mod in_memory;
mod in_step;
pub mod input;
mod las;
pub mod long_list;
pub mod mapped;
pub mod memory;
mod model;
mod named;
mod number;
mod obj;
pub mod object;
pub mod object_output;
pub mod object_range;
mod off;
pub mod output;
pub mod output_folder;
mod pcd;
mod pipeline;
mod ply;
mod polygons;
mod pool;
mod positioned;
pub mod processor;
pub mod progress;
pub mod resumable;
pub mod resumable_folder;
pub mod resumable_output;
mod scaled;
pub mod scratch;
pub mod shared;
pub mod shared_folder;
mod shared_normal;
pub mod size;
mod source;
mod splats;
mod stl;
mod summary;
pub mod target;
mod text;
mod tiles;
mod uncached;
mod unfit;
mod wkt;

pub use attribute::Attribute;
pub use cache::Cache;
pub use colors::{ColorScale, Colors};
pub use convert::{Converted, ConvertedTiles, convert_tiles, converted_names};
pub use error::{Error, ErrorKind, ErrorMark, Result};
pub use form::{Conversion, Rounding};
pub use formats::{extensions, is_model, is_named_otherwise, note_on_name, tells_when_opened};
pub use in_memory::InMemory;
pub use in_step::{Vertices, in_ranges, in_step, range_in_step};
pub use model::{
    CHUNK_TRIANGLES, CHUNK_VERTICES, Division, Edit, Edited, FACES_OF_A_BLOCK, FaceChunk, FaceMark,
    FaceReader, MAX_VERSIONS, Model, ModelInfo, Normals, Output, PieceRange, RawChunk, Rewriting,
    SMALL_CHUNK, Scalar, Tile, VertexChunk, VertexReader, for_faces, for_faces_at, for_faces_from,
    for_positions, for_vertices,
};
pub use named::{ModelName, matching, open, open_version, open_with, open_with_columns};
pub use number::Type;
pub use ply::{Besides, write_points, write_vertices};
pub use progress::Progress;
pub use scaled::ScaledIntegers;
pub use summary::Summary;
pub use tiles::pattern_of;
