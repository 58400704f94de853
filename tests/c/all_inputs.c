// Looks at all that a plugin may get, and refuses what the header does not promise. Its handles are the
// user's joints; samples shift with them, with regions and with strokes.
#include "simod_plugin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EXPECT(condition) \
    do { \
        if (!(condition)) return host->error(host, SIMOD_INTERNAL, "not as promised: " #condition, NULL); \
    } while (0)

enum { AMOUNT, COUNT, FLIP, CHOICE, ALONG, AT, TINT, PROFILE, TABLE, PARAM_COUNT };

static const SimodChoiceDesc choices[] = { { "near", "Near" }, { "far", NULL } };
static const SimodChoiceDesc extensions[] = { { "csv", NULL } };
static const double profile[] = { 0, 1, 0.5, 0.25, 1, 0 };

static const SimodParamDesc params[] = {
    [AMOUNT] = { .id = "amount", .name = "Amount", .hint = "How much", .group = "Numbers", .kind = SIMOD_PARAM_FLOAT,
                 .unit = SIMOD_UNIT_MODEL_LENGTH, .hard_range = { -INFINITY, 5 }, .soft_range = { -1, 1 },
                 .default_numbers = { 0.5 } },
    [COUNT] = { .id = "count", .hint = "How many", .group = "Numbers", .kind = SIMOD_PARAM_INT,
                .hard_range = { 1, 9 }, .default_numbers = { 3 }, .invalidates_preparation = 1 },
    [FLIP] = { .id = "flip", .hint = "The other way", .kind = SIMOD_PARAM_BOOL, .default_numbers = { 1 } },
    [CHOICE] = { .id = "where", .hint = "Where", .kind = SIMOD_PARAM_CHOICE, .choices = choices, .choice_count = 2,
                 .default_text = "far" },
    [ALONG] = { .id = "along", .hint = "Which way", .kind = SIMOD_PARAM_DIRECTION, .default_numbers = { 0, 1, 0 } },
    [AT] = { .id = "at", .hint = "Where from", .kind = SIMOD_PARAM_POINT, .default_numbers = { 0.5, 0.5, 0.5 } },
    [TINT] = { .id = "tint", .hint = "What colour", .kind = SIMOD_PARAM_COLOUR, .default_numbers = { 1, 0.5, 0, 1 } },
    [PROFILE] = { .id = "profile", .hint = "What shape", .kind = SIMOD_PARAM_CURVE, .default_list = profile,
                  .default_list_length = 6 },
    [TABLE] = { .id = "table", .hint = "What else", .kind = SIMOD_PARAM_FILE, .choices = extensions, .choice_count = 1,
                .invalidates_preparation = 1 },
};

static const SimodInputDesc inputs[] = {
    { SIMOD_INPUT_FIXED_REGIONS, 0 }, { SIMOD_INPUT_HANDLE_REGIONS, 2 }, { SIMOD_INPUT_NORMALS, 1 },
    { SIMOD_INPUT_TRIANGLES, 0 },     { SIMOD_INPUT_GRAPH, 0 },          { SIMOD_INPUT_JOINTS, 0 },
    { SIMOD_INPUT_STROKES, 0 },       { "org.example.taste/1", 0 },
};

static const SimodDescriptor descriptor = {
    .id = "all-inputs", .name = "All inputs", .version = "1.2.3", .summary = "Looks at all that there is",
    .citation = "Nobody, Nothing, 2007", .author = "Somebody", .url = "https://example.org",
    .params = params, .param_count = PARAM_COUNT, .inputs = inputs, .input_count = sizeof inputs / sizeof *inputs,
};

static const SimodDescriptor *describe(void) { return &descriptor; }

static uint32_t check_params(const SimodParam *p, size_t count, const SimodHost *host)
{
    static const size_t numbers[] = { 1, 1, 1, 0, 3, 3, 4 };
    EXPECT(count == PARAM_COUNT);
    for (size_t i = 0; i < count; i++) {
        EXPECT(strcmp(p[i].id, params[i].id) == 0 && p[i].kind == params[i].kind && p[i].text);
        EXPECT(i > TINT || p[i].count == numbers[i]);
        for (size_t n = 0; n < p[i].count; n++) EXPECT(isfinite(p[i].numbers[n]));
    }
    EXPECT(p[COUNT].numbers[0] >= 1 && p[COUNT].numbers[0] <= 9);
    EXPECT(strcmp(p[CHOICE].text, "near") == 0 || strcmp(p[CHOICE].text, "far") == 0);
    EXPECT(p[PROFILE].count >= 4 && p[PROFILE].count % 2 == 0);
    EXPECT(p[TABLE].count == 0 && p[TABLE].numbers == NULL);
    return SIMOD_OK;
}

static uint32_t check_samples(const SimodSamples *s, const SimodHost *host)
{
    EXPECT(s->count > 0 && s->positions && s->normals && s->spacing);
    for (size_t i = 0; i < s->count; i++) {
        for (int k = 0; k < 3; k++) EXPECT(isfinite(s->positions[i][k]) && isfinite(s->normals[i][k]));
        EXPECT(s->spacing[i] >= 0);
    }
    return SIMOD_OK;
}

// What there was at the preparation.
typedef struct { size_t samples, handles; } State;

static uint32_t check_parts(const SimodPrepareInput *input, const SimodHost *host)
{
    size_t count = input->samples.count;
    const SimodTriangles *triangles = simod_part(input->parts, input->part_count, SIMOD_INPUT_TRIANGLES);
    const SimodGraph *graph = simod_part(input->parts, input->part_count, SIMOD_INPUT_GRAPH);
    const SimodJoints *joints = simod_part(input->parts, input->part_count, SIMOD_INPUT_JOINTS);
    EXPECT(graph && joints && simod_part(input->parts, input->part_count, "org.example.taste/1") == NULL);
    EXPECT(count < 3 || triangles);
    for (size_t t = 0; triangles && t < triangles->count; t++)
        for (int k = 0; k < 3; k++) EXPECT(triangles->indices[t][k] < count);
    EXPECT(graph->starts[0] == 0);
    for (size_t i = 0; i < count; i++) {
        EXPECT(graph->starts[i] <= graph->starts[i + 1]);
        for (uint32_t n = graph->starts[i]; n < graph->starts[i + 1]; n++) EXPECT(graph->neighbours[n] < count);
    }
    for (size_t j = 0; j < joints->count; j++)
        EXPECT(joints->joints[j].id[0] && (joints->joints[j].parent == SIMOD_ROOT || joints->joints[j].parent < j));
    return SIMOD_OK;
}

static uint32_t prepare(const SimodPrepareInput *input, const SimodHost *host, void **to)
{
    uint32_t status = check_samples(&input->samples, host);
    if (!status) status = check_params(input->params, input->param_count, host);
    if (!status) status = check_parts(input, host);
    if (status) return status;
    if (!host->progress(host, 0.5)) return SIMOD_CANCELLED;
    EXPECT(*to == NULL && input->region_count >= 2);
    State *state = calloc(1, sizeof *state);
    if (!state) return SIMOD_INTERNAL;
    state->samples = input->samples.count;
    for (size_t r = 0; r < input->region_count; r++) {
        const SimodRegion *region = &input->regions[r];
        for (size_t i = 0; i < input->samples.count; i++)
            if (!(region->weights[i] >= 0 && region->weights[i] <= 1))
                return host->error(host, SIMOD_INTERNAL, "a weight is out of range", NULL);
        state->handles += region->role == SIMOD_ROLE_HANDLE;
    }
    *to = state;
    return SIMOD_OK;
}

static void *new_scratch(void) { return malloc(sizeof(double)); }

// How far a motion carries the middle of the box.
static void add_shift(const SimodAffine *motion, const SimodBounds *bounds, double shift[3])
{
    for (int k = 0; k < 3; k++) {
        double at[3], image = motion->rows[k][3];
        for (int j = 0; j < 3; j++) {
            at[j] = (bounds->min[j] + bounds->max[j]) / 2;
            image += motion->rows[k][j] * at[j];
        }
        shift[k] += image - at[k];
    }
}

typedef struct {
    const SimodDeformInput *input;
    const double *shift;
    float (*out)[3];
} Work;

enum { BLOCK = 1000 };

static void move_block(void *context, size_t block)
{
    const Work *work = context;
    const SimodSamples *samples = &work->input->samples;
    for (size_t i = block * BLOCK; i < (block + 1) * BLOCK && i < samples->count; i++)
        for (int k = 0; k < 3; k++) work->out[i][k] = (float)(samples->positions[i][k] + work->shift[k]);
}

static uint32_t deform(const void *from, const SimodDeformInput *input, void *scratch, float (*out)[3],
                       const SimodHost *host)
{
    const State *state = from;
    uint32_t status = check_params(input->params, input->param_count, host);
    if (status) return status;
    const SimodHandleMotions *motions =
        simod_part(input->parts, input->part_count, SIMOD_INPUT_HANDLE_MOTIONS);
    const SimodStrokes *strokes = simod_part(input->parts, input->part_count, SIMOD_INPUT_STROKES);
    EXPECT(scratch && state->samples == input->samples.count && state->handles == input->transform_count && motions);
    double shift[3] = { 0, 0, 0 };
    for (size_t h = 0; h < input->transform_count; h++) add_shift(&input->transforms[h], &input->bounds, shift);
    for (size_t h = 0; h < motions->count; h++) add_shift(&motions->motions[h], &input->bounds, shift);
    for (size_t s = 0; strokes && s < strokes->count; s++) {
        const SimodStroke *stroke = &strokes->strokes[s];
        EXPECT(stroke->radius > 0 && stroke->point_count > 0 && isfinite(stroke->points[stroke->point_count - 1][2]));
        EXPECT(stroke->pressures == NULL && stroke->key == s);
        status = check_params(stroke->params, stroke->param_count, host);
        if (status) return status;
        shift[0] += 0.01 * stroke->strength;
    }
    host->log(host, SIMOD_LOG_DEBUG, "all is as promised");
    Work work = { input, shift, out };
    bool done = host->parallel_for(host, (input->samples.count + BLOCK - 1) / BLOCK, move_block, &work);
    return done ? SIMOD_OK : SIMOD_CANCELLED;
}

static uint32_t place(const SimodPrepareInput *input, SimodHandleList *list, const SimodHost *host)
{
    const SimodJoints *joints = simod_part(input->parts, input->part_count, SIMOD_INPUT_JOINTS);
    EXPECT(joints && input->regions == NULL && input->region_count == 0);
    for (size_t j = 0; j < joints->count; j++) {
        const SimodJoint *joint = &joints->joints[j];
        SimodHandleDesc handle = { joint->id, "A joint", { 0, 0, 0 }, SIMOD_GIZMO_ROTATE, joint->parent };
        memcpy(handle.position, joint->position, sizeof handle.position);
        list->add(list, &handle);
    }
    return SIMOD_OK;
}

// The first three joints, if there are so many, are the corners of a face, WRONG_FACE of one more that there is not.
static uint32_t connect(const SimodPrepareInput *input, SimodFaceList *list, const SimodHost *host)
{
    const SimodJoints *joints = simod_part(input->parts, input->part_count, SIMOD_INPUT_JOINTS);
    EXPECT(joints && input->regions == NULL);
#ifdef WRONG_FACE
    const uint32_t corners[4] = { 0, 1, 2, (uint32_t)joints->count };
    list->add(list, WRONG_FACE ? corners : NULL, 4);
#else
    const uint32_t corners[3] = { 0, 1, 2 };
    if (joints->count >= 3) list->add(list, corners, 3);
#endif
    return SIMOD_OK;
}

static uint8_t does_nothing(const SimodDeformInput *input)
{
    double shift[3] = { 0, 0, 0 };
    const SimodHandleMotions *motions =
        simod_part(input->parts, input->part_count, SIMOD_INPUT_HANDLE_MOTIONS);
    for (size_t h = 0; h < input->transform_count; h++) add_shift(&input->transforms[h], &input->bounds, shift);
    for (size_t h = 0; motions && h < motions->count; h++) add_shift(&motions->motions[h], &input->bounds, shift);
    bool painted = simod_part(input->parts, input->part_count, SIMOD_INPUT_STROKES) != NULL;
    return !painted && shift[0] == 0 && shift[1] == 0 && shift[2] == 0;
}

static const void *extension(const char *id)
{
    static const SimodHandles handles = { place };
    static const SimodIsIdentity identity = { does_nothing };
    static const SimodHandleFaces faces = { connect };
    if (strcmp(id, SIMOD_HANDLES) == 0) return &handles;
    if (strcmp(id, SIMOD_HANDLE_FACES) == 0) return &faces;
    return strcmp(id, SIMOD_IS_IDENTITY) == 0 ? &identity : NULL;
}

const SimodPlugin simod_plugin_entry = {
    .interface_major = SIMOD_INTERFACE_MAJOR, .interface_minor = SIMOD_INTERFACE_MINOR + 7, .size = sizeof(SimodPlugin) + 8,
    .describe = describe, .prepare = prepare, .drop_state = free, .new_scratch = new_scratch, .drop_scratch = free,
    .deform = deform, .extension = extension,
};
