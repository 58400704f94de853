//! The energies of a deformation that papers tell: as rigid as possible (O. Sorkine, M. Alexa,
//! *As-rigid-as-possible surface modeling*, SGP 2007, with the spokes and rims of I. Chao, U. Pinkall, P.
//! Sanan, P. Schröder, *A simple geometric model for elastic deformations*, TOG 2010), and symmetric
//! Dirichlet (J. Smith, S. Schaefer, *Bijective parameterization with free boundaries*, TOG 2015); and how
//! lengths, areas and distortions are spread.
//!
//! Energies are means over the area at rest, so that they have no unit and meshes of any fineness compare: a
//! mesh that is only moved and turned has 0 and 4.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::Serialize;
use simod_geometry::{horn_matrix, nearest_rotation, outer};

use super::triangle::{Edges, corners, cross};

/// The energies of a deformed mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Energies {
    /// Energy of as-rigid-as-possible deformation, with spokes and rims: the squared distance of each
    /// triangle's gradient from the rotations that fit best about its corners.
    pub arap: f64,
    /// Symmetric Dirichlet energy: σ₁² + σ₂² + σ₁⁻² + σ₂⁻² of each triangle's stretches, from 4 on, over the
    /// triangles that keep an area.
    pub symmetric_dirichlet: f64,
    /// The greatest symmetric Dirichlet energy of one triangle.
    pub symmetric_dirichlet_max: f64,
    /// Triangles of which no area is left, which would have an infinite one.
    pub collapsed: usize,
    /// Histograms of lengths, areas and distortions.
    pub histograms: Histograms,
}

/// Histograms of amounts over a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histograms {
    /// Histogram of edges, by the binary logarithm of their length over that at rest.
    pub edges: Bins,
    /// Histogram of triangles, by the binary logarithm of their area over that at rest.
    pub areas: Bins,
    /// Histogram of triangles, by the binary logarithm of their symmetric Dirichlet energy over its least,
    /// which is 4.
    pub distortion: Bins,
}

/// Counts between two numbers, in bins of equal width.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Bins {
    /// Lower end of the first bin.
    pub from: i32,
    /// Upper end of the last bin.
    pub to: i32,
    /// The number of values below the first bin.
    pub below: usize,
    /// Number of values in each bin.
    pub counts: Vec<usize>,
    /// Number of values above the last bin, or infinite.
    pub above: usize,
}

impl Bins {
    /// Bins for each unit.
    const FINE: usize = 20;

    fn new(from: i32, to: i32) -> Self {
        let counts = vec![0; (to - from) as usize * Self::FINE];
        Self { from, to, below: 0, counts, above: 0 }
    }

    fn add(&mut self, x: f64) {
        let bin = ((x - f64::from(self.from)) * Self::FINE as f64).floor();
        if bin < 0.0 {
            self.below += 1;
        } else if let Some(count) = self.counts.get_mut(bin as usize) {
            *count += 1;
        } else {
            self.above += 1;
        }
    }
}

impl Energies {
    /// Energies of triangles between positions at rest and deformed ones, and their edges. Triangles without
    /// an area at rest, and edges without a length, do not count.
    pub fn between(rest: &[DVec3], deformed: &[DVec3], (triangles, edges): (&[[u32; 3]], &Edges)) -> Self {
        let both = |t: &[u32; 3]| Some((*t, corners(rest, *t)?, corners(deformed, *t)?));
        let all: Vec<BothTriangles> = triangles
            .iter()
            .filter_map(both)
            .filter(|(_, before, _)| cross(*before).length_squared() > 0.0)
            .collect();
        let mut histograms =
            Histograms { edges: Bins::new(-2, 2), areas: Bins::new(-4, 4), distortion: Bins::new(0, 4) };
        let (mut covariances, mut area) = (vec![DMat3::ZERO; rest.len()], 0.0);
        let (mut dirichlet, mut dirichlet_max, mut kept, mut collapsed) = (0.0, 0.0f64, 0.0, 0);
        for (triangle, before, after) in &all {
            let size = 0.5 * cross(*before).length();
            area += size;
            let (mut stretches, mut covariance) = (0.0, DMat3::ZERO);
            for ((e, f), weight) in sides(before).into_iter().zip(sides(after)).zip(weights(before)) {
                stretches += weight * f.length_squared();
                covariance += outer(f * weight, e);
            }
            triangle.iter().for_each(|i| covariances[*i as usize] += covariance);
            // The squares of both stretches together, and their product.
            let (squares, ratio) = (stretches / size, 0.5 * cross(*after).length() / size);
            let energy = squares * (1.0 + 1.0 / (ratio * ratio));
            histograms.areas.add(ratio.log2());
            histograms.distortion.add((energy / 4.0).log2().max(0.0));
            if energy.is_finite() {
                dirichlet += size * energy;
                dirichlet_max = dirichlet_max.max(energy);
                kept += size;
            } else {
                collapsed += 1;
            }
        }
        for [before, after] in edges.lengths(rest, deformed) {
            histograms.edges.add((after / before).log2());
        }
        let mean = |sum: f64, of: f64| if of > 0.0 { sum / of } else { 0.0 };
        Self {
            // Each triangle is about three corners.
            arap: mean(as_rigid_as_possible(&all, &covariances) / 3.0, area),
            symmetric_dirichlet: mean(dirichlet, kept),
            symmetric_dirichlet_max: dirichlet_max,
            collapsed,
            histograms,
        }
    }
}

