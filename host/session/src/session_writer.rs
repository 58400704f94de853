//! `session.toml`, written: what [`SessionFile::load`] reads, as a person would have put it. What has its
//! default is left out, and long strokes and selections go to files beside it.

use crate::motion::Motion;
use crate::picked::PickedPoints;
use crate::session_file::{
    Action, Deformation, FIRST_VERSION, HandleMove, Joint, Refine, Region, Role, Sampling, SessionFile,
    SessionTime, Step, Stroke, VERSION,
};
use crate::shapes::Shape;
use crate::strokes_file;
use glam::DVec3;
use serde::Serialize;
use simod_core::refinement::Finer;
use simod_core::sampled_model::relative;
use simod_model::target::folder_of;
use simod_model::{Error, ErrorKind, Result, matching, output};
use std::path::{Path, PathBuf};
use toml_edit::ser::ValueSerializer;
use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value, value};

impl SessionFile {
    /// Writes the session, whole or not at all; the model and the output are named as seen from its folder.
    /// Gives the files beside it that it refers to.
    ///
    /// # Errors
    /// A file cannot be written; a path is no text.
    pub fn save(&self, path: &Path) -> Result<Vec<PathBuf>> {
        let (text, strokes) = self.to_toml(path, true)?;
        output::write_file(path, text.as_bytes())?;
        Ok(strokes)
    }

    /// The files or patterns of its model, if that is made of tiles.
    fn named_tiles(&self) -> &[PathBuf] {
        match &self.model {
            Some(model) if matches!(matching(model), Ok(Some(_))) => std::slice::from_ref(model),
            Some(_) => &[],
            None => &self.tiles,
        }
    }

    /// The session's text at this path. Strokes and selections that are too long for it are written beside
    /// it, to these files, unless all has to be in the text.
    pub(crate) fn to_toml(&self, path: &Path, beside: bool) -> Result<(String, Vec<PathBuf>)> {
        let mut document = DocumentMut::new();
        document["version"] = value(self.version());
        let folder = folder_of(path);
        let mut files = Vec::new();
        let tiles = self.named_tiles();
        let named = match &self.model {
            _ if !tiles.is_empty() => Some(tiles_table(tiles, folder)?),
            Some(model) => Some(path_table(model, folder)?),
            None => None,
        };
        if let Some(mut model) = named {
            if let Some(columns) = &self.columns {
                model["columns"] = value(columns);
            }
            if let Some(fingerprint) = &self.fingerprint {
                model["fingerprint"] = value(fingerprint);
            }
            document["model"] = Item::Table(model);
        }
        if !self.follow.is_empty() {
            let declared = self.follow.iter().map(|(name, kind)| (name, Value::from(kind.name())));
            document["follow"] = Item::Table(declared.collect::<InlineTable>().into_table());
        }
        let sampling = sampling(&self.sampling);
        if !sampling.is_empty() {
            document["sampling"] = Item::Table(sampling);
        }
        if self.time != SessionTime::default() {
            document["time"] = Item::Table(time(&self.time));
        }
        if !self.steps.is_empty() {
            let step = |s| step(s, beside.then_some(path), &mut files);
            let steps = self.steps.iter().map(step).collect::<Result<ArrayOfTables>>()?;
            document["step"] = Item::ArrayOfTables(steps);
        }
        if let Some(output) = &self.output {
            document["output"] = Item::Table(path_table(output, folder)?);
        }
        Ok((document.to_string(), files))
    }

    /// The first version of the format that knows all that it says.
    fn version(&self) -> i64 {
        let has_amount = |step: &Step| step.deformation().is_some_and(|d| d.amount != 1.0);
        let is_newer =
            self.steps.iter().any(|step| step.title.is_some() || step.group.is_some() || has_amount(step));
        let is_newer = is_newer || !self.follow.is_empty() || !self.named_tiles().is_empty();
        if is_newer { VERSION } else { FIRST_VERSION }
    }
}

fn tiles_table(tiles: &[PathBuf], folder: &Path) -> Result<Table> {
    let mut table = Table::new();
    // The name of a link is kept, and a pattern is no name of a file.
    let named = |tile: &PathBuf| relative(folder_of(tile), folder).join(tile.file_name().unwrap_or_default());
    let paths = tiles.iter().map(|tile| text(&named(tile))).collect::<Result<Array>>()?;
    table["tiles"] = value(paths);
    Ok(table)
}

fn path_table(path: &Path, folder: &Path) -> Result<Table> {
    let mut table = Table::new();
    table["path"] = value(text(&relative(path, folder))?);
    Ok(table)
}

