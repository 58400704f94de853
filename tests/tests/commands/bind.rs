//! A model that is bound to its samples is deformed likewise, without a search.

use glam::DVec3;
use simod_tests::{MANY, Workplace};

const BINDING: &str = "model.simod/binding.bin";
const REST: &str = "model.simod/rest.bin";

/// A sampled model, and its deformation without a binding for each method.
fn sampled(options: &str) -> (Workplace, Vec<Vec<u8>>) {
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {} {options}", MANY / 10));
    work.simod(&format!("sample model.ply -o model.simod --samples {}", MANY / 500));
    work.move_samples("model.simod", |p| p + DVec3::new(0.1 * p.y * p.y, 0.3 * p.x, 1.0));
    let expected = methods(&work);
    (work, expected)
}

fn methods(work: &Workplace) -> Vec<Vec<u8>> {
    let method = |name: &str| {
        work.simod(&format!("reconstruct model.simod --deformed deformed.ply -o out.ply --method {name}"));
        work.read("out.ply")
    };
    vec![method("blended-jets"), method("projected-barycentric")]
}

#[test]
fn gives_the_same_bytes() {
    for options in ["", "--no-normals", "--encoding ascii --double", "--shape bumpy-sphere"] {
        let (work, expected) = sampled(options);
        let rest = work.read(REST);
        std::fs::remove_file(work.path(REST)).expect("a file");
        let report = work.report("bind model.simod");
        assert!(work.read(REST) == rest, "{options}: the samples' geometry is kept as well");
        assert_eq!(report["vertices"], MANY / 10, "{options}");
        assert_eq!(report["bytes"], work.read(BINDING).len() as u64, "{options}");
        assert!(methods(&work) == expected, "{options}");
        // Bound again, with another number of threads: the same file.
        let bytes = work.read(BINDING);
        work.simod("bind model.simod --threads 5");
        assert!(work.read(BINDING) == bytes, "{options}");
        // A folder with a binding is still one that sampling may replace.
        work.simod("sample model.ply -o model.simod --samples 500");
        assert!(!work.path(BINDING).exists());
    }
}

#[test]
fn of_no_use_it_is_not_used() {
    let (work, expected) = sampled("");
    let line = "reconstruct model.simod --deformed deformed.ply -o out.ply";
    work.simod("bind model.simod");
    let good = work.read(BINDING);
    let mut damaged = good.clone();
    damaged[1000] ^= 1;
    for bytes in [&damaged[..], &good[..1000], b"SIMODBND", b""] {
        work.write(BINDING, bytes);
        let outcome = work.simod(line);
        assert!(outcome.stderr.contains("binding.bin is not used"), "{}", outcome.stderr);
        assert!(work.read("out.ply") == expected[0]);
    }
    // The bytes behind the beginning are only looked at when they are needed: from there on the run goes on
    // without a binding.
    let mut damaged = good.clone();
    let last = damaged.len() - 10;
    damaged[last] ^= 1;
    for (bytes, why) in [(&damaged[..], "checksum"), (&good[..good.len() - 1], "cut off")] {
        work.write(BINDING, bytes);
        let outcome = work.simod(line);
        let notes = outcome.lines("note: ");
        assert!(notes.len() == 1 && notes[0].contains("binding.bin is not used"), "{}", outcome.stderr);
        assert!(notes[0].contains(why), "{}", outcome.stderr);
        assert!(work.read("out.ply") == expected[0]);
    }
    // Of other samples.
    work.write(BINDING, &good);
    work.simod("sample model.ply -o other.simod --samples 300");
    std::fs::copy(work.path(BINDING), work.path("other.simod/binding.bin")).expect("a copy");
    work.move_samples("other.simod", |p| p + DVec3::X);
    let outcome = work.simod("reconstruct other.simod --deformed deformed.ply -o out.ply");
    assert!(outcome.stderr.contains("other samples"), "{}", outcome.stderr);
}
