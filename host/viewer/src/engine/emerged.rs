//! Samples of a model that is being opened, as they come: for the eye alone. Before the first of them there
//! are vertices from places spread over the file, each of which gives way to the samples around it.

use glam::{DMat3, DVec3, Vec3};
use simod_core::geometry::symmetric_eigen;
use simod_core::sampling::SampleSet;
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::progress::{Emerging, Glimpse};
use std::time::{Duration, Instant};

/// Most samples that are kept, of 28 bytes each; beyond that, every second one is dropped.
const MOST: usize = 1 << 20;

/// Most vertices before the first sample, of 28 bytes each, and the longest time that reading them may
/// take.
const VERTICES: u64 = 1 << 14;
const PATIENCE: Duration = Duration::from_millis(250);

/// Number of vertices below which a model is sampled so quickly that no vertices are shown before.
const LARGE: u64 = 1 << 20;

/// Points of the surface; all lists have one entry for each. Local coordinates.
#[derive(Debug, Clone, Default)]
pub struct SurfacePoints {
    /// The points' positions.
    pub positions: Vec<Vec3>,
    /// Unit normals; zero where unknown.
    pub normals: Vec<Vec3>,
    /// Approximate distance of each point from those next to it.
    pub spacing: Vec<f32>,
}

/// Visible part of a model that is being sampled: samples of complete cells, and vertices elsewhere.
#[derive(Debug, Default)]
pub struct Emerged {
    /// Smallest and largest coordinates of the whole model, or of its visible part; local.
    pub bounds: [DVec3; 2],
    /// Number of changes so far.
    pub changes: u64,
    /// Samples of the cells that are complete.
    samples: SurfacePoints,
    /// Vertices where there are no samples yet, and their coordinates.
    vertices: SurfacePoints,
    frame: Option<Frame>,
    /// Stride of the kept samples: one of so many is kept.
    every: usize,
}

impl SurfacePoints {
    /// Converts positions from the local coordinates of a frame to those of another one.
    fn go_over(&mut self, from: &Frame, to: &Frame) {
        self.positions.iter_mut().for_each(|p| *p = to.to_local(from.to_model(*p)));
        let scale = (from.scale / to.scale) as f32;
        self.spacing.iter_mut().for_each(|spacing| *spacing *= scale);
    }

    fn retain(&mut self, keeps: impl Fn(Vec3) -> bool) {
        let kept: Vec<bool> = self.positions.iter().map(|p| keeps(*p)).collect();
        retain(&mut self.positions, &kept);
        retain(&mut self.normals, &kept);
        retain(&mut self.spacing, &kept);
    }
}

fn retain<T>(list: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    list.retain(|_| kept.next().copied().unwrap_or(true));
}

impl Emerged {
    /// Vertices from places spread over the file, as many as can be read in little time; nothing of a model
    /// that is sampled as quickly, or where `cancelled` says so.
    pub(super) fn glimpse(model: &mut Glimpse<'_>, cancelled: impl Fn() -> bool) -> Option<Self> {
        if model.vertices < LARGE {
            return None;
        }
        let until = Instant::now() + PATIENCE;
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for i in 0..VERTICES {
            if Instant::now() > until || cancelled() {
                break;
            }
            // Wherever the reading ends, the vertices read so far are spread evenly.
            let number = (u128::from(model.vertices) * u128::from(i.reverse_bits())) >> 64;
            if let Ok(Some((position, normal))) = model.vertex(number as u64)
                && position.is_finite()
            {
                positions.push(position);
                normals.push(normal.try_normalize().unwrap_or(Vec3::ZERO));
            }
        }
        let bounds = Bounds::from_points(positions.iter().copied());
        let frame = Frame::from_bounds(&bounds);
        let local = positions.iter().map(|p| frame.to_local(*p)).collect();
        let set = SampleSet::new(local, normals).ok()?;
        let spacing = set.spacing().to_vec();
        let vertices = SurfacePoints { normals: set.normals().to_vec(), spacing, positions: set.positions };
        let bounds = [bounds.min, bounds.max].map(|corner| frame.to_local_exact(corner));
        Some(Self { bounds, changes: 1, vertices, frame: Some(frame), every: 1, ..Self::default() })
    }

    /// Samples that are kept.
    pub fn samples(&self) -> &SurfacePoints {
        &self.samples
    }

    /// Vertices where there are no samples yet.
    pub fn vertices(&self) -> &SurfacePoints {
        &self.vertices
    }

    /// Takes in the samples of a cell.
    pub(super) fn add(&mut self, cell: &Emerging<'_>) {
        self.changes += 1;
        if cell.first {
            let Emerging { bounds, frame, .. } = cell;
            self.bounds = [bounds.min, bounds.max].map(|corner| frame.to_local_exact(corner));
            if let Some(former) = self.frame.replace(**frame) {
                self.vertices.go_over(&former, frame);
            }
            (self.samples, self.every) = (SurfacePoints::default(), 1);
        }
        let samples = &mut self.samples;
        let (first, mut all) = (samples.positions.len(), 0);
        cell.for_each(|position, normal| {
            if all % self.every == 0 {
                samples.positions.push(position);
                samples.normals.push(normal);
            }
            all += 1;
        });
        let new = &samples.positions[first..];
        let Some(plane) = PlaneFit::fit(new) else { return };
        samples.spacing.resize(samples.positions.len(), plane.spacing);
        let low = new.iter().copied().fold(Vec3::INFINITY, Vec3::min) - plane.spacing;
        let high = new.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max) + plane.spacing;
        self.vertices.retain(|p| !(p.cmpge(low).all() && p.cmple(high).all()));
        let outward = plane.normal * plane.normal.dot(plane.middle).signum();
        samples.normals[first..].iter_mut().filter(|n| **n == Vec3::ZERO).for_each(|n| *n = outward);
        if samples.positions.len() > MOST {
            self.every *= 2;
            halve(&mut samples.positions);
            halve(&mut samples.normals);
            halve(&mut samples.spacing);
            samples.spacing.iter_mut().for_each(|s| *s *= std::f32::consts::SQRT_2);
        }
    }
}

