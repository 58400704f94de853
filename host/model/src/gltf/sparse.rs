//! Sparse accessors of vertices and indices, made plain: all their elements, one after the other, as further
//! binary data, and JSON that refers to these. The sparse data stay where they are.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::value::RawValue;

use super::container::Container;
use super::json::{GltfDocument, Sparse, SparsePart, list, span};
use super::places::{Accessors, PLAIN, number_type};
use crate::cache::{CachedContent, Making};
use crate::scratch::Scratch;
use crate::size::human_size;
use crate::source::SourceFile;
use crate::{CHUNK_VERTICES, Result};

/// Attributes of a primitive that are patched.
const PATCHED: [&str; 3] = ["POSITION", "NORMAL", "TANGENT"];

/// The lists of the JSON that change, as text.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Changed<'a> {
    #[serde(borrow)]
    buffers: &'a RawValue,
    #[serde(borrow)]
    buffer_views: &'a RawValue,
    #[serde(borrow, deserialize_with = "list")]
    accessors: Vec<&'a RawValue>,
}

/// Returns the file with no sparse accessor, its JSON, and whether it had any: otherwise the file is the
/// same.
pub(super) fn made_plain(
    container: Container,
    json: Vec<u8>,
    making: &Making<'_>,
) -> Result<(Container, Vec<u8>, bool)> {
    let document: GltfDocument<'_> = container.parse(&json)?;
    let places = Accessors { container: &container, document: &document };
    let sparse = places.sparse();
    if sparse.is_empty() {
        return Ok((container, json, false));
    }
    places.check_uncompressed()?;
    let mut bytes = 0u64;
    let mut starts = Vec::new();
    for index in &sparse {
        starts.push((*index, bytes));
        bytes = bytes.saturating_add(places.plain_bytes(*index)?.next_multiple_of(4));
    }
    if container.len().saturating_add(bytes) > u64::from(u32::MAX) {
        let what =
            format!("its sparse accessors take {} as plain ones, and GLB has 4 GiB", human_size(bytes));
        return Err(container.source.malformed(what, PLAIN));
    }
    let fill = |to: &Scratch| -> Result<u64> {
        for (index, start) in &starts {
            places.write_plain(*index, to, *start)?;
        }
        to.set_len(bytes)?;
        Ok(bytes)
    };
    let need = CachedContent {
        what: "its sparse accessors are written plainly",
        bytes: bytes..=bytes,
        meanwhile: 0,
    };
    let plain = if container.is_made() {
        // A cache is known by the hash of the file alone, which does not tell the content of buffers
        // elsewhere.
        let scratch = making.cache.scratch()?;
        fill(&scratch)?;
        SourceFile::of_scratch(scratch, container.source.path(), bytes)
    } else {
        making.cache.get(&container.source, &need, making.progress, fill)?
    };
    let before = container.bin.end - container.bin.start;
    let text = with_views(&container, &json, &starts, (before.next_multiple_of(4), &plain))?;
    let (container, json) = container.with_more(text, plain)?;
    Ok((container, json, true))
}

/// JSON in which these accessors have views of their own, each from some byte of further data on.
fn with_views(
    container: &Container,
    json: &[u8],
    starts: &[(usize, u64)],
    (before, plain): (u64, &SourceFile),
) -> Result<Vec<u8>> {
    let Changed { buffers, buffer_views, accessors } = container.parse(json)?;
    let views: Vec<&RawValue> = container.parse(buffer_views.get().as_bytes())?;
    let mut more = String::new();
    let mut changes = vec![(span(json, buffers), format!("[{{\"byteLength\":{}}}]", before + plain.len()))];
    let ends = starts.iter().skip(1).map(|(_, start)| *start).chain([plain.len()]);
    for (number, ((index, start), end)) in starts.iter().zip(ends).enumerate() {
        let length = end - start;
        more += &format!(",{{\"buffer\":0,\"byteOffset\":{},\"byteLength\":{length}}}", before + start);
        let mut accessor: BTreeMap<String, &RawValue> =
            container.parse(accessors[*index].get().as_bytes())?;
        for key in ["sparse", "byteOffset", "bufferView"] {
            accessor.remove(key);
        }
        let mut text = format!("{{\"bufferView\":{}", views.len() + number);
        for (key, value) in accessor {
            let key = serde_json::Value::from(key);
            text += &format!(",{key}:{value}");
        }
        changes.push((span(json, accessors[*index]), text + "}"));
    }
    let end = span(json, buffer_views).end - 1;
    changes.push((end..end, more));
    Ok(super::container::replaced(json, changes))
}

