//! Deformation by landmarks: points of the model whose places in the result are known, in a file.
//!
//! Five maps (`map`), from a translation to a thin-plate spline, which meets all landmarks; a report of the
//! errors at the landmarks, with all of them and with each left out (`report`). Closed forms, which apply
//! to any point: the maps do not depend on the samples.

mod landmarks;
mod map;
mod report;

use glam::{DAffine3, DVec3};
use landmarks::Landmark;
use map::{MapKind, Open, PointExtent, SpaceMap};
use report::LandmarkReport;
use simod_plugin_api::{
    Bounds, Choice, Consumes, DeformInput, Deformer, Descriptor, Evaluate, Host, IsIdentity, LogLevel,
    ModelFrame, ParamDesc, ParamSet, PluginError, PluginResult, PrepareInput,
};
use std::path::Path;

/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 1024;
/// Distance of a landmark from the model, in units of its diagonal, beyond which the user is warned.
const FAR: f64 = 1.0;
/// Greatest coordinate of a landmark, in local coordinates: beyond it, sums lose all digits.
const BEYOND: f64 = 1e12;
/// Greatest number of names in a message.
const NAMES: usize = 5;

/// The plugin.
struct ControlPoints;

/// Parameters: the map, and the report on it.
#[derive(ParamSet)]
struct ControlPointSettings {
    /// Kind of map; splines and local weights meet each landmark, the others as well as they can
    #[param(default = MapKind::ThinPlate, invalidates_preparation)]
    method: MapKind,
    /// Smoothing of a thin-plate spline, for landmarks that are not exact; 0 meets them, larger ones miss
    /// more
    #[param(default = 0.0, unit = "diagonal", hard = 0.0..=1e3, soft = 0.0..=0.1, invalidates_preparation)]
    smoothing: f64,
    /// Form of the report on how well landmarks are met: one line, a line for each, or objects of JSON
    #[param(default = ReportForm::Summary, invalidates_preparation)]
    report: ReportForm,
}

#[derive(Choice, Debug, Clone, Copy)]
enum ReportForm {
    Summary,
    #[choice(label = "Each landmark")]
    Landmarks,
    #[choice(id = "json", label = "JSON")]
    Json,
}

impl Deformer for ControlPoints {
    type State = SpaceMap;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("control-points", "Control points", env!("CARGO_PKG_VERSION"))
            .summary("Takes landmarks to where they belong, and all else along: spline, affine, similarity or local")
            .citation(
                "F. L. Bookstein, Principal Warps: Thin-Plate Splines and the Decomposition of Deformations, PAMI \
                 1989; S. Umeyama, Least-Squares Estimation of Transformation Parameters Between Two Point Patterns, \
                 PAMI 1991",
            )
            .param(
                ParamDesc::file("landmarks", "Landmarks", &["csv", "txt"])
                    .hint("Lines of a name, x, y, z, the new place as x, y, z, and maybe a weight, in the model's coordinates"),
            )
            .param_set::<ControlPointSettings>()
            .consumes(Consumes { frame: true, ..Consumes::default() })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<SpaceMap> {
        let ControlPointSettings { method, smoothing, report } = input.params().read()?;
        let Some(path) = input.params().file("landmarks")? else {
            host.warn("there is no file of landmarks: nothing moves");
            return Ok(SpaceMap::Affine(DAffine3::IDENTITY));
        };
        let frame = input.frame().ok_or_else(|| {
            PluginError::input("this version of SIMOD does not tell where the file's coordinates are")
                .hint("use a newer one")
        })?;
        let landmarks = landmarks(path, frame)?;
        are_near((path, &landmarks), &input.bounds, host)?;
        let smoothing = smoothing * input.bounds.diagonal();
        let map = SpaceMap::fit(method, &landmarks, smoothing).map_err(|Open { why, instead }| {
            let or = instead.map_or(String::new(), |kind| {
                format!(", or take `method = \"{}\"`, which they determine", kind.id())
            });
            PluginError::input(format!("{}: {}", path.display(), why.what)).hint(why.remedy.to_owned() + &or)
        })?;
        warn(&map, method, &landmarks, host);
        host.progress(0.5)?;
        let told = LandmarkReport::new(&map, method, &landmarks, smoothing, frame.scale);
        tell(&told, report, host);
        Ok(map)
    }

