//! Runs to a tolerance: samples are added where the transfer is expected to be off by more, and deformed by
//! the plugins, until it is nowhere. Samples that the transfer itself placed would tell nothing about it.
//! What samples expect is asked first, as that costs little, and then what is expected of each vertex.

use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use glam::DVec3;
use simod_core::reconstruction::transfer_error::TransferError;
use simod_core::reconstruction::{
    DeformationField, ErrorExcess, ExactSample, ExpectedError, JudgedVertices, Method, RestGeometry, judge,
};
use simod_core::refinement::{Finer, SamplesNeed};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{SampleSet, Target};
use simod_model::{Error, Model, Progress, Result, Scalar};

use crate::deformed_samples::{DeformedSamples, deform};
use crate::edit::Refinements;
use crate::plugins::PluginRegistry;
use crate::refining::{Room, ShapePose};
use crate::shapes::{RegionShape, Shapes};
use crate::step::{Action, Refine, Step};
use simod_plugin_api::Time;

/// The search begins with no fewer samples. First samples stay: those of a few large clusters, at the means
/// of these, are off the surface, and no others could do their work.
const FEWEST: u64 = 1000;

/// Factor by which there are more first samples when a search that its first samples hold up begins anew.
const ANEW: u64 = 4;

/// Rounds of refinement; the number of samples may double in each, or become [`LEAST_ADDED`] more.
const ROUNDS: u64 = 20;
const LEAST_ADDED: u64 = 256;

/// Number of clusters, about, into which each one around the worst place is divided, whatever its size, where
/// nothing is added that the estimate asks for ...
const INTO: f64 = 4.0;
/// ... within so many spacings of the samples there.
const AROUND: f64 = 4.0;

/// Part of the tolerance that a refinement asks for.
const ASKED: f64 = 0.3;

/// Most samples, as a multiple of those at the beginning, or [`FEW`] ...
const MOST: u64 = 64;
/// ... if that is more.
const FEW: u64 = 1 << 20;

/// Part of its least value so far to which the largest expected error has to fall from time to time ...
const FALLS: f64 = 0.9;
/// ... and number of rounds without such a fall after which the search checks whether the deformation can be
/// followed at all. Where few samples are added among sparse ones, the error rises for a while.
const PATIENCE: usize = 7;

/// Number of such rounds after which a search begins anew with more first samples, if it may.
const STALLED: usize = 3;

/// Ratio of the former spacing of samples to the present one beyond which the expected error there has to
/// have fallen by the same ratio at least: where a deformation is smooth the error falls with the third
/// power, and at a step not at all.
const NEARER: f64 = 2.0;

/// The factor by which rounding is more at single vertices than in the mean.
const ROUNDING: f64 = 8.0;

/// Vertices at which the exact map is asked.
const MEASURED: u64 = 1_000_000;

/// Error that the estimates of samples in single precision do not show, in local units, which are at most the
/// diagonal.
const LEAST_LOCAL: f64 = 2e-6;

/// Largest distance that vertices may have from where the exact map takes them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tolerance {
    /// A fraction of the model's diagonal at rest.
    Fraction(f64),
    /// A length in the model's unit.
    Length(f64),
}

impl Tolerance {
    /// The tolerance as a fraction of this diagonal.
    pub fn fraction(self, diagonal: f64) -> f64 {
        match self {
            Self::Fraction(f) => f,
            Self::Length(l) => l / diagonal.max(f64::MIN_POSITIVE),
        }
    }
}

impl FromStr for Tolerance {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (number, of): (&str, fn(f64) -> Self) = match text.strip_suffix('u') {
            Some(number) => (number, Self::Length),
            None => (text, Self::Fraction),
        };
        match number.trim().parse::<f64>() {
            Ok(x) if x.is_finite() && x > 0.0 => Ok(of(x)),
            _ => Err("give a fraction of the diagonal, as 1e-5, or a length in the model's unit, as 0.002u"
                .to_owned()),
        }
    }
}

