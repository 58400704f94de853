//! The main job: a model, its samples, two plugins from their own libraries, the deformed model.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde_json::Value;
use simod_tests::{MANY, Workplace, library};

/// The jar is twisted, then its mouth is pulled aside.
const STEPS: &str = r#"
[[step]]
deform = "warp"
params = { operation = "twist", angle = 100, center = [0, 0.75, 0], from = -0.3, to = 0.3 }
[[step]]
deform = "rbf"
[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0.8, 0], normal = [0, -1, 0] } }]
[[step.region]]
role = "handle"
shapes = [{ half-space = { point = [0, 1.85, 0], normal = [0, 1, 0] } }]
move = { translate = [0.35, -0.05, 0], axis = [0, 0, 1], degrees = -35, pivot = [0, 1.95, 0] }
"#;

/// The amphora with the session for it.
fn amphora(vertices: u64, samples: u64) -> Workplace {
    let work = Workplace::new();
    work.simod(&format!("generate -o amphora.ply --vertices {vertices}"));
    work.write_session("amphora.ply", samples, STEPS);
    work
}

#[test]
fn three_commands_and_one_write_the_same_bytes() {
    let work = amphora(MANY, MANY / 20);
    work.simod(&format!("sample amphora.ply -o amphora.simod --samples {}", MANY / 20));
    work.simod("deform amphora.simod --session edit.toml -o deformed.ply");
    work.simod("reconstruct amphora.simod --deformed deformed.ply -o by-three.ply");
    let report = work.report("run edit.toml");
    assert_eq!(report["vertices"], MANY);
    assert!(work.read("by-three.ply") == work.read("edited.ply"), "the two ways differ");

    // Both plugins did their work: the belly was turned about the axis, the mouth moved aside.
    let (before, after) = (work.ply("amphora.ply").positions(), work.ply("edited.ply").positions());
    let band = |from: f64, to: f64| {
        let band: Vec<(DVec3, DVec3)> = before
            .iter()
            .copied()
            .zip(after.iter().copied())
            .filter(|(p, _)| (from..to).contains(&p.y))
            .collect();
        assert!(band.len() > 1000);
        band
    };
    for (p, q) in band(0.6, 0.7) {
        let radius = |v: DVec3| v.x.hypot(v.z);
        assert!((radius(p) - radius(q)).abs() < 0.02 && p.distance(q) > 0.5 * radius(p), "{p} went to {q}");
    }
    let mouth = band(1.9, 2.1);
    let shift = mouth.iter().map(|(p, q)| q - p).sum::<DVec3>() / mouth.len() as f64;
    assert!((shift.x - 0.35).abs() < 0.05 && shift.y.abs() < 0.15, "the mouth moved by {shift}");
}

/// `amount` of a step is for all that does steps: samples, vertices by the exact map, and what is measured by
/// it.
#[test]
fn an_amount_is_a_part_of_the_way() {
    let work = amphora(MANY / 10, MANY / 100);
    let with = |amount: &str| {
        let steps = STEPS.replacen("deform = \"rbf\"", &format!("deform = \"rbf\"\n{amount}"), 1);
        work.write_session("amphora.ply", MANY / 100, &steps);
    };
    let exact = |amount: &str| {
        with(amount);
        work.simod("run edit.toml --exact -o exact.ply");
        work.ply("exact.ply").positions()
    };
    let (all, none) = (exact(""), exact("amount = 0"));
    assert!(all.iter().zip(&none).any(|(a, b)| a.distance(*b) > 0.3), "the step moves something");
    let part = exact("amount = 0.25");
    for (p, (a, b)) in part.iter().zip(all.iter().zip(&none)) {
        assert!(p.distance(b.lerp(*a, 0.25)) < 1e-6, "{p} is no quarter of the way from {b} to {a}");
    }
    // By samples, in one command and in three; the map that it is measured by is the same.
    let measured = work.report("run edit.toml --measure -o edited.ply");
    let told = measured["transfer_error"]["max"].as_f64().expect("a number");
    let apart = part.iter().zip(work.ply("edited.ply").positions()).map(|(p, q)| p.distance(q));
    let worst = apart.fold(0.0, f64::max) / work.ply("amphora.ply").diagonal();
    assert!(told < 0.01 && (worst / told - 1.0).abs() < 0.01, "{worst} is told as {told}");
    work.simod(&format!("sample amphora.ply -o amphora.simod --samples {}", MANY / 100));
    work.simod("deform amphora.simod --session edit.toml -o deformed.ply");
    work.simod("reconstruct amphora.simod --deformed deformed.ply -o by-three.ply");
    assert!(work.read("by-three.ply") == work.read("edited.ply"), "the two ways differ");
}

