//! Whatever ends the program, and whenever: every target is whole, old or new, and nothing hidden stays, or
//! the next run takes it away. `SIMOD_CAMPAIGN=N` does N times as much as by default.
#![cfg(unix)]

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use glam::DVec3;
use simod_tests::{Outcome, Workplace, skip};

/// Number of rounds: `count`, times the number in SIMOD_CAMPAIGN.
fn times(count: usize) -> usize {
    let more = std::env::var("SIMOD_CAMPAIGN").ok().and_then(|n| n.parse::<usize>().ok());
    count * more.unwrap_or(1)
}

/// Each way to write something, with what it writes. `model.ply`, `model.simod`, `deformed.ply` and
/// `edit.toml` are there.
const WAYS: [(&str, &str); 8] = [
    ("generate -o out --vertices 200000", "out"),
    ("sample model.ply -o out --samples 2000", "out"),
    ("run edit.toml -o out", "out"),
    ("reconstruct model.simod --deformed deformed.ply -o out --part-size 256K", "out"),
    ("deform model.simod --session edit.toml -o out", "out"),
    ("refine model.simod --sphere 0,0,0,9 --factor 2 --into out", "out"),
    ("bind model.simod", "model.simod/binding.bin"),
    ("render model.ply --size 64x64 -o out", "out"),
];

fn workplace() -> Workplace {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 150000");
    work.simod("sample model.ply -o model.simod --samples 1000");
    work.move_samples("model.simod", |p| p + DVec3::new(0.1 * p.y, 0.0, 0.0));
    work.write_session("model.ply", 1000, "[[step]]\ndeform = \"warp\"");
    work
}

fn start(work: &Workplace, line: &str) -> Child {
    work.command(line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts")
}

fn end(child: Child) -> Outcome {
    child.wait_with_output().expect("an end").into()
}

fn send(child: &Child, signal: &str) {
    let sent = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
    assert!(sent.expect("kill runs").success());
}

/// The content of a file, or of all files of a folder; nothing where there is none.
fn content(work: &Workplace, name: &str) -> Vec<(String, Vec<u8>)> {
    let path = work.path(name);
    if !path.is_dir() {
        return std::fs::read(path).map(|bytes| (String::new(), bytes)).into_iter().collect();
    }
    let entries = std::fs::read_dir(path).expect("a folder").map(|e| e.expect("an entry").path());
    let mut all: Vec<_> = entries
        .map(|path| {
            (
                path.file_name().expect("a name").to_string_lossy().into_owned(),
                std::fs::read(path).expect("a file"),
            )
        })
        .collect();
    all.sort();
    all
}

fn remove(work: &Workplace, name: &str) {
    let path = work.path(name);
    let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
}

/// Names of hidden files, here and in the sampled model.
fn hidden(work: &Workplace) -> Vec<String> {
    let inside = content(work, "model.simod").into_iter().map(|(name, _)| name);
    work.names().into_iter().chain(inside).filter(|name| name.starts_with(".simod-")).collect()
}

#[test]
fn signals_end_the_program_and_leave_nothing() {
    let work = workplace();
    // A run that is over before its signal keeps what it found of the samples at rest: that is there already.
    work.simod("reconstruct model.simod --deformed deformed.ply -o out");
    remove(&work, "out");
    let mut ended = 0;
    for (way, (line, target)) in WAYS.into_iter().enumerate() {
        let before = work.snapshot();
        for (turn, signal) in ["TERM", "HUP", "XFSZ", "INT"].into_iter().enumerate() {
            let child = start(&work, line);
            // After it has begun to listen, and before it is done, as a rule.
            std::thread::sleep(Duration::from_millis(12 + 9 * ((way + turn) % 4) as u64));
            send(&child, signal);
            let outcome = end(child);
            match outcome.code {
                Some(0) => remove(&work, target),
                // The program had not begun.
                None => {}
                code => {
                    ended += 1;
                    assert_eq!(code, Some(130), "{line}: {signal}: {}", outcome.stderr);
                    assert_eq!(outcome.lines("error: "), ["cancelled"]);
                }
            }
            assert_eq!(work.snapshot(), before, "{line}: {signal}");
        }
    }
    if ended == 0 {
        skip("every run was over before it could be ended");
    }
}

/// As under `nohup`.
#[test]
fn a_hangup_that_is_ignored_is() {
    let work = Workplace::new();
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]);
    let program = work.command("generate -o out --vertices 1500000");
    shell.arg(program.get_program()).args(program.get_args()).current_dir(work.path(""));
    let child = shell.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a shell");
    std::thread::sleep(Duration::from_millis(60));
    send(&child, "HUP");
    let outcome = end(child);
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
}

