//! The steps of an edit as a user changes them: every change is a command, and can be undone.

use super::entry::{Entry, StepId};
use super::groups;
use crate::motion::Motion;
use crate::step::{
    Action, Deformation, HandleMove, Joint, Refine, Region, Role, Step, Stroke, check_amount, check_handles,
    check_id, check_joints, check_motion, check_name,
};
use serde::{Deserialize, Serialize};
use simod_model::{Error, Result};
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

/// Changes that can be undone. Each holds the list of steps as it was, which shares all steps that did not
/// change.
const LONGEST_HISTORY: usize = 1000;

/// Command that changes a document. Steps are named by their place, 0 for the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum EditCommand {
    /// A new step, before the one that is at this place now.
    Add {
        /// The place that the step gets.
        at: usize,
        /// The step.
        step: Box<Step>,
    },
    /// The step goes away.
    Remove {
        /// The step's place.
        at: usize,
    },
    /// The step gets another place.
    Move {
        /// The step's place.
        from: usize,
        /// The step's place afterwards.
        to: usize,
    },
    /// New steps, before the one that is at this place now.
    Insert {
        /// The place of the first.
        at: usize,
        /// The steps.
        steps: Vec<Step>,
    },
    /// All other deformations are switched off; if they are already, those are switched on that this has
    /// switched off, or all where that is not known.
    Solo {
        /// The step's place.
        at: usize,
    },
    /// Steps that follow each other become a group, or are of none any more.
    Group {
        /// The places of the steps that become a group.
        steps: Range<usize>,
        /// The group's name.
        #[serde(default)]
        name: Option<String>,
    },
    /// The step becomes the last one of a group.
    JoinGroup {
        /// The step's place.
        from: usize,
        /// The place of one of the group.
        at: usize,
    },
    /// All steps of a group are switched on, or off.
    EnableGroup {
        /// The place of one of the group's steps.
        at: usize,
        /// Whether the group's steps are to be switched on.
        enabled: bool,
    },
    /// The steps of a group get other places, one after the other.
    MoveGroup {
        /// The place of one of the group's steps.
        at: usize,
        /// The place of the first of the group's steps afterwards.
        to: usize,
    },
    /// The steps of a group go away.
    RemoveGroup {
        /// The place of one of the group's steps.
        at: usize,
    },
    /// The step becomes another one.
    Change {
        /// The step's place.
        at: usize,
        /// The change.
        change: Change,
    },
}

/// Change of a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Change {
    /// The step is done, or left out.
    Enable(bool),
    /// The step gets another title; none for the name of its plugin.
    SetTitle(Option<String>),
    /// Another amount of the deformation is done, from 0 to 1.
    SetAmount(f64),
    /// A parameter gets a value.
    SetParam {
        /// The parameter's id.
        id: String,
        /// The value as in a session file; none for the default.
        #[serde(default)]
        value: Option<toml::Value>,
    },
    /// Other regions take the place of the former ones.
    SetRegions(Vec<Region>),
    /// A handle region is moved.
    MoveRegion {
        /// The region's place among those of the step.
        region: usize,
        /// The motion from the rest pose, whatever it was before.
        motion: Motion,
    },
    /// Other joints take the place of the former ones, each after the joint that it hangs on. Motions of
    /// joints that are gone go with them.
    SetJoints(Vec<Joint>),
    /// A joint gets another id, and so do its motion and the joints that hang on it.
    RenameJoint {
        /// The joint's id.
        from: String,
        /// The joint's id afterwards.
        to: String,
    },
    /// A handle that the plugin placed is moved.
    MoveHandle {
        /// The handle's id.
        id: String,
        /// The motion from the rest pose, whatever it was before.
        motion: Motion,
    },
    /// Handles that the plugin placed are moved together.
    MoveHandles(Vec<HandleMove>),
    /// One more brush stroke, after the others.
    AddStroke(Arc<Stroke>),
    /// A stroke becomes another one.
    SetStroke {
        /// The stroke's place among those of the step.
        stroke: usize,
        /// The new stroke.
        to: Arc<Stroke>,
    },
    /// A stroke goes away.
    RemoveStroke {
        /// The stroke's place among those of the step.
        stroke: usize,
    },
    /// A refinement is of another place, or to another fineness.
    SetRefine(Refine),
}

/// Part of a document that a drag changes again and again.
#[derive(Debug, Clone, PartialEq)]
enum DragTarget {
    Param(StepId, String),
    Region(StepId, usize),
    Handle(StepId, String),
    Handles(StepId, Vec<String>),
    Amount(StepId),
    Stroke(StepId, usize),
}

