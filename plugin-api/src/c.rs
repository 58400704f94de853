//! The interface for plugins in C, and in whatever else can lay out C's structs: the same calls as
//! [`Deformer`](crate::Deformer) and its extensions, without Rust and without `abi_stable`.
//!
//! `include/simod_plugin.h` is made of this file, comments included, by `tests/c_header.rs`; what concerns
//! all of it is in `cbindgen.toml`. So names and comments are those of the header.
//!
//! There are only declarations here. The host's `CCode` reads what a plugin gives, and trusts none of it.
//!
//! The rules of evolution are those of the Rust interface: no struct ever changes, and what comes later is
//! known by an id. Zero is a sensible value of whatever may be left out of an initialiser.

use std::ffi::{c_char, c_void};

/// The version of this interface. A host refuses plugins of another major version. The minor one counts up as
/// ids and codes are added: a plugin that was built with a later header still works, as long as it needs
/// nothing later.
pub const SIMOD_INTERFACE_MAJOR: u32 = 1;
/// See SIMOD_INTERFACE_MAJOR.
pub const SIMOD_INTERFACE_MINOR: u32 = 5;

/// Code that a call returns if all is well. Every other code is an error.
pub const SIMOD_OK: u32 = 0;
/// A parameter's value makes no sense, alone or together with others.
pub const SIMOD_INVALID_PARAMETER: u32 = 1;
/// The samples, the regions or their transforms cannot be worked on.
pub const SIMOD_INVALID_INPUT: u32 = 2;
/// A solver did not get to an answer.
pub const SIMOD_NOT_CONVERGED: u32 = 3;
/// The host asked to stop (its `progress` or `parallel_for` gave false), and the plugin did. Needs no
/// message.
pub const SIMOD_CANCELLED: u32 = 4;
/// A bug of the plugin or the host, or memory that ran out.
pub const SIMOD_INTERNAL: u32 = 6;
/// Something that the plugin needs is missing: the host is older, or the samples have no triangles.
pub const SIMOD_UNSUPPORTED: u32 = 7;

/// One number.
pub const SIMOD_PARAM_FLOAT: u32 = 1;
/// One whole number, exact up to 2^53.
pub const SIMOD_PARAM_INT: u32 = 2;
/// One number, 0 or 1.
pub const SIMOD_PARAM_BOOL: u32 = 3;
/// The id of one of the choices, as text.
pub const SIMOD_PARAM_CHOICE: u32 = 4;
/// Three numbers: a direction, as the user gave it; of any length, perhaps zero.
pub const SIMOD_PARAM_DIRECTION: u32 = 5;
/// Three numbers: a point in local coordinates. Its default is in fractions of the bounding box.
pub const SIMOD_PARAM_POINT: u32 = 6;
/// Four numbers, 0 to 1: linear red, green, blue, and opacity.
pub const SIMOD_PARAM_COLOUR: u32 = 7;
/// Pairs of numbers x, y, 0 to 1, of ascending x: at least two points of a curve. Other plugins take it as a
/// monotone cubic (Fritsch and Carlson 1980) with harmonic means for slopes, constant beyond its ends.
pub const SIMOD_PARAM_CURVE: u32 = 8;
/// The path of a file that can be read, as text; empty where the user gave none.
pub const SIMOD_PARAM_FILE: u32 = 9;
/// The path of another model, as text, for messages; empty where the user gave none. The host reads it and
/// hands over its points: see SIMOD_INPUT_OTHER_MODELS. Its default number is how many points the plugin
/// takes at most, 1 to 4194304; set `invalidates_preparation`.
pub const SIMOD_PARAM_MODEL: u32 = 10;

/// Nothing.
pub const SIMOD_UNIT_NONE: u32 = 0;
/// Degrees of an angle.
pub const SIMOD_UNIT_DEGREES: u32 = 1;
/// A length: the model's unit for the user, local units for the plugin.
pub const SIMOD_UNIT_MODEL_LENGTH: u32 = 2;
/// A fraction of the diagonal of the bounding box, for both. The better one for defaults.
pub const SIMOD_UNIT_DIAGONAL: u32 = 3;
/// A ratio: 1 leaves things as they are.
pub const SIMOD_UNIT_RATIO: u32 = 4;

