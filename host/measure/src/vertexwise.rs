//! Versions of a model beside each other, vertex by vertex, in one streaming reading of all of them.

use std::ops::Range;

use glam::{DVec3, Vec3};
use pulp::{Arch, Simd, WithSimd};
use serde::Serialize;
use simod_model::bounds::Bounds;
use simod_model::histogram::Histogram;
use simod_model::{Model, Progress, Result, Vertices, in_ranges};

/// Distances between the vertices of two versions of a model. Lengths are fractions of a diagonal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// Vertices compared: those with a finite position in both.
    pub vertices: u64,
    /// Root of the mean square.
    pub rms: f64,
    /// 99 of 100 vertices are nearer (to 2 %).
    pub p99: f64,
    /// The farthest.
    pub max: f64,
    /// The angle between the normals; nothing where the model has none.
    pub normals: Option<Angles>,
}

/// Angles between normals, in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Angles {
    /// Root of the mean square.
    pub rms: f64,
    /// The greatest.
    pub max: f64,
}

/// Versions of a model beside each other.
#[derive(Debug, Clone, PartialEq)]
pub struct VersionsBeside {
    /// Boxes of the finite positions of each version.
    pub bounds: Vec<Bounds>,
    /// Differences of each pair of versions: (0, 1), (0, 2), …, (1, 2), …
    pub differences: Vec<((usize, usize), Difference)>,
}

/// Vertices that are compared at once.
const BLOCK: usize = 64;
/// Sums that are kept side by side, each of every so many vertices of a block.
const LANES: usize = 8;

/// Vertices of one version, as many as a block has, coordinate by coordinate.
struct VertexBlock {
    positions: [[f64; BLOCK]; 3],
    normals: [[f64; BLOCK]; 3],
    /// Whether all positions are finite.
    has_positions: bool,
    /// Whether all normals are directions.
    has_normals: bool,
}

impl VertexBlock {
    const EMPTY: Self = Self {
        positions: [[0.0; BLOCK]; 3],
        normals: [[0.0; BLOCK]; 3],
        has_positions: false,
        has_normals: false,
    };

    fn fill(&mut self, of: &Vertices<'_>, range: Range<usize>) {
        let is_whole = range.len() == BLOCK;
        let (positions, normals) = (&of.positions[range.clone()], of.normals.get(range).unwrap_or_default());
        self.has_positions = is_whole && positions.iter().all(|p| p.is_finite());
        self.has_normals = is_whole && normals.len() == BLOCK && normals.iter().all(|n| is_direction(*n));
        if self.has_positions {
            for (i, p) in positions.iter().enumerate() {
                (0..3).for_each(|axis| self.positions[axis][i] = p[axis]);
            }
        }
        if self.has_normals {
            for (i, n) in normals.iter().enumerate() {
                (0..3).for_each(|axis| self.normals[axis][i] = f64::from(n[axis]));
            }
        }
    }
}

/// A sum and the greatest of numbers, in lanes.
#[derive(Default)]
struct LaneSums {
    sums: [f64; LANES],
    greatest: [f64; LANES],
}

impl LaneSums {
    #[inline(always)]
    fn add(&mut self, lane: usize, square: f64, x: f64) {
        self.sums[lane] += square;
        self.greatest[lane] = if x > self.greatest[lane] { x } else { self.greatest[lane] };
    }

    /// Sum of the lanes in one order, so that it is the same whatever the processor takes at once.
    fn sum(&self) -> f64 {
        self.sums.iter().sum()
    }

    fn greatest(&self) -> f64 {
        self.greatest.iter().copied().fold(0.0, f64::max)
    }

    fn merge(&mut self, other: &Self) {
        for lane in 0..LANES {
            self.add(lane, other.sums[lane], other.greatest[lane]);
        }
    }
}

/// Sums over the vertices of a pair of versions that were read so far.
#[derive(Default)]
struct PairSums {
    histogram: Histogram,
    vertices: u64,
    /// Sums of the distances' squares.
    squares: LaneSums,
    normals: u64,
    /// Sums of the angles' squares, but the greatest of the angles.
    angles: LaneSums,
}

