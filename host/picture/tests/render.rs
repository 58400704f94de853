//! Pictures: determinism, silhouettes, and input that is no good.
#![allow(clippy::unwrap_used, reason = "a failing helper fails the test")]

use glam::{DVec3, Vec3};
use simod_generate::{Shape, Surface};
use simod_picture::{Image, PictureCamera, Renderer, Spacing, Style, SurfaceDisc};

const BOX: [DVec3; 2] = [DVec3::splat(-1.0), DVec3::splat(1.0)];

fn draw(size: [u32; 2], camera: PictureCamera, style: Style, points: &[SurfaceDisc], chunk: usize) -> Image {
    let mut renderer = Renderer::new(size[0], size[1], camera, style);
    points.chunks(chunk).for_each(|points| renderer.depth(points));
    points.chunks(chunk).for_each(|points| renderer.blend(points));
    renderer.finish()
}

fn points(shape: Shape, vertices: u64) -> (Vec<SurfaceDisc>, [DVec3; 2]) {
    let mut points = Vec::new();
    Surface::new(shape, vertices)
        .unwrap()
        .visit_vertices(|block| {
            points.extend(block.iter().map(|vertex| SurfaceDisc {
                position: vertex.position,
                normal: vertex.normal,
                color: vertex.color,
                radius: 0.0,
            }));
            Ok(())
        })
        .unwrap();
    let bounds = points
        .iter()
        .fold([DVec3::MAX, DVec3::MIN], |[low, high], p| [low.min(p.position), high.max(p.position)]);
    let mut spacing = Spacing::new(bounds);
    spacing.add(points.iter().map(|p| p.position));
    for point in &mut points {
        point.radius = spacing.radius_at(point.position);
    }
    (points, bounds)
}

/// Points of the unit sphere, evenly spread.
fn sphere(count: u32) -> Vec<SurfaceDisc> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let radius = (1.35 * (4.0 * std::f64::consts::PI / f64::from(count)).sqrt()) as f32;
    (0..count)
        .map(|i| {
            let y = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let (sin, cos) = (golden * f64::from(i)).sin_cos();
            let position = DVec3::new((1.0 - y * y).sqrt() * cos, y, (1.0 - y * y).sqrt() * sin);
            SurfaceDisc { position, normal: position.as_vec3(), color: [200, 20, 20], radius }
        })
        .collect()
}

#[test]
fn other_colours_of_the_same_points_are_another_picture() {
    // More than are drawn at a time.
    let (points, bounds) = points(Shape::Amphora, 80_000);
    let camera = PictureCamera::frame(bounds, 0.4, 0.2, 0.8);
    let style = Style { own_colors: true, ground: Some(0.0) };
    let other = |point: &SurfaceDisc| point.color.map(|c| c.wrapping_mul(7).wrapping_add(c / 2));
    let others: Vec<[u8; 3]> = points.iter().map(other).collect();
    let mut renderer = Renderer::new(96, 120, camera, style);
    renderer.depth(&points);
    renderer.blend_both(&points, &others);
    let recolored: Vec<SurfaceDisc> =
        points.iter().map(|point| SurfaceDisc { color: other(point), ..*point }).collect();
    let each = [&points, &recolored].map(|points| draw([96, 120], camera, style, points, usize::MAX));
    assert_ne!(each[0], each[1]);
    assert_eq!(renderer.finish_both(), each);
}

#[test]
fn the_same_bytes_for_any_threads_and_chunks() {
    let (points, bounds) = points(Shape::Amphora, 30_000);
    let camera = PictureCamera::frame(bounds, 0.4, 0.2, 0.8);
    let style = Style { own_colors: true, ground: Some(0.0) };
    let png = |threads, chunk| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| draw([160, 200], camera, style, &points, chunk).to_png().unwrap())
    };
    let one = png(1, 1 << 20);
    assert!(one == png(2, 1 << 20));
    assert!(one == png(3, 777));
}

#[test]
fn silhouette_of_a_sphere() {
    let (width, height) = (300, 240);
    let camera = PictureCamera::frame(BOX, 0.3, -0.5, f64::from(width) / f64::from(height));
    let image = draw([width, height], camera, Style::default(), &sphere(50_000), 10_000);

    // The circle where rays from the eye touch the sphere.
    let eye = camera.position();
    let distance = eye.length();
    let toward = eye / distance;
    let side = toward.cross(DVec3::Y).normalize_or_zero();
    let touching = toward / distance + side * (1.0 - 1.0 / (distance * distance)).sqrt();
    let [cx, cy] = camera.project(DVec3::ZERO, width, height).unwrap();
    let [tx, ty] = camera.project(touching, width, height).unwrap();
    let radius = (tx - cx).hypot(ty - cy);
    assert!(radius > 60.0);

    for y in 0..height {
        for x in 0..width {
            let [red, green, _] = image.pixel(x, y).unwrap();
            let on_sphere = i32::from(red) - i32::from(green) > 20;
            let from_edge = (x as f32 + 0.5 - cx).hypot(y as f32 + 0.5 - cy) - radius;
            assert!(!on_sphere || from_edge < 1.5, "red outside, at {x} {y}");
            assert!(on_sphere || from_edge > -1.5, "a hole at {x} {y}");
        }
    }
}