/// Samples of such a region stay where they are.
pub const SIMOD_ROLE_FIXED: u32 = 1;
/// Samples of such a region follow its transform.
pub const SIMOD_ROLE_HANDLE: u32 = 2;

/// A message for the plugin's author.
pub const SIMOD_LOG_DEBUG: u32 = 1;
/// A message for a curious user.
pub const SIMOD_LOG_INFO: u32 = 2;
/// The result may not be what the user wants.
pub const SIMOD_LOG_WARNING: u32 = 3;

/// A handle that can be shifted.
pub const SIMOD_GIZMO_TRANSLATE: u32 = 1;
/// A handle that can be turned about its position.
pub const SIMOD_GIZMO_ROTATE: u32 = 2;
/// A handle that can be scaled about its position.
pub const SIMOD_GIZMO_SCALE: u32 = 4;

/// The best result.
pub const SIMOD_EFFORT_FULL: u32 = 1;
/// Soon, while a handle is dragged.
pub const SIMOD_EFFORT_DRAFT: u32 = 2;

/// Positions of the samples as the step is given them: `SimodSamples.positions`.
pub const SIMOD_POSE_CURRENT: u32 = 1;
/// Positions of the samples before all steps, for plugins that use SIMOD_INPUT_REST_POSITIONS.
pub const SIMOD_POSE_REST: u32 = 2;

/// An attribute of whole numbers from -128 to 127.
pub const SIMOD_ATTRIBUTE_I8: u32 = 1;
/// An attribute of whole numbers from 0 to 255, as colours often are.
pub const SIMOD_ATTRIBUTE_U8: u32 = 2;
/// An attribute of whole numbers of 16 bits with a sign.
pub const SIMOD_ATTRIBUTE_I16: u32 = 3;
/// An attribute of whole numbers from 0 to 65535.
pub const SIMOD_ATTRIBUTE_U16: u32 = 4;
/// An attribute of whole numbers of 32 bits with a sign.
pub const SIMOD_ATTRIBUTE_I32: u32 = 5;
/// An attribute of whole numbers of 32 bits, from 0 on.
pub const SIMOD_ATTRIBUTE_U32: u32 = 6;
/// An attribute of numbers in single precision.
pub const SIMOD_ATTRIBUTE_F32: u32 = 7;
/// An attribute of numbers in double precision.
pub const SIMOD_ATTRIBUTE_F64: u32 = 8;

/// The host has sampled the other model for this call.
pub const SIMOD_POINTS_SAMPLED: u32 = 1;
/// Samples that the user has: a sampled model, or a file of samples that anything has moved.
pub const SIMOD_POINTS_SAMPLES: u32 = 2;

/// The parent of a joint or a handle that hangs on no other.
pub const SIMOD_ROOT: u32 = u32::MAX;

/// One of the alternatives of a SIMOD_PARAM_CHOICE, or an extension of a SIMOD_PARAM_FILE's name.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodChoiceDesc {
    /// Stable id, kebab-case; stored in files. Of a file: the extension, without a dot.
    pub id: *const c_char,
    /// Name for the user; the id where it is NULL.
    pub label: *const c_char,
}

