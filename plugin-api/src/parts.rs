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
    /// Views of the host's arrays: the neighbours of sample `i` are those from `starts[i]` to `starts[i +
    /// 1]`.
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

    /// Index among [`all`](Self::all) of each sample's first neighbour, and after the last one the number of
    /// all neighbours.
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

/// Map between local coordinates and the model's, `simod.model-frame/1`: of the preparation, and where a
/// plugin [places its handles](crate::Handles). For files in model coordinates, as other programs write them.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq)]
pub struct ModelFrame {
    /// The local origin, in model coordinates.
    pub origin: [f64; 3],
    /// Length of a local unit, in the model's unit; above 0.
    pub scale: f64,
}

impl ModelFrame {
    /// Converts a point from model coordinates to local ones.
    pub fn to_local(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| (p[i] - self.origin[i]) / self.scale)
    }

    /// Converts a point from local coordinates to the model's.
    pub fn to_model(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| p[i] * self.scale + self.origin[i])
    }
}

/// Time that a deformation may take, `simod.effort/1`: of the deformation.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort(pub u32);

impl Effort {
    /// The best result, which is kept and written.
    pub const FULL: Self = Self(1);
    /// A picture while a handle is dragged, soon: it may differ a little from the full result, which is asked
    /// for when the handle rests. For the same state and input it is the same as well.
    pub const DRAFT: Self = Self(2);
}

/// Time of a deformation in a sequence, `simod.time/1`: of the deformation. The same samples and motions at
/// another time may go elsewhere.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Default)]
pub struct Time {
    /// Number of the frame in the sequence: 0 for the first one, and where there is no sequence.
    pub frame: i64,
    /// Seconds since the beginning of the sequence; finite.
    pub seconds: f64,
}

/// Positions of the samples before all steps, `simod.rest-positions/1`: of the preparation.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct RestPositions<'a> {
    positions: RSlice<'a, [f32; 3]>,
}

impl<'a> RestPositions<'a> {
    /// A view of the host's array.
    pub fn new(positions: &'a [[f32; 3]]) -> Self {
        Self { positions: positions.into() }
    }

    /// One for each sample, local coordinates, all finite.
    pub fn all(&self) -> &'a [[f32; 3]] {
        self.positions.as_slice()
    }
}

/// Type of an attribute's numbers in the model's file.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct AttributeKind(pub u32);

impl AttributeKind {
    /// Whole numbers from -128 to 127.
    pub const I8: Self = Self(1);
    /// Whole numbers from 0 to 255, as colours often are.
    pub const U8: Self = Self(2);
    /// Whole numbers of 16 bits with a sign.
    pub const I16: Self = Self(3);
    /// Whole numbers from 0 to 65535.
    pub const U16: Self = Self(4);
    /// Whole numbers of 32 bits with a sign.
    pub const I32: Self = Self(5);
    /// Whole numbers of 32 bits, from 0 on.
    pub const U32: Self = Self(6);
    /// Numbers in single precision.
    pub const F32: Self = Self(7);
    /// Numbers in double precision.
    pub const F64: Self = Self(8);
}

/// A property of the model's vertices that is neither position nor normal, as a colour's red or a confidence.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Attribute<'a> {
    name: RStr<'a>,
    /// Type of the attribute's numbers in the file.
    pub kind: AttributeKind,
    values: RSlice<'a, f32>,
}

impl<'a> Attribute<'a> {
    /// A view of the host's array.
    pub fn new(name: &'a str, kind: AttributeKind, values: &'a [f32]) -> Self {
        Self { name: name.into(), kind, values: values.into() }
    }

    /// Name of the attribute in the model's file, as `red`; no two attributes have one name.
    pub fn name(&self) -> &'a str {
        self.name.as_str()
    }

    /// One for each sample, in the property's own unit (a `uchar` colour goes from 0 to 255), all finite: the
    /// mean over the vertices that the sample stands for.
    pub fn values(&self) -> &'a [f32] {
        self.values.as_slice()
    }
}

/// Colours and other attributes of the samples, as far as the model has them, `simod.attributes/1`: of the
/// preparation and of the deformation, and where a plugin [places its handles](crate::Handles).
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Attributes<'a> {
    attributes: RSlice<'a, Attribute<'a>>,
}

impl<'a> Attributes<'a> {
    /// A view of the host's array.
    pub fn new(attributes: &'a [Attribute<'a>]) -> Self {
        Self { attributes: attributes.into() }
    }

    /// All of them, in the file's order; none where the model has none.
    pub fn all(&self) -> &'a [Attribute<'a>] {
        self.attributes.as_slice()
    }

    /// The attribute of a name; nothing where the model has none.
    pub fn get(&self, name: &str) -> Option<&'a Attribute<'a>> {
        self.all().iter().find(|attribute| attribute.name() == name)
    }
}

/// Origin of another model's points.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct PointsKind(pub u32);

impl PointsKind {
    /// The host has sampled the model for this call: at most as many points as the plugin takes.
    pub const SAMPLED: Self = Self(1);
    /// Samples that the user has: a sampled model, or a file of samples that anything has moved. All of them,
    /// whatever the plugin takes, each with its [id](OtherModel::ids).
    pub const SAMPLES: Self = Self(2);
}

/// Another model than the one that is deformed: points of it, in the local coordinates of the one that is.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct OtherModel<'a> {
    param: RStr<'a>,
    /// Origin of the points.
    pub kind: PointsKind,
    /// Number of vertices of the model; of samples the number of samples.
    pub vertices: u64,
    positions: RSlice<'a, [f64; 3]>,
    normals: RSlice<'a, [f32; 3]>,
    ids: RSlice<'a, u64>,
    triangles: RSlice<'a, [u32; 3]>,
}

