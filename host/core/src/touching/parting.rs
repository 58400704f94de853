//! Clusters that hold several sheets are parted: each sheet gets a sample of its own, or joins a cluster of
//! its own sheet nearby.

use std::cmp::Ordering;
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use simod_model::frame::Frame;
use simod_model::mapped::looked_at;
use simod_model::scratch::Scratch;
use simod_model::{Model, Progress, Result, SMALL_CHUNK, VertexChunk};

use super::islands::{ClusterGraph, Islands, Mixed};
use super::pairs::Pairs;
use super::sorter::{Sorter, entry, hash_of};
use crate::lists::lists;
use crate::sampling::cluster::{Moments, Vertex};
use crate::sampling::finalization::unit;
use crate::sampling::kept_cells::CutTree;
use crate::sampling::ranges::joined;

/// A sheet with fewer than this part of its cluster's vertices joins a cluster nearby, if it can; in a model
/// of many layers, one with less than half of what each sheet would have if all were equal.
const LEAST_PART: f64 = 0.125;

/// Number of samples of which at most one goes to parts that could join clusters nearby: the others are taken
/// from all of the model.
const MOST_OF_ALL: usize = 32;

/// Samples that may go to such parts in any case.
const FEW: usize = 128;

/// Ratio of samples to parts that want one of their own, below which all clusters become larger, as for the
/// parts of a thin wall.
const MANY: usize = 4;

/// Bytes of temporary files for each vertex while vertices at the same position are joined.
const BYTES_OF_A_PLACE: u64 = 20;

/// Model and cells in which parts are looked for.
pub struct Parting<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// Ranges of the stream with each cell's vertices.
    pub ranges: &'a [Vec<Range<u64>>],
    /// Local coordinates.
    pub frame: Frame,
    /// The folder of temporary files.
    pub folder: &'a Path,
    /// Watches.
    pub progress: &'a dyn Progress,
}

/// A sheet of a cluster of several.
pub struct ClusterSheet {
    /// The islands of the sheet.
    islands: Vec<u32>,
    moments: Moments,
}

impl ClusterSheet {
    /// The sheets of a cluster, of no vertices so far.
    fn of_cluster(Mixed { cluster, parts }: Mixed) -> (u32, Vec<Self>) {
        let sheet = |islands| Self { islands, moments: Moments::default() };
        (cluster, parts.into_iter().map(sheet).collect())
    }

    /// Order of sheets: larger ones first, and equal ones by their positions, as vertices may come in any
    /// order.
    fn by_size(&self, other: &Self) -> Ordering {
        let larger = other.moments.count().total_cmp(&self.moments.count());
        larger.then_with(|| by_place(self.moments.mean().as_vec3(), other.moments.mean().as_vec3()))
    }
}

/// An order of places.
fn by_place(a: Vec3, b: Vec3) -> Ordering {
    let axes = a.to_array().into_iter().zip(b.to_array());
    axes.fold(Ordering::Equal, |order, (a, b)| order.then(a.total_cmp(&b)))
}

/// The clusters of several sheets, each with its parts, the largest first.
pub struct ClusterParts {
    graph: ClusterGraph,
    mixed: Vec<(u32, Vec<ClusterSheet>)>,
    /// Parts of mixed clusters that shall get samples of their own: first the `alone` ones with nothing of
    /// their own sheet beside them, and then the others; in both the largest first.
    wanted: Vec<(usize, usize)>,
    alone: usize,
}

