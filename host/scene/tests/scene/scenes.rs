//! Scenes that change: budgets, drags, ghosts, marks; and inputs that must do no harm.
#![allow(clippy::unwrap_used, reason = "a test")]

use crate::common;

use std::time::Duration;

use common::{
    Model, RED, apart, at, difference, draw, draw_from, gpu, is_red, plain, project, same, sphere, view,
};
use glam::{Vec3, Vec4};
use simod_picture::Image;
use simod_scene::{
    Background, BadSurface, Budget, Dot, Gpu, Light, Line, Matcap, NoGpu, PixelScale, Scene, SceneStyle,
    SceneSurface, SceneView, SurfaceMode,
};

fn scene_of(gpu: &Gpu, model: &Model) -> Scene {
    let mut scene = Scene::new(gpu);
    scene.set_surface(&model.surface()).unwrap();
    scene
}

fn shot(scene: &mut Scene, style: &SceneStyle) -> Image {
    scene.render(&view(), style, None);
    scene.read().unwrap()
}

/// A budget of a slow machine, of at most so many splats.
fn budget_of(splats: usize) -> Budget {
    let mut budget = Budget::new(Duration::from_secs(1));
    while budget.splats() > splats {
        budget.learn(Duration::from_secs(2), false);
    }
    budget
}

/// A part of the samples shows the same surface without holes, through which the blue one inside would be
/// seen; and then the rest comes, to the picture that is drawn at once.
#[test]
fn a_part_is_closed_and_the_rest_follows() {
    let Some(gpu) = gpu() else { return };
    let model =
        sphere(Vec3::ZERO, 1.0, 200).colored(RED).and(&sphere(Vec3::ZERO, 0.7, 30).colored([30, 50, 220]));
    let style = SceneStyle { scale: PixelScale::Full, ..plain() };
    let complete = shot(&mut scene_of(gpu, &model), &style);

    for most in [64_000, 32_000, 16_000] {
        let mut budget = budget_of(most);
        assert!(!budget.is_coarse());
        let mut scene = scene_of(gpu, &model);
        scene.render(&view(), &style, Some(&mut budget));
        let drawn = scene.drawn();
        assert!(drawn.of == model.positions.len() && !drawn.complete);
        assert!((most / 4..=most).contains(&drawn.drawn), "{drawn:?} within {most}");
        let part = scene.read().unwrap();
        for (x, y) in (0..240).flat_map(|x| (0..240).map(move |y| (x as f32 + 0.5, y as f32 + 0.5))) {
            if (x - 120.0).hypot(y - 120.0) < 101.0 {
                assert!(is_red(&part, [x, y]), "{drawn:?} at {x}, {y}");
            }
        }
        let (_, beyond) = difference(&part, &complete, 16);
        assert!(beyond < 0.03, "{drawn:?}: {beyond}");

        let mut frames = 0;
        while !scene.drawn().complete {
            scene.render(&view(), &style, Some(&mut budget));
            frames += 1;
            assert!(frames < 100);
        }
        assert!(frames > 1);
        assert_eq!(scene.drawn().drawn, model.positions.len());
        assert!(same(&scene.read().unwrap(), &complete));
    }
}

/// A slow machine draws moving frames in fewer pixels, and the last one in all.
#[test]
fn coarse_frames_become_fine_at_rest() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::ZERO, 1.0, 60).colored(RED);
    let complete = draw(gpu, &model, &plain());
    let mut budget = Budget::new(Duration::from_nanos(1));
    for _ in 0..20 {
        budget.learn(Duration::from_secs(1), false);
    }
    assert!(budget.is_coarse());
    let mut scene = scene_of(gpu, &model);
    scene.render(&view(), &plain(), Some(&mut budget));
    assert!(!scene.drawn().complete);
    assert!(difference(&scene.read().unwrap(), &complete, 40).1 < 0.05);
    while !scene.drawn().complete {
        scene.render(&view(), &plain(), Some(&mut budget));
    }
    assert!(same(&scene.read().unwrap(), &complete));
}

