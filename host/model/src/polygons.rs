//! Triangles of faces as the polygons that they were.

use crate::FaceChunk;

/// Most corners of a polygon that is held: larger ones stay fans of triangles.
pub(crate) const MOST_CORNERS: usize = 1 << 16;

/// Whether all corners are indices of vertices.
fn is_of_vertices(triangle: &[u32; 3], vertices: u64) -> bool {
    triangle.iter().all(|corner| u64::from(*corner) < vertices && *corner != u32::MAX)
}

/// Polygons, each of at least three corners.
#[derive(Debug, Default)]
pub(crate) struct Polygons {
    corners: Vec<u32>,
    /// Index in `corners` at which the corners of each polygon end.
    ends: Vec<usize>,
}

impl Polygons {
    pub(crate) fn clear(&mut self) {
        self.corners.clear();
        self.ends.clear();
    }

    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// The number of corners of all polygons.
    pub(crate) fn corners(&self) -> usize {
        self.corners.len()
    }

    /// The corners of each.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| &self.corners[start..*end])
    }

    fn push(&mut self, corners: &[u32]) {
        self.corners.extend_from_slice(corners);
        self.ends.push(self.corners.len());
    }
}

/// Joins triangles that come in the file's order to polygons again.
///
/// Of a polygon with corners that are no vertices, the triangles without these stay.
///
/// Memory: [`MOST_CORNERS`].
#[derive(Debug)]
pub(crate) struct PolygonJoin {
    /// Number of vertices that there are.
    vertices: u64,
    /// Whether triangles are joined, or each is a polygon of its own.
    joins: bool,
    /// The corners of the polygon that may go on, and whether it had too many to be held.
    open: Vec<u32>,
    is_long: bool,
    pub(crate) counted: PolygonCounts,
}

/// Counts of the triangles and faces that a [`PolygonJoin`] was given.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct PolygonCounts {
    /// Triangles of vertices that there are, and others.
    pub(crate) triangles: u64,
    pub(crate) without_vertex: u64,
    /// Faces that have any triangles; (`long`) faces that had too many corners; (`largest`) most corners of a
    /// face.
    pub(crate) faces: u64,
    pub(crate) long: u64,
    pub(crate) largest: usize,
}

impl PolygonJoin {
    pub(crate) fn new(vertices: u64, joins: bool) -> Self {
        Self { vertices, joins, open: Vec::new(), is_long: false, counted: PolygonCounts::default() }
    }

    /// Appends the polygons that are known to be over once the chunk is.
    pub(crate) fn add(&mut self, chunk: &FaceChunk, to: &mut Polygons) {
        let mut continued = chunk.continued.iter().copied().peekable();
        for (i, triangle) in chunk.triangles.iter().enumerate() {
            let goes_on = continued.next_if_eq(&(i as u32)).is_some() && self.joins;
            if !goes_on {
                self.finish(to);
                self.is_long = false;
                self.counted.faces += 1;
                self.open.extend_from_slice(triangle);
            } else if self.is_long {
                self.put(*triangle, to);
            } else if self.open.len() < MOST_CORNERS {
                self.open.push(triangle[2]);
            } else {
                self.split(to);
                self.is_long = true;
                self.counted.long += 1;
                self.put(*triangle, to);
            }
        }
    }

    /// Appends the last one.
    pub(crate) fn finish(&mut self, to: &mut Polygons) {
        if self.open.iter().any(|corner| !self.is_vertex(*corner)) {
            self.split(to);
        } else if !self.open.is_empty() {
            to.push(&self.open);
            self.counted.triangles += self.open.len() as u64 - 2;
            self.counted.largest = self.counted.largest.max(self.open.len());
            self.open.clear();
        }
    }

    /// Appends the triangles of the one at hand.
    fn split(&mut self, to: &mut Polygons) {
        let open = std::mem::take(&mut self.open);
        if let Some((first, rest)) = open.split_first() {
            rest.windows(2).for_each(|pair| self.put([*first, pair[0], pair[1]], to));
        }
    }

