//! Writes a generated surface as PLY.

use std::io::Write;
use std::path::Path;

use glam::DVec3;
use simod_model::output::OutputFile;
use simod_model::{Error, Progress, Result, Scalar};

use super::{RowPiece, Shape, Surface, SurfaceVertex};

/// The encoding of the numbers of a PLY file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyEncoding {
    /// Text.
    Ascii,
    /// Binary, least significant byte first.
    BinaryLittleEndian,
    /// Binary, most significant byte first.
    BinaryBigEndian,
}

/// A model to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelOptions {
    /// The shape.
    pub shape: Shape,
    /// Number of vertices.
    pub vertices: u64,
    /// The encoding of the numbers.
    pub encoding: PlyEncoding,
    /// Type of the positions.
    pub scalar: Scalar,
    /// Whether to write normals (always as floats).
    pub normals: bool,
    /// Whether to write colours (`uchar red green blue`).
    pub colors: bool,
    /// Whether to write triangles.
    pub faces: bool,
    /// Vector added to all positions, as georeferenced data has it.
    pub offset: DVec3,
}

impl Default for ModelOptions {
    /// A million-vertex amphora with everything, in little-endian floats.
    fn default() -> Self {
        Self {
            shape: Shape::Amphora,
            vertices: 1_000_000,
            encoding: PlyEncoding::BinaryLittleEndian,
            scalar: Scalar::F32,
            normals: true,
            colors: true,
            faces: true,
            offset: DVec3::ZERO,
        }
    }
}

/// The numbers of vertices and faces that were written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GeneratedInfo {
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles; 0 where none were asked for.
    pub faces: u64,
    /// Size of the file.
    pub bytes: u64,
}

/// Size of the file that [`write_ply`] will write, where the encoding lets it be told beforehand: not in
/// text.
///
/// # Errors
/// As [`write_ply`] has for its options.
pub fn expected_bytes(options: &ModelOptions) -> Result<Option<u64>> {
    Ok(PlyFormat::new(options, &Surface::new(options.shape, options.vertices)?)?.bytes())
}

/// Generates a model into a file, which appears whole or not at all.
///
/// # Errors
/// As [`write_ply`] has; the file cannot be made there.
pub fn write_file(options: &ModelOptions, path: &Path, progress: &dyn Progress) -> Result<GeneratedInfo> {
    let mut out = OutputFile::create(path, expected_bytes(options)?.unwrap_or(0))?;
    let info = write_ply(options, &mut out, progress)?;
    out.commit()?;
    Ok(info)
}

/// Generates a model and writes it, in constant memory (but for the rows' table; see [`Surface`]).
///
/// Begins a stage of `progress`, and advances it by the bytes written.
///
/// # Errors
/// The number of vertices is out of range, or too large for the indices of faces; `out` cannot be written;
/// the user cancelled.
pub fn write_ply(
    options: &ModelOptions,
    out: &mut dyn Write,
    progress: &dyn Progress,
) -> Result<GeneratedInfo> {
    let surface = Surface::new(options.shape, options.vertices)?;
    let format = PlyFormat::new(options, &surface)?;
    progress.begin("generating", format.bytes().unwrap_or(0));

    let mut bytes = 0;
    let mut write = |piece: Vec<u8>| -> Result<()> {
        progress.check()?;
        out.write_all(&piece).map_err(|error| {
            error.downcast().unwrap_or_else(|error| {
                let what = format!("cannot write the generated model: {}", error.to_string().to_lowercase());
                Error::system(what, "check the disk and the path, then try again")
            })
        })?;
        bytes += piece.len() as u64;
        progress.advance(piece.len() as u64);
        Ok(())
    };
    write(format.header.clone().into_bytes())?;
    surface.in_pieces(|piece| format.vertices(&surface, piece), &mut write)?;
    if options.faces {
        surface.in_pieces(|piece| format.faces(&surface, piece), &mut write)?;
    }
    Ok(GeneratedInfo { vertices: surface.vertices(), faces: format.faces, bytes })
}

/// Encoding of one model.
struct PlyFormat<'a> {
    options: &'a ModelOptions,
    header: String,
    vertices: u64,
    faces: u64,
}

impl<'a> PlyFormat<'a> {
    fn new(options: &'a ModelOptions, surface: &Surface) -> Result<Self> {
        let vertices = surface.vertices();
        let faces = if options.faces { surface.faces() } else { 0 };
        if options.faces && vertices > u64::from(u32::MAX) {
            return Err(Error::argument(
                format!("{vertices} vertices are too many for the 32-bit indices of a PLY file's faces"),
                "generate it without faces",
            ));
        }

        let encoding = match options.encoding {
            PlyEncoding::Ascii => "ascii",
            PlyEncoding::BinaryLittleEndian => "binary_little_endian",
            PlyEncoding::BinaryBigEndian => "binary_big_endian",
        };
        let scalar = match options.scalar {
            Scalar::F32 => "float",
            Scalar::F64 => "double",
        };
        let mut header = format!("ply\nformat {encoding} 1.0\nelement vertex {vertices}\n");
        let mut property = |kind: &str, names: &[&str]| {
            for name in names {
                header.push_str(&format!("property {kind} {name}\n"));
            }
        };
        property(scalar, &["x", "y", "z"]);
        if options.normals {
            property("float", &["nx", "ny", "nz"]);
        }
        if options.colors {
            property("uchar", &["red", "green", "blue"]);
        }
        if options.faces {
            // Other programs read signed indices more often than unsigned ones.
            let index = if vertices > i32::MAX as u64 { "uint" } else { "int" };
            header.push_str(&format!("element face {faces}\nproperty list uchar {index} vertex_indices\n"));
        }
        header.push_str("end_header\n");
        Ok(Self { options, header, vertices, faces })
    }

