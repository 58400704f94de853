//! Folders that appear whole or not at all.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use crate::claim::{Claim, remove, take_permissions};
use crate::output::{exchange, sync_folder};
use crate::target::folder_of;
use crate::{Error, Result};

/// A folder in the making: a hidden one beside its place, which takes its name when it is complete. Dropped
/// before [`commit`](Self::commit), it leaves no trace. As long as it is there, no other process writes a
/// folder of this name.
#[derive(Debug)]
pub struct OutputFolder {
    claim: Claim,
    target: PathBuf,
}

impl OutputFolder {
    /// Begins the folder `target`. What may be there already, and be replaced, is for the caller to check.
    ///
    /// # Errors
    /// The folder that it is to lie in is missing, or cannot be written to; another process writes it.
    pub fn create(target: &Path) -> Result<Self> {
        Self::create_or_go_on(target, false)
    }

    /// Begins the folder `target`; with `resume`, the files that an earlier call [kept](Self::keep) are
    /// there.
    ///
    /// # Errors
    /// As of [`create`](Self::create).
    pub(crate) fn create_or_go_on(target: &Path, resume: bool) -> Result<Self> {
        let claim = if resume { Claim::folder_again(target)? } else { Claim::folder(target)? };
        if claim.new_folder().symlink_metadata().is_ok_and(|is| is.is_dir()) {
            return Ok(Self { claim, target: target.to_owned() });
        }
        let mut builder = fs::DirBuilder::new();
        #[cfg(unix)]
        {
            use std::os::unix::fs::DirBuilderExt;
            // Files in the making can be seen only by those who may see the finished ones.
            builder.mode(if target.exists() { 0o700 } else { 0o777 });
        }
        builder.create(claim.new_folder()).map_err(|e| claim.failed(&e))?;
        Ok(Self { claim, target: target.to_owned() })
    }

    /// Leaves the folder in the making to a later call that goes on with it.
    pub(crate) fn keep(mut self) {
        self.claim.keep();
    }

    /// Path of the hidden folder in which the files of `target` are written as long as it is in the making.
    pub(crate) fn in_the_making(target: &Path) -> PathBuf {
        crate::claim::new_folder_of(target)
    }

    /// Path at which the folder's files are written for now.
    pub fn path(&self) -> &Path {
        self.claim.new_folder()
    }

    /// The path of the folder once it is whole.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Error of a file in the folder, told of the folder that was asked for and not of its temporary name.
    pub fn named(&self, e: Error) -> Error {
        let told = |text: &str| text.replace(&*self.path().to_string_lossy(), &self.target.to_string_lossy());
        let (what, hint) = (told(&e.to_string()), told(e.hint()));
        e.saying(what).hinting(hint)
    }

    /// Puts the folder in its place. A former folder goes away, in one step where the system can; the folder,
    /// and its files that replace others, have the permissions and the owners of those.
    ///
    /// # Errors
    /// The operating system refuses; the place is then as it was.
    pub fn commit(self) -> Result<()> {
        self.put_in_place()
    }

    /// Puts the folder in its place, as [`commit`](Self::commit) does; dropped after that, it removes
    /// nothing.
    pub(crate) fn put_in_place(&self) -> Result<()> {
        self.replace_by(self.path()).map_err(|e| self.claim.failed(&e))
    }

    /// Puts another folder in the place; `false` if that is on another disk.
    pub(crate) fn put_other_in_place(&self, other: &Path) -> Result<bool> {
        match self.replace_by(other) {
            Ok(()) => Ok(true),
            Err(e) if e.kind() == io::ErrorKind::CrossesDevices => Ok(false),
            Err(e) => Err(self.claim.failed(&e)),
        }
    }

    fn replace_by(&self, new: &Path) -> io::Result<()> {
        let places = self.claim.places();
        let (target, parent) = (&places.target, folder_of(&places.target));
        if target.symlink_metadata().is_err() {
            fs::rename(new, target)?;
            return sync_folder(parent);
        }
        for entry in fs::read_dir(new)? {
            let file = entry?.path();
            let former = target.join(file.file_name().unwrap_or_default());
            if former.symlink_metadata().is_ok_and(|is| is.is_file()) {
                take_permissions(&File::open(&file)?, &former)?;
            }
        }
        #[cfg(unix)]
        take_permissions(&File::open(new)?, target)?;
        if exchange(new, target)? {
            // The former folder has the temporary name now; files that cannot be removed there hurt nobody.
            let _ = remove(new);
            return sync_folder(parent);
        }
        fs::rename(target, &places.old_folder)?;
        if let Err(e) = fs::rename(new, target) {
            // Back as it was; if even that fails, the next call does it.
            fs::rename(&places.old_folder, target)?;
            return Err(e);
        }
        sync_folder(parent)?;
        remove(&places.old_folder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::tests::names;
    use crate::output::write_file;

    #[test]
    fn a_folder_appears_when_committed_and_replaces_the_former_one() {
        let place = tempfile::tempdir().unwrap();
        let target = place.path().join("result");
        let begin = |name: &str| {
            let folder = OutputFolder::create(&target).unwrap();
            write_file(&folder.path().join(name), b"1").unwrap();
            folder
        };
        drop(begin("a"));
        assert!(names(place.path()).is_empty());
        begin("a").commit().unwrap();
        begin("b").commit().unwrap();
        assert_eq!(names(&target), ["b"]);
        assert_eq!(names(place.path()), ["result"]);
        let error = OutputFolder::create(&place.path().join("missing/result")).unwrap_err();
        assert!(error.to_string().contains("missing/result"), "{error}");
    }

    #[test]
    fn errors_speak_of_the_folder_that_was_asked_for() {
        let place = tempfile::tempdir().unwrap();
        let folder = OutputFolder::create(&place.path().join("result")).unwrap();
        let error = write_file(&folder.path().join("no/file"), b"").unwrap_err();
        let told = folder.named(error).to_string();
        assert!(told.contains("/result/no/file") && !told.contains(".simod-"), "{told}");
    }
}
