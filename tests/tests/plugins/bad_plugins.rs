//! Plugins that are none, of another version, or misbehave: an error each, and the others go on.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};

use glam::DVec3;
use simod_tests::{Workplace, built, cargo_build, library, outside_target, run_build, workspace};

/// A model and its samples, and a folder `plugins` to look in.
fn sampled() -> Workplace {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 5000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work
}

fn install(work: &Workplace, name: &str, bytes: impl AsRef<[u8]>) {
    work.write(&format!("plugins/{name}{DLL_SUFFIX}"), bytes);
}

fn step(plugin: &str) -> String {
    format!("[[step]]\ndeform = \"{plugin}\"\n")
}

const DEFORM: &str = "deform model.simod --session edit.toml -o out.ply";

/// `name` is there, but cannot be loaded: a warning where plugins are listed, no obstacle to others, and an
/// error that says so where it is asked for.
fn check_rejected(work: &Workplace, name: &str, reason: &str) {
    let file = format!("{name}{DLL_SUFFIX}");
    let list = work.simod("plugin list --json");
    let [warning] = list.lines("warning: ")[..] else { panic!("{}", list.stderr) };
    assert!(warning.contains(&file) && warning.contains(reason), "{warning}");
    let report = list.json();
    let plugins = report["plugins"].as_array().expect("a list");
    let is_there = |id: &str| plugins.iter().any(|p| p["id"] == id);
    assert!(is_there("warp") && is_there("rbf"), "{report}");
    assert!(plugins.iter().all(|p| p["path"].as_str().is_some_and(|p| !p.ends_with(&file))), "{report}");

    work.write_session("model.ply", 500, &step("warp"));
    work.simod("run edit.toml");
    std::fs::remove_file(work.path("edited.ply")).expect("the output");

    work.write_session("model.ply", 500, &step(name));
    work.refuses("run edit.toml", &["edit.toml, line 5", &file, reason]);
    work.refuses(DEFORM, &["edit.toml, line 5", &file, reason]);
    work.refuses(&format!("plugin info {name}"), &[&file, reason]);
}

#[test]
fn a_library_that_is_no_plugin() {
    let work = sampled();
    install(&work, "letter", "a text is no library, be it ever so long\n".repeat(50));
    check_rejected(&work, "letter", "no library");
    std::fs::remove_dir_all(work.path("plugins")).expect("the folder");

    let warp = std::fs::read(library("simod_warp")).expect("a library");
    install(&work, "half", &warp[..warp.len() / 2]);
    check_rejected(&work, "half", "cut off");
}

/// A plugin that was built against another version of the interface.
#[test]
fn a_plugin_of_another_abi_version() {
    let work = sampled();
    // The interface's next version, and a plugin made for it, in a workspace of their own.
    let root = std::fs::read_to_string(workspace().join("Cargo.toml")).expect("a manifest");
    let mut root: toml::Table = root.parse().expect("TOML");
    // With the profile of other authors' plugins, of which some are built here: what all need is built once.
    root.remove("profile");
    let table = root["workspace"].as_table_mut().expect("a table");
    table.remove("default-members");
    table.insert("members".into(), vec!["plugin-api", "plugin-api/derive", "plugin"].into());
    work.write("next/Cargo.toml", root.to_string());
    work.write("next/Cargo.lock", std::fs::read(workspace().join("Cargo.lock")).expect("a lock file"));
    for folder in ["plugin-api/src", "plugin-api/derive/src"] {
        for file in std::fs::read_dir(workspace().join(folder)).expect("sources") {
            let path = file.expect("a source").path();
            let name = path.file_name().and_then(|n| n.to_str()).expect("a name");
            work.write(&format!("next/{folder}/{name}"), std::fs::read(&path).expect("a source"));
        }
    }
    let derive = std::fs::read(workspace().join("plugin-api/derive/Cargo.toml")).expect("a manifest");
    work.write("next/plugin-api/derive/Cargo.toml", derive);
    let api = std::fs::read_to_string(workspace().join("plugin-api/Cargo.toml")).expect("a manifest");
    let api = api.replace("version = \"1.5.0\"", "version = \"2.0.0\"");
    work.write("next/plugin-api/Cargo.toml", api);
    work.write(
        "next/plugin/Cargo.toml",
        "[package]\nname = \"from-the-future\"\nversion = \"1.0.0\"\nedition = \"2024\"\n\
         [lib]\ncrate-type = [\"cdylib\"]\n[dependencies]\nsimod-plugin-api.workspace = true\n",
    );
    work.write("next/plugin/src/lib.rs", FROM_THE_FUTURE);
    let mut cargo = cargo_build(&work.path("next"), &outside_target());
    cargo.args(["--offline", "-p", "from-the-future"]);
    run_build(cargo);

    let profile = built().file_name().expect("a profile's folder");
    let file = outside_target().join(profile).join(format!("{DLL_PREFIX}from_the_future{DLL_SUFFIX}"));
    install(&work, "from_the_future", std::fs::read(file).expect("a library"));
    check_rejected(&work, "from_the_future", "interface 2.0.0, this program has 1.5.0");
}

