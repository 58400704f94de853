//! Diagnostics of a deformation at each vertex, for people to look at: displacement, stretch of the surface,
//! folds and expected error.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use simod_model::follow::Following;
use simod_model::long_list::ListStorage;
use simod_model::output::OutputFile;
use simod_model::{Error, Model, Result, Scalar};

use super::expansion::Expansion;

/// Vertices that are encoded at a time.
const BLOCK: usize = 1 << 12;

/// Diagnostics of the surface at a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexDiagnostics {
    /// Length of the vertex's displacement, in the model's unit.
    pub displacement: f32,
    /// The largest and the smallest principal stretch of the surface, 1 at rest.
    pub stretch: [f32; 2],
    /// Whether the surface at the vertex is turned inside out, other than most of the model.
    pub folded: bool,
    /// Expected error of the vertex's position, in the model's unit.
    pub expected_error: f32,
    /// Ratio of length to width that a round splat at the vertex gets.
    pub anisotropy: f32,
}

impl VertexDiagnostics {
    /// The diagnostics of a vertex without a finite position.
    pub const UNKNOWN: Self = Self {
        displacement: f32::NAN,
        stretch: [f32::NAN; 2],
        folded: false,
        expected_error: f32::NAN,
        anisotropy: f32::NAN,
    };

    /// Bytes in a file, without the anisotropy.
    const BYTES: u64 = 21;
}

/// The largest and the smallest factor by which a deformation of this gradient changes lengths within the
/// plane across `normal`: the singular values of the gradient there. NaN where there is no normal.
pub fn principal_stretches(gradient: &Mat3, normal: Vec3) -> [f32; 2] {
    let Some(normal) = normal.try_normalize() else { return [f32::NAN; 2] };
    let (s, t) = normal.any_orthonormal_pair();
    let (a, b) = (*gradient * s, *gradient * t);
    let (mean, half) = ((a.dot(a) + b.dot(b)) / 2.0, (a.dot(a) - b.dot(b)) / 2.0);
    let largest = (mean + half.hypot(a.dot(b))).sqrt();
    // The product of both stretches is the change of area.
    let smallest = if largest > 0.0 { a.cross(b).length() / largest } else { 0.0 };
    [largest, smallest.min(largest)]
}

/// Whether the vertices are splats that turn with the surface.
fn has_splats(model: &dyn Model) -> bool {
    model.following().is_some_and(Following::has_splats)
}

/// Folds: samples around which a deformation turns the surface inside out.
///
/// Folded are samples at which the sign of the gradient's determinant is not that of most samples: so a
/// mirror of the whole model folds nothing. The map off the surface is known from the surface's relief alone,
/// and a dent or a bend may look mirrored by that. So folded samples count only if the surface doubles back
/// somewhere around them: if the images of its tangent planes, from one sample to the next, turn by more than
/// a right angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Folds {
    /// Number of folded samples.
    pub samples: u64,
    /// First of the folded samples, if any.
    pub first: Option<usize>,
    /// Whether most of the samples are mirrored.
    mirrored: bool,
    /// Whether each sample is folded, or one of its neighbours.
    near: Vec<bool>,
}

impl Folds {
    /// The folds of the expansions at all samples, which have these normals and neighbours at rest; `is_told`
    /// says of each whether the surface around it tells the sign of its determinant.
    pub fn new<'s>(
        expansions: &[Expansion],
        is_told: &[bool],
        normals: &[Vec3],
        neighbours: impl Fn(usize) -> &'s [u32],
        storage: &ListStorage,
    ) -> Self {
        let all = || 0..expansions.len();
        let gradient = |e: &Expansion| Mat3::IDENTITY + e.slope();
        let determinants: Vec<f32> = storage
            .counted(expansions.len(), size_of::<Expansion>())
            .map(|i| gradient(&expansions[i]).determinant())
            .collect();
        let signs = || determinants.iter().zip(is_told).filter(|(_, told)| **told).map(|(d, _)| *d);
        let mirrored = signs().filter(|d| *d < 0.0).count() > signs().filter(|d| *d > 0.0).count();
        let mut folds = Self { samples: 0, first: None, mirrored, near: Vec::new() };

        let differs = |i: usize| is_told[i] && folds.differs(determinants[i]);
        let doubles_back = |i: usize, j: usize| {
            let image = |i: usize| area_image(&gradient(&expansions[i]), normals[i]);
            normals[i].dot(normals[j]) > 0.0 && image(i).dot(image(j)) < 0.0
        };
        let around = |i: usize| neighbours(i).iter().map(|j| *j as usize);
        let at_the_fold = |i: &usize| differs(*i) && around(*i).any(|j| !differs(j) && doubles_back(*i, j));
        let mut to_visit: Vec<usize> = all().filter(at_the_fold).collect();
        let mut folded = vec![false; expansions.len()];
        while let Some(i) = to_visit.pop() {
            if !std::mem::replace(&mut folded[i], true) {
                to_visit.extend(around(i).filter(|j| differs(*j) && !folded[*j]));
            }
        }
        folds.samples = folded.iter().filter(|f| **f).count() as u64;
        folds.first = folded.iter().position(|f| *f);
        if folds.samples > 0 {
            folds.near = all().map(|i| folded[i] || around(i).any(|j| folded[j])).collect();
        }
        folds
    }

    /// Whether a vertex of this home is folded, where the deformation has this gradient.
    pub fn contains(&self, home: usize, gradient: &Mat3) -> bool {
        self.near.get(home).is_some_and(|near| *near) && self.differs(gradient.determinant())
    }

    /// Whether a determinant of a gradient has another sign than most samples have.
    fn differs(&self, determinant: f32) -> bool {
        if self.mirrored { determinant > 0.0 } else { determinant < 0.0 }
    }
}

