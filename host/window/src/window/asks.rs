//! What panels ask for. They see the window as it is, and change nothing themselves: what the user does there
//! is asked for, and done once the panel is drawn.

use super::Window;
use simod_session::edit::Change;
use simod_viewer::Command;

/// Something that is to be done with the window.
pub type Ask = Box<dyn FnOnce(&mut Window)>;

/// What is to be done with the window, first to last.
#[derive(Default)]
pub struct Asks(Vec<Ask>);

impl Asks {
    /// Anything.
    pub fn then(&mut self, ask: impl FnOnce(&mut Window) + 'static) {
        self.0.push(Box::new(ask));
    }

    /// A [command](Window::apply).
    pub fn apply(&mut self, command: Command) {
        self.then(|window| {
            window.apply(command);
        });
    }

    /// A [change](Window::change) of a step, or a drag of something of it.
    pub fn change(&mut self, at: usize, change: Change, dragging: bool) {
        self.then(move |window| {
            window.change(at, change, dragging);
        });
    }
}

impl Window {
    /// Draws a part of the window, and does what is asked for there.
    pub fn draw(&mut self, part: impl FnOnce(&Self, &mut Asks)) {
        let mut asks = Asks::default();
        part(self, &mut asks);
        self.answer(asks);
    }

    /// Does what was asked for.
    pub fn answer(&mut self, asks: Asks) {
        asks.0.into_iter().for_each(|ask| ask(self));
    }
}
