//! Vertices of a cluster that hang together by the model's faces, its *islands*; and those of them that faces
//! join across the clusters' borders.
//!
//! A cluster whose vertices are in a few islands is nothing special: clusters are cut out of the surface by
//! planes. It is one of two sheets if its islands are not joined by those around it either: see
//! [`ClusterGraph::parts`].

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;
use simod_model::mapped::{MapMut, looked_at};
use simod_model::scratch::Scratch;
use simod_model::{Error, Result, memory};

use super::ADVICE;
use super::twins::FoundTwins;
use crate::lists::lists;
use crate::sampling::placement::FACES_OF_A_JOB;

/// Largest number of links for each sample: beyond it, faces are a tangle that tells nothing. There may be
/// more of them on the way, while islands are still parts of larger ones.
const MOST_PER_SAMPLE: usize = 16;

/// Factor by which links may be more where samples are few: each of them may stand for many sheets.
const MORE_OF_FEW: usize = 4;

/// Links that are not tidied up yet.
const LINKS_AT_EASE: usize = 1 << 18;

/// Number of vertices, or links, that are looked at between two calls of [`looked_at`] for their mapped
/// files.
const FEW: usize = 1 << 14;

/// Links of each cluster that are remembered, as the next ones are probably among them.
const LATEST: usize = 4;

/// Links of a job that are remembered: more than are met along the border of a cluster.
const REMEMBERED: usize = 1 << 10;

/// Number of steps from island to island within which islands of a cluster are on one sheet.
const STEPS: usize = 4;

/// Islands, while faces come.
///
/// Memory: 32 bytes per sample, and 8 for each of at most 32 links per sample, mostly 6, or of a million,
/// whichever is more; a mapped temporary file of 4 bytes per vertex, and another one of 8 bytes for each link
/// that finds no room.
pub struct Islands {
    /// Distance of each vertex behind another one of its island; 0 for the first of an island.
    back: MapMut,
    latest: Vec<[[u32; 2]; LATEST]>,
    /// Vertices of different clusters that a face joins.
    links: Vec<[u32; 2]>,
    /// Number of links above which links that are there twice are removed, and the most links that are held.
    limit: usize,
    most: usize,
    tangled: bool,
    /// Links that found no room, and why they could not be written, if so.
    spilled: Spilled,
    /// Findings of each job in the faces that are taken at once.
    jobs: Vec<FacesJob>,
}

/// Links in a temporary file.
struct Spilled {
    folder: PathBuf,
    file: Option<Scratch>,
    count: u64,
    failed: Option<Error>,
}

impl Spilled {
    fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), file: None, count: 0, failed: None }
    }

    fn take(&mut self) -> Self {
        let none = Self::new(&self.folder);
        std::mem::replace(self, none)
    }

    fn push(&mut self, links: &[[u32; 2]]) {
        let mut write = || -> Result<()> {
            let file = match &self.file {
                Some(file) => file,
                None => self.file.insert(Scratch::new(&self.folder, ADVICE)?),
            };
            file.write_at(cast_slice(links), self.count * size_of::<[u32; 2]>() as u64)
        };
        if let Err(e) = write() {
            self.failed.get_or_insert(e);
        }
        self.count += links.len() as u64;
    }

    /// Visits all links, some at a time, as long as `visit` says so.
    fn each(&mut self, mut visit: impl FnMut(&[[u32; 2]]) -> Result<bool>) -> Result<()> {
        if let Some(e) = self.failed.take() {
            return Err(e);
        }
        let Some(file) = &self.file else { return Ok(()) };
        let (mut at, mut some) = (0, Vec::new());
        while at < self.count {
            some.resize((LINKS_AT_EASE as u64).min(self.count - at) as usize, [0; 2]);
            file.read_at(cast_slice_mut(&mut some), at * size_of::<[u32; 2]>() as u64)?;
            if !visit(&some)? {
                break;
            }
            at += some.len() as u64;
        }
        Ok(())
    }
}

