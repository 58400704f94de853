//! Steps and their parts in recordings of edits: each as a session has it, by the writer and the reader of
//! sessions. Of a step, the folder that its files are seen from is recorded as well.
//!
//! Former programs recorded steps field by field; their recordings are read by the derived implementations of
//! the types.

use crate::edit::seen_from;
use crate::motion::Motion;
use crate::session_file::SessionFile;
use crate::step::{Action, Deformation, HandleMove, Refine, Region, Role, Step};
use serde::de::Error as _;
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Reads a recording: as a session has it, or as former programs wrote it, which `is_former` tells.
fn read<'de, D: Deserializer<'de>, Table: for<'t> Deserialize<'t>, T>(
    from: D,
    is_former: impl Fn(&Value) -> bool,
    former: impl Fn(Value) -> serde_json::Result<T>,
    of_table: impl Fn(Table) -> Result<T, String>,
) -> Result<T, D::Error> {
    let value = Value::deserialize(from)?;
    if is_former(&value) {
        return former(value).map_err(D::Error::custom);
    }
    of_table(serde_json::from_value(value).map_err(D::Error::custom)?).map_err(D::Error::custom)
}

/// Writes the table of a session, if the session can have it.
fn write<S: Serializer>(table: Result<impl Serialize, String>, to: S) -> Result<S::Ok, S::Error> {
    table.map_err(S::Error::custom)?.serialize(to)
}

/// Record of a step, with the folder and the place that a session's file tells by where it is.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StepRecord {
    /// Step as a session has it.
    step: toml::Table,
    /// Folder to which the paths of the step's files are relative.
    #[serde(default)]
    folder: PathBuf,
    /// Place of the step in a file, for errors.
    #[serde(default)]
    place: String,
}

impl Serialize for Step {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let folder = self.deformation().map(|deformation| deformation.folder.clone()).unwrap_or_default();
        let record = |step| StepRecord { step, folder, place: self.place.clone() };
        write(table_of(self.clone()).map(record), to)
    }
}

impl<'de> Deserialize<'de> for Step {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let of_record = |StepRecord { step, folder, place }| Ok(Self { place, ..step_of(step, &folder)? });
        read(from, |value| value.get("action").is_some(), Self::deserialize, of_record)
    }
}

impl Serialize for Refine {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let table = table_of(Step::new(Action::Refine(self.clone())));
        write(table.map(|mut table| table.remove("refine")), to)
    }
}

impl<'de> Deserialize<'de> for Refine {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let of_table = |table: toml::Value| match step_of(table_with("refine", table), Path::new(""))?.action
        {
            Action::Refine(refine) => Ok(refine),
            Action::Deform(_) => Err("it refines nothing".to_owned()),
        };
        read(from, |value| value.get("finer").is_some(), Self::deserialize, of_table)
    }
}

impl Serialize for Region {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        // A region that was made another one than a handle may still have a motion, which is not used.
        let motion = if self.role == Role::Handle { self.motion } else { Motion::default() };
        let region = Self { motion, ..self.clone() };
        let around = Deformation { regions: vec![region], ..Deformation::by_plugin(ANY) };
        write(part_of("region", around), to)
    }
}

impl<'de> Deserialize<'de> for Region {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let is_former = |value: &Value| value.get("shapes").is_some_and(Value::is_object);
        let only = |around: Deformation| around.regions.into_iter().next();
        read(from, is_former, Self::deserialize, |table| only_part("region", table, only))
    }
}

impl Serialize for HandleMove {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let around = Deformation { handles: vec![self.clone()], ..Deformation::by_plugin(ANY) };
        write(part_of("handle", around), to)
    }
}

impl<'de> Deserialize<'de> for HandleMove {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let is_former = |value: &Value| value.get("motion").is_some();
        let only = |around: Deformation| around.handles.into_iter().next();
        read(from, is_former, Self::deserialize, |table| only_part("handle", table, only))
    }
}

/// The plugin of the step that a part is read and written in.
const ANY: &str = "any";

/// Table of the only part of its kind in a step, as a session has it.
fn part_of(kind: &str, around: Deformation) -> Result<toml::Value, String> {
    let mut table = table_of(Step::new(Action::Deform(around)))?;
    only_element(table.remove(kind)).ok_or_else(|| format!("it is no {kind}"))
}

/// A part of a kind, read from a recording's table as the only one of a step.
fn only_part<T>(kind: &str, part: toml::Value, only: impl Fn(Deformation) -> Option<T>) -> Result<T, String> {
    let mut table = table_with(kind, vec![part].into());
    table.insert("deform".to_owned(), ANY.into());
    let step = step_of(table, Path::new(""))?;
    step.deformation().cloned().and_then(only).ok_or_else(|| format!("it is no {kind}"))
}

/// A step as a session has it, with all strokes and selections.
fn table_of(step: Step) -> Result<toml::Table, String> {
    let session = SessionFile { steps: vec![step], ..SessionFile::default() };
    let text = session.to_toml(Path::new("")).map_err(|e| e.to_string())?;
    let mut session: toml::Table = toml::from_str(&text).map_err(|e| e.to_string())?;
    match only_element(session.remove("step")) {
        Some(toml::Value::Table(step)) => Ok(step),
        _ => Err("it is no step".to_owned()),
    }
}

/// The step of a session's table.
fn step_of(table: toml::Table, folder: &Path) -> Result<Step, String> {
    let session = table_with("step", vec![table].into());
    let read =
        SessionFile::parse(&session.to_string(), Path::new("")).map_err(|e| without_place(&e.to_string()));
    let mut step = read?.steps.pop().ok_or("it is no step")?;
    seen_from(&mut step, folder);
    Ok(step)
}

