//! Versions of a model beside each other, vertex by vertex, in one streaming reading of all of them.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;
use simod_model::bounds::Bounds;
use simod_model::histogram::Histogram;
use simod_model::{Model, Progress, Result, Vertices, in_step};

/// How far the vertices of two versions of a model are from each other. Lengths are fractions of a diagonal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// Vertices compared: those with a finite position in both.
    pub vertices: u64,
    /// Root of the mean square.
    pub rms: f64,
    /// 99 of 100 vertices are nearer (to 2 %).
    pub p99: f64,
    /// The farthest.
    pub max: f64,
    /// The angle between the normals; nothing where the model has none.
    pub normals: Option<Angles>,
}

/// Angles between normals, in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Angles {
    /// Root of the mean square.
    pub rms: f64,
    /// The greatest.
    pub max: f64,
}

/// Versions of a model beside each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Beside {
    /// Of the finite positions of each version.
    pub bounds: Vec<Bounds>,
    /// Each pair of versions: (0, 1), (0, 2), …, (1, 2), …
    pub differences: Vec<((usize, usize), Difference)>,
}

/// What is known of a pair so far.
struct Pair {
    of: (usize, usize),
    histogram: Histogram,
    vertices: u64,
    squares: f64,
    max: f64,
    normals: u64,
    angle_squares: f64,
    angle_max: f64,
}

impl Pair {
    fn new(of: (usize, usize)) -> Self {
        let histogram = Histogram::default();
        Self {
            of,
            histogram,
            vertices: 0,
            squares: 0.0,
            max: 0.0,
            normals: 0,
            angle_squares: 0.0,
            angle_max: 0.0,
        }
    }

    fn add(&mut self, parts: &[Vertices<'_>], scale: f64) {
        let (a, b) = (parts[self.of.0], parts[self.of.1]);
        for (p, q) in a.positions.iter().zip(b.positions).filter(|(p, q)| p.is_finite() && q.is_finite()) {
            let distance = p.distance(*q) * scale;
            self.vertices += 1;
            self.squares += distance * distance;
            self.max = self.max.max(distance);
            self.histogram.add(distance);
        }
        for angle in a.normals.iter().zip(b.normals).filter_map(|(m, n)| angle(*m, *n)) {
            self.normals += 1;
            self.angle_squares += angle * angle;
            self.angle_max = self.angle_max.max(angle);
        }
    }

    fn finish(&self) -> Difference {
        let rms = |squares: f64, count: u64| (squares / count.max(1) as f64).sqrt();
        let angles = Angles { rms: rms(self.angle_squares, self.normals), max: self.angle_max };
        Difference {
            vertices: self.vertices,
            rms: rms(self.squares, self.vertices),
            // A bin's middle may be beyond all that is in it.
            p99: self.histogram.quantile(0.99).min(self.max),
            max: self.max,
            normals: (self.normals > 0).then_some(angles),
        }
    }
}

/// Degrees; nothing where one of both has no direction.
fn angle(a: Vec3, b: Vec3) -> Option<f64> {
    let (a, b) = (a.as_dvec3().try_normalize()?, b.as_dvec3().try_normalize()?);
    // Exact for small angles, and 0 for the same.
    Some(a.cross(b).length().atan2(a.dot(b)).to_degrees())
}

/// Compares versions of a model, all with all. `diagonal` is the length that others are told as fractions of.
///
/// Memory: a small chunk of each version, and 8 kB for each pair.
///
/// # Errors
/// The models differ in their number of vertices; one cannot be read; the user cancelled.
pub fn beside(models: &[&dyn Model], diagonal: f64, progress: &dyn Progress) -> Result<Beside> {
    let numbers = 0..models.len();
    let mut pairs: Vec<Pair> =
        numbers.clone().flat_map(|i| (i + 1..models.len()).map(move |k| Pair::new((i, k)))).collect();
    let mut bounds = vec![Bounds::default(); models.len()];
    let scale = 1.0 / diagonal.max(f64::MIN_POSITIVE);
    progress.begin("measuring", models.first().map_or(0, |m| m.info().vertex_bytes));
    in_step(models, 0, progress, |parts| {
        for (bounds, part) in bounds.iter_mut().zip(parts) {
            part.positions.iter().filter(|p: &&DVec3| p.is_finite()).for_each(|p| bounds.include(*p));
        }
        pairs.par_iter_mut().for_each(|pair| pair.add(parts, scale));
        Ok(())
    })?;
    Ok(Beside { bounds, differences: pairs.iter().map(|pair| (pair.of, pair.finish())).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::progress::Silent;
    use simod_model::{Scalar, write_points};

    #[test]
    fn versions_differ_as_they_were_moved() {
        let folder = tempfile::tempdir().unwrap();
        let rest: Vec<DVec3> =
            (0..20_000).map(|i| DVec3::new(f64::from(i % 100), f64::from(i / 100), 0.0)).collect();
        let open = |name: &str, normal: Vec3, of: &dyn Fn(&DVec3) -> DVec3| {
            let (path, normals) = (folder.path().join(name), vec![normal; rest.len()]);
            let points = rest.iter().map(of).collect::<Vec<_>>().into_iter();
            write_points(&path, points, &normals, &[], Scalar::F64, &[]).unwrap();
            simod_model::open(&path).unwrap()
        };
        let tilted = Vec3::new(0.0, 3f32.sqrt() / 2.0, 0.5);
        let first = open("a", Vec3::Z, &|p| *p);
        let same = open("b", Vec3::Z, &|p| *p);
        // One of ten columns is moved by 3 and 4.
        let moved =
            open("c", tilted, &|p| if p.x % 10.0 == 0.0 { *p + DVec3::new(0.0, 3.0, 4.0) } else { *p });
        let found = beside(&[&*first, &*same, &*moved], 2.0, &Silent).unwrap();
        let order: Vec<_> = found.differences.iter().map(|(of, _)| *of).collect();
        assert_eq!(order, [(0, 1), (0, 2), (1, 2)]);
        let nothing = Difference {
            vertices: 20_000,
            rms: 0.0,
            p99: 0.0,
            max: 0.0,
            normals: Some(Angles { rms: 0.0, max: 0.0 }),
        };
        assert_eq!(found.differences[0].1, nothing);
        let Difference { rms, p99, max, normals, .. } = found.differences[1].1;
        assert!((rms - 2.5 * 0.1f64.sqrt()).abs() < 1e-12 && max == 2.5, "{rms}, {max}");
        assert!((p99 / 2.5 - 1.0).abs() < 0.02, "{p99}");
        let normals = normals.unwrap();
        assert!((normals.rms - 60.0).abs() < 1e-4 && (normals.max - 60.0).abs() < 1e-4, "{normals:?}");
        assert_eq!((found.bounds[0].max.z, found.bounds[2].max.z), (0.0, 4.0));
    }

    #[test]
    fn models_of_other_sizes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let open = |name: &str, count: usize| {
            let path = folder.path().join(name);
            write_points(&path, vec![DVec3::ONE; count].into_iter(), &[], &[], Scalar::F32, &[]).unwrap();
            simod_model::open(&path).unwrap()
        };
        let (a, b) = (open("a", 5), open("b", 6));
        let error = beside(&[&*a, &*b], 1.0, &Silent).unwrap_err();
        assert!(error.to_string().contains("6 vertices"), "{error}");
    }
}
