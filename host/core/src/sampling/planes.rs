//! The plane of the surface at each element of a cell, as the elements around it show: what stands for a cluster is the
//! minimiser of its elements' planes ([`cluster`](super::cluster)), and not all models bring normals that are those of
//! their planes. Some have none, and those of simplified, sculpted or baked models are of a smoother surface than theirs.
//!
//! A plane is that of least squares through what lies in a small ball, with weights that fall to zero at its rim
//! (H. Hoppe et al., *Surface Reconstruction from Unorganized Points*, 1992). The ball's radius follows from the spacing
//! of the elements; those whose normals face away are of another sheet, and left out.

use glam::{DMat3, DVec3, Vec3, Vec3A, Vec3Swizzles};

use super::cluster::Element;
use crate::geometry::symmetric_eigen;

/// Elements that are looked at with one radius.
const BLOCK: usize = 4096;

/// Elements by which it is told whether the normals of a cell are those of its planes, and among how many of the others their
/// neighbours are looked for.
const TRIED: usize = 3;
const AMONG: usize = 512;

/// Elements at which the spacing is measured: the median of their distances to the sixth place around, as many as a
/// vertex of a triangle mesh has.
const PROBES: usize = 5;
const AROUND: usize = 6;

/// Nearest elements among which these places are looked for: several may be at one.
const NEAREST: usize = 24;

/// The ball's radius over that distance.
const RADIUS: f32 = 1.4;

/// Most voxels, of the ball's radius, along an axis.
const MOST_VOXELS: f32 = (1 << 20) as f32;

/// No plane: where the thickness is more than this part of the lesser width (as variances) …
const THICK: f64 = 0.25;
/// … or that width is less than this part of the greater one: all on a line.
const NARROW: f64 = 0.01;

/// Normals are those of the planes if elements are off the planes across them by no more than so many times as much as off
/// their own planes (as variances), …
const FITS: f64 = 2.0;
/// … beyond what an angle of one and a half degrees makes.
const SMALL_ANGLE: f64 = 7e-4;

/// Memory for [`planes`], used again from cell to cell.
///
/// 60 bytes per element.
#[derive(Default)]
pub struct Workspace {
    order: Vec<u32>,
    voxels: Vec<(u64, u32)>,
    points: Vec<Point>,
    distances: Vec<f32>,
    planes: Vec<Vec3>,
}

/// An element, in the order of the voxels.
#[derive(Clone, Copy)]
struct Point {
    position: Vec3A,
    normal: Vec3A,
}

/// The unit normals of the planes of some elements, of either sign, and zero where nothing tells them; `None` if their own
/// normals are those of their planes, or as good.
pub fn planes<'a, E: Element>(elements: &[E], workspace: &'a mut Workspace) -> Option<&'a [Vec3]> {
    let Workspace { order, voxels, points, distances, planes } = workspace;
    let count = u32::try_from(elements.len()).ok()?;
    order.clear();
    order.extend(0..count);
    let mut space = Space { voxels, points, distances };

    let known = elements.iter().filter(|e| e.normal() != Vec3::ZERO).count();
    if 2 * known > elements.len() {
        if space.fit(elements, compact(elements, order)) {
            return None;
        }
        order.sort_unstable();
    }
    planes.clear();
    planes.resize(elements.len(), Vec3::ZERO);
    blocks(elements, order, &mut |block| {
        space.visit(elements, block, |e, around| {
            planes[e as usize] = around.spread().map_or(Vec3::ZERO, |spread| spread.normal);
        });
    });
    Some(planes)
}

/// Some of the elements that lie together: [`AMONG`] at least, or all, and at most twice as many.
fn compact<'o, E: Element>(elements: &[E], order: &'o mut [u32]) -> &'o [u32] {
    let mut part = order;
    while part.len() > 2 * AMONG {
        part = halves(elements, part).0;
    }
    part
}

/// Parts the elements into blocks that lie together.
fn blocks<E: Element>(elements: &[E], order: &mut [u32], visit: &mut impl FnMut(&[u32])) {
    if order.len() <= BLOCK {
        return visit(order);
    }
    let (low, high) = halves(elements, order);
    blocks(elements, low, visit);
    blocks(elements, high, visit);
}

/// Two halves, along the longest axis.
fn halves<'o, E: Element>(elements: &[E], order: &'o mut [u32]) -> (&'o mut [u32], &'o mut [u32]) {
    let (min, max) = bounds(elements, order);
    let extent = max - min;
    let axis = (0..3).fold(0, |a, b| if extent[b] > extent[a] { b } else { a });
    let place = |e: &u32| elements[*e as usize].position()[axis];
    let middle = order.len() / 2;
    // Elements in one place are told apart by their index, so that the halves do not depend on how they are found.
    order.select_nth_unstable_by(middle, |a, b| place(a).total_cmp(&place(b)).then(a.cmp(b)));
    order.split_at_mut(middle)
}

fn bounds<E: Element>(elements: &[E], order: &[u32]) -> (Vec3, Vec3) {
    let all = order.iter().map(|e| elements[*e as usize].position());
    all.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), p| (min.min(p), max.max(p)))
}

