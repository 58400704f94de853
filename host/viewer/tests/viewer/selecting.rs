//! Selections, against the samples that have to be in them.

use super::{done, model, open, pixel, plugins, state};
use glam::{DVec2, DVec3};
use simod_core::refinement::Finer;
use simod_core::sampling::SampleSet;
use simod_generate::Shape;
use simod_model::Scalar;
use simod_model::write_points;
use simod_session::edit::{self, Change};
use simod_session::step::Role;
use simod_session::{PluginRegistry, SessionFile};
use simod_viewer::camera::{Projection, Standard, Up};
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::selection::Combine;
use simod_viewer::{Command, Overlay, State};
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn opened(shape: Shape, samples: u64) -> State {
    let folder = tempfile::tempdir().unwrap();
    opened_file(&model(folder.path(), shape, 8 * samples), samples)
}

fn opened_file(path: &Path, samples: u64) -> State {
    let mut state = state(Arc::new(PluginRegistry::default()));
    done(&mut state, open(path, samples));
    state
}

/// A model of spheres of radius 1 about these points, of `n` by `2 n` vertices each.
fn spheres(folder: &Path, centers: &[DVec3], n: u32) -> PathBuf {
    let (mut points, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for center in centers {
        let first = points.len() as u32;
        for (i, j) in (0..n).flat_map(|i| (0..2 * n).map(move |j| (i, j))) {
            let pole = (f64::from(i) + 0.5) / f64::from(n) * std::f64::consts::PI;
            let round = f64::from(j) / f64::from(n) * std::f64::consts::PI;
            let (sin, cos) = pole.sin_cos();
            let normal = DVec3::new(sin * round.sin(), cos, sin * round.cos());
            points.push(*center + normal);
            normals.push(normal.as_vec3());
            if i + 1 < n {
                let at = |i: u32, j: u32| first + i * 2 * n + j % (2 * n);
                triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                triangles.push([at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)]);
            }
        }
    }
    let path = folder.join("spheres.ply");
    write_points(&path, points.into_iter(), &normals, &triangles, Scalar::F64, &[]).unwrap();
    path
}

fn select(state: &mut State, area: Area, visible: bool) {
    state.apply(Command::Select { area, combine: Combine::Replace, visible, goes_on: false }).unwrap();
}

fn everywhere(state: &State) -> Area {
    Area::Box { from: [0.0, 0.0], to: state.size() }
}

#[test]
fn only_what_is_seen_of_a_sphere_is_its_front() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = opened_file(&spheres(folder.path(), &[DVec3::splat(1e5)], 120), 4000);
    for (flat, side) in [(false, Standard::Front), (true, Standard::Left), (true, Standard::Isometric)] {
        let projection = if flat { Projection::Orthographic } else { Projection::Perspective };
        state.apply(Command::Camera(CameraMove::Look(side))).unwrap();
        state.apply(Command::Camera(CameraMove::Project(projection))).unwrap();
        let area = everywhere(&state);
        select(&mut state, area.clone(), false);
        let scene = state.scene().unwrap().clone();
        assert_eq!(state.selection().count(), scene.len(), "through");
        select(&mut state, area, true);
        let camera = *state.camera();
        let mut wrong = 0;
        for (i, p) in scene.positions.iter().enumerate() {
            let n = p.as_dvec3().normalize_or_zero();
            let to_eye =
                if flat { camera.axes()[2] } else { (camera.eye() - p.as_dvec3()).normalize_or_zero() };
            let cosine = n.dot(to_eye);
            let seen = state.selection().contains(i as u32);
            // Right at the border, it is half a disc that is seen.
            if (cosine > 0.08 && !seen) || (cosine < -0.08 && seen) {
                wrong += 1;
            }
        }
        assert_eq!(wrong, 0, "{side:?}, of {}", scene.len());
    }
}