/// The proof that a tolerance is met. Errors are fractions of the diagonal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// The tolerance.
    pub tolerance: f64,
    /// The largest error that is expected around a sample.
    pub expected: f64,
    /// Expected errors of the vertices, or the true ones where the exact map was asked.
    pub of_vertices: ExpectedError,
    /// Number of samples that were added.
    pub added: u64,
    /// The number of rounds.
    pub rounds: u64,
    /// Number of first samples with which the model was sampled anew, if those before held the search up.
    pub sampled_anew: Option<u64>,
    /// The true error of some vertices, if all plugins know their map.
    pub truth: Option<TransferError>,
}

/// Checks that a file can hold positions with so small errors at all.
///
/// # Errors
/// The file's numbers are too coarse; the error says which tolerance the file can hold.
pub fn check_precision(sampled: &SampledModel, model: &dyn Model, tolerance: f64) -> Result<()> {
    let diagonal = sampled.bounds.diagonal().max(f64::MIN_POSITIVE);
    let refused = |why: String, least: f64| {
        Err(Error::argument(
            format!("the tolerance of {} cannot be met: {why}", length(tolerance, diagonal)),
            format!(
                "give {least:.1e} or more; `simod run --exact` does without samples where all plugins know their map"
            ),
        ))
    };
    if model.info().position_type == Scalar::F32 {
        let largest = sampled.bounds.min.abs().max(sampled.bounds.max.abs());
        let ulp = |x: f64| 2f64.powi(x.max(f64::MIN_POSITIVE).log2().floor() as i32 - 23);
        let rounding = 0.5 * DVec3::from(largest.to_array().map(ulp)).length() / diagonal;
        if 2.0 * rounding > tolerance {
            let why =
                format!("the file's positions are of type float, which alone makes up to {rounding:.1e}");
            return refused(why, 2.0 * rounding);
        }
    }
    let rounding = 0.5 * model.info().step.length() / diagonal;
    if 2.0 * rounding > tolerance {
        let why = format!("the file's positions are integers, which alone makes up to {rounding:.1e}");
        return refused(why, 2.0 * rounding);
    }
    let least = LEAST_LOCAL / sampled.local_diagonal().max(f64::MIN_POSITIVE);
    if least > tolerance {
        return refused(
            format!("samples are in single precision, and tell nothing about less than {least:.1e}"),
            least,
        );
    }
    Ok(())
}

/// Target of the sampling that a search begins with, where `asked` was asked for.
pub(crate) fn beginning(asked: Target) -> Target {
    match asked {
        Target::Samples(samples) => Target::Samples(samples.max(FEWEST)),
        error => error,
    }
}

/// The search for a tolerance of a model, by a session's steps.
pub(crate) struct Sought<'a> {
    /// The model as it is written.
    pub model: &'a dyn Model,
    pub steps: &'a [Step],
    pub plugins: &'a PluginRegistry,
    pub time: Time,
    pub tolerance: f64,
    /// Folder for samples of refinements, and temporary files.
    pub folder: &'a Path,
    pub progress: &'a dyn Progress,
}

