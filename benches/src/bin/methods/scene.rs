//! One plugin's calls, timed, on the samples of a model.

use crate::edits::{Drag, Edit, Place, Value};
use glam::{DAffine3, DQuat, DVec3};
use rayon::prelude::*;
use simod_benches::median;
use simod_benches::process::{Result, own_cpu};
use simod_core::sampled_model::SampledModel;
use simod_plugin_api::{
    Affine, Bounds, DeformInput, Effort, Graph, HandleMotions, HostCalls, Joint, Joints, LogLevel, Param,
    ParamDesc, ParamKind, Part, PrepareInput, Region, Role, Samples, Stroke, Strokes, Triangles,
};
use simod_session::Plugin;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Seconds: medians, and means of processor time.
pub struct Figures {
    pub prepare: f64,
    pub prepare_cpu: f64,
    /// The longest time in a preparation without a sign of life.
    pub silence: f64,
    pub frame: f64,
    pub frame_cpu: f64,
}

/// The host, which listens to how long a plugin says nothing.
struct Listener(Mutex<(Instant, Duration)>);

impl Listener {
    fn new() -> Self {
        Self(Mutex::new((Instant::now(), Duration::ZERO)))
    }

    fn hear(&self) {
        let mut heard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (last, longest) = *heard;
        *heard = (Instant::now(), longest.max(last.elapsed()));
    }

    fn longest(&self) -> Duration {
        self.hear();
        self.0.lock().unwrap_or_else(PoisonError::into_inner).1
    }
}

impl HostCalls for Listener {
    fn progress(&self, _: f64) -> bool {
        self.hear();
        true
    }

    fn log(&self, level: LogLevel, message: &str) {
        if level == LogLevel::WARNING {
            eprintln!("{message}");
        }
    }

    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        (0..count).into_par_iter().for_each(|i| {
            body(i);
            self.hear();
        });
        true
    }
}

/// A model's samples as plugins get them.
pub struct Scene<'m> {
    sampled: &'m SampledModel,
    bounds: Bounds,
    /// Index of each sample's first neighbour, and at last the number of all neighbours.
    starts: Vec<u32>,
}

impl<'m> Scene<'m> {
    pub fn new(sampled: &'m SampledModel) -> Self {
        let corner = |p| sampled.frame.to_local_exact(p).to_array();
        let bounds = Bounds { min: corner(sampled.bounds.min), max: corner(sampled.bounds.max) };
        sampled.samples.prepare();
        let k = sampled.samples.neighbours().k();
        let starts = (0..=sampled.samples.len()).map(|i| (i * k) as u32).collect();
        Self { sampled, bounds, starts }
    }

