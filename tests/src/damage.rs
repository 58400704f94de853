//! Damaged files, for tests of readers: as their structure suggests, numbers become others, words and lines
//! too, and parts are cut out, doubled and exchanged.

use std::io::Write;
use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

/// Damage that is done to bytes. Places are parts of the whole.
#[derive(Debug, Clone)]
pub enum Damage {
    /// Some bits of a byte.
    Flip {
        /// Place in the bytes.
        at: f64,
        /// Bits that are turned over.
        bits: u8,
    },
    /// Bytes become a number, the lowest first.
    Number {
        /// Place in the bytes.
        at: f64,
        /// Number that is written.
        value: u64,
        /// Number of bytes.
        width: usize,
    },
    /// A part is missing.
    Cut {
        /// Place in the bytes.
        at: f64,
        /// Length, as a part of the whole.
        len: f64,
    },
    /// A part is there twice.
    Double {
        /// Place in the bytes.
        at: f64,
        /// Length, as a part of the whole.
        len: f64,
    },
    /// A word becomes another one.
    Word {
        /// Number of the word.
        nth: usize,
        /// The other word.
        with: &'static str,
    },
    /// A line is somewhere else, too.
    Line {
        /// Number of the line.
        nth: usize,
        /// Number of the line that it follows.
        after: usize,
    },
}

/// Numbers and words that are likely to be believed.
const NUMBERS: [u64; 8] = [0, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, 1 << 40, u64::MAX];
const WORDS: [&str; 16] = [
    "0",
    "-1",
    "1e400",
    "nan",
    "18446744073709551615",
    "4294967295",
    "\"\"",
    "list",
    "[]",
    "../../x",
    "{}",
    "#",
    "true",
    "1e308",
    "\"/dev/zero\"",
    "[[1, 2], [3]]",
];

/// Any damage.
pub fn damage() -> impl Strategy<Value = Damage> {
    let part = || 0.0..1.0f64;
    prop_oneof![
        3 => (part(), 1u8..).prop_map(|(at, bits)| Damage::Flip { at, bits }),
        3 => (part(), prop::sample::select(&NUMBERS[..]), 1usize..=8)
            .prop_map(|(at, value, width)| Damage::Number { at, value, width }),
        2 => (part(), 0.0..0.3f64).prop_map(|(at, len)| Damage::Cut { at, len }),
        1 => (part(), 0.0..0.2f64).prop_map(|(at, len)| Damage::Double { at, len }),
        3 => (0usize..200, prop::sample::select(&WORDS[..])).prop_map(|(nth, with)| Damage::Word { nth, with }),
        1 => (0usize..60, 0usize..60).prop_map(|(nth, after)| Damage::Line { nth, after }),
    ]
}

/// The bytes damaged; places are parts of the first `within` of them.
pub fn damaged(bytes: &[u8], within: usize, all: &[Damage]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for damage in all {
        let length = within.min(bytes.len());
        if length == 0 {
            break;
        }
        let place = |part: f64| ((part * length as f64) as usize).min(length - 1);
        match *damage {
            Damage::Flip { at, bits } => bytes[place(at)] ^= bits,
            Damage::Number { at, value, width } => {
                let at = place(at);
                bytes.iter_mut().skip(at).zip(value.to_le_bytes()).take(width).for_each(|(b, v)| *b = v);
            }
            Damage::Cut { at, len } => {
                let (at, len) = (place(at), place(len));
                bytes.drain(at..(at + len).min(length));
            }
            Damage::Double { at, len } => {
                let (at, len) = (place(at), place(len));
                let part = bytes[at..(at + len).min(length)].to_vec();
                bytes.splice(at..at, part);
            }
            Damage::Word { nth, with } => {
                let is_blank = |b: &u8| b.is_ascii_whitespace();
                let starts = (1..length).filter(|i| is_blank(&bytes[i - 1]) && !is_blank(&bytes[*i]));
                let starts: Vec<usize> = starts.collect();
                if let Some(start) = (!starts.is_empty()).then(|| starts[nth % starts.len()]) {
                    let end = (start..length).find(|i| is_blank(&bytes[*i])).unwrap_or(length);
                    bytes.splice(start..end, with.bytes());
                }
            }
            Damage::Line { nth, after } => {
                let mut lines: Vec<Vec<u8>> =
                    bytes.split_inclusive(|b| *b == b'\n').map(<[u8]>::to_vec).collect();
                let line = lines[nth % lines.len()].clone();
                lines.insert(after % lines.len(), line);
                bytes = lines.concat();
            }
        }
    }
    bytes
}

/// So many cases, unless the environment says how many.
pub fn cases(count: u32) -> ProptestConfig {
    let config = ProptestConfig::default();
    if std::env::var_os("PROPTEST_CASES").is_some() {
        config
    } else {
        ProptestConfig { cases: count, ..config }
    }
}

/// Calls `check` with files of so many damaged versions of `good`; it panics where they do harm.
pub fn damaged_files(good: &str, count: u32, check: impl Fn(&Path)) {
    let all = prop::collection::vec(damage(), 1..4);
    let tested = runner(count).run(&all, |all| {
        let mut file = tempfile::NamedTempFile::new().expect("a file");
        file.write_all(&damaged(good.as_bytes(), good.len(), &all)).expect("space");
        check(file.path());
        Ok(())
    });
    tested.expect("no harm");
}

/// Runs so many cases, unless the environment says how many.
pub fn runner(count: u32) -> TestRunner {
    TestRunner::new(cases(count))
}
