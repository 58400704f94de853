//! PLY files of every sort, made here from a description, then read, rewritten, cut off and spoilt.

#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::fs;
use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use simod_model::output::{OutputFile, write_file};
use simod_model::progress::Silent;
use simod_model::{
    CHUNK_VERTICES, Edit, Edited, Error, ErrorKind, MAX_VERSIONS, Model, Normals, Output, Progress, RawChunk,
    Result, Rewriting, Scalar, Summary, VertexChunk, write_points,
};
use tempfile::NamedTempFile;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}
use Encoding::{Ascii, Big, Little};

const ENCODINGS: [Encoding; 3] = [Ascii, Little, Big];

/// Kind of file to make.
#[derive(Debug, Clone)]
struct Spec {
    encoding: Encoding,
    /// Types of x, y, z, and of the normals' coordinates.
    position: [&'static str; 3],
    normal: Option<&'static str>,
    /// Order of x, y, z, nx, ny, nz, a colour and an id in a record (those of them that there are).
    order: Vec<usize>,
    colour: bool,
    list_in_vertex: bool,
    element_before: bool,
    faces: Faces,
    line_end: &'static str,
    tail: &'static [u8],
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Faces {
    None,
    Triangles,
    Mixed,
    Strips,
}

impl Spec {
    fn new(encoding: Encoding) -> Self {
        Self {
            encoding,
            position: ["float"; 3],
            normal: Some("float"),
            order: (0..8).collect(),
            colour: false,
            list_in_vertex: false,
            element_before: false,
            faces: Faces::Triangles,
            line_end: "\n",
            tail: b"",
        }
    }

    /// Specification with everything that makes a file difficult.
    fn difficult(encoding: Encoding) -> Self {
        Self {
            position: ["float", "double", "float"],
            normal: Some("double"),
            order: vec![6, 4, 2, 0, 7, 1, 5, 3],
            colour: true,
            list_in_vertex: true,
            element_before: true,
            faces: Faces::Mixed,
            line_end: "\r\n",
            ..Self::new(encoding)
        }
    }

    fn kind(&self, property: usize) -> Option<&'static str> {
        match property {
            0..3 => Some(self.position[property]),
            3..6 => self.normal,
            6 => self.colour.then_some("uchar"),
            _ => self.colour.then_some("int32"),
        }
    }

    /// The file with these vertices: position and normal of each.
    fn build(&self, vertices: &[[f64; 6]]) -> Vec<u8> {
        let mut header = vec![
            "ply".to_string(),
            match self.encoding {
                Ascii => "format ascii 1.0",
                Little => "format binary_little_endian 1.0",
                Big => "format binary_big_endian 1.0",
            }
            .into(),
            "comment made by hand \t".into(),
        ];
        if self.element_before {
            header.push("element camera 2".into());
            header.push("property list uint16 int8 name".into());
            header.push("property float64 focus".into());
            header.push("element nothing 7".into());
        }
        header.push(format!("element vertex {}", vertices.len()));
        for &p in &self.order {
            if let Some(kind) = self.kind(p) {
                let name = ["x", "y", "z", "nx", "ny", "nz", "red", "id"][p];
                header.push(format!("property {kind} {name}"));
            }
            if p == 4 && self.list_in_vertex {
                header.push("property list uchar short weights".into());
            }
        }
        let faces = vertices.len() / 2;
        match self.faces {
            Faces::None => {}
            Faces::Strips => {
                header.push("element tristrips 1".into());
                header.push("property list int int vertex_indices".into());
            }
            Faces::Triangles | Faces::Mixed => {
                header.push(format!("element face {faces}"));
                if self.faces == Faces::Mixed {
                    header.push("property short group".into());
                }
                header.push("property list uint8 uint vertex_indices".into());
                if self.faces == Faces::Mixed {
                    header.push("property list int8 float texcoord".into());
                    header.push("property uchar flags".into());
                    header.push("property uchar more_flags".into());
                    header.push("element edge 2".into());
                    header.push("property int vertex1".into());
                }
            }
        }
        header.push("obj_info Unix".into());
        header.push("end_header".into());
        let mut bytes = (header.join(self.line_end) + self.line_end).into_bytes();
        let mut data = Data { encoding: self.encoding, bytes: &mut bytes };

        if self.element_before {
            for camera in 0..2 {
                data.list("uint16", "int8", &vec![65.0; camera * 3]);
                data.put("double", 0.1);
            }
        }
        for (i, vertex) in vertices.iter().enumerate() {
            for &p in &self.order {
                if let Some(kind) = self.kind(p) {
                    data.put(kind, *vertex.get(p).unwrap_or(&(i as f64 % 128.0)));
                }
                if p == 4 && self.list_in_vertex {
                    data.list("uchar", "short", &vec![-7.0; i * i % 5]);
                }
            }
            data.line(self.line_end);
        }
        match self.faces {
            Faces::None => {}
            Faces::Strips => data.list("int", "int", &vec![1.0; vertices.len()]),
            Faces::Triangles | Faces::Mixed => {
                for face in 0..faces {
                    let mixed = self.faces == Faces::Mixed;
                    if mixed {
                        data.put("short", 300.0);
                    }
                    let corners = if mixed { 3 + face % 3 } else { 3 };
                    data.list("uchar", "uint", &vec![1.0; corners]);
                    if mixed {
                        data.list("int8", "float", &vec![0.5; face % 2]);
                        data.put("uchar", 9.0);
                        data.put("uchar", 9.0);
                    }
                    data.line(self.line_end);
                }
                if self.faces == Faces::Mixed {
                    data.put("int", 1.0);
                    data.put("int", 2.0);
                }
            }
        }
        bytes.extend_from_slice(self.tail);
        bytes
    }

    /// A value as the file can hold it.
    fn round(&self, component: usize, value: f64) -> f64 {
        if self.kind(component) == Some("float") { f64::from(value as f32) } else { value }
    }

    fn expected(&self, vertices: &[[f64; 6]]) -> (Vec<DVec3>, Vec<Vec3>) {
        let at = |v: &[f64; 6], c| self.round(c, v[c]);
        let positions = vertices.iter().map(|v| DVec3::new(at(v, 0), at(v, 1), at(v, 2))).collect();
        let normals = vertices.iter().map(|v| DVec3::new(at(v, 3), at(v, 4), at(v, 5)).as_vec3());
        (positions, if self.normal.is_some() { normals.collect() } else { Vec::new() })
    }
}

struct Data<'a> {
    encoding: Encoding,
    bytes: &'a mut Vec<u8>,
}

