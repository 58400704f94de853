//! Undo and redo: of the steps by their document, and of the selection between its changes.

use super::State;
use super::selections::Left;
use crate::command::{Area, Command};
use crate::selection::{Combine, Selection};
use simod_model::{Error, Result};
use simod_plugin_api::Effort;

impl State {
    /// Changes the selection; if the change goes on with the last one, both are undone as one.
    pub(super) fn set_selection(&mut self, selection: Selection, goes_on: bool) {
        let before = std::mem::replace(&mut self.selection, selection);
        if !goes_on {
            self.selections.going_on = Some(false);
        }
        if before != self.selection && self.selections.going_on == Some(false) {
            self.selections.leave(self.changes(), &before);
            self.selections.going_on = Some(true);
        }
    }

    /// Ends the present selection after a change of the steps: later selections go on with that change.
    pub(super) fn leave_selection(&mut self) {
        self.selections.going_on = None;
    }

    /// Number of changes of the steps that have been done.
    fn changes(&self) -> u64 {
        self.document().map_or(0, |document| document.depth())
    }

    /// Name of the change that [`Command::Undo`] would take back.
    pub fn can_undo(&self) -> Option<&str> {
        if self.selections.is_last(self.changes()) { Some("select") } else { self.document()?.can_undo() }
    }

    /// Name of the change that [`Command::Redo`] would do again.
    pub fn can_redo(&self) -> Option<&str> {
        if self.selections.is_next(self.changes()) { Some("select") } else { self.document()?.can_redo() }
    }

    pub(super) fn undo(&mut self) -> Result<()> {
        self.leave_selection();
        let depth = self.changes();
        if self.selections.is_last(depth)
            && let Some(left) = self.selections.done.pop_back()
        {
            let runs = self.exchange(&left);
            self.selections.undone.push(Left { depth, runs });
            return Ok(());
        }
        let (former, steps) = (self.steps_now()?, self.open()?.steps().clone());
        let label = self.document_mut()?.undo();
        self.choose_near(&steps, true);
        self.swapped(&label.ok_or_else(|| Error::argument("there is nothing to undo", "go on"))?, former);
        self.request(Effort::FULL);
        Ok(())
    }

    pub(super) fn redo(&mut self) -> Result<()> {
        self.leave_selection();
        let depth = self.changes();
        if let Some(left) = self.selections.undone.pop_if(|left| left.depth == depth) {
            let runs = self.exchange(&left);
            self.selections.done.push_back(Left { depth, runs });
            return Ok(());
        }
        let (former, steps) = (self.steps_now()?, self.open()?.steps().clone());
        let label = self.document_mut()?.redo();
        self.choose_near(&steps, true);
        self.swapped(&label.ok_or_else(|| Error::argument("there is nothing to do again", "go on"))?, former);
        self.request(Effort::FULL);
        Ok(())
    }

    /// Restores a former selection, and returns the present one.
    fn exchange(&mut self, left: &Left) -> Vec<u32> {
        let former = Selection::from_runs(&left.runs, self.selection.marks().len());
        std::mem::replace(&mut self.selection, former).runs()
    }

    pub(super) fn resolved_selection(&self, goes_on: bool) -> Command {
        let area = Area::Runs(self.selection.runs());
        Command::Select { area, combine: Combine::Replace, visible: false, goes_on }
    }
}
