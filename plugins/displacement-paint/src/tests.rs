//! The whole plugin, on a sphere, a plane, a thin wall and two fingers.

use super::*;
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use proptest::prelude::*;
use simod_plugin_api::{Bounds, ErrorCode, Graph, HostCalls, Param, ParamKind, Part, Stroke, Strokes};

const BOUNDS: Bounds = Bounds { min: [-1.0; 3], max: [1.0; 3] };
const NEIGHBOURS: usize = 32;

/// Samples with all that a host gives of them.
struct Model {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    spacing: Vec<f32>,
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Model {
    fn new(samples: impl Iterator<Item = (DVec3, DVec3)>) -> Self {
        let (positions, normals): (Vec<[f32; 3]>, Vec<[f32; 3]>) =
            samples.map(|(p, n)| (p.as_vec3().to_array(), n.as_vec3().to_array())).unzip();
        let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&positions).unwrap();
        let k = NEIGHBOURS.min(positions.len() - 1);
        let (mut neighbours, mut spacing) = (Vec::new(), Vec::new());
        for (i, p) in positions.iter().enumerate() {
            let count = std::num::NonZero::new(k + 1).unwrap();
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            let mut near: Vec<(f32, u32)> = near.into_iter().map(|n| (n.distance, n.item)).collect();
            near.retain(|n| n.1 != i as u32);
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            spacing.push(near[..6.min(k)].iter().map(|n| n.0.sqrt()).sum::<f32>() / 6.0);
            neighbours.extend(near[..k].iter().map(|n| n.1));
        }
        let starts = (0..=positions.len()).map(|i| (i * k) as u32).collect();
        Self { positions, normals, spacing, starts, neighbours }
    }

    /// Sphere of radius 1, with its normals, and bumps of some height that the normals do not show.
    fn sphere(count: usize, bumps: f64) -> Self {
        Self::new((0..count).map(|i| {
            let d = on_sphere(i, count);
            let wave = (40.0 * d.x).sin() * (40.0 * d.y).sin() * (40.0 * d.z).sin();
            (d * (1.0 + bumps * wave), d)
        }))
    }

    /// A wall in the plane z = 0 of the given thickness: its front, and then its back, from -1 to 1.
    fn wall(per_side: usize, thickness: f64) -> Self {
        let side = move |z: f64| {
            (0..per_side * per_side).map(move |i| {
                let at = |k: usize| 2.0 * (k as f64 + 0.5) / per_side as f64 - 1.0;
                // Both sides shifted, so that samples do not lie behind each other.
                let (x, y) = (at(i % per_side) + 0.01 * z, at(i / per_side));
                (DVec3::new(x, y, 0.5 * z * thickness), DVec3::Z * z)
            })
        };
        Self::new(side(1.0).chain(side(-1.0)))
    }

    /// Two fingers of radius 0.1 along y, their surfaces 0.02 apart.
    fn fingers() -> Self {
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let finger = move |x: f64| {
            (0..4000).map(move |i| {
                let angle = golden * f64::from(i);
                let n = DVec3::new(angle.cos(), 0.0, angle.sin());
                (0.1 * n + DVec3::new(x, f64::from(i) / 4000.0, 0.0), n)
            })
        };
        Self::new(finger(-0.11).chain(finger(0.11)))
    }

