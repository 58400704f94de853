// Light: from the surface that is seen to colours; the ghost over it or under it.

// Side of the square of occlusion samples that is averaged: occlusion.wgsl's tile.
const TILE = 4;

@group(1) @binding(0) var colors: texture_2d<f32>;
@group(1) @binding(1) var normals: texture_2d<f32>;
@group(1) @binding(2) var depths: texture_2d<f32>;
@group(1) @binding(3) var occlusions: texture_2d<f32>;
@group(1) @binding(4) var ghost_normals: texture_2d<f32>;
@group(1) @binding(5) var ghost_depths: texture_2d<f32>;

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4f {
    return whole_picture(vertex);
}

@fragment
fn pixel(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let at = vec2u(position.xy);
    let depth = textureLoad(depths, at, 0).r;
    var ghost = 0.0;
    if (frame.flags & GHOST) != 0u {
        ghost = textureLoad(ghost_depths, at, 0).r;
    }
    let paper = background(position.xy);
    if depth <= 0.0 && ghost <= 0.0 {
        return vec4f(paper, 1.0);
    }
    var light = linear_of(paper);
    if depth > 0.0 {
        let own = linear_of(textureLoad(colors, at, 0).rgb);
        let color = select(frame.clay.rgb, own, (frame.flags & OWN_COLORS) != 0u);
        let normal = textureLoad(normals, at, 0).xyz;
        light = lit(color, normal, to_eye(point_at(position.xy, depth)), occlusion(at, depth));
    }
    if ghost > 0.0 {
        light = with_ghost(light, position.xy, depth, ghost);
    }
    return vec4f(srgb_of(rolled_off(light)), 1.0);
}

// From above to below, in sRGB; the noise (J. Jimenez, "Next Generation Post Processing in Call of Duty", SIGGRAPH
// courses, 2014) is below what a byte tells apart, and breaks up its steps.
fn background(pixel: vec2f) -> vec3f {
    let noise = fract(52.9829189 * fract(dot(pixel, vec2f(0.06711056, 0.00583715)))) - 0.5;
    return mix(frame.background_top.rgb, frame.background_bottom.rgb, pixel.y / frame.size.y) + noise / 255.0;
}

// The mean over the tile around a pixel, of what lies on its surface.
fn occlusion(at: vec2u, depth: f32) -> f32 {
    if (frame.flags & OCCLUSION) == 0u {
        return 1.0;
    }
    // Within a tile, a slanted surface changes its depth by no more than this.
    let limit = pixel_at(depth) * 8.0 * f32(TILE);
    let last = vec2i(textureDimensions(occlusions)) - 1;
    let first = (vec2i(at) - TILE + 1) / 2;
    var sum = vec2f(0.0);
    for (var y = 0; y < TILE; y++) {
        for (var x = 0; x < TILE; x++) {
            let value = textureLoad(occlusions, clamp(first + vec2i(x, y), vec2i(0), last), 0).rg;
            sum += vec2f(value.r, 1.0) * max(1.0 - abs(value.g - depth) / limit, 0.0);
        }
    }
    return select(1.0, sum.x / max(sum.y, 1e-6), sum.y > 1e-3);
}

// Key, fill, surroundings from above and below, and a broad highlight.
fn lit(color: vec3f, normal: vec3f, eye: vec3f, occlusion: f32) -> vec3f {
    let key = max(dot(normal, frame.key.xyz), 0.0);
    let fill = max(dot(normal, frame.fill.xyz), 0.0);
    let sky = 0.5 + 0.5 * normal.y;
    let ambient = (vec3f(0.20, 0.19, 0.18) + vec3f(0.17, 0.18, 0.20) * sky) * occlusion;
    // Crevices see less of the lamps, too, as these are wide.
    let lamps = 0.35 + 0.65 * occlusion;
    let light = ambient + (vec3f(1.02, 0.98, 0.92) * frame.key.w * key + vec3f(0.17, 0.19, 0.23) * fill) * lamps;

    let halfway = normalize(frame.key.xyz + eye);
    let highlight = pow(max(dot(normal, halfway), 0.0), 40.0) * 0.10 * key * occlusion;
    let rim = pow(1.0 - clamp(dot(normal, eye), 0.0, 1.0), 4.0) * 0.10 * occlusion;
    return color * light + highlight + rim * sky;
}

// The ghost in front of the surface, or fainter through it; not where the two are one.
fn with_ghost(light: vec3f, pixel: vec2f, depth: f32, ghost: f32) -> vec3f {
    let normal = textureLoad(ghost_normals, vec2u(pixel), 0).xyz;
    let facing = clamp(dot(normal, to_eye(point_at(pixel, ghost))), 0.0, 1.0);
    // As glass: clearer where it is seen from the front.
    var opacity = frame.ghost_opacity * mix(1.0, 0.6, facing);
    if depth > 0.0 {
        let apart = (depth - ghost) / frame.reach;
        opacity *= select(0.3 * smoothstep(0.1, 0.4, -apart), smoothstep(0.05, 0.25, apart), apart > 0.0);
    }
    return mix(light, frame.ghost_color.rgb * (0.4 + 0.8 * max(dot(normal, frame.key.xyz), 0.0)), opacity);
}

// The brightest parts are rolled off instead of cut.
fn rolled_off(x: vec3f) -> vec3f {
    const KNEE = 0.8;
    return select(x, 1.0 - (1.0 - KNEE) * exp(-(x - KNEE) / (1.0 - KNEE)), x > vec3f(KNEE));
}
