//! Models of any size: their info, their vertices chunk by chunk, sampling, and writing them deformed.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, sync_channel};

use glam::DVec3;
use numpy::PyArray2;
use pyo3::exceptions::{PyIndexError, PyStopIteration};
use pyo3::prelude::*;
use serde_json::{Value, json};
use simod_core::guard::{Guard, OutputKind};
use simod_core::sampling::{Sampling, sample};
use simod_model::{Error, ErrorMark, ModelInfo, ModelName, Result, Scalar, VertexChunk, open_with_columns};
use simod_session::{Running, pipeline};

use crate::arrays;
use crate::errors::OrRaise;
use crate::options::{reconstruction, record, sampling};
use crate::samples::Samples;
use crate::work::{locked, warn, work};

/// Chunks that a reader is ahead.
const AHEAD: usize = 2;

/// A model of any size in a file: a mesh or a point cloud, which is streamed and never held.
///
/// `len(model)` is its number of vertices. All lengths are in the model's own unit, all coordinates are its
/// own, in double precision.
#[pyclass(module = "simod", frozen)]
pub struct Model {
    path: PathBuf,
    columns: Option<String>,
    info: ModelInfo,
    details: Vec<String>,
}

/// Opens a model: PLY, OBJ, STL, GLB, OFF, PCD, LAS, LAZ, E57, .splat, SPZ, or text in columns. No vertex is
/// read yet.
///
/// `columns` names the columns of a text, as "x,y,z,_,nx,ny,nz", where its first line does not.
///
/// Raises FileError or FormatError.
#[pyfunction]
#[pyo3(signature = (path, *, columns = None))]
pub fn open(py: Python<'_>, path: PathBuf, columns: Option<String>) -> PyResult<Model> {
    let open = || -> Result<_> {
        let model = open_with_columns(&path, columns.as_deref())?;
        Ok((model.info().clone(), model.details()))
    };
    let (info, details) = py.detach(open).or_raise(py)?;
    Ok(Model { path, columns, info, details })
}

#[pymethods]
impl Model {
    /// The file.
    #[getter]
    fn path(&self) -> &Path {
        &self.path
    }

