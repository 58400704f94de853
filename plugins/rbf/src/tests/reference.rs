//! Results are SciPy's, on the same points: `tests/reference/rbf.py` tells where the figures come from.

use super::{Setup, distance};
use serde_json::Value;
use simod_plugin_api::{Affine, Bounds, Role};
use std::path::Path;

/// Greatest difference as a part of the diagonal; positions are of single precision.
const AGREES: f64 = 1e-6;

fn numbers<const N: usize>(row: &Value) -> [f64; N] {
    std::array::from_fn(|i| row[i].as_f64().unwrap())
}

/// The largest distance of the plugin's samples from the figures' places, as a fraction of the diagonal.
fn difference(kernel: &'static str, figures: &str) -> f64 {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/rbf.json");
    let golden: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let rows = |name: &str| golden[name].as_array().unwrap().clone();
    let points: Vec<[f32; 3]> = rows("points").iter().map(|p| numbers(p).map(|x| x as f32)).collect();
    let selection: Vec<i64> = rows("selection").iter().map(|s| s.as_i64().unwrap()).collect();
    let motions: Vec<Affine> =
        rows("motions").iter().map(|m| Affine { rows: std::array::from_fn(|r| numbers(&m[r])) }).collect();
    let region = |s: i64| selection.iter().map(|x| f32::from(u8::from(*x == s))).collect();
    let regions = vec![(Role::FIXED, region(0)), (Role::HANDLE, region(1)), (Role::HANDLE, region(2))];
    let corner = |pick: fn(f32, f32) -> f32| {
        std::array::from_fn(|i| f64::from(points.iter().map(|p| p[i]).reduce(pick).unwrap()))
    };
    let bounds = Bounds { min: corner(f32::min), max: corner(f32::max) };
    let setup = Setup {
        kernel,
        support: golden["support"].as_f64().unwrap(),
        // The tolerance is not met before all constraints are centres.
        tolerance: 1e-9,
        bounds,
        ..Setup::new(points, regions)
    };
    let state = setup.prepare(&()).unwrap();
    let found = setup.deform(&state, &motions);
    let free = (0..selection.len()).filter(|&i| selection[i] < 0);
    let expected = golden["displacements"][figures].as_array().unwrap();
    assert_eq!(free.clone().count(), expected.len());
    let off = |(i, d): (usize, &Value)| {
        let (p, d) = (setup.points[i].map(f64::from), numbers::<3>(d));
        distance(found[i].map(f64::from), [p[0] + d[0], p[1] + d[1], p[2] + d[2]])
    };
    free.zip(expected).map(off).fold(0.0, f64::max) / bounds.diagonal()
}

#[test]
fn samples_go_where_scipy_has_them() {
    for kernel in ["triharmonic", "biharmonic", "compact-c2", "compact-c4"] {
        let worst = difference(kernel, kernel);
        println!("{kernel}: {worst:.1e} of the diagonal");
        assert!(worst < AGREES, "{kernel}: {worst:.1e}");
    }
    // The figures of another degree are not met: the test can tell results apart.
    assert!(difference("biharmonic", "degree-0") > 1e-3);
}
