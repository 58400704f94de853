//! Random commands of a user, in whatever order: nothing panics, nothing is lost, and nothing grows without
//! bound. The test is a program of its own, as its memory is measured.
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

#[path = "../viewer/helpers.rs"]
mod helpers;

use glam::DVec3;
use helpers::{LONG, done, model, open, plugins, state};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use simod_core::refinement::Finer;
use simod_generate::Shape;
use simod_model::memory::{self, anonymous};
use simod_session::Motion;
use simod_session::edit::{self, Change};
use simod_session::step::Role;
use simod_viewer::camera::{Projection, Standard};
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::engine::Job;
use simod_viewer::selection::Combine;
use simod_viewer::state::Slowest;
use simod_viewer::{Clip, Command, ComparedVersion, Overlay, Previewed, State};
use std::collections::BTreeSet;

fn area() -> impl Strategy<Value = Area> {
    let pixel = || prop::array::uniform2(-100.0..1400.0_f64);
    prop_oneof![
        Just(Area::All),
        Just(Area::None),
        Just(Area::Inverse),
        Just(Area::Grown),
        Just(Area::Shrunk),
        (pixel(), pixel()).prop_map(|(from, to)| Area::Box { from, to }),
        prop::collection::vec(pixel(), 0..6).prop_map(|path| Area::Lasso { path }),
        (prop::collection::vec(pixel(), 0..6), -1.0..200.0_f64)
            .prop_map(|(path, radius)| Area::Brush { path, radius }),
        pixel().prop_map(|at| Area::Connected { at }),
        prop::collection::vec(0..500_u32, 0..6).prop_map(Area::Runs),
    ]
}

fn camera() -> impl Strategy<Value = CameraMove> {
    let any = || -10.0..10.0_f64;
    prop_oneof![
        (any(), any()).prop_map(|(yaw, pitch)| CameraMove::Orbit { yaw, pitch }),
        (any(), any()).prop_map(|(x, y)| CameraMove::Pan { by: [x, y] }),
        (-1.0..4.0_f64, any(), any())
            .prop_map(|(factor, x, y)| CameraMove::Zoom { factor, at: [640.0 + x, 400.0 + y] }),
        Just(CameraMove::FrameAll),
        Just(CameraMove::FrameSelection),
        Just(CameraMove::Look(Standard::Top)),
        Just(CameraMove::Project(Projection::Orthographic)),
        Just(CameraMove::Project(Projection::Perspective)),
    ]
}

/// Changes of steps; some make no sense.
fn change() -> impl Strategy<Value = edit::EditCommand> {
    let (at, small) = (0..4_usize, || -0.5..0.5_f64);
    let motion = (small(), small()).prop_map(|(y, turn)| Motion {
        translate: DVec3::Y * y,
        degrees: 90.0 * turn,
        scale: 1.0 + y,
        ..Motion::default()
    });
    let one = prop_oneof![
        any::<bool>().prop_map(Change::Enable),
        prop::option::of(prop::sample::select(vec!["Neck", "", " ", "a\nb", "\u{1f40e}"]))
            .prop_map(|title| Change::SetTitle(title.map(str::to_owned))),
        prop::sample::select(vec![0.0, 0.3, 1.0, -0.1, 1.5, f64::NAN]).prop_map(Change::SetAmount),
        (-200.0..200.0_f64)
            .prop_map(|angle| Change::SetParam { id: "angle".into(), value: Some(angle.into()) }),
        Just(Change::SetParam { id: "nonsense".into(), value: Some("x".into()) }),
        Just(Change::SetParam { id: "nonsense".into(), value: None }),
        Just(Change::SetRegions(Vec::new())),
        (0..3_usize, motion.clone()).prop_map(|(region, motion)| Change::MoveRegion { region, motion }),
        prop::sample::select(vec!["joint", "a b", "other"])
            .prop_map(|to| Change::RenameJoint { from: "joint".into(), to: to.into() }),
        motion.prop_map(|motion| Change::MoveHandle { id: "0,0,0".into(), motion }),
    ];
    prop_oneof![
        6 => (at.clone(), one).prop_map(|(at, change)| edit::EditCommand::Change { at, change }),
        2 => at.clone().prop_map(|at| edit::EditCommand::Remove { at }),
        2 => at.clone().prop_map(|at| edit::EditCommand::Solo { at }),
        1 => (at.clone(), at.clone()).prop_map(|(from, to)| edit::EditCommand::Group {
            steps: from..to + 1,
            name: (from < 2).then(|| "group".to_owned()),
        }),
        1 => (at.clone(), any::<bool>()).prop_map(|(at, enabled)| edit::EditCommand::EnableGroup { at, enabled }),
        1 => (at.clone(), at.clone()).prop_map(|(at, to)| edit::EditCommand::MoveGroup { at, to }),
        1 => at.clone().prop_map(|at| edit::EditCommand::RemoveGroup { at }),
        1 => (at.clone(), at).prop_map(|(from, to)| edit::EditCommand::Move { from, to }),
    ]
}

