//! The figures of methods: each method beside the model at rest, and each pair of methods.

use crate::lengths::WithLengths;
use crate::method::Deformed;
use crate::record::{OnSamples, Pair};
use glam::DVec3;
use rayon::prelude::*;
use simod_core::deformed_positions::DeformedPositions;
use simod_core::sampled_model::SampledModel;
use simod_measure::{
    Also, DetailRotation, Details, Difference, DistanceSurface, Distances, Edges, Energies, OpenMesh,
    area_distortion, edge_distortion, is_closed, volume,
};
use simod_model::bounds::Bounds;
use simod_model::{Error, ErrorKind, Model, Progress, Result, for_faces, for_positions};
use std::collections::HashMap;
use std::sync::Arc;

/// Size below which a feature is a detail, as a fraction of the diagonal.
pub(crate) const DETAIL: f64 = 0.015;

/// Number of shapes that are measured at a time.
const TOGETHER: usize = 4;

impl ComparedModels {
    /// Difference of a method's vertices from those of the first method, both counted from 0.
    pub fn to_first(&self, method: usize) -> Option<Difference> {
        let found = self.differences.iter().find(|(of, _)| *of == (0, method));
        found.map(|(_, difference)| *difference)
    }
}

/// All vertices of the models, the first one at rest.
pub(crate) struct ComparedModels {
    /// Differences of each method's vertices from those at rest.
    pub displacements: Vec<Difference>,
    /// Boxes of all models.
    pub bounds: Vec<Bounds>,
    /// Differences of each pair of methods, counted from 0.
    differences: Vec<((usize, usize), Difference)>,
}

/// Compares all models in one reading; `also` gets their vertices, too.
pub(crate) fn beside(
    models: &[&dyn Model],
    diagonal: f64,
    also: (usize, &Also<'_>),
    progress: &dyn Progress,
) -> Result<ComparedModels> {
    let simod_measure::VersionsBeside { bounds, differences } =
        simod_measure::beside(models, diagonal, also, progress)?;
    let (rest, pairs): (Vec<_>, Vec<_>) = differences.into_iter().partition(|((a, _), _)| *a == 0);
    Ok(ComparedModels {
        displacements: rest.into_iter().map(|(_, difference)| difference).collect(),
        bounds,
        differences: pairs.into_iter().map(|((a, b), difference)| ((a - 1, b - 1), difference)).collect(),
    })
}

/// Figures of the methods' deformed samples beside those at rest: nothing of methods without samples or
/// triangles.
pub(crate) fn on_samples(deformed: &[&Deformed], progress: &dyn Progress) -> Result<Vec<Option<OnSamples>>> {
    progress.begin("measuring the samples", 0);
    let mut found: Vec<Option<OnSamples>> = deformed.iter().map(|_| None).collect();
    for (first, one) in deformed.iter().enumerate() {
        let is_same = |other: &Deformed| Arc::ptr_eq(&one.sampled, &other.sampled);
        let triangles = &one.sampled.triangles;
        if triangles.is_empty() || deformed[..first].iter().any(|other| is_same(other)) {
            continue;
        }
        let rest = one.sampled.samples.positions.iter().map(|p| p.as_dvec3());
        let rest = in_diagonals(&one.sampled, rest);
        progress.check()?;
        let shape = AtRest::new(&rest, triangles);
        let own: Vec<(usize, &DeformedPositions)> = deformed
            .iter()
            .enumerate()
            .filter(|(_, other)| is_same(other))
            .filter_map(|(i, other)| Some((i, other.positions.as_ref()?)))
            .collect();
        for some in own.chunks(TOGETHER) {
            let after: Vec<_> = some.iter().map(|(_, p)| deformed_in_diagonals(&one.sampled, p)).collect();
            let measured = shape.measure(&after, progress)?;
            some.iter().zip(measured).for_each(|((i, _), one)| found[*i] = Some(one));
        }
    }
    Ok(found)
}

/// A mesh at rest in the unit of all lengths, to be compared with deformed ones.
struct AtRest<'a> {
    rest: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    edges: Edges,
    details: Details<'a>,
    /// Volume of the mesh, if it is closed.
    volume: Option<f64>,
    open: Option<OpenMesh>,
}

