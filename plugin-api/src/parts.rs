//! Inputs that are known by an id rather than by a place in a struct, so that later versions can add to them.
//!
//! A plugin names the ones that it uses in its description ([`Consumes`](crate::Consumes)), and asks for them where it
//! is called ([`PrepareInput::part`](crate::PrepareInput::part)). Each is a frozen struct of its own.

use abi_stable::{StableAbi, std_types::RSlice};

pub use crate::opaque::{InputPart, Part};

/// Triangles between the samples, `simod.triangles/1`.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Triangles<'a> {
    indices: RSlice<'a, [u32; 3]>,
}

impl<'a> Triangles<'a> {
    /// A view of the host's array.
    pub fn new(indices: &'a [[u32; 3]]) -> Self {
        Self { indices: indices.into() }
    }

    /// Three samples each, counter-clockwise as seen from outside. There is at least one. Several may share an edge or
    /// have no area, and a sample may be in none.
    pub fn indices(&self) -> &'a [[u32; 3]] {
        self.indices.as_slice()
    }
}

/// The nearest neighbours of each sample at rest, `simod.graph/1`.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Graph<'a> {
    starts: RSlice<'a, u32>,
    neighbours: RSlice<'a, u32>,
}

impl<'a> Graph<'a> {
    /// Views of the host's arrays: the neighbours of sample `i` are those from `starts[i]` to `starts[i + 1]`.
    ///
    /// # Panics
    /// The starts do not ascend from 0 to the number of neighbours.
    pub fn new(starts: &'a [u32], neighbours: &'a [u32]) -> Self {
        assert!(starts.first() == Some(&0) && starts.is_sorted(), "lists that follow each other");
        assert_eq!(starts.last().map(|end| *end as usize), Some(neighbours.len()), "all neighbours");
        Self { starts: starts.into(), neighbours: neighbours.into() }
    }

    /// The neighbours of sample `i`, nearest first, without itself. One that is among another's need not have that other
    /// among its own.
    pub fn of(&self, i: usize) -> &'a [u32] {
        let starts = self.starts.as_slice();
        &self.neighbours.as_slice()[starts[i] as usize..starts[i + 1] as usize]
    }

    /// The number of samples.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bounds, PrepareInput, Samples};

    #[test]
    fn parts_are_found_by_what_they_are() {
        let indices = [[0, 1, 2]];
        let triangles = Triangles::new(&indices);
        let graph = Graph::new(&[0, 2, 3, 3], &[1, 2, 0]);
        let parts = [Part::new(&graph), Part::new(&triangles)];
        let samples = Samples::new(&[], &[], &[]);
        let bounds = Bounds { min: [0.0; 3], max: [1.0; 3] };
        let input = PrepareInput::new(samples, bounds, &[], &[]);
        assert!(input.triangles().is_none());
        let input = input.with_parts(&parts);
        assert_eq!(input.triangles().map(Triangles::indices), Some(&indices[..]));
        let graph = input.graph().unwrap();
        assert_eq!((graph.of(0), graph.of(1), graph.of(2)), (&[1, 2][..], &[0][..], &[][..]));
    }
}
