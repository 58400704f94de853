//! Sampling by units, in any order and more than once: the samples, and all that is kept with them, are those
//! of one reading.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once};

use glam::DVec3;
use simod_core::sampling::divided::{
    UnitDivision, cluster, cluster_shared, exchanged_at_most, merge_counts, ranges_of, reads_faces,
    sample_clustered, shared, undivided,
};
use simod_core::sampling::divided_faces::{self, FaceFiles, face_ranges_of, faces_exchanged_at_most};
use simod_core::sampling::face_runs::{self, have_to_be_found};
use simod_core::sampling::{By, Grouping, Placement, Sampling, Skip, Target, count, sample};
use simod_generate::Shape;
use simod_model::output::write_file;
use simod_model::progress::Silent;
use simod_model::{Conversion, Converted, ErrorKind, Model, Progress, Result};
use tempfile::TempDir;

use crate::body::Body;

/// Number of vertices: more than twenty pieces of the stream.
const VERTICES: u64 = 140_000;

struct Work {
    folder: TempDir,
    model: Box<dyn Model>,
    sampling: Sampling,
    units: u64,
    /// Ranges of the faces.
    face_units: u64,
}

/// Files on the faces that units leave each other.
struct OfFaces {
    runs: PathBuf,
    cut: PathBuf,
    lists: [Vec<PathBuf>; 4],
}

impl OfFaces {
    fn files(&self) -> FaceFiles<'_> {
        let [leaves, leaves_of_groups, members, faces] = &self.lists;
        FaceFiles { runs: &self.runs, cut: &self.cut, leaves, leaves_of_groups, members, faces }
    }
}

impl Work {
    fn new(body: &Body, sampling: Sampling) -> Self {
        Self::of_format(body, "ply", sampling)
    }

