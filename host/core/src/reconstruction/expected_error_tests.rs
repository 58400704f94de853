//! Tests: the expected error of vertices beside the true one, where the deformation is known.

use std::f32::consts::{PI, TAU};

use glam::{Mat3, Vec3};

use super::homes::Homes;
use super::tests::carried;
use super::{DeformationField, Method, RestGeometry};
use crate::sampling::SampleSet;

/// Samples along each side of the plane.
const SIDE: u32 = 40;

/// A place of a wavy plane of unit size, by its parameters in spacings of the samples.
fn wavy(x: f32, z: f32) -> Vec3 {
    Vec3::new(x, (0.6 * x).sin() + (0.45 * z).cos(), z) / SIDE as f32
}

/// The point `i` of a sequence that fills the unit square evenly (M. Roberts' R2).
fn filling(i: u32) -> (f32, f32) {
    let [x, z] = [0.754_877_666, 0.569_840_291].map(|step: f64| (f64::from(i) * step).fract() as f32);
    (x, z)
}

/// Half a turn from one border to the other.
fn twisted(p: Vec3) -> Vec3 {
    let (sin, cos) = (PI * p.z).sin_cos();
    Vec3::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y, p.z)
}

/// Samples of the wavy plane, one in each cell of a grid.
fn wavy_samples() -> SampleSet {
    let sample = |i: u32| {
        let (x, z) = filling(i);
        wavy((i % SIDE) as f32 + 0.7 * x, (i / SIDE) as f32 + 0.7 * z)
    };
    SampleSet::new((0..SIDE * SIDE).map(sample).collect(), Vec::new()).expect("samples")
}

/// Deformation that expects errors of vertices.
fn expecting<'a>(around: &'a RestGeometry<'a>, deformed: &'a [Vec3]) -> DeformationField<'a> {
    let mut field = DeformationField::new(around, deformed, Method::BlendedJets);
    field.expected = field.around_samples(&[]);
    field.expecting_of_vertices()
}

/// True and expected error of vertices at these places of the twisted plane.
fn compared(places: &[Vec3]) -> Vec<(f32, f32)> {
    let samples = wavy_samples();
    let around = RestGeometry::new(&samples);
    let deformed: Vec<Vec3> = samples.positions.iter().map(|p| twisted(*p)).collect();
    let field = expecting(&around, &deformed);
    let homes = Homes::new(&around).find_at(places);
    let compare = |((p, image), home): ((&Vec3, Vec3), u32)| {
        (image.distance(twisted(*p)), field.expected_at(home as usize, *p, image - *p))
    };
    places.iter().zip(carried(&field, places)).zip(homes).map(compare).collect()
}

/// Ratio of the expected error to the true one, each as the root of the mean square.
fn ratio(of: &[(f32, f32)]) -> f32 {
    let squares = |one: fn(&(f32, f32)) -> f32| of.iter().map(|x| one(x).powi(2)).sum::<f32>();
    (squares(|x| x.1) / squares(|x| x.0)).sqrt()
}

/// A vertex beyond the last samples may be reached by one support alone: what the samples around say there
/// tells that this one is not to be relied on.
#[test]
fn beyond_an_open_border_vertices_that_are_off_are_warned_of() {
    let place = |i| {
        let (x, z) = filling(i);
        wavy(-1.2 * x, 2.0 + 36.0 * z)
    };
    let beyond: Vec<Vec3> = (0..10_000).map(place).collect();
    let beyond = compared(&beyond);
    let worst = beyond.iter().map(|x| x.0).fold(0.0, f32::max);
    for t in [worst / 2.0, worst / 4.0] {
        let off: Vec<f32> = beyond.iter().filter(|x| x.0 > t).map(|x| x.1).collect();
        let warned = off.iter().filter(|expected| **expected > t / 3.0).count();
        println!("{warned} of {} beyond {t:.1e}", off.len());
        assert!(off.len() > 20 && warned * 20 >= off.len() * 19, "{warned} of {} beyond {t}", off.len());
    }
    let ratio = ratio(&beyond);
    assert!((0.8..3.0).contains(&ratio), "{ratio}");
}

/// An expansion that fails may have all of the say in a blend with wider supports. It does not count at
/// vertices that it does not reach.
#[test]
fn an_expansion_that_fails_counts_only_where_it_has_a_say() {
    let samples = wavy_samples();
    let around = RestGeometry::new(&samples);
    let deformed: Vec<Vec3> = samples.positions.iter().map(|p| twisted(*p)).collect();
    let mut field = expecting(&around, &deformed);
    // A sample, and one of its ring that does not reach it.
    let beside = |home: usize| {
        let reaches = |i: &usize| field.expansions[*i].within(samples.positions[home]) > 0.0;
        let ring = field.stencils.ring(home).iter().map(|i| *i as usize);
        ring.filter(|i| !reaches(i)).map(|i| (home, i)).next()
    };
    let middle = (SIDE * SIDE / 2) as usize;
    let (home, fails) = (middle..2 * middle).find_map(beside).expect("a neighbour that does not reach");
    let place = samples.positions[home];
    let expected = |field: &DeformationField<'_>| field.expected_at(home, place, twisted(place) - place);
    let before = expected(&field);
    let slope = field.expansions[fails].slope() + Mat3::from_diagonal(Vec3::splat(100.0));
    field.expansions[fails] = field.expansions[fails].with_slope(slope);
    let after = expected(&field);
    println!("{after}, before {before}");
    assert!(after < 30.0 * before, "{after}, before {before}");
}

