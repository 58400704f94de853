//! Details are as one with the surface.
#![allow(clippy::unwrap_used, reason = "a test")]

use crate::common;

use std::time::Duration;

use common::{Model, at, difference, draw, gpu, same, sphere, view};
use glam::Vec3;
use simod_scene::{Budget, Scene, SceneStyle, SceneSurface, SurfaceMode};

/// A sphere, of which some samples are the surface's and the others are details, in two pieces.
struct Split {
    whole: Model,
    surface: Model,
    details: [Model; 2],
}

fn split() -> Split {
    let whole = sphere(Vec3::ZERO, 1.0, 100).colored([200, 120, 60]);
    let part = |keep: &dyn Fn(Vec3) -> bool| {
        let kept: Vec<usize> = (0..whole.positions.len()).filter(|i| keep(whole.positions[*i])).collect();
        Model {
            positions: kept.iter().map(|i| whole.positions[*i]).collect(),
            normals: kept.iter().map(|i| whole.normals[*i]).collect(),
            radii: kept.iter().map(|i| whole.radii[*i]).collect(),
            colors: whole.colors.as_ref().map(|colors| kept.iter().map(|i| colors[*i]).collect()),
            triangles: Vec::new(),
            ..Model::default()
        }
    };
    let details = [part(&|p| p.x > 0.2 && p.y < 0.0), part(&|p| p.x > 0.2 && p.y >= 0.0)];
    let mut surface = whole.clone();
    surface.radii.iter_mut().zip(&whole.positions).filter(|(_, p)| p.x > 0.2).for_each(|(r, _)| *r = -1.0);
    Split { whole, surface, details }
}

fn style() -> SceneStyle {
    SceneStyle { own_colors: true, ..SceneStyle::default() }
}

#[test]
fn a_surface_in_pieces_looks_as_the_whole() {
    let Some(gpu) = gpu() else { return };
    let Split { whole, surface, details } = split();
    let image = draw(gpu, &whole, &style());
    let mut scene = Scene::new(gpu);
    scene.set_surface(&surface.surface()).unwrap();
    let shot = |scene: &mut Scene| {
        scene.render(&view(), &style(), None);
        scene.read().unwrap()
    };
    let half = shot(&mut scene);
    assert!(difference(&image, &half, 30).1 > 0.1, "half of it is not there");
    for (detail, number) in details.iter().zip([7, 3]) {
        scene.set_detail(number, Some(&detail.surface())).unwrap();
    }
    let all = details.iter().map(|d| d.positions.len()).sum::<usize>() + surface.positions.len();
    assert_eq!(scene.splats(), all);
    // Sums are rounded in another order.
    let (worst, beyond) = difference(&image, &shot(&mut scene), 2);
    assert!(beyond < 1e-3, "{worst}, {beyond}");

    // The picture that is drawn piece by piece, within a budget, is the same.
    let filled = shot(&mut scene);
    let mut budget = Budget::new(Duration::ZERO);
    for _ in 0..20 {
        budget.learn(Duration::from_secs(1), false);
    }
    scene.set_colors(&surface.radii, surface.colors.as_deref()).unwrap();
    scene.render(&view(), &style(), Some(&mut budget));
    assert!(!scene.drawn().complete && scene.drawn().drawn < all, "{:?}", scene.drawn());
    let part = scene.read().unwrap();
    assert!(difference(&image, &part, 60).1 < 0.1, "a part of it stands for all");
    for _ in 0..200 {
        scene.render(&view(), &style(), Some(&mut budget));
    }
    assert!(scene.drawn().complete && scene.drawn().drawn == all);
    assert!(difference(&filled, &scene.read().unwrap(), 2).1 < 1e-3);

    // Details are hidden, or gone.
    let hidden: Vec<Vec<f32>> = details.iter().map(|d| vec![-1.0; d.radii.len()]).collect();
    for ((detail, radii), number) in details.iter().zip(&hidden).zip([7, 3]) {
        scene.set_detail_colors(number, radii, detail.colors.as_deref()).unwrap();
    }
    assert!(same(&half, &shot(&mut scene)));
    [3, 7].iter().for_each(|number| scene.set_detail(*number, None).unwrap());
    assert!(same(&half, &shot(&mut scene)) && scene.splats() == surface.positions.len());
}

/// Fine details have their colour, and the samples that they stand for do not shine through; triangles give
/// way to details.
#[test]
fn fine_details_hide_what_is_behind() {
    let Some(gpu) = gpu() else { return };
    let Split { mut surface, .. } = split();
    surface.colors = Some(vec![[255, 0, 0]; surface.positions.len()]);
    let mut fine = sphere(Vec3::ZERO, 1.01, 400).colored([0, 0, 255]);
    fine.radii.iter_mut().zip(&fine.positions).filter(|(_, p)| p.x <= 0.2).for_each(|(r, _)| *r = -1.0);
    let mut scene = Scene::new(gpu);
    scene.set_surface(&surface.surface()).unwrap();
    scene.set_detail(0, Some(&SceneSurface { triangles: &[], ..fine.surface() })).unwrap();
    for mode in [SurfaceMode::Splats, SurfaceMode::Triangles] {
        scene.render(&view(), &SceneStyle { mode, ..style() }, None);
        let image = scene.read().unwrap();
        let [r, _, b] = at(&image, [170.0, 120.0]);
        assert!(b > r + 60, "{mode:?}: {r}, {b}");
        let [r, _, b] = at(&image, [70.0, 120.0]);
        assert!(r > b + 60, "{mode:?}: {r}, {b}");
    }
    assert!(scene.set_detail_colors(0, &[1.0], None).is_err());
    assert!(scene.set_detail(0, Some(&SceneSurface { radii: &[], ..fine.surface() })).is_err());
}

/// Few details beside a surface of which only a part is drawn, by larger discs, leave the surface its share
/// of the splats, and stay as they are.
#[test]
fn few_details_are_no_larger_for_a_large_surface() {
    let Some(gpu) = gpu() else { return };
    let mut surface = sphere(Vec3::ZERO, 1.0, 150).colored([255, 0, 0]);
    surface.radii.iter_mut().zip(&surface.positions).filter(|(_, p)| p.x > 0.2).for_each(|(r, _)| *r = -1.0);
    let few = Model {
        positions: (0..5).map(|k| Vec3::new(0.6, 0.3 * k as f32 - 0.6, 0.8)).collect(),
        normals: vec![Vec3::Z; 5],
        radii: vec![0.05; 5],
        ..Model::default()
    };
    let few = few.colored([0, 0, 255]);
    let mut scene = Scene::new(gpu);
    scene.set_surface(&surface.surface()).unwrap();
    scene.set_detail(0, Some(&few.surface())).unwrap();
    let blue = |scene: &Scene| {
        let image = scene.read().unwrap();
        image.pixels().iter().filter(|[r, _, b]| *b > r.saturating_add(60)).count()
    };
    scene.render(&view(), &style(), None);
    let (whole, all) = (blue(&scene), scene.splats());
    assert!(whole > 100, "{whole}");
    let mut budget = Budget::new(Duration::ZERO);
    for _ in 0..20 {
        budget.learn(Duration::from_secs(1), false);
    }
    scene.set_colors(&surface.radii, surface.colors.as_deref()).unwrap();
    scene.render(&view(), &style(), Some(&mut budget));
    let part = scene.drawn().drawn;
    assert!(part < all && 2 * part > budget.splats(), "{part} of {all}");
    // The details have other pixels, as moving pictures are drawn more coarsely, but as many.
    assert!(blue(&scene).abs_diff(whole) < whole / 4, "{} {whole}", blue(&scene));
}
