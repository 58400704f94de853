//! Nothing is overwritten that a command reads, nothing is read that has no end, and nothing is left behind.
#![cfg(unix)]

use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use glam::DVec3;
use simod_tests::{Outcome, Workplace, skip};

/// A model, its samples, deformed ones, and a session: `model.ply`, `model.simod`, `deformed.ply`,
/// `edit.toml`.
fn workplace() -> Workplace {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work.move_samples("model.simod", |p| p + DVec3::X);
    work.write_session("model.ply", 500, "[[step]]\ndeform = \"warp\"");
    work
}

/// Makes a pipe that nobody writes to.
fn pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo runs");
    assert!(made.success());
}

fn mode(work: &Workplace, name: &str) -> u32 {
    std::fs::metadata(work.path(name)).expect(name).mode() & 0o7777
}

#[test]
fn outputs_never_replace_inputs() {
    let work = workplace();
    std::fs::hard_link(work.path("model.ply"), work.path("hard.ply")).expect("a link");
    symlink("model.ply", work.path("soft.ply")).expect("a link");
    symlink("model.simod", work.path("other.simod")).expect("a link");
    let spelled = work.path("model.simod/../model.ply").display().to_string();
    let reconstruct = "reconstruct model.simod --deformed deformed.ply -o";
    let deform = "deform model.simod --session edit.toml -o";
    for force in ["", " --force"] {
        for name in ["model.ply", "./model.ply", "hard.ply", "soft.ply", &spelled] {
            for line in [deform, reconstruct, "run edit.toml -o", "render model.ply -o"] {
                work.refuses(&format!("{line} {name}{force}"), &[name]);
            }
            work.refuses(&format!("{reconstruct} out.ply --diagnostics {name}{force}"), &[name]);
            let refine = "refine model.simod --sphere 0,0,0,9 --factor 2 --deformed deformed.ply -o";
            work.refuses(&format!("{refine} {name}{force}"), &[name]);
        }
        for own in ["simod.toml", "samples.ply", "cells.bin"] {
            for folder in ["model.simod", "other.simod"] {
                let name = format!("{folder}/{own}");
                work.refuses(&format!("{reconstruct} {name}{force}"), &[&name]);
                work.refuses(&format!("{deform} {name}{force}"), &[&name]);
                work.refuses(&format!("render model.simod -o {name}{force}"), &[&name]);
                // Not even by a command that knows nothing of it.
                work.refuses(&format!("generate --vertices 2000 -o {name}{force}"), &[&name]);
            }
        }
        work.refuses(&format!("{deform} edit.toml{force}"), &["edit.toml"]);
        work.refuses(&format!("run edit.toml -o edit.toml{force}"), &["edit.toml"]);
        work.refuses(&format!("{reconstruct} deformed.ply{force}"), &["deformed.ply"]);
    }
    // A folder that is replaced does not take along what is read.
    work.refuses("sample model.simod/samples.ply -o model.simod", &["model.simod"]);
    // A binding that is a link would be written through it.
    symlink("../model.ply", work.path("model.simod/binding.bin")).expect("a link");
    work.refuses("bind model.simod", &["binding.bin", "model.ply"]);
}

#[test]
fn what_sessions_name_is_not_replaced() {
    let work = workplace();
    let cage = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    work.write("sub/cage.obj", cage);
    let steps = "[[step]]\ndeform = \"cage\"\nparams = { file = \"sub/cage.obj\" }";
    work.write_session("model.ply", 500, steps);
    for line in ["run edit.toml -o", "deform model.simod --session edit.toml -o"] {
        work.refuses(&format!("{line} sub/cage.obj --force"), &["cage.obj"]);
    }
    let methods = "model = { path = \"model.ply\" }\n[[method]]\nname = \"a\"\ndeform = \"warp\"\n";
    work.write("folder/methods.toml", methods.replace("model.ply", "../model.ply"));
    work.refuses("compare folder/methods.toml -o folder", &["folder"]);
}

