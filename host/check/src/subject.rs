//! The plugin under check, and calls to it whose failures are findings.

use crate::answer::{Answer, Listener, PluginRefusal, answer};
use crate::case::Case;
use crate::finding::{Checked, Finding};
use simod_plugin_api::{Scratch, State};
use simod_session::deformer::{Plugin, is_usable};

/// Content of a position before it is written: a NaN that no computation gives.
const UNWRITTEN: f32 = f32::from_bits(0x7fc5_1d0d);

/// A plugin under check.
pub(crate) struct Subject {
    pub plugin: Plugin,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Subject {
    /// Subject for this plugin.
    pub fn new(plugin: Plugin, seed: u64) -> Self {
        Self { plugin, seed }
    }

    /// Prepares the case.
    pub fn prepare(&self, case: &Case) -> Checked<Answer<State>> {
        answer("prepare", case.prepare_input(|input| self.plugin.code().prepare(input, &Listener::patient())))
    }

    /// Makes working memory of the plugin.
    pub fn scratch(&self) -> Checked<Scratch> {
        answer("new_scratch", self.plugin.code().new_scratch())?
            .map_err(|PluginRefusal(what)| Finding::fail(format!("it has no working memory: {what}"), ""))
    }

    /// Deforms with a state, and returns the positions, which are all written and finite.
    pub fn deform(
        &self,
        case: &Case,
        state: &State,
        scratch: &mut Scratch,
    ) -> Checked<Answer<Vec<[f32; 3]>>> {
        let mut out = unwritten(case);
        let host = Listener::patient();
        let done =
            case.deform_input(|input| self.plugin.code().deform(state, input, scratch, &mut out, &host));
        Ok(match answer("deform", done)? {
            Ok(()) => Ok(written(out)?),
            Err(refusal) => Err(refusal),
        })
    }

    /// Prepares and deforms.
    pub fn run(&self, case: &Case) -> Checked<Answer<(State, Vec<[f32; 3]>)>> {
        let state = match self.prepare(case)? {
            Ok(state) => state,
            Err(refusal) => return Ok(Err(refusal)),
        };
        let positions = self.deform(case, &state, &mut self.scratch()?)?;
        Ok(positions.map(|positions| (state, positions)))
    }

    /// As [`run`](Self::run), of a case that there is no reason to refuse: a refusal ends the rule.
    pub fn run_ordinary(&self, case: &Case) -> Checked<(State, Vec<[f32; 3]>)> {
        self.run(case)?.map_err(PluginRefusal::of_ordinary)
    }

    /// Images of points, which are finite; nothing where the plugin maps the samples alone.
    pub fn evaluate(
        &self,
        case: &Case,
        state: &State,
        mut points: Vec<[f64; 3]>,
    ) -> Checked<Option<Answer<Vec<[f64; 3]>>>> {
        let host = Listener::patient();
        if !self.plugin.capabilities().evaluate {
            return Ok(None);
        }
        let done = case.deform_input(|input| self.plugin.code().evaluate(state, input, &mut points, &host));
        let answer = answer("evaluate", done)?;
        if answer.is_ok()
            && let Some(i) = points.iter().position(|p| !p.iter().all(|x| x.is_finite()))
        {
            return Err(Finding::fail(
                format!("evaluate gives {:?} at point {i} of {}", points[i], points.len()),
                "give finite positions, or return an error",
            ));
        }
        Ok(Some(answer.map(|()| points)))
    }
}

/// A buffer for a deformation.
pub(crate) fn unwritten(case: &Case) -> Vec<[f32; 3]> {
    vec![[UNWRITTEN; 3]; case.positions.len()]
}

/// The positions, where all are written and finite.
fn written(out: Vec<[f32; 3]>) -> Checked<Vec<[f32; 3]>> {
    let is_unwritten = |p: &[f32; 3]| p.iter().any(|x| x.to_bits() == UNWRITTEN.to_bits());
    let is_bad = |p: &[f32; 3]| !is_usable(p.map(f64::from));
    let unwritten = out.iter().filter(|p| is_unwritten(p)).count();
    if unwritten > 0 {
        let first = out.iter().position(is_unwritten).unwrap_or(0);
        return Err(Finding::fail(
            format!(
                "deform leaves {unwritten} of {} positions unwritten, the first at index {first}",
                out.len()
            ),
            "write all of `out`, or return an error",
        ));
    }
    if let Some(first) = out.iter().position(is_bad) {
        let bad = out.iter().filter(|p| is_bad(p)).count();
        return Err(Finding::fail(
            format!(
                "deform gives {bad} of {} positions that are not finite, or too far away, the first at index {first}: {:?}",
                out.len(),
                out[first]
            ),
            "give positions that what follows can work with, or return an error",
        ));
    }
    Ok(out)
}
