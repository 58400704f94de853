//! The vertices that are shown in full, as the graphics card has them.

use super::seen::disc_radii;
use super::vertex_colors::VertexColors;
use crate::theme;
use glam::Vec3;
use simod_core::detail::DetailBatch;
use simod_scene::{BadSurface, Dot, Scene, SceneSurface};
use simod_viewer::Detail;
use simod_viewer::detail::DetailPiece;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The radius of a splat that is not drawn.
const HIDDEN: f32 = -1.0;

/// Pieces that the card has, by number, with the revision of each that is shown.
#[derive(Default)]
pub struct DetailPieces(BTreeMap<u64, u64>);

impl DetailPieces {
    /// Gives the card the pieces as they are now.
    ///
    /// # Errors
    /// Never an error for pieces that are whole.
    pub fn update(
        &mut self,
        scene: &mut Scene,
        detail: Option<&Detail>,
        colors: VertexColors<'_>,
        recolored: bool,
    ) -> Result<(), BadSurface> {
        let there = detail.map(Detail::pieces);
        let gone = |number: &u64| there.is_none_or(|pieces| !pieces.contains_key(number));
        for number in self.0.keys().copied().filter(gone).collect::<Vec<_>>() {
            scene.set_detail(number, None)?;
            self.0.remove(&number);
        }
        for (number, piece) in there.into_iter().flatten() {
            let known = self.0.insert(*number, piece.revision);
            if known == Some(piece.revision) && !recolored {
                continue;
            }
            let splats = splats(piece, colors);
            if known.is_some() {
                scene.set_detail_colors(*number, &splats.radii, Some(&splats.colors))?;
            } else {
                scene.set_detail(*number, Some(&splats.surface()))?;
            }
        }
        Ok(())
    }
}

/// A piece as it is drawn.
pub struct PieceSplats {
    batch: Arc<DetailBatch>,
    radii: Vec<f32>,
    colors: Vec<[u8; 3]>,
}

impl PieceSplats {
    /// Splats of the piece, as the renderer takes them.
    pub fn surface(&self) -> SceneSurface<'_> {
        SceneSurface {
            positions: &self.batch.positions,
            normals: &self.batch.normals,
            radii: &self.radii,
            axes: &self.batch.axes,
            colors: Some(&self.colors),
            triangles: &[],
        }
    }
}

/// A piece as it looks in these colours.
pub fn splats(piece: &DetailPiece, colors: VertexColors<'_>) -> PieceSplats {
    PieceSplats { batch: piece.batch.clone(), radii: radii(piece), colors: colors.colors(piece) }
}

fn radii(piece: &DetailPiece) -> Vec<f32> {
    let batch = &piece.batch;
    let long = |[long, _]: &[Vec3; 2]| if *long == Vec3::ZERO { HIDDEN } else { long.length() };
    let mut radii = match &batch.axes[..] {
        [] => disc_radii(&batch.spacing),
        axes => axes.iter().map(long).collect(),
    };
    for ((_, range), _) in batch.cells.iter().zip(&piece.shown).filter(|(_, shown)| !**shown) {
        radii[range.start as usize..range.end as usize].fill(HIDDEN);
    }
    radii
}

/// Radii of the samples' discs, or of the longer axes of their ellipses; negative where vertices are shown
/// instead.
pub fn sample_radii(spacing: &[f32], axes: &[[Vec3; 2]], detail: Option<&Detail>) -> Vec<f32> {
    let mut radii = disc_radii(spacing);
    radii.iter_mut().zip(axes).for_each(|(radius, [long, _])| *radius *= long.length());
    if let Some(detail) = detail {
        let covered = radii.iter_mut().zip(&**detail.covered()).filter(|(_, covered)| **covered);
        covered.for_each(|(radius, _)| *radius = HIDDEN);
    }
    radii
}

/// The radii of some samples, whose axes these are.
pub fn radii_of(some: &[u32], spacing: &[f32], axes: &[[Vec3; 2]], detail: Option<&Detail>) -> Vec<f32> {
    let mut radii = disc_radii(&some.iter().map(|i| spacing[*i as usize]).collect::<Vec<_>>());
    radii.iter_mut().zip(axes).for_each(|(radius, [long, _])| *radius *= long.length());
    if let Some(detail) = detail {
        let covered = detail.covered();
        let hidden = radii.iter_mut().zip(some).filter(|(_, i)| covered[**i as usize]);
        hidden.for_each(|(radius, _)| *radius = HIDDEN);
    }
    radii
}

/// Dots at samples in whose place vertices are shown.
pub fn sample_dots(positions: &[Vec3], detail: Option<&Detail>) -> Vec<Dot> {
    let covered = detail.map_or(&[][..], |detail| detail.covered());
    let dot = |position: &Vec3| Dot {
        position: *position,
        color: theme::SAMPLE_DOTS,
        size_px: theme::SAMPLE_DOT_SIZE,
        on_top: false,
    };
    positions.iter().zip(covered).filter(|(_, covered)| **covered).map(|(p, _)| dot(p)).collect()
}

/// Colours of samples beside vertices that are shown in full: the samples' own, mixed with a tint.
pub fn sample_colors(samples: usize, colors: Option<&[[u8; 3]]>) -> Vec<[u8; 3]> {
    let tinted = |color: [u8; 3]| theme::mixed(color, theme::SAMPLES, theme::SAMPLES_SHARE);
    match colors {
        Some(colors) => colors.iter().map(|color| tinted(*color)).collect(),
        None => vec![tinted(theme::CLAY); samples],
    }
}
