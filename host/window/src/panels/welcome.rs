//! The page that is shown where nothing is open.

use super::{ago, lesson, progress};
use crate::dialogs::Purpose;
use crate::theme;
use crate::window::{Commands, Window};
use eframe::egui::{
    Align, Button, Color32, Frame, Id, Layout, Margin, Rect, RichText, Ui, UiBuilder, Vec2, vec2,
};
use simod_viewer::engine::Job;
use simod_viewer::state;

/// Number of recent files that are offered.
const RECENT: usize = 5;
const SIZE: Vec2 = vec2(440.0, 440.0);

/// Ways to begin.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    if window.state().activity(Job::Open).is_some() {
        progress::show(ui, Rect::from_center_size(rect.center(), vec2(400.0, 120.0)), window, commands);
        return;
    }
    // The panel's height is that of the last time.
    let known = ui.ctx().data(|data| data.get_temp::<f32>(Id::unique("welcome"))).unwrap_or(SIZE.y);
    let area = Rect::from_center_size(rect.center(), vec2(SIZE.x, known).min(rect.size()));
    let builder = UiBuilder::new().max_rect(area).layout(Layout::top_down(Align::Min));
    ui.scope_builder(builder, |ui| {
        let frame = Frame::window(ui.style()).inner_margin(Margin::same(28)).corner_radius(10.0);
        let shown = frame.show(ui, |ui| content(ui, window, commands)).response.rect.height();
        ui.ctx().data_mut(|data| data.insert_temp(Id::unique("welcome"), shown));
        if (shown - known).abs() > 1.0 {
            ui.ctx().request_repaint();
        }
    });
}

fn content(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    ui.set_width(SIZE.x - 56.0);
    ui.label(RichText::new("SIMOD").size(30.0).strong());
    ui.label(RichText::new("Freeform deformation of models of any size").weak());
    ui.add_space(16.0);
    let wide = |text: &str| Button::new(RichText::new(text).size(14.0)).min_size(vec2(180.0, 34.0));
    ui.horizontal(|ui| {
        let text = RichText::new("Open a Model\u{2026}").size(14.0).color(Color32::WHITE);
        let open = Button::new(text).min_size(vec2(180.0, 34.0)).fill(theme::ACCENT);
        if ui.add(open).clicked() {
            commands.then(|window| window.ask(Purpose::Open));
        }
        if ui.add(wide("Open the Example")).on_hover_text("An amphora of 400 000 vertices").clicked() {
            commands.then(Window::open_example);
        }
    });
    ui.add_space(4.0);
    ui.label(RichText::new("or drop a model, a session, or a folder of samples here").weak().small());
    ui.add_space(14.0);
    samples(ui, window, commands);
    ui.add_space(14.0);
    ui.label(RichText::new("Lessons").strong());
    ui.label(
        RichText::new("A few minutes each, done on a small model with what to do beside it").weak().small(),
    );
    lesson::list(ui, commands);
    recent(ui, window, commands);
}

fn samples(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    ui.horizontal(|ui| {
        ui.label("Samples of a model");
        for (samples, name) in
            [(50_000, "50 k"), (150_000, "150 k"), (500_000, "500 k"), (1_500_000, "1.5 M")]
        {
            let chosen = window.settings.samples == samples;
            if ui.add(Button::selectable(chosen, name)).clicked() {
                commands.then(move |window| {
                    window.settings.samples = samples;
                    window.keep_settings();
                });
            }
        }
    })
    .response
    .on_hover_text("Number of samples, approximately: more show finer detail, and take longer to deform");
}

fn recent(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let recent: Vec<_> = window.settings.recent.iter().filter(|p| p.exists()).take(RECENT).cloned().collect();
    if recent.is_empty() {
        return;
    }
    ui.add_space(14.0);
    ui.label(RichText::new("Recent").strong());
    for path in recent {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        ui.horizontal(|ui| {
            let folder = path.parent().map_or_else(String::new, |p| p.display().to_string());
            if ui.link(name).on_hover_text(path.display().to_string()).clicked() {
                let path = path.clone();
                commands.then(|window| window.ask_to_open(path));
            }
            ui.add(eframe::egui::Label::new(RichText::new(folder).weak().small()).truncate());
            if let Some(made) = state::kept_at(&path) {
                let text = RichText::new("recover").color(ui.visuals().warn_fg_color);
                let hint = format!("An edit of it was kept against a crash, {}", ago(made));
                if ui.link(text).on_hover_text(hint).clicked() {
                    let sampling = crate::settings::sampling(None);
                    commands.then(move |window| window.open_now(path, sampling, true));
                }
            }
        });
    }
}