    fn bytes(&self) -> Option<u64> {
        if self.options.encoding == PlyEncoding::Ascii {
            return None;
        }
        Some(self.header.len() as u64 + self.vertices * self.vertex_bytes() + self.faces * 13)
    }

    fn vertex_bytes(&self) -> u64 {
        let position = match self.options.scalar {
            Scalar::F32 => 12,
            Scalar::F64 => 24,
        };
        position + if self.options.normals { 12 } else { 0 } + if self.options.colors { 3 } else { 0 }
    }

    fn vertices(&self, surface: &Surface, piece: &RowPiece) -> Vec<u8> {
        let vertices = surface.vertices_of(piece);
        let mut bytes = Vec::with_capacity(vertices.len() * self.vertex_bytes() as usize);
        for vertex in &vertices {
            match self.options.encoding {
                PlyEncoding::Ascii => self.vertex(vertex, &mut NumberText(&mut bytes)),
                PlyEncoding::BinaryLittleEndian => self.vertex(vertex, &mut LittleEndian(&mut bytes)),
                PlyEncoding::BinaryBigEndian => self.vertex(vertex, &mut BigEndian(&mut bytes)),
            }
        }
        bytes
    }

    fn vertex(&self, vertex: &SurfaceVertex, sink: &mut impl Sink) {
        for x in (vertex.position + self.options.offset).to_array() {
            match self.options.scalar {
                Scalar::F32 => sink.float(x as f32),
                Scalar::F64 => sink.double(x),
            }
        }
        if self.options.normals {
            vertex.normal.to_array().into_iter().for_each(|x| sink.float(x));
        }
        if self.options.colors {
            vertex.color.into_iter().for_each(|x| sink.byte(x));
        }
        sink.end();
    }

    fn faces(&self, surface: &Surface, piece: &RowPiece) -> Vec<u8> {
        fn face(triangle: [u64; 3], sink: &mut impl Sink) {
            sink.byte(3);
            triangle.into_iter().for_each(|index| sink.index(index as u32));
            sink.end();
        }
        let triangles = surface.triangles_of(piece);
        let mut bytes = Vec::with_capacity(triangles.len() * 13);
        for triangle in triangles {
            match self.options.encoding {
                PlyEncoding::Ascii => face(triangle, &mut NumberText(&mut bytes)),
                PlyEncoding::BinaryLittleEndian => face(triangle, &mut LittleEndian(&mut bytes)),
                PlyEncoding::BinaryBigEndian => face(triangle, &mut BigEndian(&mut bytes)),
            }
        }
        bytes
    }
}

/// Writer of the numbers of one element in an encoding.
trait Sink {
    fn float(&mut self, x: f32);
    fn double(&mut self, x: f64);
    fn byte(&mut self, x: u8);
    fn index(&mut self, x: u32);
    fn end(&mut self) {}
}

struct LittleEndian<'a>(&'a mut Vec<u8>);

impl Sink for LittleEndian<'_> {
    fn float(&mut self, x: f32) {
        self.0.extend_from_slice(&x.to_le_bytes());
    }
    fn double(&mut self, x: f64) {
        self.0.extend_from_slice(&x.to_le_bytes());
    }
    fn byte(&mut self, x: u8) {
        self.0.push(x);
    }
    fn index(&mut self, x: u32) {
        self.0.extend_from_slice(&x.to_le_bytes());
    }
}

struct BigEndian<'a>(&'a mut Vec<u8>);

impl Sink for BigEndian<'_> {
    fn float(&mut self, x: f32) {
        self.0.extend_from_slice(&x.to_be_bytes());
    }
    fn double(&mut self, x: f64) {
        self.0.extend_from_slice(&x.to_be_bytes());
    }
    fn byte(&mut self, x: u8) {
        self.0.push(x);
    }
    fn index(&mut self, x: u32) {
        self.0.extend_from_slice(&x.to_be_bytes());
    }
}

/// Shortest text that reads back as the same number, separated by spaces.
struct NumberText<'a>(&'a mut Vec<u8>);

impl NumberText<'_> {
    fn number(&mut self, x: impl std::fmt::Display) {
        // Writing to a vector does not fail.
        let _ = write!(self.0, "{x} ");
    }
}

impl Sink for NumberText<'_> {
    fn float(&mut self, x: f32) {
        self.number(x);
    }
    fn double(&mut self, x: f64) {
        self.number(x);
    }
    fn byte(&mut self, x: u8) {
        self.number(x);
    }
    fn index(&mut self, x: u32) {
        self.number(x);
    }
    fn end(&mut self) {
        self.0.pop();
        self.0.push(b'\n');
    }
}