#[test]
fn a_drag_moves_the_surface() {
    let Some(gpu) = gpu() else { return };
    let from = sphere(Vec3::new(-0.5, 0.0, 0.0), 0.4, 50).colored(RED);
    let to = sphere(Vec3::new(0.5, 0.1, 0.0), 0.4, 50).colored(RED);
    let mut scene = scene_of(gpu, &from);
    let before = shot(&mut scene, &plain());
    for (step, mode) in
        [(0.3, SurfaceMode::Splats), (1.0, SurfaceMode::Triangles), (1.0, SurfaceMode::Splats)]
    {
        let positions: Vec<Vec3> =
            from.positions.iter().zip(&to.positions).map(|(a, b)| a.lerp(*b, step)).collect();
        scene.set_positions(&positions, &to.normals).unwrap();
        shot(&mut scene, &SceneStyle { mode, ..plain() });
    }
    let after = scene.read().unwrap();
    let place = project(&view(), Vec3::new(0.5, 0.1, 0.0));
    assert!(is_red(&after, place) && !is_red(&before, place));
    // Nothing of the way there is left.
    assert!(difference(&after, &draw(gpu, &to, &plain()), 4).1 < 0.002);

    let blue = vec![[30, 40, 230]; from.positions.len()];
    scene.set_colors(&to.radii, Some(&blue)).unwrap();
    assert!(!is_red(&shot(&mut scene, &plain()), place));
}

/// While a part of the samples is drawn, no more of them have to be up to date: the picture is that of a
/// surface that has moved as a whole. More samples follow, up to all.
#[test]
fn a_part_of_the_surface_moves_alone() {
    let Some(gpu) = gpu() else { return };
    let from = sphere(Vec3::new(-0.3, 0.0, 0.0), 0.6, 200).colored(RED);
    let to = sphere(Vec3::new(0.3, 0.1, 0.0), 0.7, 200).colored([30, 50, 220]);
    let style = SceneStyle { mode: SurfaceMode::Triangles, ..plain() };
    let some = |scene: &mut Scene, reach: usize| {
        let first = scene.first(reach);
        assert!(first.len() == reach && first.is_sorted());
        let of = |i: &u32| *i as usize;
        let (positions, normals): (Vec<Vec3>, Vec<Vec3>) =
            first.iter().map(|i| (to.positions[of(i)], to.normals[of(i)])).unzip();
        let radii: Vec<f32> = first.iter().map(|i| to.radii[of(i)]).collect();
        let colors: Vec<[u8; 3]> = first.iter().map(|i| to.colors.as_ref().unwrap()[of(i)]).collect();
        let surface = SceneSurface {
            positions: &positions,
            normals: &normals,
            radii: &radii,
            colors: Some(&colors),
            ..SceneSurface::default()
        };
        scene.place_first(&surface).unwrap();
        let short = SceneSurface { positions: &positions[1..], ..surface };
        assert!(matches!(scene.place_first(&short), Err(BadSurface::Length { .. })));
    };
    let (mut moved, mut whole) = (scene_of(gpu, &from), scene_of(gpu, &from));
    let mut budgets = [budget_of(16_000), budget_of(16_000)];
    moved.render(&view(), &style, Some(&mut budgets[0]));
    moved.outdate();
    assert!(!moved.is_of(&view(), &style));
    let reach = moved.reach(&view(), &style, Some(&budgets[0]));
    assert!((4_000..=16_000).contains(&reach), "{reach}");
    some(&mut moved, reach);
    whole.outdate();
    whole.place_all(&to.surface()).unwrap();
    moved.render(&view(), &SceneStyle { mode: SurfaceMode::Splats, ..style }, Some(&mut budgets[0]));
    whole.render(&view(), &SceneStyle { mode: SurfaceMode::Splats, ..style }, Some(&mut budgets[1]));
    assert!(moved.drawn() == whole.drawn() && !moved.drawn().complete);
    assert!(same(&moved.read().unwrap(), &whole.read().unwrap()));

    // At rest more and more of it is asked for, and at last all: then triangles can be drawn.
    let style = plain();
    let mut asked = reach;
    while !moved.drawn().complete {
        let reach = moved.reach(&view(), &style, Some(&budgets[0]));
        assert!(reach >= asked, "{reach} after {asked}");
        if reach > asked {
            some(&mut moved, reach);
            asked = reach;
        }
        moved.render(&view(), &style, Some(&mut budgets[0]));
    }
    assert_eq!(asked, to.positions.len());
    assert!(same(&moved.read().unwrap(), &shot(&mut scene_of(gpu, &to), &style)));
    let triangles = SceneStyle { mode: SurfaceMode::Triangles, ..style };
    assert!(same(&shot(&mut moved, &triangles), &shot(&mut scene_of(gpu, &to), &triangles)));
}

