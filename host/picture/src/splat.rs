//! Two passes of splats into bands of pixels.

use glam::Vec3;
use rayon::prelude::*;

use super::SurfaceDisc;
use super::camera::{Lens, PictureCamera};

/// Rows of a band: what one thread draws at a time.
pub(super) const BAND: usize = 64;
/// Points projected at a time: the bound of the buffer of splats.
pub(super) const BATCH: usize = 1 << 16;
/// Least reach of a splat in pixels around its middle, so that none falls between samples.
const LEAST_REACH: f32 = 0.75;
/// Shares of their radius to which discs seen from the front and from the back hide what is behind them;
/// farther out they only blend in. So the discs of a steep or sharp edge hardly stand out from the surface,
/// above all those whose back is seen, while discs as wide as their spacing still leave no holes.
const HIDING: [f32; 2] = [0.74, 0.6];
/// A splat reaches at most so many pixels: a wrong radius costs no minutes.
const MOST_REACH: f32 = 256.0;

/// Surface that the picture shows at each sample, before it is lit. Splats are always drawn by the same
/// memory: to get it anew takes the system longer than to fill it.
///
/// Memory: 48 bytes for each sample, and some 130 for each splat of a batch, 8 MB at most.
pub(super) struct SplatBuffer {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<Pixel>,
    batch: Vec<Option<ViewSplat>>,
    bands: Bands,
}

/// One sample of the picture.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    /// Depth of the nearest surface; infinite where there is none.
    nearest: f32,
    /// Sums, weighted: of depth, normal (in view coordinates, towards the eye) and colour.
    depth: f32,
    normal: Vec3,
    color: Vec3,
    /// The colour in the second picture, where there are two of the same points.
    other: Vec3,
    weight: f32,
}

impl Pixel {
    const EMPTY: Self = Self {
        nearest: f32::INFINITY,
        depth: 0.0,
        normal: Vec3::ZERO,
        color: Vec3::ZERO,
        other: Vec3::ZERO,
        weight: 0.0,
    };

    /// Notes a surface at a depth, which hides all that is farther.
    #[inline]
    pub fn come_near(&mut self, depth: f32) {
        self.nearest = self.nearest.min(depth);
    }

    /// Whether a depth is that of the nearest surface, or behind it by no more than `behind`.
    #[inline]
    pub fn is_near(&self, depth: f32, behind: f32) -> bool {
        self.nearest.is_finite() && depth <= self.nearest + behind
    }

    /// Adds a splat on the nearest surface.
    #[inline]
    pub fn blend(&mut self, weight: f32, depth: f32, normal: Vec3, color: Vec3) {
        self.weight += weight;
        self.depth += weight * depth;
        self.normal += normal * weight;
        self.color += color * weight;
    }

    /// Depth of the blended surface; infinite where there is none.
    pub fn depth(&self) -> f32 {
        if self.weight > 0.0 { self.depth / self.weight } else { f32::INFINITY }
    }

    /// Unit normal in view coordinates; zero where no point had one.
    pub fn normal(&self) -> Vec3 {
        self.normal.normalize_or_zero()
    }

    /// Colour, from 0 to 1.
    pub fn color(&self) -> Vec3 {
        if self.weight > 0.0 { self.color / self.weight } else { Vec3::ZERO }
    }

    /// The pixel's colour in the second picture.
    pub fn other_color(&self) -> Vec3 {
        if self.weight > 0.0 { self.other / self.weight } else { Vec3::ZERO }
    }
}

/// A disc, or an ellipse, in view coordinates.
struct ViewSplat {
    center: Vec3,
    /// Unit normal towards the eye; zero where it is not known.
    normal: Vec3,
    color: Vec3,
    /// Colour in another picture of the same discs.
    other: Vec3,
    radius: f32,
    /// Half axes of an ellipse, over the squares of their lengths.
    axes: Option<[Vec3; 2]>,
    /// Least weight with which the splat hides what is behind it.
    hiding: f32,
    from_back: bool,
    pixel: [f32; 2],
    /// Reach of the splat in pixels around its middle.
    reach: f32,
    /// The samples that are drawn: columns and rows, each from the first to beyond the last.
    columns: [usize; 2],
    rows: [usize; 2],
}

/// Part of the splats that is drawn.
#[derive(Clone, Copy, PartialEq, Eq)]
enum SplatDetail {
    /// The part that hides what is behind it, drawn in any order.
    Hiding,
    All,
}

