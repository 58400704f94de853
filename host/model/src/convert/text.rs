//! OBJ, OFF and text in columns: numbers in lines.

use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;

use crate::form::{ConversionInput, FaceCounts, Form, WrittenRows, attribute_loss, counted};
use crate::polygons::Polygons;
use crate::{Attribute, ColorScale, Colors, Error, Model, Result, Scalar, Summary, Type};

/// The digits of positions as text: as many as give the numbers back.
#[derive(Debug, Clone, Copy)]
enum PositionDigits {
    /// As few digits as tell the number from all others of single precision, or (`Double`) of double.
    Single,
    Double,
    /// A fixed number of decimals; three more where a number lies between these.
    Decimals(usize),
}

impl PositionDigits {
    fn for_content(content: &ConversionInput<'_>) -> Self {
        let info = content.info();
        match (&info.integers, info.position_type) {
            (Some(integers), _) => {
                let decimals = (0..=12).find(|n| {
                    let power = 10f64.powi(*n);
                    // The test is up to the precision of doubles: a step may be as small as anything.
                    let on_grid = |x: f64| is_whole(x * power, 0.0);
                    (0..3).all(|axis| on_grid(integers.scale[axis]) && on_grid(integers.offset[axis]))
                });
                decimals.map_or(Self::Double, |n| Self::Decimals(n as usize))
            }
            (None, Scalar::F32) => Self::Single,
            (None, Scalar::F64) => Self::Double,
        }
    }

    fn write(self, number: f64, to: &mut Vec<u8>) {
        // Writing to memory does not fail.
        let _ = match self {
            Self::Single => number_to(to, f64::from(number as f32), true),
            Self::Double => number_to(to, number, false),
            Self::Decimals(n) => {
                let power = 10f64.powi(n as i32);
                let is_on_grid = is_whole(number * power, 1e-4);
                write!(to, "{number:.*}", if is_on_grid { n } else { n + 3 })
            }
        };
    }

    fn position(self, p: DVec3, separator: u8, to: &mut Vec<u8>) {
        for (axis, number) in p.to_array().into_iter().enumerate() {
            if axis > 0 {
                to.push(separator);
            }
            self.write(number, to);
        }
    }
}

/// Whether a number is whole but for `little`, or but for the rounding of double precision.
fn is_whole(number: f64, little: f64) -> bool {
    (number - number.round()).abs() <= little.max(4.0 * f64::EPSILON * number.abs())
}

/// Writes a number, with an exponent where zeros would be many.
fn number_to(to: &mut Vec<u8>, number: f64, is_single: bool) -> std::io::Result<()> {
    let size = number.abs();
    let is_plain = number == 0.0 || (1e-5..1e16).contains(&size) || !number.is_finite();
    match (is_single, is_plain) {
        (true, true) => write!(to, "{}", number as f32),
        (true, false) => write!(to, "{:e}", number as f32),
        (false, true) => write!(to, "{number}"),
        (false, false) => write!(to, "{number:e}"),
    }
}

fn whole_or_not(kind: Type, number: f64, to: &mut Vec<u8>) {
    let _ = number_to(to, number, kind == Type::F32);
}

/// Loss of the colours' digits in OFF, where colours are bytes, if there is one. Reads the model, unless its
/// colours are bytes.
pub(super) fn losses_of_bytes(model: &dyn Model) -> Result<Option<String>> {
    let Some(colors) = Colors::from_info(model.info()).filter(|colors| colors.kind != Type::U8) else {
        return Ok(None);
    };
    let are_kept = ColorScale::of_model(model, &colors)?.are_bytes(model, &colors)?;
    Ok((!are_kept).then(|| format!("digits of the colours ({}), which become bytes", colors.kind.name())))
}

/// Format of a text that is written, with the columns that it has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TextFormat {
    Obj,
    Off,
    /// Names first, and this between columns.
    Named(u8),
    /// Positions, and normals (`.xyzn`) or colours (`.xyzrgb`, as fractions: so Open3D, whose format it is,
    /// reads them) behind them.
    Plain {
        with_normals: bool,
        with_colors: bool,
    },
}

impl TextFormat {
    /// Whether an attribute of this name can be a column of the format.
    fn holds_attribute(self, name: &str) -> bool {
        let Self::Named(separator) = self else { return false };
        let needs_care =
            |c: char| c == separator as char || "\"'#,;\t\n\r".contains(c) || (c == ' ' && separator == b' ');
        !name.contains(needs_care)
            && !["x", "y", "z", "nx", "ny", "nz"].contains(&name.to_ascii_lowercase().as_str())
    }
}