#[test]
fn files_of_another_kind_need_force() {
    let work = workplace();
    let letter = "dear Ada";
    for line in [
        "generate --vertices 2000 -o",
        "render model.ply --size 32x32 -o",
        "reconstruct model.simod --deformed deformed.ply -o",
        "deform model.simod --session edit.toml -o",
        "run edit.toml -o",
    ] {
        work.write("letter", letter);
        let refused = work.refuses(&format!("{line} letter"), &["letter", "is there, and is no "]);
        assert!(refused.hint().contains("--force"), "{}", refused.hint());
        work.simod(&format!("{line} letter --force"));
        assert_ne!(work.read("letter"), letter.as_bytes());
        // One of the same kind, or an empty one, is replaced without.
        work.simod(&format!("{line} letter"));
        work.write("letter", "");
        work.simod(&format!("{line} letter"));
    }
    work.write("picture", work.read("letter"));
    work.refuses("render model.ply --size 32x32 -o picture", &["picture"]);
    work.write("simod-demo/session.toml", letter);
    work.refuses("demo --vertices 2000 --samples 100", &["session.toml"]);
    assert_eq!(work.read("simod-demo/session.toml"), letter.as_bytes());
}

#[test]
fn permissions_of_what_is_replaced_are_kept() {
    let work = workplace();
    for line in
        ["generate --vertices 2000 -o out", "run edit.toml -o out", "render model.ply --size 32x32 -o out"]
    {
        let _ = std::fs::remove_file(work.path("out"));
        work.simod(line);
        let usual = mode(&work, "out");
        for bits in [0o600, 0o640, 0o666, usual] {
            std::fs::set_permissions(work.path("out"), Permissions::from_mode(bits)).expect("permissions");
            work.simod(line);
            assert_eq!(mode(&work, "out"), bits, "simod {line}");
        }
    }
    let private = |name: &str, bits| {
        std::fs::set_permissions(work.path(name), Permissions::from_mode(bits)).expect("permissions");
    };
    private("model.simod", 0o700);
    private("model.simod/samples.ply", 0o600);
    for line in
        ["sample model.ply -o model.simod --samples 400", "refine model.simod --sphere 0,0,0,9 --factor 2"]
    {
        work.simod(line);
        assert_eq!(
            (mode(&work, "model.simod"), mode(&work, "model.simod/samples.ply")),
            (0o700, 0o600),
            "{line}"
        );
    }
    // The superuser alone may give files away.
    if std::os::unix::fs::chown(work.path("out"), Some(1), Some(1)).is_err() {
        return skip("files cannot be given to another user");
    }
    work.simod("render model.ply --size 32x32 -o out");
    let is = std::fs::metadata(work.path("out")).expect("an output");
    assert_eq!((is.uid(), is.gid()), (1, 1));
}

#[test]
fn sessions_write_beside_themselves() {
    let work = workplace();
    work.write("elsewhere/file", "");
    let outside = work.path("elsewhere/out.ply").display().to_string();
    let session = |output: &str| {
        work.write("sub/edit.toml", format!(
            "[model]\npath = \"../model.ply\"\n[sampling]\nsamples = 500\n[[step]]\ndeform = \"warp\"\n[output]\npath = \"{output}\"\n"
        ));
    };
    work.write("sub/file", "");
    symlink("../elsewhere", work.path("sub/link")).expect("a link");
    for output in ["../out.ply", &outside, "link/out.ply", "./../elsewhere/out.ply"] {
        session(output);
        let refused = work.refuses("run sub/edit.toml", &["sub/edit.toml", "out.ply"]);
        assert!(refused.hint().contains("-o"), "{}", refused.hint());
        work.simod("run sub/edit.toml -o elsewhere/out.ply");
        std::fs::remove_file(work.path("elsewhere/out.ply")).expect("an output");
    }
    session("./out.ply");
    work.simod("run sub/edit.toml");
    assert!(work.path("sub/out.ply").is_file());
}

