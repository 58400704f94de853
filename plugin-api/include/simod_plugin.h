// Plugins for SIMOD in C, C++, and in whatever else can lay out C's structs.
//
// A plugin is a dynamic library that exports a table of functions, `simod_plugin_entry`. SIMOD hands it some
// hundred thousand samples of a model, and it writes where each of them goes. How that reaches the model's
// billions of vertices is none of its concern. A whole plugin, which moves everything along x:
//
//     #include "simod_plugin.h"
//
//     enum { BY };
//     static const SimodParamDesc params[] = {
//         [BY] = { .id = "by", .name = "By", .hint = "How far it moves", .kind = SIMOD_PARAM_FLOAT,
//                  .unit = SIMOD_UNIT_MODEL_LENGTH, .default_numbers = { 1 } },
//     };
//     static const SimodDescriptor descriptor = {
//         .id = "shift", .name = "Shift", .version = "1.0.0", .summary = "Moves everything along x",
//         .params = params, .param_count = sizeof params / sizeof *params,
//     };
//     static const SimodDescriptor *describe(void) { return &descriptor; }
//
//     static uint32_t deform(const void *state, const SimodDeformInput *input, void *scratch, float (*out)[3],
//                            const SimodHost *host)
//     {
//         float by = (float)input->params[BY].numbers[0];
//         const float (*p)[3] = input->samples.positions;
//         for (size_t i = 0; i < input->samples.count; i++) {
//             out[i][0] = p[i][0] + by;
//             out[i][1] = p[i][1];
//             out[i][2] = p[i][2];
//         }
//         return SIMOD_OK;
//     }
//
//     const SimodPlugin simod_plugin_entry = {
//         .interface_major = SIMOD_INTERFACE_MAJOR, .interface_minor = SIMOD_INTERFACE_MINOR,
//         .size = sizeof(SimodPlugin), .describe = describe, .deform = deform,
//     };
//
//     cc -O2 -shared -fPIC -o shift.so shift.c && simod plugin check shift.so
//
// Coordinates. Everything is in local coordinates: the model's own, minus an origin and divided by a scale
// that the host chose so that float positions keep their digits and the model's diagonal lies between 1 and
// 2. Axes are the model's. Points, lengths in SIMOD_UNIT_MODEL_LENGTH and transforms are local as well.
//
// Ownership. What the host passes is the host's, must not be written to (but for `out`, `points` and
// `*state`), and is gone when the call returns. What the plugin passes the host copies before the call
// returns; tables and descriptions it reads for as long as the library is loaded, which is until the process
// ends. States and scratches are the plugin's own, and the host says when to free them.
//
// Threads. Each function says on which threads it is called. Nothing may depend on the thread or on variables
// that are not constant: several sessions and layers use a plugin at once.
//
// Errors. Calls return SIMOD_OK or another code, and say by host->error what is wrong and what to do about
// it. No exception and no longjmp may leave a function of the plugin, and it never ends the process.
//
// Text is UTF-8, ends with a NUL, and is of one line.
//
// Evolution. Nothing here ever changes: what comes later has another id or code, and unknown ones are refused
// or passed over. Ids of third parties begin with a domain of theirs ("org.vendor.thing/1"), those that may
// still change with "draft.". What is left out of an initialiser is zero, and zero is fine wherever nothing
// else is said.
//
// Made of plugin-api/src/c.rs in the sources of SIMOD: change that.


#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

// Inputs that a plugin names in its description.
#define SIMOD_INPUT_FIXED_REGIONS "simod.fixed-regions/1"
#define SIMOD_INPUT_HANDLE_REGIONS "simod.handle-regions/1"
#define SIMOD_INPUT_NORMALS "simod.normals/1"
#define SIMOD_INPUT_TRIANGLES "simod.triangles/1"
#define SIMOD_INPUT_GRAPH "simod.graph/1"
#define SIMOD_INPUT_JOINTS "simod.joints/1"
#define SIMOD_INPUT_STROKES "simod.strokes/1"
#define SIMOD_INPUT_MODEL_FRAME "simod.model-frame/1"
#define SIMOD_INPUT_EFFORT "simod.effort/1"
#define SIMOD_INPUT_TIME "simod.time/1"
#define SIMOD_INPUT_REST_POSITIONS "simod.rest-positions/1"
#define SIMOD_INPUT_ATTRIBUTES "simod.attributes/1"
// Inputs that plugins get unasked: whoever places handles, and whoever has parameters of SIMOD_PARAM_MODEL.
#define SIMOD_INPUT_HANDLE_MOTIONS "simod.handle-motions/1"
#define SIMOD_INPUT_OTHER_MODELS "simod.other-models/1"