impl<'a> OtherModel<'a> {
    /// Views of the host's arrays: of one length, but `ids` may be empty, and triangles are any number.
    pub fn new(
        (param, kind, vertices): (&'a str, PointsKind, u64),
        positions: &'a [[f64; 3]],
        normals: &'a [[f32; 3]],
        ids: &'a [u64],
        triangles: &'a [[u32; 3]],
    ) -> Self {
        let (param, positions, normals) = (param.into(), positions.into(), normals.into());
        Self { param, kind, vertices, positions, normals, ids: ids.into(), triangles: triangles.into() }
    }

    /// The id of the parameter that names it.
    pub fn param(&self) -> &'a str {
        self.param.as_str()
    }

    /// Local coordinates of the model that is deformed, all finite; at least one. They may be far away, where
    /// the other model has another origin or unit.
    pub fn positions(&self) -> &'a [[f64; 3]] {
        self.positions.as_slice()
    }

    /// Unit normals, one for each point: those of the file, or else of the triangles or the neighbours.
    /// Without triangles, the side that an estimated one points to is a guess.
    pub fn normals(&self) -> &'a [[f32; 3]] {
        self.normals.as_slice()
    }

    /// Sample that each point is, for [`PointsKind::SAMPLES`]: of a sampled model its index, in a file of
    /// samples its property `id`. No two are the same. Empty for others.
    pub fn ids(&self) -> &'a [u64] {
        self.ids.as_slice()
    }

    /// Triangles between the points, counter-clockwise as seen from outside; none for a cloud.
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles.as_slice()
    }
}

/// The other models that the user gave, `simod.other-models/1`: of the preparation, for plugins with
/// parameters of the kind [`MODEL`](crate::ParamKind::MODEL).
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct OtherModels<'a> {
    models: RSlice<'a, OtherModel<'a>>,
}

impl<'a> OtherModels<'a> {
    /// A view of the host's array.
    pub fn new(models: &'a [OtherModel<'a>]) -> Self {
        Self { models: models.into() }
    }

    /// All of them, in the order of the parameters.
    pub fn all(&self) -> &'a [OtherModel<'a>] {
        self.models.as_slice()
    }

    /// The model that a parameter names; nothing where the user gave none.
    pub fn get(&self, param: &str) -> Option<&'a OtherModel<'a>> {
        self.all().iter().find(|model| model.param() == param)
    }
}

/// A joint of a skeleton that the user placed.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Joint<'a> {
    id: RStr<'a>,
    /// Position at rest, local coordinates.
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

/// Motions of the plugin's own handles, `simod.handle-motions/1`: of the deformation.
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
    /// A hash: the same for strokes that are the same in every respect, and nearly surely another for others:
    /// a plugin can tell by it how many of the first strokes it has applied already.
    pub key: u64,
    /// Radius of the brush, local coordinates; above 0.
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

    /// The stroke's path on or near the surface, local coordinates: a polyline of at least one point. How
    /// many points there are on the way depends on how fast the user's machine draws, and must not matter.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bounds, DeformInput, PrepareInput, Samples};

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
        assert!(input.frame().is_none());
        let frame = ModelFrame { origin: [10.0, 20.0, 30.0], scale: 4.0 };
        assert_eq!(frame.to_local([14.0, 20.0, 26.0]), [1.0, 0.0, -1.0]);
        assert_eq!(frame.to_model([1.0, 0.0, -1.0]), [14.0, 20.0, 26.0]);
        let parts = [Part::new(&frame)];
        assert_eq!(input.with_parts(&parts).frame(), Some(&frame));
        let input = DeformInput::new(samples, bounds, &[], &[]);
        assert_eq!(input.effort(), Effort::FULL, "where nothing is said");
        let parts = [Part::new(&Effort::DRAFT)];
        assert_eq!(input.with_parts(&parts).effort(), Effort::DRAFT);
        assert_eq!(input.time(), Time::default(), "where nothing is said");
        let time = Time { frame: 3, seconds: 0.125 };
        assert_eq!(input.with_parts(&[Part::new(&time)]).time(), time);
        assert_eq!((graph.of(0), graph.of(1), graph.of(2)), (&[1, 2][..], &[0][..], &[][..]));
        assert!(input.attributes().is_empty() && input.attribute("red").is_none(), "where nothing is said");
        let red = [Attribute::new("red", AttributeKind::U8, &[255.0])];
        let attributes = Attributes::new(&red);
        let parts = [Part::new(&attributes)];
        let input = input.with_parts(&parts);
        assert_eq!(input.attribute("red"), Some(&[255.0][..]));
        assert!(input.attribute("green").is_none());
        let input = PrepareInput::new(samples, bounds, &[], &[]);
        assert!(input.other_model("target").is_none(), "where nothing is said");
        let (positions, normals) = ([[1.0, 2.0, 3.0]], [[0.0, 0.0, 1.0]]);
        let models = [OtherModel::new(("target", PointsKind::SAMPLES, 1), &positions, &normals, &[7], &[])];
        let models = OtherModels::new(&models);
        let parts = [Part::new(&models)];
        let target = input.with_parts(&parts).other_model("target").unwrap();
        assert_eq!((target.positions(), target.ids()), (&positions[..], &[7][..]));
        assert!(input.with_parts(&parts).other_model("source").is_none());
    }
}
