//! Whether the integers that a file stores positions as reach as far as a deformation goes, as far as the
//! samples tell; and an offset with which they do.

use glam::{DVec3, Vec3};
use simod_model::bounds::Bounds;
use simod_model::{Error, Model, Result};

use crate::sampled_model::SampledModel;

/// Vertices go beyond the samples by no more than this part of the diagonal of these, as a rule.
const BEYOND: f64 = 0.05;

const AXES: [&str; 3] = ["x", "y", "z"];

/// An error where a sample goes where the new file of the model has no numbers for positions.
pub(super) fn check_reach<'a>(
    sampled: &SampledModel,
    model: &dyn Model,
    deformed: impl IntoIterator<Item = &'a [Vec3]>,
) -> Result<()> {
    let rest = &sampled.samples.positions;
    for positions in deformed {
        for (sample, (local, rest)) in positions.iter().zip(rest).enumerate() {
            let p = sampled.frame.to_model(*local);
            if local != rest && !model.has_room_for(p) {
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
    deformed: impl IntoIterator<Item = &'a [Vec3]>,
) -> Result<Option<String>> {
    let rest = &sampled.samples.positions;
    let pairs = deformed.into_iter().flat_map(|deformed| rest.iter().zip(deformed));
    let moves: Vec<[DVec3; 2]> =
        pairs.map(|(from, to)| [*from, *to].map(|local| sampled.frame.to_model(local))).collect();
    let bounds = Bounds::from_points(moves.iter().map(|[_, to]| *to));
    let margin = if bounds.is_empty() { 0.0 } else { BEYOND * bounds.diagonal() };
    model.make_room(&moves, margin)
}