/// A path as a session has it.
pub(crate) fn text(path: &Path) -> Result<String> {
    path.to_str().map(str::to_owned).ok_or_else(|| {
        let what = format!("the name {} is no text, which a session has to be", path.display());
        Error::new(ErrorKind::Argument, what, "rename the file or its folder")
    })
}

fn sampling(from: &Sampling) -> Table {
    let mut table = Table::new();
    if let Some(samples) = from.samples {
        table["samples"] = value(i64::try_from(samples).unwrap_or(i64::MAX));
    }
    if let Some(error) = from.error {
        table["error"] = value(error);
    }
    if let Some(grid) = from.grid {
        table["grid"] = value(i64::from(grid));
    }
    if let Some(by) = from.by {
        table["by"] = value(by.name());
    }
    if let Some(place) = from.place {
        table["place"] = value(place.name());
    }
    if let Some(sheets) = from.sheets {
        table["sheets"] = value(sheets);
    }
    if let Some(least) = from.min_opacity {
        table["min-opacity"] = value(least);
    }
    table
}

fn time(from: &SessionTime) -> Table {
    let mut table = Table::new();
    if let Some(frame) = from.frame {
        table["frame"] = value(frame);
    }
    if let Some(rate) = from.rate {
        table["rate"] = value(rate);
    }
    if let Some(seconds) = from.seconds {
        table["seconds"] = value(seconds);
    }
    table
}

fn step(from: &Step, session: Option<&Path>, files: &mut Vec<PathBuf>) -> Result<Table> {
    let mut table = Table::new();
    if let Some(title) = &from.title {
        table["title"] = value(title);
    }
    if let Some(group) = &from.group {
        table["group"] = value(group);
    }
    if !from.enabled {
        table["enabled"] = value(false);
    }
    match &from.action {
        Action::Deform(from) => deformation(from, session, files, &mut table)?,
        Action::Refine(from) => table["refine"] = value(refine(from, session, files)?),
    }
    Ok(table)
}

fn refine(from: &Refine, session: Option<&Path>, files: &mut Vec<PathBuf>) -> Result<InlineTable> {
    let count = |samples: u64| Value::from(i64::try_from(samples).unwrap_or(i64::MAX));
    let shapes = shapes(&from.shapes.shapes, session, files)?;
    let mut table = InlineTable::new();
    if !shapes.is_empty() {
        table.insert("shapes", shapes.into());
    }
    match from.finer {
        Finer::Error(error) => _ = table.insert("error", error.into()),
        Finer::Factor(factor) => _ = table.insert("factor", factor.into()),
        Finer::Samples(samples) => _ = table.insert("samples", count(samples)),
        Finer::Auto { error, samples } => {
            table.insert("auto", true.into());
            table.insert("error", error.into());
            samples.map(|samples| table.insert("samples", count(samples)));
        }
    }
    Ok(table)
}

fn deformation(
    from: &Deformation,
    session: Option<&Path>,
    files: &mut Vec<PathBuf>,
    table: &mut Table,
) -> Result<()> {
    table["deform"] = value(&from.deform);
    if let Some(origin) = &from.plugin {
        let plugin = origin.serialize(ValueSerializer::new()).map_err(|e| lost("a plugin's origin", &e))?;
        table["plugin"] = value(plugin);
    }
    if let Some(version) = from.state_version {
        table["state-version"] = value(i64::from(version));
    }
    if !from.params.is_empty() {
        table["params"] = value(inline(&from.params)?);
    }
    if from.amount != 1.0 {
        table["amount"] = value(from.amount);
    }
    let long = session.filter(|_| strokes_file::is_needed(&from.strokes));
    if let Some(session) = long {
        let reference = strokes_file::write(session, &from.strokes)?;
        files.push(folder_of(session).join(&reference.file));
        let mut file = InlineTable::new();
        file.insert("file", text(&reference.file)?.into());
        file.insert("fingerprint", reference.fingerprint.into());
        table["strokes"] = value(file);
    }
    let mut tables = |key: &str, all: ArrayOfTables| {
        if !all.is_empty() {
            table[key] = Item::ArrayOfTables(all);
        }
    };
    let regions = from.regions.iter().map(|r| region(r, session, files));
    tables("region", regions.collect::<Result<_>>()?);
    tables("joint", from.joints.iter().map(joint).collect());
    tables("handle", from.handles.iter().map(handle).collect());
    if long.is_none() {
        tables("stroke", from.strokes.iter().map(|s| stroke(s)).collect::<Result<_>>()?);
    }
    Ok(())
}

