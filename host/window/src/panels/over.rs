//! Panels over the picture: options of the tool, what is being done, and the meaning of colours.

use super::{card, clip, lesson, pinned, progress};
use crate::tools::hand::Measuring;
use crate::tools::measure;
use crate::tools::{Tool, is_of_use};
use crate::window::{Commands, Window};
use eframe::egui::{Align, Button, DragValue, Layout, Rect, RichText, Slider, Ui, UiBuilder, pos2, vec2};
use simod_viewer::Command;
use simod_viewer::command::Area;
use simod_viewer::selection::Combine;

const MARGIN: f32 = 12.0;

/// Shows the panels over the picture.
pub fn show(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    if window.tools.has_options() {
        options(ui, rect, window, commands);
    }
    progress::show(ui, rect, window, commands);
    pinned::show(ui, rect, window, commands);
    clip::show(ui, rect, window, commands);
    lesson::show(ui, rect, window, commands);
}

fn options(ui: &mut Ui, rect: Rect, window: &Window, commands: &mut Commands) {
    let area = Rect::from_min_max(rect.min + vec2(MARGIN, MARGIN), pos2(rect.right() - 120.0, rect.bottom()));
    let builder = UiBuilder::new().max_rect(area).layout(Layout::left_to_right(Align::Min));
    ui.scope_builder(builder, |ui| {
        card(ui).show(ui, |ui| {
            // The options take several lines in a narrow picture.
            ui.horizontal_wrapped(|ui| match window.tools.tool {
                Tool::Stroke => stroke(ui, window, commands),
                Tool::Measure => measuring(ui, window, commands),
                Tool::Joint => chaining(ui, window, commands),
                tool if tool.is_gizmo() => moving(ui, window, commands),
                _ => selecting(ui, window, commands),
            });
        });
    });
}

/// Options of a move of handles that a plugin placed: the number of those in the hand, and the distance to
/// which others go along.
fn moving(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let Some((_, step, ..)) = window.chosen() else { return };
    let count = window.tools.handles(step).len();
    let text = if count == 1 { "1 handle".to_owned() } else { format!("{count} handles") };
    ui.label(text).on_hover_text("Shift and a click take one more; so does a box (B)");
    ui.separator();
    ui.spacing_mut().slider_width = 110.0;
    ui.label("Falloff");
    let mut reach = window.tools.reach;
    let slider = Slider::new(&mut reach, 0.0..=0.5).max_decimals(3);
    let response = ui.add(slider).on_hover_text(
        "Handles within this part of the model\u{2019}s diagonal go along, the less the farther they are; none at 0",
    );
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Falloff around handles"));
    if response.changed() {
        commands.then(move |window| window.tools.reach = reach);
    }
}

/// Options of the tool for joints: joints or pins, and the number of joints that a drag places.
fn chaining(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    if !is_of_use(Tool::Joint, window) {
        ui.label(RichText::new("The chosen step takes no joints.").weak());
        return;
    }
    for (pins, name, hint) in [
        (false, "Joints", "Clicks place joints, drags chains of them"),
        (true, "Pins", "Clicks place pins: what is around one stays, whatever the joints do"),
    ] {
        let button = Button::selectable(window.tools.places_pins == pins, name);
        let response = ui.add(button).on_hover_text(hint);
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(format!("Place {name}")));
        if response.clicked() {
            commands.then(move |window| window.tools.places_pins = pins);
        }
    }
    ui.separator();
    if window.tools.places_pins {
        ui.label(RichText::new("Click where the body shall stay.").weak());
        return;
    }
    ui.label("A drag places a chain of");
    let mut chain = window.tools.chain;
    let field = ui.add(DragValue::new(&mut chain).range(2..=64));
    field.ctx.accesskit_node_builder(field.id, |node| node.set_label("Joints of a chain"));
    if field.changed() {
        commands.then(move |window| window.tools.chain = chain);
    }
    ui.separator();
    let mut holds = window.tools.holds_body;
    let hold = ui.checkbox(&mut holds, "Hold the Body").on_hover_text(
        "As long as no bone is in its middle, pins there keep the body from turning with a limb",
    );
    if hold.changed() {
        commands.then(move |window| window.tools.holds_body = holds);
    }
}

