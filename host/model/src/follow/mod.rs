//! What turns with the surface besides positions: vectors, normals, quaternions and covariances that are numbers
//! of each vertex, and Gaussian splats (B. Kerbl, G. Kopanas, T. Leimkühler, G. Drettakis, *3D Gaussian
//! Splatting for Real-Time Radiance Field Rendering*, 2023), which are ellipsoids with colours that depend on
//! the direction they are seen from.
//!
//! All follow from the gradient of the deformation at the vertex. The rules are in `turn`, those of splats in
//! `splat` and of their harmonics in `harmonics`; `names` finds the numbers by their names. Where these lie in
//! the file is the format's business.

mod harmonics;
mod names;
mod splat;
mod turn;

use std::collections::BTreeMap;
use std::ops::Range;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Mat3;
use serde::{Deserialize, Serialize};

use crate::Attribute;
use splat::Splat;
use turn::Turn;
pub use turn::{normal, tangent};

/// How declared numbers turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Three numbers v become J·v, with J the gradient of the deformation.
    Vector,
    /// The same, but of the length that it had: a tangent.
    Direction,
    /// Three numbers turn by the cofactors of J, and keep their length.
    Normal,
    /// Four numbers, the real one first, turn by the rotation in J.
    QuaternionWxyz,
    /// The same with the real one last.
    QuaternionXyzw,
    /// Six numbers xx, xy, xz, yy, yz, zz of a symmetric matrix Σ, which becomes J·Σ·Jᵀ.
    Covariance,
}

impl Kind {
    /// All of them, by the names that users give.
    const NAMES: [(&str, Self); 6] = [
        ("vector", Self::Vector),
        ("direction", Self::Direction),
        ("normal", Self::Normal),
        ("quaternion-wxyz", Self::QuaternionWxyz),
        ("quaternion-xyzw", Self::QuaternionXyzw),
        ("covariance", Self::Covariance),
    ];

    /// What users call it.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = || Self::NAMES.map(|(name, _)| name).join(", ");
        let found = Self::NAMES.iter().find(|(name, _)| *name == text);
        found.map(|(_, kind)| *kind).ok_or_else(|| format!("{text:?} is none of {}", known()))
    }
}

/// What becomes of the opacity of splats.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Opacity {
    /// It stays.
    #[default]
    Keep,
    /// A splat that is stretched to twice the area lets as much light through as half of its matter would.
    Conserve,
}

/// What of a model is to turn with the surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Follow {
    /// Numbers by what their names begin with, as `tangent` of `tangent_x`, `tangent_y` and `tangent_z`.
    pub declared: BTreeMap<String, Kind>,
    /// Whether splats are recognised by their properties.
    pub splats: bool,
    /// What becomes of the opacity of splats.
    pub opacity: Opacity,
    /// No splat becomes longer than so many times its second axis, unless it was before.
    pub max_anisotropy: Option<f64>,
}

impl Default for Follow {
    fn default() -> Self {
        Self::SPLATS
    }
}

impl FromStr for Follow {
    type Err = String;

    /// Reads `tangent=vector,q=quaternion-wxyz`, or `none`.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut follow = Self::default();
        if text == "none" {
            follow.splats = false;
            return Ok(follow);
        }
        for part in text.split(',') {
            let (name, kind) = part.split_once('=').ok_or_else(|| {
                format!("{part:?} is not as tangent=vector, a name and how it turns; or give none")
            })?;
            if !Attribute::is_name(name) || follow.declared.insert(name.to_owned(), kind.parse()?).is_some() {
                return Err(format!("{name:?} is no name, or given twice"));
            }
        }
        Ok(follow)
    }
}

/// A group of numbers that turn together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    Declared(Kind),
    Splat(Splat),
}

impl Follow {
    /// Splats alone, which keep their opacity.
    pub const SPLATS: Self =
        Self { declared: BTreeMap::new(), splats: true, opacity: Opacity::Keep, max_anisotropy: None };

    /// The same with other numbers declared, which it may have none of itself.
    pub fn or_declared(mut self, declared: &BTreeMap<String, Kind>) -> Self {
        if self.declared.is_empty() && self.splats {
            self.declared.clone_from(declared);
        }
        self
    }
}

