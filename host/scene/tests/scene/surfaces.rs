//! Splats and triangles against their geometry.
#![allow(clippy::unwrap_used, reason = "a test")]

use crate::common;

use common::{
    Model, RED, apart, at, difference, draw, draw_from, gpu, is_red, lit, plain, project, same, sphere, view,
};
use glam::camera::rh::proj::directx::orthographic;
use glam::{Mat2, Mat3, Vec2, Vec3};
use simod_picture::Image;
use simod_scene::{PixelScale, SceneStyle, SceneView, SurfaceMode};

/// Places of a picture, in the middle of each pixel, with their distances from the picture's middle.
fn pixels(image: &Image) -> impl Iterator<Item = ([f32; 2], f32)> {
    let (width, height) = (image.width(), image.height());
    let middle = 0.5 * Vec2::new(width as f32, height as f32);
    (0..width * height).map(move |i| {
        let place = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        (place.to_array(), place.distance(middle))
    })
}

/// Checks that a picture has nothing but the sphere inside the circle, and nothing of the sphere outside.
fn has_outline(image: &Image, radius: f32, tolerance: f32) {
    for (place, distance) in pixels(image) {
        if (distance - radius).abs() > tolerance {
            assert_eq!(is_red(image, place), distance < radius, "{place:?}, {distance} of {radius}");
        }
    }
}

#[test]
fn the_outline_is_the_projected_circle() {
    let Some(gpu) = gpu() else { return };
    let red = sphere(Vec3::ZERO, 1.0, 120).colored(RED);
    // The tangent cone of a unit sphere from a distance of 4.
    let radius = 120.0 * (0.25f32.asin().tan() / 0.3);
    for scale in [PixelScale::Full, PixelScale::Double] {
        for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
            has_outline(&draw(gpu, &red, &SceneStyle { mode, scale, ..plain() }), radius, 2.0);
        }
    }
    has_outline(&draw(gpu, &red, &SceneStyle { scale: PixelScale::Half, ..plain() }), radius, 4.0);
}

/// A hundred pixels to a unit everywhere.
fn parallel() -> SceneView {
    SceneView { projection: orthographic(-1.2, 1.2, -1.2, 1.2, 0.5, 8.0), ..view() }
}

#[test]
fn the_outline_in_parallel_projection() {
    let Some(gpu) = gpu() else { return };
    let red = sphere(Vec3::ZERO, 1.0, 120).colored(RED);
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        has_outline(&draw_from(gpu, &red, &SceneStyle { mode, ..plain() }, &parallel()), 100.0, 1.5);
    }
}

/// An ellipse lies as its half axes do, whichever side is seen, and however it is turned.
#[test]
fn the_outline_is_the_projected_ellipse() {
    let Some(gpu) = gpu() else { return };
    for (turn, side) in [(0.0, 1.0), (0.5, 1.0), (2.1, 1.0), (-0.7, -1.0)] {
        for tilt in [0.0, 0.9] {
            let turned = Mat3::from_rotation_x(tilt) * Mat3::from_rotation_z(turn);
            let axes = [turned * Vec3::X, turned * Vec3::Y * 0.3];
            let ellipse = Model {
                positions: vec![Vec3::ZERO],
                normals: vec![turned * Vec3::Z * side],
                radii: vec![1.0],
                axes: vec![axes],
                ..Model::default()
            };
            let image = draw_from(gpu, &ellipse.colored(RED), &plain(), &parallel());
            let mut inside = 0;
            for (place, _) in pixels(&image) {
                // The place is that where the pixel's ray meets the plane, in parts of the half axes, seen
                // from z.
                let seen = Vec2::new(place[0] - 120.0, 120.0 - place[1]) / 100.0;
                let foot = Mat2::from_cols(axes[0].truncate(), axes[1].truncate()).inverse() * seen;
                // A disc only blends with others near its border; how near depends on the angle between the
                // disc and the view.
                let share = if side > 0.0 { 0.6..0.9 } else { 0.3..0.9 };
                if !share.contains(&foot.length()) {
                    assert_eq!(is_red(&image, place), foot.length() < 0.6, "{turn} {tilt} {place:?}");
                    inside += usize::from(foot.length() < 0.6);
                }
            }
            assert!(inside > 500, "{inside}");
        }
    }
}

