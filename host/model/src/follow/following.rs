//! The numbers of a model that turn with the surface.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Mat3;

use super::names;
use super::rules::{Follow, Opacity, TensorKind};
use super::splat::SplatNumbers;
use super::turn::VertexTurn;
use crate::{Attribute, Error, Progress, Result};

/// A group of numbers that turn together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FollowRule {
    Declared(TensorKind),
    Splat(SplatNumbers),
}

/// Attributes of an opened model that turn with the surface.
#[derive(Debug, Default)]
pub struct Following {
    /// The places of the attributes that follow, group by group.
    places: Vec<usize>,
    groups: Vec<(FollowRule, Range<usize>)>,
    /// Descriptions of the attributes, for people, and to tell one set of rules from another.
    descriptions: Vec<String>,
    opacity: Opacity,
    max_anisotropy: Option<f64>,
    /// Reason for which the attributes that turn are unknown, if they are.
    misfit: Option<String>,
    tally: SplatTally,
}

/// Counts of the splats of all versions that were treated specially.
#[derive(Debug, Default)]
struct SplatTally {
    /// Number of splats that keep their numbers, as some are meaningless.
    kept: AtomicU64,
    /// Number of splats that were longer than [`NEEDLE`] times their second axis afterwards and not before.
    needles: AtomicU64,
    /// Bits of the largest ratio of the axes of any of these.
    longest: AtomicU64,
}

/// Ratio of the axes from which on a splat is seen as a needle.
const NEEDLE: f64 = 10.0;

impl Following {
    /// Finds the attributes that turn without being declared: those of splats, told by their properties.
    /// Where splats lack a property, no attribute turns, and [`check`](Self::check) says so.
    pub(crate) fn recognised(attributes: &[Attribute]) -> Self {
        let found = Self::find(&Follow::default(), attributes);
        found.unwrap_or_else(|why| Self { misfit: Some(why), ..Self::default() })
    }

    /// Finds the attributes that turn in the model in `file`: declared ones, and those of splats.
    ///
    /// # Errors
    /// A declared attribute is missing, or not of floating-point numbers; splats lack a property.
    pub(crate) fn declared(follow: &Follow, attributes: &[Attribute], file: &Path) -> Result<Self> {
        Self::find(follow, attributes).map_err(|why| misfit(&why, file))
    }

    /// Checks that the attributes that turn are known.
    pub(crate) fn check(&self, file: &Path) -> Result<()> {
        self.misfit.as_ref().map_or(Ok(()), |why| Err(misfit(why, file)))
    }

    fn find(follow: &Follow, attributes: &[Attribute]) -> Result<Self, String> {
        let mut following =
            Self { opacity: follow.opacity, max_anisotropy: follow.max_anisotropy, ..Self::default() };
        for (name, kind) in &follow.declared {
            let places = names::declared(name, *kind, attributes)?;
            following.add(FollowRule::Declared(*kind), places, format!("{name} as {}", kind.name()));
        }
        if follow.splats
            && let Some((splat, places)) = names::splat(attributes)?
        {
            let (opacity, most) = (following.opacity, following.max_anisotropy);
            let how = match (opacity, most) {
                (Opacity::Keep, None) => String::new(),
                (Opacity::Conserve, None) => ", opacity conserved".to_owned(),
                (Opacity::Keep, Some(most)) => format!(", at most {most} times as long as wide"),
                (Opacity::Conserve, Some(most)) => {
                    format!(", opacity conserved, at most {most} times as long as wide")
                }
            };
            following.add(FollowRule::Splat(splat), places, format!("{splat}{how}"));
        }
        let mut seen = following.places.clone();
        seen.sort_unstable();
        if let Some(twice) = seen.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(format!("{} would turn in two ways", attributes[twice[0]].name));
        }
        Ok(following)
    }

    fn add(&mut self, rule: FollowRule, places: Vec<usize>, description: String) {
        let first = self.places.len();
        self.places.extend(places);
        self.groups.push((rule, first..self.places.len()));
        self.descriptions.push(description);
    }

    /// Whether no attribute turns.
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// Whether the vertices are splats.
    pub fn has_splats(&self) -> bool {
        self.groups.iter().any(|(rule, _)| matches!(rule, FollowRule::Splat(_)))
    }

    /// Descriptions of the attributes that turn, for people: with all that determines their new numbers.
    pub fn descriptions(&self) -> &[String] {
        &self.descriptions
    }

    /// The attributes that follow: their places in a list of attributes.
    pub(crate) fn places(&self) -> &[usize] {
        &self.places
    }

    /// The ranges of [`places`](Self::places) whose attributes turn together.
    pub(crate) fn groups(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.groups.iter().map(|(_, range)| range.clone())
    }

    /// Turns the numbers of a vertex, which are those of [`places`](Self::places).
    pub(crate) fn turn(&self, gradient: &Mat3, mirrored: bool, numbers: &mut [f64]) {
        if *gradient == Mat3::IDENTITY || !gradient.is_finite() {
            return;
        }
        let turn = VertexTurn::new(gradient.as_dmat3(), mirrored);
        for (rule, range) in &self.groups {
            let numbers = &mut numbers[range.clone()];
            match rule {
                FollowRule::Declared(kind) => turn.declared(*kind, numbers),
                FollowRule::Splat(splat) => self.turn_splat(splat, &turn, numbers),
            }
        }
    }

    fn turn_splat(&self, splat: &SplatNumbers, turn: &VertexTurn, numbers: &mut [f64]) {
        let Some(ratios) = splat.turn(turn, self.opacity, self.max_anisotropy, numbers) else {
            self.tally.kept.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let [before, after] = ratios;
        if after > NEEDLE && before <= NEEDLE {
            self.tally.needles.fetch_add(1, Ordering::Relaxed);
            // Bits of positive numbers are in the order of the numbers.
            self.tally.longest.fetch_max(after.to_bits(), Ordering::Relaxed);
        }
    }

    /// Notes what users should know of the splats of a file, which may keep their numbers or become needles.
    pub(crate) fn tell(&self, file: &Path, progress: &dyn Progress) {
        self.notes().iter().for_each(|note| progress.note(&format!("{}: {note}", file.display())));
    }

    /// Notes on the splats, which are counted anew after this call.
    fn notes(&self) -> Vec<String> {
        let SplatTally { kept, needles, longest } = &self.tally;
        let [kept, needles, longest] = [kept, needles, longest].map(|n| n.swap(0, Ordering::Relaxed));
        let mut notes = Vec::new();
        if kept > 0 {
            notes.push(format!(
                "{kept} splats keep their shape and colours: a quaternion of no length, or a scale that is not finite"
            ));
        }
        if needles > 0 {
            notes.push(format!(
                "{needles} splats became more than {NEEDLE} times as long as wide, up to {:.1} times; \
                 --max-anisotropy {NEEDLE} keeps them shorter",
                f64::from_bits(longest)
            ));
        }
        notes
    }
}

/// Error of attributes that cannot turn, for the reason `why`.
fn misfit(why: &str, file: &Path) -> Error {
    let hint = "correct the file or the names, or give --follow none: all but positions and normals keep their bytes then";
    Error::argument(format!("{}: {why}", file.display()), hint)
}
