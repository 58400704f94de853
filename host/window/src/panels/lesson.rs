//! The panel of the lesson that is being done, with its next exercise.

use super::card;
use super::clip;
use crate::lessons::{self, ALL};
use crate::theme;
use crate::window::{Commands, RunningLesson, Window};
use eframe::egui::{Align2, Area, Button, Color32, Id, Order, Rect, RichText, Sense, Ui, vec2};

const MARGIN: f32 = 12.0;
const WIDTH: f32 = 300.0;
/// Greatest height of the panel, in points.
pub const HEIGHT: f32 = 170.0;

enum LessonAnswer {
    DoIt,
    Begin(usize),
    End,
}

/// Shows the panel at the lower left, while a lesson is being done.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    let Some(running) = &window.lesson else { return };
    let below = if window.state().clipped().is_some() { clip::HEIGHT } else { 0.0 };
    let area = Area::new(Id::unique("lesson")).order(Order::Middle).movable(false);
    let area = area.pivot(Align2::LEFT_BOTTOM).fixed_pos(rect.left_bottom() + vec2(MARGIN, -MARGIN - below));
    let mut answer = None;
    area.show(ui.ctx(), |ui| {
        card(ui).show(ui, |ui| {
            ui.set_width(WIDTH.min(rect.width() - 60.0));
            answer = content(ui, window, running);
        });
    });
    match answer {
        Some(LessonAnswer::DoIt) => lessons::do_it(window, commands),
        Some(LessonAnswer::Begin(lesson)) => lessons::begin(commands, lesson),
        Some(LessonAnswer::End) => commands.then(|window| window.lesson = None),
        None => {}
    }
}

fn content(ui: &mut Ui, window: &Window, running: &RunningLesson) -> Option<LessonAnswer> {
    let lesson = lessons::lesson_of(running);
    ui.horizontal(|ui| {
        ui.label(RichText::new(lesson.title).strong());
        for i in 0..lesson.parts.len() {
            let (dot, _) = ui.allocate_exact_size(vec2(9.0, 9.0), Sense::hover());
            let color = match i {
                i if i < running.part => theme::ACCENT,
                i if i == running.part => ui.visuals().strong_text_color(),
                _ => ui.visuals().weak_text_color().gamma_multiply(0.5),
            };
            ui.painter().circle_filled(dot.center(), 3.5, color);
        }
    });
    ui.add_space(3.0);
    if !lessons::is_open(running, window) {
        ui.label(RichText::new("Its model is not open.").weak());
        return ui
            .horizontal(|ui| {
                let again = ui.button("Open It").clicked().then_some(LessonAnswer::Begin(running.lesson));
                again.or(ui.button("End Lesson").clicked().then_some(LessonAnswer::End))
            })
            .inner;
    }
    let Some(part) = lessons::part_of(running) else {
        ui.label(lesson.ends);
        ui.add_space(4.0);
        return ui
            .horizontal(|ui| {
                let next = running.lesson + 1;
                let text = RichText::new("Next Lesson").color(Color32::WHITE);
                let goes_on = next < ALL.len() && ui.add(Button::new(text).fill(theme::ACCENT)).clicked();
                goes_on
                    .then_some(LessonAnswer::Begin(next))
                    .or(ui.button("End Lesson").clicked().then_some(LessonAnswer::End))
            })
            .inner;
    };
    ui.label(part.text);
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        let does = ui.button("Do It for Me").on_hover_text("Does this part as you would").clicked();
        let end = ui.button("End Lesson").clicked();
        let count = format!("{} of {}", running.part + 1, lesson.parts.len());
        ui.label(RichText::new(count).weak().small());
        does.then_some(LessonAnswer::DoIt).or(end.then_some(LessonAnswer::End))
    })
    .inner
}

/// The lessons, each to be begun.
pub fn list(ui: &mut Ui, commands: &mut Commands) {
    for (i, lesson) in ALL.iter().enumerate() {
        ui.horizontal(|ui| {
            if ui.link(format!("{}. {}", i + 1, lesson.title)).on_hover_text(lesson.about).clicked() {
                lessons::begin(commands, i);
            }
        });
    }
}
