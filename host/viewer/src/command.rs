//! Commands: all that a user can do. A list of commands, one JSON object a line, is a recording of an edit.

use crate::camera::{Camera, Projection, Standard, Up};
use crate::clip::Clip;
use crate::detail::Previewed;
use crate::engine::Job;
use crate::overlay::Overlay;
use crate::selection::Combine;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_core::refinement::Finer;
use simod_session::edit;
use simod_session::session_file::SamplingTable;
use simod_session::step::Role;
use std::path::PathBuf;

/// One action of a user. Steps are known by their place, 0 for the first; pixels are counted from the top
/// left of the picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Opens a model, the folder of a sampled one, or a session.
    Open {
        /// The path of the file or folder.
        path: PathBuf,
        /// Fineness with which a model is sampled.
        #[serde(default)]
        sampling: SamplingTable,
        /// Whether the edit that was kept against a crash is taken instead of the file's.
        #[serde(default)]
        recover: bool,
    },
    /// Opens a session or the folder of a sampled model whose model was moved.
    Locate {
        /// The path of the session or folder.
        path: PathBuf,
        /// Present path of the model.
        model: PathBuf,
        /// Whether the edit that was kept against a crash is taken instead of the file's.
        #[serde(default)]
        recover: bool,
    },
    /// Changes the steps.
    Edit(edit::EditCommand),
    /// Changes the steps while something is dragged: a draft is made of the change. All changes of the same
    /// thing are undone as one.
    Drag(edit::EditCommand),
    /// Ends a drag: the thing that was dragged rests.
    Rest,
    /// Takes the last change of the steps, or of the selection, back.
    Undo,
    /// Does the change again that was taken back last.
    Redo,
    /// Chooses the step that is worked on from now on.
    Choose {
        /// The step's place; none for the model itself.
        step: Option<usize>,
    },
    /// Adds a step of a plugin, with its defaults, and chooses it.
    AddStep {
        /// The plugin's id.
        plugin: String,
        /// The step's place; the last one if it is not given.
        #[serde(default)]
        at: Option<usize>,
    },
    /// Adds the steps of a text, as of a session or as they were [copied](crate::State::copied), the last of
    /// which is chosen.
    Paste {
        /// The text.
        text: String,
        /// Place of the first new step; if not given, behind the chosen step, or behind the last one.
        #[serde(default)]
        at: Option<usize>,
    },
    /// Selects samples.
    Select {
        /// The samples that are meant.
        area: Area,
        /// Effect on the former selection.
        #[serde(default)]
        combine: Combine,
        /// Whether only visible samples are meant, instead of all that are behind each other.
        #[serde(default)]
        visible: bool,
        /// Whether the selection continues that of the command before, as while a brush is moved: both are
        /// undone as one.
        #[serde(default)]
        goes_on: bool,
    },
    /// Makes a region of the selected samples.
    MakeRegion {
        /// The step.
        step: usize,
        /// Role of the region.
        role: Role,
        /// Distance beyond the region's border over which its weight fades out, in the model's unit.
        #[serde(default)]
        falloff: f64,
        /// Place of the region that is replaced, and whose motion the new one keeps; otherwise a region is
        /// added.
        #[serde(default)]
        replaces: Option<usize>,
    },
    /// Makes a handle region of the selected samples, and a fixed one of the samples that are farther from
    /// them along the surface than a band, which bends.
    MakeHandle {
        /// The step.
        step: usize,
        /// Width of the band, in the model's unit.
        band: f64,
    },
    /// Adds samples in the selection, as a new step behind the others.
    RefineSelection {
        /// The fineness that is wanted.
        finer: Finer,
    },
    /// Places a joint of the user's skeleton, or moves the joint of this id.
    PlaceJoint {
        /// The step.
        step: usize,
        /// The joint's id.
        id: String,
        /// Place of the joint at rest, in model coordinates, on the surface as the step finds it.
        at: DVec3,
        /// Id of the joint's parent.
        #[serde(default)]
        parent: Option<String>,
    },
    /// Puts a brush on the surface.
    BeginStroke {
        /// The step.
        step: usize,
        /// Radius of the brush, in the model's unit.
        radius: f64,
        /// Strength: 1 is full; negative ones do the opposite.
        strength: f64,
        /// The parameters that differ from the step's.
        #[serde(default)]
        params: toml::Table,
    },
    /// Moves the brush.
    StrokePoint {
        /// Place of the brush, in model coordinates, on the surface as the step finds it: see
        /// [`State::in_step`](crate::State::in_step).
        at: DVec3,
        /// The pen's pressure, 0 to 1, if there is a pen.
        #[serde(default)]
        pressure: Option<f32>,
    },
    /// Lifts the brush: the stroke becomes one of the step's.
    EndStroke,
    /// Drops the stroke that is being drawn.
    DropStroke,
    /// Saves the session, at its path or another one.
    Save {
        /// Another path.
        #[serde(default)]
        path: Option<PathBuf>,
    },
    /// Writes the deformed model in the background.
    Write {
        /// The file.
        output: PathBuf,
    },
    /// Stops something that runs in the background.
    Cancel {
        /// The job that is stopped.
        job: Job,
    },
    /// Changes the size of the picture.
    Resize {
        /// Width and height in pixels.
        size: [f64; 2],
    },
    /// Moves the camera.
    Camera(CameraMove),
    /// Shows something else on the surface.
    Show(Overlay),
    /// Shows the model's own colours where no numbers are shown, or hides them: shown at first.
    ShowOwnColors(bool),
    /// Cuts the model open, to be looked into, or closes it again. The part that is cut away is not seen,
    /// and cannot be pointed at; the edit is as it was.
    Clip(Option<Clip>),
    /// Measures along these points instead of the former ones; without points nothing is measured.
    Measure {
        /// Places of the points before all steps, in model coordinates: the points go along with the
        /// surface; see [`State::at_rest`](crate::State::at_rest).
        points: Vec<DVec3>,
    },
    /// Shows a part of the model in full instead of its samples: the vertices of the part are streamed,
    /// again each time the edit rests after they have moved. The preview is no part of the edit.
    Preview {
        /// The part of the model.
        what: Previewed,
    },
    /// Keeps the steps as they are now, with their result, as the version to compare with.
    Pin,
    /// Takes the steps of a session as the version to compare with, done on the samples of the open model.
    PinSession {
        /// The session's file.
        path: PathBuf,
    },
    /// Drops the version to compare with.
    Unpin,
    /// Goes on with the version to compare with, in whose place the steps so far are kept.
    SwapPinned,
}

