//! STL: triangles without shared corners, binary and as text.
//!
//! Each facet has three vertices of its own. Corners that were equal stay equal, as a vertex goes where its
//! place goes. The normal of a facet that moved is computed anew from its corners, to the side that it was
//! on; one that is zero says that nobody computed it, and stays so. The header, the attribute bytes of each
//! facet, and in text all but numbers are kept, and so is every byte of a facet that did not move.

mod ascii;
mod binary;
mod facets;

use crate::source::SourceFile;
use crate::{Model, Result};

/// Opens a file that is STL by its content, or by its name.
pub(crate) fn open(source: SourceFile) -> Result<Box<dyn Model>> {
    if !binary::has_its_length(&source)? && ascii::is_text(&source)? {
        return ascii::open(source);
    }
    Ok(Box::new(binary::BinaryStl::new(source)?))
}

/// Whether the content of a file is STL.
pub(crate) fn is_stl(source: &SourceFile) -> Result<bool> {
    Ok(binary::has_its_length(source)? || ascii::is_text(source)?)
}
