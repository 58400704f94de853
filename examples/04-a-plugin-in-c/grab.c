// A soft grab: what lies in the ball around a handle's samples goes with the handle, and the surroundings
// follow, less and less, as far as it reaches.
#include "simod_plugin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// The parameters. Their values come in this order.
enum { REACH, FALLOFF, PARAM_COUNT };

static const SimodChoiceDesc falloffs[] = { { "smooth", "Smooth" }, { "linear", "Linear" } };

static const SimodParamDesc params[PARAM_COUNT] = {
    [REACH] = { .id = "reach", .name = "Reach", .hint = "Distance from the handle up to which things follow",
                .kind = SIMOD_PARAM_FLOAT, .unit = SIMOD_UNIT_DIAGONAL, .hard_range = { 0, 10 },
                .soft_range = { 0, 1 }, .default_numbers = { 0.2 } },
    [FALLOFF] = { .id = "falloff", .name = "Falloff", .hint = "Course by which they follow less and less",
                  .kind = SIMOD_PARAM_CHOICE, .choices = falloffs, .choice_count = 2, .default_text = "smooth" },
};

static const SimodInputDesc inputs[] = { { SIMOD_INPUT_HANDLE_REGIONS, 1 } };

static const SimodDescriptor descriptor = {
    .id = "grab", .name = "Grab", .version = "1.0.0", .summary = "Moves handles, and softly what is around them",
    .params = params, .param_count = PARAM_COUNT, .inputs = inputs, .input_count = 1,
};

static const SimodDescriptor *describe(void) { return &descriptor; }

// Result of `prepare` for all calls of `deform`: the places of the handles.
typedef struct { double center[3], radius; } Ball;
typedef struct { size_t count; Ball balls[]; } State;

static double distance(const double a[3], const double b[3])
{
    return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
}

// The ball about the mean of the samples of a region; false if there are none.
static bool enclose(const SimodSamples *samples, const float *weights, Ball *ball)
{
    double sum = 0;
    for (size_t i = 0; i < samples->count; i++) {
        sum += weights[i];
        for (int k = 0; k < 3; k++) ball->center[k] += weights[i] * samples->positions[i][k];
    }
    for (int k = 0; k < 3 && sum > 0; k++) ball->center[k] /= sum;
    for (size_t i = 0; i < samples->count; i++) {
        double p[3] = { samples->positions[i][0], samples->positions[i][1], samples->positions[i][2] };
        if (weights[i] > 0.5) ball->radius = fmax(ball->radius, distance(p, ball->center));
    }
    return sum > 0;
}

static uint32_t prepare(const SimodPrepareInput *input, const SimodHost *host, void **to)
{
    State *state = calloc(1, sizeof(State) + input->region_count * sizeof(Ball));
    if (!state) return host->error(host, SIMOD_INTERNAL, "there is no memory left", "close other programs");
    for (size_t r = 0; r < input->region_count; r++) {
        if (!enclose(&input->samples, input->regions[r].weights, &state->balls[state->count++])) {
            free(state);
            return host->error(host, SIMOD_INVALID_INPUT, "a handle holds no samples", "make its shape larger");
        }
    }
    *to = state;
    return SIMOD_OK;
}

// The map: the displacements of all handles, by how near they are.
static void grab(const State *state, const SimodDeformInput *input, double p[3])
{
    const double *min = input->bounds.min, *max = input->bounds.max;
    double reach = input->params[REACH].numbers[0] * distance(min, max);
    bool linear = strcmp(input->params[FALLOFF].text, "linear") == 0;
    double shift[3] = { 0 }, sum = 0;
    for (size_t h = 0; h < state->count; h++) {
        double beyond = distance(p, state->balls[h].center) - state->balls[h].radius;
        double t = beyond > 0 ? beyond / reach : 0;
        if (!(t < 1)) continue;
        double weight = linear ? 1 - t : (1 - t) * (1 - t) * (1 + 2 * t);
        sum += weight;
        for (int k = 0; k < 3; k++) {
            // A handle that does not move gives exactly nothing.
            const double *row = input->transforms[h].rows[k];
            shift[k] += weight * (row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3] - p[k]);
        }
    }
    for (int k = 0; k < 3; k++) p[k] += shift[k] / fmax(sum, 1);
}

static uint32_t deform(const void *state, const SimodDeformInput *input, void *scratch, float (*out)[3],
                       const SimodHost *host)
{
    (void)scratch, (void)host; // Nothing to keep, and too quick to be stopped.
    for (size_t i = 0; i < input->samples.count; i++) {
        const float *from = input->samples.positions[i];
        double p[3] = { from[0], from[1], from[2] };
        grab(state, input, p);
        for (int k = 0; k < 3; k++) out[i][k] = (float)p[k];
    }
    return SIMOD_OK;
}

// The same map at any point of space: what SIMOD measures results against.
static uint32_t evaluate(const void *state, const SimodDeformInput *input, double (*points)[3], size_t count,
                         const SimodHost *host)
{
    (void)host;
    for (size_t i = 0; i < count; i++) grab(state, input, points[i]);
    return SIMOD_OK;
}

static const void *extension(const char *id)
{
    static const SimodEvaluate known = { evaluate };
    return strcmp(id, SIMOD_EVALUATE) == 0 ? &known : NULL;
}

const SimodPlugin simod_plugin_entry = {
    .interface_major = SIMOD_INTERFACE_MAJOR, .interface_minor = SIMOD_INTERFACE_MINOR, .size = sizeof(SimodPlugin),
    .describe = describe, .prepare = prepare, .drop_state = free, .deform = deform, .extension = extension,
};
