//! Tests: the vertices that are streamed are those that a reconstruction writes.

use glam::{DVec3, Vec3};
use simod_model::progress::Silent;
use simod_model::{ErrorKind, for_vertices};

use super::*;
use crate::deformed_positions::DeformedPositions;
use crate::reconstruction::{Method, Reconstruction, RestGeometry, Version, reconstruct};
use crate::refinement::tests::{Body, samples};
use crate::sampling::grid::{CellMap, key_at};

fn twist(p: DVec3) -> DVec3 {
    let (sin, cos) = (1.2 * p.y).sin_cos();
    DVec3::new(cos * p.x - sin * p.z, p.y, sin * p.x + cos * p.z)
}

fn twisted(sampled: &SampledModel) -> DeformedPositions {
    let frame = &sampled.frame;
    let deformed = sampled.samples.positions.iter().map(|p| frame.to_local(twist(frame.to_model(*p))));
    sampled.rounded(&deformed.collect::<Vec<_>>())
}

/// Samples near a point.
fn near(sampled: &SampledModel, at: DVec3, radius: f64) -> Vec<bool> {
    sampled.samples.positions.iter().map(|p| sampled.frame.to_model(*p).distance(at) < radius).collect()
}

fn streamed(
    sampled: &SampledModel,
    model: &dyn Model,
    chosen: &DetailRequest,
    deformed: Option<&DeformedPositions>,
) -> Result<(Vec<DetailBatch>, Streamed)> {
    let mut batches = Vec::new();
    let mut run = |field: Option<&DeformationField<'_>>| {
        stream(sampled, model, chosen, field, &Silent, |batch| {
            batches.push(batch);
            Ok(())
        })
    };
    let report = match deformed {
        Some(deformed) => {
            let around = RestGeometry::new(&sampled.samples);
            run(Some(&DeformationField::from_deformed(&around, deformed, Method::default())))
        }
        None => run(None),
    }?;
    Ok((batches, report))
}

/// The vertices of each kept cell, in the order of the model.
fn of_cells(sampled: &SampledModel, positions: &[DVec3]) -> Vec<Vec<usize>> {
    let kept = sampled.held_cells().unwrap();
    let place: CellMap<usize> = kept.cells.iter().map(|cell| cell.key).zip(0..).collect();
    let mut of = vec![Vec::new(); kept.cells.len()];
    for (i, p) in positions.iter().enumerate().filter(|(_, p)| p.is_finite()) {
        of[place[&key_at(*p, kept.level)]].push(i);
    }
    of
}

/// Each vertex of a model.
fn read(model: &dyn Model) -> (Vec<DVec3>, Vec<Vec3>) {
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    for_vertices(model, |chunk| {
        positions.extend_from_slice(&chunk.positions);
        normals.extend_from_slice(&chunk.normals);
        Ok(())
    })
    .unwrap();
    (positions, normals)
}

#[test]
fn vertices_are_where_a_reconstruction_writes_them() {
    let bodies = [
        Body::new(60_000),
        Body::new(60_000).without_faces().without_normals(),
        Body::new(60_000).without_faces().shuffled(),
    ];
    for body in bodies {
        let (sampled, model) = body.sampled(samples(3000));
        let deformed = twisted(&sampled);
        let output = body.folder.path().join("deformed.ply");
        let version = Version { deformed: &deformed, output: &output, diagnostics: None };
        reconstruct(&sampled, model.as_ref(), &[version], &Reconstruction::default(), &Silent).unwrap();
        let (written, turned) = read(simod_model::open(&output).unwrap().as_ref());

        let all = DetailRequest::select(&sampled, &vec![true; sampled.samples.len()], ENOUGH).unwrap();
        assert_eq!((all.stride, all.vertices(&sampled)), (1, [60_000; 2]));
        let (batches, report) = streamed(&sampled, model.as_ref(), &all, Some(&deformed)).unwrap();
        assert_eq!([report.vertices, report.of], [60_000; 2]);
        let of_cells = of_cells(&sampled, &body.positions);
        let mut seen = 0;
        for batch in &batches {
            for (cell, range) in &batch.cells {
                let ids = &of_cells[*cell as usize];
                assert_eq!(range.len(), ids.len());
                seen += ids.len();
                for (at, id) in range.clone().zip(ids) {
                    let at = at as usize;
                    // The same bits, as far as single precision at unit size and the file have them.
                    let off = (batch.positions[at] - sampled.frame.to_local(written[*id])).abs();
                    assert!(off.max_element() <= 1.2e-7, "vertex {id} is {off} off");
                    if let Some(normal) = turned.get(*id) {
                        assert!(batch.normals[at].dot(*normal) > 1.0 - 1e-5, "the normal of vertex {id}");
                    }
                }
            }
        }
        assert_eq!(seen, 60_000);
    }
}

