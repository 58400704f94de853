//! Samples of clouds on the surface. A mean of vertices lies on the inner side of a surface that bends: P_S
//! is the surface, smoothed. One step of deconvolution undoes that (P. van Cittert, *Zum Einfluß der
//! Spaltbreite auf die Intensitätsverteilung in Spektrallinien II*, 1931): each sample moves across the
//! surface by a part of its height over its neighbours.

use glam::Vec3;
use rayon::prelude::*;
use simod_model::long_list::ListStorage;

use super::heights::{Height, RING, heights};
use super::kd_tree::KdTree;
use super::neighbour_graph::NeighbourGraph;
use super::normals::NEIGHBOURS;

/// Part of its height over its neighbours by which the mean of a cell is off the surface: the mean squared
/// distance from the middle of a hexagonal cell, as a part of that of its neighbours. At 7/18 the triangles
/// between samples would be nearest to the vertices, but samples that carry deformations are to be on the
/// surface.
const STEP: f64 = 5.0 / 36.0;

/// Number of neighbours of two sheets by themselves that does not come about by chance.
const FEW_OF_TWO: usize = 3;

/// Number of standard errors below which heights are noise: clusters of noisy vertices are split across the
/// surface as well, so that their means scatter more than their vertices tell.
const STANDARD_ERRORS: f64 = 6.0;

/// Samples on the surface, and the neighbours and directions that were found on the way.
pub struct Deconvolved {
    /// Positions of the samples on the surface, in local coordinates.
    pub positions: Vec<Vec3>,
    /// The [`NEIGHBOURS`] of each sample at its former position.
    pub graph: NeighbourGraph,
    /// Direction of least variance of each sample with its neighbours; of unit length.
    pub across: Vec<Vec3>,
}

/// Samples at means of clusters, taken to the surface; `None` if none can move. `variances` are those of the
/// means across their clusters' planes, as far as the vertices tell; a sample of which this is not known
/// (infinite) stays, and none moves farther than `most`.
///
/// Samples on a plane do not move, nor those whose neighbours are all on one side, are no surface or two of
/// them, nor those whose heights are explained by the scatter of the vertices.
///
/// Memory: 72 bytes per sample, 32 more meanwhile, and the samples' tree.
pub fn deconvolved(
    positions: &[Vec3],
    variances: &[f32],
    most: impl Fn(usize) -> f32 + Sync,
) -> Option<Deconvolved> {
    if positions.len() <= RING || !variances.iter().any(|variance| variance.is_finite()) {
        return None;
    }
    let graph = NeighbourGraph::of_points(&KdTree::new(positions), NEIGHBOURS, &ListStorage::Memory);
    let heights = heights(positions, &graph);
    let moved = |i: usize| {
        let is_of_two = |j: &&u32| heights[**j as usize].is_of_two;
        // Most samples know that they are of two sheets, where there are two.
        let beside = graph.nearest_to(i).iter().filter(is_of_two).count();
        if !variances[i].is_finite() || heights[i].variance == 0.0 || beside >= FEW_OF_TWO {
            return positions[i];
        }
        let Height { across, height, .. } = heights[i];
        let part = STEP * significance(&heights, variances, i, graph.nearest_to(i));
        let way = (across.as_dvec3() * (part * height)).clamp_length_max(f64::from(most(i)));
        (positions[i].as_dvec3() + way).as_vec3()
    };
    let moved = (0..positions.len()).into_par_iter().map(moved).collect();
    let across = heights.iter().map(|height| height.across).collect();
    Some(Deconvolved { positions: moved, graph, across })
}

