//! The whole plugin, as the host calls it, and its filters.

use super::*;
use proptest::prelude::*;
use simod_plugin_api::{Bounds, Graph, Param, ParamKind, Part, Region, Samples, Triangles};
use std::collections::HashMap;

const BOUNDS: Bounds = Bounds { min: [-1.0; 3], max: [1.0; 3] };

/// Samples with triangles or without, and the parameters.
#[derive(Clone)]
struct Setup {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    fixed: Vec<f32>,
    method: &'static str,
    /// Length of the smoothed bumps from crest to crest.
    size: f64,
    amount: f64,
    steps: f64,
    keep_volume: bool,
}

impl Setup {
    fn new(places: &[DVec3], triangles: Vec<[u32; 3]>) -> Self {
        Self {
            positions: places.iter().map(|p| p.as_vec3().into()).collect(),
            normals: vec![[0.0, 0.0, 1.0]; places.len()],
            triangles,
            fixed: Vec::new(),
            method: "taubin",
            size: 0.3,
            amount: 1.0,
            steps: 8.0,
            keep_volume: false,
        }
    }

    fn places(&self) -> Vec<DVec3> {
        self.positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect()
    }

    fn run(&self) -> PluginResult<Vec<DVec3>> {
        let (size, amount, steps) = ([self.size / BOUNDS.diagonal()], [self.amount], [self.steps]);
        let keep = [f64::from(u8::from(self.keep_volume))];
        let params = [
            Param::text("method", ParamKind::CHOICE, self.method),
            Param::numbers("size", ParamKind::FLOAT, &size),
            Param::numbers("amount", ParamKind::FLOAT, &amount),
            Param::numbers("steps", ParamKind::INT, &steps),
            Param::numbers("keep-volume", ParamKind::BOOL, &keep),
        ];
        let (starts, all) = neighbours(&self.places());
        let (graph, triangles) = (Graph::new(&starts, &all), Triangles::new(&self.triangles));
        let mut parts = vec![Part::new(&graph)];
        if !self.triangles.is_empty() {
            parts.push(Part::new(&triangles));
        }
        let regions = [Region::new(Role::FIXED, &self.fixed)];
        let regions = if self.fixed.is_empty() { &regions[..0] } else { &regions };
        let samples = Samples::new(&self.positions, &self.normals, &[]);
        let host = Host::new(&());
        let state =
            Smooth::prepare(&PrepareInput::new(samples, BOUNDS, regions, &params).with_parts(&parts), &host)?;
        let mut out = vec![[f32::NAN; 3]; self.positions.len()];
        Smooth::deform(&state, &DeformInput::new(samples, BOUNDS, &[], &params), &mut (), &mut out, &host)?;
        Ok(out.iter().map(|p| DVec3::from(p.map(f64::from))).collect())
    }
}

/// The eight nearest neighbours of each, of few points.
fn neighbours(places: &[DVec3]) -> (Vec<u32>, Vec<u32>) {
    let cell = 0.08;
    let key = |p: DVec3| (p / cell).floor().as_i64vec3();
    let mut cells: HashMap<_, Vec<u32>> = HashMap::new();
    (0..).zip(places).for_each(|(i, p)| cells.entry(key(*p)).or_default().push(i));
    let (mut starts, mut all) = (vec![0], Vec::new());
    for (i, p) in (0u32..).zip(places) {
        let mut near: Vec<u32> = Vec::new();
        for d in 0..27 {
            let by = glam::I64Vec3::new(d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1);
            near.extend(cells.get(&(key(*p) + by)).into_iter().flatten().filter(|j| **j != i));
        }
        let squared = |j: &u32| places[*j as usize].distance_squared(*p);
        near.sort_by(|a, b| squared(a).total_cmp(&squared(b)));
        all.extend(near.into_iter().take(8));
        starts.push(all.len() as u32);
    }
    (starts, all)
}

/// A sheet of (n + 1)² vertices, each off the grid by a part of its step, and its triangles.
fn sheet(n: u32, off: f64, height: impl Fn(f64, f64) -> f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let place = |i: u32| {
        let random = |s: f64| off * ((f64::from(i) * s).fract() - 0.5) / f64::from(n);
        let [u, v] = [i % (n + 1), i / (n + 1)];
        let is_inside = |w: u32| f64::from(u8::from(w > 0 && w < n));
        let inside = is_inside(u) * is_inside(v);
        let [x, y] = [f64::from(u) / f64::from(n) - 0.5, f64::from(v) / f64::from(n) - 0.5];
        let [x, y] = [x + inside * random(0.618_034), y + inside * random(0.754_877)];
        DVec3::new(x, y, height(x, y))
    };
    let places = (0..(n + 1) * (n + 1)).map(place).collect();
    let quad = |i: u32| {
        let a = i % n + i / n * (n + 1);
        [[a, a + 1, a + n + 1], [a + 1, a + n + 2, a + n + 1]]
    };
    (places, (0..n * n).flat_map(quad).collect())
}

