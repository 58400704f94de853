//! Places whose vertices are of another sample's sheet than their position alone would tell.

use std::io::{Read, Write};
use std::path::Path;

use bytemuck::{cast_slice, cast_slice_mut};
use glam::Vec3;
use simod_model::Result;
use simod_model::mapped::Map;
use simod_model::scratch::Scratch;

use super::ADVICE;
use super::sorter::{HashedNumber, Sorter, entry, hash_of};

/// Places for each sample that are held in memory; more of them are in a temporary file, which is mapped.
const HELD_PER_SAMPLE: u64 = 8;

/// Places that are copied at a time.
const COPIED: usize = 1 << 14;

const BYTES: u64 = size_of::<HashedNumber>() as u64;

/// The sample of each of some places.
///
/// Memory: at most 96 bytes per sample; beyond it, a mapped file of 12 bytes per place.
#[derive(Debug)]
pub enum PlaceSamples {
    Held(Vec<HashedNumber>),
    Mapped(Map),
}

impl Default for PlaceSamples {
    fn default() -> Self {
        Self::Held(Vec::new())
    }
}

/// Takes places in their order.
struct Filling<'a> {
    held: Vec<HashedNumber>,
    most: u64,
    folder: &'a Path,
    file: Option<Scratch>,
    written: u64,
}

impl Filling<'_> {
    fn push(&mut self, place: HashedNumber) -> Result<()> {
        self.held.push(place);
        if self.file.is_none() && self.held.len() as u64 > self.most {
            self.file = Some(Scratch::new(self.folder, ADVICE)?);
        }
        if self.file.is_some() && self.held.len() >= COPIED { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        if let Some(file) = &self.file {
            file.write_at(cast_slice(&self.held), self.written * BYTES)?;
            self.written += self.held.len() as u64;
            self.held = Vec::new();
        }
        Ok(())
    }

    fn finish(mut self) -> Result<PlaceSamples> {
        self.flush()?;
        Ok(match self.file {
            Some(file) => PlaceSamples::Mapped(file.map()?),
            None => PlaceSamples::Held(self.held),
        })
    }
}

fn filling(samples: usize, folder: &Path) -> Filling<'_> {
    Filling { held: Vec::new(), most: HELD_PER_SAMPLE * samples as u64, folder, file: None, written: 0 }
}

impl PlaceSamples {
    /// The table of places that were put into a sorter, each once.
    pub fn build(places: Sorter<'_>, samples: usize, folder: &Path) -> Result<Self> {
        let mut filling = filling(samples, folder);
        let mut last = None;
        places.finish(|place| {
            // Sheets that share a position are joined there.
            if last.replace([place[0], place[1]]) == Some([place[0], place[1]]) {
                return Ok(());
            }
            filling.push(place)
        })?;
        filling.finish()
    }

    /// All entries, in ascending order.
    pub fn all(&self) -> &[HashedNumber] {
        match self {
            Self::Held(places) => places,
            Self::Mapped(map) => cast_slice(map),
        }
    }

    /// An entry for a local position.
    pub fn entry(p: Vec3, sample: u32) -> HashedNumber {
        entry(hash_of(p.as_dvec3()), sample)
    }

    /// Sample of the sheet that a local position is on, if it is such a place.
    pub fn sample_at(&self, p: Vec3) -> Option<u32> {
        self.find(p).map(|at| self.all()[at][2])
    }

    /// Number of a local position among all entries, if it is such a place.
    pub fn find(&self, p: Vec3) -> Option<usize> {
        let all = self.all();
        if all.is_empty() {
            return None;
        }
        let [high, low, _] = Self::entry(p, 0);
        let at = all.partition_point(|place| (place[0], place[1]) < (high, low));
        all.get(at).filter(|place| (place[0], place[1]) == (high, low)).map(|_| at)
    }

    /// Writes them.
    pub fn write(&self, mut to: impl Write) -> std::io::Result<()> {
        self.all().chunks(COPIED).try_for_each(|places| to.write_all(cast_slice(places)))
    }

    /// Reads so many of them, for so many samples; `None` if they are not in order, or refer to samples that
    /// there are not. A temporary file, should it be needed, is made in `folder`.
    pub fn read(
        mut from: impl Read,
        count: u64,
        samples: usize,
        folder: &Path,
    ) -> std::io::Result<Result<Option<Self>>> {
        let mut filling = filling(samples, folder);
        let (mut buffer, mut left, mut last) = (Vec::new(), count, None);
        while left > 0 {
            buffer.resize(left.min(COPIED as u64) as usize, [0u32; 3]);
            from.read_exact(cast_slice_mut(&mut buffer))?;
            left -= buffer.len() as u64;
            for place in &buffer {
                let hash = [place[0], place[1]];
                if last.replace(hash).is_some_and(|last| last >= hash) || place[2] as usize >= samples {
                    return Ok(Ok(None));
                }
                if let Err(e) = filling.push(*place) {
                    return Ok(Err(e));
                }
            }
        }
        Ok(filling.finish().map(Some))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_found_in_memory_and_in_the_file() {
        let folder = std::env::temp_dir();
        let place = |i: u32| Vec3::new(i as f32, 0.5, -(i as f32));
        for (count, samples) in [(100, 50), (30_000, 50)] {
            let mut sorter = Sorter::new(&folder);
            for i in (0..count).rev() {
                sorter.push(PlaceSamples::entry(place(i), i % 50)).expect("room");
            }
            // Place that two sheets share.
            sorter.push(PlaceSamples::entry(place(7), 40)).expect("room");
            let places = PlaceSamples::build(sorter, samples, &folder).expect("room");
            assert_eq!(matches!(places, PlaceSamples::Mapped(_)), count > 400);
            let mut bytes = Vec::new();
            places.write(&mut bytes).expect("memory");
            let again = PlaceSamples::read(&bytes[..], u64::from(count), samples, &folder);
            let again = again.expect("whole").expect("room").expect("good");
            for places in [&places, &again] {
                assert_eq!(places.all().len(), count as usize);
                assert!((0..count).all(|i| places.sample_at(place(i)) == Some(i % 50)));
                assert_eq!(places.sample_at(place(count)), None);
            }
            let lies = [&bytes[12..], &bytes[..]].concat();
            assert!(
                PlaceSamples::read(&lies[..], u64::from(count), samples, &folder)
                    .expect("whole")
                    .expect("room")
                    .is_none()
            );
            assert!(
                PlaceSamples::read(&bytes[..], u64::from(count), 49, &folder)
                    .expect("whole")
                    .expect("room")
                    .is_none()
            );
            let cut_off = PlaceSamples::read(&bytes[..bytes.len() - 1], u64::from(count), samples, &folder);
            assert!(cut_off.is_err());
        }
    }
}
