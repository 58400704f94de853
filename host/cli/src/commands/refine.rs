//! `simod refine`: more samples in a part of a sampled model.

use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};
use glam::DVec3;
use serde_json::{Value, json};
use simod_core::deformed_positions::DeformedPositions;
use simod_core::guard::OutputKind;
use simod_core::reconstruction::{DeformationField, Method, RestGeometry, deformed_normals, judge};
use simod_core::refinement::{Finer, Refined, SamplesNeed, appended_deformed};
use simod_core::sampled_model::{BINDING, SampledModel};
use simod_model::target::folder_of;
use simod_model::{Error, Model, Progress, Result};
use simod_session::refining::{Room, ShapePose};
use simod_session::step::Refine as Refinement;
use simod_session::{RegionShape, Shapes};

use super::overwrite::Overwrite;
use super::sample::parse_bytes;
use super::tell_cache;
use crate::report::{Report, count, length};

/// Add samples to a sampled model in chosen places, down to one for each vertex
#[derive(Args)]
#[command(group(ArgGroup::new("shape").required(true).multiple(true).args(["sphere", "boxes", "half_space", "auto"])))]
#[command(group(ArgGroup::new("finer").args(["factor", "samples"])))]
pub struct Refine {
    /// Folder of the sampled model, which gets the new samples unless --into names another
    #[arg(value_name = "DIR")]
    sampled: PathBuf,
    /// Ball to refine: its centre and its radius
    ///
    /// Coordinates are those of the model at rest. Balls, boxes and half-spaces may be given several times,
    /// and are united.
    #[arg(long, value_name = "X,Y,Z,R", value_parser = numbers::<4>, allow_hyphen_values = true)]
    sphere: Vec<[f64; 4]>,
    /// Box to refine: its least and its greatest coordinates
    #[arg(long = "box", value_name = "X,Y,Z,X,Y,Z", value_parser = numbers::<6>, allow_hyphen_values = true)]
    boxes: Vec<[f64; 6]>,
    /// Half-space to refine: a point on its plane, and the plane's normal, which points into it
    #[arg(long, value_name = "X,Y,Z,NX,NY,NZ", value_parser = numbers::<6>, allow_hyphen_values = true)]
    half_space: Vec<[f64; 6]>,
    /// Refine where the deformed samples show that the deformation needs it
    ///
    /// Shapes restrict it to what lies in them. --error says how far vertices may be expected to be off, and
    /// --samples how many samples may be added at most.
    #[arg(long, requires = "deformed", conflicts_with = "factor")]
    auto: bool,
    /// Refine where vertices need it, too, with --auto
    ///
    /// The model is read once. Where a vertex is expected to be off by more than --error, which the samples
    /// around it may not tell, it is refined.
    #[arg(long, requires = "auto")]
    by_vertices: bool,
    /// Error bound of each new sample's cluster, as a fraction of the bounding box's diagonal
    ///
    /// 0 gives every vertex in the shapes a sample of its own. With --auto, it is the transfer error that is
    /// allowed [default: 1e-5]; only there --samples may be given besides.
    #[arg(
        long,
        value_name = "E",
        conflicts_with = "factor",
        allow_negative_numbers = true,
        required_unless_present_any = ["factor", "samples", "auto"]
    )]
    error: Option<f64>,
    /// Factor by which to multiply the number of samples in the shapes, approximately
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    factor: Option<f64>,
    /// Number of samples to add, approximately; with --auto, at most
    ///
    /// With --auto, the default is a quarter of the samples that there are.
    #[arg(long, value_name = "N")]
    samples: Option<u64>,
    /// File of the deformed samples of DIR, from which -o gets those of the refined model
    ///
    /// Samples that were there stay as they are; new ones go where the reconstruction takes them.
    #[arg(long, value_name = "FILE", requires = "output")]
    deformed: Option<PathBuf>,
    /// PLY file to write the deformed samples to
    #[arg(short, long, value_name = "FILE", requires = "deformed")]
    output: Option<PathBuf>,
    /// Folder to write the refined model to, instead of DIR
    #[arg(long, value_name = "DIR")]
    into: Option<PathBuf>,
    /// Model that was sampled, if its file has moved since
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Memory to stay below, as 500M or 2G [default: a quarter of the machine's, at most 2G]
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    memory_limit: Option<u64>,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// `N` numbers with commas between them.
fn numbers<const N: usize>(text: &str) -> std::result::Result<[f64; N], String> {
    let all: std::result::Result<Vec<f64>, _> = text.split(',').map(|x| x.trim().parse::<f64>()).collect();
    all.ok()
        .and_then(|all| <[f64; N]>::try_from(all).ok())
        .ok_or_else(|| format!("give {N} numbers with commas between them and no blanks"))
}

impl Refine {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        if !self.auto && self.error.is_some() && self.samples.is_some() {
            return Err(Error::argument(
                "both --error and --samples say how fine it shall be",
                "leave out one of them; only with --auto both are met",
            ));
        }
        let how = Refinement { shapes: self.shapes()?, finer: self.finer() };
        let target = self.into.as_deref().unwrap_or(&self.sampled);
        SampledModel::check_target(target)?;
        // The claim on the target keeps others from refining it, by which this refinement would be lost.
        let begun = SampledModel::begin(target)?;
        let mut sampled = SampledModel::load(&self.sampled)?;
        let deformed = self
            .deformed
            .as_deref()
            .map(|path| sampled.read_deformed(path, report.progress()))
            .transpose()?;
        let model = sampled.open_source(self.model.as_deref(), report.progress())?;
        self.guard(&sampled, model.as_ref())?;
        let progress = report.progress();
        sampled.hold_cells(sampled.cells_or_resample(&self.sampled, self.model.as_deref(), progress)?);
        let done = self.refined(&how, &sampled, model.as_ref(), deformed.as_ref(), progress)?;
        // The deformed samples of the refined model come first: they would be of no use without it, but do
        // no harm.
        if let (Some(from), Some(deformed), Some(to)) = (&self.deformed, deformed, &self.output) {
            progress.begin("deforming the new samples", 0);
            write_deformed(&sampled, done.sampled.as_ref().unwrap_or(&sampled), from, deformed, to)?;
        }
        progress.check()?;
        let was_bound = self.into.is_none() && self.sampled.join(BINDING).exists();
        if let Some(refined) = &done.sampled {
            progress.begin("writing", 0);
            refined.save_in(begun)?;
        }
        tell_cache(sampled.cache(), report);
        tell(report, &sampled, model.as_ref(), &done, target);
        if done.sampled.is_some() && was_bound {
            report.warn(format!("{BINDING} was of the samples before and is gone: run `simod bind` again"));
        }
        Ok(())
    }

    /// Checks that nothing that is read is replaced.
    fn guard(&self, sampled: &SampledModel, model: &dyn Model) -> Result<()> {
        let mut guard = self.overwrite.guard();
        guard.reads_all([model.path()].into_iter().chain(model.other_files()));
        guard.reads_all(sampled.source.files());
        if let Some(into) = &self.into {
            // All other files that are read may be replaced in place.
            guard.reads(&self.sampled);
            guard.replaces_folder(into)?;
        }
        guard.reads(&self.sampled);
        guard.reads_all(&self.deformed);
        self.output.iter().try_for_each(|output| guard.writes(output, OutputKind::Model))
    }

    fn finer(&self) -> Finer {
        match (self.error, self.factor, self.samples) {
            (error, _, samples) if self.auto => {
                Finer::Auto { error: error.unwrap_or(Finer::ALLOWED), samples }
            }
            (Some(e), ..) => Finer::Error(e),
            (None, Some(f), _) => Finer::Factor(f),
            (None, None, n) => Finer::Samples(n.unwrap_or(0)),
        }
    }

    /// Refines the samples. The shapes are meant at rest; the deformed samples tell where the deformation
    /// needs more.
    fn refined(
        &self,
        how: &Refinement,
        sampled: &SampledModel,
        model: &dyn Model,
        deformed: Option<&DeformedPositions>,
        progress: &dyn Progress,
    ) -> Result<Refined> {
        let around = deformed.filter(|_| self.auto).map(|_| RestGeometry::kept(sampled));
        let field = around.as_ref().zip(deformed).map(|(around, deformed)| {
            let field = DeformationField::from_deformed(around, deformed, Method::default());
            // A number that is out of range is refused below, before the model is read.
            let asks = self.by_vertices && how.finer.makes_sense();
            if asks { self.asking_vertices(field, sampled, model, progress) } else { Ok(field) }
        });
        let field = field.transpose()?;
        let target = self.into.as_deref().unwrap_or(&self.sampled);
        let room = Room { memory_limit: self.memory_limit, folder: folder_of(target) };
        how.refine(sampled, model, ShapePose::Rest(field.as_ref()), room, progress)
    }

    /// Field whose expected errors around samples are no less than those of the vertices there, where these
    /// are more than is allowed.
    fn asking_vertices<'a>(
        &self,
        field: DeformationField<'a>,
        sampled: &SampledModel,
        model: &dyn Model,
        progress: &dyn Progress,
    ) -> Result<DeformationField<'a>> {
        let allowed = self.error.unwrap_or(Finer::ALLOWED);
        let mut field = field.expecting(&sampled.frame, model.info()).expecting_of_vertices();
        let judged = judge(model, &field, sampled, allowed, None, progress)?;
        field.learn(sampled, &judged, allowed);
        Ok(field)
    }

    fn shapes(&self) -> Result<Shapes> {
        let three = |x: &[f64]| DVec3::from_slice(x);
        let spheres = self.sphere.iter().map(|s| RegionShape::Sphere { center: three(s), radius: s[3] });
        let boxes = self.boxes.iter().map(|b| RegionShape::Box { min: three(b), max: three(&b[3..]) });
        let sides = self
            .half_space
            .iter()
            .map(|h| RegionShape::HalfSpace { point: three(h), normal: three(&h[3..]) });
        let shapes: Vec<RegionShape> = spheres.chain(boxes).chain(sides).collect();
        match shapes.iter().find_map(RegionShape::defect) {
            Some(what) => Err(Error::argument(what, "correct the shape")),
            None => Ok(Shapes { shapes, falloff: 0.0 }),
        }
    }
}

