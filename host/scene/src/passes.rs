//! The passes over the whole picture: occlusion, light, and smooth edges.
//!
//! Occlusion follows M. McGuire, B. Osman, M. Bukowski, P. Hennessy, *The Alchemy Screen-Space Ambient
//! Obscurance Algorithm*, HPG 2011, on a spiral that is turned from pixel to pixel; the light is that of
//! `simod_picture`.

use std::cmp::Ordering;

use wgpu::{BindGroup, BindGroupLayout, CommandEncoder, Device, RenderPipeline, TextureView};

use crate::pipeline::{Recipe, ShaderInput, begin, bind, layout, module, shader};
use crate::targets::{OCCLUSION, Targets};

pub(crate) struct Passes {
    occlusion: ScenePass,
    shade: ScenePass,
    /// Passes that finish pictures drawn in more pixels than the picture has, in as many, and in fewer.
    finish: [ScenePass; 3],
    sampler: wgpu::Sampler,
}

struct ScenePass {
    label: &'static str,
    pipeline: RenderPipeline,
    given: BindGroupLayout,
}

/// Bindings of the targets that the passes read.
pub(crate) struct PassBindGroups {
    occlusion: BindGroup,
    shade: BindGroup,
    finish: BindGroup,
}

impl Passes {
    pub const OCCLUSION_SHADER: &str = shader!("common.wgsl", "occlusion.wgsl");
    pub const SHADE_SHADER: &str = shader!("common.wgsl", "shade.wgsl");
    pub const FINISH_SHADER: &str = shader!("common.wgsl", "finish.wgsl");

    pub fn new(device: &Device, frame: &BindGroupLayout) -> Self {
        let pass = |label, shader, fragment, given: &[ShaderInput], target: wgpu::TextureFormat| {
            let given = layout(device, label, given);
            let recipe = Recipe {
                label,
                module: &module(device, label, shader),
                groups: &[frame, &given],
                vertex: "corner",
                fragment,
                targets: &[target.into()],
                depth: None,
            };
            ScenePass { label, pipeline: recipe.make(device), given }
        };
        let smooth = [ShaderInput::Smooth, ShaderInput::Sampler];
        Self {
            occlusion: pass(
                "occlusion",
                Self::OCCLUSION_SHADER,
                "pixel",
                &[ShaderInput::Texture; 2],
                OCCLUSION,
            ),
            shade: pass("shade", Self::SHADE_SHADER, "pixel", &[ShaderInput::Texture; 6], crate::FORMAT),
            finish: ["averaged", "smoothed", "stretched"]
                .map(|way| pass("finish", Self::FINISH_SHADER, way, &smooth, crate::FORMAT)),
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
        }
    }

    pub fn groups(&self, device: &Device, targets: &Targets) -> PassBindGroups {
        let texture = wgpu::BindingResource::TextureView;
        let seen = &targets.seen;
        // Without a ghost, the shader does not read these.
        let ghost = targets.ghost.as_ref().unwrap_or(seen);
        let shade = [&seen.color, &seen.normal, &seen.depth, &targets.occlusion, &ghost.normal, &ghost.depth];
        let finish = [texture(&targets.lit), wgpu::BindingResource::Sampler(&self.sampler)];
        PassBindGroups {
            occlusion: self.occlusion.bind(device, &[&seen.normal, &seen.depth].map(texture)),
            shade: self.shade.bind(device, &shade.map(texture)),
            finish: self.finish[targets.way()].bind(device, &finish),
        }
    }

    pub fn occlusion(
        &self,
        encoder: &mut CommandEncoder,
        targets: &Targets,
        groups: &PassBindGroups,
        frame: &BindGroup,
    ) {
        self.occlusion.draw(encoder, &targets.occlusion, frame, &groups.occlusion);
    }

    pub fn shade(
        &self,
        encoder: &mut CommandEncoder,
        targets: &Targets,
        groups: &PassBindGroups,
        frame: &BindGroup,
    ) {
        self.shade.draw(encoder, &targets.lit, frame, &groups.shade);
    }

    /// The finished picture, in a texture of its size.
    pub fn finish(
        &self,
        encoder: &mut CommandEncoder,
        targets: &Targets,
        groups: &PassBindGroups,
        frame: &BindGroup,
        finished: &TextureView,
    ) {
        self.finish[targets.way()].draw(encoder, finished, frame, &groups.finish);
    }
}

impl ScenePass {
    fn bind(&self, device: &Device, resources: &[wgpu::BindingResource<'_>]) -> BindGroup {
        bind(device, self.label, &self.given, resources)
    }

    fn draw(&self, encoder: &mut CommandEncoder, target: &TextureView, frame: &BindGroup, given: &BindGroup) {
        let mut pass = begin(encoder, self.label, &[(target, Some(wgpu::Color::BLACK))], None);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, given, &[]);
        pass.draw(0..3, 0..1);
    }
}

impl Targets {
    /// Number of the pipeline that finishes a picture of these sizes.
    fn way(&self) -> usize {
        match self.size[0].cmp(&self.finished_size[0]) {
            Ordering::Greater => 0,
            Ordering::Equal => 1,
            Ordering::Less => 2,
        }
    }
}