impl<'a> AtRest<'a> {
    fn new(rest: &'a [DVec3], triangles: &'a [[u32; 3]]) -> Self {
        let ((closed, edges), details) = rayon::join(
            || (is_closed(triangles), Edges::from_triangles(rest, triangles)),
            || Details::new(rest, triangles, DETAIL),
        );
        Self {
            rest,
            triangles,
            edges,
            details,
            volume: closed.then(|| volume(rest, triangles)),
            open: if closed { None } else { OpenMesh::from_triangles(rest, triangles) },
        }
    }

    /// The mesh's figures in some shapes.
    fn measure(&self, shapes: &[Vec<DVec3>], progress: &dyn Progress) -> Result<Vec<OnSamples>> {
        let Self { rest, triangles, ref edges, .. } = *self;
        progress.check()?;
        let details = self.details.rotations(&shapes.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let each = |(after, details): (&Vec<DVec3>, DetailRotation)| {
            let volume_change = self.volume.map(|before| volume(after, triangles) / before - 1.0);
            let over_border = |open: &OpenMesh| [rest, after].map(|of| open.volume(of, triangles));
            progress.check()?;
            let ((edges, areas), energies) = rayon::join(
                || (edge_distortion(rest, after, edges), area_distortion(rest, after, triangles)),
                || Energies::between(rest, after, (triangles, edges)),
            );
            Ok(OnSamples {
                volume_change: volume_change.filter(|x| x.is_finite()),
                volume_over_border: self.open.as_ref().map(over_border),
                edges,
                areas,
                details,
                energies,
            })
        };
        shapes.par_iter().zip(details).map(each).collect()
    }
}

/// The model's own mesh, where it is small enough to be held.
pub(crate) struct HeldMesh {
    /// Index of the first vertex at the place of each: soups have several vertices at one place.
    first: Vec<u32>,
    rest: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    scale: f64,
}

impl HeldMesh {
    /// Greatest number of vertices, and of triangles.
    ///
    /// Memory: 40 bytes for each vertex and triangle, of those at rest and those of four methods; and a
    /// thousand while they are measured.
    const MOST: u64 = 1 << 18;

    /// Reads a mesh; nothing of a model that is larger, or has no faces.
    pub fn read(model: &dyn Model, diagonal: f64, progress: &dyn Progress) -> Result<Option<Self>> {
        let info = model.info();
        if info.vertices > Self::MOST || info.faces == 0 || info.faces > 2 * Self::MOST {
            return Ok(None);
        }
        progress.begin("reading the model", info.vertex_bytes);
        let rest = positions(model)?;
        let mut at = HashMap::new();
        // Both zeros count as one number.
        let place = |p: &DVec3| (*p + DVec3::ZERO).to_array().map(f64::to_bits);
        let first: Vec<u32> = rest.iter().zip(0..).map(|(p, i)| *at.entry(place(p)).or_insert(i)).collect();
        let mut triangles = Vec::new();
        for_faces(model, |chunk| {
            progress.check()?;
            let known = |t: &[u32; 3]| t.iter().all(|i| (*i as usize) < first.len());
            let merged = chunk.triangles.iter().filter(|t| known(t)).map(|t| t.map(|i| first[i as usize]));
            triangles.extend(merged.filter(|[a, b, c]| a != b && b != c && c != a));
            if triangles.len() as u64 > 4 * Self::MOST {
                // A few polygons may have very many corners.
                triangles.clear();
                return Err(Error::argument("too many triangles", "they are not held"));
            }
            Ok(())
        })
        .or_else(|e| if triangles.is_empty() && e.kind() == ErrorKind::Argument { Ok(()) } else { Err(e) })?;
        let scale = 1.0 / diagonal.max(f64::MIN_POSITIVE);
        let rest = rest.iter().map(|p| *p * scale).collect();
        Ok((!triangles.is_empty()).then_some(Self { first, rest, triangles, scale }))
    }

