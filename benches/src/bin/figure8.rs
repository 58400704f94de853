//! The paper's Figure 8 (§7): memory over time while a model is sampled, for models of growing size and for
//! coarse grids of growing resolution, drawn as SVG.
//!
//! The real `simod` runs, and the system is asked for its anonymous memory every few milliseconds.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program whose result is the table that it prints"
)]

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use clap::Parser;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use simod_benches::process::{self, MemoryPoint, Result, exit};
use simod_benches::{head, row};
use simod_generate::{ModelOptions, write_file};
use simod_model::output;
use simod_model::progress::Silent;

/// Draw the memory that sampling takes over time, and print its peaks as a Markdown table
#[derive(Parser)]
#[command(max_term_width = 100)]
struct Arguments {
    /// Vertices of the generated models, in millions
    #[arg(long, value_delimiter = ',', default_value = "2,8,32", value_name = "M,...")]
    millions: Vec<f64>,
    /// Largest numbers of cells along an axis of the coarse grids that are compared
    #[arg(long, value_delimiter = ',', default_value = "16,32,64,128,256", value_name = "R,...")]
    grids: Vec<u32>,
    /// Vertices of the model on which grids are compared, in millions [default: the middle one of --millions]
    #[arg(long, value_name = "M")]
    grids_at: Option<f64>,
    /// Number of samples
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    samples: u64,
    /// Milliseconds between two looks at the memory
    #[arg(long, default_value_t = 2, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..))]
    interval: u64,
    /// Program to measure [default: the one beside this program]
    #[arg(long, value_name = "PATH")]
    simod: Option<PathBuf>,
    /// Folder for the pictures
    #[arg(long, value_name = "DIR", default_value = "docs")]
    output: PathBuf,
    /// Folder for temporary files, with room for the largest model
    #[arg(long, value_name = "DIR", default_value_os_t = std::env::temp_dir())]
    folder: PathBuf,
}

/// Most points of a curve in a picture: one for every other column of pixels.
const MOST_POINTS: usize = 360;

/// A run of `simod sample`.
struct Curve {
    name: String,
    memory: Vec<MemoryPoint>,
}

fn main() -> ExitCode {
    if !cfg!(target_os = "linux") {
        eprintln!("error: the memory of a process can be looked at on Linux only (/proc/PID/status)");
        return ExitCode::FAILURE;
    }
    exit(measure(&Arguments::parse()))
}

fn measure(arguments: &Arguments) -> Result<()> {
    let simod = process::simod(arguments.simod.as_deref())?;
    std::fs::create_dir_all(&arguments.output)?;
    let mut sizes = arguments.millions.clone();
    sizes.sort_by(f64::total_cmp);
    let grids_at = arguments.grids_at.unwrap_or(sizes[sizes.len() / 2]);
    if !sizes.contains(&grids_at) {
        sizes.push(grids_at);
    }

    println!("{}", head(&["vertices", "grid", "time, s", "peak, MB"]));
    let (mut by_size, mut by_grid) = (Vec::new(), Vec::new());
    for millions in sizes {
        // One model at a time: the folder is deleted with all that is in it.
        let folder = tempfile::tempdir_in(&arguments.folder)?;
        let model = folder.path().join("model.ply");
        let vertices = (millions * 1e6) as u64;
        let options = ModelOptions { vertices, colors: false, faces: false, ..ModelOptions::default() };
        write_file(&options, &model, &Silent)?;

        let sample = |grid: Option<u32>| -> Result<Vec<MemoryPoint>> {
            let mut command = Command::new(&simod);
            command.arg("sample").arg(&model).arg("-o").arg(folder.path().join("samples.simod"));
            command.arg("--samples").arg(arguments.samples.to_string());
            command.args(grid.iter().flat_map(|grid| ["--grid".to_owned(), grid.to_string()]));
            let ran = process::run(&mut command, Some(Duration::from_millis(arguments.interval)))?;
            let grid = grid.map_or("automatic".to_owned(), |grid| grid.to_string());
            let (seconds, megabytes) = (format!("{:.2}", ran.wall), format!("{:.1}", ran.peak() / 1e6));
            println!("{}", row([vertices.to_string(), grid, seconds, megabytes]));
            Ok(ran.memory)
        };
        if arguments.millions.contains(&millions) {
            by_size.push(Curve { name: format!("{millions} M vertices"), memory: sample(None)? });
        }
        if millions == grids_at {
            for grid in &arguments.grids {
                by_grid.push(Curve { name: format!("grid {grid}"), memory: sample(Some(*grid))? });
            }
        }
    }

    let title = format!("Memory while sampling to {} samples", arguments.samples);
    draw(&title, &by_size, &arguments.output.join("memory-over-time-sizes.svg"))?;
    let title = format!("Memory while sampling {grids_at} M vertices, by the coarse grid");
    draw(&title, &by_grid, &arguments.output.join("memory-over-time-grids.svg"))
}

/// Heights of letters, in pixels.
const TITLE: f64 = 19.0;
const AXIS: f64 = 15.0;
const LABEL: f64 = 14.0;

/// Colours that are told apart on white, by the colour-blind too (Okabe and Ito).
const COLORS: [RGBColor; 6] = [
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 0, 0),
];

