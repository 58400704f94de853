//! Large outputs, written in parts, that can be gone on with after the program was killed.
//!
//! While `name` is written there are two hidden files beside it. `.simod-name.part` holds its beginning, and
//! is locked ([claim](crate::claim)), so that no other process writes the same file. `.simod-name.journal`
//! lists the parts of it that are known to be on the disk, each with a checksum, and a key of all that
//! determines the bytes; it is replaced at once, by way of `.simod-name.journal.new`. Bytes that are not in
//! the journal are not relied on, and those that are there are checked first.
//!
//! Bytes at the beginning of the file that depend on later ones are replaced in the end, once the journal
//! lists the old and the new ones: the checksums are of the old ones.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use xxhash_rust::xxh3::{Xxh3Default, xxh3_128};

use crate::claim::{Claim, OutputFiles, remove};
use crate::input::open_at_once;
use crate::output::sync_folder;
use crate::target::folder_of;
use crate::uncached::UncachedFile;
use crate::{Error, Output, Progress, Result, Summary};

/// First word of a journal.
const FORMAT: &str = "simod-journal/1";

/// Bytes that are checked at a time.
const BLOCK: usize = 1 << 20;

/// Most bytes of a journal: it has at most 1024 parts and a few, of some 60 bytes each, and with the lengths
/// of a file's compressed blocks some 6 bytes for each of these.
const LONGEST: u64 = 64 << 20;

/// A file in the making, a piece at a time. Dropped before [`commit`](Self::commit), it leaves no trace,
/// unless it is to be [kept](Self::keep).
///
/// Memory: 4 MiB, and the journal, of some 60 bytes for each part and 8 for each compressed block.
pub struct ResumableFile {
    claim: Claim,
    /// The part file.
    file: UncachedFile,
    journal: Journal,
    recorder: JournalRecorder,
    /// Number of pieces that were written, and (`end`) of bytes.
    pieces: u64,
    end: u64,
    /// Hash of the bytes written since the last part, and (`since`) the number of bytes of the model that
    /// they stand for.
    hash: Xxh3Default,
    since: u64,
    /// Summary of the pieces written since the last part.
    summary: Summary,
    /// Number of bytes of the model after which a part is over.
    part_bytes: u64,
    /// Whether the end of writing waits until all is on the disk.
    syncs: bool,
}

/// Result of [`ResumableFile::open`].
pub enum Opened {
    /// The file has still to be written, as a whole or in part.
    Unfinished(Box<ResumableFile>),
    /// The file is complete: an earlier call wrote all of it, and it stands in its place.
    Finished(Finished),
}

impl ResumableFile {
    /// Begins the file `path`, whose bytes `key` determines. With `resume`, the part that an earlier call
    /// left is checked and kept as far as it is good; the reason for starting anew, if so, is told to
    /// `progress`.
    ///
    /// # Errors
    /// The folder is missing or cannot be written to, `path` is a folder or a device, another process writes
    /// it, or the user cancelled.
    pub fn open(
        path: &Path,
        key: String,
        resume: bool,
        part_bytes: u64,
        progress: &dyn Progress,
    ) -> Result<Opened> {
        let claim = Claim::file(path, resume)?;
        let handle = || claim.part().try_clone().map_err(|e| claim.failed(&e));
        let mut this = Self {
            recorder: JournalRecorder::new(handle()?, claim.places().clone()),
            file: UncachedFile::new(handle()?),
            claim,
            journal: Journal { key, parts: Vec::new(), patches: Vec::new(), is_complete: false },
            pieces: 0,
            end: 0,
            hash: Xxh3Default::new(),
            since: 0,
            summary: Summary::default(),
            part_bytes,
            syncs: true,
        };
        let found = if resume { this.find(progress)? } else { JournalState::default() };
        if found.in_target {
            // The empty part file goes, the journal stays until the end.
            this.claim.keep();
            let places = this.claim.places().clone();
            let _ = fs::remove_file(&places.part);
            return Ok(Opened::Finished(Finished { places, hash: None, leave: false }));
        }
        if found.parts.is_empty() {
            // In this order: a journal never speaks of bytes that are gone.
            let begun = remove(&this.claim.places().journal).and_then(|()| this.file.file().set_len(0));
            begun
                .and_then(|()| this.journal.replace(this.claim.places(), false))
                .map_err(|e| this.failed(&e))?;
        }
        (this.journal.parts, this.journal.patches) = (found.parts, found.patches);
        if found.is_complete {
            return Ok(Opened::Finished(this.commit()?));
        }
        Ok(Opened::Unfinished(Box::new(this)))
    }

