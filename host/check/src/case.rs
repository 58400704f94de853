//! The input of a plugin under check: samples, regions, motions and parameters, made the same way each
//! time.

use crate::answer::{Listener, PluginRefusal, answer};
use crate::finding::{Checked, Finding};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use simod_core::sampling::SampleSet;
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_plugin_api::{
    Affine, Attribute, AttributeKind, Attributes, DeformInput, Graph, HandleMotions, Joint, Joints,
    ModelFrame, OtherModel, OtherModels, Param, ParamKind, Part, PointsKind, PrepareInput, Region,
    RestPositions, Role, Samples, Stroke, Strokes, Time, Triangles,
};
use simod_session::deformer::{OwnHandles, Plugin, check_handles};
use simod_session::key::Key;
use simod_session::params::{LocalParams, Params};
use simod_session::stack::{neighbour_lists, rows};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;

/// A brush's radius, as a fraction of the diagonal.
const BRUSH: f64 = 0.1;

/// Name of all other models.
const OTHER: &str = "other.ply";

/// Points of another model.
#[derive(Clone)]
pub(crate) struct Other {
    pub positions: Vec<[f64; 3]>,
    pub normals: Vec<[f32; 3]>,
    /// Ids of the points; none of a model that was sampled for the plugin.
    pub ids: Vec<u64>,
    pub triangles: Vec<[u32; 3]>,
}

/// Input of a plugin for one deformation, in local coordinates.
#[derive(Clone)]
pub(crate) struct Case {
    pub positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    spacing: Vec<f32>,
    /// Triangles of each sample with its two nearest ones: no surface, but triangles as they may be.
    triangles: Vec<[u32; 3]>,
    /// Beginning of each sample's neighbours in the list, and the list of all; nothing if the plugin does
    /// not ask for neighbours.
    neighbours: Option<(Vec<u32>, Vec<u32>)>,
    pub bounds: simod_plugin_api::Bounds,
    pub regions: Vec<(Role, Vec<f32>)>,
    /// Motion of each handle region.
    pub transforms: Vec<Affine>,
    /// Joints, if the plugin uses some: ids, places, and the index of each one's parent.
    joints: Vec<(String, [f64; 3], u32)>,
    /// Whether the plugin uses the model's frame.
    frame: bool,
    /// Positions at rest, a little beside the present ones, if the plugin uses them.
    rest: Option<Vec<[f32; 3]>>,
    /// Time of a sequence, if the plugin uses it.
    time: Option<Time>,
    /// Names and values of the samples' attributes, if the plugin uses them.
    pub attributes: Option<Vec<(String, Vec<f32>)>>,
    /// Model that all parameters of the plugin which take another model name, if it has such parameters.
    pub other: Option<Other>,
    /// Motions of the handles that the plugin placed for these joints, samples and parameters.
    pub handles: Vec<Affine>,
    /// Paths of strokes, if the plugin uses some.
    pub strokes: Vec<Vec<[f64; 3]>>,
    params: LocalParams,
}

