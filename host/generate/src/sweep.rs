//! Closed surfaces swept around an axis, with relief: the vase, its handles, the sphere.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::SurfaceVertex;
use super::curve::{BSpline, CurvePoint};
use super::layout::SurfacePatch;

/// Axis about which a sweep turns.
pub(super) enum SweepAxis {
    /// The y axis.
    Straight,
    /// A curve in the plane of x and y, perhaps turned by half a turn about the y axis.
    Bent { curve: BSpline, turned: bool },
}

/// A profile turned around an axis: x of the profile is the distance from the axis, y the way along it. Both
/// ends of the profile lie on the axis; the surface is outside to the right of the profile's direction.
pub(super) struct Sweep<R> {
    pub axis: SweepAxis,
    pub profile: BSpline,
    pub relief: R,
}

/// A place on the smooth surface, where the relief is asked for.
pub(super) struct Site {
    /// Arc length along the profile.
    pub distance: f64,
    /// Fraction of the turn, counter-clockwise seen along the axis.
    pub turn: f64,
    /// Distance from the axis.
    pub radius: f64,
    /// Position.
    pub position: DVec3,
    /// Derivative of the position by `distance`.
    pub along: DVec3,
    /// Unit vector of growing `turn`.
    pub around: DVec3,
}

/// Height above the smooth surface, with derivatives by `distance` and by the arc length of growing `turn`.
#[derive(Clone, Copy, Default)]
pub(super) struct Raised {
    pub height: f64,
    pub along: f64,
    pub around: f64,
}

impl Raised {
    /// Adds a field of space: its value, and its gradient.
    pub fn add_field(&mut self, value: f64, gradient: DVec3, site: &Site) {
        self.height += value;
        self.along += gradient.dot(site.along);
        self.around += gradient.dot(site.around);
    }
}

/// The relief of a sweep, and its colour.
pub(super) trait Relief: Sync + Send {
    fn raise(&self, site: &Site) -> (Raised, [u8; 3]);
}

/// A point of the axis with a frame of unit vectors: `outward` and `binormal` span the cross-section.
struct AxisFrame {
    origin: DVec3,
    tangent: DVec3,
    outward: DVec3,
    binormal: DVec3,
    /// Curvature of the axis: rate at which the tangent turns towards `outward`.
    curvature: f64,
}

impl SweepAxis {
    fn frame(&self, way: f64) -> AxisFrame {
        match self {
            SweepAxis::Straight => AxisFrame {
                origin: DVec3::Y * way,
                tangent: DVec3::Y,
                outward: DVec3::X,
                binormal: DVec3::Z,
                curvature: 0.0,
            },
            SweepAxis::Bent { curve, turned } => {
                let point = curve.point(way);
                // At the caps the profile swings slightly beyond the ends: go on straight there.
                let beyond = way - way.clamp(0.0, curve.length());
                let flip = if *turned { -1.0 } else { 1.0 };
                let place = |v: DVec2| DVec3::new(flip * v.x, v.y, 0.0);
                let outward = DVec2::new(point.tangent.y, -point.tangent.x);
                AxisFrame {
                    origin: place(point.position + point.tangent * beyond),
                    tangent: place(point.tangent),
                    outward: place(outward),
                    binormal: DVec3::Z * flip,
                    curvature: if beyond == 0.0 { point.bend.dot(outward) } else { 0.0 },
                }
            }
        }
    }
}

impl<R: Relief> SurfacePatch for Sweep<R> {
    fn length(&self) -> f64 {
        self.profile.length()
    }

    fn width(&self, distance: f64) -> f64 {
        TAU * self.profile.point(distance).position.x.max(0.0)
    }

    fn is_wrapped(&self) -> bool {
        true
    }

    fn row(&self, distance: f64, columns: u32, vertices: &mut Vec<SurfaceVertex>) {
        let ring = self.ring(distance);
        vertices.extend((0..columns).map(|i| self.vertex(&ring, f64::from(i) / f64::from(columns))));
    }
}

/// Data that all vertices at one distance share.
struct SweepRing {
    distance: f64,
    profile: CurvePoint,
    frame: AxisFrame,
}

impl<R: Relief> Sweep<R> {
    fn ring(&self, distance: f64) -> SweepRing {
        let profile = self.profile.point(distance);
        SweepRing { distance, profile, frame: self.axis.frame(profile.position.y) }
    }

    fn vertex(&self, SweepRing { distance, profile, frame }: &SweepRing, turn: f64) -> SurfaceVertex {
        let radius = profile.position.x.max(0.0);
        // Derivatives of the radius, and of the way along the axis, by the profile's arc length.
        let (dr, dw) = (profile.tangent.x, profile.tangent.y);
        let (ddr, ddw) = (profile.bend.x, profile.bend.y);
        let k = frame.curvature;

        let (sin, cos) = (TAU * turn).sin_cos();
        let radial = frame.outward * cos + frame.binormal * sin;
        let around = frame.binormal * cos - frame.outward * sin;
        let stretch = 1.0 - k * radius * cos;
        let site = Site {
            distance: *distance,
            turn,
            radius,
            position: frame.origin + radial * radius,
            along: radial * dr + frame.tangent * (dw * stretch),
            around,
        };
        let (relief, color) = self.relief.raise(&site);

        // The surface is site + height · D with D = dw · radial − dr · tangent, the profile's normal. Its two
        // derivatives, in the frame (radial, tangent, around), by distance and by arc length of the turn:
        let h = relief.height;
        let by_distance = DVec3::new(
            dr + relief.along * dw + h * (ddw - dr * dw * k * cos),
            dw * stretch - relief.along * dr - h * (k * dw * dw * cos + ddr),
            h * dr * dw * k * sin,
        );
        let swell = if radius > 1e-9 { h * dw / radius } else { 0.0 };
        let by_turn = DVec3::new(relief.around * dw, -relief.around * dr, 1.0 + swell);
        let n = by_distance.cross(by_turn);
        let normal = radial * n.x + frame.tangent * n.y + around * n.z;
        SurfaceVertex {
            position: site.position + (radial * dw - frame.tangent * dr) * h,
            normal: normal.normalize_or(DVec3::Y).as_vec3(),
            color,
        }
    }
}

/// The largest angle (in radians) between analytic normals and those of central differences.
#[cfg(test)]
pub(super) fn worst_normal<R: Relief>(sweep: &Sweep<R>) -> f64 {
    let length = sweep.length();
    let at = |distance, turn| sweep.vertex(&sweep.ring(distance), turn);
    let h = 1e-6;
    let mut worst = 0.0f64;
    for i in 1..400 {
        let (distance, turn) = (length * f64::from(i) / 400.0, f64::from(i) * 0.618_034 % 1.0);
        let along = at(distance + h, turn).position - at(distance - h, turn).position;
        let around = at(distance, turn + h).position - at(distance, turn - h).position;
        let normal = along.normalize_or_zero().cross(around.normalize_or_zero()).normalize_or_zero();
        worst = worst.max(normal.cross(at(distance, turn).normal.as_dvec3()).length());
    }
    worst
}
