//! Light: from the blended surface to colours.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::camera::{Lens, PictureCamera};
use super::ground::Ground;
use super::splat::{Pixel, SplatBuffer};
use super::style::{KEY_LIGHT, Style};

/// Direction to the fill light.
const FILL_LIGHT: Vec3 = Vec3::new(0.80, 0.10, -0.59);
/// Linear colour of the model where its own are not shown.
const CLAY: Vec3 = Vec3::new(0.56, 0.51, 0.46);

/// Samples of the ambient occlusion around each sample of the picture.
const OCCLUSION_SAMPLES: usize = 28;
/// Side of the square of neighbouring samples that share the work, and are averaged afterwards.
const OCCLUSION_TILE: usize = 4;
/// Reach of the occlusion, as a share of the model's radius.
const OCCLUSION_REACH: f32 = 0.13;

/// Lights all samples, in each of some colours of theirs; linear colours, row by row.
pub(super) fn shade<const N: usize>(
    canvas: &SplatBuffer,
    camera: &PictureCamera,
    style: &Style,
    ground: Option<&Ground>,
    colors: [fn(&Pixel) -> Vec3; N],
) -> [Vec<Vec3>; N] {
    let surface = SeenSurface::new(canvas, camera);
    let occlusion = surface.blurred(&surface.occlusion(camera.radius() as f32 * OCCLUSION_REACH));
    colors.map(|color| {
        let at = |(i, pixel): (usize, &Pixel)| {
            let (x, y) = (i % canvas.width, i / canvas.width);
            if surface.depths[i].is_finite() {
                let albedo = if style.own_colors { linear(color(pixel)) } else { CLAY };
                let eye = -surface.lens.ray(x, y).normalize_or_zero();
                lit(albedo, surface.normals[i], eye, occlusion[i])
            } else {
                background(canvas, camera, &surface.lens, ground, x, y)
            }
        };
        canvas.pixels.par_iter().enumerate().map(at).collect()
    })
}

/// The surface as the picture sees it.
struct SeenSurface {
    width: usize,
    height: usize,
    lens: Lens,
    depths: Vec<f32>,
    normals: Vec<Vec3>,
}

impl SeenSurface {
    fn new(canvas: &SplatBuffer, camera: &PictureCamera) -> Self {
        let mut surface = Self {
            width: canvas.width,
            height: canvas.height,
            lens: canvas.lens(camera),
            depths: canvas.pixels.par_iter().map(|pixel| pixel.depth()).collect(),
            normals: Vec::new(),
        };
        surface.normals = (0..canvas.pixels.len())
            .into_par_iter()
            .map(|i| match canvas.pixels[i].normal() {
                Vec3::ZERO if surface.depths[i].is_finite() => {
                    surface.normal_of_depths(i % canvas.width, i / canvas.width)
                }
                normal => normal,
            })
            .collect();
        surface
    }

    /// The point that a sample shows, in view coordinates; none on the background or outside.
    fn point(&self, x: isize, y: isize) -> Option<Vec3> {
        if x < 0 || y < 0 || x >= self.width as isize || y >= self.height as isize {
            return None;
        }
        let (x, y) = (x as usize, y as usize);
        let depth = self.depths[y * self.width + x];
        depth.is_finite().then(|| self.lens.ray(x, y) * depth)
    }

    /// The normal that the depths tell: on each axis from the side where the depth changes less, so that no
    /// silhouette is bridged. Splats without normals are flat, hence the wide step.
    fn normal_of_depths(&self, x: usize, y: usize) -> Vec3 {
        const STEP: isize = 3;
        let (x, y) = (x as isize, y as isize);
        let Some(here) = self.point(x, y) else { return Vec3::ZERO };
        let slope = |dx: isize, dy: isize| {
            let after = self.point(x + dx, y + dy).map(|p| p - here);
            let before = self.point(x - dx, y - dy).map(|p| here - p);
            match (before, after) {
                (Some(a), Some(b)) if (a.z.abs() - b.z.abs()).abs() < a.length() + b.length() => a + b,
                (Some(a), Some(b)) => {
                    if a.z.abs() < b.z.abs() {
                        a
                    } else {
                        b
                    }
                }
                (Some(v), None) | (None, Some(v)) => v,
                (None, None) => Vec3::ZERO,
            }
        };
        // Right times down points to the eye: forward is the third axis, and the system left-handed.
        let normal = slope(STEP, 0).cross(slope(0, STEP)).normalize_or(Vec3::NEG_Z);
        if normal.dot(here) > 0.0 { -normal } else { normal }
    }

