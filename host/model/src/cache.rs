//! Content that is made once of a model that cannot be read from anywhere as it is, such as one that is
//! compressed as a whole: one file, for all that open the model after that.
//!
//! A cache is kept under a name, in the folder of a sampled model, or in a nameless file that is gone with
//! the process. It is filled by the first one that needs it, which is told how large it will be. A kept one
//! ends with the size and the hash of the model that it was made of, and with a hash of its own: it is of use
//! as long as both are right, and filled anew otherwise.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use xxhash_rust::xxh3::Xxh3Default;

use crate::claim::Claim;
use crate::output::{OutputFile, check_space};
use crate::output_folder::OutputFolder;
use crate::positioned::Positioned;
use crate::scratch::Scratch;
use crate::size::human_size;
use crate::source::{SourceFile, Stamp};
use crate::target::folder_of;
use crate::{Error, Progress, Result, input};

/// First bytes of the ending of a kept cache; the numbers of [`CacheStamp`] follow.
const MAGIC: &[u8; 8] = b"simodc01";

/// Bytes at the end of a kept cache.
const ENDING: usize = 8 + 8 + 16 + 8 + 16;

/// Bytes that are read at a time.
const BLOCK: usize = 1 << 20;

/// Advice in an error about a folder without room.
const ADVICE: &str = "write to a disk with more room, or set TMPDIR to a folder there";

/// Place for content that is made of a model, and that content once it is made.
#[derive(Debug)]
pub struct Cache {
    place: CacheLocation,
    made: Mutex<Option<Cached>>,
}

#[derive(Debug)]
enum CacheLocation {
    /// A folder for a file without a name.
    Nameless(PathBuf),
    /// A file in a folder that this process is writing, and the path that the file will have.
    Claimed(PathBuf, PathBuf),
    /// A file in a folder that others may be writing.
    Shared(PathBuf),
}

/// Content that this process made of a model, or found kept.
#[derive(Debug)]
struct Cached {
    stamp: Option<Stamp>,
    of: CacheStamp,
    file: SourceFile,
}

/// Size and hash of a model's file, and of the content that was made of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct CacheStamp {
    source_bytes: u64,
    source_hash: u128,
    bytes: u64,
    hash: u128,
}

/// The content that will be made.
pub(crate) struct CachedContent {
    /// Words for messages on what is made of the model, as "its points are unpacked".
    pub what: &'static str,
    /// Size of the content in bytes, the least and the greatest: content of another size was made of the same
    /// model by other means, and is of no use.
    pub bytes: RangeInclusive<u64>,
    /// Bytes of temporary files besides, until the content is made.
    pub meanwhile: u64,
}

/// Cache and progress that a format needs to make content of a model.
pub(crate) struct Making<'a> {
    pub cache: &'a Arc<Cache>,
    pub progress: &'a dyn Progress,
}

impl CachedContent {
    /// Bytes on the disk at most.
    fn room(&self) -> u64 {
        self.bytes.end().saturating_add(self.meanwhile)
    }
}

impl Default for Cache {
    fn default() -> Self {
        Self::nameless(&std::env::temp_dir())
    }
}

impl Cache {
    /// Cache in a nameless file in `folder`, which is gone with the process.
    pub fn nameless(folder: &Path) -> Self {
        Self::in_place(CacheLocation::Nameless(folder.to_owned()))
    }

    /// Cache that is kept in the file `name` of a folder in the making.
    pub fn in_new_folder(folder: &OutputFolder, name: &str) -> Self {
        Self::in_place(CacheLocation::Claimed(folder.path().join(name), folder.target().join(name)))
    }

    /// Cache that is kept in the file `path` of a folder that is there. Where others write that file, or it
    /// cannot be written, the content goes to a nameless file.
    pub fn in_folder(path: &Path) -> Self {
        Self::in_place(CacheLocation::Shared(path.to_owned()))
    }

    fn in_place(place: CacheLocation) -> Self {
        Self { place, made: Mutex::new(None) }
    }

