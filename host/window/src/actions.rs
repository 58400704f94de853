//! All that has a name: one table for the menus, the keys, and the palette.

use crate::dialogs::Purpose;
use crate::settings::{Lighting, Theme};
use crate::tools::{Tool, is_of_use};
use crate::window::{CommandPalette, Window};
use crate::{axis, regions, steps, theme};
use eframe::egui::text_selection::LabelSelectionState;
use eframe::egui::{self, Event, Key, Modifiers};
use simod_scene::SurfaceMode;
use simod_session::step::Role;
use simod_viewer::camera::{Projection, Standard, Up};
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::{Command, Overlay, Previewed};

/// Where an action is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Menu {
    File,
    Edit,
    Select,
    View,
    /// Within that of the view.
    Light,
    Compare,
    Overlay,
    Tool,
    Help,
}

/// Something that the user can do by name.
pub struct NamedAction {
    /// What the user reads.
    pub name: &'static str,
    /// Where it is found.
    pub menu: Menu,
    /// Keys that do it; the first ones are shown.
    pub keys: &'static [(Modifiers, Key)],
    /// Whether it can be done now.
    pub can: fn(&Window) -> bool,
    /// Whether it is on, for what can be on.
    pub is_on: Option<fn(&Window) -> bool>,
    /// Does it.
    pub run: fn(&mut Window),
    /// Whether a line is drawn before it in its menu.
    pub begins: bool,
}

const CTRL: Modifiers = Modifiers::COMMAND;
const SHIFT: Modifiers = Modifiers::SHIFT;
const ALT: Modifiers = Modifiers::ALT;
const NONE: Modifiers = Modifiers::NONE;
const CTRL_SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);

fn always(_: &Window) -> bool {
    true
}

fn is_open(w: &Window) -> bool {
    w.state().scene().is_some()
}

fn is_pinned(w: &Window) -> bool {
    w.state().pinned().is_some()
}

fn is_selected(w: &Window) -> bool {
    !w.state().selection().is_empty()
}

const fn action(
    menu: Menu,
    name: &'static str,
    keys: &'static [(Modifiers, Key)],
    can: fn(&Window) -> bool,
    run: fn(&mut Window),
) -> NamedAction {
    NamedAction { name, menu, keys, can, is_on: None, run, begins: false }
}

impl NamedAction {
    const fn on(self, is_on: fn(&Window) -> bool) -> Self {
        Self { is_on: Some(is_on), ..self }
    }

    const fn begins(self) -> Self {
        Self { begins: true, ..self }
    }

    /// Its first keys, as the user reads them; empty where there are none.
    pub fn keys_text(&self, ctx: &egui::Context) -> String {
        self.keys.first().map_or_else(String::new, |keys| text(ctx, keys))
    }

    /// All its keys, as the user reads them.
    pub fn all_keys_text(&self, ctx: &egui::Context) -> String {
        self.keys.iter().map(|keys| text(ctx, keys)).collect::<Vec<_>>().join(", ")
    }
}

fn text(ctx: &egui::Context, (modifiers, key): &(Modifiers, Key)) -> String {
    ctx.format_shortcut(&egui::KeyboardShortcut::new(*modifiers, *key))
}

fn select(w: &mut Window, area: Area) {
    w.apply(Command::Select { area, combine: Default::default(), visible: false, goes_on: false });
}

fn look(w: &mut Window, from: Standard) {
    w.apply(Command::Camera(CameraMove::Look(from)));
}

fn show(w: &mut Window, overlay: Overlay) {
    let overlay = if w.state().overlay() == overlay { Overlay::None } else { overlay };
    w.apply(Command::Show(overlay));
}

fn set_theme(w: &mut Window, theme: Theme) {
    w.settings.theme = theme;
    theme::apply(w.ctx(), theme);
    w.keep_settings();
}

fn light(w: &mut Window, light: Lighting) {
    w.settings.light = light;
    w.keep_settings();
}