    /// Returns the parts that an earlier call left and that can be relied on.
    fn find(&mut self, progress: &dyn Progress) -> Result<JournalState> {
        let places = self.claim.places().clone();
        let name = places.path.display();
        let Some(journal) = Journal::read(&places) else { return Ok(JournalState::default()) };
        let Some(Journal { key, mut parts, patches, is_complete }) = journal else {
            progress.note(&format!("{name}: the journal is damaged; starting anew"));
            return Ok(JournalState::default());
        };
        if key != self.journal.key {
            progress.note(&format!(
                "{name}: the model, the samples or an option changed since it was interrupted; starting anew"
            ));
            return Ok(JournalState::default());
        }
        let bytes = parts.last().map_or(0, |p| p.end);
        let in_target = is_complete && self.file.file().metadata().is_ok_and(|m| m.len() == 0);
        let target = in_target.then(|| crate::input::open(&places.target).ok()).flatten();
        progress.begin("checking what is there", bytes);
        let file = target.as_ref().unwrap_or(self.file.file());
        let good = good_parts(file, &parts, &patches, progress);
        // A cancellation now loses nothing.
        let good = good.inspect_err(|_| self.claim.keep())?;
        let all = good == parts.len();
        let length = |file: &File| file.metadata().is_ok_and(|m| m.len() == bytes);
        if in_target {
            let in_target = all && target.as_ref().is_some_and(length);
            if !in_target {
                progress.note(&format!("{name}: it is not there as it was written; starting anew"));
            }
            return Ok(JournalState { in_target, ..JournalState::default() });
        }
        if !all {
            progress.note(&format!("{name}: what was left of it is damaged; going on from before that"));
        }
        parts.truncate(good);
        let is_complete = all && is_complete && length(self.file.file());
        Ok(JournalState { is_complete, parts, patches, in_target: false })
    }

    /// Leaves it to the caller to bring the complete file to the disk, or not to, where the file is removed
    /// soon. If it never gets to the disk, its checksums tell.
    pub fn leave_syncing(&mut self) {
        self.syncs = false;
    }

    /// Waits until all written bytes are on the disk, unless that is left to the caller.
    fn sync(&self) -> io::Result<()> {
        if self.syncs { self.file.file().sync_all() } else { Ok(()) }
    }

    /// Number of pieces up to the end of each part.
    pub fn boundaries(&self) -> impl Iterator<Item = u64> {
        self.journal.parts.iter().map(|p| p.pieces)
    }

    /// Goes on after so many pieces: at one of the [boundaries](Self::boundaries), or at the beginning. Has
    /// to be called before anything is written behind the parts of an earlier call. Returns the number of
    /// bytes that are there.
    ///
    /// # Errors
    /// The journal cannot be written, or the part file cannot be cut.
    pub fn go_on_after(&mut self, pieces: u64) -> Result<u64> {
        for JournalPatch { at, old, .. } in &std::mem::take(&mut self.journal.patches) {
            // Before the journal forgets them.
            write_at(self.file.file(), *at, old).map_err(|e| self.failed(&e))?;
        }
        if !self.journal.parts.is_empty() {
            // First, so that it never speaks of bytes that are gone.
            self.journal.parts.retain(|p| p.pieces <= pieces);
            self.journal.replace(self.claim.places(), true).map_err(|e| self.failed(&e))?;
        }
        self.pieces = pieces;
        self.end = self.journal.parts.last().map_or(0, |p| p.end);
        (self.hash, self.since, self.summary) = (Xxh3Default::new(), 0, Summary::default());
        self.file.go_on_at(self.end).map_err(|e| self.failed(&e))?;
        Ok(self.end)
    }