    /// Info on the model that is known without reading the vertices: a `simod.Info`.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let ModelInfo { format, vertices, faces, has_normals, bytes, crs, .. } = &self.info;
        let double = self.info.position_type == Scalar::F64;
        let integers = self.info.integers.map(|i| [i.scale.to_array(), i.offset.to_array()]);
        let attributes: Vec<&str> = self.info.attributes.iter().map(|a| a.name.as_str()).collect();
        record(
            py,
            "Info",
            &json!({
                "format": format, "vertices": vertices, "faces": faces, "has_normals": has_normals,
                "double_precision": double, "attributes": attributes, "bytes": bytes, "crs": crs,
                "scale": integers.map(|i| i[0]), "offset": integers.map(|i| i[1]), "details": self.details,
            }),
        )
    }

    /// The unit of the model's lengths, as "metre", where its format says so; otherwise None, and the
    /// coordinate reference system may tell (`info.crs`).
    #[getter]
    fn unit(&self) -> Option<&'static str> {
        ["glTF", "E57"].iter().any(|format| self.info.format.starts_with(format)).then_some("metre")
    }

    fn __len__(&self) -> usize {
        self.info.vertices as usize
    }

    fn __repr__(&self) -> String {
        let ModelInfo { format, vertices, faces, .. } = &self.info;
        format!("<simod.Model {:?}: {format}, {vertices} vertices, {faces} faces>", self.path)
    }

    /// An iterator over the positions of the vertices from `start` to before `stop`, in the file's order:
    /// arrays of shape (N, 3), float64, model coordinates, with N at most 65 536. Positions that are not
    /// finite in the file are not finite here.
    ///
    /// Raises FileError or FormatError while it is read.
    #[pyo3(signature = (start = 0, stop = None))]
    fn chunks(&self, start: i64, stop: Option<i64>) -> PyResult<Chunks> {
        let vertices = self.info.vertices as i64;
        let place = |at: i64| if at < 0 { at + vertices } else { at };
        let (start, stop) = (place(start), stop.map_or(vertices, place).min(vertices));
        if start < 0 || stop < 0 {
            return Err(PyIndexError::new_err(format!("the model has {vertices} vertices")));
        }
        Ok(Chunks::new(self.path.clone(), self.columns.clone(), start as u64..stop as u64))
    }

    /// Samples the model: two streams through the file, in bounded memory. Gives `Samples`.
    ///
    /// `samples` is their number at most; instead of it, `error` is the largest error of what a sample stands
    /// for, as a fraction of the diagonal of the model's bounding box. `by` is "error", "area" or "vertices":
    /// what the samples are spread by. `place` is "faces" or "vertices": what places them. `grid` is the
    /// number of cells along an axis, `memory_limit` bytes to stay below, `temporary` the folder for
    /// temporary files without a name. `progress` is True for a bar on standard error, or a function of
    /// (stage: str, fraction: float | None); what it raises stops the work, as Ctrl-C does.
    #[pyo3(signature = (samples = None, *, error = None, by = None, place = None, grid = None, memory_limit = None,
        temporary = None, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn sample(
        &self,
        py: Python<'_>,
        samples: Option<i64>,
        error: Option<f64>,
        by: Option<&str>,
        place: Option<&str>,
        grid: Option<u32>,
        memory_limit: Option<u64>,
        temporary: Option<PathBuf>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Samples> {
        let sampling = Sampling { memory_limit, ..sampling(py, samples, error, by, place, grid)? };
        let folder = temporary.unwrap_or_else(std::env::temp_dir);
        let (sampled, notes) = work(py, progress, |watch| {
            let model = open_with_columns(&self.path, self.columns.as_deref())?;
            sample(model.as_ref(), &sampling, &folder, watch)
        })?;
        let samples = Samples::new(py, sampled, true)?;
        warn(py, &notes)?;
        Ok(samples)
    }

    /// Writes the model as its samples are deformed now: one stream through the file. Returns a
    /// `simod.Report`.
    ///
    /// `out` appears whole or not at all, and is never the model itself. It has the model's vertices in their
    /// order, and differs in positions and normals alone; with the extension of another format it is
    /// converted to that, which is refused where anything is lost unless `lossy`. `normals` is "transform",
    /// "keep" or "drop". `method` is "blended-jets" or "projected-barycentric". `diagnostics` is a PLY file
    /// to write beside it, of what becomes of the surface at each vertex. With `choose_offset`, the offset of
    /// positions that are stored as integers (LAS) changes where they would not reach. A file of another kind
    /// that is there is replaced with `overwrite` alone. `progress`: see `sample`.
    ///
    /// Raises MismatchError if the model is not what was sampled; nothing is left of `out` then.
    #[pyo3(signature = (samples, out, *, normals = "transform", method = "blended-jets", diagnostics = None,
        choose_offset = false, lossy = false, overwrite = false, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn apply<'py>(
        &self,
        py: Python<'py>,
        samples: &Bound<'py, Samples>,
        out: PathBuf,
        normals: &str,
        method: &str,
        diagnostics: Option<PathBuf>,
        choose_offset: bool,
        lossy: bool,
        overwrite: bool,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let running = Running {
            how: reconstruction(py, normals, method)?,
            diagnostics: diagnostics.as_deref(),
            choose_offset,
            lossy,
            ..Running::default()
        };
        let (sampled, deformed) = samples.get().written(py)?;
        let ((written, seconds), notes) = work(py, progress, |watch| {
            let start = std::time::Instant::now();
            let mut guard = Guard::new(overwrite);
            guard.reads(&self.path);
            let named = ModelName::from_path(&self.path)?;
            guard.writes_model(&out, &named.written_tiles())?;
            diagnostics.iter().try_for_each(|path| guard.writes(path, OutputKind::Model))?;
            if !named.files().iter().all(|file| file.exists()) {
                let what = format!("the model {} is gone since it was opened", self.path.display());
                let hint = "put it back, or open it where it is now: its samples are good for that";
                return Err(Error::system(what, hint));
            }
            let model = sampled.open_source(Some(&self.path), watch).map_err(moved)?;
            let written =
                pipeline::write(&sampled, model, &deformed, &out, &running, watch).map_err(moved)?;
            Ok((written, start.elapsed().as_secs_f64()))
        })?;
        let folded = written.folding.first().copied().flatten().map_or(0, |f| f.samples);
        let expected = written.expected.first().copied().flatten();
        let report = json!({
            "output": out, "vertices": written.vertices, "non_finite": written.non_finite,
            "samples": sampled.samples.len(), "seconds": seconds, "folded_samples": folded,
            "expected_error": expected, "transfer_error": Value::Null, "diagonal": sampled.bounds.diagonal(),
        });
        warn(py, &notes)?;
        record(py, "Report", &report)
    }
}

/// An error about the sampled model's source, with advice for Python instead of an option of the command.
fn moved(error: Error) -> Error {
    if error.is_marked(ErrorMark::OtherSource) {
        return error.hinting("sample it again, or open the file that was sampled and apply to that");
    }
    error
}

type Chunk = Result<Vec<DVec3>>;

/// Positions of a model, chunk by chunk, which another thread reads ahead.
#[pyclass(module = "simod", frozen)]
pub struct Chunks(Mutex<Receiver<Chunk>>);

impl Chunks {
    fn new(path: PathBuf, columns: Option<String>, range: std::ops::Range<u64>) -> Self {
        let (send, receive) = sync_channel::<Chunk>(AHEAD);
        std::thread::spawn(move || {
            let read = || -> Result<()> {
                let model = open_with_columns(&path, columns.as_deref())?;
                let mut reader = model.vertices(range)?;
                reader.skip_attributes();
                let mut chunk = VertexChunk::default();
                while reader.read(&mut chunk)? {
                    if send.send(Ok(std::mem::take(&mut chunk.positions))).is_err() {
                        // No code reads on.
                        break;
                    }
                }
                Ok(())
            };
            if let Err(error) = read() {
                let _ = send.send(Err(error));
            }
        });
        Self(Mutex::new(receive))
    }
}

#[pymethods]
impl Chunks {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        match py.detach(|| locked(&self.0).recv()) {
            Ok(chunk) => arrays::of_points(py, chunk.or_raise(py)?),
            Err(_) => Err(PyStopIteration::new_err(())),
        }
    }
}
