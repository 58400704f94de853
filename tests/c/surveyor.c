// The plugin of tests/plugins/surveyor, in C.
#include "simod_plugin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MODE, REACH, OTHER, PARAM_COUNT };

// Samples that are looked up at once: more than there are in any test.
enum { ROOM = 1000000 };

static const SimodChoiceDesc modes[] = {
    { "nearest", NULL }, { "within", NULL }, { "rest", NULL }, { "closest", NULL }, { "ray", NULL }, { "time", NULL },
    { "paint", NULL },   { "other", NULL },
};

static const SimodParamDesc params[PARAM_COUNT] = {
    [MODE] = { .id = "mode", .name = "Mode", .hint = "What is looked up", .kind = SIMOD_PARAM_CHOICE, .choices = modes,
               .choice_count = 8, .default_text = "nearest" },
    [REACH] = { .id = "reach", .name = "Reach", .hint = "How far it looks, as a part of the diagonal",
                .kind = SIMOD_PARAM_FLOAT, .hard_range = { 0, 1 }, .default_numbers = { 0.1 } },
    [OTHER] = { .id = "other", .name = "Other", .hint = "Where samples go that have another model",
                .kind = SIMOD_PARAM_MODEL, .default_numbers = { 300 }, .invalidates_preparation = 1 },
};

static const SimodInputDesc inputs[] = {
    { SIMOD_INPUT_TRIANGLES, 0 }, { SIMOD_INPUT_REST_POSITIONS, 0 }, { SIMOD_INPUT_TIME, 0 },
    { SIMOD_INPUT_ATTRIBUTES, 0 },
};

static const SimodDescriptor descriptor = {
    .id = "surveyor-in-c", .name = "Surveyor", .version = "3.0.0", .author = "a third party",
    .summary = "Moves samples to where the host says that something is", .params = params, .param_count = PARAM_COUNT,
    .inputs = inputs, .input_count = 4,
};

static const SimodDescriptor *describe(void) { return &descriptor; }

// What the other model has.
typedef struct {
    size_t count;
    double (*positions)[3];
    float (*normals)[3];
    uint64_t *ids;
} Other;

static void drop_state(void *state)
{
    Other *other = state;
    free(other->positions);
    free(other->normals);
    free(other->ids);
    free(other);
}

static void *copied(const void *from, size_t bytes)
{
    void *to = from && bytes ? malloc(bytes) : NULL;
    return to ? memcpy(to, from, bytes) : NULL;
}

static uint32_t prepare(const SimodPrepareInput *input, const SimodHost *host, void **to)
{
    Other *other = calloc(1, sizeof *other);
    if (!other) return host->error(host, SIMOD_INTERNAL, "there is no memory left", NULL);
    *to = other;
    const SimodOtherModel *from = simod_other_model(input->parts, input->part_count, "other");
    if (!from) return SIMOD_OK;
    int fits = from->count > 0 && from->positions && from->normals && input->params[OTHER].text[0] &&
               (from->kind == SIMOD_POINTS_SAMPLES) == (from->ids != NULL);
    for (size_t t = 0; t < from->triangle_count; t++)
        for (int k = 0; k < 3; k++) fits = fits && from->triangles[t][k] < from->count;
    if (!fits) return host->error(host, SIMOD_INTERNAL, "the other model is not as promised", NULL);
    other->count = from->count;
    other->positions = copied(from->positions, from->count * sizeof *from->positions);
    other->normals = copied(from->normals, from->count * sizeof *from->normals);
    other->ids = copied(from->ids, from->count * sizeof *from->ids);
    return SIMOD_OK;
}

// To the point of the other model that has the sample's id, or else the nearest one; and along its normal.
static void to_other(const Other *other, size_t i, const double p[3], double reach, float *out)
{
    size_t best = 0;
    double least = INFINITY;
    for (size_t j = 0; j < other->count; j++) {
        double squared = 0;
        for (int k = 0; k < 3; k++) squared += (p[k] - other->positions[j][k]) * (p[k] - other->positions[j][k]);
        if (other->ids && other->ids[j] == i) squared = -1;
        if (squared < least) least = squared, best = j;
    }
    for (int k = 0; k < 3; k++) out[k] = (float)(other->positions[best][k] + reach * (double)other->normals[best][k]);
}

// Each thread has its own.
static void *new_scratch(void) { return malloc(ROOM * sizeof(uint32_t)); }

static void mean(const SimodSamples *samples, const uint32_t *found, size_t count, float *out)
{
    double sum[3] = { 0, 0, 0 };
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) sum[k] += samples->positions[found[i]][k];
    for (int k = 0; k < 3; k++) out[k] = (float)(sum[k] / (double)count);
}

