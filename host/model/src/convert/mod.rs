//! Models written in other formats than their own: streamed, edited on the way like those that keep theirs.
//!
//! A [`Converted`] model reads as the model that it is made of, and is written in another format. Losses are
//! known before anything is written, and listed; a caller that accepts losses has said so.
//!
//! | module | |
//! |---|---|
//! | `records` | PLY and PCD; `text` OBJ, OFF and columns; `stl`; LAS is in its [folder](crate::las); each is a [form](crate::form) |
//! | `work` | the stream from one to the other, for the [pipeline](crate::pipeline) |
//! | `tiles` | each tile of a model by itself |

mod records;
mod stl;
mod text;
mod tiles;
mod work;

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;

use crate::follow::{Follow, Following};
use crate::form::{self, Conversion, ConversionInput, FaceCounts, Form, Rounding};
use crate::formats::extension;
use crate::las::LasModel;
use crate::las::form::LasForm;
use crate::las::remarks;
use crate::las::same_records::SameRecords;
use crate::object::is_object;
use crate::object_output::ObjectOutput;
use crate::output::OutputFile;
use crate::polygons::{MOST_CORNERS, PolygonCounts, PolygonJoin, Polygons};
use crate::source::SourceFile;
use crate::target::scratch_folder;
use crate::{
    Edit, Edited, Error, FaceReader, Model, ModelInfo, Normals, Output, Progress, Result, Rewriting, Scalar,
    ScaledIntegers, VertexChunk, VertexReader, for_faces, pipeline,
};
pub use tiles::{ConvertedTiles, convert_tiles, converted_names};
use work::ConversionCall;

/// Extensions of what can be written.
const WRITTEN: [&str; 13] =
    ["ply", "las", "laz", "obj", "stl", "off", "pcd", "csv", "tsv", "txt", "xyz", "xyzn", "xyzrgb"];

/// A model that is written in another format than its own.
pub struct Converted {
    model: Box<dyn Model>,
    source: SourceFile,
    info: ModelInfo,
    /// The extension of the format, one of [`WRITTEN`].
    extension: &'static str,
    how: Conversion,
    faces: FaceCounts,
    folder: std::path::PathBuf,
    /// Whether the records of points stay as they are, as from LAS to LAZ.
    keeps_records: bool,
    losses: Vec<String>,
    rounding: Option<Rounding>,
    /// The integers that positions become, once they are chosen.
    integers: Option<ScaledIntegers>,
    bytes: u64,
    /// Vertices of each file written that were left out.
    left_out: AtomicU64,
}

/// The extension of a target, if it is one of [`WRITTEN`].
fn written_extension(model: &dyn Model, target: &Path) -> Result<&'static str> {
    let named = extension(target);
    WRITTEN.into_iter().find(|written| *written == named).ok_or_else(|| {
        Error::argument(
            format!(
                "{} is named as if of another format than the model, {}, and of one that cannot be written anew",
                target.display(),
                model.info().format
            ),
            format!(
                "give it the extension .{}; what else can be written: {}",
                model.extensions().first().unwrap_or(&"ply"),
                WRITTEN.join(", ")
            ),
        )
    })
}

/// # Errors
/// The model is of several tiles.
fn check_one_file(model: &dyn Model) -> Result<()> {
    if model.tiles().is_empty() {
        return Ok(());
    }
    Err(Error::argument(
        format!("{} is a model of several tiles, which are not joined", model.path().display()),
        "have each tile written by itself: name a folder, and say with --to what they become, as --to ply",
    ))
}