#[test]
fn light_comes_from_the_upper_left() {
    let camera = PictureCamera::frame(BOX, 0.0, 0.0, 1.0);
    let style = Style { own_colors: false, ground: None };
    let image = draw([200, 200], camera, style, &sphere(50_000), 50_000);
    let at = |x, y| image.pixel(x, y).unwrap()[1];
    assert!(at(75, 70) > at(100, 100) && at(100, 100) > at(125, 140));
    // Without normals, the depth tells nearly the same.
    let bare: Vec<_> = sphere(50_000).into_iter().map(|p| SurfaceDisc { normal: Vec3::ZERO, ..p }).collect();
    let derived = draw([200, 200], camera, style, &bare, 50_000);
    for (x, y) in [(75, 70), (100, 100), (125, 140), (60, 120)] {
        let difference = i32::from(at(x, y)) - i32::from(derived.pixel(x, y).unwrap()[1]);
        assert!(difference.abs() < 16, "{difference} at {x} {y}");
    }
}

#[test]
fn no_holes_at_normal_density() {
    let (points, bounds) = points(Shape::Plane, 20_000);
    // From above, the whole inside of the square is covered.
    let camera = PictureCamera::frame(bounds, 0.0, 1.5, 1.0);
    let black: Vec<_> = points.iter().map(|p| SurfaceDisc { color: [0; 3], ..*p }).collect();
    let image = draw([300, 300], camera, Style::default(), &black, 1 << 16);
    let inside = (60..240).flat_map(|y| (60..240).map(move |x| (x, y)));
    let light = inside.filter(|&(x, y)| image.pixel(x, y).unwrap()[0] > 120).count();
    assert_eq!(light, 0);
}