    /// Entry for the part that is written since the last complete one.
    fn open_part(&self) -> JournalEntry {
        let summary = self.summary.clone();
        JournalEntry { pieces: self.pieces, end: self.end, hash: self.hash.digest128(), summary }
    }

    /// Ends the current part, which is recorded once it is on the disk.
    fn end_part(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.journal.parts.push(self.open_part());
        (self.hash, self.since, self.summary) = (Xxh3Default::new(), 0, Summary::default());
        self.recorder.record(self.journal.clone())
    }

    /// Ends the file, and waits until all is on the disk. A later call takes the file for finished if it was
    /// of more than one part, or is `one_of_several`.
    ///
    /// # Errors
    /// The disk is full, or the operating system refuses.
    pub fn complete(&mut self, one_of_several: bool) -> Result<()> {
        let mut complete = || {
            self.recorder.finish()?;
            self.file.flush()?;
            self.sync()?;
            let is_recorded = one_of_several || !self.journal.parts.is_empty();
            if !self.journal.patches.is_empty() {
                if is_recorded {
                    self.journal.replace(self.claim.places(), self.syncs)?;
                }
                for JournalPatch { at, new, .. } in &self.journal.patches {
                    write_at(self.file.file(), *at, new)?;
                }
                self.sync()?;
            }
            if is_recorded {
                if self.journal.parts.last().is_none_or(|p| p.pieces < self.pieces) {
                    self.journal.parts.push(self.open_part());
                }
                self.journal.is_complete = true;
                self.journal.replace(self.claim.places(), self.syncs)?;
            }
            Ok(())
        };
        complete().map_err(|e: io::Error| self.failed(&e))
    }

    /// Puts the [completed](Self::complete) file in its place.
    ///
    /// # Errors
    /// The operating system refuses; the target is then what it was.
    pub fn commit(&mut self) -> Result<Finished> {
        self.claim.put_in_place().map_err(|e| self.failed(&e))?;
        let finished = Finished { places: self.claim.places().clone(), hash: self.hash(), leave: false };
        if self.syncs {
            sync_folder(folder_of(&finished.places.target)).map_err(|e| self.failed(&e))?;
        }
        Ok(finished)
    }

    /// Hash of the whole file, where all of it was written as one part and nothing is replaced in it.
    fn hash(&self) -> Option<u128> {
        if !self.journal.patches.is_empty() {
            return None;
        }
        match &self.journal.parts[..] {
            [] => Some(self.hash.digest128()),
            // One of several files notes it once it is complete.
            [all] if all.end == self.end => Some(all.hash),
            _ => None,
        }
    }

    /// Leaves the recorded parts to a later call, if there are any.
    pub fn keep(mut self) {
        // Parts that could not be recorded are not kept.
        let _ = self.recorder.finish();
        let Some(Some(journal)) = Journal::read(self.claim.places()) else { return };
        if let Some(last) = journal.parts.last() {
            // The rest of the file may be what fills the disk. If it cannot be cut off now, that happens when
            // the file is gone on with.
            let _ = self.file.wait();
            let _ = self.file.file().set_len(last.end);
            let _ = remove(&self.claim.places().new_journal);
            self.claim.keep();
        }
    }

    fn failed(&self, error: &io::Error) -> Error {
        self.claim.failed(error)
    }
}

