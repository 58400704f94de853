//! The maps against their formulas, wherever the axis lies.

use super::*;
use proptest::prelude::*;
use std::f64::consts::PI;

const RANGE: [f64; 2] = [-0.7, 0.9];
const LENGTH: f64 = RANGE[1] - RANGE[0];

/// Step of differences for gradients, which have to stay on one side of the range's ends.
const STEP: f64 = 1e-5;

/// A place for a warp: a centre and orthonormal vectors, of which the first is the axis.
#[derive(Debug, Clone, Copy)]
struct Place {
    centre: Vec3,
    axis: Vec3,
    direction: Vec3,
    side: Vec3,
}

impl Place {
    fn warp(&self, deformation: WarpKind) -> Warp {
        // Neither has to be of unit length, nor the direction perpendicular.
        let deformation = match deformation {
            WarpKind::Bend { angle, .. } => WarpKind::Bend { angle, direction: self.slanted() },
            WarpKind::Shear { slope, .. } => WarpKind::Shear { slope, direction: self.slanted() },
            other => other,
        };
        Warp::new(deformation, self.centre, self.axis.map(|x| 3.0 * x), RANGE).unwrap()
    }

    fn slanted(&self) -> Vec3 {
        add(self.direction, self.axis, 0.5).map(|x| 0.1 * x)
    }

    /// The point with the given coordinates along the axis, the direction and the side.
    fn point(&self, [s, u, v]: Vec3) -> Vec3 {
        add(add(add(self.centre, self.axis, s), self.direction, u), self.side, v)
    }

    /// The inverse of `point`.
    fn coordinates(&self, p: Vec3) -> Vec3 {
        let x = sub(p, self.centre);
        [self.axis, self.direction, self.side].map(|a| dot(x, a))
    }

    /// Image of a point, in coordinates of the place.
    fn image(&self, deformation: WarpKind, coordinates: Vec3) -> Vec3 {
        self.coordinates(self.warp(deformation).apply(self.point(coordinates)))
    }

    /// Determinant of the gradient: the ratio by which volumes change.
    fn determinant(&self, deformation: WarpKind, at: Vec3) -> f64 {
        let columns: [Vec3; 3] = std::array::from_fn(|i| {
            let step = |t: f64| std::array::from_fn(|j| at[j] + if i == j { t } else { 0.0 });
            let [after, before] = [STEP, -STEP].map(|t| self.image(deformation, step(t)));
            sub(after, before).map(|x| x / (2.0 * STEP))
        });
        dot(columns[0], cross(columns[1], columns[2]))
    }
}

fn places() -> impl Strategy<Value = Place> {
    let vector = || prop::array::uniform3(-1.0..1.0);
    (vector(), vector(), vector()).prop_filter_map("directions", |(centre, axis, direction)| {
        let [axis, direction] = [unit(axis)?, unit(direction)?];
        let direction = add(direction, axis, -dot(direction, axis));
        let direction = (dot(direction, direction) > 1e-2).then(|| unit(direction)).flatten()?;
        Some(Place { centre, axis, direction, side: cross(axis, direction) })
    })
}

/// Coordinates of points about the range.
fn points() -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-1.5..1.5)
}

/// Points away from the ends of the range.
fn between_kinks() -> impl Strategy<Value = Vec3> {
    points().prop_filter("at a kink", |p| RANGE.iter().all(|end| (p[0] - end).abs() > 2.0 * STEP))
}

const ANY: Vec3 = [0.0; 3];

fn deformations() -> impl Strategy<Value = WarpKind> {
    let (angle, factor) = (-7.0..7.0, 0.1..4.0);
    prop_oneof![
        angle.clone().prop_map(|angle| WarpKind::Twist { angle }),
        angle.prop_map(|angle| WarpKind::Bend { angle, direction: ANY }),
        factor.clone().prop_map(|factor| WarpKind::Taper { factor }),
        (factor, any::<bool>()).prop_map(|(factor, keep_volume)| WarpKind::Stretch { factor, keep_volume }),
        (-2.0..2.0).prop_map(|slope| WarpKind::Shear { slope, direction: ANY }),
    ]
}

fn distance(a: Vec3, b: Vec3) -> f64 {
    dot(sub(a, b), sub(a, b)).sqrt()
}

fn parameter(s: f64) -> f64 {
    ((s - RANGE[0]) / LENGTH).clamp(0.0, 1.0)
}

fn is_inside(s: f64) -> bool {
    s > RANGE[0] && s < RANGE[1]
}

