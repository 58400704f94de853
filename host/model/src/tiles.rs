//! A model that is made of several files, as a survey of tiles: their vertices are numbered one after the
//! other, and each file is rewritten to one of its own, as if it was alone.
//!
//! Each tile is a model by itself, of any format. Its file is [closed](crate::pool) while others are read.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

use crate::bounds::Bounds;
use crate::cache::{Cache, Making};
use crate::follow::{Follow, Following};
use crate::formats::{extension, open_file};
use crate::input::Identity;
use crate::model::{
    CHUNK_VERTICES, Division, Edit, FaceChunk, FaceReader, Model, ModelInfo, Normals, Output, Rewriting,
    Scalar, Tile, VertexChunk, VertexReader, some_by_all,
};
use crate::pool::Pool;
use crate::target::folder_of;
use crate::{Attribute, Error, Progress, Result};

/// Most tiles for which a cache is made to read them from anywhere: each has an open file.
const MOST_UNPACKED: usize = 64;

/// Most tiles whose positions are kept while the tiles are read again, and (`MOST_KEPT_BYTES`) most bytes of
/// all these.
const MOST_KEPT: usize = 32;
const MOST_KEPT_BYTES: u64 = 8 << 30;

/// Bytes of a vertex that is kept.
const KEPT_BYTES: u64 = 18;

/// Most tiles that are named in a line.
const MOST_NAMED: usize = 3;

/// Most tiles that are described.
const MOST_DESCRIBED: usize = 20;

/// A model of several files.
pub(crate) struct TiledModel {
    path: PathBuf,
    info: ModelInfo,
    tiles: Vec<TilePart>,
    /// Tiles as callers see them.
    files: Vec<Tile>,
}

/// A tile, and where its vertices and attributes are among those of the whole model.
struct TilePart {
    model: Box<dyn Model>,
    /// Number of vertices of the tiles before this one.
    before: u64,
    /// Bytes of the tiles before this one, and one more for each: the end of one is not the beginning of the
    /// next.
    bytes_before: u64,
    /// Places of the whole model's attributes among the tile's own.
    places: Vec<usize>,
}

impl TilePart {
    /// Moves that begin in the box that the tile's file tells, or near to it if there are none, and the
    /// margin that is the same part of their size as `margin` is of all: other tiles may be further away than
    /// the integers of this one reach, and this tile has no vertices there.
    fn own_moves<'m>(&self, moves: &'m [[DVec3; 2]], margin: f64) -> (Cow<'m, [[DVec3; 2]]>, f64) {
        let size = |moves: &[[DVec3; 2]]| Bounds::from_points(moves.iter().map(|[_, to]| *to)).diagonal();
        let (Some(told), all) = (self.model.told_bounds(), size(moves)) else {
            return (Cow::Borrowed(moves), margin);
        };
        let part = if all > 0.0 { margin / all } else { 0.0 };
        for beyond in [part * told.diagonal(), margin] {
            let near = Bounds { min: told.min - beyond, max: told.max + beyond };
            let own: Vec<_> = moves.iter().copied().filter(|[from, _]| near.contains(*from)).collect();
            if !own.is_empty() {
                let margin = part * size(&own).max(told.diagonal());
                return (Cow::Owned(own), margin);
            }
        }
        (Cow::Borrowed(moves), margin)
    }
}

