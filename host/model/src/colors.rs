//! Colours of vertices: their places among the numbers of vertices, and their scale. All code that shows,
//! compares or writes colours uses this module.

use rayon::prelude::*;

use crate::{Attribute, Model, ModelInfo, Result, Type, VertexChunk};

/// Names of red, green and blue in the formats, in lower case.
const NAMES: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

/// The first coefficients of the harmonics of Gaussian splats: the colour that they have from all sides
/// alike.
const COEFFICIENTS: [&str; 3] = ["f_dc_0", "f_dc_1", "f_dc_2"];

/// The first function of the harmonics.
const HARMONIC: f64 = 0.282_094_791_773_878_14;

/// Places of the vertices' colour among their attributes, and its type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colors {
    /// The places of red, green and blue among the attributes.
    pub places: [usize; 3],
    /// Type of the colours' numbers.
    pub kind: Type,
    /// The numbers are coefficients of harmonics.
    pub of_splats: bool,
}

/// The meaning of the numbers of a colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColorScale(Meaning);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Meaning {
    /// Numbers from 0 to this one, which is full light.
    Full(u16),
    /// Coefficients of harmonics.
    Coefficients,
}

impl Colors {
    /// The colour of vertices with such attributes, if they have one: three numbers of one type.
    pub fn among<'a>(attributes: impl IntoIterator<Item = &'a Attribute>) -> Option<Self> {
        let mut places = [[None; 3]; NAMES.len()];
        for (place, attribute) in attributes.into_iter().enumerate() {
            for (names, places) in NAMES.iter().zip(&mut places) {
                for (name, found) in names.iter().zip(places) {
                    if found.is_none() && attribute.name.eq_ignore_ascii_case(name) {
                        *found = Some((place, attribute.kind));
                    }
                }
            }
        }
        places.into_iter().find_map(|found| {
            let [(red, kind), (green, other), (blue, another)] = [found[0]?, found[1]?, found[2]?];
            (kind == other && kind == another).then_some(Self {
                places: [red, green, blue],
                kind,
                of_splats: false,
            })
        })
    }

    /// Returns the places of the colours of vertices with such attributes; of Gaussian splats without
    /// colours, those of the colour in which they are seen.
    pub fn seen<'a>(attributes: impl IntoIterator<Item = &'a Attribute> + Clone) -> Option<Self> {
        let coefficient = |name: &str| {
            let mut all = attributes.clone().into_iter().enumerate();
            all.find_map(|(place, a)| (a.name == name).then_some((place, a.kind)))
        };
        let of_splats = || {
            let [red, green, blue] = COEFFICIENTS.map(coefficient);
            let ((red, kind), (green, _), (blue, _)) = (red?, green?, blue?);
            Some(Self { places: [red, green, blue], kind, of_splats: true })
        };
        Self::among(attributes.clone()).or_else(of_splats)
    }

    /// The colour of a model's vertices, as numbers from nothing to full light.
    pub fn from_info(info: &ModelInfo) -> Option<Self> {
        Self::among(&info.attributes)
    }

    /// Number of the first attributes that have to be read for the colours.
    pub fn count(&self) -> usize {
        self.places.into_iter().max().map_or(0, |last| last + 1)
    }
}

impl ColorScale {
    /// The scale of numbers of which `most` is the largest: bytes are full at 255. Wider types are by
    /// themselves full at 1 (fractions), 255 or 65 535, which programs do not agree upon, so that the largest
    /// number tells.
    pub fn for_largest(colors: &Colors, most: f64) -> Self {
        Self(match colors.kind {
            _ if colors.of_splats => Meaning::Coefficients,
            Type::U8 | Type::I8 => Meaning::Full(255),
            kind if kind.is_float() && most <= 1.0 => Meaning::Full(1),
            _ if most <= 255.0 => Meaning::Full(255),
            _ => Meaning::Full(65535),
        })
    }

    /// The number of full light; 1 of coefficients, which have none.
    pub fn full(self) -> f64 {
        match self.0 {
            Meaning::Full(full) => f64::from(full),
            Meaning::Coefficients => 1.0,
        }
    }

