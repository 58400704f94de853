//! Which vertices of each cluster hang together by the model's faces, and which of these *islands* the faces join across
//! the clusters' borders.
//!
//! A cluster whose vertices are in a few islands is nothing special: clusters are cut out of the surface by planes. It is one
//! of two sheets if its islands are not joined by those around it either: see [`Graph::parts`].

use std::path::Path;

use bytemuck::{cast_slice, cast_slice_mut};
use memmap2::MmapMut;
use rayon::prelude::*;

use super::ADVICE;
use crate::Result;
use crate::scratch::Scratch;

/// Most links for each sample: beyond it, faces are a tangle that tells nothing.
const MOST_PER_SAMPLE: usize = 16;

/// Links that are not tidied up yet.
const LINKS_AT_EASE: usize = 1 << 18;

/// Links of each cluster that are remembered, as the next ones are probably among them.
const LATEST: usize = 4;

/// Islands of a cluster that so many steps from island to island join are on one sheet.
const STEPS: usize = 4;

/// Islands, while faces come.
///
/// Memory: 32 bytes per sample, and 8 for each of at most 32 links per sample, mostly 6; a mapped temporary file of 4 bytes per vertex.
pub struct Islands {
    /// For each vertex, how far before it another one of its island is; 0 for the first of an island.
    back: MmapMut,
    latest: Vec<[[u32; 2]; LATEST]>,
    /// Vertices of different clusters that a face joins.
    links: Vec<[u32; 2]>,
    /// How many links there may be until each is looked for but once, and at most.
    limit: usize,
    most: usize,
    tangled: bool,
}

