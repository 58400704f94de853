// How much light of the surroundings gets to the surface, for a quarter of the pixels: what rises above the tangent
// plane nearby takes some away.

const SAMPLES = 14u;
// Side of the square of neighbours that share the work; shade.wgsl averages over it.
const TILE = 4u;

@group(1) @binding(0) var normals: texture_2d<f32>;
@group(1) @binding(1) var depths: texture_2d<f32>;

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4f {
    return whole_picture(vertex);
}

// The light, from 0 to 1, and the depth.
@fragment
fn pixel(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let at = 2u * vec2u(position.xy);
    let depth = textureLoad(depths, at, 0).r;
    if depth <= 0.0 {
        return vec4f(1.0, 0.0, 0.0, 0.0);
    }
    let middle = vec2f(at) + 0.5;
    let here = point_at(middle, depth);
    let normal = textureLoad(normals, at, 0).xyz;
    let pixels = clamp(frame.reach / pixel_at(depth), 2.0, 400.0);
    // Neighbours in the tile get turns that differ much.
    let tile = vec2u(position.xy) % TILE;
    let turn = f32((tile.x * 5u + tile.y * 7u) % (TILE * TILE));
    var sum = 0.0;
    for (var i = 0u; i < SAMPLES; i++) {
        let t = (f32(i) + (turn + 0.5) / f32(TILE * TILE)) / f32(SAMPLES);
        let angle = 6.2831853 * (t * 7.0 + turn * 0.618034);
        // Dense in the middle: engraving and edges are small.
        let there = middle + (1.0 + pixels * t * t) * vec2f(cos(angle), sin(angle));
        if any(there < vec2f(0.0)) || any(there >= frame.size) {
            continue;
        }
        let behind = textureLoad(depths, vec2u(there), 0).r;
        if behind <= 0.0 {
            continue;
        }
        let way = point_at(floor(there) + 0.5, behind) - here;
        let distance = length(way);
        if distance > 0.0 {
            // What is far away in depth hides nothing here.
            let near = max(1.0 - distance / (1.5 * frame.reach), 0.0);
            sum += max(dot(normal, way) / distance - 0.06, 0.0) * near;
        }
    }
    return vec4f(clamp(1.0 - 2.2 * sum / f32(SAMPLES), 0.0, 1.0), depth, 0.0, 0.0);
}
