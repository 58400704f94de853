//! Finished pictures.

use glam::Vec3;
use rayon::prelude::*;
use simod_model::{Error, Result};

use super::font;

/// Colours of captions and their background.
const PAPER: [u8; 3] = [244, 244, 242];
const INK: [u8; 3] = [40, 40, 44];

/// A picture of 8-bit sRGB pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: u32,
    height: u32,
    /// Red, green and blue of each pixel, row by row from the top.
    pixels: Vec<[u8; 3]>,
}

impl Image {
    /// A picture of one colour. A width or height of 0 is taken as 1.
    pub fn new(width: u32, height: u32, color: [u8; 3]) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self { width, height, pixels: vec![color; width as usize * height as usize] }
    }

    /// Picture of given pixels, row by row from the top; none where their number does not fit the size.
    pub fn from_pixels(width: u32, height: u32, pixels: Vec<[u8; 3]>) -> Option<Self> {
        let fits = width > 0 && height > 0 && pixels.len() as u64 == u64::from(width) * u64::from(height);
        fits.then_some(Self { width, height, pixels })
    }

    /// Averages linear samples, `factor` by `factor` for a pixel.
    pub(super) fn downsampled(width: u32, height: u32, factor: u32, samples: &[Vec3]) -> Self {
        let mut image = Self::new(width, height, [0; 3]);
        let factor = factor as usize;
        let (wide, share) = (width as usize * factor, 1.0 / (factor * factor) as f32);
        image.pixels.par_iter_mut().enumerate().with_min_len(1 << 10).for_each(|(i, pixel)| {
            let (x, y) = (i % width as usize * factor, i / width as usize * factor);
            let sum: Vec3 =
                (0..factor).flat_map(|v| (0..factor).map(move |u| samples[(y + v) * wide + x + u])).sum();
            *pixel = (sum * share).to_array().map(srgb);
        });
        image
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Red, green and blue of all pixels, row by row from the top.
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    /// The pixel at (`x`, `y`) from the top left; none outside.
    pub fn pixel(&self, x: u32, y: u32) -> Option<[u8; 3]> {
        let inside = x < self.width && y < self.height;
        inside.then(|| self.pixels[y as usize * self.width as usize + x as usize])
    }

    /// The picture as the content of a PNG file.
    ///
    /// # Errors
    /// The picture is too large for the format.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        encode(self.width, self.height, png::ColorType::Rgb, self.pixels.as_flattened())
    }

    /// Pictures in a row, each with its caption below. Captions are drawn in capitals; characters that the
    /// font does not have stay empty.
    pub fn side_by_side(pictures: &[(&Image, &str)]) -> Self {
        const GAP: u32 = 12;
        // Captions fit the narrowest picture that has one, but stay legible.
        let fits = |(image, text): &(&Image, &str)| image.width / font::width(text, 1).max(1);
        let scale = pictures.iter().map(fits).min().unwrap_or(1).clamp(1, 3);
        let captioned = pictures.iter().any(|(_, text)| !text.is_empty());
        let caption = if captioned { font::HEIGHT * scale + GAP } else { 0 };

        let width = GAP + pictures.iter().map(|(image, _)| image.width + GAP).sum::<u32>();
        let tallest = pictures.iter().map(|(image, _)| image.height).max().unwrap_or(0);
        let mut montage = Self::new(width, GAP + tallest + caption + GAP, PAPER);
        let mut left = GAP;
        for (image, text) in pictures {
            montage.paste(image, left, GAP);
            let indent = image.width.saturating_sub(font::width(text, scale)) / 2;
            font::draw(text, scale, |x, y| {
                montage.set(left + indent + x, GAP + tallest + GAP + y, INK);
            });
            left += image.width + GAP;
        }
        montage
    }

    /// Picture above a bar of the colours from 0 to 1, with a label below its left end and its right one.
    /// Characters that the font does not have stay empty.
    pub fn with_scale(&self, color: impl Fn(f32) -> [u8; 3], labels: [&str; 2]) -> Self {
        const GAP: u32 = 12;
        let bar = [self.width.saturating_sub(2 * GAP).max(2), 10];
        let longest = font::width(labels[0], 1) + font::width(labels[1], 1) + GAP;
        let scale = (bar[0] / longest.max(1)).clamp(1, 2);
        let mut whole = Self::new(self.width, self.height + 3 * GAP + bar[1] + font::HEIGHT * scale, PAPER);
        whole.paste(self, 0, 0);
        let top = self.height + GAP;
        for (x, y) in (0..bar[0]).flat_map(|x| (0..bar[1]).map(move |y| (x, y))) {
            whole.set(GAP + x, top + y, color(x as f32 / (bar[0] - 1) as f32));
        }
        let right = bar[0].saturating_sub(font::width(labels[1], scale));
        for (label, left) in labels.into_iter().zip([GAP, GAP + right]) {
            font::draw(label, scale, |x, y| whole.set(left + x, top + bar[1] + GAP / 2 + y, INK));
        }
        whole
    }

    fn paste(&mut self, image: &Image, left: u32, top: u32) {
        for (row, y) in image.pixels.chunks_exact(image.width as usize).zip(top..) {
            let start = y as usize * self.width as usize + left as usize;
            self.pixels[start..start + row.len()].copy_from_slice(row);
        }
    }

    fn set(&mut self, x: u32, y: u32, color: [u8; 3]) {
        if x < self.width && y < self.height {
            self.pixels[y as usize * self.width as usize + x as usize] = color;
        }
    }
}

