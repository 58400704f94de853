//! Deformed models that are written in parts, in any order and as often as one likes: the same bytes as at
//! once.

#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::{
    Method, Normals, Part, Reconstruction, SharedTarget, Version, join_parts, reconstruct, write_part,
};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, count, sample, sample_counted};
use simod_generate::{ModelOptions, write_file as generate};
use simod_model::output::write_file;
use simod_model::progress::Silent;
use simod_model::{Conversion, Converted, Division, ErrorKind, Model, Progress, Result};
use tempfile::TempDir;

struct Work {
    folder: TempDir,
    model: Box<dyn Model>,
    sampled: SampledModel,
    deformed: DeformedPositions,
}

impl Work {
    /// An amphora in a format, with a few vertices that are nowhere.
    fn new(extension: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let [made, path] = ["made.ply", &format!("model.{extension}")].map(|name| folder.path().join(name));
        let options = ModelOptions { vertices: 230_000, ..ModelOptions::default() };
        generate(&options, &made, &Silent).unwrap();
        let open = |path: &Path| simod_model::open(path).unwrap();
        if extension == "ply" {
            fs::rename(&made, &path).unwrap();
        } else {
            let how = Conversion { lossy: true, ..Conversion::default() };
            Converted::new(open(&made), &path, how, &Silent).unwrap().write(&path, &Silent).unwrap();
            fs::remove_file(made).unwrap();
        }
        let model = open(&path);
        let sampling = Sampling { target: Target::Samples(500), ..Sampling::default() };
        let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent).unwrap();
        let bend = |p: &Vec3| *p + Vec3::new(0.1 * p.y * p.y, 0.0, 0.1 * p.x);
        let deformed = sampled.samples.positions.iter().map(bend).collect::<Vec<_>>().into();
        Self { folder, model, sampled, deformed }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn files(&self) -> usize {
        fs::read_dir(self.folder.path()).unwrap().count()
    }

    fn whole(&self, how: &Reconstruction<'_>) -> Vec<u8> {
        let output = self.path("whole");
        let version = Version { deformed: &self.deformed, output: &output, diagnostics: None };
        reconstruct(&self.sampled, &*self.model, &[version], how, &Silent).unwrap();
        let bytes = fs::read(&output).unwrap();
        fs::remove_file(output).unwrap();
        bytes
    }

    fn parts(&self, count: u64) -> Vec<PathBuf> {
        (0..count).map(|part| self.path(&format!("part-{part}"))).collect()
    }

    fn write(
        &self,
        part: u64,
        count: u64,
        how: &Reconstruction<'_>,
        progress: &dyn Progress,
    ) -> Result<bool> {
        let Division { pieces, vertices, .. } = self.model.division(how.normals).unwrap();
        let at = |part: u64| vertices.start + part * (pieces - vertices.start) / count;
        let (own, shared) = (&*self.parts(count)[part as usize], &*self.path("shared"));
        let part = Part { pieces: at(part)..at(part + 1), own, shared: SharedTarget::File(shared) };
        write_part(&self.sampled, &*self.model, &self.deformed, how, &part, progress)
    }

    fn join(&self, parts: &[PathBuf], how: &Reconstruction<'_>) -> Result<Vec<u8>> {
        let output = self.path("joined");
        let version = Version { deformed: &self.deformed, output: &output, diagnostics: None };
        let shared = self.path("shared");
        let files = (parts, SharedTarget::File(&shared));
        let done = join_parts(&self.sampled, &*self.model, &version, how, files, &Silent)?;
        assert_eq!(done.vertices, self.model.info().vertices);
        assert_eq!(done.folding.len(), 1);
        Ok(fs::read(&output).unwrap())
    }

    /// Whether parts share a file.
    fn shares(&self, how: &Reconstruction<'_>) -> bool {
        self.model.division(how.normals).unwrap().in_place
    }
}

