//! Twins: vertices at the same position as an earlier one that is not far before them in the file. They hang
//! together along the seams of a mesh whose faces share no vertices there, as far as little memory tells.

use std::path::Path;

use bytemuck::cast_slice;
use glam::DVec3;
use rayon::prelude::*;
use simod_model::Result;
use simod_model::mapped::MapMut;
use simod_model::scratch::Scratch;

use super::ADVICE;
use super::sorter::{HashedNumber, entry, hash_of};

/// Positions that are remembered: a few rows or patches of a scan.
const REMEMBERED: usize = 1 << 18;

/// The number of entries that are looked at first, as most twins are near each other in the file: as many as
/// a processor's first cache holds.
const LATEST: usize = 1 << 11;

/// Vertices that are looked at together.
const BLOCK: usize = 64;

/// Numbers written at a time.
const BUFFER: usize = 1 << 16;

/// Length of runs of vertices, none of which is compared with those before the run: so a unit with a part of
/// the vertices needs to look at few others to find what a search of all of them finds.
const RUN: u64 = 1 << 20;

/// Finds twins while the vertices stream.
///
/// Memory: that of a search, 256 KiB, and a file of 4 bytes per vertex.
pub struct Twins {
    file: Scratch,
    buffer: Vec<u32>,
    written: u64,
    /// Search for twins; `None` where positions are not looked at.
    search: Option<TwinSearch>,
    found: u64,
}

/// A search for twins, some vertices at a time.
///
/// Memory: 3.1 MiB.
pub struct TwinSearch {
    /// Hash of a position and a vertex there, at a place that the hash tells; and the same of the latest
    /// vertices.
    remembered: Vec<HashedNumber>,
    latest: Vec<HashedNumber>,
    next: u64,
}

/// The vertices at one place that were found.
pub struct FoundTwins {
    /// Distance of each vertex behind one at the same position; 0 where none is known.
    pub back: MapMut,
    /// Number of vertices that have such an earlier one.
    pub count: u64,
}

impl FoundTwins {
    /// Twins from a file with the numbers of all vertices, as `back` has them.
    ///
    /// # Errors
    /// The file cannot be mapped.
    pub fn of_all(back: Scratch) -> Result<Self> {
        let back = back.map_mut()?;
        let count = cast_slice::<_, u32>(&back).par_iter().filter(|back| **back != 0).count() as u64;
        Ok(Self { back, count })
    }

    /// Empty findings for a model of `vertices` vertices, at least one.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn none(vertices: u64, folder: &Path) -> Result<Self> {
        let (file, zeros) = (Scratch::new(folder, ADVICE)?, vec![0u32; BUFFER]);
        let mut at = 0;
        while at < vertices {
            let some = (BUFFER as u64).min(vertices - at);
            file.write_at(cast_slice(&zeros[..some as usize]), at * size_of::<u32>() as u64)?;
            at += some;
        }
        Ok(Self { back: file.map_mut()?, count: 0 })
    }
}

/// Whether a model of so many vertices and faces may have vertices at one place that are worth looking for:
/// where faces share their vertices, there are hardly any.
pub fn may_be_there(vertices: u64, faces: u64) -> bool {
    // A closed mesh of triangles has half as many vertices as faces.
    20 * u128::from(vertices) > 11 * u128::from(faces)
}

impl Twins {
    /// Search without vertices yet, for a model with `vertices` vertices and `faces` faces. Where there are
    /// hardly [any](may_be_there), they are not looked for. The file goes to `folder`.
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn new(vertices: u64, faces: u64, folder: &Path) -> Result<Self> {
        Ok(Self {
            file: Scratch::new(folder, ADVICE)?,
            buffer: Vec::with_capacity(BUFFER + BLOCK),
            written: 0,
            search: may_be_there(vertices, faces).then(|| TwinSearch::new(0)),
            found: 0,
        })
    }

