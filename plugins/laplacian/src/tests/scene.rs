//! Models, regions and calls of the plugin.

use crate::{Laplacian, PreparedSurface};
use glam::DVec3;
use rayon::prelude::*;
use simod_plugin_api::{
    Affine, Bounds, DeformInput, Deformer, Effort, Graph, Host, HostCalls, LogLevel, Param, ParamKind, Part,
    PluginResult, PrepareInput, Region, Role, Samples, Triangles,
};

/// A host with threads.
pub struct Threads;

impl HostCalls for Threads {
    fn progress(&self, _: f64) -> bool {
        true
    }
    fn log(&self, _: LogLevel, _: &str) {}
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        (0..count).into_par_iter().for_each(body);
        true
    }
}

/// A model with regions and parameters.
#[derive(Clone)]
pub struct Scene {
    pub points: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    /// Nearest neighbours of each sample, or none at all.
    pub neighbours: Vec<Vec<u32>>,
    pub regions: Vec<(Role, Vec<f32>)>,
    pub mode: &'static str,
    pub surroundings: &'static str,
    pub decrease: f64,
    pub weights: &'static str,
    pub bending: f64,
    pub iterations: f64,
    pub tolerance: f64,
    pub effort: Effort,
}

impl Scene {
    pub fn new(points: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Self {
        Self {
            points,
            triangles,
            neighbours: Vec::new(),
            regions: Vec::new(),
            mode: "smooth-arap",
            surroundings: "spokes-and-rims",
            decrease: 1e-6,
            weights: "robust",
            bending: 0.03,
            iterations: 1000.0,
            tolerance: 1e-7,
            effort: Effort::FULL,
        }
    }

    /// Scene with a further region of all points that are inside.
    pub fn region(mut self, role: Role, inside: impl Fn([f64; 3]) -> bool) -> Self {
        let weights = self.points.iter().map(|p| f32::from(u8::from(inside(p.map(f64::from))))).collect();
        self.regions.push((role, weights));
        self
    }

    /// Without triangles, and with the nearest `k` neighbours.
    pub fn cloud(mut self, k: usize) -> Self {
        self.triangles.clear();
        let points: Vec<DVec3> = self.points.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let near = |i: usize| {
            let mut all: Vec<u32> = (0..points.len() as u32).filter(|j| *j as usize != i).collect();
            all.sort_by(|a, b| {
                let d = |j: &u32| points[i].distance_squared(points[*j as usize]);
                d(a).total_cmp(&d(b)).then(a.cmp(b))
            });
            all.truncate(k);
            all
        };
        self.neighbours = (0..points.len()).into_par_iter().map(near).collect();
        self
    }

    pub fn bounds(&self) -> Bounds {
        let by = |start: f64, f: fn(f64, f64) -> f64| {
            std::array::from_fn(|k| self.points.iter().map(|p| f64::from(p[k])).fold(start, f))
        };
        Bounds { min: by(f64::INFINITY, f64::min), max: by(f64::NEG_INFINITY, f64::max) }
    }

    pub fn prepare(&self) -> PluginResult<PreparedSurface> {
        self.prepare_with(&Threads)
    }

    pub fn prepare_with(&self, host: &impl HostCalls) -> PluginResult<PreparedSurface> {
        self.with_input(|input| Laplacian::prepare(input, &Host::new(host)))
    }

    /// Calls with the preparation's input.
    pub fn with_input<T>(&self, call: impl FnOnce(&PrepareInput<'_>) -> T) -> T {
        let regions: Vec<Region<'_>> = self.regions.iter().map(|(role, w)| Region::new(*role, w)).collect();
        let numbers = [[self.iterations], [self.tolerance], [self.bending], [self.decrease]];
        let params = self.params(&numbers);
        let triangles = Triangles::new(&self.triangles);
        let mut starts = vec![0];
        starts.extend(self.neighbours.iter().scan(0, |end, near| {
            *end += near.len() as u32;
            Some(*end)
        }));
        let all = self.neighbours.concat();
        let graph = Graph::new(&starts, &all);
        let mut parts = Vec::new();
        if !self.triangles.is_empty() {
            parts.push(Part::new(&triangles));
        }
        if !self.neighbours.is_empty() {
            parts.push(Part::new(&graph));
        }
        let samples = Samples::new(&self.points, &[], &[]);
        call(&PrepareInput::new(samples, self.bounds(), &regions, &params).with_parts(&parts))
    }

    fn params<'a>(&'a self, numbers: &'a [[f64; 1]; 4]) -> [Param<'a>; 7] {
        [
            Param::text("mode", ParamKind::CHOICE, self.mode),
            Param::text("weights", ParamKind::CHOICE, self.weights),
            Param::numbers("iterations", ParamKind::INT, &numbers[0]),
            Param::numbers("tolerance", ParamKind::FLOAT, &numbers[1]),
            Param::numbers("bending", ParamKind::FLOAT, &numbers[2]),
            Param::numbers("decrease", ParamKind::FLOAT, &numbers[3]),
            Param::text("surroundings", ParamKind::CHOICE, self.surroundings),
        ]
    }

    pub fn deform(&self, state: &PreparedSurface, transforms: &[Affine]) -> Vec<[f32; 3]> {
        self.deform_with(state, transforms, &Threads).unwrap()
    }

    pub fn deform_with(
        &self,
        state: &PreparedSurface,
        transforms: &[Affine],
        host: &impl HostCalls,
    ) -> PluginResult<Vec<[f32; 3]>> {
        let numbers = [[self.iterations], [self.tolerance], [self.bending], [self.decrease]];
        let params = self.params(&numbers);
        let samples = Samples::new(&self.points, &[], &[]);
        let parts = [Part::new(&self.effort)];
        let input = DeformInput::new(samples, self.bounds(), transforms, &params).with_parts(&parts);
        let mut out = vec![[f32::NAN; 3]; self.points.len()];
        Laplacian::deform(state, &input, &mut (), &mut out, &Host::new(host))?;
        Ok(out)
    }

    pub fn run(&self, transforms: &[Affine]) -> Vec<[f32; 3]> {
        self.deform(&self.prepare().unwrap(), transforms)
    }
}

/// A square pipe along z, `[-w, w]²` across and `[0, 1]` long, closed at its ends: `n` cells along each side
/// of the cross section, `m` along z.
pub fn bar(n: usize, m: usize, w: f64) -> Scene {
    grid_box([n, n, m], DVec3::new(-w, -w, 0.0), DVec3::new(w, w, 1.0))
}

/// The surface of a box, as grids whose diagonals are all alike.
fn grid_box(cells: [usize; 3], min: DVec3, max: DVec3) -> Scene {
    let mut index = std::collections::BTreeMap::new();
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in 0..2 {
            let mut corner = |i: usize, j: usize| {
                let mut at = [0; 3];
                (at[axis], at[u], at[v]) = (side * cells[axis], i, j);
                *index.entry(at).or_insert_with(|| {
                    let t = DVec3::from_array(std::array::from_fn(|k| at[k] as f64 / cells[k] as f64));
                    points.push((min + t * (max - min)).as_vec3().to_array());
                    points.len() as u32 - 1
                })
            };
            for i in 0..cells[u] {
                for j in 0..cells[v] {
                    let (a, b, c, d) =
                        (corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1));
                    let mut both = [[a, b, c], [a, c, d]];
                    if side == 0 {
                        both.iter_mut().for_each(|t| t.swap(1, 2));
                    }
                    triangles.extend(both);
                }
            }
        }
    }
    Scene::new(points, triangles)
}