#[test]
fn parts_in_any_order_are_the_model_that_is_written_at_once() {
    for extension in ["ply", "laz", "las"] {
        let work = Work::new(extension);
        let both = [(Method::BlendedJets, Normals::Transform), (Method::ProjectedBarycentric, Normals::Drop)];
        for (method, normals) in both {
            let how = Reconstruction { method, normals, ..Reconstruction::default() };
            let whole = work.whole(&how);
            for count in [1, 3, 5] {
                for part in (0..count).rev() {
                    assert!(work.write(part, count, &how, &Silent).unwrap(), "{extension}, part {part}");
                    // Again, there is nothing to be done.
                    let before = fs::read(&work.parts(count)[part as usize]).unwrap();
                    assert!(!work.write(part, count, &how, &Silent).unwrap());
                    // A part that is lost is written again with the same bytes.
                    fs::remove_file(&work.parts(count)[part as usize]).unwrap();
                    assert!(work.write(part, count, &how, &Silent).unwrap());
                    assert!(before == fs::read(&work.parts(count)[part as usize]).unwrap());
                }
                let parts = work.parts(count);
                assert!(work.join(&parts, &how).unwrap() == whole, "{extension} of {count} parts differs");
                assert!(work.join(&parts, &how).unwrap() == whole, "a second time");
                assert!(!work.path("shared").exists());
                fs::remove_file(work.path("joined")).unwrap();
                if work.shares(&how) {
                    let error = work.join(&parts, &how).unwrap_err().to_string();
                    assert!(error.contains("are gone"), "{error}");
                    // A part whose bytes in the shared file are gone is written again.
                    assert!(work.write(0, count, &how, &Silent).unwrap());
                    fs::remove_file(work.path("shared")).unwrap();
                }
                parts.iter().for_each(|part| fs::remove_file(part).unwrap());
            }
            assert_eq!(work.files(), 1, "something is left");
        }
    }
}

#[test]
fn what_is_wrong_with_parts_is_told() {
    ["laz", "las"].into_iter().for_each(check_wrong);
}

fn check_wrong(extension: &str) {
    let work = Work::new(extension);
    let how = Reconstruction::default();
    let parts = work.parts(3);
    (0..3).for_each(|part| assert!(work.write(part, 3, &how, &Silent).unwrap()));
    let whole = work.whole(&how);
    let message = |parts: &[PathBuf], how: &Reconstruction<'_>| {
        let error = work.join(parts, how).unwrap_err();
        assert!(!error.hint().is_empty());
        assert!(!work.path("joined").exists());
        error.to_string()
    };
    assert!(message(&parts[..2], &how).contains("parts of") && message(&[], &how).contains("missing"));
    assert!(message(&parts[1..], &how).contains("not the part that comes next"));
    let swapped = [parts[0].clone(), parts[2].clone(), parts[1].clone()];
    assert!(message(&swapped, &how).contains("not the part that comes next"));
    let drops = Reconstruction { normals: Normals::Drop, ..how };
    assert!(message(&parts, &drops).contains("other options"));
    let good = fs::read(&parts[1]).unwrap();
    for at in [0, good.len() / 2, good.len() - 40, good.len() - 9, good.len() - 8, good.len() - 1] {
        let mut spoilt = good.clone();
        spoilt[at] ^= 1;
        write_file(&parts[1], &spoilt).unwrap();
        assert!(message(&parts, &how).contains("is damaged"), "byte {at}");
    }
    for end in [0, 7, 8, 100, good.len() - 1] {
        write_file(&parts[1], &good[..end]).unwrap();
        assert!(message(&parts, &how).contains("is damaged"), "{end} bytes");
        // A damaged part is written again where that is asked for.
        assert!(work.write(1, 3, &how, &Silent).unwrap());
    }
    fs::remove_file(&parts[1]).unwrap();
    assert!(message(&parts, &how).contains("part-1"));
    assert!(work.write(1, 3, &how, &Silent).unwrap());
    if work.shares(&how) {
        let shared = fs::read(work.path("shared")).unwrap();
        write_file(&work.path("shared"), &shared[..shared.len() - 1]).unwrap();
        assert!(message(&parts, &how).contains("is cut off"));
        assert!(work.write(2, 3, &how, &Silent).unwrap(), "the part that is not all there is written again");
    }
    assert!(work.join(&parts, &how).unwrap() == whole);
}

