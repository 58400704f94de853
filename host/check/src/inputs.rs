//! Rules on unusual input: a plugin gives finite positions, or an error that says why not.

use crate::answer::{Answer, Listener};
use crate::case::Case;
use crate::finding::{Checked, Finding};
use crate::subject::{Subject, unwritten};
use glam::Vec3;
use simod_plugin_api::{ErrorCode, State};
use simod_session::deformer::line;

/// Samples of a large case: as many as the interactive tools are made for.
pub(crate) const LARGE: usize = 200_000;

/// Samples of an ordinary case.
pub(crate) const ORDINARY: usize = 2000;

/// Samples where a rule tries many cases.
pub(crate) const FEW: usize = 500;

/// Distance of samples that lie far outside, in units of the diagonal.
const FAR: f32 = 1e6;

pub(crate) fn one_sample(subject: &Subject) -> Checked<Finding> {
    points(subject, vec![Vec3::new(0.1, 0.2, 0.3)])
}

pub(crate) fn two_samples(subject: &Subject) -> Checked<Finding> {
    points(subject, vec![Vec3::new(-0.5, 0.0, 0.2), Vec3::new(0.5, 0.7, -0.1)])
}

pub(crate) fn coincident(subject: &Subject) -> Checked<Finding> {
    points(subject, vec![Vec3::new(0.1, 0.2, 0.3); 100])
}

pub(crate) fn collinear(subject: &Subject) -> Checked<Finding> {
    let at = |i: u8| Vec3::new(-0.4, -0.5, -0.3).lerp(Vec3::new(0.4, 0.5, 0.3), f32::from(i) / 99.0);
    points(subject, (0..100).map(at).collect())
}

pub(crate) fn flat(subject: &Subject) -> Checked<Finding> {
    let at = |i: u16| Vec3::new(f32::from(i / 20) / 19.0 - 0.5, f32::from(i % 20) / 19.0 - 0.5, 0.0);
    points(subject, (0..400).map(at).collect())
}

/// A large number of samples is not refused: a plugin that refuses such an ordinary input is of little use.
pub(crate) fn large(subject: &Subject) -> Checked<Finding> {
    Ok(match subject.run(&Case::bumpy_sphere(&subject.plugin, LARGE)?)? {
        Ok(_) => Finding::pass("finite"),
        Err(refusal) => Finding::warn(
            format!("it refuses: {}", refusal.0),
            "a closed surface of 200 000 samples, with default parameters, should be no problem",
        ),
    })
}

/// Coordinates are huge, as after layers that sent the samples away: the box is that of the model at rest.
pub(crate) fn huge_coordinates(subject: &Subject) -> Checked<Finding> {
    let mut case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let away = FAR * case.bounds.diagonal() as f32;
    case.positions.iter_mut().flatten().for_each(|x| *x += away);
    survives(subject, &case)
}

pub(crate) fn regions_empty(subject: &Subject) -> Checked<Finding> {
    let mut case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    if case.regions.is_empty() {
        return Ok(Finding::skip("it uses no regions"));
    }
    case.regions.iter_mut().for_each(|(_, weights)| weights.fill(0.0));
    survives(subject, &case)
}

/// All regions hold the same samples: fixed and moved at once, or moved in several ways.
pub(crate) fn regions_contradictory(subject: &Subject) -> Checked<Finding> {
    let mut case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    let Some((_, weights)) = case.regions.first().cloned() else {
        return Ok(Finding::skip("it uses no regions"));
    };
    case.regions.iter_mut().for_each(|(_, w)| w.clone_from(&weights));
    if case.regions.len() == 1 {
        case.regions.push(case.regions[0].clone());
        // Motions that are the same would be no contradiction.
        case.transforms.extend(case.transforms.first().map(|t| {
            let mut other = *t;
            other.rows.iter_mut().for_each(|row| row[3] += 0.1);
            other
        }));
    }
    survives(subject, &case)
}

/// A case without any sample harms nothing. No host gives such input, and no plugin has to expect it.
pub(crate) fn no_samples(subject: &Subject) -> Checked<Finding> {
    let case = Case::new(&subject.plugin, vec![Vec3::ZERO, Vec3::ONE], Vec::new())?.without_samples();
    tolerates(subject, &case)
}

/// A case with a position that is not a number harms nothing. No host gives such input, either.
pub(crate) fn not_a_number(subject: &Subject) -> Checked<Finding> {
    let mut case = Case::bumpy_sphere(&subject.plugin, ORDINARY)?;
    case.positions[ORDINARY / 3] = [f32::NAN, f32::INFINITY, 0.0];
    tolerates(subject, &case)
}

/// Checks that the plugin comes back from input that it was promised not to get; its result does not
/// matter.
fn tolerates(subject: &Subject, case: &Case) -> Checked<Finding> {
    let (code, host) = (subject.plugin.code(), Listener::patient());
    let run = || {
        let state = case.prepare_input(|input| code.prepare(input, &host))?;
        let (mut scratch, mut out) = (code.new_scratch()?, unwritten(case));
        case.deform_input(|input| code.deform(&state, input, &mut scratch, &mut out, &host))
    };
    Ok(match run() {
        Ok(()) => Finding::pass("it goes on"),
        Err(error) if error.code == ErrorCode::PANICKED => Finding::warn(
            format!("it {}", line(&error.message)),
            "this program gives finite samples, and at least one; an error would tell more where another one does not",
        ),
        Err(error) => Finding::pass(format!("it refuses: {}", line(&error.message))),
    })
}

fn points(subject: &Subject, positions: Vec<Vec3>) -> Checked<Finding> {
    survives(subject, &Case::new(&subject.plugin, positions, Vec::new())?)
}

fn survives(subject: &Subject, case: &Case) -> Checked<Finding> {
    Ok(Finding::pass(match all_calls(subject, case)? {
        Ok(()) => "finite".to_owned(),
        Err(refusal) => format!("it refuses: {}", refusal.0),
    }))
}

/// Prepares, deforms, and evaluates at the samples, where the plugin can evaluate: the answer is finite
/// positions or a polite error.
pub(crate) fn all_calls(subject: &Subject, case: &Case) -> Checked<Answer<()>> {
    match subject.prepare(case)? {
        Ok(state) => calls_with(subject, case, &state),
        Err(refusal) => Ok(Err(refusal)),
    }
}

/// Calls a plugin's functions on a case with a state that was prepared before.
pub(crate) fn calls_with(subject: &Subject, case: &Case, state: &State) -> Checked<Answer<()>> {
    if let Err(refusal) = subject.deform(case, state, &mut subject.scratch()?)? {
        return Ok(Err(refusal));
    }
    let points = case.positions.iter().map(|p| p.map(f64::from)).collect();
    Ok(subject.evaluate(case, state, points)?.unwrap_or(Ok(Vec::new())).map(drop))
}