    fn of_format(body: &Body, extension: &str, sampling: Sampling) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut path = folder.path().join("model.ply");
        body.write(&path);
        if extension != "ply" {
            let (made, open) = (path, |path: &Path| simod_model::open(path).unwrap());
            path = folder.path().join(format!("model.{extension}"));
            let how = Conversion { lossy: true, ..Conversion::default() };
            Converted::new(open(&made), &path, how, &Silent).unwrap().write(&path, &Silent).unwrap();
            fs::remove_file(made).unwrap();
        }
        Self::of_file(folder, &path, sampling)
    }

    /// Work on a file, or on several by their pattern, in a folder that has nothing else.
    fn of_file(folder: TempDir, path: &Path, sampling: Sampling) -> Self {
        let model = simod_model::open(path).unwrap();
        Self { folder, model, sampling, units: 0, face_units: 0 }
    }

    /// Work on faces with these corners in the place of the body's triangles.
    fn of_polygons(body: &Body, faces: &[Vec<u32>], sampling: Sampling) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        write_file(&path, &polygon_file(body, faces)).unwrap();
        Self::of_file(folder, &path, sampling)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn files(&self, name: &str) -> Vec<PathBuf> {
        (0..self.units).map(|unit| self.path(&format!("{name}-{unit}"))).collect()
    }

    /// Counts the vertices in ranges that have nothing to do with pieces.
    fn count(&mut self, units: u64) {
        self.units = units;
        let all = self.model.info().vertices;
        let files: Vec<_> = (0..units).zip(self.files("count")).collect();
        for (unit, file) in files.into_iter().rev() {
            let range = all * unit / units..all * (unit + 1) / units;
            assert!(count(&*self.model, &self.sampling, (range, &file), &Silent).unwrap());
        }
        let counted = self.files("count");
        let merge = || merge_counts(&*self.model, &self.sampling, &counted, &self.path("counts")).unwrap();
        assert!(merge() && !merge());
        self.units = ranges_of(&*self.model, units);
        self.face_units = face_ranges_of(&*self.model, units);
    }

    fn of_faces(&self) -> OfFaces {
        let [leaves, leaves_of_groups, members] =
            ["leaves", "leaves-of-group", "members"].map(|name| self.files(name));
        let faces = (0..self.face_units).map(|unit| self.path(&format!("faces-{unit}"))).collect();
        OfFaces {
            runs: self.path("runs"),
            cut: self.path("cut"),
            lists: [leaves, leaves_of_groups, members, faces],
        }
    }

    fn with_faces(&self) -> bool {
        reads_faces(&*self.model, &self.sampling).unwrap()
    }

    /// Makes the cut, by which other units find the samples of vertices and the findings in faces.
    fn cut_for_faces(&self) -> Result<bool> {
        let counts = self.path("counts");
        let division = UnitDivision { counts: &counts, units: self.units };
        let (ranges, groups) = (self.files("range"), self.files("group"));
        let files = (&ranges[..], &groups[..]);
        let (target, folder) = (self.path("cut"), self.folder.path());
        divided_faces::cut(&*self.model, &self.sampling, &division, files, &target, folder, &Silent)
    }

    fn members(&self, unit: u64) -> Result<bool> {
        let counts = self.path("counts");
        let division = (&UnitDivision { counts: &counts, units: self.units }, unit);
        let (files, target) = (self.of_faces(), self.path(&format!("members-{unit}")));
        let (model, folder) = (&*self.model, self.folder.path());
        divided_faces::members(model, &self.sampling, division, &files.files(), &target, folder, &Silent)
    }

    fn faces(&self, unit: u64) -> Result<bool> {
        let counts = self.path("counts");
        let division = (&UnitDivision { counts: &counts, units: self.units }, unit);
        let (files, target) = (self.of_faces(), self.path(&format!("faces-{unit}")));
        let (model, folder) = (&*self.model, self.folder.path());
        divided_faces::faces(model, &self.sampling, division, &files.files(), &target, folder, &Silent)
    }

    fn range(&self, unit: u64) -> Result<bool> {
        let counts = self.path("counts");
        let division = UnitDivision { counts: &counts, units: self.units };
        let [trees, vertices, leaves] =
            ["range", "shared", "leaves"].map(|name| self.path(&format!("{name}-{unit}")));
        let (model, folder) = (&*self.model, self.folder.path());
        cluster(model, &self.sampling, (&division, unit), (&trees, &vertices, &leaves), folder, &Silent)
    }

    fn group(&self, unit: u64) -> Result<bool> {
        self.group_watched(unit, &Silent)
    }

    fn group_watched(&self, unit: u64, progress: &dyn Progress) -> Result<bool> {
        let counts = self.path("counts");
        let division = UnitDivision { counts: &counts, units: self.units };
        let [trees, leaves] = ["group", "leaves-of-group"].map(|name| self.path(&format!("{name}-{unit}")));
        let (model, folder) = (&*self.model, self.folder.path());
        let files = (&*trees, &*leaves);
        cluster_shared(
            model,
            &self.sampling,
            (&division, unit),
            &self.files("shared"),
            files,
            folder,
            progress,
        )
    }

    fn cut(&self, progress: &dyn Progress) -> Result<()> {
        let counts = self.path("counts");
        let division = UnitDivision { counts: &counts, units: self.units };
        let (ranges, groups) = (self.files("range"), self.files("group"));
        let (model, folder) = (&*self.model, self.folder.path());
        let files = (&ranges[..], &groups[..]);
        let sampled = if self.with_faces() {
            let files = self.of_faces();
            divided_faces::complete(model, &self.sampling, &division, &files.files(), folder, progress)
        } else {
            sample_clustered(model, &self.sampling, &division, files, folder, progress)
        };
        sampled?.save(&self.path("divided.simod"))
    }

    /// Does all stages by `units` units, each stage from its end, and twice; returns the notes of the last
    /// one.
    fn by_units(&mut self, units: u64) -> Vec<String> {
        self.count(units);
        for unit in (0..self.units).rev() {
            assert!(self.range(unit).unwrap() && !self.range(unit).unwrap());
        }
        for unit in (0..self.units).rev() {
            assert!(self.group(unit).unwrap() && !self.group(unit).unwrap());
        }
        if self.with_faces() {
            if have_to_be_found(&*self.model) {
                let find = || face_runs::find(&*self.model, &self.path("runs"), &Silent).unwrap();
                assert!(find() && !find());
            }
            assert!(self.cut_for_faces().unwrap() && !self.cut_for_faces().unwrap());
            for unit in (0..self.units).rev() {
                assert!(self.members(unit).unwrap() && !self.members(unit).unwrap());
            }
            for unit in (0..self.face_units).rev() {
                assert!(self.faces(unit).unwrap() && !self.faces(unit).unwrap());
            }
            let lists = self.of_faces().lists.concat();
            let bytes: u64 =
                lists.iter().filter_map(|file| file.metadata().ok()).map(|file| file.len()).sum();
            // Triangles and links of each unit, whose size is that of P_S, are not counted in the bound.
            let at_most = faces_exchanged_at_most(&*self.model, &self.sampling).unwrap();
            assert!(bytes <= at_most + 100_000 * (self.units + 1), "{bytes} of {at_most}");
        }
        let notes = Notes::default();
        self.cut(&notes).unwrap();
        let notes = notes.0.into_inner().unwrap();
        let (shared, at_most) = (self.shared(), exchanged_at_most(&*self.model));
        let bytes: u64 = self.files("shared").iter().map(|file| file.metadata().unwrap().len()).sum();
        // Beside the vertices there are a few bytes for each piece and block.
        assert!(bytes <= at_most.min(shared * 38) + 500 * (self.units + 1) * (self.units + 1), "{bytes}");
        notes
    }

    fn shared(&self) -> u64 {
        let counts = self.path("counts");
        let division = UnitDivision { counts: &counts, units: self.units };
        shared(&*self.model, &self.sampling, &division, self.folder.path(), &Silent).unwrap()
    }

    /// Removes the files that units have left, and compares the samples with those of one reading.
    fn compare(&self, what: &str) {
        let of_faces = ["leaves", "leaves-of-group", "members", "faces"];
        for name in ["count", "range", "shared", "group"].into_iter().chain(of_faces) {
            let files = (0..100).map(|unit| self.path(&format!("{name}-{unit}")));
            files.filter(|file| file.exists()).for_each(|file| fs::remove_file(file).unwrap());
        }
        fs::remove_file(self.path("counts")).unwrap();
        ["cut", "runs"].into_iter().for_each(|name| drop(fs::remove_file(self.path(name))));
        let whole = self.path("whole.simod");
        if !whole.exists() {
            let sampled = sample(&*self.model, &self.sampling, self.folder.path(), &Silent).unwrap();
            assert!(sampled.samples.len() > 20);
            sampled.save(&whole).unwrap();
        }
        let divided = self.path("divided.simod");
        // The last ones are where they are wanted, and where parts touch.
        for file in ["samples.ply", "simod.toml", "cells.bin", "sheets.bin"] {
            let [whole, divided] = [&whole, &divided].map(|folder| fs::read(folder.join(file)).ok());
            assert!(whole == divided, "{file} differs: {what}");
        }
        fs::remove_dir_all(divided).unwrap();
        // The model and its samples.
        assert_eq!(fs::read_dir(self.folder.path()).unwrap().count(), 2, "something is left: {what}");
    }

    fn check(&mut self, what: &str) {
        for units in [2, 5, 40] {
            assert_eq!(self.by_units(units), Vec::<String>::new(), "{what}");
            self.compare(&format!("{what}, {units} units"));
        }
    }
}

