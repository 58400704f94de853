//! The model's own colours as colours of the samples, for programs in which these are deformed.
//!
//! A sample has the mean colour of the vertices that it stands for: where faces tell which these are, of
//! those in its cluster, and otherwise of those that it is the nearest sample to. As a mean needs no more,
//! one of so many vertices is picked while the model streams, and kept in a temporary file until the samples
//! are known.

use std::ops::Range;
use std::path::Path;
use std::sync::OnceLock;

use bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut};
use glam::Vec3;
use rayon::prelude::*;
use simod_model::frame::Frame;
use simod_model::mapped::looked_at;
use simod_model::scratch::Scratch;
use simod_model::{ColorScale, Colors, Model, Progress, Result, SMALL_CHUNK, VertexChunk};
use xxhash_rust::xxh3::xxh3_64;

use crate::sampling::KdTree;
use crate::sampling::kd_tree::completed;

/// Vertices for each sample that are enough for a mean.
const ENOUGH: u64 = 8;

/// Largest number of vertices that are picked where the number of samples is not known.
const MOST: u64 = 4 << 20;

/// Vertices that are written or looked up at a time.
const BLOCK: usize = 1 << 14;

/// The colours of a model's vertices as bytes.
pub struct ColorBytes {
    colors: Colors,
    scale: ColorScale,
}

impl ColorBytes {
    /// Range of a model's colours, where it has some, by vertices all over the file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn for_model(model: &dyn Model) -> Result<Option<Self>> {
        let Some(colors) = Colors::seen(&model.info().attributes) else { return Ok(None) };
        Ok(Some(Self { colors, scale: ColorScale::of_model(model, &colors)? }))
    }

    /// The attributes that are the colours, and the scale of their numbers.
    pub fn meaning(&self) -> (Colors, ColorScale) {
        (self.colors, self.scale)
    }

    /// Decodes the colours of a chunk that was read of the model, in place of the content of `to`.
    ///
    /// # Errors
    /// In a text format, something is no number.
    pub fn decode(&self, model: &dyn Model, chunk: &VertexChunk, to: &mut Vec<[u8; 3]>) -> Result<()> {
        let mut lists = ColorLists::default();
        model.some_attributes(chunk, &self.colors.places, &mut lists)?;
        to.clear();
        to.extend((0..chunk.len()).map(|i| self.color(&lists, i)));
        Ok(())
    }

    #[inline]
    fn color(&self, lists: &ColorLists, vertex: usize) -> [u8; 3] {
        [0, 1, 2].map(|part: usize| self.scale.byte(lists[part][vertex]))
    }
}

/// Red, green and blue of the vertices of a chunk, as they are in the file.
pub type ColorLists = [Vec<f64>; 3];

/// A vertex that was picked.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Pick {
    /// Position in local coordinates; not finite where the vertex has no position.
    position: Vec3,
    color: [u8; 4],
}

/// The vertices that are picked, and their colours.
pub struct Picking {
    colors: ColorBytes,
    /// Length of the runs of vertices of which one is picked; which one follows from a hash of the run's
    /// number. The first of each run would be picked along stripes where the vertices are in rows.
    every: u64,
}

impl Picking {
    /// Picks for `samples` samples, or for an unknown number; `None` for a model without colours.
    ///
    /// # Errors
    /// The model cannot be read.
    pub fn for_model(model: &dyn Model, samples: Option<u64>) -> Result<Option<Self>> {
        let most = samples.map_or(MOST, |n| n.saturating_mul(ENOUGH));
        let every = (model.info().vertices / most.max(1)).max(1);
        Ok(ColorBytes::for_model(model)?.map(|colors| Self { colors, every }))
    }