    /// Figures of deformed models beside this mesh.
    pub fn measure(&self, models: &[&dyn Model], progress: &dyn Progress) -> Result<Vec<OnSamples>> {
        progress.begin("measuring the model", 0);
        let shape = AtRest::new(&self.rest, &self.triangles);
        let after = |model: &&dyn Model| -> Result<Vec<DVec3>> {
            let all = positions(*model)?;
            Ok(self.first.iter().map(|i| all[*i as usize] * self.scale).collect())
        };
        let mut measured = Vec::with_capacity(models.len());
        for some in models.chunks(TOGETHER) {
            let shapes = some.iter().map(after).collect::<Result<Vec<_>>>()?;
            measured.extend(shape.measure(&shapes, progress)?);
        }
        Ok(measured)
    }
}

/// The positions of all vertices, in the model's coordinates.
fn positions(model: &dyn Model) -> Result<Vec<DVec3>> {
    let mut positions = Vec::new();
    for_positions(model, |chunk| {
        positions.extend_from_slice(&chunk.positions);
        Ok(())
    })?;
    Ok(positions)
}

/// Local positions, in the unit of all lengths here: the diagonal.
fn in_diagonals(sampled: &SampledModel, local: impl Iterator<Item = DVec3>) -> Vec<DVec3> {
    let scale = 1.0 / sampled.local_diagonal().max(f64::MIN_POSITIVE);
    local.map(|p| p * scale).collect()
}

/// Deformed samples, in the unit of all lengths here: the diagonal.
fn deformed_in_diagonals(sampled: &SampledModel, deformed: &DeformedPositions) -> Vec<DVec3> {
    let shift = deformed.shift / sampled.frame.scale;
    in_diagonals(sampled, deformed.local.iter().map(|p| p.as_dvec3() + shift))
}

/// Figures of each pair of methods, of a model whose bounding box has the `diagonal`.
///
/// Memory: the tree of one method's triangles, and 24 bytes for each sample of two methods.
pub(crate) fn pairs(
    names: &[String],
    deformed: &[&Deformed],
    (beside, diagonal): (&ComparedModels, f64),
    progress: &dyn Progress,
) -> Result<Vec<Pair>> {
    let count = deformed.len();
    let has_surface = |d: &&&Deformed| d.positions.is_some() && !d.sampled.triangles.is_empty();
    let points: usize = deformed.iter().filter(has_surface).map(|d| d.sampled.samples.len()).sum();
    progress.begin_parts("comparing surfaces", (points * count.saturating_sub(1)) as u64);
    // Distances in one direction: row by row from one method to each other one.
    let mut ways: Vec<Option<Distances>> = vec![None; count * count];
    for (to, target) in deformed.iter().enumerate() {
        let Some(positions) = &target.positions else { continue };
        let positions = deformed_in_diagonals(&target.sampled, positions);
        let Some(surface) = DistanceSurface::new(&positions, &target.sampled.triangles) else { continue };
        for (from, source) in deformed.iter().enumerate().filter(|(from, _)| *from != to) {
            let triangles = &source.sampled.triangles;
            if let Some(points) = source.positions.as_ref().filter(|_| !triangles.is_empty()) {
                let points = deformed_in_diagonals(&source.sampled, points);
                ways[from * count + to] = Some(surface.distances(&points, triangles, progress)?);
            }
        }
    }
    let pair = |((a, b), vertices): &((usize, usize), Difference)| Pair {
        first: names[*a].clone(),
        second: names[*b].clone(),
        vertices: WithLengths::new(*vertices, diagonal),
        surfaces: ways[a * count + b]
            .zip(ways[b * count + a])
            .map(|(there, back)| [there, back].map(|way| WithLengths::new(way, diagonal))),
    };
    Ok(beside.differences.iter().map(pair).collect())
}

/// End of the colour scale: a round number that about 99 of 100 vertices of each method do not reach.
pub(crate) fn color_scale(pairs: &[Pair], reference: &str) -> f64 {
    let with_first = pairs.iter().filter(|pair| pair.first == reference);
    rounded_up(with_first.map(|pair| pair.vertices.p99).fold(0.0, f64::max))
}

/// Next larger number of one digit, or 1.5, times a power of ten.
fn rounded_up(x: f64) -> f64 {
    if !(x > 0.0 && x.is_finite()) {
        return 0.0;
    }
    let exponent = x.log10().floor() as i32;
    // The number is divided by whole powers of ten, so that 0.3 is 0.3.
    let round = |n: f64| if exponent < 0 { n / 10f64.powi(-exponent) } else { n * 10f64.powi(exponent) };
    let ends = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0].map(round);
    ends.into_iter().find(|end| *end >= x * (1.0 - 1e-9)).unwrap_or(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_at_round_numbers() {
        for (x, end) in
            [(0.013, 0.015), (0.02, 0.02), (0.0021, 0.003), (9.0, 10.0), (0.27, 0.3), (1.0, 1.0), (0.0, 0.0)]
        {
            assert_eq!(rounded_up(x), end, "{x}");
        }
        assert_eq!(rounded_up(f64::NAN), 0.0);
    }
}
