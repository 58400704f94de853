//! Painting a stroke, dab by dab.
//!
//! Draw, inflate, pinch and crease move the surface as it was when the stroke began: a sample feels the
//! greatest weight that any part of the stroke has for it, as a brush that is drawn along sweeps a capsule.
//! So a stroke is even however it was divided, and crosses itself without a lump. If they accumulate, as
//! smooth and flatten always do, each dab acts on the result of the dabs before, and counts by the length
//! of path that it stands for: the limit of many dabs is a line integral.
//!
//! Normals are derived anew after every step that moved something: strokes over strokes bulge in the
//! direction of the present surface.

use crate::brush::{Brush, SetBrush, Under};
use crate::canvas::{Canvas, UnpaintedSamples};
use crate::path::{self, IMAGES};
use crate::spot::{BrushShape, DabSweep, Felt, Finder, Spot, SurfaceWays};
use crate::surface::LinkedSurface;
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult, Stroke};

/// Length over which the smooth brush evens out at full strength, in radii of the brush.
const SMOOTH_LENGTH: f64 = 0.2;
/// Greatest number of passes of smoothing for a dab: where samples are so dense that more would be due, the
/// dab smooths less.
const MOST_PASSES: f64 = 12.0;
/// The largest part of the way to the neighbours' mean in one pass.
const STABLE: f64 = 0.5;
/// Negative logarithm of the part of the distance to the plane that a full stroke leaves.
const FLATTEN: f64 = 2.0;

/// Number of samples that are smoothed at once on one thread.
const BLOCK: usize = 512;

/// Working memory, kept from stroke to stroke.
#[derive(Default)]
pub struct StrokeWorkspace {
    reach: SurfaceWays,
    felt: Vec<Felt>,
    /// Pushes of a dab and its mirror images, each by itself.
    pushed: Vec<Pushed>,
    /// Pushes of a dab and its mirror images, each sample once.
    pushes: Vec<Push>,
    /// Weight of the stroke that each sample has felt so far, and the displacement by that; 0 between
    /// strokes.
    covered: Vec<f64>,
    offsets: Vec<DVec3>,
    moved: Vec<u32>,
}

/// Push of one image of a dab on a sample.
#[derive(Debug, Clone, Copy)]
struct Pushed {
    sample: u32,
    image: u8,
    weight: f64,
    by: DVec3,
}

/// The push of a dab on a sample, with all its images.
#[derive(Debug, Clone, Copy)]
struct Push {
    sample: u32,
    weight: f64,
    by: DVec3,
}

/// One value for each mirror image that there is.
type Images<T> = [Option<T>; IMAGES];

/// Paints on a canvas.
pub struct Painter<'a> {
    /// The samples' links.
    pub surface: &'a LinkedSurface,
    /// The samples before anything was painted.
    pub rest: UnpaintedSamples<'a>,
    /// Area for which each sample stands, relative to the others; or none.
    pub areas: &'a [f32],
}

