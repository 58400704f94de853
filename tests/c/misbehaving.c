// Does one thing wrong, which the compiler is told: cc -DWRONG=...
#include "simod_plugin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    NOTHING,
    NULL_DESCRIPTION, NULL_ID, NULL_NAME, BAD_UTF8, NO_PARAMS, ABSURD_COUNT, UNKNOWN_KIND, BAD_DEFAULT, NEEDS_MORE,
    NO_DEFORM, SMALL_TABLE, NEXT_VERSION, NO_EVALUATE,
    SILENT_ERROR, SPOKEN_ERROR, BAD_UTF8_ERROR, CANCELS, NANS, UNWRITTEN, WRITES_INPUT, NO_SCRATCH,
};

static SimodParamDesc params[] = {
    { .id = "by", .name = "By", .hint = "How far", .kind = WRONG == UNKNOWN_KIND ? 99 : SIMOD_PARAM_FLOAT,
      .hard_range = { -2, 2 }, .default_numbers = { WRONG == BAD_DEFAULT ? 3 : 1 } },
};

static const SimodInputDesc inputs[] = { { "simod.smell/9", WRONG == NEEDS_MORE } };

static const SimodDescriptor *describe(void)
{
    static SimodDescriptor d = { .id = "misbehaving-c", .name = "Misbehaving", .version = "1.0.0",
        .summary = "Does one thing wrong", .params = params, .param_count = 1, .inputs = inputs, .input_count = 1 };
    switch ((int)WRONG) {
    case NULL_DESCRIPTION: return NULL;
    case NULL_ID: d.id = NULL; break;
    case NULL_NAME: params[0].name = NULL; d.name = NULL; break;
    case BAD_UTF8: d.summary = "\xff\xfe"; break;
    case NO_PARAMS: d.params = NULL; break;
    case ABSURD_COUNT: d.param_count = (size_t)-1; break;
    }
    return &d;
}

static uint32_t prepare(const SimodPrepareInput *input, const SimodHost *host, void **state)
{
    (void)input;
    static char anything;
    *state = &anything; // Not to be freed: there is no drop_state.
    switch ((int)WRONG) {
    case SILENT_ERROR: return 42;
    case SPOKEN_ERROR: return host->error(host, SIMOD_INVALID_INPUT, "this does not\nplease me", "give me another");
    case BAD_UTF8_ERROR: return host->error(host, SIMOD_INTERNAL, "bad \xff byte", NULL);
    case CANCELS: return SIMOD_CANCELLED;
    }
    return SIMOD_OK;
}

static void *new_scratch(void)
{
    static char anything;
    return WRONG == NO_SCRATCH ? NULL : &anything;
}

static uint32_t deform(const void *state, const SimodDeformInput *input, void *scratch, float (*out)[3],
                       const SimodHost *host)
{
    if (!state || !scratch) return host->error(host, SIMOD_INTERNAL, "they are gone", NULL);
    size_t count = input->samples.count;
    for (size_t i = 0; i + (WRONG == UNWRITTEN) < count; i++) {
        memcpy(out[i], input->samples.positions[i], sizeof out[i]);
        out[i][0] += (float)input->params[0].numbers[0];
    }
    if (WRONG == NANS) out[0][1] = NAN;
    if (WRONG == WRITES_INPUT) ((float *)(size_t)input->samples.positions)[0] += 1;
    return SIMOD_OK;
}

static const void *extension(const char *id)
{
    static const SimodEvaluate empty = { NULL };
    return WRONG == NO_EVALUATE && strcmp(id, SIMOD_EVALUATE) == 0 ? &empty : NULL;
}

const SimodPlugin simod_plugin_entry = {
    .interface_major = SIMOD_INTERFACE_MAJOR + (WRONG == NEXT_VERSION), .interface_minor = SIMOD_INTERFACE_MINOR,
    .size = WRONG == SMALL_TABLE ? 24 : sizeof(SimodPlugin), .describe = describe, .prepare = prepare,
    .new_scratch = new_scratch, .deform = WRONG == NO_DEFORM ? NULL : deform, .extension = extension,
};
