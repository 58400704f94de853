//! Parts of the model in full: their vertices are those of the written model, and are shown while the
//! samples are at the positions that these vertices were carried by.

use super::{LONG, done, model, open, pixel, plugins, state};
use glam::{DVec3, Vec3};
use simod_core::detail::DetailBatch;
use simod_core::sampling::grid::{CellMap, key_at};
use simod_generate::Shape;
use simod_model::{ErrorKind, for_vertices};
use simod_plugin_api::Effort;
use simod_session::Motion;
use simod_session::edit::{self, Change};
use simod_session::step::{Region, Role};
use simod_viewer::camera::Standard;
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::engine::Job;
use simod_viewer::selection::Combine;
use simod_viewer::state::Notice;
use simod_viewer::{Command, Previewed, State};
use std::collections::BTreeMap;
use std::path::Path;

const VERTICES: u64 = 60_000;

fn select(area: Area) -> Command {
    Command::Select { area, combine: Combine::Replace, visible: false, goes_on: false }
}

/// An amphora that is open, and can be bent by `bent`.
fn amphora(folder: &Path) -> State {
    let mut state = state(plugins());
    done(&mut state, open(&model(folder, Shape::Amphora, VERTICES), 3000));
    done(&mut state, Command::Camera(CameraMove::Look(Standard::Front)));
    done(&mut state, Command::AddStep { plugin: "rbf".into(), at: None });
    let half = |height: f64, side: f64| simod_session::Shapes {
        shapes: vec![simod_session::RegionShape::HalfSpace {
            point: DVec3::Y * height,
            normal: DVec3::Y * side,
        }],
        falloff: 0.0,
    };
    let region = |role, height, side| Region { role, shapes: half(height, side), motion: Motion::default() };
    let regions = vec![region(Role::Fixed, 0.6, -1.0), region(Role::Handle, 1.5, 1.0)];
    done(&mut state, Command::Edit(edit::EditCommand::Change { at: 0, change: Change::SetRegions(regions) }));
    done(&mut state, Command::Edit(bent(15.0)));
    state
}

fn bent(degrees: f64) -> edit::EditCommand {
    let motion = Motion { translate: DVec3::new(0.1, 0.1, 0.0), degrees, ..Motion::default() };
    edit::EditCommand::Change { at: 0, change: Change::MoveRegion { region: 1, motion } }
}

fn read(path: &Path) -> Vec<DVec3> {
    let mut positions = Vec::new();
    for_vertices(simod_model::open(path).unwrap().as_ref(), |chunk| {
        positions.extend_from_slice(&chunk.positions);
        Ok(())
    })
    .unwrap();
    positions
}

/// The positions that are shown of each cell.
fn shown(state: &State) -> BTreeMap<u32, Vec<Vec3>> {
    let mut found = BTreeMap::new();
    for piece in state.detail().unwrap().pieces().values() {
        let DetailBatch { positions, cells, .. } = &*piece.batch;
        for ((cell, range), _) in cells.iter().zip(&piece.shown).filter(|(_, shown)| **shown) {
            let positions = positions[range.start as usize..range.end as usize].to_vec();
            assert!(found.insert(*cell, positions).is_none(), "cell {cell} is shown twice");
        }
    }
    found
}

/// Samples are covered where all that they stand for is shown.
fn is_covered_once(state: &State) {
    let (detail, shown) = (state.detail().unwrap(), shown(state));
    let scene = state.scene().unwrap();
    let cells = &scene.sampled.held_cells().unwrap().cells;
    let mut covered = vec![true; scene.len()];
    for (cell, place) in cells.iter().zip(0..).filter(|(_, place)| !shown.contains_key(place)) {
        assert!(!shown.contains_key(&place));
        cell.tree.samples.iter().for_each(|s| covered[*s as usize] = false);
    }
    let contacts = scene.sampled.samples.contacts();
    for [sample, of] in contacts.map_or(&[][..], |contacts| contacts.parted()) {
        covered[*sample as usize] = covered[*of as usize];
    }
    assert!(**detail.covered() == *covered);
}

