//! Models of several files: read as one, whatever the files are, and rewritten each as if it was alone.

#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use simod_model::progress::Silent;
use simod_model::{
    Edited, FaceChunk, Model, ModelName, Output, Rewriting, Summary, Type, VertexChunk, for_faces,
    for_faces_from, for_vertices,
};

/// A tile: its vertices, whether they have normals, intensity and colours, and its faces.
#[derive(Debug, Clone)]
struct Tile {
    positions: Vec<[i16; 3]>,
    has_normals: bool,
    has_intensity: bool,
    is_binary: bool,
    faces: Vec<[i32; 3]>,
}

fn tile() -> impl Strategy<Value = Tile> {
    let faces = proptest::collection::vec(proptest::array::uniform3(-2..40i32), 0..40);
    let positions = proptest::collection::vec(any::<[i16; 3]>(), 0..40);
    (positions, any::<[bool; 3]>(), faces).prop_map(
        |(positions, [has_normals, has_intensity, is_binary], faces)| Tile {
            positions,
            has_normals,
            has_intensity,
            is_binary,
            faces,
        },
    )
}

impl Tile {
    fn intensity(&self, vertex: usize) -> u8 {
        (self.positions[vertex][0] as u8).wrapping_mul(7)
    }

    fn write(&self, path: &Path) {
        let format = if self.is_binary { "binary_little_endian" } else { "ascii" };
        let mut header = format!("ply\nformat {format} 1.0\nelement vertex {}\n", self.positions.len());
        // In another order in binary ones.
        let quality = if self.is_binary {
            "property uchar b\nproperty uchar a\n"
        } else {
            "property uchar a\nproperty uchar b\n"
        };
        header += "property float x\nproperty float y\nproperty float z\n";
        header +=
            if self.has_normals { "property float nx\nproperty float ny\nproperty float nz\n" } else { "" };
        header += quality;
        header += if self.has_intensity { "property uchar intensity\n" } else { "" };
        header += &format!(
            "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            self.faces.len()
        );
        let mut bytes = header.into_bytes();
        for (vertex, p) in self.positions.iter().enumerate() {
            let normal = [0.0f32, 0.0, 1.0];
            let floats = p.map(f32::from).into_iter().chain(normal.into_iter().filter(|_| self.has_normals));
            let b = self.intensity(vertex).wrapping_add(1);
            let quality = if self.is_binary { [b, 5] } else { [5, b] };
            let small = quality.into_iter().chain(self.has_intensity.then(|| self.intensity(vertex)));
            if self.is_binary {
                floats.for_each(|x| bytes.extend(x.to_le_bytes()));
                bytes.extend(small);
            } else {
                let words: Vec<String> =
                    floats.map(|x| x.to_string()).chain(small.map(|n| n.to_string())).collect();
                bytes.extend(format!("{}\n", words.join(" ")).bytes());
            }
        }
        for face in &self.faces {
            if self.is_binary {
                bytes.push(3);
                face.iter().for_each(|index| bytes.extend(index.to_le_bytes()));
            } else {
                bytes.extend(format!("3 {} {} {}\n", face[0], face[1], face[2]).bytes());
            }
        }
        std::fs::File::create(path).and_then(|mut file| file.write_all(&bytes)).unwrap();
    }
}

fn open(paths: &[PathBuf]) -> Box<dyn Model> {
    ModelName::Tiles(paths.to_vec()).open(None, &std::sync::Arc::default(), &Silent).unwrap()
}

