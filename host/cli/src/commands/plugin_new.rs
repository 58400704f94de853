//! `simod plugin new`: a project for a plugin in Rust or in C that builds, tests itself and works as it is.
//!
//! The interface travels along, a crate or a header, so that the project needs neither SIMOD's sources nor a
//! path to them.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;
use simod_model::output::write_file;
use simod_model::output_folder::OutputFolder;
use simod_model::target::folder_of;
use simod_model::{Error, Result};

use super::plugin_options::PluginArgs;
use crate::report::Report;

/// Begin a plugin of your own: a project in Rust or C that builds, tests itself and works
#[derive(Args)]
pub struct New {
    /// Name of the plugin in kebab-case, as `soft-bulge`
    ///
    /// It is the plugin's id in sessions, and the name of the project's folder.
    name: String,
    /// Folder to make the project's folder in [default: the current one]
    #[arg(long, value_name = "DIR")]
    path: Option<PathBuf>,
    /// Programming language of the plugin
    #[arg(long, value_enum, default_value_t = Language::Rust)]
    lang: Language,
}

/// Programming language of a plugin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Language {
    /// Rust, with the crate of the interface
    Rust,
    /// C, with the header of the interface; also for C++
    C,
}

/// A project in C.
const C_PROJECT: [(&str, &str); 6] = [
    ("plugin.c", include_str!("plugin_new/c/plugin.c")),
    ("simod_plugin.h", include_str!("../../../../plugin-api/include/simod_plugin.h")),
    ("Makefile", include_str!("plugin_new/c/Makefile")),
    ("README.md", include_str!("plugin_new/c/README.md")),
    ("session.toml", include_str!("plugin_new/session.toml")),
    (".gitignore", include_str!("plugin_new/c/gitignore")),
];

/// The project's files; words between underscores are filled in. The manifests have other names here, so that
/// cargo takes the folder for no package.
const PROJECT: [(&str, &str); 10] = [
    ("Cargo.toml", include_str!("plugin_new/manifest.toml")),
    ("README.md", include_str!("plugin_new/README.md")),
    ("session.toml", include_str!("plugin_new/session.toml")),
    ("rustfmt.toml", "max_width = 110\nuse_small_heuristics = \"Max\"\n"),
    (".gitignore", include_str!("plugin_new/gitignore")),
    ("src/lib.rs", include_str!("plugin_new/lib.rs")),
    ("src/tests.rs", include_str!("plugin_new/tests.rs")),
    ("simod-plugin-api/Cargo.toml", INTERFACE_MANIFEST),
    ("simod-plugin-api/derive/Cargo.toml", DERIVE_MANIFEST),
    ("simod-plugin-api/.gitignore", "/target\n/Cargo.lock\n"),
];

/// The interface's manifest without a workspace.
const INTERFACE_MANIFEST: &str = include_str!("plugin_new/interface.toml");

/// The manifest of the interface's derives, without a workspace.
const DERIVE_MANIFEST: &str = include_str!("plugin_new/derive.toml");

/// The interface's sources.
const INTERFACE: [(&str, &str); 16] = [
    ("c.rs", include_str!("../../../../plugin-api/src/c.rs")),
    ("curve.rs", include_str!("../../../../plugin-api/src/curve.rs")),
    ("deformer.rs", include_str!("../../../../plugin-api/src/deformer.rs")),
    ("descriptor.rs", include_str!("../../../../plugin-api/src/descriptor.rs")),
    ("error.rs", include_str!("../../../../plugin-api/src/error.rs")),
    ("handles.rs", include_str!("../../../../plugin-api/src/handles.rs")),
    ("host.rs", include_str!("../../../../plugin-api/src/host.rs")),
    ("input.rs", include_str!("../../../../plugin-api/src/input.rs")),
    ("lib.rs", include_str!("../../../../plugin-api/src/lib.rs")),
    ("migration.rs", include_str!("../../../../plugin-api/src/migration.rs")),
    ("opaque.rs", include_str!("../../../../plugin-api/src/opaque.rs")),
    ("param_set.rs", include_str!("../../../../plugin-api/src/param_set.rs")),
    ("params.rs", include_str!("../../../../plugin-api/src/params.rs")),
    ("parts.rs", include_str!("../../../../plugin-api/src/parts.rs")),
    ("root.rs", include_str!("../../../../plugin-api/src/root.rs")),
    ("services.rs", include_str!("../../../../plugin-api/src/services.rs")),
];

