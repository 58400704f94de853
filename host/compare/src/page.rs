//! The page of a comparison: one HTML file that needs nothing else, no scripts, and can be printed.

use crate::figures::DETAIL;
use crate::file::CropPlace;
use crate::folder::{REST, difference};
use crate::html::{NONE, Table, number, or_dash, round_percent};
use crate::record::{Comparison, Figures, MethodRecord, Pair, TimeOf};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::{Map, Value};
use simod_core::reconstruction::ExpectedError;
use simod_picture::scale_color as color;

const STYLE: &str = include_str!("page.css");

/// Page with these pictures, and with parts of them.
pub(crate) fn page(comparison: &Comparison, crops: &[CropPlace], pictures: &[(String, Vec<u8>)]) -> String {
    let title = format!("{} methods on {}", comparison.methods.len(), comparison.model.name);
    let page = html! {
        (DOCTYPE) "\n"
        html lang="en" {
            "\n"
            head {
                "\n"
                meta charset="utf-8";
                "\n"
                meta name="viewport" content="width=device-width, initial-scale=1";
                "\n"
                title { (title) }
                "\n"
                style { "\n" (PreEscaped(STYLE)) }
                "\n"
            }
            "\n"
            body {
                "\n"
                main {
                    "\n"
                    (head(comparison, &title))
                    (failures(comparison))
                    (gallery(comparison, "", pictures))
                    (differences(comparison, "", pictures))
                    @for crop in crops {
                        h2 { (crop.name) ", " (round_percent(crop.part)) " of the width" }
                        "\n"
                        (gallery(comparison, &format!("_{}", crop.file), pictures))
                        (differences(comparison, &format!("_{}", crop.file), pictures))
                    }
                    (rest(comparison))
                    (energies(comparison))
                    (pairs(comparison))
                    (exact(comparison))
                    (costs(comparison))
                    (meaning())
                    (parameters(comparison))
                    h2 { "The file" }
                    "\n"
                    pre { (comparison.compare_file) }
                    "\n"
                }
                "\n"
            }
            "\n"
        }
        "\n"
    };
    // HTML forbids control characters, which names and files may have.
    page.into_string().replace(|c: char| c.is_control() && !matches!(c, '\n' | '\t'), "\u{fffd}")
}

/// Section of a heading and its content.
fn section(title: &str, content: &Markup) -> Markup {
    html! { h2 { (title) } "\n" (content) }
}

/// Entry of a term and its meaning or value.
fn entry(term: &str, text: &str) -> Markup {
    html! { dt { (term) } dd { (text) } "\n" }
}

fn head(c: &Comparison, title: &str) -> Markup {
    let m = &c.model;
    let facts = [
        ("Model", m.name.clone()),
        ("Size", format!("{} vertices, {} bytes", m.vertices, m.bytes)),
        ("Fingerprint", m.fingerprint.clone()),
        ("Diagonal", format!("{} in the model's unit", m.diagonal)),
        ("Made by", format!("SIMOD {}, {}", c.simod, c.machine.in_words())),
    ];
    html! {
        h1 { (title) }
        "\n"
        dl { "\n" @for (name, value) in &facts { (entry(name, value)) } }
        "\n"
        p.soft {
            "Lengths are in percent of the diagonal of the model's bounding box at rest: 1 % is "
            (number(0.01 * m.diagonal)) " in the model's unit. All figures are in "
            code { "compare.json" }
            " as well."
        }
        "\n"
    }
}

fn failures(c: &Comparison) -> Markup {
    let titles = [("method", ""), ("what is wrong", ""), ("what to do", "")];
    let mut table = Table::new("Methods that could not be done.", &titles);
    for (method, failure) in c.failed() {
        table.row(&[&method.name, &failure.what, &failure.hint], []);
    }
    html! {
        @if !table.is_empty() { h2.bad { "Failed" } "\n" (table.finish()) }
    }
}

/// A picture with its caption; nothing where there is no such picture.
fn figure(pictures: &[(String, Vec<u8>)], name: &str, alt: &str, caption: &str) -> Option<Markup> {
    let (_, bytes) = pictures.iter().find(|(other, _)| other == name)?;
    let source = format!("data:image/png;base64,{}", STANDARD.encode(bytes));
    Some(html! { figure { img alt=(alt) src=(source); figcaption { (caption) } } "\n" })
}

/// Gallery of the pictures whose names have this ending before their extension.
fn gallery(c: &Comparison, end: &str, pictures: &[(String, Vec<u8>)]) -> Markup {
    let methods =
        c.done().filter_map(|(m, _)| figure(pictures, &format!("{}{end}.png", m.file), &m.name, &m.name));
    let rest = figure(pictures, &format!("{REST}{end}.png"), "The model at rest", "at rest");
    let all = rest.into_iter().chain(methods);
    let key = |color: &str| html! { span.key style=(format!("background:{color}")) {} };
    html! {
        @if end.is_empty() { h2 { "Results" } }
        "\n"
        p.soft {
            "All from the same place. The shared regions:" (key("#788caf")) "fixed" (key("#e6af3c")) "handle"
        }
        "\n"
        div.grid { "\n" @for figure in all { (figure) } }
        "\n"
    }
}

