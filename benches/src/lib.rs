//! Code that the benchmark programs share: exact maps of space, models like scans, distances, peers, child
//! processes, and tables.

pub mod distance;
pub mod peers;
pub mod process;
pub mod scan;

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3, EulerRot, Vec3};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::sampled_model::SampledModel;
use simod_model::bounds::Bounds;

/// A unit vector along no axis: hardly ever along a surface, or perpendicular to it.
pub const TILTED: DVec3 = DVec3::new(0.6, 0.48, 0.64);

/// A map of space that is known everywhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Map {
    /// Moves nothing.
    Identity,
    /// Turns about the centre of the box, and moves by a third of its diagonal.
    Rigid,
    /// Turns and scales, to nearly twice the size.
    Similarity,
    /// Stretches and shears, by factors between 0.5 and 1.5.
    Affine,
    /// Half a turn about y, from the bottom of the box to its top.
    Twist,
    /// Bends y into a quarter of a circle, towards +x.
    Bend,
    /// Moves what is around a point by up to 5 % of the diagonal: a Gaussian of radius 10 % of the diagonal.
    Bump(DVec3),
}

impl Map {
    /// Maps that need no place on the model, the rigid ones first.
    pub const ALL: [Self; 6] =
        [Self::Identity, Self::Rigid, Self::Similarity, Self::Affine, Self::Twist, Self::Bend];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Identity => "identity",
            Self::Rigid => "rigid",
            Self::Similarity => "similarity",
            Self::Affine => "affine",
            Self::Twist => "half-turn twist",
            Self::Bend => "quarter-turn bend",
            Self::Bump(_) => "local bump",
        }
    }

    /// The image of a point of a model in `bounds`.
    pub fn apply(self, bounds: &Bounds, p: DVec3) -> DVec3 {
        let center = bounds.center();
        let height = bounds.max.y - bounds.min.y;
        let turn = || DQuat::from_euler(EulerRot::XYZ, 1.0, 2.0, 0.5);
        let d = p - center;
        match self {
            Self::Identity => p,
            Self::Rigid => center + turn() * d + DVec3::splat(bounds.diagonal() / 3.0),
            Self::Similarity => center + turn() * d * 1.9,
            Self::Affine => {
                center + DVec3::new(1.5 * d.x + 0.4 * d.y, 0.7 * d.y - 0.3 * d.z, 0.2 * d.x + 0.9 * d.z)
            }
            Self::Twist => center + DQuat::from_rotation_y(PI * (p.y - bounds.min.y) / height) * d,
            Self::Bend => {
                let radius = height / FRAC_PI_2;
                let (sin, cos) = (d.y / radius).sin_cos();
                center + DVec3::new(radius - (radius - d.x) * cos, (radius - d.x) * sin, d.z)
            }
            Self::Bump(at) => {
                let (height, radius) = (0.05 * bounds.diagonal(), 0.1 * bounds.diagonal());
                p + TILTED * (height * (-p.distance_squared(at) / (radius * radius)).exp())
            }
        }
    }

    /// P_S*: the samples after the map, as exact as a file of them holds.
    pub fn deform(self, sampled: &SampledModel) -> DeformedPositions {
        let frame = sampled.frame;
        let image = |p: &Vec3| frame.to_local(self.apply(&sampled.bounds, frame.to_model(*p)));
        sampled.rounded(&sampled.samples.positions.iter().map(image).collect::<Vec<_>>())
    }
}

/// A row of a Markdown table.
pub fn row<S: AsRef<str>>(cells: impl IntoIterator<Item = S>) -> String {
    cells.into_iter().fold("|".to_owned(), |line, cell| line + " " + cell.as_ref() + " |")
}

/// The first two rows of a Markdown table: titles, the first column to the left, all others to the right.
pub fn head(titles: &[&str]) -> String {
    let rule = titles.iter().enumerate().map(|(i, _)| if i == 0 { "---" } else { "---:" });
    format!("{}\n{}", row(titles), row(rule))
}

/// An error of a table: two digits.
pub fn error_figure(error: f64) -> String {
    match error {
        0.0 => "0".to_owned(),
        x if x.is_nan() => "-".to_owned(),
        x => format!("{x:.1e}"),
    }
}

/// The middle of some measurements: what a shared machine disturbs least.
///
/// # Panics
/// `values` is empty.
pub fn median(values: Vec<f64>) -> f64 {
    simod_measure::median(values).expect("measurements")
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds { min: DVec3::new(-1.0, 0.0, 1.0), max: DVec3::new(2.0, 5.0, 2.0) };

    #[test]
    fn a_twist_turns_the_ends_by_half_a_turn_against_each_other() {
        let (bottom, top) = (BOUNDS.min, DVec3::new(BOUNDS.min.x, BOUNDS.max.y, BOUNDS.min.z));
        let turned = DVec3::new(BOUNDS.max.x, BOUNDS.max.y, BOUNDS.max.z);
        assert!(Map::Twist.apply(&BOUNDS, bottom).distance(bottom) < 1e-12);
        assert!(Map::Twist.apply(&BOUNDS, top).distance(turned) < 1e-12);
    }

    #[test]
    fn a_bend_keeps_the_axis_its_centre_and_its_length() {
        let center = BOUNDS.center();
        let image = |y: f64| Map::Bend.apply(&BOUNDS, DVec3::new(center.x, y, center.z));
        assert!(image(center.y).distance(center) < 1e-12);
        let n = 1000;
        let at = |i: i32| image(5.0 * f64::from(i) / f64::from(n));
        let length: f64 = (0..n).map(|i| at(i).distance(at(i + 1))).sum();
        assert!((length - 5.0).abs() < 1e-4, "{length}");
        let turned = (at(1) - at(0)).normalize_or_zero().dot((at(n) - at(n - 1)).normalize_or_zero());
        assert!(turned.abs() < 1e-2, "the ends are not perpendicular: {turned}");
    }

    #[test]
    fn a_bump_is_local() {
        let bump = Map::Bump(BOUNDS.center());
        let moved = |p: DVec3| bump.apply(&BOUNDS, p).distance(p) / BOUNDS.diagonal();
        assert!((moved(BOUNDS.center()) - 0.05).abs() < 1e-12);
        assert!(moved(BOUNDS.min) < 1e-9);
    }

    #[test]
    fn tables_and_medians() {
        assert_eq!(head(&["map", "rms"]), "| map | rms |\n| --- | ---: |");
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0]), 2.5);
    }
}
