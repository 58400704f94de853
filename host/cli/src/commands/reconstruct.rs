//! `simod reconstruct`: deformed samples back onto the whole model.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::guard::OutputKind;
use simod_core::reconstruction::{
    BeyondTolerance, DeformationField, ErrorExcess, ExpectedError, Folding, Method, Normals, PART_BYTES,
    Reconstructed, Reconstruction, RestGeometry, Version, choose_offset, judge, reconstruct,
};
use simod_core::sampled_model::{BINDING, SampledModel};
use simod_model::{
    Conversion, Converted, Error, MAX_VERSIONS, Model, Result, is_named_otherwise, note_on_name,
};
use simod_session::tolerance::check_precision;
use simod_session::{Tolerance, sidecar};

use super::convert::tell_losses;
use super::follow_options::FollowOptions;
use super::overwrite::Overwrite;
use super::sample::parse_bytes;
use super::{tell_cache, warn_non_finite};
use crate::report::{Report, count, errors, length, rate, with_lengths};
use crate::versions::{VersionPaths, versions};

/// Largest rounding, as a part of the tolerance, at which more samples still help: where it exceeds the
/// tolerance together with the samples' disagreement, that is more than the advised part of the tolerance.
const MOST_ROUNDING: f64 = 0.86;

/// Number of samples that it adds at most for each one that there is, or [`LEAST_MORE`] in all: the expected
/// errors of these are known then.
const TIMES_MORE: u64 = 3;
const LEAST_MORE: u64 = 256;

/// Stream the deformation of the samples onto every vertex of the model
///
/// Several deformations at once give a deformed model each.
#[derive(Args)]
pub struct Reconstruct {
    /// Folder of the sampled model
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// Deformed samples: samples.ply with other positions, from `simod deform` or any program
    ///
    /// Several files, or a pattern such as 'frame-*.ply', give a deformed model each.
    #[arg(long, value_name = "FILE", required = true, num_args = 1..)]
    deformed: Vec<PathBuf>,
    /// File to write the deformed model to; its extension says the format
    ///
    /// Formats: that of the model, and those that `simod convert` writes. For a model of several tiles it is
    /// a folder, for as many files of the same names. {} in the name stands for what the * of --deformed
    /// matched, or for a file's name without its extension.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// PLY file to write as well, with figures for each vertex; not with --resume
    ///
    /// The figures are for viewers of scalar fields: the new position, the displacement, the largest and the
    /// smallest stretch of the surface, whether it is folded (turned inside out), and the expected error
    /// (`expected_error`, in the model's unit, and `expected_error_fraction`, of the diagonal). {} in the
    /// name stands for what it does in -o.
    #[arg(long, value_name = "FILE")]
    diagnostics: Option<PathBuf>,
    /// Largest expected error of a vertex at which the model is written, as 1e-4 or 0.002u
    ///
    /// A number is a fraction of the diagonal of the bounding box; with the suffix u it is a length in the
    /// model's unit. Nothing is written if any vertex is expected to have a larger error.
    #[arg(long, value_name = "L", allow_hyphen_values = true)]
    tolerance: Option<Tolerance>,
    /// Model that was sampled, if its file has moved since
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Method by which the deformation goes from the samples to the vertices
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    /// Normals of the deformed model
    #[arg(long, value_enum, default_value_t)]
    normals: NormalsName,
    /// Offset of positions that are stored as integers, as in LAS
    #[arg(long, value_enum, default_value_t)]
    offset: OffsetName,
    /// Continue what an interrupted run of this command left
    ///
    /// With it, Ctrl-C and a full disk keep what is done.
    #[arg(long)]
    resume: bool,
    /// Size of the part of the model that is lost at most when a run is killed; for tests
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes, default_value_t = PART_BYTES, hide = true)]
    part_size: u64,
    /// Write a format that cannot hold all that the model has
    ///
    /// Without it, that is an error, which lists what would be lost.
    #[arg(long)]
    lossy: bool,
    #[command(flatten)]
    following: FollowOptions,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// Treatment of the model's normals.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum NormalsName {
    /// Keep the bytes of the model's normals
    Keep,
    /// Turn the model's normals with the surface
    #[default]
    Transform,
    /// Leave the normals out
    Drop,
}

impl From<NormalsName> for Normals {
    fn from(name: NormalsName) -> Self {
        match name {
            NormalsName::Keep => Self::Keep,
            NormalsName::Transform => Self::Transform,
            NormalsName::Drop => Self::Drop,
        }
    }
}

