//! Poses of the joints: by their handles, and by the places that ends reach for.

use crate::reach::{turned, turns};
use crate::skeleton::Skeleton;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use simod_geometry::affine_map;
use simod_plugin_api::{Affine, Gizmo, HandleDesc, PluginError, PluginResult};

/// End of the id of a handle for which a joint reaches.
pub const REACH: &str = "/reach";

/// The joints that can reach for a place of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reaching {
    /// Joints that no other hangs on.
    Ends,
    /// All joints that hang on one.
    All,
    /// No joints.
    None,
}

/// Handles of a skeleton: its joints, and after them the places that joints reach for.
pub struct Handles {
    /// The joints that reach.
    reaching: Vec<usize>,
}

impl Handles {
    /// The handles of a skeleton, of which these joints reach.
    pub fn new(skeleton: &Skeleton, which: Reaching) -> Self {
        let joints = skeleton.joints.iter().enumerate();
        let reaches = |joint: &crate::skeleton::Joint| match which {
            Reaching::Ends => joint.is_end(),
            Reaching::All => joint.parent.is_some(),
            Reaching::None => false,
        };
        Self { reaching: joints.filter(|(_, j)| reaches(j)).map(|(i, _)| i).collect() }
    }

    /// Handles as the host knows them.
    pub fn describe(&self, skeleton: &Skeleton) -> Vec<HandleDesc> {
        let mut handles: Vec<HandleDesc> = Vec::new();
        for joint in &skeleton.joints {
            let handle = HandleDesc::new(&joint.id, joint.at.into());
            let turns = Gizmo::ROTATE | Gizmo::TRANSLATE | Gizmo::SCALE;
            let handle = handle.gizmo(if joint.is_end() { Gizmo::TRANSLATE } else { turns });
            handles.push(match joint.parent {
                Some(parent) => handle.parent(parent as u32),
                None => handle,
            });
        }
        for joint in self.reaching.iter().map(|j| &skeleton.joints[*j]) {
            let name = format!("{} reaches", joint.id);
            handles.push(HandleDesc::new(&format!("{}{REACH}", joint.id), joint.at.into()).name(&name));
        }
        handles
    }

    /// Motion of each joint's bones: as the handles say, and then, one after the other, so that ends come to
    /// where they are wanted. A chain is of `length` bones at most, and ends below a joint that several hang
    /// on.
    ///
    /// # Errors
    /// There are not as many motions as handles.
    pub fn pose(
        &self,
        skeleton: &Skeleton,
        motions: &[Affine],
        length: Option<usize>,
    ) -> PluginResult<Vec<DAffine3>> {
        let count = skeleton.joints.len();
        if motions.len() != count + self.reaching.len() {
            let message = format!("{} motions of {} joints", motions.len(), count);
            return Err(PluginError::internal(message));
        }
        let given: Vec<DAffine3> = motions.iter().map(|map| affine_map(&map.rows)).collect();
        // The motion of a handle includes that of the handle above. An end has no bone, and goes along with
        // the bone above.
        let mut posed: Vec<DAffine3> = given[..count].to_vec();
        let mut wanted: Vec<(usize, DVec3)> = Vec::new();
        for (i, joint) in skeleton.joints.iter().enumerate() {
            if let Some(parent) = joint.parent.filter(|_| joint.is_end()) {
                posed[i] = given[parent];
                if given[i] != given[parent] {
                    wanted.push((i, given[i].transform_point3(joint.at)));
                }
            }
        }
        // Places that an end's own handle asks for come after those of the posed skeleton, and in their
        // stead.
        for (joint, motion) in self.reaching.iter().zip(&given[count..]) {
            if *motion != DAffine3::IDENTITY {
                wanted.retain(|(other, _)| other != joint);
                wanted.push((*joint, motion.transform_point3(skeleton.joints[*joint].at)));
            }
        }
        for (end, target) in wanted {
            reach(skeleton, &mut posed, end, target, length);
        }
        Ok(posed)
    }
}

/// The joints of the chain that ends in one, from its beginning on.
fn chain(skeleton: &Skeleton, end: usize, length: Option<usize>) -> Vec<usize> {
    let branches = |joint: usize| skeleton.joints[joint].children.len() > 1;
    let mut chain = vec![end];
    let mut next = skeleton.joints[end].parent;
    while let Some(joint) = next {
        // An end that hangs on a branch directly turns the branch; longer chains end below it.
        let is_alone = chain.len() == 1;
        if (branches(joint) && !is_alone) || length.is_some_and(|most| chain.len() > most) {
            break;
        }
        chain.push(joint);
        next = skeleton.joints[joint].parent.filter(|_| !branches(joint));
    }
    chain.reverse();
    chain
}

/// Bends a chain so that its end comes to the target, and takes along the bones that hang on it.
fn reach(skeleton: &Skeleton, posed: &mut [DAffine3], end: usize, target: DVec3, length: Option<usize>) {
    let chain = chain(skeleton, end, length);
    let joints: Vec<DVec3> =
        chain.iter().map(|j| posed[*j].transform_point3(skeleton.joints[*j].at)).collect();
    let turns = turns(&joints, target);
    if turns.iter().all(|t| *t == DQuat::IDENTITY) {
        return;
    }
    // Each bone's change, and so that of all that hangs on it.
    let mut changes: Vec<Option<DAffine3>> = vec![None; posed.len()];
    let moved = turned(&joints, &turns);
    for (i, turn) in turns.iter().enumerate() {
        let matrix3 = DMat3::from_quat(*turn);
        changes[chain[i]] = Some(DAffine3 { matrix3, translation: moved[i] - matrix3 * joints[i] });
    }
    for (i, joint) in skeleton.joints.iter().enumerate() {
        if changes[i].is_none() {
            changes[i] = joint.parent.and_then(|p| changes[p]);
        }
        if let Some(change) = changes[i] {
            posed[i] = change * posed[i];
        }
    }
}
