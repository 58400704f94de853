// Triangles with the samples' normals and colours.

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) point: vec3f,
    @location(1) normal: vec3f,
    @location(2) color: vec3f,
    // Above zero in triangles of which a corner is hidden.
    @location(3) hidden: f32,
}

@vertex
fn corner(@builtin(vertex_index) index: u32) -> Corner {
    let sample = geometry[index];
    let point = position_of(sample);
    var out: Corner;
    out.position = frame.projection * vec4f(point, 1.0);
    out.point = point;
    out.normal = normal_of(sample);
    out.color = color_of(look[index]);
    out.hidden = select(0.0, 1.0, sample.w == HIDDEN);
    return out;
}

struct Seen {
    @location(0) color: vec4f,
    @location(1) normal: vec4f,
    @location(2) depth: vec4f,
}

@fragment
fn pixel(in: Corner, @builtin(front_facing) front: bool) -> Seen {
    var derived = cross(dpdy(in.point), dpdx(in.point));
    if in.hidden > 0.0 || (!front && (frame.flags & ONE_SIDED) != 0u) || is_clipped(in.point) {
        discard;
    }
    derived = select(derived, -derived, dot(derived, in.point) > 0.0);
    var normal = in.normal;
    if dot(normal, normal) < 1e-6 {
        normal = derived;
    }
    // The side that is seen, as the triangle lies: a normal may lean a little behind the silhouette.
    normal = select(normal, -normal, !front);
    normal = normal / max(length(normal), 1e-12);
    let color = select(inside(in.color), in.color, front);
    return Seen(vec4f(color, 1.0), vec4f(normal, 1.0), vec4f(max(-in.point.z, 1e-9)));
}
