//! Deformation of space by a wire: each place goes along with the nearest place of the curve, which is
//! moved and turned.
//!
//! K. Singh, E. Fiume, *Wires: a geometric deformation technique*, SIGGRAPH 1998, §2. There the turn at
//! each place of the curve is the least one between the two tangents, which jumps where these come to
//! oppose each other. Here frames that do not turn about the curve are carried along both curves (W. Wang,
//! B. Jüttler, D. Zheng, Y. Liu, *Computation of rotation minimizing frames*, TOG 2008, double reflection),
//! so that a wire can be bent to a knot; the turn of these frames about the curve, between parts that are
//! as they were, is taken back where the curve bends.

use crate::nearest::{Foot, NearestOnCurve, PIECES};
use crate::spline::{Spline, WirePoint};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::TAU;

/// Turn in radians below which it is rounding.
const LEAST_TURN: f64 = 1e-12;

/// Effects of a wire: the distances within which its motion is made, twist and volume.
#[derive(Debug, Clone, Copy)]
pub struct WireEffects {
    /// Distance from the curve up to which all goes along as a whole.
    pub whole: f64,
    /// Distance from the curve from which on nothing moves.
    pub reach: f64,
    /// The turn about the curve from its beginning to its end, in radians.
    pub twist: f64,
    /// Whether a part that is stretched along the curve gets thinner.
    pub keeps_volume: bool,
}

/// Number along the curve by its values and slopes at the nodes.
struct WireNumber {
    values: Vec<f64>,
    slopes: Vec<f64>,
}

/// A wire that has been moved.
pub struct WireMotion<'a> {
    rest: &'a NearestOnCurve,
    moved: Spline,
    /// Both curves at the nodes.
    nodes: Vec<[WirePoint; 2]>,
    /// Directions across the two curves, at the nodes, that do not turn about them.
    across: [Vec<DVec3>; 2],
    /// Angle by which the moved curve has been bent from its beginning on, in radians.
    bent: WireNumber,
    /// Length along the curve at rest, from its beginning on.
    length: WireNumber,
    /// Whole turn about the curve that is taken back.
    taken_back: f64,
    /// Turns at the nodes as vectors, which are continued beyond half a turn.
    turns: Vec<DVec3>,
    looks: WireEffects,
}

impl<'a> WireMotion<'a> {
    /// Motion that takes the points of a wire at rest to as many others.
    pub fn new(rest: &'a NearestOnCurve, moved: Spline, looks: WireEffects) -> Self {
        let nodes = rest.pieces() + 1;
        let none = || WireNumber { values: vec![0.0; nodes], slopes: vec![0.0; nodes] };
        let across = [Vec::with_capacity(nodes), Vec::with_capacity(nodes)];
        let (bent, length) = (none(), none());
        let mut motion = Self {
            rest,
            moved,
            nodes: Vec::new(),
            across,
            bent,
            length,
            taken_back: 0.0,
            turns: Vec::new(),
            looks,
        };
        motion.nodes = (0..nodes).map(|node| motion.jets(&motion.at_node(node))).collect();
        motion.carry_frames();
        let turns: Vec<DQuat> =
            (0..nodes).map(|node| motion.carried(&motion.at_node(node), &motion.nodes[node])).collect();
        let steps = turns.windows(2).map(|pair| between(pair[0], pair[1]).length());
        motion.bent = motion.along(steps.collect());
        let steps = rest.nodes().windows(2).map(|pair| pair[0].distance(pair[1]));
        motion.length = motion.along(steps.collect());
        motion.taken_back = motion.to_take_back();
        for node in 0..nodes {
            let turn = motion.turn(&motion.at_node(node), &motion.nodes[node]);
            motion.turns.push(as_vector(turn, motion.turns.last().copied().unwrap_or(DVec3::ZERO)));
        }
        motion
    }

