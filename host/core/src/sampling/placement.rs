//! Samples placed by the faces of P_L: each at the minimum of the quadric of the planes around it, weighted
//! by area (M. Garland, P. Heckbert 1997; P. Lindstrom, *Out-of-Core Simplification of Large Polygonal
//! Models*, 2000), held by a small ridge to where its vertices alone have placed it.
//!
//! Faces tell where the surface is when normals do not: where there are none, or those of a smoother surface.
//! Unless the placement is given, some faces at the beginning of the file are compared with the normals of
//! their corners.

use glam::{DMat3, DVec3, Vec3, Vec3A, Vec3Swizzles, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_model::{FaceChunk, Model, Result, SMALL_CHUNK, VertexChunk};

use super::cluster::symmetric;

/// Strength of the ridge, relative to the trace of the quadric.
const RIDGE: f64 = 3e-4;

/// The way in which samples are placed in their clusters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// Placement by faces where vertices have no normals, or other ones than those of the surface that the
    /// faces are; otherwise by vertices.
    #[default]
    Automatic,
    /// The planes of the faces, where the model has any: they take a pass, and temporary files of at most 20
    /// bytes per vertex.
    Faces,
    /// The tangent planes of the vertices that have normals; without, their mean.
    Vertices,
}

/// Triangles at the beginning of the file among which …
const FIRST: usize = 1 << 16;
/// … largest number of pairs of one and the next that are compared with the normals at their corners.
const PAIRS: usize = 512;

/// Vertices between two that are passed over rather than begun anew behind.
const NEAR: u64 = 256;

/// Largest ratio of the difference between normals of vertices and of faces to that of faces from one
/// triangle to the next. Normals of the surface itself differ 0.4 to 0.9 times as much, and those of a smooth
/// surface below a relief 1.4 to 2.3 times.
const MOST_UNLIKE: f64 = 1.15;

/// An angle by which normals may always differ, radians.
const ALIKE: f64 = 0.03;

/// The part of the area that may differ by more: at sharp edges, where vertices have the mean of the normals
/// on both sides.
const AT_EDGES: f64 = 0.05;

impl Placement {
    /// The name of this choice in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Automatic => "automatic",
            Self::Faces => "faces",
            Self::Vertices => "vertices",
        }
    }

    /// Placement for a model with faces: `Automatic` becomes one of the others.
    ///
    /// Memory: 1 MiB, and a chunk of vertices and one of faces.
    ///
    /// # Errors
    /// The vertices cannot be read. Faces that cannot be tell nothing.
    pub(super) fn resolve(self, model: &dyn Model) -> Result<Self> {
        match self {
            Self::Automatic if !model.info().has_normals => Ok(Self::Faces),
            Self::Automatic => Ok(if normals_are_of_faces(model)? { Self::Vertices } else { Self::Faces }),
            given => Ok(given),
        }
    }
}

/// Whether the normals of vertices may be taken for those of the surface that the faces are: which they are
/// unless faces at the beginning of the file tell otherwise.
fn normals_are_of_faces(model: &dyn Model) -> Result<bool> {
    let Ok(triangles) = first_pairs(model) else { return Ok(true) };
    let corners = PairVertices::read(model, &triangles)?;
    let mut unlike = Unlike::default();
    for triangle in triangles {
        if let [Some(a), Some(b), Some(c)] = triangle.map(|vertex| corners.get(vertex)) {
            unlike.take(triangle, [a.0, b.0, c.0], [a.1, b.1, c.1]);
        }
    }
    Ok(unlike.is_little())
}

/// Pairs of triangles that follow each other, spread over those at the beginning of the file.
fn first_pairs(model: &dyn Model) -> Result<Vec<[u32; 3]>> {
    let mut triangles = Vec::new();
    let mut reader = model.faces()?;
    let mut chunk = FaceChunk::default();
    while triangles.len() < FIRST && reader.read(&mut chunk)? {
        triangles.extend(chunk.triangles.iter().take(FIRST - triangles.len()));
    }
    let step = triangles.len().div_ceil(PAIRS).max(2);
    Ok(triangles.chunks(step).flat_map(|few| few.iter().take(2)).copied().collect())
}

/// Position and unit normal (zero where there is none) of some vertices, by their indices.
///
/// Memory: 56 bytes for each of [`PAIRS`] · 6.
struct PairVertices(Vec<(u32, (DVec3, DVec3))>);

