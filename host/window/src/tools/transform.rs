//! A motion by keys: G, R and S begin it at once; X, Y and Z say along what, digits how far. Enter or a click ends it,
//! Escape or the right button takes it back.

use super::gizmo::Place;
use super::{Target, Tool};
use crate::numbers::number;
use crate::viewport::Canvas;
use crate::window::Window;
use eframe::egui::{self, Align2, Color32, CursorIcon, Event, FontId, Key, PointerButton, Stroke};
use glam::{DAffine3, DVec3};
use simod_session::Motion;
use simod_session::edit::{Change, StepId};
use simod_viewer::Command;
use simod_viewer::held::Held;
use simod_viewer::transform::{Kind, Seen, Transform};

/// Of the axes, as the gizmo has them.
const COLORS: [Color32; 3] =
    [Color32::from_rgb(226, 62, 68), Color32::from_rgb(96, 172, 40), Color32::from_rgb(52, 120, 232)];
const KEYS: [(Key, usize); 3] = [(Key::X, 0), (Key::Y, 1), (Key::Z, 2)];
const NAMES: [&str; 3] = ["X", "Y", "Z"];

/// A motion that is going on.
pub struct Transforming {
    transform: Transform,
    step: StepId,
    of: Of,
    /// The middle, local coordinates.
    middle: DVec3,
    /// The motion that was done last.
    last: Option<Motion>,
    /// Whether the button is held that ends it.
    pressed: bool,
}

/// What moves.
enum Of {
    Handles(Held),
    /// A handle region, from its gizmo's place.
    Region(Box<Place>, DAffine3),
}

impl Of {
    fn change(&self, motion: &Motion) -> Option<Change> {
        match self {
            Self::Handles(held) => held.moved(motion).map(Change::MoveHandles),
            Self::Region(place, from) => place.change_to(motion.to_affine(from.translation) * *from),
        }
    }
}

enum Next {
    GoesOn,
    Done,
    Back,
}

/// Begins, if there is anything in the hand and the pointer is over the picture.
pub fn begin(canvas: &Canvas<'_>, window: &mut Window, tool: Tool) {
    let kind = match tool {
        Tool::Rotate => Kind::Turn,
        Tool::Scale => Kind::Scale,
        _ => Kind::Move,
    };
    let Some((step, id, ..)) = window.chosen() else { return };
    let (Some(place), Some(pointer)) = (Place::of(window), canvas.pointer()) else { return };
    let of = match place.target() {
        Target::Region(_) => Of::Region(Box::new(place.clone()), place.matrix()),
        Target::Handle(_) => match held(window, step, id) {
            Some(held) => Of::Handles(held),
            None => return,
        },
    };
    let Some(frame) = window.state().scene().map(|scene| scene.frame()) else { return };
    let middle = match &of {
        Of::Handles(held) => held.pivot(),
        Of::Region(_, from) => from.translation,
    };
    let middle = frame.to_local_exact(middle);
    let transform = Transform::new(kind, middle, frame.scale, pointer);
    window.tools.transforming =
        Some(Transforming { transform, step: id, of, middle, last: None, pressed: false });
}

/// The handles that the hand holds, with those around them that go along.
pub fn held(window: &Window, step: usize, id: StepId) -> Option<Held> {
    let bounds = window.state().scene()?.sampled.bounds;
    let reach = window.tools.reach * (bounds.max - bounds.min).length();
    Held::new(&window.state().handles(step), &window.tools.handles(id), reach)
}

/// Goes on with it. The pointer is its own as long as it lasts.
pub fn update(canvas: &Canvas<'_>, window: &mut Window) -> bool {
    let Some(mut going) = window.tools.transforming.take() else { return false };
    if window.chosen().is_none_or(|(_, id, ..)| id != going.step) {
        return false;
    }
    let (camera, size) = (*window.state().camera(), window.state().size());
    let seen = Seen { camera: &camera, size };
    for pixel in canvas.trail().into_iter().chain(canvas.pointer()) {
        going.transform.follow(pixel, seen);
    }
    let next = going.next(canvas.ctx());
    if matches!(next, Next::Back) {
        if going.last.is_some() {
            window.apply(Command::Undo);
        }
        return true;
    }
    let motion = going.transform.motion(seen, canvas.modifiers().command);
    if let (Some(motion), Some((step, ..))) = (motion, window.chosen())
        && going.last.unwrap_or_default() != motion
        && let Some(change) = going.of.change(&motion)
    {
        going.last = Some(motion);
        window.change(step, change, true);
    }
    canvas.ctx().set_cursor_icon(CursorIcon::Move);
    going.draw(canvas, seen);
    if matches!(next, Next::Done) {
        if going.last.is_some() {
            window.apply(Command::Rest);
        }
    } else {
        window.tools.transforming = Some(going);
    }
    true
}

