//! Remarks of LAS on its attributes that other formats have no place for: the type of GPS times, and the
//! parts of the descriptions of extra bytes beside names and types (LAS 1.4, table 24). Each is a line, which
//! PLY keeps as a comment, so that LAS made of that PLY has it again.

use std::fmt::Write;

use super::header::bytes_at;
use crate::Type;

/// Bytes of the description of extra bytes.
pub(super) const DESCRIPTION: usize = 192;

/// Bytes at which the parts of a description begin: the text is the last, of 32 bytes.
const NO_DATA: usize = 40;
pub(super) const LEAST: usize = 64;
pub(super) const MOST: usize = 88;
pub(super) const SCALE: usize = 112;
pub(super) const OFFSET: usize = 136;
const TEXT: usize = 160;

/// Bits of a description's options, which say which of its parts are there.
const HAS_NO_DATA: u8 = 1;
pub(super) const HAS_LEAST: u8 = 2;
pub(super) const HAS_MOST: u8 = 4;
pub(super) const HAS_SCALE: u8 = 8;
pub(super) const HAS_OFFSET: u8 = 16;

/// Line on the type of GPS times, and first word of the lines on extra bytes.
pub(crate) const GPS_TIME: &str = "gps-time adjusted";
const EXTRA_BYTES: &str = "extra-bytes";

/// Words before a name with blanks, which a quote ends.
const NAME: &str = " name \"";

/// Whether a line is a remark.
pub(crate) fn is_remark(line: &str) -> bool {
    line == GPS_TIME || ExtraBytesRemark::parse(line).is_some()
}

/// Losses of a format that does not keep remarks, in a few words each.
pub(crate) fn losses(remarks: &[String]) -> Vec<String> {
    let extra = |line: &String| ExtraBytesRemark::parse(line).map(|remark| remark.full_name().to_owned());
    let described: Vec<String> = remarks.iter().filter_map(extra).collect();
    let of_extra = (!described.is_empty()).then(|| {
        format!("what LAS says of the extra bytes {}: type, range and description", described.join(", "))
    });
    let has_time = remarks.iter().any(|line| line == GPS_TIME);
    let of_time = has_time.then(|| "that GPS times are adjusted standard ones".to_owned());
    of_time.into_iter().chain(of_extra).collect()
}

/// Whether a remark is about extra bytes of this name, which has blanks.
pub(crate) fn has_name(remarks: &[String], name: &str) -> bool {
    let is_its =
        |line: &String| ExtraBytesRemark::parse(line).is_some_and(|remark| remark.full_name() == name);
    remarks.iter().any(is_its)
}

/// Remark on the numbers of extra bytes.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ExtraBytesRemark {
    /// The attribute's name, without blanks.
    pub name: String,
    /// The attribute's name with blanks, if it has any.
    pub spaced: Option<String>,
    /// The type in which the numbers are stored, if these are scaled: as `stored · scale + offset`.
    pub stored: Option<Type>,
    pub scale: Option<f64>,
    pub offset: Option<f64>,
    /// The number that is none, the least and the largest, as stored.
    pub no_data: Option<f64>,
    pub least: Option<f64>,
    pub most: Option<f64>,
    pub text: String,
}

/// Name of an attribute as remarks and PLY have it: without blanks.
pub(super) fn name_of(name: &str) -> String {
    name.chars().map(|c| if c.is_whitespace() { '_' } else { c }).collect()
}

/// A number with an exponent where zeros would be many.
fn in_digits(number: f64) -> String {
    let is_plain = number == 0.0 || (1e-5..1e16).contains(&number.abs());
    if is_plain { number.to_string() } else { format!("{number:e}") }
}

