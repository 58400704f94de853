//! The two versions that are compared, and the data of the pinned one.

use crate::engine::CarriedSamples;
use crate::scene::ViewerScene;
use glam::Vec3;
use simod_core::sampled_model::SampledModel;
use simod_session::edit::Entry;
use std::sync::Arc;

/// One of the two versions that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComparedVersion {
    /// The version that is worked on.
    Now,
    /// The version that is pinned.
    Pinned,
}

/// A version to compare with. Its samples are shared with the scene that they were shown in.
pub(super) struct Pinned {
    /// The version's number, for the engine.
    pub number: u64,
    pub version: Steps,
    /// Whether the version is of no use with a step that cannot be done.
    pub whole: bool,
    /// Positions in this version of the other version's samples, where that was refined otherwise.
    pub carried: Option<CarriedSamples>,
    /// Last request to the engine: whether the error to be expected is wanted, and the samples whose
    /// positions are.
    pub asked: Option<(bool, Option<Arc<SampledModel>>)>,
}

/// Steps with a name, and the samples that result from them, once these are known.
pub(super) struct Steps {
    pub name: String,
    pub steps: Arc<[Entry]>,
    pub scene: Option<Arc<ViewerScene>>,
}

impl Pinned {
    pub fn scene(&self) -> Option<&Arc<ViewerScene>> {
        self.version.scene.as_ref()
    }

    /// Positions of all samples of a scene in this version, if they are known.
    pub fn carried(&self, onto: &Arc<SampledModel>) -> Option<&Arc<[Vec3]>> {
        let known = self.carried.as_ref().filter(|carried| Arc::ptr_eq(&carried.sampled, onto));
        known.map(|carried| &carried.positions)
    }
}