fn has_colors(w: &Window) -> bool {
    w.state().scene().is_some_and(|scene| !scene.sampled.colors.is_empty())
}

fn has_triangles(w: &Window) -> bool {
    w.state().scene().is_some_and(|scene| !scene.sampled.triangles.is_empty())
}

fn has_step(w: &Window) -> bool {
    w.state().chosen().is_some()
}

/// Does something with the chosen step.
fn of_step(w: &mut Window, run: fn(&mut Window, usize)) {
    if let Some(at) = w.state().chosen() {
        run(w, at);
    }
}

fn is_deformation(w: &Window) -> bool {
    w.chosen().is_some()
}

/// All of them, in the order of their menus.
pub const ALL: &[NamedAction] = &[
    action(Menu::File, "Open\u{2026}", &[(CTRL, Key::O)], always, |w| w.ask(Purpose::Open)),
    action(Menu::File, "Open Sampled Folder\u{2026}", &[], always, |w| w.ask(Purpose::OpenFolder)),
    action(Menu::File, "Open the Example", &[], always, Window::open_example),
    action(Menu::File, "Save Session", &[(CTRL, Key::S)], is_open, |w| {
        w.save();
    })
    .begins(),
    action(Menu::File, "Save Session As\u{2026}", &[(CTRL_SHIFT, Key::S)], is_open, |w| w.ask(Purpose::Save)),
    action(Menu::File, "Write Deformed Model\u{2026}", &[(CTRL, Key::E)], is_open, |w| w.ask(Purpose::Write))
        .begins(),
    action(Menu::File, "Save Picture\u{2026}", &[(NONE, Key::F12)], crate::rendering::can_begin, |w| {
        crate::rendering::ask_for_picture(w);
    })
    .begins(),
    action(Menu::File, "Render Turntable\u{2026}", &[], crate::rendering::can_begin, crate::rendering::ask),
    action(Menu::File, "Quit", &[(CTRL, Key::Q)], always, |w| {
        w.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
    })
    .begins(),
    action(
        Menu::Edit,
        "Undo",
        &[(CTRL, Key::Z)],
        |w| w.state().can_undo().is_some(),
        |w| {
            w.apply(Command::Undo);
        },
    ),
    action(
        Menu::Edit,
        "Redo",
        &[(CTRL_SHIFT, Key::Z), (CTRL, Key::Y)],
        |w| w.state().can_redo().is_some(),
        |w| {
            w.apply(Command::Redo);
        },
    ),
    action(
        Menu::Edit,
        "Reset This Motion",
        &[(ALT, Key::G)],
        |w| w.tools.target.is_some(),
        |w| {
            crate::tools::gizmo::reset(w);
        },
    )
    .begins(),
    action(Menu::Edit, "Search Commands\u{2026}", &[(CTRL, Key::P), (CTRL, Key::K)], always, |w| {
        w.palette = Some(CommandPalette::default());
    })
    .begins(),
    action(Menu::Select, "Select All", &[(CTRL, Key::A), (NONE, Key::A)], is_open, |w| select(w, Area::All)),
    action(Menu::Select, "Select None", &[(ALT, Key::A), (CTRL_SHIFT, Key::A)], is_open, |w| {
        select(w, Area::None);
    }),
    action(Menu::Select, "Invert Selection", &[(CTRL, Key::I)], is_open, |w| select(w, Area::Inverse)),
    action(Menu::Select, "Grow Selection", &[(NONE, Key::Plus), (NONE, Key::Equals)], is_selected, |w| {
        select(w, Area::Grown);
    })
    .begins(),
    action(Menu::Select, "Shrink Selection", &[(NONE, Key::Minus)], is_selected, |w| select(w, Area::Shrunk)),
    action(
        Menu::Select,
        "Fixed Region from Selection",
        &[(SHIFT, Key::F)],
        |w| regions::can_make(w, Role::Fixed),
        |w| regions::make(w, Role::Fixed),
    )
    .begins(),
    action(
        Menu::Select,
        "Handle Region from Selection",
        &[(SHIFT, Key::H)],
        |w| regions::can_make(w, Role::Handle),
        |w| regions::make(w, Role::Handle),
    ),
    action(
        Menu::Select,
        "Mask from Selection",
        &[(SHIFT, Key::M)],
        |w| regions::can_make(w, Role::Mask),
        |w| regions::make(w, Role::Mask),
    ),
    action(Menu::Select, "Refine Selection", &[(SHIFT, Key::R)], is_selected, regions::refine).begins(),
    action(Menu::View, "Frame All", &[(NONE, Key::Home), (SHIFT, Key::C)], is_open, |w| {
        axis::frame_all(w);
    }),
    action(Menu::View, "Frame Selection", &[(NONE, Key::F), (NONE, Key::Period)], is_selected, |w| {
        w.apply(Command::Camera(CameraMove::FrameSelection));
    }),
    action(Menu::View, "Front", &[(NONE, Key::Num1)], always, |w| look(w, Standard::Front)).begins(),
    action(Menu::View, "Back", &[(CTRL, Key::Num1)], always, |w| look(w, Standard::Back)),
    action(Menu::View, "Right", &[(NONE, Key::Num3)], always, |w| look(w, Standard::Right)),
    action(Menu::View, "Left", &[(CTRL, Key::Num3)], always, |w| look(w, Standard::Left)),
    action(Menu::View, "Top", &[(NONE, Key::Num7)], always, |w| look(w, Standard::Top)),
    action(Menu::View, "Bottom", &[(CTRL, Key::Num7)], always, |w| look(w, Standard::Bottom)),
    action(Menu::View, "Isometric", &[(NONE, Key::Num9)], always, |w| look(w, Standard::Isometric)),
    action(Menu::View, "Orthographic", &[(NONE, Key::Num5)], always, |w| {
        let other = match w.state().camera().projection {
            Projection::Perspective => Projection::Orthographic,
            Projection::Orthographic => Projection::Perspective,
        };
        w.apply(Command::Camera(CameraMove::Project(other)));
    })
    .on(|w| w.state().camera().projection == Projection::Orthographic)
    .begins(),
    action(Menu::View, "Z Is Up", &[], always, |w| {
        let up = if w.state().camera().up == Up::Z { Up::Y } else { Up::Z };
        w.apply(Command::Camera(CameraMove::Up(up)));
    })
    .on(|w| w.state().camera().up == Up::Z),
    action(Menu::View, "Triangles", &[(NONE, Key::T)], has_triangles, |w| {
        w.looks.triangles = Some(w.mode() != SurfaceMode::Triangles);
    })
    .on(|w| w.mode() == SurfaceMode::Triangles)
    .begins(),
    action(Menu::View, "Ghost of the Rest Shape", &[(SHIFT, Key::G)], is_open, |w| w.looks.ghost ^= true)
        .on(|w| w.looks.ghost),
    action(Menu::View, "Samples over Full Detail", &[], is_open, |w| w.looks.samples ^= true)
        .on(|w| w.looks.samples),
    action(Menu::View, "The Model's Own Colours", &[], has_colors, |w| {
        let own = !w.state().has_own_colors();
        w.apply(Command::ShowOwnColors(own));
    })
    .on(|w| w.state().has_own_colors()),
    action(Menu::View, "Region Colours", &[], is_open, |w| w.looks.regions ^= true).on(|w| w.looks.regions),
    action(Menu::View, "Handles", &[], is_open, |w| w.looks.handles ^= true).on(|w| w.looks.handles),
    action(Menu::View, "Darker Crevices", &[], always, |w| {
        w.settings.occlusion ^= true;
        w.keep_settings();
    })
    .on(|w| w.settings.occlusion),
    action(Menu::View, "Cut Open", &[(ALT, Key::B)], is_open, crate::clip::switch)
        .on(|w| w.state().clipped().is_some()),
    action(Menu::Light, "Lit by Lamps", &[], always, |w| light(w, Lighting::Lamps))
        .on(|w| w.settings.light == Lighting::Lamps),
    action(Menu::Light, "Lit from the Camera", &[], always, |w| light(w, Lighting::Camera))
        .on(|w| w.settings.light == Lighting::Camera),
    action(Menu::Light, "Ceramic", &[], always, |w| light(w, Lighting::Ceramic))
        .on(|w| w.settings.light == Lighting::Ceramic)
        .begins(),
    action(Menu::Light, "Polished Metal", &[], always, |w| light(w, Lighting::Metal))
        .on(|w| w.settings.light == Lighting::Metal),
    action(Menu::Light, "Warm Wax", &[], always, |w| light(w, Lighting::Wax))
        .on(|w| w.settings.light == Lighting::Wax),
    action(Menu::Light, "Mirrored Stripes", &[], always, |w| light(w, Lighting::Stripes))
        .on(|w| w.settings.light == Lighting::Stripes),
    action(Menu::View, "Full Detail of What Is Seen", &[(NONE, Key::I)], is_open, |w| {
        w.apply(Command::Preview { what: Previewed::Seen });
    })
    .on(|w| w.state().detail().is_some_and(|detail| detail.previewed() == Previewed::Seen))
    .begins(),
    action(Menu::View, "Full Detail of the Selection", &[(SHIFT, Key::I)], is_selected, |w| {
        w.apply(Command::Preview { what: Previewed::Selection });
    })
    .on(|w| w.state().detail().is_some_and(|detail| detail.previewed() == Previewed::Selection)),
    action(
        Menu::View,
        "Samples Only",
        &[(ALT, Key::I)],
        |w| w.state().detail().is_some(),
        |w| {
            w.apply(Command::Preview { what: Previewed::Nothing });
        },
    ),
    action(Menu::View, "Dark Theme", &[], always, |w| set_theme(w, Theme::Dark))
        .on(|w| w.settings.theme == Theme::Dark)
        .begins(),
    action(Menu::View, "Light Theme", &[], always, |w| set_theme(w, Theme::Light))
        .on(|w| w.settings.theme == Theme::Light),
    action(Menu::Compare, "Pin This Version", &[(NONE, Key::P)], is_open, |w| {
        w.apply(Command::Pin);
    }),
    action(Menu::Compare, "Pin a Session\u{2026}", &[], is_open, |w| w.ask(Purpose::Pin)),
    action(Menu::Compare, "Unpin", &[(SHIFT, Key::P)], is_pinned, |w| {
        w.apply(Command::Unpin);
    }),
    action(Menu::Compare, "Side by Side", &[(NONE, Key::V)], is_pinned, |w| w.looks.side_by_side ^= true)
        .on(|w| w.looks.side_by_side)
        .begins(),
    action(Menu::Compare, "Pinned Version in Place", &[(SHIFT, Key::V)], is_pinned, |w| {
        w.looks.pinned_in_place ^= true;
    })
    .on(|w| w.looks.pinned_in_place),
    action(Menu::Compare, "Go On with the Pinned Version", &[(SHIFT, Key::X)], is_pinned, |w| {
        if w.apply(Command::SwapPinned) {
            w.tools.target = None;
            w.looks.pinned_in_place = false;
        }
    })
    .begins(),
    action(Menu::Overlay, "Surface Only", &[], is_open, |w| {
        w.apply(Command::Show(Overlay::None));
    })
    .on(|w| w.state().overlay() == Overlay::None),
    action(Menu::Overlay, "Displacement", &[], is_open, |w| show(w, Overlay::Displacement))
        .on(|w| w.state().overlay() == Overlay::Displacement),
    action(Menu::Overlay, "Stretch", &[], is_open, |w| show(w, Overlay::Stretch))
        .on(|w| w.state().overlay() == Overlay::Stretch),
    action(Menu::Overlay, "Sample Distance", &[], is_open, |w| show(w, Overlay::Density))
        .on(|w| w.state().overlay() == Overlay::Density),
    action(Menu::Overlay, "Expected Transfer Error", &[], is_open, |w| show(w, Overlay::TransferError))
        .on(|w| w.state().overlay() == Overlay::TransferError),
    action(Menu::Overlay, "Difference from the Pinned Version", &[], is_pinned, |w| {
        show(w, Overlay::Difference);
    })
    .on(|w| w.state().overlay() == Overlay::Difference),
    tool(Tool::Orbit, &[(NONE, Key::Q)], |w| pick(w, Tool::Orbit), |w| w.tools.tool == Tool::Orbit),
    tool(Tool::Move, &[(NONE, Key::G)], |w| begin(w, Tool::Move), |w| w.tools.tool == Tool::Move),
    tool(Tool::Rotate, &[(NONE, Key::R)], |w| begin(w, Tool::Rotate), |w| w.tools.tool == Tool::Rotate),
    tool(Tool::Scale, &[(NONE, Key::S)], |w| begin(w, Tool::Scale), |w| w.tools.tool == Tool::Scale),
    tool(Tool::Brush, &[(NONE, Key::C)], |w| pick(w, Tool::Brush), |w| w.tools.tool == Tool::Brush),
    tool(Tool::Lasso, &[(NONE, Key::L)], |w| pick(w, Tool::Lasso), |w| w.tools.tool == Tool::Lasso),
    tool(Tool::Box, &[(NONE, Key::B)], |w| pick(w, Tool::Box), |w| w.tools.tool == Tool::Box),
    tool(
        Tool::Connected,
        &[(NONE, Key::K)],
        |w| pick(w, Tool::Connected),
        |w| w.tools.tool == Tool::Connected,
    ),
    tool(Tool::Stroke, &[(NONE, Key::D)], |w| pick(w, Tool::Stroke), |w| w.tools.tool == Tool::Stroke),
    tool(Tool::Measure, &[(NONE, Key::M)], |w| pick(w, Tool::Measure), |w| w.tools.tool == Tool::Measure),
    tool(Tool::Joint, &[(NONE, Key::J)], |w| pick(w, Tool::Joint), |w| w.tools.tool == Tool::Joint),
    action(Menu::Edit, "Rename the Step", &[(NONE, Key::F2)], has_step, |w| of_step(w, steps::rename))
        .begins(),
    action(Menu::Edit, "Duplicate the Step", &[(CTRL, Key::D)], has_step, |w| of_step(w, steps::duplicate)),
    action(Menu::Edit, "Copy the Step", &[(CTRL, Key::C)], has_step, |w| of_step(w, steps::copy)),
    action(Menu::Edit, "Paste Steps", &[(CTRL, Key::V)], is_open, |w| {
        w.ctx().send_viewport_cmd(egui::ViewportCommand::RequestPaste);
    }),
    action(Menu::Edit, "Group with the Step Above", &[(CTRL, Key::G)], has_step, |w| {
        of_step(w, steps::group)
    }),
    action(Menu::Edit, "Only This Step", &[(SHIFT, Key::S)], is_deformation, |w| of_step(w, steps::solo))
        .on(|w| w.state().chosen().is_some_and(|at| steps::is_alone(w, at))),
    action(Menu::Edit, "More of the Step", &[(SHIFT, Key::ArrowUp)], is_deformation, |w| {
        steps::change_amount(w, 0.1);
    }),
    action(Menu::Edit, "Less of the Step", &[(SHIFT, Key::ArrowDown)], is_deformation, |w| {
        steps::change_amount(w, -0.1);
    }),
    action(Menu::Edit, "Remove the Chosen Step", &[], has_step, |w| {
        if let Some(at) = w.state().chosen() {
            w.apply(Command::Edit(simod_session::edit::EditCommand::Remove { at }));
        }
    })
    .begins(),
    action(Menu::Help, "Look for Plugins Again", &[], always, Window::look_for_plugins),
    action(Menu::Help, "Keys and Mouse", &[(NONE, Key::F1)], always, |w| w.shows_keys = true),
];