/// The first Ctrl-C ends the program in any stage, also where nothing looks whether it shall stop, as in a
/// library that is being loaded.
#[test]
fn one_interrupt_is_enough_in_any_stage() {
    let work = workplace();
    let joints: String = (0..4000)
        .map(|i| {
            let parent = if i > 0 { format!("parent = \"j{}\"\n", i - 1) } else { String::new() };
            format!("[[step.joint]]\nid = \"j{i}\"\nat = [0, {}, 0]\n{parent}", 2.0 * f64::from(i) / 4000.0)
        })
        .collect();
    work.write_session("model.ply", 1000, &format!("[[step]]\ndeform = \"skinning\"\n{joints}"));
    let before = work.snapshot();
    for wait in [30, 100, 300, 900].map(Duration::from_millis) {
        let child = start(&work, "run edit.toml");
        std::thread::sleep(wait);
        let sent = Instant::now();
        send(&child, "INT");
        let outcome = end(child);
        if outcome.code == Some(0) {
            remove(&work, "edited.ply");
        } else if outcome.code.is_some() {
            assert_eq!(outcome.code, Some(130), "{}", outcome.stderr);
            // Its second, and what a busy machine adds.
            assert!(sent.elapsed() < Duration::from_secs(30), "it went on for {:?}", sent.elapsed());
        }
        assert_eq!(work.snapshot(), before, "after {wait:?}");
    }
}

/// Killed at any moment, a target is as before or as it shall be; and the next run leaves nothing of the
/// former.
#[test]
fn killed_at_any_moment() {
    let work = workplace();
    let (mut killed, mut left) = (0, 0);
    for (line, target) in WAYS {
        remove(&work, target);
        let started = Instant::now();
        work.simod(line);
        let whole_time = started.elapsed();
        let expected = content(&work, target);
        let turns = times(6);
        for turn in 0..turns {
            // There is a former one every other time.
            let is_there = turn % 2 == 1;
            if !is_there {
                remove(&work, target);
            } else if content(&work, target).is_empty() {
                work.simod(line);
            }
            let mut child = start(&work, line);
            std::thread::sleep(whole_time.mul_f64((turn as f64 + 0.5) / turns as f64));
            child.kill().expect("a child");
            killed += usize::from(!child.wait().expect("an end").success());
            left += usize::from(!hidden(&work).is_empty());
            let now = content(&work, target);
            assert!(
                now == expected || now.is_empty() && !is_there,
                "{line}: neither old nor new: {:?}",
                work.names()
            );
        }
        work.simod(line);
        assert!(content(&work, target) == expected, "{line}");
        assert!(hidden(&work).is_empty(), "{line} left {:?}", hidden(&work));
        remove(&work, target);
    }
    if killed == 0 {
        skip("every run was done before it could be killed");
    }
    println!("{killed} killed, {left} of them left something for the next run");
}

/// A limit on the size of files gives an error that names the target, and nothing is left of the output.
#[test]
fn a_full_disk_leaves_nothing() {
    let work = workplace();
    for (line, target) in WAYS {
        remove(&work, target);
        work.simod(line);
        let largest = content(&work, target).iter().map(|(_, bytes)| bytes.len() as u64).max().unwrap_or(0);
        for part in 1..=times(3) as u64 {
            let most = largest * part / (times(3) as u64 + 1) / 512 * 512;
            // With a former one in its place, which stays.
            work.refuses_beyond(most, line, &[]);
            assert!(hidden(&work).is_empty(), "{line} left {:?}", hidden(&work));
        }
        // The signal that comes with it does not kill: there is time to clean up.
        let before = work.snapshot();
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("ulimit -c 0; ulimit -f {}; exec \"$@\"", largest / 2 / 512), "sh"]);
        let program = work.command(line);
        shell.arg(program.get_program()).args(program.get_args()).current_dir(work.path(""));
        let outcome = Outcome::from(shell.output().expect("a shell"));
        assert!(matches!(outcome.code, Some(1 | 130)), "{line}: {:?} {}", outcome.code, outcome.stderr);
        assert_eq!(work.snapshot(), before, "{line}");
        remove(&work, target);
    }
}
