//! Cells that are kept beside the samples, saved and loaded.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use glam::DVec3;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::cluster::REACH_WEIGHT;
use simod_core::sampling::kept_cells::{KeptCell, KeptCells};
use simod_core::sampling::{Grouping, Sampling, Skip, Splitting, Target};
use simod_generate::Shape;
use simod_model::ErrorKind;
use simod_model::progress::Silent;
use tempfile::TempDir;

use crate::body::{Body, sample_file};

fn samples(n: u64) -> Sampling {
    Sampling { target: Target::Samples(n), ..Sampling::default() }
}

/// A model and its sampled model in a folder.
pub struct Saved {
    root: TempDir,
}

impl Saved {
    pub fn new(body: &Body, sampling: Sampling) -> Self {
        let saved = Self { root: tempfile::tempdir().unwrap() };
        body.write(&saved.model());
        sample_file(&saved.model(), sampling).save(&saved.folder()).unwrap();
        saved
    }

    pub fn model(&self) -> PathBuf {
        self.root.path().join("model.ply")
    }

    pub fn folder(&self) -> PathBuf {
        self.root.path().join("model.simod")
    }

    pub fn load(&self) -> SampledModel {
        SampledModel::load(&self.folder()).unwrap()
    }

    fn file(&self) -> PathBuf {
        self.folder().join("cells.bin")
    }

    /// The content of the cells' file.
    pub fn bytes(&self) -> Vec<u8> {
        fs::read(self.file()).unwrap()
    }

    pub fn cells(&self) -> KeptCells {
        self.load().cells_or_resample(&self.folder(), None, &Silent).unwrap()
    }

    /// All names in both folders.
    pub fn names(&self) -> Vec<String> {
        let names = |folder: &Path| {
            let entries = fs::read_dir(folder).unwrap();
            entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect::<Vec<_>>()
        };
        let mut names = [names(self.root.path()), names(&self.folder())].concat();
        names.sort();
        names
    }
}

fn write(path: &Path, bytes: &[u8]) {
    File::create(path).unwrap().write_all(bytes).unwrap();
}

/// Checks the rules that hold for all trees, and calls `visit` with the error of each node, that of its
/// parent, and whether it is a leaf.
fn walk(cell: &KeptCell, mut visit: impl FnMut(f32, f32, bool)) {
    let tree = &cell.tree;
    assert_eq!(tree.children.len(), tree.errors.len());
    // Children that are still to come of each open ancestor, and the ancestor's error.
    let mut open: Vec<(u8, f32)> = Vec::new();
    for (at, (children, error)) in tree.children.iter().zip(&tree.errors).enumerate() {
        let above = match open.last_mut() {
            Some((left, above)) => {
                *left -= 1;
                *above
            }
            None => {
                assert_eq!(at, 0, "a second root");
                f32::INFINITY
            }
        };
        assert!((0.0..=above).contains(error), "{error} below {above}");
        assert!(*children <= 8 && *children != 1, "{children} children");
        visit(*error, above, *children == 0);
        open.push((*children, *error));
        while open.pop_if(|(left, _)| *left == 0).is_some() {}
    }
    assert!(open.is_empty(), "children are missing");
}

fn leaves(cell: &KeptCell) -> usize {
    cell.tree.children.iter().filter(|children| **children == 0).count()
}

/// Checks the cells of a sampled model against the model itself.
fn check(cells: &KeptCells, sampled: &SampledModel, body: &Body) {
    let edge = 2f64.powi(cells.level);
    assert_eq!(edge, sampled.cell_size);
    assert_eq!(cells.cells.len() as u64, sampled.cells);
    let finite = body.positions.iter().filter(|p| p.is_finite()).count() as u64;
    assert_eq!(cells.cells.iter().map(|c| c.vertices).sum::<u64>(), finite);

    let index: std::collections::BTreeMap<_, _> = cells.cells.iter().map(|c| c.key).zip(0..).collect();
    assert_eq!(index.len(), cells.cells.len(), "a cell is there twice");
    let mut counts = vec![0; index.len()];
    for (i, p) in (0..).zip(&body.positions).filter(|(_, p)| p.is_finite()) {
        let at: usize = index[&(*p / edge).floor().to_array().map(|x| x as i64)];
        counts[at] += 1;
        assert!(cells.cells[at].ranges.iter().any(|range| range.contains(&i)), "vertex {i} is left out");
    }
    for (cell, count) in cells.cells.iter().zip(counts) {
        assert_eq!(cell.vertices, count);
        assert!(!cell.ranges.is_empty() && cell.ranges.iter().all(|r| r.start < r.end));
        assert!(cell.ranges.windows(2).all(|w| w[0].end <= w[1].start), "{:?}", cell.ranges);
        assert!(cell.ranges.iter().all(|r| r.end <= body.positions.len() as u64));
    }

    // Each sample is a leaf; of several cells only where it is all that they have.
    let mut owners = vec![Vec::new(); sampled.samples.len()];
    for (i, cell) in cells.cells.iter().enumerate() {
        walk(cell, |_, _, _| {});
        assert_eq!(cell.tree.samples.len(), leaves(cell));
        cell.tree.samples.iter().for_each(|sample| owners[*sample as usize].push(i));
    }
    let parted = sampled.samples.contacts().map_or(&[][..], |contacts| contacts.parted());
    for (sample, owners) in owners.iter().enumerate() {
        // But those of parts that touch another one, which has the cluster.
        let of = parted.iter().find(|[part, _]| *part as usize == sample);
        assert!(owners.is_empty() == of.is_some(), "sample {sample} is of {owners:?}");
        if of.is_some() {
            continue;
        }
        let shared = owners.len() == 1 || owners.iter().all(|cell| leaves(&cells.cells[*cell]) == 1);
        assert!(shared, "sample {sample} is of {owners:?}");
    }
}

