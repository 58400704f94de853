//! Data that drawing keeps from one frame to the next: textures, the splats summed up so far, values for
//! the shaders.

use bytemuck::bytes_of;
use wgpu::{BindGroup, BindGroupLayout, Buffer, BufferUsages};

use crate::frame::FrameData;
use crate::gpu::Gpu;
use crate::pipeline::bind;
use crate::targets::Targets;
use crate::{passes, splats};

/// Textures of a size.
pub(super) struct SizedTargets {
    pub targets: Targets,
    pub splats: splats::SplatBindGroups,
    pub passes: passes::PassBindGroups,
}

/// The shares of the surface and of its details that a frame shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct DetailShares {
    /// Splats of the surface.
    pub surface: usize,
    /// Number of times that the details are halved.
    pub halved: usize,
}

/// Splats of the next picture at rest that both passes have drawn.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FilledSplats {
    /// Shares of that picture; not chosen yet before its first splats.
    pub shares: Option<DetailShares>,
    pub depth: usize,
    pub blend: usize,
}

/// A `FrameData` in the device's memory.
pub(super) struct Uniform {
    buffer: Buffer,
    pub group: BindGroup,
}

impl Uniform {
    pub fn new(gpu: &Gpu, layout: &BindGroupLayout) -> Self {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<FrameData>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let group = bind(&gpu.device, "frame", layout, &[buffer.as_entire_binding()]);
        Self { buffer, group }
    }

    pub fn write(&self, gpu: &Gpu, frame: &FrameData) {
        gpu.queue.write_buffer(&self.buffer, 0, bytes_of(frame));
    }
}