/// A parameter: described by the plugin; shown, stored, checked and undone by the host.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodParamDesc {
    /// Stable id, kebab-case, unique among the plugin's parameters; stored in files.
    pub id: *const c_char,
    /// Name for the user; the id where it is NULL.
    pub name: *const c_char,
    /// One line on what it does. May be NULL.
    pub hint: *const c_char,
    /// Parameters of one group are shown together. May be NULL.
    pub group: *const c_char,
    /// Kind of value: SIMOD_PARAM_...
    pub kind: u32,
    /// Unit of its numbers: SIMOD_UNIT_...
    pub unit: u32,
    /// The host refuses values outside, smallest and largest: {0, 0} for no limit, else -INFINITY or INFINITY
    /// for none on that side.
    pub hard_range: [f64; 2],
    /// Range of a slider, in the same way; values outside are fine.
    pub soft_range: [f64; 2],
    /// Default of the kinds of one to four numbers: as many as the kind has. Of SIMOD_PARAM_MODEL the most
    /// points.
    pub default_numbers: [f64; 4],
    /// Default of the kinds of any number of them, as x0, y0, x1, y1, ... of a curve. Else NULL.
    pub default_list: *const f64,
    /// Number of numbers in `default_list`.
    pub default_list_length: usize,
    /// Default of a choice: the id of one. Else NULL.
    pub default_text: *const c_char,
    /// The alternatives of a choice, or the extensions that a file's name may have (NULL for any).
    pub choices: *const SimodChoiceDesc,
    /// Number of choices.
    pub choice_count: usize,
    /// 1 if the state must be prepared anew once the value changed: if `prepare` reads it.
    pub invalidates_preparation: u8,
}

/// An input that the plugin uses besides the positions: an id SIMOD_INPUT_...
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodInputDesc {
    /// The id.
    pub id: *const c_char,
    /// Number of such inputs that the plugin needs: where there are fewer, it is not called. 0 for an input
    /// that it uses if there is one.
    pub at_least: u32,
}

/// A plugin's description of itself: its names, its parameters and the inputs that it uses.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodDescriptor {
    /// Stable id, kebab-case; what sessions call the plugin.
    pub id: *const c_char,
    /// Name for the user.
    pub name: *const c_char,
    /// The plugin's own version: "major.minor.patch".
    pub version: *const c_char,
    /// One line on what it does.
    pub summary: *const c_char,
    /// The publication that it implements. May be NULL.
    pub citation: *const c_char,
    /// Author of the plugin, whom its users may ask. May be NULL.
    pub author: *const c_char,
    /// Address of a page on the plugin. May be NULL.
    pub url: *const c_char,
    /// The plugin's parameters, in the order to show them. Their values come in this order.
    pub params: *const SimodParamDesc,
    /// Number of parameters.
    pub param_count: usize,
    /// The inputs that it uses.
    pub inputs: *const SimodInputDesc,
    /// Number of inputs that the plugin uses.
    pub input_count: usize,
}

/// A parameter's value, checked by the host against its description.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodParam {
    /// Id of the parameter that has this value.
    pub id: *const c_char,
    /// Kind of value: SIMOD_PARAM_...
    pub kind: u32,
    /// The parameter's numbers; NULL where it is a text.
    pub numbers: *const f64,
    /// Number of numbers.
    pub count: usize,
    /// The parameter's text; "" where it is numbers.
    pub text: *const c_char,
}

/// The samples at rest. Arrays of `count` entries; `count` is at least 1, but where the host asks whether
/// there is anything to do.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodSamples {
    /// Number of samples.
    pub count: usize,
    /// Rest positions, local coordinates, all finite.
    pub positions: *const [f32; 3],
    /// Unit normals, or NULL. They fit the positions if the plugin uses SIMOD_INPUT_NORMALS; else they may be
    /// stale.
    pub normals: *const [f32; 3],
    /// Distance to the nearest other samples, local coordinates, or NULL.
    pub spacing: *const f32,
}

/// An axis-aligned box, local coordinates.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodBounds {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

/// A part of the samples, with a role.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodRegion {
    /// Role of its samples: SIMOD_ROLE_...
    pub role: u32,
    /// One weight per sample, 0 (outside) to 1 (inside).
    pub weights: *const f32,
}

/// An affine map: x goes to M x + t, where the rows are those of `[M | t]`. Local coordinates.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodAffine {
    /// Three rows of four.
    pub rows: [[f64; 4]; 3],
}

