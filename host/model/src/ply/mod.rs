//! PLY 1.0: text, and binary of either byte order, with any elements and properties in any order.
//!
//! Vertices are the records of element `vertex`; their x, y, z (and nx, ny, nz, if all three are there) are
//! of type float or double. Everything else is passed over when reading, and copied byte by byte when
//! rewriting.
//!
//! Files are read by positioned reads and never mapped into memory: a mapped file that another program
//! shortens kills the process (SIGBUS), whereas a read returns an error.
//!
//! | module | |
//! |---|---|
//! | `header` | the header's text |
//! | `layout` | where a vertex record keeps its numbers |
//! | `file` | what is known of a file once it is open; `offsets` where its vertices begin |
//! | `walk` | going over elements of no interest; noticing that a file is cut off |
//! | `reader` | chunks of vertices from anywhere in the file |
//! | `faces` | triangles of all faces |
//! | `binary`, `ascii` | numbers in and out of a chunk's bytes; `patch` what both share |
//! | `attributes` | the other numbers of a chunk's bytes, where they are asked for |
//! | `rewrite` | the whole file anew |
//! | `writer` | files of our own |

mod ascii;
mod attributes;
mod binary;
mod faces;
mod file;
mod header;
mod layout;
mod offsets;
mod reader;
mod rewrite;
mod walk;
mod writer;

use std::ops::Range;
use std::path::Path;

pub use file::PlyModel;
pub(super) use header::{Encoding, PlyElement, PlyHeader, Property, PropertyShape, is_ply};
pub use writer::{Besides, write_points, write_vertices};

use super::model::some_by_all;
use super::source::SourceFile;
use super::{
    Division, Edit, FaceReader, Model, ModelInfo, Output, Rewriting, VertexChunk, VertexReader, pipeline,
};
use crate::follow::{Follow, Following};
use crate::form::counted;
use crate::las::remarks;
use crate::pipeline::Rewritable;
use crate::progress::Silent;
use crate::{Normals, Progress, Result, wkt};
use faces::{PlyFaces, SomeFaces};
use layout::PlyLayout;
use offsets::Offsets;
use reader::PlyReader;

/// Info on a model from its header; the bytes of vertices and faces are not known yet.
fn info(source: &SourceFile, header: &PlyHeader, vertices: u64, layout: &PlyLayout) -> ModelInfo {
    let faces = header.elements.iter().filter(|e| e.name == "face" || e.name == "tristrips");
    ModelInfo {
        format: format!("PLY 1.0, {}", header.encoding.name()),
        vertices,
        faces: faces.map(|e| e.count).fold(0, u64::saturating_add),
        has_normals: layout.has_normals(),
        position_type: layout.position_type(),
        other_properties: layout.other.clone(),
        attributes: layout.attributes.clone(),
        bytes: source.len(),
        random_access: layout.stride.is_some(),
        ..ModelInfo::default()
    }
}

impl PlyModel {
    /// The file.
    pub(crate) fn source(&self) -> &SourceFile {
        &self.source
    }

    /// Opens the file `source`.
    ///
    /// A binary file that is cut off is noticed here; a text file where the missing part is read, or by
    /// [`Model::check_complete`].
    ///
    /// # Errors
    /// The file cannot be read, is not PLY, is cut off, or has no vertices with positions.
    pub(crate) fn new(source: SourceFile) -> Result<Self> {
        let header = PlyHeader::read(&source)?;
        let mut model = Self::from_header(source, header, header::without_normals)?;
        let Comments { crs, wkt, remarks, .. } = model.comments()?;
        model.remarks = remarks;
        model.info.crs = crs.or_else(|| wkt::name(&wkt));
        model.wkt = Some(wkt).filter(|wkt| !wkt.is_empty());
        Ok(model)
    }

    /// Makes colours of the bytes of a number of a [text](PlyLayout::unpack_colors).
    pub(super) fn unpack_colors(&mut self) {
        self.layout.unpack_colors();
        self.following = Following::recognised(&self.layout.attributes);
        self.layout.follow(self.following.places());
        self.info.attributes = self.layout.attributes.clone();
    }

