//! Objects by a store in memory: what is written in parts is what was written, and is there whole or not at
//! all.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard};

use proptest::prelude::*;
use simod_model::object::{self, Object, Store, Upload};
use simod_model::object_output::{ObjectOutput, part_bytes};
use simod_model::object_range::ObjectRange;
use simod_model::{Error, Output, Result, Summary};

/// The objects, and the parts of those that are begun.
#[derive(Default)]
struct Content {
    objects: BTreeMap<String, Vec<u8>>,
    uploads: BTreeMap<String, BTreeMap<usize, Vec<u8>>>,
    begun: usize,
}

static CONTENT: LazyLock<Mutex<Content>> = LazyLock::new(|| {
    object::install(Box::new(InMemory));
    Mutex::default()
});

fn content() -> MutexGuard<'static, Content> {
    CONTENT.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

struct InMemory;

#[derive(Debug)]
struct Read(Vec<u8>);

struct Begun {
    url: String,
    id: String,
    sent: BTreeMap<usize, String>,
}

impl Store for InMemory {
    fn open(&self, url: &str) -> Result<Option<Arc<dyn Object>>> {
        let found = content().objects.get(url).cloned();
        Ok(found.map(|bytes| Arc::new(Read(bytes)) as Arc<dyn Object>))
    }

    fn begin(&self, url: &str) -> Result<Box<dyn Upload>> {
        let id = {
            let mut content = content();
            content.begun += 1;
            let id = format!("{url} {}", content.begun);
            content.uploads.insert(id.clone(), BTreeMap::new());
            id
        };
        self.go_on(url, &id)
    }

    fn go_on(&self, url: &str, id: &str) -> Result<Box<dyn Upload>> {
        Ok(Box::new(Begun { url: url.to_owned(), id: id.to_owned(), sent: BTreeMap::new() }))
    }
}

impl Object for Read {
    fn bytes(&self) -> u64 {
        self.0.len() as u64
    }

    fn version(&self) -> &str {
        "the only one"
    }

    fn read_at(&self, buffer: &mut [u8], offset: u64) -> Result<()> {
        buffer.copy_from_slice(&self.0[offset as usize..offset as usize + buffer.len()]);
        Ok(())
    }
}

impl Upload for Begun {
    fn id(&self) -> &str {
        &self.id
    }

    fn send(&mut self, number: usize, bytes: Vec<u8>) -> Result<()> {
        let refused = || Error::system("no such upload", "begin one");
        self.sent.insert(number, format!("{number} of {}", bytes.len()));
        content().uploads.get_mut(&self.id).ok_or_else(refused)?.insert(number, bytes);
        Ok(())
    }

    fn sent(&mut self) -> Result<BTreeMap<usize, String>> {
        Ok(std::mem::take(&mut self.sent))
    }

    fn complete(&mut self, tags: Vec<String>, bytes: u64) -> Result<()> {
        let mut content = content();
        let parts = content.uploads.remove(&self.id).expect("an upload");
        let known: Vec<String> =
            parts.iter().map(|(number, part)| format!("{number} of {}", part.len())).collect();
        assert_eq!(tags, known);
        let lengths: Vec<usize> = parts.values().map(Vec::len).collect();
        let [all @ .., last] = &lengths[..] else { panic!("an object without parts") };
        assert!(all.iter().all(|length| length == &lengths[0]) && last <= &lengths[0], "{lengths:?}");
        let whole: Vec<u8> = parts.into_values().flatten().collect();
        assert_eq!(whole.len() as u64, bytes);
        content.objects.insert(self.url.clone(), whole);
        Ok(())
    }

    fn abort(&mut self) -> Result<()> {
        content().uploads.remove(&self.id);
        Ok(())
    }
}

/// Bytes of an object, if it is there.
fn there(path: &Path) -> Option<Vec<u8>> {
    object::find(path).expect("a store").map(|object| {
        let mut bytes = vec![0; object.bytes() as usize];
        object.read_at(&mut bytes, 0).expect("bytes");
        bytes
    })
}

fn is_begun(path: &Path) -> bool {
    content().uploads.keys().any(|id| id.starts_with(path.to_str().expect("text")))
}

