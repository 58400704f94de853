//! Table of all actions that have a name, for the menus, the keys and the palette.

use crate::dialogs::Purpose;
use crate::settings::{Lighting, Theme};
use crate::tools::{Tool, is_of_use};
use crate::window::{CommandPalette, Commands, Window};
use crate::{axis, regions, steps, theme};
use eframe::egui::text_selection::LabelSelectionState;
use eframe::egui::{self, Event, Key, Modifiers};
use simod_scene::SurfaceMode;
use simod_session::step::Role;
use simod_viewer::camera::{Projection, Standard, Up};
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::{Command, Overlay, Previewed};

/// Menu in which an action is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Menu {
    File,
    Edit,
    Select,
    View,
    /// Submenu of the view's menu.
    Light,
    Compare,
    Overlay,
    Tool,
    Help,
}

/// Something that the user can do by name.
pub struct NamedAction {
    /// The name that the user reads.
    pub name: &'static str,
    /// Menu in which the action is found.
    pub menu: Menu,
    /// Keys that do the action; the first ones are shown.
    pub keys: &'static [(Modifiers, Key)],
    /// Whether the action can be done now.
    pub can: fn(&Window) -> bool,
    /// State of an action that can be on or off; nothing for the others.
    pub is_on: Option<fn(&Window) -> bool>,
    /// Commands that do the action.
    pub run: fn(&Window, &mut Commands),
    /// Whether the menu has a line before the action.
    pub begins: bool,
    /// Whether the models and sessions that were opened last follow the action in its menu.
    pub precedes_recent: bool,
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
    run: fn(&Window, &mut Commands),
) -> NamedAction {
    NamedAction { name, menu, keys, can, is_on: None, run, begins: false, precedes_recent: false }
}

impl NamedAction {
    const fn on(self, is_on: fn(&Window) -> bool) -> Self {
        Self { is_on: Some(is_on), ..self }
    }

    const fn begins(self) -> Self {
        Self { begins: true, ..self }
    }

    const fn precedes_recent(self) -> Self {
        Self { precedes_recent: true, ..self }
    }

    /// The action's first keys, as the user reads them; empty where there are none.
    pub fn keys_text(&self, ctx: &egui::Context) -> String {
        self.keys.first().map_or_else(String::new, |keys| text(ctx, keys))
    }

    /// All keys of the action, as the user reads them.
    pub fn all_keys_text(&self, ctx: &egui::Context) -> String {
        self.keys.iter().map(|keys| text(ctx, keys)).collect::<Vec<_>>().join(", ")
    }
}

fn text(ctx: &egui::Context, (modifiers, key): &(Modifiers, Key)) -> String {
    ctx.format_shortcut(&egui::KeyboardShortcut::new(*modifiers, *key))
}

fn select(commands: &mut Commands, area: Area) {
    commands.apply(Command::Select { area, combine: Default::default(), visible: false, goes_on: false });
}

fn look(commands: &mut Commands, from: Standard) {
    commands.apply(Command::Camera(CameraMove::Look(from)));
}

fn show(w: &Window, commands: &mut Commands, overlay: Overlay) {
    let overlay = if w.state().overlay() == overlay { Overlay::None } else { overlay };
    commands.apply(Command::Show(overlay));
}

fn set_theme(commands: &mut Commands, theme: Theme) {
    commands.then(move |w| theme::apply(w.ctx(), theme));
    commands.set(move |settings| settings.theme = theme);
}

