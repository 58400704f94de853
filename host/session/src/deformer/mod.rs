//! The border to foreign code: the only module that calls it.
//!
//! Every fault of a plugin short of a crash becomes an [`Error`] of kind `Plugin`: errors and panics (which
//! the plugin's side of the interface turned into errors), samples left unwritten, values that are not
//! finite, input that was written to, descriptions that make no sense.

mod about;
#[allow(unsafe_code, reason = "tables and pointers of C; each block has its argument")]
mod c;
mod care;
mod code;
pub mod limits;
mod lookups;
#[allow(unsafe_code, reason = "registers of the processor; each block has its argument")]
mod registers;

use crate::params::{check_description, check_migration};
use rayon::prelude::*;
use simod_model::{Error, ErrorMark, Progress, Result};
use simod_plugin_api::{
    Consumes, DeformInput, Descriptor, ErrorCode, HandleDesc, HostCalls, LogLevel, ParamDesc, PluginError,
    PrepareInput, Samples, Scratch, Setting, State,
};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use xxhash_rust::xxh3::Xxh3Default;

pub(crate) use about::About;
pub use about::{Capabilities, Migration};
pub(crate) use c::{CCode, load_whole};
pub(crate) use care::{Care, CarefulCode};
pub(crate) use code::RustCode;
pub use code::{Code, OwnHandles};
pub use limits::is_raw;
pub(crate) use lookups::LookingCode;

/// A plugin that is there to be used.
pub struct Plugin {
    code: Box<dyn Code>,
    capabilities: Capabilities,
    descriptor: Descriptor,
    migration: Option<Migration>,
    consumes: Consumes,
    path: PathBuf,
    shipped: bool,
}

/// A line from a plugin for the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The plugin's id.
    pub plugin: String,
    /// The message's importance.
    pub level: LogLevel,
    /// The text, in one line.
    pub text: String,
}

impl Message {
    /// A warning on a plugin.
    pub(crate) fn warning(plugin: &str, text: String) -> Self {
        Self { plugin: plugin.to_owned(), level: LogLevel::WARNING, text }
    }

    /// Whether the message is a warning: the result may not be what the user wants.
    pub fn is_warning(&self) -> bool {
        self.level.0 >= LogLevel::WARNING.0
    }

    /// Whether the message is for the plugin's author alone.
    pub fn is_debug(&self) -> bool {
        self.level.0 <= LogLevel::DEBUG.0
    }
}

impl std::fmt::Debug for Plugin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Plugin").field("descriptor", &self.descriptor).field("path", &self.path).finish()
    }
}

impl Plugin {
    /// A plugin of a test's own.
    #[cfg(test)]
    pub(crate) fn in_process(module: simod_plugin_api::PluginModRef, path: &Path) -> Result<Self> {
        Self::new(Box::new(LookingCode(RustCode::new(module))), path)
    }

    /// A deformer of the host's own: no library has its code.
    ///
    /// # Errors
    /// What it says of itself makes no sense.
    pub fn of_host(code: Box<dyn Code>) -> Result<Self> {
        Self::new(code, Path::new("this process"))
    }

    /// Asks a plugin for its description, and checks it.
    pub(crate) fn new(code: Box<dyn Code>, path: &Path) -> Result<Self> {
        let about = Self::ask(code.as_ref(), path)?;
        Self::known(code, about, path)
    }

    /// Plugin whose description is known, which is checked.
    pub(crate) fn known(code: Box<dyn Code>, about: About, path: &Path) -> Result<Self> {
        check_description(&about.descriptor).map_err(|what| refused(path, &what))?;
        let migration = about.migration.as_ref().map(|m| check_migration(&about.descriptor, m));
        migration.transpose().map_err(|what| refused(path, &what))?;
        Self::unchecked(code, about, path)
    }