/// Writes the deformed samples of the refined model; `deformed` are those before, from a file.
fn write_deformed(
    sampled: &SampledModel,
    refined: &SampledModel,
    from: &Path,
    mut deformed: DeformedPositions,
    to: &Path,
) -> Result<()> {
    let more = {
        let around = RestGeometry::kept(sampled);
        let field = DeformationField::from_deformed(&around, &deformed, Method::default());
        appended_deformed(refined, deformed.local.len(), &field)
    };
    let frame = deformed.frame(&refined.frame);
    deformed.local.extend(more.iter().map(|p| frame.to_local(*p)));
    let normals = deformed_normals(&refined.samples, &deformed.local);
    refined.write_more_deformed(to, from, &more, &normals)
}

/// Reports the vertices that were read, and the samples that were added.
fn tell(report: &mut Report, sampled: &SampledModel, model: &dyn Model, done: &Refined, target: &Path) {
    let samples = done.sampled.as_ref().unwrap_or(sampled).samples.len();
    let (info, diagonal) = (model.info(), sampled.bounds.diagonal());
    report.figure("vertices", info.vertices);
    report.figure("samples", samples);
    report.figure("added", done.added);
    report.figure("error", done.error);
    report.figure("error_length", done.error * diagonal);
    let mut lengths = json!({"error": done.error * diagonal});
    report.figure("diagonal", diagonal);
    report.figure("cells_read", done.cells);
    report.figure("bytes_read", json!({"vertices": done.vertex_bytes, "faces": done.face_bytes}));
    report.figure("model_bytes", info.bytes);
    if let Some(need) = &done.need {
        tell_need(report, need, &mut lengths, diagonal);
    }
    report.figure("lengths", lengths);
    if done.sampled.is_some() {
        report.line(format!(
            "{} samples more, {} in all, in {}; the error there is {}",
            count(done.added),
            count(samples as u64),
            target.display(),
            length(done.error, diagonal)
        ));
    } else if done.need.is_none() {
        report.line("nothing to refine: no cluster there has a larger error. Nothing is changed");
    } else if done.need.is_some_and(|need| need.samples > 0) {
        report.line(
            "what is expected there divides no cluster any further: nothing is changed. --sphere and --factor refine around a \
             place whatever is expected there",
        );
    }
    report.line(format!(
        "read {} bytes of {} for {} of {} cells",
        count(done.vertex_bytes + done.face_bytes),
        count(info.bytes),
        count(done.cells),
        count(sampled.cells)
    ));
}

/// Reports the expected error of the vertices.
fn tell_need(report: &mut Report, need: &SamplesNeed, lengths: &mut Value, diagonal: f64) {
    for (name, fraction) in [("expected", need.expected), ("allowed", need.allowed)] {
        let name = format!("{name}_transfer_error");
        report.figure(&name, fraction);
        report.figure(&format!("{name}_length"), fraction * diagonal);
        lengths[name] = json!(fraction * diagonal);
    }
    report.figure("needy_samples", need.samples);
    let expected = length(need.expected, diagonal);
    report.line(if need.samples == 0 && !need.is_met {
        format!(
            "vertices are expected to be off by up to {expected}, which is more than {}: {}. Nothing is changed",
            length(need.allowed, diagonal),
            SamplesNeed::NONE_LEFT
        )
    } else if need.samples == 0 {
        format!(
            "vertices are expected to be off by {expected} at most: the deformation needs no more samples. Nothing is \
             changed"
        )
    } else {
        format!(
            "vertices are expected to be off by up to {expected}: by more than {} around {} samples",
            length(need.allowed, diagonal),
            count(need.samples)
        )
    });
}