/// Treatment of the offset of positions that are stored as integers.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum OffsetName {
    /// Keep the model's offset; a vertex that moves beyond the integers is an error
    #[default]
    Keep,
    /// Choose another offset, by whole steps, where samples move beyond the integers; all positions are
    /// written anew then
    Auto,
}

/// The methods of the reconstruction.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    /// Offset along the normal over a projected triangle of samples, as in the paper
    ProjectedBarycentric,
    /// Blend of second-order expansions around the nearest samples
    #[default]
    BlendedJets,
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::ProjectedBarycentric => Self::ProjectedBarycentric,
            MethodName::BlendedJets => Self::BlendedJets,
        }
    }
}

impl Reconstruct {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let paths = versions(&self.deformed, &self.output, self.diagnostics.as_deref())?;
        let files: Vec<&Path> = paths.iter().map(|version| version.deformed.as_path()).collect();
        let (sampled, deformed) = SampledModel::load_with_deformed(&self.sampled, &files, report.progress())?;
        self.check_paths(&paths, &sampled)?;
        let model = self.open_model(&sampled, &paths, &deformed, report)?;
        let versions: Vec<Version<'_>> = paths
            .iter()
            .zip(&deformed)
            .map(|(v, deformed)| Version {
                deformed,
                output: &v.output,
                diagnostics: v.diagnostics.as_deref(),
            })
            .collect();
        let binding = self.sampled.join(BINDING);
        let how = Reconstruction {
            method: self.method.into(),
            normals: self.normals.into(),
            resume: self.resume,
            part_bytes: self.part_size,
            binding: Some(&binding),
            ..Reconstruction::default()
        };
        let tolerance = self.checked_tolerance(&sampled, model.as_ref())?;
        let judges_first = self.judges_first(paths.len());
        let judge =
            |fraction| self.judge_first(fraction, (&sampled, model.as_ref()), &paths, &deformed, report);
        let judged = tolerance.filter(|_| judges_first).map(judge).transpose()?;
        // Nothing is judged twice.
        let how = Reconstruction { tolerance: tolerance.filter(|_| !judges_first), ..how };
        let done = reconstruct(&sampled, model.as_ref(), &versions, &how, report.progress())
            .map_err(|error| self.advising(error, tolerance, &sampled, &paths))?;
        if let Some(fraction) = tolerance {
            let expected = judged.unwrap_or(done.around_samples);
            let figures = json!({"fraction": fraction, "expected": expected});
            let lengths = with_lengths(figures, &["fraction", "expected"], sampled.bounds.diagonal());
            report.figure("tolerance", lengths);
        }
        self.tell(&done, &paths, &sampled, report);
        Ok(())
    }

    /// Checks that nothing that is read is written over.
    fn check_paths(&self, paths: &[VersionPaths], sampled: &SampledModel) -> Result<()> {
        let mut guard = self.overwrite.guard();
        guard.reads(&self.sampled);
        // The model itself is guarded where it is streamed.
        guard.reads_all(self.model.is_some().then(|| sampled.source.files()).into_iter().flatten());
        guard.reads(&sidecar::path_beside(self.model.as_ref().unwrap_or(&sampled.source.path)));
        guard.reads_all(paths.iter().map(|v| &v.deformed));
        let tiles = sampled.source.named(self.model.as_deref())?.written_tiles();
        for VersionPaths { output, diagnostics, .. } in paths {
            guard.writes_model(output, &tiles)?;
            diagnostics.iter().try_for_each(|path| guard.writes(path, OutputKind::Model))?;
        }
        Ok(())
    }

    /// Opens the model as it is to be written: with the attributes that turn, the offset and the format
    /// that were asked for.
    fn open_model(
        &self,
        sampled: &SampledModel,
        paths: &[VersionPaths],
        deformed: &[DeformedPositions],
        report: &mut Report,
    ) -> Result<Box<dyn Model>> {
        let mut model = sampled.open_source(self.model.as_deref(), report.progress())?;
        sidecar::follow(&mut *model, &self.following.follow(&BTreeMap::new()))?;
        tell_following(&*model, report);
        let mut outputs = paths.iter().map(|v| &v.output);
        outputs.clone().filter_map(|path| note_on_name(path)).for_each(|note| report.progress().note(&note));
        if let Some(output) = outputs.find(|path| is_named_otherwise(&*model, path)) {
            let drops_normals = self.normals == NormalsName::Drop;
            let how = Conversion { lossy: self.lossy, drops_normals, ..Conversion::default() };
            let converted = Converted::new(model, output, how, report.progress())?;
            tell_losses(converted.losses(), converted.rounding(), report);
            model = Box::new(converted);
        }
        if self.offset == OffsetName::Auto {
            let chosen = choose_offset(sampled, model.as_mut(), deformed.iter())?;
            chosen.into_iter().for_each(|changed| report.progress().note(&changed));
        }
        Ok(model)
    }

    /// Reports the outputs, and their figures.
    fn tell(
        &self,
        done: &Reconstructed,
        paths: &[VersionPaths],
        sampled: &SampledModel,
        report: &mut Report,
    ) {
        warn_non_finite(sampled, report);
        describe_folding(paths, &done.folding, report);
        self.describe_expected(paths, &done.expected, sampled.bounds.diagonal(), report);
        report.figure("vertices", done.vertices);
        tell_cache(sampled.cache(), report);
        report.figure("versions", paths.len());
        report.figure("samples", sampled.samples.len());
        report.figure("diagonal", sampled.bounds.diagonal());
        let into = match paths {
            [one] => one.output.display().to_string(),
            several => format!("each of {} versions", several.len()),
        };
        if self.resume {
            report.figure("resumed_bytes", done.taken_over);
            report.line(format!("{} bytes were there from an earlier run", count(done.taken_over)));
        }
        report.line(format!(
            "{} vertices in {into}, {}",
            count(done.vertices),
            rate(done.vertices * paths.len() as u64, report.seconds())
        ));
    }
}

