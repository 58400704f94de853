//! Readers of damaged files: any bytes are an error or fit, and nothing panics. Files are damaged as their structure
//! suggests: numbers become others, parts are cut out, doubled and exchanged, and checksums are made to fit again, so that
//! what is behind them is reached. `PROPTEST_CASES` says how many.

use std::path::Path;

use proptest::prelude::*;
use simod_core::generate::{Encoding, ModelOptions, write_file};
use simod_core::model::{self, FaceChunk, VertexChunk};
use simod_core::output;
use simod_core::progress::Silent;
use simod_core::reconstruction::{Reconstruction, Version, bind, reconstruct};
use simod_core::refinement::{Finer, Refining, Selection, refine};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// What is done to bytes.
#[derive(Debug, Clone)]
enum Damage {
    Flip { at: f64, bits: u8 },
    Number { at: f64, value: u64, width: usize },
    Cut { at: f64, len: f64 },
    Double { at: f64, len: f64 },
    Word { nth: usize, with: &'static str },
}

/// Numbers and words that are likely to be believed.
const NUMBERS: [u64; 8] = [0, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, 1 << 40, u64::MAX];
const WORDS: [&str; 10] =
    ["0", "-1", "1e400", "nan", "18446744073709551615", "4294967295", "\"\"", "list", "[]", "../../x"];

fn damage() -> impl Strategy<Value = Damage> {
    let part = || 0.0..1.0f64;
    prop_oneof![
        3 => (part(), 1u8..).prop_map(|(at, bits)| Damage::Flip { at, bits }),
        3 => (part(), prop::sample::select(&NUMBERS[..]), 1usize..=8)
            .prop_map(|(at, value, width)| Damage::Number { at, value, width }),
        2 => (part(), 0.0..0.3f64).prop_map(|(at, len)| Damage::Cut { at, len }),
        1 => (part(), 0.0..0.2f64).prop_map(|(at, len)| Damage::Double { at, len }),
        3 => (0usize..60, prop::sample::select(&WORDS[..])).prop_map(|(nth, with)| Damage::Word { nth, with }),
    ]
}

/// The bytes damaged; places are parts of the first `within` of them.
fn damaged(bytes: &[u8], within: usize, all: &[Damage]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for damage in all {
        let length = within.min(bytes.len());
        if length == 0 {
            break;
        }
        let place = |part: f64| ((part * length as f64) as usize).min(length - 1);
        match *damage {
            Damage::Flip { at, bits } => bytes[place(at)] ^= bits,
            Damage::Number { at, value, width } => {
                let at = place(at);
                bytes.iter_mut().skip(at).zip(value.to_le_bytes()).take(width).for_each(|(b, v)| *b = v);
            }
            Damage::Cut { at, len } => {
                let (at, len) = (place(at), place(len));
                bytes.drain(at..(at + len).min(length));
            }
            Damage::Double { at, len } => {
                let (at, len) = (place(at), place(len));
                let part = bytes[at..(at + len).min(length)].to_vec();
                bytes.splice(at..at, part);
            }
            Damage::Word { nth, with } => {
                let is_blank = |b: &u8| b.is_ascii_whitespace();
                let starts = (1..length).filter(|i| is_blank(&bytes[i - 1]) && !is_blank(&bytes[*i]));
                let starts: Vec<usize> = starts.collect();
                if let Some(start) = (!starts.is_empty()).then(|| starts[nth % starts.len()]) {
                    let end = (start..length).find(|i| is_blank(&bytes[*i])).unwrap_or(length);
                    bytes.splice(start..end, with.bytes());
                }
            }
        }
    }
    bytes
}

fn put(path: &Path, bytes: &[u8]) {
    output::write_file(path, bytes).expect("a written file");
}

/// A model and its sampled folder, bound: their files' content.
struct Good {
    folder: tempfile::TempDir,
    sampled: SampledModel,
}

impl Good {
    fn new(encoding: Encoding) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        let options = ModelOptions { vertices: 1000, encoding, ..ModelOptions::default() };
        write_file(&options, &at("m.ply"), &Silent).expect("a model");
        let model = model::open(&at("m.ply")).expect("a model");
        let how = Sampling { target: Target::Samples(100), ..Sampling::default() };
        let sampled = sample(&*model, &how, folder.path(), &Silent).expect("samples");
        sampled.save(&at("m.simod")).expect("a folder");
        bind(&sampled, &*model, &at("m.simod/binding.bin"), &Silent).expect("a binding");
        Self { folder, sampled }
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.folder.path().join(name)).expect("a file")
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        put(&self.folder.path().join(name), bytes);
    }

    /// Does with the folder what commands do. Errors are fine.
    fn use_it(&self) {
        let at = |name: &str| self.folder.path().join(name);
        let Ok(mut sampled) = SampledModel::load(&at("m.simod")) else { return };
        let Ok(model) = sampled.open_source(None) else { return };
        let deformed = sampled.samples.positions.clone();
        let version = Version { deformed: &deformed, output: &at("out.ply"), diagnostics: None };
        let binding = at("m.simod/binding.bin");
        let how = Reconstruction { binding: Some(&binding), ..Reconstruction::default() };
        let _ = reconstruct(&sampled, &*model, &[version], &how, &Silent);
        if let Some(cells) = SampledModel::kept_cells(&at("m.simod")) {
            sampled.hold_cells(cells);
            let how = Refining { finer: Finer::Factor(2.0), memory_limit: None, shapes: Vec::new() };
            let everywhere = |_| -1.0;
            let selection = Selection { distance: &everywhere, so_far: None, at_rest: true };
            let _ = refine(&sampled, &*model, selection, &how, self.folder.path(), &Silent);
        }
    }
}

