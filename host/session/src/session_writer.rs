//! `session.toml`, written: what [`SessionFile::load`] reads, as a person would have put it. Values that are
//! their defaults are left out, and long strokes and selections go to files beside the session.

use crate::motion::Motion;
use crate::picked::PickedPoints;
use crate::session_file::{FIRST_VERSION, SamplingTable, SessionFile, SessionTime, VERSION, read_text};
use crate::session_layout;
use crate::session_tables::{
    HandleTable, ModelTable, PathTable, RefineTable, RegionTable, SessionTable, StepTable, TileNames,
    placeless,
};
use crate::shapes::RegionShape;
use crate::step::{Action, Deformation, HandleMove, Refine, Region, Step};
use crate::strokes_file;
use simod_core::refinement::Finer;
use simod_core::sampled_model::relative;
use simod_core::tables::Spanned;
use simod_model::target::folder_of;
use simod_model::{Error, Result, matching, output};
use std::path::{Path, PathBuf};
use toml_edit::{DocumentMut, Item, Table};

impl SessionFile {
    /// Writes the session, whole or not at all; the model and the output are named relative to its folder.
    /// Returns the files beside the session that the session refers to.
    ///
    /// # Errors
    /// A file cannot be written; a path is no text.
    pub fn save(&self, path: &Path) -> Result<Vec<PathBuf>> {
        let (document, beside) = self.to_document(path, true)?;
        output::write_file(path, document.to_string().as_bytes())?;
        Ok(beside)
    }

    /// Saves the session where it was made by changes of a `former` one: the comments, the order and the
    /// spellings of that file stay wherever the content is the same.
    ///
    /// # Errors
    /// As of [`save`](Self::save). A former session that cannot be read has nothing that could be kept.
    pub fn save_over(&self, path: &Path, former: &Path) -> Result<Vec<PathBuf>> {
        let (document, beside) = self.to_document(path, true)?;
        let mut text = document.to_string();
        if let Some((file, base)) = Self::as_it_stands(former) {
            let changed = session_layout::changed(file, &base, document).to_string();
            // A changed text that would be read as another session is not written: joints, say, may stand in
            // another order than they are read in.
            let read = Self::parse(&changed, path).and_then(|read| read.to_toml(path));
            if read.is_ok_and(|read| Some(read) == self.to_toml(path).ok()) {
                text = changed;
            }
        }
        output::write_file(path, text.as_bytes())?;
        Ok(beside)
    }

    /// File of a session, and its content as this program would write it; none where either cannot be had.
    fn as_it_stands(former: &Path) -> Option<(DocumentMut, DocumentMut)> {
        let text = read_text(former, "session", "").ok()?;
        let session = Self::parse(&text, former).ok()?;
        Some((text.parse().ok()?, session.to_document(former, false).ok()?.0))
    }

    /// Text of the session for this path, with all strokes and selections in it.
    pub(crate) fn to_toml(&self, path: &Path) -> Result<String> {
        Ok(self.to_document(path, false)?.0.to_string())
    }

    /// The session at this path. Strokes and selections that are too long for it are written beside it, to
    /// these files, unless all has to be in the text.
    fn to_document(&self, path: &Path, beside: bool) -> Result<(DocumentMut, Vec<PathBuf>)> {
        let mut writer =
            Writer { session: beside.then_some(path), folder: folder_of(path), files: Vec::new() };
        let mut table = SessionTable {
            version: Some(placeless(FIRST_VERSION)),
            model: writer.model(self)?.map(placeless),
            follow: (!self.follow.is_empty()).then(|| placeless(self.follow.clone())),
            sampling: (self.sampling != SamplingTable::default()).then_some(placeless(self.sampling)),
            time: (self.time != SessionTime::default()).then_some(placeless(self.time)),
            step: spanned(&self.steps, |step| writer.step(step))?,
            output: self.output.as_deref().map(|output| writer.output(output)).transpose()?,
        };
        if table.of_version_2().is_some() {
            table.version = Some(placeless(VERSION));
        }
        let document = toml_edit::ser::to_document(&table);
        let mut document = document.map_err(|e| Error::unwritable("a session", e))?;
        lay_out(&mut document);
        Ok((document, writer.files))
    }

    /// Files or patterns of the model, if it is made of tiles.
    fn named_tiles(&self) -> &[PathBuf] {
        match &self.model {
            Some(model) if matches!(matching(model), Ok(Some(_))) => std::slice::from_ref(model),
            Some(_) => &[],
            None => &self.tiles,
        }
    }
}