/// Notes that work reports.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Progress for Notes {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, _bytes: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
    fn note(&self, text: &str) {
        self.0.lock().unwrap().push(text.to_owned());
    }
}

/// While a group is clustered, another process does it from the beginning to the end.
struct Overtaken<'a> {
    work: &'a Work,
    group: u64,
    once: Once,
}

impl Progress for Overtaken<'_> {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, _bytes: u64) {
        self.once.call_once(|| assert!(self.work.group(self.group).unwrap(), "the other one is first"));
    }
    fn is_cancelled(&self) -> bool {
        false
    }
}

fn amphora() -> Body {
    Body::generated(Shape::Amphora, VERTICES).without_faces()
}

fn samples(n: u64) -> Sampling {
    Sampling { target: Target::Samples(n), ..Sampling::default() }
}

#[test]
fn units_sample_as_one_reading_does() {
    let body = amphora();
    for (name, body) in [("in order", body.clone()), ("in no order", body.shuffled())] {
        Work::new(&body, samples(3000)).check(name);
        Work::new(&body.without_normals(), samples(300)).check(&format!("{name}, without normals"));
    }
    let error = Sampling { target: Target::Error(2e-3), ..Sampling::default() };
    Work::new(&body, error).check("to an error");
    let area = Sampling { by: By::Area, grid: Some(64), ..samples(5000) };
    Work::new(&body.shuffled(), area).check("by area");
}

/// A unit may be given to a second machine while the first one, which is taken for lost, goes on with it. The
/// depth of the trees depends on the threads, and files that others have made by the first ones have to go on
/// to fit.
#[test]
fn what_another_process_has_left_meanwhile_stays() {
    let mut work = Work::new(&amphora().shuffled(), samples(3000));
    work.count(2);
    (0..work.units).for_each(|unit| assert!(work.range(unit).unwrap()));
    for group in 0..work.units {
        let overtaken = Overtaken { work: &work, group, once: Once::new() };
        let trees = work.path(&format!("group-{group}"));
        assert!(!work.group_watched(group, &overtaken).unwrap(), "group {group} is left by the other one");
        let left = fs::metadata(&trees).unwrap().modified().unwrap();
        assert!(!work.group(group).unwrap());
        assert_eq!(fs::metadata(&trees).unwrap().modified().unwrap(), left);
    }
    work.cut(&Silent).unwrap();
    work.compare("overtaken");
}

