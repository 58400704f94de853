//! Surfaces as oriented discs that overlap: M. Zwicker, H. Pfister, J. van Baar, M. Gross, *Surface
//! Splatting*, SIGGRAPH 2001; in two passes as in M. Botsch, A. Hornung, M. Zwicker, L. Kobbelt,
//! *High-Quality Surface Splatting on Today's GPUs*, PBG 2005.
//!
//! The first pass finds the nearest surface, and puts it back by a part of the discs' radii. The second one
//! sums up the colours, normals and depths of the splats that are not behind this surface, by a weight that
//! falls to nothing at a disc's border; the means are the surface that is seen.

use std::ops::Range;

use wgpu::{BindGroup, BindGroupLayout, CommandEncoder, Device, RenderPipeline, TextureView};

use crate::cloud::Cloud;
use crate::pipeline::{Recipe, ShaderInput, begin, bind, layout, module, shader};
use crate::targets::{DEPTHS, SEEN, SUMS, SurfaceTargets, Targets};

pub(crate) struct SplatPasses {
    depth: RenderPipeline,
    blend: RenderPipeline,
    resolve: RenderPipeline,
    nearest: BindGroupLayout,
    sums: BindGroupLayout,
}

/// Range of places in a cloud's order, drawn with a frame's values.
pub(crate) struct CloudRange<'a> {
    pub frame: &'a BindGroup,
    pub cloud: &'a Cloud,
    pub places: Range<usize>,
}

/// Bindings of the targets that the passes read.
pub(crate) struct SplatBindGroups {
    nearest: BindGroup,
    sums: BindGroup,
}

impl SplatPasses {
    pub const SHADER: &str = shader!("common.wgsl", "samples.wgsl", "splats.wgsl");
    pub const RESOLVE_SHADER: &str = shader!("common.wgsl", "resolve.wgsl");

    pub fn new(device: &Device, frame: &BindGroupLayout, samples: &BindGroupLayout) -> Self {
        let splats = module(device, "splats", Self::SHADER);
        let resolve = module(device, "resolve", Self::RESOLVE_SHADER);
        let nearest = layout(device, "nearest", &[ShaderInput::Texture]);
        let sums = layout(device, "sums", &[ShaderInput::Texture; 3]);
        let one = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Add,
        };
        let sum = wgpu::ColorTargetState {
            format: SUMS,
            blend: Some(wgpu::BlendState { color: one, alpha: one }),
            write_mask: wgpu::ColorWrites::ALL,
        };
        let depth = Recipe {
            label: "splats: depth",
            module: &splats,
            groups: &[frame, samples],
            vertex: "depth_corner",
            fragment: "depth_pixel",
            targets: &[DEPTHS.into()],
            depth: Some(true),
        };
        let blend = Recipe {
            label: "splats: blend",
            groups: &[frame, samples, &nearest],
            vertex: "blend_corner",
            fragment: "blend_pixel",
            targets: &[sum.clone(), sum],
            depth: Some(false),
            ..depth
        };
        let resolve = Recipe {
            label: "splats: resolve",
            module: &resolve,
            groups: &[frame, &sums],
            vertex: "corner",
            fragment: "pixel",
            targets: &SEEN.map(Into::into),
            depth: None,
        };
        let [depth, blend, resolve] = [depth, blend, resolve].map(|recipe| recipe.make(device));
        Self { depth, blend, resolve, nearest, sums }
    }

    pub fn groups(&self, device: &Device, targets: &Targets) -> SplatBindGroups {
        let texture = wgpu::BindingResource::TextureView;
        let Targets { nearest, colors, surfaces, .. } = targets;
        SplatBindGroups {
            nearest: bind(device, "nearest", &self.nearest, &[texture(nearest)]),
            sums: bind(device, "sums", &self.sums, &[texture(nearest), texture(colors), texture(surfaces)]),
        }
    }

    /// Draws the first pass, over the former content or anew.
    pub fn depth(
        &self,
        encoder: &mut CommandEncoder,
        targets: &Targets,
        parts: &[CloudRange<'_>],
        anew: bool,
    ) {
        let nearest: (&TextureView, _) = (&targets.nearest, anew.then_some(wgpu::Color::TRANSPARENT));
        let depth = Some((&targets.depth, anew.then_some(1.0)));
        let mut pass = begin(encoder, "splats: depth", &[nearest], depth);
        pass.set_pipeline(&self.depth);
        draw(&mut pass, parts);
    }

    /// Draws the second pass, once the first one is done: anew, or over the former content.
    pub fn blend(
        &self,
        encoder: &mut CommandEncoder,
        targets: &Targets,
        groups: &SplatBindGroups,
        parts: &[CloudRange<'_>],
        anew: bool,
    ) {
        let clear = anew.then_some(wgpu::Color::TRANSPARENT);
        let sums = [(&targets.colors, clear), (&targets.surfaces, clear)];
        let mut pass = begin(encoder, "splats: blend", &sums, Some((&targets.depth, None)));
        pass.set_pipeline(&self.blend);
        pass.set_bind_group(2, &groups.nearest, &[]);
        draw(&mut pass, parts);
    }

    /// Draws the means of the sums.
    pub fn resolve(
        &self,
        encoder: &mut CommandEncoder,
        groups: &SplatBindGroups,
        frame: &BindGroup,
        seen: &SurfaceTargets,
    ) {
        let mut pass = begin(encoder, "splats: resolve", &seen.attachments(), None);
        pass.set_pipeline(&self.resolve);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, &groups.sums, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn draw(pass: &mut wgpu::RenderPass<'_>, parts: &[CloudRange<'_>]) {
    for CloudRange { frame, cloud, places } in parts {
        pass.set_bind_group(0, *frame, &[]);
        cloud.draw_splats(pass, places.clone());
    }
}