#[test]
fn a_ghost_is_seen_beside_and_through_the_surface() {
    let Some(gpu) = gpu() else { return };
    let surface = sphere(Vec3::new(0.4, 0.0, 0.0), 0.5, 60);
    let mut scene = scene_of(gpu, &surface);
    for background in [Background::Light, Background::Dark] {
        let style = SceneStyle { background, ..SceneStyle::default() };
        let [beside, front, far] =
            [[-0.5, 0.0, 0.0], [0.15, 0.0, 0.3], [0.0, 1.0, 0.0]].map(|p| project(&view(), Vec3::from(p)));
        let without = shot(&mut scene, &style);
        let ghost = sphere(Vec3::new(-0.2, 0.0, 0.5), 0.5, 60);
        scene.set_ghost(Some(&ghost.surface())).unwrap();
        let with = shot(&mut scene, &style);
        for place in [beside, front] {
            let (a, b) = (at(&without, place), at(&with, place));
            assert!(apart(a, b) > 12, "{place:?}: {a:?}, {b:?}");
        }
        assert_eq!(at(&without, far), at(&with, far));
        // A ghost without opacity leaves the picture as it is.
        assert!(
            difference(&shot(&mut scene, &SceneStyle { ghost_opacity: 0.0, ..style }), &without, 1).1 == 0.0
        );
        // A ghost at the surface's own place leaves no stains.
        scene.set_ghost(Some(&surface.surface())).unwrap();
        assert!(difference(&shot(&mut scene, &style), &without, 12).1 < 0.01);
        scene.set_ghost(None).unwrap();
        assert!(same(&shot(&mut scene, &style), &without));
    }
}

#[test]
fn marks_before_behind_and_on_top() {
    let Some(gpu) = gpu() else { return };
    let mut scene = scene_of(gpu, &sphere(Vec3::ZERO, 0.6, 80));
    let line = |y: f32, z: f32, on_top| Line {
        a: Vec3::new(-1.0, y, z),
        b: Vec3::new(1.0, y, z),
        color: [0, 160, 0, 255],
        width_px: 3.0,
        on_top,
    };
    scene.set_lines(&[line(0.1, 0.9, false), line(-0.1, -0.9, false), line(-0.3, -0.9, true)]);
    let dot = |x: f32, z: f32, on_top| Dot {
        position: Vec3::new(x, 0.3, z),
        color: [200, 0, 200, 255],
        size_px: 9.0,
        on_top,
    };
    scene.set_dots(&[dot(-0.3, 0.9, false), dot(0.0, -0.9, false), dot(0.3, -0.9, true)]);
    let image = shot(&mut scene, &plain());
    let shows = |point: [f32; 3], color| apart(at(&image, project(&view(), Vec3::from(point))), color) < 12;
    let (green, violet) = ([0, 160, 0], [200, 0, 200]);
    assert!(shows([0.0, 0.1, 0.9], green) && shows([0.85, 0.1, 0.9], green));
    assert!(!shows([0.0, -0.1, -0.9], green) && shows([0.85, -0.1, -0.9], green));
    assert!(shows([0.0, -0.3, -0.9], green));
    assert!(shows([-0.3, 0.3, 0.9], violet) && !shows([0.0, 0.3, -0.9], violet));
    assert!(shows([0.3, 0.3, -0.9], violet));

    // Marks alone change without the surface being drawn again, and leave nothing behind.
    scene.set_lines(&[]);
    scene.set_dots(&[]);
    assert!(same(&shot(&mut scene, &plain()), &draw(gpu, &sphere(Vec3::ZERO, 0.6, 80), &plain())));
}