// Capabilities that a plugin's `extension` is asked for.
#define SIMOD_EVALUATE "simod.evaluate/1"
#define SIMOD_HANDLES "simod.handles/1"
#define SIMOD_HANDLE_FACES "simod.handle-faces/1"
#define SIMOD_IS_IDENTITY "simod.is-identity/1"
#define SIMOD_MIGRATION "simod.migration/1"

// Services that the host's `extension` is asked for.
#define SIMOD_NEAREST "simod.nearest/1"
#define SIMOD_SURFACE "simod.surface/1"


// The version of this interface. A host refuses plugins of another major version. The minor one counts up as
// ids and codes are added: a plugin that was built with a later header still works, as long as it needs
// nothing later.
#define SIMOD_INTERFACE_MAJOR 1

// See SIMOD_INTERFACE_MAJOR.
#define SIMOD_INTERFACE_MINOR 5

// Code that a call returns if all is well. Every other code is an error.
#define SIMOD_OK 0

// A parameter's value makes no sense, alone or together with others.
#define SIMOD_INVALID_PARAMETER 1

// The samples, the regions or their transforms cannot be worked on.
#define SIMOD_INVALID_INPUT 2

// A solver did not get to an answer.
#define SIMOD_NOT_CONVERGED 3

// The host asked to stop (its `progress` or `parallel_for` gave false), and the plugin did. Needs no
// message.
#define SIMOD_CANCELLED 4

// A bug of the plugin or the host, or memory that ran out.
#define SIMOD_INTERNAL 6

// Something that the plugin needs is missing: the host is older, or the samples have no triangles.
#define SIMOD_UNSUPPORTED 7

// One number.
#define SIMOD_PARAM_FLOAT 1

// One whole number, exact up to 2^53.
#define SIMOD_PARAM_INT 2

// One number, 0 or 1.
#define SIMOD_PARAM_BOOL 3

// The id of one of the choices, as text.
#define SIMOD_PARAM_CHOICE 4

// Three numbers: a direction, as the user gave it; of any length, perhaps zero.
#define SIMOD_PARAM_DIRECTION 5

// Three numbers: a point in local coordinates. Its default is in fractions of the bounding box.
#define SIMOD_PARAM_POINT 6

// Four numbers, 0 to 1: linear red, green, blue, and opacity.
#define SIMOD_PARAM_COLOUR 7

// Pairs of numbers x, y, 0 to 1, of ascending x: at least two points of a curve. Other plugins take it as a
// monotone cubic (Fritsch and Carlson 1980) with harmonic means for slopes, constant beyond its ends.
#define SIMOD_PARAM_CURVE 8

// The path of a file that can be read, as text; empty where the user gave none.
#define SIMOD_PARAM_FILE 9

// The path of another model, as text, for messages; empty where the user gave none. The host reads it and
// hands over its points: see SIMOD_INPUT_OTHER_MODELS. Its default number is how many points the plugin
// takes at most, 1 to 4194304; set `invalidates_preparation`.
#define SIMOD_PARAM_MODEL 10

// Nothing.
#define SIMOD_UNIT_NONE 0

// Degrees of an angle.
#define SIMOD_UNIT_DEGREES 1

// A length: the model's unit for the user, local units for the plugin.
#define SIMOD_UNIT_MODEL_LENGTH 2

// A fraction of the diagonal of the bounding box, for both. The better one for defaults.
#define SIMOD_UNIT_DIAGONAL 3

// A ratio: 1 leaves things as they are.
#define SIMOD_UNIT_RATIO 4

// Samples of such a region stay where they are.
#define SIMOD_ROLE_FIXED 1

// Samples of such a region follow its transform.
#define SIMOD_ROLE_HANDLE 2

// A message for the plugin's author.
#define SIMOD_LOG_DEBUG 1

// A message for a curious user.
#define SIMOD_LOG_INFO 2

// The result may not be what the user wants.
#define SIMOD_LOG_WARNING 3

// A handle that can be shifted.
#define SIMOD_GIZMO_TRANSLATE 1

// A handle that can be turned about its position.
#define SIMOD_GIZMO_ROTATE 2

// A handle that can be scaled about its position.
#define SIMOD_GIZMO_SCALE 4

// The best result.
#define SIMOD_EFFORT_FULL 1

