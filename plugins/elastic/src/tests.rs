//! The whole plugin, as the host calls it, beside finite elements, volumes, and surfaces that must not meet.

use super::*;
use proptest::prelude::*;
use simod_plugin_api::{
    Bounds, ErrorCode, Graph, HostCalls, LogLevel, Param, ParamKind, Part, Region, Role, Samples, Triangles,
};
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Lines that a host hears; whether it lets the plugin go on, and in which order it has blocks done.
#[derive(Default)]
struct Listener {
    lines: Mutex<Vec<String>>,
    stop: bool,
    backwards: bool,
}

impl HostCalls for Listener {
    fn progress(&self, _: f64) -> bool {
        !self.stop
    }
    fn log(&self, level: LogLevel, message: &str) {
        assert_eq!(level, LogLevel::WARNING);
        self.lines.lock().unwrap().push(message.to_owned());
    }
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        let order = |i: usize| if self.backwards { count - 1 - i } else { i };
        (0..count).for_each(|i| body(order(i)));
        !self.stop
    }
}

/// Surface with the regions and settings of a deformation.
#[derive(Clone)]
struct Setup {
    places: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    fixed: Vec<f32>,
    handle: Vec<f32>,
    poisson: f64,
    weight: f64,
    resolution: f64,
    contact: bool,
    effort: Effort,
}

impl Setup {
    fn new((places, triangles): (Vec<DVec3>, Vec<[u32; 3]>)) -> Self {
        Self {
            places,
            triangles,
            fixed: Vec::new(),
            handle: Vec::new(),
            poisson: 0.45,
            weight: 0.0,
            resolution: 32.0,
            contact: true,
            effort: Effort::FULL,
        }
    }

    /// Held where one condition holds, and moved where another one does.
    fn held(mut self, fixed: impl Fn(DVec3) -> bool, handle: impl Fn(DVec3) -> bool) -> Self {
        let weights = |is_in: &dyn Fn(DVec3) -> bool| {
            self.places.iter().map(|p| f32::from(u8::from(is_in(*p)))).collect::<Vec<f32>>()
        };
        (self.fixed, self.handle) = (weights(&fixed), weights(&handle));
        self
    }

    fn bounds(&self) -> Bounds {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (min, max) = self.places.iter().fold(start, |(low, high), p| (low.min(*p), high.max(*p)));
        Bounds { min: min.into(), max: max.into() }
    }

    fn run(&self, motion: Affine, host: &Listener) -> PluginResult<Vec<DVec3>> {
        let (poisson, weight, resolution) = ([self.poisson], [self.weight], [self.resolution]);
        let contact = [f64::from(u8::from(self.contact))];
        let tolerance = [1e-4];
        let params = [
            Param::numbers("poisson", ParamKind::FLOAT, &poisson),
            Param::numbers("weight", ParamKind::FLOAT, &weight),
            Param::numbers("resolution", ParamKind::INT, &resolution),
            Param::numbers("contact", ParamKind::BOOL, &contact),
            Param::numbers("tolerance", ParamKind::FLOAT, &tolerance),
            Param::numbers("down", ParamKind::DIRECTION, &[0.0, 0.0, -1.0]),
        ];
        let positions: Vec<[f32; 3]> = self.places.iter().map(|p| p.as_vec3().into()).collect();
        let normals: Vec<[f32; 3]> =
            normals(&self.places, &self.triangles).iter().map(|n| n.as_vec3().into()).collect();
        let starts = vec![0; positions.len() + 1];
        let (graph, triangles) = (Graph::new(&starts, &[]), Triangles::new(&self.triangles));
        let parts = [Part::new(&graph), Part::new(&triangles)];
        let all = [(Role::FIXED, &self.fixed), (Role::HANDLE, &self.handle)];
        let regions: Vec<Region<'_>> = all
            .into_iter()
            .filter(|(_, w)| w.iter().any(|w| *w > 0.0))
            .map(|(role, weights)| Region::new(role, weights))
            .collect();
        let motions = [motion];
        let motions = if self.handle.iter().any(|w| *w > 0.0) { &motions[..] } else { &[] };
        let samples = Samples::new(&positions, &normals, &[]);
        let host = Host::new(host);
        let input = PrepareInput::new(samples, self.bounds(), &regions, &params).with_parts(&parts);
        let state = Elastic::prepare(&input, &host)?;
        let mut out = vec![[f32::NAN; 3]; positions.len()];
        let parts = [Part::new(&self.effort)];
        let input = DeformInput::new(samples, self.bounds(), motions, &params).with_parts(&parts);
        Elastic::deform(&state, &input, &mut (), &mut out, &host)?;
        Ok(out.iter().map(|p| DVec3::from(p.map(f64::from))).collect())
    }
}

