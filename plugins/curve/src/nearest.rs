//! Nearest point of a curve to a place: by the nodes of a polyline along the curve, whose pieces are in a
//! tree of boxes, and by Newton's method from there.

use crate::spline::{Spline, WirePoint};
use glam::DVec3;

/// Number of pieces of the polyline in a span of the curve.
pub const PIECES: usize = 16;
/// Greatest number of steps of Newton's method; some five are taken.
const MOST_STEPS: usize = 40;

/// A place on the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Piece of the polyline; the first or last one for places beyond the ends.
    pub piece: u32,
    /// The curve's parameter.
    pub t: f64,
    /// Distance from the given place.
    pub distance: f64,
}

/// A curve whose nearest points are found.
#[derive(Debug)]
pub struct NearestOnCurve {
    curve: Spline,
    nodes: Vec<DVec3>,
    parameters: Vec<f64>,
    /// Boxes of a binary tree over the pieces: those of `i` are in `2 i + 1` and `2 i + 2`.
    boxes: Vec<[DVec3; 2]>,
    /// Whether a place beyond an end is nearest to the straight line that goes on there, or to the end.
    goes_on: bool,
}

impl NearestOnCurve {
    pub fn new(curve: Spline, goes_on: bool) -> Self {
        let spans = curve.spans();
        let parameter = |node: usize| match node {
            _ if node == spans * PIECES => curve.range()[1],
            _ => curve.parameter(node / PIECES, (node % PIECES) as f64 / PIECES as f64),
        };
        let parameters: Vec<f64> = (0..=spans * PIECES).map(parameter).collect();
        let at = |(node, t): (usize, &f64)| curve.evaluate((node / PIECES).min(spans - 1), *t).position;
        let nodes: Vec<DVec3> = parameters.iter().enumerate().map(at).collect();
        let mut found = Self { boxes: Vec::new(), curve, nodes, parameters, goes_on };
        found.boxes = vec![[DVec3::ZERO; 2]; 2 * found.pieces().next_power_of_two()];
        found.bound(0, 0, found.pieces());
        found
    }

    pub fn curve(&self) -> &Spline {
        &self.curve
    }

    /// Number of pieces of the polyline, [`PIECES`] for each span of the curve.
    pub fn pieces(&self) -> usize {
        self.nodes.len() - 1
    }

    /// The polyline's nodes, one more than there are pieces.
    pub fn nodes(&self) -> &[DVec3] {
        &self.nodes
    }

    /// The curve's parameters at the nodes.
    pub fn parameters(&self) -> &[f64] {
        &self.parameters
    }

    /// Point and derivatives of the curve at a place of it.
    pub fn jet(&self, foot: &Foot) -> WirePoint {
        self.curve.evaluate(foot.piece as usize / PIECES, foot.t)
    }

    fn bound(&mut self, cell: usize, first: usize, end: usize) -> [DVec3; 2] {
        let bounds = if end - first == 1 {
            let [a, b] = [self.nodes[first], self.nodes[first + 1]];
            [a.min(b), a.max(b)]
        } else {
            let middle = first.midpoint(end);
            let [a, b] = [self.bound(2 * cell + 1, first, middle), self.bound(2 * cell + 2, middle, end)];
            [a[0].min(b[0]), a[1].max(b[1])]
        };
        if cell >= self.boxes.len() {
            self.boxes.resize(cell + 1, [DVec3::ZERO; 2]);
        }
        self.boxes[cell] = bounds;
        bounds
    }

    /// The place on the curve that is nearest to `p`.
    pub fn find(&self, p: DVec3) -> Foot {
        let mut best = (f64::INFINITY, 0);
        self.search(p, [0, 0, self.pieces()], &mut best);
        let mut foot = self.refined(p, best.1);
        if self.goes_on {
            for (end, piece) in [(0, 0), (1, self.pieces() - 1)] {
                let t_end = self.curve.range()[end];
                let WirePoint { position, first, .. } = self.curve.evaluate(piece / PIECES, t_end);
                let t = t_end + (p - position).dot(first) / first.length_squared();
                let is_beyond = if end == 0 { t < t_end } else { t > t_end };
                let distance = (p - position - (t - t_end) * first).length();
                if is_beyond && distance < foot.distance {
                    foot = Foot { piece: piece as u32, t, distance };
                }
            }
        }
        foot
    }

    /// Nearest piece among `[first, end)`, whose box is `cell`: its squared distance, and its index.
    fn search(&self, p: DVec3, [cell, first, end]: [usize; 3], best: &mut (f64, usize)) {
        if end - first == 1 {
            let [a, b] = [self.nodes[first], self.nodes[first + 1]];
            let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            let distance = p.distance_squared(a + along * (b - a));
            if distance < best.0 {
                *best = (distance, first);
            }
            return;
        }
        let beside = |cell: usize| p.distance_squared(p.clamp(self.boxes[cell][0], self.boxes[cell][1]));
        let middle = first.midpoint(end);
        let halves =
            [[2 * cell + 1, first, middle], [2 * cell + 2, middle, end]].map(|half| (beside(half[0]), half));
        let nearer = usize::from(halves[1].0 < halves[0].0);
        for (beside, half) in [halves[nearer], halves[1 - nearer]] {
            if beside < best.0 {
                self.search(p, half, best);
            }
        }
    }

    /// Nearest place around a piece: Newton's method for the place where the curve is at right angles to
    /// the way to `p`, held between the pieces before and behind.
    fn refined(&self, p: DVec3, piece: usize) -> Foot {
        let jet = |t: f64| {
            let piece = self.piece(piece, t);
            (self.curve.evaluate(piece / PIECES, t), piece)
        };
        let slope = |jet: &WirePoint| (jet.position - p).dot(jet.first);
        let [mut low, mut high] =
            [self.parameters[piece.saturating_sub(1)], self.parameters[(piece + 2).min(self.pieces())]];
        let foot = |t: f64| {
            let (jet, piece) = jet(t);
            Foot { piece: piece as u32, t, distance: jet.position.distance(p) }
        };
        // The place is an end of the curve, or a bend without such a place between.
        if slope(&jet(low).0) >= 0.0 || slope(&jet(high).0) <= 0.0 {
            let [a, b] = [foot(low), foot(high)];
            return if a.distance <= b.distance { a } else { b };
        }
        let mut t = self.parameters[piece].midpoint(self.parameters[piece + 1]);
        for _ in 0..MOST_STEPS {
            let (jet, _) = jet(t);
            let slope = slope(&jet);
            if slope > 0.0 {
                high = t;
            } else {
                low = t;
            }
            let bend = jet.first.length_squared() + (jet.position - p).dot(jet.second);
            let newton = t - slope / bend;
            let next = if bend > 0.0 && newton > low && newton < high { newton } else { low.midpoint(high) };
            let is_done = (next - t).abs() <= 1e-15 * (1.0 + t.abs());
            t = next;
            if is_done {
                break;
            }
        }
        foot(t)
    }

    /// Piece that a parameter lies in, at or beside the given one.
    fn piece(&self, near: usize, t: f64) -> usize {
        let from = near.saturating_sub(1);
        let to = (near + 1).min(self.pieces() - 1);
        (from..to).find(|piece| t < self.parameters[piece + 1]).unwrap_or(to)
    }
}
