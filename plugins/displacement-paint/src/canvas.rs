//! The surface as painted so far, and the way back to earlier states.
//!
//! Positions and normals after the first strokes are kept from one call to the next, with the keys of these
//! strokes, so that one more stroke costs that stroke, and one less costs the samples that it touched. The
//! result is the same to the last bit as if all strokes had been painted anew: it depends on the strokes in
//! their order alone.

use crate::grid::HashGrid;
use crate::surface::LinkedSurface;
use glam::{DVec3, Vec3};
use simod_plugin_api::{Host, PluginResult};
use std::collections::VecDeque;

/// Greatest number of samples' states before strokes that are remembered, for each sample of the surface.
const REMEMBERED: usize = 4;

/// Number of normals that are derived at once on one thread.
const BLOCK: usize = 512;

/// A sample as it was before a stroke.
#[derive(Debug, Clone, Copy)]
struct Before {
    sample: u32,
    position: Vec3,
    normal: Vec3,
}

/// A stroke that was painted.
#[derive(Debug)]
struct PaintedStroke {
    key: u64,
    /// Samples that the stroke changed, as they were; nothing where that was forgotten, as it was too much.
    before: Option<Vec<Before>>,
}

/// The samples as painted so far.
///
/// Memory: up to 58 bytes a sample, and 112 more for taking back.
pub struct Canvas {
    surface: u64,
    /// Positions of the samples, in local coordinates.
    pub positions: Vec<Vec3>,
    /// Normals of the surface at the positions.
    pub normals: Vec<Vec3>,
    /// Grid by which samples are found at their positions.
    pub grid: HashGrid,
    painted: VecDeque<PaintedStroke>,
    /// Samples that the stroke under way has changed so far, as they were.
    before: Vec<Before>,
    is_remembered: Vec<bool>,
    /// Samples whose normals are derived anew, with the new normals: of use in a call alone.
    stale: Vec<(u32, Vec3)>,
    is_stale: Vec<bool>,
}

impl Canvas {
    /// A canvas on which nothing is painted yet.
    pub fn new(surface: &LinkedSurface, positions: &[Vec3], normals: &[Vec3]) -> Self {
        Self {
            surface: surface.id,
            positions: positions.to_vec(),
            normals: normals.to_vec(),
            grid: surface.grid.clone(),
            painted: VecDeque::new(),
            before: Vec::new(),
            is_remembered: vec![false; positions.len()],
            stale: Vec::new(),
            is_stale: vec![false; positions.len()],
        }
    }

    /// Whether the canvas is of this surface.
    pub fn is_of(&self, surface: &LinkedSurface) -> bool {
        self.surface == surface.id
    }

    /// Takes strokes back until the strokes that are left are the first of `keys`, and returns their
    /// number. Nothing if the canvas cannot remember an earlier state: all has to be painted anew.
    pub fn take_back(&mut self, keys: impl Iterator<Item = u64>) -> Option<usize> {
        let common = self.painted.iter().zip(keys).take_while(|(p, key)| p.key == *key).count();
        while self.painted.len() > common {
            let before = self.painted.pop_back().and_then(|p| p.before)?;
            for Before { sample, position, normal } in before {
                let i = sample as usize;
                self.grid.relocate(i, self.positions[i], position);
                (self.positions[i], self.normals[i]) = (position, normal);
            }
        }
        Some(common)
    }

    /// Ends a stroke, which is complete.
    pub fn finish(&mut self, key: u64) {
        let before = std::mem::take(&mut self.before);
        before.iter().for_each(|b| self.is_remembered[b.sample as usize] = false);
        self.painted.push_back(PaintedStroke { key, before: Some(before) });
        let sizes = self.painted.iter().filter_map(|p| p.before.as_ref()).map(Vec::len);
        let mut total: usize = sizes.sum();
        // The last stroke is always remembered: it changes while it is drawn.
        let earlier = self.painted.len() - 1;
        for stroke in self.painted.iter_mut().take(earlier) {
            if total <= REMEMBERED * self.positions.len() {
                break;
            }
            total -= stroke.before.take().map_or(0, |b| b.len());
        }
    }