fn read_all(path: &Path) {
    let Ok(model) = model::open(path) else { return };
    let (mut vertices, mut faces) = (VertexChunk::default(), FaceChunk::default());
    if let Ok(mut reader) = model.vertices(0..model.info().vertices) {
        while reader.read(&mut vertices).unwrap_or(false) {}
    }
    if let Ok(mut reader) = model.faces() {
        while reader.read(&mut faces).unwrap_or(false) {}
    }
    let _ = model.check_complete(&Silent);
}

/// So many cases, unless the environment says how many.
fn cases(count: u32) -> ProptestConfig {
    let config = ProptestConfig::default();
    if std::env::var_os("PROPTEST_CASES").is_some() {
        config
    } else {
        ProptestConfig { cases: count, ..config }
    }
}

#[test]
fn damaged_models_do_no_harm() {
    for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
        let good = Good::new(encoding);
        let bytes = good.read("m.ply");
        let header = bytes.windows(10).position(|w| w == b"end_header").expect("a header") + 11;
        let path = good.folder.path().join("damaged.ply");
        let mut runner = proptest::test_runner::TestRunner::new(cases(150));
        // Half of them in the header, where the structure is.
        let all = (prop::collection::vec(damage(), 1..4), any::<bool>());
        let tested = runner.run(&all, |(all, in_header)| {
            put(&path, &damaged(&bytes, if in_header { header } else { bytes.len() }, &all));
            read_all(&path);
            if let Ok(model) = model::open(&path) {
                let _ = sample(&*model, &Sampling::default(), good.folder.path(), &Silent);
            }
            Ok(())
        });
        tested.expect("no panic");
    }
}

/// The files of a sampled folder, whose checksums fit what is damaged.
#[test]
fn damaged_folders_do_no_harm() {
    let good = Good::new(Encoding::BinaryLittleEndian);
    let names = ["simod.toml", "samples.ply", "cells.bin", "binding.bin"];
    let kept: Vec<(String, Vec<u8>)> = names
        .iter()
        .map(|name| format!("m.simod/{name}"))
        .map(|name| (name.clone(), good.read(&name)))
        .collect();
    let mut runner = proptest::test_runner::TestRunner::new(cases(150));
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
                "cells.bin" if spoilt.len() > 16 => {
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
    // And what was put back is as good as it was.
    let again = SampledModel::load(&good.folder.path().join("m.simod")).expect("a sampled model");
    assert_eq!(again.samples.positions, good.sampled.samples.positions);
}

/// Makes the checksums of a binding's parts fit again, as far as its parts are there.
fn refit_binding(bytes: &mut [u8]) {
    let word = |bytes: &[u8], at: usize| -> Option<usize> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize)
    };
    let Some(head) = word(bytes, 12) else { return };
    let Some(mut at) = head.checked_add(20).filter(|end| end.saturating_add(16) <= bytes.len()) else {
        return;
    };
    let hash = xxh3_128(&bytes[20..at]).to_le_bytes();
    bytes[at..at + 16].copy_from_slice(&hash);
    at += 16;
    while let Some(length) = word(bytes, at + 4) {
        let (start, end) = (at + 16, (at + 16).saturating_add(length));
        let Some(hash) = bytes.get(start..end).map(xxh3_64) else { return };
        bytes[at + 8..at + 16].copy_from_slice(&hash.to_le_bytes());
        at = end;
    }
}