impl Data<'_> {
    fn put(&mut self, kind: &str, value: f64) {
        let mut bytes = match kind {
            "char" | "int8" => (value as i8).to_le_bytes().to_vec(),
            "uchar" | "uint8" => (value as u8).to_le_bytes().to_vec(),
            "short" | "int16" => (value as i16).to_le_bytes().to_vec(),
            "ushort" | "uint16" => (value as u16).to_le_bytes().to_vec(),
            "int" | "int32" => (value as i32).to_le_bytes().to_vec(),
            "uint" | "uint32" => (value as u32).to_le_bytes().to_vec(),
            "float" | "float32" => (value as f32).to_le_bytes().to_vec(),
            _ => value.to_le_bytes().to_vec(),
        };
        match self.encoding {
            Little => {}
            Big => bytes.reverse(),
            Ascii if kind == "float" => bytes = format!("{} ", value as f32).into_bytes(),
            Ascii => bytes = format!("{value} ").into_bytes(),
        }
        self.bytes.extend_from_slice(&bytes);
    }

    fn list(&mut self, count: &str, item: &str, values: &[f64]) {
        self.put(count, values.len() as f64);
        for value in values {
            self.put(item, *value);
        }
    }

    fn line(&mut self, end: &str) {
        if self.encoding == Ascii {
            self.bytes.extend_from_slice(end.as_bytes());
        }
    }
}

fn temp(bytes: &[u8]) -> NamedTempFile {
    let mut file = tempfile::Builder::new().suffix(".ply").tempfile().unwrap();
    file.write_all(bytes).unwrap();
    file
}

fn open(bytes: &[u8]) -> Result<Box<dyn Model>> {
    // The open file outlives its name.
    simod_model::open(temp(bytes).path())
}

fn read(model: &dyn Model, range: Range<u64>) -> Result<(Vec<DVec3>, Vec<Vec3>)> {
    let mut reader = model.vertices(range.clone())?;
    let mut chunk = VertexChunk::default();
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    while reader.read(&mut chunk)? {
        assert!(!chunk.is_empty() && chunk.len() <= CHUNK_VERTICES);
        assert_eq!(chunk.first, range.start + positions.len() as u64);
        positions.extend_from_slice(&chunk.positions);
        normals.extend_from_slice(&chunk.normals);
    }
    assert!(chunk.is_empty() && !reader.read(&mut chunk)?);
    Ok((positions, normals))
}

fn rewrite(model: &dyn Model, edit: impl FnMut(&mut Edited) + Send) -> Result<Vec<u8>> {
    rewrite_as(model, Normals::Transform, edit)
}

fn rewrite_as(model: &dyn Model, normals: Normals, edit: impl FnMut(&mut Edited) + Send) -> Result<Vec<u8>> {
    let (mut out, edit) = (Vec::new(), Mutex::new(edit));
    let edit = |_: &VertexChunk, versions: &mut [Edited]| {
        versions.iter_mut().for_each(&mut *edit.lock().unwrap());
        Ok(())
    };
    model.rewrite(&mut [&mut out], Rewriting { normals, ..Rewriting::default() }, &edit, &Silent)?;
    Ok(out)
}

/// Bits, so that NaN equals itself.
fn bits((positions, normals): &(Vec<DVec3>, Vec<Vec3>)) -> (Vec<[u64; 3]>, Vec<[u32; 3]>) {
    let one = |v: f64| if v.is_nan() { f64::NAN.to_bits() } else { v.to_bits() };
    let one32 = |v: f32| if v.is_nan() { f32::NAN.to_bits() } else { v.to_bits() };
    (
        positions.iter().map(|p| p.to_array().map(one)).collect(),
        normals.iter().map(|n| n.to_array().map(one32)).collect(),
    )
}

fn grid(count: usize) -> Vec<[f64; 6]> {
    (0..count)
        .map(|i| {
            let i = i as f64;
            [i * 0.25, (i * 0.37).sin(), -i / 3.0, 0.0, (i * 0.1).cos(), (i * 0.1).sin()]
        })
        .collect()
}

fn message(result: Result<impl Sized>) -> String {
    match result {
        Ok(_) => panic!("no error"),
        Err(e) => {
            assert!(!e.hint().is_empty());
            // Without the folder, which differs.
            let text = e.to_string();
            text.split_once(".ply").map_or(text.clone(), |(_, rest)| rest.trim_start_matches(": ").into())
        }
    }
}

fn specs() -> impl Strategy<Value = Spec> {
    let float = || prop_oneof![Just("float"), Just("double")];
    let faces =
        prop_oneof![Just(Faces::None), Just(Faces::Triangles), Just(Faces::Mixed), Just(Faces::Strips)];
    let tail: &[&[u8]] = &[b"", b"\n", b"and more", &[0, 255, 13, 10]];
    (
        (prop::sample::select(&ENCODINGS[..]), [float(), float(), float()], prop::option::of(float())),
        Just((0..8).collect::<Vec<_>>()).prop_shuffle(),
        (any::<bool>(), any::<bool>(), any::<bool>(), faces),
        prop::sample::select(vec!["\n", "\r\n", "\r"]),
        prop::sample::select(tail.to_vec()),
    )
        .prop_map(|(types, order, parts, line_end, tail)| Spec {
            encoding: types.0,
            position: types.1,
            normal: types.2,
            order,
            colour: parts.0,
            list_in_vertex: parts.1,
            element_before: parts.2,
            faces: parts.3,
            line_end,
            tail,
        })
}