/// Lays out tables by themselves, and their contents in one line each.
fn lay_out(document: &mut DocumentMut) {
    for (key, item) in document.iter_mut() {
        if key == "step" {
            tables(item, |step| {
                let several = step.iter_mut().filter(|(key, _)| SEVERAL.contains(&key.get()));
                several.for_each(|(_, item)| tables(item, |_| {}));
            });
        } else if item.as_inline_table().is_some() {
            *item = Item::Table(std::mem::take(item).into_table().unwrap_or_default());
        }
    }
}

/// Keys of which a step may have several, each a table by itself.
const SEVERAL: [&str; 4] = ["region", "joint", "handle", "stroke"];

/// An array of tables by themselves, each laid out.
fn tables(item: &mut Item, lay_out: impl Fn(&mut Table)) {
    let mut all = std::mem::take(item).into_array_of_tables().unwrap_or_default();
    all.iter_mut().for_each(lay_out);
    *item = Item::ArrayOfTables(all);
}

/// Text of a path as a session has it.
pub(crate) fn text(path: &Path) -> Result<String> {
    path.to_str().map(str::to_owned).ok_or_else(|| {
        let what = format!("the name {} is no text, which a session has to be", path.display());
        Error::argument(what, "rename the file or its folder")
    })
}

/// Several tables, in order.
fn spanned<T, U>(all: &[T], mut table: impl FnMut(&T) -> Result<U>) -> Result<Vec<Spanned<U>>> {
    all.iter().map(|one| table(one).map(placeless)).collect()
}

/// A writer of the tables of a session that goes to a place.
struct Writer<'a> {
    /// Path of the session, if contents that are too long for it may go beside it.
    session: Option<&'a Path>,
    /// Folder to which the paths of the model and the output are relative.
    folder: &'a Path,
    /// Files that were written beside the session.
    files: Vec<PathBuf>,
}

