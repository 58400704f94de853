//! A file's bytes as GLB has them: a header, a chunk of JSON, and one of binary data.
//!
//! A `.gltf`, whose buffers are files beside it or text within it, is read as if it were a GLB without being
//! copied: a header and JSON in memory, with the buffers one behind the other as binary data.

use std::ops::Range;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use serde_json::value::RawValue;

use super::json::{Buffer, list, span};
use crate::cache::Cache;
use crate::size::human_size;
use crate::source::SourceFile;
use crate::text::lines::without_mark;
use crate::text::{CUT_OFF, DAMAGED};
use crate::{Error, Result};

/// First bytes of a GLB file.
pub(super) const MAGIC: &[u8] = b"glTF";

/// Longest JSON: it is held while a file is opened, and when one has been written.
const LONGEST_JSON: u64 = 64 << 20;

/// Bytes of a file's header, and of a chunk's.
pub(super) const HEADER: u64 = 12;
const CHUNK: u64 = 8;

const JSON: u32 = 0x4E4F_534A;
const BIN: u32 = 0x004E_4942;

const AS_GLB: &str = "export the model as GLB, which has everything in one file";

/// The bytes of a GLB file.
#[derive(Debug)]
pub(super) struct Container {
    /// The file that was opened.
    pub(super) source: SourceFile,
    /// Segments that make up the container's bytes; none if these are the file's as they are.
    parts: Vec<Segment>,
    len: u64,
    pub(super) json: Range<u64>,
    /// The binary data; empty if there is none.
    pub(super) bin: Range<u64>,
}

#[derive(Debug)]
struct Segment {
    /// Byte of the container at which the segment begins.
    at: u64,
    len: u64,
    bytes: SegmentBytes,
}

#[derive(Debug)]
enum SegmentBytes {
    Memory(Vec<u8>),
    /// The opened file, from some place on.
    Opened(u64),
    File(SourceFile),
}

/// The part of the JSON that speaks of buffers, as text.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct OfBuffers<'a> {
    #[serde(borrow)]
    buffers: Option<&'a RawValue>,
    #[serde(borrow, default, deserialize_with = "list")]
    buffer_views: Vec<OfView<'a>>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct OfView<'a> {
    #[serde(borrow)]
    buffer: &'a RawValue,
    #[serde(borrow)]
    byte_offset: Option<&'a RawValue>,
}

#[derive(Deserialize)]
struct Buffers {
    #[serde(default, deserialize_with = "list")]
    buffers: Vec<Buffer>,
}

impl Container {
    /// Opens a file, and returns its JSON.
    pub(super) fn open(source: SourceFile, cache: &Cache) -> Result<(Self, Vec<u8>)> {
        let mut start = [0; HEADER as usize];
        let read = source.read_at(&mut start, 0)?;
        if !start[..read].starts_with(MAGIC) {
            let len = source.len();
            if len > LONGEST_JSON {
                let what =
                    format!("{} of JSON, where {} can be read", human_size(len), human_size(LONGEST_JSON));
                return Err(source.malformed(what, AS_GLB));
            }
            let mut json = Vec::new();
            source.append_at(&mut json, 0, len as usize)?;
            let marked = json.len() - without_mark(&json).len();
            json.drain(..marked);
            return Self::gather(source, json, None, (0, cache));
        }
        let this = Self::of_glb(source)?;
        let mut json = Vec::new();
        this.append_at(&mut json, this.json.start, (this.json.end - this.json.start) as usize)?;
        let Buffers { buffers } = this.parse(&json)?;
        if buffers.iter().all(|buffer| buffer.uri.is_none()) {
            return Ok((this, json));
        }
        let after = if this.bin.is_empty() { this.json.end } else { this.bin.end };
        let bin = Some(this.bin.clone()).filter(|bin| !bin.is_empty());
        Self::gather(this.source, json, bin, (after, cache))
    }

    /// Range of bytes of the content of the chunk at a byte of a GLB file of length `len`, and the chunk's
    /// type.
    fn chunk(&self, at: u64, len: u64) -> Result<(Range<u64>, u32)> {
        let mut chunk = [0; CHUNK as usize];
        self.read_at(&mut chunk, at)?;
        let (size, start) = (u64::from(number(&chunk, 0)), at + CHUNK);
        if start + size > len {
            let left = len.saturating_sub(start);
            let what = format!("the chunk at byte {at} says {size} bytes, but {left} are left");
            return Err(self.source.malformed(what, CUT_OFF));
        }
        Ok((start..start + size, number(&chunk, 4)))
    }