/// Lines to behind the eye, without an end, or without a length.
#[test]
fn odd_marks_do_no_harm() {
    let Some(gpu) = gpu() else { return };
    let mut scene = Scene::new(gpu);
    let line = |a, b| Line { a, b, color: [200, 0, 0, 255], width_px: 3.0, on_top: true };
    scene.set_lines(&[
        line(Vec3::new(0.0, 0.0, 0.0), Vec3::new(0.3, 0.0, 30.0)),
        line(Vec3::NAN, Vec3::ZERO),
        line(Vec3::new(0.0, 0.0, 9.0), Vec3::new(1.0, 0.0, 30.0)),
        line(Vec3::new(-0.5, 0.5, 0.0), Vec3::new(-0.5, 0.5, 0.0)),
    ]);
    let image = shot(&mut scene, &plain());
    let red = |p: [f32; 3]| is_red(&image, project(&view(), Vec3::from(p)));
    assert!(
        red([0.01, 0.0, 1.0]) && red([-0.5, 0.5, 0.0]) && !red([0.5, -0.5, 0.0]) && !red([-0.3, 0.0, 0.0])
    );
}

#[test]
fn an_empty_scene_is_its_background() {
    let Some(gpu) = gpu() else { return };
    let mut scene = Scene::new(gpu);
    assert!(scene.read().is_none());
    let empty = shot(&mut scene, &SceneStyle::default());
    assert!(empty.pixels().iter().all(|p| p[0] > 200 && p[0] <= p[2]));
    assert!(scene.drawn().complete && scene.drawn().of == 0);
    scene.set_surface(&SceneSurface::default()).unwrap();
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        assert!(same(&shot(&mut scene, &SceneStyle { mode, ..SceneStyle::default() }), &empty));
    }
    let dark = shot(&mut scene, &SceneStyle { background: Background::Dark, ..SceneStyle::default() });
    assert!(dark.pixels().iter().all(|p| p[0] < 90));
}

#[test]
fn views_of_any_size() {
    let Some(gpu) = gpu() else { return };
    let mut scene = scene_of(gpu, &sphere(Vec3::ZERO, 0.8, 30).colored(RED));
    for scale in [PixelScale::Half, PixelScale::Full, PixelScale::Double] {
        for size in [[0, 0], [0, 7], [1, 1], [3, 500], [333, 77], [0, 0]] {
            scene.render(&SceneView { size, ..view() }, &SceneStyle { scale, ..plain() }, None);
            let image = scene.read().unwrap();
            assert_eq!([image.width(), image.height()], size.map(|s| s.max(1)));
            let middle = [image.width() as f32 / 2.0, image.height() as f32 / 2.0];
            assert!(is_red(&image, middle), "{size:?} {scale:?}");
        }
    }
}

#[test]
fn the_same_picture_twice_has_the_same_bytes() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::new(-0.2, 0.1, 0.0), 0.8, 100).and(&sphere(Vec3::new(0.5, 0.3, 0.5), 0.3, 40));
    let first = draw(gpu, &model, &SceneStyle::default());
    assert!(same(&draw(gpu, &model, &SceneStyle::default()), &first));
    // Nor does it depend on what was drawn before.
    let mut scene = scene_of(gpu, &sphere(Vec3::ZERO, 1.0, 30));
    shot(&mut scene, &SceneStyle { scale: PixelScale::Double, ..SceneStyle::default() });
    scene.set_surface(&model.surface()).unwrap();
    assert!(same(&shot(&mut scene, &SceneStyle::default()), &first));
    let turned = SceneView { view: view().view * glam::Mat4::from_rotation_y(0.7), ..view() };
    assert!(!same(&draw_from(gpu, &model, &SceneStyle::default(), &turned), &first));
}