#[test]
fn boxes_lassos_and_brushes_are_those_of_the_pixels() {
    let mut state = opened(Shape::Amphora, 1000);
    let scene = state.scene().unwrap().clone();
    let at = |state: &State, i: usize| {
        state.camera().project(scene.positions[i].as_dvec3(), state.size()).unwrap().0
    };
    let (from, to) = ([500.0, 300.0], [700.0, 500.0]);
    select(&mut state, Area::Box { from: to, to: from }, false);
    let boxed = state.selection().clone();
    for i in 0..scene.len() {
        let p = at(&state, i);
        let inside = (500.0..=700.0).contains(&p.x) && (300.0..=500.0).contains(&p.y);
        assert_eq!(boxed.contains(i as u32), inside);
    }
    assert!(!boxed.is_empty() && boxed.count() < scene.len());
    let path = vec![from, [to[0], from[1]], to, [from[0], to[1]]];
    select(&mut state, Area::Lasso { path }, false);
    assert_eq!(state.selection(), &boxed);
    select(&mut state, Area::Brush { path: vec![from, to], radius: 40.0 }, false);
    for i in 0..scene.len() {
        let (p, a, b) = (at(&state, i), DVec2::from(from), DVec2::from(to));
        let nearest = (0..=2000).map(|t| p.distance(a.lerp(b, f64::from(t) / 2000.0)));
        let d = nearest.fold(f64::INFINITY, f64::min);
        assert!((d - 40.0).abs() < 0.1 || state.selection().contains(i as u32) == (d < 40.0));
    }
    // Once more from all sides, so that nothing is left.
    select(&mut state, Area::All, false);
    let area = everywhere(&state);
    state.apply(Command::Select { area, combine: Combine::Subtract, visible: true, goes_on: false }).unwrap();
    assert!(!state.selection().is_empty() && state.selection().count() < scene.len());
    select(&mut state, Area::Inverse, false);
    select(&mut state, Area::None, false);
    assert!(state.selection().is_empty());
}

#[test]
fn a_connected_part_is_one_body() {
    let folder = tempfile::tempdir().unwrap();
    let centers = [DVec3::ZERO, DVec3::X * 3.0, DVec3::new(1.5, 3.0, 0.0)];
    let mut state = opened_file(&spheres(folder.path(), &centers, 60), 2000);
    state.apply(Command::Camera(CameraMove::Look(Standard::Front))).unwrap();
    let scene = state.scene().unwrap().clone();
    for center in centers {
        let at = pixel(&state, center + DVec3::Z);
        select(&mut state, Area::Connected { at }, false);
        for (i, p) in scene.positions.iter().enumerate() {
            let inside = scene.frame().to_model(*p).distance(center) < 1.1;
            assert_eq!(state.selection().contains(i as u32), inside);
        }
        let body = state.selection().clone();
        select(&mut state, Area::Grown, false);
        assert_eq!(state.selection(), &body, "a body has no border");
    }
    select(&mut state, Area::Connected { at: [1.0, 1.0] }, false);
    assert!(state.selection().is_empty());
}

#[test]
fn points_of_the_surface_are_on_the_surface() {
    let mut state = opened(Shape::BumpySphere, 8000);
    let scene = state.scene().unwrap().clone();
    state.apply(Command::Camera(CameraMove::Up(Up::Z))).unwrap();
    let middle = scene.frame().to_model_exact(DVec3::ZERO);
    let spacing = scene.frame().scale * f64::from(scene.sampled.samples.spacing()[0]);
    let mut hits = 0;
    for x in (0..1280).step_by(40) {
        for y in (0..800).step_by(40) {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let Some(hit) = state.pick(pixel) else {
                assert!(pixel.distance(DVec2::new(640.0, 400.0)) > 190.0, "a hole at {pixel}");
                continue;
            };
            hits += 1;
            let back = state.camera().project(hit.local, state.size()).unwrap().0;
            assert!(back.abs_diff_eq(pixel, 1.0), "{back} is not {pixel}");
            let radius = hit.at.distance(middle);
            assert!((0.8..1.2).contains(&radius), "{radius}");
            let normal = hit.normal.dot((hit.at - middle).normalize_or_zero());
            assert!(normal > 0.3, "{normal}");
            let sample = scene.frame().to_model(scene.positions[hit.sample as usize]);
            assert!(sample.distance(hit.at) < 3.0 * spacing);
        }
    }
    assert!(hits > 80, "{hits}");
    // The nearest surface, not what is behind it.
    let eye = state.camera().eye();
    let center = state.pick(DVec2::new(640.0, 400.0)).unwrap().local;
    assert!(eye.distance(center) < eye.length());
    assert!(state.pick(DVec2::new(2.0, 2.0)).is_none());
}

