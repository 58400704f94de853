//! Surfaces as triangles, with the samples' normals and colours in between.

use wgpu::{BindGroup, BindGroupLayout, CommandEncoder, Device, RenderPipeline, TextureView};

use crate::cloud::Cloud;
use crate::pipeline::{Recipe, begin, module, shader};
use crate::targets::{SEEN, SurfaceTargets};

pub(crate) struct TriangleMesh {
    pipeline: RenderPipeline,
}

impl TriangleMesh {
    pub const SHADER: &str = shader!("common.wgsl", "samples.wgsl", "triangles.wgsl");

    pub fn new(device: &Device, frame: &BindGroupLayout, samples: &BindGroupLayout) -> Self {
        let recipe = Recipe {
            label: "triangles",
            module: &module(device, "triangles", Self::SHADER),
            groups: &[frame, samples],
            vertex: "corner",
            fragment: "pixel",
            targets: &SEEN.map(Into::into),
            depth: Some(true),
        };
        Self { pipeline: recipe.make(device) }
    }

    pub fn draw(
        &self,
        encoder: &mut CommandEncoder,
        depth: &TextureView,
        seen: &SurfaceTargets,
        frame: &BindGroup,
        cloud: &Cloud,
    ) {
        let mut pass = begin(encoder, "triangles", &seen.attachments(), Some((depth, Some(1.0))));
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, frame, &[]);
        cloud.draw_triangles(&mut pass);
    }
}
