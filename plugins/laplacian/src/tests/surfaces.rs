//! Surfaces as they come: without triangles, in several parts, with bad ones.

use super::scene::{Scene, held_at_ends, tube, turn};
use crate::operators::Operators;
use crate::surface::{TriangleWeights, elements};
use glam::DVec3;
use proptest::prelude::*;
use simod_plugin_api::{Affine, Host, Role};

fn v(p: &[f32; 3]) -> DVec3 {
    DVec3::from(p.map(f64::from))
}

/// A plane with shifted points: `n` by `n`, tilted in space.
fn plane(n: u32) -> Scene {
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    for j in 0..n {
        for i in 0..n {
            let shift = |k: u32| f64::from((7 * i + 5 * j + k * i * j) % 11) / 11.0 - 0.5;
            let (x, y) = (f64::from(i) + 0.6 * shift(3), f64::from(j) + 0.6 * shift(2));
            let p = (x * DVec3::new(0.8, 0.0, 0.6) + y * DVec3::new(0.36, 0.8, -0.48)) / f64::from(n);
            points.push(p.as_vec3().to_array());
            if i > 0 && j > 0 {
                let [a, b, c, d] = [(j - 1) * n + i - 1, (j - 1) * n + i, j * n + i, j * n + i - 1];
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    Scene::new(points, triangles)
}

/// The Laplacian of a linear function is nothing, away from the border.
#[test]
fn linear_functions_of_a_plane_have_no_laplacian() {
    const N: u32 = 20;
    let mesh = plane(N);
    let cloud = mesh.clone().cloud(20);
    for (name, scene, weights) in [
        ("cotangent", &mesh, TriangleWeights::Cotangent),
        ("robust", &mesh, TriangleWeights::Robust),
        ("neighbours", &cloud, TriangleWeights::Robust),
    ] {
        let rest: Vec<DVec3> = scene.points.iter().map(v).collect();
        let host = Host::new(&());
        let all = scene.with_input(|input| elements(input, &rest, weights, &host)).unwrap();
        let operators = Operators::new(&rest, &all, &host).unwrap();
        let area: f64 = operators.areas.iter().sum();
        assert!((area - 0.9).abs() < 0.1, "{name}: an area of {area}");
        for i in 0..N {
            for j in 0..N {
                // At the border edges are flipped, and neighbours lack on one side.
                if !(4..N - 4).contains(&i) || !(4..N - 4).contains(&j) {
                    continue;
                }
                let node = (j * N + i) as usize;
                let sum: DVec3 = operators.laplacian(node).map(|(k, l)| l * rest[k]).sum();
                // Positions are of single precision, and so is the plane.
                assert!(sum.length() < 1e-5, "{name}: {sum} at {i} {j}");
                let least = operators.laplacian(node).filter(|(k, _)| *k != node).map(|(_, l)| -l);
                let least = least.fold(f64::INFINITY, f64::min);
                assert!(name == "cotangent" || least > -1e-6, "{name}: {least}");
            }
        }
    }
}

#[test]
fn points_alone_deform_as_their_triangles_do() {
    let mesh = held_at_ends(tube(40, 60, 0.15), 0.2);
    let cloud = mesh.clone().cloud(24);
    let motion = turn(DVec3::X, 50.0, DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, -0.2, -0.1));
    // Deformations that may crease do so elsewhere.
    for mode in ["smooth-arap", "laplacian", "bi-laplacian"] {
        let run = |scene: &Scene| Scene { mode, ..scene.clone() }.run(&[motion]);
        let apart = run(&mesh).iter().zip(run(&cloud)).map(|(a, b)| v(a).distance(v(&b))).fold(0.0, f64::max);
        println!("{mode}: {apart:.4} apart");
        assert!(apart < 1e-3, "{mode}: {apart}");
    }
}

/// A part that nothing holds goes rigidly with the samples next to it; a lone point is held by its
/// neighbours, if it has any.
#[test]
fn loose_parts_follow() {
    let scene = held_at_ends(tube(24, 40, 0.1), 0.2);
    let tube_samples = scene.points.len();
    let button = [[0.12, 0.0, 0.95], [0.14, 0.0, 0.95], [0.12, 0.02, 0.95], [0.12, 0.0, 0.97]];
    let foot = [[0.12, 0.0, 0.05], [0.14, 0.0, 0.05], [0.12, 0.02, 0.05]];
    let mut scene = scene;
    scene.points.extend(button);
    scene.points.extend(foot);
    let first = tube_samples as u32;
    scene.triangles.extend([[0, 1, 2], [0, 2, 3], [4, 5, 6]].map(|t: [u32; 3]| t.map(|i| first + i)));
    for (_, weights) in &mut scene.regions {
        weights.resize(tube_samples + 7, 0.0);
    }
    // With neighbours, the motion of the part's whole surroundings is known.
    let graph = scene.clone().cloud(12).neighbours;
    let motion = turn(DVec3::Y, 40.0, DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.3, 0.1, 0.0));
    for mode in ["smooth-arap", "bi-laplacian"] {
        let deformed = Scene { mode, neighbours: graph.clone(), ..scene.clone() }.run(&[motion]);
        for (p, q) in scene.points.iter().zip(&deformed).skip(tube_samples) {
            let expected = if p[2] > 0.5 { DVec3::from(motion.apply(p.map(f64::from))) } else { v(p) };
            assert!(expected.distance(v(q)) < 1e-5, "{mode}: {p:?} goes to {q:?}");
        }
    }

    let mut scene = held_at_ends(tube(24, 40, 0.1), 0.2);
    scene.points.push([0.1005, 0.001, 0.5]);
    scene.regions.iter_mut().for_each(|(_, w)| w.push(0.0));
    let graph = scene.clone().cloud(12).neighbours;
    let deformed = Scene { neighbours: graph.clone(), ..scene.clone() }.run(&[motion]);
    let near = graph[tube_samples][0] as usize;
    let before = v(&scene.points[tube_samples]).distance(v(&scene.points[near]));
    let after = v(&deformed[tube_samples]).distance(v(&deformed[near]));
    assert!((before - after).abs() < 0.01, "{before} {after}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Results are finite, and held samples where they belong, whatever the triangles and neighbours are.
    #[test]
    fn anything_gives_finite_positions(
        points in proptest::collection::vec(proptest::array::uniform3(0_u8..5), 2..40),
        triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..40), 0..60),
        with_neighbours in any::<bool>(),
        mode in prop::sample::select(vec!["arap", "smooth-arap", "laplacian", "bi-laplacian"]),
        weights in prop::sample::select(vec!["robust", "cotangent"]),
        handle in prop::sample::select(vec![1.0_f32, 0.5, 0.001]),
    ) {
        let n = points.len() as u32;
        let points: Vec<[f32; 3]> = points.into_iter().map(|p| p.map(f32::from)).collect();
        let scene = Scene::new(points, Vec::new());
        let neighbours = if with_neighbours { scene.clone().cloud(8).neighbours } else { Vec::new() };
        let triangles = triangles.into_iter().map(|t| t.map(|i| i % n)).collect();
        let mut scene = Scene { neighbours, triangles, mode, weights, iterations: 5.0, ..scene };
        let only = |k: usize, w: f32| (0..n as usize).map(|i| if i == k { w } else { 0.0 }).collect();
        scene.regions = vec![(Role::FIXED, only(0, 1.0)), (Role::HANDLE, only(1, handle))];
        let motion: Affine = turn(DVec3::X, 170.0, DVec3::ONE, DVec3::new(1.0, -2.0, 0.5));
        let deformed = scene.run(&[motion]);
        prop_assert!(deformed.as_flattened().iter().all(|x| x.is_finite()));
        prop_assert_eq!(deformed[0], scene.points[0]);
    }
}