/// Reading any of these would never end.
#[test]
fn pipes_and_devices_are_refused_at_once() {
    let work = workplace();
    pipe(&work.path("pipe"));
    let session = |steps: &str| work.write_session("model.ply", 500, steps);
    let refuses = |line: &str, named: &[&str]| {
        let started = Instant::now();
        work.refuses(line, named);
        assert!(started.elapsed() < Duration::from_secs(20), "simod {line} waited");
    };
    for odd in ["./pipe", "/dev/zero"] {
        for line in [
            "info X",
            "sample X -o new.simod",
            "render X -o x.png",
            "run X",
            "compare X -o new",
            "deform model.simod --session X -o out.ply",
            "reconstruct model.simod --deformed X -o out.ply",
            "plugin check X",
            "plugin list --use X",
        ] {
            refuses(&line.replace('X', odd), &[odd.trim_start_matches("./"), "is a pipe or a device"]);
        }
        let at = if odd == "./pipe" { work.path("pipe").display().to_string() } else { odd.to_owned() };
        for steps in [
            "[[step]]\ndeform = \"displacement-paint\"\nstrokes = { file = \"X\", fingerprint = \"xxh3-128:0\" }",
            "[[step]]\ndeform = \"warp\"\n[[step.region]]\nrole = \"mask\"\n\
             shapes = [{ selection = { file = { file = \"X\", fingerprint = \"xxh3-128:0\" } } }]",
        ] {
            session(&steps.replace('X', &at));
            refuses("run edit.toml", &["is a pipe or a device"]);
        }
        for (plugin, param, ending) in
            [("cage", "file", "obj"), ("skinning", "skeleton", "tgf"), ("skinning", "weights", "csv")]
        {
            let name = format!("odd.{ending}");
            let _ = std::fs::remove_file(work.path(&name));
            symlink(&at, work.path(&name)).expect("a link");
            session(&format!("[[step]]\ndeform = \"{plugin}\"\nparams = {{ {param} = \"{name}\" }}"));
            refuses("run edit.toml", &[&name, "is a pipe or a device"]);
        }
        session("");
        for own in ["simod.toml", "samples.ply", "cells.bin", "binding.bin"] {
            let (own, kept) = (work.path(&format!("model.simod/{own}")), work.path("kept"));
            let was_there = std::fs::rename(&own, &kept).is_ok();
            symlink(&at, &own).expect("a link");
            let started = Instant::now();
            let outcome = work.run("reconstruct model.simod --deformed deformed.ply -o out.ply");
            let _ = work.run("refine model.simod --sphere 0,0,0,9 --factor 2 --into new.simod");
            assert!(started.elapsed() < Duration::from_secs(40), "{} was waited for", own.display());
            if own.ends_with("binding.bin") {
                // The binding is not needed: the run goes on without.
                assert!(outcome.stderr.contains("is a pipe or a device"), "{}", outcome.stderr);
            }
            if own.ends_with("simod.toml") || own.ends_with("samples.ply") {
                outcome.refused("reconstruct", &["is a pipe or a device"]);
            }
            std::fs::remove_file(&own).expect("a link");
            if was_there {
                std::fs::rename(&kept, &own).expect("a file");
            }
            let _ = std::fs::remove_dir_all(work.path("new.simod"));
            let _ = std::fs::remove_file(work.path("out.ply"));
        }
    }
}

/// A file that is mostly holes is as long as it says to whoever reads it.
#[test]
fn files_that_are_too_long_are_refused() {
    let work = workplace();
    let hole = |name: &str| {
        let file = std::fs::File::create(work.path(name)).expect("a file");
        file.set_len(1 << 40).expect("a file of holes");
    };
    hole("long.toml");
    work.refuses("run long.toml", &["long.toml", "too long"]);
    hole("cage.obj");
    work.write_session("model.ply", 500, "[[step]]\ndeform = \"cage\"\nparams = { file = \"cage.obj\" }");
    work.refuses("run edit.toml", &["cage.obj"]);
    hole("a.strokes");
    let strokes = "strokes = { file = \"a.strokes\", fingerprint = \"xxh3-128:0\" }";
    work.write_session("model.ply", 500, &format!("[[step]]\ndeform = \"displacement-paint\"\n{strokes}"));
    work.refuses("run edit.toml", &["a.strokes", "longer than"]);
    hole("model.simod/simod.toml");
    work.refuses("info model.simod", &["simod.toml", "longer than"]);
}

fn start(work: &Workplace, line: &str) -> Child {
    work.command(line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts")
}

fn end(child: Child) -> Outcome {
    child.wait_with_output().expect("an end").into()
}

/// Of two refinements at once one would be lost: the second says so and changes nothing.
#[test]
fn one_command_at_a_time_changes_a_folder() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 400000");
    work.simod("sample model.ply -o model.simod --samples 2000");
    let refine = "refine model.simod --sphere 0,0,0,9 --factor 8";
    let before = work.report("info model.simod")["samples"].as_u64().expect("a number");
    let mut together = 0;
    for second in [refine, "sample model.ply -o model.simod --samples 100", "bind model.simod"] {
        let mut first = start(&work, refine);
        let started = Instant::now();
        while !work.path(".simod-model.simod.part").exists() {
            if first.try_wait().expect("a child").is_some() || started.elapsed() > Duration::from_secs(60) {
                break;
            }
            std::thread::sleep(Duration::from_micros(200));
        }
        let other = work.run(second);
        let first = end(first);
        if other.code == Some(0) {
            assert_eq!(first.code, Some(0), "{}", first.stderr);
            continue;
        }
        together += 1;
        other.refused(second, &["model.simod is being written by another process"]);
        assert_eq!(first.code, Some(0), "{}", first.stderr);
        // The refinements that the commands reported are there.
        let refinements = work.report("info model.simod")["refinements"].as_array().map(Vec::len);
        assert_eq!(refinements, Some(together));
    }
    assert!(work.report("info model.simod")["samples"].as_u64() > Some(before));
    assert_eq!(work.names(), ["model.ply", "model.simod"]);
    if together == 0 {
        skip("the first was always done before the second began");
    }
}

