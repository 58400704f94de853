//! Options on the time in a sequence for which the steps of a session are done.

use clap::Args;
use simod_model::{Error, Result};
use simod_session::session_file::SessionTime;

/// `--frame` and `--time`.
#[derive(Args)]
pub struct TimeOptions {
    /// Frame of a sequence, for plugins that take the time, instead of the session's `[time]`
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    frame: Option<i64>,
    /// Time since the beginning of the sequence, in seconds
    ///
    /// [default: the frame, by the session's `rate` or 24 frames per second]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    time: Option<f64>,
}

impl TimeOptions {
    /// Time of the session, replaced by the options as far as they are given.
    pub fn over(&self, session: SessionTime) -> Result<SessionTime> {
        let asked = self.frame.is_some() || self.time.is_some();
        let time = SessionTime {
            frame: self.frame.or(session.frame),
            seconds: if asked { self.time } else { session.seconds },
            ..session
        };
        match time.defect() {
            Some(_) => Err(Error::argument("--time is no finite number", "give seconds, such as 0.5")),
            None => Ok(time),
        }
    }
}