static uint32_t deform(const void *state, const SimodDeformInput *input, void *scratch, float (*out)[3],
                       const SimodHost *host)
{
    const Other *other = state;
    uint32_t *found = scratch;
    const char *mode = input->params[MODE].text;
    double diagonal = 0;
    for (int k = 0; k < 3; k++) diagonal += pow(input->bounds.max[k] - input->bounds.min[k], 2);
    double reach = input->params[REACH].numbers[0] * sqrt(diagonal);
    const SimodNearest *nearest = host->extension(host, SIMOD_NEAREST);
    const SimodSurface *surface = host->extension(host, SIMOD_SURFACE);
    const SimodTime *time = simod_part(input->parts, input->part_count, SIMOD_INPUT_TIME);
    if (!nearest || !surface || !time) return host->error(host, SIMOD_UNSUPPORTED, "the host is too old", NULL);
    int looks = strcmp(mode, "closest") == 0 || strcmp(mode, "ray") == 0;
    if (looks && !surface->has(host, SIMOD_POSE_CURRENT))
        return host->error(host, SIMOD_UNSUPPORTED, "there are no triangles between the samples", "sample some");
    const SimodAttributes *all = simod_part(input->parts, input->part_count, SIMOD_INPUT_ATTRIBUTES);
    const float *red = simod_attribute(input->parts, input->part_count, "red");
    const float *quality = simod_attribute(input->parts, input->part_count, "quality");
    if (strcmp(mode, "paint") == 0 && !red) host->log(host, SIMOD_LOG_WARNING, "there is no red");
    for (size_t i = 0; i < input->samples.count; i++) {
        const float *from = input->samples.positions[i];
        double p[3] = { from[0], from[1], from[2] };
        SimodSurfacePoint at;
        memcpy(out[i], from, sizeof out[i]);
        if (strcmp(mode, "nearest") == 0) {
            nearest->find(host, SIMOD_POSE_CURRENT, p, INFINITY, found, 5);
            mean(&input->samples, found, 5, out[i]);
        } else if (strcmp(mode, "within") == 0) {
            size_t count = nearest->find(host, SIMOD_POSE_CURRENT, p, reach, found, ROOM);
            mean(&input->samples, found, count, out[i]);
        } else if (strcmp(mode, "rest") == 0) {
            nearest->find(host, SIMOD_POSE_REST, p, INFINITY, found, 1);
            memcpy(out[i], input->samples.positions[found[0]], sizeof out[i]);
        } else if (strcmp(mode, "closest") == 0) {
            p[0] += reach;
            if (surface->closest(host, SIMOD_POSE_CURRENT, p, INFINITY, &at))
                for (int k = 0; k < 3; k++) out[i][k] = (float)at.position[k];
        } else if (strcmp(mode, "ray") == 0) {
            const double down[3] = { 0, 0, -2 };
            p[2] = 10;
            if (surface->ray(host, SIMOD_POSE_CURRENT, p, down, INFINITY, &at))
                for (int k = 0; k < 3; k++) out[i][k] = (float)at.position[k];
        } else if (strcmp(mode, "other") == 0) {
            if (other->count) to_other(other, i, p, reach, out[i]);
        } else if (strcmp(mode, "paint") == 0) {
            out[i][0] = (float)(p[0] + (red ? red[i] : 0.0) / 255.0);
            out[i][1] = (float)(p[1] + (quality ? quality[i] : 0.0));
            out[i][2] = (float)(p[2] + (all ? (double)all->count : 0.0));
        } else {
            out[i][0] = from[0] + (float)time->seconds;
            out[i][1] = from[1] + (float)time->frame;
        }
    }
    return SIMOD_OK;
}

static uint32_t migrate(uint32_t from, const SimodParam *settings, size_t count, SimodSettingList *to,
                        const SimodHost *host)
{
    (void)from;
    for (size_t i = 0; i < count; i++) {
        SimodParam setting = settings[i];
        double reach;
        if (strcmp(setting.id, "reach") == 0) {
            if (setting.numbers[0] < 0)
                return host->error(host, SIMOD_INVALID_PARAMETER, "parameter `reach` was never below 0",
                                   "give a part of the diagonal");
            reach = setting.numbers[0] / 100;
            setting.kind = SIMOD_PARAM_FLOAT;
            setting.numbers = &reach;
        }
        to->set(to, &setting);
    }
    return SIMOD_OK;
}

static const void *extension(const char *id)
{
    static const SimodAlias aliases[] = { { "method", "mode" }, { "distance", "reach" } };
    static const SimodMigration migration = {
        .state_version = 2, .aliases = aliases, .alias_count = 2, .migrate = migrate,
    };
    return strcmp(id, SIMOD_MIGRATION) == 0 ? &migration : NULL;
}

const SimodPlugin simod_plugin_entry = {
    .interface_major = SIMOD_INTERFACE_MAJOR, .interface_minor = SIMOD_INTERFACE_MINOR, .size = sizeof(SimodPlugin),
    .describe = describe, .prepare = prepare, .drop_state = drop_state, .new_scratch = new_scratch,
    .drop_scratch = free, .deform = deform, .extension = extension,
};