    /// The chunks of a GLB file.
    fn of_glb(source: SourceFile) -> Result<Self> {
        let mut header = [0; (HEADER + CHUNK) as usize];
        if source.read_at(&mut header, 0)? < header.len() {
            let what = format!("{} bytes are too few for GLB, which begins with 20", source.len());
            return Err(source.malformed(what, CUT_OFF));
        }
        let (version, len) = (number(&header, 4), u64::from(number(&header, 8)));
        if version != 2 {
            return Err(source.malformed(
                format!("GLB of version {version}, where 2 can be read"),
                "export the model as glTF 2.0",
            ));
        }
        if len > source.len() {
            let what = format!("says {len} bytes, but it has {}", source.len());
            return Err(source.malformed(what, CUT_OFF));
        }
        let mut this = Self { source, parts: Vec::new(), len: 0, json: 0..0, bin: 0..0 };
        this.len = this.source.len();
        let mut at = HEADER;
        for index in 0.. {
            // Fewer are padding.
            if at + CHUNK > len && index > 0 {
                break;
            }
            let (range, kind) = this.chunk(at, len)?;
            at = range.end;
            match (index, kind) {
                (0, JSON) => this.json = range,
                (0, _) => {
                    let what = format!("its first chunk is not JSON but of type {kind:#010x}");
                    return Err(this.source.malformed(what, DAMAGED));
                }
                (1, BIN) => this.bin = range,
                _ => {}
            }
        }
        let size = this.json.end - this.json.start;
        if size > LONGEST_JSON {
            let what =
                format!("{} of JSON, where {} can be read", human_size(size), human_size(LONGEST_JSON));
            return Err(this.source.malformed(what, "export the model with fewer nodes and meshes, joined"));
        }
        Ok(this)
    }

    /// Joins a file, whose JSON refers to buffers elsewhere, with all of these as binary data. `bin` is
    /// the binary data of the file itself, and `after` is where other chunks begin.
    fn gather(
        source: SourceFile,
        json: Vec<u8>,
        bin: Option<Range<u64>>,
        (after, cache): (u64, &Cache),
    ) -> Result<(Self, Vec<u8>)> {
        let this = Self { source, parts: Vec::new(), len: 0, json: 0..0, bin: 0..0 };
        let Buffers { buffers } = this.parse(&json)?;
        let (mut parts, mut len, mut starts) = (Vec::new(), 0, Vec::new());
        for (index, buffer) in buffers.iter().enumerate() {
            starts.push(len);
            let bytes = match (&buffer.uri, &bin) {
                (Some(uri), _) => SegmentBytes::File(this.buffer(index, uri, cache)?),
                (None, Some(bin)) if index == 0 => SegmentBytes::Opened(bin.start),
                (None, _) => {
                    let what = format!("buffer {index} has no data");
                    return Err(this.source.malformed(what, AS_GLB));
                }
            };
            let there = match (&bytes, &bin) {
                (SegmentBytes::File(file), _) => file.len(),
                (_, Some(bin)) => bin.end - bin.start,
                _ => 0,
            };
            if there < buffer.byte_length {
                let what = format!("buffer {index} says {} bytes, but it has {there}", buffer.byte_length);
                return Err(this.source.malformed(what, CUT_OFF));
            }
            if buffer.byte_length > 0 {
                parts.push(Segment { at: len, len: buffer.byte_length, bytes });
            }
            len = pad(&mut parts, len + buffer.byte_length);
        }
        let text = this.gathered(&json, &starts, len)?;
        let there = this.source.len();
        // A `.gltf` has nothing but its JSON.
        let behind = (after > 0 && after < there).then(|| Segment {
            at: 0,
            len: there - after,
            bytes: SegmentBytes::Opened(after),
        });
        this.assembled(text, (parts, len), behind.into_iter().collect())
    }

    /// The JSON with one buffer in place of several, each of which begins at one of `starts` in it.
    fn gathered(&self, json: &[u8], starts: &[u64], len: u64) -> Result<Vec<u8>> {
        let OfBuffers { buffers, buffer_views } = self.parse(json)?;
        let mut changes = Vec::new();
        if let Some(buffers) = buffers {
            changes.push((span(json, buffers), format!("[{{\"byteLength\":{len}}}]")));
        }
        for (index, view) in buffer_views.iter().enumerate() {
            let number = |value: &RawValue| value.get().parse::<u64>().ok();
            let buffer = number(view.buffer).and_then(|b| starts.get(usize::try_from(b).ok()?));
            let offset = view.byte_offset.map_or(Some(0), number);
            let Some((start, offset)) = buffer.zip(offset) else {
                let what = format!("bufferView {index} is of no buffer");
                return Err(self.source.malformed(what, DAMAGED));
            };
            if *start == 0 && view.buffer.get() == "0" {
                continue;
            }
            let place = start.saturating_add(offset);
            match view.byte_offset {
                Some(old) => {
                    changes.push((span(json, view.buffer), "0".into()));
                    changes.push((span(json, old), place.to_string()));
                }
                None => changes.push((span(json, view.buffer), format!("0,\"byteOffset\":{place}"))),
            }
        }
        Ok(replaced(json, changes))
    }