    /// Picks of a chunk that was read of the model. `lists` are used for its numbers.
    ///
    /// # Errors
    /// In a text format, something is no number.
    pub fn pick(
        &self,
        model: &dyn Model,
        frame: &Frame,
        chunk: &VertexChunk,
        lists: &mut ColorLists,
        to: &mut Vec<Pick>,
    ) -> Result<()> {
        let end = chunk.first + chunk.len() as u64;
        let picked = (chunk.first / self.every..end.div_ceil(self.every)).map(|run| self.vertex(run));
        let mut picked = picked.filter(|vertex| (chunk.first..end).contains(vertex)).peekable();
        if picked.peek().is_none() {
            return Ok(());
        }
        model.some_attributes(chunk, &self.colors.colors.places, lists)?;
        to.extend(picked.map(|vertex| {
            let i = (vertex - chunk.first) as usize;
            let [r, g, b] = self.colors.color(lists, i);
            Pick { position: frame.to_local(chunk.positions[i]), color: [r, g, b, 0] }
        }));
        Ok(())
    }

    /// The vertex that is picked of run number `run`. Of the last run, which may be shorter, it may be beyond
    /// the model.
    fn vertex(&self, run: u64) -> u64 {
        run * self.every + xxh3_64(&run.to_le_bytes()) % self.every
    }
}

/// Vertices that were picked, in the order of the model.
///
/// Memory: a block; 16 bytes for each in a temporary file.
pub struct Picked {
    file: Scratch,
    buffer: Vec<Pick>,
    written: u64,
}

impl Picked {
    /// Empty list, whose file goes to `folder`.
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn new(folder: &Path) -> Result<Self> {
        let file = Scratch::new(folder, "do without the samples' colours, by --skip colors")?;
        Ok(Self { file, buffer: Vec::new(), written: 0 })
    }

    /// Adds the picks that come next in the model.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&mut self, picks: &[Pick]) -> Result<()> {
        self.buffer.extend_from_slice(picks);
        if self.buffer.len() >= BLOCK { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        self.file.write_at(cast_slice(&self.buffer), self.written * size_of::<Pick>() as u64)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Colours of all samples, which are at these local positions. `sample_of` has the sample of each vertex
    /// of the model, where that is known.
    ///
    /// # Errors
    /// The file cannot be written or read; the user cancelled.
    pub fn colors(
        mut self,
        picking: &Picking,
        positions: &[Vec3],
        sample_of: Option<&[u32]>,
        progress: &dyn Progress,
    ) -> Result<Vec<[u8; 3]>> {
        self.flush()?;
        let mut means = Means::new(positions, 0);
        let mut picks = vec![Pick::zeroed(); BLOCK];
        for first in (0..self.written).step_by(BLOCK) {
            progress.check()?;
            picks.truncate((self.written - first).min(BLOCK as u64) as usize);
            self.file.read_at(cast_slice_mut(&mut picks), first * size_of::<Pick>() as u64)?;
            let known = |i: usize| {
                let vertex = picking.vertex(first + i as u64);
                sample_of.and_then(|all| all.get(vertex as usize).copied())
            };
            means.add(&picks, known);
            looked_at(size_of::<u32>() * picks.len() * picking.every as usize);
        }
        Ok(means.colors())
    }
}

/// Sums over the vertices of each sample.
///
/// Memory: 16 bytes per sample, and their tree, of 16 bytes for each.
struct Means<'a> {
    positions: &'a [Vec3],
    tree: OnceLock<KdTree>,
    first: usize,
    /// Sums of red, green and blue, and the number of vertices.
    sums: Vec<[u32; 4]>,
}

impl<'a> Means<'a> {
    /// Sums for the samples from `first` on.
    fn new(positions: &'a [Vec3], first: usize) -> Self {
        Self { positions, tree: OnceLock::new(), first, sums: vec![[0; 4]; positions.len() - first] }
    }

    fn nearest(&self, p: Vec3) -> u32 {
        self.tree.get_or_init(|| KdTree::in_one_job(self.positions)).nearest(p)
    }