    fn samples(&self) -> Samples<'_> {
        Samples::new(&self.positions, &self.normals, &self.spacing)
    }

    fn prepare(&self) -> PreparedSheets {
        let graph = Graph::new(&self.starts, &self.neighbours);
        let parts = [Part::new(&graph)];
        let input = PrepareInput::new(self.samples(), BOUNDS, &[], &[]).with_parts(&parts);
        DisplacementPaint::prepare(&input, &Host::new(&())).unwrap()
    }

    fn paint_on(
        &self,
        state: &PreparedSheets,
        easel: &mut PaintScratch,
        strokes: &[Painting],
    ) -> PluginResult<Vec<[f32; 3]>> {
        let params: Vec<_> = strokes.iter().map(Painting::params).collect();
        let strokes: Vec<Stroke<'_>> = strokes
            .iter()
            .zip(&params)
            .map(|(s, params)| Stroke::new(s.key(), s.radius, s.strength, &s.points, &s.pressures, params))
            .collect();
        let strokes = Strokes::new(&strokes);
        let parts = [Part::new(&strokes)];
        let input = DeformInput::new(self.samples(), BOUNDS, &[], &[]).with_parts(&parts);
        let mut out = vec![[f32::NAN; 3]; self.positions.len()];
        DisplacementPaint::deform(state, &input, easel, &mut out, &Host::new(&())).map(|()| out)
    }

    fn paint(&self, strokes: &[Painting]) -> Vec<[f32; 3]> {
        self.paint_on(&self.prepare(), &mut PaintScratch::default(), strokes).unwrap()
    }

    /// Rest and painted positions.
    fn pairs<'a>(&'a self, out: &'a [[f32; 3]]) -> impl Iterator<Item = (DVec3, DVec3)> + 'a {
        let point = |p: &[f32; 3]| DVec3::from(p.map(f64::from));
        self.positions.iter().zip(out).map(move |(p, q)| (point(p), point(q)))
    }
}

fn on_sphere(i: usize, count: usize) -> DVec3 {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let z = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
    let (sin, cos) = (golden * i as f64).sin_cos();
    DVec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
}

/// A stroke and its brush.
#[derive(Debug, Clone)]
struct Painting {
    brush: &'static str,
    radius: f64,
    strength: f64,
    points: Vec<[f64; 3]>,
    pressures: Vec<f32>,
    depth: [f64; 1],
    spacing: [f64; 1],
    falloff: Vec<f64>,
    accumulate: [f64; 1],
    symmetry: [[f64; 1]; 3],
}

impl Painting {
    fn new(brush: &'static str, points: &[[f64; 3]]) -> Self {
        Self {
            brush,
            radius: 0.3,
            strength: 1.0,
            points: points.to_vec(),
            pressures: Vec::new(),
            depth: [0.2],
            spacing: [0.2],
            falloff: vec![0.0, 1.0, 1.0, 0.0],
            accumulate: [0.0],
            symmetry: [[0.0]; 3],
        }
    }

    fn key(&self) -> u64 {
        use std::hash::{DefaultHasher, Hash, Hasher};
        let mut hasher = DefaultHasher::new();
        format!("{self:?}").hash(&mut hasher);
        hasher.finish()
    }

    fn params(&self) -> Vec<Param<'_>> {
        vec![
            Param::text("brush", ParamKind::CHOICE, self.brush),
            Param::numbers("depth", ParamKind::FLOAT, &self.depth),
            Param::numbers("spacing", ParamKind::FLOAT, &self.spacing),
            Param::numbers("falloff", ParamKind::CURVE, &self.falloff),
            Param::numbers("accumulate", ParamKind::BOOL, &self.accumulate),
            Param::numbers("symmetry-x", ParamKind::BOOL, &self.symmetry[0]),
            Param::numbers("symmetry-y", ParamKind::BOOL, &self.symmetry[1]),
            Param::numbers("symmetry-z", ParamKind::BOOL, &self.symmetry[2]),
            Param::numbers("symmetry-center", ParamKind::POINT, &[0.0; 3]),
        ]
    }
}

const BRUSHES: [&str; 7] = ["inflate", "draw", "grab", "smooth", "flatten", "pinch", "crease"];

/// Arc on the unit sphere, from one direction to another.
fn arc(from: [f64; 3], to: [f64; 3], points: usize) -> Vec<[f64; 3]> {
    let (a, b) = (DVec3::from(from), DVec3::from(to));
    (0..points).map(|i| a.lerp(b, i as f64 / (points - 1) as f64).normalize_or_zero().to_array()).collect()
}

