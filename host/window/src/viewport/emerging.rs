//! The samples of a model that is being opened, as they come.

use super::ModelArea;
use super::seen::{disc_radii, view};
use super::texture::Texture;
use crate::settings::Theme;
use crate::window::Window;
use eframe::egui::Shape;
use eframe::egui_wgpu::RenderState;
use glam::DVec3;
use simod_scene::{BadSurface, Budget, Gpu, Scene, SceneStyle, SceneSurface, SceneView};
use simod_viewer::engine::{Emerged, SurfacePoints};
use std::time::{Duration, Instant};

/// Least pause between two pictures of the samples that came meanwhile ...
const PAUSE: Duration = Duration::from_millis(200);
/// ... and pauses are this many times as long as drawing takes: in software, drawing holds the work up.
const SHARE: u32 = 2;

/// Number of the piece of detail that holds the vertices which are shown where there are no samples yet.
const VERTICES: u64 = 0;

/// The points of a model that is being sampled, as they are drawn.
pub struct EmergingPoints {
    scene: Scene,
    budget: Budget,
    texture: Texture,
    /// Number of the last change that is shown, and the time since when.
    shown: u64,
    since: Option<Instant>,
    /// Duration of the last picture, and the view of it.
    took: Duration,
    seen: Option<SceneView>,
    bounds: [DVec3; 2],
}

impl EmergingPoints {
    /// A picture of no points yet.
    pub fn new(render: &RenderState, gpu: &Gpu) -> Self {
        Self {
            scene: Scene::new(gpu),
            budget: Budget::new(PAUSE),
            texture: Texture::new(render),
            shown: 0,
            since: None,
            took: Duration::ZERO,
            seen: None,
            bounds: [DVec3::ZERO; 2],
        }
    }

    /// A picture of the samples that there are so far.
    pub fn picture(&mut self, canvas: &ModelArea<'_>, window: &Window) -> Result<Shape, BadSurface> {
        let state = window.state();
        // A picture of all samples stays, until the model is shown.
        let pause = PAUSE.max(SHARE * self.took);
        canvas.ctx().request_repaint_after(pause);
        if self.since.is_none_or(|since| since.elapsed() > pause) {
            state.emerged(|emerged| self.upload(emerged)).unwrap_or(Ok(()))?;
        }
        let (size, mut camera) = (state.size(), *state.camera());
        camera.frame(self.bounds, size);
        let view = view(&camera, size, self.bounds);
        let style = SceneStyle {
            background: window.settings.theme.background(),
            light: window.settings.light.light(),
            occlusion: window.settings.occlusion,
            ..SceneStyle::default()
        };
        if self.seen != Some(view) {
            let started = Instant::now();
            let picture = self.scene.render(&view, &style, Some(&mut self.budget)).clone();
            self.texture.set(&picture, view.size);
            (self.seen, self.took) = (Some(view), started.elapsed());
        }
        Ok(self.texture.show(canvas.rect()))
    }

    fn upload(&mut self, emerged: &Emerged) -> Result<(), BadSurface> {
        if emerged.changes == self.shown {
            return Ok(());
        }
        (self.bounds, self.seen) = (emerged.bounds, None);
        (self.shown, self.since) = (emerged.changes, Some(Instant::now()));
        let (samples, vertices) = (emerged.samples(), emerged.vertices());
        // Samples and vertices are drawn beside each other: once the samples are many, only a part of them
        // is drawn, by larger discs.
        self.scene.set_surface(&surface(samples, &disc_radii(&samples.spacing)))?;
        let radii = disc_radii(&vertices.spacing);
        let vertices = (!vertices.positions.is_empty()).then(|| surface(vertices, &radii));
        self.scene.set_detail(VERTICES, vertices.as_ref())
    }
}

fn surface<'a>(
    SurfacePoints { positions, normals, .. }: &'a SurfacePoints,
    radii: &'a [f32],
) -> SceneSurface<'a> {
    SceneSurface { positions, normals, radii, ..SceneSurface::default() }
}

impl Theme {
    /// Background that the renderer has behind the surface.
    pub fn background(self) -> simod_scene::Background {
        match self {
            Self::Dark => simod_scene::Background::Dark,
            Self::Light => simod_scene::Background::Light,
        }
    }
}