// Soon, while a handle is dragged.
#define SIMOD_EFFORT_DRAFT 2

// Positions of the samples as the step is given them: `SimodSamples.positions`.
#define SIMOD_POSE_CURRENT 1

// Positions of the samples before all steps, for plugins that use SIMOD_INPUT_REST_POSITIONS.
#define SIMOD_POSE_REST 2

// An attribute of whole numbers from -128 to 127.
#define SIMOD_ATTRIBUTE_I8 1

// An attribute of whole numbers from 0 to 255, as colours often are.
#define SIMOD_ATTRIBUTE_U8 2

// An attribute of whole numbers of 16 bits with a sign.
#define SIMOD_ATTRIBUTE_I16 3

// An attribute of whole numbers from 0 to 65535.
#define SIMOD_ATTRIBUTE_U16 4

// An attribute of whole numbers of 32 bits with a sign.
#define SIMOD_ATTRIBUTE_I32 5

// An attribute of whole numbers of 32 bits, from 0 on.
#define SIMOD_ATTRIBUTE_U32 6

// An attribute of numbers in single precision.
#define SIMOD_ATTRIBUTE_F32 7

// An attribute of numbers in double precision.
#define SIMOD_ATTRIBUTE_F64 8

// The host has sampled the other model for this call.
#define SIMOD_POINTS_SAMPLED 1

// Samples that the user has: a sampled model, or a file of samples that anything has moved.
#define SIMOD_POINTS_SAMPLES 2

// The parent of a joint or a handle that hangs on no other.
#define SIMOD_ROOT UINT32_MAX

// One of the alternatives of a SIMOD_PARAM_CHOICE, or an extension of a SIMOD_PARAM_FILE's name.
typedef struct SimodChoiceDesc {
    // Stable id, kebab-case; stored in files. Of a file: the extension, without a dot.
    const char *id;
    // Name for the user; the id where it is NULL.
    const char *label;
} SimodChoiceDesc;

// A parameter: described by the plugin; shown, stored, checked and undone by the host.
typedef struct SimodParamDesc {
    // Stable id, kebab-case, unique among the plugin's parameters; stored in files.
    const char *id;
    // Name for the user; the id where it is NULL.
    const char *name;
    // One line on what it does. May be NULL.
    const char *hint;
    // Parameters of one group are shown together. May be NULL.
    const char *group;
    // Kind of value: SIMOD_PARAM_...
    uint32_t kind;
    // Unit of its numbers: SIMOD_UNIT_...
    uint32_t unit;
    // The host refuses values outside, smallest and largest: {0, 0} for no limit, else -INFINITY or INFINITY
    // for none on that side.
    double hard_range[2];
    // Range of a slider, in the same way; values outside are fine.
    double soft_range[2];
    // Default of the kinds of one to four numbers: as many as the kind has. Of SIMOD_PARAM_MODEL the most
    // points.
    double default_numbers[4];
    // Default of the kinds of any number of them, as x0, y0, x1, y1, ... of a curve. Else NULL.
    const double *default_list;
    // Number of numbers in `default_list`.
    size_t default_list_length;
    // Default of a choice: the id of one. Else NULL.
    const char *default_text;
    // The alternatives of a choice, or the extensions that a file's name may have (NULL for any).
    const struct SimodChoiceDesc *choices;
    // Number of choices.
    size_t choice_count;
    // 1 if the state must be prepared anew once the value changed: if `prepare` reads it.
    uint8_t invalidates_preparation;
} SimodParamDesc;

// An input that the plugin uses besides the positions: an id SIMOD_INPUT_...
typedef struct SimodInputDesc {
    // The id.
    const char *id;
    // Number of such inputs that the plugin needs: where there are fewer, it is not called. 0 for an input
    // that it uses if there is one.
    uint32_t at_least;
} SimodInputDesc;

// A plugin's description of itself: its names, its parameters and the inputs that it uses.
typedef struct SimodDescriptor {
    // Stable id, kebab-case; what sessions call the plugin.
    const char *id;
    // Name for the user.
    const char *name;
    // The plugin's own version: "major.minor.patch".
    const char *version;
    // One line on what it does.
    const char *summary;
    // The publication that it implements. May be NULL.
    const char *citation;
    // Author of the plugin, whom its users may ask. May be NULL.
    const char *author;
    // Address of a page on the plugin. May be NULL.
    const char *url;
    // The plugin's parameters, in the order to show them. Their values come in this order.
    const struct SimodParamDesc *params;
    // Number of parameters.
    size_t param_count;
    // The inputs that it uses.
    const struct SimodInputDesc *inputs;
    // Number of inputs that the plugin uses.
    size_t input_count;
} SimodDescriptor;

