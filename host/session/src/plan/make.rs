//! Plans from sessions.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use simod_core::reconstruction::Method;
use simod_core::sampling::divided::{exchanged_at_most, ranges_of, reads_faces, undivided};
use simod_core::sampling::divided_faces::{face_ranges_of, faces_exchanged_at_most};
use simod_core::sampling::face_runs::have_to_be_found;
use simod_core::sampling::{Sampling, Skip};
use simod_model::follow::Follow;
use simod_model::output_folder::OutputFolder;
use simod_model::target::{canonical_folder, canonical_target, folder_of};
use simod_model::{Cache, Division, Error, Model, ModelName, Normals, Progress, Result};

use super::emit::Emit;
use super::folder::{absolute, check_target, put, text};
use super::graph::{
    COUNTS, CUT, DEFORMED, Exchange, FACE_RUNS, FORMAT, METHODS, NORMALS, Plan, Recorded, SAMPLED, name_of,
};
use super::units::{FINISHED, Stage, Unit, hash_of};
use crate::pipeline::{converted, needed, open, sampling_of};
use crate::plugins::PluginRegistry;
use crate::session_file::{SessionFile, SessionTime};
use crate::sidecar;
use crate::stack::Stack;

/// Options of running a session by units: those of [`Running`](crate::Running) that units support.
#[derive(Debug, Clone)]
pub struct PlanOptions<'a> {
    /// Method by which vertices are carried over.
    pub method: Method,
    /// Treatment of the model's normals.
    pub normals: Normals,
    /// The offset of positions that are stored as integers may be another one.
    pub choose_offset: bool,
    /// Whether another format may lose content that it cannot hold.
    pub lossy: bool,
    /// Files of other kinds may be replaced by the output.
    pub force: bool,
    /// Rules for the attributes that turn with the surface.
    pub follow: &'a Follow,
    /// Libraries of plugins that were chosen.
    pub plugins: &'a [PathBuf],
    /// Whether the samples get all that those of a folder have, but for colours, and not only what the steps
    /// need.
    pub whole_samples: bool,
    /// Number of units that share each stage that can be divided.
    pub units: u64,
    /// The engines that files are written for.
    pub emit: &'a [Emit],
}

/// Makes the plan of a session, which is in the file `path`, and writes it to a folder, which appears whole
/// or not at all. A former plan there is replaced. Vertices are not read, unless the model has to be gone
/// over to be opened.
///
/// # Errors
/// The session cannot be done; the model cannot be opened; the folder cannot be written, or is no plan; a
/// path is no text.
pub fn make(
    session: &SessionFile,
    path: &Path,
    registry: &PluginRegistry,
    output: &Path,
    options: &PlanOptions<'_>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Plan> {
    check_target(folder)?;
    // Mistakes in the steps are reported now.
    let stack = Stack::build(&session.steps, registry)?;
    let output = output_outside(folder, session, output)?;
    let new = OutputFolder::create(folder)?;
    let cache = &Arc::new(Cache::nameless(folder_of(folder)));
    let becomes = converted(session, &output, (options.normals, options.lossy), (cache, progress))?;
    let mut model = open(session, cache, progress)?;
    let follow = sidecar::follow(&mut *model, options.follow)?;
    let sampling = sampling_of(session, skipped(session, &stack, options.whole_samples));
    let undivided = why_undivided(&*model, becomes.is_some(), options.normals);
    let info = model.info();
    let tiles: Vec<PathBuf> = model.tiles().iter().map(|tile| absolute(&tile.path)).collect::<Result<_>>()?;
    let plan = Plan {
        format: FORMAT.to_owned(),
        program: env!("CARGO_PKG_VERSION").to_owned(),
        session: absolute(path)?,
        session_hash: hash_of(path)?,
        output: text(output)?,
        model: if tiles.is_empty() { absolute(model.path())? } else { text(model.path().to_owned())? },
        tiles,
        model_bytes: info.bytes,
        vertices: info.vertices,
        options: recorded(options, follow, session.time)?,
        units: units(&*model, &sampling, undivided.is_some(), options)?,
        exchange: exchange(&*model, &sampling, options)?,
        undivided,
    };
    put(new, (&plan, &plan.units), options.emit, progress)?;
    Ok(plan)
}

/// Parts of the samples that are left out.
pub(super) fn skipped(session: &SessionFile, stack: &Stack, whole: bool) -> Skip {
    if whole { Skip { colors: true, ..Skip::default() } } else { needed(session, stack, false) }
}

/// Reason for which only one unit writes the model, if so.
fn why_undivided(model: &dyn Model, is_converted: bool, normals: Normals) -> Option<String> {
    if is_converted {
        return Some("it becomes another format, whose parts follow from each other".to_owned());
    }
    let of = if model.tiles().is_empty() { "whose parts" } else { "of which some" };
    model
        .division(normals)
        .is_none()
        .then(|| format!("it is {}, {of} cannot be written by themselves", model.info().format))
}

