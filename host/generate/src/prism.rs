//! Straight bars with flat ends: round, or square with sharp edges.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::SurfaceVertex;
use super::layout::SurfacePatch;
use super::shapes::CLAY;

/// Half the width of all bars.
const RADIUS: f64 = 0.15;
/// Height of all bars, from y = 0.
const HEIGHT: f64 = 2.0;

pub(super) fn cylinder() -> Box<dyn SurfacePatch> {
    Box::new(Prism { section: PrismSection::Disc })
}

pub(super) fn bar() -> Box<dyn SurfacePatch> {
    Box::new(Prism { section: PrismSection::Square })
}

/// Rows go from the middle of the lower end to its rim, up the side, and to the middle of the upper end.
struct Prism {
    section: PrismSection,
}

enum PrismSection {
    Disc,
    Square,
}

impl PrismSection {
    /// Length around a section of radius 1.
    fn around(&self) -> f64 {
        match self {
            Self::Disc => TAU,
            Self::Square => 8.0,
        }
    }

    /// A place on the rim of a section of radius 1, in x and z, and the normal of the side there. Rims run
    /// from x to z.
    fn rim(&self, column: u32, columns: u32) -> [DVec2; 2] {
        match self {
            Self::Disc => [DVec2::from_angle(TAU * f64::from(column) / f64::from(columns)); 2],
            Self::Square => {
                // Each corner has a column of its own.
                let corner = |side: u64| (side * u64::from(columns) + 2) / 4;
                let side = (0..3).rev().find(|side| corner(*side + 1) <= column.into()).map_or(0, |s| s + 1);
                let (from, to) = (corner(side), corner(side + 1));
                let along = (u64::from(column) - from) as f64 / (to - from) as f64;
                let turned = |v: DVec2| (0..side).fold(v, |v, _| v.perp());
                let normal = if along == 0.0 { DVec2::new(1.0, -1.0) } else { DVec2::X };
                [DVec2::new(1.0, 2.0 * along - 1.0), normal.normalize()].map(turned)
            }
        }
    }
}

impl SurfacePatch for Prism {
    fn length(&self) -> f64 {
        HEIGHT + 2.0 * RADIUS
    }

    fn width(&self, distance: f64) -> f64 {
        self.section.around() * RADIUS.min(distance).min(self.length() - distance).max(0.0)
    }

    fn is_wrapped(&self) -> bool {
        true
    }

    fn creases(&self) -> &[f64] {
        &[RADIUS, RADIUS + HEIGHT]
    }

    fn row(&self, distance: f64, columns: u32, vertices: &mut Vec<SurfaceVertex>) {
        let radius = RADIUS.min(distance).min(self.length() - distance).max(0.0);
        let y = if distance < RADIUS + HEIGHT { (distance - RADIUS).max(0.0) } else { HEIGHT };
        // On a rim the normals of both faces count.
        let is_side = (RADIUS..=RADIUS + HEIGHT).contains(&distance);
        let up = if y == 0.0 { -DVec3::Y } else { DVec3::Y };
        let is_end = y == 0.0 || y == HEIGHT;
        for column in 0..columns {
            let [place, side] = self.section.rim(column, columns).map(|v| DVec3::new(v.x, 0.0, v.y));
            let normal = if is_side { side } else { DVec3::ZERO } + if is_end { up } else { DVec3::ZERO };
            vertices.push(SurfaceVertex {
                position: (place * radius).with_y(y),
                normal: normal.normalize_or(up).as_vec3(),
                color: CLAY,
            });
        }
    }
}