fn vertices() -> impl Strategy<Value = Vec<[f64; 6]>> {
    let value = prop_oneof![
        60 => -1000.0..1000.0f64,
        1 => prop::sample::select(vec![0.0, -0.0, 1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e15, 1e-4]),
    ];
    prop::collection::vec(prop::array::uniform6(value), 0..40)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..Default::default() })]

    #[test]
    fn files_of_every_sort_are_read_and_rewritten(spec in specs(), vertices in vertices(), cut in 0..40u64) {
        let bytes = spec.build(&vertices);
        let model = open(&bytes).unwrap();
        let info = model.info();
        prop_assert_eq!(info.vertices, vertices.len() as u64);
        prop_assert_eq!(info.bytes, bytes.len() as u64);
        prop_assert_eq!(info.has_normals, spec.normal.is_some());
        prop_assert_eq!(info.position_type == Scalar::F64, spec.position.contains(&"double"));
        prop_assert_eq!(info.other_properties.len(), 2 * usize::from(spec.colour) + usize::from(spec.list_in_vertex));
        model.check_complete(&Silent).unwrap();

        let all = read(&*model, 0..u64::MAX).unwrap();
        prop_assert_eq!(bits(&all), bits(&spec.expected(&vertices)));
        let cut = cut.min(info.vertices);
        let tail = read(&*model, cut..info.vertices).unwrap();
        prop_assert_eq!(bits(&tail).0, bits(&all).0.split_off(cut as usize));

        // The bytes are compared as strings, so that a difference is printed in full.
        let same = rewrite(&*model, |_| {}).unwrap();
        prop_assert!(same == bytes, "{:?}\n{:?}", same.escape_ascii().to_string(), bytes.escape_ascii().to_string());

        // An edited file is the file made from edited vertices.
        let shift = DVec3::new(0.5, 0.0, -2.0);
        let mut moved = vertices.clone();
        for vertex in moved.iter_mut() {
            let p: [f64; 3] = std::array::from_fn(|c| spec.round(c, vertex[c]));
            let p = DVec3::from_array(p);
            if p.is_finite() {
                vertex[..3].copy_from_slice(&(p + shift).to_array());
                for (c, v) in vertex.iter_mut().enumerate().skip(3).filter(|(_, v)| !v.is_nan()) {
                    *v = -f64::from(spec.round(c, *v) as f32);
                }
            }
        }
        let edited = rewrite(&*model, |chunk| {
            chunk.positions.iter_mut().for_each(|p| *p += shift);
            chunk.normals.iter_mut().for_each(|n| *n = -*n);
        }).unwrap();
        // In text, numbers too large for `Display` differ, and those that are not finite.
        if spec.encoding != Ascii || vertices.iter().flatten().all(|x| x.abs() < 1e14) {
            let expected = spec.build(&moved);
            prop_assert_eq!(edited.escape_ascii().to_string(), expected.escape_ascii().to_string());
        }
        let again = open(&edited).unwrap();
        prop_assert_eq!(bits(&read(&*again, 0..u64::MAX).unwrap()), bits(&spec.expected(&moved)));

        // Without normals it is the file made without them.
        let shifted = |normals| rewrite_as(&*model, normals, |chunk| {
            chunk.positions.iter_mut().for_each(|p| *p += shift);
        }).unwrap();
        let kept = shifted(Normals::Keep);
        let dropped = shifted(Normals::Drop);
        let without = Spec { normal: None, ..spec.clone() };
        prop_assert_eq!(
            rewrite_as(&*open(&kept).unwrap(), Normals::Drop, |_| {}).unwrap().escape_ascii().to_string(),
            dropped.escape_ascii().to_string()
        );
        if spec.encoding != Ascii || vertices.iter().flatten().all(|x| x.abs() < 1e14) {
            prop_assert_eq!(dropped.escape_ascii().to_string(), without.build(&moved).escape_ascii().to_string());
        }
        let again = open(&dropped).unwrap();
        prop_assert!(!again.info().has_normals);
        prop_assert_eq!(bits(&read(&*again, 0..u64::MAX).unwrap()), bits(&without.expected(&moved)));
        let normals = read(&*open(&kept).unwrap(), 0..u64::MAX).unwrap().1;
        prop_assert_eq!(bits(&(Vec::new(), normals)).1, bits(&all).1);
    }

    #[test]
    fn versions_of_one_reading_are_those_of_several(spec in specs(), vertices in vertices(), drop in any::<bool>()) {
        let model = open(&spec.build(&vertices)).unwrap();
        let normals = if drop { Normals::Drop } else { Normals::Transform };
        let edit = |version: usize, edited: &mut Edited| {
            edited.positions.iter_mut().for_each(|p| p.y += version as f64);
            edited.normals.iter_mut().for_each(|n| *n *= version as f32);
        };
        let mut together = vec![Vec::new(); 4];
        let mut outputs: Vec<&mut dyn Output> = together.iter_mut().map(|o| o as &mut dyn Output).collect();
        let how = Rewriting { normals, ..Rewriting::default() };
        model.rewrite(
            &mut outputs,
            how,
            &|chunk: &VertexChunk, versions: &mut [Edited]| {
                assert_eq!(versions.len(), 4);
                for (version, edited) in versions.iter_mut().enumerate() {
                    assert_eq!(bits(&(edited.positions.clone(), vec![])), bits(&(chunk.positions.clone(), vec![])));
                    edit(version, edited);
                }
                Ok(())
            },
            &Silent,
        ).unwrap();
        for (version, bytes) in together.into_iter().enumerate() {
            let alone = rewrite_as(&*model, normals, |edited| edit(version, edited)).unwrap();
            prop_assert!(alone == bytes, "version {}", version);
        }
    }

    #[test]
    fn random_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 1..200), ply in any::<bool>()) {
        if ply {
            bytes.splice(..0, *b"ply\nformat ascii 1.0\nelement vertex 2\n");
        }
        exhaust(&bytes).ok();
    }

    #[test]
    fn spoilt_files_never_panic(
        spec in specs(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4usize), 1..6),
    ) {
        let mut bytes = spec.build(&grid(6));
        for (at, byte, action) in changes {
            let at = at.index(bytes.len());
            match action {
                0 => bytes[at] = byte,
                1 => bytes[at] = b'0' + byte % 10,
                2 => bytes.insert(at, byte),
                _ => { bytes.remove(at); }
            }
        }
        exhaust(&bytes).ok();
    }
}

