//! Input of the hands while a picture was drawn, one event after the other.
//!
//! A slow picture leaves many events to the next frame: a key that takes a tool, a press, a drag, a release,
//! another key. A frame knows one state of the pointer and of the keys, so each frame gets the events up to
//! the first deed, and the others wait for frames that follow at once, without pictures in between.

use eframe::egui::{Context, Event, Key, Plugin, RawInput};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// Gives a context its events in turn. `waits` says after each frame's beginning whether further events
/// wait for their frame.
pub fn install(ctx: &Context, waits: Arc<AtomicBool>) {
    ctx.add_plugin(InTurn { held: VecDeque::new(), waits });
    // A press and its release are of different frames, however long these take: both are a click if the
    // pointer stays.
    ctx.options_mut(|options| options.input_options.max_click_duration = f64::INFINITY);
}

/// The events that wait.
struct InTurn {
    held: VecDeque<Event>,
    waits: Arc<AtomicBool>,
}

impl Plugin for InTurn {
    fn debug_name(&self) -> &'static str {
        "events in turn"
    }

    fn input_hook(&mut self, ctx: &Context, input: &mut RawInput) {
        self.held.extend(input.events.drain(..));
        input.events = next(&mut self.held, ctx.egui_wants_keyboard_input());
        let waits = !self.held.is_empty();
        self.waits.store(waits, Relaxed);
        if waits {
            ctx.request_repaint();
        }
    }
}

/// Events up to the first deed, with those that belong to the deed. The frame in which the pointer moves is
/// another one than that in which a button is pressed or let go: a drag that begins and ends in one frame
/// is none. Where somebody types, letters are no deeds; but keys that act upon the text so far, as Tab,
/// wait until the frame has seen the text.
fn next(held: &mut VecDeque<Event>, types: bool) -> Vec<Event> {
    let mut events = Vec::new();
    let (mut done, mut moved, mut typed) = (false, false, false);
    while let Some(event) = held.front() {
        let is_button = matches!(event, Event::PointerButton { .. });
        let is_deed = match event {
            Event::Key { pressed: true, key, .. } => !types || acts_upon_text(*key),
            _ => is_button,
        };
        let moves = matches!(event, Event::PointerMoved(_) | Event::MouseMoved(_));
        let is_of_next = is_deed
            || moves
            || matches!(
                event,
                Event::Key { pressed: true, .. }
                    | Event::ModifiersChanged(_)
                    | Event::MouseWheel { .. }
                    | Event::Zoom(_)
            );
        if done && is_of_next || moved && is_button || typed && is_deed {
            break;
        }
        (done, moved) = (done || is_deed, moved || moves);
        typed = typed || types && is_typing(event);
        events.extend(held.pop_front());
    }
    events
}

/// Whether a key acts upon the text as the text is when the key is pressed.
fn acts_upon_text(key: Key) -> bool {
    matches!(key, Key::Enter | Key::Escape | Key::Tab | Key::ArrowUp | Key::ArrowDown)
}

/// Whether an event changes the text that is typed.
fn is_typing(event: &Event) -> bool {
    matches!(event, Event::Key { pressed: true, .. } | Event::Text(_) | Event::Paste(_) | Event::Cut)
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::{Modifiers, PointerButton, pos2};

    #[test]
    fn each_deed_has_a_turn() {
        let key = |key| Event::Key {
            key,
            physical_key: None,
            pressed: true,
            repeat: false,
            modifiers: Modifiers::NONE,
        };
        let button = |pressed| Event::PointerButton {
            pos: pos2(1.0, 1.0),
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        };
        let moved = |x| Event::PointerMoved(pos2(x, 0.0));
        let text = |text: &str| Event::Text(text.to_owned());
        let all = [
            key(Key::G),
            text("g"),
            moved(0.0),
            button(true),
            moved(1.0),
            moved(2.0),
            button(false),
            key(Key::Z),
            key(Key::Z),
        ];
        let mut held = VecDeque::from(all.clone());
        let turns: Vec<_> =
            std::iter::from_fn(|| Some(next(&mut held, false)).filter(|e| !e.is_empty())).collect();
        let counts: Vec<usize> = turns.iter().map(Vec::len).collect();
        assert_eq!(counts, [2, 1, 1, 2, 1, 1, 1], "{turns:?}");
        assert_eq!(turns.concat(), all);
        // Words are typed at once; a key that acts upon them comes in a later frame.
        let mut held = VecDeque::from([
            key(Key::A),
            text("a"),
            key(Key::B),
            text("b"),
            key(Key::Tab),
            key(Key::C),
            text("c"),
            key(Key::Enter),
            key(Key::G),
        ]);
        let turns = [true, true, true, true, false].map(|types| next(&mut held, types).len());
        assert_eq!(turns, [4, 1, 2, 1, 1]);
    }
}
