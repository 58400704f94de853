//! The report of a command that is done: lines for people, or one JSON object with `--json`.

use std::io::Write;
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};
use simod_model::{Error, Progress, Result};

use crate::console::{Console, line};
use simod_session::is_raw;

/// Collects the figures of a command.
pub struct Report<'a> {
    console: &'a Console,
    started: Instant,
    lines: Vec<String>,
    figures: Map<String, Value>,
    timed: bool,
    failure: Option<Error>,
}

impl<'a> Report<'a> {
    /// An empty report; its clock starts now.
    pub fn new(console: &'a Console) -> Self {
        Self {
            console,
            started: Instant::now(),
            lines: Vec::new(),
            figures: Map::new(),
            timed: false,
            failure: None,
        }
    }

    /// Progress of timed work: a command that uses it gets the times of its phases into the report.
    pub fn progress(&mut self) -> &'a dyn Progress {
        self.timed = true;
        self.console
    }

    /// Progress of work whose phases' times are of no interest.
    pub fn untimed(&self) -> &'a dyn Progress {
        self.console
    }

    /// Marks the command as failed though it did its work: the error is printed after the report.
    pub fn fail(&mut self, error: Error) {
        self.failure = Some(error);
    }

    /// Adds a line for people.
    pub fn line(&mut self, text: impl Into<String>) {
        self.lines.push(text.into());
    }

    /// Adds a line for people, which programs get among the `notes`.
    pub fn note(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.record("notes", &text);
        self.line(text);
    }

    /// Adds a text to a list for programs.
    fn record(&mut self, list: &str, text: &str) {
        match self.figures.entry(list).or_insert_with(|| json!([])) {
            Value::Array(all) => all.push(text.into()),
            other => *other = json!([text]),
        }
    }

    /// Adds a figure for programs.
    pub fn figure(&mut self, name: &str, value: impl Into<Value>) {
        self.figures.insert(name.to_owned(), value.into());
    }

    /// Warns at once, on standard error, and records it.
    pub fn warn(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.console.warn(&text);
        self.record("warnings", &text);
    }

    /// Peak anonymous memory so far; `None` where the system does not tell.
    pub fn peak_memory(&self) -> Option<u64> {
        self.console.peak_memory()
    }

    /// Seconds since the command began.
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Prints the report. Returns the [failure](Self::fail), if there is one.
    pub fn finish(mut self, as_json: bool) -> Result<()> {
        let seconds = self.seconds();
        let stages = self.console.stages();
        if self.timed {
            let phase = |(name, time): &(&str, Duration)| format!("{name} {}", duration(time.as_secs_f64()));
            let phases: Vec<String> = stages.iter().map(phase).collect();
            self.lines.push(format!("{}: {}", duration(seconds), phases.join(", ")));
            if let Some(peak) = self.console.peak_memory() {
                self.lines.push(format!("peak memory {} MB", peak.div_ceil(1 << 20)));
            }
        }
        let mut out = std::io::stdout().lock();
        let written = if as_json {
            let phases: Vec<Value> =
                stages.iter().map(|(name, t)| json!({"name": name, "seconds": t.as_secs_f64()})).collect();
            self.figures.insert("seconds".into(), seconds.into());
            self.figures.insert("phases".into(), phases.into());
            self.figures.insert("peak_memory_bytes".into(), self.console.peak_memory().into());
            writeln!(out, "{}", shown_json(&Value::Object(self.figures)))
        } else {
            self.lines.iter().try_for_each(|text| writeln!(out, "{}", line(text)))
        };
        match written.and_then(|()| out.flush()) {
            // A reader that has seen enough, as `head`, is no failure.
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                Err(Error::io("write to", "standard output".as_ref(), &e))
            }
            _ => self.failure.map_or(Ok(()), Err),
        }
    }
}

/// JSON in which no character is one that a terminal may obey: such are written by their numbers, which means
/// the same.
fn shown_json(value: &Value) -> String {
    let mut text = String::new();
    for c in value.to_string().chars() {
        // A JSON value has such characters in its texts alone.
        if is_raw(c) { text.push_str(&format!("\\u{:04x}", u32::from(c))) } else { text.push(c) }
    }
    text
}

/// A time for people, of three digits at least where it is not tiny: "1.50 s", "12.3 ms".
pub fn duration(seconds: f64) -> String {
    if seconds >= 1.0 { format!("{seconds:.2} s") } else { format!("{:.1} ms", (1e3 * seconds).max(0.1)) }
}

/// A count with thin separators: 2 000 000.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(c);
    }
    out
}

/// A rate of vertices: "12.3 M vertices/s".
pub fn rate(vertices: u64, seconds: f64) -> String {
    let rate = vertices as f64 / seconds.max(1e-9);
    if rate >= 1e6 {
        format!("{:.1} M vertices/s", rate / 1e6)
    } else {
        format!("{:.0} k vertices/s", rate / 1e3)
    }
}

/// A length for people: as a fraction of the model's diagonal, and in its unit.
pub fn length(fraction: f64, diagonal: f64) -> String {
    format!("{fraction:.1e} of the diagonal ({:.1e} in the model's unit)", fraction * diagonal)
}

/// Errors of vertices for people: as fractions of the model's diagonal, and in its unit.
pub fn errors([rms, p999, worst]: [f64; 3], diagonal: f64) -> String {
    format!(
        "rms {rms:.1e}, 99.9 % below {p999:.1e}, worst {worst:.1e} of the diagonal ({:.1e}, {:.1e}, {:.1e} in the \
         model's unit)",
        rms * diagonal,
        p999 * diagonal,
        worst * diagonal
    )
}

/// Figures for `--json` that are fractions of the diagonal, with the same figures under `lengths` in the
/// model's unit. A value that is no object stays.
pub fn with_lengths(mut figures: Value, names: &[&str], diagonal: f64) -> Value {
    if let Some(figures) = figures.as_object_mut() {
        let length =
            |name: &&str| Some(((*name).to_owned(), json!(figures.get(*name)?.as_f64()? * diagonal)));
        let lengths: Map<String, Value> = names.iter().filter_map(length).collect();
        figures.insert("lengths".to_owned(), Value::Object(lengths));
    }
    figures
}

#[cfg(test)]
mod tests {
    #[test]
    fn json_has_nothing_that_a_terminal_obeys() {
        let value = serde_json::json!({ "name": "red\u{1b}[31m \u{9b}2J \u{202e}Größe" });
        let text = super::shown_json(&value);
        assert!(!text.chars().any(simod_session::is_raw), "{text:?}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).expect("JSON"), value);
    }

    #[test]
    fn no_time_is_none() {
        let times =
            [(0.0, "0.1 ms"), (0.0042, "4.2 ms"), (0.9, "900.0 ms"), (1.0, "1.00 s"), (75.5, "75.50 s")];
        for (seconds, text) in times {
            assert_eq!(super::duration(seconds), text);
        }
    }

    #[test]
    fn counts_are_grouped() {
        assert_eq!(super::count(0), "0");
        assert_eq!(super::count(1234), "1 234");
        assert_eq!(super::count(2_000_000), "2 000 000");
    }
}
