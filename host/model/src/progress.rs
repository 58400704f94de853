//! Progress of long work: how it reports where it is, and learns that it shall stop.

use glam::{DVec3, Vec3};

use crate::bounds::Bounds;
use crate::frame::Frame;
use crate::{Error, Result};

/// Samples of one cell of a model that is being sampled: see [`Progress::emerge`].
pub struct Emerging<'a> {
    /// Whether these are the first samples of a run: those of a run before, if any, are found anew.
    pub first: bool,
    /// The box of the whole model.
    pub bounds: &'a Bounds,
    /// The model's local coordinates.
    pub frame: &'a Frame,
    visit: &'a dyn Fn(Visitor<'_>),
}

/// Takes a position and a normal.
pub type Visitor<'a> = &'a mut dyn FnMut(Vec3, Vec3);

impl<'a> Emerging<'a> {
    /// Samples that `visit` visits, of a model of these bounds and local coordinates.
    pub fn new(first: bool, bounds: &'a Bounds, frame: &'a Frame, visit: &'a dyn Fn(Visitor<'_>)) -> Self {
        Self { first, bounds, frame, visit }
    }

    /// Visits each sample's position, in local coordinates, and its unit normal, zero where it is unknown.
    pub fn for_each(&self, mut visit: impl FnMut(Vec3, Vec3)) {
        (self.visit)(&mut visit);
    }
}

/// Vertices of a model that is going to be sampled: see [`Progress::glimpse`].
pub struct Glimpse<'a> {
    /// The number of vertices.
    pub vertices: u64,
    read: ReadVertex<'a>,
}

/// Gives the position and the normal of a vertex, if there is one of this number.
type ReadVertex<'a> = &'a mut dyn FnMut(u64) -> Result<Option<(DVec3, Vec3)>>;

impl<'a> Glimpse<'a> {
    /// Model of so many vertices, which `read` reads.
    pub fn new(vertices: u64, read: ReadVertex<'a>) -> Self {
        Self { vertices, read }
    }

    /// Vertex of a number: its position in the model's coordinates, and its normal, zero where it has none.
    ///
    /// # Errors
    /// The vertex cannot be read.
    pub fn vertex(&mut self, number: u64) -> Result<Option<(DVec3, Vec3)>> {
        (self.read)(number)
    }
}

/// Receiver of the progress of a long operation, as a progress bar or a window.
///
/// Called from any thread, and often: implementations keep it cheap.
pub trait Progress: Sync {
    /// A new stage begins: a few words for the user, and its size in bytes (0 where it is not known).
    fn begin(&self, stage: &'static str, total_bytes: u64);

    /// A stage begins that prepares a deformation: what does not depend on how things move.
    fn begin_preparation(&self, stage: &'static str, total_bytes: u64) {
        self.begin(stage, total_bytes);
    }

    /// Begins a stage whose size is not in bytes, but in parts of any kind.
    fn begin_parts(&self, stage: &'static str, total: u64) {
        self.begin(stage, total);
    }

    /// Adds so many bytes, or parts, to those of the stage that are done.
    fn advance(&self, bytes: u64);

    /// Whether the user asked to stop. Work looks at it at least every 100 ms.
    fn is_cancelled(&self) -> bool;

    /// Something that the user should know, though the work goes on: one line.
    fn note(&self, _text: &str) {}

    /// Samples that sampling found in a cell that is complete: for those who like to see them come. They are
    /// not the last word: where their number is aimed at, fewer may be left in the end.
    fn emerge(&self, _samples: &Emerging<'_>) {}

    /// A model is going to be sampled whose vertices can be read from anywhere: for those who like to see
    /// some of them before. Sampling begins once this is done.
    fn glimpse(&self, _model: &mut Glimpse<'_>) {}

    /// An error of kind [`Cancelled`](crate::ErrorKind::Cancelled) once the user asked to stop.
    fn check(&self) -> Result<()> {
        if self.is_cancelled() { Err(Error::cancelled()) } else { Ok(()) }
    }
}

/// Progress that is not shown.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, _bytes: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}
