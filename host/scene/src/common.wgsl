// What all shaders share: the frame's uniform values, and the map between pixels and the space of the view
// (right, up, backward; so the surface is where z < 0). A "depth" is -z there; 0 stands for no surface.

struct Frame {
    view: mat4x4f,
    projection: mat4x4f,
    // Direction to the key light in the view's space, and how strong it is; direction to the fill light.
    key: vec4f,
    fill: vec4f,
    // Linear colours.
    clay: vec4f,
    ghost_color: vec4f,
    // sRGB.
    background_top: vec4f,
    background_bottom: vec4f,
    // What lies beyond it is cut away: normal and distance, in the view's space.
    clip: vec4f,
    // Pixels of the picture while it is drawn, and of the finished one.
    size: vec2f,
    finished: vec2f,
    // Of all discs, as fewer of them are drawn.
    radius_scale: f32,
    ghost_opacity: f32,
    // How far the occlusion reaches.
    reach: f32,
    flags: u32,
}

const OWN_COLORS = 1u;
const OCCLUSION = 2u;
const ONE_SIDED = 4u;
const GHOST = 8u;
const CLIP = 16u;
// Above these, which light it is.
const LIGHT = 8u;

@group(0) @binding(0) var<uniform> frame: Frame;

fn is_perspective() -> bool {
    return frame.projection[2].w != 0.0;
}

// The fourth clip coordinate at a depth.
fn clip_w(depth: f32) -> f32 {
    return frame.projection[3].w - frame.projection[2].w * depth;
}

// Units that a pixel spans at a depth.
fn pixel_at(depth: f32) -> f32 {
    return 2.0 * abs(clip_w(depth) / (frame.projection[1].y * frame.size.y));
}

// The point in the view's space that a pixel shows.
fn point_at(pixel: vec2f, depth: f32) -> vec3f {
    let clip = (pixel / frame.size * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0)) * clip_w(depth);
    let shear = frame.projection[3].xy - frame.projection[2].xy * depth;
    return vec3f((clip - shear) / vec2f(frame.projection[0].x, frame.projection[1].y), -depth);
}

// Whether a point in the view's space is cut away.
fn is_clipped(point: vec3f) -> bool {
    return (frame.flags & CLIP) != 0u && dot(frame.clip.xyz, point) > frame.clip.w;
}

// The direction to the eye from a point in the view's space.
fn to_eye(point: vec3f) -> vec3f {
    if is_perspective() {
        return -normalize(point);
    }
    return vec3f(0.0, 0.0, 1.0);
}

// A triangle that covers the picture.
fn whole_picture(vertex: u32) -> vec4f {
    return vec4f(f32(vertex & 1u) * 4.0 - 1.0, f32(vertex >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// Between linear values and those of the sRGB standard (IEC 61966-2-1).
fn linear_of(c: vec3f) -> vec3f {
    return select(pow((c + 0.055) / 1.055, vec3f(2.4)), c / 12.92, c <= vec3f(0.04045));
}

fn srgb_of(c: vec3f) -> vec3f {
    return select(1.055 * pow(max(c, vec3f(0.0)), vec3f(1.0 / 2.4)) - 0.055, 12.92 * c, c <= vec3f(0.0031308));
}
