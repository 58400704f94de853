//! Coordinates of a closed cage that come from linear elasticity, and keep the shape of details.
//!
//! After J. Chen, F. de Goes, M. Desbrun, *Somigliana coordinates: an elasticity-derived approach for cage
//! deformation*, SIGGRAPH 2023: by Somigliana's identity, the displacement of a body at a point follows
//! from the displacements of its boundary, by a matrix for each vertex, and from the tractions there.
//! Elasticity is linear in a frame that goes along with the cage around the point: the similarity that is
//! nearest to the maps of the faces at each vertex, weighted by the angle at which the point sees them.
//! Displacements are relative to that frame.
//!
//! The method differs from the paper in the choice of tractions. Nobody knows them, and those that follow
//! from each face's stretch, rotated along, are wrong by the moduli where materials are nearly
//! incompressible; here there are no tractions in the frame, which needs no modulus, and half of the
//! memory. And the stretch that the cage has as a whole belongs to the frame, so that not only similarities
//! but all affine maps come back.

use crate::mesh::Cage;
use crate::panels::{Panel, Sight};
use crate::pose::MovedCage;
use glam::{DMat3, DVec3};
use pulp::{Arch, Simd, WithSimd};
use simod_plugin_api::{Host, PluginResult};
use std::array::from_fn;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of samples whose coordinates lie together.
pub const TILE: usize = 64;
/// Distance to the surface, in radii of the cage, below which a point has the coordinates of a point
/// within, next to the nearest one of the surface; so has a point outside.
const SKIN: f64 = 1e-5;
/// Depth of that point below its face, in radii of the cage.
const DEPTH: f64 = 1e-6;
/// Way of that point from the edge, as a part of the way to the face's centre: beyond an edge another face
/// may be near.
const ASIDE: f64 = 1e-3;

/// A cage and its material.
#[derive(Debug)]
pub struct CageBody {
    panels: Vec<Panel>,
    poisson: f64,
}

/// The coordinates of a point: for each vertex a matrix, and its share of the sphere that the faces cover as
/// seen from the point. Both sum to 1.
#[derive(Debug, Default)]
pub struct Coordinates {
    sight: Sight,
    vertices: Vec<DMat3>,
    shares: Vec<f64>,
    /// Angles of the faces.
    angles: Vec<f64>,
}

/// Number of entries of each sample for each vertex.
pub const NUMBERS: usize = 10;

impl CageBody {
    /// A body with Poisson's ratio below 0.5.
    pub fn new(cage: &Cage, poisson: f64) -> Self {
        Self { panels: Panel::all(cage), poisson }
    }

    /// Pose of the cage with these displacements of its vertices.
    pub fn pose(&self, cage: &Cage, displacements: &[DVec3]) -> MovedCage {
        MovedCage::new(cage, &self.panels, displacements)
    }

    /// Computes the coordinates of a point. Returns whether the point lies outside.
    pub fn coordinates(&self, cage: &Cage, x: DVec3, out: &mut Coordinates) -> bool {
        let skin = SKIN * cage.radius;
        let total = self.look(cage, x, out);
        let is_outside = total < 0.5;
        if is_outside || self.panels.iter().any(|p| p.distance(&out.sight).abs() < skin) {
            let (distance, within) = self.within(cage, x);
            if is_outside || distance < skin {
                self.look(cage, within, out);
            }
        }
        out.vertices.clear();
        out.vertices.resize(cage.vertices.len(), DMat3::ZERO);
        out.shares.clear();
        out.shares.resize(cage.vertices.len(), 0.0);
        for (panel, angle) in self.panels.iter().zip(&out.angles) {
            let weights = panel.weights(&out.sight, *angle, self.poisson);
            for (v, (weight, share)) in panel.corners.into_iter().zip(weights) {
                out.vertices[v] += weight;
                out.shares[v] += share;
            }
        }
        is_outside
    }

    /// Computes the angles of the faces from a point, and returns their sum.
    fn look(&self, cage: &Cage, x: DVec3, out: &mut Coordinates) -> f64 {
        out.sight.look(x, cage);
        out.angles.clear();
        out.angles.extend(self.panels.iter().map(|p| p.angle(&out.sight)));
        out.angles.iter().sum()
    }

    /// Distance of the surface, and a point just below the nearest one of the surface.
    fn within(&self, cage: &Cage, x: DVec3) -> (f64, DVec3) {
        let mut best = (f64::INFINITY, x);
        for panel in &self.panels {
            let p = panel.nearest(x, &cage.vertices);
            let distance = p.distance(x);
            if distance < best.0 {
                let centre = panel.corners.iter().map(|v| cage.vertices[*v]).sum::<DVec3>() / 3.0;
                best = (distance, p + ASIDE * (centre - p) - DEPTH * cage.radius * panel.normal);
            }
        }
        best
    }