    /// Asks a plugin for its description of itself.
    pub(crate) fn ask(code: &dyn Code, path: &Path) -> Result<About> {
        let descriptor = code.descriptor().map_err(|e| refused(path, &line(&e.message)))?;
        let migration = code.migration().map_err(|e| refused(path, &line(&e.message)))?;
        Ok(About { descriptor, capabilities: code.capabilities(), migration })
    }

    /// Plugin whose description is known, and is not checked: for those who look at it more closely.
    pub(crate) fn unchecked(code: Box<dyn Code>, about: About, path: &Path) -> Result<Self> {
        let About { descriptor, capabilities, migration } = about;
        let consumes = Consumes::from_inputs(&descriptor.inputs).map_err(|id| {
            let what = format!("{} needs the input `{id}`, which this program does not have", path.display());
            Error::plugin(what, "use a later version of the program, or an earlier one of the plugin")
        })?;
        Ok(Self {
            code,
            capabilities,
            migration,
            consumes,
            descriptor,
            path: path.to_owned(),
            shipped: false,
        })
    }

    /// The plugin with the mark whether it came with the program.
    pub(crate) fn shipped(self, shipped: bool) -> Self {
        Self { shipped, ..self }
    }

    /// Whether the plugin came with the program.
    pub fn is_shipped(&self) -> bool {
        self.shipped
    }

    /// Stable id, such as `warp`.
    pub fn id(&self) -> &str {
        &self.descriptor.id
    }

    /// The name that the user reads.
    pub fn name(&self) -> &str {
        &self.descriptor.name
    }

    /// The plugin's own version, `major.minor.patch`.
    pub fn version(&self) -> &str {
        &self.descriptor.version
    }

    /// Summary of what the plugin does, in one line.
    pub fn summary(&self) -> &str {
        &self.descriptor.summary
    }

    /// The publication that the plugin implements; may be empty.
    pub fn citation(&self) -> &str {
        &self.descriptor.citation
    }

    /// The plugin's author; may be empty.
    pub fn author(&self) -> &str {
        &self.descriptor.author
    }

    /// Address of more information on the plugin; may be empty.
    pub fn url(&self) -> &str {
        &self.descriptor.url
    }

    /// The parameters of the tool.
    pub fn params(&self) -> &[ParamDesc] {
        &self.descriptor.params
    }

    /// The inputs that the plugin uses.
    pub fn consumes(&self) -> Consumes {
        self.consumes
    }

    /// Abilities of the plugin besides deforming samples.
    pub fn capabilities(&self) -> Capabilities {
        self.capabilities
    }

    /// Version of the plugin's parameters and their meaning: 1 where the plugin declares none.
    pub fn state_version(&self) -> u32 {
        self.migration.as_ref().map_or(1, |m| m.state_version)
    }

    /// The plugin's description of its older sessions, if it has one.
    pub fn migration(&self) -> Option<&Migration> {
        self.migration.as_ref()
    }

    /// Whether the plugin runs in a process of its own.
    pub fn is_isolated(&self) -> bool {
        self.code.is_isolated()
    }

    /// The library's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Does the work that does not depend on the transforms.
    pub(crate) fn prepare(&self, input: &PrepareInput<'_>, watch: &PluginWatch<'_>) -> Result<State> {
        watch.begin_preparation("preparing the deformation");
        let before = self.fingerprint(&input.samples);
        let state = self.code.prepare(input, watch);
        self.check_unchanged(before.as_ref(), &input.samples, SampleChecks::All)?;
        watch.progress.check()?;
        state.map_err(|e| self.failed(&e))
    }

    /// Working memory for a sequence of deformations.
    pub(crate) fn new_scratch(&self) -> Result<Scratch> {
        self.code.new_scratch().map_err(|e| self.failed(&e))
    }

