//! Messages that go away, with what to do.

use crate::window::Window;
use crate::wording::in_window;
use eframe::egui::{self, Align2, Area, Color32, Frame, Id, Margin, Order, RichText, Stroke, vec2};
use simod_model::Error;
use simod_viewer::engine::Job;
use std::time::{Duration, Instant};

/// How long a note stays, and an error.
const STAYS: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(20)];
const MOST: usize = 5;

struct Toast {
    text: String,
    hint: String,
    is_error: bool,
    /// Once it is mended, the message goes away.
    cause: Option<Cause>,
    since: Instant,
}

/// What an error came of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// A command that could not be done: the next one mends it.
    Command,
    /// A job that came to nothing, until it does not.
    Job(Job),
}

/// The messages, oldest first.
#[derive(Default)]
pub struct Toasts(Vec<Toast>);

impl Toasts {
    /// Good to know.
    pub fn note(&mut self, text: impl Into<String>) {
        self.push(text.into(), String::new(), false, None);
    }

    /// Something came to nothing.
    pub fn error(&mut self, error: &Error) {
        self.push(error.to_string(), error.hint().to_owned(), true, None);
    }

    /// Something came to nothing, which may be mended.
    pub fn error_of(&mut self, cause: Cause, error: &Error) {
        let [text, hint] = [&error.to_string(), error.hint()].map(|text| in_window(text, None));
        self.push(text, hint, true, Some(cause));
    }

    /// What some errors came of is mended.
    pub fn leave(&mut self, cause: Cause) {
        self.0.retain(|toast| toast.cause != Some(cause));
    }

    /// What is there to be read.
    pub fn texts(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|toast| toast.text.as_str())
    }

    fn push(&mut self, text: String, hint: String, is_error: bool, cause: Option<Cause>) {
        // The same again stays longer.
        self.0.retain(|toast| toast.text != text);
        self.0.push(Toast { text, hint, is_error, cause, since: Instant::now() });
        let surplus = self.0.len().saturating_sub(MOST);
        self.0.drain(..surplus);
    }
}

/// Shows them at the lower right of the picture.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let stays = |toast: &Toast| STAYS[usize::from(toast.is_error)];
    let toasts = &mut window.toasts.0;
    toasts.retain(|toast| toast.since.elapsed() < stays(toast));
    let Some(next) = toasts.iter().map(|t| stays(t).saturating_sub(t.since.elapsed())).min() else { return };
    ctx.request_repaint_after(next);
    let mut closed = None;
    let area = Area::new(Id::unique("toasts")).order(Order::Foreground);
    area.anchor(Align2::CENTER_BOTTOM, vec2(-80.0, -38.0)).show(ctx, |ui| {
        for (i, toast) in toasts.iter().enumerate() {
            let visuals = ui.visuals();
            let color = if toast.is_error { visuals.error_fg_color } else { visuals.selection.bg_fill };
            let frame = Frame::window(ui.style())
                .stroke(Stroke::new(1.0, color.gamma_multiply(0.7)))
                .inner_margin(Margin::symmetric(12, 8));
            frame.show(ui, |ui| {
                ui.set_max_width(460.0);
                ui.horizontal_top(|ui| {
                    let close = ui.add(egui::Button::new("\u{d7}").frame(false).fill(Color32::TRANSPARENT));
                    close.widget_info(|| {
                        egui::WidgetInfo::labeled(egui::Role::Button, true, "Close the message")
                    });
                    if close.clicked() {
                        closed = Some(i);
                    }
                    ui.vertical(|ui| {
                        let text = RichText::new(&toast.text);
                        ui.label(if toast.is_error { text.color(color) } else { text });
                        if !toast.hint.is_empty() {
                            ui.label(RichText::new(&toast.hint).weak());
                        }
                    });
                });
            });
        }
    });
    if let Some(i) = closed {
        toasts.remove(i);
    }
}
