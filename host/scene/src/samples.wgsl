// The samples' arrays, of one chunk of them.

// Position (three floats), and the normal on an octahedron (two numbers of 16 bits).
@group(1) @binding(0) var<storage, read> geometry: array<vec4u>;
// Radius (a float), and red, green and blue (a byte each).
@group(1) @binding(1) var<storage, read> look: array<vec2u>;

// The longer axis of an ellipse, on an octahedron (two numbers of 12 bits), and the other's length beside it (8 bits).
@group(1) @binding(2) var<storage, read> shape: array<u32>;

// Instead of a normal: nothing is drawn; a normal that is not known.
const HIDDEN = 0x80008000u;
const UNKNOWN = 0x80000000u;

fn position_of(sample: vec4u) -> vec3f {
    return (frame.view * vec4f(bitcast<vec3f>(sample.xyz), 1.0)).xyz;
}

// In the view's space; zero where it is not known.
fn normal_of(sample: vec4u) -> vec3f {
    if sample.w == UNKNOWN {
        return vec3f(0.0);
    }
    return direction_of(unpack2x16snorm(sample.w));
}

// The direction in the view's space of a point on the octahedron: Z. Cigolle et al., "A Survey of Efficient
// Representations for Independent Unit Vectors", JCGT 3(2), 2014.
fn direction_of(e: vec2f) -> vec3f {
    var n = vec3f(e, 1.0 - abs(e.x) - abs(e.y));
    let fold = max(-n.z, 0.0);
    n = vec3f(n.xy - select(vec2f(-fold), vec2f(fold), n.xy >= vec2f(0.0)), n.z);
    return normalize((frame.view * vec4f(n, 0.0)).xyz);
}

// How long the shorter axis is beside the longer one; 1 of discs.
fn width_of(shape: u32) -> f32 {
    return f32(shape >> 24u) / 255.0;
}

fn long_axis_of(shape: u32) -> vec3f {
    return direction_of((vec2f(vec2u(shape, shape >> 12u) & vec2u(0xfffu)) - 2047.0) / 2047.0);
}

fn color_of(look: vec2u) -> vec3f {
    // What is cut open tells its inside by colours, so that all has some.
    if (frame.flags & (CLIP | OWN_COLORS)) == CLIP {
        return srgb_of(frame.clay.rgb);
    }
    return unpack4x8unorm(look.y).rgb;
}

// What is seen of the inside of a surface that is cut open.
fn inside(color: vec3f) -> vec3f {
    return select(color, mix(color, vec3f(0.62, 0.24, 0.20), 0.62), (frame.flags & CLIP) != 0u);
}
