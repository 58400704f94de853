//! The field as a whole: what it reproduces, how it behaves at steps, and that sheets do not bleed.

use glam::{Affine3A, DVec3, EulerRot, Mat3, Quat, Vec3};
use simod_model::follow::tangent;
use simod_model::frame::Frame;
use simod_model::long_list::ListStorage;

use super::block::carry_on_this_thread;
use super::{DeformationField, Method, Moved, RestGeometry, VertexDiagnostics, carry};
use crate::deformed_positions::DeformedPositions;
use crate::sampling::SampleSet;

const LOCAL: Frame = Frame { origin: DVec3::ZERO, scale: 1.0 };

/// A curved patch with irregular samples, and points on it between them.
fn patch(n: usize) -> impl Iterator<Item = Vec3> {
    (0..n * n).map(move |i| {
        let jitter = |k: u32| ((i as u32 * 7919 + k * 104_729) % 1000) as f32 / 1500.0;
        let (x, y) = ((i % n) as f32 + jitter(1), (i / n) as f32 + jitter(2));
        on_patch(x / n as f32, y / n as f32)
    })
}

fn on_patch(x: f32, z: f32) -> Vec3 {
    Vec3::new(x, 0.1 * (6.0 * x).sin() + 0.07 * (9.0 * z).cos(), z)
}

fn inner(p: &Vec3) -> bool {
    p.x.min(p.z) > 0.05 && p.x.max(p.z) < 0.95
}

/// Deformed positions of points.
pub(super) fn carried(field: &DeformationField, points: &[Vec3]) -> Vec<Vec3> {
    carried_with_normals(field, points, &[]).0
}

/// Deformed positions of points, and their normals.
fn carried_with_normals(
    field: &DeformationField,
    points: &[Vec3],
    normals: &[Vec3],
) -> (Vec<Vec3>, Vec<Vec3>) {
    let rest: Vec<DVec3> = points.iter().map(|p| p.as_dvec3()).collect();
    let (mut positions, mut turned) = (rest.clone(), normals.to_vec());
    let moved =
        Moved { positions: &mut positions, normals: &mut turned, gradients: &mut [], figures: &mut [] };
    carry(std::slice::from_ref(field), &LOCAL, &rest, None, &mut [moved]);
    (positions.iter().map(|p| p.as_vec3()).collect(), turned)
}

/// The largest error of a map that is applied to the samples of the patch alone.
fn worst(method: Method, map: impl Fn(Vec3) -> Vec3) -> f32 {
    let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    let deformed: Vec<Vec3> = set.positions.iter().map(|p| map(*p)).collect();
    let field = DeformationField::new(&around, &deformed, method);
    let points: Vec<Vec3> = patch(97).filter(inner).collect();
    let images = carried(&field, &points);
    points.iter().zip(images).map(|(p, image)| map(*p).distance(image)).fold(0.0, f32::max)
}

