//! Tests that no vertex leaves the range of the samples around it, whatever the samples are and wherever they
//! go: by the definition in `docs/reconstruction.md`, over all samples, and with nothing of what the
//! reconstruction knows.

use glam::{DMat3, DVec3, EulerRot, Quat, Vec3};
use proptest::prelude::*;

use super::tests::carried;
use super::{DeformationField, Method, RestGeometry};
use crate::sampling::SampleSet;

/// Samples of a range.
const AROUND: usize = 28;
/// Edges of each sample.
const EDGES: usize = 6;

/// Distance, in local steps, by which a vertex at `p` that is displaced by `u` leaves the range of the
/// samples around it.
fn leaves_range(positions: &[Vec3], displacements: &[DVec3], p: Vec3, u: DVec3) -> f64 {
    let mut order: Vec<usize> = (0..positions.len()).collect();
    let key = |i: &usize| (positions[*i].distance_squared(p), *i);
    order.sort_by(|a, b| key(a).0.total_cmp(&key(b).0).then(a.cmp(b)));
    order.truncate(AROUND);

    let (mut step, mut steepest) = (0.0f64, 0.0f64);
    for i in &order {
        let length = |j: usize| positions[*i].as_dvec3().distance(positions[j].as_dvec3());
        let mut others: Vec<usize> = (0..positions.len()).filter(|j| j != i).collect();
        others.sort_by(|a, b| length(*a).total_cmp(&length(*b)));
        for j in others.into_iter().take(EDGES) {
            let difference = displacements[*i].distance(displacements[j]);
            step = step.max(difference);
            if length(j) > 0.0 {
                steepest = steepest.max(difference / length(j));
            }
        }
    }
    let (slope, part) = explained(&order, positions, displacements);
    let steepness = steepest.min(1.5 * slope) * ((0.55 - part) / 0.15).clamp(0.0, 1.0);

    let corners: Vec<DVec3> = order.iter().map(|i| positions[*i].as_dvec3() - p.as_dvec3()).collect();
    let further = steepness * distance_from_hull(&corners);
    let of = |i: &usize| displacements[*i];
    let low = order.iter().map(of).fold(DVec3::INFINITY, DVec3::min) - further;
    let high = order.iter().map(of).fold(DVec3::NEG_INFINITY, DVec3::max) + further;
    // Rounding of positions in single precision, about one from the middle.
    let rounding = 2e-6 * (1.0 + u.length() + p.as_dvec3().length());
    let leaves = (low - u).max(u - high).max_element() - rounding;
    if leaves <= 0.0 { 0.0 } else { leaves / step }
}

/// The norm of the linear map that explains displacements, and the part that it leaves over.
fn explained(order: &[usize], positions: &[Vec3], displacements: &[DVec3]) -> (f64, f64) {
    let count = order.len() as f64;
    let middle = order.iter().map(|i| positions[*i].as_dvec3()).sum::<DVec3>() / count;
    let mean = order.iter().map(|i| displacements[*i]).sum::<DVec3>() / count;
    let of = |i: &usize| (positions[*i].as_dvec3() - middle, displacements[*i] - mean);
    let sum = |f: &dyn Fn(DVec3, DVec3) -> f64| order.iter().map(|i| f(of(i).0, of(i).1)).sum::<f64>();
    let ridge = 0.02 * sum(&|x, _| x.length_squared());
    let entries = |f: &dyn Fn(DVec3, DVec3, usize, usize) -> f64| {
        let mut matrix = DMat3::ZERO;
        for (row, column) in (0..9).map(|k| (k % 3, k / 3)) {
            matrix.col_mut(column)[row] = sum(&|x, u| f(x, u, row, column));
        }
        matrix
    };
    let squares =
        entries(&|x, _, row, column| x[row] * x[column]) + DMat3::from_diagonal(DVec3::splat(ridge));
    let slope = entries(&|x, u, row, column| u[row] * x[column]) * squares.inverse();
    let part = (sum(&|x, u| (u - slope * x).length_squared()) / sum(&|_, u| u.length_squared())).sqrt();
    let norm = slope.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    if norm.is_finite() && part.is_finite() { (norm, part) } else { (0.0, 0.0) }
}

