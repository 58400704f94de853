//! Finding and loading plugins.
//!
//! One bad library never hides the good ones: what cannot be used is listed with its reason, in one line.

mod cache;
mod folders;
mod library_file;
mod load;

use crate::deformer::{About, Plugin};
use crate::params::nearest;
use crate::step::Step;
#[cfg(unix)]
use crate::worker::{self, WorkerCode, WorkerOptions};
use cache::{LibraryCache, LibraryStamp};
pub use library_file::aborts_on_panic;
use load::LazyCode;
pub(crate) use load::load_code;
use semver::Version;
use simod_model::progress::Silent;
use simod_model::{Error, Progress, Result};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::env::consts::{DLL_EXTENSION, DLL_PREFIX};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Environment variable with more folders to look in, before all others; separated as in `PATH`.
pub const PATH_VARIABLE: &str = "SIMOD_PLUGIN_PATH";

/// A library that is not used.
#[derive(Debug)]
pub struct Rejected {
    /// The library's file, or a folder that could not be read.
    pub path: PathBuf,
    /// The reason for the rejection.
    pub error: Error,
}

/// A library that is not used because another of the same id has a higher version, came with the program, or
/// came first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Duplicate {
    /// The plugin's id.
    pub id: String,
    /// The library that is used.
    pub used: PathBuf,
    /// The library that is not used.
    pub unused: PathBuf,
    /// The version of the library that is not used.
    pub unused_version: String,
    /// Whether the library that is not used came with the program.
    pub unused_is_shipped: bool,
}

/// A folder to look in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PluginFolder {
    /// The folder's path.
    pub path: PathBuf,
    /// Whether only files named like plugins count (`libsimod_*.so` and its like), rather than every library.
    pub by_name: bool,
    /// Whether the folder's plugins came with the program.
    pub shipped: bool,
}

/// The plugins that run in processes of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Isolation {
    /// Plugins that did not come with the program.
    #[default]
    Others,
    /// All plugins.
    Always,
    /// No plugin.
    Never,
}

impl Isolation {
    /// Whether a library gets a process of its own.
    fn isolates(self, shipped: bool) -> bool {
        match self {
            Self::Others => !shipped,
            Self::Always => true,
            Self::Never => false,
        }
    }
}

/// Options of looking for plugins and running them.
#[derive(Debug, Clone)]
pub struct PluginOptions {
    /// Libraries to use, whatever others with their ids there are.
    pub chosen: Vec<PathBuf>,
    /// The folders to look in, most important first.
    pub folders: Vec<PluginFolder>,
    /// The plugins that run in processes of their own.
    pub isolation: Isolation,
    /// Options of these processes.
    #[cfg(unix)]
    pub worker: Arc<WorkerOptions>,
    /// File in which to remember what libraries are, if at all.
    pub cache: Option<PathBuf>,
}

impl PluginOptions {
    /// The standard folders and cache.
    #[cfg(unix)]
    pub fn standard(isolation: Isolation, worker: WorkerOptions) -> Self {
        let (folders, cache) = (standard_folders(), cache::standard_file());
        Self { chosen: Vec::new(), folders, isolation, worker: Arc::new(worker), cache }
    }

    /// Options for another program that has this one's libraries within itself: its plugins are those of
    /// `program`, beside which they lie, and which runs them where they have processes of their own.
    #[cfg(unix)]
    pub fn of_program(program: &Path) -> Self {
        let worker = WorkerOptions::for_program(program);
        Self { folders: folders_of(Some(program)), ..Self::standard(Isolation::Others, worker) }
    }

    /// The given folders in this process, and nothing to remember.
    pub fn in_process(folders: Vec<PluginFolder>) -> Self {
        Self {
            chosen: Vec::new(),
            folders,
            isolation: Isolation::Never,
            #[cfg(unix)]
            worker: Arc::new(WorkerOptions { command: Vec::new(), silence: Duration::ZERO, memory: 0 }),
            cache: None,
        }
    }
}

