//! Transfer by projected barycentric coordinates, the method of the paper's §5: the vertex is split into a
//! point of the average plane H and an offset along its normal, the former is expressed in a triangle of
//! three samples projected on H (W. Heidrich, *Computing the Barycentric Coordinates of a Projected Point*,
//! 2005), and both are put together again on the deformed side: p* = T'*·B + d·(r*/r)·n*.
//!
//! Three guards are ours. A triangle must be well shaped and not leave the vertex far outside, or coordinates
//! and circumradii explode. The change of scale r*/r stays within the changes of the triangle's edges,
//! between which it lies for any similarity. H* is taken over the images of the samples that gave H: a search
//! among the deformed samples would catch sheets that came near.

use glam::{Mat3, Vec3};

use super::neighbourhood::{MAX_K, Neighbourhood};
use super::{DeformationField, Transport};

/// Samples in a neighbourhood (k in the paper, which uses 10 to 30).
pub const NEIGHBOURS: usize = 12;

/// Half the opening of the cone with the solid angle 2π/3 that a neighbour discards: 2π(1 − cos θ) = 2π/3.
const CONE: f32 = 0.841_068_7;

/// Number of halvings of the cone's angle before giving up.
const ROUNDS: i32 = 4;

/// Least doubled area of the projected triangle, over its longest edge squared (√3/2 if equilateral).
const MIN_SHAPE: f32 = 0.25;

/// Least barycentric coordinate: the distance outside the triangle that a vertex may lie.
const MIN_COORDINATE: f32 = -0.25;

/// Carries a vertex over. Expansions stand in where no triangle of samples is fit to be used, as outside an
/// open boundary.
pub fn carry(field: &DeformationField, home: usize, p: Vec3) -> Transport {
    let around = Neighbourhood::gather(field.around, home, NEIGHBOURS, p);
    over_triangle(field, &around, p).unwrap_or_else(|| field.beyond(home, p))
}

fn over_triangle(field: &DeformationField, around: &Neighbourhood, p: Vec3) -> Option<Transport> {
    let samples = field.around.samples;
    let (rest, deformed) = (&samples.positions, field.deformed);
    let plane = average_plane(around, rest, samples.normals())?;
    let plane_star = average_plane(around, deformed, &field.gradients.normal)?;
    let d = (p - plane.center).dot(plane.normal);
    let flat = p - d * plane.normal;

    let (corners, b) = vote(around, rest, plane.normal, flat)?;
    let t = corners.map(|i| rest[i as usize]);
    let t_star = corners.map(|i| deformed[i as usize]);
    let scale = scale_change(t, t_star);

    let projected = t.map(|q| q - (q - plane.center).dot(plane.normal) * plane.normal);
    let projected_star =
        t_star.map(|q| q - (q - plane_star.center).dot(plane_star.normal) * plane_star.normal);
    let flat_star = projected_star[0] * b[0] + projected_star[1] * b[1] + projected_star[2] * b[2];
    let displacement = (flat_star + d * scale * plane_star.normal) - p;

    // The map's gradient with T and H held: the triangle's edges to their images, n to its scaled image.
    let basis = |q: [Vec3; 3], n: Vec3| Mat3::from_cols(q[1] - q[0], q[2] - q[0], n);
    let gradient =
        basis(projected_star, scale * plane_star.normal) * basis(projected, plane.normal).inverse();
    (displacement.is_finite() && gradient.is_finite()).then_some(Transport { displacement, gradient })
}

/// The average plane H.
struct AveragePlane {
    center: Vec3,
    normal: Vec3,
}

/// H by a partition of unity: the neighbours' positions and normals, weighted by the kernel.
fn average_plane(around: &Neighbourhood, positions: &[Vec3], normals: &[Vec3]) -> Option<AveragePlane> {
    let (mut center, mut normal, mut sum) = (Vec3::ZERO, Vec3::ZERO, 0.0);
    // About the nearest sample, for precision.
    let origin = positions[around.weighted()[0].0 as usize];
    for &(i, w) in around.weighted() {
        center += w * (positions[i as usize] - origin);
        normal += w * normals[i as usize];
        sum += w;
    }
    Some(AveragePlane { center: origin + center / sum, normal: normal.try_normalize()? })
}

