//! PCD 0.7: a header of text, and points as text, as binary records, or compressed.
//!
//! But for the header these are records as PLY has them, and are read and written by the same code: see
//! [`ply`](crate::ply). A compressed file holds one block of at most 4 GiB, in which each field of all points
//! comes before the next field: it is unpacked into the [cache](crate::cache) when it is opened, and is
//! written without compression, according to its new header.

mod header;
mod unpack;

use crate::cache::Making;
use crate::ply::{Encoding, PlyElement, PlyHeader, PlyModel, Property, PropertyShape};
use crate::source::SourceFile;
use crate::{Model, Result, Type};
pub(crate) use header::is_pcd;
use header::{Data, PcdField, PcdHeader};

/// Whether a file with the extension `pcd` begins as PCD, whatever its first comment says.
pub(crate) fn is_head(source: &SourceFile) -> bool {
    PcdHeader::read(source).is_ok()
}

/// Opens a file; a compressed one is unpacked into the cache.
pub(crate) fn open(source: SourceFile, making: &Making<'_>) -> Result<Box<dyn Model>> {
    let header = PcdHeader::read(&source)?;
    let name = header.data.name();
    let (compressed, is_text) = (header.data == Data::Compressed, header.data == Data::Ascii);
    let (source, header) = match header.data {
        Data::Compressed => {
            let source = unpack::unpack(&source, &header, making)?;
            let header = PcdHeader::read(&source)?;
            (source, header)
        }
        _ => (source, header),
    };
    let records = header.records();
    let other = header.fields.iter().filter(|f| !f.is_component()).map(PcdField::describe).collect();
    let mut model = PlyModel::from_header(source, records, header::without_normals)?;
    if is_text {
        model.unpack_colors();
    }
    model.extensions = &["pcd"];
    model.besides = besides;
    model.info.format = format!("PCD {}, {name}", header.version);
    model.info.other_properties = other;
    model.note = compressed.then_some("what is written is not compressed again: DATA is binary in it");
    Ok(Box::new(model))
}

/// Content of the file that is not read, in a few words each.
fn besides(model: &PlyModel) -> Result<Vec<String>> {
    let header = PcdHeader::read(model.source())?;
    let mut besides = Vec::new();
    for field in header.fields.iter().filter(|f| f.kind.is_none() || f.count != 1) {
        besides.push(format!("the field {}", field.describe()));
    }
    for line in String::from_utf8_lossy(&header.text).lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["HEIGHT", height] if height != "1" => besides.push(format!("that there are {height} rows")),
            ["VIEWPOINT", ref numbers @ ..] if numbers.join(" ") != "0 0 0 1 0 0 0" => {
                besides.push("the viewpoint".to_owned());
            }
            _ => {}
        }
    }
    Ok(besides)
}

impl PcdHeader {
    /// The points as an element of PLY.
    fn records(&self) -> PlyHeader {
        let binary = self.data != Data::Ascii;
        let mut properties = Vec::new();
        for field in &self.fields {
            let mut put = |name: &str, kind| {
                properties.push(Property { name: name.into(), shape: PropertyShape::Scalar(kind) });
            };
            match (field.kind, field.count) {
                // Colours are the bytes of one number.
                (Some(kind), 1)
                    if binary && kind.size() == 4 && matches!(field.name.as_str(), "rgb" | "rgba") =>
                {
                    let alpha = if field.name == "rgba" { "alpha" } else { "" };
                    ["blue", "green", "red", alpha].into_iter().for_each(|name| put(name, Type::U8));
                }
                (Some(kind), 1) => put(field.component().unwrap_or(&field.name), kind),
                // Nothing that has a name.
                (Some(kind), count) => (0..count).for_each(|_| put("", kind)),
                (None, count) => (0..count).for_each(|_| {
                    // Whole numbers of 64 bits: so many bytes, or a word.
                    put("", Type::F64);
                }),
            }
        }
        let encoding = if binary { Encoding::Little } else { Encoding::Ascii };
        let vertices = PlyElement { name: "vertex".into(), count: self.points, properties };
        PlyHeader { encoding, elements: vec![vertices], len: self.len }
    }
}
