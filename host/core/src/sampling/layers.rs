//! Layers of a cluster: sheets of a point cloud that lie one above the other and face the same way, or have
//! no normals, as those of cloth on skin, or of a wall that was scanned from both sides. Where there are
//! faces, they tell sheets apart instead (`touching`).
//!
//! Heights over the cluster's plane, less the quadratic surface that explains them best, are in two heaps
//! then. The heaps are parted at the height that leaves the least variance in them (N. Otsu, *A Threshold
//! Selection Method from Gray-Level Histograms*, 1979).

use glam::{DMat3, DVec3, Vec3, Vec3Swizzles};

use super::cluster::{Covariance, Element, Moments};
use super::random::mix;
use crate::geometry::{solve_positive_definite, symmetric_eigen};

/// Least number of elements that make two layers.
const LEAST: usize = 24;

/// Elements that heights are taken of, at most.
const MOST: usize = 512;

/// Divisor of the number of elements: each of two layers has at least this part of them.
const LEAST_PART: usize = 8;

/// Least ratio of the distance of layers to that of points in them: closer ones are a rough surface.
const APART: f64 = 1.5;

/// Part of the variance of the heights that the two layers explain; of heights that are spread evenly they
/// explain 3/4.
const EXPLAINED: f64 = 0.9;

/// The standard deviation of the heights of two layers, of which one may be as small as that, over their
/// distance, is no less.
const LEAST_DEVIATION: f64 = 0.33;

/// The height of a smooth patch (standard deviation) over the product of the deviation of its normals and its
/// own extent (rms): 0.29 for a disc of a sphere.
const BENT: f64 = 0.35;

/// Thickness, as a part of a cluster's lesser width, below which no layers are looked for: a cluster that
/// bends is told better by its parts.
const THIN: f64 = 1.0 / 16.0;

/// Strength of the ridge that holds the quadratic surface to a plane, relative to the number of elements.
const RIDGE: f64 = 1e-6;

/// Height of elements with normals along the mean of these, less that which the bend of a smooth patch
/// explains (standard deviation).
fn thickness(m: &Moments, covariance: DMat3) -> f64 {
    let (normal, bent) = (m.mean_normal(), BENT * m.deviation() * m.spread());
    (normal.dot(covariance * normal) - bent * bent).max(0.0).sqrt()
}

/// Two layers, and the height at which they are parted.
pub struct Layers {
    mean: Vec3,
    axes: [Vec3; 3],
    per_unit: f32,
    surface: [f32; 6],
    threshold: f32,
}

impl Layers {
    /// The layers of a cluster with these moments; `None` where it is one, as it mostly is.
    pub fn find<E: Element>(elements: &[E], m: &Moments, covariance: &Covariance, seed: u64) -> Option<Self> {
        if elements.len() < LEAST {
            return None;
        }
        let (covariance, least) = (covariance.matrix, covariance.least());
        let [thin, width, length] = deviations(covariance, least);
        // Most clusters have no layers, and end here.
        let thickness = if m.has_normals() { thickness(m, covariance) } else { thin };
        // An evenly filled rectangle of these deviations; half of the elements in it.
        let area = 12.0 * width * length;
        let apart = APART * (2.0 * area / elements.len() as f64).sqrt();
        if !(thickness > LEAST_DEVIATION * apart && thickness > THIN * width && width > 0.0) {
            return None;
        }
        let normal = if m.has_normals() { m.mean_normal() } else { symmetric_eigen(covariance).1.x_axis };
        if normal == DVec3::ZERO {
            return None;
        }
        let (u, v) = normal.any_orthonormal_pair();
        let mut layers = Self {
            mean: m.mean().as_vec3(),
            axes: [u, v, normal].map(|axis| axis.as_vec3()),
            per_unit: length.recip() as f32,
            surface: [0.0; 6],
            threshold: 0.0,
        };
        let chosen = |i: usize| {
            if elements.len() <= MOST {
                &elements[i]
            } else {
                &elements[mix(seed, i as u64) as usize % elements.len()]
            }
        };
        let places: Vec<[f32; 3]> = (0..elements.len().min(MOST)).map(|i| layers.place(chosen(i))).collect();
        layers.surface = quadratic(&places)?;
        let mut heights: Vec<f32> = places.iter().map(|place| layers.above_surface(*place)).collect();
        let squares = heights.iter().map(|h| f64::from(h * h)).sum::<f64>() / heights.len() as f64;
        if squares.sqrt() < LEAST_DEVIATION * apart * f64::from(layers.per_unit) {
            return None;
        }
        heights.sort_unstable_by(f32::total_cmp);
        let (threshold, distance, explained) = two_heaps(&heights)?;
        layers.threshold = threshold;
        let distance = distance / f64::from(layers.per_unit);
        (explained > EXPLAINED && distance > apart).then_some(layers)
    }

