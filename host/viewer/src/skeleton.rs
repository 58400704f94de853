//! Skeletons of the user's: joints mirrored from one side of the body to the other, chains of them, and pins.
//!
//! A pin is a joint without a parent and without children, which nobody moves: the body around it stays. As
//! long as a skeleton is that of a limb alone, pins in the middle of the body keep that from turning along.

use crate::body::Ball;
use glam::DVec3;
use simod_session::step::Joint;

/// The words by which sides are told in names, in pairs.
const SIDES: [[&str; 2]; 4] = [["left", "right"], ["Left", "Right"], [".L", ".R"], ["_l", "_r"]];

/// Beginning of the ids of pins.
const PIN: &str = "pin-";

/// Beginning of the ids of pins that hold the body.
const BODY: &str = "pin-body-";

/// Whether a joint of this id is a pin.
pub fn is_pin(id: &str) -> bool {
    id.starts_with(PIN)
}

/// Id of a joint, or of a pin, that no joint has.
pub fn free_id(joints: &[Joint], pin: bool) -> String {
    let word = if pin { PIN } else { "joint-" };
    let is_free = |id: &String| joints.iter().all(|joint| joint.id != *id);
    (1..).map(|i| format!("{word}{i}")).find(is_free).unwrap_or_default()
}

/// Joints with a pin in the middle of each ball of the body, if no bone is in any ball; without such pins,
/// if a bone is, or there are no joints besides.
pub fn with_body_held(mut joints: Vec<Joint>, body: &[Ball]) -> Vec<Joint> {
    joints.retain(|joint| !joint.id.starts_with(BODY));
    let place = |id: &String| joints.iter().find(|joint| joint.id == *id).map(|joint| joint.at);
    let is_within = |joint: &Joint| {
        let upper = joint.parent.as_ref().and_then(place).unwrap_or(joint.at);
        body.iter().any(|ball| ball.holds_some_of([upper, joint.at]))
    };
    let limbs = || joints.iter().filter(|joint| !is_pin(&joint.id));
    if limbs().next().is_some() && !limbs().any(is_within) {
        let pin =
            |(i, ball): (usize, &Ball)| Joint { id: format!("{BODY}{i}"), at: ball.center, parent: None };
        joints.extend((1..).zip(body).map(pin));
    }
    joints
}

/// Name on the other side: `left-hand` of `right-hand`; with a word added where no word tells the side.
pub fn mirrored_name(name: &str) -> String {
    for [a, b] in SIDES {
        for (from, to) in [(a, b), (b, a)] {
            // Short words tell a side at the end of a name alone.
            let at = if from.len() > 2 { name.find(from) } else { name.strip_suffix(from).map(str::len) };
            if let Some(at) = at {
                return format!("{}{to}{}", &name[..at], &name[at + from.len()..]);
            }
        }
    }
    match name.strip_suffix("-mirrored") {
        Some(first) => first.to_owned(),
        None => format!("{name}-mirrored"),
    }
}

/// Joints with those of one side on the other one as well, across the plane where the coordinate `axis` is
/// `middle`; joints nearer to the plane than `near` lie in the middle, and have no counterpart. A
/// counterpart is added where no joint has the mirrored name; where one has, the joint of the two that comes
/// first in the list gives the other one its place.
pub fn mirrored(joints: &[Joint], axis: usize, middle: f64, near: f64) -> Vec<Joint> {
    let is_aside = |joint: &Joint| (joint.at[axis] - middle).abs() > near;
    let mut all = joints.to_vec();
    let mut done: Vec<String> = Vec::new();
    for joint in joints.iter().filter(|joint| is_aside(joint) && !joint.id.starts_with(BODY)) {
        if done.contains(&joint.id) {
            continue;
        }
        let id = mirrored_name(&joint.id);
        let mut at: DVec3 = joint.at;
        at[axis] = 2.0 * middle - at[axis];
        let hangs_aside = |parent: &String| joints.iter().any(|j| j.id == *parent && is_aside(j));
        let parent = joint.parent.as_ref();
        let parent = parent.map(|p| if hangs_aside(p) { mirrored_name(p) } else { p.clone() });
        match all.iter_mut().find(|other| other.id == id) {
            Some(other) => other.at = at,
            None => all.push(Joint { id: id.clone(), at, parent }),
        }
        done.push(id);
    }
    all
}

