//! Rules of what a command may write over. An output never replaces a file that the command reads, by
//! whatever name; nor a file of a sampled model, which makes no sense without the others; nor a file of
//! another kind than is written, unless that is asked for.

use std::ffi::OsStr;
use std::io::Read;
use std::path::{Path, PathBuf};

use simod_model::input::{self, Identity};
use simod_model::object::{self, is_object};
use simod_model::resumable_folder::check_target;
use simod_model::target::{canonical_target, folder_of};
use simod_model::{Error, Result, matching};

use crate::sampled_model::{OWN_FILES, SampledModel};

/// The kind of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputKind {
    /// A model, or samples, of a format that can be read.
    Model,
    /// A picture, as PNG.
    Picture,
    /// A session.
    Session,
    /// The file that [`bind`](crate::reconstruction::bind) adds to a sampled model.
    Binding,
}

impl OutputKind {
    /// The kind's name in messages.
    fn name(self) -> &'static str {
        match self {
            Self::Model => "model",
            Self::Picture => "PNG file",
            Self::Session => "session",
            Self::Binding => "binding",
        }
    }

    /// Whether there is no file of another kind at the path.
    fn may_replace(self, path: &Path) -> Result<bool> {
        match self {
            Self::Model if is_object(path) => match object::find(path)? {
                Some(object) => Ok(object.bytes() == 0 || simod_model::is_model(path)?),
                None => Ok(true),
            },
            _ => Ok(!path.exists() || self.is_of(path)?),
        }
    }

    /// Whether the file at the path is of this kind, or is empty, so that nothing is lost.
    fn is_of(self, path: &Path) -> Result<bool> {
        /// Size that no session file exceeds, in bytes.
        const LONGEST: u64 = 16 << 20;
        let mut start = Vec::new();
        let failed = |e: std::io::Error| Error::io("read", path, &e);
        input::open(path)?.take(8).read_to_end(&mut start).map_err(failed)?;
        Ok(start.is_empty()
            || match self {
                Self::Model => simod_model::is_model(path)?,
                Self::Picture => start == b"\x89PNG\r\n\x1a\n",
                Self::Binding => start == crate::reconstruction::BINDING_MAGIC,
                Self::Session => {
                    let known = ["version", "model", "sampling", "time", "step", "output"];
                    let table =
                        input::read_text(path, LONGEST).ok().and_then(|t| t.parse::<toml::Table>().ok());
                    table.is_some_and(|table| table.keys().all(|key| known.contains(&key.as_str())))
                }
            })
    }
}

/// Record of the files that a command reads, which says what the command may write. It is asked before any
/// work is done.
#[derive(Debug, Default)]
pub struct Guard {
    inputs: Vec<(PathBuf, Identity)>,
    outputs: Vec<PathBuf>,
    force: bool,
}

impl Guard {
    /// The guard of a command that has read nothing so far. `force` says that files of another kind may be
    /// replaced.
    pub fn new(force: bool) -> Self {
        Self { force, ..Self::default() }
    }

    /// Records that the command reads this file, or this folder with the files of a sampled model in it.
    /// There need not be one: that is told when it is read.
    pub fn reads(&mut self, path: &Path) {
        // A pattern that is wrong, or matches no file, is told when the model is read.
        if let Ok(Some(files)) = matching(path) {
            return self.reads_all(files);
        }
        if let Some(identity) = Identity::from_path(path) {
            self.inputs.push((path.to_owned(), identity));
        }
        if path.is_dir() {
            let files = OWN_FILES.iter().map(|name| path.join(name));
            self.inputs.extend(files.filter_map(|file| Some((file.clone(), Identity::from_path(&file)?))));
        }
    }

    /// Records several paths as [`reads`](Self::reads) does one.
    pub fn reads_all<P: AsRef<Path>>(&mut self, paths: impl IntoIterator<Item = P>) {
        paths.into_iter().for_each(|path| self.reads(path.as_ref()));
    }

    /// An error if the command may not write this file.
    ///
    /// # Errors
    /// The file cannot be written; it is an input of the command, another of its outputs, or a file of a
    /// sampled model; or it is there, of another kind, and may not be replaced.
    pub fn writes(&mut self, path: &Path, kind: OutputKind) -> Result<()> {
        let target = canonical_target(path)?;
        if kind == OutputKind::Model && is_object(&target) {
            object::check_output(&target)?;
        }
        let refused = |what: String, hint: &str| Err(Error::argument(what, hint));
        if let Some((input, _)) = self.input_at(&target) {
            let what = if canonical_target(input).is_ok_and(|input| input == target) && !path.is_symlink() {
                format!("{} is read by this command, and would be overwritten", path.display())
            } else {
                format!(
                    "{} is {}, which this command reads: it would be overwritten",
                    path.display(),
                    input.display()
                )
            };
            return refused(what, "write to another file");
        }
        let is_own = target.file_name().is_some_and(is_own) && SampledModel::is_at(folder_of(&target));
        if is_own && kind != OutputKind::Binding {
            let what =
                format!("{} is a file of the sampled model {}", path.display(), folder_of(path).display());
            return refused(what, "write to a file outside that folder");
        }
        if self.outputs.contains(&target) {
            return refused(
                format!("two files go to {}", path.display()),
                "give each of them a name of its own",
            );
        }
        // A binding that is damaged is one all the same.
        if !self.force && !is_own && !kind.may_replace(&target)? {
            let what = format!("{} is there, and is no {}", path.display(), kind.name());
            return refused(what, "write to another file, or give --force to replace it");
        }
        self.outputs.push(target);
        Ok(())
    }

