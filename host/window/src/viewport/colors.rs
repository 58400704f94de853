//! The samples' colours: overlay, regions of the chosen step, selection.

use super::detail::sample_colors;
use crate::theme::{self, mixed};
use crate::window::Window;
use simod_session::Shapes;
use simod_session::edit::StepId;
use simod_session::session_file::Role;
use simod_viewer::overlay::{self, Field};
use simod_viewer::{Overlay, Scene, Selection, Version};
use std::sync::Arc;

/// How much of a selected sample's colour is that of the selection.
const SELECTED: f32 = 0.75;
const REGION: f32 = 0.62;

/// What the colours depend on.
#[derive(PartialEq, Default)]
struct Key {
    samples: usize,
    overlay: Overlay,
    /// Of both versions, where an overlay is shown: its scale is that of both.
    revisions: Option<[Option<u64>; 2]>,
    /// Of the overlay's scale.
    range: Option<[f32; 2]>,
    selection: Selection,
    regions: Option<Regions>,
    /// Whether parts are shown in full.
    detail: bool,
}

/// The regions of the step that is chosen, if they are shown.
#[derive(PartialEq)]
struct Regions {
    step: StepId,
    shapes: Vec<(Role, Shapes)>,
    /// The address of what the step began with.
    before: usize,
}

/// The colours, as they were asked for last.
#[derive(Default)]
pub struct Colors {
    key: Key,
    weights: Vec<(Role, Field)>,
    colors: Option<Vec<[u8; 3]>>,
    tinted: Option<Vec<[u8; 3]>>,
}

impl Colors {
    /// Finds the samples' colours. Whether they have changed. The selection and regions are of
    /// the version that is worked on.
    pub fn update(&mut self, window: &mut Window, version: Version, scene: &Arc<Scene>) -> bool {
        let key = match version {
            Version::Now => key(window, scene),
            Version::Pinned => plain(window, scene),
        };
        let changed = key != self.key;
        if changed {
            if key.regions != self.key.regions || key.samples != self.key.samples {
                self.weights = weights(window, scene, &key);
            }
            self.colors = self.made(window, version, scene, &key);
            self.tinted = key.detail.then(|| sample_colors(scene.len(), self.colors.as_deref()));
            self.key = key;
        }
        changed
    }

    /// What is shown where a sample is; nothing if it is the same everywhere.
    pub fn of_surface(&self) -> Option<&[[u8; 3]]> {
        self.colors.as_deref()
    }

    /// As samples show it.
    pub fn of_samples(&self) -> Option<&[[u8; 3]]> {
        self.tinted.as_deref().or(self.colors.as_deref())
    }

    fn made(&self, window: &mut Window, version: Version, scene: &Scene, key: &Key) -> Option<Vec<[u8; 3]>> {
        let field = window.state_mut().field_of(version);
        if field.is_none() && self.weights.is_empty() && key.selection.is_empty() {
            return None;
        }
        let mut colors = match field {
            Some(field) => (0..scene.len()).map(|i| field.color(i)).collect(),
            None => vec![theme::CLAY; scene.len()],
        };
        if key.overlay == Overlay::None {
            for (role, field) in &self.weights {
                let tint = theme::role_color(*role);
                for (color, weight) in colors.iter_mut().zip(&field.values) {
                    *color = mixed(*color, tint, REGION * weight);
                }
            }
        }
        for i in key.selection.samples() {
            let color = &mut colors[i as usize];
            *color = mixed(*color, theme::SELECTED, SELECTED);
        }
        Some(colors)
    }
}

/// Of a version with nothing but the overlay.
fn plain(window: &mut Window, scene: &Scene) -> Key {
    let overlay = window.state().overlay();
    let revision = |version| window.state().scene_of(version).map(|scene| scene.revision);
    let revisions = [Version::Now, Version::Pinned].map(revision);
    let range = window.state_mut().field().map(|field| field.range);
    let revisions = (overlay != Overlay::None).then_some(revisions);
    Key { samples: scene.len(), overlay, revisions, range, ..Key::default() }
}

fn key(window: &mut Window, scene: &Arc<Scene>) -> Key {
    let regions = window.chosen().filter(|_| window.looks.regions).map(|(at, id, deformation, _)| {
        let shapes = deformation.regions.into_iter().map(|r| (r.role, r.shapes)).collect();
        let before = scene.before.get(at).map_or(0, |before| before.as_ptr() as usize);
        Regions { step: id, shapes, before }
    });
    let (selection, detail) = (window.state().selection().clone(), window.state().detail().is_some());
    Key { selection, regions, detail, ..plain(window, scene) }
}

fn weights(window: &Window, scene: &Scene, key: &Key) -> Vec<(Role, Field)> {
    let (Some(regions), Some(at)) = (&key.regions, window.state().chosen()) else {
        return Vec::new();
    };
    // A step that was not reached yet begins with what is shown.
    let before = scene.before.get(at).unwrap_or(&scene.positions);
    regions.shapes.iter().map(|(role, shapes)| (*role, overlay::region(scene, before, shapes))).collect()
}
