//! A surface's samples and triangles in the device's memory.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::cast_slice;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use wgpu::{BindGroup, BindGroupLayout, Buffer, BufferUsages, Device, Queue};

use crate::gpu::Gpu;
use crate::order::Order;
use crate::pipeline::bind;

/// A sampled surface, in local coordinates. All lists are as long as `positions`, but not `triangles`, and
/// `axes` may be empty.
#[derive(Debug, Clone, Copy, Default)]
pub struct SceneSurface<'a> {
    /// Positions; samples that are not finite are not drawn.
    pub positions: &'a [Vec3],
    /// Normals of any length; zero (or not finite) where they are not known.
    pub normals: &'a [Vec3],
    /// Radii of the discs: a little more than the distance of neighbours, so that discs leave no holes. A
    /// sample with a negative radius is not drawn.
    pub radii: &'a [f32],
    /// Half axes of ellipses in the discs' place, the longer one first, at right angles to each other and
    /// to the normal; `radii` has the length of the longer one, or a negative number for no ellipse. Empty
    /// where all are round discs.
    pub axes: &'a [[Vec3; 2]],
    /// Red, green and blue, in sRGB; white where there are none.
    pub colors: Option<&'a [[u8; 3]]>,
    /// Indices of samples; their order tells the front side (counter-clockwise). May be empty.
    pub triangles: &'a [[u32; 3]],
}

/// A surface that cannot be drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BadSurface {
    /// A list has another length than the positions.
    #[error("{what}: {found} for {expected} samples\nhint: give one for each sample")]
    Length {
        /// The list.
        what: &'static str,
        /// The list's length.
        found: usize,
        /// The number of samples.
        expected: usize,
    },
    /// A triangle of samples that do not exist.
    #[error("triangle {triangle} has sample {index} of {samples}\nhint: samples are counted from 0")]
    Triangle {
        /// The triangle's number.
        triangle: usize,
        /// The corner's sample.
        index: u32,
        /// The number of samples.
        samples: usize,
    },
}

/// Samples with their order of drawing, in chunks that the device takes.
pub(crate) struct Cloud {
    /// Order in which the samples are held and drawn; triangles speak of places in it.
    order: Order,
    chunks: Vec<SampleChunk>,
    triangles: Option<DrawnTriangles>,
    /// Half the diagonal of the bounding box.
    pub radius: f32,
}

/// The samples that are drawn first.
pub(crate) struct First {
    /// The samples' indices, ascending.
    pub samples: Arc<[u32]>,
    /// The place of each in the order of drawing.
    places: Vec<u32>,
}

/// A part of the samples.
struct SampleChunk {
    places: Range<usize>,
    geometry: Buffer,
    look: Buffer,
    shape: Buffer,
    group: BindGroup,
}

/// Triangles of three indices each.
struct DrawnTriangles {
    buffer: Buffer,
    indices: u32,
}

/// Position and packed normal; see `samples.wgsl`.
type Geometry = [u32; 4];
/// Radius and colour.
type DiscLook = [u32; 2];
/// Direction of the longer axis, and ratio of the shorter one's length to its length.
type DiscShape = u32;

/// Samples that a thread packs at once, at least.
const LEAST_TOGETHER: usize = 4096;

/// Shape of a disc, which is as wide as it is long.
const ROUND: DiscShape = 0xff00_0000;

/// Value in a normal's place for a sample that is not drawn; the same in `samples.wgsl`.
const HIDDEN: u32 = 0x8000_8000;
const UNKNOWN: u32 = 0x8000_0000;

