// A plugin in C++11, which moves everything along x.
#include "simod_plugin.h"

#include <exception>
#include <vector>

namespace {

struct State {
    std::vector<float> x;
};

const SimodDescriptor *describe()
{
    static SimodParamDesc by = SimodParamDesc();
    static SimodDescriptor descriptor = SimodDescriptor();
    by.id = "by";
    by.name = "By";
    by.hint = "How far it moves";
    by.kind = SIMOD_PARAM_FLOAT;
    by.default_numbers[0] = 1;
    descriptor.id = "shift-cpp";
    descriptor.name = "Shift";
    descriptor.version = "1.0.0";
    descriptor.summary = "Moves everything along x";
    descriptor.params = &by;
    descriptor.param_count = 1;
    return &descriptor;
}

uint32_t prepare(const SimodPrepareInput *input, const SimodHost *host, void **to)
{
    try {
        State *state = new State;
        for (size_t i = 0; i < input->samples.count; i++) state->x.push_back(input->samples.positions[i][0]);
        *to = state;
        return SIMOD_OK;
    } catch (const std::exception &e) {
        return host->error(host, SIMOD_INTERNAL, e.what(), nullptr);
    }
}

uint32_t deform(const void *state, const SimodDeformInput *input, void *, float (*out)[3], const SimodHost *)
{
    const State &prepared = *static_cast<const State *>(state);
    for (size_t i = 0; i < input->samples.count; i++) {
        out[i][0] = prepared.x[i] + static_cast<float>(input->params[0].numbers[0]);
        out[i][1] = input->samples.positions[i][1];
        out[i][2] = input->samples.positions[i][2];
    }
    return SIMOD_OK;
}

} // namespace

const SimodPlugin simod_plugin_entry = {
    SIMOD_INTERFACE_MAJOR, SIMOD_INTERFACE_MINOR, sizeof(SimodPlugin), describe, prepare,
    [](void *state) { delete static_cast<State *>(state); }, nullptr, nullptr, deform, nullptr,
};