fn install() {
    drop(content());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn parts_are_what_was_written(
        length in 1..700usize,
        part in 1..90u64,
        piece in 1..200usize,
        patches in proptest::collection::vec((0.0..1.0f64, 1..30usize), 0..4),
        passed in 0..8usize,
    ) {
        install();
        let path = Path::new("s3://bucket/parts");
        content().objects.remove("s3://bucket/parts");
        let mut bytes: Vec<u8> = (0..length).map(|i| (i * 31 % 251) as u8).collect();
        let mut begun = object::begin(path).unwrap();
        // Some whole parts, in a row, are sent by another process.
        let from = length / part as usize / 3;
        let passed = from..(from + passed).min(length / part as usize);
        let mut tags = BTreeMap::new();
        for number in passed.clone() {
            let range = number * part as usize..(number + 1) * part as usize;
            begun.upload().send(number, bytes[range].to_vec()).unwrap();
        }
        tags.extend(begun.upload().sent().unwrap());
        let mut output = ObjectOutput::with_parts(path, begun, part);
        let (first, last) = (passed.start * part as usize, passed.end * part as usize);
        for piece in bytes[..first].chunks(piece) {
            output.write_piece(piece, 0, &Summary::default()).unwrap();
        }
        tags.into_values().try_for_each(|tag| output.pass(tag)).unwrap();
        for piece in bytes[last.max(first)..].chunks(piece) {
            output.write_piece(piece, 0, &Summary::default()).unwrap();
        }
        prop_assert_eq!(output.position(), length as u64);
        // The part that would be filled next: none has begun where the last one is full.
        let current = length / part as usize;
        for (at, count) in patches {
            let at = (at * length as f64) as usize;
            let end = (at + count).min(length);
            let of = |at: usize| at / part as usize;
            let is_held = |number: usize| !passed.contains(&number) && (number == 0 || number + 1 >= current);
            let new: Vec<u8> = bytes[at..end].iter().map(|byte| byte ^ 0x55).collect();
            let all_held = (of(at)..=of(end - 1)).all(is_held);
            let patched = output.patch(at as u64, &new);
            if all_held {
                prop_assert!(patched.is_ok());
                bytes[at..end].copy_from_slice(&new);
            } else {
                prop_assert!(patched.is_err());
                return Ok(());
            }
        }
        prop_assert_eq!(there(path), None);
        output.complete().unwrap();
        prop_assert_eq!(output.commit().unwrap(), length as u64);
        prop_assert!(there(path) == Some(bytes));
        prop_assert!(!is_begun(path));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Ranges in any order, twice, of any length: what is before them, between them and behind them is put
    /// together.
    #[test]
    fn ranges_are_sent_beside_each_other(
        length in 1..900usize,
        cuts in proptest::collection::vec(0.0..1.0f64, 2..7),
        part in 1..120u64,
        piece in 1..150usize,
        order in 0..6usize,
    ) {
        install();
        let path = Path::new("s3://bucket/ranges");
        content().objects.remove("s3://bucket/ranges");
        let bytes: Vec<u8> = (0..length).map(|i| (i * 37 % 241) as u8).collect();
        let mut ends: Vec<usize> = cuts.iter().map(|cut| (cut * length as f64) as usize).collect();
        ends.sort_unstable();
        let id = object::begin(path).unwrap().leave();
        let ranges = ends.len() - 1;
        let mut sent = vec![None; ranges];
        for turn in 0..2 * ranges {
            let number = (turn * 5 + order) % ranges;
            let mut range = ObjectRange::open(path, &id, part).unwrap();
            range.begin_at(ends[number] as u64);
            for piece in bytes[ends[number]..ends[number + 1]].chunks(piece) {
                range.write(piece).unwrap();
            }
            sent[number] = Some(range.finish().unwrap());
        }
        // The order may have left some out.
        for number in 0..ranges {
            if sent[number].is_none() {
                let mut range = ObjectRange::open(path, &id, part).unwrap();
                range.begin_at(ends[number] as u64);
                range.write(&bytes[ends[number]..ends[number + 1]]).unwrap();
                sent[number] = Some(range.finish().unwrap());
            }
        }
        let mut output = ObjectOutput::with_parts(path, object::go_on(path, &id).unwrap(), part);
        output.write(&bytes[..ends[0]]).unwrap();
        for sent in sent.into_iter().flatten() {
            prop_assert!(sent.before.len() < part as usize && sent.behind.len() < part as usize);
            output.write(&sent.before).unwrap();
            sent.tags.into_iter().try_for_each(|tag| output.pass(tag)).unwrap();
            output.write(&sent.behind).unwrap();
        }
        output.write(&bytes[ends[ranges]..]).unwrap();
        prop_assert_eq!(there(path), None);
        output.complete().unwrap();
        output.commit().unwrap();
        prop_assert!(there(path) == Some(bytes));
    }
}

#[test]
fn what_is_not_committed_leaves_nothing() {
    install();
    let path = Path::new("s3://bucket/dropped");
    let mut output = ObjectOutput::begin(path, 100).unwrap();
    output.write(&[1; 100]).unwrap();
    output.complete().unwrap();
    assert!(is_begun(path));
    drop(output);
    assert!(!is_begun(path));
    assert_eq!(there(path), None);
    // An upload that others go on with stays.
    let id = object::begin(path).unwrap().leave();
    drop(object::go_on(path, &id).unwrap());
    assert!(is_begun(path));
    object::go_on(path, &id).unwrap().upload().abort().unwrap();
    assert!(!is_begun(path));
}

#[test]
fn parts_are_few_enough_and_long_enough() {
    for bytes in [0, 1, 8 << 20, 70_000_000_000, 5 << 40] {
        let part = part_bytes(bytes);
        assert!(
            part >= 5 << 20 && bytes.div_ceil(part) <= 10_000 && part.is_multiple_of(1 << 20),
            "{bytes}: {part}"
        );
    }
    assert_eq!(part_bytes(70_000_000_000), 8 << 20);
}

#[test]
fn models_are_opened_by_what_they_hold() {
    install();
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 2 3\n";
    content().objects.insert("s3://bucket/[1]/a.ply".to_owned(), text.into());
    let model = simod_model::open(Path::new("s3://bucket/[1]/a.ply")).unwrap();
    assert_eq!((model.info().vertices, model.info().bytes), (2, text.len() as u64));
    let error = simod_model::open(Path::new("s3://bucket/none.ply")).err().unwrap();
    assert!(error.to_string().contains("there is no such object"), "{error}");
}
