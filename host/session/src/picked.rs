//! A part of a model that the user selected by hand, as geometry: points inside, and points next to them
//! outside.

use crate::key::{Key, Keyed};
use crate::side_file::{MOST_IN_SESSION, Reference, SideFileKind, write as write_file};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use simod_model::Result;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use xxhash_rust::xxh3::xxh3_128;

/// Points of a model that were selected, and points around them that were not; model coordinates. Any other
/// point belongs to the nearer one of both, so the part of the model is the same on any sampling of it.
///
/// Memory: 24 bytes a point, and 32 more once distances are asked for. A clone shares it.
#[derive(Clone)]
pub struct PickedPoints(Arc<PickedContent>);

struct PickedContent {
    inside: Vec<DVec3>,
    outside: Vec<DVec3>,
    /// File of the points, if it was not read yet.
    file: Option<Reference>,
    /// Hash of all points, which stands for them.
    hash: u128,
    search: OnceLock<PickedSearch>,
}

/// Finds the nearest of points.
struct PickedSearch {
    /// Trees of the points; none where there are no points.
    inside: Option<ImmutableKdTree<f64, 3>>,
    outside: Option<ImmutableKdTree<f64, 3>>,
    /// Half of the distance from each point inside to the nearest outside: where the border is.
    half_gaps: Vec<f64>,
}

/// Selection as files have it: its points, or a file of them.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct Raw {
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    inside: Vec<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    outside: Vec<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    file: Option<Reference>,
}

impl PickedPoints {
    /// Selection of points inside, and others outside. There have to be points outside wherever the model
    /// goes on; no points outside mean that all of the model is selected.
    pub fn new(inside: Vec<DVec3>, outside: Vec<DVec3>) -> Self {
        Self::from_parts(inside, outside, None)
    }

    fn from_parts(inside: Vec<DVec3>, outside: Vec<DVec3>, file: Option<Reference>) -> Self {
        let count = inside.len().to_le_bytes();
        let bytes = inside.iter().chain(&outside).flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes);
        let hash = xxh3_128(&count.into_iter().chain(bytes).collect::<Vec<u8>>());
        Self(Arc::new(PickedContent { inside, outside, file, hash, search: OnceLock::new() }))
    }

    /// Points inside.
    pub fn inside(&self) -> &[DVec3] {
        &self.0.inside
    }

    /// Points that are not.
    pub fn outside(&self) -> &[DVec3] {
        &self.0.outside
    }

    /// Defect of the selection, if it has one.
    pub fn defect(&self) -> Option<&'static str> {
        let all = || self.0.inside.iter().chain(&self.0.outside);
        if self.0.file.is_some() {
            Some("a selection is in a file, which only a session can name")
        } else if self.0.inside.is_empty() {
            Some("a selection has no point inside")
        } else if all().any(|p| !p.is_finite()) {
            Some("a selection has a coordinate that is no finite number")
        } else {
            None
        }
    }

    /// Signed distance to the border, in the model's unit: negative or 0 where the nearest point is inside,
    /// and a lower bound that is exact along the model beyond it. Far inside everywhere where there are no
    /// points outside.
    ///
    /// The border is halfway between points inside and outside. Near it, the distance is half of the
    /// difference between those to the nearest points of both; farther out, where the nearest one outside
    /// tells nothing, that to the nearest point inside, without its half of the gap.
    pub fn signed_distance(&self, p: DVec3) -> f64 {
        let PickedContent { inside, outside, .. } = &*self.0;
        let search = self.0.search.get_or_init(|| PickedSearch::new(inside, outside));
        let Some((i, to_inside)) = nearest(search.inside.as_ref(), inside, p) else { return f64::INFINITY };
        let Some((_, to_outside)) = nearest(search.outside.as_ref(), outside, p) else { return -f64::MAX };
        let near = 0.5 * (to_inside - to_outside);
        if near <= 0.0 { near } else { near.max(to_inside - search.half_gaps[i]) }
    }

    /// Reads the selection's file, if it is in one; `folder` is the session's.
    ///
    /// # Errors
    /// The file cannot be read, or is not what the session was saved with.
    pub(crate) fn loaded(self, folder: &Path) -> Result<Self> {
        let Some(file) = &self.0.file else { return Ok(self) };
        file.read(folder, SideFileKind::Selection, |raw: [Vec<[f64; 3]>; 2]| {
            let [inside, outside] = raw.map(points);
            let read = Self::new(inside, outside);
            read.defect().map_or(Ok(read), |what| Err(what.to_owned()))
        })
    }

    /// Whether the selection is too long for a readable file.
    pub(crate) fn is_long(&self) -> bool {
        self.0.inside.len() + self.0.outside.len() > MOST_IN_SESSION
    }

    /// Writes the points to a file beside a session, if the selection is too long for the session itself.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn stored(&self, session: &Path) -> Result<Option<Reference>> {
        if !self.is_long() {
            return Ok(None);
        }
        let content = [arrays(&self.0.inside), arrays(&self.0.outside)];
        write_file(session, SideFileKind::Selection, &content).map(Some)
    }

    /// Stand-in for a selection that is in a file.
    pub(crate) fn in_file(file: Reference) -> Self {
        Self::from_parts(Vec::new(), Vec::new(), Some(file))
    }
}

fn points(from: Vec<[f64; 3]>) -> Vec<DVec3> {
    from.into_iter().map(DVec3::from_array).collect()
}

