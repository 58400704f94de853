//! Pictures back from the device.

use simod_picture::Image;
use wgpu::{BufferUsages, Texture};

use crate::gpu::Gpu;

/// The picture in a texture of [`FORMAT`](crate::FORMAT).
pub(crate) fn image(gpu: &Gpu, texture: &Texture) -> Option<Image> {
    const PIXEL: u32 = 4;
    let (width, height) = (texture.width(), texture.height());
    let row = (PIXEL * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("picture"),
        size: u64::from(row) * u64::from(height),
        usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        texture.size(),
    );
    gpu.queue.submit([encoder.finish()]);

    let (done, arrived) = std::sync::mpsc::channel();
    buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| {
        // Nobody listens only where waiting failed.
        let _ = done.send(result.is_ok());
    });
    gpu.wait();
    if arrived.recv() != Ok(true) {
        return None;
    }
    let bytes = buffer.slice(..).get_mapped_range().ok()?;
    let pixels = bytes
        .chunks_exact(row as usize)
        .flat_map(|row| row[..(PIXEL * width) as usize].chunks_exact(PIXEL as usize))
        .map(|pixel| [pixel[0], pixel[1], pixel[2]])
        .collect();
    Image::from_pixels(width, height, pixels)
}