    /// Image of a place of space whose nearest place of the curve at rest is `foot`.
    pub fn apply(&self, p: DVec3, foot: &Foot) -> DVec3 {
        let part = self.part(foot.distance);
        if part == 0.0 {
            return p;
        }
        let jets = self.jets(foot);
        let [rest, moved] = jets;
        let turn = as_vector(self.turn(foot, &jets), self.turns[foot.piece as usize]);
        let shift = moved.position - rest.position;
        let [before, behind] = [rest.first.length(), moved.first.length()];
        let wider = if self.looks.keeps_volume && behind > 0.0 { (before / behind).sqrt() } else { 1.0 };
        let is_turned = turn.length() > LEAST_TURN;
        if !is_turned && shift == DVec3::ZERO && (wider - 1.0).abs() < LEAST_TURN {
            return p;
        }
        let mut offset = p - rest.position;
        if (wider - 1.0).abs() >= LEAST_TURN {
            offset *= 1.0 + (wider - 1.0) * part;
        }
        if is_turned {
            offset = DQuat::from_scaled_axis(part * turn) * offset;
        }
        rest.position + part * shift + offset
    }

    /// Part of the motion that is made at a distance from the curve: 1 up to the distance `whole`, and then
    /// Singh and Fiume's density function.
    fn part(&self, distance: f64) -> f64 {
        let WireEffects { whole, reach, .. } = self.looks;
        if distance <= whole {
            return 1.0;
        }
        if distance >= reach {
            return 0.0;
        }
        let u = (distance - whole) / (reach - whole);
        (1.0 - u * u).powi(2)
    }

    fn at_node(&self, node: usize) -> Foot {
        let piece = node.min(self.rest.pieces() - 1);
        Foot { piece: piece as u32, t: self.rest.parameters()[node], distance: 0.0 }
    }

    fn jets(&self, foot: &Foot) -> [WirePoint; 2] {
        [self.rest.jet(foot), self.moved.evaluate(foot.piece as usize / PIECES, foot.t)]
    }

    /// Finds the directions across both curves at the nodes.
    fn carry_frames(&mut self) {
        let [rest, moved] = self.nodes[0].map(|jet| direction(&jet, DVec3::X));
        let across = rest.any_orthonormal_vector();
        self.across[0].push(across);
        self.across[1].push(DQuat::from_rotation_arc(rest, moved) * across);
        for node in 1..=self.rest.pieces() {
            for i in 0..2 {
                let [from, to] = [self.nodes[node - 1][i], self.nodes[node][i]];
                let new = carried(&from, self.across[i][node - 1], &to);
                self.across[i].push(new);
            }
        }
    }

    /// The turn from the curve at rest to the moved one by the frames that were carried along, at a place
    /// where the curves are `to`.
    fn carried(&self, foot: &Foot, to: &[WirePoint; 2]) -> DQuat {
        let piece = foot.piece as usize;
        let from = &self.nodes[piece];
        let frame = |i: usize| {
            let across = carried(&from[i], self.across[i][piece], &to[i]);
            let along = direction(&to[i], direction(&from[i], DVec3::X));
            DMat3::from_cols(along, across, along.cross(across))
        };
        DQuat::from_mat3(&(frame(1) * frame(0).transpose())).normalize()
    }

    /// The turn at a place of the curve, where both curves are `jets`.
    fn turn(&self, foot: &Foot, jets: &[WirePoint; 2]) -> DQuat {
        let about = self.looks.twist * self.part_along(&self.length, foot)
            - self.taken_back * self.part_along(&self.bent, foot);
        let turn = self.carried(foot, jets);
        if about == 0.0 {
            return turn;
        }
        let along = direction(&jets[0], DVec3::X);
        turn * DQuat::from_axis_angle(along, about)
    }

    /// Turn about the curve, at its end, by which the frames that were carried along differ from the least
    /// turn between the tangents: nothing should turn where the curve is as it was. The more the tangents
    /// oppose each other, the less this turn counts.
    fn to_take_back(&self) -> f64 {
        let end = self.rest.pieces();
        let jets = &self.nodes[end];
        let [rest, moved] = jets.map(|jet| direction(&jet, DVec3::X));
        let least = DQuat::from_rotation_arc(rest, moved);
        let about =
            as_vector(least.conjugate() * self.carried(&self.at_node(end), jets), DVec3::ZERO).dot(rest);
        about * rest.dot(moved).midpoint(1.0)
    }

