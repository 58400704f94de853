// From sums to the surface that is seen: colour, normal, depth.

@group(1) @binding(0) var nearest: texture_2d<f32>;
@group(1) @binding(1) var colors: texture_2d<f32>;
@group(1) @binding(2) var surfaces: texture_2d<f32>;

struct Seen {
    @location(0) color: vec4f,
    @location(1) normal: vec4f,
    @location(2) depth: vec4f,
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4f {
    return whole_picture(vertex);
}

@fragment
fn pixel(@builtin(position) position: vec4f) -> Seen {
    let at = vec2u(position.xy);
    let first = textureLoad(nearest, at, 0).r;
    let color = textureLoad(colors, at, 0);
    let surface = textureLoad(surfaces, at, 0);
    let weight = max(color.a, 1e-6);
    let depth = select(0.0, max(first + surface.w / weight, 1e-9), first > 0.0);

    // Where no sample had a normal, the depths tell it.
    let point = point_at(position.xy, depth);
    let derived = cross(dpdy(point), dpdx(point));
    var normal = surface.xyz / weight;
    if dot(normal, normal) < 1e-4 {
        normal = derived;
        if dot(normal, point) > 0.0 {
            normal = -normal;
        }
    }
    normal = normal / max(length(normal), 1e-12);
    if first <= 0.0 {
        return Seen(vec4f(0.0), vec4f(0.0), vec4f(0.0));
    }
    return Seen(vec4f(color.rgb / weight, 1.0), vec4f(normal, 1.0), vec4f(depth));
}