#[test]
fn cells_hold_all_vertices_and_name_all_samples() {
    let amphora = Body::generated(Shape::Amphora, 40_000);
    let mut odd = amphora.clone();
    odd.positions[33].x = f64::NAN;
    odd.positions[39_000].z = f64::INFINITY;
    let moved = {
        let mut body = amphora.clone();
        body.positions.iter_mut().for_each(|p| *p = *p * 1e4 - DVec3::new(5e5, 3.0, 4.6e6));
        body
    };
    for body in [amphora.clone(), amphora.shuffled(), odd, moved] {
        for sampling in [
            samples(4000),
            // The handles of the amphora touch its body.
            Sampling { skip: Skip { sheets: false, ..Skip::default() }, ..samples(4000) },
            // Fewer than cells.
            Sampling { grid: Some(64), ..samples(300) },
            Sampling { grouping: Grouping::Level(3), ..samples(2000) },
            Sampling { splitting: Splitting::Octree, ..samples(2000) },
            Sampling { target: Target::Error(3e-3), ..Sampling::default() },
        ] {
            let saved = Saved::new(&body, sampling);
            assert!(SampledModel::kept_cells(&saved.folder()).is_some());
            let (sampled, cells) = (saved.load(), saved.cells());
            check(&cells, &sampled, &body);
        }
    }
}

#[test]
fn cells_below_the_target_share_their_samples() {
    let body = Body::generated(Shape::Amphora, 40_000).without_faces();
    let saved = Saved::new(&body, Sampling { grid: Some(64), ..samples(300) });
    let (sampled, cells) = (saved.load(), saved.cells());
    assert!(sampled.samples.len() <= 300 && cells.cells.len() > 1000);
    assert!(cells.cells.iter().all(|c| leaves(c) == 1));
}

#[test]
fn trees_go_down_to_the_error_bound_and_no_further() {
    let body = Body::generated(Shape::Amphora, 60_000).without_faces();
    for splitting in [Splitting::VolumeSurface, Splitting::Octree] {
        for (e, grid) in [(2e-3, None), (1e-2, Some(64))] {
            let sampling = Sampling { target: Target::Error(e), grid, splitting, ..Sampling::default() };
            let saved = Saved::new(&body, sampling);
            let (sampled, cells) = (saved.load(), saved.cells());
            let bound = (e * sampled.local_diagonal()) as f32;
            let mut split = 0;
            for cell in &cells.cells {
                walk(cell, |error, _, leaf| {
                    assert_eq!(leaf, error <= bound, "an error of {error} at a bound of {bound}");
                    split += usize::from(!leaf);
                });
            }
            assert!(grid.is_some() || split > 100, "{split} nodes are split");

            // Each vertex has a sample of its own cell within the reach that this leaves.
            let edge = 2f64.powi(cells.level);
            let index: std::collections::BTreeMap<_, _> =
                cells.cells.iter().map(|cell| (cell.key, cell)).collect();
            let reach = f64::from(bound) / REACH_WEIGHT + 1e-5;
            for p in &body.positions {
                let cell = index[&(*p / edge).floor().to_array().map(|x| x as i64)];
                let local = sampled.frame.to_local(*p);
                let mut own = cell.tree.samples.iter().map(|i| sampled.samples.positions[*i as usize]);
                assert!(own.any(|q| f64::from(q.distance(local)) <= reach), "{p} is left alone");
            }
        }
    }
}

/// Without groups, a sample stays in the cell of the vertices that it stands for.
#[test]
fn samples_are_in_their_cells() {
    let body = Body::generated(Shape::Amphora, 60_000).without_faces();
    let saved = Saved::new(&body, samples(5000));
    let (sampled, cells) = (saved.load(), saved.cells());
    let edge = 2f64.powi(cells.level);
    let mut alone = 0;
    for cell in cells.cells.iter().filter(|cell| leaves(cell) > 1) {
        for i in &cell.tree.samples {
            let p = sampled.samples.positions[*i as usize];
            let place = sampled.frame.to_model(p) / edge - DVec3::from_array(cell.key.map(|k| k as f64));
            assert!(place.min_element() > -1e-4 && place.max_element() < 1.0 + 1e-4, "{place}");
            alone += 1;
        }
    }
    assert!(alone > 4000);
}