fn command() -> impl Strategy<Value = Command> {
    let step = 0..3_usize;
    let combine = prop_oneof![Just(Combine::Replace), Just(Combine::Add), Just(Combine::Subtract)];
    let role = prop_oneof![Just(Role::Fixed), Just(Role::Handle), Just(Role::Mask)];
    let plugin = prop::sample::select(vec!["warp", "rbf", "lattice", "displacement-paint", "nobody"]);
    let overlay = prop::sample::select(vec![
        Overlay::None,
        Overlay::Selection,
        Overlay::Region(0),
        Overlay::Displacement,
        Overlay::Stretch,
        Overlay::Density,
        Overlay::TransferError,
        Overlay::Difference,
        Overlay::Attribute(0),
    ]);
    let previewed = vec![Previewed::Seen, Previewed::Selection, Previewed::Nothing];
    let point = prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from);
    prop_oneof![
        4 => change().prop_map(Command::Edit),
        4 => change().prop_map(Command::Drag),
        2 => Just(Command::Rest),
        3 => Just(Command::Undo),
        2 => Just(Command::Redo),
        1 => prop::option::of(step.clone()).prop_map(|step| Command::Choose { step }),
        2 => (plugin, prop::option::of(step.clone()))
            .prop_map(|(plugin, at)| Command::AddStep { plugin: plugin.into(), at }),
        4 => (area(), combine, any::<bool>(), any::<bool>())
            .prop_map(|(area, combine, visible, goes_on)| Command::Select { area, combine, visible, goes_on }),
        2 => (step.clone(), role, -0.1..0.5_f64, prop::option::of(0..2_usize)).prop_map(
            |(step, role, falloff, replaces)| Command::MakeRegion { step, role, falloff, replaces }
        ),
        1 => (step.clone(), -0.1..0.8_f64).prop_map(|(step, band)| Command::MakeHandle { step, band }),
        1 => (1.5..2.5_f64).prop_map(|f| Command::RefineSelection { finer: Finer::Factor(f) }),
        1 => (step.clone(), point.clone()).prop_map(|(step, at)| Command::PlaceJoint {
            step, id: "joint".into(), at, parent: None
        }),
        1 => (step, -0.1..0.5_f64).prop_map(|(step, radius)| Command::BeginStroke {
            step, radius, strength: 1.0, params: toml::Table::new()
        }),
        2 => point.clone().prop_map(|at| Command::StrokePoint { at, pressure: None }),
        1 => Just(Command::EndStroke),
        1 => Just(Command::DropStroke),
        1 => Just(Command::Cancel { job: Job::Evaluate }),
        1 => Just(Command::Cancel { job: Job::Preview }),
        2 => prop::sample::select(previewed).prop_map(|what| Command::Preview { what }),
        2 => camera().prop_map(Command::Camera),
        1 => overlay.prop_map(Command::Show),
        1 => Just(Command::Pin),
        1 => prop::option::of((point.clone(), point.clone())).prop_map(|plane| {
            Command::Clip(plane.map(|(normal, through)| Clip { normal, through }))
        }),
        1 => prop::collection::vec(point.clone(), 0..4).prop_map(|points| Command::Measure { points }),
        1 => (text(), prop::option::of(0..4_usize)).prop_map(|(text, at)| Command::Paste { text, at }),
        2 => (0..3_usize).prop_map(|step| Command::Paste { text: format!("{COPIED}{step}"), at: None }),
        1 => Just(Command::SwapPinned),
        1 => Just(Command::Unpin),
        1 => prop::array::uniform2(-10.0..2000.0_f64).prop_map(|size| Command::Resize { size }),
    ]
}

/// Texts that somebody might paste: a step, two steps, and a text that is no step.
fn text() -> impl Strategy<Value = String> {
    prop::sample::select(vec![
        "version = 1\n[[step]]\ndeform = \"warp\"\n[step.params]\nangle = 20.0\n",
        "version = 2\n[[step]]\ndeform = \"rbf\"\ntitle = \"b\"\namount = 0.5\n[[step]]\ndeform = \"nobody\"\n",
        "[[step]]\nrefine = { shapes = [{ sphere = { center = [0, 0, 0], radius = 0.1 } }], factor = 2.0 }\n",
        "version = 1\n",
        "not a session",
        "",
    ])
    .prop_map(str::to_owned)
}

/// Begins a text that stands for the copy of a step that is there, whose place follows.
const COPIED: &str = "the copy of step ";