/// Sums depend on the order in which vertices are added up: on pieces, and on the stream within them.
#[test]
fn units_add_groups_up_as_one_reading_does() {
    let body = amphora();
    for level in [0, 2, 4] {
        let sampling = Sampling { grouping: Grouping::Level(level), ..samples(1000) };
        Work::new(&body, sampling).check(&format!("in order, level {level}"));
        Work::new(&body.shuffled(), sampling).check(&format!("in no order, level {level}"));
    }
    // Rows of two halves in turns: the stream leaves each cell and comes back.
    let n = body.positions.len();
    let turns = |i: usize| (i / 7 * 7 + (i % 7) * (n / 14)) % n;
    let positions = (0..n).map(|i| body.positions[turns(i)]).collect();
    let normals = (0..n).map(|i| body.normals[turns(i)]).collect();
    let turns = Body { positions, normals, ..Body::default() };
    let sampling = Sampling { grouping: Grouping::Level(3), ..samples(1000) };
    Work::new(&turns, sampling).check("in turns");
}

/// The vertices that are open at a time are so many that there are groups, whether these are asked for or
/// not.
#[test]
fn units_know_when_groups_are_needed() {
    let body = Body::generated(Shape::Amphora, 500_000).without_faces().shuffled();
    let mut work = Work::new(&body, samples(500));
    assert_eq!(work.by_units(3), Vec::<String>::new());
    work.compare("automatic groups");
    let described = fs::read_to_string(work.path("whole.simod/simod.toml")).unwrap();
    assert!(described.contains("group-level"), "{described}");
}

#[test]
fn vertices_that_are_nowhere_are_of_no_unit() {
    let mut body = amphora();
    let n = body.positions.len();
    // Around the borders of ranges, all over, and a far one.
    let borders = (0..n).step_by(6144).flat_map(|at| at.saturating_sub(40)..(at + 60).min(n));
    let all: Vec<usize> = borders.chain((0..n).step_by(11)).collect();
    all.into_iter().for_each(|i| body.positions[i] = DVec3::NAN);
    body.positions[77_777] = DVec3::splat(40.0);
    Work::new(&body, samples(2000)).check("as they are");
    let groups = Sampling { grouping: Grouping::Level(3), ..samples(2000) };
    Work::new(&body, groups).check("in groups");
    // A range without any vertex.
    body.positions[30_000..60_000].fill(DVec3::NAN);
    Work::new(&body, groups).check("with a gap");
}

#[test]
fn compressed_blocks_need_not_end_where_ranges_do() {
    let body = amphora().without_normals();
    Work::of_format(&body, "laz", samples(2000)).check("LAZ");
    Work::of_format(&body.shuffled(), "laz", samples(2000)).check("LAZ in no order");
    Work::of_format(&body, "las", samples(2000)).check("LAS");
    Work::of_format(&body, "pcd", samples(2000)).check("PCD");
}

#[test]
fn all_in_one_place_and_few_vertices_are_no_matter() {
    let place = |i: u32| DVec3::new(1.0, 2.0, 3.0 + f64::from(i % 30));
    let body = Body { positions: (0..30_000).map(place).collect(), ..Body::default() };
    Work::new(&body, samples(1000)).check("in a few places");
}

/// A part of the vertices that takes nearly all of the samples: its unit keeps too few, and that is noticed.
#[test]
fn a_part_that_is_too_rich_is_sampled_after_all() {
    let (mut body, mut state) = (Body::default(), 7u64);
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    body.positions = (0..6144).map(|_| DVec3::new(random(), random(), random())).collect();
    let flat = |i: u32| DVec3::new(f64::from(i % 500) * 1e-5, f64::from(i / 500) * 1e-5, 0.5);
    body.positions.extend((0..290_000).map(flat));
    let mut work = Work::new(&body, samples(6000));
    let notes = work.by_units(40);
    assert!(notes.len() == 1 && notes[0].contains("far more of the samples"), "{notes:?}");
    work.compare("a rich part");
}

#[test]
fn groups_without_room_are_no_groups() {
    let body = Body::generated(Shape::Amphora, 300_000).without_faces().shuffled();
    let sampling = Sampling { grouping: Grouping::Level(6), memory_limit: Some(34 << 20), ..samples(3000) };
    let mut work = Work::new(&body, sampling);
    let notes = work.by_units(3);
    assert!(notes.len() == 1 && notes[0].contains("no room"), "{notes:?}");
    work.compare("without room");
    let described = fs::read_to_string(work.path("whole.simod/simod.toml")).unwrap();
    assert!(!described.contains("group-level"), "{described}");
}