fn light(commands: &mut Commands, light: Lighting) {
    commands.set(move |settings| settings.light = light);
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
fn of_step(w: &Window, commands: &mut Commands, run: fn(&Window, &mut Commands, usize)) {
    if let Some(at) = w.state().chosen() {
        run(w, commands, at);
    }
}

fn is_deformation(w: &Window) -> bool {
    w.chosen().is_some()
}

/// All actions, in the order of their menus.
pub const ALL: &[NamedAction] = &[
    action(Menu::File, "Open\u{2026}", &[(CTRL, Key::O)], always, |_, c| c.then(|w| w.ask(Purpose::Open))),
    action(Menu::File, "Open Sampled Folder\u{2026}", &[], always, |_, c| {
        c.then(|w| w.ask(Purpose::OpenFolder))
    }),
    action(Menu::File, "Open the Example", &[], always, |_, c| c.then(Window::open_example))
        .precedes_recent(),
    action(Menu::File, "Save Session", &[(CTRL, Key::S)], is_open, |_, c| {
        c.then(|w| {
            w.save();
        });
    })
    .begins(),
    action(Menu::File, "Save Session As\u{2026}", &[(CTRL_SHIFT, Key::S)], is_open, |_, c| {
        c.then(|w| w.ask(Purpose::Save))
    }),
    action(Menu::File, "Write Deformed Model\u{2026}", &[(CTRL, Key::E)], is_open, |_, c| {
        c.then(|w| w.ask(Purpose::Write))
    })
    .begins(),
    action(
        Menu::File,
        "Save Picture\u{2026}",
        &[(NONE, Key::F12)],
        crate::rendering::can_begin,
        crate::rendering::ask_for_picture,
    )
    .begins(),
    action(Menu::File, "Render Turntable\u{2026}", &[], crate::rendering::can_begin, crate::rendering::ask),
    action(Menu::File, "Quit", &[(CTRL, Key::Q)], always, |w, _| {
        w.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
    })
    .begins(),
    action(
        Menu::Edit,
        "Undo",
        &[(CTRL, Key::Z)],
        |w| w.state().can_undo().is_some(),
        |_, c| c.apply(Command::Undo),
    ),
    action(
        Menu::Edit,
        "Redo",
        &[(CTRL_SHIFT, Key::Z), (CTRL, Key::Y)],
        |w| w.state().can_redo().is_some(),
        |_, c| c.apply(Command::Redo),
    ),
    action(
        Menu::Edit,
        "Reset This Motion",
        &[(ALT, Key::G)],
        |w| w.tools.target.is_some(),
        crate::tools::gizmo::reset,
    )
    .begins(),
    action(Menu::Edit, "Search Commands\u{2026}", &[(CTRL, Key::P), (CTRL, Key::K)], always, |_, c| {
        c.then(|w| w.palette = Some(CommandPalette::default()));
    })
    .begins(),
    action(Menu::Select, "Select All", &[(CTRL, Key::A), (NONE, Key::A)], is_open, |_, c| {
        select(c, Area::All)
    }),
    action(Menu::Select, "Select None", &[(ALT, Key::A), (CTRL_SHIFT, Key::A)], is_open, |_, c| {
        select(c, Area::None);
    }),
    action(Menu::Select, "Invert Selection", &[(CTRL, Key::I)], is_open, |_, c| select(c, Area::Inverse)),
    action(Menu::Select, "Grow Selection", &[(NONE, Key::Plus), (NONE, Key::Equals)], is_selected, |_, c| {
        select(c, Area::Grown);
    })
    .begins(),
    action(Menu::Select, "Shrink Selection", &[(NONE, Key::Minus)], is_selected, |_, c| {
        select(c, Area::Shrunk)
    }),
    action(
        Menu::Select,
        "Fixed Region from Selection",
        &[(SHIFT, Key::F)],
        |w| regions::can_make(w, Role::Fixed),
        |w, c| regions::make(w, c, Role::Fixed),
    )
    .begins(),
    action(
        Menu::Select,
        "Handle Region from Selection",
        &[(SHIFT, Key::H)],
        |w| regions::can_make(w, Role::Handle),
        |w, c| regions::make(w, c, Role::Handle),
    ),
    action(
        Menu::Select,
        "Mask from Selection",
        &[(SHIFT, Key::M)],
        |w| regions::can_make(w, Role::Mask),
        |w, c| regions::make(w, c, Role::Mask),
    ),
    action(Menu::Select, "Refine Selection", &[(SHIFT, Key::R)], is_selected, |_, c| regions::refine(c))
        .begins(),
    action(Menu::View, "Frame All", &[(NONE, Key::Home), (SHIFT, Key::C)], is_open, axis::frame_all),
    action(Menu::View, "Frame Selection", &[(NONE, Key::F), (NONE, Key::Period)], is_selected, |_, c| {
        c.apply(Command::Camera(CameraMove::FrameSelection))
    }),
    action(Menu::View, "Front", &[(NONE, Key::Num1)], always, |_, c| look(c, Standard::Front)).begins(),
    action(Menu::View, "Back", &[(CTRL, Key::Num1)], always, |_, c| look(c, Standard::Back)),
    action(Menu::View, "Right", &[(NONE, Key::Num3)], always, |_, c| look(c, Standard::Right)),
    action(Menu::View, "Left", &[(CTRL, Key::Num3)], always, |_, c| look(c, Standard::Left)),
    action(Menu::View, "Top", &[(NONE, Key::Num7)], always, |_, c| look(c, Standard::Top)),
    action(Menu::View, "Bottom", &[(CTRL, Key::Num7)], always, |_, c| look(c, Standard::Bottom)),
    action(Menu::View, "Isometric", &[(NONE, Key::Num9)], always, |_, c| look(c, Standard::Isometric)),
    action(Menu::View, "Orthographic", &[(NONE, Key::Num5)], always, |w, c| {
        let other = match w.state().camera().projection {
            Projection::Perspective => Projection::Orthographic,
            Projection::Orthographic => Projection::Perspective,
        };
        c.apply(Command::Camera(CameraMove::Project(other)));
    })
    .on(|w| w.state().camera().projection == Projection::Orthographic)
    .begins(),
    action(Menu::View, "Z Is Up", &[], always, |w, c| {
        let up = if w.state().camera().up == Up::Z { Up::Y } else { Up::Z };
        c.apply(Command::Camera(CameraMove::Up(up)));
    })
    .on(|w| w.state().camera().up == Up::Z),
    action(Menu::View, "Triangles", &[(NONE, Key::T)], has_triangles, |_, c| {
        c.then(|w| w.looks.triangles = Some(w.mode() != SurfaceMode::Triangles));
    })
    .on(|w| w.mode() == SurfaceMode::Triangles)
    .begins(),
    action(Menu::View, "Ghost of the Rest Shape", &[(SHIFT, Key::G)], is_open, |_, c| {
        c.then(|w| w.looks.ghost ^= true)
    })
    .on(|w| w.looks.ghost),
    action(Menu::View, "Samples over Full Detail", &[], is_open, |_, c| c.then(|w| w.looks.samples ^= true))
        .on(|w| w.looks.samples),
    action(Menu::View, "The Model's Own Colours", &[], has_colors, |w, c| {
        let own = !w.state().has_own_colors();
        c.apply(Command::ShowOwnColors(own));
    })
    .on(|w| w.state().has_own_colors()),
    action(Menu::View, "Region Colours", &[], is_open, |_, c| c.then(|w| w.looks.regions ^= true))
        .on(|w| w.looks.regions),
    action(Menu::View, "Handles", &[], is_open, |_, c| c.then(|w| w.looks.handles ^= true))
        .on(|w| w.looks.handles),
    action(Menu::View, "Darker Crevices", &[], always, |_, c| {
        c.set(|settings| settings.occlusion ^= true);
    })
    .on(|w| w.settings.occlusion),
    action(Menu::View, "Cut Open", &[(ALT, Key::B)], is_open, crate::clip::switch)
        .on(|w| w.state().clipped().is_some()),
    action(Menu::Light, "Lit by Lamps", &[], always, |_, c| light(c, Lighting::Lamps))
        .on(|w| w.settings.light == Lighting::Lamps),
    action(Menu::Light, "Lit from the Camera", &[], always, |_, c| light(c, Lighting::Camera))
        .on(|w| w.settings.light == Lighting::Camera),
    action(Menu::Light, "Ceramic", &[], always, |_, c| light(c, Lighting::Ceramic))
        .on(|w| w.settings.light == Lighting::Ceramic)
        .begins(),
    action(Menu::Light, "Polished Metal", &[], always, |_, c| light(c, Lighting::Metal))
        .on(|w| w.settings.light == Lighting::Metal),
    action(Menu::Light, "Warm Wax", &[], always, |_, c| light(c, Lighting::Wax))
        .on(|w| w.settings.light == Lighting::Wax),
    action(Menu::Light, "Mirrored Stripes", &[], always, |_, c| light(c, Lighting::Stripes))
        .on(|w| w.settings.light == Lighting::Stripes),
    action(Menu::View, "Full Detail of What Is Seen", &[(NONE, Key::I)], is_open, |_, c| {
        c.apply(Command::Preview { what: Previewed::Seen })
    })
    .on(|w| w.state().detail().is_some_and(|detail| detail.previewed() == Previewed::Seen))
    .begins(),
    action(Menu::View, "Full Detail of the Selection", &[(SHIFT, Key::I)], is_selected, |_, c| {
        c.apply(Command::Preview { what: Previewed::Selection })
    })
    .on(|w| w.state().detail().is_some_and(|detail| detail.previewed() == Previewed::Selection)),
    action(
        Menu::View,
        "Samples Only",
        &[(ALT, Key::I)],
        |w| w.state().detail().is_some(),
        |_, c| c.apply(Command::Preview { what: Previewed::Nothing }),
    ),
    action(Menu::View, "Dark Theme", &[], always, |_, c| set_theme(c, Theme::Dark))
        .on(|w| w.settings.theme == Theme::Dark)
        .begins(),
    action(Menu::View, "Light Theme", &[], always, |_, c| set_theme(c, Theme::Light))
        .on(|w| w.settings.theme == Theme::Light),
    action(Menu::Compare, "Pin This Version", &[(NONE, Key::P)], is_open, |_, c| c.apply(Command::Pin)),
    action(Menu::Compare, "Pin a Session\u{2026}", &[], is_open, |_, c| c.then(|w| w.ask(Purpose::Pin))),
    action(Menu::Compare, "Unpin", &[(SHIFT, Key::P)], is_pinned, |_, c| c.apply(Command::Unpin)),
    action(Menu::Compare, "Side by Side", &[(NONE, Key::V)], is_pinned, |_, c| {
        c.then(|w| w.looks.side_by_side ^= true)
    })
    .on(|w| w.looks.side_by_side)
    .begins(),
    action(Menu::Compare, "Pinned Version in Place", &[(SHIFT, Key::V)], is_pinned, |_, c| {
        c.then(|w| w.looks.pinned_in_place ^= true);
    })
    .on(|w| w.looks.pinned_in_place),
    action(Menu::Compare, "Go On with the Pinned Version", &[(SHIFT, Key::X)], is_pinned, |_, c| {
        c.apply_then(Command::SwapPinned, |w| {
            w.tools.target = None;
            w.looks.pinned_in_place = false;
        });
    })
    .begins(),
    action(Menu::Overlay, "Surface Only", &[], is_open, |_, c| c.apply(Command::Show(Overlay::None)))
        .on(|w| w.state().overlay() == Overlay::None),
    action(Menu::Overlay, "Displacement", &[], is_open, |w, c| show(w, c, Overlay::Displacement))
        .on(|w| w.state().overlay() == Overlay::Displacement),
    action(Menu::Overlay, "Stretch", &[], is_open, |w, c| show(w, c, Overlay::Stretch))
        .on(|w| w.state().overlay() == Overlay::Stretch),
    action(Menu::Overlay, "Sample Distance", &[], is_open, |w, c| show(w, c, Overlay::Density))
        .on(|w| w.state().overlay() == Overlay::Density),
    action(Menu::Overlay, "Expected Transfer Error", &[], is_open, |w, c| show(w, c, Overlay::TransferError))
        .on(|w| w.state().overlay() == Overlay::TransferError),
    action(Menu::Overlay, "Difference from the Pinned Version", &[], is_pinned, |w, c| {
        show(w, c, Overlay::Difference);
    })
    .on(|w| w.state().overlay() == Overlay::Difference),
    tool(Tool::Orbit, &[(NONE, Key::Q)], |_, c| pick(c, Tool::Orbit), |w| w.tools.tool == Tool::Orbit),
    tool(Tool::Move, &[(NONE, Key::G)], |w, c| begin(w, c, Tool::Move), |w| w.tools.tool == Tool::Move),
    tool(Tool::Rotate, &[(NONE, Key::R)], |w, c| begin(w, c, Tool::Rotate), |w| w.tools.tool == Tool::Rotate),
    tool(Tool::Scale, &[(NONE, Key::S)], |w, c| begin(w, c, Tool::Scale), |w| w.tools.tool == Tool::Scale),
    tool(Tool::Brush, &[(NONE, Key::C)], |_, c| pick(c, Tool::Brush), |w| w.tools.tool == Tool::Brush),
    tool(Tool::Lasso, &[(NONE, Key::L)], |_, c| pick(c, Tool::Lasso), |w| w.tools.tool == Tool::Lasso),
    tool(Tool::Box, &[(NONE, Key::B)], |_, c| pick(c, Tool::Box), |w| w.tools.tool == Tool::Box),
    tool(
        Tool::Connected,
        &[(NONE, Key::K)],
        |_, c| pick(c, Tool::Connected),
        |w| w.tools.tool == Tool::Connected,
    ),
    tool(Tool::Stroke, &[(NONE, Key::D)], |_, c| pick(c, Tool::Stroke), |w| w.tools.tool == Tool::Stroke),
    tool(Tool::Measure, &[(NONE, Key::M)], |_, c| pick(c, Tool::Measure), |w| w.tools.tool == Tool::Measure),
    tool(Tool::Joint, &[(NONE, Key::J)], |_, c| pick(c, Tool::Joint), |w| w.tools.tool == Tool::Joint),
    action(Menu::Edit, "Rename the Step", &[(NONE, Key::F2)], has_step, |w, c| of_step(w, c, steps::rename))
        .begins(),
    action(Menu::Edit, "Duplicate the Step", &[(CTRL, Key::D)], has_step, |w, c| {
        of_step(w, c, steps::duplicate)
    }),
    action(Menu::Edit, "Copy the Step", &[(CTRL, Key::C)], has_step, |w, c| of_step(w, c, steps::copy)),
    action(Menu::Edit, "Paste Steps", &[(CTRL, Key::V)], is_open, |w, _| {
        w.ctx().send_viewport_cmd(egui::ViewportCommand::RequestPaste);
    }),
    action(Menu::Edit, "Group with the Step Above", &[(CTRL, Key::G)], has_step, |w, c| {
        of_step(w, c, steps::group)
    }),
    action(Menu::Edit, "Only This Step", &[(SHIFT, Key::S)], is_deformation, |w, c| {
        of_step(w, c, steps::solo)
    })
    .on(|w| w.state().chosen().is_some_and(|at| steps::is_alone(w, at))),
    action(Menu::Edit, "More of the Step", &[(SHIFT, Key::ArrowUp)], is_deformation, |w, c| {
        steps::change_amount(w, c, 0.1);
    }),
    action(Menu::Edit, "Less of the Step", &[(SHIFT, Key::ArrowDown)], is_deformation, |w, c| {
        steps::change_amount(w, c, -0.1);
    }),
    action(Menu::Edit, "Remove the Chosen Step", &[], has_step, |w, c| {
        if let Some(at) = w.state().chosen() {
            c.apply(Command::Edit(simod_session::edit::EditCommand::Remove { at }));
        }
    })
    .begins(),
    action(Menu::Help, "Look for Plugins Again", &[], always, |_, c| c.then(Window::look_for_plugins)),
    action(Menu::Help, "Keys and Mouse", &[(NONE, Key::F1)], always, |_, c| c.then(|w| w.shows_keys = true)),
];

const fn tool(
    tool: Tool,
    keys: &'static [(Modifiers, Key)],
    run: fn(&Window, &mut Commands),
    is_on: fn(&Window) -> bool,
) -> NamedAction {
    let can: fn(&Window) -> bool = match tool {
        Tool::Stroke => |w| is_of_use(Tool::Stroke, w),
        Tool::Joint => |w| is_of_use(Tool::Joint, w),
        _ => is_open,
    };
    action(Menu::Tool, tool.name(), keys, can, run).on(is_on)
}

/// Takes a tool that moves the handles in the hand, and begins the motion where the navigation preset says
/// so.
fn begin(w: &Window, commands: &mut Commands, tool: Tool) {
    pick(commands, tool);
    let at_once = w.settings.navigation().begins_at_once;
    let begins = Some(tool).filter(|_| at_once && w.tools.target.is_some());
    commands.then(move |w| w.tools.begins = begins);
}

fn pick(commands: &mut Commands, tool: Tool) {
    commands.then(move |w| w.tools.take(tool));
}

/// Does the actions of the keys that were just pressed.
pub fn keys(window: &mut Window) {
    let ctx = window.ctx().clone();
    if ctx.egui_wants_keyboard_input() || window.is_asking() || window.tools.gesture.transforming.is_some() {
        return;
    }
    window.draw(clipboard);
    for action in ALL {
        if action.keys.iter().any(|keys| take_key(&ctx, keys)) && (action.can)(window) {
            window.draw(action.run);
            if window.is_asking() {
                return;
            }
        }
    }
}

/// Copies and pastes where the system says so: the system keeps the keys for that to itself.
fn clipboard(window: &Window, commands: &mut Commands) {
    let ctx = window.ctx().clone();
    // A text that is selected in a label is meant first.
    let selects_text = ctx.plugin::<LabelSelectionState>().lock().has_selection();
    let is_of_it = |event: &Event| match event {
        Event::Copy => !selects_text,
        event => matches!(event, Event::Paste(_)),
    };
    let events: Vec<Event> = ctx.input_mut(|i| i.events.extract_if(.., |event| is_of_it(event)).collect());
    for event in events {
        match event {
            Event::Copy => of_step(window, commands, steps::copy),
            Event::Paste(text) if is_open(window) => steps::paste(commands, text),
            _ => {}
        }
    }
}

/// Whether a key was pressed with these modifiers and no others; then nobody else takes the press. The
/// modifiers that are held now do not matter: in a slow picture these may be others already.
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
