//! The header of a LAS file, which has its numbers at fixed places, little endian.

use glam::DVec3;

use crate::bounds::Bounds;
use crate::source::SourceFile;
use crate::{Result, ScaledIntegers};

/// The bit of the header's global encoding that GPS times are adjusted standard ones: seconds less 10⁹
/// since the beginning of 1980, instead of those of a week.
pub(super) const ADJUSTED_TIME: u8 = 1;

/// Hint for everything that no correct program writes.
pub(super) const DAMAGED: &str = "the file is damaged: copy or export it again";

/// Hint where something is missing.
pub(super) const CUT_OFF: &str = "the file is cut off, or its header lies: copy or export it again";

/// First bytes of a file.
pub(super) const MAGIC: &[u8] = b"LASF";

/// Places of the header's numbers that are changed.
pub(super) mod at {
    pub const POINTS: u64 = 96;
    pub const VLRS: u64 = 100;
    pub const OFFSETS: u64 = 155;
    /// The largest x, the least x, then y and z likewise.
    pub const BOUNDS: u64 = 179;
    pub const WAVEFORMS: u64 = 227;
    pub const EVLRS_START: u64 = 235;
    pub const EVLRS: u64 = 243;
}

/// Bytes of a record of each point format, without extra bytes.
pub(super) const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

/// The header's content.
#[derive(Debug, Clone)]
pub(super) struct LasHeader {
    /// The second number of the version, 0 to 4.
    pub minor: u8,
    /// The header's length, after which the VLRs begin.
    pub len: u64,
    /// The place where the points begin.
    pub points: u64,
    /// Number of VLRs.
    pub vlrs: u32,
    /// Point format, 0 to 10.
    pub format: u8,
    pub is_compressed: bool,
    /// Bytes of a point's record.
    pub record: usize,
    pub count: u64,
    pub integers: ScaledIntegers,
    /// Box of all points in the header; none where it is no box.
    pub told: Option<Bounds>,
    /// Byte of this file at which the waveforms begin, if it has them.
    pub waveforms: Option<u64>,
    /// Whether the waveforms are in another file, of the same name but for its extension.
    pub has_waveforms_beside: bool,
    /// Whether GPS times are said to be adjusted standard ones.
    pub has_adjusted_time: bool,
    /// Byte at which the EVLRs begin, and their number, if there are any.
    pub evlrs: Option<(u64, u32)>,
}

impl LasHeader {
    pub fn read(source: &SourceFile) -> Result<Self> {
        let mut bytes = [0; 375];
        let read = source.read_at(&mut bytes, 0)?;
        let [major, minor] = [bytes[24], bytes[25]];
        let least = match minor {
            0..=2 => 227,
            3 => 235,
            _ => 375,
        };
        if read < 227 || (major == 1 && read < least) {
            return Err(source.malformed("the file ends within the header of LAS", CUT_OFF));
        }
        if major != 1 || minor > 4 {
            let what = format!("a file of LAS {major}.{minor}");
            return Err(
                source.malformed(what, "LAS 1.0 to 1.4 can be read: export the model as one of these")
            );
        }
        let u16_at = |at: usize| u16::from_le_bytes(bytes_at(&bytes, at));
        let u32_at = |at: usize| u32::from_le_bytes(bytes_at(&bytes, at));
        let u64_at = |at: usize| u64::from_le_bytes(bytes_at(&bytes, at));
        let vector =
            |at: usize| DVec3::from([0, 8, 16].map(|axis| f64::from_le_bytes(bytes_at(&bytes, at + axis))));
        let legacy = u64::from(u32_at(107));
        let count = if minor == 4 && u64_at(247) > 0 { u64_at(247) } else { legacy };
        let some = |at: u64, least: u8| (minor >= least).then(|| u64_at(at as usize)).filter(|at| *at > 0);
        let evlrs = some(at::EVLRS_START, 4).map(|start| (start, u32_at(at::EVLRS as usize)));
        let format = bytes[104] & 0x3f;
        let this = Self {
            minor,
            len: u64::from(u16_at(94)),
            points: u64::from(u32_at(at::POINTS as usize)),
            vlrs: u32_at(at::VLRS as usize),
            format,
            is_compressed: bytes[104] & 0xc0 != 0,
            record: usize::from(u16_at(105)),
            count,
            integers: ScaledIntegers { scale: vector(131), offset: vector(at::OFFSETS as usize) },
            told: told_bounds(&bytes),
            waveforms: some(at::WAVEFORMS, 3),
            has_waveforms_beside: minor >= 3 && bytes[6] & 4 != 0 && matches!(format, 4 | 5 | 9 | 10),
            has_adjusted_time: minor >= 2 && bytes[6] & ADJUSTED_TIME != 0,
            evlrs: evlrs.filter(|(_, count)| *count > 0),
        };
        this.check(source, least as u64)?;
        Ok(this)
    }

    fn check(&self, source: &SourceFile, least: u64) -> Result<()> {
        let Self { minor, len, points, format, record, integers: ScaledIntegers { scale, offset }, .. } =
            self;
        let wrong = |what: String| Err(source.malformed(what, DAMAGED));
        if *len < least {
            return wrong(format!("the header says it has {len} bytes, but LAS 1.{minor} needs {least}"));
        }
        if points < len {
            return wrong(format!("the points begin at byte {points}, within the header of {len} bytes"));
        }
        if *points > source.len() {
            let what = format!("the points begin at byte {points}, but the file has {} bytes", source.len());
            return Err(source.malformed(what, CUT_OFF));
        }
        let Some(needed) = RECORD_BYTES.get(usize::from(*format)) else {
            let what = format!("point format {format}");
            return Err(
                source.malformed(what, "formats 0 to 10 can be read: export the model in one of these")
            );
        };
        if record < needed {
            return wrong(format!("point format {format} needs {needed} bytes, but a point has {record}"));
        }
        if !scale.is_finite() || scale.cmpeq(DVec3::ZERO).any() || !offset.is_finite() {
            return wrong(format!(
                "the header says that positions have the scale {scale} and offset {offset}"
            ));
        }
        Ok(())
    }

    /// Bytes of a point behind those of its format.
    pub fn extra_bytes(&self) -> usize {
        self.record - RECORD_BYTES[usize::from(self.format)]
    }
}

/// Box of all points in a header.
fn told_bounds(header: &[u8; 375]) -> Option<Bounds> {
    let number = |at: usize| f64::from_le_bytes(bytes_at(header, at));
    let corner =
        |side: usize| DVec3::from([0, 1, 2].map(|axis| number(at::BOUNDS as usize + 16 * axis + 8 * side)));
    let told = Bounds { max: corner(0), min: corner(1) };
    (told.min.is_finite() && told.max.is_finite() && told.min.cmple(told.max).all()).then_some(told)
}

/// `N` bytes from `at` on, which are there.
#[inline(always)]
pub(super) fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut result = [0; N];
    result.copy_from_slice(&bytes[at..at + N]);
    result
}