/// A sphere of triangles: rings of so many corners, with normals or without.
fn ball(rings: u32, normals: bool) -> Vec<[SurfaceDisc; 3]> {
    let at = |i: u32, k: u32| {
        let (down, round) = (f64::from(i) / f64::from(rings), f64::from(k % rings) / f64::from(rings));
        let ((sin, cos), (s, c)) =
            ((std::f64::consts::PI * down).sin_cos(), (std::f64::consts::TAU * round).sin_cos());
        let position = DVec3::new(sin * c, cos, sin * s);
        let normal = if normals { position.as_vec3() } else { Vec3::ZERO };
        SurfaceDisc { position, normal, color: [200, 20, 20], radius: 0.0 }
    };
    let quads = (0..rings).flat_map(|i| (0..rings).map(move |k| (i, k)));
    quads
        .flat_map(|(i, k)| {
            let [a, b, c, d] = [at(i, k), at(i + 1, k), at(i + 1, k + 1), at(i, k + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

fn draw_triangles(
    size: [u32; 2],
    camera: PictureCamera,
    triangles: &[[SurfaceDisc; 3]],
    chunk: usize,
) -> Image {
    let mut renderer =
        Renderer::new(size[0], size[1], camera, Style { own_colors: true, ground: Some(-1.0) });
    triangles.chunks(chunk).for_each(|some| renderer.depth_of_triangles(some));
    triangles.chunks(chunk).for_each(|some| renderer.blend_triangles(some));
    renderer.finish()
}

#[test]
fn triangles_of_any_size_make_the_same_ball() {
    let camera = PictureCamera::frame(BOX, 0.3, 0.2, 1.0);
    // From triangles of many pixels to some hundred of them on each pixel; and as splats.
    let splats =
        draw([100, 100], camera, Style { own_colors: true, ground: Some(-1.0) }, &sphere(50_000), 9999);
    for (rings, most) in [(60, 3.0), (200, 2.5), (1000, 2.5)] {
        let image = draw_triangles([100, 100], camera, &ball(rings, true), 1 << 16);
        let difference = |(a, b): (&[u8; 3], &[u8; 3])| {
            a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0
        };
        let mean = image.pixels().iter().zip(splats.pixels()).map(difference).sum::<f64>() / 10_000.0;
        assert!(mean < most, "{rings} rings: {mean} of 255");
        // No hole: all of the middle is red.
        let middle = (30..70).flat_map(|y| (30..70).map(move |x| (x, y)));
        let holes = middle.filter(|&(x, y)| image.pixel(x, y).is_some_and(|[r, g, _]| r < g + 20)).count();
        assert_eq!(holes, 0, "{rings} rings");
    }
}

#[test]
fn triangles_are_the_same_for_any_threads_and_chunks() {
    let camera = PictureCamera::frame(BOX, 0.3, 0.2, 0.8);
    let triangles = ball(150, false);
    let png = |threads, chunk| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| draw_triangles([160, 200], camera, &triangles, chunk).to_png().unwrap())
    };
    let one = png(1, 1 << 20);
    assert!(one == png(2, 1 << 20));
    assert!(one == png(3, 777));
}

#[test]
fn the_nearer_triangle_hides_the_other_from_either_side() {
    let camera = PictureCamera::frame(BOX, 0.0, 0.0, 1.0);
    let triangle = |z: f64, color: [u8; 3]| {
        let at = |x: f64, y: f64| SurfaceDisc {
            position: DVec3::new(x, y, z),
            normal: Vec3::ZERO,
            color,
            radius: 0.0,
        };
        [at(-1.0, -1.0), at(1.0, -1.0), at(0.0, 1.0)]
    };
    let (near, far) = (triangle(0.5, [250, 0, 0]), triangle(-0.5, [0, 0, 250]));
    let [a, b, c] = near;
    for triangles in [[near, far], [far, near], [[c, b, a], far]] {
        let [red, _, blue] = draw_triangles([80, 80], camera, &triangles, 1).pixel(40, 40).unwrap();
        assert!(red > 3 * blue, "{red}, {blue}");
    }
    // Corners that are nowhere, behind the eye, or all at one place.
    let background = draw_triangles([80, 80], camera, &[], 1);
    let nowhere = |p: DVec3| [SurfaceDisc { position: p, ..a }, b, c];
    let useless = [nowhere(DVec3::NAN), nowhere(DVec3::splat(1e300)), nowhere(camera.position() * 2.0)];
    let shadowless = |triangles: &[[SurfaceDisc; 3]]| {
        let mut renderer = Renderer::new(80, 80, camera, Style::default());
        renderer.depth_of_triangles(triangles);
        renderer.blend_triangles(triangles);
        renderer.finish()
    };
    assert!(shadowless(&useless) == shadowless(&[]));
    assert!(draw_triangles([80, 80], camera, &[[a; 3]], 1) != background);
}

#[test]
fn useless_points_leave_the_background() {
    let camera = PictureCamera::frame(BOX, 0.0, 0.0, 1.0);
    let style = Style { own_colors: true, ground: Some(-1.0) };
    let background = draw([40, 40], camera, style, &[], 1);
    let good = SurfaceDisc { position: DVec3::ZERO, normal: Vec3::Z, color: [255, 0, 0], radius: 0.1 };
    let useless = [
        SurfaceDisc { position: DVec3::new(f64::NAN, 0.0, 0.0), ..good },
        SurfaceDisc { position: DVec3::splat(f64::INFINITY), ..good },
        SurfaceDisc { position: DVec3::splat(-1e300), ..good },
        SurfaceDisc { position: camera.position() * 2.0, ..good },
        SurfaceDisc { position: camera.position(), ..good },
        SurfaceDisc { radius: f32::NAN, ..good },
        SurfaceDisc { radius: -1.0, ..good },
    ];
    let shadowless = Style { ground: None, ..style };
    let background_without = draw([40, 40], camera, shadowless, &[], 1);
    assert!(draw([40, 40], camera, shadowless, &useless, 3) == background_without);
    assert!(background.pixels().iter().all(|&[r, g, b]| r > 180 && g > 180 && b > 180));
    // Odd, but of use: normals that are not finite are as none, and radii have bounds.
    for point in [
        SurfaceDisc { normal: Vec3::NAN, ..good },
        SurfaceDisc { normal: Vec3::INFINITY, ..good },
        SurfaceDisc { radius: f32::INFINITY, ..good },
        SurfaceDisc { radius: 0.0, ..good },
    ] {
        assert!(draw([40, 40], camera, style, &[point], 1) != background);
    }
}

#[test]
fn smallest_pictures() {
    for size in [[1, 1], [0, 0], [1, 7], [7, 1]] {
        let camera = PictureCamera::frame(BOX, 0.0, 0.0, 1.0);
        let style = Style { own_colors: true, ground: Some(-1.0) };
        let image = draw(size, camera, style, &sphere(1000), 100);
        assert!(!image.to_png().unwrap().is_empty());
    }
}
