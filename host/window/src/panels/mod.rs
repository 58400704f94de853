//! What is around the picture, and over it.

mod detail;
mod keys;
mod legend;
pub mod menu;
pub mod over;
mod palette;
mod parameters;
mod pinned;
pub mod progress;
mod prompt;
mod questions;
mod regions;
mod report;
pub mod side;
pub mod status;
mod steps;
mod toasts;
pub mod tools;
mod turntable;
pub mod welcome;

use crate::window::Window;
use eframe::egui;
pub use palette::Palette;
pub use prompt::Prompt;
pub use report::Report;
pub use toasts::Toasts;
pub use turntable::Turntable;

/// Windows over all the rest.
pub fn floating(ctx: &egui::Context, window: &mut Window) {
    turntable::show(ctx, window);
    prompt::show(ctx, window);
    questions::show(ctx, window);
    palette::show(ctx, window);
    report::show(ctx, window);
    keys::show(ctx, window);
    toasts::show(ctx, window);
}

/// The frame of what has to be answered.
fn modal(ctx: &egui::Context) -> egui::Frame {
    egui::Frame::popup(&ctx.global_style()).inner_margin(egui::Margin::same(20)).corner_radius(8.0)
}

/// Bytes as people read them.
pub fn bytes(bytes: f64) -> String {
    const UNITS: [&str; 4] = ["kB", "MB", "GB", "TB"];
    let mut value = bytes / 1e3;
    let mut unit = 0;
    while value >= 1000.0 && unit + 1 < UNITS.len() {
        value /= 1e3;
        unit += 1;
    }
    if value < 10.0 { format!("{value:.1} {}", UNITS[unit]) } else { format!("{value:.0} {}", UNITS[unit]) }
}

/// A count with thin spaces between thousands.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{2009}');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_easily() {
        assert_eq!(count(1234567), "1\u{2009}234\u{2009}567");
        assert_eq!(count(12), "12");
        assert_eq!(bytes(1.5e6), "1.5 MB");
        assert_eq!(bytes(512e9), "512 GB");
        assert_eq!(bytes(0.0), "0.0 kB");
    }
}