impl Islands {
    /// Islands of single vertices, but for those that are known to be at one place. `sample_of` is the
    /// cluster of each. A temporary file, should it be needed, is made in `folder`.
    pub fn new(twins: FoundTwins, sample_of: &[u32], samples: usize, folder: &Path) -> Self {
        let mut islands = Self {
            back: twins.back,
            latest: vec![[[0; 2]; LATEST]; samples],
            links: Vec::new(),
            limit: LINKS_AT_EASE,
            most: most_links(samples.max(64)),
            tangled: false,
            spilled: Spilled::new(folder),
            jobs: Vec::new(),
        };
        if twins.count > 0 {
            islands.join_twins(sample_of);
        }
        islands
    }

    /// Twins of one cluster are of one island, others are linked.
    fn join_twins(&mut self, sample_of: &[u32]) {
        for vertex in 0..sample_of.len() as u32 {
            let back = &mut cast_slice_mut::<_, u32>(&mut self.back)[vertex as usize];
            if *back != 0 {
                let twin = vertex - std::mem::take(back);
                self.join((twin, sample_of[twin as usize]), (vertex, sample_of[vertex as usize]));
            }
            if vertex.is_multiple_of(FEW as u32) {
                looked_at(2 * size_of::<u32>() * FEW);
            }
        }
    }

    /// Takes faces, in any order. `clusters_of` a face's corners are nothing if there is no such vertex; such
    /// a face joins nothing, nor does one with a cluster that there is not. Takes jobs of the thread pool.
    ///
    /// Memory: for each job 8 KiB, 24 bytes for each face across the border of clusters, and 12 for each link
    /// that is found, of which such a face has three at most: as much as it was for the faces that were most.
    pub fn take(&mut self, faces: &[[u32; 3]], clusters_of: impl Fn([u32; 3]) -> Option<[u32; 3]> + Sync) {
        if self.tangled {
            return;
        }
        let known = self.latest.len() as u32;
        let clusters_of = |corners: [u32; 3]| {
            clusters_of(corners).filter(|clusters| clusters.iter().all(|cluster| *cluster < known))
        };
        let (mut jobs, count) = (std::mem::take(&mut self.jobs), faces.len().div_ceil(FACES_OF_A_JOB));
        jobs.resize_with(count.max(jobs.len()), FacesJob::default);
        let sets = DisjointSets::new(&mut self.back);
        let used = &mut jobs[..count];
        let unite = |(job, faces): (&mut FacesJob, &[[u32; 3]])| job.unite(sets, faces, clusters_of);
        used.par_iter_mut().zip(faces.par_chunks(FACES_OF_A_JOB)).for_each(unite);
        // Links are of fewer vertices once all islands of these faces are joined.
        used.par_iter_mut().for_each(|job| job.link(sets));
        used.iter().flat_map(|job| &job.links).for_each(|link| self.link(*link));
        self.jobs = jobs;
    }

    /// Two islands of different clusters are joined.
    #[inline]
    fn link(&mut self, (cluster, link): VertexLink) {
        let latest = &mut self.latest[cluster as usize];
        if !latest.contains(&link) {
            let [a, b, c, _] = *latest;
            *latest = [link, a, b, c];
            self.links.push(link);
            if self.links.len() > self.limit {
                self.tidy();
            }
        }
    }

    /// Two vertices, each of a cluster, are next to each other.
    #[inline]
    pub fn join(&mut self, (u, a): (u32, u32), (v, b): (u32, u32)) {
        let known = self.latest.len() as u32;
        if self.tangled || a >= known || b >= known {
            return;
        }
        let sets = DisjointSets::new(&mut self.back);
        let (u, v) = (sets.first(u), sets.first(v));
        if a == b {
            sets.unite(u, v);
        } else {
            self.link(link((u, a), (v, b)));
        }
    }

    /// The first vertex of a vertex' island.
    #[inline]
    pub fn first(&mut self, vertex: u32) -> u32 {
        DisjointSets::new(&mut self.back).first(vertex)
    }

    /// The first vertex of a vertex' island, on any thread; no path is shortened.
    pub fn first_of(&self, mut vertex: u32) -> u32 {
        let back: &[u32] = cast_slice(&self.back);
        while back[vertex as usize] != 0 {
            vertex -= back[vertex as usize];
        }
        vertex
    }

    /// Removes links that are there twice, by the islands as they are now.
    fn once_each(&self, links: &mut Vec<[u32; 2]>) {
        // Links are in about the vertices' order.
        let share = self.back.len() / links.len().max(1);
        links.par_chunks_mut(FEW).for_each(|some| {
            for link in some.iter_mut() {
                *link = link.map(|vertex| self.first_of(vertex));
                link.sort_unstable();
            }
            looked_at(share * some.len());
        });
        links.par_sort_unstable();
        links.dedup();
    }

