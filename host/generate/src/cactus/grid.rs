//! The cactus' vertices: rings of four sides about each tube, with square grids as caps.
//!
//! The stem's sides towards the arms have a hole each, as high as it is wide, whose border is the first ring
//! of the arm. So every vertex but those at holes' and caps' corners has two rows of neighbours each way, and
//! nothing has to be looked up: each index is a sum. Vertices begin on cones between rings that are near the
//! surface.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use glam::{DVec2, DVec3};

use super::super::{BodyRows, SurfaceVertex};
use super::counts::{Counts, HOLES, Hole, ROOT, STEM};
use super::form::CactusForm;

/// Radius of the ring at the edge of an arm's cap, and distance of the ring beyond the tube's end: parts of
/// the tube's radius.
const CAP: [f64; 2] = [0.9, 0.44];

/// Rows that belong together.
struct GridSection {
    part: CactusPart,
    rows: u64,
    /// Index of the first vertex.
    first: u64,
}

#[derive(Clone, Copy)]
enum CactusPart {
    /// The cap below.
    Foot,
    Stem,
    /// The cap of the stem.
    Top,
    Arm(usize),
    /// The cap of an arm.
    Tip(usize),
}

/// The cactus with some number of vertices.
pub(super) struct Cactus {
    form: CactusForm,
    counts: Counts,
    sections: Vec<GridSection>,
}

impl Cactus {
    /// Cactus of at most so many vertices, and hardly less.
    pub fn new(vertices: u64) -> Self {
        let form = CactusForm::new();
        let counts = Counts::of_vertices(&Counts::lengths(&form), vertices);
        let mut cactus = Self { form, counts, sections: Vec::new() };
        let arms = [0, 1].into_iter().flat_map(|arm| [CactusPart::Arm(arm), CactusPart::Tip(arm)]);
        let mut first = 0;
        for part in [CactusPart::Foot, CactusPart::Stem, CactusPart::Top].into_iter().chain(arms) {
            let rows = match part {
                CactusPart::Stem => counts.stem.iter().sum::<u64>() + 1,
                CactusPart::Arm(arm) => counts.arms[arm].iter().sum::<u64>() + 1,
                CactusPart::Foot | CactusPart::Top | CactusPart::Tip(_) => cactus.cap(part).height,
            };
            cactus.sections.push(GridSection { part, rows, first });
            first += (0..rows).map(|row| cactus.row_of(part, row)).sum::<u64>();
        }
        cactus
    }

    /// Section of a row, and the row's number there.
    fn find(&self, row: usize) -> (&GridSection, u64) {
        let mut row = row as u64;
        let last = self.sections.len() - 1;
        for section in &self.sections[..last] {
            if row < section.rows {
                return (section, row);
            }
            row -= section.rows;
        }
        (&self.sections[last], row)
    }

    /// The index of a section's first vertex.
    fn first(&self, index: usize) -> u64 {
        self.sections[index].first
    }

    /// Number of vertices in a row of a section.
    fn row_of(&self, part: CactusPart, row: u64) -> u64 {
        match part {
            CactusPart::Stem => (0..2).fold(4 * self.counts.side, |len, arm| {
                let hole = self.counts.hole(arm);
                if hole.low < row && row < hole.high { len - (self.counts.side - 1) } else { len }
            }),
            // The first ring of an arm and of a cap is another section's.
            CactusPart::Arm(_) | CactusPart::Foot | CactusPart::Top | CactusPart::Tip(_) if row == 0 => 0,
            CactusPart::Arm(arm) => self.counts.around_arm(arm),
            CactusPart::Foot | CactusPart::Top | CactusPart::Tip(_) => self.counts.side - 1,
        }
    }

    /// Index of a vertex of the stem; not of one within a hole.
    fn on_stem(&self, row: u64, column: u64) -> u64 {
        let side = self.counts.side;
        let mut index = self.first(1) + 4 * side * row + column;
        for arm in 0..2 {
            let Hole { low, high, left } = self.counts.hole(arm);
            // The hole lacks vertices in the rows before this one, and in this one.
            index -= (side - 1) * row.min(high).saturating_sub(low + 1);
            if low < row && row < high && column >= left + side {
                index -= side - 1;
            }
        }
        index
    }