#[test]
fn fields_have_a_number_for_each_sample() {
    let mut state = opened(Shape::Plane, 1000);
    assert!(state.field().is_none());
    let fields = [
        (Overlay::Selection, [0.0, 1.0]),
        (Overlay::Displacement, [0.0, 1.0]),
        (Overlay::TransferError, [0.0, 1.0]),
    ];
    let samples: &SampleSet = &state.scene().unwrap().clone().sampled.samples;
    for (overlay, range) in fields {
        done(&mut state, Command::Show(overlay));
        let field = state.field().unwrap();
        assert_eq!((field.values.len(), field.range), (samples.len(), range), "{overlay:?}");
        assert!(field.values.iter().all(|x| (x - range[0]).abs() < 1e-4), "{overlay:?}: nothing moves");
    }
    state.apply(Command::Show(Overlay::Stretch)).unwrap();
    assert!(state.field().unwrap().values.iter().all(|x| (x - 1.0).abs() < 1e-5));
    state.apply(Command::Show(Overlay::Density)).unwrap();
    let field = state.field().unwrap();
    assert!(field.range[0] > 0.0 && field.range[1] < 0.5, "{:?}", field.range);
}

#[test]
fn a_region_of_what_is_selected_is_just_that() {
    let folder = tempfile::tempdir().unwrap();
    // The model is two shells, as the sides of a thin wall: samples that are near in space need not be
    // selected.
    let centers = [DVec3::ZERO, DVec3::splat(0.02)];
    let mut state = super::state(super::plugins());
    done(&mut state, open(&spheres(folder.path(), &centers, 80), 2500));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    state.apply(Command::Camera(CameraMove::Look(Standard::Front))).unwrap();
    let area = Area::Box { from: [400.0, 200.0], to: [700.0, 450.0] };
    select(&mut state, area, true);
    let selected = state.selection().clone();
    assert!(selected.count() > 50);
    let mask = Command::MakeRegion { step: 0, role: Role::Mask, falloff: 0.0, replaces: None };
    done(&mut state, mask);
    state.apply(Command::Choose { step: Some(0) }).unwrap();
    state.apply(Command::Show(Overlay::Region(0))).unwrap();
    let field = state.field().unwrap().clone();
    for (i, weight) in field.values.iter().enumerate() {
        assert_eq!(*weight, f32::from(u8::from(selected.contains(i as u32))), "sample {i}");
    }
    select(&mut state, Area::None, false);
    select(&mut state, Area::Region { step: 0, region: 0 }, false);
    assert_eq!(state.selection(), &selected);
    // With a falloff it fades out from there, and another one takes its place.
    let soft = Command::MakeRegion { step: 0, role: Role::Mask, falloff: 0.3, replaces: Some(0) };
    done(&mut state, soft);
    let soft = state.field().unwrap().values.clone();
    assert!(soft.iter().zip(&field.values).all(|(s, h)| s >= h && *s <= 1.0));
    let between = soft.iter().filter(|w| (0.05..0.95).contains(*w)).count();
    assert!(between > 20, "{between}");
    assert!(soft.iter().filter(|w| **w == 0.0).count() > soft.len() / 2);
    // The region comes back from the session's file as it was.
    let steps = state.document().unwrap().steps().clone();
    let path = folder.path().join("edit.toml");
    done(&mut state, Command::Save { path: Some(path.clone()) });
    let saved = SessionFile::load(&path).unwrap();
    assert_eq!(saved.steps[0].deformation().unwrap().regions, steps[0].step.deformation().unwrap().regions);
}