/// Whether each unit can read its own vertices; in other models each would have to unpack, or go over, the
/// vertices of others.
fn is_read_anywhere(model: &dyn Model, normals: Normals) -> bool {
    model.info().random_access && model.division(normals).is_some()
}

/// Most units that cluster ranges, since every group of cells has to wait for each of them.
const MOST_CLUSTERING: u64 = 1000;

/// Number of units that cluster ranges of the model, which is also the number of groups of cells that these
/// share; 0 if one unit samples the model.
fn clustering(model: &dyn Model, sampling: &Sampling, options: &PlanOptions<'_>) -> Result<u64> {
    let is_divided = is_read_anywhere(model, options.normals) && undivided(model, sampling)?.is_none();
    let count = if is_divided { ranges_of(model, options.units.min(MOST_CLUSTERING)) } else { 0 };
    Ok(if count > 1 { count } else { 0 })
}

/// Size of the files that units write for each other on the cells that they share, and on the faces.
fn exchange(model: &dyn Model, sampling: &Sampling, options: &PlanOptions<'_>) -> Result<Exchange> {
    if clustering(model, sampling, options)? > 0 {
        let at_most_bytes =
            exchanged_at_most(model).saturating_add(faces_exchanged_at_most(model, sampling)?);
        return Ok(Exchange { at_most_bytes, undivided: None });
    }
    let why = undivided(model, sampling)?.filter(|_| options.units > 1);
    Ok(Exchange { at_most_bytes: 0, undivided: why.map(str::to_owned) })
}

/// Part of a model that a unit does.
enum UnitExtent {
    All,
    Vertices(Range<u64>),
    Part(u64),
    Pieces(Range<u64>),
}

/// The deformed model's place, which is not in the plan's folder.
fn output_outside(folder: &Path, session: &SessionFile, output: &Path) -> Result<PathBuf> {
    let output = match session.named_model()? {
        Some(ModelName::Tiles(_)) => canonical_folder(output)?,
        _ => canonical_target(output)?,
    };
    if folder.canonicalize().is_ok_and(|folder| output.starts_with(folder)) {
        let what = format!("{} lies in the plan's folder, which is replaced", output.display());
        return Err(Error::argument(what, "write it to another folder"));
    }
    Ok(output)
}

/// Options as units read them.
fn recorded(options: &PlanOptions<'_>, follow: Follow, time: SessionTime) -> Result<Recorded> {
    Ok(Recorded {
        method: name_of(&METHODS, &options.method),
        normals: name_of(&NORMALS, &options.normals),
        choose_offset: options.choose_offset,
        lossy: options.lossy,
        force: options.force,
        whole_samples: options.whole_samples,
        splats: follow.splats,
        opacity: follow.opacity,
        max_anisotropy: follow.max_anisotropy,
        plugins: options.plugins.iter().map(|file| absolute(file)).collect::<Result<_>>()?,
        time,
        follow: follow.declared,
    })
}

/// The graph.
fn units(
    model: &dyn Model,
    sampling: &Sampling,
    undivided: bool,
    options: &PlanOptions<'_>,
) -> Result<Vec<Unit>> {
    let mut units: Vec<Unit> = Vec::new();
    let mut add = |stage, after: Vec<usize>, of: UnitExtent, writes: PathBuf| {
        let (vertices, part, pieces) = match of {
            UnitExtent::All => (None, None, None),
            UnitExtent::Vertices(range) => (Some(range), None, None),
            UnitExtent::Part(part) => (None, Some(part), None),
            UnitExtent::Pieces(range) => (None, None, Some(range)),
        };
        units.push(Unit { number: units.len(), stage, after, vertices, part, pieces, writes });
        units.len() - 1
    };
    let sample = sampling_units(model, sampling, options, &mut add)?;
    let deform = add(Stage::Deform, vec![sample], UnitExtent::All, DEFORMED.into());
    let division = model.division(options.normals).filter(|_| !undivided);
    let Some(division) = division else {
        add(Stage::Write, vec![deform], UnitExtent::All, FINISHED.into());
        return Ok(units);
    };
    let mut written = Vec::new();
    for (number, range) in pieces(model, &division, options.units).into_iter().enumerate() {
        let writes = PathBuf::from(format!("part-{number}.bin"));
        written.push(add(Stage::Apply, vec![deform], UnitExtent::Pieces(range), writes));
    }
    add(Stage::Finish, written, UnitExtent::All, FINISHED.into());
    Ok(units)
}