const fn tool(
    tool: Tool,
    keys: &'static [(Modifiers, Key)],
    run: fn(&mut Window),
    is_on: fn(&Window) -> bool,
) -> NamedAction {
    let can: fn(&Window) -> bool = match tool {
        Tool::Stroke => |w| is_of_use(Tool::Stroke, w),
        Tool::Joint => |w| is_of_use(Tool::Joint, w),
        _ => is_open,
    };
    action(Menu::Tool, tool.name(), keys, can, run).on(is_on)
}

/// Takes a tool that moves what is in the hand; in navigation like Blender's, it begins at once.
fn begin(w: &mut Window, tool: Tool) {
    pick(w, tool);
    let at_once = w.settings.navigation().name.starts_with("Blender");
    w.tools.begins = Some(tool).filter(|_| at_once && w.tools.target.is_some());
}

fn pick(w: &mut Window, tool: Tool) {
    w.tools.take(tool);
}

/// Does what the keys say that were just pressed.
pub fn keys(window: &mut Window) {
    let ctx = window.ctx().clone();
    if ctx.egui_wants_keyboard_input() || window.is_asking() || window.tools.transforming.is_some() {
        return;
    }
    clipboard(window);
    for action in ALL {
        if action.keys.iter().any(|keys| take_key(&ctx, keys)) && (action.can)(window) {
            (action.run)(window);
            if window.is_asking() {
                return;
            }
        }
    }
}