impl Cloud {
    pub fn new(gpu: &Gpu, layout: &BindGroupLayout, surface: &SceneSurface<'_>) -> Result<Self, BadSurface> {
        surface.check()?;
        let order = Order::new(surface.positions);
        let samples = order.samples.len();
        let limits = gpu.device.limits();
        let most = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size) as usize;
        let per_chunk = (most / size_of::<Geometry>()).min((u32::MAX / 3) as usize);
        let chunks = (0..samples)
            .step_by(per_chunk)
            .map(|first| SampleChunk::new(&gpu.device, layout, first..samples.min(first + per_chunk)))
            .collect();
        let mut cloud = Self { order, chunks, triangles: None, radius: radius(surface.positions) };
        cloud.write_geometry(&gpu.queue, surface.positions, surface.normals);
        cloud.write_shapes(&gpu.queue, surface.axes);
        cloud.write_look(&gpu.queue, surface.radii, surface.colors);
        // Triangles reach all samples only where the samples are in one chunk.
        if cloud.chunks.len() == 1 && !surface.triangles.is_empty() {
            cloud.triangles =
                DrawnTriangles::new(gpu, &cloud.order.samples, surface.triangles, limits.max_buffer_size);
        }
        Ok(cloud)
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.order.samples.len()
    }

    /// Number of samples to draw where at most `most` are wanted, so that they are evenly spread.
    pub fn part(&self, most: usize) -> usize {
        if most >= self.len() { self.len() } else { self.order.part(most) }
    }

    /// Number of samples that are about one of 2^`times`, evenly spread.
    pub fn halved(&self, times: usize) -> usize {
        self.order.halved(times)
    }

    /// Number of triangles that can be drawn.
    pub fn triangles(&self) -> usize {
        self.triangles.as_ref().map_or(0, |triangles| triangles.indices as usize / 3)
    }

    /// The `count` samples that are drawn first.
    pub fn first(&self, count: usize) -> First {
        let mut first: Vec<(u32, u32)> = self.order.samples[..count].iter().copied().zip(0..).collect();
        first.par_sort_unstable();
        First {
            samples: first.iter().map(|(sample, _)| *sample).collect(),
            places: first.iter().map(|(_, place)| *place).collect(),
        }
    }

    /// Uploads all of the first samples; the surface's lists have one entry for each of them.
    pub fn write_first(&self, queue: &Queue, first: &First, of: &SceneSurface<'_>) {
        let packed = |k: usize| {
            let color = of.colors.map(|colors| colors[k]);
            let shape = of.axes.get(k).map_or(ROUND, shape);
            (packed(of.positions[k], of.normals[k]), look(of.radii[k], color), shape)
        };
        let count = first.places.len();
        let all: Vec<(Geometry, DiscLook, DiscShape)> =
            (0..count).into_par_iter().with_min_len(LEAST_TOGETHER).map(packed).collect();
        // Entries are put into the order of drawing.
        let mut geometry = vec![Geometry::default(); count];
        let (mut looks, mut shapes) = (vec![DiscLook::default(); count], vec![DiscShape::default(); count]);
        for (packed, place) in all.into_iter().zip(&first.places) {
            let place = *place as usize;
            (geometry[place], looks[place], shapes[place]) = packed;
        }
        for chunk in &self.chunks {
            let places = chunk.places.start..chunk.places.end.min(first.places.len());
            if places.is_empty() {
                break;
            }
            queue.write_buffer(&chunk.geometry, 0, cast_slice(&geometry[places.clone()]));
            queue.write_buffer(&chunk.look, 0, cast_slice(&looks[places.clone()]));
            queue.write_buffer(&chunk.shape, 0, cast_slice(&shapes[places]));
        }
    }

    /// Uploads positions and normals, one for each sample.
    pub fn write_geometry(&self, queue: &Queue, positions: &[Vec3], normals: &[Vec3]) {
        for chunk in &self.chunks {
            let packed: Vec<Geometry> = self.order.samples[chunk.places.clone()]
                .par_iter()
                .map(|&i| packed(positions[i as usize], normals[i as usize]))
                .collect();
            queue.write_buffer(&chunk.geometry, 0, cast_slice(&packed));
        }
    }

    /// Uploads half axes, one pair for each sample, or none.
    pub fn write_shapes(&self, queue: &Queue, axes: &[[Vec3; 2]]) {
        let shape = |i: &u32| axes.get(*i as usize).map_or(ROUND, shape);
        for chunk in &self.chunks {
            let packed: Vec<DiscShape> =
                self.order.samples[chunk.places.clone()].par_iter().map(shape).collect();
            queue.write_buffer(&chunk.shape, 0, cast_slice(&packed));
        }
    }

    /// Uploads radii and colours, one for each sample.
    pub fn write_look(&self, queue: &Queue, radii: &[f32], colors: Option<&[[u8; 3]]>) {
        for chunk in &self.chunks {
            let packed: Vec<DiscLook> = self.order.samples[chunk.places.clone()]
                .par_iter()
                .map(|&i| look(radii[i as usize], colors.map(|colors| colors[i as usize])))
                .collect();
            queue.write_buffer(&chunk.look, 0, cast_slice(&packed));
        }
    }

    /// Draws the splats of these places of the order.
    pub fn draw_splats(&self, pass: &mut wgpu::RenderPass<'_>, places: Range<usize>) {
        for chunk in &self.chunks {
            let first = places.start.max(chunk.places.start);
            let last = places.end.min(chunk.places.end);
            if first < last {
                let within = |place: usize| 3 * (place - chunk.places.start) as u32;
                pass.set_bind_group(1, &chunk.group, &[]);
                pass.draw(within(first)..within(last), 0..1);
            }
        }
    }

    /// Draws the triangles, if there are any.
    pub fn draw_triangles(&self, pass: &mut wgpu::RenderPass<'_>) {
        if let (Some(triangles), [chunk]) = (&self.triangles, self.chunks.as_slice()) {
            pass.set_bind_group(1, &chunk.group, &[]);
            pass.set_index_buffer(triangles.buffer.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..triangles.indices, 0, 0..1);
        }
    }
}

impl SampleChunk {
    fn new(device: &Device, layout: &BindGroupLayout, places: Range<usize>) -> Self {
        let buffer = |label, bytes: usize| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: (places.len() * bytes) as u64,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let geometry = buffer("positions and normals", size_of::<Geometry>());
        let look = buffer("radii and colours", size_of::<DiscLook>());
        let shape = buffer("axes", size_of::<DiscShape>());
        let buffers = [&geometry, &look, &shape].map(Buffer::as_entire_binding);
        let group = bind(device, "samples", layout, &buffers);
        Self { places, geometry, look, shape, group }
    }
}