impl ViewSplat {
    /// Splat in a picture of the given size; none if the point is outside, or is no disc at all.
    fn new(
        (camera, lens): (&PictureCamera, &Lens),
        (size, drawn): ([usize; 2], SplatDetail),
        point: &SurfaceDisc,
        axes: Option<&[Vec3; 2]>,
    ) -> Option<Self> {
        let center = camera.to_view(point.position);
        if !(center.is_finite() && center.z > lens.near && point.radius >= 0.0) {
            return None;
        }
        let pixel = lens.project(center);
        let scale = lens.scale[0].max(lens.scale[1]) / center.z;
        let reach = (point.radius * scale).clamp(LEAST_REACH, MOST_REACH);
        let normal = camera.direction_to_view(point.normal.as_dvec3()).as_vec3().normalize_or_zero();
        let from_back = normal.dot(center) > 0.0;
        let normal = if from_back { -normal } else { normal };
        // A splat as small as a sample hides wherever it is drawn: else it could fall between samples.
        let share = HIDING[usize::from(from_back)].max(LEAST_REACH / reach);
        let (radius, hiding) = (reach / scale, weight(share * share));
        let drawn = match drawn {
            SplatDetail::Hiding if axes.is_none() => hiding_reach(center, radius, share) * scale,
            _ => reach,
        };
        let drawn = drawn.max(LEAST_REACH).min(reach);
        let columns = covered(pixel[0], drawn, size[0])?;
        let rows = covered(pixel[1], drawn, size[1])?;
        let shrunk = radius / point.radius;
        let axes = axes.filter(|_| shrunk > 0.0 && shrunk.is_finite()).map(|axes| {
            axes.map(|axis| {
                let axis = shrunk * camera.direction_to_view(axis.as_dvec3()).as_vec3();
                axis / axis.length_squared()
            })
        });
        let color = color_of(point.color);
        let other = Vec3::ZERO;
        Some(Self {
            center,
            normal,
            color,
            other,
            radius,
            axes,
            hiding,
            from_back,
            pixel,
            reach,
            columns,
            rows,
        })
    }

    /// Least depth of any point of the splat.
    #[inline]
    fn least_depth(&self) -> f32 {
        self.center.z - self.radius
    }

    /// Depth and weight (0 outside) along a pixel's ray; (`dx`, `dy`) is the way there from the splat's
    /// middle.
    fn hit(&self, ray: Vec3, dx: f32, dy: f32) -> (f32, f32) {
        let on_screen = dx * dx + dy * dy;
        let facing = self.normal.dot(ray);
        // Facing the eye where the normal is unknown; a disc seen edge-on keeps its depth within its radius.
        let mut depth = self.center.z;
        let mut distance = on_screen / (self.reach * self.reach);
        if facing < 0.0 {
            depth = (self.normal.dot(self.center) / facing)
                .clamp(self.least_depth(), self.center.z + self.radius);
            let way = ray * depth - self.center;
            let on_disc = match self.axes {
                Some([a, b]) => way.dot(a).powi(2) + way.dot(b).powi(2),
                None => way.length_squared() / (self.radius * self.radius),
            };
            // A disc narrower than a sample is drawn as a dot of that size.
            distance = on_disc.min(on_screen / (LEAST_REACH * LEAST_REACH));
        }
        (depth, weight(distance))
    }
}

/// Distance from a disc's middle, on the picture's plane, up to which the disc, in view coordinates, is seen
/// within a share of its radius: a point that is off by w, at a depth of z, lies within |w| |c| / z, where c
/// is the middle.
fn hiding_reach(center: Vec3, radius: f32, share: f32) -> f32 {
    const ROUNDING: f32 = 1.01;
    let nearest = center.z - share * radius;
    if nearest > 0.0 { ROUNDING * share * radius * center.length() / nearest } else { f32::INFINITY }
}

fn color_of(color: [u8; 3]) -> Vec3 {
    Vec3::from(color.map(f32::from)) / 255.0
}

/// Weight by squared distance, in units of the radius.
fn weight(distance: f32) -> f32 {
    let t = (1.0 - distance).max(0.0);
    t * t
}

impl SplatBuffer {
    pub fn new(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        let pixels = vec![Pixel::EMPTY; width * height];
        Self { width, height, pixels, batch: Vec::new(), bands: Bands::default() }
    }

    pub fn lens(&self, camera: &PictureCamera) -> Lens {
        camera.lens(self.width as u32, self.height as u32)
    }

    /// First pass: the depth of the nearest surface.
    pub fn depth(&mut self, camera: &PictureCamera, points: &[SurfaceDisc], axes: &[[Vec3; 2]]) {
        let may_show = |pixel: &Pixel, splat: &ViewSplat| splat.least_depth() < pixel.nearest;
        self.draw(
            (camera, SplatDetail::Hiding),
            (points, axes, &[]),
            may_show,
            |pixel, splat, depth, weight| {
                if weight >= splat.hiding {
                    pixel.come_near(depth);
                }
            },
        );
    }

