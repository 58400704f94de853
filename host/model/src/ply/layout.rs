//! Layout of a vertex record: position and normal, and the other numbers that turn with the surface.

use super::header::{DAMAGED, Encoding, NORMAL, PlyElement, Property, PropertyShape, quoted};
use crate::source::SourceFile;
use crate::{Attribute, Result, Scalar, Type};

/// One coordinate of the position or of the normal, or a number that follows these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Component {
    /// The name of a coordinate; names of other numbers are with the attributes.
    pub(super) name: &'static str,
    pub(super) scalar: Scalar,
    /// Bytes from the start of the record, in binary records of fixed size.
    pub(super) offset: usize,
}

/// Treatment of a property of a vertex record while the record is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PropertySlot {
    /// Another property, of so many bytes, which is passed over.
    Other { size: usize },
    /// The component of this index, of so many bytes.
    Component { index: usize, size: usize },
    /// A list, which makes records differ in length.
    List { count: Type, item: Type },
}

/// The layout of the vertex records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PlyLayout {
    pub(super) encoding: Encoding,
    /// x, y, z, and if the vertices have normals nx, ny, nz; and then what [follows](Self::follow).
    pub(super) components: Vec<Component>,
    has_normals: bool,
    /// Indices into `components`, in the file's order.
    pub(super) file_order: Vec<usize>,
    /// The properties in the file's order.
    pub(super) slots: Vec<PropertySlot>,
    /// Bytes of a record, if all records have the same number: in binary files without lists.
    pub(super) stride: Option<usize>,
    /// The properties that are neither position nor normal, for people.
    pub(super) other: Vec<String>,
    /// The properties that are numbers with a name of their own, in the file's order.
    pub(super) attributes: Vec<Attribute>,
    /// Place of each attribute: its index among the slots, and bytes from the start of the record where
    /// records are of fixed size.
    pub(super) places: Vec<(usize, usize)>,
    /// The slot of a number, and its type, whose bytes are [colours](Self::unpack_colors) in a text.
    pub(super) packed: Option<(usize, Type)>,
}

const POSITION: [&str; 3] = ["x", "y", "z"];

