//! Reconstructions that are interrupted anywhere and gone on with: the same bytes, and nothing else is left.

#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use simod_core::deformed_positions::DeformedPositions;
use simod_core::reconstruction::{Normals, Reconstruction, Version, reconstruct};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{SampleSet, Sampling, Target, sample};
use simod_generate::{ModelOptions, PlyEncoding, write_file as generate};
use simod_model::long_list::ListStorage;
use simod_model::progress::Silent;
use simod_model::{ErrorKind, Model, Progress, Result};
use tempfile::TempDir;

/// A sampled model and deformations of it, in a folder of its own.
struct Work {
    folder: TempDir,
    model: Box<dyn Model>,
    sampled: SampledModel,
    deformed: Vec<DeformedPositions>,
}

/// Size of a part in bytes of the model, less than most pieces: so nearly every piece ends a part.
const PART: u64 = 200_000;

impl Work {
    fn new(encoding: PlyEncoding) -> Self {
        Self::of_samples(500, encoding)
    }

    fn of_samples(samples: u64, encoding: PlyEncoding) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        let options = ModelOptions { vertices: 200_000, encoding, ..ModelOptions::default() };
        generate(&options, &path, &Silent).unwrap();
        let model = simod_model::open(&path).unwrap();
        let sampling = Sampling { target: Target::Samples(samples), ..Sampling::default() };
        let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent).unwrap();
        let bent = |version: usize| {
            let bend = |p: &Vec3| *p + Vec3::new(0.1 * version as f32 * p.y * p.y, 0.0, 0.1);
            sampled.samples.positions.iter().map(bend).collect::<Vec<_>>().into()
        };
        let deformed = (0..6).map(bent).collect();
        Self { folder, model, sampled, deformed }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.retain(|name| name != "model.ply");
        names.sort();
        names
    }

    /// Writes the versions of these numbers: out-0, out-1, and so on. Returns the bytes that were taken over.
    fn write(&self, versions: &[usize], how: &Reconstruction, progress: &dyn Progress) -> Result<u64> {
        let outputs: Vec<PathBuf> = versions.iter().map(|v| self.path(&format!("out-{v}"))).collect();
        let versions: Vec<Version<'_>> = versions
            .iter()
            .zip(&outputs)
            .map(|(v, output)| Version { deformed: &self.deformed[*v], output, diagnostics: None })
            .collect();
        Ok(reconstruct(&self.sampled, self.model.as_ref(), &versions, how, progress)?.taken_over)
    }

    /// The bytes of the versions, each written alone, which leaves no file.
    fn expected(&self, versions: &[usize], normals: Normals) -> Vec<Vec<u8>> {
        let one = |v: &usize| {
            self.write(&[*v], &Reconstruction { normals, ..Reconstruction::default() }, &Silent).unwrap();
            let path = self.path(&format!("out-{v}"));
            let bytes = fs::read(&path).unwrap();
            fs::remove_file(path).unwrap();
            bytes
        };
        versions.iter().map(one).collect()
    }

    fn check(&self, versions: &[usize], expected: &[Vec<u8>]) {
        let names: Vec<String> = versions.iter().map(|v| format!("out-{v}")).collect();
        assert_eq!(self.names(), names);
        for (name, expected) in names.iter().zip(expected) {
            assert!(fs::read(self.path(name)).unwrap() == *expected, "{name} has other bytes");
            fs::remove_file(self.path(name)).unwrap();
        }
    }
}

fn how(resume: bool) -> Reconstruction<'static> {
    Reconstruction { resume, part_bytes: PART, ..Reconstruction::default() }
}

/// Names and contents.
type Files = Vec<(PathBuf, Vec<u8>)>;

/// Copies of all hidden files, taken each time that anything is reported: the files that a process leaves
/// which is killed then.
struct Snapshots<'a> {
    folder: &'a Path,
    taken: Mutex<Vec<Files>>,
}

impl<'a> Snapshots<'a> {
    fn new(folder: &'a Path) -> Self {
        Self { folder, taken: Mutex::default() }
    }

