//! Octree of cells, which has for each the sample whose support reaches the cell's middle best.

use std::sync::OnceLock;

use glam::{Vec3, Vec4};
use pulp::Simd;
use rayon::prelude::*;
use simod_model::long_list::LongList;

use super::expansion::Expansion;
use super::lanes::{Lanes, from};
use crate::sampling::SampleSet;

/// Largest number of supports that may meet a cell that is not parted: fewer than each sample has neighbours.
const MOST: usize = 5;

/// Part of its radius at which a support ends for that: half a spacing.
const REACH: f32 = 0.35;

/// A cell whose edge is shorter than this part of the least radius is not parted, however many supports
/// overlap there.
const EDGE: f32 = 0.5;

/// Levels of cells below the whole.
const LEVELS: u32 = 20;

/// Marks a cell that is parted.
const PARTED: u32 = 1 << 31;

/// Samples in a cell from which on its parts are made side by side.
const SIDE_BY_SIDE: usize = 1 << 12;

/// An octree over the supports: for each cell a sample that is near its middle.
///
/// Memory: 17 bytes per sample, and 32 for each cell that is parted: about one for seven samples of a
/// surface. Where samples are in heaps of a dozen, each has a chain of at most [`LEVELS`] cells, which makes
/// 1.5 per sample. As much again while it is made, and 16 bytes more for each sample.
pub struct HomeOctree {
    /// Corner of the whole, in local coordinates.
    corner: Vec3,
    /// Finest cells per unit.
    scale: f32,
    /// The eighths of each cell that is parted: their place in this list with [`PARTED`], or their sample.
    /// The whole is the first.
    parted: Vec<[u32; 8]>,
    /// Centre of each support, and one over the square of its radius.
    supports: LongList<Vec4>,
    /// For each node of the samples' tree, the largest radius below it: found when a place is first looked up
    /// that no support near it reaches.
    pub(super) largest: OnceLock<Vec<f32>>,
}

impl HomeOctree {
    /// The octree over samples with supports of these radii.
    pub fn build(samples: &SampleSet, radius: &[f32]) -> Self {
        let positions = &samples.positions;
        let (mut cells, whole) = Self::whole(samples, radius);
        let mut balls = LongList::<Vec4>::zeros(positions.len(), samples.storage());
        balls.iter_mut().zip(positions).zip(radius).for_each(|((to, p), radius)| *to = p.extend(*radius));
        let growing = Growing { supports: &cells.supports, balls: &balls };
        let all: Vec<u32> = (0..positions.len() as u32).collect();
        let mut parted = Vec::new();
        growing.part(whole, &all, &mut parted, &mut Reached::of_levels());
        parted.shrink_to_fit();
        cells.parted = parted;
        cells
    }

    /// Octree whose [parted](Self::parted) cells were found before; `None` if they are no octree's.
    pub fn known(samples: &SampleSet, radius: &[f32], parted: Vec<[u32; 8]>) -> Option<Self> {
        let mut levels = vec![0; parted.len()];
        for (at, what) in parted.iter().enumerate().flat_map(|(at, eighths)| eighths.map(|what| (at, what))) {
            if what & PARTED == 0 {
                ((what as usize) < samples.len()).then_some(())?;
                continue;
            }
            // The eighths of a cell stand behind the cell in the list.
            let below = (what & !PARTED) as usize;
            let level = levels[at] + 1;
            (below > at && below < parted.len() && level < LEVELS).then_some(())?;
            levels[below] = level.max(levels[below]);
        }
        let cells = Self::whole(samples, radius).0;
        (!parted.is_empty()).then_some(Self { parted, ..cells })
    }

    /// The eighths of each cell that is parted: see [`known`](Self::known).
    pub fn parted(&self) -> &[[u32; 8]] {
        &self.parted
    }