#[test]
fn a_file_that_is_missing_or_damaged_is_made_again() {
    let body = Body::generated(Shape::Amphora, 30_000);
    for sampling in [
        samples(2000),
        Sampling { grid: Some(20), splitting: Splitting::Octree, ..samples(2000) },
        Sampling { grouping: Grouping::Level(2), ..samples(2000) },
        Sampling { target: Target::Error(4e-3), ..Sampling::default() },
        Sampling { skip: Skip { triangles: true, ..Skip::default() }, ..samples(2000) },
    ] {
        let saved = Saved::new(&body, sampling);
        let (names, bytes, cells) = (saved.names(), saved.bytes(), saved.cells());
        let foreign = Saved::new(&body, samples(1000)).bytes();
        let flipped = |at: usize| {
            let mut bytes = bytes.clone();
            bytes[at] ^= 1;
            bytes
        };
        let damaged = [
            Some(bytes[..bytes.len() - 1].to_vec()),
            Some(bytes[..bytes.len() / 2].to_vec()),
            Some(Vec::new()),
            Some(flipped(0)),
            Some(flipped(bytes.len() / 2)),
            Some(flipped(bytes.len() - 1)),
            Some([&bytes[..], &[0]].concat()),
            None,
        ];
        for damage in damaged {
            match damage {
                Some(damage) => write(&saved.file(), &damage),
                None => fs::remove_file(saved.file()).unwrap(),
            }
            assert!(SampledModel::kept_cells(&saved.folder()).is_none());
            assert!(saved.cells() == cells);
            assert!(saved.bytes() == bytes, "{sampling:?}: the file is not what it was");
            assert_eq!(saved.names(), names);
        }
        // Whole, but of other samples.
        write(&saved.file(), &foreign);
        assert!(saved.cells() == cells && saved.bytes() == bytes);
    }
}

#[test]
fn what_waited_in_a_file_is_made_again_in_memory() {
    let body = Body::generated(Shape::Amphora, 500_000).without_faces().shuffled();
    let saved = Saved::new(
        &body,
        Sampling { memory_limit: Some(33 << 20), grouping: Grouping::Never, ..samples(3000) },
    );
    let bytes = saved.bytes();
    fs::remove_file(saved.file()).unwrap();
    saved.cells();
    assert!(saved.bytes() == bytes);
}

#[test]
fn a_model_that_has_changed_has_no_such_cells() {
    let body = Body::generated(Shape::BumpySphere, 20_000);
    let mut moved = body.clone();
    moved.positions[12_345].x += 1e-9;
    let mut turned = body.clone();
    turned.normals[777] = -turned.normals[777];
    let shorter = Body::generated(Shape::BumpySphere, 19_000);
    for changed in [moved, turned, shorter, body.shuffled()] {
        let saved = Saved::new(&body, samples(1000));
        fs::remove_file(saved.file()).unwrap();
        let names = saved.names();
        changed.write(&saved.model());
        let error = saved.load().cells_or_resample(&saved.folder(), None, &Silent).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Mismatch);
        assert!(error.to_string().contains("model.ply changed since it was sampled"), "{error}");
        assert!(error.hint().contains("sample it again"), "{}", error.hint());
        assert_eq!(saved.names(), names, "something was written");
        // Back again, all is well.
        body.write(&saved.model());
        saved.cells();
    }
}

#[test]
fn a_model_that_is_gone_has_no_cells_to_be_made() {
    let saved = Saved::new(&Body::generated(Shape::BumpySphere, 5000), samples(500));
    fs::remove_file(saved.model()).unwrap();
    // As long as the file is there, the model is not needed.
    saved.cells();
    fs::remove_file(saved.file()).unwrap();
    let error = saved.load().cells_or_resample(&saved.folder(), None, &Silent).unwrap_err();
    assert!(error.to_string().contains("model.ply is gone"), "{error}");
}

#[test]
fn what_found_no_room_in_groups_is_made_again() {
    let body = Body::generated(Shape::Amphora, 500_000).without_faces().shuffled();
    let grouping = Grouping::Level(6);
    let sampling = Sampling { memory_limit: Some(33 << 20), grouping, ..samples(3000) };
    let saved = Saved::new(&body, sampling);
    let before = saved.load().cells_or_resample(&saved.folder(), None, &Silent).unwrap();
    std::fs::remove_file(saved.folder().join("cells.bin")).unwrap();
    assert_eq!(saved.load().cells_or_resample(&saved.folder(), None, &Silent).unwrap(), before);
}
