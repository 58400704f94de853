//! Coordinate reference systems as well-known text, of OGC 01-009 or ISO 19162 (WKT 2): their names and
//! units.

/// Nodes that are a system of which positions are.
const SYSTEMS: [&str; 14] = [
    "PROJCS",
    "GEOGCS",
    "GEOCCS",
    "LOCAL_CS",
    "VERT_CS",
    "PROJCRS",
    "PROJECTEDCRS",
    "GEODCRS",
    "GEODETICCRS",
    "GEOGCRS",
    "GEOGRAPHICCRS",
    "VERTCRS",
    "VERTICALCRS",
    "ENGCRS",
];

/// Nodes that only hold such.
const AROUND: [&str; 4] = ["COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "SOURCECRS"];

const UNITS: [&str; 3] = ["UNIT", "LENGTHUNIT", "ANGLEUNIT"];

/// Units that are told: there is one of the plane, and one of heights.
const MOST_UNITS: usize = 4;

/// Most nodes within each other; deeper ones belong to none that matters here.
const DEEPEST: usize = 32;

/// A text in one line, without the characters that end texts in files; `None` where nothing is left of it.
pub(crate) fn in_one_line(text: &str) -> Option<String> {
    let line = text.trim_matches(|c: char| c == '\0' || c.is_whitespace());
    let line: String = line.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    (!line.is_empty()).then_some(line)
}

/// Name as people are shown it: without control characters, of at most 200 characters.
pub(crate) fn short(name: &str) -> Option<String> {
    let name: String = name.trim().chars().filter(|c| !c.is_control()).take(200).collect();
    (!name.is_empty()).then_some(name)
}

/// The name of a system.
pub(crate) fn name(wkt: &str) -> Option<String> {
    wkt.split('"').nth(1).and_then(short)
}

/// Names of the units of positions in a system, none twice: those of its axes, but not of ellipsoids,
/// parameters and the system that it is projected from.
pub(crate) fn units(wkt: &str) -> Vec<String> {
    let (mut open, mut units, mut rest) = (Vec::<String>::new(), Vec::new(), wkt);
    let mut depth = 0usize;
    while let Some(at) = rest.find(['[', '(', ']', ')', '"']) {
        let (before, mark) = (&rest[..at], rest.as_bytes()[at]);
        rest = &rest[at + 1..];
        match mark {
            b'"' => rest = rest.split_once('"').map_or("", |(_, behind)| behind),
            b'[' | b'(' => {
                let is_other = |c: char| !c.is_ascii_alphanumeric() && c != '_';
                let keyword = before.trim_end().rsplit(is_other).next().unwrap_or_default();
                let keyword = keyword.to_ascii_uppercase();
                let quoted = rest.trim_start().strip_prefix('"').and_then(|text| text.split('"').next());
                if UNITS.contains(&&*keyword)
                    && is_of_positions(&open)
                    && let Some(unit) = quoted.and_then(short)
                    && units.len() < MOST_UNITS
                    && !units.contains(&unit)
                {
                    units.push(unit);
                }
                depth += 1;
                if depth <= DEEPEST {
                    open.push(keyword);
                }
            }
            _ => {
                depth = depth.saturating_sub(1);
                open.truncate(depth);
            }
        }
    }
    units
}

/// Line on the units for [details](crate::Model::details).
pub(crate) fn line_of_units(wkt: &str) -> Option<String> {
    let units = units(wkt);
    (!units.is_empty()).then(|| format!("unit: {}", units.join(", ")))
}

/// Whether a value within these nodes, the innermost last, is about positions.
fn is_of_positions(open: &[String]) -> bool {
    let around = if open.last().is_some_and(|last| last == "AXIS") { &open[..open.len() - 1] } else { open };
    let is = |keyword: &String, of: &[&str]| of.contains(&keyword.as_str());
    around.split_last().is_some_and(|(system, outer)| {
        is(system, &SYSTEMS) && outer.iter().all(|keyword| is(keyword, &AROUND))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANE: &str = r#"PROJCS["A",GEOGCS["B",UNIT["degree",0.017]],UNIT["US survey foot",0.3048]]"#;

    #[test]
    fn units_are_those_of_positions() {
        assert_eq!(units(PLANE), ["US survey foot"]);
        let both = format!(r#"COMPD_CS["C",{PLANE},VERT_CS["D",UNIT["metre",1]]]"#);
        assert_eq!(units(&both), ["US survey foot", "metre"]);
        let second = r#"PROJCRS["E",BASEGEOGCRS["G",ELLIPSOID["F",1,2,LENGTHUNIT["metre",1]]],CONVERSION["c",
            PARAMETER["p",1,LENGTHUNIT["yard",1]]],CS[Cartesian,2],AXIS["(E)",east],LENGTHUNIT["foot",0.3]]"#;
        assert_eq!(units(second), ["foot"]);
        assert_eq!(units(&format!("BOUNDCRS[SOURCECRS[{second}],TARGETCRS[{PLANE}]]")), ["foot"]);
        let earth = r#"GEODCRS["W",DATUM["W",ELLIPSOID["W",1,2,LENGTHUNIT["foot",1]]],CS[Cartesian,3],
            AXIS["(X)",geocentricX],UNIT["metre",1]]"#;
        assert_eq!(units(earth), ["metre"]);
        let axes = r#"GEOGCRS["W",CS[ellipsoidal,3],AXIS["lat",north,ANGLEUNIT["degree",0.01]],
            AXIS["h",up,LENGTHUNIT["metre",1]]]"#;
        assert_eq!(units(axes), ["degree", "metre"]);
        assert_eq!(units("GEOGCS[\"B\",UNIT[\"Degree\",0.017]"), ["Degree"]);
        assert!(units("").is_empty() && units("UNIT[\"metre\",1]").is_empty());
    }

    /// Texts that people wrote, or other programs made readable, are read as all others.
    #[test]
    fn blanks_and_capitals_make_no_difference() {
        let spread = PLANE.replace('[', " [ ").replace(',', ",\n  ");
        assert_eq!((units(&spread), name(&spread).as_deref()), (units(PLANE), Some("A")));
        assert_eq!(units(&PLANE.replace("UNIT", "unit").replace("PROJCS", "ProjCS")), units(PLANE));
        assert_eq!(units(&PLANE.replace('[', "(").replace(']', ")")), units(PLANE));
        // Names may have anything in them.
        assert_eq!(units(&PLANE.replace("\"A\"", r#""A ""of"" [1], UNIT[""#)), units(PLANE));
    }

    #[test]
    fn what_is_no_such_text_tells_nothing() {
        for text in ["]]]]", "\"", "UNIT[", "PROJCS[UNIT[\"", &"PROJCS[".repeat(100_000)] {
            assert!(units(text).is_empty());
        }
        let deep = format!("{}{}{PLANE}", "A[".repeat(100), "]".repeat(100));
        assert_eq!(units(&deep), ["US survey foot"]);
        assert_eq!((in_one_line("\0\0 "), in_one_line(" a\n\0")), (None, Some("a".to_owned())));
        assert_eq!(in_one_line("a\nb").as_deref(), Some("a b"));
    }
}
