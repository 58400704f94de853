//! Plugins in processes of their own: whatever they do there, the program goes on.
#![cfg(unix)]

use std::env::consts::DLL_SUFFIX;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use simod_tests::{Outcome, Workplace, library, skip};

/// A model and its samples, and the plugin that misbehaves in a folder to look in.
fn sampled() -> Workplace {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 5000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work.write(
        &format!("plugins/misbehaving{DLL_SUFFIX}"),
        std::fs::read(library("misbehaving")).expect("one"),
    );
    work
}

fn session(work: &Workplace, how: &str) {
    let step = format!("[[step]]\ndeform = \"misbehaving\"\nparams = {{ how = \"{how}\" }}\n");
    work.write_session("model.ply", 500, &step);
}

const DEFORM: &str = "deform model.simod --session edit.toml -o out.ply";

#[test]
fn what_would_end_the_program_ends_the_plugin_alone() {
    let work = sampled();
    // The kind of misbehaviour, the call that it happens in, and words of the error.
    let bad = [
        ("abort", "in prepare", "signal 6 (abort)"),
        ("segfault", "in deform", "invalid memory access"),
        ("writes-to-input", "in deform", "invalid memory access"),
        ("endless-loop --plugin-patience 1", "deform", "no sign of life for 1 s"),
        ("endless-allocation --plugin-memory 300M", "in prepare", "ran out of the 300 MB"),
        ("panic-in-prepare", "panicked", "no state for"),
        ("panic-in-deform", "panicked", "half-way"),
        ("panic-payload", "panicked", ""),
        ("error-in-deform", "not today", ""),
        ("cancel-unasked", "stopped unasked", ""),
        ("nan", "not finite", "index"),
        ("unwritten", "unwritten", "index"),
    ];
    for (how, call, reason) in bad {
        let (how, options) = how.split_once(' ').unwrap_or((how, ""));
        session(&work, how);
        work.refuses(
            &format!("{DEFORM} {options}"),
            &["edit.toml, line 5: plugin misbehaving", call, reason],
        );
    }
    if cfg!(not(target_os = "linux")) {
        skip("only Linux limits a process's memory");
    }
    for how in ["well", "log-spam", "panic-in-drop"] {
        session(&work, how);
        work.simod(DEFORM);
        std::fs::remove_file(work.path("out.ply")).expect("the output");
    }
}

#[test]
fn results_are_the_same_in_any_process() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    work.simod("sample model.ply -o model.simod --samples 2000");
    let steps = "
        [[step]]
        deform = \"warp\"
        params = { angle = 120 }
        [[step]]
        deform = \"rbf\"
        [[step.region]]
        role = \"fixed\"
        shapes = [{ half-space = { point = [0, 0.5, 0], normal = [0, -1, 0] } }]
        [[step.region]]
        role = \"handle\"
        shapes = [{ half-space = { point = [0, 1.6, 0], normal = [0, 1, 0] } }]
        falloff = 0.1
        move = { translate = [0.3, 0.1, 0], axis = [0, 0, 1], degrees = -30, pivot = [0, 1.6, 0] }
        [[step.region]]
        role = \"mask\"
        shapes = [{ sphere = { center = [0, 1, 0], radius = 3 } }]
        falloff = 1
        ";
    work.write_session("model.ply", 2000, steps);
    let mut results = Vec::new();
    for options in ["--isolate never", "--isolate always", "--isolate always --threads 1"] {
        work.simod(&format!("{DEFORM} {options}"));
        // With every vertex's exact image, which is asked for by several threads.
        let measured = work.report(&format!("run edit.toml --measure {options}"));
        results.push((work.read("out.ply"), work.read("edited.ply"), measured["transfer_error"].clone()));
    }
    assert!(results[0] == results[1] && results[0] == results[2]);
    let info = work.simod("plugin info rbf --isolate always");
    assert!(info.stdout.contains("in a process of its own"), "{}", info.stdout);
    assert!(!work.simod("plugin info rbf").stdout.contains("in a process of its own"));
}

