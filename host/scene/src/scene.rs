//! A scene, and the way of a frame through the passes.

use std::collections::BTreeMap;
use std::time::Instant;

use bytemuck::bytes_of;
use glam::Vec3;
use simod_core::render::Image;
use wgpu::{BindGroup, BindGroupLayout, Buffer, BufferUsages, CommandEncoder, Texture, TextureView};

use crate::budget::Budget;
use crate::cloud::{BadSurface, Cloud, Surface, same_length};
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::marks::{Dot, Line, Marks};
use crate::passes::{self, Passes};
use crate::pipeline::{Given, bind, layout};
use crate::splats::{self, Splats};
use crate::targets::{Seen, Targets, texture};
use crate::triangles::TriangleMesh;
use crate::view::{Mode, Scale, Style, View};

/// Discs of a part of the samples are so much wider than their number says, as they are not spread evenly.
const PART_SLACK: f32 = 1.15;
/// Most splats of a ghost: it is faint, so a part of its samples will do.
const GHOST_SPLATS: usize = 200_000;
/// While something moves, a mesh of so many times more triangles than the budget has splats is drawn as splats.
const TRIANGLES_PER_SPLAT: usize = 4;

/// A surface, maybe a ghost of another one, lines and dots, and the picture of them.
pub struct Scene {
    gpu: Gpu,
    samples: BindGroupLayout,
    splats: Splats,
    mesh: TriangleMesh,
    passes: Passes,
    marks: Marks,
    /// The frame's values for the surface and all that follows, and for the ghost.
    frame: Uniform,
    ghost_frame: Uniform,
    surface: Option<Cloud>,
    ghost: Option<Cloud>,
    /// By how finely they are drawn.
    stages: BTreeMap<Scale, Stage>,
    finished: Option<(Texture, TextureView)>,
    /// What the picture is of, while surfaces are as they were.
    of: Option<(View, Style)>,
    /// Which stage the picture comes from.
    shown: Scale,
    drawn: Drawn,
    /// How far all splats are summed up, for the picture that follows one of a part of them.
    filled: Filled,
    marks_changed: bool,
}

/// Textures of a size.
struct Stage {
    targets: Targets,
    splats: splats::Groups,
    passes: passes::Groups,
}

/// How much of the surface the picture shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Drawn {
    /// Splats drawn (triangles, where these are shown) ...
    pub drawn: usize,
    /// ... of so many.
    pub of: usize,
    /// Whether the picture is as it shall be: else [`Scene::render`] has more to draw, when it is called again.
    pub complete: bool,
}

/// Splats that both passes have drawn.
#[derive(Debug, Clone, Copy, Default)]
struct Filled {
    depth: usize,
    blend: usize,
}

/// A `Frame` in the device's memory.
struct Uniform {
    buffer: Buffer,
    group: BindGroup,
}