#[test]
fn joints_lie_in_the_middle_of_the_body() {
    let folder = tempfile::tempdir().unwrap();
    // Two spheres behind each other: the middle is that of the nearer one.
    let centers = [DVec3::new(0.0, 0.0, 1.5), DVec3::new(0.0, 0.0, -1.5)];
    let path = spheres(folder.path(), &centers, 60);
    let mut state = state(plugins());
    done(&mut state, open(&path, 6000));
    done(&mut state, Command::AddStep { plugin: "lattice".into(), at: None });
    state.apply(Command::Camera(CameraMove::Look(Standard::Front))).unwrap();
    let at = pixel(&state, centers[0]);
    let middle = state.pick_middle(0, at.into()).unwrap();
    assert!(middle.distance(centers[0]) < 0.02, "{middle}");
    assert!(state.pick_middle(0, DVec2::new(2.0, 2.0)).is_none());

    // Half a sphere, from its open side, has nothing behind what is seen.
    let bowl = folder.path().join("bowl.ply");
    let points: Vec<DVec3> = (0..5000)
        .map(|i| (f64::from(i) * 2.399_963, f64::from(i) / 5000.0))
        .map(|(turn, z)| DVec3::new(turn.cos(), turn.sin(), 0.0) * (1.0 - z * z).sqrt() - DVec3::Z * z)
        .collect();
    let normals: Vec<_> = points.iter().map(|p| -p.as_vec3()).collect();
    write_points(&bowl, points.into_iter(), &normals, &[], Scalar::F64, &[]).unwrap();
    done(&mut state, open(&bowl, 2000));
    done(&mut state, Command::AddStep { plugin: "lattice".into(), at: None });
    state.apply(Command::Camera(CameraMove::Look(Standard::Front))).unwrap();
    let at = pixel(&state, DVec3::NEG_Z);
    let on_it = state.pick_middle(0, at.into()).unwrap();
    assert!(on_it.distance(DVec3::NEG_Z) < 0.02, "{on_it}");
}

#[test]
fn selections_are_undone_between_the_steps() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), Shape::Amphora, 20_000), 1000));
    let select = |state: &mut State, area: Area, combine: Combine, goes_on: bool| {
        done(state, Command::Select { area, combine, visible: false, goes_on });
        state.selection().clone()
    };
    let some = |from: u32| Area::Runs(vec![from, 100]);
    let nothing = state.selection().clone();
    assert_eq!(state.can_undo(), None);
    // A brush, in three moves of which the first meets nothing; and what changes nothing.
    select(&mut state, Area::None, Combine::Replace, false);
    select(&mut state, some(0), Combine::Add, true);
    let brushed = select(&mut state, some(200), Combine::Add, true);
    select(&mut state, some(200), Combine::Add, false);
    assert_eq!(brushed.count(), 200);
    select(&mut state, some(400), Combine::Add, false);
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    done(&mut state, Command::MakeRegion { step: 0, role: Role::Mask, falloff: 0.0, replaces: None });
    select(&mut state, Area::None, Combine::Replace, true);

    let mut seen = Vec::new();
    while let Some(what) = state.can_undo().map(str::to_owned) {
        done(&mut state, Command::Undo);
        seen.push((what, state.selection().clone()));
    }
    let labels: Vec<&str> = seen.iter().map(|(what, _)| what.as_str()).collect();
    assert_eq!(labels, ["change regions of warp", "add warp", "select", "select"]);
    assert!(seen[2].1 == brushed && seen[3].1 == nothing);
    assert_eq!(state.can_redo(), Some("select"));
    done(&mut state, Command::Redo);
    assert!(*state.selection() == brushed && state.can_redo() == Some("select"));
    done(&mut state, Command::Redo);
    done(&mut state, Command::Redo);
    done(&mut state, Command::Redo);
    assert_eq!((state.can_redo(), state.document().unwrap().steps().len()), (None, 1));
    // Another selection takes the place of those undone.
    done(&mut state, Command::Undo);
    done(&mut state, Command::Undo);
    done(&mut state, Command::Undo);
    select(&mut state, some(7), Combine::Replace, false);
    assert_ne!(state.can_redo(), Some("select"));
}

