//! The volume that triangles enclose.

use glam::DVec3;

/// Number of steps by which a volume is brought back; each leaves a small part of the error.
const STEPS: usize = 4;

/// Whether each edge has a triangle on either side, in the same sense: whether there is a volume.
pub fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let of = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(of).collect();
    edges.sort_unstable();
    let is_single = edges.windows(2).all(|pair| pair[0] != pair[1]);
    is_single && !edges.is_empty() && edges.iter().all(|[a, b]| edges.binary_search(&[*b, *a]).is_ok())
}

/// The volume that closed triangles enclose.
pub fn volume(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    let origin = positions.first().copied().unwrap_or_default();
    let part = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|c| positions[c as usize] - origin);
        a.dot(b.cross(c)) / 6.0
    };
    triangles.iter().map(part).sum()
}

/// Moves vertices along the normals, all by one distance times their freedom, until the volume is the given
/// one.
pub fn bring_back(positions: &mut [DVec3], triangles: &[[u32; 3]], freedom: &[f64], goal: f64) {
    for _ in 0..STEPS {
        let mut normals = vec![DVec3::ZERO; positions.len()];
        for t in triangles {
            let [a, b, c] = t.map(|c| positions[c as usize]);
            let area = (b - a).cross(c - a) / 6.0;
            t.iter().for_each(|c| normals[*c as usize] += area);
        }
        // The volume grows with the distance by this factor.
        let growth: f64 = normals.iter().zip(freedom).map(|(n, f)| f * n.length()).sum();
        if growth <= 0.0 {
            return;
        }
        let distance = (goal - volume(positions, triangles)) / growth;
        for ((p, n), f) in positions.iter_mut().zip(normals).zip(freedom) {
            *p += *f * distance * n.normalize_or_zero();
        }
    }
}
