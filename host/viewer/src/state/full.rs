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
    /// The user stopped it.
    pub stopped: bool,
    /// The last that was streamed to its end, and how long it took.
    pub last: Option<(Streamed, f64)>,
}

/// The detail that is being streamed.
pub(super) struct StreamedDetail {
    pub request: u64,
    /// By what samples, one of how many vertices, and with what.
    pub pose: SamplePose,
    pub stride: u64,
    pub tint: Tint,
}
