//! The brushes, and the displacement of samples by each.
//!
//! The brushes are those of today's sculpting programs: each has a target for every sample under it, and
//! the sample goes towards it by as much as it feels of the brush.

use crate::path::Symmetry;
use glam::{BVec3, DVec3};
use simod_plugin_api::{Curve, ParamDesc, Params, PluginError, PluginResult, Stroke, Unit};

/// Kind of a brush.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Brush {
    /// Moves samples along their own normals: details puff up, where drawing carries them along.
    Inflate,
    /// Moves samples along the mean normal.
    Draw,
    /// Moves the samples under the stroke's start along with the stroke.
    Grab,
    /// Lowers the curvature.
    Smooth,
    /// Moves samples towards their mean plane.
    Flatten,
    /// Moves samples along the surface towards the stroke.
    Pinch,
    /// Draws, and pinches.
    Crease,
}

/// Part of the distance to the stroke by which a full stroke pinches.
const PINCH: f64 = 0.5;

/// Greatest part of that distance, whatever the strength: samples never go beyond the stroke.
const MOST_PINCH: f64 = 0.9;

/// A brush as it was set for a stroke.
pub struct SetBrush<'a> {
    /// Kind of the brush.
    pub brush: Brush,
    /// Radius in local coordinates.
    pub radius: f64,
    /// Strength: 1 is full; negative ones do the opposite.
    pub strength: f64,
    /// Distance between dabs, in radii.
    pub spacing: f64,
    /// Whether a stroke that crosses itself adds up.
    pub accumulate: bool,
    /// Mirrors of the stroke.
    pub symmetry: Symmetry,
    /// Height by which a full stroke draws or inflates, in local coordinates.
    depth: f64,
    falloff: Curve<'a>,
}

impl<'a> SetBrush<'a> {
    /// The tool of a stroke.
    pub fn from_stroke(stroke: &Stroke<'a>) -> PluginResult<Self> {
        let params: Params<'a> = stroke.params();
        let brush = match params.choice("brush")? {
            "inflate" => Brush::Inflate,
            "draw" => Brush::Draw,
            "grab" => Brush::Grab,
            "smooth" => Brush::Smooth,
            "flatten" => Brush::Flatten,
            "pinch" => Brush::Pinch,
            "crease" => Brush::Crease,
            other => return Err(PluginError::parameter("brush", &format!("is unknown: {other}"))),
        };
        let axis = |id| params.bool(id);
        let axes = BVec3::new(axis("symmetry-x")?, axis("symmetry-y")?, axis("symmetry-z")?);
        Ok(Self {
            brush,
            radius: stroke.radius,
            strength: stroke.strength,
            spacing: params.float("spacing")?,
            accumulate: params.bool("accumulate")?,
            symmetry: Symmetry { center: params.vec3("symmetry-center")?.into(), axes },
            depth: params.float("depth")? * stroke.radius,
            falloff: params.curve("falloff")?,
        })
    }

    /// Parameters of a brush.
    pub fn params() -> Vec<ParamDesc> {
        let brushes = [
            ("inflate", "Inflate"),
            ("draw", "Draw"),
            ("grab", "Grab"),
            ("smooth", "Smooth"),
            ("flatten", "Flatten"),
            ("pinch", "Pinch"),
            ("crease", "Crease"),
        ];
        let mirror = |id, name, hint| ParamDesc::bool(id, name, false).hint(hint).group("Symmetry");
        vec![
            ParamDesc::choice("brush", "Brush", "inflate", &brushes)
                .hint("Effect of strokes; negative strengths do the opposite, which smooth has not"),
            ParamDesc::float("depth", "Depth", 0.2).hard(0.0, 4.0).soft(0.0, 1.0).hint(
                "Distance by which a full stroke of inflate, draw or crease moves the surface, in radii",
            ),
            ParamDesc::curve("falloff", "Falloff", &[[0.0, 1.0], [1.0, 0.0]])
                .hint("Strength of the brush from its middle (left) to its rim (right)"),
            ParamDesc::float("spacing", "Spacing", 0.2)
                .hard(0.01, 1.0)
                .soft(0.05, 0.5)
                .hint("Distance between dabs along the stroke, in radii"),
            ParamDesc::bool("accumulate", "Accumulate", false)
                .hint("Adds up where a stroke crosses itself; smooth and flatten always do"),
            mirror("symmetry-x", "Mirror x", "Paints the mirror image across x as well"),
            mirror("symmetry-y", "Mirror y", "Paints the mirror image across y as well"),
            mirror("symmetry-z", "Mirror z", "Paints the mirror image across z as well"),
            ParamDesc::point("symmetry-center", "Mirror centre", [0.5; 3])
                .unit(Unit::MODEL_LENGTH)
                .hint("Point on all mirrors")
                .group("Symmetry"),
        ]
    }

    /// Whether a stroke acts on the surface as it was when the stroke began, by the greatest weight that
    /// any part of the stroke has for a sample.
    pub fn sweeps(&self) -> bool {
        !self.accumulate && matches!(self.brush, Brush::Inflate | Brush::Draw | Brush::Pinch | Brush::Crease)
    }

    /// Weight at a distance of 0 to 1 radii. A crease is sharper than the other brushes.
    pub fn falloff(&self, t: f64) -> f64 {
        let f = self.falloff.at(t);
        if self.brush == Brush::Crease { f * f } else { f }
    }

    /// Contribution of a dab to the middle of a long straight stroke, as a part of the whole: the length of
    /// path that the dab stands for, over the integral of the falloff.
    pub fn exposure(&self) -> f64 {
        /// Intervals of Simpson's rule.
        const INTERVALS: u32 = 64;
        let at = |i: u32| self.falloff(f64::from(i) / f64::from(INTERVALS));
        let inner: f64 = (1..INTERVALS).map(|i| if i % 2 == 1 { 4.0 * at(i) } else { 2.0 * at(i) }).sum();
        let mean = (at(0) + inner + at(INTERVALS)) / (3.0 * f64::from(INTERVALS));
        // A brush of next to no width still has dabs.
        self.spacing / (2.0 * mean).max(self.spacing)
    }

    /// Displacement of a sample that feels all of the brush. `under` has the vectors from the sample to the
    /// stroke and the mean plane, and the stroke's motion.
    pub fn displacement(&self, own_normal: DVec3, under: &Under) -> DVec3 {
        let lift = self.depth * self.strength;
        let pinch = |strength: f64| {
            let along = under.towards - under.normal * under.towards.dot(under.normal);
            (PINCH * strength).clamp(-MOST_PINCH, MOST_PINCH) * along
        };
        match self.brush {
            Brush::Inflate => lift * own_normal,
            Brush::Draw => lift * under.normal,
            Brush::Grab => self.strength * under.grab,
            Brush::Pinch => pinch(self.strength),
            Brush::Crease => lift * under.normal + pinch(self.strength.abs()),
            Brush::Flatten => under.normal * under.to_plane.dot(under.normal),
            Brush::Smooth => DVec3::ZERO,
        }
    }
}

/// Surroundings of a sample under a dab.
#[derive(Debug, Clone, Copy)]
pub struct Under {
    /// Mean normal.
    pub normal: DVec3,
    /// Vector to the nearest point of the stroke.
    pub towards: DVec3,
    /// Vector to a point of the mean plane.
    pub to_plane: DVec3,
    /// Vector from the stroke's start to its end.
    pub grab: DVec3,
}
