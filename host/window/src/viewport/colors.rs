//! The samples' colours: overlay or the model's own, regions of the chosen step, selection.

use super::detail::sample_colors;
use super::vertex_colors::{Mixing, VertexColors};
use crate::theme;
use crate::window::Window;
use simod_session::Shapes;
use simod_session::edit::StepId;
use simod_session::step::Role;
use simod_viewer::overlay::{self, OverlayScale, ScalarField};
use simod_viewer::{ComparedVersion, Overlay, Selection, Tint, ViewerScene};
use std::sync::Arc;

/// Share of the selection's colour in that of a selected sample, and of a region's colour.
const SELECTED: f32 = 0.75;
const REGION: f32 = 0.62;

/// State on which the colours depend.
#[derive(PartialEq, Default)]
struct ColorsKey {
    samples: usize,
    overlay: Overlay,
    tint: Tint,
    own: bool,
    /// Revisions of both versions, where an overlay is shown: its scale is that of both.
    revisions: Option<[Option<u64>; 2]>,
    /// Ends of the overlay's scale.
    range: Option<[f32; 2]>,
    selection: Selection,
    regions: Option<ShownRegions>,
    /// Whether parts of the model are shown in full.
    detail: bool,
}

/// The regions of the step that is chosen, if they are shown.
#[derive(PartialEq)]
struct ShownRegions {
    step: StepId,
    shapes: Vec<(Role, Shapes)>,
    /// Address of the positions with which the step began.
    before: usize,
}

/// The colours, as they were asked for last.
#[derive(Default)]
pub struct SampleColors {
    key: ColorsKey,
    weights: Vec<(Role, ScalarField)>,
    /// Mixing of each sample's colour with those of regions and the selection, and the outcome.
    mixing: Option<Vec<Mixing>>,
    scale: Option<OverlayScale>,
    colors: Option<Vec<[u8; 3]>>,
    tinted: Option<Vec<[u8; 3]>>,
}

impl SampleColors {
    /// Finds the samples' colours. Returns whether they have changed. The selection and regions are of the
    /// version that is worked on.
    pub fn update(&mut self, window: &Window, version: ComparedVersion, scene: &Arc<ViewerScene>) -> bool {
        let key = match version {
            ComparedVersion::Now => key(window, scene),
            ComparedVersion::Pinned => plain(window, scene),
        };
        let changed = key != self.key;
        if changed {
            if key.regions != self.key.regions || key.samples != self.key.samples {
                self.weights = weights(window, scene, &key);
            }
            self.mixing = self.mixed(scene, &key);
            self.scale = window.state().field_of(version).map(|field| field.scale());
            self.colors = self.made(window, version, scene);
            self.tinted = key.detail.then(|| sample_colors(scene.len(), self.colors.as_deref()));
            self.key = key;
        }
        changed
    }

    /// The colours of vertices, from those of their samples.
    pub fn of_vertices(&self) -> VertexColors<'_> {
        let Self { colors, mixing, scale, key, .. } = self;
        VertexColors { samples: colors.as_deref(), mixing: mixing.as_deref(), tint: key.tint, scale: *scale }
    }

    /// The colours that samples show.
    pub fn of_samples(&self) -> Option<&[[u8; 3]]> {
        self.tinted.as_deref().or(self.colors.as_deref())
    }

    /// The colours of samples, if they are not all the same.
    fn made(&self, window: &Window, version: ComparedVersion, scene: &ViewerScene) -> Option<Vec<[u8; 3]>> {
        let mut colors = match window.state().sample_colors(version) {
            Some(colors) => colors,
            None if self.mixing.is_none() => return None,
            None => vec![theme::CLAY; scene.len()],
        };
        if let Some(mixing) = &self.mixing {
            colors.iter_mut().zip(mixing).for_each(|(color, mixing)| *color = mixing.applied_to(*color));
        }
        Some(colors)
    }

    /// Mixing of each sample's colour with those of regions and the selection, if there are any.
    fn mixed(&self, scene: &ViewerScene, key: &ColorsKey) -> Option<Vec<Mixing>> {
        if self.weights.is_empty() && key.selection.is_empty() {
            return None;
        }
        let mut mixing = vec![Mixing::NONE; scene.len()];
        if key.overlay == Overlay::None {
            for (role, field) in &self.weights {
                let tint = theme::role_color(*role);
                for (mixing, weight) in mixing.iter_mut().zip(&field.values) {
                    *mixing = mixing.with(tint, REGION * weight);
                }
            }
        }
        for i in key.selection.samples() {
            let mixing = &mut mixing[i as usize];
            *mixing = mixing.with(theme::SELECTED, SELECTED);
        }
        Some(mixing)
    }
}

/// The key of a version with nothing but the overlay.
fn plain(window: &Window, scene: &ViewerScene) -> ColorsKey {
    let overlay = window.state().overlay();
    let revision = |version| window.state().scene_of(version).map(|scene| scene.revision);
    let revisions = [ComparedVersion::Now, ComparedVersion::Pinned].map(revision);
    let range = window.state().field().map(|field| field.range);
    let revisions = (overlay != Overlay::None).then_some(revisions);
    let (tint, own) = (window.state().tint(), window.state().has_own_colors());
    ColorsKey { samples: scene.len(), overlay, tint, own, revisions, range, ..ColorsKey::default() }
}

fn key(window: &Window, scene: &Arc<ViewerScene>) -> ColorsKey {
    let regions = window.chosen().filter(|_| window.looks.regions).map(|(at, id, deformation, _)| {
        let shapes = deformation.regions.into_iter().map(|r| (r.role, r.shapes)).collect();
        let before = scene.before.get(at).map_or(0, |before| before.as_ptr() as usize);
        ShownRegions { step: id, shapes, before }
    });
    let (selection, detail) = (window.state().selection().clone(), window.state().detail().is_some());
    ColorsKey { selection, regions, detail, ..plain(window, scene) }
}

fn weights(window: &Window, scene: &ViewerScene, key: &ColorsKey) -> Vec<(Role, ScalarField)> {
    let (Some(regions), Some(at)) = (&key.regions, window.state().chosen()) else {
        return Vec::new();
    };
    // A step that was not reached yet begins with the shown positions.
    let before = scene.before.get(at).unwrap_or(&scene.positions);
    regions.shapes.iter().map(|(role, shapes)| (*role, overlay::region(scene, before, shapes))).collect()
}