/// A sphere of triangles of about the same size.
fn sphere(times: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let corners = [[-1.0, g, 0.0], [1.0, g, 0.0], [-1.0, -g, 0.0], [1.0, -g, 0.0]];
    let turned = |k: usize| {
        corners.map(|c| DVec3::new(c[(3 - k) % 3], c[(4 - k) % 3], c[(5 - k) % 3]).normalize_or_zero())
    };
    let mut places: Vec<DVec3> = (0..3).flat_map(turned).collect();
    let length = places[0].distance(places[1]);
    let mut triangles = Vec::new();
    for a in 0..12u32 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let p = [a, b, c].map(|i| places[i as usize]);
                if (0..3).all(|i| (p[i].distance(p[(i + 1) % 3]) - length).abs() < 1e-9) {
                    let outward = (p[1] - p[0]).cross(p[2] - p[0]).dot(p[0]) > 0.0;
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..times {
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                places.push((places[a as usize] + places[b as usize]).normalize_or_zero());
                places.len() as u32 - 1
            })
        };
        let split = |[a, b, c]: [u32; 3]| {
            let [d, e, f] = [middle(a, b), middle(b, c), middle(c, a)];
            [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]
        };
        triangles = triangles.into_iter().flat_map(split).collect();
    }
    (places, triangles)
}

#[test]
fn filters_leave_of_waves_what_they_say() {
    for cut_off in [1e-3f64, 0.02, 0.3] {
        let filter = Filter::low_pass(cut_off);
        // Frequencies are roots of eigenvalues, nearly: angles, exactly.
        let at = |part: f64| filter.response(1.0 - (part * (1.0 - cut_off).acos()).cos());
        assert!((at(0.0) - 1.0).abs() < 1e-12 && (at(1.0) - 0.5).abs() < 0.02, "{cut_off}: {}", at(1.0));
        for part in [0.1, 0.3, 0.45] {
            assert!((at(part) - 1.0).abs() < 0.01, "{cut_off}, {part}: {}", at(part));
        }
        for part in [1.6, 1.9, 2.5] {
            assert!(at(part).abs() < 0.01, "{cut_off}, {part}: {}", at(part));
        }
    }
    for time in [0.1, 3.0, 500.0] {
        for k in [0.0, 1e-3, 0.1, 0.9, 2.0] {
            assert!((Filter::flow(time).response(k) - (-time * k).exp()).abs() < 1e-9, "{time}, {k}");
        }
    }
}

#[test]
fn what_is_flat_stays_whatever_its_triangles_are() {
    let (places, triangles) = sheet(40, 0.8, |x, y| 0.3 * x - 0.2 * y);
    for method in ["taubin", "mean-curvature"] {
        let setup = Setup { method, ..Setup::new(&places, triangles.clone()) };
        let off = setup.run().unwrap().iter().zip(&places).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);

        assert!(off < 1e-6, "{method}: {off}");
    }
}

#[test]
fn short_waves_go_and_long_ones_stay() {
    for with_triangles in [true, false] {
        let left = |length: f64| {
            let (places, triangles) = sheet(80, 0.5, |x, _| 0.002 * (TAU * x / length).cos());
            let triangles = if with_triangles { triangles } else { Vec::new() };
            let setup = Setup { size: 0.15, ..Setup::new(&places, triangles) };
            let smoothed = setup.run().unwrap();
            // The part of the wave that is left is measured away from the border.
            let inner = places.iter().zip(smoothed).filter(|(p, _)| p.x.abs() < 0.3 && p.y.abs() < 0.3);
            let (mut product, mut squares) = (0.0, 0.0);
            for (p, q) in inner {
                assert!(!with_triangles || (q - *p).truncate().length() < 1e-4);
                (product, squares) = (product + p.z * q.z, squares + p.z * p.z);
            }
            product / squares
        };
        let (short, same, long) = (left(0.075), left(0.15), left(0.4));
        assert!(
            short.abs() < 0.03 && (0.3..0.72).contains(&same) && (long - 1.0).abs() < 0.04,
            "{short} {same} {long}"
        );
    }
}

#[test]
fn a_sphere_shrinks_by_the_flow_as_it_should() {
    let (places, triangles) = sphere(4);
    // The square of the radius loses four times the time.
    let size = 2.0;
    let expected = (1.0 - 4.0 * (size / TAU).powi(2)).sqrt();
    let setup =
        Setup { method: "mean-curvature", size, steps: 40.0, ..Setup::new(&places, triangles.clone()) };
    for p in setup.run().unwrap() {
        assert!((p.length() - expected).abs() < 0.01, "{} instead of {expected}", p.length());
    }
    let kept = Setup { keep_volume: true, ..setup };
    for p in kept.run().unwrap() {
        assert!((p.length() - 1.0).abs() < 3e-3, "{}", p.length());
    }
}

