//! Two passes of triangles into bands of pixels, as those of [splats](super::splat).
//!
//! A triangle shows at the samples whose middles it covers. One that is too small to cover any shows at the
//! sample around its middle, so that nothing thin is lost; and as all triangles of a sample that lie on the
//! nearest surface are averaged by how much of it they cover, very small ones make a calm picture.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::SurfaceDisc;
use super::camera::{Lens, PictureCamera};
use super::splat::{BAND, BATCH, Bands, Pixel, SplatBuffer};

/// Steepest slope of a surface, in depths for each width of a sample, over which samples are still of one.
const STEEPEST: f32 = 6.0;

/// Least weight of a triangle at a sample.
const LEAST_WEIGHT: f32 = 1e-4;

/// A triangle in the picture.
struct PictureTriangle {
    /// Positions of the corners in the picture, in samples; they may be far outside it.
    corners: [DVec2; 3],
    /// Inverse of twice the area, in samples; of either sign, and infinite where there is no area.
    by_area: f64,
    /// Inverses of the corners' depths.
    inverse: [f32; 3],
    normals: [Vec3; 3],
    colors: [Vec3; 3],
    /// Largest distance of two depths of one surface from each other at a sample, for each unit of depth.
    slack: f32,
    weight: f32,
    /// Samples within the triangle's box: columns and rows, each from the first to beyond the last.
    columns: [usize; 2],
    rows: [usize; 2],
    /// Sample at which the triangle is shown though it covers no sample's middle.
    only: Option<[usize; 2]>,
}

/// The samples of a row or column that a triangle touches, whether it covers their middles or not.
fn touched(low: f64, high: f64, count: usize) -> Option<[usize; 2]> {
    let (first, last) = (low.floor().max(0.0), (high.floor() + 1.0).min(count as f64));
    (first < last).then_some([first as usize, last as usize])
}

/// The normal of a triangle on the side that is seen, and its slope, in depths for each width.
fn facing([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    let face = (b - a).cross(c - a);
    // A triangle without an area has no side: any will do, such as that towards the eye.
    let face = face.try_normalize().unwrap_or_else(|| -a.normalize_or_zero());
    let middle = (a + b + c) / 3.0;
    let face = if face.dot(middle) > 0.0 { -face } else { face };
    let toward = middle.normalize_or_zero();
    let along = face.dot(toward).abs().max(1e-3);
    (face, ((1.0 - along * along).max(0.0).sqrt() / along).min(STEEPEST))
}

impl PictureTriangle {
    /// Triangle in a picture of the given size; none if it is outside, or has a corner that is not before the
    /// camera.
    fn new(
        camera: &PictureCamera,
        lens: &Lens,
        size: [usize; 2],
        triangle: &[SurfaceDisc; 3],
    ) -> Option<Self> {
        let places = triangle.map(|corner| camera.to_view(corner.position));
        if !places.iter().all(|p| p.is_finite() && p.z > lens.near) {
            return None;
        }
        let corners = places.map(|p| {
            let [x, y] = lens.project_exactly(p.as_dvec3());
            DVec2::new(x, y)
        });
        let [low, high] =
            [corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2])];
        let columns = touched(low.x, high.x, size[0])?;
        let rows = touched(low.y, high.y, size[1])?;
        let area = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]);
        let (face, slope) = facing(places);
        let normals = triangle.map(|corner| {
            let normal = camera.direction_to_view(corner.normal.as_dvec3()).as_vec3();
            let normal = normal.try_normalize().unwrap_or(face);
            if normal.dot(face) < 0.0 { -normal } else { normal }
        });
        let mut this = Self {
            corners,
            by_area: area.recip(),
            inverse: places.map(|p| p.z.recip()),
            normals,
            colors: triangle.map(|corner| Vec3::from(corner.color.map(f32::from)) / 255.0),
            slack: (0.5 + slope) / lens.scale[0].min(lens.scale[1]),
            weight: ((0.5 * area.abs()) as f32).clamp(LEAST_WEIGHT, 1.0),
            columns,
            rows,
            only: None,
        };
        if (columns[1] - columns[0]) * (rows[1] - rows[0]) <= 16 && !this.covers_any() {
            let middle = ((corners[0] + corners[1] + corners[2]) / 3.0).floor();
            let inside =
                middle.cmpge(DVec2::ZERO).all() && middle.x < size[0] as f64 && middle.y < size[1] as f64;
            if !inside {
                return None;
            }
            this.only = Some([middle.x as usize, middle.y as usize]);
        }
        Some(this)
    }

    fn covers_any(&self) -> bool {
        let [left, right] = self.columns;
        (self.rows[0]..self.rows[1]).any(|y| (left..right).any(|x| self.shares(x, y).is_some()))
    }

    /// Barycentric coordinates of a sample's middle in the triangle, as the picture shows it; none where the
    /// middle is outside. The sides belong to both triangles there, and a little more than that, so that
    /// nothing shines through between.
    #[inline]
    fn shares(&self, x: usize, y: usize) -> Option<[f32; 3]> {
        const SLACK: f64 = -1e-7;
        let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let [a, b, c] = self.corners.map(|corner| corner - p);
        let parts = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)].map(|part| part * self.by_area);
        // Without an area, no part is a number, or none is finite.
        let is_inside = parts.iter().all(|part| *part >= SLACK && part.is_finite());
        is_inside.then(|| parts.map(|part| part.max(0.0) as f32))
    }

    /// Depth, and how much each corner has of the surface there.
    #[inline]
    fn interpolated(&self, shares: [f32; 3]) -> (f32, [f32; 3]) {
        let parts: [f32; 3] = std::array::from_fn(|i| shares[i] * self.inverse[i]);
        let depth = parts.iter().sum::<f32>().recip();
        (depth, parts.map(|part| part * depth))
    }

    /// Calls `hit` for each sample of some rows at which the triangle is shown, with its column and row.
    #[inline]
    fn visit(&self, [first, last]: [usize; 2], mut hit: impl FnMut(usize, usize, f32, [f32; 3])) {
        if let Some([x, y]) = self.only {
            if (first..last).contains(&y) {
                let (depth, parts) = self.interpolated([1.0 / 3.0; 3]);
                hit(x, y, depth, parts);
            }
            return;
        }
        for y in self.rows[0].max(first)..self.rows[1].min(last) {
            for x in self.columns[0]..self.columns[1] {
                if let Some(shares) = self.shares(x, y) {
                    let (depth, parts) = self.interpolated(shares);
                    hit(x, y, depth, parts);
                }
            }
        }
    }
}

