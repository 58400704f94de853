//! Plugins in C and C++: they get all that there is, and what is wrong with one is an error.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::env::consts::DLL_SUFFIX;

use glam::DVec3;
use serde_json::Value;
use simod_tests::{Workplace, has_compiler, skip};

/// Rules and findings of a report by `simod plugin check` that have this verdict.
fn rules<'a>(report: &'a Value, verdict: &str) -> Vec<(&'a str, &'a str)> {
    let rules = report["rules"].as_array().unwrap().iter().filter(|r| r["verdict"] == verdict);
    rules.map(|r| (r["rule"].as_str().unwrap(), r["found"].as_str().unwrap())).collect()
}

/// A plugin with a parameter of each kind that asks for every input, places handles, knows when it does
/// nothing, and refuses what is not as the header promises.
#[test]
fn all_that_there_is_arrives() {
    let work = Workplace::new();
    let library = work.build_c("tests/c/all_inputs.c", "all_inputs", &[]);
    let report = work.report(&format!("plugin check {}", library.display()));
    let none: [(&str, &str); 0] = [];
    assert_eq!(rules(&report, "fail"), none);
    let passed: Vec<&str> = rules(&report, "pass").into_iter().map(|(rule, _)| rule).collect();
    for rule in
        ["descriptor", "one-sample", "identity", "repeatable", "input-unchanged", "handles", "is-identity"]
    {
        assert!(passed.contains(&rule), "{rule}: {report}");
    }
    let handles = rules(&report, "pass").into_iter().find(|(rule, _)| *rule == "handles");
    assert!(
        handles.is_some_and(|(_, found)| found.ends_with("handles, and 1 faces between them")),
        "{handles:?}"
    );
    // No input is refused: all is as promised, but where a rule breaks the promise.
    let broken = ["no-samples", "not-a-number"];
    for rule in report["rules"]
        .as_array()
        .expect("rules")
        .iter()
        .filter(|r| !broken.contains(&r["rule"].as_str().unwrap()))
    {
        let text = rule.to_string();
        assert!(!text.contains("not as promised") && !text.contains("out of range"), "{text}");
    }

    let work = work.with_plugins("plugins");
    let info = work.report("plugin info all-inputs");
    assert_eq!(info["version"], "1.2.3");
    assert_eq!(info["parameters"].as_array().unwrap().len(), 9);
}

/// Faces between handles that there are not, or that are NULL, fail the rule.
#[test]
fn wrong_faces_between_handles_are_told() {
    let work = Workplace::new();
    let wrongs =
        [("1", "the face 0 has the corner"), ("0", "the corners of a face are said to be 4, and are NULL")];
    for (wrong, reason) in wrongs {
        let library = work.build_c("tests/c/all_inputs.c", "all_inputs", &[&format!("-DWRONG_FACE={wrong}")]);
        let outcome = work.run(&format!("plugin check {} --json", library.display()));
        assert!(outcome.stdout.contains(reason), "{}", outcome.stdout);
    }
}

#[test]
fn a_plugin_in_cpp() {
    if !has_compiler("c++") {
        return skip("there is no C++ compiler");
    }
    let work = Workplace::new().with_plugins("plugins");
    let library = work.build_c("tests/c/shift.cpp", "shift", &[]);
    let report = work.report(&format!("plugin check {}", library.display()));
    assert_eq!((&report["failed"], &report["warned"]), (&0.into(), &0.into()), "{report}");
    assert_shifts(&work, "shift-cpp");
}

/// A plugin shifts by 1 along x, in a unit in which the diagonal is between 1 and 2.
fn assert_shifts(work: &Workplace, plugin: &str) {
    work.simod("generate -o model.ply --vertices 5000");
    work.write_session("model.ply", 500, &format!("[[step]]\ndeform = \"{plugin}\"\n"));
    work.simod("run edit.toml");
    let before = work.ply("model.ply");
    let unit = before.diagonal().log2().floor().exp2();
    let shifts = before.positions().into_iter().zip(work.ply("edited.ply").positions()).map(|(p, q)| q - p);
    assert!(shifts.into_iter().all(|shift| shift.distance(DVec3::X * unit) < 1e-5));
}