    /// Fills `out`, whose content is NaN so that unwritten positions stay visible, with the samples' deformed
    /// positions. On an error its content is meaningless. The caller [checks](Self::check_unchanged) that the
    /// samples are unchanged.
    pub(crate) fn deform(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        scratch: &mut Scratch,
        out: &mut [[f32; 3]],
        watch: &PluginWatch<'_>,
    ) -> Result<()> {
        watch.begin("deforming");
        let done = self.code.deform(state, input, scratch, out, watch);
        watch.progress.check()?;
        done.map_err(|e| self.failed(&e))?;
        // Without a branch for each number: there are three million of them in a picture of a drag.
        let are_usable = |part: &[[f32; 3]]| {
            part.as_flattened().iter().fold(true, |all, x| all & (x.abs() <= FARTHEST as f32))
        };
        if out.par_chunks(CHECKED_TOGETHER).all(are_usable) {
            return Ok(());
        }
        let bad = |p: &[f32; 3]| !is_usable(p.map(f64::from));
        let first = out.iter().position(bad).map(|i| (i, out[i].map(f64::from)));
        self.all_usable(out.len(), out.iter().filter(|p| bad(p)).count(), first)
    }

    /// Replaces the points by their images. On an error their content is meaningless.
    pub(crate) fn evaluate(
        &self,
        state: &State,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        watch: &PluginWatch<'_>,
    ) -> Result<()> {
        if !self.capabilities.evaluate {
            return Err(self.samples_only());
        }
        let done = self.code.evaluate(state, input, points, watch);
        watch.progress.check()?;
        done.map_err(|e| self.failed(&e))?;
        let bad = |p: &[f64; 3]| !is_usable(*p);
        let first = points.iter().position(bad).map(|i| (i, points[i]));
        self.all_usable(points.len(), points.iter().filter(|p| bad(p)).count(), first)
    }

    /// Error of a plugin that has no map of space.
    pub(crate) fn samples_only(&self) -> Error {
        Error::plugin(
            format!(
                "plugin {} deforms samples only, not any point of space, so the exact deformation is not known",
                self.id()
            ),
            "measure, or evaluate exactly, sessions of space deformations, as warp, lattice and rbf; or switch the step off",
        )
    }

    /// The handles that the plugin places for this input; none where it has no such.
    pub(crate) fn handles(&self, input: &PrepareInput<'_>, watch: &PluginWatch<'_>) -> Result<OwnHandles> {
        if !self.capabilities.handles {
            return Ok(OwnHandles::default());
        }
        let handles = self.code.handles(input, watch);
        watch.progress.check()?;
        let handles = handles.map_err(|e| self.failed(&e))?;
        check_handles(&handles).map_err(|what| {
            let what = format!("plugin {}: {what}", self.id());
            plugins_bug(what)
        })?;
        Ok(handles)
    }

    /// Whether the plugin would leave all samples where they are; false where it cannot tell.
    pub(crate) fn is_identity(&self, input: &DeformInput<'_>, watch: &PluginWatch<'_>) -> Result<bool> {
        if !self.capabilities.is_identity {
            return Ok(false);
        }
        let ready = self.code.get_ready(watch);
        watch.progress.check()?;
        ready.map_err(|e| self.failed(&e))?;
        self.code.is_identity(input).map_err(|e| self.failed(&e))
    }

    /// Settings that a step of an older session has to give now, under the ids of now; nobody has checked
    /// them yet.
    pub(crate) fn migrate(&self, from: u32, settings: Vec<Setting>) -> Result<Vec<Setting>> {
        self.code.migrate(from, settings).map_err(|e| self.failed(&e))
    }

    /// Fingerprint of the samples' arrays, about a millisecond for 350 000; none for a plugin in another
    /// process, which has a copy of them.
    pub(crate) fn fingerprint(&self, samples: &Samples<'_>) -> Option<Fingerprint> {
        (!self.is_isolated()).then(|| Fingerprint::new(samples))
    }

