//! A picture of the renderer's as egui knows it.

use eframe::egui::{Color32, Rect, Shape, TextureId, pos2};
use eframe::egui_wgpu::RenderState;

/// Texture of a picture, which egui knows as long as this value lives.
pub struct Texture {
    render: RenderState,
    known: Option<(TextureId, [u32; 2])>,
}

impl Texture {
    /// A texture without a picture yet.
    pub fn new(render: &RenderState) -> Self {
        Self { render: render.clone(), known: None }
    }

    /// Takes a picture of this size: another one whenever the size changes, the same otherwise.
    pub fn set(&mut self, picture: &wgpu::TextureView, size: [u32; 2]) {
        let mut renderer = self.render.renderer.write();
        let (device, filter) = (&self.render.device, wgpu::FilterMode::Linear);
        let id = match self.known {
            Some((id, known)) if known == size => id,
            Some((id, _)) => {
                renderer.update_egui_texture_from_wgpu_texture(device, picture, filter, id);
                id
            }
            None => renderer.register_native_texture(device, picture, filter),
        };
        self.known = Some((id, size));
    }

    /// Shape that shows the texture; nothing before there is a picture.
    pub fn show(&self, rect: Rect) -> Shape {
        let Some((id, _)) = self.known else { return Shape::Noop };
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        Shape::image(id, rect, uv, Color32::WHITE)
    }
}

impl Drop for Texture {
    fn drop(&mut self) {
        if let Some((id, _)) = self.known {
            self.render.renderer.write().free_texture(&id);
        }
    }
}