/// Box of `parts` squares along each axis.
fn block(size: DVec3, parts: [u32; 3]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (mut places, mut triangles, mut ids) = (Vec::new(), Vec::new(), BTreeMap::new());
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [0, parts[axis]] {
            let mut id = |i: u32, j: u32| {
                let mut at = [0; 3];
                (at[axis], at[u], at[v]) = (side, i, j);
                *ids.entry(at).or_insert_with(|| {
                    let part = |a: usize| f64::from(at[a]) / f64::from(parts[a]) - 0.5;
                    places.push(size * DVec3::new(part(0), part(1), part(2)));
                    places.len() as u32 - 1
                })
            };
            for (i, j) in (0..parts[u]).flat_map(|i| (0..parts[v]).map(move |j| (i, j))) {
                let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
                triangles.extend(if side == 0 { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
            }
        }
    }
    (places, triangles)
}

/// A bar of length 1 along x from the origin on, with square sections.
fn bar(thick: f64, along: u32) -> Setup {
    let across = (f64::from(along) * thick).round() as u32;
    let (places, triangles) = block(DVec3::new(1.0, thick, thick), [along, across, across]);
    Setup::new((places.iter().map(|p| *p + 0.5 * DVec3::X).collect(), triangles))
}

fn normals(places: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; places.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| places[i as usize]);
        t.iter().for_each(|i| normals[*i as usize] += (b - a).cross(c - a));
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}

