//! Triangles of P_S: the faces of P_L whose corners are in three different clusters, between their samples
//! (J. Rossignac, P. Borrel, *Multi-resolution 3D approximations for rendering complex scenes*, 1993).

use rayon::prelude::*;
use simod_model::{Model, Progress, Result, for_faces};

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

/// Streams the faces of a model. `sample_of` says which sample each vertex belongs to. Where islands are
/// looked for, by which clusters may be parted, the triangles come as vertices, unless there are too many.
///
/// Memory: the chunks of [`for_faces`], and 12 bytes for each of at most twice [`MOST_PER_SAMPLE`] triangles
/// per sample, twice while the list grows; a surface has about two, found once or twice each.
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
    let Wanted { triangles, mut ranges, mut islands, mut planes } = wanted;
    let most = MOST_PER_SAMPLE * samples.max(64);
    let mut found = Triangles { of_vertices: triangles && islands.is_some(), ..Triangles::default() };
    for_faces(model, |chunk| {
        progress.check()?;
        let mut reindex = || {
            let mut marks = chunk.marks.iter().peekable();
            for (at, corners) in chunk.triangles.iter().enumerate() {
                if let Some(ranges) = &mut ranges {
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
                if triangles
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
            if let Some(ranges) = &mut ranges {
                marks.for_each(|mark| ranges.mark(mark.offset));
            }
            if found.triangles.len() > 2 * most {
                found.put(sample_of);
                once_each(&mut found.triangles);
                if found.triangles.len() > most {
                    (found.triangles, found.tangled) = (Vec::new(), true);
                }
            }
        };
        let known = |corners: [u32; 3]| match corners.map(|v| sample_of.get(v as usize)) {
            [Some(a), Some(b), Some(c)] => Some([*a, *b, *c]),
            _ => None,
        };
        let mut join = || {
            let Some(islands) = &mut islands else { return };
            for corners in &chunk.triangles {
                known(*corners).into_iter().for_each(|of| islands.take(*corners, of));
            }
        };
        let mut add_planes = || {
            let Some(planes) = &mut planes else { return };
            for corners in &chunk.triangles {
                known(*corners).into_iter().for_each(|of| planes.take(*corners, of));
            }
        };
        // Side by side, each in the file's order.
        rayon::join(&mut reindex, || rayon::join(&mut join, &mut add_planes));
        progress.advance(chunk.bytes);
        Ok(())
    })?;
    if !found.of_vertices {
        once_each(&mut found.triangles);
        found.triangles.shrink_to_fit();
    }
    Ok(found)
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