    /// Sums of the pieces' numbers along the curve.
    fn along(&self, pieces: Vec<f64>) -> WireNumber {
        let parameters = self.rest.parameters();
        let rate = |piece: usize| pieces[piece] / (parameters[piece + 1] - parameters[piece]);
        let last = pieces.len() - 1;
        let slopes = (0..=pieces.len()).map(|node| {
            let [before, behind] = [rate(node.saturating_sub(1)), rate(node.min(last))];
            // The slope is zero where nothing happens on one side, so that it stays so.
            if before == 0.0 || behind == 0.0 { 0.0 } else { before.midpoint(behind) }
        });
        let slopes = slopes.collect();
        let mut values = vec![0.0];
        for piece in &pieces {
            values.push(values[values.len() - 1] + piece);
        }
        WireNumber { values, slopes }
    }

    /// Part of the whole that a sum has come to at a place.
    fn part_along(&self, sum: &WireNumber, foot: &Foot) -> f64 {
        let piece = foot.piece as usize;
        let whole = sum.values[sum.values.len() - 1];
        let [start, end] = self.rest.curve().range();
        if whole == 0.0 || foot.t <= start {
            return 0.0;
        }
        if foot.t >= end {
            return 1.0;
        }
        let [from, to] = [self.rest.parameters()[piece], self.rest.parameters()[piece + 1]];
        let h = to - from;
        let u = (foot.t - from) / h;
        let ([p, q], [m, n]) =
            ([sum.values[piece], sum.values[piece + 1]], [sum.slopes[piece], sum.slopes[piece + 1]]);
        let (a, b) = (2.0 * (p - q) + h * (m + n), 3.0 * (q - p) - h * (2.0 * m + n));
        (((a * u + b) * u + h * m) * u + p) / whole
    }
}

/// Unit tangent; `otherwise` where the curve stands still.
fn direction(jet: &WirePoint, otherwise: DVec3) -> DVec3 {
    jet.first.try_normalize().unwrap_or(otherwise)
}

/// Direction across a curve carried along it, to a place near by: double reflection.
fn carried(from: &WirePoint, across: DVec3, to: &WirePoint) -> DVec3 {
    let tangent = direction(from, DVec3::X);
    let goal = direction(to, tangent);
    let reflected = |v: DVec3, plane: DVec3| {
        let squared = plane.length_squared();
        if squared > 0.0 { v - 2.0 / squared * v.dot(plane) * plane } else { v }
    };
    let way = to.position - from.position;
    let new = if way.length_squared() > 0.0 {
        let [tangent, across] = [tangent, across].map(|v| reflected(v, way));
        reflected(across, goal - tangent)
    } else {
        across
    };
    // The direction is put at right angles again, against rounding.
    (new - new.dot(goal) * goal).try_normalize().unwrap_or_else(|| goal.any_orthonormal_vector())
}

/// The turn from one orientation to another, as a vector of its angle's length.
fn between(from: DQuat, to: DQuat) -> DVec3 {
    as_vector(to * from.conjugate(), DVec3::ZERO)
}

/// Turn as a vector along its axis of its angle's length: among those that differ by whole turns, the one
/// next to another vector.
fn as_vector(turn: DQuat, near: DVec3) -> DVec3 {
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let sine = turn.xyz().length();
    let angle = 2.0 * sine.atan2(turn.w);
    let Some(axis) = turn.xyz().try_normalize().filter(|_| sine > LEAST_TURN) else {
        // The turn is none, or whole ones.
        let turns = (near.length() / TAU).round();
        return turns * TAU * near.normalize_or_zero();
    };
    axis * (angle + TAU * ((near.dot(axis) - angle) / TAU).round())
}