/// Clusters parted by sheets: the sample of each part, and new samples.
pub struct Parted {
    graph: ClusterGraph,
    /// The sample that each island belongs to.
    sample: Vec<u32>,
    /// A cluster of each sample, and the sample of each cluster, if these are not the same.
    cluster_of: Vec<u32>,
    becomes: Option<Vec<u32>>,
    /// Whether each sample has other islands than its cluster; `islands_of` has these.
    has_own: Vec<bool>,
    /// The islands of samples that have more or fewer than their cluster.
    islands_of: HashMap<u32, Vec<u32>>,
    /// Whether each cluster is one of several sheets.
    mixed: Vec<bool>,
    /// The new position and normal of each sample that stands for another part than it did.
    pub moved: Vec<(u32, Vec3, Vec3)>,
    /// The position and normal of each new sample, and the one that each was parted from.
    pub added: Vec<(u32, Vec3, Vec3)>,
    /// Samples with a part of a cluster of several sheets, ascending.
    pub seeds: Vec<u32>,
    /// Samples beside which clusters of other sheets lie, ascending.
    pub beside: Vec<u32>,
}

impl Parting<'_> {
    /// Joins vertices at the same position, everywhere: for models whose faces share no vertices.
    ///
    /// # Errors
    /// The model cannot be read, or a temporary file written; the user cancelled.
    pub fn weld_all(&self, islands: &mut Islands, sample_of: &[u32]) -> Result<()> {
        let vertices = self.model.info().vertices;
        Scratch::check_space(self.folder, BYTES_OF_A_PLACE.saturating_mul(vertices), super::ADVICE)?;
        let all = std::iter::once(0..vertices).collect();
        self.weld(all, islands, sample_of).map(|_| ())
    }

    /// Joins vertices at the same position in some ranges; returns whether there were any to join.
    fn weld(&self, ranges: Vec<Range<u64>>, islands: &mut Islands, sample_of: &[u32]) -> Result<bool> {
        let mut sorter = Sorter::new(self.folder);
        self.vertices(
            ranges,
            |vertex, p, _| {
                if p.is_finite() { sorter.push(entry(hash_of(p), vertex)) } else { Ok(()) }
            },
        )?;
        let mut pairs = Pairs::new(self.model.info().vertices, self.folder);
        let (mut last, mut joins): (Option<[u32; 3]>, bool) = (None, false);
        sorter.finish(|entry| {
            let twin = last.replace(entry).filter(|last| last[..2] == entry[..2]);
            joins |= twin.is_some();
            twin.map_or(Ok(()), |twin| pairs.push([twin[2], entry[2]]))
        })?;
        let with_cluster = |vertex: u32| (vertex, sample_of[vertex as usize]);
        pairs.each(|some| {
            some.iter().for_each(|pair| islands.join(with_cluster(pair[0]), with_cluster(pair[1])));
            // The sample and the island of both.
            looked_at(2 * size_of_val(some));
        })?;
        Ok(joins)
    }

    /// The clusters of several sheets, once the faces are known. `trees` has the samples of each cell;
    /// `welded` says whether equal positions are joined everywhere already; it is set once they are.
    ///
    /// # Errors
    /// As of [`weld_all`](Self::weld_all).
    pub fn find(
        &self,
        islands: &mut Islands,
        sample_of: &[u32],
        trees: &[CutTree],
        welded: &mut bool,
    ) -> Result<ClusterParts> {
        // A soup looks like a tangle if not all vertices at one place were found in passing.
        if !*welded && islands.is_overfull()? {
            self.weld_all(islands, sample_of)?;
            *welded = true;
        }
        let mut graph = islands.graph(sample_of)?;
        let mut mixed = None;
        if !*welded {
            // Seams of the file are none of the surface. Where most clusters have some, it is quicker to weld
            // all than to see which do.
            let mut several = graph.several();
            if several.len() < graph.clusters() / 8 {
                let found = mixed.insert(graph.parts());
                several = found.iter().map(|mixed| mixed.cluster).collect();
            }
            if several.is_empty() {
                return Ok(ClusterParts::new(graph, Vec::new()));
            }
            let ranges = self.ranges_with(trees, |sample| several.binary_search(&sample).is_ok());
            if self.weld(ranges, islands, sample_of)? {
                (graph, mixed) = (islands.graph(sample_of)?, None);
            }
        }
        let mixed = mixed.unwrap_or_else(|| graph.parts());
        let clusters: BTreeMap<u32, usize> = mixed.iter().map(|m| m.cluster).zip(0..).collect();
        let ranges = self.ranges_with(trees, |sample| clusters.contains_key(&sample));
        let place_of = places(&mixed);
        let mut found: Vec<(u32, Vec<ClusterSheet>)> =
            mixed.into_iter().map(ClusterSheet::of_cluster).collect();
        self.vertices(ranges, |vertex, p, normal| {
            let cluster = sample_of[vertex as usize];
            if !clusters.contains_key(&cluster) {
                return Ok(());
            }
            let island = graph.number(cluster, islands.first(vertex));
            if let Some((i, j)) = island.and_then(|island| place_of.get(&island)) {
                let vertex = Vertex { position: self.frame.to_local(p), normal, index: 0 };
                found[*i].1[*j].moments.add(&Moments::from_elements(&[vertex]));
            }
            Ok(())
        })?;
        for (_, parts) in &mut found {
            parts.sort_by(ClusterSheet::by_size);
        }
        Ok(ClusterParts::new(graph, found))
    }

    /// Ranges of the stream with the cells that hold vertices of chosen samples.
    pub fn ranges_with(&self, trees: &[CutTree], chosen: impl Fn(u32) -> bool) -> Vec<Range<u64>> {
        let of_chosen = |tree: &CutTree| tree.samples.iter().any(|sample| chosen(*sample));
        let cells = trees.iter().zip(self.ranges).filter(|(tree, _)| of_chosen(tree));
        // Where reading cannot begin anywhere, going on costs less than beginning again.
        let near = self.model.info().near();
        joined(cells.flat_map(|(_, ranges)| ranges.iter().cloned()), near)
    }

    /// Reads the vertices of some ranges: index, position in the model's coordinates, and unit normal.
    ///
    /// # Errors
    /// The vertices cannot be read, or `visit` failed; the user cancelled.
    pub fn vertices(
        &self,
        ranges: Vec<Range<u64>>,
        mut visit: impl FnMut(u32, DVec3, Vec3) -> Result<()>,
    ) -> Result<()> {
        let mut chunk = VertexChunk::default();
        for range in ranges {
            let mut reader = self.model.vertices(range)?;
            reader.set_chunk(SMALL_CHUNK);
            reader.skip_attributes();
            while reader.read(&mut chunk)? {
                self.progress.check()?;
                for (i, p) in chunk.positions.iter().enumerate() {
                    let normal = chunk.normals.get(i).map_or(Vec3::ZERO, |n| unit(*n));
                    visit((chunk.first + i as u64) as u32, *p, normal)?;
                }
                // The sample and the island of each.
                looked_at(2 * size_of::<u32>() * chunk.len());
            }
        }
        Ok(())
    }
}