impl DrawnTriangles {
    /// Buffers of triangles; none where the device takes no buffer that long.
    fn new(gpu: &Gpu, order: &[u32], triangles: &[[u32; 3]], most: u64) -> Option<Self> {
        let mut places = vec![0u32; order.len()];
        order.iter().zip(0..).for_each(|(&sample, place)| places[sample as usize] = place);
        let indices: Vec<[u32; 3]> =
            triangles.par_iter().map(|corners| corners.map(|i| places[i as usize])).collect();
        let bytes: &[u8] = cast_slice(&indices);
        if bytes.len() as u64 > most {
            return None;
        }
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("triangles"),
            size: bytes.len() as u64,
            usage: BufferUsages::INDEX | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        gpu.queue.write_buffer(&buffer, 0, bytes);
        Some(Self { buffer, indices: u32::try_from(3 * indices.len()).ok()? })
    }
}

impl SceneSurface<'_> {
    pub(crate) fn check(&self) -> Result<(), BadSurface> {
        let samples = self.positions.len();
        same_length("normals", self.normals.len(), samples)?;
        same_length("radii", self.radii.len(), samples)?;
        same_length("axes", if self.axes.is_empty() { samples } else { self.axes.len() }, samples)?;
        same_length("colours", self.colors.map_or(samples, <[_]>::len), samples)?;
        let wrong = |corners: &[u32; 3]| corners.iter().copied().find(|i| *i as usize >= samples);
        match self.triangles.iter().enumerate().find_map(|(t, corners)| Some((t, wrong(corners)?))) {
            Some((triangle, index)) => Err(BadSurface::Triangle { triangle, index, samples }),
            None => Ok(()),
        }
    }
}

pub(crate) fn same_length(what: &'static str, found: usize, expected: usize) -> Result<(), BadSurface> {
    if found == expected { Ok(()) } else { Err(BadSurface::Length { what, found, expected }) }
}

/// Half the diagonal of the box of finite positions; 1 where there is none.
fn radius(positions: &[Vec3]) -> f32 {
    let (low, high) = positions
        .iter()
        .filter(|p| p.is_finite())
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let radius = 0.5 * (high - low).length();
    if radius.is_finite() && radius > 0.0 { radius } else { 1.0 }
}

fn look(radius: f32, color: Option<[u8; 3]>) -> DiscLook {
    let [r, g, b] = color.unwrap_or([255; 3]);
    let radius = if radius.is_finite() { radius } else { 0.0 };
    [radius.to_bits(), u32::from_le_bytes([r, g, b, 255])]
}

fn packed(position: Vec3, normal: Vec3) -> Geometry {
    let [x, y, z] = position.to_array().map(f32::to_bits);
    if position.is_finite() { [x, y, z, octahedral(normal)] } else { [0, 0, 0, HIDDEN] }
}

/// Direction of the longer axis in 12 bits for each of two coordinates, and the other axis' length in 8, as
/// a part of the longer one's.
fn shape([long, short]: &[Vec3; 2]) -> DiscShape {
    let Some(e) = on_octahedron(*long) else { return ROUND };
    let word = |x: f32| (rounded(x.clamp(-1.0, 1.0) * 2047.0) + 2047) as u32;
    // A conversion saturates, and gives 0 for NaN.
    let ratio = (255.0 * short.length() / long.length() + 0.5) as u8;
    word(e.x) | word(e.y) << 12 | u32::from(ratio) << 24
}

/// Nearest whole number: the library's function would be a call for each of some numbers in each picture.
fn rounded(x: f32) -> i32 {
    (x + 0.5_f32.copysign(x)) as i32
}

/// Direction as a point of an octahedron's net, in 16 bits for each of two coordinates.
fn octahedral(normal: Vec3) -> u32 {
    let word = |x: f32| u32::from(rounded(x.clamp(-1.0, 1.0) * 32767.0) as i16 as u16);
    on_octahedron(normal).map_or(UNKNOWN, |e| word(e.x) | word(e.y) << 16)
}

/// Direction as a point of an octahedron's net, with both coordinates from -1 to 1; nothing where the
/// direction is not known (Z. Cigolle et al., *A Survey of Efficient Representations for Independent Unit
/// Vectors*, JCGT 3(2), 2014).
fn on_octahedron(direction: Vec3) -> Option<Vec2> {
    let n = direction / direction.abs().element_sum();
    if !n.is_finite() {
        return None;
    }
    let sign = |x: f32| if x >= 0.0 { 1.0 } else { -1.0 };
    Some(if n.z >= 0.0 {
        Vec2::new(n.x, n.y)
    } else {
        Vec2::new((1.0 - n.y.abs()) * sign(n.x), (1.0 - n.x.abs()) * sign(n.y))
    })
}
