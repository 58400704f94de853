//! Windows over all the rest.

use super::{film, keys, palette, picture, prompt, questions, report, toasts, turntable};
use crate::window::Window;
use eframe::egui;

/// Shows the panels that are open.
pub fn show(ctx: &egui::Context, window: &mut Window) {
    let panels = [turntable::show, picture::show, film::show];
    panels.into_iter().for_each(|show| window.draw(|window, commands| show(ctx, window, commands)));
    // The prompt remembers the content of a folder.
    window.draw_with(|window| &mut window.prompt, |_, commands, prompt| prompt::show(ctx, commands, prompt));
    let panels = [questions::show, palette::show, report::show, keys::show, toasts::show];
    panels.into_iter().for_each(|show| window.draw(|window, commands| show(ctx, window, commands)));
}
