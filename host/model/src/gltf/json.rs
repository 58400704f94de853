//! Parts of a file's JSON that say where vertices and faces are, and where these are shown.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;

use serde::de::{IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::value::RawValue;

/// Most things of a kind, as nodes or accessors: a bound of the memory for them.
const MOST: usize = 1 << 20;

/// Names of extensions, or of other members that are there.
pub(super) type Names = BTreeMap<String, IgnoredAny>;

/// Accessors of a primitive by their attribute, as `POSITION`.
pub(super) type AccessorIndices = BTreeMap<String, usize>;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct GltfDocument<'a> {
    pub(super) asset: Asset,
    #[serde(borrow, default, deserialize_with = "list")]
    pub(super) accessors: Vec<Accessor<'a>>,
    #[serde(default, deserialize_with = "list")]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default, deserialize_with = "list")]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(default, deserialize_with = "list")]
    pub(super) meshes: Vec<Mesh>,
    #[serde(default, deserialize_with = "list")]
    pub(super) nodes: Vec<GltfNode>,
    #[serde(default, deserialize_with = "list")]
    pub(super) scenes: Vec<GltfScene>,
    #[serde(default, deserialize_with = "list")]
    pub(super) skins: Vec<Skin>,
    #[serde(default, deserialize_with = "list")]
    pub(super) animations: Vec<Animation>,
    #[serde(default, deserialize_with = "list")]
    pub(super) images: Vec<GltfImage>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Asset {
    pub(super) version: String,
    pub(super) min_version: Option<String>,
    pub(super) generator: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor<'a> {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) shape: String,
    #[serde(borrow)]
    pub(super) min: Option<&'a RawValue>,
    #[serde(borrow)]
    pub(super) max: Option<&'a RawValue>,
    /// Sparse part as text: it is parsed only for accessors that are patched.
    #[serde(borrow)]
    pub(super) sparse: Option<&'a RawValue>,
}

/// Elements of an accessor that stand elsewhere.
#[derive(Deserialize)]
pub(super) struct Sparse {
    pub(super) count: u64,
    pub(super) indices: SparsePart,
    pub(super) values: SparsePart,
}

/// The places of the elements that differ, or the elements themselves.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparsePart {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: Option<u32>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) byte_length: u64,
    pub(super) uri: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    #[serde(default)]
    pub(super) extensions: Names,
}

#[derive(Deserialize)]
pub(super) struct Mesh {
    #[serde(default, deserialize_with = "list")]
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: AccessorIndices,
    pub(super) indices: Option<usize>,
    pub(super) mode: Option<u32>,
    #[serde(default)]
    pub(super) targets: Vec<AccessorIndices>,
    #[serde(default)]
    pub(super) extensions: Names,
}

#[derive(Deserialize)]
pub(super) struct GltfNode {
    #[serde(default)]
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) skin: Option<usize>,
    pub(super) matrix: Option<Box<[f64; 16]>>,
    pub(super) translation: Option<Box<[f64; 3]>>,
    pub(super) rotation: Option<Box<[f64; 4]>>,
    pub(super) scale: Option<Box<[f64; 3]>>,
    #[serde(default)]
    pub(super) extensions: Names,
}

/// Nodes that are shown together, and all below them.
#[derive(Deserialize)]
pub(super) struct GltfScene {
    #[serde(default, deserialize_with = "list")]
    pub(super) nodes: Vec<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    pub(super) inverse_bind_matrices: Option<usize>,
}

#[derive(Deserialize)]
pub(super) struct Animation {
    #[serde(default)]
    pub(super) samplers: Vec<Sampler>,
}

#[derive(Deserialize)]
pub(super) struct Sampler {
    pub(super) input: usize,
    pub(super) output: usize,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct GltfImage {
    pub(super) buffer_view: Option<usize>,
}

/// Range of bytes of a value in the text that the value was read from.
pub(super) fn span(text: &[u8], value: &RawValue) -> Range<usize> {
    let start = value.get().as_ptr() as usize - text.as_ptr() as usize;
    start..start + value.get().len()
}

/// A list that is not too long.
pub(super) fn list<'de, D: Deserializer<'de>, T: Deserialize<'de>>(from: D) -> Result<Vec<T>, D::Error> {
    struct List<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for List<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a list of at most {MOST}")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut from: A) -> Result<Vec<T>, A::Error> {
            let mut all = Vec::new();
            while let Some(next) = from.next_element()? {
                if all.len() == MOST {
                    return Err(serde::de::Error::invalid_length(MOST + 1, &self));
                }
                all.push(next);
            }
            Ok(all)
        }
    }

    from.deserialize_seq(List(PhantomData))
}
