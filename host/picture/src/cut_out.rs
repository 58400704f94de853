//! Pictures whose background is seen through, of two renderings of the same before black and before white:
//! where both are alike, the picture hides what is behind (A. R. Smith, J. F. Blinn, *Blue Screen Matting*,
//! SIGGRAPH 1996, §4).

use simod_model::Result;

use crate::image::{Image, encode};

/// A picture of 8-bit sRGB pixels with how much each hides, from 0 to 255. Colours are not multiplied by
/// that.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CutOut {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 4]>,
}

impl CutOut {
    /// Cuts the foreground out of two pictures that differ in their background, which is black in one and
    /// white in the other; none where they are not of one size. Borders that were averaged in linear light
    /// are exact but for rounding.
    pub fn from_backgrounds(black: &Image, white: &Image) -> Option<Self> {
        let (width, height) = (black.width(), black.height());
        let same = (width, height) == (white.width(), white.height());
        let pixels = || black.pixels().iter().zip(white.pixels()).map(|(b, w)| pixel(*b, *w)).collect();
        same.then(|| Self { width, height, pixels: pixels() })
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Red, green, blue and opacity of all pixels, row by row from the top.
    pub fn pixels(&self) -> &[[u8; 4]] {
        &self.pixels
    }

    /// The picture as the content of a PNG file.
    ///
    /// # Errors
    /// The picture is too large for the format.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        encode(self.width, self.height, png::ColorType::Rgba, self.pixels.as_flattened())
    }
}

/// The colour and the opacity that give one over black, and the other over white.
fn pixel(black: [u8; 3], white: [u8; 3]) -> [u8; 4] {
    if black == white {
        return [black[0], black[1], black[2], 255];
    }
    let (black, white) = (black.map(linear), white.map(linear));
    // The mean of the channels, which all hide alike, rounds least.
    let seen_through = (0..3).map(|i| white[i] - black[i]).sum::<f32>() / 3.0;
    let opacity = (1.0 - seen_through).clamp(0.0, 1.0);
    if opacity < 0.5 / 255.0 {
        return [0; 4];
    }
    let [r, g, b] = black.map(|x| encoded(x / opacity));
    [r, g, b, (255.0 * opacity).round() as u8]
}

/// Linear value of a byte of the sRGB standard (IEC 61966-2-1).
fn linear(c: u8) -> f32 {
    let c = f32::from(c) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

fn encoded(x: f32) -> u8 {
    let x = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (x * 255.0).round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pixel of a colour and an opacity, over a background, in linear light.
    fn over(color: [u8; 3], opacity: f32, background: u8) -> [u8; 3] {
        color.map(|c| encoded(linear(c) * opacity + linear(background) * (1.0 - opacity)))
    }

    #[test]
    fn what_was_put_over_both_comes_back() {
        let color = [200, 90, 40];
        for opacity in [0.0, 0.25, 0.5, 0.9, 1.0] {
            let [black, white] = [0, 255].map(|b| Image::new(2, 1, over(color, opacity, b)));
            let cut = CutOut::from_backgrounds(&black, &white).unwrap();
            let [r, g, b, a] = cut.pixels()[1];
            assert!((f32::from(a) - 255.0 * opacity).abs() <= 1.5, "{a} of {opacity}");
            if opacity > 0.0 {
                let apart = [r, g, b].iter().zip(color).map(|(x, y)| x.abs_diff(y)).max().unwrap();
                assert!(apart <= 4, "{:?} at {opacity}", [r, g, b]);
            }
        }
        assert!(CutOut::from_backgrounds(&Image::new(2, 1, color), &Image::new(1, 2, color)).is_none());
    }

    #[test]
    fn a_file_holds_the_opacity() {
        let [black, white] = [0, 255].map(|b| Image::new(3, 2, over([10, 200, 30], 0.5, b)));
        let cut = CutOut::from_backgrounds(&black, &white).unwrap();
        let bytes = cut.to_png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (3, 2, png::ColorType::Rgba));
        assert_eq!(pixels, cut.pixels().as_flattened());
    }
}
