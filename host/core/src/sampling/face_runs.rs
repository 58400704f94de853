//! Starts of the runs of triangles in a model's faces whose planes are summed up by themselves, so that a
//! part of the faces can be read by itself. Where all faces are triangles of one length, arithmetic tells;
//! else they are gone over once.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use simod_model::{Error, Model, Progress, Result, for_faces, input, output};
use xxhash_rust::xxh3::xxh3_128;

use super::clustered_file::refused;
use super::placement::FACES_OF_A_SUM;
use crate::sealed::{seal, unsealed};

/// First letters of a file of runs.
const LETTERS: &[u8; 8] = b"simodrun";

const VERSION: u32 = 1;

/// Most bytes of a file of runs: of 2³² - 1 triangles for each vertex there are far fewer.
const LONGEST: u64 = 1 << 36;

/// The runs of a model's faces, each of [`FACES_OF_A_SUM`] triangles but for the last one.
///
/// Memory: 16 bytes per run.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct FaceRuns {
    /// The model's key.
    key: u128,
    triangles: u64,
    starts: Vec<RunStart>,
}

/// The beginning of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct RunStart {
    /// The mark from which faces can be read: of several behind as many triangles, the first.
    mark: u64,
    /// Number of triangles from the mark on that come before the run.
    skip: u64,
}

/// Range of the faces that is read for a part of the runs.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct RunsRead {
    /// Mark at which reading begins.
    pub(super) from: u64,
    /// Triangles of the part's runs, counted from that mark, whose planes the part sums up …
    pub(super) summed: Range<u64>,
    /// … and the number of those before the mark at which the next part begins to read, in which this part
    /// finds all else.
    pub(super) found: u64,
    /// Mark at which the part ends; `None` for the last part, which reads to the end.
    pub(super) to: Option<u64>,
}

/// Whether the faces of a model have to be [gone over](find) before parts of them can be read.
pub fn have_to_be_found(model: &dyn Model) -> bool {
    model.face_at(model.info().faces).is_none()
}

/// Finds where each run of a model's faces begins, to a file. Nothing is done if it is there already; `false`
/// then.
///
/// Memory: 16 bytes for each 65 536 triangles, and as much for the file; chunks of faces.
///
/// # Errors
/// The faces cannot be read, or not from anywhere; the file cannot be written, or another process writes it;
/// the user cancelled.
pub fn find(model: &dyn Model, target: &Path, progress: &dyn Progress) -> Result<bool> {
    if FaceRuns::read(model, target).is_ok() {
        return Ok(false);
    }
    progress.begin("finding the faces", model.info().face_bytes);
    let runs = FaceRuns::find(model, progress)?;
    let bytes = seal(LETTERS, VERSION, &runs)
        .map_err(|e| Error::internal("the runs cannot be held in a file").because(e))?;
    output::write_file(target, &bytes)?;
    Ok(true)
}

/// Hash of a model's size, by which a file is known to be of it.
fn key_of(model: &dyn Model) -> u128 {
    let info = model.info();
    xxh3_128(
        format!("runs of {} bytes, {} vertices, {} faces", info.bytes, info.vertices, info.faces).as_bytes(),
    )
}

impl FaceRuns {
    /// Runs of a model, from a file unless arithmetic tells.
    pub(super) fn known(model: &dyn Model, file: &Path) -> Result<Self> {
        if have_to_be_found(model) { Self::read(model, file) } else { Ok(Self::of_triangles(model)) }
    }

    fn read(model: &dyn Model, path: &Path) -> Result<Self> {
        let bytes = input::read(path, LONGEST)?;
        let damaged = |what: &str| refused(path, &format!("is damaged: {what}"));
        let runs: Self = unsealed(&bytes, (LETTERS, VERSION), damaged)?;
        if runs.key != key_of(model) {
            return Err(refused(path, "is of the faces of another model"));
        }
        let first = |at: usize| (at as u64 * FACES_OF_A_SUM).checked_sub(runs.starts[at].skip);
        let firsts: Option<Vec<u64>> = (0..runs.starts.len()).map(first).collect();
        let fits = runs.starts.len() as u64 == runs.triangles.div_ceil(FACES_OF_A_SUM);
        if !fits || !firsts.is_some_and(|firsts| firsts.is_sorted()) {
            return Err(damaged("its content makes no sense"));
        }
        Ok(runs)
    }

