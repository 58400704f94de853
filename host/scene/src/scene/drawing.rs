//! The way of a frame through the passes.

use std::ops::Range;

use wgpu::CommandEncoder;

use super::stage::{DetailShares, FilledSplats, SizedTargets};
use super::{Scene, SurfaceShare};
use crate::cloud::Cloud;
use crate::frame::FrameData;
use crate::splats::CloudRange;
use crate::targets::{SurfaceTargets, Targets, texture};
use crate::view::{PixelScale, SceneStyle, SceneView, SurfaceMode};

/// Factor by which the discs of a part of the samples are wider than their number demands, as the samples
/// are not quite evenly spread.
const PART_SLACK: f32 = 1.15;
/// Most splats of a ghost: it is faint, so a part of its samples will do.
const GHOST_SPLATS: usize = 200_000;
/// Number of triangles for each splat of the budget, beyond which a moving mesh is drawn as splats.
const TRIANGLES_PER_SPLAT: usize = 4;

/// Greatest number of halvings of the details for a frame.
const MOST_HALVED: usize = 24;

/// Factor by which the next picture at rest has more splats than the last one ...
const FINER: usize = 3;
/// ... unless these would be at least one of so many of all splats: then all are drawn.
const NEARLY_ALL: usize = 2;

impl Scene {
    /// Whether triangles are shown, in a frame of so many splats.
    fn shows_triangles(&self, style: &SceneStyle, splats: usize) -> bool {
        style.mode == SurfaceMode::Triangles
            && self.placed == self.samples()
            && self.has_triangles_for(splats)
    }

    /// Whether there are triangles, and no more than can be drawn in the time of so many splats.
    pub(super) fn has_triangles_for(&self, splats: usize) -> bool {
        let triangles = self.surface.as_ref().map_or(0, Cloud::triangles);
        self.details.is_empty() && (1..=splats.saturating_mul(TRIANGLES_PER_SPLAT)).contains(&triangles)
    }

    /// Makes the textures anew where the picture's size changed.
    pub(super) fn resize(&mut self, view: &SceneView, scale: PixelScale) {
        let device = &self.gpu.device;
        let fits = self.finished.as_ref().is_some_and(|(t, _)| [t.width(), t.height()] == view.size);
        if !fits {
            self.stages.clear();
            let texture = texture(device, "finished", view.size, crate::FORMAT);
            let shown = texture.create_view(&Default::default());
            self.finished = Some((texture, shown));
        }
        self.stages.retain(|s, _| *s == scale || *s == PixelScale::Half);
    }

    /// The textures of a scale.
    fn stage(&mut self, view: &SceneView, scale: PixelScale) {
        let device = &self.gpu.device;
        let stage = self.stages.entry(scale).or_insert_with(|| {
            let targets = Targets::new(device, view.size.map(|s| scale.drawn(s)), view.size);
            SizedTargets {
                splats: self.splats.groups(device, &targets),
                passes: self.passes.groups(device, &targets),
                targets,
            }
        });
        if self.ghost.is_some() && stage.targets.ghost.is_none() {
            stage.targets.ghost = Some(SurfaceTargets::new(device, stage.targets.size));
            stage.passes = self.passes.groups(device, &stage.targets);
        }
    }

