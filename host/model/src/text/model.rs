//! Models whose vertices are lines of text: decoding a chunk, and putting edited numbers in their places.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::blocks::{BlockPiece, BlockPieces, BlockReader, TextBlocks, changed};
use super::digits::{Digits, Survey};
use super::lines::{LineEnds, line_end, lines, wrong_line};
use super::{
    DAMAGED, coordinate, has_many_digits, is_beyond_doubles, no_coordinate, no_normal, parse, quoted, word,
};
use crate::follow::{Follow, Following};
use crate::model::NoFaces;
use crate::pipeline::{self, Piece, PieceVersion, Pieces, Rewritable};
use crate::source::SourceFile;
use crate::unfit::{Unfit, new_component, same_normal};
use crate::{
    CHUNK_VERTICES, Edit, Edited, Error, FaceReader, Model, ModelInfo, Normals, Output, Progress, Result,
    Rewriting, Scalar, VertexChunk, VertexReader,
};

/// The grammar of a text format's lines, between the first vertex and the last.
pub(crate) trait Grammar: Send + Sync + Sized + 'static {
    /// Vertices that stay in one chunk together when the model is rewritten.
    const UNIT: u64 = 1;
    /// Extensions that names of such files have.
    const EXTENSIONS: &'static [&'static str];

    /// Way in which the lines of the format end.
    #[inline(always)]
    fn ends(&self) -> LineEnds {
        LineEnds::Breaks
    }

    /// Columns as the user named them.
    fn wanted(&self) -> Option<&str> {
        None
    }

    /// Numbers of a vertex that are its position, and its normal if it has one: 3 or 6.
    fn components(&self) -> usize {
        3
    }

    /// Content of the file that is not read, as [`Model::besides`] has it.
    fn besides(&self) -> Vec<String> {
        Vec::new()
    }

    /// Sets the attributes that turn with the surface: their numbers come behind the components.
    fn follow(&mut self, _attributes: &[usize]) {}

    /// Numbers of a vertex whose places are noted: its components, and those that turn.
    fn numbers(&self) -> usize {
        self.components()
    }

    /// Whether a line is a vertex.
    fn is_vertex(&self, line: &[u8]) -> bool;

    /// Notes the places of a vertex' numbers in its line. The places of numbers that are missing are left as
    /// they are.
    fn words(&self, line: &[u8], spans: &mut [[usize; 2]]);

    /// Whether a line has a cell for a component, which may be empty.
    fn has_cell(&self, _line: &[u8], _component: usize) -> bool {
        false
    }

    /// Notes where the numbers of all vertices stand in whole lines; returns how many vertices there are.
    fn find(&self, raw: &[u8], spans: &mut Vec<[u32; 2]>) -> usize {
        let (mut count, mut words) = (0, vec![[0; 2]; self.numbers()]);
        for (start, end) in lines(raw, self.ends()) {
            let line = &raw[start..end];
            if self.is_vertex(line) {
                words.fill([0; 2]);
                self.words(line, &mut words);
                spans.extend(words.iter().map(|word| word.map(|at| (start + at) as u32)));
                count += 1;
            }
        }
        count
    }

    /// Byte at which the first `count` vertices of `bytes` end.
    fn cut(&self, bytes: &[u8], count: u64) -> Option<usize> {
        let (mut at, mut left) = (0, count);
        while left > 0 {
            let length = line_end(&bytes[at..], self.ends(), true)?;
            left -= u64::from(self.is_vertex(&bytes[at..at + length]));
            at += length;
        }
        Some(at)
    }

    /// The word of an attribute in the line of a vertex; an empty one says that there is no number.
    fn attribute<'l>(&self, _line: &'l [u8], _attribute: usize) -> Option<&'l [u8]> {
        None
    }

    /// Appends a chunk with other numbers to `text`.
    fn encode(
        model: &TextModel<Self>,
        chunk: &VertexChunk,
        edited: &Edited,
        text: &mut Vec<u8>,
    ) -> Result<(), Unfit> {
        model.splice(chunk, edited, text)
    }

    /// A reader of the faces between some bytes, or of all.
    fn faces<'a>(
        _model: &'a TextModel<Self>,
        _ranges: Option<Vec<Range<u64>>>,
    ) -> Result<Box<dyn FaceReader + 'a>> {
        Ok(Box::new(NoFaces))
    }

    /// Advice about normals that shall be left out, which is not possible in such a file.
    fn without_normals(&self) -> &'static str {
        "keep the normals, or have them transformed; or export the model without them"
    }
}

