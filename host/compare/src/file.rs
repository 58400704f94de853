//! `compare.toml`: a model, regions, and the methods to be compared on them.

use crate::html::hyphenated;
use glam::DVec3;
use serde::Deserialize;
use simod_core::reconstruction::Method as Reconstruction;
use simod_core::tables::{self, Spanned};
use simod_model::{Error, Result};
use simod_picture::picture::UpAxis;
use simod_session::session_file::{SamplingTable, read_text};
use simod_session::session_text::{RegionTable, SessionText};
use simod_session::step::Region;
use std::path::{Path, PathBuf};

/// Most methods of a comparison: all their models are read at once, and all pairs of them are compared.
pub const MAX_METHODS: usize = 32;

/// Longest side of a picture in pixels, as in `simod render`: 4 times as many samples are held, of 64 bytes
/// each, which is 1 GB for 2000 by 2000.
const MAX_SIDE: u32 = 3840;

/// Most runs of each method.
const MAX_RUNS: usize = 100;

/// Most parts of the pictures that are shown larger.
const MAX_CROPS: usize = 16;

/// A comparison that is to be made. Paths are as the program needs them: relative to the current folder, or
/// absolute.
#[derive(Debug, Clone, PartialEq)]
pub struct CompareFile {
    /// The file's text.
    pub text: String,
    /// The huge model.
    pub model: PathBuf,
    /// Names of the model's columns, if the model is a text in columns that does not name them.
    pub columns: Option<String>,
    /// Fingerprint of the model, if the file gives it.
    pub fingerprint: Option<String>,
    /// Regions for all methods that are one plugin, as far as the plugin takes them.
    pub regions: Vec<Region>,
    /// Camera and size of the pictures.
    pub camera: CameraPlace,
    /// Parts of the pictures that are shown larger.
    pub crops: Vec<CropPlace>,
    /// Number of runs of each method: its times are the medians.
    pub runs: usize,
    /// Methods, at least one, with different names.
    pub methods: Vec<ComparedMethod>,
}

/// Camera and size of pictures, as in `simod render`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields, default)]
pub struct CameraPlace {
    /// Turn to the right about the vertical axis, in degrees.
    pub yaw: f64,
    /// Angle by which the camera looks down, in degrees.
    pub pitch: f64,
    /// The model's axis that points up.
    pub up: UpAxis,
    /// Width and height of a picture in pixels.
    pub size: [u32; 2],
}

impl Default for CameraPlace {
    fn default() -> Self {
        Self { yaw: 25.0, pitch: 12.0, up: UpAxis::Y, size: [640, 640] }
    }
}

/// A part of the pictures that is shown larger.
#[derive(Debug, Clone, PartialEq)]
pub struct CropPlace {
    /// Name that the user gives to the part.
    pub name: String,
    /// Ending of the pictures' names; unique.
    pub file: String,
    /// Point of the model in the middle of the part.
    pub target: DVec3,
    /// The part's width over that of the whole.
    pub part: f64,
}

/// One of the methods that are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparedMethod {
    /// Name that the user gives to the method; unique.
    pub name: String,
    /// Place of the method in the file, as `compare.toml, line 7`; for errors.
    pub place: String,
    /// The work of the method.
    pub work: MethodWork,
    /// Sampling of the model.
    pub sampling: SamplingTable,
    /// Reconstruction of the deformation on the model.
    pub reconstruction: Reconstruction,
}

/// Work of a method on the samples.
#[derive(Debug, Clone, PartialEq)]
pub enum MethodWork {
    /// One plugin, on the shared regions.
    Plugin {
        /// The plugin's id.
        deform: String,
        /// Version of the parameters' meaning; the first where nothing is said.
        state_version: Option<u32>,
        /// The parameters that differ from their defaults.
        params: toml::Table,
        /// Folder to which paths among the parameters are relative.
        folder: PathBuf,
    },
    /// The steps of a session, with the regions that they have there.
    Session(PathBuf),
    /// No work: the samples' new positions are in a file.
    Deformed(PathBuf),
    /// No work: the deformed model is there.
    Model(PathBuf),
    /// A program of the user's.
    Command(ProgramMethod),
}

/// A program that deforms the samples, or the model itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProgramMethod {
    /// Command line in the file.
    pub line: String,
    /// The program and its arguments, in which names in braces stand for files.
    pub words: Vec<String>,
    /// Files that the command asks for.
    pub given: Vec<ProgramFile>,
    /// Folder in which the program runs.
    pub folder: PathBuf,
}

