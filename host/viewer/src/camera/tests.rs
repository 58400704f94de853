//! Cameras: their maps against each other, and where they go.

use super::*;
use proptest::prelude::*;

const SIZE: [f64; 2] = [640.0, 480.0];
const BOUNDS: [DVec3; 2] = [DVec3::splat(-0.6), DVec3::splat(0.6)];

fn camera() -> impl Strategy<Value = Camera> {
    let small = || prop::array::uniform3(-0.5..0.5_f64).prop_map(DVec3::from);
    (small(), -3.0..3.0_f64, -1.57..1.57_f64, 1.5..5.0_f64, any::<bool>(), any::<bool>()).prop_map(
        |(target, yaw, pitch, distance, flat, z)| Camera {
            target,
            yaw,
            pitch,
            distance,
            projection: if flat { Projection::Orthographic } else { Projection::Perspective },
            up: if z { Up::Z } else { Up::Y },
            ..Camera::default()
        },
    )
}

fn point() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-0.3..0.3_f64).prop_map(DVec3::from)
}

proptest! {
    #[test]
    fn axes_are_right_handed_and_never_roll(camera in camera()) {
        let [right, up, back] = camera.axes();
        prop_assert!(right.cross(up).abs_diff_eq(back, 1e-12) && (right.length() - 1.0).abs() < 1e-12);
        let upright = if camera.up == Up::Y { DVec3::Y } else { DVec3::Z };
        prop_assert!(right.dot(upright).abs() < 1e-12 && up.dot(upright) >= -1e-12);
    }

    #[test]
    fn matrices_and_pixels_agree(camera in camera(), p in point()) {
        let clip = camera.view_projection(SIZE, BOUNDS) * p.extend(1.0);
        let (x, y, depth) = (clip.x / clip.w, clip.y / clip.w, clip.z / clip.w);
        let (pixel, _) = camera.project(p, SIZE).unwrap();
        let expected = DVec2::new(0.5 * (x + 1.0) * SIZE[0], 0.5 * (1.0 - y) * SIZE[1]);
        prop_assert!(pixel.abs_diff_eq(expected, 1e-8), "{pixel} {expected}");
        prop_assert!((0.0..=1.0).contains(&depth), "{depth}");
        // And the pixel's ray goes through the point.
        let ray = camera.ray(pixel, SIZE);
        let d = p - ray.origin;
        prop_assert!((d - ray.direction * d.dot(ray.direction)).length() < 1e-9);
    }

    #[test]
    fn what_is_under_the_pointer_stays_there(camera in camera(), p in point(), factor in 0.2..5.0_f64) {
        let mut zoomed = camera;
        zoomed.zoom(factor, p);
        let at = |camera: &Camera| camera.project(p, SIZE).unwrap().0;
        prop_assert!(at(&camera).abs_diff_eq(at(&zoomed), 1e-6));
        let larger = zoomed.pixel_length(zoomed.distance, SIZE) / camera.pixel_length(camera.distance, SIZE);
        prop_assert!((larger * factor - 1.0).abs() < 1e-9);
    }

    #[test]
    fn panning_follows_the_pointer(camera in camera(), x in -200.0..200.0_f64, y in -200.0..200.0_f64) {
        let mut panned = camera;
        panned.pan(DVec2::new(x, y), SIZE);
        let at = |camera: &Camera| camera.project(camera.target - panned.target + camera.target, SIZE);
        let moved = panned.project(camera.target, SIZE).unwrap().0;
        prop_assert!(moved.abs_diff_eq(DVec2::new(320.0 + x, 240.0 + y), 1e-8), "{moved} {:?}", at(&camera));
    }

    #[test]
    fn all_of_a_box_is_framed(camera in camera(), wide in 0.3..3.0_f64) {
        let mut camera = camera;
        let (bounds, size) = ([DVec3::new(-1.0, 0.0, 2.0), DVec3::new(0.5, 3.0, 2.5)], [480.0 * wide, 480.0]);
        camera.frame(bounds, size);
        for i in 0..8 {
            let pick = |bit: usize, axis: usize| bounds[(i >> bit) & 1][axis];
            let corner = DVec3::new(pick(0, 0), pick(1, 1), pick(2, 2));
            let (pixel, _) = camera.project(corner, size).unwrap();
            prop_assert!(pixel.cmpge(DVec2::ZERO).all() && pixel.cmple(DVec2::from(size)).all(), "{pixel}");
        }
    }

    #[test]
    fn no_orbit_leaves_the_ball(moves in prop::collection::vec((-9.0..9.0_f64, -9.0..9.0_f64), 0..50)) {
        let mut camera = Camera::default();
        for (yaw, pitch) in moves {
            camera.orbit(yaw, pitch);
            prop_assert!(camera.is_valid());
        }
    }
}

#[test]
fn both_projections_show_the_target_alike() {
    let perspective = Camera::default();
    let flat = Camera { projection: Projection::Orthographic, ..perspective };
    let [right, up, _] = perspective.axes();
    let p = perspective.target + right * 0.2 - up * 0.1;
    let at = |camera: &Camera| camera.project(p, SIZE).unwrap().0;
    assert!(at(&perspective).abs_diff_eq(at(&flat), 1e-9));
}

#[test]
fn standard_views_look_along_axes() {
    let sides = [
        (Standard::Front, DVec3::Z, DVec3::NEG_Y),
        (Standard::Back, DVec3::NEG_Z, DVec3::Y),
        (Standard::Right, DVec3::X, DVec3::X),
        (Standard::Left, DVec3::NEG_X, DVec3::NEG_X),
        (Standard::Top, DVec3::Y, DVec3::Z),
        (Standard::Bottom, DVec3::NEG_Y, DVec3::NEG_Z),
    ];
    for (side, y_up, z_up) in sides {
        for (up, expected) in [(Up::Y, y_up), (Up::Z, z_up)] {
            let mut camera = Camera { up, ..Camera::default() };
            camera.look(side);
            assert!(camera.axes()[2].abs_diff_eq(expected, 1e-12), "{side:?} {up:?}: {}", camera.axes()[2]);
        }
    }
    let mut camera = Camera::default();
    camera.look(Standard::Isometric);
    let lengths =
        [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| axis.reject_from_normalized(camera.axes()[2]).length());
    assert!(lengths.iter().all(|l| (l - lengths[0]).abs() < 1e-12), "{lengths:?}");
}

#[test]
fn points_behind_the_eye_are_not_shown() {
    let camera = Camera::default();
    assert!(camera.project(camera.eye() + camera.axes()[2], SIZE).is_none());
    let nowhere = [DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY)];
    let [near, far] = camera.near_far(nowhere);
    assert!(0.0 < near && near < far);
}
