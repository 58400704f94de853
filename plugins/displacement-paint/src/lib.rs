//! Displacement painting: brush strokes that inflate, draw, grab, smooth, flatten, pinch and crease the
//! surface.
//!
//! The tool with which the paper's users finish (T. Boubekeur, O. Sorkine, C. Schlick, *SIMOD: Making
//! Freeform Deformation Size-Insensitive*, 2007, §6: "an inflating displacement tool"). The brushes are
//! those of today's sculpting programs. A dab reaches samples that are near in space and connected on the
//! same side of the surface; strokes are the same at any frame rate; and one more stroke costs that stroke,
//! as the result of those before is kept.

mod brush;
mod canvas;
mod grid;
mod paint;
mod path;
mod spot;
mod surface;

use brush::SetBrush;
use canvas::{Canvas, UnpaintedSamples};
use glam::Vec3;
use paint::{Painter, StrokeWorkspace};
use simod_plugin_api::{
    Consumes, DeformInput, Deformer, Descriptor, Host, IsIdentity, PluginError, PluginResult, PrepareInput,
    Samples,
};
use surface::LinkedSurface;

/// The plugin.
struct DisplacementPaint;

/// Surface on which strokes are painted.
struct PreparedSheets {
    surface: LinkedSurface,
    /// Area for which each sample stands, relative to the others; empty where that is not known.
    areas: Vec<f32>,
}

/// Canvas of the last call, and working memory.
#[derive(Default)]
struct PaintScratch {
    canvas: Option<Canvas>,
    work: StrokeWorkspace,
}

impl Deformer for DisplacementPaint {
    type State = PreparedSheets;
    type Scratch = PaintScratch;

    fn descriptor() -> Descriptor {
        let descriptor =
            Descriptor::new("displacement-paint", "Displacement painting", env!("CARGO_PKG_VERSION"))
                .summary("Brush strokes that inflate, draw, grab, smooth, flatten, pinch or crease")
                .citation("after the displacement painting of Boubekeur, Sorkine and Schlick, SIMOD, 2007")
                .consumes(Consumes { strokes: true, graph: true, normals: true, ..Consumes::default() });
        SetBrush::params().into_iter().fold(descriptor, Descriptor::param)
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedSheets> {
        let UnpaintedSamples { positions, normals } = rest(&input.samples);
        let graph = input.graph().filter(|g| g.len() == positions.len());
        let (Some(graph), true) = (graph, normals.len() == positions.len()) else {
            return Err(PluginError::internal("the host gave no neighbours or normals of the samples"));
        };
        let surface = LinkedSurface::new(positions, normals, graph, host)?;
        Ok(PreparedSheets { surface, areas: areas(input.samples.spacing()) })
    }

    fn deform(
        state: &PreparedSheets,
        input: &DeformInput<'_>,
        easel: &mut PaintScratch,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = rest(&input.samples);
        let count = state.surface.len();
        if [out.len(), rest.positions.len(), rest.normals.len()] != [count; 3] {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        let strokes = input.strokes();
        let anew = || Canvas::new(&state.surface, rest.positions, rest.normals);
        // The canvas is taken out of the scratch while it is worked on: a call that fails or panics leaves
        // nothing half done there.
        let mut work = std::mem::take(&mut easel.work);
        let kept = easel.canvas.take().filter(|canvas| canvas.is_of(&state.surface));
        let kept = kept.and_then(|mut canvas| {
            let done = canvas.take_back(strokes.iter().map(|s| s.key))?;
            Some((canvas, done))
        });
        let (mut canvas, done) = kept.unwrap_or_else(|| (anew(), 0));
        let painter = Painter { surface: &state.surface, rest, areas: &state.areas };
        for (i, stroke) in strokes.iter().enumerate().skip(done) {
            host.progress(i as f64 / strokes.len() as f64)?;
            painter.stroke(&mut canvas, &mut work, stroke, host)?;
            canvas.finish(stroke.key);
        }
        out.copy_from_slice(bytemuck::cast_slice(&canvas.positions));
        *easel = PaintScratch { canvas: Some(canvas), work };
        Ok(())
    }
}

impl IsIdentity for DisplacementPaint {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(input.strokes().iter().all(|s| s.strength == 0.0))
    }
}

fn rest<'a>(samples: &Samples<'a>) -> UnpaintedSamples<'a> {
    UnpaintedSamples {
        positions: bytemuck::cast_slice::<_, Vec3>(samples.positions()),
        normals: bytemuck::cast_slice::<_, Vec3>(samples.normals()),
    }
}

/// Areas for which samples at such distances from each other stand, relative to the largest ordinary one:
/// at most 1.
fn areas(spacing: &[f32]) -> Vec<f32> {
    /// Multiple of the median spacing beyond which a sample is not ordinary.
    const ORDINARY: f32 = 4.0;
    let mut sorted = spacing.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let Some(&median) = sorted.get(sorted.len() / 2).filter(|m| **m > 0.0) else { return Vec::new() };
    spacing.iter().map(|s| (s / (ORDINARY * median)).min(1.0).powi(2)).collect()
}

simod_plugin_api::export_plugin!(DisplacementPaint, is_identity);

#[cfg(test)]
mod tests;