#[test]
fn lists_that_do_not_fit_are_refused() {
    let Some(gpu) = gpu() else { return };
    let good = sphere(Vec3::ZERO, 0.8, 20);
    let mut scene = scene_of(gpu, &good);
    let before = shot(&mut scene, &plain());
    let refused = |error: BadSurface, text: &str| assert_eq!(error.to_string().lines().next(), Some(text));
    let n = good.positions.len();
    let short = SceneSurface { normals: &good.normals[1..], ..good.surface() };
    refused(scene.set_surface(&short).unwrap_err(), &format!("normals: {} for {n} samples", n - 1));
    let colors = SceneSurface { colors: Some(&[[0; 3]; 2]), ..good.surface() };
    refused(scene.set_surface(&colors).unwrap_err(), &format!("colours: 2 for {n} samples"));
    let axes = SceneSurface { axes: &[[Vec3::X; 2]; 3], ..good.surface() };
    refused(scene.set_surface(&axes).unwrap_err(), &format!("axes: 3 for {n} samples"));
    let triangles = SceneSurface { triangles: &[[0, 1, 2], [0, 9999, 1]], ..good.surface() };
    refused(scene.set_surface(&triangles).unwrap_err(), &format!("triangle 1 has sample 9999 of {n}"));
    refused(scene.set_positions(&[], &good.normals).unwrap_err(), &format!("positions: 0 for {n} samples"));
    refused(scene.set_colors(&[], None).unwrap_err(), &format!("radii: 0 for {n} samples"));
    assert!(same(&shot(&mut scene, &plain()), &before));
}

#[test]
fn who_has_no_adapter_is_told_what_to_install() {
    assert!(NoGpu::HINT.contains("mesa-vulkan-drivers"));
}

/// A device whose buffers hold a part of the samples gets the samples in several buffers.
#[test]
fn samples_in_several_buffers() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::ZERO, 1.0, 200).colored(RED);
    let whole = shot(&mut scene_of(gpu, &model), &plain());

    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
    // Room for 2^15 samples.
    let required_limits = wgpu::Limits {
        max_storage_buffer_binding_size: 1 << 19,
        ..wgpu::Limits::default().or_worse_values_from(&adapter.limits())
    };
    let descriptor = wgpu::DeviceDescriptor { required_limits, ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
    let small = Gpu::from_device(device, queue, &adapter.get_info());
    let mut scene = scene_of(&small, &model);
    assert!(same(&shot(&mut scene, &plain()), &whole));

    // Triangles cannot reach samples in other buffers, so splats stand in.
    assert!(same(&shot(&mut scene, &SceneStyle { mode: SurfaceMode::Triangles, ..plain() }), &whole));
    scene.set_positions(&model.positions, &model.normals).unwrap();
    assert!(same(&shot(&mut scene, &plain()), &whole));
}

/// All splats are drawn at once after a part, where no budget holds them back.
#[test]
fn without_a_budget_all_is_drawn() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::ZERO, 1.0, 150).colored(RED);
    let mut scene = scene_of(gpu, &model);
    scene.render(&view(), &plain(), Some(&mut budget_of(16_000)));
    assert!(!scene.drawn().complete);
    let image = shot(&mut scene, &plain());
    assert!(scene.drawn().complete && same(&image, &draw(gpu, &model, &plain())));
    // A mesh that is larger than the budget is drawn as splats, and then as it is.
    let mesh = SceneStyle { mode: SurfaceMode::Triangles, ..plain() };
    scene.render(&view(), &mesh, Some(&mut budget_of(16_000)));
    assert!(scene.drawn().of == model.positions.len() && !scene.drawn().complete);
    shot(&mut scene, &mesh);
    assert_eq!(scene.drawn().drawn, model.triangles.len());
}