#[test]
fn what_is_wrong_is_told() {
    let body = amphora();
    let mut work = Work::new(&body, samples(1000));
    let told = |error: simod_model::Error, words: &[&str]| {
        let text = error.to_string();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert_ne!(error.kind(), ErrorKind::Internal);
    };
    work.count(3);
    told(work.range(3).unwrap_err(), &["no part 3 of 3"]);
    told(work.group(0).unwrap_err(), &["shared-0"]);
    (0..2).for_each(|unit| assert!(work.range(unit).unwrap()));
    told(work.group(0).unwrap_err(), &["shared-2"]);
    assert!(work.range(2).unwrap());
    (0..3).for_each(|unit| assert!(work.group(unit).unwrap()));
    let samples_of_cut = || {
        work.cut(&Silent).unwrap();
        let samples = fs::read(work.path("divided.simod/samples.ply")).unwrap();
        fs::remove_dir_all(work.path("divided.simod")).unwrap();
        samples
    };
    let expected = samples_of_cut();
    // A damaged file is made again.
    for name in ["range-1", "group-2", "shared-0"] {
        let (file, good) = (work.path(name), fs::read(work.path(name)).unwrap());
        let mut bad = good.clone();
        let at = bad.len() / 2;
        bad[at] ^= 1;
        write_file(&file, &bad).unwrap();
        if name == "shared-0" {
            fs::remove_file(work.path("group-0")).unwrap();
            fs::remove_file(work.path("group-1")).unwrap();
            told((0..2).find_map(|unit| work.group(unit).err()).unwrap(), &[name, "damaged"]);
            fs::remove_file(&file).unwrap();
            assert!(work.range(0).unwrap());
            assert!(work.group(0).unwrap() | work.group(1).unwrap());
            assert!(fs::read(&file).unwrap() == good, "{name} is another one");
        } else {
            told(work.cut(&Silent).unwrap_err(), &[name, "damaged"]);
            assert!(if name == "range-1" { work.range(1) } else { work.group(2) }.unwrap());
        }
        // The trees may hold other clusters below the cut, as timing decides, but the samples are the same.
        assert!(samples_of_cut() == expected, "{name} is another one");
    }
    // Parts of one another's, of other samples, and none.
    let [a, b] = ["range-0", "range-1"].map(|name| fs::read(work.path(name)).unwrap());
    write_file(&work.path("range-0"), &b).unwrap();
    told(work.cut(&Silent).unwrap_err(), &["range-0"]);
    write_file(&work.path("range-0"), &a).unwrap();
    work.sampling.target = Target::Samples(1001);
    told(work.cut(&Silent).unwrap_err(), &["range-0", "other samples"]);
    work.sampling = samples(1000);
    work.cut(&Silent).unwrap();
    fs::remove_file(work.path("group-1")).unwrap();
    told(work.cut(&Silent).unwrap_err(), &["group-1"]);

    // Another vertex of the same cell or of another one.
    let mut other = body.clone();
    other.positions.swap(1000, 100_000);
    other.write(&work.path("model.ply"));
    work.model = simod_model::open(&work.path("model.ply")).unwrap();
    fs::remove_file(work.path("range-0")).unwrap();
    told(work.range(0).unwrap_err(), &["changed while it was read"]);

    let why = |work: &Work| undivided(&*work.model, &work.sampling).unwrap();
    let text = Work::of_format(&Body::generated(Shape::Amphora, 20_000), "off", samples(1000));
    assert!(why(&text).is_some_and(|why| why.contains("faces")));
    let skip = Skip { colors: true, ..Skip::default() };
    assert!(undivided(&*work.model, &Sampling { skip, ..work.sampling }).unwrap().is_none());
}

/// Both the vertices and the faces of it in an order without any coherence.
fn in_no_order(body: &Body) -> Body {
    let mut body = body.shuffled();
    let n = body.faces.len();
    let step = (n * 5 / 13..)
        .find(|step| (2..=*step.min(&1000)).all(|k| !n.is_multiple_of(k) || !step.is_multiple_of(k)))
        .unwrap();
    body.faces = (0..n).map(|i| body.faces[i * step % n]).collect();
    body
}

