//! Readers of damaged files: any bytes are an error or fit, and nothing panics. Files are damaged as their
//! structure suggests: numbers become others, parts are cut out, doubled and exchanged, and checksums are
//! made to fit again, so that what is behind them is reached. `PROPTEST_CASES` says how many.

use std::path::Path;
use std::sync::Mutex;

use proptest::prelude::*;
use simod_core::reconstruction::{Reconstruction, Version, bind, reconstruct};
use simod_core::refinement::{Finer, Refining, SpaceSelection, refine};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Skip, Target, sample};
use simod_generate::{ModelOptions, PlyEncoding, write_file};
use simod_model::progress::Silent;
use simod_model::{FaceChunk, Model, Progress, VertexChunk, output};
use simod_tests::damage::{damage, damaged, runner};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

fn put(path: &Path, bytes: &[u8]) {
    output::write_file(path, bytes).expect("a written file");
}

/// A model and its sampled folder, bound: their files' content.
struct Good {
    folder: tempfile::TempDir,
    sampled: SampledModel,
}

impl Good {
    fn new(encoding: PlyEncoding) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        let options = ModelOptions { vertices: 1000, encoding, ..ModelOptions::default() };
        write_file(&options, &at("m.ply"), &Silent).expect("a model");
        let model = simod_model::open(&at("m.ply")).expect("a model");
        let skip = Skip { sheets: false, ..Skip::default() };
        let how = Sampling { target: Target::Samples(100), skip, ..Sampling::default() };
        let sampled = sample(&*model, &how, folder.path(), &Silent).expect("samples");
        sampled.save(&at("m.simod")).expect("a folder");
        bind(&sampled, &*model, &at("m.simod/binding.bin"), &Silent).expect("a binding");
        let folder_again = SampledModel::load(&at("m.simod")).expect("a folder");
        assert!(folder_again.attributes(None, &Silent).expect("attributes").get("red").is_some());
        moved(&folder_again, &*model, &at("out.ply"), &Reconstruction::default()).expect("a reconstruction");
        Self { folder, sampled }
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.folder.path().join(name)).expect("a file")
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        put(&self.folder.path().join(name), bytes);
    }

    /// Uses the folder as commands do. Errors are fine.
    fn use_it(&self) {
        let at = |name: &str| self.folder.path().join(name);
        let Ok(mut sampled) = SampledModel::load(&at("m.simod")) else { return };
        let Ok(model) = sampled.open_source(None, &Silent) else { return };
        if let Ok(attributes) = sampled.attributes(None, &Silent) {
            let samples = sampled.samples.len();
            assert!(attributes.all().iter().all(|of| of.values.len() == samples));
        }
        let _ = moved(&sampled, &*model, &at("out.ply"), &Reconstruction::default());
        let binding = at("m.simod/binding.bin");
        let how = Reconstruction { binding: Some(&binding), ..Reconstruction::default() };
        let _ = moved(&sampled, &*model, &at("out.ply"), &how);
        if let Some(cells) = SampledModel::kept_cells(&at("m.simod")) {
            sampled.hold_cells(cells);
            let how = Refining { finer: Finer::Factor(2.0), memory_limit: None, shapes: Vec::new() };
            let everywhere = |_| -1.0;
            let selection = SpaceSelection { distance: &everywhere, so_far: None, at_rest: true };
            let _ = refine(&sampled, &*model, selection, &how, self.folder.path(), &Silent);
        }
    }
}

/// The model with its samples moved, unevenly.
fn moved(
    sampled: &SampledModel,
    model: &dyn Model,
    output: &Path,
    how: &Reconstruction<'_>,
) -> simod_model::Result<()> {
    let stretched = sampled.samples.positions.iter().map(|p| *p * (1.0 + p.y));
    let deformed = stretched.collect::<Vec<_>>().into();
    let version = Version { deformed: &deformed, output, diagnostics: None };
    reconstruct(sampled, model, &[version], how, &Silent).map(drop)
}

fn read_all(path: &Path) {
    let Ok(model) = simod_model::open(path) else { return };
    let (mut vertices, mut faces) = (VertexChunk::default(), FaceChunk::default());
    if let Ok(mut reader) = model.vertices(0..model.info().vertices) {
        while reader.read(&mut vertices).unwrap_or(false) {}
    }
    if let Ok(mut reader) = model.faces() {
        while reader.read(&mut faces).unwrap_or(false) {}
    }
    let _ = model.check_complete(&Silent);
}

#[test]
fn damaged_models_do_no_harm() {
    for encoding in [PlyEncoding::Ascii, PlyEncoding::BinaryLittleEndian, PlyEncoding::BinaryBigEndian] {
        let good = Good::new(encoding);
        let bytes = good.read("m.ply");
        let header = bytes.windows(10).position(|w| w == b"end_header").expect("a header") + 11;
        let path = good.folder.path().join("damaged.ply");
        let mut runner = runner(150);
        // Half of them in the header, where the structure is.
        let all = (prop::collection::vec(damage(), 1..4), any::<bool>());
        let tested = runner.run(&all, |(all, in_header)| {
            put(&path, &damaged(&bytes, if in_header { header } else { bytes.len() }, &all));
            read_all(&path);
            if let Ok(model) = simod_model::open(&path)
                && let Ok(sampled) = sample(&*model, &Sampling::default(), good.folder.path(), &Silent)
            {
                let _ = sampled.attributes(None, &Silent);
            }
            Ok(())
        });
        tested.expect("no panic");
    }
}

