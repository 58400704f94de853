//! The cases and the tools, as tables: what is new in either is a line here, and a session where the tool has
//! handles of its own.

use glam::DVec3;
use simod_generate::Shape;

/// A shape and what is to become of it. Its regions are in the session `NAME.toml`.
pub struct Case {
    pub name: &'static str,
    pub title: &'static str,
    pub shape: Shape,
    pub is_closed: bool,
    /// Length below which a feature is a detail, in the model's unit; nothing where there are none.
    pub details: Option<f64>,
    /// Box that the pictures show; and the direction that they are seen from, to the right of +z and down, in
    /// radians.
    pub stage: [DVec3; 2],
    pub view: [f64; 2],
    /// Size of one picture, in pixels.
    pub size: [u32; 2],
}

pub const CASES: [Case; 4] = [
    Case {
        name: "bumpy-plane",
        title: "Bumpy plane, lifted",
        shape: Shape::BumpyPlane,
        is_closed: false,
        details: Some(0.06),
        stage: [DVec3::new(-1.0, -0.05, -1.0), DVec3::new(1.0, 0.7, 1.0)],
        view: [0.5, 0.35],
        size: [300, 190],
    },
    Case {
        name: "cylinder",
        title: "Cylinder, bent by 120°",
        shape: Shape::Cylinder,
        is_closed: true,
        details: None,
        stage: [DVec3::new(-0.3, 0.0, -0.2), DVec3::new(1.4, 1.3, 0.2)],
        view: [0.3, 0.2],
        size: [280, 240],
    },
    Case {
        name: "bar",
        title: "Bar, twisted by 135°",
        shape: Shape::Bar,
        is_closed: true,
        details: None,
        stage: [DVec3::new(-0.22, 0.0, -0.22), DVec3::new(0.22, 2.0, 0.22)],
        view: [0.4, 0.2],
        size: [150, 360],
    },
    Case {
        name: "cactus",
        title: "Cactus, bent by 70°",
        shape: Shape::Cactus,
        is_closed: true,
        details: Some(0.03),
        stage: [DVec3::new(-0.6, 0.0, -0.25), DVec3::new(1.3, 2.2, 0.25)],
        view: [0.3, 0.2],
        size: [280, 310],
    },
];

/// A tool and how it is set.
pub struct Method {
    pub name: &'static str,
    /// In names of files: a session `CASE-KEY.toml`, if there is one.
    pub key: &'static str,
    /// For a tool that takes regions, the plugin and its parameters, in the place of those of `CASE.toml`.
    pub by_regions: Option<[&'static str; 2]>,
}

const fn by_regions(
    name: &'static str,
    key: &'static str,
    deform: &'static str,
    params: &'static str,
) -> Method {
    Method { name, key, by_regions: Some([deform, params]) }
}

/// A tool with handles of its own: cases without a session of it are those that it cannot do.
const fn by_session(name: &'static str, key: &'static str) -> Method {
    Method { name, key, by_regions: None }
}

pub const METHODS: [Method; 16] = [
    by_regions("rbf", "rbf", "rbf", ""),
    by_regions("rbf, compact", "rbf-compact", "rbf", "kernel = 'compact-c2'\nsupport = 1.0"),
    by_regions("laplacian, smooth-arap", "smooth-arap", "laplacian", "mode = 'smooth-arap'"),
    by_regions("laplacian, arap", "arap", "laplacian", "mode = 'arap'"),
    by_regions("laplacian, laplacian", "laplacian", "laplacian", "mode = 'laplacian'"),
    by_regions("laplacian, bi-laplacian", "bi-laplacian", "laplacian", "mode = 'bi-laplacian'"),
    by_regions("smooth-handle", "smooth-handle", "smooth-handle", ""),
    by_regions("elastic", "elastic", "elastic", ""),
    by_session("lattice", "lattice"),
    by_session("cage", "cage"),
    by_session("cage, somigliana", "somigliana"),
    by_session("skinning", "skinning"),
    by_session("warp", "warp"),
    by_session("curve", "curve"),
    by_session("control-points", "landmarks"),
    by_session("displacement-paint", "paint"),
];