    /// Makes room for further links.
    fn tidy(&mut self) {
        let mut links = std::mem::take(&mut self.links);
        self.once_each(&mut links);
        if links.len() > self.most {
            self.spilled.push(&links);
            links.clear();
        }
        self.limit = 2 * links.len().max(LINKS_AT_EASE / 2);
        self.links = links;
    }

    /// Goes on with coarser clusters, of which `sample_of` has that of each vertex: islands that are linked
    /// within one are joined. To be called when the [graph](Self::graph) is known.
    pub fn merge(&mut self, sample_of: &[u32], clusters: usize) {
        let sets = DisjointSets::new(&mut self.back);
        self.links.retain(|[u, v]| {
            let is_within = sample_of[*u as usize] == sample_of[*v as usize];
            if is_within {
                sets.unite(sets.first(*u), sets.first(*v));
            }
            !is_within
        });
        self.latest = vec![[[0; 2]; LATEST]; clusters];
    }

    /// Two vertices are of one island of a cluster, as is known of other faces.
    pub fn unite_both(&mut self, u: u32, v: u32) {
        let sets = DisjointSets::new(&mut self.back);
        sets.unite(sets.first(u), sets.first(v));
    }

    /// Two vertices of different clusters are joined, as is known of other faces.
    pub fn add_link(&mut self, link: [u32; 2]) {
        if !self.tangled {
            self.links.push(link);
            if self.links.len() > self.limit {
                self.tidy();
            }
        }
    }

    /// Visits all links, some at a time: each once among these. No link is left then.
    ///
    /// # Errors
    /// The temporary file could not be written, or read; `visit` failed.
    pub fn drain_links(&mut self, mut visit: impl FnMut(&[[u32; 2]]) -> Result<()>) -> Result<()> {
        let mut links = std::mem::take(&mut self.links);
        self.once_each(&mut links);
        visit(&links)?;
        self.spilled.take().each(|some| {
            links.clear();
            links.extend_from_slice(some);
            self.once_each(&mut links);
            visit(&links).map(|()| true)
        })
    }

    /// Whether there are more links than a graph may have, by the islands as they are now: that they are a
    /// tangle, or that much of one place is not known to be one. To be called when all faces are known.
    ///
    /// # Errors
    /// The temporary file could not be written, or read.
    pub fn is_overfull(&mut self) -> Result<bool> {
        if self.links.len() as u64 + self.spilled.count <= self.most as u64 {
            return Ok(false);
        }
        let (links, mut spilled) = (std::mem::take(&mut self.links), self.spilled.take());
        self.links = self.gathered(links, &mut spilled)?;
        let is_overfull = self.links.len() > self.most;
        if is_overfull {
            // Not all of the file may have been read.
            self.spilled = spilled;
        }
        Ok(is_overfull)
    }

    /// Links, with those that found no room, each once: all of them, or more than a graph may have.
    fn gathered(&self, mut links: Vec<[u32; 2]>, spilled: &mut Spilled) -> Result<Vec<[u32; 2]>> {
        self.once_each(&mut links);
        spilled.each(|some| {
            links.extend_from_slice(some);
            if links.len() > self.most {
                self.once_each(&mut links);
            }
            // Islands are complete: links only become more.
            Ok(links.len() <= self.most)
        })?;
        self.once_each(&mut links);
        Ok(links)
    }

    /// Graph of all islands that are joined with others, unless they are a tangle: whatever order faces came
    /// in. `sample_of` is the cluster of each vertex.
    ///
    /// # Errors
    /// The temporary file could not be written, or read.
    pub fn graph(&mut self, sample_of: &[u32]) -> Result<ClusterGraph> {
        let (links, mut spilled) = (std::mem::take(&mut self.links), self.spilled.take());
        let mut links = self.gathered(links, &mut spilled)?;
        if links.len() > self.most {
            (links, self.tangled) = (Vec::new(), true);
        }
        // Links ascend by their first ends, so that samples are looked up in about the vertices' order; two
        // look-ups a link.
        let (share, mut left) = (size_of_val(sample_of) / links.len().max(1), 2 * FEW);
        let graph = ClusterGraph::new(&links, self.latest.len(), |first| {
            left -= 1;
            if left == 0 {
                left = 2 * FEW;
                looked_at(share * FEW);
            }
            sample_of[first as usize]
        });
        self.links = links;
        Ok(graph)
    }
}

