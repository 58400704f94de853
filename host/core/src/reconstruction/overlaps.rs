//! Supports that meet the support of a sample: its own, those of its neighbours, and those of samples that
//! have it as a neighbour, as between sparse and dense samples.
//!
//! The overlaps of a sample and its neighbours are found for as many at once as the processor's vector
//! registers take, by the same operations as for one.

use glam::{Vec3, Vec4};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use simod_model::long_list::{ListStorage, LongList};

use super::expansion::ReachingSupport;
use super::lanes::Lanes;
use super::sheets::{SHEET_NEIGHBOURS, Sheets};
use crate::counting_sort;
use crate::lists::lists;

/// Samples that are looked at by one job.
const TOGETHER: usize = 256;

/// Centres and radii of the supports, beside each other, as they are looked up in no order.
pub struct Balls(Vec<Vec4>);

impl Balls {
    pub fn new(positions: &[Vec3], radius: &[f32]) -> Self {
        Self(positions.iter().zip(radius).map(|(p, radius)| p.extend(*radius)).collect())
    }

    fn distance(&self, home: usize, j: usize) -> f32 {
        self.0[home].truncate().distance(self.0[j].truncate())
    }

    /// Whether the supports of two samples overlap.
    fn overlap(&self, home: usize, j: usize) -> bool {
        self.distance(home, j) < self.0[home].w + self.0[j].w
    }

    /// Support of sample `j`, as it is seen from a home.
    pub fn reaching(&self, home: usize, j: usize) -> ReachingSupport {
        ReachingSupport { from: self.distance(home, j) - self.0[j].w, sample: j as u32 }
    }
}

/// Lists of the supports that reach each home: a list has a start and an end, and entries between two lists
/// have no meaning.
///
/// Memory: 8 bytes for each sample that may reach a home, and 8 for each sample; as long as it is found, 32
/// for each sample besides, and 24 for each that is a neighbour of another which is none of its own.
pub struct HomeLists {
    pub starts: Vec<u32>,
    pub ends: Vec<u32>,
    pub reaching: LongList<ReachingSupport>,
}

impl HomeLists {
    /// The lists of samples with supports of these radii.
    pub fn find(positions: &[Vec3], radius: &[f32], sheets: &Sheets, storage: &ListStorage) -> Self {
        let n = positions.len();
        let balls = Balls::new(positions, radius);
        let one_way = OneWay::find(positions, &balls, sheets, storage);
        // Places are left for as many supports as there may be: so lists that are made side by side stay
        // where they are.
        let (mut starts, mut most) = (Vec::with_capacity(n), 0);
        for home in 0..n {
            starts.push(most as u32);
            most += 1 + sheets.of_sample(home).len() + one_way.owners_of(home).len();
        }
        let (mut ends, mut reaching) = (vec![0; n], LongList::<ReachingSupport>::zeros(most, storage));
        let (mut parts, mut rest, mut first) =
            (Vec::with_capacity(n.div_ceil(TOGETHER)), &mut reaching[..], 0);
        for end in starts.iter().step_by(TOGETHER).skip(1).map(|start| *start as usize).chain([most]) {
            let (part, behind) = rest.split_at_mut(end - first);
            parts.push(part);
            (rest, first) = (behind, end);
        }
        let jobs = parts.into_par_iter().zip(ends.par_chunks_mut(TOGETHER)).enumerate();
        jobs.for_each(|(job, (part, ends))| {
            let (starts, first) = (&starts, job * TOGETHER);
            storage.gone_through(size_of_val(part) + sheets.bytes_of(ends.len()));
            Arch::new().dispatch(Listing {
                balls: &balls,
                sheets,
                one_way: &one_way,
                starts,
                first,
                part,
                ends,
            });
        });
        Self { starts, ends, reaching }
    }
}

/// For each sample, the samples that have it as a neighbour but are not among its own neighbours, and whose
/// supports meet its own: in ascending order.
struct OneWay {
    /// Start of each sample's entries in `samples`, and the end of the last.
    starts: Vec<u32>,
    samples: Vec<u32>,
}

impl OneWay {
    fn find(positions: &[Vec3], balls: &Balls, sheets: &Sheets, storage: &ListStorage) -> Self {
        let n = positions.len();
        // The last neighbour of a sample whose neighbours are the nearest ones tells which samples are
        // neighbours.
        let last = |i: usize| match sheets.of_sample(i).last() {
            Some(last) if !sheets.is_crowded(i) => {
                (positions[i].distance_squared(positions[*last as usize]), *last)
            }
            _ => (-1.0, 0),
        };
        let last: Vec<(f32, u32)> = storage.counted(n, sheets.bytes_of(1)).map(last).collect();
        let job = |job: usize| {
            let samples = job * TOGETHER..n.min((job + 1) * TOGETHER);
            storage.gone_through(sheets.bytes_of(samples.len()));
            Arch::new().dispatch(NeighbourQuery { balls, sheets, last: &last, samples })
        };
        // Pairs of a home and a sample that has it as a neighbour: these ascending.
        let pairs: Vec<(u32, u32)> = (0..n.div_ceil(TOGETHER)).into_par_iter().flat_map_iter(job).collect();
        let (starts, samples) = lists(n, pairs.iter().copied());
        Self { starts, samples }
    }

