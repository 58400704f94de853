//! A chain of bones that reaches for a place.
//!
//! A. Aristidou, J. Lasenby, *FABRIK: a fast, iterative solver for the inverse kinematics problem*, Graphical
//! Models 73, 2011: its joints are drawn to the target and back to where the chain begins, in turns, with
//! their distances kept. What is left is closed exactly: the chain is bent at one of its joints until its end
//! is as far from its beginning as the target, and then turned there; a chain that is all but straight may
//! stay away by 1e-8 of its length. Where the target is too far, the chain is stretched straight towards it.

use glam::{DQuat, DVec3};

/// There and back so many times at most; the rest is closed exactly.
const TIMES: usize = 300;
/// An end that is so near to its target, as a part of the chain's length, needs no more.
const NEAR: f64 = 1e-12;
/// Chains that are so straight, as a part of their length, are pushed aside by as much, so that they can
/// bend.
const STRAIGHT: f64 = 1e-4;

/// How each bone turns, about its upper end, so that the last one's lower end comes to `target`: from a
/// chain's joints, its beginning first. Nothing turns if the end is there already, but for rounding.
pub fn turns(joints: &[DVec3], target: DVec3) -> Vec<DQuat> {
    let still = vec![DQuat::IDENTITY; joints.len().saturating_sub(1)];
    let (Some(&base), Some(&end)) = (joints.first(), joints.last()) else { return still };
    let lengths: Vec<f64> = joints.windows(2).map(|j| j[0].distance(j[1])).collect();
    let total: f64 = lengths.iter().sum();
    if still.is_empty() || total <= 0.0 || end.distance(target) <= 1e-12 * (total + base.distance(target)) {
        return still;
    }
    let mut moved = joints.to_vec();
    let far = base.distance(target);
    if far >= total {
        let along = (target - base) / far;
        for (i, length) in lengths.iter().enumerate() {
            moved[i + 1] = moved[i] + *length * along;
        }
    } else {
        push_aside(&mut moved, target, total);
        for _ in 0..TIMES {
            draw(&mut moved, &lengths, base, target);
            if moved[lengths.len()].distance(target) <= NEAR * total {
                break;
            }
        }
    }
    let mut turns = follow(joints, &moved);
    close(&mut turns, joints, target);
    turns
}

/// There and back once.
fn draw(joints: &mut [DVec3], lengths: &[f64], base: DVec3, target: DVec3) {
    let last = lengths.len();
    let at = |from: DVec3, to: DVec3, length: f64| from + (to - from).normalize_or_zero() * length;
    joints[last] = target;
    for i in (0..last).rev() {
        joints[i] = at(joints[i + 1], joints[i], lengths[i]);
    }
    joints[0] = base;
    for i in 0..last {
        joints[i + 1] = at(joints[i], joints[i + 1], lengths[i]);
    }
}

/// Pushes joints that are in a line with the target out of it: they would be drawn along this line for ever.
fn push_aside(joints: &mut [DVec3], target: DVec3, total: f64) {
    let base = joints[0];
    let axis = (target - base).normalize_or((joints[joints.len() - 1] - base).normalize_or(DVec3::X));
    let off = |p: &DVec3| (*p - base).reject_from_normalized(axis).length();
    if joints.iter().any(|p| off(p) > STRAIGHT * total) {
        return;
    }
    let aside = axis.any_orthonormal_vector() * STRAIGHT * total;
    let inner = joints.len() - 1;
    joints[1..inner].iter_mut().for_each(|p| *p += aside);
}

/// How bones turn from `from` to `to`: each first along with the one above, and then on the shortest way.
fn follow(from: &[DVec3], to: &[DVec3]) -> Vec<DQuat> {
    let mut turn = DQuat::IDENTITY;
    let bones = from.windows(2).zip(to.windows(2));
    let mut next = |(a, b): (&[DVec3], &[DVec3])| {
        turn = shortest(turn * (a[1] - a[0]), b[1] - b[0]) * turn;
        turn
    };
    bones.map(&mut next).collect()
}

/// The turn on the shortest way; none from or to nowhere.
fn shortest(from: DVec3, to: DVec3) -> DQuat {
    match (from.try_normalize(), to.try_normalize()) {
        (Some(from), Some(to)) => DQuat::from_rotation_arc(from, to).normalize(),
        _ => DQuat::IDENTITY,
    }
}