/// A file whose vertices are lines.
#[derive(Debug)]
pub(crate) struct TextModel<G> {
    pub(crate) source: SourceFile,
    pub(crate) grammar: G,
    pub(crate) blocks: TextBlocks,
    /// Attributes that turn with the surface.
    following: Following,
    /// The digits of each of a vertex' numbers.
    pub(crate) digits: Vec<Digits>,
    pub(crate) info: ModelInfo,
}

/// Info on a text file, but for its vertices.
pub(crate) fn info(source: &SourceFile, format: String) -> ModelInfo {
    ModelInfo { format, position_type: Scalar::F64, bytes: source.len(), ..ModelInfo::default() }
}

impl<G: Grammar> TextModel<G> {
    /// Model of a file whose vertices lie in these blocks.
    pub(crate) fn new(source: SourceFile, grammar: G, blocks: TextBlocks, info: ModelInfo) -> Result<Self> {
        let info = ModelInfo {
            vertices: blocks.vertices(),
            vertex_bytes: blocks.vertex_bytes(),
            has_normals: grammar.components() == 6,
            ..info
        };
        let following = Following::recognised(&info.attributes);
        let mut model = Self { source, grammar, blocks, following, digits: Vec::new(), info };
        model.note_what_follows()?;
        Ok(model)
    }

    /// Notes the places and the digits of all numbers that are written anew.
    fn note_what_follows(&mut self) -> Result<()> {
        self.grammar.follow(self.following.places());
        self.digits = self.survey()?;
        Ok(())
    }

    /// Ranges of a vertex' numbers that have as many digits: its position, its normal, and the numbers that
    /// turn together.
    fn sorts(&self) -> Vec<Range<usize>> {
        let components = self.grammar.components();
        let following = self.following.groups().map(|group| group.start + components..group.end + components);
        let own = (0..components).step_by(3).map(|first| first..first + 3);
        own.chain(following).collect()
    }

    /// The digits of numbers all over the file, for each of a vertex.
    fn survey(&self) -> Result<Vec<Digits>> {
        const BLOCKS: usize = 32;
        const OF_A_BLOCK: u64 = 64;
        let sorts = self.sorts();
        let mut surveys: Vec<Survey> = sorts.iter().map(|_| Survey::default()).collect();
        let (mut raw, mut spans) = (Vec::new(), Vec::new());
        for (vertices, bytes) in self.blocks.spread(BLOCKS) {
            raw.clear();
            spans.clear();
            self.source.append_at(&mut raw, bytes.start, (bytes.end - bytes.start) as usize)?;
            let wanted = OF_A_BLOCK.min(vertices.end - vertices.start).next_multiple_of(G::UNIT);
            let end = self.grammar.cut(&raw, wanted).unwrap_or(raw.len());
            self.grammar.find(&raw[..end], &mut spans);
            for spans in spans.chunks_exact(self.grammar.numbers()) {
                for (survey, sort) in surveys.iter_mut().zip(&sorts) {
                    let words = spans[sort.clone()].iter().map(|span| word(&raw, *span));
                    words.enumerate().for_each(|(coordinate, word)| survey.take(coordinate, word));
                }
            }
        }
        let components = self.grammar.components();
        let of_sort = |(survey, sort): (&Survey, &Range<usize>)| {
            let extent = match sort.start {
                0 => None,
                first if first < components => Some(1.0),
                // A component of a vector that turns may become any share of the vector's length.
                _ => Some(survey.largest()),
            };
            vec![survey.digits(extent); sort.len()]
        };
        Ok(surveys.iter().zip(&sorts).flat_map(of_sort).collect())
    }

