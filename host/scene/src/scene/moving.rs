//! Samples that move while only a part of them is drawn: the others need not be brought up to date.

use std::sync::Arc;

use super::stage::DetailShares;
use super::{Scene, SurfaceShare};
use crate::budget::Budget;
use crate::cloud::{BadSurface, SceneSurface, same_length};
use crate::view::{SceneStyle, SceneView, SurfaceMode};

impl Scene {
    /// Marks all samples as moved: none of them is up to date any more, and the next picture is another
    /// one.
    pub fn outdate(&mut self) {
        (self.placed, self.of) = (0, None);
    }

    /// Whether the picture is that of this view and style, or on its way to it.
    pub fn is_of(&self, view: &SceneView, style: &SceneStyle) -> bool {
        self.of == Some(self.drawable(view, style))
    }

    /// Greatest number of samples that the next picture draws: only these [first ones](Self::first) have to
    /// be up to date for it.
    pub fn reach(&self, view: &SceneView, style: &SceneStyle, budget: Option<&Budget>) -> usize {
        let all = self.samples();
        let Some(budget) = budget else { return all };
        if !self.is_of(view, style) {
            let splats = budget.splats();
            return if self.would_show_triangles(style, splats) { all } else { self.shares(splats).surface };
        }
        match (self.drawn, self.filled.shares) {
            (SurfaceShare { complete: true, .. }, _) => self.placed,
            _ if self.would_show_triangles(style, usize::MAX) => all,
            (_, Some(shares)) => shares.surface,
            (_, None) => self.next_shares().surface,
        }
    }

    /// Whether triangles would be shown in a frame of so many splats, if all samples were up to date.
    fn would_show_triangles(&self, style: &SceneStyle, splats: usize) -> bool {
        style.mode == SurfaceMode::Triangles
            && self.has_triangles_for(if splats < self.splats() { splats } else { usize::MAX })
    }

    /// Indices of the `count` samples that are drawn first, ascending.
    pub fn first(&mut self, count: usize) -> Arc<[u32]> {
        let count = count.min(self.samples());
        if self.first.as_ref().is_none_or(|first| first.samples.len() != count) {
            self.first = self.surface.as_ref().map(|surface| surface.first(count));
        }
        self.first.as_ref().map_or_else(Arc::default, |first| first.samples.clone())
    }

    /// Brings the [first samples](Self::first) up to date, as many as were asked for last: lists with one
    /// entry for each, in their order; triangles are not used. The picture goes on with them.
    ///
    /// # Errors
    /// The lists do not fit together, or are not of these samples.
    pub fn place_first(&mut self, of: &SceneSurface<'_>) -> Result<(), BadSurface> {
        let (Some(surface), Some(first)) = (&self.surface, &self.first) else {
            return same_length("positions", of.positions.len(), 0);
        };
        same_length("positions", of.positions.len(), first.samples.len())?;
        SceneSurface { triangles: &[], ..*of }.check()?;
        surface.write_first(&self.gpu.queue, first, of);
        self.placed = self.placed.max(first.samples.len());
        Ok(())
    }

    /// Brings all samples up to date; the picture goes on with them.
    ///
    /// # Errors
    /// The lists do not fit together, or are not of as many samples as before.
    pub fn place_all(&mut self, of: &SceneSurface<'_>) -> Result<(), BadSurface> {
        same_length("positions", of.positions.len(), self.samples())?;
        SceneSurface { triangles: &[], ..*of }.check()?;
        if let Some(surface) = &self.surface {
            let queue = &self.gpu.queue;
            surface.write_geometry(queue, of.positions, of.normals);
            surface.write_shapes(queue, of.axes);
            surface.write_look(queue, of.radii, of.colors);
        }
        self.placed = self.samples();
        Ok(())
    }

    /// The part of these shares that is up to date.
    pub(super) fn placed_of(&self, shares: DetailShares) -> DetailShares {
        DetailShares { surface: shares.surface.min(self.placed), ..shares }
    }
}
