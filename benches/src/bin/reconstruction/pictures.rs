//! Pictures of a model, its deformed samples, and the model that is made of these.

use std::path::Path;

use glam::{DVec3, Vec3};
use simod_benches::Map;
use simod_benches::process::Result;
use simod_core::reconstruction::deformed_normals;
use simod_model::Model;
use simod_model::bounds::Bounds;
use simod_model::output::write_file;
use simod_picture::{Image, PictureCamera, Renderer, Spacing, Style, SurfaceDisc};

use crate::method::Method;
use crate::scene::Scene;

const CLAY: [u8; 3] = [200, 190, 180];
const SIZE: [u32; 2] = [480, 560];
/// From where: to the right of +z, and down, in radians.
const VIEW: [f64; 2] = [0.5, 0.25];
/// Radius of a sample's disc over its spacing: too small to hide that there are few.
const SAMPLE_RADIUS: f64 = 0.5;

/// Draws one picture into a folder.
pub fn draw(scene: &Scene, map: Map, folder: &Path) -> Result<()> {
    let deformed = map.deform(&scene.sampled);
    scene.transfer(Method::SIMOD[1], &deformed)?;
    let result = scene.result()?;

    let samples = points_of_samples(scene, &deformed.local);
    let after = Bounds::from_points(samples.iter().map(|p| p.position));
    let pictures = [
        picture(&points_of_model(scene.model.as_ref(), &scene.sampled.bounds)?, &scene.sampled.bounds),
        picture(&samples, &after),
        picture(&points_of_model(result.as_ref(), &after)?, &after),
    ];
    let captions = [
        scene.name.clone(),
        format!("{} samples", samples.len()),
        format!("{} vertices", scene.positions.len()),
    ];
    let captioned: Vec<(&Image, &str)> = pictures.iter().zip(captions.iter().map(String::as_str)).collect();
    let name = format!("reconstruction-{}-{}.png", scene.name, map.name()).replace(' ', "-");
    std::fs::create_dir_all(folder)?;
    Ok(write_file(&folder.join(name), &Image::side_by_side(&captioned).to_png()?)?)
}

fn picture(points: &[SurfaceDisc], bounds: &Bounds) -> Image {
    let [width, height] = SIZE;
    let camera = PictureCamera::frame(
        [bounds.min, bounds.max],
        VIEW[0],
        VIEW[1],
        f64::from(width) / f64::from(height),
    );
    let style = Style { own_colors: false, ground: Some(bounds.min.y) };
    let mut renderer = Renderer::new(width, height, camera, style);
    renderer.depth(points);
    renderer.blend(points);
    renderer.finish()
}

fn points_of_model(model: &dyn Model, bounds: &Bounds) -> Result<Vec<SurfaceDisc>> {
    let mut surface: Vec<(DVec3, Vec3)> = Vec::new();
    simod_model::for_vertices(model, |chunk| {
        let normals = chunk.normals.iter().copied().chain(std::iter::repeat(Vec3::ZERO));
        surface.extend(chunk.positions.iter().copied().zip(normals));
        Ok(())
    })?;
    let mut spacing = Spacing::new([bounds.min, bounds.max]);
    spacing.add(surface.iter().map(|(p, _)| *p));
    let point = |(position, normal): (DVec3, Vec3)| SurfaceDisc {
        position,
        normal,
        color: CLAY,
        radius: spacing.radius_at(position),
    };
    Ok(surface.into_iter().map(point).collect())
}

fn points_of_samples(scene: &Scene, deformed: &[Vec3]) -> Vec<SurfaceDisc> {
    let (samples, frame) = (&scene.sampled.samples, scene.sampled.frame);
    let normals = deformed_normals(samples, deformed);
    let point = |((p, normal), spacing): ((&Vec3, Vec3), &f32)| SurfaceDisc {
        position: frame.to_model(*p),
        normal,
        color: CLAY,
        radius: (SAMPLE_RADIUS * f64::from(*spacing) * frame.scale) as f32,
    };
    deformed.iter().zip(normals).zip(samples.spacing()).map(point).collect()
}
