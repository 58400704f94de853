//! A skeleton: joints in a tree. From the session, or from a file.
//!
//! A *bone* is the segment from a joint to one that hangs on it, and moves with the upper one. So a joint
//! without any that hang on it, an *end*, has no bone of its own; a joint all by itself is a bone of no
//! length.

use crate::dmat::Wrong;
use glam::DVec3;
use simod_plugin_api::{Joint as GivenJoint, PluginError, PluginResult};
use std::path::Path;

/// Largest number of joints, which are numbered in 16 bits. Each joint's distances are found by themselves,
/// so that more would take long.
const MOST_JOINTS: usize = 1 << 12;
/// Bones below this part of the skeleton's size have no direction.
const SHORTEST: f64 = 1e-9;

/// A joint of a skeleton.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    pub id: String,
    /// The place at rest, local coordinates.
    pub at: DVec3,
    /// The joint that this one hangs on, whose number is less.
    pub parent: Option<usize>,
    /// The joints that hang on it, ascending.
    pub children: Vec<usize>,
}

impl Joint {
    /// Whether the joint is the lower end of a bone, and the upper one of none.
    pub fn is_end(&self) -> bool {
        self.children.is_empty() && self.parent.is_some()
    }
}

/// Joints, each after the one that it hangs on.
#[derive(Debug, Clone, PartialEq)]
pub struct Skeleton {
    pub joints: Vec<Joint>,
    /// The lower joint of each bone, in the order in which they were given, after joints that are all by
    /// themselves, as libigl has them.
    bones: Vec<usize>,
}

impl Skeleton {
    /// The joints of a session.
    ///
    /// # Errors
    /// There is none, or a bone has no length.
    pub fn new(given: &[GivenJoint<'_>]) -> PluginResult<Self> {
        let joint = |j: &GivenJoint<'_>| {
            let parent = (j.parent != GivenJoint::ROOT).then_some(j.parent as usize);
            (j.id().to_owned(), DVec3::from(j.position), parent)
        };
        Self::from_joints(given.iter().map(joint).collect(), &[])
    }

    /// Joints by their ids, places and parents, each after its parent; and the lower joints of bones, if
    /// these have an order of their own.
    fn from_joints(given: Vec<Placed>, bones: &[usize]) -> PluginResult<Self> {
        if given.is_empty() {
            return Err(PluginError::input("there are no joints")
                .hint("place some by [[step.joint]], or give a file with a skeleton as `skeleton`"));
        }
        if given.len() > MOST_JOINTS {
            let message = format!("{} joints are too many", given.len());
            return Err(PluginError::input(message).hint(format!("give {MOST_JOINTS} at most")));
        }
        let mut joints: Vec<Joint> = Vec::with_capacity(given.len());
        for (id, at, parent) in given {
            if !at.is_finite() {
                return Err(PluginError::input(format!("the joint `{id}` is at no finite place")));
            }
            if let Some(parent) = parent {
                let child = joints.len();
                let Some(parent) = joints.get_mut(parent) else {
                    return Err(PluginError::internal(format!("the joint `{id}` comes before its parent")));
                };
                parent.children.push(child);
            }
            joints.push(Joint { id, at, parent, children: Vec::new() });
        }
        let is_lone = |j: &usize| joints[*j].parent.is_none() && joints[*j].children.is_empty();
        let lone = (0..joints.len()).filter(is_lone);
        let hanging: Vec<usize> = match bones {
            [] => (0..joints.len()).filter(|j| joints[*j].parent.is_some()).collect(),
            bones => bones.to_vec(),
        };
        let bones = lone.chain(hanging).collect();
        let this = Self { joints, bones };
        let size = this.size();
        for joint in &this.joints {
            if let Some(parent) = joint.parent.map(|p| &this.joints[p])
                && joint.at.distance(parent.at) <= SHORTEST * size
            {
                let message = format!("the joints `{}` and `{}` are in one place", parent.id, joint.id);
                return Err(PluginError::input(message)
                    .hint("move one of them: the bone between the two has no length"));
            }
        }
        Ok(this)
    }

    /// The diagonal of the joints' box.
    pub fn size(&self) -> f64 {
        let points = || self.joints.iter().map(|j| j.at);
        points().fold(DVec3::NEG_INFINITY, DVec3::max).distance(points().fold(DVec3::INFINITY, DVec3::min))
    }