/// A file of lines.
pub(super) struct TextForm {
    kind: TextFormat,
    digits: PositionDigits,
    vertices: u64,
    faces: FaceCounts,
    has_normals: bool,
    attributes: Vec<(String, Type, usize)>,
    /// The colours of OBJ, OFF, and `.xyzrgb`.
    colors: Option<ColorStyle>,
    /// Whether vertices without a position are left out: nothing in the file counts the vertices, and leaving
    /// out is allowed.
    leaves_out: bool,
    left_out: AtomicU64,
}

/// Colours behind positions: fractions of full light, but in OFF bytes, with the alpha behind them.
struct ColorStyle {
    colors: Colors,
    scale: ColorScale,
    /// Place of the alpha among the attributes, if the model has one of the colours' type.
    alpha: Option<usize>,
}

impl ColorStyle {
    fn for_content(kind: TextFormat, content: &ConversionInput<'_>) -> Result<Option<Self>> {
        let info = content.info();
        let is_painted =
            matches!(kind, TextFormat::Obj | TextFormat::Off | TextFormat::Plain { with_colors: true, .. });
        let Some(colors) = Colors::from_info(info).filter(|_| is_painted) else {
            return Ok(None);
        };
        let scale = ColorScale::of_model(content.model, &colors)?;
        let is_alpha = |a: &Attribute| a.name == "alpha" && a.kind == colors.kind;
        let alpha = info.attributes.iter().position(is_alpha).filter(|_| kind == TextFormat::Off);
        Ok(Some(Self { colors, scale, alpha }))
    }

    fn write(&self, kind: TextFormat, numbers: &[Vec<f64>], i: usize, to: &mut Vec<u8>) {
        for place in self.colors.places {
            to.push(b' ');
            let number = numbers[place][i];
            // Writing to memory does not fail.
            let _ = match (kind, self.colors.kind) {
                (TextFormat::Off, _) => write!(to, "{}", self.scale.byte(number)),
                (_, Type::F64) => number_to(to, number / self.scale.full(), false),
                // Numbers have as many digits as give bytes, words, and singles back.
                _ => number_to(to, number / self.scale.full(), true),
            };
        }
        if kind == TextFormat::Off {
            let alpha = self.alpha.map_or(u8::MAX, |place| self.scale.byte(numbers[place][i]));
            let _ = write!(to, " {alpha}");
        }
    }
}

impl TextForm {
    pub(super) fn new(
        kind: TextFormat,
        content: &ConversionInput<'_>,
        losses: &mut Vec<String>,
    ) -> Result<Self> {
        let info = content.info();
        let holds_faces = matches!(kind, TextFormat::Obj | TextFormat::Off);
        if !holds_faces && content.faces.triangles > 0 {
            losses.push(counted(content.faces.polygons, "face"));
        }
        let holds_normals = !matches!(kind, TextFormat::Plain { with_normals: false, .. });
        if content.has_normals && !holds_normals {
            losses.push("the normals".to_owned());
        }
        if let Some(crs) = &info.crs {
            losses.push(format!("the coordinate reference system {crs}"));
        }
        let colors = ColorStyle::for_content(kind, content)?;
        let is_painted = |place: usize| {
            colors.as_ref().is_some_and(|c| c.colors.places.contains(&place) || c.alpha == Some(place))
        };
        let mut attributes = Vec::new();
        for (place, attribute) in info.attributes.iter().enumerate() {
            if is_painted(place) {
                continue;
            }
            if kind.holds_attribute(&attribute.name) {
                attributes.push((attribute.name.clone(), attribute.kind, place));
            } else {
                losses.push(attribute_loss(&attribute.name, attribute.kind));
            }
        }
        Ok(Self {
            kind,
            digits: PositionDigits::for_content(content),
            vertices: info.vertices,
            faces: if holds_faces { content.faces } else { FaceCounts::default() },
            has_normals: content.has_normals && holds_normals,
            attributes,
            colors,
            leaves_out: content.how.lossy
                && !(holds_faces && content.faces.triangles > 0)
                && kind != TextFormat::Off,
            left_out: AtomicU64::new(0),
        })
    }

