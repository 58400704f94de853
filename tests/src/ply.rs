//! PLY files, read by means of the tests' own: where each vertex keeps its position and normal, and all the
//! bytes that are neither. Independent of the program's reader, and holding the whole file.

use std::ops::Range;

use glam::DVec3;

/// Names of the properties of a vertex' position and normal.
const NAMES: [&str; 6] = ["x", "y", "z", "nx", "ny", "nz"];

/// A PLY file in memory.
pub struct Ply {
    /// The whole file.
    pub bytes: Vec<u8>,
    encoding: Encoding,
    /// Types of the numbers that [`NAMES`] lists; those of the normal are missing where there is none.
    types: Vec<Type>,
    /// Offsets of these numbers in the file, vertex by vertex.
    spots: Vec<[u32; 6]>,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, PartialEq)]
enum Type {
    Integer { bytes: usize },
    Float,
    Double,
}

struct Property {
    name: String,
    /// Type of the count, where it is a list.
    count: Option<Type>,
    item: Type,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

impl Ply {
    /// Finds the vertices in a file's bytes.
    ///
    /// # Panics
    /// They are no PLY file with positions.
    pub fn parse(bytes: Vec<u8>) -> Self {
        let (encoding, elements, data) = header(&bytes);
        let mut ply = Self { bytes, encoding, types: Vec::new(), spots: Vec::new() };
        let mut at = data;
        for element in &elements {
            let properties = &element.properties;
            let is_vertex = element.name == "vertex";
            let named: Vec<Option<usize>> =
                properties.iter().map(|p| NAMES.iter().position(|n| is_vertex && p.name == *n)).collect();
            for _ in 0..element.count {
                let mut spots = [0; 6];
                for (property, named) in properties.iter().zip(&named) {
                    let mut items = 1;
                    if let Some(count) = property.count {
                        let span = ply.span(at, count);
                        items = ply.number(span.clone(), count) as usize;
                        at = span.end;
                    }
                    for _ in 0..items {
                        let span = ply.span(at, property.item);
                        if let Some(slot) = named {
                            spots[*slot] = u32::try_from(span.start).expect("a small file");
                        }
                        at = span.end;
                    }
                }
                if is_vertex {
                    ply.spots.push(spots);
                }
            }
            if is_vertex {
                let item = |name: &&str| properties.iter().find(|p| p.name == **name).map(|p| p.item);
                ply.types = NAMES.iter().filter_map(item).collect();
                break;
            }
        }
        assert!([3, 6].contains(&ply.types.len()), "a position, and a normal or none");
        ply
    }

    /// A binary file of floats: these positions, and normals as many or none.
    pub fn from_points(positions: &[DVec3], normals: &[DVec3]) -> Self {
        let names = if normals.is_empty() { &NAMES[..3] } else { &NAMES[..] };
        let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let header = "ply\nformat binary_little_endian 1.0\nelement vertex";
        let mut bytes = format!("{header} {}\n{properties}end_header\n", positions.len()).into_bytes();
        let mut normals = normals.iter();
        for p in positions {
            let numbers =
                p.to_array().into_iter().chain(normals.next().into_iter().flat_map(|n| n.to_array()));
            numbers.for_each(|x| bytes.extend_from_slice(&(x as f32).to_le_bytes()));
        }
        Self::parse(bytes)
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.spots.len()
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.spots.is_empty()
    }

    /// The vertices' positions.
    pub fn positions(&self) -> Vec<DVec3> {
        self.vectors(0)
    }

    /// The vertices' normals; empty where they have none.
    pub fn normals(&self) -> Vec<DVec3> {
        if self.types.len() == 6 { self.vectors(3) } else { Vec::new() }
    }

    /// The box around the finite positions.
    pub fn bounds(&self) -> [DVec3; 2] {
        let finite = self.positions().into_iter().filter(|p| p.is_finite());
        finite.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[min, max], p| [min.min(p), max.max(p)])
    }

    /// Diagonal of that box.
    pub fn diagonal(&self) -> f64 {
        let [min, max] = self.bounds();
        (max - min).length()
    }

    /// Moves the vertices of a binary file, as any program may that deforms samples.
    pub fn move_vertices(&mut self, mut to: impl FnMut(DVec3) -> DVec3) {
        for (vertex, p) in self.positions().into_iter().enumerate() {
            self.set_position(vertex, to(p));
        }
    }

    /// Puts one vertex of a binary file elsewhere.
    pub fn set_position(&mut self, vertex: usize, p: DVec3) {
        for (slot, x) in p.to_array().into_iter().enumerate() {
            let (spot, big) = (self.spots[vertex][slot] as usize, self.encoding == Encoding::Big);
            let encoded = match self.types[slot] {
                Type::Float if big => (x as f32).to_be_bytes().to_vec(),
                Type::Float => (x as f32).to_le_bytes().to_vec(),
                Type::Double if big => x.to_be_bytes().to_vec(),
                Type::Double => x.to_le_bytes().to_vec(),
                Type::Integer { .. } => panic!("positions are no integers"),
            };
            assert!(self.encoding != Encoding::Ascii, "text is not changed in place");
            self.bytes[spot..spot + encoded.len()].copy_from_slice(&encoded);
        }
    }