/// Library that took long to describe itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slow {
    /// The library's file.
    pub path: PathBuf,
    /// The time that it took to load.
    pub time: Duration,
}

/// Time of loading above which a library is reported as slow.
const SLOW: Duration = Duration::from_millis(500);

/// Longest time that a library may take to describe itself.
#[cfg(unix)]
const INTRODUCTION: Duration = Duration::from_secs(10);

/// The plugins that are there.
#[derive(Debug, Default)]
pub struct PluginRegistry {
    plugins: Vec<Arc<Plugin>>,
    rejected: Vec<Rejected>,
    duplicates: Vec<Duplicate>,
    slow: Vec<Slow>,
    /// Folders that anybody may write to.
    open: Vec<PathBuf>,
    /// Libraries that are used, whatever others with their ids there are.
    chosen: Vec<PathBuf>,
    /// All libraries that were looked at, as they were then, used or not.
    seen: BTreeMap<PathBuf, (LibraryStamp, Option<Arc<Plugin>>)>,
}

/// The folders that [`PluginRegistry::discover`] looks in, most important first: those in
/// `SIMOD_PLUGIN_PATH`, the user's, `plugins/` beside the running program, and the program's own.
pub fn standard_folders() -> Vec<PluginFolder> {
    folders_of(std::env::current_exe().ok().as_deref())
}

/// The folders that a program looks for plugins in, which may not be the running one.
fn folders_of(program: Option<&Path>) -> Vec<PluginFolder> {
    let any = |path| PluginFolder { path, by_name: false, shipped: false };
    let mut folders: Vec<PluginFolder> = std::env::var_os(PATH_VARIABLE)
        .map(|paths| std::env::split_paths(&paths).filter(|p| !p.as_os_str().is_empty()).map(any).collect())
        .unwrap_or_default();
    folders.extend(user_folder().map(any));
    if let Some(own) = program.and_then(Path::parent) {
        folders.push(PluginFolder { path: own.join("plugins"), by_name: false, shipped: true });
        folders.push(PluginFolder { path: own.to_owned(), by_name: true, shipped: true });
    }
    folders
}

/// Folder in which a user installs plugins.
fn user_folder() -> Option<PathBuf> {
    let data =
        folders::users_folder("APPDATA", "Library/Application Support", "XDG_DATA_HOME", ".local/share");
    data.map(|data| data.join("simod").join("plugins"))
}

impl PluginRegistry {
    /// The given plugins.
    pub fn from_plugins(plugins: impl IntoIterator<Item = Plugin>) -> Self {
        let mut registry = Self::default();
        plugins.into_iter().for_each(|plugin| registry.add(Arc::new(plugin)));
        registry
    }

    /// Adds a plugin, which takes the place of any other of its id.
    pub fn put(&mut self, plugin: Arc<Plugin>) {
        self.plugins.retain(|known| known.id() != plugin.id());
        self.plugins.push(plugin);
        self.plugins.sort_by(|a, b| a.id().cmp(b.id()));
    }

    /// Looks for plugins in the folders. Folders that do not exist are fine. Libraries that were looked at
    /// before and did not change since are not run, nor loaded before they are used.
    pub fn discover(options: &PluginOptions) -> Self {
        // No user can ask this to stop.
        Self::discover_with(options, &Silent).unwrap_or_default()
    }

    /// [`discover`](Self::discover), stopping where `progress` says so.
    ///
    /// # Errors
    /// Cancelled.
    pub fn discover_with(options: &PluginOptions, progress: &dyn Progress) -> Result<Self> {
        let mut registry = Self::default();
        registry.refresh_with(options, progress)?;
        Ok(registry)
    }

    /// Looks again. Plugins whose library did not change stay the same; one that changed is a new plugin,
    /// beside which the former one goes on to work for those that use it.
    pub fn refresh(&mut self, options: &PluginOptions) {
        // No user can ask this to stop.
        let _ = self.refresh_with(options, &Silent);
    }

