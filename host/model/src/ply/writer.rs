//! Point sets of our own as PLY files.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};

use crate::output::OutputFile;
use crate::{Error, ErrorKind, Result, Scalar};

/// Writes points to a binary little-endian PLY file, which appears whole or not at all.
///
/// `scalar` is the type of the positions; normals, one for each position or none at all, are of type float.
/// Triangles, if there are any, become faces. Line breaks in comments become further comments.
///
/// # Errors
/// The counts differ, a position does not fit the type, or the file cannot be written.
pub fn write_points(
    path: &Path,
    positions: impl ExactSizeIterator<Item = DVec3>,
    normals: &[Vec3],
    triangles: &[[u32; 3]],
    scalar: Scalar,
    comments: &[String],
) -> Result<()> {
    let count = positions.len();
    if !normals.is_empty() && normals.len() != count {
        return Err(Error::new(
            ErrorKind::Mismatch,
            format!("{}: {} normals for {} positions", path.display(), normals.len(), count),
            "give a normal for each position, or none",
        ));
    }
    let header = header(count, !normals.is_empty(), triangles.len(), scalar, comments);
    let position_bytes = match scalar {
        Scalar::F32 => 12,
        Scalar::F64 => 24,
    };
    let bytes = header.len() + count * position_bytes + normals.len() * 12 + triangles.len() * 13;
    let mut out = OutputFile::create(path, bytes as u64)?;
    let failed = |e: std::io::Error| e.downcast().unwrap_or_else(|e| Error::io("write", path, &e));
    out.write_all(header.as_bytes()).map_err(failed)?;
    for (i, position) in positions.enumerate() {
        match scalar {
            Scalar::F64 => write_all(&mut out, position.to_array().map(f64::to_le_bytes)).map_err(failed)?,
            Scalar::F32 => {
                let rounded = position.as_vec3();
                if position.is_finite() && !rounded.is_finite() {
                    return Err(Error::new(
                        ErrorKind::Degenerate,
                        format!("{}: point {i} at {position} is too far away for type float", path.display()),
                        "move the model towards the origin, or use type double",
                    ));
                }
                write_all(&mut out, rounded.to_array().map(f32::to_le_bytes)).map_err(failed)?;
            }
        }
        if let Some(normal) = normals.get(i) {
            write_all(&mut out, normal.to_array().map(f32::to_le_bytes)).map_err(failed)?;
        }
    }
    for corners in triangles {
        out.write_all(&[3]).map_err(failed)?;
        write_all(&mut out, corners.map(u32::to_le_bytes)).map_err(failed)?;
    }
    out.commit()
}

fn header(count: usize, has_normals: bool, triangles: usize, scalar: Scalar, comments: &[String]) -> String {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
    for comment in comments.iter().flat_map(|c| c.split(['\n', '\r'])) {
        header.push_str(&format!("comment {comment}\n"));
    }
    header.push_str(&format!("element vertex {count}\n"));
    let kind = match scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    };
    for name in ["x", "y", "z"] {
        header.push_str(&format!("property {kind} {name}\n"));
    }
    for name in ["nx", "ny", "nz"].iter().filter(|_| has_normals) {
        header.push_str(&format!("property float {name}\n"));
    }
    if triangles > 0 {
        header.push_str(&format!("element face {triangles}\nproperty list uchar uint vertex_indices\n"));
    }
    header.push_str("end_header\n");
    header
}

fn write_all<const N: usize>(out: &mut impl Write, numbers: [[u8; N]; 3]) -> std::io::Result<()> {
    out.write_all(numbers.as_flattened())
}