/// Largest number of links of so many samples.
fn most_links(samples: usize) -> usize {
    let most = MOST_PER_SAMPLE * samples;
    most.max((MORE_OF_FEW * most).min(2 * LINKS_AT_EASE))
}

/// Two vertices of different clusters that are joined, that of the lower cluster first; and this cluster.
type VertexLink = (u32, [u32; 2]);

/// The link between two vertices, each of a cluster.
#[inline]
fn link((u, a): (u32, u32), (v, b): (u32, u32)) -> VertexLink {
    if a < b { (a, [u, v]) } else { (b, [v, u]) }
}

/// Findings of one job in some faces.
struct FacesJob {
    /// The faces with corners in several clusters, and these.
    crossing: Vec<([u32; 3], [u32; 3])>,
    /// Links, mostly each once.
    links: Vec<VertexLink>,
    /// Some of these links, at places that their vertices tell.
    remembered: [[u32; 2]; REMEMBERED],
}

impl Default for FacesJob {
    fn default() -> Self {
        Self { crossing: Vec::new(), links: Vec::new(), remembered: [[0; 2]; REMEMBERED] }
    }
}

impl FacesJob {
    /// Makes one island of those corners of each face that are of one cluster.
    fn unite(
        &mut self,
        sets: DisjointSets<'_>,
        faces: &[[u32; 3]],
        clusters_of: impl Fn([u32; 3]) -> Option<[u32; 3]>,
    ) {
        self.crossing.clear();
        for corners in faces {
            if let Some(clusters) = clusters_of(*corners)
                && sets.unite_corners(*corners, clusters)
            {
                self.crossing.push((*corners, clusters));
            }
        }
    }

    /// Finds the links between those that are of several.
    fn link(&mut self, sets: DisjointSets<'_>) {
        self.links.clear();
        self.remembered.fill([0; 2]);
        for (corners, [a, b, c]) in &self.crossing {
            let [u, v, w] = corners.map(|vertex| sets.first(vertex));
            for ((u, a), (v, b)) in [((u, *a), (v, *b)), ((v, *b), (w, *c)), ((w, *c), (u, *a))] {
                if a == b {
                    continue;
                }
                let (cluster, [u, v]) = link((u, a), (v, b));
                let place = u.wrapping_mul(31).wrapping_add(v) as usize % REMEMBERED;
                if std::mem::replace(&mut self.remembered[place], [u, v]) != [u, v] {
                    self.links.push((cluster, [u, v]));
                }
            }
        }
    }
}

/// Islands as disjoint sets of vertices (R. E. Tarjan, *Efficiency of a good but not linear set union
/// algorithm*, 1975), each known by its first vertex, to which the steps back of its vertices lead. Any
/// number of threads may unite them at once: a step always leads to an earlier vertex of the same set, and
/// where there is one, there will be one. So what a thread has not seen yet costs it further steps; and a
/// first vertex gets its step once, so that in the end the least one is left, whatever the threads do.
#[derive(Clone, Copy)]
struct DisjointSets<'a> {
    /// Distance of each vertex behind another one of its island; 0 for the first of an island.
    back: &'a [AtomicU32],
}

impl<'a> DisjointSets<'a> {
    fn new(back: &'a mut MapMut) -> Self {
        Self { back: memory::atomics(cast_slice_mut(&mut back[..])) }
    }

    #[inline]
    fn back(self, vertex: u32) -> u32 {
        self.back[vertex as usize].load(Relaxed)
    }

    /// Joins corners of a face that are of one cluster. Returns whether the face has corners of several
    /// clusters.
    #[inline]
    fn unite_corners(self, corners: [u32; 3], [a, b, c]: [u32; 3]) -> bool {
        let [u, v, w] = corners;
        if a == b && b == c {
            if !self.are_plainly_one(corners) {
                let first = self.unite(self.first(u), self.first(v));
                self.unite(first, self.first(w));
            }
            return false;
        }
        for ((u, a), (v, b)) in [((u, a), (v, b)), ((v, b), (w, c)), ((w, c), (u, a))] {
            if a == b {
                self.unite(self.first(u), self.first(v));
            }
        }
        true
    }

