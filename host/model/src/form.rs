//! The trait of formats that are written anew: beginning, vertices, faces, end, each as bytes.

use std::fmt;
use std::path::PathBuf;

use glam::{DVec3, Vec3};

use crate::bounds::Bounds;
use crate::polygons::Polygons;
use crate::{
    Edited, Error, Model, ModelInfo, Result, ScaledIntegers, Summary, Type, VertexChunk, for_positions,
};

/// Options of a conversion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Conversion {
    /// Whether the conversion may lose content that the new format cannot hold.
    pub lossy: bool,
    /// Step from one integer to the next, where the new format stores positions as integers and the model
    /// does not; as fine as the model's extent allows, where not given.
    pub step: Option<f64>,
    /// The position of number zero then; near the model's middle, where not given.
    pub offset: Option<DVec3>,
    /// Whether the normals shall be left out.
    pub drops_normals: bool,
}

/// Rounding of positions in a new format, where they lose digits by it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rounding {
    /// Step from one position to the next, in the model's unit.
    pub step: f64,
    /// The diagonal of the model's box, likewise.
    pub diagonal: f64,
    /// Whether just this step was [asked for](Conversion::step).
    pub is_asked: bool,
}

impl Rounding {
    /// Rounding of a model's positions, which are a `step` apart within their bounds, but for those that keep
    /// their digits, which `stays` tells; none where all stay. Reads the model.
    pub(crate) fn of_model(
        model: &dyn Model,
        stays: impl Fn(DVec3) -> bool,
        step: impl Fn(&Bounds) -> f64,
    ) -> Result<Option<Self>> {
        let (mut bounds, mut all_stay) = (Bounds::default(), true);
        for_positions(model, |chunk| {
            for p in chunk.positions.iter().filter(|p| p.is_finite()) {
                (bounds.min, bounds.max) = (bounds.min.min(*p), bounds.max.max(*p));
                all_stay = all_stay && stays(*p);
            }
            Ok(())
        })?;
        let rounding = || Self { step: step(&bounds), diagonal: bounds.diagonal(), is_asked: false };
        Ok((!all_stay).then(rounding))
    }

    /// The step as a fraction of the diagonal; nothing of a model without an extent.
    pub fn fraction(&self) -> Option<f64> {
        Some(self.step / self.diagonal).filter(|fraction| fraction.is_finite())
    }
}

impl fmt::Display for Rounding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "digits of the positions, which are rounded to {} in the model's unit", self.step)?;
        self.fraction().map_or(Ok(()), |fraction| write!(f, ", {fraction:.1e} of the diagonal"))
    }
}

/// A model that is converted, and how.
pub(crate) struct ConversionInput<'a> {
    pub(crate) model: &'a dyn Model,
    /// Whether vertices have normals that are kept.
    pub(crate) has_normals: bool,
    /// The model's faces as polygons.
    pub(crate) faces: FaceCounts,
    pub(crate) how: Conversion,
    /// The integers that positions become, once they are [chosen](Form::integers).
    pub(crate) integers: Option<ScaledIntegers>,
    /// The folder of temporary files.
    pub(crate) folder: PathBuf,
}

/// Faces of which all corners are vertices.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct FaceCounts {
    pub(crate) polygons: u64,
    /// Corners of all polygons, and (`largest`) of the largest one.
    pub(crate) corners: u64,
    pub(crate) largest: usize,
    /// Triangles that the polygons are made of.
    pub(crate) triangles: u64,
}

impl ConversionInput<'_> {
    pub(crate) fn info(&self) -> &ModelInfo {
        self.model.info()
    }

    /// An error where there is too much of something for a format.
    pub(crate) fn too_many(&self, what: &str, count: u64, most: u64) -> Result<()> {
        if count <= most {
            return Ok(());
        }
        Err(Error::argument(
            format!(
                "{} has {count} {what}, and this format counts {most} at most",
                self.model.path().display()
            ),
            "write another format, as PLY",
        ))
    }
}

/// Number of things with the noun `one`, as "1 comment" and "3 comments".
pub(crate) fn counted(count: u64, one: &str) -> String {
    format!("{count} {one}{}", if count == 1 { "" } else { "s" })
}

/// A loss, for people.
pub(crate) fn attribute_loss(name: &str, kind: Type) -> String {
    format!("the attribute {name} ({})", kind.name())
}

/// Consecutive vertices, as they are to be written.
pub(crate) struct WrittenRows<'a> {
    /// The first one's index.
    pub(crate) first: u64,
    pub(crate) positions: &'a [DVec3],
    /// Normals, one for each vertex or none at all.
    pub(crate) normals: &'a [Vec3],
    /// The first attributes of the model, as many as the form [asks for](Form::attributes).
    pub(crate) attributes: &'a [Vec<f64>],
    /// The vertices as they were read.
    pub(crate) chunk: &'a VertexChunk,
    /// Positions and gradients after the edit, for forms that turn by themselves the attributes that follow.
    pub(crate) edited: &'a Edited,
}