/// The cluster of which each island of several sheets is, and of which of its parts.
fn places(mixed: &[Mixed]) -> HashMap<u32, (usize, usize)> {
    let mut place_of = HashMap::new();
    for (i, Mixed { parts, .. }) in mixed.iter().enumerate() {
        for (j, part) in parts.iter().enumerate() {
            place_of.extend(part.iter().map(|island| (*island, (i, j))));
        }
    }
    place_of
}

impl ClusterParts {
    fn new(graph: ClusterGraph, mixed: Vec<(u32, Vec<ClusterSheet>)>) -> Self {
        let mut parts = Self { graph, mixed, wanted: Vec::new(), alone: 0 };
        // Clusters of many sheets here and there are where small parts meet; all over, they are layers.
        let mut wanted = parts.large(|sheets| LEAST_PART.min(0.5 / sheets as f64));
        if wanted.len() <= parts.graph.clusters() / MANY {
            wanted = parts.large(|_| LEAST_PART);
        }
        let sheet = |(_, i, j): (bool, usize, usize)| &parts.mixed[i].1[j];
        wanted.sort_by(|a, b| a.0.cmp(&b.0).then_with(|| sheet(*a).by_size(sheet(*b))));
        parts.alone = wanted.iter().filter(|(joins, ..)| !joins).count();
        parts.wanted = wanted.into_iter().map(|(_, i, j)| (i, j)).collect();
        parts
    }