/// Image of a unit piece of surface across `normal`, as the vector of its area: on the same side as seen
/// within the surface, whether or not the deformation mirrors.
fn area_image(gradient: &Mat3, normal: Vec3) -> Vec3 {
    let (s, t) = normal.any_orthonormal_pair();
    (*gradient * s).cross(*gradient * t) * s.cross(t).dot(normal).signum()
}

/// A file of figures in the making, vertex by vertex: a binary PLY file with the deformed positions, which
/// any viewer of scalar fields opens. Dropped before [`commit`](Self::commit), it leaves no trace.
///
/// Memory: a few hundred kilobytes.
pub struct DiagnosticsFile {
    file: OutputFile,
    path: PathBuf,
    scalar: Scalar,
    /// Whether the vertices are splats, whose anisotropy is written.
    of_splats: bool,
    /// One over the model's diagonal at rest.
    inverse_diagonal: f64,
    /// Number of folded vertices up to here.
    pub folded: u64,
}

impl DiagnosticsFile {
    /// Size of such a file of a model, in bytes, but for its header.
    pub fn expected_bytes(model: &dyn Model) -> u64 {
        let info = model.info();
        let anisotropy = if has_splats(model) { 4 } else { 0 };
        info.vertices * (3 * info.position_type.size() as u64 + VertexDiagnostics::BYTES + anisotropy)
    }

    /// Begins the file of a model with this diagonal at rest.
    ///
    /// # Errors
    /// As for [`OutputFile::create`], and [`write`](Self::write).
    pub fn create(path: &Path, model: &dyn Model, diagonal: f64) -> Result<Self> {
        let (info, of_splats) = (model.info(), has_splats(model));
        let scalar = info.position_type;
        let kind = match scalar {
            Scalar::F32 => "float",
            Scalar::F64 => "double",
        };
        let mut header = String::from("ply\nformat binary_little_endian 1.0\ncomment SIMOD diagnostics\n");
        header.push_str(&format!("element vertex {}\n", info.vertices));
        let of_floats = ["displacement", "stretch_max", "stretch_min"].map(|name| ("float", name));
        let position = ["x", "y", "z"].map(|name| (kind, name));
        let expected = ["expected_error", "expected_error_fraction"].map(|name| ("float", name));
        let all = position.into_iter().chain(of_floats).chain([("uchar", "folded")]).chain(expected);
        let all = all.chain(of_splats.then_some(("float", "anisotropy")));
        for (kind, name) in all {
            header.push_str(&format!("property {kind} {name}\n"));
        }
        header.push_str("end_header\n");
        let file = OutputFile::create(path, Self::expected_bytes(model))?;
        let inverse_diagonal = 1.0 / diagonal.max(f64::MIN_POSITIVE);
        let path = path.to_owned();
        let mut this = Self { file, path, scalar, of_splats, inverse_diagonal, folded: 0 };
        this.file.write_all(header.as_bytes()).map_err(|e| this.failed(e))?;
        Ok(this)
    }

