//! simod-picture: pictures of models of any size, by a deterministic splat rasteriser on the processor.
//!
//! Points are streamed twice, as oriented discs (M. Zwicker, H. Pfister, J. van Baar, M. Gross, *Surface
//! Splatting*, SIGGRAPH 2001; the two passes as in M. Botsch, A. Hornung, M. Zwicker, L. Kobbelt,
//! *High-Quality Surface Splatting on Today's GPUs*, PBG 2005): first for the depth of the nearest surface,
//! then to blend the points on it. Triangles are drawn in the same two passes. Memory grows with the picture
//! alone. The same points in the same order give the same picture, bit by bit, for any number of threads:
//! each band of the picture takes them in order.
//!
//! ```
//! use glam::{DVec3, Vec3};
//! use simod_picture::{PictureCamera, Renderer, Style, SurfaceDisc};
//!
//! let bounds = [DVec3::splat(-1.0), DVec3::splat(1.0)];
//! let camera = PictureCamera::frame(bounds, 0.5, 0.3, 64.0 / 48.0);
//! let mut renderer = Renderer::new(64, 48, camera, Style::default());
//! let points = [SurfaceDisc { position: DVec3::ZERO, normal: Vec3::Z, color: [200, 90, 40], radius: 0.5 }];
//! renderer.depth(&points);
//! renderer.blend(&points);
//! let image = renderer.finish();
//! assert_eq!((image.width(), image.height()), (64, 48));
//! ```

mod camera;
mod cut_out;
mod facet;
mod font;
mod frames;
mod ground;
mod image;
mod mesh;
mod paint;
mod palette;
pub mod picture;
mod point;
mod shade;
mod spacing;
mod splat;
mod style;
mod view;

pub use camera::PictureCamera;
pub use cut_out::CutOut;
pub use frames::FrameFolder;
pub use image::Image;
pub use paint::{Coloring, Paint};
pub use palette::{class_color, class_name, scale_color};
pub use point::SurfaceDisc;
pub use spacing::Spacing;
pub use style::Style;

use facet::TriangleRaster;
use glam::Vec3;
use ground::Ground;
use splat::{Pixel, SplatBuffer};

/// Draws one picture: [`depth`](Self::depth) for all points, then [`blend`](Self::blend) for all points
/// again, then [`finish`](Self::finish).
pub struct Renderer {
    width: u32,
    height: u32,
    camera: PictureCamera,
    style: Style,
    canvas: SplatBuffer,
    facets: TriangleRaster,
    ground: Option<Ground>,
}

/// Samples per pixel in each direction.
const SUPERSAMPLING: u32 = 2;

impl Renderer {
    /// An empty picture. A width or height of 0 is taken as 1.
    pub fn new(width: u32, height: u32, camera: PictureCamera, style: Style) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self {
            width,
            height,
            camera,
            style,
            canvas: SplatBuffer::new(width * SUPERSAMPLING, height * SUPERSAMPLING),
            facets: TriangleRaster::default(),
            ground: style.ground.map(|height| Ground::new(height, &camera)),
        }
    }

    /// First pass: finds the nearest surface.
    pub fn depth(&mut self, points: &[SurfaceDisc]) {
        self.depth_of(points, &[]);
    }

    /// Draws the depth of ellipses: each point has two half axes at right angles to each other and to its
    /// normal, the longer one as long as its radius. Where there are no axes, points are discs.
    pub fn depth_of(&mut self, points: &[SurfaceDisc], axes: &[[Vec3; 2]]) {
        let Self { canvas, camera, ground, .. } = self;
        let shadow = || ground.iter_mut().for_each(|ground| ground.add(points));
        rayon::join(|| canvas.depth(camera, points, axes), shadow);
    }

    /// Second pass: blends normals and colours of the points on the nearest surface. Points that were not in
    /// the first pass are not shown.
    pub fn blend(&mut self, points: &[SurfaceDisc]) {
        self.blend_of(points, &[]);
    }

    /// Blends ellipses, as in [`depth_of`](Self::depth_of).
    pub fn blend_of(&mut self, points: &[SurfaceDisc], axes: &[[Vec3; 2]]) {
        self.canvas.blend(&self.camera, points, axes);
    }

    /// [`blend`](Self::blend) for two pictures at once, in the points' colours and in others, of which there
    /// are as many: [`finish_both`](Self::finish_both) gives both.
    pub fn blend_both(&mut self, points: &[SurfaceDisc], others: &[[u8; 3]]) {
        self.canvas.blend_both(&self.camera, points, others);
    }

    /// The first pass of triangles, whose corners' normals and colours are mixed; the radii of corners do not
    /// count. Each corner without a normal has that of its triangle. A triangle is seen from either side; one
    /// with a corner that is not finite, or not before the camera, is left out.
    pub fn depth_of_triangles(&mut self, triangles: &[[SurfaceDisc; 3]]) {
        self.facets.depth(&mut self.canvas, &self.camera, triangles);
        if let Some(ground) = &mut self.ground {
            ground.add_triangles(triangles);
        }
    }

    /// The second pass of triangles.
    pub fn blend_triangles(&mut self, triangles: &[[SurfaceDisc; 3]]) {
        self.facets.blend(&mut self.canvas, &self.camera, triangles);
    }

    /// Lights the picture.
    pub fn finish(self) -> Image {
        let [image] = self.lit([Pixel::color]);
        image
    }

    /// Lights two pictures of the same, the other one in the other colours.
    pub fn finish_both(self) -> [Image; 2] {
        self.lit([Pixel::color, Pixel::other_color])
    }

    fn lit<const N: usize>(self, colors: [fn(&Pixel) -> Vec3; N]) -> [Image; N] {
        let shadow = self.ground.map(Ground::finish);
        let lit = shade::shade(&self.canvas, &self.camera, &self.style, shadow.as_ref(), colors);
        lit.map(|samples| Image::downsampled(self.width, self.height, SUPERSAMPLING, &samples))
    }
}
