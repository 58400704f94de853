//! Documents and their evaluation, with a plugin that counts how often it is called.

use super::around::Around;
use super::*;
use crate::deformer::Plugin;
use crate::motion::Motion;
use crate::plugins::PluginRegistry;
use crate::session_file::SessionFile;
use crate::shapes::{RegionShape, Shapes};
use crate::step::{Action, HandleMove, Refine, Region, Role, Step, Stroke};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use simod_core::reconstruction::{DeformationField, Method, RestGeometry};
use simod_core::refinement::{Finer, Refining, SpaceSelection, appended_deformed, refine as refine_model};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use simod_generate::{ModelOptions, write_file};
use simod_model::Scalar;
use simod_model::follow::Follow;
use simod_model::progress::Silent;
use simod_model::write_points;
use simod_plugin_api as api;
use simod_plugin_api::__private::{abi_stable, capability, find_extension, root_module};
use std::cell::Cell;
use std::path::Path;
use std::sync::{Arc, LazyLock};

thread_local! {
    /// Calls of `prepare` and of `deform` on this thread.
    static CALLS: Cell<[usize; 2]> = const { Cell::new([0; 2]) };
}

fn count(call: usize) {
    let mut calls = CALLS.get();
    calls[call] += 1;
    CALLS.set(calls);
}

/// Numbers of preparations and of deformations since these were asked last.
fn calls() -> [usize; 2] {
    CALLS.replace([0; 2])
}

/// Turns about z by the point's height, by `factor` from the preparation; moves by `shift`, more in handles
/// and for each stroke. So no two of its steps can be exchanged.
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

/// A height field of 40 by 40 points, sampled by some of them.
fn sampled() -> Arc<SampledModel> {
    static SAMPLED: LazyLock<(tempfile::TempDir, Arc<SampledModel>)> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.ply");
        let point = |i: i32| (f64::from(i % 40) * 0.1, f64::from(i / 40) * 0.1);
        let points = (0..1600).map(point).map(|(x, y)| DVec3::new(x, y, (x + 2.0 * y).sin()));
        write_points(&path, points, &[], &[], Scalar::F64, &[]).unwrap();
        let sampling = Sampling { target: Target::Samples(100), ..Sampling::default() };
        let model = simod_model::open(&path).unwrap();
        let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent).unwrap();
        (folder, Arc::new(sampled))
    });
    SAMPLED.1.clone()
}

fn step(params: &str) -> Step {
    let text = format!("[[step]]\ndeform = \"counted\"\nparams = {{ {params} }}");
    SessionFile::parse(&text, Path::new("s.toml")).unwrap().steps.remove(0)
}

fn change(at: usize, change: Change) -> EditCommand {
    EditCommand::Change { at, change }
}

fn set(at: usize, id: &str, value: f64) -> EditCommand {
    change(at, Change::SetParam { id: id.to_owned(), value: Some(value.into()) })
}

