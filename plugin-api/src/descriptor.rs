//! What a plugin is, and what it wants.

use crate::ParamDesc;
use abi_stable::{
    StableAbi,
    std_types::{RString, RVec},
};

/// Which inputs a plugin uses, so that the host offers just those.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Consumes {
    /// Regions that stay where they are.
    pub fixed_regions: bool,
    /// Regions that follow a transform.
    pub handle_regions: bool,
    /// Fewest handle regions that it needs.
    pub min_handles: u32,
    /// Fewest fixed regions that it needs.
    pub min_fixed: u32,
    /// Normals that fit the positions: the host derives them anew between layers.
    pub normals: bool,
}

/// A plugin's description of itself.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq)]
pub struct Descriptor {
    /// Stable id, kebab-case; what a session file calls it.
    pub id: RString,
    /// What the user reads.
    pub name: RString,
    /// The plugin's own version, `major.minor.patch`.
    pub version: RString,
    /// One line on what it does.
    pub summary: RString,
    /// The publication that it implements; may be empty.
    pub citation: RString,
    /// Its parameters, in the order to show them.
    pub params: RVec<ParamDesc>,
    /// Which inputs it uses.
    pub consumes: Consumes,
}

impl Descriptor {
    /// A plugin without parameters that consumes the positions alone.
    pub fn new(id: &str, name: &str, version: &str) -> Self {
        Self {
            id: id.into(),
            name: name.into(),
            version: version.into(),
            summary: RString::new(),
            citation: RString::new(),
            params: RVec::new(),
            consumes: Consumes::default(),
        }
    }

    /// One line on what it does.
    #[must_use]
    pub fn summary(mut self, summary: &str) -> Self {
        self.summary = summary.into();
        self
    }

    /// The publication that it implements.
    #[must_use]
    pub fn citation(mut self, citation: &str) -> Self {
        self.citation = citation.into();
        self
    }

    /// One more parameter.
    #[must_use]
    pub fn param(mut self, param: ParamDesc) -> Self {
        self.params.push(param);
        self
    }

    /// Which inputs it uses.
    #[must_use]
    pub fn consumes(mut self, consumes: Consumes) -> Self {
        self.consumes = consumes;
        self
    }
}
