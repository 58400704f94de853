//! The rules by which users ask for numbers to turn with the surface.

use std::collections::BTreeMap;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::Attribute;

/// The way in which declared numbers turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TensorKind {
    /// Three numbers v become J·v, with J the gradient of the deformation.
    Vector,
    /// Three numbers turn by J, and keep their length: a tangent.
    Direction,
    /// Three numbers turn by the cofactors of J, and keep their length.
    Normal,
    /// Four numbers, the real one first, turn by the rotation in J.
    QuaternionWxyz,
    /// Four numbers, the real one last, turn by the rotation in J.
    QuaternionXyzw,
    /// Six numbers xx, xy, xz, yy, yz, zz of a symmetric matrix Σ, which becomes J·Σ·Jᵀ.
    Covariance,
}

impl TensorKind {
    /// Names of all kinds, as users give them.
    const NAMES: [(&str, Self); 6] = [
        ("vector", Self::Vector),
        ("direction", Self::Direction),
        ("normal", Self::Normal),
        ("quaternion-wxyz", Self::QuaternionWxyz),
        ("quaternion-xyzw", Self::QuaternionXyzw),
        ("covariance", Self::Covariance),
    ];

    /// Name of the kind, as users give it.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }
}

impl FromStr for TensorKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = || Self::NAMES.map(|(name, _)| name).join(", ");
        let found = Self::NAMES.iter().find(|(name, _)| *name == text);
        found.map(|(_, kind)| *kind).ok_or_else(|| format!("{text:?} is none of {}", known()))
    }
}

/// Rule for the opacity of splats.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Opacity {
    /// The opacity stays.
    #[default]
    Keep,
    /// Matter is conserved: a splat that is stretched to twice the area lets as much light through as half of
    /// its matter would.
    Conserve,
}

/// Rules for the attributes of a model that turn with the surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Follow {
    /// Kinds of declared numbers by the beginning of their names, as `tangent` of `tangent_x`, `tangent_y`
    /// and `tangent_z`.
    pub declared: BTreeMap<String, TensorKind>,
    /// Whether splats are recognised by their properties.
    pub splats: bool,
    /// Rule for the opacity of splats.
    pub opacity: Opacity,
    /// Longest axis that a splat may get, in lengths of its second axis, unless it was longer before.
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

impl Follow {
    /// Rules by which splats alone turn, and keep their opacity.
    pub const SPLATS: Self =
        Self { declared: BTreeMap::new(), splats: true, opacity: Opacity::Keep, max_anisotropy: None };

    /// Rules with `declared` as their declarations, if they declare nothing and recognise splats; else the
    /// rules as they are.
    pub fn or_declared(mut self, declared: &BTreeMap<String, TensorKind>) -> Self {
        if self.declared.is_empty() && self.splats {
            self.declared.clone_from(declared);
        }
        self
    }
}
