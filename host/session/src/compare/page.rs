//! The page of a comparison: one HTML file that needs nothing else, no scripts, and can be printed.

use super::figures::{DETAIL, Pair};
use super::folder::{REST, difference};
use super::html::{NONE, Table, escape, number, or_dash, round_percent};
use super::pictures::color;
use super::record::{Comparison, MethodRecord};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value};
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");

/// The page, with these pictures in it.
pub(super) fn page(comparison: &Comparison, pictures: &[(String, Vec<u8>)]) -> String {
    let title = format!("{} methods on {}", comparison.methods.len(), comparison.model.name);
    let sections = [
        head(comparison, &title),
        failures(comparison),
        gallery(comparison, pictures),
        differences(comparison, pictures),
        rest(comparison),
        pairs(comparison),
        exact(comparison),
        costs(comparison),
        meaning(),
        parameters(comparison),
        format!("<h2>The file</h2>\n<pre>{}</pre>\n", escape(&comparison.compare_file)),
    ];
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n\
         <body>\n<main>\n{}</main>\n</body>\n</html>\n",
        escape(&title),
        sections.concat()
    )
}

fn head(c: &Comparison, title: &str) -> String {
    let m = &c.model;
    let facts = [
        ("Model", m.name.clone()),
        ("Size", format!("{} vertices, {} bytes", m.vertices, m.bytes)),
        ("Fingerprint", m.fingerprint.clone()),
        ("Diagonal", format!("{} in the model's unit", m.diagonal)),
        ("Made by", format!("SIMOD {}", c.simod)),
    ];
    let facts: String =
        facts.iter().map(|(name, value)| format!("<dt>{name}</dt><dd>{}</dd>\n", escape(value))).collect();
    format!(
        "<h1>{}</h1>\n<dl>\n{facts}</dl>\n<p class=\"soft\">Lengths are in percent of the diagonal of the model's \
         bounding box at rest. All figures are in <code>compare.json</code> as well.</p>\n",
        escape(title)
    )
}

fn failures(c: &Comparison) -> String {
    let mut table = Table::new(
        "Methods that could not be done.",
        &[("method", ""), ("what is wrong", ""), ("what to do", "")],
    );
    let mut any = false;
    for (method, failure) in c.failed() {
        table.row(&[&method.name, &failure.what, &failure.hint], []);
        any = true;
    }
    if any { format!("<h2 class=\"bad\">Failed</h2>\n{}", table.finish()) } else { String::new() }
}

/// A picture with its caption, which is HTML; nothing where there is no such picture.
fn figure(pictures: &[(String, Vec<u8>)], name: &str, alt: &str, caption: &str) -> String {
    let Some((_, bytes)) = pictures.iter().find(|(other, _)| other == name) else { return String::new() };
    format!(
        "<figure><img alt=\"{}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>\n",
        escape(alt),
        STANDARD.encode(bytes)
    )
}

fn gallery(c: &Comparison, pictures: &[(String, Vec<u8>)]) -> String {
    let of = |m: &MethodRecord| figure(pictures, &format!("{}.png", m.file), &m.name, &escape(&m.name));
    let methods: String = c.done().map(|(m, _)| of(m)).collect();
    format!(
        "<h2>Results</h2>\n<p class=\"soft\">All from the same place. The shared regions:<span class=\"key\" \
         style=\"background:#788caf\"></span>fixed<span class=\"key\" style=\"background:#e6af3c\"></span>handle</p>\n\
         <div class=\"grid\">\n{}{methods}</div>\n",
        figure(pictures, REST, "The model at rest", "at rest")
    )
}

