//! The edits that are measured: a line for each.

use simod_plugin_api::Role;

/// A point in fractions of the model's box.
pub type Place = [f64; 3];

/// A region: its role, and whether it holds a point.
pub type Region = (Role, fn(Place) -> bool);

/// One method with the edit that it is asked to do.
pub struct Edit {
    /// Name in the table.
    pub name: &'static str,
    /// The plugin's id.
    pub plugin: &'static str,
    /// Parameters that differ from their defaults.
    pub params: &'static [(&'static str, Value)],
    /// Its regions.
    pub regions: &'static [Region],
    /// Handles that move from frame to frame.
    pub drag: Drag,
    /// A chain of joints, each hanging on the one before.
    pub joints: &'static [Place],
    /// Whether frames are drafts, as while a mouse button is held.
    pub draft: bool,
}

impl Edit {
    const fn draft(mut self) -> Self {
        self.draft = true;
        self
    }

    const fn joints(mut self, joints: &'static [Place]) -> Self {
        self.joints = joints;
        self
    }
}

/// A parameter's value.
#[derive(Clone, Copy)]
pub enum Value {
    /// Value of a number or a switch.
    Number(f64),
    /// Id of a choice.
    Text(&'static str),
}

/// Handles that move from frame to frame.
#[derive(Clone, Copy, PartialEq)]
pub enum Drag {
    /// The handle regions, or nothing where there are none.
    Regions,
    /// One of the handles that the plugin places: so far through their list.
    OneHandle(f64),
    /// The same while all others stay moved.
    OneOfMoved(f64),
    /// All handles that the plugin places.
    AllHandles,
    /// A brush, whose radius is this fraction of the diagonal: each frame adds a dab.
    Brush(f64),
}

use Value::{Number, Text};

const BELOW: Region = (Role::FIXED, |p| p[1] < 0.35);
const ABOVE: Region = (Role::HANDLE, |p| p[1] > 0.9);
const LEFT: Region = (Role::HANDLE, |p| p[1] > 0.5 && p[1] < 0.8 && p[0] < 0.15);
const RIGHT: Region = (Role::HANDLE, |p| p[1] > 0.5 && p[1] < 0.8 && p[0] > 0.85);
const ONE: &[Region] = &[BELOW, ABOVE];
const THREE: &[Region] = &[BELOW, ABOVE, LEFT, RIGHT];

const ARAP: &[(&str, Value)] = &[("mode", Text("smooth-arap"))];
const ROTATED: &[(&str, Value)] = &[("mode", Text("laplacian"))];
const SMOOTH: &[(&str, Value)] = &[("mode", Text("bi-laplacian"))];

/// Along the model's axis, and off it into a handle.
const SPINE: &[Place] =
    &[[0.5, 0.05, 0.5], [0.5, 0.3, 0.5], [0.5, 0.5, 0.5], [0.5, 0.7, 0.5], [0.5, 0.95, 0.5]];
const LINEAR: &[(&str, Value)] = &[("method", Text("linear"))];
const DUAL: &[(&str, Value)] = &[("method", Text("dual-quaternion"))];

const EIGHT: [(&str, Value); 3] =
    [("resolution-x", Number(8.0)), ("resolution-y", Number(8.0)), ("resolution-z", Number(8.0))];
const EIGHT_BERNSTEIN: [(&str, Value); 4] = [EIGHT[0], EIGHT[1], EIGHT[2], ("basis", Text("bernstein"))];

const fn edit(
    name: &'static str,
    plugin: &'static str,
    params: &'static [(&'static str, Value)],
    regions: &'static [Region],
    drag: Drag,
) -> Edit {
    Edit { name, plugin, params, regions, drag, joints: &[], draft: false }
}

/// All edits.
pub const EDITS: &[Edit] = &[
    edit("warp: twist", "warp", &[], &[], Drag::Regions),
    edit("warp: bend", "warp", &[("operation", Text("bend"))], &[], Drag::Regions),
    edit("rbf: 1 handle", "rbf", &[], ONE, Drag::Regions),
    edit("rbf: 3 handles", "rbf", &[], THREE, Drag::Regions),
    edit("rbf: biharmonic, 3 handles", "rbf", &[("kernel", Text("biharmonic"))], THREE, Drag::Regions),
    edit("rbf: compact C², 3 handles", "rbf", &[("kernel", Text("compact-c2"))], THREE, Drag::Regions),
    edit("laplacian: as rigid as possible", "laplacian", ARAP, ONE, Drag::Regions),
    edit("laplacian: as rigid as possible, draft", "laplacian", ARAP, ONE, Drag::Regions).draft(),
    edit("laplacian: rotated coordinates", "laplacian", ROTATED, ONE, Drag::Regions),
    edit("laplacian: rotated coordinates, draft", "laplacian", ROTATED, ONE, Drag::Regions).draft(),
    edit("laplacian: bi-Laplacian", "laplacian", SMOOTH, ONE, Drag::Regions),
    edit("skinning: linear", "skinning", LINEAR, &[], Drag::AllHandles).joints(SPINE),
    edit("skinning: dual quaternions", "skinning", DUAL, &[], Drag::AllHandles).joints(SPINE),
    edit("smooth-handle: 1 handle", "smooth-handle", &[], ONE, Drag::Regions),
    edit("smooth-handle: 3 handles", "smooth-handle", &[], THREE, Drag::Regions),
    edit("lattice: 4³, all points", "lattice", &[], &[], Drag::AllHandles),
    edit("lattice: 8³, one point", "lattice", &EIGHT, &[], Drag::OneHandle(0.4)),
    edit("lattice: 8³, all points", "lattice", &EIGHT, &[], Drag::AllHandles),
    edit("lattice: 8³, Bernstein, all points", "lattice", &EIGHT_BERNSTEIN, &[], Drag::AllHandles),
    edit("cage: 100 vertices, one", "cage", &[("detail", Number(100.0))], &[], Drag::OneHandle(0.4)),
    edit("cage: 100 vertices, all", "cage", &[("detail", Number(100.0))], &[], Drag::AllHandles),
    edit(
        "cage: 400 vertices, one of moved",
        "cage",
        &[("detail", Number(400.0))],
        &[],
        Drag::OneOfMoved(0.4),
    ),
    edit("cage: 400 vertices, all", "cage", &[("detail", Number(400.0))], &[], Drag::AllHandles),
    edit("paint: 1 %", "displacement-paint", &[], &[], Drag::Brush(0.01)),
    edit("paint: 3 %", "displacement-paint", &[], &[], Drag::Brush(0.03)),
    edit("paint: 10 %", "displacement-paint", &[], &[], Drag::Brush(0.1)),
    edit("paint: 20 %", "displacement-paint", &[], &[], Drag::Brush(0.2)),
    edit("paint: smooth, 3 %", "displacement-paint", &[("brush", Text("smooth"))], &[], Drag::Brush(0.03)),
    edit("paint: smooth, 10 %", "displacement-paint", &[("brush", Text("smooth"))], &[], Drag::Brush(0.1)),
];
