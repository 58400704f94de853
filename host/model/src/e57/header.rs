//! Header of an E57 file: 48 bytes, with the place of the file's XML.

use std::ops::Range;

use super::pages::{CUT_OFF, DAMAGED, PAGE, PageWindow, logical};
use crate::Result;
use crate::source::SourceFile;

/// The first bytes.
pub(super) const MAGIC: &[u8] = b"ASTM-E57";

/// Bytes of the header.
pub(super) const LENGTH: u64 = 48;

/// Places of the header's numbers that are changed.
pub(super) mod at {
    pub const FILE_LENGTH: u64 = 16;
    pub const XML_PLACE: u64 = 24;
    pub const XML_LENGTH: u64 = 32;
}

/// Longest XML that is read, which bounds the memory for it and its tree.
const MOST_XML: u64 = 64 << 20;

/// The header's content.
#[derive(Debug)]
pub(super) struct E57Header {
    /// Version of the format.
    pub version: [u32; 2],
    /// The logical bytes of the XML.
    pub xml: Range<u64>,
}

impl E57Header {
    pub fn read(source: &SourceFile) -> Result<Self> {
        if source.len() < PAGE {
            let what = format!("{} bytes are less than the first page of E57", source.len());
            return Err(source.malformed(what, CUT_OFF));
        }
        let mut window = PageWindow::new(source, 1);
        let bytes = window.get(0..LENGTH)?;
        let number = |at: u64| u64::from_le_bytes(bytes_at(bytes, at as usize));
        let version = [8, 12].map(|at| u32::from_le_bytes(bytes_at(bytes, at)));
        let (length, place, xml) = (number(at::FILE_LENGTH), number(at::XML_PLACE), number(at::XML_LENGTH));
        let page = number(40);
        if version[0] != 1 {
            let what = format!("a file of E57 {}.{}", version[0], version[1]);
            return Err(source.malformed(what, "E57 1.0 can be read: export the model as such"));
        }
        if page != PAGE {
            let what = format!("the header says pages of {page} bytes, but E57 has pages of {PAGE}");
            return Err(source.malformed(what, DAMAGED));
        }
        if length != source.len() || length % PAGE != 0 {
            let what = format!("the header says {length} bytes, but the file has {}", source.len());
            return Err(source.malformed(what, CUT_OFF));
        }
        let end = length / PAGE * super::pages::PAYLOAD;
        let start = logical(place).filter(|start| *start >= LENGTH && place < length);
        let xml =
            start.and_then(|start| Some(start..start.checked_add(xml).filter(|behind| *behind <= end)?));
        let Some(xml) = xml else {
            let what = format!(
                "the XML is said to be at byte {place}, of {} bytes, but the file has {length}",
                number(at::XML_LENGTH)
            );
            return Err(source.malformed(what, DAMAGED));
        };
        if xml.end - xml.start > MOST_XML {
            let what = format!("XML of {} bytes, where {MOST_XML} are the most", xml.end - xml.start);
            return Err(source.malformed(what, "divide the file into several, with fewer scans each"));
        }
        Ok(Self { version, xml })
    }
}

/// `N` bytes from `at` on; zeros for those that are not there.
#[inline(always)]
pub(super) fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut result = [0; N];
    if let Some(there) = bytes.get(at..at + N) {
        result.copy_from_slice(there);
    }
    result
}
