//! P_S: the samples, with the neighbours, normals and spacings that a deformation tool and the reconstruction
//! need.

use std::any::Any;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use glam::Vec3;
use rayon::prelude::*;
use simod_model::long_list::ListStorage;
use simod_model::{Error, Result, memory};

use super::kd_tree::KdTree;
use super::neighbour_graph::NeighbourGraph;
use super::normals;
use crate::touching::Contacts;

/// Neighbours that are known of each sample: enough for a second-order fit, and for the neighbourhoods of all
/// points around the sample.
pub const NEIGHBOURS: usize = 32;

/// Factors of the distance within which as many neighbours as are wanted are expected, tried one after the
/// other.
const MORE: [f32; 3] = [1.15, 1.5, 2.0];

/// Neighbours over which the spacing is measured: as many as in a hexagonal packing.
const SPACING_NEIGHBOURS: usize = 6;

/// Bytes of a sample's entries in the long lists of a reconstruction, about.
const LISTED: u64 = 600;

/// Most bytes that the long lists of a reconstruction take in memory: beyond that they are in temporary
/// files.
const MOST_LISTED: u64 = 1 << 30;

/// Largest ratio of the extent of a sample that few others have for a neighbour to the median spacing around
/// it.
const FINER: f32 = 4.0;

/// The small point set P_S, in local coordinates (see [`Frame`](simod_model::frame::Frame)).
///
/// Memory: 24 bytes per sample; 12 more where normals were estimated (about 150 meanwhile), and 160 once the
/// neighbours are asked for, and that of a [`RestGeometry`](crate::reconstruction::RestGeometry). The index
/// of a sample never changes.
pub struct SampleSet {
    /// Positions.
    pub positions: Vec<Vec3>,
    /// Unit normals of the model, averaged; zero, or none at all, where the model has none.
    known: Vec<Vec3>,
    /// Whether the model has told the normals of all samples.
    all_known: bool,
    /// All normals, where some had to be estimated.
    estimated: OnceLock<Vec<Vec3>>,
    neighbourhoods: OnceLock<Neighbourhoods>,
    contacts: Option<Contacts>,
    tree: OnceLock<KdTree>,
    rest: OnceLock<Arc<dyn Any + Send + Sync>>,
    storage: ListStorage,
}

/// Neighbours of each sample and its spacing: found when they are first asked for, as writing the samples
/// does not need them.
struct Neighbourhoods {
    neighbours: NeighbourGraph,
    spacing: Vec<f32>,
}