/// No holes down to splats much smaller than pixels, nor where discs are seen on edge.
#[test]
fn any_density_is_closed() {
    let Some(gpu) = gpu() else { return };
    let radius = 120.0 * (0.25f32.asin().tan() / 0.3);
    for (rows, tolerance) in [(40, 4.0), (250, 1.5)] {
        has_outline(&draw(gpu, &sphere(Vec3::ZERO, 1.0, rows).colored(RED), &plain()), radius, tolerance);
    }
}

/// Depths and normals are those of the sphere: so is the light.
#[test]
fn a_sphere_is_lit_as_the_formula_says() {
    let Some(gpu) = gpu() else { return };
    let color = [150, 160, 170];
    let model = sphere(Vec3::ZERO, 1.0, 120).colored(color);
    let eye = Vec3::new(0.0, 0.0, 4.0);
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        let image = draw(gpu, &model, &SceneStyle { mode, ..plain() });
        let mut worst = 0;
        for ([x, y], distance) in pixels(&image) {
            if distance > 85.0 {
                continue;
            }
            let ray = Vec3::new((x - 120.0) / 400.0, (120.0 - y) / 400.0, -1.0).normalize_or_zero();
            let nearest = -eye.dot(ray);
            let inside = 1.0 - (eye + ray * nearest).length_squared();
            let normal = eye + ray * (nearest - inside.sqrt());
            worst = worst.max(apart(lit(color, normal, -ray), at(&image, [x, y])));
        }
        assert!(worst <= 5, "{mode:?}: {worst}");
    }
}

#[test]
fn splats_and_triangles_agree() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::new(-0.2, 0.0, 0.0), 0.8, 90).and(&sphere(Vec3::new(0.6, 0.3, 0.5), 0.4, 60));
    let splats = draw(gpu, &model, &SceneStyle::default());
    let triangles = draw(gpu, &model, &SceneStyle { mode: SurfaceMode::Triangles, ..SceneStyle::default() });
    let (_, beyond) = difference(&splats, &triangles, 10);
    assert!(beyond < 0.02, "{beyond} of the pixels differ");
}

#[test]
fn what_is_in_front_hides_what_is_behind() {
    let Some(gpu) = gpu() else { return };
    let front = sphere(Vec3::new(0.0, 0.0, 0.5), 0.4, 60).colored(RED);
    let behind = sphere(Vec3::new(0.0, 0.0, -0.6), 0.9, 90).colored([40, 60, 200]);
    // In either order of the samples.
    for model in [front.clone().and(&behind), behind.and(&front)] {
        for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
            let image = draw(gpu, &model, &SceneStyle { mode, ..plain() });
            for ([x, y], distance) in pixels(&image) {
                let [r, _, b] = at(&image, [x, y]);
                if distance < 43.0 {
                    assert!(r > b + 12, "{mode:?} at {x}, {y}: {r}, {b}");
                } else if (50.0..75.0).contains(&distance) {
                    assert!(b > r + 12, "{mode:?} at {x}, {y}: {r}, {b}");
                }
            }
        }
    }
}

/// A plate that faces the eye, two sheets a little apart: the colour of the front one alone, as it was given.
#[test]
fn colours_come_out_as_they_were_given() {
    let Some(gpu) = gpu() else { return };
    let plate = |z: f32, color| {
        let positions: Vec<Vec3> = (0..3600)
            .map(|i| Vec3::new((i % 60) as f32 / 30.0 - 1.0, (i / 60) as f32 / 30.0 - 1.0, z))
            .collect();
        Model { normals: vec![Vec3::Z; 3600], radii: vec![0.045; 3600], positions, ..Model::default() }
            .colored(color)
    };
    for color in [[200, 30, 90], [10, 120, 250], [128, 128, 128], [0, 0, 0]] {
        let model = plate(0.0, color).and(&plate(-0.1, [255, 255, 255]));
        let image = draw(gpu, &model, &plain());
        for point in [Vec3::ZERO, Vec3::new(0.5, -0.4, 0.0), Vec3::new(-0.7, 0.6, 0.0)] {
            let eye = (Vec3::new(0.0, 0.0, 4.0) - point).normalize_or_zero();
            let (shown, expected) = (at(&image, project(&view(), point)), lit(color, Vec3::Z, eye));
            assert!(apart(shown, expected) <= 3, "{color:?}: {shown:?} instead of {expected:?}");
        }
    }
    // Without colours of its own, and in clay.
    let white = Model { colors: None, ..plate(0.0, [0; 3]) };
    let expected = lit([255; 3], Vec3::Z, Vec3::Z);
    assert!(apart(at(&draw(gpu, &white, &plain()), [120.0; 2]), expected) <= 3);
    let clay = SceneStyle { own_colors: false, ..plain() };
    let [r, g, b] = at(&draw(gpu, &plate(0.0, [0, 0, 255]), &clay), [120.0; 2]);
    assert!(r > g && g > b, "{r} {g} {b}");
}