/// The sources of the interface's derives.
const DERIVE: [(&str, &str); 5] = [
    ("choice.rs", include_str!("../../../../plugin-api/derive/src/choice.rs")),
    ("lib.rs", include_str!("../../../../plugin-api/derive/src/lib.rs")),
    ("names.rs", include_str!("../../../../plugin-api/derive/src/names.rs")),
    ("param_set.rs", include_str!("../../../../plugin-api/derive/src/param_set.rs")),
    ("words.rs", include_str!("../../../../plugin-api/derive/src/words.rs")),
];

/// Names that Rust, its standard library, the interface or Windows keep for themselves.
const RESERVED: &str = "abstract alloc as async aux await become box break con const continue core crate do dyn else enum \
    extern false final fn for gen if impl in let loop macro match mod move mut nul override priv prn \
    proc-macro pub ref return self simod-plugin-api static std struct super test trait true try type \
    typeof union unsafe unsized use virtual where while yield";

/// The longest name, in letters.
const LONGEST: usize = 64;

impl New {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let names = PluginNames::from_name(&self.name)?;
        let known = PluginArgs::default().discover(report)?;
        if let Some(other) = known.plugins().iter().find(|plugin| plugin.id() == names.id) {
            let what = format!("there is a plugin `{}` already: {}", names.id, other.path().display());
            let hint = format!(
                "choose another id, such as my-{}: of two plugins with one id, one is not used",
                names.id
            );
            return Err(Error::argument(what, hint));
        }
        let folder = self.path.unwrap_or_default().join(&names.id);
        write_project(&folder, &names, self.lang)?;
        let (source, library) = match self.lang {
            Language::Rust => ("src/lib.rs", &names.library),
            Language::C => ("plugin.c", &names.c_library),
        };
        report
            .line(format!("{} is ready: a bulge about a point, to be changed in {source}", folder.display()));
        report.line("next:");
        report.line(format!("  cd {}", folder.display()));
        for command in self.lang.commands(&names) {
            report.line(format!("  {command}"));
        }
        report.line("README.md goes on from there");
        report.figure("id", names.id);
        report.figure("folder", folder.display().to_string());
        report.figure("library", library.as_str());
        report.figure("files", json!(self.lang.files().map(|(path, _)| path).collect::<Vec<_>>()));
        Ok(())
    }
}

impl Language {
    /// Commands that build and check a project.
    fn commands(self, names: &PluginNames) -> [String; 2] {
        match self {
            Self::Rust => {
                ["cargo build --release".to_owned(), format!("simod plugin check {}", names.library)]
            }
            Self::C => ["make".to_owned(), "make check".to_owned()],
        }
    }

    /// The files of a project, by their paths, before words are filled in.
    fn files(self) -> impl Iterator<Item = (String, &'static str)> {
        let own: &[_] = match self {
            Self::Rust => &PROJECT,
            Self::C => &C_PROJECT,
        };
        let own = own.iter().map(|&(path, text)| (path.to_owned(), text));
        own.chain(interface().filter(move |_| self == Self::Rust))
    }
}

/// Names that are made of the plugin's.
struct PluginNames {
    /// `soft-bulge`: the id, the package and the folder.
    id: String,
    /// `Soft bulge`: the title that the user reads.
    title: String,
    /// `SoftBulge`.
    type_name: String,
    /// `target/release/libsoft_bulge.so`, or as the system names libraries.
    library: String,
    /// `build/libsoft_bulge.so`, or as the system names libraries.
    c_library: String,
}

