//! Whether a library's file is all there, before the dynamic linker maps it (64-bit ELF, that is, on Linux; the
//! loaders of other systems check by themselves).

use simod_core::{Error, ErrorKind, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// An error where the file ends before something that its header announces. Other formats pass.
pub(super) fn check_complete(path: &Path) -> Result<()> {
    let io = |e: std::io::Error| Error::io("read", path, &e);
    let mut file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    match required_length(&mut file) {
        Ok(Some(required)) if required <= length => Ok(()),
        Ok(None) if !cfg!(target_os = "linux") => Ok(()),
        Ok(None) => Err(bad(format!("{} is no library", path.display()))),
        Ok(Some(required)) => {
            let what = format!("{} is cut off: {length} bytes instead of {required}", path.display());
            Err(bad(what))
        }
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            Err(bad(format!("{} is no library, or cut off", path.display())))
        }
        Err(e) => Err(io(e)),
    }
}

fn bad(what: String) -> Error {
    Error::new(ErrorKind::Plugin, what, "build or copy it again, or remove it from the plugin folder")
}

/// Where the last segment or table ends, in bytes; nothing for other formats.
fn required_length(file: &mut (impl Read + Seek)) -> std::io::Result<Option<u64>> {
    const CLASS_64_LITTLE_ENDIAN: [u8; 6] = [0x7f, b'E', b'L', b'F', 2, 1];
    let mut header = [0; 64];
    file.read_exact(&mut header)?;
    if header[..6] != CLASS_64_LITTLE_ENDIAN {
        return Ok(None);
    }
    let number = |bytes: &[u8]| bytes.iter().rev().fold(0_u64, |n, &b| n << 8 | u64::from(b));
    let (table, entry_size, entries) =
        (number(&header[32..40]), number(&header[54..56]), number(&header[56..58]));
    // The section headers come last in most files, and are announced as well.
    let sections = number(&header[40..48]);
    let sections_end =
        sections.saturating_add(number(&header[58..60]).saturating_mul(number(&header[60..62])));
    let mut required = table.saturating_add(entry_size * entries).max(sections_end);
    for i in 0..entries {
        let mut entry = [0; 56];
        file.seek(SeekFrom::Start(table.saturating_add(i * entry_size)))?;
        file.read_exact(&mut entry)?;
        let end = number(&entry[8..16]).saturating_add(number(&entry[32..40]));
        required = required.max(end);
    }
    Ok(Some(required))
}
