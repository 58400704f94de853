//! `simod plugin new`: the project builds as it is, passes its own tests, and deforms a model.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::DVec3;
use simod_tests::{Workplace, built, has_compiler, outside_target, skip, workspace};

/// Centre of the bulge, its radius as a fraction of the diagonal, and its strength.
const CENTER: DVec3 = DVec3::new(0.8, 0.0, 0.0);
const RADIUS: f64 = 0.15;
const STRENGTH: f64 = 0.5;

/// Runs cargo in a project as a user does, and without the network unless it has to.
fn cargo(project: &Path, job: &str) {
    let run = |more: &[&str]| {
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo
            .current_dir(project)
            .args([job, "--release"])
            .args(more)
            .env("CARGO_TARGET_DIR", outside_target());
        cargo.output().unwrap()
    };
    let mut output = run(&["--offline"]);
    if !output.status.success() && String::from_utf8_lossy(&output.stderr).contains("--offline") {
        output = run(&[]);
    }
    assert!(output.status.success(), "cargo {job}: {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_new_plugin_works_as_it_is() {
    let work = Workplace::new();
    let report = work.report("plugin new soft-bulge");
    assert_eq!((&report["id"], &report["folder"]), (&"soft-bulge".into(), &"soft-bulge".into()));
    let project = work.path("soft-bulge");
    for file in report["files"].as_array().unwrap() {
        assert!(project.join(file.as_str().unwrap()).is_file(), "{file}");
    }
    // The same versions as here: nothing has to be looked up or downloaded.
    fs::copy(workspace().join("Cargo.lock"), project.join("Cargo.lock")).unwrap();
    cargo(&project, "build");
    cargo(&project, "test");

    let library = report["library"].as_str().unwrap().strip_prefix("target/").unwrap();
    let file = Path::new(library).file_name().unwrap();
    fs::create_dir(work.path("plugins")).unwrap();
    fs::copy(outside_target().join(library), work.path("plugins").join(file)).unwrap();
    assert_bulges(&work.with_plugins("plugins"));
}

#[test]
fn a_new_plugin_in_c_works_as_it_is() {
    if cfg!(windows) || !has_compiler("make") {
        return skip("make is not installed");
    }
    let work = Workplace::new();
    let report = work.report("plugin new soft-bulge --lang c");
    let project = work.path("soft-bulge");
    for file in report["files"].as_array().unwrap() {
        assert!(project.join(file.as_str().unwrap()).is_file(), "{file}");
    }
    let make = |target: &[&str]| {
        let path = std::env::var("PATH").unwrap_or_default();
        let mut make = Command::new("make");
        make.args(target).current_dir(&project).env("PATH", format!("{}:{path}", built().display()));
        let output = make.env("CFLAGS", "-O2 -Wpedantic -Werror").output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
        said
    };
    make(&[]);
    assert!(project.join(report["library"].as_str().unwrap()).is_file(), "{report}");
    let said = make(&["check"]);
    assert!(said.contains(" 0 failed, 0 warned"), "{said}");
    let work = work.with_plugins("soft-bulge/build");
    assert_bulges(&work);
    // Built from a clean checkout, nothing is left behind.
    make(&["clean"]);
    assert!(!project.join("build").exists());
}

/// The plugin is there, as a user sees it, and does what its source says.
fn assert_bulges(work: &Workplace) {
    let info = work.report("plugin info soft-bulge");
    assert_eq!((&info["version"], &info["warnings"]), (&"0.1.0".into(), &serde_json::Value::Null));
    assert_eq!(info["parameters"].as_array().unwrap().len(), 4);

    work.simod("generate -o model.ply --shape bumpy-sphere --vertices 30000");
    let [x, y, z] = CENTER.to_array();
    let params = format!("center = [{x}, {y}, {z}], radius = {RADIUS}, strength = {STRENGTH}");
    work.write_session(
        "model.ply",
        6000,
        &format!("[[step]]\ndeform = \"soft-bulge\"\nparams = {{ {params} }}"),
    );
    work.simod("sample model.ply -o model.simod --samples 6000");
    work.simod("deform model.simod --session edit.toml -o deformed.ply");
    work.simod("reconstruct model.simod --deformed deformed.ply -o edited.ply");

    let (before, after) = (work.ply("model.ply"), work.ply("edited.ply"));
    let diagonal = before.diagonal();
    let radius = RADIUS * diagonal;
    let mut moved = 0;
    for (p, q) in before.positions().into_iter().zip(after.positions()) {
        let t = (p.distance(CENTER) / radius).min(1.0);
        let exact = p + STRENGTH * (1.0 - t * t).powi(2) * (p - CENTER);
        assert!(q.distance(exact) < 2e-3 * diagonal, "{p} goes to {q}, not to {exact}");
        // Beyond the rim, what lies among samples that moved may move a little with them.
        assert!(p == q || t < 1.0 || p.distance(CENTER) < 1.5 * radius, "{p}, far away, goes to {q}");
        moved += usize::from(p.distance(q) > 0.01 * radius);
    }
    assert!(moved > 300, "{moved} vertices moved");
}

#[test]
fn the_folder_can_be_elsewhere_and_empty_but_nothing_else() {
    let work = Workplace::new();
    work.write("mine/Cargo.toml", "precious");
    work.refuses("plugin new mine", &["mine", "no empty folder"]);
    work.write("file", "precious");
    work.refuses("plugin new file", &["file", "no empty folder"]);
    work.refuses("plugin new bulge --path missing", &["missing"]);

    fs::create_dir_all(work.path("tools/bulge")).unwrap();
    let outcome = work.simod("plugin new bulge --path tools");
    assert!(outcome.stdout.contains("cargo build --release"), "{}", outcome.stdout);
    let outcome = work.simod("plugin new bump --path tools --lang c");
    assert!(outcome.stdout.contains("  make check\n"), "{}", outcome.stdout);
    assert_eq!(work.run("plugin new bump --lang cobol").code, Some(2));
    assert_eq!(work.names(), ["file", "mine", "tools"]);
    assert!(work.path("tools/bulge/src/lib.rs").is_file());
    work.refuses("plugin new bulge --path tools", &["bulge", "is there already"]);
}

#[test]
fn names_that_do_not_do_are_refused() {
    let work = Workplace::new();
    for name in ["Bulge", "soft_bulge", "soft--bulge", "bulge-", "2d", "../bulge", "bülge", "move", "test"] {
        work.refuses(&format!("plugin new {name}"), &[name]);
    }
    assert!(work.names().is_empty());
}