impl PluginNames {
    fn from_name(name: &str) -> Result<Self> {
        let refused = |what: &str, hint: &str| {
            Err(Error::argument(format!("a plugin cannot be called `{name}`: {what}"), hint))
        };
        let is_small = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit();
        if !name.chars().all(|c| is_small(c) || c == '-') || name.split('-').any(str::is_empty) {
            let hint = "use words of small letters and digits with a hyphen between, such as soft-bulge";
            return refused("it is not kebab-case", hint);
        }
        if name.starts_with(|c: char| c.is_ascii_digit()) {
            return refused("it begins with a digit", "begin with a letter, such as soft-bulge");
        }
        if name.len() > LONGEST {
            return refused("it is too long", &format!("use {LONGEST} letters at most"));
        }
        if RESERVED.split(' ').any(|word| word == name) {
            return refused("the name is taken", &format!("add a word, such as {name}-tool"));
        }
        let words: Vec<String> = name.split('-').map(capitalised).collect();
        let mut type_name = words.concat();
        if is_known(&type_name) {
            type_name.push_str("Deformation");
        }
        Ok(Self {
            id: name.to_owned(),
            title: capitalised(&name.replace('-', " ")),
            type_name,
            library: format!("target/release/{DLL_PREFIX}{}{DLL_SUFFIX}", name.replace('-', "_")),
            c_library: format!("build/{DLL_PREFIX}{}{DLL_SUFFIX}", name.replace('-', "_")),
        })
    }

    /// A file of the project with the names in their places.
    fn fill_in(&self, text: &str) -> String {
        text.replace("__NAME__", &self.id)
            .replace("__TITLE__", &self.title)
            .replace("__TYPE__", &self.type_name)
            .replace("__LIBRARY__", &self.library)
            .replace("__LIBRARY_NAME__", &self.id.replace('-', "_"))
    }
}

fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect()
}

/// Whether a type's name occurs in the interface or the project, whose own type would be hidden by it. The
/// answer is yes too often rather than too rarely.
fn is_known(type_name: &str) -> bool {
    let has_it = |text: &str| text.split(|c: char| !c.is_alphanumeric()).any(|word| word == type_name);
    PROJECT.iter().chain(&INTERFACE).any(|(_, text)| has_it(text))
}

/// The interface's and its derives' sources, by their paths in a project.
fn interface() -> impl Iterator<Item = (String, &'static str)> {
    let own = INTERFACE.iter().map(|(file, text)| (format!("simod-plugin-api/src/{file}"), *text));
    own.chain(DERIVE.iter().map(|(file, text)| (format!("simod-plugin-api/derive/src/{file}"), *text)))
}