impl TiledModel {
    /// Opens tiles in the order of their vertices.
    ///
    /// # Errors
    /// A tile cannot be opened, or is there twice; too many have to be unpacked first; the user cancelled.
    pub fn open(files: &[PathBuf], columns: Option<&str>, making: &Making<'_>) -> Result<Self> {
        let pool = Arc::new(Pool::default());
        let (mut seen, mut unpacked) = (BTreeMap::new(), 0);
        let (mut models, mut before, mut bytes_before) = (Vec::with_capacity(files.len()), 0u64, 0u64);
        for path in files {
            making.progress.check()?;
            if let Some(other) = Identity::from_path(path).and_then(|identity| seen.insert(identity, path)) {
                return Err(twice(other, path));
            }
            let cache = Arc::new(Cache::nameless(&making.cache.folder()));
            let making = Making { cache: &cache, progress: making.progress };
            let model = open_file(path, Some(&pool), columns, &making)?;
            unpacked += usize::from(cache.bytes().is_some());
            if unpacked > MOST_UNPACKED {
                return Err(Error::argument(
                    format!("{}: more than {MOST_UNPACKED} tiles have to be unpacked first", path.display()),
                    "have `simod convert` make uncompressed files of them",
                ));
            }
            let (vertices, bytes) = (model.info().vertices, model.info().bytes);
            models.push(TilePart { model, before, bytes_before, places: Vec::new() });
            bytes_before = bytes_before.saturating_add(bytes.saturating_add(1));
            before = before.checked_add(vertices).ok_or_else(|| too_many(path))?;
        }
        let Some(first) = models.first() else {
            return Err(Error::argument("a model of no tiles", "name the files"));
        };
        let attributes = common_attributes(&models);
        let info = first.model.info().clone();
        for part in &mut models {
            let own = &part.model.info().attributes;
            part.places = attributes.iter().filter_map(|a| own.iter().position(|own| own == a)).collect();
        }
        let names = written_names(files);
        let tile = |((part, path), name): ((&TilePart, &PathBuf), PathBuf)| Tile {
            path: path.clone(),
            name,
            bytes: part.model.info().bytes,
            vertices: part.model.info().vertices,
        };
        let tiles = models.iter().zip(files).zip(names).map(tile).collect();
        let mut this = Self { path: pattern_of(files), info, tiles: models, files: tiles };
        this.info = this.summed(attributes);
        this.tell(making.progress);
        Ok(this)
    }

    /// The description of all tiles as one model.
    fn summed(&self, attributes: Vec<Attribute>) -> ModelInfo {
        let all = || self.infos();
        let sum = |of: fn(&ModelInfo) -> u64| all().map(of).sum();
        let formats = distinct(all().map(|info| &info.format));
        let some = formats.iter().take(MOST_NAMED).map(|format| format.as_str()).collect::<Vec<_>>();
        let more = if formats.len() > MOST_NAMED { " and others" } else { "" };
        let is_float = |info: &ModelInfo| info.position_type == Scalar::F32 && info.integers.is_none();
        let first = &self.info;
        let same = |is: fn(&ModelInfo, &ModelInfo) -> bool| all().all(|info| is(info, first));
        ModelInfo {
            format: format!("{} of {}", tiles(self.tiles.len()), some.join(", ")) + more,
            vertices: sum(|info| info.vertices),
            faces: sum(|info| info.faces),
            has_normals: all().all(|info| info.has_normals),
            position_type: if all().all(is_float) { Scalar::F32 } else { Scalar::F64 },
            other_properties: common(all().map(|info| &info.other_properties)),
            attributes,
            bytes: sum(|info| info.bytes),
            random_access: all().all(|info| info.random_access),
            block_vertices: all().map(|info| info.block_vertices).max().unwrap_or(1),
            vertex_bytes: sum(|info| info.vertex_bytes),
            face_bytes: sum(|info| info.face_bytes),
            integers: first.integers.filter(|_| same(|a, b| a.integers == b.integers)),
            written: first.written.filter(|_| same(|a, b| a.written == b.written)),
            step: all().fold(DVec3::ZERO, |step, info| step.max(info.step)),
            ranges: all().flat_map(|info| info.ranges.iter().copied()).collect(),
            crs: first.crs.clone().filter(|_| same(|a, b| a.crs == b.crs)),
        }
    }

    fn infos(&self) -> impl Iterator<Item = &ModelInfo> {
        self.tiles.iter().map(|part| part.model.info())
    }

    /// The tiles of which something is so, for people: the first of them by name.
    fn named(&self, is_so: impl Fn(&ModelInfo) -> bool) -> String {
        let are = self.files.iter().zip(self.infos()).filter(|(_, info)| is_so(info));
        let (mut names, mut more) = (Vec::new(), 0);
        for (tile, _) in are {
            if names.len() < MOST_NAMED {
                names.push(tile.name.display().to_string());
            } else {
                more += 1;
            }
        }
        if more > 0 {
            names.push(format!("{more} more"));
        }
        names.join(", ")
    }

