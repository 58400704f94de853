//! The maps themselves, in double precision.
//!
//! In the frame of the centre and the axis, a point is `(s, q)`: its signed distance along the axis and the
//! rest, perpendicular to the axis. With `r(s)` the range's parameter, 0 at its start, 1 at its end,
//! clamped outside, and `l(s)` the signed length of the range from its point that stays (the centre, or the
//! end next to it) to `s`:
//!
//! * twist turns `q` by `angle · r(s)` about the axis;
//! * taper scales `q` by `1 + (factor - 1) · r(s)`;
//! * stretch moves along the axis by `(factor - 1) · l(s)`; to keep the range's volume, it scales all `q` by
//!   `1 / √factor`: those beyond the range too, or it would tear at the ends;
//! * shear moves across the axis by `slope · l(s)`;
//! * bend lays the axis on a circular arc of the same length, of `angle` in all, straight beyond the range.

use simod_plugin_api::{PluginError, PluginResult};

type Vec3 = [f64; 3];

/// Kind and amount of a warp. Angles in radians, over the whole range.
#[derive(Debug, Clone, Copy)]
pub enum WarpKind {
    /// Turns about the axis, ever more along the range.
    Twist {
        /// Angle at the end of the range; right-handed about the axis.
        angle: f64,
    },
    /// Bends the axis.
    Bend {
        /// Angle between the tangents at both ends.
        angle: f64,
        /// Direction to which the axis turns; its part along the axis is dropped.
        direction: Vec3,
    },
    /// Scales perpendicularly to the axis.
    Taper {
        /// Factor at the end of the range; 1 at its start.
        factor: f64,
    },
    /// Scales along the axis.
    Stretch {
        /// The factor of the range's length.
        factor: f64,
        /// Whether the range's volume stays.
        keep_volume: bool,
    },
    /// Slants the axis.
    Shear {
        /// Way across the axis, per length along it.
        slope: f64,
        /// Direction in which the end of the range moves; its part along the axis is dropped.
        direction: Vec3,
    },
}

/// A warp in place.
#[derive(Debug, Clone, Copy)]
pub struct Warp {
    pub(crate) deformation: WarpKind,
    pub(crate) centre: Vec3,
    pub(crate) axis: Vec3,
    pub(crate) range: [f64; 2],
}

impl Warp {
    /// A warp about the line through `centre` along `axis` (any length but zero), over a range of signed
    /// distances from the centre, `range[0] < range[1]`.
    pub fn new(deformation: WarpKind, centre: Vec3, axis: Vec3, range: [f64; 2]) -> PluginResult<Self> {
        let axis = unit(axis).ok_or_else(|| {
            PluginError::parameter("axis", "is zero").hint("give a direction, such as [0, 1, 0]")
        })?;
        let deformation = match deformation {
            WarpKind::Bend { angle, direction } => {
                WarpKind::Bend { angle, direction: across(direction, axis)? }
            }
            WarpKind::Shear { slope, direction } => {
                WarpKind::Shear { slope, direction: across(direction, axis)? }
            }
            other => other,
        };
        Ok(Self { deformation, centre, axis, range })
    }

    /// The image of a point.
    pub fn apply(&self, p: Vec3) -> Vec3 {
        match self.deformation {
            WarpKind::Twist { angle } if angle != 0.0 => self.twist(p, angle),
            WarpKind::Bend { angle, direction } if angle != 0.0 => self.bend(p, angle, direction),
            WarpKind::Taper { factor } if factor != 1.0 => self.taper(p, factor),
            WarpKind::Stretch { factor, keep_volume } if factor != 1.0 => {
                self.stretch(p, factor, keep_volume)
            }
            WarpKind::Shear { slope, direction } if slope != 0.0 => self.shear(p, slope, direction),
            // The point stays exactly, and not only up to rounding.
            WarpKind::Twist { .. }
            | WarpKind::Bend { .. }
            | WarpKind::Taper { .. }
            | WarpKind::Stretch { .. }
            | WarpKind::Shear { .. } => p,
        }
    }

