//! A scene: the surfaces and marks that are shown, and their changes since the last picture.

mod drawing;
mod moving;
mod stage;

use std::collections::BTreeMap;
use std::time::Instant;

use glam::Vec3;
use simod_picture::Image;
use wgpu::{BindGroupLayout, Texture, TextureView};

use crate::budget::Budget;
use crate::cloud::{BadSurface, Cloud, First, SceneSurface, same_length};
use crate::gpu::Gpu;
use crate::marks::{Dot, Line, Marks};
use crate::passes::Passes;
use crate::pipeline::{ShaderInput, layout};
use crate::splats::SplatPasses;
use crate::triangles::TriangleMesh;
use crate::view::{PixelScale, SceneStyle, SceneView};
use stage::{FilledSplats, SizedTargets, Uniform};

/// Greatest number of frames for each pass in which all splats are drawn at rest.
const MOST_STEPS: usize = 64;

/// A surface, maybe a ghost of another one, lines and dots, and the picture of them.
pub struct Scene {
    gpu: Gpu,
    samples: BindGroupLayout,
    splats: SplatPasses,
    mesh: TriangleMesh,
    passes: Passes,
    marks: Marks,
    /// The frame's values for the surface and all that follows, for its details, and for the ghost.
    frame: Uniform,
    detail_frame: Uniform,
    ghost_frame: Uniform,
    surface: Option<Cloud>,
    /// Number of the surface's samples, of those that are drawn first, that are up to date ...
    placed: usize,
    /// ... and the first samples, as they were asked for last.
    first: Option<First>,
    /// More splats of the surface, by numbers that others gave them.
    details: BTreeMap<u64, Cloud>,
    ghost: Option<Cloud>,
    /// Targets for each scale of pixels.
    stages: BTreeMap<PixelScale, SizedTargets>,
    finished: Option<(Texture, TextureView)>,
    /// View and style of the picture, while surfaces are as they were.
    of: Option<(SceneView, SceneStyle)>,
    /// Scale of pixels at which the picture was drawn.
    shown: PixelScale,
    drawn: SurfaceShare,
    /// Splats that are summed up so far, for the picture that follows one of a part of the splats.
    filled: FilledSplats,
    marks_changed: bool,
}

/// Share of the surface that the picture shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SurfaceShare {
    /// Splats drawn (triangles, where these are shown) ...
    pub drawn: usize,
    /// ... and number of all.
    pub of: usize,
    /// Whether the picture is complete: if not, [`Scene::render`] has more to draw, when it is called
    /// again.
    pub complete: bool,
}