fn arrays(from: &[DVec3]) -> Vec<[f64; 3]> {
    from.iter().map(DVec3::to_array).collect()
}

impl PickedSearch {
    fn new(inside: &[DVec3], outside: &[DVec3]) -> Self {
        let tree = |points: &[DVec3]| ImmutableKdTree::new_from_slice(&arrays(points)).ok();
        let outside_tree = tree(outside).filter(|_| !outside.is_empty());
        let gap = |p: &DVec3| nearest(outside_tree.as_ref(), outside, *p).map_or(0.0, |(_, d)| 0.5 * d);
        let half_gaps = inside.iter().map(gap).collect();
        Self { inside: tree(inside).filter(|_| !inside.is_empty()), outside: outside_tree, half_gaps }
    }
}

/// Index of the point nearest to `p`, and its distance.
fn nearest(tree: Option<&ImmutableKdTree<f64, 3>>, points: &[DVec3], p: DVec3) -> Option<(usize, f64)> {
    let found = tree?.query(&p.to_array()).nearest_one::<SquaredEuclidean<f64>>().execute();
    let i = found.item as usize;
    Some((i, points.get(i)?.distance(p)))
}

impl PartialEq for PickedPoints {
    fn eq(&self, other: &Self) -> bool {
        self.0.hash == other.0.hash && self.0.file == other.0.file
    }
}

impl Keyed for PickedPoints {
    fn add_to(&self, key: &mut Key) {
        (self.0.hash, self.0.file.as_ref()).add_to(key);
    }
}

impl std::fmt::Debug for PickedPoints {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let PickedContent { inside, outside, file, hash, .. } = &*self.0;
        write!(f, "PickedPoints({} inside, {} outside, {hash:032x}, {file:?})", inside.len(), outside.len())
    }
}

impl Serialize for PickedPoints {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let PickedContent { inside, outside, file, .. } = &*self.0;
        Raw { inside: arrays(inside), outside: arrays(outside), file: file.clone() }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for PickedPoints {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Raw { inside, outside, file } = Raw::deserialize(deserializer)?;
        Ok(Self::from_parts(points(inside), points(outside), file))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{RegionShape, Shapes};

    /// A grid of unit spacing on the plane, of which those left of x = 0 are selected; outside are `rings`
    /// columns.
    fn half(rings: i32) -> PickedPoints {
        let column = |x: i32| (-20..=20).map(move |y| DVec3::new(f64::from(x), f64::from(y), 0.0));
        PickedPoints::new((-10..=0).flat_map(column).collect(), (1..=rings).flat_map(column).collect())
    }

    #[test]
    fn the_border_is_halfway_between_points_inside_and_outside() {
        for rings in [1, 3] {
            let half = half(rings);
            for (x, d) in
                [(-3.0, -2.0), (0.0, -0.5), (0.25, -0.25), (0.5, 0.0), (0.75, 0.25), (1.0, 0.5), (4.0, 3.5)]
            {
                let found = half.signed_distance(DVec3::new(x, 3.0, 0.0));
                assert!((found - d).abs() < 1e-12, "{x}: {found} is not {d}");
            }
        }
    }

    #[test]
    fn it_fades_out_as_other_shapes_do() {
        let soft = Shapes { shapes: vec![RegionShape::Selection(half(1))], falloff: 4.0 };
        let weight = |x: f64| soft.weight(DVec3::new(x, 0.5, 0.1));
        assert_eq!((weight(-2.0), weight(0.0), weight(6.0)), (1.0, 1.0, 0.0));
        assert!((weight(2.5) - 0.5).abs() < 0.1, "{}", weight(2.5));
        let weights: Vec<f64> = (0..60).map(|i| weight(f64::from(i) * 0.1)).collect();
        assert!(weights.iter().all(|w| (0.0..=1.0).contains(w)));
        assert!(weights.windows(2).all(|w| w[1] <= w[0] + 0.05 && w[0] - w[1] < 0.2), "{weights:?}");
    }

    #[test]
    fn without_points_outside_everything_is_selected() {
        let all = PickedPoints::new(vec![DVec3::ONE], Vec::new());
        assert!(all.signed_distance(DVec3::splat(1e9)) < 0.0);
        // Coincident points, as scans have, are no trouble.
        let same = PickedPoints::new(vec![DVec3::ZERO; 500], vec![DVec3::X; 500]);
        assert_eq!(same.signed_distance(DVec3::X), 0.5);
    }

    #[test]
    fn defects_are_found() {
        assert!(half(1).defect().is_none());
        assert!(PickedPoints::new(Vec::new(), vec![DVec3::ONE]).defect().is_some());
        assert!(PickedPoints::new(vec![DVec3::ONE], vec![DVec3::NAN]).defect().is_some());
        let read: RegionShape =
            toml::from_str("selection = { file = { file = \"a\", fingerprint = \"b\" } }").unwrap();
        assert!(read.defect().unwrap().contains("only a session"));
    }

    #[test]
    fn long_ones_come_back_from_their_file() {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("edit.toml");
        assert!(PickedPoints::new(vec![DVec3::ONE], vec![]).stored(&session).unwrap().is_none());
        let long =
            PickedPoints::new((0..2000).map(|i| DVec3::splat(f64::from(i) / 3.0)).collect(), vec![DVec3::X]);
        let file = long.stored(&session).unwrap().unwrap();
        let named = PickedPoints::in_file(file);
        assert!(named != long);
        assert_eq!(named.loaded(folder.path()).unwrap(), long);
    }
}
