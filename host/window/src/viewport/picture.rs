//! The picture itself: keeps the graphics card's copy of the scene up to date where the scene changed.

use super::ModelArea;
use super::colors::SampleColors;
use super::detail::{DetailPieces, radii_of, sample_dots, sample_radii};
use super::emerging::EmergingPoints;
use super::seen::{disc_radii, seen_clip, view};
use super::texture::Texture;
use crate::settings::Theme;
use crate::window::{Commands, Window};
use eframe::egui::{Color32, Mesh, Rect, Shape, Ui};
use eframe::egui_wgpu::RenderState;
use glam::{Mat4, Vec3};
use simod_core::sampling::SampleSet;
use simod_scene::{Budget, Gpu, Scene, SceneStyle, SceneSurface};
use simod_viewer::shading::Rings;
use simod_viewer::{ComparedVersion, Detail};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Duration of a picture that is aimed at while something moves: with a card, and in software.
const GOALS: [Duration; 2] = [Duration::from_millis(12), Duration::from_millis(45)];

/// Pause after which dragged samples are drawn more finely: while they move, they are drawn as finely as
/// the time of a picture allows.
const STILL: Duration = Duration::from_millis(150);

/// Longest duration of a picture at rest that is drawn at once, by the budget's estimate, in seconds.
const PATIENCE: f64 = 0.6;

/// The pictures of both versions.
pub struct Viewport(Option<Pictures>);

struct Pictures {
    render: RenderState,
    now: PictureDrawing,
    /// Drawing of the pinned version, while there is one and once it was shown.
    pinned: Option<PictureDrawing>,
    /// Points of a model that is being opened.
    emerging: Option<EmergingPoints>,
}

struct PictureDrawing {
    version: ComparedVersion,
    scene: Scene,
    /// Number of pictures that share a frame, and the budget for that number.
    budget: (u32, Budget),
    texture: Texture,
    colors: SampleColors,
    shown: Option<Arc<simod_viewer::ViewerScene>>,
    /// Number of samples that the card has, of those that are drawn first.
    placed: usize,
    /// Time when the picture became another one.
    changed: Instant,
    /// Extent of the surface around each sample at rest.
    extents: Vec<f32>,
    /// Data kept of the samples that drafts draw.
    rings: Option<Rings>,
    pieces: DetailPieces,
    /// Revision of the detail that is shown.
    detail: Option<u64>,
    ghost: bool,
    /// Whether samples are dots over vertices that are shown in full.
    dots: bool,
    /// View of the last picture, and its size.
    seen: Option<(Mat4, [u32; 2])>,
}

impl Viewport {
    /// Makes the pictures; none in tests that have nothing to draw with.
    pub fn new(render: Option<&RenderState>) -> Self {
        Self(render.map(|render| Pictures {
            render: render.clone(),
            now: PictureDrawing::new(ComparedVersion::Now, render),
            pinned: None,
            emerging: None,
        }))
    }

    /// Draws nothing any more, as the card went away.
    pub fn lose(&mut self) {
        self.0 = None;
    }

    /// The background alone.
    pub fn clear(&mut self, ui: &Ui, rect: Rect, window: &Window) {
        ui.painter().add(background(rect, window.settings.theme));
    }

    /// Picture of a model that is being opened; nothing where none is, or none of its samples is there yet.
    pub fn emerging(&mut self, canvas: &ModelArea<'_>, window: &Window) -> Option<Shape> {
        self.0.as_mut()?.emerging(canvas, window)
    }

    /// Picture of a version at its place. `share` is the number of pictures that share a frame.
    pub fn picture(
        &mut self,
        rect: Rect,
        version: ComparedVersion,
        share: u32,
        window: &Window,
        commands: &mut Commands,
    ) -> Shape {
        match &mut self.0 {
            Some(Pictures { render, now, pinned, .. }) => match version {
                ComparedVersion::Now => now.picture(rect, share, window, commands),
                ComparedVersion::Pinned => {
                    let drawing = pinned.get_or_insert_with(|| PictureDrawing::new(version, render));
                    drawing.picture(rect, share, window, commands)
                }
            },
            None => background(rect, window.settings.theme),
        }
    }

    /// Lets go of the pinned version where it is not there any more.
    pub fn tidy(&mut self, window: &Window) {
        if let Some(pictures) = &mut self.0
            && window.state().pinned().is_none()
        {
            pictures.pinned = None;
        }
    }
}

/// The colours that the renderer has behind the surface.
fn background(rect: Rect, theme: Theme) -> Shape {
    let (top, bottom) = match theme {
        Theme::Dark => (Color32::from_rgb(58, 63, 71), Color32::from_rgb(30, 33, 38)),
        Theme::Light => (Color32::from_rgb(246, 246, 247), Color32::from_rgb(214, 216, 219)),
    };
    let mut mesh = Mesh::default();
    for (at, color) in [
        (rect.left_top(), top),
        (rect.right_top(), top),
        (rect.right_bottom(), bottom),
        (rect.left_bottom(), bottom),
    ] {
        mesh.colored_vertex(at, color);
    }
    mesh.add_triangle(0, 1, 2);
    mesh.add_triangle(0, 2, 3);
    Shape::mesh(mesh)
}