impl Case {
    /// Case of the given samples with as many regions as the plugin wants, moved handles, and default
    /// parameters. Normals of zero are estimated, as the host does.
    pub fn new(plugin: &Plugin, positions: Vec<Vec3>, normals: Vec<Vec3>) -> Checked<Self> {
        let set = SampleSet::new(positions, normals).map_err(|e| Finding::skip(e.to_string()))?;
        let bounds = Bounds::from_points(set.positions.iter().map(|p| p.as_dvec3()));
        let takes_models = plugin.params().iter().any(|d| d.kind == ParamKind::MODEL);
        let params = params(plugin, &bounds, &toml::Table::new())?;
        let regions = regions(plugin, set.len());
        let graph = set.neighbours();
        let (starts, all) = neighbour_lists(graph, set.len());
        let neighbours = plugin.consumes().graph.then(|| (starts, all.to_vec()));
        let triangle = |i: usize| graph.nearest_to(i).get(..2).map(|near| [i as u32, near[0], near[1]]);
        let triangles = (0..set.len()).filter(|_| plugin.consumes().triangles).filter_map(triangle).collect();
        let handles = regions.iter().filter(|(role, _)| *role == Role::HANDLE).count();
        let consumes = plugin.consumes();
        let mut case = Self {
            transforms: (0..handles).map(|i| rows(motion(&bounds, i))).collect(),
            normals: bytemuck::cast_slice(set.normals()).to_vec(),
            spacing: set.spacing().to_vec(),
            triangles,
            neighbours,
            bounds: simod_plugin_api::Bounds { min: bounds.min.to_array(), max: bounds.max.to_array() },
            joints: if consumes.joints { joints(&bounds) } else { Vec::new() },
            frame: consumes.frame,
            rest: consumes
                .rest_positions
                .then(|| set.positions.iter().map(|p| [p.x + 0.01, p.y, p.z]).collect()),
            attributes: consumes.attributes.then(|| colours(set.len())),
            time: consumes.time.then_some(Time { frame: 12, seconds: 0.5 }),
            other: takes_models.then(|| other(&set, &bounds)),
            handles: Vec::new(),
            strokes: if consumes.strokes { strokes(&set.positions) } else { Vec::new() },
            positions: bytemuck::cast_slice(&set.positions).to_vec(),
            regions,
            params,
        };
        case.move_handles(plugin)?;
        Ok(case)
    }

    /// Moves the handles that the plugin places, each by a motion of its own.
    fn move_handles(&mut self, plugin: &Plugin) -> Checked<()> {
        let placed = self.placed_handles(plugin)?;
        let corner = DVec3::from_array;
        let bounds = Bounds { min: corner(self.bounds.min), max: corner(self.bounds.max) };
        self.handles = (0..placed.descs.len()).map(|i| rows(motion(&bounds, i % 3))).collect();
        Ok(())
    }

    /// The handles that the plugin places.
    pub fn placed_handles(&self, plugin: &Plugin) -> Checked<OwnHandles> {
        if !plugin.capabilities().handles {
            return Ok(OwnHandles::default());
        }
        let call =
            |input: &PrepareInput<'_>| plugin.code().handles(&input.without_regions(), &Listener::patient());
        let handles = answer("handles", self.prepare_input(call))?.map_err(PluginRefusal::of_ordinary)?;
        check_handles(&handles).map_err(|what| Finding::fail(what, "see `HandleDesc`"))?;
        Ok(handles)
    }

    /// Same case with all regions and handles at rest, and without strokes.
    pub fn at_rest(mut self) -> Self {
        self.transforms.fill(Affine::IDENTITY);
        self.handles.fill(Affine::IDENTITY);
        self.strokes.clear();
        self
    }

    /// Same case at another time of a sequence.
    pub fn at_time(mut self, time: Time) -> Self {
        self.time = Some(time);
        self
    }

    /// Same case with other attributes: their names, and the value of each for sample `i`.
    pub fn with_attributes(mut self, names: &[&str], value: impl Fn(usize) -> f32) -> Self {
        let values: Vec<f32> = (0..self.positions.len()).map(value).collect();
        self.attributes = Some(names.iter().map(|name| ((*name).to_owned(), values.clone())).collect());
        self
    }

    /// Same case with another model in the place of those that parameters name, or with none.
    pub fn with_other(mut self, other: Option<Other>) -> Self {
        self.params.name_models(if other.is_some() { OTHER } else { "" });
        self.other = other;
        self
    }

    /// Case of a sphere with bumps, of so many samples.
    pub fn bumpy_sphere(plugin: &Plugin, count: usize) -> Checked<Self> {
        let (positions, normals) = (0..count).map(|i| bumpy_sphere(i, count)).unzip();
        Self::new(plugin, positions, normals)
    }

