//! Documents and their evaluation, with a plugin that counts how often it is called.

use super::*;
use crate::deformer::Plugin;
use crate::motion::Motion;
use crate::plugins::PluginRegistry;
use crate::session_file::{Region, Role, SessionFile, Step, Stroke};
use crate::shapes::{Shape, Shapes};
use crate::stack::{RestShape, Stack};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use simod_core::frame::Frame;
use simod_core::geometry::Bounds;
use simod_core::progress::Silent;
use simod_plugin_api as api;
use simod_plugin_api::__private::{abi_stable, capability, find_extension, root_module};
use std::cell::Cell;
use std::path::Path;
use std::sync::Arc;

thread_local! {
    /// Calls of `prepare` and of `deform` on this thread.
    static CALLS: Cell<[usize; 2]> = const { Cell::new([0; 2]) };
}

fn count(call: usize) {
    let mut calls = CALLS.get();
    calls[call] += 1;
    CALLS.set(calls);
}

/// How often it prepared and deformed since this was asked last.
fn calls() -> [usize; 2] {
    CALLS.replace([0; 2])
}

/// Turns about z by the point's height, by `factor` from the preparation; moves by `shift`, more in handles and for each
/// stroke. So no two of its steps can be exchanged.
struct Counted;

impl api::Deformer for Counted {
    type State = (f64, Vec<f32>);
    type Scratch = ();

    fn descriptor() -> api::Descriptor {
        let consumes = api::Consumes {
            handle_regions: true,
            strokes: true,
            effort: true,
            normals: true,
            ..api::Consumes::default()
        };
        api::Descriptor::new("counted", "Counted", "1.0.0")
            .param(api::ParamDesc::float("factor", "Factor", 1.0).invalidates_preparation())
            .param(api::ParamDesc::float("shift", "Shift", 0.0))
            .consumes(consumes)
    }

    fn prepare(input: &api::PrepareInput<'_>, host: &api::Host<'_>) -> api::PluginResult<Self::State> {
        count(0);
        host.progress(0.0)?;
        let weights = input.regions().first().map_or(Vec::new(), |r| r.weights().to_vec());
        Ok((input.params().float("factor")?, weights))
    }

    fn deform(
        (factor, weights): &Self::State,
        input: &api::DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &api::Host<'_>,
    ) -> api::PluginResult<()> {
        count(1);
        host.progress(0.5)?;
        let mut shift = input.params().float("shift")?;
        if shift > 100.0 {
            return Err(api::PluginError::parameter("shift", "is too far"));
        }
        shift += input.strokes().iter().map(|s| s.strength).sum::<f64>();
        if input.effort() == api::Effort::DRAFT {
            shift = shift.round();
        }
        for (i, (o, p)) in out.iter_mut().zip(input.samples.positions()).enumerate() {
            let (sin, cos) = (factor * f64::from(p[2])).sin_cos();
            let [x, y, z] = p.map(f64::from);
            let turned = [cos * x - sin * y + shift, sin * x + cos * y, z];
            let moved = input.transforms().first().map_or(turned, |t| t.apply(turned));
            let weight = f64::from(weights.get(i).copied().unwrap_or(0.0));
            *o = std::array::from_fn(|k| (turned[k] + weight * (moved[k] - turned[k])) as f32);
        }
        Ok(())
    }
}

impl api::IsIdentity for Counted {
    fn is_identity(input: &api::DeformInput<'_>) -> api::PluginResult<bool> {
        let none = input.strokes().is_empty() && input.transforms().is_empty();
        Ok(none && input.params().float("factor")? == 0.0 && input.params().float("shift")? == 0.0)
    }
}

extern "C" fn extension(
    id: abi_stable::std_types::RStr<'_>,
) -> abi_stable::std_types::ROption<api::Extension> {
    find_extension(id.as_str(), &[capability::is_identity::<Counted> as fn() -> _])
}

fn registry() -> PluginRegistry {
    let module = root_module::<Counted>(extension);
    PluginRegistry::of([Plugin::in_process(module, Path::new("counted")).unwrap()])
}