/// The parts know nothing of each other: together they notice that the model is another one.
#[test]
fn another_model_is_noticed() {
    let mut work = Work::new("ply");
    let how = Reconstruction::default();
    work.sampled.source.fingerprint = "xxh3-128-blocks:0".to_owned();
    (0..3).for_each(|part| assert!(work.write(part, 3, &how, &Silent).unwrap()));
    let error = work.join(&work.parts(3), &how).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Mismatch);
    assert!(error.to_string().contains("changed since it was sampled"), "{error}");
}

#[test]
fn who_cancels_leaves_nothing() {
    struct Cancelling(AtomicU64);
    impl Progress for Cancelling {
        fn begin(&self, _: &str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            self.0.fetch_sub(1, Ordering::Relaxed) <= 1
        }
    }
    let work = Work::new("ply");
    let how = Reconstruction::default();
    for times in 1..4 {
        let error = work.write(0, 1, &how, &Cancelling(AtomicU64::new(times))).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Cancelled);
        // The shared file stays, for the other parts.
        assert!(work.files() <= 2 && !work.parts(1)[0].exists());
    }
}

#[test]
fn counts_of_ranges_add_up() {
    for extension in ["ply", "laz"] {
        let work = Work::new(extension);
        let model = &*work.model;
        let sampling = Sampling { target: Target::Samples(500), ..Sampling::default() };
        let vertices = model.info().vertices;
        let whole = sample(model, &sampling, work.folder.path(), &Silent).unwrap();
        for cuts in [vec![], vec![1], vec![100_000, 100_000, 220_001], vec![0, 70_000, 150_001]] {
            let ends: Vec<u64> = [0].into_iter().chain(cuts).chain([vertices]).collect();
            let mut files = Vec::new();
            for (number, pair) in ends.windows(2).enumerate() {
                let path = work.path(&format!("count-{number}"));
                assert!(count(model, &sampling, (pair[0]..pair[1], &path), &Silent).unwrap());
                assert!(!count(model, &sampling, (pair[0]..pair[1], &path), &Silent).unwrap());
                files.push(path);
            }
            files.reverse();
            let by_parts =
                sample_counted(model, &sampling, Some(&files), work.folder.path(), &Silent).unwrap();
            assert_eq!(by_parts.source, whole.source);
            assert_eq!(by_parts.samples.positions, whole.samples.positions);
            assert_eq!(by_parts.samples.normals(), whole.samples.normals());
            assert_eq!(by_parts.triangles, whole.triangles);
            for (name, sampled) in [("by-parts", &by_parts), ("whole", &whole)] {
                sampled.save(&work.path(name)).unwrap();
            }
            for file in ["simod.toml", "samples.ply", "cells.bin"] {
                let [a, b] = ["by-parts", "whole"].map(|name| fs::read(work.path(name).join(file)).unwrap());
                assert!(a == b, "{file} differs");
            }
            let refused = |files: &[PathBuf], sampling: &Sampling| {
                let folder = work.folder.path();
                let error = sample_counted(model, sampling, Some(files), folder, &Silent).err().unwrap();
                error.to_string()
            };
            assert!(refused(&[], &sampling).contains("not of each vertex once"));
            if files.len() > 1 {
                assert!(refused(&files[1..], &sampling).contains("not of each vertex once"));
                let twice = [&files[..], &files[..1]].concat();
                assert!(refused(&twice, &sampling).contains("not of each vertex once"));
            }
            let finer = Sampling { grid: Some(37), ..sampling };
            assert!(refused(&files, &finer).contains("for other samples"));
            let good = fs::read(&files[0]).unwrap();
            for at in [0, 9, good.len() / 2, good.len() - 1] {
                let mut spoilt = good.clone();
                spoilt[at] ^= 1;
                write_file(&files[0], &spoilt).unwrap();
                assert!(refused(&files, &sampling).contains("is damaged"), "byte {at}");
            }
            files.iter().for_each(|file| fs::remove_file(file).unwrap());
        }
    }
}