    fn owners_of(&self, home: usize) -> &[u32] {
        &self.samples[self.starts[home] as usize..self.starts[home + 1] as usize]
    }
}

/// The supports of a sample's neighbours, number by number.
#[derive(Default)]
struct NeighbourSupports {
    centers: [[f32; SHEET_NEIGHBOURS]; 3],
    radius: [f32; SHEET_NEIGHBOURS],
    /// The squares of their distances.
    squares: [f32; SHEET_NEIGHBOURS],
    /// Distance from the sample at which each neighbour's support begins.
    from: [f32; SHEET_NEIGHBOURS],
    /// 1 where they meet the sample's own support, and 0 elsewhere.
    overlap: [f32; SHEET_NEIGHBOURS],
}

impl NeighbourSupports {
    /// Gathers the neighbours of a sample. Entries behind them have no meaning.
    #[inline(always)]
    fn look<S: Simd>(&mut self, simd: S, balls: &Balls, sample: usize, near: &[u32]) {
        for (at, j) in near.iter().enumerate() {
            let [x, y, z, radius] = balls.0[*j as usize].to_array();
            (self.centers[0][at], self.centers[1][at], self.centers[2][at]) = (x, y, z);
            self.radius[at] = radius;
        }
        let splat = |x: f32| Lanes::splat(simd, x);
        let [x, y, z, own] = balls.0[sample].to_array();
        let (x, y, z, own) = (splat(x), splat(y), splat(z), splat(own));
        let [xs, ys, zs] = &self.centers;
        let (xs, ys, zs) = (S::as_simd_f32s(xs).0, S::as_simd_f32s(ys).0, S::as_simd_f32s(zs).0);
        let radii = S::as_simd_f32s(&self.radius).0;
        let squares = S::as_mut_simd_f32s(&mut self.squares).0;
        let from = S::as_mut_simd_f32s(&mut self.from).0;
        let overlap = S::as_mut_simd_f32s(&mut self.overlap).0;
        for at in 0..near.len().div_ceil(S::F32_LANES) {
            let (dx, dy, dz) = (x - Lanes(simd, xs[at]), y - Lanes(simd, ys[at]), z - Lanes(simd, zs[at]));
            let (square, radius) = (dx * dx + dy * dy + dz * dz, Lanes(simd, radii[at]));
            let distance = square.sqrt();
            (squares[at], from[at]) = (square.1, (distance - radius).1);
            overlap[at] = distance.less(own + radius).select(splat(1.0), splat(0.0)).1;
        }
    }
}

/// Asks whether some samples, which follow each other, are neighbours of their neighbours.
struct NeighbourQuery<'a> {
    balls: &'a Balls,
    sheets: &'a Sheets,
    /// The squared distance of each sample's last neighbour, and that; less than nothing where others may be
    /// nearer than that.
    last: &'a [(f32, u32)],
    samples: std::ops::Range<usize>,
}

impl WithSimd for NeighbourQuery<'_> {
    /// The neighbours which know nothing of the samples whose supports meet theirs, and these, ascending.
    type Output = Vec<(u32, u32)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { balls, sheets, last, samples } = self;
        let (mut around, mut found) = (NeighbourSupports::default(), Vec::new());
        for sample in samples {
            let near = sheets.of_sample(sample);
            around.look(simd, balls, sample, near);
            // The neighbours that may not have the sample as theirs are collected without a branch, as which
            // ones they are cannot be foretold.
            let (mut chosen, mut count) = ([0; SHEET_NEIGHBOURS], 0);
            for (at, home) in near.iter().enumerate() {
                chosen[count] = at;
                let is_far = last[*home as usize].0 <= around.squares[at];
                count += usize::from(is_far & (around.overlap[at] != 0.0));
            }
            for at in &chosen[..count] {
                let home = near[*at];
                let is_unknown = match last[home as usize] {
                    (distance, _) if distance < 0.0 => {
                        !sheets.of_sample(home as usize).contains(&(sample as u32))
                    }
                    last => last < (around.squares[*at], sample as u32),
                };
                if is_unknown {
                    found.push((home, sample as u32));
                }
            }
        }
        found
    }
}

