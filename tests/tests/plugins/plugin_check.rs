//! `simod plugin check`: each thing done wrong breaks its rule, whatever becomes of the process that finds it
//! out, and the program goes on to the others.

use std::env::consts::DLL_SUFFIX;

use serde_json::Value;
use simod_tests::{Outcome, Workplace, library};

/// All rules.
const RULES: usize = 33;

/// A report of `simod plugin check --json` on the misbehaving plugin, which does `how` wrong.
fn check(work: &Workplace, how: &str, options: &str) -> (Outcome, Value) {
    let file = library("misbehaving");
    let mut command = work.command("plugin check --json");
    command.arg(file).args(options.split_whitespace());
    if !how.is_empty() {
        command.env("SIMOD_MISBEHAVE", how);
    }
    let outcome = Outcome::from(command.output().expect("the program starts"));
    let report = outcome.json();
    (outcome, report)
}

/// Finding of a rule.
fn rule<'a>(report: &'a Value, id: &str) -> &'a Value {
    let rules = report["rules"].as_array().expect("rules");
    rules.iter().find(|r| r["rule"] == id).unwrap_or_else(|| panic!("no {id}: {report}"))
}

fn with_verdict<'a>(report: &'a Value, verdict: &str) -> Vec<&'a str> {
    let rules = report["rules"].as_array().expect("rules").iter();
    rules.filter(|r| r["verdict"] == verdict).map(|r| r["rule"].as_str().expect("an id")).collect()
}

/// Checks that a rule is broken, with a finding that contains `found`, a hint, and what reproduces it.
fn expect_failure(outcome: &Outcome, report: &Value, id: &str, found: &str) {
    let rule = rule(report, id);
    assert_eq!(rule["verdict"], "fail", "{id}: {report}");
    assert!(rule["found"].as_str().expect("a finding").contains(found), "{rule}");
    assert!(!rule["hint"].as_str().expect("a hint").is_empty(), "{rule}");
    assert!(rule["again"].as_str().expect("a command").contains(&format!("--rule {id} --seed 1")), "{rule}");
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    let [error] = outcome.lines("error: ")[..] else { panic!("{}", outcome.stderr) };
    assert!(error.contains(id), "{error}");
    assert_eq!(outcome.lines("hint: ").len(), 1, "{}", outcome.stderr);
}

/// One thing wrong breaks one rule, and no other.
#[test]
fn each_wrong_breaks_its_rule() {
    let work = Workplace::new();
    let wrongs = [
        ("writes-to-input", "input-unchanged", "deform changed its input"),
        ("blocked-cancel", "cancel", "deform went on for "),
        ("lying-invalidation", "invalidation", "another result than a fresh one"),
        ("not-identity", "identity", "samples move though no handle does"),
        ("not-repeatable", "repeatable", "prepared and deformed again"),
        ("evaluate-disagrees", "evaluate", "agree to"),
        ("nan-at-bounds", "bounds", "with by = 2.0: deform gives 500 of 500"),
        ("bad-descriptor", "descriptor", "out of its range"),
        ("raw-texts", "texts", "the plugin's summary has a character U+001B in it"),
        ("log-spam", "log", "1000 lines"),
        ("error-in-prepare", "ordinary", "this does not please me"),
    ];
    for (how, id, found) in wrongs {
        let options = format!("--rule loads --rule large --rule {id}");
        let (outcome, report) = check(&work, how, &options);
        expect_failure(&outcome, &report, id, found);
        assert_eq!(with_verdict(&report, "fail"), [id], "{how}");
        assert_eq!(rule(&report, "loads")["verdict"], "pass", "{how}");
    }
}

/// Descriptions that are too long to read are told by both rules on the description, through both doors.
#[test]
fn descriptions_have_limits() {
    let work = Workplace::new();
    for (how, found) in [
        ("many-params", "the parameters are 10003, more than 10000"),
        ("many-choices", "the choices of parameter `many` are 10001"),
        ("long-hint", "the hint of parameter `long` is 65536 bytes long"),
    ] {
        let (outcome, report) = check(&work, how, "--rule descriptor --rule texts --rule ordinary");
        expect_failure(&outcome, &report, "descriptor", found);
        expect_failure(&outcome, &report, "texts", found);
        assert_eq!(with_verdict(&report, "skip"), ["ordinary"], "{how}");
    }
}

/// A library in Rust whose panics end the process is told from others, before any of it runs.
#[test]
#[cfg(target_os = "linux")]
fn panics_that_abort_are_noticed() {
    let work = Workplace::new();
    let source = "#[unsafe(export_name = \"_1as_0lib_1header_0root_bmodule_bloader\")]\npub static ROOT: u64 = 0;\n\
                  #[unsafe(no_mangle)]\npub extern \"C\" fn f(x: usize) -> usize { [1, 2][x] + std::env::args().count() }\n";
    work.write("lib.rs", source);
    for (how, verdict) in [("abort", "fail"), ("unwind", "pass")] {
        let mut rustc = std::process::Command::new("rustc");
        rustc.args(["--edition=2024", "--crate-type=cdylib", "-O", "lib.rs", "-o", "lib.so", "-C"]);
        let output = rustc.arg(format!("panic={how}")).current_dir(work.path("")).output().expect("rustc");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report = work.run("plugin check lib.so --rule unwinds --json").json();
        assert_eq!(rule(&report, "unwinds")["verdict"], verdict, "{how}: {report}");
    }
}

