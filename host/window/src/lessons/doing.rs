//! Conditions that parts of lessons look for, and commands that they do.

use crate::tools::{MovedPart, Tool};
use crate::window::{Commands, Window};
use glam::DVec3;
use simod_session::Motion;
use simod_session::edit::{Change, StepId};
use simod_session::step::{Deformation, HandleMove, Role};
use simod_viewer::camera::Standard;
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::{Command, Selection};

/// Last step of a plugin: its place in the list, its id, and its deformation.
pub fn step(window: &Window, plugin: &str) -> Option<(usize, StepId, Deformation)> {
    let steps = window.steps();
    steps.iter().enumerate().rev().find_map(|(at, entry)| {
        let deformation = entry.step.deformation().filter(|d| d.deform == plugin)?;
        Some((at, entry.id, deformation.clone()))
    })
}

/// Adds a step of a plugin, with the tool for it, as the menu does.
pub fn add(window: &Window, commands: &mut Commands, plugin: &str) {
    let found = window.state().plugins().get(plugin).cloned();
    match found {
        Ok(plugin) => crate::steps::added(commands, &plugin, None),
        Err(error) => commands.then(move |window| window.toasts.error(&error)),
    }
}

/// Chooses the last step of a plugin as that which is worked on, and returns its place.
pub fn choose(window: &Window, commands: &mut Commands, plugin: &str) -> Option<usize> {
    let (at, ..) = step(window, plugin)?;
    if window.state().chosen() != Some(at) {
        commands.apply(Command::Choose { step: Some(at) });
    }
    Some(at)
}

/// Value of a parameter of the plugin's step, if the parameter was set.
pub fn number(window: &Window, plugin: &str, id: &str) -> Option<f64> {
    let (_, _, deformation) = step(window, plugin)?;
    let value = deformation.params.get(id)?;
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}

pub fn change(window: &Window, commands: &mut Commands, plugin: &str, change: Change) {
    if let Some(at) = choose(window, commands, plugin) {
        commands.change(at, change, false);
    }
}

/// Looks at all of the model from its front.
pub fn look_from_front(_: &Window, commands: &mut Commands) {
    for step in [CameraMove::Look(Standard::Front), CameraMove::FrameAll] {
        commands.apply(Command::Camera(step));
    }
}

pub fn is_selected(window: &Window) -> bool {
    !window.state().selection().is_empty()
}

/// Selects the samples between two heights, from 0 at the model's foot to 1 at its top.
pub fn select_between(window: &Window, commands: &mut Commands, [from, to]: [f32; 2]) {
    let Some(scene) = window.state().scene() else { return };
    let [min, max] = scene.bounds();
    let height = |y: f32| (y - min.y) / (max.y - min.y);
    let marks = scene.positions.iter().map(|p| (from..=to).contains(&height(p.y))).collect();
    let area = Area::Runs(Selection::from_marks(marks).runs());
    commands.apply(Command::Select { area, combine: Default::default(), visible: false, goes_on: false });
}

/// Whether the plugin's step has a region of this role.
pub fn has_region(window: &Window, plugin: &str, role: Role) -> bool {
    step(window, plugin).is_some_and(|(.., d)| d.regions.iter().any(|region| region.role == role))
}

/// Makes a region of the selected samples, for the plugin's step.
pub fn make_region(window: &Window, commands: &mut Commands, plugin: &str, role: Role) {
    if choose(window, commands, plugin).is_some() {
        commands.then_draw(move |window, commands| crate::regions::make(window, commands, role));
    }
}

/// Whether a handle region of the plugin's step was moved.
pub fn is_region_moved(window: &Window, plugin: &str) -> bool {
    let moved = |m: &Motion| *m != Motion { pivot: m.pivot, ..Motion::default() };
    step(window, plugin).is_some_and(|(.., d)| d.regions.iter().any(|region| moved(&region.motion)))
}

/// The model's height, in its unit.
fn height(window: &Window) -> f64 {
    let bounds = window.state().scene().map(|scene| scene.sampled.bounds);
    bounds.map_or(1.0, |bounds| bounds.max.y - bounds.min.y)
}

/// Moves the first handle region of the plugin's step aside, and turns it.
pub fn move_region(window: &Window, commands: &mut Commands, plugin: &str) {
    let Some(at) = choose(window, commands, plugin) else { return };
    let Some((.., deformation)) = step(window, plugin) else { return };
    let Some(region) = deformation.regions.iter().position(|region| region.role == Role::Handle) else {
        return;
    };
    let motion = Motion {
        translate: DVec3::new(0.35, -0.12, 0.0) * height(window),
        axis: DVec3::NEG_Z,
        degrees: 50.0,
        pivot: window.state().handle_pivot(at, region),
        ..Motion::default()
    };
    commands.then(move |window| window.tools.target = Some(MovedPart::Region(region)));
    commands.change(at, Change::MoveRegion { region, motion }, false);
}