/// An input that is known by an id: see `simod_part`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodPart {
    /// SIMOD_INPUT_...
    pub id: *const c_char,
    /// The struct of that id.
    pub data: *const c_void,
}

/// Input of a preparation: all that its state may depend on.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodPrepareInput {
    /// The samples at rest.
    pub samples: SimodSamples,
    /// The model's box in its rest pose, the same for all steps of a session. Samples may lie outside.
    pub bounds: SimodBounds,
    /// The regions of the roles that the plugin uses, in the user's order.
    pub regions: *const SimodRegion,
    /// Number of regions.
    pub region_count: usize,
    /// The values of all parameters, in the order of the description.
    pub params: *const SimodParam,
    /// As many as there are descriptions.
    pub param_count: usize,
    /// Inputs that are known by ids: triangles, graph, joints, the model's frame.
    pub parts: *const SimodPart,
    /// Number of these inputs.
    pub part_count: usize,
}

/// Input of one deformation: all that it depends on, besides the state.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodDeformInput {
    /// The samples at rest: those of the preparation.
    pub samples: SimodSamples,
    /// The bounding box of the model: that of the preparation.
    pub bounds: SimodBounds,
    /// One map for each region of role SIMOD_ROLE_HANDLE, in their order; all finite.
    pub transforms: *const SimodAffine,
    /// Number of maps.
    pub transform_count: usize,
    /// The values of all parameters, in the order of the description.
    pub params: *const SimodParam,
    /// As many as there are descriptions.
    pub param_count: usize,
    /// Inputs that are known by ids: motions of handles, strokes, the effort.
    pub parts: *const SimodPart,
    /// Number of these inputs.
    pub part_count: usize,
}

/// SIMOD_INPUT_TRIANGLES, of the preparation: triangles between the samples.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodTriangles {
    /// Three samples each, counter-clockwise as seen from outside. Several may share an edge or have no area,
    /// and a sample may be in none.
    pub indices: *const [u32; 3],
    /// Number of triangles, at least one.
    pub count: usize,
}

/// SIMOD_INPUT_GRAPH, of the preparation: the nearest neighbours of each sample at rest.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodGraph {
    /// The neighbours of sample i are those from `starts[i]` up to, and without, `starts[i + 1]`: one entry
    /// more than samples.
    pub starts: *const u32,
    /// Nearest first, without the sample itself. One that is among another's need not have that other among
    /// its own.
    pub neighbours: *const u32,
}

/// SIMOD_INPUT_MODEL_FRAME, of the preparation and where handles are placed: for files in model coordinates.
/// A point of the model lies at (point - origin) / scale in local coordinates.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodModelFrame {
    /// The local origin, in model coordinates.
    pub origin: [f64; 3],
    /// Length of a local unit, in the model's unit; above 0.
    pub scale: f64,
}

/// SIMOD_INPUT_EFFORT, of the deformation: the time that it may take.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodEffort {
    /// SIMOD_EFFORT_...: a draft, while a handle is dragged, may differ a little from the full result.
    pub effort: u32,
}

/// SIMOD_INPUT_TIME, of the deformation: its time in a sequence.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodTime {
    /// Number of the frame in the sequence: 0 for the first one, and where there is no sequence.
    pub frame: i64,
    /// Seconds since the beginning of the sequence; finite.
    pub seconds: f64,
}

/// SIMOD_INPUT_REST_POSITIONS, of the preparation: the samples' positions before all steps.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodRestPositions {
    /// One for each sample, local coordinates, all finite.
    pub positions: *const [f32; 3],
}

/// A property of the model's vertices that is neither position nor normal, as a colour's red or a confidence.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodAttribute {
    /// Name of the attribute in the model's file, as "red"; no two attributes have one name.
    pub name: *const c_char,
    /// Type of its numbers in the file: SIMOD_ATTRIBUTE_...
    pub kind: u32,
    /// One for each sample, in the property's own unit (a colour of SIMOD_ATTRIBUTE_U8 goes from 0 to 255),
    /// all finite: the mean over the vertices that the sample stands for.
    pub values: *const f32,
}

