//! A plugin's description of itself: its names, its parameters and the inputs that it uses.

use crate::{
    Attributes, Effort, Graph, InputPart, Joints, ModelFrame, ParamDesc, RestPositions, Strokes, Time,
    Triangles,
};
use abi_stable::{
    StableAbi,
    std_types::{RString, RVec},
};

/// One input that a plugin uses beside the samples' positions. Inputs are known by ids, as extensions are:
/// what later versions offer is a new id, not a new field.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq, Eq)]
pub struct InputDesc {
    /// Such as `simod.handle-regions/1`.
    pub id: RString,
    /// Number of such inputs that the plugin needs: where there are fewer, it is not called. 0 for an input
    /// that it uses if there is one. A host that does not know the id passes over the input if this is 0, and
    /// refuses the plugin otherwise.
    pub at_least: u32,
}

/// The inputs of this version that a plugin uses, so that the host offers just those.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Consumes {
    /// Regions that stay where they are.
    pub fixed_regions: bool,
    /// Regions that follow a transform.
    pub handle_regions: bool,
    /// Fewest handle regions that it needs.
    pub min_handles: u32,
    /// Fewest fixed regions that it needs.
    pub min_fixed: u32,
    /// Normals that fit the positions: the host derives them anew between layers. Without them it is not
    /// called.
    pub normals: bool,
    /// [`Triangles`](crate::Triangles) between the samples, where there are any.
    pub triangles: bool,
    /// The [`Graph`](crate::Graph) of the samples' nearest neighbours.
    pub graph: bool,
    /// [`Joints`](crate::Joints) that the user places.
    pub joints: bool,
    /// Brush [`Strokes`](crate::Strokes).
    pub strokes: bool,
    /// The [`ModelFrame`](crate::ModelFrame), for files in model coordinates.
    pub frame: bool,
    /// The [`Effort`](crate::Effort) that a deformation is worth.
    pub effort: bool,
    /// The [`Time`](crate::Time) of a sequence.
    pub time: bool,
    /// The [`RestPositions`](crate::RestPositions) of the samples, before all steps.
    pub rest_positions: bool,
    /// The [`Attributes`](crate::Attributes) of the samples, as colours: the model is read once more for
    /// them.
    pub attributes: bool,
}

impl Consumes {
    /// Regions that stay where they are.
    pub const FIXED_REGIONS: &'static str = "simod.fixed-regions/1";
    /// Regions that follow a transform.
    pub const HANDLE_REGIONS: &'static str = "simod.handle-regions/1";
    /// Normals that fit the positions.
    pub const NORMALS: &'static str = "simod.normals/1";

    fn inputs(&self) -> [(&'static str, bool, u32); 12] {
        [
            (Self::FIXED_REGIONS, self.fixed_regions, self.min_fixed),
            (Self::HANDLE_REGIONS, self.handle_regions, self.min_handles),
            (Self::NORMALS, self.normals, 1),
            (Triangles::ID, self.triangles, 0),
            (Graph::ID, self.graph, 0),
            (Joints::ID, self.joints, 0),
            (Strokes::ID, self.strokes, 0),
            (ModelFrame::ID, self.frame, 0),
            (Effort::ID, self.effort, 0),
            (Time::ID, self.time, 0),
            (RestPositions::ID, self.rest_positions, 0),
            (Attributes::ID, self.attributes, 0),
        ]
    }

    /// Reads a plugin's list of inputs. Ids that this version does not have are passed over where the plugin
    /// can do without them.
    ///
    /// # Errors
    /// The id of the first input that the plugin needs and this version does not have.
    pub fn from_inputs(inputs: &[InputDesc]) -> Result<Self, &str> {
        let mut this = Self::default();
        for InputDesc { id, at_least } in inputs {
            match id.as_str() {
                Self::FIXED_REGIONS => (this.fixed_regions, this.min_fixed) = (true, *at_least),
                Self::HANDLE_REGIONS => (this.handle_regions, this.min_handles) = (true, *at_least),
                Self::NORMALS => this.normals = true,
                Triangles::ID => this.triangles = true,
                Graph::ID => this.graph = true,
                Joints::ID => this.joints = true,
                Strokes::ID => this.strokes = true,
                ModelFrame::ID => this.frame = true,
                Effort::ID => this.effort = true,
                Time::ID => this.time = true,
                RestPositions::ID => this.rest_positions = true,
                Attributes::ID => this.attributes = true,
                id if *at_least > 0 => return Err(id),
                _ => {}
            }
        }
        Ok(this)
    }
}

/// A plugin's description of itself.
#[repr(C)]
#[derive(StableAbi, Debug, Clone, PartialEq)]
pub struct Descriptor {
    /// Stable id of the plugin, kebab-case, as session files have it.
    pub id: RString,
    /// Name for the user.
    pub name: RString,
    /// The plugin's own version, `major.minor.patch`.
    pub version: RString,
    /// One line on what it does.
    pub summary: RString,
    /// The publication that it implements; may be empty.
    pub citation: RString,
    /// Author of the plugin, whom its users may ask; may be empty.
    pub author: RString,
    /// Address of a page on the plugin; may be empty.
    pub url: RString,
    /// The plugin's parameters, in the order to show them.
    pub params: RVec<ParamDesc>,
    /// Inputs that the plugin uses.
    pub inputs: RVec<InputDesc>,
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
            author: RString::new(),
            url: RString::new(),
            params: RVec::new(),
            inputs: RVec::new(),
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

    /// Sets the author, whom users may ask.
    #[must_use]
    pub fn author(mut self, author: &str) -> Self {
        self.author = author.into();
        self
    }

    /// Sets the address of a page on the plugin.
    #[must_use]
    pub fn url(mut self, url: &str) -> Self {
        self.url = url.into();
        self
    }

    /// One more parameter.
    #[must_use]
    pub fn param(mut self, param: ParamDesc) -> Self {
        self.params.push(param);
        self
    }

    /// Adds the inputs that the plugin uses.
    #[must_use]
    pub fn consumes(mut self, consumes: Consumes) -> Self {
        let used = consumes.inputs().into_iter().filter(|(_, used, _)| *used);
        self.inputs.extend(used.map(|(id, _, at_least)| InputDesc { id: id.into(), at_least }));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_known_by_ids() {
        let consumes = Consumes {
            handle_regions: true,
            min_handles: 2,
            normals: true,
            graph: true,
            ..Consumes::default()
        };
        let mut inputs = Descriptor::new("x", "X", "1.0.0").consumes(consumes).inputs;
        assert_eq!(Consumes::from_inputs(&inputs), Ok(consumes));
        // An input of a later version: passed over where it is not needed.
        inputs.push(InputDesc { id: "simod.smell/1".into(), at_least: 0 });
        assert_eq!(Consumes::from_inputs(&inputs), Ok(consumes));
        inputs.push(InputDesc { id: "simod.sound/1".into(), at_least: 1 });
        assert_eq!(Consumes::from_inputs(&inputs), Err("simod.sound/1"));
    }
}