impl Reconstruct {
    /// Returns the tolerance as a fraction of the diagonal, or an error where nothing tells that it is met.
    fn checked_tolerance(&self, sampled: &SampledModel, model: &dyn Model) -> Result<Option<f64>> {
        let Some(tolerance) = self.tolerance else { return Ok(None) };
        if self.method != MethodName::BlendedJets {
            return Err(Error::argument(
                "what is expected is known of the method blended-jets alone",
                "leave out --tolerance or --method",
            ));
        }
        let tolerance = tolerance.fraction(sampled.bounds.diagonal());
        check_precision(sampled, model, tolerance)?;
        Ok(Some(tolerance))
    }

    /// Whether all vertices of so many versions are judged before anything is written: an earlier run may
    /// have written some of them, or the versions of one reading are in their places before the next one.
    fn judges_first(&self, versions: usize) -> bool {
        self.resume || versions > MAX_VERSIONS
    }

    /// Returns an error where more than the tolerance is expected around any sample of a version, or of any
    /// vertex, before anything is written; otherwise the largest error that is expected around a sample.
    fn judge_first(
        &self,
        tolerance: f64,
        of: (&SampledModel, &dyn Model),
        paths: &[VersionPaths],
        deformed: &[DeformedPositions],
        report: &mut Report,
    ) -> Result<f64> {
        let (sampled, model) = of;
        report.progress().begin("estimating the error", 0);
        let (around, mut most) = (RestGeometry::kept(sampled), 0.0f64);
        for (version, deformed) in deformed.iter().enumerate() {
            report.progress().check()?;
            let field = DeformationField::from_deformed(&around, deformed, self.method.into())
                .expecting(&sampled.frame, model.info());
            if let Some(beyond) = BeyondTolerance::by_samples(version, &field, sampled, tolerance) {
                return Err(self.refusal(tolerance, sampled, paths, &beyond));
            }
            most = most.max(field.most_expected(sampled));
            let mut field = field.expecting_of_vertices();
            let judged = judge(model, &field, sampled, tolerance, None, report.progress())?;
            if judged.beyond > 0
                && let Some(beyond) = field.learn(sampled, &judged, tolerance)
            {
                let beyond = BeyondTolerance::by_vertices(version, judged.beyond, beyond);
                return Err(self.refusal(tolerance, sampled, paths, &beyond));
            }
        }
        Ok(most)
    }

    /// Error with advice, where it is that vertices are expected to be off by more than the tolerance.
    fn advising(
        &self,
        error: Error,
        tolerance: Option<f64>,
        sampled: &SampledModel,
        paths: &[VersionPaths],
    ) -> Error {
        let source = std::error::Error::source(&error).and_then(|source| source.downcast_ref());
        let (Some(beyond), Some(tolerance)) = (source, tolerance) else { return error };
        self.refusal(tolerance, sampled, paths, beyond)
    }

