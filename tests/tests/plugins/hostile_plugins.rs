//! Plugins that do not keep to themselves: nothing of them is left behind, nothing else is changed, nothing
//! is said in their words that a terminal would obey, and none takes the place of another unnoticed.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::env::consts::DLL_SUFFIX;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use simod_tests::{Outcome, Workplace};

const DEFORM: &str = "deform model.simod --session edit.toml -o out.ply";

/// A model and its samples, a session with the plugin, and an empty folder of plugins.
fn sampled() -> Workplace {
    let work = Workplace::new().with_plugins("plugins");
    // Nothing touches there, so that there are as many samples as asked for.
    work.simod("generate -o model.ply --vertices 5000 --shape bumpy-sphere");
    work.simod("sample model.ply -o model.simod --samples 500");
    work.write_session("model.ply", 500, "[[step]]\ndeform = \"hostile\"\n");
    work
}

/// Has the plugin built that does this.
fn build(work: &Workplace, does: &str) -> std::path::PathBuf {
    work.build_c("tests/c/hostile.c", "hostile", &[&format!("-DDOES={does}")])
}

/// Number of processes that run in this folder.
#[cfg(target_os = "linux")]
fn processes(work: &Workplace) -> usize {
    let folder = work.path("").canonicalize().unwrap();
    let all = std::fs::read_dir("/proc").unwrap().filter_map(Result::ok);
    let of_ours = |p: &std::fs::DirEntry| {
        let cwd = std::fs::read_link(p.path().join("cwd"));
        p.file_name().to_string_lossy().parse::<u32>().is_ok() && cwd.is_ok_and(|cwd| cwd == folder)
    };
    all.filter(of_ours).count()
}

