//! `simod sample`: what it writes, what can be left out, and what is left where it does not come to an end.

use std::fs;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use glam::DVec3;
use simod_tests::{OPTIMISED, Outcome, Ply, Workplace, skip};

/// The parts of a sampled model, where no parts of the model touch.
const FILES: [&str; 3] = ["cells.bin", "samples.ply", "simod.toml"];

/// Files of the sampled amphora, whose handles stand in its body.
const WITH_SHEETS: [&str; 4] = ["cells.bin", "samples.ply", "sheets.bin", "simod.toml"];

fn contents(work: &Workplace, folder: &str) -> Vec<Vec<u8>> {
    FILES.map(|name| work.read(&format!("{folder}/{name}"))).to_vec()
}

fn files(work: &Workplace, folder: &str) -> Vec<String> {
    let entries = fs::read_dir(work.path(folder)).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// The header of a PLY file.
fn header(work: &Workplace, name: &str) -> String {
    let bytes = work.read(name);
    let text = String::from_utf8_lossy(&bytes);
    text.split("end_header").next().expect("a header").to_owned()
}

/// A model whose vertices, each of `width` bytes at the end of the file, are in an order without any
/// coherence.
fn shuffle(work: &Workplace, name: &str, width: usize, count: usize) {
    let bytes = work.read(name);
    let (head, body) = bytes.split_at(bytes.len() - count * width);
    let mut shuffled = head.to_vec();
    // A prime that is not a factor of the count: all vertices are visited once.
    assert!(!count.is_multiple_of(7_919));
    (0..count).for_each(|i| shuffled.extend_from_slice(&body[i * 7_919 % count * width..][..width]));
    work.write(name, shuffled);
}

#[test]
fn the_figures_are_those_of_what_is_written() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 60000 --shape bumpy-sphere");
    let report = work.report("sample model.ply -o model.simod --samples 2000");
    let samples = work.ply("model.simod/samples.ply");
    assert_eq!(files(&work, "model.simod"), FILES);
    assert_eq!(report["vertices"], 60_000);
    assert_eq!(report["samples"], samples.len());
    let triangles = report["triangles"].as_u64().expect("a number");
    // A closed surface has two for each sample.
    assert!((3800..4400).contains(&triangles), "{triangles} triangles");
    let head = header(&work, "model.simod/samples.ply");
    assert!(head.contains(&format!("element face {triangles}\n")), "{head}");
    let description = String::from_utf8(work.read("model.simod/simod.toml")).expect("text");
    assert!(description.contains(&format!("cells = {}\n", report["cells"])), "{description}");
    let phases: Vec<_> = report["phases"].as_array().expect("a list").iter().map(|p| &p["name"]).collect();
    assert!(phases.iter().any(|name| *name == "reindexing the faces"), "{phases:?}");
    assert!(!report.as_object().expect("an object").contains_key("non_finite"));
}

#[test]
fn parts_that_are_left_out_are_not_there() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000 --no-normals");
    work.simod("sample model.ply -o whole.simod --samples 1000");
    let whole = header(&work, "whole.simod/samples.ply");
    assert!(whole.contains("element face") && whole.contains("property float nx"), "{whole}");
    let positions = work.ply("whole.simod/samples.ply").positions();
    for (skipped, faces, cells, normals) in [
        ("triangles", false, true, true),
        ("cells", true, false, true),
        ("normals", true, true, false),
        ("triangles,cells", false, false, true),
        ("normals,cells,triangles", false, false, false),
    ] {
        let report = work.report(&format!("sample model.ply -o part.simod --samples 1000 --skip {skipped}"));
        assert_eq!(report["triangles"].as_u64().is_some_and(|n| n > 1800), faces, "{skipped}: {report}");
        let head = header(&work, "part.simod/samples.ply");
        assert_eq!(head.contains("element face"), faces, "{skipped}");
        assert_eq!(head.contains("property float nx"), normals, "{skipped}");
        assert_eq!(files(&work, "part.simod").contains(&"cells.bin".to_owned()), cells, "{skipped}");
        // The rest is as it would be with them.
        assert!(work.ply("part.simod/samples.ply").positions() == positions, "{skipped}");
        work.simod("info part.simod");
    }
    // As several options, too.
    work.simod("sample model.ply -o part.simod --samples 1000 --skip triangles --skip cells");
    assert_eq!(files(&work, "part.simod"), WITH_SHEETS[1..]);
    work.simod("sample model.ply -o part.simod --samples 1000 --skip sheets");
    assert_eq!(files(&work, "part.simod"), FILES);
    // Former versions had to be asked for it.
    work.simod("sample model.ply -o part.simod --samples 1000 --sheets");
    assert!(work.read("part.simod/sheets.bin") == work.read("whole.simod/sheets.bin"));
}

