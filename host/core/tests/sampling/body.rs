//! Models in memory, and their sampling.

use std::collections::BTreeSet;
use std::path::Path;

use glam::{DVec3, Vec3};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, sample};
use simod_generate::{Shape, Surface};
use simod_model::Scalar;
use simod_model::progress::Silent;
use simod_model::write_points;

/// A model in memory.
#[derive(Debug, Clone, Default)]
pub struct Body {
    pub positions: Vec<DVec3>,
    /// Normal of each position; empty if the model has none.
    pub normals: Vec<Vec3>,
    pub faces: Vec<[u32; 3]>,
}

impl Body {
    pub fn generated(shape: Shape, vertices: u64) -> Self {
        let (vertices, faces) = Surface::new(shape, vertices).unwrap().mesh().unwrap();
        let (positions, normals) = vertices.iter().map(|v| (v.position, v.normal)).unzip();
        Self { positions, normals, faces }
    }

    pub fn without_faces(mut self) -> Self {
        self.faces.clear();
        self
    }

    pub fn without_normals(mut self) -> Self {
        self.normals.clear();
        self
    }

    /// The same model with its vertices in an order without any coherence.
    pub fn shuffled(&self) -> Self {
        // A step that shares no factor with the count visits each index once.
        let gcd = |mut a: usize, mut b: usize| {
            while b > 0 {
                (a, b) = (b, a % b);
            }
            a
        };
        let n = self.positions.len();
        let step = (n * 5 / 13..).find(|s| gcd(*s, n) == 1).unwrap();
        let old: Vec<usize> = (0..n).map(|i| i * step % n).collect();
        let mut new = vec![0; n];
        (0..).zip(&old).for_each(|(i, old)| new[*old] = i);
        Self {
            positions: old.iter().map(|i| self.positions[*i]).collect(),
            normals: old.iter().filter_map(|i| self.normals.get(*i).copied()).collect(),
            faces: self.faces.iter().map(|corners| corners.map(|i| new[i as usize])).collect(),
        }
    }

    pub fn write(&self, path: &Path) {
        write_points(path, self.positions.iter().copied(), &self.normals, &self.faces, Scalar::F64, &[])
            .unwrap();
    }

    /// Samples the model, and checks that nothing is left of it on the disk.
    pub fn sampled(&self, sampling: Sampling) -> SampledModel {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        self.write(&path);
        let sampled = sample_file(&path, sampling);
        std::fs::remove_file(path).unwrap();
        // Temporary files have no name.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        sampled
    }
}

/// Samples a file.
pub fn sample_file(path: &Path, sampling: Sampling) -> SampledModel {
    let model = simod_model::open(path).unwrap();
    sample(model.as_ref(), &sampling, path.parent().unwrap(), &Silent).unwrap()
}

/// Distance of each finite vertex to the nearest sample, in local units.
pub fn distances<'a>(sampled: &'a SampledModel, vertices: &'a [DVec3]) -> impl Iterator<Item = f32> + 'a {
    vertices.iter().filter(|p| p.is_finite()).map(|p| {
        let p = sampled.frame.to_local(*p);
        sampled.samples.positions[sampled.samples.nearest(p) as usize].distance(p)
    })
}

/// Largest distance of a vertex from its nearest sample.
pub fn worst_distance(sampled: &SampledModel, vertices: &[DVec3]) -> f32 {
    // Not by `f32::max`, which passes over NaN.
    distances(sampled, vertices).max_by(f32::total_cmp).unwrap()
}

/// The root mean square of the distances.
pub fn rms_distance(sampled: &SampledModel, vertices: &[DVec3]) -> f64 {
    let squares = distances(sampled, vertices).map(|d| f64::from(d).powi(2));
    (squares.sum::<f64>() / vertices.len() as f64).sqrt()
}

/// Triangles as a set, where it does not matter with which corner each begins.
pub fn triangle_set(triangles: impl IntoIterator<Item = [u32; 3]>) -> BTreeSet<[u32; 3]> {
    let first_least = |[a, b, c]: [u32; 3]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap();
    triangles.into_iter().map(first_least).collect()
}