#[test]
fn what_is_shown_in_full_is_what_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = amphora(folder.path());
    done(&mut state, select(Area::All));
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let figures = state.detail().unwrap().figures();
    assert_eq!(
        (figures.vertices, figures.wanted, figures.stride, figures.stale),
        (VERTICES, VERTICES, 1, 0.0)
    );
    assert!(state.detail().unwrap().covered().iter().all(|covered| *covered));

    let output = folder.path().join("written.ply");
    done(&mut state, Command::Write { output: output.clone() });
    let (rest, written) = (read(&folder.path().join("model.ply")), read(&output));
    let scene = state.scene().unwrap();
    let kept = scene.sampled.held_cells().unwrap();
    let place: CellMap<u32> = kept.cells.iter().map(|cell| cell.key).zip(0..).collect();
    let mut of_cells: BTreeMap<u32, Vec<Vec3>> = BTreeMap::new();
    for (p, q) in rest.iter().zip(&written) {
        let cell = place[&key_at(*p, kept.level)];
        of_cells.entry(cell).or_default().push(scene.frame().to_local(*q));
    }
    let shown = shown(&state);
    let mut strays = 0;
    for (cell, positions) in &of_cells {
        assert_eq!(positions.len(), shown[cell].len());
        // To single precision at unit size; but for a few between sheets, see `simod_core::detail::stream`.
        let off = positions.iter().zip(&shown[cell]).map(|(p, q)| p.distance(*q));
        strays += off.filter(|off| *off > 5e-7).count();
    }
    assert!(strays < 10, "{strays} vertices are elsewhere");
    assert!(rest != written);
}

#[test]
fn what_is_stale_is_not_shown_and_comes_again_when_the_edit_rests() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = amphora(folder.path());
    done(&mut state, select(Area::All));
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let first = shown(&state);
    let (report, _) = state.streamed().unwrap();
    is_covered_once(&state);

    // Dragged: what is held fast stays, what moves is shown by samples.
    done(&mut state, Command::Drag(bent(25.0)));
    assert_eq!(state.scene().unwrap().effort, Effort::DRAFT);
    let figures = state.detail().unwrap().figures();
    assert!((0.3..0.95).contains(&figures.stale), "{figures:?}");
    assert_eq!(figures.vertices as f64, (VERTICES as f64 * (1.0 - figures.stale)).round());
    is_covered_once(&state);
    let fast = shown(&state);
    assert!(fast.iter().all(|(cell, positions)| first[cell] == *positions));
    assert!(!state.is_streaming());

    // Taken back: all of it is of use again, and nothing is read.
    done(&mut state, Command::Undo);
    done(&mut state, Command::Redo);
    done(&mut state, Command::Undo);
    assert!(state.document().unwrap().can_redo().is_some());
    let again = state.streamed().unwrap().0;
    assert_eq!(state.detail().unwrap().figures().stale, 0.0);
    assert!(again.vertices <= report.vertices);

    // At rest, what has moved is streamed again, and only that.
    done(&mut state, Command::Drag(bent(40.0)));
    done(&mut state, Command::Rest);
    let figures = state.detail().unwrap().figures();
    assert_eq!((figures.vertices, figures.stale), (VERTICES, 0.0));
    let last = state.streamed().unwrap().0;
    assert!(last.vertices < report.vertices && last.bytes < report.bytes, "{last:?}, {report:?}");
    is_covered_once(&state);
    let followed = shown(&state);

    // As if it had been streamed now.
    done(&mut state, Command::Preview { what: Previewed::Nothing });
    assert!(state.detail().is_none());
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let mut strays = 0;
    for (cell, positions) in shown(&state) {
        let off = positions.iter().zip(&followed[&cell]).map(|(p, q)| p.distance(*q));
        strays += off.filter(|off| *off > 5e-7).count();
    }
    assert!(strays < 10, "{strays} vertices are elsewhere");
}

#[test]
fn a_change_that_is_taken_back_before_it_rests_costs_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = amphora(folder.path());
    done(&mut state, select(Area::All));
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let pieces = |state: &State| state.detail().unwrap().pieces().keys().copied().collect::<Vec<_>>();
    let before = pieces(&state);
    for degrees in [20.0, 25.0, 30.0] {
        done(&mut state, Command::Drag(bent(degrees)));
        assert!(state.detail().unwrap().figures().stale > 0.3);
    }
    done(&mut state, Command::Undo);
    assert_eq!(pieces(&state), before);
    let figures = state.detail().unwrap().figures();
    assert_eq!((figures.vertices, figures.stale), (VERTICES, 0.0));
}

