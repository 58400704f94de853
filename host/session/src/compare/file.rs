//! `compare.toml`: a model, regions, and the methods to be compared on them.

use crate::session_file::{RawModel, RawRegion, Region, Sampling, Source, read_text};
use serde::Deserialize;
use simod_core::reconstruction::Method as Reconstruction;
use simod_model::{Error, ErrorKind, Result};
use simod_picture::picture::Up;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Most methods of a comparison: all their models are read at once, and all pairs of them are compared.
pub const MAX_METHODS: usize = 32;

/// Longest side of a picture in pixels: 4 times as many samples are held, of 64 bytes each, which is 1 GB at
/// most.
const MAX_SIDE: u32 = 2000;

/// A comparison that is to be made. Paths are as the program needs them: relative to the current folder, or
/// absolute.
#[derive(Debug, Clone, PartialEq)]
pub struct CompareFile {
    /// The file's text.
    pub text: String,
    /// The huge model.
    pub model: PathBuf,
    /// What its columns are, if it is a text in columns that does not say so.
    pub columns: Option<String>,
    /// The model's fingerprint, if the file says it.
    pub fingerprint: Option<String>,
    /// Regions for all methods that are one plugin, as far as it takes them.
    pub regions: Vec<Region>,
    /// How the pictures are taken.
    pub camera: CameraPlace,
    /// At least one, with names that differ.
    pub methods: Vec<Method>,
}

/// From where pictures are taken, and how large, as `simod render` has it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields, default)]
pub struct CameraPlace {
    /// Turned to the right about the vertical axis, in degrees.
    pub yaw: f64,
    /// Looking down, in degrees.
    pub pitch: f64,
    /// The model's axis that points up.
    pub up: Up,
    /// Width and height of a picture in pixels.
    pub size: [u32; 2],
}

impl Default for CameraPlace {
    fn default() -> Self {
        Self { yaw: 25.0, pitch: 12.0, up: Up::Y, size: [640, 640] }
    }
}

/// One of the methods that are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Method {
    /// What the user calls it; unique.
    pub name: String,
    /// Where in the file it stands, as `compare.toml, line 7`; for errors.
    pub place: String,
    /// What is done.
    pub work: Work,
    /// How finely the model is sampled.
    pub sampling: Sampling,
    /// How the deformation gets onto the model.
    pub reconstruction: Reconstruction,
}

/// What a method does to the samples.
#[derive(Debug, Clone, PartialEq)]
pub enum Work {
    /// One plugin, on the shared regions.
    Plugin {
        /// Its id.
        deform: String,
        /// The version of what its parameters mean; where nothing is said, the first.
        state_version: Option<u32>,
        /// The parameters that differ from their defaults.
        params: toml::Table,
        /// What paths among them are relative to.
        folder: PathBuf,
    },
    /// The steps of a session, with the regions that they have there.
    Session(PathBuf),
}

// As the file has it.

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCompare {
    model: Option<RawModel>,
    sampling: Option<Spanned<Sampling>>,
    #[serde(default)]
    region: Vec<Spanned<RawRegion>>,
    camera: Option<Spanned<CameraPlace>>,
    #[serde(default)]
    method: Vec<Spanned<RawMethod>>,
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
    sampling: Option<Spanned<Sampling>>,
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
    /// It cannot be read, or says something that makes no sense; which line it is.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&read_text(path, "comparison", "give a file such as compare.toml")?, path)
    }

    /// Reads a comparison from its text; `path` is where it came from.
    ///
    /// # Errors
    /// As for [`load`](Self::load).
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let source = Source { text, path };
        let raw: RawCompare = toml::from_str(text).map_err(|e| source.refused(&e))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let missing = |what: &str, hint: &str| {
            Error::new(ErrorKind::Format, format!("{}: {what}", path.display()), hint)
        };
        let model = raw
            .model
            .ok_or_else(|| missing("there is no model", "add [model] path = \"…\", relative to this file"))?;
        let sampling = match raw.sampling {
            Some(sampling) => source.sampling(sampling)?,
            None => Sampling::default(),
        };
        let mut methods: Vec<Method> = Vec::with_capacity(raw.method.len());
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
        Ok(Self {
            text: text.to_owned(),
            model: folder.join(model.path),
            columns: model.columns,
            fingerprint: model.fingerprint,
            regions: raw.region.into_iter().map(|r| source.region(r)).collect::<Result<_>>()?,
            camera: raw.camera.map_or(Ok(CameraPlace::default()), |c| camera(&source, c))?,
            methods,
        })
    }
}

fn camera(source: &Source<'_>, raw: Spanned<CameraPlace>) -> Result<CameraPlace> {
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

/// Checks a method; `before` are those above it.
fn method(
    source: &Source<'_>,
    raw: Spanned<RawMethod>,
    shared: Sampling,
    before: &[Method],
) -> Result<Method> {
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
    let work = match (raw.deform, raw.session) {
        (Some(deform), None) => {
            let (state_version, params) = (raw.state_version, raw.params);
            Work::Plugin { deform, state_version, params, folder: folder.to_owned() }
        }
        (None, Some(session)) if raw.params.is_empty() && raw.state_version.is_none() => {
            Work::Session(folder.join(session))
        }
        (None, Some(_)) => {
            return wrong("a method of a whole session has no `params`", "change them in the session");
        }
        (Some(_), Some(_)) => {
            return wrong("a method has both `deform` and `session`", "keep one of the two");
        }
        (None, None) => {
            return wrong(
                "a method has neither `deform` nor `session`",
                "name a plugin, such as deform = \"rbf\", or a session, as session = \"bend.toml\"",
            );
        }
    };
    let sampling = raw.sampling.map_or(Ok(shared), |sampling| source.sampling(sampling))?;
    let reconstruction = raw.reconstruction.map(Reconstruction::from).unwrap_or_default();
    Ok(Method { name: raw.name, place: source.place(&span), work, sampling, reconstruction })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session_file::Role;

    fn parse(text: &str) -> Result<CompareFile> {
        CompareFile::parse(text, Path::new("edits/compare.toml"))
    }

    const GOOD: &str = r#"
[model]
path = "cactus.ply"
[sampling]
samples = 20000
[[region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0.4, 0], normal = [0, -1, 0] } }]
[[region]]
role = "handle"
shapes = [{ sphere = { center = [0, 2, 0], radius = 0.3 } }]
move = { translate = [1, 0, 0] }
[camera]
yaw = 10
size = [400, 300]
[[method]]
name = "as rigid as possible"
deform = "laplacian"
params = { mode = "arap" }
[[method]]
name = "rbf, coarse"
deform = "rbf"
sampling = { samples = 5000 }
reconstruction = "projected-barycentric"
[[method]]
name = "a whole session"
session = "bend.toml"
"#;

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
        assert_eq!(session.work, Work::Session("edits/bend.toml".into()));
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
