//! Promises that hold for the samples of any points at all.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::cluster::REACH_WEIGHT;
use simod_core::sampling::{By, Grouping, Sampling, Splitting, Target};

use crate::body::{Body, worst_distance};

/// Arrangement of points.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Space,
    Clusters,
    Line,
    Plane,
    /// Points of which many are at the same few places.
    Coincident,
    /// Points of which all but one are in one cell of the coarse grid.
    OneCell,
}

fn place(kind: Kind, p: DVec3) -> DVec3 {
    match kind {
        Kind::Space => p,
        Kind::Clusters => (p * 2.0).round() + p * 1e-4,
        Kind::Line => DVec3::new(1.0, -0.3, 0.7) * p.x,
        Kind::Plane => DVec3::new(1.0, 0.2, -0.4) * p.x + DVec3::new(0.1, 1.0, 0.3) * p.y,
        Kind::Coincident => (p * 2.0).round(),
        Kind::OneCell => p * 1e-3,
    }
}

fn body() -> impl Strategy<Value = Body> {
    let kind = prop_oneof![
        Just(Kind::Space),
        Just(Kind::Clusters),
        Just(Kind::Line),
        Just(Kind::Plane),
        Just(Kind::Coincident),
        Just(Kind::OneCell),
    ];
    let vector = || (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| DVec3::new(x, y, z));
    // Some normals are missing, of any length, or no numbers.
    let normal = prop_oneof![
        8 => vector().prop_map(|n| n.normalize_or(DVec3::Y).as_vec3()),
        1 => vector().prop_map(|n| 100.0 * n.as_vec3()),
        1 => Just(Vec3::ZERO),
        1 => Just(Vec3::NAN),
    ];
    let points = proptest::collection::vec((vector(), normal), 1..400);
    (kind, points, any::<bool>(), -30..=30i32, prop_oneof![Just(0.0), -3.0..3.0f64]).prop_map(
        |(kind, points, with_normals, exponent, offset)| {
            let (scale, offset) = (10f64.powi(exponent), DVec3::splat(offset));
            let mut body = Body::default();
            for (p, n) in points {
                body.positions.push((place(kind, p) + offset) * scale);
                body.normals.push(n);
            }
            if let (Kind::OneCell, Some(first)) = (kind, body.positions.first_mut()) {
                *first = (DVec3::ONE + offset) * scale;
            }
            if with_normals { body } else { body.without_normals() }
        },
    )
}

fn by() -> impl Strategy<Value = By> {
    prop_oneof![Just(By::Error), Just(By::Area), Just(By::Vertices)]
}

fn splitting() -> impl Strategy<Value = Splitting> {
    prop_oneof![Just(Splitting::Layered), Just(Splitting::VolumeSurface), Just(Splitting::Octree)]
}

/// Number of places that are told apart in local coordinates, and of places with different normals: where two
/// sheets touch, a place has a sample on each.
fn distinct(sampled: &SampledModel, body: &Body) -> (usize, usize) {
    let bits = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let places = body.positions.iter().map(|p| bits(sampled.frame.to_local(*p)));
    let normals = body.normals.iter().map(|n| bits(*n)).chain(std::iter::repeat([0; 3]));
    (places.clone().collect::<BTreeSet<_>>().len(), places.zip(normals).collect::<BTreeSet<_>>().len())
}

/// Checks the promises that hold whatever the target: samples are within the model, but for `outside`.
fn check_samples(sampled: &SampledModel, body: &Body, outside: f64) -> Result<(), TestCaseError> {
    let samples = &sampled.samples;
    let slack = DVec3::splat(outside + 1e-6 * sampled.bounds.diagonal());
    for p in samples.positions.iter().map(|p| sampled.frame.to_model(*p)) {
        let inside = p.cmpge(sampled.bounds.min - slack).all() && p.cmple(sampled.bounds.max + slack).all();
        prop_assert!(inside, "{p} is outside of the model");
    }
    prop_assert_eq!(samples.normals().len(), samples.len());
    for (normal, known) in samples.normals().iter().zip(samples.known_normals()) {
        prop_assert!(normal.is_normalized(), "{normal}");
        prop_assert!(*known == Vec3::ZERO || known == normal);
    }
    prop_assert!(!body.normals.is_empty() || samples.known_normals().is_empty());
    Ok(())
}

/// Number of samples that may be missing, as splits come in eights, and clusters alike are split together or
/// not at all.
const FEW: usize = 16;

/// Cases of each kind.
const CASES: u32 = if cfg!(debug_assertions) { 48 } else { 256 };

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(CASES) })]

    #[test]
    fn an_error_bounds_how_far_a_sample_is(
        body in body(), splitting in splitting(), by in by(), exponent in -5.0..0.0f64, grid in 2u32..40,
    ) {
        let e = 10f64.powf(exponent);
        let sampling =
            Sampling { target: Target::Error(e), grid: Some(grid), splitting, by, ..Sampling::default() };
        let sampled = body.sampled(sampling);
        check_samples(&sampled, &body, 0.0)?;
        let diagonal = sampled.local_diagonal();
        let worst = f64::from(worst_distance(&sampled, &body.positions));
        prop_assert!(worst <= e * diagonal / REACH_WEIGHT + 1e-5 * diagonal, "{} beyond {}", worst, e);
    }

    #[test]
    fn a_number_of_samples_is_met(
        body in body(), splitting in splitting(), by in by(), n in 1usize..300, grid in 2u32..40,
    ) {
        let target = Target::Samples(n as u64);
        let sampled = body.sampled(Sampling { target, grid: Some(grid), splitting, by, ..Sampling::default() });
        check_samples(&sampled, &body, 0.0)?;
        let (found, (places, sides)) = (sampled.samples.len(), distinct(&sampled, &body));
        prop_assert!(found <= n.min(sides), "{} samples instead of {} of {}", found, n, sides);
        if sides <= n {
            // All that there is to tell apart.
            prop_assert!(found >= places, "{} samples of {} points", found, places);
            prop_assert_eq!(worst_distance(&sampled, &body.positions), 0.0);
        } else {
            prop_assert!(found + FEW >= n.min(places) * 98 / 100, "{} samples instead of {}", found, n);
        }
    }

    #[test]
    fn groups_of_any_points_give_no_more_samples_than_asked_for(
        body in body(), splitting in splitting(), by in by(), n in 1usize..300, grid in 2u32..40, level in 0u32..8,
    ) {
        let (target, grouping) = (Target::Samples(n as u64), Grouping::Level(level));
        let sampled =
            body.sampled(Sampling { target, grid: Some(grid), splitting, by, grouping, ..Sampling::default() });
        let edge = sampled.cell_size / f64::from(1 << level);
        check_samples(&sampled, &body, edge)?;
        prop_assert!(sampled.samples.len() <= n, "{} samples instead of {}", sampled.samples.len(), n);
    }
}