#[test]
fn units_read_faces_as_one_reading_does() {
    let body = Body::generated(Shape::Amphora, VERTICES);
    let by_faces = Sampling { placement: Placement::Faces, ..samples(3000) };
    for (name, body) in [("in order", body.clone()), ("in no order", in_no_order(&body))] {
        Work::new(&body, by_faces).check(name);
        Work::new(&body.without_normals(), samples(500)).check(&format!("{name}, without normals"));
    }
    let groups = Sampling { grouping: Grouping::Level(3), ..by_faces };
    Work::new(&body.shuffled(), groups).check("in groups");
    let error = Sampling { target: Target::Error(2e-3), ..by_faces };
    Work::new(&body, error).check("to an error");
}

/// A PLY file of polygons.
fn polygon_file(body: &Body, faces: &[Vec<u32>]) -> Vec<u8> {
    let (vertices, normals) = (body.positions.len(), &body.normals);
    let properties = ["x", "y", "z"].iter().map(|name| format!("property double {name}\n"));
    let of_normals = ["nx", "ny", "nz"].iter().filter(|_| !normals.is_empty());
    let properties = properties.chain(of_normals.map(|name| format!("property float {name}\n")));
    let (properties, count) = (properties.collect::<String>(), faces.len());
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\n{properties}element face {count}\n\
         property uchar kind\nproperty list uint int vertex_indices\nend_header\n"
    )
    .into_bytes();
    for (i, p) in body.positions.iter().enumerate() {
        bytes.extend(p.to_array().iter().flat_map(|number| number.to_le_bytes()));
        let normal = normals.get(i).map(|normal| normal.to_array());
        bytes.extend(normal.iter().flatten().flat_map(|number| number.to_le_bytes()));
    }
    for corners in faces {
        bytes.push(7);
        bytes.extend((corners.len() as u32).to_le_bytes());
        bytes.extend(corners.iter().flat_map(|corner| corner.to_le_bytes()));
    }
    bytes
}

/// Two triangles that follow each other as a quad, where they share an edge, and every fifth one as it is.
fn quads(faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let turned = |[a, b, c]: [u32; 3]| [[a, b, c], [b, c, a], [c, a, b]];
    let (mut polygons, mut at) = (Vec::new(), 0);
    while let Some(face) = faces.get(at) {
        let next = faces.get(at + 1).filter(|_| !polygons.len().is_multiple_of(5));
        // A fan about its first corner.
        let quad = next.and_then(|next| {
            let mut both = turned(*face).into_iter().flat_map(|a| turned(*next).map(|b| (a, b)));
            both.find(|([a, _, c], [d, e, _])| [d, e] == [a, c])
        });
        at += if quad.is_some() { 2 } else { 1 };
        polygons.push(quad.map_or_else(|| face.to_vec(), |([a, b, c], [_, _, d])| vec![a, b, c, d]));
    }
    polygons
}

#[test]
fn units_read_polygons_as_one_reading_does() {
    let body = Body::generated(Shape::Amphora, VERTICES);
    let by_faces = Sampling { placement: Placement::Faces, ..samples(3000) };
    for (name, body) in [("in order", body.clone()), ("in no order", body.shuffled())] {
        let mut polygons = quads(&body.faces);
        if name == "in no order" {
            // A prime visits each once.
            let n = polygons.len();
            polygons = (0..n).map(|i| polygons[i * 7919 % n].clone()).collect();
        }
        let mut work = Work::of_polygons(&body, &polygons, by_faces);
        assert!(have_to_be_found(&*work.model) && work.with_faces());
        work.check(&format!("quads {name}"));
        Work::of_polygons(&body.without_normals(), &polygons, samples(500))
            .check(&format!("{name}, without normals"));
    }
    // Faces without a triangle, among them blocks and before the end of a run; faces of more triangles than a
    // run has, and of some that there are not.
    let mut polygons: Vec<Vec<u32>> = body.faces.iter().map(|corners| corners.to_vec()).collect();
    let all = 0..body.positions.len() as u32;
    polygons.insert(100, all.clone().collect());
    polygons.splice(65_000..65_000, vec![vec![1, 2]; 100]);
    for at in [65_536, 2 * 65_536, 100_001] {
        polygons.splice(at..at, vec![vec![]; 40]);
        polygons.insert(at + 20, vec![0, u32::MAX, 3, 70, all.end]);
    }
    polygons.extend(vec![vec![5]; 20]);
    let skip = Skip { triangles: true, ..Skip::default() };
    for sampling in [by_faces, samples(2000), Sampling { skip, ..by_faces }] {
        Work::of_polygons(&body, &polygons, sampling).check("of any length");
    }
    // None of them is a triangle's.
    let edges: Vec<Vec<u32>> = (1..body.faces.len() as u32).map(|i| vec![i % all.end, i / 2]).collect();
    Work::of_polygons(&body, &edges, by_faces).check("edges");
}

