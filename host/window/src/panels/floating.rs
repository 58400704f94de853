//! Windows over all the rest.

use super::{film, keys, palette, picture, prompt, questions, report, toasts, turntable};
use crate::window::{Asks, Window};
use eframe::egui;

/// Shows the panels that are open.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let panels = [turntable::show, picture::show, film::show];
    panels.into_iter().for_each(|show| window.draw(|window, asks| show(ctx, window, asks)));
    // It remembers what is in a folder.
    let mut prompt = window.prompt.take();
    let mut asks = Asks::default();
    prompt::show(ctx, &mut asks, &mut prompt);
    window.prompt = prompt;
    window.answer(asks);
    let panels = [questions::show, palette::show, report::show, keys::show, toasts::show];
    panels.into_iter().for_each(|show| window.draw(|window, asks| show(ctx, window, asks)));
}