impl Output for ResumableFile {
    fn write_pieces(
        &mut self,
        pieces: u64,
        bytes: &[u8],
        source_bytes: u64,
        summary: &Summary,
    ) -> io::Result<()> {
        let mut write = || {
            self.file.write(bytes)?;
            self.hash.update(bytes);
            self.pieces += pieces;
            self.end += bytes.len() as u64;
            self.since += source_bytes;
            self.summary.absorb(summary);
            if self.since >= self.part_bytes { self.end_part() } else { Ok(()) }
        };
        // With the file's name, packed so that it passes through.
        write().map_err(|e| io::Error::new(e.kind(), self.failed(&e)))
    }

    fn summary(&self) -> Summary {
        let mut all = Summary::default();
        self.journal.parts.iter().for_each(|part| all.absorb(&part.summary));
        all
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let mut note = || {
            self.file.flush()?;
            let mut old = vec![0; bytes.len()];
            let mut file = self.file.file();
            file.seek(SeekFrom::Start(at))?;
            file.read_exact(&mut old)?;
            if old != bytes {
                self.journal.patches.push(JournalPatch { at, old, new: bytes.to_vec() });
            }
            Ok(())
        };
        note().map_err(|e: io::Error| io::Error::new(e.kind(), self.failed(&e)))
    }

    /// Bytes are replaced when the file is [completed](Self::complete).
    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for ResumableFile {
    fn drop(&mut self) {
        // The recorder ends first, as it writes the journal; the other files go with the claim.
        let _ = self.recorder.finish();
    }
}

/// A file that stands in its place; its journal is removed with this.
pub struct Finished {
    places: OutputFiles,
    hash: Option<u128>,
    leave: bool,
}

impl Finished {
    /// Size of the file.
    pub fn bytes(&self) -> u64 {
        fs::metadata(&self.places.target).map_or(0, |m| m.len())
    }

    /// XXH3 hash of 128 bits of all bytes of the file, where it is known without reading them: for a file
    /// that this call wrote as one part, and in which nothing was replaced.
    pub fn hash(&self) -> Option<u128> {
        self.hash
    }