impl Scene {
    /// An empty scene.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let frame = layout(device, "frame", &[ShaderInput::Uniform]);
        let samples = layout(device, "samples", &[ShaderInput::Storage; 3]);
        Self {
            splats: SplatPasses::new(device, &frame, &samples),
            mesh: TriangleMesh::new(device, &frame, &samples),
            passes: Passes::new(device, &frame),
            marks: Marks::new(device, &frame),
            frame: Uniform::new(gpu, &frame),
            detail_frame: Uniform::new(gpu, &frame),
            ghost_frame: Uniform::new(gpu, &frame),
            gpu: gpu.clone(),
            samples,
            surface: None,
            placed: 0,
            first: None,
            details: BTreeMap::new(),
            ghost: None,
            stages: BTreeMap::new(),
            finished: None,
            of: None,
            shown: PixelScale::Full,
            drawn: SurfaceShare::default(),
            filled: FilledSplats::default(),
            marks_changed: false,
        }
    }

    /// The device that draws.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Shows another surface. A sample takes 28 bytes of the device's memory and 4 of the program's, a
    /// triangle 12 of the device's.
    ///
    /// # Errors
    /// The surface's lists do not fit together.
    pub fn set_surface(&mut self, surface: &SceneSurface<'_>) -> Result<(), BadSurface> {
        self.surface = Some(Cloud::new(&self.gpu, &self.samples, surface)?);
        (self.placed, self.first, self.of) = (self.samples(), None, None);
        Ok(())
    }

    /// Moves the surface's samples: for each frame of a drag.
    ///
    /// # Errors
    /// The lists are not as long as before.
    pub fn set_positions(&mut self, positions: &[Vec3], normals: &[Vec3]) -> Result<(), BadSurface> {
        let samples = self.samples();
        same_length("positions", positions.len(), samples)?;
        same_length("normals", normals.len(), samples)?;
        if let Some(surface) = &self.surface {
            surface.write_geometry(&self.gpu.queue, positions, normals);
        }
        (self.placed, self.of) = (samples, None);
        Ok(())
    }

    /// Changes the half axes of the surface's ellipses (see [`SceneSurface::axes`]), whose radii go with
    /// them.
    ///
    /// # Errors
    /// There are axes, but not as many as samples.
    pub fn set_axes(&mut self, axes: &[[Vec3; 2]]) -> Result<(), BadSurface> {
        let samples = self.samples();
        same_length("axes", if axes.is_empty() { samples } else { axes.len() }, samples)?;
        if let Some(surface) = &self.surface {
            surface.write_shapes(&self.gpu.queue, axes);
        }
        self.of = None;
        Ok(())
    }

    /// Changes the surface's colours (see [`SceneSurface::colors`]) and radii.
    ///
    /// # Errors
    /// The lists are not as long as the samples.
    pub fn set_colors(&mut self, radii: &[f32], colors: Option<&[[u8; 3]]>) -> Result<(), BadSurface> {
        let samples = self.samples();
        same_length("radii", radii.len(), samples)?;
        same_length("colours", colors.map_or(samples, <[_]>::len), samples)?;
        if let Some(surface) = &self.surface {
            surface.write_look(&self.gpu.queue, radii, colors);
        }
        self.of = None;
        Ok(())
    }

    /// Shows more splats with the surface, as one with it: a part of the surface in more detail, for
    /// example, where the surface's own radii are negative. They take the place of the detail of the same
    /// number; without a detail, that one goes. The triangles of details are not used, and while there is a
    /// detail, neither are those of the surface.
    ///
    /// # Errors
    /// The detail's lists do not fit together.
    pub fn set_detail(&mut self, number: u64, detail: Option<&SceneSurface<'_>>) -> Result<(), BadSurface> {
        match detail {
            Some(detail) => {
                let bare = SceneSurface { triangles: &[], ..*detail };
                self.details.insert(number, Cloud::new(&self.gpu, &self.samples, &bare)?);
            }
            None => drop(self.details.remove(&number)),
        }
        self.of = None;
        Ok(())
    }

    /// Changes the radii and colours of the detail of a number.
    ///
    /// # Errors
    /// The detail of that number does not have as many splats.
    pub fn set_detail_colors(
        &mut self,
        number: u64,
        radii: &[f32],
        colors: Option<&[[u8; 3]]>,
    ) -> Result<(), BadSurface> {
        let splats = self.details.get(&number).map_or(0, Cloud::len);
        same_length("radii", radii.len(), splats)?;
        same_length("colours", colors.map_or(splats, <[_]>::len), splats)?;
        if let Some(detail) = self.details.get(&number) {
            detail.write_look(&self.gpu.queue, radii, colors);
        }
        self.of = None;
        Ok(())
    }

    /// Shows a ghost (the rest shape, say), or none. Its colours and triangles are not used.
    ///
    /// # Errors
    /// The ghost's lists do not fit together.
    pub fn set_ghost(&mut self, ghost: Option<&SceneSurface<'_>>) -> Result<(), BadSurface> {
        let bare = ghost.map(|ghost| SceneSurface { triangles: &[], ..*ghost });
        self.ghost = bare.map(|ghost| Cloud::new(&self.gpu, &self.samples, &ghost)).transpose()?;
        self.of = None;
        Ok(())
    }

    /// Shows these lines instead of the former ones.
    pub fn set_lines(&mut self, lines: &[Line]) {
        self.marks.set_lines(&self.gpu, lines);
        self.marks_changed = true;
    }

    /// Shows these dots instead of the former ones.
    pub fn set_dots(&mut self, dots: &[Dot]) {
        self.marks.set_dots(&self.gpu, dots);
        self.marks_changed = true;
    }

    /// Number of the surface's samples.
    pub fn samples(&self) -> usize {
        self.surface.as_ref().map_or(0, Cloud::len)
    }

    /// Number of splats of the whole surface, with its details.
    pub fn splats(&self) -> usize {
        self.samples() + self.details.values().map(Cloud::len).sum::<usize>()
    }

    /// Share of the surface that the last picture shows.
    pub fn drawn(&self) -> SurfaceShare {
        self.drawn
    }

    /// Draws the changes, and returns the picture: another texture whenever its size changes, the same
    /// otherwise.
    ///
    /// Without a budget all splats are drawn at once, and the device may go on drawing when this returns.
    /// With a budget, a changed scene is drawn as well as the time allows; then calls draw more, and every
    /// few of them show a picture of some more splats, until [`SurfaceShare::complete`].
    pub fn render(
        &mut self,
        view: &SceneView,
        style: &SceneStyle,
        budget: Option<&mut Budget>,
    ) -> &TextureView {
        let (view, style) = self.drawable(view, style);
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let started = Instant::now();
        let changed = self.of != Some((view, style));
        if changed || (budget.is_none() && !self.drawn.complete) {
            self.resize(&view, style.scale);
            self.of = Some((view, style));
            self.filled = FilledSplats::default();
            let (splats, scale) = match &budget {
                Some(budget) if budget.is_coarse() => (budget.splats(), PixelScale::Half),
                Some(budget) => (budget.splats(), style.scale),
                None => (usize::MAX, style.scale),
            };
            self.draw(&mut encoder, &view, &style, scale, splats);
        } else if !self.drawn.complete {
            let step = |budget: &&mut Budget| budget.step().max(self.splats() / MOST_STEPS);
            let splats = budget.as_ref().map_or(usize::MAX, step);
            self.fill(&mut encoder, &view, &style, splats);
        } else if self.marks_changed {
            self.finish(&mut encoder);
        }
        self.gpu.queue.submit([encoder.finish()]);
        if let Some(budget) = budget {
            // Without this wait frames pile up before the device, and the hand is seconds ahead of the
            // picture.
            self.gpu.wait();
            if changed {
                budget.learn(started.elapsed(), self.drawn.drawn == self.drawn.of);
            } else {
                budget.learn_step(started.elapsed());
            }
        }
        &self.finished.as_ref().expect("a first picture makes it").1
    }

    /// View and style within the limits of the device.
    fn drawable(&self, view: &SceneView, style: &SceneStyle) -> (SceneView, SceneStyle) {
        let most = self.gpu.device.limits().max_texture_dimension_2d;
        let view = SceneView { size: view.size.map(|s| s.clamp(1, most)), ..*view };
        let is_large = style.scale == PixelScale::Double && view.size.iter().any(|s| 2 * s > most);
        (view, SceneStyle { scale: if is_large { PixelScale::Full } else { style.scale }, ..*style })
    }

    /// The last picture; none before there is any, or where the device is lost.
    pub fn read(&self) -> Option<Image> {
        let (texture, _) = self.finished.as_ref()?;
        crate::read::image(&self.gpu, texture)
    }
}