#[test]
fn the_identity_is_the_identity_bit_for_bit() {
    let set = SampleSet::new(patch(30).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    for method in [Method::BlendedJets, Method::ProjectedBarycentric] {
        let field = DeformationField::new(&around, &set.positions, method);
        let points: Vec<Vec3> = patch(71).map(|p| p * 1.01).collect();
        assert_eq!(carried(&field, &points), points);
    }
}

#[test]
fn similarities_affine_and_quadratic_maps_are_reproduced() {
    let rotation = Quat::from_euler(EulerRot::XYZ, 1.0, -2.0, 0.5);
    let similarity = Affine3A::from_scale_rotation_translation(Vec3::splat(1.7), rotation, Vec3::ONE);
    for method in [Method::BlendedJets, Method::ProjectedBarycentric] {
        let error = worst(method, |p| similarity.transform_point3(p));
        assert!(error < 2e-6, "{method:?}: {error}");
    }
    let m = Mat3::from_cols_array(&[1.2, 0.3, -0.1, 0.2, 0.8, 0.4, -0.3, 0.1, 1.1]);
    let affine = worst(Method::BlendedJets, |p| m * p + Vec3::ONE);
    assert!(affine < 2e-6, "{affine}");
    let quadratic = worst(Method::BlendedJets, |p| p + Vec3::new(p.z * p.z, p.x * p.y, 0.5 * p.x * p.z));
    assert!(quadratic < 2e-5, "{quadratic}");
}

/// As of scans with triangles that are inside out.
#[test]
fn samples_whose_normals_are_wrong_turn_with_those_around() {
    let rest: Vec<Vec3> = patch(40).collect();
    let normal = |(i, p): (usize, &Vec3)| {
        let n = Vec3::new(-0.6 * (6.0 * p.x).cos(), 1.0, 0.63 * (9.0 * p.z).sin()).normalize_or_zero();
        if i % 97 < 2 { -n } else { n }
    };
    let normals = rest.iter().enumerate().map(normal).collect();
    let set = SampleSet::new(rest, normals).expect("samples");
    let around = RestGeometry::new(&set);
    let rigid = Affine3A::from_rotation_translation(Quat::from_euler(EulerRot::XYZ, 1.0, -2.0, 0.5), Vec3::X);
    let deformed: Vec<Vec3> = set.positions.iter().map(|p| rigid.transform_point3(*p)).collect();
    let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
    let points: Vec<Vec3> = patch(97).filter(inner).collect();
    for (p, image) in points.iter().zip(carried(&field, &points)) {
        assert!(rigid.transform_point3(*p).distance(image) < 2e-6, "{p} goes to {image}");
    }
}

#[test]
fn a_smooth_map_is_followed_to_third_order() {
    let twist = |p: Vec3| Quat::from_rotation_z(2.0 * p.z) * p;
    let error = worst(Method::BlendedJets, twist);
    assert!(error < 5e-5, "{error}");
}

#[test]
fn at_steps_nothing_leaves_the_range_of_the_samples_by_much() {
    let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    for (width, side) in [(0.01, Vec3::X), (0.03, Vec3::new(0.6, 0.0, 0.8)), (0.1, Vec3::Z)] {
        let step = |p: Vec3| ((p - Vec3::splat(0.5)).dot(side) / width + 0.5).clamp(0.0, 1.0);
        let deformed: Vec<Vec3> = set.positions.iter().map(|p| *p + Vec3::Y * step(*p)).collect();
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
        let points: Vec<Vec3> = patch(97).collect();
        for (p, image) in points.iter().zip(carried(&field, &points)) {
            let moved = image - *p;
            assert!((-0.1..1.1).contains(&moved.y), "{width}: {p}: {moved}");
            assert!(moved.x.abs().max(moved.z.abs()) < 0.1, "{width}: {p}: {moved}");
        }
    }
}

#[test]
fn at_the_ends_of_a_ramp_neighbouring_vertices_stay_neighbours() {
    // Samples with gaps between them, as where cells of the sampling meet.
    let hole = |p: &Vec3| (p.x * 7.0).fract() > 0.8 && (p.z * 7.0).fract() > 0.8;
    let set = SampleSet::new(patch(50).filter(|p| !hole(p)).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    for width in [0.08, 0.16, 0.32] {
        let step = |p: Vec3| ((p.x + 0.3 * p.z - 0.6) / width + 0.5).clamp(0.0, 1.0);
        let deformed: Vec<Vec3> = set.positions.iter().map(|p| *p + Vec3::Y * 0.3 * step(*p)).collect();
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
        for row in 1..40 {
            let at = |i: usize| on_patch(i as f32 / 2000.0, row as f32 / 40.0);
            let points: Vec<Vec3> = (100..1900).map(at).collect();
            let moved: Vec<f32> =
                carried(&field, &points).iter().zip(&points).map(|(a, b)| a.y - b.y).collect();
            let steepest = moved.windows(2).map(|m| (m[1] - m[0]).abs()).fold(0.0, f32::max);
            assert!(
                steepest < 2.5 * 0.3 / width / 2000.0,
                "{width} {row}: {}",
                steepest * 2000.0 * width / 0.3
            );
        }
    }
}

#[test]
fn normals_of_a_rough_scan_do_not_come_between() {
    // Relief of the size of the spacing, and normals that go with it up to 110° off: two may oppose each
    // other.
    let rough = |i: usize, p: Vec3| {
        let noise = |k: usize| ((i * 7919 + k * 104_729) % 997) as f32 / 997.0;
        let (tilt, around) = ((110.0 * noise(1).sqrt()).to_radians(), 6.3 * noise(2));
        let normal = Vec3::new(tilt.sin() * around.cos(), tilt.cos(), tilt.sin() * around.sin());
        (p + Vec3::Y * 0.01 * noise(3), normal)
    };
    let (positions, normals): (Vec<Vec3>, Vec<Vec3>) =
        patch(60).enumerate().map(|(i, p)| rough(i, p)).unzip();
    let set = SampleSet::new(positions, normals).expect("samples");
    let around = RestGeometry::new(&set);
    let map = |p: Vec3| Quat::from_rotation_z(1.5 * p.z) * p;
    let deformed: Vec<Vec3> = set.positions.iter().map(|p| map(*p)).collect();
    let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
    let (points, normals): (Vec<Vec3>, Vec<Vec3>) =
        patch(127).enumerate().map(|(i, p)| rough(i, p)).filter(|(p, _)| inner(p)).unzip();
    let (images, _) = carried_with_normals(&field, &points, &normals);
    let worst = points.iter().zip(images).map(|(p, image)| map(*p).distance(image)).fold(0.0, f32::max);
    assert!(worst < 4e-5, "{worst}");
}

#[test]
fn the_gradient_is_that_of_what_the_vertices_do() {
    let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    let twist = |p: Vec3| Quat::from_rotation_z(2.0 * p.z) * p + Vec3::Y * (9.0 * p.x).sin() * 0.02;
    let deformed: Vec<Vec3> = set.positions.iter().map(|p| twist(*p)).collect();
    let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
    let points: Vec<Vec3> = patch(37).filter(inner).collect();
    let tangents = |p: &Vec3| [1e-3, -1e-3].map(|h| (on_patch(p.x + h, p.z), on_patch(p.x, p.z + h)));
    let normal =
        |ends: [(Vec3, Vec3); 2]| (ends[0].1 - ends[1].1).cross(ends[0].0 - ends[1].0).normalize_or(Vec3::Y);
    let normals: Vec<Vec3> = points.iter().map(|p| 3.0 * normal(tangents(p))).collect();
    let (_, normals) = carried_with_normals(&field, &points, &normals);
    for (p, n) in points.iter().zip(normals) {
        let ends = tangents(p).map(|(x, z)| (carried(&field, &[x])[0], carried(&field, &[z])[0]));
        assert!(n.distance(3.0 * normal(ends)) < 0.02, "{p}: {n} is not {}", normal(ends));
    }
}

#[test]
fn tangents_turn_as_lines_on_the_surface_do() {
    let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    let points: Vec<Vec3> = patch(61).filter(inner).collect();
    let rest: Vec<DVec3> = points.iter().map(|p| p.as_dvec3()).collect();
    let along =
        |p: &Vec3| 2.0 * (on_patch(p.x + 1e-3, p.z) - on_patch(p.x - 1e-3, p.z)).normalize_or(Vec3::X);
    let shear = Mat3::from_cols(Vec3::X, Vec3::new(0.5, 1.0, 0.0), Vec3::new(0.0, -0.3, 1.2));
    let mirror = Mat3::from_diagonal(Vec3::new(1.0, -1.0, 1.0));
    let bend = |p: Vec3| Quat::from_rotation_x(0.7 * p.x) * p;
    // The gradient of the second is that of a fit.
    for (method, bound) in [(Method::BlendedJets, 0.03), (Method::ProjectedBarycentric, 0.1)] {
        for (matrix, side) in
            [(Some(Mat3::from_rotation_z(2.0)), 1.0), (Some(shear), 1.0), (Some(mirror), -1.0), (None, 1.0)]
        {
            let map = |p: Vec3| matrix.map_or_else(|| bend(p), |matrix| matrix * p);
            let deformed: Vec<Vec3> = set.positions.iter().map(|p| map(*p)).collect();
            let field = DeformationField::new(&around, &deformed, method);
            let mut positions = rest.clone();
            let mut gradients = vec![Mat3::IDENTITY; points.len()];
            let moved = Moved {
                positions: &mut positions,
                normals: &mut [],
                gradients: &mut gradients,
                figures: &mut [],
            };
            carry(std::slice::from_ref(&field), &LOCAL, &rest, None, &mut [moved]);
            for (p, gradient) in points.iter().zip(&gradients) {
                let t = tangent(gradient, along(p).extend(1.0), field.is_mirrored());
                let step = 1e-3 * along(p);
                let expected = 2.0 * (map(*p + step) - map(*p - step)).normalize_or(Vec3::X);
                let found = t.truncate();
                assert!(
                    found.distance(expected) < bound && t.w == side,
                    "{method:?} {p}: {t} is not {expected}"
                );
            }
        }
        // Nothing moves, and nothing turns.
        let field = DeformationField::new(&around, &set.positions, method);
        assert!(field.is_still());
        let mut gradients = vec![Mat3::IDENTITY; points.len()];
        let mut positions = rest.clone();
        let moved = Moved {
            positions: &mut positions,
            normals: &mut [],
            gradients: &mut gradients,
            figures: &mut [],
        };
        carry(std::slice::from_ref(&field), &LOCAL, &rest, None, &mut [moved]);
        assert!(gradients.iter().all(|gradient| *gradient == Mat3::IDENTITY));
    }
}

/// More of them than are carried over at a time, and samples that all go far.
#[test]
fn lists_in_files_carry_vertices_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    // Enough samples for all lists to be long; two plates near each other, of which one bends and a part of
    // the other one jumps.
    let points: Vec<Vec3> = patch(182).flat_map(|p| [p, p - 0.004 * Vec3::Y]).collect();
    let deformed: Vec<Vec3> = (0..)
        .zip(&points)
        .map(|(i, p): (u32, _)| match i % 2 {
            0 => *p + Vec3::Y * (3.0 * p.x).sin() * 0.1,
            _ if p.z > 0.5 => *p - 0.2 * Vec3::Y,
            _ => *p,
        })
        .collect();
    let vertices: Vec<Vec3> = points.iter().map(|p| *p + Vec3::new(0.001, 0.0005, -0.001)).collect();
    let in_storage = |storage: ListStorage| {
        let mut samples = SampleSet::new(points.clone(), Vec::new()).expect("samples");
        samples.store_lists(storage.clone());
        let around = RestGeometry::new(&samples);
        let mut kept = Vec::new();
        super::kept_geometry::pack(&around, &mut kept).expect("bytes");
        let mut again = SampleSet::new(points.clone(), Vec::new()).expect("samples");
        again.store_lists(storage);
        let (unpacked, mut packed) =
            (super::kept_geometry::unpack(&again, &kept).expect("geometry"), Vec::new());
        super::kept_geometry::pack(&unpacked, &mut packed).expect("bytes");
        assert!(packed == kept);
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
        let expected: Vec<u32> = field.expected_error().into_iter().map(f32::to_bits).collect();
        let carried = carried(&field, &vertices).into_iter().map(|p| p.to_array().map(f32::to_bits));
        (kept, expected, carried.collect::<Vec<_>>())
    };
    let in_files = in_storage(ListStorage::in_folder(folder.path()));
    assert!(in_files == in_storage(ListStorage::Memory));
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
}

#[test]
fn vertices_in_no_order_go_where_they_go_in_order() {
    let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    let to = |p: Vec3| (Quat::from_rotation_z(0.3 * p.z) * p).as_dvec3() + DVec3::new(1e6, 0.0, -300.0);
    let places: Vec<DVec3> = set.positions.iter().map(|p| to(*p)).collect();
    let deformed = DeformedPositions::new(&LOCAL, &set.positions, &places);
    assert!(!deformed.is_unshifted());
    let field = DeformationField::from_deformed(&around, &deformed, Method::BlendedJets);
    let rest: Vec<DVec3> = patch(220).map(|p| p.as_dvec3()).collect();
    let carried = |rest: &[DVec3]| {
        let mut positions = rest.to_vec();
        let moved =
            Moved { positions: &mut positions, normals: &mut [], gradients: &mut [], figures: &mut [] };
        carry_on_this_thread(std::slice::from_ref(&field), &LOCAL, rest, None, &mut [moved]);
        positions
    };
    let images = carried(&rest);
    let inner = rest.iter().zip(&images).filter(|(p, _)| inner(&p.as_vec3()));
    let off = inner.map(|(p, image)| to(p.as_vec3()).distance(*image)).fold(0.0, f64::max);
    assert!(off < 1e-5, "{off:e}");
    // Each once: 48 400 and 24 097 have no divisor in common.
    let scattered: Vec<usize> = (0..rest.len()).map(|i| i * 24_097 % rest.len()).collect();
    // So are runs of 16.
    let runs =
        scattered.iter().filter(|i| **i < rest.len() / 16).flat_map(|i| 16 * i..16 * (i + 1)).collect();
    for order in [scattered.clone(), runs] {
        let places: Vec<DVec3> = order.iter().map(|i| rest[*i]).collect();
        assert!(order.iter().zip(carried(&places)).all(|(i, image)| image == images[*i]));
    }
}

/// Results of a call for each vertex: the bits of its position and of its normal, and its figures.
type Bits = ([u64; 3], [u32; 3], [u32; 3]);

fn bits(field: &DeformationField, points: &[(Vec3, Vec3)]) -> Vec<Bits> {
    let rest: Vec<DVec3> = points.iter().map(|(p, _)| p.as_dvec3()).collect();
    let mut positions = rest.clone();
    let mut normals: Vec<Vec3> = points.iter().map(|(_, n)| *n).collect();
    let mut figures = vec![VertexDiagnostics::UNKNOWN; rest.len()];
    let moved =
        Moved { positions: &mut positions, normals: &mut normals, gradients: &mut [], figures: &mut figures };
    carry(std::slice::from_ref(field), &LOCAL, &rest, None, &mut [moved]);
    let figures = figures.iter().map(|f| [f.displacement, f.stretch[0], f.stretch[1]].map(f32::to_bits));
    let normals = normals.iter().map(|n| n.to_array().map(f32::to_bits));
    let positions = positions.iter().map(|p| p.to_array().map(f64::to_bits));
    positions.zip(normals).zip(figures).map(|((p, n), f)| (p, n, f)).collect()
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(24))]

    /// Whatever stands before and beside it in the file, whatever its normal, and however many threads there
    /// are; also where sheets are near, where samples are noise, and off all of them.
    #[test]
    fn what_becomes_of_a_vertex_is_a_function_of_its_place(
        seed in 0u64..u64::MAX, model in 0usize..4, motion in 0usize..4, barycentric: bool,
    ) {
        let mut state = seed | 1;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let (positions, known) = match model {
            0 => (patch(25).collect(), Vec::new()),
            1 => plates(0.3, [-Vec3::Y, Vec3::Y]),
            2 => plates(0.2, [Vec3::Y, Vec3::Y]),
            _ => ((0..600).map(|_| Vec3::new(random(), random(), random() * random())).collect(), Vec::new()),
        };
        let set = SampleSet::new(positions, known).expect("samples");
        let around = RestGeometry::new(&set);
        let deformed: Vec<Vec3> = set
            .positions
            .iter()
            .map(|p| match motion {
                0 => Quat::from_rotation_z(2.0 * p.z) * *p,
                1 => *p + Vec3::Y * f32::from(u8::from(random() < 0.5)),
                2 => *p + Vec3::new(random(), random(), random()),
                _ => *p + Vec3::X * f32::from(u8::from(p.y > 0.003)),
            })
            .collect();
        let method = if barycentric { Method::ProjectedBarycentric } else { Method::BlendedJets };
        let field = DeformationField::new(&around, &deformed, method);

        // Each place three times, with other normals; and once more, with zero of the other sign.
        let mut points: Vec<(Vec3, Vec3)> = Vec::new();
        for i in 0..3000 {
            let q = set.positions[(random() * set.len() as f32) as usize % set.len()];
            let far = [0.0, 0.003, 0.03, 0.3][i % 4];
            let mut p = q + far * (Vec3::new(random(), random(), random()) - 0.5);
            p.x = if i % 50 == 0 { 0.0 } else { p.x };
            for _ in 0..3 {
                points.push((p, Vec3::new(random(), random(), random()) - 0.5));
            }
        }
        let whole = bits(&field, &points);
        for (i, same) in whole.chunks(3).enumerate() {
            assert!(same.iter().all(|s| s.0 == same[0].0 && s.2 == same[0].2), "place {i} comes apart");
        }
        // In another order, and in calls of other sizes, on other numbers of threads.
        let mut order: Vec<usize> = (0..points.len()).collect();
        (1..order.len()).for_each(|i| order.swap(i, (random() * i as f32) as usize));
        let shuffled: Vec<(Vec3, Vec3)> = order.iter().map(|i| points[*i]).collect();
        for (threads, size) in [(1, 9000), (2, 4000), (3, 77)] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let parts: Vec<Bits> =
                pool.install(|| shuffled.chunks(size).flat_map(|part| bits(&field, part)).collect());
            assert!(order.iter().zip(&parts).all(|(i, b)| whole[*i] == *b), "{threads} threads, {size} at a time");
        }
        for i in (0..points.len()).step_by(500) {
            assert!(bits(&field, &points[i..=i])[0] == whole[i], "vertex {i} alone");
            // As many as fill packets, and some more.
            let copies = vec![points[i]; 2 * super::lanes::PACKET + 3];
            assert!(bits(&field, &copies).iter().all(|b| *b == whole[i]), "vertex {i} in packets");
        }
        let (zero, other): (Vec<_>, Vec<_>) = points
            .iter()
            .filter(|(p, _)| p.x == 0.0)
            .map(|(p, n)| ((p.with_x(0.0), *n), (p.with_x(-0.0), *n)))
            .unzip();
        let zeros = bits(&field, &zero).into_iter().zip(bits(&field, &other));
        // A vertex that stays may keep the sign of a zero.
        let value = |b: &Bits| b.0.map(|x| f64::from_bits(x) + 0.0);
        assert!(zeros.into_iter().all(|(a, b)| value(&a) == value(&b) && a.1 == b.1));
    }
}

