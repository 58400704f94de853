//! The textures that a frame is drawn into.

use crate::pipeline::begin;
use wgpu::{Device, TextureFormat, TextureUsages, TextureView};

/// Sums of the splats.
pub(crate) const SUMS: TextureFormat = TextureFormat::Rgba16Float;
/// Depths, along the direction of view.
pub(crate) const DEPTHS: TextureFormat = TextureFormat::R32Float;
/// Occlusion, and depths.
pub(crate) const OCCLUSION: TextureFormat = TextureFormat::Rg32Float;
/// Formats of a surface's colour, normal and depth.
pub(crate) const SEEN: [TextureFormat; 3] = [TextureFormat::Rgba8Unorm, TextureFormat::Rgba16Float, DEPTHS];

/// All textures of a size but the finished one: 46 bytes per pixel, 16 more with a ghost.
pub(crate) struct Targets {
    /// Width and height in drawn pixels.
    pub size: [u32; 2],
    /// Width and height of the picture in pixels.
    pub finished_size: [u32; 2],
    /// Buffer for the test of depths.
    pub depth: TextureView,
    /// Sums over splats: depth of the nearest, sums of colours, sums of normals and depths.
    pub nearest: TextureView,
    pub colors: TextureView,
    pub surfaces: TextureView,
    /// Visible surface.
    pub seen: SurfaceTargets,
    /// Visible surface of the ghost, once there is one.
    pub ghost: Option<SurfaceTargets>,
    pub occlusion: TextureView,
    pub lit: TextureView,
}

/// The surface that is seen: colour, normal, depth.
pub(crate) struct SurfaceTargets {
    pub color: TextureView,
    pub normal: TextureView,
    pub depth: TextureView,
}

impl Targets {
    pub fn new(device: &Device, size: [u32; 2], finished_size: [u32; 2]) -> Self {
        let view = |label, format| texture(device, label, size, format).create_view(&Default::default());
        Self {
            size,
            finished_size,
            depth: view("depth test", TextureFormat::Depth32Float),
            nearest: view("nearest", DEPTHS),
            colors: view("sums of colours", SUMS),
            surfaces: view("sums of normals", SUMS),
            seen: SurfaceTargets::new(device, size),
            ghost: None,
            occlusion: texture(device, "occlusion", size.map(|s| s.div_ceil(2)), OCCLUSION)
                .create_view(&Default::default()),
            lit: view("lit", crate::FORMAT),
        }
    }
}

impl SurfaceTargets {
    pub fn new(device: &Device, size: [u32; 2]) -> Self {
        let [color, normal, depth] =
            SEEN.map(|format| texture(device, "seen", size, format).create_view(&Default::default()));
        Self { color, normal, depth }
    }

    /// Attachments, which are cleared and written.
    pub fn attachments(&self) -> [(&TextureView, Option<wgpu::Color>); 3] {
        [&self.color, &self.normal, &self.depth].map(|view| (view, Some(wgpu::Color::TRANSPARENT)))
    }
}

/// A texture that is drawn and read.
pub(crate) fn texture(
    device: &Device,
    label: &str,
    [width, height]: [u32; 2],
    format: TextureFormat,
) -> wgpu::Texture {
    let mut usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
    if format == crate::FORMAT {
        usage |= TextureUsages::COPY_SRC;
    }
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

impl SurfaceTargets {
    /// Clears the targets: no surface is seen.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        begin(encoder, "nothing", &self.attachments(), None);
    }
}