fn gpu_of(render: &RenderState) -> Gpu {
    Gpu::from_device(render.device.clone(), render.queue.clone(), &render.adapter.get_info())
}

impl Pictures {
    fn emerging(&mut self, canvas: &ModelArea<'_>, window: &Window) -> Option<Shape> {
        if !window.state().is_opening() {
            self.emerging = None;
            return None;
        }
        if self.emerging.is_none() {
            window.state().emerged(|_| ())?;
            self.emerging = Some(EmergingPoints::new(&self.render, &gpu_of(&self.render)));
        }
        self.emerging.as_mut()?.picture(canvas, window).ok()
    }
}

impl PictureDrawing {
    fn new(version: ComparedVersion, render: &RenderState) -> Self {
        let gpu = gpu_of(render);
        let goal = GOALS[usize::from(gpu.is_software())];
        Self {
            version,
            scene: Scene::new(&gpu),
            budget: (1, Budget::new(goal)),
            texture: Texture::new(render),
            colors: SampleColors::default(),
            shown: None,
            placed: 0,
            changed: Instant::now(),
            extents: Vec::new(),
            rings: None,
            pieces: DetailPieces::default(),
            detail: None,
            ghost: false,
            dots: false,
            seen: None,
        }
    }

    fn picture(&mut self, rect: Rect, share: u32, window: &Window, commands: &mut Commands) -> Shape {
        let Some(scene) = window.state().scene_of(self.version).cloned() else {
            return background(rect, window.settings.theme);
        };
        // The hand was quicker than the last picture: the events that wait come first.
        if window.is_catching_up() && self.shown.is_some() {
            return self.texture.show(rect);
        }
        if let Err(error) = self.upload(&scene, window) {
            return failed(error, rect, window, commands);
        }
        let view = view(window.state().camera(), window.state().size(), self.bounds(&scene));
        let style = self.style(window);
        let started = Instant::now();
        let before = self.scene.drawn();
        let goal = GOALS[usize::from(self.scene.gpu().is_software())] / share;
        if self.budget.0 != share {
            self.budget = (share, Budget::new(goal));
        }
        // A move of the samples is no move of the camera, though its picture reaches farther or less far: the
        // result after a draft takes its place at once.
        let from = Some((view.view, view.size));
        let moves = window.ctx().input(|i| i.pointer.any_down()) || self.seen != from || scene.is_draft();
        if !self.scene.is_of(&view, &style) {
            self.changed = started;
        } else if let Some(left) = STILL.checked_sub(self.changed.elapsed()).filter(|_| scene.is_draft()) {
            window.ctx().request_repaint_after(left);
            return self.texture.show(rect);
        }
        self.seen = from;
        // All splats are drawn at once at rest, unless that would take too long to wait for.
        let parts = self.scene.splats() as f64 / self.budget.1.splats() as f64;
        let whole = !moves && parts * goal.as_secs_f64() < PATIENCE / f64::from(share);
        let reach = self.scene.reach(&view, &style, Some(&self.budget.1).filter(|_| !whole));
        if let Err(error) = self.place(&scene, reach, window) {
            return failed(error, rect, window, commands);
        }
        let budget = (!whole).then_some(&mut self.budget.1);
        let picture = self.scene.render(&view, &style, budget).clone();
        let drawn = self.scene.drawn();
        // Without a budget the card goes on drawing meanwhile.
        let took = (!whole && (drawn != before || !drawn.complete)).then(|| started.elapsed());
        let is_now = self.version == ComparedVersion::Now;
        commands.then(move |window| window.tell_drawn(Some(drawn).filter(|_| is_now), took));
        if !drawn.complete {
            window.ctx().request_repaint();
        }
        self.texture.set(&picture, view.size);
        self.texture.show(rect)
    }

    /// Style of the scene, as the window looks.
    fn style(&self, window: &Window) -> SceneStyle {
        SceneStyle {
            mode: window.mode(),
            own_colors: self.colors.of_samples().is_some(),
            background: window.settings.theme.background(),
            light: window.settings.light.light(),
            occlusion: window.settings.occlusion,
            clip: seen_clip(window.state()),
            ..SceneStyle::default()
        }
    }

    /// The box of all that is shown.
    fn bounds(&self, scene: &simod_viewer::ViewerScene) -> [glam::DVec3; 2] {
        let [min, max] = scene.bounds();
        let rest = &scene.sampled.bounds;
        let frame = scene.frame();
        let (low, high) = (frame.to_local(rest.min), frame.to_local(rest.max));
        if self.ghost {
            return [min.min(low).as_dvec3(), max.max(high).as_dvec3()];
        }
        [min.as_dvec3(), max.as_dvec3()]
    }

