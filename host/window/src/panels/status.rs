//! The line at the bottom: the work that is going on, and the numbers of samples and vertices.

use super::{count, detail::drawing};
use crate::window::Window;
use eframe::egui::{Align, Frame, Layout, Margin, Panel, RichText, Spinner, Ui};
use simod_model::memory::MemoryWatch;
use simod_model::size::human_size;
use simod_viewer::engine::Job;
use std::sync::OnceLock;

/// Greatest memory of the program so far, where the system tells.
fn memory() -> Option<u64> {
    static WATCH: OnceLock<MemoryWatch> = OnceLock::new();
    WATCH.get_or_init(MemoryWatch::start).peak()
}

/// The line.
pub fn show(ui: &mut Ui, window: &Window) {
    let frame = Frame::side_top_panel(ui.style()).inner_margin(Margin::symmetric(10, 3));
    Panel::bottom("status").frame(frame).show(ui, |ui| {
        ui.horizontal(|ui| {
            going_on(ui, window);
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| figures(ui, window));
        });
    });
}

fn going_on(ui: &mut Ui, window: &Window) {
    let state = window.state();
    let text = |text: String| RichText::new(text).small();
    let jobs = [Job::Open, Job::Write, Job::Evaluate, Job::Preview, Job::Compare];
    let job = jobs.into_iter().find_map(|job| state.activity(job));
    match job {
        Some(activity) => {
            ui.add(Spinner::new().size(12.0));
            let mut line = activity.stage.to_owned();
            if let Some(fraction) = activity.fraction {
                line += &format!(" {:.0} %", 100.0 * fraction);
            }
            ui.label(text(line));
        }
        None if state.scene().is_some() => {
            ui.label(text(window.tools.tool.hint().to_owned()).weak());
        }
        None => {
            ui.label(text("Open a model, or drop one here.".to_owned()).weak());
        }
    }
}

fn figures(ui: &mut Ui, window: &Window) {
    let mut figures = Vec::new();
    if let Some(scene) = window.state().scene() {
        let selected = window.state().selection().count();
        if selected > 0 {
            figures.push(format!("{} selected", count(selected as u64)));
        }
        figures.push(format!("{} samples", count(scene.len() as u64)));
        figures.push(format!("of {} vertices", count(scene.sampled.source.vertices)));
        figures.extend(drawing(window.drawn));
        figures.push(format!("{:.0} ms a picture", 1e3 * window.frame_time.as_secs_f64()));
    }
    if let Some(memory) = memory() {
        figures.push(format!("peak memory {}", human_size(memory)));
    }
    let line = figures.join("   \u{00b7}   ");
    ui.label(RichText::new(line).small().weak());
}
