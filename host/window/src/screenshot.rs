//! Pictures of the model without a window, or beside it.

use crate::viewport::colors::VertexColors;
use crate::viewport::detail::{Splats, sample_colors, sample_dots, sample_radii, splats};
use crate::window::Window;
use glam::{DVec3, Vec4};
use simod_model::{Error, ErrorKind, Result};
use simod_picture::{CutOut, Image};
use simod_scene::{Background, Dot, Gpu, Mode, NoGpu, Scale, Scene, Style, Surface, View};
use simod_viewer::camera::Camera;
use simod_viewer::{State, Version};
use std::path::Path;
use std::sync::Arc;

/// Width and height, in pixels.
const SIZE: [u32; 2] = [1600, 1000];
/// Longest side of a picture that is saved, in pixels.
pub const LARGEST: u32 = 8192;
/// Radius of a disc over the spacing of samples, in the window, too: enough that no gap is left.
const RADIUS: f32 = 1.35;

/// From where a camera sees what is between two corners, in a picture of so many pixels.
pub fn view(camera: &Camera, size: [f64; 2], bounds: [DVec3; 2]) -> View {
    View {
        view: camera.view().as_mat4(),
        projection: camera.projection(size, camera.near_far(bounds)).as_mat4(),
        size: size.map(|s| s as u32),
    }
}

/// The discs' radii of samples so far apart.
pub fn disc_radii(spacing: &[f32]) -> Vec<f32> {
    spacing.iter().map(|s| RADIUS * s).collect()
}

/// How samples are drawn unless the user says otherwise: as triangles where there are any, as these keep together
/// however they are stretched.
pub fn mode_of(shown: &simod_viewer::Scene) -> Mode {
    if shown.sampled.triangles.is_empty() { Mode::Splats } else { Mode::Triangles }
}

/// The plane that cuts the model open, as the renderer takes it.
pub fn seen_clip(state: &State) -> Option<Vec4> {
    state.local_clip().map(|(normal, distance)| normal.extend(distance).as_vec4())
}

/// How large a picture that is saved is, and what is behind the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Format {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// The background is seen through.
    pub transparent: bool,
}

impl Default for Format {
    fn default() -> Self {
        Self { size: SIZE, transparent: false }
    }
}

/// The size of a window's picture, even as films have to be.
pub fn shown_size(window: &Window) -> [u32; 2] {
    window.state().size().map(|pixels| 2 * (0.5 * pixels).clamp(1.0, 4096.0) as u32)
}

/// Draws what the state shows, as its camera sees it.
///
/// # Errors
/// Nothing is open, there is nothing to draw with, or the file cannot be written.
pub fn write(state: &mut State, file: &Path, format: Format) -> Result<()> {
    write_shot(&Shot::of(state)?.formatted(format), file)
}

/// Draws a picture to a PNG file.
///
/// # Errors
/// There is nothing to draw with, or the file cannot be written.
pub fn write_shot(shot: &Shot, file: &Path) -> Result<()> {
    simod_model::output::write_file(file, &shot.studio()?.png(0.0)?)
}

/// What is drawn, and how: it does not change with what it was taken of.
pub struct Shot {
    shown: Arc<simod_viewer::Scene>,
    radii: Vec<f32>,
    colors: Option<Vec<[u8; 3]>>,
    /// What is shown in full.
    detail: Vec<Splats>,
    /// Samples over that.
    dots: Vec<Dot>,
    camera: Camera,
    format: Format,
    style: Style,
    ghost: bool,
}

/// A shot with the device that draws it.
pub struct Studio<'a> {
    shot: &'a Shot,
    scene: Scene,
    bounds: [DVec3; 2],
}