/// The weighted sums over what is around an element, relative to it.
#[derive(Default)]
struct Around {
    weight: f32,
    position: Vec3A,
    outer: [Vec3A; 2],
}

/// How what is around an element lies.
struct Spread {
    covariance: DMat3,
    /// Ascending.
    variances: DVec3,
    /// Across the plane.
    normal: Vec3,
}

impl Around {
    /// Takes in what is at `d`, if it is in the ball, of a squared radius of 1 / `scale`, and on the same sheet.
    #[inline(always)]
    fn add(&mut self, d: Vec3A, scale: f32, normal: Vec3A, own: Vec3A) {
        let weight = 1.0 - d.length_squared() * scale;
        if weight > 0.0 && normal.dot(own) >= 0.0 {
            let weighted = d * weight;
            self.weight += weight;
            self.position += weighted;
            self.outer[0] += d * weighted;
            self.outer[1] += weighted * d.yzx();
        }
    }

    /// `None` where it is no surface.
    fn spread(&self) -> Option<Spread> {
        let [mean, diagonal, off] =
            [self.position, self.outer[0], self.outer[1]].map(|sum| sum.as_dvec3() / f64::from(self.weight));
        let (d, o) = (diagonal - mean * mean, off - mean * mean.yzx());
        let covariance = DMat3::from_cols_array(&[d.x, o.x, o.z, o.x, d.y, o.y, o.z, o.y, d.z]);
        if !(covariance.is_finite() && d.element_sum() > 0.0) {
            return None;
        }
        let (variances, vectors) = symmetric_eigen(covariance);
        let is_surface = variances.x <= THICK * variances.y && variances.y > NARROW * variances.z;
        is_surface.then(|| Spread { covariance, variances, normal: vectors.x_axis.as_vec3() })
    }
}

/// What it takes to find neighbours.
struct Space<'a> {
    voxels: &'a mut Vec<(u64, u32)>,
    points: &'a mut Vec<Point>,
    distances: &'a mut Vec<f32>,
}