impl Converted {
    /// The model in the format that the extension of `target` names. Its faces are read once, to be counted.
    ///
    /// # Errors
    /// Nothing of that name can be written; the new format has no room for so much; something would be lost,
    /// and it was not said that it may be; the model cannot be read; the user cancelled.
    pub fn new(
        model: Box<dyn Model>,
        target: &Path,
        how: Conversion,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let extension = written_extension(&*model, target)?;
        check_one_file(&*model)?;
        model.check_complete(progress)?;
        let (faces, counted) = count_faces(&*model, progress)?;
        let info = model.info().clone();
        let is_las = matches!(extension, "las" | "laz") && as_las(&*model).is_some();
        let keeps_records = is_las && how.step.is_none() && how.offset.is_none();
        let mut converted = Self {
            source: SourceFile::open(model.path(), None)?,
            model,
            info,
            extension,
            how,
            faces,
            folder: scratch_folder(target),
            keeps_records,
            losses: Vec::new(),
            rounding: None,
            integers: None,
            bytes: 0,
            left_out: AtomicU64::new(0),
        };
        converted.choose_form(&counted, progress)?;
        // A user who says how fine positions shall be need not allow the loss besides.
        let is_asked = converted.rounding.is_some_and(|rounding| rounding.is_asked);
        let is_silent = converted.losses.len() == usize::from(is_asked);
        if !is_silent && !how.lossy {
            return Err(converted.would_lose(target, &converted.losses));
        }
        Ok(converted)
    }

    /// Chooses the form in which the file is written, which tells the losses.
    fn choose_form(&mut self, counted: &PolygonCounts, progress: &dyn Progress) -> Result<()> {
        let mut losses = self.losses_of_model(counted, progress)?;
        let form = self.form(self.how.drops_normals, &mut losses)?;
        if form.has_faces() {
            losses.extend(losses_of_faces(form.holds_polygons(), self.info.faces, counted));
        }
        let rounding = form.rounding(&self.content(self.how.drops_normals))?;
        losses.extend(rounding.map(|rounding| rounding.to_string()));
        let (bytes, written) = (form.bytes(), form.integers());
        drop(form);
        (self.bytes, self.integers, self.info.written) = (bytes, written, written);
        self.info.step = written.map_or(DVec3::ZERO, |integers| integers.scale.abs());
        if !self.keeps_records {
            self.info.integers = None;
        }
        if self.extension == "stl" {
            self.info.position_type = Scalar::F32;
        }
        (self.losses, self.rounding) = (losses, rounding);
        Ok(())
    }

    /// Losses of the model that any form of the new format has, in a few words each.
    fn losses_of_model(&self, counted: &PolygonCounts, progress: &dyn Progress) -> Result<Vec<String>> {
        let mut losses = Vec::new();
        if !self.keeps_records {
            losses.extend(self.model.besides()?);
            losses.extend(self.model.beyond_doubles(progress)?);
            if !matches!(self.extension, "ply" | "las" | "laz") {
                losses.extend(remarks::losses(&self.model.remarks()));
            }
        }
        if counted.without_vertex > 0 {
            let triangles = form::counted(counted.without_vertex, "triangle");
            losses.push(triangles + " with a corner that is no vertex");
        }
        if self.extension == "off" {
            losses.extend(text::losses_of_bytes(&*self.model)?);
        }
        Ok(losses)
    }

    /// Error of a conversion that loses something without being allowed to.
    fn would_lose(&self, target: &Path, losses: &[String]) -> Error {
        let own = self.own_extension();
        let all = format!("in its own format, .{own}, a deformed model keeps all of it");
        let is_of_step = self.integers.is_some() && self.rounding.is_some_and(|rounding| !rounding.is_asked);
        // Commands other than `convert` have no `--step`.
        let step =
            if is_of_step { "; `simod convert --step` says what positions are rounded to" } else { "" };
        let without = format!("give --lossy to write it without{step}");
        let hint = if own == self.extension { without } else { format!("{without}; {all}") };
        Error::argument(format!("{} would lose: {}", target.display(), losses.join("; ")), hint)
    }

