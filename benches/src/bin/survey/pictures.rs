//! All results of a case in one picture: what stays blue, what is moved golden.

use std::path::Path;

use color_quant::NeuQuant;
use glam::{DVec3, Vec3};
use simod_benches::process::Result;
use simod_model::bounds::Bounds;
use simod_model::output::write_file;
use simod_picture::{Image, PictureCamera, Renderer, Spacing, Style, SurfaceDisc};
use simod_session::SessionFile;
use simod_session::step::Role;

use crate::cases::Case;

const CLAY: [u8; 3] = [205, 198, 190];
const FIXED: [u8; 3] = [120, 140, 175];
const HANDLE: [u8; 3] = [230, 175, 60];
const PAPER: [u8; 3] = [244, 244, 242];
/// Most pictures beside each other.
const COLUMNS: usize = 6;

pub struct Gallery<'a> {
    case: &'a Case,
    /// Of the vertices, by the case's regions.
    colors: Vec<[u8; 3]>,
    session: SessionFile,
    pictures: Vec<(Image, String)>,
}

impl<'a> Gallery<'a> {
    pub fn new(case: &'a Case, session: &Path) -> Result<Self> {
        let session = SessionFile::load(session)?;
        Ok(Self { case, colors: Vec::new(), session, pictures: Vec::new() })
    }

    /// Draws a model: first the one at rest, which tells the colours.
    pub fn add(&mut self, caption: &str, path: &Path) -> Result<()> {
        let mut surface: Vec<(DVec3, Vec3)> = Vec::new();
        simod_model::for_vertices(simod_model::open(path)?.as_ref(), |chunk| {
            surface.extend(chunk.positions.iter().copied().zip(chunk.normals.iter().copied()));
            Ok(())
        })?;
        if self.colors.is_empty() {
            self.colors = surface.iter().map(|(p, _)| self.color(*p)).collect();
        }
        let bounds = Bounds::from_points(surface.iter().map(|(p, _)| *p));
        let mut spacing = Spacing::new([bounds.min, bounds.max]);
        spacing.add(surface.iter().map(|(p, _)| *p));
        let point = |((position, normal), color): ((DVec3, Vec3), &[u8; 3])| SurfaceDisc {
            position,
            normal,
            color: *color,
            radius: spacing.radius_at(position),
        };
        let points: Vec<SurfaceDisc> = surface.into_iter().zip(&self.colors).map(point).collect();

        let ([width, height], [yaw, pitch]) = (self.case.size, self.case.view);
        // The model at rest may not fit on the others' stage.
        let stage = if self.pictures.is_empty() { [bounds.min, bounds.max] } else { self.case.stage };
        let camera = PictureCamera::frame(stage, yaw, pitch, f64::from(width) / f64::from(height));
        let mut renderer =
            Renderer::new(width, height, camera, Style { own_colors: true, ground: Some(stage[0].y) });
        renderer.depth(&points);
        renderer.blend(&points);
        self.pictures.push((renderer.finish(), caption.to_owned()));
        Ok(())
    }

    fn color(&self, p: DVec3) -> [u8; 3] {
        let regions =
            self.session.steps.iter().filter_map(|step| step.deformation()).flat_map(|step| &step.regions);
        let mut holding = regions.filter(|region| region.shapes.weight(p) > 0.5);
        holding.next().map_or(CLAY, |region| if region.role == Role::Handle { HANDLE } else { FIXED })
    }

    pub fn write(mut self, path: &Path) -> Result<()> {
        let [width, height] = self.case.size;
        let columns = COLUMNS.min(self.pictures.len());
        while !self.pictures.len().is_multiple_of(columns) {
            self.pictures.push((Image::new(width, height, PAPER), String::new()));
        }
        // Captions of one length, so that all are of one size.
        let longest = self.pictures.iter().map(|(_, text)| text.len()).max().unwrap_or(0);
        let captioned: Vec<(Image, String)> =
            self.pictures.into_iter().map(|(image, text)| (image, format!("{text:^longest$}"))).collect();
        let row = |pictures: &[(Image, String)]| {
            let pictures: Vec<(&Image, &str)> =
                pictures.iter().map(|(image, text)| (image, &**text)).collect();
            Image::side_by_side(&pictures)
        };
        let rows: Vec<Image> = captioned.chunks(columns).map(row).collect();
        let width = rows.first().map_or(0, Image::width);
        let height = rows.iter().map(Image::height).sum();
        let pixels: Vec<[u8; 3]> = rows.iter().flat_map(|row| row.pixels().iter().copied()).collect();
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        Ok(write_file(path, &with_palette(width, height, &pixels)?)?)
    }
}

/// A PNG file of 256 colours, which takes a third of one with all.
fn with_palette(width: u32, height: u32, pixels: &[[u8; 3]]) -> Result<Vec<u8>> {
    let opaque: Vec<u8> = pixels.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]).collect();
    let palette = NeuQuant::new(3, 256, &opaque);
    let indices: Vec<u8> = opaque.chunks_exact(4).map(|pixel| palette.index_of(pixel) as u8).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(palette.color_map_rgb());
    encoder.set_compression(png::Compression::High);
    encoder.write_header()?.write_image_data(&indices)?;
    Ok(bytes)
}
