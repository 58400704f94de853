//! Plugins that do not keep to themselves: nothing of them is left behind, nothing else is changed, nothing is said in their
//! words that a terminal would obey, and none takes the place of another unnoticed.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::env::consts::DLL_SUFFIX;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use simod_tests::{Outcome, Workplace, library};

const DEFORM: &str = "deform model.simod --session edit.toml -o out.ply";

/// A model and its samples, a session with the plugin, and an empty folder of plugins.
fn sampled() -> Workplace {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 5000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work.write_session("model.ply", 500, "[[step]]\ndeform = \"hostile\"\n");
    work
}

/// Has the plugin built that does this.
fn build(work: &Workplace, does: &str) -> std::path::PathBuf {
    work.build_c("tests/c/hostile.c", "hostile", &[&format!("-DDOES={does}")])
}

/// How many processes run in this folder.
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

/// What a plugin starts ends with the plugin's process, however the program ends.
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
    // It ends well: then what it started is no part of it any more either.
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
    for line in ["plugin list", DEFORM, "plugin check plugins/hostile.so"] {
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
    }
}

/// A plugin in the program's own process changes neither the bytes that follow, nor where they go, nor the report.
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

/// What isolation is good for, and what not, is said where it is asked about.
#[test]
fn isolation_is_said_to_be_no_protection_from_malice() {
    let work = Workplace::new();
    for line in ["plugin --help", "run --help", "deform --help"] {
        let help = work.simod(line).stdout.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(help.contains("malice") || help.contains("means harm"), "{line}: {help}");
        assert!(help.contains("your rights"), "{line}: {help}");
    }
}

/// One that calls itself as a plugin of the program's does not take its place, unless it is newer, and then it is told in
/// every command, or it was asked for.
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
            assert_eq!(outcome.stderr, "", "{line}");
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
    let compare = "model = \"model.ply\"\n[[method]]\nname = \"one\"\nsession = \"edit.toml\"\n\
                   [[method]]\nname = \"two\"\nsession = \"edit.toml\"\n";
    work.write("compare.toml", compare);
    for line in lines.into_iter().chain(["compare compare.toml -o compared"]) {
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
        assert_eq!(outcome.stderr, "");
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
    let _ = library("simod_warp");
}
