//! The test for work of the engine whose result is of no more use.

use super::watch::StageKind;
use simod_plugin_api::Effort;
use simod_session::edit::Entry;
use simod_session::step::{Action, Region, Role, Step};
use std::sync::Arc;

/// Whether the work on the steps `before`, of which step `at` is being done (or prepared), is of use
/// neither to the eye nor to the newer request.
///
/// Drafts are never in each other's way: while something is dragged, each draft shows where the thing was a
/// moment ago. Other work is wasted once a step up to the one that is being done has changed; but not a
/// preparation that the newer request needs too.
pub fn is_wasted(
    before: &[Entry],
    was: Effort,
    after: &[Entry],
    effort: Effort,
    at: usize,
    stage: StageKind,
) -> bool {
    if was == Effort::DRAFT && effort == Effort::DRAFT {
        return false;
    }
    let same = |(a, b): (&Entry, &Entry)| a.id == b.id && Arc::ptr_eq(&a.step, &b.step);
    let first = before.iter().zip(after).take_while(|pair| same(*pair)).count();
    if first == before.len() || at < first {
        return false;
    }
    let prepared_alike = || match (before.get(at), after.get(at)) {
        (Some(a), Some(b)) => a.id == b.id && is_prepared_alike(&a.step, &b.step),
        _ => false,
    };
    !(at == first && stage == StageKind::Preparation && prepared_alike())
}

/// Whether two steps differ at most in their motions.
fn is_prepared_alike(a: &Step, b: &Step) -> bool {
    let (Action::Deform(c), Action::Deform(d)) = (&a.action, &b.action) else { return false };
    let still = |regions: &[Region]| -> Vec<_> {
        let held = regions.iter().filter(|r| r.role != Role::Mask);
        held.map(|r| (r.role, r.shapes.clone())).collect()
    };
    a.enabled == b.enabled
        && c.deform == d.deform
        && c.params == d.params
        && still(&c.regions) == still(&d.regions)
        && c.joints == d.joints
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_session::edit::{Change, Document, EditCommand};
    use simod_session::{Motion, SessionFile};
    use std::path::Path;

    #[test]
    fn what_the_newer_request_needs_goes_on() {
        let text = "[[step]]\ndeform = \"warp\"\n[[step]]\ndeform = \"rbf\"\n[[step.region]]\nrole = \"handle\"\n\
            shapes = [{ sphere = { center = [0, 0, 0], radius = 1 } }]\n[[step]]\ndeform = \"warp\"";
        let mut document = Document::new(SessionFile::parse(text, Path::new("s.toml")).unwrap().steps);
        let before = document.steps().clone();
        let (full, draft) = (Effort::FULL, Effort::DRAFT);
        let wasted = |document: &Document, was, effort, at, preparing| {
            let stage = if preparing { StageKind::Preparation } else { StageKind::Other };
            is_wasted(&before, was, document.steps(), effort, at, stage)
        };
        assert!(!wasted(&document, full, full, 1, false), "nothing changed");
        let motion = Motion { degrees: 10.0, ..Motion::default() };
        let moved = Change::MoveRegion { region: 0, motion };
        document.apply(EditCommand::Change { at: 1, change: moved }).unwrap();
        for effort in [draft, full] {
            assert!(!wasted(&document, full, effort, 1, true), "the preparation is the same");
            assert!(wasted(&document, full, effort, 1, false), "the result is not");
            assert!(!wasted(&document, full, effort, 0, false), "the step before is the same");
            assert!(wasted(&document, full, effort, 2, true), "the step after has another input");
        }
        assert!(!wasted(&document, draft, draft, 2, false), "a drag shows where it was");
        let change = Change::SetParam { id: "kernel".into(), value: Some("gaussian".into()) };
        document.apply(EditCommand::Change { at: 1, change }).unwrap();
        assert!(wasted(&document, full, full, 1, true), "another preparation");
        document.undo();
        document.undo();
        document.apply(EditCommand::Remove { at: 2 }).unwrap();
        assert!(!wasted(&document, full, full, 1, true));
        assert!(wasted(&document, full, full, 2, true), "the step is gone");
    }
}
