//! The input of a plugin's calls, borrowed from the host for the length of one call; nothing is copied.

use crate::opaque::Part;
use crate::params::{Param, Params};
use crate::parts::{
    Attribute, Attributes, Effort, Graph, HandleMotions, InputPart, Joint, Joints, ModelFrame, OtherModel,
    OtherModels, RestPositions, Stroke, Strokes, Time, Triangles,
};
use abi_stable::{StableAbi, std_types::RSlice};

/// The samples' arrays, of one length (spacing and normals may be empty where the host has none).
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Samples<'a> {
    positions: RSlice<'a, [f32; 3]>,
    normals: RSlice<'a, [f32; 3]>,
    spacing: RSlice<'a, f32>,
}

impl<'a> Samples<'a> {
    /// Views of the host's arrays.
    pub fn new(positions: &'a [[f32; 3]], normals: &'a [[f32; 3]], spacing: &'a [f32]) -> Self {
        Self { positions: positions.into(), normals: normals.into(), spacing: spacing.into() }
    }

    /// Rest positions, local coordinates, all finite.
    pub fn positions(&self) -> &'a [[f32; 3]] {
        self.positions.as_slice()
    }

    /// Unit normals, or nothing where the host has none. They may be stale after earlier layers of the stack
    /// unless the plugin declares that it consumes them ([`Consumes::normals`](crate::Consumes)).
    pub fn normals(&self) -> &'a [[f32; 3]] {
        self.normals.as_slice()
    }

    /// Distance to the nearest other samples, in local coordinates; or nothing.
    pub fn spacing(&self) -> &'a [f32] {
        self.spacing.as_slice()
    }
}

/// An axis-aligned box in local coordinates.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

impl Bounds {
    /// Length of the diagonal, in local coordinates.
    pub fn diagonal(&self) -> f64 {
        (0..3).map(|i| (self.max[i] - self.min[i]).powi(2)).sum::<f64>().sqrt()
    }
}

/// Role of a region: what its samples do.
#[repr(transparent)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq)]
pub struct Role(pub u32);

impl Role {
    /// The region's samples stay where they are.
    pub const FIXED: Self = Self(1);
    /// The region's samples follow its transform.
    pub const HANDLE: Self = Self(2);
}

/// A part of the samples, with a role.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct Region<'a> {
    /// Role of the region's samples.
    pub role: Role,
    weights: RSlice<'a, f32>,
}

impl<'a> Region<'a> {
    /// A region of the given role; one weight per sample.
    pub fn new(role: Role, weights: &'a [f32]) -> Self {
        Self { role, weights: weights.into() }
    }

    /// One weight per sample, 0 (outside) to 1 (inside).
    pub fn weights(&self) -> &'a [f32] {
        self.weights.as_slice()
    }
}

/// An affine map `x -> M x + t` as the rows of `[M | t]`, local coordinates.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    /// Row-major 3x4 matrix.
    pub rows: [[f64; 4]; 3],
}

impl Affine {
    /// The map that moves nothing.
    pub const IDENTITY: Self =
        Self { rows: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]] };

    /// The image of a point.
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        self.rows.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3])
    }
}

/// Input of a preparation: all that its state may depend on. The host calls `prepare` again once any of it
/// changed, parameters that do not invalidate the preparation excepted.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct PrepareInput<'a> {
    /// The samples at rest.
    pub samples: Samples<'a>,
    /// The model's box in its rest pose, the same for all layers of a stack: lengths given as fractions of
    /// its diagonal do not change when an earlier layer does. Samples of later layers may lie outside.
    pub bounds: Bounds,
    regions: RSlice<'a, Region<'a>>,
    params: RSlice<'a, Param<'a>>,
    parts: RSlice<'a, Part<'a>>,
}

