//! Output of a rewritten model: a file, or a folder with a file for each tile, which can be gone on with; or
//! an object.

use std::path::{Path, PathBuf};

use crate::object::is_object;
use crate::object_output::ObjectOutput;
use crate::resumable::{Finished, Opened, ResumableFile, bytes_there, is_left};
use crate::resumable_folder::{
    FinishedFolder, OpenedFolder, ResumableFolder, bytes_in_folder, check_target, is_folder_left,
};
use crate::target::{canonical_folder, canonical_target};
use crate::{Error, Model, Output, Progress, Result};

/// The output of a model, in the making.
pub enum ResumableOutput {
    /// The output of a model in one file.
    File(Box<ResumableFile>),
    /// The output of a model that is made of several files.
    Folder(Box<ResumableFolder>),
    /// The output of a model in one file, in a store.
    Object(Box<ObjectOutput>),
}

/// Result of [`ResumableOutput::open`].
pub enum OpenedOutput {
    /// The output has still to be written, as a whole or in part.
    Unfinished(ResumableOutput),
    /// The output is complete: an earlier call wrote all of it, and it stands in its place.
    Finished(FinishedOutput),
}

/// Path of an output, and the names of its files if it is a folder.
#[derive(Debug, Clone)]
pub struct OutputPaths {
    path: PathBuf,
    names: Vec<PathBuf>,
    /// The output's size in bytes, about.
    bytes: u64,
}

impl OutputPaths {
    /// Paths of a model's output: a file, or a folder of tiles.
    pub fn for_model(model: &dyn Model, path: &Path) -> Self {
        let names = model.tiles().iter().map(|tile| tile.name.clone()).collect();
        Self { path: path.to_owned(), names, bytes: model.written_bytes() }
    }

    /// Path of the output by the one name that all paths to it share.
    ///
    /// # Errors
    /// The output cannot be written, or holds what would be lost.
    pub fn checked(&self) -> Result<PathBuf> {
        if self.names.is_empty() {
            return canonical_target(&self.path);
        }
        check_target(&self.path, &self.names)?;
        canonical_folder(&self.path)
    }

    /// Bytes of the output that the disk holds already.
    pub fn bytes_there(&self, resume: bool) -> u64 {
        if self.names.is_empty() {
            bytes_there(&self.path, resume)
        } else {
            bytes_in_folder(&self.path, &self.names, resume)
        }
    }

    /// Whether an earlier call left something of the output.
    pub fn is_left(&self) -> bool {
        if self.names.is_empty() { is_left(&self.path) } else { is_folder_left(&self.path, &self.names) }
    }

    /// Paths of the output's files.
    pub fn files(&self) -> Vec<PathBuf> {
        if self.names.is_empty() {
            return vec![self.path.clone()];
        }
        self.names.iter().map(|name| self.path.join(name)).collect()
    }
}

impl ResumableOutput {
    /// Begins an output whose bytes `key` determines: see [`ResumableFile::open`].
    ///
    /// # Errors
    /// As of [`ResumableFile::open`]; an object cannot be gone on with.
    pub fn open(
        place: &OutputPaths,
        key: String,
        resume: bool,
        part_bytes: u64,
        progress: &dyn Progress,
    ) -> Result<OpenedOutput> {
        let OutputPaths { path, names, bytes } = place;
        if is_object(path) && names.is_empty() {
            if resume {
                return Err(Error::argument(
                    format!("{} is an object, whose beginning cannot be gone on with", path.display()),
                    "leave out --resume, or write to a file",
                ));
            }
            return Ok(OpenedOutput::Unfinished(Self::Object(Box::new(ObjectOutput::begin(path, *bytes)?))));
        }
        if names.is_empty() {
            return Ok(match ResumableFile::open(path, key, resume, part_bytes, progress)? {
                Opened::Unfinished(file) => OpenedOutput::Unfinished(Self::File(file)),
                Opened::Finished(file) => OpenedOutput::Finished(FinishedOutput::File(file)),
            });
        }
        Ok(match ResumableFolder::open(path, names, key, resume, part_bytes, progress)? {
            OpenedFolder::Unfinished(folder) => OpenedOutput::Unfinished(Self::Folder(folder)),
            OpenedFolder::Finished(folder) => OpenedOutput::Finished(FinishedOutput::Folder(folder)),
        })
    }