impl Transforming {
    /// What keys and buttons say.
    fn next(&mut self, ctx: &egui::Context) -> Next {
        let events = ctx.input_mut(|i| std::mem::take(&mut i.events));
        let mut next = Next::GoesOn;
        for event in events {
            match event {
                Event::Key { key: Key::Enter, pressed: true, .. } => next = Next::Done,
                Event::Key { key: Key::Escape, pressed: true, .. }
                | Event::PointerButton { button: PointerButton::Secondary, pressed: false, .. } => {
                    next = Next::Back;
                }
                Event::PointerButton { button: PointerButton::Primary, pressed: true, .. } => {
                    self.pressed = true
                }
                Event::PointerButton { button: PointerButton::Primary, pressed: false, .. }
                    if self.pressed =>
                {
                    next = Next::Done;
                }
                Event::Key { key: Key::Backspace, pressed: true, .. } => self.transform.erase(),
                Event::Key { key, pressed: true, repeat: false, .. } => {
                    let axis = KEYS.iter().find(|(known, _)| *known == key);
                    axis.iter().for_each(|(_, axis)| self.transform.toggle_axis(*axis));
                }
                Event::Text(text) => text.chars().for_each(|c| self.transform.type_in(c)),
                _ => {}
            }
        }
        next
    }

    /// The axis, and what is done, in numbers.
    fn draw(&self, canvas: &Canvas<'_>, seen: Seen<'_>) {
        let painter = canvas.painter();
        if let Some(axis) = self.transform.axis() {
            let end = |far: f64| {
                let pixel = seen.camera.project(self.middle + far * DVec3::AXES[axis], seen.size)?.0;
                Some(canvas.at(pixel))
            };
            // In short pieces, as a line may go behind the eye.
            let ends: Vec<_> = (-40..=40).map(|i| end(f64::from(i) * 0.1)).collect();
            for pair in ends.windows(2) {
                if let [Some(a), Some(b)] = pair {
                    painter.line_segment([*a, *b], Stroke::new(1.5, COLORS[axis]));
                }
            }
        }
        let text = self.text();
        let at = canvas.rect().left_bottom() + egui::vec2(16.0, -18.0);
        let galley = painter.layout_no_wrap(text, FontId::proportional(15.0), Color32::WHITE);
        let rect = Align2::LEFT_BOTTOM.anchor_size(at, galley.size());
        painter.rect_filled(rect.expand(7.0), 5.0, Color32::from_black_alpha(190));
        painter.galley(rect.min, galley, Color32::WHITE);
    }

    fn text(&self) -> String {
        let motion = self.last.unwrap_or_default();
        let axis = self.transform.axis();
        let typed = self.transform.typed();
        let value = |shown: String| if typed.is_empty() { shown } else { format!("{typed}|") };
        let text = match (self.transform.kind(), axis) {
            (Kind::Move, Some(axis)) => {
                format!("Move along {}: {}", NAMES[axis], value(number(motion.translate[axis])))
            }
            (Kind::Move, None) => {
                let all = motion.translate.to_array().map(number).join(", ");
                format!("Move: {}", value(all))
            }
            (Kind::Turn, axis) => {
                let about = axis.map_or_else(String::new, |axis| format!(" about {}", NAMES[axis]));
                format!("Turn{about}: {}\u{b0}", value(format!("{:.1}", motion.degrees)))
            }
            (Kind::Scale, _) => format!("Scale: {}", value(number(motion.scale))),
        };
        format!(
            "{text}     X, Y, Z: axis \u{b7} digits: how far \u{b7} Enter, click: done \u{b7} Escape: back"
        )
    }
}