/// Links that somebody put in the places of the program's temporary files are not written through.
#[test]
fn planted_links_are_not_followed() {
    let work = workplace();
    let line = "reconstruct model.simod --deformed deformed.ply -o out.ply --part-size 4K";
    work.simod(line);
    let expected = work.read("out.ply");
    for hidden in ["part", "journal", "journal.new", "new", "old"] {
        for is_hard in [false, true] {
            for (line, name) in [
                (line, "out.ply"),
                ("run edit.toml -o out.ply", "out.ply"),
                ("sample model.ply -o other.simod --samples 100", "other.simod"),
                ("bind model.simod", "model.simod"),
            ] {
                work.write("victim", "precious");
                work.write("victims/letter", "dear");
                let planted = work.path(&format!(".simod-{name}.{hidden}"));
                let victim = if hidden == "new" { "victims" } else { "victim" };
                if is_hard {
                    std::fs::hard_link(work.path("victim"), &planted).expect("a link");
                } else {
                    symlink(work.path(victim), &planted).expect("a link");
                }
                work.simod(line);
                assert_eq!(work.read("victim"), b"precious", "{line} wrote through {hidden}");
                assert_eq!(work.read("victims/letter"), b"dear", "{line} wrote through {hidden}");
                assert!(planted.symlink_metadata().is_err(), "{line} left {hidden}");
                if line.starts_with("reconstruct") {
                    assert!(work.read("out.ply") == expected);
                }
            }
        }
    }
    work.write("victim", "precious");
    // The links in the folder itself.
    for own in ["binding.bin", "samples.ply"] {
        symlink(work.path("victim"), work.path(&format!("model.simod/.simod-{own}.part"))).expect("a link");
    }
    work.simod("bind model.simod");
    assert_eq!(work.read("victim"), b"precious");
}

/// The program says that a binding is damaged and goes on without, wherever the damage is: the result is the
/// same.
#[test]
fn a_damaged_binding_is_not_used() {
    let work = workplace();
    let line = "reconstruct model.simod --deformed deformed.ply -o out.ply";
    work.simod(line);
    let expected = work.read("out.ply");
    work.simod("bind model.simod");
    let good = work.read("model.simod/binding.bin");
    let places = (0..24).map(|i| i * good.len() / 24).chain([8, 12, good.len() - 1]);
    let flipped = places.map(|at| {
        let mut bytes = good.clone();
        bytes[at] ^= 0x41;
        bytes
    });
    let cut = [0, 7, 20, good.len() / 3, good.len() - 1].map(|end| good[..end].to_vec());
    for (turn, bytes) in flipped.chain(cut).enumerate() {
        work.write("model.simod/binding.bin", bytes);
        let outcome = work.simod(line);
        let notes = outcome.lines("note: ");
        assert!(
            notes.len() == 1 && notes[0].contains("binding.bin is not used"),
            "{turn}: {}",
            outcome.stderr
        );
        assert!(work.read("out.ply") == expected, "damage {turn} changes the result");
    }
}