    /// Bytes of the content that was made or found; `None` if nothing was needed so far.
    pub fn bytes(&self) -> Option<u64> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|made| made.of.bytes)
    }

    /// Gives the kept content another name as well, if that can be done without copying it: it can be made
    /// anew.
    pub fn link_to(&self, path: &Path) {
        if let CacheLocation::Claimed(file, _) | CacheLocation::Shared(file) = &self.place {
            let _ = std::fs::hard_link(file, path);
        }
    }

    /// The folder for files without a name.
    pub(crate) fn folder(&self) -> PathBuf {
        match &self.place {
            CacheLocation::Nameless(folder) => folder.clone(),
            CacheLocation::Claimed(file, _) => folder_of(file).to_owned(),
            CacheLocation::Shared(_) => std::env::temp_dir(),
        }
    }

    /// A file without a name, for what is small.
    pub(crate) fn scratch(&self) -> Result<Scratch> {
        Scratch::new(&self.folder(), ADVICE)
    }

    /// Returns the content of a model: the content that was made before, or else what `fill` writes, which
    /// returns its size in bytes. The content is read under the model's path.
    ///
    /// # Errors
    /// The model cannot be read, the disk has no room, `fill` failed, or wrote more or less than is needed.
    pub(crate) fn get(
        &self,
        source: &SourceFile,
        need: &CachedContent,
        progress: &dyn Progress,
        fill: impl FnOnce(&Scratch) -> Result<u64>,
    ) -> Result<SourceFile> {
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let stamp = source.stamp();
        if let Some(known) = made.as_ref()
            && stamp.is_some()
            && known.stamp == stamp
            && need.bytes.contains(&known.of.bytes)
        {
            return Ok(known.file.clone());
        }
        let source_hash = hash(source, progress)?;
        let is_same = |of: &CacheStamp| {
            (of.source_bytes, of.source_hash) == (source.len(), source_hash) && need.bytes.contains(&of.bytes)
        };
        let before = made.take().filter(|known| is_same(&known.of)).map(|known| (known.of, known.file));
        let (of, file) = match before.or_else(|| self.kept(source, is_same, progress)) {
            Some(found) => found,
            None => self.fill(source, source_hash, need, progress, fill)?,
        };
        *made = Some(Cached { stamp, of, file: file.clone() });
        Ok(file)
    }

    /// Returns the kept content with its stamp, if it is whole and was made of this model.
    fn kept(
        &self,
        source: &SourceFile,
        is_same: impl Fn(&CacheStamp) -> bool,
        progress: &dyn Progress,
    ) -> Option<(CacheStamp, SourceFile)> {
        let (CacheLocation::Claimed(path, _) | CacheLocation::Shared(path)) = &self.place else {
            return None;
        };
        let file = input::open(path).ok()?;
        let len = file.metadata().ok()?.len();
        let file = Positioned::new(file);
        let mut ending = [0; ENDING];
        file.read_exact_at(&mut ending, len.checked_sub(ENDING as u64)?).ok()?;
        let of = CacheStamp::decode(&ending).filter(is_same)?;
        if of.bytes != len - ENDING as u64 {
            return None;
        }
        let file = SourceFile::of_part(file, source.path(), of.bytes);
        (hash(&file, progress).ok()? == of.hash).then_some((of, file))
    }

    fn fill(
        &self,
        source: &SourceFile,
        source_hash: u128,
        need: &CachedContent,
        progress: &dyn Progress,
        fill: impl FnOnce(&Scratch) -> Result<u64>,
    ) -> Result<(CacheStamp, SourceFile)> {
        let output = self.output(need)?;
        let folder = output.as_ref().map_or_else(|| self.folder(), |(o, _)| folder_of(o.path()).to_owned());
        let place = match (&self.place, &output) {
            (CacheLocation::Claimed(_, shown), _) => shown.clone(),
            (_, Some((output, _))) => output.path().to_owned(),
            (_, None) => format!("a temporary file in {}", folder.display()).into(),
        };
        check_space(&place, &folder, need.room())?;
        let meanwhile = match need.meanwhile {
            0 => String::new(),
            bytes => format!(", and {} besides until it is done", human_size(bytes)),
        };
        let (path, takes) = (source.path().display(), human_size(*need.bytes.end()));
        progress.note(&format!(
            "{path}: {} into {}, which takes {takes}{meanwhile}",
            need.what,
            place.display()
        ));
        progress.begin("unpacking", 0);
        let scratch = match &output {
            Some((file, _)) => Scratch::from_file(file.part()?, &folder, ADVICE)?,
            None => Scratch::new(&folder, ADVICE)?,
        };
        let bytes = fill(&scratch)?;
        if !need.bytes.contains(&bytes) {
            return Err(Error::internal(format!(
                "{path}: {} in {bytes} bytes, not {:?}",
                need.what, need.bytes
            )));
        }
        source.check_unchanged()?;
        let file = SourceFile::of_scratch(scratch, source.path(), bytes);
        let mut of = CacheStamp { source_bytes: source.len(), source_hash, bytes, hash: 0 };
        // No later process will check whether a nameless file is whole.
        let Some((output, _claim)) = output else { return Ok((of, file)) };
        of.hash = hash(&file, progress)?;
        let part = Positioned::new(output.part()?);
        part.write_all_at(&of.encode(), bytes).map_err(|e| Error::io("write", &place, &e))?;
        output.commit()?;
        Ok((of, SourceFile::of_part(part, source.path(), bytes)))
    }

    /// File for the content that is to be kept, with the right to write it; none if it is to have no name.
    fn output(&self, need: &CachedContent) -> Result<Option<(OutputFile, Option<Claim>)>> {
        match &self.place {
            CacheLocation::Nameless(_) => Ok(None),
            // The check for room looks at the name that the file will have.
            CacheLocation::Claimed(path, _) => Ok(Some((OutputFile::create(path, 0)?, None))),
            CacheLocation::Shared(path) => {
                let Ok(claim) = Claim::folder(folder_of(path)) else { return Ok(None) };
                let Ok(file) = OutputFile::create(path, need.room()) else {
                    return Ok(None);
                };
                Ok(Some((file, Some(claim))))
            }
        }
    }
}