// The samples at rest. Arrays of `count` entries; `count` is at least 1, but where the host asks whether
// there is anything to do.
typedef struct SimodSamples {
    // Number of samples.
    size_t count;
    // Rest positions, local coordinates, all finite.
    const float (*positions)[3];
    // Unit normals, or NULL. They fit the positions if the plugin uses SIMOD_INPUT_NORMALS; else they may be
    // stale.
    const float (*normals)[3];
    // Distance to the nearest other samples, local coordinates, or NULL.
    const float *spacing;
} SimodSamples;

// An axis-aligned box, local coordinates.
typedef struct SimodBounds {
    // Smallest coordinates.
    double min[3];
    // Largest coordinates.
    double max[3];
} SimodBounds;

// A part of the samples, with a role.
typedef struct SimodRegion {
    // Role of its samples: SIMOD_ROLE_...
    uint32_t role;
    // One weight per sample, 0 (outside) to 1 (inside).
    const float *weights;
} SimodRegion;

// A parameter's value, checked by the host against its description.
typedef struct SimodParam {
    // Id of the parameter that has this value.
    const char *id;
    // Kind of value: SIMOD_PARAM_...
    uint32_t kind;
    // The parameter's numbers; NULL where it is a text.
    const double *numbers;
    // Number of numbers.
    size_t count;
    // The parameter's text; "" where it is numbers.
    const char *text;
} SimodParam;

// An input that is known by an id: see `simod_part`.
typedef struct SimodPart {
    // SIMOD_INPUT_...
    const char *id;
    // The struct of that id.
    const void *data;
} SimodPart;

// Input of a preparation: all that its state may depend on.
typedef struct SimodPrepareInput {
    // The samples at rest.
    struct SimodSamples samples;
    // The model's box in its rest pose, the same for all steps of a session. Samples may lie outside.
    struct SimodBounds bounds;
    // The regions of the roles that the plugin uses, in the user's order.
    const struct SimodRegion *regions;
    // Number of regions.
    size_t region_count;
    // The values of all parameters, in the order of the description.
    const struct SimodParam *params;
    // As many as there are descriptions.
    size_t param_count;
    // Inputs that are known by ids: triangles, graph, joints, the model's frame.
    const struct SimodPart *parts;
    // Number of these inputs.
    size_t part_count;
} SimodPrepareInput;

// The host, for the length of one call. Its functions may be called from any thread, and take this pointer.
typedef struct SimodHost {
    // The host's own.
    const void *context;
    // Tells that so much of the call is done, 0 to 1. Whether to go on: after false the plugin returns
    // SIMOD_CANCELLED. Costs some nanoseconds; call it at least every 100 ms.
    bool (*progress)(const struct SimodHost *host, double fraction);
    // A line for the user, of level SIMOD_LOG_... The host copies it, and keeps a hundred of a call.
    void (*log)(const struct SimodHost *host, uint32_t level, const char *message);
    // Says what is wrong, in one line without a full stop, and what to do about it (may be NULL). The host
    // copies both. Gives `code` back, so that a plugin can write: return host->error(host,
    // SIMOD_INVALID_INPUT, "...", "...");
    uint32_t (*error)(const struct SimodHost *host, uint32_t code, const char *message, const char *hint);
    // Calls body(context, i) once for each i below `count`, in any order, on several of the host's threads:
    // threads of the plugin's own would crowd the cores. Returns when all is done; may be called from within
    // a body. False if the user asked to stop: some were not called. A call costs about a microsecond, and
    // so should the body, or more: give it a block of samples, not a single one.
    bool (*parallel_for)(const struct SimodHost *host,
                         size_t count,
                         void (*body)(void *context, size_t i),
                         void *context);
    // A capability of the host by id: a SimodNearest for SIMOD_NEAREST and so on, constant. NULL where there
    // is none.
    const void *(*extension)(const struct SimodHost *host, const char *id);
} SimodHost;

// An affine map: x goes to M x + t, where the rows are those of `[M | t]`. Local coordinates.
typedef struct SimodAffine {
    // Three rows of four.
    double rows[3][4];
} SimodAffine;