impl Islands {
    /// Each vertex by itself. The file goes to `folder`.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn new(vertices: usize, samples: usize, folder: &Path) -> Result<Self> {
        let file = Scratch::new(folder, ADVICE)?;
        // Written, so that there is room on the disk for what is mapped.
        let zeros = vec![0u8; 1 << 20];
        let bytes = (vertices * size_of::<u32>()) as u64;
        for start in (0..bytes).step_by(zeros.len()) {
            file.write_at(&zeros[..zeros.len().min((bytes - start) as usize)], start)?;
        }
        Ok(Self {
            back: file.map_mut()?,
            latest: vec![[[0; 2]; LATEST]; samples],
            links: Vec::new(),
            limit: LINKS_AT_EASE,
            most: MOST_PER_SAMPLE * samples.max(64),
            tangled: false,
        })
    }

    /// Takes a face: its corners, and the cluster of each; a cluster that there is not stands for none.
    #[inline]
    pub fn take(&mut self, corners: [u32; 3], clusters: [u32; 3]) {
        let known = self.latest.len() as u32;
        let [a, b, c] = clusters;
        if self.tangled || a >= known || b >= known || c >= known {
            return;
        }
        let [mut u, mut v, mut w] = corners.map(|corner| self.first(corner));
        if a == b {
            u = self.unite(u, v);
            v = u;
        }
        if b == c {
            v = self.unite(v, w);
            w = v;
            u = if a == b { v } else { u };
        }
        if c == a && b != c {
            u = self.unite(u, w);
            w = u;
        }
        if a != b {
            self.link((u, a), (v, b));
        }
        if c != a {
            self.link((u, a), (w, c));
        }
        if a != b && b != c && c != a {
            self.link((v, b), (w, c));
        }
    }

    /// Two islands are one, whose first vertex it gives.
    #[inline]
    fn unite(&mut self, u: u32, v: u32) -> u32 {
        if u == v {
            return u;
        }
        let (low, high) = (u.min(v), u.max(v));
        cast_slice_mut(&mut self.back)[high as usize] = high - low;
        low
    }

    /// Two islands of different clusters are joined.
    #[inline]
    fn link(&mut self, (u, a): (u32, u32), (v, b): (u32, u32)) {
        let (at, link) = if a < b { (a, [u, v]) } else { (b, [v, u]) };
        let latest = &mut self.latest[at as usize];
        if !latest.contains(&link) {
            latest.rotate_right(1);
            latest[0] = link;
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
        let (u, v) = (self.first(u), self.first(v));
        if a == b {
            self.unite(u, v);
        } else {
            self.link((u, a), (v, b));
        }
    }

    /// The first vertex of a vertex' island.
    #[inline]
    pub fn first(&mut self, mut vertex: u32) -> u32 {
        let back: &mut [u32] = cast_slice_mut(&mut self.back);
        loop {
            let step = back[vertex as usize];
            if step == 0 {
                return vertex;
            }
            let before = vertex - step;
            let next = back[before as usize];
            if next == 0 {
                return before;
            }
            back[vertex as usize] = step + next;
            vertex = before - next;
        }
    }

    /// The same, on any thread.
    pub fn first_of(&self, mut vertex: u32) -> u32 {
        let back: &[u32] = cast_slice(&self.back);
        while back[vertex as usize] != 0 {
            vertex -= back[vertex as usize];
        }
        vertex
    }

    /// Each link once.
    fn tidy(&mut self) {
        let mut links = std::mem::take(&mut self.links);
        links.par_iter_mut().for_each(|link| {
            *link = link.map(|vertex| self.first_of(vertex));
            link.sort_unstable();
        });
        links.par_sort_unstable();
        links.dedup();
        if links.len() > self.most {
            (links, self.tangled) = (Vec::new(), true);
        }
        self.limit = 2 * links.len().max(LINKS_AT_EASE / 2);
        self.links = links;
    }

    /// Clusters have become one, as `sample_of` says now.
    pub fn merge(&mut self, sample_of: &[u32]) {
        let links = std::mem::take(&mut self.links);
        let clusters = |link: [u32; 2]| link.map(|vertex| sample_of[vertex as usize]);
        for link in &links {
            let [a, b] = clusters(*link);
            if a == b {
                self.join((link[0], a), (link[1], b));
            }
        }
        self.links = links.into_iter().filter(|link| clusters(*link)[0] != clusters(*link)[1]).collect();
    }

    /// The clusters of several sheets, ascending: as [`Graph::parts`] of the whole [`graph`](Self::graph), but quick where there
    /// are few clusters of several islands. `sample_of` is the cluster of each vertex.
    pub fn mixed(&self, sample_of: &[u32]) -> Vec<u32> {
        const NONE: u32 = u32::MAX;
        let mut island = vec![NONE; self.latest.len()];
        let mut chosen = vec![false; self.latest.len()];
        for vertex in self.links.iter().flatten() {
            let (first, cluster) = (self.first_of(*vertex), sample_of[*vertex as usize] as usize);
            if island[cluster] == NONE {
                island[cluster] = first;
            }
            chosen[cluster] |= island[cluster] != first;
        }
        drop(island);
        let mut mixed: Vec<u32> =
            (0..).zip(&chosen).filter(|(_, c)| **c).map(|(cluster, _)| cluster).collect();
        // First with the links of these clusters alone, and then with those of the clusters around them.
        for _ in 0..2 {
            if mixed.is_empty() {
                break;
            }
            let near =
                |link: &[u32; 2]| link.iter().any(|vertex| chosen[sample_of[*vertex as usize] as usize]);
            let links = self.links.par_iter().filter(|link| near(link)).copied().collect();
            let still: Vec<u32> = self.graph_of(links, sample_of).parts().iter().map(|m| m.cluster).collect();
            mixed.retain(|cluster| still.binary_search(cluster).is_ok());
            chosen.fill(false);
            mixed.iter().for_each(|cluster| chosen[*cluster as usize] = true);
            let of_mixed = chosen.clone();
            for link in &self.links {
                let [a, b] = link.map(|vertex| sample_of[vertex as usize] as usize);
                if of_mixed[a] || of_mixed[b] {
                    (chosen[a], chosen[b]) = (true, true);
                }
            }
        }
        mixed
    }

    /// All islands that are joined with others. `sample_of` is the cluster of each vertex.
    pub fn graph(&mut self, sample_of: &[u32]) -> Graph {
        self.tidy();
        self.graph_of(self.links.clone(), sample_of)
    }

    fn graph_of(&self, mut links: Vec<[u32; 2]>, sample_of: &[u32]) -> Graph {
        links.par_iter_mut().for_each(|link| *link = link.map(|vertex| self.first_of(vertex)));
        let mut firsts: Vec<u32> = links.iter().flatten().copied().collect();
        firsts.par_sort_unstable();
        firsts.dedup();
        let place = |first: u32| firsts.partition_point(|f| *f < first) as u32;
        let mut pairs: Vec<[u32; 2]> =
            links.par_iter().map(|link| link.map(place)).flat_map_iter(|[a, b]| [[a, b], [b, a]]).collect();
        pairs.par_sort_unstable();
        pairs.dedup();
        let mut starts = vec![0u32; firsts.len() + 1];
        pairs.iter().for_each(|pair| starts[pair[0] as usize + 1] += 1);
        (0..firsts.len()).for_each(|i| starts[i + 1] += starts[i]);
        let cluster = firsts.iter().map(|first| sample_of[*first as usize]).collect();
        Graph { firsts, cluster, starts, joined: pairs.into_iter().map(|pair| pair[1]).collect() }
    }
}

