//! Rules on time, and on the number of lines that a plugin says.

use crate::answer::{Listener, PluginRefusal, answer, panicked};
use crate::case::Case;
use crate::finding::{Checked, Finding};
use crate::inputs::{LARGE, ORDINARY};
use crate::subject::{Subject, unwritten};
use simod_plugin_api::{ErrorCode, PluginResult};
use std::time::{Duration, Instant};

/// Time within which a plugin should have stopped.
const PROMPT: Duration = Duration::from_secs(1);

/// Time after which a plugin counts as deaf to the wish to stop.
const DEAF: Duration = Duration::from_secs(2);

/// Advice on how a plugin stops in time.
const LISTEN: &str = "ask the host's `progress` every 100 ms, and return its error";

/// Longest deformation that feels as if the motion was continuous.
const INTERACTIVE: Duration = Duration::from_millis(100);

/// Lines of a call that somebody may read.
const LINES: usize = 100;

pub(crate) fn cancel(subject: &Subject) -> Checked<Finding> {
    let (plugin, case, stop) =
        (&subject.plugin, Case::bumpy_sphere(&subject.plugin, LARGE)?, Listener::impatient());
    let mut slowest = ("prepare", Duration::ZERO);
    let mut take = |call: &'static str, time: Duration| {
        if time > slowest.1 {
            slowest = (call, time);
        }
        if time <= DEAF {
            return Ok(());
        }
        Err(Finding::fail(
            format!("{call} went on for {:.1} s after it was asked to stop", time.as_secs_f64()),
            LISTEN,
        ))
    };
    let started = Instant::now();
    let state = case.prepare_input(|input| plugin.code().prepare(input, &stop));
    take("prepare", started.elapsed())?;
    let state = match stopped("prepare", state)? {
        Some(state) => state,
        None => subject.prepare(&case)?.map_err(PluginRefusal::of_ordinary)?,
    };
    let (mut scratch, mut out) = (subject.scratch()?, unwritten(&case));
    let started = Instant::now();
    let done = case.deform_input(|input| plugin.code().deform(&state, input, &mut scratch, &mut out, &stop));
    take("deform", started.elapsed())?;
    stopped("deform", done)?;
    let mut points: Vec<_> = case.positions.iter().map(|p| p.map(f64::from)).collect();
    if plugin.capabilities().evaluate {
        let started = Instant::now();
        let done = case.deform_input(|input| plugin.code().evaluate(&state, input, &mut points, &stop));
        take("evaluate", started.elapsed())?;
        stopped("evaluate", done)?;
    }
    let (call, time) = slowest;
    let text = format!("{call} took {:.3} s to stop or finish", time.as_secs_f64());
    Ok(if time > PROMPT { Finding::warn(text, LISTEN) } else { Finding::pass(text) })
}

/// Outcome of a call that was asked to stop: its result, where the call finished all the same. Any error
/// but a panic will do.
fn stopped<T>(call: &str, result: PluginResult<T>) -> Checked<Option<T>> {
    match result {
        Err(error) if error.code == ErrorCode::PANICKED => Err(panicked(call, &error)),
        result => Ok(result.ok()),
    }
}

pub(crate) fn log(subject: &Subject) -> Checked<Finding> {
    let (plugin, case) = (&subject.plugin, Case::bumpy_sphere(&subject.plugin, ORDINARY)?);
    let host = Listener::patient();
    let state = case.prepare_input(|input| plugin.code().prepare(input, &host));
    let mut most = ("prepare", host.lines());
    if let Ok(state) = answer("prepare", state)? {
        let (mut scratch, mut out, host) = (subject.scratch()?, unwritten(&case), Listener::patient());
        let done =
            case.deform_input(|input| plugin.code().deform(&state, input, &mut scratch, &mut out, &host));
        if host.lines() > most.1 {
            most = ("deform", host.lines());
        }
        // A refusal may be told in as few lines as anything else.
        let _ = answer("deform", done)?;
        if plugin.capabilities().evaluate {
            let host = Listener::patient();
            let mut points: Vec<_> = case.positions.iter().map(|p| p.map(f64::from)).collect();
            let done = case.deform_input(|input| plugin.code().evaluate(&state, input, &mut points, &host));
            if host.lines() > most.1 {
                most = ("evaluate", host.lines());
            }
            let _ = answer("evaluate", done)?;
        }
    }
    let (call, lines) = most;
    if lines > LINES {
        let hint = "say in one line what matters; the host shows no more than 100 a call";
        return Err(Finding::fail(format!("{call} says {lines} lines"), hint));
    }
    Ok(Finding::pass(format!("at most {lines} lines a call")))
}

/// The shortest of a few deformations is quick; there are a few, as other programs take their time, too.
pub(crate) fn latency(subject: &Subject) -> Checked<Finding> {
    const TIMES: usize = 5;
    let case = Case::bumpy_sphere(&subject.plugin, LARGE)?;
    let state = subject.prepare(&case)?.map_err(PluginRefusal::of_ordinary)?;
    let (mut scratch, mut out, host) = (subject.scratch()?, unwritten(&case), Listener::patient());
    let mut shortest = Duration::MAX;
    for _ in 0..TIMES {
        let started = Instant::now();
        let done = case
            .deform_input(|input| subject.plugin.code().deform(&state, input, &mut scratch, &mut out, &host));
        shortest = shortest.min(started.elapsed());
        answer("deform", done)?.map_err(PluginRefusal::of_ordinary)?;
    }
    let text = format!("deform takes {:.1} ms for 200 000 samples", shortest.as_secs_f64() * 1e3);
    Ok(if shortest > INTERACTIVE {
        Finding::warn(text, "move work to prepare, and use all cores, so that handles can be dragged")
    } else {
        Finding::pass(text)
    })
}