    /// Leaves the journal, for a later call that does the rest.
    pub fn keep(mut self) {
        self.leave = true;
    }
}

impl Drop for Finished {
    fn drop(&mut self) {
        if !self.leave {
            self.places.remove_journal();
        }
    }
}

#[derive(Default)]
struct JournalState {
    /// The good ones.
    parts: Vec<JournalEntry>,
    /// Replacements that may have been made in the parts.
    patches: Vec<JournalPatch>,
    /// The parts are the whole file.
    is_complete: bool,
    /// The whole file stands in its place, and its checksums are right.
    in_target: bool,
}

/// Number of the parts, from the first on, that are in the file as they were written. A part that cannot be
/// read is not counted. Bytes that were to be replaced may be the old or the new ones.
fn good_parts(
    mut file: &File,
    parts: &[JournalEntry],
    patches: &[JournalPatch],
    progress: &dyn Progress,
) -> Result<usize> {
    let (mut start, mut block) = (0, vec![0; BLOCK]);
    for (number, part) in parts.iter().enumerate() {
        let mut hash = Xxh3Default::new();
        if number == 0 && file.seek(SeekFrom::Start(0)).is_err() {
            return Ok(0);
        }
        while start < part.end {
            progress.check()?;
            let count = (part.end - start).min(BLOCK as u64);
            let block = &mut block[..count as usize];
            if file.read_exact(block).is_err() {
                return Ok(number);
            }
            patches.iter().for_each(|patch| patch.undo(start, block));
            hash.update(block);
            start += count;
            progress.advance(count);
        }
        if hash.digest128() != part.hash {
            return Ok(number);
        }
    }
    Ok(parts.len())
}

/// Bytes of the file `path` that the disk holds already: those of its part file, and with `resume` the file
/// itself, if an earlier call finished it.
pub fn bytes_there(path: &Path, resume: bool) -> u64 {
    let Ok(places) = OutputFiles::of_file(path) else { return 0 };
    let len = |path: &Path| fs::metadata(path).map_or(0, |m| m.len());
    match fs::metadata(&places.part) {
        Ok(part) => part.len(),
        Err(_) if resume && matches!(Journal::read(&places), Some(Some(j)) if j.is_complete) => {
            len(&places.target)
        }
        Err(_) => 0,
    }
}

/// Whether an earlier call left something of the file `path`.
pub fn is_left(path: &Path) -> bool {
    OutputFiles::of_file(path).is_ok_and(|places| places.journal.exists())
}

/// Removes what tells later calls that the file `path` is finished.
pub(crate) fn forget(path: &Path) {
    if let Ok(places) = OutputFiles::of_file(path) {
        places.remove_journal();
    }
}

/// The journal: parts that are known to be on the disk.
#[derive(Debug, Clone, PartialEq)]
struct Journal {
    /// Hash of all that determines the bytes.
    key: String,
    /// Parts in the order of the file.
    parts: Vec<JournalEntry>,
    /// Replacements in the parts, which are made in the end.
    patches: Vec<JournalPatch>,
    /// The parts are the whole file.
    is_complete: bool,
}

/// Part of the file: a run of bytes, which begins where the part before it ends.
#[derive(Debug, Clone, PartialEq)]
struct JournalEntry {
    /// Number of pieces up to the end of the part.
    pieces: u64,
    /// Byte of the file at which the part ends.
    end: u64,
    /// Hash of the part's bytes, before anything is replaced in them.
    hash: u128,
    /// Summary of the part's pieces.
    summary: Summary,
}

/// Bytes that are replaced once all others are there, by as many.
#[derive(Debug, Clone, PartialEq)]
struct JournalPatch {
    at: u64,
    old: Vec<u8>,
    new: Vec<u8>,
}

impl JournalPatch {
    /// Puts the old bytes back into a block of the file, as far as the patch lies in it, if all of them were
    /// replaced.
    fn undo(&self, start: u64, block: &mut [u8]) {
        let from = self.at.max(start);
        let to = (self.at + self.old.len() as u64).min(start + block.len() as u64);
        if from >= to {
            return;
        }
        let of_block = (from - start) as usize..(to - start) as usize;
        let of_patch = (from - self.at) as usize..(to - self.at) as usize;
        if block[of_block.clone()] == self.new[of_patch.clone()] {
            block[of_block].copy_from_slice(&self.old[of_patch]);
        }
    }
}

fn write_at(mut file: &File, at: u64, bytes: &[u8]) -> io::Result<()> {
    file.seek(SeekFrom::Start(at))?;
    file.write_all(bytes)
}

/// Two hexadecimal digits for each byte.
fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digits = |at| text.get(at..at + 2).and_then(|digits| u8::from_str_radix(digits, 16).ok());
    (0..text.len()).step_by(2).map(digits).collect()
}

impl Journal {
    /// Text of the journal: lines of words, the last of which is a checksum of those before it.
    fn encode(&self) -> String {
        let mut text = format!("{FORMAT}\nkey {}\n", self.key);
        for JournalEntry { pieces, end, hash, summary } in &self.parts {
            let summary = summary.encode().map(|word| format!(" {word}")).unwrap_or_default();
            text.push_str(&format!("part {pieces} {end} {hash:032x}{summary}\n"));
        }
        for JournalPatch { at, old, new } in &self.patches {
            text.push_str(&format!("patch {at} {} {}\n", hex(old), hex(new)));
        }
        if self.is_complete {
            text.push_str("complete\n");
        }
        let check = xxh3_128(text.as_bytes());
        text + &format!("check {check:032x}\n")
    }

