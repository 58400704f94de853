//! The methods that are compared.

use simod_benches::peers::Peer;
use simod_core::reconstruction;

/// SIMOD's own, or another.
#[derive(Clone, Copy, PartialEq)]
pub enum Method {
    Simod(reconstruction::Method),
    Peer(Peer),
}

impl Method {
    /// SIMOD's, the default last.
    pub const SIMOD: [Self; 2] = [
        Self::Simod(reconstruction::Method::ProjectedBarycentric),
        Self::Simod(reconstruction::Method::BlendedJets),
    ];

    /// All of them, SIMOD's first.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::SIMOD.into_iter().chain(Peer::ALL.map(Self::Peer))
    }

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Simod(reconstruction::Method::ProjectedBarycentric) => "SIMOD, projected-barycentric",
            Self::Simod(reconstruction::Method::BlendedJets) => "SIMOD, blended-jets",
            Self::Peer(peer) => peer.name(),
        }
    }

    /// Whether the method needs triangles between the samples.
    pub fn needs_triangles(self) -> bool {
        matches!(self, Self::Peer(peer) if peer.needs_triangles())
    }
}
