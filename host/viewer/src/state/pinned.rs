//! The pinned version: other steps on the same samples, to compare with those that are worked on.

use super::State;
use super::open::{OpenSession, nothing_open};
use super::version::{ComparedVersion, Pinned, Steps};
use crate::engine::{CarriedSamples, ComparisonRequest};
use crate::overlay::Overlay;
use crate::scene::{ViewerScene, common};
use simod_core::fingerprint::are_same;
use simod_core::sampled_model::SampledModel;
use simod_model::{Error, Result};
use simod_plugin_api::Effort;
use simod_session::SessionFile;
use std::path::Path;
use std::sync::Arc;

/// Name of a swap in the list of changes, which the user reads where it is undone.
const SWAP: &str = "go on with the pinned version";

impl State {
    /// Scene of a version, if it is there.
    pub fn scene_of(&self, version: ComparedVersion) -> Option<&Arc<ViewerScene>> {
        match version {
            ComparedVersion::Now => self.scene(),
            ComparedVersion::Pinned => self.pinned.as_ref()?.scene(),
        }
    }

    /// Name of the pinned version, if there is one; its samples may still be on their way.
    pub fn pinned(&self) -> Option<&str> {
        self.pinned.as_ref().map(|pinned| &*pinned.version.name)
    }

    pub(super) fn pin(&mut self) -> Result<()> {
        let version = self.steps_now()?;
        self.pin_version(version, false);
        Ok(())
    }

    pub(super) fn pin_session(&mut self, path: &Path) -> Result<()> {
        let open = self.open.as_mut().ok_or_else(nothing_open)?;
        let session = SessionFile::load(path)?;
        if !is_of(&session, open) {
            let what = format!("{} is an edit of another model", path.display());
            return Err(Error::argument(what, "choose a session of the model that is open"));
        }
        let steps = open.editor.document_mut().entries(session.steps);
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.pin_version(Steps { name, steps, scene: None }, true);
        Ok(())
    }

    fn pin_version(&mut self, version: Steps, whole: bool) {
        self.pins += 1;
        self.pinned = Some(Pinned { number: self.pins, version, whole, carried: None, asked: None });
        self.engine.compare(None);
        self.compare();
    }

    pub(super) fn unpin(&mut self) {
        self.pinned = None;
        self.engine.compare(None);
        if self.overlay == Overlay::Difference {
            self.overlay = Overlay::None;
        }
    }

    pub(super) fn swap_pinned(&mut self) -> Result<()> {
        let former = self.steps_now()?;
        let pinned = self
            .pinned
            .as_ref()
            .ok_or_else(|| Error::argument("nothing is pinned", "pin a version first"))?;
        if pinned.scene().is_none() {
            return Err(Error::argument("the pinned version is not there yet", "wait for it"));
        }
        let steps = pinned.version.steps.clone();
        self.document_mut()?.replace(SWAP, steps);
        self.leave_selection();
        self.swapped(SWAP, former);
        self.request(Effort::FULL);
        Ok(())
    }

    /// The version that is worked on, as it is now.
    pub(super) fn steps_now(&self) -> Result<Steps> {
        let open = self.open()?;
        let steps = open.steps().clone();
        let known = self.named.as_ref().filter(|(_, named)| Arc::ptr_eq(named, &steps));
        let name = match (known, open.editor.document().can_undo()) {
            (Some((name, _)), _) => name.clone(),
            (None, Some(label)) => format!("after \u{201c}{label}\u{201d}"),
            (None, None) => "as it was opened".to_owned(),
        };
        let scene = (self.is_settled() && self.stroke.is_none()).then(|| open.scene.clone());
        Ok(Steps { name, steps, scene })
    }

    /// Follows a change of the steps that swapped the versions, or took that back: the pinned version
    /// becomes the one that is worked on, and the `former` one is pinned. Changes with another label are no
    /// swaps.
    pub(super) fn swapped(&mut self, label: &str, former: Steps) {
        let (Some(open), Some(pinned)) = (&self.open, &mut self.pinned) else { return };
        let steps = open.steps().clone();
        if label != SWAP || !Arc::ptr_eq(&pinned.version.steps, &steps) {
            return;
        }
        let Steps { name, scene, .. } = std::mem::replace(&mut pinned.version, former);
        self.named = Some((name, steps.clone()));
        self.stroke = None;
        if self.chosen().is_none() {
            self.chosen = steps.iter().rfind(|entry| entry.step.deformation().is_some()).map(|e| e.id);
        }
        // Results of former requests are not of these steps.
        self.floor = self.requested;
        if let Some(scene) = scene {
            self.show_scene(scene);
            self.follow_samples();
        }
        let Some(Pinned { version, .. }) = self.pinned.take() else { return };
        self.pin_version(version, false);
    }

    /// Asks the engine for the parts of the pinned version that are missing.
    pub(super) fn compare(&mut self) {
        let (Some(open), Some(pinned)) = (&self.open, &mut self.pinned) else { return };
        let scene = pinned.version.scene.clone();
        let measured = scene.as_ref().is_some_and(|scene| scene.expected_error.is_some());
        let measure = self.overlay == Overlay::TransferError && !measured;
        let now = &open.scene.sampled;
        let has_others = |scene: &Arc<ViewerScene>| common(&scene.sampled, now) < open.scene.len();
        let carries = self.overlay == Overlay::Difference && pinned.carried(now).is_none();
        let onto = (carries && scene.as_ref().is_some_and(has_others)).then(|| now.clone());
        if scene.is_some() && !measure && onto.is_none() {
            return;
        }
        let same = |(m, o): &(bool, Option<Arc<SampledModel>>)| {
            let address = |o: &Option<Arc<SampledModel>>| o.as_ref().map(Arc::as_ptr);
            *m == measure && address(o) == address(&onto)
        };
        if pinned.asked.as_ref().is_some_and(same) {
            return;
        }
        pinned.asked = Some((measure, onto.clone()));
        let Pinned { number, whole, .. } = *pinned;
        let steps = pinned.version.steps.clone();
        self.engine.compare(Some(ComparisonRequest { number, steps, scene, whole, measure, onto }));
    }

    /// Asks again for a comparison that was given up.
    pub(super) fn compare_again(&mut self) {
        if let Some(pinned) = &mut self.pinned {
            pinned.asked = None;
        }
        self.compare();
    }

    /// Takes the samples of a version that the engine has made.
    pub(super) fn compared(&mut self, number: u64, scene: Arc<ViewerScene>, carried: Option<CarriedSamples>) {
        if let Some(pinned) = self.pinned.as_mut().filter(|pinned| pinned.number == number) {
            pinned.version.scene = Some(scene);
            pinned.carried = carried.or(pinned.carried.take());
        }
        self.compare();
    }

    /// Drops a version that the engine could not make: without samples it is of no use.
    pub(super) fn not_compared(&mut self) {
        if self.pinned.as_ref().is_some_and(|pinned| pinned.scene().is_none()) {
            self.unpin();
        }
    }
}

/// Whether a session is one of the model that is open.
fn is_of(session: &SessionFile, open: &OpenSession) -> bool {
    let source = &open.scene.sampled.source;
    let file = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let same = session.fingerprint.as_ref().and_then(|known| are_same(known, &source.fingerprint));
    match (same, &session.model) {
        (Some(same), _) => same,
        (None, Some(model)) => file(model) == file(open.editor.model().unwrap_or(&source.path)),
        (None, None) => true,
    }
}
