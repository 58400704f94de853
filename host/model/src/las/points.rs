//! Positions in and out of records: three integers of 32 bits that each begins with.

use glam::{DVec3, IVec3};

use super::header::bytes_at;
use crate::bounds::Bounds;
use crate::unfit::Unfit;
use crate::{ScaledIntegers, Summary};

/// Bytes of the integers of a position.
pub(super) const BYTES: usize = 12;

#[inline(always)]
fn numbers(record: &[u8]) -> IVec3 {
    let axis = |i: usize| i32::from_le_bytes(bytes_at(record, 4 * i));
    IVec3::new(axis(0), axis(1), axis(2))
}

/// The positions of records.
pub(super) fn decode(integers: &ScaledIntegers, records: &[u8], record: usize, to: &mut Vec<DVec3>) {
    to.clear();
    to.extend(records.chunks_exact(record).map(|bytes| integers.position(numbers(bytes))));
}

/// Puts edited positions into records, where they differ from those before: on the grid of `to`, whose
/// numbers are those of the file less `shift`. Returns whether any byte changed.
pub(super) fn patch(
    (to, shift): (&ScaledIntegers, [i64; 3]),
    records: &mut [u8],
    record: usize,
    (old, new): (&[DVec3], &[DVec3]),
    summary: &mut Summary,
) -> Result<bool, Unfit> {
    let mut changed = false;
    let (mut before, mut after) = ((IVec3::MAX, IVec3::MIN), (IVec3::MAX, IVec3::MIN));
    let include = |all: &mut (IVec3, IVec3), one: IVec3| *all = (all.0.min(one), all.1.max(one));
    for (vertex, ((bytes, old), new)) in records.chunks_exact_mut(record).zip(old).zip(new).enumerate() {
        let was = numbers(bytes);
        let mut is = was;
        include(&mut before, was);
        // A branch that is foretold well: those around a vertex at rest mostly rest, too.
        if old == new && shift == [0; 3] {
            include(&mut after, was);
            continue;
        }
        let within = to.nearest_within(*new).filter(|_| shift == [0; 3] && old.is_finite());
        if let Some(nearest) = within {
            // Without a branch: along which axes vertices move cannot be foretold.
            is = IVec3::from_array([0, 1, 2].map(|i| if old[i] == new[i] { was[i] } else { nearest[i] }));
        } else if shift != [0; 3] || old != new {
            for axis in 0..3 {
                let (old, new) = (old[axis], new[axis]);
                // A coordinate that is not finite, as the scale is huge, keeps its integer.
                let number = if old == new || !old.is_finite() {
                    i32::try_from(i64::from(was[axis]) - shift[axis]).ok()
                } else {
                    to.nearest_of_axis(axis, new)
                };
                is[axis] = number.ok_or(Unfit { vertex, axis, value: new })?;
            }
        }
        include(&mut after, is);
        if is != was {
            changed = true;
            for axis in 0..3 {
                bytes[4 * axis..4 * axis + 4].copy_from_slice(&is[axis].to_le_bytes());
            }
        }
    }
    if !old.is_empty() {
        let bounds = |(min, max): (IVec3, IVec3)| Bounds { min: min.as_dvec3(), max: max.as_dvec3() };
        summary.absorb(&Summary { before: bounds(before), after: bounds(after), ..Summary::default() });
    }
    debug_assert!(record >= BYTES);
    Ok(changed)
}