    /// Checks that a call has not changed the samples: later layers work on them too.
    ///
    /// # Errors
    /// The plugin has changed them.
    pub(crate) fn check_unchanged(
        &self,
        before: Option<&Fingerprint>,
        samples: &Samples<'_>,
        of: SampleChecks,
    ) -> Result<()> {
        if before.is_none_or(|before| before.fits(samples, of)) {
            return Ok(());
        }
        let what = format!("plugin {} changed the samples, which are not its own", self.id());
        Err(plugins_bug(what))
    }

    /// `bad` of `count` results cannot be used: `first` is the first one, and its index.
    fn all_usable(&self, count: usize, bad: usize, first: Option<(usize, [f64; 3])>) -> Result<()> {
        let Some((first, at)) = first else { return Ok(()) };
        let what = if at.iter().all(|x| x.is_finite()) {
            "are farther away than what follows can work with"
        } else {
            "are unwritten or not finite"
        };
        Err(Error::plugin(
            format!("plugin {}: {bad} of {count} positions {what}, the first at index {first}", self.id()),
            "try less extreme parameters; if that does not help, it is a bug of the plugin",
        ))
    }

    fn failed(&self, error: &PluginError) -> Error {
        if error.code == ErrorCode::CANCELLED {
            // The host did not ask for it, or it would have been told before.
            let what = format!("plugin {} stopped unasked", self.id());
            return plugins_bug(what);
        }
        let hint = if error.hint.trim().is_empty() {
            format!("`simod plugin info {}` describes what it needs", self.id())
        } else {
            line(&error.hint)
        };
        let what = format!("plugin {}: {}", self.id(), line(&error.message));
        let failed = Error::plugin(what, hint);
        // Mistakes against the C interface have any code, and the host's own advice.
        if error.code == ErrorCode::PANICKED || error.hint.as_str() == TELL_AUTHOR {
            failed.marked(ErrorMark::PluginBug)
        } else {
            failed
        }
    }
}

/// Hashes of the samples' arrays, each of all pages whose numbers leave the same remainder: checks that are
/// made again and again look at one part after the other.
#[derive(Debug, PartialEq)]
pub(crate) struct Fingerprint([u64; Self::PARTS]);

/// Part of the samples that is compared.
#[derive(Debug, Clone, Copy)]
pub(crate) enum SampleChecks {
    All,
    /// One of the parts of a fingerprint, which are taken in turn.
    Part(usize),
}

impl Fingerprint {
    const PARTS: usize = 16;
    /// Bytes.
    const PAGE: usize = 4096;

    fn new(samples: &Samples<'_>) -> Self {
        Self(std::array::from_fn(|part| Self::part(samples, part)))
    }

    fn part(samples: &Samples<'_>, part: usize) -> u64 {
        let mut hash = Xxh3Default::new();
        let [positions, normals] = [samples.positions(), samples.normals()].map(bytemuck::cast_slice);
        for array in [positions, normals, bytemuck::cast_slice(samples.spacing())] {
            let array: &[u8] = array;
            array.chunks(Self::PAGE).skip(part).step_by(Self::PARTS).for_each(|page| hash.update(page));
        }
        hash.digest()
    }

    fn fits(&self, samples: &Samples<'_>, of: SampleChecks) -> bool {
        match of {
            SampleChecks::All => *self == Self::new(samples),
            SampleChecks::Part(number) => {
                let part = number % Self::PARTS;
                self.0[part] == Self::part(samples, part)
            }
        }
    }
}

/// Access for checks of plugins, which is used for nothing else.
impl Plugin {
    /// The plugin's description of itself, and its abilities.
    pub(crate) fn about(&self) -> About {
        let migration = self.migration.clone();
        About { descriptor: self.descriptor.clone(), capabilities: self.capabilities, migration }
    }

    /// Description that the plugin gave of itself at load.
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }

    /// Calls of the plugin as it answers them, with error codes, and output of any kind: to measure and check
    /// them. Deformations for users go by a [`Stack`](crate::Stack), which checks the output.
    pub fn code(&self) -> &dyn Code {
        self.code.as_ref()
    }
}