fn region(from: &Region, session: Option<&Path>, files: &mut Vec<PathBuf>) -> Result<Table> {
    let mut table = Table::new();
    table["role"] = value(match from.role {
        Role::Fixed => "fixed",
        Role::Handle => "handle",
        Role::Mask => "mask",
    });
    table["shapes"] = value(shapes(&from.shapes.shapes, session, files)?);
    if from.shapes.falloff != 0.0 {
        table["falloff"] = value(from.shapes.falloff);
    }
    if from.motion != Motion::default() {
        table["move"] = value(motion(&from.motion));
    }
    Ok(table)
}

/// The shapes in one line; selections that are too long for it are written beside the session, if there is
/// one.
fn shapes(from: &[Shape], session: Option<&Path>, files: &mut Vec<PathBuf>) -> Result<Array> {
    let shape = |shape: &Shape| -> Result<Value> {
        let in_file = match (shape, session) {
            (Shape::Selection(picked), Some(session)) => picked.stored(session)?.map(|file| {
                files.push(folder_of(session).join(&file.file));
                Shape::Selection(PickedPoints::in_file(file))
            }),
            _ => None,
        };
        in_file.as_ref().unwrap_or(shape).serialize(ValueSerializer::new()).map_err(|e| lost("a shape", &e))
    };
    from.iter().map(shape).collect()
}

/// What differs from no motion at all.
fn motion(from: &Motion) -> InlineTable {
    let none = Motion::default();
    let mut table = InlineTable::new();
    if from.translate != none.translate {
        table.insert("translate", vector(from.translate));
    }
    if from.degrees != none.degrees || from.axis != none.axis {
        table.insert("axis", vector(from.axis));
        table.insert("degrees", from.degrees.into());
    }
    if let Some(pivot) = from.pivot {
        table.insert("pivot", vector(pivot));
    }
    if from.scale != none.scale {
        table.insert("scale", from.scale.into());
    }
    table
}

fn joint(from: &Joint) -> Table {
    let mut table = Table::new();
    table["id"] = value(&from.id);
    table["at"] = value(vector(from.at));
    if let Some(parent) = &from.parent {
        table["parent"] = value(parent);
    }
    table
}

fn handle(from: &HandleMove) -> Table {
    let mut table = Table::new();
    table["id"] = value(&from.id);
    table["move"] = value(motion(&from.motion));
    table
}

fn stroke(from: &Stroke) -> Result<Table> {
    let mut table = Table::new();
    table["radius"] = value(from.radius);
    table["strength"] = value(from.strength);
    table["points"] = value(from.points.iter().map(|p| vector(*p)).collect::<Array>());
    if !from.pressures.is_empty() {
        table["pressures"] = value(from.pressures.iter().map(|p| f64::from(*p)).collect::<Array>());
    }
    if !from.params.is_empty() {
        table["params"] = value(inline(&from.params)?);
    }
    Ok(table)
}

fn vector(v: DVec3) -> Value {
    Value::Array(v.to_array().into_iter().collect())
}

fn lost(what: &str, e: &dyn std::fmt::Display) -> Error {
    Error::internal(format!("cannot write {what}: {e}"), "report this")
}