    /// Sheets but the first of each cluster that have at least a part of its vertices, as its number of
    /// sheets tells, or nothing of their own beside them: whether there is, the cluster and the sheet.
    fn large(&self, least: impl Fn(usize) -> f64) -> Vec<(bool, usize, usize)> {
        let mut large = Vec::new();
        for (i, (_, sheets)) in self.mixed.iter().enumerate() {
            let all: f64 = sheets.iter().map(|sheet| sheet.moments.count()).sum();
            let least = all * least(sheets.len());
            for (j, sheet) in sheets.iter().enumerate().skip(1) {
                let is_alone = self.neighbours(sheet).next().is_none();
                let count = sheet.moments.count();
                if count > 0.0 && (is_alone || (count > 1.0 && count >= least)) {
                    large.push((!is_alone, i, j));
                }
            }
        }
        large
    }

    /// Whether no cluster is of several sheets.
    pub fn is_empty(&self) -> bool {
        self.mixed.is_empty()
    }

    /// Number of new samples that parts shall have, for `samples` in all: as many as they need, but no more
    /// than [a part of them](MOST_OF_ALL), unless nothing of their own sheets is beside them.
    pub fn needed(&self, samples: usize) -> usize {
        self.wanted.len().min(self.alone.max(samples / MOST_OF_ALL).max(FEW))
    }

    /// Number of clusters that there shall be instead of `clusters`, where so many hold several sheets that
    /// not each of these could get one of `wanted` samples: so many fewer that they can. `None` where they
    /// can already, or where parts that want a sample are no more than one in [`MANY`] of `wanted`.
    pub fn fewer_clusters(&self, clusters: usize, wanted: usize) -> Option<usize> {
        let more = self.wanted.len();
        let fewer = (clusters as u128 * wanted as u128 / (clusters + more) as u128) as usize;
        (more > wanted / MANY && clusters + more > wanted).then_some(fewer.max(1))
    }

    /// Parts of mixed clusters that have samples, where at most `most` new ones are for so many clusters: the
    /// largest parts, unless sheets of many clusters are to share few samples.
    fn holders(&self, clusters: usize, most: usize) -> Holders {
        let none = self.mixed.iter().map(|(_, parts)| vec![false; parts.len()]).collect();
        let mut holders = Holders { keeps: vec![0; self.mixed.len()], new: none };
        if self.wanted.len() > most.max(clusters / MANY) {
            self.spread(most, &mut holders);
        } else {
            self.wanted.iter().take(most).for_each(|(i, j)| holders.new[*i][*j] = true);
        }
        holders
    }

    /// Gives samples to parts of which few islands beside have any: so all sheets get about as many.
    fn spread(&self, most: usize, holders: &mut Holders) {
        let mut has = vec![false; self.graph.len() as usize];
        for cluster in (0..self.graph.clusters() as u32).filter(|cluster| !self.is_mixed(*cluster)) {
            self.graph.each_island(cluster, |island| has[island as usize] = true);
        }
        let mut open: Vec<Vec<usize>> = vec![vec![0]; self.mixed.len()];
        self.wanted.iter().for_each(|(i, j)| open[*i].push(*j));
        let sheet = |i: usize, j: usize| &self.mixed[i].1[j];
        let served = |has: &[bool], i: usize, j: usize| {
            self.neighbours(sheet(i, j)).filter(|island| has[*island as usize]).count()
        };
        for (i, open) in open.iter_mut().enumerate() {
            let least = (0..open.len()).min_by_key(|at| served(&has, i, open[*at])).unwrap_or(0);
            holders.keeps[i] = open.swap_remove(least);
            sheet(i, holders.keeps[i]).islands.iter().for_each(|island| has[*island as usize] = true);
        }
        let rest = open.iter().enumerate().flat_map(|(i, open)| open.iter().map(move |j| (i, *j)));
        let mut rest: Vec<(usize, (usize, usize))> =
            rest.map(|(i, j)| (served(&has, i, j), (i, j))).collect();
        rest.sort_by(|(a, of_a), (b, of_b)| {
            a.cmp(b).then_with(|| sheet(of_a.0, of_a.1).by_size(sheet(of_b.0, of_b.1)))
        });
        rest.iter().take(most).for_each(|(_, (i, j))| holders.new[*i][*j] = true);
    }