    /// Extension that the model has in its own format: that of its file's name, if that is one of the
    /// format's.
    fn own_extension(&self) -> &'static str {
        let (own, named) = (self.model.extensions(), extension(self.model.path()));
        own.iter().find(|own| **own == named).or(own.first()).unwrap_or(&"ply")
    }

    /// Losses: what the new file lacks of the model, in a few words each.
    pub fn losses(&self) -> &[String] {
        &self.losses
    }

    /// Rounding of the positions, if they lose digits by it: as among the losses.
    pub fn rounding(&self) -> Option<Rounding> {
        self.rounding
    }

    /// Number of vertices that were written: without those that were left out.
    pub fn vertices(&self) -> u64 {
        self.info.vertices - self.left_out.load(Ordering::Relaxed)
    }

    /// Number of triangles that are written, where the format has any.
    pub fn triangles(&self) -> u64 {
        self.faces.triangles
    }

    /// Writes the model as it is; the file, or object, appears whole or not at all.
    ///
    /// # Errors
    /// The model cannot be read; a position does not fit; the file cannot be written; the user cancelled.
    pub fn write(&self, target: &Path, progress: &dyn Progress) -> Result<()> {
        if is_object(target) {
            let mut object = ObjectOutput::begin(target, self.bytes)?;
            self.write_to(&mut object, progress)?;
            object.complete()?;
            return object.commit().map(drop);
        }
        let mut file = OutputFile::create(target, self.bytes)?;
        self.write_to(&mut file.replaceable(), progress)?;
        file.commit()
    }

    fn write_to(&self, output: &mut dyn Output, progress: &dyn Progress) -> Result<()> {
        progress.begin("converting", self.info.vertex_bytes + self.info.face_bytes);
        let normals = if self.how.drops_normals { Normals::Drop } else { Normals::Keep };
        let keep = |_: &VertexChunk, _: &mut [Edited]| Ok(());
        let how = Rewriting { normals, ..Rewriting::default() };
        self.rewrite(&mut [output], how, &keep, progress)?;
        progress.check()
    }

    fn content(&self, drops_normals: bool) -> ConversionInput<'_> {
        ConversionInput {
            model: &*self.model,
            has_normals: self.model.info().has_normals && !drops_normals,
            faces: self.faces,
            how: self.how,
            integers: self.integers,
            folder: self.folder.clone(),
        }
    }

    fn form(&self, drops_normals: bool, losses: &mut Vec<String>) -> Result<Box<dyn Form + '_>> {
        use records::RecordFormat::{Pcd, Ply};
        use text::TextFormat::{Named, Obj, Off, Plain};
        let content = self.content(drops_normals);
        let records = |kind, losses: &mut _| records::RecordForm::new(kind, &content, losses);
        let lines = |kind, losses: &mut _| text::TextForm::new(kind, &content, losses);
        let plain = |with_normals, with_colors| Plain { with_normals, with_colors };
        if let Some(las) = as_las(&*self.model).filter(|_| self.keeps_records) {
            return Ok(Box::new(SameRecords::new(las, self.extension == "laz")?));
        }
        Ok(match self.extension {
            "pcd" => Box::new(records(Pcd, losses)?),
            "las" | "laz" => Box::new(LasForm::new(self.extension == "laz", &content, losses)?),
            "obj" => Box::new(lines(Obj, losses)?),
            "off" => Box::new(lines(Off, losses)?),
            "stl" => Box::new(stl::StlForm::new(&content, losses)?),
            "csv" => Box::new(lines(Named(b','), losses)?),
            "tsv" => Box::new(lines(Named(b'\t'), losses)?),
            "txt" => Box::new(lines(Named(b' '), losses)?),
            "xyz" => Box::new(lines(plain(false, false), losses)?),
            "xyzn" => Box::new(lines(plain(true, false), losses)?),
            "xyzrgb" => Box::new(lines(plain(false, true), losses)?),
            _ => Box::new(records(Ply, losses)?),
        })
    }
}

fn as_las(model: &dyn Model) -> Option<&LasModel> {
    model.as_any()?.downcast_ref()
}

