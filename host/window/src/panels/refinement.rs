//! Controls for the fineness of the chosen refinement.

use super::{diagonal, number, parts};
use crate::window::{Commands, Window};
use eframe::egui::{Button, ComboBox, DragValue, Id, RichText, Ui};
use simod_core::refinement::Finer;
use simod_session::edit::Change;
use simod_session::step::{Action, Refine};

/// The ways to say how fine a refinement is, as the user reads them.
const FACTOR: &str = "Times as many samples";
const ERROR: &str = "Down to an error";
const SAMPLES: &str = "Number of samples more";
const NEEDED: &str = "Where the deformation needs it";

/// First values of a refinement whose fineness was given in another way before.
const FIRST_FACTOR: f64 = 4.0;
const FIRST_SAMPLES: u64 = 10_000;

fn name(finer: Finer) -> &'static str {
    match finer {
        Finer::Factor(_) => FACTOR,
        Finer::Error(_) => ERROR,
        Finer::Samples(_) => SAMPLES,
        Finer::Auto { .. } => NEEDED,
    }
}

/// The fineness of the chosen step, if that is a refinement.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let Some(at) = window.state().chosen() else { return };
    let Some(entry) = window.steps().get(at).cloned() else { return };
    let Action::Refine(refine) = &entry.step.action else { return };
    parts::part(ui);
    parts::heading(ui, "Refinement", |_| ());
    let finer = ui.horizontal(|ui| {
        let chosen = way(ui, refine);
        chosen.or_else(|| amount(ui, refine.finer))
    });
    if let Some(finer) = finer.inner {
        commands.change(at, Change::SetRefine(Refine { finer, ..refine.clone() }), false);
    }
    ui.label(RichText::new(explanation(refine.finer, diagonal(window))).weak().small());
}

/// Meaning of the fineness' number; of an error also its length in the model's unit.
fn explanation(finer: Finer, diagonal: Option<f64>) -> String {
    let in_unit = |error: f64| {
        diagonal.map_or(String::new(), |d| format!(" Here {} in the model's unit.", number(error * d)))
    };
    match finer {
        Finer::Factor(_) => "Each sample of the part becomes about this many.".to_owned(),
        Finer::Error(error) => {
            format!("A fraction of the diagonal of the model's box; less is finer.{}", in_unit(error))
        }
        Finer::Samples(_) => "New samples are put where the error is largest.".to_owned(),
        Finer::Auto { error, .. } => format!(
            "The error that may be left, as a fraction of the diagonal of the model's box.{}",
            in_unit(error)
        ),
    }
}

/// Choice of the way in which the fineness is given; another way comes with the number that it begins with.
fn way(ui: &mut Ui, refine: &Refine) -> Option<Finer> {
    let finer = refine.finer;
    let error = match finer {
        Finer::Error(error) | Finer::Auto { error, .. } if error > 0.0 => error,
        _ => Finer::ALLOWED,
    };
    let needed = Finer::Auto { error, samples: None };
    let ways = [Finer::Factor(FIRST_FACTOR), Finer::Error(error), Finer::Samples(FIRST_SAMPLES), needed];
    let mut chosen = None;
    let combo = ComboBox::from_id_salt("finer").width(190.0).selected_text(name(finer)).show_ui(ui, |ui| {
        for way in ways {
            // A refinement without shapes can only be placed by the deformation's need.
            let can = !refine.shapes.shapes.is_empty() || name(way) == NEEDED;
            let is_it = name(way) == name(finer);
            if ui.add_enabled(can, Button::selectable(is_it, name(way))).clicked() && !is_it {
                chosen = Some(way);
            }
        }
    });
    combo
        .response
        .ctx
        .accesskit_node_builder(combo.response.id, |node| node.set_label("Measure of the refinement"));
    chosen
}

/// Field of the fineness' number; returns another fineness if the user changes it.
fn amount(ui: &mut Ui, finer: Finer) -> Option<Finer> {
    let id = ui.scope_id().with("amount");
    match finer {
        Finer::Factor(factor) => {
            let (_, changed) = parts::held(ui, id, "Factor of the refinement", factor, |x| {
                kept(DragValue::new(x)).range(1.1..=1000.0).speed(0.05).max_decimals(2).suffix("\u{d7}")
            });
            changed.map(Finer::Factor)
        }
        Finer::Error(value) => error(ui, id, value).map(Finer::Error),
        Finer::Samples(samples) => {
            let (_, changed) = parts::held(ui, id, "Samples of the refinement", samples as f64, |x| {
                kept(DragValue::new(x)).range(1.0..=1e9).speed(100.0).max_decimals(0)
            });
            changed.map(|x| Finer::Samples(x.round().max(1.0) as u64))
        }
        Finer::Auto { error: value, samples } => {
            error(ui, id, value).map(|error| Finer::Auto { error, samples })
        }
    }
}

/// Keeps a value of the session that is outside of the control's range as it is.
fn kept(drag: DragValue<'_>) -> DragValue<'_> {
    drag.clamp_existing_to_range(false)
}

/// Field of an error, as a fraction of the diagonal; returns another one if the user changes it.
fn error(ui: &mut Ui, id: Id, value: f64) -> Option<f64> {
    let drag = parts::held(ui, id, "Error of the refinement", value, |x| {
        let drag = kept(DragValue::new(x)).range(1e-9..=1.0).speed(0.01 * value.max(1e-6));
        drag.custom_formatter(|x, _| format!("{x:.1e}")).custom_parser(|text| text.trim().parse().ok())
    });
    drag.1
}
