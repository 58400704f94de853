//! Skeletons of the user's: joints mirrored from one side of the body to the other, and chains of them.

use glam::DVec3;
use simod_session::session_file::Joint;

/// The words by which sides are told in names, in pairs.
const SIDES: [[&str; 2]; 4] = [["left", "right"], ["Left", "Right"], [".L", ".R"], ["_l", "_r"]];

/// The name on the other side: `left-hand` of `right-hand`; with a word of its own where none tells the side.
pub fn mirrored_name(name: &str) -> String {
    for [a, b] in SIDES {
        for (from, to) in [(a, b), (b, a)] {
            // Short ones tell a side at the end alone.
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

/// The joints with those of one side on the other one as well, across the plane where the coordinate `axis` is `middle`;
/// those nearer to it than `near` lie in the middle, and have no other. A side is mirrored where a joint of its own name
/// is not on the other one yet; where joints are on both, those of the first named are what the others become.
pub fn mirrored(joints: &[Joint], axis: usize, middle: f64, near: f64) -> Vec<Joint> {
    let is_aside = |joint: &Joint| (joint.at[axis] - middle).abs() > near;
    let mut all = joints.to_vec();
    let mut done: Vec<String> = Vec::new();
    for joint in joints.iter().filter(|joint| is_aside(joint)) {
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

/// So many joints that hang on each other, with names that are free, the first on `parent`; behind those that are there.
pub fn chained(joints: &[Joint], places: &[DVec3], parent: Option<String>) -> Vec<Joint> {
    let mut all = joints.to_vec();
    let mut parent = parent;
    for at in places {
        let is_free = |id: &String| all.iter().all(|joint| joint.id != *id);
        let Some(id) = (1..).map(|i| format!("joint-{i}")).find(is_free) else { break };
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
        // Once more changes nothing; a side that was moved since takes the other along.
        assert_eq!(mirrored(&both, 0, 1.0, 0.01), both);
        let mut moved = both.clone();
        moved[2].at.y = 7.0;
        assert_eq!(mirrored(&moved, 0, 1.0, 0.01)[4].at.y, 7.0);
        assert!(mirrored(&[], 1, 0.0, 0.1).is_empty());
    }

    #[test]
    fn a_chain_goes_on_from_its_parent() {
        let one = [joint("joint-2", [0.0; 3], None)];
        let all = chained(&one, &[DVec3::X, DVec3::Y], Some("joint-2".into()));
        assert_eq!(all[1], joint("joint-1", [1.0, 0.0, 0.0], Some("joint-2")));
        assert_eq!(all[2], joint("joint-3", [0.0, 1.0, 0.0], Some("joint-1")));
    }
}
