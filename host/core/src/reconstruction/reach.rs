//! Reach of the integers that a file stores positions as: whether it suffices for a deformation, as far as
//! the samples tell; and an offset with which it does.

use glam::DVec3;
use simod_model::bounds::Bounds;
use simod_model::{Error, Model, Result};

use crate::deformed_positions::DeformedPositions;
use crate::sampled_model::SampledModel;

/// Vertices go beyond the samples by no more than this part of the diagonal of these, as a rule.
const BEYOND: f64 = 0.05;

const AXES: [&str; 3] = ["x", "y", "z"];

/// An error where a sample goes where the new file of the model has no numbers for positions.
pub(super) fn check_reach<'a>(
    sampled: &SampledModel,
    model: &dyn Model,
    deformed: impl IntoIterator<Item = &'a DeformedPositions>,
) -> Result<()> {
    for deformed in deformed {
        let from = deformed.local.iter().zip(&sampled.samples.positions);
        for (sample, (p, (local, rest))) in deformed.places(&sampled.frame).zip(from).enumerate() {
            let moves = local != rest || !deformed.is_unshifted();
            if moves && !model.has_room_for(p) {
                return Err(no_room(model, sample, p));
            }
        }
    }
    Ok(())
}

fn no_room(model: &dyn Model, sample: usize, p: DVec3) -> Error {
    let path = model.path().display();
    let Some(integers) = model.info().written else {
        return Error::degenerate(
            format!(
                "sample {sample} moves to {p}, for which {path} has no room in its integers; nothing was written"
            ),
            "move it less, give --offset auto, which chooses other ranges, or export the model with coordinates as floats \
             first",
        );
    };
    let range = integers.range();
    let axis = (0..3).find(|axis| !(range.min[*axis]..=range.max[*axis]).contains(&p[*axis])).unwrap_or(0);
    Error::degenerate(
        format!(
            "sample {sample} moves to {} = {}, but with its scale and offset {path} holds {} to {} alone; nothing was \
             written",
            AXES[axis], p[axis], range.min[axis], range.max[axis]
        ),
        "move it less, or give --offset auto, which chooses another offset",
    )
}

/// Chooses another offset, or another range, for the integers of the new file, where the samples tell that
/// those of the model do not reach. The steps from one number to the next stay where they are. Returns what
/// was changed, if anything.
///
/// # Errors
/// Positions are no integers; what the samples span has more steps than there are numbers.
pub fn choose_offset<'a>(
    sampled: &SampledModel,
    model: &mut dyn Model,
    deformed: impl IntoIterator<Item = &'a DeformedPositions>,
) -> Result<Option<String>> {
    let frame = &sampled.frame;
    let rest = || sampled.samples.positions.iter().map(|p| frame.to_model(*p));
    let pairs = deformed.into_iter().flat_map(|deformed| rest().zip(deformed.places(frame)));
    let moves: Vec<[DVec3; 2]> = pairs.map(|(from, to)| [from, to]).collect();
    let bounds = Bounds::from_points(moves.iter().map(|[_, to]| *to));
    let margin = if bounds.is_empty() { 0.0 } else { BEYOND * bounds.diagonal() };
    model.make_room(&moves, margin)
}