/// The command, with the text of a copy where it speaks of one; as it is where there is no such step.
fn with_copy(state: &State, command: Command) -> Command {
    let copy = |text: &str| state.copied(text.strip_prefix(COPIED)?.parse().ok()?).ok();
    match command {
        Command::Paste { text, at } => Command::Paste { text: copy(&text).unwrap_or(text), at },
        other => other,
    }
}

/// Number of the model's vertices.
const VERTICES: u64 = 3000;

/// Conditions that have to hold at any time.
fn check(state: &mut State) {
    let scene = state.scene().expect("a model").clone();
    assert_eq!(state.selection().marks().len(), scene.len());
    assert_eq!(scene.normals().len(), scene.len());
    assert!(scene.positions.iter().all(|p| p.is_finite()));
    assert!(scene.normals().iter().all(|n| n.is_finite()));
    assert!(state.camera().is_valid());
    assert!(state.measured().iter().all(|point| point.rest.is_finite() && point.now.is_finite()));
    if let Some(detail) = state.detail() {
        assert_eq!(detail.covered().len(), scene.len());
        let mut shown = BTreeSet::new();
        let (mut held, mut alive) = (0, 0);
        for piece in detail.pieces().values() {
            assert!(piece.batch.positions.iter().all(|p| p.is_finite()));
            held += piece.batch.positions.len() as u64;
            for ((cell, range), _) in piece.batch.cells.iter().zip(&piece.shown).filter(|(_, shown)| **shown)
            {
                assert!(shown.insert(*cell), "cell {cell} is shown twice");
                alive += range.len() as u64;
            }
        }
        assert_eq!(detail.figures().vertices, alive);
        assert!(held <= 2 * VERTICES, "{held} vertices");
    }
    for version in [ComparedVersion::Now, ComparedVersion::Pinned] {
        let samples = state.scene_of(version).map(|scene| scene.len());
        if let Some(field) = state.field_of(version) {
            assert_eq!(Some(field.values.len()), samples);
            assert!(field.values.iter().all(|x| x.is_finite()));
        }
    }
}

/// Commands between two looks at the memory: as many as can be undone.
const SPELL: usize = 1000;

/// Does so many random commands. Returns the memory that is held after each thousand, when nothing is left
/// of the steps but their history; and the slowest commands.
fn soak(commands: usize) -> (Vec<u64>, Slowest) {
    // The memory that the allocator keeps for itself differs from run to run by more than the growth that
    // is looked for.
    memory::return_large_blocks();
    let mut held = Vec::new();
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), Shape::Amphora, VERTICES), 300));
    let mut runner = TestRunner::deterministic();
    let strategy = command();
    let mut accepted = 0;
    for i in 0..commands {
        let command = with_copy(&state, strategy.new_tree(&mut runner).unwrap().current());
        // Errors are fine, and have a hint.
        match state.apply(command.clone()) {
            Ok(()) => accepted += 1,
            Err(e) => assert!(!e.to_string().is_empty(), "{command:?}"),
        }
        state.poll();
        if i % 10 == 0 {
            check(&mut state);
        }
        // There are more steps than a person adds, and each refinement makes more samples.
        if state.document().unwrap().steps().len() > 6 {
            state.apply(Command::Edit(edit::EditCommand::Remove { at: 0 })).unwrap();
        }
        if i % 50 == 0 {
            state.settle(LONG).unwrap();
            check(&mut state);
            state.take_notices();
        }
        if i % SPELL == SPELL - 1 {
            while !state.document().unwrap().steps().is_empty() {
                state.apply(Command::Edit(edit::EditCommand::Remove { at: 0 })).unwrap();
            }
            state.settle(LONG).unwrap();
            held.extend(anonymous());
        }
    }
    state.settle(LONG).unwrap();
    check(&mut state);
    assert!(accepted > commands / 4, "{accepted} of {commands}");
    // All that can be undone is a thousand changes, and some selections, and leads to some earlier state.
    let mut undone = 0;
    while state.can_undo().is_some() {
        state.apply(Command::Undo).unwrap();
        undone += 1;
    }
    assert!(undone <= 1200);
    state.settle(LONG).unwrap();
    check(&mut state);
    (held, state.slowest().clone())
}

#[test]
fn anything_in_any_order() {
    let (held, slowest) = soak(10_000);
    println!("{slowest}");
    println!("MB held after each thousand commands: {:?}", held.iter().map(|b| b >> 20).collect::<Vec<_>>());
    // The first thousands fill the list of what can be undone; after that no more is needed.
    if let (Some(early), Some(late)) = (held.get(1..4), held.get(7..)) {
        let most = |held: &[u64]| held.iter().copied().max().unwrap_or(0);
        assert!(most(late) <= most(early) + (16 << 20), "{held:?}");
    }
}