/// The largest coordinate of a result, in local units, of which the model's diagonal is 1 to 2: far beyond
/// any use, and such that the steps that follow can square distances and multiply what they get in single
/// precision.
const FARTHEST: f64 = 1e9;

/// Results that a thread checks at once.
const CHECKED_TOGETHER: usize = 1 << 14;

/// Whether the steps that follow can work with a position in local coordinates: all coordinates are finite,
/// and none is beyond 1e9.
pub fn is_usable(p: [f64; 3]) -> bool {
    p.iter().all(|x| x.abs() <= FARTHEST)
}

/// Checks the handles that a plugin places; the error names the first defect.
pub fn check_handles(OwnHandles { descs, faces }: &OwnHandles) -> std::result::Result<(), String> {
    let mut ids = HashSet::new();
    for (i, handle) in descs.iter().enumerate() {
        if [&handle.id, &handle.name].iter().any(|text| text.len() >= limits::LONGEST_TEXT) {
            return Err(format!("the id or name of the handle `{}` is too long", line(&handle.id)));
        }
        if handle.id.is_empty() || handle.id.contains(|c: char| c.is_whitespace() || is_raw(c)) {
            return Err(format!("the id `{}` of a handle is empty, or has white space", line(&handle.id)));
        }
        if !ids.insert(handle.id.as_str()) {
            return Err(format!("there are two handles `{}`", line(&handle.id)));
        }
        if handle.position.iter().any(|x| !x.is_finite()) {
            return Err(format!("the handle `{}` is at {:?}", handle.id, handle.position));
        }
        if handle.parent != HandleDesc::ROOT && handle.parent as usize >= i {
            return Err(format!("the handle `{}` hangs on one that does not come before it", handle.id));
        }
    }
    for (i, corners) in faces.iter().enumerate() {
        if corners.len() < 3 {
            return Err(format!("the face {i} between its handles has {} corners", corners.len()));
        }
        if let Some(beyond) = corners.iter().find(|corner| **corner as usize >= descs.len()) {
            return Err(format!(
                "the face {i} has the corner {beyond}, and there are {} handles",
                descs.len()
            ));
        }
    }
    Ok(())
}

/// The dynamic linker refuses a library, and says why.
pub(crate) fn cannot_load(path: &Path, reason: &str) -> Error {
    // "/path/lib.so: fault": the path is added by the host.
    let file = path.display();
    let reason = reason.lines().next().unwrap_or_default();
    let reason = reason.strip_prefix(&format!("{file}: ")).unwrap_or(reason);
    let what = format!("cannot load {file}: {reason}");
    let hint = if reason.contains("undefined symbol") || reason.contains("symbol not found") {
        "link it with the library that has this symbol, or install that one"
    } else {
        "is it a library for this system, and complete?"
    };
    Error::plugin(what, hint)
}

/// Advice about a mistake of a plugin.
pub(crate) const TELL_AUTHOR: &str = "this is a bug of the plugin; tell its author";

/// A mistake of a plugin, which is named.
pub(crate) fn plugins_bug(what: impl Into<String>) -> Error {
    Error::plugin(what, TELL_AUTHOR).marked(ErrorMark::PluginBug)
}

fn refused(path: &Path, what: &str) -> Error {
    let what = format!("{}: {what}", path.display());
    plugins_bug(what)
}

/// A plugin's text on one line, of bounded length.
pub fn line(text: &str) -> String {
    const LONGEST: usize = 500;
    // A raw character, as one that a terminal obeys, separates words as white space does.
    let words = text.split(|c: char| c.is_whitespace() || is_raw(c)).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join(" ").chars().take(LONGEST).collect()
}

/// Host as one plugin sees it: passes progress and cancellation on, and collects the plugin's messages.
pub(crate) struct PluginWatch<'a> {
    progress: &'a dyn Progress,
    plugin: &'a str,
    /// Number of bytes that a fraction of 1 stands for.
    size: u64,
    /// Bytes told so far.
    told: AtomicU64,
    messages: Mutex<Vec<Message>>,
}