    fn remember(&mut self, i: usize) {
        if !std::mem::replace(&mut self.is_remembered[i], true) {
            let (position, normal) = (self.positions[i], self.normals[i]);
            self.before.push(Before { sample: i as u32, position, normal });
        }
    }

    /// Moves a sample.
    pub fn shift(&mut self, i: usize, by: DVec3) {
        let to = (self.positions[i].as_dvec3() + by).as_vec3();
        if to == self.positions[i] || !to.is_finite() {
            return;
        }
        self.remember(i);
        self.grid.relocate(i, self.positions[i], to);
        self.positions[i] = to;
    }

    /// Derives the normals of samples that moved, and of those beside them, anew.
    pub fn refresh_normals(
        &mut self,
        surface: &LinkedSurface,
        rest: &UnpaintedSamples<'_>,
        moved: &[u32],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        self.stale.clear();
        let with_those_beside =
            |&i: &u32| std::iter::once(i).chain(surface.beside(i as usize).iter().copied());
        for i in moved.iter().flat_map(with_those_beside) {
            if !std::mem::replace(&mut self.is_stale[i as usize], true) {
                self.stale.push((i, Vec3::ZERO));
            }
        }
        let mut stale = std::mem::take(&mut self.stale);
        host.parallel_blocks(&mut stale, BLOCK, |_, stale| {
            for (i, normal) in stale {
                *normal = turned_normal(surface, rest, &self.positions, *i as usize);
            }
        })?;
        for &(i, normal) in &stale {
            let i = i as usize;
            self.is_stale[i] = false;
            if normal != self.normals[i] {
                self.remember(i);
                self.normals[i] = normal;
            }
        }
        self.stale = stale;
        Ok(())
    }
}

/// The samples before anything was painted.
#[derive(Debug, Clone, Copy)]
pub struct UnpaintedSamples<'a> {
    /// Positions in local coordinates.
    pub positions: &'a [Vec3],
    /// Unit normals.
    pub normals: &'a [Vec3],
}

/// Normal that a sample's rest normal becomes: the direction perpendicular to the images of its tangent
/// plane under the affine map that fits the displacements around it best. Exactly the rest normal where
/// nothing around it moved.
fn turned_normal(surface: &LinkedSurface, rest: &UnpaintedSamples<'_>, positions: &[Vec3], i: usize) -> Vec3 {
    let normal = rest.normals[i];
    let n = normal.as_dvec3();
    let Some(n) = n.try_normalize() else { return normal };
    let (s, t) = n.any_orthonormal_pair();
    let at = rest.positions[i].as_dvec3();
    let moved = |j: usize| positions[j].as_dvec3() - rest.positions[j].as_dvec3();
    let here = moved(i);
    // Normal equations of the displacements' gradient in the tangent plane.
    let (mut ss, mut st, mut tt) = (0.0, 0.0, 0.0);
    let (mut ds, mut dt) = (DVec3::ZERO, DVec3::ZERO);
    for j in surface.beside(i).iter().map(|&j| j as usize) {
        let to = rest.positions[j].as_dvec3() - at;
        let (x, y) = (to.dot(s), to.dot(t));
        let square = x * x + y * y;
        if square > 0.0 {
            let d = (moved(j) - here) / square;
            (ss, st, tt) = (ss + x * x / square, st + x * y / square, tt + y * y / square);
            (ds, dt) = (ds + x * d, dt + y * d);
        }
    }
    let determinant = ss * tt - st * st;
    // Without samples around it, or with all in one line, there is no plane to turn.
    if determinant <= 1e-6 * (ss + tt) * (ss + tt) || (ds, dt) == (DVec3::ZERO, DVec3::ZERO) {
        return normal;
    }
    let along_s = s + (tt * ds - st * dt) / determinant;
    let along_t = t + (ss * dt - st * ds) / determinant;
    along_s.cross(along_t).try_normalize().map_or(normal, |n| n.as_vec3())
}