impl ProgramMethod {
    /// Whether the program makes a deformed model, and not deformed samples.
    pub fn makes_model(&self) -> bool {
        self.given.contains(&ProgramFile::Model)
    }
}

/// A file that a program asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgramFile {
    /// The samples at rest: `{samples}`.
    Samples,
    /// Targets of the samples in regions: `{constraints}`.
    Constraints,
    /// The model: `{model}`.
    Model,
    /// Output that the program writes: `{output}`.
    Output,
}

impl ProgramFile {
    const ALL: [(&'static str, Self); 4] = [
        ("samples", Self::Samples),
        ("constraints", Self::Constraints),
        ("model", Self::Model),
        ("output", Self::Output),
    ];
}

// Tables of the file, as they are read.

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCompare {
    model: Option<RawModel>,
    sampling: Option<Spanned<SamplingTable>>,
    #[serde(default)]
    region: Vec<Spanned<RegionTable>>,
    camera: Option<Spanned<CameraPlace>>,
    #[serde(default)]
    crop: Vec<Spanned<RawCrop>>,
    runs: Option<Spanned<usize>>,
    #[serde(default)]
    method: Vec<Spanned<RawMethod>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawModel {
    path: PathBuf,
    columns: Option<String>,
    fingerprint: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCrop {
    name: String,
    #[serde(deserialize_with = "simod_session::vector::three")]
    target: DVec3,
    part: f64,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct RawMethod {
    name: String,
    deform: Option<String>,
    state_version: Option<u32>,
    #[serde(default)]
    params: toml::Table,
    session: Option<PathBuf>,
    deformed: Option<PathBuf>,
    model: Option<PathBuf>,
    command: Option<String>,
    sampling: Option<Spanned<SamplingTable>>,
    reconstruction: Option<RawReconstruction>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "kebab-case")]
enum RawReconstruction {
    BlendedJets,
    ProjectedBarycentric,
}

impl From<RawReconstruction> for Reconstruction {
    fn from(raw: RawReconstruction) -> Self {
        match raw {
            RawReconstruction::BlendedJets => Self::BlendedJets,
            RawReconstruction::ProjectedBarycentric => Self::ProjectedBarycentric,
        }
    }
}

impl CompareFile {
    /// Reads a file; its paths are relative to its folder.
    ///
    /// # Errors
    /// The file cannot be read, or has a line that makes no sense, which the error names.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&read_text(path, "comparison", "give a file such as compare.toml")?, path)
    }

    /// Reads a comparison from its text; `path` is where it came from.
    ///
    /// # Errors
    /// As for [`load`](Self::load).
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let source = SessionText { text, path };
        let raw: RawCompare = tables::read(text).map_err(|e| source.refused(&e))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let missing = |what: &str, hint: &str| Error::format(format!("{}: {what}", path.display()), hint);
        let model = raw
            .model
            .ok_or_else(|| missing("there is no model", "add [model] path = \"…\", relative to this file"))?;
        let sampling = match raw.sampling {
            Some(sampling) => source.sampling(sampling)?,
            None => SamplingTable::default(),
        };
        let mut methods: Vec<ComparedMethod> = Vec::with_capacity(raw.method.len());
        for raw in raw.method {
            let method = method(&source, raw, sampling, &methods)?;
            methods.push(method);
        }
        if methods.is_empty() {
            return Err(missing(
                "there is no method",
                "add a [[method]] with a name and `deform` or `session`",
            ));
        }
        let mut crops: Vec<CropPlace> = Vec::with_capacity(raw.crop.len());
        for raw in raw.crop {
            let crop = crop(&source, raw, &crops)?;
            crops.push(crop);
        }
        let runs = match raw.runs {
            Some(runs) if !(1..=MAX_RUNS).contains(runs.get_ref()) => {
                let hint = format!("give from 1 to {MAX_RUNS}");
                return Err(source.error(&runs.span(), "`runs` is no number of runs", hint));
            }
            runs => runs.map_or(1, Spanned::into_inner),
        };
        Ok(Self {
            text: text.to_owned(),
            model: folder.join(model.path),
            columns: model.columns,
            fingerprint: model.fingerprint,
            regions: raw.region.into_iter().map(|r| source.region(r)).collect::<Result<_>>()?,
            camera: raw.camera.map_or(Ok(CameraPlace::default()), |c| camera(&source, c))?,
            crops,
            runs,
            methods,
        })
    }

    /// The methods that are programs of the user's.
    pub fn commands(&self) -> impl Iterator<Item = (&ComparedMethod, &ProgramMethod)> {
        self.methods.iter().filter_map(|method| match &method.work {
            MethodWork::Command(command) => Some((method, command)),
            _ => None,
        })
    }
}

fn camera(source: &SessionText<'_>, raw: Spanned<CameraPlace>) -> Result<CameraPlace> {
    let CameraPlace { yaw, pitch, size, .. } = *raw.get_ref();
    if !(yaw.is_finite() && pitch.is_finite()) {
        let what = "`yaw` or `pitch` is no finite number";
        return Err(source.error(&raw.span(), what, "give degrees, such as yaw = 25, pitch = 12"));
    }
    if size.iter().any(|side| !(16..=MAX_SIDE).contains(side)) {
        let hint = format!("give [width, height], each from 16 to {MAX_SIDE}");
        return Err(source.error(&raw.span(), "`size` is no size of a picture", hint));
    }
    Ok(raw.into_inner())
}

/// Checks a part of the pictures; `before` are the parts above it.
fn crop(source: &SessionText<'_>, raw: Spanned<RawCrop>, before: &[CropPlace]) -> Result<CropPlace> {
    let (span, raw) = (raw.span(), raw.into_inner());
    let wrong = |what: &str, hint: &str| Err(source.error(&span, what, hint));
    let file = hyphenated(&raw.name);
    if file.is_empty() {
        return wrong(
            "the name of a crop has no letter of the alphabet and no digit",
            "call it \"head\", say",
        );
    }
    if before.iter().any(|other| other.file == file) {
        return wrong(&format!("there are two crops `{}`", raw.name), "give one of both another name");
    }
    if before.len() == MAX_CROPS {
        return wrong(&format!("there are more than {MAX_CROPS} crops"), "leave some out");
    }
    if !raw.target.is_finite() {
        return wrong("`target` is no point", "give a point of the model, such as target = [0, 1.5, 0]");
    }
    if !(1e-3..=1.0).contains(&raw.part) {
        return wrong("`part` is no part of a picture", "give from 0.001 to 1: 0.1 is ten times as large");
    }
    Ok(CropPlace { name: raw.name, file, target: raw.target, part: raw.part })
}

/// Checks a command.
fn command(line: &str, folder: &Path) -> std::result::Result<ProgramMethod, (String, String)> {
    let words = shlex::split(line).filter(|words| !words.is_empty());
    let words = words.ok_or_else(|| {
        let hint = "quote words that hold spaces, as in a shell: command = \"python 'my arap.py' {samples} {output}\"";
        (format!("`command` is no program with arguments: {line}"), hint.to_owned())
    })?;
    let asks = |name: &str| words.iter().any(|word| word.contains(&format!("{{{name}}}")));
    let given: Vec<ProgramFile> =
        ProgramFile::ALL.iter().filter(|(name, _)| asks(name)).map(|(_, given)| *given).collect();
    let has = |one: ProgramFile| given.contains(&one);
    let hint =
        "{samples} or {model} stands for what is to be deformed, and {output} for the file to be written"
            .to_owned();
    if !has(ProgramFile::Output) {
        return Err(("`command` has no {output}".to_owned(), hint));
    }
    if has(ProgramFile::Samples) == has(ProgramFile::Model) {
        let both = if has(ProgramFile::Samples) {
            "both {samples} and {model}"
        } else {
            "neither {samples} nor {model}"
        };
        return Err((format!("`command` has {both}"), hint));
    }
    Ok(ProgramMethod { line: line.to_owned(), words, given, folder: folder.to_owned() })
}

/// Checks a method; `before` are the methods above it.
fn method(
    source: &SessionText<'_>,
    raw: Spanned<RawMethod>,
    shared: SamplingTable,
    before: &[ComparedMethod],
) -> Result<ComparedMethod> {
    let (span, raw) = (raw.span(), raw.into_inner());
    let wrong = |what: &str, hint: &str| Err(source.error(&span, what, hint));
    let folder = source.path.parent().unwrap_or(Path::new(""));
    if raw.name.trim().is_empty() {
        return wrong("the name of a method is empty", "give it one, such as name = \"rbf\"");
    }
    if before.iter().any(|other| other.name == raw.name) {
        let what = format!("there are two methods `{}`", raw.name);
        return wrong(&what, "give one of both another name");
    }
    if before.len() == MAX_METHODS {
        let what = format!("there are more than {MAX_METHODS} methods");
        return wrong(&what, "make two comparisons of it, which share a method");
    }
    let (name, place) = (raw.name.clone(), source.place(&span));
    let (sampling, reconstruction) = (raw.sampling.clone(), raw.reconstruction);
    let work = work(raw, folder).map_err(|(what, hint)| source.error(&span, &what, hint))?;
    if reconstruction.is_some()
        && (matches!(&work, MethodWork::Model(_))
            || matches!(&work, MethodWork::Command(command) if command.makes_model()))
    {
        return wrong("a method that gives a deformed model has no `reconstruction`", "leave it out");
    }
    let sampling = sampling.map_or(Ok(shared), |sampling| source.sampling(sampling))?;
    let reconstruction = reconstruction.map(Reconstruction::from).unwrap_or_default();
    Ok(ComparedMethod { name, place, work, sampling, reconstruction })
}

/// Work of a method, of which the file names just one kind; or the defect and the advice.
fn work(raw: RawMethod, folder: &Path) -> std::result::Result<MethodWork, (String, String)> {
    let wrong = |what: &str, hint: &str| Err((what.to_owned(), hint.to_owned()));
    let what = [
        ("deform", raw.deform.is_some()),
        ("session", raw.session.is_some()),
        ("deformed", raw.deformed.is_some()),
        ("model", raw.model.is_some()),
        ("command", raw.command.is_some()),
    ];
    let given: Vec<&str> = what.into_iter().filter(|(_, given)| *given).map(|(key, _)| key).collect();
    match given[..] {
        [] => {
            return wrong(
                "a method has neither `deform` nor `session`, nor `deformed`, `model` or `command`",
                "name a plugin, such as deform = \"rbf\", a session, as session = \"bend.toml\", or what another \
                 program made",
            );
        }
        [_] => {}
        [one, other, ..] => {
            return wrong(&format!("a method has both `{one}` and `{other}`"), "keep one of the two");
        }
    }
    if raw.deform.is_none() && !(raw.params.is_empty() && raw.state_version.is_none()) {
        let (whose, hint) = match raw.session {
            Some(_) => ("a whole session", "change them in the session"),
            None => ("another program", "they are those of plugins: leave them out"),
        };
        return wrong(&format!("a method of {whose} has no `params`"), hint);
    }
    Ok(if let Some(deform) = raw.deform {
        let (state_version, params) = (raw.state_version, raw.params);
        MethodWork::Plugin { deform, state_version, params, folder: folder.to_owned() }
    } else if let Some(session) = raw.session {
        MethodWork::Session(folder.join(session))
    } else if let Some(deformed) = raw.deformed {
        MethodWork::Deformed(folder.join(deformed))
    } else if let Some(line) = raw.command {
        MethodWork::Command(command(&line, folder)?)
    } else {
        MethodWork::Model(folder.join(raw.model.unwrap_or_default()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_session::step::Role;

    fn parse(text: &str) -> Result<CompareFile> {
        CompareFile::parse(text, Path::new("edits/compare.toml"))
    }

    const GOOD: &str = include_str!("../tests/compare.toml");

    #[test]
    fn a_comparison_is_read() {
        let file = parse(GOOD).unwrap();
        assert_eq!((file.model.as_path(), file.text.as_str()), (Path::new("edits/cactus.ply"), GOOD));
        assert_eq!(file.regions.iter().map(|r| r.role).collect::<Vec<_>>(), [Role::Fixed, Role::Handle]);
        let camera = CameraPlace { yaw: 10.0, size: [400, 300], ..CameraPlace::default() };
        assert_eq!(file.camera, camera);
        let [arap, rbf, session] = &file.methods[..] else { panic!("three methods") };
        assert_eq!(arap.sampling.samples, Some(20_000));
        assert_eq!(arap.reconstruction, Reconstruction::BlendedJets);
        assert_eq!(arap.place, "edits/compare.toml, line 16");
        assert_eq!(rbf.sampling.samples, Some(5000));
        assert_eq!(rbf.reconstruction, Reconstruction::ProjectedBarycentric);
        assert_eq!(session.work, MethodWork::Session("edits/bend.toml".into()));
        assert_eq!((file.runs, file.crops.len()), (1, 0));
    }

    #[test]
    fn what_others_made_is_a_method() {
        let text = r#"
runs = 3
model = { path = "a.ply" }
[[crop]]
name = "The head"
target = [0, 1, 2]
part = 0.25
[[method]]
name = "a"
deformed = "a-deformed.ply"
[[method]]
name = "b"
model = "b.ply"
[[method]]
name = "c"
command = "python 'my arap.py' {samples} --to={output} --with {constraints}"
"#;
        let file = parse(text).unwrap();
        let [a, b, c] = &file.methods[..] else { panic!("three methods") };
        assert_eq!(a.work, MethodWork::Deformed("edits/a-deformed.ply".into()));
        assert_eq!(b.work, MethodWork::Model("edits/b.ply".into()));
        let MethodWork::Command(command) = &c.work else { panic!("a command") };
        assert_eq!(command.words[..2], ["python", "my arap.py"]);
        assert_eq!(command.given, [ProgramFile::Samples, ProgramFile::Constraints, ProgramFile::Output]);
        assert!(!command.makes_model() && command.folder == Path::new("edits"));
        assert_eq!(file.commands().count(), 1);
        let head = CropPlace {
            name: "The head".into(),
            file: "the-head".into(),
            target: DVec3::new(0.0, 1.0, 2.0),
            part: 0.25,
        };
        assert_eq!((file.runs, &file.crops[..]), (3, &[head][..]));
    }

    #[test]
    fn errors_say_which_line_and_what_to_do() {
        let told = |text: &str, line: usize, what: &str| {
            let error = parse(text).unwrap_err();
            let message = error.to_string();
            let place = if line == 0 {
                "edits/compare.toml: ".to_owned()
            } else {
                format!("edits/compare.toml, line {line}: ")
            };
            assert!(message.starts_with(&place), "{message}");
            assert!(message.contains(what), "{message}");
            assert!(!message.contains('\n') && !error.hint().contains('\n') && !error.hint().is_empty());
        };
        let with = |method: &str| format!("[model]\npath = \"a.ply\"\n[[method]]\n{method}");
        told("", 0, "no model");
        told("[model]\npath = \"a.ply\"", 0, "no method");
        told("[model]\npath = 3", 2, "3");
        told("[models]\n", 1, "models");
        told("[model\n", 1, "");
        told(&with("deform = \"rbf\""), 3, "name");
        told(&with("name = \" \"\ndeform = \"rbf\""), 3, "empty");
        told(&with("name = \"a\""), 3, "neither `deform` nor `session`");
        told(&with("name = \"a\"\ndeform = \"b\"\nsession = \"c\""), 3, "both `deform` and `session`");
        told(&with("name = \"a\"\nsession = \"c\"\nparams = { d = 1 }"), 3, "no `params`");
        told(&with("name = \"a\"\nmodel = \"c\"\nparams = { d = 1 }"), 3, "no `params`");
        told(&with("name = \"a\"\nmodel = \"c\"\ndeformed = \"d\""), 3, "both `deformed` and `model`");
        told(
            &with("name = \"a\"\nmodel = \"c\"\nreconstruction = \"blended-jets\""),
            3,
            "no `reconstruction`",
        );
        told(&with("name = \"a\"\ncommand = \"b {samples}\""), 3, "no {output}");
        told(&with("name = \"a\"\ncommand = \"b {output}\""), 3, "neither {samples} nor {model}");
        told(
            &with("name = \"a\"\ncommand = \"b {samples} {model} {output}\""),
            3,
            "both {samples} and {model}",
        );
        told(&with("name = \"a\"\ncommand = \"b 'c\""), 3, "no program");
        told(&with("name = \"a\"\ncommand = \"\""), 3, "no program");
        told(&format!("runs = 0\n{}", with("name = \"a\"\ndeform = \"b\"")), 1, "`runs`");
        for (bad, what) in [
            ("name = '!'\ntarget = [0, 0, 0]\npart = 0.1", "no letter"),
            ("name = 'a'\ntarget = [0, nan, 0]\npart = 0.1", "`target`"),
            ("name = 'a'\ntarget = [0, 0, 0]\npart = 0", "`part`"),
        ] {
            told(&format!("[[crop]]\n{bad}\n{}", with("name = \"a\"\ndeform = \"b\"")), 1, what);
        }
        told(&with("name = \"a\"\ndeform = \"b\"\nmethod = \"c\""), 6, "method");
        told(&with("name = \"a\"\ndeform = \"b\"\nsampling = { samples = 0 }"), 6, "`samples` is 0");
        told(&with("name = \"a\"\ndeform = \"b\"\nreconstruction = \"best\""), 6, "best");
        let one = "[[method]]\nname = \"a\"\ndeform = \"b\"\n";
        told(&format!("[model]\npath = \"a.ply\"\n{one}{one}"), 6, "two methods `a`");
        let many: String = (0..33).map(|i| one.replace("\"a\"", &format!("\"{i}\""))).collect();
        told(&format!("[model]\npath = \"a.ply\"\n{many}"), 99, "more than 32");
        for bad in ["size = [0, 5]", "size = [5000, 500]", "yaw = nan"] {
            told(&format!("[camera]\n{bad}\n{}", with(&one[11..])), 1, "");
        }
        told(&format!("[[region]]\nrole = \"fixed\"\nshapes = []\n{}", with(&one[11..])), 1, "no shape");
    }
}