    /// Writes the next vertices: their positions after the deformation, in the model's coordinates, and as
    /// many figures.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub fn write(&mut self, positions: &[DVec3], figures: &[VertexDiagnostics]) -> Result<()> {
        let mut bytes = Vec::new();
        for (positions, figures) in positions.chunks(BLOCK).zip(figures.chunks(BLOCK)) {
            bytes.clear();
            for (p, f) in positions.iter().zip(figures) {
                match self.scalar {
                    Scalar::F32 => {
                        bytes.extend_from_slice(p.as_vec3().to_array().map(f32::to_le_bytes).as_flattened());
                    }
                    Scalar::F64 => {
                        bytes.extend_from_slice(p.to_array().map(f64::to_le_bytes).as_flattened());
                    }
                }
                let numbers = [f.displacement, f.stretch[0], f.stretch[1]].map(f32::to_le_bytes);
                bytes.extend_from_slice(numbers.as_flattened());
                bytes.push(f.folded.into());
                self.folded += u64::from(f.folded);
                let part = f64::from(f.expected_error) * self.inverse_diagonal;
                bytes.extend_from_slice([f.expected_error, part as f32].map(f32::to_le_bytes).as_flattened());
                if self.of_splats {
                    bytes.extend_from_slice(&f.anisotropy.to_le_bytes());
                }
            }
            self.file.write_all(&bytes).map_err(|e| self.failed(e))?;
        }
        Ok(())
    }

    /// Puts the file in its place, once all of it is on the disk.
    ///
    /// # Errors
    /// As for [`OutputFile::commit`].
    pub fn commit(self) -> Result<()> {
        self.file.commit()
    }

    fn failed(&self, error: io::Error) -> Error {
        error.downcast().unwrap_or_else(|e| Error::io("write", &self.path, &e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;

    #[test]
    fn stretches_are_those_within_the_surface() {
        let close = |gradient: Mat3, normal: Vec3, expected: [f32; 2]| {
            let found = principal_stretches(&gradient, normal);
            let worst = (0..2).map(|i| (found[i] - expected[i]).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-5, "{gradient} {normal}: {found:?} is not {expected:?}");
        };
        let scale = Mat3::from_diagonal(Vec3::new(2.0, 0.5, 3.0));
        let (before, after) = (Quat::from_rotation_x(0.7), Quat::from_rotation_y(-1.9));
        for (normal, expected) in [(Vec3::X, [3.0, 0.5]), (Vec3::Y, [3.0, 2.0]), (Vec3::Z, [2.0, 0.5])] {
            close(Mat3::IDENTITY, normal, [1.0, 1.0]);
            close(scale, normal, expected);
            close(scale * -1.0, 7.0 * normal, expected);
            let turned = Mat3::from_quat(after) * scale * Mat3::from_quat(before.inverse());
            close(turned, before * normal, expected);
        }
        // A shear by 1: the golden ratio, and its inverse.
        let shear = Mat3::from_cols(Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Z);
        close(shear, Vec3::Z, [1.618_034, 0.618_034]);
        close(Mat3::from_diagonal(Vec3::new(2.0, 0.0, 1.0)), Vec3::Z, [2.0, 0.0]);
        close(Mat3::ZERO, Vec3::Z, [0.0, 0.0]);
        assert!(principal_stretches(&scale, Vec3::ZERO).iter().all(|s| s.is_nan()));
    }

    #[test]
    fn the_minority_is_folded_if_the_surface_doubles_back() {
        // A row of samples on a plane.
        let of = |scales: &[Vec3], is_told: &[bool]| {
            let expansion = |s: &Vec3| {
                Expansion::new(Vec3::ZERO, Vec3::ZERO, Mat3::from_diagonal(*s - 1.0), [Vec3::ZERO; 6])
            };
            let expansions: Vec<Expansion> = scales.iter().map(expansion).collect();
            let neighbours = |i: usize| -> &[u32] { [&[1][..], &[0, 2], &[1, 3], &[2]][i] };
            let folds = Folds::new(
                &expansions,
                is_told,
                &[Vec3::Z; 4][..scales.len()],
                neighbours,
                &ListStorage::Memory,
            );
            (folds.samples, folds.first)
        };
        let along = |x: f32| Vec3::new(x, 1.0, 1.0);
        let (plain, back, across) = (Vec3::ONE, along(-1.0), Vec3::new(1.0, 1.0, -1.0));
        let all = &[true; 4];
        assert_eq!(of(&[plain, along(2.0), along(0.5), plain], all), (0, None));
        assert_eq!(of(&[plain, plain, plain, back], all), (1, Some(3)));
        assert_eq!(of(&[plain, plain, along(-2.0), back], all), (2, Some(2)));
        assert_eq!(of(&[back, along(-2.0), back, plain], all), (1, Some(3)));
        assert_eq!(of(&[back; 4], all), (0, None));
        assert_eq!(of(&[plain, along(0.0), along(f32::NAN), plain], all), (0, None));
        assert_eq!(of(&[plain, plain, plain, back], &[true, true, true, false]), (0, None));
        // By its relief alone.
        assert_eq!(of(&[plain, plain, across, plain], all), (0, None));
        assert_eq!(of(&[back, plain, plain, across], all), (1, Some(0)));
    }
}
