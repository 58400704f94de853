//! Facts about a library that can be told without running any of its code: whether its file is all there, and
//! which kind of plugin it is. Loading runs its initialisers, and the dynamic linker of Linux maps a file
//! that was cut off without a complaint: the process then dies on touching it.

use object::read::macho::{FatArch, MachOFatFile32, MachOFatFile64};
use object::{
    Architecture, BinaryFormat, File, FileKind, Object, ObjectSegment, ObjectSymbol, ReadCache, ReadCacheOps,
    ReadRef,
};
use simod_model::{Error, Result, input};
use std::path::Path;

/// Interface by which a plugin is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EntryPoint {
    /// The library exports the root module of the interface's crate.
    Rust,
    /// The library exports the table that `simod_plugin.h` describes.
    C,
}

/// Symbol that each kind of plugin exports: by the name that `export_plugin!` gives, and by that of the
/// header.
const SYMBOLS: [(&str, EntryPoint); 2] =
    [("_1as_0lib_1header_0root_bmodule_bloader", EntryPoint::Rust), ("simod_plugin_entry", EntryPoint::C)];

/// The libraries of this system.
const NATIVE: BinaryFormat = if cfg!(windows) {
    BinaryFormat::Pe
} else if cfg!(target_vendor = "apple") {
    BinaryFormat::MachO
} else {
    BinaryFormat::Elf
};

/// The kind of plugin that a library is; an error if it is none, not all there, or for another system.
pub(super) fn kind(path: &Path) -> Result<EntryPoint> {
    let file = input::open(path)?;
    // The cache keeps the bytes that are read: headers and symbols, not the code.
    let cache = ReadCache::new(file);
    let (what, hint) = match FileKind::parse(&cache) {
        Err(_) => ("is no library", "build or copy it again, or remove it from the plugin folder"),
        Ok(format) => match contents(&cache, format) {
            None => ("is cut off, or damaged", "build or copy it again, or remove it from the plugin folder"),
            Some((format, _)) if format != NATIVE => (
                "is no library for this system",
                "build it for this one, or remove it from the plugin folder",
            ),
            Some((_, None)) => ("is no SIMOD plugin", "remove it from the plugin folder"),
            Some((_, Some(kind))) => return Ok(kind),
        },
    };
    Err(Error::plugin(format!("{} {what}", path.display()), hint))
}

/// Whether a plugin in Rust was built with `panic = "abort"`; none where that cannot be told.
///
/// Panics are unwound by a library of which the plugin imports functions: a plugin whose panics unwind
/// imports the function that begins the unwinding. One that aborts imports only the others, by which it finds
/// out where it was.
pub fn aborts_on_panic(path: &Path) -> Option<bool> {
    let cache = ReadCache::new(std::fs::File::open(path).ok()?);
    let file = File::parse(cache.range(0, cache.len().ok()?)).ok()?;
    let has =
        |symbol: &[u8]| file.dynamic_symbols().any(|s| s.is_undefined() && s.name_bytes() == Ok(symbol));
    let is_rust = file.exports().ok()?.iter().any(|e| e.name() == SYMBOLS[0].0.as_bytes());
    let unwinder_is_elsewhere = has(b"_Unwind_Backtrace") || has(b"_Unwind_Resume");
    (is_rust && file.format() == BinaryFormat::Elf && unwinder_is_elsewhere)
        .then(|| !has(b"_Unwind_RaiseException"))
}

/// Format of a library, and the kind of plugin it is, if any; none if a part of the file is missing.
fn contents(
    data: &ReadCache<impl ReadCacheOps>,
    format: FileKind,
) -> Option<(BinaryFormat, Option<EntryPoint>)> {
    let all = data.len().ok()?;
    let ours = match format {
        // macOS has libraries for several processors in one file.
        FileKind::MachOFat32 => range_of_ours(MachOFatFile32::parse(data).ok()?.arches()),
        FileKind::MachOFat64 => range_of_ours(MachOFatFile64::parse(data).ok()?.arches()),
        _ => Some((0, all)),
    };
    // In a file without a library for this processor, the dynamic linker knows what to say.
    let Some((start, length)) = ours else { return Some((BinaryFormat::MachO, Some(EntryPoint::C))) };
    if start.checked_add(length)? > all {
        return None;
    }
    contents_of_one(data.range(start, length))
}

