//! The maps themselves, in double precision.
//!
//! In the frame of the centre and the axis, a point is `(s, q)`: its signed distance along the axis and the
//! rest, perpendicular to it. With `r(s)` the range's parameter, 0 at its start, 1 at its end, clamped outside:
//!
//! * twist turns `q` by `angle · r(s)` about the axis;
//! * taper scales `q` by `1 + (factor - 1) · r(s)`;
//! * bend lays the axis on a circular arc of the same length, of `angle` in all, straight beyond the range.

use simod_plugin_api::{PluginError, PluginResult};

type Vec3 = [f64; 3];

/// Which warp. Angles in radians, over the whole range.
#[derive(Debug, Clone, Copy)]
pub enum Deformation {
    /// Turns about the axis, ever more.
    Twist {
        /// At the end of the range; right-handed about the axis.
        angle: f64,
    },
    /// Bends the axis.
    Bend {
        /// Between the tangents at both ends.
        angle: f64,
        /// Where the axis turns to; its part along the axis is dropped.
        direction: Vec3,
    },
    /// Scales perpendicularly to the axis.
    Taper {
        /// At the end of the range; 1 at its start.
        factor: f64,
    },
}

/// A warp in place.
#[derive(Debug, Clone, Copy)]
pub struct Warp {
    deformation: Deformation,
    centre: Vec3,
    axis: Vec3,
    range: [f64; 2],
}

impl Warp {
    /// A warp about the line through `centre` along `axis` (any length but zero), over a range of signed
    /// distances from the centre, `range[0] < range[1]`.
    pub fn new(deformation: Deformation, centre: Vec3, axis: Vec3, range: [f64; 2]) -> PluginResult<Self> {
        let axis = unit(axis).ok_or_else(|| {
            PluginError::parameter("axis", "is zero").hint("give a direction, such as [0, 1, 0]")
        })?;
        let deformation = match deformation {
            Deformation::Bend { angle, direction } => {
                let direction = unit(direction).ok_or_else(|| {
                    PluginError::parameter("direction", "is zero").hint("give a direction, such as [1, 0, 0]")
                })?;
                let across = add(direction, axis, -dot(direction, axis));
                // Nearer than a thousandth of a degree, what is left is rounding.
                let across = (dot(across, across) > 3e-10).then(|| unit(across)).flatten();
                let direction = across.ok_or_else(|| {
                    PluginError::parameter("direction", "is parallel to `axis`")
                        .hint("a bend needs a direction across its axis")
                })?;
                Deformation::Bend { angle, direction }
            }
            other => other,
        };
        Ok(Self { deformation, centre, axis, range })
    }

    /// The image of a point.
    pub fn apply(&self, p: Vec3) -> Vec3 {
        match self.deformation {
            Deformation::Twist { angle } if angle != 0.0 => self.twist(p, angle),
            Deformation::Bend { angle, direction } if angle != 0.0 => self.bend(p, angle, direction),
            Deformation::Taper { factor } if factor != 1.0 => self.taper(p, factor),
            // Exactly, and not only up to rounding.
            Deformation::Twist { .. } | Deformation::Bend { .. } | Deformation::Taper { .. } => p,
        }
    }

    /// Distance along the axis, and its parameter in the range, 0 to 1.
    fn along(&self, p: Vec3) -> (f64, f64) {
        let s = dot(sub(p, self.centre), self.axis);
        let [from, to] = self.range;
        // A model without extent has a range without length; everything then lies at its start or end.
        let r = if to > from { (s - from) / (to - from) } else { 0.0 };
        (s, r.clamp(0.0, 1.0))
    }

    fn twist(&self, p: Vec3, angle: f64) -> Vec3 {
        let (s, r) = self.along(p);
        let foot = add(self.centre, self.axis, s);
        let q = sub(p, foot);
        let (sin, cos) = (angle * r).sin_cos();
        // Rodrigues' formula for a vector perpendicular to the axis.
        add(add(foot, q, cos), cross(self.axis, q), sin)
    }

    fn taper(&self, p: Vec3, factor: f64) -> Vec3 {
        let (s, r) = self.along(p);
        let foot = add(self.centre, self.axis, s);
        add(foot, sub(p, foot), 1.0 + (factor - 1.0) * r)
    }

    fn bend(&self, p: Vec3, angle: f64, direction: Vec3) -> Vec3 {
        let [from, to] = self.range;
        if to <= from {
            return p;
        }
        let x = sub(p, self.centre);
        let (s, u) = (dot(x, self.axis), dot(x, direction));
        // The centre stays, or else the end of the range next to it, with the straight piece that holds it.
        let neutral = 0.0_f64.clamp(from, to);
        let on_arc = s.clamp(from, to);
        let length = on_arc - neutral;
        let phi = angle * length / (to - from);
        let (sin, cos) = phi.sin_cos();
        // The arc's end, and from there `u` along its normal and the rest of `s` along its tangent.
        let half = 0.5 * phi;
        let along = neutral + length * sinc(phi) - u * sin + (s - on_arc) * cos;
        let across = length * half.sin() * sinc(half) + u * cos + (s - on_arc) * sin;
        add(add(p, self.axis, along - s), direction, across - u)
    }
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
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const CENTRE: Vec3 = [0.3, -0.2, 0.5];
    const AXIS: Vec3 = [1.0, 2.0, -0.5];
    const RANGE: [f64; 2] = [-0.7, 0.9];

    fn warp(deformation: Deformation) -> Warp {
        Warp::new(deformation, CENTRE, AXIS, RANGE).unwrap()
    }

    fn points() -> impl Iterator<Item = Vec3> {
        (0..500)
            .map(f64::from)
            .map(|i| [(i * 0.37).sin() * 2.0, (i * 0.73).cos() * 2.0, (i * 1.1).sin() * 2.0])
    }