impl<'a> PluginWatch<'a> {
    /// Watches calls to one plugin on data of `size` bytes.
    pub(crate) fn new(progress: &'a dyn Progress, plugin: &'a str, size: u64) -> Self {
        Self { progress, plugin, size, told: AtomicU64::new(0), messages: Mutex::new(Vec::new()) }
    }

    fn begin(&self, stage: &'static str) {
        self.told.store(0, Ordering::Relaxed);
        self.progress.begin_parts(stage, self.size);
    }

    fn begin_preparation(&self, stage: &'static str) {
        self.told.store(0, Ordering::Relaxed);
        self.progress.begin_preparation(stage, self.size);
    }

    /// Messages of the plugin.
    pub(crate) fn into_messages(self) -> Vec<Message> {
        self.messages.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl HostCalls for PluginWatch<'_> {
    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        let part = |i| {
            if self.progress.is_cancelled() {
                return Err(());
            }
            let _kept = Care::Registers.enter();
            body(i);
            Ok(())
        };
        // A single part takes less time here than another thread takes to wake up.
        let work = if count == 1 { part(0) } else { (0..count).into_par_iter().try_for_each(part) };
        work.is_ok()
    }

    fn progress(&self, fraction: f64) -> bool {
        // NaN becomes 0; a fraction that went back is ignored.
        let bytes = (fraction.clamp(0.0, 1.0) * self.size as f64) as u64;
        let before = self.told.fetch_max(bytes, Ordering::Relaxed);
        if bytes > before {
            self.progress.advance(bytes - before);
        }
        !self.progress.is_cancelled()
    }

    fn log(&self, level: LogLevel, message: &str) {
        /// A plugin that never stops talking shall not fill the memory.
        const MOST: usize = 100;
        let mut messages = self.messages.lock().unwrap_or_else(PoisonError::into_inner);
        if messages.len() < MOST {
            messages.push(Message { plugin: self.plugin.to_owned(), level, text: line(message) });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Wherever something is written to, one of the parts tells, and all together.
    #[test]
    fn a_fingerprint_tells_in_parts_what_was_written_to() {
        let count = 70_001;
        let value = |i: usize| (i % 977 + 1) as f32;
        let mut positions: Vec<[f32; 3]> = (0..count).map(|i| [value(i), 1.0, -value(i)]).collect();
        let mut normals = vec![[0.0, 1.0, 0.0]; count];
        let mut spacing: Vec<f32> = (0..count).map(value).collect();
        let before = Fingerprint::new(&Samples::new(&positions, &normals, &spacing));
        let told = |positions: &[[f32; 3]], normals: &[[f32; 3]], spacing: &[f32]| {
            let samples = Samples::new(positions, normals, spacing);
            let tells = |part: &usize| !before.fits(&samples, SampleChecks::Part(*part));
            let parts = (0..Fingerprint::PARTS).filter(tells).count();
            assert_eq!(before.fits(&samples, SampleChecks::All), parts == 0);
            parts
        };
        assert_eq!(told(&positions, &normals, &spacing), 0);
        for i in [0, 1, 5000, 33_333, count - 1] {
            positions[i][2] += 1.0;
            assert_eq!(told(&positions, &normals, &spacing), 1, "{i}");
            positions[i][2] -= 1.0;
            normals[i][0] = 1e-9;
            assert_eq!(told(&positions, &normals, &spacing), 1, "{i}");
            normals[i][0] = 0.0;
            spacing[i] += 1.0;
            assert_eq!(told(&positions, &normals, &spacing), 1, "{i}");
            spacing[i] -= 1.0;
        }
        // A change of all the positions is seen at once, whichever part is looked at.
        positions.iter_mut().for_each(|p| p[0] += 1.0);
        assert_eq!(told(&positions, &normals, &spacing), Fingerprint::PARTS);
    }
}