/// Range of the library for this processor among several, in bytes: start and length.
fn range_of_ours(arches: &[impl FatArch]) -> Option<(u64, u64)> {
    let ours = if cfg!(target_arch = "aarch64") { Architecture::Aarch64 } else { Architecture::X86_64 };
    arches.iter().find(|arch| arch.architecture() == ours).map(FatArch::file_range)
}

/// Format and kind as of [`contents`], of a single library.
fn contents_of_one<'a, R: ReadRef<'a>>(data: R) -> Option<(BinaryFormat, Option<EntryPoint>)> {
    let (file, length) = (File::parse(data).ok()?, data.len().ok()?);
    let is_there = |(start, size): (u64, u64)| start.checked_add(size).is_some_and(|end| end <= length);
    if !file.segments().all(|segment| is_there(segment.file_range())) {
        return None;
    }
    let exports = file.exports().ok()?;
    // Before the names of C, macOS has an underscore.
    let prefix: &[u8] = if file.format() == BinaryFormat::MachO { b"_" } else { b"" };
    let has = |symbol: &str| exports.iter().any(|e| e.name().strip_prefix(prefix) == Some(symbol.as_bytes()));
    let kind = SYMBOLS.iter().find(|(symbol, _)| has(symbol)).map(|(_, kind)| *kind);
    Some((file.format(), kind))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    const ARM: u32 = 0x0100_000c;
    const INTEL: u32 = 0x0100_0007;

    /// A library of macOS for a processor that exports a symbol, and nothing else: header, table of symbols,
    /// dynamic one.
    fn mach_o(processor: u32, symbol: &str) -> Vec<u8> {
        let strings = format!("\0{symbol}\0");
        let (symbols, text) = (32 + 24 + 80, 32 + 24 + 80 + 16);
        let mut words = vec![0xfeed_facf, processor, 0, 6, 2, 24 + 80, 0, 0];
        words.extend([2, 24, symbols, 1, text, strings.len() as u32]);
        words.extend([0xb, 80, 0, 0, 0, 1]);
        words.extend([0; 14]);
        // In the first section, external.
        words.extend([1, 0x010f, 0, 0]);
        words.iter().flat_map(|word| word.to_le_bytes()).chain(strings.into_bytes()).collect()
    }

    /// Several libraries of macOS in one file.
    fn fat(libraries: &[(u32, Vec<u8>)]) -> Vec<u8> {
        let mut words = vec![0xcafe_babe, libraries.len() as u32];
        let mut start = 8 + 20 * libraries.len() as u32;
        for (processor, library) in libraries {
            words.extend([*processor, 0, start, library.len() as u32, 0]);
            start += library.len() as u32;
        }
        let all = libraries.iter().flat_map(|(_, library)| library.clone());
        words.iter().flat_map(|word| word.to_be_bytes()).chain(all).collect()
    }

    fn look_at(bytes: &[u8]) -> Option<(BinaryFormat, Option<EntryPoint>)> {
        contents(&ReadCache::new(Cursor::new(bytes)), FileKind::parse(bytes).unwrap())
    }

    #[test]
    fn libraries_of_macos_are_told_apart() {
        let (ours, other) = if cfg!(target_arch = "aarch64") { (ARM, INTEL) } else { (INTEL, ARM) };
        let plugin = mach_o(ours, "_simod_plugin_entry");
        let stranger = mach_o(other, "_somebody");
        assert_eq!(look_at(&plugin), Some((BinaryFormat::MachO, Some(EntryPoint::C))));
        let rust = mach_o(ours, "__1as_0lib_1header_0root_bmodule_bloader");
        assert_eq!(look_at(&rust), Some((BinaryFormat::MachO, Some(EntryPoint::Rust))));
        assert_eq!(look_at(&stranger), Some((BinaryFormat::MachO, None)));
        let both = fat(&[(other, stranger), (ours, plugin.clone())]);
        assert_eq!(look_at(&both), Some((BinaryFormat::MachO, Some(EntryPoint::C))));
        for cut in [plugin.len() - 40, both.len() - 4] {
            assert_eq!(
                look_at(if cut < plugin.len() { &plugin[..cut] } else { &both[..cut] }),
                None,
                "{cut}"
            );
        }
    }
}