    /// `None` if this is no journal of ours, or damaged.
    fn decode(text: &str) -> Option<Self> {
        let (lines, check) = text.split_at(text.rfind("check ")?);
        if check != format!("check {:032x}\n", xxh3_128(lines.as_bytes())) {
            return None;
        }
        let mut lines = lines.lines();
        if lines.next()? != FORMAT {
            return None;
        }
        let key = lines.next()?.strip_prefix("key ")?.to_owned();
        let mut journal = Self { key, parts: Vec::new(), patches: Vec::new(), is_complete: false };
        for line in lines {
            match *line.split(' ').collect::<Vec<_>>() {
                ["part", pieces, end, hash, ref summary @ ..] if summary.len() < 2 => {
                    journal.parts.push(JournalEntry {
                        pieces: pieces.parse().ok()?,
                        end: end.parse().ok()?,
                        hash: u128::from_str_radix(hash, 16).ok()?,
                        summary: match summary.first() {
                            Some(word) => Summary::decode(word)?,
                            None => Summary::default(),
                        },
                    });
                }
                ["patch", at, old, new] if old.len() == new.len() => journal.patches.push(JournalPatch {
                    at: at.parse().ok()?,
                    old: from_hex(old)?,
                    new: from_hex(new)?,
                }),
                ["complete"] => journal.is_complete = true,
                _ => return None,
            }
        }
        journal.parts.is_sorted_by(|a, b| a.pieces < b.pieces && a.end <= b.end).then_some(journal)
    }

    /// Reads the journal in its place, if there is one; `Some(None)` if it is damaged.
    fn read(places: &OutputFiles) -> Option<Option<Self>> {
        // The journal is not read through a link, which another process may have put there.
        let file = open_at_once(&places.journal, false).ok()?;
        let mut bytes = Vec::new();
        if !file.metadata().is_ok_and(|is| is.is_file())
            || file.take(LONGEST).read_to_end(&mut bytes).is_err()
        {
            return Some(None);
        }
        Some(std::str::from_utf8(&bytes).ok().and_then(Self::decode))
    }

    /// Puts the journal in its place, at once; if it is to last through a power failure, by way of the disk.
    fn replace(&self, places: &OutputFiles, sync: bool) -> io::Result<()> {
        remove(&places.new_journal)?;
        let mut file = OpenOptions::new().write(true).create_new(true).open(&places.new_journal)?;
        file.write_all(self.encode().as_bytes())?;
        if sync {
            file.sync_data()?;
        }
        fs::rename(&places.new_journal, &places.journal)
    }
}

/// Brings parts to the disk and then into the journal, on a thread of its own, so that writing goes on. One
/// journal is worked on, and one may wait.
struct JournalRecorder {
    /// A second handle of the part file, until the thread begins.
    idle: Option<(File, OutputFiles)>,
    busy: Option<(SyncSender<Journal>, JoinHandle<io::Result<()>>)>,
}

impl JournalRecorder {
    fn new(file: File, places: OutputFiles) -> Self {
        Self { idle: Some((file, places)), busy: None }
    }

    /// Records the parts written up to now. An earlier failure is returned here, or by
    /// [`finish`](Self::finish).
    fn record(&mut self, journal: Journal) -> io::Result<()> {
        if let Some((file, places)) = self.idle.take() {
            let (send, receive) = sync_channel::<Journal>(1);
            let work = move || {
                receive.into_iter().try_for_each(|journal| {
                    file.sync_data()?;
                    journal.replace(&places, true)
                })
            };
            self.busy = Some((send, thread::Builder::new().spawn(work)?));
        }
        match &self.busy {
            Some((send, _)) if send.send(journal).is_ok() => Ok(()),
            _ => self.finish(),
        }
    }