    /// Opens a file of such records, which need not be called PLY. `without_normals` makes its header anew
    /// without the properties of the vertices' normals.
    ///
    /// # Errors
    /// As of [`new`](Self::new).
    pub(super) fn from_header(
        source: SourceFile,
        header: PlyHeader,
        without_normals: fn(&[u8]) -> Vec<u8>,
    ) -> Result<Self> {
        let (vertex, element) = header.vertex(&source)?;
        let mut layout = PlyLayout::new(&source, header.encoding, element)?;
        let following = Following::recognised(&layout.attributes);
        layout.follow(following.places());
        let mut info = info(&source, &header, element.count, &layout);
        let mut starts = Vec::new();
        let vertices_start = if header.encoding == Encoding::Ascii {
            check_room_for_words(&source, &header)?;
            walk::walk(&source, header.encoding, &header.elements[..vertex], header.len, &Silent)?
        } else {
            starts = walk::extents(&source, header.encoding, &header.elements, header.len)?;
            info.vertex_bytes = starts[vertex + 1] - starts[vertex];
            starts[vertex]
        };
        let mut model = Self {
            source,
            header,
            vertex,
            layout,
            following,
            vertices_start,
            starts,
            offsets: Offsets::new(),
            without_normals,
            note: None,
            extensions: &["ply"],
            besides: Self::besides_of_ply,
            wkt: None,
            remarks: Vec::new(),
            info,
        };
        if model.header.encoding == Encoding::Ascii {
            model.info.vertex_bytes = model.estimate_vertex_bytes();
        }
        model.info.face_bytes = faces::bytes(&model);
        Ok(model)
    }

    /// Our own comments in the header, and the number of the others.
    fn comments(&self) -> Result<Comments> {
        let mut text = Vec::new();
        self.source.append_at(&mut text, 0, self.header.len as usize)?;
        let mut comments = Comments::default();
        for line in text.split(|byte| matches!(byte, b'\n' | b'\r')) {
            let own = |word: &str| line.strip_prefix(format!("comment {word} ").as_bytes());
            if let Some(name) = own(CRS) {
                comments.crs = wkt::short(&String::from_utf8_lossy(name)).or(comments.crs);
            } else if let Some(part) = own(WKT) {
                comments.wkt += &String::from_utf8_lossy(part);
            } else if let Some(remark) = remark(line) {
                comments.remarks.push(remark);
            } else if (line.starts_with(b"comment") || line.starts_with(b"obj_info"))
                && !line.starts_with(b"comment SIMOD ")
            {
                comments.others += 1;
            }
        }
        Ok(comments)
    }

    /// Comments, and elements and properties that are neither of vertices nor of faces.
    fn besides_of_ply(&self) -> Result<Vec<String>> {
        let mut besides = Vec::new();
        let others = self.comments()?.others;
        if others > 0 {
            besides.push(counted(others, "comment"));
        }
        for (place, PlyElement { name, count, properties }) in self.header.elements.iter().enumerate() {
            let name = header::quoted(name);
            let is_face = matches!(name.as_str(), "\"face\"" | "\"tristrips\"");
            if *count == 0 {
                continue;
            }
            if place != self.vertex && !is_face {
                besides.push(format!("the element {name}"));
                continue;
            }
            let of_corners = |p: &Property| is_face && faces::are_corners(p);
            let is_known = |p: &Property| {
                matches!(p.shape, PropertyShape::Scalar(_)) && {
                    POSITION.contains(&&*p.name)
                        || header::NORMAL.contains(&&*p.name) && self.layout.has_normals()
                        || self.info.attributes.iter().any(|a| a.name == p.name)
                }
            };
            let others = properties.iter().filter(|p| if is_face { !of_corners(p) } else { !is_known(p) });
            besides.extend(others.map(|p| format!("the property {} of {name}", p.describe())));
            if !is_face && properties.iter().any(|p| is_double_normal(p) && self.layout.has_normals()) {
                besides.push("digits of the normals: double becomes float".to_owned());
            }
        }
        Ok(besides)
    }

    /// Bytes of the vertices in a text file: all that follow, if nothing but vertices does, and otherwise as
    /// if all vertices were like the first ones.
    fn estimate_vertex_bytes(&self) -> u64 {
        const FIRST: u64 = 1000;
        if self.info.vertices == 0 {
            return 0;
        }
        let rest = self.source.len() - self.vertices_start;
        let after = &self.header.elements[self.vertex + 1..];
        if after.iter().all(|e| e.count == 0) {
            return rest;
        }
        let count = FIRST.min(self.info.vertices);
        let mut chunk = VertexChunk::default();
        // Errors in these vertices are reported when they are read.
        match PlyReader::new(self, 0..count).and_then(|mut reader| reader.read(&mut chunk)) {
            Ok(true) => {
                let bytes = chunk.raw.len() as f64 / chunk.len() as f64 * self.info.vertices as f64;
                rest.min(bytes as u64)
            }
            Ok(false) => 0,
            Err(_) => rest,
        }
    }
}