impl PairVertices {
    /// The corners of some triangles, as far as the model has them. Of a model that can only be read from its
    /// beginning, those that are near each other.
    fn read(model: &dyn Model, triangles: &[[u32; 3]]) -> Result<Self> {
        let mut wanted: Vec<u32> = triangles.iter().flatten().copied().collect();
        wanted.sort_unstable();
        wanted.dedup();
        let mut found = Vec::with_capacity(wanted.len());
        let mut chunk = VertexChunk::default();
        let (near, most) = if model.info().random_access { (NEAR, usize::MAX) } else { (FIRST as u64, 1) };
        for run in wanted.chunk_by(|a, b| u64::from(b - a) <= near).take(most) {
            let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
            let mut reader = model.vertices(u64::from(*first)..u64::from(*last) + 1)?;
            reader.set_chunk(SMALL_CHUNK);
            reader.skip_attributes();
            let mut run = run.iter().peekable();
            while reader.read(&mut chunk)? {
                let end = chunk.first + chunk.len() as u64;
                while let Some(vertex) = run.next_if(|vertex| u64::from(**vertex) < end) {
                    let i = (u64::from(*vertex) - chunk.first) as usize;
                    let normal = chunk.normals.get(i).and_then(|n| n.as_dvec3().try_normalize());
                    found.push((*vertex, (chunk.positions[i], normal.unwrap_or(DVec3::ZERO))));
                }
            }
        }
        Ok(Self(found))
    }

    fn get(&self, vertex: u32) -> Option<(DVec3, DVec3)> {
        self.0.binary_search_by_key(&vertex, |(found, _)| *found).ok().map(|at| self.0[at].1)
    }
}

/// Differences of the normals of faces from those of their corners, and from one face to the next.
#[derive(Default)]
struct Unlike {
    /// Area of the triangles.
    area: f64,
    /// Angles of triangles with normals at their corners.
    from_corners: AngleSquares,
    /// Angles of pairs of triangles.
    from_next: AngleSquares,
    /// Corners, normal and area of the last triangle.
    last: Option<([u32; 3], DVec3, f64)>,
}

impl Unlike {
    fn take(&mut self, triangle: [u32; 3], [a, b, c]: [DVec3; 3], normals: [DVec3; 3]) {
        let across = (b - a).cross(c - a);
        let area = across.length();
        let Some(normal) = across.try_normalize().filter(|n| n.is_finite() && area.is_finite()) else {
            return;
        };
        self.area += area;
        let mean: DVec3 = normals.into_iter().sum();
        if let Some(mean) = mean.try_normalize().filter(|_| !normals.contains(&DVec3::ZERO)) {
            // The normals may be on either side of the face.
            self.from_corners.add((2.0 - 2.0 * normal.dot(mean).abs()).max(0.0), area);
        }
        if let Some((corners, last, last_area)) = self.last
            && corners.iter().any(|corner| triangle.contains(corner))
        {
            self.from_next.add(normal.distance_squared(last), area.min(last_area));
        }
        self.last = Some((triangle, normal, area));
    }

    /// Whether there are normals of vertices, and nothing tells that they are others than those of the faces:
    /// neither all faces, nor those without the sharpest edges.
    fn is_little(&mut self) -> bool {
        let known = self.from_corners.area();
        // Hardly a triangle shares a corner with the next.
        if 4.0 * self.from_next.area() < known {
            return true;
        }
        let mut is_little = |part| {
            let (from_corners, from_next) = (self.from_corners.mean(part), self.from_next.mean(part));
            from_corners <= MOST_UNLIKE.powi(2) * from_next + ALIKE.powi(2)
        };
        2.0 * known >= self.area && (is_little(1.0) || is_little(1.0 - AT_EDGES))
    }
}

/// Squares of angles, each with its area.
#[derive(Default)]
struct AngleSquares(Vec<[f64; 2]>);

impl AngleSquares {
    fn add(&mut self, square: f64, area: f64) {
        self.0.push([square, area]);
    }

    fn area(&self) -> f64 {
        self.0.iter().map(|[_, area]| area).sum()
    }

    /// The mean of the least, as many as have this part of the area; 0 of none.
    fn mean(&mut self, part: f64) -> f64 {
        self.0.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let most = part * self.area();
        let (mut sum, mut counted) = (0.0, 0.0);
        for [square, area] in &self.0 {
            let area = area.min(most - counted);
            sum += square * area;
            counted += area;
        }
        if counted > 0.0 { sum / counted } else { 0.0 }
    }
}

