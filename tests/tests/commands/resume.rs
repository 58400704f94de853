//! A reconstruction that is killed leaves the target as it was, and can be gone on with.
#![cfg(unix)]

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use glam::DVec3;
use simod_tests::{MANY, Outcome, Workplace, skip};

const RECONSTRUCT: &str = "reconstruct model.simod --deformed deformed.ply -o out.ply --part-size 1M";
const JOURNAL: &str = ".simod-out.ply.journal";
const PART: &str = ".simod-out.ply.part";

/// A model of a dozen parts, its samples, and deformed ones.
fn sampled() -> Workplace {
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {}", MANY / 4));
    work.simod(&format!("sample model.ply -o model.simod --samples {}", MANY / 400));
    work.move_samples("model.simod", |p| p + DVec3::new(0.2 * p.y * p.y, 0.0, 0.1 * p.x));
    work
}

fn start(work: &Workplace, line: &str) -> Child {
    let mut command = work.command(line);
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts")
}

/// Parts that the journal lists.
fn parts(work: &Workplace, journal: &str) -> usize {
    let journal = std::fs::read_to_string(work.path(journal)).unwrap_or_default();
    journal.lines().filter(|line| line.starts_with("part ")).count()
}

/// Waits until so many parts are listed; `false` if the program ended before.
fn wait_for_parts(work: &Workplace, child: &mut Child, journal: &str, count: usize) -> bool {
    let start = Instant::now();
    loop {
        if count == 0 && work.path(journal).exists() || count > 0 && parts(work, journal) >= count {
            return true;
        }
        if child.try_wait().expect("a child").is_some() {
            return false;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "nothing is done");
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Starts a reconstruction and kills it after so many parts; `false` if it was done before.
fn kill_after(work: &Workplace, line: &str, journal: &str, count: usize) -> bool {
    let mut child = start(work, line);
    let in_time = wait_for_parts(work, &mut child, journal, count);
    child.kill().expect("a child");
    !child.wait().expect("an end").success() && in_time
}

/// The names of what there is beside the model and its samples.
fn names(work: &Workplace) -> Vec<String> {
    let given = ["model.ply", "model.simod", "deformed.ply"];
    work.names().into_iter().filter(|name| !given.contains(&name.as_str())).collect()
}

#[test]
fn killed_and_gone_on_with() {
    let work = sampled();
    work.simod(RECONSTRUCT);
    assert_eq!(names(&work), ["out.ply"]);
    let expected = work.read("out.ply");
    let mut killed = 0;
    for count in [0, 1, 4, 8] {
        work.write("out.ply", "ply\nprecious");
        if !kill_after(&work, RECONSTRUCT, JOURNAL, count) {
            continue;
        }
        killed += 1;
        assert_eq!(work.read("out.ply"), b"ply\nprecious");
        let left = names(&work);
        assert!(left.contains(&JOURNAL.to_owned()) && left.contains(&PART.to_owned()), "{left:?}");
        let done = parts(&work, JOURNAL);
        let outcome = work.simod(&format!("{RECONSTRUCT} --resume --json"));
        assert_eq!(outcome.stderr, "");
        let there = outcome.json()["resumed_bytes"].as_u64().expect("a number");
        assert!(done >= count && there >= done as u64 * 1_000_000, "{there} bytes, {done} parts");
        assert!(work.read("out.ply") == expected, "killed after {count} parts");
        assert_eq!(names(&work), ["out.ply"]);

        // Without being asked to, nothing is gone on with.
        if kill_after(&work, RECONSTRUCT, JOURNAL, count) {
            work.simod(RECONSTRUCT);
            assert!(work.read("out.ply") == expected, "killed after {count} parts");
            assert_eq!(names(&work), ["out.ply"]);
        }
    }
    if killed == 0 {
        skip("every run was done before it could be killed");
    }
    // Nothing to go on with.
    let outcome = work.simod(&format!("{RECONSTRUCT} --resume --json"));
    assert_eq!((outcome.json()["resumed_bytes"].as_u64(), &*outcome.stderr), (Some(0), ""));
    assert!(work.read("out.ply") == expected);
    // Something else to do.
    if kill_after(&work, RECONSTRUCT, JOURNAL, 2) {
        let outcome = work.simod(&format!("{RECONSTRUCT} --resume --json --normals keep"));
        assert_eq!(outcome.json()["resumed_bytes"], 0);
        let [note] = outcome.lines("note: ")[..] else { panic!("{}", outcome.stderr) };
        assert!(note.contains("out.ply") && note.contains("changed"), "{note}");
        assert_eq!(names(&work), ["out.ply"]);
    }
}

#[test]
fn several_versions_killed_and_gone_on_with() {
    let work = sampled();
    let deformed = work.read("deformed.ply");
    for version in 1..=5 {
        work.write(&format!("in/{version}.ply"), &deformed);
    }
    let line = "reconstruct model.simod --deformed in/*.ply -o out/{}.ply --part-size 1M";
    work.write("out/1.ply", "ply\nprecious");
    work.simod(line);
    let expected = work.read("out/1.ply");
    let check = |when: &str| {
        let found = std::fs::read_dir(work.path("out")).expect("a folder").count();
        assert_eq!(found, 5, "{when}");
        for version in 1..=5 {
            assert!(work.read(&format!("out/{version}.ply")) == expected, "version {version}, {when}");
        }
    };
    check("uninterrupted");
    // In the first reading of four versions, and in the second.
    for (version, count) in [(1, 2), (4, 6), (5, 1), (5, 6)] {
        std::fs::remove_dir_all(work.path("out")).expect("a folder");
        std::fs::create_dir(work.path("out")).expect("a folder");
        if kill_after(&work, line, &format!("out/.simod-{version}.ply.journal"), count) {
            // Of the first reading counts what all four versions have, of which one may have been behind.
            let parts = |version| parts(&work, &format!("out/.simod-{version}.ply.journal"));
            let least = match version {
                5 => 4 * expected.len() as u64,
                _ => (1..=4).map(parts).min().unwrap_or(0) as u64 * 1_000_000,
            };
            let there = work.report(&format!("{line} --resume"))["resumed_bytes"].as_u64();
            assert!(there.is_some_and(|bytes| bytes >= least), "{there:?} bytes of {}", expected.len());
            check(&format!("killed after {count} parts of version {version}"));
        }
    }
}

#[test]
fn two_at_once_to_one_output() {
    let work = sampled();
    let mut first = start(&work, RECONSTRUCT);
    if !wait_for_parts(&work, &mut first, JOURNAL, 1) {
        return skip("the first was done before the second began");
    }
    for line in [RECONSTRUCT.to_owned(), format!("{RECONSTRUCT} --resume")] {
        let second = work.run(&line);
        if first.try_wait().expect("a child").is_some() {
            return skip("the first was done before the second");
        }
        second.refused(&line, &["out.ply is being written by another process"]);
    }
    let first = Outcome::from(first.wait_with_output().expect("an end"));
    assert_eq!(first.code, Some(0), "{}", first.stderr);
    let written = work.read("out.ply");
    assert_eq!(names(&work), ["out.ply"]);
    work.simod(RECONSTRUCT);
    assert!(work.read("out.ply") == written);
}

#[test]
fn cancelled_to_be_gone_on_with() {
    let work = sampled();
    work.simod(RECONSTRUCT);
    let expected = work.read("out.ply");
    std::fs::remove_file(work.path("out.ply")).expect("an output");
    for resume in ["", " --resume"] {
        let line = format!("{RECONSTRUCT}{resume}");
        let mut child = start(&work, &line);
        if !wait_for_parts(&work, &mut child, JOURNAL, 2) {
            return skip("it was done before it could be cancelled");
        }
        let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
        assert!(sent.success());
        let outcome = Outcome::from(child.wait_with_output().expect("an end"));
        if outcome.code == Some(0) {
            return skip("it was done before it was cancelled");
        }
        assert_eq!((outcome.code, outcome.lines("error: ")), (Some(130), vec!["cancelled"]));
        assert_eq!(outcome.hint().contains("--resume"), !resume.is_empty(), "{}", outcome.hint());
        let left: &[&str] = if resume.is_empty() { &[] } else { &[JOURNAL, PART] };
        assert_eq!(names(&work), left);
    }
    assert!(work.report(&format!("{RECONSTRUCT} --resume"))["resumed_bytes"].as_u64() > Some(0));
    assert!(work.read("out.ply") == expected);
    assert_eq!(names(&work), ["out.ply"]);
}

#[test]
fn a_full_disk_to_be_gone_on_with() {
    let work = sampled();
    work.simod(RECONSTRUCT);
    let expected = work.read("out.ply");
    std::fs::remove_file(work.path("out.ply")).expect("an output");
    let size = expected.len() as u64;
    let line = format!("{RECONSTRUCT} --resume");
    for limit in [size / 3, size * 2 / 3] {
        let outcome = work.run_beyond(limit, &line);
        outcome.refused(&line, &["out.ply"]);
        assert!(outcome.hint().contains("--resume"), "{}", outcome.hint());
        assert_eq!(names(&work), [JOURNAL, PART]);
    }
    assert!(work.report(&line)["resumed_bytes"].as_u64() > Some(size / 2));
    assert!(work.read("out.ply") == expected);
    // Without it nothing is left.
    work.refuses_beyond(size / 2, RECONSTRUCT, &["out.ply"]);
}

/// A file system of its own, of so many bytes.
struct Disk(std::path::PathBuf);

impl Disk {
    fn mount(path: std::path::PathBuf, bytes: u64) -> Option<Self> {
        std::fs::create_dir(&path).expect("a folder");
        let options = format!("size={bytes}");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(&path).stderr(Stdio::null());
        mount.status().is_ok_and(|status| status.success()).then_some(Self(path))
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

/// A part of the output that is there already needs no room, whether it is gone on with or replaced.
#[test]
fn a_disk_with_room_for_one() {
    let work = sampled();
    let size = work.read("model.ply").len() as u64;
    let Some(_disk) = Disk::mount(work.path("disk"), size + size / 4) else {
        return skip("no file system can be mounted here");
    };
    let line = RECONSTRUCT.replace("out.ply", "disk/out.ply");
    for resume in [" --resume", ""] {
        if !kill_after(&work, &line, "disk/.simod-out.ply.journal", parts_of_half(size)) {
            return skip("it was done before it could be killed");
        }
        work.simod(&format!("{line}{resume}"));
        // No second one beside the first.
        let outcome = work.run(&line.replace("out.ply", "other.ply"));
        outcome.refused(&line, &["disk/other.ply", "needs"]);
        std::fs::remove_file(work.path("disk/out.ply")).expect("an output");
        assert_eq!(std::fs::read_dir(work.path("disk")).expect("a folder").count(), 0);
    }
}

/// At least two pieces of the model end a part in 10 MB.
fn parts_of_half(size: u64) -> usize {
    (size / 2 / 5_000_000) as usize
}
