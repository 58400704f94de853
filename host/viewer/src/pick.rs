//! Visibility from the camera: a small depth buffer of splats, drawn on the processor, one sample after the
//! other, so that the result is the same everywhere.

use crate::camera::{Camera, Projection, Ray};
use crate::clip::cuts;
use crate::scene::ViewerScene;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use simod_geometry::smoothstep;

/// Greatest number of pixels of the buffer along its longer side.
const LONGEST: f64 = 1024.0;

/// Number of neighbours that decide on the radius of a sample's disc.
const RING: usize = 6;

/// A disc's radius, in mean distances to the neighbours: enough that no gap is left between discs.
const REACH: f32 = 1.0;

/// Least number of pixels, from its middle, that a disc covers.
const LEAST_REACH: f64 = 0.75;

/// Depth behind the nearest surface to which a sample still counts as seen, in radii of its disc: for
/// samples that face the camera, and for those that do not, which are on the far side of something if
/// anything at all lies before them.
const BEHIND: [f64; 2] = [1.0, 0.25];

/// No sample.
const NOBODY: u32 = u32::MAX;

/// A point of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The nearest sample.
    pub sample: u32,
    /// The point in local coordinates.
    pub local: DVec3,
    /// The point in model coordinates.
    pub at: DVec3,
    /// The surface's normal there, of length 1, towards the outside.
    pub normal: DVec3,
}

/// The sample that is seen in each pixel.
pub struct DepthBuffer {
    camera: Camera,
    /// The picture's size, in pixels of the window, and of the buffer.
    size: [f64; 2],
    /// Plane beyond which nothing is drawn: unit normal and distance, in local coordinates.
    clip: Option<(DVec3, f64)>,
    lens: PixelMap,
    width: usize,
    height: usize,
    nearest: Vec<(f32, u32)>,
    /// The discs' radii.
    radii: Vec<f32>,
}

/// Sample's disc before the camera. Vectors are the eye's: to the right, upwards, and depth.
struct Disc {
    pixel: DVec2,
    radius: f64,
    /// Radius in pixels of the buffer.
    reach: f64,
    normal: DVec3,
    center: DVec3,
    faces: bool,
}

/// The camera's map to the pixels of the buffer, with all that many points share.
struct PixelMap {
    eye: DVec3,
    axes: [DVec3; 3],
    flat: bool,
    /// Half of the picture's width and height at depth 1, or at any depth.
    half: DVec2,
    size: DVec2,
}

impl PixelMap {
    fn new(camera: &Camera, size: [f64; 2]) -> Self {
        let flat = camera.projection == Projection::Orthographic;
        let height = 0.5 * size[1] * camera.pixel_length(1.0, size);
        let half = DVec2::new(height * size[0] / size[1], height);
        Self { eye: camera.eye(), axes: camera.axes(), flat, half, size: size.into() }
    }

    fn direction_to_eye(&self, v: DVec3) -> DVec3 {
        let [right, up, back] = self.axes;
        DVec3::new(v.dot(right), v.dot(up), -v.dot(back))
    }

    /// The point on a pixel's ray at depth 1.
    fn ray(&self, pixel: DVec2) -> DVec2 {
        (2.0 * pixel / self.size - 1.0) * DVec2::new(self.half.x, -self.half.y)
    }

    fn disc(&self, center: DVec3, normal: DVec3, radius: f64) -> Option<Disc> {
        let (center, normal) = (self.direction_to_eye(center - self.eye), self.direction_to_eye(normal));
        let share = if self.flat { 1.0 } else { center.z };
        if share <= 0.0 {
            return None;
        }
        let at = center.truncate() / (self.half * share);
        let pixel = 0.5 * self.size * (1.0 + DVec2::new(at.x, -at.y));
        let reach = (0.5 * self.size.y * radius / (self.half.y * share)).clamp(LEAST_REACH, LONGEST);
        let faces = if self.flat { normal.z < 0.0 } else { normal.dot(center) < 0.0 };
        pixel.is_finite().then_some(Disc { pixel, radius, reach, normal, center, faces })
    }

    /// Depth of a disc at a pixel that the disc covers. A disc that is seen edge-on still covers its own
    /// pixel.
    fn depth_at(&self, pixel: DVec2, disc: &Disc) -> Option<f64> {
        let (ray, n, c) = (self.ray(pixel), disc.normal, disc.center);
        let hit = if self.flat {
            ray.extend(c.z - n.truncate().dot(ray - c.truncate()) / n.z)
        } else {
            let ray = ray.extend(1.0);
            ray * (n.dot(c) / n.dot(ray))
        };
        if hit.distance_squared(c) <= disc.radius * disc.radius {
            return Some(hit.z);
        }
        (pixel.distance_squared(disc.pixel) <= LEAST_REACH * LEAST_REACH).then_some(c.z)
    }
}

