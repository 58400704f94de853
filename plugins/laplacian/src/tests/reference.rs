//! Results are libigl's, on the same regions: `tests/reference/laplacian.py` says how the figures came about.
//!
//! With cotangents as they are, `bi-laplacian` is libigl's `harmonic` of order 2, and `arap` its `ARAP` when
//! both have converged. The default, robust weights, is another discretisation on purpose: cotangents of the
//! intrinsic Delaunay triangulation, which have no negative weights; it is held against libigl's own, for
//! closed models, since ours also flips edges of borders (over to the back). `laplacian` has no counterpart
//! there.

use super::scene::Scene;
use glam::DVec3;
use serde_json::Value;
use simod_plugin_api::{Affine, Role};
use std::path::Path;

/// Largest difference from libigl's results, as a fraction of the diagonal.
const AGREES: f64 = 1e-4;

struct Reference {
    scene: Scene,
    motions: Vec<Affine>,
    figures: Value,
}

fn figures(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/laplacian.json");
    let text = std::fs::read_to_string(path).unwrap();
    let mut all: Value = serde_json::from_str(&text).unwrap();
    all[name].take()
}

/// FNV-1a, as the script has it.
fn fingerprint(points: &[[f32; 3]], triangles: &[[u32; 3]], selection: &[i32]) -> String {
    let points = points.as_flattened().iter().flat_map(|x| x.to_le_bytes());
    let triangles = triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes());
    let selection = selection.iter().flat_map(|i| i.to_le_bytes());
    let hash = points
        .chain(triangles)
        .chain(selection)
        .fold(0xcbf2_9ce4_8422_2325_u64, |h, byte| (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    format!("{hash:016x}")
}

impl Reference {
    /// The figures for a model, of which region 0 is fixed and the others are handles.
    fn new(name: &str, points: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>, selection: &[i32]) -> Self {
        let figures = figures(name);
        assert_eq!(figures["fingerprint"], fingerprint(&points, &triangles, selection), "another {name}");
        let number = |x: &Value| x.as_f64().unwrap();
        let motion =
            |m: &Value| Affine { rows: std::array::from_fn(|r| std::array::from_fn(|c| number(&m[r][c]))) };
        let motions: Vec<Affine> = figures["motions"].as_array().unwrap().iter().map(motion).collect();
        let mut scene = Scene::new(points, triangles);
        scene.weights = "cotangent";
        scene.decrease = 1e-12;
        for region in 0..motions.len() {
            let role = if region == 0 { Role::FIXED } else { Role::HANDLE };
            let weights = selection.iter().map(|s| f32::from(u8::from(*s == region as i32)));
            scene.regions.push((role, weights.collect()));
        }
        Self { scene, motions: motions[1..].to_vec(), figures }
    }

    /// The largest distance from libigl's positions, as a fraction of the diagonal.
    fn difference(&self, mode: &'static str, weights: &'static str, figures: &str) -> f64 {
        let scene = Scene { mode, weights, ..self.scene.clone() };
        let found = scene.run(&self.motions);
        let every = self.figures["every"].as_u64().unwrap() as usize;
        let expected = self.figures["positions"][figures].as_array().unwrap();
        let kept: Vec<_> = found.iter().step_by(every).collect();
        assert_eq!(kept.len(), expected.len());
        let distance = |(p, q): (&&[f32; 3], &Value)| {
            DVec3::from(p.map(f64::from))
                .distance(DVec3::from_array(std::array::from_fn(|k| q[k].as_f64().unwrap())))
        };
        let worst = kept.iter().zip(expected).map(distance).fold(0.0, f64::max);
        worst / self.figures["diagonal"].as_f64().unwrap()
    }

    fn agrees(&self, mode: &'static str, weights: &'static str, figures: &str) {
        let worst = self.difference(mode, weights, figures);
        println!("{mode}, {weights}: {worst:.1e} of the diagonal");
        assert!(worst < AGREES, "{mode}: {worst:.1e}");
    }
}

/// Bumpy plane as the script makes it.
fn bumpy_plane() -> Reference {
    const N: i32 = 24;
    let (mut points, mut triangles, mut selection) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..N {
        for i in 0..N {
            let inner = (1..N - 1).contains(&i) && (1..N - 1).contains(&j);
            let shift = |by: i32| if inner { f64::from(by) / 10.0 } else { 0.0 };
            let x = (f64::from(i) + shift((5 * i + 3 * j) % 7 - 3)) / f64::from(N - 1);
            let y = (f64::from(j) + shift((3 * i + 5 * j) % 5 - 2)) / f64::from(N - 1);
            let z = 0.5 * (4.0 * x * (1.0 - x)) * (4.0 * y * (1.0 - y)) * (y - 0.3);
            points.push([x, y, z].map(|x| x as f32));
            let middle = (i - 14).abs() <= 2 && (j - 12).abs() <= 2;
            selection.push(if !inner {
                0
            } else if middle {
                1
            } else {
                -1
            });
        }
    }
    for j in 0..N - 1 {
        for i in 0..N - 1 {
            let [a, b, c, d] =
                [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(|[i, j]| (j * N + i) as u32);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    Reference::new("bumpy-plane", points, triangles, &selection)
}

/// Knight of libigl, where its file is there.
fn knight() -> Option<Reference> {
    let model = simod_tests::real_model("decimated-knight.off")?;
    let selection = simod_tests::real_model("decimated-knight-selection.dmat")?;
    let model = std::fs::read_to_string(model).unwrap();
    let mut lines = model.lines().skip(1);
    let mut counts = lines.next().unwrap().split_whitespace().map(|x| x.parse::<usize>().unwrap());
    let (vertices, faces) = (counts.next().unwrap(), counts.next().unwrap());
    let points = lines.by_ref().take(vertices).map(|line| {
        let mut x = line.split_whitespace().map(|x| x.parse::<f64>().unwrap() as f32);
        std::array::from_fn(|_| x.next().unwrap())
    });
    let points: Vec<[f32; 3]> = points.collect();
    let triangles = lines.take(faces).map(|line| {
        let mut i = line.split_whitespace().skip(1).map(|i| i.parse::<u32>().unwrap());
        std::array::from_fn(|_| i.next().unwrap())
    });
    let triangles = triangles.collect();
    let selection = std::fs::read_to_string(selection).unwrap();
    let selection: Vec<i32> = selection.split_whitespace().skip(2).map(|s| s.parse().unwrap()).collect();
    Some(Reference::new("decimated-knight", points, triangles, &selection))
}

#[test]
fn a_bumpy_plane_goes_where_libigl_has_it() {
    let reference = bumpy_plane();
    reference.agrees("bi-laplacian", "cotangent", "bi-laplacian");
    reference.agrees("arap", "cotangent", "arap");
}

#[test]
fn the_knight_goes_where_libigl_has_it() {
    let Some(reference) = knight() else { return };
    reference.agrees("bi-laplacian", "cotangent", "bi-laplacian");
    reference.agrees("bi-laplacian", "robust", "robust");
    reference.agrees("arap", "cotangent", "arap");
    // Results of other methods differ by more than the agreement that is tested.
    assert!(reference.difference("bi-laplacian", "robust", "bi-laplacian") > AGREES);
}
