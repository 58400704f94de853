//! An OBJ file as a model: the way of writing depends on whether normals belong to vertices or to corners.

use std::ops::Range;
use std::path::Path;

use super::apart::ApartModel;
use super::grammar::Obj;
use super::shared::SharedNormals;
use crate::pipeline;
use crate::text::model::Grammar;
use crate::{
    Edit, FaceReader, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting, VertexChunk,
    VertexReader,
};

impl Model for ApartModel {
    fn info(&self) -> &ModelInfo {
        &self.model.info
    }

    fn path(&self) -> &Path {
        self.model.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        Obj::EXTENSIONS
    }

    fn besides(&self) -> Result<Vec<String>> {
        let mut besides = self.model.grammar.besides();
        if self.of_corners > 0 || self.sharing.is_some() {
            besides.push("normals (vn) of corners".to_owned());
        }
        Ok(besides)
    }

    fn beyond_doubles(&self, progress: &dyn Progress) -> Result<Vec<String>> {
        self.model.beyond_doubles(progress)
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        self.reader(range)
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        self.model.read_attributes(chunk, to)
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Obj::faces(&self.model, None)
    }

    fn faces_at(&self, ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Obj::faces(&self.model, Some(ranges))
    }

    fn check_complete(&self, progress: &dyn Progress) -> Result<()> {
        self.model.check_complete(progress)
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        if how.normals == Normals::Transform && self.of_corners > 0 {
            progress.note(&format!(
                "{}: its {} normals (vn) belong to corners, not to vertices, and are kept as they are",
                self.path().display(),
                self.of_corners
            ));
        }
        if self.normals.is_none() {
            return self.model.rewrite(outputs, how, edit, progress);
        }
        self.model.check_normals(how.normals)?;
        if let (Some(sharing), Normals::Transform) = (&self.sharing, how.normals) {
            let shared = SharedNormals::new(self, sharing, progress)?;
            pipeline::rewrite(&shared, outputs, how, edit, progress)?;
            shared.tell(progress);
            return Ok(());
        }
        pipeline::rewrite(self, outputs, how, edit, progress)
    }
}