    /// Row and column on the stem of a vertex of an arm's hole: from the first corner along the sides, as the
    /// arm's columns go. The stem's left arm begins at the other end of the hole, as its curve goes the other
    /// way.
    fn border(&self, arm: usize, column: u64) -> (u64, u64) {
        let (Hole { low, high, left }, side) = (self.counts.hole(arm), self.counts.side);
        let height = high - low;
        let j = (column + [0, side + height][arm]) % self.counts.around_arm(arm);
        if j <= side {
            (high, left + side - j)
        } else if j <= side + height {
            (high - (j - side), left)
        } else if j <= 2 * side + height {
            (low, left + (j - side - height))
        } else {
            (low + (j - 2 * side - height), left + side)
        }
    }

    /// Index of a vertex of an arm.
    fn on_arm(&self, arm: usize, row: u64, column: u64) -> u64 {
        if row == 0 {
            let (row, column) = self.border(arm, column);
            return self.on_stem(row, column);
        }
        self.first(3 + 2 * arm) + (row - 1) * self.counts.around_arm(arm) + column
    }

    /// The place of a stem's vertex before it is moved onto the surface.
    fn near_stem(&self, row: u64, column: u64) -> DVec3 {
        let (mut rest, mut between) = (row, 0);
        while between < 6 && rest > self.counts.stem[between] {
            rest -= self.counts.stem[between];
            between += 1;
        }
        let part = rest as f64 / self.counts.stem[between] as f64;
        let ([y, radius], [to_y, to_radius]) = (STEM[between], STEM[between + 1]);
        let angle = angle_of(column, self.counts.side, self.counts.side);
        stem_ring(y + (to_y - y) * part, radius + (to_radius - radius) * part, angle)
    }

    /// The point of a row and column near an arm.
    fn near_arm(&self, arm: usize, row: u64, column: u64) -> DVec3 {
        let [root, along, _] = self.counts.arms[arm];
        let tube = &self.form.tubes[1 + arm];
        let angle = angle_of(column, self.counts.side, self.counts.stem[HOLES[arm]]);
        let parts = |row: u64, of: u64| row as f64 / of as f64;
        if row <= root {
            let (row_of_stem, column) = self.border(arm, column);
            let ring = self.arm_ring(arm, ROOT, tube.radius, angle);
            self.near_stem(row_of_stem, column).lerp(ring, parts(row, root))
        } else if row <= root + along {
            let way = ROOT + (tube.length() - ROOT) * parts(row - root, along);
            self.arm_ring(arm, way, tube.radius, angle)
        } else {
            let part = parts(row - root - along, self.counts.arms[arm][2]);
            let way = tube.length() + CAP[1] * tube.radius * part;
            self.arm_ring(arm, way, tube.radius * (1.0 - (1.0 - CAP[0]) * part), angle)
        }
    }

    fn arm_ring(&self, arm: usize, way: f64, radius: f64, angle: f64) -> DVec3 {
        let [center, tangent] = self.form.tubes[1 + arm].point(way);
        let (sin, cos) = angle.sin_cos();
        (center + tangent.perp() * (radius * cos)).extend(-radius * sin)
    }

    fn cap(&self, part: CactusPart) -> Cap {
        let side = self.counts.side;
        match part {
            CactusPart::Tip(arm) => Cap { width: side, height: self.counts.stem[HOLES[arm]] },
            _ => Cap { width: side, height: side },
        }
    }

    /// The index of a vertex of a cap, its border included.
    fn on_cap(&self, section: &GridSection, column: u64, row: u64) -> u64 {
        let cap = self.cap(section.part);
        let Some(j) = cap.border(column, row) else {
            return section.first + (row - 1) * (cap.width - 1) + column - 1;
        };
        match section.part {
            CactusPart::Tip(arm) => self.on_arm(arm, self.counts.arms[arm].iter().sum(), j),
            CactusPart::Top => self.on_stem(self.counts.stem.iter().sum(), j),
            _ => self.on_stem(0, j),
        }
    }