/// Vertices from a range, with their normals, and the numbers of an attribute.
fn read(
    model: &dyn Model,
    range: std::ops::Range<u64>,
    chunk: usize,
    place: usize,
) -> (Vec<DVec3>, Vec<Vec3>, Vec<f64>) {
    let mut reader = model.vertices(range.clone()).unwrap();
    let (mut read, mut piece, mut lists) = (VertexChunk::default(), VertexChunk::default(), [Vec::new()]);
    let (mut positions, mut normals, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    let mut next = range.start;
    loop {
        // Another size each time, as of pieces that end somewhere.
        let most = 1 + next as usize % chunk;
        reader.set_chunk(most);
        if !reader.read(&mut piece).unwrap() {
            break;
        }
        assert!(piece.len() <= most);
        assert_eq!(piece.first, next);
        next += piece.len() as u64;
        positions.extend_from_slice(&piece.positions);
        normals.extend_from_slice(&piece.normals);
        model.some_attributes(&piece, &[place], &mut lists).unwrap();
        numbers.extend_from_slice(&lists[0]);
        // Buffers are used in turn, as by readers ahead.
        std::mem::swap(&mut read, &mut piece);
    }
    (positions, normals, numbers)
}

/// An output of several files.
#[derive(Default)]
struct Files(Vec<Vec<u8>>);

impl Output for Files {
    fn begin_file(&mut self, number: usize) -> std::io::Result<()> {
        assert_eq!(number, self.0.len());
        self.0.push(Vec::new());
        Ok(())
    }

    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> std::io::Result<()> {
        self.0.last_mut().unwrap().extend_from_slice(bytes);
        Ok(())
    }

    fn patch(&mut self, _at: u64, _bytes: &[u8]) -> std::io::Result<()> {
        Ok(())
    }

    fn finish(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn edit(chunk: &VertexChunk, versions: &mut [Edited]) -> simod_model::Result<()> {
    for (to, from) in versions[0].positions.iter_mut().zip(&chunk.positions) {
        *to = DVec3::new(from.z, -from.x, from.y + 1.0);
    }
    Ok(())
}

proptest! {
    #[test]
    fn tiles_are_read_as_one_and_written_as_each_alone(
        tiles in proptest::collection::vec(tile(), 1..6),
        range in any::<[proptest::sample::Index; 2]>(),
        chunk in 1..50usize,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let paths: Vec<PathBuf> = (0..tiles.len()).map(|i| folder.path().join(format!("{i}.ply"))).collect();
        tiles.iter().zip(&paths).for_each(|(tile, path)| tile.write(path));
        let model = open(&paths);
        let info = model.info();
        let expected: Vec<DVec3> =
            tiles.iter().flat_map(|tile| &tile.positions).map(|p| Vec3::from_array(p.map(f32::from)).as_dvec3()).collect();
        let count = expected.len() as u64;
        prop_assert_eq!(info.vertices, count);
        prop_assert_eq!(info.has_normals, tiles.iter().all(|tile| tile.has_normals));
        let places: Vec<&str> = info.attributes.iter().map(|a| a.name.as_str()).collect();
        prop_assert_eq!(places.contains(&"intensity"), tiles.iter().all(|tile| tile.has_intensity));
        prop_assert!(info.attributes.iter().all(|a| a.kind == Type::U8));
        let place = places.iter().position(|name| *name == "b").unwrap();
        let numbers: Vec<f64> = tiles
            .iter()
            .flat_map(|tile| (0..tile.positions.len()).map(|i| f64::from(tile.intensity(i).wrapping_add(1))))
            .collect();
        let mut ends = range.map(|index| index.index(count as usize + 1));
        ends.sort_unstable();
        let within = ends[0]..ends[1];
        let found = read(&*model, ends[0] as u64..ends[1] as u64, chunk, place);
        prop_assert_eq!(&found.0, &expected[within.clone()]);
        prop_assert_eq!(found.1.len(), if info.has_normals { within.len() } else { 0 });
        prop_assert_eq!(&found.2, &numbers[within]);

        // Bytes of vertices add up in any reading.
        let mut bytes = 0;
        for_vertices(&*model, |chunk| { bytes += chunk.raw().len() as u64; Ok(()) }).unwrap();
        if tiles.iter().all(|tile| tile.is_binary) {
            prop_assert_eq!(model.bytes_before(count)[0], bytes);
            prop_assert_eq!(model.bytes_before(0), [0; 2]);
        }

        // Faces are of their own vertices.
        let (mut triangles, mut before, mut known) = (Vec::new(), 0, Vec::new());
        let mut marks = Vec::new();
        for_faces(&*model, |chunk: &FaceChunk| {
            marks.extend(chunk.marks.iter().map(|mark| (triangles.len() + mark.triangle, mark.offset)));
            triangles.extend_from_slice(&chunk.triangles);
            Ok(())
        })
        .unwrap();
        for tile in &tiles {
            let own = tile.positions.len() as i32;
            let shifted = |index: i32| if (0..own).contains(&index) { (index + before) as u32 } else { u32::MAX };
            known.extend(tile.faces.iter().map(|face| face.map(shifted)));
            before += own;
        }
        prop_assert_eq!(&triangles, &known);
        // From any mark on, all behind it.
        prop_assert!(!tiles.iter().all(|tile| tile.is_binary) || model.has_face_marks());
        prop_assert!(marks.is_sorted());
        for (before, mark) in marks.into_iter().filter(|_| model.has_face_marks()) {
            let mut behind = Vec::new();
            let visit = |chunk: &FaceChunk| { behind.extend_from_slice(&chunk.triangles); Ok(()) };
            for_faces_from(&*model, mark, u64::MAX, visit).unwrap();
            prop_assert_eq!(&behind, &triangles[before..]);
        }

        // Each file is what it would be alone, also where some are there already.
        let alone: Vec<Vec<u8>> = paths.iter().map(|path| {
            let mut bytes = Vec::new();
            simod_model::open(path).unwrap().rewrite(&mut [&mut bytes], Rewriting::default(), &edit, &Silent).unwrap();
            bytes
        }).collect();
        for files_done in 0..=tiles.len() as u64 {
            let mut files = Files(alone[..files_done as usize].to_vec());
            let how = Rewriting { files_done, ..Rewriting::default() };
            model.rewrite(&mut [&mut files], how, &edit, &Silent).unwrap();
            prop_assert!(files.0 == alone);
        }
    }
}

#[test]
fn tiles_of_gltf_are_written_as_glb() {
    let files = ["a/x.gltf", "a/y.GLTF", "a/y.glb", "a/z.ply", "a/y.gltf"].map(PathBuf::from);
    let name = ModelName::Tiles(files.to_vec());
    assert_eq!(name.tiles(), ["x.gltf", "y.GLTF", "y.glb", "z.ply", "y.gltf"].map(PathBuf::from));
    let written = ["x.glb", "y.gltf.glb", "y.glb", "z.ply", "y.gltf.gltf.glb"].map(PathBuf::from);
    assert_eq!(name.written_tiles(), written);
}

#[test]
fn tiles_have_a_name_in_common_and_names_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let tile = Tile {
        positions: vec![[1, 2, 3]],
        has_normals: false,
        has_intensity: false,
        is_binary: true,
        faces: Vec::new(),
    };
    let paths: Vec<PathBuf> =
        ["a/t-1.ply", "a/t-2.ply", "b/t-1.ply"].map(|name| folder.path().join(name)).to_vec();
    for path in &paths {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        tile.write(path);
    }
    let model = open(&paths);
    let names: Vec<&Path> = model.tiles().iter().map(|tile| tile.name.as_path()).collect();
    assert_eq!(names, ["a/t-1.ply", "a/t-2.ply", "b/t-1.ply"].map(Path::new));
    assert_eq!(model.path(), folder.path().join("*"));
    assert_eq!(open(&paths[..2]).path(), folder.path().join("a/t-*.ply"));
    assert_eq!(model.other_files(), paths.iter().map(PathBuf::as_path).collect::<Vec<_>>());
    let stream = model.rewrite(&mut [&mut Vec::new()], Rewriting::default(), &edit, &Silent).unwrap_err();
    assert!(stream.to_string().contains("t-1.ply"), "{stream}");
    let twice = ModelName::Tiles(vec![paths[0].clone(), paths[0].clone()]);
    let twice = twice.open(None, &std::sync::Arc::default(), &Silent).err().unwrap();
    assert!(twice.to_string().ends_with("t-1.ply is named twice"), "{twice}");
}
