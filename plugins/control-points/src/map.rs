//! The maps that landmarks determine, from the simplest to the most flexible.
//!
//! - A similarity, or seven-parameter transformation: S. Umeyama, *Least-squares estimation of transformation
//!   parameters between two point patterns*, PAMI 1991.
//! - The thin-plate spline in space, whose kernel is the distance: F. L. Bookstein, *Principal warps*,
//!   PAMI 1989.
//! - Local weights: D. Shepard, *A two-dimensional interpolation function for irregularly-spaced data*,
//!   1968, of the residuals of the best simpler map.

use crate::landmarks::Landmark;
use faer::Mat;
use faer::linalg::solvers::{PartialPivLu, Solve};
use glam::{DAffine3, DMat3, DVec3};
use simod_geometry::{nearest_rotation, symmetric_eigen};
use simod_plugin_api::Choice;

/// Least extent of landmarks in a direction, as a part of their largest extent.
const EXTENDS: f64 = 1e-6;
/// Distance of sources, as a part of their extent, below which they coincide.
const SAME: f64 = 1e-9;
/// Extent, as a part of the largest one, below which a map is uncertain in that direction.
const FLAT: f64 = 1e-2;

/// The kind of map.
#[derive(Choice, Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapKind {
    #[choice(label = "Thin-plate spline")]
    ThinPlate,
    #[choice(label = "Local weights")]
    LocalWeights,
    Affine,
    #[choice(label = "Similarity (Helmert)")]
    Similarity,
    Translation,
}

impl MapKind {
    /// Name of the map in sessions.
    pub fn id(self) -> &'static str {
        match self {
            Self::ThinPlate => "thin-plate",
            Self::LocalWeights => "local-weights",
            Self::Affine => "affine",
            Self::Similarity => "similarity",
            Self::Translation => "translation",
        }
    }

    /// Kinds that fewer landmarks determine, the most flexible first.
    fn simpler(self) -> &'static [Self] {
        match self {
            Self::ThinPlate | Self::LocalWeights => &[Self::Affine, Self::Similarity, Self::Translation],
            Self::Affine => &[Self::Similarity, Self::Translation],
            Self::Similarity => &[Self::Translation],
            Self::Translation => &[],
        }
    }
}

/// Reason why landmarks determine no map of a kind, and the next simpler kind that they do determine.
#[derive(Debug, Clone, PartialEq)]
pub struct Open {
    pub why: Why,
    pub instead: Option<MapKind>,
}

/// Reason why landmarks determine no map of a kind, and the advice.
#[derive(Debug, Clone, PartialEq)]
pub struct Why {
    pub what: String,
    pub remedy: &'static str,
}

/// Number of directions in which points extend, and the least of these extents as a part of the largest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointExtent {
    pub directions: usize,
    pub least: f64,
}

impl PointExtent {
    pub fn measure(points: &[DVec3]) -> Self {
        let count = points.len().max(1) as f64;
        let mean = points.iter().sum::<DVec3>() / count;
        let covariance = points.iter().fold(DMat3::ZERO, |sum, p| {
            let p = *p - mean;
            sum + DMat3::from_cols(p * p.x, p * p.y, p * p.z)
        });
        let squares = (symmetric_eigen(covariance).0 / count).to_array();
        let largest = squares[2].max(0.0).sqrt();
        // Rounding leaves an extent of this size of points in one place.
        let size = points.iter().map(|p| p.length()).fold(0.0, f64::max);
        if largest <= 1e-12 * size {
            return Self { directions: 0, least: 0.0 };
        }
        let parts = squares.iter().map(|s| s.max(0.0).sqrt() / largest).filter(|part| *part > EXTENDS);
        Self { directions: parts.clone().count(), least: parts.fold(1.0, f64::min) }
    }

    /// Whether the points are nearly flat, but extend in all directions.
    pub fn is_uncertain(self) -> bool {
        self.directions == 3 && self.least < FLAT
    }

