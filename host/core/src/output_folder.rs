//! Folders that appear whole or not at all.

use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::output::{exchange, folder_of, sync_folder};
use crate::{Error, Result};

/// A folder in the making: a hidden one beside its place, which takes its name when it is complete. Dropped before
/// [`commit`](Self::commit), it leaves no trace.
#[derive(Debug)]
pub struct OutputFolder {
    new: TempDir,
    target: PathBuf,
}

impl OutputFolder {
    /// Begins the folder `target`. What may be there already, and be replaced, is for the caller to check.
    ///
    /// # Errors
    /// The folder that it is to lie in is missing, or cannot be written to.
    pub fn create(target: &Path) -> Result<Self> {
        let new = tempfile::Builder::new()
            .prefix(".simod-")
            .tempdir_in(folder_of(target))
            .map_err(|e| Error::io("write", target, &e))?;
        Ok(Self { new, target: target.to_owned() })
    }

    /// Where its files are written for now.
    pub fn path(&self) -> &Path {
        self.new.path()
    }

    /// An error of a file in it, told of the folder that was asked for and not of its temporary name.
    pub fn named(&self, e: &Error) -> Error {
        let told = |text: &str| text.replace(&*self.path().to_string_lossy(), &self.target.to_string_lossy());
        Error::new(e.kind(), told(&e.to_string()), told(e.hint()))
    }

    /// Puts the folder in its place. What is there goes away: in one step where the system can.
    ///
    /// # Errors
    /// The operating system refuses; the place is then as it was.
    pub fn commit(self) -> Result<()> {
        let Self { new, target } = self;
        let io = |e: std::io::Error| Error::io("write", &target, &e);
        let parent = folder_of(&target);
        set_permissions(new.path()).map_err(io)?;
        if target.symlink_metadata().is_err() {
            std::fs::rename(new.path(), &target).map_err(io)?;
        } else if exchange(new.path(), &target).map_err(io)? {
            // What was there goes with the temporary folder.
            return sync_folder(parent).map_err(io);
        } else {
            let old = tempfile::Builder::new().prefix(".simod-old-").tempdir_in(parent).map_err(io)?;
            std::fs::rename(&target, old.path().join("old")).map_err(io)?;
            if let Err(e) = std::fs::rename(new.path(), &target) {
                // Back as it was; if even that fails, it stays where it is.
                let old = old.keep();
                std::fs::rename(old.join("old"), &target).map_err(io)?;
                let _ = std::fs::remove_dir(old);
                return Err(io(e));
            }
        }
        // Moved away: there is nothing to remove under the temporary name.
        let _ = new.keep();
        sync_folder(parent).map_err(io)
    }
}

/// Temporary folders are private; a result has the permissions of any other new folder.
fn set_permissions(folder: &Path) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // What mkdir would give under the present umask, which can only be read by making something.
        let probe = folder.join(".mode");
        std::fs::create_dir(&probe)?;
        let mode = std::fs::metadata(&probe)?.permissions().mode();
        std::fs::remove_dir(&probe)?;
        std::fs::set_permissions(folder, std::fs::Permissions::from_mode(mode))?;
    }
    let _ = folder;
    Ok(())
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
        let told = folder.named(&error).to_string();
        assert!(told.contains("/result/no/file") && !told.contains(".simod-"), "{told}");
    }
}