fn differences(c: &Comparison, end: &str, pictures: &[(String, Vec<u8>)]) -> Markup {
    let Some((first, _)) = c.done().next() else { return Markup::default() };
    let of = |m: &MethodRecord| {
        let alt = format!("Distance of {} to {}", m.name, first.name);
        figure(pictures, &format!("{}{end}.png", difference(&m.file)), &alt, &m.name)
    };
    let figures: Vec<Markup> = c.done().skip(1).filter_map(|(m, _)| of(m)).collect();
    if figures.is_empty() {
        return Markup::default();
    }
    let stops: Vec<String> =
        (0..=10).map(|i| color(i as f32 / 10.0)).map(|[r, g, b]| format!("rgb({r},{g},{b})")).collect();
    let scale = format!(
        "display:inline-block;width:14rem;max-width:50%;height:.8em;background:linear-gradient(to right,{});\
         border-radius:2px;print-color-adjust:exact",
        stops.join(",")
    );
    html! {
        @if end.is_empty() { h2 { "Where they differ from " (first.name) } }
        "\n"
        p.soft {
            "Each vertex by its distance to the same vertex of " (first.name) ", on one scale for all:"
        }
        "\n"
        p {
            span style=(scale) {}
            " 0 to " (round_percent(c.color_scale)) " of the diagonal, "
            (number(c.color_scale * c.model.diagonal)) " in the model's unit, and beyond"
        }
        "\n"
        div.grid { "\n" @for figure in figures { (figure) } }
        "\n"
    }
}

fn rest(c: &Comparison) -> Markup {
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
        let moved = |of: fn(&simod_measure::Difference) -> f64| {
            or_dash(f.displacement.as_ref().map(|d| 100.0 * of(d)))
        };
        let shape = f.on_samples.as_ref();
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
    section("Beside the model at rest", &table.finish())
}

fn energies(c: &Comparison) -> Markup {
    let titles = [
        ("method", ""),
        ("of", ""),
        ("ARAP", ""),
        ("symmetric Dirichlet", ""),
        ("its largest", ""),
        ("collapsed triangles", ""),
        ("volume", "%"),
        ("volume over the border", "%"),
        ("edges rms", "%"),
        ("areas rms", "%"),
        ("details rms", "°"),
        ("folded triangles", ""),
    ];
    let mut table =
        Table::new("Energies, of the samples' triangles and of the model's own where they are few.", &titles);
    for (method, f) in c.done() {
        for (of, shape) in [("samples", &f.on_samples), ("model", &f.on_model)] {
            let Some(shape) = shape else { continue };
            let e = &shape.energies;
            let open =
                shape.volume_over_border.map(|[rest, after]| after / rest - 1.0).filter(|x| x.is_finite());
            let percent = |x: Option<f64>| x.map_or(NONE.to_owned(), |x| format!("{:+.2}", 100.0 * x));
            let cells = [
                number(e.arap),
                number(e.symmetric_dirichlet),
                number(e.symmetric_dirichlet_max),
                e.collapsed.to_string(),
                percent(shape.volume_change),
                percent(open),
                number(100.0 * shape.edges.rms),
                number(100.0 * shape.areas.rms),
                number(shape.details.rms),
                shape.details.folded.to_string(),
            ];
            table.row(&[&method.name, of], cells);
        }
    }
    if table.is_empty() { Markup::default() } else { section("Energies", &table.finish()) }
}