#[test]
fn whatever_is_left_out_the_model_comes_back() {
    let work = Workplace::new();
    for parts in ["", "--no-normals", "--no-normals --no-faces"] {
        work.simod(&format!("generate -o model.ply --vertices 20000 {parts}"));
        work.simod("sample model.ply -o whole.simod --samples 1000");
        let moved = |folder: &str| {
            let samples = format!("{folder}/samples.ply");
            work.simod(&format!("reconstruct {folder} --deformed {samples} -o out.ply"));
            assert!(
                work.read("out.ply") == work.read("model.ply"),
                "{folder} with {parts}: not the identity"
            );
            work.move_samples(folder, |p| 2.0 * p + DVec3::new(p.y, p.z, p.x));
            work.simod(&format!("reconstruct {folder} --deformed deformed.ply -o out.ply"));
            work.read("out.ply")
        };
        let whole = moved("whole.simod");
        for skipped in ["triangles", "cells", "normals", "triangles,cells,normals"] {
            work.simod(&format!("sample model.ply -o part.simod --samples 1000 --skip {skipped}"));
            assert!(moved("part.simod") == whole, "without {skipped}, with {parts}: another model");
        }
    }
}

#[test]
fn the_octree_alone_samples_too() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000");
    for (tree, name) in [("vs", "volume-surface"), ("octree", "octree")] {
        let report = work.report(&format!("sample model.ply -o {tree}.simod --samples 1500 --tree {tree}"));
        let samples = report["samples"].as_u64().expect("a number");
        assert!((1470..=1500).contains(&samples), "{samples} samples");
        let description = String::from_utf8(work.read(&format!("{tree}.simod/simod.toml"))).expect("text");
        assert!(description.contains(&format!("splitting = \"{name}\"")), "{description}");
        work.simod(&format!("reconstruct {tree}.simod --deformed {tree}.simod/samples.ply -o out.ply"));
        assert!(work.read("out.ply") == work.read("model.ply"));
    }
    assert!(work.read("vs.simod/samples.ply") != work.read("octree.simod/samples.ply"));
    work.simod("sample model.ply -o default.simod --samples 1500");
    assert!(work.read("vs.simod/samples.ply") == work.read("default.simod/samples.ply"));
}

/// In the model's unit as well as in fractions of the diagonal.
#[test]
fn the_error_that_was_asked_for_is_told() {
    let work = Workplace::new();
    work.write("m.xyz", (0..900).map(|i| format!("{} {} {}\n", i % 30, i / 30, i % 7)).collect::<String>());
    let report = work.report("sample m.xyz -o s.simod --error 0.05");
    let told = work.report("info s.simod");
    let length = told["diagonal"].as_f64().map(|diagonal| 0.05 * diagonal);
    for report in [&report, &told] {
        assert_eq!((report["error"].as_f64(), report["error_length"].as_f64()), (Some(0.05), length));
    }
    let line = "asked for an error of 0.05 of the diagonal (2.1e0 in the model's unit)";
    let text = work.simod("sample m.xyz -o s.simod --error 0.05").stdout;
    assert!(text.contains(line), "{text}");
    assert!(work.simod("info s.simod").stdout.contains(line));
    assert!(work.report("sample m.xyz -o s.simod --samples 50")["error"].is_null());
}