impl DepthBuffer {
    /// Depths of the samples in a picture of so many pixels, without the samples beyond a plane (unit
    /// normal and distance, local coordinates).
    pub fn new(scene: &ViewerScene, camera: &Camera, size: [f64; 2], clip: Option<(DVec3, f64)>) -> Self {
        let shrink = (LONGEST / size[0].max(size[1]).max(1.0)).min(1.0);
        let pixels = |length: f64| ((length * shrink).ceil() as usize).max(1);
        let (width, height) = (pixels(size[0]), pixels(size[1]));
        let neighbours = scene.sampled.samples.neighbours();
        let radius = |i: usize| {
            let near = &neighbours.nearest_to(i)[..RING.min(neighbours.k())];
            let sum: f32 =
                near.iter().map(|j| scene.positions[*j as usize].distance(scene.positions[i])).sum();
            REACH * sum / near.len().max(1) as f32
        };
        let radii: Vec<f32> = (0..scene.len()).into_par_iter().map(radius).collect();
        let nearest = vec![(f32::INFINITY, NOBODY); width * height];
        let lens = PixelMap::new(camera, [width as f64, height as f64]);
        let mut this = Self { camera: *camera, size, clip, lens, width, height, nearest, radii };
        for i in 0..scene.len() {
            if let Some(disc) = this.disc(scene, i) {
                this.draw(i as u32, &disc);
            }
        }
        this
    }

    /// Whether the buffer is of this camera, size and plane.
    pub fn is_of(&self, camera: &Camera, size: [f64; 2], clip: Option<(DVec3, f64)>) -> bool {
        self.camera == *camera && self.size == size && self.clip == clip
    }

    /// Disc of a sample before the camera; nothing where the sample is cut away, or behind the eye.
    fn disc(&self, scene: &ViewerScene, i: usize) -> Option<Disc> {
        if cuts(self.clip, scene.positions[i]) {
            return None;
        }
        let (center, normal) = (scene.positions[i].as_dvec3(), scene.normals()[i].as_dvec3());
        self.lens.disc(center, normal, f64::from(self.radii[i]))
    }

    fn draw(&mut self, sample: u32, disc: &Disc) {
        let range = |center: f64, count: usize| {
            let from = (center - disc.reach).floor().max(0.0) as usize;
            from..((center + disc.reach).ceil().max(0.0) as usize).min(count)
        };
        for y in range(disc.pixel.y, self.height) {
            for x in range(disc.pixel.x, self.width) {
                let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let Some(depth) = self.lens.depth_at(pixel, disc) else { continue };
                let nearest = &mut self.nearest[y * self.width + x];
                if (depth as f32) < nearest.0 {
                    *nearest = (depth as f32, sample);
                }
            }
        }
    }

    /// Whether each sample is seen, and none lies before it.
    pub fn visible(&self, scene: &ViewerScene) -> Vec<bool> {
        let is_seen = |i: usize| {
            let Some(disc) = self.disc(scene, i) else { return false };
            let Some((depth, _)) = self.look_up(disc.pixel) else { return false };
            // Depths are those of the pixels' middles.
            let pixel = disc.radius / disc.reach;
            disc.center.z <= f64::from(depth) + BEHIND[usize::from(!disc.faces)] * disc.radius + pixel
        };
        (0..scene.len()).into_par_iter().map(is_seen).collect()
    }

    /// Whether each sample is visible, or is the nearest one in a pixel, though its middle may be outside
    /// of the picture.
    pub fn seen(&self, scene: &ViewerScene) -> Vec<bool> {
        let mut seen = self.visible(scene);
        let nearest = self.nearest.iter().map(|(_, sample)| *sample);
        nearest.filter(|sample| *sample != NOBODY).for_each(|sample| seen[sample as usize] = true);
        seen
    }

    /// Depth and sample at a pixel of the buffer.
    fn look_up(&self, pixel: DVec2) -> Option<(f32, u32)> {
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0;
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        (inside && x < self.width && y < self.height).then(|| self.nearest[y * self.width + x])
    }

    /// The point of the surface under a pixel of the window; nothing where there is none.
    pub fn pick(&self, scene: &ViewerScene, pixel: DVec2) -> Option<Hit> {
        let (_, sample) = self.look_up(self.shrunk(pixel)).filter(|(_, sample)| *sample != NOBODY)?;
        Some(self.hit(scene, pixel, sample))
    }

    /// Point behind that under a pixel, where the body ends that begins there: on the nearest surface that
    /// looks away. Nothing where there is none, as in an open scan.
    pub fn pick_far_side(&self, scene: &ViewerScene, pixel: DVec2) -> Option<Hit> {
        let at = self.shrunk(pixel);
        let (front, first) = self.look_up(at).filter(|(_, sample)| *sample != NOBODY)?;
        let from = front + self.radii[first as usize];
        let behind = |i: usize| {
            let disc = self.disc(scene, i).filter(|disc| !disc.faces)?;
            let depth = self.lens.depth_at(at, &disc)? as f32;
            (depth > from).then_some((depth, i as u32))
        };
        let all = (0..scene.len()).into_par_iter().filter_map(behind);
        // Of samples at one depth the first is taken, whatever the threads.
        let (_, sample) = all.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
        Some(self.hit(scene, pixel, sample))
    }

