//! The colours of vertices that are shown in full: their own numbers and colours, or those of their samples.

use crate::theme;
use simod_core::detail::Values;
use simod_viewer::Tint;
use simod_viewer::detail::DetailPiece;
use simod_viewer::overlay::OverlayScale;

/// The mixing of a colour with others.
#[derive(Debug, Clone, Copy)]
pub struct Mixing {
    /// The part of the colour that is left.
    keep: f32,
    /// Colour that is added.
    add: [f32; 3],
}

impl Mixing {
    /// The mixing that changes nothing.
    pub const NONE: Self = Self { keep: 1.0, add: [0.0; 3] };

    /// The same mixing with a share of another colour over it.
    pub fn with(self, color: [u8; 3], share: f32) -> Self {
        let add = |i: usize| self.add[i] * (1.0 - share) + f32::from(color[i]) * share;
        Self { keep: self.keep * (1.0 - share), add: [0, 1, 2].map(add) }
    }

    /// Mixed colour that a colour becomes.
    pub fn applied_to(self, color: [u8; 3]) -> [u8; 3] {
        std::array::from_fn(|i| (f32::from(color[i]) * self.keep + self.add[i]).round() as u8)
    }
}

/// The colours of vertices that are shown in full.
#[derive(Clone, Copy, Default)]
pub struct VertexColors<'a> {
    /// Colours that samples have, if they are not all the same.
    pub samples: Option<&'a [[u8; 3]]>,
    /// Mixing of each sample's colour, if any colour is mixed.
    pub mixing: Option<&'a [Mixing]>,
    /// Attribute or colour of the vertices themselves that is shown, and the colour scale of its numbers.
    pub tint: Tint,
    pub scale: Option<OverlayScale>,
}

impl<'a> VertexColors<'a> {
    /// Colours of vertices whose samples have these colours, not mixed.
    pub fn new(samples: Option<&'a [[u8; 3]]>, tint: Tint, scale: Option<OverlayScale>) -> Self {
        Self { samples, mixing: None, tint, scale }
    }

    /// Colours of all vertices of a piece: their own, as far as they came with it, or those of their samples.
    pub fn colors(&self, piece: &DetailPiece) -> Vec<[u8; 3]> {
        let batch = &piece.batch;
        let mixed = |(i, color): (usize, [u8; 3])| {
            let mixing = self.mixing.and_then(|all| all.get(batch.homes[i] as usize));
            mixing.map_or(color, |mixing| mixing.applied_to(color))
        };
        let is_theirs = piece.tint == self.tint;
        match (&batch.values, self.scale) {
            (Values::Colors(own), _) if is_theirs => own.iter().copied().enumerate().map(mixed).collect(),
            (Values::Numbers(all), Some(scale)) if is_theirs => {
                all.iter().map(|number| scale.color(*number)).enumerate().map(mixed).collect()
            }
            _ => {
                let of = |home: &u32| self.samples.and_then(|all| all.get(*home as usize)).copied();
                batch.homes.iter().map(|home| of(home).unwrap_or(theme::CLAY)).collect()
            }
        }
    }
}
