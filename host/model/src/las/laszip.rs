//! Blocks of compressed points (LASzip calls them chunks): each begins anew, so that any can be read alone.

use std::cell::Cell;
use std::io::{Cursor, Read, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

use laz::record::{
    LayeredPointRecordCompressor, LayeredPointRecordDecompressor, RecordCompressor, RecordDecompressor,
    SequentialPointRecordCompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItem, LazItemRecordBuilder, LazItemType, LazVlr, LazVlrBuilder};

use super::header::{LasHeader, bytes_at};

/// Compression of a file's points, from its VLR.
#[derive(Debug)]
pub(super) struct Laszip {
    items: Vec<LazItem>,
    /// Bytes of a point's record.
    record: usize,
    /// Whether each number of the record is compressed apart from the others (LASzip 3 and later).
    pub is_layered: bool,
    /// Number of lengths of layers behind the first point of a block.
    layers: usize,
    /// Lengths of the blocks in points.
    pub blocks: BlockLengths,
}

/// Parts of compressed points that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LayerChoice {
    All,
    /// Positions, and all that is decompressed in the same time: in layers, the other numbers are passed
    /// over.
    Positions,
    /// Positions, and colours.
    Colors,
}

/// Numbers of points in the blocks of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BlockLengths {
    /// All points in one block.
    One,
    /// The same number of points in each block but the last.
    Fixed(u32),
    /// Numbers of points that a table lists.
    Variable,
}

impl Laszip {
    /// Reads the content of the VLR; an error tells the fault in words.
    pub fn new(vlr: &[u8], header: &LasHeader) -> Result<Self, String> {
        let parsed = LazVlr::from_buffer(vlr).map_err(|e| e.to_string())?;
        let [compressor, coder] = [0, 2].map(|at| u16::from_le_bytes(bytes_at(vlr, at)));
        let kinds = |items: &[LazItem]| items.iter().map(LazItem::item_type).collect::<Vec<_>>();
        let expected =
            LazItemRecordBuilder::default_for_point_format_id(header.format, header.extra_bytes() as u16);
        let expected = expected.map(|items| kinds(&items)).map_err(|e| e.to_string())?;
        let items = parsed.items().clone();
        if kinds(&items) != expected {
            return Err(format!("it lists {:?}, where the points are {expected:?}", kinds(&items)));
        }
        // The library forgets to clear the upper byte of a former colour.
        if items.iter().any(|item| (item.item_type(), item.version()) == (LazItemType::RGB12, 1)) {
            return Err("colours of the first version of LASzip are not read as they are".to_owned());
        }
        let is_layered = match compressor {
            1 | 2 => false,
            3 => true,
            other => return Err(format!("it has the unknown compressor {other}")),
        };
        if coder != 0 {
            return Err(format!("it has the unknown coder {coder}"));
        }
        let blocks = match parsed.chunk_size() {
            _ if compressor == 1 => BlockLengths::One,
            u32::MAX => BlockLengths::Variable,
            size => BlockLengths::Fixed(size),
        };
        let layers = items.iter().map(|item| match item.item_type() {
            LazItemType::Point14 => 9,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(count) => usize::from(count),
            _ => 1,
        });
        let this = Self { layers: layers.sum(), items, record: header.record, is_layered, blocks };
        let known = this.decompressor(Cursor::new(&[][..])).map_err(|e| e.to_string())?;
        let record = known.record_size();
        if record != header.record {
            return Err(format!("it describes points of {record} bytes, but they have {}", header.record));
        }
        this.compress(&[]).map_err(|e| e.to_string())?;
        Ok(this)
    }

    /// Compression for points of a format with so many extra bytes, in blocks of so many points, and the
    /// content of the VLR that describes it.
    pub fn anew(format: u8, extra: u16, block: u32) -> laz::Result<(Self, Vec<u8>)> {
        let items = LazItemRecordBuilder::default_for_point_format_id(format, extra)?;
        let vlr = LazVlrBuilder::new(items.clone()).with_fixed_chunk_size(block).build();
        let mut bytes = Vec::new();
        vlr.write_to(&mut bytes)?;
        let record = vlr.items_size() as usize;
        // A compression that only writes does not use its number of layers.
        Ok((
            Self { items, record, is_layered: format >= 6, layers: 0, blocks: BlockLengths::Fixed(block) },
            bytes,
        ))
    }