/// Where numbers of single precision overflow, nothing tells the error: it is beyond any tolerance.
#[test]
fn an_error_that_nothing_tells_is_infinite() {
    let samples = wavy_samples();
    let around = RestGeometry::new(&samples);
    let mut deformed: Vec<Vec3> = samples.positions.iter().map(|p| twisted(*p)).collect();
    let far = (SIDE * SIDE / 2) as usize;
    deformed[far] = Vec3::splat(1e25);
    let field = expecting(&around, &deformed);
    assert_eq!(field.expected[far].largest, f32::INFINITY);
    let beside = |d: Vec3| field.expected_at(far, samples.positions[far] + d, Vec3::splat(1e25));
    let all = [Vec3::ZERO, 0.3 * Vec3::X, 0.5 * Vec3::Z].map(|d| beside(d / SIDE as f32));
    assert!(all.iter().all(|expected| *expected == f32::INFINITY), "{all:?}");
}

/// A place of a torus around the y axis, one unit wide, by its angles as parts of a turn; and the normal.
fn on_torus((u, v): (f32, f32)) -> (Vec3, Vec3) {
    let ((sin_u, cos_u), (sin_v, cos_v)) = ((TAU * u).sin_cos(), (TAU * v).sin_cos());
    let normal = Vec3::new(cos_v * cos_u, sin_v, cos_v * sin_u);
    (0.357 * Vec3::new(cos_u, 0.0, sin_u) + 0.143 * normal, normal)
}

/// The gradient of the twist in a direction.
fn twisted_along(p: Vec3, direction: Vec3) -> Vec3 {
    let (sin, cos) = (PI * p.z).sin_cos();
    let turned = |v: Vec3| Vec3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, v.z);
    turned(direction) + PI * direction.z * turned(Vec3::new(-p.y, p.x, 0.0))
}

/// True and expected error of the gradient across a surface of such places and normals, at samples that are
/// twisted.
fn off_across(on_surface: fn((f32, f32)) -> (Vec3, Vec3)) -> Vec<(f32, f32)> {
    let (places, normals): (Vec<Vec3>, Vec<Vec3>) = (0..5000).map(|i| on_surface(filling(i))).unzip();
    let samples = SampleSet::new(places, Vec::new()).expect("samples");
    let around = RestGeometry::new(&samples);
    let deformed: Vec<Vec3> = samples.positions.iter().map(|p| twisted(*p)).collect();
    let field = expecting(&around, &deformed);
    let compare = |i: usize| {
        let n = normals[i];
        let off = (field.expansions[i].slope() * n + n).distance(twisted_along(samples.positions[i], n));
        let little = 1e-4;
        (off, field.unresolved[i].length(little * n) / little)
    };
    (0..samples.len()).map(compare).collect()
}

/// Samples of a surface that is bent gently everywhere guess the gradient across the surface by that of their
/// neighbours along it. The error of the guess is told by wider neighbourhoods.
#[test]
fn the_error_of_the_gradient_across_is_foretold() {
    let compared = off_across(on_torus);
    let ratio = ratio(&compared);
    let far_off = compared.iter().filter(|x| x.0 > 0.01);
    let warned = far_off.clone().filter(|x| x.1 > 0.01 / 3.0).count();
    println!("{ratio}, {warned} of {}", far_off.clone().count());
    assert!((0.7..2.0).contains(&ratio), "{ratio}");
    assert!(far_off.clone().count() > 100 && warned * 100 >= far_off.count() * 95, "{warned}");
}

/// A place of a gently wavy sheet across the axis of the twist, by its parameters, and the normal.
fn on_sheet((u, v): (f32, f32)) -> (Vec3, Vec3) {
    let (x, y) = (u - 0.5, v - 0.5);
    let ((sin, cos), (other_sin, other_cos)) = ((9.0 * x + 4.0 * y).sin_cos(), (6.0 * y - 2.0 * x).sin_cos());
    let slope = (0.27 * cos + 0.06 * other_sin, 0.12 * cos - 0.18 * other_sin);
    (Vec3::new(x, y, 0.03 * (sin + other_cos)), Vec3::new(-slope.0, -slope.1, 1.0).normalize_or(Vec3::Z))
}

/// A sheet that a map twists about its own normal is hardly strained, and samples agree with their neighbours
/// on a gradient across that all of them have wrong. The waves tell, over a dozen spacings.
#[test]
fn a_gradient_across_that_neighbours_agree_on_and_have_wrong_is_foretold() {
    let compared = off_across(on_sheet);
    let ratio = ratio(&compared);
    let far_off = compared.iter().filter(|x| x.0 > 0.1);
    let warned = far_off.clone().filter(|x| x.1 > 0.1 / 1.5).count();
    println!("{ratio}, {warned} of {}", far_off.clone().count());
    assert!((0.9..1.3).contains(&ratio), "{ratio}");
    assert!(far_off.clone().count() > 100 && warned * 100 >= far_off.count() * 98, "{warned}");
}
