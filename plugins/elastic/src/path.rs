//! Path of a handle from rest to its pose: part of a screw motion, and of its stretches.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use simod_geometry::polar_rotation;
use std::f64::consts::PI;

/// A turn that is this near to a half one has two ways.
const HALF: f64 = 1e-3;
/// Turns below this are none.
const LEAST: f64 = 1e-4;

/// Path of a handle.
#[derive(Debug)]
pub struct Path {
    whole: DAffine3,
    /// Turn of the path, as axis and angle, and the stretches before it; `None` where the handle is turned
    /// inside out.
    parts: Option<(DVec3, f64, DMat3)>,
    middle: DVec3,
    /// Point on the screw's axis.
    pivot: DVec3,
    /// Translation along the axis.
    along: DVec3,
}

impl Path {
    /// Path of a handle about a middle. A half turn goes the way on which the middle keeps farther from the
    /// point `away`.
    pub fn new(whole: DAffine3, middle: DVec3, away: Option<DVec3>) -> Self {
        let shift = whole.transform_point3(middle) - middle;
        let mut this = Self { whole, parts: None, middle, pivot: middle, along: shift };
        let Some(turn) = turn(whole.matrix3) else { return this };
        let (axis, angle) = DQuat::from_mat3(&turn).normalize().to_axis_angle();
        let (axis, angle) = if angle > PI { (-axis, 2.0 * PI - angle) } else { (axis, angle) };
        let stretch = turn.transpose() * whole.matrix3;
        this.parts = Some((axis, if angle < LEAST { 0.0 } else { angle }, stretch));
        if angle < LEAST {
            return this;
        }
        let set = |this: &mut Self, axis: DVec3| {
            let across = shift - shift.dot(axis) * axis;
            this.pivot = middle + 0.5 * (across + axis.cross(across) / (0.5 * angle).tan());
            this.along = shift.dot(axis) * axis;
            this.parts = Some((axis, angle, stretch));
        };
        set(&mut this, axis);
        if let Some(away) = away.filter(|_| angle > PI - HALF) {
            let far = |this: &Self| this.pose(0.5).transform_point3(middle).distance(away);
            let there = far(&this);
            set(&mut this, -axis);
            if far(&this) <= there {
                set(&mut this, axis);
            }
        }
        this
    }

    /// Pose of the handle after a part of its path, 0 to 1.
    pub fn pose(&self, part: f64) -> DAffine3 {
        if part >= 1.0 {
            return self.whole;
        }
        let Some((axis, angle, stretch)) = self.parts else {
            let id = DAffine3::IDENTITY;
            return DAffine3 {
                matrix3: id.matrix3 + (self.whole.matrix3 - id.matrix3) * part,
                translation: self.whole.translation * part,
            };
        };
        let turn = DMat3::from_axis_angle(axis, part * angle);
        let matrix3 = turn * (DMat3::IDENTITY + (stretch - DMat3::IDENTITY) * part);
        let to = self.pivot + turn * (self.middle - self.pivot) + part * self.along;
        DAffine3 { matrix3, translation: to - matrix3 * self.middle }
    }

    /// The angle of the turn.
    pub fn angle(&self) -> f64 {
        self.parts.map_or(PI, |(_, angle, _)| angle)
    }

    /// Length of the way of the handle's farthest point, about; `reach` is that point's distance from the
    /// middle.
    pub fn length(&self, reach: f64) -> f64 {
        let around = if self.angle() > 0.0 { self.angle() * self.middle.distance(self.pivot) } else { 0.0 };
        let stretches = self.whole.matrix3 - DMat3::IDENTITY;
        let largest = [stretches.x_axis, stretches.y_axis, stretches.z_axis].map(DVec3::length);
        around.hypot(self.along.length()) + reach * largest.into_iter().fold(self.angle(), f64::max)
    }
}

/// The rotation nearest to a map that does not turn anything inside out.
pub fn turn(map: DMat3) -> Option<DMat3> {
    let size = map.determinant();
    let largest = [map.x_axis, map.y_axis, map.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
    if !(size > 1e-9 * largest.powi(3) && largest.is_finite()) {
        return None;
    }
    let turn = polar_rotation(map * size.cbrt().recip(), 60, 1e-15);
    turn.is_finite().then_some(turn)
}