    fn decompressor<'a, R: Read + Seek + 'a>(
        &self,
        from: R,
    ) -> laz::Result<Box<dyn RecordDecompressor<R> + 'a>> {
        Ok(if self.is_layered {
            let mut all = LayeredPointRecordDecompressor::new(from);
            all.set_fields_from(&self.items)?;
            Box::new(all)
        } else {
            let mut all = SequentialPointRecordDecompressor::new(from);
            all.set_fields_from(&self.items)?;
            Box::new(all)
        })
    }

    /// Decompresses a block into `records`; an error tells the fault in words.
    pub fn decompress(&self, block: &[u8], records: &mut [u8], what: LayerChoice) -> Result<(), String> {
        if records.is_empty() {
            return Ok(());
        }
        if self.is_layered {
            self.check_layers(block, records.len() / self.record)?;
        }
        let work = || {
            let mut decompressor = self.decompressor(Cursor::new(block)).map_err(|e| e.to_string())?;
            let positions = DecompressionSelection::xy_returns_channel().decompress_z();
            match what {
                LayerChoice::All => {}
                LayerChoice::Positions => decompressor.set_selection(positions),
                LayerChoice::Colors => decompressor.set_selection(positions.decompress_rgb()),
            }
            decompressor.decompress_many(records).map_err(|e| e.to_string())
        };
        unless_it_panics(work)
    }

    /// An error where layers are longer than the block: so much would be allocated for them.
    fn check_layers(&self, block: &[u8], points: usize) -> Result<(), String> {
        let (count, length) = self.layers_of(block).ok_or("it is too short")?;
        if length > block.len() as u64 {
            return Err(format!("it says that it has {length} bytes, but has {}", block.len()));
        }
        if count as usize != points {
            return Err(format!("it says that it has {count} points, but the table of blocks says {points}"));
        }
        Ok(())
    }

    /// Number of points and of bytes that a layered block declares in its first bytes.
    fn layers_of(&self, start: &[u8]) -> Option<(u32, u64)> {
        let lengths = start.get(self.record + 4..self.head_bytes())?;
        let count = u32::from_le_bytes(bytes_at(start, self.record));
        let length = |bytes: &[u8]| u64::from(u32::from_le_bytes(bytes_at(bytes, 0)));
        Some((count, self.head_bytes() as u64 + lengths.chunks_exact(4).map(length).sum::<u64>()))
    }

    /// Bytes of a layered block before its layers.
    fn head_bytes(&self) -> usize {
        self.record + 4 + 4 * self.layers
    }

    /// Number of points and of bytes of the block that `from` is at the beginning of, if it has at most so
    /// many points; `from` is read no further than needed.
    ///
    /// The error tells the fault in words.
    pub fn measure<R: Read + Seek>(&self, mut from: R, most: u64) -> Result<(u64, u64), String> {
        if self.is_layered {
            let mut head = vec![0; self.head_bytes()];
            from.read_exact(&mut head).map_err(|e| e.to_string())?;
            let (count, length) = self.layers_of(&head).ok_or("it is too short")?;
            return Ok((u64::from(count), length));
        }
        let start = from.stream_position().map_err(|e| e.to_string())?;
        let work = || {
            let mut decompressor = self.decompressor(&mut from).map_err(|e| e.to_string())?;
            let mut point = vec![0; self.record];
            for _ in 0..most {
                decompressor.decompress_next(&mut point).map_err(|e| e.to_string())?;
            }
            Ok(())
        };
        unless_it_panics(work)?;
        let end = from.stream_position().map_err(|e| e.to_string())?;
        Ok((most, end - start))
    }

    /// The bytes of a block of these records.
    pub fn compress(&self, records: &[u8]) -> laz::Result<Vec<u8>> {
        let to = Vec::with_capacity(records.len() / 2);
        if self.is_layered {
            let mut all = LayeredPointRecordCompressor::new(to);
            all.set_fields_from(&self.items)?;
            all.compress_many(records)?;
            all.done()?;
            Ok(all.into_inner())
        } else {
            let mut all = SequentialPointRecordCompressor::new(to);
            all.set_fields_from(&self.items)?;
            all.compress_many(records)?;
            all.done()?;
            Ok(all.into_inner())
        }
    }
}

thread_local! {
    /// Whether a panic of this thread comes of the file's content, and not of a fault of the program.
    static MAY_PANIC: Cell<bool> = const { Cell::new(false) };
}

/// Calls `work`, in which the library panics where its tables have no entry, as of bytes that are no
/// compressed points: a panic is an error here, without a message.
fn unless_it_panics(work: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !MAY_PANIC.get() {
                hook(panic);
            }
        }));
    });
    MAY_PANIC.set(true);
    let done = catch_unwind(AssertUnwindSafe(work));
    MAY_PANIC.set(false);
    done.unwrap_or_else(|_| Err("its bytes mean nothing".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_the_library_is_an_error_without_a_message() {
        // The message goes to standard error, which another process can look at.
        const CHILD: &str = "SIMOD_TEST_OF_PANICS";
        if std::env::var_os(CHILD).is_some() {
            assert!(unless_it_panics(|| panic!("no entry")).is_err());
            assert!(unless_it_panics(|| Ok(())).is_ok());
            return;
        }
        let mut child = std::process::Command::new(std::env::current_exe().unwrap());
        let name = "las::laszip::tests::a_panic_of_the_library_is_an_error_without_a_message";
        let done = child.args([name, "--exact", "--nocapture"]).env(CHILD, "1").output().unwrap();
        let [said, told] = [done.stdout, done.stderr].map(|text| String::from_utf8(text).unwrap());
        assert!(said.contains("1 passed") && !told.contains("no entry"), "{said}{told}");
    }
}
