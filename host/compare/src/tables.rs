//! The figures of the methods as tables: comma-separated values for other programs, and LaTeX for papers.

use crate::html::number;
use crate::record::{Comparison, Figures, MethodRecord, OnSamples, TimeOf};
use std::fmt::Write as _;

/// A column of numbers.
type Column = (&'static str, fn(&Figures) -> Option<f64>);

/// The shape of a deformed model: of its own faces where they are known, or else of the samples'.
fn shape(f: &Figures) -> Option<&OnSamples> {
    f.on_model.as_ref().or(f.on_samples.as_ref())
}

/// All columns of the CSV, whose names say where the figures are in `compare.json`.
const COLUMNS: [Column; 38] = [
    ("samples", |f| Some(f.samples as f64)),
    ("triangles", |f| Some(f.triangles as f64)),
    ("seconds.sample", |f| f.seconds.sample),
    ("seconds.deform", |f| f.seconds.deform),
    ("seconds.prepare", |f| f.seconds.prepare),
    ("seconds.motion", |f| f.seconds.motion),
    ("seconds.reconstruct", |f| f.seconds.reconstruct),
    ("seconds.processor", |f| f.seconds.processor),
    ("runs", |f| Some(f.seconds.runs.len() as f64)),
    ("seconds.deform spread", |f| f.seconds.spread(|r| r.deform)),
    ("seconds.reconstruct spread", |f| f.seconds.spread(|r| r.reconstruct)),
    ("peak_memory_bytes", |f| f.peak_memory_bytes.map(|bytes| bytes as f64)),
    ("displacement.rms", |f| f.displacement.map(|d| d.rms)),
    ("displacement.max", |f| f.displacement.map(|d| d.max)),
    ("to_first.rms", |f| f.to_first.map(|d| d.rms)),
    ("to_first.p99", |f| f.to_first.map(|d| d.p99)),
    ("to_first.max", |f| f.to_first.map(|d| d.max)),
    ("transfer_error.vertices", |f| f.transfer_error.map(|e| e.vertices as f64)),
    ("transfer_error.rms", |f| f.transfer_error.map(|e| e.rms)),
    ("transfer_error.p999", |f| f.transfer_error.map(|e| e.p999)),
    ("transfer_error.max", |f| f.transfer_error.map(|e| e.max)),
    ("expected_error.rms", |f| f.expected_error.map(|e| e.rms)),
    ("expected_error.p999", |f| f.expected_error.map(|e| e.p999)),
    ("expected_error.worst", |f| f.expected_error.map(|e| e.worst)),
    ("volume_change", |f| shape(f)?.volume_change),
    ("volume_over_border at rest", |f| shape(f)?.volume_over_border.map(|v| v[0])),
    ("volume_over_border", |f| shape(f)?.volume_over_border.map(|v| v[1])),
    ("edges.rms", |f| Some(shape(f)?.edges.rms)),
    ("edges.p99", |f| Some(shape(f)?.edges.p99)),
    ("areas.rms", |f| Some(shape(f)?.areas.rms)),
    ("details.rms", |f| Some(shape(f)?.details.rms)),
    ("details.folded", |f| Some(shape(f)?.details.folded as f64)),
    ("folded_samples", |f| f.folded_samples.map(|n| n as f64)),
    ("energies.arap", |f| Some(shape(f)?.energies.arap)),
    ("energies.symmetric_dirichlet", |f| Some(shape(f)?.energies.symmetric_dirichlet)),
    ("energies.symmetric_dirichlet_max", |f| Some(shape(f)?.energies.symmetric_dirichlet_max)),
    ("energies.collapsed", |f| Some(shape(f)?.energies.collapsed as f64)),
    ("result.bytes", |f| Some(f.result.bytes as f64)),
];

/// Table with a row for each method, the first row with the names of the columns, as of RFC 4180; methods
/// that failed have empty cells.
pub(crate) fn csv(c: &Comparison) -> String {
    let names = ["method", "shape_of"].into_iter().chain(COLUMNS.map(|(name, _)| name));
    let mut rows = vec![names.chain(["result.hash", "error"]).map(str::to_owned).collect::<Vec<_>>()];
    rows.extend(c.methods.iter().map(row));
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> = row.iter().map(|cell| quoted(cell)).collect();
        text += &cells.join(",");
        text += "\r\n";
    }
    text
}

fn row(method: &MethodRecord) -> Vec<String> {
    let figures = method.figures.as_ref();
    let whose = figures.map_or("", |f| match (&f.on_model, &f.on_samples) {
        (Some(_), _) => "model",
        (None, Some(_)) => "samples",
        (None, None) => "",
    });
    let cell = |(_, of): &Column| {
        let number = figures.and_then(of).filter(|x| x.is_finite());
        number.map_or(String::new(), |x| x.to_string())
    };
    let mut row = vec![method.name.clone(), whose.to_owned()];
    row.extend(COLUMNS.iter().map(cell));
    row.push(figures.map_or(String::new(), |f| f.result.hash.clone()));
    row.push(method.error.as_ref().map_or(String::new(), |e| e.what.clone()));
    row
}