#[test]
fn units_read_faces_of_tiles_as_one_reading_does() {
    let folder = tempfile::tempdir().unwrap();
    let tiles = folder.path().join("tiles");
    fs::create_dir(&tiles).unwrap();
    for (number, vertices) in [70_000, 3_000, 40_000, 50_000].into_iter().enumerate() {
        let mut body = Body::generated(Shape::Amphora, vertices);
        body.positions.iter_mut().for_each(|p| p.x += 0.7 * number as f64);
        let path = tiles.join(format!("{number}.ply"));
        match number {
            0 => body.write(&path),
            // A cloud.
            1 => body.without_faces().write(&path),
            _ => write_file(&path, &polygon_file(&body, &quads(&body.faces))).unwrap(),
        }
    }
    let pattern = tiles.join("*.ply");
    let mut work = Work::of_file(folder, &pattern, Sampling { placement: Placement::Faces, ..samples(3000) });
    assert_eq!(undivided(&*work.model, &work.sampling).unwrap(), None);
    work.check("by faces");
    fs::remove_dir_all(work.path("whole.simod")).unwrap();
    work.sampling = samples(500);
    work.check("as they are");
}

#[test]
fn units_find_no_more_than_is_wanted() {
    let body = Body::generated(Shape::Amphora, VERTICES);
    let placed = [Placement::Vertices, Placement::Faces];
    for (triangles, sheets, placement) in [
        (false, true, placed[0]),
        (true, false, placed[0]),
        (true, true, placed[1]),
        (false, true, placed[1]),
    ] {
        let skip = Skip { triangles, sheets, ..Skip::default() };
        let sampling = Sampling { skip, placement, ..samples(2000) };
        Work::new(&body, sampling).check(&format!("{sampling:?}"));
    }
    // Faces have nothing to say.
    let skip = Skip { triangles: true, sheets: true, ..Skip::default() };
    let mut work = Work::new(&body, Sampling { skip, placement: Placement::Vertices, ..samples(2000) });
    assert!(!work.with_faces());
    work.check("without faces");
}

/// Sheets are parted by one unit, which needs to know all vertices' samples and islands.
#[test]
fn parts_that_touch_are_told_apart_as_by_one_reading() {
    let [first, second] = [0.0, 1e-3].map(|gap| {
        let mut body = Body::generated(Shape::Amphora, VERTICES / 2).without_normals();
        body.positions.iter_mut().for_each(|p| *p *= 1.0 + gap);
        body
    });
    let mut body = first;
    let before = body.positions.len() as u32;
    body.positions.extend(second.positions);
    body.faces.extend(second.faces.into_iter().map(|face| face.map(|vertex| vertex + before)));
    for body in [body.clone(), in_no_order(&body)] {
        let mut work = Work::new(&body, samples(1500));
        work.check("one within the other");
        assert!(work.path("whole.simod/sheets.bin").exists());
        let skip = Skip { triangles: true, cells: true, ..Skip::default() };
        Work::new(&body, Sampling { skip, ..samples(1500) }).check("without triangles");
    }
}

#[test]
fn faces_that_are_none_are_of_no_unit() {
    let mut body = Body::generated(Shape::Amphora, VERTICES);
    let n = body.positions.len();
    (0..n).step_by(17).for_each(|i| body.positions[i] = DVec3::NAN);
    let faces = body.faces.len();
    for (i, corner) in [(5, u32::MAX), (70_000, n as u32), (faces - 1, 1 << 31)] {
        body.faces[i][1] = corner;
    }
    (0..faces).step_by(29).for_each(|i| body.faces[i][2] = body.faces[i][0]);
    // A range of faces without any vertex.
    body.faces[65_536..2 * 65_536].fill([u32::MAX - 1; 3]);
    let sampling = Sampling { placement: Placement::Faces, ..samples(2000) };
    Work::new(&body, sampling).check("some of them");
}

/// Faces with vertices of their own each.
fn soup(body: &Body) -> Body {
    let corners = || body.faces.iter().flatten().map(|corner| *corner as usize);
    Body {
        positions: corners().map(|corner| body.positions[corner]).collect(),
        normals: Vec::new(),
        faces: (0..body.faces.len() as u32).map(|face| [0, 1, 2].map(|corner| 3 * face + corner)).collect(),
    }
}

