//! The camera, moved by pointer, wheel, trackpad and keys.

use super::ModelArea;
use crate::tools::Tool;
use crate::window::{Commands, Window};
use eframe::egui::{Event, Key, MouseWheelUnit, PointerButton};
use simod_viewer::Command;
use simod_viewer::command::CameraMove;
use simod_viewer::navigation::{Button, Drag, Modifiers};

/// Radians of a turn for each point of the screen by which the pointer moves.
const TURN: f64 = 0.0085;
/// Factor by which things get larger for a notch of the wheel.
const NOTCH: f64 = 1.18;
/// Radians of a turn by a key.
const KEY_TURN: f64 = std::f64::consts::PI / 12.0;

const BUTTONS: [(PointerButton, Button); 3] = [
    (PointerButton::Primary, Button::Left),
    (PointerButton::Middle, Button::Middle),
    (PointerButton::Secondary, Button::Right),
];

/// Moves the camera, with this tool in the hand.
pub fn update(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands, tool: Tool) {
    drag(canvas, window, commands, tool);
    if canvas.is_hovered() {
        wheel(canvas, commands);
        pinch(canvas, commands);
    }
    keys(canvas, commands);
}

fn drag(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands, tool: Tool) {
    let held = canvas.modifiers();
    let modifiers = Modifiers { shift: held.shift, control: held.command, alt: held.alt };
    let moves = |w: &Window, button| {
        let preset = w.settings.navigation().drag(button, modifiers);
        preset.or_else(|| free(tool, button, modifiers))
    };
    let Some((_, button)) = BUTTONS.into_iter().find(|(b, _)| canvas.response.dragged_by(*b)) else { return };
    let Some(drag) = moves(window, button) else { return };
    let by = canvas.response.drag_delta();
    if by == Default::default() {
        return;
    }
    let (x, y) = (f64::from(by.x), f64::from(by.y));
    let step = match drag {
        // The model follows the hand.
        Drag::Orbit => CameraMove::Orbit { yaw: -x * TURN, pitch: y * TURN },
        Drag::Pan => CameraMove::Pan { by: [canvas.pixels(by.x), canvas.pixels(by.y)] },
        Drag::Zoom => {
            let [width, height] = window.state().size();
            let factor = (0.01 * (x - y)).exp();
            CameraMove::Zoom { factor, at: [0.5 * width, 0.5 * height] }
        }
    };
    commands.apply(Command::Camera(step));
}

/// Drag of the camera by a button that the preset leaves to the tools, for those with one button or a pen.
fn free(tool: Tool, button: Button, modifiers: Modifiers) -> Option<Drag> {
    match (button, modifiers) {
        (Button::Left, Modifiers { alt: true, .. }) => Some(Drag::Orbit),
        (Button::Left, Modifiers { shift: true, .. }) if tool.grabs() => Some(Drag::Pan),
        (Button::Left, Modifiers { control: true, .. }) if tool.grabs() => Some(Drag::Zoom),
        (Button::Left, _) if tool.grabs() => Some(Drag::Orbit),
        (Button::Right, _) => Some(Drag::Pan),
        _ => None,
    }
}

fn wheel(canvas: &ModelArea<'_>, commands: &mut Commands) {
    let wheel = canvas.ctx().input(|i| {
        let of = |event: &Event| match event {
            Event::MouseWheel { unit, delta, modifiers, .. } => Some((*unit, *delta, *modifiers)),
            _ => None,
        };
        i.events.iter().filter_map(of).collect::<Vec<_>>()
    });
    let Some(at) = canvas.pointer() else { return };
    for (unit, delta, modifiers) in wheel {
        let (x, y) = (f64::from(delta.x), f64::from(delta.y));
        let step = match unit {
            // Two fingers on a trackpad.
            MouseWheelUnit::Point if modifiers.shift => {
                CameraMove::Pan { by: [canvas.pixels(delta.x), canvas.pixels(delta.y)] }
            }
            MouseWheelUnit::Point if !modifiers.command => {
                CameraMove::Orbit { yaw: -x * TURN, pitch: y * TURN }
            }
            MouseWheelUnit::Point => CameraMove::Zoom { factor: (0.01 * y).exp(), at: at.into() },
            // A page is a few notches; trackpads without points report parts of one.
            MouseWheelUnit::Line => {
                CameraMove::Zoom { factor: NOTCH.powf(y.clamp(-5.0, 5.0)), at: at.into() }
            }
            MouseWheelUnit::Page => CameraMove::Zoom { factor: NOTCH.powf(3.0 * y), at: at.into() },
        };
        commands.apply(Command::Camera(step));
    }
}

fn pinch(canvas: &ModelArea<'_>, commands: &mut Commands) {
    let factor = canvas.ctx().input(|i| {
        let zoom = |event: &Event| if let Event::Zoom(factor) = event { *factor } else { 1.0 };
        i.events.iter().map(zoom).product::<f32>()
    });
    if factor != 1.0
        && factor > 0.0
        && let Some(at) = canvas.pointer()
    {
        commands.apply(Command::Camera(CameraMove::Zoom { factor: f64::from(factor), at: at.into() }));
    }
}

fn keys(canvas: &ModelArea<'_>, commands: &mut Commands) {
    let ctx = canvas.ctx();
    if ctx.memory(|memory| memory.focused().is_some()) {
        return;
    }
    let pressed = |key| ctx.input(|i| i.modifiers.is_none() && i.key_pressed(key));
    for (key, yaw, pitch) in [
        (Key::ArrowLeft, -KEY_TURN, 0.0),
        (Key::ArrowRight, KEY_TURN, 0.0),
        (Key::ArrowUp, 0.0, KEY_TURN),
        (Key::ArrowDown, 0.0, -KEY_TURN),
    ] {
        if pressed(key) {
            commands.apply(Command::Camera(CameraMove::Orbit { yaw, pitch }));
        }
    }
}