    fn in_words(self) -> &'static str {
        match self.directions {
            0 => "all in one place",
            1 => "all on one line",
            2 => "all in one plane",
            _ => "all over space",
        }
    }
}

/// A map of space.
#[derive(Debug, Clone)]
pub enum SpaceMap {
    Affine(DAffine3),
    /// Affine map, and at each centre the weight of the distance from it.
    Spline(DAffine3, Vec<(DVec3, DVec3)>),
    /// Affine map, and at each source the residual, and its weight.
    Local(DAffine3, Vec<(DVec3, DVec3, f64)>),
}

impl SpaceMap {
    /// The image of a point.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Affine(map) => map.transform_point3(p),
            Self::Spline(map, centers) => {
                centers.iter().fold(map.transform_point3(p), |q, (c, w)| q + *w * c.distance(p))
            }
            Self::Local(map, left) => {
                let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
                for (source, off, weight) in left {
                    let square = source.distance_squared(p);
                    if square == 0.0 {
                        return map.transform_point3(p) + *off;
                    }
                    sum += weight / square * *off;
                    weights += weight / square;
                }
                map.transform_point3(p) + if weights > 0.0 { sum / weights } else { DVec3::ZERO }
            }
        }
    }

    /// Map of a kind that is determined by the landmarks with a weight. `smoothing` allows a spline to miss
    /// the landmarks, in their own unit of length.
    ///
    /// # Errors
    /// The landmarks do not determine a map.
    pub fn fit(kind: MapKind, landmarks: &[Landmark], smoothing: f64) -> Result<Self, Open> {
        let determined = |simpler: &&MapKind| Self::of_kind(**simpler, landmarks, smoothing).is_ok();
        Self::of_kind(kind, landmarks, smoothing)
            .map_err(|why| Open { why, instead: kind.simpler().iter().find(determined).copied() })
    }

    fn of_kind(kind: MapKind, landmarks: &[Landmark], smoothing: f64) -> Result<Self, Why> {
        let used: Vec<&Landmark> = landmarks.iter().filter(|l| l.weight > 0.0).collect();
        let extent = PointExtent::measure(&used.iter().map(|l| l.source).collect::<Vec<_>>());
        let needed = match kind {
            MapKind::ThinPlate | MapKind::Affine => 3,
            MapKind::Similarity => 2,
            MapKind::Translation | MapKind::LocalWeights => 0,
        };
        if used.is_empty() {
            let what = "no landmark has a weight above 0".to_owned();
            return Err(Why { what, remedy: "give landmarks a weight" });
        }
        if extent.directions < needed {
            return Err(open(extent, used.len()));
        }
        match kind {
            MapKind::Translation => Ok(Self::Affine(translation(&used))),
            MapKind::Similarity => similarity(&used).map(Self::Affine),
            MapKind::Affine => Ok(Self::Affine(affine(&used))),
            MapKind::ThinPlate => ThinPlateSpline::new(&used, smoothing).map(|spline| spline.map(&used)),
            MapKind::LocalWeights => {
                distinct(&used)?;
                let map = match extent.directions {
                    3 => affine(&used),
                    2 => similarity(&used)?,
                    _ => translation(&used),
                };
                let left = |l: &&Landmark| (l.source, l.target - map.transform_point3(l.source), l.weight);
                Ok(Self::Local(map, used.iter().map(left).collect()))
            }
        }
    }

    /// Vector by which each landmark is missed by the map of all others; nothing where these do not
    /// determine a map.
    pub fn left_out(kind: MapKind, landmarks: &[Landmark], smoothing: f64) -> Vec<Option<DVec3>> {
        if kind == MapKind::ThinPlate {
            return ThinPlateSpline::left_out(landmarks, smoothing);
        }
        let without = |i: usize| {
            let mut others = landmarks.to_vec();
            let landmark = others.remove(i);
            Self::of_kind(kind, &others, smoothing)
                .ok()
                .map(|map| landmark.target - map.apply(landmark.source))
        };
        (0..landmarks.len()).map(without).collect()
    }

    /// Whether an affine map mirrors space.
    pub fn mirrors(&self) -> bool {
        matches!(self, Self::Affine(map) if map.matrix3.determinant() <= 0.0)
    }
}