fn distance_to(path: &[[f64; 3]], p: DVec3) -> f64 {
    path.windows(2)
        .map(|w| {
            let (a, b) = (DVec3::from(w[0]), DVec3::from(w[1]));
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, t))
        })
        .fold(f64::INFINITY, f64::min)
}

/// Largest distance between the same samples.
fn difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let apart = |(p, q): (&[f32; 3], &[f32; 3])| Vec3::from(*p).distance(Vec3::from(*q));
    f64::from(a.iter().zip(b).map(apart).fold(0.0, f32::max))
}

#[test]
fn inflating_lifts_the_middle_by_the_depth_and_nothing_outside() {
    let model = Model::sphere(8000, 0.0);
    let path = arc([1.0, -0.5, 0.0], [1.0, 0.5, 0.2], 40);
    for brush in ["inflate", "draw"] {
        let out = model.paint(&[Painting::new(brush, &path)]);
        let mut highest: f64 = 0.0;
        for (p, q) in model.pairs(&out) {
            let d = distance_to(&path, p);
            let lift = q.length() - p.length();
            highest = highest.max(lift);
            if d > 0.302 {
                assert_eq!(p, q, "{brush}: {d}");
            } else {
                // The way of the brush lies a little below what is round. The falloff's default is the
                // Hermite kernel.
                let t = d / 0.3;
                let expected = 0.06 * (1.0 - 3.0 * t * t + 2.0 * t * t * t);
                assert!((lift - expected).abs() < 0.004, "{brush} at {t}: {lift} {expected}");
            }
        }
        assert!((highest - 0.06).abs() < 5e-4, "{brush}: {highest}");
    }
}

