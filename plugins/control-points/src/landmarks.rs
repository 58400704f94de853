//! Landmarks in a file: their places on the model, and their places in the result.

use glam::DVec3;
use std::collections::HashMap;
use std::path::Path;

/// Most bytes of a file.
const MOST_BYTES: u64 = 16 << 20;
/// Most landmarks: splines take the cube of their number.
pub const MOST: usize = 4000;
/// Weights of landmarks that are no checks: other weights would leave no sums.
const WEIGHTS: std::ops::RangeInclusive<f64> = 1e-30..=1e30;
/// Characters of a name that are told.
const LONGEST: usize = 60;

/// A point of the model, and its place in the result.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    pub name: String,
    pub source: DVec3,
    pub target: DVec3,
    /// Weight of the landmark; a landmark of weight 0 is a check, and does not take part.
    pub weight: f64,
    /// The line of the file, from 1 on.
    pub line: usize,
}

/// Defect of a file with landmarks, with its line, where it is in one.
pub type BadLandmarks = (Option<usize>, String);

/// Landmarks of a file, in the file's coordinates.
///
/// # Errors
/// The file cannot be read, or a line is no landmark.
pub fn read(path: &Path) -> Result<Vec<Landmark>, BadLandmarks> {
    let unreadable = |e: std::io::Error| (None, format!("cannot be read: {e}"));
    if std::fs::metadata(path).map_err(unreadable)?.len() > MOST_BYTES {
        return Err((None, "is too large".to_owned()));
    }
    let bytes = std::fs::read(path).map_err(unreadable)?;
    let text = std::str::from_utf8(&bytes).map_err(|_| (None, "is no text".to_owned()))?;
    parse(text.trim_start_matches('\u{feff}'))
}

/// Landmarks of a text, a line for each: a name, three numbers of the source, three of the target, and
/// maybe a weight, separated by commas, semicolons or tabs. A first line whose fields are no numbers is a
/// heading; empty lines, and those that begin with `#`, are passed over.
fn parse(text: &str) -> Result<Vec<Landmark>, BadLandmarks> {
    let mut landmarks: Vec<Landmark> = Vec::new();
    let mut lines: HashMap<String, usize> = HashMap::new();
    let mut is_first = true;
    for (line, text) in (1..).zip(text.lines()) {
        if text.trim().is_empty() || text.trim_start().starts_with('#') {
            continue;
        }
        let fields = fields(text);
        let may_be_heading = std::mem::replace(&mut is_first, false);
        if may_be_heading && fields.iter().skip(1).take(6).all(|f| f.parse::<f64>().is_err()) {
            continue;
        }
        let landmark = landmark(&fields, line).map_err(|what| (Some(line), what))?;
        if let Some(before) = lines.insert(landmark.name.clone(), line) {
            return Err((Some(line), format!("names `{}`, as line {before} does", landmark.name)));
        }
        landmarks.push(landmark);
        if landmarks.len() > MOST {
            return Err((Some(line), format!("is landmark {}: {MOST} are the most", landmarks.len())));
        }
    }
    if landmarks.is_empty() {
        return Err((None, "has no landmark".to_owned()));
    }
    Ok(landmarks)
}

fn landmark(fields: &[String], line: usize) -> Result<Landmark, String> {
    if !(7..=8).contains(&fields.len()) {
        return Err(format!(
            "has {} fields, not a name, three numbers of the source, three of the target, and maybe a weight",
            fields.len()
        ));
    }
    let number = |field: &String| match field.parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        Ok(_) => Err(format!("has `{field}`, which is not finite")),
        Err(_) => Err(format!("has `{}`, which is no number", short(field))),
    };
    let numbers = fields[1..].iter().map(number).collect::<Result<Vec<f64>, _>>()?;
    let weight = numbers.get(6).copied().unwrap_or(1.0);
    if weight < 0.0 {
        return Err(format!("has the weight {weight}, below 0"));
    }
    if weight > 0.0 && !WEIGHTS.contains(&weight) {
        let [least, most] = [WEIGHTS.start(), WEIGHTS.end()];
        return Err(format!("has the weight {weight:e}: 0, or from {least:e} to {most:e} it can be"));
    }
    let name = short(&fields[0]);
    Ok(Landmark {
        name: if name.is_empty() { format!("line {line}") } else { name },
        source: DVec3::from_slice(&numbers[..3]),
        target: DVec3::from_slice(&numbers[3..6]),
        weight,
        line,
    })
}

/// Fields of a line, some of which may be in quotes.
fn fields(line: &str) -> Vec<String> {
    let separator = [';', '\t', ','].into_iter().find(|s| line.contains(*s)).unwrap_or(',');
    let (mut fields, mut is_quoted) = (vec![String::new()], false);
    for c in line.chars() {
        match c {
            '"' => is_quoted = !is_quoted,
            c if c == separator && !is_quoted => fields.push(String::new()),
            c => fields.last_mut().into_iter().for_each(|field| field.push(c)),
        }
    }
    fields.iter().map(|field| field.trim().to_owned()).collect()
}

fn short(text: &str) -> String {
    text.chars().take(LONGEST).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn headings_separators_quotes_and_weights() {
        let text =
            "name,x,y,z,X,Y,Z,weight\n# a comment\n\"a, b\",1,2,3,4,5,6\n\nc, 1e1, 2, 3, 4, 5, 6, 0.5\n";
        let found = parse(text).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].name.as_str(), found[0].weight, found[0].line), ("a, b", 1.0, 3));
        assert_eq!((found[1].source, found[1].weight), (DVec3::new(10.0, 2.0, 3.0), 0.5));
        assert_eq!(found[1].target, DVec3::new(4.0, 5.0, 6.0));
        assert_eq!(parse("a;1;2;3;4;5;6\nb\t1\t2\t3\t4\t5\t6").unwrap().len(), 2);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, line, what) in [
            ("", None, "no landmark"),
            ("name,x,y,z,X,Y,Z\n", None, "no landmark"),
            ("a,1,2,3,4,5\n", Some(1), "6 fields"),
            ("a,1,2,3,4,5,6\nb,1,2,3,4,5,NaN", Some(2), "not finite"),
            ("a,1,2,3,4,5,6\nb,1,2,3,4,5,x", Some(2), "no number"),
            ("a,1,2,3,4,5,6\n\na,1,2,3,4,5,6", Some(3), "as line 1 does"),
            ("a,1,2,3,4,5,6,-1", Some(1), "below 0"),
            ("a,1,2,3,4,5,6,1e300", Some(1), "the weight 1e300"),
            ("a,1,2,3,4,5,6,1,9", Some(1), "9 fields"),
        ] {
            let (at, told) = parse(text).unwrap_err();
            assert!(at == line && told.contains(what), "{text}: {at:?}, {told}");
        }
        let many: String = (0..=MOST).map(|i| format!("{i},1,2,3,4,5,6\n")).collect();
        assert!(parse(&many).unwrap_err().1.contains("the most"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[a1,;\t\".e\n# -]{0,80}") {
            if let Ok(found) = parse(&text) {
                prop_assert!(found.iter().all(|l| l.source.is_finite() && l.target.is_finite() && l.weight >= 0.0));
            }
        }
    }
}