impl Model for PlyModel {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        self.extensions
    }

    fn details(&self) -> Vec<String> {
        self.wkt.as_deref().and_then(wkt::line_of_units).into_iter().collect()
    }

    fn wkt(&self) -> Option<String> {
        self.wkt.clone()
    }

    fn remarks(&self) -> Vec<String> {
        self.remarks.clone()
    }

    fn besides(&self) -> Result<Vec<String>> {
        (self.besides)(self)
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(PlyReader::new(self, range)?))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        attributes::decode(&self.layout, chunk, to).map_err(|e| {
            let (vertex, name) =
                (chunk.first_of_file() + e.vertex as u64, &self.layout.attributes[e.attribute].name);
            let what = format!("vertex {vertex}: {} {} is no number", header::quoted(name), e.word);
            self.source.malformed(what, header::DAMAGED)
        })
    }

    fn some_attributes(&self, chunk: &VertexChunk, places: &[usize], to: &mut [Vec<f64>]) -> Result<()> {
        if attributes::decode_some(&self.layout, chunk, places, to) {
            return Ok(());
        }
        some_by_all(|lists| self.attributes(chunk, lists), places, to)
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(PlyFaces::new(self)?))
    }

    fn faces_at(&self, ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(SomeFaces::new(self, ranges)?))
    }

    fn face_at(&self, face: u64) -> Option<u64> {
        faces::triangle_at(self, face)
    }

    fn has_face_marks(&self) -> bool {
        faces::are_marked(self)
    }

    fn faces_from(&self, mark: u64) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(SomeFaces::from(self, mark)?))
    }

    fn check_complete(&self, progress: &dyn Progress) -> Result<()> {
        if self.header.encoding == Encoding::Ascii {
            progress.begin("checking the text", self.source.len());
            let PlyHeader { encoding, elements, len, .. } = &self.header;
            walk::walk(&self.source, *encoding, elements, *len, progress)?;
        }
        self.source.check_unchanged()
    }

    fn following(&self) -> Option<&Following> {
        (!self.following.is_empty()).then_some(&self.following)
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.following = Following::declared(follow, &self.layout.attributes, self.source.path())?;
        self.layout.follow(self.following.places());
        Ok(())
    }

    fn division(&self, normals: Normals) -> Option<Division> {
        Rewritable::division(self, normals)
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.following.check(self.source.path())?;
        if let Some(note) = self.note {
            progress.note(&format!("{}: {note}", self.source.path().display()));
        }
        pipeline::rewrite(self, outputs, how, edit, progress)?;
        self.following.tell(self.source.path(), progress);
        Ok(())
    }
}

/// Keywords of our own comments: on the name of the coordinate reference system, and on its text in parts of
/// `PART` bytes, as other programs have no room for all of it in one line.
const CRS: &str = "crs";
const WKT: &str = "crs-wkt";
const PART: usize = 200;

/// The remarks in comments.
#[derive(Default)]
struct Comments {
    crs: Option<String>,
    wkt: String,
    /// [Remarks](Model::remarks).
    remarks: Vec<String>,
    /// Number of all others, but for who wrote the file.
    others: u64,
}

/// Comments on the coordinate reference system of a model, and on its attributes.
pub(crate) fn own_comments(model: &dyn Model) -> Vec<String> {
    let name = model.info().crs.iter().map(|name| format!("{CRS} {name}"));
    let text = model.wkt().unwrap_or_default();
    let characters: Vec<char> = text.chars().collect();
    let parts = characters.chunks(PART).map(|part| format!("{WKT} {}", part.iter().collect::<String>()));
    name.chain(parts).chain(model.remarks()).collect()
}

/// The [remark](Model::remarks) of a line, if it is one.
fn remark(line: &[u8]) -> Option<String> {
    let line = str::from_utf8(line.strip_prefix(b"comment ")?).ok()?;
    remarks::is_remark(line).then(|| line.to_owned())
}

/// Names of the position.
const POSITION: [&str; 3] = ["x", "y", "z"];

fn is_double_normal(property: &Property) -> bool {
    property.name == "nx" && property.shape == PropertyShape::Scalar(crate::Type::F64)
}

/// An error where a text file is too short to hold a word for each number that its header speaks of.
fn check_room_for_words(source: &SourceFile, header: &PlyHeader) -> Result<()> {
    let mut left = source.len() - header.len;
    for PlyElement { name, count, properties } in &header.elements {
        // A word takes a byte and another one to end it, if only the last one of the file may do without.
        let words = count.saturating_mul(properties.len() as u64);
        let bytes = words.saturating_mul(2);
        if bytes > left.saturating_add(1) {
            let what = format!(
                "says {count} records of element {} of {} numbers each, but only {left} bytes are left for them",
                header::quoted(name),
                properties.len()
            );
            return Err(source.malformed(what, walk::CUT_OFF));
        }
        left = left.saturating_sub(bytes);
    }
    Ok(())
}