/// What of a model's numbers turns with the surface, once it is open.
#[derive(Debug, Default)]
pub struct Following {
    /// Which attributes they are, group by group.
    places: Vec<usize>,
    groups: Vec<(Rule, Range<usize>)>,
    /// For people, and to tell one from another.
    descriptions: Vec<String>,
    opacity: Opacity,
    max_anisotropy: Option<f64>,
    tally: Tally,
}

/// What became of the splats of all versions.
#[derive(Debug, Default)]
struct Tally {
    /// Those that keep their numbers, as some mean nothing.
    kept: AtomicU64,
    /// Those that were longer than [`NEEDLE`] times their second axis afterwards and not before.
    needles: AtomicU64,
    /// Bits of the largest ratio of any of these.
    longest: AtomicU64,
}

/// From here on a splat is seen as a needle.
const NEEDLE: f64 = 10.0;

impl Following {
    /// Finds what is to follow among the attributes of a model.
    ///
    /// # Errors
    /// What is declared is not there, or is not of floating-point numbers; splats lack a property.
    pub(crate) fn of(follow: &Follow, attributes: &[Attribute]) -> Result<Self, String> {
        let mut following =
            Self { opacity: follow.opacity, max_anisotropy: follow.max_anisotropy, ..Self::default() };
        for (name, kind) in &follow.declared {
            let places = names::declared(name, *kind, attributes)?;
            following.add(Rule::Declared(*kind), places, format!("{name} as {}", kind.name()));
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
            following.add(Rule::Splat(splat), places, format!("{splat}{how}"));
        }
        let mut seen = following.places.clone();
        seen.sort_unstable();
        if let Some(twice) = seen.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(format!("{} would turn in two ways", attributes[twice[0]].name));
        }
        Ok(following)
    }

    fn add(&mut self, rule: Rule, places: Vec<usize>, description: String) {
        let first = self.places.len();
        self.places.extend(places);
        self.groups.push((rule, first..self.places.len()));
        self.descriptions.push(description);
    }

    /// Whether nothing follows.
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// Whether the vertices are splats.
    pub fn has_splats(&self) -> bool {
        self.groups.iter().any(|(rule, _)| matches!(rule, Rule::Splat(_)))
    }

    /// What follows, for people: all that determines what becomes of it.
    pub fn descriptions(&self) -> &[String] {
        &self.descriptions
    }

    /// Which attributes follow: places in a list of these.
    pub(crate) fn places(&self) -> &[usize] {
        &self.places
    }

    /// Turns the numbers of a vertex, which are those of [`places`](Self::places).
    pub(crate) fn turn(&self, gradient: &Mat3, mirrored: bool, numbers: &mut [f64]) {
        if *gradient == Mat3::IDENTITY || !gradient.is_finite() {
            return;
        }
        let turn = Turn::new(gradient.as_dmat3(), mirrored);
        for (rule, range) in &self.groups {
            let numbers = &mut numbers[range.clone()];
            match rule {
                Rule::Declared(kind) => turn.declared(*kind, numbers),
                Rule::Splat(splat) => self.turn_splat(splat, &turn, numbers),
            }
        }
    }

    fn turn_splat(&self, splat: &Splat, turn: &Turn, numbers: &mut [f64]) {
        let Some(ratios) = splat.turn(turn, self.opacity, self.max_anisotropy, numbers) else {
            self.tally.kept.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let [before, after] = ratios;
        if after > NEEDLE && before <= NEEDLE {
            self.tally.needles.fetch_add(1, Ordering::Relaxed);
            // Of positive numbers, the larger ones have the larger bits.
            self.tally.longest.fetch_max(after.to_bits(), Ordering::Relaxed);
        }
    }

    /// What became of splats, where users should know.
    pub(crate) fn notes(&self) -> Vec<String> {
        let Tally { kept, needles, longest } = &self.tally;
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

/// How much longer than wide a round splat becomes under a deformation of this gradient: the ratio of its two
/// largest singular values.
pub fn anisotropy(gradient: &Mat3) -> f32 {
    if *gradient == Mat3::IDENTITY {
        return 1.0;
    }
    let [a, b, _] = turn::sorted(turn::lengths(&turn::orthogonal(&gradient.as_dmat3(), 1e-9).0));
    (a / b) as f32
}

/// A matrix with these columns' images, for tests of several modules.
#[cfg(test)]
fn some_gradient() -> glam::DMat3 {
    glam::DMat3::from_cols_array(&[1.1, 0.2, -0.3, -0.1, 0.8, 0.4, 0.2, -0.5, 1.3])
}