/// # Errors
/// A coordinate of the position is missing, or of another type than float or double; or it, or one of the
/// normal, is there twice.
fn check_properties(source: &SourceFile, vertex: &PlyElement) -> Result<()> {
    for name in POSITION.iter().chain(&NORMAL) {
        if vertex.properties.iter().filter(|p| p.name == *name).count() > 1 {
            return Err(source.malformed(format!("the vertices have two properties {name}"), DAMAGED));
        }
    }
    for name in POSITION {
        let hint = "positions have to be of type float or double: export the model so";
        match vertex.properties.iter().find(|p| p.name == name) {
            None => return Err(source.malformed(format!("the vertices have no property {name}"), hint)),
            Some(p) if floating(p.shape).is_none() => {
                let what = format!("property {name} of the vertices is {}", quoted(&p.describe()));
                return Err(source.malformed(what, hint));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

impl PlyLayout {
    pub(super) fn new(source: &SourceFile, encoding: Encoding, vertex: &PlyElement) -> Result<Self> {
        check_properties(source, vertex)?;
        let scalar_of =
            |name: &str| vertex.properties.iter().find(|p| p.name == name).and_then(|p| floating(p.shape));
        // Normals of another type, or not all three, are properties like any other.
        let has_normals = NORMAL.iter().all(|name| scalar_of(name).is_some());
        let names = if has_normals { [POSITION, NORMAL].concat() } else { POSITION.to_vec() };
        let component = |&name: &&'static str| Some(Component { name, scalar: scalar_of(name)?, offset: 0 });
        let mut layout = Self {
            encoding,
            components: names.iter().filter_map(component).collect(),
            has_normals,
            file_order: Vec::new(),
            slots: Vec::new(),
            stride: (encoding != Encoding::Ascii).then_some(0),
            other: Vec::new(),
            attributes: Vec::new(),
            places: Vec::new(),
            packed: None,
        };
        for property in &vertex.properties {
            layout.push(property, names.iter().position(|n| *n == property.name));
        }
        Ok(layout)
    }

    /// Adds the next property of the file: a component of this index, or another one.
    fn push(&mut self, property: &Property, index: Option<usize>) {
        let offset = self.stride.unwrap_or(0);
        self.slots.push(match (property.shape, index) {
            (PropertyShape::List { count, item }, _) => PropertySlot::List { count, item },
            (PropertyShape::Scalar(t), None) => PropertySlot::Other { size: t.size() },
            (PropertyShape::Scalar(t), Some(index)) => {
                self.components[index].offset = offset;
                self.file_order.push(index);
                PropertySlot::Component { index, size: t.size() }
            }
        });
        // Other formats have properties without names, which cannot be asked for.
        if index.is_none() && !property.name.is_empty() {
            self.other.push(property.describe());
            let known = self.attributes.iter().any(|known| known.name == property.name);
            if let PropertyShape::Scalar(kind) = property.shape
                && !known
                && Attribute::is_name(&property.name)
            {
                self.attributes.push(Attribute { name: property.name.clone(), kind });
                self.places.push((self.slots.len() - 1, offset));
            }
        }
        self.stride = match property.shape {
            PropertyShape::Scalar(t) => self.stride.map(|bytes| bytes + t.size()),
            PropertyShape::List { .. } => None,
        };
    }

    /// Makes colours of the bytes of the number `rgb` or `rgba` of a text, as PCD has them: blue, green and
    /// red from the lowest byte on, and alpha. Each has the number's slot, and its byte for a place.
    pub(super) fn unpack_colors(&mut self) {
        let is_packed = |a: &Attribute| a.kind.size() == 4 && matches!(a.name.as_str(), "rgb" | "rgba");
        let Some(at) = self.attributes.iter().position(is_packed) else { return };
        let ((slot, _), Attribute { name, kind }) = (self.places[at], self.attributes[at].clone());
        let colors = &["blue", "green", "red", "alpha"][..name.len()];
        if self.attributes.iter().any(|known| colors.contains(&known.name.as_str())) {
            return;
        }
        self.packed = Some((slot, kind));
        let color = |name: &&str| Attribute { name: (*name).to_owned(), kind: Type::U8 };
        self.attributes.splice(at..=at, colors.iter().map(color));
        self.places.splice(at..=at, (0..colors.len()).map(|byte| (slot, byte)));
    }

    pub(super) fn has_normals(&self) -> bool {
        self.has_normals
    }

    /// Index of the first component that is part neither of the position nor of the normal.
    pub(super) fn following(&self) -> usize {
        if self.has_normals { 6 } else { 3 }
    }

    /// Makes components of attributes, in the place of former ones. None is of another type than float or
    /// double.
    pub(super) fn follow(&mut self, attributes: &[usize]) {
        let first = self.following();
        self.components.truncate(first);
        for slot in &mut self.slots {
            if let PropertySlot::Component { index, size } = *slot
                && index >= first
            {
                *slot = PropertySlot::Other { size };
            }
        }
        for attribute in attributes {
            let (slot, offset) = self.places[*attribute];
            let Some(scalar) = floating(PropertyShape::Scalar(self.attributes[*attribute].kind)) else {
                continue;
            };
            self.slots[slot] = PropertySlot::Component { index: self.components.len(), size: scalar.size() };
            self.components.push(Component { name: "", scalar, offset });
        }
        let index = |slot: &PropertySlot| match slot {
            PropertySlot::Component { index, .. } => Some(*index),
            _ => None,
        };
        self.file_order = self.slots.iter().filter_map(index).collect();
    }

    /// Double if any coordinate is.
    pub(super) fn position_type(&self) -> Scalar {
        let double = self.components[..3].iter().any(|c| c.scalar == Scalar::F64);
        if double { Scalar::F64 } else { Scalar::F32 }
    }

    /// The three components from `first` on: 0 for the position, 3 for the normal.
    pub(super) fn triple(&self, first: usize) -> [Component; 3] {
        std::array::from_fn(|i| self.components[first + i])
    }
}

fn floating(shape: PropertyShape) -> Option<Scalar> {
    match shape {
        PropertyShape::Scalar(Type::F32) => Some(Scalar::F32),
        PropertyShape::Scalar(Type::F64) => Some(Scalar::F64),
        _ => None,
    }
}
