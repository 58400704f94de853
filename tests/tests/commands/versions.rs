//! Several versions of a model in one reading, and what becomes of its normals.

use glam::DVec3;
use simod_tests::{MANY, OPTIMISED, Workplace, skip};

/// A sampled model, and deformed samples: in-1.ply, in-2.ply, and so on.
fn sampled(options: &str, vertices: u64, versions: u32) -> Workplace {
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {vertices} {options}"));
    work.simod(&format!("sample model.ply -o model.simod --samples {}", vertices / 50));
    for version in 1..=versions {
        let by = f64::from(version) / 10.0;
        work.move_samples("model.simod", |p| p + by * DVec3::new(p.y * p.y, 0.3 * p.x, 1.0));
        std::fs::rename(work.path("deformed.ply"), work.path(&format!("in-{version}.ply"))).expect("a file");
    }
    work
}

#[test]
fn are_those_of_single_runs() {
    for options in ["", "--encoding big-endian --double --no-faces", "--encoding ascii"] {
        let work = sampled(options, MANY / 10, 5);
        for normals in ["keep", "transform", "drop"] {
            let line = |deformed: &str, output: &str| {
                format!("reconstruct model.simod --normals {normals} --deformed {deformed} -o {output}")
            };
            let single = |version: u32| {
                work.simod(&line(&format!("in-{version}.ply"), "one.ply"));
                work.read("one.ply")
            };
            let expected: Vec<Vec<u8>> = (1..=5).map(single).collect();
            assert!(expected[0] != expected[1]);
            for threads in [1, 2, 8] {
                let report = work.report(&format!("{} --threads {threads}", line("in-*.ply", "out-{}.ply")));
                assert_eq!(report["vertices"], MANY / 10);
                assert_eq!(report["versions"], 5);
                for (i, expected) in expected.iter().enumerate() {
                    let name = format!("out-{}.ply", i + 1);
                    assert!(work.read(&name) == *expected, "{name}, {options}, {threads} threads, {normals}");
                }
            }
            // As a shell hands them over.
            work.simod(&line("in-2.ply in-5.ply", "{}-out.ply"));
            assert!(work.read("in-2-out.ply") == expected[1] && work.read("in-5-out.ply") == expected[4]);
            std::fs::remove_file(work.path("in-2-out.ply")).expect("an output");
            std::fs::remove_file(work.path("in-5-out.ply")).expect("an output");
        }
    }
}

#[test]
fn normals_are_kept_turned_or_left_out() {
    for options in ["", "--encoding ascii --double", "--encoding big-endian"] {
        let work = sampled(options, 20_000, 1);
        let with = |normals: &str| {
            work.simod(&format!("reconstruct model.simod --deformed in-1.ply -o out.ply {normals}"));
            work.ply("out.ply")
        };
        let (before, usual) = (work.ply("model.ply"), with(""));
        let (keep, transform, drop) =
            (with("--normals keep"), with("--normals transform"), with("--normals drop"));
        assert!(transform.bytes == usual.bytes);
        assert_eq!(keep.positions(), usual.positions());
        assert_eq!(keep.normals(), before.normals());
        assert_ne!(usual.normals(), before.normals());
        assert_eq!(drop.positions(), usual.positions());
        assert!(drop.normals().is_empty() && drop.bytes.len() < usual.bytes.len());
        let header = String::from_utf8_lossy(&drop.bytes[..400]).into_owned();
        assert!(!header.contains(" nx") && header.contains("red"), "{header}");
        work.write_session("model.ply", 400, "[[step]]\ndeform = \"warp\"\n");
        work.simod("run edit.toml --normals drop");
        assert!(work.ply("edited.ply").normals().is_empty());
    }
    // A model without normals has none to leave out, which is no news.
    let work = sampled("--no-normals", 20_000, 1);
    let line = "reconstruct model.simod --deformed in-1.ply -o out.ply";
    work.simod(line);
    let usual = work.read("out.ply");
    for normals in ["keep", "drop"] {
        assert_eq!(work.simod(&format!("{line} --normals {normals}")).stderr, "");
        assert!(work.read("out.ply") == usual);
    }
}

#[test]
fn command_lines_that_make_no_sense() {
    let work = sampled("", 20_000, 3);
    work.write("out.ply", "precious");
    let reconstruct = "reconstruct model.simod --deformed";
    work.refuses(&format!("{reconstruct} frame-*.ply -o out-{{}}.ply"), &["frame-*.ply matches no file"]);
    work.refuses(&format!("{reconstruct} in-*.ply -o out.ply"), &["3 versions", "out.ply"]);
    work.refuses(
        &format!("{reconstruct} in-*.ply --deformed in-2.ply in-2.ply -o out-{{}}.ply"),
        &["in-2.ply", "out-in-2.ply"],
    );
    work.refuses(&format!("{reconstruct} in-*.ply -o in-{{}}.ply"), &["in-1.ply", "one of the deformed"]);
    work.refuses(&format!("{reconstruct} in-1.ply -o in-1.ply"), &["in-1.ply", "one of the deformed"]);
    std::fs::copy(work.path("in-1.ply"), work.path("model-1.ply")).expect("a copy");
    work.refuses(&format!("{reconstruct} model-*.ply -o model.ply"), &["model.ply", "the model itself"]);
    work.refuses(&format!("{reconstruct} in-*.ply -o missing/{{}}.ply"), &["missing/1.ply"]);
    work.write("in-4.ply", "ply");
    work.refuses(&format!("{reconstruct} in-*.ply -o out-{{}}.ply"), &["in-4.ply"]);
}

/// Four versions at once: a chunk and what becomes of it is held for each, and nothing that grows with the
/// model.
#[test]
#[cfg(target_os = "linux")]
fn memory_of_several_does_not_grow_with_the_model() {
    if !OPTIMISED {
        return skip("millions of vertices take minutes in a build without optimisation");
    }
    let peak = |vertices: u64| {
        let work = Workplace::new();
        work.simod(&format!("generate -o model.ply --vertices {vertices} --no-faces --no-colors"));
        work.simod("sample model.ply -o model.simod --samples 20000");
        work.move_samples("model.simod", |p| 2.0 * p);
        for name in ["in-1.ply", "in-2.ply", "in-3.ply", "in-4.ply"] {
            work.write(name, work.read("deformed.ply"));
        }
        let report = work.report("reconstruct model.simod --deformed in-*.ply -o out-{}.ply");
        report["peak_memory_bytes"].as_u64().expect("a peak")
    };
    let (one, six) = (peak(1_000_000), peak(6_000_000));
    assert!(six < 150_000_000, "{} MB", six / 1_000_000);
    assert!(six < one + 20_000_000, "{} MB, {} MB", one / 1_000_000, six / 1_000_000);
}