fn volume(places: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    triangles.iter().map(|t| t.map(|i| places[i as usize])).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

/// A turn about an axis through a point, and a shift.
fn turn(axis: DVec3, degrees: f64, pivot: DVec3, shift: DVec3) -> Affine {
    let turn = DMat3::from_axis_angle(axis, degrees.to_radians());
    let to = pivot + shift - turn * pivot;
    Affine { rows: [0, 1, 2].map(|i| [turn.x_axis[i], turn.y_axis[i], turn.z_axis[i], to[i]]) }
}

/// Pairs of triangles without a common corner of which an edge of one passes through the other.
fn crossings(places: &[DVec3], triangles: &[[u32; 3]]) -> usize {
    let corners = |t: &[u32; 3]| t.map(|i| places[i as usize]);
    let cell = 2.0
        * triangles.iter().map(corners).map(|[a, b, c]| a.distance(b).max(b.distance(c))).fold(0.0, f64::max);
    let key = |p: DVec3| (p / cell).floor().as_i64vec3().to_array();
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    triangles.iter().enumerate().for_each(|(i, t)| cells.entry(key(corners(t)[0])).or_default().push(i));
    let side = |[a, b, c]: [DVec3; 3], p: DVec3| (b - a).cross(c - a).dot(p - a);
    let passes = |[p, q]: [DVec3; 2], t: [DVec3; 3]| {
        let around = [[p, q, t[0]], [p, q, t[1]], [p, q, t[2]]];
        let turns = [side(around[0], t[1]), side(around[1], t[2]), side(around[2], t[0])];
        side(t, p) * side(t, q) < 0.0 && (turns.iter().all(|s| *s > 0.0) || turns.iter().all(|s| *s < 0.0))
    };
    let mut count = 0;
    for (i, t) in triangles.iter().enumerate() {
        let own = corners(t);
        let at = key(own[0]);
        for n in 0..27 {
            let next = [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1];
            for j in cells.get(&next).into_iter().flatten().filter(|j| **j != i) {
                let other = &triangles[*j];
                if !other.iter().any(|c| t.contains(c)) {
                    let edges = (0..3).map(|k| [own[k], own[(k + 1) % 3]]);
                    count += usize::from(edges.into_iter().any(|edge| passes(edge, corners(other))));
                }
            }
        }
    }
    count
}

fn ends(setup: Setup) -> Setup {
    setup.held(|p| p.x < 0.05, |p| p.x > 0.95)
}

#[test]
fn what_is_not_moved_stays_to_the_last_bit() {
    let setup = ends(bar(0.2, 20));
    let out = setup.run(Affine::IDENTITY, &Listener::default()).unwrap();
    assert!(out.iter().zip(&setup.places).all(|(q, p)| q.as_vec3() == p.as_vec3()));
}

/// A bar rests where finite elements have it rest.
#[test]
fn bars_sag_as_finite_elements_do() {
    let figures: serde_json::Value =
        serde_json::from_str(include_str!("../../../tests/reference/elastic.json")).unwrap();
    let point = |v: &serde_json::Value| DVec3::from([0, 1, 2].map(|i| v[i].as_f64().unwrap()));
    let points: Vec<DVec3> = figures["points"].as_array().unwrap().iter().map(point).collect();
    for case in figures["cases"].as_array().unwrap() {
        let mut setup = bar(0.2, 40).held(|p| p.x < 1e-6, |_| false);
        setup.poisson = case["poisson"].as_f64().unwrap();
        setup.weight = case["load"].as_f64().unwrap() * setup.bounds_diagonal();
        let out = setup.run(Affine::IDENTITY, &Listener::default()).unwrap();
        let moved: Vec<DVec3> = case["moved"].as_array().unwrap().iter().map(point).collect();
        let far = moved.iter().map(|m| m.length()).fold(0.0, f64::max);
        for (p, m) in points.iter().zip(&moved) {
            let near = |i: &usize| setup.places[*i].distance(*p);
            let i = (0..out.len()).min_by(|a, b| near(a).total_cmp(&near(b))).unwrap();
            assert!(near(&i) < 1e-6);
            let off = (out[i] - setup.places[i]).distance(*m) / far;
            assert!(off < 0.02, "{} {p}: {} instead of {m}, {off}", setup.poisson, out[i] - setup.places[i]);
        }
    }
}

impl Setup {
    fn bounds_diagonal(&self) -> f64 {
        self.bounds().diagonal()
    }
}

#[test]
fn volume_is_kept() {
    let mut setup = ends(bar(0.2, 30));
    setup.poisson = 0.49;
    let before = volume(&setup.places, &setup.triangles);
    for motion in [
        turn(DVec3::Y, -90.0, DVec3::new(0.5, 0.0, 0.4), DVec3::ZERO),
        turn(DVec3::X, 90.0, DVec3::ZERO, DVec3::ZERO),
        turn(DVec3::X, 0.0, DVec3::ZERO, 0.3 * DVec3::X),
    ] {
        let after = volume(&setup.run(motion, &Listener::default()).unwrap(), &setup.triangles);
        assert!((after / before - 1.0).abs() < 0.02, "{}", after / before);
    }
}

/// A bar is bent back upon itself, and its end pressed into it from above: it gives way. Without contact both
/// are in one place.
#[test]
fn a_half_turn_passes_nowhere_through_itself() {
    let mut setup = ends(bar(0.12, 50));
    let motion = turn(DVec3::Y, -180.0, DVec3::new(0.55, 0.0, 0.03), DVec3::ZERO);
    let crossing =
        |setup: &Setup| crossings(&setup.run(motion, &Listener::default()).unwrap(), &setup.triangles);
    assert_eq!(crossing(&setup), 0);
    setup.contact = false;
    assert!(crossing(&setup) > 50);
}

#[test]
fn samples_go_the_same_way_on_any_number_of_threads() {
    let mut setup = ends(bar(0.2, 20));
    setup.resolution = 12.0;
    let motion = turn(DVec3::Y, -60.0, DVec3::new(0.5, 0.0, 0.3), DVec3::ZERO);
    let one = setup.run(motion, &Listener::default()).unwrap();
    let other = setup.run(motion, &Listener { backwards: true, ..Listener::default() }).unwrap();
    assert_eq!(one, other);
}

#[test]
fn bodies_that_are_not_one_solid_are_told() {
    let told = |setup: &Setup| {
        let host = Listener::default();
        let motion = turn(DVec3::Y, -30.0, DVec3::new(0.5, 0.0, 0.3), DVec3::ZERO);
        let out = setup.run(motion, &host).unwrap();
        assert!(out.iter().all(|p| p.is_finite()));
        (host.lines.into_inner().unwrap().concat(), out)
    };
    let mut setup = bar(0.2, 20);
    setup.resolution = 12.0;
    assert_eq!(told(&ends(setup.clone())).0, "");
    // A second bar above, which nothing holds, goes along without a change of shape.
    let count = setup.places.len() as u32;
    let (places, triangles) = block(DVec3::new(0.2, 0.1, 0.1), [4, 2, 2]);
    setup.places.extend(places.iter().map(|p| *p + DVec3::new(0.8, 0.0, 0.4)));
    setup.triangles.extend(triangles.iter().map(|t| t.map(|i| i + count)));
    let held = setup.clone().held(|p| p.x < 0.05, |p| p.x > 0.95 && p.z < 0.2);
    let (lines, out) = told(&held);
    assert!(lines.contains("1 of 2 parts"), "{lines}");
    let (a, b) = (count as usize, count as usize + 9);
    let [before, after] = [&held.places, &out].map(|p| p[a].distance(p[b]));
    assert!((before - after).abs() < 1e-5 && out[a].distance(held.places[a]) > 0.05);
    // A sheet, and a box without a lid.
    let sheet = |thick: f64| {
        let (places, mut triangles) = block(DVec3::new(1.0, 0.4, thick), [20, 8, 8]);
        triangles.retain(|t| t.iter().any(|i| places[*i as usize].z < 0.5 * thick - 1e-9));
        let mut setup = Setup::new((places, triangles)).held(|p| p.x < -0.45, |p| p.x > 0.45);
        setup.resolution = 12.0;
        setup
    };
    assert!(told(&sheet(0.4)).0.contains("has holes"));
    let mut flat = sheet(0.4);
    flat.places.iter_mut().for_each(|p| p.z = 0.0);
    assert!(told(&flat).0.contains("encloses nothing"));
}

#[test]
fn what_cannot_be_is_refused() {
    let setup = bar(0.2, 10);
    let refused = |setup: &Setup, host: &Listener| setup.run(Affine::IDENTITY, host).unwrap_err();
    let error = refused(&Setup { weight: 0.1, ..setup.clone() }, &Listener::default());
    assert!(error.message.contains("nothing holds") && !error.hint.is_empty(), "{error}");
    let cube = Setup::new(block(DVec3::ONE, [4; 3])).held(|p| p.x < 0.0, |_| false);
    let error = refused(&Setup { resolution: 40.0, weight: 0.1, ..cube }, &Listener::default());
    assert!(error.message.contains("too fine") && error.hint.contains("lower"), "{error}");
    let error = refused(&ends(setup), &Listener { stop: true, ..Listener::default() });
    assert_eq!(error.code, ErrorCode::CANCELLED);
}

/// Drafts are near to the full results.
#[test]
fn drafts_are_near() {
    let mut setup = ends(bar(0.2, 30));
    let motion = turn(DVec3::Y, -80.0, DVec3::new(0.5, 0.0, 0.4), DVec3::ZERO);
    let full = setup.run(motion, &Listener::default()).unwrap();
    setup.effort = Effort::DRAFT;
    let draft = setup.run(motion, &Listener::default()).unwrap();
    let off = full.iter().zip(&draft).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(off < 0.05, "{off}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// All results are finite, and held samples do as their regions do, whatever the handle does.
    #[test]
    fn any_motion_has_a_rest(rows in prop::array::uniform3(prop::array::uniform4(-2.0..2.0_f64)), poisson in 0.0..0.495_f64) {
        let mut setup = ends(bar(0.25, 8));
        (setup.resolution, setup.poisson) = (6.0, poisson);
        let motion = Affine { rows };
        let out = setup.run(motion, &Listener::default()).unwrap();
        for ((q, p), handle) in out.iter().zip(&setup.places).zip(&setup.handle) {
            prop_assert!(q.is_finite());
            prop_assert!(*handle == 0.0 || q.distance(motion.apply((*p).into()).into()) < 1e-5);
        }
    }

    /// A body that one handle alone holds goes along as it is.
    #[test]
    fn what_nothing_else_holds_goes_along(degrees in -179.0..179.0_f64, by in prop::array::uniform3(-1.0..1.0_f64)) {
        let mut setup = bar(0.25, 8).held(|_| false, |p| p.x > 0.7);
        (setup.resolution, setup.contact) = (6.0, false);
        let motion = turn(DVec3::new(0.6, 0.0, 0.8), degrees, DVec3::ZERO, DVec3::from(by));
        for (q, p) in setup.run(motion, &Listener::default()).unwrap().iter().zip(&setup.places) {
            let off = q.distance(motion.apply((*p).into()).into());
            prop_assert!(off < 1e-3, "{off}");
        }
    }
}