/// Where the joints of a chain go when its bones turn.
pub fn turned(joints: &[DVec3], turns: &[DQuat]) -> Vec<DVec3> {
    let mut moved = vec![joints[0]];
    for (bone, turn) in joints.windows(2).zip(turns) {
        moved.push(moved[moved.len() - 1] + *turn * (bone[1] - bone[0]));
    }
    moved
}

/// Brings the end to the target exactly, where a bend at one joint and a turn at the first one can.
fn close(turns: &mut [DQuat], joints: &[DVec3], target: DVec3) {
    let moved = turned(joints, turns);
    let (base, end) = (moved[0], moved[moved.len() - 1]);
    let far = base.distance(target);
    // The joint that can do it, with the most to spare on both sides.
    let spare = |k: usize| {
        let (a, b) = (base.distance(moved[k]), end.distance(moved[k]));
        (a + b - far).min(far - (a - b).abs())
    };
    let best = (1..moved.len() - 1).max_by(|a, b| spare(*a).total_cmp(&spare(*b)));
    if let Some(k) = best.filter(|k| spare(*k) >= 0.0) {
        let (upper, lower) = (moved[k] - base, end - moved[k]);
        let (a, b) = (upper.length(), lower.length());
        let normal = upper.cross(lower).try_normalize().unwrap_or_else(|| {
            upper.try_normalize().map_or(DVec3::Z, |along| along.any_orthonormal_vector())
        });
        if a > 0.0 && b > 0.0 {
            // The angle between both parts now, and as it has to be, by the law of cosines for its half: so
            // it keeps its digits where the chain is nearly straight.
            let now = upper.cross(lower).dot(normal).atan2(upper.dot(lower));
            let (open, shut) = ((a + b - far) * (a + b + far), (far - a + b) * (far + a - b));
            let wanted = 2.0 * open.max(0.0).sqrt().atan2(shut.max(0.0).sqrt());
            let bend = DQuat::from_axis_angle(normal, wanted - now);
            turns[k..].iter_mut().for_each(|t| *t = bend * *t);
        }
    }
    let moved = turned(joints, turns);
    let aim = shortest(moved[moved.len() - 1] - base, target - base);
    turns.iter_mut().for_each(|t| *t = aim * *t);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn chain() -> impl Strategy<Value = Vec<DVec3>> {
        let point = prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from);
        prop::collection::vec(point, 2..7)
    }

    fn ends(joints: &[DVec3], target: DVec3) -> (Vec<DVec3>, f64) {
        let moved = turned(joints, &turns(joints, target));
        let far = moved[moved.len() - 1].distance(target);
        (moved, far)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn bones_keep_their_lengths_and_what_can_be_reached_is(
            joints in chain(), target in prop::array::uniform3(-3.0..3.0_f64),
        ) {
            let target = DVec3::from(target);
            let lengths: Vec<f64> = joints.windows(2).map(|j| j[0].distance(j[1])).collect();
            let (total, longest) = (lengths.iter().sum::<f64>(), lengths.iter().copied().fold(0.0, f64::max));
            prop_assume!(lengths.iter().all(|l| *l > 1e-3));
            let (moved, miss) = ends(&joints, target);
            prop_assert!(moved[0] == joints[0]);
            for (bone, length) in moved.windows(2).zip(&lengths) {
                prop_assert!((bone[0].distance(bone[1]) - length).abs() < 1e-12);
            }
            let far = joints[0].distance(target);
            if far >= total {
                prop_assert!((miss - (far - total)).abs() < 1e-9, "stretched: {}", miss);
            } else if far > 2.0 * longest - total {
                prop_assert!(miss < 1e-7 * total, "{miss} from a target that can be reached");
            }
        }

        #[test]
        fn at_its_place_an_end_turns_nothing(joints in chain()) {
            prop_assert!(turns(&joints, joints[joints.len() - 1]).iter().all(|t| *t == DQuat::IDENTITY));
        }
    }

    #[test]
    fn straight_chains_bend() {
        let joints = [0.0, 1.0, 2.0, 3.0].map(|x| DVec3::X * x);
        for x in [2.9, 1.0, 0.3, -2.0] {
            let (moved, miss) = ends(&joints, DVec3::X * x);
            assert!(miss < 1e-9, "{x}: {miss}");
            assert!(moved.iter().all(|p| p.is_finite()));
        }
        let (moved, miss) = ends(&joints, DVec3::ZERO);
        assert!(miss < 1e-9, "back to its beginning: {moved:?}");
    }
}