/// SIMOD_INPUT_ATTRIBUTES, of the preparation, of the deformation, and where handles are placed: colours and
/// other attributes of the samples, as far as the model has them. See `simod_attribute`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodAttributes {
    /// In the file's order.
    pub attributes: *const SimodAttribute,
    /// Number of attributes that the model has; may be 0.
    pub count: usize,
}

/// Another model than the one that is deformed: points of it, in the local coordinates of the one that is.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodOtherModel {
    /// The id of the parameter, of SIMOD_PARAM_MODEL, that names it.
    pub param: *const c_char,
    /// Origin of the points: SIMOD_POINTS_... Those of SIMOD_POINTS_SAMPLED are at most as many as the
    /// plugin takes; those of SIMOD_POINTS_SAMPLES are all that there are.
    pub kind: u32,
    /// Number of vertices of the model; of samples the number of samples.
    pub vertices: u64,
    /// Number of points, at least one.
    pub count: usize,
    /// Local coordinates, all finite. They may be far away, where the other model has another origin or unit.
    pub positions: *const [f64; 3],
    /// Unit normals, one for each point: those of the file, or else of the triangles or the neighbours.
    pub normals: *const [f32; 3],
    /// Sample that each point is, no two the same: of a sampled model its index, in a file of samples its
    /// property "id". NULL for SIMOD_POINTS_SAMPLED.
    pub ids: *const u64,
    /// Triangles between the points, counter-clockwise as seen from outside; NULL for a cloud.
    pub triangles: *const [u32; 3],
    /// Number of triangles.
    pub triangle_count: usize,
}

/// SIMOD_INPUT_OTHER_MODELS, of the preparation: the other models that the user gave. See
/// `simod_other_model`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodOtherModels {
    /// In the order of the parameters.
    pub models: *const SimodOtherModel,
    /// Number of other models that the user gave.
    pub count: usize,
}

/// A joint of a skeleton that the user placed.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodJoint {
    /// Stable id, unique among the joints.
    pub id: *const c_char,
    /// Position at rest, local coordinates.
    pub position: [f64; 3],
    /// The index of the joint that it hangs on, less than its own, or SIMOD_ROOT.
    pub parent: u32,
}

/// SIMOD_INPUT_JOINTS, of the preparation and where handles are placed.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodJoints {
    /// Parents come before those that hang on them.
    pub joints: *const SimodJoint,
    /// Number of joints.
    pub count: usize,
}

/// SIMOD_INPUT_HANDLE_MOTIONS, of the deformation: the motions of the plugin's own handles.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodHandleMotions {
    /// One map of space for each handle that the plugin placed, in its order: from the rest pose to the
    /// user's. That of what a handle hangs on is included; the identity where neither was moved.
    pub motions: *const SimodAffine,
    /// Number of handles.
    pub count: usize,
}

/// A brush stroke.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodStroke {
    /// A hash: the same for strokes that are the same in every respect, and nearly surely another for others.
    pub key: u64,
    /// Radius of the brush, local coordinates; above 0.
    pub radius: f64,
    /// 1 is full strength; negative ones do the opposite, as far as the brush has one.
    pub strength: f64,
    /// The stroke's path on or near the surface, local coordinates: a polyline of at least one point.
    pub points: *const [f64; 3],
    /// Number of points: it depends on the user's machine, and must not matter.
    pub point_count: usize,
    /// The pen's pressure at each point, 0 to 1; NULL where there is no pen.
    pub pressures: *const f32,
    /// The values of all parameters for this stroke, in the order of the description.
    pub params: *const SimodParam,
    /// As many as there are descriptions.
    pub param_count: usize,
}

/// SIMOD_INPUT_STROKES, of the deformation.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodStrokes {
    /// First to last.
    pub strokes: *const SimodStroke,
    /// Number of strokes.
    pub count: usize,
}