#[test]
fn options_are_told_of_and_others_refused() {
    let work = Workplace::new();
    let help = work.simod("sample --help").stdout;
    for word in [
        "--samples",
        "--error",
        "--grid",
        "--memory-limit",
        "--tree",
        "octree",
        "--skip",
        "triangles",
        "cells",
        "normals",
    ] {
        assert!(help.contains(word), "--help does not tell of {word}: {help}");
    }
    for (options, possible) in [
        ("--skip faces", "triangles"),
        ("--skip triangles,faces", "triangles"),
        ("--skip", "triangles"),
        ("--skip triangles,", "triangles"),
        ("--tree kd", "octree"),
        ("--memory-limit much", "500M"),
        ("--memory-limit 0", "500M"),
    ] {
        let outcome = work.run(&format!("sample model.ply -o out.simod {options}"));
        assert_eq!(outcome.code, Some(2), "{options}: {}", outcome.stderr);
        assert!(outcome.stderr.contains(possible), "{options}: {}", outcome.stderr);
    }
    assert!(work.names().is_empty());
}

#[test]
fn a_former_sampled_model_is_replaced_whole() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    work.simod("generate -o other.ply --vertices 30000 --shape bumpy-sphere --no-normals");
    work.simod("sample model.ply -o model.simod --samples 1000");
    let first = contents(&work, "model.simod");
    work.simod("sample other.ply -o model.simod --samples 700");
    let second = contents(&work, "model.simod");
    assert!(first.iter().zip(&second).all(|(a, b)| a != b), "something is left of the former one");
    // Without cells, none are left of those before.
    work.simod("sample model.ply -o model.simod --samples 1000 --skip cells");
    assert_eq!(files(&work, "model.simod"), WITH_SHEETS[1..]);
    work.simod("sample model.ply -o model.simod --samples 1000");
    assert!(contents(&work, "model.simod") == first, "the same command writes something else");
    assert_eq!(work.names(), ["model.ply", "model.simod", "other.ply"]);
}

/// Samples of 14 MB, of which at most 8 fit: the others wait in a file.
const SHUFFLED: usize = 500_000;

fn shuffled() -> Workplace {
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {SHUFFLED} --no-faces --no-colors"));
    shuffle(&work, "model.ply", 24, SHUFFLED);
    work
}

/// As fine as that takes some time.
const SAMPLE: &str = "sample model.ply -o model.simod --samples 40000";

#[test]
fn less_memory_than_it_takes_is_enough() {
    let work = shuffled();
    work.simod(SAMPLE);
    let free = contents(&work, "model.simod");
    for limit in ["38M", "60M"] {
        work.simod(&format!("{SAMPLE} --memory-limit {limit}"));
        assert!(contents(&work, "model.simod") == free, "{limit} give other samples");
    }
    assert_eq!(work.names(), ["model.ply", "model.simod"]);
}

#[test]
fn memory_that_cannot_be_enough_is_refused() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 5000 --no-faces");
    let outcome =
        work.refuses("sample model.ply -o model.simod --samples 40000 --memory-limit 20M", &["21.0 MB"]);
    assert!(outcome.hint().contains("--memory-limit 38M"), "{}", outcome.hint());
    assert_eq!(work.names(), ["model.ply"]);
}

/// Memory that is less than what the samples of open cells take, and a model beyond what tests hold
/// otherwise.
#[test]
fn a_large_shuffled_model_needs_no_more_than_its_limit() {
    if !OPTIMISED {
        return skip("8 million vertices take minutes in a build without optimisation");
    }
    const VERTICES: usize = 8_000_000;
    const LIMIT: u64 = 96 << 20;
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {VERTICES} --no-faces --no-colors --no-normals"));
    shuffle(&work, "model.ply", 12, VERTICES);
    let report = work.report(&format!(
        "sample model.ply -o model.simod --samples 60000 --skip normals,cells --memory-limit {LIMIT}"
    ));
    assert!(report["samples"].as_u64().is_some_and(|n| (58_800..=60_000).contains(&n)), "{report}");
    if let Some(peak) = report["peak_memory_bytes"].as_u64() {
        assert!(peak < LIMIT, "{} MB", peak >> 20);
    }
    assert_eq!(work.names(), ["model.ply", "model.simod"]);
}

