//! A soft shadow on the ground.

use glam::DVec3;

use super::SurfaceDisc;
use super::camera::PictureCamera;
use super::facet::spread_over;
use super::style::KEY_LIGHT;

/// Cells of the shadow's map in each direction.
const CELLS: usize = 384;

/// A map of the ground, with what lies above it: along the key light, and straight down.
pub(super) struct Ground {
    pub height: f64,
    corner: DVec3,
    cell: f64,
    /// Height above which nothing darkens the ground by being near.
    contact_height: f64,
    light: DVec3,
    cast: Vec<f32>,
    contact: Vec<f32>,
}

impl Ground {
    pub fn new(height: f64, camera: &PictureCamera) -> Self {
        let side = 8.0 * camera.radius();
        Self {
            height,
            corner: camera.target() - DVec3::new(0.5 * side, 0.0, 0.5 * side),
            cell: side / CELLS as f64,
            contact_height: 0.12 * camera.radius(),
            light: camera.to_world(KEY_LIGHT.as_dvec3()),
            cast: vec![0.0; CELLS * CELLS],
            contact: vec![0.0; CELLS * CELLS],
        }
    }

    pub fn add(&mut self, points: &[SurfaceDisc]) {
        points.iter().for_each(|point| self.add_place(point.position));
    }

    /// Adds triangles, all over their areas.
    pub fn add_triangles(&mut self, triangles: &[[SurfaceDisc; 3]]) {
        let apart = self.cell;
        triangles.iter().for_each(|triangle| spread_over(triangle, apart, |p| self.add_place(p)));
    }

    fn add_place(&mut self, p: DVec3) {
        let above = p.y - self.height;
        // A place without a finite height casts no shadow, either.
        if !(above >= 0.0 && p.is_finite()) {
            return;
        }
        // A light that is too low would throw shadows without end.
        let slope = self.light / self.light.y.max(0.35);
        if let Some(cell) = self.cell_of(p - slope * above) {
            self.cast[cell] = 1.0;
        }
        let near = (1.0 - above / self.contact_height) as f32;
        if near > 0.0
            && let Some(cell) = self.cell_of(p)
        {
            self.contact[cell] = self.contact[cell].max(near);
        }
    }

    /// Softens the shadows.
    pub fn finish(mut self) -> Self {
        for _ in 0..3 {
            blur(&mut self.cast, 9);
            blur(&mut self.contact, 4);
        }
        self
    }

    /// Darkness of the ground at a point of it, from 0 to 1.
    pub fn shadow(&self, p: DVec3) -> f32 {
        let x = (p.x - self.corner.x) / self.cell - 0.5;
        let z = (p.z - self.corner.z) / self.cell - 0.5;
        if !(x >= 0.0 && z >= 0.0 && x < (CELLS - 1) as f64 && z < (CELLS - 1) as f64) {
            return 0.0;
        }
        let (i, j) = (x as usize, z as usize);
        let (s, t) = ((x - i as f64) as f32, (z - j as f64) as f32);
        let bilinear = |map: &[f32]| {
            let row = |j: usize| map[j * CELLS + i] * (1.0 - s) + map[j * CELLS + i + 1] * s;
            row(j) * (1.0 - t) + row(j + 1) * t
        };
        1.0 - (1.0 - 0.30 * bilinear(&self.cast)) * (1.0 - 0.60 * bilinear(&self.contact))
    }

    fn cell_of(&self, p: DVec3) -> Option<usize> {
        let x = (p.x - self.corner.x) / self.cell;
        let z = (p.z - self.corner.z) / self.cell;
        let inside = x >= 0.0 && z >= 0.0 && x < CELLS as f64 && z < CELLS as f64;
        inside.then(|| z as usize * CELLS + x as usize)
    }
}

/// A box filter of the given radius over a map, its outside taken as 0.
fn blur(map: &mut [f32], radius: usize) {
    let share = 1.0 / (2 * radius + 1) as f32;
    let mut line = [0.0; CELLS];
    for (stride, step) in [(CELLS, 1), (1, CELLS)] {
        for i in 0..CELLS {
            let start = i * stride;
            let mut sum: f32 = (0..radius).map(|k| map[start + k * step]).sum();
            for (k, out) in line.iter_mut().enumerate() {
                if k + radius < CELLS {
                    sum += map[start + (k + radius) * step];
                }
                if k > radius {
                    sum -= map[start + (k - radius - 1) * step];
                }
                *out = sum * share;
            }
            for (k, value) in line.iter().enumerate() {
                map[start + k * step] = *value;
            }
        }
    }
}