/// Two plates a part of the spacing apart, with jitter; `facing` of the upper one over the lower.
fn plates(gap: f32, up: [Vec3; 2]) -> (Vec<Vec3>, Vec<Vec3>) {
    let plate = |k: usize| {
        (0..900).map(move |i| {
            let jitter = |a: usize| ((i * 7919 + a * 104_729 + k * 331) % 1000) as f32 / 2000.0;
            let (x, z) = ((i % 30) as f32 + jitter(1), (i / 30) as f32 + jitter(2));
            Vec3::new(x / 30.0, k as f32 * gap / 30.0, z / 30.0)
        })
    };
    let normals = [vec![up[0]; 900], vec![up[1]; 900]].concat();
    (plate(0).chain(plate(1)).collect(), normals)
}

#[test]
fn plates_closer_than_the_spacing_move_apart_without_dragging_each_other() {
    for gap in [0.8, 0.5, 0.3] {
        for up in [[-Vec3::Y, Vec3::Y], [Vec3::Y, -Vec3::Y], [Vec3::Y, Vec3::Y]] {
            let (positions, normals) = plates(gap, up);
            let set = SampleSet::new(positions, normals).expect("samples");
            let around = RestGeometry::new(&set);
            let lift = Vec3::new(0.1, 0.5, 0.0);
            let deformed: Vec<Vec3> =
                set.positions.iter().enumerate().map(|(i, p)| if i < 900 { *p } else { *p + lift }).collect();
            for method in [Method::BlendedJets, Method::ProjectedBarycentric] {
                let field = DeformationField::new(&around, &deformed, method);
                for with_normals in [true, false] {
                    for k in 0..2 {
                        let y = k as f32 * gap / 30.0;
                        let points: Vec<Vec3> = (0..2000)
                            .map(|i| Vec3::new((i % 50) as f32 / 50.0, y, (i / 50) as f32 / 40.0))
                            .collect();
                        let normals = if with_normals { vec![up[k]; points.len()] } else { Vec::new() };
                        let (images, turned) = carried_with_normals(&field, &points, &normals);
                        let expected = lift * k as f32;
                        for (p, image) in points.iter().zip(&images) {
                            let error = (*image - *p - expected).length();
                            assert!(
                                error < 1e-4,
                                "{gap} {up:?} {method:?} {with_normals}: plate {k}, {p}: {error}"
                            );
                        }
                        assert!(turned.iter().all(|n| n.distance(up[k]) < 1e-4));
                    }
                }
            }
        }
    }
}