    /// Takes the next vertices; one without a finite position has no twin.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn take(&mut self, positions: &[DVec3]) -> Result<()> {
        for block in positions.chunks(BLOCK) {
            match &mut self.search {
                Some(search) => self.found += search.look_at(block, &mut self.buffer),
                None => self.buffer.resize(self.buffer.len() + block.len(), 0),
            }
            if self.buffer.len() >= BUFFER {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<()> {
        self.file.write_at(cast_slice(&self.buffer), self.written * size_of::<u32>() as u64)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Twins of all vertices that were pushed.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<FoundTwins> {
        self.flush()?;
        Ok(FoundTwins { back: self.file.map_mut()?, count: self.found })
    }
}

impl TwinSearch {
    /// Vertex from which on one has to look at vertices to find what a search of all of them finds of this
    /// one and those behind it.
    pub fn first_for(vertex: u64) -> u64 {
        vertex - vertex % RUN
    }

    /// A search in the vertices from one on that is the [first](Self::first_for) for others.
    pub fn new(first: u64) -> Self {
        Self { remembered: none(REMEMBERED), latest: none(LATEST), next: first }
    }

    /// Finds for each of the next vertices its distance behind one at the same position, or 0.
    pub fn take(&mut self, positions: &[DVec3], back: &mut Vec<u32>) {
        positions.chunks(BLOCK).for_each(|block| _ = self.look_at(block, back));
    }

    /// Looks for the twins of a block of vertices; returns the number that was found.
    fn look_at(&mut self, block: &[DVec3], to: &mut Vec<u32>) -> u64 {
        let mut hashes = [0; BLOCK];
        hashes.iter_mut().zip(block).for_each(|(hash, p)| *hash = hash_of(*p));
        // The entries for all vertices of a block are fetched from memory at once, rather than one after the
        // other.
        let touched = hashes.iter().map(|hash| self.remembered[*hash as usize % REMEMBERED][0]);
        std::hint::black_box(touched.fold(0, u32::wrapping_add));
        let mut found = 0;
        for (p, hash) in block.iter().zip(hashes) {
            if self.next.is_multiple_of(RUN) {
                (self.remembered, self.latest) = (none(REMEMBERED), none(LATEST));
            }
            let vertex = self.next as u32;
            self.next += 1;
            let new = entry(hash, vertex);
            let is_twin = |known: HashedNumber| known[..2] == new[..2] && known[2] < vertex;
            let mut back = 0;
            if p.is_finite() {
                let latest = std::mem::replace(&mut self.latest[hash as usize % LATEST], new);
                if is_twin(latest) {
                    back = vertex - latest[2];
                } else {
                    let known = std::mem::replace(&mut self.remembered[hash as usize % REMEMBERED], new);
                    if is_twin(known) {
                        back = vertex - known[2];
                    }
                }
            }
            found += u64::from(back != 0);
            to.push(back);
        }
        found
    }
}

/// Table of `entries` entries, all of no vertex.
fn none(entries: usize) -> Vec<HashedNumber> {
    vec![[0, 0, u32::MAX]; entries]
}

#[cfg(test)]
mod tests {
    use bytemuck::cast_slice;
    use proptest::prelude::*;

    use super::*;

    fn found(positions: &[DVec3]) -> (Vec<u32>, u64) {
        let folder = std::env::temp_dir();
        let mut twins = Twins::new(positions.len() as u64, 0, &folder).expect("a file");
        positions.chunks(100).for_each(|some| twins.take(some).expect("room"));
        let found = twins.finish().expect("a file");
        (cast_slice(&found.back).to_vec(), found.count)
    }

    proptest! {
        #[test]
        fn twins_are_at_the_same_position_and_near_ones_are_found(
            places in proptest::collection::vec(0..400u32, 1..1000),
        ) {
            let place = |i: &u32| if *i == 0 { DVec3::NAN } else { DVec3::new(f64::from(*i), 1.0, -0.0) };
            let positions: Vec<DVec3> = places.iter().map(place).collect();
            let (back, count) = found(&positions);
            prop_assert_eq!(back.iter().filter(|back| **back != 0).count() as u64, count);
            for (i, back) in back.iter().enumerate() {
                let before = places[..i].iter().rposition(|place| *place == places[i] && *place != 0);
                // Two that fall on the same place of what is remembered are rare among so few.
                match before {
                    Some(_) if *back != 0 => prop_assert_eq!(places[i - *back as usize], places[i]),
                    Some(_) => (),
                    None => prop_assert_eq!(*back, 0),
                }
            }
            let known = (1..400).filter(|place| places.contains(place)).count();
            let twins = places.iter().filter(|place| **place != 0).count() - known;
            prop_assert!(count as usize <= twins && count as usize * 10 >= twins * 9);
        }
    }

    /// A search of a part of the vertices finds what a search of all of them does.
    #[test]
    fn parts_find_what_all_do() {
        // Three vertices at each place, some of them far from each other, and some that are nowhere.
        let place =
            |i: u64| if i.is_multiple_of(101) { f64::NAN } else { ((i / 3) ^ ((i % 5 / 4) << 9)) as f64 };
        let all: Vec<DVec3> = (0..2 * RUN + 70_000).map(|i| DVec3::splat(place(i))).collect();
        let (back, count) = found(&all);
        assert!(count > RUN / 2);
        for start in [0, 1, RUN - 6144, RUN, RUN + 12_288, 2 * RUN + 50_000] {
            let first = TwinSearch::first_for(start);
            let (mut search, mut own) = (TwinSearch::new(first), Vec::new());
            all[first as usize..].chunks(999).for_each(|some| search.take(some, &mut own));
            assert!(own[(start - first) as usize..] == back[start as usize..], "{start}");
        }
    }

    #[test]
    fn far_ones_are_found_as_well() {
        let row = || (0..20_000).map(|i| DVec3::new(f64::from(i), 2.0, 3.0));
        let (back, count) = found(&row().chain(row()).collect::<Vec<_>>());
        assert!(back.iter().all(|back| *back == 0 || *back == 20_000));
        assert!((18_000..=20_000).contains(&count), "{count}");
    }
}
