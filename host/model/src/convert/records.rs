//! PLY (binary, little endian) and PCD (binary): a header of text, a record for each vertex, and in PLY one
//! for each face.

use std::collections::HashSet;

use crate::form::{ConversionInput, FaceCounts, Form, WrittenRows, attribute_loss, counted, put_numbers};
use crate::las::remarks;
use crate::ply::own_comments;
use crate::polygons::Polygons;
use crate::{Attribute, Colors, Result, Scalar, Summary, Type};

/// The format that the records are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RecordFormat {
    Ply,
    Pcd,
}

/// Names of the position and the normal in each.
const PLY: [&str; 6] = ["x", "y", "z", "nx", "ny", "nz"];
const PCD: [&str; 6] = ["x", "y", "z", "normal_x", "normal_y", "normal_z"];

/// Names that PCD reads as the bytes of another number.
const PACKED: [&str; 2] = ["rgb", "rgba"];

/// A file of records.
pub(super) struct RecordForm {
    kind: RecordFormat,
    vertices: u64,
    faces: FaceCounts,
    scalar: Scalar,
    has_normals: bool,
    /// Name and type of each attribute that is written, and its place among the model's.
    attributes: Vec<(String, Type, usize)>,
    /// Places of blue, green and red among the model's attributes, where PCD packs them as bytes of one
    /// number.
    packed: Option<[usize; 3]>,
    comments: Vec<String>,
    stride: usize,
}

/// Name, type and place of those attributes that can be written.
fn written<'a>(
    kind: RecordFormat,
    attributes: impl Iterator<Item = (usize, &'a Attribute)>,
    remarks: &[String],
    losses: &mut Vec<String>,
) -> Vec<(String, Type, usize)> {
    let own = if kind == RecordFormat::Ply { PLY } else { PCD };
    let mut taken: HashSet<String> = own.iter().map(|name| (*name).to_owned()).collect();
    let mut written = Vec::new();
    for (place, attribute) in attributes {
        let name: String = attribute.name.chars().map(|c| if c.is_whitespace() { '_' } else { c }).collect();
        let is_packed = kind == RecordFormat::Pcd && PACKED.contains(&name.as_str());
        // A name that words are made of in the header alone.
        if !name.is_ascii() || is_packed || !taken.insert(name.clone()) {
            losses.push(attribute_loss(&attribute.name, attribute.kind));
            continue;
        }
        if name != attribute.name && !remarks::has_name(remarks, &attribute.name) {
            losses.push(format!("the name of the attribute {}, which becomes {name}", attribute.name));
        }
        written.push((name, attribute.kind, place));
    }
    written
}

impl RecordForm {
    pub(super) fn new(
        kind: RecordFormat,
        content: &ConversionInput<'_>,
        losses: &mut Vec<String>,
    ) -> Result<Self> {
        let info = content.info();
        let faces = if kind == RecordFormat::Ply { content.faces } else { FaceCounts::default() };
        if kind == RecordFormat::Pcd && content.faces.triangles > 0 {
            losses.push(counted(content.faces.polygons, "face"));
        }
        if faces.triangles > 0 {
            content.too_many("vertices with faces", info.vertices, u64::from(u32::MAX))?;
        }
        let names = |c: &Colors| {
            c.places.map(|place| info.attributes[place].name.as_str()) == ["red", "green", "blue"]
        };
        let is_alpha = |a: &Attribute| a.name == "alpha";
        let packs = kind == RecordFormat::Pcd && !info.attributes.iter().any(is_alpha);
        let colors =
            Colors::from_info(info).filter(|colors| packs && colors.kind == Type::U8 && names(colors));
        let packed = colors.map(|Colors { places: [r, g, b], .. }| [b, g, r]);
        let is_other = |place: &usize| !packed.is_some_and(|packed| packed.contains(place));
        let others = (0..info.attributes.len()).filter(is_other);
        // PLY keeps attributes' names with blanks in its remarks.
        let remarks = if kind == RecordFormat::Ply { content.model.remarks() } else { Vec::new() };
        let others = others.map(|place| (place, &info.attributes[place]));
        let attributes = written(kind, others, &remarks, losses);
        let mut comments = Vec::new();
        if kind == RecordFormat::Ply {
            comments = own_comments(content.model);
        } else if let Some(crs) = &info.crs {
            losses.push(format!("the coordinate reference system {crs}"));
        }
        // Positions that the model stores as scaled integers have more digits than single precision holds.
        let scalar = if info.integers.is_some() { Scalar::F64 } else { info.position_type };
        let numbers: usize = attributes.iter().map(|(_, kind, _)| kind.size()).sum();
        let colors = if packed.is_some() { 4 } else { 0 };
        let stride = 3 * scalar.size() + if content.has_normals { 12 } else { 0 } + colors + numbers;
        let (vertices, has_normals) = (info.vertices, content.has_normals);
        Ok(Self { kind, vertices, faces, scalar, has_normals, attributes, packed, comments, stride })
    }