    /// Same case with other parameters, as a user would write them; parameters that are not given have
    /// their defaults.
    pub fn with_params(&self, plugin: &Plugin, given: &toml::Table) -> Checked<Self> {
        let corner = DVec3::from_array;
        let bounds = Bounds { min: corner(self.bounds.min), max: corner(self.bounds.max) };
        let mut case = Self { params: params(plugin, &bounds, given)?, ..self.clone() };
        case.move_handles(plugin)?;
        Ok(case)
    }

    /// Whether one preparation is for both cases, which differ in their parameters alone: the plugin says
    /// which of these invalidate it.
    pub fn is_prepared_as(&self, other: &Self, plugin: &Plugin) -> bool {
        let prepares = |id: &str| plugin.params().iter().any(|d| d.id == id && d.invalidates_preparation);
        self.params.some(prepares) == other.params.some(prepares)
    }

    /// Same case without any sample.
    pub fn without_samples(mut self) -> Self {
        self.positions.clear();
        self.normals.clear();
        self.spacing.clear();
        self.triangles.clear();
        self.rest = self.rest.map(|_| Vec::new());
        self.attributes.iter_mut().flatten().for_each(|(_, values)| values.clear());
        self.neighbours = self.neighbours.map(|_| (vec![0], Vec::new()));
        self.regions.iter_mut().for_each(|(_, weights)| weights.clear());
        self
    }

    /// Same case with all samples in handles of one motion: as many handles as the plugin needs, each with
    /// a part of the samples.
    pub fn all_handles(mut self, handles: usize, transform: Affine) -> Self {
        let count = self.positions.len();
        let part = |h: usize| (0..count).map(|i| f32::from(u8::from(i * handles / count == h))).collect();
        self.regions = (0..handles).map(|h| (Role::HANDLE, part(h))).collect();
        self.transforms = vec![transform; handles];
        self.handles.fill(transform);
        self
    }