#[test]
fn degenerate_samples_make_no_spikes() {
    let line: Vec<Vec3> = (0..60).map(|i| Vec3::X * i as f32 / 60.0).collect();
    let isolated: Vec<Vec3> = patch(20).chain([Vec3::new(3.0, 2.0, 1.0)]).collect();
    let coincident: Vec<Vec3> = patch(12).flat_map(|p| [p; 9]).collect();
    let sparse_and_dense: Vec<Vec3> =
        patch(10).chain(patch(60).map(|p| p * Vec3::new(0.1, 1.0, 0.1))).collect();
    let all_at_once = vec![Vec3::ONE; 50];
    let few = vec![Vec3::ZERO, Vec3::X, Vec3::Z];
    for rest in [line, isolated, coincident, sparse_and_dense, all_at_once, few, vec![Vec3::Y]] {
        let set = SampleSet::new(rest.clone(), Vec::new()).expect("samples");
        let around = RestGeometry::new(&set);
        let noise = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1000) as f32 / 1000.0;
        let maps: [Box<dyn Fn(usize, Vec3) -> Vec3>; 4] = [
            // Collapsed to a point, to a plane, turned inside out in part, and noise.
            Box::new(|_, _| Vec3::ONE),
            Box::new(|_, p| p * Vec3::new(1.0, 0.0, 1.0)),
            Box::new(|_, p| if p.x > 0.5 { Vec3::new(1.0 - p.x, p.y, p.z) } else { p }),
            Box::new(|i, p| p + Vec3::new(noise(i, 1), noise(i, 2), noise(i, 3))),
        ];
        for (m, map) in maps.iter().enumerate() {
            let deformed: Vec<Vec3> = rest.iter().enumerate().map(|(i, p)| map(i, *p)).collect();
            for method in [Method::BlendedJets, Method::ProjectedBarycentric] {
                let field = DeformationField::new(&around, &deformed, method);
                let points: Vec<Vec3> =
                    rest.iter().flat_map(|p| [*p, *p + Vec3::new(0.0005, 0.0015, -0.0003)]).collect();
                for (i, image) in carried(&field, &points).iter().enumerate() {
                    // The displacements differ by 1.8 at most: no further from the image of its own sample
                    // than twice that.
                    let own = deformed[i / 2];
                    assert!(
                        image.is_finite() && image.distance(own) < 3.6,
                        "map {m}, {method:?}: {own} {image}"
                    );
                }
            }
        }
    }
}

