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

fn pixel_color(at: vec2i) -> vec3f {
    let last = vec2i(textureDimensions(lit)) - 1;
    return textureLoad(lit, clamp(at, vec2i(0), last), 0).rgb;
}

fn color_between(position: vec2f) -> vec3f {
    return textureSampleLevel(lit, between, position / vec2f(textureDimensions(lit)), 0.0).rgb;
}

fn luminance(c: vec3f) -> f32 {
    return dot(c, vec3f(0.299, 0.587, 0.114));
}

// A pixel for several.
@fragment
fn stretched(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return vec4f(color_between(position.xy * vec2f(textureDimensions(lit)) / frame.finished), 1.0);
}

// A pixel for one: blurred along edges (after T. Lottes, "FXAA", NVIDIA white paper, 2009).
@fragment
fn smoothed(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let at = vec2i(position.xy);
    let middle = pixel_color(at);
    let l = luminance(middle);
    let nw = luminance(pixel_color(at + vec2i(-1, -1)));
    let ne = luminance(pixel_color(at + vec2i(1, -1)));
    let sw = luminance(pixel_color(at + vec2i(-1, 1)));
    let se = luminance(pixel_color(at + vec2i(1, 1)));
    let low = min(l, min(min(nw, ne), min(sw, se)));
    let high = max(l, max(max(nw, ne), max(sw, se)));
    if high - low < max(0.02, 0.035 * high) {
        return vec4f(middle, 1.0);
    }
    // The edge runs across the gradient.
    var along = vec2f(sw + se - nw - ne, nw + sw - ne - se);
    let softness = max((nw + ne + sw + se) * 0.03, 0.008);
    along = clamp(along / (min(abs(along.x), abs(along.y)) + softness), vec2f(-6.0), vec2f(6.0));
    let here = position.xy;
    let short = 0.5 * (color_between(here - along / 6.0) + color_between(here + along / 6.0));
    let long = 0.5 * short + 0.25 * (color_between(here - 0.5 * along) + color_between(here + 0.5 * along));
    let l_long = luminance(long);
    return vec4f(select(long, short, l_long < low || l_long > high), 1.0);
}