proptest! {
    #[test]
    fn twist_turns_about_the_axis(place in places(), p in points(), angle in -7.0..7.0) {
        let q = place.image(WarpKind::Twist { angle }, p);
        let (sin, cos) = (angle * parameter(p[0])).sin_cos();
        let expected = [p[0], cos * p[1] - sin * p[2], sin * p[1] + cos * p[2]];
        prop_assert!(distance(q, expected) < 1e-12, "{q:?} is not {expected:?}");
    }

    #[test]
    fn taper_scales_linearly(place in places(), p in points(), factor in 0.1..4.0) {
        let q = place.image(WarpKind::Taper { factor }, p);
        let scale = 1.0 + (factor - 1.0) * parameter(p[0]);
        prop_assert!(distance(q, [p[0], scale * p[1], scale * p[2]]) < 1e-12);
    }

    #[test]
    fn stretch_scales_lengths_of_the_range(place in places(), p in points(), factor in 0.1..4.0) {
        let q = place.image(WarpKind::Stretch { factor, keep_volume: false }, p);
        // The centre stays, the range is scaled about it, and what is beyond moves with its end.
        let end = p[0].clamp(RANGE[0], RANGE[1]);
        let s = factor * end + (p[0] - end);
        prop_assert!(distance(q, [s, p[1], p[2]]) < 1e-12);
        let q = place.image(WarpKind::Stretch { factor, keep_volume: true }, p);
        prop_assert!(distance(q, [s, p[1] / factor.sqrt(), p[2] / factor.sqrt()]) < 1e-12);
    }

    #[test]
    fn shear_moves_across(place in places(), p in points(), slope in -2.0..2.0) {
        let q = place.image(WarpKind::Shear { slope, direction: ANY }, p);
        let way = slope * p[0].clamp(RANGE[0], RANGE[1]);
        prop_assert!(distance(q, [p[0], p[1] + way, p[2]]) < 1e-12);
    }

    /// A point at `u` towards the centre of curvature gets on the circle that is so much smaller, and as far
    /// around it as its part of the range.
    #[test]
    fn bend_lays_the_range_on_circles(
        place in places(),
        p in points().prop_filter("beyond", |p| is_inside(p[0])),
        angle in prop_oneof![-7.0..-0.01, 0.01..7.0],
    ) {
        let q = place.image(WarpKind::Bend { angle, direction: ANY }, p);
        let radius = LENGTH / angle;
        let (sin, cos) = (p[0] / radius).sin_cos();
        let expected = [(radius - p[1]) * sin, radius - (radius - p[1]) * cos, p[2]];
        prop_assert!(distance(q, expected) < 1e-10, "{q:?} is not {expected:?}");
    }

    #[test]
    fn what_lies_beyond_bends_and_twists_moves_rigidly(
        place in places(), p in points(), q in points(), angle in -7.0..7.0, end in 0..2_usize,
    ) {
        let beyond = |[s, u, v]: Vec3| [RANGE[end] + if end == 0 { -s.abs() } else { s.abs() }, u, v];
        let (p, q) = (beyond(p), beyond(q));
        for deformation in [WarpKind::Bend { angle, direction: ANY }, WarpKind::Twist { angle }] {
            let images = [p, q].map(|x| place.image(deformation, x));
            prop_assert!((distance(p, q) - distance(images[0], images[1])).abs() < 1e-12);
        }
        // Beyond the range, the image goes on along the tangent.
        let further = |x: Vec3| place.image(WarpKind::Bend { angle, direction: ANY }, x);
        let tangent = sub(further([2.0 * RANGE[end], 0.0, 0.0]), further([RANGE[end], 0.0, 0.0]));
        let phi = angle * RANGE[end] / LENGTH;
        prop_assert!(distance(tangent, [phi.cos(), phi.sin(), 0.0].map(|x| RANGE[end] * x)) < 1e-12);
    }

    #[test]
    fn nothing_tears_at_the_ends(
        place in places(), deformation in deformations(), p in points(), end in 0..2_usize,
    ) {
        let at = |s| place.image(deformation, [s, p[1], p[2]]);
        let gap = distance(at(RANGE[end] - 1e-9), at(RANGE[end] + 1e-9));
        prop_assert!(gap < 1e-7, "{gap}");
    }

    #[test]
    fn volumes_change_as_they_should(
        place in places(), deformation in deformations(), p in between_kinks(),
    ) {
        let inside = is_inside(p[0]);
        let expected = match deformation {
            WarpKind::Twist { .. } | WarpKind::Shear { .. } => 1.0,
            WarpKind::Bend { angle, .. } => if inside { 1.0 - angle / LENGTH * p[1] } else { 1.0 },
            WarpKind::Taper { factor } => (1.0 + (factor - 1.0) * parameter(p[0])).powi(2),
            WarpKind::Stretch { factor, keep_volume } => {
                (if inside { factor } else { 1.0 }) / if keep_volume { factor } else { 1.0 }
            }
        };
        let determinant = place.determinant(deformation, p);
        let close = 1e-6 * (1.0 + expected.abs());
        prop_assert!((determinant - expected).abs() < close, "{determinant}, not {expected}");
    }

    #[test]
    fn neutral_values_move_nothing(place in places(), p in points()) {
        let p = place.point(p);
        for deformation in [
            WarpKind::Twist { angle: 0.0 },
            WarpKind::Bend { angle: 0.0, direction: ANY },
            WarpKind::Taper { factor: 1.0 },
            WarpKind::Stretch { factor: 1.0, keep_volume: true },
            WarpKind::Shear { slope: 0.0, direction: ANY },
        ] {
            prop_assert_eq!(place.warp(deformation).apply(p), p);
        }
    }

    /// Bends by nearly nothing are computed without dividing by the angle.
    #[test]
    fn small_bends_bend_little(place in places(), p in points(), exponent in -300.0..-6.0) {
        let angle = 10_f64.powf(exponent);
        let q = place.image(WarpKind::Bend { angle, direction: ANY }, p);
        prop_assert!(distance(p, q) < 1e-12 + 10.0 * angle);
    }

    /// The end next to the centre stays, where the centre is beyond the range, with all on its side.
    #[test]
    fn the_end_next_to_the_centre_stays(
        place in places(), deformation in deformations(), p in points(), away in 0.0..2.0,
    ) {
        let mut warp = place.warp(deformation);
        warp.range = [away, away + 1.0];
        let keeps_size = !matches!(deformation, WarpKind::Stretch { keep_volume: true, .. });
        let p = place.point([p[0].min(away), p[1], p[2]]);
        prop_assert!(!keeps_size || distance(warp.apply(p), p) < 1e-12);
    }
}

