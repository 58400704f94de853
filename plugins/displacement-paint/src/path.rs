//! The dabs of a stroke: its path, divided by arc length.
//!
//! A dab's place depends on the path alone, not on the number of points that the user's machine recorded on
//! it. Dabs lie at 0, `step`, 2 `step`, ... and at the path's end, so that those of a path are among those
//! of a longer one: a part that is drawn already does not swim while the stroke goes on.

use glam::{BVec3, DVec3};
use simod_plugin_api::{PluginError, PluginResult, Stroke};

/// Greatest number of dabs of a stroke, which bounds the memory that it takes.
const MOST_DABS: f64 = 1e5;

/// A place on the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dab {
    /// Place of the dab, in local coordinates.
    pub at: DVec3,
    /// Pressure of the pen, 0 to 1.
    pub pressure: f64,
    /// Length of path that the dab stands for, in steps: 1, but less for the last one.
    pub share: f64,
}

/// The dabs of a stroke, `step` apart along its path.
pub fn dabs(stroke: &Stroke<'_>, step: f64) -> PluginResult<Vec<Dab>> {
    let points = stroke.points();
    let pressure = |i: usize| stroke.pressures().get(i).map_or(1.0, |&p| f64::from(p));
    let Some(&first) = points.first() else {
        return Err(PluginError::internal("a stroke without a point"));
    };
    let length: f64 = points.windows(2).map(|w| DVec3::from(w[0]).distance(w[1].into())).sum();
    if length > MOST_DABS * step {
        let error = PluginError::input(format!("a stroke has more than {MOST_DABS} dabs"));
        return Err(error.hint("give it a larger radius, or a wider `spacing`"));
    }
    let mut dabs = vec![Dab { at: first.into(), pressure: pressure(0), share: 1.0 }];
    if length == 0.0 {
        return Ok(dabs);
    }
    // Arc length up to the segment's start; the multiple of the step that comes next.
    let (mut before, mut next) = (0.0, 1_u32);
    for (i, w) in points.windows(2).enumerate() {
        let (a, b) = (DVec3::from(w[0]), DVec3::from(w[1]));
        let here = a.distance(b);
        while f64::from(next) * step <= before + here {
            let t = ((f64::from(next) * step - before) / here).clamp(0.0, 1.0);
            let pressure = pressure(i) + t * (pressure(i + 1) - pressure(i));
            dabs.push(Dab { at: a.lerp(b, t), pressure, share: 1.0 });
            next += 1;
        }
        before += here;
    }
    let rest = length - f64::from(next - 1) * step;
    // A shorter rest is nothing but rounding.
    if rest > 1e-9 * step {
        let last = points.len() - 1;
        dabs.push(Dab { at: points[last].into(), pressure: pressure(last), share: rest / step });
    }
    Ok(dabs)
}

/// Greatest number of mirror images of a dab, itself included.
pub const IMAGES: usize = 8;

/// Mirrors through planes across axes.
#[derive(Debug, Clone, Copy)]
pub struct Symmetry {
    /// Point on all planes, in local coordinates.
    pub center: DVec3,
    /// Axes across which there is a plane.
    pub axes: BVec3,
}

impl Symmetry {
    /// Images that there are: numbers whose bit `i` says whether axis `i` is mirrored.
    pub fn images(&self) -> impl Iterator<Item = usize> + use<> {
        let axes = self.axes.bitmask() as usize;
        (0..IMAGES).filter(move |image| image & !axes == 0)
    }

    /// An image of a point.
    pub fn point(&self, p: DVec3, image: usize) -> DVec3 {
        DVec3::select(mirrored(image), 2.0 * self.center - p, p)
    }

    /// An image of a vector.
    pub fn vector(&self, v: DVec3, image: usize) -> DVec3 {
        DVec3::select(mirrored(image), -v, v)
    }
}

fn mirrored(image: usize) -> BVec3 {
    BVec3::new(image & 1 != 0, image & 2 != 0, image & 4 != 0)
}

/// Sum over images, whose mirror image is the sum of the mirrored values to the last bit: mirroring an axis
/// exchanges the two sides of one level of additions.
pub fn sum<T: Copy + std::ops::Add<Output = T>>(v: [T; IMAGES]) -> T {
    ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stroke<'a>(points: &'a [[f64; 3]], pressures: &'a [f32]) -> Stroke<'a> {
        Stroke::new(1, 1.0, 1.0, points, pressures, &[])
    }

    #[test]
    fn dabs_are_evenly_spaced_and_end_where_the_path_does() {
        let path = [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.5, 0.0]];
        let dabs = dabs(&stroke(&path, &[0.0, 1.0, 0.0]), 0.4).unwrap();
        let places: Vec<DVec3> = dabs.iter().map(|d| d.at).collect();
        let expected = [[0.0, 0.0], [0.4, 0.0], [0.8, 0.0], [1.0, 0.2], [1.0, 0.5]];
        for (p, e) in places.iter().zip(expected) {
            assert!(p.distance(DVec3::new(e[0], e[1], 0.0)) < 1e-12, "{places:?}");
        }
        assert_eq!(places.len(), 5);
        assert!((dabs[2].pressure - 0.8).abs() < 1e-12 && (dabs[3].pressure - 0.6).abs() < 1e-12);
        assert!((dabs[4].share - 0.75).abs() < 1e-12, "{}", dabs[4].share);
    }

    #[test]
    fn a_longer_path_begins_with_the_same_dabs() {
        let path = [[0.0; 3], [0.3, 0.1, 0.0], [0.9, 0.4, 0.2], [1.0, 1.0, 1.0]];
        let short = dabs(&stroke(&path[..3], &[]), 0.13).unwrap();
        let long = dabs(&stroke(&path, &[]), 0.13).unwrap();
        assert_eq!(short[..short.len() - 1], long[..short.len() - 1]);
        // A click, and one with a trembling hand.
        assert_eq!(dabs(&stroke(&path[..1], &[]), 0.1).unwrap().len(), 1);
        assert_eq!(dabs(&stroke(&[[1.0; 3]; 3], &[]), 0.1).unwrap().len(), 1);
        assert_eq!(dabs(&stroke(&[[1.0; 3]; 3], &[]), 0.0).unwrap().len(), 1);
    }

    #[test]
    fn endless_strokes_are_refused() {
        let error = dabs(&stroke(&[[0.0; 3], [1e9, 0.0, 0.0]], &[]), 0.1).unwrap_err();
        assert!(!error.hint.is_empty());
    }
}