/// Reads and rewrites a file in all ways, up to the first error.
fn exhaust(bytes: &[u8]) -> Result<()> {
    let model = open(bytes)?;
    model.check_complete(&Silent)?;
    read(&*model, 0..u64::MAX)?;
    read(&*model, 1..3)?;
    assert_eq!(rewrite(&*model, |_| {})?, bytes);
    Ok(())
}

#[test]
fn every_truncation_is_an_error() {
    for encoding in ENCODINGS {
        for faces in [Faces::None, Faces::Triangles, Faces::Mixed, Faces::Strips] {
            for spec in [Spec::new(encoding), Spec::difficult(encoding)] {
                let spec = Spec { faces, ..spec };
                // All last numbers of the text are of one digit: of longer ones nobody could tell that they
                // are cut.
                let mut vertices = grid(5);
                vertices[4] = [1.0; 6];
                let bytes = spec.build(&vertices);
                exhaust(&bytes).unwrap();
                let complete = match encoding {
                    Ascii => bytes.trim_ascii_end().len(),
                    Little | Big => bytes.len(),
                };
                for end in 0..complete {
                    assert!(exhaust(&bytes[..end]).is_err(), "{spec:?} cut to {end} of {complete}");
                    if encoding != Ascii {
                        assert!(open(&bytes[..end]).is_err(), "{spec:?} opened when cut to {end}");
                    } else if let Ok(model) = open(&bytes[..end]) {
                        assert!(model.check_complete(&Silent).is_err(), "{spec:?} cut to {end}");
                        assert!(rewrite(&*model, |_| {}).is_err(), "{spec:?} cut to {end}");
                    }
                }
                for end in complete..bytes.len() {
                    exhaust(&bytes[..end]).unwrap();
                }
            }
        }
    }
}

#[test]
fn large_files_are_read_from_anywhere() {
    let vertices = grid(200_000);
    for (encoding, list_in_vertex) in [(Ascii, false), (Little, false), (Big, true)] {
        let spec = Spec { list_in_vertex, ..Spec::new(encoding) };
        let bytes = spec.build(&vertices);
        let model = open(&bytes).unwrap();
        let expected = spec.expected(&vertices);
        for range in [199_999..200_000, 70_000..140_000, 0..200_000, 131_072..131_073, 65_530..65_550, 7..7] {
            let (positions, normals) = read(&*model, range.clone()).unwrap();
            let range = range.start as usize..range.end as usize;
            assert!(positions == expected.0[range.clone()], "{spec:?} {range:?}");
            assert!(normals == expected.1[range.clone()], "{spec:?} {range:?}");
        }
        assert!(rewrite(&*model, |_| {}).unwrap() == bytes);
        // The vertex bytes are what the chunks hold.
        let mut reader = model.vertices(0..u64::MAX).unwrap();
        let (mut chunk, mut raw) = (VertexChunk::default(), 0);
        while reader.read(&mut chunk).unwrap() {
            raw += chunk.raw().len() as u64;
        }
        if encoding == Ascii {
            let ratio = model.info().vertex_bytes as f64 / raw as f64;
            assert!((0.8..1.2).contains(&ratio), "{ratio}");
        } else {
            assert_eq!(model.info().vertex_bytes, raw);
        }
    }
}

#[test]
fn a_large_file_cut_off_is_noticed_when_opened() {
    for faces in [Faces::Triangles, Faces::Mixed] {
        let spec = Spec { faces, ..Spec::new(Little) };
        let bytes = spec.build(&grid(300_000));
        open(&bytes).unwrap();
        for cut in [1, 13, 26, 130_013, 1_300_000] {
            let text = message(open(&bytes[..bytes.len() - cut]));
            assert!(
                text.contains("the file ends within element ") || text.contains("are left for them"),
                "{text}"
            );
        }
        // Bytes behind the faces are not the model's.
        let mut longer = bytes.clone();
        longer.extend_from_slice(&[3; 26]);
        assert!(rewrite(&*open(&longer).unwrap(), |_| {}).unwrap() == longer);
    }
}

#[test]
fn a_length_that_fits_by_chance_does_not_pass() {
    let spec = Spec { faces: Faces::Mixed, ..Spec::new(Little) };
    let bytes = spec.build(&grid(300_000));
    // The file is as long as if all faces were like the first one: group, triangle, no texcoord, flags; and
    // two edges.
    let faces = 150_000;
    let first = 2 + 1 + 3 * 4 + 1 + 2;
    let all: usize = (0..faces).map(|face| first + face % 3 * 4 + face % 2 * 4).sum();
    let start = bytes.len() - all - 8;
    assert!(open(&bytes[..start + faces * first + 8]).is_err());
}

#[test]
fn elements_after_triangles_count() {
    let bytes = Spec::new(Little).build(&grid(300_000));
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap();
    let (header, data) = bytes.split_at(end);
    let bytes = [header, b"element edge 3\nproperty double d\n", data, &[1; 24]].concat();
    assert!(rewrite(&*open(&bytes).unwrap(), |_| {}).unwrap() == bytes);
    for cut in [1, 8, 24, 25] {
        assert!(open(&bytes[..bytes.len() - cut]).is_err());
    }
}

