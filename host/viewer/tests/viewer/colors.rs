//! The model's own colours and its other numbers: of samples, and of vertices in full.

use super::{done, model, open, plugins, state};
use glam::DVec3;
use simod_core::detail::Values;
use simod_core::sampling::grid::{CellMap, key_at};
use simod_generate::Shape;
use simod_model::for_vertices;
use simod_viewer::command::Area;
use simod_viewer::selection::Combine;
use simod_viewer::{Command, Overlay, Previewed, State, Tint};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const VERTICES: u64 = 40_000;
const INTENSITY: usize = 3;
const CLASSIFICATION: usize = 4;

fn color(p: DVec3) -> [u8; 3] {
    [(100.0 * p.y) as u8, if p.x > 0.0 { 200 } else { 40 }, 90]
}

fn intensity(p: DVec3) -> f32 {
    (3.0 * p.y + p.z) as f32
}

/// Two classes whose mean is a third one.
fn class(p: DVec3) -> u8 {
    if p.y < 1.0 { 2 } else { 6 }
}

/// An amphora whose vertices have colours and more.
fn colored(folder: &Path) -> (PathBuf, Vec<DVec3>) {
    let plain = model(folder, Shape::Amphora, VERTICES);
    let mut positions = Vec::new();
    for_vertices(simod_model::open(&plain).unwrap().as_ref(), |chunk| {
        positions.extend_from_slice(&chunk.positions);
        Ok(())
    })
    .unwrap();
    let mut bytes =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", positions.len()).into_bytes();
    for (kind, name) in [
        ("double", "x"),
        ("double", "y"),
        ("double", "z"),
        ("uchar", "red"),
        ("uchar", "green"),
        ("uchar", "blue"),
        ("float", "intensity"),
        ("uchar", "classification"),
    ] {
        bytes.extend(format!("property {kind} {name}\n").bytes());
    }
    bytes.extend(b"end_header\n");
    for p in &positions {
        bytes.extend(p.to_array().into_iter().flat_map(f64::to_le_bytes));
        bytes.extend(color(*p));
        bytes.extend(intensity(*p).to_le_bytes());
        bytes.push(class(*p));
    }
    let path = folder.join("colored.ply");
    std::fs::write(&path, bytes).unwrap();
    (path, positions)
}

/// Values of the shown vertices of each cell, in the order of the model.
fn shown<T: Clone>(state: &State, of: impl Fn(&Values) -> Vec<T>) -> BTreeMap<u32, Vec<T>> {
    let mut found = BTreeMap::new();
    for piece in state.detail().unwrap().pieces().values() {
        let all = of(&piece.batch.values);
        for ((cell, range), _) in piece.batch.cells.iter().zip(&piece.shown).filter(|(_, shown)| **shown) {
            let values = all[range.start as usize..range.end as usize].to_vec();
            assert!(found.insert(*cell, values).is_none());
        }
    }
    found
}

#[test]
fn samples_and_vertices_have_the_models_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (path, positions) = colored(folder.path());
    let mut state = state(plugins());
    done(&mut state, open(&path, 2000));
    let scene = state.scene().unwrap().clone();
    let names: Vec<&str> = state.attributes().iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["red", "green", "blue", "intensity", "classification"]);

    // Samples have means over their vertices: near their own colours, but where green jumps.
    let at = |i: usize| scene.frame().to_model(scene.sampled.samples.positions[i]);
    let near = (0..scene.len()).filter(|i| {
        let (is, due) = (scene.sampled.colors[*i], color(at(*i)));
        is.iter().zip(due).all(|(a, b)| a.abs_diff(b) <= 12)
    });
    let share = near.count() as f64 / scene.len() as f64;
    assert!(share > 0.9, "{share} of the samples have the model's colours");

    // In full, the very colours.
    let all = Command::Select { area: Area::All, combine: Combine::Replace, visible: false, goes_on: false };
    done(&mut state, all);
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let kept = scene.sampled.held_cells().unwrap();
    let place: CellMap<u32> = kept.cells.iter().map(|cell| cell.key).zip(0..).collect();
    let mut of_cells: BTreeMap<u32, Vec<DVec3>> = BTreeMap::new();
    positions.iter().for_each(|p| of_cells.entry(place[&key_at(*p, kept.level)]).or_default().push(*p));
    assert_eq!(state.tint(), Tint::Own);
    let colors = shown(&state, |values| match values {
        Values::Colors(all) => all.clone(),
        other => panic!("{other:?}"),
    });
    let due = |cell: &u32| of_cells[cell].iter().map(|p| color(*p)).collect::<Vec<_>>();
    assert_eq!(colors.len(), of_cells.len());
    assert!(colors.iter().all(|(cell, colors)| *colors == due(cell)));

    // Other numbers: read of the samples once, and streamed again of the vertices.
    done(&mut state, Command::Show(Overlay::Attribute(INTENSITY)));
    let field = state.field().unwrap().clone();
    let off = (0..scene.len()).map(|i| (field.values[i] - intensity(at(i))).abs());
    assert!(off.fold(0.0, f32::max) < 0.3 && !field.are_classes);
    let numbers = shown(&state, |values| match values {
        Values::Numbers(all) => all.clone(),
        other => panic!("{other:?}"),
    });
    let due = |cell: &u32| of_cells[cell].iter().map(|p| intensity(*p)).collect::<Vec<_>>();
    assert!(numbers.iter().all(|(cell, numbers)| *numbers == due(cell)));

    // No class that no vertex has.
    done(&mut state, Command::Show(Overlay::Attribute(CLASSIFICATION)));
    let field = state.field().unwrap().clone();
    assert!(field.are_classes && field.values.iter().all(|class| [2.0, 6.0].contains(class)));
    assert_ne!(field.scale().color(2.0), field.scale().color(6.0));

    // Without, what is there stays.
    done(&mut state, Command::Show(Overlay::None));
    assert_eq!(state.tint(), Tint::Own);
    done(&mut state, Command::ShowOwnColors(false));
    assert_eq!(state.tint(), Tint::Samples);
    assert!(!state.is_streaming() && state.detail().unwrap().missing().cells.is_empty());
}

/// An attribute that is not there, as in a recording of another model, shows nothing.
#[test]
fn what_is_not_there_is_not_shown() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), Shape::Amphora, 5000), 500));
    let there = state.attributes().len();
    done(&mut state, Command::Show(Overlay::Attribute(there)));
    assert!(state.field().is_none() && state.tint() == Tint::Samples);
}