impl Sought<'_> {
    /// Deforms samples by the steps, and adds more, which the steps deform as well, until nothing is expected
    /// to be off by more. `sampled` holds its cells. Where the first samples hold this up, `sample` samples
    /// the model anew, with so many; `None` where their number is not to be changed.
    ///
    /// # Errors
    /// The tolerance cannot be met, for a reason that is told; a step cannot be done; the user cancelled.
    pub fn meet(
        &self,
        mut sampled: SampledModel,
        sample: Option<&dyn Fn(u64) -> Result<SampledModel>>,
    ) -> Result<(DeformedSamples, Certificate)> {
        check_precision(&sampled, self.model, self.tolerance)?;
        let mut sampled_anew = None;
        loop {
            let first = match (self.search(sampled, sample.is_some())?, sample) {
                (Ended::Met(met), _) => {
                    let (deformed, certificate) = *met;
                    return Ok((deformed, Certificate { sampled_anew, ..certificate }));
                }
                (Ended::HeldUp { why, first: Some(first) }, Some(sample)) => {
                    self.progress.note(&format!(
                        "sampled anew with {first} samples, as {}",
                        why.to_string().lines().next().unwrap_or_default()
                    ));
                    sampled = sample(first)?;
                    first
                }
                (Ended::HeldUp { why, .. }, _) => return Err(why),
            };
            sampled_anew = Some(first);
        }
    }

    /// Searches with these first samples; another search, with more of them, may follow.
    fn search(&self, sampled: SampledModel, may_begin_anew: bool) -> Result<Ended> {
        let Self { steps, progress, .. } = *self;
        let mut search = ToleranceSearch::new(&sampled, self, may_begin_anew);
        let how = Refinements { folder: self.folder.to_owned(), time: self.time, ..Refinements::default() };
        let again = |sampled: Arc<SampledModel>, steps: &[Step]| {
            deform(sampled, steps, self.plugins, how.clone(), progress)
        };
        let mut deformed = again(sampled.into(), steps)?;
        // The samples that steps have added were placed by the transfer: now the plugins place them.
        let plain: Vec<Step> = steps.iter().filter(|step| !step.refines()).cloned().collect();
        if plain.len() < steps.len() {
            deformed = again(deformed.sampled, &plain)?;
        }
        loop {
            match search.look(&deformed)? {
                Round::Met(certificate) => return Ok(Ended::Met(Box::new((deformed, certificate)))),
                Round::More(refined) => deformed = again(refined, &plain)?,
                Round::HeldUp { why, first } => return Ok(Ended::HeldUp { why, first }),
            }
        }
    }
}

/// Result of a search.
enum Ended {
    /// The tolerance is met.
    Met(Box<(DeformedSamples, Certificate)>),
    /// The tolerance is not met, and the reason; and the number of first samples that may do.
    HeldUp { why: Error, first: Option<u64> },
}

/// The search for samples by which no vertex is expected to be off by more.
struct ToleranceSearch<'a> {
    sought: &'a Sought<'a>,
    /// Whether it may end early for the sake of another one, with more first samples.
    may_begin_anew: bool,
    /// Error that refinements ask for: smaller than the tolerance, as density changes around refined places,
    /// which costs precision there.
    asked: f64,
    /// Samples before, and the most that there may be.
    first: u64,
    most: u64,
    rounds: u64,
    /// Least of the largest errors that were expected, and (`waited`) the number of rounds since then.
    least: f64,
    waited: usize,
    beginning: Option<UnrefinedState>,
}

/// Result of a round of the search.
enum Round {
    /// The tolerance is met.
    Met(Certificate),
    /// More samples, which are to be deformed.
    More(Arc<SampledModel>),
    /// No more samples help, and the reason; and the number of first samples that may do.
    HeldUp { why: Error, first: Option<u64> },
}

impl<'a> ToleranceSearch<'a> {
    fn new(sampled: &SampledModel, sought: &'a Sought<'a>, may_begin_anew: bool) -> Self {
        let first = sampled.samples.len() as u64;
        let of_diagonal = sampled.local_diagonal().max(f64::MIN_POSITIVE);
        Self {
            sought,
            may_begin_anew,
            asked: (ASKED * sought.tolerance).max(LEAST_LOCAL / of_diagonal),
            first,
            most: (MOST * first).max(FEW).min(sampled.source.vertices),
            rounds: 0,
            least: f64::INFINITY,
            waited: 0,
            beginning: None,
        }
    }