    /// The runs of faces that are all triangles of one length.
    fn of_triangles(model: &dyn Model) -> Self {
        let triangles = model.info().faces;
        let start = |face| model.face_at(face).map(|mark| RunStart { mark, skip: 0 });
        let starts = (0..triangles).step_by(FACES_OF_A_SUM as usize).filter_map(start).collect();
        Self { key: key_of(model), triangles, starts }
    }

    fn find(model: &dyn Model, progress: &dyn Progress) -> Result<Self> {
        let mut runs = Self { key: key_of(model), ..Self::default() };
        // Number of triangles before the last mark, and the mark's offset.
        let mut last: Option<(u64, u64)> = None;
        for_faces(model, |chunk| {
            progress.check()?;
            for mark in &chunk.marks {
                let before = runs.triangles + mark.triangle as u64;
                runs.begin(before, last);
                if last.is_none_or(|(former, _)| former < before) {
                    last = Some((before, mark.offset));
                }
            }
            runs.triangles += chunk.triangles.len() as u64;
            runs.begin(runs.triangles, last);
            progress.advance(chunk.bytes);
            Ok(())
        })?;
        if runs.starts.len() as u64 == runs.triangles.div_ceil(FACES_OF_A_SUM) {
            return Ok(runs);
        }
        Err(Error::internal(format!("{} has faces without marks", model.path().display())))
    }

    /// Begins the runs, each of [`FACES_OF_A_SUM`] triangles, whose first triangle is among the first
    /// `triangles`: each from the last mark before it.
    fn begin(&mut self, triangles: u64, last: Option<(u64, u64)>) {
        let Some((before, mark)) = last else { return };
        loop {
            let next = self.starts.len() as u64 * FACES_OF_A_SUM;
            if next >= triangles {
                return;
            }
            self.starts.push(RunStart { mark, skip: next - before });
        }
    }

    /// Number of all triangles.
    pub(super) fn triangles(&self) -> u64 {
        self.triangles
    }

    /// Range that is read for part number `part` of `parts`; `None` where there are fewer runs than parts.
    pub(super) fn part(&self, part: u64, parts: u64) -> Option<RunsRead> {
        let runs = self.starts.len() as u64;
        let at = |share: u64| (u128::from(runs) * u128::from(share) / u128::from(parts.max(1))) as u64;
        let (first, end) = (at(part), at(part + 1));
        let start = self.starts.get(first as usize).filter(|_| first < end)?;
        let next = self.starts.get(end as usize);
        let before = first * FACES_OF_A_SUM - start.skip;
        let last = (end * FACES_OF_A_SUM).min(self.triangles);
        Some(RunsRead {
            from: start.mark,
            summed: start.skip..last - before,
            found: next.map_or(last, |next| last - next.skip) - before,
            to: next.map(|next| next.mark),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Triangles of any blocks of faces are found once, and summed up once, by any number of parts.
        #[test]
        fn parts_have_all_triangles_once(
            blocks in proptest::collection::vec(prop_oneof![0..50u64, 0..200_000u64], 1..40), parts in 1..50u64,
        ) {
            let mut runs = FaceRuns::default();
            let mut last: Option<(u64, u64)> = None;
            for (offset, triangles) in (100..).step_by(7).zip(&blocks) {
                if last.is_none_or(|(former, _)| former < runs.triangles) {
                    last = Some((runs.triangles, offset));
                }
                runs.triangles += triangles;
                runs.begin(runs.triangles, last);
            }
            let before = |mark: u64| blocks[..(mark as usize - 100) / 7].iter().sum::<u64>();
            let (mut found, mut summed) = (0, 0);
            let mut from = runs.starts.first().map(|start| start.mark);
            for part in (0..parts).filter_map(|part| runs.part(part, parts)) {
                prop_assert_eq!(Some(part.from), from);
                let first = before(part.from);
                prop_assert_eq!([first, first + part.summed.start], [found, summed]);
                found = first + part.found;
                summed = first + part.summed.end;
                prop_assert!(found <= summed && (summed % FACES_OF_A_SUM == 0 || part.to.is_none()));
                prop_assert!(part.to.is_none_or(|to| before(to) == found));
                from = part.to;
            }
            prop_assert_eq!([found, summed, runs.triangles], [runs.triangles; 3]);
        }
    }
}
