//! Draws sampled surfaces with the graphics card: for the viewer's window, and for pictures without a
//! window.
//!
//! Geometry is in local coordinates (single precision, about unit size; see `simod_model::frame::Frame`). A
//! [`Scene`] holds a surface, maybe a ghost of another one, lines and dots, and draws them into a texture of
//! its own:
//!
//! ```no_run
//! use glam::Vec3;
//! use glam::camera::rh::{proj::directx::perspective, view::look_at_mat4};
//! use simod_scene::{Gpu, Scene, SceneStyle, SceneSurface, SceneView};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let gpu = Gpu::headless()?;
//! let mut scene = Scene::new(&gpu);
//! let (positions, normals) = (&[Vec3::ZERO], &[Vec3::Z]);
//! scene.set_surface(&SceneSurface { positions, normals, radii: &[0.3], ..SceneSurface::default() })?;
//! let view = SceneView {
//!     view: look_at_mat4(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, Vec3::Y),
//!     projection: perspective(0.5, 1.5, 0.1, 10.0),
//!     size: [600, 400],
//! };
//! scene.render(&view, &SceneStyle::default(), None);
//! let picture = scene.read();
//! # Ok(())
//! # }
//! ```
//!
//! The steps of a frame, each a module with its shader:
//!
//! 1. `splats`: discs, in two passes, to weighted sums; `resolve` makes the visible surface of them. Or
//!    `triangles`, which give it at once. The ghost likewise.
//! 2. `occlusion`: how much light of the surroundings arrives.
//! 3. `shade`: light and colour, as in `simod_picture`.
//! 4. `finish`: smooth edges, in the size asked for; `marks` (lines and dots) over it.

mod budget;
mod cloud;
mod frame;
mod gpu;
mod marks;
mod order;
mod passes;
mod pipeline;
mod read;
mod scene;
mod splats;
mod targets;
mod triangles;
mod view;

pub use budget::Budget;
pub use cloud::{BadSurface, SceneSurface};
pub use gpu::{Gpu, NoGpu};
pub use marks::{Dot, Line};
pub use scene::{Scene, SurfaceShare};
pub use view::{Background, Light, Matcap, PixelScale, SceneStyle, SceneView, SurfaceMode};

/// Format of the texture that [`Scene::render`] returns: 8 bits a channel, which hold sRGB values as they
/// are (as in a PNG file, and as egui takes textures of the user).
pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