    /// Fills a chunk's positions and normals from its bytes, which hold as many vertices as it has places
    /// for.
    pub(crate) fn decode(&self, chunk: &mut VertexChunk, vertices: usize) -> Result<()> {
        let VertexChunk { positions, normals, raw, spans, .. } = chunk;
        positions.clear();
        normals.clear();
        spans.clear();
        if self.grammar.find(raw, spans) != vertices {
            return Err(changed(&self.source));
        }
        if let Some(at) = memchr::memchr(0, raw) {
            return Err(self.zero_byte(chunk.first, raw, at));
        }
        let components = self.grammar.components();
        for (vertex, spans) in spans.chunks_exact(self.grammar.numbers()).enumerate() {
            let mut values = [0.0; 6];
            for (n, (value, span)) in values.iter_mut().zip(&spans[..components]).enumerate() {
                *value = match coordinate(Scalar::F64, word(raw, *span)) {
                    Some(number) => number,
                    None => self.no_number(chunk.first + vertex as u64, n, raw, *span)?,
                };
            }
            let [x, y, z, nx, ny, nz] = values;
            positions.push(DVec3::new(x, y, z));
            if components == 6 {
                normals.push(DVec3::new(nx, ny, nz).as_vec3());
            }
        }
        Ok(())
    }

    /// Value of a component without a number: NaN where the cell is empty, or else an error.
    #[cold]
    fn no_number(&self, vertex: u64, component: usize, raw: &[u8], span: [u32; 2]) -> Result<f64> {
        let found = word(raw, span);
        if !found.is_empty() {
            let wrong = if component < 3 { no_coordinate } else { no_normal };
            let (what, hint) = wrong(Scalar::F64, found);
            return Err(self.wrong_vertex(vertex, format!("vertex {vertex}: {what}"), hint));
        }
        let at = span[0] as usize;
        let start = raw[..at].iter().rposition(|b| matches!(b, b'\n' | b'\r')).map_or(0, |end| end + 1);
        let end = line_end(&raw[start..], self.grammar.ends(), true).unwrap_or_default();
        if self.grammar.has_cell(&raw[start..start + end], component) {
            return Ok(f64::NAN);
        }
        let what = format!("vertex {vertex} has fewer than {} numbers", self.grammar.components());
        Err(self.wrong_vertex(vertex, what, DAMAGED))
    }

    /// Error about a byte of zero in a chunk that begins with the vertex `first`. Where a disk was full, such
    /// bytes stand instead of the text: the number of vertices is unknown then.
    #[cold]
    fn zero_byte(&self, first: u64, raw: &[u8], at: usize) -> Error {
        let (mut vertex, mut is_in) = (first, false);
        for (start, end) in lines(raw, self.grammar.ends()).take_while(|line| line.0 <= at) {
            vertex += u64::from(std::mem::replace(&mut is_in, self.grammar.is_vertex(&raw[start..end])));
        }
        let what = match is_in {
            true => format!("vertex {vertex}: a byte of zero"),
            false => format!("a byte of zero before vertex {vertex}"),
        };
        match self.block_of(first) {
            Ok(Some((block, begin, before))) => {
                let start = begin + self.grammar.cut(&block, before).unwrap_or_default() as u64;
                wrong_line(&self.source, start + at as u64, what, DAMAGED)
            }
            Ok(None) => self.source.malformed(what, DAMAGED),
            Err(error) => error,
        }
    }

    /// Error about a vertex, with the number of its line.
    fn wrong_vertex(&self, vertex: u64, what: String, hint: &str) -> Error {
        match self.place_of(vertex) {
            Ok(Some(offset)) => wrong_line(&self.source, offset, what, hint),
            Ok(None) => self.source.malformed(what, hint),
            Err(error) => error,
        }
    }

