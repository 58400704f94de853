//! Basis functions along one axis of the lattice, and their continuation beyond its ends.
//!
//! B-splines over uniform knots which are repeated at both ends, so that the control points at the ends are
//! met (L. Piegl, W. Tiller, *The NURBS Book*, 1997, algorithm A2.2). With one control point more than the
//! degree they are Bernstein's polynomials.

/// Most control points along an axis.
pub const MOST: usize = 32;

/// Continuation of the functions outside of `[0, 1]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beyond {
    /// The functions have their values at the nearer end.
    Clamped,
    /// The functions go on along their tangents and fade to nothing over this distance: continuous with their
    /// derivatives.
    Smooth {
        /// Distance in units of the axis' length; above 0.
        reach: f64,
    },
}

/// The basis functions of an axis, whose parameter runs from 0 to 1.
#[derive(Debug, Clone)]
pub struct Basis {
    count: usize,
    degree: usize,
    beyond: Beyond,
    /// Knots, in units of their distance.
    knots: Vec<f64>,
    /// Inverse lengths of the intervals by which the recurrence divides, in the recurrence's order, span by
    /// span.
    inverses: Vec<f64>,
}

/// The functions that may be other than zero at some parameter: those from `first` on.
#[derive(Debug, Clone, Copy)]
pub struct BasisWeights<'v> {
    pub first: usize,
    pub values: &'v [f64],
}

/// Place of a parameter: inside, or beyond one of the ends.
#[derive(Debug, Clone, Copy)]
pub struct KnotPosition {
    /// The nearest parameter inside.
    pub inside: f64,
    /// Factor of the functions inside.
    pub fade: f64,
    /// Number that is then taken off the second function, and added to the first one; not less than 0.
    pub below: f64,
    /// Number that is then taken off the last function but one, and added to the last one; not less than 0.
    pub above: f64,
}

impl Basis {
    /// Bernstein's polynomials of the highest degree, for 2 to [`MOST`] control points.
    pub fn bernstein(count: usize, beyond: Beyond) -> Self {
        Self::new(count, count - 1, beyond)
    }

    /// Cubic B-splines, or of a lower degree where there are less than 4 control points.
    pub fn b_spline(count: usize, beyond: Beyond) -> Self {
        Self::new(count, (count - 1).min(3), beyond)
    }

    fn new(count: usize, degree: usize, beyond: Beyond) -> Self {
        let spans = count - degree;
        let knots: Vec<f64> =
            (0..=count + degree).map(|i| i.saturating_sub(degree).min(spans) as f64).collect();
        let mut inverses = Vec::with_capacity(spans * degree * (degree + 1) / 2);
        for first in 0..spans {
            for k in 1..=degree {
                let ends = (0..k).map(|r| [first + degree + 1 + r - k, first + degree + 1 + r]);
                inverses.extend(ends.map(|[left, right]| (knots[right] - knots[left]).recip()));
            }
        }
        Self { count, degree, beyond, knots, inverses }
    }

    /// The number of control points.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether all functions reach everywhere.
    pub fn is_global(&self) -> bool {
        self.degree + 1 == self.count
    }

    fn spans(&self) -> usize {
        self.count - self.degree
    }

    /// Place of control point `i` at rest, so that `Σ B_i(u) place_i = u`: Greville's abscissa.
    pub fn place_of(&self, i: usize) -> f64 {
        let knots = &self.knots[i + 1..=i + self.degree];
        knots.iter().sum::<f64>() / (self.degree * self.spans()) as f64
    }

    /// Place of a parameter, which may be any finite number.
    #[inline(always)]
    pub fn place(&self, u: f64) -> KnotPosition {
        if (0.0..=1.0).contains(&u) {
            return KnotPosition { inside: u, fade: 1.0, below: 0.0, above: 0.0 };
        }
        self.place_of_many(u)
    }