    fn samples(&self) -> Samples<'_> {
        let samples = &self.sampled.samples;
        Samples::new(
            bytemuck::cast_slice(&samples.positions),
            bytemuck::cast_slice(samples.normals()),
            samples.spacing(),
        )
    }

    fn carry(&self, place: DVec3) -> DVec3 {
        let (min, max) = (DVec3::from(self.bounds.min), DVec3::from(self.bounds.max));
        min + place * (max - min)
    }

    /// Prepares and drags; a frame is the deformation alone, without the host's checks.
    pub fn measure(&self, plugin: &Plugin, edit: &Edit, runs: u32, frames: u32) -> Result<Figures> {
        let code = plugin.code();
        let values: Vec<Vec<f64>> = plugin.params().iter().map(|p| self.numbers(p, edit)).collect();
        let params: Vec<Param<'_>> =
            plugin.params().iter().zip(&values).map(|(p, numbers)| param(p, numbers, edit)).collect();
        let weights: Vec<Vec<f32>> = edit.regions.iter().map(|(_, inside)| self.weights(*inside)).collect();
        let regions: Vec<Region<'_>> =
            edit.regions.iter().zip(&weights).map(|((role, _), w)| Region::new(*role, w)).collect();
        let triangles = Triangles::new(&self.sampled.triangles);
        let graph = Graph::new(&self.starts, self.sampled.samples.neighbours().all());
        let mut parts = Vec::new();
        if plugin.consumes().triangles && !self.sampled.triangles.is_empty() {
            parts.push(Part::new(&triangles));
        }
        if plugin.consumes().graph {
            parts.push(Part::new(&graph));
        }
        let ids: Vec<String> = (0..edit.joints.len()).map(|i| format!("joint-{i}")).collect();
        let joint = |(i, at): (usize, &Place)| {
            let parent = if i == 0 { Joint::ROOT } else { i as u32 - 1 };
            Joint::new(&ids[i], self.carry(DVec3::from(*at)).to_array(), parent)
        };
        let joints: Vec<Joint<'_>> = edit.joints.iter().enumerate().map(joint).collect();
        let joints = Joints::new(&joints);
        if plugin.consumes().joints {
            parts.push(Part::new(&joints));
        }
        let input = PrepareInput::new(self.samples(), self.bounds, &regions, &params).with_parts(&parts);
        let placed = if plugin.capabilities().handles {
            code.handles(&input.without_regions(), &())?
                .descs
                .iter()
                .map(|h| DVec3::from(h.position))
                .collect()
        } else {
            Vec::new()
        };

        let cpu = own_cpu();
        let (mut prepare, mut silence, mut state) = (Vec::new(), Vec::new(), None);
        for _ in 0..runs {
            // One state at a time, as in a program.
            drop(state.take());
            let (host, started) = (Listener::new(), Instant::now());
            state = Some(code.prepare(&input, &host)?);
            prepare.push(started.elapsed().as_secs_f64());
            silence.push(host.longest().as_secs_f64());
        }
        let state = state.ok_or("no preparation")?;
        let prepare_cpu = (own_cpu() - cpu) / f64::from(runs);

        let handles = edit.regions.iter().filter(|(role, _)| *role == Role::HANDLE).count();
        let (mut scratch, mut out) = (code.new_scratch()?, vec![[0.0; 3]; self.sampled.samples.len()]);
        let (mut times, mut frame_cpu) = (Vec::new(), 0.0);
        let effort = if edit.draft { Effort::DRAFT } else { Effort::FULL };
        for frame in 0..frames {
            let transforms = vec![self.turn(frame, self.carry(DVec3::splat(0.5))); handles];
            let motions = self.motions(edit.drag, frame, &placed);
            let radius = if let Drag::Brush(part) = edit.drag { part * self.bounds.diagonal() } else { 1.0 };
            // Strokes of earlier frames are known by their keys.
            let dabs: Vec<[[f64; 3]; 1]> = (0..=frame).map(|i| [self.dab(i)]).collect();
            let strokes: Vec<Stroke<'_>> = (0..)
                .zip(&dabs)
                .map(|(key, path)| Stroke::new(key, radius, 0.5, path, &[], &params))
                .collect();
            let (strokes, motions) = (Strokes::new(&strokes), HandleMotions::new(&motions));
            let mut parts = Vec::new();
            if plugin.consumes().strokes {
                parts.push(Part::new(&strokes));
            }
            if !placed.is_empty() {
                parts.push(Part::new(&motions));
            }
            if plugin.consumes().effort {
                parts.push(Part::new(&effort));
            }
            let input =
                DeformInput::new(self.samples(), self.bounds, &transforms, &params).with_parts(&parts);
            let (host, started, cpu) = (Listener::new(), Instant::now(), own_cpu());
            code.deform(&state, &input, &mut scratch, &mut out, &host)?;
            times.push(started.elapsed().as_secs_f64());
            frame_cpu += (own_cpu() - cpu) / f64::from(frames);
        }
        let (prepare, silence, frame) = (median(prepare), median(silence), median(times));
        Ok(Figures { prepare, prepare_cpu, silence, frame, frame_cpu })
    }

    /// A parameter's numbers: those of the edit, or the default, in local coordinates.
    fn numbers(&self, desc: &ParamDesc, edit: &Edit) -> Vec<f64> {
        if let Some((_, Value::Number(x))) = edit.params.iter().find(|(id, _)| *id == desc.id.as_str()) {
            return vec![*x];
        }
        let default = desc.default_numbers.to_vec();
        match (desc.kind, default.as_slice()) {
            (ParamKind::POINT, [x, y, z]) => self.carry(DVec3::new(*x, *y, *z)).to_array().to_vec(),
            _ => default,
        }
    }

    fn weights(&self, inside: fn([f64; 3]) -> bool) -> Vec<f32> {
        let (min, max) = (DVec3::from(self.bounds.min), DVec3::from(self.bounds.max));
        let place = |p: &glam::Vec3| ((p.as_dvec3() - min) / (max - min)).to_array();
        let positions = &self.sampled.samples.positions;
        positions.iter().map(|p| f32::from(u8::from(inside(place(p))))).collect()
    }

    /// A turn and a shift that grow with the frames.
    fn turn(&self, frame: u32, pivot: DVec3) -> Affine {
        let t = 0.01 * f64::from(1 + frame);
        let shift = DVec3::new(0.3, 0.1, -0.2) * (t * self.bounds.diagonal());
        let map = DAffine3::from_translation(pivot + shift)
            * DAffine3::from_quat(DQuat::from_rotation_z(t))
            * DAffine3::from_translation(-pivot);
        let (m, t) = (map.matrix3, map.translation);
        Affine { rows: std::array::from_fn(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]) }
    }

    fn motions(&self, drag: Drag, frame: u32, placed: &[DVec3]) -> Vec<Affine> {
        let motion = |(i, p): (usize, &DVec3)| {
            let is = |at: f64| i == (at * placed.len() as f64) as usize;
            let frame = match drag {
                Drag::OneHandle(at) => is(at).then_some(frame),
                Drag::OneOfMoved(at) => Some(if is(at) { frame } else { 0 }),
                Drag::AllHandles => Some(frame),
                Drag::Regions | Drag::Brush(_) => None,
            };
            frame.map_or(Affine::IDENTITY, |frame| self.turn(frame + i as u32 % 7, *p))
        };
        placed.iter().enumerate().map(motion).collect()
    }

    /// Place of a frame's dab: on the model's front, a hundredth of the diagonal from the one before.
    fn dab(&self, frame: u32) -> [f64; 3] {
        let p = self.carry(DVec3::new(0.5, 0.3 + 0.01 * f64::from(frame % 40), 1.0));
        let nearest = self.sampled.samples.nearest(p.as_vec3());
        self.sampled.samples.positions[nearest as usize].as_dvec3().to_array()
    }
}

fn param<'a>(desc: &'a ParamDesc, numbers: &'a [f64], edit: &'a Edit) -> Param<'a> {
    if [ParamKind::CHOICE, ParamKind::FILE, ParamKind::MODEL].contains(&desc.kind) {
        let text = edit.params.iter().find_map(|(id, value)| match value {
            Value::Text(text) if *id == desc.id.as_str() => Some(*text),
            _ => None,
        });
        return Param::text(&desc.id, desc.kind, text.unwrap_or(&desc.default_text));
    }
    Param::numbers(&desc.id, desc.kind, numbers)
}