/// The units that sample the model; the number of the last one.
fn sampling_units(
    model: &dyn Model,
    sampling: &Sampling,
    options: &PlanOptions<'_>,
    add: &mut impl FnMut(Stage, Vec<usize>, UnitExtent, PathBuf) -> usize,
) -> Result<usize> {
    let mut before = Vec::new();
    let info = model.info();
    if is_read_anywhere(model, options.normals) {
        for (number, range) in shares(info.vertices, options.units).enumerate() {
            let writes = PathBuf::from(format!("count-{number}.bin"));
            before.push(add(Stage::Count, Vec::new(), UnitExtent::Vertices(range), writes));
        }
    }
    let (count, sampled) = (clustering(model, sampling, options)?, Path::new(SAMPLED).join("simod.toml"));
    Ok(if count > 0 {
        if reads_faces(model, sampling)? && have_to_be_found(model) {
            before.push(add(Stage::FaceRuns, Vec::new(), UnitExtent::All, FACE_RUNS.into()));
        }
        let merged = vec![add(Stage::Merge, before, UnitExtent::All, COUNTS.into())];
        let mut clustered = parts(add, (Stage::Cluster, "cluster"), &merged, count);
        clustered.extend(parts(add, (Stage::ClusterShared, "group"), &clustered, count));
        if reads_faces(model, sampling)? {
            let cut = vec![add(Stage::Cut, clustered, UnitExtent::All, CUT.into())];
            let members = parts(add, (Stage::Members, "members"), &cut, count);
            let ranges = face_ranges_of(model, count);
            let faces = parts(add, (Stage::Faces, "faces"), &members, ranges);
            add(Stage::Complete, faces, UnitExtent::All, sampled)
        } else {
            add(Stage::Cut, clustered, UnitExtent::All, sampled)
        }
    } else {
        add(Stage::Sample, before, UnitExtent::All, sampled)
    })
}

/// Adds the units of a stage, each for the part with its number, after the same other units.
fn parts(
    add: &mut impl FnMut(Stage, Vec<usize>, UnitExtent, PathBuf) -> usize,
    (stage, name): (Stage, &str),
    after: &[usize],
    count: u64,
) -> Vec<usize> {
    let writes = |part| PathBuf::from(format!("{name}-{part}.bin"));
    (0..count).map(|part| add(stage, after.to_vec(), UnitExtent::Part(part), writes(part))).collect()
}

/// The pieces of a model, tiles among them, that units write.
fn pieces(model: &dyn Model, division: &Division, units: u64) -> Vec<Range<u64>> {
    if !model.tiles().is_empty() {
        let bytes: Vec<u64> = model.tiles().iter().map(|tile| tile.bytes).collect();
        return runs(&bytes, units);
    }
    let first = division.vertices.start;
    let range = |share: Range<u64>| first + share.start..first + share.end;
    shares(division.pieces - first, units).map(range).collect()
}

/// Runs of tiles of about as many bytes, none of them empty.
fn runs(bytes: &[u64], count: u64) -> Vec<Range<u64>> {
    let (tiles, all) = (bytes.len() as u64, bytes.iter().map(|bytes| u128::from(*bytes)).sum::<u128>());
    let count = count.clamp(1, tiles.max(1));
    let (mut next, mut before) = (0, 0);
    let run = |share: u64| {
        let (start, end) = (next, all * u128::from(share + 1) / u128::from(count));
        // The units behind this one have a tile each.
        let most = tiles - (count - 1 - share);
        for tile in &bytes[start as usize..most as usize] {
            let tile = u128::from(*tile);
            if next > start && before + tile / 2 > end {
                break;
            }
            before += tile;
            next += 1;
        }
        start..next
    };
    (0..count).map(run).collect()
}

/// Ranges of about the same length, none of them empty.
fn shares(all: u64, count: u64) -> impl Iterator<Item = Range<u64>> {
    let count = count.clamp(1, all.max(1));
    let at = move |share: u64| (u128::from(all) * u128::from(share) / u128::from(count)) as u64;
    (0..count).map(move |share| at(share)..at(share + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shares_are_all_of_it(all in 0u64..u64::MAX, count in 0u64..2000) {
            let shares: Vec<Range<u64>> = shares(all, count).collect();
            let mut next = 0;
            for share in &shares {
                prop_assert!(share.start == next && (share.end > share.start || all == 0));
                next = share.end;
            }
            prop_assert_eq!(next, all);
            prop_assert!(shares.len() as u64 <= count.max(1));
            let lengths = shares.iter().map(|share| share.end - share.start);
            prop_assert!(lengths.clone().max().unwrap() - lengths.min().unwrap() <= 1);
        }

        #[test]
        fn runs_have_all_tiles_and_about_as_many_bytes(
            bytes in proptest::collection::vec(prop_oneof![0..1000u64, Just(u64::MAX / 64)], 1..60),
            count in 0u64..80,
        ) {
            let runs = runs(&bytes, count);
            prop_assert_eq!(runs.len() as u64, count.clamp(1, bytes.len() as u64));
            let mut next = 0;
            for run in &runs {
                prop_assert!(run.start == next && run.end > run.start);
                next = run.end;
            }
            prop_assert_eq!(next, bytes.len() as u64);
        }

        #[test]
        fn runs_of_tiles_that_are_alike_are_alike(tiles in 1usize..500, count in 1u64..80) {
            let lengths: Vec<u64> = runs(&vec![1000; tiles], count).iter().map(|run| run.end - run.start).collect();
            prop_assert!(lengths.iter().max().unwrap() - lengths.iter().min().unwrap() <= 1);
        }
    }
}