#[test]
fn samples_are_placed_alike_however_they_come_about() {
    let work = amphora(MANY / 10, MANY / 100);
    let refine = "[[step]]\nrefine = { shapes = [{ sphere = { center = [0.41, 1, 0.41], radius = 0.25 } }], factor = 4 }\n";
    let by = |key: &str, option: &str| {
        work.write_session("amphora.ply", MANY / 100, &format!("{key}{refine}{STEPS}"));
        work.simod("run edit.toml");
        work.simod(&format!("sample amphora.ply -o first.simod --samples {} {option}", MANY / 100));
        let info = work.simod("info first.simod").stdout;
        assert_eq!(info.contains("planes of the faces"), option.contains("faces"), "{info}");
        work.simod("deform first.simod --session edit.toml -o deformed.ply --refined refined.simod");
        work.simod("reconstruct refined.simod --deformed deformed.ply -o by-three.ply");
        let bytes = work.read("edited.ply");
        assert!(bytes == work.read("by-three.ply"), "{option}: the two ways differ");
        bytes
    };
    // The normals of an amphora are its own.
    let vertices = by("", "");
    assert!(vertices == by("place = \"vertices\"\n", "--place vertices"), "not what is automatic");
    assert!(vertices != by("place = \"faces\"\n", "--place faces"), "it makes no difference");
}

/// `--by`, and `by` in a session, are the same, and the folder remembers it.
#[test]
fn samples_are_spread_alike_however_they_come_about() {
    let work = amphora(MANY / 20, MANY / 200);
    let refine = "[[step]]\nrefine = { shapes = [{ sphere = { center = [0.41, 1, 0.41], radius = 0.25 } }], factor = 4 }\n";
    let by = |rule: &str| {
        work.write_session("amphora.ply", MANY / 200, &format!("by = \"{rule}\"\n{refine}{STEPS}"));
        work.simod("run edit.toml");
        work.simod(&format!("sample amphora.ply -o first.simod --samples {} --by {rule}", MANY / 200));
        let info = work.simod("info first.simod").stdout;
        assert_eq!(info.contains(&format!("spread by {rule}")), rule != "error", "{info}");
        work.simod("deform first.simod --session edit.toml -o deformed.ply --refined refined.simod");
        let info = work.simod("info refined.simod").stdout;
        assert_eq!(info.contains(&format!("spread by {rule}")), rule != "error", "{info}");
        work.simod("reconstruct refined.simod --deformed deformed.ply -o by-three.ply");
        let bytes = work.read("edited.ply");
        assert!(bytes == work.read("by-three.ply"), "{rule}: the two ways differ");
        bytes
    };
    let (error, area, vertices) = (by("error"), by("area"), by("vertices"));
    assert!(error != area && area != vertices && vertices != error, "it makes no difference");
    let outcome = work.run("sample amphora.ply -o second.simod --by colour");
    assert!(outcome.code != Some(0) && outcome.stderr.contains("area"), "{}", outcome.stderr);
}

#[test]
fn threads_do_not_change_a_byte() {
    let work = amphora(MANY / 4, MANY / 80);
    let with_threads = |n: usize| {
        let sample = format!("sample amphora.ply -o m{n}.simod --samples {} --threads {n}", MANY / 80);
        work.simod(&sample);
        work.simod(&format!("run edit.toml -o edited{n}.ply --threads {n}"));
        (work.read(&format!("m{n}.simod/samples.ply")), work.read(&format!("edited{n}.ply")))
    };
    let one = with_threads(1);
    for threads in [2, 3] {
        assert!(with_threads(threads) == one, "{threads} threads give another result");
    }
    // Plugins have threads of their own.
    let mut command = work.command("run edit.toml -o edited.ply");
    let status = command.env("RAYON_NUM_THREADS", "7").status().expect("the program runs");
    assert!(status.success());
    assert!(work.read("edited.ply") == one.1, "threads in plugins give another result");
}