fn differences(c: &Comparison, pictures: &[(String, Vec<u8>)]) -> String {
    let Some((first, _)) = c.done().next() else { return String::new() };
    let of = |m: &MethodRecord| {
        let alt = format!("Distance of {} to {}", m.name, first.name);
        figure(pictures, &format!("{}.png", difference(&m.file)), &alt, &escape(&m.name))
    };
    let figures: String = c.done().skip(1).map(|(m, _)| of(m)).collect();
    if figures.is_empty() {
        return String::new();
    }
    let stops: Vec<String> =
        (0..=10).map(|i| color(i as f32 / 10.0)).map(|[r, g, b]| format!("rgb({r},{g},{b})")).collect();
    format!(
        "<h2>Where they differ from {}</h2>\n<p class=\"soft\">Each vertex by its distance to the same vertex of {}, on \
         one scale for all:</p>\n<p><span style=\"display:inline-block;width:14rem;max-width:50%;height:.8em;\
         background:linear-gradient(to right,{});border-radius:2px;print-color-adjust:exact\"></span> 0 to {} of the \
         diagonal and beyond</p>\n<div class=\"grid\">\n{figures}</div>\n",
        escape(&first.name),
        escape(&first.name),
        stops.join(","),
        round_percent(c.color_scale),
    )
}

fn rest(c: &Comparison) -> String {
    let titles = [
        ("method", ""),
        ("displacement rms", "%"),
        ("largest", "%"),
        ("volume", "%"),
        ("edges rms", "%"),
        ("edges 99th", "%"),
        ("areas rms", "%"),
        ("details rms", "°"),
        ("folded triangles", ""),
        ("folded samples", ""),
    ];
    let mut table = Table::new("Displacements of all vertices; the rest on the samples.", &titles);
    for (method, f) in c.done() {
        let moved = |of: fn(&simod_core::measure::Difference) -> f64| {
            or_dash(f.displacement.as_ref().map(|d| 100.0 * of(d)))
        };
        let shape = f.on_samples;
        let cells = [
            moved(|d| d.rms),
            moved(|d| d.max),
            shape.and_then(|s| s.volume_change).map_or(NONE.to_owned(), |x| format!("{:+.2}", 100.0 * x)),
            or_dash(shape.map(|s| 100.0 * s.edges.rms)),
            or_dash(shape.map(|s| 100.0 * s.edges.p99)),
            or_dash(shape.map(|s| 100.0 * s.areas.rms)),
            or_dash(shape.map(|s| s.details.rms)),
            shape.map_or(NONE.to_owned(), |s| s.details.folded.to_string()),
            f.folded_samples.map_or(NONE.to_owned(), |n| n.to_string()),
        ];
        table.row(&[&method.name], cells);
    }
    format!("<h2>Beside the model at rest</h2>\n{}", table.finish())
}

fn pairs(c: &Comparison) -> String {
    if c.pairs.is_empty() {
        return String::new();
    }
    let titles = [
        ("first", ""),
        ("second", ""),
        ("vertices rms", "%"),
        ("vertices 99th", "%"),
        ("vertices max", "%"),
        ("normals rms", "°"),
        ("surface rms →", "%"),
        ("surface rms ←", "%"),
        ("farthest →", "%"),
        ("farthest ←", "%"),
        ("Hausdorff", "%"),
    ];
    let mut table = Table::new(
        "The same vertices of both, all of them; surfaces on the samples, from the first to the second (→) and back (←).",
        &titles,
    );
    for Pair { first, second, vertices, surfaces } in &c.pairs {
        let ways = |of: fn(&simod_core::measure::Distances) -> f64, i: usize| {
            or_dash(surfaces.map(|ways| 100.0 * of(&ways[i])))
        };
        let cells = [
            number(100.0 * vertices.rms),
            number(100.0 * vertices.p99),
            number(100.0 * vertices.max),
            or_dash(vertices.normals.map(|n| n.rms)),
            ways(|d| d.rms, 0),
            ways(|d| d.rms, 1),
            ways(|d| d.max, 0),
            ways(|d| d.max, 1),
            or_dash(surfaces.map(|[there, back]| 100.0 * there.max.max(back.max))),
        ];
        table.row(&[first, second], cells);
    }
    format!("<h2>Beside each other</h2>\n{}", table.finish())
}

fn exact(c: &Comparison) -> String {
    let titles = [("method", ""), ("rms", "%"), ("99.9th", "%"), ("max", "%")];
    let mut table = Table::new("All vertices beside their exact images.", &titles);
    let mut any = false;
    for (method, f) in c.done() {
        let of = |x: fn(&simod_core::reconstruction::transfer_error::TransferError) -> f64| {
            or_dash(f.transfer_error.as_ref().map(|e| 100.0 * x(e)))
        };
        any |= f.transfer_error.is_some();
        table.row(&[&method.name], [of(|e| e.rms), of(|e| e.p999), of(|e| e.max)]);
    }
    if any {
        format!("<h2>Transfer from the samples to the model</h2>\n{}", table.finish())
    } else {
        String::new()
    }
}