    fn refresh_with(&mut self, options: &PluginOptions, progress: &dyn Progress) -> Result<()> {
        let before = std::mem::take(self).seen;
        let mut cache = LibraryCache::load(options.cache.clone());
        for file in &options.chosen {
            let path = file.canonicalize().unwrap_or_else(|_| file.clone());
            self.chosen.push(path);
            self.look_at(file.clone(), false, options, &before, &mut cache, progress)?;
        }
        for folder in &options.folders {
            match libraries(folder) {
                Ok(files) => {
                    if is_open(&folder.path) {
                        self.open.push(folder.path.clone());
                    }
                    for file in files {
                        self.look_at(file, folder.shipped, options, &before, &mut cache, progress)?;
                    }
                }
                Err(error) => self.rejected.push(Rejected { path: folder.path.clone(), error }),
            }
        }
        cache.save();
        self.plugins.sort_by(|a, b| a.id().cmp(b.id()));
        Ok(())
    }

    fn look_at(
        &mut self,
        file: PathBuf,
        shipped: bool,
        options: &PluginOptions,
        before: &BTreeMap<PathBuf, (LibraryStamp, Option<Arc<Plugin>>)>,
        cache: &mut LibraryCache,
        progress: &dyn Progress,
    ) -> Result<()> {
        progress.check()?;
        // The same file by another name, as through a link, is one library.
        let path = file.canonicalize().unwrap_or_else(|_| file.clone());
        if self.seen.contains_key(&path) {
            return Ok(());
        }
        let Some(stamp) = LibraryStamp::from_path(&path) else {
            let e = std::io::Error::from(std::io::ErrorKind::NotFound);
            self.rejected.push(Rejected { error: Error::io("read the plugin", &file, &e), path: file });
            return Ok(());
        };
        if let Some((old, Some(plugin))) = before.get(&path)
            && *old == stamp
        {
            self.seen.insert(path, (stamp, Some(plugin.clone())));
            self.add(plugin.clone());
            return Ok(());
        }
        let isolated = options.isolation.isolates(shipped);
        let started = Instant::now();
        let known = cache.get(&path, stamp);
        let plugin = open(&file, shipped, isolated, options, known.clone(), progress);
        progress.check()?;
        let plugin = plugin.map(Arc::new);
        let time = started.elapsed();
        if time > SLOW {
            self.slow.push(Slow { path: file.clone(), time });
        }
        self.seen.insert(path.clone(), (stamp, plugin.as_ref().ok().cloned()));
        match plugin {
            Ok(plugin) => {
                if known.is_none() {
                    cache.put(&path, stamp, plugin.about());
                }
                self.add(plugin);
            }
            Err(error) => self.rejected.push(Rejected { path: file, error }),
        }
        Ok(())
    }

    /// Whether a library was chosen, and so is used whatever others of its id there are.
    fn is_chosen(&self, plugin: &Plugin) -> bool {
        plugin.path().canonicalize().is_ok_and(|path| self.chosen.contains(&path))
    }

    fn add(&mut self, plugin: Arc<Plugin>) {
        let Some(at) = self.plugins.iter().position(|p| p.id() == plugin.id()) else {
            self.plugins.push(plugin);
            return;
        };
        let known_is_chosen = self.is_chosen(&self.plugins[at]);
        let known = &mut self.plugins[at];
        let better = match compare_versions(plugin.version(), known.version()) {
            Ordering::Greater => true,
            // A plugin takes the place of the program's own only with a newer version.
            Ordering::Equal => plugin.is_shipped() && !known.is_shipped(),
            Ordering::Less => false,
        };
        let unused = if better && !known_is_chosen { std::mem::replace(known, plugin) } else { plugin };
        self.duplicates.push(Duplicate {
            id: known.id().to_owned(),
            used: known.path().to_owned(),
            unused: unused.path().to_owned(),
            unused_version: unused.version().to_owned(),
            unused_is_shipped: unused.is_shipped(),
        });
    }