    /// Light of the surroundings that each sample gets, from 0 to 1: surface that rises above the sample's
    /// tangent plane nearby takes some away (M. McGuire et al., *The Alchemy Screen-Space Ambient Obscurance
    /// Algorithm*, HPG 2011), on a spiral that is turned from sample to sample.
    fn occlusion(&self, reach: f32) -> Vec<f32> {
        let spirals = spirals();
        (0..self.depths.len())
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % self.width, i / self.width);
                let Some(here) = self.point(x as isize, y as isize) else { return 1.0 };
                let normal = self.normals[i];
                let pixels = (reach * self.lens.scale[1] / here.z).clamp(2.0, 400.0);
                // Neighbours in the tile get turns that differ much.
                let turn = ((x % OCCLUSION_TILE) * 5 + (y % OCCLUSION_TILE) * 7) % TURNS;
                let mut sum = 0.0;
                for [dx, dy, share] in &spirals[turn] {
                    let radius = 1.0 + pixels * share;
                    let (sx, sy) = (x as f32 + radius * dx, y as f32 + radius * dy);
                    // Rounding as `round` does, which calls a library for each number.
                    let [sx, sy] = [sx, sy].map(|s| (s + if s < 0.0 { -0.5 } else { 0.5 }) as isize);
                    if let Some(there) = self.point(sx, sy) {
                        let way = there - here;
                        let distance = way.length();
                        if distance > 0.0 {
                            // Surface that is far away in depth hides nothing here.
                            let near = (1.0 - distance / (1.5 * reach)).max(0.0);
                            sum += (normal.dot(way) / distance - 0.06).max(0.0) * near;
                        }
                    }
                }
                (1.0 - 2.2 * sum / OCCLUSION_SAMPLES as f32).clamp(0.0, 1.0)
            })
            .collect()
    }

    /// Mean of the values over the samples of a tile around each sample that lie on its surface.
    fn blurred(&self, values: &[f32]) -> Vec<f32> {
        const BEFORE: usize = OCCLUSION_TILE / 2;
        (0..values.len())
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % self.width, i / self.width);
                let here = self.depths[i];
                if !here.is_finite() {
                    return 1.0;
                }
                // Within a tile, a slanted surface changes its depth by no more than this.
                let limit = here / self.lens.scale[1] * 4.0 * OCCLUSION_TILE as f32;
                let (mut sum, mut count) = (0.0, 0.0);
                for v in y.saturating_sub(BEFORE)..(y + OCCLUSION_TILE - BEFORE).min(self.height) {
                    for u in x.saturating_sub(BEFORE)..(x + OCCLUSION_TILE - BEFORE).min(self.width) {
                        let j = v * self.width + u;
                        if (self.depths[j] - here).abs() < limit {
                            sum += values[j];
                            count += 1.0;
                        }
                    }
                }
                if count > 0.0 { sum / count } else { values[i] }
            })
            .collect()
    }
}

/// Turns of the spiral of occlusion samples.
const TURNS: usize = OCCLUSION_TILE * OCCLUSION_TILE;

/// Directions on the picture, and how far to go there as a share of the reach, for each turn.
fn spirals() -> [[[f32; 3]; OCCLUSION_SAMPLES]; TURNS] {
    std::array::from_fn(|turn| {
        std::array::from_fn(|k| {
            let t = (k as f32 + (turn as f32 + 0.5) / TURNS as f32) / OCCLUSION_SAMPLES as f32;
            let angle = std::f32::consts::TAU * (t * 7.0 + turn as f32 * 0.618_034);
            let (sin, cos) = angle.sin_cos();
            // Dense in the middle: engraving and edges are small.
            [cos, sin, t * t]
        })
    })
}

