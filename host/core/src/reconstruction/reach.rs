//! Whether the integers that a file stores positions as reach as far as a deformation goes, as far as the
//! samples tell; and an offset with which they do.

use glam::{DVec3, Vec3};
use simod_model::bounds::Bounds;
use simod_model::{Error, ErrorKind, Model, Result, ScaledIntegers};

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
        return Error::new(
            ErrorKind::Degenerate,
            format!(
                "sample {sample} moves to {p}, for which {path} has no room in its integers; nothing was written"
            ),
            "move it less, or export the model with coordinates as floats first",
        );
    };
    let range = integers.range();
    let axis = (0..3).find(|axis| !(range.min[*axis]..=range.max[*axis]).contains(&p[*axis])).unwrap_or(0);
    Error::new(
        ErrorKind::Degenerate,
        format!(
            "sample {sample} moves to {} = {}, but with its scale and offset {path} holds {} to {} alone; nothing was \
             written",
            AXES[axis], p[axis], range.min[axis], range.max[axis]
        ),
        "move it less, or give --offset auto, which chooses another offset",
    )
}

/// Chooses another offset for the integers of the new file, where the samples tell that those of the model do
/// not reach. The steps from one number to the next stay where they are. Returns the new offset, if it is
/// another one.
///
/// # Errors
/// Positions are no integers; what the samples span has more steps than there are numbers.
pub fn choose_offset<'a>(
    sampled: &SampledModel,
    model: &mut dyn Model,
    deformed: impl IntoIterator<Item = &'a [Vec3]>,
) -> Result<Option<DVec3>> {
    let Some(integers) = model.info().integers else {
        return Err(Error::new(
            ErrorKind::Argument,
            format!("{} has no offset: its positions are not stored as integers", model.path().display()),
            "leave out --offset auto",
        ));
    };
    let positions = deformed.into_iter().flatten();
    let bounds = Bounds::of(positions.map(|local| sampled.frame.to_model(*local)));
    if bounds.is_empty() {
        return Ok(None);
    }
    let Some(steps) = steps_to(&integers, &bounds).map_err(|axis| {
        let extent = (bounds.max - bounds.min)[axis];
        Error::new(
            ErrorKind::Degenerate,
            format!(
                "the deformed samples span {extent} along {}, which has no room in integers of 32 bits at the \
                 scale {} of {}",
                AXES[axis],
                integers.scale[axis],
                model.path().display()
            ),
            "write the model with a coarser scale first, as `pdal translate IN.las OUT.las --writers.las.scale_x=0.01` \
             (and _y, _z) does",
        )
    })?
    else {
        return Ok(None);
    };
    model.move_offset(steps)?;
    Ok(model.info().written.map(|written| written.offset))
}

/// By how many steps the offset has to move, if it has to; an axis along which none will do.
fn steps_to(integers: &ScaledIntegers, bounds: &Bounds) -> Result<Option<[i64; 3]>, usize> {
    let margin = BEYOND * bounds.diagonal();
    let range = integers.range();
    let (min, max) = (bounds.min - margin, bounds.max + margin);
    let mut steps = [0; 3];
    for (axis, steps) in steps.iter_mut().enumerate() {
        if (range.max - range.min)[axis] <= (max - min)[axis] {
            return Err(axis);
        }
        if min[axis] < range.min[axis] || max[axis] > range.max[axis] {
            *steps = ((bounds.center() - integers.offset)[axis] / integers.scale[axis]).round() as i64;
        }
    }
    Ok((steps != [0; 3]).then_some(steps))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_moves_by_whole_steps_and_only_where_it_has_to() {
        let integers =
            ScaledIntegers { scale: DVec3::new(0.01, -0.01, 1e-9), offset: DVec3::new(5.0, 0.0, 1.0) };
        let near = Bounds::of([DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.1, 0.1, 1.5)]);
        assert_eq!(steps_to(&integers, &near), Ok(None));
        let far = Bounds::of([DVec3::new(1e8, 1e8, 0.5), DVec3::new(1e8 + 2.0, 1e8 + 2.0, 1.5)]);
        assert_eq!(steps_to(&integers, &far), Ok(Some([9_999_999_600, -10_000_000_100, 0])));
        let wide = Bounds::of([DVec3::ZERO, DVec3::new(0.0, 0.0, 4.3)]);
        assert_eq!(steps_to(&integers, &wide), Err(2));
    }
}
