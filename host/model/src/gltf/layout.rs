//! The bytes of a file that are positions, normals and tangents, and the vertices that they belong to.
//!
//! The vertices are the elements of all position accessors that a node shows: each run of bytes counts once,
//! however many use it, and vertices are numbered in the order of the file. Bytes that are patched lie in
//! *regions*: rows of equal length with a position, a normal or a tangent of a vertex in each, or several of
//! them.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::json::{GltfNode, Names, Primitive};
use super::nodes::MeshPose;
use super::places::{AccessorBytes, Accessors, PLAIN, UNCOMPRESSED};
use crate::Result;

const APART: &str =
    "have gltfpack write it anew, which gives everything its own data: gltfpack -noq -i IN.glb -o OUT.glb";
const SINGLE: &str = "make each of them a mesh of its own, as by \"Make Single User\" in Blender, or: gltf-transform join IN.glb OUT.glb";
const SEPARATE: &str =
    "export it with a mesh of its own for each copy, as Blender does after \"Make Single User\"";

/// Bytes that a triangle counts as: three indices. Marks count so from the first one on, as strips and
/// vertices without indices have no place of their own for each triangle.
pub(super) const FACE: u64 = 12;

/// Extensions by which a mesh' bytes are compressed, of primitives and of views.
const COMPRESSED: [&str; 3] =
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

const INSTANCED: &str = "EXT_mesh_gpu_instancing";

/// Meaning of an element of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum VectorRole {
    Position,
    Normal,
    Tangent,
}

/// Vertices whose positions one accessor has, or several that are the same.
#[derive(Debug)]
pub(super) struct VertexSet {
    pub(super) place: AccessorBytes,
    /// Number of the first vertex.
    pub(super) first: u64,
    /// Placement of the mesh in the world; none if the mesh is not transformed.
    pub(super) placement: Option<MeshPose>,
    /// The region where the positions are.
    pub(super) region: usize,
    /// Normals that belong to the positions: the first ones, if several primitives have others.
    pub(super) normals: Option<AccessorBytes>,
    /// Colours, and the component type of their numbers.
    pub(super) colours: Option<(AccessorBytes, u32)>,
}

/// Rows of equal length, one for each vertex.
#[derive(Debug)]
pub(super) struct VertexRows {
    pub(super) bytes: Range<u64>,
    pub(super) stride: u64,
    pub(super) rows: u64,
    /// Elements of a row, and the byte of the row at which each begins: no two of a kind.
    pub(super) elements: Vec<(VectorRole, usize)>,
    /// Sets whose rows the region has: one, or several if they share normals or tangents.
    pub(super) owners: Vec<usize>,
}

impl VertexRows {
    /// Range of the bytes of some rows, without the rest of the last row behind its elements.
    pub(super) fn window(&self, rows: Range<u64>) -> Range<u64> {
        let start = self.bytes.start + self.stride * rows.start;
        let end =
            if rows.end >= self.rows { self.bytes.end } else { self.bytes.start + self.stride * rows.end };
        start..end
    }

    /// Byte of a row at which its element of this kind begins, if it has one.
    pub(super) fn offset(&self, kind: VectorRole) -> Option<usize> {
        self.elements.iter().find(|(of, _)| *of == kind).map(|(_, offset)| *offset)
    }

    /// The number of an element of a region as a part of the file.
    pub(super) fn part(region: usize, element: usize) -> u32 {
        // There are three kinds.
        (4 * region + element) as u32
    }

    pub(super) fn has_positions(&self) -> bool {
        self.offset(VectorRole::Position).is_some()
    }
}

/// Topology of a primitive: the way in which its vertices make triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PrimitiveMode {
    Triangles,
    Strip,
    Fan,
    /// Points, lines: no triangles.
    Other,
}

/// Primitive: a part of a mesh that is drawn at once.
#[derive(Debug)]
pub(super) struct DrawnPrimitive {
    /// Number of the primitive's first triangle.
    pub(super) first: u64,
    pub(super) triangles: u64,
    pub(super) mode: PrimitiveMode,
    /// The vertices of the primitive, by the place of their set.
    pub(super) set: usize,
    /// Indices of corners, if they are not simply the vertices.
    pub(super) indices: Option<AccessorBytes>,
    pub(super) is_mirrored: bool,
}