/// Faces whose planes are summed up by themselves, in single precision: so that sums are those of ranges of
/// the faces that begin at a multiple of this number, whichever unit reads them.
pub const FACES_OF_A_SUM: u64 = 1 << 16;

/// Faces that one job looks at.
pub const FACES_OF_A_JOB: usize = 1 << 12;

/// Planes of the faces around each sample's cluster, summed up.
///
/// Memory: 128 bytes per sample, and 4 for each time that one is met in a run of faces; without its own sums
/// 48, and 44 bytes for each of the listed ones, of which a run has three for each face at most. 28 bytes for
/// each face across borders, of those that were taken at once and had most.
pub struct Planes<'a> {
    /// Positions of the vertices of P_L, local coordinates.
    vertices: &'a [Vec3],
    /// Positions of the samples by their vertices.
    samples: &'a [Vec3],
    /// Number of the first of these samples: those before it stay where they are.
    first: u32,
    /// Planes of `samples_of_a_shard` samples each, one after the other: each is summed up by one thread at a
    /// time, in the file's order.
    shards: Vec<PlaneShard>,
    samples_of_a_shard: usize,
    /// Findings of each job in the faces that are taken at once.
    crossing: Vec<Vec<CrossingFace>>,
    /// Number of faces of a run that were taken so far.
    faces: u64,
}

/// The planes around some samples that follow each other.
struct PlaneShard {
    /// Quadrics of the faces at hand, and the places of those samples that have any.
    quadrics: Vec<Quadric>,
    met: Vec<u32>,
    sums: PlaneSumming,
}

/// A face across the border of clusters.
struct CrossingFace {
    /// The face's number among those that are taken at once.
    number: u32,
    corners: [u32; 3],
    /// The sample of each corner.
    of: [u32; 3],
}

/// Sums of the planes of faces, either added up or listed.
enum PlaneSumming {
    /// Planes are added up, in double precision.
    Added(Vec<[f64; 10]>),
    /// Sums that are listed for who [adds](Planes::add_listed) them.
    Listed(Vec<u32>),
}

/// Σ w (n·(x − p))² as a function of x, about a sample: sums in single precision over some faces around it.
#[derive(Clone, Copy, Default)]
struct Quadric {
    /// Σ w n nᵀ: xx, yy, zz, and Σ w |p|² for corners p in the sample's cluster.
    squares: Vec4,
    /// Σ w n nᵀ: xy, yz, zx.
    products: Vec4,
    /// Σ w n (n·p).
    toward: Vec4,
}

impl Quadric {
    fn numbers(&self) -> [f32; 10] {
        let ([a, b, c, d], [e, f, g, _], [h, i, j, _]) =
            (self.squares.to_array(), self.products.to_array(), self.toward.to_array());
        [a, b, c, d, e, f, g, h, i, j]
    }
}

/// A sample that faces have placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// Position of the sample, local coordinates.
    pub at: Vec3,
    /// Largest distance that the sample may be from where the vertices have placed it.
    pub most: f32,
}

/// Numbers of a sum that is listed: its sample, and those of its quadric.
pub const LISTED: usize = 11;

impl<'a> Planes<'a> {
    /// Planes of no face yet, around the samples from number `first` on.
    pub fn new(vertices: &'a [Vec3], samples: &'a [Vec3], first: u32) -> Self {
        let shards = rayon::current_num_threads();
        Self::sharded(vertices, samples, first, shards, |samples| {
            PlaneSumming::Added(vec![[0.0; 10]; samples])
        })
    }

    /// The planes of a part of the faces, which begins at a multiple of [`FACES_OF_A_SUM`].
    pub fn listed(vertices: &'a [Vec3], samples: &'a [Vec3]) -> Self {
        // A listing has one shard, as sums are listed in the order of the faces.
        Self::sharded(vertices, samples, 0, 1, |_| PlaneSumming::Listed(Vec::new()))
    }

    fn sharded(
        vertices: &'a [Vec3],
        samples: &'a [Vec3],
        first: u32,
        shards: usize,
        sums: impl Fn(usize) -> PlaneSumming,
    ) -> Self {
        let samples_of_a_shard = samples.len().div_ceil(shards).max(1);
        let shard = |samples: &[Vec3]| PlaneShard {
            quadrics: vec![Quadric::default(); samples.len()],
            met: Vec::new(),
            sums: sums(samples.len()),
        };
        let shards = samples.chunks(samples_of_a_shard).map(shard).collect();
        Self { vertices, samples, first, shards, samples_of_a_shard, crossing: Vec::new(), faces: 0 }
    }