    /// The scale of a model's colours. How large they are is told by vertices all over the file; where
    /// reading begins at the first one always, those there have to do.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of_model(model: &dyn Model, colors: &Colors) -> Result<Self> {
        const PLACES: u64 = 16;
        const AT_A_PLACE: u64 = 2048;
        let info = model.info();
        if colors.kind == Type::U8 || colors.of_splats {
            return Ok(Self::for_largest(colors, 0.0));
        }
        let places = if info.random_access { PLACES } else { 1 };
        let largest = |place| -> Result<f64> {
            let first = info.vertices / places * place;
            let mut reader = model.vertices(first..(first + AT_A_PLACE).min(info.vertices))?;
            reader.skip_all_but_colors();
            let (mut chunk, mut lists, mut most) =
                (VertexChunk::default(), [(); 3].map(|()| Vec::new()), 0.0f64);
            while reader.read(&mut chunk)? {
                model.some_attributes(&chunk, &colors.places, &mut lists)?;
                let finite = lists.iter().flatten().filter(|c| c.is_finite());
                most = finite.fold(most, |most, c| most.max(*c));
            }
            Ok(most)
        };
        let largest: Result<Vec<f64>> = (0..places).into_par_iter().map(largest).collect();
        let most = largest?.into_iter().fold(0.0, f64::max);
        Ok(Self::for_largest(colors, most))
    }

    /// Whether all colours of a model, and the alpha of the same type if it has one, come back unchanged from
    /// bytes.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn are_bytes(self, model: &dyn Model, colors: &Colors) -> Result<bool> {
        const RANGE: u64 = 1 << 20;
        let info = model.info();
        let is_alpha = |a: &Attribute| a.name == "alpha" && a.kind == colors.kind;
        let places: Vec<usize> =
            colors.places.into_iter().chain(info.attributes.iter().position(is_alpha)).collect();
        // Each byte as a number of any type, or of the digits of single precision.
        let of_bytes: Vec<[f64; 3]> = (0..=u8::MAX)
            .map(|byte| {
                let exact = f64::from(byte) / 255.0 * self.full();
                let single = exact as f32;
                [exact, f64::from(single), single.to_string().parse().unwrap_or(exact)]
            })
            .collect();
        let comes_back = |number: &f64| of_bytes[usize::from(self.byte(*number))].contains(number);
        let range = if info.random_access { RANGE } else { info.vertices.max(1) };
        let are_bytes = |first: u64| -> Result<bool> {
            let mut reader = model.vertices(first..(first + range).min(info.vertices))?;
            let (mut chunk, mut lists) = (VertexChunk::default(), vec![Vec::new(); places.len()]);
            while reader.read(&mut chunk)? {
                model.some_attributes(&chunk, &places, &mut lists)?;
                if !lists.iter().flatten().all(comes_back) {
                    return Ok(false);
                }
            }
            Ok(true)
        };
        let ranges = info.vertices.div_ceil(range);
        let all = (0..ranges).into_par_iter().map(|n| are_bytes(n * range));
        all.try_reduce(|| true, |a, b| Ok(a && b))
    }

    /// Byte for a number, in the transfer curve that the number has (sRGB as a rule); 0 for NaN.
    #[inline]
    pub fn byte(self, number: f64) -> u8 {
        let part = match self.0 {
            Meaning::Full(full) => number / f64::from(full),
            Meaning::Coefficients => 0.5 + HARMONIC * number,
        };
        // A conversion saturates, and gives 0 for NaN.
        (part * 255.0).round() as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attributes(names: &[(&str, Type)]) -> Vec<Attribute> {
        names.iter().map(|(name, kind)| Attribute { name: (*name).to_owned(), kind: *kind }).collect()
    }

    #[test]
    fn colours_are_found_by_their_names() {
        let of = |names: &[(&str, Type)]| Colors::among(&attributes(names));
        let byte = |name| (name, Type::U8);
        let usual = of(&[("intensity", Type::F32), byte("red"), byte("green"), byte("blue"), byte("alpha")]);
        assert_eq!(usual, Some(Colors { places: [1, 2, 3], kind: Type::U8, of_splats: false }));
        assert_eq!(usual.unwrap().count(), 4);
        assert_eq!(of(&[byte("B"), byte("G"), byte("R")]).unwrap().places, [2, 1, 0]);
        let two = [byte("r"), byte("g"), byte("b"), byte("red"), byte("green"), byte("blue")];
        assert_eq!(of(&two).unwrap().places, [3, 4, 5]);
        assert_eq!(of(&[byte("red"), byte("green")]), None);
        assert_eq!(of(&[byte("red"), byte("green"), ("blue", Type::F32)]), None);
        assert_eq!(of(&[]), None);
        let float = |name| (name, Type::F32);
        let splats = [float("f_dc_0"), float("f_dc_1"), float("f_dc_2"), float("opacity")];
        assert_eq!((of(&splats), Colors::seen(&attributes(&splats[..2]))), (None, None));
        assert!(Colors::seen(&attributes(&splats)).unwrap().of_splats);
        assert!(!Colors::seen(&attributes(&[&splats[..], &two].concat())).unwrap().of_splats);
    }

    #[test]
    fn numbers_become_bytes() {
        let colors = |kind| Colors { places: [0, 1, 2], kind, of_splats: false };
        let byte = |kind, most, number| ColorScale::for_largest(&colors(kind), most).byte(number);
        assert_eq!(byte(Type::U8, 1.0, 1.0), 1);
        assert_eq!(byte(Type::U16, 65000.0, 65535.0), 255);
        assert_eq!(byte(Type::U16, 255.0, 128.0), 128);
        assert_eq!(byte(Type::F32, 1.0, 0.5), 128);
        assert_eq!(byte(Type::F64, 200.0, 200.0), 200);
        assert_eq!(byte(Type::F64, 1.0, f64::NAN), 0);
        assert_eq!(byte(Type::F64, 1.0, -3.0), 0);
        assert_eq!(byte(Type::F64, 1.0, 3.0), 255);
        let splats = ColorScale::for_largest(&Colors { of_splats: true, ..colors(Type::F32) }, 0.0);
        assert_eq!([0.0, 1.0, -9.0, 9.0, f64::NAN].map(|c| splats.byte(c)), [128, 199, 0, 255, 0]);
    }
}
