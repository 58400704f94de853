//! All that a user can do. A list of commands, one JSON object a line, is a recording of an edit.

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

/// One thing that a user does. Steps are known by their place, 0 for the first; pixels are counted from the
/// top left of the picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Opens a model, the folder of a sampled one, or a session.
    Open {
        /// The path of the file or folder.
        path: PathBuf,
        /// How finely a model is sampled.
        #[serde(default)]
        sampling: SamplingTable,
        /// Takes what was kept of it against a crash.
        #[serde(default)]
        recover: bool,
    },
    /// Opens a session or the folder of a sampled model whose model was moved.
    Locate {
        /// The path of the session or folder.
        path: PathBuf,
        /// Where the model is now.
        model: PathBuf,
        /// Takes what was kept of it against a crash.
        #[serde(default)]
        recover: bool,
    },
    /// Changes the steps.
    Edit(edit::EditCommand),
    /// Changes them while something is dragged: a draft is made of it. All changes of the same thing are
    /// undone as one.
    Drag(edit::EditCommand),
    /// The end of a drag: what was dragged rests.
    Rest,
    /// Takes the last change of the steps, or of the selection, back.
    Undo,
    /// Does it again.
    Redo,
    /// Works on a step from now on.
    Choose {
        /// The step's place; none for the model itself.
        step: Option<usize>,
    },
    /// A new step of a plugin, with its defaults, which is chosen.
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
        /// The place of the first; behind the chosen one if it is not given, or the last ones.
        #[serde(default)]
        at: Option<usize>,
    },
    /// Selects samples.
    Select {
        /// The samples that are meant.
        area: Area,
        /// What becomes of those that are selected.
        #[serde(default)]
        combine: Combine,
        /// Only those that can be seen, instead of all that are behind each other.
        #[serde(default)]
        visible: bool,
        /// Goes on with the command before, as while a brush is moved: both are undone as one.
        #[serde(default)]
        goes_on: bool,
    },
    /// Makes a region of what is selected.
    MakeRegion {
        /// The step.
        step: usize,
        /// What the region is for.
        role: Role,
        /// How far beyond its border it fades out, in the model's unit.
        #[serde(default)]
        falloff: f64,
        /// The region that it takes the place of, with its motion; otherwise it is one more.
        #[serde(default)]
        replaces: Option<usize>,
    },
    /// Makes a handle region of what is selected, and a fixed one of what is farther from it along the
    /// surface than a band, which bends.
    MakeHandle {
        /// The step.
        step: usize,
        /// How wide the band is, in the model's unit.
        band: f64,
    },
    /// More samples where it is selected, as a new step behind the others.
    RefineSelection {
        /// The fineness that is wanted.
        finer: Finer,
    },
    /// A joint of a skeleton of the user's, moved if there is one of this id.
    PlaceJoint {
        /// The step.
        step: usize,
        /// The joint's id.
        id: String,
        /// Where it is at rest, model coordinates, as the step finds them.
        at: DVec3,
        /// The joint that it hangs on.
        #[serde(default)]
        parent: Option<String>,
    },
    /// A brush is put on the surface.
    BeginStroke {
        /// The step.
        step: usize,
        /// Radius of the brush, in the model's unit.
        radius: f64,
        /// 1 is full strength, negative ones do the opposite.
        strength: f64,
        /// The parameters that differ from the step's.
        #[serde(default)]
        params: toml::Table,
    },
    /// The brush moves.
    StrokePoint {
        /// Where to, model coordinates, as the step finds them: see
        /// [`State::in_step`](crate::State::in_step).
        at: DVec3,
        /// The pen's pressure, 0 to 1, if there is a pen.
        #[serde(default)]
        pressure: Option<f32>,
    },
    /// The brush is lifted, and the stroke is one of the step's.
    EndStroke,
    /// The stroke is not wanted.
    DropStroke,
    /// Saves the session, at its path or another one.
    Save {
        /// Another one.
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
    /// The picture has another size.
    Resize {
        /// Width and height in pixels.
        size: [f64; 2],
    },
    /// Moves the camera.
    Camera(CameraMove),
    /// Shows something else on the surface.
    Show(Overlay),
    /// Shows the model's own colours where no numbers are shown, or does not: shown at first.
    ShowOwnColors(bool),
    /// Cuts the model open, to be looked into, or closes it again. What is cut away is not seen, and cannot
    /// be pointed at; the edit is as it was.
    Clip(Option<Clip>),
    /// Measures along these points instead of the former ones; none measure nothing.
    Measure {
        /// Where they are before all steps, model coordinates: they go along with the surface; see
        /// [`State::at_rest`](crate::State::at_rest).
        points: Vec<DVec3>,
    },
    /// Shows a part of the model in full instead of its samples: its vertices are streamed, again each time
    /// the edit rests after they have moved. It is no part of the edit.
    Preview {
        /// The part of the model.
        what: Previewed,
    },
    /// Keeps the steps as they are now, with what they come to, as the version to compare with.
    Pin,
    /// Takes the steps of a session as the version to compare with, done on the samples that are there.
    PinSession {
        /// The session's file.
        path: PathBuf,
    },
    /// There is no version to compare with any more.
    Unpin,
    /// Goes on with the version to compare with, which the steps so far become.
    SwapPinned,
}

/// A part of the samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Area {
    /// All.
    All,
    /// None.
    None,
    /// All others than those that are selected.
    Inverse,
    /// One more around those that are selected.
    Grown,
    /// The selection, smaller by a ring.
    Shrunk,
    /// Under a brush that is moved along pixels.
    Brush {
        /// The pixels.
        path: Vec<[f64; 2]>,
        /// The radius in pixels.
        radius: f64,
    },
    /// Within a line that goes round.
    Lasso {
        /// The pixels on its way.
        path: Vec<[f64; 2]>,
    },
    /// Within a box.
    Box {
        /// A corner of the rectangle.
        from: [f64; 2],
        /// The opposite one.
        to: [f64; 2],
    },
    /// All that is connected with what is seen at a pixel.
    Connected {
        /// The pixel.
        at: [f64; 2],
    },
    /// Where a region of a step has at least half of its weight.
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
    /// Round its target.
    Orbit {
        /// The turn to the right, in radians.
        yaw: f64,
        /// Upwards, radians.
        pitch: f64,
    },
    /// Along the picture.
    Pan {
        /// How far the pointer moved, in pixels.
        by: [f64; 2],
    },
    /// Nearer to what is under the pointer, or away from it.
    Zoom {
        /// By how much things get larger.
        factor: f64,
        /// The pointer's pixel.
        at: [f64; 2],
    },
    /// All of the model is seen.
    FrameAll,
    /// All that is selected is seen.
    FrameSelection,
    /// From a side that has a name.
    Look(Standard),
    /// How depth shows.
    Project(Projection),
    /// Has another axis point up.
    Up(Up),
    /// As it was some other time.
    Set(Camera),
}