    /// The octree of one cell, which is not parted yet.
    fn whole(samples: &SampleSet, radius: &[f32]) -> (Self, OctreeCell) {
        let positions = &samples.positions;
        let min = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let max = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        // Room for rounding: the finest cells are still eight times as wide as coordinates there are exact.
        // And room for samples that are all at one place.
        let size = (max - min).max_element().max(min.abs().max(max.abs()).max_element());
        let edge = (1.001 * size).max(1e-20);
        let corner = 0.5 * (min + max) - 0.5 * edge;
        let support = |p: &Vec3, radius: f32| p.extend((1.0 / (radius * radius)).min(Expansion::NO_SUPPORT));
        let mut supports = LongList::<Vec4>::zeros(positions.len(), samples.storage());
        supports
            .iter_mut()
            .zip(positions)
            .zip(radius)
            .for_each(|((to, p), radius)| *to = support(p, *radius));
        let cells = Self {
            corner,
            scale: (1 << LEVELS) as f32 / edge,
            parted: Vec::new(),
            supports,
            largest: OnceLock::new(),
        };
        (cells, OctreeCell { corner, edge, level: 0 })
    }

    /// Square of the distance of a point from a sample, as a part of the square of the radius of its support.
    #[inline]
    pub fn depth(&self, sample: u32, p: Vec3) -> f32 {
        depth(self.supports[sample as usize], p)
    }

    /// The [depths](Self::depth) of many points, to the bit as of one.
    #[inline(always)]
    pub fn depths<S: Simd>(&self, simd: S, sample: u32, p: [Lanes<S>; 3]) -> Lanes<S> {
        let [x, y, z, inverse_square] = self.supports[sample as usize].to_array();
        let d = from(simd, p, [x, y, z]);
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) * Lanes::splat(simd, inverse_square)
    }
}

#[inline]
fn depth(support: Vec4, p: Vec3) -> f32 {
    (p - support.truncate()).length_squared() * support.w
}

/// A cube.
#[derive(Clone, Copy)]
struct OctreeCell {
    corner: Vec3,
    edge: f32,
    level: u32,
}

impl OctreeCell {
    fn eighth(self, at: usize) -> Self {
        let edge = 0.5 * self.edge;
        let side = |bit: usize| if at >> bit & 1 == 1 { edge } else { 0.0 };
        Self { corner: self.corner + Vec3::new(side(0), side(1), side(2)), edge, level: self.level + 1 }
    }

    fn middle(self) -> Vec3 {
        self.corner + 0.5 * self.edge
    }

    /// Along which axes a box about a point, so far to each side, meets it: a bit for each; the point's last
    /// number is of no meaning.
    fn meets(self, p: Vec4, reach: f32) -> usize {
        let away = (p - self.middle().extend(0.0)).abs();
        (away.cmple(Vec4::splat(0.5 * self.edge + reach)).bitmask() & 0b111) as usize
    }
}

/// The eighths that a box meets, a bit for each, by the [axes](Cell::meets) along which it meets the first of
/// them and, three bits higher, the last.
const MET: [u8; 64] = {
    let mut met = [0; 64];
    let mut axes = 0;
    while axes < 64 {
        let mut eighth = 0;
        while eighth < 8 {
            let (low, high) = (axes & 0b111 & !eighth, axes >> 3 & eighth);
            if low | high == 0b111 {
                met[axes] |= 1 << eighth;
            }
            eighth += 1;
        }
        axes += 1;
    }
    met
};

/// Entry of a cell, shifted where it is a place in a list that stands behind `others` other entries.
fn behind(others: u32, what: u32) -> u32 {
    if what & PARTED == 0 { what } else { what + others }
}

/// The samples that reach each eighth of a cell: as many places for each as there are samples that reach the
/// cell, of which the first are taken.
#[derive(Default)]
struct Reached {
    samples: Vec<u32>,
    places: usize,
    counts: [u32; 8],
    /// The least radius of the samples of each eighth; infinite where there are none.
    least: [f32; 8],
}

impl Reached {
    /// Empty lists of the samples that reach a cell, one for each level of cells.
    ///
    /// Memory: 32 bytes for each sample that reaches a cell, of one cell of each level: of the samples that
    /// are parted by one thread, up to [`SIDE_BY_SIDE`], twice as many.
    fn of_levels() -> [Self; LEVELS as usize] {
        Default::default()
    }

    fn of_eighth(&self, eighth: usize) -> &[u32] {
        let first = eighth * self.places;
        &self.samples[first..first + self.counts[eighth] as usize]
    }
}

/// Supports and balls from which cells are made.
struct Growing<'a> {
    supports: &'a [Vec4],
    /// Centre and radius of each support.
    balls: &'a [Vec4],
}