#[cfg(target_os = "linux")]
fn wait_until(work: &Workplace, what: &str, is_so: impl Fn(usize) -> bool) {
    let since = Instant::now();
    while !is_so(processes(work)) {
        assert!(since.elapsed() < Duration::from_secs(10), "{what}: {} processes", processes(work));
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn start(work: &Workplace, line: &str) -> std::process::Child {
    let mut command = work.command(line);
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Killed at any moment while a library loads, the program leaves no process behind, nor does the library.
#[test]
#[cfg(target_os = "linux")]
fn a_kill_while_a_library_loads_leaves_nobody_behind() {
    let work = sampled();
    for does in ["SLEEPS_AT_LOAD", "STARTS_A_PROCESS_AT_LOAD"] {
        build(&work, does);
        for milliseconds in [0, 2, 4, 6, 8, 10, 12, 15, 18, 22, 27, 33, 40, 60, 100, 200] {
            let mut child = start(&work, "plugin list");
            std::thread::sleep(Duration::from_millis(milliseconds));
            child.kill().unwrap();
            child.wait().unwrap();
            wait_until(&work, &format!("{does}, killed after {milliseconds} ms"), |n| n == 0);
        }
    }
}

/// Processes that a plugin starts end with the plugin's own, however the program ends.
#[test]
#[cfg(target_os = "linux")]
fn what_a_plugin_starts_ends_with_it() {
    let work = sampled();
    build(&work, "STARTS_A_PROCESS");
    // So that it is remembered, and the first process is the one that deforms.
    work.simod("plugin list");
    for signal in ["-KILL", "-INT"] {
        let child = start(&work, DEFORM);
        wait_until(&work, "it starts one", |n| n == 3);
        let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        child.wait_with_output().unwrap();
        wait_until(&work, signal, |n| n == 0);
    }
    // The library is still there.
    let work = work.path("plugins").join(format!("hostile{DLL_SUFFIX}"));
    assert!(work.is_file());
}

/// The first Ctrl-C ends a command that waits for a library.
#[test]
#[cfg(target_os = "linux")]
fn a_library_that_does_not_finish_loading_can_be_interrupted() {
    let work = sampled();
    build(&work, "SLEEPS_AT_LOAD");
    let before = work.snapshot();
    // In the last one it is known what it is, and it is loaded when it is first called.
    for line in ["plugin list", DEFORM, "plugin check plugins/hostile.so", DEFORM] {
        let child = start(&work, line);
        wait_until(&work, "it loads", |n| n == 2);
        std::thread::sleep(Duration::from_millis(200));
        let since = Instant::now();
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let outcome = Outcome::from(child.wait_with_output().unwrap());
        assert!(since.elapsed() < Duration::from_secs(5), "{line} took {:?}", since.elapsed());
        assert_eq!((outcome.code, outcome.lines("error: ")), (Some(130), vec!["cancelled"]), "{line}");
        wait_until(&work, line, |n| n == 0);
        assert_eq!(work.snapshot(), before);
        if line.contains("check") {
            let known = work.command("plugin list").env("AWAKE", "1").output().unwrap();
            assert!(known.status.success());
            assert!(work.plugin_cache().is_file());
        }
    }
}

/// So does it where that loads in the program itself.
#[test]
#[cfg(target_os = "linux")]
fn a_library_that_loads_in_the_program_can_be_interrupted() {
    let work = sampled();
    build(&work, "SLEEPS_AT_LOAD");
    let child = start(&work, &format!("{DEFORM} --isolate never"));
    wait_until(&work, "it loads", |n| n == 1);
    std::thread::sleep(Duration::from_secs(1));
    let since = Instant::now();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let outcome = Outcome::from(child.wait_with_output().unwrap());
    assert!(since.elapsed() < Duration::from_secs(10), "{:?}", since.elapsed());
    assert_eq!((outcome.code, outcome.lines("error: ")), (Some(130), vec!["cancelled"]));
}

/// A plugin in the program's own process changes neither the bytes that follow, nor where they go, nor the
/// report.
#[test]
fn the_program_s_surroundings_are_kept() {
    let work = sampled();
    // The steps that follow compute in the program.
    let steps = "[[step]]\ndeform = \"hostile\"\n[[step.region]]\nrole = \"mask\"\nfalloff = 1\n\
                 shapes = [{ sphere = { center = [0, 1, 0], radius = 0.5 } }]\n\
                 [[step]]\ndeform = \"warp\"\nparams = { angle = 33 }\n";
    work.write_session("model.ply", 500, steps);
    let results = |does: &str| {
        build(&work, does);
        let mut results = Vec::new();
        for line in ["run edit.toml --json --isolate never", &format!("{DEFORM} --json --isolate never")] {
            let outcome = work.simod(line);
            let report: serde_json::Value = outcome.json();
            assert_eq!(report["samples"], 500, "{does}: {report}");
            assert_eq!(outcome.stdout.lines().count(), 1, "{does}: {}", outcome.stdout);
        }
        for file in ["edited.ply", "out.ply"] {
            results.push(work.read(file));
            std::fs::remove_file(work.path(file)).unwrap();
        }
        results
    };
    let expected = results("NOTHING");
    for does in ["CHANGES_ROUNDING", "CHANGES_FOLDER", "PRINTS", "CLOSES_OUTPUT"] {
        assert!(results(does) == expected, "{does} changes what is written");
    }
}

/// The help on isolation says what it is good for, and what not.
#[test]
fn isolation_is_said_to_be_no_protection_from_malice() {
    let work = Workplace::new();
    for line in ["plugin --help", "run --help", "deform --help"] {
        let help = work.simod(line).stdout.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(help.contains("malice") || help.contains("means harm"), "{line}: {help}");
        assert!(help.contains("your rights"), "{line}: {help}");
    }
}

/// One that calls itself as a plugin of the program's does not take its place, unless it is newer, and then
/// it is told in every command, or it was asked for.
#[test]
fn none_takes_the_place_of_another_unnoticed() {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 5000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work.write_session("model.ply", 500, "[[step]]\ndeform = \"warp\"\n");
    let own = work.report("plugin info warp")["version"].as_str().unwrap().to_owned();
    let same = |version: &str| {
        let define = format!("-DVERSION=\"{version}\"");
        work.build_c("tests/c/hostile.c", "warp2", &["-DDOES=NOTHING", "-DID=\"warp\"", &define])
    };
    let lines = ["run edit.toml", DEFORM, "plugin info warp", "plugin list"];
    work.simod("run edit.toml");
    let expected = work.read("edited.ply");
    // Of the same version, and an older one: not used, and that is told in the list alone.
    for version in [own.as_str(), "0.0.1"] {
        let other = same(version);
        for line in lines {
            let outcome = work.simod(line);
            assert!(!outcome.stderr.contains("warp"), "{line}: {}", outcome.stderr);
            assert_eq!(
                outcome.stdout.contains(&*other.display().to_string()),
                line == "plugin list",
                "{line}"
            );
        }
        assert!(work.read("edited.ply") == expected, "{version} is used");
    }
    // A newer one.
    let other = same("99.0.0");
    let compare = "[model]\npath = \"model.ply\"\n[[method]]\nname = \"one\"\nsession = \"edit.toml\"\n\
                   [[method]]\nname = \"two\"\nsession = \"edit.toml\"\n";
    work.write("compare.toml", compare);
    let others = [
        "compare compare.toml -o compared",
        "plugin migrate edit.toml -o new.toml",
        "plugin check warp --rule descriptor",
    ];
    for line in lines.into_iter().chain(others) {
        let outcome = work.simod(line);
        let told = outcome.stderr.lines().filter(|l| l.contains("takes the place of the program's own warp"));
        assert!(told.clone().count() >= 1, "{line}: {}", outcome.stderr);
        assert!(
            told.clone().all(|l| l.contains(&*other.display().to_string()) && l.contains("99.0.0")),
            "{line}"
        );
    }
    assert!(work.read("edited.ply") != expected, "the newer one is used");
    // Asked for, nothing needs to be told; and the version does not matter.
    for version in ["99.0.0", "0.0.1"] {
        let other = same(version);
        let outcome = work.simod(&format!("run edit.toml --use {}", other.display()));
        assert!(!outcome.stderr.contains("warp"), "{}", outcome.stderr);
        assert!(work.read("edited.ply") != expected, "{version}: the one that was asked for is used");
    }
    work.refuses("run edit.toml --use nowhere.so", &["nowhere.so"]);
}

/// A step that was made with another version of its plugin says so.
#[test]
fn another_version_is_told() {
    let work = sampled();
    build(&work, "NOTHING");
    let made_with = |version: &str| {
        let step = format!("[[step]]\ndeform = \"hostile\"\nplugin = {{ version = \"{version}\" }}\n");
        work.write_session("model.ply", 500, &step);
        work.simod(DEFORM)
    };
    assert_eq!(made_with("1.0.0").stderr, "");
    let outcome = made_with("0.9.0");
    let [warning] = outcome.lines("warning: ")[..] else { panic!("{}", outcome.stderr) };
    assert!(warning.contains("edit.toml, line 5") && warning.contains("0.9.0"), "{warning}");
    assert!(warning.contains("hostile") && warning.contains("1.0.0 is used"), "{warning}");
}

/// A folder of plugins that everybody may write to is told.
#[test]
fn an_open_folder_is_told() {
    let work = sampled();
    build(&work, "NOTHING");
    let folder = work.path("plugins");
    assert_eq!(work.simod("plugin list").stderr, "");
    for mode in [0o777, 0o1777] {
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(mode)).unwrap();
        for line in ["plugin list", DEFORM] {
            let outcome = work.simod(line);
            let [warning] = outcome.lines("warning: ")[..] else { panic!("{line}: {}", outcome.stderr) };
            assert!(
                warning.contains(&*folder.display().to_string()) && warning.contains("anybody"),
                "{warning}"
            );
        }
    }
    std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// Texts of a plugin, on itself and to the user, do nothing to a terminal: no escape sequences, no lines of
/// their own.
#[test]
fn nothing_raw_reaches_a_terminal() {
    let work = sampled();
    build(&work, "SPEAKS_RAW");
    let refused = "[[step]]\ndeform = \"hostile\"\nparams = { by = 2 }\n";
    work.write(
        "refused.toml",
        String::from_utf8(work.read("edit.toml"))
            .unwrap()
            .replace("[[step]]\ndeform = \"hostile\"\n", refused),
    );
    let lines = [
        "plugin list",
        "plugin list --json",
        "plugin info hostile",
        "plugin info hostile --json",
        "plugin check hostile",
        "plugin check hostile --json",
        DEFORM,
        "run edit.toml --json",
        "run refused.toml",
        "run refused.toml --isolate never",
    ];
    let is_raw = |c: char| c.is_control() && c != '\n';
    for line in lines {
        let outcome = work.run(line);
        for text in [&outcome.stdout, &outcome.stderr] {
            assert!(!text.chars().any(is_raw), "{line}: {text:?}");
            // A line that looks like one of the program's own.
            assert!(
                !text.lines().any(|l| l.starts_with("error: \u{9b}") || l.starts_with("error:  2Jfake")),
                "{line}: {text}"
            );
        }
        if line.ends_with("--json") {
            assert_eq!(outcome.stdout.lines().count(), 1, "{line}");
        }
    }
    // As data, all is as it was said.
    let info = work.report("plugin info hostile");
    assert!(info["parameters"][0]["hint"].as_str().unwrap().contains("\u{1b}[31m"), "{info}");
    let check = work.run("plugin check hostile --rule texts");
    assert!(check.stdout.starts_with("FAIL texts") && check.stdout.contains("U+001B"), "{}", check.stdout);
}

/// Results that are numbers, and of no use to what follows, are the fault of who gave them.
#[test]
fn results_too_far_away_are_the_plugin_s_fault() {
    let work = sampled();
    let steps = "[[step]]\ndeform = \"hostile\"\n[[step]]\ndeform = \"warp\"\nparams = { angle = 33 }\n";
    for does in ["GOES_FAR", "GOES_TOO_FAR"] {
        let library = build(&work, does);
        for steps in ["[[step]]\ndeform = \"hostile\"\n", steps] {
            work.write_session("model.ply", 500, steps);
            for options in ["", " --isolate never"] {
                let named =
                    ["edit.toml, line 5: plugin hostile", "1 of 500 positions are farther away", "index 0"];
                work.refuses(&format!("{DEFORM}{options}"), &named);
                work.refuses(&format!("run edit.toml{options}"), &named);
            }
        }
        let report = work.run(&format!("plugin check {} --rule collinear --json", library.display())).json();
        assert!(report["rules"][0]["found"].as_str().unwrap().contains("too far away"), "{report}");
    }
}

/// A function that is nowhere is told when the library is loaded, and not by a crash when it is called.
#[test]
fn a_function_that_is_nowhere_is_told_at_load() {
    let work = sampled();
    let library = work.build_c("tests/c/hostile.c", "hostile", &["-DDOES=LACKS_A_FUNCTION", "-DLACKING"]);
    let outcome = work.run(&format!("plugin check {}", library.display()));
    assert_eq!(outcome.code, Some(1));
    assert!(outcome.stdout.starts_with("FAIL loads"), "{}", outcome.stdout);
    assert!(outcome.stdout.lines().next().unwrap().contains("not_there_at_all"), "{}", outcome.stdout);
    for options in ["", " --isolate never"] {
        let refused = work.refuses(&format!("{DEFORM}{options}"), &["edit.toml, line 5", "not_there_at_all"]);
        assert!(refused.hint().contains("link it"), "{}", refused.stderr);
    }
}

/// A tool whose defaults do something keeps the rule on identity where it says so, and what is to be said
/// stands in the hint; one that lags behind its handles is told what it misses, and by how much.
#[test]
fn tools_that_do_something_by_themselves_say_so() {
    let work = Workplace::new();
    let rules = |does: &str| {
        let library = build(&work, does);
        let rules = "--rule identity --rule rigid --rule is-identity";
        let outcome = work.run(&format!("plugin check {} {rules} --json", library.display()));
        let report = outcome.json();
        let of = |id: &str| {
            let rule = report["rules"].as_array().unwrap().iter().find(|r| r["rule"] == id).unwrap();
            ["verdict", "found", "hint"].map(|key| rule[key].as_str().unwrap().to_owned())
        };
        (of("identity"), of("rigid"))
    };
    let ([verdict, _, hint], [rigid, ..]) = rules("MOVES_AT_REST");
    assert_eq!((verdict.as_str(), rigid.as_str()), ("fail", "skip"));
    assert!(hint.contains("`IsIdentity`") && hint.contains("SIMOD_IS_IDENTITY"), "{hint}");
    let ([verdict, found, _], [rigid, ..]) = rules("MOVES_AT_REST_AND_SAYS_SO");
    assert_eq!((verdict.as_str(), rigid.as_str()), ("pass", "skip"), "{found}");
    let ([verdict, ..], [rigid, found, hint]) = rules("LAGS_BEHIND");
    assert_eq!((verdict.as_str(), rigid.as_str()), ("pass", "warn"), "{found}");
    assert!(found.contains("of the diagonal from where") && found.contains("more than 1e-4"), "{found}");
    assert!(hint.contains("in full"), "{hint}");
}

/// The parameters that a user can set are there as data, and in groups as text.
#[test]
fn parameters_are_told_as_data() {
    let work = Workplace::new().with_plugins("plugins");
    build(&work, "NOTHING");
    let info = work.report("plugin info hostile");
    let by = &info["parameters"][0];
    let expected = serde_json::json!({
        "id": "by", "name": "By", "kind": "float", "unit": null, "default": 1.0, "hard_range": [-2.0, 2.0],
        "soft_range": [null, null], "group": "Distances", "hint": "How far", "invalidates_preparation": false,
        "text": "How far: a number from -2 to 2; default 1",
    });
    assert_eq!(*by, expected);
    let text = work.simod("plugin info hostile").stdout;
    assert!(text.contains("\n  Distances:\n    by "), "{text}");
    let warp = work.report("plugin info warp");
    let of = |id: &str| {
        let all = warp["parameters"].as_array().unwrap();
        all.iter().find(|p| p["id"] == id).unwrap_or_else(|| panic!("{id}: {warp}")).clone()
    };
    let operation = of("operation");
    assert!(
        operation["choices"].as_array().unwrap().iter().any(|c| c["id"] == operation["default"]),
        "{operation}"
    );
    assert_eq!(of("angle")["unit"], "degrees");
    assert_eq!(of("axis")["kind"], "direction");
}

/// An id that is taken is refused before a project is made of it.
#[test]
fn a_new_plugin_takes_no_other_s_id() {
    let work = Workplace::new().with_plugins("plugins");
    work.refuses("plugin new warp", &["there is a plugin `warp` already"]);
    build(&work, "NOTHING");
    let refused =
        work.refuses("plugin new hostile --lang c", &["there is a plugin `hostile` already", "hostile.so"]);
    assert!(refused.hint().contains("my-hostile"), "{}", refused.stderr);
    assert_eq!(work.names(), ["plugins"]);
}

/// Whatever a plugin makes of older sessions, it is an error that names it, in both places where it may run.
#[test]
fn bad_migrations_are_the_plugin_s_fault() {
    let work = sampled();
    for (does, what) in [
        ("ALIASES_RAW", "the alias `"),
        ("ALIASES_A_PARAMETER", "the alias `by` is a parameter's id"),
        ("VERSION_ZERO", "its state version is 0"),
        ("GIVES_ENDLESSLY", "more than 10000 settings"),
        ("GIVES_WHAT_IS_NOT_THERE", "none of its parameters"),
        ("GIVES_NOTHING_GOOD", "the numbers of the setting `by`"),
        ("CRASHES_WHILE_MIGRATING", "signal 6"),
    ] {
        build(&work, does);
        for place in ["always", "never"] {
            if does.starts_with("CRASHES") && place == "never" {
                continue;
            }
            work.write_session("model.ply", 500, "[[step]]\ndeform = \"hostile\"\nparams = { by = 0.5 }\n");
            let outcome = work.run(&format!("{DEFORM} --isolate {place}"));
            assert_eq!(outcome.code, Some(1), "{does}: {}", outcome.stderr);
            assert!(
                outcome.stderr.contains(what) && outcome.stderr.contains("hostile"),
                "{does}: {}",
                outcome.stderr
            );
            assert!(!outcome.stderr.contains('\u{1b}'), "{does}: {}", outcome.stderr);
            assert!(!work.path("out.ply").exists());
        }
        let report = work
            .run(&format!(
                "plugin check plugins/hostile{DLL_SUFFIX} --rule descriptor --rule migration --json"
            ))
            .json();
        assert!(report["failed"].as_u64() >= Some(1), "{does}: {report}");
    }
}
