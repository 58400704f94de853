//! Inputs that are known by an id rather than by a place in a struct, so that later versions can add to them.
//!
//! A plugin names the ones that it uses in its description ([`Consumes`](crate::Consumes)), and asks for them
//! where it is called ([`PrepareInput::part`](crate::PrepareInput::part)). Each is a frozen struct of its
//! own.

use crate::{Affine, Param, Params};
use abi_stable::{
    StableAbi,
    std_types::{RSlice, RStr},
};

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

    /// Three samples each, counter-clockwise as seen from outside. There is at least one. Several may share
    /// an edge or have no area, and a sample may be in none.
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
    /// Views of the host's arrays: the neighbours of sample `i` are those from `starts[i]` to
    /// `starts[i + 1]`.
    ///
    /// # Panics
    /// The starts do not ascend from 0 to the number of neighbours.
    pub fn new(starts: &'a [u32], neighbours: &'a [u32]) -> Self {
        assert!(starts.first() == Some(&0) && starts.is_sorted(), "lists that follow each other");
        assert_eq!(starts.last().map(|end| *end as usize), Some(neighbours.len()), "all neighbours");
        Self { starts: starts.into(), neighbours: neighbours.into() }
    }

    /// The neighbours of sample `i`, nearest first, without itself. One that is among another's need not have
    /// that other among its own.
    pub fn of(&self, i: usize) -> &'a [u32] {
        let starts = self.starts.as_slice();
        &self.neighbours.as_slice()[starts[i] as usize..starts[i + 1] as usize]
    }

    /// Where the neighbours of each sample begin among [`all`](Self::all), and after the last one their
    /// number.
    pub fn starts(&self) -> &'a [u32] {
        self.starts.as_slice()
    }

    /// The neighbours of all samples, one list after the other.
    pub fn all(&self) -> &'a [u32] {
        self.neighbours.as_slice()
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

/// A joint of a skeleton that the user placed.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Joint<'a> {
    id: RStr<'a>,
    /// Where it is at rest, local coordinates.
    pub position: [f64; 3],
    /// The index of the joint that it hangs on: less than its own; [`Joint::ROOT`] for none.
    pub parent: u32,
}

impl<'a> Joint<'a> {
    /// The parent of a joint that hangs on no other.
    pub const ROOT: u32 = u32::MAX;

    /// A joint at `position`.
    pub fn new(id: &'a str, position: [f64; 3], parent: u32) -> Self {
        Self { id: id.into(), position, parent }
    }

    /// Stable id, unique among the joints.
    pub fn id(&self) -> &'a str {
        self.id.as_str()
    }
}

/// The joints that the user placed, `simod.joints/1`: of the preparation, and where a plugin
/// [places its handles](crate::Handles), so that it can offer them as such.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Joints<'a> {
    joints: RSlice<'a, Joint<'a>>,
}

impl<'a> Joints<'a> {
    /// A view of the host's array: parents come before those that hang on them.
    pub fn new(joints: &'a [Joint<'a>]) -> Self {
        Self { joints: joints.into() }
    }

    /// The joints: parents come before those that hang on them.
    pub fn all(&self) -> &'a [Joint<'a>] {
        self.joints.as_slice()
    }
}

/// How the plugin's own handles were moved, `simod.handle-motions/1`: of the deformation.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct HandleMotions<'a> {
    motions: RSlice<'a, Affine>,
}

impl<'a> HandleMotions<'a> {
    /// A view of the host's array.
    pub fn new(motions: &'a [Affine]) -> Self {
        Self { motions: motions.into() }
    }

    /// One map of space for each handle that [`Handles::handles`](crate::Handles::handles) gave, in its
    /// order: from the rest pose to the user's, local coordinates. Those of what a handle hangs on are
    /// included (first its own motion, then its parent's); the identity where neither was moved.
    pub fn all(&self) -> &'a [Affine] {
        self.motions.as_slice()
    }
}

/// A brush stroke.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Stroke<'a> {
    /// The same for strokes that are the same in every respect, and nearly surely another for others: a
    /// plugin can tell by it how many of the first strokes it has applied already.
    pub key: u64,
    /// Of the brush, local coordinates; above 0.
    pub radius: f64,
    /// 1 is full strength; negative ones do the opposite, as far as the brush has one.
    pub strength: f64,
    points: RSlice<'a, [f64; 3]>,
    pressures: RSlice<'a, f32>,
    params: RSlice<'a, Param<'a>>,
}

impl<'a> Stroke<'a> {
    /// A stroke along `points`. `pressures` are as many or none, `params` the values of all parameters of the
    /// plugin.
    pub fn new(
        key: u64,
        radius: f64,
        strength: f64,
        points: &'a [[f64; 3]],
        pressures: &'a [f32],
        params: &'a [Param<'a>],
    ) -> Self {
        let (points, pressures, params) = (points.into(), pressures.into(), params.into());
        Self { key, radius, strength, points, pressures, params }
    }

    /// Its path on or near the surface, local coordinates: a polyline of at least one point. How many points
    /// there are on the way depends on how fast the user's machine draws, and must not matter.
    pub fn points(&self) -> &'a [[f64; 3]] {
        self.points.as_slice()
    }

    /// The pen's pressure at each point, 0 to 1; none where there is no pen.
    pub fn pressures(&self) -> &'a [f32] {
        self.pressures.as_slice()
    }

    /// The parameters' values for this stroke: the layer's, unless the user chose others while drawing.
    pub fn params(&self) -> Params<'a> {
        Params::new(self.params.as_slice())
    }
}

/// Brush strokes, first to last, `simod.strokes/1`: of the deformation.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Strokes<'a> {
    strokes: RSlice<'a, Stroke<'a>>,
}

impl<'a> Strokes<'a> {
    /// A view of the host's array.
    pub fn new(strokes: &'a [Stroke<'a>]) -> Self {
        Self { strokes: strokes.into() }
    }

    /// The strokes, first to last.
    pub fn all(&self) -> &'a [Stroke<'a>] {
        self.strokes.as_slice()
    }
}
