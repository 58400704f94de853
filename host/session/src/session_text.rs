//! Sessions as they are read: the tables of a file become a [`SessionFile`], or an error that says where it
//! is wrong.

use crate::session_file::{SamplingTable, SessionFile, SessionTime, VERSION, read_text};
pub use crate::session_tables::RegionTable;
use crate::session_tables::{HandleTable, ModelTable, RefineTable, SessionTable, StepTable, TileNames};
use crate::shapes::{RegionShape, Shapes};
use crate::step::{
    self, Action, Defect, Deformation, FINER, HandleMove, Joint, ParamPlaces, Refine, Region, RegionPart,
    Role, Step, Stroke,
};
use crate::strokes_file;
use simod_core::refinement::Finer;
use simod_core::tables::{self, Spanned};
use simod_model::{Error, Result, input, object};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

impl SessionFile {
    /// Reads a session; its paths are relative to the file's folder.
    pub fn load(path: &Path) -> Result<Self> {
        let text = read_text(path, "session", "give a session file (session.toml), not a model")?;
        Self::parse(&text, path)
    }

    /// Reads a session from its text; `path` is the file that the text came from.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let source = SessionText { text, path };
        let table: SessionTable = tables::read(text).map_err(|e| source.refused(&e))?;
        source.check_version(&table)?;
        let folder = source.folder();
        let (model, tiles, columns, fingerprint) = match table.model {
            Some(model) => source.model(model)?,
            None => Default::default(),
        };
        Ok(Self {
            model,
            tiles,
            columns,
            fingerprint,
            follow: table.follow.map(Spanned::into_inner).unwrap_or_default(),
            sampling: table
                .sampling
                .map_or(Ok(SamplingTable::default()), |sampling| source.sampling(sampling))?,
            time: table.time.map_or(Ok(SessionTime::default()), |time| source.time(&time))?,
            steps: table.step.into_iter().map(|s| source.step(s)).collect::<Result<_>>()?,
            output: table.output.as_ref().map(|output| named_from(folder, &output.path)),
            named_output: table.output.map(|output| output.path),
        })
    }
}

/// Path that a session in a folder names. Secrets in the URL of an object are not remembered in the path.
fn named_from(folder: &Path, path: &Path) -> PathBuf {
    input::seen_from(folder, Path::new(&object::admit(path)))
}

/// The file, for errors that say where.
pub struct SessionText<'a> {
    /// Text of the whole file.
    pub text: &'a str,
    /// Path of the file, to whose folder other paths in it are relative.
    pub path: &'a Path,
}