    /// Name and type of all numbers of a record.
    fn fields(&self) -> impl Iterator<Item = (&str, Type)> {
        let position = if self.scalar == Scalar::F64 { Type::F64 } else { Type::F32 };
        let names = if self.kind == RecordFormat::Ply { PLY } else { PCD };
        let components = names.into_iter().zip([position; 3].into_iter().chain([Type::F32; 3]));
        let components = components.take(if self.has_normals { 6 } else { 3 });
        let packed = self.packed.map(|_| ("rgb", Type::F32));
        components.chain(packed).chain(self.attributes.iter().map(|(name, kind, _)| (name.as_str(), *kind)))
    }

    fn ply_header(&self) -> String {
        let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
        self.comments.iter().for_each(|comment| header += &format!("comment {comment}\n"));
        header += &format!("element vertex {}\n", self.vertices);
        self.fields().for_each(|(name, kind)| header += &format!("property {} {name}\n", kind.name()));
        if self.faces.triangles > 0 {
            header += &format!(
                "element face {}\nproperty list {} {} vertex_indices\n",
                self.faces.polygons,
                self.length().name(),
                self.index().name()
            );
        }
        header + "end_header\n"
    }

    fn pcd_header(&self) -> String {
        let words = |word: &dyn Fn(&str, Type) -> String| {
            self.fields().map(|(name, kind)| format!(" {}", word(name, kind))).collect::<String>()
        };
        let letter = |kind: Type| match kind {
            Type::I8 | Type::I16 | Type::I32 => "I",
            Type::U8 | Type::U16 | Type::U32 => "U",
            Type::F32 | Type::F64 => "F",
        };
        format!(
            "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS{}\nSIZE{}\nTYPE{}\nCOUNT{}\nWIDTH {n}\nHEIGHT 1\n\
             VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n",
            words(&|name, _| name.to_owned()),
            words(&|_, kind| kind.size().to_string()),
            words(&|_, kind| letter(kind).to_owned()),
            words(&|_, _| "1".to_owned()),
            n = self.vertices
        )
    }

    /// The type of how many corners a face has.
    fn length(&self) -> Type {
        if self.faces.largest <= usize::from(u8::MAX) { Type::U8 } else { Type::I32 }
    }

    /// The type of the numbers of vertices: what most programs expect, as long as it reaches.
    fn index(&self) -> Type {
        if self.vertices <= i32::MAX as u64 { Type::I32 } else { Type::U32 }
    }
}

impl Form for RecordForm {
    fn attributes(&self) -> usize {
        let places = self.attributes.iter().map(|(.., place)| *place);
        places.chain(self.packed.into_iter().flatten()).max().map_or(0, |last| last + 1)
    }

    fn head(&self) -> Result<Vec<u8>> {
        Ok(match self.kind {
            RecordFormat::Ply => self.ply_header(),
            RecordFormat::Pcd => self.pcd_header(),
        }
        .into_bytes())
    }

    fn vertices(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, _summary: &mut Summary) -> Result<()> {
        to.resize(rows.positions.len() * self.stride, 0);
        let mut at = 0;
        for (i, (record, p)) in to.chunks_exact_mut(self.stride).zip(rows.positions).enumerate() {
            match self.scalar {
                Scalar::F64 => {
                    record[..24].copy_from_slice(p.to_array().map(f64::to_le_bytes).as_flattened())
                }
                Scalar::F32 => {
                    let single = p.as_vec3();
                    if p.is_finite() && !single.is_finite() {
                        return Err(rows.unfit(i, "too far away for the type float"));
                    }
                    record[..12].copy_from_slice(single.to_array().map(f32::to_le_bytes).as_flattened());
                }
            }
        }
        at += 3 * self.scalar.size();
        if self.has_normals {
            for (record, n) in to.chunks_exact_mut(self.stride).zip(rows.normals) {
                record[at..at + 12].copy_from_slice(n.to_array().map(f32::to_le_bytes).as_flattened());
            }
            at += 12;
        }
        if let Some(packed) = self.packed {
            for (byte, place) in packed.into_iter().enumerate() {
                put_numbers(Type::U8, &rows.attributes[place], to, at + byte, self.stride);
            }
            at += 4;
        }
        for (_, kind, place) in &self.attributes {
            put_numbers(*kind, &rows.attributes[*place], to, at, self.stride);
            at += kind.size();
        }
        Ok(())
    }

    fn has_faces(&self) -> bool {
        self.faces.triangles > 0
    }

    fn holds_polygons(&self) -> bool {
        true
    }

    fn faces(&self, faces: &Polygons, to: &mut Vec<u8>) -> Result<()> {
        let length = self.length().size();
        to.clear();
        to.reserve(length * faces.len() + 4 * faces.corners());
        for corners in faces.iter() {
            to.extend_from_slice(&(corners.len() as u32).to_le_bytes()[..length]);
            corners.iter().for_each(|corner| to.extend_from_slice(&corner.to_le_bytes()));
        }
        Ok(())
    }

    fn bytes(&self) -> u64 {
        let of_faces = self.length().size() as u64 * self.faces.polygons + 4 * self.faces.corners;
        self.vertices * self.stride as u64 + of_faces
    }
}