/// Steps of an edit, with the changes that can be undone or done again.
#[derive(Debug, Default)]
pub struct Document {
    steps: Arc<[Entry]>,
    /// Changes that were done, oldest first, with the steps before them.
    undo: VecDeque<(String, Arc<[Entry]>)>,
    /// Changes that were undone, oldest first, with the steps after them.
    redo: Vec<(String, Arc<[Entry]>)>,
    next: u64,
    /// Number of changes that have been done, less those undone.
    depth: u64,
    /// Part that the last command changed, if a next command on the same part belongs to it.
    dragged: Option<DragTarget>,
    /// Steps that were switched off for another one.
    silenced: Vec<StepId>,
}

impl Document {
    /// A document with these steps, and nothing to undo.
    pub fn new(steps: impl IntoIterator<Item = Step>) -> Self {
        let mut this = Self::default();
        this.steps = this.entries(steps);
        this
    }

    fn entry(&mut self, step: Step) -> Entry {
        self.next += 1;
        Entry { id: StepId::new(self.next), step: Arc::new(step) }
    }

    /// The steps, first to last. Two lists with the same pointer are the same.
    pub fn steps(&self) -> &Arc<[Entry]> {
        &self.steps
    }

    /// Does a command. Commands that follow each other and set the same thing, as while a handle is dragged,
    /// are undone as one, until [`rest`](Self::rest).
    ///
    /// # Errors
    /// There is no such step or region, or a value makes no sense; nothing has changed then. What only the
    /// plugin can judge, such as a parameter's range, is told when the step is done.
    pub fn apply(&mut self, command: EditCommand) -> Result<()> {
        let (label, target) = (self.label(&command), self.target(&command));
        let steps = self.changed(command)?;
        let before = std::mem::replace(&mut self.steps, steps);
        let goes_on = target.is_some() && target == self.dragged && self.redo.is_empty();
        if !goes_on {
            self.done(label, before);
        }
        self.dragged = target;
        Ok(())
    }

    /// Entries for steps that can take the place of the document's, by [`replace`](Self::replace): their ids
    /// are none that this document has had.
    pub fn entries(&mut self, steps: impl IntoIterator<Item = Step>) -> Arc<[Entry]> {
        steps.into_iter().map(|step| self.entry(step)).collect()
    }

    /// Replaces all steps by others; `label` names the change. The others are some that the document has had,
    /// or [its entries](Self::entries).
    pub fn replace(&mut self, label: &str, steps: Arc<[Entry]>) {
        self.rest();
        let before = std::mem::replace(&mut self.steps, steps);
        self.done(label.to_owned(), before);
    }

    /// Records a change, which can be undone.
    fn done(&mut self, label: String, before: Arc<[Entry]>) {
        self.undo.push_back((label, before));
        self.depth += 1;
        if self.undo.len() > LONGEST_HISTORY {
            self.undo.pop_front();
        }
        self.redo.clear();
    }

    /// Ends a drag: the next change is undone by itself.
    pub fn rest(&mut self) {
        self.dragged = None;
    }

    /// Takes the last command back, and returns its label; none where there is none.
    pub fn undo(&mut self) -> Option<String> {
        self.rest();
        let (label, before) = self.undo.pop_back()?;
        self.depth -= 1;
        self.redo.push((label.clone(), std::mem::replace(&mut self.steps, before)));
        Some(label)
    }

    /// Does again the command that was undone last, and returns its label; none where there is none.
    pub fn redo(&mut self) -> Option<String> {
        self.rest();
        let (label, after) = self.redo.pop()?;
        self.depth += 1;
        self.undo.push_back((label.clone(), std::mem::replace(&mut self.steps, after)));
        Some(label)
    }

    /// Whether a deformation is the only one that is switched on, though there are others.
    pub fn is_alone(&self, at: usize) -> bool {
        is_alone(&self.steps, at)
    }

    /// Number of changes that have been done, however many of them can still be undone: each change that is
    /// undone lowers it by one.
    pub fn depth(&self) -> u64 {
        self.depth
    }

    /// Label of the change that [`undo`](Self::undo) would take back.
    pub fn can_undo(&self) -> Option<&str> {
        self.undo.back().map(|(label, _)| label.as_str())
    }

    /// Label of the change that [`redo`](Self::redo) would do again.
    pub fn can_redo(&self) -> Option<&str> {
        self.redo.last().map(|(label, _)| label.as_str())
    }

