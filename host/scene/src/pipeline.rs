//! Parts that all pipelines have in common.

use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, BindingType, BufferBindingType, ColorTargetState, Device,
    RenderPipeline, SamplerBindingType, ShaderModule, ShaderStages, TextureFormat, TextureSampleType,
    TextureViewDimension,
};

/// Joins shader files.
macro_rules! shader {
    ($($file:literal),+) => { concat!($(include_str!($file), "\n"),+) };
}
pub(crate) use shader;

/// Kind of a shader's input.
#[derive(Clone, Copy)]
pub(crate) enum ShaderInput {
    Uniform,
    Storage,
    /// A texture that is read pixel by pixel.
    Texture,
    /// A texture that is read between pixels, too.
    Smooth,
    Sampler,
}

/// Layout of a group: the kinds of its resources, by binding.
pub(crate) fn layout(device: &Device, label: &str, given: &[ShaderInput]) -> BindGroupLayout {
    let texture = |filterable| BindingType::Texture {
        sample_type: TextureSampleType::Float { filterable },
        view_dimension: TextureViewDimension::D2,
        multisampled: false,
    };
    let buffer = |ty| BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let entries: Vec<_> = given
        .iter()
        .zip(0..)
        .map(|(given, binding)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::VERTEX_FRAGMENT,
            ty: match given {
                ShaderInput::Uniform => buffer(BufferBindingType::Uniform),
                ShaderInput::Storage => buffer(BufferBindingType::Storage { read_only: true }),
                ShaderInput::Texture => texture(false),
                ShaderInput::Smooth => texture(true),
                ShaderInput::Sampler => BindingType::Sampler(SamplerBindingType::Filtering),
            },
            count: None,
        })
        .collect();
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

/// A group of these resources, by binding.
pub(crate) fn bind(
    device: &Device,
    label: &str,
    layout: &BindGroupLayout,
    resources: &[BindingResource<'_>],
) -> BindGroup {
    let entries: Vec<_> = resources
        .iter()
        .zip(0..)
        .map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}

pub(crate) fn module(device: &Device, label: &str, source: &str) -> ShaderModule {
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    })
}

/// A pipeline of triangles, all of whose buffers are in groups.
pub(crate) struct Recipe<'a> {
    pub label: &'a str,
    pub module: &'a ShaderModule,
    pub groups: &'a [&'a BindGroupLayout],
    pub vertex: &'a str,
    pub fragment: &'a str,
    pub targets: &'a [ColorTargetState],
    /// Whether the pipeline writes depths; nothing where it does not test them either.
    pub depth: Option<bool>,
}

impl Recipe<'_> {
    pub fn make(&self, device: &Device) -> RenderPipeline {
        let groups: Vec<_> = self.groups.iter().map(|group| Some(*group)).collect();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(self.label),
            bind_group_layouts: &groups,
            immediate_size: 0,
        });
        let targets: Vec<_> = self.targets.iter().cloned().map(Some).collect();
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(self.label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: self.module,
                entry_point: Some(self.vertex),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: self.depth.map(|writes| wgpu::DepthStencilState {
                format: TextureFormat::Depth32Float,
                depth_write_enabled: Some(writes),
                depth_compare: Some(wgpu::CompareFunction::LessEqual),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: self.module,
                entry_point: Some(self.fragment),
                compilation_options: Default::default(),
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Begins a pass over these textures, each cleared to its value first, or kept as it is.
pub(crate) fn begin<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    label: &str,
    colors: &[(&wgpu::TextureView, Option<wgpu::Color>)],
    depth: Option<(&wgpu::TextureView, Option<f32>)>,
) -> wgpu::RenderPass<'a> {
    fn ops<V>(clear: Option<V>) -> wgpu::Operations<V> {
        wgpu::Operations {
            load: clear.map_or(wgpu::LoadOp::Load, wgpu::LoadOp::Clear),
            store: wgpu::StoreOp::Store,
        }
    }
    let attachments: Vec<_> = colors
        .iter()
        .map(|(view, clear)| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: ops(*clear),
            })
        })
        .collect();
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: &attachments,
        depth_stencil_attachment: depth.map(|(view, clear)| wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(ops(clear)),
            stencil_ops: None,
        }),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    })
}

#[cfg(test)]
mod tests {
    use crate::marks::Marks;
    use crate::passes::Passes;
    use crate::splats::SplatPasses;
    use crate::triangles::TriangleMesh;

    /// All shaders are valid for any device, without extensions.
    #[test]
    fn shaders_are_valid() {
        for (name, source) in [
            ("splats", SplatPasses::SHADER),
            ("resolve", SplatPasses::RESOLVE_SHADER),
            ("triangles", TriangleMesh::SHADER),
            ("occlusion", Passes::OCCLUSION_SHADER),
            ("shade", Passes::SHADE_SHADER),
            ("finish", Passes::FINISH_SHADER),
            ("marks", Marks::SHADER),
        ] {
            let module = naga::front::wgsl::parse_str(source)
                .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
            let (flags, none) = (naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
            let valid = naga::valid::Validator::new(flags, none).validate(&module);
            assert!(valid.is_ok(), "{name}: {}", valid.unwrap_err().emit_to_string(source));
        }
    }
}
