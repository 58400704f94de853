//! Times for which commands hold up the thread that gives them, which is the window's.

use crate::command::Command;
use std::fmt::{self, Write};
use std::time::Duration;

/// Duration above which a user feels a delay.
const FELT: Duration = Duration::from_millis(50);

/// Most characters of a command in the message.
const LONGEST: usize = 60;

/// The commands that took longest.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Slowest {
    /// The beginning of the command that took longest, as in a recording; empty where there was none.
    pub command: String,
    /// Duration of that command.
    pub took: Duration,
    /// Number of commands that took longer than 50 ms.
    pub felt: u64,
}

impl Slowest {
    pub(super) fn note(&mut self, command: &Command, took: Duration) {
        self.felt += u64::from(took > FELT);
        if took > self.took {
            (self.command, self.took) = (beginning(command), took);
        }
    }
}

impl fmt::Display for Slowest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { command, took, felt } = self;
        write!(f, "{felt} commands held the window up for more than {} ms", FELT.as_millis())?;
        write!(f, "; the slowest: {:.0} ms, {command}", 1e3 * took.as_secs_f64())
    }
}

/// Beginning of a command's text: the whole may have a million numbers.
fn beginning(command: &Command) -> String {
    struct StageStart(String);
    impl Write for StageStart {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.0.extend(text.chars().take(LONGEST - self.0.chars().count()));
            if self.0.chars().count() < LONGEST { Ok(()) } else { Err(fmt::Error) }
        }
    }
    let mut text = StageStart(String::new());
    // Writing ends with an error once there is enough.
    let _ = write!(text, "{command:?}");
    text.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Area;

    #[test]
    fn the_slowest_is_told_by_its_beginning() {
        let mut slowest = Slowest::default();
        slowest.note(&Command::Undo, Duration::from_millis(51));
        slowest.note(&Command::Redo, Duration::from_millis(3));
        let area = Area::Runs(vec![1; 1 << 20]);
        let select = Command::Select { area, combine: Default::default(), visible: false, goes_on: false };
        slowest.note(&select, Duration::from_millis(70));
        assert_eq!(slowest.felt, 2);
        let told = slowest.to_string();
        assert!(told.contains("2 commands") && told.contains("70 ms, Select { area: Runs("), "{told}");
        assert_eq!(slowest.command.chars().count(), LONGEST);
    }
}