    /// Whether all three corners are known to be of one island: each is linked to the same vertex of it.
    #[inline]
    fn are_plainly_one(self, corners: [u32; 3]) -> bool {
        let [u, v, w] = corners.map(|corner| corner - self.back(corner));
        u == v && v == w
    }

    /// The islands of which these were the first vertices are one, whose first vertex it gives.
    #[inline]
    fn unite(self, mut u: u32, mut v: u32) -> u32 {
        while u != v {
            let (low, high) = (u.min(v), u.max(v));
            if self.back[high as usize].compare_exchange(0, high - low, Relaxed, Relaxed).is_ok() {
                return low;
            }
            // Another thread has united it with one before it meanwhile.
            (u, v) = (self.first(u), self.first(v));
        }
        u
    }

    /// The first vertex of a vertex' island.
    #[inline]
    fn first(self, mut vertex: u32) -> u32 {
        loop {
            let step = self.back(vertex);
            if step == 0 {
                return vertex;
            }
            let before = vertex - step;
            let next = self.back(before);
            if next == 0 {
                return before;
            }
            self.back[vertex as usize].store(step + next, Relaxed);
            vertex = before - next;
        }
    }
}

/// Islands that faces join with others. The first island of each cluster has the cluster's number, all
/// further ones come behind the clusters.
///
/// Memory: 9 bytes per sample, and 8 more and 16 for each of at most 32 links per sample while it is made,
/// mostly 6, or of half a million, whichever is more.
pub struct ClusterGraph {
    /// The first vertex of one island of each cluster; [`NONE`] where no island is joined with others.
    firsts: Vec<u32>,
    /// The cluster and the first vertex of each further island, ascending.
    further: Vec<[u32; 2]>,
    /// Whether each cluster has islands besides its first.
    has_further: Vec<bool>,
    starts: Vec<u32>,
    joined: Vec<u32>,
}

/// No vertex.
const NONE: u32 = u32::MAX;

/// A cluster of several sheets: the islands of each.
pub struct Mixed {
    /// The cluster.
    pub cluster: u32,
    /// Numbers of islands.
    pub parts: Vec<Vec<u32>>,
}

impl ClusterGraph {
    /// The graph of links between islands, which are known by their first vertices.
    fn new(links: &[[u32; 2]], clusters: usize, mut cluster_of: impl FnMut(u32) -> u32) -> Self {
        let mut graph = Self {
            firsts: vec![NONE; clusters],
            further: Vec::new(),
            has_further: vec![false; clusters],
            starts: Vec::new(),
            joined: Vec::new(),
        };
        // Ends of links that are further islands, which have no number yet.
        let mut later: Vec<(u32, usize)> = Vec::new();
        let mut pairs: Vec<[u32; 2]> = Vec::with_capacity(links.len());
        for (at, link) in links.iter().enumerate() {
            let mut pair = link.map(&mut cluster_of);
            for (end, (first, cluster)) in link.iter().zip(&mut pair).enumerate() {
                let known = &mut graph.firsts[*cluster as usize];
                if *known == NONE {
                    *known = *first;
                } else if *known != *first {
                    later.push((at as u32, end));
                    graph.further.push([*cluster, *first]);
                }
            }
            pairs.push(pair);
        }
        graph.further.par_sort_unstable();
        graph.further.dedup();
        graph.further.iter().for_each(|[cluster, _]| graph.has_further[*cluster as usize] = true);
        for (at, end) in later {
            let (pair, link) = (&mut pairs[at as usize], &links[at as usize]);
            pair[end] = graph.number(pair[end], link[end]).unwrap_or_default();
        }

        let count = clusters + graph.further.len();
        let (mut starts, mut joined) = lists(count, pairs.iter().flat_map(|[a, b]| [(*a, *b), (*b, *a)]));
        drop(pairs);
        keep_once(&mut starts, &mut joined);
        Self { starts, joined, ..graph }
    }

    /// The number of the island of a cluster with this first vertex.
    pub fn number(&self, cluster: u32, first: u32) -> Option<u32> {
        if self.firsts[cluster as usize] == first {
            return Some(cluster);
        }
        let place = self.further.binary_search(&[cluster, first]).ok()?;
        Some((self.firsts.len() + place) as u32)
    }