#[test]
fn no_strength_and_no_strokes_move_nothing() {
    let model = Model::sphere(1000, 0.01);
    let state = model.prepare();
    let path = arc([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 5);
    for brush in BRUSHES {
        let none = Painting { strength: 0.0, ..Painting::new(brush, &path) };
        let out = model.paint_on(&state, &mut PaintScratch::default(), &[none]).unwrap();
        assert_eq!(out, model.positions, "{brush}");
    }
    assert_eq!(model.paint(&[]), model.positions);
    // Far from the surface there is nothing to paint on.
    let away = Painting::new("draw", &[[9.0; 3], [9.0, 9.0, 10.0]]);
    assert_eq!(model.paint(&[away]), model.positions);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn nothing_moves_that_the_brush_does_not_touch(
        brush in 0..7_usize, accumulate in any::<bool>(), radius in 0.05..0.6_f64, seed in 0..987_usize,
    ) {
        let model = Model::sphere(3000, 0.004);
        // Never from pole to pole, where the path would go through the sphere.
        let path = arc(on_sphere(seed, 1000).to_array(), on_sphere(seed + 13, 1000).to_array(), 12);
        let accumulate = [f64::from(u8::from(accumulate))];
        let out = model.paint(&[Painting { radius, accumulate, ..Painting::new(BRUSHES[brush], &path) }]);
        for (p, q) in model.pairs(&out) {
            // A brush that acts on its own results may reach a little farther, as the surface moves.
            prop_assert!(p == q || distance_to(&path, p) <= 1.1 * radius + 0.01, "{}", BRUSHES[brush]);
        }
    }

    #[test]
    fn strokes_do_not_depend_on_how_often_they_were_recorded(
        brush in 0..7_usize, accumulate in any::<bool>(), cuts in prop::collection::vec(0.0..1.0_f64, 1..40),
    ) {
        let model = Model::sphere(3000, 0.004);
        let path = arc([1.0, 0.0, 0.3], [0.5, 0.8, 0.0], 4);
        let pressures = vec![0.2, 1.0, 0.5, 0.9];
        let (mut finer, mut finer_pressures) = (Vec::new(), Vec::new());
        for (i, w) in path.windows(2).enumerate() {
            let mut cuts = [vec![0.0], cuts.clone()].concat();
            cuts.sort_by(f64::total_cmp);
            for t in cuts {
                finer.push(DVec3::from(w[0]).lerp(w[1].into(), t).to_array());
                finer_pressures.push(pressures[i] + t as f32 * (pressures[i + 1] - pressures[i]));
            }
        }
        finer.push(path[3]);
        finer_pressures.push(pressures[3]);
        let accumulate = [f64::from(u8::from(accumulate))];
        let coarse = Painting { accumulate, pressures, ..Painting::new(BRUSHES[brush], &path) };
        let fine = Painting { points: finer, pressures: finer_pressures, ..coarse.clone() };
        let difference = difference(&model.paint(&[coarse]), &model.paint(&[fine]));
        prop_assert!(difference < 1e-6, "{}: {difference}", BRUSHES[brush]);
    }

    #[test]
    fn what_is_kept_from_call_to_call_does_not_show(
        layers in prop::collection::vec(
            prop::collection::vec((0..7_usize, 0..40_usize, any::<bool>()), 0..5), 1..8),
    ) {
        let model = Model::sphere(1500, 0.01);
        let state = model.prepare();
        let stroke = |&(brush, at, accumulate): &(usize, usize, bool)| {
            let path = arc(on_sphere(at, 40).to_array(), on_sphere((at + 3) % 40, 40).to_array(), 6);
            let accumulate = [f64::from(u8::from(accumulate))];
            Painting { accumulate, ..Painting::new(BRUSHES[brush], &path) }
        };
        let mut easel = PaintScratch::default();
        let mut strokes: Vec<Painting> = Vec::new();
        for layer in &layers {
            // Some are kept, some taken back, some new.
            strokes.truncate(layer.len());
            strokes.extend(layer.iter().map(stroke));
            let kept = model.paint_on(&state, &mut easel, &strokes).unwrap();
            let anew = model.paint_on(&state, &mut PaintScratch::default(), &strokes).unwrap();
            let bits = |out: &[[f32; 3]]| -> Vec<u32> { out.iter().flatten().map(|x| x.to_bits()).collect() };
            prop_assert_eq!(bits(&kept), bits(&anew));
        }
    }
}

#[test]
fn narrower_spacing_converges() {
    let model = Model::sphere(8000, 0.004);
    let path = arc([1.0, -0.5, 0.0], [1.0, 0.5, 0.2], 40);
    for brush in BRUSHES {
        for accumulate in [[0.0], [1.0]] {
            let at = |spacing: f64| {
                model.paint(&[Painting { spacing: [spacing], accumulate, ..Painting::new(brush, &path) }])
            };
            let finest = at(0.0125);
            let errors = [0.4, 0.1].map(|spacing| difference(&at(spacing), &finest));
            // The error is compared with the default's whole effect.
            let whole = difference(&finest, &model.positions);
            assert!(errors[1] < 0.12 * whole, "{brush}, {accumulate:?}: {errors:?} of {whole}");
        }
    }
}

#[test]
fn the_opposite_stroke_undoes() {
    let model = Model::sphere(8000, 0.0);
    let path = arc([1.0, -0.3, 0.0], [1.0, 0.3, 0.0], 20);
    for brush in ["inflate", "draw", "grab"] {
        let mut there = Painting::new(brush, &path);
        let mut back = Painting { strength: -1.0, ..there.clone() };
        if brush == "grab" {
            there.points = vec![[1.0, 0.0, 0.0], [1.05, 0.0, 0.02]];
            back = Painting { points: vec![[1.05, 0.0, 0.02], [1.0, 0.0, 0.0]], ..there.clone() };
        }
        let once = difference(&model.paint(std::slice::from_ref(&there)), &model.positions);
        let twice = difference(&model.paint(&[there, back]), &model.positions);
        assert!(twice < 0.25 * once, "{brush}: {twice} of {once}");
    }
}

#[test]
fn a_stroke_that_crosses_itself_has_no_lump_unless_it_accumulates() {
    let model = Model::sphere(8000, 0.0);
    let once = arc([1.0, -0.3, 0.0], [1.0, 0.3, 0.0], 20);
    let there_and_back: Vec<[f64; 3]> = once.iter().chain(once.iter().rev()).copied().collect();
    let highest = |painting: Painting| {
        let out = model.paint(&[painting]);
        model.pairs(&out).map(|(_, q)| q.length() - 1.0).fold(0.0, f64::max)
    };
    let even = highest(Painting::new("draw", &there_and_back));
    assert!((even - 0.06).abs() < 5e-4, "{even}");
    let accumulate = [1.0];
    let long = arc([1.0, -0.6, 0.0], [1.0, 0.6, 0.0], 20);
    let single = highest(Painting { accumulate, ..Painting::new("draw", &long) });
    assert!((single - 0.06).abs() < 6e-3, "the line integral is the depth: {single}");
    let double = highest(Painting { accumulate, ..Painting::new("draw", &there_and_back) });
    assert!(double > 1.6 * single, "{double} {single}");
}

#[test]
fn grab_takes_the_start_along() {
    let model = Model::sphere(8000, 0.0);
    let start = on_sphere(4000, 8000);
    let by = DVec3::new(0.05, 0.1, -0.02);
    let mut painting = Painting::new("grab", &[start.to_array(), (start + by).to_array()]);
    // The pen has no pressure where it touches down.
    painting.pressures = vec![0.0, 1.0];
    let out = model.paint(&[painting]);
    let (p, q) = model.pairs(&out).nth(4000).unwrap();
    assert!((q - p).distance(by) < 2e-3, "{}", q - p);
}

#[test]
fn smoothing_lowers_bumps_whatever_the_density() {
    for count in [6000, 20_000] {
        let model = Model::sphere(count, 0.01);
        let path = arc([1.0, -0.4, 0.1], [1.0, 0.4, 0.1], 20);
        let out = model.paint(&[Painting { radius: 0.4, ..Painting::new("smooth", &path) }]);
        // Roughness is the height above the mean of the nearest others.
        let roughness = |of: &[[f32; 3]]| {
            let height = |i: usize| DVec3::from(of[i].map(f64::from)).length();
            let inner =
                (0..count).filter(|&i| distance_to(&path, Vec3::from(model.positions[i]).as_dvec3()) < 0.2);
            let bumps = inner.map(|i| {
                let near = &model.neighbours[model.starts[i] as usize..][..NEIGHBOURS];
                (height(i) - near.iter().map(|&j| height(j as usize)).sum::<f64>() / near.len() as f64)
                    .powi(2)
            });
            let bumps: Vec<f64> = bumps.collect();
            (bumps.iter().sum::<f64>() / bumps.len() as f64).sqrt()
        };
        let (before, after) = (roughness(&model.positions), roughness(&out));
        assert!(after < 0.35 * before, "{count}: {before} {after}");
    }
}

#[test]
fn smoothing_leaves_a_plane_as_it_is() {
    let model = Model::wall(60, 0.5);
    let out = model.paint(&[Painting::new("smooth", &[[-0.5, 0.0, 0.25], [0.5, 0.1, 0.25]])]);
    assert!(difference(&out, &model.positions) < 1e-6);
}

#[test]
fn flattening_brings_samples_to_a_plane() {
    let model = Model::sphere(8000, 0.01);
    let dab = Painting { radius: 0.4, ..Painting::new("flatten", &[[1.0, 0.0, 0.0]]) };
    let out = model.paint(&vec![dab; 10]);
    let spread = |of: &dyn Fn((DVec3, DVec3)) -> DVec3| {
        let inner = model.pairs(&out).filter(|(p, _)| p.distance(DVec3::X) < 0.2);
        let heights: Vec<f64> = inner.map(|pair| of(pair).x).collect();
        let mean = heights.iter().sum::<f64>() / heights.len() as f64;
        heights.iter().map(|h| (h - mean).abs()).fold(0.0, f64::max)
    };
    let (before, after) = (spread(&|pair| pair.0), spread(&|pair| pair.1));
    assert!(after < 0.5 * before, "{before} {after}");
}

#[test]
fn pinching_draws_towards_the_line_along_the_surface() {
    let model = Model::wall(100, 0.5);
    let path = [[-0.6, 0.03, 0.25], [0.6, 0.03, 0.25]];
    for (brush, lift) in [("pinch", 0.0), ("crease", 0.06)] {
        for accumulate in [[0.0], [1.0]] {
            let out = model.paint(&[Painting { accumulate, ..Painting::new(brush, &path) }]);
            let mut nearest: f64 = 1.0;
            let mut highest: f64 = 0.0;
            for (p, q) in model.pairs(&out).filter(|(p, _)| p.x.abs() < 0.3 && p.z > 0.0) {
                let (from, to) = (p.y - 0.03, q.y - 0.03);
                assert!(from * to >= -1e-6 && to.abs() <= from.abs() + 1e-4, "{brush}: {from} {to}");
                if (0.05..0.1).contains(&from) {
                    nearest = nearest.min(to / from);
                }
                highest = highest.max(q.z - p.z);
            }
            assert!(nearest < 0.75, "{brush} {accumulate:?}: {nearest}");
            assert!((highest - lift).abs() < 0.006, "{brush} {accumulate:?}: {highest}");
        }
    }
}

#[test]
fn mirror_images_are_exact() {
    // A cloud of its own mirror images across x and y, with samples on the mirrors.
    let mut points: Vec<Vec3> = Vec::new();
    for i in 0..3600 {
        let d = on_sphere(i, 3600);
        if d.x < 0.0 || d.y < 0.0 {
            continue;
        }
        let on = |x: f64| if x < 0.01 { 0.0 } else { x };
        let d = (0.75 * DVec3::new(on(d.x), on(d.y), d.z)).as_vec3();
        for image in
            [d, d * Vec3::new(-1.0, 1.0, 1.0), d * Vec3::new(1.0, -1.0, 1.0), d * Vec3::new(-1.0, -1.0, 1.0)]
        {
            if !points.contains(&image) {
                points.push(image);
            }
        }
    }
    let model = Model::new(points.iter().map(|p| (p.as_dvec3(), p.as_dvec3() / 0.75)));
    // Strokes that run over both mirrors.
    let path: Vec<[f64; 3]> = arc([0.3, -0.2, 1.0], [-0.1, 0.5, 1.0], 9)
        .iter()
        .map(|p| (0.75 * DVec3::from(*p)).to_array())
        .collect();
    for brush in BRUSHES {
        for accumulate in [[0.0], [1.0]] {
            let symmetry = [[1.0], [1.0], [0.0]];
            let painting = Painting { symmetry, accumulate, ..Painting::new(brush, &path) };
            let out = model.paint(&[painting.clone(), painting]);
            assert!(difference(&out, &model.positions) > 1e-3, "{brush}");
            for mirror in [Vec3::new(-1.0, 1.0, 1.0), Vec3::new(1.0, -1.0, 1.0)] {
                for (i, p) in points.iter().enumerate() {
                    let twin = points.iter().position(|q| *q == mirror * *p).unwrap();
                    assert_eq!(
                        mirror * Vec3::from(out[i]),
                        Vec3::from(out[twin]),
                        "{brush}, {accumulate:?}: {i}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_other_side_of_a_thin_wall_stays() {
    for thickness in [0.002, 0.02, 0.1] {
        let model = Model::wall(60, thickness);
        let half = model.positions.len() / 2;
        for brush in BRUSHES {
            // The strokes are in the middle of the wall, and beside its rim.
            for y in [0.0, 0.9] {
                let path = [[-0.4, y, 0.5 * thickness], [0.3, y, 0.5 * thickness]];
                let out = model.paint(&[Painting::new(brush, &path)]);
                assert_eq!(out[half..], model.positions[half..], "{brush}, {thickness}");
                let moves = !matches!(brush, "smooth" | "flatten");
                assert_eq!(out[..half] != model.positions[..half], moves, "{brush}, {thickness}");
            }
        }
    }
}

#[test]
fn the_other_finger_stays() {
    let model = Model::fingers();
    // The path is on the side of the left finger that faces the right one.
    let path = [[-0.01, 0.4, 0.0], [-0.01, 0.6, 0.0]];
    for brush in BRUSHES {
        let out = model.paint(&[Painting { radius: 0.08, ..Painting::new(brush, &path) }]);
        assert_eq!(out[4000..], model.positions[4000..], "{brush}");
        assert_ne!(out[..4000], model.positions[..4000], "{brush}");
        if brush != "grab" {
            // Nor does the back of the same one.
            for (p, q) in model.pairs(&out).filter(|(p, _)| p.x < -0.18) {
                assert_eq!(p, q, "{brush}");
            }
        }
    }
}

#[test]
fn strokes_over_strokes_follow_the_surface_as_it_is() {
    // A wall that was lifted to a steep ridge inflates sideways as well.
    let model = Model::wall(100, 0.5);
    let ridge = Painting { depth: [0.8], ..Painting::new("draw", &[[-0.6, 0.0, 0.25], [0.6, 0.0, 0.25]]) };
    let slope =
        Painting { radius: 0.15, ..Painting::new("inflate", &[[-0.4, 0.15, 0.37], [0.4, 0.15, 0.37]]) };
    let (once, twice) = (model.paint(std::slice::from_ref(&ridge)), model.paint(&[ridge, slope]));
    let sideways = once.iter().zip(&twice).map(|(p, q)| q[1] - p[1]).fold(0.0, f32::max);
    assert!(sideways > 0.01, "{sideways}");
}

#[test]
fn stops_when_asked_and_leaves_nothing_half_done() {
    struct Stop(std::sync::atomic::AtomicUsize);
    impl HostCalls for Stop {
        fn progress(&self, _: f64) -> bool {
            self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < 7
        }
        fn log(&self, _: simod_plugin_api::LogLevel, _: &str) {}
    }
    let model = Model::sphere(2000, 0.0);
    let state = model.prepare();
    let path = arc([1.0, -0.5, 0.0], [1.0, 0.5, 0.2], 40);
    let strokes =
        [Painting::new("draw", &path), Painting { accumulate: [1.0], ..Painting::new("inflate", &path) }];
    let mut easel = PaintScratch::default();
    let first = model.paint_on(&state, &mut easel, &strokes[..1]).unwrap();
    let params = strokes[1].params();
    let stroke = [Stroke::new(7, 0.3, 1.0, &strokes[1].points, &[], &params)];
    let list = Strokes::new(&stroke);
    let parts = [Part::new(&list)];
    let input = DeformInput::new(model.samples(), BOUNDS, &[], &[]).with_parts(&parts);
    let mut out = vec![[0.0; 3]; 2000];
    let stop = Stop(Default::default());
    let error =
        DisplacementPaint::deform(&state, &input, &mut easel, &mut out, &Host::new(&stop)).unwrap_err();
    assert_eq!(error.code, ErrorCode::CANCELLED);
    assert_eq!(model.paint_on(&state, &mut easel, &strokes[..1]).unwrap(), first);
    assert!(!DisplacementPaint::is_identity(&input).unwrap());
}

#[test]
fn a_sample_alone_can_be_painted_on() {
    let model = Model {
        positions: vec![[0.0; 3]],
        normals: vec![[0.0, 0.0, 1.0]],
        spacing: vec![0.0],
        starts: vec![0, 0],
        neighbours: Vec::new(),
    };
    for brush in BRUSHES {
        let out = model.paint(&[Painting::new(brush, &[[0.0; 3], [0.0, 0.1, 0.0]])]);
        assert!(out[0].iter().all(|x| x.is_finite()), "{brush}");
    }
}