#[test]
fn samples_between_two_sheets_do_not_join_them() {
    // A third of the spacing apart, facing the same way; one sample of 80 has vertices of both in its
    // cluster.
    let n = 50;
    let gap = Vec3::Y * 0.3 / n as f32;
    let sheet = patch(n).enumerate();
    let samples: Vec<Vec3> =
        sheet.flat_map(|(i, p)| if i % 40 == 7 { vec![p + 0.5 * gap] } else { vec![p, p + gap] }).collect();
    let map = |p: Vec3| Quat::from_rotation_y(2.0 * p.y + p.x) * p;
    let deformed: Vec<Vec3> = samples.iter().map(|p| map(*p)).collect();
    let set = SampleSet::new(samples, Vec::new()).expect("samples");
    let around = RestGeometry::new(&set);
    let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
    let points: Vec<Vec3> = patch(97).filter(inner).flat_map(|p| [p, p + gap]).collect();
    let images = carried(&field, &points);
    let errors = points.iter().zip(images).map(|(p, image)| map(*p).distance_squared(image));
    let rms = (errors.sum::<f32>() / points.len() as f32).sqrt();
    assert!(rms < 1e-5, "{rms}");
}

#[test]
fn a_map_that_bends_across_gentle_relief_is_not_taken_for_shear() {
    // A rolling sheet whose samples tell little about the direction across it, and places that lie off it by
    // a fiftieth of the spacing, as detail does.
    let height = |p: Vec3| 0.05 * (6.0 * p.x).sin() * (5.0 * p.z).cos();
    let rolling = |n: usize| patch(n).map(move |p| Vec3::new(p.x, height(p), p.z));
    let map = |p: Vec3| {
        let d = p - Vec3::new(0.6, 0.0, 0.4);
        p + 0.1 * (-d.length_squared() / 0.04).exp() * Vec3::new(0.6, 0.64, 0.48)
    };
    let set = SampleSet::new(rolling(100).collect(), Vec::new()).expect("samples");
    let deformed: Vec<Vec3> = set.positions.iter().map(|p| map(*p)).collect();
    let around = RestGeometry::new(&set);
    let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
    let points: Vec<Vec3> = rolling(97).filter(inner).map(|p| p + 2e-4 * Vec3::Y).collect();
    let images = carried(&field, &points);
    let errors = points.iter().zip(images).map(|(p, image)| map(*p).distance_squared(image));
    let rms = (errors.sum::<f32>() / points.len() as f32).sqrt();
    // 1.4e-4 if the affine map takes the bend for shear.
    assert!(rms < 7e-5, "{rms}");
}