/// A part of the samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Area {
    /// All samples.
    All,
    /// No sample.
    None,
    /// All samples that are not selected.
    Inverse,
    /// The selection, larger by a ring.
    Grown,
    /// The selection, smaller by a ring.
    Shrunk,
    /// Samples under a brush that is moved along pixels.
    Brush {
        /// The pixels.
        path: Vec<[f64; 2]>,
        /// The radius in pixels.
        radius: f64,
    },
    /// Samples within a closed line.
    Lasso {
        /// Pixels along the line.
        path: Vec<[f64; 2]>,
    },
    /// Samples within a rectangle of the picture.
    Box {
        /// A corner of the rectangle.
        from: [f64; 2],
        /// Corner opposite to the first.
        to: [f64; 2],
    },
    /// All samples that are connected with the one seen at a pixel.
    Connected {
        /// The pixel.
        at: [f64; 2],
    },
    /// Samples at which a region of a step has at least half of its weight.
    Region {
        /// The step.
        step: usize,
        /// The region's place among those of the step.
        region: usize,
    },
    /// Lengths of runs of samples that are not selected and selected in turn.
    Runs(Vec<u32>),
}

/// A move of the camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum CameraMove {
    /// Turns the camera round its target.
    Orbit {
        /// The turn to the right, in radians.
        yaw: f64,
        /// Turn upwards, in radians.
        pitch: f64,
    },
    /// Moves the camera along the picture.
    Pan {
        /// Shift of the pointer, in pixels.
        by: [f64; 2],
    },
    /// Brings the camera nearer to the point under the pointer, or farther from it.
    Zoom {
        /// Factor by which things get larger.
        factor: f64,
        /// The pointer's pixel.
        at: [f64; 2],
    },
    /// Shows all of the model.
    FrameAll,
    /// Shows all selected samples.
    FrameSelection,
    /// Looks from a standard side.
    Look(Standard),
    /// Changes the projection of depth.
    Project(Projection),
    /// Makes another axis point up.
    Up(Up),
    /// Sets the camera to a former one.
    Set(Camera),
}