/// Error text of a session that is in no file: without its place.
fn without_place(what: &str) -> String {
    what.split_once(": ").map_or(what, |(_, what)| what).to_owned()
}

fn table_with(key: &str, value: toml::Value) -> toml::Table {
    [(key.to_owned(), value)].into_iter().collect()
}

fn only_element(list: Option<toml::Value>) -> Option<toml::Value> {
    match list {
        Some(toml::Value::Array(list)) => list.into_iter().next(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Change, EditCommand};
    use crate::picked::PickedPoints;
    use crate::shapes::{RegionShape, Shapes};
    use crate::step::{Joint, Stroke};
    use glam::DVec3;
    use simod_core::refinement::Finer;
    use std::fmt::Debug;
    use std::sync::Arc;

    fn region() -> Region {
        let ball = RegionShape::Sphere { center: DVec3::new(0.1, 300.0, 1e-30), radius: 1.0 / 3.0 };
        let picked = PickedPoints::new(vec![DVec3::splat(1.0 / 3.0)], vec![DVec3::X]);
        let shapes = Shapes { shapes: vec![ball, RegionShape::Selection(picked)], falloff: 0.3 };
        Region { role: Role::Handle, shapes, motion: motion() }
    }

    fn motion() -> Motion {
        Motion { degrees: 30.1, pivot: Some(DVec3::ZERO), ..Motion::default() }
    }

    fn refine() -> Refine {
        let shapes = Shapes { falloff: 0.0, ..region().shapes };
        Refine { shapes, finer: Finer::Auto { error: 1e-3, samples: Some(7) } }
    }

    fn step() -> Step {
        let points = vec![DVec3::new(1.0 / 3.0, 1e-30, -2e6); 3];
        let params = "brush = \"smooth\"\nfalloff = [[0.0, 1.0], [1.0, 0.0]]".parse().unwrap();
        let stroke = Stroke { radius: 0.1, strength: -1.0, points, pressures: vec![0.1, 0.2, 1.0], params };
        let deformation = Deformation {
            state_version: Some(3),
            params: "kernel = \"triharmonic\"\ntolerance = 1e-4\nname = \"a \\\" b\"".parse().unwrap(),
            regions: vec![region()],
            joints: vec![Joint { id: "arm".to_owned(), at: DVec3::ONE, parent: None }],
            handles: vec![HandleMove { id: "3,3,3".to_owned(), motion: motion() }],
            strokes: vec![Arc::new(stroke)],
            amount: 0.7,
            folder: "some/where".into(),
            ..Deformation::by_plugin("rbf")
        };
        let title = Some("Arms, \"up\"".to_owned());
        Step {
            title,
            enabled: false,
            place: "s.toml, line 9".to_owned(),
            ..Step::new(Action::Deform(deformation))
        }
    }

    /// A command comes back the same, in the form of a session.
    fn assert_comes_back<T: Serialize + for<'de> Deserialize<'de> + PartialEq + Debug>(what: &T, has: &str) {
        let text = serde_json::to_string(what).unwrap();
        assert!(text.contains(has), "{text}");
        assert_eq!(serde_json::from_str::<T>(&text).unwrap(), *what, "{text}");
    }

    #[test]
    fn what_is_recorded_is_as_in_a_session() {
        assert_comes_back(&step(), r#""step":{"amount":0.7,"deform":"rbf","enabled":false,"handle":[{"id""#);
        assert_comes_back(&Step::new(Action::Refine(refine())), r#""step":{"refine":{"auto":true,"#);
        assert_comes_back(&refine(), r#"{"auto":true,"error":0.001,"samples":7,"shapes":[{"#);
        assert_comes_back(&region(), r#"{"falloff":0.3,"move":{"axis":[0.0,1.0,0.0],"degrees":30.1,"#);
        let mask = Region { role: Role::Mask, ..region() };
        let text = serde_json::to_string(&mask).unwrap();
        let read: Region = serde_json::from_str(&text).unwrap();
        assert_eq!(read, Region { motion: Motion::default(), ..mask });
        assert_comes_back(&HandleMove { id: "a".to_owned(), motion: motion() }, r#"{"id":"a","move":{"#);
    }

    /// Recordings of these that a former program wrote.
    #[test]
    fn former_recordings_are_read() {
        let lines = include_str!("former-recording.jsonl").lines();
        let read: Vec<EditCommand> = lines.map(|line| serde_json::from_str(line).unwrap()).collect();
        let change = |change| EditCommand::Change { at: 0, change };
        let expected = [
            EditCommand::Add { at: 0, step: Box::new(step()) },
            EditCommand::Insert { at: 0, steps: vec![Step::new(Action::Refine(refine()))] },
            change(Change::SetRegions(vec![region()])),
            change(Change::MoveHandles(vec![HandleMove { id: "3,3,3".to_owned(), motion: motion() }])),
            change(Change::SetRefine(refine())),
        ];
        assert_eq!(read, expected);
        for command in expected {
            assert_comes_back(&command, "\"at\":0");
        }
    }

    #[test]
    fn what_makes_no_sense_is_told_without_a_line() {
        let told = |text: &str, what: &str| {
            let error = serde_json::from_str::<Region>(text).unwrap_err().to_string();
            assert!(error.starts_with(what), "{error}");
        };
        told(r#"{"role":"mask","shapes":[]}"#, "the region has no shape");
        told(
            r#"{"role":"mask","shapes":[{"sphere":{"center":[0,0,0],"radius":-1}}]}"#,
            "the radius of a sphere",
        );
        assert!(serde_json::from_str::<Refine>(r#"{"auto":true,"factor":2}"#).is_err());
        assert!(serde_json::from_str::<Step>("{\"step\":{}}").is_err());
        assert!(serde_json::from_str::<Step>("7").is_err());
    }
}