    /// The place of a cap's vertex before it is moved onto the surface.
    fn near_cap(&self, part: CactusPart, column: u64, row: u64) -> DVec3 {
        let (share, angle) = self.cap(part).polar(column, row);
        let (tip, rim) = match part {
            CactusPart::Tip(arm) => {
                let tube = &self.form.tubes[1 + arm];
                let at = |way: f64, radius: f64| self.arm_ring(arm, tube.length() + way, radius, angle);
                (at(tube.radius, 0.0), at(CAP[1] * tube.radius, CAP[0] * tube.radius))
            }
            CactusPart::Top => (DVec3::Y * 1.98, stem_ring(STEM[7][0], STEM[7][1], angle)),
            _ => (DVec3::ZERO, stem_ring(STEM[0][0], STEM[0][1], angle)),
        };
        tip.lerp(rim, share)
    }
}

/// The angle of a column of a ring, from the middle of its first side; of two sides of `width` and two of
/// `height`.
fn angle_of(column: u64, width: u64, height: u64) -> f64 {
    let (mut column, mut side) = (column, 0);
    let lengths = [width, height, width, height];
    while side < 3 && column > lengths[side] {
        column -= lengths[side];
        side += 1;
    }
    FRAC_PI_2 * (side as f64 + column as f64 / lengths[side] as f64) - FRAC_PI_4
}

fn stem_ring(y: f64, radius: f64, angle: f64) -> DVec3 {
    DVec3::new(radius * angle.cos(), y, radius * angle.sin())
}

/// A grid of so many steps whose border is a ring.
struct Cap {
    width: u64,
    height: u64,
}

impl Cap {
    /// The column of the ring at a place of the border.
    fn border(&self, column: u64, row: u64) -> Option<u64> {
        let Self { width, height } = *self;
        if row == 0 {
            Some(column)
        } else if column == width {
            Some(width + row)
        } else if row == height {
            Some(2 * width + height - column)
        } else if column == 0 {
            Some(2 * (width + height) - row)
        } else {
            None
        }
    }

    /// Polar coordinates of a place on the cap: its distance from the middle, 1 at the border, and its
    /// direction. Squares become circles.
    fn polar(&self, column: u64, row: u64) -> (f64, f64) {
        let on = |i: u64, of: u64| 2.0 * i as f64 / of as f64 - 1.0;
        let place = DVec2::new(on(column, self.width), on(row, self.height));
        let share = place.abs().max_element();
        if share == 0.0 {
            return (0.0, 0.0);
        }
        let DVec2 { x, y } = place / share;
        let side = if y == -1.0 {
            0.5 * x
        } else if x == 1.0 {
            1.0 + 0.5 * y
        } else if y == 1.0 {
            2.0 - 0.5 * x
        } else {
            3.0 - 0.5 * y
        };
        (share, FRAC_PI_2 * side)
    }
}

impl BodyRows for Cactus {
    fn rows(&self) -> usize {
        self.sections.iter().map(|section| section.rows as usize).sum()
    }

    fn row_len(&self, row: usize) -> u64 {
        let (section, row) = self.find(row);
        self.row_of(section.part, row)
    }

    fn row(&self, row: usize, vertices: &mut Vec<SurfaceVertex>) {
        let (section, row) = self.find(row);
        let (count, part) = (self.row_of(section.part, row), section.part);
        let side = self.counts.side;
        let near = |i: u64| match part {
            CactusPart::Stem => {
                let missing = (0..2)
                    .map(|arm| self.counts.hole(arm))
                    .find(|hole| hole.low < row && row < hole.high && i > hole.left);
                self.near_stem(row, i + if missing.is_some() { side - 1 } else { 0 })
            }
            CactusPart::Arm(arm) => self.near_arm(arm, row, i),
            CactusPart::Foot | CactusPart::Top | CactusPart::Tip(_) => self.near_cap(part, i + 1, row),
        };
        vertices.extend((0..count).map(|i| self.form.vertex(near(i))));
    }

    fn strip_len(&self, row: usize) -> u64 {
        let (section, row) = self.find(row);
        let side = self.counts.side;
        2 * match section.part {
            CactusPart::Foot | CactusPart::Top | CactusPart::Tip(_) => side,
            _ if row + 1 == section.rows => 0,
            CactusPart::Arm(arm) => self.counts.around_arm(arm),
            CactusPart::Stem => 4 * side - if self.hole_above(row).is_some() { side } else { 0 },
        }
    }

