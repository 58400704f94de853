//! Changes of the model's details: of its edges and the angles between its triangles, beside the model
//! deformed exactly.

use glam::DVec3;
use rayon::prelude::*;
use simod_benches::peers::Peer;
use simod_benches::process::Result;
use simod_benches::{Map, error_figure, head, row};
use simod_generate::Shape;
use simod_model::{Model, Scalar};

use crate::method::Method;
use crate::scene::Scene;
use crate::{Arguments, pictures};

const COLUMNS: [&str; 8] = [
    "model",
    "map",
    "method",
    "edges, rms",
    "edges, 99.9 % below",
    "edges off by more than a tenth",
    "angles, rms, degrees",
    "angles, 99.9 % below, degrees",
];

/// A deviation of an edge that makes a fold or a hole to be seen.
const LARGE: f64 = 0.1;

/// Measures, prints a table, and draws.
pub fn measure(arguments: &Arguments) -> Result<()> {
    let Arguments { small_vertices, small_samples, folder, .. } = arguments;
    let sphere = Scene::generated(Shape::BumpySphere, *small_vertices, *small_samples, folder)?;
    let own =
        arguments.model.as_ref().map(|path| Scene::of_file(path, *small_samples, folder)).transpose()?;
    for scene in own.iter().chain([&sphere]) {
        println!("{}", scene.title());
    }
    println!("\n{}", head(&COLUMNS));
    for scene in own.iter().chain([&sphere]) {
        let edges = edges(scene.model.as_ref())?;
        for map in [Map::Bend, Map::Twist] {
            measure_map(scene, &edges, map)?;
        }
        if let Some(folder) = &arguments.pictures {
            for map in [Map::Bend, Map::Twist] {
                pictures::draw(scene, map, folder)?;
            }
        }
    }
    Ok(())
}

fn measure_map(scene: &Scene, edges: &[Edge], map: Map) -> Result<()> {
    let bounds = &scene.sampled.bounds;
    let truth: Vec<DVec3> = scene.positions.iter().map(|p| map.apply(bounds, *p)).collect();
    let print = |method: &str, result: &[DVec3]| {
        let (lengths, angles) = deviations(edges, &truth, result);
        let figures = [lengths.rms, lengths.p999].map(error_figure).into_iter();
        let figures = figures.chain([lengths.large.to_string()]);
        let figures = figures.chain([angles.rms, angles.p999].map(|x| format!("{:.3}", x.to_degrees())));
        let names = [&scene.name, map.name(), method].map(str::to_owned);
        println!("{}", row(names.into_iter().chain(figures)));
    };
    if scene.model.info().position_type == Scalar::F32 {
        let rounded: Vec<DVec3> = truth.iter().map(|p| p.as_vec3().as_dvec3()).collect();
        print("none: the exact map, in floats", &rounded);
    }
    for method in scene.methods().filter(|method| *method != Method::Peer(Peer::ThinPlate)) {
        print(method.name(), &scene.transferred(method, map)?);
    }
    Ok(())
}

/// An edge between two triangles: its ends, and the corner of the triangle to the left and to the right.
struct Edge {
    ends: [u32; 2],
    corners: [u32; 2],
}

/// The edges that two triangles share, which agree on the outside.
fn edges(model: &dyn Model) -> Result<Vec<Edge>> {
    // Each triangle's edges: the ends in order of their numbers, whether that is the triangle's order, its
    // third corner.
    let mut sides: Vec<([u32; 2], bool, u32)> = Vec::new();
    simod_model::for_faces(model, |chunk| {
        for [a, b, c] in &chunk.triangles {
            for [from, to, corner] in [[a, b, c], [b, c, a], [c, a, b]] {
                sides.push(([*from.min(to), *from.max(to)], from > to, *corner));
            }
        }
        Ok(())
    })?;
    sides.par_sort_unstable();
    let shared = sides.chunk_by(|a, b| a.0 == b.0).filter_map(|sides| match sides {
        [(ends, false, left), (_, true, right)] => Some(Edge { ends: *ends, corners: [*left, *right] }),
        _ => None,
    });
    let vertices = model.info().vertices;
    let edges: Vec<Edge> = shared
        .filter(|edge| edge.ends.iter().chain(&edge.corners).all(|i| u64::from(*i) < vertices))
        .collect();
    if edges.is_empty() {
        return Err(format!("{} has no triangles", model.path().display()).into());
    }
    Ok(edges)
}