    /// Leaves it to the caller to bring the complete output to the disk, or not to, where the output is
    /// removed soon. A store keeps an object in any case.
    pub fn leave_syncing(&mut self) {
        match self {
            Self::File(file) => file.leave_syncing(),
            Self::Folder(folder) => folder.leave_syncing(),
            Self::Object(_) => {}
        }
    }

    /// Numbers of files, and of pieces of the file after them, behind which work can be gone on with:
    /// ascending.
    pub fn boundaries(&self) -> Vec<(u64, u64)> {
        match self {
            Self::File(file) => file.boundaries().map(|pieces| (0, pieces)).collect(),
            Self::Folder(folder) => folder.boundaries(),
            Self::Object(_) => Vec::new(),
        }
    }

    /// Goes on behind one of these [boundaries](Self::boundaries): see [`ResumableFile::go_on_after`].
    ///
    /// # Errors
    /// As of [`ResumableFile::go_on_after`].
    pub fn go_on_after(&mut self, done: (u64, u64)) -> Result<u64> {
        match self {
            Self::File(file) => file.go_on_after(done.1),
            Self::Folder(folder) => folder.go_on_after(done),
            Self::Object(_) => Ok(0),
        }
    }

    /// The output as a trait object, for a rewriting to write to.
    pub fn as_output(&mut self) -> &mut dyn Output {
        match self {
            Self::File(file) => &mut **file,
            Self::Folder(folder) => &mut **folder,
            Self::Object(object) => &mut **object,
        }
    }

    /// Ends the output: see [`ResumableFile::complete`].
    ///
    /// # Errors
    /// As of [`ResumableFile::complete`].
    pub fn complete(&mut self, one_of_several: bool) -> Result<()> {
        match self {
            Self::File(file) => file.complete(one_of_several),
            Self::Folder(folder) => folder.complete(),
            Self::Object(object) => object.complete(),
        }
    }

    /// Puts the complete output in its place.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn commit(&mut self) -> Result<FinishedOutput> {
        match self {
            Self::File(file) => file.commit().map(FinishedOutput::File),
            Self::Folder(folder) => folder.commit().map(FinishedOutput::Folder),
            Self::Object(object) => object.commit().map(FinishedOutput::Object),
        }
    }

    /// Leaves the recorded parts to a later call, if there are any.
    pub fn keep(self) {
        match self {
            Self::File(file) => file.keep(),
            Self::Folder(folder) => folder.keep(),
            Self::Object(_) => {}
        }
    }
}

/// Output that stands in its place; the journals by which a later call would know it are removed with this.
pub enum FinishedOutput {
    /// A file.
    File(Finished),
    /// A folder of tiles.
    Folder(FinishedFolder),
    /// An object of so many bytes.
    Object(u64),
}

impl FinishedOutput {
    /// The output's size in bytes.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::File(file) => file.bytes(),
            Self::Folder(folder) => folder.bytes(),
            Self::Object(bytes) => *bytes,
        }
    }

    /// Hash of the output's bytes, if it is a file whose hash is known without reading it: see
    /// [`Finished::hash`].
    pub fn hash(&self) -> Option<u128> {
        match self {
            Self::File(file) => file.hash(),
            Self::Folder(_) | Self::Object(_) => None,
        }
    }

    /// Keeps the journals, by which a later call, which does the rest, knows the output.
    pub fn keep(self) {
        match self {
            Self::File(file) => file.keep(),
            Self::Folder(folder) => folder.keep(),
            Self::Object(_) => {}
        }
    }
}
