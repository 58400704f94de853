//! The line that says which share of the model is shown in full, and how up to date that share is.

use super::count;
use crate::theme;
use crate::window::{Commands, Window};
use eframe::egui::{RichText, Sense, Ui, vec2};
use simod_scene::SurfaceShare;
use simod_viewer::detail::DetailCounts;
use simod_viewer::{Command, Previewed};

/// Share of the vertices that is shown in full, and the part of it that is stale, in words.
fn words(of: Previewed, DetailCounts { vertices, stride, stale, .. }: DetailCounts) -> String {
    let of = if of == Previewed::Selection { "the selection" } else { "what was seen" };
    let share = match stride {
        1 => format!("all of {of}"),
        k => format!("1 of {k} of {of}"),
    };
    if stale > 0.0 {
        format!("{} vertices, {:.0} % out of date", count(vertices), (100.0 * stale).clamp(1.0, 100.0))
    } else {
        format!("{} vertices, {share}", count(vertices))
    }
}

/// Shows the line, from the right.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let Some((of, figures)) = window.state().detail().map(|detail| (detail.previewed(), detail.figures()))
    else {
        return;
    };
    let line = if window.state().is_streaming() {
        let done = figures.vertices as f64 / figures.wanted.max(1) as f64;
        format!("{} vertices, {:.0} % of them here", count(figures.vertices), 100.0 * done.min(1.0))
    } else {
        words(of, figures)
    };
    let line = match drawing(window.drawn) {
        Some(part) => format!("{line}, {part}"),
        None => line,
    };
    if ui.button("Off").on_hover_text("Shows samples everywhere").clicked() {
        commands.apply(Command::Preview { what: Previewed::Nothing });
    }
    if ui.button("Update").on_hover_text("Streams what is seen, or selected, now").clicked() {
        commands.apply(Command::Preview { what: of });
    }
    ui.label(RichText::new("samples, at less detail").small().weak());
    let (dot, _) = ui.allocate_exact_size(vec2(12.0, 14.0), Sense::hover());
    ui.painter().circle_filled(dot.center(), 5.0, theme::color(theme::samples_clay()));
    ui.add_space(8.0);
    ui.label(RichText::new(line).small());
    ui.label(RichText::new("Full detail").strong());
}

/// Percentage of the picture that is drawn, in words, where the picture is not complete.
pub fn drawing(SurfaceShare { drawn, of, complete }: SurfaceShare) -> Option<String> {
    let part = 100.0 * drawn as f64 / of.max(1) as f64;
    (!complete && drawn < of).then(|| format!("{:.0} % drawn", part.clamp(1.0, 99.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_in_words() {
        let figures = DetailCounts { vertices: 2140332, stride: 1, wanted: 2140332, stale: 0.0 };
        let told = |figures| words(Previewed::Seen, figures).replace('\u{2009}', " ");
        assert_eq!(told(figures), "2 140 332 vertices, all of what was seen");
        assert_eq!(
            told(DetailCounts { stride: 7, ..figures }),
            "2 140 332 vertices, 1 of 7 of what was seen"
        );
        assert_eq!(told(DetailCounts { stale: 0.31, ..figures }), "2 140 332 vertices, 31 % out of date");
        let part = SurfaceShare { drawn: 500, of: 2000, complete: false };
        assert_eq!(drawing(part).as_deref(), Some("25 % drawn"));
        assert_eq!(drawing(SurfaceShare { complete: true, drawn: 2000, ..part }), None);
        assert_eq!(
            words(Previewed::Selection, DetailCounts { vertices: 3, ..figures }),
            "3 vertices, all of the selection"
        );
    }
}
