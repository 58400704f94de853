//! The numbers that are shown on the surface, as they were found last.

use crate::overlay::{Overlay, ScalarField};
use crate::selection::Selection;
use simod_session::edit::Entry;
use std::sync::Arc;

/// The numbers of a version, as they were found last.
pub(super) struct VersionNumbers {
    pub key: FieldKey,
    pub field: ScalarField,
    /// The range of these numbers alone.
    pub range: [f32; 2],
}

/// State on which a field depends.
pub(super) struct FieldKey {
    pub overlay: Overlay,
    pub revision: u64,
    /// The other version's revision, and whether its positions are known for all samples; where versions
    /// are compared.
    pub other: Option<(u64, bool)>,
    pub selection: Selection,
    pub steps: Arc<[Entry]>,
    pub chosen: Option<usize>,
}