    /// Looks how far vertices are expected to be off, and adds samples there if that is too far.
    fn look(&mut self, deformed: &DeformedSamples) -> Result<Round> {
        let of = &deformed.sampled;
        let Sought { model, tolerance, progress, .. } = *self.sought;
        progress.begin("estimating the error", 0);
        let around = RestGeometry::new(&of.samples);
        let mut field = DeformationField::from_deformed(&around, &deformed.positions, Method::default())
            .expecting(&of.frame, model.info());
        self.beginning.get_or_insert_with(|| UnrefinedState::new(of, &field));
        if deformed.stack.can_evaluate() {
            field = field.expecting_at_vertices(of)?;
        }
        let beyond = match field.expected_beyond(of, tolerance) {
            Some(beyond) => beyond,
            None => {
                field = field.expecting_of_vertices();
                let judged = self.judged(deformed, &field)?;
                if judged.beyond == 0 {
                    return Ok(Round::Met(self.certificate(of, &field, &judged)));
                }
                // What samples expect was too little there.
                field.learn(of, &judged, tolerance).ok_or_else(|| {
                    not_met(of, [tolerance; 2], "single vertices are off by a little more", None)
                })?
            }
        };
        if let Some(why) = self.why_ended(of, &field, &beyond) {
            return Ok(self.held_up(of, &why, &beyond));
        }
        if self.may_begin_anew && self.waited >= STALLED && self.first_anew(of, &beyond).is_some() {
            let why = format!("{STALLED} rounds of refinement have not lessened it");
            return Ok(self.held_up(of, &why, &beyond));
        }
        match self.refine(of, &field, &beyond)? {
            Some(refined) => Ok(Round::More(refined)),
            None => {
                let told = self.told_of_first(of, &beyond);
                let rim = at_rim(self.sought.steps, of, beyond.place);
                let none_left = || format!("{}{rim}{told}", SamplesNeed::NONE_LEFT);
                let why = self.why_not(of, &field, &beyond).unwrap_or_else(none_left);
                Ok(self.held_up(of, &why, &beyond))
            }
        }
    }

    /// The end of a search that has not met the tolerance.
    fn held_up(&self, of: &SampledModel, why: &str, beyond: &ErrorExcess) -> Round {
        let why = not_met(of, [self.sought.tolerance, beyond.worst], why, Some(beyond));
        Round::HeldUp { why, first: self.first_anew(of, beyond) }
    }

    /// Number of first samples that may meet the tolerance where these have not: more than these, as long as
    /// the search had as many in the end, where the worst is around one of the first, or where parts of the
    /// model touch, as refinement goes by which of the first samples are on whose sheet.
    fn first_anew(&self, of: &SampledModel, beyond: &ErrorExcess) -> Option<u64> {
        let nearest = of.samples.nearest(of.frame.to_local(beyond.place)) as usize;
        let near = of.samples.neighbours().nearest_to(nearest).iter().map(|i| *i as usize);
        let touches = || {
            let contacts = of.samples.contacts()?;
            near.chain([nearest]).find(|i| contacts.same_sheet(*i).is_some())
        };
        let first = ANEW * self.first;
        let rounds_off = ROUNDING * beyond.rounding > beyond.worst;
        let helps = (nearest as u64) < self.first || touches().is_some();
        // A bend at a region's rim is as sharp for any samples.
        let is_bend = step_with_rim(self.sought.steps, of, beyond.place).is_some();
        (helps && !rounds_off && !is_bend && first <= of.samples.len() as u64).then_some(first)
    }

    /// Judges each vertex, and asks the exact map if it is known.
    fn judged(&self, deformed: &DeformedSamples, field: &DeformationField<'_>) -> Result<JudgedVertices> {
        let Sought { model, tolerance, progress, .. } = *self.sought;
        let map = |points: &mut [DVec3]| deformed.stack.evaluate_with(points, progress);
        let exact = deformed.stack.can_evaluate().then_some(ExactSample { most: MEASURED, map: &map });
        judge(model, field, &deformed.sampled, tolerance, exact, progress)
    }

    fn certificate(
        &self,
        of: &SampledModel,
        field: &DeformationField<'_>,
        judged: &JudgedVertices,
    ) -> Certificate {
        let expected = field.expected_beyond(of, 0.0).map_or(0.0, |all| all.worst);
        let added = of.samples.len() as u64 - self.first;
        let (tolerance, rounds) = (self.sought.tolerance, self.rounds);
        let JudgedVertices { expected: of_vertices, truth, .. } = *judged;
        Certificate { tolerance, expected, of_vertices, added, rounds, sampled_anew: None, truth }
    }

    /// Reason for which more samples would not help, if they would not.
    fn why_not(
        &self,
        of: &SampledModel,
        field: &DeformationField<'_>,
        beyond: &ErrorExcess,
    ) -> Option<String> {
        self.beginning.as_ref()?.why_not(of, field, beyond, self.sought.steps)
    }