    /// Error where vertices of a version are expected to be off by more than the tolerance, as samples tell,
    /// or as single vertices do.
    fn refusal(
        &self,
        tolerance: f64,
        sampled: &SampledModel,
        paths: &[VersionPaths],
        told: &BeyondTolerance,
    ) -> Error {
        let diagonal = sampled.bounds.diagonal();
        let BeyondTolerance { version, vertices, ref beyond, needed } = *told;
        let (paths, ErrorExcess { worst, place, samples, .. }) = (&paths[version], *beyond);
        let what = format!(
            "{}: vertices are expected to be off by up to {} near ({:.6}, {:.6}, {:.6}), and by more than the tolerance of \
             {} around {} samples; nothing was written",
            paths.output.display(),
            length(worst, diagonal),
            place.x,
            place.y,
            place.z,
            length(tolerance, diagonal),
            count(samples)
        );
        if let Some(why) = why_no_samples_help(tolerance, sampled, beyond) {
            return Error::argument(what, why);
        }
        let most = (TIMES_MORE * sampled.samples.len() as u64).max(LEAST_MORE);
        let how =
            format!("--error {:e} --samples {most}", rounded_down(BeyondTolerance::ADVISED * tolerance));
        let (how, told) = match vertices {
            None => (how, format!(", about {} in all, at most {} at a time", count(needed), count(most))),
            Some(_) => (format!("--by-vertices {how}"), String::new()),
        };
        let hint = format!(
            "`{}` adds samples where they are needed{told}; then deform these by the program that deformed the others, as \
             where the transfer places them tells nothing about it",
            self.refining(paths, &how)
        );
        Error::argument(what, hint)
    }

    /// Command that adds samples, with these options.
    fn refining(&self, paths: &VersionPaths, how: &str) -> String {
        let model =
            self.model.as_deref().map_or_else(String::new, |path| format!(" --model {}", quoted(path)));
        // A file that is read is not written over.
        let output = if paths.deformed.ends_with("more.ply") { "more-2.ply" } else { "more.ply" };
        format!(
            "simod refine {} --auto {how} --deformed {}{model} -o {output}",
            quoted(&self.sampled),
            quoted(&paths.deformed)
        )
    }

    /// Reports the expected errors of the versions, and warns where these are larger than a user will
    /// accept.
    fn describe_expected(
        &self,
        paths: &[VersionPaths],
        expected: &[Option<ExpectedError>],
        diagonal: f64,
        report: &mut Report,
    ) {
        let figure = match expected {
            [one] => json!(one.map(|one| expected_figure(&one, diagonal))),
            several => {
                several.iter().map(|one| json!(one.map(|one| expected_figure(&one, diagonal)))).collect()
            }
        };
        report.figure("expected_error", figure);
        let several = paths.len() > 1;
        for (paths, expected) in paths.iter().zip(expected) {
            let Some(expected) = expected else { continue };
            describe_expected(expected, diagonal, report);
            // Whoever gives a tolerance accepts it.
            if let Some(beyond) = expected.beyond.filter(|_| self.tolerance.is_none()) {
                let which = if several { format!("{}: ", paths.output.display()) } else { String::new() };
                let help = format!(
                    "`{}` adds samples where they are needed, about {} in all, at most a quarter more at a time",
                    self.refining(paths, &format!("--error {:e}", ExpectedError::ACCEPTED)),
                    count(beyond.needed)
                );
                warn_beyond(&which, &beyond, diagonal, &help, report);
            }
        }
    }
}

/// Reason for which more samples would not help where vertices are expected to be off by more than the
/// tolerance, if they would not.
fn why_no_samples_help(tolerance: f64, sampled: &SampledModel, beyond: &ErrorExcess) -> Option<String> {
    if !beyond.worst.is_finite() {
        return Some("numbers of single precision overflow there: move the samples less far".to_owned());
    }
    if beyond.rounding > MOST_ROUNDING * tolerance {
        let rounding = length(beyond.rounding, sampled.bounds.diagonal());
        return Some(format!("rounding alone makes {rounding} there: give a larger tolerance"));
    }
    (sampled.samples.len() as u64 >= sampled.source.vertices).then(|| {
        "all vertices are samples already: give a larger tolerance, or make the deformation smoother there".to_owned()
    })
}