    /// A pixel of the window as one of the buffer.
    fn shrunk(&self, pixel: DVec2) -> DVec2 {
        let [width, height] = self.size.map(|s| s.max(1.0));
        pixel * DVec2::new(self.width as f64 / width, self.height as f64 / height)
    }

    fn hit(&self, scene: &ViewerScene, pixel: DVec2, sample: u32) -> Hit {
        let ray = self.camera.ray(pixel, self.size);
        surface(scene, &ray, sample, f64::from(self.radii[sample as usize]))
    }
}

/// Intersection of a ray and a plane; nothing where the ray runs along the plane.
fn plane(ray: &Ray, point: DVec3, normal: DVec3) -> Option<DVec3> {
    let facing = normal.dot(ray.direction);
    let t = (point - ray.origin).dot(normal) / facing;
    (facing.abs() > 1e-3 && t.is_finite()).then(|| ray.origin + ray.direction * t)
}

/// Intersection of a ray and the surface near a sample: first with the sample's own plane, then with the
/// mean one of the samples around (M. Alexa et al., *Point Set Surfaces*, 2001, with two steps).
fn surface(scene: &ViewerScene, ray: &Ray, sample: u32, radius: f64) -> Hit {
    let of = |i: u32| (scene.positions[i as usize].as_dvec3(), scene.normals()[i as usize].as_dvec3());
    let (center, own) = of(sample);
    let near = |p: DVec3| p.distance(center) <= 2.0 * radius;
    // On a plane that is seen edge-on, the ray's nearest point to the sample is taken.
    let foot = ray.origin + ray.direction * (center - ray.origin).dot(ray.direction);
    let (mut p, mut n) = (plane(ray, center, own).filter(|p| near(*p)).unwrap_or(foot), own);
    let around = scene.sampled.samples.neighbours().nearest_to(sample as usize);
    for _ in 0..2 {
        let (mut sum, mut point, mut normal) = (0.0, DVec3::ZERO, DVec3::ZERO);
        for i in std::iter::once(&sample).chain(around) {
            let (q, m) = of(*i);
            let t = (p.distance(q) / (2.0 * radius).max(f64::MIN_POSITIVE)).min(1.0);
            // Samples of other sheets nearby have other normals.
            let weight = (1.0 - smoothstep(t)) * m.dot(own).max(0.0);
            (sum, point, normal) = (sum + weight, point + weight * q, normal + weight * m);
        }
        let Some(mean) = normal.try_normalize().filter(|_| sum > 0.0) else { break };
        let Some(hit) = plane(ray, point / sum, mean).filter(|p| near(*p)) else { break };
        (p, n) = (hit, mean);
    }
    let nearest = |i: &u32| scene.positions[*i as usize].distance_squared(p.as_vec3());
    let all = std::iter::once(&sample).chain(around);
    let sample = all.min_by(|a, b| nearest(a).total_cmp(&nearest(b))).copied().unwrap_or(sample);
    Hit { sample, local: p, at: scene.frame().to_model_exact(p), normal: n }
}

/// Samples whose pixels fulfil a condition; samples behind the camera do not.
pub fn within(
    scene: &ViewerScene,
    camera: &Camera,
    size: [f64; 2],
    is_in: impl Fn(DVec2) -> bool + Sync,
) -> Vec<bool> {
    let test = |p: &Vec3| camera.project(p.as_dvec3(), size).is_some_and(|(pixel, _)| is_in(pixel));
    scene.positions.par_iter().map(test).collect()
}

/// Whether a pixel is within a radius of a line through pixels.
pub fn near_path(path: &[[f64; 2]], radius: f64, pixel: DVec2) -> bool {
    let to_segment = |a: DVec2, b: DVec2| {
        let way = b - a;
        let t = ((pixel - a).dot(way) / way.length_squared()).clamp(0.0, 1.0);
        let t = if t.is_nan() { 0.0 } else { t };
        pixel.distance_squared(a + way * t)
    };
    let near = |d: f64| d <= radius * radius;
    match path {
        [one] => near(pixel.distance_squared(DVec2::from(*one))),
        _ => path.windows(2).any(|ends| near(to_segment(ends[0].into(), ends[1].into()))),
    }
}

/// Whether a pixel is inside a closed line through pixels: the line goes round it an odd number of times.
pub fn in_lasso(path: &[[f64; 2]], pixel: DVec2) -> bool {
    let mut inside = false;
    for (i, b) in path.iter().enumerate() {
        let a = path[(i + path.len() - 1) % path.len()];
        let crosses = (a[1] > pixel.y) != (b[1] > pixel.y);
        if crosses && pixel.x < a[0] + (b[0] - a[0]) * (pixel.y - a[1]) / (b[1] - a[1]) {
            inside = !inside;
        }
    }
    inside
}