#[test]
fn a_model_can_be_rewritten_in_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let spec = Spec::new(Big);
    let mut vertices = grid(100_000);
    write_file(&path, &spec.build(&vertices)).unwrap();
    let model = simod_model::open(&path).unwrap();
    let double = |_: &VertexChunk, versions: &mut [Edited]| {
        versions[0].positions.iter_mut().for_each(|p| *p *= 2.0);
        Ok(())
    };
    let begin = || OutputFile::create(&path, model.info().bytes).unwrap();
    let cancel = CancelAfter(1_000_000, AtomicU64::new(0));
    model.rewrite(&mut [&mut begin()], Rewriting::default(), &double, &cancel).unwrap_err();
    assert!(fs::read(&path).unwrap() == spec.build(&vertices));
    let mut out = begin();
    model.rewrite(&mut [&mut out], Rewriting::default(), &double, &Silent).unwrap();
    out.commit().unwrap();
    vertices.iter_mut().for_each(|v| v[..3].iter_mut().for_each(|x| *x *= 2.0));
    assert!(fs::read(&path).unwrap() == spec.build(&vertices));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn vertices_that_are_not_finite_keep_their_bytes() {
    for encoding in [Little, Big] {
        let spec = Spec { faces: Faces::None, ..Spec::new(encoding) };
        let mut bytes = spec.build(&grid(3));
        // A signalling NaN with a payload in y of the second vertex, and another in nx of the third.
        let data = bytes.len() - 3 * 24;
        let nan =
            if encoding == Little { 0x7fa1_2345u32.to_le_bytes() } else { 0x7fa1_2345u32.to_be_bytes() };
        bytes[data + 24 + 4..][..4].copy_from_slice(&nan);
        bytes[data + 48 + 12..][..4].copy_from_slice(&nan);
        let model = open(&bytes).unwrap();
        assert_eq!(rewrite(&*model, |_| {}).unwrap(), bytes);
        let edited = rewrite(&*model, |chunk| {
            assert!(chunk.positions[1].y.is_nan() && chunk.normals[2].x.is_nan());
            chunk.positions.fill(DVec3::ONE);
            chunk.normals.fill(Vec3::ONE);
        })
        .unwrap();
        assert_eq!(edited[..data], bytes[..data]);
        assert_eq!(edited[data + 24..data + 48], bytes[data + 24..data + 48]);
        assert_ne!(edited[data..data + 4], bytes[data..data + 4]);
    }
    let text =
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        end_header\nNAN 1 2\n1 -1.#IND -inf\n 1.50  +2. 3e0 rest";
    let model = open(text).unwrap();
    let edited = rewrite(&*model, |chunk| chunk.positions.iter_mut().for_each(|p| p.z += 0.1)).unwrap();
    assert_eq!(edited, String::from_utf8_lossy(text).replace("3e0", "3.1").into_bytes());
}

#[test]
fn text_numbers_are_short_and_exact() {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n\
        end_header\n1 1 1\n1 1 1\n1 1 1\n1 1 1\n";
    let model = open(text.as_bytes()).unwrap();
    let values = [0.1f64, 1.0 / 3.0, 1e-30, -3e38];
    let edited = rewrite(&*model, |chunk| {
        for (p, v) in chunk.positions.iter_mut().zip(values) {
            (p.x, p.y) = (v, v);
        }
    })
    .unwrap();
    let edited = String::from_utf8(edited).unwrap();
    let data = edited.split("end_header\n").nth(1).unwrap();
    assert_eq!(data, "0.1 0.1 1\n0.33333334 0.3333333333333333 1\n1e-30 1e-30 1\n-3e38 -3e38 1\n");
}

#[test]
fn what_an_edit_may_not_do_is_an_error() {
    for encoding in ENCODINGS {
        let model = open(&Spec::new(encoding).build(&grid(9))).unwrap();
        let to = |value: f64| rewrite(&*model, |chunk| chunk.positions[4].y = value);
        assert_eq!(message(to(f64::NAN)), "the deformation moves vertex 4 to NaN");
        let far = message(to(1e40));
        assert!(
            far.starts_with("vertex 4 moves to 1") && far.ends_with("too far for the type float of the file")
        );
        to(1e38).unwrap();
        let fewer = message(rewrite(&*model, |chunk| chunk.positions.truncate(3)));
        assert_eq!(fewer, "the 9 vertices from 0 on came back as 3");
        message(rewrite(&*model, |chunk| chunk.normals.clear()));
        message(rewrite(&*model, |chunk| *chunk = Edited::default()));
    }
}

/// The outputs get what comes after the pieces that they have, and the edit sees all of the model.
#[test]
fn pieces_that_are_done_are_read_alone() {
    for (encoding, normals) in [(Little, Normals::Transform), (Big, Normals::Drop), (Ascii, Normals::Keep)] {
        let spec = Spec { faces: Faces::Mixed, element_before: true, ..Spec::new(encoding) };
        let model = open(&spec.build(&grid(3 * CHUNK_VERTICES))).unwrap();
        let rewrite = |pieces_done| {
            let (mut out, counting) = (Pieces::default(), Counting::default());
            let how = Rewriting { normals, pieces_done, ..Rewriting::default() };
            model.rewrite(&mut [&mut out], how, &counting, &Silent).unwrap();
            let Counting { begun, raw, edited, ended } = counting;
            let [begun, ended] = [begun, ended].map(|firsts| firsts.into_inner().unwrap());
            assert!(
                begun.is_sorted() && begun.ends_with(&ended) && ended.len() == edited.load(Ordering::Relaxed)
            );
            (out.0, raw.into_inner(), edited.into_inner())
        };
        let (pieces, raw, edited) = rewrite(0);
        assert!(pieces.len() > 4 && edited >= 3);
        for done in 1..=pieces.len() {
            let (rest, raw_again, edited_again) = rewrite(done as u64);
            assert!(rest == pieces[done..], "after {done} of {} pieces", pieces.len());
            assert_eq!(raw_again, raw);
            assert!(edited_again <= edited && edited_again + done >= edited);
        }
    }
}