/// The box of a block's positions.
struct BlockBox<'a>(&'a VertexBlock);

impl WithSimd for BlockBox<'_> {
    type Output = Bounds;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Bounds {
        let mut bounds = Bounds::default();
        for (axis, all) in self.0.positions.iter().enumerate() {
            let (mut least, mut most) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
            for some in all.chunks_exact(LANES) {
                for (lane, x) in some.iter().enumerate() {
                    least[lane] = if *x < least[lane] { *x } else { least[lane] };
                    most[lane] = if *x > most[lane] { *x } else { most[lane] };
                }
            }
            bounds.min[axis] = least.into_iter().fold(f64::INFINITY, f64::min);
            bounds.max[axis] = most.into_iter().fold(f64::NEG_INFINITY, f64::max);
        }
        bounds
    }
}

/// Distances between the vertices of two blocks, times a factor; their squares are added to the lanes.
struct BlockDistances<'a>([&'a VertexBlock; 2], f64, &'a mut LaneSums);

impl WithSimd for BlockDistances<'_> {
    type Output = [f64; BLOCK];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; BLOCK] {
        let Self([a, b], scale, lanes) = self;
        let ([ax, ay, az], [bx, by, bz]) = (&a.positions, &b.positions);
        let mut squares = [0.0; BLOCK];
        for i in 0..BLOCK {
            let [x, y, z] = [ax[i] - bx[i], ay[i] - by[i], az[i] - bz[i]];
            squares[i] = (x * x + y * y + z * z) * (scale * scale);
        }
        for some in squares.chunks_exact(LANES) {
            for (lane, square) in some.iter().enumerate() {
                lanes.add(lane, *square, *square);
            }
        }
        for square in &mut squares {
            *square = square.sqrt();
        }
        squares
    }
}

/// Angles between the normals of a block.
struct NormalAngles<'a>([&'a VertexBlock; 2], &'a mut LaneSums);

impl WithSimd for NormalAngles<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self([a, b], lanes) = self;
        let ([ax, ay, az], [bx, by, bz]) = (&a.normals, &b.normals);
        let mut angles = [0.0; BLOCK];
        for i in 0..BLOCK {
            angles[i] = angle(DVec3::new(ax[i], ay[i], az[i]), DVec3::new(bx[i], by[i], bz[i]));
        }
        for some in angles.chunks_exact(LANES) {
            for (lane, angle) in some.iter().enumerate() {
                lanes.add(lane, angle * angle, *angle);
            }
        }
    }
}