/// The file that is at fault is named, and the sample where there is one.
#[test]
fn errors_name_the_file() {
    let work = workplace();
    let mut samples = work.ply("model.simod/samples.ply");
    samples.set_position(17, DVec3::new(0.0, 1e30, 0.0));
    work.write("deformed.ply", &samples.bytes);
    let line = "reconstruct model.simod --deformed deformed.ply -o out.ply";
    for method in ["blended-jets", "projected-barycentric"] {
        let outcome = work.refuses(&format!("{line} --method {method}"), &["deformed.ply", "sample 17"]);
        assert!(!outcome.stderr.contains("NaN"), "{}", outcome.stderr);
    }
    // Samples that are not those of the folder's description, but have its fingerprint.
    let text = String::from_utf8(work.read("model.simod/simod.toml")).expect("text");
    let (start, end) = text.split_once("samples-fingerprint = \"").expect("a fingerprint");
    let set = |hash: &str| {
        let rest = end.split_once('"').expect("an end").1;
        work.write("model.simod/simod.toml", format!("{start}samples-fingerprint = \"{hash}\"{rest}"));
    };
    work.move_samples("model.simod", |p| p + DVec3::X);
    let stdout =
        work.refuses(&line.replace("out.ply", "/dev/stdout"), &["/dev/stdout", "a pipe or a device"]);
    assert!(stdout.hint().contains("whole"), "{}", stdout.hint());
    set("xxh3-128:0");
    work.refuses("info model.simod", &["samples.ply"]);
}

#[test]
fn names_need_not_be_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let work = workplace();
    let name = |bytes: &'static [u8]| OsStr::from_bytes(bytes);
    let model = name(b"odd-\xff.ply");
    if std::fs::copy(work.path("model.ply"), work.path("").join(model)).is_err() {
        return skip("names are text on this file system");
    }
    let run = |line: &str, names: &[&OsStr]| {
        let mut command = work.command(line.split(" X").next().expect("a line"));
        for (option, name) in line.split(" X").skip(1).chain(["", ""]).zip(names) {
            command.arg(name).args(option.split_whitespace());
        }
        let output = command.output().expect("the program starts");
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    };
    let folder = name(b"odd-\xfe.simod");
    run("sample X --samples 300 -o X", &[model, folder]);
    run("info X", &[folder]);
    run("bind X", &[folder]);
    let samples = work.path("").join(folder).join("samples.ply");
    run("reconstruct X --deformed X -o X", &[folder, samples.as_os_str(), name(b"out-\xff.ply")]);
    assert!(
        std::fs::read(work.path("").join(name(b"out-\xff.ply"))).expect("an output")
            == work.read("model.ply")
    );
    run("refine X --sphere 0,0,0,9 --factor 2", &[folder]);
    run("render X --size 32x32 -o X", &[model, name(b"\xff.png")]);
    run("run edit.toml --model X -o X", &[model, name(b"run-\xff.ply")]);
    run("deform model.simod --session edit.toml --model X -o X", &[model, name(b"deformed-\xff.ply")]);
    run("plugin migrate edit.toml -o X", &[name(b"new-\xff.toml")]);
}

/// A session is a text, and plugins get texts: where a folder's name is none, that is said before anything is
/// written.
#[test]
fn folders_whose_names_are_no_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let work = workplace();
    let folder = work.path("").join(OsStr::from_bytes(b"odd-\xff"));
    if std::fs::create_dir(&folder).is_err() {
        return skip("names are text on this file system");
    }
    let beside = |name: &str| folder.join(name);
    std::fs::copy(work.path("model.ply"), beside("model.ply")).expect("a copy");
    std::fs::copy(work.path("edit.toml"), beside("edit.toml")).expect("a copy");
    let of = |line: &str, session: &Path, to: &Path| {
        let mut command = work.command(line);
        command.arg(session).arg("-o").arg(to);
        Outcome::from(command.output().expect("the program starts"))
    };
    // Files beside the session are found there, and can be written there.
    let outcome = of("run", &beside("edit.toml"), &beside("out.ply"));
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
    let outcome = of("plugin migrate", &beside("edit.toml"), &beside("new.toml"));
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
    let outcome = of("run", &beside("new.toml"), &beside("again.ply"));
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
    let read = |name: &str| std::fs::read(beside(name)).expect("an output");
    assert!(read("out.ply") == read("again.ply"));

    let cage = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    work.write("cage.obj", cage);
    work.write("caged.toml", "[[step]]\ndeform = \"cage\"\nparams = { file = \"cage.obj\" }");
    for name in ["cage.obj", "caged.toml"] {
        std::fs::rename(work.path(name), beside(name)).expect("a file");
    }
    let outcome = of("deform model.simod --session", &beside("caged.toml"), &work.path("caged.ply"));
    outcome.refused("deform", &["caged.toml, line 3", "`file`", "cage.obj is not UTF-8"]);
    // Seen from elsewhere, the same: a session that would not find the cage is not written.
    let outcome = of("plugin migrate", &beside("caged.toml"), &work.path("elsewhere.toml"));
    outcome.refused("plugin migrate", &["cage.obj is no text"]);
    let outcome = of("plugin migrate", &beside("edit.toml"), &work.path("elsewhere.toml"));
    outcome.refused("plugin migrate", &["model.ply is no text"]);
    assert!(!work.path("elsewhere.toml").exists() && !work.path("caged.ply").exists());
}