impl Accessors<'_> {
    /// Sparse accessors of vertices and corners, in their order.
    fn sparse(&self) -> Vec<usize> {
        let mut all = Vec::new();
        for primitive in self.document.meshes.iter().flat_map(|mesh| &mesh.primitives) {
            let patched = primitive.attributes.iter().filter(|(name, _)| PATCHED.contains(&name.as_str()));
            all.extend(patched.map(|(_, index)| *index).chain(primitive.indices));
        }
        let is_sparse =
            |index: &usize| self.document.accessors.get(*index).is_some_and(|of| of.sparse.is_some());
        all.retain(is_sparse);
        all.sort_unstable();
        all.dedup();
        all
    }

    /// Bytes that a sparse accessor takes as a plain one.
    fn plain_bytes(&self, index: usize) -> Result<u64> {
        match self.place(index)? {
            Some(place) => Ok(place.count * place.size),
            None => {
                let what = format!("accessor {index} is sparse, and has no data beneath");
                Err(self.container.source.malformed(what, PLAIN))
            }
        }
    }

    /// Writes all elements of a sparse accessor.
    fn write_plain(&self, index: usize, to: &Scratch, start: u64) -> Result<()> {
        let (Some(place), Some(sparse)) = (self.place(index)?, self.accessor(index)?.sparse) else {
            return Ok(());
        };
        let sparse: Sparse = serde_json::from_str(sparse.get()).map_err(|e| {
            self.malformed(format_args!("what is sparse of accessor {index} makes no sense: {e}"))
        })?;
        let (mut raw, mut plain) = (Vec::new(), Vec::new());
        let step = CHUNK_VERTICES as u64;
        for first in (0..place.count).step_by(CHUNK_VERTICES) {
            self.container.read(&mut raw, place.bytes(first..(first + step).min(place.count)))?;
            plain.clear();
            raw.chunks(place.stride as usize).for_each(|row| plain.extend(&row[..place.size as usize]));
            to.write_at(&plain, start + first * place.size)?;
        }
        self.write_others(index, &sparse, (place.count, place.size), to, start)
    }

    /// Writes the elements that a sparse accessor has instead of some of `count` ones of `size` bytes.
    fn write_others(
        &self,
        index: usize,
        Sparse { count: others, indices, values }: &Sparse,
        (count, size): (u64, u64),
        to: &Scratch,
        start: u64,
    ) -> Result<()> {
        let kind =
            indices.component_type.filter(|kind| [5121, 5123, 5125].contains(kind)).and_then(number_type);
        let Some(width) = kind.map(|kind| kind.size() as u64) else {
            return Err(
                self.malformed(format_args!("the sparse indices of accessor {index} are no whole numbers"))
            );
        };
        let of_indices = self.run(index, indices, (*others, width))?;
        let of_values = self.run(index, values, (*others, size))?;
        let (mut numbers, mut elements, mut next) = (Vec::new(), Vec::new(), 0);
        for first in (0..*others).step_by(CHUNK_VERTICES) {
            let some = (others - first).min(CHUNK_VERTICES as u64);
            self.container
                .read(&mut numbers, of_indices + first * width..of_indices + (first + some) * width)?;
            self.container
                .read(&mut elements, of_values + first * size..of_values + (first + some) * size)?;
            for (number, element) in
                numbers.chunks_exact(width as usize).zip(elements.chunks_exact(size as usize))
            {
                let place = number.iter().rev().fold(0, |all, byte| all << 8 | u64::from(*byte));
                if !(next..count).contains(&place) {
                    let what = format!(
                        "accessor {index} has {count} elements, but its sparse indices have {place} behind {next} others"
                    );
                    return Err(self.malformed(what));
                }
                to.write_at(element, start + place * size)?;
                next = place + 1;
            }
        }
        Ok(())
    }

    /// Byte at which the elements of a part of a sparse accessor begin, of which there are `count`, of `size`
    /// bytes each.
    fn run(&self, index: usize, part: &SparsePart, (count, size): (u64, u64)) -> Result<u64> {
        let bytes = self.view(part.buffer_view)?;
        let start = bytes.start.checked_add(part.byte_offset);
        let end = count.checked_mul(size).and_then(|all| all.checked_add(start?));
        start.filter(|_| end.is_some_and(|end| end <= bytes.end)).ok_or_else(|| {
            self.malformed(format_args!(
                "accessor {index} says {count} sparse elements, but bufferView {} has no room for them",
                part.buffer_view
            ))
        })
    }
}