impl PairSums {
    /// Vertices of both versions, in the blocks if these have them.
    fn add(
        &mut self,
        blocks: [&VertexBlock; 2],
        [a, b]: [&Vertices<'_>; 2],
        range: Range<usize>,
        scale: f64,
        arch: Arch,
    ) {
        if blocks.iter().all(|block| block.has_positions) {
            let distances = arch.dispatch(BlockDistances(blocks, scale, &mut self.squares));
            distances.iter().for_each(|distance| self.histogram.add(*distance));
            self.vertices += BLOCK as u64;
        } else {
            self.add_positions([&a.positions[range.clone()], &b.positions[range.clone()]], scale);
        }
        if blocks.iter().all(|block| block.has_normals) {
            arch.dispatch(NormalAngles(blocks, &mut self.angles));
            self.normals += BLOCK as u64;
        } else {
            self.add_normals([a, b].map(|part| part.normals.get(range.clone()).unwrap_or_default()));
        }
    }

    fn add_positions(&mut self, [a, b]: [&[DVec3]; 2], scale: f64) {
        for (p, q) in a.iter().zip(b).filter(|(p, q)| p.is_finite() && q.is_finite()) {
            let square = p.distance_squared(*q) * (scale * scale);
            self.vertices += 1;
            self.squares.add(0, square, square);
            self.histogram.add(square.sqrt());
        }
    }

    fn add_normals(&mut self, [a, b]: [&[Vec3]; 2]) {
        for (m, n) in a.iter().zip(b).filter(|(m, n)| is_direction(**m) && is_direction(**n)) {
            let angle = angle(m.as_dvec3(), n.as_dvec3());
            self.normals += 1;
            self.angles.add(0, angle * angle, angle);
        }
    }

    fn merge(&mut self, other: &Self) {
        self.histogram.merge(&other.histogram);
        self.vertices += other.vertices;
        self.squares.merge(&other.squares);
        self.normals += other.normals;
        self.angles.merge(&other.angles);
    }

    fn finish(&self) -> Difference {
        let rms = |squares: &LaneSums, count: u64| (squares.sum() / count.max(1) as f64).sqrt();
        let angles = Angles {
            rms: rms(&self.angles, self.normals).to_degrees(),
            max: self.angles.greatest().to_degrees(),
        };
        let max = self.squares.greatest().sqrt();
        Difference {
            vertices: self.vertices,
            rms: rms(&self.squares, self.vertices),
            // The middle of a bin may be beyond all numbers in the bin.
            p99: self.histogram.quantile(0.99).min(max),
            max,
            normals: (self.normals > 0).then_some(angles),
        }
    }
}

/// Whether a normal has a direction: a length above 0 that is finite.
#[inline]
fn is_direction(n: Vec3) -> bool {
    let square = n.length_squared();
    square > 0.0 && square.is_finite()
}

/// The angle between two directions, in radians; exact for small angles, and 0 between a direction and
/// itself.
#[inline(always)]
fn angle(a: DVec3, b: DVec3) -> f64 {
    // The vectors' lengths cancel out.
    let (across, along) = (a.cross(b).length(), a.dot(b));
    // The arctangent is that of libraries, but without branches, so that several are found at once: x is at
    // most the tangent of a sixteenth of a turn, where the terms that the series leaves out are 3e-9.
    let (small, large) = (across.min(along.abs()), across.max(along.abs()));
    let x = small / large.max(f64::MIN_POSITIVE);
    let steep = x > std::f64::consts::SQRT_2 - 1.0;
    let x = if steep { (x - 1.0) / (x + 1.0) } else { x };
    let square = x * x;
    let series = [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0f64];
    let sum = series.iter().fold(0.0, |sum, n| (1.0 / n - sum) * square);
    let angle = x * (1.0 - sum) + if steep { std::f64::consts::FRAC_PI_4 } else { 0.0 };
    let angle = if across > along.abs() { std::f64::consts::FRAC_PI_2 - angle } else { angle };
    if along < 0.0 { std::f64::consts::PI - angle } else { angle }
}

/// Figures of all versions in a range of vertices.
#[derive(Default)]
struct RangeFigures {
    bounds: Vec<Bounds>,
    pairs: Vec<PairSums>,
}

impl RangeFigures {
    fn add(&mut self, parts: &[Vertices<'_>], scale: f64) {
        self.make_room(parts.len());
        let arch = Arch::new();
        let count = parts.first().map_or(0, |part| part.positions.len());
        let mut blocks: Vec<VertexBlock> = parts.iter().map(|_| VertexBlock::EMPTY).collect();
        for first in (0..count).step_by(BLOCK) {
            let range = first..count.min(first + BLOCK);
            for ((block, part), bounds) in blocks.iter_mut().zip(parts).zip(&mut self.bounds) {
                block.fill(part, range.clone());
                if block.has_positions {
                    bounds.absorb(&arch.dispatch(BlockBox(block)));
                } else {
                    let finite = part.positions[range.clone()].iter().filter(|p| p.is_finite());
                    finite.for_each(|p| bounds.include(*p));
                }
            }
            for (pair, (a, b)) in self.pairs.iter_mut().zip(each_two(parts.len())) {
                pair.add([&blocks[a], &blocks[b]], [&parts[a], &parts[b]], range.clone(), scale, arch);
            }
        }
    }

    fn make_room(&mut self, versions: usize) {
        self.bounds.resize_with(versions, Bounds::default);
        self.pairs.resize_with(each_two(versions).count(), PairSums::default);
    }

    fn merge(&mut self, other: &Self) {
        for (bounds, other) in self.bounds.iter_mut().zip(&other.bounds).filter(|(_, o)| !o.is_empty()) {
            bounds.include(other.min);
            bounds.include(other.max);
        }
        self.pairs.iter_mut().zip(&other.pairs).for_each(|(pair, other)| pair.merge(other));
    }
}

/// (0, 1), (0, 2), …, (1, 2), …
fn each_two(count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).flat_map(move |i| (i + 1..count).map(move |k| (i, k)))
}

/// Takes vertices of all versions, with the number of the first one: on any thread, a range of the model
/// after the other.
pub type Also<'a> = dyn Fn(u64, &[Vertices<'_>]) -> Result<()> + Sync + 'a;

