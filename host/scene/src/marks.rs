//! Lines and dots over the picture: handles, lattices, bones, cages, the brush.
//!
//! Both are segments with round ends, drawn as rectangles of the picture; the borders are as smooth as a
//! pixel allows.

use bytemuck::{Pod, Zeroable, cast_slice};
use glam::Vec3;
use wgpu::{
    BindGroup, BindGroupLayout, Buffer, BufferUsages, CommandEncoder, Device, RenderPipeline, TextureView,
};

use crate::gpu::Gpu;
use crate::pipeline::{Recipe, ShaderInput, begin, bind, layout, module, shader};
use crate::targets::Targets;

/// A straight line between two points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// One end, in local coordinates.
    pub a: Vec3,
    /// The other end, in local coordinates.
    pub b: Vec3,
    /// Red, green, blue and opacity, in sRGB.
    pub color: [u8; 4],
    /// Width in pixels.
    pub width_px: f32,
    /// Whether the line is drawn over the surface, which does not hide it.
    pub on_top: bool,
}

/// A round dot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dot {
    /// The middle of the dot, in local coordinates.
    pub position: Vec3,
    /// Red, green, blue and opacity, in sRGB.
    pub color: [u8; 4],
    /// Diameter in pixels.
    pub size_px: f32,
    /// Whether the dot is drawn over the surface, which does not hide it.
    pub on_top: bool,
}

/// A line or a dot: `Mark` in `marks.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Mark {
    a: Vec3,
    half_width: f32,
    b: Vec3,
    color: u32,
    on_top: u32,
    unused: [u32; 3],
}

impl From<&Line> for Mark {
    fn from(line: &Line) -> Self {
        Self {
            a: line.a,
            half_width: 0.5 * line.width_px,
            b: line.b,
            color: u32::from_le_bytes(line.color),
            on_top: u32::from(line.on_top),
            unused: [0; 3],
        }
    }
}

impl From<&Dot> for Mark {
    fn from(dot: &Dot) -> Self {
        let Dot { position, color, size_px, on_top } = *dot;
        Self::from(&Line { a: position, b: position, color, width_px: size_px, on_top })
    }
}

impl Mark {
    fn is_finite(&self) -> bool {
        self.a.is_finite() && self.b.is_finite() && self.half_width.is_finite()
    }
}

pub(crate) struct Marks {
    pipeline: RenderPipeline,
    given: BindGroupLayout,
    lines: Vec<Mark>,
    dots: Vec<Mark>,
    buffer: Buffer,
}

impl Marks {
    pub const SHADER: &str = shader!("common.wgsl", "marks.wgsl");

    pub fn new(device: &Device, frame: &BindGroupLayout) -> Self {
        let given = layout(device, "marks", &[ShaderInput::Storage, ShaderInput::Texture]);
        let target = wgpu::ColorTargetState {
            format: crate::FORMAT,
            blend: Some(wgpu::BlendState {
                color: wgpu::BlendState::ALPHA_BLENDING.color,
                alpha: wgpu::BlendComponent::OVER,
            }),
            write_mask: wgpu::ColorWrites::ALL,
        };
        let recipe = Recipe {
            label: "marks",
            module: &module(device, "marks", Self::SHADER),
            groups: &[frame, &given],
            vertex: "corner",
            fragment: "pixel",
            targets: &[target],
            depth: None,
        };
        Self {
            pipeline: recipe.make(device),
            given,
            lines: Vec::new(),
            dots: Vec::new(),
            buffer: buffer(device, 1),
        }
    }

    pub fn set_lines(&mut self, gpu: &Gpu, lines: &[Line]) {
        self.lines = lines.iter().map(Mark::from).filter(Mark::is_finite).collect();
        self.upload(gpu);
    }

    pub fn set_dots(&mut self, gpu: &Gpu, dots: &[Dot]) {
        self.dots = dots.iter().map(Mark::from).filter(Mark::is_finite).collect();
        self.upload(gpu);
    }

    fn upload(&mut self, gpu: &Gpu) {
        let all = [self.lines.as_slice(), self.dots.as_slice()].concat();
        let bytes: &[u8] = cast_slice(&all);
        if bytes.len() as u64 > self.buffer.size() {
            self.buffer = buffer(&gpu.device, all.len().next_power_of_two());
        }
        gpu.queue.write_buffer(&self.buffer, 0, bytes);
    }

    /// Draws all marks over the finished picture, dots after lines.
    pub fn draw(
        &self,
        device: &Device,
        encoder: &mut CommandEncoder,
        targets: &Targets,
        frame: &BindGroup,
        finished: &TextureView,
    ) {
        let count = (self.lines.len() + self.dots.len()) as u32;
        if count == 0 {
            return;
        }
        let depths = wgpu::BindingResource::TextureView(&targets.seen.depth);
        let given = bind(device, "marks", &self.given, &[self.buffer.as_entire_binding(), depths]);
        let mut pass = begin(encoder, "marks", &[(finished, None)], None);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, &given, &[]);
        pass.draw(0..6 * count, 0..1);
    }
}

/// Room for so many marks.
fn buffer(device: &Device, marks: usize) -> Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("marks"),
        size: (marks * size_of::<Mark>()) as u64,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