    /// Notes the differences between the tiles.
    fn tell(&self, progress: &dyn Progress) {
        let systems = distinct(self.infos().map(|info| &info.crs));
        if systems.len() > 1 {
            let told = systems.iter().map(|crs| {
                let said = crs.as_deref().unwrap_or("none is said");
                format!("{said} ({})", self.named(|info| info.crs == **crs))
            });
            progress.note(&format!(
                "the tiles are of different coordinate reference systems, and taken as if they were of one: {}",
                told.collect::<Vec<_>>().join("; ")
            ));
        }
        if !self.info.has_normals && self.infos().any(|info| info.has_normals) {
            let without = self.named(|info| !info.has_normals);
            progress.note(&format!("the tiles' normals are not looked at, as some have none: {without}"));
        }
        let known: Vec<&Attribute> = self.info.attributes.iter().collect();
        let left_out = distinct(self.infos().flat_map(|info| &info.attributes));
        let left_out: Vec<&Attribute> = left_out.into_iter().filter(|a| !known.contains(a)).collect();
        if !left_out.is_empty() {
            let some = left_out.iter().take(2 * MOST_NAMED).map(|a| a.name.as_str()).collect::<Vec<_>>();
            let more = left_out.len() - some.len();
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            progress.note(&format!("not all tiles have {}{more}: no use is made of these", some.join(", ")));
        }
    }

    /// The tile that has a vertex; the last one at the end.
    fn tile_of(&self, vertex: u64) -> Option<(usize, &TilePart)> {
        let number = self.tiles.partition_point(|part| part.before + part.model.info().vertices <= vertex);
        let number = number.min(self.tiles.len().saturating_sub(1));
        self.tiles.get(number).map(|part| (number, part))
    }

    /// The tile that a chunk was read of.
    fn tile_of_chunk(&self, chunk: &VertexChunk) -> Result<&TilePart> {
        let found = self.tile_of(chunk.first).filter(|(_, part)| part.before == chunk.before);
        found.map(|(_, part)| part).ok_or_else(|| {
            Error::internal(format!("a chunk is of none of the tiles of {}", self.path.display()))
        })
    }

    /// Whether a tile's positions are whole numbers, whose range can be chosen anew.
    fn has_integers(part: &TilePart) -> bool {
        part.model.info().step != DVec3::ZERO
    }
}

/// Attributes that all tiles have, in the order of the first one.
fn common_attributes(tiles: &[TilePart]) -> Vec<Attribute> {
    common(tiles.iter().map(|part| &part.model.info().attributes))
}

/// Elements that all lists have, in the order of the first one.
fn common<'a, T: Clone + PartialEq + 'a>(mut lists: impl Iterator<Item = &'a Vec<T>>) -> Vec<T> {
    let mut common = lists.next().cloned().unwrap_or_default();
    lists.for_each(|list| common.retain(|one| list.contains(one)));
    common
}

/// Distinct elements, in the order in which they first come.
fn distinct<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut found = Vec::new();
    for one in all {
        if !found.contains(&one) {
            found.push(one);
        }
    }
    found
}

fn tiles(count: usize) -> String {
    if count == 1 { "1 tile".to_owned() } else { format!("{count} tiles") }
}

fn twice(a: &Path, b: &Path) -> Error {
    let what = if a == b {
        format!("the tile {} is named twice", a.display())
    } else {
        format!("the tiles {} and {} are the same file", a.display(), b.display())
    };
    Error::argument(what, "name each tile once")
}

fn too_many(path: &Path) -> Error {
    Error::format(
        format!("{}: the tiles up to this one have more vertices than can be counted", path.display()),
        "copy or export the tile again",
    )
}

/// Folder that all files are in, at any depth, if there is one.
fn folder_of_all(files: &[PathBuf]) -> PathBuf {
    let mut folders = files.iter().map(|file| folder_of(file));
    let mut common = folders.next().unwrap_or(Path::new(".")).to_owned();
    for folder in folders {
        while !folder.starts_with(&common) && common.pop() {}
    }
    common
}

/// Names of files in a folder of all of them: their file names, with the folders below the one that they
/// share.
pub(crate) fn names(files: &[PathBuf]) -> Vec<PathBuf> {
    let absolute = |file: &PathBuf| {
        let folder = folder_of(file);
        let known = folder.canonicalize().or_else(|_| std::path::absolute(folder));
        known.unwrap_or_else(|_| folder.to_owned()).join(file.file_name().unwrap_or_default())
    };
    let files: Vec<PathBuf> = files.iter().map(absolute).collect();
    let folder = folder_of_all(&files);
    let name = |file: &PathBuf| {
        let below = file.strip_prefix(&folder).unwrap_or(file);
        // Never outside the folder.
        below.components().filter(|part| matches!(part, Component::Normal(_))).collect()
    };
    files.iter().map(name).collect()
}