    /// Islands of other clusters that a part is joined with.
    fn neighbours<'a>(&'a self, part: &'a ClusterSheet) -> impl Iterator<Item = u32> + 'a {
        part.islands.iter().flat_map(|island| self.graph.joined(*island)).copied()
    }

    /// Whether a cluster is one of several sheets.
    pub fn is_mixed(&self, cluster: u32) -> bool {
        self.mixed.binary_search_by_key(&cluster, |(mixed, _)| *mixed).is_ok()
    }

    /// Clusters, ascending, that would share a sample with others though that sample would be of several
    /// sheets, where the cut has become coarser: `becomes` is the sample of each, of `samples`.
    pub fn joining_sheets(&self, becomes: &[u32], samples: usize) -> Vec<u32> {
        let clusters = 0..self.graph.clusters() as u32;
        let (starts, members) = lists(samples, clusters.map(|cluster| (becomes[cluster as usize], cluster)));
        let joined = starts.par_windows(2).filter_map(|s| {
            let members = &members[s[0] as usize..s[1] as usize];
            let islands: Vec<u32> = members.iter().flat_map(|cluster| self.graph.islands(*cluster)).collect();
            (members.len() > 1 && self.graph.parts_among(&islands).is_some()).then(|| members.to_vec())
        });
        let mut joined: Vec<u32> = joined.flatten().collect();
        joined.sort_unstable();
        joined
    }

    /// Parts the clusters, with at most `most` new samples. Where the cut has become coarser meanwhile,
    /// `becomes` is the sample of each cluster now, which none of several sheets shares; `samples` are the
    /// samples' positions.
    pub fn part(self, samples: &[Vec3], becomes: Option<&[u32]>, most: usize) -> Parted {
        let of = |cluster: u32| becomes.map_or(cluster, |becomes| becomes[cluster as usize]);
        let mut given = GivenSamples::new(&self, samples, of, most);
        given.join_open(&self, samples, of);
        let GivenSamples { sample, moved, added, .. } = given;
        let mut seeds: Vec<u32> = self.mixed_islands().map(|island| sample[island as usize]).collect();
        seeds.sort_unstable();
        seeds.dedup();
        let (cluster_of, merged) = self.clusters_of(samples.len(), of);
        let mut mixed = vec![false; self.graph.clusters()];
        self.mixed.iter().for_each(|(cluster, _)| mixed[*cluster as usize] = true);
        let islands_of = self.islands_of(&sample, (&cluster_of, &merged), &mixed);
        let mut has_own = vec![false; samples.len() + added.len()];
        islands_of.keys().for_each(|sample| has_own[*sample as usize] = true);
        let becomes = becomes.map(<[u32]>::to_vec);
        let graph = self.graph;
        Parted {
            sample,
            cluster_of,
            becomes,
            has_own,
            islands_of,
            mixed,
            moved,
            added,
            seeds,
            beside: Vec::new(),
            graph,
        }
    }

    /// The islands of all clusters of several sheets.
    fn mixed_islands(&self) -> impl Iterator<Item = u32> {
        self.mixed.iter().flat_map(|(_, parts)| parts).flat_map(|part| &part.islands).copied()
    }