/// Part of the heights of a sample and its neighbours that is no noise: zero, where they are no more than
/// [`STANDARD_ERRORS`] times the noise.
fn significance(heights: &[Height], variances: &[f32], i: usize, neighbours: &[u32]) -> f64 {
    let (mut squares, mut noise) = (0.0, 0.0);
    for j in neighbours.iter().map(|j| *j as usize).chain([i]) {
        let variance = f64::from(variances[j]);
        if variance.is_finite() {
            squares += heights[j].height * heights[j].height;
            noise += heights[j].variance * variance;
        }
    }
    let noise = STANDARD_ERRORS * STANDARD_ERRORS * noise;
    if squares > noise { 1.0 - noise / squares } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::random::mix;

    /// A number from -0.5 to 0.5.
    fn random(i: usize, axis: u64) -> f32 {
        (mix(i as u64, axis) >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    }

    const SIDE: usize = 60;

    /// A grid of places one apart, moved about in their plane a little, at these heights.
    fn sheet(height: impl Fn(f32, f32, usize) -> f32) -> Vec<Vec3> {
        let place =
            |i: usize| ((i % SIDE) as f32 + 0.4 * random(i, 1), (i / SIDE) as f32 + 0.4 * random(i, 2));
        let at = |i: usize| Vec3::new(place(i).0, place(i).1, height(place(i).0, place(i).1, i));
        (0..SIDE * SIDE).map(at).collect()
    }

    fn rms(values: impl Iterator<Item = f32>) -> f32 {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
        (sum / count as f32).sqrt()
    }

    fn held(positions: &[Vec3], variance: f32, most: f32) -> Vec<Vec3> {
        let moved = deconvolved(positions, &vec![variance; positions.len()], |_| most);
        moved.map_or_else(|| positions.to_vec(), |moved| moved.positions)
    }

    fn moved(positions: &[Vec3], variance: f32) -> Vec<Vec3> {
        held(positions, variance, f32::INFINITY)
    }

    #[test]
    fn means_of_a_sphere_come_to_its_radius() {
        const SAMPLES: usize = 4000;
        let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
        let direction = |i: usize| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / SAMPLES as f32;
            let (s, c) = (golden * i as f32).sin_cos();
            Vec3::new(c * (1.0 - z * z).sqrt(), s * (1.0 - z * z).sqrt(), z)
        };
        // Distance of the mean of a cell of this area below the surface: half of its mean squared distance.
        let below = 0.5 * 4.0 * std::f32::consts::PI / SAMPLES as f32 / (2.0 * std::f32::consts::PI);
        let means: Vec<Vec3> = (0..SAMPLES).map(|i| direction(i) * (1.0 - below)).collect();
        let off = rms(moved(&means, 0.0).into_iter().map(|p| p.length() - 1.0));
        assert!(off < 0.2 * below, "{off} of {below}");
        // Samples move no farther than they may.
        let held = held(&means, 0.0, 0.25 * below);
        assert!(held.iter().zip(&means).all(|(p, q)| p.distance(*q) < 0.26 * below));
    }

    #[test]
    fn nothing_moves_on_a_plane_or_by_noise() {
        let plane = sheet(|x, y, _| 0.3 * x - 0.2 * y);
        let off = plane.iter().zip(moved(&plane, 0.0)).map(|(p, q)| p.distance(q)).fold(0.0, f32::max);
        assert!(off < 1e-5, "{off}");
        // Of means of ten vertices each.
        let noisy = sheet(|_, _, i| 0.1 * random(i, 3));
        assert_eq!(moved(&noisy, 0.01 / 12.0), noisy);
        assert!(moved(&noisy, 0.0) != noisy);
        // Heights that stand out of noise are taken off all the same.
        let bowl = sheet(|x, y, _| 0.01 * (x * x + y * y));
        let (all, part) = (moved(&bowl, 0.0), moved(&bowl, 1e-8));
        let is_much = |((p, q), all): ((&Vec3, &Vec3), &Vec3)| p.distance(*q) >= 0.9 * p.distance(*all);
        assert!(bowl.iter().zip(&part).zip(&all).all(is_much) && part != all);
    }

    #[test]
    fn a_bowl_moves_to_its_outer_side_up_to_its_border() {
        let bowl = sheet(|x, y, _| 0.01 * (x * x + y * y));
        let moved = moved(&bowl, 0.0);
        for (i, (p, q)) in bowl.iter().zip(&moved).enumerate() {
            let (column, row) = (i % SIDE, i / SIDE);
            let from_border = column.min(row).min(SIDE - 1 - column).min(SIDE - 1 - row);
            // Height as a part of 5/36 of κh²/2, though places are about one apart, and the bowl is steep.
            let outwards = Vec3::new(0.02 * p.x, 0.02 * p.y, -1.0).normalize_or(Vec3::Z);
            let part = (*q - *p).dot(outwards) / (0.01 * STEP as f32);
            // The plane through neighbours that are all on one side tells less.
            let expected = if from_border == 0 { -1e-3..4.0 } else { 0.3..1.8 };
            assert!(expected.contains(&part), "{i}: {part}");
        }
    }

    /// Places of one of two sheets that bend alike stand out of those of the other by their distance.
    #[test]
    fn sheets_that_lie_one_above_the_other_stay_apart() {
        for gap in [0.1, 0.2, 0.4] {
            let above = |i: usize| if random(i, 4) > 0.0 { gap } else { 0.0 };
            let sheets = sheet(|x, y, i| 1e-3 * (x * x + y * y) + above(i));
            let off = sheets.iter().zip(moved(&sheets, 0.0)).map(|(p, q)| p.distance(q));
            let off: Vec<f32> = off.collect();
            let far = off.iter().filter(|off| **off > 0.02 * gap).count();
            assert!(far * 50 < sheets.len(), "{gap}: {far} moved by more than a fiftieth of it");
        }
    }

    #[test]
    fn what_tells_nothing_stays() {
        // A ball, places that all are one, and too few places are no surface.
        let ball: Vec<Vec3> = (0..500).map(|i| Vec3::from([1, 2, 3].map(|axis| random(i, axis)))).collect();
        let same = ball.iter().zip(moved(&ball, 0.0)).filter(|(p, q)| **p == *q).count();
        assert!(same > 400, "{same}");
        assert_eq!(moved(&[Vec3::ONE; 40], 0.0), [Vec3::ONE; 40]);
        assert_eq!(moved(&ball[..5], 0.0), &ball[..5]);
        let bowl = sheet(|x, y, _| 0.01 * (x * x + y * y));
        assert_eq!(moved(&bowl, f32::INFINITY), bowl);
    }
}