#[test]
fn a_soup_is_divided_whether_its_sheets_are_told_apart_or_not() {
    let body = Body::generated(Shape::Amphora, VERTICES / 6);
    let skip = Skip { sheets: true, ..Skip::default() };
    Work::of_format(&body, "stl", Sampling { skip, ..samples(1000) }).check("STL without sheets");
    Work::of_format(&body, "stl", samples(1000)).check("STL");
    let body = in_no_order(&body);
    Work::of_format(&body, "stl", samples(1000)).check("STL in no order");
    // Vertices at one place are nowhere near each other in the file.
    Work::new(&soup(&body).shuffled(), samples(1000)).check("in no order");
    // Of more vertices than are compared with each other.
    let mut work = Work::new(&soup(&Body::generated(Shape::Amphora, 200_000)), samples(1000));
    assert!(work.model.info().vertices > 1 << 20);
    assert_eq!(work.by_units(5), Vec::<String>::new());
    work.compare("a large one");
}

#[test]
fn parts_of_a_soup_that_touch_are_told_apart_as_by_one_reading() {
    let mut body = soup(&Body::generated(Shape::Amphora, VERTICES / 8));
    let second: Vec<DVec3> = body.positions.iter().map(|p| *p * (1.0 + 1e-3)).collect();
    body.positions.extend(second);
    body.faces =
        (0..body.positions.len() as u32 / 3).map(|face| [0, 1, 2].map(|corner| 3 * face + corner)).collect();
    for body in [body.clone(), body.shuffled()] {
        let mut work = Work::new(&body, samples(1500));
        work.check("one within the other");
        assert!(work.path("whole.simod/sheets.bin").exists());
    }
}

#[test]
fn groups_without_room_are_none_where_faces_are_read() {
    let body = Body::generated(Shape::Amphora, 300_000).shuffled();
    let sampling = Sampling { grouping: Grouping::Level(6), memory_limit: Some(34 << 20), ..samples(3000) };
    let mut work = Work::new(&body, sampling);
    let notes = work.by_units(3);
    assert!(notes.len() == 1 && notes[0].contains("no room"), "{notes:?}");
    work.compare("without room");
}

#[test]
fn what_is_wrong_with_files_of_faces_is_told() {
    let mut work = Work::new(&Body::generated(Shape::Amphora, VERTICES).without_normals(), samples(1000));
    let told = |error: simod_model::Error, words: &[&str]| {
        let text = error.to_string();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert_ne!(error.kind(), ErrorKind::Internal);
    };
    assert_eq!(work.by_units(3), Vec::<String>::new());
    let expected = fs::read(work.path("divided.simod/samples.ply")).unwrap();
    fs::remove_dir_all(work.path("divided.simod")).unwrap();
    told(work.members(3).unwrap_err(), &["no part 3 of 3"]);
    told(work.faces(3).unwrap_err(), &["no part 3 of 3"]);
    // Damaged files are told of by each unit that reads them.
    let damaged = |name: &str, read: &dyn Fn() -> Option<simod_model::Error>| {
        let (file, good) = (work.path(name), fs::read(work.path(name)).unwrap());
        let mut bad = good.clone();
        let at = bad.len() / 2;
        bad[at] ^= 1;
        write_file(&file, &bad).unwrap();
        told(read().unwrap(), &[name, "damaged"]);
        write_file(&file, &good).unwrap();
    };
    damaged("faces-1", &|| work.cut(&Silent).err());
    damaged("members-2", &|| work.cut(&Silent).err());
    damaged("cut", &|| work.cut(&Silent).err());
    for (name, unit) in [("leaves-1", 1), ("leaves-of-group-0", 0)] {
        let again = || {
            // Some of them have vertices of the group.
            (0..3).filter(|other| name != "leaves-1" || *other == unit).find_map(|unit| {
                fs::remove_file(work.path(&format!("members-{unit}"))).ok();
                work.members(unit).err()
            })
        };
        damaged(name, &again);
        (0..3).for_each(|unit| assert!(work.members(unit).is_ok()));
    }
    // Files that belong to other trees are written again, though these trees are as good.
    fs::remove_file(work.path("range-1")).unwrap();
    assert!(work.range(1).unwrap());
    fs::remove_file(work.path("cut")).unwrap();
    assert!(work.cut_for_faces().unwrap());
    (0..3).for_each(|unit| assert!(work.members(unit).is_ok()));
    (0..3).for_each(|unit| assert!(work.faces(unit).is_ok()));
    work.cut(&Silent).unwrap();
    assert!(fs::read(work.path("divided.simod/samples.ply")).unwrap() == expected);
}