#[test]
fn the_demo_shows_all_there_is() {
    let work = Workplace::new();
    let report = work.report("demo -o demo --vertices 60000 --samples 6000");

    assert_eq!(report["vertices"], 60_000);
    let samples = report["samples"].as_u64().expect("a number");
    assert!((5880..=6000).contains(&samples), "{samples} samples");
    for figure in ["seconds", "vertices_per_second", "peak_memory_bytes"] {
        assert!(report[figure].as_f64().is_some_and(|x| x > 0.0), "{figure} is {}", report[figure]);
    }
    let phases = report["phases"].as_array().expect("a list");
    let names: Vec<&str> = phases.iter().filter_map(|p| p["name"].as_str()).collect();
    for name in ["counting", "clustering", "deforming", "reconstructing"] {
        assert!(names.contains(&name), "no phase {name} among {names:?}");
    }
    let seconds: f64 = phases.iter().filter_map(|p| p["seconds"].as_f64()).sum();
    assert!(seconds <= report["seconds"].as_f64().expect("a number"), "phases take longer than the whole");
    let error = &report["transfer_error"];
    let figure = |name: &str| error[name].as_f64().unwrap_or_else(|| panic!("no {name} in {error}"));
    assert_eq!(error["vertices"], 60_000);
    assert!(
        0.0 < figure("rms") && figure("rms") < figure("p999") && figure("p999") < figure("max"),
        "{error}"
    );
    assert!(figure("rms") < 1e-3, "{error}");

    let (before, after) = (work.ply("demo/amphora.ply"), work.ply("demo/amphora-edited.ply"));
    assert_eq!((before.len(), after.len()), (60_000, 60_000));
    assert!(before.other_bytes() == after.other_bytes(), "more than positions and normals changed");
    check_picture(&work.path("demo/before-after.png"));

    // The session that it leaves does the same again.
    work.simod("run demo/session.toml -o again.ply");
    assert!(work.read("again.ply") == after.bytes, "the session does something else");
}

/// Four panels, each with a shaded model in it, and the last another one than the first.
fn check_picture(path: &Path) {
    let file = std::io::BufReader::new(std::fs::File::open(path).expect("a picture"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG file");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut pixels).expect("a whole picture");
    assert_eq!(info.bit_depth, png::BitDepth::Eight);
    let (channels, width) = (info.color_type.samples(), info.width as usize);
    let panel = |n: usize| -> Vec<&[u8]> {
        let columns = n * width / 4 * channels..(n + 1) * width / 4 * channels;
        pixels.chunks(width * channels).flat_map(|row| row[columns.clone()].chunks(channels)).collect()
    };
    let panels: Vec<Vec<&[u8]>> = (0..4).map(panel).collect();
    for (n, panel) in panels.iter().enumerate() {
        let colors: std::collections::BTreeSet<_> = panel.iter().collect();
        assert!(colors.len() > 200, "panel {n} has {} colours", colors.len());
    }
    let differ = panels[0].iter().zip(&panels[3]).filter(|(a, b)| a != b).count();
    assert!(differ > panels[0].len() / 20, "before and after look alike: {differ} pixels differ");
}

/// Of several libraries of one plugin, that in the folder that the user named is taken, then the one in the
/// user's own folder, then the one beside the program.
#[test]
fn plugins_are_found_in_three_places() {
    let mut work = Workplace::new();
    let beside = library("simod_warp");
    assert_eq!(plugin_path(&work, "warp"), beside);
    assert_eq!(plugin_path(&work, "rbf"), library("simod_rbf"));

    // One of the user's own is found in both other places, of which the one that was named comes first.
    let built = work.build_c("tests/c/hostile.c", "own", &["-DDOES=NOTHING", "-DID=\"own\""]);
    let name = built.file_name().and_then(|n| n.to_str()).expect("a name").to_owned();
    let bytes = std::fs::read(&built).expect("a library");
    let own = format!("../home/.local/share/simod/plugins/{name}");
    work.write(&own, &bytes);
    assert_same_file(&plugin_path(&work, "own"), &work.path(&own));

    work.write(&format!("named/{name}"), &bytes);
    work = work.with_plugins("named");
    assert_same_file(&plugin_path(&work, "own"), &work.path("named").join(name));
    assert_eq!(plugin_path(&work, "rbf"), library("simod_rbf"));

    // None takes the place of one of the program's own unless its version is higher.
    let bytes = std::fs::read(&beside).expect("a library");
    let name = beside.file_name().and_then(|n| n.to_str()).expect("a name");
    work.write(&format!("named/{name}"), &bytes);
    assert_eq!(plugin_path(&work, "warp"), beside);
}

/// The library that a plugin was loaded from.
fn plugin_path(work: &Workplace, id: &str) -> PathBuf {
    let report = work.report("plugin list");
    let plugins = report["plugins"].as_array().expect("a list");
    let plugin: Vec<&Value> = plugins.iter().filter(|p| p["id"] == id).collect();
    assert_eq!(plugin.len(), 1, "{report}");
    plugin[0]["path"].as_str().expect("a path").into()
}

fn assert_same_file(a: &Path, b: &Path) {
    let real = |p: &Path| p.canonicalize().unwrap_or_else(|e| panic!("{}: {e}", p.display()));
    assert_eq!(real(a), real(b));
}
