//! The arrows between the crates go one way (design §2): `plugin-api <- plugins`; `plugin-api, core <- session <- viewer, cli`;
//! `core <- scene`; `viewer, scene <- window`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, PackageId};
use simod_tests::workspace;

/// What draws windows or talks to graphics cards.
const WINDOWS: [&str; 8] = ["egui", "eframe", "wgpu", "winit", "glutin", "ash", "glow", "softbuffer"];

/// The packages and what they depend on, on this platform.
struct Crates {
    metadata: Metadata,
    /// Direct dependencies, those for tests and build scripts left out.
    uses: BTreeMap<PackageId, BTreeSet<PackageId>>,
}

impl Crates {
    fn read() -> Self {
        // Of other platforms' packages, not even the manifests need be on this machine.
        let rustc = Command::new("rustc").arg("-vV").output().expect("rustc runs");
        let rustc = String::from_utf8(rustc.stdout).expect("UTF-8");
        let host = rustc.lines().find_map(|l| l.strip_prefix("host: ")).expect("rustc names the host");
        let mut command = MetadataCommand::new();
        command.manifest_path(workspace().join("Cargo.toml"));
        command.other_options(["--locked", "--filter-platform", host].map(String::from));
        let metadata = command.exec().expect("cargo metadata");
        let resolve = metadata.resolve.as_ref().expect("resolved dependencies");
        let uses = resolve.nodes.iter().map(|node| {
            let normal =
                node.deps.iter().filter(|d| d.dep_kinds.iter().any(|k| k.kind == DependencyKind::Normal));
            (node.id.clone(), normal.map(|d| d.pkg.clone()).collect())
        });
        Self { uses: uses.collect(), metadata }
    }

    fn name(&self, id: &PackageId) -> &str {
        &self.metadata[id].name
    }

    /// Members of the workspace below a folder of it, or the one of a manifest.
    fn below(&self, folder: &str) -> Vec<PackageId> {
        let folder = workspace().join(folder);
        let members = self.metadata.workspace_packages().into_iter();
        let found: Vec<PackageId> =
            members.filter(|p| p.manifest_path.starts_with(&folder)).map(|p| p.id.clone()).collect();
        assert!(!found.is_empty(), "no crate in {}", folder.display());
        found
    }

    /// All that a crate depends on, directly or not.
    fn closure(&self, id: &PackageId) -> BTreeSet<&str> {
        let (mut found, mut open) = (BTreeSet::new(), vec![id]);
        while let Some(next) = open.pop() {
            open.extend(self.uses[next].iter().filter(|d| found.insert(*d)));
        }
        found.into_iter().map(|d| self.name(d)).collect()
    }

    /// Checks which crates of the workspace each crate below a folder depends on directly.
    fn expect_members(&self, folder: &str, expected: &[&str]) {
        for id in self.below(folder) {
            let members = self.uses[&id].iter().filter(|d| self.metadata.workspace_members.contains(d));
            let members: Vec<&str> = members.map(|d| self.name(d)).collect();
            assert_eq!(members, expected, "what {} depends on", self.name(&id));
        }
    }

    /// Checks that crates below a folder do not even indirectly depend on any of `banned`.
    fn expect_none(&self, folder: &str, banned: &[&str]) {
        for id in self.below(folder) {
            let found = self.closure(&id);
            let found: Vec<&&str> = banned.iter().filter(|b| found.contains(**b)).collect();
            assert!(found.is_empty(), "{} depends on {found:?}", self.name(&id));
        }
    }
}

#[test]
fn arrows_go_one_way() {
    let crates = Crates::read();
    crates.expect_members("plugin-api/Cargo.toml", &["simod-plugin-api-derive"]);
    crates.expect_members("plugin-api/derive", &[]);
    crates.expect_members("plugins", &["simod-plugin-api"]);
    crates.expect_members("tests/bad-plugins", &["simod-plugin-api"]);
    crates.expect_members("host/core", &[]);
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