impl WrittenRows<'_> {
    /// An error where a vertex has no position, in a format that could leave it out.
    pub(crate) fn without_position(&self, i: usize, why: &str) -> Error {
        self.unfit(i, why)
            .hinting("give --lossy to leave such vertices out, or write a format that holds them, as PLY")
    }

    /// An error where a position does not fit.
    pub(crate) fn unfit(&self, i: usize, why: &str) -> Error {
        let (vertex, p) = (self.first + i as u64, self.positions[i]);
        Error::degenerate(
            format!("vertex {vertex} is at ({}, {}, {}), {why}", p.x, p.y, p.z),
            "write a format that holds it, as PLY",
        )
    }
}

/// Writer of a format. Its memory is bounded by a chunk, but for temporary files.
pub(crate) trait Form: Send + Sync {
    /// Number of the model's first attributes that the form needs.
    fn attributes(&self) -> usize;

    /// First bytes of the file.
    fn head(&self) -> Result<Vec<u8>>;

    /// Appends vertices.
    ///
    /// # Errors
    /// A vertex does not fit the format.
    fn vertices(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, summary: &mut Summary) -> Result<()>;

    /// Whether faces follow the vertices.
    fn has_faces(&self) -> bool {
        false
    }

    /// Whether faces need all vertices to be there: there can be no more than one version then, and nothing
    /// to resume.
    fn needs_vertices(&self) -> bool {
        false
    }

    /// Whether the format holds polygons of more than three corners.
    fn holds_polygons(&self) -> bool {
        false
    }

    /// Appends faces, all of vertices that there are: triangles, or polygons.
    ///
    /// # Errors
    /// A temporary file cannot be read.
    fn faces(&self, _faces: &Polygons, _to: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }

    /// Last bytes of the file, once all before are known.
    ///
    /// # Errors
    /// The end cannot be made.
    fn tail(&self, _all: &Summary) -> Result<Vec<u8>> {
        Ok(Vec::new())
    }

    /// Number of vertices that this process left out so far, as they have no position.
    fn left_out(&self) -> u64 {
        0
    }

    /// Replacements once all vertices and faces are written: places in the file, and bytes.
    ///
    /// # Errors
    /// A replacement cannot be made.
    fn patches(&self, _all: &Summary) -> Result<Vec<(u64, Vec<u8>)>> {
        Ok(Vec::new())
    }

    /// Scale and offset of positions, where the format stores them as integers.
    fn integers(&self) -> Option<ScaledIntegers> {
        None
    }

    /// Rounding of positions, if they lose digits by it; may read the model.
    ///
    /// # Errors
    /// The model cannot be read.
    fn rounding(&self, _content: &ConversionInput<'_>) -> Result<Option<Rounding>> {
        Ok(None)
    }

    /// Bytes that the file will have, about.
    fn bytes(&self) -> u64;
}

/// Puts numbers of a type into records of `stride` bytes, at the byte `at` of each, little endian.
pub(crate) fn put_numbers(kind: Type, numbers: &[f64], records: &mut [u8], at: usize, stride: usize) {
    fn put<const N: usize>(
        numbers: &[f64],
        records: &mut [u8],
        at: usize,
        stride: usize,
        bytes: impl Fn(f64) -> [u8; N],
    ) {
        for (record, number) in records.chunks_exact_mut(stride).zip(numbers) {
            record[at..at + N].copy_from_slice(&bytes(*number));
        }
    }
    let to = (records, at, stride);
    match kind {
        Type::I8 => put(numbers, to.0, to.1, to.2, |n| (n as i8).to_le_bytes()),
        Type::U8 => put(numbers, to.0, to.1, to.2, |n| (n as u8).to_le_bytes()),
        Type::I16 => put(numbers, to.0, to.1, to.2, |n| (n as i16).to_le_bytes()),
        Type::U16 => put(numbers, to.0, to.1, to.2, |n| (n as u16).to_le_bytes()),
        Type::I32 => put(numbers, to.0, to.1, to.2, |n| (n as i32).to_le_bytes()),
        Type::U32 => put(numbers, to.0, to.1, to.2, |n| (n as u32).to_le_bytes()),
        Type::F32 => put(numbers, to.0, to.1, to.2, |n| (n as f32).to_le_bytes()),
        Type::F64 => put(numbers, to.0, to.1, to.2, f64::to_le_bytes),
    }
}