// Input of one deformation: all that it depends on, besides the state.
typedef struct SimodDeformInput {
    // The samples at rest: those of the preparation.
    struct SimodSamples samples;
    // The bounding box of the model: that of the preparation.
    struct SimodBounds bounds;
    // One map for each region of role SIMOD_ROLE_HANDLE, in their order; all finite.
    const struct SimodAffine *transforms;
    // Number of maps.
    size_t transform_count;
    // The values of all parameters, in the order of the description.
    const struct SimodParam *params;
    // As many as there are descriptions.
    size_t param_count;
    // Inputs that are known by ids: motions of handles, strokes, the effort.
    const struct SimodPart *parts;
    // Number of these inputs.
    size_t part_count;
} SimodDeformInput;

// A plugin: the exported table. Members that are not said to be required may be NULL.
//
// States and scratches are pointers to whatever the plugin likes, and NULL where it needs none.
typedef struct SimodPlugin {
    // SIMOD_INTERFACE_MAJOR. Required.
    uint32_t interface_major;
    // SIMOD_INTERFACE_MINOR. Required.
    uint32_t interface_minor;
    // sizeof(SimodPlugin). Required.
    size_t size;
    // Description of the plugin: always the same, and valid for as long as the library is loaded. Called
    // when the library is loaded, on any thread, and perhaps again, one call at a time; takes microseconds.
    // Required.
    const struct SimodDescriptor *(*describe)(void);
    // All the work that depends neither on transforms nor on parameters that do not invalidate the
    // preparation: writes a state to *state, which is NULL before. On an error there is none. Called on a
    // worker thread, several at once. May take long: tells `progress`.
    uint32_t (*prepare)(const struct SimodPrepareInput *input, const struct SimodHost *host, void **state);
    // Frees a state that is not NULL, on any thread, once no call uses it.
    void (*drop_state)(void *state);
    // Working memory that `deform` may keep from one call to the next, and never a place for results. NULL
    // is an error: there is no memory.
    void *(*new_scratch)(void);
    // Frees a scratch that is not NULL, on any thread.
    void (*drop_scratch)(void *scratch);
    // Writes the deformed position of sample i to `out[i]`, local coordinates: all input->samples.count of
    // them, finite. `out` holds nothing of use before, and the host drops it on an error. Handles that do
    // not move must leave the samples exactly where they are. The same state and input always give the same
    // positions. Called by several threads at once on one state, each with a scratch of its own.
    // Interactive: takes milliseconds. Required.
    uint32_t (*deform)(const void *state,
                       const struct SimodDeformInput *input,
                       void *scratch,
                       float (*out)[3],
                       const struct SimodHost *host);
    // A capability by id: a SimodEvaluate for SIMOD_EVALUATE and so on, valid for as long as the library is
    // loaded; NULL for ids that the plugin does not know. Called when the library is loaded.
    const void *(*extension)(const char *id);
} SimodPlugin;

// SIMOD_EVALUATE: the deformation is a map of space, known anywhere.
typedef struct SimodEvaluate {
    // Replaces each of `count` points by its image, local coordinates: the same map as `deform`, up to its
    // rounding. Called by several threads at once, on blocks of any length; points may lie anywhere, and are
    // finite. Required.
    uint32_t (*evaluate)(const void *state,
                         const struct SimodDeformInput *input,
                         double (*points)[3],
                         size_t count,
                         const struct SimodHost *host);
} SimodEvaluate;

// A handle that a plugin places.
typedef struct SimodHandleDesc {
    // Stable id, unique among the plugin's handles, without white space; stored in files.
    const char *id;
    // Name for the user; the id where it is NULL.
    const char *name;
    // Position at rest, local coordinates.
    double position[3];
    // Motions that the handle takes: SIMOD_GIZMO_... added up. 0 for SIMOD_GIZMO_TRANSLATE.
    uint32_t gizmo;
    // The index of the handle that it hangs on, less than its own, or SIMOD_ROOT: its motion moves this one
    // along.
    uint32_t parent;
} SimodHandleDesc;

// List to which a plugin adds its handles.
typedef struct SimodHandleList {
    // The host's own.
    void *context;
    // Adds a handle, not by several threads at once. The host copies it.
    void (*add)(struct SimodHandleList *list, const struct SimodHandleDesc *handle);
} SimodHandleList;