impl Writer<'_> {
    fn model(&self, session: &SessionFile) -> Result<Option<ModelTable>> {
        let tiles = session.named_tiles();
        let mut table = ModelTable::default();
        if !tiles.is_empty() {
            let names = tiles.iter().map(|tile| self.tile(tile)).collect::<Result<_>>()?;
            table.tiles = Some(placeless(TileNames::Several(names)));
        } else if let Some(model) = &session.model {
            table.path = Some(text(&relative(model, self.folder))?.into());
        } else {
            return Ok(None);
        }
        table.columns.clone_from(&session.columns);
        table.fingerprint.clone_from(&session.fingerprint);
        Ok(Some(table))
    }

    /// A tile's name: that of a link is kept, and a pattern is no name of a file.
    fn tile(&self, tile: &Path) -> Result<PathBuf> {
        let name = relative(folder_of(tile), self.folder).join(tile.file_name().unwrap_or_default());
        Ok(text(&name)?.into())
    }

    fn output(&self, output: &Path) -> Result<PathTable> {
        Ok(PathTable { path: text(&relative(output, self.folder))?.into() })
    }

    fn step(&mut self, from: &Step) -> Result<StepTable> {
        let table = match &from.action {
            Action::Deform(from) => self.deformation(from)?,
            Action::Refine(from) => {
                StepTable { refine: Some(placeless(self.refine(from)?)), ..StepTable::default() }
            }
        };
        Ok(StepTable {
            title: from.title.clone().map(placeless),
            group: from.group.clone().map(placeless),
            enabled: (!from.enabled).then_some(false),
            ..table
        })
    }

    fn refine(&mut self, from: &Refine) -> Result<RefineTable> {
        let shapes = self.shapes(&from.shapes.shapes)?;
        let table = RefineTable {
            shapes: Some(shapes).filter(|shapes| !shapes.is_empty()),
            ..RefineTable::default()
        };
        Ok(match from.finer {
            Finer::Error(error) => RefineTable { error: Some(error), ..table },
            Finer::Factor(factor) => RefineTable { factor: Some(factor), ..table },
            Finer::Samples(samples) => RefineTable { samples: Some(samples), ..table },
            Finer::Auto { error, samples } => {
                RefineTable { auto: Some(true), error: Some(error), samples, ..table }
            }
        })
    }

    fn deformation(&mut self, from: &Deformation) -> Result<StepTable> {
        let long = self.session.filter(|_| strokes_file::is_needed(&from.strokes));
        let strokes = long.map(|session| strokes_file::write(session, &from.strokes)).transpose()?;
        if let Some(strokes) = &strokes {
            text(&strokes.file)?;
            self.files.push(self.folder.join(&strokes.file));
        }
        let params = from.params.iter().map(|(id, value)| (placeless(id.clone()), value.clone()));
        let handle =
            |from: &HandleMove| Ok(HandleTable { id: from.id.clone(), r#move: placeless(from.motion) });
        Ok(StepTable {
            deform: Some(from.deform.clone()),
            plugin: from.plugin.clone(),
            state_version: from.state_version,
            params: params.collect(),
            amount: Some(from.amount).filter(|amount| *amount != 1.0).map(placeless),
            region: spanned(&from.regions, |region| self.region(region))?,
            joint: spanned(&from.joints, |joint| Ok(joint.clone()))?,
            handle: spanned(&from.handles, handle)?,
            stroke: if strokes.is_some() { Vec::new() } else { spanned(&from.strokes, |s| Ok(s.clone()))? },
            strokes: strokes.map(placeless),
            ..StepTable::default()
        })
    }

    fn region(&mut self, from: &Region) -> Result<RegionTable> {
        Ok(RegionTable {
            role: from.role,
            shapes: self.shapes(&from.shapes.shapes)?,
            falloff: Some(from.shapes.falloff).filter(|falloff| *falloff != 0.0).map(placeless),
            r#move: Some(from.motion).filter(|motion| *motion != Motion::default()).map(placeless),
        })
    }

    /// Selections that are too long for one line are written beside the session, if that may be.
    fn shapes(&mut self, from: &[RegionShape]) -> Result<Vec<Spanned<RegionShape>>> {
        spanned(from, |shape| {
            let in_file = match (shape, self.session) {
                (RegionShape::Selection(picked), Some(session)) => picked.stored(session)?,
                _ => None,
            };
            let Some(file) = in_file else { return Ok(shape.clone()) };
            self.files.push(self.folder.join(&file.file));
            Ok(RegionShape::Selection(PickedPoints::in_file(file)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::Shapes;
    use crate::step::{Joint, Origin, Role, Stroke};
    use glam::DVec3;
    use simod_core::sampling::{By, Placement};
    use simod_model::follow::TensorKind;
    use std::sync::Arc;

    fn stroke(points: usize) -> Arc<Stroke> {
        let points: Vec<DVec3> = (0..points).map(|i| DVec3::new(i as f64 / 3.0, 1e-30, -2e6)).collect();
        let pressures = points.iter().enumerate().map(|(i, _)| i as f32 / points.len() as f32).collect();
        let params = "brush = \"smooth\"\nfalloff = [[0.0, 1.0], [1.0, 0.0]]".parse().unwrap();
        Arc::new(Stroke { radius: 0.1, strength: -1.0, points, pressures, params })
    }

    fn session(folder: &Path) -> SessionFile {
        let shapes = vec![
            RegionShape::HalfSpace { point: DVec3::ZERO, normal: DVec3::NEG_Y },
            RegionShape::Sphere { center: DVec3::new(0.1, 300.0, 0.0), radius: 1.0 / 3.0 },
            RegionShape::Box { min: DVec3::ZERO, max: DVec3::ONE },
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
            long.regions[0].shapes.shapes.push(RegionShape::Selection(picked));
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
            follow: [("n1".to_owned(), TensorKind::Normal), ("t".to_owned(), TensorKind::Vector)].into(),
            fingerprint: Some("xxh3-128:0".to_owned()),
            sampling: SamplingTable {
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
        // The session that was read is written as it was.
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
        let text = session.to_toml(&folder.join("edit.toml")).unwrap();
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
        let empty = SessionFile::default().to_toml(Path::new("edit.toml")).unwrap();
        assert_eq!(empty, "version = 1\n");
    }

    #[test]
    fn what_former_programs_understand_stays_of_the_first_version() {
        let version = |step: Step| {
            let session = SessionFile { steps: vec![step], ..SessionFile::default() };
            session.to_toml(Path::new("edit.toml")).unwrap().lines().next().unwrap().to_owned()
        };
        let deform =
            |amount| Step::new(Action::Deform(Deformation { amount, ..Deformation::by_plugin("warp") }));
        assert_eq!(version(deform(1.0)), "version = 1");
        assert_eq!(version(deform(0.0)), "version = 2");
        assert_eq!(version(Step { title: Some("a".to_owned()), ..deform(1.0) }), "version = 2");
        assert_eq!(version(Step { group: Some("a".to_owned()), ..deform(1.0) }), "version = 2");
    }
}
