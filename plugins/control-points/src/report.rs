//! The errors of a map at its landmarks.

use crate::landmarks::Landmark;
use crate::map::{MapKind, SpaceMap};
use glam::DVec3;
use serde_json::{Value, json};

/// Greatest number of landmarks that are told one by one: the host takes a hundred lines.
const MOST_TOLD: usize = 90;
/// Greatest number of landmarks for which the map without each of them is found.
const MOST_LEFT_OUT: usize = 1500;
/// Greatest number of landmarks for which outliers are found one after the other.
const MOST_AGAIN: usize = 300;
/// Factor of the median by which the map of all others has to miss a landmark that is an outlier,
const OUTLIER: f64 = 4.0;
/// and part of the landmarks' extent by which it has to miss the landmark, too.
const NOTHING: f64 = 1e-5;

/// Errors of a landmark, lengths in the model's unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub name: String,
    /// Distance from the landmark's image by the map to its target.
    pub residual: f64,
    /// Residual of the map of all other landmarks; nothing where these determine none.
    pub left_out: Option<f64>,
    /// Whether the landmark has no weight.
    pub is_check: bool,
    pub is_outlier: bool,
}

/// The rows of all landmarks, and the kind of map.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkReport {
    pub rows: Vec<Row>,
    kind: MapKind,
}

impl LandmarkReport {
    /// The report of a map for landmarks in local coordinates, of which a unit is `scale` of the model's.
    pub fn new(map: &SpaceMap, kind: MapKind, landmarks: &[Landmark], smoothing: f64, scale: f64) -> Self {
        let left_out = if landmarks.len() <= MOST_LEFT_OUT {
            SpaceMap::left_out(kind, landmarks, smoothing)
        } else {
            vec![None; landmarks.len()]
        };
        let row = |(l, left): (&Landmark, Option<DVec3>)| Row {
            name: l.name.clone(),
            residual: scale * map.apply(l.source).distance(l.target),
            left_out: left.map(|left| scale * left.length()),
            is_check: l.weight == 0.0,
            is_outlier: false,
        };
        let mut rows: Vec<Row> = landmarks.iter().zip(left_out.iter().copied()).map(row).collect();
        for i in outliers(kind, landmarks, smoothing, left_out) {
            rows[i].is_outlier = true;
        }
        Self { rows, kind }
    }

    /// Root mean square of the residuals of the landmarks with a weight.
    pub fn rms(&self) -> f64 {
        rms(self.rows.iter().filter(|row| !row.is_check).map(|row| row.residual)).unwrap_or(0.0)
    }

    /// The root mean square of residuals where each landmark is left out; nothing where none can be.
    pub fn left_out_rms(&self) -> Option<f64> {
        rms(self.rows.iter().filter_map(|row| row.left_out))
    }

    /// Names of the landmarks that are outliers.
    pub fn outliers(&self) -> Vec<&str> {
        self.rows.iter().filter(|row| row.is_outlier).map(|row| row.name.as_str()).collect()
    }

    /// The report in one line.
    pub fn summary(&self) -> String {
        let left_out = match self.left_out_rms() {
            Some(rms) => format!("{} where each is left out", figure(rms)),
            None => "none can be left out".to_owned(),
        };
        let count = self.rows.len();
        format!("{}, {count} landmarks: rms {}, {left_out}", self.kind.id(), figure(self.rms()))
    }

    /// A line for each landmark, the worst ones where there are very many.
    pub fn lines(&self) -> Vec<String> {
        let line = |row: &Row| {
            let left_out =
                row.left_out.map_or("cannot be left out".to_owned(), |x| format!("left out {}", figure(x)));
            let check = if row.is_check { ", a check" } else { "" };
            let outlier = if row.is_outlier { ", an outlier" } else { "" };
            format!("{}: residual {}, {left_out}{check}{outlier}", row.name, figure(row.residual))
        };
        self.told().into_iter().map(line).collect()
    }

    /// The report as objects of JSON, the summary first.
    pub fn json(&self) -> Vec<String> {
        let summary = json!({
            "method": self.kind.id(), "landmarks": self.rows.len(), "rms": self.rms(),
            "left_out_rms": self.left_out_rms(), "outliers": self.outliers().len(),
        });
        let row = |row: &Row| {
            json!({
                "name": row.name, "residual": row.residual, "left_out": row.left_out,
                "check": row.is_check, "outlier": row.is_outlier,
            })
        };
        std::iter::once(summary)
            .chain(self.told().into_iter().map(row))
            .map(|v: Value| v.to_string())
            .collect()
    }

    fn told(&self) -> Vec<&Row> {
        let mut rows: Vec<&Row> = self.rows.iter().collect();
        if rows.len() > MOST_TOLD {
            let bad = |row: &Row| row.left_out.unwrap_or(row.residual);
            rows.sort_by(|a, b| bad(b).total_cmp(&bad(a)));
            rows.truncate(MOST_TOLD);
        }
        rows
    }
}

/// Landmarks that are outliers, one after the other: each is left out before the next is looked for, as a
/// map that is wrong in one place is wrong beside it, too.
fn outliers(
    kind: MapKind,
    landmarks: &[Landmark],
    smoothing: f64,
    mut left_out: Vec<Option<DVec3>>,
) -> Vec<usize> {
    let middle = landmarks.iter().map(|l| l.target).sum::<DVec3>() / landmarks.len().max(1) as f64;
    let extent = landmarks.iter().map(|l| l.target.distance(middle)).fold(0.0, f64::max);
    let most = if landmarks.len() <= MOST_AGAIN { landmarks.len() / 4 } else { 1 };
    let (mut kept, mut found) = (landmarks.to_vec(), Vec::new());
    while found.len() < most {
        let left = left_out.iter().enumerate().filter(|(i, _)| !found.contains(i));
        let mut left: Vec<(f64, usize)> = left.filter_map(|(i, l)| Some(((*l)?.length(), i))).collect();
        left.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some((median, (worst, i))) = left.get(left.len() / 2).map(|l| l.0).zip(left.last()) else {
            break;
        };
        if *worst <= (OUTLIER * median).max(NOTHING * extent) {
            break;
        }
        found.push(*i);
        kept[*i].weight = 0.0;
        if found.len() < most {
            left_out = SpaceMap::left_out(kind, &kept, smoothing);
        }
    }
    found
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0.0, 0.0), |(n, sum), x| (n + 1.0, sum + x * x));
    (count > 0.0).then(|| f64::sqrt(sum / count))
}

/// Number with four digits.
fn figure(x: f64) -> String {
    if x == 0.0 || (1e-3..1e6).contains(&x) { format!("{x:.4}") } else { format!("{x:.3e}") }
}