impl Space<'_> {
    /// Calls `visit` with each element of a block, and what is around it.
    fn visit<E: Element>(&mut self, elements: &[E], block: &[u32], mut visit: impl FnMut(u32, &Around)) {
        let (min, max) = bounds(elements, block);
        let radius = self.radius(elements, block).max((max - min).max_element() / MOST_VOXELS);
        if !(radius > 0.0 && radius.is_finite()) {
            return;
        }
        // One row of voxels after the other, with an empty one around all.
        let count = ((max - min) / radius).as_u64vec3() + 3;
        let (row, layer) = (count.x, count.x * count.y);
        let Self { voxels, points, .. } = self;
        voxels.clear();
        voxels.extend(block.iter().map(|e| {
            let at = ((elements[*e as usize].position() - min) / radius).as_u64vec3() + 1;
            (at.x + at.y * row + at.z * layer, *e)
        }));
        voxels.sort_unstable();
        points.clear();
        points.extend(voxels.iter().map(|(_, e)| {
            let element = &elements[*e as usize];
            Point { position: element.position().into(), normal: element.normal().into() }
        }));

        // Of each row around a voxel, the three voxels that meet it follow each other, and move on as it does.
        let rows: [u64; 9] = std::array::from_fn(|i| (i / 3) as u64 * layer + (i % 3) as u64 * row);
        let behind = layer + row;
        let mut ranges = [(0usize, 0usize); 9];
        let scale = 1.0 / (radius * radius);
        let mut first = 0;
        while let Some((voxel, _)) = voxels.get(first) {
            let end = first + voxels[first..].iter().take_while(|(v, _)| v == voxel).count();
            for (range, offset) in ranges.iter_mut().zip(rows) {
                // The row's own place is that of the voxel, less one layer and row.
                let middle = voxel + offset;
                while voxels.get(range.0).is_some_and(|(v, _)| v + behind + 1 < middle) {
                    range.0 += 1;
                }
                range.1 = range.1.max(range.0);
                while voxels.get(range.1).is_some_and(|(v, _)| v + behind <= middle + 1) {
                    range.1 += 1;
                }
            }
            for at in first..end {
                let Point { position, normal } = points[at];
                let mut around = Around::default();
                for point in ranges.iter().flat_map(|(from, to)| &points[*from..*to]) {
                    around.add(point.position - position, scale, point.normal, normal);
                }
                visit(voxels[at].1, &around);
            }
            first = end;
        }
    }

    /// Whether the normals of a few of the elements of a block are those of their planes.
    fn fit<E: Element>(&mut self, elements: &[E], block: &[u32]) -> bool {
        let (mut across, mut off, mut width) = (0.0, 0.0, 0.0);
        for tried in 0..TRIED {
            let middle = &elements[block[(2 * tried + 1) * block.len() / (2 * TRIED)] as usize];
            let (position, normal) = (Vec3A::from(middle.position()), Vec3A::from(middle.normal()));
            let radius = RADIUS * self.distance_around(elements, block, middle.position());
            let (mut around, scale) = (Around::default(), 1.0 / (radius * radius));
            for e in block.iter().map(|e| &elements[*e as usize]) {
                around.add(Vec3A::from(e.position()) - position, scale, e.normal().into(), normal);
            }
            if let Some(spread) = around.spread()
                && middle.normal() != Vec3::ZERO
            {
                let n = middle.normal().as_dvec3();
                across += n.dot(spread.covariance * n);
                off += spread.variances.x;
                width += spread.variances.z;
            }
        }
        across <= FITS * off + SMALL_ANGLE * width
    }

    /// The radius of the ball for a block.
    fn radius<E: Element>(&mut self, elements: &[E], block: &[u32]) -> f32 {
        let mut found = [0.0f32; PROBES];
        for (probe, found) in found.iter_mut().enumerate() {
            let p = elements[block[probe * block.len() / PROBES] as usize].position();
            *found = self.distance_around(elements, block, p);
        }
        found.sort_unstable_by(f32::total_cmp);
        RADIUS * found[PROBES / 2]
    }

    /// How far the last of the [`AROUND`] places around an element is; zero if there is no other.
    fn distance_around<E: Element>(&mut self, elements: &[E], block: &[u32], p: Vec3) -> f32 {
        let distances = &mut *self.distances;
        distances.clear();
        distances.extend(block.iter().map(|e| elements[*e as usize].position().distance_squared(p)));
        if distances.len() > NEAREST {
            distances.select_nth_unstable_by(NEAREST, f32::total_cmp);
            distances.truncate(NEAREST);
        }
        distances.sort_unstable_by(f32::total_cmp);
        // Copies of a vertex are at one distance; what is at another is in another place.
        distances.dedup();
        let others = distances.iter().filter(|d| **d > 0.0);
        others.take(AROUND).last().map_or(0.0, |d| d.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::cluster::Sample;

    /// A wavy sheet of elements, each at several places of the list, and its own normals or those that `given` says.
    fn sheet(given: impl Fn(Vec3) -> Vec3) -> (Vec<Sample>, Vec<Vec3>) {
        let place = |i: u32| (i as f32 + 0.3 * (i as f32 * 1.7).sin()) / 60.0;
        let at = |i: u32| {
            let (x, z) = (place(i % 60), place(i / 60));
            let normal = Vec3::new(-0.3 * (20.0 * x).cos(), 1.0, 0.0).normalize_or(Vec3::Y);
            (Vec3::new(x, 0.015 * (20.0 * x).sin(), z), normal)
        };
        let sample = |i: u32| {
            let (position, normal) = at(i / 2);
            Sample { position, normal: given(normal), index: i }
        };
        ((0..7200).map(sample).collect(), (0..7200).map(|i| at(i / 2).1).collect())
    }

    #[test]
    fn normals_that_fit_are_kept_and_those_of_a_smoother_surface_are_not() {
        let mut workspace = Workspace::default();
        assert!(planes(&sheet(|n| n).0, &mut workspace).is_none());
        for given in [Vec3::ZERO, Vec3::Y] {
            let (samples, normals) = sheet(|_| given);
            let planes = planes(&samples, &mut workspace).expect("planes");
            let off = |(p, n): (&Vec3, &Vec3)| p.dot(*n).abs().min(1.0).acos().to_degrees();
            let mut angles: Vec<f32> = planes.iter().zip(&normals).map(off).collect();
            angles.sort_unstable_by(f32::total_cmp);
            // The slope changes by a degree from one element to the next.
            assert!(angles[3600] < 1.0 && angles[7000] < 6.0, "{} {}", angles[3600], angles[7000]);
        }
    }

    #[test]
    fn the_other_side_of_a_thin_plate_is_not_seen_where_normals_tell() {
        let side = |up: f32| {
            let at = move |i: u32| Vec3::new((i % 30) as f32, 0.4 * up, (i / 30) as f32 + 0.2 * up) / 30.0;
            // Normals that are off by thirty degrees, so that planes are looked for.
            let normal = Vec3::new(0.5, 0.8 * up, 0.0).normalize_or(Vec3::Y);
            (0..900).map(move |i| Sample { position: at(i), normal, index: 0 })
        };
        let plate: Vec<Sample> = side(1.0).chain(side(-1.0)).collect();
        let planes = planes(&plate, &mut Workspace::default()).expect("planes").to_vec();
        assert!(planes.iter().filter(|n| n.y.abs() > 0.999).count() > 1700);
    }

    #[test]
    fn what_is_no_surface_has_no_planes() {
        let mut workspace = Workspace::default();
        let sample = |position: Vec3| Sample { position, normal: Vec3::ZERO, index: 0 };
        let line: Vec<_> = (0..500).map(|i| sample(Vec3::new(i as f32, 0.0, 0.0))).collect();
        let point = vec![sample(Vec3::ONE); 300];
        for samples in [line, point, vec![sample(Vec3::ONE)]] {
            let planes = planes(&samples, &mut workspace).expect("no normals");
            assert!(planes.len() == samples.len() && planes.iter().all(|n| *n == Vec3::ZERO));
        }
    }
}
