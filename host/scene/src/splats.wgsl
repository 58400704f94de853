// Samples as oriented discs, in two passes: see splats.rs.

// Shares of their radius to which discs hide what is behind them; farther out they only blend in. First where they
// are seen on edge, as at creases, where they should not stand out from the surface; then where they face the eye.
const HIDING_FRONT = vec2f(0.6, 0.82);
const HIDING_BACK = vec2f(0.3, 0.6);
// Where only a part of the discs is drawn: they are not spread evenly.
const HIDING_PART = vec2f(0.6, 0.9);
// A disc reaches at least so many pixels around its middle, in all directions.
const LEAST_REACH = 0.75;
// How far behind the nearest surface a disc still blends in, in its radii.
const LAYER = 0.8;
// How much farther away, in its radii, a disc seen from the back counts: the far side of a thin wall must not
// shine through.
const BACK_PENALTY = 1.0;

@group(2) @binding(0) var nearest: texture_2d<f32>;

struct Corner {
    @builtin(position) position: vec4f,
    // On the disc, whose radius is 1; or on an ellipse, by parts of its half axes.
    @location(0) disc: vec2f,
    @location(1) depth: f32,
    @location(2) @interpolate(flat) normal: vec3f,
    @location(3) @interpolate(flat) color: vec3f,
    // Square of the share of the radius to which it hides.
    @location(4) @interpolate(flat) hiding: f32,
    // How much of its area is seen: discs on edge, which stand out at creases, count little.
    @location(5) @interpolate(flat) seen: f32,
}

// Corners of the triangle around the unit circle.
fn around_disc(i: u32) -> vec2f {
    if i == 0u {
        return vec2f(0.0, 2.0);
    }
    return vec2f(select(1.7320508, -1.7320508, i == 1u), -1.0);
}

// A corner of the triangle around a disc, or around its part that hides. The triangle lies in the disc's plane, so
// that what is interpolated with perspective is where the pixel's ray meets the disc.
fn corner(index: u32, hiding_part: bool) -> Corner {
    var out: Corner;
    // Outside of the picture.
    out.position = vec4f(2.0, 2.0, 2.0, 1.0);
    let sample = geometry[index / 3u];
    let own = look[index / 3u];
    if sample.w == HIDDEN || bitcast<f32>(own.x) < 0.0 {
        return out;
    }
    let center = position_of(sample);
    let depth = -center.z;
    let eye = to_eye(center);
    if is_perspective() && depth <= 0.0 {
        return out;
    }
    var normal = normal_of(sample);
    var facing = dot(normal, eye);
    let back = facing < 0.0;
    if back {
        if (frame.flags & ONE_SIDED) != 0u {
            return out;
        }
        normal = -normal;
        facing = -facing;
    }
    let known = sample.w != UNKNOWN;

    // No disc is seen narrower than a pixel: small ones grow, edge-on ones are turned towards the eye.
    let least = LEAST_REACH * pixel_at(depth);
    let radius = max(bitcast<f32>(own.x) * frame.radius_scale, least);
    let share = least / radius;
    let across = normal - eye * facing;
    var axis = eye;
    if known && dot(across, across) > 1e-8 {
        let tilt = max(facing, share);
        axis = eye * tilt + normalize(across) * sqrt(max(1.0 - tilt * tilt, 0.0));
    }
    var u = normalize(cross(axis, select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(axis.x) > 0.7)));
    let width = max(width_of(shape[index / 3u]), share);
    if width < 1.0 {
        let long = cross(axis, long_axis_of(shape[index / 3u]));
        u = select(u, cross(normalize(long), axis), dot(long, long) > 1e-8);
    }
    let v = cross(axis, u) * width;

    var ends = select(HIDING_FRONT, HIDING_PART, frame.radius_scale > 1.0);
    ends = select(ends, HIDING_BACK, back);
    let hiding = max(mix(ends.x, ends.y, select(1.0, smoothstep(0.1, 0.6, facing), known)), share);
    let disc = around_disc(index % 3u) * select(1.0, hiding, hiding_part);
    let point = center + radius * (u * disc.x + v * disc.y);

    // Seen from the eye, scaling about it moves the disc backwards alone.
    let behind = radius * sqrt(width) * (select(0.0, BACK_PENALTY, back) + select(0.0, LAYER, hiding_part));
    var moved = point - vec3f(0.0, 0.0, behind);
    if is_perspective() {
        moved = point * (1.0 + behind / length(center));
    }
    out.position = frame.projection * vec4f(moved, 1.0);
    out.disc = disc;
    out.depth = -point.z;
    out.normal = normal;
    if back {
        // What is just beyond the horizon looks like what is just before it, not like the other side.
        out.normal = normalize(mix(-across, normal, smoothstep(0.0, 0.5, facing)));
    }
    out.color = color_of(own);
    if back {
        out.color = inside(out.color);
    }
    out.hiding = hiding * hiding;
    out.seen = select(1.0, max(facing, 0.02), known);
    return out;
}

@vertex
fn depth_corner(@builtin(vertex_index) index: u32) -> Corner {
    return corner(index, true);
}

// The nearest surface: its depth.
@fragment
fn depth_pixel(in: Corner) -> @location(0) vec4f {
    if dot(in.disc, in.disc) > in.hiding || is_clipped(point_at(in.position.xy, in.depth)) {
        discard;
    }
    return vec4f(in.depth);
}

@vertex
fn blend_corner(@builtin(vertex_index) index: u32) -> Corner {
    return corner(index, false);
}

struct Sums {
    // Colour, and the weights.
    @location(0) color: vec4f,
    // Normal, and how much deeper than the nearest.
    @location(1) surface: vec4f,
}

// What lies on the nearest surface: weighted sums.
@fragment
fn blend_pixel(in: Corner) -> Sums {
    let t = 1.0 - dot(in.disc, in.disc);
    if t <= 0.0 || is_clipped(point_at(in.position.xy, in.depth)) {
        discard;
    }
    let weight = t * t * in.seen;
    let deeper = in.depth - textureLoad(nearest, vec2u(in.position.xy), 0).r;
    return Sums(vec4f(in.color, 1.0) * weight, vec4f(in.normal, deeper) * weight);
}
