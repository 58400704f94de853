// Lines and dots over the finished picture, with smooth borders.

struct Mark {
    a: vec3f,
    // Half the width in pixels.
    half_width: f32,
    b: vec3f,
    // A byte each of red, green, blue and opacity.
    color: u32,
    // Whether what lies in front does not hide it.
    on_top: u32,
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(1) @binding(0) var<storage, read> marks: array<Mark>;
@group(1) @binding(1) var depths: texture_2d<f32>;

struct Corner {
    @builtin(position) position: vec4f,
    // Of the pixel, from the line's beginning.
    @location(0) @interpolate(linear) from_a: vec2f,
    // From the line's beginning to its end.
    @location(1) @interpolate(flat) way: vec2f,
    // Clip coordinates z and w at both ends.
    @location(2) @interpolate(flat) ends: vec4f,
    @location(3) @interpolate(flat) color: vec4f,
    @location(4) @interpolate(flat) half_width: f32,
    @location(5) @interpolate(flat) on_top: u32,
}

fn pixel_of(clip: vec4f) -> vec2f {
    return (clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * frame.finished;
}

@vertex
fn corner(@builtin(vertex_index) index: u32) -> Corner {
    let mark = marks[index / 6u];
    var out: Corner;
    out.position = vec4f(2.0, 2.0, 2.0, 1.0);
    var a = frame.projection * (frame.view * vec4f(mark.a, 1.0));
    var b = frame.projection * (frame.view * vec4f(mark.b, 1.0));
    // What lies before the near plane is cut off.
    if a.z < 0.0 && b.z < 0.0 {
        return out;
    }
    if a.z < 0.0 {
        a = mix(a, b, a.z / (a.z - b.z));
    } else if b.z < 0.0 {
        b = mix(b, a, b.z / (b.z - a.z));
    }
    let begins = pixel_of(a);
    let way = pixel_of(b) - begins;
    let along = select(vec2f(1.0, 0.0), way / max(length(way), 1e-9), length(way) > 1e-4);
    let across = vec2f(-along.y, along.x);
    let margin = mark.half_width + 1.0;
    // Two triangles: 0 1 2 and 1 2 3.
    let k = index % 6u;
    let which = select(k - 2u, k, k < 3u);
    let end = which >> 1u;
    let at = begins + f32(end) * way + along * margin * (f32(end) * 2.0 - 1.0)
        + across * margin * (f32(which & 1u) * 2.0 - 1.0);
    out.position = vec4f((at / frame.finished - 0.5) * vec2f(2.0, -2.0), 0.0, 1.0);
    out.from_a = at - begins;
    out.way = way;
    out.ends = vec4f(a.zw, b.zw);
    out.color = unpack4x8unorm(mark.color);
    out.half_width = mark.half_width;
    out.on_top = mark.on_top;
    return out;
}

// The depth from the third and fourth clip coordinates.
fn depth_of(z: f32, w: f32) -> f32 {
    if is_perspective() {
        return (frame.projection[3].w - w) / frame.projection[2].w;
    }
    return (frame.projection[3].z - z) / frame.projection[2].z;
}

@fragment
fn pixel(in: Corner) -> @location(0) vec4f {
    let t = clamp(dot(in.from_a, in.way) / max(dot(in.way, in.way), 1e-9), 0.0, 1.0);
    let coverage = clamp(in.half_width + 0.5 - length(in.from_a - t * in.way), 0.0, 1.0);
    if coverage <= 0.0 {
        discard;
    }
    if in.on_top == 0u {
        // On the picture, z/w and 1/w are linear.
        let w = 1.0 / mix(1.0 / in.ends.y, 1.0 / in.ends.w, t);
        let z = mix(in.ends.x / in.ends.y, in.ends.z / in.ends.w, t) * w;
        let size = textureDimensions(depths);
        let at = vec2u(in.position.xy * vec2f(size) / frame.finished);
        let surface = textureLoad(depths, min(at, size - 1u), 0).r;
        // What lies on the surface is not hidden by it.
        if surface > 0.0 && depth_of(z, w) > surface + 4.0 * pixel_at(surface) {
            discard;
        }
    }
    return vec4f(in.color.rgb, in.color.a * coverage);
}