    fn strip(&self, row: usize, triangles: &mut Vec<[u64; 3]>) {
        let (section, row) = self.find(row);
        // Corners below and above, of a column and of the next one.
        let mut add = |[a, b, c, d]: [u64; 4]| triangles.extend([[a, c, b], [b, c, d]]);
        let ring = |around: u64, at: &dyn Fn(u64, u64) -> u64, column: u64| {
            let next = (column + 1) % around;
            [at(row, column), at(row, next), at(row + 1, column), at(row + 1, next)]
        };
        let side = self.counts.side;
        match section.part {
            CactusPart::Foot | CactusPart::Top | CactusPart::Tip(_) => {
                let cap = self.cap(section.part);
                for column in 0..side {
                    let at = |i: u64, k: u64| self.on_cap(section, column + i, row + k);
                    let [a, b, c, d] = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
                    // Halved towards the middle: a border's corner and its neighbours are nearly on a line.
                    let halved = (2 * column < cap.width) == (2 * row < cap.height);
                    let corners = if halved { [c, a, d, b] } else { [a, b, c, d] };
                    // The foot is seen from below.
                    let [a, b, c, d] = corners;
                    add(if matches!(section.part, CactusPart::Foot) { [c, d, a, b] } else { corners });
                }
            }
            _ if row + 1 == section.rows => {}
            CactusPart::Arm(arm) => {
                let around = self.counts.around_arm(arm);
                (0..around).for_each(|j| add(ring(around, &|r, c| self.on_arm(arm, r, c), j)));
            }
            CactusPart::Stem => {
                let hole = self.hole_above(row).map_or(0..0, |hole| hole.left..hole.left + side);
                let columns = (0..4 * side).filter(|column| !hole.contains(column));
                columns.for_each(|j| add(ring(4 * side, &|r, c| self.on_stem(r, c), j)));
            }
        }
    }
}

impl Cactus {
    /// The hole that takes a part of the strip between a row of the stem and the next one.
    fn hole_above(&self, row: u64) -> Option<Hole> {
        (0..2).map(|arm| self.counts.hole(arm)).find(|hole| hole.low <= row && row < hole.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All vertices and triangles.
    fn mesh(cactus: &Cactus) -> (Vec<DVec3>, Vec<[u64; 3]>) {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for row in 0..cactus.rows() {
            cactus.row(row, &mut vertices);
            cactus.strip(row, &mut triangles);
        }
        (vertices.into_iter().map(|v| v.position).collect(), triangles)
    }

    #[test]
    fn vertices_are_on_the_surface_and_triangles_near_it() {
        let cactus = Cactus::new(40_000);
        let (vertices, triangles) = mesh(&cactus);
        assert!(vertices.iter().all(|p| cactus.form.value(*p).abs() < 1e-9));
        // With all triangles facing away from the inside, the mesh covers the surface once and does not cross
        // itself.
        for triangle in triangles {
            let [a, b, c] = triangle.map(|i| vertices[i as usize]);
            let middle = (a + b + c) / 3.0;
            assert!(cactus.form.value(middle).abs() < 4e-3, "{middle}");
            let normal = (b - a).cross(c - a).normalize_or_zero();
            assert!(normal.dot(cactus.form.normal(middle)) > 0.3, "{middle}");
        }
    }

    #[test]
    fn the_volume_is_that_of_the_inside() {
        let cactus = Cactus::new(100_000);
        let (vertices, triangles) = mesh(&cactus);
        let signed = |t: [u64; 3]| {
            let [a, b, c] = t.map(|i| vertices[i as usize]);
            a.cross(b).dot(c) / 6.0
        };
        let volume: f64 = triangles.into_iter().map(signed).sum();
        // Points of a regular grid that are inside.
        const STEP: f64 = 0.008;
        let points = |from: f64, to: f64| {
            (0..((to - from) / STEP) as i32).map(move |i| from + STEP * (f64::from(i) + 0.5))
        };
        let is_inside = |x: f64, y: f64, z: f64| cactus.form.value(DVec3::new(x, y, z)) < 0.0;
        let row = |x: f64, y: f64| points(-0.3, 0.3).filter(|z| is_inside(x, y, *z)).count();
        let inside: usize = points(-0.8, 0.8).flat_map(|x| points(0.0, 2.1).map(move |y| row(x, y))).sum();
        let expected = inside as f64 * STEP.powi(3);
        // Triangles cut corners.
        assert!((volume / expected - 1.0).abs() < 4e-3, "{volume} instead of {expected}");
    }
}