    /// The cluster of an island.
    pub fn cluster(&self, island: u32) -> u32 {
        let further = (island as usize).checked_sub(self.firsts.len());
        further.map_or(island, |place| self.further[place][0])
    }

    /// Number of clusters.
    pub fn clusters(&self) -> usize {
        self.firsts.len()
    }

    /// Whether no islands are joined.
    pub fn is_empty(&self) -> bool {
        self.joined.is_empty()
    }

    /// Number of islands, first and further ones: the bound of their numbers.
    pub fn len(&self) -> u32 {
        (self.firsts.len() + self.further.len()) as u32
    }

    /// The islands of a cluster that are joined with others.
    pub fn islands(&self, cluster: u32) -> impl Iterator<Item = u32> + '_ {
        let first = self.firsts.get(cluster as usize).filter(|first| **first != NONE).map(|_| cluster);
        let (mut start, mut count) = (0, 0);
        if self.has_further.get(cluster as usize) == Some(&true) {
            start = self.further.partition_point(|[of, _]| *of < cluster);
            count = self.further[start..].iter().take_while(|[of, _]| *of == cluster).count();
        }
        let begin = (self.firsts.len() + start) as u32;
        first.into_iter().chain(begin..begin + count as u32)
    }

    /// Visits the islands of a cluster that are joined with others.
    #[inline]
    pub fn each_island(&self, cluster: u32, mut visit: impl FnMut(u32)) {
        if self.has_further[cluster as usize] {
            self.islands(cluster).for_each(visit);
        } else if self.firsts[cluster as usize] != NONE {
            visit(cluster);
        }
    }

    /// The islands that an island is joined with.
    pub fn joined(&self, island: u32) -> &[u32] {
        &self.joined[self.starts[island as usize] as usize..self.starts[island as usize + 1] as usize]
    }

    /// The clusters of several islands, ascending.
    pub fn several(&self) -> Vec<u32> {
        let mut several: Vec<u32> = self.further.iter().map(|[cluster, _]| *cluster).collect();
        several.dedup();
        several
    }

    /// Clusters of which not all islands are joined by others around: those of several sheets, ascending.
    pub fn parts(&self) -> Vec<Mixed> {
        self.several().into_par_iter().filter_map(|cluster| self.parts_of(cluster)).collect()
    }

    fn parts_of(&self, cluster: u32) -> Option<Mixed> {
        let parts = self.parts_among(&self.islands(cluster).collect::<Vec<_>>())?;
        Some(Mixed { cluster, parts })
    }

    /// Parts of several islands that are not all joined by others around; `None` if they are one.
    pub fn parts_among(&self, islands: &[u32]) -> Option<Vec<Vec<u32>>> {
        let mut parts: Vec<Vec<u32>> = Vec::new();
        for island in islands {
            if parts.iter().any(|part| part.contains(island)) {
                continue;
            }
            // Islands that are met from an island of a part are of the same part: so it does not matter which
            // is looked at first.
            let (mut part, mut at) = (vec![*island], 0);
            while at < part.len() && part.len() < islands.len() {
                let of_cluster = |island: &u32| islands.contains(island);
                let each_joined = |island, visit: &mut dyn FnMut(u32)| {
                    self.joined(island).iter().copied().for_each(visit);
                };
                let met = met_within(part[at], usize::MAX, each_joined, |met| {
                    met.iter().copied().filter(of_cluster).count() == islands.len()
                });
                let new = met.into_iter().filter(of_cluster).filter(|island| !part.contains(island));
                part.extend(new.collect::<Vec<_>>());
                at += 1;
            }
            if part.len() == islands.len() {
                return None;
            }
            part.sort_unstable();
            parts.push(part);
        }
        (parts.len() > 1).then_some(parts)
    }
}