    /// The bones that move with a joint, as their two ends; none for an end.
    pub fn bones(&self, joint: usize) -> Vec<[DVec3; 2]> {
        let Joint { at, children, .. } = &self.joints[joint];
        if children.is_empty() && !self.joints[joint].is_end() {
            return vec![[*at; 2]];
        }
        children.iter().map(|c| [*at, self.joints[*c].at]).collect()
    }

    /// All bones.
    pub fn all_bones(&self) -> Vec<[DVec3; 2]> {
        (0..self.joints.len()).flat_map(|joint| self.bones(joint)).collect()
    }

    /// Number of bones, with joints that are all by themselves.
    pub fn bone_count(&self) -> usize {
        self.bones.len()
    }

    /// The joint that moves a bone, by the bone's number.
    pub fn mover(&self, bone: usize) -> usize {
        let lower = self.bones[bone];
        self.joints[lower].parent.unwrap_or(lower)
    }

    /// Skeleton of single bones, each with two joints of its own, upper and lower, or one. The upper one has
    /// the id of the joint that it is of, and behind it that of the lower one where several bones hang there:
    /// `hip/knee`.
    #[must_use]
    pub fn taken_apart(&self) -> Self {
        let mut joints = Vec::new();
        let mut bones = Vec::new();
        for lower in &self.bones {
            let end = &self.joints[*lower];
            let upper = end.parent.map_or(end, |p| &self.joints[p]);
            let id =
                if upper.children.len() > 1 { format!("{}/{}", upper.id, end.id) } else { upper.id.clone() };
            let first = joints.len();
            joints.push(Joint { id, at: upper.at, parent: None, children: Vec::new() });
            if end.parent.is_some() {
                joints[first].children.push(first + 1);
                let id = format!("{}/{}/end", upper.id, end.id);
                joints.push(Joint { id, at: end.at, parent: Some(first), children: Vec::new() });
            }
            bones.push(joints.len() - 1);
        }
        Self { joints, bones }
    }

    /// Whether any joint with a bone hangs on another.
    pub fn is_hierarchy(&self) -> bool {
        self.joints.iter().any(|j| j.parent.is_some() && !j.is_end())
    }

    /// The joint of an id.
    pub fn find(&self, id: &str) -> Option<usize> {
        self.joints.iter().position(|j| j.id == id)
    }

    /// Skeleton in a file of points and bones, as libigl and its kin write it (`.tgf`): a line with a name
    /// and three coordinates for each joint, a line `#`, and a line with two names for each bone, the upper
    /// joint first. Further numbers of a joint are passed over, and so are edges that say that they are no
    /// bone (three more numbers, of which the first is 0), and all lines after a second `#`.
    ///
    /// # Errors
    /// Errors name the line.
    pub fn read(path: &Path, to_local: impl Fn(DVec3) -> DVec3) -> PluginResult<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            PluginError::parameter("skeleton", &format!("cannot be read: {}: {e}", path.display()))
                .hint("give a TGF file of points and bones")
        })?;
        let (joints, bones) = parse(&text).map_err(|(line, what)| {
            let place = line.map_or(String::new(), |n| format!(", line {n}"));
            PluginError::parameter("skeleton", &format!("{what}: {}{place}", path.display()))
                .hint("give points as `id x y z`, a line `#`, and bones as `upper-id lower-id`")
        })?;
        Self::from_joints(
            joints.into_iter().map(|(id, at, parent)| (id, to_local(at), parent)).collect(),
            &bones,
        )
    }
}

/// The place of a segment that is nearest to a point.
pub fn on_segment(p: DVec3, [a, b]: [DVec3; 2]) -> DVec3 {
    let along = b - a;
    let square = along.length_squared();
    a + if square > 0.0 { ((p - a).dot(along) / square).clamp(0.0, 1.0) } else { 0.0 } * along
}

/// A joint's id, its place, and the number of the one that it hangs on, which comes before it.
type Placed = (String, DVec3, Option<usize>);

/// Joints, and the lower ones of bones.
type Parsed = (Vec<Placed>, Vec<usize>);