    /// Returns this container with other JSON and further binary data, which begins and ends at multiples of
    /// four bytes.
    pub(super) fn with_more(mut self, text: Vec<u8>, more: SourceFile) -> Result<(Self, Vec<u8>)> {
        let old = std::mem::take(&mut self.parts);
        let (bin, end) = (self.bin.clone(), if self.bin.is_empty() { self.json.end } else { self.bin.end });
        let (mut parts, mut behind) = (Vec::new(), Vec::new());
        for part in old.into_iter().filter(|part| part.at >= self.json.end) {
            if part.at < end { parts.push(part) } else { behind.push(part) }
        }
        if parts.is_empty() && !bin.is_empty() {
            parts.push(Segment {
                at: bin.start,
                len: bin.end - bin.start,
                bytes: SegmentBytes::Opened(bin.start),
            });
            let (at, len) = (end, self.len - end);
            behind.extend((len > 0).then_some(Segment { at, len, bytes: SegmentBytes::Opened(end) }));
        }
        parts.iter_mut().for_each(|part| part.at -= bin.start);
        let at = pad(&mut parts, bin.end - bin.start);
        let len = at + more.len();
        parts.push(Segment { at, len: more.len(), bytes: SegmentBytes::File(more) });
        self.assembled(text, (parts, len), behind)
    }

    /// Container of this JSON, parts of binary data that have `len` bytes together, and the chunks behind
    /// these.
    fn assembled(
        mut self,
        mut text: Vec<u8>,
        (mut parts, len): (Vec<Segment>, u64),
        mut behind: Vec<Segment>,
    ) -> Result<(Self, Vec<u8>)> {
        text.resize(text.len().next_multiple_of(4), b' ');
        let json_end = HEADER + CHUNK + text.len() as u64;
        let total = json_end + CHUNK + len + behind.iter().map(|part| part.len).sum::<u64>();
        let Ok(whole) = u32::try_from(total) else {
            let what = format!(
                "its buffers have {}, but GLB, as which it is written, 4 GiB at most",
                human_size(len)
            );
            return Err(self.source.malformed(what, "divide the model"));
        };
        let mut head = MAGIC.to_vec();
        for word in [2, whole, text.len() as u32, JSON] {
            head.extend_from_slice(&word.to_le_bytes());
        }
        head.extend_from_slice(&text);
        [len as u32, BIN].iter().for_each(|word| head.extend_from_slice(&word.to_le_bytes()));
        self.json = HEADER + CHUNK..json_end;
        self.bin = json_end + CHUNK..json_end + CHUNK + len;
        self.len = total;
        parts.iter_mut().for_each(|part| part.at += self.bin.start);
        let mut at = self.bin.end;
        for part in &mut behind {
            part.at = at;
            at += part.len;
        }
        self.parts = vec![Segment { at: 0, len: head.len() as u64, bytes: SegmentBytes::Memory(head) }];
        self.parts.append(&mut parts);
        self.parts.append(&mut behind);
        Ok((self, text))
    }

    /// Opens the file, or decodes the data, that a buffer's URI names.
    fn buffer(&self, index: usize, uri: &str, cache: &Cache) -> Result<SourceFile> {
        let refused = |why: &str| {
            let what = format!("buffer {index} {why}");
            Err(self.source.malformed(what, AS_GLB))
        };
        if let Some(data) = uri.strip_prefix("data:") {
            let Some((_, text)) = data.split_once(";base64,") else {
                return refused("is a data URI that is not base64");
            };
            let Ok(bytes) = STANDARD.decode(text) else { return refused("is not correct base64") };
            // No more than the JSON, which is bounded.
            let scratch = cache.scratch()?;
            scratch.write_at(&bytes, 0)?;
            return Ok(SourceFile::of_scratch(scratch, self.source.path(), bytes.len() as u64));
        }
        let Some(path) = unescaped(uri).filter(|path| !path.is_absolute() && !uri.contains(':')) else {
            return refused("is not a file beside it");
        };
        let folder = crate::target::folder_of(self.source.path());
        self.source.open_beside(&folder.join(path)).map_err(|e| {
            let what = format!("buffer {index}, \"{}\": {e}", uri.escape_debug());
            self.source.malformed(what, &format!("{}; or {AS_GLB}", e.hint()))
        })
    }