    /// Distance along the axis.
    fn along(&self, p: Vec3) -> f64 {
        dot(sub(p, self.centre), self.axis)
    }

    /// The range's parameter, 0 to 1.
    fn parameter(&self, s: f64) -> f64 {
        let [from, to] = self.range;
        // A model without extent has a range without length; everything then lies at its start or end.
        let r = if to > from { (s - from) / (to - from) } else { 0.0 };
        r.clamp(0.0, 1.0)
    }

    /// Nearest point of the range, and the point that stays where the axis itself is moved: the centre, or
    /// else the end next to it.
    fn held_and_still(&self, s: f64) -> (f64, f64) {
        let [from, to] = self.range;
        (s.clamp(from, to), 0.0_f64.clamp(from, to))
    }

    fn twist(&self, p: Vec3, angle: f64) -> Vec3 {
        let s = self.along(p);
        let foot = add(self.centre, self.axis, s);
        let q = sub(p, foot);
        let (sin, cos) = (angle * self.parameter(s)).sin_cos();
        // Rodrigues' formula for a vector perpendicular to the axis.
        add(add(foot, q, cos), cross(self.axis, q), sin)
    }

    fn taper(&self, p: Vec3, factor: f64) -> Vec3 {
        let s = self.along(p);
        let foot = add(self.centre, self.axis, s);
        add(foot, sub(p, foot), 1.0 + (factor - 1.0) * self.parameter(s))
    }

    fn stretch(&self, p: Vec3, factor: f64, keep_volume: bool) -> Vec3 {
        let s = self.along(p);
        let (held, still) = self.held_and_still(s);
        let moved = add(p, self.axis, (factor - 1.0) * (held - still));
        if !keep_volume {
            return moved;
        }
        let q = sub(p, add(self.centre, self.axis, s));
        add(moved, q, factor.sqrt().recip() - 1.0)
    }

    fn shear(&self, p: Vec3, slope: f64, direction: Vec3) -> Vec3 {
        let (held, still) = self.held_and_still(self.along(p));
        add(p, direction, slope * (held - still))
    }

    fn bend(&self, p: Vec3, angle: f64, direction: Vec3) -> Vec3 {
        let [from, to] = self.range;
        if to <= from {
            return p;
        }
        let x = sub(p, self.centre);
        let (s, u) = (dot(x, self.axis), dot(x, direction));
        let (on_arc, still) = self.held_and_still(s);
        let length = on_arc - still;
        let phi = angle * length / (to - from);
        let (sin, cos) = phi.sin_cos();
        // The arc's end, and from there `u` along its normal and the rest of `s` along its tangent.
        let half = 0.5 * phi;
        let along = still + length * sinc(phi) - u * sin + (s - on_arc) * cos;
        let across = length * half.sin() * sinc(half) + u * cos + (s - on_arc) * sin;
        add(add(p, self.axis, along - s), direction, across - u)
    }
}

/// The unit vector across the axis on the side of `direction`.
fn across(direction: Vec3, axis: Vec3) -> PluginResult<Vec3> {
    let direction = unit(direction).ok_or_else(|| {
        PluginError::parameter("direction", "is zero").hint("give a direction, such as [1, 0, 0]")
    })?;
    let across = add(direction, axis, -dot(direction, axis));
    // A direction nearer to the axis than a thousandth of a degree leaves rounding alone.
    let across = (dot(across, across) > 3e-10).then(|| unit(across)).flatten();
    across.ok_or_else(|| {
        PluginError::parameter("direction", "is parallel to `axis`")
            .hint("bends and shears need a direction across the axis")
    })
}

/// `sin(x) / x`.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-8 { 1.0 } else { x.sin() / x }
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + t b`
fn add(a: Vec3, b: Vec3, t: f64) -> Vec3 {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The unit vector along `v`, of whatever length; nothing for zero.
fn unit(v: Vec3) -> Option<Vec3> {
    // Scaled first, so that neither tiny nor huge vectors are lost in their squares.
    let largest = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let v = v.map(|x| x / largest);
    let norm = dot(v, v).sqrt();
    Some(v.map(|x| x / norm))
}

#[cfg(test)]
mod tests;