    /// Range of a vertex' position in the file's bytes.
    pub fn position_bytes(&self, vertex: usize) -> Range<usize> {
        let spot = |slot: usize| self.span(self.spots[vertex][slot] as usize, self.types[slot]);
        spot(0).start..spot(2).end
    }

    /// All bytes of the file that belong to no position and no normal, in their order.
    pub fn other_bytes(&self) -> Vec<u8> {
        let (mut rest, mut at) = (Vec::with_capacity(self.bytes.len()), 0);
        for spots in &self.spots {
            let mut spans: Vec<Range<usize>> =
                spots.iter().zip(&self.types).map(|(s, t)| self.span(*s as usize, *t)).collect();
            spans.sort_by_key(|s| s.start);
            for span in spans {
                rest.extend_from_slice(&self.bytes[at..span.start]);
                at = span.end;
            }
        }
        rest.extend_from_slice(&self.bytes[at..]);
        rest
    }

    fn vectors(&self, slot: usize) -> Vec<DVec3> {
        let number = |spots: &[u32; 6], i| {
            let kind = self.types[i];
            self.number(self.span(spots[i] as usize, kind), kind)
        };
        let vector = |s: &[u32; 6]| DVec3::new(number(s, slot), number(s, slot + 1), number(s, slot + 2));
        self.spots.iter().map(vector).collect()
    }

    /// The bytes of the next number: from here on, or the next word.
    fn span(&self, at: usize, kind: Type) -> Range<usize> {
        if self.encoding != Encoding::Ascii {
            return at..at + kind.bytes();
        }
        let word = |from: usize, wanted: bool| {
            let found = self.bytes[from..].iter().position(|b| b.is_ascii_whitespace() != wanted);
            found.map_or(self.bytes.len(), |n| from + n)
        };
        let start = word(at, true);
        start..word(start, false)
    }

    fn number(&self, span: Range<usize>, kind: Type) -> f64 {
        let bytes = &self.bytes[span];
        if self.encoding == Encoding::Ascii {
            let word = std::str::from_utf8(bytes).expect("a number in text");
            return match kind {
                Type::Float => f64::from(word.parse::<f32>().expect("a float")),
                _ => word.parse().expect("a number"),
            };
        }
        let mut little = [0; 8];
        little[..bytes.len()].copy_from_slice(bytes);
        if self.encoding == Encoding::Big {
            little[..bytes.len()].reverse();
        }
        let bits = u64::from_le_bytes(little);
        match kind {
            Type::Float => f64::from(f32::from_bits(bits as u32)),
            Type::Double => f64::from_bits(bits),
            Type::Integer { .. } => bits as f64,
        }
    }
}

impl Type {
    fn bytes(self) -> usize {
        match self {
            Self::Integer { bytes } => bytes,
            Self::Float => 4,
            Self::Double => 8,
        }
    }

    fn from_name(name: &str) -> Self {
        match name {
            "char" | "uchar" | "int8" | "uint8" => Self::Integer { bytes: 1 },
            "short" | "ushort" | "int16" | "uint16" => Self::Integer { bytes: 2 },
            "int" | "uint" | "int32" | "uint32" => Self::Integer { bytes: 4 },
            "float" | "float32" => Self::Float,
            "double" | "float64" => Self::Double,
            other => panic!("unknown type {other}"),
        }
    }
}

/// The encoding, the elements, and where the data begins.
fn header(bytes: &[u8]) -> (Encoding, Vec<Element>, usize) {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    for line in bytes.split_inclusive(|b| *b == b'\n') {
        at += line.len();
        let line = std::str::from_utf8(line).expect("a header of text");
        match line.split_ascii_whitespace().collect::<Vec<_>>()[..] {
            ["format", name, _] => {
                encoding = Some(match name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => panic!("unknown format {other}"),
                });
            }
            ["element", name, count] => {
                let count = count.parse().expect("a count");
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref words @ .., name] => {
                let (count, item) = match words {
                    ["list", count, item] => (Some(Type::from_name(count)), Type::from_name(item)),
                    [item] => (None, Type::from_name(item)),
                    _ => panic!("unknown property {line}"),
                };
                let element = elements.last_mut().expect("an element before its properties");
                element.properties.push(Property { name: name.to_owned(), count, item });
            }
            ["end_header"] => return (encoding.expect("a format"), elements, at),
            _ => {}
        }
    }
    panic!("no end of the header");
}