fn costs(c: &Comparison) -> String {
    let titles = [
        ("method", ""),
        ("samples", ""),
        ("triangles", ""),
        ("sample", "s"),
        ("prepare, deform", "s"),
        ("reconstruct", "s"),
        ("peak memory", "MB"),
    ];
    let mut table =
        Table::new("Of a single run each: repeat it before you trust small differences.", &titles);
    for (method, f) in c.done() {
        let s = f.seconds;
        let memory = f.peak_memory_bytes.map_or(NONE.to_owned(), |bytes| bytes.div_ceil(1 << 20).to_string());
        let cells = [f.samples.to_string(), f.triangles.to_string()];
        let times = [s.sample, s.deform, s.reconstruct].map(|s| format!("{s:.2}"));
        table.row(&[&method.name], cells.into_iter().chain(times).chain([memory]));
    }
    format!("<h2>Time and memory</h2>\n{}", table.finish())
}

/// What the columns mean.
fn meaning() -> String {
    let terms = [
        ("displacement", "how far vertices moved from where they are at rest."),
        ("volume", "its relative change; a dash where the triangles between the samples are not closed."),
        (
            "edges, areas",
            "relative changes |after / before − 1| of edges' lengths and triangles' areas; some come with any bend.",
        ),
        (
            "folded triangles, folded samples",
            "triangles that turn by more than a right angle against the smooth surface beneath; samples around which the \
             map turns the surface inside out.",
        ),
        (
            "vertices",
            "distances between the same vertices of two results; 99 of 100 are below the 99th percentile (to 2 %).",
        ),
        ("normals", "the angle between the normals of the same vertices; a dash where the model has none."),
        (
            "surface, farthest, Hausdorff",
            "distances from the samples of one result to the nearest points of the triangles of the other: the root mean \
             square by area, the largest one way, and the larger of both ways. As samples alone are looked at, the last two \
             are lower bounds. They do not see vertices that slide along the surface.",
        ),
        (
            "transfer",
            "vertices beside their exact images, where all plugins of a method know their map between the samples; a dash \
             where not.",
        ),
        (
            "sample",
            "done once for all methods with the same sampling, with triangles, though some methods would not need them.",
        ),
        (
            "peak memory",
            "anonymous memory of the process while the method was at work; what earlier methods left to be compared \
             counts, too, and plugins in processes of their own do not.",
        ),
    ];
    let details = format!(
        "how far what is smaller than {} of the diagonal turns against the smooth surface beneath (M. Botsch, O. Sorkine, \
         IEEE TVCG 2008, as a figure). 0 for rigid motions.",
        round_percent(DETAIL)
    );
    let mut list: String =
        terms.iter().map(|(term, text)| format!("<dt>{term}</dt><dd>{}</dd>\n", escape(text))).collect();
    let _ = writeln!(list, "<dt>details</dt><dd>{}</dd>", escape(&details));
    format!("<h2>What the figures mean</h2>\n<dl>\n{list}</dl>\n")
}

fn parameters(c: &Comparison) -> String {
    let mut html = "<h2>Methods</h2>\n".to_owned();
    for method in &c.methods {
        let given = words(&method.sampling);
        let sampling = if given.is_empty() { "as by default".to_owned() } else { given };
        let _ = writeln!(html, "<h3>{}</h3>\n<dl>", escape(&method.name));
        let mut line = |name: &str, value: &str| {
            let _ = writeln!(html, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value));
        };
        for step in &method.steps {
            line(&format!("{} {}", step.plugin, step.version), &words(&step.params));
        }
        line("sampling", &sampling);
        line("reconstruction", &method.reconstruction);
        for message in method.figures.iter().flat_map(|f| &f.messages) {
            line("said", message);
        }
        html.push_str("</dl>\n");
        if let Some(session) = &method.session {
            let _ = writeln!(html, "<pre>{}</pre>", escape(session));
        }
    }
    html
}

/// `key = value, key = value`.
fn words(values: &Map<String, Value>) -> String {
    values.iter().map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join(", ")
}