/// The host, for the length of one call. Its functions may be called from any thread, and take this pointer.
#[repr(C)]
#[derive(Debug)]
pub struct SimodHost {
    /// The host's own.
    pub context: *const c_void,
    /// Tells that so much of the call is done, 0 to 1. Whether to go on: after false the plugin returns
    /// SIMOD_CANCELLED. Costs some nanoseconds; call it at least every 100 ms.
    pub progress: unsafe extern "C" fn(host: *const SimodHost, fraction: f64) -> bool,
    /// A line for the user, of level SIMOD_LOG_... The host copies it, and keeps a hundred of a call.
    pub log: unsafe extern "C" fn(host: *const SimodHost, level: u32, message: *const c_char),
    /// Says what is wrong, in one line without a full stop, and what to do about it (may be NULL). The host
    /// copies both. Gives `code` back, so that a plugin can write: return host->error(host,
    /// SIMOD_INVALID_INPUT, "...", "...");
    pub error: unsafe extern "C" fn(
        host: *const SimodHost,
        code: u32,
        message: *const c_char,
        hint: *const c_char,
    ) -> u32,
    /// Calls body(context, i) once for each i below `count`, in any order, on several of the host's threads:
    /// threads of the plugin's own would crowd the cores. Returns when all is done; may be called from within
    /// a body. False if the user asked to stop: some were not called. A call costs about a microsecond, and
    /// so should the body, or more: give it a block of samples, not a single one.
    pub parallel_for: unsafe extern "C" fn(
        host: *const SimodHost,
        count: usize,
        body: Option<unsafe extern "C" fn(context: *mut c_void, i: usize)>,
        context: *mut c_void,
    ) -> bool,
    /// A capability of the host by id: a SimodNearest for SIMOD_NEAREST and so on, constant. NULL where there
    /// is none.
    pub extension: unsafe extern "C" fn(host: *const SimodHost, id: *const c_char) -> *const c_void,
}

/// A plugin: the exported table. Members that are not said to be required may be NULL.
///
/// States and scratches are pointers to whatever the plugin likes, and NULL where it needs none.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodPlugin {
    /// SIMOD_INTERFACE_MAJOR. Required.
    pub interface_major: u32,
    /// SIMOD_INTERFACE_MINOR. Required.
    pub interface_minor: u32,
    /// sizeof(SimodPlugin). Required.
    pub size: usize,
    /// Description of the plugin: always the same, and valid for as long as the library is loaded. Called
    /// when the library is loaded, on any thread, and perhaps again, one call at a time; takes microseconds.
    /// Required.
    pub describe: Option<unsafe extern "C" fn() -> *const SimodDescriptor>,
    /// All the work that depends neither on transforms nor on parameters that do not invalidate the
    /// preparation: writes a state to *state, which is NULL before. On an error there is none. Called on a
    /// worker thread, several at once. May take long: tells `progress`.
    pub prepare: Option<
        unsafe extern "C" fn(
            input: *const SimodPrepareInput,
            host: *const SimodHost,
            state: *mut *mut c_void,
        ) -> u32,
    >,
    /// Frees a state that is not NULL, on any thread, once no call uses it.
    pub drop_state: Option<unsafe extern "C" fn(state: *mut c_void)>,
    /// Working memory that `deform` may keep from one call to the next, and never a place for results. NULL
    /// is an error: there is no memory.
    pub new_scratch: Option<unsafe extern "C" fn() -> *mut c_void>,
    /// Frees a scratch that is not NULL, on any thread.
    pub drop_scratch: Option<unsafe extern "C" fn(scratch: *mut c_void)>,
    /// Writes the deformed position of sample i to `out[i]`, local coordinates: all input->samples.count of
    /// them, finite. `out` holds nothing of use before, and the host drops it on an error. Handles that do
    /// not move must leave the samples exactly where they are. The same state and input always give the same
    /// positions. Called by several threads at once on one state, each with a scratch of its own.
    /// Interactive: takes milliseconds. Required.
    pub deform: Option<
        unsafe extern "C" fn(
            state: *const c_void,
            input: *const SimodDeformInput,
            scratch: *mut c_void,
            out: *mut [f32; 3],
            host: *const SimodHost,
        ) -> u32,
    >,
    /// A capability by id: a SimodEvaluate for SIMOD_EVALUATE and so on, valid for as long as the library is
    /// loaded; NULL for ids that the plugin does not know. Called when the library is loaded.
    pub extension: Option<unsafe extern "C" fn(id: *const c_char) -> *const c_void>,
}