/// Calls with samples on a line.
fn with_shape<T>(call: impl FnOnce(&RestShape<'_>) -> T) -> T {
    let positions: Vec<Vec3> = (0..20).map(|i| Vec3::new(1.0, 0.1 * i as f32, 0.05 * i as f32)).collect();
    let renormal = |positions: &[Vec3]| vec![Vec3::Z; positions.len()];
    call(&RestShape {
        positions: &positions,
        normals: &vec![Vec3::X; positions.len()],
        spacing: &[],
        triangles: &[],
        neighbours: None,
        frame: Frame { origin: DVec3::ZERO, scale: 2.0 },
        bounds: Bounds { min: DVec3::ZERO, max: DVec3::splat(4.0) },
        renormal: Some(&renormal),
    })
}

fn step(params: &str) -> Step {
    let text = format!("[[step]]\ndeform = \"counted\"\nparams = {{ {params} }}");
    SessionFile::parse(&text, Path::new("s.toml")).unwrap().steps.remove(0)
}

fn change(at: usize, change: Change) -> Command {
    Command::Change { at, change }
}

fn set(at: usize, id: &str, value: f64) -> Command {
    change(at, Change::SetParam { id: id.to_owned(), value: Some(value.into()) })
}

fn handle() -> Region {
    let shape = Shape::Sphere { center: DVec3::new(2.0, 2.0, 1.0), radius: 1.0 };
    let shapes = Shapes { shapes: vec![shape], falloff: 0.5 };
    Region { role: Role::Handle, shapes, motion: Motion::default() }
}

fn stroke(strength: f64) -> Arc<Stroke> {
    let (points, params) = (vec![DVec3::ONE], toml::Table::new());
    Arc::new(Stroke { radius: 1.0, strength, points, pressures: Vec::new(), params })
}

fn steps() -> [Step; 3] {
    [step("factor = 0.5"), step("factor = -1, shift = 0.25"), step("factor = 2")]
}

fn update(evaluation: &mut Evaluation, document: &Document, effort: api::Effort) -> Evaluated {
    with_shape(|shape| {
        evaluation.update(document.steps(), (shape, 1), &registry_of_thread(), effort, &Silent)
    })
    .unwrap()
}

/// The same plugin each time: one that is loaded anew is another one.
fn registry_of_thread() -> Arc<PluginRegistry> {
    thread_local! { static REGISTRY: Arc<PluginRegistry> = Arc::new(registry()); }
    REGISTRY.with(Arc::clone)
}

/// What the steps make of the samples when they are done once, from nothing.
fn from_nothing(document: &Document) -> Vec<Vec3> {
    let steps: Vec<Step> = document.steps().iter().map(|e| (*e.step).clone()).collect();
    let stack = Stack::build(&steps, &registry()).unwrap();
    with_shape(|shape| stack.apply(shape, &Silent)).unwrap().positions
}

#[test]
fn an_edit_does_anew_what_depends_on_it_and_nothing_else() {
    let mut document = Document::new(steps());
    let mut evaluation = Evaluation::default();
    let full = api::Effort::FULL;
    calls();
    let mut after = |document: &Document| {
        let positions = update(&mut evaluation, document, full).positions.to_vec();
        let calls = calls();
        assert_eq!(positions, from_nothing(document));
        self::calls();
        calls
    };
    assert_eq!(after(&document), [3, 3]);
    assert_eq!(after(&document), [0, 0], "nothing changed");
    document.apply(set(2, "shift", 1.0)).unwrap();
    assert_eq!(after(&document), [0, 1], "the last one moves otherwise");
    document.apply(set(1, "shift", 2.0)).unwrap();
    assert_eq!(after(&document), [1, 2], "the last one has another rest shape");
    document.apply(set(1, "factor", 3.0)).unwrap();
    assert_eq!(after(&document), [2, 2]);
    document.undo().unwrap();
    assert_eq!(after(&document), [2, 2]);
    document.apply(change(2, Change::Enable(false))).unwrap();
    assert_eq!(after(&document), [0, 0], "the last one is left out");
    document.undo().unwrap();
    assert_eq!(after(&document), [1, 1], "nothing is kept of what is left out");
    document.apply(Command::Add { at: 1, step: Box::new(step("factor = 0")) }).unwrap();
    assert_eq!(after(&document), [0, 0], "it does nothing");
    document.apply(change(3, Change::SetRegions(vec![handle()]))).unwrap();
    assert_eq!(after(&document), [1, 1]);
    for i in 0..5 {
        let motion = Motion { translate: DVec3::Y * f64::from(i), ..Motion::default() };
        document.apply(change(3, Change::MoveRegion { region: 0, motion })).unwrap();
        assert_eq!(after(&document), if i == 0 { [0, 0] } else { [0, 1] }, "a drag prepares nothing");
    }
    document.apply(Command::Move { from: 0, to: 2 }).unwrap();
    assert_eq!(after(&document), [3, 3], "all have other rest shapes");
}

#[test]
fn drafts_are_for_plugins_that_ask() {
    let mut document = Document::new([step("shift = 0.75")]);
    let mut evaluation = Evaluation::default();
    let draft = update(&mut evaluation, &document, api::Effort::DRAFT).positions;
    let full = update(&mut evaluation, &document, api::Effort::FULL).positions;
    assert_eq!(draft[0].x - full[0].x, 0.25);
    document.apply(set(0, "shift", 1.0)).unwrap();
    assert_eq!(
        update(&mut evaluation, &document, api::Effort::DRAFT).positions,
        from_nothing(&document).into()
    );
}

#[test]
fn what_fails_leaves_what_comes_before_it() {
    let mut document = Document::new(steps());
    let mut evaluation = Evaluation::default();
    let full = api::Effort::FULL;
    let below = from_nothing(&Document::new(steps().into_iter().take(1)));
    let missing = Step { deform: "from-elsewhere".to_owned(), ..step("") };
    let wrong = [
        (Command::Add { at: 1, step: Box::new(missing) }, "there is no plugin `from-elsewhere`"),
        (set(1, "shift", 101.0), "`shift` is too far"),
        (change(1, Change::SetParam { id: "shift".into(), value: Some("far".into()) }), "not a number"),
        (change(1, Change::SetParam { id: "shaft".into(), value: None }), ""),
    ];
    for (command, message) in wrong {
        document.apply(command).unwrap();
        let evaluated = update(&mut evaluation, &document, full);
        if message.is_empty() {
            assert!(evaluated.failure().is_none());
            continue;
        }
        assert_eq!(*evaluated.positions, below);
        let (id, error) = evaluated.failure().unwrap();
        assert_eq!(id, document.steps()[1].id);
        assert!(
            error.to_string().contains(message) && error.to_string().starts_with("s.toml, line 1: "),
            "{error}"
        );
        let waiting = evaluated.statuses.iter().filter(|(_, s)| matches!(s, Status::Waiting)).count();
        assert_eq!(waiting, document.steps().len() - 2);
        // Left out, it harms nobody; and what was right before is right again.
        document.apply(change(1, Change::Enable(false))).unwrap();
        assert!(update(&mut evaluation, &document, full).failure().is_none());
        document.undo().unwrap();
        document.undo().unwrap();
        assert_eq!(*update(&mut evaluation, &document, full).positions, from_nothing(&document));
    }
}

#[test]
fn a_drag_is_undone_as_one() {
    let mut document = Document::new(steps());
    document.apply(change(0, Change::SetRegions(vec![handle()]))).unwrap();
    let to = |y: f64| {
        let motion = Motion { translate: DVec3::Y * y, ..Motion::default() };
        change(0, Change::MoveRegion { region: 0, motion })
    };
    let at = |document: &Document| document.steps()[0].step.regions[0].motion.translate.y;
    for y in [1.0, 2.0, 3.0] {
        document.apply(to(y)).unwrap();
    }
    document.rest();
    for y in [4.0, 5.0] {
        document.apply(to(y)).unwrap();
    }
    assert_eq!(document.can_undo(), Some("move a handle of counted"));
    assert_eq!(document.undo().as_deref(), Some("move a handle of counted"));
    assert_eq!(at(&document), 3.0);
    document.undo();
    assert_eq!(at(&document), 0.0);
    document.redo();
    assert_eq!(at(&document), 3.0);
    // What follows an undo is another drag, and nothing can be done again.
    document.apply(to(9.0)).unwrap();
    assert_eq!((at(&document), document.can_redo()), (9.0, None));
    document.undo();
    assert_eq!(at(&document), 3.0);
}

#[test]
fn what_makes_no_sense_changes_nothing() {
    let mut document = Document::new(steps());
    let before = document.steps().clone();
    let nan = Motion { translate: DVec3::NAN, ..Motion::default() };
    let joint = |id: &str, parent: Option<&str>| crate::session_file::Joint {
        id: id.to_owned(),
        at: DVec3::ZERO,
        parent: parent.map(str::to_owned),
    };
    let wrong = [
        Command::Remove { at: 3 },
        Command::Add { at: 4, step: Box::new(step("")) },
        Command::Move { from: 0, to: 3 },
        set(3, "shift", 0.0),
        change(0, Change::MoveRegion { region: 0, motion: Motion::default() }),
        change(0, Change::MoveHandle { id: "tip".to_owned(), motion: nan }),
        change(0, Change::SetRegions(vec![Region { motion: nan, ..handle() }])),
        change(0, Change::AddStroke(stroke(f64::NAN))),
        change(0, Change::SetJoints(vec![joint("a", Some("a"))])),
        change(0, Change::SetJoints(vec![joint("a", None), joint("a", None)])),
        change(0, Change::SetJoints(vec![joint("a b", None)])),
    ];
    for command in wrong {
        let error = document.apply(command.clone()).unwrap_err();
        assert!(!error.hint().is_empty(), "{command:?}");
        assert!(Arc::ptr_eq(document.steps(), &before) && document.can_undo().is_none(), "{command:?}");
    }
}

#[test]
fn a_cancelled_update_can_be_done_again() {
    struct After(std::sync::atomic::AtomicUsize);
    impl simod_core::Progress for After {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            let left = &self.0;
            let ordering = std::sync::atomic::Ordering::Relaxed;
            left.fetch_update(ordering, ordering, |n| Some(n.saturating_sub(1))) == Ok(0)
        }
    }
    let document = Document::new(steps());
    let mut evaluation = Evaluation::default();
    let mut cancelled = 0;
    for looks in 0..100 {
        let progress = After(looks.into());
        let result = with_shape(|shape| {
            let registry = registry_of_thread();
            evaluation.update(document.steps(), (shape, 1), &registry, api::Effort::FULL, &progress)
        });
        match result {
            Ok(evaluated) => {
                assert_eq!(*evaluated.positions, from_nothing(&document));
                assert!(cancelled > 3, "{cancelled}");
                return;
            }
            Err(e) => assert_eq!(e.kind(), simod_core::ErrorKind::Cancelled),
        }
        cancelled += 1;
    }
    panic!("it never ended");
}