/// Names of tiles in the folder that they are written to, none like another: of a `.gltf` with its buffers
/// comes one GLB.
pub(crate) fn written_names(files: &[PathBuf]) -> Vec<PathBuf> {
    let names = names(files);
    let mut taken: BTreeSet<PathBuf> = names.iter().cloned().collect();
    let written = |name: PathBuf| {
        if extension(&name) != "gltf" {
            return name;
        }
        let mut glb = name.with_extension("glb");
        while !taken.insert(glb.clone()) {
            glb = glb.with_extension("gltf.glb");
        }
        glb
    };
    names.into_iter().map(written).collect()
}

/// A pattern that files have in common, which stands for them in messages.
pub fn pattern_of(files: &[PathBuf]) -> PathBuf {
    let [first, others @ ..] = files else { return PathBuf::new() };
    if others.is_empty() {
        return first.clone();
    }
    let folder = folder_of_all(files);
    let names: Option<Vec<&str>> =
        files.iter().map(|file| file.file_name()?.to_str().filter(|_| folder_of(file) == folder)).collect();
    let Some(names) = names else { return folder.join("*") };
    let common = |of: &dyn Fn(&str) -> Vec<char>| {
        let mut common = of(names[0]);
        for name in &names[1..] {
            let same = common.iter().zip(of(name)).take_while(|(a, b)| **a == *b).count();
            common.truncate(same);
        }
        common
    };
    let start = common(&|name| name.chars().collect());
    let longest = names.iter().map(|name| name.chars().count()).min().unwrap_or(0) - start.len();
    let mut end = common(&|name| name.chars().rev().collect());
    end.truncate(longest);
    let [start, end]: [String; 2] = [start.into_iter().collect(), end.into_iter().rev().collect()];
    folder.join(format!("{start}*{end}"))
}

/// Reads the vertices of one tile after the other.
struct TileReader<'a> {
    model: &'a TiledModel,
    range: Range<u64>,
    open: Option<(&'a TilePart, Box<dyn VertexReader + 'a>)>,
    chunk: usize,
    skips_attributes: bool,
    skips_all_but_colors: bool,
}

impl<'a> TileReader<'a> {
    /// The reader of the tile in which the range begins.
    fn next(&mut self) -> Result<Option<(&'a TilePart, Box<dyn VertexReader + 'a>)>> {
        if let Some(open) = self.open.take() {
            return Ok(Some(open));
        }
        let Some((_, part)) = self.model.tile_of(self.range.start).filter(|_| !self.range.is_empty()) else {
            return Ok(None);
        };
        let end = self.range.end.min(part.before + part.model.info().vertices);
        let mut reader = part.model.vertices(self.range.start - part.before..end - part.before)?;
        reader.set_chunk(self.chunk);
        if self.skips_attributes {
            reader.skip_attributes();
        }
        if self.skips_all_but_colors {
            reader.skip_all_but_colors();
        }
        self.range.start = end;
        Ok(Some((part, reader)))
    }
}

impl VertexReader for TileReader<'_> {
    fn set_chunk(&mut self, vertices: usize) {
        self.chunk = vertices;
        if let Some((_, reader)) = &mut self.open {
            reader.set_chunk(vertices);
        }
    }

    fn skip_attributes(&mut self) {
        self.skips_attributes = true;
        if let Some((_, reader)) = &mut self.open {
            reader.skip_attributes();
        }
    }

    fn skip_all_but_colors(&mut self) {
        self.skips_all_but_colors = true;
        if let Some((_, reader)) = &mut self.open {
            reader.skip_all_but_colors();
        }
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        while let Some((part, mut reader)) = self.next()? {
            if chunk.before != part.before {
                // Data that the reader of another tile left in the chunk mean nothing to this one.
                *chunk = VertexChunk::default();
            }
            chunk.before = 0;
            if reader.read(chunk)? {
                chunk.first += part.before;
                chunk.before = part.before;
                if !self.model.info.has_normals {
                    chunk.normals.clear();
                }
                self.open = Some((part, reader));
                return Ok(true);
            }
        }
        *chunk = VertexChunk::default();
        Ok(false)
    }
}

/// Reads the faces of one tile after the other. The byte between the faces of two tiles is of no face: faces
/// can be read on from any mark, but not from one tile to another.
struct TileFaces<'a> {
    tiles: std::slice::Iter<'a, TilePart>,
    open: Option<(&'a TilePart, Box<dyn FaceReader + 'a>)>,
}

