//! Measures by which samples are spread, where a small part of a model has many of its vertices.

use glam::{DVec3, Vec3};
use simod_core::refinement::{Finer, Refining, SpaceSelection, refine};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{By, Grouping, Sampling, Splitting, Target};
use simod_generate::Shape;
use simod_model::progress::Silent;

use crate::body::{Body, rms_distance, sample_file, worst_distance};
use crate::cells::Saved;

/// Ratio of the sphere's area to that of the cap.
const RATIO: f64 = 1e6;

/// Half of the vertices of a unit sphere are evenly in a cap about +z, the others evenly elsewhere.
fn sphere_with_a_dense_cap(vertices: u32) -> Body {
    let half = vertices / 2;
    let point = |i: u32| {
        let part = |i: u32| (f64::from(i) + 0.5) / f64::from(half);
        // Distance of the point below the pole.
        let (edge, turn) = (2.0 / RATIO, 2.399_963_229_728_653 * f64::from(i));
        let below = if i < half { edge * part(i) } else { edge + (2.0 - edge) * part(i - half) };
        let radius = (below * (2.0 - below)).sqrt();
        DVec3::new(radius * turn.cos(), radius * turn.sin(), 1.0 - below)
    };
    let positions: Vec<DVec3> = (0..vertices).map(point).collect();
    Body { normals: positions.iter().map(|p| p.as_vec3()).collect(), positions, faces: Vec::new() }
}

fn by(by: By, samples: u64) -> Sampling {
    Sampling { target: Target::Samples(samples), by, ..Sampling::default() }
}

/// Samples in the cap.
fn in_cap(sampled: &SampledModel) -> usize {
    let edge = (4.0 / RATIO).sqrt() * 1.001;
    let is_inside = |p: &&Vec3| {
        let p = sampled.frame.to_model(**p);
        p.z > 0.0 && p.truncate().length() < edge
    };
    sampled.samples.positions.iter().filter(is_inside).count()
}

#[test]
fn finer_parts_get_finer_samples() {
    let cloud = sphere_with_a_dense_cap(200_000);
    for body in [cloud.clone(), cloud.without_normals()] {
        let sampled = By::ALL.map(|rule| body.sampled(by(rule, 10_000)));
        let [error, area, vertices] = &sampled;
        sampled.iter().for_each(|s| assert!((9_900..=10_000).contains(&s.samples.len())));
        assert!(in_cap(error) < 50 && in_cap(area) < 50, "{} and {}", in_cap(error), in_cap(area));
        let found = in_cap(vertices);
        assert!((2000..5000).contains(&found), "{found} samples in the cap");
        // Loss of the rest of the sphere: a third of the samples less, and so a fifth of the distance more.
        let rest = &body.positions[100_000..];
        let worse = |s| (rms_distance(s, rest), worst_distance(s, rest));
        let ((rms, worst), (rms_before, worst_before)) = (worse(vertices), worse(error));
        assert!(
            rms < 1.4 * rms_before && worst < 1.5 * worst_before,
            "{rms} of {rms_before}, {worst} of {worst_before}"
        );
        // Gain of the cap.
        let cap = &body.positions[..100_000];
        assert!(rms_distance(vertices, cap) < 0.1 * rms_distance(error, cap));
    }
}

/// Few vertices beside many are not taken for a part of these.
#[test]
fn around_a_fine_part_samples_are_graded() {
    let body = sphere_with_a_dense_cap(200_000);
    let sampled = body.sampled(by(By::Vertices, 10_000));
    let edge = (4.0 / RATIO).sqrt();
    let around = |p: &&DVec3| p.z > 0.0 && (edge * 1.001..20.0 * edge).contains(&p.truncate().length());
    for p in body.positions.iter().filter(around) {
        let off = f64::from(worst_distance(&sampled, &[*p])) * sampled.frame.scale;
        assert!(off < p.truncate().length() - 0.5 * edge, "at {p} the nearest sample is {off} away");
    }
}