    fn distance(a: Vec3, b: Vec3) -> f64 {
        dot(sub(a, b), sub(a, b)).sqrt()
    }

    /// Part across the axis.
    fn across(p: Vec3) -> Vec3 {
        let axis = unit(AXIS).unwrap();
        let x = sub(p, CENTRE);
        add(x, axis, -dot(x, axis))
    }

    #[test]
    fn twist_turns_about_the_axis_by_the_angle() {
        let angle = 2.0;
        let w = warp(Deformation::Twist { angle });
        let axis = unit(AXIS).unwrap();
        for p in points() {
            let q = w.apply(p);
            let (s, r) = w.along(p);
            assert!((w.along(q).0 - s).abs() < 1e-12, "moved along the axis");
            let (a, b) = (across(p), across(q));
            assert!((dot(a, a) - dot(b, b)).abs() < 1e-12, "moved away from the axis");
            let turned = dot(cross(a, b), axis).atan2(dot(a, b));
            assert!((turned - angle * r).abs() < 1e-9);
            if s <= RANGE[0] {
                assert!(distance(p, q) < 1e-12, "the start of the range stays");
            }
        }
    }

    #[test]
    fn taper_scales_linearly() {
        let w = warp(Deformation::Taper { factor: 0.25 });
        for p in points() {
            let (s, r) = w.along(p);
            let q = w.apply(p);
            assert!((w.along(q).0 - s).abs() < 1e-12);
            assert!(distance(across(q), across(p).map(|x| x * (1.0 - 0.75 * r))) < 1e-12);
        }
    }

    #[test]
    fn bend_keeps_the_length_of_the_axis_and_its_centre() {
        let axis = unit(AXIS).unwrap();
        for angle in [1e-9, 0.5, PI, -2.0 * PI, 9.0] {
            let w = warp(Deformation::Bend { angle, direction: [0.0, 0.0, 1.0] });
            assert!(distance(w.apply(CENTRE), CENTRE) < 1e-12);
            let n = 20_000;
            let at = |i: i32| w.apply(add(CENTRE, axis, -1.5 + 3.0 * f64::from(i) / f64::from(n)));
            let length: f64 = (0..n).map(|i| distance(at(i), at(i + 1))).sum();
            assert!((length - 3.0).abs() < 1e-5, "{angle}: {length}");
        }
    }

    #[test]
    fn bend_turns_the_ends_by_the_angle_rigidly() {
        let axis = unit(AXIS).unwrap();
        let direction = unit(across(add(CENTRE, [0.0, 0.0, 1.0], 1.0))).unwrap();
        let w = warp(Deformation::Bend { angle: 1.2, direction });
        let tangent = |s: f64| {
            let (a, b) = (add(CENTRE, axis, s), add(CENTRE, axis, s + 0.1));
            unit(sub(w.apply(b), w.apply(a))).unwrap()
        };
        let (start, end) = (tangent(-2.0), tangent(2.0));
        assert!((dot(start, end) - 1.2_f64.cos()).abs() < 1e-9);
        assert!(dot(end, direction) > 0.0, "bends towards the direction");
        // Beyond the range, distances stay.
        let beyond: Vec<Vec3> = points().filter(|&p| w.along(p).0 > RANGE[1]).collect();
        assert!(beyond.len() > 10);
        for pair in beyond.windows(2) {
            let (before, after) = (distance(pair[0], pair[1]), distance(w.apply(pair[0]), w.apply(pair[1])));
            assert!((before - after).abs() < 1e-12);
        }
    }

    #[test]
    fn a_full_bend_of_the_range_is_a_circle() {
        let w = Warp::new(
            Deformation::Bend { angle: 2.0 * PI, direction: [1.0, 0.0, 0.0] },
            [0.0; 3],
            [0.0, 1.0, 0.0],
            [-PI, PI],
        );
        let w = w.unwrap();
        for i in 0..100 {
            let s = PI * (f64::from(i) / 50.0 - 1.0);
            // Radius 1 about (1, 0), and 0.5 for what lies half-way to the centre of curvature.
            assert!((distance(w.apply([0.0, s, 0.3]), [1.0, 0.0, 0.3]) - 1.0).abs() < 1e-12);
            assert!((distance(w.apply([0.5, s, 0.0]), [1.0, 0.0, 0.0]) - 0.5).abs() < 1e-12);
        }
        assert!(distance(w.apply([0.0, PI, 0.0]), w.apply([0.0, -PI, 0.0])) < 1e-12);
    }

    #[test]
    fn nothing_is_exactly_nothing() {
        for deformation in [
            Deformation::Twist { angle: 0.0 },
            Deformation::Bend { angle: 0.0, direction: [0.0, 0.0, 1.0] },
            Deformation::Taper { factor: 1.0 },
        ] {
            assert!(points().all(|p| warp(deformation).apply(p) == p));
        }
    }

    #[test]
    fn senseless_directions_are_refused() {
        let bend = |direction| Deformation::Bend { angle: 1.0, direction };
        let error = |deformation, axis| Warp::new(deformation, CENTRE, axis, RANGE).unwrap_err().message;
        assert!(error(Deformation::Twist { angle: 1.0 }, [0.0; 3]).contains("`axis`"));
        assert!(error(bend([0.0; 3]), AXIS).contains("`direction`"));
        assert!(error(bend([2.0, 4.0, -1.0]), AXIS).contains("parallel"));
        assert!(Warp::new(Deformation::Twist { angle: 1.0 }, CENTRE, [1e-300, 0.0, 0.0], RANGE).is_ok());
    }
}
