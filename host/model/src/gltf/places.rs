//! Places of the accessors' bytes in the file.

use std::ops::Range;

use super::container::Container;
use super::json::{Accessor, GltfDocument};
use crate::text::DAMAGED;
use crate::{Error, Result, Type};

/// Advice on writing a file plainly that has other things in it.
pub(super) const PLAIN: &str = "have gltfpack write it plainly: gltfpack -noq -i IN.glb -o OUT.glb";

/// Advice about an accessor whose numbers are compressed.
pub(super) const UNCOMPRESSED: &str =
    "have gltf-transform write it plainly: gltf-transform dequantize IN.glb OUT.glb";

/// Longest distance from one element to the next, by the format.
const LONGEST_STRIDE: u64 = 252;

/// The bytes of an accessor: so many elements of equal size, at equal distances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct AccessorBytes {
    /// Byte of the file at which the first element begins.
    pub(super) start: u64,
    pub(super) count: u64,
    /// Bytes from the start of one element to that of the next.
    pub(super) stride: u64,
    /// Bytes of an element.
    pub(super) size: u64,
}

impl AccessorBytes {
    /// Byte of the file behind the last element.
    pub(super) fn end(&self) -> u64 {
        if self.count == 0 { self.start } else { self.start + self.stride * (self.count - 1) + self.size }
    }

    /// Range of bytes of some elements, with the bytes between them.
    pub(super) fn bytes(&self, elements: Range<u64>) -> Range<u64> {
        if elements.is_empty() {
            return self.start..self.start;
        }
        let start = self.start + self.stride * elements.start;
        start..start + self.stride * (elements.end - elements.start - 1) + self.size
    }

    /// Whether some byte belongs to both accessors.
    pub(super) fn touches(&self, other: &Self) -> bool {
        if self.count == 0 || other.count == 0 || self.end() <= other.start || other.end() <= self.start {
            return false;
        }
        // Between each other, as where attributes are interleaved.
        let phase = (other.start + self.stride - self.start % self.stride) % self.stride;
        let apart = phase >= self.size && phase + other.size <= self.stride;
        self.stride != other.stride || !apart
    }
}

/// The type of the numbers of a component type.
pub(super) fn number_type(component: u32) -> Option<Type> {
    Some(match component {
        5120 => Type::I8,
        5121 => Type::U8,
        5122 => Type::I16,
        5123 => Type::U16,
        5125 => Type::U32,
        5126 => Type::F32,
        _ => return None,
    })
}

/// Count of the numbers in an element.
pub(super) fn numbers(shape: &str) -> Option<u64> {
    Some(match shape {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" | "MAT2" => 4,
        "MAT3" => 9,
        "MAT4" => 16,
        _ => return None,
    })
}

/// The accessors of a document.
pub(super) struct Accessors<'a> {
    pub(super) container: &'a Container,
    pub(super) document: &'a GltfDocument<'a>,
}

impl Accessors<'_> {
    pub(super) fn malformed(&self, what: impl std::fmt::Display) -> Error {
        self.container.source.malformed(what, DAMAGED)
    }

    pub(super) fn accessor(&self, index: usize) -> Result<&Accessor<'_>> {
        let accessors = &self.document.accessors;
        accessors
            .get(index)
            .ok_or_else(|| self.malformed(format_args!("accessor {index} of {}", accessors.len())))
    }

    /// The bytes of a view within the file.
    pub(super) fn view(&self, index: usize) -> Result<Range<u64>> {
        let views = &self.document.buffer_views;
        let Some(view) = views.get(index) else {
            return Err(self.malformed(format_args!("bufferView {index} of {}", views.len())));
        };
        let bin = &self.container.bin;
        let there = bin.end - bin.start;
        let Some(buffer) = self.document.buffers.get(view.buffer) else {
            return Err(self.malformed(format_args!(
                "bufferView {index} is of buffer {}, which is not there",
                view.buffer
            )));
        };
        // All other buffers have become this one.
        if view.buffer > 0 || buffer.byte_length > there {
            let (is, says) = (view.buffer, buffer.byte_length);
            return Err(self
                .malformed(format_args!("buffer {is} says {says} bytes, but the binary data has {there}")));
        }
        let end = view.byte_offset.checked_add(view.byte_length);
        let Some(end) = end.filter(|end| *end <= buffer.byte_length) else {
            return Err(self.malformed(format_args!(
                "bufferView {index} says {} bytes from {} on, but buffer {} has {}",
                view.byte_length, view.byte_offset, view.buffer, buffer.byte_length
            )));
        };
        Ok(bin.start + view.byte_offset..bin.start + end)
    }

    /// Place of an accessor's bytes; `None` for an accessor without bytes of its own.
    pub(super) fn place(&self, index: usize) -> Result<Option<AccessorBytes>> {
        let accessor = self.accessor(index)?;
        let size = number_type(accessor.component_type).zip(numbers(&accessor.shape));
        let Some((kind, numbers)) = size else {
            return Err(self.malformed(format_args!(
                "accessor {index} is of type \"{}\", component type {}",
                accessor.shape.escape_debug(),
                accessor.component_type
            )));
        };
        let (bytes, is_matrix) = (kind.size() as u64, accessor.shape.starts_with("MAT"));
        // Columns of matrices begin at multiples of four.
        let size = match numbers {
            4 if is_matrix => 2 * (2 * bytes).next_multiple_of(4),
            9 => 3 * (3 * bytes).next_multiple_of(4),
            _ => numbers * bytes,
        };
        let Some(view) = accessor.buffer_view else { return Ok(None) };
        let bytes = self.view(view)?;
        let stride = self.document.buffer_views[view].byte_stride.unwrap_or(size);
        if stride < size || stride > LONGEST_STRIDE.max(size) {
            return Err(self.malformed(format_args!(
                "bufferView {view} has a byteStride of {stride}, but accessor {index} elements of {size} bytes"
            )));
        }
        let room = (bytes.end - bytes.start).checked_sub(accessor.byte_offset);
        let fits = |room: &u64| match accessor.count {
            0 => true,
            count => {
                (count - 1).checked_mul(stride).and_then(|n| n.checked_add(size)).is_some_and(|n| n <= *room)
            }
        };
        if room.filter(fits).is_none() {
            return Err(self.malformed(format_args!(
                "accessor {index} says {} elements of {size} bytes, {stride} apart, from byte {} on, but bufferView {view} has {} bytes",
                accessor.count,
                accessor.byte_offset,
                bytes.end - bytes.start
            )));
        }
        // One element has no distance.
        let stride = if accessor.count > 1 { stride } else { size };
        Ok(Some(AccessorBytes {
            start: bytes.start + accessor.byte_offset,
            count: accessor.count,
            stride,
            size,
        }))
    }

    /// Place of the bytes of an accessor whose numbers are to be changed, which have to be floats with all
    /// their bytes in the file.
    pub(super) fn place_of(&self, index: usize, what: &str, shape: &str) -> Result<AccessorBytes> {
        let accessor = self.accessor(index)?;
        let refused = |why: &str, hint: &str| {
            let what = format!("accessor {index} ({what}) {why}");
            Err(self.container.source.malformed(what, hint))
        };
        if accessor.component_type != 5126 {
            return refused("is quantised (KHR_mesh_quantization)", UNCOMPRESSED);
        }
        if accessor.shape != shape {
            return refused(&format!("is of type {}, not {shape}", accessor.shape.escape_debug()), DAMAGED);
        }
        match self.place(index)? {
            Some(place) => Ok(place),
            None => refused("has no data", PLAIN),
        }
    }
}