impl ExtraBytesRemark {
    /// Reads the remark on a description. Where the numbers are stored in another type, `scaled` is that
    /// type; `stored` reads one of the description's numbers.
    pub fn read(name: &str, one: &[u8], scaled: Option<Type>, stored: impl Fn(&[u8]) -> f64) -> Self {
        let number = |bit: u8, at: usize| (one[3] & bit != 0).then(|| stored(&one[at..]));
        let double = |bit: u8, at| {
            (scaled.is_some() && one[3] & bit != 0).then(|| f64::from_le_bytes(bytes_at(one, at)))
        };
        let text = one[TEXT..DESCRIPTION].split(|byte| *byte == 0).next().unwrap_or_default();
        Self {
            name: name_of(name),
            spaced: (name.contains(char::is_whitespace) && !name.contains(['"', '\'']))
                .then(|| name.to_owned()),
            stored: scaled,
            scale: double(HAS_SCALE, SCALE),
            offset: double(HAS_OFFSET, OFFSET),
            no_data: number(HAS_NO_DATA, NO_DATA),
            least: number(HAS_LEAST, LEAST),
            most: number(HAS_MOST, MOST),
            text: crate::wkt::in_one_line(&String::from_utf8_lossy(text)).unwrap_or_default(),
        }
    }

    /// Whether the remark has nothing but a name.
    pub fn is_empty(&self) -> bool {
        *self == Self { name: self.name.clone(), ..Self::default() }
    }

    /// The attribute's name.
    pub fn full_name(&self) -> &str {
        self.spaced.as_ref().unwrap_or(&self.name)
    }

    /// The remark as a line of text.
    pub fn line(&self) -> String {
        let mut line = format!("{EXTRA_BYTES} {}", self.name);
        // Writing to memory does not fail.
        if let Some(stored) = self.stored {
            let _ = write!(line, " type {}", stored.name());
        }
        for (word, number) in self.numbers() {
            if let Some(number) = number {
                let _ = write!(line, " {word} {}", in_digits(number));
            }
        }
        if let Some(spaced) = &self.spaced {
            let _ = write!(line, "{NAME}{spaced}\"");
        }
        if !self.text.is_empty() {
            let _ = write!(line, " description {}", self.text);
        }
        line
    }