/// Makes the project's folder, whole or not at all. There may be an empty one.
fn write_project(folder: &Path, names: &PluginNames, language: Language) -> Result<()> {
    let failed = |e: &io::Error| Error::io("create", folder, e);
    let is_there = folder.symlink_metadata().is_ok();
    if is_there && !fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none()) {
        let what = format!("{} is there already, and is no empty folder", folder.display());
        let hint = "choose another name, or another place by --path";
        return Err(Error::argument(what, hint));
    }
    let new = OutputFolder::create(folder)?;
    // Errors name the folder that was asked for, not its temporary name.
    let write = |path: String, text: &str| {
        write_file(&new.path().join(path), text.as_bytes()).map_err(|e| new.named(e))
    };
    for (path, text) in language.files() {
        fs::create_dir_all(folder_of(&new.path().join(&path))).map_err(|e| failed(&e))?;
        write(path, &names.fill_in(text))?;
    }
    if is_there {
        // The removal fails if something came into the folder meanwhile.
        fs::remove_dir(folder).map_err(|e| failed(&e))?;
    }
    new.commit()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of the workspace.
    fn read(path: &str) -> String {
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)).unwrap()
    }

    #[test]
    fn the_whole_interface_travels_along() {
        let files = |folder: &str| {
            let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
            let entries = fs::read_dir(sources).unwrap();
            let mut files: Vec<String> =
                entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
            files.sort();
            files
        };
        assert_eq!(files("plugin-api/src"), INTERFACE.map(|(file, _)| file));
        assert_eq!(files("plugin-api/derive/src"), DERIVE.map(|(file, _)| file));
    }

    #[test]
    fn the_interface_keeps_its_manifests_and_the_versions_of_the_workspace() {
        let workspace = read("Cargo.toml");
        let spelt_out = |line: &str| match line.strip_suffix(".workspace = true") {
            Some(key) => {
                let begins = |l: &&str| l.split_once(" = ").is_some_and(|(k, _)| k == key);
                workspace.lines().find(begins).unwrap().to_owned()
            }
            None => line.to_owned(),
        };
        for (path, ours) in
            [("plugin-api/Cargo.toml", INTERFACE_MANIFEST), ("plugin-api/derive/Cargo.toml", DERIVE_MANIFEST)]
        {
            let manifest = read(path);
            let (kept, _) = manifest.split_once("\n[lints]").unwrap();
            let expected: Vec<String> = kept.trim_end().lines().map(spelt_out).collect();
            assert_eq!(ours.lines().collect::<Vec<_>>(), expected, "{path}");
        }
    }

    #[test]
    fn names_follow_from_one() {
        let names = PluginNames::from_name("soft-bulge-2").unwrap();
        assert_eq!((&*names.title, &*names.type_name), ("Soft bulge 2", "SoftBulge2"));
        assert!(names.library.contains("soft_bulge_2"));
        assert_eq!(PluginNames::from_name("host").unwrap().type_name, "HostDeformation");
        assert_eq!(PluginNames::from_name("vec").unwrap().type_name, "VecDeformation");
        for bad in
            ["", "-", "Bulge", "soft_bulge", "soft--bulge", "bulge-", "-bulge", "2d", "bülge", "a/b", "fn"]
        {
            let error = PluginNames::from_name(bad).err().unwrap();
            assert!(error.to_string().contains(&format!("`{bad}`")) && !error.hint().is_empty(), "{error}");
        }
        assert!(
            PluginNames::from_name(&"a".repeat(LONGEST)).is_ok()
                && PluginNames::from_name(&"a".repeat(LONGEST + 1)).is_err()
        );
    }

    #[test]
    fn all_words_are_filled_in() {
        let names = PluginNames::from_name("soft-bulge").unwrap();
        let words = ["__NAME__", "__TITLE__", "__TYPE__", "__LIBRARY__", "__LIBRARY_NAME__"];
        for (path, text) in Language::Rust.files().chain(Language::C.files()) {
            // The interface's files have such words of their own.
            let is_ours = !path.starts_with("simod-plugin-api/");
            let text = names.fill_in(text);
            assert!(!is_ours || !words.iter().any(|w| text.contains(w)), "{path}");
        }
    }

    /// `docs/plugins.md` has all of the plugin but for its head.
    #[test]
    fn the_documentation_shows_the_plugin_as_it_is() {
        let (_, library) = PROJECT.iter().find(|(path, _)| *path == "src/lib.rs").unwrap();
        assert!(library.lines().count() < 130, "no short plugin");
        let library = PluginNames::from_name("soft-bulge").unwrap().fill_in(library);
        let plugin = &library[library.find("use simod_plugin_api").unwrap()..];
        assert!(read("docs/plugins.md").contains(&format!("```rust\n{plugin}```\n")), "write it anew");
    }

    /// All C code in `docs/plugins.md` is of the project's plugin, or of the lesson's.
    #[test]
    fn the_documentation_shows_c_as_it_is() {
        let (_, plugin) = C_PROJECT.iter().find(|(path, _)| *path == "plugin.c").unwrap();
        let sources = [
            PluginNames::from_name("soft-bulge").unwrap().fill_in(plugin),
            read("examples/04-a-plugin-in-c/grab.c"),
        ];
        let page = read("docs/plugins.md");
        let blocks: Vec<&str> = page.split("```c\n").skip(1).filter_map(|b| b.split("```").next()).collect();
        assert!(blocks.len() >= 4, "{}", blocks.len());
        for block in blocks {
            assert!(sources.iter().any(|source| source.contains(block)), "write it anew: {block}");
        }
    }

    #[test]
    fn a_project_is_written_whole_or_not_at_all() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("soft-bulge");
        let names = PluginNames::from_name("soft-bulge").unwrap();
        let found =
            || fs::read_dir(place.path()).unwrap().map(|e| e.unwrap().file_name()).collect::<Vec<_>>();
        write_project(&place.path().join("missing/soft-bulge"), &names, Language::C).unwrap_err();
        assert!(found().is_empty());
        fs::create_dir(&folder).unwrap();
        write_project(&folder, &names, Language::Rust).unwrap();
        assert!(Language::Rust.files().all(|(path, _)| folder.join(path).is_file()));
        let error = write_project(&folder, &names, Language::C).unwrap_err();
        assert!(error.to_string().contains("is there already"), "{error}");
        assert_eq!(found(), ["soft-bulge"]);
    }
}