/// Values as they were given, in one line.
fn inline(from: &toml::Table) -> Result<InlineTable> {
    let text = toml::Value::Table(from.clone()).to_string();
    match text.parse::<Value>() {
        Ok(Value::InlineTable(table)) => Ok(table),
        Ok(other) => Err(lost("parameters", &other.type_name())),
        Err(e) => Err(lost("parameters", &e.message())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session_file::Origin;
    use crate::shapes::Shapes;
    use simod_core::sampling::{By, Placement};
    use simod_model::follow::Kind;
    use std::sync::Arc;

    fn stroke(points: usize) -> Arc<Stroke> {
        let points: Vec<DVec3> = (0..points).map(|i| DVec3::new(i as f64 / 3.0, 1e-30, -2e6)).collect();
        let pressures = points.iter().enumerate().map(|(i, _)| i as f32 / points.len() as f32).collect();
        let params = "brush = \"smooth\"\nfalloff = [[0.0, 1.0], [1.0, 0.0]]".parse().unwrap();
        Arc::new(Stroke { radius: 0.1, strength: -1.0, points, pressures, params })
    }

    fn session(folder: &Path) -> SessionFile {
        let shapes = vec![
            Shape::HalfSpace { point: DVec3::ZERO, normal: DVec3::NEG_Y },
            Shape::Sphere { center: DVec3::new(0.1, 300.0, 0.0), radius: 1.0 / 3.0 },
            Shape::Box { min: DVec3::ZERO, max: DVec3::ONE },
        ];
        let region = |role, falloff, motion| Region {
            role,
            shapes: Shapes { shapes: shapes.clone(), falloff },
            motion,
        };
        let turned = Motion { degrees: 30.0, pivot: Some(DVec3::ZERO), scale: 2.0, ..Motion::default() };
        let shifted = Motion { translate: DVec3::X, axis: DVec3::Z, ..Motion::default() };
        let deformation = Deformation {
            param_places: Default::default(),
            notes: Default::default(),
            deform: "rbf".to_owned(),
            plugin: None,
            state_version: Some(3),
            params: "kernel = \"triharmonic\"\ntolerance = 1e-4\nname = \"a \\\" b\"".parse().unwrap(),
            regions: vec![
                region(Role::Fixed, 0.0, Motion::default()),
                region(Role::Handle, 2.5, turned),
                region(Role::Mask, 1e-9, Motion::default()),
            ],
            joints: vec![
                Joint { id: "arm".to_owned(), at: DVec3::ONE, parent: None },
                Joint { id: "hand".to_owned(), at: DVec3::X, parent: Some("arm".to_owned()) },
            ],
            handles: vec![HandleMove { id: "3,3,3".to_owned(), motion: shifted }],
            strokes: vec![stroke(3), stroke(1)],
            amount: 0.75,
            folder: folder.to_owned(),
        };
        let mut long =
            Deformation { strokes: vec![stroke(5000), stroke(2)], amount: 1.0, ..deformation.clone() };
        let (version, author) = ("1.0.3".to_owned(), "A \"B\"".to_owned());
        long.plugin = Some(Origin { version, author, url: String::new() });
        for points in [10, 5000] {
            let all: Vec<DVec3> = (0..points).map(|i| DVec3::splat(f64::from(i) / 3.0)).collect();
            let picked = PickedPoints::new(all, vec![DVec3::NEG_X]);
            long.regions[0].shapes.shapes.push(Shape::Selection(picked));
        }
        let refine =
            |finer| Action::Refine(Refine { shapes: Shapes { shapes: shapes.clone(), falloff: 0.0 }, finer });
        let step = |action, enabled| Step { enabled, ..Step::new(action) };
        let titled = |step: Step| Step {
            title: Some("Arms, \"up\"".to_owned()),
            group: Some("Both arms".to_owned()),
            ..step
        };
        SessionFile {
            model: Some(folder.join("models/nefertiti.ply")),
            tiles: Vec::new(),
            columns: Some("x,y,z,_,nx,ny,nz".into()),
            follow: [("n1".to_owned(), Kind::Normal), ("t".to_owned(), Kind::Vector)].into(),
            fingerprint: Some("xxh3-128:0".to_owned()),
            sampling: Sampling {
                samples: Some(50_000),
                error: None,
                grid: Some(64),
                place: Some(Placement::Vertices),
                by: Some(By::Area),
                sheets: Some(true),
                min_opacity: Some(0.25),
            },
            time: SessionTime { frame: Some(-3), rate: Some(25.0), seconds: None },
            steps: vec![
                step(Action::Deform(deformation), false),
                titled(step(refine(Finer::Factor(4.0)), true)),
                step(Action::Deform(long), true),
                step(refine(Finer::Error(1e-5)), false),
                step(refine(Finer::Samples(1000)), true),
                step(refine(Finer::Auto { error: 1e-6, samples: Some(500) }), true),
                step(
                    Action::Refine(Refine {
                        shapes: Shapes::default(),
                        finer: Finer::Auto { error: 1e-5, samples: None },
                    }),
                    true,
                ),
            ],
            output: Some(folder.join("out.ply")),
            named_output: Some("out.ply".into()),
        }
    }

    fn without_places(mut session: SessionFile) -> SessionFile {
        session.steps.iter_mut().for_each(|step| step.place.clear());
        session
    }

    #[test]
    fn a_session_comes_back_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().canonicalize().unwrap();
        let path = folder.join("edit.toml");
        let session = session(&folder);
        session.save(&path).unwrap();
        assert_eq!(without_places(SessionFile::load(&path).unwrap()), session);
        // And what was read is written as it was.
        let text = std::fs::read_to_string(&path).unwrap();
        SessionFile::load(&path).unwrap().save(&path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn tiles_come_back_in_version_2() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().canonicalize().unwrap();
        let path = folder.join("edit.toml");
        std::fs::create_dir(folder.join("tiles")).unwrap();
        let tiles = ["tiles/*.laz", "tiles/more.las"].map(|name| folder.join(name)).to_vec();
        let session = SessionFile { tiles, ..SessionFile::default() };
        session.save(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("version = 2"), "{text}");
        assert!(text.contains(r#"tiles = ["tiles/*.laz", "tiles/more.las"]"#), "{text}");
        assert_eq!(SessionFile::load(&path).unwrap(), session);
        for (wrong, what) in
            [("[model]\npath = 'a'\ntiles = 'b'", "both"), ("[model]\ncolumns = 'x,y,z'", "no `path`")]
        {
            let error = SessionFile::parse(wrong, &path).unwrap_err().to_string();
            assert!(error.contains(what) && error.contains("edit.toml, line"), "{error}");
        }
    }

    #[test]
    fn it_reads_as_a_person_would_have_written_it() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().canonicalize().unwrap();
        let mut session = session(&folder);
        session.steps.truncate(2);
        let Action::Deform(first) = &mut session.steps[0].action else { panic!("a deformation") };
        first.strokes.clear();
        let (text, _) = session.to_toml(&folder.join("edit.toml"), true).unwrap();
        assert_eq!(
            text,
            r#"version = 2

[model]
path = "models/nefertiti.ply"
columns = "x,y,z,_,nx,ny,nz"
fingerprint = "xxh3-128:0"

[follow]
n1 = "normal"
t = "vector"

[sampling]
samples = 50000
grid = 64
by = "area"
place = "vertices"
sheets = true
min-opacity = 0.25

[time]
frame = -3
rate = 25.0

[[step]]
enabled = false
deform = "rbf"
state-version = 3
params = { kernel = "triharmonic", name = 'a " b', tolerance = 0.0001 }
amount = 0.75

[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [0.0, 0.0, 0.0], normal = [0.0, -1.0, 0.0] } }, { sphere = { center = [0.1, 300.0, 0.0], radius = 0.3333333333333333 } }, { box = { min = [0.0, 0.0, 0.0], max = [1.0, 1.0, 1.0] } }]

[[step.region]]
role = "handle"
shapes = [{ half-space = { point = [0.0, 0.0, 0.0], normal = [0.0, -1.0, 0.0] } }, { sphere = { center = [0.1, 300.0, 0.0], radius = 0.3333333333333333 } }, { box = { min = [0.0, 0.0, 0.0], max = [1.0, 1.0, 1.0] } }]
falloff = 2.5
move = { axis = [0.0, 1.0, 0.0], degrees = 30.0, pivot = [0.0, 0.0, 0.0], scale = 2.0 }

[[step.region]]
role = "mask"
shapes = [{ half-space = { point = [0.0, 0.0, 0.0], normal = [0.0, -1.0, 0.0] } }, { sphere = { center = [0.1, 300.0, 0.0], radius = 0.3333333333333333 } }, { box = { min = [0.0, 0.0, 0.0], max = [1.0, 1.0, 1.0] } }]
falloff = 0.000000001

[[step.joint]]
id = "arm"
at = [1.0, 1.0, 1.0]

[[step.joint]]
id = "hand"
at = [1.0, 0.0, 0.0]
parent = "arm"

[[step.handle]]
id = "3,3,3"
move = { translate = [1.0, 0.0, 0.0], axis = [0.0, 0.0, 1.0], degrees = 0.0 }

[[step]]
title = 'Arms, "up"'
group = "Both arms"
refine = { shapes = [{ half-space = { point = [0.0, 0.0, 0.0], normal = [0.0, -1.0, 0.0] } }, { sphere = { center = [0.1, 300.0, 0.0], radius = 0.3333333333333333 } }, { box = { min = [0.0, 0.0, 0.0], max = [1.0, 1.0, 1.0] } }], factor = 4.0 }

[output]
path = "out.ply"
"#
        );
        let empty = SessionFile::default().to_toml(Path::new("edit.toml"), true).unwrap();
        assert_eq!(empty, ("version = 1\n".to_owned(), Vec::new()));
    }

    #[test]
    fn what_former_programs_understand_stays_of_the_first_version() {
        let version = |step: Step| {
            let session = SessionFile { steps: vec![step], ..SessionFile::default() };
            session.to_toml(Path::new("edit.toml"), true).unwrap().0.lines().next().unwrap().to_owned()
        };
        let deform =
            |amount| Step::new(Action::Deform(Deformation { amount, ..Deformation::by_plugin("warp") }));
        assert_eq!(version(deform(1.0)), "version = 1");
        assert_eq!(version(deform(0.0)), "version = 2");
        assert_eq!(version(Step { title: Some("a".to_owned()), ..deform(1.0) }), "version = 2");
        assert_eq!(version(Step { group: Some("a".to_owned()), ..deform(1.0) }), "version = 2");
    }
}