/// A tube along z, closed in the round and open at its ends: `n` around, `m` along.
pub fn tube(n: usize, m: usize, radius: f64) -> Scene {
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    for j in 0..=m {
        for i in 0..n {
            let (s, c) = (std::f64::consts::TAU * i as f64 / n as f64).sin_cos();
            points.push([radius * c, radius * s, j as f64 / m as f64].map(|x| x as f32));
            if j < m {
                let at = |i: usize, j: usize| (j * n + i % n) as u32;
                triangles.extend([
                    [at(i, j), at(i + 1, j), at(i + 1, j + 1)],
                    [at(i, j), at(i + 1, j + 1), at(i, j + 1)],
                ]);
            }
        }
    }
    Scene::new(points, triangles)
}

/// Held below, a handle above.
pub fn held_at_ends(scene: Scene, end: f64) -> Scene {
    scene.region(Role::FIXED, |p| p[2] < end).region(Role::HANDLE, |p| p[2] > 1.0 - end)
}

/// Turns about an axis through a point, and moves.
pub fn turn(axis: DVec3, degrees: f64, pivot: DVec3, by: DVec3) -> Affine {
    let m = glam::DMat3::from_axis_angle(axis.normalize_or(DVec3::Z), degrees.to_radians());
    let t = pivot - m * pivot + by;
    Affine { rows: std::array::from_fn(|r| [m.x_axis[r], m.y_axis[r], m.z_axis[r], t[r]]) }
}