fn handle() -> Region {
    let shape = RegionShape::Sphere { center: DVec3::new(2.0, 2.0, 1.0), radius: 1.0 };
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

fn refine(center: DVec3, radius: f64, finer: Finer) -> Step {
    let shapes = Shapes { shapes: vec![RegionShape::Sphere { center, radius }], falloff: 0.0 };
    let action = Action::Refine(Refine { shapes, finer });
    Step { place: "s.toml, line 9".to_owned(), ..Step::new(action) }
}

fn evaluation() -> Evaluation {
    Evaluation::new(sampled(), Refinements { folder: std::env::temp_dir(), ..Refinements::default() })
}

fn update(evaluation: &mut Evaluation, document: &Document, effort: api::Effort) -> Evaluated {
    evaluation.update(document.steps(), &registry(), effort, &Silent).unwrap()
}

/// The plugins, the same ones each time: one that is loaded anew is another one.
fn registry() -> Arc<PluginRegistry> {
    thread_local! {
        static REGISTRY: Arc<PluginRegistry> = {
            let module = root_module::<Counted>(extension);
            Arc::new(PluginRegistry::from_plugins([Plugin::in_process(module, Path::new("counted")).unwrap()]))
        };
    }
    REGISTRY.with(Arc::clone)
}

/// Positions of the samples when the steps are done once, from nothing.
fn from_nothing(document: &Document) -> Vec<Vec3> {
    let again = Document::new(document.steps().iter().map(|e| (*e.step).clone()));
    update(&mut evaluation(), &again, api::Effort::FULL).positions.to_vec()
}

#[test]
fn an_edit_does_anew_what_depends_on_it_and_nothing_else() {
    let mut document = Document::new(steps());
    let mut evaluation = evaluation();
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
    document.apply(EditCommand::Add { at: 1, step: Box::new(step("factor = 0")) }).unwrap();
    assert_eq!(after(&document), [0, 0], "it does nothing");
    document.apply(change(3, Change::SetRegions(vec![handle()]))).unwrap();
    assert_eq!(after(&document), [1, 1]);
    for i in 0..5 {
        let motion = Motion { translate: DVec3::Y * f64::from(i), ..Motion::default() };
        document.apply(change(3, Change::MoveRegion { region: 0, motion })).unwrap();
        assert_eq!(after(&document), if i == 0 { [0, 0] } else { [0, 1] }, "a drag prepares nothing");
    }
    document.apply(EditCommand::Move { from: 0, to: 2 }).unwrap();
    assert_eq!(after(&document), [3, 3], "all have other rest shapes");
}

#[test]
fn refinements_are_done_anew_where_what_comes_before_them_changed() {
    let full = api::Effort::FULL;
    let around = DVec3::new(2.0, 2.0, 0.0);
    let mut document = Document::new(steps());
    let mut evaluation = evaluation();
    let coarse = update(&mut evaluation, &document, full).sampled;
    document
        .apply(EditCommand::Add { at: 1, step: Box::new(refine(around, 1.0, Finer::Error(0.0))) })
        .unwrap();
    let fine = update(&mut evaluation, &document, full);
    assert!(fine.failure().is_none(), "{:?}", fine.failure());
    let (before, after) = (coarse.samples.len(), fine.sampled.samples.len());
    assert!(after > before + 100, "{before} to {after}");
    assert_eq!(fine.positions.len(), after);
    assert_eq!(fine.sampled.samples.positions[..before], coarse.samples.positions);
    assert_eq!(*fine.positions, *from_nothing(&document));
    calls();
    document.apply(set(2, "shift", 1.0)).unwrap();
    let again = update(&mut evaluation, &document, full);
    assert!(Arc::ptr_eq(&again.sampled, &fine.sampled), "nothing before it changed");
    assert_eq!(calls(), [1, 2]);
    // A draft does with the samples that there are; the full result does not.
    document.apply(set(0, "shift", 0.5)).unwrap();
    let draft = update(&mut evaluation, &document, api::Effort::DRAFT);
    assert!(Arc::ptr_eq(&draft.sampled, &fine.sampled));
    let full = update(&mut evaluation, &document, full);
    assert!(!Arc::ptr_eq(&full.sampled, &fine.sampled));
    assert_eq!(*full.positions, *from_nothing(&document));
    // Off the model there is nothing to refine, which is an error of that step alone.
    let nowhere = refine(DVec3::splat(99.0), 1.0, Finer::Factor(2.0));
    document.apply(EditCommand::Add { at: 4, step: Box::new(nowhere) }).unwrap();
    let evaluated = update(&mut evaluation, &document, api::Effort::FULL);
    let (id, error) = evaluated.failure().unwrap();
    assert_eq!((id, evaluated.positions.clone()), (document.steps()[4].id, full.positions));
    assert!(error.to_string().starts_with("s.toml, line 9: ") && !error.hint().is_empty(), "{error}");
    let off = Refine { finer: Finer::Factor(0.0), ..some_refine(&document, 4) };
    assert!(document.apply(change(4, Change::SetRefine(off))).is_err());
    let shapes =
        Shapes { shapes: vec![RegionShape::Sphere { center: DVec3::ZERO, radius: 99.0 }], falloff: 0.0 };
    let on = Refine { shapes, ..some_refine(&document, 4) };
    document.apply(change(4, Change::SetRefine(on))).unwrap();
    assert!(update(&mut evaluation, &document, api::Effort::FULL).failure().is_none());
}

fn some_refine(document: &Document, at: usize) -> Refine {
    match &document.steps()[at].step.action {
        Action::Refine(refine) => refine.clone(),
        Action::Deform(_) => panic!("step {at} refines nothing"),
    }
}

#[test]
fn drafts_are_for_plugins_that_ask() {
    let mut document = Document::new([step("shift = 0.75")]);
    let mut evaluation = evaluation();
    let draft = update(&mut evaluation, &document, api::Effort::DRAFT).positions;
    let full = update(&mut evaluation, &document, api::Effort::FULL).positions;
    assert!((draft[0].x - full[0].x - 0.25).abs() < 1e-6);
    document.apply(set(0, "shift", 1.0)).unwrap();
    assert_eq!(
        update(&mut evaluation, &document, api::Effort::DRAFT).positions,
        from_nothing(&document).into()
    );
}

#[test]
fn what_fails_leaves_what_comes_before_it() {
    let mut document = Document::new(steps());
    let mut evaluation = evaluation();
    let full = api::Effort::FULL;
    let below = from_nothing(&Document::new(steps().into_iter().take(1)));
    let elsewhere =
        "[[step]]\ndeform = \"from-elsewhere\"\nplugin = { version = \"2\", author = \"A\", url = \"B\" }";
    let missing = SessionFile::parse(elsewhere, Path::new("s.toml")).unwrap().steps.remove(0);
    let wrong = [
        (EditCommand::Add { at: 1, step: Box::new(missing) }, "there is no plugin `from-elsewhere`"),
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
        // A mistake in a parameter is told with the parameter's own line.
        let line = if message.contains("plugin") { 1 } else { 3 };
        let place = format!("s.toml, line {line}: ");
        assert!(error.to_string().contains(message) && error.to_string().starts_with(&place), "{error}");
        if message.contains("from-elsewhere") {
            assert!(error.hint().starts_with("it was version 2 by A, B; install it"), "{}", error.hint());
        }
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
    let at =
        |document: &Document| document.steps()[0].step.deformation().unwrap().regions[0].motion.translate.y;
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
    // A move after an undo is another drag, and nothing can be done again.
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
    let joint = |id: &str, parent: Option<&str>| crate::step::Joint {
        id: id.to_owned(),
        at: DVec3::ZERO,
        parent: parent.map(str::to_owned),
    };
    let wrong = [
        EditCommand::Remove { at: 3 },
        EditCommand::Add { at: 4, step: Box::new(step("")) },
        EditCommand::Move { from: 0, to: 3 },
        set(3, "shift", 0.0),
        change(0, Change::MoveRegion { region: 0, motion: Motion::default() }),
        change(0, Change::MoveHandle { id: "tip".to_owned(), motion: nan }),
        change(0, Change::SetRegions(vec![Region { motion: nan, ..handle() }])),
        change(0, Change::AddStroke(stroke(f64::NAN))),
        change(0, Change::SetStroke { stroke: 0, to: stroke(1.0) }),
        change(0, Change::RemoveStroke { stroke: 0 }),
        change(0, Change::SetAmount(1.5)),
        change(0, Change::SetAmount(f64::NAN)),
        change(0, Change::SetTitle(Some(String::new()))),
        EditCommand::Insert { at: 4, steps: vec![step("")] },
        EditCommand::Insert { at: 0, steps: vec![refine(DVec3::ZERO, -1.0, Finer::Error(1.0))] },
        EditCommand::Solo { at: 3 },
        change(0, Change::SetJoints(vec![joint("a", Some("a"))])),
        change(0, Change::SetJoints(vec![joint("a", None), joint("a", None)])),
        change(0, Change::SetJoints(vec![joint("a b", None)])),
        change(0, Change::RenameJoint { from: "a".into(), to: "b".into() }),
        change(
            0,
            Change::SetRefine(some_refine(&Document::new([refine(DVec3::ZERO, 1.0, Finer::Error(1.0))]), 0)),
        ),
    ];
    for command in wrong {
        let error = document.apply(command.clone()).unwrap_err();
        assert!(!error.hint().is_empty(), "{command:?}");
        assert!(Arc::ptr_eq(document.steps(), &before) && document.can_undo().is_none(), "{command:?}");
    }
}

/// A session would not be read with a region that moves and is no handle.
#[test]
fn a_handle_that_becomes_another_region_stays_where_it_is() {
    let mut document = Document::new([step("")]);
    document.apply(change(0, Change::SetRegions(vec![handle()]))).unwrap();
    let motion = Motion { degrees: 20.0, pivot: Some(DVec3::X), ..Motion::default() };
    document.apply(change(0, Change::MoveRegion { region: 0, motion })).unwrap();
    for role in [Role::Fixed, Role::Mask] {
        let region = Region { role, motion, ..handle() };
        document.apply(change(0, Change::SetRegions(vec![region]))).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edit.toml");
        let steps = document.steps().iter().map(|entry| (*entry.step).clone()).collect();
        SessionFile { steps, ..SessionFile::default() }.save(&path).unwrap();
        let read = SessionFile::load(&path).unwrap();
        let region = &read.steps[0].deformation().unwrap().regions[0];
        assert_eq!((region.role, region.motion), (role, Motion::default()));
    }
}

#[test]
fn a_joint_is_renamed_with_its_motion_and_what_hangs_on_it() {
    let mut document = Document::new([step("")]);
    let joint = |id: &str, parent: Option<&str>| crate::step::Joint {
        id: id.to_owned(),
        at: DVec3::ZERO,
        parent: parent.map(str::to_owned),
    };
    document.apply(change(0, Change::SetJoints(vec![joint("a", None), joint("b", Some("a"))]))).unwrap();
    let motion = Motion { degrees: 20.0, ..Motion::default() };
    document.apply(change(0, Change::MoveHandle { id: "a".into(), motion })).unwrap();
    let before = document.steps().clone();
    let rename = |from: &str, to: &str| change(0, Change::RenameJoint { from: from.into(), to: to.into() });
    for wrong in [rename("c", "d"), rename("a", "b"), rename("a", ""), rename("a", "two words")] {
        let error = document.apply(wrong.clone()).unwrap_err();
        assert!(!error.hint().is_empty() && Arc::ptr_eq(document.steps(), &before), "{wrong:?}");
    }
    document.apply(rename("a", "hip")).unwrap();
    let after = document.steps()[0].step.deformation().unwrap().clone();
    assert_eq!(after.joints, [joint("hip", None), joint("b", Some("hip"))]);
    assert_eq!(after.handles, [HandleMove { id: "hip".into(), motion }]);
    document.undo();
    assert_eq!(document.steps()[0].step, before[0].step);
}

#[test]
fn an_amount_is_done_without_a_preparation() {
    let mut document = Document::new(steps());
    let mut evaluation = evaluation();
    let full = api::Effort::FULL;
    update(&mut evaluation, &document, full);
    let whole = update(&mut evaluation, &document, full).positions.clone();
    calls();
    for amount in [0.75, 0.5] {
        document.apply(change(2, Change::SetAmount(amount))).unwrap();
        let now = update(&mut evaluation, &document, full);
        assert_eq!(calls(), [0, 1], "the plugin moves, and prepares nothing");
        let before = &now.before[2];
        for (p, (w, q)) in before.iter().zip(whole.iter().zip(now.positions.iter())) {
            assert!(p.lerp(*w, amount as f32).distance(*q) < 1e-5);
        }
    }
    document.apply(change(2, Change::SetAmount(0.0))).unwrap();
    let now = update(&mut evaluation, &document, full);
    assert_eq!((calls(), &now.positions), ([0, 0], &now.before[2]), "nothing is asked for");
    // A drag of it is one change.
    document.undo().unwrap();
    assert_eq!(document.steps()[2].step.deformation().unwrap().amount, 1.0);
    assert!(document.can_undo().is_none());
}

#[test]
fn handles_are_moved_together() {
    let mut document = Document::new([step("")]);
    let moves = |all: &[(&str, f64)]| {
        let one = |(id, y): &(&str, f64)| HandleMove {
            id: (*id).to_owned(),
            motion: Motion { translate: DVec3::Y * *y, ..Motion::default() },
        };
        change(0, Change::MoveHandles(all.iter().map(one).collect()))
    };
    let places = |document: &Document| -> Vec<(String, f64)> {
        let handles = &document.steps()[0].step.deformation().unwrap().handles;
        handles.iter().map(|handle| (handle.id.clone(), handle.motion.translate.y)).collect()
    };
    let at = |all: &[(&str, f64)]| all.iter().map(|(id, y)| ((*id).to_owned(), *y)).collect::<Vec<_>>();
    document.apply(moves(&[("a", 1.0), ("b", 2.0)])).unwrap();
    document.apply(moves(&[("a", 1.5), ("b", 2.5)])).unwrap();
    assert_eq!(places(&document), at(&[("a", 1.5), ("b", 2.5)]));
    document.apply(moves(&[("b", 0.0), ("c", 3.0)])).unwrap();
    assert_eq!(places(&document), at(&[("a", 1.5), ("c", 3.0)]), "what is at rest is not told");
    for wrong in [&[("a", 1.0), ("a", 2.0)][..], &[("c", 1.0), ("b", f64::NAN)]] {
        assert!(document.apply(moves(wrong)).is_err());
    }
    assert_eq!(document.undo().as_deref(), Some("move 2 handles of counted"));
    assert_eq!(places(&document), at(&[("a", 1.5), ("b", 2.5)]), "others are another change");
    document.undo();
    assert_eq!((places(&document), document.can_undo()), (Vec::new(), None), "a drag is one");
}

#[test]
fn one_step_alone_and_the_others_again() {
    let around = refine(DVec3::new(2.0, 2.0, 0.0), 1.5, Finer::Factor(3.0));
    let [first, second, third] = steps();
    let mut document = Document::new([first, around, second, third]);
    let on = |document: &Document| document.steps().iter().map(|e| e.step.enabled).collect::<Vec<_>>();
    document.apply(change(0, Change::Enable(false))).unwrap();
    assert!(!document.is_alone(2));
    document.apply(EditCommand::Solo { at: 2 }).unwrap();
    assert_eq!(on(&document), [false, true, true, false], "refinements move nothing");
    assert!(document.is_alone(2) && !document.is_alone(3));
    document.apply(EditCommand::Solo { at: 2 }).unwrap();
    assert_eq!(on(&document), [false, true, true, true], "as they were");
    document.undo().unwrap();
    assert!(document.is_alone(2), "it can be undone");
    document.apply(EditCommand::Solo { at: 3 }).unwrap();
    assert_eq!(on(&document), [false, true, false, true], "another one");
    assert!(document.apply(EditCommand::Solo { at: 1 }).is_err());
    // A document that was opened with a single step switched on knows no steps that it switched off: all
    // others are meant.
    let mut opened = Document::new(document.steps().iter().map(|e| (*e.step).clone()));
    opened.apply(EditCommand::Solo { at: 3 }).unwrap();
    assert_eq!(on(&opened), [true; 4]);
}

#[test]
fn groups_are_switched_moved_and_removed_as_one() {
    let one = |id: usize| step(&format!("shift = {id}.0"));
    let mut document = Document::new((0..6).map(one));
    // Each step by its number, in brackets where a group begins and ends.
    let seen = |document: &Document| {
        let steps = document.steps();
        let mut text = String::new();
        for (at, entry) in steps.iter().enumerate() {
            let group = group_at(steps, at);
            let is = |place: Option<usize>| place == Some(at);
            let shift = &entry.step.deformation().unwrap().params["shift"];
            text += if is(group.as_ref().map(|group| group.start)) { "(" } else { "" };
            text += &format!("{}", shift.as_float().unwrap());
            text += if is(group.map(|group| group.end - 1)) { ")" } else { "" };
        }
        text
    };
    let named = |steps, name: &str| EditCommand::Group { steps, name: Some(name.to_owned()) };
    let mut done = |command, expected: &str| {
        document.apply(command).unwrap();
        assert_eq!(seen(&document), expected);
    };
    done(named(1..3, "arms"), "0(12)345");
    done(named(4..6, "legs"), "0(12)3(45)");
    // A step that comes into a group belongs to it, one that leaves it does not, and one that stays beside it
    // keeps it.
    done(EditCommand::Move { from: 3, to: 2 }, "0(132)(45)");
    done(EditCommand::Move { from: 2, to: 0 }, "30(12)(45)");
    done(EditCommand::Move { from: 2, to: 3 }, "30(21)(45)");
    done(EditCommand::Add { at: 3, step: Box::new(one(6)) }, "30(261)(45)");
    // A group has none within.
    done(EditCommand::MoveGroup { at: 3, to: 3 }, "30(45)(261)");
    done(EditCommand::MoveGroup { at: 2, to: 0 }, "(45)30(261)");
    done(EditCommand::MoveGroup { at: 5, to: 1 }, "(45)(261)30");
    let twin = Step { group: Some("legs".to_owned()), ..one(7) };
    done(EditCommand::Insert { at: 7, steps: vec![twin.clone(), twin, one(8)] }, "(45)(261)30(77)8");
    done(EditCommand::Group { steps: 1..4, name: None }, "(4)526(1)30(77)8");
    done(EditCommand::JoinGroup { from: 0, at: 4 }, "526(14)30(77)8");
    done(EditCommand::JoinGroup { from: 9, at: 3 }, "526(148)30(77)");
    done(EditCommand::JoinGroup { from: 3, at: 4 }, "526(148)30(77)");
    done(EditCommand::Group { steps: 4..5, name: None }, "526(1)4(8)30(77)");
    done(EditCommand::RemoveGroup { at: 3 }, "5264(8)30(77)");
    done(EditCommand::Remove { at: 4 }, "526430(77)");
    done(EditCommand::Remove { at: 0 }, "26430(77)");
    assert_eq!(document.steps()[5].step.group.as_deref(), Some("legs 2"));
    document.apply(EditCommand::EnableGroup { at: 6, enabled: false }).unwrap();
    let off = |at: usize| !document.steps()[at].step.enabled;
    assert_eq!((0..7).map(off).filter(|off| *off).count(), 2);
    assert!(off(5) && off(6));
    for none in [
        EditCommand::EnableGroup { at: 1, enabled: true },
        EditCommand::MoveGroup { at: 1, to: 0 },
        EditCommand::MoveGroup { at: 5, to: 7 },
        EditCommand::RemoveGroup { at: 9 },
        named(7..9, "a"),
        named(3..3, "a"),
        named(0..1, " "),
    ] {
        assert!(document.apply(none.clone()).is_err(), "{none:?}");
    }
}

#[test]
fn steps_go_by_the_clipboard_to_another_edit() {
    let folder = tempfile::tempdir().unwrap();
    let points = (0..3000).map(|x| DVec3::new(f64::from(x), 0.0, 0.5)).collect::<Vec<_>>();
    let long = Arc::new(Stroke { points: points.clone(), ..(*stroke(0.5)).clone() });
    let picked = crate::PickedPoints::new(points, vec![DVec3::NEG_ONE]);
    let region =
        Region { shapes: Shapes { shapes: vec![RegionShape::Selection(picked)], falloff: 1.0 }, ..handle() };
    let mut document = Document::new([step("factor = 0.5"), refine(DVec3::ONE, 2.0, Finer::Samples(7))]);
    for what in [
        Change::AddStroke(long),
        Change::SetRegions(vec![region]),
        Change::SetAmount(0.25),
        Change::SetTitle(Some("Up \"there\"".to_owned())),
        Change::Enable(false),
    ] {
        document.apply(change(0, what)).unwrap();
    }
    let steps: Vec<Step> = document.steps().iter().map(|e| (*e.step).clone()).collect();
    let text = copied(&steps, &registry()).unwrap();
    let back = pasted(&text, folder.path()).unwrap();
    let plain = |steps: &[Step]| -> Vec<Step> {
        let one = |step: &Step| {
            let mut step = Step { place: String::new(), ..step.clone() };
            if let Action::Deform(deformation) = &mut step.action {
                deformation.folder.clear();
            }
            step
        };
        steps.iter().map(one).collect()
    };
    assert_eq!(plain(&back), plain(&steps));
    assert_eq!(back[0].deformation().unwrap().folder, folder.path());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "all is in the text");
    for (text, told) in [
        ("", "no steps"),
        ("version = 2\n[model]\npath = \"a.ply\"", "no steps"),
        ("Dear all,\nplease find", "the clipboard, line 1"),
        ("[[step]]\ndeform = \"x\"\namount = 2", "the clipboard, line 3"),
        ("[[step]]\ndeform = \"x\"\nstrokes = { file = \"/etc/passwd\", fingerprint = \"x\" }", "line 3"),
    ] {
        let error = pasted(text, folder.path()).unwrap_err();
        assert!(error.to_string().contains(told) && !error.hint().is_empty(), "{text}: {error}");
    }
    assert!(pasted(&"#".repeat(17 << 20), folder.path()).unwrap_err().to_string().contains("17 MB"));
}

#[test]
fn a_cancelled_update_can_be_done_again() {
    struct After(std::sync::atomic::AtomicUsize);
    impl simod_model::Progress for After {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            let left = &self.0;
            let ordering = std::sync::atomic::Ordering::Relaxed;
            left.fetch_update(ordering, ordering, |n| Some(n.saturating_sub(1))) == Ok(0)
        }
    }
    let document = Document::new(steps());
    let mut evaluation = evaluation();
    for cancelled in 0..100_usize {
        let progress = After(cancelled.into());
        let result = evaluation.update(document.steps(), &registry(), api::Effort::FULL, &progress);
        match result {
            Ok(evaluated) => {
                assert_eq!(*evaluated.positions, from_nothing(&document));
                assert!(cancelled > 3, "{cancelled}");
                return;
            }
            Err(e) => assert_eq!(e.kind(), simod_model::ErrorKind::Cancelled),
        }
    }
    panic!("it never ended");
}

