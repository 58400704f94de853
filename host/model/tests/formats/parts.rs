//! Models that are written in parts, each by itself: together they are the file that is written at once.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use simod_model::{
    Besides, Conversion, Converted, Division, ErrorKind, PieceRange, RawChunk, Scalar, write_vertices,
};

use super::*;

/// Number of vertices: more than three pieces, and faces of more than one.
const VERTICES: u32 = 210_000;

/// A part of a file in memory.
#[derive(Default)]
struct Part {
    bytes: Vec<u8>,
    summary: Summary,
    is_patched: bool,
    begins: u64,
}

impl Output for Part {
    fn begin_at(&mut self, at: u64) -> io::Result<()> {
        self.begins = at;
        Ok(())
    }

    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, summary: &Summary) -> io::Result<()> {
        self.bytes.extend_from_slice(bytes);
        self.summary.absorb(summary);
        Ok(())
    }

    fn summary(&self) -> Summary {
        self.summary.clone()
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.is_patched = true;
        self.bytes[at as usize..at as usize + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A deformation, and what it was told of.
#[derive(Default)]
struct Twist {
    behind: AtomicU64,
    raw: Mutex<Vec<u8>>,
}

impl Edit for Twist {
    fn begin_behind(&self, vertex_bytes: u64) {
        self.behind.store(vertex_bytes, Ordering::Relaxed);
    }

    fn begin(&self, chunk: &RawChunk<'_>) -> Result<()> {
        self.raw.lock().unwrap().extend_from_slice(chunk.bytes);
        Ok(())
    }

    fn edit(&self, chunk: &VertexChunk, versions: &mut [Edited]) -> Result<()> {
        for (i, p) in versions[0].positions.iter_mut().enumerate() {
            // The model moves as a whole, and each vertex by itself.
            p.z += 0.25 * p.x + ((chunk.first + i as u64) % 7) as f64;
        }
        Ok(())
    }
}

fn write_range(
    model: &dyn Model,
    normals: Normals,
    (only, pieces_at_once): (Option<PieceRange>, u64),
    out: &mut Part,
) -> Twist {
    let (edit, how) = (Twist::default(), Rewriting { normals, only, pieces_at_once, ..Rewriting::default() });
    model.rewrite(&mut [out], how, &edit, &Silent).unwrap();
    edit
}

/// Writes a model at once, and in so many parts: the same.
fn check_parts(model: &dyn Model, normals: Normals) {
    let mut whole = Part::default();
    let all = write_range(model, normals, (None, 0), &mut whole).raw.into_inner().unwrap();
    let Division { pieces, vertices, in_place } = model.division(normals).unwrap();
    assert!(vertices.end <= pieces && vertices.end - vertices.start >= 3, "{vertices:?} of {pieces}");
    for parts in [1, 2, 3, pieces] {
        let (mut file, mut raw) = (Part::default(), Vec::new());
        for part in 0..parts {
            let [first, end] = [part, part + 1].map(|part| part * pieces / parts);
            let mut some = Part::default();
            let only = Some(PieceRange { first, end: Some(end) });
            let Twist { behind, raw: of_part } = write_range(model, normals, (only, 1 + part % 3), &mut some);
            assert!(!some.is_patched);
            if in_place {
                assert_eq!(some.begins, file.bytes.len() as u64, "part {part} of {parts}");
            }
            assert_eq!(behind.into_inner(), raw.len() as u64, "part {part} of {parts}");
            raw.append(&mut of_part.into_inner().unwrap());
            file.bytes.append(&mut some.bytes);
            file.summary.absorb(&some.summary);
        }
        let before_rest = file.bytes.len() as u64;
        let rest = Some(PieceRange { first: pieces, end: None });
        let told = write_range(model, normals, (rest, 2), &mut file).raw.into_inner().unwrap();
        assert!(told.is_empty());
        assert!(!in_place || file.begins == before_rest);
        assert!(raw == all, "{parts} parts read other vertices");
        assert!(file.bytes == whole.bytes, "{parts} parts are another file");
        assert_eq!(file.is_patched, whole.is_patched);
    }
}

/// A wavy sheet with normals and faces.
fn sheet(folder: &std::path::Path) -> std::path::PathBuf {
    let path = folder.join("sheet.ply");
    let at = |i: u32| {
        let (u, v) = (f64::from(i % 700) / 700.0, f64::from(i / 700) / 300.0);
        DVec3::new(u, v, 0.1 * (9.0 * u).sin() * (7.0 * v).cos())
    };
    let normals = vec![Vec3::new(0.0, 0.6, 0.8); VERTICES as usize];
    let cells = (0..VERTICES - 701).filter(|i| i % 700 < 699);
    let triangles: Vec<[u32; 3]> = cells.flat_map(|i| [[i, i + 1, i + 701], [i, i + 701, i + 700]]).collect();
    let besides = Besides { normals: &normals, triangles: &triangles, ..Besides::default() };
    let points: Vec<DVec3> = (0..VERTICES).map(at).collect();
    write_vertices(&path, points.into_iter(), besides, Scalar::F32, &[]).unwrap();
    path
}

#[test]
fn parts_by_themselves_are_the_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = sheet(folder.path());
    let model = simod_model::open(&path).unwrap();
    for normals in [Normals::Transform, Normals::Keep, Normals::Drop] {
        check_parts(&*model, normals);
    }
    for name in ["a.las", "a.laz", "a.stl", "a.pcd"] {
        let to = folder.path().join(name);
        let how = Conversion { lossy: true, ..Conversion::default() };
        let model = simod_model::open(&path).unwrap();
        Converted::new(model, &to, how, &Silent).unwrap().write(&to, &Silent).unwrap();
        check_parts(&*simod_model::open(&to).unwrap(), Normals::Transform);
    }
    let records: Vec<u8> = (0..VERTICES).flat_map(|i| [(i as f32).to_le_bytes(); 8].concat()).collect();
    check_parts(&*open(&records, ".splat").unwrap(), Normals::Transform);
}

#[test]
fn what_has_no_parts_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let model = simod_model::open(&sheet(folder.path())).unwrap();
    let to = folder.path().join("a.obj");
    let how = Conversion { lossy: true, ..Conversion::default() };
    let converted = Converted::new(model, &to, how, &Silent).unwrap();
    converted.write(&to, &Silent).unwrap();
    for model in [&converted as &dyn Model, &*simod_model::open(&to).unwrap()] {
        assert_eq!(model.division(Normals::Keep), None);
        let only = Some(PieceRange { first: 1, end: Some(2) });
        let how = Rewriting { only, ..Rewriting::default() };
        let refused = model.rewrite(&mut [&mut Part::default()], how, &Twist::default(), &Silent);
        assert_eq!(refused.unwrap_err().kind(), ErrorKind::Argument);
    }
}
