//! Point sets of our own as PLY files.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};

use crate::output::OutputFile;
use crate::{Error, Result, Scalar};

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
    let besides = Besides { normals, triangles, ..Besides::default() };
    write_vertices(path, positions, besides, scalar, comments)
}

/// Contents of a file of vertices beside their positions.
#[derive(Debug, Clone, Copy, Default)]
pub struct Besides<'a> {
    /// Normals, one for each position, or none at all.
    pub normals: &'a [Vec3],
    /// Red, green and blue of each, or none at all.
    pub colors: &'a [[u8; 3]],
    /// Whether each vertex has its number as `id`.
    pub ids: bool,
    /// The triangles that become the faces.
    pub triangles: &'a [[u32; 3]],
}

/// Writes points with colours, of type uchar, and ids, of type int: other programs keep these rather than
/// unsigned ones.
///
/// # Errors
/// As of [`write_points`].
pub fn write_vertices(
    path: &Path,
    positions: impl ExactSizeIterator<Item = DVec3>,
    besides: Besides<'_>,
    scalar: Scalar,
    comments: &[String],
) -> Result<()> {
    let count = positions.len();
    let Besides { normals, colors, ids, triangles } = besides;
    check_counts(path, count, &besides)?;
    let header = header(count, &besides, scalar, comments);
    let record = 3 * scalar.size() + if ids { 4 } else { 0 };
    let bytes = header.len() + count * record + normals.len() * 12 + colors.len() * 3 + triangles.len() * 13;
    let mut out = OutputFile::create(path, bytes as u64)?;
    let failed = |e: std::io::Error| e.downcast().unwrap_or_else(|e| Error::io("write", path, &e));
    out.write_all(header.as_bytes()).map_err(failed)?;
    for (i, position) in positions.enumerate() {
        match scalar {
            Scalar::F64 => write_all(&mut out, position.to_array().map(f64::to_le_bytes)).map_err(failed)?,
            Scalar::F32 => {
                let rounded = position.as_vec3();
                if position.is_finite() && !rounded.is_finite() {
                    return Err(Error::degenerate(
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
        if let Some(color) = colors.get(i) {
            out.write_all(color).map_err(failed)?;
        }
        if ids {
            out.write_all(&(i as u32).to_le_bytes()).map_err(failed)?;
        }
    }
    for corners in triangles {
        out.write_all(&[3]).map_err(failed)?;
        write_all(&mut out, corners.map(u32::to_le_bytes)).map_err(failed)?;
    }
    out.commit()
}

/// # Errors
/// There is not one normal, or colour, for each position.
fn check_counts(path: &Path, count: usize, besides: &Besides<'_>) -> Result<()> {
    for (kind, number) in [("normals", besides.normals.len()), ("colours", besides.colors.len())] {
        if number != 0 && number != count {
            return Err(Error::mismatch(
                format!("{}: {number} {kind} for {count} positions", path.display()),
                "give one for each position, or none",
            ));
        }
    }
    Ok(())
}

fn header(count: usize, besides: &Besides<'_>, scalar: Scalar, comments: &[String]) -> String {
    let Besides { normals, colors, ids, triangles } = besides;
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
    for name in ["nx", "ny", "nz"].iter().filter(|_| !normals.is_empty()) {
        header.push_str(&format!("property float {name}\n"));
    }
    for name in ["red", "green", "blue"].iter().filter(|_| !colors.is_empty()) {
        header.push_str(&format!("property uchar {name}\n"));
    }
    if *ids {
        header.push_str("property int id\n");
    }
    if !triangles.is_empty() {
        let triangles = triangles.len();
        header.push_str(&format!("element face {triangles}\nproperty list uchar uint vertex_indices\n"));
    }
    header.push_str("end_header\n");
    header
}

fn write_all<const N: usize>(out: &mut impl Write, numbers: [[u8; N]; 3]) -> std::io::Result<()> {
    out.write_all(numbers.as_flattened())
}