    /// Table of coordinates: tile by tile, for each vertex rows of its matrix' nine entries, row by row,
    /// and then a row of its shares. Returned with the number of samples that lie outside.
    pub fn tabulate(
        &self,
        cage: &Cage,
        samples: &[[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<(Vec<f32>, usize)> {
        let size = NUMBERS * cage.vertices.len() * TILE;
        let mut table = vec![0.0; samples.len().div_ceil(TILE) * size];
        let outside = AtomicUsize::new(0);
        host.parallel_blocks(&mut table, size, |first, tile| {
            let first = first / size * TILE;
            // The wish to stop is looked after by the code that hands out the blocks.
            let _ = host.progress(first as f64 / samples.len() as f64);
            let mut found = Coordinates::default();
            for (i, p) in samples[first..].iter().take(TILE).enumerate() {
                let is_outside = self.coordinates(cage, DVec3::from(p.map(f64::from)), &mut found);
                outside.fetch_add(usize::from(is_outside), Ordering::Relaxed);
                let entries = found.vertices.iter().flat_map(|m| m.transpose().to_cols_array());
                let rows = tile.chunks_exact_mut(TILE);
                rows.zip(entries.chain(found.shares.iter().copied())).for_each(|(row, x)| row[i] = x as f32);
            }
        })?;
        Ok((table, outside.into_inner()))
    }
}

impl Coordinates {
    /// Image of the point with these coordinates.
    pub fn apply(&self, cage: &Cage, pose: &MovedCage, x: DVec3) -> DVec3 {
        let sum =
            self.shares.iter().zip(&pose.maps).fold(DMat3::ZERO, |sum, (share, map)| sum + *map * *share);
        let scale = self.shares.iter().zip(&pose.scales).map(|(share, scale)| share * scale).sum();
        let frame = pose.frame(sum, scale);
        let back = frame.inverse();
        let vertices = self.vertices.iter().zip(pose.vertices.iter().zip(&cage.vertices));
        let x =
            vertices.fold(x - cage.mean, |x, (w, (to, from))| x + *w * (back * *to - (*from - cage.mean)));
        pose.mean + frame * x
    }
}

/// Moves the samples of a tile; places in the tile behind the last sample are left out.
pub fn deform(cage: &Cage, pose: &MovedCage, table: &[f32], samples: &[[f32; 3]], out: &mut [[f32; 3]]) {
    Arch::new().dispatch(TileDeformation { cage, pose, table, samples, out });
}

struct TileDeformation<'a> {
    cage: &'a Cage,
    pose: &'a MovedCage,
    table: &'a [f32],
    samples: &'a [[f32; 3]],
    out: &'a mut [[f32; 3]],
}

impl WithSimd for TileDeformation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Plain loops, which the compiler makes vectors of; the same numbers come out of any.
        let Self { cage, pose, table, samples, out } = self;
        let (vertices, shares) = table.split_at(9 * TILE * pose.vertices.len());
        // There are nine entries of the map, and the scale.
        let mut maps = [[0.0; TILE]; 10];
        for (row, (map, scale)) in shares.chunks_exact(TILE).zip(pose.maps.iter().zip(&pose.scales)) {
            let entries = map.to_cols_array().into_iter().chain([*scale]);
            for (sums, entry) in maps.iter_mut().zip(entries) {
                for i in 0..TILE {
                    sums[i] += entry * f64::from(row[i]);
                }
            }
        }
        let mut frames = [DMat3::IDENTITY; TILE];
        // The inverse frame is stored row by row.
        let mut back = [[0.0; TILE]; 9];
        for i in 0..samples.len() {
            frames[i] = pose.frame(DMat3::from_cols_array(&from_fn(|k| maps[k][i])), maps[9][i]);
            let inverse = frames[i].inverse().transpose().to_cols_array();
            back.iter_mut().zip(inverse).for_each(|(row, x)| row[i] = x);
        }
        let mut moved = [[0.0; TILE]; 3];
        let pairs = pose.vertices.iter().zip(&cage.vertices);
        for (weights, (to, from)) in vertices.chunks_exact(9 * TILE).zip(pairs) {
            let from = *from - cage.mean;
            for i in 0..TILE {
                let at = |row: usize| {
                    back[3 * row][i] * to.x + back[3 * row + 1][i] * to.y + back[3 * row + 2][i] * to.z
                };
                let (x, y, z) = (at(0) - from.x, at(1) - from.y, at(2) - from.z);
                for (row, moved) in moved.iter_mut().enumerate() {
                    let w = |column: usize| f64::from(weights[(3 * row + column) * TILE + i]);
                    moved[i] += w(0) * x + w(1) * y + w(2) * z;
                }
            }
        }
        for (i, (out, p)) in out.iter_mut().zip(samples).enumerate() {
            let x =
                DVec3::from(p.map(f64::from)) - cage.mean + DVec3::new(moved[0][i], moved[1][i], moved[2][i]);
            *out = (pose.mean + frames[i] * x).as_vec3().into();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made;
    use crate::mean_value::SeenCage;
    use proptest::prelude::*;
    use simod_plugin_api::Bounds;
    use std::path::Path;

    /// A cage with dents.
    fn dented() -> Cage {
        Cage::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/cage.obj"), |p| p)
            .unwrap()
    }

    /// A cage about a bar along x.
    fn box_of_bar(detail: usize) -> Cage {
        let (min, max) = ([-1.0, -0.2, -0.2], [1.0, 0.2, 0.2]);
        made::divided_box(&Bounds { min, max }, &[min.map(|x| x as f32), max.map(|x| x as f32)], 0.05, detail)
            .unwrap()
    }

    fn displacements(cage: &Cage, map: impl Fn(DVec3) -> DVec3) -> Vec<DVec3> {
        cage.vertices.iter().map(|p| map(*p) - *p).collect()
    }

    fn bend(p: DVec3) -> DVec3 {
        let radius = 2.0 / 120_f64.to_radians();
        let (sine, cosine) = (p.x / radius).sin_cos();
        DVec3::new((radius - p.y) * sine, radius - (radius - p.y) * cosine, p.z)
    }

    fn twist(p: DVec3) -> DVec3 {
        let (sine, cosine) = (0.5 * 135_f64.to_radians() * p.x).sin_cos();
        DVec3::new(p.x, p.y * cosine - p.z * sine, p.y * sine + p.z * cosine)
    }

    /// A vertex of a side drawn out.
    fn draw(p: DVec3) -> DVec3 {
        if p.x.abs() < 0.2 && p.y > 0.0 && p.z.abs() < 0.1 { p + 0.3 * DVec3::Y } else { p }
    }

    /// Distortion of the bar by a map: the changes of volume, in the mean and as a root mean square, and
    /// the mean distance from a similarity, by the squares of the map's stretches: 0 where angles are kept.
    fn distortion(mut map: impl FnMut(DVec3) -> DVec3) -> [f64; 3] {
        const POINTS: usize = 300;
        const STEP: f64 = 1e-4;
        let mut sums = [0.0; 3];
        for i in 0..POINTS {
            let at = |k: f64| 2.0 * (i as f64 * k).fract() - 1.0;
            let x = DVec3::new(0.97 * at(0.618_034), 0.2 * at(0.754_878), 0.2 * at(0.569_840));
            let mut along = |axis: DVec3| (map(x + STEP * axis) - map(x - STEP * axis)) / (2.0 * STEP);
            let columns = [along(DVec3::X), along(DVec3::Y), along(DVec3::Z)];
            let volume = DMat3::from_cols(columns[0], columns[1], columns[2]).determinant();
            let squares: f64 = columns.iter().map(|c| c.length_squared()).sum();
            sums[0] += volume - 1.0;
            sums[1] += (volume - 1.0).powi(2);
            sums[2] += squares / 3.0 / volume.abs().powf(2.0 / 3.0) - 1.0;
        }
        let [mean, square, shape] = sums.map(|sum| sum / POINTS as f64);
        [mean, square.sqrt(), shape]
    }

    fn both(cage: &Cage, poisson: f64, map: impl Fn(DVec3) -> DVec3) -> [[f64; 3]; 2] {
        let (displacements, body) = (displacements(cage, map), CageBody::new(cage, poisson));
        let (mut view, mut weights) = (SeenCage::default(), vec![0.0; cage.vertices.len()]);
        let mean_value = distortion(|x| {
            cage.coordinates(x, &mut view, &mut weights);
            displacements.iter().zip(&weights).fold(x, |q, (d, w)| q + *w * *d)
        });
        let (pose, mut found) = (body.pose(cage, &displacements), Coordinates::default());
        let somigliana = distortion(|x| {
            body.coordinates(cage, x, &mut found);
            found.apply(cage, &pose, x)
        });
        [mean_value, somigliana]
    }

    /// Purpose of the method: `docs/methods.md` has the figures.
    #[test]
    fn volume_and_details_are_kept_better_than_by_mean_values() {
        let maps: [fn(DVec3) -> DVec3; 3] = [bend, twist, draw];
        for detail in [80, 150] {
            let cage = box_of_bar(detail);
            for (name, map) in ["bend", "twist", "draw"].into_iter().zip(maps) {
                for poisson in [-0.5, -0.25, 0.0, 0.3, 0.45] {
                    let [before, now] = both(&cage, poisson, map);
                    assert!(now[2] < 0.9 * before[2], "{detail} {name} {poisson}: {before:?} {now:?}");
                    if poisson == -0.25 {
                        assert!(now[1] < 0.9 * before[1], "{detail} {name}: {before:?} {now:?}");
                        assert!(now[0].abs() < 0.9 * before[0].abs(), "{detail} {name}: {before:?} {now:?}");
                    }
                }
            }
        }
    }

    fn coordinates_at(cage: &Cage, body: &CageBody, x: DVec3) -> Coordinates {
        let mut found = Coordinates::default();
        body.coordinates(cage, x, &mut found);
        found
    }

    /// Error in giving back the identity: of the sum of the vertices' matrices, which has to be the identity,
    /// or of that of the shares, which has to be 1.
    fn miss(found: &Coordinates) -> f64 {
        let sum = found.vertices.iter().fold(-DMat3::IDENTITY, |sum, w| sum + *w);
        let shares: f64 = found.shares.iter().sum();
        sum.to_cols_array().iter().map(|x| x.abs()).fold((shares - 1.0).abs(), f64::max)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// An affine map without tractions comes back by its displacements alone: Somigliana's identity gives
        /// any affine map back by its displacements and tractions, and these follow from the symmetric part
        /// of the map's matrix. So the map `spin ×`, whose matrix is antisymmetric, has no tractions.
        #[test]
        fn what_makes_no_traction_comes_back(
            x in prop::array::uniform3(-0.4..0.4_f64), spin in prop::array::uniform3(-1.0..1.0_f64), poisson in -0.9..0.49_f64,
        ) {
            let cage = box_of_bar(60);
            let x = DVec3::from(x) * DVec3::new(2.0, 0.4, 0.4);
            let found = coordinates_at(&cage, &CageBody::new(&cage, poisson), x);
            let spin = DVec3::from(spin);
            let sum = found.vertices.iter().zip(&cage.vertices).fold(DVec3::ZERO, |sum, (w, p)| sum + *w * spin.cross(*p));
            prop_assert!(sum.distance(spin.cross(x)) < 1e-10 && miss(&found) < 1e-10, "{x} {poisson}");
        }

        /// Points as near to a vertex, an edge or a face as can be, on both sides of it, have the right
        /// coordinates.
        #[test]
        fn the_surface_is_no_exception(
            triangle in 0..72_usize, u in 0.0..1.0_f64, v in 0.0..1.0_f64, kind in 0..3, nearness in 1.0..17.0_f64,
            toward in prop::array::uniform3(-1.0..1.0_f64), poisson in -0.9..0.49_f64,
        ) {
            let cage = dented();
            let body = CageBody::new(&cage, poisson);
            let [a, b, c] = cage.triangles[triangle].corners.map(|v| cage.vertices[v]);
            let on = match kind {
                0 => a,
                1 => a.lerp(b, u),
                _ => a.lerp(b, u).lerp(c, v),
            };
            let x = on + 10_f64.powf(-nearness) * DVec3::from(toward);
            let found = coordinates_at(&cage, &body, x);
            prop_assert!(miss(&found) < 1e-6, "{x} {}", miss(&found));
            let wave = |p: DVec3| p + 0.2 * DVec3::new((5.0 * p.y).sin(), (4.0 * p.z).cos(), (3.0 * p.x).sin());
            let pose = body.pose(&cage, &displacements(&cage, wave));
            let gap = coordinates_at(&cage, &body, on).apply(&cage, &pose, on).distance(found.apply(&cage, &pose, x));
            prop_assert!(gap < 3e-3 + 30.0 * 10_f64.powf(-nearness), "{gap} at 1e-{nearness}");
        }

        /// Samples stay finite whatever the vertices do: flat, mirrored, in one point.
        #[test]
        fn all_poses_have_finite_places(
            to in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 38),
            flat in prop::array::uniform3(prop::bool::ANY), mirrored in prop::bool::ANY, wild in 0.0..1.0_f64,
        ) {
            let cage = dented();
            let body = CageBody::new(&cage, 0.3);
            let scale = DVec3::from(flat.map(|f| if f { 0.0 } else { 1.0 })) * if mirrored { DVec3::new(-1.0, 1.0, 1.0) } else { DVec3::ONE };
            let moved: Vec<DVec3> = cage.vertices.iter().zip(&to)
                .map(|(p, to)| scale * (*p + wild * DVec3::from(*to)) - *p).collect();
            let pose = body.pose(&cage, &moved);
            for x in [DVec3::ZERO, DVec3::splat(0.1), DVec3::splat(3.0), DVec3::X * 1e6, cage.vertices[3]] {
                let y = coordinates_at(&cage, &body, x).apply(&cage, &pose, x);
                prop_assert!(y.is_finite() && y.length() < 1e3 * (1.0 + x.length()), "{x} {y}");
            }
        }
    }
}