impl<'a> PrepareInput<'a> {
    /// Views of the host's arrays.
    pub fn new(
        samples: Samples<'a>,
        bounds: Bounds,
        regions: &'a [Region<'a>],
        params: &'a [Param<'a>],
    ) -> Self {
        Self { samples, bounds, regions: regions.into(), params: params.into(), parts: RSlice::EMPTY }
    }

    /// With inputs that are known by ids.
    #[must_use]
    pub fn with_parts(self, parts: &'a [Part<'a>]) -> Self {
        Self { parts: parts.into(), ..self }
    }

    /// Without regions, as where [handles are placed](crate::Handles::handles).
    #[must_use]
    pub fn without_regions(self) -> Self {
        Self { regions: RSlice::EMPTY, ..self }
    }

    /// An input that is known by an id; nothing where the host has none, or was not told that the plugin
    /// [uses](crate::Descriptor::inputs) it.
    pub fn part<T: InputPart<'a>>(&self) -> Option<&'a T> {
        self.parts.as_slice().iter().find_map(Part::get)
    }

    /// The triangles between the samples, where there are any.
    pub fn triangles(&self) -> Option<&'a Triangles<'a>> {
        self.part()
    }

    /// The graph of the samples' nearest neighbours.
    pub fn graph(&self) -> Option<&'a Graph<'a>> {
        self.part()
    }

    /// The map between model and local coordinates; nothing where the host is older than this input.
    pub fn frame(&self) -> Option<&'a ModelFrame> {
        self.part()
    }

    /// The samples' positions before all steps, for plugins that [ask for
    /// them](crate::Consumes::rest_positions); nothing where the host is older than this input.
    pub fn rest_positions(&self) -> Option<&'a [[f32; 3]]> {
        self.part().map(RestPositions::all)
    }

    /// Colours and other attributes of the samples, in the file's order, for plugins that [ask for
    /// them](crate::Consumes::attributes); none where the model has none, or the host is older than this
    /// input.
    pub fn attributes(&self) -> &'a [Attribute<'a>] {
        self.part().map_or(&[], Attributes::all)
    }

    /// One value for each sample of the attribute that the model's file calls so: see [`Attribute::values`].
    /// Nothing where the model has no such attribute.
    pub fn attribute(&self, name: &str) -> Option<&'a [f32]> {
        self.part().and_then(|all: &Attributes<'_>| all.get(name)).map(Attribute::values)
    }

    /// The other model that a parameter of the kind [`MODEL`](crate::ParamKind::MODEL) names; nothing where
    /// the user gave none.
    pub fn other_model(&self, param: &str) -> Option<&'a OtherModel<'a>> {
        self.part().and_then(|all: &OtherModels<'_>| all.get(param))
    }

    /// The joints that the user placed; none where there are none.
    pub fn joints(&self) -> &'a [Joint<'a>] {
        self.part().map_or(&[], Joints::all)
    }

    /// The regions, in the user's order.
    pub fn regions(&self) -> &'a [Region<'a>] {
        self.regions.as_slice()
    }

    /// The parameters' values.
    pub fn params(&self) -> Params<'a> {
        Params::new(self.params.as_slice())
    }
}

/// Input of one deformation: all that it depends on, besides the state.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy)]
pub struct DeformInput<'a> {
    /// The samples at rest: those of the preparation.
    pub samples: Samples<'a>,
    /// The bounding box of the model: that of the preparation.
    pub bounds: Bounds,
    transforms: RSlice<'a, Affine>,
    params: RSlice<'a, Param<'a>>,
    parts: RSlice<'a, Part<'a>>,
}

impl<'a> DeformInput<'a> {
    /// Views of the host's arrays.
    pub fn new(
        samples: Samples<'a>,
        bounds: Bounds,
        transforms: &'a [Affine],
        params: &'a [Param<'a>],
    ) -> Self {
        Self { samples, bounds, transforms: transforms.into(), params: params.into(), parts: RSlice::EMPTY }
    }

    /// With inputs that are known by ids.
    #[must_use]
    pub fn with_parts(self, parts: &'a [Part<'a>]) -> Self {
        Self { parts: parts.into(), ..self }
    }

    /// An input that is known by an id, such as later versions may add.
    pub fn part<T: InputPart<'a>>(&self) -> Option<&'a T> {
        self.parts.as_slice().iter().find_map(Part::get)
    }

    /// One map for each of the [handles that the plugin placed](crate::Handles::handles), in its order: see
    /// [`HandleMotions::all`].
    pub fn handle_motions(&self) -> &'a [Affine] {
        self.part().map_or(&[], HandleMotions::all)
    }

    /// The time that this deformation may take; [`Effort::FULL`] where the host says nothing.
    pub fn effort(&self) -> Effort {
        self.part().copied().unwrap_or(Effort::FULL)
    }

    /// The time of this deformation in a sequence, for plugins that [ask for it](crate::Consumes::time); the
    /// beginning where the host says nothing.
    pub fn time(&self) -> Time {
        self.part().copied().unwrap_or_default()
    }

    /// Colours and other attributes of the samples, in the file's order, for plugins that [ask for
    /// them](crate::Consumes::attributes); none where the model has none, or the host is older than this
    /// input.
    pub fn attributes(&self) -> &'a [Attribute<'a>] {
        self.part().map_or(&[], Attributes::all)
    }

    /// One value for each sample of the attribute that the model's file calls so: see [`Attribute::values`].
    /// Nothing where the model has no such attribute.
    pub fn attribute(&self, name: &str) -> Option<&'a [f32]> {
        self.part().and_then(|all: &Attributes<'_>| all.get(name)).map(Attribute::values)
    }

    /// The brush strokes, first to last; none where there are none.
    pub fn strokes(&self) -> &'a [Stroke<'a>] {
        self.part().map_or(&[], Strokes::all)
    }

    /// One map for each *handle* region of the preparation, in their order; all finite.
    pub fn transforms(&self) -> &'a [Affine] {
        self.transforms.as_slice()
    }

    /// The parameters' values.
    pub fn params(&self) -> Params<'a> {
        Params::new(self.params.as_slice())
    }
}