#[test]
fn only_the_chosen_cells_are_read() {
    let body = Body::new(150_000);
    let (sampled, model) = body.sampled(samples(5000));
    let marks = near(&sampled, DVec3::new(0.41, 1.0, 0.41), 0.12);
    let chosen = DetailRequest::select(&sampled, &marks, ENOUGH).unwrap();
    let kept = sampled.held_cells().unwrap();
    for (cell, place) in kept.cells.iter().zip(0..) {
        let meets = cell.tree.samples.iter().any(|s| marks[*s as usize]);
        assert_eq!(chosen.cells.binary_search(&place).is_ok(), meets);
    }
    let (batches, report) = streamed(&sampled, model.as_ref(), &chosen, None).unwrap();
    let [all, taken] = chosen.vertices(&sampled);
    assert_eq!((report.vertices, report.of, all), (taken, all, taken));
    let share = report.bytes as f64 / model.info().vertex_bytes as f64;
    assert!(share < 0.25, "{share} of the model was read");
    let found: Vec<u32> = batches.iter().flat_map(|b| &b.cells).map(|(cell, _)| *cell).collect();
    let mut sorted = found.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, chosen.cells);
    // At rest, each vertex where it is.
    let of_cells = of_cells(&sampled, &body.positions);
    for batch in &batches {
        for (cell, range) in &batch.cells {
            for (at, id) in range.clone().zip(&of_cells[*cell as usize]) {
                let rest = sampled.frame.to_local(body.positions[*id]);
                assert_eq!(batch.positions[at as usize], rest);
            }
        }
    }
}

#[test]
fn no_more_vertices_are_taken_than_allowed_and_they_are_spread() {
    for body in [Body::new(150_000), Body::new(150_000).without_faces().shuffled()] {
        let (sampled, model) = body.sampled(samples(4000));
        let marks = vec![true; sampled.samples.len()];
        let deformed = twisted(&sampled);
        let cells = sampled.held_cells().unwrap().cells.len();
        for most in [40_000, 10_000, 100] {
            let chosen = DetailRequest::select(&sampled, &marks, most).unwrap();
            let (batches, report) = streamed(&sampled, model.as_ref(), &chosen, Some(&deformed)).unwrap();
            let taken: usize = batches.iter().map(|b| b.positions.len()).sum();
            assert!(taken <= most.max(cells) && taken * 4 > most, "{taken} of {most}");
            assert_eq!([report.of, report.vertices], [150_000, taken as u64]);
            // Every cell has its share.
            for batch in &batches {
                for (cell, range) in &batch.cells {
                    let n = sampled.held_cells().unwrap().cells[*cell as usize].vertices;
                    assert_eq!(range.len() as u64, n.div_ceil(chosen.stride));
                }
                for i in 0..batch.positions.len() {
                    assert!(batch.spacing[i] > 0.0 && batch.normals[i].is_normalized());
                }
            }
        }
    }
}

#[test]
fn threads_change_nothing() {
    let body = Body::new(80_000).without_normals();
    let (sampled, model) = body.sampled(samples(3000));
    let deformed = twisted(&sampled);
    let chosen = DetailRequest::select(&sampled, &vec![true; sampled.samples.len()], 30_000).unwrap();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| streamed(&sampled, model.as_ref(), &chosen, Some(&deformed)).unwrap())
    };
    assert_eq!(run(1), run(3));
}