    /// Waits until all is recorded. Nothing can be recorded after that.
    fn finish(&mut self) -> io::Result<()> {
        self.idle = None;
        let Some((send, thread)) = self.busy.take() else { return Ok(()) };
        drop(send);
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::tests::names;
    use crate::progress::Silent;

    fn open(path: &Path, key: &str, resume: bool) -> Result<ResumableFile> {
        match ResumableFile::open(path, key.into(), resume, 10, &Silent)? {
            Opened::Unfinished(file) => Ok(*file),
            Opened::Finished(_) => panic!("it is finished"),
        }
    }

    /// Pieces of five bytes, so that a part is of two.
    fn write(file: &mut ResumableFile, pieces: std::ops::Range<u8>) {
        for piece in pieces {
            file.write_piece(&[piece; 5], 5, &Summary::default()).unwrap();
        }
    }

    fn expected(pieces: u8) -> Vec<u8> {
        (0..pieces).flat_map(|piece| [piece; 5]).collect()
    }

    #[test]
    fn a_journal_comes_back_and_no_other_text_passes() {
        let part = |n: u64| JournalEntry {
            pieces: n,
            end: 100 * n,
            hash: u128::MAX / u128::from(n),
            summary: Summary { lengths: vec![5; n as usize - 1], ..Summary::default() },
        };
        let patches = vec![JournalPatch { at: 7, old: vec![0, 255], new: vec![16, 1] }];
        let journal = Journal { key: "k".into(), parts: vec![part(1), part(2)], patches, is_complete: true };
        let text = journal.encode();
        assert_eq!(Journal::decode(&text), Some(journal));
        for end in 0..text.len() {
            assert_eq!(Journal::decode(&text[..end]), None);
        }
        for at in 0..text.len() {
            let mut spoilt = text.clone().into_bytes();
            spoilt[at] ^= 1;
            assert_eq!(Journal::decode(&String::from_utf8_lossy(&spoilt)), None);
        }
        let descending = Journal {
            key: "k".into(),
            parts: vec![part(2), part(1)],
            patches: Vec::new(),
            is_complete: false,
        };
        assert_eq!(Journal::decode(&descending.encode()), None);
    }

    #[test]
    fn nothing_but_the_file_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let mut file = open(&path, "k", false).unwrap();
        assert_eq!(names(folder.path()), [".simod-a.journal", ".simod-a.part"]);
        write(&mut file, 0..7);
        drop(file);
        assert!(names(folder.path()).is_empty());
        let mut file = open(&path, "k", false).unwrap();
        write(&mut file, 0..7);
        file.complete(false).unwrap();
        file.commit().unwrap();
        assert_eq!(names(folder.path()), ["a"]);
        assert_eq!(fs::read(&path).unwrap(), expected(7));
    }