    /// Notices for users of these steps on the plugins that do them: a plugin that came from elsewhere takes
    /// the place of the program's own, or a step was made with another version.
    pub fn notices(&self, steps: &[Step]) -> Vec<String> {
        let mut notices = Vec::new();
        for step in steps.iter().filter(|step| step.enabled) {
            let Some(deformation) = step.deformation() else { continue };
            let Ok(plugin) = self.get(&deformation.deform) else { continue };
            notices.extend(self.replaced(plugin).filter(|notice| !notices.contains(notice)));
            let made_with = deformation.plugin.as_ref().map(|origin| origin.version.as_str());
            if let Some(version) = made_with.filter(|version| *version != plugin.version()) {
                notices.push(format!(
                    "{}: the step was made with {} {version}, and {} is used",
                    step.place,
                    plugin.id(),
                    plugin.version()
                ));
            }
        }
        notices
    }

    /// The plugin of the program's own that this one takes the place of, in words; nothing where that was
    /// asked for.
    pub fn replaced(&self, plugin: &Plugin) -> Option<String> {
        let own = self.duplicates.iter().find(|d| d.id == plugin.id() && d.unused_is_shipped)?;
        if plugin.is_shipped() || self.is_chosen(plugin) {
            return None;
        }
        Some(format!(
            "{} {} from {} takes the place of the program's own {} {}: remove it if that is not meant, or say `--use {}`",
            plugin.id(),
            plugin.version(),
            plugin.path().display(),
            plugin.id(),
            own.unused_version,
            plugin.path().display()
        ))
    }

    /// Folders that were looked in and that anybody on this machine may write to, and thereby have code run
    /// as the user.
    pub fn open_folders(&self) -> &[PathBuf] {
        &self.open
    }

    /// Reason for which a library that was chosen is not used, if so.
    pub fn refused_choice(&self) -> Option<&Error> {
        let is_chosen = |r: &&Rejected| {
            let path = r.path.canonicalize().unwrap_or_else(|_| r.path.clone());
            self.chosen.contains(&path)
        };
        self.rejected.iter().find(is_chosen).map(|r| &r.error)
    }

    /// Libraries that took long to describe themselves.
    pub fn slow(&self) -> &[Slow] {
        &self.slow
    }

    /// The plugins, by id.
    pub fn plugins(&self) -> &[Arc<Plugin>] {
        &self.plugins
    }

    /// The files of all libraries that were looked at, used or not.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.seen.keys().map(PathBuf::as_path)
    }

    /// Libraries that could not be used, and the reasons.
    pub fn rejected(&self) -> &[Rejected] {
        &self.rejected
    }

    /// Libraries that are not used since there is another of the same id.
    pub fn duplicates(&self) -> &[Duplicate] {
        &self.duplicates
    }

    /// The plugin of an id; an error that suggests another where there is none.
    pub fn get(&self, id: &str) -> Result<&Arc<Plugin>> {
        self.plugins.iter().find(|p| p.id() == id).ok_or_else(|| {
            // Perhaps it is there, and was not loaded: then that is what to tell.
            if let Some(Rejected { error, .. }) = self.rejected.iter().find(|r| is_named(&r.path, id)) {
                return Error::plugin(format!("there is no plugin `{id}`: {error}"), error.hint());
            }
            let ids = self.plugins.iter().map(|p| p.id());
            let hint = match nearest(id, ids.clone()) {
                Some(near) => format!("did you mean `{near}`?"),
                None if self.plugins.is_empty() => {
                    format!("no plugin was found at all: put some into {PATH_VARIABLE}'s folders")
                }
                None => format!("there are {}", ids.collect::<Vec<_>>().join(", ")),
            };
            Error::plugin(format!("there is no plugin `{id}`"), hint)
        })
    }
}

/// Loads a library into this process, whatever it says about itself.
pub fn load_unchecked(path: &Path) -> Result<Plugin> {
    let code = load_code(path, false)?;
    let about = Plugin::ask(code.as_ref(), path)?;
    Plugin::unchecked(code, about, path)
}