    fn deform(
        map: &SpaceMap,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let rest = input.samples.positions();
        if rest.len() != out.len() {
            return Err(PluginError::internal("the samples are not those of the preparation"));
        }
        host.parallel_blocks(out, BLOCK, |first, out| {
            for (o, p) in out.iter_mut().zip(&rest[first..]) {
                *o = map.apply(DVec3::from(p.map(f64::from))).as_vec3().into();
            }
        })
    }
}

impl Evaluate for ControlPoints {
    fn evaluate(
        map: &SpaceMap,
        _: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            points.iter_mut().for_each(|p| *p = map.apply(DVec3::from(*p)).into());
        }
        Ok(())
    }
}

impl IsIdentity for ControlPoints {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(input.params().file("landmarks")?.is_none())
    }
}

/// The landmarks of a file, in local coordinates.
fn landmarks(path: &Path, frame: &ModelFrame) -> PluginResult<Vec<Landmark>> {
    let local = |p: DVec3| DVec3::from(frame.to_local(p.into()));
    let mut landmarks = landmarks::read(path).map_err(|(line, what)| {
        let place = line.map_or(String::new(), |line| format!(", line {line}"));
        PluginError::input(format!("{}{place} {what}", path.display()))
            .hint("a line for each landmark: a name, x, y, z, where these belong, and maybe a weight")
    })?;
    for landmark in &mut landmarks {
        (landmark.source, landmark.target) = (local(landmark.source), local(landmark.target));
        if !(landmark.source.length() < BEYOND && landmark.target.length() < BEYOND) {
            let what = format!("{}, line {} is immensely far from the model", path.display(), landmark.line);
            return Err(PluginError::input(what).hint("give places in the model's coordinates"));
        }
    }
    Ok(landmarks)
}

/// Warns of landmarks that lie far from the model; all of them cannot.
fn are_near((path, landmarks): (&Path, &[Landmark]), bounds: &Bounds, host: &Host<'_>) -> PluginResult<()> {
    let [low, high] = [bounds.min, bounds.max].map(DVec3::from);
    let beside = |l: &&Landmark| l.source.distance(l.source.clamp(low, high)) > FAR * bounds.diagonal();
    let far: Vec<&str> = landmarks.iter().filter(beside).map(|l| l.name.as_str()).collect();
    if far.len() == landmarks.len() {
        let what = format!("{}: all landmarks lie far from the model", path.display());
        return Err(PluginError::input(what)
            .hint("their coordinates have to be the model's: same origin, unit and order of axes"));
    }
    if !far.is_empty() {
        host.warn(&format!("landmarks lie far from the model: {}", names(&far)));
    }
    Ok(())
}

/// Warns of maps that the user may not want.
fn warn(map: &SpaceMap, method: MapKind, landmarks: &[Landmark], host: &Host<'_>) {
    let used: Vec<DVec3> = landmarks.iter().filter(|l| l.weight > 0.0).map(|l| l.source).collect();
    let extent = PointExtent::measure(&used);
    if matches!(method, MapKind::Affine | MapKind::ThinPlate) && extent.is_uncertain() {
        host.warn(&format!(
            "the landmarks lie nearly in a plane ({:.1e} of their extent across it): what happens across it is \
             uncertain; `method = \"similarity\"` does without",
            extent.least
        ));
    }
    if map.mirrors() {
        host.warn("the map turns the model inside out: axes may be in another order in sources and targets");
    }
}

fn tell(told: &LandmarkReport, how: ReportForm, host: &Host<'_>) {
    let lines = match how {
        ReportForm::Summary => vec![told.summary()],
        ReportForm::Landmarks => std::iter::once(told.summary()).chain(told.lines()).collect(),
        ReportForm::Json => told.json(),
    };
    lines.iter().for_each(|line| host.log(LogLevel::INFO, line));
    let outliers = told.outliers();
    if !outliers.is_empty() {
        host.warn(&format!("landmarks stand out, and may be wrong: {}", names(&outliers)));
    }
}

/// Some names.
fn names(all: &[&str]) -> String {
    let some = all.iter().take(NAMES).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    if all.len() > NAMES { format!("{some} and {} more", all.len() - NAMES) } else { some }
}

simod_plugin_api::export_plugin!(ControlPoints, evaluate, is_identity);

#[cfg(test)]
mod tests;
