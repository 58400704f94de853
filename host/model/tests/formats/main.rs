//! Files of formats, written here by hand, then read, rewritten, cut off and spoilt.

#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

mod columns;
mod e57;
mod gltf;
mod las;
mod obj;
mod off;
mod parts;
mod pcd;
mod ply;
mod splats;
mod stl;
mod tiles;

use std::io::{self, Write};
use std::ops::Range;
use std::sync::Mutex;

use glam::{DVec3, Vec3};
use proptest::prelude::ProptestConfig;
use simod_model::progress::Silent;
use simod_model::{
    Edit, Edited, FaceChunk, Model, Normals, Output, Result, Rewriting, Summary, VertexChunk, for_faces,
    for_faces_at, for_faces_from,
};

/// Opens a file of these bytes, with a name of this ending.
pub fn open(bytes: &[u8], extension: &str) -> Result<Box<dyn Model>> {
    let mut file = tempfile::Builder::new().suffix(extension).tempfile().unwrap();
    file.write_all(bytes).unwrap();
    // The open file outlives its name.
    simod_model::open(file.path())
}

/// Positions and normals of a range, read in chunks of at most so many vertices.
pub fn read_by(model: &dyn Model, range: Range<u64>, chunk_size: usize) -> Result<(Vec<DVec3>, Vec<Vec3>)> {
    let mut reader = model.vertices(range.clone())?;
    reader.set_chunk(chunk_size);
    let mut chunk = VertexChunk::default();
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    while reader.read(&mut chunk)? {
        assert!(!chunk.is_empty() && chunk.len() <= chunk_size.max(3));
        assert_eq!(chunk.first, range.start + positions.len() as u64);
        positions.extend_from_slice(&chunk.positions);
        normals.extend_from_slice(&chunk.normals);
    }
    assert!(chunk.is_empty() && !reader.read(&mut chunk)?);
    Ok((positions, normals))
}

/// Positions and normals of the whole model.
pub fn read(model: &dyn Model) -> Result<(Vec<DVec3>, Vec<Vec3>)> {
    read_by(model, 0..u64::MAX, 1 << 16)
}

/// The bytes of all vertices, in chunks of at most so many: what tells whether a model is the one that was
/// sampled.
pub fn vertex_bytes(model: &dyn Model, chunk_size: usize) -> Vec<u8> {
    bytes_of(model, 0..u64::MAX, chunk_size)
}

fn bytes_of(model: &dyn Model, range: Range<u64>, chunk_size: usize) -> Vec<u8> {
    let mut reader = model.vertices(range).unwrap();
    reader.set_chunk(chunk_size);
    let (mut chunk, mut bytes) = (VertexChunk::default(), Vec::new());
    while reader.read(&mut chunk).unwrap() {
        bytes.extend_from_slice(chunk.raw());
    }
    bytes
}

/// The triangles of all faces.
pub fn triangles(model: &dyn Model) -> Result<Vec<[u32; 3]>> {
    let mut triangles = Vec::new();
    for_faces(model, |chunk| {
        triangles.extend_from_slice(&chunk.triangles);
        Ok(())
    })?;
    Ok(triangles)
}

/// Reads the faces between marks, and checks that they are those that a reading of all has there.
pub fn check_marks(model: &dyn Model) {
    let (mut all, mut marks) = (Vec::new(), Vec::new());
    let mut reader = model.faces().unwrap();
    let mut chunk = FaceChunk::default();
    while reader.read(&mut chunk).unwrap() {
        marks.extend(chunk.marks.iter().map(|m| (all.len() + m.triangle, m.offset)));
        all.extend_from_slice(&chunk.triangles);
    }
    assert!(marks.is_sorted());
    for pair in marks.windows(2).step_by(3).chain(marks.windows(marks.len().max(1))) {
        let (first, last) = (pair[0], pair[pair.len() - 1]);
        let mut some = Vec::new();
        let ranges = std::iter::once(first.1..last.1).collect();
        for_faces_at(model, ranges, |chunk| {
            some.extend_from_slice(&chunk.triangles);
            Ok(())
        })
        .unwrap();
        assert_eq!(some, all[first.0..last.0]);
    }
    check_reading_on(model, &all, &marks);
}