// SIMOD_HANDLES: the plugin has handles of its own, which users move one by one.
typedef struct SimodHandles {
    // Adds the handles for these samples, this box, these parameters and joints; the input has no regions.
    // How they were moved comes with SIMOD_INPUT_HANDLE_MOTIONS. Called before `prepare`, on any thread, and
    // whenever the user looks at the handles: takes milliseconds at most. Required.
    uint32_t (*handles)(const struct SimodPrepareInput *input,
                        struct SimodHandleList *list,
                        const struct SimodHost *host);
} SimodHandles;

// List to which a plugin adds the faces between its handles.
typedef struct SimodFaceList {
    // The host's own.
    void *context;
    // Adds a face of `count` corners, three at least: indices of handles, around it. Not by several threads
    // at once. The host copies them.
    void (*add)(struct SimodFaceList *list, const uint32_t *corners, size_t count);
} SimodFaceList;

// SIMOD_HANDLE_FACES: the handles are the corners of a surface, as those of a cage.
typedef struct SimodHandleFaces {
    // Adds the faces between the handles that SIMOD_HANDLES gives for the same input; the host draws them
    // with their edges. Called as `handles` is, after it. Required.
    uint32_t (*handle_faces)(const struct SimodPrepareInput *input,
                             struct SimodFaceList *list,
                             const struct SimodHost *host);
} SimodHandleFaces;

// SIMOD_IS_IDENTITY: the plugin knows when it does nothing.
typedef struct SimodIsIdentity {
    // 1 if `deform` would leave all samples where they are, whatever they are: the host then calls neither
    // `prepare` nor `deform`. 0 is always right. The input has no samples; takes microseconds. Required.
    uint8_t (*is_identity)(const struct SimodDeformInput *input);
} SimodIsIdentity;

// A parameter's former name.
typedef struct SimodAlias {
    // The id that older sessions give; no parameter has it now.
    const char *former;
    // The id that the parameter has now.
    const char *now;
} SimodAlias;

// List to which a plugin adds the settings that a session has to give now.
typedef struct SimodSettingList {
    // The host's own.
    void *context;
    // Gives a parameter. The host copies it. Its kind is what it looks like: SIMOD_PARAM_FLOAT or _INT for a
    // number, _BOOL, _CHOICE for any text, _DIRECTION for three numbers, _COLOUR for four, _CURVE for pairs.
    void (*set)(struct SimodSettingList *list, const struct SimodParam *setting);
} SimodSettingList;

// SIMOD_MIGRATION: sessions that are older than the plugin keep working.
typedef struct SimodMigration {
    // Counts up, from 1, whenever the meaning of a parameter changes; saved sessions write it down. One that
    // says no version is of the first. Required.
    uint32_t state_version;
    // Former names of parameters.
    const struct SimodAlias *aliases;
    // Number of aliases.
    size_t alias_count;
    // Gives `to` what a session of version `from`, which is less than that of now, has to give now, of what
    // it gave: in model coordinates and the user's units, checked by nobody, under the ids of now (aliases
    // have been applied). What is not given to `to` has its default. Takes microseconds; any thread. The
    // host has no samples in this call. NULL where all stays as it is.
    uint32_t (*migrate)(uint32_t from,
                        const struct SimodParam *settings,
                        size_t count,
                        struct SimodSettingList *to,
                        const struct SimodHost *host);
} SimodMigration;

// SIMOD_NEAREST, of the host: the nearest of the samples of the call that it was asked for in. From any
// thread; the first time it builds a tree, which is kept with the state.
typedef struct SimodNearest {
    // Number of samples within `radius` (INFINITY for all of them); the nearest of them are written to
    // `found`, nearest first, as many as `capacity`. Those at the same distance are in the order of their
    // indices. 0 where there are no samples in this pose, SIMOD_POSE_...
    size_t (*find)(const struct SimodHost *host,
                   uint32_t pose,
                   const double *point,
                   double radius,
                   uint32_t *found,
                   size_t capacity);
} SimodNearest;

// A point of the triangles between the samples.
typedef struct SimodSurfacePoint {
    // Index of the triangle.
    uint32_t triangle;
    // Weights of its corners, at least 0, which add up to 1.
    double weights[3];
    // Position of the point, local coordinates.
    double position[3];
    // Distance from the point that was asked for, or along the ray: a length in local coordinates.
    double distance;
} SimodSurfacePoint;

