//! Windows over all the rest.

use super::{film, keys, palette, picture, prompt, questions, report, toasts, turntable};
use crate::window::Window;
use eframe::egui;

/// Those that are open.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    turntable::show(ctx, window);
    picture::show(ctx, window);
    film::show(ctx, window);
    prompt::show(ctx, window);
    questions::show(ctx, window);
    palette::show(ctx, window);
    report::show(ctx, window);
    keys::show(ctx, window);
    toasts::show(ctx, window);
}
