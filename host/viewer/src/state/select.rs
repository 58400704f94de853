//! Picking and selecting: samples under the pointer, in an area, all of them or those that are seen.

use super::State;
use crate::clip::cuts;
use crate::command::Area;
use crate::overlay;
use crate::pick::{DepthBuffer, Hit, in_lasso, near_path, within};
use crate::scene::ViewerScene;
use crate::selection::{Combine, Selection};
use glam::{DVec2, DVec3};
use simod_model::Result;
use std::sync::Arc;

impl State {
    /// The point of the surface under a pixel.
    pub fn pick(&self, pixel: DVec2) -> Option<Hit> {
        let scene = self.scene()?.clone();
        self.depth(&scene).pick(&scene, pixel)
    }

    /// Middle of the body under a pixel, as a step finds the body, in model coordinates: between the
    /// surface there and the one behind it that looks away. A point of the surface where there is none
    /// behind, as in an open scan.
    pub fn pick_middle(&self, step: usize, pixel: DVec2) -> Option<DVec3> {
        let scene = self.scene()?.clone();
        let near = self.depth(&scene).pick(&scene, pixel)?;
        let far = self.depth(&scene).pick_far_side(&scene, pixel);
        let near = self.in_step(step, &near)?;
        let far = far.and_then(|far| self.in_step(step, &far));
        Some(far.map_or(near, |far| 0.5 * (near + far)))
    }

    /// Depth buffer of the shown scene; made anew where the last one is of another scene, camera, size or
    /// plane.
    pub(super) fn depth(&self, scene: &Arc<ViewerScene>) -> Arc<DepthBuffer> {
        let (camera, size, clip) = (self.camera, self.size, self.local_clip());
        let is_it = |(revision, depth): &(u64, Arc<DepthBuffer>)| {
            *revision == scene.revision && depth.is_of(&camera, size, clip)
        };
        let known = self.depth.take().filter(is_it);
        let make = || (scene.revision, Arc::new(DepthBuffer::new(scene, &camera, size, clip)));
        let depth = known.unwrap_or_else(make);
        self.depth.replace(Some(depth.clone()));
        depth.1
    }

    pub(super) fn select(
        &mut self,
        area: &Area,
        combine: Combine,
        visible: bool,
        goes_on: bool,
    ) -> Result<()> {
        let scene = self.open()?.scene.clone();
        let pointed = self.pointed(area)?;
        let is_pointed_at = matches!(area, Area::Brush { .. } | Area::Lasso { .. } | Area::Box { .. });
        let both = |seen: &[bool]| pointed.marks().iter().zip(seen).map(|(a, b)| *a && *b).collect();
        let seen = if !is_pointed_at {
            pointed
        } else if visible {
            Selection::from_marks(both(&self.depth(&scene).visible(&scene)))
        } else {
            // Samples are taken through the model, but not through the part that is cut away.
            let clip = self.local_clip();
            let is_there: Vec<bool> = scene.positions.iter().map(|p| !cuts(clip, *p)).collect();
            Selection::from_marks(both(&is_there))
        };
        let replaces = matches!(area, Area::Inverse | Area::Grown | Area::Shrunk);
        let combine = if replaces { Combine::Replace } else { combine };
        self.set_selection(self.selection.combined(&seen, combine), goes_on);
        Ok(())
    }

    /// Samples of an area, visible or not.
    fn pointed(&self, area: &Area) -> Result<Selection> {
        let open = self.open()?;
        let (scene, adjacency) = (&open.scene.clone(), &open.adjacency.clone());
        let (camera, size, count) = (self.camera, self.size, scene.len());
        Ok(match area {
            Area::All => Selection::from_marks(vec![true; count]),
            Area::None => Selection::none(count),
            Area::Inverse => self.selection.inverted(),
            Area::Grown => self.selection.grown(adjacency),
            Area::Shrunk => self.selection.shrunk(adjacency),
            Area::Runs(runs) => Selection::from_runs(runs, count),
            Area::Brush { path, radius } => {
                Selection::from_marks(within(scene, &camera, size, |p| near_path(path, *radius, p)))
            }
            Area::Lasso { path } => {
                Selection::from_marks(within(scene, &camera, size, |p| in_lasso(path, p)))
            }
            Area::Box { from, to } => {
                let (a, b) = (DVec2::from(*from), DVec2::from(*to));
                let (min, max) = (a.min(b), a.max(b));
                Selection::from_marks(within(scene, &camera, size, |p| {
                    p.cmpge(min).all() && p.cmple(max).all()
                }))
            }
            Area::Region { step, region } => {
                let weights = overlay::region(scene, self.before(*step)?, self.shapes(*step, *region)?);
                Selection::from_marks(weights.values.iter().map(|w| *w >= 0.5).collect())
            }
            Area::Connected { at } => match self.pick(DVec2::from(*at)) {
                Some(hit) => adjacency.connected(hit.sample),
                None => Selection::none(count),
            },
        })
    }
}