/// Pictures of more and more splats come before the complete one, if that takes its time; each is nearer to
/// the last.
#[test]
fn pictures_at_rest_get_better_steadily() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::ZERO, 1.0, 500).colored(RED);
    let style = SceneStyle { scale: PixelScale::Full, ..plain() };
    let complete = shot(&mut scene_of(gpu, &model), &style);
    let mut budget = budget_of(16_000);
    let mut scene = scene_of(gpu, &model);
    let mut seen: Vec<(usize, f32)> = Vec::new();
    for _ in 0..1000 {
        scene.render(&view(), &style, Some(&mut budget));
        let drawn = scene.drawn();
        if seen.last().is_none_or(|(before, _)| *before != drawn.drawn) {
            seen.push((drawn.drawn, difference(&scene.read().unwrap(), &complete, 3).1));
        }
        if drawn.complete {
            break;
        }
    }
    assert!(scene.drawn().complete && seen.len() >= 4, "{seen:?}");
    assert!(seen.windows(2).all(|w| w[0].0 < w[1].0 && w[1].1 <= w[0].1 + 2e-3), "{seen:?}");
    assert!(same(&scene.read().unwrap(), &complete));
}

/// Discs that stretch with the surface leave no holes in it; discs that do not stretch leave some.
#[test]
fn stretched_discs_close_a_stretched_surface() {
    let Some(gpu) = gpu() else { return };
    let mut model = sphere(Vec3::ZERO, 0.25, 40).colored(RED);
    model.positions.iter_mut().for_each(|p| p.x *= 4.0);
    let mut scene = scene_of(gpu, &model);
    let holes = |image: &Image| {
        let places = (50..190).flat_map(|x| (108..132).map(move |y| [x as f32 + 0.5, y as f32 + 0.5]));
        places.filter(|place| !is_red(image, *place)).count()
    };
    let open = holes(&shot(&mut scene, &plain()));
    assert!(open > 10, "{open}");
    // The part of the surface that faces the eye is stretched along x.
    let ellipse = |(n, r): (&Vec3, &f32)| {
        let along = (Vec3::X - n.x * *n).try_normalize().unwrap_or(n.any_orthonormal_vector());
        [4.0 * r * along, r * n.cross(along)]
    };
    let axes: Vec<[Vec3; 2]> = model.normals.iter().zip(&model.radii).map(ellipse).collect();
    let radii: Vec<f32> = model.radii.iter().map(|r| 4.0 * r).collect();
    scene.set_axes(&axes).unwrap();
    scene.set_colors(&radii, model.colors.as_deref()).unwrap();
    assert_eq!(holes(&shot(&mut scene, &plain())), 0);
    assert!(scene.set_axes(&axes[1..]).is_err());
}