/// A triangle's vertices, and its corners at rest and deformed.
type BothTriangles = ([u32; 3], [DVec3; 3], [DVec3; 3]);

/// Energy with spokes and rims of all triangles, about each of their corners: the squared distance of the
/// triangles' gradients from the rotation that fits best there, where `covariances` determine one.
fn as_rigid_as_possible(all: &[BothTriangles], covariances: &[DMat3]) -> f64 {
    let rotations: Vec<DMat3> = covariances.par_iter().map(rotation).collect();
    let energy = |(triangle, before, after): &BothTriangles| {
        let about = |i: &u32| {
            let rotation = rotations[*i as usize];
            let off = sides(before).into_iter().zip(sides(after)).zip(weights(before));
            off.map(|((e, f), weight)| weight * (f - rotation * e).length_squared()).sum::<f64>()
        };
        triangle.iter().map(about).sum::<f64>()
    };
    // Summed up in pieces of one size, so that the sum does not depend on the threads.
    let sums: Vec<f64> = all.par_chunks(1 << 12).map(|some| some.iter().map(energy).sum()).collect();
    sums.into_iter().sum()
}

/// The sides of a triangle, each opposite to the corner of its number.
fn sides([a, b, c]: &[DVec3; 3]) -> [DVec3; 3] {
    [*c - *b, *a - *c, *b - *a]
}

/// Half the cotangents of the angles: with these, squared lengths of sides add up to the area times the
/// squared norm of what maps them.
fn weights(triangle: &[DVec3; 3]) -> [f64; 3] {
    let double = cross(*triangle).length();
    let [a, b, c] = sides(triangle);
    [-b.dot(c), -c.dot(a), -a.dot(b)].map(|along| 0.5 * along / double)
}

/// The rotation R for which the trace of Rᵀ times the matrix is the greatest: the eigenvector of the greatest
/// eigenvalue of a symmetric matrix is its quaternion (B. K. P. Horn, *Closed-form solution of absolute
/// orientation using unit quaternions*, J. Opt. Soc. Am. A 1987). The identity where the matrix tells
/// nothing.
fn rotation(m: &DMat3) -> DMat3 {
    let rotation = match quickly(m, &horn_matrix(*m)) {
        Some([w, x, y, z]) => DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w)),
        None => nearest_rotation(*m).0,
    };
    if rotation.is_finite() { rotation } else { DMat3::IDENTITY }
}

