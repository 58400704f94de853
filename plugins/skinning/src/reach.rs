//! A chain of bones that reaches for a place.
//!
//! A. Aristidou, J. Lasenby, *FABRIK: a fast, iterative solver for the inverse kinematics problem*, Graphical
//! Models 73, 2011: its joints are drawn to the target and back to where the chain begins, in turns, with
//! their distances kept. The rest of the way is closed exactly: the chain is bent at one of its joints until
//! its end is as far from its beginning as the target, and then turned there; a chain that is all but
//! straight may stay away by 1e-8 of its length. Where no single joint can do that (a long bone that almost
//! cannot fold back far enough), the chain is laid along the sides of a triangle first. Where the target is
//! too far, the chain is stretched straight towards it.

use glam::{DQuat, DVec3};

/// Largest number of passes to the target and back; the rest is closed exactly.
const TIMES: usize = 300;
/// An end that is so near to its target, as a part of the chain's length, needs no more.
const NEAR: f64 = 1e-12;
/// Chains that are so straight, as a part of their length, are pushed aside by as much, so that they can
/// bend.
const STRAIGHT: f64 = 1e-4;

/// Turn of each bone about its upper end, so that the last one's lower end comes to `target`: from a chain's
/// joints, its beginning first. Nothing turns if the end is there already, but for rounding.
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

/// Draws the chain to the target and back, once.
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

/// Turns of bones from `from` to `to`: each first along with the bone above, and then on the shortest way.
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

/// Positions of a chain's joints when its bones turn.
pub fn turned(joints: &[DVec3], turns: &[DQuat]) -> Vec<DVec3> {
    let mut moved = vec![joints[0]];
    for (bone, turn) in joints.windows(2).zip(turns) {
        moved.push(moved[moved.len() - 1] + *turn * (bone[1] - bone[0]));
    }
    moved
}

/// Brings the end to the target exactly, where a bend at one joint and a turn at the first one can.
fn close(turns: &mut Vec<DQuat>, joints: &[DVec3], target: DVec3) {
    let mut moved = turned(joints, turns);
    let far = moved[0].distance(target);
    let mut best = best_bend(&moved, far);
    if best.is_some_and(|(_, spare)| spare < 0.0) {
        *turns = follow(joints, &along_a_triangle(&moved, target));
        moved = turned(joints, turns);
        best = best_bend(&moved, far);
    }
    if let Some((k, _)) = best {
        bend(&mut turns[k..], &moved, k, far);
    }
    let moved = turned(joints, turns);
    let aim = shortest(moved[moved.len() - 1] - moved[0], target - moved[0]);
    turns.iter_mut().for_each(|t| *t = aim * *t);
}