    /// Cluster of each of `samples` samples, and all clusters of those that have more than one.
    fn clusters_of(&self, samples: usize, of: impl Fn(u32) -> u32) -> (Vec<u32>, HashMap<u32, Vec<u32>>) {
        let mut cluster_of = vec![OPEN; samples];
        let mut merged: HashMap<u32, Vec<u32>> = HashMap::new();
        for cluster in 0..self.graph.clusters() as u32 {
            let known = &mut cluster_of[of(cluster) as usize];
            if *known == OPEN {
                *known = cluster;
            } else {
                merged.entry(of(cluster)).or_insert_with(|| vec![*known]).push(cluster);
            }
        }
        (cluster_of, merged)
    }

    /// The islands of samples that have more or fewer than their cluster, by the sample of each island.
    fn islands_of(
        &self,
        sample: &[u32],
        (cluster_of, merged): (&[u32], &HashMap<u32, Vec<u32>>),
        mixed: &[bool],
    ) -> HashMap<u32, Vec<u32>> {
        let whole = |sample: u32| {
            let one = [cluster_of[sample as usize]];
            let clusters = merged.get(&sample).map_or(&one[..], |clusters| clusters);
            clusters.iter().flat_map(|cluster| self.graph.islands(*cluster)).collect::<Vec<_>>()
        };
        let mut islands_of: HashMap<u32, Vec<u32>> =
            merged.keys().map(|sample| (*sample, whole(*sample))).collect();
        for island in self.mixed_islands() {
            let of_sample = sample[island as usize];
            let own = || match cluster_of.get(of_sample as usize) {
                Some(cluster) if !mixed[*cluster as usize] => whole(of_sample),
                _ => Vec::new(),
            };
            islands_of.entry(of_sample).or_insert_with(own).push(island);
        }
        islands_of
    }
}

/// Parts of mixed clusters that have samples.
struct Holders {
    /// The part of each cluster that keeps its sample.
    keeps: Vec<usize>,
    /// Whether each part of each cluster gets a new one.
    new: Vec<Vec<bool>>,
}

/// Sample of an island that has none yet.
const OPEN: u32 = u32::MAX;

/// The samples that parts of clusters are given.
struct GivenSamples {
    /// The sample of each island.
    sample: Vec<u32>,
    /// Samples that are moved, as in [`Parted`].
    moved: Vec<(u32, Vec3, Vec3)>,
    added: Vec<(u32, Vec3, Vec3)>,
    /// The parts that got none of their own: which of the mixed clusters, and which of its parts.
    open: Vec<(usize, usize)>,
}

impl GivenSamples {
    /// A part of each cluster keeps its sample, and as many others as may get new ones.
    fn new(parts: &ClusterParts, samples: &[Vec3], of: impl Fn(u32) -> u32, most: usize) -> Self {
        let first = samples.len() as u32;
        let holders = parts.holders(samples.len(), most);
        let graph = &parts.graph;
        let sample = (0..graph.len()).map(|island| of(graph.cluster(island))).collect();
        let mut given = Self { sample, moved: Vec::new(), added: Vec::new(), open: Vec::new() };
        for (i, (cluster, sheets)) in parts.mixed.iter().enumerate() {
            for (j, sheet) in sheets.iter().enumerate() {
                let (position, normal, _) = sheet.moments.representative();
                let of_part = if j == holders.keeps[i] {
                    given.moved.push((of(*cluster), position, normal));
                    of(*cluster)
                } else if holders.new[i][j] {
                    given.added.push((of(*cluster), position, normal));
                    first + given.added.len() as u32 - 1
                } else {
                    given.open.push((i, j));
                    OPEN
                };
                given.set(sheet, of_part);
            }
        }
        given
    }

    fn set(&mut self, sheet: &ClusterSheet, to: u32) {
        sheet.islands.iter().for_each(|island| self.sample[*island as usize] = to);
    }

