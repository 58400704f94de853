//! The colours of vertices that are shown in full.

/// The source of the colours of vertices that are shown in full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Tint {
    /// The samples to which the vertices belong.
    #[default]
    Samples,
    /// The vertices' own colours.
    Own,
    /// The vertices' attribute at this place in the model's list.
    Attribute(usize),
}
