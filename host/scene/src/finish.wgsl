// From the lit picture to the finished one, with smooth edges.

@group(1) @binding(0) var lit: texture_2d<f32>;
@group(1) @binding(1) var between: sampler;

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4f {
    return whole_picture(vertex);
}

// Two by two pixels for one: their mean in linear light.
@fragment
fn averaged(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let first = 2u * vec2u(position.xy);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 4u; i++) {
        sum += linear_of(textureLoad(lit, first + vec2u(i & 1u, i >> 1u), 0).rgb);
    }
    return vec4f(srgb_of(0.25 * sum), 1.0);
}

fn at(position: vec2f) -> vec3f {
    return textureSampleLevel(lit, between, position / vec2f(textureDimensions(lit)), 0.0).rgb;
}

fn luminance(c: vec3f) -> f32 {
    return dot(c, vec3f(0.299, 0.587, 0.114));
}

// A pixel for one or for several: blurred along edges (after T. Lottes, "FXAA", NVIDIA white paper, 2009).
@fragment
fn smoothed(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let here = position.xy * vec2f(textureDimensions(lit)) / frame.finished;
    let middle = at(here);
    let l = luminance(middle);
    let nw = luminance(at(here + vec2f(-1.0, -1.0)));
    let ne = luminance(at(here + vec2f(1.0, -1.0)));
    let sw = luminance(at(here + vec2f(-1.0, 1.0)));
    let se = luminance(at(here + vec2f(1.0, 1.0)));
    let low = min(l, min(min(nw, ne), min(sw, se)));
    let high = max(l, max(max(nw, ne), max(sw, se)));
    if high - low < max(0.04, 0.1 * high) {
        return vec4f(middle, 1.0);
    }
    // The edge runs across the gradient.
    var along = vec2f(sw + se - nw - ne, nw + sw - ne - se);
    let softness = max((nw + ne + sw + se) * 0.03, 0.008);
    along = clamp(along / (min(abs(along.x), abs(along.y)) + softness), vec2f(-6.0), vec2f(6.0));
    let short = 0.5 * (at(here - along / 6.0) + at(here + along / 6.0));
    let long = 0.5 * short + 0.25 * (at(here - 0.5 * along) + at(here + 0.5 * along));
    let l_long = luminance(long);
    return vec4f(select(long, short, l_long < low || l_long > high), 1.0);
}