/// Islands that faces join with others.
///
/// Memory: about 36 bytes per sample.
pub struct Graph {
    /// The first vertex of each island, ascending.
    pub firsts: Vec<u32>,
    /// The cluster that it is in.
    pub cluster: Vec<u32>,
    starts: Vec<u32>,
    joined: Vec<u32>,
}

/// A cluster of several sheets: the islands of each.
pub struct Mixed {
    /// The cluster.
    pub cluster: u32,
    /// Places in [`Graph::firsts`].
    pub parts: Vec<Vec<u32>>,
}

impl Graph {
    /// The islands that an island is joined with.
    pub fn joined(&self, island: u32) -> &[u32] {
        &self.joined[self.starts[island as usize] as usize..self.starts[island as usize + 1] as usize]
    }

    /// The clusters of which not all islands are joined by others around: those of several sheets, ascending.
    pub fn parts(&self) -> Vec<Mixed> {
        let mut by_cluster: Vec<(u32, u32)> = self.cluster.iter().copied().zip(0..).collect();
        by_cluster.par_sort_unstable();
        let several: Vec<&[(u32, u32)]> =
            by_cluster.chunk_by(|a, b| a.0 == b.0).filter(|islands| islands.len() > 1).collect();
        several.into_par_iter().filter_map(|islands| self.parts_of(islands)).collect()
    }

    fn parts_of(&self, islands: &[(u32, u32)]) -> Option<Mixed> {
        let mut parts: Vec<Vec<u32>> = Vec::new();
        for (_, island) in islands {
            if parts.iter().any(|part| part.contains(island)) {
                continue;
            }
            let mut part = self.met_from(*island, islands);
            if part.len() == islands.len() {
                return None;
            }
            // Steps go both ways, but those of several islands go further: parts that were taken for two may meet.
            let (meet, apart): (Vec<_>, Vec<_>) =
                parts.into_iter().partition(|other: &Vec<u32>| other.iter().any(|i| part.contains(i)));
            part.extend(meet.into_iter().flatten());
            part.sort_unstable();
            part.dedup();
            parts = apart;
            parts.push(part);
        }
        (parts.len() > 1).then(|| Mixed { cluster: islands[0].0, parts })
    }

    /// Those of a cluster's islands that are met within [`STEPS`] from one of them.
    fn met_from(&self, island: u32, islands: &[(u32, u32)]) -> Vec<u32> {
        let (mut found, mut from) = (vec![island], 0);
        let mut met = vec![island];
        for _ in 0..STEPS {
            let to = found.len();
            for i in from..to {
                for next in self.joined(found[i]) {
                    if !found.contains(next) {
                        found.push(*next);
                        if self.cluster[*next as usize] == islands[0].0 {
                            met.push(*next);
                        }
                    }
                }
            }
            if met.len() == islands.len() {
                break;
            }
            from = to;
        }
        met
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Islands of faces over vertices whose clusters are given.
    fn graph(sample_of: &[u32], samples: usize, faces: &[[u32; 3]]) -> Graph {
        let mut islands = Islands::new(sample_of.len(), samples, &std::env::temp_dir()).expect("a file");
        for face in faces {
            islands.take(*face, face.map(|v| sample_of[v as usize]));
        }
        assert!(!islands.tangled);
        islands.graph(sample_of)
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
            let firsts: Vec<Vec<u32>> = mixed
                .parts
                .iter()
                .map(|p| p.iter().map(|i| graph.firsts[*i as usize] / 24).collect())
                .collect();
            assert_eq!(firsts, [[0], [1]]);
        }
    }

    #[test]
    fn islands_that_others_around_join_are_of_one_part() {
        let faces = strip(0, 12);
        // The strip leaves cluster 0 and comes back.
        let sample_of: Vec<u32> = (0..24).map(|v| u32::from((8..16).contains(&v))).collect();
        let graph = graph(&sample_of, 2, &faces);
        assert_eq!(graph.cluster, [0, 1, 0]);
        assert!(graph.parts().is_empty());
    }

    #[test]
    fn a_tangle_is_noticed() {
        let sample_of: Vec<u32> = (0..400).collect();
        let mut islands = Islands::new(400, 400, &std::env::temp_dir()).expect("a file");
        for u in 0..400 {
            (0..u).for_each(|v| islands.join((u, u), (v, v)));
        }
        assert!(islands.graph(&sample_of).firsts.is_empty() && islands.tangled);
    }
}
