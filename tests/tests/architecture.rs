//! The arrows between the crates go one way (design §2): `plugin-api <- plugins`; `plugin-api, core <-
//! session <- viewer, cli`; `core <- scene`; `viewer, scene <- window`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use object::{Object, ObjectSymbol};
use serde_json::Value;
use simod_tests::workspace;

/// What draws windows or talks to graphics cards.
const WINDOWS: [&str; 8] = ["egui", "eframe", "wgpu", "winit", "glutin", "ash", "glow", "softbuffer"];

/// The packages and what they depend on, on this platform: what `cargo metadata` says, by the ids of
/// packages.
struct Crates {
    names: BTreeMap<String, String>,
    /// The manifests of the workspace's own crates.
    members: BTreeMap<String, PathBuf>,
    /// Direct dependencies, those for tests and build scripts left out.
    uses: BTreeMap<String, BTreeSet<String>>,
}

impl Crates {
    fn read() -> Self {
        // Of other platforms' packages, not even the manifests need be on this machine.
        let rustc = Command::new("rustc").arg("-vV").output().expect("rustc runs");
        let rustc = String::from_utf8(rustc.stdout).expect("UTF-8");
        let host = rustc.lines().find_map(|l| l.strip_prefix("host: ")).expect("rustc names the host");
        let mut cargo = cargo("metadata");
        cargo.args(["--format-version", "1", "--locked", "--filter-platform", host]);
        let metadata: Value = serde_json::from_slice(&output(cargo)).expect("JSON");

        let ids: BTreeSet<&str> = list(&metadata["workspace_members"]).map(text).collect();
        let (mut names, mut members) = (BTreeMap::new(), BTreeMap::new());
        for package in list(&metadata["packages"]) {
            let id = text(&package["id"]);
            names.insert(id.to_owned(), text(&package["name"]).to_owned());
            if ids.contains(id) {
                members.insert(id.to_owned(), text(&package["manifest_path"]).into());
            }
        }
        let uses = list(&metadata["resolve"]["nodes"]).map(|node| {
            let is_normal = |d: &&Value| list(&d["dep_kinds"]).any(|k| k["kind"].is_null());
            let normal = list(&node["deps"]).filter(is_normal).map(|d| text(&d["pkg"]).to_owned());
            (text(&node["id"]).to_owned(), normal.collect())
        });
        Self { names, members, uses: uses.collect() }
    }

    /// Members of the workspace below a folder of it, or the one of a manifest.
    fn below(&self, folder: &str) -> Vec<&str> {
        let folder = workspace().join(folder);
        let found = self.members.iter().filter(|(_, manifest)| manifest.starts_with(&folder));
        let found: Vec<&str> = found.map(|(id, _)| id.as_str()).collect();
        assert!(!found.is_empty(), "no crate in {}", folder.display());
        found
    }

    /// All that a crate depends on, directly or not.
    fn closure(&self, id: &str) -> BTreeSet<&str> {
        let (mut found, mut open) = (BTreeSet::new(), vec![id]);
        while let Some(next) = open.pop() {
            open.extend(self.uses[next].iter().filter(|d| found.insert(*d)).map(String::as_str));
        }
        found.into_iter().map(|d| self.names[d].as_str()).collect()
    }

    /// Checks which crates of the workspace each crate below a folder depends on directly.
    fn expect_members(&self, folder: &str, expected: &[&str]) {
        for id in self.below(folder) {
            let members = self.uses[id].iter().filter(|d| self.members.contains_key(*d));
            let members: BTreeSet<&str> = members.map(|d| self.names[d].as_str()).collect();
            assert_eq!(members, expected.iter().copied().collect(), "what {} depends on", self.names[id]);
        }
    }

    /// Checks that crates below a folder do not even indirectly depend on any of `banned`.
    fn expect_none(&self, folder: &str, banned: &[&str]) {
        for id in self.below(folder) {
            let found = self.closure(id);
            let found: Vec<&&str> = banned.iter().filter(|b| found.contains(**b)).collect();
            assert!(found.is_empty(), "{} depends on {found:?}", self.names[id]);
        }
    }
}

/// A command of cargo's in the workspace.
fn cargo(command: &str) -> Command {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(workspace()).arg(command);
    cargo
}

/// What a command writes.
fn output(mut command: Command) -> Vec<u8> {
    let output = command.output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// A list in JSON.
fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().expect("a list").iter()
}

/// A text in JSON.
fn text(value: &Value) -> &str {
    value.as_str().expect("a text")
}