/// The part beyond a plane is cut away, of discs and triangles alike, and the reddish inside is seen.
#[test]
fn a_plane_cuts_the_surface_open() {
    let Some(gpu) = gpu() else { return };
    let model = sphere(Vec3::ZERO, 1.0, 100).colored([60, 120, 200]);
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        let style = SceneStyle { mode, ..plain() };
        let mut scene = scene_of(gpu, &model);
        let whole = shot(&mut scene, &style);
        let nothing = shot(&mut scene, &SceneStyle { clip: Some(Vec3::X.extend(-1.1)), ..style });
        let right = project(&view(), Vec3::new(0.5, 0.0, 0.0));
        let left = project(&view(), Vec3::new(-0.5, 0.0, 0.0));
        // The right half is away, up to a border that is straight to a pixel.
        let half = shot(&mut scene, &SceneStyle { clip: Some(Vec3::X.extend(0.0)), ..style });
        assert_eq!(at(&half, right), at(&nothing, right));
        assert_eq!(at(&half, left), at(&whole, left));
        let middle = project(&view(), Vec3::ZERO);
        let [before, behind] = [-2.0, 2.0].map(|x| at(&half, [middle[0] + x, middle[1]]));
        assert!(apart(before, at(&whole, middle)) < 8, "{before:?}");
        assert!(apart(behind, at(&nothing, middle)) < 8, "{behind:?}");
        // The half that faces the eye is away: its inside is seen, with colours of its own and without.
        for own_colors in [true, false] {
            let style = SceneStyle { own_colors, clip: Some(Vec3::Z.extend(0.0)), ..style };
            let open = shot(&mut scene, &style);
            assert!(is_red(&open, middle) && !is_red(&whole, middle), "{mode:?} {:?}", at(&open, middle));
        }
        // A plane beyond all of it cuts nothing.
        let beyond = shot(&mut scene, &SceneStyle { clip: Some(Vec4::new(0.0, 0.6, 0.8, 1.2)), ..style });
        let (_, changed) = difference(&beyond, &whole, 2);
        assert!(changed < 0.02, "{mode:?}: {changed}");
    }
}

/// A ball of light is turned with the eye: the same form looks the same from all sides, and not as by lamps.
#[test]
fn balls_of_light_face_the_eye() {
    let Some(gpu) = gpu() else { return };
    let mut scene = scene_of(gpu, &sphere(Vec3::ZERO, 1.0, 100));
    let lamps = shot(&mut scene, &SceneStyle { occlusion: false, ..SceneStyle::default() });
    let turned = SceneView { view: view().view * glam::Mat4::from_rotation_y(1.1), ..view() };
    let mut seen: Vec<Image> = vec![lamps];
    for ball in [Matcap::Ceramic, Matcap::Metal, Matcap::Wax, Matcap::Stripes] {
        let style = SceneStyle { light: Light::Matcap(ball), occlusion: false, ..SceneStyle::default() };
        let picture = shot(&mut scene, &style);
        scene.render(&turned, &style, None);
        let (_, beyond) = difference(&picture, &scene.read().unwrap(), 10);
        assert!(beyond < 0.02, "{ball:?}: {beyond}");
        for other in &seen {
            assert!(difference(&picture, other, 12).1 > 0.1, "{ball:?}");
        }
        seen.push(picture);
    }
    // Stripes: dark and light ones from above to below.
    let column = |y: f32| at(&seen[4], [120.0, y])[1];
    let flips = (30..210).filter(|y| (column(*y as f32) > 90) != (column(*y as f32 + 1.0) > 90)).count();
    assert!((6..40).contains(&flips), "{flips}");
}

/// The surface is cut out of two flat backgrounds, with borders half seen through.
#[test]
fn a_picture_is_cut_out_of_its_background() {
    let Some(gpu) = gpu() else { return };
    let mut scene = scene_of(gpu, &sphere(Vec3::ZERO, 1.0, 100).colored(RED));
    let style = SceneStyle { scale: PixelScale::Double, ..plain() };
    let mut over = |background| shot(&mut scene, &SceneStyle { background, ..style });
    let [black, white] = [Background::Black, Background::White].map(&mut over);
    let cut = simod_picture::CutOut::from_backgrounds(&black, &white).unwrap();
    let opacity = |x: usize, y: usize| cut.pixels()[y * 240 + x][3];
    assert_eq!((opacity(0, 0), opacity(239, 120), opacity(120, 120)), (0, 0, 255));
    let part = cut.pixels().iter().filter(|p| (8..247).contains(&p[3])).count();
    assert!((100..2000).contains(&part), "{part}");
    // The background leaves no seam: half of a border's pixel is as red as the whole ones beside it.
    assert!(cut.pixels().iter().filter(|p| p[3] > 60).all(|p| p[0] > p[2]));
}