/// Pieces that are edited as one are counted as many, and do not reach over what is done.
#[test]
fn pieces_that_are_edited_at_once_stay_what_they_are() {
    let spec = Spec { faces: Faces::Mixed, element_before: true, ..Spec::new(Little) };
    let model = open(&spec.build(&grid(4 * CHUNK_VERTICES + 5))).unwrap();
    let normals = Normals::Transform;
    let (mut apart, counting) = (Pieces::default(), Counting::default());
    model
        .rewrite(&mut [&mut apart], Rewriting { normals, ..Rewriting::default() }, &counting, &Silent)
        .unwrap();
    let chunks = counting.edited.into_inner();
    assert!(chunks >= 5);
    for pieces_at_once in [2, 3, 100] {
        for done in 0..=apart.0.len() {
            let (mut out, counting) = (CountedPieces::default(), Counting::default());
            let how = Rewriting { normals, pieces_done: done as u64, pieces_at_once, ..Rewriting::default() };
            model.rewrite(&mut [&mut out], how, &counting, &Silent).unwrap();
            assert_eq!((done as u64 + out.pieces) as usize, apart.0.len());
            assert!(out.bytes == apart.0[done..].concat(), "{pieces_at_once} at once, after {done}");
            assert!(done > 0 || counting.edited.into_inner() < chunks);
        }
    }
}

/// Bytes that the output was given, and the number of pieces that these were said to be.
#[derive(Default)]
struct CountedPieces {
    bytes: Vec<u8>,
    pieces: u64,
}

impl Output for CountedPieces {
    fn write_pieces(&mut self, pieces: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.bytes.extend_from_slice(bytes);
        self.pieces += pieces;
        Ok(())
    }

    fn patch(&mut self, _at: u64, _bytes: &[u8]) -> io::Result<()> {
        unreachable!("nothing of PLY is replaced")
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Edit that moves all vertices, and counts the calls.
#[derive(Default)]
struct Counting {
    begun: Mutex<Vec<u64>>,
    raw: AtomicUsize,
    edited: AtomicUsize,
    ended: Mutex<Vec<u64>>,
}

impl Edit for Counting {
    fn begin(&self, chunk: &RawChunk<'_>) -> Result<()> {
        self.begun.lock().unwrap().push(chunk.first);
        self.raw.fetch_add(chunk.bytes.len(), Ordering::Relaxed);
        Ok(())
    }

    fn edit(&self, _chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        self.edited.fetch_add(versions.len(), Ordering::Relaxed);
        versions.iter_mut().for_each(|v| v.positions.iter_mut().for_each(|p| p.x += 1.0));
        Ok(())
    }

    fn end(&self, first: u64) -> Result<()> {
        self.ended.lock().unwrap().push(first);
        Ok(())
    }
}

/// Bytes that were written, piece by piece.
#[derive(Default)]
struct Pieces(Vec<Vec<u8>>);

impl Output for Pieces {
    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> io::Result<()> {
        self.0.push(bytes.to_vec());
        Ok(())
    }

    fn patch(&mut self, _at: u64, _bytes: &[u8]) -> io::Result<()> {
        unreachable!("PLY says nothing of what comes later")
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn more_versions_than_memory_is_held_for_are_refused() {
    let model = open(&Spec::new(Little).build(&grid(3))).unwrap();
    let mut outputs: Vec<Vec<u8>> = vec![Vec::new(); MAX_VERSIONS + 1];
    let mut outputs: Vec<&mut dyn Output> = outputs.iter_mut().map(|o| o as &mut dyn Output).collect();
    let result = model.rewrite(
        &mut outputs,
        Rewriting::default(),
        &|_: &VertexChunk, _: &mut [Edited]| Ok(()),
        &Silent,
    );
    assert_eq!(result.unwrap_err().kind(), ErrorKind::Argument);
}

#[test]
fn text_without_normals_keeps_its_form() {
    let header = |normals: &str| {
        format!(
            "ply\nformat ascii 1.0\ncomment property float nx\nelement vertex 3\nproperty float x\n{normals}property \
             float y\nproperty float z\nelement other 1\nproperty float nx\nend_header\n"
        )
    };
    let with = header("property float nx\nproperty float ny\n property  float nz \n");
    let text = with + "1 0 0 1 2 3\n  4\t.5 .5 .5  5 6 \n nan 1 1 1 8 9\n7\n";
    let dropped = rewrite_as(&*open(text.as_bytes()).unwrap(), Normals::Drop, |_| {}).unwrap();
    let expected = header("") + "1 2 3\n  4  5 6 \n nan 8 9\n7\n";
    assert_eq!(String::from_utf8(dropped).unwrap(), expected);
}

fn three_chunks(encoding: Encoding) -> Box<dyn Model> {
    let spec = Spec { faces: Faces::Mixed, ..Spec::new(encoding) };
    open(&spec.build(&grid(3 * CHUNK_VERTICES))).unwrap()
}

/// The first one of several chunks that fail, perhaps at the same time, is reported, and all chunks before it
/// are written.
#[test]
fn an_error_of_the_edit_stops_everything() {
    for encoding in [Little, Ascii] {
        let bytes = Spec { faces: Faces::Mixed, ..Spec::new(encoding) }.build(&grid(5 * CHUNK_VERTICES));
        let model = open(&bytes).unwrap();
        let of_chunks = Counting::default();
        model.rewrite(&mut [&mut io::sink()], Rewriting::default(), &of_chunks, &Silent).unwrap();
        let begun = of_chunks.begun.into_inner().unwrap();
        assert!(begun.len() >= 5);
        let fail = |chunk: &VertexChunk, _: &mut [Edited]| match chunk.first {
            0 => Ok(()),
            first => Err(Error::plugin(format!("no to {first}"), "never")),
        };
        for _ in 0..20 {
            let mut out = Vec::new();
            let error = model.rewrite(&mut [&mut out], Rewriting::default(), &fail, &Silent).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Plugin);
            assert_eq!(error.to_string(), format!("no to {}", begun[1]));
            assert!(bytes.starts_with(&out) && out.len() > bytes.len() / 20, "{}", out.len());
        }
    }
}

/// Output that takes so many bytes, and then is full.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = bytes.len().min(self.0);
        self.0 -= taken;
        if taken == 0 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(taken) }
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.0 == 0 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }
}