    /// An error if the command may not write a model: a file, or a folder with files of these names, if there
    /// are any.
    ///
    /// # Errors
    /// As of [`writes`](Self::writes) and [`replaces_folder`](Self::replaces_folder); the folder holds
    /// something else.
    pub fn writes_model(&mut self, path: &Path, tiles: &[PathBuf]) -> Result<()> {
        if tiles.is_empty() {
            return self.writes(path, OutputKind::Model);
        }
        check_target(path, tiles)?;
        self.replaces_folder(path)?;
        tiles
            .iter()
            .map(|name| path.join(name))
            .filter(|file| file.exists())
            .try_for_each(|file| self.writes(&file, OutputKind::Model))
    }

    /// An error if a folder may not be replaced, as an input of the command lies in it.
    ///
    /// # Errors
    /// An input of the command lies in the folder.
    pub fn replaces_folder(&self, folder: &Path) -> Result<()> {
        let (Ok(place), Some(identity)) = (folder.canonicalize(), Identity::from_path(folder)) else {
            return Ok(());
        };
        let is_within = |(input, known): &&(PathBuf, Identity)| {
            *known == identity || input.canonicalize().is_ok_and(|input| input.starts_with(&place))
        };
        match self.inputs.iter().find(is_within) {
            Some((input, _)) => Err(Error::argument(
                format!("{} holds {}, which this command reads", folder.display(), input.display()),
                "write to another folder",
            )),
            None => Ok(()),
        }
    }

    /// The input that a file is.
    fn input_at(&self, target: &Path) -> Option<&(PathBuf, Identity)> {
        let identity = Identity::from_path(target)?;
        self.inputs.iter().find(|(_, known)| *known == identity)
    }
}

fn is_own(name: &OsStr) -> bool {
    OWN_FILES.iter().any(|own| name == *own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::output::write_file;

    #[test]
    fn inputs_are_known_by_any_name_and_kinds_by_their_content() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for (name, content) in [
            ("a.ply", "ply\n"),
            ("b.ply", "ply\r\nx"),
            ("empty", ""),
            ("letter", "dear"),
            ("edit.toml", "[model]\npath = 'a'"),
            ("Cargo.toml", "[package]"),
        ] {
            write_file(&at(name), content.as_bytes()).unwrap();
        }
        std::fs::hard_link(at("a.ply"), at("hard")).unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink("a.ply", at("soft")).unwrap();
        #[cfg(not(unix))]
        std::fs::hard_link(at("a.ply"), at("soft")).unwrap();
        for force in [false, true] {
            let mut guard = Guard::new(force);
            guard.reads_all([at("a.ply"), at("missing")]);
            for name in ["a.ply", "./a.ply", "hard", "soft"] {
                let error = guard.writes(&at(name), OutputKind::Model).unwrap_err().to_string();
                assert!(error.contains("a.ply") && error.contains("command"), "{error}");
            }
            let refused = guard.replaces_folder(folder.path()).unwrap_err().to_string();
            assert!(refused.contains("a.ply"), "{refused}");
            guard.replaces_folder(&at("elsewhere")).unwrap();
            guard.writes(&at("b.ply"), OutputKind::Model).unwrap();
            assert!(
                guard.writes(&at("b.ply"), OutputKind::Model).unwrap_err().to_string().contains("two files")
            );
            guard.writes(&at("empty"), OutputKind::Picture).unwrap();
            guard.writes(&at("new"), OutputKind::Picture).unwrap();
            guard.writes(&at("edit.toml"), OutputKind::Session).unwrap();
            for (name, kind) in [("letter", OutputKind::Model), ("Cargo.toml", OutputKind::Session)] {
                let allowed = guard.writes(&at(name), kind);
                assert_eq!(allowed.is_ok(), force, "{allowed:?}");
            }
        }
    }

    #[test]
    fn files_of_a_sampled_model_are_not_written_alone() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("samples.ply");
        write_file(&own, b"ply\n").unwrap();
        Guard::new(false).writes(&own, OutputKind::Model).unwrap();
        write_file(&folder.path().join("simod.toml"), b"format = \"simod-sampled-model/1\"\n").unwrap();
        let error = Guard::new(true).writes(&own, OutputKind::Model).unwrap_err().to_string();
        assert!(error.contains("a file of the sampled model"), "{error}");
        Guard::new(false).writes(&folder.path().join("other.ply"), OutputKind::Model).unwrap();
    }
}
