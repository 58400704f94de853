//! Models with skeletons, and calls of the plugin.

use crate::{Prepared, Skinning};
use glam::{DAffine3, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use simod_plugin_api::{
    Affine, Bounds, DeformInput, Deformer, Evaluate, Graph, HandleDesc, HandleMotions, Handles, Host,
    HostCalls, Joint, Joints, LogLevel, ModelFrame, Param, ParamKind, Part, PluginResult, PrepareInput,
    Samples, Time, Triangles,
};
use std::num::NonZero;
use std::sync::Mutex;

/// Host with threads that collects messages, and may stop the work.
#[derive(Default)]
pub struct Listener {
    pub lines: Mutex<Vec<String>>,
    pub stop: bool,
}

impl HostCalls for Listener {
    fn progress(&self, fraction: f64) -> bool {
        assert!((0.0..=1.0).contains(&fraction), "{fraction}");
        !self.stop
    }
    fn log(&self, _: LogLevel, message: &str) {
        self.lines.lock().unwrap().push(message.to_owned());
    }
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        (0..count).into_par_iter().for_each(body);
        !self.stop
    }
}

/// A model with a skeleton and parameters.
#[derive(Clone)]
pub struct Scene {
    pub points: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    /// Nearest neighbours of each sample, or none at all.
    pub neighbours: Vec<Vec<u32>>,
    pub joints: Vec<(&'static str, [f64; 3], u32)>,
    pub method: &'static str,
    pub binding: &'static str,
    pub reach: &'static str,
    pub reach_length: f64,
    pub skeleton: String,
    pub weights: String,
    pub places: String,
    pub pose: String,
    pub frame: i64,
    pub influences: f64,
    pub resolution: f64,
}

impl Scene {
    pub fn new(
        (points, triangles): (Vec<[f32; 3]>, Vec<[u32; 3]>),
        joints: &[(&'static str, [f64; 3], u32)],
    ) -> Self {
        Self {
            points,
            triangles,
            neighbours: Vec::new(),
            joints: joints.to_vec(),
            method: "dual-quaternion",
            binding: "biharmonic",
            reach: "ends",
            reach_length: 0.0,
            skeleton: String::new(),
            weights: String::new(),
            places: String::new(),
            pose: String::new(),
            frame: 0,
            influences: 4.0,
            resolution: 96.0,
        }
    }

    /// Scene with a cloud of points in the place of the surface.
    pub fn into_cloud(mut self) -> Self {
        self.triangles.clear();
        let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&self.points).unwrap();
        let near = |(i, p): (usize, &[f32; 3])| {
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(NonZero::new(13).unwrap()).execute();
            let mut near: Vec<(f32, u32)> = near.into_iter().map(|n| (n.distance, n.item)).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            near.into_iter().map(|n| n.1).filter(|j| *j != i as u32).collect()
        };
        self.neighbours = self.points.iter().enumerate().map(near).collect();
        self
    }

    fn bounds(&self) -> Bounds {
        let points = || self.points.iter().map(|p| DVec3::from(p.map(f64::from)));
        Bounds {
            min: points().fold(DVec3::INFINITY, DVec3::min).into(),
            max: points().fold(DVec3::NEG_INFINITY, DVec3::max).into(),
        }
    }

    fn with_params<T>(&self, call: impl FnOnce(&[Param<'_>]) -> T) -> T {
        let numbers = [[self.reach_length], [self.influences], [4.0], [0.005], [self.resolution]];
        let [length, influences, falloff, smoothing, resolution] = &numbers;
        call(&[
            Param::text("method", ParamKind::CHOICE, self.method),
            Param::text("reach", ParamKind::CHOICE, self.reach),
            Param::numbers("reach-length", ParamKind::INT, length),
            Param::text("skeleton", ParamKind::FILE, &self.skeleton),
            Param::text("weights", ParamKind::FILE, &self.weights),
            Param::text("places", ParamKind::FILE, &self.places),
            Param::text("pose", ParamKind::FILE, &self.pose),
            Param::text("binding", ParamKind::CHOICE, self.binding),
            Param::numbers("influences", ParamKind::INT, influences),
            Param::numbers("falloff", ParamKind::FLOAT, falloff),
            Param::numbers("smoothing", ParamKind::FLOAT, smoothing),
            Param::numbers("resolution", ParamKind::INT, resolution),
        ])
    }

    fn with<T>(&self, call: impl FnOnce(&PrepareInput<'_>) -> T) -> T {
        let joints: Vec<Joint<'_>> =
            self.joints.iter().map(|(id, at, parent)| Joint::new(id, *at, *parent)).collect();
        let joints = Joints::new(&joints);
        let triangles = Triangles::new(&self.triangles);
        let mut starts = vec![0_u32];
        self.neighbours.iter().for_each(|n| starts.push(starts[starts.len() - 1] + n.len() as u32));
        let neighbours = self.neighbours.concat();
        let graph = Graph::new(&starts, &neighbours);
        let frame = ModelFrame { origin: [0.0; 3], scale: 1.0 };
        let mut parts = vec![Part::new(&joints), Part::new(&frame)];
        if !self.triangles.is_empty() {
            parts.push(Part::new(&triangles));
        }
        if !self.neighbours.is_empty() {
            parts.push(Part::new(&graph));
        }
        let samples = Samples::new(&self.points, &[], &[]);
        self.with_params(|params| {
            call(&PrepareInput::new(samples, self.bounds(), &[], params).with_parts(&parts))
        })
    }

    pub fn try_prepare(&self, host: &Listener) -> PluginResult<Prepared> {
        self.with(|input| Skinning::prepare(input, &Host::new(host)))
    }

    pub fn prepare(&self) -> Prepared {
        self.try_prepare(&Listener::default()).unwrap()
    }

    pub fn try_handles(&self) -> PluginResult<Vec<HandleDesc>> {
        self.with(|input| Skinning::handles(input, &Host::new(&())))
    }

    /// Motions of all handles where some move by themselves, about their places: each with the handles above,
    /// as the host gives them.
    pub fn motions(&self, moved: &[(&str, DAffine3)]) -> Vec<Affine> {
        let mut totals: Vec<DAffine3> = Vec::new();
        for handle in self.try_handles().unwrap() {
            let at = DVec3::from(handle.position);
            let own = moved
                .iter()
                .find(|(id, _)| handle.id == *id)
                .map(|(_, m)| DAffine3::from_translation(at) * *m * DAffine3::from_translation(-at));
            totals.push(match (totals.get(handle.parent as usize), own) {
                (Some(parent), Some(own)) => *parent * own,
                (Some(one), None) => *one,
                (None, own) => own.unwrap_or(DAffine3::IDENTITY),
            });
        }
        totals.into_iter().map(rows).collect()
    }

    fn with_motions<T>(
        &self,
        samples: Samples<'_>,
        motions: &[Affine],
        call: impl FnOnce(&DeformInput<'_>) -> T,
    ) -> T {
        let motions = HandleMotions::new(motions);
        let time = Time { frame: self.frame, seconds: 0.0 };
        let parts = [Part::new(&motions), Part::new(&time)];
        self.with_params(|params| {
            call(&DeformInput::new(samples, self.bounds(), &[], params).with_parts(&parts))
        })
    }

    pub fn try_deform(&self, state: &Prepared, motions: &[Affine]) -> PluginResult<Vec<[f32; 3]>> {
        let mut out = vec![[f32::NAN; 3]; self.points.len()];
        let samples = Samples::new(&self.points, &[], &[]);
        self.with_motions(samples, motions, |input| {
            Skinning::deform(state, input, &mut (), &mut out, &Host::new(&Listener::default()))
        })?;
        Ok(out)
    }

    pub fn deform(&self, state: &Prepared, moved: &[(&str, DAffine3)]) -> Vec<[f32; 3]> {
        self.try_deform(state, &self.motions(moved)).unwrap()
    }

    pub fn evaluate(&self, state: &Prepared, moved: &[(&str, DAffine3)], points: &[DVec3]) -> Vec<DVec3> {
        let mut out: Vec<[f64; 3]> = points.iter().map(|p| p.to_array()).collect();
        self.with_motions(Samples::new(&[], &[], &[]), &self.motions(moved), |input| {
            Skinning::evaluate(state, input, &mut out, &Host::new(&()))
        })
        .unwrap();
        out.into_iter().map(DVec3::from).collect()
    }
}

pub fn rows(map: DAffine3) -> Affine {
    let (m, t) = (map.matrix3, map.translation);
    Affine { rows: std::array::from_fn(|r| [m.x_axis[r], m.y_axis[r], m.z_axis[r], t[r]]) }
}

pub fn turn(axis: DVec3, degrees: f64) -> DAffine3 {
    DAffine3::from_axis_angle(axis, degrees.to_radians())
}

pub fn at(p: [f32; 3]) -> DVec3 {
    DVec3::from(p.map(f64::from))
}