/// Without normals of its own, those of the surface, on the side of the samples; and discs as wide as
/// vertices are apart.
#[test]
fn normals_and_spacings_are_those_of_the_surface() {
    let mut body = Body::new(60_000).without_faces().without_normals();
    // A sphere, by a spiral.
    let (golden, n) = (std::f64::consts::PI * (3.0 - 5f64.sqrt()), body.positions.len() as f64);
    for (p, i) in body.positions.iter_mut().zip(0..) {
        let (z, (s, c)) = (1.0 - (2.0 * f64::from(i) + 1.0) / n, (golden * f64::from(i)).sin_cos());
        let r = (1.0 - z * z).sqrt();
        *p = DVec3::new(r * c, r * s, z) * 10.0;
    }
    let (sampled, model) = body.sampled(samples(3000));
    for (most, tolerance) in [(ENOUGH, 0.15), (15_000, 0.25)] {
        let chosen = DetailRequest::select(&sampled, &vec![true; sampled.samples.len()], most).unwrap();
        let (batches, report) = streamed(&sampled, model.as_ref(), &chosen, None).unwrap();
        let mut area = 0.0;
        for batch in &batches {
            for (p, n) in batch.positions.iter().zip(&batch.normals) {
                assert!(n.dot(p.normalize_or_zero()) > 0.97, "{n} at {p}");
            }
            // Each vertex has the cell of a hexagonal packing.
            area += batch.spacing.iter().map(|s| 0.75f64.sqrt() * f64::from(*s).powi(2)).sum::<f64>();
        }
        let truth = 4.0 * std::f64::consts::PI * (10.0 / sampled.frame.scale).powi(2);
        assert!((area / truth - 1.0).abs() < tolerance, "{} for {}", area / truth, report.vertices);
    }
}

/// A user who has asked to stop.
struct Stopped;

impl Progress for Stopped {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        true
    }
}

#[test]
fn what_cannot_be_streamed_is_told() {
    let mut body = Body::new(60_000).without_faces();
    body.positions[777] = DVec3::NAN;
    let (mut sampled, model) = body.sampled(samples(3000));
    let marks = vec![true; sampled.samples.len()];
    let all = DetailRequest::select(&sampled, &marks, ENOUGH).unwrap();
    let (batches, report) = streamed(&sampled, model.as_ref(), &all, None).unwrap();
    assert_eq!(report.vertices, 59_999);
    assert!(batches.iter().flat_map(|b| &b.positions).all(|p| p.is_finite()));

    let refused = |marks: &[bool], text: &str| {
        let error = DetailRequest::select(&sampled, marks, ENOUGH).expect_err("an error");
        assert!(error.to_string().contains(text), "{error}");
    };
    refused(&vec![false; marks.len()], "nothing of the model");
    refused(&marks[1..], "marks for");
    let nowhere = DetailRequest { cells: vec![u32::MAX], stride: 1, shown: DetailAttributes::Nothing };
    assert!(streamed(&sampled, model.as_ref(), &nowhere, None).is_err());

    // Stopped by the one who takes them, or by the user.
    let stopped = stream(&sampled, model.as_ref(), &all, None, &Silent, |_| Err(Error::cancelled()));
    assert_eq!(stopped.unwrap_err().kind(), ErrorKind::Cancelled);
    let stopped = stream(&sampled, model.as_ref(), &all, None, &Stopped, |_| Ok(()));
    assert_eq!(stopped.unwrap_err().kind(), ErrorKind::Cancelled);

    // Another model in the same file.
    let mut other = Body::new(60_000).without_faces();
    other.positions[777] = DVec3::NAN;
    other.positions[100].y += 1.0;
    let other = other.write();
    let error = streamed(&sampled, other.as_ref(), &all, None).expect_err("an error");
    assert!(error.to_string().contains("changed since it was sampled"), "{error}");

    let mut cells = sampled.held_cells().unwrap().clone();
    cells.cells[0].vertices += 1;
    sampled.hold_cells(cells);
    assert!(DetailRequest::select(&sampled, &marks, ENOUGH).is_err());
}