/// The inner joint whose bend brings the end of a chain to the distance `far` from its beginning, with the
/// length that it has to spare on both sides: below zero if no joint can. `None` of a single bone.
fn best_bend(joints: &[DVec3], far: f64) -> Option<(usize, f64)> {
    let (base, end) = (joints[0], joints[joints.len() - 1]);
    let spare = |k: usize| {
        let (a, b) = (base.distance(joints[k]), end.distance(joints[k]));
        (a + b - far).min(far - (a - b).abs())
    };
    (1..joints.len() - 1).map(|k| (k, spare(k))).max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Bends a chain at joint `k`, by the turns of the bones below it, until its end is as near to the distance
/// `far` from its beginning as this joint can bring it.
fn bend(below: &mut [DQuat], joints: &[DVec3], k: usize, far: f64) {
    let (upper, lower) = (joints[k] - joints[0], joints[joints.len() - 1] - joints[k]);
    let (a, b) = (upper.length(), lower.length());
    if a <= 0.0 || b <= 0.0 {
        return;
    }
    let normal = plane_normal(upper, lower);
    // The angle between both parts now, and as it has to be, by the law of cosines for its half: so it keeps
    // its digits where the chain is nearly straight.
    let now = upper.cross(lower).dot(normal).atan2(upper.dot(lower));
    let (open, shut) = ((a + b - far) * (a + b + far), (far - a + b) * (far + a - b));
    let wanted = 2.0 * open.max(0.0).sqrt().atan2(shut.max(0.0).sqrt());
    let bend = DQuat::from_axis_angle(normal, wanted - now);
    below.iter_mut().for_each(|t| *t = bend * *t);
}

/// Unit normal of the plane of two directions; any that is normal to the first if they are parallel.
fn plane_normal(upper: DVec3, lower: DVec3) -> DVec3 {
    upper
        .cross(lower)
        .try_normalize()
        .unwrap_or_else(|| upper.try_normalize().map_or(DVec3::Z, |along| along.any_orthonormal_vector()))
}

/// The joints of a chain of two bones at least that is laid along the sides of a triangle, so that it ends at
/// `target`; if one bone is too long for that, it ends as near as it can.
///
/// Bones and the way to the target are a closed polygon, whose corners can be made straight but for three: if
/// the joint nearest to half of the chain's length allows it, this joint, the beginning and the target;
/// otherwise the bone that holds this half is one side, the bones before it lead straight away from the
/// target, and those behind it are the third.
fn along_a_triangle(joints: &[DVec3], target: DVec3) -> Vec<DVec3> {
    let base = joints[0];
    let lengths: Vec<f64> = joints.windows(2).map(|j| j[0].distance(j[1])).collect();
    let far = base.distance(target);
    let axis = (target - base).normalize_or((joints[joints.len() - 1] - base).normalize_or(DVec3::X));
    let off = joints.iter().map(|p| (*p - base).reject_from_normalized(axis));
    let off = off.max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap_or(DVec3::ZERO);
    let aside = off.normalize_or(axis.any_orthonormal_vector());

    let whole: f64 = lengths.iter().sum();
    let before = |k: usize| lengths[..k].iter().sum::<f64>();
    let uneven = |k: &usize| (2.0 * before(*k) - whole).abs();
    let middle = (1..lengths.len()).min_by(|a, b| uneven(a).total_cmp(&uneven(b))).unwrap_or(1);
    // Number of bones that lead away from the target, and the joint at the triangle's far corner.
    let (away, corner) = if uneven(&middle) <= far {
        (0, middle)
    } else {
        let halfway = (0..lengths.len()).find(|k| 2.0 * before(k + 1) >= whole).unwrap_or(0);
        (halfway, halfway + 1)
    };
    let start = base - before(away) * axis;
    let (a, b, c) = (before(corner) - before(away), whole - before(corner), far + before(away));
    let along = if c > 0.0 { (0.5 * ((a - b) * (a + b) / c + c)).clamp(-a, a) } else { 0.0 };
    let apex = start + along * axis + ((a - along) * (a + along)).max(0.0).sqrt() * aside;
    let mut laid = vec![base];
    for (i, length) in lengths.iter().enumerate() {
        let way = match i {
            i if i < away => -axis,
            i if i < corner => (apex - start).normalize_or(aside),
            _ => (target - apex).normalize_or(-aside),
        };
        laid.push(laid[i] + *length * way);
    }
    laid
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
            } else {
                let least = 2.0 * longest - total - far;
                prop_assert!((miss - least).abs() < 1e-7 * total, "{miss} instead of {least}");
            }
        }

        /// One bone is so long that the others just bring the end back to the target.
        #[test]
        fn a_long_bone_is_folded_back_as_far_as_it_can_be(
            directions in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 2..7),
            (long, spare, towards) in (0..7_usize, -9.0..0.0_f64, prop::array::uniform3(-1.0..1.0_f64)),
        ) {
            let (long, spare) = (long % directions.len(), 10_f64.powf(spare));
            let others = (directions.len() - 1) as f64 * 0.1;
            let mut joints = vec![DVec3::ZERO];
            for (i, way) in directions.iter().enumerate() {
                let length = if i == long { 2.0 * others } else { 0.1 };
                joints.push(joints[i] + length * DVec3::from(*way).normalize_or(DVec3::X));
            }
            let target = DVec3::from(towards).normalize_or(DVec3::Y) * others * (1.0 + spare);
            let (_, miss) = ends(&joints, target);
            prop_assert!(miss < 1e-7 * 3.0 * others, "{miss} from a target that can be reached");
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