/// Cell of such a file, in quotes where it needs them.
fn quoted(cell: &str) -> String {
    if cell.contains(['"', ',', '\r', '\n']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

/// Column of the table for papers: its head, and a method's figure.
type LatexColumn = (&'static str, fn(&Figures) -> Option<String>);

const LATEX_COLUMNS: [LatexColumn; 12] = [
    ("Prepare [s]", |f| time(f, f.seconds.prepare, |r| r.prepare)),
    ("Motion [s]", |f| time(f, f.seconds.motion.or(f.seconds.deform), |r| r.motion.or(r.deform))),
    ("Transfer [s]", |f| time(f, f.seconds.reconstruct, |r| r.reconstruct)),
    ("Memory [MB]", |f| Some(f.peak_memory_bytes?.div_ceil(1 << 20).to_string())),
    ("Volume [\\%]", |f| Some(format!("${:+.2}$", 100.0 * shape(f)?.volume_change?))),
    ("Edges [\\%]", |f| Some(math(100.0 * shape(f)?.edges.rms))),
    ("Areas [\\%]", |f| Some(math(100.0 * shape(f)?.areas.rms))),
    ("ARAP", |f| Some(math(shape(f)?.energies.arap))),
    ("Dirichlet", |f| Some(math(shape(f)?.energies.symmetric_dirichlet))),
    ("Details [$^\\circ$]", |f| Some(math(shape(f)?.details.rms))),
    ("Folded", |f| Some(shape(f)?.details.folded.to_string())),
    ("To first [\\%]", |f| Some(math(100.0 * f.to_first?.rms))),
];

fn time(f: &Figures, median: Option<f64>, of: TimeOf) -> Option<String> {
    let median = median?;
    Some(match f.seconds.spread(of) {
        Some(spread) => format!("${median:.2} \\pm {spread:.2}$"),
        None => format!("{median:.2}"),
    })
}

/// Number as TeX writes it.
fn math(x: f64) -> String {
    let text = number(x);
    match text.split_once('e') {
        Some((digits, exponent)) => format!("${digits} \\cdot 10^{{{exponent}}}$"),
        None => format!("${text}$"),
    }
}

/// Table for the package `booktabs`; columns of which no method has a figure are left out.
pub(crate) fn latex(c: &Comparison) -> String {
    let columns: Vec<LatexColumn> =
        LATEX_COLUMNS.into_iter().filter(|(_, of)| c.done().any(|(_, f)| of(f).is_some())).collect();
    let mut text = String::new();
    // Writing to a text does not fail.
    let _ = writeln!(
        text,
        "% {} vertices of {}, by SIMOD {} on {}; lengths in percent of the diagonal: 1 % is {} in the model's unit.",
        c.model.vertices,
        comment(&c.model.name),
        c.simod,
        comment(&c.machine.in_words()),
        0.01 * c.model.diagonal
    );
    for (method, failure) in c.failed() {
        let _ = writeln!(text, "% {} could not be done: {}", comment(&method.name), comment(&failure.what));
    }
    let _ = writeln!(text, "% \\usepackage{{booktabs}}");
    let _ = writeln!(text, "\\begin{{tabular}}{{l{}}}\n\\toprule", "r".repeat(columns.len()));
    let head: Vec<&str> = ["Method"].into_iter().chain(columns.iter().map(|(name, _)| *name)).collect();
    let _ = writeln!(text, "{} \\\\\n\\midrule", head.join(" & "));
    for (method, figures) in c.done() {
        let cells = columns.iter().map(|(_, of)| of(figures).unwrap_or_else(|| "--".to_owned()));
        let row: Vec<String> = [escaped(&method.name)].into_iter().chain(cells).collect();
        let _ = writeln!(text, "{} \\\\", row.join(" & "));
    }
    text + "\\bottomrule\n\\end{tabular}\n"
}

/// Text as TeX prints it.
fn escaped(text: &str) -> String {
    let mut all = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => all.extend(['\\', c]),
            '~' => all += "\\textasciitilde{}",
            '^' => all += "\\textasciicircum{}",
            '\\' => all += "\\textbackslash{}",
            c if c.is_control() => all.push(' '),
            c => all.push(c),
        }
    }
    all
}

/// Text in a comment, which ends with its line.
fn comment(text: &str) -> String {
    text.replace(char::is_control, " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_what_they_are() {
        assert_eq!(quoted("a, \"b\""), "\"a, \"\"b\"\"\"");
        assert_eq!(quoted("plain"), "plain");
        assert_eq!(escaped("50 % of a_b \\x{}\n"), "50 \\% of a\\_b \\textbackslash{}x\\{\\} ");
        assert_eq!([math(0.0123), math(3e-9)], ["$0.0123$", "$3.0 \\cdot 10^{-9}$"]);
    }
}