    /// The steps after a command.
    fn changed(&mut self, command: EditCommand) -> Result<Arc<[Entry]>> {
        let mut steps = self.steps.to_vec();
        let count = steps.len();
        let check = |at: usize, end: usize| check_place(at, end, count);
        match command {
            EditCommand::Add { at, step } => {
                check(at, count + 1)?;
                step.check()?;
                let entry = self.entry(*step);
                steps.insert(at, entry);
                groups::settle(&mut steps, at);
            }
            EditCommand::Remove { at } => {
                check(at, count)?;
                steps.remove(at);
            }
            EditCommand::Move { from, to } => {
                check(from, count)?;
                check(to, count)?;
                let entry = steps.remove(from);
                steps.insert(to, entry);
                groups::settle(&mut steps, to);
            }
            EditCommand::Insert { at, steps: new } => {
                check(at, count + 1)?;
                new.iter().try_for_each(Step::check)?;
                let new: Vec<Entry> = new.into_iter().map(|step| self.entry(step)).collect();
                let places = at..at + new.len();
                steps.splice(at..at, new);
                groups::settle_new(&mut steps, places);
            }
            EditCommand::Solo { at } => {
                check(at, count)?;
                self.solo(&mut steps, at)?;
            }
            EditCommand::Change { at, change } => {
                check(at, count)?;
                edit(Arc::make_mut(&mut steps[at].step), change)?;
            }
            of_groups => change_groups(&mut steps, of_groups)?,
        }
        Ok(steps.into())
    }

    /// Switches all other deformations off, or on again.
    fn solo(&mut self, steps: &mut [Entry], at: usize) -> Result<()> {
        let deforms = |entry: &Entry| entry.step.deformation().is_some();
        if !deforms(&steps[at]) {
            return Err(Error::argument(
                "a refinement moves nothing that could be looked at alone",
                "choose a deformation",
            ));
        }
        let is_alone = is_alone(steps, at);
        let known = steps.iter().any(|entry| self.silenced.contains(&entry.id));
        let mut silenced = Vec::new();
        for (place, entry) in steps.iter_mut().enumerate().filter(|(_, entry)| deforms(entry)) {
            let was = entry.step.enabled;
            let enabled = place == at || is_alone && (was || !known || self.silenced.contains(&entry.id));
            if was && !enabled {
                silenced.push(entry.id);
            }
            if was != enabled {
                Arc::make_mut(&mut entry.step).enabled = enabled;
            }
        }
        self.silenced = silenced;
        Ok(())
    }

    /// The command's label for the user.
    fn label(&self, command: &EditCommand) -> String {
        let called = |step: &Step| step.title.clone().unwrap_or_else(|| step.name().to_owned());
        let name = |at: &usize| self.steps.get(*at).map_or_else(|| "step".to_owned(), |e| called(&e.step));
        let group_name = |at: &usize| {
            let group = self.steps.get(*at).and_then(|entry| entry.step.group.clone());
            group.unwrap_or_else(|| "a group".to_owned())
        };
        match command {
            EditCommand::Add { step, .. } => format!("add {}", called(step)),
            EditCommand::Remove { at } => format!("remove {}", name(at)),
            EditCommand::Move { from, .. } => format!("move {}", name(from)),
            EditCommand::Insert { steps, .. } => match steps.as_slice() {
                [step] => format!("paste {}", called(step)),
                steps => format!("paste {} steps", steps.len()),
            },
            EditCommand::Solo { at } => format!("only {}", name(at)),
            EditCommand::Group { name: Some(name), .. } => format!("group as {name}"),
            EditCommand::Group { name: None, .. } => "ungroup".to_owned(),
            EditCommand::JoinGroup { from, at } => format!("move {} to {}", name(from), group_name(at)),
            EditCommand::EnableGroup { at, enabled } => {
                format!("switch {} {}", group_name(at), if *enabled { "on" } else { "off" })
            }
            EditCommand::MoveGroup { at, .. } => format!("move {}", group_name(at)),
            EditCommand::RemoveGroup { at } => format!("remove {}", group_name(at)),
            EditCommand::Change { at, change } => {
                let name = name(at);
                match change {
                    Change::Enable(true) => format!("switch {name} on"),
                    Change::Enable(false) => format!("switch {name} off"),
                    Change::SetTitle(_) => format!("rename {name}"),
                    Change::SetAmount(_) => format!("change the amount of {name}"),
                    Change::SetParam { id, .. } => format!("change {id} of {name}"),
                    Change::SetRegions(_) => format!("change regions of {name}"),
                    Change::MoveRegion { .. } => format!("move a handle of {name}"),
                    Change::SetJoints(_) => format!("change joints of {name}"),
                    Change::RenameJoint { from, .. } => format!("rename {from} of {name}"),
                    Change::MoveHandle { id, .. } => format!("move {id} of {name}"),
                    Change::MoveHandles(handles) => match handles.as_slice() {
                        [one] => format!("move {} of {name}", one.id),
                        many => format!("move {} handles of {name}", many.len()),
                    },
                    Change::AddStroke(_) => format!("stroke of {name}"),
                    Change::SetStroke { .. } => format!("change a stroke of {name}"),
                    Change::RemoveStroke { .. } => format!("remove a stroke of {name}"),
                    Change::SetRefine(_) => "change a refinement".to_owned(),
                }
            }
        }
    }