/// Files of a sampled folder, whose checksums fit the damaged content.
#[test]
fn damaged_folders_do_no_harm() {
    let good = Good::new(PlyEncoding::BinaryLittleEndian);
    let names =
        ["simod.toml", "samples.ply", "cells.bin", "binding.bin", "sheets.bin", "attributes.bin", "rest.bin"];
    let kept: Vec<(String, Vec<u8>)> = names
        .iter()
        .map(|name| format!("m.simod/{name}"))
        .map(|name| (name.clone(), good.read(&name)))
        .collect();
    let mut runner = runner(150);
    let all = (prop::collection::vec(damage(), 1..3), 0..names.len(), any::<bool>());
    let tested = runner.run(&all, |(all, which, fits)| {
        let (name, bytes) = &kept[which];
        let mut spoilt = damaged(bytes, bytes.len(), &all);
        if fits {
            match names[which] {
                "samples.ply" => {
                    let text = String::from_utf8(kept[0].1.clone()).expect("text");
                    let hash = |bytes: &[u8]| format!("xxh3-128:{:032x}", xxh3_128(bytes));
                    good.put(&kept[0].0, text.replace(&hash(bytes), &hash(&spoilt)).as_bytes());
                }
                "cells.bin" | "sheets.bin" | "attributes.bin" | "rest.bin" if spoilt.len() > 16 => {
                    let end = spoilt.len() - 16;
                    let hash = xxh3_128(&spoilt[..end]).to_le_bytes();
                    spoilt[end..].copy_from_slice(&hash);
                }
                "binding.bin" => refit_binding(&mut spoilt),
                _ => {}
            }
        }
        good.put(name, &spoilt);
        good.use_it();
        kept.iter().for_each(|(name, bytes)| good.put(name, bytes));
        Ok(())
    });
    tested.expect("no panic");
    // The files that were put back are as good as they were.
    let again = SampledModel::load(&good.folder.path().join("m.simod")).expect("a sampled model");
    assert_eq!(again.samples.positions, good.sampled.samples.positions);
}

/// Interrupts a reconstruction, so that its part file and its journal are left, and goes on by damaged ones:
/// it ends, with the right bytes, and nothing is left.
#[test]
fn damaged_journals_do_no_harm() {
    let good = Good::new(PlyEncoding::BinaryLittleEndian);
    let at = |name: &str| good.folder.path().join(name);
    let model = simod_model::open(&at("m.ply")).expect("a model");
    let deformed = good.sampled.samples.positions.clone().into();
    let write = |resume: bool, progress: &dyn Progress| {
        let version = Version { deformed: &deformed, output: &at("out.ply"), diagnostics: None };
        let how = Reconstruction { resume, part_bytes: 1000, ..Reconstruction::default() };
        reconstruct(&good.sampled, &*model, &[version], &how, progress)
    };
    write(false, &Silent).expect("a reconstruction");
    let expected = good.read("out.ply");
    let kept = Keeping { files: Mutex::default(), folder: good.folder.path() };
    write(false, &kept).expect("a reconstruction");
    let files = kept.files.into_inner().expect("files");
    let (journal, part) = files.expect("a journal beside a part file");
    let names = [".simod-out.ply.journal", ".simod-out.ply.part"];
    let all = (prop::collection::vec(damage(), 1..3), any::<bool>(), any::<bool>());
    let tested = runner(150).run(&all, |(all, which, new)| {
        let spoilt =
            |bytes: &Vec<u8>, yes: bool| if yes { damaged(bytes, bytes.len(), &all) } else { bytes.clone() };
        let name = if new && !which { ".simod-out.ply.journal.new" } else { names[0] };
        plain(&at(name), &spoilt(&journal, !which));
        plain(&at(names[1]), &spoilt(&part, which));
        std::fs::remove_file(at("out.ply")).expect("the file of before");
        write(true, &Silent).expect("a reconstruction");
        assert!(good.read("out.ply") == expected, "other bytes");
        assert!(names.iter().all(|name| !at(name).exists()), "something is left");
        Ok(())
    });
    tested.expect("no panic");
}

/// A file as it is, without the hidden ones beside it.
fn plain(path: &Path, bytes: &[u8]) {
    use std::io::Write;
    std::fs::File::create(path).and_then(|mut file| file.write_all(bytes)).expect("a written file");
}

/// Keeps the journal and the part file as a process leaves them that is killed: the last ones with parts.
struct Keeping<'a> {
    folder: &'a Path,
    files: Mutex<Option<(Vec<u8>, Vec<u8>)>>,
}

impl Progress for Keeping<'_> {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {
        let read = |name: &str| std::fs::read(self.folder.join(name)).ok().filter(|bytes| !bytes.is_empty());
        if let (Some(journal), Some(part)) = (read(".simod-out.ply.journal"), read(".simod-out.ply.part")) {
            *self.files.lock().expect("files") = Some((journal, part));
        }
    }
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Makes the checksums of a binding's parts fit again, as far as its parts are there.
fn refit_binding(bytes: &mut [u8]) {
    let word = |bytes: &[u8], at: usize| -> Option<usize> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize)
    };
    // Behind the letters, the version, and the hash of what it depends on.
    let mut at = 28;
    while let Some(length) = word(bytes, at + 4) {
        let (start, end) = (at + 16, (at + 16).saturating_add(length));
        let Some(hash) = bytes.get(start..end).map(xxh3_64) else { return };
        bytes[at + 8..at + 16].copy_from_slice(&hash.to_le_bytes());
        at = end;
    }
}