    /// Hash of all bytes that a plugin sees.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        bytemuck::cast_slice::<_, u8>(&self.positions).hash(&mut hasher);
        bytemuck::cast_slice::<_, u8>(&self.normals).hash(&mut hasher);
        bytemuck::cast_slice::<_, u8>(&self.spacing).hash(&mut hasher);
        self.triangles.hash(&mut hasher);
        self.neighbours.hash(&mut hasher);
        for (_, values) in self.attributes.iter().flatten() {
            bytemuck::cast_slice::<_, u8>(values).hash(&mut hasher);
        }
        if let Some(Other { positions, normals, ids, triangles }) = &self.other {
            bytemuck::cast_slice::<_, u8>(positions).hash(&mut hasher);
            bytemuck::cast_slice::<_, u8>(normals).hash(&mut hasher);
            (ids, triangles).hash(&mut hasher);
        }
        for (role, weights) in &self.regions {
            role.0.hash(&mut hasher);
            bytemuck::cast_slice::<_, u8>(weights).hash(&mut hasher);
        }
        for x in self.transforms.iter().chain(&self.handles).flat_map(|t| t.rows.as_flattened()) {
            x.to_bits().hash(&mut hasher);
        }
        for x in self.strokes.iter().flatten().flatten() {
            x.to_bits().hash(&mut hasher);
        }
        Key::from_key(hasher.finish()).and(&self.params).end()
    }

    fn attributes(&self) -> Option<Vec<Attribute<'_>>> {
        let attribute = |(name, values)| Attribute::new(name, AttributeKind::F32, values);
        let all = self.attributes.as_ref()?;
        Some(all.iter().map(|(name, values): &(String, Vec<f32>)| attribute((name, values))).collect())
    }

    fn other_models(&self) -> Vec<OtherModel<'_>> {
        let Some(Other { positions, normals, ids, triangles }) = &self.other else { return Vec::new() };
        let kind = if ids.is_empty() { PointsKind::SAMPLED } else { PointsKind::SAMPLES };
        let view = |param| {
            OtherModel::new((param, kind, positions.len() as u64), positions, normals, ids, triangles)
        };
        self.params.models().map(view).collect()
    }

    fn samples(&self) -> Samples<'_> {
        Samples::new(&self.positions, &self.normals, &self.spacing)
    }

    /// Calls `call` with the input of a preparation.
    pub fn prepare_input<T>(&self, call: impl FnOnce(&PrepareInput<'_>) -> T) -> T {
        let regions: Vec<Region<'_>> = self.regions.iter().map(|(role, w)| Region::new(*role, w)).collect();
        let params = self.params.views();
        let triangles = Triangles::new(&self.triangles);
        let graph = self.neighbours.as_ref().map(|(starts, all)| Graph::new(starts, all));
        let mut parts: Vec<Part<'_>> = graph.iter().map(Part::new).collect();
        if !self.triangles.is_empty() {
            parts.push(Part::new(&triangles));
        }
        let joints: Vec<_> =
            self.joints.iter().map(|(id, at, parent)| Joint::new(id, *at, *parent)).collect();
        let joints = Joints::new(&joints);
        if !self.joints.is_empty() {
            parts.push(Part::new(&joints));
        }
        // The frame is that of a georeferenced model.
        let frame = ModelFrame { origin: [3e5, 5e6, 100.0], scale: 64.0 };
        if self.frame {
            parts.push(Part::new(&frame));
        }
        let rest = self.rest.as_ref().map(|rest| RestPositions::new(rest));
        parts.extend(rest.iter().map(Part::new));
        let attributes = self.attributes();
        let attributes = attributes.as_deref().map(Attributes::new);
        parts.extend(attributes.iter().map(Part::new));
        let others = self.other_models();
        let others = OtherModels::new(&others);
        if !others.all().is_empty() {
            parts.push(Part::new(&others));
        }
        call(&PrepareInput::new(self.samples(), self.bounds, &regions, &params).with_parts(&parts))
    }

    /// Calls `call` with the input of a deformation.
    pub fn deform_input<T>(&self, call: impl FnOnce(&DeformInput<'_>) -> T) -> T {
        let params: Vec<Param<'_>> = self.params.views();
        // The radius is above 0, also where all samples are in one point.
        let radius = BRUSH * Some(self.bounds.diagonal()).filter(|d| *d > 0.0).unwrap_or(1.0);
        let strokes = self.strokes.iter().enumerate();
        let strokes: Vec<Stroke<'_>> = strokes
            .map(|(i, path)| Stroke::new(i as u64, radius, 1.0 - 0.5 * i as f64, path, &[], &params))
            .collect();
        let (strokes, handles) = (Strokes::new(&strokes), HandleMotions::new(&self.handles));
        let mut parts = Vec::new();
        if !self.handles.is_empty() {
            parts.push(Part::new(&handles));
        }
        if !self.strokes.is_empty() {
            parts.push(Part::new(&strokes));
        }
        parts.extend(self.time.iter().map(Part::new));
        let attributes = self.attributes();
        let attributes = attributes.as_deref().map(Attributes::new);
        parts.extend(attributes.iter().map(Part::new));
        call(&DeformInput::new(self.samples(), self.bounds, &self.transforms, &params).with_parts(&parts))
    }
}

/// Point of a sphere with bumps, whose box has a diagonal between 1 and 2, and the normal there. Points go
/// round the z axis from one pole to the other, evenly spread.
fn bumpy_sphere(i: usize, count: usize) -> (Vec3, Vec3) {
    const RADIUS: f64 = 0.5;
    const BUMPS: f64 = 0.05;
    const WAVES: f64 = 5.0;
    let z = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
    // Points are turned by the golden angle.
    let (sin, cos) = (i as f64 * (3.0 - 5_f64.sqrt()) * std::f64::consts::PI).sin_cos();
    let d = DVec3::new(cos, sin, 0.0) * (1.0 - z * z).max(0.0).sqrt() + DVec3::Z * z;
    let (s, c) = ((d * WAVES).map(f64::sin), (d * WAVES).map(f64::cos));
    let radius = RADIUS + BUMPS * s.x * s.y * s.z;
    let slope = BUMPS * WAVES * DVec3::new(c.x * s.y * s.z, s.x * c.y * s.z, s.x * s.y * c.z);
    let normal = d * radius - (slope - d * slope.dot(d));
    ((d * radius).as_vec3(), normal.normalize_or(d).as_vec3())
}

/// Regions as the plugin wants them, fixed ones first: each a run of samples, with a soft end, and gaps in
/// between.
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

/// Attributes of the samples: a colour that changes from sample to sample, as a scan has it, and a quality.
fn colours(count: usize) -> Vec<(String, Vec<f32>)> {
    let values = |step: usize| (0..count).map(|i| (i * step % 256) as f32).collect();
    [("red", 1), ("green", 3), ("blue", 7), ("quality", 11)]
        .map(|(name, step)| (name.to_owned(), values(step)))
        .into()
}

/// Another model for plugins that take one: the case's own samples, bent and shifted a little.
fn other(set: &SampleSet, bounds: &Bounds) -> Other {
    let diagonal = bounds.diagonal();
    let moved = |p: &Vec3| {
        let p = p.as_dvec3();
        (p + 0.03 * diagonal * DVec3::new((3.0 * p.y).sin(), 0.5, p.x)).to_array()
    };
    let graph = set.neighbours();
    let triangle = |i: usize| graph.nearest_to(i).get(..2).map(|near| [i as u32, near[0], near[1]]);
    Other {
        positions: set.positions.iter().map(moved).collect(),
        normals: bytemuck::cast_slice(set.normals()).to_vec(),
        ids: (0..set.len() as u64).collect(),
        triangles: (0..set.len()).filter_map(triangle).collect(),
    }
}

/// A chain of joints through the box, with a branch.
fn joints(bounds: &Bounds) -> Vec<(String, [f64; 3], u32)> {
    let at =
        |x: f64, y: f64, z: f64| (bounds.min + DVec3::new(x, y, z) * (bounds.max - bounds.min)).to_array();
    [
        ("root", at(0.5, 0.1, 0.5), Joint::ROOT),
        ("middle", at(0.5, 0.5, 0.5), 0),
        ("end", at(0.6, 0.9, 0.5), 1),
        ("branch", at(0.9, 0.6, 0.4), 1),
    ]
    .map(|(id, at, parent)| (id.to_owned(), at, parent))
    .into()
}

/// Two strokes near the surface, the second one of a single point.
fn strokes(positions: &[Vec3]) -> Vec<Vec<[f64; 3]>> {
    let at = |i: usize| positions[i.min(positions.len() - 1)].as_dvec3().to_array();
    vec![(0..8).map(|i| at(i * positions.len() / 40)).collect(), vec![at(positions.len() / 2)]]
}

/// Motion of a handle: a turn about an axis along no coordinate, and a shift.
pub(crate) fn motion(bounds: &Bounds, handle: usize) -> DAffine3 {
    let centre = bounds.center();
    let axis = DVec3::new(1.0, 2.0, 3.0).normalize_or(DVec3::X);
    let shift = DVec3::new(0.08, -0.05, 0.1) * bounds.diagonal() * (1.0 + 0.5 * handle as f64);
    DAffine3::from_translation(centre + shift)
        * DAffine3::from_quat(DQuat::from_axis_angle(axis, 0.35))
        * DAffine3::from_translation(-centre)
}

fn params(plugin: &Plugin, bounds: &Bounds, given: &toml::Table) -> Checked<LocalParams> {
    let frame = Frame { origin: DVec3::ZERO, scale: 1.0 };
    let params = Params::check(plugin.id(), plugin.params(), given, Path::new(""));
    let mut params = params.map_err(|e| Finding::skip(e.to_string()))?.to_local(&frame, bounds);
    params.name_models(OTHER);
    Ok(params)
}