/// Everything that is written has another name until it is whole, which a pipe cannot take back; a file can.
#[test]
fn standard_output_is_written_where_it_is_a_file() {
    let work = workplace();
    let methods = "model = { path = \"model.ply\" }\n[[method]]\nname = \"a\"\ndeform = \"warp\"\n";
    work.write("methods.toml", methods);
    for line in [
        "deform model.simod --session edit.toml -o",
        "reconstruct model.simod --deformed deformed.ply -o",
        "run edit.toml -o",
        "render model.ply --size 32x32 -o",
        "generate --vertices 2000 -o",
        "plugin migrate edit.toml -o",
    ] {
        for name in ["/dev/stdout", "/dev/fd/1", "/dev/null"] {
            let refused = work.refuses(&format!("{line} {name}"), &[name, "it is a pipe or a device"]);
            assert!(refused.hint().contains("give the path of a file"), "{}", refused.hint());
            assert_eq!(refused.stdout, "");
        }
        let file = std::fs::File::create(work.path("out")).expect("a file");
        let mut command = work.command(&format!("{line} /dev/stdout"));
        let status = command.stdout(file).status().expect("the program starts");
        assert!(status.success(), "{line}");
        work.simod(&format!("{line} expected"));
        assert!(work.read("out") == work.read("expected"), "{line}");
        std::fs::remove_file(work.path("expected")).expect("a file");
        std::fs::remove_file(work.path("out")).expect("a file");
    }
    for (line, name) in [
        ("reconstruct model.simod --deformed deformed.ply -o out --diagnostics", "it is a pipe or a device"),
        ("run edit.toml -o out --diagnostics", "it is a pipe or a device"),
        (
            "refine model.simod --sphere 0,0,0,9 --factor 2 --deformed deformed.ply -o",
            "it is a pipe or a device",
        ),
        ("refine model.simod --sphere 0,0,0,9 --factor 2 --into", "is no sampled model"),
        ("sample model.ply --samples 100 -o", "is no sampled model"),
        ("compare methods.toml -o", "is no comparison"),
    ] {
        let refused = work.refuses(&format!("{line} /dev/stdout"), &["/dev/stdout", name]);
        assert_eq!(refused.stdout, "");
    }
}

#[test]
fn limits_are_told() {
    let work = workplace();
    for threads in ["0", "1000000"] {
        assert_eq!(work.run(&format!("info model.ply --threads {threads}")).code, Some(2));
    }
    for named in ["model.ply", "model.simod"] {
        let outcome = work.simod(&format!("info {named}"));
        assert!(
            outcome.stdout.contains("bounding box [") && !outcome.stdout.contains("0.00 s"),
            "{}",
            outcome.stdout
        );
    }
    let bounds = work.report("info model.ply")["bounds"].clone();
    let near = |a: &serde_json::Value, b: &serde_json::Value| {
        (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-6
    };
    let sampled = work.report("info model.simod")["bounds"].clone();
    assert!((0..2).all(|i| (0..3).all(|j| near(&bounds[i][j], &sampled[i][j]))), "{bounds} is not {sampled}");
    // A chain of joints, in the order of the file and against it.
    for backwards in [false, true] {
        let joint = |i: usize| {
            let parent = if i > 0 { format!("parent = \"j{}\"\n", i - 1) } else { String::new() };
            format!("[[step.joint]]\nid = \"j{i}\"\nat = [0, {}, 0]\n{parent}", i as f64 * 1e-4)
        };
        let joints: String =
            if backwards { (0..20_000).rev().map(joint).collect() } else { (0..20_000).map(joint).collect() };
        work.write_session("model.ply", 500, &format!("[[step]]\ndeform = \"skinning\"\n{joints}"));
        let started = Instant::now();
        work.refuses("run edit.toml", &["20000 joints"]);
        // A former version took minutes; a busy machine takes some seconds.
        assert!(started.elapsed() < Duration::from_secs(30), "{:?}", started.elapsed());
    }
}