    /// An error about a vertex without a position.
    fn without_position(&self, rows: &WrittenRows<'_>, i: usize) -> Error {
        let why = "which is no number in text";
        if self.has_faces() || self.kind == TextFormat::Off {
            rows.unfit(i, why)
        } else {
            rows.without_position(i, why)
        }
    }
}

impl Form for TextForm {
    fn attributes(&self) -> usize {
        let colors = self.colors.iter().flat_map(|c| c.colors.places.into_iter().chain(c.alpha));
        self.attributes.iter().map(|(.., place)| *place).chain(colors).max().map_or(0, |last| last + 1)
    }

    fn head(&self) -> Result<Vec<u8>> {
        Ok(match self.kind {
            TextFormat::Off => {
                let color = if self.colors.is_some() { "C" } else { "" };
                let normal = if self.has_normals { "N" } else { "" };
                format!("{color}{normal}OFF\n{} {} 0\n", self.vertices, self.faces.polygons).into_bytes()
            }
            TextFormat::Named(separator) => {
                let mut names = vec!["x", "y", "z"];
                names.extend(["nx", "ny", "nz"].iter().filter(|_| self.has_normals));
                names.extend(self.attributes.iter().map(|(name, ..)| name.as_str()));
                (names.join(&(separator as char).to_string()) + "\n").into_bytes()
            }
            TextFormat::Obj | TextFormat::Plain { .. } => Vec::new(),
        })
    }

    fn vertices(&self, rows: &WrittenRows<'_>, to: &mut Vec<u8>, _summary: &mut Summary) -> Result<()> {
        let separator = if let TextFormat::Named(separator) = self.kind { separator } else { b' ' };
        to.clear();
        for (i, p) in rows.positions.iter().enumerate() {
            if !p.is_finite() {
                if !self.leaves_out {
                    return Err(self.without_position(rows, i));
                }
                self.left_out.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            if self.kind == TextFormat::Obj {
                to.extend_from_slice(b"v ");
            }
            self.digits.position(*p, separator, to);
            if let Some(colors) = self.colors.as_ref().filter(|_| self.kind == TextFormat::Obj) {
                colors.write(self.kind, rows.attributes, i, to);
            }
            if let Some(n) = rows.normals.get(i).filter(|_| self.has_normals) {
                to.extend_from_slice(if self.kind == TextFormat::Obj { b"\nvn" } else { b"" });
                for component in n.to_array() {
                    to.push(separator);
                    whole_or_not(Type::F32, f64::from(component), to);
                }
            }
            if let Some(colors) = self.colors.as_ref().filter(|_| self.kind != TextFormat::Obj) {
                colors.write(self.kind, rows.attributes, i, to);
            }
            for (_, kind, place) in &self.attributes {
                to.push(separator);
                whole_or_not(*kind, rows.attributes[*place][i], to);
            }
            to.push(b'\n');
        }
        Ok(())
    }

    fn left_out(&self) -> u64 {
        self.left_out.load(Ordering::Relaxed)
    }

    fn has_faces(&self) -> bool {
        self.faces.triangles > 0
    }

    fn holds_polygons(&self) -> bool {
        true
    }

    fn faces(&self, faces: &Polygons, to: &mut Vec<u8>) -> Result<()> {
        to.clear();
        for corners in faces.iter() {
            // Writing to memory does not fail.
            let _ =
                if self.kind == TextFormat::Off { write!(to, "{}", corners.len()) } else { write!(to, "f") };
            for corner in corners {
                let one_more = u64::from(*corner) + 1;
                let _ = match (self.kind, self.has_normals) {
                    (TextFormat::Off, _) => write!(to, " {corner}"),
                    (_, true) => write!(to, " {one_more}//{one_more}"),
                    (_, false) => write!(to, " {one_more}"),
                };
            }
            to.push(b'\n');
        }
        Ok(())
    }

    fn bytes(&self) -> u64 {
        // Characters of a number with its separator, at a guess: large whole numbers are rare.
        let of_type = |kind: Type| match kind {
            Type::U8 | Type::I8 => 3,
            Type::U16 | Type::I16 => 5,
            Type::U32 | Type::I32 => 8,
            Type::F32 | Type::F64 => 12,
        };
        let (normals, colors) = (u64::from(self.has_normals), u64::from(self.colors.is_some()));
        let attributes: u64 = self.attributes.iter().map(|(_, kind, _)| of_type(*kind)).sum();
        (36 * (1 + normals + colors) + attributes) * self.vertices + 8 * self.faces.corners
    }
}