impl Painter<'_> {
    /// Paints one stroke.
    pub fn stroke(
        &self,
        canvas: &mut Canvas,
        work: &mut StrokeWorkspace,
        stroke: &Stroke<'_>,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let tool = SetBrush::from_stroke(stroke)?;
        if tool.radius.is_nan() || tool.radius <= 0.0 {
            return Ok(());
        }
        let points = stroke.points();
        let mut dabs = path::dabs(stroke, tool.spacing * tool.radius)?;
        let mut grab = DVec3::ZERO;
        if let (Brush::Grab, [first, .., last]) = (tool.brush, points) {
            grab = DVec3::from(*last) - DVec3::from(*first);
            dabs.truncate(1);
            // A pen's pressure is 0 where it touches down.
            dabs[0].pressure = 1.0;
        }
        work.covered.resize(self.surface.len(), 0.0);
        work.offsets.resize(self.surface.len(), DVec3::ZERO);
        // Sweeps are on the present surface: all spots are known beforehand.
        let all = if tool.sweeps() { &dabs[..] } else { &[] };
        let mut spots: Vec<Images<Spot>> = Vec::with_capacity(all.len());
        for dab in all {
            host.progress(0.0)?;
            spots.push(self.spots(canvas, work, &tool, dab));
        }
        for (k, dab) in dabs.iter().enumerate() {
            host.progress(0.0)?;
            if tool.sweeps() {
                let (before, after) = (k.checked_sub(1).map(|k| &spots[k]), spots.get(k + 1));
                let sweep = |image: usize| {
                    let other = |spots: Option<&'_ Images<Spot>>| spots.and_then(|s| s[image]);
                    let spot = spots[k][image]?;
                    Some((spot, DabSweep::between(other(before).as_ref(), &spot, other(after).as_ref())))
                };
                self.gather(canvas, work, &tool, grab, &std::array::from_fn(sweep), host)?;
            } else {
                let round = self.spots(canvas, work, &tool, dab);
                let round = round.map(|s| s.map(|s| (s, DabSweep::round(&s))));
                self.gather(canvas, work, &tool, grab, &round, host)?;
            }
            self.push(canvas, work, &tool, tool.exposure() * dab.share, host)?;
        }
        self.shift_covered(canvas, work, host)
    }

    /// Applies the gathered pushes of a dab to the canvas, with this share of the stroke's exposure.
    /// Brushes that do not accumulate only note by how much they cover each sample.
    fn push(
        &self,
        canvas: &mut Canvas,
        work: &mut StrokeWorkspace,
        tool: &SetBrush<'_>,
        share: f64,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        match tool.brush {
            Brush::Smooth => self.smooth(canvas, work, tool, share, host),
            Brush::Flatten => {
                self.shift(canvas, work, |w| relaxed(FLATTEN * tool.strength * share * w), host)
            }
            Brush::Grab => self.shift(canvas, work, |w| w, host),
            _ if tool.accumulate => self.shift(canvas, work, |w| share * w, host),
            _ => {
                cover(work);
                Ok(())
            }
        }
    }

    /// Moves the samples that the stroke covered, once all its dabs are known.
    fn shift_covered(
        &self,
        canvas: &mut Canvas,
        work: &mut StrokeWorkspace,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        for &i in &work.moved {
            let i = i as usize;
            canvas.shift(i, std::mem::take(&mut work.offsets[i]));
            work.covered[i] = 0.0;
        }
        canvas.refresh_normals(self.surface, &self.rest, &work.moved, host)?;
        work.moved.clear();
        Ok(())
    }

    /// Spots of a dab and its mirror images on the surface.
    fn spots(
        &self,
        canvas: &Canvas,
        work: &mut StrokeWorkspace,
        tool: &SetBrush<'_>,
        dab: &path::Dab,
    ) -> Images<Spot> {
        let mut spots = [None; IMAGES];
        for image in tool.symmetry.images() {
            let p = tool.symmetry.point(dab.at, image);
            spots[image] = self.finder().spot(canvas, &mut work.reach, p, dab.pressure, tool.radius);
        }
        spots
    }

    /// Gathers the pushes of a dab and its mirror images on each sample under them: the mean of their
    /// displacements, and the greatest of their weights.
    fn gather(
        &self,
        canvas: &Canvas,
        work: &mut StrokeWorkspace,
        tool: &SetBrush<'_>,
        grab: DVec3,
        dabs: &Images<(Spot, DabSweep)>,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let falloff = |t: f64| tool.falloff(t);
        let both_sides = tool.brush == Brush::Grab;
        let shape = BrushShape { radius: tool.radius, falloff: &falloff, both_sides };
        work.pushed.clear();
        for (image, dab) in dabs.iter().enumerate() {
            let Some((spot, sweep)) = dab else { continue };
            self.finder().felt(canvas, &mut work.reach, sweep, &shape, &mut work.felt, host)?;
            let grab = tool.symmetry.vector(grab, image);
            for Felt { sample, weight, to_path, normal } in &work.felt {
                let (p, n) = (canvas.positions[*sample as usize], canvas.normals[*sample as usize]);
                let to_plane = spot.origin - p.as_dvec3();
                let under = Under { normal: *normal, towards: *to_path, to_plane, grab };
                let by = tool.displacement(n.as_dvec3(), &under);
                work.pushed.push(Pushed { sample: *sample, image: image as u8, weight: *weight, by });
            }
        }
        work.pushes.clear();
        if tool.symmetry.axes.any() {
            work.pushed.sort_unstable_by_key(|p| (p.sample, p.image));
        }
        work.pushes.extend(work.pushed.chunk_by(|a, b| a.sample == b.sample).map(Push::sum));
        Ok(())
    }

    fn finder(&self) -> Finder<'_> {
        Finder { surface: self.surface, areas: self.areas }
    }

    /// Moves samples by their pushes, by the part that `amount` makes of each one's weight.
    fn shift(
        &self,
        canvas: &mut Canvas,
        work: &mut StrokeWorkspace,
        amount: impl Fn(f64) -> f64,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        for push in &work.pushes {
            canvas.shift(push.sample as usize, amount(push.weight) * push.by);
        }
        self.refresh(canvas, work, host)
    }

    /// Lowers the curvature by steps of its flow, along the normals: samples do not slide on the surface,
    /// whatever their density, so that details are neither drawn together nor apart.
    ///
    /// M. Desbrun, M. Meyer, P. Schröder, A. H. Barr, Implicit fairing of irregular meshes using diffusion
    /// and curvature flow, SIGGRAPH 1999; the Laplacian is that of the links, in units of their mean squared
    /// length.
    fn smooth(
        &self,
        canvas: &mut Canvas,
        work: &mut StrokeWorkspace,
        tool: &SetBrush<'_>,
        share: f64,
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let time = (SMOOTH_LENGTH * tool.radius).powi(2) * tool.strength.max(0.0) * share;
        let steps = |canvas: &Canvas, push: &Push| {
            let (_, square) = self.bump(canvas, push.sample as usize);
            if square > 0.0 { 4.0 * time * push.weight / square } else { 0.0 }
        };
        host.parallel_blocks(&mut work.pushes, BLOCK, |_, pushes| {
            pushes.iter_mut().for_each(|push| push.weight = steps(canvas, push));
        })?;
        let most = work.pushes.iter().map(|p| p.weight).fold(0.0, f64::max);
        let passes = (most / STABLE).ceil().min(MOST_PASSES);
        for _ in 0..passes as usize {
            host.parallel_blocks(&mut work.pushes, BLOCK, |_, pushes| {
                for push in pushes {
                    let (height, _) = self.bump(canvas, push.sample as usize);
                    push.by = (push.weight / passes).min(STABLE) * height;
                }
            })?;
            work.pushes.iter().for_each(|push| canvas.shift(push.sample as usize, push.by));
        }
        self.refresh(canvas, work, host)
    }

    /// Mean height of the samples beside one above it, along its normal, and their mean squared distance.
    fn bump(&self, canvas: &Canvas, i: usize) -> (DVec3, f64) {
        let (p, n) = (canvas.positions[i], canvas.normals[i].as_dvec3());
        let beside = self.surface.beside(i);
        let (mut sum, mut square) = (DVec3::ZERO, 0.0);
        for &j in beside {
            let d = (canvas.positions[j as usize] - p).as_dvec3();
            (sum, square) = (sum + d, square + d.length_squared());
        }
        let count = beside.len().max(1) as f64;
        (n * (sum.dot(n) / count), square / count)
    }

    fn refresh(&self, canvas: &mut Canvas, work: &mut StrokeWorkspace, host: &Host<'_>) -> PluginResult<()> {
        work.moved.extend(work.pushes.iter().map(|push| push.sample));
        canvas.refresh_normals(self.surface, &self.rest, &work.moved, host)?;
        work.moved.clear();
        Ok(())
    }
}