fn pairs(c: &Comparison) -> Markup {
    if c.pairs.is_empty() {
        return Markup::default();
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
        let ways = |of: fn(&simod_measure::Distances) -> f64, i: usize| {
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
    section("Beside each other", &table.finish())
}

fn exact(c: &Comparison) -> Markup {
    let titles = [
        ("method", ""),
        ("vertices", ""),
        ("rms", "%"),
        ("99.9th", "%"),
        ("max", "%"),
        ("expected rms", "%"),
        ("99.9th", "%"),
        ("worst", "%"),
    ];
    let mut table = Table::new("Vertices beside their exact images, and what was expected of them.", &titles);
    let mut any = false;
    for (method, f) in c.done() {
        let of = |x: fn(&simod_core::reconstruction::transfer_error::TransferError) -> f64| {
            or_dash(f.transfer_error.as_ref().map(|e| 100.0 * x(e)))
        };
        let expected =
            |x: fn(&ExpectedError) -> f64| or_dash(f.expected_error.as_ref().map(|e| 100.0 * x(e)));
        any |= f.transfer_error.is_some() || f.expected_error.is_some();
        let vertices = f.transfer_error.map_or(NONE.to_owned(), |e| e.vertices.to_string());
        let exact = [of(|e| e.rms), of(|e| e.p999), of(|e| e.max)];
        let expected = [expected(|e| e.rms), expected(|e| e.p999), expected(|e| e.worst)];
        table.row(&[&method.name], [vertices].into_iter().chain(exact).chain(expected));
    }
    if any { section("Transfer from the samples to the model", &table.finish()) } else { Markup::default() }
}

fn costs(c: &Comparison) -> Markup {
    let titles = [
        ("method", ""),
        ("samples", ""),
        ("triangles", ""),
        ("sample", "s"),
        ("prepare, deform", "s"),
        ("of that prepare", "s"),
        ("motion", "s"),
        ("reconstruct", "s"),
        ("processor", "s"),
        ("peak memory", "MB"),
        ("result", "xxh3-128"),
    ];
    let runs = c.done().map(|(_, f)| f.seconds.runs.len()).max().unwrap_or(1);
    let caption = match runs {
        1 => "Of a single run each: repeat it (runs = 5, say) before you trust small differences. Up to four methods in a \
              row that have the same samples are transferred together: of these, what reconstruct says is an equal \
              part of what all took."
            .to_owned(),
        runs => {
            format!("Medians of {runs} runs each, ± half of how far the fastest and the slowest are apart.")
        }
    };
    let mut table = Table::new(&caption, &titles);
    for (method, f) in c.done() {
        table.row(&[&method.name], cost_cells(f));
    }
    section("Time and memory", &table.finish())
}

/// The cells of a method's row in the table of [`costs`].
fn cost_cells(f: &Figures) -> [String; 10] {
    let s = &f.seconds;
    let memory = f.peak_memory_bytes.map_or(NONE.to_owned(), |bytes| bytes.div_ceil(1 << 20).to_string());
    let time = |median: Option<f64>, of: TimeOf| match (median, s.spread(of)) {
        (None, _) => NONE.to_owned(),
        (Some(median), None) => format!("{median:.2}"),
        (Some(median), Some(spread)) => format!("{median:.2} ± {spread:.2}"),
    };
    let hash = f.result.hash.rsplit(':').next().unwrap_or_default().chars().take(12);
    let hash = hash.collect::<String>()
        + if f.result.repeats == Some(false) { ", others in other runs" } else { "" };
    [
        f.samples.to_string(),
        f.triangles.to_string(),
        time(s.sample, |_| None),
        time(s.deform, |r| r.deform),
        time(s.prepare, |r| r.prepare),
        time(s.motion, |r| r.motion),
        time(s.reconstruct, |r| r.reconstruct),
        time(s.processor, |r| r.processor),
        memory,
        hash,
    ]
}

/// Meanings of the columns, but for the details, whose text has a figure in it.
const TERMS: [(&str, &str); 15] = [
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
         where not. Of more than four million vertices a million are looked at, so that the largest is a lower bound.",
    ),
    (
        "expected",
        "how far vertices are probably off by the transfer, as the samples tell it themselves where no exact map is \
         known.",
    ),
    (
        "ARAP",
        "the energy of as-rigid-as-possible with spokes and rims, over the area: how far, squared, triangles' \
         gradients are from the rotations that fit best about their corners. 0 for rigid motions.",
    ),
    (
        "symmetric Dirichlet",
        "σ₁² + σ₂² + σ₁⁻² + σ₂⁻² of the triangles' stretches, in the mean over the area: 4 for rigid motions. \
         Triangles that have collapsed are counted apart.",
    ),
    (
        "volume over the border",
        "of open surfaces, the relative change of the volume between the surface and the plane of its border at rest.",
    ),
    ("result", "the first digits of the hash of the deformed model's file; compare.json has all of them."),
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

/// The meaning of the columns.
fn meaning() -> Markup {
    let details = format!(
        "how far what is smaller than {} of the diagonal turns against the smooth surface beneath (M. Botsch, O. Sorkine, \
         IEEE TVCG 2008, as a figure). 0 for rigid motions.",
        round_percent(DETAIL)
    );
    html! {
        h2 { "What the figures mean" }
        "\n"
        dl {
            "\n"
            @for (term, text) in TERMS { (entry(term, text)) }
            (entry("details", &details))
        }
        "\n"
    }
}

fn parameters(c: &Comparison) -> Markup {
    html! {
        h2 { "Methods" }
        "\n"
        @for method in &c.methods { (parameters_of(method)) }
    }
}

fn parameters_of(method: &MethodRecord) -> Markup {
    let given = words(&method.sampling);
    let sampling = if given.is_empty() { "as by default" } else { &given };
    html! {
        h3 { (method.name) }
        "\n"
        dl {
            "\n"
            @for step in &method.steps {
                (entry(&format!("{} {}", step.plugin, step.version), &words(&step.params)))
            }
            @if let Some((key, what)) = &method.from { (entry(key, what)) }
            (entry("sampling", sampling))
            (entry("reconstruction", &method.reconstruction))
            @for message in method.figures.iter().flat_map(|f| &f.messages) { (entry("said", message)) }
        }
        "\n"
        @if let Some(session) = &method.session { pre { (session) } "\n" }
    }
}

/// `key = value, key = value`.
fn words(values: &Map<String, Value>) -> String {
    values.iter().map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join(", ")
}
