//! The two versions that are compared, and what is known of the pinned one.

use crate::engine::CarriedSamples;
use crate::scene::ViewerScene;
use glam::Vec3;
use simod_core::sampled_model::SampledModel;
use simod_session::edit::Entry;
use std::sync::Arc;

/// One of the two versions that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComparedVersion {
    /// The one that is worked on.
    Now,
    /// The one that is pinned.
    Pinned,
}

/// A version to compare with. Its samples are shared with the scene that they were shown in.
pub(super) struct Pinned {
    /// The version's number, for the engine.
    pub number: u64,
    pub version: Steps,
    /// Whether it is of no use with a step that cannot be done.
    pub whole: bool,
    /// Where it has the samples of the other version, which was refined otherwise.
    pub carried: Option<CarriedSamples>,
    /// What the engine was asked for last: the error to be expected, and where it has these samples.
    pub asked: Option<(bool, Option<Arc<SampledModel>>)>,
}

/// Steps with a name, and the samples that they come to, once these are known.
pub(super) struct Steps {
    pub name: String,
    pub steps: Arc<[Entry]>,
    pub scene: Option<Arc<ViewerScene>>,
}

impl Pinned {
    pub fn scene(&self) -> Option<&Arc<ViewerScene>> {
        self.version.scene.as_ref()
    }

    /// Where it has all samples of a scene, if that is known.
    pub fn carried(&self, onto: &Arc<SampledModel>) -> Option<&Arc<[Vec3]>> {
        let known = self.carried.as_ref().filter(|carried| Arc::ptr_eq(&carried.sampled, onto));
        known.map(|carried| &carried.positions)
    }
}