fn command() -> impl Strategy<Value = Command> {
    let at = 0..5_usize;
    let small = -2.0..2.0_f64;
    let motion = small.clone().prop_map(|y| Motion {
        translate: DVec3::Y * y,
        degrees: 90.0 * y,
        ..Motion::default()
    });
    prop_oneof![
        (at.clone(), small.clone())
            .prop_map(|(at, x)| Command::Add { at, step: Box::new(step(&format!("factor = {x:?}"))) }),
        at.clone().prop_map(|at| Command::Remove { at }),
        (at.clone(), at.clone()).prop_map(|(from, to)| Command::Move { from, to }),
        (at.clone(), any::<bool>()).prop_map(|(at, on)| change(at, Change::Enable(on))),
        (at.clone(), small.clone()).prop_map(|(at, x)| set(at, "shift", x)),
        (at.clone(), small.clone()).prop_map(|(at, x)| set(at, "factor", x)),
        (at.clone(), any::<bool>()).prop_map(|(at, some)| {
            let region = Region { role: if some { Role::Handle } else { Role::Mask }, ..handle() };
            change(at, Change::SetRegions(vec![region]))
        }),
        (at.clone(), motion).prop_map(|(at, motion)| change(at, Change::MoveRegion { region: 0, motion })),
        (at, small).prop_map(|(at, x)| change(at, Change::AddStroke(stroke(x)))),
    ]
}

