//! A tube about a curve of straight parts and arcs in the plane of x and y.

use glam::{DVec2, DVec3};

/// A part of the curve.
pub(super) enum Leg {
    Line {
        from: DVec2,
        direction: DVec2,
        length: f64,
    },
    /// Arc from the angle `start` on, over the angle `sweep`; counter-clockwise where that is positive.
    Arc {
        center: DVec2,
        radius: f64,
        start: f64,
        sweep: f64,
    },
}

pub(super) struct Tube {
    pub legs: Vec<Leg>,
    pub radius: f64,
    /// Number of ribs around the tube.
    pub ribs: f64,
}

/// A point, as seen from the nearest one of the curve.
#[derive(Clone, Copy)]
pub(super) struct TubePoint {
    /// Length of the curve up to there.
    pub way: f64,
    /// Vector from the curve's nearest point to the point.
    pub offset: DVec3,
    /// The curve's direction there.
    pub tangent: DVec2,
}

impl Leg {
    pub fn length(&self) -> f64 {
        match self {
            Self::Line { length, .. } => *length,
            Self::Arc { radius, sweep, .. } => radius * sweep.abs(),
        }
    }

    /// The point after some length, and the direction there. It goes straight on beyond both ends.
    fn point(&self, way: f64) -> [DVec2; 2] {
        match *self {
            Self::Line { from, direction, .. } => [from + direction * way, direction],
            Self::Arc { center, radius, start, sweep } => {
                let within = way.clamp(0.0, self.length());
                let out = DVec2::from_angle(start + sweep.signum() * within / radius);
                let direction = out.perp() * sweep.signum();
                [center + out * radius + direction * (way - within), direction]
            }
        }
    }

    /// Length along the leg at which the leg is nearest to a point.
    fn nearest(&self, p: DVec2) -> f64 {
        match *self {
            Self::Line { from, direction, length } => (p - from).dot(direction).clamp(0.0, length),
            Self::Arc { center, radius, start, sweep } => {
                let middle = DVec2::from_angle(start + 0.5 * sweep);
                let from_middle = sweep.signum() * middle.angle_to(p - center);
                radius * (from_middle + 0.5 * sweep.abs()).clamp(0.0, sweep.abs())
            }
        }
    }
}

impl Tube {
    pub fn length(&self) -> f64 {
        self.legs.iter().map(Leg::length).sum()
    }

    /// The curve's point after some length, and its direction there; straight on beyond both ends.
    pub fn point(&self, way: f64) -> [DVec2; 2] {
        let mut rest = way;
        for leg in &self.legs[..self.legs.len() - 1] {
            if rest < leg.length() {
                return leg.point(rest);
            }
            rest -= leg.length();
        }
        self.legs[self.legs.len() - 1].point(rest)
    }

    pub fn see(&self, p: DVec3) -> TubePoint {
        let mut before = 0.0;
        let seen = self.legs.iter().map(|leg| {
            let way = leg.nearest(p.truncate());
            let [at, tangent] = leg.point(way);
            let seen = TubePoint { way: before + way, offset: p - at.extend(0.0), tangent };
            before += leg.length();
            seen
        });
        let nearer = |a: TubePoint, b: TubePoint| {
            if b.offset.length_squared() < a.offset.length_squared() { b } else { a }
        };
        let nowhere = TubePoint { way: 0.0, offset: DVec3::INFINITY, tangent: DVec2::Y };
        seen.fold(nowhere, nearer)
    }
}

impl TubePoint {
    pub fn distance(&self) -> f64 {
        self.offset.length()
    }

    /// The offset across the curve: to the curve's left, and backwards, which is where grids begin to turn
    /// to.
    pub fn across(&self) -> DVec2 {
        DVec2::new(self.offset.truncate().dot(self.tangent.perp()), -self.offset.z)
    }
}
