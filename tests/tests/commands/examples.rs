//! The lessons under `examples/`: the commands of their pages do what the pages say, on smaller models.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use simod_tests::{Ply, Workplace, built, outside_target, skip, workspace};

#[test]
fn a_first_edit() {
    let lesson = Lesson::follow("01-first-edit");
    // The lesson itself compares the three commands with the one.
    lesson.assert_deformed("amphora.ply", "amphora-edited.ply");
}

#[test]
fn any_program_is_a_deformer() {
    if Command::new("python3").arg("--version").output().is_err() {
        return skip("python3 is not installed");
    }
    let lesson = Lesson::follow("02-any-program-is-a-deformer");
    lesson.assert_deformed("amphora.ply", "amphora-wave.ply");
}

#[test]
fn your_own_plugin() {
    let lesson = Lesson::follow("03-your-own-plugin");
    lesson.assert_deformed("pond.ply", "pond-rippled.ply");
    assert!(lesson.said.contains("transfer error"), "{}", lesson.said);
}

#[test]
fn a_plugin_in_c() {
    if std::env::consts::DLL_SUFFIX != ".so" {
        return skip("the lesson's library has the name that Linux wants");
    }
    let lesson = Lesson::follow("04-a-plugin-in-c");
    lesson.assert_deformed("amphora.ply", "amphora-grabbed.ply");
    assert!(lesson.said.contains(" 0 failed, 0 warned"), "{}", lesson.said);
    assert!(lesson.said.contains("transfer error"), "{}", lesson.said);
}

#[test]
fn comparing_methods() {
    let lesson = Lesson::follow("05-compare-methods");
    lesson.assert_deformed("cactus.ply", "comparison/exact-bend.ply");
    let page = fs::read_to_string(lesson.folder.join("comparison/index.html")).unwrap();
    assert!(page.contains("5 methods on cactus.ply") && !page.contains("Failed"), "{}", lesson.said);
}

#[test]
fn a_splat_scene() {
    if Command::new("python3").arg("--version").output().is_err() {
        return skip("python3 is not installed");
    }
    let lesson = Lesson::follow("09-a-splat-scene");
    lesson.assert_deformed("scene.ply", "posed.ply");
    assert!(lesson.said.contains("Gaussian splats with harmonics of degree 1"), "{}", lesson.said);
}

/// The programs of the lesson on the library, one after the other.
#[test]
fn the_library() {
    let work = Workplace::new();
    work.simod("generate -o amphora.ply --vertices 60000");
    let run = |name: &str, arguments: &[&str]| {
        let program = built().join("examples").join(format!("library-{name}"));
        let mut program = Command::new(program);
        program.args(arguments).current_dir(work.path("")).env("SIMOD_PLUGIN_PATH", built());
        let output = program.output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{name}: {said}{}", String::from_utf8_lossy(&output.stderr));
        said
    };
    run("sample", &["amphora.ply", "amphora.simod"]);
    assert!(run("deform", &["amphora.simod", "deformed.ply"]).contains("deformed by 1 plugin"));
    run("reconstruct", &["amphora.simod", "deformed.ply", "edited.ply"]);
    let finer = run("refine", &["amphora.simod", "finer.simod", "0", "1", "0.5", "0.2"]);
    assert!(!finer.starts_with("0 samples"), "{finer}");
    let said = run("edit", &["amphora.ply", "edited-too.ply", "edit.toml"]);
    assert!(said.contains("undone: change angle of warp"), "{said}");
    // The edit is the one that the saved session says.
    work.simod("run edit.toml -o again.ply");
    assert!(work.read("edited-too.ply") == work.read("again.ply"));
    assert!(work.read("edited.ply") != work.read("amphora.ply"));
    assert!(work.read("edited-too.ply") != work.read("amphora.ply"));
    let said = run("compare", &["amphora.ply", "samples-compared", "warp"]);
    assert!(
        said.contains("1000 samples: off by ") && work.path("samples-compared/index.html").exists(),
        "{said}"
    );
}

/// A copy of a lesson's folder, after the commands of its page.
struct Lesson {
    folder: PathBuf,
    /// Standard output of the commands.
    said: String,
}

impl Lesson {
    /// Copies a lesson and gives the commands in the ```sh blocks of its page to a shell, as a reader would.
    fn follow(name: &str) -> Self {
        let repository = workspace();
        // Kept from one run to the next, so that what a plugin depends on is built once.
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("examples").join(name);
        copy(&repository.join("examples").join(name), &folder, repository);
        // Where a lesson builds a plugin.
        let target = folder.join("target");
        if !target.exists() {
            fs::create_dir_all(outside_target()).unwrap();
            std::os::unix::fs::symlink(outside_target(), target).unwrap();
        }
        // The same versions as here: nothing has to be looked up or downloaded.
        fs::copy(repository.join("Cargo.lock"), folder.join("Cargo.lock")).unwrap();

        let page = fs::read_to_string(folder.join("README.md")).unwrap();
        let blocks = page.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
        let script: String = blocks.collect();
        assert!(!script.is_empty(), "{name} has no commands");

        let path = std::env::var("PATH").unwrap_or_default();
        let output = Command::new("sh")
            .args(["-e", "-u", "-c", &script])
            .current_dir(&folder)
            .env("PATH", format!("{}:{path}", built().display()))
            .env_remove("CARGO_TARGET_DIR")
            .env_remove("SIMOD_PLUGIN_PATH")
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let complaint = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name}:\n{script}\n{said}\n{complaint}");
        Self { folder, said }
    }

    /// The result has all vertices of the model, most of them elsewhere.
    fn assert_deformed(&self, model: &str, result: &str) {
        let positions = |file: &str| Ply::parse(fs::read(self.folder.join(file)).unwrap()).positions();
        let (before, after) = (positions(model), positions(result));
        assert_eq!(before.len(), after.len());
        let moved = before.iter().zip(&after).filter(|(a, b)| a.distance(**b) > 1e-3).count();
        assert!(2 * moved > before.len(), "{moved} of {} vertices moved", before.len());
    }
}

/// Copies a lesson's sources, with smaller models, fewer samples, and absolute paths to the rest of the
/// repository.
fn copy(from: &Path, to: &Path, repository: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        let is_source =
            path.extension().is_some_and(|e| ["md", "toml", "py", "rs", "c"].iter().any(|x| e == *x));
        if path.is_dir() && entry.file_name() != "target" {
            copy(&path, &target, repository);
        } else if is_source {
            let text = fs::read_to_string(&path)
                .unwrap()
                .replace("2000000", "30000")
                .replace("200000", "8000")
                .replace("50000", "4000")
                .replace("\"../../", &format!("\"{}/", repository.display()));
            #[expect(clippy::disallowed_methods, reason = "half a file is made whole by the next run")]
            fs::write(target, text).unwrap();
        }
    }
}