/// Reason why a map is open for landmarks that extend in too few directions.
fn open(extent: PointExtent, count: usize) -> Why {
    let what = match extent.directions {
        2 => "what happens across it cannot be determined",
        1 => "turns about it, and what happens across it, cannot be determined",
        _ => "neither turns nor scales can be determined",
    };
    let what = match count {
        1 => format!("there is one landmark: {what}"),
        _ => format!("the {count} landmarks lie {}: {what}", extent.in_words()),
    };
    Why { what, remedy: "take more landmarks elsewhere" }
}

/// Sources that coincide cannot go to several places.
fn distinct(used: &[&Landmark]) -> Result<(), Why> {
    let middle = means(used)[0];
    let near = SAME * used.iter().map(|l| l.source.distance(middle)).fold(0.0, f64::max);
    let mut order: Vec<&&Landmark> = used.iter().collect();
    order.sort_by(|a, b| a.source.x.total_cmp(&b.source.x));
    for (i, one) in order.iter().enumerate() {
        let beside = order[i + 1..].iter().take_while(|other| other.source.x - one.source.x <= near);
        let same = beside.clone().find(|other| other.source.distance(one.source) <= near);
        if let Some(other) = same {
            let [a, b] = if one.line <= other.line { [one, other] } else { [other, one] };
            let what = format!(
                "landmarks `{}` and `{}` coincide, in lines {} and {}, and cannot both be met",
                a.name, b.name, a.line, b.line
            );
            return Err(Why { what, remedy: "leave one of them out" });
        }
    }
    Ok(())
}

/// Weighted means of sources and targets.
fn means(used: &[&Landmark]) -> [DVec3; 2] {
    let whole: f64 = used.iter().map(|l| l.weight).sum();
    [
        used.iter().map(|l| l.weight / whole * l.source).sum(),
        used.iter().map(|l| l.weight / whole * l.target).sum(),
    ]
}

fn translation(used: &[&Landmark]) -> DAffine3 {
    let [source, target] = means(used);
    DAffine3::from_translation(target - source)
}

/// Sum of weighted products of the differences from the means: target by source.
fn covariance(used: &[&Landmark], [source, target]: [DVec3; 2]) -> DMat3 {
    used.iter().fold(DMat3::ZERO, |sum, l| {
        let (s, t) = (l.source - source, l.weight * (l.target - target));
        sum + DMat3::from_cols(t * s.x, t * s.y, t * s.z)
    })
}

fn similarity(used: &[&Landmark]) -> Result<DAffine3, Why> {
    let middle = means(used);
    let covariance = covariance(used, middle);
    let unsolved = || Why {
        what: "the landmarks' targets lie so that neither turns nor scales can be determined".to_owned(),
        remedy: "take more landmarks elsewhere",
    };
    let (turn, values) = nearest_rotation(covariance);
    // The second largest value decides whether the turn is known.
    if !(values.y > EXTENDS * EXTENDS * values.x && values.x > 0.0) {
        return Err(unsolved());
    }
    let spread: f64 = used.iter().map(|l| l.weight * (l.source - middle[0]).length_squared()).sum();
    let scaled = values.element_sum() / spread * turn;
    Ok(DAffine3::from_mat3_translation(scaled, middle[1] - scaled * middle[0]))
}

fn affine(used: &[&Landmark]) -> DAffine3 {
    let middle = means(used);
    let spread = used.iter().fold(DMat3::ZERO, |sum, l| {
        let s = l.source - middle[0];
        sum + l.weight * DMat3::from_cols(s * s.x, s * s.y, s * s.z)
    });
    let matrix = covariance(used, middle) * spread.inverse();
    DAffine3::from_mat3_translation(matrix, middle[1] - matrix * middle[0])
}