    /// Adds vertices, whose samples may be known.
    fn add(&mut self, picks: &[Pick], known: impl Fn(usize) -> Option<u32> + Sync) {
        let of = |(i, pick): (usize, &Pick)| {
            let nearest = || pick.position.is_finite().then(|| self.nearest(pick.position));
            known(i).or_else(nearest).unwrap_or(u32::MAX)
        };
        let places: Vec<u32> = picks.par_iter().enumerate().with_min_len(1024).map(of).collect();
        for (place, pick) in places.iter().zip(picks) {
            let Some(sum) = (*place as usize).checked_sub(self.first).and_then(|i| self.sums.get_mut(i))
            else {
                continue;
            };
            // More than fit would say the same.
            if sum[3] < u32::MAX / 256 {
                let [r, g, b, _] = pick.color;
                sum.iter_mut().zip([r, g, b, 1]).for_each(|(sum, value)| *sum += u32::from(value));
            }
        }
    }

    /// Mean colours of the samples; samples without a vertex get that of the nearest one that has some. Empty
    /// if no sample has a vertex.
    fn colors(&self) -> Vec<[u8; 3]> {
        let mean = |[r, g, b, n]: &[u32; 4]| (*n > 0).then(|| [r, g, b].map(|sum| ((sum + n / 2) / n) as u8));
        let known: Vec<_> = self.sums.iter().map(mean).collect();
        completed(&known, &self.positions[self.first..]).unwrap_or_default()
    }
}

/// The colours of the samples from `first` on, of those at these positions, by the vertices in some ranges of
/// the model; black if none of these has a position.
///
/// Memory: 16 bytes per sample, their tree, and a chunk.
///
/// # Errors
/// The model cannot be read; the user cancelled.
pub fn of_ranges(
    (positions, first): (&[Vec3], usize),
    frame: &Frame,
    model: &dyn Model,
    ranges: &[Range<u64>],
    progress: &dyn Progress,
) -> Result<Vec<[u8; 3]>> {
    let mut means = Means::new(positions, first);
    if let Some(colors) = ColorBytes::for_model(model)? {
        let picking = Picking { colors, every: 1 };
        let (mut chunk, mut lists, mut picks) = (VertexChunk::default(), ColorLists::default(), Vec::new());
        for range in ranges {
            let mut reader = model.vertices(range.clone())?;
            reader.set_chunk(SMALL_CHUNK);
            reader.skip_all_but_colors();
            while reader.read(&mut chunk)? {
                progress.check()?;
                picks.clear();
                picking.pick(model, frame, &chunk, &mut lists, &mut picks)?;
                means.add(&picks, |_| None);
            }
        }
    }
    let mut colors = means.colors();
    colors.resize(positions.len() - first, [0; 3]);
    Ok(colors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampling, Target, sample};
    use simod_model::progress::Silent;

    /// The rows of this model are as long as 20 runs of 15: the first of each run would be of 20 columns
    /// alone.
    #[test]
    fn colours_of_rows_are_those_around_each_sample() {
        const SIDE: usize = 300;
        let mut bytes = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
            SIDE * SIDE
        )
        .into_bytes();
        for i in 0..SIDE * SIDE {
            let at = [i % SIDE, i / SIDE].map(|x| x as f32 / (SIDE - 1) as f32);
            [at[0], at[1], 0.0].map(f32::to_le_bytes).iter().for_each(|number| bytes.extend(number));
            bytes.extend(at.map(|x| (255.0 * x).round() as u8));
            bytes.push(7);
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.ply");
        #[expect(clippy::disallowed_methods, reason = "a test's own file")]
        std::fs::write(&path, bytes).unwrap();
        let model = simod_model::open(&path).unwrap();
        // One of 15 vertices is picked.
        let sampling = Sampling { target: Target::Samples(750), ..Sampling::default() };
        let sampled = sample(model.as_ref(), &sampling, folder.path(), &Silent).unwrap();
        assert_eq!(sampled.colors.len(), sampled.samples.len());
        let off = |(p, color): (&Vec3, &[u8; 3])| {
            assert_eq!(color[2], 7);
            let p = sampled.frame.to_model(*p);
            (255.0 * p.x - f64::from(color[0])).abs()
        };
        let off: Vec<f64> = sampled.samples.positions.iter().zip(&sampled.colors).map(off).collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        println!("{} samples, off by {mean:.2} in the mean", off.len());
        assert!(mean < 1.5, "{mean}");
    }
}