    /// Text that is told, besides, where the worst is around a sample of those at the beginning: these stay,
    /// and stand for as many vertices as they did.
    fn told_of_first(&self, of: &SampledModel, beyond: &ErrorExcess) -> &'static str {
        let nearest = of.samples.nearest(of.frame.to_local(beyond.place));
        if u64::from(nearest) >= self.first {
            return "";
        }
        "; the worst is around one of the first samples, which stay where the means of their vertices are, off the surface \
         where these are many"
    }

    /// Reason for which the search ends, if it has come to its limits, or no further for a while.
    fn why_ended(
        &mut self,
        of: &SampledModel,
        field: &DeformationField<'_>,
        beyond: &ErrorExcess,
    ) -> Option<String> {
        self.waited += 1;
        if beyond.worst < FALLS * self.least {
            (self.least, self.waited) = (beyond.worst, 0);
        }
        let (samples, most) = (of.samples.len() as u64, self.most);
        let limit = if self.rounds == ROUNDS {
            Some(format!("{ROUNDS} rounds of refinement have not been enough"))
        } else if samples >= most {
            Some(format!("it has {samples} samples by now, and {most} are the most"))
        } else {
            None
        };
        let limit = limit.map(|limit| limit + self.told_of_first(of, beyond));
        let asks = limit.is_some() || self.waited >= PATIENCE;
        asks.then(|| self.why_not(of, field, beyond).or(limit)).flatten()
    }

    /// Adds samples where more is expected than is allowed; `None` if there are none to add.
    fn refine(
        &mut self,
        of: &SampledModel,
        field: &DeformationField<'_>,
        beyond: &ErrorExcess,
    ) -> Result<Option<Arc<SampledModel>>> {
        let Sought { model, folder, progress, .. } = *self.sought;
        let samples = of.samples.len() as u64;
        let added = (self.most - samples).min(samples.max(LEAST_ADDED));
        let finer = Finer::Auto { error: self.asked, samples: Some(added) };
        let everywhere = Refine { shapes: Shapes::default(), finer };
        let refine = |how: &Refine| {
            let room = Room { memory_limit: None, folder };
            how.refine(of, model, ShapePose::Rest(Some(field)), room, progress)
        };
        let mut done = refine(&everywhere)?;
        if done.sampled.is_none() {
            done = refine(&around_worst(of, beyond))?;
        }
        let Some(refined) = done.sampled else { return Ok(None) };
        progress.note(&format!(
            "up to {} are expected: {} samples more are deformed",
            length(beyond.worst, of.bounds.diagonal()),
            done.added
        ));
        self.rounds += 1;
        Ok(Some(refined.into()))
    }
}

/// Refinement around the place where the largest error is expected, whatever the clusters' errors.
fn around_worst(of: &SampledModel, beyond: &ErrorExcess) -> Refine {
    let nearest = of.samples.nearest(of.frame.to_local(beyond.place)) as usize;
    let spacing = f64::from(of.samples.spacing()[nearest]) * of.frame.scale;
    let ball = RegionShape::Sphere { center: beyond.place, radius: AROUND * spacing };
    Refine { shapes: Shapes { shapes: vec![ball], falloff: 0.0 }, finer: Finer::Factor(INTO) }
}

/// Expected errors before samples were added.
///
/// Memory: P_S as it was.
struct UnrefinedState {
    sampled: Arc<SampledModel>,
    /// Expected error around each sample; local units.
    expected: Vec<f32>,
}

impl UnrefinedState {
    fn new(sampled: &Arc<SampledModel>, field: &DeformationField<'_>) -> Self {
        Self { sampled: sampled.clone(), expected: field.expected_error() }
    }