#[test]
fn a_full_bend_of_the_range_is_a_circle() {
    let bend = WarpKind::Bend { angle: 2.0 * PI, direction: [1.0, 0.0, 0.0] };
    let w = Warp::new(bend, [0.0; 3], [0.0, 1.0, 0.0], [-PI, PI]).unwrap();
    for i in 0..100 {
        let s = PI * (f64::from(i) / 50.0 - 1.0);
        // Radius 1 about (1, 0), and 0.5 for what lies half-way to the centre of curvature.
        assert!((distance(w.apply([0.0, s, 0.3]), [1.0, 0.0, 0.3]) - 1.0).abs() < 1e-12);
        assert!((distance(w.apply([0.5, s, 0.0]), [1.0, 0.0, 0.0]) - 0.5).abs() < 1e-12);
    }
    assert!(distance(w.apply([0.0, PI, 0.0]), w.apply([0.0, -PI, 0.0])) < 1e-12);
}

#[test]
fn a_range_without_length_moves_nothing_far() {
    for deformation in [
        WarpKind::Twist { angle: 1.0 },
        WarpKind::Bend { angle: 1.0, direction: [1.0, 0.0, 0.0] },
        WarpKind::Stretch { factor: 2.0, keep_volume: false },
        WarpKind::Shear { slope: 1.0, direction: [1.0, 0.0, 0.0] },
    ] {
        let w = Warp::new(deformation, [0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0]).unwrap();
        assert_eq!(w.apply([0.3, 0.0, 0.1]), [0.3, 0.0, 0.1]);
    }
}

#[test]
fn senseless_directions_are_refused() {
    let axis = [1.0, 2.0, -0.5];
    let error = |deformation, axis| Warp::new(deformation, [0.0; 3], axis, RANGE).unwrap_err().message;
    assert!(error(WarpKind::Twist { angle: 1.0 }, [0.0; 3]).contains("`axis`"));
    let bend = |direction| WarpKind::Bend { angle: 1.0, direction };
    let shear = |direction| WarpKind::Shear { slope: 1.0, direction };
    for with in [bend as fn(Vec3) -> WarpKind, shear] {
        assert!(error(with([0.0; 3]), axis).contains("`direction`"));
        assert!(error(with([2.0, 4.0, -1.0]), axis).contains("parallel"));
    }
    assert!(Warp::new(WarpKind::Twist { angle: 1.0 }, [0.0; 3], [1e-300, 0.0, 0.0], RANGE).is_ok());
}