/// Adds a chain of joints at these places, with names that are free, the first on `parent`, behind the
/// joints that are there.
pub fn chained(joints: &[Joint], places: &[DVec3], parent: Option<String>) -> Vec<Joint> {
    let mut all = joints.to_vec();
    let mut parent = parent;
    for at in places {
        let id = free_id(&all, false);
        all.push(Joint { id: id.clone(), at: *at, parent: parent.replace(id) });
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(id: &str, at: [f64; 3], parent: Option<&str>) -> Joint {
        Joint { id: id.into(), at: at.into(), parent: parent.map(str::to_owned) }
    }

    #[test]
    fn names_have_another_side() {
        for (a, b) in
            [("left-hand", "right-hand"), ("hand.L", "hand.R"), ("arm_l", "arm_r"), ("a", "a-mirrored")]
        {
            assert_eq!((&*mirrored_name(a), &*mirrored_name(b)), (b, a));
        }
        // Letters within a word tell no side.
        assert_eq!(mirrored_name("t_leg"), "t_leg-mirrored");
    }

    #[test]
    fn an_arm_is_mirrored_onto_the_spine() {
        let one = [
            joint("spine", [1.001, 0.0, 0.0], None),
            joint("left-arm", [2.0, 1.0, 0.5], Some("spine")),
            joint("left-hand", [3.0, 1.0, 0.5], Some("left-arm")),
        ];
        let both = mirrored(&one, 0, 1.0, 0.01);
        assert_eq!(both[..3], one);
        assert_eq!(both[3], joint("right-arm", [0.0, 1.0, 0.5], Some("spine")));
        assert_eq!(both[4], joint("right-hand", [-1.0, 1.0, 0.5], Some("right-arm")));
        // A second mirroring changes nothing; a side that was moved since takes the other along.
        assert_eq!(mirrored(&both, 0, 1.0, 0.01), both);
        let mut moved = both.clone();
        moved[2].at.y = 7.0;
        assert_eq!(mirrored(&moved, 0, 1.0, 0.01)[4].at.y, 7.0);
        assert!(mirrored(&[], 1, 0.0, 0.1).is_empty());
    }

    #[test]
    fn the_body_is_held_as_long_as_no_bone_is_in_it() {
        let body = [DVec3::ZERO, DVec3::Y * 1.5].map(|center| Ball { center, radius: 1.0 });
        let arm =
            vec![joint("joint-1", [3.0, 0.0, 0.0], None), joint("joint-2", [5.0, 0.0, 0.0], Some("joint-1"))];
        let held = with_body_held(arm.clone(), &body);
        assert_eq!(held[..2], arm);
        assert_eq!(held[2], joint("pin-body-1", [0.0; 3], None));
        assert_eq!(held[3..], [joint("pin-body-2", [0.0, 1.5, 0.0], None)]);
        assert_eq!(with_body_held(held.clone(), &body), held);
        assert_eq!(mirrored(&held, 0, 7.0, 0.1).iter().filter(|joint| is_pin(&joint.id)).count(), 2);
        // A bone through the body, with no joint in it.
        let across = [held, vec![joint("joint-3", [-3.0, 0.2, 0.0], Some("joint-1"))]].concat();
        assert!(with_body_held(across, &body).iter().all(|joint| !is_pin(&joint.id)));
        // Pins alone cannot turn the body.
        let pin = vec![joint(&free_id(&[], true), [3.0, 0.0, 0.0], None)];
        assert_eq!(with_body_held(pin.clone(), &body), pin);
        assert_eq!(free_id(&arm, false), "joint-3");
    }

    #[test]
    fn a_chain_goes_on_from_its_parent() {
        let one = [joint("joint-2", [0.0; 3], None)];
        let all = chained(&one, &[DVec3::X, DVec3::Y], Some("joint-2".into()));
        assert_eq!(all[1], joint("joint-1", [1.0, 0.0, 0.0], Some("joint-2")));
        assert_eq!(all[2], joint("joint-3", [0.0, 1.0, 0.0], Some("joint-1")));
    }
}