impl Shot {
    /// Of what the state shows.
    ///
    /// # Errors
    /// Nothing is open.
    pub fn of(state: &mut State) -> Result<Self> {
        let none = || Error::new(ErrorKind::Argument, "there is no model to be drawn", "name one");
        let shown = state.scene().cloned().ok_or_else(none)?;
        let (colors, tint) = (state.sample_colors(Version::Now), state.tint());
        let scale = state.field().map(|field| field.scale());
        let detail = state.detail();
        let radii = sample_radii(&shown.sampled.samples.extents(), &shown.axes, detail);
        let pieces = detail.into_iter().flat_map(|detail| detail.pieces().values());
        let of_vertices = VertexColors::new(colors.as_deref(), tint, scale);
        let in_full = pieces.map(|piece| splats(piece, of_vertices)).collect();
        let colors = match detail {
            Some(_) => Some(sample_colors(shown.len(), colors.as_deref())),
            None => colors,
        };
        let style = Style {
            mode: mode_of(&shown),
            own_colors: colors.is_some(),
            background: Background::Dark,
            scale: Scale::Double,
            clip: seen_clip(state),
            ..Style::default()
        };
        let camera = *state.camera();
        Ok(Self {
            shown,
            radii,
            colors,
            detail: in_full,
            dots: Vec::new(),
            camera,
            format: Format::default(),
            style,
            ghost: false,
        })
    }

    /// Of what a window shows, as it looks there, but for what is marked for the work on it: the selection,
    /// and regions. Width and height are even, as films have to be.
    ///
    /// # Errors
    /// Nothing is open.
    pub fn of_window(window: &mut Window) -> Result<Self> {
        let (looks, settings) = (window.looks, &window.settings);
        let (theme, occlusion, mode) = (settings.theme, settings.occlusion, window.mode());
        let light = settings.light.light();
        let shot = Self::of(window.state_mut())?;
        let format = Format { size: shown_size(window), transparent: false };
        let style = Style { mode, background: theme.background(), light, occlusion, ..shot.style };
        let detail = window.state().detail().filter(|_| looks.samples);
        let dots = sample_dots(&shot.shown.positions, detail);
        Ok(Self { format, style, dots, ghost: looks.ghost, ..shot })
    }

    /// The same in another size, or before another background.
    pub fn formatted(self, format: Format) -> Self {
        let size = format.size.map(|side| side.clamp(1, LARGEST));
        Self { format: Format { size, ..format }, ..self }
    }

    /// Whether the background is seen through.
    pub fn is_transparent(&self) -> bool {
        self.format.transparent
    }

    /// Gives it to a device of its own.
    ///
    /// # Errors
    /// There is nothing to draw with.
    pub fn studio(&self) -> Result<Studio<'_>> {
        let gpu = Gpu::headless().map_err(|e| {
            let what = e.to_string().lines().next().unwrap_or_default().to_owned();
            Error::new(ErrorKind::Io, what, NoGpu::HINT)
        })?;
        let (shown, samples) = (&self.shown, &self.shown.sampled.samples);
        let radii = disc_radii(&samples.extents());
        let mut scene = Scene::new(&gpu);
        let surface = Surface {
            positions: &shown.positions,
            normals: &shown.normals,
            radii: &self.radii,
            axes: &shown.axes,
            colors: self.colors.as_deref(),
            triangles: &shown.sampled.triangles,
        };
        let rest = Surface {
            positions: &samples.positions,
            normals: samples.normals(),
            radii: &radii,
            ..Surface::default()
        };
        let bad = |e: simod_scene::BadSurface| Error::internal(e.to_string(), "report this");
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
    /// The picture after the camera went round its target by an angle, radians.
    ///
    /// # Errors
    /// The device was lost.
    pub fn picture(&mut self, turn: f64) -> Result<Image> {
        self.drawn(turn, self.shot.style.background)
    }

    /// The same as the content of a PNG file, in the shot's [format](Format).
    ///
    /// # Errors
    /// The device was lost.
    pub fn png(&mut self, turn: f64) -> Result<Vec<u8>> {
        if !self.shot.format.transparent {
            return self.picture(turn)?.to_png();
        }
        let black = self.drawn(turn, Background::Black)?;
        let white = self.drawn(turn, Background::White)?;
        let differ = || Error::internal("two pictures of the same differ in size", "report this");
        CutOut::of(&black, &white).ok_or_else(differ)?.to_png()
    }

    fn drawn(&mut self, turn: f64, background: Background) -> Result<Image> {
        let Shot { camera, format, style, .. } = self.shot;
        let camera = Camera { yaw: camera.yaw + turn, ..*camera };
        let style = Style { background, ..*style };
        self.scene.render(&view(&camera, format.size.map(f64::from), self.bounds), &style, None);
        let lost = || Error::new(ErrorKind::Io, "the picture cannot be drawn", NoGpu::HINT);
        self.scene.read().ok_or_else(lost)
    }
}