impl Scene {
    /// An empty scene.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let frame = layout(device, "frame", &[Given::Uniform]);
        let samples = layout(device, "samples", &[Given::Storage; 2]);
        Self {
            splats: Splats::new(device, &frame, &samples),
            mesh: TriangleMesh::new(device, &frame, &samples),
            passes: Passes::new(device, &frame),
            marks: Marks::new(device, &frame),
            frame: Uniform::new(gpu, &frame),
            ghost_frame: Uniform::new(gpu, &frame),
            gpu: gpu.clone(),
            samples,
            surface: None,
            ghost: None,
            stages: BTreeMap::new(),
            finished: None,
            of: None,
            shown: Scale::Full,
            drawn: Drawn::default(),
            filled: Filled::default(),
            marks_changed: false,
        }
    }

    /// The device that draws.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Shows another surface. What it takes per sample: 24 bytes of the device's memory, 4 here; 12 there per triangle.
    ///
    /// # Errors
    /// Its lists do not fit together.
    pub fn set_surface(&mut self, surface: &Surface<'_>) -> Result<(), BadSurface> {
        self.surface = Some(Cloud::new(&self.gpu, &self.samples, surface)?);
        self.of = None;
        Ok(())
    }

    /// Moves the surface's samples: for each frame of a drag.
    ///
    /// # Errors
    /// There are not as many as before.
    pub fn set_positions(&mut self, positions: &[Vec3], normals: &[Vec3]) -> Result<(), BadSurface> {
        let samples = self.samples();
        same_length("positions", positions.len(), samples)?;
        same_length("normals", normals.len(), samples)?;
        if let Some(surface) = &self.surface {
            surface.write_geometry(&self.gpu.queue, positions, normals);
        }
        self.of = None;
        Ok(())
    }

    /// Changes the surface's colours (see [`Surface::colors`]) and radii.
    ///
    /// # Errors
    /// There are not as many as samples.
    pub fn set_colors(&mut self, radii: &[f32], colors: Option<&[[u8; 3]]>) -> Result<(), BadSurface> {
        let samples = self.samples();
        same_length("radii", radii.len(), samples)?;
        same_length("colours", colors.map_or(samples, <[_]>::len), samples)?;
        if let Some(surface) = &self.surface {
            surface.write_look(&self.gpu.queue, radii, colors);
        }
        self.of = None;
        Ok(())
    }

    /// Shows a ghost (the rest shape, say), or none. Its colours and triangles are not used.
    ///
    /// # Errors
    /// Its lists do not fit together.
    pub fn set_ghost(&mut self, ghost: Option<&Surface<'_>>) -> Result<(), BadSurface> {
        let bare = ghost.map(|ghost| Surface { triangles: &[], ..*ghost });
        self.ghost = bare.map(|ghost| Cloud::new(&self.gpu, &self.samples, &ghost)).transpose()?;
        self.of = None;
        Ok(())
    }

    /// Shows these lines instead of the former ones.
    pub fn set_lines(&mut self, lines: &[Line]) {
        self.marks.set_lines(&self.gpu, lines);
        self.marks_changed = true;
    }

    /// Shows these dots instead of the former ones.
    pub fn set_dots(&mut self, dots: &[Dot]) {
        self.marks.set_dots(&self.gpu, dots);
        self.marks_changed = true;
    }

    /// Number of the surface's samples.
    pub fn samples(&self) -> usize {
        self.surface.as_ref().map_or(0, Cloud::len)
    }

    /// How much of the surface the last picture shows.
    pub fn drawn(&self) -> Drawn {
        self.drawn
    }

    /// Draws what has changed, and gives the picture: another texture whenever its size changes, the same otherwise.
    ///
    /// Without a budget all is drawn at once, and the device may go on drawing when this returns. With one, a changed
    /// scene is drawn as well as its time allows; then each call draws more, until [`Drawn::complete`].
    pub fn render(&mut self, view: &View, style: &Style, budget: Option<&mut Budget>) -> &TextureView {
        let most = self.gpu.device.limits().max_texture_dimension_2d;
        let view = View { size: view.size.map(|s| s.clamp(1, most)), ..*view };
        let mut style = *style;
        if style.scale == Scale::Double && view.size.iter().any(|s| 2 * s > most) {
            style.scale = Scale::Full;
        }
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let started = Instant::now();
        let changed = self.of != Some((view, style));
        if changed {
            self.resize(&view, style.scale);
            self.of = Some((view, style));
            self.filled = Filled::default();
            let (splats, scale) = match &budget {
                Some(budget) if budget.is_coarse() => (budget.splats(), Scale::Half),
                Some(budget) => (budget.splats(), style.scale),
                None => (usize::MAX, style.scale),
            };
            self.draw(&mut encoder, &view, &style, scale, splats);
        } else if !self.drawn.complete {
            let splats = budget.as_ref().map_or(usize::MAX, |budget| 2 * budget.splats());
            self.fill(&mut encoder, &view, &style, splats);
        } else if self.marks_changed {
            self.finish(&mut encoder);
        }
        self.gpu.queue.submit([encoder.finish()]);
        if let Some(budget) = budget {
            // Else frames pile up before the device, and the hand is seconds ahead of the picture.
            self.gpu.wait();
            if changed && !self.shows_triangles(&style, usize::MAX) {
                budget.learn(self.drawn.drawn, started.elapsed());
            }
        }
        &self.finished.as_ref().expect("a first picture makes it").1
    }

    /// The last picture; none before there is any, or where the device is lost.
    pub fn read(&self) -> Option<Image> {
        let (texture, _) = self.finished.as_ref()?;
        crate::read::image(&self.gpu, texture)
    }

    /// Whether triangles are shown, in a frame of so many splats.
    fn shows_triangles(&self, style: &Style, splats: usize) -> bool {
        let triangles = self.surface.as_ref().map_or(0, Cloud::triangles);
        style.mode == Mode::Triangles && (1..=splats.saturating_mul(TRIANGLES_PER_SPLAT)).contains(&triangles)
    }

    /// Makes the textures anew where the picture's size changed.
    fn resize(&mut self, view: &View, scale: Scale) {
        let device = &self.gpu.device;
        let fits = self.finished.as_ref().is_some_and(|(t, _)| [t.width(), t.height()] == view.size);
        if !fits {
            self.stages.clear();
            let texture = texture(device, "finished", view.size, crate::FORMAT);
            let shown = texture.create_view(&Default::default());
            self.finished = Some((texture, shown));
        }
        self.stages.retain(|s, _| *s == scale || *s == Scale::Half);
    }

    /// The textures of a scale.
    fn stage(&mut self, view: &View, scale: Scale) {
        let device = &self.gpu.device;
        let stage = self.stages.entry(scale).or_insert_with(|| {
            let targets = Targets::new(device, view.size.map(|s| scale.of(s)), view.size);
            Stage {
                splats: self.splats.groups(device, &targets),
                passes: self.passes.groups(device, &targets),
                targets,
            }
        });
        if self.ghost.is_some() && stage.targets.ghost.is_none() {
            stage.targets.ghost = Some(Seen::new(device, stage.targets.size));
            stage.passes = self.passes.groups(device, &stage.targets);
        }
    }

    /// Draws a whole frame of at most so many splats.
    fn draw(
        &mut self,
        encoder: &mut CommandEncoder,
        view: &View,
        style: &Style,
        scale: Scale,
        splats: usize,
    ) {
        self.stage(view, scale);
        let stage = &self.stages[&scale];
        let of = self.samples();
        let splats = splats.min(of);
        self.set_frame(view, style, stage, splats);
        self.draw_ghost(encoder, stage);
        let frame = &self.frame.group;
        let triangles = self.shows_triangles(style, if splats < of { splats } else { usize::MAX });
        match &self.surface {
            Some(surface) if triangles => {
                self.mesh.draw(encoder, &stage.targets.depth, &stage.targets.seen, frame, surface);
                let all = surface.triangles();
                self.drawn = Drawn { drawn: all, of: all, complete: scale == style.scale };
            }
            Some(surface) => {
                self.splats.depth(encoder, &stage.targets, frame, surface, 0..splats);
                self.splats.blend(encoder, &stage.targets, &stage.splats, frame, surface, 0..splats);
                self.splats.resolve(encoder, &stage.splats, frame, &stage.targets.seen);
                let complete = splats == of && scale == style.scale;
                self.drawn = Drawn { drawn: splats, of, complete };
            }
            None => {
                stage.targets.seen.clear(encoder);
                self.drawn = Drawn { drawn: 0, of: 0, complete: scale == style.scale };
            }
        }
        self.shown = scale;
        self.light(encoder, style);
    }

    /// Sums up at most so many more splats of all, pass by pass; once these are through, they are shown.
    fn fill(&mut self, encoder: &mut CommandEncoder, view: &View, style: &Style, splats: usize) {
        let scale = style.scale;
        let of = self.samples();
        if self.shows_triangles(style, usize::MAX) || of == 0 {
            return self.draw(encoder, view, style, scale, usize::MAX);
        }
        self.stage(view, scale);
        let stage = &self.stages[&scale];
        self.set_frame(view, style, stage, of);
        let frame = &self.frame.group;
        let Some(surface) = &self.surface else { return };
        if self.filled.depth == 0 {
            self.draw_ghost(encoder, stage);
        }
        if self.filled.depth < of {
            let next = self.filled.depth..of.min(self.filled.depth.saturating_add(splats));
            self.filled.depth = next.end;
            self.splats.depth(encoder, &stage.targets, frame, surface, next);
        } else {
            let next = self.filled.blend..of.min(self.filled.blend.saturating_add(splats));
            self.filled.blend = next.end;
            self.splats.blend(encoder, &stage.targets, &stage.splats, frame, surface, next);
        }
        if self.filled.blend == of {
            self.splats.resolve(encoder, &stage.splats, frame, &stage.targets.seen);
            self.drawn = Drawn { drawn: of, of, complete: true };
            self.shown = scale;
            self.light(encoder, style);
        } else if self.marks_changed {
            self.finish(encoder);
        }
    }

    fn draw_ghost(&self, encoder: &mut CommandEncoder, stage: &Stage) {
        if let (Some(ghost), Some(seen)) = (&self.ghost, &stage.targets.ghost) {
            let frame = &self.ghost_frame.group;
            let splats = 0..ghost.len().min(GHOST_SPLATS);
            self.splats.depth(encoder, &stage.targets, frame, ghost, splats.clone());
            self.splats.blend(encoder, &stage.targets, &stage.splats, frame, ghost, splats);
            self.splats.resolve(encoder, &stage.splats, frame, seen);
        }
    }

    /// From the surface that is seen to the finished picture.
    fn light(&mut self, encoder: &mut CommandEncoder, style: &Style) {
        let Stage { targets, passes, .. } = &self.stages[&self.shown];
        if style.occlusion {
            self.passes.occlusion(encoder, targets, passes, &self.frame.group);
        }
        self.passes.shade(encoder, targets, passes, &self.frame.group);
        self.finish(encoder);
    }

    /// From the lit picture to the finished one.
    fn finish(&mut self, encoder: &mut CommandEncoder) {
        let Stage { targets, passes, .. } = &self.stages[&self.shown];
        let Some((_, finished)) = &self.finished else { return };
        let frame = &self.frame.group;
        self.passes.finish(encoder, targets, passes, frame, finished);
        self.marks.draw(&self.gpu.device, encoder, targets, frame, finished);
        self.marks_changed = false;
    }

    /// Tells the shaders of a frame of so many of the surface's splats.
    fn set_frame(&self, view: &View, style: &Style, stage: &Stage, splats: usize) {
        let radius = self.surface.as_ref().or(self.ghost.as_ref()).map_or(1.0, |cloud| cloud.radius);
        let size = stage.targets.size;
        let mut frame = Frame::new(view, style, size, view.size, radius, self.ghost.is_some());
        frame.radius_scale = part_scale(splats, self.samples());
        self.frame.write(&self.gpu, &frame);
        let ghosts = self.ghost.as_ref().map_or(0, Cloud::len);
        frame.radius_scale = part_scale(GHOST_SPLATS.min(ghosts), ghosts);
        self.ghost_frame.write(&self.gpu, &frame);
    }
}

/// How much wider the discs of a part of the samples are than those of all.
fn part_scale(part: usize, all: usize) -> f32 {
    if part >= all { 1.0 } else { PART_SLACK * (all as f32 / part.max(1) as f32).sqrt() }
}

impl Uniform {
    fn new(gpu: &Gpu, layout: &BindGroupLayout) -> Self {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<Frame>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let group = bind(&gpu.device, "frame", layout, &[buffer.as_entire_binding()]);
        Self { buffer, group }
    }

    fn write(&self, gpu: &Gpu, frame: &Frame) {
        gpu.queue.write_buffer(&self.buffer, 0, bytes_of(frame));
    }
}