/// The equations of a thin-plate spline: distances, the smoothing, and the four side conditions.
struct ThinPlateSpline {
    factor: PartialPivLu<f64>,
    /// Middle and size of the sources, by which they are shifted and scaled against rounding.
    middle: DVec3,
    size: f64,
}

impl ThinPlateSpline {
    fn new(used: &[&Landmark], smoothing: f64) -> Result<Self, Why> {
        if smoothing == 0.0 {
            distinct(used)?;
        }
        let middle = means(used)[0];
        let size = used.iter().map(|l| l.source.distance(middle)).fold(0.0, f64::max);
        let n = used.len();
        let matrix = Mat::from_fn(n + 4, n + 4, |i, j| match (i < n, j < n) {
            // The kernel of positive energy is minus the distance, so the smoothing has a minus.
            (true, true) if i == j => -smoothing / (size * used[i].weight),
            (true, true) => used[i].source.distance(used[j].source) / size,
            (true, false) => affine_part((used[i].source - middle) / size, j - n),
            (false, true) => affine_part((used[j].source - middle) / size, i - n),
            (false, false) => 0.0,
        });
        faer::set_global_parallelism(faer::Par::Seq);
        Ok(Self { factor: matrix.partial_piv_lu(), middle, size })
    }

    /// The weights of the kernels, and the coefficients of the affine part.
    fn solve(&self, used: &[&Landmark]) -> Mat<f64> {
        let n = used.len();
        let mut right =
            Mat::from_fn(n + 4, 3, |i, k| if i < n { used[i].target[k] - used[i].source[k] } else { 0.0 });
        self.factor.solve_in_place(right.as_mut());
        right
    }

    fn map(&self, used: &[&Landmark]) -> SpaceMap {
        let found = self.solve(used);
        let row = |i: usize| DVec3::from_array(std::array::from_fn(|k| found[(i, k)]));
        let n = used.len();
        let linear = DMat3::from_cols(row(n + 1), row(n + 2), row(n + 3)) * self.size.recip();
        let own = DAffine3::from_mat3_translation(DMat3::IDENTITY + linear, row(n) - linear * self.middle);
        SpaceMap::Spline(own, (0..n).map(|i| (used[i].source, row(i) / self.size)).collect())
    }

    /// S. Rippa, *An algorithm for selecting a good value for the parameter c in radial basis function
    /// interpolation*, Advances in Computational Mathematics 1999: no spline has to be found anew.
    fn left_out(landmarks: &[Landmark], smoothing: f64) -> Vec<Option<DVec3>> {
        let used: Vec<&Landmark> = landmarks.iter().filter(|l| l.weight > 0.0).collect();
        let Ok(spline) = Self::new(&used, smoothing) else { return vec![None; landmarks.len()] };
        let map = spline.map(&used);
        let found = spline.solve(&used);
        let mut inverse = Mat::<f64>::identity(used.len() + 4, used.len() + 4);
        spline.factor.solve_in_place(inverse.as_mut());
        let largest = (0..used.len()).map(|i| inverse[(i, i)].abs()).fold(0.0, f64::max);
        let mut next = 0;
        let each = |l: &Landmark| {
            if l.weight == 0.0 {
                return Some(l.target - map.apply(l.source));
            }
            let i = next;
            next += 1;
            // The other points alone do not determine a spline.
            let own = inverse[(i, i)];
            let is_needed = own.abs() <= 1e-9 * largest || used.len() < 5;
            (!is_needed).then(|| DVec3::from_array(std::array::from_fn(|k| found[(i, k)] / own)))
        };
        landmarks.iter().map(each).collect()
    }
}

fn affine_part(p: DVec3, function: usize) -> f64 {
    if function == 0 { 1.0 } else { p[function - 1] }
}
