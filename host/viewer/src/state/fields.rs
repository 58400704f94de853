//! The numbers that are shown on the surface, of both versions on one scale.

use super::known::{FieldKey, VersionNumbers};
use super::{ComparedVersion, State};
use crate::overlay::{self, Overlay, ScalarField};
use crate::scene::ViewerScene;
use std::cell::Ref;
use std::sync::Arc;

impl State {
    /// The numbers that are shown on the surface; nothing where only the surface is.
    pub fn field(&self) -> Option<Ref<'_, ScalarField>> {
        self.field_of(ComparedVersion::Now)
    }

    /// Numbers that are shown on the surface of a version. While a version is pinned, the scale is that of
    /// both; numbers that depend on the selection, or on the step that is chosen, are of the version alone
    /// that is worked on.
    pub fn field_of(&self, version: ComparedVersion) -> Option<Ref<'_, ScalarField>> {
        self.know(ComparedVersion::Now);
        self.know(ComparedVersion::Pinned);
        let mut fields = self.fields.borrow_mut();
        let ranges = fields.iter().flatten().map(|known| known.range);
        if let Some(range) = ranges.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]) {
            fields.iter_mut().flatten().for_each(|known| known.field.range = range);
        }
        drop(fields);
        let fields = self.fields.borrow();
        Ref::filter_map(fields, |fields| Some(&fields[version as usize].as_ref()?.field)).ok()
    }

    /// The colours of a version's samples, if they are not all the same: those of the numbers that are shown,
    /// or the model's own.
    pub fn sample_colors(&self, version: ComparedVersion) -> Option<Vec<[u8; 3]>> {
        let scene = self.scene_of(version)?.clone();
        if let Some(field) = self.field_of(version) {
            return Some((0..scene.len()).map(|i| field.color(i)).collect());
        }
        let own = self.has_own_colors() && self.overlay() == Overlay::None;
        (own && !scene.sampled.colors.is_empty()).then(|| scene.sampled.colors.clone())
    }

    /// Finds the numbers of a version, unless they are known.
    fn know(&self, version: ComparedVersion) {
        let known = self.fields.borrow_mut()[version as usize].take();
        let found = self.found(version, known);
        self.fields.borrow_mut()[version as usize] = found;
    }

    fn found(&self, version: ComparedVersion, known: Option<VersionNumbers>) -> Option<VersionNumbers> {
        let scene = self.scene_of(version)?;
        let steps = self.document()?.steps();
        let (overlay, chosen) = (self.overlay, self.chosen());
        let other = match overlay {
            Overlay::Difference => Some(self.other(version)?),
            _ => None,
        };
        let carried = match version {
            ComparedVersion::Now => self.pinned.as_ref().and_then(|pinned| pinned.carried(&scene.sampled)),
            ComparedVersion::Pinned => None,
        };
        let compared = other.map(|other| (other.revision, carried.is_some()));
        let is_same = |VersionNumbers { key, .. }: &VersionNumbers| {
            let shown = match overlay {
                Overlay::Selection => key.selection == self.selection,
                Overlay::Region(_) => Arc::ptr_eq(&key.steps, steps) && key.chosen == chosen,
                _ => true,
            };
            (key.overlay, key.revision, key.other) == (overlay, scene.revision, compared) && shown
        };
        if known.as_ref().is_some_and(is_same) {
            return known;
        }
        let field = match (overlay, other) {
            (Overlay::None, _) => return None,
            (Overlay::Selection | Overlay::Region(_), _) if version == ComparedVersion::Pinned => {
                return None;
            }
            (Overlay::Selection, _) => overlay::selection(&self.selection),
            (Overlay::Region(region), _) => {
                overlay::region(scene, self.before(chosen?).ok()?, self.shapes(chosen?, region).ok()?)
            }
            (Overlay::Displacement, _) => overlay::displacement(scene),
            (Overlay::Stretch, _) => overlay::stretch(scene),
            (Overlay::Density, _) => overlay::density(scene),
            (Overlay::TransferError, _) => overlay::transfer_error(scene)?,
            (Overlay::Attribute(place), _) => overlay::attribute(scene, place)?,
            (Overlay::Difference, other) => overlay::difference(scene, other?, carried.map(|c| &**c)),
        };
        let (revision, steps) = (scene.revision, steps.clone());
        let key =
            FieldKey { overlay, revision, other: compared, selection: self.selection.clone(), steps, chosen };
        let range = field.range;
        Some(VersionNumbers { key, field, range })
    }

    /// The scene of the other version.
    fn other(&self, version: ComparedVersion) -> Option<&Arc<ViewerScene>> {
        self.scene_of(match version {
            ComparedVersion::Now => ComparedVersion::Pinned,
            ComparedVersion::Pinned => ComparedVersion::Now,
        })
    }
}