    #[test]
    fn one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let first = open(&path, "k", false).unwrap();
        for resume in [false, true] {
            let error = open(&path, "k", resume).err().unwrap();
            assert!(error.to_string().ends_with("/a is being written by another process"), "{error}");
        }
        drop(first);
        open(&path, "k", false).unwrap();
    }

    #[test]
    fn kept_parts_are_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        for written in 0..9 {
            let mut file = open(&path, "k", false).unwrap();
            write(&mut file, 0..written);
            file.keep();
            assert_eq!(names(folder.path()).is_empty(), written < 2);
            let mut file = open(&path, "k", true).unwrap();
            let boundaries: Vec<u64> = file.boundaries().collect();
            let whole = written / 2 * 2;
            assert_eq!(boundaries, (2..=u64::from(whole)).step_by(2).collect::<Vec<_>>());
            assert_eq!(file.go_on_after(u64::from(whole)).unwrap(), 5 * u64::from(whole));
            write(&mut file, whole..9);
            file.complete(false).unwrap();
            file.commit().unwrap();
            assert_eq!(fs::read(&path).unwrap(), expected(9));
            assert_eq!(names(folder.path()), ["a"]);
            fs::remove_file(&path).unwrap();
        }
    }

    /// A file of a process that was killed at any time becomes the file that it would have become.
    #[test]
    fn what_is_replaced_in_the_end_is_replaced_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let mut whole = expected(7);
        whole[3..5].copy_from_slice(b"AB");
        whole[9..12].copy_from_slice(b"CDE");
        let patch = |file: &mut ResumableFile| {
            file.patch(3, b"AB").unwrap();
            file.patch(9, b"CDE").unwrap();
        };
        let summary = |n: u32| Summary { lengths: vec![n], ..Summary::default() };
        for stage in 0..4 {
            let mut file = open(&path, "k", false).unwrap();
            for piece in 0..7 {
                file.write_piece(&[piece; 5], 5, &summary(u32::from(piece))).unwrap();
            }
            patch(&mut file);
            match stage {
                // The process may be killed before anything was replaced, in the midst of it, when all was
                // replaced, and when that was recorded.
                0 => {}
                1 | 2 => {
                    file.recorder.finish().unwrap();
                    file.journal.replace(file.claim.places(), true).unwrap();
                    for JournalPatch { at, new, .. } in file.journal.patches.iter().take(stage) {
                        write_at(file.file.file(), *at, new).unwrap();
                    }
                }
                _ => file.complete(false).unwrap(),
            }
            file.keep();
            match ResumableFile::open(&path, "k".into(), true, 10, &Silent).unwrap() {
                Opened::Finished(_) => assert_eq!(stage, 3),
                Opened::Unfinished(mut file) => {
                    let there = file.boundaries().last().unwrap();
                    assert_eq!(there, 6, "stage {stage}");
                    file.go_on_after(there).unwrap();
                    assert_eq!(file.summary().lengths, [0, 1, 2, 3, 4, 5]);
                    file.write_piece(&[6; 5], 5, &summary(6)).unwrap();
                    patch(&mut file);
                    file.complete(false).unwrap();
                    file.commit().unwrap();
                }
            }
            assert_eq!(fs::read(&path).unwrap(), whole, "stage {stage}");
            fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn the_hash_is_known_of_what_was_written_as_one_part() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let all = [(100, false), (100, true), (10, false)].into_iter();
        for ((part_bytes, replaces), one_of_several) in all.flat_map(|of| [(of, false), (of, true)]) {
            let opened = ResumableFile::open(&path, "k".into(), false, part_bytes, &Silent).unwrap();
            let Opened::Unfinished(mut file) = opened else { panic!("it is finished") };
            write(&mut file, 0..7);
            if replaces {
                file.patch(3, b"AB").unwrap();
            }
            file.complete(one_of_several).unwrap();
            let hash = file.commit().unwrap().hash();
            let is_known = part_bytes == 100 && !replaces;
            assert_eq!(hash, is_known.then(|| xxh3_128(&fs::read(&path).unwrap())));
        }
    }

    #[test]
    fn a_finished_file_is_known_by_its_journal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let finish = || {
            let mut file = open(&path, "k", false).unwrap();
            write(&mut file, 0..5);
            file.complete(true).unwrap();
            file
        };
        let is_finished = || {
            let opened = ResumableFile::open(&path, "k".into(), true, 10, &Silent).unwrap();
            matches!(opened, Opened::Finished(_))
        };
        finish().commit().unwrap().keep();
        assert_eq!(names(folder.path()), [".simod-a.journal", "a"]);
        assert!(is_finished());
        assert_eq!(names(folder.path()), ["a"]);
        // Killed before it was renamed.
        finish().keep();
        fs::remove_file(&path).unwrap();
        assert!(is_finished());
        assert_eq!(fs::read(&path).unwrap(), expected(5));
        // Changed since.
        finish().commit().unwrap().keep();
        fs::File::create(&path).unwrap().write_all(b"precious").unwrap();
        assert!(!is_finished());
        assert_eq!(fs::read(&path).unwrap(), b"precious");
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[test]
    fn long_names_and_what_is_in_the_way() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a".repeat(255));
        let mut file = open(&path, "k", false).unwrap();
        write(&mut file, 0..3);
        file.complete(false).unwrap();
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), expected(3));
        fs::create_dir(folder.path().join(".simod-b.part")).unwrap();
        let error = open(&folder.path().join("b"), "k", false).err().unwrap();
        assert!(error.to_string().contains(".simod-b.part is in the way"), "{error}");
    }
}
