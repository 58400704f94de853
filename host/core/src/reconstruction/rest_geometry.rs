//! Geometry of the samples at rest, which is found once for all deformations.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use glam::Vec3;

use super::blend::{Grouped, Supports};
use super::home_cells::HomeOctree;
use super::sheets::Sheets;
use super::workspace::Workspaces;
use crate::sampling::SampleSet;

/// Geometry of the samples at rest, for all deformations of them: the sheet of each sample, and its support,
/// the ball in which its expansion has a weight. It is found once for a [`SampleSet`], which holds it for all
/// who need it.
///
/// Memory: about 290 bytes per sample, up to 130 more beside other sheets, and that of
/// [`SampleSet::prepare`].
pub struct RestGeometry<'a> {
    pub(super) samples: &'a SampleSet,
    pub(super) sheets: Arc<Sheets>,
    pub(super) supports: Arc<Supports>,
    found: Arc<FoundGeometry>,
    pub(super) workspaces: Workspaces,
    /// The number of vertices whose home each sample was.
    vertices: Vec<AtomicU64>,
}

/// Geometry of samples at rest that was found so far, each part once, and is held with the samples: some need
/// the sheets alone.
#[derive(Default)]
struct HeldGeometry {
    sheets: OnceLock<Arc<Sheets>>,
    all: OnceLock<Arc<FoundGeometry>>,
}

/// Geometry of samples at rest: sheets, supports, and cells of homes.
struct FoundGeometry {
    sheets: Arc<Sheets>,
    supports: Arc<Supports>,
    /// Cells by which homes are found: made when a place is first looked up, as fitting does not need them.
    cells: OnceLock<HomeOctree>,
    /// Whether the geometry is on the disk, beside the samples.
    is_kept: AtomicBool,
}

impl<'a> RestGeometry<'a> {
    /// Sheets and supports of the samples at rest: as held from before, or found now.
    pub fn new(samples: &'a SampleSet) -> Self {
        Self::held(samples).unwrap_or_else(|| {
            let sheets = sheets(samples);
            let supports = Supports::new(samples, &sheets);
            Self::known(samples, sheets, supports)
        })
    }

    /// Finds now the cells that are otherwise found when a place is first looked up.
    pub fn prepare(&self) {
        self.cells();
    }

    /// Geometry that is held with the samples, if it was found before.
    pub(super) fn held(samples: &'a SampleSet) -> Option<Self> {
        samples.rest::<HeldGeometry>().all.get().map(|found| Self::of_found(samples, found.clone()))
    }

    /// Whether a sample is on the sheet of another.
    pub(crate) fn share_sheet(&self, i: usize, j: u32) -> bool {
        i as u32 == j
            || self.sheets.of_sample(i).contains(&j)
            || self.sheets.of_sample(j as usize).contains(&(i as u32))
    }

    /// The sample nearest to a local place of this home, among those on the home's sheet; the first of those
    /// that are equally near.
    pub(crate) fn nearest_on_sheet(&self, home: u32, p: Vec3) -> u32 {
        let distance = |i: u32| self.samples.positions[i as usize].distance_squared(p);
        let near = self.sheets.of_sample(home as usize).iter().map(|i| (distance(*i), *i));
        let nearer = |a: (f32, u32), b: (f32, u32)| if b < a { b } else { a };
        near.fold((distance(home), home), nearer).1
    }

    /// The samples whose supports reach where one is the home.
    pub(super) fn reaching(&self, home: usize) -> impl Iterator<Item = usize> {
        self.supports.of_home(home).iter().map(|r| r.sample as usize)
    }

    /// Geometry from sheets and supports that were found before.
    pub(super) fn known(
        samples: &'a SampleSet,
        sheets: impl Into<Arc<Sheets>>,
        supports: impl Into<Arc<Supports>>,
    ) -> Self {
        let (sheets, supports) = (sheets.into(), supports.into());
        let found =
            FoundGeometry { sheets, supports, cells: OnceLock::new(), is_kept: AtomicBool::new(false) };
        let found = Arc::new(found);
        // Another thread that found the geometry at the same time found the same.
        let held = samples.rest::<HeldGeometry>();
        let _ = (held.sheets.set(found.sheets.clone()), held.all.set(found.clone()));
        Self::of_found(samples, found)
    }

    fn of_found(samples: &'a SampleSet, found: Arc<FoundGeometry>) -> Self {
        let vertices = (0..samples.len()).map(|_| AtomicU64::new(0)).collect();
        let (sheets, supports) = (found.sheets.clone(), found.supports.clone());
        Self { samples, sheets, supports, found, workspaces: Workspaces::default(), vertices }
    }

    /// Whether the geometry is on the disk, beside the samples.
    pub(super) fn is_kept(&self) -> bool {
        self.found.is_kept.load(Ordering::Relaxed)
    }

    /// Notes that the geometry is on the disk.
    pub(super) fn set_kept(&self) {
        self.found.is_kept.store(true, Ordering::Relaxed);
    }

    pub(super) fn cells(&self) -> &HomeOctree {
        match self.found.cells.get() {
            Some(cells) => cells,
            // Jobs of the thread pool make them: no other one may wait for that.
            None => {
                let cells = HomeOctree::build(self.samples, &self.supports.radius);
                self.found.cells.get_or_init(|| cells)
            }
        }
    }

    /// Sets the cells by which homes are found, from an earlier call.
    pub(super) fn set_cells(&self, cells: HomeOctree) {
        let _ = self.found.cells.set(cells);
    }

    /// Counts vertices that were carried around homes.
    pub(super) fn count(&self, grouped: &Grouped) {
        grouped.groups.iter().for_each(|(home, vertices)| self.count_more(*home, vertices.len() as u64));
        grouped.scattered.iter().for_each(|home| self.count_more(*home, 1));
    }

    /// Counts more vertices that were carried around a home.
    pub(super) fn count_more(&self, home: u32, vertices: u64) {
        self.vertices[home as usize].fetch_add(vertices, Ordering::Relaxed);
    }

    /// The number of vertices so far of which the sample was the home, where anything moves.
    pub(super) fn vertices_of(&self, sample: usize) -> u64 {
        self.vertices[sample].load(Ordering::Relaxed)
    }
}

/// Sheets of the samples at rest: as held from before, or found now.
pub(super) fn sheets(samples: &SampleSet) -> Arc<Sheets> {
    let held = samples.rest::<HeldGeometry>();
    if let Some(sheets) = held.sheets.get() {
        return sheets.clone();
    }
    // Jobs of the thread pool find them: no other one may wait for that.
    samples.prepare();
    let found = Arc::new(Sheets::find(samples));
    held.sheets.get_or_init(|| found).clone()
}
