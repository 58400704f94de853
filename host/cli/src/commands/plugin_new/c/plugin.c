// Swells a model about a point, or pinches it: a deformation for SIMOD, to be changed into your own.
//
// SIMOD takes some thousands of samples of a model of any size, asks this library where they go, and carries
// the whole model along. All coordinates here are local ones: the model's, shifted and scaled to a diagonal
// of 1 to 2. simod_plugin.h says what each function may rely on, on which thread it is called, and who owns
// what.
#include "simod_plugin.h"

#include <math.h>
#include <string.h>

// Parameters. Their values come in this order, all there and in their ranges.
enum { CENTER, RADIUS, STRENGTH, FALLOFF, PARAM_COUNT };

static const SimodParamDesc params[PARAM_COUNT] = {
    // The default of a point is in fractions of the model's box.
    [CENTER] = { .id = "center", .name = "Centre", .hint = "Centre of the swelling", .kind = SIMOD_PARAM_POINT,
                 .default_numbers = { 0.5, 0.5, 0.5 } },
    // A fraction of the model's diagonal, so that the default suits a model of any size.
    [RADIUS] = { .id = "radius", .name = "Radius", .hint = "Distance from the centre up to which points move",
                 .kind = SIMOD_PARAM_FLOAT, .unit = SIMOD_UNIT_DIAGONAL, .hard_range = { 1e-6, 10 },
                 .default_numbers = { 0.3 } },
    [STRENGTH] = { .id = "strength", .name = "Strength", .hint = "Strength of the swelling; below 0 pinches",
                   .kind = SIMOD_PARAM_FLOAT, .hard_range = { -1, 10 }, .default_numbers = { 0.5 } },
    [FALLOFF] = { .id = "falloff", .name = "Falloff", .hint = "Narrowness, from 1 for wide to 8 for narrow",
                  .kind = SIMOD_PARAM_FLOAT, .hard_range = { 1, 8 }, .default_numbers = { 2 } },
};

static const SimodDescriptor descriptor = {
    .id = "__NAME__", .name = "__TITLE__", .version = "0.1.0",
    .summary = "Swells the model about a point, or pinches it",
    .params = params, .param_count = PARAM_COUNT,
};

static const SimodDescriptor *describe(void) { return &descriptor; }

// The map: a point at distance r < radius from the centre goes to 1 + strength (1 - (r / radius)^2)^falloff
// times that distance; all others stay exactly where they are.
static void bulge(const SimodDeformInput *input, double p[3])
{
    const SimodParam *values = input->params;
    const double *center = values[CENTER].numbers, *min = input->bounds.min, *max = input->bounds.max;
    double d[3], r2 = 0, diagonal2 = 0;
    for (int k = 0; k < 3; k++) {
        d[k] = p[k] - center[k];
        r2 += d[k] * d[k];
        diagonal2 += (max[k] - min[k]) * (max[k] - min[k]);
    }
    double radius = values[RADIUS].numbers[0];
    double t = r2 / (radius * radius * diagonal2);
    double push = t < 1 ? values[STRENGTH].numbers[0] * pow(1 - t, values[FALLOFF].numbers[0]) : 0;
    for (int k = 0; k < 3; k++) p[k] += push * d[k];
}

// Moves sample i to out[i].
static uint32_t deform(const void *state, const SimodDeformInput *input, void *scratch, float (*out)[3],
                       const SimodHost *host)
{
    (void)state, (void)scratch, (void)host; // Nothing is worth preparing, nor keeping; and this takes no time.
    for (size_t i = 0; i < input->samples.count; i++) {
        const float *from = input->samples.positions[i];
        double p[3] = { from[0], from[1], from[2] };
        bulge(input, p);
        for (int k = 0; k < 3; k++) out[i][k] = (float)p[k];
    }
    return SIMOD_OK;
}

// The same map at any point, by which SIMOD measures its results. Not all deformations know it: this can be
// left out, and `extension` with it.
static uint32_t evaluate(const void *state, const SimodDeformInput *input, double (*points)[3], size_t count,
                         const SimodHost *host)
{
    (void)state, (void)host;
    for (size_t i = 0; i < count; i++) bulge(input, points[i]);
    return SIMOD_OK;
}

static const void *extension(const char *id)
{
    static const SimodEvaluate known = { evaluate };
    return strcmp(id, SIMOD_EVALUATE) == 0 ? &known : NULL;
}

// Entry of this library, which SIMOD looks up.
const SimodPlugin simod_plugin_entry = {
    .interface_major = SIMOD_INTERFACE_MAJOR, .interface_minor = SIMOD_INTERFACE_MINOR,
    .size = sizeof(SimodPlugin), .describe = describe, .deform = deform, .extension = extension,
};