    /// Second pass: blends the splats on the nearest surface.
    pub fn blend(&mut self, camera: &PictureCamera, points: &[SurfaceDisc], axes: &[[Vec3; 2]]) {
        let may_show = |pixel: &Pixel, splat: &ViewSplat| pixel.is_near(splat.least_depth(), splat.radius);
        self.draw(
            (camera, SplatDetail::All),
            (points, axes, &[]),
            may_show,
            |pixel, splat, depth, weight| {
                // Neighbouring discs of one surface differ in depth by less than they are wide.
                if pixel.is_near(depth, splat.radius) {
                    pixel.blend(weight, depth, splat.normal, splat.color);
                }
            },
        );
    }

    /// Blends points into two pictures at once, in the points' colours and in others, of which there are as
    /// many.
    pub fn blend_both(&mut self, camera: &PictureCamera, points: &[SurfaceDisc], others: &[[u8; 3]]) {
        let may_show = |pixel: &Pixel, splat: &ViewSplat| pixel.is_near(splat.least_depth(), splat.radius);
        self.draw(
            (camera, SplatDetail::All),
            (points, &[], others),
            may_show,
            |pixel, splat, depth, weight| {
                if pixel.is_near(depth, splat.radius) {
                    pixel.blend(weight, depth, splat.normal, splat.color);
                    pixel.other += splat.other * weight;
                }
            },
        );
    }

    fn draw(
        &mut self,
        (camera, drawn): (&PictureCamera, SplatDetail),
        (points, axes, others): (&[SurfaceDisc], &[[Vec3; 2]], &[[u8; 3]]),
        may_show: impl Fn(&Pixel, &ViewSplat) -> bool + Sync,
        hit: impl Fn(&mut Pixel, &ViewSplat, f32, f32) + Sync,
    ) {
        let lens = self.lens(camera);
        let size = [self.width, self.height];
        for (number, batch) in points.chunks(BATCH).enumerate() {
            let axes = axes.get(number * BATCH..).unwrap_or_default();
            let others = others.get(number * BATCH..).unwrap_or_default();
            let splat = |(i, point)| {
                let splat = ViewSplat::new((camera, &lens), (size, drawn), point, axes.get(i))?;
                Some(ViewSplat { other: others.get(i).map_or(Vec3::ZERO, |color| color_of(*color)), ..splat })
            };
            batch.par_iter().enumerate().map(splat).collect_into_vec(&mut self.batch);
            self.bands.sort(size[1], &self.batch, |splat| splat.as_ref().map(|splat| splat.rows));
            let Self { pixels, batch: splats, bands, .. } = self;
            pixels.par_chunks_mut(BAND * size[0]).enumerate().for_each(|(band, pixels)| {
                let first = band * BAND;
                let all = || bands.in_band(band, splats).flatten();
                let mut show = |splat: &ViewSplat| {
                    let [left, right] = splat.columns;
                    for y in splat.rows[0].max(first)..splat.rows[1].min(first + BAND) {
                        let row = &mut pixels[(y - first) * size[0]..][..size[0]];
                        for (x, pixel) in (left..right).zip(&mut row[left..right]) {
                            // A hidden splat needs no further work.
                            if !may_show(pixel, splat) {
                                continue;
                            }
                            let (dx, dy) = (x as f32 + 0.5 - splat.pixel[0], y as f32 + 0.5 - splat.pixel[1]);
                            let (depth, weight) = splat.hit(lens.ray(x, y), dx, dy);
                            if weight > 0.0 {
                                hit(pixel, splat, depth, weight);
                            }
                        }
                    }
                };
                match drawn {
                    // Discs that are seen from the front hide most of those that are not.
                    SplatDetail::Hiding => {
                        all().filter(|splat| !splat.from_back).for_each(&mut show);
                        all().filter(|splat| splat.from_back).for_each(show);
                    }
                    SplatDetail::All => all().for_each(show),
                }
            });
        }
    }
}

/// Index of the things of a batch that each band of a picture shows, in their order.
///
/// Memory: 4 bytes for each band that a thing is in.
#[derive(Default)]
pub(super) struct Bands {
    starts: Vec<u32>,
    things: Vec<u32>,
}