fn mixed(parts: [f32; 3], of: &[Vec3; 3]) -> Vec3 {
    of[0] * parts[0] + of[1] * parts[1] + of[2] * parts[2]
}

/// A normal that does not look away from the eye: at an outline, one in between may.
fn towards(normal: Vec3, ray: Vec3) -> Vec3 {
    let away = normal.dot(ray);
    if away > 0.0 { normal - ray * (away / ray.length_squared()) } else { normal }
}

/// Draws triangles into a canvas, always by the same memory: to get it anew takes the system longer than to
/// fill it.
///
/// Memory: some 200 bytes for each triangle of a batch, 13 MB at most.
#[derive(Default)]
pub(super) struct TriangleRaster {
    batch: Vec<Option<PictureTriangle>>,
    bands: Bands,
}

impl TriangleRaster {
    /// First pass: the depth of the nearest surface.
    pub fn depth(
        &mut self,
        canvas: &mut SplatBuffer,
        camera: &PictureCamera,
        triangles: &[[SurfaceDisc; 3]],
    ) {
        self.draw(canvas, camera, triangles, |pixel, _, _, depth, _| pixel.come_near(depth));
    }

    /// Second pass: blends the triangles on the nearest surface.
    pub fn blend(
        &mut self,
        canvas: &mut SplatBuffer,
        camera: &PictureCamera,
        triangles: &[[SurfaceDisc; 3]],
    ) {
        self.draw(canvas, camera, triangles, |pixel, facet, ray, depth, parts| {
            if pixel.is_near(depth, facet.slack * depth) {
                let normal = towards(mixed(parts, &facet.normals).normalize_or_zero(), ray);
                pixel.blend(facet.weight, depth, normal, mixed(parts, &facet.colors));
            }
        });
    }

    fn draw(
        &mut self,
        canvas: &mut SplatBuffer,
        camera: &PictureCamera,
        triangles: &[[SurfaceDisc; 3]],
        hit: impl Fn(&mut Pixel, &PictureTriangle, Vec3, f32, [f32; 3]) + Sync,
    ) {
        let lens = canvas.lens(camera);
        let size = [canvas.width, canvas.height];
        for batch in triangles.chunks(BATCH) {
            let facet = |triangle| PictureTriangle::new(camera, &lens, size, triangle);
            batch.par_iter().map(facet).collect_into_vec(&mut self.batch);
            self.bands.sort(size[1], &self.batch, |facet| facet.as_ref().map(|f| f.rows));
            let Self { batch: facets, bands } = self;
            canvas.pixels.par_chunks_mut(BAND * size[0]).enumerate().for_each(|(band, pixels)| {
                let first = band * BAND;
                let rows = [first, first + pixels.len() / size[0]];
                for facet in bands.in_band(band, facets).flatten() {
                    facet.visit(rows, |x, y, depth, parts| {
                        hit(&mut pixels[(y - first) * size[0] + x], facet, lens.ray(x, y), depth, parts);
                    });
                }
            });
        }
    }
}

/// Points of a triangle, no two neighbours farther apart than a length but for very large ones: `visit` gets
/// all of these, or the first corner of one that is smaller than that.
pub(super) fn spread_over(triangle: &[SurfaceDisc; 3], apart: f64, mut visit: impl FnMut(DVec3)) {
    const MOST: f64 = 256.0;
    let [a, b, c] = triangle.map(|corner| corner.position);
    let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a)).sqrt();
    if longest <= apart {
        visit(a);
    } else if longest.is_finite() {
        let steps = (longest / apart).ceil().min(MOST) as u32;
        for i in 0..=steps {
            for k in 0..=steps - i {
                let [s, t] = [i, k].map(|n| f64::from(n) / f64::from(steps));
                visit(a + (b - a) * s + (c - a) * t);
            }
        }
    }
}