/// The eigenvector of the greatest eigenvalue of a matrix whose characteristic polynomial follows from `m`
/// (D. L. Theobald, *Rapid calculation of RMSDs using a quaternion-based characteristic polynomial*, Acta
/// Cryst. A 2005): a row of the adjugate. Nothing where another eigenvalue is nearly as great.
fn quickly(m: &DMat3, matrix: &[[f64; 4]; 4]) -> Option<[f64; 4]> {
    const STEPS: usize = 50;
    const APART: f64 = 1e-4;
    let squares: f64 = m.to_cols_array().iter().map(|x| x * x).sum();
    let size = squares.sqrt();
    let (linear, constant) = (-8.0 * m.determinant(), determinant(matrix));
    // The start is above the greatest root, so that Newton's steps descend to it.
    let mut greatest = 3f64.sqrt() * size;
    let mut slope = 0.0;
    for _ in 0..STEPS {
        let square = greatest * greatest;
        let value = (square - 2.0 * squares) * square + linear * greatest + constant;
        slope = 4.0 * greatest * (square - squares) + linear;
        let step = value / slope;
        greatest -= step;
        if step.is_nan() || step.abs() <= 1e-15 * greatest {
            break;
        }
    }
    // The slope is the product of the greatest eigenvalue's distances from the others, which the lengths of
    // the adjugate's rows are proportional to.
    if slope.is_nan() || slope <= APART * size * squares {
        return None;
    }
    let mut shifted = *matrix;
    (0..4).for_each(|i| shifted[i][i] -= greatest);
    let rows = (0..4).map(|i| cofactors(&shifted, i));
    let row = rows.into_iter().find(|row| row.iter().map(|x| x * x).sum::<f64>().sqrt() >= 0.45 * slope)?;
    let length = row.iter().map(|x| x * x).sum::<f64>().sqrt();
    Some(row.map(|x| x / length))
}

/// The cofactors of a row.
fn cofactors(m: &[[f64; 4]; 4], row: usize) -> [f64; 4] {
    let [a, b, c] = [(row + 1) % 4, (row + 2) % 4, (row + 3) % 4].map(|i| m[i]);
    // The three others in a circle, which is as good as in order.
    std::array::from_fn(|column| {
        let [i, j, k] = [(column + 1) % 4, (column + 2) % 4, (column + 3) % 4];
        let minor = a[i] * (b[j] * c[k] - b[k] * c[j]) - a[j] * (b[i] * c[k] - b[k] * c[i])
            + a[k] * (b[i] * c[j] - b[j] * c[i]);
        if (row + column).is_multiple_of(2) { minor } else { -minor }
    })
}