    /// Bytes of the block that holds a vertex, the byte of the file at which they begin, and the number of
    /// vertices before this one in the block.
    fn block_of(&self, vertex: u64) -> Result<Option<(Vec<u8>, u64, u64)>> {
        let Some((of, bytes)) = self.blocks.spread(usize::MAX).find(|block| block.0.contains(&vertex)) else {
            return Ok(None);
        };
        let mut raw = vec![0; (bytes.end - bytes.start) as usize];
        self.source.read_at(&mut raw, bytes.start)?;
        Ok(Some((raw, bytes.start, vertex - of.start)))
    }

    /// Byte of the file at which the last byte of a vertex is.
    fn place_of(&self, vertex: u64) -> Result<Option<u64>> {
        let Some((raw, begin, before)) = self.block_of(vertex)? else { return Ok(None) };
        let end = self.grammar.cut(&raw, before + 1);
        Ok(end.map(|end| {
            let line = raw[..end].trim_ascii_end().len();
            begin + line.saturating_sub(1) as u64
        }))
    }

    /// An error where normals cannot be left out.
    pub(crate) fn check_normals(&self, normals: Normals) -> Result<()> {
        if normals == Normals::Drop && self.info.has_normals {
            return Err(self.source.keeps_normals(self.grammar.without_normals()));
        }
        Ok(())
    }

    /// The numbers of the first attributes.
    pub(crate) fn read_attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        to.iter_mut().for_each(Vec::clear);
        let mut vertex = chunk.first_of_file();
        for (start, end) in lines(&chunk.raw, self.grammar.ends()) {
            let line = &chunk.raw[start..end];
            if !self.grammar.is_vertex(line) {
                continue;
            }
            for (i, values) in to.iter_mut().enumerate() {
                let word = self.grammar.attribute(line, i);
                let is_empty = word == Some(&[]);
                let word = word.unwrap_or_default();
                let Some(value) = is_empty.then_some(f64::NAN).or_else(|| parse(Scalar::F64, word)) else {
                    let (name, word) = (&self.info.attributes[i].name, String::from_utf8_lossy(word));
                    let what = format!("vertex {vertex}: {} {} is no number", quoted(name), quoted(&word));
                    return Err(self.wrong_vertex(vertex, what, DAMAGED));
                };
                values.push(value);
            }
            vertex += 1;
        }
        Ok(())
    }

    /// Appends a chunk's bytes to `text`, with those numbers replaced that were edited, or turn.
    pub(crate) fn splice(
        &self,
        chunk: &VertexChunk,
        edited: &Edited,
        text: &mut Vec<u8>,
    ) -> Result<(), Unfit> {
        let VertexChunk { positions, raw, spans, .. } = chunk;
        let (components, numbers) = (self.grammar.components(), self.grammar.numbers());
        let mut copied = 0;
        // Words come in the file's order, but for columns that do not.
        let mut order: Vec<usize> = (0..numbers).collect();
        if let Some(of_vertex) = spans.get(..numbers) {
            order.sort_by_key(|n| of_vertex[*n][0]);
        }
        // Numbers that turn, before and after.
        let mut turned = [Vec::new(), Vec::new()];
        let mut words: Vec<(usize, f64)> = Vec::with_capacity(numbers);
        for (vertex, spans) in spans.chunks_exact(numbers).enumerate() {
            if !positions[vertex].is_finite() {
                continue;
            }
            self.turn(vertex, edited, (raw, &spans[components..]), &mut turned);
            words.clear();
            for &n in &order {
                let new = if n < components {
                    new_component(chunk, edited, (vertex, n), Scalar::F64)?
                } else if let [Some(old), Some(new)] = turned.each_ref().map(|of| of.get(n - components)) {
                    Some(*new).filter(|new| new.to_bits() != old.to_bits() && new.is_finite())
                } else {
                    None
                };
                words.extend(new.map(|new| (n, new)));
            }
            if words.windows(2).any(|pair| spans[pair[0].0][0] > spans[pair[1].0][0]) {
                words.sort_by_key(|(n, _)| spans[*n][0]);
            }
            for &(n, value) in &words {
                let [start, end] = spans[n].map(|at| at as usize);
                text.extend_from_slice(&raw[copied..start]);
                self.digits[n].write(text, &raw[start..end], value);
                copied = end;
            }
        }
        text.extend_from_slice(&raw[copied..]);
        Ok(())
    }

    /// Fills the lists with the old and the new numbers of a vertex that turn; they are empty where the
    /// numbers stay.
    fn turn(
        &self,
        vertex: usize,
        edited: &Edited,
        (raw, spans): (&[u8], &[[u32; 2]]),
        [old, new]: &mut [Vec<f64>; 2],
    ) {
        old.clear();
        new.clear();
        let Some(gradient) = edited.gradients.get(vertex).filter(|g| **g != Mat3::IDENTITY) else { return };
        // A word that is no number stays, as nothing that it belongs to is finite.
        old.extend(spans.iter().map(|span| parse(Scalar::F64, word(raw, *span)).unwrap_or(f64::NAN)));
        new.clone_from(old);
        self.following.turn(gradient, edited.mirrored, new);
    }
}