/// Corners of a soup are found once for each place: their positions and their number are those of corners one
/// by one.
#[test]
fn corners_at_one_place_go_where_one_goes() {
    let set = SampleSet::new(patch(40).collect(), Vec::new()).expect("samples");
    let deformed: Vec<Vec3> =
        set.positions.iter().map(|p| if p.x > 0.5 { *p + Vec3::Y * (p.x - 0.5) } else { *p }).collect();
    let points: Vec<DVec3> = patch(97).map(|p| p.as_dvec3()).collect();
    let corners: Vec<DVec3> = (0..points.len() - 98)
        .flat_map(|i| [i, i + 1, i + 97, i + 1, i + 98, i + 97])
        .map(|i| points[i])
        .collect();
    let by = |carry: &dyn Fn(&DeformationField<'_>, &mut [Moved<'_>])| {
        let around = RestGeometry::new(&set);
        around.cells();
        let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
        let mut positions = corners.clone();
        let moved =
            Moved { positions: &mut positions, normals: &mut [], gradients: &mut [], figures: &mut [] };
        carry(&field, &mut [moved]);
        let counts: Vec<u64> = (0..set.len()).map(|i| around.vertices_of(i)).collect();
        (positions, counts)
    };
    let of_places =
        by(&|field, moved| carry_on_this_thread(std::slice::from_ref(field), &LOCAL, &corners, None, moved));
    let one_by_one = by(&|field, moved| carry(std::slice::from_ref(field), &LOCAL, &corners, None, moved));
    assert!(of_places == one_by_one);
    assert!(of_places.0 != corners);
}