/// The layout of a file: its vertices, what shows them, and the bytes that are patched.
#[derive(Debug, Default)]
pub(super) struct GltfLayout {
    /// Sets of vertices, in the order of the file.
    pub(super) sets: Vec<VertexSet>,
    pub(super) regions: Vec<VertexRows>,
    pub(super) drawn: Vec<DrawnPrimitive>,
    pub(super) vertices: u64,
    pub(super) triangles: u64,
    /// Accessors that are patched, and which part of the file each is.
    pub(super) accessors: Vec<(usize, u32)>,
    /// Other attributes of the vertices, as "float TEXCOORD_0".
    pub(super) others: BTreeSet<String>,
    pub(super) has_targets: bool,
    pub(super) has_skins: bool,
    /// Number of meshes that are shown.
    pub(super) meshes: usize,
}

/// A layout while it is found.
#[derive(Default)]
struct LayoutBuilder {
    /// Positions that were found, by the place of their accessor.
    sets: BTreeMap<AccessorBytes, FoundPositions>,
    /// Streams of normals and tangents, with the places of the positions that they belong to.
    streams: BTreeMap<(AccessorBytes, VectorRole), BTreeSet<AccessorBytes>>,
    layout: GltfLayout,
    /// Mode, positions, indices.
    drawn: Vec<(PrimitiveMode, AccessorBytes, Option<AccessorBytes>)>,
    /// Accessors that are patched.
    accessors: BTreeMap<usize, (AccessorBytes, VectorRole)>,
    /// Accessors whose bytes are kept, each with a description.
    kept: BTreeMap<usize, String>,
}

/// Positions that were found.
struct FoundPositions {
    placement: Option<MeshPose>,
    /// Node that shows the positions.
    node: usize,
    normals: Option<AccessorBytes>,
    colours: Option<(AccessorBytes, u32)>,
}

/// Attribute of vertices at known positions: an accessor of as many numbers.
struct VertexAttribute<'a> {
    positions: AccessorBytes,
    /// The attribute's name, as `NORMAL`.
    attribute: &'a str,
    accessor: usize,
    /// Name of the primitive in errors.
    primitive: &'a dyn Fn() -> String,
}

