//! The arrows between the crates go one way (design §2): `plugin-api <- plugins`; `geometry <- core,
//! measure, generate, session, viewer`; `model <- core, generate, measure`; `core <- picture`; `plugin-api,
//! core, measure <- session <- check, compare, viewer, cli`; `measure, picture <- compare`; `check, compare
//! <- cli`; `picture <- scene, viewer`; `viewer, scene <- window`; `core, plugin-api, session, compare <-
//! python`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use object::{Object, ObjectSymbol};
use serde_json::Value;
use simod_tests::workspace;

/// Crates that draw windows or talk to graphics cards.
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

    /// Checks that each crate below a folder directly depends on no crate of the workspace but these.
    fn expect_at_most(&self, folder: &str, allowed: &[&str]) {
        for id in self.below(folder) {
            let members = self.uses[id].iter().filter(|d| self.members.contains_key(*d));
            let mut others = members.map(|d| &*self.names[d]).filter(|name| !allowed.contains(name));
            assert_eq!(others.next(), None, "what {} depends on", self.names[id]);
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

/// Runs a command, and returns its standard output.
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
    crates.expect_members("plugin-api/geometry", &[]);
    crates.expect_members("plugin-api/cholesky", &["simod-geometry", "simod-plugin-api"]);
    crates.expect_at_most("plugins", &["simod-cholesky", "simod-geometry", "simod-plugin-api"]);
    crates.expect_members("tests/bad-plugins", &["simod-plugin-api"]);
    crates.expect_members("host/features", &[]);
    crates.expect_members("host/model", &["simod-features"]);
    crates.expect_members("host/core", &["simod-geometry", "simod-model"]);
    crates.expect_members("host/generate", &["simod-geometry", "simod-model"]);
    crates.expect_members("host/measure", &["simod-geometry", "simod-model"]);
    crates.expect_members("host/storage", &["simod-model"]);
    crates.expect_members("host/picture", &["simod-core", "simod-model"]);
    let engine = ["simod-core", "simod-model"];
    let session = [&engine[..], &["simod-geometry", "simod-measure", "simod-plugin-api"]].concat();
    crates.expect_members("host/session", &session);
    let viewer =
        [&engine[..], &["simod-geometry", "simod-picture", "simod-plugin-api", "simod-session"]].concat();
    crates.expect_members("host/viewer", &viewer);
    let compare = [&engine[..], &["simod-measure", "simod-picture", "simod-session"]].concat();
    crates.expect_members("host/compare", &compare);
    let check = [&engine[..], &["simod-plugin-api", "simod-session"]].concat();
    crates.expect_members("host/check", &check);
    let cli =
        [&engine[..], &["simod-check", "simod-compare", "simod-generate", "simod-picture", "simod-session"]]
            .concat();
    crates.expect_members("host/cli", &cli);
    crates.expect_members("host/scene", &["simod-model", "simod-picture"]);
    let window = ["simod-generate", "simod-picture", "simod-plugin-api", "simod-scene", "simod-session"];
    crates.expect_members("host/window", &[&engine[..], &window, &["simod-viewer"]].concat());
    let python = [&engine[..], &["simod-compare", "simod-plugin-api", "simod-session"]].concat();
    crates.expect_members("host/python", &python);

    // Crates that talk to stores are in the program if it is built with them, and nowhere else.
    for folder in ["plugins", "host/core", "host/session", "host/viewer", "host/cli"] {
        crates.expect_none(folder, &["simod-storage", "object_store", "tokio"]);
    }
    crates.expect_none("host/core", &["abi_stable", "libloading", "clap", "simod-plugin-api"]);
    for folder in ["plugin-api", "plugins", "host/picture", "host/session", "host/viewer", "host/cli"] {
        crates.expect_none(folder, &WINDOWS);
    }
    // The scene is drawn into textures, for whichever window.
    crates.expect_none("host/scene", &["egui", "eframe", "winit", "abi_stable", "simod-plugin-api"]);
}

/// Nothing waits for the library for Python, or needs Python: it is no part of the first build, and without
/// tests of its own for `cargo test`.
#[test]
fn python_is_built_where_it_is_asked_for() {
    let read = |file: &str| -> toml::Table {
        let text = std::fs::read_to_string(workspace().join(file)).expect("a manifest");
        text.parse().expect("TOML")
    };
    let built_first = &read("Cargo.toml")["workspace"]["default-members"];
    assert_eq!(*built_first, vec!["plugins/*", "host/cli"].into());
    let library = &read("host/python/Cargo.toml")["lib"];
    for tests in ["test", "doctest"] {
        assert_eq!(library[tests].as_bool(), Some(false), "{tests}");
    }
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
    let left: Vec<&&str> =
        names.iter().filter(|name| name.contains("core_arch") && name.contains("_mm")).collect();
    assert!(left.is_empty(), "{left:#?}");
}

/// Libraries of the program have the same features whatever is built, so that none of them is built a second
/// time: in the first build, for the tests, the window, Python and stores. Where this fails, `host/features`
/// lacks a feature, or has one too many.
#[test]
fn what_the_program_needs_is_built_once() {
    let program = Packages::read("normal,build", &[]);
    let heavy = ["simod-scene", "simod-storage", "simod-window"];
    let tests: Vec<&str> =
        ["--workspace"].into_iter().chain(heavy.into_iter().flat_map(|name| ["--exclude", name])).collect();
    let python = ["-p", "simod-python"];
    let storage = ["-p", "simod-storage", "-p", "simod-cli", "--features", "simod-cli/object-storage"];
    for choice in [&tests[..], &["-p", "simod-scene", "-p", "simod-window"], &python, &storage] {
        let others = Packages::read("normal,build,dev", choice);
        // Object storage is a feature of the program itself.
        let libraries = program.0.iter().filter(|p| !p.starts_with("simod-cli "));
        let again: Vec<&String> =
            libraries.filter(|p| others.has_kind_of(p) && !others.0.contains(*p)).collect();
        assert!(again.is_empty(), "{choice:?} has other features of {again:?}");
    }
}

/// Packages that are built for a choice of the workspace's crates: name, version and features of each.
struct Packages(BTreeSet<String>);

impl Packages {
    fn read(edges: &str, choice: &[&str]) -> Self {
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

/// Comments are as wide as code may be, which `rustfmt` sees to for code alone. Tables, drawings and examples
/// of code are as wide as they have to be.
#[test]
fn comments_keep_to_the_width_of_code() {
    let settings = std::fs::read_to_string(workspace().join("rustfmt.toml")).expect("settings of rustfmt");
    let settings: toml::Table = settings.parse().expect("TOML");
    let width = settings["max_width"].as_integer().expect("a width") as usize;
    let folders = ["host", "plugin-api", "plugins", "tests", "benches", "examples"];
    let files: Vec<PathBuf> =
        folders.iter().flat_map(|folder| rust_files(&workspace().join(folder))).collect();
    assert!(files.len() > 300, "{} files", files.len());
    let mut wide = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).expect("source code");
        let mut is_code = false;
        for (number, line) in text.lines().enumerate() {
            let Some(comment) = line.trim_start().strip_prefix("//") else {
                is_code = false;
                continue;
            };
            let comment = comment.trim_start_matches(['/', '!']).trim_start();
            is_code ^= comment.starts_with("```");
            let is_drawn = is_code || comment.starts_with('|') || comment.contains('─');
            if line.chars().count() > width && !is_drawn {
                wide.push(format!("{}:{}", file.display(), number + 1));
            }
        }
    }
    assert!(wide.is_empty(), "comments wider than {width} characters: {wide:#?}");
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

#[test]
fn modules_have_no_circles() {
    let mut found = BTreeMap::new();
    for folder in std::fs::read_dir(workspace().join("host")).expect("a folder") {
        let folder = folder.expect("an entry").path();
        let name = folder.file_name().and_then(|name| name.to_str()).expect("a name").to_owned();
        if !folder.join("Cargo.toml").exists() {
            continue;
        }
        let files = Modules::read(&folder.join("src")).in_circles();
        if !files.is_empty() {
            found.insert(name, files);
        }
    }
    assert_eq!(found, BTreeMap::new(), "files that use each other in a circle");
}

/// The reader itself is right, on a crate with a circle, a facade, an alias and tests.
#[test]
#[allow(clippy::disallowed_methods, reason = "files of a test")]
fn circles_are_found() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in [
        ("lib.rs", "mod a;\nmod b;\nmod c;\npub use a::{A, One as Two};\n"),
        ("a.rs", "pub struct A;\npub struct One;\nfn f() { crate::b::g() }\n"),
        ("b.rs", "use super::{\n    Two,\n};\npub fn g() {}\n"),
        ("c.rs", "// use crate::d;\nuse crate::A;\n#[cfg(test)]\nmod tests {\n    use crate::d::D;\n}\n"),
        ("d.rs", "use crate::c;\n"),
    ] {
        std::fs::write(folder.path().join(name), text).expect("a file");
    }
    assert_eq!(Modules::read(folder.path()).in_circles(), ["crate::a", "crate::b"]);
}

/// The place of a module in its crate, or of something in a module.
type Place = Vec<String>;

/// The modules of a crate, a file each, without their tests; and what each uses of the others. A name that a
/// module merely passes on is of the module that has it.
struct Modules {
    /// The code of each, without comments.
    code: BTreeMap<Place, String>,
    /// Places that the names imported by each module stand for.
    imports: BTreeMap<Place, BTreeMap<String, Place>>,
}

impl Modules {
    fn read(source: &Path) -> Self {
        let mut code = BTreeMap::new();
        for file in rust_files(source) {
            let place = file.strip_prefix(source).expect("a file there").with_extension("");
            let mut place: Place =
                place.iter().map(|part| part.to_str().expect("UTF-8").to_owned()).collect();
            place.pop_if(|last| ["lib", "main", "mod"].contains(&last.as_str()));
            if !place.last().is_some_and(|last| last == "tests" || last.ends_with("_tests")) {
                let text = std::fs::read_to_string(&file).expect("source code");
                code.insert(place, without_tests(&text));
            }
        }
        let mut all = Self { code, imports: BTreeMap::new() };
        for (module, text) in &all.code {
            let named = parts(text).0.into_iter().flat_map(|import| leaves(import.1));
            let known = named.filter_map(|(name, path)| Some((name, all.absolute(module, &path)?)));
            let known = known.collect();
            all.imports.insert(module.clone(), known);
        }
        all
    }

    /// A path as from the crate's root; nothing for what is of other crates.
    fn absolute(&self, module: &[String], path: &[String]) -> Option<Place> {
        let below = |n: usize, rest: &[String]| Some([&module[..n], rest].concat());
        match path.first()?.as_str() {
            "crate" => Some(path[1..].to_vec()),
            "self" => below(module.len(), &path[1..]),
            "super" => {
                let up = path.iter().take_while(|part| *part == "super").count();
                below(module.len().checked_sub(up)?, &path[up..])
            }
            first => {
                let child = [module, &[first.to_owned()]].concat();
                if self.code.contains_key(&child) { below(module.len(), path) } else { None }
            }
        }
    }

    /// The module that has what stands at a place.
    fn owner(&self, place: &[String], depth: usize) -> Option<Place> {
        let length = (0..=place.len()).rev().find(|n| self.code.contains_key(&place[..*n]))?;
        let (module, rest) = place.split_at(length);
        let known = rest.first().and_then(|name| self.imports.get(module)?.get(name));
        match known {
            Some(to) if depth < 10 => self.owner(&[to, &rest[1..]].concat(), depth + 1),
            _ => Some(module.to_vec()),
        }
    }

    /// The modules that a module uses.
    fn used(&self, module: &Place) -> BTreeSet<Place> {
        let (imports, body) = parts(&self.code[module]);
        let words: BTreeSet<&str> = body.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
        let mut paths: Vec<Place> = Vec::new();
        for (passes_on, tree) in imports {
            let uses = leaves(tree).into_iter();
            paths.extend(uses.filter(|(name, _)| !passes_on || words.contains(name.as_str())).map(|x| x.1));
        }
        let inline = body.split(|c: char| !c.is_alphanumeric() && c != '_' && c != ':');
        paths.extend(inline.filter(|path| path.contains("::")).map(|path| place(path.trim_matches(':'))));
        let places = paths.iter().filter_map(|path| self.absolute(module, path));
        places.filter_map(|place| self.owner(&place, 0)).filter(|owner| owner != module).collect()
    }

    /// The modules that use themselves by way of others.
    fn in_circles(&self) -> Vec<String> {
        let used: BTreeMap<&Place, BTreeSet<Place>> = self.code.keys().map(|m| (m, self.used(m))).collect();
        let reaches_itself = |module: &&&Place| {
            let (mut seen, mut open) = (BTreeSet::new(), vec![**module]);
            while let Some(next) = open.pop() {
                open.extend(used[next].iter().filter(|m| seen.insert(*m)));
            }
            seen.contains(**module)
        };
        used.keys().filter(reaches_itself).map(|module| format!("crate::{}", module.join("::"))).collect()
    }
}

/// A path's names.
fn place(path: &str) -> Place {
    path.split("::").map(|part| part.trim().to_owned()).collect()
}

/// A file's code without comments, and without the modules of its tests, which come last.
fn without_tests(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(|line| line.split("//").next().unwrap_or("")).collect();
    let is_tests =
        |pair: &[&str]| pair[0] == "#[cfg(test)]" && pair[1].contains("mod ") && pair[1].ends_with('{');
    let end = lines.windows(2).position(is_tests).unwrap_or(lines.len());
    lines[..end].join("\n")
}

/// The imports of a file, each with whether it passes names on to others; and the rest of it.
fn parts(code: &str) -> (Vec<(bool, &str)>, String) {
    let (mut imports, mut body) = (Vec::new(), String::new());
    let mut rest = code;
    while let Some(at) = rest.find("use ") {
        let (before, after) = rest.split_at(at);
        let line = &before[before.rfind('\n').map_or(0, |end| end + 1)..];
        let is_import = line.trim().is_empty() || line.trim_start().starts_with("pub");
        let end = after.find(';').unwrap_or(after.len());
        if is_import {
            imports.push((!line.trim().is_empty(), &after[4..end]));
            body.push_str(&before[..before.len() - line.len()]);
            rest = &after[end..];
        } else {
            body.push_str(before);
            body.push_str("use ");
            rest = &after[4..];
        }
    }
    body.push_str(rest);
    (imports, body)
}

/// The names that an import brings in, and their paths.
fn leaves(tree: &str) -> Vec<(String, Place)> {
    let tree = tree.trim();
    let Some((prefix, inner)) = tree.split_once('{') else {
        let (path, name) = tree.split_once(" as ").map_or((tree, None), |(path, name)| (path, Some(name)));
        let mut path = place(path);
        if path.len() > 1 {
            path.pop_if(|last| last == "self");
        }
        let name = name.map_or_else(|| path.last().cloned().unwrap_or_default(), |n| n.trim().to_owned());
        return vec![(name, path)];
    };
    let inner = &inner[..inner.rfind('}').unwrap_or(inner.len())];
    let (mut all, mut depth, mut start) = (Vec::new(), 0, 0);
    for (at, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                let part = inner[start..at].trim();
                start = at + 1;
                if !part.is_empty() {
                    all.extend(leaves(&format!("{}{part}", prefix.trim())));
                }
            }
            _ => {}
        }
    }
    all
}