const FROM_THE_FUTURE: &str = r#"
use simod_plugin_api::{DeformInput, Deformer, Descriptor, Host, PluginResult, PrepareInput};

struct Still;

impl Deformer for Still {
    type State = ();
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("from-the-future", "From the future", "1.0.0")
    }

    fn prepare(_: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<()> {
        Ok(())
    }

    fn deform(
        _: &(), input: &DeformInput<'_>, _: &mut (), out: &mut [[f32; 3]], _: &Host<'_>,
    ) -> PluginResult<()> {
        out.copy_from_slice(input.samples.positions());
        Ok(())
    }
}

simod_plugin_api::export_plugin!(Still);
"#;

#[test]
fn a_plugin_that_misbehaves() {
    let work = sampled();
    install(&work, "misbehaving", std::fs::read(library("misbehaving")).expect("a library"));
    let session = |how: &str| {
        let step = step("misbehaving") + &format!("params = {{ how = \"{how}\" }}\n");
        work.write_session("model.ply", 500, &step);
    };
    let bad = [
        ("panic-in-prepare", "panic"),
        ("panic-in-deform", "panic"),
        ("panic-payload", "panic"),
        ("error-in-prepare", "this does not please me"),
        ("error-in-deform", "not today"),
        ("cancel-unasked", "stopped unasked"),
        ("nan", "not finite"),
        ("unwritten", "unwritten"),
    ];
    let here = format!("{DEFORM} --isolate never");
    for (how, reason) in bad {
        session(how);
        work.refuses("run edit.toml", &["misbehaving", reason]);
        work.refuses(DEFORM, &["misbehaving", reason]);
        work.refuses(&here, &["misbehaving", reason]);
    }
    session("writes-to-input");
    work.refuses(&here, &["misbehaving", "changed the samples"]);
    // Asked for the exact map, when the deformed model is there already, it fails; the model stays.
    session("panic-in-evaluate");
    let line = "run edit.toml --measure";
    work.run(line).refused(line, &["misbehaving", "panic"]);
    assert_eq!(work.ply("edited.ply").len(), 5000);
    // The same plugin, when it behaves, and when only its state cannot be freed.
    for how in ["well", "panic-in-drop"] {
        session(how);
        let outcome = work.simod("run edit.toml");
        assert!(outcome.stdout.contains("all is well"), "{}", outcome.stdout);
        assert!(outcome.lines("warning: ").is_empty(), "{}", outcome.stderr);
    }
    // The plugin shifts by 1 along x, in a unit in which the diagonal is between 1 and 2.
    let before = work.ply("model.ply");
    let unit = before.diagonal().log2().floor().exp2();
    let shifts = before.positions().into_iter().zip(work.ply("edited.ply").positions()).map(|(p, q)| q - p);
    assert!(shifts.into_iter().all(|shift| shift.distance(DVec3::X * unit) < 1e-5));
}