    fn take(&self) {
        let mut found = Vec::new();
        let mut paths: Vec<PathBuf> = fs::read_dir(self.folder).unwrap().map(|e| e.unwrap().path()).collect();
        // The journal before the part that it speaks of, as the work goes on meanwhile.
        paths.sort();
        for path in paths.into_iter().filter(|p| !p.ends_with("model.ply")) {
            if let Ok(bytes) = fs::read(&path) {
                found.push((path, bytes));
            }
        }
        self.taken.lock().unwrap().push(found);
    }

    /// Puts them back, one after the other.
    fn for_each(self, mut then: impl FnMut()) {
        for files in self.taken.into_inner().unwrap() {
            for (path, bytes) in files {
                put(&path, &bytes);
            }
            then();
        }
    }
}

/// The work waits for its journals here, so that each state of them is seen.
impl Progress for Snapshots<'_> {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {
        self.take();
    }
    fn advance(&self, _bytes: u64) {
        std::thread::sleep(std::time::Duration::from_millis(30));
        self.take();
    }
    fn is_cancelled(&self) -> bool {
        false
    }
}

fn put(path: &Path, bytes: &[u8]) {
    use std::io::Write;
    fs::File::create(path).unwrap().write_all(bytes).unwrap();
}

/// Collector of notes, which cancels after so many bytes.
struct Watch {
    cancel_after: u64,
    done: AtomicU64,
    notes: Mutex<Vec<String>>,
}

impl Watch {
    fn new(cancel_after: u64) -> Self {
        Self { cancel_after, done: AtomicU64::new(0), notes: Mutex::default() }
    }

    fn note(&self) -> String {
        self.notes.lock().unwrap().join("\n")
    }
}

impl Progress for Watch {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, bytes: u64) {
        self.done.fetch_add(bytes, Ordering::Relaxed);
    }
    fn is_cancelled(&self) -> bool {
        self.done.load(Ordering::Relaxed) >= self.cancel_after
    }
    fn note(&self, text: &str) {
        self.notes.lock().unwrap().push(text.to_owned());
    }
}

#[test]
fn killed_anywhere_it_goes_on_to_the_same_bytes() {
    let cases: [(&[usize], PlyEncoding, Normals); 4] = [
        (&[1], PlyEncoding::BinaryLittleEndian, Normals::Transform),
        (&[1, 2, 3], PlyEncoding::BinaryLittleEndian, Normals::Drop),
        (&[2], PlyEncoding::Ascii, Normals::Keep),
        // Six take two readings.
        (&[0, 1, 2, 3, 4, 5], PlyEncoding::BinaryBigEndian, Normals::Transform),
    ];
    for (versions, encoding, normals) in cases {
        let work = Work::new(encoding);
        let expected = work.expected(versions, normals);
        let snapshots = Snapshots::new(work.folder.path());
        work.write(versions, &Reconstruction { normals, ..how(false) }, &snapshots).unwrap();
        work.check(versions, &expected);
        let mut taken_over = Vec::new();
        snapshots.for_each(|| {
            taken_over.push(work.write(versions, &Reconstruction { normals, ..how(true) }, &Silent).unwrap());
            work.check(versions, &expected);
        });
        // Not always from the beginning, and ever later.
        taken_over.dedup();
        assert!(taken_over.len() > 3 && taken_over.is_sorted(), "{taken_over:?}");
    }
}

#[test]
fn without_resume_leftovers_are_replaced() {
    let work = Work::new(PlyEncoding::BinaryLittleEndian);
    let expected = work.expected(&[1, 2], Normals::Transform);
    let snapshots = Snapshots::new(work.folder.path());
    work.write(&[1, 2], &how(false), &snapshots).unwrap();
    work.check(&[1, 2], &expected);
    snapshots.for_each(|| {
        assert_eq!(work.write(&[1, 2], &how(false), &Silent).unwrap(), 0);
        work.check(&[1, 2], &expected);
    });
}