/// Nodes of a graph within [`STEPS`] of `start`, itself included, nearer ones first: at most `most`, and no
/// farther than until the nodes that were met `are_enough`. `each_joined` visits the nodes that are joined
/// with one.
pub fn met_within(
    start: u32,
    most: usize,
    each_joined: impl Fn(u32, &mut dyn FnMut(u32)),
    are_enough: impl Fn(&[u32]) -> bool,
) -> Vec<u32> {
    let (mut met, mut from) = (vec![start], 0);
    for _ in 0..STEPS {
        let to = met.len();
        for i in from..to {
            each_joined(met[i], &mut |other| {
                if met.len() < most && !met.contains(&other) {
                    met.push(other);
                }
            });
        }
        if are_enough(&met) {
            break;
        }
        from = to;
    }
    met
}

/// Leaves each island in the list of another one once.
fn keep_once(starts: &mut [u32], joined: &mut Vec<u32>) {
    let count = starts.len() - 1;
    // The island by which each one was met last.
    let mut met = vec![NONE; count];
    let (mut kept, mut from) = (0, 0);
    for island in 0..count {
        let to = starts[island + 1] as usize;
        for at in from..to {
            let other = joined[at];
            if std::mem::replace(&mut met[other as usize], island as u32) != island as u32 {
                joined[kept] = other;
                kept += 1;
            }
        }
        starts[island + 1] = kept as u32;
        from = to;
    }
    joined.truncate(kept);
}

#[cfg(test)]
mod tests {
    use super::super::twins::Twins;
    use super::*;
    use glam::DVec3;

    fn no_twins(vertices: usize) -> FoundTwins {
        let mut twins = Twins::new(0, 1, &std::env::temp_dir()).expect("a file");
        twins.take(&vec![DVec3::ZERO; vertices]).expect("room");
        twins.finish().expect("a file")
    }

    /// Islands of faces over vertices whose clusters are given.
    fn graph(sample_of: &[u32], samples: usize, faces: &[[u32; 3]]) -> ClusterGraph {
        let mut islands = Islands::new(no_twins(sample_of.len()), sample_of, samples, &std::env::temp_dir());
        islands.take(faces, |face| Some(face.map(|v| sample_of[v as usize])));
        assert!(!islands.tangled);
        islands.graph(sample_of).expect("a file")
    }

    fn first(graph: &ClusterGraph, island: u32) -> u32 {
        let further = (island as usize).checked_sub(graph.firsts.len());
        further.map_or_else(|| graph.firsts[island as usize], |place| graph.further[place][1])
    }

    /// A strip of quads along x of two rows of vertices: `first + 2 i` and `first + 2 i + 1`.
    fn strip(first: u32, length: u32) -> Vec<[u32; 3]> {
        (0..length - 1)
            .flat_map(|i| {
                let a = first + 2 * i;
                [[a, a + 2, a + 1], [a + 1, a + 2, a + 3]]
            })
            .collect()
    }

    #[test]
    fn two_strips_in_the_same_clusters_are_two_parts_of_each() {
        let faces = [strip(0, 12), strip(24, 12)].concat();
        // Three columns to a cluster, of both strips.
        let sample_of: Vec<u32> = (0..48).map(|v| v % 24 / 6).collect();
        let graph = graph(&sample_of, 4, &faces);
        let parts = graph.parts();
        assert_eq!(parts.iter().map(|m| m.cluster).collect::<Vec<_>>(), [0, 1, 2, 3]);
        for mixed in parts {
            let firsts: Vec<Vec<u32>> =
                mixed.parts.iter().map(|p| p.iter().map(|i| first(&graph, *i) / 24).collect()).collect();
            assert_eq!(firsts, [[0], [1]]);
        }
    }

    #[test]
    fn islands_that_others_around_join_are_of_one_part() {
        let faces = strip(0, 12);
        // The strip leaves cluster 0 and comes back.
        let sample_of: Vec<u32> = (0..24).map(|v| u32::from((8..16).contains(&v))).collect();
        let graph = graph(&sample_of, 2, &faces);
        assert_eq!((graph.firsts.len(), &graph.further[..]), (2, &[[0, 16]][..]));
        assert_eq!([0, 1, 2].map(|island| graph.joined(island).to_vec()), [vec![1], vec![0, 2], vec![1]]);
        assert_eq!([0, 1].map(|cluster| graph.islands(cluster).collect::<Vec<_>>()), [vec![0, 2], vec![1]]);
        assert!(graph.parts().is_empty());
    }