    /// Place of a parameter without a branch, for loops over many parameters; the same to the bit as
    /// [`place`](Self::place).
    #[inline(always)]
    pub fn place_of_many(&self, u: f64) -> KnotPosition {
        let inside = u.clamp(0.0, 1.0);
        let over = u - inside;
        let Beyond::Smooth { reach } = self.beyond else {
            return KnotPosition { inside, fade: 1.0, below: 0.0, above: 0.0 };
        };
        let t = (over.abs() / reach).min(1.0);
        let left = 1.0 - t;
        let fade = left * left * (1.0 + 2.0 * t);
        // At an end only the outermost function and the one beside it change: their slope is the degree
        // over the distance of knots. The continuation is bent back soon: where the outer control points
        // rest and the next ones do not, it is a groove beside the face.
        let slope = (self.degree * self.spans()) as f64;
        let along = over * slope * left * left * left;
        KnotPosition { inside, fade, below: (-along).max(0.0), above: along.max(0.0) }
    }

    /// Number of functions that are not zero at a parameter.
    pub fn width(&self) -> usize {
        self.degree + 1
    }

    /// The functions' values, which are written into `values`, at least [`width`](Self::width) numbers.
    #[inline(always)]
    pub fn values_at<'v>(&self, u: f64, values: &'v mut [f64]) -> BasisWeights<'v> {
        let place = self.place(u);
        let (degree, t) = (self.degree, place.inside * self.spans() as f64);
        let first = (t as usize).min(self.spans() - 1);
        let (knots, inverses) =
            (&self.knots[first + 1..], &self.inverses[first * degree * (degree + 1) / 2..]);
        let values = &mut values[..=degree];
        if degree == 3 {
            // The same with loops of known lengths, as nearly all lattices are cubic.
            let values: &mut [f64; 4] = values.try_into().expect("as many as the degree and one");
            recurrence(3, t, &knots[..6], &inverses[..6], values, &place);
        } else {
            recurrence(degree, t, knots, inverses, values, &place);
        }
        BasisWeights { first, values }
    }
}