    /// The sums that were listed, [`LISTED`] numbers each, in the order of the faces; at the end all.
    pub fn take_listed(&mut self, is_end: bool) -> Vec<u32> {
        let mut taken = Vec::new();
        for shard in &mut self.shards {
            if is_end {
                shard.sum_up();
            }
            if let PlaneSumming::Listed(list) = &mut shard.sums {
                taken.append(list);
            }
        }
        taken
    }

    /// Adds sums that were listed, in the order of the faces; `false` if there are not such samples.
    pub fn add_listed(&mut self, listed: &[u32]) -> bool {
        let (all, rest) = listed.as_chunks::<LISTED>();
        rest.is_empty() && all.iter().all(|[sample, numbers @ ..]| self.add_one(*sample as usize, numbers))
    }

    fn add_one(&mut self, sample: usize, numbers: &[u32]) -> bool {
        let shard = self.shards.get_mut(sample / self.samples_of_a_shard);
        let Some(PlaneShard { sums: PlaneSumming::Added(sums), .. }) = shard else { return false };
        let Some(sum) = sums.get_mut(sample % self.samples_of_a_shard) else { return false };
        sum.iter_mut().zip(numbers).for_each(|(sum, n)| *sum += f64::from(f32::from_bits(*n)));
        true
    }

    /// Adds the faces across the border of clusters, each once to each sample that one of its corners belongs
    /// to. The triangles of P_S reach from sample to sample, and so a surface fits them best that is known
    /// where clusters meet: faces inside of them add nothing to that, and would take most of the time.
    /// `samples_of` a face's corners are nothing if there is no such vertex, and the face is passed over.
    /// Takes jobs of the thread pool.
    pub fn take(&mut self, faces: &[[u32; 3]], samples_of: impl Fn([u32; 3]) -> Option<[u32; 3]> + Sync) {
        let jobs = faces.len().div_ceil(FACES_OF_A_JOB);
        self.crossing.resize_with(jobs.max(self.crossing.len()), Vec::new);
        let find = |(piece, (found, faces)): (usize, (&mut Vec<CrossingFace>, &[[u32; 3]]))| {
            found.clear();
            for (number, corners) in (piece * FACES_OF_A_JOB..).zip(faces) {
                if let Some(of) = samples_of(*corners).filter(|[a, b, c]| a != b || b != c) {
                    found.push(CrossingFace { number: number as u32, corners: *corners, of });
                }
            }
        };
        let crossing = &mut self.crossing[..jobs];
        crossing.par_iter_mut().zip(faces.par_chunks(FACES_OF_A_JOB)).enumerate().for_each(find);
        let Self { vertices, samples, first, ref mut shards, samples_of_a_shard, faces: before, .. } = *self;
        let crossing = &self.crossing[..jobs];
        let end = before + faces.len() as u64;
        let add = |(at, (shard, samples)): (usize, (&mut PlaneShard, &[Vec3]))| {
            let first = first + (at * samples_of_a_shard) as u32;
            let mut around = ShardPlanes { vertices, samples, first, shard };
            let mut next = FACES_OF_A_SUM;
            for face in crossing.iter().flatten() {
                while before + u64::from(face.number) >= next {
                    around.shard.sum_up();
                    next += FACES_OF_A_SUM;
                }
                around.take(face);
            }
            if end >= next {
                around.shard.sum_up();
            }
        };
        shards.par_iter_mut().zip(samples.par_chunks(samples_of_a_shard)).enumerate().for_each(add);
        self.faces = end % FACES_OF_A_SUM;
    }

    /// Positions of the samples by the faces. A sample moves at most as far as the corners in its cluster are
    /// from its former position (rms), and as `most` allows.
    pub fn place(mut self, most: impl Fn(usize) -> f32 + Sync) -> Vec<Placed> {
        self.shards.par_iter_mut().for_each(PlaneShard::sum_up);
        let sum = |i: usize| match &self.shards[i / self.samples_of_a_shard].sums {
            PlaneSumming::Added(sums) => Some(&sums[i % self.samples_of_a_shard]),
            PlaneSumming::Listed(_) => None,
        };
        let placed = |(i, sample): (usize, &Vec3)| {
            let moved = sum(i).map(|sum| (least(sum), radius(sum).min(f64::from(most(i)))));
            // Some samples have no planes around them.
            match moved.filter(|(way, most)| way.is_finite() && *most > 0.0) {
                Some((way, most)) => {
                    let at = (sample.as_dvec3() + way.clamp_length_max(most)).as_vec3();
                    Placed { at, most: most as f32 }
                }
                None => Placed { at: *sample, most: 0.0 },
            }
        };
        self.samples.par_iter().enumerate().map(placed).collect()
    }
}

