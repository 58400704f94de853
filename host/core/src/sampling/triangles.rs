//! Triangles of P_S: the faces of P_L whose corners are in three different clusters, between their samples
//! (J. Rossignac, P. Borrel, *Multi-resolution 3D approximations for rendering complex scenes*, 1993).

use rayon::prelude::*;
use simod_model::mapped::looked_at;
use simod_model::{FaceMark, Model, Progress, Result, for_faces};

use super::face_ranges::{FaceRanges, MetCells};
use super::placement::{FACES_OF_A_JOB, Planes};
use crate::touching::Islands;

/// Largest number of triangles for each sample. A closed surface has two, and any that is worth the name not
/// many more; beyond it the faces are a tangle that tells nothing of P_S, as large as P_L's own.
const MOST_PER_SAMPLE: usize = 16;

/// Bytes of temporary files that are looked up for a face: sample, place and island of each corner.
pub const BYTES_OF_A_FACE: usize = 3 * 20;

/// Triangles of P_S, as found in a model's faces.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Triangles {
    /// Samples of each triangle, in the orientation of its faces; each triangle once, in no order that means
    /// anything.
    pub triangles: Vec<[u32; 3]>,
    /// Corners are not samples yet, but of vertices, for which samples still have to be [put](Self::put).
    pub of_vertices: bool,
    /// Number of triangles of P_L that refer to a vertex that there is not.
    pub without_vertex: u64,
    /// Whether there were more than [`MOST_PER_SAMPLE`], and all were dropped.
    pub tangled: bool,
}

impl Triangles {
    /// Puts samples for vertices, if these are still there: each triangle once, without those that are none.
    pub fn put(&mut self, sample_of: &[u32]) {
        if std::mem::take(&mut self.of_vertices) {
            // Triangles are in about the vertices' order.
            let share = size_of_val(sample_of) / self.triangles.len().max(1);
            self.triangles.par_chunks_mut(FACES_OF_A_JOB).for_each(|some| {
                for triangle in some.iter_mut() {
                    *triangle = first_least(triangle.map(|vertex| sample_of[vertex as usize]));
                }
                looked_at(share * some.len());
            });
            self.triangles.retain(|[a, b, c]| a != b && b != c && c != a);
            once_each(&mut self.triangles);
            self.triangles.shrink_to_fit();
        }
    }

    /// Removes triangles that are there twice, if there are more than twice `most`; and all triangles, if
    /// there are still more than `most`.
    fn keep_few(&mut self, sample_of: &[u32], most: usize) {
        if self.triangles.len() > 2 * most {
            self.put(sample_of);
            once_each(&mut self.triangles);
            if self.triangles.len() > most {
                (self.triangles, self.tangled) = (Vec::new(), true);
            }
        }
    }
}

/// Findings that are looked for in the faces.
#[derive(Default)]
pub struct Wanted<'a, 'p> {
    /// Whether the triangles of P_S are wanted.
    pub triangles: bool,
    /// Ranges of the file with the faces of each cell, if they are wanted.
    pub ranges: Option<&'a mut FaceRanges>,
    /// Islands of vertices that hang together, if they are wanted.
    pub islands: Option<&'a mut Islands>,
    /// Planes around each sample, if they are wanted.
    pub planes: Option<&'a mut Planes<'p>>,
}

/// Takes faces, some at a time, in the file's order. `sample_of` says which sample each vertex belongs to.
/// Where islands are looked for, by which clusters may be parted, the triangles come as vertices, unless
/// there are too many.
///
/// Memory: 12 bytes for each of at most twice [`MOST_PER_SAMPLE`] triangles per sample, twice while the list
/// grows; a surface has about two, found once or twice each. Of the triangles that are taken at once at most
/// 12 bytes each, 12 more where ranges are noted, and a byte for the marks.
pub struct Reindexing<'a, 'p> {
    sample_of: &'a [u32],
    samples: usize,
    wanted: Wanted<'a, 'p>,
    /// The number of triangles, at most.
    most: usize,
    found: Triangles,
}