#[test]
fn a_plugin_that_fails_to_say_what_it_is_hides_no_other() {
    let work = sampled();
    for how in ["segfault-at-load", "panic-at-load"] {
        let mut list = work.command("plugin list");
        list.env("SIMOD_MISBEHAVE", how);
        let list = Outcome::from(list.output().expect("the program starts"));
        assert_eq!(list.code, Some(0), "{how}");
        let [warning] = list.lines("warning: ")[..] else { panic!("{how}: {}", list.stderr) };
        assert!(warning.contains(&format!("misbehaving{DLL_SUFFIX}")), "{warning}");
        assert!(list.stdout.contains("warp") && !list.stdout.contains("misbehaving"), "{}", list.stdout);
    }
    // One that takes its time is told, once: then it is remembered.
    for warnings in [1, 0] {
        let mut list = work.command("plugin list");
        let list = Outcome::from(list.env("SIMOD_MISBEHAVE", "slow-at-load").output().expect("an end"));
        assert!(list.stdout.contains("misbehaving"), "{}", list.stdout);
        assert_eq!(list.lines("warning: ").len(), warnings, "{}", list.stderr);
        assert!(list.lines("warning: ").iter().all(|w| w.contains("to say what it is")), "{}", list.stderr);
    }
}

#[test]
fn libraries_are_remembered_until_they_change() {
    let work = sampled();
    let listed = || work.simod("plugin list").stdout;
    let list = listed();
    assert!(list.contains("misbehaving"), "{list}");
    let cache = std::fs::read(work.plugin_cache()).expect("a cache");
    // Now it would not say what it is; but nobody asks.
    let mut again = work.command("plugin list");
    let again = Outcome::from(again.env("SIMOD_MISBEHAVE", "segfault-at-load").output().expect("an end"));
    assert_eq!((again.stdout.as_str(), again.stderr.as_str()), (list.as_str(), ""));
    assert!(std::fs::read(work.plugin_cache()).expect("a cache") == cache);
    // Another library in its place is noticed, and so is one that is gone.
    let file = format!("plugins/misbehaving{DLL_SUFFIX}");
    work.write(&file, "no library any more\n".repeat(10));
    let outcome = work.simod("plugin list");
    assert!(!outcome.stdout.contains("misbehaving"), "{}", outcome.stdout);
    assert!(outcome.lines("warning: ")[0].contains("no library"), "{}", outcome.stderr);
    std::fs::remove_file(work.path(&file)).expect("a file");
    assert!(work.simod("plugin list").lines("warning: ").is_empty());
    // A cache that cannot be read is made anew.
    std::fs::File::create(work.plugin_cache()).expect("a cache");
    work.simod("plugin list");
    assert!(std::fs::metadata(work.plugin_cache()).expect("a cache").len() > 0);
}

/// Starts a deformation that never ends, and waits until the plugin is at it.
fn endless(work: &Workplace) -> std::process::Child {
    session(work, "endless-loop");
    // So that it is remembered, and not started twice.
    work.simod("plugin list");
    let mut command = work.command(DEFORM);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    let since = Instant::now();
    while processes(work) < 2 && since.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(20));
    }
    // A moment more, until it deforms.
    std::thread::sleep(Duration::from_millis(300));
    child
}

/// Number of processes that run in this folder.
fn processes(work: &Workplace) -> usize {
    let folder = work.path("").canonicalize().expect("a folder");
    let all = std::fs::read_dir("/proc").expect("processes").filter_map(Result::ok);
    let of_ours = |p: &std::fs::DirEntry| {
        let cwd = std::fs::read_link(p.path().join("cwd"));
        p.file_name().to_string_lossy().parse::<u32>().is_ok() && cwd.is_ok_and(|cwd| cwd == folder)
    };
    all.filter(of_ours).count()
}

#[test]
#[cfg(target_os = "linux")]
fn the_plugins_process_ends_with_the_program() {
    let work = sampled();
    // Killed: nobody is there to clean up.
    let mut child = endless(&work);
    assert_eq!(processes(&work), 2);
    child.kill().expect("kill works");
    child.wait().expect("an end");
    let since = Instant::now();
    while processes(&work) > 0 {
        assert!(since.elapsed() < Duration::from_secs(10), "the plugin goes on alone");
        std::thread::sleep(Duration::from_millis(20));
    }
    // Interrupted: a plugin that does not listen is ended.
    let before = work.names();
    let child = endless(&work);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
    assert!(sent.success());
    let outcome = Outcome::from(child.wait_with_output().expect("an end"));
    assert_eq!(
        (outcome.code, outcome.lines("error: ")),
        (Some(130), vec!["cancelled"]),
        "{}",
        outcome.stderr
    );
    assert_eq!(processes(&work), 0);
    assert_eq!(work.names(), before);
}