/// Planes of a shard, and the samples to which they are added.
struct ShardPlanes<'a> {
    vertices: &'a [Vec3],
    /// The samples of the shard, and the number of the first of them.
    samples: &'a [Vec3],
    first: u32,
    shard: &'a mut PlaneShard,
}

impl ShardPlanes<'_> {
    /// Adds the plane of a face to each sample of the shard that one of its corners belongs to.
    #[inline]
    fn take(&mut self, face: &CrossingFace) {
        let CrossingFace { corners, of, .. } = *face;
        if !of.iter().any(|sample| (sample.wrapping_sub(self.first) as usize) < self.samples.len()) {
            return;
        }
        let [a, b, c] = corners.map(|vertex| Vec3A::from(self.vertices[vertex as usize]));
        // The length of the product is twice the area.
        let across = (b - a).cross(c - a);
        let normal = across * across.length_recip();
        // Neither are corners without a finite position.
        if !normal.is_finite() {
            return;
        }
        let plane = Quadric {
            squares: (across * normal).extend(0.0),
            products: (across * normal.yzx()).extend(0.0),
            toward: across.extend(0.0),
        };
        self.add(of[0], &plane, normal, a);
        if of[1] != of[0] {
            self.add(of[1], &plane, normal, b);
        }
        if of[2] != of[0] && of[2] != of[1] {
            self.add(of[2], &plane, normal, c);
        }
    }

    #[inline(always)]
    fn add(&mut self, sample: u32, plane: &Quadric, normal: Vec3A, corner: Vec3A) {
        let place = sample.wrapping_sub(self.first) as usize;
        let Some((sample, quadric)) = self.samples.get(place).zip(self.shard.quadrics.get_mut(place)) else {
            return;
        };
        let p = corner - Vec3A::from(*sample);
        let weight = plane.squares.x + plane.squares.y + plane.squares.z;
        let is_first = quadric.squares == Vec4::ZERO;
        quadric.squares += plane.squares + Vec4::new(0.0, 0.0, 0.0, weight * p.length_squared());
        quadric.products += plane.products;
        quadric.toward += plane.toward * normal.dot(p);
        if is_first {
            self.shard.meet(place as u32);
        }
    }
}

impl PlaneShard {
    /// Notes that a sample has its first planes, of which nothing may be left, so that it is met once more:
    /// it is summed up once, as it has nothing then.
    #[cold]
    #[inline(never)]
    fn meet(&mut self, place: u32) {
        self.met.push(place);
    }

    /// Adds the faces at hand to the sums.
    #[cold]
    fn sum_up(&mut self) {
        for place in self.met.drain(..) {
            let numbers = std::mem::take(&mut self.quadrics[place as usize]).numbers();
            match &mut self.sums {
                PlaneSumming::Added(sums) => {
                    let sum = sums[place as usize].iter_mut().zip(numbers);
                    sum.for_each(|(sum, number)| *sum += f64::from(number));
                }
                PlaneSumming::Listed(list) => {
                    list.push(place);
                    list.extend(numbers.map(f32::to_bits));
                }
            }
        }
    }
}

/// Σ w of a quadric: normals are of unit length.
fn weight([xx, yy, zz, ..]: &[f64; 10]) -> f64 {
    xx + yy + zz
}

fn radius(sum: &[f64; 10]) -> f64 {
    (sum[3] / weight(sum)).max(0.0).sqrt()
}