/// Place of a joint that comes after others; or an error text that says what is wrong with the joint.
fn next_joint(id: &str, place: [&str; 3], before: &[(&str, DVec3)]) -> Result<DVec3, String> {
    let number = |word: &str| word.parse::<f64>().ok().filter(|x| x.is_finite());
    let [Some(x), Some(y), Some(z)] = place.map(number) else {
        return Err(format!("has no three coordinates for the joint `{id}`"));
    };
    if before.iter().any(|(known, _)| *known == id) {
        return Err(format!("has two joints `{id}`"));
    }
    if before.len() == MOST_JOINTS {
        return Err(format!("has more than {MOST_JOINTS} joints"));
    }
    Ok(DVec3::new(x, y, z))
}

/// Joints in a file, and the lower ones of its bones; or the line of an error, and its text.
fn parse(text: &str) -> Result<Parsed, Wrong> {
    let mut points: Vec<(&str, DVec3)> = Vec::new();
    let mut parents: Vec<Option<usize>> = Vec::new();
    let mut bones = Vec::new();
    let mut part = 0;
    for (number, line) in text.lines().enumerate() {
        let wrong = |what: String| (Some(number + 1), what);
        let words: Vec<&str> = line.split_whitespace().collect();
        match (part, words.as_slice()) {
            (_, []) => {}
            (2.., _) => break,
            (_, ["#", ..]) => {
                part += 1;
                parents.resize(points.len(), None);
            }
            (0, [id, x, y, z, ..]) => {
                points.push((id, next_joint(id, [x, y, z], &points).map_err(wrong)?));
            }
            (0, _) => return Err(wrong("has a point without coordinates".to_owned())),
            (_, [_, _, "0", _, _]) => {}
            (_, [upper, lower, ..]) => {
                let find = |id: &str| {
                    let found = points.iter().position(|(known, _)| *known == id);
                    found.ok_or_else(|| wrong(format!("has a bone of a joint `{id}` that is not there")))
                };
                let (upper, lower) = (find(upper)?, find(lower)?);
                bones.push(lower);
                if let Some(other) = parents[lower].replace(upper) {
                    let [lower, a, b] = [lower, other, upper].map(|j| points[j].0);
                    return Err(wrong(format!("hangs the joint `{lower}` on two, `{a}` and `{b}`")));
                }
            }
            _ => return Err(wrong("has a bone without a lower joint".to_owned())),
        }
    }
    parents.resize(points.len(), None);
    let order = parents_first(&parents)
        .map_err(|joint| (None, format!("hangs the joint `{}` on itself, by others", points[joint].0)))?;
    let place = |joint: usize| order.iter().position(|o| *o == joint);
    let joint = |o: &usize| (points[*o].0.to_owned(), points[*o].1, parents[*o].and_then(place));
    Ok((order.iter().map(joint).collect(), bones.into_iter().filter_map(place).collect()))
}

