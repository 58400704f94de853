//! A model that another program holds in memory, as arrays: it is streamed as files are, and cannot be
//! rewritten.

use std::ops::Range;
use std::path::Path;

use glam::{DVec3, Vec3};

use crate::model::{
    CHUNK_TRIANGLES, CHUNK_VERTICES, Edit, FaceChunk, FaceReader, Model, ModelInfo, Output, Rewriting,
    Scalar, VertexChunk, VertexReader,
};
use crate::{Error, Progress, Result};

/// Name of the model in messages, in place of a path.
const NAME: &str = "the arrays in memory";

/// A mesh or a cloud whose arrays are in memory already.
#[derive(Debug)]
pub struct InMemory {
    info: ModelInfo,
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl InMemory {
    /// A model of these vertices, with a normal for each, or none; and triangles between them, if there are
    /// any.
    ///
    /// # Errors
    /// There is not one normal for each vertex.
    pub fn new(positions: Vec<DVec3>, normals: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        if ![0, positions.len()].contains(&normals.len()) {
            let what = format!("there are {} normals of {} vertices", normals.len(), positions.len());
            return Err(Error::argument(what, "give as many, or none"));
        }
        let (vertex_bytes, face_bytes) = (size_of_val(&*positions), size_of_val(&*triangles));
        let info = ModelInfo {
            format: "arrays".to_owned(),
            vertices: positions.len() as u64,
            faces: triangles.len() as u64,
            has_normals: !normals.is_empty(),
            position_type: Scalar::F64,
            bytes: (vertex_bytes + face_bytes) as u64,
            vertex_bytes: vertex_bytes as u64,
            face_bytes: face_bytes as u64,
            ..ModelInfo::default()
        };
        Ok(Self { info, positions, normals, triangles })
    }
}

/// Vertices from one index on, up to another.
struct MemoryVertices<'a> {
    model: &'a InMemory,
    left: Range<usize>,
    chunk: usize,
}

impl VertexReader for MemoryVertices<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices.clamp(1, CHUNK_VERTICES);
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        let range = self.left.start..self.left.end.min(self.left.start + self.chunk);
        self.left.start = range.end;
        chunk.first = range.start as u64;
        chunk.positions.clear();
        chunk.positions.extend_from_slice(&self.model.positions[range.clone()]);
        chunk.normals.clear();
        chunk.normals.extend_from_slice(self.model.normals.get(range).unwrap_or_default());
        chunk.raw.clear();
        // Bytes by which two models are told apart, as those of a file are.
        chunk.raw.extend_from_slice(bytemuck::cast_slice(&chunk.positions));
        chunk.raw.extend_from_slice(bytemuck::cast_slice(&chunk.normals));
        Ok(!chunk.is_empty())
    }
}

/// Triangles from one index on.
struct MemoryTriangles<'a>(&'a [[u32; 3]]);

impl FaceReader for MemoryTriangles<'_> {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        let (now, later) = self.0.split_at(self.0.len().min(CHUNK_TRIANGLES));
        self.0 = later;
        chunk.clear();
        chunk.triangles.extend_from_slice(now);
        chunk.bytes = size_of_val(now) as u64;
        Ok(!now.is_empty())
    }
}

impl Model for InMemory {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        Path::new(NAME)
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        let end = range.end.min(self.info.vertices) as usize;
        let left = (range.start as usize).min(end)..end;
        Ok(Box::new(MemoryVertices { model: self, left, chunk: CHUNK_VERTICES }))
    }

    fn attributes(&self, _chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        to.iter_mut().for_each(Vec::clear);
        Ok(())
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(MemoryTriangles(&self.triangles)))
    }

    fn faces_at(&self, _ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Err(no_file("their faces cannot be read in parts"))
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        Ok(())
    }

    fn rewrite(
        &self,
        _outputs: &mut [&mut dyn Output],
        _how: Rewriting,
        _edit: &dyn Edit,
        _progress: &dyn Progress,
    ) -> Result<()> {
        Err(no_file("they cannot be rewritten"))
    }
}

fn no_file(what: &str) -> Error {
    Error::argument(format!("{NAME} are no file: {what}"), "write them to a file, and open that")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::{for_faces, for_positions};

    #[test]
    fn arrays_are_streamed_as_they_are() {
        let positions: Vec<DVec3> = (0..100_000).map(|i| DVec3::new(f64::from(i), 0.5, -1.0)).collect();
        let normals = vec![Vec3::Y; positions.len()];
        let triangles: Vec<[u32; 3]> = (0..70_000).map(|i| [i, i + 1, i + 2]).collect();
        let model = InMemory::new(positions.clone(), normals, triangles.clone()).unwrap();
        let (mut read, mut faces) = (Vec::new(), Vec::new());
        for_positions(&model, |chunk| {
            assert_eq!(chunk.first as usize, read.len());
            assert_eq!(chunk.normals.len(), chunk.len());
            read.extend_from_slice(&chunk.positions);
            Ok(())
        })
        .unwrap();
        for_faces(&model, |chunk| {
            faces.extend_from_slice(&chunk.triangles);
            Ok(())
        })
        .unwrap();
        assert_eq!((read, faces), (positions, triangles));
        let mut some = VertexChunk::default();
        assert!(model.vertices(99_999..u64::MAX).unwrap().read(&mut some).unwrap());
        assert_eq!((some.first, some.len()), (99_999, 1));
        assert!(!model.vertices(100_000..100_001).unwrap().read(&mut some).unwrap());
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        assert!(InMemory::new(vec![DVec3::ZERO; 2], vec![Vec3::X], Vec::new()).is_err());
        let model = InMemory::new(vec![DVec3::ZERO], Vec::new(), Vec::new()).unwrap();
        let edit = |_: &VertexChunk, _: &mut [crate::Edited]| Ok(());
        let refused = model.rewrite(&mut [], Rewriting::default(), &edit, &Silent).unwrap_err();
        assert!(refused.to_string().contains("no file"), "{refused}");
    }
}