/// Interrupts version 1 past its middle, with the parts kept; returns the paths of the hidden files.
fn interrupted(work: &Work, how: &Reconstruction) -> (PathBuf, PathBuf) {
    let watch = Watch::new(work.model.info().bytes * 2 / 3);
    let error = work.write(&[1], how, &watch).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled);
    assert!(error.hint().contains("--resume"), "{}", error.hint());
    assert_eq!(work.names(), [".simod-out-1.journal", ".simod-out-1.part"]);
    (work.path(".simod-out-1.part"), work.path(".simod-out-1.journal"))
}

#[test]
fn cancelling_keeps_parts_only_where_they_are_wanted() {
    let work = Work::new(PlyEncoding::BinaryLittleEndian);
    let expected = work.expected(&[1], Normals::Transform);
    let bytes = work.model.info().bytes;
    for after in [0, bytes / 2, bytes - 1] {
        let error = work.write(&[1], &how(false), &Watch::new(after)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Cancelled);
        assert!(!error.hint().contains("--resume"));
        assert!(work.names().is_empty());
    }
    // A call that has finished no part has nothing to keep.
    let error = work.write(&[1], &how(true), &Watch::new(0)).unwrap_err();
    assert!(!error.hint().contains("--resume"));
    assert!(work.names().is_empty());

    interrupted(&work, &how(true));
    // Again and again: while it is checked, and later.
    for after in [1, PART, bytes, 2 * bytes / 3 + bytes / 2] {
        let watch = Watch::new(after);
        let error = work.write(&[1], &how(true), &watch).unwrap_err();
        assert!(error.hint().contains("--resume"), "{}", error.hint());
        assert_eq!(watch.note(), "");
    }
    assert!(work.write(&[1], &how(true), &Silent).unwrap() > bytes / 3);
    work.check(&[1], &expected);
}

#[test]
fn what_is_damaged_is_done_again() {
    let work = Work::new(PlyEncoding::BinaryLittleEndian);
    let expected = work.expected(&[1], Normals::Transform);
    let (part, journal) = interrupted(&work, &how(true));
    let (bytes, record) = (fs::read(&part).unwrap(), fs::read(&journal).unwrap());
    let resumed = |watch: &Watch| {
        let taken_over = work.write(&[1], &how(true), watch).unwrap() as usize;
        work.check(&[1], &expected);
        taken_over
    };
    put(&part, &bytes);
    put(&journal, &record);
    let watch = Watch::new(u64::MAX);
    assert_eq!(resumed(&watch), bytes.len());
    assert_eq!(watch.note(), "");
    for at in [0, bytes.len() / 2, bytes.len() - 1] {
        for cut in [false, true] {
            let mut spoilt = bytes.clone();
            spoilt[at] ^= 0x10;
            if cut {
                spoilt.truncate(at);
            }
            put(&part, &spoilt);
            put(&journal, &record);
            let watch = Watch::new(u64::MAX);
            let taken_over = resumed(&watch);
            assert!(taken_over <= at, "{taken_over} bytes, where byte {at} is wrong");
            assert!(watch.note().contains("damaged"), "{}", watch.note());
        }
    }
    let mut spoilt = record.clone();
    spoilt[record.len() / 2] ^= 1;
    for garbage in [&b""[..], b"\xff\0garbage", &record[..record.len() / 2], &spoilt] {
        put(&part, &bytes);
        put(&journal, garbage);
        let watch = Watch::new(u64::MAX);
        assert_eq!(resumed(&watch), 0);
        assert!(watch.note().contains("starting anew"), "{}", watch.note());
    }
    // A part without its journal, and a journal without its part.
    put(&part, &bytes);
    assert_eq!(resumed(&Watch::new(u64::MAX)), 0);
    put(&journal, &record);
    assert_eq!(resumed(&Watch::new(u64::MAX)), 0);
}