/// Angular voting: the nearest sample, the next one outside its cone, and the next one outside both cones,
/// such that the triangle passes the guards; with the coordinates of `flat` in the triangle projected along
/// `n`.
fn vote(around: &Neighbourhood, rest: &[Vec3], n: Vec3, flat: Vec3) -> Option<([u32; 3], [f32; 3])> {
    let near = around.weighted();
    let position = |m: usize| rest[near[m].0 as usize];
    let mut directions = [Vec3::ZERO; MAX_K];
    for (m, direction) in directions.iter_mut().enumerate().take(near.len()) {
        let offset = position(m) - flat;
        *direction = (offset - offset.dot(n) * n).normalize_or_zero();
    }
    for round in 0..ROUNDS {
        let cosine = (CONE / (1 << round) as f32).cos();
        let outside = |a: usize, b: usize| directions[a].dot(directions[b]) < cosine;
        for j in 1..near.len() {
            if !outside(0, j) {
                continue;
            }
            for k in j + 1..near.len() {
                if outside(0, k)
                    && outside(j, k)
                    && let Some(b) = coordinates([position(0), position(j), position(k)], n, flat)
                {
                    return Some(([near[0].0, near[j].0, near[k].0], b));
                }
            }
        }
    }
    None
}

/// Barycentric coordinates of `p` in the triangle, both projected along `n`; `None` if the guards refuse it.
fn coordinates(t: [Vec3; 3], n: Vec3, p: Vec3) -> Option<[f32; 3]> {
    let (u, v, w) = (t[1] - t[0], t[2] - t[0], p - t[0]);
    let area = u.cross(v).dot(n);
    let flat = |e: Vec3| e.length_squared() - e.dot(n) * e.dot(n);
    let longest = flat(u).max(flat(v)).max(flat(v - u));
    // Written so that NaN is refused.
    if !(area.abs() >= MIN_SHAPE * longest && longest > 0.0) {
        return None;
    }
    let (b1, b2) = (w.cross(v).dot(n) / area, u.cross(w).dot(n) / area);
    let b = [1.0 - b1 - b2, b1, b2];
    b.iter().all(|x| *x >= MIN_COORDINATE).then_some(b)
}

/// r*/r, the ratio of the circumradii, held between the least and the greatest ratio of edges.
fn scale_change(t: [Vec3; 3], t_star: [Vec3; 3]) -> f32 {
    let edges = |t: [Vec3; 3]| [t[0].distance(t[1]), t[1].distance(t[2]), t[2].distance(t[0])];
    let area = |t: [Vec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]).length();
    let (e, e_star) = (edges(t), edges(t_star));
    let ratios = [e_star[0] / e[0], e_star[1] / e[1], e_star[2] / e[2]];
    let low = ratios[0].min(ratios[1]).min(ratios[2]);
    let high = ratios[0].max(ratios[1]).max(ratios[2]);
    // Circumradius: product of the edges over four times the area.
    let ratio = ratios[0] * ratios[1] * ratios[2] * area(t) / area(t_star);
    if ratio.is_nan() { low } else { ratio.clamp(low, high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_reproduce_the_point_and_refuse_slivers() {
        let n = Vec3::Y;
        let t = [Vec3::new(0.0, 0.3, 0.0), Vec3::new(1.0, -0.2, 0.1), Vec3::new(0.2, 0.1, 0.9)];
        let p = Vec3::new(0.4, 5.0, 0.3);
        let b = coordinates(t, n, p).expect("inside");
        let q = t[0] * b[0] + t[1] * b[1] + t[2] * b[2];
        assert!((q - p).reject_from(n).length() < 1e-6);
        assert!(coordinates([Vec3::ZERO, Vec3::X, Vec3::X * 2.0 + Vec3::Z * 0.1], n, p).is_none());
        assert!(coordinates(t, n, Vec3::new(-3.0, 0.0, 0.0)).is_none());
        assert!(coordinates([Vec3::ONE; 3], n, Vec3::ONE).is_none());
    }

    #[test]
    fn scale_is_that_of_a_similarity_and_bounded_otherwise() {
        let t = [Vec3::ZERO, Vec3::X, Vec3::new(0.3, 0.0, 0.8)];
        assert!((scale_change(t, t.map(|q| q * 2.5)) - 2.5).abs() < 1e-5);
        // Crushed to a sliver: the circumradius ratio alone is 2500 here.
        let crushed = t.map(|q| q * Vec3::new(1.0, 1.0, 1e-4));
        assert!(scale_change(t, crushed) <= 1.0);
        assert_eq!(scale_change(t, [Vec3::ONE; 3]), 0.0);
    }
}