impl SessionText<'_> {
    /// The file's name and the line, counted from 1.
    pub fn place(&self, span: &Range<usize>) -> String {
        let before = self.text.as_bytes().get(..span.start).unwrap_or_default();
        let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
        format!("{}, line {line}", self.path.display())
    }

    /// An error of format, `what`, at a place in the file.
    pub fn error(&self, span: &Range<usize>, what: &str, hint: impl Into<String>) -> Error {
        Error::format(format!("{}: {what}", self.place(span)), hint)
    }

    /// Error about a file or value that is named at a place.
    fn locate(&self, span: &Range<usize>, e: Error) -> Error {
        let what = format!("{}: {e}", self.place(span));
        e.saying(what)
    }

    /// Folder to which paths in the file are relative.
    fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Error of the parser on one line, with the number of the file's line.
    pub fn refused(&self, error: &tables::TableError) -> Error {
        let message = error.message().lines().collect::<Vec<_>>().join("; ");
        let Some(span) = error.span() else {
            let what = format!("{}: {message}", self.path.display());
            return Error::format(what, "compare it with the examples");
        };
        let start = self.text[..span.start.min(self.text.len())].rfind('\n').map_or(0, |i| i + 1);
        let line = self.text[start..].lines().next().unwrap_or_default().trim();
        let line: String = line.chars().take(80).collect();
        self.error(&span, &message, format!("the line reads: {line}"))
    }

    /// The table `[sampling]`, checked.
    ///
    /// # Errors
    /// Both a number of samples and an error are given, or a value is out of range: with the line.
    pub fn sampling(&self, sampling: Spanned<SamplingTable>) -> Result<SamplingTable> {
        let span = sampling.span();
        let sampling = sampling.into_inner();
        let wrong = |what, hint: &str| Err(self.error(&span, what, hint));
        if sampling.samples.is_some() && sampling.error.is_some() {
            return wrong("both `samples` and `error` are given", "keep one of the two");
        }
        if sampling.samples == Some(0) {
            return wrong("`samples` is 0", "give a number such as 50000");
        }
        if sampling.error.is_some_and(|e| !(e > 0.0 && e.is_finite())) {
            return wrong("`error` is not positive", "give a fraction of the diagonal, such as 2e-4");
        }
        if sampling.grid == Some(0) {
            return wrong("`grid` is 0", "leave it out, or give a number such as 128");
        }
        Ok(sampling)
    }

    fn time(&self, time: &Spanned<SessionTime>) -> Result<SessionTime> {
        match time.get_ref().defect() {
            Some(what) => Err(self.error(
                &time.span(),
                what,
                "give a frame, such as 12, and perhaps a rate, such as 24",
            )),
            None => Ok(*time.get_ref()),
        }
    }

    /// A session of a version that this program knows says nothing that only a later one may.
    fn check_version(&self, table: &SessionTable) -> Result<()> {
        let Some(version) = &table.version else { return Ok(()) };
        let (span, version) = (version.span(), *version.get_ref());
        if !(1..=VERSION).contains(&version) {
            let what = format!("the session is of version {version}, this program knows {VERSION}");
            return Err(self.error(&span, &what, "open it with a newer version of SIMOD"));
        }
        if let Some((key, span)) = table.of_version_2().filter(|_| version < VERSION) {
            let hint = "write `version = 2` at its beginning: programs that do not know it refuse it then";
            return Err(self.error(&span, &format!("{key} of sessions of version 2"), hint));
        }
        Ok(())
    }

    /// The model's file, or the files and patterns of its tiles; its columns and its fingerprint.
    fn model(&self, table: Spanned<ModelTable>) -> Result<NamedModel> {
        let (span, ModelTable { path, tiles, columns, fingerprint }) = (table.span(), table.into_inner());
        let path = path.filter(|path| !path.as_os_str().is_empty());
        let model = path.map(|path| named_from(self.folder(), &path));
        let hint = "name a file in `path`, or files in `tiles`";
        let Some(named) = tiles else {
            return match model {
                Some(_) => Ok((model, Vec::new(), columns, fingerprint)),
                None => Err(self.error(&span, "the model has no `path`", hint)),
            };
        };
        let span = named.span();
        let names = match named.into_inner() {
            TileNames::One(name) => vec![name],
            TileNames::Several(names) => names,
        };
        if names.is_empty() {
            return Err(self.error(&span, "there are no `tiles`", hint));
        }
        if model.is_some() {
            return Err(self.error(&span, "both `path` and `tiles` are given", hint));
        }
        let tiles = names.iter().map(|name| named_from(self.folder(), name)).collect();
        Ok((None, tiles, columns, fingerprint))
    }

    /// Error of a defect, with its line.
    fn defect(&self, span: &Range<usize>, defect: &Defect) -> Error {
        self.error(span, &defect.what, defect.hint)
    }

    fn step(&self, step: Spanned<StepTable>) -> Result<Step> {
        let (span, mut table) = (step.span(), step.into_inner());
        let (enabled, place) = (table.enabled.unwrap_or(true), self.place(&span));
        let title = self.name("title", table.title.take())?;
        let group = self.name("group", table.group.take())?;
        let action = match table.refine.take() {
            Some(_) if table.deforms() => {
                let hint = "give each a [[step]] of its own";
                return Err(self.error(&span, "a step that refines does nothing else", hint));
            }
            Some(refine) => Action::Refine(self.refine(refine)?),
            None => Action::Deform(self.deformation(&span, table)?),
        };
        Ok(Step { action, enabled, title, group, place })
    }

    /// Checks the name that the user gave a step, or a group.
    fn name(&self, key: &str, name: Option<Spanned<String>>) -> Result<Option<String>> {
        if let Some(name) = &name {
            step::check_name(key, name.get_ref()).map_err(|defect| self.defect(&name.span(), &defect))?;
        }
        Ok(name.map(Spanned::into_inner))
    }

    fn refine(&self, table: Spanned<RefineTable>) -> Result<Refine> {
        let span = table.span();
        let RefineTable { shapes, auto, error, factor, samples } = table.into_inner();
        let auto = auto.unwrap_or(false);
        let shapes = match shapes {
            Some(shapes) if shapes.is_empty() => {
                return Err(self.error(&span, "the refinement has no shape", "give one, such as a sphere"));
            }
            Some(shapes) => self.shapes(shapes)?,
            None if auto => Shapes::default(),
            None => {
                let hint = "give `shapes`, such as a sphere, or `auto = true`";
                return Err(self.error(&span, "the refinement has no `shapes`", hint));
            }
        };
        let finer = match (error, factor, samples) {
            (error, None, samples) if auto => Finer::Auto { error: error.unwrap_or(Finer::ALLOWED), samples },
            _ if auto => {
                let hint = "give `error` (a fraction of the diagonal) or `samples` with `auto`, or both";
                return Err(self.error(&span, "`factor` says nothing of what is needed", hint));
            }
            (Some(e), None, None) => Finer::Error(e),
            (None, Some(f), None) => Finer::Factor(f),
            (None, None, Some(n)) => Finer::Samples(n),
            _ => return Err(self.error(&span, "give one of `error`, `factor` and `samples`", FINER)),
        };
        let refine = Refine { shapes, finer };
        refine.check().map_err(|defect| self.defect(&span, &defect))?;
        Ok(refine)
    }

    /// Shapes that are checked, with the points of selections.
    fn shapes(&self, tables: Vec<Spanned<RegionShape>>) -> Result<Shapes> {
        let mut shapes = Shapes::default();
        for shape in tables {
            let (span, mut shape) = (shape.span(), shape.into_inner());
            if let RegionShape::Selection(picked) = shape {
                shape =
                    RegionShape::Selection(picked.loaded(self.folder()).map_err(|e| self.locate(&span, e))?);
            }
            if let Some(what) = shape.defect() {
                return Err(self.error(&span, what, "correct the shape"));
            }
            shapes.shapes.push(shape);
        }
        Ok(shapes)
    }

    fn deformation(&self, span: &Range<usize>, table: StepTable) -> Result<Deformation> {
        let deform = table.deform.ok_or_else(|| {
            self.error(span, "the step has no `deform`", "name a plugin, such as deform = \"warp\"")
        })?;
        let folder = self.folder();
        let mut strokes = match table.strokes {
            Some(file) => {
                strokes_file::read(file.get_ref(), folder).map_err(|e| self.locate(&file.span(), e))?
            }
            None => Vec::new(),
        };
        for stroke in table.stroke {
            strokes.push(self.stroke(stroke)?);
        }
        if let Some(amount) = &table.amount {
            step::check_amount(*amount.get_ref()).map_err(|defect| self.defect(&amount.span(), &defect))?;
        }
        let places = table.params.keys().map(|id| (id.get_ref().clone(), self.place(&id.span())));
        Ok(Deformation {
            plugin: table.plugin,
            state_version: table.state_version,
            param_places: ParamPlaces::new(places),
            params: table.params.into_iter().map(|(id, value)| (id.into_inner(), value)).collect(),
            regions: table.region.into_iter().map(|r| self.region(r)).collect::<Result<_>>()?,
            joints: self.joints(table.joint)?,
            handles: self.handles(table.handle)?,
            strokes,
            amount: table.amount.map_or(1.0, Spanned::into_inner),
            folder: folder.to_owned(),
            ..Deformation::by_plugin(&deform)
        })
    }

    /// Joints, each after the one that it hangs on.
    fn joints(&self, tables: Vec<Spanned<Joint>>) -> Result<Vec<Joint>> {
        let (spans, joints): (Vec<_>, Vec<_>) =
            tables.into_iter().map(|joint| (joint.span(), joint.into_inner())).unzip();
        let order = step::joint_order(&joints);
        let joints: Vec<Joint> = order.iter().map(|joint| joints[*joint].clone()).collect();
        match step::check_joints(&joints) {
            Ok(()) => Ok(joints),
            Err((number, defect)) => Err(self.defect(&spans[order[number]], &defect)),
        }
    }

    fn handles(&self, tables: Vec<Spanned<HandleTable>>) -> Result<Vec<HandleMove>> {
        let (mut spans, mut handles) = (Vec::new(), Vec::new());
        for table in tables {
            let (span, HandleTable { id, r#move }) = (table.span(), table.into_inner());
            spans.push((span, r#move.span()));
            handles.push(HandleMove { id, motion: r#move.into_inner() });
        }
        step::check_handles(&handles).map_err(|(number, defect)| {
            let (whole, motion) = &spans[number];
            self.defect(if defect.part == RegionPart::Move { motion } else { whole }, &defect)
        })?;
        Ok(handles)
    }

    fn stroke(&self, stroke: Spanned<Arc<Stroke>>) -> Result<Arc<Stroke>> {
        match stroke.get_ref().defect() {
            Some((what, hint)) => Err(self.error(&stroke.span(), what, hint)),
            None => Ok(stroke.into_inner()),
        }
    }

    /// A region, checked.
    ///
    /// # Errors
    /// The region has no shapes, or a shape, its falloff or its motion makes no sense: with the line.
    pub fn region(&self, table: Spanned<RegionTable>) -> Result<Region> {
        let (whole, RegionTable { role, shapes, falloff, r#move }) = (table.span(), table.into_inner());
        let spanned = |part: &Option<Range<usize>>| part.clone().unwrap_or_else(|| whole.clone());
        let (falloff_span, move_span) =
            (falloff.as_ref().map(Spanned::span), r#move.as_ref().map(Spanned::span));
        let refused = |defect: Defect| {
            let span = match defect.part {
                RegionPart::Whole => whole.clone(),
                RegionPart::Falloff => spanned(&falloff_span),
                RegionPart::Move => spanned(&move_span),
            };
            self.defect(&span, &defect)
        };
        // Even one that moves nothing is a mistake.
        if r#move.is_some() && role != Role::Handle {
            return Err(refused(Region::moves()));
        }
        let falloff = falloff.map_or(0.0, Spanned::into_inner);
        let shapes = Shapes { falloff, ..self.shapes(shapes)? };
        let region = Region { role, shapes, motion: r#move.map(Spanned::into_inner).unwrap_or_default() };
        region.check().map_err(refused)?;
        Ok(region)
    }
}

/// The file of a session's model, or those of its tiles; its columns and its fingerprint.
type NamedModel = (Option<PathBuf>, Vec<PathBuf>, Option<String>, Option<String>);

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn parse(text: &str) -> Result<SessionFile> {
        SessionFile::parse(text, Path::new("edits/session.toml"))
    }

    const GOOD: &str = r#"
[model]
path = "nefertiti.ply"
[sampling]
samples = 50000
[[step]]
deform = "rbf"
params = { kernel = "triharmonic" }
[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0, 0], normal = [0, -1, 0] } }]
[[step.region]]
role = "handle"
shapes = [{ sphere = { center = [0, 300, 0], radius = 40 } }, { box = { min = [0,0,0], max = [1,1,1] } }]
falloff = 2
move = { translate = [10, 0, 0], axis = [0, 1, 0], degrees = 30, pivot = [0, 300, 0], scale = 1 }
[[step]]
deform = "warp"
[output]
path = "/elsewhere/out.ply"
"#;

    #[test]
    fn reads_a_session() {
        let session = parse(GOOD).unwrap();
        assert_eq!(session.model.unwrap(), Path::new("edits/nefertiti.ply"));
        assert_eq!(session.output.unwrap(), Path::new("/elsewhere/out.ply"));
        assert_eq!(session.sampling.samples, Some(50_000));
        let [rbf, warp] = session.steps.as_slice() else { panic!() };
        assert_eq!(rbf.place, "edits/session.toml, line 6");
        let [rbf, warp] = [rbf, warp].map(|step| step.deformation().unwrap());
        assert_eq!((rbf.deform.as_str(), rbf.regions.len()), ("rbf", 2));
        assert_eq!(
            rbf.regions[1].shapes.shapes[0],
            RegionShape::Sphere { center: DVec3::Y * 300.0, radius: 40.0 }
        );
        assert_eq!(rbf.regions[1].shapes.falloff, 2.0);
        assert_eq!(rbf.regions[1].motion.degrees, 30.0);
        assert!(warp.params.is_empty());
        assert_eq!(parse("").unwrap().steps, []);
    }

    #[test]
    fn says_where_and_what() {
        let told = |text: &str, line: u32, what: &str| {
            let error = parse(text).unwrap_err();
            let message = error.to_string();
            assert!(message.starts_with(&format!("edits/session.toml, line {line}: ")), "{message}");
            assert!(message.contains(what), "{message}");
            assert!(!message.contains('\n') && !error.hint().contains('\n') && !error.hint().is_empty());
        };
        told("[model]\nfile = 1", 2, "`file`");
        told("[model]\npath = \"\"", 1, "no `path`");
        told("model = \"x.ply\"", 1, "the text \"x.ply\" stands where a table is wanted");
        told("[sampling]\nsamples = \"x\"", 2, "the text \"x\"");
        told("[sampling]\nsamples = 1\nerror = 1e-3", 1, "both");
        told("[model\n", 1, "");
        told("[time]\nrate = 0", 1, "`rate` is no number");
        told("[time]\nseconds = nan", 1, "`seconds` is no finite number");
        let region = "[[step]]\ndeform = \"rbf\"\n[[step.region]]\n";
        told(&format!("{region}role = \"free\"\nshapes = []"), 4, "free");
        told(&format!("{region}role = \"fixed\"\nshapes = []"), 3, "no shape");
        let ball = "shapes = [{ sphere = { center = [0,0,0], radius = 1 } }]\n";
        told(&format!("{region}role = \"fixed\"\n{ball}move = {{}}"), 6, "`move`");
        told(&format!("{region}role = \"handle\"\n{ball}move = {{ scale = 0 }}"), 6, "scale");
        told(&format!("{region}role = \"mask\"\n{ball}falloff = -1"), 6, "falloff");
        told(&format!("{region}role = \"mask\"\nshapes = [{{ cone = {{}} }}]"), 5, "cone");
        let extra = "shapes = [{ sphere = { center = [0,0,0], radius = 1, size = 2 } }]";
        told(&format!("{region}role = \"mask\"\n{extra}"), 5, "size");
        told(
            &format!(
                "{region}role = \"mask\"\n{}",
                extra.replace("[0,0,0]", "[0,0]").replace(", size = 2", "")
            ),
            5,
            "found 2",
        );
        told(
            &format!(
                "{region}role = \"mask\"\n{}",
                extra.replace("0,0]", "0,0,7]").replace(", size = 2", "")
            ),
            5,
            "",
        );
        told("[[step]]\nparams = {}", 1, "no `deform`");
        let refine = |text: &str| format!("[[step]]\nrefine = {{ {text} }}");
        let shapes = "shapes = [{ sphere = { center = [0,0,0], radius = 1 } }]";
        told(&refine("error = 1"), 2, "`shapes`");
        told(&refine("shapes = [], error = 1"), 2, "no shape");
        told(&refine(shapes), 2, "give one of `error`");
        told(&refine(&format!("{shapes}, error = 1, factor = 2")), 2, "give one of `error`");
        for bad in ["error = -1", "error = nan", "factor = 1", "samples = 0"] {
            told(&refine(&format!("{shapes}, {bad}")), 2, "no fineness that makes sense");
        }
        told(&refine(&format!("{}, error = 1", shapes.replace("= 1", "= 0"))), 2, "radius");
        told(&refine(&format!("{shapes}, size = 1")), 2, "size");
        for bad in ["error = 0", "error = nan", "samples = 0"] {
            told(&refine(&format!("auto = true, {bad}")), 2, "no fineness that makes sense");
        }
        told(&refine("auto = true, factor = 2"), 2, "`factor` says nothing");
        told(&refine("auto = true, shapes = []"), 2, "no shape");
        told(&refine("auto = false, error = 1"), 2, "`shapes`");
        told(&format!("[[step]]\ndeform = \"x\"\nrefine = {{ {shapes}, error = 1 }}"), 1, "nothing else");
        let step = "[[step]]\ndeform = \"x\"\n";
        told(&format!("{step}[[step.handle]]\nid = \"0\""), 3, "`move`");
        told(&format!("{step}[[step.handle]]\nid = \"a b\"\nmove = {{}}"), 3, "white space");
        told(&format!("{step}[[step.handle]]\nid = \"a\"\nmove = {{ scale = -1 }}"), 5, "scale");
        told(&format!("{step}[[step.stroke]]\nradius = 0\npoints = [[0,0,0]]"), 3, "radius");
        told(&format!("{step}[[step.stroke]]\nradius = 1\npoints = []"), 3, "no point");
        told(&format!("{step}[[step.stroke]]\nradius = 1\npoints = [[0,0]]"), 5, "found 2");
        told(&format!("{step}[[step.stroke]]\nradius = 1\npoints = [[0,0,0]]\npressures = [2]"), 3, "0 to 1");
        for bad in ["-0.1", "1.5", "nan"] {
            told(&format!("{step}amount = {bad}"), 3, "not from 0 to 1");
        }
        told(&format!("version = 1\n{step}amount = 0.5"), 4, "`amount` is of sessions of version 2");
        told(&format!("version = 1\n{step}title = \"a\""), 4, "`title` is of sessions of version 2");
        told(&format!("version = 1\n{step}group = \"a\""), 4, "`group` is of sessions of version 2");
        told(&format!("{step}group = \"\""), 3, "a `group` is empty");
        told(&format!("{step}title = \" \""), 3, "a `title` is empty");
        told(&format!("{step}title = \"a\\nb\""), 3, "none to be read");
        told(&format!("{step}title = \"{}\"", "ab".repeat(101)), 3, "longer");
        told(&format!("{}\namount = 0.5", refine(&format!("{shapes}, error = 1"))), 1, "nothing else");
        let joint = |id: &str, parent: &str| {
            format!("[[step.joint]]\nid = \"{id}\"\nat = [0,0,0]\nparent = \"{parent}\"\n")
        };
        told(&format!("{step}{}{}", joint("a", "b"), joint("b", "a")), 3, "hangs on `b`");
        let twice = "[[step.joint]]\nid = \"a\"\nat = [0,0,0]\n";
        told(&format!("{step}{twice}{twice}"), 6, "twice");
    }

    #[test]
    fn refinements_stand_between_deformations() {
        let refine = |e: f64| {
            format!(
                "[[step]]\nrefine = {{ shapes = [{{ sphere = {{ center = [0,0,0], radius = 1 }} }}], error = {e} }}\n"
            )
        };
        let deform = "[[step]]\ndeform = \"warp\"\n";
        let session = parse(&[&refine(0.0), deform, deform, &refine(0.5), &refine(0.25)].concat()).unwrap();
        let finer = |s: &Step| match &s.action {
            Action::Refine(refine) => Some(refine.finer),
            Action::Deform(_) => None,
        };
        let order: Vec<_> = session.steps.iter().map(finer).collect();
        let error = |e| Some(Finer::Error(e));
        assert_eq!(order, [error(0.0), None, None, error(0.5), error(0.25)]);
        assert!(session.steps[3].place.ends_with("line 7"));
    }

    #[test]
    fn joints_come_after_those_that_they_hang_on() {
        let joint = |id: &str, rest: &str| format!("[[step.joint]]\nid = \"{id}\"\nat = [1,2,3]\n{rest}\n");
        let text =
            ["[[step]]\ndeform = \"x\"\n", &joint("hand", "parent = \"arm\""), &joint("arm", "")].concat();
        let session = parse(&text).unwrap();
        let ids: Vec<&str> =
            session.steps[0].deformation().unwrap().joints.iter().map(|j| j.id.as_str()).collect();
        assert_eq!(ids, ["arm", "hand"]);
    }
}
