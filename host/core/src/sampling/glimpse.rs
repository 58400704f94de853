//! Single vertices of a model before it is sampled, for those who watch.

use glam::Vec3;
use simod_model::progress::Glimpse;
use simod_model::{Model, Progress, VertexChunk};

/// Lets those who watch read vertices of a model from anywhere in its file, if they can be.
pub fn offer(model: &dyn Model, progress: &dyn Progress) {
    let info = model.info();
    if !info.random_access {
        return;
    }
    let mut chunk = VertexChunk::default();
    let mut read = |vertex| {
        let mut reader = model.vertices(vertex..vertex + 1)?;
        reader.set_chunk(1);
        reader.skip_attributes();
        reader.read(&mut chunk)?;
        let normal = chunk.normals.first().copied().unwrap_or(Vec3::ZERO);
        Ok(chunk.positions.first().map(|position| (*position, normal)))
    };
    progress.glimpse(&mut Glimpse::new(info.vertices, &mut read));
}