/// Resident memory too, with the pages of temporary files, which are 20 bytes for each of 12 million corners.
#[test]
#[cfg(target_os = "linux")]
fn what_is_mapped_for_faces_does_not_stay_resident() {
    if !OPTIMISED {
        return skip("millions of vertices take minutes in a build without optimisation");
    }
    let peak = |vertices: u32| {
        let work = Workplace::new();
        work.simod(&format!("generate -o model.ply --vertices {vertices} --no-normals --no-colors"));
        work.simod("convert model.ply model.stl --lossy");
        let mut command = work.command("sample model.stl -o model.simod --samples 20000 --threads 4");
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("a process");
        let status = format!("/proc/{}/status", child.id());
        let mut peak = 0;
        while child.try_wait().expect("a process").is_none() {
            let text = std::fs::read_to_string(&status).unwrap_or_default();
            let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
            let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
            peak = kilobytes.unwrap_or(peak);
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(child.wait().expect("a process").success());
        peak >> 10
    };
    let (half, two) = (peak(500_000), peak(2_000_000));
    assert!(half > 0 && two < half + 100, "{half} MB, {two} MB");
}

/// The disk fills up while samples wait in a file, while the maps for the triangles are written, and while
/// the result is; what was there before stays.
#[cfg(unix)]
#[test]
fn a_disk_that_fills_while_sampling() {
    let work = shuffled();
    work.simod("sample model.ply -o model.simod --samples 1000 --skip normals");
    let before = contents(&work, "model.simod");
    let tight = "sample model.ply -o model.simod --samples 40000 --memory-limit 38M";
    let refused = |limit: u64, line: &str, advice: &str| {
        let outcome = work.refuses_beyond(limit, line, &["a temporary file"]);
        assert!(outcome.hint().ends_with(advice), "{}", outcome.hint());
        assert!(contents(&work, "model.simod") == before);
    };
    for limit in [0, 512, 1 << 20, 5 << 20] {
        refused(limit, tight, "or raise --memory-limit");
    }
    // With memory enough, no file is needed but the result, of 1.3 MB with cells and all.
    work.refuses_beyond(512, SAMPLE, &["model.simod"]);
    work.refuses_beyond(700_000, SAMPLE, &["model.simod"]);
    assert!(contents(&work, "model.simod") == before);

    // Two maps and one more, of 4 bytes for each vertex.
    work.simod("generate -o model.ply --vertices 200000 --no-colors");
    for limit in [0, 512, 400_000, 799_744] {
        refused(
            limit,
            "sample model.ply -o model.simod --samples 1000",
            "or do without the faces, by --skip triangles,sheets and --place vertices",
        );
    }
    // As the advice says.
    let line = "sample model.ply -o model.simod --samples 1000 --skip triangles,sheets --place vertices";
    let outcome = work.run_beyond(400_000, line);
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
    assert_eq!(work.names(), ["model.ply", "model.simod"]);
}

/// Starts a sampling, and waits for `so_long`.
fn start(work: &Workplace, line: &str, so_long: Duration) -> Child {
    let mut command = work.command(line);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    std::thread::sleep(so_long);
    child
}

/// A model of some size, a sampled model of it, and how long it takes to make that again.
fn slow(options: &str) -> (Workplace, Duration) {
    let work = Workplace::new();
    let vertices = if OPTIMISED { 500_000 } else { 60_000 };
    work.simod(&format!("generate -o model.ply --vertices {vertices} {options}"));
    let start = Instant::now();
    work.simod("sample model.ply -o model.simod --samples 20000");
    (work, start.elapsed())
}

#[cfg(unix)]
#[test]
fn an_interrupted_sampling_leaves_nothing() {
    let (work, whole) = slow("--no-colors");
    let before = work.snapshot();
    let mut interrupted = 0;
    for tenth in [1, 2, 4, 6, 8, 9] {
        let child = start(&work, SAMPLE, whole * tenth / 10);
        let kill = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status();
        assert!(kill.expect("kill runs").success());
        let outcome = Outcome::from(child.wait_with_output().expect("an end"));
        match outcome.code {
            // The command was done before the signal came.
            Some(0) => break,
            // The signal came before the program was ready for it.
            None => {}
            code => {
                interrupted += 1;
                assert_eq!(code, Some(130), "after {tenth} tenths: {}", outcome.stderr);
                assert_eq!(outcome.lines("error: "), ["cancelled"]);
            }
        }
        assert_eq!(work.snapshot(), before, "after {tenth} tenths of {whole:?}");
    }
    if interrupted == 0 {
        skip("every run was done before it could be interrupted");
    }
}

/// Not even where it cannot do anything about it.
#[cfg(unix)]
#[test]
fn a_killed_sampling_leaves_the_former_one_as_it_was() {
    let (work, whole) = slow("--no-colors");
    let before = contents(&work, "model.simod");
    for tenth in [2, 5, 8] {
        let mut child = start(&work, &format!("{SAMPLE} --memory-limit 38M"), whole * tenth / 10);
        child.kill().expect("our own process");
        let killed = child.wait().expect("an end").code().is_none();
        if !killed {
            break;
        }
        assert!(contents(&work, "model.simod") == before, "after {tenth} tenths of {whole:?}");
        let shown: Vec<String> =
            work.names().into_iter().filter(|name| !name.starts_with(".simod-")).collect();
        assert_eq!(shown, ["model.ply", "model.simod"]);
    }
    // Remains of the killed run go with the next one.
    work.simod(SAMPLE);
    assert_eq!(work.names(), ["model.ply", "model.simod"]);
}

/// Cut to half its length, or written anew, at any time of the work: a result, or an error; never a crash.
#[test]
fn a_model_that_changes_while_it_is_sampled() {
    use std::io::Write;
    for options in ["--no-colors", "--no-faces --no-colors", "--encoding ascii --no-colors --no-faces"] {
        let (work, whole) = slow(options);
        let (before, model) = (contents(&work, "model.simod"), work.read("model.ply"));
        // Turned inside out, and three times as large.
        let other = (!options.contains("ascii")).then(|| {
            let mut other = Ply::parse(model.clone());
            other.move_vertices(|p| DVec3::ONE - 3.0 * p);
            other.bytes
        });
        let mut refused = 0;
        for part in [0.1, 0.3, 0.5, 0.7, 0.9] {
            for other in std::iter::once(None).chain(other.as_ref().map(Some)) {
                let child = start(&work, SAMPLE, whole.mul_f64(part));
                let file = fs::OpenOptions::new().write(true).open(work.path("model.ply")).expect("a model");
                match other {
                    None => file.set_len(model.len() as u64 / 2).expect("a shorter model"),
                    // In place, as a careless program does it.
                    Some(other) => (&file).write_all(other).expect("another model"),
                }
                let outcome = Outcome::from(child.wait_with_output().expect("an end"));
                if outcome.code == Some(0) {
                    // The command had read all that it needed before, or it read nothing but the new bytes.
                    work.simod("info model.simod");
                    for (name, bytes) in FILES.iter().zip(&before) {
                        work.write(&format!("model.simod/{name}"), bytes);
                    }
                } else {
                    refused += 1;
                    outcome.refused(SAMPLE, &["model.ply"]);
                    assert!(contents(&work, "model.simod") == before, "{options}: at {part} of the work");
                }
                work.write("model.ply", &model);
                assert_eq!(work.names(), ["model.ply", "model.simod"]);
            }
        }
        if refused == 0 {
            skip("every run was done before the model changed");
        }
    }
}

#[test]
fn an_error_that_takes_too_many_samples_is_refused() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 400000 --no-faces --no-colors");
    let line = "sample model.ply -o model.simod --error 1e-300 --memory-limit 64M";
    let outcome = work.refuses(line, &["so small an error takes more than"]);
    assert!(outcome.hint().contains("a larger --error"), "{}", outcome.hint());
    assert_eq!(work.names(), ["model.ply"]);
}

/// Geometry of the samples at rest is found by the same threads that then ask for it.
#[test]
fn many_threads_do_not_wait_for_each_other() {
    let work = Workplace::new();
    for options in ["", "--no-normals"] {
        work.simod(&format!("generate -o model.ply --vertices 60000 --no-faces {options}"));
        work.simod("sample model.ply -o model.simod --samples 20000 --skip normals");
        work.move_samples("model.simod", |p| 2.0 * p);
        for _ in 0..5 {
            work.simod("reconstruct model.simod --deformed deformed.ply -o out.ply --threads 24");
        }
    }
}