impl CacheStamp {
    fn encode(&self) -> Vec<u8> {
        let Self { source_bytes, source_hash, bytes, hash } = self;
        let mut ending = MAGIC.to_vec();
        ending.extend_from_slice(&source_bytes.to_le_bytes());
        ending.extend_from_slice(&source_hash.to_le_bytes());
        ending.extend_from_slice(&bytes.to_le_bytes());
        ending.extend_from_slice(&hash.to_le_bytes());
        ending
    }

    fn decode(ending: &[u8; ENDING]) -> Option<Self> {
        let (magic, rest) = ending.split_first_chunk()?;
        let (source_bytes, rest) = rest.split_first_chunk()?;
        let (source_hash, rest) = rest.split_first_chunk()?;
        let (bytes, rest) = rest.split_first_chunk()?;
        let (hash, _) = rest.split_first_chunk()?;
        (magic == MAGIC).then_some(Self {
            source_bytes: u64::from_le_bytes(*source_bytes),
            source_hash: u128::from_le_bytes(*source_hash),
            bytes: u64::from_le_bytes(*bytes),
            hash: u128::from_le_bytes(*hash),
        })
    }
}

/// The hash of all bytes.
fn hash(source: &SourceFile, progress: &dyn Progress) -> Result<u128> {
    let (mut hash, mut block, mut at) = (Xxh3Default::new(), Vec::new(), 0);
    while at < source.len() {
        progress.check()?;
        block.clear();
        let read = source.append_at(&mut block, at, BLOCK)?;
        hash.update(&block);
        at += read as u64;
    }
    Ok(hash.digest128())
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use crate::progress::Silent;

    #[test]
    fn what_is_of_another_size_is_of_no_use() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model");
        std::fs::File::create(&model).unwrap().write_all(b"some model").unwrap();
        let source = SourceFile::open(&model, None).unwrap();
        // Written by one, and looked for by others.
        let made = |bytes: RangeInclusive<u64>, writes: u64| {
            let cache = Cache::in_folder(&folder.path().join("cache.bin"));
            let need = CachedContent { what: "it is written", bytes, meanwhile: 0 };
            let mut is_filled = false;
            let file = cache.get(&source, &need, &Silent, |to| {
                is_filled = true;
                to.set_len(writes)?;
                Ok(writes)
            });
            file.map(|file| (file.len(), is_filled))
        };
        assert_eq!(made(5..=5, 5).unwrap(), (5, true));
        assert_eq!(made(5..=5, 5).unwrap(), (5, false));
        assert_eq!(made(3..=9, 9).unwrap(), (5, false));
        assert_eq!(made(7..=7, 7).unwrap(), (7, true));
        assert!(made(8..=9, 10).is_err());
    }
}