/// An editor of the height field, whose session's file is in a folder of its own.
fn editor(folder: &Path) -> (Editor, Evaluation) {
    let sampled = sampled();
    let path = folder.join("edit.toml");
    let session = SessionFile { model: Some(sampled.source.path.clone()), ..SessionFile::default() };
    session.save(&path).unwrap();
    open(&path)
}

fn open(path: &Path) -> (Editor, Evaluation) {
    open_session(SessionFile::load(path).unwrap(), path)
}

fn open_session(session: SessionFile, path: &Path) -> (Editor, Evaluation) {
    Editor::open(session, Some(path.to_owned()), registry(), &Silent).unwrap()
}

fn saved_steps(session: &SessionFile) -> Vec<Step> {
    let without_place = |step: &Step| Step { place: String::new(), ..step.clone() };
    session.steps.iter().map(without_place).collect()
}

#[test]
fn what_was_not_saved_can_be_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let (mut editor, _) = editor(folder.path());
    let path = folder.path().join("edit.toml");
    let files = || {
        let mut names: Vec<_> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    };
    assert!(editor.is_saved() && recover(&path).unwrap().is_none());
    editor.autosave().unwrap();
    assert_eq!(files(), ["edit.toml"], "nothing is to be kept");
    // With a stroke that is too long for the session itself; and again, with another one.
    for i in 1..3 {
        let points = (0..3000).map(|x| DVec3::new(f64::from(x), 0.0, f64::from(i))).collect();
        let long = Arc::new(Stroke { points, ..(*stroke(0.5)).clone() });
        let add = EditCommand::Add { at: 0, step: Box::new(step("shift = 0.5")) };
        editor.document_mut().apply(add).unwrap();
        editor.document_mut().apply(change(0, Change::AddStroke(long))).unwrap();
        editor.autosave().unwrap();
        assert!(!editor.is_saved());
        let kept = files();
        let strokes = kept.iter().filter(|name| name.ends_with(".strokes")).count();
        assert_eq!((kept.len(), strokes), (2 + i as usize, i as usize), "{kept:?}");
    }
    // The program ends here; the next one finds what was kept.
    let document = Document::new(editor.document().steps().iter().map(|e| (*e.step).clone()));
    drop(editor);
    let kept = recover(&path).unwrap().unwrap();
    let expected: Vec<Step> = document.steps().iter().map(|e| (*e.step).clone()).collect();
    let (mut kept_steps, mut expected) = (saved_steps(&kept), expected);
    for step in kept_steps.iter_mut().chain(&mut expected) {
        step.place.clear();
        let Action::Deform(deformation) = &mut step.action else { panic!("a deformation") };
        deformation.folder.clear();
    }
    assert_eq!(kept_steps, expected);
    // Saved, it is not needed any more.
    let (mut editor, _) = open_session(kept, &path);
    editor.save(&path).unwrap();
    assert!(editor.is_saved() && recover(&path).unwrap().is_none());
    assert_eq!(files().iter().filter(|name| name.starts_with('.')).count(), 0, "{:?}", files());
    assert_eq!(saved_steps(&SessionFile::load(&path).unwrap()).len(), 2);
    // An edit that the user does not want is gone.
    editor.document_mut().apply(EditCommand::Remove { at: 0 }).unwrap();
    editor.autosave().unwrap();
    forget(&path).unwrap();
    assert!(recover(&path).unwrap().is_none());
}