impl SampleSet {
    /// A set of samples; normals that are zero or missing will be estimated when they are asked for.
    ///
    /// # Errors
    /// There is no sample, or one that is not finite.
    pub fn new(positions: Vec<Vec3>, normals: Vec<Vec3>) -> Result<Self> {
        let refused = |what: String| Err(Error::degenerate(what, "sample the model again"));
        if positions.is_empty() {
            return refused("there are no samples".to_owned());
        }
        if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
            return refused(format!("sample {i} has no finite position"));
        }
        let mut known = normals;
        known.resize(positions.len(), Vec3::ZERO);
        if known.iter().all(|n| *n == Vec3::ZERO) {
            known = Vec::new();
        }
        let all_known = !known.is_empty() && !known.contains(&Vec3::ZERO);
        Ok(Self {
            positions,
            known,
            all_known,
            estimated: OnceLock::new(),
            neighbourhoods: OnceLock::new(),
            contacts: None,
            tree: OnceLock::new(),
            rest: OnceLock::new(),
            storage: ListStorage::Memory,
        })
    }

    /// Unit normals, consistently oriented.
    #[inline]
    pub fn normals(&self) -> &[Vec3] {
        if self.all_known {
            return &self.known;
        }
        let completed =
            |graph: &NeighbourGraph| normals::completed(&self.positions, &self.known, graph, &self.storage);
        self.estimated.get_or_init(|| match self.neighbourhoods.get() {
            Some(around) => completed(&around.neighbours),
            None => completed(&self.graph_to(normals::NEIGHBOURS)),
        })
    }

    /// Estimates normals, where the model has not told them all, by neighbours and directions of least
    /// variance from an earlier step.
    pub(super) fn estimate_normals(&self, graph: &NeighbourGraph, across: &[Vec3]) {
        if !self.all_known {
            let completed =
                || normals::completed_from(&self.positions, &self.known, graph, across, &self.storage);
            self.estimated.get_or_init(completed);
        }
    }

    /// Takes all normals, as they were estimated before; none, where the model has told them. `false` if they
    /// are not of unit length, or not as many.
    pub(crate) fn set_normals(&self, normals: Vec<Vec3>) -> bool {
        if self.all_known {
            return normals.is_empty();
        }
        let fit = normals.len() == self.len() && normals.iter().all(|n| n.is_normalized());
        if fit {
            // Normals that are known by now are the same.
            let _ = self.estimated.set(normals);
        }
        fit
    }

    /// Whether the model has told all normals, and none has to be estimated.
    pub fn knows_normals(&self) -> bool {
        self.all_known
    }

    /// The normals that stem from the model; zero where there is none, and empty if there are none at all.
    pub fn known_normals(&self) -> &[Vec3] {
        &self.known
    }

    /// Contacts where parts of the model touch, with the sheets of the samples there, as its faces tell;
    /// `None` where none do, or the model has no faces.
    pub fn contacts(&self) -> Option<&Contacts> {
        self.contacts.as_ref()
    }

    pub(crate) fn set_contacts(&mut self, contacts: Option<Contacts>) {
        self.contacts = contacts;
        self.rest = OnceLock::new();
    }

    /// Data held with the samples at rest, for all who need it as long as there are these samples: the
    /// reconstruction's, whose type is not known here.
    pub(crate) fn rest<T: Any + Default + Send + Sync>(&self) -> Arc<T> {
        self.rest.get_or_init(|| Arc::<T>::default()).clone().downcast().unwrap_or_default()
    }

    /// Place of the long lists that are found of these samples from now on.
    pub fn storage(&self) -> &ListStorage {
        &self.storage
    }

    /// Place of the long lists of this set where a reconstruction needs them: memory, as long as they take no
    /// more than 1 GiB and an eighth of the machine's memory; otherwise temporary files in `folder`.
    pub fn usual_storage(&self, folder: &Path) -> ListStorage {
        let most = (memory::of_machine() / 8).min(MOST_LISTED);
        ListStorage::for_bytes(LISTED * self.len() as u64, most, folder)
    }

    /// Sets the place of the long lists that are found from now on, whose values do not depend on it.
    pub fn store_lists(&mut self, storage: ListStorage) {
        self.storage = storage;
    }

    /// Another set of samples, whose long lists will be where those of these are.
    pub(crate) fn stored_alike(&self, other: Self) -> Self {
        Self { storage: self.storage.clone(), ..other }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether the set is empty, which it never is: a set has at least one sample.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Finds now the neighbours, spacing and normals that are otherwise found when they are first asked for.
    ///
    /// To be called before these are asked for by jobs of a thread pool: finding them takes jobs of the pool,
    /// and a thread that waits for these could take one that waits for it.
    pub fn prepare(&self) {
        let _ = (self.neighbourhoods(), self.normals());
    }

    /// The k-nearest-neighbour graph.
    #[inline]
    pub fn neighbours(&self) -> &NeighbourGraph {
        &self.neighbourhoods().neighbours
    }

    /// Sets the graph of neighbours that was found before; `false` if it cannot be that of these samples.
    pub(crate) fn set_neighbours(&self, graph: NeighbourGraph) -> bool {
        if graph.k() != NEIGHBOURS.min(self.len() - 1) || !graph.is_valid(self.len()) {
            return false;
        }
        self.neighbourhoods.get_or_init(|| Neighbourhoods::new(&self.positions, graph, &self.storage));
        true
    }

    /// Mean distance to the nearest neighbours, for each sample; 0 for a single one.
    #[inline]
    pub fn spacing(&self) -> &[f32] {
        &self.neighbourhoods().spacing
    }

    /// Radius of the surface around each sample that the sample stands for in pictures: its spacing, but for
    /// samples that lie apart from all others, as strays of a scan, no more than their nearest neighbour
    /// tells.
    pub fn extents(&self) -> Vec<f32> {
        let Neighbourhoods { neighbours, spacing } = self.neighbourhoods();
        let ring = SPACING_NEIGHBOURS.min(neighbours.k());
        // Number of others that each sample is a neighbour of.
        let mut known = vec![0u8; spacing.len()];
        for i in 0..spacing.len() {
            for j in &neighbours.nearest_to(i)[..ring] {
                let known = &mut known[*j as usize];
                *known = known.saturating_add(1);
            }
        }
        let median_around = |i: usize| {
            let mut around = [0.0; SPACING_NEIGHBOURS];
            let around = &mut around[..ring];
            around.iter_mut().zip(neighbours.nearest_to(i)).for_each(|(to, j)| *to = spacing[*j as usize]);
            *around.select_nth_unstable_by(ring / 2, f32::total_cmp).1
        };
        let extent = |i: usize| {
            let Some(nearest) =
                neighbours.nearest_to(i).first().map(|j| *j as usize).filter(|_| known[i] < 5)
            else {
                return spacing[i];
            };
            // A sample is one of a few that are far from all others, or, where hardly any other has it for a
            // neighbour, all alone.
            let of_few = spacing[i].min(2.0 * self.positions[i].distance(self.positions[nearest]));
            // Or far from each other, too, beside a surface that is much finer.
            let of_few = if known[i] < 4 { of_few.min(FINER * median_around(i)) } else { of_few };
            if known[i] < 2 { of_few.min(spacing[nearest]) } else { of_few }
        };
        (0..spacing.len()).map(extent).collect()
    }

    /// At most `count` nearest neighbours of sample `i`, nearest first.
    pub(crate) fn nearest_neighbours(&self, i: usize, count: usize) -> Vec<u32> {
        let mut found = vec![0; count.min(self.len() - 1)];
        self.tree().nearest_others(self.positions[i], i as u32, &mut found);
        found.into_iter().map(|found| found as u32).collect()
    }

    /// Neighbours of a sample, found sooner if about as many are within `reach`.
    pub(crate) fn neighbours_about(&self, i: usize, reach: f32, count: usize) -> Vec<u32> {
        let mut found = self.unsorted_neighbours_about(i, reach, count);
        found.sort_unstable();
        found.into_iter().map(|found| found as u32).collect()
    }

    /// The same neighbours in no order, as numbers that are in it: their lower halves are the neighbours.
    pub(crate) fn unsorted_neighbours_about(&self, i: usize, reach: f32, count: usize) -> Vec<u64> {
        // A few more are looked for, as their number is not the same everywhere.
        for more in MORE.into_iter().take_while(|_| reach > 0.0) {
            let mut found = self.tree().within(self.positions[i], more * reach);
            if found.len() > count {
                found.retain(|found| *found as u32 != i as u32);
                if found.len() > count {
                    found.select_nth_unstable(count);
                    found.truncate(count);
                }
                return found;
            }
        }
        let mut found = vec![0; count.min(self.len() - 1)];
        self.tree().nearest_others(self.positions[i], i as u32, &mut found);
        found
    }

    /// The sample nearest to a finite point. Costs about a microsecond: not for every vertex of P_L.
    pub fn nearest(&self, p: Vec3) -> u32 {
        self.tree().nearest(p)
    }

    /// Largest radius of the balls about the samples below each node of their tree, for
    /// [`deepest`](Self::deepest).
    pub(crate) fn largest_below(&self, radius: &[f32]) -> Vec<f32> {
        self.tree().largest_below(radius)
    }

    /// Ball, among those about the samples that hold a point, in which the point is nearest to the middle, as
    /// a part of the radius.
    pub(crate) fn deepest(&self, p: Vec3, radius: &[f32], largest: &[f32]) -> Option<u32> {
        self.tree().deepest(p, radius, largest)
    }

    /// The indices of the samples nearest to a finite point, nearest first: the beginning of `found`, which
    /// is filled as far as there are samples. Costs microseconds. May be asked by jobs of a thread pool at
    /// any time.
    pub(crate) fn nearest_ones<'a>(
        &self,
        p: Vec3,
        found: &'a mut [u64],
    ) -> impl Iterator<Item = u32> + use<'a> {
        let count = found.len().min(self.len());
        self.tree().nearest_ones(p, &mut found[..count]);
        found[..count].iter().map(|found| *found as u32)
    }

    #[inline]
    fn neighbourhoods(&self) -> &Neighbourhoods {
        self.neighbourhoods
            .get_or_init(|| Neighbourhoods::new(&self.positions, self.graph_to(NEIGHBOURS), &self.storage))
    }

    /// The graph of all samples to at most `count` nearest neighbours. Takes jobs of the thread pool.
    pub(crate) fn graph_to(&self, count: usize) -> NeighbourGraph {
        self.prepare_tree();
        NeighbourGraph::of_points(self.tree(), count, &self.storage)
    }

    /// Builds now, with jobs of the thread pool, the tree in which the nearest samples are looked up.
    pub(crate) fn prepare_tree(&self) {
        if self.tree.get().is_none() {
            // A tree that another thread made meanwhile is the same.
            let _ = self.tree.set(KdTree::new(&self.positions));
        }
    }

    #[inline]
    fn tree(&self) -> &KdTree {
        self.tree.get_or_init(|| KdTree::in_one_job(&self.positions))
    }

    /// Set of some of the samples, with their normals, completed, but without their sheets.
    pub(crate) fn part(&self, chosen: &[u32]) -> Self {
        let normals = self.normals();
        Self {
            positions: chosen.iter().map(|i| self.positions[*i as usize]).collect(),
            known: chosen.iter().map(|i| normals[*i as usize]).collect(),
            all_known: true,
            estimated: OnceLock::new(),
            neighbourhoods: OnceLock::new(),
            contacts: None,
            tree: OnceLock::new(),
            rest: OnceLock::new(),
            storage: self.storage.clone(),
        }
    }
}