impl Edge {
    fn length(&self, positions: &[DVec3]) -> f64 {
        let [a, b] = self.ends.map(|i| positions[i as usize]);
        a.distance(b)
    }

    /// The signed angle between the normals of both triangles; NaN where one has no area.
    fn angle(&self, positions: &[DVec3]) -> f64 {
        let ([a, b], [c, d]) =
            (self.ends.map(|i| positions[i as usize]), self.corners.map(|i| positions[i as usize]));
        let along = (b - a).normalize_or_zero();
        let (left, right) = ((b - a).cross(c - a), (d - a).cross(b - a));
        if left == DVec3::ZERO || right == DVec3::ZERO {
            return f64::NAN;
        }
        left.cross(right).dot(along).atan2(left.dot(right))
    }
}

/// Statistics of many deviations.
struct Spread {
    rms: f64,
    p999: f64,
    /// The number of those above [`LARGE`].
    large: usize,
}

impl Spread {
    /// Of those that are numbers.
    fn from_deviations(deviations: impl ParallelIterator<Item = f64>) -> Self {
        let mut all: Vec<f64> = deviations.filter(|x| x.is_finite()).map(f64::abs).collect();
        if all.is_empty() {
            return Self { rms: f64::NAN, p999: f64::NAN, large: 0 };
        }
        let squares: f64 = all.iter().map(|x| x * x).sum();
        let rms = (squares / all.len() as f64).sqrt();
        let rank = (0.999 * (all.len() - 1) as f64) as usize;
        let large = all.iter().filter(|x| **x > LARGE).count();
        let (_, p999, _) = all.select_nth_unstable_by(rank, f64::total_cmp);
        Self { rms, p999: *p999, large }
    }
}

/// The deviations of lengths, as parts of them, and of angles.
fn deviations(edges: &[Edge], truth: &[DVec3], result: &[DVec3]) -> (Spread, Spread) {
    let length = |edge: &Edge| edge.length(result) / edge.length(truth) - 1.0;
    let angle = |edge: &Edge| {
        let turned = edge.angle(result) - edge.angle(truth);
        // At a fold by half a turn the sign may change.
        turned.sin().atan2(turned.cos())
    };
    (
        Spread::from_deviations(edges.par_iter().map(length)),
        Spread::from_deviations(edges.par_iter().map(angle)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_have_signs() {
        let edge = Edge { ends: [0, 1], corners: [2, 3] };
        let angle = |height: f64| {
            let corner = DVec3::new(0.5, -1.0, height);
            edge.angle(&[DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0), corner]).to_degrees()
        };
        assert!(angle(0.0).abs() < 1e-12);
        assert!((angle(1.0).abs() - 45.0).abs() < 1e-9);
        assert!((angle(1.0) + angle(-1.0)).abs() < 1e-9);
    }

    #[test]
    fn deviations_of_a_sheared_square() {
        let edge = || Edge { ends: [0, 1], corners: [2, 3] };
        let rest = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::NEG_Y];
        let result = rest.map(|p| DVec3::new(1.25 * p.x, p.y, 0.0));
        let (lengths, angles) = deviations(&[edge(), edge()], &rest, &result);
        assert!((lengths.rms - 0.25).abs() < 1e-12 && (lengths.p999 - 0.25).abs() < 1e-12);
        assert!(angles.rms < 1e-12);
    }
}