    /// Gives the card the samples at rest as a ghost, or takes the ghost away.
    fn upload_ghost(&mut self, samples: &SampleSet) -> Result<(), simod_scene::BadSurface> {
        let radii = disc_radii(&self.extents);
        let rest = SceneSurface {
            positions: &samples.positions,
            normals: samples.normals(),
            radii: &radii,
            ..SceneSurface::default()
        };
        self.scene.set_ghost(self.ghost.then_some(&rest))
    }

    /// Brings the card's copy of the scene up to date.
    fn upload(
        &mut self,
        scene: &Arc<simod_viewer::ViewerScene>,
        window: &Window,
    ) -> Result<(), simod_scene::BadSurface> {
        let known = self.shown.as_ref();
        let same_samples = known.is_some_and(|known| Arc::ptr_eq(&known.sampled, &scene.sampled));
        let same = same_samples && known.is_some_and(|known| known.revision == scene.revision);
        let sampled = &scene.sampled;
        let samples = &sampled.samples;
        let recolored = self.colors.update(window, self.version, scene);
        let detail = window.state().detail().filter(|_| self.version == ComparedVersion::Now);
        let revision = detail.map(Detail::revision);
        let covers_others = revision != std::mem::replace(&mut self.detail, revision);
        if !same_samples {
            (self.extents, self.rings) = (samples.extents(), None);
        }
        let colors = self.colors.of_samples();
        if !same_samples {
            let radii = sample_radii(&self.extents, scene.axes(), detail);
            self.scene.set_surface(&SceneSurface {
                positions: &scene.positions,
                normals: scene.normals(),
                radii: &radii,
                axes: scene.axes(),
                colors,
                triangles: &sampled.triangles,
            })?;
            self.placed = scene.len();
        } else if !same || (recolored || covers_others) && self.placed < scene.len() {
            self.scene.outdate();
            self.placed = 0;
        } else if recolored || covers_others {
            let radii = sample_radii(&self.extents, scene.axes(), detail);
            self.scene.set_colors(&radii, colors)?;
        }
        self.pieces.update(&mut self.scene, detail, self.colors.of_vertices(), recolored)?;
        let dots = window.looks.samples && self.version == ComparedVersion::Now;
        if std::mem::replace(&mut self.dots, dots) != dots || dots && (!same || covers_others) {
            self.scene.set_dots(&sample_dots(&scene.positions, detail.filter(|_| dots)));
        }
        if window.looks.ghost != self.ghost || self.ghost && !same_samples {
            self.ghost = window.looks.ghost;
            self.upload_ghost(samples)?;
        }
        if !same {
            self.shown = Some(scene.clone());
        }
        Ok(())
    }

    /// Brings so many of the samples up to date that are drawn first. The others of a draft are left: the
    /// next draft comes before they are drawn.
    fn place(
        &mut self,
        scene: &simod_viewer::ViewerScene,
        reach: usize,
        window: &Window,
    ) -> Result<(), simod_scene::BadSurface> {
        if self.placed >= reach {
            return Ok(());
        }
        let detail = window.state().detail().filter(|_| self.version == ComparedVersion::Now);
        let colors = self.colors.of_samples();
        if !scene.is_draft() {
            let radii = sample_radii(&self.extents, scene.axes(), detail);
            self.scene.place_all(&SceneSurface {
                positions: &scene.positions,
                normals: scene.normals(),
                radii: &radii,
                axes: scene.axes(),
                colors,
                triangles: &[],
            })?;
            self.placed = scene.len();
            return Ok(());
        }
        let some = self.scene.first(reach);
        // The rings of the pictures that follow while the hand rests are different each time.
        let (is_first, mut once) = (self.placed == 0, None);
        let rings = if is_first { &mut self.rings } else { &mut once };
        Rings::keep(rings, &scene.sampled, &some);
        let started = Instant::now();
        let shading = scene.shading_of(&some, rings);
        let positions: Vec<Vec3> = some.iter().map(|i| scene.positions[*i as usize]).collect();
        let colors: Option<Vec<[u8; 3]>> =
            colors.map(|colors| some.iter().map(|i| colors[*i as usize]).collect());
        self.scene.place_first(&SceneSurface {
            positions: &positions,
            normals: &shading.normals,
            radii: &radii_of(&some, &self.extents, &shading.axes, detail),
            axes: &shading.axes,
            colors: colors.as_deref(),
            triangles: &[],
        })?;
        if is_first {
            self.budget.1.also(started.elapsed());
        }
        self.placed = reach;
        Ok(())
    }
}

/// Picture and message where the card does not take the scene.
fn failed(error: simod_scene::BadSurface, rect: Rect, window: &Window, commands: &mut Commands) -> Shape {
    let hint = "save the session, and report this";
    let error = simod_model::Error::internal(error.to_string()).hinting(hint);
    commands.then(move |window| window.toasts.error(&error));
    background(rect, window.settings.theme)
}