#[test]
fn comments_of_the_file_stay_where_an_edit_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edit.toml");
    editor(folder.path()).0.save(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    simod_model::output::write_file(&path, format!("# For the catalogue.\n{text}").as_bytes()).unwrap();
    let (mut editor, _) = open_session(SessionFile::load(&path).unwrap(), &path);
    let steps = editor.document().steps().len();
    editor.document_mut().apply(EditCommand::Add { at: steps, step: Box::new(step("")) }).unwrap();
    for path in [path.clone(), folder.path().join("other.toml")] {
        editor.save(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("# For the catalogue.\n"), "{text}");
        assert_eq!(SessionFile::load(&path).unwrap().steps.len(), steps + 1);
    }
}

#[cfg(unix)]
#[test]
fn sessions_whose_names_are_no_text_are_told_apart() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &'static [u8]| folder.path().join(std::ffi::OsStr::from_bytes(name));
    let paths = [path(b"a\xfe.toml"), path(b"a\xff.toml")];
    drop(editor(folder.path()));
    let saved = SessionFile::load(&folder.path().join("edit.toml")).unwrap();
    if saved.save(&paths[0]).is_err() {
        return println!("skipped: names are text on this file system");
    }
    let mut editors = paths.each_ref().map(|path| {
        saved.save(path).unwrap();
        open(path).0
    });
    // Each with strokes that are too long for the session itself.
    for (i, editor) in editors.iter_mut().enumerate() {
        let points = (0..3000).map(|x| DVec3::new(f64::from(x), 0.0, i as f64)).collect();
        let long = Arc::new(Stroke { points, ..(*stroke(0.5)).clone() });
        let add = EditCommand::Add { at: 0, step: Box::new(step(&format!("shift = 0.{}", i + 1))) };
        editor.document_mut().apply(add).unwrap();
        editor.document_mut().apply(change(0, Change::AddStroke(long))).unwrap();
        editor.autosave().unwrap();
    }
    let shift = |session: &SessionFile| session.steps[0].deformation().unwrap().params["shift"].clone();
    for (i, path) in paths.iter().enumerate() {
        let kept = recover(path).unwrap().unwrap();
        assert_eq!(shift(&kept).as_float(), Some(0.1 * (i + 1) as f64));
        assert_eq!(kept.steps[0].deformation().unwrap().strokes.len(), 1);
    }
    // Saving one takes nothing from the other.
    editors[0].save(&paths[0]).unwrap();
    assert!(recover(&paths[0]).unwrap().is_none());
    assert_eq!(recover(&paths[1]).unwrap().unwrap().steps[0].deformation().unwrap().strokes.len(), 1);
}