    fn target(&self, command: &EditCommand) -> Option<DragTarget> {
        let EditCommand::Change { at, change } = command else { return None };
        let step = self.steps.get(*at)?.id;
        match change {
            Change::SetParam { id, .. } => Some(DragTarget::Param(step, id.clone())),
            Change::MoveRegion { region, .. } => Some(DragTarget::Region(step, *region)),
            Change::MoveHandle { id, .. } => Some(DragTarget::Handle(step, id.clone())),
            Change::MoveHandles(handles) => {
                Some(DragTarget::Handles(step, handles.iter().map(|handle| handle.id.clone()).collect()))
            }
            Change::SetAmount(_) => Some(DragTarget::Amount(step)),
            Change::SetStroke { stroke, .. } => Some(DragTarget::Stroke(step, *stroke)),
            _ => None,
        }
    }
}

/// A place that there is among the steps, which `end` is behind.
fn check_place(at: usize, end: usize, count: usize) -> Result<()> {
    if at < end {
        return Ok(());
    }
    let what = format!("there is no place {at} among {count} steps");
    Err(Error::argument(what, "places are counted from 0"))
}

/// Does a command on groups; commands of other kinds are done [before](Document::changed).
fn change_groups(steps: &mut Vec<Entry>, command: EditCommand) -> Result<()> {
    let count = steps.len();
    let check = |at: usize, end: usize| check_place(at, end, count);
    match command {
        EditCommand::Group { steps: places, name } => {
            check(places.start, places.end)?;
            check(places.end - 1, count)?;
            if let Some(name) = &name {
                check_name("group", name)?;
            }
            groups::set(&mut steps[places.clone()], name.as_ref());
            groups::part(steps, places);
        }
        EditCommand::JoinGroup { from, at } => {
            check(from, count)?;
            let to = group(steps, at)?;
            let name = steps[to.start].step.group.clone();
            if !to.contains(&from) {
                let entry = steps.remove(from);
                let to = if from < to.start { to.end - 1 } else { to.end };
                steps.insert(to, entry);
                groups::set(&mut steps[to..=to], name.as_ref());
            }
        }
        EditCommand::EnableGroup { at, enabled } => {
            let group = group(steps, at)?;
            for entry in steps[group].iter_mut().filter(|entry| entry.step.enabled != enabled) {
                Arc::make_mut(&mut entry.step).enabled = enabled;
            }
        }
        EditCommand::MoveGroup { at, to } => {
            let group = group(steps, at)?;
            let length = group.len();
            check(to, count + 1 - length)?;
            let moved: Vec<Entry> = steps.drain(group).collect();
            // A group has none within, so it goes behind one that it would come into.
            let to = groups::gap_at(steps, to);
            steps.splice(to..to, moved);
        }
        EditCommand::RemoveGroup { at } => drop(steps.drain(group(steps, at)?)),
        _ => return Err(Error::internal("a command that is of no groups is done as if it was")),
    }
    Ok(())
}

/// The group of the step at a place, which there has to be.
fn group(steps: &[Entry], at: usize) -> Result<Range<usize>> {
    let none = || Error::argument(format!("step {at} is in no group"), "choose one that is");
    groups::group_at(steps, at).ok_or_else(none)
}

/// Whether all deformations but the one at a place are switched off, and there are others.
fn is_alone(steps: &[Entry], at: usize) -> bool {
    let is_other = |(place, entry): &(usize, &Entry)| *place != at && entry.step.deformation().is_some();
    let mut others = steps.iter().enumerate().filter(is_other).peekable();
    others.peek().is_some()
        && others.all(|(_, entry)| !entry.step.enabled)
        && steps.get(at).is_some_and(|entry| entry.step.enabled)
}