/// Two square plates of unit size, close to each other, which face away from each other.
fn plates(folder: &Path, n: u32, apart: f64) -> PathBuf {
    let (mut points, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for (z, up) in [(0.0, false), (apart, true)] {
        let first = points.len() as u32;
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let part = |k: u32| f64::from(k) / f64::from(n - 1);
            points.push(DVec3::new(part(i), part(j), z));
            normals.push(if up { glam::Vec3::Z } else { glam::Vec3::NEG_Z });
            if i + 1 < n && j + 1 < n {
                let at = |i: u32, j: u32| first + i * n + j;
                let both =
                    [[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)]];
                triangles.extend(both.map(|[a, b, c]| if up { [a, b, c] } else { [b, a, c] }));
            }
        }
    }
    let path = folder.join("plates.ply");
    write_points(&path, points.into_iter(), &normals, &triangles, Scalar::F64, &[]).unwrap();
    path
}

/// A thin wall, of which a half of the front is selected, before and behind a bend: once the wall is
/// refined, the new samples are in the selection, and in regions that were picked before, where the samples
/// around them are, and nowhere else.
#[test]
fn what_a_refinement_appends_belongs_to_what_is_around_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&plates(folder.path(), 150, 0.01), 1200));
    done(&mut state, Command::Camera(CameraMove::Look(Standard::Front)));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    let at = pixel(&state, DVec3::new(0.2, 0.5, 0.01));
    select(&mut state, Area::Connected { at }, false);
    let border = pixel(&state, DVec3::new(0.5, 0.5, 0.01))[0];
    let right = Area::Box { from: [border, 0.0], to: state.size() };
    done(
        &mut state,
        Command::Select { area: right, combine: Combine::Subtract, visible: false, goes_on: false },
    );
    let coarse = state.selection().count();
    let mask = |step: usize| Command::MakeRegion { step, role: Role::Mask, falloff: 0.0, replaces: None };
    done(&mut state, mask(0));
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    let change = Change::SetParam { id: "angle".into(), value: Some(50.0.into()) };
    done(&mut state, Command::Edit(edit::EditCommand::Change { at: 0, change }));
    done(&mut state, mask(1));
    let (former, spacing) = {
        let samples = &state.scene().unwrap().sampled.samples;
        (samples.len(), f64::from(samples.spacing()[0]) * state.scene().unwrap().frame().scale)
    };
    let refine = Command::RefineSelection { finer: Finer::Factor(6.0) };
    done(&mut state, refine.clone());

    let truth = |state: &State, i: usize| {
        let scene = state.scene().unwrap();
        let p = scene.frame().to_model(scene.sampled.samples.positions[i]);
        // Halfway between samples, wherever they are.
        ((p.x - 0.5).abs() > 1.5 * spacing).then_some(p.z > 0.005 && p.x < 0.5)
    };
    let wrong = |state: &State, is_in: &dyn Fn(usize) -> bool| {
        let appended = former..state.scene().unwrap().len();
        appended.filter(|i| truth(state, *i).is_some_and(|truth| truth != is_in(*i))).count()
    };
    let appended = state.scene().unwrap().len() - former;
    assert!(appended > 3 * coarse, "{appended} to {coarse}");
    assert_eq!(wrong(&state, &|i| state.selection().contains(i as u32)), 0, "of the selection");
    assert!(state.selection().count() > 3 * coarse);
    for step in [0, 1] {
        done(&mut state, Command::Choose { step: Some(step) });
        done(&mut state, Command::Show(Overlay::Region(0)));
        let field = state.field().unwrap().clone();
        assert_eq!(wrong(&state, &|i| field.values[i] > 0.5), 0, "of the region of step {step}");
    }

    // The present selection is as finely picked for a step that knows the former samples alone.
    let selected = state.selection().clone();
    done(&mut state, Command::MakeRegion { step: 1, role: Role::Mask, falloff: 0.0, replaces: Some(0) });
    let field = state.field().unwrap().clone();
    let differs = |i: &usize| (field.values[*i] > 0.5) != selected.contains(*i as u32);
    let others = (0..field.values.len()).filter(differs).count();
    // Some samples right at the border have the selection of those to which they belong.
    assert!(others * 500 <= field.values.len(), "{others} of {}", field.values.len());
    // Undone and done again, it is the same.
    done(&mut state, Command::Undo);
    done(&mut state, Command::Undo);
    assert_eq!((state.scene().unwrap().len(), state.selection().count()), (former, coarse));
    done(&mut state, Command::Redo);
    assert_eq!(state.selection(), &selected);
}
