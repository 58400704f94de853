//! Replays recorded commands without a window.

use crate::command::Command;
use crate::state::State;
use simod_model::Result;
use simod_session::PluginRegistry;
use std::sync::Arc;
use std::time::Duration;

/// Longest time of a single command before a replay gives up.
const PATIENCE: Duration = Duration::from_secs(24 * 3600);

/// Does commands one after the other, and waits each time until all that a command asks for is done.
///
/// # Errors
/// A command cannot be done; the error names the command.
pub fn replay(commands: &[Command], plugins: &Arc<PluginRegistry>) -> Result<State> {
    let mut state = State::new(plugins.clone(), Arc::new(|| ()));
    for (i, command) in commands.iter().enumerate() {
        state.apply(command.clone()).map_err(|e| {
            let what = format!("command {} of the recording cannot be done: {e}", i + 1);
            e.saying(what)
        })?;
        state.settle(PATIENCE)?;
    }
    Ok(state)
}
