//! Shapes that say where in space something holds: geometry, not sample indices, so they fit any sampling.

use crate::key::{Key, Keyed};
use crate::picked::PickedPoints;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use simod_geometry::smoothstep;
use simod_model::bounds::Bounds;

/// A part of space, in model coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum RegionShape {
    /// All points on the side of a plane that its normal points to.
    HalfSpace {
        /// A point on the plane.
        #[serde(deserialize_with = "crate::vector::three")]
        point: DVec3,
        /// Points inwards; any length but zero.
        #[serde(deserialize_with = "crate::vector::three")]
        normal: DVec3,
    },
    /// A ball.
    Sphere {
        /// The sphere's centre.
        #[serde(deserialize_with = "crate::vector::three")]
        center: DVec3,
        /// Radius in the model's unit; positive.
        radius: f64,
    },
    /// An axis-aligned box.
    Box {
        /// Smallest coordinates.
        #[serde(deserialize_with = "crate::vector::three")]
        min: DVec3,
        /// Largest coordinates.
        #[serde(deserialize_with = "crate::vector::three")]
        max: DVec3,
    },
    /// A selection that a hand made.
    Selection(PickedPoints),
}

impl RegionShape {
    /// Defect of the shape, if it has one.
    pub fn defect(&self) -> Option<&'static str> {
        match *self {
            Self::HalfSpace { point, normal } if !(point.is_finite() && normal.is_finite()) => {
                Some("a half-space has a coordinate that is no finite number")
            }
            Self::HalfSpace { normal, .. } if normal.try_normalize().is_none() => {
                Some("the normal of a half-space is zero")
            }
            Self::Sphere { center, radius } if !(center.is_finite() && radius.is_finite()) => {
                Some("a sphere has a coordinate that is no finite number")
            }
            Self::Sphere { radius, .. } if radius <= 0.0 => Some("the radius of a sphere is not positive"),
            Self::Box { min, max } if !(min.is_finite() && max.is_finite()) => {
                Some("a box has a coordinate that is no finite number")
            }
            Self::Box { min, max } if !min.cmple(max).all() => Some("the min of a box exceeds its max"),
            Self::Selection(ref picked) => picked.defect(),
            _ => None,
        }
    }

    /// Signed distance to the surface, in the model's unit; negative inside.
    pub fn signed_distance(&self, p: DVec3) -> f64 {
        match *self {
            Self::HalfSpace { point, normal } => (point - p).dot(normal.normalize_or_zero()),
            Self::Sphere { center, radius } => p.distance(center) - radius,
            Self::Box { min, max } => {
                let q = (p - 0.5 * (min + max)).abs() - 0.5 * (max - min);
                q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
            }
            Self::Selection(ref picked) => picked.signed_distance(p),
        }
    }
}

/// A union of shapes whose influence may fade out beyond their surface.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Shapes {
    /// The shapes; none is nowhere.
    pub shapes: Vec<RegionShape>,
    /// Distance beyond the surface at which the weight has fallen to 0, in the model's unit; 0 for at once.
    #[serde(default)]
    pub falloff: f64,
}

impl Shapes {
    /// Checks the shapes and the falloff.
    ///
    /// # Errors
    /// A shape is no part of space, or the falloff is no distance: the text says which.
    pub fn check(&self) -> Result<(), &'static str> {
        if let Some(what) = self.shapes.iter().find_map(RegionShape::defect) {
            return Err(what);
        }
        if self.falloff >= 0.0 && self.falloff.is_finite() {
            Ok(())
        } else {
            Err("`falloff` is negative or no finite number")
        }
    }

    /// Signed distance to the surface of the union, in the model's unit: negative inside, and exact outside.
    pub fn signed_distance(&self, p: DVec3) -> f64 {
        self.shapes.iter().map(|s| s.signed_distance(p)).fold(f64::INFINITY, f64::min)
    }

    /// Tables of the shapes as a session file has them; for selections that are too long for that, the number
    /// of their points and their place.
    pub fn tables(&self) -> Vec<toml::Table> {
        let summary = |picked: &PickedPoints| {
            let bounds = Bounds::from_points(picked.inside().iter().copied());
            let entries = [
                ("points", toml::Value::from(picked.inside().len() as i64)),
                ("min", bounds.min.to_array().to_vec().into()),
                ("max", bounds.max.to_array().to_vec().into()),
            ];
            let content = entries.map(|(key, value)| (key.to_owned(), value));
            toml::Table::from_iter([("selection".to_owned(), toml::Table::from_iter(content).into())])
        };
        let table = |shape: &RegionShape| match shape {
            RegionShape::Selection(picked) if picked.is_long() => summary(picked),
            _ => match toml::Value::try_from(shape) {
                Ok(toml::Value::Table(table)) => table,
                // Numbers are always TOML.
                _ => toml::Table::new(),
            },
        };
        self.shapes.iter().map(table).collect()
    }

    /// 1 inside and on the surface of any shape, 0 from `falloff` away on, and `1 - 3t² + 2t³` in between,
    /// with `t` the distance to the surface over `falloff`.
    pub fn weight(&self, p: DVec3) -> f64 {
        let distance = self.signed_distance(p);
        if distance <= 0.0 {
            1.0
        } else if distance < self.falloff {
            1.0 - smoothstep(distance / self.falloff)
        } else {
            0.0
        }
    }
}