/// Reads the faces from marks on, if the format supports that, and checks that they are the same, with the
/// same marks.
pub fn check_reading_on(model: &dyn Model, all: &[[u32; 3]], marks: &[(usize, u64)]) {
    let every = marks.len().div_ceil(50).max(1);
    let inner = marks.iter().enumerate().take(marks.len().saturating_sub(1));
    for (number, (before, from)) in inner.step_by(every).filter(|_| model.has_face_marks()) {
        let (mut some, mut again) = (Vec::new(), Vec::new());
        for_faces_from(model, *from, u64::MAX, |chunk| {
            again.extend(chunk.marks.iter().map(|m| (before + some.len() + m.triangle, m.offset)));
            some.extend_from_slice(&chunk.triangles);
            Ok(())
        })
        .unwrap();
        assert_eq!(some, all[*before..]);
        again.dedup();
        let mut expected = marks[number..].to_vec();
        expected.dedup();
        assert_eq!(again, expected);
    }
}

/// A file in memory.
#[derive(Default, PartialEq)]
pub struct Written(pub Vec<u8>);

impl Output for Written {
    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.0[at as usize..at as usize + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An edit that gives all versions the same; whether it says beforehand that nothing changes.
struct Same<F>(Mutex<F>, bool);

impl<F: FnMut(&mut Edited) + Send> Edit for Same<F> {
    fn edit(&self, _: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        let (one, others) = versions.split_first_mut().unwrap();
        self.0.lock().unwrap()(one);
        for other in others {
            other.positions.clone_from(&one.positions);
            other.normals.clone_from(&one.normals);
            other.gradients.clone_from(&one.gradients);
            other.mirrored = one.mirrored;
        }
        Ok(())
    }

    fn is_still(&self, _: usize) -> bool {
        self.1
    }
}

fn write(model: &dyn Model, edit: &dyn Edit) -> Result<Vec<u8>> {
    let (mut first, mut second) = (Written::default(), Written::default());
    let how = Rewriting { normals: Normals::Transform, ..Rewriting::default() };
    model.rewrite(&mut [&mut first, &mut second], how, edit, &Silent)?;
    assert!(first == second);
    Ok(first.0)
}

/// Writes the model with other positions and normals; also checks that versions are the same by each other.
pub fn rewrite(model: &dyn Model, edit: impl FnMut(&mut Edited) + Send) -> Result<Vec<u8>> {
    write(model, &Same(Mutex::new(edit), false))
}

/// An error's message without the file's name; it has a hint.
pub fn message(result: Result<impl Sized>) -> String {
    match result {
        Ok(_) => panic!("no error"),
        Err(e) => {
            assert!(!e.hint().is_empty());
            let text = e.to_string();
            text.split_once(": ").map_or(text.clone(), |(_, rest)| rest.into())
        }
    }
}

/// Number of cases, unless others are asked for.
pub fn cases(count: u32) -> ProptestConfig {
    let usual = ProptestConfig::default();
    if std::env::var_os("PROPTEST_CASES").is_some() {
        usual
    } else {
        ProptestConfig { cases: count, ..usual }
    }
}

/// Reads all of a file, as commands do.
pub fn go_over(bytes: &[u8], extension: &str) -> Result<()> {
    let model = open(bytes, extension)?;
    model.check_complete(&Silent)?;
    let read = read(model.as_ref())?;
    assert_eq!(read.0.len() as u64, model.info().vertices);
    triangles(model.as_ref())?;
    let out = write(model.as_ref(), &Same(Mutex::new(|_: &mut Edited| {}), true))?;
    assert!(out == bytes, "an identity changes bytes");
    Ok(())
}

/// Checks of every good file: it comes back as it is, by any chunks.
pub fn check_whole(bytes: &[u8], extension: &str) -> Box<dyn Model> {
    go_over(bytes, extension).unwrap();
    let model = open(bytes, extension).unwrap();
    let all = read(model.as_ref()).unwrap();
    let of_all = vertex_bytes(model.as_ref(), 1 << 16);
    let count = all.0.len();
    for chunk in [1, 3, 1000] {
        let by = read_by(model.as_ref(), 0..u64::MAX, chunk).unwrap();
        assert!(by.0.len() == count && format!("{by:?}") == format!("{all:?}"), "{chunk}");
        assert!(vertex_bytes(model.as_ref(), chunk) == of_all, "{chunk}");
    }
    for range in [0..1, 1..2, count / 3..2 * count / 3, count.saturating_sub(1)..count + 7] {
        let some = read_by(model.as_ref(), range.start as u64..range.end as u64, 7).unwrap();
        let end = range.end.min(count);
        let expected = &all.0[range.start.min(end)..end];
        assert!(format!("{:?}", some.0) == format!("{expected:?}"), "{range:?}");
    }
    check_parts(model.as_ref(), &of_all);
    if !triangles(model.as_ref()).unwrap().is_empty() {
        check_marks(model.as_ref());
    }
    model
}

/// Ranges of vertices, wherever they meet, have all bytes together, once: as conversions read them.
fn check_parts(model: &dyn Model, of_all: &[u8]) {
    let count = model.info().vertices;
    for at in [1, 2, 3, count / 3 + 1, count.saturating_sub(1)] {
        if model.info().reads_exactly() && at < count {
            let parts = [0..at, at..count].map(|range| bytes_of(model, range, 1000));
            assert!(parts.concat() == of_all, "{at}");
        }
    }
}

/// Checks that the beginning of a file up to any byte is an error or something sane, and so is the file with
/// any byte replaced by some others.
pub fn check_bad(bytes: &[u8], extension: &str) {
    for end in 1..bytes.len() {
        let _ = go_over(&bytes[..end], extension);
    }
    for at in 0..bytes.len() {
        for other in [0, b'\n', b'-', b'9', b'/', 0xff] {
            let mut bad = bytes.to_vec();
            bad[at] = other;
            let _ = go_over(&bad, extension);
        }
    }
}

/// A text of each format, and a word of it that is a coordinate.
const TEXTS: [(&str, &str, &str); 7] = [
    ("v 0 0 0\nv 1.25 0 0\nv 0 1 0\n# end\nf 1 2 3\n", ".obj", "1.25"),
    ("OFF\n3 1 0\n0 0 0\n1.25 0 0\n0 1 0\n3 0 1 2\n", ".off", "1.25"),
    (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n\
         0 0 0\n1.25 0 0\n0 1 0\n",
        ".pcd",
        "1.25",
    ),
    (
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1.25 0 0\nvertex 0 1 0\nendloop\nendfacet\n\
         endsolid a\n",
        ".stl",
        "1.25",
    ),
    ("x,y,z,a\n0,0,0,7\n1.25,0,0,8\n0,1,0,9\n", ".csv", "1.25"),
    ("0 0 0\n1.25 0 0\n0 1 0\n", ".xyz", "1.25"),
    ("3\n0 0 0 1\n1.25 0 0 1\n0 1 0 1\n", ".pts", "1.25"),
];

#[test]
fn texts_with_line_ends_of_all_kinds_are_the_same() {
    for (text, extension, _) in TEXTS {
        let expected = read(open(text.as_bytes(), extension).unwrap().as_ref()).unwrap().0;
        let ends = ["\r\n", "\n", "\r"];
        let mixed: String =
            text.lines().zip(ends.iter().cycle()).map(|(line, end)| line.to_owned() + end).collect();
        go_over(mixed.as_bytes(), extension).unwrap();
        let found = read(open(mixed.as_bytes(), extension).unwrap().as_ref()).unwrap().0;
        assert_eq!(found, expected, "{extension}");
    }
}

#[test]
fn texts_with_what_is_no_text_are_errors_or_sane() {
    for (text, extension, word) in TEXTS {
        let with = |other: &[u8]| {
            let (before, after) = text.split_once(word).unwrap();
            go_over(&[before.as_bytes(), other, after.as_bytes()].concat(), extension)
        };
        // A number written as infinite or NaN stays; a number beyond all doubles is a mistake.
        ["nan", "-inf", "Infinity"].iter().for_each(|none| with(none.as_bytes()).unwrap());
        for beyond in ["1e999", "-1E+999", &"9".repeat(310)] {
            let error = with(beyond.as_bytes()).unwrap_err();
            let (text, hint) = (error.to_string(), error.hint());
            assert!(
                text.contains(if extension == ".pcd" { "the type float" } else { "the type double" }),
                "{text}"
            );
            assert!(text.contains("line ") || text.contains("vertex "), "{extension}: {text}");
            assert!(hint.starts_with("write nan in its place"), "{hint}");
        }
        for (what, other) in [
            ("NUL alone", &b"\0"[..]),
            ("NUL within", b"1.\x0025"),
            ("NUL behind", b"1.25\0"),
            ("no UTF-8", b"1.2\xff"),
            ("words", b"one"),
        ] {
            if let Err(error) = with(other) {
                let text = error.to_string();
                let tells =
                    ["line ", "vertex ", "ends within", "facets"].iter().any(|place| text.contains(place));
                assert!(!error.hint().is_empty() && tells, "{extension}, {what}: {text}");
            }
        }
        // Long lines are refused long before they are read to their end.
        for (long, mebibytes) in [(b"1", 100), (b" ", 17), (b"\0", 17)] {
            let error = with(&long.repeat(mebibytes << 20)).unwrap_err();
            assert!(!error.hint().is_empty(), "{extension}: {error}");
        }
    }
}