/// A plugin that does one thing wrong in its table or description is listed with the reason, and no obstacle
/// to others.
#[test]
fn wrong_tables_are_refused() {
    let wrongs = [
        ("NULL_DESCRIPTION", "the description is NULL"),
        ("NULL_ID", "the plugin's id is NULL"),
        ("NULL_NAME", "the plugin's name is NULL"),
        ("BAD_UTF8", "the plugin's summary is not UTF-8"),
        ("NO_PARAMS", "the parameters are said to be 1, and are NULL"),
        ("ABSURD_COUNT", "the parameters are said to be 18446744073709551615"),
        ("UNKNOWN_KIND", "parameter `by`"),
        ("BAD_DEFAULT", "out of its range"),
        ("NEEDS_MORE", "needs the input `simod.smell/9`"),
        ("NO_DEFORM", "lacks `describe` or `deform`"),
        ("SMALL_TABLE", "its table has 24 bytes instead of"),
        ("NEXT_VERSION", "built for plugin interface 2.5, this program has 1.5"),
        ("NO_EVALUATE", "offers simod.evaluate/1 without the function"),
    ];
    let work = Workplace::new().with_plugins("plugins");
    for (wrong, reason) in wrongs {
        work.build_c("tests/c/misbehaving.c", "misbehaving_c", &[&format!("-DWRONG={wrong}")]);
        let list = work.simod("plugin list");
        let [warning] = list.lines("warning: ")[..] else { panic!("{wrong}: {}", list.stderr) };
        assert!(
            warning.contains(&format!("misbehaving_c{DLL_SUFFIX}")) && warning.contains(reason),
            "{wrong}: {warning}"
        );
        assert!(list.stdout.contains("warp"), "{}", list.stdout);
        let error = work.refuses("plugin info misbehaving-c", &[reason]);
        assert!(error.stderr.lines().count() <= 3, "{}", error.stderr);
    }
}

/// A call that fails gives an error in the plugin's words, or in ours where it has none.
#[test]
fn failing_calls_are_errors() {
    let wrongs = [
        ("SILENT_ERROR", "failed with code 42, and does not say why"),
        ("SPOKEN_ERROR", "this does not please me"),
        ("BAD_UTF8_ERROR", "bad \u{fffd} byte"),
        ("CANCELS", "stopped unasked"),
        ("NANS", "1 of 500 positions are unwritten or not finite"),
        ("UNWRITTEN", "1 of 500 positions are unwritten or not finite, the first at index 499"),
        ("NO_SCRATCH", "there is no memory to work in"),
    ];
    let work = Workplace::new().with_plugins("plugins");
    // Nothing touches there, so that there are as many samples as asked for.
    work.simod("generate -o model.ply --vertices 5000 --shape bumpy-sphere");
    work.write_session("model.ply", 500, "[[step]]\ndeform = \"misbehaving-c\"\n");
    for (wrong, reason) in wrongs {
        work.build_c("tests/c/misbehaving.c", "misbehaving_c", &[&format!("-DWRONG={wrong}")]);
        // In this process, and in one of its own.
        work.refuses("run edit.toml --isolate never", &["misbehaving-c", reason]);
        let outcome = work.refuses("run edit.toml", &["misbehaving-c", reason]);
        assert!(wrong != "SPOKEN_ERROR" || outcome.hint() == "give me another", "{}", outcome.stderr);
    }
    work.build_c("tests/c/misbehaving.c", "misbehaving_c", &["-DWRONG=WRITES_INPUT"]);
    work.refuses("run edit.toml --isolate never", &["misbehaving-c", "changed the samples"]);
    work.refuses("run edit.toml", &["misbehaving-c"]);
    // The same one, when it behaves.
    work.build_c("tests/c/misbehaving.c", "misbehaving_c", &["-DWRONG=NOTHING"]);
    assert_shifts(&work, "misbehaving-c");
}

/// The code of a library that is no plugin never runs.
#[test]
fn a_stranger_is_not_loaded() {
    let work = Workplace::new().with_plugins("plugins");
    let library = work.build_c("tests/c/stranger.c", "stranger", &[]);
    let list = work.simod("plugin list");
    let [warning] = list.lines("warning: ")[..] else { panic!("{}", list.stderr) };
    assert!(warning.contains(&format!("stranger{DLL_SUFFIX} is no SIMOD plugin")), "{warning}");
    let outcome = work.run(&format!("plugin check {}", library.display()));
    assert!(outcome.stdout.contains("is no SIMOD plugin"), "{}", outcome.stdout);
    // Half of it is no library at all.
    let bytes = std::fs::read(&library).unwrap();
    work.write(&format!("plugins/stranger{DLL_SUFFIX}"), &bytes[..bytes.len() / 2]);
    assert!(work.simod("plugin list").stderr.contains("is cut off, or damaged"));
}
