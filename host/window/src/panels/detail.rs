//! How much of the model is shown in full, and how up to date it is.

use super::count;
use super::over::card;
use crate::theme;
use crate::window::Window;
use eframe::egui::{Align, Layout, Rect, RichText, Sense, Ui, UiBuilder, pos2, vec2};
use simod_viewer::detail::Figures;
use simod_viewer::{Command, Previewed};

const MARGIN: f32 = 12.0;
const SIZE: [f32; 2] = [300.0, 78.0];
/// Height of the card of a pinned version, with a gap.
const RAISED: f32 = 46.0;

/// What there is, in words.
fn words(of: Previewed, Figures { vertices, stride, stale, .. }: Figures) -> String {
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

/// At the lower right.
pub fn show(ui: &mut Ui, rect: Rect, window: &mut Window) {
    let Some((of, figures)) = window.state().detail().map(|detail| (detail.of(), detail.figures())) else {
        return;
    };
    let line = if window.state().is_streaming() {
        let done = figures.vertices as f64 / figures.wanted.max(1) as f64;
        format!("{} vertices, {:.0} % of them here", count(figures.vertices), 100.0 * done.min(1.0))
    } else {
        words(of, figures)
    };
    // Above what there is of a pinned version.
    let raised = if window.state().pinned().is_some() { RAISED } else { 0.0 };
    let corner = rect.right_bottom() - vec2(MARGIN, MARGIN + raised);
    let area = Rect::from_min_max(pos2(corner.x - SIZE[0], corner.y - SIZE[1]), corner);
    let builder = UiBuilder::new().max_rect(area).layout(Layout::bottom_up(Align::Max));
    ui.scope_builder(builder, |ui| {
        card(ui).show(ui, |ui| {
            ui.with_layout(Layout::top_down(Align::Min), |ui| {
                ui.horizontal(|ui| {
                    ui.label(RichText::new("Full detail").strong());
                    if ui.button("Update").on_hover_text("Stream what is seen, or selected, now").clicked() {
                        window.apply(Command::Preview { what: of });
                    }
                    if ui.button("Off").on_hover_text("Samples everywhere").clicked() {
                        window.apply(Command::Preview { what: Previewed::Nothing });
                    }
                });
                ui.label(RichText::new(line).small());
                ui.horizontal(|ui| {
                    let (dot, _) = ui.allocate_exact_size(vec2(12.0, 14.0), Sense::hover());
                    ui.painter().circle_filled(dot.center(), 5.0, theme::color(theme::samples_clay()));
                    ui.label(RichText::new("samples, at less detail").small().weak());
                });
            });
        });
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_in_words() {
        let figures = Figures { vertices: 2140332, stride: 1, wanted: 2140332, stale: 0.0 };
        let told = |figures| words(Previewed::Seen, figures).replace('\u{2009}', " ");
        assert_eq!(told(figures), "2 140 332 vertices, all of what was seen");
        assert_eq!(told(Figures { stride: 7, ..figures }), "2 140 332 vertices, 1 of 7 of what was seen");
        assert_eq!(told(Figures { stale: 0.31, ..figures }), "2 140 332 vertices, 31 % out of date");
        assert_eq!(
            words(Previewed::Selection, Figures { vertices: 3, ..figures }),
            "3 vertices, all of the selection"
        );
    }
}