/// Plugin of a library, whose description may be known.
fn open(
    file: &Path,
    shipped: bool,
    isolated: bool,
    options: &PluginOptions,
    known: Option<About>,
    progress: &dyn Progress,
) -> Result<Plugin> {
    #[cfg(unix)]
    if isolated {
        let about = match known {
            Some(about) => about,
            None => {
                // No process is started for a file that is no plugin.
                library_file::kind(file)?;
                let silence = INTRODUCTION.min(options.worker.silence);
                let options = Arc::new(WorkerOptions { silence, ..(*options.worker).clone() });
                worker::ask(file, &options, progress)?
            }
        };
        let code = WorkerCode::new(file, about.clone(), options.worker.clone());
        return Plugin::known(Box::new(code), about, file).map(|plugin| plugin.shipped(shipped));
    }
    // There are no such processes on other systems.
    let _ = (isolated, options, progress);
    let plugin = match known {
        Some(about) => Plugin::known(Box::new(LazyCode::new(file, about.clone(), shipped)), about, file),
        None => Plugin::new(load_code(file, shipped)?, file),
    };
    plugin.map(|plugin| plugin.shipped(shipped))
}

/// Whether anybody may write to a folder.
fn is_open(folder: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        folder.metadata().is_ok_and(|meta| meta.permissions().mode() & 0o002 != 0)
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        false
    }
}

/// The dynamic libraries in a folder, by name; none where there is no folder.
fn libraries(folder: &PluginFolder) -> Result<Vec<PathBuf>> {
    let refused = |e: &std::io::Error| Error::io("read the plugin folder", &folder.path, e);
    let entries = match std::fs::read_dir(&folder.path) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(e) => return Err(refused(&e)),
    };
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| refused(&e))?.path();
        let is_library = path.extension().is_some_and(|e| e == DLL_EXTENSION);
        let named = path.file_name().and_then(|n| n.to_str());
        let is_named = named.is_some_and(|n| n.starts_with(&format!("{DLL_PREFIX}simod_")));
        if is_library && (is_named || !folder.by_name) && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Whether a library's file is named as that of the plugin `id` would be: `rbf.so`, `librbf.so`,
/// `libsimod_rbf.so`.
fn is_named(file: &Path, id: &str) -> bool {
    let stem = file.file_stem().and_then(|s| s.to_str()).unwrap_or_default();
    let stem = stem.strip_prefix(DLL_PREFIX).unwrap_or(stem);
    stem.strip_prefix("simod_").unwrap_or(stem) == id.replace('-', "_")
}

/// Compares by the precedence of semantic versions; the build does not count. Missing numbers are 0, and a
/// text that is no such version is older than all that are.
fn compare_versions(a: &str, b: &str) -> Ordering {
    match (semantic(a), semantic(b)) {
        (Some(a), Some(b)) => a.cmp_precedence(&b),
        (a, b) => a.is_some().cmp(&b.is_some()),
    }
}

/// A semantic version, of which minor and patch may be missing.
fn semantic(version: &str) -> Option<Version> {
    let (numbers, rest) = version.split_at(version.find(['-', '+']).unwrap_or(version.len()));
    let missing = ".0".repeat(2usize.saturating_sub(numbers.matches('.').count()));
    Version::parse(&format!("{numbers}{missing}{rest}")).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_compare_by_numbers() {
        assert_eq!(compare_versions("0.10.0", "0.9.7"), Ordering::Greater);
        assert_eq!(compare_versions("1.0.0", "1.0.0-rc.1"), Ordering::Greater);
        assert_eq!(compare_versions("1.0", "1.0.0+local"), Ordering::Equal);
        assert_eq!(compare_versions("1.0.0-rc.10", "1.0.0-rc.2"), Ordering::Greater);
        assert_eq!(compare_versions("2-rc.1", "1.9"), Ordering::Greater);
        assert_eq!(compare_versions("of today", "0.0.0-a"), Ordering::Less);
        assert_eq!(compare_versions("of today", ""), Ordering::Equal);
    }

    #[test]
    fn an_empty_registry_says_so() {
        let error = PluginRegistry::default().get("warp").unwrap_err();
        assert_eq!(error.to_string(), "there is no plugin `warp`");
        assert!(error.hint().contains("no plugin was found"));
    }
}