/// Number of handles of the plugin's step that are in the hand.
pub fn in_hand(window: &Window, plugin: &str) -> usize {
    step(window, plugin).map_or(0, |(_, id, _)| window.tools.handles(id).len())
}

/// Takes handles of the plugin's step into the hand: the `count` highest ones.
pub fn take_highest(window: &Window, commands: &mut Commands, plugin: &str, count: usize) {
    let Some(at) = choose(window, commands, plugin) else { return };
    let Some((_, id, _)) = step(window, plugin) else { return };
    let mut handles: Vec<(f64, String)> = window
        .state()
        .handles(at)
        .into_iter()
        .map(|(desc, placed)| (placed.position().y, desc.id.to_string()))
        .collect();
    handles.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let ids: Vec<String> = handles.into_iter().take(count).map(|(_, id)| id).collect();
    commands.then(move |window| {
        window.tools.take(Tool::Move);
        window.tools.take_handles(id, ids.first().cloned(), ids.into_iter().collect());
    });
}

/// Moves the handles in the hand upwards and aside.
pub fn move_in_hand(window: &Window, commands: &mut Commands, plugin: &str) {
    let Some((_, id, _)) = step(window, plugin) else { return };
    let translate = DVec3::new(0.12, 0.14, 0.0) * height(window);
    let ids = window.tools.handles(id);
    let moved = |id| HandleMove { id, motion: Motion { translate, ..Motion::default() } };
    change(window, commands, plugin, Change::MoveHandles(ids.into_iter().map(moved).collect()));
}

/// Places three joints along the upright middle of the model.
pub fn place_joints(window: &Window, commands: &mut Commands, plugin: &str) {
    let Some(step) = choose(window, commands, plugin) else { return };
    let Some(bounds) = window.state().scene().map(|scene| scene.sampled.bounds) else { return };
    let mut parent = None;
    for (i, part) in [0.05, 0.5, 0.93].into_iter().enumerate() {
        let id = format!("joint-{}", i + 1);
        let at = DVec3::new(0.0, bounds.min.y + part * (bounds.max.y - bounds.min.y), 0.0);
        commands.apply(Command::PlaceJoint { step, id: id.clone(), at, parent });
        parent = Some(id);
    }
}

/// Takes a joint into the hand, to be turned.
pub fn take_joint(window: &Window, commands: &mut Commands, plugin: &str, place: usize) {
    choose(window, commands, plugin);
    let Some((.., deformation)) = step(window, plugin) else { return };
    if let Some(joint) = deformation.joints.get(place) {
        let target = Some(MovedPart::Handle(joint.id.clone()));
        commands.then(|window| {
            window.tools.target = target;
            window.tools.take(Tool::Rotate);
        });
    }
}

/// Turns a joint towards the side.
pub fn turn_joint(window: &Window, commands: &mut Commands, plugin: &str, place: usize) {
    let Some((.., deformation)) = step(window, plugin) else { return };
    let Some(joint) = deformation.joints.get(place) else { return };
    let motion = Motion { axis: DVec3::Z, degrees: 40.0, ..Motion::default() };
    change(window, commands, plugin, Change::MoveHandle { id: joint.id.clone(), motion });
}

/// Paints a stroke from left to right over the visible surface, at a part of the picture's height.
pub fn paint(window: &Window, commands: &mut Commands, plugin: &str, part: f64) {
    let Some(step) = choose(window, commands, plugin) else { return };
    let Some(scale) = window.state().scene().map(|scene| scene.frame().scale) else { return };
    let [width, height] = window.state().size();
    let pixels = (0..24).map(|i| [width * (0.3 + 0.4 * f64::from(i) / 23.0), height * part]);
    let hits: Vec<_> = pixels.filter_map(|pixel| window.state().pick(pixel.into())).collect();
    let points: Vec<DVec3> = hits.iter().filter_map(|hit| window.state().in_step(step, hit)).collect();
    let radius = window.tools.stroke_radius * scale;
    if points.is_empty() {
        return;
    }
    let begin = Command::BeginStroke { step, radius, strength: 1.0, params: Default::default() };
    commands.apply_then(begin, |window| {
        for at in points {
            window.apply(Command::StrokePoint { at, pressure: None });
        }
        window.apply(Command::EndStroke);
    });
}

pub fn strokes(window: &Window, plugin: &str) -> usize {
    step(window, plugin).map_or(0, |(.., deformation)| deformation.strokes.len())
}