    /// Reason, other than a want of vertices, for which more samples would not help where the largest error
    /// is expected.
    fn why_not(
        &self,
        now: &SampledModel,
        field: &DeformationField<'_>,
        beyond: &ErrorExcess,
        steps: &[Step],
    ) -> Option<String> {
        let ErrorExcess { worst, rounding, place, .. } = *beyond;
        if !worst.is_finite() {
            return Some("numbers of single precision overflow there: it moves samples too far".to_owned());
        }
        if ROUNDING * rounding > worst {
            return Some(format!("rounding to floats alone makes about {rounding:.1e} where it goes"));
        }
        let at = now.frame.to_local(place);
        let nearest = |samples: &SampleSet| samples.nearest(at) as usize;
        let spacing = |samples: &SampleSet| f64::from(samples.spacing()[nearest(samples)]);
        let nearer = spacing(&self.sampled.samples) / spacing(&now.samples);
        let first = nearest(&self.sampled.samples);
        let around =
            self.sampled.samples.neighbours().nearest_to(first).iter().map(|i| *i as usize).chain([first]);
        let before = around.map(|i| f64::from(self.expected[i])).fold(0.0, f64::max);
        let disagree = f64::from(field.disagreement(at));
        (nearer > NEARER && before < nearer * disagree).then(|| {
            let [before, disagree] = [before, disagree].map(|x| x / now.local_diagonal());
            let rim = at_rim(steps, now, place);
            format!(
                "the deformation has a step there, or bends sharply{rim}, or has details of the size of the vertices' \
                 spacing, as samples {nearer:.1} times as near to each other disagree by {disagree:.1e}, and {before:.1e} \
                 at first"
            )
        })
    }
}

/// Words for the rim of a region, if one is near to a place of the model at rest.
fn at_rim(steps: &[Step], of: &SampledModel, place: DVec3) -> String {
    step_with_rim(steps, of, place)
        .map_or_else(String::new, |step| format!(" at the rim of a region of the step {step}"))
}

/// Name of the first step's tool, if the rim of one of its regions is near to a place of the model at rest:
/// to either side of it a deformation need not bend alike.
fn step_with_rim<'s>(steps: &'s [Step], of: &SampledModel, place: DVec3) -> Option<&'s str> {
    let nearest = of.samples.nearest(of.frame.to_local(place)) as usize;
    let near = AROUND * f64::from(of.samples.spacing()[nearest]) * of.frame.scale;
    let first = steps.iter().filter(|step| step.enabled).find_map(|step| match &step.action {
        Action::Deform(deformation) => Some(deformation),
        Action::Refine(_) => None,
    })?;
    let is_near = |shapes: &Shapes| shapes.signed_distance(place).abs() < near;
    first.regions.iter().any(|region| is_near(&region.shapes)).then_some(&first.deform)
}

/// A length for people: as a fraction of the model's diagonal, and in its unit.
fn length(fraction: f64, diagonal: f64) -> String {
    format!("{fraction:.1e} of the diagonal ({:.1e} in the model's unit)", fraction * diagonal)
}

/// An error where as much as `left` is expected in place of the tolerance.
fn not_met(of: &SampledModel, [tolerance, left]: [f64; 2], why: &str, beyond: Option<&ErrorExcess>) -> Error {
    let diagonal = of.bounds.diagonal();
    let place = beyond.map_or_else(String::new, |b| {
        format!(" near ({:.6}, {:.6}, {:.6})", b.place.x, b.place.y, b.place.z)
    });
    Error::argument(
        format!(
            "the tolerance of {} is not met{place}, where {} is expected: {why}",
            length(tolerance, diagonal),
            length(left, diagonal)
        ),
        "nothing was written; give a larger tolerance, sample the model more finely, or make the deformation smoother there",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_fractions_or_lengths() {
        let read = |text: &str| text.parse::<Tolerance>();
        assert_eq!(read("1e-5"), Ok(Tolerance::Fraction(1e-5)));
        assert_eq!(read("0.25u"), Ok(Tolerance::Length(0.25)));
        assert_eq!(read("0.25 u"), Ok(Tolerance::Length(0.25)));
        for bad in ["", "u", "-1e-5", "0", "nan", "inf", "1e-5m", "1e-5uu"] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert_eq!(Tolerance::Length(0.5).fraction(100.0), 0.005);
        assert_eq!(Tolerance::Fraction(0.5).fraction(100.0), 0.5);
    }
}