/// The distance of the origin from the convex hull of points, or a little more: by Frank and Wolfe's method.
fn distance_from_hull(corners: &[DVec3]) -> f64 {
    let mut x = corners[0];
    for _ in 0..2000 {
        let corner = corners.iter().copied().min_by(|a, b| a.dot(x).total_cmp(&b.dot(x))).expect("corners");
        let edge = corner - x;
        let t = (-edge.dot(x) / edge.length_squared()).clamp(0.0, 1.0);
        if t.is_nan() || t == 0.0 {
            break;
        }
        x += edge * t;
    }
    x.length()
}

/// Numbers in [0, 1) that look random, one for each `i` and `k`.
fn noise(seed: u64, i: usize, k: usize) -> f32 {
    let mut x = seed ^ (i as u64 * 0x9E37_79B9_7F4A_7C15) ^ (k as u64 * 0xD1B5_4A32_D192_ED03);
    for _ in 0..2 {
        x = (x ^ (x >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    }
    (x >> 40) as f32 / (1u64 << 24) as f32
}

fn noises(seed: u64, i: usize, k: usize) -> Vec3 {
    Vec3::new(noise(seed, i, 3 * k), noise(seed, i, 3 * k + 1), noise(seed, i, 3 * k + 2)) - 0.5
}

#[derive(Debug, Clone, Copy)]
enum Model {
    Sheet,
    Rough,
    /// Two sheets at this distance, in spacings; whether they face the same way.
    Sheets(f32, bool),
    Cloud,
    Curve,
    /// Places that several samples share.
    Coincident(usize),
    Clusters,
}

const SIDE: usize = 18;

impl Model {
    /// Samples and their normals.
    fn samples(self, seed: u64) -> Vec<(Vec3, Vec3)> {
        let spacing = 1.0 / SIDE as f32;
        let on_sheet = |i: usize| {
            let at = |x: usize, k: usize| (x as f32 + noise(seed, i, k)) * spacing;
            let (x, z) = (at(i % SIDE, 90), at(i / SIDE % SIDE, 91));
            (Vec3::new(x, 0.1 * (5.0 * x).sin() * (4.0 * z).cos(), z), Vec3::Y)
        };
        let count = SIDE * SIDE;
        match self {
            Self::Sheet => (0..count).map(on_sheet).collect(),
            Self::Rough => {
                (0..count).map(|i| (on_sheet(i).0 + noises(seed, i, 7) * spacing, Vec3::Y)).collect()
            }
            Self::Sheets(gap, alike) => (0..2 * count)
                .map(|i| {
                    let ((p, n), upper) = (on_sheet(i), i >= count);
                    let side = if upper || alike { n } else { -n };
                    (if upper { p + n * gap * spacing } else { p }, side)
                })
                .collect(),
            Self::Cloud => (0..count).map(|i| (noises(seed, i, 1), Vec3::ZERO)).collect(),
            Self::Curve => (0..80)
                .map(|i| {
                    let t = (i as f32 + noise(seed, i, 2)) / 12.0;
                    (Vec3::new(t.cos(), 0.1 * t, t.sin()), Vec3::Y)
                })
                .collect(),
            Self::Coincident(copies) => (0..count).map(|i| on_sheet(i / copies * copies)).collect(),
            Self::Clusters => (0..count)
                .map(|i| (on_sheet(i % 12 * 27).0 + noises(seed, i, 4) * spacing * 0.1, Vec3::Y))
                .collect(),
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum Map {
    Independent,
    Smooth,
    Piecewise,
    OneSample,
    Half,
    /// A turn by so many radians, with a translation.
    Rigid(f32),
    /// One of two sheets, or the second half of the samples otherwise.
    SecondHalf,
}

impl Map {
    fn displacement(self, seed: u64, i: usize, count: usize, p: Vec3) -> Vec3 {
        let lift = Vec3::new(0.1, 0.3, -0.2) * noise(seed, 0, 40);
        match self {
            Self::Independent => p + noises(seed, i, 11) * noise(seed, 0, 41),
            Self::Smooth => Quat::from_rotation_y(3.0 * p.y + p.x) * p + Vec3::X * (6.0 * p.z).sin() * 0.05,
            Self::Piecewise if p.x > 0.5 => Quat::from_rotation_z(1.0) * p + lift,
            Self::OneSample if i == count / 2 => p + lift,
            Self::Half if noise(seed, i, 12) < 0.5 => p + lift,
            Self::Rigid(angle) => Quat::from_euler(EulerRot::XYZ, angle, 0.3 * angle, 1.0) * p + lift,
            Self::SecondHalf if i >= count / 2 => p + lift * (6.0 * p.x).sin(),
            _ => p,
        }
    }
}

fn model() -> impl Strategy<Value = Model> {
    prop_oneof![
        Just(Model::Sheet),
        Just(Model::Rough),
        (0.02..1.5f32, any::<bool>()).prop_map(|(gap, alike)| Model::Sheets(gap, alike)),
        Just(Model::Cloud),
        Just(Model::Curve),
        (2..40usize).prop_map(Model::Coincident),
        Just(Model::Clusters),
    ]
}

fn map() -> impl Strategy<Value = Map> {
    prop_oneof![
        Just(Map::Independent),
        Just(Map::Smooth),
        Just(Map::Piecewise),
        Just(Map::OneSample),
        Just(Map::Half),
        (0.01..3.1f32).prop_map(Map::Rigid),
        Just(Map::SecondHalf),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn no_vertex_leaves_the_range_of_the_samples_around(
        model in model(), map in map(), with_normals: bool, seed: u64,
    ) {
        let (rest, normals): (Vec<Vec3>, Vec<Vec3>) = model.samples(seed).into_iter().unzip();
        let set = SampleSet::new(rest.clone(), if with_normals { normals } else { Vec::new() }).expect("samples");
        let around = RestGeometry::new(&set);
        let moved = |(i, p): (usize, &Vec3)| map.displacement(seed, i, rest.len(), *p);
        let deformed: Vec<Vec3> = rest.iter().enumerate().map(moved).collect();
        let displacements: Vec<DVec3> =
            rest.iter().zip(&deformed).map(|(p, image)| (*image - *p).as_dvec3()).collect();
        // On the samples, around them, off the surface, and far beyond it.
        let points: Vec<Vec3> = (0..120)
            .map(|i| rest[i * 7919 % rest.len()] + noises(seed, i, 20) * [0.0, 0.03, 0.1, 0.3, 2.0][i % 5])
            .collect();
        for method in [Method::BlendedJets, Method::ProjectedBarycentric] {
            let field = DeformationField::new(&around, &deformed, method);
            for (p, image) in points.iter().zip(carried(&field, &points)) {
                let u = image.as_dvec3() - p.as_dvec3();
                let leaves = leaves_range(&rest, &displacements, *p, u);
                prop_assert!(leaves <= 0.1, "{method:?}: {p} by {leaves} of the local step");
            }
        }
    }
}

#[test]
fn rigid_motions_are_no_overshoot_however_far_off_the_surface() {
    for (model, angle) in [Model::Sheet, Model::Sheets(0.3, true)]
        .into_iter()
        .flat_map(|model| [0.01, 0.5, 1.5, 3.0].map(|angle| (model, angle)))
    {
        let rest: Vec<Vec3> = model.samples(1).into_iter().map(|(p, _)| p).collect();
        let set = SampleSet::new(rest.clone(), Vec::new()).expect("samples");
        let around = RestGeometry::new(&set);
        let map = |p: Vec3| Map::Rigid(angle).displacement(1, 0, 1, p);
        let deformed: Vec<Vec3> = rest.iter().map(|p| map(*p)).collect();
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
        let points: Vec<Vec3> =
            (0..600).map(|i| rest[i % rest.len()] + noises(2, i, 1) * [0.05, 0.3][i % 2]).collect();
        for (p, image) in points.iter().zip(carried(&field, &points)) {
            assert!(
                map(*p).distance(image) < 2e-5,
                "{model:?}, {angle}: {p} goes to {image}, not {}",
                map(*p)
            );
        }
    }
}