#[test]
fn arrows_go_one_way() {
    let crates = Crates::read();
    crates.expect_members("plugin-api/Cargo.toml", &["simod-plugin-api-derive"]);
    crates.expect_members("plugin-api/derive", &[]);
    crates.expect_members("plugins", &["simod-plugin-api"]);
    crates.expect_members("tests/bad-plugins", &["simod-plugin-api"]);
    crates.expect_members("host/features", &[]);
    crates.expect_members("host/core", &["simod-features"]);
    crates.expect_members("host/session", &["simod-core", "simod-plugin-api"]);
    crates.expect_members("host/viewer", &["simod-core", "simod-session", "simod-plugin-api"]);
    crates.expect_members("host/cli", &["simod-core", "simod-session"]);
    crates.expect_members("host/scene", &["simod-core"]);
    let window = ["simod-core", "simod-scene", "simod-session", "simod-viewer", "simod-plugin-api"];
    crates.expect_members("host/window", &window);

    crates.expect_none("host/core", &["abi_stable", "libloading", "clap", "simod-plugin-api"]);
    for folder in ["plugin-api", "plugins", "host/core", "host/session", "host/viewer", "host/cli"] {
        crates.expect_none(folder, &WINDOWS);
    }
    // It draws into textures, for whichever window.
    crates.expect_none("host/scene", &["egui", "eframe", "winit", "abi_stable", "simod-plugin-api"]);
}

/// Code over vectors is compiled for the processor only where it is inlined: what is left of the compiler's
/// vector instructions as functions of their own passes vectors through memory.
#[test]
fn no_vector_instruction_is_a_function() {
    if cfg!(debug_assertions) {
        println!("skipped: little is inlined without optimisation");
        return;
    }
    let program = std::fs::read(simod_tests::program()).expect("the program");
    let program = object::File::parse(&*program).expect("a program");
    let names: Vec<&str> = program.symbols().filter_map(|symbol| symbol.name().ok()).collect();
    assert!(names.iter().any(|name| name.contains("simod_core")), "the program has no names of functions");
    let left: Vec<&&str> = names.iter().filter(|name| name.contains("core_arch") && name.contains("_mm")).collect();
    assert!(left.is_empty(), "{left:#?}");
}

/// What the program depends on has the same features whatever is built, so that nothing of it is built a
/// second time: in the first build, for the tests, and for the window. Where this fails, `host/features`
/// lacks a feature, or has one too many.
#[test]
fn what_the_program_needs_is_built_once() {
    let program = Packages::of("normal,build", &[]);
    let tests = ["--workspace", "--exclude", "simod-scene", "--exclude", "simod-window"];
    for choice in [&tests[..], &["-p", "simod-scene", "-p", "simod-window"]] {
        let others = Packages::of("normal,build,dev", choice);
        let again: Vec<&String> =
            program.0.iter().filter(|p| others.has_kind_of(p) && !others.0.contains(*p)).collect();
        assert!(again.is_empty(), "{choice:?} has other features of {again:?}");
    }
}

/// Packages that are built for a choice of the workspace's crates: name, version and features of each.
struct Packages(BTreeSet<String>);

impl Packages {
    fn of(edges: &str, choice: &[&str]) -> Self {
        let mut cargo = cargo("tree");
        cargo
            .args(["--locked", "--no-dedupe", "--prefix", "none", "--format", "{p} {f}", "-e", edges])
            .args(choice);
        let lines = String::from_utf8(output(cargo)).expect("UTF-8");
        Self(lines.lines().filter(|line| !line.is_empty()).map(str::to_owned).collect())
    }

    /// Whether a package of the same name and version is there, with whatever features.
    fn has_kind_of(&self, package: &str) -> bool {
        let end = package.match_indices(' ').nth(1).map_or(package.len(), |(end, _)| end + 1);
        self.0.iter().any(|p| p.starts_with(&package[..end]))
    }
}

/// A panic in a plugin is caught at its border, which needs unwinding.
#[test]
fn no_profile_aborts_on_panic() {
    let manifest = std::fs::read_to_string(workspace().join("Cargo.toml")).expect("the workspace's manifest");
    let manifest: toml::Table = manifest.parse().expect("TOML");
    let profiles = manifest["profile"].as_table().expect("profiles");
    assert!(profiles.contains_key("release"));
    for (name, profile) in profiles {
        assert_ne!(profile.get("panic").and_then(|p| p.as_str()), Some("abort"), "profile {name}");
    }
}

/// Foreign code is loaded and called in one place of the session, and nowhere else in the host.
#[test]
fn foreign_code_has_one_border() {
    let mut border = BTreeSet::new();
    // Tests may make plugins of their own.
    let sources = rust_files(&workspace().join("host"));
    for file in sources.into_iter().filter(|file| !file.ends_with("tests.rs")) {
        let text = std::fs::read_to_string(&file).expect("source code");
        let text = text.split("#[cfg(test)]\nmod tests").next().expect("a first part");
        if ["abi_stable", "libloading", "PluginModRef"].iter().any(|word| text.contains(word)) {
            border.insert(file.strip_prefix(workspace()).expect("a file of the workspace").to_owned());
        }
    }
    let calls = Path::new("host/session/src/deformer");
    assert!(border.iter().any(|file| file.starts_with(calls)));
    border.retain(|file| !file.starts_with(calls));
    assert_eq!(border, BTreeSet::from([PathBuf::from("host/session/src/plugins/load.rs")]));
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                files.push(path);
            }
        }
    }
    files
}