/// Counts the faces, which takes a reading of them.
fn count_faces(model: &dyn Model, progress: &dyn Progress) -> Result<(FaceCounts, PolygonCounts)> {
    let (mut faces, info) = (FaceCounts::default(), model.info());
    let (mut joining, mut polygons) = (PolygonJoin::new(info.vertices, true), Polygons::default());
    if info.faces == 0 {
        return Ok((faces, joining.counted));
    }
    let mut count = |polygons: &mut Polygons| {
        faces.polygons += polygons.len() as u64;
        faces.corners += polygons.corners() as u64;
        polygons.clear();
    };
    progress.begin("counting the faces", info.face_bytes);
    for_faces(model, |chunk| {
        progress.check()?;
        joining.add(chunk, &mut polygons);
        count(&mut polygons);
        progress.advance(chunk.bytes);
        Ok(())
    })?;
    joining.finish(&mut polygons);
    count(&mut polygons);
    let counted = joining.counted;
    (faces.triangles, faces.largest) = (counted.triangles, counted.largest);
    Ok((faces, counted))
}

/// Losses of faces in a format that holds polygons, or triangles alone, of a file that tells a number `told`
/// of faces.
fn losses_of_faces(holds_polygons: bool, told: u64, counted: &PolygonCounts) -> Vec<String> {
    let PolygonCounts { triangles, without_vertex, faces, long, .. } = *counted;
    let mut losses = Vec::new();
    // Each triangle of a strip is one face.
    let is_of_strips = faces > told;
    if is_of_strips || (!holds_polygons && faces != triangles + without_vertex) {
        losses.push(format!("which of the {triangles} triangles are one of {told} faces"));
    } else if long > 0 {
        let of = form::counted(long, "polygon");
        losses.push(format!("{of} of more than {MOST_CORNERS} corners: triangles instead"));
    }
    if faces < told {
        losses.push(form::counted(told - faces, "face") + " of fewer than three corners");
    }
    losses
}

impl Model for Converted {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.model.path()
    }

    fn other_files(&self) -> Vec<&Path> {
        self.model.other_files()
    }

    fn extensions(&self) -> &'static [&'static str] {
        let at = WRITTEN.iter().position(|written| *written == self.extension).unwrap_or(0);
        const ALL: &[&str] = &WRITTEN;
        &ALL[at..=at]
    }

    fn columns(&self) -> Option<&str> {
        None
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        self.model.vertices(range)
    }

    fn keep_positions(&self, folder: Option<&Path>) {
        self.model.keep_positions(folder);
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        self.model.attributes(chunk, to)
    }

    fn following(&self) -> Option<&Following> {
        self.model.following()
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.model.follow(follow)
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        self.model.faces()
    }

    fn faces_at(&self, ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        self.model.faces_at(ranges)
    }

    fn check_complete(&self, progress: &dyn Progress) -> Result<()> {
        self.model.check_complete(progress)
    }

    fn make_room(&mut self, moves: &[[DVec3; 2]], margin: f64) -> Result<Option<String>> {
        if self.info.written.is_none() {
            // Floats and text reach everywhere.
            return Ok(None);
        }
        if !self.keeps_records {
            return Err(Error::argument(
                format!("{} is not written with the offset of the model", self.path().display()),
                "leave out --offset auto",
            ));
        }
        let changed = self.model.make_room(moves, margin)?;
        self.info.written = self.model.info().written;
        Ok(changed)
    }

    fn written_bytes(&self) -> u64 {
        self.bytes
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        if let Some(las) = as_las(&*self.model) {
            las.tell_of_octree(progress);
            if self.keeps_records {
                las.tell_of_waveforms(progress);
            }
        }
        let form = self.form(how.normals == Normals::Drop, &mut Vec::new())?;
        if form.needs_vertices() && (outputs.len() > 1 || how.pieces_done > 0) {
            return Err(Error::argument(
                format!("files of .{} are written one at a time, from their beginning", self.extension),
                "leave out --resume, and write one version after the other",
            ));
        }
        let work = ConversionCall::new(&*self.model, &self.source, &*form, how, edit, progress);
        pipeline::rewrite(&work, outputs, how, &work.edit(), &work.quietly())?;
        let left_out = form.left_out() / outputs.len().max(1) as u64;
        self.left_out.store(left_out, Ordering::Relaxed);
        if left_out > 0 {
            let of = self.path().display();
            progress.note(&format!("{of}: {left_out} vertices without a position were left out"));
        }
        if let Some(following) = self.following() {
            following.tell(self.path(), progress);
        }
        Ok(())
    }
}
