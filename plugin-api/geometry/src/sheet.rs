//! The sheet metric: how far points are from each other along a surface of which there are samples with
//! normals, as the nearest in space may be those of the other side of a thin wall, or of the next finger.
//!
//! Two samples of one sheet have normals that do not oppose, and lie near each other's tangent planes: the
//! chord of an arc is perpendicular to the mean of both ends' normals, whatever the curvature.

use glam::Vec3;

/// Factor by which a distance across the surface counts more than one along it.
pub const STACKED: f32 = 10.0;

/// The sine against the surface beyond which a chord joins two sheets.
pub const STEEPEST: f32 = 0.5;

/// The squared distance in the sheet metric between a sample and a point at `d` from it, where the surface
/// between them has the unit normal `n`.
#[inline]
pub fn sheet_distance(d: Vec3, n: Vec3) -> f32 {
    let across = STACKED * d.dot(n);
    d.length_squared() + across * across
}

/// The squared length in the sheet metric of the chord `d` from a sample with the unit normal `m` to one with
/// the unit normal `n`; nothing where it joins two sheets.
#[inline]
pub fn chord_length(d: Vec3, m: Vec3, n: Vec3) -> Option<f32> {
    let between = 0.5 * (m + n);
    // More than 120° apart, as on both sides of a thin plate, but not as the walls of a groove.
    let faces_away = 2.0 * m.dot(n) + 1.0 <= 0.0;
    let across = d.dot(between);
    let is_steep = across * across > STEEPEST * STEEPEST * d.length_squared();
    (!faces_away && !is_steep).then(|| sheet_distance(d, between))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chords_of_an_arc_are_as_long_as_in_space_and_those_through_a_wall_join_nothing() {
        let at = |angle: f32| Vec3::new(angle.cos(), angle.sin(), 0.0);
        for angle in [0.1, 0.7, 1.9] {
            let d = at(angle) - at(0.0);
            let length = chord_length(d, at(0.0), at(angle)).expect("one sheet");
            assert!((length / d.length_squared() - 1.0).abs() < 1e-5, "{angle}: {length}");
        }
        let wall = Vec3::new(0.0, 0.0, 0.01);
        assert_eq!(chord_length(wall, Vec3::Z, Vec3::NEG_Z), None, "the other side of a wall");
        assert_eq!(chord_length(wall, Vec3::Z, Vec3::Z), None, "a sheet above");
        assert!((sheet_distance(wall, Vec3::Z) - 101.0 * 1e-4).abs() < 1e-6);
    }
}