/// A plugin of the same id would take the place of one that comes with the program.
#[test]
fn ids_are_not_taken_from_the_programs_own_plugins() {
    let work = Workplace::new();
    work.write(&format!("mine{DLL_SUFFIX}"), std::fs::read(library("simod_warp")).expect("a library"));
    let outcome = work.run(&format!("plugin check mine{DLL_SUFFIX} --rule loads --rule own-id --json"));
    expect_failure(&outcome, &outcome.json(), "own-id", "the id `warp`");
}

/// A mistake in every deformation breaks every rule that deforms; the others are kept.
#[test]
fn what_always_goes_wrong() {
    let work = Workplace::new();
    let wrongs = [
        ("nan", "not finite", ""),
        ("unwritten", "1 of 100 positions unwritten", ""),
        ("panic-in-prepare", "panicked: no state for 100 samples", ""),
        ("cancel-unasked", "nobody asked", ""),
        ("abort", "ended by signal 6", ""),
        ("segfault", "ended by signal 11", ""),
        ("endless-loop", "still running after 2 s", "--time-limit 2"),
        ("endless-allocation", "out of memory", "--memory-limit 200M"),
    ];
    for (how, found, limit) in wrongs {
        let unix = cfg!(unix) || !found.contains("signal");
        if !unix || (how == "endless-allocation" && !cfg!(target_os = "linux")) {
            continue;
        }
        let options = format!("--rule loads --rule descriptor --rule collinear {limit}");
        let (outcome, report) = check(&work, how, &options);
        expect_failure(&outcome, &report, "collinear", found);
        assert_eq!(with_verdict(&report, "pass"), ["loads", "descriptor"], "{how}");
    }
}

/// A library that crashes the process that loads it, and a file that is no library.
#[test]
fn what_does_not_load() {
    let work = Workplace::new();
    if cfg!(unix) {
        let (outcome, report) = check(&work, "segfault-at-load", "");
        expect_failure(&outcome, &report, "loads", "ended by signal 11");
        assert_eq!(with_verdict(&report, "fail"), ["loads"]);
        assert_eq!(with_verdict(&report, "skip").len(), RULES - 1, "{report}");
    }
    let (outcome, report) = check(&work, "panic-at-load", "");
    expect_failure(&outcome, &report, "loads", "panicked: who am I");

    let file = format!("letter{DLL_SUFFIX}");
    work.write(&file, "a text is no library, be it ever so long\n".repeat(50));
    let line = format!("plugin check {file}");
    let outcome = work.run(&line);
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    assert!(outcome.stdout.starts_with("FAIL loads"), "{}", outcome.stdout);
    assert!(outcome.stdout.contains("no library"), "{}", outcome.stdout);
    let all = format!("0 passed, 1 failed, 0 warned, {} skipped\n", RULES - 1);
    assert!(outcome.stdout.ends_with(&all), "{}", outcome.stdout);
    assert_eq!(outcome.lines("error: ").len(), 1, "{}", outcome.stderr);

    work.refuses("plugin check nothing.so", &["nothing.so"]);
    work.refuses("plugin check nobody", &["there is no plugin `nobody`"]);
    let outcome = work.run("plugin check warp --rule identiy");
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("did you mean `identity`?"), "{}", outcome.stderr);
}

/// Plugins that come with the program break no rule, however busy the machine is; warnings are printed.
#[expect(clippy::print_stdout, reason = "this is a part of tests")]
fn keeps_every_rule(id: &str) {
    let report = Workplace::new().report(&format!("plugin check {id} --time-limit 600"));
    assert_eq!(with_verdict(&report, "fail"), [""; 0], "{report}");
    assert_eq!(report["rules"].as_array().map(Vec::len), Some(RULES));
    for r in report["rules"].as_array().expect("rules").iter().filter(|r| r["verdict"] != "pass") {
        println!("{id}: {} {}: {}", r["verdict"], r["rule"], r["found"]);
    }
}

/// A test for each plugin, as some take long and can be checked at the same time.
mod every_rule_is_kept {
    use super::keeps_every_rule;

    #[test]
    fn by_warp() {
        keeps_every_rule("warp");
    }

    #[test]
    fn by_rbf() {
        keeps_every_rule("rbf");
    }

    #[test]
    fn by_laplacian() {
        keeps_every_rule("laplacian");
    }

    #[test]
    fn by_lattice() {
        keeps_every_rule("lattice");
    }

    #[test]
    fn by_cage() {
        keeps_every_rule("cage");
    }

    #[test]
    fn by_smooth() {
        keeps_every_rule("smooth");
    }

    #[test]
    fn by_smooth_handle() {
        keeps_every_rule("smooth-handle");
    }

    #[test]
    fn by_displacement_paint() {
        keeps_every_rule("displacement-paint");
    }

    #[test]
    fn by_control_points() {
        keeps_every_rule("control-points");
    }

    #[test]
    fn by_curve() {
        keeps_every_rule("curve");
    }

    #[test]
    fn by_blendshapes() {
        keeps_every_rule("blendshapes");
    }

    #[test]
    fn by_register() {
        keeps_every_rule("register");
    }

    #[test]
    fn by_skinning() {
        keeps_every_rule("skinning");
    }
}