    /// Whether an element is in the upper layer.
    pub fn is_upper<E: Element>(&self, element: &E) -> bool {
        self.above_surface(self.place(element)) > self.threshold
    }

    /// Coordinates in the plane, and the height over it.
    fn place<E: Element>(&self, element: &E) -> [f32; 3] {
        let p = (element.position() - self.mean) * self.per_unit;
        self.axes.map(|axis| axis.dot(p))
    }

    fn above_surface(&self, place: [f32; 3]) -> f32 {
        place[2] - terms(place).iter().zip(self.surface).map(|(term, by)| term * by).sum::<f32>()
    }
}

/// Standard deviations along the principal axes, ascending, of which the least variance is known.
fn deviations(covariance: DMat3, least: f64) -> [f64; 3] {
    let diagonal = DVec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z);
    let off = DVec3::new(covariance.x_axis.y, covariance.y_axis.z, covariance.z_axis.x);
    // Sum and product of the other two, from the trace and the sum of the principal minors.
    let sum = diagonal.element_sum() - least;
    let product = diagonal.dot(diagonal.yzx()) - off.length_squared() - least * sum;
    let half = (0.25 * sum * sum - product).max(0.0).sqrt();
    [least, 0.5 * sum - half, 0.5 * sum + half].map(|value| value.max(0.0).sqrt())
}

fn terms([u, v, _]: [f32; 3]) -> [f32; 6] {
    [1.0, u, v, u * u, u * v, v * v]
}

/// The quadratic surface through heights, by least squares.
fn quadratic(places: &[[f32; 3]]) -> Option<[f32; 6]> {
    // The lower triangle is enough.
    let (mut a, mut b) = ([[0.0; 6]; 6], [DVec3::ZERO; 6]);
    for place in places {
        let terms = terms(*place).map(f64::from);
        for (i, (row, right)) in a.iter_mut().zip(&mut b).enumerate() {
            row.iter_mut().zip(&terms[..=i]).for_each(|(sum, term)| *sum += terms[i] * term);
            right.x += terms[i] * f64::from(place[2]);
        }
    }
    a.iter_mut().enumerate().for_each(|(i, row)| row[i] += RIDGE * places.len() as f64);
    solve_positive_definite(a, b).map(|x| x.map(|x| x.x as f32))
}

/// Height between two heaps of ascending heights, the distance of the heaps' means, and the part of the
/// variance that the heaps explain.
fn two_heaps(heights: &[f32]) -> Option<(f32, f64, f64)> {
    let n = heights.len() as f64;
    let sum = |heights: &[f32]| heights.iter().map(|h| f64::from(*h)).sum::<f64>();
    let mean = sum(heights) / n;
    let variance = heights.iter().map(|h| (f64::from(*h) - mean).powi(2)).sum::<f64>() / n;
    let least = heights.len().div_ceil(LEAST_PART);
    let mut below = sum(&heights[..least - 1]);
    let mut best: Option<(f32, f64, f64)> = None;
    for i in least..=heights.len() - least {
        below += f64::from(heights[i - 1]);
        let count = i as f64;
        let distance = (mean * n - below) / (n - count) - below / count;
        let explained = count * (n - count) / (n * n) * distance * distance / variance;
        if best.is_none_or(|(.., most)| explained > most) {
            best = Some((0.5 * (heights[i - 1] + heights[i]), distance, explained));
        }
    }
    best.filter(|(.., explained)| explained.is_finite())
}

#[cfg(test)]
mod tests {
    use super::super::cluster::Vertex;
    use super::*;
    use crate::geometry::least_eigenvalue;
    use proptest::prelude::*;

    /// Points of a sheet that bends, so far above it.
    fn sheet(count: u32, bend: f32, height: impl Fn(u32) -> f32, normal: bool) -> Vec<Vertex> {
        (0..count)
            .map(|i| {
                let (u, v) = (0.5 * noise(!i), i as f32 / count as f32 - 0.5);
                let n = Vec3::new(-2.0 * bend * u, -2.0 * bend * v, 1.0).normalize_or(Vec3::Z);
                let p = Vec3::new(u, v, bend * (u * u + v * v)) + n * height(i);
                Vertex {
                    position: p + Vec3::splat(0.3),
                    normal: if normal { n } else { Vec3::ZERO },
                    index: i,
                }
            })
            .collect()
    }