fn determinant(m: &[[f64; 4]; 4]) -> f64 {
    cofactors(m, 0).iter().zip(m[0]).map(|(minor, x)| minor * x).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn energies(rest: &[DVec3], deformed: &[DVec3], triangles: &[[u32; 3]]) -> Energies {
        Energies::between(rest, deformed, (triangles, &Edges::from_triangles(rest, triangles)))
    }

    /// A rolled sheet.
    fn sheet() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        const STEPS: u32 = 30;
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        for (i, k) in (0..=STEPS).flat_map(|i| (0..=STEPS).map(move |k| (i, k))) {
            let [s, t] = [i, k].map(|n| f64::from(n) / f64::from(STEPS));
            points.push(DVec3::new((2.0 * s).sin(), t, (2.0 * s).cos() + 0.1 * (7.0 * t).sin()));
            if i < STEPS && k < STEPS {
                let a = i * (STEPS + 1) + k;
                triangles.extend([[a, a + 1, a + STEPS + 1], [a + 1, a + STEPS + 2, a + STEPS + 1]]);
            }
        }
        (points, triangles)
    }

    #[test]
    fn eigenvectors_are_those_of_jacobi_or_left_to_it() {
        let number = |i: u32, k: f64| (f64::from(i) * k).sin();
        let mut found = 0;
        for i in 0..2000 {
            let columns =
                [1.7, 2.9, 5.3].map(|k| DVec3::new(number(i, k), number(i, 1.3 * k), number(i, 2.1 * k)));
            let scale = 10f64.powi(i as i32 % 40 - 20);
            // Some matrices have no third singular value above zero, and some not even a second one.
            let m = match i % 5 {
                0 => outer(columns[0], columns[1]) + outer(columns[2], columns[0]),
                1 => outer(columns[0], columns[1]),
                2 => DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
                _ => DMat3::from_cols(columns[0], columns[1], columns[2]),
            } * scale;
            let Some(quick) = quickly(&m, &horn_matrix(m)) else { continue };
            let [w, x, y, z] = quick;
            let along = DQuat::from_xyzw(x, y, z, w).dot(DQuat::from_mat3(&nearest_rotation(m).0));
            assert!((along.abs() - 1.0).abs() < 1e-12, "{m}: {quick:?}");
            found += 1;
        }
        assert!(found > 1000, "{found}");
        // Matrices that determine no rotation give none.
        let nothing = DMat3::ZERO;
        assert_eq!(quickly(&nothing, &horn_matrix(nothing)), None);
        let mirror = DMat3::from_diagonal(DVec3::splat(-1.0));
        assert_eq!(quickly(&mirror, &horn_matrix(mirror)), None);
        assert_eq!(quickly(&DMat3::NAN, &horn_matrix(DMat3::NAN)), None);
    }

    #[test]
    fn a_rigid_motion_costs_nothing() {
        let (rest, triangles) = sheet();
        for (axis, angle) in [(DVec3::X, 0.0), (DVec3::new(0.48, 0.6, 0.64), 2.9), (DVec3::Y, 3.1)] {
            let turn = DQuat::from_axis_angle(axis, angle);
            let moved: Vec<_> = rest.iter().map(|p| turn * *p + DVec3::new(1.0, 2.0, 3.0)).collect();
            let found = energies(&rest, &moved, &triangles);
            assert!(found.arap.abs() < 1e-20, "{found:?}");
            assert!((found.symmetric_dirichlet - 4.0).abs() < 1e-9, "{found:?}");
            assert_eq!((found.collapsed, found.histograms.edges.above), (0, 0));
        }
        // A mirror image of a flat sheet is that sheet turned over; of a curved one it is not.
        let mirrored: Vec<_> = rest.iter().map(|p| p.with_z(-p.z)).collect();
        assert!(energies(&rest, &mirrored, &triangles).arap > 1e-3);
        let flat: Vec<_> = rest.iter().map(|p| p.with_z(0.3 * p.x)).collect();
        let mirrored: Vec<_> = flat.iter().map(|p| p.with_z(-p.z)).collect();
        assert!(energies(&flat, &mirrored, &triangles).arap < 1e-20);
    }

    #[test]
    fn scales_and_stretches_cost_what_the_formulas_say() {
        let (rest, triangles) = sheet();
        for scale in [0.5, 1.25, 3.0] {
            let scaled: Vec<_> = rest.iter().map(|p| *p * scale).collect();
            let found = energies(&rest, &scaled, &triangles);
            let (arap, dirichlet) =
                (2.0 * (scale - 1.0f64).powi(2), 2.0 * (scale * scale + 1.0 / (scale * scale)));
            assert!((found.arap / arap - 1.0).abs() < 1e-9, "{} instead of {arap}", found.arap);
            assert!((found.symmetric_dirichlet / dirichlet - 1.0).abs() < 1e-9);
            assert!((found.symmetric_dirichlet_max / dirichlet - 1.0).abs() < 1e-9);
            let bins = found.histograms.edges;
            let total: usize = bins.counts.iter().sum::<usize>() + bins.below + bins.above;
            let fullest = bins.counts.iter().enumerate().max_by_key(|(_, n)| **n).unwrap();
            let at = f64::from(bins.from) + (fullest.0 as f64 + 0.5) / Bins::FINE as f64;
            assert!(*fullest.1 == total && (at - scale.log2()).abs() <= 0.5 / Bins::FINE as f64 + 1e-9);
        }
        // The nearest rotation of a flat sheet that is stretched one way is the identity.
        let flat: Vec<_> = rest.iter().map(|p| p.with_z(0.0)).collect();
        let wide: Vec<_> = flat.iter().map(|p| p.with_x(2.0 * p.x)).collect();
        let found = energies(&flat, &wide, &triangles);
        assert!(
            (found.arap - 1.0).abs() < 1e-9 && (found.symmetric_dirichlet - 6.25).abs() < 1e-9,
            "{found:?}"
        );
        // Triangles of a sheet that is pressed together collapse, and are counted.
        let gone: Vec<_> = flat.iter().map(|p| p.with_x(0.0)).collect();
        let found = energies(&flat, &gone, &triangles);
        assert!(found.collapsed > 1000 && found.symmetric_dirichlet_max.is_finite(), "{found:?}");
        let nothing = energies(&[], &[], &triangles);
        assert_eq!((nothing.arap, nothing.symmetric_dirichlet), (0.0, 0.0));
    }
}