impl Growing<'_> {
    /// Parts a cell that some samples reach: appends the cell and those below it. `levels` are the lists for
    /// its eighths and below.
    fn part(&self, cell: OctreeCell, near: &[u32], parted: &mut Vec<[u32; 8]>, levels: &mut [Reached]) {
        let at = parted.len();
        parted.push([0; 8]);
        let Some((reached, below)) = levels.split_first_mut() else { return };
        self.reach(cell, near, reached);
        let reached = &*reached;
        if near.len() < SIDE_BY_SIDE {
            for i in 0..8 {
                let (eighth, samples, least) = (cell.eighth(i), reached.of_eighth(i), reached.least[i]);
                parted[at][i] = self.fill(eighth, near, samples, least, parted, below);
            }
            return;
        }
        let eighths: Vec<(u32, Vec<[u32; 8]>)> = (0..8)
            .into_par_iter()
            .map(|i| {
                let mut below = Vec::new();
                let (eighth, samples, least) = (cell.eighth(i), reached.of_eighth(i), reached.least[i]);
                let mut levels = Reached::of_levels();
                (self.fill(eighth, near, samples, least, &mut below, &mut levels), below)
            })
            .collect();
        for (i, (what, below)) in eighths.into_iter().enumerate() {
            let first = parted.len() as u32;
            parted[at][i] = behind(first, what);
            parted.extend(below.into_iter().map(|eighths| eighths.map(|what| behind(first, what))));
        }
    }

    /// Finds which samples reach the eighths of a cell, of those that reach itself.
    fn reach(&self, cell: OctreeCell, near: &[u32], reached: &mut Reached) {
        let [low, high] = [0, 7].map(|eighth| cell.eighth(eighth));
        if reached.samples.len() < 8 * near.len() {
            // The system's own zeros: most places stay free, and are not touched.
            reached.samples = bytemuck::zeroed_vec(8 * near.len());
        }
        (reached.places, reached.counts, reached.least) = (near.len(), [0; 8], [f32::INFINITY; 8]);
        for sample in near {
            let ball = self.balls[*sample as usize];
            let reach = REACH * ball.w;
            let mut met = MET[low.meets(ball, reach) | high.meets(ball, reach) << 3];
            while met != 0 {
                let eighth = met.trailing_zeros() as usize;
                let count = &mut reached.counts[eighth];
                reached.samples[eighth * near.len() + *count as usize] = *sample;
                *count += 1;
                reached.least[eighth] = reached.least[eighth].min(ball.w);
                met &= met - 1;
            }
        }
    }

    /// Entry of a cell: its sample, or the place of its eighths with [`PARTED`]. The samples `around` reach
    /// the cell of which it is an eighth, and those that are `near` reach the cell itself; `least` is the
    /// least of their radii.
    fn fill(
        &self,
        cell: OctreeCell,
        around: &[u32],
        near: &[u32],
        least: f32,
        parted: &mut Vec<[u32; 8]>,
        levels: &mut [Reached],
    ) -> u32 {
        if near.len() > MOST && cell.edge > EDGE * least && cell.level < LEVELS {
            let at = parted.len() as u32;
            self.part(cell, near, parted, levels);
            return at | PARTED;
        }
        let middle = cell.middle();
        // A cell that no support reaches gets the nearest sample of those around.
        if near.is_empty() {
            self.first(around, |support| (middle - support.truncate()).length_squared())
        } else {
            self.first(near, |support| depth(support, middle))
        }
    }

    /// The sample whose support has the least key, which is not less than nothing, and of such the first.
    fn first(&self, from: &[u32], key: impl Fn(Vec4) -> f32) -> u32 {
        // Keys that are not negative are in the order of their bits.
        let bits = |i: &u32| u64::from(key(self.supports[*i as usize]).to_bits()) << 32 | u64::from(*i);
        from.iter().map(bits).min().unwrap_or_default() as u32
    }
}

/// Cell in which the last place was found, as the next one is mostly near it. The results do not depend on
/// the cell.
pub struct Finger<'a> {
    cells: &'a HomeOctree,
    /// The parted cells around the last place, by their level ...
    parted: [u32; LEVELS as usize],
    /// ... and the level and the sample of the finest one, which is not parted.
    level: u32,
    sample: u32,
}

impl<'a> Finger<'a> {
    /// Finger that has found nothing yet: the first place has to [differ](Self::differ) in any digit.
    pub fn new(cells: &'a HomeOctree) -> Self {
        Self { cells, parted: [0; LEVELS as usize], level: LEVELS, sample: 0 }
    }