/// Adds the part of a dab's weights that exceeds the weights of all dabs before.
fn cover(work: &mut StrokeWorkspace) {
    for push in &work.pushes {
        let i = push.sample as usize;
        let more = push.weight - work.covered[i];
        if more > 0.0 {
            if work.covered[i] == 0.0 {
                work.moved.push(push.sample);
            }
            work.covered[i] = push.weight;
            work.offsets[i] += more * push.by;
        }
    }
}

/// Part of the way that is gone after a time, if the rest decreases steadily; away from the target where
/// the time is negative.
fn relaxed(time: f64) -> f64 {
    (1.0 - (-time.abs()).exp()).copysign(time)
}

impl Push {
    /// Sum of all images of a dab that a sample feels.
    fn sum(images: &[Pushed]) -> Self {
        let sample = images[0].sample;
        if let [only] = images {
            return Self { sample, weight: only.weight, by: only.by };
        }
        let (mut weights, mut sums) = ([0.0; IMAGES], [DVec3::ZERO; IMAGES]);
        for p in images {
            weights[p.image as usize] = p.weight;
            sums[p.image as usize] = p.weight * p.by;
        }
        let weight = weights.iter().copied().fold(0.0, f64::max);
        Self { sample, weight, by: path::sum(sums) / path::sum(weights) }
    }
}
