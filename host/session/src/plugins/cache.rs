//! Descriptions that libraries gave of themselves when they were looked at last, so that they need not be
//! loaded to be listed.
//!
//! A file in the user's cache folder, by the libraries' paths and stamps. It may be missing, or broken, or
//! not writable: then the libraries are asked again.

use crate::deformer::About;
use serde::{Deserialize, Serialize};
use simod_model::{input, output};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Number that changes whenever the content of the cache gets another form or meaning.
const FORM: u32 = 2;

/// Most bytes of a cache.
const LONGEST: u64 = 64 << 20;

/// Stamp of a file, by which one state of the file is told from another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct LibraryStamp {
    len: u64,
    /// Nanoseconds since 1970.
    modified: u64,
    inode: u64,
}

impl LibraryStamp {
    /// Stamp of a file, if it can be read.
    pub fn from_path(path: &Path) -> Option<Self> {
        let meta = path.metadata().ok()?;
        let modified = meta.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        let modified = u64::try_from(modified.as_nanos()).ok()?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&meta);
        #[cfg(not(unix))]
        let inode = 0;
        Some(Self { len: meta.len(), modified, inode })
    }
}

#[derive(Serialize, Deserialize)]
struct LibraryEntry {
    stamp: LibraryStamp,
    about: About,
}

#[derive(Serialize, Deserialize)]
struct CacheFile {
    form: u32,
    /// Versions of this program and of its interface.
    versions: [String; 2],
    libraries: BTreeMap<PathBuf, LibraryEntry>,
}

/// The cache; kept on the disk by [`save`](Self::save).
pub(super) struct LibraryCache {
    file: Option<PathBuf>,
    content: CacheFile,
    changed: bool,
}

impl LibraryCache {
    /// Reads the cache from a file, or begins an empty one.
    pub fn load(file: Option<PathBuf>) -> Self {
        let versions = [env!("CARGO_PKG_VERSION"), super::load::interface()].map(str::to_owned);
        let read = |file: &PathBuf| -> Option<CacheFile> {
            let content: CacheFile = serde_json::from_slice(&input::read(file, LONGEST).ok()?).ok()?;
            (content.form == FORM && content.versions == versions).then_some(content)
        };
        let content = file.as_ref().and_then(read);
        let empty = || CacheFile { form: FORM, versions: versions.clone(), libraries: BTreeMap::new() };
        Self { content: content.unwrap_or_else(empty), changed: false, file }
    }

    /// Returns the description that a library gave, if its file is as it was then.
    pub fn get(&self, path: &Path, stamp: LibraryStamp) -> Option<About> {
        let entry = self.content.libraries.get(path)?;
        (entry.stamp == stamp).then(|| entry.about.clone())
    }

    /// Remembers the description of a library.
    pub fn put(&mut self, path: &Path, stamp: LibraryStamp, about: About) {
        self.content.libraries.insert(path.to_owned(), LibraryEntry { stamp, about });
        self.changed = true;
    }

    /// Writes the cache, without the libraries that are gone. Where that does not work, the next one does the
    /// same again.
    pub fn save(mut self) {
        let Some(file) = self.file.filter(|_| self.changed) else { return };
        self.content.libraries.retain(|path, _| path.exists());
        let folder = file.parent().unwrap_or(Path::new(""));
        if let (Ok(()), Ok(bytes)) = (std::fs::create_dir_all(folder), serde_json::to_vec(&self.content)) {
            let _ = output::write_file(&file, &bytes);
        }
    }
}

/// Standard path of the cache, in the user's cache folder.
pub(super) fn standard_file() -> Option<PathBuf> {
    let cache = super::folders::users_folder("LOCALAPPDATA", "Library/Caches", "XDG_CACHE_HOME", ".cache");
    cache.map(|cache| cache.join("simod").join("plugins.json"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deformer::Capabilities;
    use simod_plugin_api::Descriptor;

    #[test]
    fn what_changed_is_asked_again() {
        let folder = tempfile::tempdir().unwrap();
        let (file, library) = (folder.path().join("deep/plugins.json"), folder.path().join("x.so"));
        let write = |text: &str| {
            #[expect(clippy::disallowed_methods, reason = "a test's own file")]
            std::fs::write(&library, text).unwrap();
            LibraryStamp::from_path(&library).unwrap()
        };
        let old = write("one");
        let (descriptor, capabilities) = (Descriptor::new("x", "X", "1.0.0"), Capabilities::default());
        let about = About { descriptor, capabilities, migration: None };
        let mut cache = LibraryCache::load(Some(file.clone()));
        assert_eq!(cache.get(&library, old), None);
        cache.put(&library, old, about.clone());
        cache.save();
        let cache = LibraryCache::load(Some(file.clone()));
        assert_eq!(cache.get(&library, old), Some(about));
        let new = write("other");
        assert_eq!(cache.get(&library, new), None);
        // A broken one is as good as none.
        #[expect(clippy::disallowed_methods, reason = "a test's own file")]
        std::fs::write(&file, "{").unwrap();
        assert_eq!(LibraryCache::load(Some(file)).get(&library, old), None);
    }
}