    fn put(&mut self, triangle: [u32; 3], to: &mut Polygons) {
        if is_of_vertices(&triangle, self.vertices) {
            to.push(&triangle);
            self.counted.triangles += 1;
            self.counted.largest = self.counted.largest.max(3);
        } else {
            self.counted.without_vertex += 1;
        }
    }

    fn is_vertex(&self, corner: u32) -> bool {
        u64::from(corner) < self.vertices && corner != u32::MAX
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::fan::Fan;

    /// Chunks of so many triangles at most, of faces with these corners.
    fn chunks(faces: &[Vec<u32>], most: usize) -> Vec<FaceChunk> {
        let mut chunks = vec![FaceChunk::default()];
        for corners in faces {
            let mut fan = Fan::default();
            for corner in corners {
                if chunks.last().is_none_or(|chunk| chunk.triangles.len() == most) {
                    chunks.push(FaceChunk::default());
                }
                if let Some(chunk) = chunks.last_mut() {
                    chunk.add_corner(&mut fan, i64::from(*corner));
                }
            }
        }
        chunks
    }

    fn joined(chunks: &[FaceChunk], vertices: u64, joins: bool) -> (Vec<Vec<u32>>, PolygonCounts) {
        let (mut joining, mut polygons) = (PolygonJoin::new(vertices, joins), Polygons::default());
        chunks.iter().for_each(|chunk| joining.add(chunk, &mut polygons));
        joining.finish(&mut polygons);
        (polygons.iter().map(<[u32]>::to_vec).collect(), joining.counted)
    }

    #[test]
    fn too_many_corners_stay_triangles() {
        let long: Vec<u32> = (0..MOST_CORNERS as u32 + 5).collect();
        let chunks = chunks(&[long.clone(), vec![1, 2, 3, 4]], 1000);
        let (polygons, counted) = joined(&chunks, 1 << 20, true);
        assert_eq!(polygons.len(), long.len() - 2 + 1);
        assert!(polygons[..long.len() - 2].iter().zip(1..).all(|(p, i)| *p == [0, i, i + 1]));
        assert_eq!(polygons.last(), Some(&vec![1, 2, 3, 4]));
        assert_eq!((counted.faces, counted.long, counted.largest), (2, 1, 4));
    }

    proptest! {
        #[test]
        fn faces_come_back(
            faces in prop::collection::vec(prop::collection::vec(0u32..12, 0..9), 0..30),
            most in 1usize..20,
        ) {
            let chunks = chunks(&faces, most);
            let wide: Vec<_> = faces.iter().filter(|corners| corners.len() > 2).cloned().collect();
            let (polygons, counted) = joined(&chunks, 12, true);
            prop_assert_eq!(&polygons, &wide);
            prop_assert_eq!(counted.faces, wide.len() as u64);
            prop_assert_eq!(counted.largest, wide.iter().map(Vec::len).max().unwrap_or(0));

            // Faces with corners that are no vertices leave some of their triangles.
            let fan = |corners: &Vec<u32>| -> Vec<Vec<u32>> {
                corners[1..].windows(2).map(|pair| vec![corners[0], pair[0], pair[1]]).collect()
            };
            let is_there = |corners: &Vec<u32>| corners.iter().all(|corner| *corner < 10);
            let expected = wide.iter().flat_map(|corners| {
                if is_there(corners) { vec![corners.clone()] } else { fan(corners) }
            });
            let (polygons, counted) = joined(&chunks, 10, true);
            prop_assert_eq!(polygons, expected.filter(is_there).collect::<Vec<_>>());
            let (apart, of_apart) = joined(&chunks, 10, false);
            prop_assert_eq!(&apart, &wide.iter().flat_map(fan).filter(is_there).collect::<Vec<_>>());
            let numbers = |counted: PolygonCounts| (counted.triangles, counted.without_vertex);
            prop_assert_eq!(numbers(counted), numbers(of_apart));
            prop_assert_eq!(counted.triangles, apart.len() as u64);
        }
    }
}
