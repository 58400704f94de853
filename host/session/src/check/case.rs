//! What a plugin is given: samples, regions, motions and parameters, made the same way each time.

use super::{Checked, Finding};
use crate::deformer::Plugin;
use crate::params::{LocalParams, Params};
use crate::stack::{neighbour_lists, rows};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use simod_core::frame::Frame;
use simod_core::geometry::Bounds;
use simod_core::sampling::SampleSet;
use simod_plugin_api::{
    Affine, DeformInput, Graph, Param, Part, PrepareInput, Region, Role, Samples, Triangles,
};
use std::hash::{DefaultHasher, Hash, Hasher};

/// All that a plugin is given for one deformation, local coordinates.
#[derive(Clone)]
pub(super) struct Case {
    pub positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    spacing: Vec<f32>,
    /// Each sample with its two nearest: no surface, but triangles as they may be.
    triangles: Vec<[u32; 3]>,
    /// Where the neighbours of each sample begin, and all of them; nothing if the plugin does not ask for them.
    neighbours: Option<(Vec<u32>, Vec<u32>)>,
    pub bounds: simod_plugin_api::Bounds,
    pub regions: Vec<(Role, Vec<f32>)>,
    /// One for each handle region.
    pub transforms: Vec<Affine>,
    params: LocalParams,
}

impl Case {
    /// The given samples with as many regions as the plugin wants, moved handles, and default parameters. Normals of
    /// zero are estimated, as the host does it.
    pub fn new(plugin: &Plugin, positions: Vec<Vec3>, normals: Vec<Vec3>) -> Checked<Self> {
        let set = SampleSet::new(positions, normals).map_err(|e| Finding::skip(e.to_string()))?;
        let bounds = Bounds::of(set.positions.iter().map(|p| p.as_dvec3()));
        let params = params(plugin, &bounds, &toml::Table::new())?;
        let regions = regions(plugin, set.len());
        let graph = set.neighbours();
        let (starts, all) = neighbour_lists(graph, set.len());
        let neighbours = plugin.consumes().graph.then(|| (starts, all.to_vec()));
        let triangle = |i: usize| graph.of(i).get(..2).map(|near| [i as u32, near[0], near[1]]);
        let triangles = (0..set.len()).filter(|_| plugin.consumes().triangles).filter_map(triangle).collect();
        let handles = regions.iter().filter(|(role, _)| *role == Role::HANDLE).count();
        Ok(Self {
            transforms: (0..handles).map(|i| rows(motion(&bounds, i))).collect(),
            normals: bytemuck::cast_slice(set.normals()).to_vec(),
            spacing: set.spacing().to_vec(),
            triangles,
            neighbours,
            bounds: simod_plugin_api::Bounds { min: bounds.min.to_array(), max: bounds.max.to_array() },
            positions: bytemuck::cast_slice(&set.positions).to_vec(),
            regions,
            params,
        })
    }

    /// A sphere with bumps, of so many samples.
    pub fn bumpy_sphere(plugin: &Plugin, count: usize) -> Checked<Self> {
        let (positions, normals) = (0..count).map(|i| bumpy_sphere(i, count)).unzip();
        Self::new(plugin, positions, normals)
    }

    /// The same with other parameters, as a user would write them; those that are not given have their defaults.
    pub fn with_params(&self, plugin: &Plugin, given: &toml::Table) -> Checked<Self> {
        let corner = DVec3::from_array;
        let bounds = Bounds { min: corner(self.bounds.min), max: corner(self.bounds.max) };
        Ok(Self { params: params(plugin, &bounds, given)?, ..self.clone() })
    }

    /// All samples in handles that do the same: as many handles as the plugin needs, each with a part of the samples.
    pub fn all_handles(mut self, handles: usize, transform: Affine) -> Self {
        let count = self.positions.len();
        let part = |h: usize| (0..count).map(|i| f32::from(u8::from(i * handles / count == h))).collect();
        self.regions = (0..handles).map(|h| (Role::HANDLE, part(h))).collect();
        self.transforms = vec![transform; handles];
        self
    }