impl FaceReader for TileFaces<'_> {
    fn read(&mut self, chunk: &mut FaceChunk) -> Result<bool> {
        loop {
            let (part, mut reader) = match self.open.take() {
                Some(open) => open,
                None => {
                    let Some(part) = self.tiles.next() else {
                        chunk.clear();
                        return Ok(false);
                    };
                    (part, part.model.faces()?)
                }
            };
            if reader.read(chunk)? {
                let (vertices, before) = (part.model.info().vertices, part.before);
                let shifted = |index: u32| {
                    // An index that its own tile does not have is none of another one.
                    let index = Some(u64::from(index)).filter(|index| *index < vertices);
                    index.and_then(|index| u32::try_from(index + before).ok()).unwrap_or(u32::MAX)
                };
                chunk.triangles.iter_mut().for_each(|corners| *corners = corners.map(shifted));
                chunk.marks.iter_mut().for_each(|mark| mark.offset += part.bytes_before);
                self.open = Some((part, reader));
                return Ok(true);
            }
        }
    }
}

impl Model for TiledModel {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        &self.path
    }

    fn other_files(&self) -> Vec<&Path> {
        let mut files = Vec::new();
        for part in &self.tiles {
            files.push(part.model.path());
            files.extend(part.model.other_files());
        }
        files
    }

    fn tiles(&self) -> &[Tile] {
        &self.files
    }

    fn details(&self) -> Vec<String> {
        let tile = |tile: &Tile, info: &ModelInfo| {
            format!("{}: {}, {} vertices", tile.name.display(), info.format, info.vertices)
        };
        let all = self.files.iter().zip(self.infos());
        let mut lines: Vec<String> = all.take(MOST_DESCRIBED).map(|(t, info)| tile(t, info)).collect();
        if self.tiles.len() > MOST_DESCRIBED {
            lines.push(format!("and {} tiles more", self.tiles.len() - MOST_DESCRIBED));
        }
        lines
    }

    fn besides(&self) -> Result<Vec<String>> {
        let all: Result<Vec<_>> = self.tiles.iter().map(|part| part.model.besides()).collect();
        Ok(distinct(all?.into_iter().flatten()))
    }

    fn beyond_doubles(&self, progress: &dyn Progress) -> Result<Vec<String>> {
        let all: Result<Vec<_>> = self.tiles.iter().map(|part| part.model.beyond_doubles(progress)).collect();
        Ok(distinct(all?.into_iter().flatten()))
    }

    fn written_bytes(&self) -> u64 {
        self.tiles.iter().map(|part| part.model.written_bytes()).sum()
    }

    fn bytes_to_rewrite(&self) -> u64 {
        self.tiles.iter().map(|part| part.model.bytes_to_rewrite()).sum()
    }

    fn columns(&self) -> Option<&str> {
        self.tiles.iter().find_map(|part| part.model.columns())
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        let range = range.start..range.end.min(self.info.vertices);
        let (skips_attributes, skips_all_but_colors) = (false, false);
        let chunk = CHUNK_VERTICES;
        Ok(Box::new(TileReader {
            model: self,
            range,
            open: None,
            chunk,
            skips_attributes,
            skips_all_but_colors,
        }))
    }

    fn bytes_before(&self, vertex: u64) -> [u64; 2] {
        let Some((number, part)) = self.tile_of(vertex) else { return [0; 2] };
        let before: u64 = self.infos().take(number).map(|info| info.vertex_bytes).sum();
        let own = part.model.bytes_before(vertex.min(self.info.vertices) - part.before);
        own.map(|bytes| before + bytes)
    }

    fn keep_positions(&self, folder: Option<&Path>) {
        let mut left = MOST_KEPT_BYTES;
        for part in self.tiles.iter().take(MOST_KEPT) {
            let bytes = part.model.info().vertices.saturating_mul(KEPT_BYTES);
            if folder.is_some() && bytes > left {
                break;
            }
            left = left.saturating_sub(bytes);
            part.model.keep_positions(folder);
        }
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        let part = self.tile_of_chunk(chunk)?;
        let places = part.places.get(..to.len()).unwrap_or(&part.places);
        if places.iter().enumerate().all(|(own, place)| own == *place) {
            return part.model.attributes(chunk, to);
        }
        part.model.some_attributes(chunk, places, to)
    }

    fn some_attributes(&self, chunk: &VertexChunk, places: &[usize], to: &mut [Vec<f64>]) -> Result<()> {
        let part = self.tile_of_chunk(chunk)?;
        match places.iter().map(|place| part.places.get(*place).copied()).collect::<Option<Vec<_>>>() {
            Some(own) => part.model.some_attributes(chunk, &own, to),
            None => some_by_all(|lists| self.attributes(chunk, lists), places, to),
        }
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        Ok(Box::new(TileFaces { tiles: self.tiles.iter(), open: None }))
    }

    fn faces_at(&self, _ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        Err(Error::argument(
            format!("{}: the faces of tiles can be read only all at once", self.path.display()),
            "sample the model again",
        ))
    }

    fn has_face_marks(&self) -> bool {
        self.tiles.iter().all(|part| part.model.info().faces == 0 || part.model.has_face_marks())
    }

    fn faces_from(&self, mark: u64) -> Result<Box<dyn FaceReader + '_>> {
        let number = self.tiles.partition_point(|part| part.bytes_before <= mark).saturating_sub(1);
        let mut tiles = self.tiles[number..].iter();
        let open = match tiles.next() {
            Some(part) => Some((part, part.model.faces_from(mark - part.bytes_before)?)),
            None => None,
        };
        Ok(Box::new(TileFaces { tiles, open }))
    }

    fn check_complete(&self, progress: &dyn Progress) -> Result<()> {
        self.tiles.iter().try_for_each(|part| {
            progress.check()?;
            part.model.check_complete(progress)
        })
    }

    fn has_room_for(&self, p: DVec3) -> bool {
        self.tiles.iter().any(|part| part.model.has_room_for(p))
    }

    fn make_room(&mut self, moves: &[[DVec3; 2]], margin: f64) -> Result<Option<String>> {
        let any = self.tiles.iter().any(Self::has_integers);
        let mut changes = Vec::new();
        for part in self.tiles.iter_mut().filter(|part| !any || Self::has_integers(part)) {
            let (own, margin) = part.own_moves(moves, margin);
            changes.extend(part.model.make_room(&own, margin)?);
        }
        let attributes = std::mem::take(&mut self.info.attributes);
        // The info is that of the first tile, by which the others are told apart.
        if let Some(first) = self.tiles.first() {
            self.info = first.model.info().clone();
        }
        self.info = self.summed(attributes);
        Ok(match &changes[..] {
            [] => None,
            [one] => Some(one.clone()),
            [first, others @ ..] => Some(format!("{first}; and likewise of {}", tiles(others.len()))),
        })
    }

    fn following(&self) -> Option<&Following> {
        self.tiles.iter().find_map(|part| part.model.following())
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.tiles.iter_mut().try_for_each(|part| part.model.follow(follow))
    }

    fn division(&self, normals: Normals) -> Option<Division> {
        // Tiles that cannot be divided have vertices whose bytes are not known beforehand, or have to be
        // unpacked first.
        let are_divided = self.tiles.iter().all(|part| part.model.division(normals).is_some());
        let pieces = self.tiles.len() as u64;
        are_divided.then_some(Division { pieces, vertices: 0..pieces, in_place: true })
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        let mut numbers = 0..self.tiles.len() as u64;
        if let Some(only) = how.only {
            if self.division(how.normals).is_none() {
                return Err(Error::argument(
                    format!("{}: the tiles cannot be rewritten by themselves", self.path.display()),
                    "rewrite all of them at once",
                ));
            }
            numbers = only.first.min(numbers.end)..only.end.unwrap_or(numbers.end).min(numbers.end);
            edit.begin_behind(self.infos().take(numbers.start as usize).map(|info| info.vertex_bytes).sum());
        }
        let some = self.tiles.iter().enumerate().take(numbers.end as usize).skip(numbers.start as usize);
        for (number, part) in some {
            let Rewriting { normals, pieces_at_once, .. } = how;
            let of_tile = Rewriting { normals, pieces_at_once, ..Rewriting::default() };
            if (number as u64) < how.files_done {
                // Tiles that are done are read all the same, for the checks that compare them.
                let nothing = Rewriting { pieces_done: u64::MAX, ..of_tile };
                part.model.rewrite(&mut [], nothing, edit, progress)?;
                continue;
            }
            for output in outputs.iter_mut() {
                output.begin_file(number).map_err(|e| failed_write(&self.files[number], e))?;
            }
            let is_next = number as u64 == how.files_done;
            let of_tile = Rewriting { pieces_done: if is_next { how.pieces_done } else { 0 }, ..of_tile };
            part.model.rewrite(outputs, of_tile, edit, progress)?;
        }
        Ok(())
    }
}

fn failed_write(tile: &Tile, error: io::Error) -> Error {
    match error.downcast::<Error>() {
        // Our own writers know best what went wrong.
        Ok(error) => error,
        Err(error) => Error::io("write the new version of", &tile.path, &error),
    }
}