/// Versions of one reading go on from where all of them are good, and no later call takes the rest for
/// damaged.
#[test]
fn versions_go_on_together() {
    let work = Work::new(PlyEncoding::BinaryLittleEndian);
    let expected = work.expected(&[1, 2], Normals::Transform);
    let bytes = work.model.info().bytes;
    work.write(&[1, 2], &how(true), &Watch::new(bytes * 2 / 3)).unwrap_err();
    let part = work.path(".simod-out-2.part");
    let mut spoilt = fs::read(&part).unwrap();
    let middle = spoilt.len() / 2;
    spoilt[middle] ^= 1;
    put(&part, &spoilt);
    // Checking takes two thirds of each, up to the damage; then little is written.
    let watch = Watch::new(bytes * 3 / 2);
    work.write(&[1, 2], &how(true), &watch).unwrap_err();
    assert!(watch.note().contains("out-2") && !watch.note().contains("out-1"), "{}", watch.note());
    let watch = Watch::new(u64::MAX);
    assert!(work.write(&[1, 2], &how(true), &watch).unwrap() > 0);
    assert_eq!(watch.note(), "");
    work.check(&[1, 2], &expected);
}

#[test]
fn another_key_starts_anew() {
    let mut work = Work::new(PlyEncoding::BinaryLittleEndian);
    let note = |work: &Work, how: &Reconstruction| {
        let watch = Watch::new(u64::MAX);
        assert_eq!(work.write(&[1], how, &watch).unwrap(), 0);
        watch.note()
    };
    // Nothing to go on with is no news.
    assert_eq!(note(&work, &how(true)), "");
    fs::remove_file(work.path("out-1")).unwrap();
    let expected = work.expected(&[1], Normals::Keep);
    interrupted(&work, &how(true));
    assert!(note(&work, &Reconstruction { normals: Normals::Keep, ..how(true) }).contains("changed"));
    work.check(&[1], &expected);

    interrupted(&work, &how(true));
    work.deformed[1].local[7].x += 0.01;
    let changed = note(&work, &how(true));
    fs::remove_file(work.path("out-1")).unwrap();
    assert!(changed.contains("changed") && changed.contains("out-1"), "{changed}");
}

#[test]
fn two_outputs_that_are_one_file_are_refused() {
    let work = Work::new(PlyEncoding::BinaryLittleEndian);
    let outputs = [work.path("out"), work.path("./out")];
    let deformed = &work.deformed[0];
    let versions = outputs.each_ref().map(|output| Version { deformed, output, diagnostics: None });
    let error = reconstruct(&work.sampled, work.model.as_ref(), &versions, &how(false), &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Argument);
    assert!(error.to_string().starts_with("two files go to "), "{error}");
    assert!(work.names().is_empty());
}

#[test]
fn threads_do_not_change_a_byte_of_several_versions() {
    let work = Work::new(PlyEncoding::Ascii);
    let versions = [0, 1, 2, 3];
    let expected = work.expected(&versions, Normals::Transform);
    for threads in [1, 2, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| work.write(&versions, &how(false), &Silent)).unwrap();
        work.check(&versions, &expected);
    }
}

#[test]
fn lists_that_no_file_has_room_for_are_told_and_change_nothing() {
    let mut work = Work::of_samples(12_000, PlyEncoding::BinaryLittleEndian);
    let mut store = |storage: ListStorage, expected: Option<&[Vec<u8>]>| {
        let samples = &work.sampled.samples;
        let mut again = SampleSet::new(samples.positions.clone(), samples.known_normals().to_vec()).unwrap();
        again.store_lists(storage);
        work.sampled.samples = again;
        let Some(expected) = expected else {
            return (work.expected(&[1], Normals::Transform), String::new());
        };
        let watch = Watch::new(u64::MAX);
        work.write(&[1], &Reconstruction::default(), &watch).unwrap();
        work.check(&[1], expected);
        (Vec::new(), watch.note())
    };
    let (expected, _) = store(ListStorage::Memory, None);
    let folder = std::env::temp_dir();
    for (folder, is_told) in [(folder.clone(), false), (folder.join("nowhere at all"), true)] {
        let (_, told) = store(ListStorage::in_folder(&folder), Some(&expected));
        assert_eq!(told.contains("nowhere at all has no room for temporary files"), is_told, "{told}");
    }
}