    /// Joins each part without a sample of its own to the nearest sample that faces join it with; a part that
    /// faces join with none stays with its cluster.
    fn join_open(&mut self, parts: &ClusterParts, samples: &[Vec3], of: impl Fn(u32) -> u32) {
        let moved_to: HashMap<u32, Vec3> = self.moved.iter().map(|(sample, p, _)| (*sample, *p)).collect();
        while !self.open.is_empty() {
            let before = self.open.len();
            let mut joins = Vec::new();
            let mut open = std::mem::take(&mut self.open);
            open.retain(|(i, j)| {
                let sheet = &parts.mixed[*i].1[*j];
                let to = self.nearest(parts.neighbours(sheet), sheet, samples, &moved_to);
                joins.extend(to.map(|to| (sheet, to)));
                to.is_none()
            });
            joins.into_iter().for_each(|(sheet, to)| self.set(sheet, to));
            if open.len() == before {
                for (i, j) in open.drain(..) {
                    let (cluster, sheets) = &parts.mixed[i];
                    self.set(&sheets[j], of(*cluster));
                }
            }
            self.open = open;
        }
    }

    /// Sample among those of some islands that is nearest to the middle of a sheet, if these have any.
    fn nearest(
        &self,
        islands: impl Iterator<Item = u32>,
        sheet: &ClusterSheet,
        samples: &[Vec3],
        moved_to: &HashMap<u32, Vec3>,
    ) -> Option<u32> {
        let place = |sample: u32| match samples.get(sample as usize) {
            Some(p) => moved_to.get(&sample).copied().unwrap_or(*p),
            None => self.added[sample as usize - samples.len()].1,
        };
        let center = sheet.moments.mean().as_vec3();
        let nearer = |a: &u32, b: &u32| {
            let [p, q] = [*a, *b].map(place);
            let distance = |p: Vec3| p.distance_squared(center);
            distance(p).total_cmp(&distance(q)).then_with(|| by_place(p, q)).then(a.cmp(b))
        };
        let known = islands.map(|island| self.sample[island as usize]).filter(|sample| *sample != OPEN);
        known.min_by(nearer)
    }
}

impl Parted {
    /// The samples at which sheets meet, in one cluster or two, ascending.
    pub fn all_seeds(&self) -> Vec<u32> {
        let mut all = [&self.seeds[..], &self.beside].concat();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// Whether faces join any samples: they do not where they are a tangle.
    pub fn joins_any(&self) -> bool {
        !self.graph.is_empty()
    }

    /// Notes in `sample_of` which sample each vertex belongs to now.
    pub fn renumber(&self, islands: &Islands, sample_of: &mut [u32]) {
        sample_of.par_iter_mut().enumerate().for_each(|(vertex, sample)| {
            if vertex.is_multiple_of(SMALL_CHUNK) {
                looked_at(2 * size_of::<u32>() * SMALL_CHUNK);
            }
            let Some(mixed) = self.mixed.get(*sample as usize) else { return };
            if *mixed && let Some(island) = self.graph.number(*sample, islands.first_of(vertex as u32)) {
                *sample = self.sample[island as usize];
            } else if let Some(becomes) = &self.becomes {
                *sample = becomes[*sample as usize];
            }
        });
    }

    /// Visits the samples that faces join with `sample`; some of them several times.
    #[inline]
    pub fn each_joined(&self, sample: u32, mut visit: impl FnMut(u32)) {
        let mut of_island = |island: u32| {
            let others = self.graph.joined(island).iter().map(|island| self.sample[*island as usize]);
            others.filter(|other| *other != sample).for_each(&mut visit);
        };
        if self.has_own[sample as usize] {
            self.islands_of.get(&sample).into_iter().flatten().for_each(|island| of_island(*island));
        } else {
            self.graph.each_island(self.cluster_of[sample as usize], of_island);
        }
    }
}