/// The content of a PNG file of 8 bits a channel.
pub(crate) fn encode(width: u32, height: u32, color: png::ColorType, pixels: &[u8]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().and_then(|mut writer| writer.write_image_data(pixels)).map_err(|error| {
        let what = format!("cannot encode a picture of {width} by {height}: {error}");
        Error::argument(what, "make the picture smaller")
    })?;
    Ok(bytes)
}

/// Byte of 8-bit sRGB for a linear value, with the brightest parts rolled off instead of cut.
fn srgb(x: f32) -> u8 {
    const KNEE: f32 = 0.8;
    let x = x.max(0.0);
    let x = if x > KNEE { 1.0 - (1.0 - KNEE) * (-(x - KNEE) / (1.0 - KNEE)).exp() } else { x };
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn montage_holds_pictures_and_captions() {
        let (red, blue) = (Image::new(40, 30, [255, 0, 0]), Image::new(20, 50, [0, 0, 255]));
        let montage = Image::side_by_side(&[(&red, "a-1"), (&blue, "")]);
        let count = |color| montage.pixels().iter().filter(|&&p| p == color).count();
        assert_eq!(count([255, 0, 0]), 1200);
        assert_eq!(count([0, 0, 255]), 1000);
        assert!(count([40, 40, 44]) > 20);
        assert!(Image::side_by_side(&[]).width() > 0);
        // A caption wider than its picture is cut at the montage's border.
        assert!(Image::side_by_side(&[(&blue, "much longer than wide")]).width() < 50);
    }

    #[test]
    fn a_scale_goes_from_one_end_to_the_other() {
        let image = Image::new(100, 20, [9, 9, 9]);
        let scaled = image.with_scale(|t| [(255.0 * t) as u8, 0, 0], ["0", "1.5 %"]);
        let count = |color| scaled.pixels().iter().filter(|&&p| p == color).count();
        assert_eq!(count([9, 9, 9]), 2000);
        assert_eq!((count([0, 0, 0]), count([255, 0, 0])), (10, 10));
        assert!(count(INK) > 20);
        Image::new(1, 1, INK).with_scale(|_| INK, ["", ""]);
    }

    #[test]
    fn png_reads_back() {
        let mut image = Image::new(3, 2, [1, 2, 3]);
        image.set(2, 1, [9, 8, 7]);
        let bytes = image.to_png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, image.pixels().as_flattened());
    }
}