impl Accessors<'_> {
    /// Finds out where everything is.
    pub(super) fn layout(&self) -> Result<GltfLayout> {
        let document = self.document;
        // Compression is checked first, as compressed content looks damaged otherwise.
        self.check_uncompressed()?;
        for index in 0..document.accessors.len() {
            self.place(index)?;
        }
        for (index, mesh) in document.nodes.iter().enumerate().filter_map(|(i, node)| Some((i, node.mesh?))) {
            if mesh >= document.meshes.len() {
                let what = format!("node {index} shows mesh {mesh}, of {}", document.meshes.len());
                return Err(self.malformed(what));
            }
        }
        let mut builder = LayoutBuilder::default();
        let mut shown: BTreeMap<usize, (usize, Option<MeshPose>)> = BTreeMap::new();
        for (index, placement) in self.placements()? {
            let node = &document.nodes[index];
            let Some(mesh) = node.mesh else { continue };
            self.check_node(index, node)?;
            builder.layout.has_skins |= node.skin.is_some();
            match shown.entry(mesh) {
                Entry::Vacant(entry) => drop(entry.insert((index, placement))),
                Entry::Occupied(entry) if entry.get().1 == placement => continue,
                Entry::Occupied(entry) => {
                    let other = entry.get().0;
                    let what = format!(
                        "nodes {other} and {index} show mesh {mesh} at two places, where it would need two shapes"
                    );
                    return Err(self.container.source.malformed(what, SINGLE));
                }
            }
            for (number, primitive) in document.meshes[mesh].primitives.iter().enumerate() {
                let name = || format!("mesh {mesh}, primitive {number}");
                self.add(&mut builder, primitive, (index, placement), &name)?;
            }
        }
        builder.layout.meshes = shown.len();
        self.keep_others(&mut builder);
        self.finish(builder)
    }

    /// An error where something is compressed.
    pub(super) fn check_uncompressed(&self) -> Result<()> {
        for (index, view) in self.document.buffer_views.iter().enumerate() {
            self.check_plain(&view.extensions, || format!("bufferView {index}"))?;
        }
        for (index, mesh) in self.document.meshes.iter().enumerate() {
            for primitive in &mesh.primitives {
                self.check_plain(&primitive.extensions, || format!("mesh {index}"))?;
            }
        }
        Ok(())
    }

    fn check_plain(&self, extensions: &Names, name: impl Fn() -> String) -> Result<()> {
        match COMPRESSED.iter().find(|extension| extensions.contains_key(**extension)) {
            None => Ok(()),
            Some(extension) => {
                let what = format!("{} is compressed ({extension})", name());
                Err(self.container.source.malformed(what, UNCOMPRESSED))
            }
        }
    }

    fn check_node(&self, index: usize, node: &GltfNode) -> Result<()> {
        if node.extensions.contains_key(INSTANCED) {
            let what = format!("node {index} shows its mesh at many places ({INSTANCED})");
            return Err(self.container.source.malformed(what, SEPARATE));
        }
        Ok(())
    }

    /// Adds an attribute of vertices.
    fn add_attribute(&self, builder: &mut LayoutBuilder, of: &VertexAttribute<'_>) -> Result<()> {
        let VertexAttribute { positions, attribute, accessor: index, primitive } = *of;
        let accessor = self.accessor(index)?;
        if accessor.count != positions.count {
            let (name, count) = (primitive(), accessor.count);
            let what =
                format!("{name}: {count} {attribute} (accessor {index}) for {} positions", positions.count);
            return Err(self.malformed(what));
        }
        let (kind, shape) = match attribute {
            "POSITION" => return Ok(()),
            "NORMAL" => (VectorRole::Normal, "VEC3"),
            "TANGENT" => (VectorRole::Tangent, "VEC4"),
            _ => return self.add_other(builder, of),
        };
        let place = self.place_of(index, attribute, shape)?;
        if let (VectorRole::Normal, Some(found)) = (kind, builder.sets.get_mut(&positions)) {
            found.normals.get_or_insert(place);
        }
        builder.accessors.insert(index, (place, kind));
        builder.streams.entry((place, kind)).or_default().insert(positions);
        Ok(())
    }

    /// Adds an attribute that is not read, and keeps its bytes.
    fn add_other(&self, builder: &mut LayoutBuilder, of: &VertexAttribute<'_>) -> Result<()> {
        let VertexAttribute { positions, attribute, accessor: index, primitive } = *of;
        let accessor = self.accessor(index)?;
        builder.kept.entry(index).or_insert_with(|| format!("{attribute} of {}", primitive()));
        let kind = super::places::number_type(accessor.component_type).map_or("", crate::Type::name);
        builder.layout.others.insert(format!("{kind} {}", attribute.escape_debug()));
        if attribute == "COLOR_0"
            && ["VEC3", "VEC4"].contains(&accessor.shape.as_str())
            && accessor.sparse.is_none()
            && let Some(found) = builder.sets.get_mut(&positions)
        {
            found.colours = self.place(index)?.map(|place| (place, accessor.component_type));
        }
        Ok(())
    }

    /// Adds a primitive that a node shows.
    fn add(
        &self,
        builder: &mut LayoutBuilder,
        primitive: &Primitive,
        (node, placement): (usize, Option<MeshPose>),
        name: &dyn Fn() -> String,
    ) -> Result<()> {
        let Some(index) = primitive.attributes.get("POSITION") else { return Ok(()) };
        let positions = self.place_of(*index, "POSITION", "VEC3")?;
        let indices = primitive.indices.map(|index| self.indices(index)).transpose()?;
        for index in primitive.indices.iter() {
            builder.kept.entry(*index).or_insert_with(|| format!("indices of {}", name()));
        }
        for (attribute, index) in primitive.targets.iter().flatten() {
            builder.layout.has_targets = true;
            builder
                .kept
                .entry(*index)
                .or_insert_with(|| format!("{attribute} of a morph target of {}", name()));
        }
        if positions.count == 0 {
            return Ok(());
        }
        builder.accessors.insert(*index, (positions, VectorRole::Position));
        let found = FoundPositions { placement, node, normals: None, colours: None };
        let found = builder.sets.entry(positions).or_insert(found);
        if found.placement != placement {
            let what = format!(
                "nodes {} and {node} show the positions of accessor {index} at two places, where they would need two shapes",
                found.node
            );
            return Err(self.container.source.malformed(what, SINGLE));
        }
        for (attribute, index) in &primitive.attributes {
            let of = VertexAttribute { positions, attribute, accessor: *index, primitive: name };
            self.add_attribute(builder, &of)?;
        }
        let mode = match primitive.mode {
            None | Some(4) => PrimitiveMode::Triangles,
            Some(5) => PrimitiveMode::Strip,
            Some(6) => PrimitiveMode::Fan,
            Some(0..=3) => PrimitiveMode::Other,
            Some(mode) => return Err(self.malformed(format_args!("{} is of mode {mode}", name()))),
        };
        builder.drawn.push((mode, positions, indices));
        Ok(())
    }

    /// Place of the indices of a primitive.
    fn indices(&self, index: usize) -> Result<AccessorBytes> {
        let accessor = self.accessor(index)?;
        let place = self.place(index)?;
        let is_index = accessor.shape == "SCALAR" && [5121, 5123, 5125].contains(&accessor.component_type);
        match place {
            _ if !is_index => Err(self.malformed(format_args!(
                "accessor {index} (indices) is of type {}, component type {}",
                accessor.shape.escape_debug(),
                accessor.component_type
            ))),
            Some(place) => Ok(place),
            None => Err(self
                .container
                .source
                .malformed(format_args!("accessor {index} (indices) has no data"), PLAIN)),
        }
    }

    /// Notes all accessors that have to keep their bytes, beside those of vertices.
    fn keep_others(&self, builder: &mut LayoutBuilder) {
        let document = self.document;
        for (index, skin) in document.skins.iter().enumerate() {
            if let Some(accessor) = skin.inverse_bind_matrices {
                builder.kept.entry(accessor).or_insert_with(|| format!("matrices of skin {index}"));
            }
        }
        for (index, animation) in document.animations.iter().enumerate() {
            for accessor in animation.samplers.iter().flat_map(|sampler| [sampler.input, sampler.output]) {
                builder.kept.entry(accessor).or_insert_with(|| format!("numbers of animation {index}"));
            }
        }
    }

    fn finish(&self, builder: LayoutBuilder) -> Result<GltfLayout> {
        let LayoutBuilder { sets, streams, mut layout, drawn, accessors, kept } = builder;
        // Numbers of the sets in the order of the bytes at which they begin.
        let numbers: BTreeMap<AccessorBytes, usize> =
            sets.keys().enumerate().map(|(number, place)| (*place, number)).collect();
        let number = |place: &AccessorBytes| numbers.get(place).copied().unwrap_or_default();
        for (place, found) in &sets {
            let FoundPositions { placement, normals, colours, .. } = *found;
            let (place, first, region) = (*place, layout.vertices, 0);
            layout.vertices += place.count;
            layout.sets.push(VertexSet { place, first, placement, region, normals, colours });
        }
        let mut all: Vec<ElementRun> =
            sets.keys().map(|place| (*place, VectorRole::Position, vec![number(place)])).collect();
        all.extend(
            streams.iter().map(|((place, kind), of)| (*place, *kind, of.iter().map(number).collect())),
        );
        all.sort();
        self.regions(&all, &mut layout)?;
        for (index, region) in layout.regions.iter().enumerate() {
            if region.has_positions() {
                region.owners.iter().for_each(|set| layout.sets[*set].region = index);
            }
        }
        self.check_kept(&kept, &all)?;
        for (mode, positions, indices) in drawn {
            let corners = indices.map_or(positions.count, |indices| indices.count);
            let triangles = match mode {
                PrimitiveMode::Triangles => corners / 3,
                PrimitiveMode::Strip | PrimitiveMode::Fan => corners.saturating_sub(2),
                PrimitiveMode::Other => 0,
            };
            let (first, set) = (layout.triangles, number(&positions));
            layout.triangles += triangles;
            let is_mirrored = layout.sets[set].placement.is_some_and(|placement| placement.is_mirrored());
            layout.drawn.push(DrawnPrimitive { first, triangles, mode, set, indices, is_mirrored });
        }
        let part = |(place, kind): &(AccessorBytes, VectorRole)| {
            let region = layout.regions.partition_point(|region| region.bytes.end <= place.start);
            let element = layout.regions.get(region)?.elements.iter().position(|(of, _)| of == kind)?;
            Some(VertexRows::part(region, element))
        };
        layout.accessors = accessors.iter().filter_map(|(index, of)| Some((*index, part(of)?))).collect();
        Ok(layout)
    }

    /// Gathers streams that are interleaved in regions; `all` is sorted.
    fn regions(&self, all: &[ElementRun], layout: &mut GltfLayout) -> Result<()> {
        let mut rest = all;
        while let Some(((first, _, _), _)) = rest.split_first() {
            let mut end = first.end();
            let mut count = 1;
            while let Some((place, _, _)) = rest.get(count).filter(|(place, _, _)| place.start < end) {
                end = end.max(place.end());
                count += 1;
            }
            let (these, others) = rest.split_at(count);
            rest = others;
            let elements = self.row(these)?;
            let AccessorBytes { start, stride, count, .. } = *first;
            // Positions have a single owner.
            let owners = these[0].2.clone();
            layout.regions.push(VertexRows { bytes: start..end, stride, rows: count, elements, owners });
        }
        Ok(())
    }

    /// Elements of a row of streams that are interleaved.
    fn row(&self, these: &[ElementRun]) -> Result<Vec<(VectorRole, usize)>> {
        let (first, _, owners) = &these[0];
        let mut elements: Vec<(VectorRole, usize)> = Vec::new();
        let mut end = 0;
        for (place, kind, of) in these {
            let offset = place.start - first.start;
            let is_beside = offset >= end && offset + place.size <= first.stride;
            let is_alike = place.stride == first.stride && place.count == first.count;
            let is_other = elements.iter().all(|(other, _)| other != kind);
            end = offset + place.size;
            if !(is_beside && is_alike && is_other && of == owners) {
                let name = |kind| match kind {
                    VectorRole::Position => "positions",
                    VectorRole::Normal => "normals",
                    VectorRole::Tangent => "tangents",
                };
                let what = format!(
                    "the {} from byte {} on and the {} from byte {} on lie over or between each other, and are not of the same vertices",
                    name(these[0].1),
                    first.start,
                    name(*kind),
                    place.start
                );
                return Err(self.container.source.malformed(what, APART));
            }
            elements.push((*kind, offset as usize));
        }
        Ok(elements)
    }

    /// Error where bytes that change belong to an accessor that does not, too.
    fn check_kept(&self, kept: &BTreeMap<usize, String>, all: &[ElementRun]) -> Result<()> {
        // Largest end of all streams up to each one, in the order of their starts.
        let mut ends = Vec::with_capacity(all.len());
        let mut furthest = 0;
        for (place, _, _) in all {
            furthest = furthest.max(place.end());
            ends.push(furthest);
        }
        let check = |other: &AccessorBytes, name: &dyn Fn() -> String| -> Result<()> {
            let first = ends.partition_point(|end| *end <= other.start);
            let near = all[first..].iter().take_while(|(place, _, _)| place.start < other.end());
            match near.into_iter().find(|(place, _, _)| place.touches(other)) {
                None => Ok(()),
                Some((place, _, _)) => {
                    let what = format!(
                        "{} and the vertices from byte {} on have bytes in common, and would change as these do",
                        name(),
                        place.start
                    );
                    Err(self.container.source.malformed(what, APART))
                }
            }
        };
        for (index, what) in kept {
            if let Some(place) = self.place(*index)? {
                check(&place, &|| format!("accessor {index} ({what})"))?;
            }
        }
        for (index, image) in self.document.images.iter().enumerate() {
            if let Some(view) = image.buffer_view {
                let bytes = self.view(view)?;
                let size = bytes.end - bytes.start;
                let place = AccessorBytes { start: bytes.start, count: 1, stride: size, size };
                check(&place, &|| format!("image {index}"))?;
            }
        }
        Ok(())
    }
}

/// Run of elements, their role, and the sets that own them.
type ElementRun = (AccessorBytes, VectorRole, Vec<usize>);