impl Neighbourhoods {
    fn new(positions: &[Vec3], neighbours: NeighbourGraph, storage: &ListStorage) -> Self {
        let near = SPACING_NEIGHBOURS.min(neighbours.k());
        let spacing = storage
            .counted(positions.len(), neighbours.bytes_of(1))
            .map(|i| {
                let distance = |j: &u32| positions[*j as usize].distance(positions[i]);
                neighbours.nearest_to(i)[..near].iter().map(distance).sum::<f32>() / near.max(1) as f32
            })
            .collect();
        Self { neighbours, spacing }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vec3> {
        // Few distinct values: coincident and collinear samples are common.
        let x = || (-4..4i32).prop_map(|x| x as f32 / 4.0);
        (x(), x(), x()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn neighbours_are_the_nearest(points in proptest::collection::vec(point(), 1..120)) {
            let set = SampleSet::new(points.clone(), Vec::new()).expect("finite points");
            for (i, p) in points.iter().enumerate() {
                let mut all: Vec<f32> =
                    points.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, q)| p.distance(*q)).collect();
                all.sort_by(f32::total_cmp);
                let found = set.neighbours().nearest_to(i);
                prop_assert!(!found.contains(&(i as u32)));
                let found: Vec<f32> = found.iter().map(|j| points[*j as usize].distance(*p)).collect();
                prop_assert_eq!(&found[..], &all[..set.neighbours().k()]);
                prop_assert!(set.normals()[i].is_normalized());
            }
        }
    }