#[test]
fn an_error_of_the_output_stops_everything() {
    let model = three_chunks(Little);
    let bytes = model.info().bytes as usize;
    for room in [0, 10, 1000, bytes / 2, bytes - 1, bytes] {
        let result = model.rewrite(
            &mut [&mut Full(room)],
            Rewriting::default(),
            &|_: &VertexChunk, _: &mut [Edited]| Ok(()),
            &Silent,
        );
        let error = result.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Io);
        assert!(error.to_string().starts_with("cannot write the new version of"), "{error}");
    }
    model
        .rewrite(
            &mut [&mut Full(bytes + 1)],
            Rewriting::default(),
            &|_: &VertexChunk, _: &mut [Edited]| Ok(()),
            &Silent,
        )
        .unwrap();
}

/// Cancels after so many bytes; counts them.
struct CancelAfter(u64, AtomicU64);

impl Progress for CancelAfter {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, bytes: u64) {
        self.1.fetch_add(bytes, Ordering::Relaxed);
    }
    fn is_cancelled(&self) -> bool {
        self.1.load(Ordering::Relaxed) >= self.0
    }
}

#[test]
fn cancelling_stops_everything() {
    for encoding in [Little, Ascii] {
        let model = three_chunks(encoding);
        let bytes = model.info().bytes;
        for after in [0, 1, bytes / 2] {
            let progress = CancelAfter(after, AtomicU64::new(0));
            let result = model.rewrite(
                &mut [&mut io::sink()],
                Rewriting::default(),
                &|_: &VertexChunk, _: &mut [Edited]| Ok(()),
                &progress,
            );
            assert_eq!(result.unwrap_err().kind(), ErrorKind::Cancelled);
        }
        let progress = CancelAfter(u64::MAX, AtomicU64::new(0));
        model
            .rewrite(
                &mut [&mut io::sink()],
                Rewriting::default(),
                &|_: &VertexChunk, _: &mut [Edited]| Ok(()),
                &progress,
            )
            .unwrap();
        assert_eq!(progress.1.into_inner(), bytes);
    }
}

#[test]
fn a_panic_of_the_edit_comes_through() {
    let model = three_chunks(Little);
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let mut calls = 0;
        rewrite(&*model, |_| {
            calls += 1;
            assert!(calls == 1, "as it should");
        })
    }));
    assert!(result.is_err());
}

#[test]
fn a_file_that_changes_its_length_is_an_error() {
    let file = temp(&Spec::new(Little).build(&grid(200_000)));
    let model = simod_model::open(file.path()).unwrap();
    let length = model.info().bytes;
    for changed in [length + 1, length - 1, 1000] {
        file.as_file().set_len(changed).unwrap();
        assert_eq!(rewrite(&*model, |_| {}).unwrap_err().kind(), ErrorKind::Mismatch);
        assert_eq!(model.check_complete(&Silent).unwrap_err().kind(), ErrorKind::Mismatch);
    }
    assert_eq!(read(&*model, 0..u64::MAX).unwrap_err().kind(), ErrorKind::Mismatch);
}

#[test]
fn lying_headers_are_named() {
    let header = |lines: &str| format!("ply\nformat binary_little_endian 1.0\n{lines}\nend_header\n");
    let xyz = "property float x\nproperty float y\nproperty float z";
    let with = |lines: &str, data: &[u8]| message(open(&[header(lines).as_bytes(), data].concat()));
    assert_eq!(
        with(&format!("element vertex 1000000\n{xyz}"), &[0; 24]),
        "says 1000000 vertices of 12 bytes each, but only 24 bytes follow the header"
    );
    assert_eq!(
        with(&format!("element vertex 18446744073709551615\n{xyz}"), &[0; 24]),
        "says 18446744073709551615 vertices of 12 bytes each, but only 24 bytes follow the header"
    );
    assert_eq!(
        with(&format!("element vertex 1\n{xyz}\nelement face 9\nproperty list uchar int i"), &[0; 20]),
        "says 9 records of element \"face\" of at least 1 bytes each, but only 8 bytes are left for them"
    );
    assert_eq!(
        with(&format!("element vertex 1\n{xyz}\nelement face 2\nproperty list char int i"), &[255; 14]),
        "element \"face\", record 0: a list of length -1"
    );
    assert_eq!(
        with(&format!("element vertex 1\n{xyz}\nproperty list char int i"), &[255; 14]),
        "element \"vertex\", record 0: a list of length -1"
    );
    assert_eq!(with("element vertex 0", b""), "the vertices have no property x");
    assert_eq!(with("element face 0", b""), "the header has no element \"vertex\"");
    assert_eq!(
        with(&format!("element vertex 0\n{xyz}\nelement vertex 0"), b""),
        "the header has two elements \"vertex\""
    );
    assert_eq!(with(&format!("element vertex 0\n{xyz}\n{xyz}"), b""), "the vertices have two properties x");
    assert_eq!(
        with("element vertex 0\nproperty int x\nproperty int y\nproperty int z", b""),
        "property x of the vertices is \"int x\""
    );
    let text = format!("ply\nformat ascii 1.0\nelement vertex 1000\n{xyz}\nend_header\n1 2 3");
    assert_eq!(
        message(open(text.as_bytes())),
        "says 1000 records of element \"vertex\" of 3 numbers each, but only 5 bytes are left for them"
    );
    let text = format!("ply\nformat ascii 1.0\nelement vertex 2\n{xyz}\nend_header\n1 2 3\n4 five 6\n");
    let model = open(text.as_bytes()).unwrap();
    assert_eq!(message(read(&*model, 0..2)), "vertex 1: y \"five\" is no number");
    assert_eq!(message(rewrite(&*model, |_| {})), "vertex 1: y \"five\" is no number");
}