    /// A hash of all bytes that a plugin sees.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        bytemuck::cast_slice::<_, u8>(&self.positions).hash(&mut hasher);
        bytemuck::cast_slice::<_, u8>(&self.normals).hash(&mut hasher);
        bytemuck::cast_slice::<_, u8>(&self.spacing).hash(&mut hasher);
        self.triangles.hash(&mut hasher);
        self.neighbours.hash(&mut hasher);
        for (role, weights) in &self.regions {
            role.0.hash(&mut hasher);
            bytemuck::cast_slice::<_, u8>(weights).hash(&mut hasher);
        }
        for x in self.transforms.iter().flat_map(|t| t.rows.as_flattened()) {
            x.to_bits().hash(&mut hasher);
        }
        self.params.hash(&mut hasher);
        hasher.finish()
    }

    fn samples(&self) -> Samples<'_> {
        Samples::new(&self.positions, &self.normals, &self.spacing)
    }

    /// Calls with what a preparation gets.
    pub fn prepare_input<T>(&self, call: impl FnOnce(&PrepareInput<'_>) -> T) -> T {
        let regions: Vec<Region<'_>> = self.regions.iter().map(|(role, w)| Region::new(*role, w)).collect();
        let params = self.params.views();
        let triangles = Triangles::new(&self.triangles);
        let graph = self.neighbours.as_ref().map(|(starts, all)| Graph::new(starts, all));
        let mut parts: Vec<Part<'_>> = graph.iter().map(Part::new).collect();
        if !self.triangles.is_empty() {
            parts.push(Part::new(&triangles));
        }
        call(&PrepareInput::new(self.samples(), self.bounds, &regions, &params).with_parts(&parts))
    }

    /// Calls with what a deformation gets.
    pub fn deform_input<T>(&self, call: impl FnOnce(&DeformInput<'_>) -> T) -> T {
        let params: Vec<Param<'_>> = self.params.views();
        call(&DeformInput::new(self.samples(), self.bounds, &self.transforms, &params))
    }
}

/// A point of a sphere with bumps, whose box has a diagonal between 1 and 2, and the normal there. Points go round
/// the z axis from one pole to the other, evenly spread.
fn bumpy_sphere(i: usize, count: usize) -> (Vec3, Vec3) {
    const RADIUS: f64 = 0.5;
    const BUMPS: f64 = 0.05;
    const WAVES: f64 = 5.0;
    let z = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
    // The golden angle.
    let (sin, cos) = (i as f64 * (3.0 - 5_f64.sqrt()) * std::f64::consts::PI).sin_cos();
    let d = DVec3::new(cos, sin, 0.0) * (1.0 - z * z).max(0.0).sqrt() + DVec3::Z * z;
    let (s, c) = ((d * WAVES).map(f64::sin), (d * WAVES).map(f64::cos));
    let radius = RADIUS + BUMPS * s.x * s.y * s.z;
    let slope = BUMPS * WAVES * DVec3::new(c.x * s.y * s.z, s.x * c.y * s.z, s.x * s.y * c.z);
    let normal = d * radius - (slope - d * slope.dot(d));
    ((d * radius).as_vec3(), normal.normalize_or(d).as_vec3())
}

/// Regions as the plugin wants them, fixed ones first: each a run of samples, with a soft end, and gaps in between.
fn regions(plugin: &Plugin, count: usize) -> Vec<(Role, Vec<f32>)> {
    const SOFT: f64 = 0.02;
    let wanted = |used: bool, least: u32| if used { least.max(1) as usize } else { 0 };
    let consumes = plugin.consumes();
    let fixed = wanted(consumes.fixed_regions, consumes.min_fixed);
    let handles = wanted(consumes.handle_regions, consumes.min_handles);
    let all = (fixed + handles) as f64;
    let region = |r: usize| {
        let (from, to) = (r as f64 / all, (r as f64 + 0.5) / all);
        let weight = |i: usize| {
            let t = (i as f64 + 0.5) / count as f64;
            let outside = (from - t).max(t - to).max(0.0);
            (1.0 - outside / SOFT).max(0.0) as f32
        };
        let role = if r < fixed { Role::FIXED } else { Role::HANDLE };
        (role, (0..count).map(weight).collect())
    };
    (0..fixed + handles).map(region).collect()
}

/// How a handle moves: a turn about an odd axis, and a shift.
pub(super) fn motion(bounds: &Bounds, handle: usize) -> DAffine3 {
    let centre = bounds.center();
    let axis = DVec3::new(1.0, 2.0, 3.0).normalize_or(DVec3::X);
    let shift = DVec3::new(0.08, -0.05, 0.1) * bounds.diagonal() * (1.0 + 0.5 * handle as f64);
    DAffine3::from_translation(centre + shift)
        * DAffine3::from_quat(DQuat::from_axis_angle(axis, 0.35))
        * DAffine3::from_translation(-centre)
}

fn params(plugin: &Plugin, bounds: &Bounds, given: &toml::Table) -> Checked<LocalParams> {
    let frame = Frame { origin: DVec3::ZERO, scale: 1.0 };
    let params = Params::check(plugin.id(), plugin.params(), given);
    Ok(params.map_err(|e| Finding::skip(e.to_string()))?.to_local(&frame, bounds))
}