/// Writes one normal in the place of another.
pub(crate) fn splice_normal(
    raw: &[u8],
    spans: &[[u32; 2]],
    (old, new): (Vec3, Vec3),
    digits: &Digits,
    copied: &mut usize,
    text: &mut Vec<u8>,
) {
    for c in 0..3 {
        if !same_normal(old[c], new[c]) {
            let [start, end] = spans[c].map(|at| at as usize);
            text.extend_from_slice(&raw[*copied..start]);
            digits.write(text, &raw[start..end], f64::from(new[c]));
            *copied = end;
        }
    }
}

/// Reads the vertices of a range.
struct TextReader<'a, G> {
    model: &'a TextModel<G>,
    blocks: BlockReader<'a>,
}

impl<G: Grammar> VertexReader for TextReader<'_, G> {
    fn set_chunk(&mut self, vertices: usize) {
        self.blocks.set_chunk(vertices);
    }

    fn read(&mut self, chunk: &mut VertexChunk) -> Result<bool> {
        chunk.first = self.blocks.next_vertex();
        let vertices = self.blocks.read(&mut chunk.raw, |bytes, n| self.model.grammar.cut(bytes, n))?;
        self.model.decode(chunk, vertices as usize)?;
        Ok(vertices > 0)
    }
}

impl<G: Grammar> Model for TextModel<G> {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    fn extensions(&self) -> &'static [&'static str] {
        G::EXTENSIONS
    }

    fn columns(&self) -> Option<&str> {
        self.grammar.wanted()
    }

    fn besides(&self) -> Result<Vec<String>> {
        Ok(self.grammar.besides())
    }

    /// Memory: a block for each thread.
    fn beyond_doubles(&self, progress: &dyn Progress) -> Result<Vec<String>> {
        if self.info.attributes.is_empty() {
            return Ok(Vec::new());
        }
        let are_beyond: Vec<AtomicBool> =
            self.info.attributes.iter().map(|_| AtomicBool::new(false)).collect();
        progress.begin("looking for numbers beyond 2^53", self.info.vertex_bytes);
        let are_all = || are_beyond.iter().all(|is_beyond| is_beyond.load(Relaxed));
        self.blocks.spread(usize::MAX).par_bridge().try_for_each_init(Vec::new, |raw, (_, bytes)| {
            progress.check()?;
            progress.advance(bytes.end - bytes.start);
            if are_all() {
                return Ok(());
            }
            raw.clear();
            self.source.append_at(raw, bytes.start, (bytes.end - bytes.start) as usize)?;
            if !has_many_digits(raw) {
                return Ok(());
            }
            let of_vertices = lines(raw, self.grammar.ends()).map(|(start, end)| &raw[start..end]);
            for line in of_vertices.filter(|line| has_many_digits(line) && self.grammar.is_vertex(line)) {
                for (attribute, is_beyond) in are_beyond.iter().enumerate() {
                    if self.grammar.attribute(line, attribute).is_some_and(is_beyond_doubles) {
                        is_beyond.store(true, Relaxed);
                    }
                }
            }
            Ok(())
        })?;
        let are_beyond = are_beyond.into_iter().map(AtomicBool::into_inner);
        let beyond = self.info.attributes.iter().zip(are_beyond).filter(|(_, is_beyond)| *is_beyond);
        Ok(beyond
            .map(|(of, _)| format!("digits of {}, which has whole numbers beyond 2^53", quoted(&of.name)))
            .collect())
    }

    fn vertices(&self, range: Range<u64>) -> Result<Box<dyn VertexReader + '_>> {
        Ok(Box::new(TextReader { model: self, blocks: BlockReader::new(&self.source, &self.blocks, range) }))
    }

    fn attributes(&self, chunk: &VertexChunk, to: &mut [Vec<f64>]) -> Result<()> {
        self.read_attributes(chunk, to)
    }

    fn faces(&self) -> Result<Box<dyn FaceReader + '_>> {
        G::faces(self, None)
    }

    fn faces_at(&self, ranges: Vec<Range<u64>>) -> Result<Box<dyn FaceReader + '_>> {
        G::faces(self, Some(ranges))
    }

    fn check_complete(&self, _progress: &dyn Progress) -> Result<()> {
        // The whole file was read when it was opened.
        self.source.check_unchanged()
    }

    fn following(&self) -> Option<&Following> {
        (!self.following.is_empty()).then_some(&self.following)
    }

    fn follow(&mut self, follow: &Follow) -> Result<()> {
        self.following = Following::declared(follow, &self.info.attributes, self.source.path())?;
        self.note_what_follows()
    }

    fn rewrite(
        &self,
        outputs: &mut [&mut dyn Output],
        how: Rewriting,
        edit: &dyn Edit,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.check_normals(how.normals)?;
        self.following.check(self.source.path())?;
        pipeline::rewrite(self, outputs, how, edit, progress)?;
        self.following.tell(self.source.path(), progress);
        Ok(())
    }
}