/// SIMOD_EVALUATE: the deformation is a map of space, known anywhere.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodEvaluate {
    /// Replaces each of `count` points by its image, local coordinates: the same map as `deform`, up to its
    /// rounding. Called by several threads at once, on blocks of any length; points may lie anywhere, and are
    /// finite. Required.
    pub evaluate: Option<
        unsafe extern "C" fn(
            state: *const c_void,
            input: *const SimodDeformInput,
            points: *mut [f64; 3],
            count: usize,
            host: *const SimodHost,
        ) -> u32,
    >,
}

/// A handle that a plugin places.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodHandleDesc {
    /// Stable id, unique among the plugin's handles, without white space; stored in files.
    pub id: *const c_char,
    /// Name for the user; the id where it is NULL.
    pub name: *const c_char,
    /// Position at rest, local coordinates.
    pub position: [f64; 3],
    /// Motions that the handle takes: SIMOD_GIZMO_... added up. 0 for SIMOD_GIZMO_TRANSLATE.
    pub gizmo: u32,
    /// The index of the handle that it hangs on, less than its own, or SIMOD_ROOT: its motion moves this one
    /// along.
    pub parent: u32,
}

/// List to which a plugin adds its handles.
#[repr(C)]
#[derive(Debug)]
pub struct SimodHandleList {
    /// The host's own.
    pub context: *mut c_void,
    /// Adds a handle, not by several threads at once. The host copies it.
    pub add: unsafe extern "C" fn(list: *mut SimodHandleList, handle: *const SimodHandleDesc),
}

/// SIMOD_HANDLES: the plugin has handles of its own, which users move one by one.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodHandles {
    /// Adds the handles for these samples, this box, these parameters and joints; the input has no regions.
    /// How they were moved comes with SIMOD_INPUT_HANDLE_MOTIONS. Called before `prepare`, on any thread, and
    /// whenever the user looks at the handles: takes milliseconds at most. Required.
    pub handles: Option<
        unsafe extern "C" fn(
            input: *const SimodPrepareInput,
            list: *mut SimodHandleList,
            host: *const SimodHost,
        ) -> u32,
    >,
}

/// List to which a plugin adds the faces between its handles.
#[repr(C)]
#[derive(Debug)]
pub struct SimodFaceList {
    /// The host's own.
    pub context: *mut c_void,
    /// Adds a face of `count` corners, three at least: indices of handles, around it. Not by several threads
    /// at once. The host copies them.
    pub add: unsafe extern "C" fn(list: *mut SimodFaceList, corners: *const u32, count: usize),
}

/// SIMOD_HANDLE_FACES: the handles are the corners of a surface, as those of a cage.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodHandleFaces {
    /// Adds the faces between the handles that SIMOD_HANDLES gives for the same input; the host draws them
    /// with their edges. Called as `handles` is, after it. Required.
    pub handle_faces: Option<
        unsafe extern "C" fn(
            input: *const SimodPrepareInput,
            list: *mut SimodFaceList,
            host: *const SimodHost,
        ) -> u32,
    >,
}

/// SIMOD_IS_IDENTITY: the plugin knows when it does nothing.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodIsIdentity {
    /// 1 if `deform` would leave all samples where they are, whatever they are: the host then calls neither
    /// `prepare` nor `deform`. 0 is always right. The input has no samples; takes microseconds. Required.
    pub is_identity: Option<unsafe extern "C" fn(input: *const SimodDeformInput) -> u8>,
}