impl<'a, 'p> Reindexing<'a, 'p> {
    /// Reindexing that has taken no faces yet.
    pub fn new(sample_of: &'a [u32], samples: usize, wanted: Wanted<'a, 'p>) -> Self {
        let of_vertices = wanted.triangles && wanted.islands.is_some();
        let found = Triangles { of_vertices, ..Triangles::default() };
        Self { sample_of, samples, wanted, most: MOST_PER_SAMPLE * samples.max(64), found }
    }

    /// Takes the next triangles, and the marks among them; and the triangles whose planes are summed up,
    /// which are the same but for a unit that reads a part of the faces. Takes jobs of the thread pool.
    pub fn take(&mut self, triangles: &[[u32; 3]], marks: &[FaceMark], summed: &[[u32; 3]]) {
        // The following is done by one of the pool's threads: else it would have to be woken for each part.
        rayon::scope(|_| {
            let Self { sample_of, samples, ref mut wanted, ref found, .. } = *self;
            let Wanted { triangles: wants_triangles, ranges, islands, planes } = wanted;
            let (wants_triangles, of_vertices) = (*wants_triangles && !found.tangled, found.of_vertices);
            let look = Look { sample_of, samples, wants_triangles, of_vertices, ranges: ranges.as_deref() };
            let sample_of = |vertex: u32| sample_of.get(vertex as usize).copied();
            let samples_of = |corners: [u32; 3]| all_three(corners.map(sample_of));
            let mut join = || islands.iter_mut().for_each(|islands| islands.take(triangles, samples_of));
            let mut add_planes = || planes.iter_mut().for_each(|planes| planes.take(summed, samples_of));
            let (pieces, _) =
                rayon::join(|| look.pieces(triangles, marks), || rayon::join(&mut join, &mut add_planes));
            pieces.into_iter().for_each(|piece| self.add_piece(piece));
            looked_at(BYTES_OF_A_FACE * triangles.len().max(summed.len()));
            self.found.keep_few(self.sample_of, self.most);
        });
    }

    fn add_piece(&mut self, piece: FoundInFaces) {
        self.found.without_vertex += piece.without_vertex;
        self.found.triangles.extend_from_slice(&piece.triangles);
        if let Some(ranges) = &mut self.wanted.ranges {
            ranges.take(&piece.met);
        }
    }

    /// The sample of a vertex, if it has any.
    pub fn sample(&self, vertex: u32) -> Option<u32> {
        self.sample_of.get(vertex as usize).copied().filter(|sample| (*sample as usize) < self.samples)
    }

    /// Findings that were wanted besides the triangles.
    pub fn wanted(&mut self) -> &mut Wanted<'a, 'p> {
        &mut self.wanted
    }

    /// Adds the findings of another one in other faces, of the same vertices.
    pub fn add(&mut self, found: &Triangles) {
        let own = &mut self.found;
        own.without_vertex += found.without_vertex;
        own.tangled |= found.tangled;
        if own.of_vertices && !found.of_vertices {
            own.put(self.sample_of);
        }
        if own.tangled {
            own.triangles = Vec::new();
        } else if own.of_vertices == found.of_vertices {
            own.triangles.extend_from_slice(&found.triangles);
        } else {
            let mut put =
                Triangles { triangles: found.triangles.clone(), of_vertices: true, ..Triangles::default() };
            put.put(self.sample_of);
            own.triangles.append(&mut put.triangles);
        }
        own.keep_few(self.sample_of, self.most);
    }

    /// The triangles, unless there are too many: in all, whatever order they came in.
    pub fn finish(self) -> Triangles {
        let Self { mut found, sample_of, most, .. } = self;
        if !found.of_vertices {
            once_each(&mut found.triangles);
        }
        let mut count = found.triangles.len();
        if found.of_vertices && count > most {
            let triangles = found.triangles.clone();
            let mut put = Triangles { triangles, of_vertices: true, ..Triangles::default() };
            put.put(sample_of);
            count = put.triangles.len();
        }
        if count > most {
            (found.triangles, found.tangled) = (Vec::new(), true);
        }
        found.triangles.shrink_to_fit();
        found
    }
}