impl<G: Grammar> Rewritable for TextModel<G> {
    fn pieces(&self, _normals: Normals) -> Result<Box<dyn Pieces + '_>> {
        let chunk = CHUNK_VERTICES - CHUNK_VERTICES % G::UNIT as usize;
        Ok(Box::new(TextPieces { model: self, pieces: BlockPieces::new(&self.source, &self.blocks, chunk) }))
    }

    fn decode(&self, chunk: &mut VertexChunk) -> Result<()> {
        chunk.follows = !self.following.is_empty();
        // The piece has a place for each vertex.
        let vertices = chunk.spans.len();
        TextModel::decode(self, chunk, vertices)
    }

    fn encode(&self, chunk: &mut VertexChunk, version: PieceVersion<'_>) -> Result<()> {
        version.bytes.clear();
        let unfit = |unfit: Unfit| unfit.error(&self.source, chunk.first);
        G::encode(self, chunk, version.edited, version.bytes).map_err(unfit)
    }

    fn source(&self) -> &SourceFile {
        &self.source
    }
}

struct TextPieces<'a, G> {
    model: &'a TextModel<G>,
    pieces: BlockPieces<'a>,
}

impl<G: Grammar> Pieces for TextPieces<'_, G> {
    fn read(&mut self, chunk: &mut VertexChunk) -> Result<Piece> {
        let grammar = &self.model.grammar;
        chunk.positions.clear();
        chunk.normals.clear();
        chunk.spans.clear();
        Ok(match self.pieces.read(&mut chunk.raw, |bytes, n| grammar.cut(bytes, n))? {
            BlockPiece::Vertices(first, vertices) => {
                chunk.first = first;
                chunk.spans.resize(vertices as usize, [0; 2]);
                Piece::Vertices(vertices as usize)
            }
            BlockPiece::Bytes => Piece::Bytes,
            BlockPiece::End => Piece::End,
        })
    }
}
