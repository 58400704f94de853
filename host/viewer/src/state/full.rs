//! Vertices of the model that are shown in full, or on their way.

use crate::detail::Detail;
use crate::engine::SamplePose;
use crate::tint::Tint;
use simod_core::detail::Streamed;

/// The vertices that are shown in full, or on their way.
#[derive(Default)]
pub(super) struct Preview {
    pub detail: Option<Detail>,
    pub streaming: Option<StreamedDetail>,
    /// Whether the user stopped the stream.
    pub stopped: bool,
    /// Figures of the last stream that came to its end, and its time in seconds.
    pub last: Option<(Streamed, f64)>,
}

/// The detail that is being streamed.
pub(super) struct StreamedDetail {
    pub request: u64,
    /// Request of the stream: the samples by which vertices are carried, the share of the vertices, and the
    /// source of their colours.
    pub pose: SamplePose,
    pub stride: u64,
    pub tint: Tint,
}
