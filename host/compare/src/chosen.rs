//! Vertices that are drawn of models which have very many: one of each so many that follow each other in
//! the file, in every method's version, in a temporary file. They are chosen while the models are measured,
//! so that pictures need no further reading.

use glam::{DVec3, Vec3};
use simod_model::mapped::Map;
use simod_model::scratch::Scratch;
use simod_model::{Result, Vertices};
use simod_picture::SurfaceDisc;
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// Advice where the disk has no room.
const ADVICE: &str = "compare fewer methods at a time, or draw smaller pictures";

/// Numbers of a vertex in one version: its position and its normal.
const NUMBERS: usize = 6;

/// Vertices that are being chosen.
pub(crate) struct Choosing {
    /// Number of vertices of which one is chosen.
    stride: u64,
    count: u64,
    versions: usize,
    origin: DVec3,
    file: Scratch,
}

/// Vertices that were chosen, each in all versions.
pub(crate) struct ChosenVertices {
    versions: usize,
    origin: DVec3,
    numbers: Map,
}

impl Choosing {
    /// Begins a choice of about `most` of so many vertices, or of all where there are fewer than twice as
    /// many. Positions are kept relative to `origin`.
    ///
    /// Disk space, in `folder`: 24 bytes for each chosen vertex and version, and four.
    pub fn begin(
        (vertices, most): (u64, u64),
        versions: usize,
        origin: DVec3,
        folder: &Path,
    ) -> Result<Self> {
        let stride = (vertices / most.max(1)).max(1);
        let file = Scratch::new(folder, ADVICE)?;
        Ok(Self { stride, count: vertices / stride, versions, origin, file })
    }

    /// Takes the chosen ones of some consecutive vertices, in all versions, the first one at rest; `color`
    /// gives their colours.
    pub fn take(
        &self,
        first: u64,
        parts: &[Vertices<'_>],
        color: &dyn Fn(&[Vertices<'_>], usize) -> [u8; 3],
    ) -> Result<()> {
        let end = first + parts[0].positions.len() as u64;
        let mut words: Vec<u32> = Vec::new();
        let mut begin = None;
        for number in first / self.stride..end.div_ceil(self.stride).min(self.count) {
            // The chosen vertices are not at equal distances, which files may have something to do with.
            let vertex = number * self.stride + xxh3_64(&number.to_le_bytes()) % self.stride;
            if !(first..end).contains(&vertex) {
                continue;
            }
            begin.get_or_insert(number);
            let i = (vertex - first) as usize;
            for part in parts {
                let position = (part.positions[i] - self.origin).as_vec3();
                let normal = part.normals.get(i).copied().unwrap_or_default();
                words.extend([position, normal].iter().flat_map(|v| v.to_array()).map(f32::to_bits));
            }
            let [r, g, b] = color(parts, i);
            words.push(u32::from_le_bytes([r, g, b, 0]));
        }
        let Some(begin) = begin else { return Ok(()) };
        self.file.write_at(bytemuck::cast_slice(&words), begin * (self.width() * size_of::<u32>()) as u64)
    }

    fn width(&self) -> usize {
        self.versions * NUMBERS + 1
    }

    /// The choice, once all vertices are there.
    pub fn finish(self) -> Result<ChosenVertices> {
        let (versions, origin) = (self.versions, self.origin);
        Ok(ChosenVertices { versions, origin, numbers: self.file.map()? })
    }
}

impl ChosenVertices {
    /// Number of chosen vertices.
    pub fn len(&self) -> usize {
        self.words().len() / self.width()
    }

    fn width(&self) -> usize {
        self.versions * NUMBERS + 1
    }

    fn words(&self) -> &[u32] {
        // The map begins with a page, and consists of whole words.
        bytemuck::cast_slice(&self.numbers)
    }

    /// Chosen vertex in a version, in the model's coordinates, with its colour; the disc has no size yet.
    pub fn point(&self, i: usize, version: usize) -> SurfaceDisc {
        let words = &self.words()[i * self.width()..][..self.width()];
        let number = |at: usize| f32::from_bits(words[version * NUMBERS + at]);
        let [r, g, b, _] = words[self.width() - 1].to_le_bytes();
        SurfaceDisc {
            position: self.origin + Vec3::new(number(0), number(1), number(2)).as_dvec3(),
            normal: Vec3::new(number(3), number(4), number(5)),
            color: [r, g, b],
            radius: 0.0,
        }
    }
}