/// Light of a sample: key, fill, surroundings from above and below, and a broad highlight.
fn lit(albedo: Vec3, normal: Vec3, eye: Vec3, occlusion: f32) -> Vec3 {
    let key = normal.dot(KEY_LIGHT.normalize_or_zero()).max(0.0);
    let fill = normal.dot(FILL_LIGHT.normalize_or_zero()).max(0.0);
    let sky = 0.5 + 0.5 * normal.y;
    let ambient = (Vec3::new(0.20, 0.19, 0.18) + Vec3::new(0.17, 0.18, 0.20) * sky) * occlusion;
    // Crevices see less of the lamps, too, as these are wide.
    let lamps = 0.35 + 0.65 * occlusion;
    let light = ambient + (Vec3::new(1.02, 0.98, 0.92) * key + Vec3::new(0.17, 0.19, 0.23) * fill) * lamps;

    let halfway = (KEY_LIGHT.normalize_or_zero() + eye).normalize_or_zero();
    let highlight = normal.dot(halfway).max(0.0).powi(40) * 0.10 * key.min(1.0) * occlusion;
    let rim = (1.0 - normal.dot(eye).clamp(0.0, 1.0)).powi(4) * 0.10 * occlusion;
    albedo * light + Vec3::splat(highlight) + Vec3::splat(rim) * sky
}

/// Light paper, a little darker to the corners, with the ground's shadow.
fn background(
    canvas: &SplatBuffer,
    camera: &PictureCamera,
    lens: &Lens,
    ground: Option<&Ground>,
    x: usize,
    y: usize,
) -> Vec3 {
    let u = (x as f32 + 0.5) / canvas.width as f32 - 0.5;
    let v = (y as f32 + 0.5) / canvas.height as f32 - 0.5;
    let paper = Vec3::new(0.845, 0.85, 0.86) * (1.0 - 0.35 * (u * u + v * v));
    let Some(ground) = ground else { return paper };
    let way = camera.to_world(lens.ray(x, y).as_dvec3());
    let eye: DVec3 = camera.position();
    let t = (ground.height - eye.y) / way.y;
    if t > 0.0 && t.is_finite() { paper * (1.0 - ground.shadow(eye + way * t)) } else { paper }
}

/// Linear value of an sRGB colour, near enough for a picture's own colours.
fn linear(srgb: Vec3) -> Vec3 {
    srgb.map(|c| c * (c * (c * 0.305_306_02 + 0.682_171_1) + 0.012_522_88))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SurfaceDisc;

    #[test]
    fn normals_of_a_sphere_given_and_derived() {
        const POINTS: u32 = 40_000;
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let points = |known: bool| -> Vec<SurfaceDisc> {
            (0..POINTS)
                .map(|i| {
                    let y = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(POINTS);
                    let (sin, cos) = (golden * f64::from(i)).sin_cos();
                    let r = (1.0 - y * y).sqrt();
                    let position = DVec3::new(r * cos, y, r * sin);
                    let normal = if known { position.as_vec3() } else { Vec3::ZERO };
                    SurfaceDisc { position, normal, color: [128; 3], radius: 0.024 }
                })
                .collect()
        };
        let camera = PictureCamera::frame([DVec3::splat(-1.0), DVec3::splat(1.0)], 0.7, 0.4, 1.0);
        for (known, worst_allowed, mean_allowed) in [(true, 0.03, 0.01), (false, 0.5, 0.06)] {
            let points = points(known);
            let mut canvas = SplatBuffer::new(400, 400);
            canvas.depth(&camera, &points, &[]);
            canvas.blend(&camera, &points, &[]);
            let surface = SeenSurface::new(&canvas, &camera);
            let center = camera.to_view(DVec3::ZERO);
            let (mut worst, mut sum, mut count) = (0.0f32, 0.0, 0.0);
            for i in 0..canvas.pixels.len() {
                let ray = surface.lens.ray(i % 400, i / 400).normalize_or_zero();
                let nearest = ray.dot(center);
                let inside = 1.0 - (center - ray * nearest).length_squared();
                // The outermost part of the silhouette is steeper than any tolerance.
                if inside < 0.15 {
                    continue;
                }
                let normal = ray * (nearest - inside.sqrt()) - center;
                let error = normal.distance(surface.normals[i]);
                worst = worst.max(error);
                sum += error;
                count += 1.0;
            }
            assert!(count > 10_000.0);
            assert!(worst < worst_allowed, "known: {known}, worst {worst}");
            assert!(sum / count < mean_allowed, "known: {known}, mean {}", sum / count);
        }
    }
}