impl Bands {
    /// Sorts things of a picture of so many rows, by the rows that each is in, from the first to beyond the
    /// last.
    pub fn sort<T>(&mut self, height: usize, things: &[T], rows: impl Fn(&T) -> Option<[usize; 2]>) {
        let within = |thing: &T| rows(thing).map_or(0..0, |[first, last]| first / BAND..last.div_ceil(BAND));
        self.starts.clear();
        self.starts.resize(height.div_ceil(BAND) + 2, 0);
        // Two places ahead, so that in the end each begins where the one before it ends.
        things.iter().flat_map(within).for_each(|band| self.starts[band + 2] += 1);
        (2..self.starts.len()).for_each(|i| self.starts[i] += self.starts[i - 1]);
        self.things.clear();
        self.things.resize(self.starts.last().map_or(0, |all| *all as usize), 0);
        for (number, thing) in (0..).zip(things) {
            for band in within(thing) {
                let next = &mut self.starts[band + 1];
                self.things[*next as usize] = number;
                *next += 1;
            }
        }
    }

    /// The things of a band.
    pub fn in_band<'a, T>(&'a self, band: usize, things: &'a [T]) -> impl Iterator<Item = &'a T> {
        let range = self.starts[band] as usize..self.starts[band + 1] as usize;
        self.things[range].iter().map(|i| &things[*i as usize])
    }
}

/// The samples, of so many, whose middles lie within `reach` of a coordinate.
fn covered(middle: f32, reach: f32, count: usize) -> Option<[usize; 2]> {
    // Rounded by hand, as `ceil` and `floor` call a library for each: up from what is left of the first
    // sample is 0.
    let (from, to) = (middle - reach - 0.5, middle + reach - 0.5);
    if !(to >= 0.0 && from <= count as f32 - 1.0) {
        return None;
    }
    let whole = from.max(0.0) as usize;
    let first = whole + usize::from((whole as f32) < from);
    let end = (to as usize + 1).min(count);
    (first < end).then_some([first, end])
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// The discs that the first pass leaves out, and the order in which it draws, change nothing.
    #[test]
    fn the_nearest_surface_is_that_of_whole_discs_in_any_order() {
        let number = |i: u32, k: f64| (f64::from(i) * k).sin();
        for (yaw, size) in [(0.3, 0.02), (2.0, 0.3), (4.0, 3.0)] {
            let camera = PictureCamera::frame([DVec3::splat(-1.0), DVec3::splat(1.0)], yaw, 0.4, 1.5);
            let point = |i: u32| SurfaceDisc {
                position: DVec3::new(number(i, 1.7), number(i, 2.9), number(i, 5.3)),
                // Some points have no normal.
                normal: Vec3::new(number(i, 3.1) as f32, number(i, 7.7) as f32, number(i, 0.9) as f32)
                    * f32::from(u8::from(!i.is_multiple_of(5))),
                color: [0; 3],
                radius: (size * (1.1 + number(i, 11.0))) as f32,
            };
            let points: Vec<SurfaceDisc> = (0..4000).map(point).collect();
            let [mut canvas, mut whole] = [SplatBuffer::new(180, 120), SplatBuffer::new(180, 120)];
            canvas.depth(&camera, &points, &[]);
            whole.draw(
                (&camera, SplatDetail::All),
                (&points, &[], &[]),
                |_, _| true,
                |pixel, splat, depth, weight| {
                    if weight >= splat.hiding {
                        pixel.come_near(depth);
                    }
                },
            );
            let nearest = |canvas: &SplatBuffer| canvas.pixels.iter().map(|p| p.nearest).collect::<Vec<_>>();
            assert!(nearest(&canvas) == nearest(&whole), "{yaw} {size}");
            assert!(whole.pixels.iter().any(|p| p.nearest.is_finite()));
        }
    }

    #[test]
    fn bands_have_what_is_in_them_in_order() {
        let mut bands = Bands::default();
        for height in [1, BAND - 1, BAND, BAND + 1, 3 * BAND + 7] {
            // From any row on, some to any other; some are in no row.
            let rows = |i: usize| {
                let (first, count) = (i * 37 % height, i * i * 13 % 150);
                (count > 0).then(|| [first, (first + count).min(height)])
            };
            let things: Vec<_> = (0..200).map(|i| (i, rows(i))).collect();
            bands.sort(height, &things, |(_, rows)| *rows);
            for band in 0..height.div_ceil(BAND) {
                let found: Vec<usize> = bands.in_band(band, &things).map(|(i, _)| *i).collect();
                let meets = |rows: [usize; 2]| rows[0] < (band + 1) * BAND && rows[1] > band * BAND;
                let expected = things.iter().filter(|(_, rows)| rows.is_some_and(meets)).map(|(i, _)| *i);
                assert_eq!(found, expected.collect::<Vec<_>>(), "{height}, {band}");
            }
        }
    }
}