// SIMOD_SURFACE, of the host: the triangles between the samples, for plugins that use SIMOD_INPUT_TRIANGLES.
// From any thread; the first time it builds a tree.
typedef struct SimodSurface {
    // Whether there are triangles in this pose, SIMOD_POSE_...
    bool (*has)(const struct SimodHost *host, uint32_t pose);
    // Finds the point of the surface that is nearest to a point, if it is not farther away than `radius`;
    // returns whether there is one.
    bool (*closest)(const struct SimodHost *host,
                    uint32_t pose,
                    const double *point,
                    double radius,
                    struct SimodSurfacePoint *found);
    // Finds the point in which a ray first meets the surface, from either side, not farther away than
    // `reach`; returns whether there is one. The direction may be of any length but zero.
    bool (*ray)(const struct SimodHost *host,
                uint32_t pose,
                const double *origin,
                const double *direction,
                double reach,
                struct SimodSurfacePoint *found);
} SimodSurface;

// SIMOD_INPUT_TRIANGLES, of the preparation: triangles between the samples.
typedef struct SimodTriangles {
    // Three samples each, counter-clockwise as seen from outside. Several may share an edge or have no area,
    // and a sample may be in none.
    const uint32_t (*indices)[3];
    // Number of triangles, at least one.
    size_t count;
} SimodTriangles;

// SIMOD_INPUT_GRAPH, of the preparation: the nearest neighbours of each sample at rest.
typedef struct SimodGraph {
    // The neighbours of sample i are those from `starts[i]` up to, and without, `starts[i + 1]`: one entry
    // more than samples.
    const uint32_t *starts;
    // Nearest first, without the sample itself. One that is among another's need not have that other among
    // its own.
    const uint32_t *neighbours;
} SimodGraph;

// A joint of a skeleton that the user placed.
typedef struct SimodJoint {
    // Stable id, unique among the joints.
    const char *id;
    // Position at rest, local coordinates.
    double position[3];
    // The index of the joint that it hangs on, less than its own, or SIMOD_ROOT.
    uint32_t parent;
} SimodJoint;

// SIMOD_INPUT_JOINTS, of the preparation and where handles are placed.
typedef struct SimodJoints {
    // Parents come before those that hang on them.
    const struct SimodJoint *joints;
    // Number of joints.
    size_t count;
} SimodJoints;

// SIMOD_INPUT_MODEL_FRAME, of the preparation and where handles are placed: for files in model coordinates.
// A point of the model lies at (point - origin) / scale in local coordinates.
typedef struct SimodModelFrame {
    // The local origin, in model coordinates.
    double origin[3];
    // Length of a local unit, in the model's unit; above 0.
    double scale;
} SimodModelFrame;

// SIMOD_INPUT_EFFORT, of the deformation: the time that it may take.
typedef struct SimodEffort {
    // SIMOD_EFFORT_...: a draft, while a handle is dragged, may differ a little from the full result.
    uint32_t effort;
} SimodEffort;

// SIMOD_INPUT_TIME, of the deformation: its time in a sequence.
typedef struct SimodTime {
    // Number of the frame in the sequence: 0 for the first one, and where there is no sequence.
    int64_t frame;
    // Seconds since the beginning of the sequence; finite.
    double seconds;
} SimodTime;

// SIMOD_INPUT_REST_POSITIONS, of the preparation: the samples' positions before all steps.
typedef struct SimodRestPositions {
    // One for each sample, local coordinates, all finite.
    const float (*positions)[3];
} SimodRestPositions;

// A property of the model's vertices that is neither position nor normal, as a colour's red or a confidence.
typedef struct SimodAttribute {
    // Name of the attribute in the model's file, as "red"; no two attributes have one name.
    const char *name;
    // Type of its numbers in the file: SIMOD_ATTRIBUTE_...
    uint32_t kind;
    // One for each sample, in the property's own unit (a colour of SIMOD_ATTRIBUTE_U8 goes from 0 to 255),
    // all finite: the mean over the vertices that the sample stands for.
    const float *values;
} SimodAttribute;

// SIMOD_INPUT_ATTRIBUTES, of the preparation, of the deformation, and where handles are placed: colours and
// other attributes of the samples, as far as the model has them. See `simod_attribute`.
typedef struct SimodAttributes {
    // In the file's order.
    const struct SimodAttribute *attributes;
    // Number of attributes that the model has; may be 0.
    size_t count;
} SimodAttributes;