fn content(document: &Document) -> Vec<(StepId, Step)> {
    document.steps().iter().map(|e| (e.id, (*e.step).clone())).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever was done, undone and done again: the samples are where they would be from nothing, and all can be undone.
    #[test]
    fn any_edit_is_as_from_nothing_and_can_be_undone(commands in prop::collection::vec((command(), 0..6_u8), 1..30)) {
        let mut document = Document::new(steps());
        let first = content(&document);
        let mut evaluation = Evaluation::default();
        for (command, then) in commands {
            let before = content(&document);
            if document.apply(command).is_err() {
                prop_assert_eq!(content(&document), before);
            }
            match then {
                0 => drop(document.undo()),
                1 => { document.undo(); document.undo(); document.redo(); }
                2 => document.rest(),
                _ => {}
            }
            let evaluated = update(&mut evaluation, &document, api::Effort::FULL);
            prop_assert!(evaluated.failure().is_none());
            prop_assert_eq!(&*evaluated.positions, &*from_nothing(&document));
        }
        let last = content(&document);
        let mut undone = 0;
        while document.undo().is_some() {
            undone += 1;
        }
        prop_assert_eq!(content(&document), first);
        for _ in 0..undone {
            document.redo();
        }
        prop_assert_eq!(content(&document), last);
    }
}