/// Draws the curves, with their names beside them.
fn draw(title: &str, curves: &[Curve], path: &Path) -> Result<()> {
    let mut svg = String::new();
    {
        let whole = SVGBackend::with_string(&mut svg, (900, 460)).into_drawing_area();
        // A ground of its own: pages may be dark.
        whole.fill(&WHITE)?;
        let below = whole.titled(title, font(TITLE))?;
        let (plot, names) = below.split_horizontally(740);
        draw_curves(&plot, curves)?;
        draw_names(&names, curves)?;
        whole.present()?;
    }
    output::write_file(path, svg.as_bytes())?;
    Ok(())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw_curves(area: &Area<'_>, curves: &[Curve]) -> Result<()> {
    let points = || curves.iter().flat_map(|curve| &curve.memory);
    let most = |figure: fn(&MemoryPoint) -> f64| points().map(figure).fold(1e-3, f64::max);
    let (seconds, megabytes) = (1.03 * most(|m| m.seconds), 1.08 * most(|m| m.bytes / 1e6));
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(48)
        .y_label_area_size(68)
        .build_cartesian_2d(0.0..seconds, 0.0..megabytes)?;
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc("anonymous memory, MB")
        .x_labels(10)
        .y_labels(8)
        .x_label_formatter(&|x| label(*x, seconds))
        .y_label_formatter(&|y| label(*y, megabytes))
        .label_style(font(LABEL))
        .axis_desc_style(font(AXIS))
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .draw()?;
    for (i, curve) in curves.iter().enumerate() {
        let points = thin(&curve.memory, MOST_POINTS);
        let points = points.iter().map(|m| (m.seconds, m.bytes / 1e6));
        chart.draw_series(LineSeries::new(points, color(i).stroke_width(2)))?;
    }
    Ok(())
}

fn draw_names(area: &Area<'_>, curves: &[Curve]) -> Result<()> {
    let style = font(LABEL).into_text_style(area).pos(Pos::new(HPos::Left, VPos::Center));
    for (i, curve) in curves.iter().enumerate() {
        let y = 24 + 24 * i as i32;
        area.draw(&PathElement::new([(0, y), (26, y)], color(i).stroke_width(3)))?;
        area.draw(&Text::new(curve.name.clone(), (34, y), style.clone()))?;
    }
    Ok(())
}

/// A font of a height in pixels, of which the SVG backend would write 1/1.24.
fn font(height: f64) -> (&'static str, f64) {
    ("sans-serif", 1.24 * height)
}

/// The colour of a curve.
fn color(i: usize) -> RGBColor {
    COLORS[i % COLORS.len()]
}

/// A number at an axis, with as many digits as its neighbours need.
fn label(value: f64, largest: f64) -> String {
    let digits = (1.0 - largest.log10()).ceil().max(0.0) as usize;
    format!("{value:.digits$}")
}

/// A curve of at most `most` points (six or more) that keeps the ends and, of each stretch, the least and the
/// most.
fn thin(curve: &[MemoryPoint], most: usize) -> Vec<MemoryPoint> {
    if curve.len() <= most {
        return curve.to_vec();
    }
    let stretch = curve.len().div_ceil(most.saturating_sub(2).max(2) / 2);
    let extremes = curve.chunks(stretch).flat_map(|points| {
        let by = |a: &usize, b: &usize| points[*a].bytes.total_cmp(&points[*b].bytes);
        let (least, most) = ((0..points.len()).min_by(by), (0..points.len()).max_by(by));
        let (first, second) = (least.min(most), least.max(most));
        first.into_iter().chain(second.filter(|_| first != second)).map(|i| points[i])
    });
    let mut thinned: Vec<MemoryPoint> = curve.first().copied().into_iter().chain(extremes).collect();
    thinned.extend(curve.last());
    thinned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_curve_keeps_its_ends_and_its_peak() {
        let at = |i: usize| MemoryPoint {
            seconds: i as f64,
            bytes: if i == 7_777 { 9e6 } else { (i % 97) as f64 },
        };
        let curve: Vec<MemoryPoint> = (0..10_000).map(at).collect();
        let thinned = thin(&curve, 100);
        assert!(thinned.len() <= 100, "{}", thinned.len());
        assert_eq!((thinned[0], thinned[thinned.len() - 1]), (at(0), at(9_999)));
        assert!(thinned.contains(&at(7_777)));
        assert!(thinned.is_sorted_by(|a, b| a.seconds <= b.seconds));
        assert_eq!(thin(&curve[..50], 100), &curve[..50]);
    }

    #[test]
    fn a_picture_is_small_and_names_its_curves() {
        let at = |i: usize| MemoryPoint { seconds: i as f64 * 1e-3, bytes: 1e6 * (i % 50) as f64 };
        let memory: Vec<MemoryPoint> = (0..10_000).map(at).collect();
        let curve = |i: usize| Curve { name: format!("grid {i}"), memory: memory.clone() };
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("picture.svg");
        draw("Memory", &[curve(1), curve(2), curve(3), curve(4), curve(5)], &path).expect("a picture");
        let svg = std::fs::read_to_string(&path).expect("a picture");
        assert!(svg.len() < 40_000, "{} bytes", svg.len());
        for text in ["grid 5", "time, s", "anonymous memory, MB"] {
            assert!(svg.contains(text), "no {text:?}");
        }
    }

    #[test]
    fn labels_have_the_digits_that_they_need() {
        assert_eq!([label(0.5, 3.2), label(20.0, 64.0), label(0.05, 0.21)], ["0.5", "20", "0.05"]);
    }
}
