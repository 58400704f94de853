//! Triangles of P_S: the faces of P_L whose corners are in three different clusters, between their samples
//! (J. Rossignac, P. Borrel, *Multi-resolution 3D approximations for rendering complex scenes*, 1993).

use rayon::prelude::*;
use simod_model::{FaceMark, Model, Progress, Result, for_faces};

use super::face_ranges::FaceRanges;
use super::placement::Planes;
use crate::touching::Islands;

/// Most triangles for each sample. A closed surface has two, and any that is worth the name not many more;
/// beyond it the faces are a tangle that tells nothing of P_S, as large as P_L's own.
const MOST_PER_SAMPLE: usize = 16;

/// Triangles of P_S, as found in a model's faces.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Triangles {
    /// Samples of each triangle, in the orientation of its faces; each triangle once, in no order that means
    /// anything.
    pub triangles: Vec<[u32; 3]>,
    /// They are not of samples yet, but of vertices, for which samples still have to be [put](Self::put).
    pub of_vertices: bool,
    /// Number of triangles of P_L that refer to a vertex that there is not.
    pub without_vertex: u64,
    /// There were more than [`MOST_PER_SAMPLE`], and all were dropped.
    pub tangled: bool,
}

impl Triangles {
    /// Puts samples for vertices, if these are still there: each triangle once, without those that are none.
    pub fn put(&mut self, sample_of: &[u32]) {
        if std::mem::take(&mut self.of_vertices) {
            self.triangles.par_iter_mut().for_each(|triangle| {
                *triangle = first_least(triangle.map(|vertex| sample_of[vertex as usize]));
            });
            self.triangles.retain(|[a, b, c]| a != b && b != c && c != a);
            once_each(&mut self.triangles);
            self.triangles.shrink_to_fit();
        }
    }

    /// Each triangle once, if there are more than twice so many; none if there are still more than that.
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

/// What is looked for in the faces.
#[derive(Default)]
pub struct Wanted<'a, 'p> {
    /// The triangles of P_S.
    pub triangles: bool,
    /// Where the faces of each cell are.
    pub ranges: Option<&'a mut FaceRanges>,
    /// What hangs together.
    pub islands: Option<&'a mut Islands>,
    /// The planes around each sample.
    pub planes: Option<&'a mut Planes<'p>>,
}

/// Takes faces, some at a time, in the file's order. `sample_of` says which sample each vertex belongs to.
/// Where islands are looked for, by which clusters may be parted, the triangles come as vertices, unless
/// there are too many.
///
/// Memory: 12 bytes for each of at most twice [`MOST_PER_SAMPLE`] triangles per sample, twice while the list
/// grows; a surface has about two, found once or twice each.
pub struct Reindexing<'a, 'p> {
    sample_of: &'a [u32],
    samples: usize,
    wanted: Wanted<'a, 'p>,
    /// Most triangles.
    most: usize,
    found: Triangles,
}

impl<'a, 'p> Reindexing<'a, 'p> {
    /// No face yet.
    pub fn new(sample_of: &'a [u32], samples: usize, wanted: Wanted<'a, 'p>) -> Self {
        let of_vertices = wanted.triangles && wanted.islands.is_some();
        let found = Triangles { of_vertices, ..Triangles::default() };
        Self { sample_of, samples, wanted, most: MOST_PER_SAMPLE * samples.max(64), found }
    }

    /// Takes the next triangles, and the marks among them; and those whose planes are summed up, which are
    /// the same but for who reads a part of the faces.
    pub fn take(&mut self, triangles: &[[u32; 3]], marks: &[FaceMark], summed: &[[u32; 3]]) {
        let Self { sample_of, samples, ref mut wanted, most, ref mut found } = *self;
        let Wanted { triangles: wants_triangles, ranges, islands, planes } = wanted;
        let mut reindex = || {
            let mut marks = marks.iter().peekable();
            for (at, corners) in triangles.iter().enumerate() {
                if let Some(ranges) = ranges {
                    while let Some(mark) = marks.next_if(|mark| mark.triangle <= at) {
                        ranges.mark(mark.offset);
                    }
                    let known = corners.iter().filter_map(|corner| sample_of.get(*corner as usize).copied());
                    known
                        .filter(|sample| (*sample as usize) < samples)
                        .for_each(|sample| ranges.meet(sample));
                }
                let [Some(a), Some(b), Some(c)] = corners.map(|corner| sample_of.get(corner as usize)) else {
                    found.without_vertex += 1;
                    continue;
                };
                // Vertices without a finite position have no sample.
                if *wants_triangles
                    && !found.tangled
                    && a != b
                    && b != c
                    && c != a
                    && [a, b, c].iter().all(|s| (**s as usize) < samples)
                {
                    found.triangles.push(if found.of_vertices {
                        *corners
                    } else {
                        first_least([*a, *b, *c])
                    });
                }
            }
            if let Some(ranges) = ranges {
                marks.for_each(|mark| ranges.mark(mark.offset));
            }
            found.keep_few(sample_of, most);
        };
        let known = |corners: [u32; 3]| match corners.map(|v| sample_of.get(v as usize)) {
            [Some(a), Some(b), Some(c)] => Some([*a, *b, *c]),
            _ => None,
        };
        let mut join = || {
            let Some(islands) = islands else { return };
            for corners in triangles {
                known(*corners).into_iter().for_each(|of| islands.take(*corners, of));
            }
        };
        let mut add_planes = || {
            let Some(planes) = planes else { return };
            let mut left = summed;
            while !left.is_empty() {
                let (some, behind) = left.split_at(left.len().min(planes.room()));
                for corners in some {
                    known(*corners).into_iter().for_each(|of| planes.take(*corners, of));
                }
                planes.count(some.len());
                left = behind;
            }
        };
        // Side by side, each in the file's order.
        rayon::join(&mut reindex, || rayon::join(&mut join, &mut add_planes));
    }

    /// The sample of a vertex, if it has any.
    pub fn sample(&self, vertex: u32) -> Option<u32> {
        self.sample_of.get(vertex as usize).copied().filter(|sample| (*sample as usize) < self.samples)
    }

    /// What was wanted besides the triangles.
    pub fn wanted(&mut self) -> &mut Wanted<'a, 'p> {
        &mut self.wanted
    }

    /// Adds what another one has found in other faces, of the same vertices.
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
    // From one mark to another, faces of several files cannot be read.
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

/// The same triangle, beginning with its least corner.
pub fn first_least([a, b, c]: [u32; 3]) -> [u32; 3] {
    if a < b && a < c {
        [a, b, c]
    } else if b < c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// Each triangle once, in the order of their samples.
pub fn once_each(triangles: &mut Vec<[u32; 3]>) {
    triangles.sort_unstable();
    triangles.dedup();
}