/// Makes the lists of some homes, which follow each other from the first.
struct Listing<'a> {
    balls: &'a Balls,
    sheets: &'a Sheets,
    one_way: &'a OneWay,
    /// Start of the lists of all homes.
    starts: &'a [u32],
    first: usize,
    /// Places of these lists, and the end of each among those of all.
    part: &'a mut [ReachingSupport],
    ends: &'a mut [u32],
}

impl WithSimd for Listing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { balls, sheets, one_way, starts, first, part, ends } = self;
        let (mut around, mut list) = (NeighbourSupports::default(), Vec::new());
        for (home, end) in (first..).zip(ends) {
            let near = sheets.of_sample(home);
            around.look(simd, balls, home, near);
            // As numbers that are in the order of the entries. Without a branch, as above.
            list.clear();
            list.resize(near.len(), 0);
            let mut count = 0;
            for (at, sample) in near.iter().enumerate() {
                list[count] = ReachingSupport { from: around.from[at], sample: *sample }.to_ordered();
                count += usize::from(around.overlap[at] != 0.0);
            }
            list.truncate(count);
            let others = one_way.owners_of(home).iter().map(|sample| *sample as usize);
            let others = [home].into_iter().chain(others).filter(|j| balls.overlap(home, *j));
            list.extend(others.map(|j| balls.reaching(home, j).to_ordered()));
            counting_sort::sort(&mut list);
            let to = &mut part[(starts[home] - starts[first]) as usize..];
            to.iter_mut().zip(&list).for_each(|(to, r)| *to = ReachingSupport::from_ordered(*r));
            *end = starts[home] + list.len() as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::SampleSet;

    /// Dense on one side and sparse on the other, and a second sheet below.
    fn uneven() -> SampleSet {
        let place = |i: u32| {
            let (x, z) = ((i as f32 * 0.754_877_7).fract(), (i as f32 * 0.569_840_3).fract());
            let y = if i.is_multiple_of(3) { -0.02 } else { 0.05 * (9.0 * z).cos() };
            Vec3::new(x * x * x * x, y, z * z)
        };
        let normals = (0..1500u32).map(|i| if i.is_multiple_of(3) { Vec3::NEG_Y } else { Vec3::Y }).collect();
        let samples = SampleSet::new((0..1500).map(place).collect(), normals).expect("samples");
        samples.prepare();
        samples
    }

    #[test]
    fn lists_have_all_that_overlap_among_neighbours_of_either_way() {
        let samples = uneven();
        let sheets = Sheets::find(&samples);
        let positions = &samples.positions;
        let radius: Vec<f32> = (0..samples.len()).map(|i| sheets.around(positions, i, 6).1).collect();
        let (balls, lists) =
            (Balls::new(positions, &radius), HomeLists::find(positions, &radius, &sheets, samples.storage()));
        let knows = |i: usize, j: usize| sheets.of_sample(i).contains(&(j as u32));
        let mut one_way = 0;
        for home in 0..samples.len() {
            let of_either = |j: &usize| *j == home || knows(home, *j) || knows(*j, home);
            let all = (0..samples.len()).filter(of_either).filter(|j| balls.overlap(home, *j));
            let mut expected: Vec<u64> = all.map(|j| balls.reaching(home, j).to_ordered()).collect();
            expected.sort_unstable();
            let found = &lists.reaching[lists.starts[home] as usize..lists.ends[home] as usize];
            let found: Vec<u64> = found.iter().map(|r| r.to_ordered()).collect();
            assert_eq!(found, expected, "{home}");
            one_way += found
                .iter()
                .filter(|r| **r as u32 != home as u32 && !knows(home, **r as u32 as usize))
                .count();
        }
        assert!(one_way > 500, "{one_way}");
    }

    #[test]
    fn overlaps_are_the_same_with_any_vectors() {
        struct All<'a>(&'a Balls, &'a Sheets, usize);

        impl WithSimd for All<'_> {
            type Output = Vec<[u32; 3]>;

            #[inline(always)]
            fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
                let (mut around, mut all) = (NeighbourSupports::default(), Vec::new());
                for i in 0..self.2 {
                    let near = self.1.of_sample(i);
                    around.look(simd, self.0, i, near);
                    let bits =
                        |at| [around.squares[at], around.from[at], around.overlap[at]].map(f32::to_bits);
                    all.extend((0..near.len()).map(bits));
                }
                all
            }
        }
        let samples = uneven();
        let sheets = Sheets::find(&samples);
        let balls = Balls::new(&samples.positions, samples.spacing());
        let all = || All(&balls, &sheets, samples.len());
        let one_by_one = all().with_simd(pulp::Scalar::new());
        assert!(Arch::new().dispatch(all()) == one_by_one);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert!(Simd::vectorize(simd, all()) == one_by_one);
        }
    }
}