/// Inputs by which triangles are looked at.
struct Look<'a> {
    sample_of: &'a [u32],
    samples: usize,
    wants_triangles: bool,
    /// Whether corners are wanted as vertices.
    of_vertices: bool,
    /// Cell of each sample, if the cells that faces meet are noted.
    ranges: Option<&'a FaceRanges>,
}

impl Look<'_> {
    /// Looks at triangles, piece by piece, and the marks among them.
    fn pieces(&self, triangles: &[[u32; 3]], marks: &[FaceMark]) -> Vec<FoundInFaces> {
        let before = |end: usize| marks.partition_point(|mark| mark.triangle < end);
        let piece = |(at, some): (usize, &[[u32; 3]])| {
            let (first, end) = (at * FACES_OF_A_JOB, at * FACES_OF_A_JOB + some.len());
            // The last one has those behind all triangles, too.
            let last = if end == triangles.len() { marks.len() } else { before(end) };
            self.piece(first, some, &marks[before(first)..last])
        };
        let mut pieces: Vec<FoundInFaces> =
            triangles.par_chunks(FACES_OF_A_JOB).enumerate().map(piece).collect();
        if triangles.is_empty() {
            pieces.push(self.piece(0, &[], marks));
        }
        pieces
    }

    /// Findings in some triangles, of which the first one has number `first`, as marks count.
    fn piece(&self, first: usize, triangles: &[[u32; 3]], marks: &[FaceMark]) -> FoundInFaces {
        let mut piece = FoundInFaces::default();
        let mut marks = marks.iter().peekable();
        for (at, corners) in (first..).zip(triangles) {
            while let Some(mark) = marks.next_if(|mark| mark.triangle <= at) {
                piece.met.mark(mark.offset);
            }
            let of = corners.map(|corner| self.sample_of.get(corner as usize).copied());
            let [Some(a), Some(b), Some(c)] = of else {
                piece.without_vertex += 1;
                of.iter().flatten().for_each(|sample| self.meet(*sample, &mut piece.met));
                continue;
            };
            self.meet(a, &mut piece.met);
            if a == b && b == c {
                continue;
            }
            self.meet(b, &mut piece.met);
            self.meet(c, &mut piece.met);
            // Vertices without a finite position have no sample.
            let are_samples = || a.max(b).max(c) < self.samples as u32;
            if self.wants_triangles && a != b && b != c && c != a && are_samples() {
                let triangle = if self.of_vertices { *corners } else { first_least([a, b, c]) };
                piece.triangles.push(triangle);
            }
        }
        marks.for_each(|mark| piece.met.mark(mark.offset));
        piece
    }

    /// A face has a corner in a sample's cluster.
    #[inline]
    fn meet(&self, sample: u32, met: &mut MetCells) {
        if let Some(ranges) = &self.ranges
            && (sample as usize) < self.samples
        {
            met.meet(ranges.cell_of(sample));
        }
    }
}

/// Findings in some faces.
#[derive(Default)]
struct FoundInFaces {
    triangles: Vec<[u32; 3]>,
    without_vertex: u64,
    met: MetCells,
}

/// Streams the faces of a model through a [`Reindexing`].
///
/// Memory: that, and the chunks of [`for_faces`].
///
/// # Errors
/// The model cannot be read; the user cancelled.
pub fn reindex(
    model: &dyn Model,
    sample_of: &[u32],
    samples: usize,
    wanted: Wanted<'_, '_>,
    progress: &dyn Progress,
) -> Result<Triangles> {
    let mut reindexing = Reindexing::new(sample_of, samples, wanted);
    // Faces of several files cannot be read from one mark to another.
    let are_ranges = model.tiles().is_empty();
    for_faces(model, |chunk| {
        progress.check()?;
        let marks = if are_ranges { &chunk.marks[..] } else { &[] };
        reindexing.take(&chunk.triangles, marks, &chunk.triangles);
        progress.advance(chunk.bytes);
        Ok(())
    })?;
    Ok(reindexing.finish())
}