    /// The JSON, or a part of it, as a type of ours.
    pub(super) fn parse<'a, T: Deserialize<'a>>(&self, json: &'a [u8]) -> Result<T> {
        serde_json::from_slice(json).map_err(|e| {
            let what = format!("its JSON makes no sense: {e}");
            Error::format(format!("{}: {what}", self.source.path().display()), DAMAGED)
        })
    }

    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// Whether the bytes are put together of segments, not those of a file as they are.
    pub(super) fn is_made(&self) -> bool {
        !self.parts.is_empty()
    }

    /// The files beside the opened one that hold its buffers.
    pub(super) fn others(&self) -> impl Iterator<Item = &Path> {
        self.parts.iter().filter_map(|part| match &part.bytes {
            SegmentBytes::File(file) if file.path() != self.source.path() => Some(file.path()),
            _ => None,
        })
    }

    /// Fills `buffer` from `offset` on; returns the number of bytes read, which is less than the buffer's
    /// length only at the end.
    pub(super) fn read_at(&self, buffer: &mut [u8], offset: u64) -> Result<usize> {
        if self.parts.is_empty() {
            return self.source.read_at(buffer, offset);
        }
        let wanted = self.len.saturating_sub(offset).min(buffer.len() as u64) as usize;
        let mut done = 0;
        while done < wanted {
            let at = offset + done as u64;
            let index = self.parts.partition_point(|part| part.at + part.len <= at);
            let Some(part) = self.parts.get(index) else { break };
            let within = at - part.at;
            let some = (wanted - done).min((part.len - within) as usize);
            let to = &mut buffer[done..done + some];
            match &part.bytes {
                SegmentBytes::Memory(bytes) => {
                    to.copy_from_slice(&bytes[within as usize..within as usize + some])
                }
                SegmentBytes::Opened(start) => drop(self.source.read_at(to, start + within)?),
                SegmentBytes::File(file) => drop(file.read_at(to, within)?),
            }
            done += some;
        }
        Ok(done)
    }

    /// Appends to `buffer` up to `count` bytes from `offset` on; returns how many, fewer only at the end.
    pub(super) fn append_at(&self, buffer: &mut Vec<u8>, offset: u64, count: usize) -> Result<usize> {
        let old = buffer.len();
        let count = self.len.saturating_sub(offset).min(count as u64) as usize;
        buffer.resize(old + count, 0);
        self.read_at(&mut buffer[old..], offset)
    }

    /// Makes `buffer` the bytes of a range within the file.
    pub(super) fn read(&self, buffer: &mut Vec<u8>, range: Range<u64>) -> Result<()> {
        // Not cleared first: filling a buffer with zeros, only to overwrite it, takes time.
        buffer.resize((range.end - range.start) as usize, 0);
        self.read_at(buffer, range.start)?;
        Ok(())
    }

    /// An error where a file is not as long any more as when it was opened.
    pub(super) fn check_unchanged(&self) -> Result<()> {
        self.source.check_unchanged()?;
        self.parts.iter().try_for_each(|part| match &part.bytes {
            SegmentBytes::File(file) => file.check_unchanged(),
            _ => Ok(()),
        })
    }
}

/// Adds zeros behind so many bytes up to a multiple of four, which is returned.
fn pad(parts: &mut Vec<Segment>, len: u64) -> u64 {
    let padding = len.next_multiple_of(4) - len;
    if padding > 0 {
        parts.push(Segment { at: len, len: padding, bytes: SegmentBytes::Memory(vec![0; padding as usize]) });
    }
    len + padding
}

/// A text with other words in some places, none of which overlap.
pub(super) fn replaced(json: &[u8], mut changes: Vec<(Range<usize>, String)>) -> Vec<u8> {
    changes.sort_by_key(|(range, _)| range.start);
    let (mut text, mut copied) = (Vec::new(), 0);
    for (range, new) in changes {
        text.extend_from_slice(&json[copied..range.start]);
        text.extend_from_slice(new.as_bytes());
        copied = range.end;
    }
    text.extend_from_slice(&json[copied..]);
    text
}

/// Four bytes as a number.
fn number(bytes: &[u8], at: usize) -> u32 {
    let mut four = [0; 4];
    four.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(four)
}

/// A relative URI as a path; `None` where an escape is wrong.
fn unescaped(uri: &str) -> Option<PathBuf> {
    let (mut bytes, mut rest) = (Vec::new(), uri.bytes());
    while let Some(byte) = rest.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let mut digit = || char::from(rest.next()?).to_digit(16);
        bytes.push((digit()? * 16 + digit()?) as u8);
    }
    String::from_utf8(bytes).ok().map(PathBuf::from)
}
