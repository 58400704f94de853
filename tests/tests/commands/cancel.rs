//! Long work tells how far it is, and Ctrl-C stops it: nothing of it is left.
#![cfg(unix)]

use std::process::{Command, Stdio};
use std::time::Duration;

use simod_tests::{Outcome, Workplace, skip};

#[test]
fn an_interrupted_run_leaves_nothing() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 3000000 --no-colors");
    work.write_session("model.ply", 200_000, "[[step]]\ndeform = \"warp\"\n");
    let before = work.snapshot();
    let mut interrupted = 0;
    for wait in [50, 200, 400, 800, 1600].map(Duration::from_millis) {
        let mut command = work.command("run edit.toml");
        let child =
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        std::thread::sleep(wait);
        let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
        assert!(sent.success());
        let outcome = Outcome::from(child.wait_with_output().expect("an end"));
        if outcome.code == Some(0) {
            // The run was done before the signal came.
            std::fs::remove_file(work.path("edited.ply")).expect("an output");
            continue;
        }
        if outcome.code.is_none() {
            // The signal came before the program was ready for it: it was ended at once, and had begun
            // nothing.
            assert_eq!(work.snapshot(), before, "after {wait:?}");
            continue;
        }
        interrupted += 1;
        assert_eq!(outcome.code, Some(130), "after {wait:?}: {}", outcome.stderr);
        assert_eq!(outcome.lines("error: "), ["cancelled"]);
        assert_eq!(outcome.lines("hint: ").len(), 1);
        assert_eq!(work.snapshot(), before, "after {wait:?}");
    }
    if interrupted == 0 {
        skip("every run was done before it could be interrupted");
    }
}

#[test]
fn lines_of_progress_are_for_programs_to_read() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 300000 --no-colors");
    let said = work.simod("sample model.ply -o model.simod --json --progress lines");
    let lines = said.lines("progress: ");
    for stage in ["counting", "clustering"] {
        let of_stage = lines.iter().filter_map(|line| line.strip_prefix(stage)).collect::<Vec<_>>();
        assert_eq!(of_stage.first(), Some(&" 0%"), "{lines:?}");
        let parts = of_stage.iter().map(|rest| rest.split_once('%').expect("a part").0.trim().parse::<u32>());
        let parts: Vec<u32> = parts.map(|part| part.expect("a number")).collect();
        assert!(parts.is_sorted() && parts.iter().all(|part| *part <= 100), "{lines:?}");
    }
    assert!(said.stdout.starts_with('{') && said.stderr.lines().all(|line| line.starts_with("progress: ")));
    // Not a terminal: silent.
    let silent = work.simod("sample model.ply -o again.simod --json");
    assert_eq!(silent.stderr, "");
    assert_eq!(work.run("sample model.ply -o x.simod --progress loud").code, Some(2));
}