/// Compares versions of a model, all with all, in one reading, of ranges on all threads where the files
/// allow. `diagonal` is the length that others are told as fractions of; `also` sees all vertices, too, with
/// so many of the first one's first attributes.
///
/// Memory: for each thread a small chunk of each version; for each pair 13 kB, and as much for each of two
/// ranges for each thread.
///
/// # Errors
/// The models differ in their number of vertices; one cannot be read; `also` fails; the user cancelled.
pub fn beside(
    models: &[&dyn Model],
    diagonal: f64,
    (attributes, also): (usize, &Also<'_>),
    progress: &dyn Progress,
) -> Result<VersionsBeside> {
    let scale = 1.0 / diagonal.max(f64::MIN_POSITIVE);
    progress.begin("measuring", models.first().map_or(0, |m| m.info().vertex_bytes));
    let mut all = RangeFigures::default();
    all.make_room(models.len());
    let visit = |found: &mut RangeFigures, first: u64, parts: &[Vertices<'_>]| {
        found.add(parts, scale);
        also(first, parts)
    };
    in_ranges(models, attributes, progress, visit, |found| {
        all.merge(&found);
        Ok(())
    })?;
    let differences = each_two(models.len()).zip(&all.pairs).map(|(of, pair)| (of, pair.finish()));
    Ok(VersionsBeside { differences: differences.collect(), bounds: all.bounds })
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::progress::Silent;
    use simod_model::{Scalar, write_points};

    #[test]
    fn versions_differ_as_they_were_moved() {
        let folder = tempfile::tempdir().unwrap();
        let rest: Vec<DVec3> =
            (0..20_000).map(|i| DVec3::new(f64::from(i % 100), f64::from(i / 100), 0.0)).collect();
        let open = |name: &str, normal: Vec3, of: &dyn Fn(&DVec3) -> DVec3| {
            let (path, normals) = (folder.path().join(name), vec![normal; rest.len()]);
            let points = rest.iter().map(of).collect::<Vec<_>>().into_iter();
            write_points(&path, points, &normals, &[], Scalar::F64, &[]).unwrap();
            simod_model::open(&path).unwrap()
        };
        let tilted = Vec3::new(0.0, 3f32.sqrt() / 2.0, 0.5);
        let first = open("a", Vec3::Z, &|p| *p);
        let same = open("b", Vec3::Z, &|p| *p);
        // One of ten columns is moved by 3 and 4.
        let moved =
            open("c", tilted, &|p| if p.x % 10.0 == 0.0 { *p + DVec3::new(0.0, 3.0, 4.0) } else { *p });
        let found = beside(&[&*first, &*same, &*moved], 2.0, (0, &|_, _| Ok(())), &Silent).unwrap();
        let order: Vec<_> = found.differences.iter().map(|(of, _)| *of).collect();
        assert_eq!(order, [(0, 1), (0, 2), (1, 2)]);
        let nothing = Difference {
            vertices: 20_000,
            rms: 0.0,
            p99: 0.0,
            max: 0.0,
            normals: Some(Angles { rms: 0.0, max: 0.0 }),
        };
        assert_eq!(found.differences[0].1, nothing);
        let Difference { rms, p99, max, normals, .. } = found.differences[1].1;
        assert!((rms - 2.5 * 0.1f64.sqrt()).abs() < 1e-12 && max == 2.5, "{rms}, {max}");
        assert!((p99 / 2.5 - 1.0).abs() < 0.02, "{p99}");
        let normals = normals.unwrap();
        assert!((normals.rms - 60.0).abs() < 1e-4 && (normals.max - 60.0).abs() < 1e-4, "{normals:?}");
        assert_eq!(found.bounds[0], Bounds::from_points(rest.iter().copied()));
        assert_eq!(found.bounds[2], Bounds { min: DVec3::ZERO, max: DVec3::new(99.0, 202.0, 4.0) });
    }

    #[test]
    fn the_box_of_a_block_is_that_of_its_positions() {
        let place = |i: usize| DVec3::new(1.3, 2.9, 7.1).map(|k| (k * i as f64).sin() * 5.0 - 1.0);
        let mut block = VertexBlock::EMPTY;
        for (axis, i) in (0..3).flat_map(|axis| (0..BLOCK).map(move |i| (axis, i))) {
            block.positions[axis][i] = place(i)[axis];
        }
        assert_eq!(Arch::new().dispatch(BlockBox(&block)), Bounds::from_points((0..BLOCK).map(place)));
    }

    #[test]
    fn models_of_other_sizes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let open = |name: &str, count: usize| {
            let path = folder.path().join(name);
            write_points(&path, vec![DVec3::ONE; count].into_iter(), &[], &[], Scalar::F32, &[]).unwrap();
            simod_model::open(&path).unwrap()
        };
        let (a, b) = (open("a", 5), open("b", 6));
        let error = beside(&[&*a, &*b], 1.0, (0, &|_, _| Ok(())), &Silent).unwrap_err();
        assert!(error.to_string().contains("6 vertices"), "{error}");
    }

    #[test]
    fn angles_are_those_of_the_arctangent() {
        for i in 0..=3600 {
            let t = f64::from(i) * std::f64::consts::PI / 3600.0;
            let (a, b) = (DVec3::new(0.6, 0.0, 0.8) * 3.0, DVec3::Y * 0.25);
            let found = angle(a, (a.normalize_or_zero() * t.cos() + b.normalize_or_zero() * t.sin()) * 7.0);
            assert!((found - t).abs() < 2e-8, "{found} instead of {t}");
        }
        assert_eq!(angle(DVec3::X, DVec3::X), 0.0);
        // Small ones keep their digits.
        let little = angle(DVec3::X, DVec3::new(1.0, 1e-9, 0.0));
        assert!((little / 1e-9 - 1.0).abs() < 1e-6, "{little}");
    }

    #[test]
    fn ranges_on_any_threads_add_up_to_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let count = 600_000;
        let at = |i: u32, lift: f64| {
            let t = f64::from(i);
            DVec3::new(t, (t * 0.01).sin(), lift * (t * 1e-3).cos())
        };
        let open = |name: &str, lift: f64| {
            let path = folder.path().join(name);
            write_points(&path, (0..count).map(|i| at(i, lift)), &[], &[], Scalar::F64, &[]).unwrap();
            simod_model::open(&path).unwrap()
        };
        let (a, b) = (open("a", 0.0), open("b", 1.0));
        let seen = std::sync::atomic::AtomicU64::new(0);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let also = |first: u64, parts: &[Vertices<'_>]| {
                assert_eq!(parts[0].positions[0].x, first as f64);
                seen.fetch_add(parts[1].positions.len() as u64, std::sync::atomic::Ordering::Relaxed);
                Ok(())
            };
            pool.install(|| beside(&[&*a, &*b], 1.0, (0, &also), &Silent).unwrap())
        };
        let one = run(1);
        assert_eq!(one, run(3));
        assert_eq!(seen.into_inner(), 2 * u64::from(count));
        let squares: f64 = (0..count).map(|i| at(i, 1.0).z.powi(2)).sum();
        let expected = (squares / f64::from(count)).sqrt();
        assert!((one.differences[0].1.rms / expected - 1.0).abs() < 1e-12);
        assert_eq!(one.differences[0].1.vertices, u64::from(count));
    }
}