fn rename_joint(step: &mut Deformation, from: &str, to: String) -> Result<()> {
    if step.joints.iter().all(|joint| joint.id != from) {
        return Err(Error::argument(format!("there is no joint `{from}`"), "choose another one"));
    }
    check_id(&to, to != from && step.joints.iter().any(|joint| joint.id == to))?;
    let ids = step.joints.iter_mut().flat_map(|joint| [Some(&mut joint.id), joint.parent.as_mut()]).flatten();
    let moved = step.handles.iter_mut().map(|handle| &mut handle.id);
    ids.chain(moved).filter(|id| **id == from).for_each(|id| id.clone_from(&to));
    Ok(())
}

fn no_stroke(stroke: usize, count: usize) -> Error {
    Error::argument(format!("there is no stroke {stroke} among {count}"), "strokes are counted from 0")
}

fn of_another_kind() -> Error {
    Error::argument("the step is of another kind", "choose another step")
}

fn edit(step: &mut Step, change: Change) -> Result<()> {
    match (&mut step.action, change) {
        (_, Change::Enable(enabled)) => step.enabled = enabled,
        (_, Change::SetTitle(title)) => {
            if let Some(title) = &title {
                check_name("title", title)?;
            }
            step.title = title;
        }
        (Action::Refine(refine), Change::SetRefine(other)) => {
            other.check()?;
            *refine = other;
        }
        (Action::Refine(_), _) => return Err(of_another_kind()),
        (Action::Deform(deformation), change) => edit_deformation(deformation, change)?,
    }
    Ok(())
}

fn edit_deformation(step: &mut Deformation, change: Change) -> Result<()> {
    match change {
        Change::SetAmount(amount) => {
            check_amount(amount)?;
            step.amount = amount;
        }
        Change::SetParam { id, value: Some(value) } => drop(step.params.insert(id, value)),
        Change::SetParam { id, value: None } => drop(step.params.remove(&id)),
        Change::SetRegions(mut regions) => {
            for region in &mut regions {
                // A handle region that gets another role stays where it is.
                if region.role != Role::Handle {
                    region.motion = Motion::default();
                }
                region.check()?;
            }
            step.regions = regions;
        }
        Change::MoveRegion { region, motion } => {
            check_motion(&motion)?;
            let handle = step.regions.get_mut(region).filter(|r| r.role == Role::Handle);
            let none = || Error::argument(format!("region {region} is no handle"), "choose a handle");
            handle.ok_or_else(none)?.motion = motion;
        }
        Change::SetJoints(joints) => {
            check_joints(&joints).map_err(|(_, defect)| defect)?;
            let has = |joints: &[Joint], id: &str| joints.iter().any(|joint| joint.id == id);
            step.handles.retain(|handle| !has(&step.joints, &handle.id) || has(&joints, &handle.id));
            step.joints = joints;
        }
        Change::RenameJoint { from, to } => rename_joint(step, &from, to)?,
        Change::MoveHandle { id, motion } => move_handles(step, vec![HandleMove { id, motion }])?,
        Change::MoveHandles(moves) => move_handles(step, moves)?,
        Change::AddStroke(stroke) => {
            check_stroke(&stroke)?;
            step.strokes.push(stroke);
        }
        Change::SetStroke { stroke, to } => {
            check_stroke(&to)?;
            let count = step.strokes.len();
            *step.strokes.get_mut(stroke).ok_or_else(|| no_stroke(stroke, count))? = to;
        }
        Change::RemoveStroke { stroke } if stroke < step.strokes.len() => drop(step.strokes.remove(stroke)),
        Change::RemoveStroke { stroke } => return Err(no_stroke(stroke, step.strokes.len())),
        // Changes of steps in general, or of refinements.
        Change::Enable(_) | Change::SetTitle(_) | Change::SetRefine(_) => return Err(of_another_kind()),
    }
    Ok(())
}

/// Handles that move get another motion, or none.
fn move_handles(step: &mut Deformation, moves: Vec<HandleMove>) -> Result<()> {
    check_handles(&moves).map_err(|(_, defect)| defect)?;
    step.handles.retain(|handle| moves.iter().all(|other| other.id != handle.id));
    step.handles.extend(moves.into_iter().filter(|handle| handle.motion != Motion::default()));
    Ok(())
}

fn check_stroke(stroke: &Stroke) -> Result<()> {
    stroke.defect().map_or(Ok(()), |(what, hint)| Err(Error::argument(what, hint)))
}
