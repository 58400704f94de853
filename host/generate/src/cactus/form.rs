//! The cactus as a surface: where a function of space is zero.
//!
//! Distances to the tubes' curves are joined by the logarithm of a sum of exponentials, which is smooth (A.
//! Ricci, *A constructive geometry for computer graphics*, The Computer Journal 1973, has such blends); the
//! relief is subtracted.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec2, DVec3};

use super::super::SurfaceVertex;
use super::tube::{Leg, Tube};
use simod_geometry::smoothstep;

/// Length over which tubes flow into each other, and the stem into its flat foot.
const JOINT: f64 = 0.04;
const FOOT: f64 = 0.015;
/// Height of the ribs, and of the bumps on them.
const RIB: f64 = 0.022;
const BUMP: f64 = 0.018;
/// Distance of bumps along a rib.
const BUMP_SPACING: f64 = 0.1;

const GREEN: [f64; 3] = [78.0, 122.0, 66.0];
const RIDGE: [f64; 3] = [150.0, 170.0, 96.0];

/// The smooth surface at a point of space.
struct Base {
    /// About the distance from the surface; below 0 inside.
    value: f64,
    gradient: DVec3,
    /// Height of the relief above the smooth surface, 0 to [`RIB`] + [`BUMP`].
    relief: f64,
}

pub(super) struct CactusForm {
    /// The stem, and the arms on its right (+x) and left.
    pub tubes: [Tube; 3],
}

impl CactusForm {
    pub fn new() -> Self {
        let stem = vec![Leg::Line { from: DVec2::new(0.0, -0.3), direction: DVec2::Y, length: 2.08 }];
        let arm = |side: f64, height: f64, reach: f64, radius: f64, top: f64| {
            let start = DVec2::new(0.1 * side, height);
            let center = DVec2::new(reach * side, height + radius);
            let elbow = DVec2::new((reach + radius) * side, height + radius);
            vec![
                Leg::Line { from: start, direction: DVec2::X * side, length: reach - 0.1 },
                Leg::Arc { center, radius, start: -FRAC_PI_2, sweep: FRAC_PI_2 * side },
                Leg::Line { from: elbow, direction: DVec2::Y, length: top - elbow.y },
            ]
        };
        Self {
            tubes: [
                Tube { legs: stem, radius: 0.2, ribs: 10.0 },
                Tube { legs: arm(1.0, 0.8, 0.34, 0.26, 1.42), radius: 0.14, ribs: 7.0 },
                Tube { legs: arm(-1.0, 1.2, 0.3, 0.24, 1.66), radius: 0.125, ribs: 7.0 },
            ],
        }
    }

    fn base(&self, p: DVec3) -> Base {
        let seen = self.tubes.each_ref().map(|tube| tube.see(p));
        let distances: [f64; 3] = std::array::from_fn(|i| seen[i].distance() - self.tubes[i].radius);
        let least = distances.into_iter().fold(f64::INFINITY, f64::min);
        let shares = distances.map(|d| ((least - d) / JOINT).exp());
        let sum: f64 = shares.iter().sum();
        let (mut gradient, mut relief, mut purity) = (DVec3::ZERO, 0.0, 0.0);
        for ((tube, seen), share) in self.tubes.iter().zip(seen).zip(shares) {
            let share = share / sum;
            gradient += seen.offset.normalize_or_zero() * share;
            relief += share * tube.relief(seen.way, seen.across());
            purity += share * share;
        }
        // In the hollow between two tubes there is no room for it.
        relief *= smoothstep(2.0 * purity - 1.0);
        let value = least - JOINT * sum.ln();

        // Cut off below y = 0.
        let above = 1.0 / (1.0 + ((-p.y - value) / FOOT).exp());
        let highest = value.max(-p.y);
        let cut = highest + FOOT * (((value - highest) / FOOT).exp() + ((-p.y - highest) / FOOT).exp()).ln();
        Base {
            value: cut,
            gradient: gradient * above - DVec3::Y * (1.0 - above),
            relief: relief * smoothstep(p.y / 0.12),
        }
    }

    /// Approximate distance from the surface with its relief; below 0 inside.
    pub fn value(&self, p: DVec3) -> f64 {
        let base = self.base(p);
        base.value - base.relief
    }

    /// The direction in which the value grows, of unit length.
    pub fn normal(&self, p: DVec3) -> DVec3 {
        const H: f64 = 1e-6;
        let slope = |axis: DVec3| self.value(p + axis * H) - self.value(p - axis * H);
        DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z)).normalize_or(DVec3::Y)
    }

    /// Moves a point that is near the smooth surface onto that surface, and up to the relief.
    pub fn vertex(&self, near: DVec3) -> SurfaceVertex {
        const STEPS: usize = 30;
        const ENOUGH: f64 = 1e-12;
        // Newton's method along the gradient.
        let mut foot = near;
        let mut base = self.base(foot);
        for _ in 0..STEPS {
            foot -= base.gradient * (base.value / base.gradient.length_squared());
            base = self.base(foot);
            if base.value.abs() < ENOUGH {
                break;
            }
        }
        // Secants along the normal. The relief changes less than the distance does.
        let up = base.gradient.normalize_or(DVec3::Y);
        let (mut height, mut value, mut slope) = (0.0, -base.relief, 1.0);
        for _ in 0..STEPS {
            if value.abs() < ENOUGH {
                break;
            }
            let step = -value / slope;
            let next = self.value(foot + up * (height + step));
            slope = ((next - value) / step).max(0.2);
            (height, value) = (height + step, next);
        }
        let position = foot + up * height;
        let share = base.relief / (RIB + BUMP);
        let mix = |i: usize| (GREEN[i] + (RIDGE[i] - GREEN[i]) * share).round() as u8;
        SurfaceVertex { position, normal: self.normal(position).as_vec3(), color: [0, 1, 2].map(mix) }
    }
}

impl Tube {
    /// Height of ribs and bumps; they end where the tip's ribs would meet.
    fn relief(&self, way: f64, across: DVec2) -> f64 {
        let fade = smoothstep(across.length() / (0.8 * self.radius));
        let rib = 0.5 + 0.5 * (self.ribs * across.to_angle()).cos();
        let bump = 0.5 + 0.5 * (TAU * way / BUMP_SPACING + PI).cos();
        fade * (RIB * rib + BUMP * (rib * bump).powi(2))
    }
}