/// The minimum of a quadric, with the ridge.
fn least(sum: &[f64; 10]) -> DVec3 {
    let scale = weight(sum).recip();
    let vector = |i: usize| DVec3::from_slice(&sum[i..]) * scale;
    let ridge = DMat3::from_diagonal(DVec3::splat(RIDGE));
    (symmetric(vector(0), vector(4)) + ridge).inverse() * vector(7)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The faces of a fan about the first vertex, all corners of one sample.
    fn placed(vertices: &[Vec3], faces: &[[u32; 3]], sample: Vec3, most: f32) -> Vec3 {
        let samples = [sample];
        let mut planes = Planes::new(vertices, &samples, 7);
        // Samples before and behind, which are none of these, are left out.
        planes.take(faces, |_| Some([7, 7, 6]));
        planes.take(faces, |_| Some([6, 8, u32::MAX]));
        // A face inside of a cluster is of no triangle of P_S.
        planes.take(&[[1, 2, 3]; 3], |_| Some([7; 3]));
        planes.place(|_| most)[0].at
    }

    /// Three sides of a cube meet at (1, 1, 1).
    const CORNER: [Vec3; 4] =
        [Vec3::ONE, Vec3::new(0.0, 1.0, 1.0), Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 1.0, 0.0)];
    const SIDES: [[u32; 3]; 3] = [[0, 1, 2], [0, 2, 3], [0, 3, 1]];

    #[test]
    fn a_corner_is_found_as_far_as_may_be_gone() {
        let mean = Vec3::splat(0.75);
        let found = placed(&CORNER, &SIDES, mean, f32::INFINITY);
        assert!(found.distance(Vec3::ONE) < 2e-3, "{found}");
        let found = placed(&CORNER, &SIDES, mean, 0.1);
        assert!((found.distance(mean) - 0.1).abs() < 1e-6 && found.distance(Vec3::ONE) < 0.34, "{found}");
        // Not beyond the corners' own distance.
        let away = Vec3::splat(-9.0);
        let radius = CORNER.iter().map(|p| p.distance(away)).fold(0.0, f32::max);
        assert!(placed(&CORNER, &SIDES, away, f32::INFINITY).distance(away) <= radius);
    }

    #[test]
    fn across_a_plane_it_is_the_plane_and_along_it_nothing_moves() {
        let found = placed(&CORNER, &SIDES[..1], Vec3::new(0.5, 0.6, 0.7), f32::INFINITY);
        assert!(found.distance(Vec3::new(0.5, 0.6, 1.0)) < 2e-4, "{found}");
    }

    #[test]
    fn what_is_no_face_tells_nothing() {
        let mut vertices = CORNER.to_vec();
        vertices.extend([Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e30), Vec3::splat(1e-30)]);
        let sample = Vec3::splat(0.75);
        let none = [[0, 0, 1], [2, 2, 2], [0, 1, 4], [5, 1, 2], [0, 6, 0], [7, 7, 7]];
        assert_eq!(placed(&vertices, &none, sample, f32::INFINITY), sample);
        let all = [&SIDES[..], &none[..]].concat();
        assert_eq!(
            placed(&vertices, &all, sample, f32::INFINITY),
            placed(&vertices, &SIDES, sample, f32::INFINITY)
        );
        // Sums beyond what a number holds.
        let far = placed(&vertices, &[[0, 1, 6], [2, 6, 3]], sample, f32::INFINITY);
        assert!(far.is_finite(), "{far}");
    }

    /// Sums are of the same faces, whichever unit reads them.
    #[test]
    fn ranges_of_faces_add_up_to_the_sums_of_one_reading() {
        let random =
            |i: u32, axis: u32| f64::from((i * 3 + axis).wrapping_mul(2_654_435_761) >> 8) as f32 / 1e7;
        let vertices: Vec<Vec3> =
            (0..997).map(|i| Vec3::from([0, 1, 2].map(|axis| random(i, axis)))).collect();
        let samples = &vertices[..50];
        let faces: Vec<[u32; 3]> = (0..3 * FACES_OF_A_SUM as u32 - 77)
            .map(|i| [i, i * 7 + 1, i * i % 991].map(|v| v % 997))
            .collect();
        let of = |corners: [u32; 3]| Some(corners.map(|corner| corner % 53));
        let read = |planes: &mut Planes<'_>, faces: &[[u32; 3]], mut taken: Vec<u32>| {
            for some in faces.chunks(10_007) {
                planes.take(some, of);
                taken.extend(planes.take_listed(false));
            }
            taken.extend(planes.take_listed(true));
            taken
        };
        let mut whole = Planes::new(&vertices, samples, 0);
        assert!(read(&mut whole, &faces, Vec::new()).is_empty());
        let mut parts = Planes::new(&vertices, samples, 0);
        let (first, second) = faces.split_at(2 * FACES_OF_A_SUM as usize);
        for faces in [first, second] {
            let listed = read(&mut Planes::listed(&vertices, samples), faces, Vec::new());
            assert!(!listed.is_empty() && parts.add_listed(&listed));
        }
        assert!(!parts.add_listed(&[50; LISTED]) && !parts.add_listed(&[1]));
        let [whole, parts] = [whole, parts].map(|planes| planes.place(|_| f32::INFINITY));
        assert!(whole == parts && whole.iter().zip(samples).any(|(placed, sample)| placed.at != *sample));
    }
}
