// Does one thing that a plugin should leave alone, which the compiler is told: cc -DDOES=...
#define _GNU_SOURCE
#include "simod_plugin.h"

#include <fenv.h>
#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

enum {
    NOTHING, SLEEPS_AT_LOAD, STARTS_A_PROCESS_AT_LOAD, STARTS_A_PROCESS, CHANGES_ROUNDING, CHANGES_FOLDER, PRINTS,
    CLOSES_OUTPUT, SPEAKS_RAW, GOES_FAR, GOES_TOO_FAR, LACKS_A_FUNCTION, MOVES_AT_REST, MOVES_AT_REST_AND_SAYS_SO,
    LAGS_BEHIND, ALIASES_RAW, ALIASES_A_PARAMETER, VERSION_ZERO, GIVES_ENDLESSLY, GIVES_WHAT_IS_NOT_THERE,
    CRASHES_WHILE_MIGRATING, GIVES_NOTHING_GOOD,
};

#ifndef VERSION
#define VERSION "1.0.0"
#endif
#ifndef ID
#define ID "hostile"
#endif

// Goes on for longer than any test, unless somebody ends it.
static void start_a_process(void)
{
    if (fork() == 0) {
        sleep(60);
        _exit(0);
    }
}

static void change_rounding(void)
{
    fesetround(FE_UPWARD);
#if defined(__x86_64__)
    _mm_setcsr(_mm_getcsr() | 0x8040); // Numbers too small to be normal are zero.
#endif
}

__attribute__((constructor)) static void load(void)
{
    // A signal ends a sleep, and not this.
    for (int i = 0; DOES == SLEEPS_AT_LOAD && !getenv("AWAKE") && i < 30;) i += sleep(1) == 0;
    if (DOES == STARTS_A_PROCESS_AT_LOAD) {
        start_a_process();
        sleep(30);
    }
    if (DOES == CHANGES_ROUNDING) change_rounding();
    if (DOES == CHANGES_FOLDER && chdir("/") != 0) abort();
}

#define RAW "\033[31mred\033[0m\nerror: \xc2\x9b" "2Jfake\r"
#define TEXT(text) (DOES == SPEAKS_RAW ? text RAW : text)

static SimodParamDesc params[] = {
    { .id = "by", .name = TEXT("By"), .hint = TEXT("How far"), .group = TEXT("Distances"), .kind = SIMOD_PARAM_FLOAT,
      .hard_range = { -2, 2 }, .default_numbers = { 1 } },
};

static const SimodInputDesc inputs[] = { { SIMOD_INPUT_HANDLE_REGIONS, 1 } };

static const SimodDescriptor descriptor = {
    .id = ID, .name = TEXT("Hostile"), .version = VERSION, .summary = TEXT("Does what it should leave alone"),
    .author = TEXT("Nobody"), .params = params, .param_count = 1, .inputs = inputs,
    .input_count = DOES == MOVES_AT_REST || DOES == MOVES_AT_REST_AND_SAYS_SO || DOES == LAGS_BEHIND,
};

static const SimodDescriptor *describe(void) { return &descriptor; }

static void do_it(void)
{
    switch ((int)DOES) {
    case STARTS_A_PROCESS: start_a_process(); sleep(30); break;
    case CHANGES_ROUNDING: change_rounding(); break;
    case CHANGES_FOLDER: if (chdir("/") != 0) abort(); break;
    case PRINTS: printf("{\"samples\": 0"); break;
    case CLOSES_OUTPUT: close(1); break;
    }
}

static uint32_t prepare(const SimodPrepareInput *input, const SimodHost *host, void **state)
{
    (void)input, (void)state;
    do_it();
    if (DOES != SPEAKS_RAW) return SIMOD_OK;
    host->log(host, SIMOD_LOG_INFO, RAW);
    host->log(host, SIMOD_LOG_WARNING, RAW);
    return input->params[0].numbers[0] == 2 ? host->error(host, SIMOD_INVALID_INPUT, RAW, RAW) : SIMOD_OK;
}

#ifdef LACKING
void not_there_at_all(void);
#else
static void not_there_at_all(void) {}
#endif

static uint32_t deform(const void *state, const SimodDeformInput *input, void *scratch, float (*out)[3],
                       const SimodHost *host)
{
    (void)state, (void)scratch, (void)host;
    if (DOES == LACKS_A_FUNCTION) not_there_at_all();
    for (size_t i = 0; i < input->samples.count; i++) {
        memcpy(out[i], input->samples.positions[i], sizeof out[i]);
        if (input->transform_count > 0) {
            // Follows the handle, by half where it lags behind.
            const double (*m)[4] = input->transforms[0].rows;
            for (int k = 0; k < 3; k++) {
                const float *p = input->samples.positions[i];
                double to = m[k][0] * p[0] + m[k][1] * p[1] + m[k][2] * p[2] + m[k][3];
                out[i][k] += (float)((to - p[k]) * (DOES == LAGS_BEHIND ? 0.5 : 1));
            }
            if (DOES != LAGS_BEHIND) out[i][0] += 0.1f;
        } else {
            out[i][0] += (float)input->params[0].numbers[0];
        }
    }
    do_it(); // At the end: what it computes itself is to be as ever.
    if (DOES == GOES_FAR) out[0][1] = -FLT_MAX;
    if (DOES == GOES_TOO_FAR) out[0][1] = 1e20f;
    return SIMOD_OK;
}

static uint8_t is_identity(const SimodDeformInput *input)
{
    (void)input;
    return 0;
}

static uint32_t migrate(uint32_t from, const SimodParam *settings, size_t count, SimodSettingList *to,
                        const SimodHost *host)
{
    (void)from, (void)settings, (void)count, (void)host;
    double by = 1;
    SimodParam good = { .id = "by", .kind = SIMOD_PARAM_FLOAT, .numbers = &by, .count = 1 };
    SimodParam bad = good;
    if (DOES == CRASHES_WHILE_MIGRATING) abort();
    if (DOES == GIVES_WHAT_IS_NOT_THERE) bad.id = RAW;
    if (DOES == GIVES_NOTHING_GOOD) bad.numbers = NULL;
    for (int i = 0; i < (DOES == GIVES_ENDLESSLY ? 20000 : 1); i++) to->set(to, &bad);
    return SIMOD_OK;
}

static const void *extension(const char *id)
{
    static const SimodAlias aliases[] = { { DOES == ALIASES_A_PARAMETER ? "by" : RAW, "by" } };
    static const SimodMigration migration = {
        .state_version = DOES == VERSION_ZERO ? 0 : 2, .aliases = aliases,
        .alias_count = DOES == ALIASES_RAW || DOES == ALIASES_A_PARAMETER, .migrate = migrate,
    };
    if (DOES >= ALIASES_RAW && strcmp(id, SIMOD_MIGRATION) == 0) return &migration;
    static const SimodIsIdentity identity = { is_identity };
    int tells = DOES == MOVES_AT_REST_AND_SAYS_SO || DOES == SLEEPS_AT_LOAD;
    return tells && strcmp(id, SIMOD_IS_IDENTITY) == 0 ? &identity : NULL;
}

const SimodPlugin simod_plugin_entry = {
    .interface_major = SIMOD_INTERFACE_MAJOR, .interface_minor = SIMOD_INTERFACE_MINOR, .size = sizeof(SimodPlugin),
    .describe = describe, .prepare = prepare, .deform = deform, .extension = extension,
};