#[test]
fn the_editor_writes_what_a_run_of_its_session_writes() {
    let folder = tempfile::tempdir().unwrap();
    let (mut editor, mut evaluation) = editor(folder.path());
    let [first, second, third] = steps();
    let around = refine(DVec3::new(2.0, 2.0, 0.0), 1.5, Finer::Factor(3.0));
    for (at, step) in [first, around, second, third].into_iter().enumerate() {
        editor.document_mut().apply(EditCommand::Add { at, step: Box::new(step) }).unwrap();
    }
    // Something to undo, and drafts in between.
    editor.document_mut().apply(set(3, "shift", 1.0)).unwrap();
    update(&mut evaluation, editor.document(), api::Effort::DRAFT);
    editor.document_mut().undo();
    editor.document_mut().apply(set(0, "shift", 0.125)).unwrap();
    update(&mut evaluation, editor.document(), api::Effort::DRAFT);
    let (edited, run) = (folder.path().join("edited.ply"), folder.path().join("run.ply"));
    let how = simod_core::reconstruction::Reconstruction::default();
    let full = api::Effort::FULL;
    update(&mut evaluation, editor.document(), full)
        .write(None, &Follow::default(), &edited, &how, &Silent)
        .unwrap();
    let saved = folder.path().join("elsewhere.toml");
    editor.save(&saved).unwrap();
    let session = SessionFile::load(&saved).unwrap();
    crate::Run::execute(&session, &registry(), &how, false, &run, &Silent).unwrap();
    let [edited, run, model] =
        [&edited, &run, &sampled().source.path].map(|path| std::fs::read(path).unwrap());
    assert!(edited == run, "not the same bytes");
    assert!(edited != model, "nothing was edited");
    // A step that cannot be done: nothing is written.
    editor.document_mut().apply(set(0, "shift", 1000.0)).unwrap();
    let never = folder.path().join("never.ply");
    let error = update(&mut evaluation, editor.document(), full)
        .write(None, &Follow::default(), &never, &how, &Silent)
        .unwrap_err();
    assert!(error.to_string().contains("too far"));
    assert!(!never.exists());
}