/// Positive number of three digits that is no larger: an error that meets it meets `x`.
fn rounded_down(x: f64) -> f64 {
    let digits = |x: f64| format!("{x:.2e}").parse().unwrap_or(x);
    let nearest = digits(x);
    // The number less three quarters of its last digit is rounded to the one below.
    if nearest <= x { nearest } else { digits(x - 0.0075 * 10f64.powf(x.log10().floor())) }
}

/// A path as a shell takes it, and the program: one that begins with a hyphen would be an option.
fn quoted(path: &Path) -> String {
    let path = path.to_string_lossy();
    let path = if path.starts_with('-') { Cow::Owned(format!("./{path}")) } else { path };
    // Paths have no zero bytes, which is all that cannot be quoted.
    shlex::try_quote(&path).map_or_else(|_| path.to_string(), |quoted| quoted.into_owned())
}

/// Reports the attributes that turn with the surface besides normals and tangents.
pub fn tell_following(model: &dyn Model, report: &mut Report) {
    let Some(following) = model.following() else { return };
    report.line(format!("turning with the surface: {}", following.descriptions().join("; ")));
    report.figure("following", following.descriptions().to_vec());
}

/// Expected error of the vertices, for `--json`.
pub fn expected_figure(expected: &ExpectedError, diagonal: f64) -> Value {
    with_lengths(json!(expected), &["rms", "p999", "worst"], diagonal)
}

/// Reports the expected error of the vertices.
pub fn describe_expected(expected: &ExpectedError, diagonal: f64, report: &mut Report) {
    let ExpectedError { rms, p999, worst, of_vertices, .. } = expected;
    report.line(format!(
        "expected transfer error{}: {}",
        if *of_vertices { " of the vertices" } else { ", by the samples" },
        errors([*rms, *p999, *worst], diagonal)
    ));
}

/// Warns where the expected error is larger than a user will accept.
pub fn warn_beyond(which: &str, beyond: &ErrorExcess, diagonal: f64, help: &str, report: &mut Report) {
    let ErrorExcess { worst, place, samples, .. } = beyond;
    report.warn(format!(
        "{which}vertices are expected to be off by up to {}, near ({:.6}, {:.6}, {:.6}), and by more than {} around \
         {} samples; {help}",
        length(*worst, diagonal),
        place.x,
        place.y,
        place.z,
        length(ExpectedError::ACCEPTED, diagonal),
        count(*samples)
    ));
}

/// Reports the places where the versions fold the surface.
fn describe_folding(paths: &[VersionPaths], folding: &[Option<Folding>], report: &mut Report) {
    let known = || paths.iter().zip(folding).filter_map(|(paths, folding)| Some((paths, (*folding)?)));
    report.figure("folded_samples", known().map(|(_, f)| f.samples).sum::<u64>());
    let vertices = || known().filter_map(|(_, f)| f.vertices);
    if vertices().next().is_some() {
        report.figure("folded_vertices", vertices().sum::<u64>());
    }
    for (paths, folding) in known() {
        let Some(first) = folding.first else { continue };
        let which = if known().count() > 1 { format!("{}: ", paths.output.display()) } else { String::new() };
        report.warn(format!(
            "{which}the deformation folds the surface at {} samples, first near ({:.6}, {:.6}, {:.6}); deform it less \
             there, or look at it with --diagnostics",
            count(folding.samples),
            first.x,
            first.y,
            first.z
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_digits_are_never_more() {
        let cases = [
            (1e-4, 1e-4),
            (1.06e-4, 1.06e-4),
            (1.0651e-4, 1.06e-4),
            (1.0649e-4, 1.06e-4),
            (9.999e-5, 9.99e-5),
            (0.001_234_5, 1.23e-3),
            (2.0, 2.0),
        ];
        for (x, down) in cases {
            assert_eq!(rounded_down(x), down, "{x:e}");
        }
        for x in (1..5000).map(|i| 1e-7 * 1.0071f64.powi(i)) {
            assert!(rounded_down(x) <= x && rounded_down(x) > 0.99 * x, "{x:e}");
        }
    }

    #[test]
    fn a_path_with_a_blank_is_one_word() {
        for path in ["model.simod", "my model.simod", "it's.ply", "frame-*.ply"] {
            assert_eq!(shlex::split(&quoted(Path::new(path))), Some(vec![path.to_owned()]));
        }
        assert_eq!(quoted(Path::new("-model.ply")), "./-model.ply");
    }
}
