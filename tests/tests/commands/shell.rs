//! Completions for shells and pages for `man`, which speak of all options and commands.

use std::io::Write;
use std::process::{Command, Stdio};

use simod_tests::{Workplace, built, skip, workspace};

/// All commands that `simod --help` names.
fn commands(work: &Workplace) -> Vec<String> {
    let help = work.simod("--help").stdout;
    let list = help.split("Commands:\n").nth(1).and_then(|rest| rest.split("\n\n").next());
    // Descriptions of commands may go on in further lines, which are set in.
    let first = list.expect("a list").lines().filter_map(|line| line.strip_prefix("  "));
    let names = first.filter_map(|line| line.split(' ').next().filter(|name| !name.is_empty()));
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

#[test]
fn completions_know_all_commands() {
    let work = Workplace::new();
    let names = commands(&work);
    assert!(names.len() > 10 && names.contains(&"reconstruct".to_owned()), "{names:?}");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = work.simod(&format!("completions {shell}")).stdout;
        let unknown: Vec<&String> = names.iter().filter(|name| !script.contains(name.as_str())).collect();
        assert!(unknown.is_empty() && script.contains("diagnostics"), "{shell}: {unknown:?}");
    }
    assert_eq!(work.run("completions cmd").code, Some(2));
}

#[test]
fn bash_takes_its_completions() {
    let work = Workplace::new();
    let bash =
        Command::new("bash").args(["--norc", "-s"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let Ok(mut bash) = bash else { return skip("bash is not installed") };
    let ask = "COMP_WORDS=(simod rec); COMP_CWORD=1; _simod simod rec simod; echo \"${COMPREPLY[@]}\"\n";
    let script = work.simod("completions bash").stdout + ask;
    bash.stdin.take().expect("a pipe").write_all(script.as_bytes()).expect("bash reads");
    let said = bash.wait_with_output().expect("bash ends").stdout;
    assert_eq!(String::from_utf8_lossy(&said).trim(), "reconstruct");
}

#[test]
fn there_is_a_page_for_each_command() {
    let work = Workplace::new();
    work.simod("manual -o pages/man1");
    for name in commands(&work) {
        let page = work.read(&format!("pages/man1/simod-{name}.1"));
        let page = String::from_utf8(page).expect("text");
        assert!(page.contains(".SH NAME") && page.contains(&format!("simod\\-{name}")), "{name}: {page}");
    }
    let page = String::from_utf8(work.read("pages/man1/simod-reconstruct.1")).expect("text");
    assert!(page.contains("\\-\\-diagnostics") && page.contains("blended\\-jets"), "{page}");
    let all = String::from_utf8(work.read("pages/man1/simod.1")).expect("text");
    assert!(all.contains("simod\\-sample(1)"), "{all}");
    assert!(work.path("pages/man1/simod-plugin-check.1").exists());
    assert!(!work.path("pages/man1/simod-plugin-serve.1").exists());
}

/// The archive of a release, unpacked, is a program that works.
#[test]
fn an_archive_has_all_of_a_release() {
    if cfg!(debug_assertions) {
        return skip("an archive is of a release");
    }
    let tools = ["python3", "tar", "git"];
    if let Some(missing) = tools.iter().find(|tool| Command::new(tool).arg("--version").output().is_err()) {
        return skip(&format!("{missing} is not installed"));
    }
    let work = Workplace::new();
    let target = built().parent().expect("a folder").to_owned();
    let mut script = Command::new("python3");
    script.arg(workspace().join("release/archive.py")).arg(work.path("")).env("CARGO_TARGET_DIR", target);
    let made = script.output().expect("the script runs");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let archive = work.names().into_iter().find(|name| name.ends_with(".tar.gz")).expect("an archive");
    let unpacked = Command::new("tar").args(["-xzf", &archive]).current_dir(work.path("")).status();
    assert!(unpacked.expect("tar runs").success());
    let folder = work.path(archive.trim_end_matches(".tar.gz"));
    for file in [
        "README.md",
        "LICENSE-MIT",
        "share/man/man1/simod-run.1",
        "share/completions/simod",
        "share/applications/simod.desktop",
        "share/mime/packages/simod.xml",
        "docs/formats.md",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
    let licences = std::fs::read_to_string(folder.join("LICENSES-OF-DEPENDENCIES")).expect("a text");
    assert!(
        licences.contains("\nrayon ") && licences.contains("Permission is hereby granted"),
        "{licences:.500}"
    );
    let listed = Command::new(folder.join("bin/simod")).args(["plugin", "list"]).output().expect("it runs");
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    assert!(["rbf", "warp", "skinning"].iter().all(|id| listed.contains(id)), "{listed}");
}