#[test]
fn a_filter_keeps_the_size_of_a_sphere_and_takes_its_bumps() {
    let (round, triangles) = sphere(5);
    let bumpy = |p: &DVec3| *p * (1.0 + 0.01 * (40.0 * p.x).sin() * (40.0 * p.y).cos());
    let places: Vec<DVec3> = round.iter().map(bumpy).collect();
    let setup = Setup { size: 0.4, ..Setup::new(&places, triangles.clone()) };
    let smoothed = setup.run().unwrap();
    let rms = |all: &[DVec3]| {
        (all.iter().map(|p| (p.length() - 1.0).powi(2)).sum::<f64>() / all.len() as f64).sqrt()
    };
    assert!(rms(&smoothed) < 0.3 * rms(&places), "{} of {}", rms(&smoothed), rms(&places));
    let [before, after] = [&places, &smoothed].map(|all| volume::volume(all, &triangles));
    assert!((after / before - 1.0).abs() < 2e-3, "{before} {after}");
    // A negative amount makes bumps stand out by as much.
    let sharpened = Setup { amount: -1.0, ..setup }.run().unwrap();
    for ((p, a), b) in places.iter().zip(smoothed).zip(sharpened) {
        assert!((a + b - 2.0 * *p).length() < 1e-6);
    }
}

#[test]
fn what_is_fixed_or_on_a_border_stays() {
    let (places, triangles) = sheet(30, 0.5, |x, y| 0.02 * (50.0 * x).sin() * (40.0 * y).sin());
    let fixed = places.iter().map(|p| ((0.1 - p.x) * 5.0).clamp(0.0, 1.0) as f32).collect();
    let setup = Setup { fixed, ..Setup::new(&places, triangles) };
    let (before, after) = (setup.places(), setup.run().unwrap());
    let mut moved = 0;
    for ((p, q), weight) in before.iter().zip(&after).zip(&setup.fixed) {
        let is_inside = p.x.abs() < 0.5 - 1e-9 && p.y.abs() < 0.5 - 1e-9;
        assert!(p == q || (*weight < 1.0 && is_inside), "{p} went to {q}");
        moved += usize::from(p.distance(*q) > 1e-3);
    }
    assert!(moved > 200, "{moved}");
}

#[test]
fn odd_surfaces_do_no_harm() {
    let (mut places, mut triangles) = sheet(20, 0.0, |x, y| 0.01 * (60.0 * (x + y)).sin());
    // Without an area, all at one place, three at one edge, far off, alone.
    places.extend([places[5], places[5], places[5], DVec3::new(0.9, 0.9, 0.9), DVec3::new(-0.9, 0.9, 0.0)]);
    let n = places.len() as u32;
    triangles.extend([
        [5, n - 5, n - 4],
        [n - 5, n - 4, n - 3],
        [44, 45, n - 2],
        [0, 0, 1],
        [7, 8, u32::MAX],
    ]);
    for method in ["taubin", "mean-curvature"] {
        for keep_volume in [false, true] {
            let setup = Setup { method, keep_volume, ..Setup::new(&places, triangles.clone()) };
            let smoothed = setup.run().unwrap();
            assert!(smoothed.iter().all(|p| p.is_finite() && p.length() < 2.0));
        }
    }
    let one = Setup::new(&[DVec3::ZERO; 7], Vec::new());
    assert_eq!(one.run().unwrap(), [DVec3::ZERO; 7]);
    assert!(
        Setup { positions: vec![[f32::NAN; 3]; 3], ..one }
            .run()
            .unwrap_err()
            .message
            .contains("no finite place")
    );
}

proptest! {
    #[test]
    fn smoothing_goes_with_turns_and_shifts(
        angles in prop::array::uniform3(-3.0..3.0f64), shift in prop::array::uniform3(-0.5..0.5f64), flow in any::<bool>(),
    ) {
        let (places, triangles) = sheet(16, 0.5, |x, y| 0.05 * (20.0 * x).sin() * (25.0 * y).cos());
        let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
        let moved = |p: &DVec3| turn * *p + DVec3::from(shift);
        let method = if flow { "mean-curvature" } else { "taubin" };
        let of = |places: &[DVec3]| Setup { method, ..Setup::new(places, triangles.clone()) }.run().unwrap();
        let (here, there) = (of(&places), of(&places.iter().map(moved).collect::<Vec<_>>()));
        let off = here.iter().map(moved).zip(there).map(|(a, b)| a.distance(b)).fold(0.0, f64::max);
        prop_assert!(off < 2e-6, "{off}");
    }
}