// Another model than the one that is deformed: points of it, in the local coordinates of the one that is.
typedef struct SimodOtherModel {
    // The id of the parameter, of SIMOD_PARAM_MODEL, that names it.
    const char *param;
    // Origin of the points: SIMOD_POINTS_... Those of SIMOD_POINTS_SAMPLED are at most as many as the
    // plugin takes; those of SIMOD_POINTS_SAMPLES are all that there are.
    uint32_t kind;
    // Number of vertices of the model; of samples the number of samples.
    uint64_t vertices;
    // Number of points, at least one.
    size_t count;
    // Local coordinates, all finite. They may be far away, where the other model has another origin or unit.
    const double (*positions)[3];
    // Unit normals, one for each point: those of the file, or else of the triangles or the neighbours.
    const float (*normals)[3];
    // Sample that each point is, no two the same: of a sampled model its index, in a file of samples its
    // property "id". NULL for SIMOD_POINTS_SAMPLED.
    const uint64_t *ids;
    // Triangles between the points, counter-clockwise as seen from outside; NULL for a cloud.
    const uint32_t (*triangles)[3];
    // Number of triangles.
    size_t triangle_count;
} SimodOtherModel;

// SIMOD_INPUT_OTHER_MODELS, of the preparation: the other models that the user gave. See
// `simod_other_model`.
typedef struct SimodOtherModels {
    // In the order of the parameters.
    const struct SimodOtherModel *models;
    // Number of other models that the user gave.
    size_t count;
} SimodOtherModels;

// SIMOD_INPUT_HANDLE_MOTIONS, of the deformation: the motions of the plugin's own handles.
typedef struct SimodHandleMotions {
    // One map of space for each handle that the plugin placed, in its order: from the rest pose to the
    // user's. That of what a handle hangs on is included; the identity where neither was moved.
    const struct SimodAffine *motions;
    // Number of handles.
    size_t count;
} SimodHandleMotions;

// A brush stroke.
typedef struct SimodStroke {
    // A hash: the same for strokes that are the same in every respect, and nearly surely another for others.
    uint64_t key;
    // Radius of the brush, local coordinates; above 0.
    double radius;
    // 1 is full strength; negative ones do the opposite, as far as the brush has one.
    double strength;
    // The stroke's path on or near the surface, local coordinates: a polyline of at least one point.
    const double (*points)[3];
    // Number of points: it depends on the user's machine, and must not matter.
    size_t point_count;
    // The pen's pressure at each point, 0 to 1; NULL where there is no pen.
    const float *pressures;
    // The values of all parameters for this stroke, in the order of the description.
    const struct SimodParam *params;
    // As many as there are descriptions.
    size_t param_count;
} SimodStroke;

// SIMOD_INPUT_STROKES, of the deformation.
typedef struct SimodStrokes {
    // First to last.
    const struct SimodStroke *strokes;
    // Number of strokes.
    size_t count;
} SimodStrokes;

#if defined(_WIN32)
#define SIMOD_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define SIMOD_EXPORT __attribute__((visibility("default")))
#else
#define SIMOD_EXPORT
#endif

#ifdef __cplusplus
extern "C" {
#endif

// The plugin, once in a library: const SimodPlugin simod_plugin_entry = { ... };
extern SIMOD_EXPORT const SimodPlugin simod_plugin_entry;

#ifdef __cplusplus
}
#endif

// The input of an id, as `const SimodGraph *graph = simod_part(input->parts, input->part_count,
// SIMOD_INPUT_GRAPH);`: NULL where the host has none, or the description does not name it.
static inline const void *simod_part(const SimodPart *parts, size_t count, const char *id)
{
    for (size_t i = 0; i < count; i++)
        if (strcmp(parts[i].id, id) == 0)
            return parts[i].data;
    return NULL;
}

// The values of the attribute of a name, one for each sample: NULL where the model has none of this name, or
// there is no input SIMOD_INPUT_ATTRIBUTES.
static inline const float *simod_attribute(const SimodPart *parts, size_t count, const char *name)
{
    const SimodAttributes *all = (const SimodAttributes *)simod_part(parts, count, SIMOD_INPUT_ATTRIBUTES);
    for (size_t i = 0; all && i < all->count; i++)
        if (strcmp(all->attributes[i].name, name) == 0)
            return all->attributes[i].values;
    return NULL;
}

// The other model that a parameter of SIMOD_PARAM_MODEL names: NULL where the user gave none.
static inline const SimodOtherModel *simod_other_model(const SimodPart *parts, size_t count, const char *param)
{
    const SimodOtherModels *all = (const SimodOtherModels *)simod_part(parts, count, SIMOD_INPUT_OTHER_MODELS);
    for (size_t i = 0; all && i < all->count; i++)
        if (strcmp(all->models[i].param, param) == 0)
            return &all->models[i];
    return NULL;
}
