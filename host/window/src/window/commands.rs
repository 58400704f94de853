//! Commands of panels and tools. Panels and tools see the window as it is, and change nothing themselves: an
//! action of the user there becomes a command, which is done once the panel is drawn.

use super::Window;
use crate::settings::WindowSettings;
use simod_session::edit::Change;
use simod_viewer::Command;

/// Something that is to be done with the window.
type WindowCommand = Box<dyn FnOnce(&mut Window)>;

/// List of commands to the window, first to last.
#[derive(Default)]
pub struct Commands(Vec<WindowCommand>);

impl Commands {
    /// Adds any command.
    pub fn then(&mut self, command: impl FnOnce(&mut Window) + 'static) {
        self.0.push(Box::new(command));
    }

    /// Adds the commands that others hold, after these.
    pub fn append(&mut self, others: Self) {
        self.0.extend(others.0);
    }

    /// Adds the commands of a part of the window, which sees the window as the commands before have left
    /// it.
    pub fn then_draw(&mut self, part: impl FnOnce(&Window, &mut Self) + 'static) {
        self.then(|window| window.draw(part));
    }

    /// Adds a [command](Window::apply).
    pub fn apply(&mut self, command: Command) {
        self.then(|window| {
            window.apply(command);
        });
    }

    /// Adds a [command](Window::apply), and what follows if the command was done.
    pub fn apply_then(&mut self, command: Command, follows: impl FnOnce(&mut Window) + 'static) {
        self.then(|window| {
            if window.apply(command) {
                follows(window);
            }
        });
    }

    /// Adds a change of the settings, which are kept.
    pub fn set(&mut self, change: impl FnOnce(&mut WindowSettings) + 'static) {
        self.then(|window| {
            change(&mut window.settings);
            window.keep_settings();
        });
    }

    /// Adds a [change](Window::change) of a step, or a drag of something of the step.
    pub fn change(&mut self, at: usize, change: Change, dragging: bool) {
        self.then(move |window| {
            window.change(at, change, dragging);
        });
    }
}

impl Window {
    /// Draws a part of the window, and does the commands that come of the part. Returns the part's result.
    pub fn draw<T>(&mut self, part: impl FnOnce(&Self, &mut Commands) -> T) -> T {
        let mut commands = Commands::default();
        let said = part(self, &mut commands);
        self.run(commands);
        said
    }

    /// Draws a part of the window that has something of its own, which nobody else sees meanwhile.
    pub fn draw_with<S: Default, T>(
        &mut self,
        own: fn(&mut Self) -> &mut S,
        part: impl FnOnce(&Self, &mut Commands, &mut S) -> T,
    ) -> T {
        let mut taken = std::mem::take(own(self));
        let mut commands = Commands::default();
        let said = part(self, &mut commands, &mut taken);
        *own(self) = taken;
        self.run(commands);
        said
    }

    fn run(&mut self, commands: Commands) {
        commands.0.into_iter().for_each(|command| command(self));
    }
}