    /// Numbers between -1 and 1 that look random.
    fn noise(i: u32) -> f32 {
        (mix(5, u64::from(i)) >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    fn layers(vertices: &[Vertex]) -> Option<Layers> {
        let m = Moments::from_elements(vertices);
        Layers::find(vertices, &m, &m.covariance(), 3)
    }

    proptest! {
        #[test]
        fn two_layers_are_told_apart(
            count in 200u32..3000, bend in -0.3..0.3f32, normal: bool, share in 3u32..8, gap in 1.6..4.0f32, rough in 0.0..0.1f32,
        ) {
            // Layers of points that are this far from each other.
            let gap = (gap * 1.1 * (10.0 / count as f32 / share.min(10 - share) as f32).sqrt()).min(0.25);
            let is_upper = |i: u32| i * 7 % 10 < share;
            let vertices = sheet(count, bend, |i| if is_upper(i) { gap } else { 0.0 } + rough * gap * noise(i), normal);
            if let Some(found) = layers(&vertices) {
                let is_right = |s: &&Vertex| found.is_upper(*s) == (is_upper(s.index) == (found.axes[2].z > 0.0));
                let wrong = vertices.len() - vertices.iter().filter(is_right).count();
                // Near the corners a sheet that bends is no quadratic surface.
                prop_assert!(wrong * 50 <= vertices.len(), "{wrong} of {count}");
            } else {
                // Layers that bend by as much as they are apart are told by their parts.
                prop_assert!(bend.abs() > 0.2 || gap < 0.04, "{gap} of {count}");
            }
        }

        #[test]
        fn two_flat_layers_are_told_apart_wholly(
            count in 200u32..3000, normal: bool, share in 3u32..8, gap in 0.05..0.25f32, rough in 0.0..0.1f32,
        ) {
            let is_upper = |i: u32| i * 7 % 10 < share;
            let gap = gap.max(1.76 * (10.0 / count as f32 / share.min(10 - share) as f32).sqrt());
            let vertices = sheet(count, 0.0, |i| if is_upper(i) { gap } else { 0.0 } + rough * gap * noise(i), normal);
            let found = layers(&vertices).unwrap();
            for s in &vertices {
                prop_assert_eq!(found.is_upper(s), is_upper(s.index) == (found.axes[2].z > 0.0), "{}", s.index);
            }
        }

        #[test]
        fn one_sheet_is_one(count in 24u32..3000, bend in -0.7..0.7f32, normal: bool, rough in 0.0..0.5f32) {
            let vertices = sheet(count, bend, |i| rough * noise(i), normal);
            prop_assert!(layers(&vertices).is_none());
        }
    }

    #[test]
    fn deviations_are_those_along_the_principal_axes() {
        for i in 0..100 {
            let a = DMat3::from_cols_array(&std::array::from_fn(|j| f64::from(noise(9 * i + j as u32))));
            let covariance = a * a.transpose();
            let expected = symmetric_eigen(covariance).0;
            let found = DVec3::from(deviations(covariance, least_eigenvalue(covariance)));
            assert!((expected - found * found).abs().max_element() < 1e-9 * expected.z, "{expected} {found}");
        }
    }

    #[test]
    fn heights_in_steps_are_no_layers() {
        // Points are rounded as scanners do: by steps that are smaller than the distance of the points.
        for normal in [false, true] {
            let vertices = sheet(400, 0.0, |i| (0.02 * noise(i) / 0.02).round() * 0.02, normal);
            assert!(layers(&vertices).is_none());
        }
    }

    #[test]
    fn nothing_odd_comes_of_odd_clusters() {
        let same = vec![Vertex { position: Vec3::ONE, normal: Vec3::Z, index: 0 }; 100];
        assert!(layers(&same).is_none());
        let line: Vec<Vertex> =
            (0..100).map(|i| Vertex { position: Vec3::X * i as f32, normal: Vec3::ZERO, index: i }).collect();
        assert!(layers(&line).is_none());
        let two: Vec<Vertex> = (0..100)
            .map(|i| Vertex { position: Vec3::Z * (i % 2) as f32, normal: Vec3::Z, index: i })
            .collect();
        assert!(layers(&two).is_none());
    }
}