/// All three samples, if all are known.
pub fn all_three([a, b, c]: [Option<u32>; 3]) -> Option<[u32; 3]> {
    Some([a?, b?, c?])
}

/// The triangle, beginning with its least corner.
pub fn first_least([a, b, c]: [u32; 3]) -> [u32; 3] {
    if a < b && a < c {
        [a, b, c]
    } else if b < c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// Removes triangles that are there twice; the rest are in the order of their samples.
pub fn once_each(triangles: &mut Vec<[u32; 3]>) {
    triangles.sort_unstable();
    triangles.dedup();
}

#[cfg(test)]
mod tests {
    use super::super::kept_cells::CutTree;
    use super::*;
    use proptest::prelude::*;

    /// Places of marks: mostly near where one piece ends and the next begins.
    fn places(faces: usize) -> impl Strategy<Value = Vec<usize>> {
        let near = (0..=faces / FACES_OF_A_JOB, 0..4usize)
            .prop_map(|(piece, beyond)| piece * FACES_OF_A_JOB + beyond);
        prop::collection::vec(prop_oneof![near, 0..=faces], 0..60).prop_map(move |mut places| {
            places.iter_mut().for_each(|place| *place = (*place).min(faces));
            places.sort_unstable();
            places
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn faces_that_are_taken_at_once_tell_what_they_tell_one_by_one(
            (faces, places) in (0..3 * FACES_OF_A_JOB + 9).prop_flat_map(|faces| (Just(faces), places(faces))),
            seed in 0..1000u32,
        ) {
            let random = |i: usize| (i as u32).wrapping_add(seed).wrapping_mul(2_654_435_761) >> 9;
            let (samples, cells, vertices) = (40, 5, 900u32);
            // Some vertices have no sample.
            let sample_of: Vec<u32> =
                (0..vertices).map(|v| if v % 97 == 0 { u32::MAX } else { v * samples / vertices }).collect();
            let of_cell = |cell: u32| (0..samples).filter(|sample| sample * cells / samples == cell).collect();
            let tree = |cell| CutTree { samples: of_cell(cell), ..CutTree::default() };
            let trees: Vec<CutTree> = (0..cells).map(tree).collect();
            // Near each other; some of no vertex.
            let corner = |i: usize, k: u32| (i as u32 * vertices / faces.max(1) as u32 + random(i) % 30 + k * 7)
                .min(vertices);
            let triangles: Vec<[u32; 3]> =
                (0..faces).map(|i| [corner(i, 0), corner(i, 1), corner(i, 2)]).collect();
            let mark = |(number, triangle): (usize, &usize)| {
                FaceMark { triangle: *triangle, offset: 100 + 10 * number as u64 }
            };
            let marks: Vec<FaceMark> = places.iter().enumerate().map(mark).collect();
            let found = |one_by_one: bool| {
                let mut ranges = FaceRanges::listed(&trees, samples as usize);
                let wanted = Wanted { triangles: true, ranges: Some(&mut ranges), ..Wanted::default() };
                let mut reindexing = Reindexing::new(&sample_of, samples as usize, wanted);
                if one_by_one {
                    for (at, triangle) in triangles.iter().enumerate() {
                        let here = marks.iter().filter(|mark| mark.triangle == at);
                        let here: Vec<FaceMark> =
                            here.map(|mark| FaceMark { triangle: 0, offset: mark.offset }).collect();
                        reindexing.take(&[*triangle], &here, &[]);
                    }
                    let behind = marks.iter().filter(|mark| mark.triangle >= faces);
                    reindexing.take(&[], &behind.copied().collect::<Vec<_>>(), &[]);
                } else {
                    reindexing.take(&triangles, &marks, &[]);
                }
                let found = reindexing.finish();
                let mut taken = ranges.take_listed(true);
                taken.sort_by_key(|(cell, range)| (*cell, range.start));
                (found, taken)
            };
            let (at_once, one_by_one) = (found(false), found(true));
            prop_assert_eq!(at_once, one_by_one);
        }
    }
}