    /// Bits in which two finest cells differ: in one cell of a level lie those that differ in no higher digit
    /// than is below that level.
    #[inline(always)]
    pub fn differ(a: [u32; 3], b: [u32; 3]) -> u32 {
        (a[0] ^ b[0]) | (a[1] ^ b[1]) | (a[2] ^ b[2])
    }

    /// Bound of the bits in which a place [differs](Self::differ) from the last one: a place that differs by
    /// less is in the same cell.
    #[inline(always)]
    pub fn limit(&self) -> u32 {
        1 << (LEVELS - self.level)
    }

    /// The sample of the last place's cell.
    #[inline(always)]
    pub fn sample(&self) -> u32 {
        self.sample
    }

    /// Goes to a [finest cell](Cells::finest), which differs so from the last one.
    #[inline]
    pub fn go(&mut self, at: [u32; 3], differ: u32) {
        // Down to this level the place is in the same cells as the last one.
        let mut level = LEVELS.saturating_sub(u32::BITS - differ.leading_zeros());
        let mut parted = self.parted[level as usize];
        loop {
            let [x, y, z] = at.map(|x| (x >> (LEVELS - 1 - level)) & 1);
            let what = self.cells.parted[parted as usize][(x | y << 1 | z << 2) as usize];
            level += 1;
            if what & PARTED == 0 {
                (self.level, self.sample) = (level, what);
                return;
            }
            parted = what & !PARTED;
            self.parted[level as usize] = parted;
        }
    }
}

impl HomeOctree {
    /// The finest cells to which ways from the corner lead, or those that are nearest to them, along an axis:
    /// whole numbers in the lower digits, below such that are the same for all.
    #[inline(always)]
    pub fn finest<S: Simd>(&self, axis: usize, p: Lanes<S>) -> S::u32s {
        let simd = p.0;
        let way = (p - Lanes::splat(simd, self.corner[axis])) * Lanes::splat(simd, self.scale);
        whole(way)
    }
}

/// The whole part of numbers, of which none is less than nothing, or the nearest that is the place of a cell.
#[inline(always)]
fn whole<S: Simd>(way: Lanes<S>) -> S::u32s {
    // Number beyond which singles have no digits behind the point; the whole part of an added number is in
    // the last ones.
    const SHIFT: f32 = (1 << 23) as f32;
    let splat = |x: f32| Lanes::splat(way.0, x);
    let (shift, zero, one) = (splat(SHIFT), splat(0.0), splat(1.0));
    let way = way.max(zero).min(splat(((1 << LEVELS) - 1) as f32));
    let rounded = (way + shift) - shift;
    let down = rounded - way.less(rounded).select(one, zero);
    way.0.transmute_u32s_f32s((down + shift).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use pulp::{Arch, WithSimd};

    struct Whole(f32);

    impl WithSimd for Whole {
        type Output = u32;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> u32 {
            bytemuck::cast_slice(&[whole(Lanes::splat(simd, self.0))])[0]
        }
    }

    proptest! {
        #[test]
        fn whole_parts_are_found_many_at_once(
            way in prop::array::uniform3(prop_oneof![-2.0..70.0f32, -1e7..1e7f32, (0..1i32 << LEVELS).prop_map(|x| x as f32)]),
        ) {
            let most = ((1 << LEVELS) - 1) as f32;
            for x in way {
                let found = Arch::new().dispatch(Whole(x));
                prop_assert_eq!(found & ((1 << LEVELS) - 1), x.clamp(0.0, most) as u32);
            }
        }
    }

    #[test]
    fn the_cells_are_the_same_on_any_number_of_threads() {
        let points: Vec<Vec3> = (0..20_000u32)
            .map(|i| Vec3::new((i as f32 * 0.618).fract(), (i as f32 * 0.01).sin(), i as f32 / 20_000.0))
            .collect();
        let set = SampleSet::new(points, Vec::new()).expect("samples");
        set.prepare();
        let radius = vec![0.03; set.len()];
        let of = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| HomeOctree::build(&set, &radius).parted)
        };
        let cells = of(1);
        assert!(cells == of(3));
        assert!(cells.len() > 100 && cells.len() < set.len(), "{}", cells.len());
    }
}