/// Options of the tool that measures, and the result.
fn measuring(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    for (measuring, name, hint) in [
        (Measuring::Distance, "Distance", "Distance between two points; a third click begins anew"),
        (Measuring::Angle, "Angle", "Angle at the second of three points"),
        (Measuring::Path, "Path", "Length of the path along all points that are clicked"),
    ] {
        let button = Button::selectable(window.tools.measuring == measuring, name);
        let response = ui.add(button).on_hover_text(hint);
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(format!("Measure {name}")));
        if response.clicked() {
            commands.then(move |window| window.tools.measuring = measuring);
        }
    }
    ui.separator();
    match measure::summary(window) {
        Some(text) => ui.label(RichText::new(text).strong()),
        None => ui.label(RichText::new("Click points on the surface.").weak()),
    };
    if !window.state().measured().is_empty() {
        ui.separator();
        if ui.button("Remove Last").on_hover_text("Removes the last point (Backspace)").clicked() {
            measure::remove_last(window, commands);
        }
        if ui.button("Clear").on_hover_text("Removes all points (Escape)").clicked() {
            measure::clear(window, commands);
        }
    }
}

/// Choice between samples and handles for a box, where the step has handles.
fn what_is_boxed(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let has_handles = window.chosen().is_some_and(|(step, ..)| !window.state().handles(step).is_empty());
    if window.tools.tool != Tool::Box || !has_handles {
        commands.then(move |window| window.tools.boxes_handles &= has_handles);
        return;
    }
    for (handles, name, hint) in [
        (false, "Samples", "The box selects samples"),
        (true, "Handles", "The box takes handles of the step into the hand"),
    ] {
        let button = Button::selectable(window.tools.boxes_handles == handles, name);
        if ui.add(button).on_hover_text(hint).clicked() {
            commands.then(move |window| window.tools.boxes_handles = handles);
        }
    }
    ui.separator();
}

fn brush_size(ui: &mut Ui, mut radius: f32, commands: &mut Commands) {
    ui.spacing_mut().slider_width = 90.0;
    let slider = Slider::new(&mut radius, 4.0..=200.0).logarithmic(true).max_decimals(0);
    ui.label("Size");
    let response = ui.add(slider);
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Size of the brush"));
    if response.changed() {
        commands.then(move |window| window.tools.radius = radius);
    }
    ui.separator();
}

fn selecting(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    what_is_boxed(ui, window, commands);
    let tools = &window.tools;
    for (combine, name, hint) in [
        (Combine::Replace, "Replace", "Selects what is pointed at instead"),
        (Combine::Add, "Add", "Adds what is pointed at to the selection (Shift)"),
        (Combine::Subtract, "Subtract", "Takes what is pointed at out of the selection (Ctrl)"),
    ] {
        if ui.add(Button::selectable(tools.combine == combine, name)).on_hover_text(hint).clicked() {
            commands.then(move |window| window.tools.combine = combine);
        }
    }
    ui.separator();
    if tools.tool != Tool::Connected {
        for (visible, name, hint) in [
            (true, "Visible", "Only what is seen is selected"),
            (false, "Through", "Selects what lies behind, too"),
        ] {
            if ui.add(Button::selectable(tools.visible == visible, name)).on_hover_text(hint).clicked() {
                commands.then(move |window| window.tools.visible = visible);
            }
        }
        ui.separator();
    }
    if tools.tool == Tool::Brush {
        brush_size(ui, tools.radius, commands);
    }
    let some = !window.state().selection().is_empty();
    for (name, area, needs) in [
        ("All", Area::All, false),
        ("None", Area::None, true),
        ("Invert", Area::Inverse, false),
        ("Grow", Area::Grown, true),
        ("Shrink", Area::Shrunk, true),
    ] {
        if ui.add_enabled(some || !needs, Button::new(name)).clicked() {
            commands.apply(Command::Select {
                area,
                combine: Combine::Replace,
                visible: false,
                goes_on: false,
            });
        }
    }
}

fn stroke(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let Some(scale) = window.state().scene().map(|scene| scene.frame().scale) else { return };
    let takes = window.chosen().and_then(|(_, _, _, plugin)| plugin).is_some_and(|p| p.consumes().strokes);
    if !takes {
        ui.label(RichText::new("The chosen step takes no brush strokes.").weak());
        return;
    }
    let tools = &window.tools;
    ui.spacing_mut().slider_width = 110.0;
    let mut radius = tools.stroke_radius * scale;
    ui.label("Radius");
    let slider = Slider::new(&mut radius, 0.002 * scale..=0.5 * scale).logarithmic(true);
    let response = ui.add(slider).on_hover_text("Radius in the model's unit; [ and ] change it");
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Radius of the brush"));
    if response.changed() {
        commands.then(move |window| window.tools.stroke_radius = radius / scale);
    }
    ui.separator();
    ui.label("Strength");
    let mut strength = tools.strength;
    let response = ui.add(Slider::new(&mut strength, 0.0..=1.0)).on_hover_text("Ctrl does the opposite");
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Strength of the brush"));
    if response.changed() {
        commands.then(move |window| window.tools.strength = strength);
    }
}
