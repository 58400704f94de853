//! Parts that touch: a closed fist, lips, cloth on skin. Where a model has faces, the sheet of each sample is
//! told by how these connect the surface, however near two sheets come in space.
//!
//! While sampling reads the faces, `islands` finds the vertices that hang together in each cluster, and which
//! of these islands faces join. A place belongs to all faces there: most equal positions are found while the
//! vertices stream (`twins`), and where a cluster turns out to hold two sheets, the others are welded first
//! (`sorter`). Clusters that hold two sheets then are parted, one sample for each (`parting`). [`Contacts`]
//! keeps the sheets of the samples near such places, and those of the vertices that their position alone
//! would put on another one.
//!
//! Two sheets may also meet in clusters beside each other, of which each holds but one, as normals part them
//! first: there a sample has some among its nearest that faces do not join with it. Where there are none of
//! either, nothing is kept: the samples tell the sheets apart by themselves.

mod contacts;
mod finding;
mod islands;
mod pairs;
mod parting;
mod places;
mod sorter;
mod twins;

pub use contacts::Contacts;
pub(crate) use finding::{ContactVertices, Guides, InheritedSheets, crowded, meeting};
pub(crate) use islands::Islands;
pub(crate) use parting::{ClusterParts, Parted, Parting};
pub(crate) use twins::{FoundTwins, TwinSearch, Twins, may_be_there as twins_may_be_there};

/// Advice to the user where a temporary file has no room.
const ADVICE: &str = "do without them, by --skip sheets";
