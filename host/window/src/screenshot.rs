//! Pictures of the model without a window, or beside it.

use crate::viewport::detail::{PieceSplats, sample_colors, sample_radii, splats};
use crate::viewport::seen::{disc_radii, mode_of, seen_clip, view};
use crate::viewport::vertex_colors::VertexColors;
use glam::{DVec3, Vec3};
use simod_model::{Error, Result};
use simod_picture::{CutOut, Image};
use simod_scene::{Background, Dot, Gpu, NoGpu, PixelScale, Scene, SceneStyle, SceneSurface};
use simod_viewer::camera::Camera;
use simod_viewer::{ComparedVersion, State};
use std::path::Path;
use std::sync::Arc;

/// Width and height, in pixels.
const SIZE: [u32; 2] = [1600, 1000];
/// Longest side of a picture that is saved, in pixels.
pub const LARGEST: u32 = 8192;
/// The size of a picture that is saved, and whether its background is seen through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScreenshotFormat {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Whether the background is transparent.
    pub transparent: bool,
}

impl Default for ScreenshotFormat {
    fn default() -> Self {
        Self { size: SIZE, transparent: false }
    }
}

/// Draws the state's scene, as its camera sees it.
///
/// # Errors
/// Nothing is open, there is nothing to draw with, or the file cannot be written.
pub fn write(state: &mut State, file: &Path, format: ScreenshotFormat) -> Result<()> {
    write_shot(&Shot::take(state)?.formatted(format), file)
}

/// Draws a picture to a PNG file.
///
/// # Errors
/// There is nothing to draw with, or the file cannot be written.
pub fn write_shot(shot: &Shot, file: &Path) -> Result<()> {
    simod_model::output::write_file(file, &shot.studio()?.png(0.0)?)
}

/// Content and look of a picture. A shot does not change with the state that it was taken of.
pub struct Shot {
    shown: Arc<simod_viewer::ViewerScene>,
    radii: Vec<f32>,
    colors: Option<Vec<[u8; 3]>>,
    /// Vertices that are shown in full.
    detail: Vec<PieceSplats>,
    /// Samples that are drawn as dots over the detail.
    pub(crate) dots: Vec<Dot>,
    camera: Camera,
    pub(crate) format: ScreenshotFormat,
    pub(crate) style: SceneStyle,
    pub(crate) ghost: bool,
}

/// A shot with the device that draws it.
pub struct Studio<'a> {
    shot: &'a Shot,
    scene: Scene,
    bounds: [DVec3; 2],
}

impl Shot {
    /// Shot of the state's scene.
    ///
    /// # Errors
    /// Nothing is open.
    pub fn take(state: &State) -> Result<Self> {
        let none = || Error::argument("there is no model to be drawn", "name one");
        let shown = state.scene().cloned().ok_or_else(none)?;
        let (colors, tint) = (state.sample_colors(ComparedVersion::Now), state.tint());
        let scale = state.field().map(|field| field.scale());
        let detail = state.detail();
        let radii = sample_radii(&shown.sampled.samples.extents(), shown.axes(), detail);
        let pieces = detail.into_iter().flat_map(|detail| detail.pieces().values());
        let of_vertices = VertexColors::new(colors.as_deref(), tint, scale);
        let in_full = pieces.map(|piece| splats(piece, of_vertices)).collect();
        let colors = match detail {
            Some(_) => Some(sample_colors(shown.len(), colors.as_deref())),
            None => colors,
        };
        let style = SceneStyle {
            mode: mode_of(&shown),
            own_colors: colors.is_some(),
            background: Background::Dark,
            scale: PixelScale::Double,
            clip: seen_clip(state),
            ..SceneStyle::default()
        };
        let camera = *state.camera();
        Ok(Self {
            shown,
            radii,
            colors,
            detail: in_full,
            dots: Vec::new(),
            camera,
            format: ScreenshotFormat::default(),
            style,
            ghost: false,
        })
    }

    /// Positions of the shot's samples, in local coordinates.
    pub fn positions(&self) -> &[Vec3] {
        &self.shown.positions
    }

    /// Returns this shot in another size, or before another background.
    pub fn formatted(self, format: ScreenshotFormat) -> Self {
        let size = format.size.map(|side| side.clamp(1, LARGEST));
        Self { format: ScreenshotFormat { size, ..format }, ..self }
    }

    /// Whether the background is transparent.
    pub fn is_transparent(&self) -> bool {
        self.format.transparent
    }

    /// Gives the shot to a device of its own.
    ///
    /// # Errors
    /// There is nothing to draw with.
    pub fn studio(&self) -> Result<Studio<'_>> {
        let gpu = Gpu::headless().map_err(|e| {
            let what = e.to_string().lines().next().unwrap_or_default().to_owned();
            Error::system(what, NoGpu::HINT)
        })?;
        let (shown, samples) = (&self.shown, &self.shown.sampled.samples);
        let radii = disc_radii(&samples.extents());
        let mut scene = Scene::new(&gpu);
        let surface = SceneSurface {
            positions: &shown.positions,
            normals: shown.normals(),
            radii: &self.radii,
            axes: shown.axes(),
            colors: self.colors.as_deref(),
            triangles: &shown.sampled.triangles,
        };
        let rest = SceneSurface {
            positions: &samples.positions,
            normals: samples.normals(),
            radii: &radii,
            ..SceneSurface::default()
        };
        let bad = |e: simod_scene::BadSurface| Error::internal(e.to_string()).because(e);
        scene.set_surface(&surface).map_err(bad)?;
        for (splats, number) in self.detail.iter().zip(0..) {
            scene.set_detail(number, Some(&splats.surface())).map_err(bad)?;
        }
        scene.set_dots(&self.dots);
        scene.set_ghost(self.ghost.then_some(&rest)).map_err(bad)?;
        let mut bounds = shown.bounds();
        if self.ghost {
            let at_rest = samples.positions.iter().fold(bounds, |[a, b], p| [a.min(*p), b.max(*p)]);
            bounds = at_rest;
        }
        Ok(Studio { shot: self, scene, bounds: bounds.map(|corner| corner.as_dvec3()) })
    }
}

impl Studio<'_> {
    /// Picture after the camera went round its target by an angle in radians.
    ///
    /// # Errors
    /// The device was lost.
    pub fn picture(&mut self, turn: f64) -> Result<Image> {
        self.drawn(turn, self.shot.style.background)
    }

    /// The picture as the content of a PNG file, in the shot's [format](ScreenshotFormat).
    ///
    /// # Errors
    /// The device was lost.
    pub fn png(&mut self, turn: f64) -> Result<Vec<u8>> {
        if !self.shot.format.transparent {
            return self.picture(turn)?.to_png();
        }
        let black = self.drawn(turn, Background::Black)?;
        let white = self.drawn(turn, Background::White)?;
        let differ = || Error::internal("two pictures of the same differ in size");
        CutOut::from_backgrounds(&black, &white).ok_or_else(differ)?.to_png()
    }

    fn drawn(&mut self, turn: f64, background: Background) -> Result<Image> {
        let Shot { camera, format, style, .. } = self.shot;
        let camera = Camera { yaw: camera.yaw + turn, ..*camera };
        let style = SceneStyle { background, ..*style };
        self.scene.render(&view(&camera, format.size.map(f64::from), self.bounds), &style, None);
        let lost = || Error::system("the picture cannot be drawn", NoGpu::HINT);
        self.scene.read().ok_or_else(lost)
    }
}
