//! A plugin that was built when the interface was first released, and with another compiler configuration,
//! keeps working.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::{Path, PathBuf};
use std::process::Command;

use glam::DVec3;
use simod_tests::{Workplace, outside_target, run_build, workspace};

const STEP: &str = "
    [[step]]
    deform = \"veteran\"
    params = { height = 2, notes = \"notes.txt\" }
    [[step.region]]
    role = \"fixed\"
    shapes = [{ half-space = { point = [0, 0.5, 0], normal = [0, -1, 0] } }]
    [[step.joint]]
    id = \"elbow\"
    at = [0, 1, 0]
    [[step.handle]]
    id = \"grip\"
    move = { translate = [0.25, 0, 0] }
    [[step.stroke]]
    radius = 0.125
    points = [[0, 1, 0]]
    [[step.stroke]]
    radius = 0.25
    strength = 0.5
    points = [[0, 1, 0], [0, 2, 0]]
    params = { along = \"y\", up = false, times = 3, height = 1 }
    ";

/// Builds the old plugin as its author did, or otherwise: what is in a folder of the target folder.
fn build(folder: &str, configure: impl Fn(&mut Command)) -> PathBuf {
    let target = outside_target();
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(workspace().join("tests/first-interface"));
    cargo.args(["build", "--release", "--locked", "--target-dir"]).arg(&target);
    configure(&mut cargo);
    run_build(cargo);
    target.join(folder).join("release").join(format!("{DLL_PREFIX}veteran{DLL_SUFFIX}"))
}

fn works(library: &Path) {
    let work = Workplace::new().with_plugins("plugins");
    work.write(&format!("plugins/veteran{DLL_SUFFIX}"), std::fs::read(library).expect("a library"));
    let checked = work.report(&format!("plugin check {}", library.display()));
    assert_eq!(checked["failed"], 0, "{checked}");
    // Rules on what the first interface does not know do not apply to the plugin.
    let rules = checked["rules"].as_array().expect("rules").iter();
    let skipped: Vec<_> = rules.filter(|r| r["verdict"] == "skip").map(|r| &r["rule"]).collect();
    assert_eq!(skipped, ["migration", "time", "attributes", "other-models"], "{checked}");
    work.simod("generate -o model.ply --vertices 5000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work.write("notes.txt", "to be read");
    work.write_session("model.ply", 500, STEP);
    let before = work.ply("model.simod/samples.ply").positions();
    for isolate in ["never", "always"] {
        let outcome =
            work.simod(&format!("deform model.simod --session edit.toml -o out.ply --isolate {isolate}"));
        assert!(outcome.stdout.contains("at your service"), "{}", outcome.stdout);
        // Moved by the grip, lifted along z by one stroke and lowered along y by the other, as far as not
        // held.
        let held = before.iter().filter(|p| p.y <= 0.5).count();
        assert!((10..before.len() - 10).contains(&held), "{held} of {}", before.len());
        let t = 1.0 - held as f64 / before.len() as f64;
        let shift = DVec3::new(0.25, -0.375, 0.25) * t * t * (3.0 - 2.0 * t);
        for (p, q) in before.iter().zip(work.ply("out.ply").positions()) {
            assert!((q - *p).distance(shift) < 1e-5, "{p} to {q}, not by {shift}");
        }
    }
}

#[test]
fn a_plugin_of_the_first_release_works() {
    works(&build("", |_| ()));
}

#[test]
fn a_plugin_of_another_compiler_configuration_works() {
    // Rust's own layouts are shuffled, as another compiler's may be: only what is frozen may cross the
    // boundary. What runs in the compiler, its macros, is that of the other test.
    let host = host_triple();
    works(&build(&host, |cargo| {
        cargo.args(["--target", &host]).env("RUSTC_BOOTSTRAP", "1");
        cargo.env("RUSTFLAGS", "-Zrandomize-layout -Copt-level=0 -Cdebug-assertions=on -Coverflow-checks=on");
    }));
}

/// The compiler's name for this platform.
fn host_triple() -> String {
    let rustc = Command::new("rustc").arg("-vV").output().expect("rustc runs");
    let said = String::from_utf8(rustc.stdout).expect("UTF-8");
    said.lines().find_map(|line| line.strip_prefix("host: ")).expect("rustc names the host").to_owned()
}
