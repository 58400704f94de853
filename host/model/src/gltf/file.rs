//! A glTF file once it is open.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::value::RawValue;

use super::container::Container;
use super::json::GltfDocument;
use super::layout::{FACE, GltfLayout};
use super::limits::AccessorLimits;
use super::places::{AccessorBytes, Accessors, number_type};
use super::sparse::made_plain;
use crate::cache::Making;
use crate::source::SourceFile;
use crate::{Attribute, Error, ModelInfo, Result, Scalar};

/// Longest name of the program that made a file, as it is shown.
const LONGEST_NAME: usize = 80;

/// A file, open.
#[derive(Debug)]
pub(super) struct GltfModel {
    pub(super) container: Container,
    /// Buffers were elsewhere.
    pub(super) is_gathered: bool,
    /// Sparse accessors have become plain.
    pub(super) had_sparse: bool,
    pub(super) layout: GltfLayout,
    pub(super) limits: AccessorLimits,
    pub(super) info: ModelInfo,
}

/// Mesh of which only the attributes' names of its primitives are read.
#[derive(Deserialize)]
struct OnlyPrimitives {
    #[serde(default)]
    primitives: Vec<NamedAccessors>,
}

#[derive(Deserialize)]
struct NamedAccessors {
    #[serde(default)]
    attributes: BTreeMap<String, IgnoredAny>,
    targets: Option<IgnoredAny>,
}

/// Lists of a document that hold what other formats do not.
const LISTS: [&str; 7] =
    ["materials", "textures", "images", "animations", "skins", "cameras", "extensionsUsed"];

/// Attributes of primitives that are read.
const READ: [&str; 3] = ["POSITION", "NORMAL", "COLOR_0"];

impl GltfModel {
    /// Content of the document that is not given as vertices and faces, in a few words each.
    pub(super) fn not_read(&self) -> Result<Vec<String>> {
        let mut json = Vec::new();
        self.container.read(&mut json, self.container.json.clone())?;
        let document: BTreeMap<String, &RawValue> = self.container.parse(&json)?;
        let list = |name: &str| -> Vec<&RawValue> {
            document.get(name).and_then(|list| serde_json::from_str(list.get()).ok()).unwrap_or_default()
        };
        let mut found = Vec::new();
        for name in LISTS {
            match list(name).len() {
                0 => {}
                count => found.push(format!("{count} {name}")),
            }
        }
        if list("nodes").len() > 1 {
            found.push(format!("that there are {} nodes", list("nodes").len()));
        }
        let mut others = BTreeSet::new();
        for mesh in list("meshes") {
            let mesh: OnlyPrimitives = self.container.parse(mesh.get().as_bytes())?;
            for primitive in mesh.primitives {
                others.extend(primitive.attributes.into_keys().filter(|name| !READ.contains(&name.as_str())));
                if primitive.targets.is_some() {
                    others.insert("morph targets".to_owned());
                }
            }
        }
        found.extend(others.into_iter().map(|name| format!("the attribute {name}")));
        Ok(found)
    }

    pub(super) fn new(source: SourceFile, making: &Making<'_>) -> Result<Self> {
        let (container, json) = Container::open(source, making.cache)?;
        let is_gathered = container.is_made();
        let (container, json, had_sparse) = made_plain(container, json, making)?;
        let document: GltfDocument<'_> = container.parse(&json)?;
        check_version(&container, &document)?;
        let layout = Accessors { container: &container, document: &document }.layout()?;
        if layout.sets.is_empty() && !document.meshes.is_empty() {
            let what = "none of its nodes shows a mesh with positions";
            return Err(container.source.malformed(what, "export the model with its scene"));
        }
        let limits = AccessorLimits::from_accessor(&json, &document, &layout, &container)?;
        let info = info(&container, is_gathered, &document, &layout);
        Ok(Self { container, is_gathered, had_sparse, layout, limits, info })
    }
}

fn check_version(container: &Container, document: &GltfDocument<'_>) -> Result<()> {
    let asset = &document.asset;
    let is_known = asset.version.split('.').next() == Some("2")
        && asset.min_version.as_ref().is_none_or(|version| version == "2.0");
    if is_known {
        return Ok(());
    }
    let version = asset.min_version.as_ref().unwrap_or(&asset.version);
    Err(Error::format(
        format!(
            "{}: glTF of version \"{}\", where 2.0 can be read",
            container.source.path().display(),
            version.escape_debug()
        ),
        "export the model as glTF 2.0",
    ))
}

fn info(
    container: &Container,
    is_gathered: bool,
    document: &GltfDocument<'_>,
    layout: &GltfLayout,
) -> ModelInfo {
    let is_placed = layout.sets.iter().any(|set| set.placement.is_some());
    let has_normals = !layout.sets.is_empty() && layout.sets.iter().all(|set| set.normals.is_some());
    let attributes = colours(layout);
    let mut other_properties: Vec<String> = layout.others.iter().cloned().collect();
    other_properties.extend(layout.has_targets.then(|| "morph targets".into()));
    other_properties.extend(layout.has_skins.then(|| "skins".into()));
    let regions = layout.regions.iter().filter(|region| region.has_positions());
    ModelInfo {
        format: format(is_gathered, document, layout),
        vertices: layout.vertices,
        faces: layout.triangles,
        has_normals,
        // Elsewhere than in the world's coordinates, single precision is another one.
        position_type: if is_placed { Scalar::F64 } else { Scalar::F32 },
        other_properties,
        attributes,
        bytes: container.len(),
        vertex_bytes: regions.map(|region| region.bytes.end - region.bytes.start).sum(),
        face_bytes: FACE * layout.triangles,
        ..ModelInfo::default()
    }
}

/// The format for people.
fn format(is_gathered: bool, document: &GltfDocument<'_>, layout: &GltfLayout) -> String {
    let kind = if is_gathered { "with separate buffers" } else { "binary" };
    let meshes = layout.meshes;
    let mut format = format!(
        "glTF {}, {kind}, {meshes} mesh{}",
        document.asset.version,
        if meshes == 1 { "" } else { "es" }
    );
    if let Some(generator) = &document.asset.generator {
        let name: String = generator.chars().filter(|c| !c.is_control()).take(LONGEST_NAME).collect();
        format += &format!(", by {name}");
    }
    format
}

/// The vertices' colours, if all of them have some of the same type.
fn colours(layout: &GltfLayout) -> Vec<Attribute> {
    let of = |colours: Option<(AccessorBytes, u32)>| {
        let (place, component) = colours?;
        let kind = number_type(component)?;
        Some((kind, place.size / kind.size() as u64))
    };
    let mut all = layout.sets.iter().map(|set| of(set.colours));
    let Some(Some((kind, mut numbers))) = all.next() else { return Vec::new() };
    for other in all {
        match other {
            Some((other, count)) if other == kind => numbers = numbers.min(count),
            _ => return Vec::new(),
        }
    }
    let names = ["red", "green", "blue", "alpha"];
    names.iter().take(numbers as usize).map(|name| Attribute { name: (*name).into(), kind }).collect()
}
