//! The progress of jobs that take their time: stage, rate, and a button that stops the job.

use super::{card, clip, duration, lesson};
use crate::window::{Commands, Window};
use eframe::egui::{Align, Layout, ProgressBar, Rect, RichText, Spinner, Ui, UiBuilder, pos2};
use simod_model::size::human_size;
use simod_viewer::Command;
use simod_viewer::engine::{Activity, Job};

/// Seconds after which a job's progress is shown.
const PATIENCE: f64 = 0.4;
const SIZE: [f32; 2] = [420.0, 92.0];

/// Shows each job that is running and takes its time, one above the other at the lower edge.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    // The first job stands above what lies in the lower corners.
    let below = window.state().clipped().is_some() || window.state().pinned().is_some();
    let below =
        if below { clip::HEIGHT } else { 0.0 } + if window.lesson.is_some() { lesson::HEIGHT } else { 0.0 };
    let mut bottom = rect.bottom() - 12.0 - below;
    for (job, what) in [
        (Job::Open, "Opening"),
        (Job::Write, "Writing"),
        (Job::Evaluate, "Deforming"),
        (Job::Preview, "Full detail"),
        (Job::Compare, "Comparing"),
    ] {
        let Some(activity) = window.state().activity(job) else { continue };
        // A quick job may be over before anybody could read of it.
        let left = PATIENCE - activity.seconds;
        if left > 0.0 && matches!(job, Job::Evaluate | Job::Preview | Job::Compare) {
            ui.ctx().request_repaint_after(std::time::Duration::from_secs_f64(left));
            continue;
        }
        if shown(ui, rect, &mut bottom, what, &activity, None) {
            commands.apply(Command::Cancel { job });
        }
    }
    if let Some(turning) = &window.turning {
        let (done, frames) = turning.progress();
        let line = (frames > 1).then(|| format!("frame {} of {frames}", (done + 1).min(frames)));
        if shown(ui, rect, &mut bottom, turning.name(), &turning.activity(), line) {
            commands.then(Window::stop_turning);
        }
    }
    if window.state().is_busy() || window.turning.is_some() || window.stopping.is_some() {
        ui.ctx().request_repaint_after(std::time::Duration::from_millis(200));
    }
}

/// Time left of the stage, in words, if the stage goes on at the rate so far; nothing in the first second
/// and below 2 %, when the rate is not known yet.
fn left(activity: &Activity) -> Option<String> {
    let fraction = f64::from(activity.fraction.filter(|f| *f > 0.02)?);
    let seconds = activity.seconds * (1.0 - fraction) / fraction;
    (activity.seconds > 1.0).then(|| format!("about {} left", duration(seconds)))
}

/// Shows a running job above the others, with its figures. Returns whether the user stops it.
fn shown(
    ui: &mut Ui,
    rect: Rect,
    bottom: &mut f32,
    what: &str,
    activity: &Activity,
    more: Option<String>,
) -> bool {
    let [width, height] = SIZE;
    let area = Rect::from_min_size(pos2(rect.center().x - 0.5 * width, *bottom - height), SIZE.into());
    let builder = UiBuilder::new().max_rect(area).layout(Layout::top_down(Align::Min));
    let mut stop = false;
    ui.scope_builder(builder, |ui| {
        card(ui).show(ui, |ui| {
            ui.set_width(width - 20.0);
            ui.horizontal(|ui| {
                ui.add(Spinner::new().size(14.0));
                ui.label(RichText::new(what).strong());
                ui.label(RichText::new(activity.stage).weak());
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    stop = ui.button("Cancel").clicked();
                });
            });
            if let Some(fraction) = activity.fraction {
                ui.add(ProgressBar::new(fraction).desired_height(8.0));
            }
            let told = [
                more.clone(),
                Some(duration(activity.seconds)),
                more.and_then(|_| left(activity)),
                activity.rate.map(|rate| format!("{}/s", human_size(rate as u64))),
                activity.memory.map(|memory| format!("{} of memory", human_size(memory))),
            ];
            let line = told.into_iter().flatten().collect::<Vec<_>>().join("   \u{00b7}   ");
            ui.label(RichText::new(line).small().weak());
        });
    });
    *bottom -= height + 8.0;
    stop
}