/// The B-splines of a degree that are not zero at `t`, from the knots around: as many as the degree before
/// `t`, and after.
#[inline(always)]
fn recurrence(
    degree: usize,
    t: f64,
    knots: &[f64],
    inverses: &[f64],
    values: &mut [f64],
    place: &KnotPosition,
) {
    let mut inverses = inverses.iter();
    values[0] = place.fade;
    for k in 1..=degree {
        let ends = knots[degree - k..].iter().zip(&knots[degree..]);
        let mut carried = 0.0;
        for ((value, (left, right)), inverse) in values[..k].iter_mut().zip(ends).zip(inverses.by_ref()) {
            let share = *value * inverse;
            *value = carried + (right - t) * share;
            carried = (t - left) * share;
        }
        values[k] = carried;
    }
    values[0] += place.below;
    values[1] -= place.below;
    values[degree] += place.above;
    values[degree - 1] -= place.above;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bases(count: usize, beyond: Beyond) -> [Basis; 2] {
        [Basis::bernstein(count, beyond), Basis::b_spline(count, beyond)]
    }

    /// The sum of the functions, each with its factor.
    fn sum(basis: &Basis, u: f64, factor: impl Fn(usize) -> f64) -> f64 {
        let mut values = [0.0; MOST];
        let weights = basis.values_at(u, &mut values);
        weights.values.iter().enumerate().map(|(i, w)| w * factor(weights.first + i)).sum()
    }

    fn value(basis: &Basis, u: f64, i: usize) -> f64 {
        sum(basis, u, |j| f64::from(u8::from(i == j)))
    }

    proptest! {
        #[test]
        fn they_sum_to_one_and_reproduce_their_parameter(count in 2..=MOST, u in 0.0..=1.0) {
            for basis in bases(count, Beyond::Clamped) {
                prop_assert!((sum(&basis, u, |_| 1.0) - 1.0).abs() < 1e-14);
                prop_assert!((sum(&basis, u, |i| basis.place_of(i)) - u).abs() < 1e-14);
                prop_assert!(basis.values_at(u, &mut [0.0; MOST]).values.iter().all(|w| *w >= 0.0));
            }
        }

        #[test]
        fn beyond_the_ends_they_fade(count in 2..=12_usize, over in 0.0..0.3_f64) {
            let beyond = Beyond::Smooth { reach: 0.3 };
            for basis in bases(count, beyond) {
                for u in [-over, 1.0 + over] {
                    let KnotPosition { inside, fade, .. } = basis.place(u);
                    prop_assert!((0.0..=1.0).contains(&fade) && (sum(&basis, u, |_| 1.0) - fade).abs() < 1e-13);
                    let tangent = (u - inside) * (1.0 - over / 0.3).powi(3);
                    let reproduced = sum(&basis, u, |i| basis.place_of(i));
                    prop_assert!((reproduced - (inside * fade + tangent)).abs() < 1e-13);
                }
            }
        }

        #[test]
        fn bernsteins_are_bernsteins(count in 2..10_usize, u in 0.0..=1.0) {
            let n = count as i32 - 1;
            let mut binomial = 1.0;
            for i in 0..=n {
                let exact = binomial * f64::powi(u, i) * (1.0 - u).powi(n - i);
                let found = value(&Basis::bernstein(count, Beyond::Clamped), u, i as usize);
                prop_assert!((found - exact).abs() < 1e-14);
                binomial *= f64::from(n - i) / f64::from(i + 1);
            }
        }

        #[test]
        fn splines_reach_four_spans_at_most(count in 5..=MOST, u in 0.0..=1.0, i in 0..MOST) {
            let i = i % count;
            let basis = Basis::b_spline(count, Beyond::Clamped);
            let span = 1.0 / (count - 3) as f64;
            let [from, to] = [i as f64 - 3.0, i as f64 + 1.0].map(|k| k * span);
            if u < from - 1e-12 || u > to + 1e-12 {
                prop_assert!(value(&basis, u, i) == 0.0);
            }
        }
    }

    #[test]
    fn without_branches_places_are_the_same() {
        for beyond in [Beyond::Clamped, Beyond::Smooth { reach: 0.3 }] {
            let basis = Basis::b_spline(5, beyond);
            for u in (-400..=1400).map(|k| 1e-3 * f64::from(k)).chain([-0.0, -1e300, 1e300]) {
                let all = |p: KnotPosition| [p.inside, p.fade, p.below, p.above];
                assert_eq!(all(basis.place(u)), all(basis.place_of_many(u)), "{u}");
            }
        }
    }

    #[test]
    fn ends_are_met_and_far_away_nothing_is_left() {
        for count in 2..=MOST {
            for basis in bases(count, Beyond::Smooth { reach: 0.5 }) {
                assert!((value(&basis, 0.0, 0), value(&basis, 1.0, count - 1)) == (1.0, 1.0));
                for u in [-0.5, 1.5, -1e300, 1e300] {
                    assert!(basis.values_at(u, &mut [0.0; MOST]).values.iter().all(|w| *w == 0.0));
                }
            }
            for basis in bases(count, Beyond::Clamped) {
                assert!((value(&basis, -1e300, 0), value(&basis, 7.0, count - 1)) == (1.0, 1.0));
            }
        }
    }

    #[test]
    fn smooth_ones_have_no_kink_anywhere() {
        const H: f64 = 1e-5;
        for count in [2, 3, 4, 5, 9] {
            for basis in bases(count, Beyond::Smooth { reach: 0.2 }) {
                for i in 0..count {
                    let slope = |u: f64| (value(&basis, u + H, i) - value(&basis, u, i)) / H;
                    for end in [-0.2, 0.0, 1.0, 1.2] {
                        let kink = slope(end) - slope(end - H);
                        // Second derivatives of some hundreds change the slope by less than a kink does.
                        assert!(kink.abs() < 3e3 * H, "{count} {i} at {end}: {kink}");
                    }
                }
            }
        }
    }
}