/// A parameter's former name.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodAlias {
    /// The id that older sessions give; no parameter has it now.
    pub former: *const c_char,
    /// The id that the parameter has now.
    pub now: *const c_char,
}

/// List to which a plugin adds the settings that a session has to give now.
#[repr(C)]
#[derive(Debug)]
pub struct SimodSettingList {
    /// The host's own.
    pub context: *mut c_void,
    /// Gives a parameter. The host copies it. Its kind is what it looks like: SIMOD_PARAM_FLOAT or _INT for a
    /// number, _BOOL, _CHOICE for any text, _DIRECTION for three numbers, _COLOUR for four, _CURVE for pairs.
    pub set: unsafe extern "C" fn(list: *mut SimodSettingList, setting: *const SimodParam),
}

/// SIMOD_MIGRATION: sessions that are older than the plugin keep working.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodMigration {
    /// Counts up, from 1, whenever the meaning of a parameter changes; saved sessions write it down. One that
    /// says no version is of the first. Required.
    pub state_version: u32,
    /// Former names of parameters.
    pub aliases: *const SimodAlias,
    /// Number of aliases.
    pub alias_count: usize,
    /// Gives `to` what a session of version `from`, which is less than that of now, has to give now, of what
    /// it gave: in model coordinates and the user's units, checked by nobody, under the ids of now (aliases
    /// have been applied). What is not given to `to` has its default. Takes microseconds; any thread. The
    /// host has no samples in this call. NULL where all stays as it is.
    pub migrate: Option<
        unsafe extern "C" fn(
            from: u32,
            settings: *const SimodParam,
            count: usize,
            to: *mut SimodSettingList,
            host: *const SimodHost,
        ) -> u32,
    >,
}

/// SIMOD_NEAREST, of the host: the nearest of the samples of the call that it was asked for in. From any
/// thread; the first time it builds a tree, which is kept with the state.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodNearest {
    /// Number of samples within `radius` (INFINITY for all of them); the nearest of them are written to
    /// `found`, nearest first, as many as `capacity`. Those at the same distance are in the order of their
    /// indices. 0 where there are no samples in this pose, SIMOD_POSE_...
    pub find: unsafe extern "C" fn(
        host: *const SimodHost,
        pose: u32,
        point: *const f64,
        radius: f64,
        found: *mut u32,
        capacity: usize,
    ) -> usize,
}

/// A point of the triangles between the samples.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodSurfacePoint {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of its corners, at least 0, which add up to 1.
    pub weights: [f64; 3],
    /// Position of the point, local coordinates.
    pub position: [f64; 3],
    /// Distance from the point that was asked for, or along the ray: a length in local coordinates.
    pub distance: f64,
}

/// SIMOD_SURFACE, of the host: the triangles between the samples, for plugins that use SIMOD_INPUT_TRIANGLES.
/// From any thread; the first time it builds a tree.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SimodSurface {
    /// Whether there are triangles in this pose, SIMOD_POSE_...
    pub has: unsafe extern "C" fn(host: *const SimodHost, pose: u32) -> bool,
    /// Finds the point of the surface that is nearest to a point, if it is not farther away than `radius`;
    /// returns whether there is one.
    pub closest: unsafe extern "C" fn(
        host: *const SimodHost,
        pose: u32,
        point: *const f64,
        radius: f64,
        found: *mut SimodSurfacePoint,
    ) -> bool,
    /// Finds the point in which a ray first meets the surface, from either side, not farther away than
    /// `reach`; returns whether there is one. The direction may be of any length but zero.
    pub ray: unsafe extern "C" fn(
        host: *const SimodHost,
        pose: u32,
        origin: *const f64,
        direction: *const f64,
        reach: f64,
        found: *mut SimodSurfacePoint,
    ) -> bool,
}