    /// Draws a whole frame of at most so many splats.
    pub(super) fn draw(
        &mut self,
        encoder: &mut CommandEncoder,
        view: &SceneView,
        style: &SceneStyle,
        scale: PixelScale,
        splats: usize,
    ) {
        self.stage(view, scale);
        let stage = &self.stages[&scale];
        let of = self.splats();
        let shares = self.placed_of(self.shares(splats));
        let splats = self.count(shares);
        self.set_frame(view, style, stage, shares);
        self.draw_ghost(encoder, stage);
        let frame = &self.frame.group;
        let triangles = self.shows_triangles(style, if splats < of { splats } else { usize::MAX });
        match &self.surface {
            Some(surface) if triangles => {
                self.mesh.draw(encoder, &stage.targets.depth, &stage.targets.seen, frame, surface);
                let all = surface.triangles();
                self.drawn = SurfaceShare { drawn: all, of: all, complete: scale == style.scale };
            }
            Some(_) => {
                let parts = self.parts(shares);
                self.splats.depth(encoder, &stage.targets, &parts, true);
                self.splats.blend(encoder, &stage.targets, &stage.splats, &parts, true);
                self.splats.resolve(encoder, &stage.splats, frame, &stage.targets.seen);
                let complete = splats == of && scale == style.scale;
                self.drawn = SurfaceShare { drawn: splats, of, complete };
            }
            None => {
                stage.targets.seen.clear(encoder);
                self.drawn = SurfaceShare { drawn: 0, of: 0, complete: scale == style.scale };
            }
        }
        self.shown = scale;
        self.light(encoder, style);
    }

    /// Sums up at most so many more splats, pass by pass: first those of the picture that shows more splats
    /// than the last one, and once that is shown, those of the next one.
    pub(super) fn fill(
        &mut self,
        encoder: &mut CommandEncoder,
        view: &SceneView,
        style: &SceneStyle,
        splats: usize,
    ) {
        let scale = style.scale;
        let all = self.splats();
        if self.shows_triangles(style, usize::MAX) || all == 0 {
            return self.draw(encoder, view, style, scale, usize::MAX);
        }
        self.stage(view, scale);
        let shares = self.filled.shares.unwrap_or_else(|| self.placed_of(self.next_shares()));
        self.filled.shares = Some(shares);
        let stage = &self.stages[&scale];
        self.set_frame(view, style, stage, shares);
        let frame = &self.frame.group;
        if self.surface.is_none() {
            return;
        }
        let of = self.count(shares);
        let FilledSplats { depth, blend, .. } = self.filled;
        if depth == 0 {
            self.draw_ghost(encoder, stage);
        }
        if depth < of {
            let end = of.min(depth.saturating_add(splats));
            self.splats.depth(encoder, &stage.targets, &self.slice(shares, depth..end), depth == 0);
            self.filled.depth = end;
        } else {
            let end = of.min(blend.saturating_add(splats));
            let parts = self.slice(shares, blend..end);
            self.splats.blend(encoder, &stage.targets, &stage.splats, &parts, blend == 0);
            self.filled.blend = end;
        }
        if self.filled.blend == of {
            self.splats.resolve(encoder, &stage.splats, frame, &stage.targets.seen);
            self.drawn = SurfaceShare { drawn: of, of: all, complete: of == all };
            self.filled = FilledSplats::default();
            self.shown = scale;
            self.light(encoder, style);
        } else if self.marks_changed {
            self.finish(encoder);
        }
    }

    /// Shares of the next picture at rest, which shows more splats than the last one.
    pub(super) fn next_shares(&self) -> DetailShares {
        let SurfaceShare { drawn, of, .. } = self.drawn;
        let more = drawn.saturating_mul(FINER);
        let shares = self.shares(more);
        if more >= of / NEARLY_ALL || self.count(shares) <= drawn { self.shares(usize::MAX) } else { shares }
    }

    /// Number of splats in these shares.
    fn count(&self, shares: DetailShares) -> usize {
        shares.surface + self.details.values().map(|c| c.halved(shares.halved)).sum::<usize>()
    }

    fn draw_ghost(&self, encoder: &mut CommandEncoder, stage: &SizedTargets) {
        if let (Some(ghost), Some(seen)) = (&self.ghost, &stage.targets.ghost) {
            let frame = &self.ghost_frame.group;
            let part = [CloudRange { frame, cloud: ghost, places: 0..ghost.part(GHOST_SPLATS) }];
            self.splats.depth(encoder, &stage.targets, &part, true);
            self.splats.blend(encoder, &stage.targets, &stage.splats, &part, true);
            self.splats.resolve(encoder, &stage.splats, frame, seen);
        }
    }