/// Copies and pastes where the system says so: it keeps the keys for it to itself.
fn clipboard(window: &mut Window) {
    let ctx = window.ctx().clone();
    // What is selected of a label is what is meant first.
    let selects_text = ctx.plugin::<LabelSelectionState>().lock().has_selection();
    let is_of_it = |event: &Event| match event {
        Event::Copy => !selects_text,
        event => matches!(event, Event::Paste(_)),
    };
    let events: Vec<Event> = ctx.input_mut(|i| i.events.extract_if(.., |event| is_of_it(event)).collect());
    for event in events {
        match event {
            Event::Copy => of_step(window, steps::copy),
            Event::Paste(text) if is_open(window) => steps::paste(window, text),
            _ => {}
        }
    }
}

/// Whether a key was pressed just with these; then nobody else takes it. What is held now does not matter: in
/// a slow picture it may be other keys already.
fn take_key(ctx: &egui::Context, (with, key): &(Modifiers, Key)) -> bool {
    let is_it = |event: &Event| match event {
        Event::Key { key: k, pressed: true, modifiers, .. } if k == key => {
            // Some keyboards have plus above another sign.
            modifiers.matches_exact(*with) || *k == Key::Plus && modifiers.matches_logically(*with)
        }
        _ => false,
    };
    ctx.input_mut(|i| {
        let before = i.events.len();
        i.events.retain(|event| !is_it(event));
        i.events.len() < before
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_does_two_things() {
        let all: Vec<_> = ALL.iter().flat_map(|a| a.keys.iter().map(move |keys| (keys, a.name))).collect();
        for (i, (keys, name)) in all.iter().enumerate() {
            for (other, other_name) in &all[..i] {
                assert_ne!(keys, other, "{name} and {other_name}");
            }
        }
    }

    #[test]
    fn names_are_unique() {
        for (i, action) in ALL.iter().enumerate() {
            assert!(ALL[..i].iter().all(|other| other.name != action.name), "{}", action.name);
        }
    }
}