    fn numbers(&self) -> [(&'static str, Option<f64>); 5] {
        let Self { scale, offset, no_data, least, most, .. } = *self;
        [("scale", scale), ("offset", offset), ("no-data", no_data), ("least", least), ("most", most)]
    }

    /// Reads a remark from its line; none where the line has words that are not known.
    pub fn parse(line: &str) -> Option<Self> {
        let rest = line.strip_prefix(EXTRA_BYTES)?.strip_prefix(' ')?;
        let (head, text) = rest.split_once(" description ").unwrap_or((rest, ""));
        let (head, spaced, text) = match head.split_once(NAME) {
            // A name may have that word, too, but no quote.
            Some((head, _)) => {
                let (spaced, behind) = rest[head.len() + NAME.len()..].split_once('"')?;
                (head, Some(spaced.to_owned()), behind.strip_prefix(" description ").unwrap_or_default())
            }
            None => (head, None, text),
        };
        let mut words = head.split(' ');
        let name = words.next()?.to_owned();
        let mut this = Self { name, spaced, text: text.to_owned(), ..Self::default() };
        while let (Some(word), Some(value)) = (words.next(), words.next()) {
            let number = value.parse().ok();
            match word {
                "type" => this.stored = value.parse().ok(),
                "scale" => this.scale = number,
                "offset" => this.offset = number,
                "no-data" => this.no_data = number,
                "least" => this.least = number,
                "most" => this.most = number,
                _ => return None,
            }
        }
        Some(this)
    }

    /// Number that is stored for another one, in a type that may hold more numbers.
    pub fn to_stored(&self, number: f64) -> f64 {
        let stored = (number - self.offset.unwrap_or(0.0)) / self.scale.unwrap_or(1.0);
        match self.stored {
            Some(Type::F64) | None => stored,
            Some(Type::F32) => f64::from(stored as f32),
            Some(_) => stored.round(),
        }
    }

    /// Number that a stored number stands for.
    pub fn of_stored(&self, stored: f64) -> f64 {
        stored * self.scale.unwrap_or(1.0) + self.offset.unwrap_or(0.0)
    }

    /// The remark on the same numbers, not scaled any more.
    pub fn unscaled(self) -> Self {
        let number = |stored: Option<f64>| stored.map(|stored| self.of_stored(stored));
        let [no_data, least, most] = [self.no_data, self.least, self.most].map(number);
        Self { stored: None, scale: None, offset: None, no_data, least, most, ..self }
    }

    /// Puts the remark into a description of numbers that are stored in a type.
    pub fn put(&self, kind: Type, one: &mut [u8]) {
        let bytes = |number: f64| match kind {
            Type::F32 | Type::F64 => number.to_le_bytes(),
            Type::U8 | Type::U16 | Type::U32 => (number as u64).to_le_bytes(),
            Type::I8 | Type::I16 | Type::I32 => (number as i64).to_le_bytes(),
        };
        let double = |number: f64| number.to_le_bytes();
        let parts = [
            (HAS_NO_DATA, NO_DATA, self.no_data.map(bytes)),
            (HAS_LEAST, LEAST, self.least.map(bytes)),
            (HAS_MOST, MOST, self.most.map(bytes)),
            (HAS_SCALE, SCALE, self.scale.map(double)),
            (HAS_OFFSET, OFFSET, self.offset.map(double)),
        ];
        for (bit, at, bytes) in parts {
            if let Some(bytes) = bytes {
                one[3] |= bit;
                one[at..at + 8].copy_from_slice(&bytes);
            }
        }
        let fits = (0..=DESCRIPTION - TEXT).rev().find_map(|end| self.text.get(..end));
        let text = if self.text.len() < DESCRIPTION - TEXT { &self.text } else { fits.unwrap_or_default() };
        one[TEXT..TEXT + text.len()].copy_from_slice(text.as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remarks_come_back_from_their_lines() {
        let remark = ExtraBytesRemark {
            name: "Height_above".to_owned(),
            spaced: Some("Height above".to_owned()),
            stored: Some(Type::I16),
            scale: Some(0.01),
            offset: Some(-1e-9),
            no_data: Some(-9999.0),
            least: Some(f64::MIN),
            most: Some(0.0),
            text: "of the ground, in  metres".to_owned(),
        };
        assert_eq!(ExtraBytesRemark::parse(&remark.line()), Some(remark.clone()));
        assert!(is_remark(&remark.line()) && is_remark(GPS_TIME) && !is_remark("extra-bytesize 3"));
        assert!(!remark.is_empty() && ExtraBytesRemark::parse("extra-bytes a").unwrap().is_empty());
        // Lines with unknown words are no remarks: as remarks, these words would be lost silently.
        for other in ["extra-bytes", "extra-bytes a colour 3", "comment"] {
            assert!(ExtraBytesRemark::parse(other).is_none() && !is_remark(other), "{other}");
        }
        // Words of such lines are also those of names and descriptions.
        for (spaced, text) in [("a description b", "of c"), ("a description b", ""), ("a b", "as name \"c\"")]
        {
            let (name, spaced, text) = (name_of(spaced), Some(spaced.to_owned()), text.to_owned());
            let remark = ExtraBytesRemark { name, spaced, text, ..ExtraBytesRemark::default() };
            assert_eq!(ExtraBytesRemark::parse(&remark.line()), Some(remark));
        }
        let mut one = [0; DESCRIPTION];
        remark.put(Type::I16, &mut one);
        let stored = |bytes: &[u8]| i64::from_le_bytes(bytes_at(bytes, 0)) as f64;
        let back = ExtraBytesRemark::read("Height above", &one, Some(Type::I16), stored);
        assert_eq!(back, ExtraBytesRemark { least: Some(i64::MIN as f64), ..remark.clone() });
        // Without its scale, it speaks of the numbers themselves.
        let plain = remark.unscaled();
        assert_eq!((plain.stored, plain.no_data), (None, Some(-9999.0 * 0.01 - 1e-9)));
    }
}