    /// Faces of several jobs, which unite and link the same vertices at once, and the same ones by one.
    #[test]
    fn whoever_unites_them_at_once_islands_are_the_same() {
        let random = |i: u32| i.wrapping_mul(2_654_435_761) >> 7;
        let vertices = 20_000;
        let sample_of: Vec<u32> = (0..vertices).map(|v| v / 30).collect();
        let samples = vertices.div_ceil(30) as usize;
        // Faces come in no order, each of even vertices alone, or of odd ones: two islands of a cluster.
        let face = |i: u32| [0, 1, 2].map(|k| random(i) % (vertices - 12) + random(3 * i + k) % 6 * 2);
        let faces: Vec<[u32; 3]> = (0..9 * FACES_OF_A_JOB as u32 + 5).map(face).collect();
        let threads = rayon::ThreadPoolBuilder::new().num_threads(4).build().expect("threads");
        let at_once = threads.install(|| graph(&sample_of, samples, &faces));
        let mut islands = Islands::new(no_twins(sample_of.len()), &sample_of, samples, &std::env::temp_dir());
        for face in faces.iter().rev() {
            islands.take(&[*face], |face| Some(face.map(|v| sample_of[v as usize])));
        }
        let one_by_one = islands.graph(&sample_of).expect("a file");
        let joined = |graph: &ClusterGraph| -> Vec<Vec<[u32; 2]>> {
            let islands = (0..graph.len()).map(|island| {
                let of = |other: &u32| [graph.cluster(*other), first(graph, *other)];
                let mut joined: Vec<[u32; 2]> = graph.joined(island).iter().map(of).collect();
                joined.push([graph.cluster(island), first(graph, island)]);
                joined.sort_unstable();
                joined
            });
            let mut all: Vec<_> = islands.collect();
            all.sort_unstable();
            all
        };
        assert!(at_once.further.len() >= samples);
        assert_eq!(joined(&at_once), joined(&one_by_one));
    }

    #[test]
    fn a_tangle_is_noticed() {
        let sample_of: Vec<u32> = (0..400).collect();
        let mut islands = Islands::new(no_twins(400), &sample_of, 400, &std::env::temp_dir());
        for u in 0..400 {
            (0..u).for_each(|v| islands.join((u, u), (v, v)));
        }
        let graph = islands.graph(&sample_of).expect("a file");
        assert!(graph.joined.is_empty() && islands.tangled);
    }

    /// Two rows of vertices, each a cluster, whose links come before the faces that make an island of each
    /// row.
    #[test]
    fn links_that_find_no_room_until_islands_are_whole_are_no_tangle() {
        let pairs = LINKS_AT_EASE as u32 + 1000;
        let sample_of: Vec<u32> = (0..2 * pairs).map(|v| v % 2).collect();
        let of = |vertex: u32| (vertex, vertex % 2);
        let linked = || {
            let twins = no_twins(sample_of.len());
            let mut islands = Islands::new(twins, &sample_of, 2, &std::env::temp_dir());
            (0..pairs).for_each(|i| islands.join(of(2 * i), of(2 * i + 1)));
            assert!(islands.spilled.count > 0);
            islands
        };
        let mut one = linked();
        (2..2 * pairs).for_each(|vertex| one.join(of(vertex - 2), of(vertex)));
        // Another set of islands has found the faces that make the islands, and is told of the links.
        let (mut two, mut from) =
            (Islands::new(no_twins(sample_of.len()), &sample_of, 2, &std::env::temp_dir()), linked());
        (2..2 * pairs).for_each(|vertex| two.unite_both(vertex, vertex - 2));
        let mut count = 0;
        let take = |links: &[[u32; 2]]| {
            count += links.len();
            links.iter().for_each(|link| two.add_link(*link));
            Ok(())
        };
        from.drain_links(take).expect("a file");
        assert_eq!(count, pairs as usize);
        for islands in [&mut one, &mut two] {
            assert!(!islands.is_overfull().expect("a file"));
            let graph = islands.graph(&sample_of).expect("a file");
            assert!(!islands.tangled && graph.further.is_empty());
            assert_eq!((graph.joined(0), graph.joined(1)), (&[1][..], &[0][..]));
        }
        // Links without those faces are a tangle.
        let mut tangle = linked();
        assert!(tangle.is_overfull().expect("a file"));
        assert!(tangle.graph(&sample_of).expect("a file").joined.is_empty() && tangle.tangled);
    }
}