/// Normals may have any length, and may be unknown: the depths tell then.
#[test]
fn normals_of_any_kind() {
    let Some(gpu) = gpu() else { return };
    let good = sphere(Vec3::ZERO, 1.0, 100);
    let image = draw(gpu, &good, &plain());
    let scaled = Model { normals: good.normals.iter().map(|n| *n * 7.5).collect(), ..good.clone() };
    assert!(difference(&image, &draw(gpu, &scaled, &plain()), 1).1 < 0.01);
    for unknown in [Vec3::ZERO, Vec3::NAN] {
        let without = Model { normals: vec![unknown; good.normals.len()], ..good.clone() };
        let (_, beyond) = difference(&image, &draw(gpu, &without, &plain()), 60);
        assert!(beyond < 0.06, "{beyond}");
    }
}

#[test]
fn samples_that_are_not_finite_are_left_out() {
    let Some(gpu) = gpu() else { return };
    let good = sphere(Vec3::ZERO, 0.8, 60).colored(RED);
    let mut bad = good.clone();
    for (i, x) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].into_iter().cycle().enumerate().take(300) {
        bad.positions[i * 20][i % 3] = x;
    }
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        let style = SceneStyle { mode, ..plain() };
        let image = draw(gpu, &bad, &style);
        for (place, distance) in pixels(&image) {
            assert!(distance < 90.0 || !is_red(&image, place), "{mode:?} at {place:?}");
        }
        let (_, beyond) = difference(&image, &draw(gpu, &good, &style), 60);
        assert!(beyond < 0.15, "{mode:?}: {beyond}");
    }
    bad.positions.fill(Vec3::NAN);
    assert!(same(&draw(gpu, &bad, &plain()), &draw(gpu, &Model::default(), &plain())));
}

/// Seen from the back, a sheet shows only where both sides are asked for.
#[test]
fn one_side_or_both() {
    let Some(gpu) = gpu() else { return };
    let mut sheet = sphere(Vec3::ZERO, 0.8, 60).colored(RED);
    // The half of the sphere behind, whose inside is seen.
    let keep = |p: &Vec3| p.z < 0.0;
    let kept: Vec<bool> = sheet.positions.iter().map(keep).collect();
    sheet.triangles.retain(|t| t.iter().all(|i| kept[*i as usize]));
    sheet.positions.iter_mut().filter(|p| !keep(p)).for_each(|p| *p = Vec3::NAN);
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        let both = draw(gpu, &sheet, &SceneStyle { mode, ..plain() });
        let one = draw(gpu, &sheet, &SceneStyle { mode, two_sided: false, ..plain() });
        assert!(is_red(&both, [120.0; 2]), "{mode:?}");
        assert!(!is_red(&one, [120.0; 2]), "{mode:?}");
    }
}

/// Crevices are darker, open surfaces are not.
#[test]
fn occlusion_darkens_crevices() {
    let Some(gpu) = gpu() else { return };
    let style = |occlusion| SceneStyle { occlusion, ..SceneStyle::default() };
    let open = sphere(Vec3::ZERO, 1.0, 100);
    let (worst, _) = difference(&draw(gpu, &open, &style(true)), &draw(gpu, &open, &style(false)), 0);
    assert!(worst <= 8, "{worst}");
    let touching =
        sphere(Vec3::new(-0.5, 0.0, 0.0), 0.52, 80).and(&sphere(Vec3::new(0.5, 0.0, 0.0), 0.52, 80));
    let [with, without] = [true, false].map(|on| at(&draw(gpu, &touching, &style(on)), [120.0; 2])[1]);
    assert!(with < without - 8, "{with}, {without}");
}