#[test]
fn only_what_is_seen_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = amphora(folder.path());
    done(&mut state, Command::Preview { what: Previewed::Seen });
    let whole = state.detail().unwrap().figures();
    // The far side is not seen.
    assert!((VERTICES / 10..VERTICES * 9 / 10).contains(&whole.vertices), "{whole:?}");
    is_covered_once(&state);
    let covered = state.detail().unwrap().covered().clone();
    let [at_x, at_y] = pixel(&state, DVec3::new(0.0, 1.0, 0.5));
    let bytes = state.streamed().unwrap().0.bytes;
    for _ in 0..4 {
        done(&mut state, Command::Camera(CameraMove::Zoom { factor: 2.0, at: [at_x, at_y] }));
    }
    // The vertices that were streamed stay until somebody asks for the present view; of that, nothing is
    // read twice.
    assert_eq!(*state.detail().unwrap().covered(), covered);
    done(&mut state, Command::Preview { what: Previewed::Seen });
    let near = state.detail().unwrap().figures();
    assert!(
        near.vertices * 4 < whole.vertices && near.vertices == near.wanted && near.stride == 1,
        "{near:?}"
    );
    assert_eq!(state.streamed().unwrap().0.bytes, bytes, "something was read twice");
    is_covered_once(&state);
    // Between samples.
    for _ in 0..10 {
        done(&mut state, Command::Camera(CameraMove::Zoom { factor: 2.0, at: [at_x, at_y] }));
    }
    done(&mut state, Command::Preview { what: Previewed::Seen });
    assert!(state.detail().unwrap().figures().vertices > 0);
    done(&mut state, Command::Camera(CameraMove::Look(Standard::Back)));
    done(&mut state, Command::Camera(CameraMove::FrameAll));
    done(&mut state, Command::Preview { what: Previewed::Seen });
    let read = state.streamed().unwrap().0.bytes as f64;
    let all = simod_model::open(&folder.path().join("model.ply")).unwrap().info().vertex_bytes as f64;
    assert!(read < 0.95 * all, "{read} of {all} bytes");
    is_covered_once(&state);
}

#[test]
fn refinements_and_other_models_are_followed() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = amphora(folder.path());
    done(&mut state, select(Area::All));
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let [left, top] = pixel(&state, DVec3::new(-0.3, 1.3, 0.0));
    let [right, bottom] = pixel(&state, DVec3::new(0.3, 0.8, 0.0));
    done(&mut state, select(Area::Box { from: [left, top], to: [right, bottom] }));
    let samples = state.scene().unwrap().len();
    done(&mut state, Command::RefineSelection { finer: simod_core::refinement::Finer::Factor(3.0) });
    assert!(state.scene().unwrap().len() > samples);
    let figures = state.detail().unwrap().figures();
    assert_eq!((figures.vertices, figures.stale), (VERTICES, 0.0));
    is_covered_once(&state);
    done(&mut state, Command::Undo);
    assert_eq!(state.detail().unwrap().figures().stale, 0.0);
    is_covered_once(&state);

    // A model that cannot be opened ends nothing.
    let nothing = folder.path().join("nothing.ply");
    std::fs::write(&nothing, "no model").unwrap();
    done(&mut state, open(&nothing, 100));
    assert!(!state.is_streaming() && state.detail().is_some());
    done(&mut state, open(&folder.path().join("model.ply"), 500));
    assert!(state.detail().is_none());
}

#[test]
fn what_cannot_be_shown_is_told() {
    let mut empty = state(plugins());
    assert!(empty.apply(Command::Preview { what: Previewed::Seen }).is_err());
    let folder = tempfile::tempdir().unwrap();
    let mut state = amphora(folder.path());
    let error = state.apply(Command::Preview { what: Previewed::Selection }).unwrap_err();
    assert!(error.to_string().contains("nothing of the model"), "{error}");

    // Stopped: what is there stays, and nothing comes by itself.
    done(&mut state, select(Area::All));
    state.apply(Command::Preview { what: Previewed::Selection }).unwrap();
    state.apply(Command::Cancel { job: Job::Preview }).unwrap();
    state.settle(LONG).unwrap();
    let there = state.detail().unwrap().figures().vertices;
    done(&mut state, Command::Edit(bent(3.0)));
    assert!(state.detail().unwrap().figures().vertices <= there);
    state.take_notices();

    // The model is another one by now.
    let path = folder.path().join("model.ply");
    std::fs::remove_file(&path).unwrap();
    done(&mut state, Command::Preview { what: Previewed::Selection });
    let told = state.take_notices();
    let is_gone = |n: &Notice| matches!(n, Notice::Failed(Job::Preview, e) if e.kind() == ErrorKind::Io);
    assert!(told.iter().any(is_gone), "{told:?}");
    done(&mut state, Command::Edit(bent(5.0)));
    assert!(state.take_notices().is_empty(), "it is not tried again");
}