#[test]
fn by_area_samples_are_as_far_apart_everywhere() {
    let body = Body::generated(Shape::Amphora, 60_000);
    let [even, bent] = [By::Area, By::Error].map(|rule| body.sampled(by(rule, 3000)));
    let most = |s: &SampledModel| worst_distance(s, &body.positions);
    assert!(most(&even) < 0.8 * most(&bent), "{} and {}", most(&even), most(&bent));
    let rms = |s: &SampledModel| rms_distance(s, &body.positions);
    assert!(rms(&even) < rms(&bent), "{} and {}", rms(&even), rms(&bent));
}

/// A model whose vertices are as near to each other everywhere is sampled as by error.
#[test]
fn an_even_model_is_sampled_by_error() {
    let body = Body::generated(Shape::BumpyPlane, 60_000);
    let [error, vertices] = [By::Error, By::Vertices].map(|rule| body.sampled(by(rule, 3000)));
    let rms = |s: &SampledModel| rms_distance(s, &body.positions);
    let ratio = rms(&vertices) / rms(&error);
    assert!((0.9..1.1).contains(&ratio), "{ratio} times as far");
}

#[test]
fn a_bound_holds_whatever_samples_are_spread_by() {
    for body in [sphere_with_a_dense_cap(40_000), Body::generated(Shape::Cactus, 40_000)] {
        for (rule, error) in By::ALL.into_iter().flat_map(|rule| [(rule, 1e-2), (rule, 2e-3)]) {
            let sampled =
                body.sampled(Sampling { target: Target::Error(error), by: rule, ..Sampling::default() });
            let most = 12.5 * error * sampled.local_diagonal();
            let worst = f64::from(worst_distance(&sampled, &body.positions));
            assert!(worst <= most * 1.0001, "{rule:?}: {worst} beyond {most}");
        }
    }
}

/// The folder names the measure, cells that are made again are the same, and a refinement goes on by it.
#[test]
fn the_rule_is_kept() {
    let body = sphere_with_a_dense_cap(60_000);
    for rule in By::ALL {
        let saved = Saved::new(&body, by(rule, 2000));
        let text = std::fs::read_to_string(saved.folder().join("simod.toml")).unwrap();
        assert_eq!(text.contains(&format!("by = \"{}\"", rule.name())), rule != By::Error, "{text}");
        assert_eq!(saved.load().sampling.by, rule);
        let bytes = saved.bytes();
        std::fs::remove_file(saved.folder().join("cells.bin")).unwrap();
        saved.cells();
        assert!(saved.bytes() == bytes, "{rule:?}");

        let sampled = sample_file(&saved.model(), by(rule, 2000));
        let model = simod_model::open(&saved.model()).unwrap();
        let everywhere = |_: DVec3| -1.0;
        let selection = SpaceSelection { distance: &everywhere, so_far: None, at_rest: true };
        let how = Refining { finer: Finer::Factor(3.0), memory_limit: None, shapes: Vec::new() };
        let folder = saved.folder();
        let refined =
            refine(&sampled, model.as_ref(), selection, &how, folder.parent().unwrap(), &Silent).unwrap();
        let refined = refined.sampled.unwrap();
        assert_eq!(refined.sampling.by, rule);
        let (found, before) = (in_cap(&refined), in_cap(&sampled));
        if rule == By::Vertices {
            assert!(found > 2 * before && before > 300, "{found} samples in the cap, and {before} before");
        } else {
            assert!(found < 30, "{found} samples in the cap");
        }
    }
}

#[test]
fn groups_and_octrees_are_spread_alike() {
    let body = Body::generated(Shape::Amphora, 100_000);
    for rule in [By::Area, By::Vertices] {
        let whole = body.sampled(by(rule, 3000));
        let grouped = body.sampled(Sampling { grouping: Grouping::Level(4), ..by(rule, 3000) });
        let octree = body.sampled(Sampling { splitting: Splitting::Octree, ..by(rule, 3000) });
        let rms = |s: &SampledModel| rms_distance(s, &body.positions);
        for other in [&grouped, &octree] {
            assert!((0.85..1.15).contains(&(rms(other) / rms(&whole))), "{rule:?}");
        }
    }
}