impl Keyed for RegionShape {
    fn add_to(&self, key: &mut Key) {
        match self {
            Self::HalfSpace { point, normal } => (0u8, [point, normal]).add_to(key),
            Self::Sphere { center, radius } => (1u8, (center, radius)).add_to(key),
            Self::Box { min, max } => (2u8, [min, max]).add_to(key),
            Self::Selection(picked) => (3u8, picked).add_to(key),
        }
    }
}

impl Keyed for Shapes {
    fn add_to(&self, key: &mut Key) {
        let Self { shapes, falloff } = self;
        (shapes, falloff).add_to(key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: RegionShape = RegionShape::Box { min: DVec3::ZERO, max: DVec3::new(1.0, 2.0, 3.0) };

    #[test]
    fn distances() {
        let above =
            RegionShape::HalfSpace { point: DVec3::new(0.0, 5.0, 0.0), normal: DVec3::new(0.0, 10.0, 0.0) };
        assert_eq!(above.signed_distance(DVec3::new(9.0, 7.0, 1.0)), -2.0);
        let ball = RegionShape::Sphere { center: DVec3::X, radius: 2.0 };
        assert_eq!(ball.signed_distance(DVec3::X * 6.0), 3.0);
        assert_eq!(BOX.signed_distance(DVec3::new(0.5, 1.0, 1.0)), -0.5);
        assert_eq!(BOX.signed_distance(DVec3::new(4.0, 6.0, 1.0)), 5.0);
    }

    #[test]
    fn weights_fall_off_smoothly_over_the_union() {
        let ball = RegionShape::Sphere { center: DVec3::new(10.0, 0.0, 0.0), radius: 1.0 };
        let hard = Shapes { shapes: vec![BOX, ball], falloff: 0.0 };
        assert_eq!(hard.weight(DVec3::ONE), 1.0);
        assert_eq!(hard.weight(DVec3::new(11.0, 0.0, 0.0)), 1.0);
        assert_eq!(hard.weight(DVec3::new(11.001, 0.0, 0.0)), 0.0);
        let soft = Shapes { falloff: 2.0, ..hard };
        assert_eq!(soft.weight(DVec3::new(12.0, 0.0, 0.0)), 0.5);
        assert_eq!(soft.weight(DVec3::new(13.0, 0.0, 0.0)), 0.0);
        assert_eq!(Shapes::default().weight(DVec3::ZERO), 0.0);
    }

    #[test]
    fn tables_are_read_as_the_same_shapes() {
        let ball = RegionShape::Sphere { center: DVec3::X, radius: 2.0 };
        let half = RegionShape::HalfSpace { point: DVec3::ZERO, normal: DVec3::Y };
        let picked = RegionShape::Selection(PickedPoints::new(vec![DVec3::ONE], vec![DVec3::X, DVec3::Z]));
        let all = Shapes { shapes: vec![BOX, ball, half, picked], falloff: 0.0 };
        let read: Vec<RegionShape> = all.tables().into_iter().map(|t| t.try_into().unwrap()).collect();
        assert_eq!(read, all.shapes);
        let long = PickedPoints::new((0..2000).map(|i| DVec3::splat(f64::from(i))).collect(), Vec::new());
        let summary =
            &Shapes { shapes: vec![RegionShape::Selection(long)], falloff: 0.0 }.tables()[0]["selection"];
        assert_eq!(
            (summary["points"].as_integer(), summary["max"][0].as_float()),
            (Some(2000), Some(1999.0))
        );
    }

    #[test]
    fn defects_are_found() {
        assert!(BOX.defect().is_none());
        assert!(RegionShape::Box { min: DVec3::ONE, max: DVec3::ZERO }.defect().is_some());
        assert!(RegionShape::Sphere { center: DVec3::ZERO, radius: 0.0 }.defect().is_some());
        assert!(RegionShape::Sphere { center: DVec3::ZERO, radius: f64::NAN }.defect().is_some());
        assert!(RegionShape::HalfSpace { point: DVec3::ZERO, normal: DVec3::ZERO }.defect().is_some());
    }
}
