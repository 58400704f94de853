//! Surfaces to bend.

use glam::DVec3;
use simod_plugin_api::Joint;

pub type Surface = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A closed tube between two points, with flat ends, of `around` samples around.
pub fn tube(from: DVec3, to: DVec3, radius: f64, around: usize) -> Surface {
    let axis = (to - from).try_normalize().unwrap();
    let (u, v) = axis.any_orthonormal_pair();
    let edge = std::f64::consts::TAU * radius / around as f64;
    let rings = (from.distance(to) / edge).round() as usize;
    let discs = (radius / edge).round() as usize;
    // The middle of one end, rings outwards, along, and inwards again.
    let mut profile: Vec<(f64, f64)> = (1..discs).map(|d| (d as f64 / discs as f64, 0.0)).collect();
    profile.extend((0..=rings).map(|r| (1.0, r as f64 / rings as f64)));
    profile.extend((1..discs).rev().map(|d| (d as f64 / discs as f64, 1.0)));
    let mut points = vec![from];
    for (wide, along) in &profile {
        for k in 0..around {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / around as f64).sin_cos();
            points.push(from.lerp(to, *along) + radius * wide * (cos * u + sin * v));
        }
    }
    points.push(to);
    let (last, at) = (points.len() - 1, |ring: usize, k: usize| 1 + ring * around + k % around);
    let mut triangles = Vec::new();
    for k in 0..around {
        triangles.push([0, at(0, k + 1), at(0, k)]);
        triangles.push([last, at(profile.len() - 1, k), at(profile.len() - 1, k + 1)]);
        for ring in 0..profile.len() - 1 {
            let [a, b, c, d] = [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let points = points.into_iter().map(|p| p.as_vec3().to_array()).collect();
    (points, triangles.into_iter().map(|t| t.map(|v| v as u32)).collect())
}

/// Several surfaces as one.
pub fn together(parts: &[Surface]) -> Surface {
    let (mut points, mut triangles): Surface = (Vec::new(), Vec::new());
    for (p, t) in parts {
        let first = points.len() as u32;
        points.extend(p);
        triangles.extend(t.iter().map(|t| t.map(|v| v + first)));
    }
    (points, triangles)
}

pub const LIMB: [(&str, [f64; 3], u32); 3] =
    [("upper", [-0.95, 0.0, 0.0], Joint::ROOT), ("lower", [0.0; 3], 0), ("tip", [0.95, 0.0, 0.0], 1)];

/// A straight limb along x, with a joint in the middle.
pub fn limb() -> Surface {
    tube(-DVec3::X, DVec3::X, 0.15, 40)
}

pub const FORK: [(&str, [f64; 3], u32); 7] = [
    ("root", [0.0, 0.1, 0.0], Joint::ROOT),
    ("a", [0.0, 0.0, 0.0], 0),
    ("a-middle", [0.6, 0.0, 0.0], 1),
    ("a-tip", [1.1, 0.0, 0.0], 2),
    ("b", [0.0, 0.2, 0.0], 0),
    ("b-middle", [0.6, 0.2, 0.0], 4),
    ("b-tip", [1.1, 0.2, 0.0], 5),
];

/// Two limbs beside each other, near in space and far along the surface; of three tubes that pass into each
/// other.
pub fn fork() -> Surface {
    let limb = |y: f64| tube(DVec3::new(-0.05, y, 0.0), DVec3::new(1.2, y, 0.0), 0.07, 24);
    together(&[limb(0.0), limb(0.2), tube(DVec3::new(0.0, -0.05, 0.0), DVec3::new(0.0, 0.25, 0.0), 0.08, 24)])
}