    /// Draws the passes from the visible surface to the lit picture.
    fn light(&mut self, encoder: &mut CommandEncoder, style: &SceneStyle) {
        let SizedTargets { targets, passes, .. } = &self.stages[&self.shown];
        if style.occlusion {
            self.passes.occlusion(encoder, targets, passes, &self.frame.group);
        }
        self.passes.shade(encoder, targets, passes, &self.frame.group);
        self.finish(encoder);
    }

    /// Draws the pass from the lit picture to the finished one.
    pub(super) fn finish(&mut self, encoder: &mut CommandEncoder) {
        let SizedTargets { targets, passes, .. } = &self.stages[&self.shown];
        let Some((_, finished)) = &self.finished else { return };
        let frame = &self.frame.group;
        self.passes.finish(encoder, targets, passes, frame, finished);
        self.marks.draw(&self.gpu.device, encoder, targets, frame, finished);
        self.marks_changed = false;
    }

    /// Shares of the surface and of its details that are at most so many splats, evenly spread in each.
    pub(super) fn shares(&self, splats: usize) -> DetailShares {
        let Some(surface) = &self.surface else { return DetailShares::default() };
        if splats >= self.splats() {
            return DetailShares { surface: surface.len(), halved: 0 };
        }
        // Half of the splats are the details', or as many as the details have.
        let details: usize = self.details.values().map(Cloud::len).sum();
        let part = surface.part(splats - details.min(splats / 2));
        let fits = |times: &usize| {
            self.details.values().map(|c| c.halved(*times)).sum::<usize>() <= splats.saturating_sub(part)
        };
        DetailShares { surface: part, halved: (0..MOST_HALVED).find(fits).unwrap_or(MOST_HALVED) }
    }

    /// Splats of the surface and of the details in these shares.
    fn parts(&self, shares: DetailShares) -> Vec<CloudRange<'_>> {
        let surface = self.surface.iter().map(|cloud| (&self.frame.group, cloud, shares.surface));
        let details = self.details.values().map(|c| (&self.detail_frame.group, c, c.halved(shares.halved)));
        let part = |(frame, cloud, splats)| CloudRange { frame, cloud, places: 0..splats };
        surface.chain(details).map(part).collect()
    }

    /// Some places among the splats of these shares, laid side by side.
    fn slice(&self, shares: DetailShares, places: Range<usize>) -> Vec<CloudRange<'_>> {
        let mut first = 0;
        let mut parts = self.parts(shares);
        for part in &mut parts {
            let end = first + part.places.end;
            let within = |place: usize| place.clamp(first, end) - first;
            part.places = within(places.start)..within(places.end);
            first = end;
        }
        parts
    }

    /// Gives the shaders the data of a frame with these shares.
    fn set_frame(&self, view: &SceneView, style: &SceneStyle, stage: &SizedTargets, shares: DetailShares) {
        let radius = self.surface.as_ref().or(self.ghost.as_ref()).map_or(1.0, |cloud| cloud.radius);
        let size = stage.targets.size;
        let mut frame = FrameData::new(view, style, size, view.size, radius, self.ghost.is_some());
        frame.radius_scale = part_scale(shares.surface, self.samples());
        self.frame.write(&self.gpu, &frame);
        if !self.details.is_empty() {
            frame.radius_scale = part_scale(1, 1 << shares.halved);
            self.detail_frame.write(&self.gpu, &frame);
        }
        if let Some(ghost) = &self.ghost {
            frame.radius_scale = part_scale(ghost.part(GHOST_SPLATS), ghost.len());
            self.ghost_frame.write(&self.gpu, &frame);
        }
    }
}

/// Factor by which the discs of a part of the samples are wider than those of all.
fn part_scale(part: usize, all: usize) -> f32 {
    if part >= all { 1.0 } else { PART_SLACK * (all as f32 / part.max(1) as f32).sqrt() }
}