#[test]
fn files_that_are_no_models_are_named() {
    assert_eq!(message(open(b"a solid cube")), "no model of a known format: it begins with \"a solid cube\"");
    assert!(message(open(b"")).ends_with("is empty"));
    assert!(message(open(b"ply\nformat ascii")).ends_with("the file ends within its header"));
    let endless = b"ply\nformat ascii 1.0\n".iter().copied().chain(b"comment\n".iter().copied().cycle());
    let endless: Vec<u8> = endless.take(3 << 20).collect();
    assert_eq!(message(open(&endless)), "no end_header within the first 1 MiB");
    let missing = simod_model::open(Path::new("no such file.ply")).err().unwrap();
    assert_eq!(missing.kind(), ErrorKind::Io);
    assert!(missing.to_string().starts_with("cannot open no such file.ply"));
    let folder = simod_model::open(&std::env::temp_dir()).err().unwrap();
    assert!(folder.hint().contains("not of a folder"));
    if cfg!(unix) {
        let device = simod_model::open(Path::new("/dev/null")).err().unwrap();
        assert_eq!(device.to_string(), "/dev/null is a pipe or a device, not a file");
    }
}

#[test]
fn a_record_without_end_is_an_error_not_memory() {
    let xyz = "property float x\nproperty float y\nproperty float z\nend_header\n1 2 ";
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex 2\n{xyz}").into_bytes();
    text.resize(40 << 20, b' ');
    let model = open(&text).unwrap();
    assert_eq!(message(read(&*model, 0..2)), "vertex 0 takes more than 16 MiB");
    text.fill(b'7');
    text[..xyz.len() + 40].copy_from_slice(&[b' '; 1].repeat(xyz.len() + 40));
    let head = format!("ply\nformat ascii 1.0\nelement vertex 2\n{xyz}");
    text[..head.len()].copy_from_slice(head.as_bytes());
    assert_eq!(message(read(&*open(&text).unwrap(), 0..2)), "vertex 0 takes more than 16 MiB");
}

#[test]
fn long_lists_are_read_and_rewritten() {
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let lists = "property list uint uchar l\nelement tristrips 1\nproperty list uint uchar l\nend_header\n";
    for encoding in [Ascii, Little] {
        let format = if encoding == Ascii { "ascii" } else { "binary_little_endian" };
        let mut bytes = format!("ply\nformat {format} 1.0\nelement vertex 3\n{xyz}{lists}").into_bytes();
        let mut data = Data { encoding, bytes: &mut bytes };
        for items in [0, 6_000_000, 5] {
            data.put("float", 1.0);
            data.put("float", 2.0);
            data.put("float", 3.0);
            data.put("uint", f64::from(items));
            data.bytes.extend(b"1 ".repeat(items as usize / if encoding == Ascii { 1 } else { 2 }));
            data.bytes.extend(&b"7"[..items as usize % 2 * usize::from(encoding != Ascii)]);
        }
        // Longer than a vertex may be, which does not matter elsewhere.
        data.put("uint", 20_000_000.0);
        data.bytes.extend(b"1 ".repeat(if encoding == Ascii { 20_000_000 } else { 10_000_000 }));
        let model = open(&bytes).unwrap();
        model.check_complete(&Silent).unwrap();
        assert!(rewrite(&*model, |_| {}).unwrap() == bytes);
        assert_eq!(read(&*model, 2..3).unwrap().0, [DVec3::new(1.0, 2.0, 3.0)]);
        let cut = open(&bytes[..bytes.len() - 2]);
        assert!(cut.and_then(|m| m.check_complete(&Silent)).is_err());
    }
}

#[test]
fn several_threads_read_at_once() {
    let vertices = grid(150_000);
    let spec = Spec::new(Ascii);
    let model = open(&spec.build(&vertices)).unwrap();
    let expected = spec.expected(&vertices).0;
    std::thread::scope(|scope| {
        for start in [0, 149_000, 70_000, 0] {
            let (model, expected) = (&*model, &expected);
            scope
                .spawn(move || assert!(read(model, start..150_000).unwrap().0 == expected[start as usize..]));
        }
    });
}

#[test]
fn zero_vertices_can_be_opened() {
    for encoding in ENCODINGS {
        for spec in [Spec::new(encoding), Spec::difficult(encoding)] {
            let bytes = spec.build(&[]);
            let model = open(&bytes).unwrap();
            assert_eq!((model.info().vertices, model.info().vertex_bytes), (0, 0));
            assert_eq!(rewrite(&*model, |_| panic!("no vertices")).unwrap(), bytes);
        }
    }
}

#[test]
fn normals_that_are_not_three_floats_are_other_properties() {
    let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property char nx\nproperty char ny\nproperty float nz\nend_header\n1 2 3 4 5 6\n";
    let model = open(text.as_bytes()).unwrap();
    assert!(!model.info().has_normals);
    assert_eq!(model.info().other_properties, ["char nx", "char ny", "float nz"]);
    let edited = rewrite(&*model, |chunk| chunk.positions[0] = DVec3::ZERO).unwrap();
    assert!(edited.ends_with(b"\n0 0 0 4 5 6\n"));
}

#[test]
fn our_own_point_sets_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("samples.ply");
    let vertices = grid(1000);
    for scalar in [Scalar::F32, Scalar::F64] {
        for has_normals in [false, true] {
            let kind = if scalar == Scalar::F32 { "float" } else { "double" };
            let spec =
                Spec { position: [kind; 3], normal: has_normals.then_some("float"), ..Spec::new(Little) };
            let (positions, normals) = spec.expected(&vertices);
            let comments = ["one".to_string(), "two\nend_header".to_string()];
            write_points(&path, positions.iter().copied(), &normals, &[], scalar, &comments).unwrap();
            let model = simod_model::open(&path).unwrap();
            assert_eq!(model.info().position_type, scalar);
            assert_eq!(read(&*model, 0..u64::MAX).unwrap(), (positions, normals));
        }
    }
    let far = write_points(&path, [DVec3::splat(1e300)].into_iter(), &[], &[], Scalar::F32, &[]).unwrap_err();
    assert_eq!(far.kind(), ErrorKind::Degenerate);
    let fewer =
        write_points(&path, [DVec3::ZERO; 2].into_iter(), &[Vec3::X], &[], Scalar::F32, &[]).unwrap_err();
    assert_eq!(fewer.kind(), ErrorKind::Mismatch);
    // The former file is still there, and no other.
    assert_eq!(simod_model::open(&path).unwrap().info().vertices, 1000);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