fn command() -> impl Strategy<Value = EditCommand> {
    let at = 0..5_usize;
    let small = -2.0..2.0_f64;
    let motion = small.clone().prop_map(|y| Motion {
        translate: DVec3::Y * y,
        degrees: 90.0 * y,
        ..Motion::default()
    });
    prop_oneof![
        (at.clone(), small.clone())
            .prop_map(|(at, x)| EditCommand::Add { at, step: Box::new(step(&format!("factor = {x:?}"))) }),
        at.clone().prop_map(|at| EditCommand::Remove { at }),
        (at.clone(), at.clone()).prop_map(|(from, to)| EditCommand::Move { from, to }),
        (at.clone(), any::<bool>()).prop_map(|(at, on)| change(at, Change::Enable(on))),
        (at.clone(), -0.5..1.5_f64).prop_map(|(at, x)| change(at, Change::SetAmount(x))),
        at.clone().prop_map(|at| EditCommand::Solo { at }),
        (at.clone(), at.clone(), any::<bool>()).prop_map(|(from, to, some)| EditCommand::Group {
            steps: from..to,
            name: some.then(|| "both".to_owned())
        }),
        (at.clone(), any::<bool>()).prop_map(|(at, enabled)| EditCommand::EnableGroup { at, enabled }),
        (at.clone(), at.clone()).prop_map(|(at, to)| EditCommand::MoveGroup { at, to }),
        at.clone().prop_map(|at| EditCommand::RemoveGroup { at }),
        (at.clone(), any::<bool>())
            .prop_map(|(at, some)| change(at, Change::SetTitle(some.then(|| "up".to_owned())))),
        (at.clone(), small.clone()).prop_map(|(at, x)| EditCommand::Insert {
            at,
            steps: vec![step(&format!("factor = {x:?}")), step("")]
        }),
        (at.clone(), 0..3_usize).prop_map(|(at, stroke)| change(at, Change::RemoveStroke { stroke })),
        (at.clone(), 0..3_usize, small.clone())
            .prop_map(|(at, i, x)| change(at, Change::SetStroke { stroke: i, to: stroke(x) })),
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

    /// Whatever was done, undone and done again: the samples are where they would be from nothing, and all
    /// can be undone.
    #[test]
    fn any_edit_is_as_from_nothing_and_can_be_undone(commands in prop::collection::vec((command(), 0..6_u8), 1..30)) {
        let mut document = Document::new(steps());
        let first = content(&document);
        let mut evaluation = evaluation();
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

#[test]
fn drafts_below_a_refinement_are_near_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let options = ModelOptions { vertices: 60_000, ..ModelOptions::default() };
    write_file(&options, &path, &Silent).unwrap();
    let model = simod_model::open(&path).unwrap();
    let sampling = Sampling { target: Target::Samples(6000), ..Sampling::default() };
    let before = sample(model.as_ref(), &sampling, folder.path(), &Silent).unwrap();
    let distance = |p: DVec3| p.distance(DVec3::new(0.5, 1.0, 0.0)) - 0.3;
    let selection = SpaceSelection { distance: &distance, so_far: None, at_rest: false };
    let how = Refining { finer: Finer::Factor(1.5), memory_limit: None, shapes: Vec::new() };
    let refined = refine_model(&before, model.as_ref(), selection, &how, folder.path(), &Silent).unwrap();
    let after = refined.sampled.unwrap();
    let twisted = |p: &Vec3| glam::Quat::from_rotation_y(2.0 * p.y) * *p;
    let deformed: Vec<Vec3> = before.samples.positions.iter().map(twisted).collect();

    let around = Around::new(&before, &after);
    let draft = around.draft(&after, &deformed);
    let surroundings = RestGeometry::new(&before.samples);
    let field = DeformationField::new(&surroundings, &deformed, Method::default());
    let exact = appended_deformed(&after, deformed.len(), &field);
    assert_eq!(draft.len(), after.samples.len());
    assert_eq!(draft[..deformed.len()], deformed);
    let off = |(p, q): (&Vec3, &DVec3)| p.distance(after.frame.to_local(*q));
    let worst = draft[deformed.len()..].iter().zip(&exact).map(off).fold(0.0, f32::max);
    let spacing = after.samples.spacing()[deformed.len()..].iter().copied().fold(f32::INFINITY, f32::min);
    assert!(worst < 0.02 * spacing, "{worst} of {spacing}");
    // Samples that nothing moves stay to the bit, and an affine motion is met.
    assert_eq!(*around.draft(&after, &before.samples.positions), after.samples.positions);
    let turn = glam::Affine3A::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 2.0);
    let turned = |all: &[Vec3]| all.iter().map(|p| turn.transform_point3(*p)).collect::<Vec<Vec3>>();
    let draft = around.draft(&after, &turned(&before.samples.positions));
    let off = draft.iter().zip(turned(&after.samples.positions)).map(|(p, q)| p.distance(q));
    let worst = off.fold(0.0, f32::max);
    assert!(worst < 0.01 * spacing, "{worst} of {spacing}");
}
