//! The pictures of a moving camera: a folder of numbered PNG files, which appears whole or not at all.

use std::path::{Path, PathBuf};

use simod_model::output::write_file;
use simod_model::output_folder::OutputFolder;
use simod_model::{Error, Result};

use super::Image;

/// A folder of `frame-0001.png` and so on, in the making. Dropped before [`commit`](Self::commit), it leaves
/// no trace.
#[derive(Debug)]
pub struct FrameFolder {
    folder: OutputFolder,
    target: PathBuf,
    count: u32,
}

impl FrameFolder {
    /// Most frames, as their names have four digits.
    pub const MOST: u32 = 9999;

    /// Begins the folder `target`. A former one of frames is replaced in the end, or an empty one.
    ///
    /// # Errors
    /// Something else is there, or the folder that it is to lie in is missing or cannot be written to.
    pub fn create(target: &Path) -> Result<Self> {
        check(target)?;
        Ok(Self { folder: OutputFolder::create(target)?, target: target.to_owned(), count: 0 })
    }

    /// Writes the next frame.
    ///
    /// # Errors
    /// The frame cannot be written, or there are too many.
    pub fn push(&mut self, image: &Image) -> Result<()> {
        self.push_png(&image.to_png()?)
    }

    /// Writes the next frame, which is the content of a PNG file already.
    ///
    /// # Errors
    /// The frame cannot be written, or there are too many.
    pub fn push_png(&mut self, png: &[u8]) -> Result<()> {
        if self.count == Self::MOST {
            let what = format!("there are more than {} frames", Self::MOST);
            return Err(Error::argument(what, "make fewer"));
        }
        self.count += 1;
        let path = self.folder.path().join(format!("frame-{:04}.png", self.count));
        write_file(&path, png).map_err(|e| self.folder.named(e))
    }

    /// Puts the folder in its place.
    ///
    /// # Errors
    /// Something else is there by now, or the operating system refuses; the place is then as it was.
    pub fn commit(self) -> Result<()> {
        check(&self.target)?;
        self.folder.commit()
    }
}

/// Checks that nothing is at a place that would be lost.
fn check(target: &Path) -> Result<()> {
    let Ok(meta) = target.symlink_metadata() else { return Ok(()) };
    let refused = |what: String| {
        let hint = "give the name of a new folder, or of one of frames to replace";
        Err(Error::argument(format!("{} {what}", target.display()), hint))
    };
    if !meta.is_dir() {
        return refused("exists and is no folder".to_owned());
    }
    for entry in std::fs::read_dir(target).map_err(|e| Error::io("read", target, &e))? {
        let name = entry.map_err(|e| Error::io("read", target, &e))?.file_name();
        if !name.to_str().is_some_and(is_frame) {
            return refused(format!("holds {}, which is no frame", name.display()));
        }
    }
    Ok(())
}

fn is_frame(name: &str) -> bool {
    let number = name.strip_prefix("frame-").and_then(|rest| rest.strip_suffix(".png"));
    number.is_some_and(|digits| digits.len() == 4 && digits.bytes().all(|b| b.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The files of a folder.
    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn frames_appear_together_and_replace_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let target = place.path().join("turn");
        let image = Image::new(2, 2, [0; 3]);
        let begun = |frames: usize| {
            let mut folder = FrameFolder::create(&target).unwrap();
            (0..frames).for_each(|_| folder.push(&image).unwrap());
            folder
        };
        drop(begun(3));
        assert!(names(place.path()).is_empty());
        begun(3).commit().unwrap();
        begun(2).commit().unwrap();
        assert_eq!(names(&target), ["frame-0001.png", "frame-0002.png"]);
        let late = begun(1);
        write_file(&target.join("frame-1.png"), b"").unwrap();
        assert!(late.commit().unwrap_err().to_string().contains("frame-1.png, which is no frame"));
        assert!(FrameFolder::create(&target).is_err());
        assert_eq!(names(&target).len(), 3);
        assert_eq!(names(place.path()), ["turn"]);
        let file = target.join("frame-0001.png");
        assert!(FrameFolder::create(&file).unwrap_err().to_string().contains("is no folder"));
    }
}
