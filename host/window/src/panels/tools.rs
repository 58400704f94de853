//! The strip of tools at the left.

use crate::actions::{ALL, Menu};
use crate::tools::{Tool, is_of_use};
use crate::widgets::icons;
use crate::window::{Commands, Window};
use eframe::egui::{Color32, Frame, Margin, Panel, Role, Sense, Ui, WidgetInfo, vec2};

/// The tools in groups.
const GROUPS: [&[Tool]; 4] = [
    &[Tool::Orbit, Tool::Move, Tool::Rotate, Tool::Scale],
    &[Tool::Brush, Tool::Lasso, Tool::Box, Tool::Connected],
    &[Tool::Stroke, Tool::Joint],
    &[Tool::Measure],
];
const SIZE: f32 = 36.0;

/// The strip.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let frame = Frame::side_top_panel(ui.style()).inner_margin(Margin::same(6));
    Panel::left("tools").frame(frame).resizable(false).exact_size(SIZE + 12.0).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        for (i, group) in GROUPS.iter().enumerate() {
            if i > 0 {
                ui.add_space(3.0);
                ui.separator();
                ui.add_space(3.0);
            }
            for tool in *group {
                button(ui, window, commands, *tool);
            }
        }
    });
}

fn button(ui: &mut Ui, window: &Window, commands: &mut Commands, tool: Tool) {
    let enabled = is_of_use(tool, window);
    let chosen = window.tools.tool == tool;
    let sense = if enabled { Sense::click() } else { Sense::hover() };
    let (rect, response) = ui.allocate_exact_size(vec2(SIZE, SIZE), sense);
    response.widget_info(|| WidgetInfo::selected(Role::RadioButton, enabled, chosen, tool.name()));
    let visuals = ui.visuals();
    let fill = match (chosen, response.hovered() && enabled) {
        (true, _) => visuals.selection.bg_fill,
        (_, true) => visuals.widgets.hovered.weak_bg_fill,
        _ => Color32::TRANSPARENT,
    };
    let color = match (chosen, enabled) {
        (true, _) => Color32::WHITE,
        (_, true) => visuals.text_color(),
        _ => visuals.weak_text_color().gamma_multiply(0.45),
    };
    ui.painter().rect_filled(rect, 5.0, fill);
    icons::tool(ui.painter(), rect.shrink(9.0), tool, color);
    let action = ALL.iter().find(|a| a.menu == Menu::Tool && a.name == tool.name());
    let keys = action.map_or_else(String::new, |action| action.keys_text(ui.ctx()));
    let mut text = format!("{} ({keys})\n{}", tool.name(), tool.hint());
    if !enabled {
        text += "\nThe chosen step takes none.";
    }
    if response.on_hover_text(text).clicked() {
        commands.then(move |window| window.tools.take(tool));
    }
}