/// The plane through some points.
struct PlaneFit {
    middle: Vec3,
    normal: Vec3,
    /// Spacing of the points, if they are spread evenly over the plane.
    spacing: f32,
}

impl PlaneFit {
    /// Fits the plane by the points' principal components; nothing where there is no point.
    fn fit(points: &[Vec3]) -> Option<Self> {
        let n = points.len() as f64;
        let middle = points.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n;
        let mut covariance = DMat3::ZERO;
        for d in points.iter().map(|p| p.as_dvec3() - middle) {
            covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (1.0 / n);
        }
        let (variances, axes) = symmetric_eigen(covariance);
        // Of a rectangle that is evenly covered, the variance is a twelfth of the square of its side.
        let area = 12.0 * (variances.y.max(0.0) * variances.z.max(0.0)).sqrt();
        let spacing = (area / n).sqrt() as f32;
        (!points.is_empty()).then(|| Self {
            middle: middle.as_vec3(),
            normal: axes.x_axis.as_vec3(),
            spacing,
        })
    }
}

/// Keeps every second entry of a list.
fn halve<T>(list: &mut Vec<T>) {
    let mut i = 0;
    list.retain(|_| {
        i += 1;
        i % 2 == 1
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::Result;

    #[test]
    fn points_of_a_rectangle_tell_its_plane_and_their_spacing() {
        let spacing = 0.01;
        let tilt = glam::Quat::from_rotation_x(0.7);
        let point = |i: u32| tilt * Vec3::new(spacing * (i % 40) as f32, spacing * (i / 40) as f32, 0.5);
        let points: Vec<Vec3> = (0..1600).map(point).collect();
        let plane = PlaneFit::fit(&points).unwrap();
        assert!(plane.normal.dot(tilt * Vec3::Z).abs() > 0.9999);
        assert!((plane.spacing / spacing - 1.0).abs() < 0.01, "{}", plane.spacing);
        let alone = PlaneFit::fit(&points[..1]).unwrap();
        assert!(alone.spacing == 0.0 && alone.middle == points[0]);
        assert!(PlaneFit::fit(&[]).is_none());
    }

    #[test]
    fn vertices_are_seen_until_there_are_samples() {
        // A plate of a million vertices, far from the zero, of which some are nowhere.
        let side = 1100;
        let at = |number: u64| DVec3::new((number % side) as f64, (number / side) as f64, 3e6);
        let mut read = |number: u64| {
            let nowhere = number.is_multiple_of(5);
            Ok(Some((if nowhere { DVec3::NAN } else { at(number) }, Vec3::ZERO)))
        };
        let mut emerged = Emerged::glimpse(&mut Glimpse::new(side * side, &mut read), || false).unwrap();
        let seen = emerged.vertices();
        let count = seen.positions.len();
        assert!(count > 1000 && seen.normals.len() == count && seen.spacing.len() == count);
        assert!(seen.normals.iter().all(|n| n.z.abs() > 0.999));
        // Each quarter of the plate has about as many vertices, however long there was time.
        let quarter = |p: &&Vec3| p.x < 0.0 && p.y < 0.0;
        let part = seen.positions.iter().filter(quarter).count() as f64 / count as f64;
        assert!((part - 0.25).abs() < 0.02, "{part}");

        // Samples come of the left half, in coordinates of their own.
        let bounds = Bounds { min: at(0) - 500.0, max: at(side * side - 1) + 500.0 };
        let frame = Frame::from_bounds(&bounds);
        let local = |x: u64, y: u64| frame.to_local(at(x + side * y));
        let visit = |visit: &mut dyn FnMut(Vec3, Vec3)| {
            (0..10_000).for_each(|i| visit(local(i % 50 * 11, i / 50 * 11 / 2), Vec3::ZERO));
        };
        emerged.add(&Emerging::new(true, &bounds, &frame, &visit));
        let vertices = &emerged.vertices.positions;
        assert!(vertices.iter().all(|p| p.x > local(539, 0).x));
        assert!((vertices.len() as f64 / count as f64 - 0.5).abs() < 0.05);
        assert_eq!(emerged.samples().positions.len(), 10_000);
        let right = local(side - 1, 0).x;
        let (low, high) = vertices.iter().fold((right, 0.0_f32), |(a, b), p| (a.min(p.x), b.max(p.x)));
        assert!(low < local(600, 0).x && (high - right).abs() < 0.02, "{low} {high} {right}");
    }

    #[test]
    fn of_small_models_nothing_is_read() {
        let mut read = |_: u64| -> Result<Option<(DVec3, Vec3)>> { panic!("it is read") };
        assert!(Emerged::glimpse(&mut Glimpse::new(1000, &mut read), || false).is_none());
        assert!(Emerged::glimpse(&mut Glimpse::new(1 << 40, &mut read), || true).is_none());
    }

    #[test]
    fn of_too_many_each_second_one_is_left() {
        let mut list: Vec<u32> = (0..7).collect();
        halve(&mut list);
        assert_eq!(list, [0, 2, 4, 6]);
    }
}
