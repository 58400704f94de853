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
        let color = select(frame.clay.rgb, own, (frame.flags & (OWN_COLORS | CLIP)) != 0u);
        let normal = textureLoad(normals, at, 0).xyz;
        let eye = to_eye(point_at(position.xy, depth));
        let which = frame.flags >> LIGHT;
        if which == 0u {
            light = lit(color, normal, eye, occlusion(at, depth));
        } else {
            light = lit_by_ball(which, color, normal, eye, occlusion(at, depth));
        }
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
    let even = mix(frame.background_top.rgb, frame.background_bottom.rgb, pixel.y / frame.size.y);
    return even + select(0.0, noise / 255.0, any(frame.background_top != frame.background_bottom));
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

// As a ball before the eye looks where it is turned alike: `Matcap` in view.rs.
fn lit_by_ball(which: u32, color: vec3f, normal: vec3f, eye: vec3f, occlusion: f32) -> vec3f {
    // Beside the middle of the picture the eye looks aside; the ball is turned with it.
    let right = normalize(cross(vec3f(0.0, 1.0, 0.0), eye));
    let n = vec3f(dot(normal, right), dot(normal, cross(eye, right)), clamp(dot(normal, eye), 0.0, 1.0));
    let mirrored = vec3f(2.0 * n.z * n.xy, 2.0 * n.z * n.z - 1.0);
    let lamp = normalize(vec3f(-0.42, 0.62, 0.66));
    let facing = dot(n, lamp);
    let rim = pow(1.0 - n.z, 4.0);
    switch which {
        case 1u: {
            let soft = 0.30 + 1.05 * pow(max(0.5 + 0.5 * facing, 0.0), 2.2);
            let gloss = 0.42 * smoothstep(0.86, 0.94, dot(mirrored, lamp)) + 0.22 * rim * (0.5 + 0.5 * n.y);
            return color * soft * occlusion + gloss * occlusion;
        }
        case 2u: {
            let sky = mix(1.25, 0.30, clamp(mirrored.y, 0.0, 1.0));
            let floor = mix(0.42, 0.05, sqrt(clamp(-mirrored.y, 0.0, 1.0)));
            let around = mix(floor, sky, smoothstep(-0.06, 0.06, mirrored.y));
            return color * (1.55 * around + 0.35 * rim) * (0.4 + 0.6 * occlusion)
                + 0.8 * smoothstep(0.90, 0.97, dot(mirrored, lamp)) * occlusion;
        }
        case 3u: {
            let t = smoothstep(0.0, 1.0, 0.5 + 0.5 * facing);
            let warm = mix(vec3f(0.14, 0.035, 0.025), vec3f(1.50, 0.82, 0.62), t);
            let gloss = 0.28 * pow(max(dot(mirrored, lamp), 0.0), 18.0) + 0.10 * rim;
            return (color * warm + gloss * vec3f(1.0, 0.85, 0.8)) * (0.25 + 0.75 * occlusion);
        }
        default: {
            let stripe = smoothstep(-0.3, 0.3, sin(14.0 * asin(clamp(mirrored.y, -1.0, 1.0))));
            return color * mix(0.06, 1.35, stripe) * (0.6 + 0.4 * n.z);
        }
    }
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