/// An order in which parents come first; or one that is in a circle.
fn parents_first(parents: &[Option<usize>]) -> Result<Vec<usize>, usize> {
    let mut order: Vec<usize> = Vec::with_capacity(parents.len());
    let mut is_placed = vec![false; parents.len()];
    for start in 0..parents.len() {
        let mut path = Vec::new();
        let mut next = Some(start);
        while let Some(joint) = next.filter(|j| !is_placed[*j]) {
            if path.len() > parents.len() {
                return Err(joint);
            }
            path.push(joint);
            next = parents[joint];
        }
        for joint in path.into_iter().rev() {
            is_placed[joint] = true;
            order.push(joint);
        }
    }
    Ok(order)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;

    fn read(text: &str) -> PluginResult<Skeleton> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        Skeleton::read(file.path(), |p| 2.0 * p)
    }

    #[test]
    fn files_are_read() {
        let text = "  1 0 0 0  0 1e-323\n\n 2 1 0 0\nelbow 2 0 0.5\n 4 9 9 9\n#\n elbow 2\n1 elbow 1 0 0\n\
                    2 4 0 0 1\n#\nno more";
        let skeleton = read(text).unwrap();
        let ids: Vec<&str> = skeleton.joints.iter().map(|j| j.id.as_str()).collect();
        assert_eq!(ids, ["1", "elbow", "2", "4"]);
        let parents: Vec<Option<usize>> = skeleton.joints.iter().map(|j| j.parent).collect();
        assert_eq!(parents, [None, Some(0), Some(1), None]);
        assert_eq!(skeleton.joints[1].at, DVec3::new(4.0, 0.0, 1.0));
        assert_eq!(skeleton.bones(0), [[DVec3::ZERO, DVec3::new(4.0, 0.0, 1.0)]]);
        assert_eq!(skeleton.bones(2), [[DVec3::ZERO; 2]; 0]);
        assert_eq!(skeleton.bones(3), [[DVec3::splat(18.0); 2]], "a bone of no length");
    }

    #[test]
    fn bones_are_taken_apart() {
        let text =
            "knee 0 1 0\nhip 0 2 0\nspine 0 3 0\nlone 9 9 9\ntoe 0 0 0\n#\nhip spine\nknee toe\nhip knee\n";
        let skeleton = read(text).unwrap();
        assert!(skeleton.is_hierarchy() && skeleton.bone_count() == 4);
        let apart = skeleton.taken_apart();
        let ids: Vec<&str> = apart.joints.iter().map(|j| j.id.as_str()).collect();
        let wanted =
            ["lone", "hip/spine", "hip/spine/end", "knee", "knee/toe/end", "hip/knee", "hip/knee/end"];
        assert_eq!(ids, wanted);
        assert!(!apart.is_hierarchy());
        let knee = apart.find("knee").unwrap();
        assert_eq!(apart.bones(knee), [[DVec3::new(0.0, 2.0, 0.0), DVec3::ZERO]]);
        assert_eq!([0, 1, 2, 3].map(|bone| apart.mover(bone)), [0, 1, 3, 5]);
        assert_eq!(
            [0, 1, 2, 3].map(|bone| &skeleton.joints[skeleton.mover(bone)].id),
            ["lone", "hip", "knee", "hip"]
        );
    }

    #[test]
    fn what_is_no_skeleton_is_refused() {
        let told = |text: &str, parts: &[&str]| {
            let error = read(text).unwrap_err();
            for part in parts {
                assert!(error.message.contains(part), "{part}: {error}");
            }
            assert!(!error.hint.is_empty(), "{text}");
        };
        told("", &["no joints"]);
        told("1 0 0\n", &["line 1"]);
        told("1 0 0 0\n2 0 0 x\n", &["`2`", "line 2"]);
        told("1 0 0 0\n2 0 0 nan\n", &["`2`", "line 2"]);
        told("1 0 0 0\n1 0 0 1\n", &["two joints `1`", "line 2"]);
        told("1 0 0 0\n2 0 0 1\n#\n1 3\n", &["`3`", "line 4"]);
        told("1 0 0 0\n2 0 0 1\n#\n1\n", &["line 4"]);
        told("1 0 0 0\n2 0 0 1\n3 0 0 2\n#\n1 3\n2 3\n", &["`3` on two, `1` and `2`", "line 6"]);
        told("1 0 0 0\n2 0 0 1\n#\n1 2\n2 1\n", &["on itself"]);
        told("1 0 0 0\n#\n1 1\n", &["on itself"]);
        told("1 0 0 0\n2 0 0 0\n3 1 0 0\n#\n1 2\n", &["`1` and `2` are in one place"]);
    }

    /// Damaged files are an error or a skeleton whose joints come after those that they hang on, and nothing
    /// panics.
    #[test]
    fn damaged_files_do_no_harm() {
        let good = "1 0 0 0 0 1e-323\n2 1 0 0\nelbow 2 0 0.5\n4 9 9 9\n#\nelbow 2\n1 elbow 1 0 0\n2 4 0 0 1\n#\nno more\n";
        assert!(read(good).is_ok());
        simod_tests::damage::damaged_files(good, 500, |path| match Skeleton::read(path, |p| p) {
            Ok(skeleton) => {
                let mut joints = skeleton.joints.iter().enumerate();
                assert!(joints.all(|(i, j)| j.at.is_finite() && j.parent.is_none_or(|p| p < i)));
            }
            Err(e) => assert!(!e.message.is_empty() && !e.hint.is_empty()),
        });
    }

    proptest! {
        #[test]
        fn nothing_makes_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&String::from_utf8_lossy(&bytes));
        }

        #[test]
        fn nor_does_what_looks_right(lines in prop::collection::vec("[0-9a# .-]{0,12}", 0..12)) {
            let _ = parse(&lines.join("\n"));
        }
    }
}