    #[test]
    fn no_samples_and_non_finite_samples_are_refused() {
        assert!(SampleSet::new(Vec::new(), Vec::new()).is_err());
        assert!(SampleSet::new(vec![Vec3::NAN], Vec::new()).is_err());
    }

    /// Strays, alone or a few together, do not stand for the space between them and all others; borders and
    /// corners of a surface are no strays.
    #[test]
    fn strays_stand_for_little() {
        let surface = (0..900).map(|i| Vec3::new((i % 30) as f32, (i / 30) as f32, 0.0));
        let alone = Vec3::splat(60.0);
        let together = [alone, Vec3::new(-40.0, 0.0, 30.0), Vec3::new(-41.0, 0.0, 30.0)];
        let scattered =
            [Vec3::new(15.0, 10.0, 40.0), Vec3::new(15.0, 20.0, 40.0), Vec3::new(22.0, 15.0, 42.0)];
        let apart = [Vec3::new(70.0, 10.0, -40.0), Vec3::new(70.0, 30.0, -40.0)];
        for (strays, most) in [(&together[..], 3.0), (&scattered[..], 6.0), (&apart[..], 6.0)] {
            let points = surface.clone().chain(strays.iter().copied()).collect();
            let set = SampleSet::new(points, Vec::new()).expect("finite points");
            let (extents, spacing) = (set.extents(), set.spacing());
            assert!((0..900).all(|i| extents[i] == spacing[i]));
            let is_little = |i: usize| spacing[i] > 20.0 && extents[i] < most;
            assert!((900..extents.len()).all(is_little), "{:?}", &extents[900..]);
        }
    }
}
